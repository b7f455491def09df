"""The lines that channels have closed: requests whose replies may still come, and ports whose modems still hang up.

Lines are known by their names (`line_of`), not by the numbers of channels: an edit may give a line to another channel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from framekit.definition.fingerprint import fingerprint
from framekit.link.engine import Engine
from framekit.link.late import LateReplies
from framekit.transport.port import Port


@dataclass(slots=True, eq=False)
class LeftEngine:
    """An engine whose channel has closed its line."""

    engine: Engine
    takers: list[LateReplies] = field(default_factory=list)
    """Those of the engines that have used the line since, and know its open requests."""

    def is_like(self, engine: Engine) -> bool:
        """Return whether another engine has the same protocol and role, so that it understands the requests."""
        mine = self.engine
        return mine.role == engine.role and (
            mine.protocol is engine.protocol or fingerprint(mine.protocol) == fingerprint(engine.protocol)
        )


class LeftRequests:
    """The open requests of channels that have closed their lines: the next channel on the line waits for them too.

    Runs in sequence, in the same process, may share it.
    """

    def __init__(self) -> None:
        self._left: dict[str, list[LeftEngine]] = {}
        """By line the engines whose requests may still be answered."""

    def leave(self, line: str, engine: Engine, now: int) -> None:
        """Keep the open requests of an engine that asks, as its channel closes the line."""
        left = self._left.pop(line, [])
        if all(one.engine is not engine for one in left):
            engine.leave_line(now)
            left.append(LeftEngine(engine))
        # what a taker does not wait for any more, it has received
        self._keep(line, [one for one in left if engine.late not in one.takers], now)

    def enter(self, line: str, engine: Engine, now: int) -> None:
        """Pass the open requests of a line to the engine whose channel opens it."""
        left = [one for one in self._left.pop(line, ()) if one.engine is not engine]
        for one in left:
            if engine.late not in one.takers and not one.engine.late.is_over(now):
                engine.late.take_over(one.engine.late, is_same=one.is_like(engine))
                one.takers.append(engine.late)
        self._keep(line, left, now)

    def _keep(self, line: str, left: list[LeftEngine], now: int) -> None:
        if kept := [one for one in left if not one.engine.late.is_over(now)]:
            self._left[line] = kept


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
