"""Captures as JSON lines: one object for each thing that happened on a line, after one that says what the file is.

Times are whole nanoseconds since 1970 (`time_ns`), bytes hex pairs. Nothing is lost between writing and reading.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

from framekit.codec.shown import explain
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.port import LineEvent

HEADER = {"capture": "framekit", "version": 1}


class JsonCaptureError(ValueError):
    """The file holds no capture."""


def header_line() -> bytes:
    """What a file begins with."""
    return _line(HEADER)


def event_line(channel: int, event: LineEvent, epoch: int) -> bytes:
    """One event; `epoch` (ns) is added to its time."""
    line: dict[str, Any] = {"time_ns": event.at + epoch, "channel": channel, "event": event.kind}
    if event.direction:
        line["direction"] = event.direction
    if event.data:
        line["bytes"] = event.data.hex(" ").upper()
    if event.faults:
        line["faults"] = [[fault.index, fault.fault.value] for fault in event.faults]
    if event.lines:
        line["lines"] = dict(event.lines)
    if event.reason:
        line["reason"] = event.reason
    return _line(line)


def _line(value: Any) -> bytes:
    return json.dumps(value, ensure_ascii=False).encode("utf-8") + b"\n"


class JsonReader:
    """The events of a file with their channels. `is_cut`: the last line is not whole (its writer was killed)."""

    def __init__(self, lines: Iterable[bytes]) -> None:
        """Raises JsonCaptureError."""
        self.is_cut = False
        self._lines = iter(lines)
        try:
            head = json.loads(next(self._lines, b""))
        except ValueError:
            head = None
        if not isinstance(head, dict) or head.get("capture") != HEADER["capture"]:
            raise JsonCaptureError('this is no capture – its first line is not {"capture": "framekit", …}')
        if head.get("version") != HEADER["version"]:
            raise JsonCaptureError(f"this capture is of version {head.get('version')}, known is {HEADER['version']}")

    def events(self) -> Iterator[tuple[int, LineEvent]]:
        """In the order of the file. Raises JsonCaptureError for a line that is no event."""
        for number, text in enumerate(self._lines, 2):
            if not text.endswith(b"\n"):
                self.is_cut = True
                return
            try:
                yield _event(json.loads(text))
            except (ValueError, TypeError, KeyError, AttributeError, IndexError) as error:
                raise JsonCaptureError(f"line {number} is no event of a capture ({explain(error)})") from None


def _event(line: dict[str, Any]) -> tuple[int, LineEvent]:
    kind, direction = line["event"], line.get("direction", "")
    if kind not in ("data", "break", "control", "open", "closed") or direction not in ("in", "out", ""):
        raise ValueError(f"{kind} {direction}")
    faults = tuple(CharacterFault(int(index), LineFault(fault)) for index, fault in line.get("faults", ()))
    data = bytes.fromhex(line.get("bytes", ""))
    event = LineEvent(
        kind, int(line["time_ns"]), direction, data, faults, dict(line.get("lines", {})), line.get("reason", "")
    )
    return int(line["channel"]), event
