"""A pair of pseudo-terminals: what is written to one comes out of the other. For tests, demos and real peers.

A pseudo-terminal has no baud rate, no parity and no break.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import tty


class PtyPair:
    """Two terminals wired to each other; `first` and `second` are their paths. Closed at the end of a `with`."""

    def __init__(self) -> None:
        self._masters: list[int] = []
        self._slaves: list[int] = []
        paths = []
        for _ in range(2):
            master, slave = pty.openpty()
            tty.setraw(slave)
            self._masters.append(master)
            self._slaves.append(slave)
            paths.append(os.ttyname(slave))
        self.first, self.second = paths
        self._stop, self._wake = os.pipe()
        self._thread = threading.Thread(target=self._carry, daemon=True, name="pty pair")
        self._thread.start()

    def _carry(self) -> None:
        left, right = self._masters
        other = {left: right, right: left}
        while True:
            ready, _, _ = select.select([left, right, self._stop], [], [])
            if self._stop in ready:
                return
            for master in ready:
                with contextlib.suppress(OSError):
                    os.write(other[master], os.read(master, 4096))

    def close(self) -> None:
        """Pulls both out: whoever has one open gets an error or the end."""
        os.write(self._wake, b"x")
        self._thread.join()
        for descriptor in [*self._masters, *self._slaves, self._stop, self._wake]:
            with contextlib.suppress(OSError):
                os.close(descriptor)

    def __enter__(self) -> PtyPair:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
