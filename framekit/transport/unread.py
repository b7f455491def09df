"""Whether bytes wait in the operating system that no read has returned yet: the question before a time limit ends."""

from __future__ import annotations

import select
import sys


class UnreadInput:
    """The input of a file descriptor, or on Windows of a socket; `bool` of it returns whether a read would return.

    That is also the case at the end of a connection, and if the question itself fails: a read then reports the loss.
    """

    __slots__ = ("_descriptor", "_poll")

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        if sys.platform != "win32":
            self._poll = select.poll()  # `select` has no room for descriptors above 1023
            self._poll.register(descriptor, select.POLLIN)

    def __bool__(self) -> bool:
        try:
            if sys.platform == "win32":
                return bool(select.select([self._descriptor], [], [], 0)[0])
            return bool(self._poll.poll(0))
        except (OSError, ValueError):  # a descriptor that is closed, or -1
            return True
