"""The lines that channels of a run have closed: ports whose modems still hang up.

Lines are known by their names (`line_of`), not by the numbers of channels: an edit may give a line to another channel.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from framekit.transport.port import Port


class ClosingPorts:
    """The closed ports of all channels, present and removed, that have not finished their work: modems hang up."""

    def __init__(self) -> None:
        self._ports: dict[str, list[Port]] = {}
        """The closing ports by line."""
        self._openings: dict[str, list[tuple[object, Callable[[], None]]]] = {}
        """Openings that wait for the end of the closing, each with its channel, by line."""
        self._at_end: list[Callable[[], None]] = []

    @property
    def names(self) -> list[str]:
        """Return the names of the closing ports."""
        return [port.name for ports in self._ports.values() for port in ports]

    def add(self, line: str, port: Port) -> None:
        """Register a port that its owner has closed, until it has finished its work."""
        if any(one is port for one in self._ports.get(line, ())):
            return
        self._ports.setdefault(line, []).append(port)
        port.when_closed(lambda: self._closed(line, port))

    def open(self, line: str, channel: object, port: Port, start: Callable[[], None]) -> None:
        """Call `start` when no other port on the line of `port` is closing; a port waits for its own closing itself."""
        if all(one is port for one in self._ports.get(line, ())):
            start()
        else:
            self.cancel(line, channel)
            again = partial(self.open, line, channel, port, start)
            self._openings.setdefault(line, []).append((channel, again))

    def cancel(self, line: str, channel: object) -> None:
        """Cancel the waiting opening of a channel, if any."""
        left = [opening for opening in self._openings.pop(line, ()) if opening[0] is not channel]
        if left:
            self._openings[line] = left

    def at_end(self, done: Callable[[], None]) -> None:
        """Call `done` once no port is closing."""
        if self._ports:
            self._at_end.append(done)
        else:
            done()

    def _closed(self, line: str, port: Port) -> None:
        left = [one for one in self._ports.pop(line) if one is not port]
        if left:
            self._ports[line] = left
        for _, again in self._openings.pop(line, ()):
            again()
        if not self._ports:
            waiting, self._at_end = self._at_end, []
            for done in waiting:
                done()
