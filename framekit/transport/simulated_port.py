"""One port of a simulated line: what its owner hands over goes out in order, what it hears it tells.

Everything is told in calls of the clock. How characters travel and what happens to them is the line's business.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from framekit.link.events import CharacterFault
from framekit.transport.port import Port, PortEvents

if TYPE_CHECKING:
    from framekit.transport.simulated import SimulatedLine
    from framekit.transport.transmission import Fault

FAR_END_CLOSED = "the other side has closed the connection"


class SimulatedPort(Port):
    """A port made by `SimulatedLine.port`.

    While not `present` (an adapter that is unplugged) it cannot be opened. `rts` is how its owner has set the line.
    `wanted`: it is open or waits for a connection, `joined`: it takes part in `connection`. `fault` is done to what
    this port sends, before that of the line.
    """

    def __init__(self, line: SimulatedLine, name: str) -> None:
        self.line = line
        self.name = name
        self.settings = line.settings
        self.present = True
        self.rts = False
        self.fault: Fault | None = None
        self.is_open = False
        self.joined = False
        self.connection = line.connection
        self.heard_until = 0
        self._events: PortEvents | None = None
        self._clock = line.clock
        self._opening = 0
        self._deaf_until = 0
        self._free = 0
        self._sent_due = False

    @property
    def wanted(self) -> bool:
        return self._events is not None

    def _later(self, when: int, action: Callable[[], None]) -> None:
        """Does something then, unless the port has been closed meanwhile."""
        opening = self._opening

        def call() -> None:
            if opening == self._opening:
                action()

        self._clock.call_at(when, call)

    # ---- life ---------------------------------------------------------------------------------------------

    def open(self, events: PortEvents) -> None:
        self.close()
        self._events = events
        if self.present:
            self.line.join(self)
        else:
            self._later(self._clock.now(), lambda: self.pull(f"{self.name} is not there"))

    def connect(self, connection: int) -> None:
        """The line is there, or the connection: the port is open from now on."""
        self.joined = True
        self.connection = connection
        self._later(self._clock.now(), self._opened)

    def _opened(self) -> None:
        self.is_open = True
        self._deaf_until = now = self._clock.now()
        if self._events is not None:
            self._events.opened(now)

    def close(self) -> None:
        if self.wanted:
            self._forget()

    def _forget(self) -> None:
        """What has not begun to leave never will."""
        self._events = None
        self.is_open = False
        self._opening += 1
        self._free = 0
        self._sent_due = False
        self.line.cut_off(self)
        self.line.leave(self)
        self.joined = False

    def pull(self, reason: str = "pulled out") -> None:
        """The port goes away, as an adapter does that is unplugged; its owner is told at once."""
        events = self._events
        if events is not None:
            self._forget()
            events.closed(self._clock.now(), reason)

    def lose_at(self, when: int) -> None:
        """The other side of a connection has gone; that is known here then."""
        self._later(when, lambda: self.pull(FAR_END_CLOSED))

    # ---- out ----------------------------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        if not self.is_open:
            return
        start = max(self._free, self._clock.now())
        self._free = self.line.transmit(self, data, start) if data else start
        self._tell_when_sent()

    def send_break(self, duration: int) -> None:
        if not self.is_open:
            return
        start = max(self._free, self._clock.now())
        self._free = start + duration
        self._later(start, lambda: self.line.break_from(self, start, duration))
        self._tell_when_sent()

    def _tell_when_sent(self) -> None:
        if not self._sent_due:
            self._sent_due = True
            self._later(self._free, self._left)

    def _left(self) -> None:
        """The last bit has left, unless something else has been handed over meanwhile."""
        self._sent_due = False
        if self._free > self._clock.now():
            self._tell_when_sent()
        elif self._events is not None:
            self._events.sent(self._free)

    def set_rts(self, on: bool) -> None:
        self.rts = on

    # ---- in -----------------------------------------------------------------------------------------------

    def flush_input(self) -> None:
        """Drops characters that are complete by now and have not been told; one on its way is heard."""
        self._deaf_until = max(self._deaf_until, self._clock.now() - self.line.character_time + 1)

    def hear(self, data: bytes, now: int, faults: tuple[CharacterFault, ...], begin: int) -> None:
        """Characters without a pause between them, the first of which begins at `begin`."""
        if self._events is None or not self.is_open:
            return
        if begin < self._deaf_until:
            step = self.line.character_time
            missed = -((begin - self._deaf_until) // step) if step else len(data)
            data = data[missed:]
            faults = tuple(CharacterFault(at.index - missed, at.fault) for at in faults if at.index >= missed)
        if data:
            self._events.received(data, now, faults)

    def hear_break(self, now: int) -> None:
        """The line has been in break state for more than a character."""
        if self._events is not None and self.is_open:
            self._events.line_break(now)

    def signal(self, lines: Mapping[str, bool]) -> None:
        """What is connected to the port switches control lines (cts, dsr, dcd, ri)."""
        if self._events is not None and self.is_open:
            self._events.control(lines, self._clock.now())
