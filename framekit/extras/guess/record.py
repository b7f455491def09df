"""Recordings of unknown lines: bytes, times, damage and breaks, stored and shown."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framekit.api.errors import RequestError
from framekit.api.rows import ascii_of, spaced
from framekit.definition.problems import plural
from framekit.definition.times import NEVER, LineFormat, readable_time
from framekit.link.events import CharacterFault, Command, LineFault
from framekit.run.trouble import TroubleReport
from framekit.service.capture import Capture
from framekit.service.driver import Driver, LineLoad
from framekit.transport.clock import AsyncioClock, Clock
from framekit.transport.port import LineEvent, Port, Way
from framekit.transport.schemes import open_port


def clock_of_loop() -> Clock:
    """Return a clock on the running loop."""
    return AsyncioClock(asyncio.get_running_loop())


WAYS: tuple[Way, Way] = ("in", "out")
"""Directions in a recording of the bytes of its first port, and of its second."""


@dataclass(frozen=True, slots=True)
class Heard:
    """An event on a wire (0: that of the first port).

    `begin`, `end`: times of its characters (ns); equal if they take no time.
    """

    wire: int
    event: LineEvent
    begin: int
    end: int


@dataclass(slots=True)
class WireCounts:
    """Counters of one wire."""

    bytes: int = 0
    framing: int = 0
    parity: int = 0
    overruns: int = 0
    breaks: int = 0
    missing: int = 0
    """Bytes that are missing in the file."""
    stuck: int = 0
    """Bytes that were not passed on."""

    def count(self, event: LineEvent) -> None:
        """Count an event."""
        self.bytes += len(event.data)
        self.breaks += event.kind == "break"
        for fault in event.faults:
            self.framing += fault.fault is LineFault.FRAMING
            self.parity += fault.fault is LineFault.PARITY
            self.overruns += fault.fault is LineFault.OVERRUN


MOST_PASSED = 64 << 10
"""Largest number of bytes that wait for the port to which they are passed on."""


class _Wire:
    """A port with the interface of an engine for drivers; it never has a command.

    `other`: the wire that it forwards everything to.
    """

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
        """Report an event: in a capture received bytes have the time of their last, sent bytes that of their first."""
        line = self.port.settings if self.port.has_bit_times else None
        duration = 0 if line is None else len(event.data) * line.character_time
        begin, end = max(event.at - duration, min(self._free, event.at)), event.at
        self._free = end
        if event.data and event.direction == "out":
            event = LineEvent("data", begin, "out", event.data, event.faults)
        self.counts.count(event)
        self._tell(Heard(self.number, event, begin, end))
        return []

    @property
    def good_frames(self) -> int:
        return self.counts.bytes

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
        """Send the bytes of the other wire; return whether there was room for them."""
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
        """Note that characters carry marks."""

    def hear_late(self) -> None:
        """Note that the times are those of reading."""

    def other_sender(self, now: int) -> list[Command]:
        return []

    def sent(self, now: int) -> list[Command]:
        self._waiting = 0
        return []

    def tick(self, now: int) -> list[Command]:
        return []


class Recorder:
    """Records one port, or two that receive the two directions of one line. A lost port is opened again.

    It sends no data, except with `through`: then it forwards the bytes of each port to the other.

    `show` gets every event, `on_state` the number and the state of a port. In the capture the bytes of the first port
    are received ones, those of the second sent ones. `problems`: data missing in the file, known after `stop`.
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
        """Return a recorder of one or two ports, in the running loop.

        Raises RequestError; OSError if the file cannot be created.
        """
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
        """Return the load of each wire."""
        return [driver.load for driver in self._drivers]

    def watch_troubles(self, listener: Callable[[TroubleReport], None]) -> None:
        """Call `listener` when the file cannot be written, at once, in the thread that writes it."""
        if self._capture is not None:
            self._capture.troubles.listen(listener)

    def start(self) -> None:
        """Open the ports."""
        for driver in self._drivers:
            driver.start()

    def stop(self) -> None:
        """Close the ports, and the file once it is complete."""
        for driver, wire in zip(self._drivers, self.wires, strict=True):
            driver.stop()
            wire.closed(self.clock.now())
        if self._capture is not None:
            if self._missing:
                self._tell_missing(wait=True)
            self._capture.close()
            self.problems = self._capture.problems
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
        """Write an event; a gap caused by a slow disk is marked as if the line was closed and opened there."""
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


# ---- as rows of text, with the pauses between them and the damage that was seen -------------------------------


WIDTH = 16
"""Number of bytes of a row."""
ARROWS = ("←", "→")
MARKS = {LineFault.FRAMING: "!", LineFault.PARITY: "?", LineFault.OVERRUN: "+", LineFault.MARK: "'"}
"""Marks after a damaged or marked character."""
LEGEND = "behind a character: ! framing error, ? parity error, + characters lost before it, ' ninth bit set"
SHORTEST_PAUSE = 5_000_000
PAUSE_WITHOUT_SPEED = 20_000_000
PAUSE_CHARACTERS = 5


def usual_pause(line: LineFormat | None) -> int:
    """Return the pause (ns) from which bytes begin a new row: shorter pauses are often made by the operating system."""
    if line is None:
        return PAUSE_WITHOUT_SPEED
    return max(SHORTEST_PAUSE, PAUSE_CHARACTERS * line.character_time)


class ByteRows:
    """Makes rows of received bytes; a row ends after a `pause` (ns), when it is full, and when the direction changes.

    `deadline`: when the present row ends without further bytes. Times are shown in seconds since `began`.
    """

    def __init__(self, began: int, pause: int) -> None:
        self.deadline = NEVER
        self._began = began
        self._pause = pause
        self._last: int | None = None
        self._wire = 0
        self._row: list[tuple[int, str]] = []
        self._head = ""

    def add(self, heard: Heard) -> list[str]:
        """Add an event and return the rows that are complete now."""
        event = heard.event
        if event.kind == "data":
            return self._add_bytes(heard)
        rows = self.end_row()
        words = {"open": "open", "closed": f"closed {event.reason}".rstrip(), "break": "break"}
        lines = ", ".join(f"{name} {'on' if on else 'off'}" for name, on in event.lines.items())
        rows.append(f"{self._times(heard.begin)}  {ARROWS[heard.wire]} {words.get(event.kind, lines)}")
        self._last = heard.end if event.kind == "break" else self._last
        return rows

    def _add_bytes(self, heard: Heard) -> list[str]:
        rows: list[str] = []
        event = heard.event
        pause = self._pause_before(heard.begin)
        if self._row and (pause or heard.wire != self._wire):
            rows += self.end_row()
        marks = {fault.index: MARKS[fault.fault] for fault in event.faults}
        duration = heard.end - heard.begin
        for index, byte in enumerate(event.data):
            if len(self._row) == WIDTH:
                rows += self.end_row()
            if not self._row:
                at = heard.begin + duration * index // len(event.data)
                self._wire = heard.wire
                self._head = f"{self._times(at, is_first=index == 0)}  {ARROWS[heard.wire]}"
            self._row.append((byte, marks.get(index, " ")))
        self._last = heard.end
        self.deadline = heard.end + self._pause
        return rows

    def end_row(self) -> list[str]:
        """Return the present row, if any, and end it."""
        self.deadline = NEVER
        if not self._row:
            return []
        row, self._row = self._row, []
        shown = "".join(f"{byte:02X}{mark}" for byte, mark in row)
        return [f"{self._head} {shown:<{3 * WIDTH}} {ascii_of(bytes(byte for byte, _ in row))}"]

    def _pause_before(self, begin: int) -> int:
        """Return the pause before an event at `begin` if it is long enough to be shown (ns), else 0."""
        pause = 0 if self._last is None else begin - self._last
        return pause if pause >= self._pause else 0

    def _times(self, at: int, *, is_first: bool = True) -> str:
        pause = self._pause_before(at) if is_first else 0
        shown = readable_time(round(pause, -5)) if pause else ""
        return f"{(at - self._began) / 1e9:10.3f} {shown:>10}"


def heard_data(heard: Heard, began: int) -> dict[str, Any]:
    """Return an event for programs, without empty values.

    `time`: seconds from `began` until the last byte was complete.
    """
    event = heard.event
    line = {
        "event": event.kind,
        "time": round((heard.end - began) / 1e9, 6),
        "direction": event.direction,
        "size": len(event.data) or "",
        "bytes": spaced(event.data),
        "faults": [[fault.index, fault.fault.value] for fault in event.faults],
        "lines": dict(event.lines),
        "reason": event.reason,
    }
    return {key: value for key, value in line.items() if value not in ("", {}, [])}


class ByteView:
    """Shows events: as `rows`, or without them as an object a line, in seconds since `began`; `show` gets each line."""

    def __init__(self, clock: Clock, began: int, rows: ByteRows | None, show: Callable[[str], object]) -> None:
        self._began = began
        self._rows = rows
        self._show = show
        self._alarm = clock.alarm(self._ring)

    def show(self, heard: Heard) -> None:
        """Show an event."""
        if self._rows is None:
            self._show(json.dumps(heard_data(heard, self._began), ensure_ascii=False))
        else:
            self._show_rows(self._rows.add(heard))
            self._alarm.set(self._rows.deadline)

    def _ring(self) -> None:
        if self._rows is not None:
            self._show_rows(self._rows.end_row())

    def _show_rows(self, rows: list[str]) -> None:
        for row in rows:
            self._show(row)

    def close(self) -> None:
        """Show the unfinished row."""
        self._ring()
        self._alarm.cancel()
