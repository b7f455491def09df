"""Pairs of pseudo-terminals, for tests, demos and real peers: a port at one terminal, a program at the other."""

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
    """Two connected terminals; `first` and `second` are their paths. The end of a `with` block closes them.

    A thread moves the bytes; it buffers at most `PAIR_READ_SIZE` bytes in each direction. Raises OSError.
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
        """Close both terminals: a program at one of them gets an error or the end of the stream."""
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
    """Port at a new pair of pseudo-terminals; another program uses the other terminal, until `release`.

    `link`: path of a symbolic link to the other terminal; it replaces an existing link to a terminal, such as from an
    earlier start. Raises OSError if the link cannot be created, and ValueError if the path exists and is no such link.
    """

    name: str
    """The path for the other program: `link`, or the path of the other terminal."""

    def __init__(self, settings: LineFormat | None, clock: AsyncioClock, wiring: LineSettings, link: str = "") -> None:
        _refuse_other_files(link)
        self._pair = PtyPair()
        self._link = link
        super().__init__(SerialPort(self._pair.first, settings, clock, wiring))
        self.name = link or self._pair.second
        if link:
            try:
                _replace_link(link, self._pair.second)
            except OSError:
                self._pair.close()
                raise

    def release(self) -> None:
        if self._link:
            with contextlib.suppress(OSError):
                if os.readlink(self._link) == self._pair.second:  # unless a later start has replaced it
                    os.unlink(self._link)
        self._pair.close()


TERMINALS = ("/dev/pts/", "/dev/ttys", "/dev/tty")
"""Prefixes of the paths of pseudo-terminals on Linux, macOS and BSD."""


def _refuse_other_files(link: str) -> None:
    """Raise ValueError if the path exists and is no link to a terminal."""
    if link and os.path.lexists(link) and not (os.path.islink(link) and os.readlink(link).startswith(TERMINALS)):
        raise ValueError(f"'{link}' exists and is no link to a terminal – name a path that is free")


def _replace_link(link: str, terminal: str) -> None:
    """Create a symbolic link, or replace it in one step if it exists. Raise OSError."""
    fresh = f"{link}.{os.getpid()}"
    os.symlink(terminal, fresh)
    try:
        os.replace(fresh, link)
    except OSError:
        os.unlink(fresh)
        raise


def _raw_pty() -> tuple[int, int]:
    """Return both ends of a pseudo-terminal that changes no byte. The other end stays open while peers come and go."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    return master, slave
