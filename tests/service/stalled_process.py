"""A client whose process stalls: its clock jumps ahead, and bytes that arrived meanwhile wait to be read.

The stalls of a world are planned by the number of the interaction of the client with its clock and its port: each
reading of the clock, each timer, each write. So a stall can come in every phase of an exchange, also within a function
and, where a read returns fewer bytes than a frame has, between two reads of one frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from framekit.link.events import CharacterFault
from framekit.transport.clock import Alarm, Callback, Handle, Lagging, LateAlarm, VirtualClock
from framekit.transport.port import PassingPort, Port

Plan = Callable[[int], int]
"""A function from the number of an interaction to the duration of the stall there (ns); 0: no stall."""


def once(number: int, duration: int) -> Plan:
    """Return the plan of a single stall."""
    stalls: Mapping[int, int] = {number: duration}
    return lambda interaction: stalls.get(interaction, 0)


class DeferredCall:
    """A call of the clock; a call that becomes due during a stall is made after the stall."""

    def __init__(self, clock: StalledClock, callback: Callback) -> None:
        self.clock = clock
        self.callback: Callback | None = callback
        self.handle: Handle | None = None

    def cancel(self) -> None:
        self.callback = None
        if self.handle is not None:
            self.handle.cancel()

    def make(self) -> None:
        if self.callback is None:
            return
        if self.clock.is_stalled:
            self.clock.due.append(self)
        else:
            callback, self.callback = self.callback, None
            callback()


class StalledClock:
    """The clock of the client: the clock of the world with added stalls.

    `reads_first`: after a stall the loop reads the ports before it makes the calls that came due; else afterwards.
    """

    def __init__(self, inner: VirtualClock, plan: Plan, reads_first: bool = False) -> None:
        self.inner, self.plan, self.reads_first = inner, plan, reads_first
        self.is_stalled = False
        self.is_armed = False
        """Whether interactions are counted; stalls come only then."""
        self.interactions = 0
        self.due: list[DeferredCall] = []
        self.ports: list[StalledPort] = []

    def interact(self) -> None:
        """Count an interaction, and stall if the plan has a stall here."""
        if not self.is_armed or self.is_stalled:
            return
        self.interactions += 1
        duration = self.plan(self.interactions)
        if duration:
            self.is_stalled = True
            self.inner.run_for(duration)
            self.is_stalled = False
            self._go_on()

    def _go_on(self) -> None:
        """Let the loop go on after a stall: it makes the calls that are due, and reads the ports."""
        if self.reads_first:
            for port in self.ports:
                port.read_soon()
        due, self.due = self.due, []
        for call in due:
            call.handle = self.inner.call_soon(call.make)
        if not self.reads_first:
            for port in self.ports:
                port.read_soon()

    # ---- as the users of a clock see it -------------------------------------------------------------------

    def now(self) -> int:
        self.interact()
        return self.inner.now()

    def moment(self) -> int:
        return self.inner.now()

    def call_at(self, when: int, callback: Callback) -> Handle:
        call = DeferredCall(self, callback)
        call.handle = self.inner.call_at(when, call.make)
        return call

    def call_soon(self, callback: Callback) -> Handle:
        return self.call_at(self.inner.now(), callback)

    def look_at(self, when: int, callback: Callback) -> None:
        self.inner.look_at(when, callback)

    def alarm(self, callback: Callback) -> Alarm:
        def ring() -> None:
            self.interact()
            callback()

        return LateAlarm(self, ring)

    def bell(self, callback: Callback) -> Callable[[], object]:
        return lambda: self.call_soon(callback)

    def lag(self, source: Lagging) -> None:
        self.inner.lag(source)

    def end_lag(self, source: Lagging) -> None:
        self.inner.end_lag(source)


class StalledPort(PassingPort):
    """The port of the client: bytes wait until the loop reads them, `room` bytes in a turn.

    `is_network`: everything that is written has left at once, as on a TCP connection.
    """

    def __init__(self, inner: Port, clock: StalledClock, is_network: bool = False, room: int = 64) -> None:
        super().__init__(inner)
        self.clock, self.is_network, self.room = clock, is_network, room
        self.has_exact_times = False
        if is_network:
            self.settings = None
        self.waiting = bytearray()
        self.is_asked = False
        self.never_empty = False
        """Whether bytes are always unread, as under a flood."""
        self.knows_unread = True
        """Whether the port reports unread bytes; some operating systems do not."""
        clock.ports.append(self)

    @property
    def has_unread(self) -> bool:
        return self.knows_unread and (bool(self.waiting) or self.never_empty)

    def write(self, data: bytes) -> None:
        self.clock.interact()
        super().write(data)
        self.clock.interact()

    def write_through(self, data: bytes) -> bool:
        self.write(data)
        return self.is_network

    # ---- events of the line -------------------------------------------------------------------------------

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self.waiting += data
        if not self.clock.is_stalled:
            self.read_soon()

    def read_soon(self) -> None:
        """Let the loop read the waiting bytes."""
        if self.waiting and not self.is_asked:
            self.is_asked = True
            self.clock.call_soon(self._read)

    def _read(self) -> None:
        self.is_asked = False
        data, self.waiting = bytes(self.waiting[: self.room]), self.waiting[self.room :]
        self.read_soon()
        if data and self.events is not None:
            self.events.received(data, self.clock.now())

    def sent(self, now: int) -> None:
        if not self.is_network:
            self.clock.call_soon(self._sent)

    def _sent(self) -> None:
        if self.events is not None:
            self.events.sent(self.clock.now())

    def closed(self, now: int, reason: str) -> None:
        self.waiting.clear()
        super().closed(now, reason)
