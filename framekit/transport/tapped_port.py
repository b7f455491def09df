"""A port around another one that shows everything going through it: bytes, breaks, control lines, opening, closing.

Only lines that somebody wants to see have one, so nothing is paid otherwise. What is done with it is not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from framekit.link.events import CharacterFault
from framekit.transport.clock import Clock
from framekit.transport.port import Port, PortEvents

LineEventKind = Literal["data", "break", "control", "open", "closed"]
Direction = Literal["in", "out", ""]


@dataclass(frozen=True, slots=True)
class LineEvent:
    """Something on a line. `at` (ns): when the last byte was complete, or when it was handed over for sending.

    `faults`: the damaged characters of `data`; `lines`: control lines by name; `reason`: why it was closed.
    """

    kind: LineEventKind
    at: int
    direction: Direction = ""
    data: bytes = b""
    faults: tuple[CharacterFault, ...] = ()
    lines: Mapping[str, bool] = field(default_factory=dict)
    reason: str = ""


Tap = Callable[[LineEvent], None]


class TappedPort(Port):
    """The port `inner`, with `tap` told of everything before whoever uses the port."""

    def __init__(self, inner: Port, clock: Clock, tap: Tap) -> None:
        self.inner = inner
        self.clock = clock
        self.tap = tap
        self.name = inner.name
        self.settings = inner.settings
        self.opens_again = inner.opens_again
        self.is_open = False

    def open(self, events: PortEvents) -> None:
        self.inner.open(_Tapped(self, events))

    def write(self, data: bytes) -> None:
        self._show(data)
        self.inner.write(data)

    def write_through(self, data: bytes) -> bool:
        self._show(data)
        return self.inner.write_through(data)

    def _show(self, data: bytes) -> None:
        if self.is_open and data:
            self.tap(LineEvent("data", self.clock.now(), "out", data))

    def close(self) -> None:
        if self.is_open:
            self.is_open = False
            self.tap(LineEvent("closed", self.clock.now()))
        self.inner.close()

    def send_break(self, duration: int) -> None:
        if self.is_open:
            self.tap(LineEvent("break", self.clock.now(), "out"))
        self.inner.send_break(duration)

    def set_rts(self, on: bool) -> None:
        if self.is_open:
            self.tap(LineEvent("control", self.clock.now(), "out", lines={"rts": on}))
        self.inner.set_rts(on)

    def flush_input(self) -> None:
        self.inner.flush_input()

    def describes(self) -> str:
        return self.inner.describes()


class _Tapped:
    """The events of a tapped port on their way to its owner."""

    def __init__(self, port: TappedPort, events: PortEvents) -> None:
        self._port = port
        self._events = events

    def opened(self, now: int) -> None:
        self._port.is_open = True
        self._port.tap(LineEvent("open", now))
        self._events.opened(now)

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self._port.tap(LineEvent("data", now, "in", data, tuple(faults)))
        self._events.received(data, now, faults)

    def other_sender(self, now: int) -> None:
        self._events.other_sender(now)

    def line_break(self, now: int) -> None:
        self._port.tap(LineEvent("break", now, "in"))
        self._events.line_break(now)

    def sent(self, now: int) -> None:
        self._events.sent(now)

    def closed(self, now: int, reason: str) -> None:
        self._port.is_open = False
        self._port.tap(LineEvent("closed", now, reason=reason))
        self._events.closed(now, reason)

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        self._port.tap(LineEvent("control", now, "in", lines=dict(lines)))
        self._events.control(lines, now)
