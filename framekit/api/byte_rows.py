"""Bytes of a line as rows of text, in hex and ASCII, with the pauses between them and the damage that was seen."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from framekit.api.frame_rows import ascii_of, spaced
from framekit.api.record import Heard
from framekit.definition.problems import plural
from framekit.definition.times import NEVER, LineFormat, readable_time
from framekit.link.events import LineFault
from framekit.service.behind import Behind
from framekit.transport.clock import Clock

WIDTH = 16
"""Bytes of a row."""
ARROWS = ("←", "→")
MARKS = {LineFault.FRAMING: "!", LineFault.PARITY: "?", LineFault.OVERRUN: "+", LineFault.MARK: "'"}
"""What stands behind a damaged or marked character."""
LEGEND = "behind a character: ! framing error, ? parity error, + characters lost before it, ' ninth bit set"
SHORTEST_PAUSE = 5_000_000
PAUSE_WITHOUT_SPEED = 20_000_000
PAUSE_CHARACTERS = 5


def usual_pause(line: LineFormat | None) -> int:
    """From which pause on bytes stand in a new row (ns): shorter ones are often made by the operating system."""
    if line is None:
        return PAUSE_WITHOUT_SPEED
    return max(SHORTEST_PAUSE, PAUSE_CHARACTERS * line.character_time)


class ByteRows:
    """Makes rows of what is heard; a row ends after a `pause` (ns), when it is full, and where the direction changes.

    `deadline`: when the row under way ends if nothing comes. Times are shown in seconds since `began`.
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
        """The rows that are complete now."""
        event = heard.event
        if event.kind == "data":
            return self._add_bytes(heard)
        rows = self.end_row()
        told = {"open": "open", "closed": f"closed {event.reason}".rstrip(), "break": "break"}
        lines = ", ".join(f"{name} {'on' if on else 'off'}" for name, on in event.lines.items())
        rows.append(f"{self._times(heard.begin)}  {ARROWS[heard.wire]} {told.get(event.kind, lines)}")
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
        """The row under way, if there is one."""
        self.deadline = NEVER
        if not self._row:
            return []
        row, self._row = self._row, []
        shown = "".join(f"{byte:02X}{mark}" for byte, mark in row)
        return [f"{self._head} {shown:<{3 * WIDTH}} {ascii_of(bytes(byte for byte, _ in row))}"]

    def _pause_before(self, begin: int) -> int:
        """The pause before what begins then, if it is long enough to be shown (ns)."""
        pause = 0 if self._last is None else begin - self._last
        return pause if pause >= self._pause else 0

    def _times(self, at: int, *, is_first: bool = True) -> str:
        pause = self._pause_before(at) if is_first else 0
        told = readable_time(round(pause, -5)) if pause else ""
        return f"{(at - self._began) / 1e9:10.3f} {told:>10}"


def heard_data(heard: Heard, began: int) -> dict[str, Any]:
    """The same for programs, without what is empty. `time`: seconds from `began` until the last byte was complete."""
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


MOST_WAITING = 1 << 20
"""Bytes of rows that may wait for their reader."""


class ByteView:
    """Shows what is heard: as `rows`, or without them as an object a line, in seconds since `began`.

    `write` is called in a thread: a terminal that stands still, or a slow reader, holds up nothing; it misses rows,
    and is told so. `on_error` is told, in that thread, when nothing can be written any more; `error` is why.
    """

    def __init__(
        self,
        clock: Clock,
        began: int,
        rows: ByteRows | None,
        write: Callable[[bytes], object],
        on_error: Callable[[], object] = lambda: None,
        most: int = MOST_WAITING,
    ) -> None:
        self._began = began
        self._rows = rows
        self._left_out = 0
        self._behind = Behind(write, most, "shows bytes", on_error)
        self._alarm = clock.alarm(self._ring)

    @property
    def error(self) -> OSError | None:
        return self._behind.error

    def show(self, heard: Heard) -> None:
        """One thing heard."""
        if self._rows is None:
            self._tell([json.dumps(heard_data(heard, self._began), ensure_ascii=False)])
        else:
            self._tell(self._rows.add(heard))
            self._alarm.set(self._rows.deadline)

    def _ring(self) -> None:
        if self._rows is not None:
            self._tell(self._rows.end_row())

    def _tell(self, rows: list[str]) -> None:
        for row in rows:
            if self._left_out:
                missing = f"({plural(self._left_out, 'row')} left out: the reader is too slow)"
                if self._rows is None:
                    missing = json.dumps({"event": "left_out", "count": self._left_out})
                if not self._behind.write(f"{missing}\n".encode()):
                    self._left_out += 1
                    continue
                self._left_out = 0
            if not self._behind.write(f"{row}\n".encode()):
                self._left_out = 1

    def close(self) -> None:
        """Shows what is unfinished, and returns when all is shown."""
        self._ring()
        self._alarm.cancel()
        self._behind.close()
