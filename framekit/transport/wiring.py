"""Wiring of a line, implemented around a port: the direction of RS-485, the local echo, a modem."""

from __future__ import annotations

from collections import deque

from framekit.definition.times import Direction, LineSettings
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import Clock
from framekit.transport.modem import ModemPort
from framekit.transport.port import PassingPort, Port, PortEvents


def wired(port: Port, wiring: LineSettings, clock: Clock) -> Port:
    """Return the port with the wrappers that its wiring requires (direction, echo, modem); the port itself if none is
    required.
    """
    if wiring.direction is not None and wiring.direction.by == "rts":
        port = DirectionPort(port, wiring.direction, clock)
    if wiring.echo:
        port = EchoFreePort(port, clock)
    if wiring.modem is not None:
        port = ModemPort(port, wiring.modem, clock)
    return port


class DirectionPort(PassingPort):
    """Port whose RTS is at the sending level from `before` ns ahead of the first bit until `after` ns past the last
    bit.
    """

    def __init__(self, inner: Port, direction: Direction, clock: Clock) -> None:
        super().__init__(inner)
        self.direction = direction
        self.clock = clock
        self._waiting: deque[bytes | int | tuple[bytes, int]] = deque()
        self._sending = self._ready = False
        self._alarm = clock.alarm(self._go_on)

    def _switch(self, sending: bool) -> None:
        self._sending = sending
        self._ready = False
        self.inner.set_rts(sending == self.direction.high)

    def _after(self, time: int) -> None:
        """Run `_go_on` after `time` (ns); a later call replaces the alarm."""
        self._alarm.set(self.clock.now() + time)

    def forget(self) -> None:
        super().forget()
        self._waiting.clear()
        self._sending = self._ready = False
        self._alarm.cancel()

    def opened(self, now: int) -> None:
        self._switch(False)
        super().opened(now)

    def write(self, data: bytes) -> None:
        self._put(data)

    def write_marked(self, data: bytes, marked: int) -> None:
        self._put((data, marked))

    def send_break(self, duration: int) -> None:
        self._put(duration)

    def set_rts(self, on: bool) -> None:
        """Ignore the call: RTS belongs to the direction of the line."""

    def _put(self, what: bytes | int | tuple[bytes, int]) -> None:
        if self.events is None:
            return
        self._waiting.append(what)
        if self._sending and self._ready:
            self._hand_over()
        elif not self._sending:
            self._switch(True)
            self._after(self.direction.before)

    def _go_on(self) -> None:
        """Begin to send after the lead time, or release the line after the last bit."""
        if self._waiting:
            self._ready = True
            self._hand_over()
        elif self._sending:
            self._switch(False)
            super().sent(self.clock.now())

    def _hand_over(self) -> None:
        self._alarm.cancel()
        while self._waiting:
            what = self._waiting.popleft()
            if isinstance(what, bytes):
                self.inner.write(what)
            elif isinstance(what, tuple):
                self.inner.write_marked(*what)
            else:
                self.inner.send_break(what)

    def sent(self, now: int) -> None:
        if self.direction.after:
            self._after(self.direction.after)
        else:
            self._go_on()


LATEST = 100_000_000
"""Longest delay of an echo after the last bit left (ns); adapters hold bytes back."""


class EchoFreePort(PassingPort):
    """Port that removes its echo.

    `removed`: number of characters removed; `damaged`: number of those that returned damaged; `missing`: number of
    transmissions that did not return, because the first character differed or no character arrived.
    """

    def __init__(self, inner: Port, clock: Clock) -> None:
        super().__init__(inner)
        self.clock = clock
        self.removed = self.damaged = self.missing = 0
        self._expected = bytearray()
        self._begun = False
        self._until: int | None = None

    def open(self, events: PortEvents) -> None:
        self._expect_nothing()
        super().open(events)

    def _expect_nothing(self) -> None:
        self._expected.clear()
        self._begun = False
        self._until = None

    def write(self, data: bytes) -> None:
        self._expected += data
        self._until = None
        super().write(data)

    def write_marked(self, data: bytes, marked: int) -> None:
        self._expected += data
        self._until = None
        super().write_marked(data, marked)

    def sent(self, now: int) -> None:
        self._until = now + LATEST
        super().sent(now)

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        if self._expected and self._until is not None and now > self._until:
            self.missing += 1
            self._expect_nothing()
        flagged = {one.index for one in faults if one.fault is not LineFault.MARK}
        taken = 0
        while taken < len(data) and self._expected:
            wrong = data[taken] != self._expected[0] or taken in flagged
            if wrong and not self._begun and taken not in flagged:
                self.missing += 1
                self._expect_nothing()
                break
            self.damaged += wrong
            self._begun = True
            del self._expected[0]
            taken += 1
        self.removed += taken
        if not self._expected:
            self._begun = False
        if taken < len(data):
            rest = tuple(CharacterFault(one.index - taken, one.fault) for one in faults if one.index >= taken)
            super().received(data[taken:], now, rest)
