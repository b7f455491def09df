"""Rows of text for the events of a line and for the status of a run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from framekit.codec.shown import code_text, shown
from framekit.definition.problems import plural, printable
from framekit.definition.times import format_time
from framekit.run.trouble import lasted

if TYPE_CHECKING:
    from framekit.api.points import RunPoints
    from framekit.link.events import Seen
    from framekit.run.block_state import BlockStatus
    from framekit.run.edit import RemovedBlocks
    from framekit.run.status import ChannelStatus, JobStatus, SinkStatus, StationStatus
    from framekit.run.trouble import Trouble

FAULTY = ("bad", "noise", "trouble")
LONGEST_SHOWN = 64
"""Maximum number of bytes of a frame in a line."""
LONGEST_CELL = 48
FRAME_HEAD = ("no.", "time", "ch", "", "size", "result", "frame", "bytes")
FIELD_HEAD = ("field", "offset", "bytes", "value")


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """An event of a line. `number` counts all events from 1."""

    number: int
    channel: int
    seen: Seen
    result: str


@dataclass(frozen=True, slots=True)
class FieldRow:
    """One field of a frame: path, offset, bytes and value."""

    path: str
    offset: int
    data: bytes
    value: str


def spaced(data: bytes) -> str:
    """Return the bytes as upper-case hex pairs."""
    return data.hex(" ").upper()


def ascii_of(data: bytes) -> str:
    """Return the bytes as ASCII, with a dot for each unprintable character."""
    return "".join(chr(byte) if 32 <= byte < 127 else "·" for byte in data)


def shown_hex(data: bytes) -> str:
    """Return upper-case hex pairs of at most `LONGEST_SHOWN` bytes."""
    if len(data) > LONGEST_SHOWN:
        return f"{data[:LONGEST_SHOWN].hex(' ').upper()} …"
    return data.hex(" ").upper()


def shown_bytes(data: bytes, as_ascii: bool = False, longest: int = LONGEST_SHOWN) -> str:
    """Return at most `longest` bytes as hex pairs or as ASCII."""
    if len(data) > longest:
        return f"{shown_bytes(data[:longest], as_ascii)} …"
    return ascii_of(data) if as_ascii else spaced(data)


LONGEST_VALUE = 40
"""Maximum number of characters of a value in a line of fields."""


def inner_frame(value: Any) -> tuple[str, dict[str, Any]] | None:
    """Return the name and the fields of an inner frame, `{name: {field: value}}`; None for any other value."""
    name, fields = next(iter(value.items())) if isinstance(value, dict) and len(value) == 1 else ("", None)
    return (name, fields) if isinstance(fields, dict) else None


def inner_names(fields: Mapping[str, Any]) -> list[str]:
    """Return the names of the frames inside a frame, outer frames first."""
    found: list[str] = []
    for value in fields.values():
        if (inner := inner_frame(value)) is not None:
            found += [inner[0], *inner_names(inner[1])]
    return found


def fields_text(fields: Mapping[str, Any], named: bool = True) -> str:
    """Return the fields of a frame in one line, `station=1 read_holding address=0 count=2`.

    `named`: with the names of inner frames.
    """
    words = []
    for name, value in fields.items():
        inner = inner_frame(value)
        if inner is not None:
            words.append(f"{inner[0] if named else ''} {fields_text(inner[1], named)}".strip())
            continue
        text = json.dumps(value, ensure_ascii=False) if isinstance(value, (dict, list)) else str(value)
        text = text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]} …"
        words.append(f"{name}={text!r}" if " " in text and not isinstance(value, (dict, list)) else f"{name}={text}")
    return printable(" ".join(filter(None, words)))


def what_was_seen(seen: Seen) -> str:
    """Return the name of a frame, with reason and place if it is bad, or the description of another event."""
    if seen.kind == "bad":
        segment = f", {seen.segment}" if seen.segment else ""
        return f"bad {seen.frame}".rstrip() + f" ({seen.reason} at byte {seen.place}{segment})"
    if seen.kind in ("line", "open", "closed", "trouble", "not_taken"):
        return f"{seen.kind.replace('_', ' ')} {seen.reason}".rstrip()
    return seen.frame or seen.kind


def meaning_of(seen: Seen) -> str:
    """Return the name of the innermost frame of a good frame, such as the PDU in an ADU; else as `what_was_seen`."""
    names = inner_names(seen.fields) if seen.kind == "frame" else []
    return names[-1] if names else what_was_seen(seen)


def frame_row(entry: FrameEntry, seconds: float, as_ascii: bool = False) -> tuple[str, ...]:
    """Return the row of an event, `seconds` after the start; a faulty event is marked."""
    seen = entry.seen
    arrow = {"in": "←", "out": "→"}.get(seen.direction, "")
    mark = "! " if seen.kind in FAULTY else ""
    size = str(len(seen.raw)) if seen.raw else ""
    return (
        str(entry.number), f"{seconds:.3f}", str(entry.channel), arrow, size, entry.result,
        mark + what_was_seen(seen), shown_bytes(seen.raw, as_ascii, LONGEST_CELL),
    )  # fmt: skip


def field_row(row: FieldRow, as_ascii: bool = False) -> tuple[str, ...]:
    """Return the row of a field of a frame."""
    return row.path, str(row.offset), shown_bytes(row.data, as_ascii, LONGEST_CELL), row.value


SINK_HEAD = ("sink", "to", "taken", "waiting", "dropped", "problem")
TROUBLE_HEAD = ("trouble", "since", "waiting", "lost", "reason")
CHANNEL_HEAD = (
    "channel", "driver", "station", "line", "mode", "state", "services", "errors", "frames", "bad", "line load", "why",
)  # fmt: skip
JOB_HEAD = ("job", "what", "host", "state", "every", "left", "good", "refused", "late", "broken off", "last")
BLOCK_HEAD = ("set", "block", "what", "channel", "state", "done", "failed", "overruns", "last failure")
STATION_HEAD = ("channel", "station", "state", "blocks", "done", "failed")
POINT_HEAD = ("point", "value", "unit", "quality")


def percent(part: float) -> str:
    return f"{100 * part:.1f} %"


def channel_row(one: ChannelStatus) -> tuple[str, ...]:
    driver = one.driver if one.role is None else f"{one.driver} {one.role}"
    line = f"{one.line} {one.line_type}".strip() or "-"
    why = ", ".join(f"{count} × {reason}" for reason, count in sorted(one.reasons.items()))
    return (
        str(one.number), driver, "-" if one.station is None else str(one.station), line, one.mode, one.state,
        str(one.services), str(one.errors), str(one.frames_in), str(one.bad),
        "-" if one.load is None else percent(one.load), why or "-",
    )  # fmt: skip


def block_state(one: BlockStatus) -> str:
    """Return a word for the state of a block: off, runs, dead (its station does not answer), waits, ready."""
    if not one.enabled:
        return "off"
    if one.running:
        return "runs"
    if one.dead:
        return "dead"
    return "waits" if one.waiting else "ready"


def block_row(one: BlockStatus) -> tuple[str, ...]:
    what = f"{one.instruction} {one.name}".rstrip()
    return (
        str(one.set), str(one.block), what, str(one.channel), block_state(one), str(one.done), str(one.failed),
        str(one.overruns), "-" if one.last_failure is None else str(one.last_failure),
    )  # fmt: skip


def removed_row(one: RemovedBlocks) -> tuple[str, ...]:
    """Return the row of blocks that an edit has removed."""
    why = ", ".join(f"{count} × {reason}" for reason, count in sorted(one.reasons.items()))
    return (
        "-", "-", plural(one.blocks, "removed block"), str(one.channel), "gone", str(one.done), str(one.failed),
        str(one.overruns), why or "-",
    )  # fmt: skip


def job_row(one: JobStatus) -> tuple[str, ...]:
    """Return the row of a slot, with its present or last job."""
    every = "-" if not one.period else format_time(one.period)
    left = "-" if one.left is None else str(one.left)
    counters = one.counters
    return (
        str(one.slot), f"{one.kind} {one.remote or one.own}", one.host or "-", one.state, every, left,
        str(counters.good), str(counters.refused), str(counters.late + counters.over_period), str(counters.ended),
        f"{code_text(one.word)} {one.text}".rstrip(),
    )  # fmt: skip


def sink_row(one: SinkStatus) -> tuple[str, ...]:
    return one.kind, one.target, str(one.written), str(one.waiting), str(one.dropped), one.problem or "-"


def trouble_row(one: Trouble, now: int) -> tuple[str, ...]:
    """Return the row of a part that fails, with the duration, or that has lost data."""
    since = lasted(now - one.since) if one.reason else "-"
    return one.name, since, str(one.waiting), one.loss or "-", one.reason or "works again"


def station_row(one: StationStatus) -> tuple[str, ...]:
    state = "dead" if one.dead else "answers" if one.answers else "no answer" if one.failed else "-"
    return str(one.channel), str(shown(one.station)), state, str(one.blocks), str(one.done), str(one.failed)


def point_rows(points: RunPoints) -> list[tuple[str, ...]]:
    """Return the rows of the points at this moment: value, unit, quality."""
    rows: list[tuple[str, ...]] = []
    for value in points.now():
        point, quality = points[value.name], value.quality + (f", {value.reason}" if value.reason else "")
        rows.append((value.name, point.text_of(value.value), point.unit, quality))
    return rows
