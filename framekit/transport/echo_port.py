"""Takes the local echo away: on two wires many adapters hear what they send.

The echo of a transmission has as many characters as it. They are compared as they come; a damaged one is still taken
for echo. What is behind them belongs to the other side.
"""

from __future__ import annotations

from framekit.link.events import CharacterFault
from framekit.transport.clock import Clock
from framekit.transport.passing_port import PassingPort
from framekit.transport.port import Port, PortEvents

LATEST = 100_000_000
"""An echo that has not come so long after the last bit left does not come any more (ns); adapters hold bytes back."""


class EchoFreePort(PassingPort):
    """A port without its echo. `removed` counts characters taken away, `damaged` those that came back wrong.

    `missing` counts transmissions that did not come back: their first character was another one, or nothing came.
    """

    def __init__(self, inner: Port, clock: Clock, latest: int = LATEST) -> None:
        super().__init__(inner)
        self.clock = clock
        self.latest = latest
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

    def sent(self, now: int) -> None:
        self._until = now + self.latest
        super().sent(now)

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        if self._expected and self._until is not None and now > self._until:
            self.missing += 1
            self._expect_nothing()
        flagged = {fault.index for fault in faults}
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
