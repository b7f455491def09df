"""A port that stands before another one and passes everything on: what wrappers of ports have in common."""

from __future__ import annotations

from collections.abc import Mapping

from framekit.link.events import CharacterFault
from framekit.transport.port import Port, PortEvents


class PassingPort(Port):
    """Passes on what its owner does, and what the port behind it tells."""

    def __init__(self, inner: Port) -> None:
        self.inner = inner
        self.name = inner.name
        self.settings = inner.settings
        self.opens_again = inner.opens_again
        self.events: PortEvents | None = None

    def forget(self) -> None:
        """The use of the port is over."""
        self.events = None

    # ---- what its owner does ------------------------------------------------------------------------------

    def open(self, events: PortEvents) -> None:
        if self.events is not None:
            self.close()
        self.events = events
        self.inner.open(self)

    def write(self, data: bytes) -> None:
        self.inner.write(data)

    def close(self) -> None:
        self.forget()
        self.inner.close()

    def send_break(self, duration: int) -> None:
        self.inner.send_break(duration)

    def set_rts(self, on: bool) -> None:
        self.inner.set_rts(on)

    def flush_input(self) -> None:
        self.inner.flush_input()

    # ---- what the port behind it tells --------------------------------------------------------------------

    def opened(self, now: int) -> None:
        if self.events is not None:
            self.events.opened(now)

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        if self.events is not None:
            self.events.received(data, now, faults)

    def other_sender(self, now: int) -> None:
        if self.events is not None:
            self.events.other_sender(now)

    def line_break(self, now: int) -> None:
        if self.events is not None:
            self.events.line_break(now)

    def sent(self, now: int) -> None:
        if self.events is not None:
            self.events.sent(now)

    def closed(self, now: int, reason: str) -> None:
        events = self.events
        self.forget()
        if events is not None:
            events.closed(now, reason)

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        if self.events is not None:
            self.events.control(lines, now)
