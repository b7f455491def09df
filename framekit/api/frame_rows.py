"""What was seen on a line, as rows of text: its frame or fault, its bytes, its fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # every verb imports this
    from framekit.link.events import Seen

FAULTY = ("bad", "noise", "trouble")
LONGEST_SHOWN = 64
"""Bytes of a frame that a line shows."""
LONGEST_CELL = 48
FRAME_HEAD = ("no.", "time", "ch", "", "size", "result", "frame", "bytes")
FIELD_HEAD = ("field", "offset", "bytes", "value")


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """One thing seen. `number` counts all of them from 1."""

    number: int
    channel: int
    seen: Seen
    result: str


@dataclass(frozen=True, slots=True)
class FieldRow:
    """One field of a frame: its path, where it stands and what it says."""

    path: str
    offset: int
    data: bytes
    value: str


def spaced(data: bytes) -> str:
    """Upper-case hex pairs."""
    return data.hex(" ").upper()


def ascii_of(data: bytes) -> str:
    """Printable characters as they are, others as a dot."""
    return "".join(chr(byte) if 32 <= byte < 127 else "·" for byte in data)


def shown_bytes(data: bytes, as_ascii: bool = False, longest: int = LONGEST_SHOWN) -> str:
    """The bytes as hex pairs or as ASCII, no more than `longest` of them."""
    cut = " …" if len(data) > longest else ""
    return (ascii_of(data[:longest]) if as_ascii else spaced(data[:longest])) + cut


def what_was_seen(seen: Seen) -> str:
    """The frame's name, of a bad one with the reason and where the fault is; or what else happened."""
    if seen.kind == "bad":
        segment = f", {seen.segment}" if seen.segment else ""
        return f"bad {seen.frame}".rstrip() + f" ({seen.reason} at byte {seen.place}{segment})"
    if seen.kind in ("line", "open", "closed", "trouble", "not_taken"):
        return f"{seen.kind.replace('_', ' ')} {seen.reason}".rstrip()
    return seen.frame or seen.kind


def frame_row(entry: FrameEntry, seconds: float, as_ascii: bool = False) -> tuple[str, ...]:
    """One thing seen, `seconds` after the beginning; a bad one is marked."""
    seen = entry.seen
    arrow = {"in": "←", "out": "→"}.get(seen.direction, "")
    mark = "! " if seen.kind in FAULTY else ""
    size = str(len(seen.raw)) if seen.raw else ""
    return (
        str(entry.number), f"{seconds:.3f}", str(entry.channel), arrow, size, entry.result,
        mark + what_was_seen(seen), shown_bytes(seen.raw, as_ascii, LONGEST_CELL),
    )  # fmt: skip


def field_row(row: FieldRow, as_ascii: bool = False) -> tuple[str, ...]:
    """One field of a frame."""
    return row.path, str(row.offset), shown_bytes(row.data, as_ascii, LONGEST_CELL), row.value
