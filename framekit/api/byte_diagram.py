"""The bytes of a frame as a picture (SVG): a box for each segment, as manuals draw them.

Shades tell constants, lengths and counts, check codes, and what may be absent (a dashed frame). Text of a definition
only ever stands in text elements, escaped.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal
from xml.sax.saxutils import escape

Shade = Literal["constant", "size", "check", "value", "inside"]

_BYTE = 34
_LEAST, _MOST = 58, 190
_LETTER = 6.6
_ROW = 74
_WIDE = 860
_LONGEST = 26
_FILLS: dict[Shade, str] = {
    "constant": "#e4e7eb", "size": "#d8e6f8", "check": "#dcefd8", "value": "#ffffff", "inside": "#fdf3d7",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Box:
    """One segment: its name, what stands below it (the type or the bytes), its size in words, and its shade.

    `bytes_`: its size where that is always the same. `optional`: it may be absent.
    """

    name: str
    below: str
    size: str
    bytes_: int | None
    shade: Shade
    optional: bool = False

    @property
    def width(self) -> float:
        """Pixels: by the size, and so that the texts have room."""
        room = 16 + _LETTER * max(len(_cut(self.name)), len(_cut(self.below)), len(self.size))
        return min(max(_LEAST, _BYTE * (self.bytes_ or 3), room), max(_MOST, room))


def byte_diagram(title: str, boxes: Iterable[Box]) -> str:
    """The picture of a frame, at most 860 pixels wide; long frames have several rows."""
    places: list[tuple[float, int, Box]] = []
    across, row, widest = 0.0, 0, 0.0
    for box in boxes:
        if across and across + box.width > _WIDE:
            across, row = 0.0, row + 1
        places.append((across, row, box))
        across += box.width
        widest = max(widest, across)
    height = (row + 1) * _ROW
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-1 -1 {widest + 2:.0f} {height + 2}" '
        f'width="{widest + 2:.0f}" height="{height + 2}" role="img" font-family="sans-serif" font-size="12">',
        f"<title>{_text(title)}</title>",
        *(_drawn(left, _ROW * line, box) for left, line, box in places),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _drawn(left: float, top: int, box: Box) -> str:
    middle, dash = left + box.width / 2, ' stroke-dasharray="4 3"' if box.optional else ""
    texts = ((18, "12", "#1b1f24", _cut(box.name)), (36, "11", "#57606a", _cut(box.below)))
    written = "".join(
        f'<text x="{middle:.1f}" y="{top + down}" text-anchor="middle" font-size="{size}" fill="{fill}">'
        f"{_text(text)}</text>"
        for down, size, fill, text in (*texts, (60, "10", "#57606a", box.size))
    )
    return (
        f'<rect x="{left:.1f}" y="{top}" width="{box.width:.1f}" height="46" fill="{_FILLS[box.shade]}" '
        f'stroke="#57606a"{dash}/>{written}'
    )


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


def _text(text: str) -> str:
    return escape("".join(sign if sign.isprintable() else "�" for sign in text))
