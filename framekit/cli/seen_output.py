"""What goes over a line, one line each: as text for people, with hex or ASCII, or as data for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from framekit.cli.common import spaced

if TYPE_CHECKING:
    from framekit.codec.plain import PlainValues
    from framekit.link.observe import Seen

LONGEST_SHOWN = 64
"""Bytes of a frame that a line shows."""


def what_was_seen(seen: Seen) -> str:
    """The frame's name, of a bad one with the reason and where the fault is; or what else happened."""
    if seen.kind == "bad":
        segment = f", {seen.segment}" if seen.segment else ""
        return f"bad {seen.frame}".rstrip() + f" ({seen.reason} at byte {seen.place}{segment})"
    if seen.kind in ("open", "closed", "trouble", "not_taken"):
        return f"{seen.kind.replace('_', ' ')} {seen.reason}".rstrip()
    return seen.frame or seen.kind


def shown_bytes(data: bytes, as_ascii: bool = False, longest: int = LONGEST_SHOWN) -> str:
    """The bytes as hex pairs or as ASCII, no more than `longest` of them."""
    from framekit.service.frame_log import ascii_of

    cut = " …" if len(data) > longest else ""
    return (ascii_of(data[:longest]) if as_ascii else spaced(data[:longest])) + cut


def seen_text(seen: Seen, time: float | str, where: str, as_ascii: bool = False) -> str:
    """Time (seconds, or a text), where it was seen, direction, frame, size and bytes."""
    arrow = {"in": "←", "out": "→"}.get(seen.direction, " ")
    size = f"{len(seen.raw):4d} " if seen.raw else "     "
    place = f"{where} " if where else ""
    told = time if isinstance(time, str) else f"{time:10.3f}"
    return f"{told}  {place}{arrow} {what_was_seen(seen):<22}{size}{shown_bytes(seen.raw, as_ascii)}".rstrip()


def seen_data(seen: Seen, seconds: float, plain: PlainValues, **more: Any) -> dict[str, Any]:
    """The same with the frame's fields, and without what is empty; `more` stands behind the time."""
    line = {
        "event": seen.kind,
        "time": seconds,
        **more,
        "direction": seen.direction,
        "frame": seen.frame,
        "size": len(seen.raw) or "",
        "bytes": spaced(seen.raw),
        "fields": plain.to_plain(seen.frame, seen.fields),
        "reason": seen.reason,
        "repeated": seen.repeated or "",
    }
    if seen.kind == "bad":
        line |= {"segment": seen.segment, "offset": seen.place}
    return {key: value for key, value in line.items() if value not in ("", {})}
