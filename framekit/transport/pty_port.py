"""Pairs of pseudo-terminals, for tests, demos and real peers: a port on one, a program on the other."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading

from framekit.definition.times import LineFormat, LineSettings
from framekit.transport.clock import AsyncioClock
from framekit.transport.port import PassingPort
from framekit.transport.serial_port import SerialPort

if sys.platform != "win32":
    import pty
    import tty

PAIR_READ_SIZE = 4096


class PtyPair:
    """Two terminals wired to each other; `first` and `second` are their paths. Closed at the end of a `with`.

    A thread carries the bytes; it keeps at most `PAIR_READ_SIZE` of them in each direction. Raises OSError.
    """

    def __init__(self) -> None:
        pairs = [_raw_pty() for _ in range(2)]
        self._masters = [master for master, _ in pairs]
        self._slaves = [slave for _, slave in pairs]
        self.first, self.second = (os.ttyname(slave) for slave in self._slaves)
        for master in self._masters:
            os.set_blocking(master, False)
        self._stop, self._wake = os.pipe()
        self._closed = False
        self._thread = threading.Thread(target=self._carry, daemon=True, name="pty pair")
        self._thread.start()

    def _carry(self) -> None:
        left, right = self._masters
        waiting = {left: b"", right: b""}
        other = {left: right, right: left}
        while True:
            readers = [master for master in waiting if not waiting[other[master]]]
            writers = [master for master, data in waiting.items() if data]
            readable, writable, _ = select.select([self._stop, *readers], writers, [])
            if self._stop in readable:
                return
            for master in writable:
                with contextlib.suppress(BlockingIOError):
                    waiting[master] = waiting[master][os.write(master, waiting[master]) :]
            for master in readable:
                with contextlib.suppress(BlockingIOError):
                    waiting[other[master]] = os.read(master, PAIR_READ_SIZE)

    def close(self) -> None:
        """Pulls both out: a program that has one open gets an error or the end."""
        if self._closed:
            return
        self._closed = True
        os.write(self._wake, b"x")
        self._thread.join()
        for descriptor in [*self._masters, *self._slaves, self._stop, self._wake]:
            os.close(descriptor)

    def __enter__(self) -> PtyPair:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class PtyPort(PassingPort):
    """A port on a new pair of terminals; its name is the path of the other one, which stays until `release`."""

    def __init__(self, settings: LineFormat | None, clock: AsyncioClock, wiring: LineSettings) -> None:
        self._pair = PtyPair()
        super().__init__(SerialPort(self._pair.first, settings, clock, wiring))
        self.name = self._pair.second

    def release(self) -> None:
        self._pair.close()


def _raw_pty() -> tuple[int, int]:
    """Both ends of a pseudo-terminal that changes no byte. The other end stays open, so that peers may come and go."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    return master, slave
