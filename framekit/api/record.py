"""Recordings of lines that nothing is known of: bytes, times, damage and breaks, kept in a capture and shown."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from framekit.api.errors import RequestError
from framekit.definition.problems import plural
from framekit.definition.times import NEVER, LineFormat
from framekit.link.events import CharacterFault, Command, LineFault
from framekit.service.capture import Capture
from framekit.service.driver import Driver, LineLoad
from framekit.transport.clock import AsyncioClock, Clock
from framekit.transport.port import LineEvent, Port, Way
from framekit.transport.schemes import open_port


def clock_of_loop() -> Clock:
    """The time of the running loop."""
    return AsyncioClock(asyncio.get_running_loop())


WAYS: tuple[Way, Way] = ("in", "out")
"""The direction that a recording gives the bytes of its first port, and those of its second."""


@dataclass(frozen=True, slots=True)
class Heard:
    """Something on a wire (0: that of the first port). `begin`, `end` (ns): of its characters; equal where they take no
    time.
    """

    wire: int
    event: LineEvent
    begin: int
    end: int


@dataclass(slots=True)
class WireCounts:
    """What has come over one wire. `missing`: bytes that are not in the file; `stuck`: that were not passed on."""

    bytes: int = 0
    framing: int = 0
    parity: int = 0
    overruns: int = 0
    breaks: int = 0
    missing: int = 0
    stuck: int = 0

    def count(self, event: LineEvent) -> None:
        """One more event."""
        self.bytes += len(event.data)
        self.breaks += event.kind == "break"
        for fault in event.faults:
            self.framing += fault.fault is LineFault.FRAMING
            self.parity += fault.fault is LineFault.PARITY
            self.overruns += fault.fault is LineFault.OVERRUN


MOST_PASSED = 64 << 10
"""Bytes that may wait for the port that they are passed on to."""


class _Wire:
    """One port as drivers know engines: it never has a command. `other`: the wire that it passes everything on to."""

    deadline = NEVER

    def __init__(self, number: int, port: Port, way: Way, tell: Callable[[Heard], None]) -> None:
        self.number = number
        self.port = port
        self.counts = WireCounts()
        self.is_open = False
        self._way = way
        self._tell = tell
        self._free = 0
        self.other: _Wire | None = None
        self._waiting = 0

    def _event(self, event: LineEvent) -> list[Command]:
        """In a capture received bytes have the time of their last one, sent ones that of their first."""
        line = self.port.settings if self.port.has_bit_times else None
        duration = 0 if line is None else len(event.data) * line.character_time
        begin, end = max(event.at - duration, min(self._free, event.at)), event.at
        self._free = end
        if event.data and event.direction == "out":
            event = LineEvent("data", begin, "out", event.data, event.faults)
        self.counts.count(event)
        self._tell(Heard(self.number, event, begin, end))
        return []

    def opened(self, now: int) -> list[Command]:
        self.is_open = True
        return self._event(LineEvent("open", now))

    def closed(self, now: int, reason: str = "") -> list[Command]:
        if not self.is_open:  # it could not be opened again
            return []
        self.is_open = False
        self._waiting = 0
        return self._event(LineEvent("closed", now, reason=reason))

    def send(self, data: bytes) -> bool:
        """Sends what the other wire has heard; whether there is a place for it."""
        if not self.is_open or self._waiting >= MOST_PASSED:
            return False
        self._waiting += len(data)
        self.port.write(data)
        return True

    def receive(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> list[Command]:
        if self.other is not None and not self.other.send(data):
            self.counts.stuck += len(data)
        return self._event(LineEvent("data", now, self._way, data, tuple(faults)))

    def line_break(self, now: int) -> list[Command]:
        if self.other is not None and self.other.is_open:
            line = self.other.port.settings
            self.other.port.send_break(0 if line is None else 2 * line.character_time)
        return self._event(LineEvent("break", now, self._way))

    def control(self, lines: Mapping[str, bool], now: int) -> list[Command]:
        return self._event(LineEvent("control", now, self._way, lines=dict(lines)))

    def hear_marks(self) -> None:
        """Marks come with the characters."""

    def other_sender(self, now: int) -> list[Command]:
        return []

    def sent(self, now: int) -> list[Command]:
        self._waiting = 0
        return []

    def tick(self, now: int) -> list[Command]:
        return []


class Recorder:
    """Records one port, or two that hear the two directions of one line. A lost port is opened again.

    It sends nothing. But `through` stands between two: what comes at one leaves at the other.

    `show` is told of everything, `on_state` of a port's number and how it is doing. In the capture the bytes of the
    first port are received ones, those of the second sent ones. `problems`: what the file lacks, known after `stop`.
    """

    def __init__(
        self,
        ports: Sequence[Port],
        clock: Clock,
        capture: Capture | None,
        show: Callable[[Heard], None],
        on_state: Callable[[int, str], None] = lambda number, state: None,
        *,
        through: bool = False,
    ) -> None:
        self.clock = clock
        self.problems: list[str] = []
        self._capture = capture
        self._show = show
        self._missing = False
        self.wires = [_Wire(number, port, WAYS[number], self._heard) for number, port in enumerate(ports)]
        if through:
            first, second = self.wires
            first.other, second.other = second, first
        self._drivers = [
            Driver(wire, wire.port, clock, lambda state, number=wire.number: on_state(number, state))  # type: ignore[misc]
            for wire in self.wires
        ]

    @classmethod
    def at(
        cls, urls: Sequence[str], path: Path | None, show: Callable[[Heard], None], *, line: LineFormat,
        on_state: Callable[[int, str], None], through: bool = False,
    ) -> Recorder:  # fmt: skip
        """A recorder of one or two ports, in the running loop. Raises RequestError; OSError if there can be no file."""
        clock = clock_of_loop()
        if len(set(urls)) < len(urls):
            raise RequestError(f"'{urls[0]}' is named twice – name the port that hears the other direction")
        if through and len(urls) < len(WAYS):
            raise RequestError("--through stands between two ports – name the second one")
        if len(urls) > len(WAYS):
            raise RequestError(f"{len(urls)} ports are too many – a line has two directions")
        try:
            ports = [open_port(url, line, clock, listen_only=not through) for url in urls]
        except ValueError as error:
            raise RequestError(str(error)) from None
        capture = None if path is None else Capture(path, (1,), clock, later=True)
        return cls(ports, clock, capture, show, on_state, through=through)

    @property
    def loads(self) -> list[LineLoad]:
        """How busy each wire is."""
        return [driver.load for driver in self._drivers]

    def start(self) -> None:
        """Opens the ports."""
        for driver in self._drivers:
            driver.start()

    def stop(self) -> None:
        """Closes the ports, and the file when all is in it."""
        for driver, wire in zip(self._drivers, self.wires, strict=True):
            driver.stop()
            wire.closed(self.clock.now())
        if self._capture is not None:
            if self._missing:
                self._tell_missing(wait=True)
            self._capture.close()
            self.problems = self._capture.troubles
        self.problems += [
            f"{plural(wire.counts.stuck, 'byte')} from {wire.port.name} not passed on: the other port is closed or slow"
            for wire in self.wires
            if wire.counts.stuck
        ]
        missing = sum(wire.counts.missing for wire in self.wires)
        if missing:
            self.problems.append(
                f"{plural(missing, 'byte')} are not in the file: it could not be written as fast as they came"
            )

    def _heard(self, heard: Heard) -> None:
        if self._capture is not None:
            self._keep(self._capture, heard)
        self._show(heard)

    def _keep(self, capture: Capture, heard: Heard) -> None:
        """Where a slow disk has left something out the file says so: as if the line was closed and opened there."""
        if self._missing and not self._tell_missing():
            self.wires[heard.wire].counts.missing += len(heard.event.data)
        elif not capture.write(1, heard.event):
            self._missing = True
            self.wires[heard.wire].counts.missing += len(heard.event.data)

    def _tell_missing(self, *, wait: bool = False) -> bool:
        assert self._capture is not None
        gap = LineEvent("closed", self.clock.now(), reason="bytes are missing here: the file was written too slowly")
        if not self._capture.write(1, gap, wait=wait):
            return False
        self._missing = not self._capture.write(1, LineEvent("open", gap.at), wait=wait)
        return not self._missing
