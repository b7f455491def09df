"""What goes over a line, one line each: as text for people, or as data for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from framekit.cli.common import spaced

if TYPE_CHECKING:
    from framekit.codec.plain import PlainValues
    from framekit.link.observe import Seen

LONGEST_SHOWN = 64
"""Bytes of a frame that a line shows."""


def seen_text(seen: Seen, seconds: float, where: str) -> str:
    """Time, where it was seen, direction, frame, size and bytes."""
    arrow = {"in": "←", "out": "→"}.get(seen.direction, " ")
    what = seen.frame or seen.kind
    if seen.kind == "bad":
        what = f"bad {seen.frame}".rstrip() + f" ({seen.reason})"
    elif seen.kind in ("open", "closed", "trouble", "not_taken"):
        what = f"{seen.kind.replace('_', ' ')} {seen.reason}".rstrip()
    cut = " …" if len(seen.raw) > LONGEST_SHOWN else ""
    size = f"{len(seen.raw):4d} " if seen.raw else "     "
    place = f"{where} " if where else ""
    return f"{seconds:10.3f}  {place}{arrow} {what:<22}{size}{spaced(seen.raw[:LONGEST_SHOWN])}{cut}".rstrip()


def seen_data(seen: Seen, seconds: float, plain: PlainValues, **where: Any) -> dict[str, Any]:
    """The same with the frame's fields, and without what is empty."""
    line = {
        "event": seen.kind,
        "time": seconds,
        **where,
        "direction": seen.direction,
        "frame": seen.frame,
        "bytes": spaced(seen.raw),
        "fields": plain.to_plain(seen.frame, seen.fields),
        "reason": seen.reason,
    }
    return {key: value for key, value in line.items() if value not in ("", {})}
