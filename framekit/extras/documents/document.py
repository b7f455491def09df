"""The document of a protocol: its definition for readers – frames drawn, fields, services, sequences.

It is made from the model alone, so that it always agrees with the running protocol. It is written as Markdown, with a
picture for each frame, or as a single HTML page that needs no other file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Literal, NamedTuple

import framekit.codec.kinds  # noqa: F401 - it registers the kinds
from framekit.codec.python.registry import summary
from framekit.definition.kinds.base import Segments
from framekit.definition.model.frames import Frame, StaticSizes, parts_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Bits, Segment
from framekit.definition.model.values import FrameOf
from framekit.definition.problems import plural, visible
from framekit.definition.vectors import FrameVector, read_vectors
from framekit.definition.wire_types import ANY, NOTHING, Sizes
from framekit.extras.documents.diagrams import sequence_diagram

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
    """A segment in the picture: its name, the line below the name (type or bytes), its size in words, and its shade.

    `bytes_`: its size if constant. `optional`: whether it may be absent.
    """

    name: str
    below: str
    size: str
    bytes_: int | None
    shade: Shade
    optional: bool = False

    @property
    def width(self) -> float:
        """Return the width in pixels, from the size of the segment and the length of its texts."""
        room = 16 + _LETTER * max(len(_cut(self.name)), len(_cut(self.below)), len(self.size))
        return min(max(_LEAST, _BYTE * (self.bytes_ or 3), room), max(_MOST, room))


def byte_diagram(title: str, boxes: Iterable[Box]) -> str:
    """Return the picture of a frame, at most 860 pixels wide; long frames have several rows."""
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
        f"<title>{_svg_text(title)}</title>",
        *(_drawn(left, _ROW * line, box) for left, line, box in places),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _drawn(left: float, top: int, box: Box) -> str:
    middle, dash = left + box.width / 2, ' stroke-dasharray="4 3"' if box.optional else ""
    texts = ((18, "12", "#1b1f24", _cut(box.name)), (36, "11", "#57606a", _cut(box.below)))
    written = "".join(
        f'<text x="{middle:.1f}" y="{top + down}" text-anchor="middle" font-size="{size}" fill="{fill}">'
        f"{_svg_text(text)}</text>"
        for down, size, fill, text in (*texts, (60, "10", "#57606a", box.size))
    )
    return (
        f'<rect x="{left:.1f}" y="{top}" width="{box.width:.1f}" height="46" fill="{_FILLS[box.shade]}" '
        f'stroke="#57606a"{dash}/>{written}'
    )


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


def _svg_text(text: str) -> str:
    return escape("".join(sign if sign.isprintable() else "�" for sign in text), quote=False)


DEEPEST = 8
"""Largest depth of nested lists that is shown."""
_SENDERS = {"client": "from the client", "server": "from the device", "both": "from both sides", "none": "from no side"}


class Heading(NamedTuple):
    level: int
    text: str


class Paragraph(NamedTuple):
    text: str


class PageTable(NamedTuple):
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


class Picture(NamedTuple):
    """`name` is safe as the name of a file."""

    name: str
    title: str
    svg: str


class Listing(NamedTuple):
    """Literal text: bytes, or a diagram in Mermaid."""

    language: str
    text: str


Block = Heading | Paragraph | PageTable | Picture | Listing


@dataclass(frozen=True, slots=True)
class FieldLine:
    """A segment in the table of a frame; `depth`: number of lists that contain it."""

    offset: str
    size: str
    name: str
    what: str
    depth: int


@dataclass(frozen=True, slots=True)
class DrawnFrame:
    """A frame for a picture: its name, a sentence with its size and its sender, and its boxes."""

    name: str
    about: str
    boxes: tuple[Box, ...]


def drawn_frames(protocol: Protocol) -> Iterator[DrawnFrame]:
    """Yield the frames of a protocol as they are drawn."""
    writer = _Writer(protocol, {})
    return (writer.drawn(frame) for frame in protocol.frames.values())


def document(protocol: Protocol, vectors: Path | None = None) -> list[Block]:
    """Return the document of a protocol; `vectors`: its cases, from which examples are taken."""
    return list(_Writer(protocol, _examples(vectors)).blocks())


def _examples(path: Path | None) -> Mapping[str, FrameVector]:
    """Return the first good case of each frame."""
    found: dict[str, FrameVector] = {}
    vectors = None if path is None or not path.is_file() else read_vectors(path)[0]
    for case in () if vectors is None else vectors.frames:
        if case.frame is not None and case.expect is None:
            found.setdefault(case.frame, case)
    return found


class _Writer:
    def __init__(self, protocol: Protocol, examples: Mapping[str, FrameVector]) -> None:
        self.protocol, self.examples = protocol, examples
        self.sizes = StaticSizes(protocol.frames)

    def blocks(self) -> Iterator[Block]:
        protocol = self.protocol
        yield Heading(1, protocol.name)
        for text in (protocol.about, f"Source: {protocol.source}" if protocol.source else ""):
            if text:
                yield Paragraph(text)
        yield from self._settings()
        yield Heading(2, "Frames")
        for frame in protocol.frames.values():
            yield from self._frame(frame)
        yield from self._areas()
        yield from self._services()
        if protocol.sequences:
            yield Heading(2, "Sequences")
            for sequence in protocol.sequences.values():
                yield Heading(3, sequence.name)
                yield Listing("mermaid", sequence_diagram(sequence))

    def _settings(self) -> Iterator[Block]:
        rows = [
            (one.name, one.type, "" if one.secret else str(one.default or ""), one.doc)
            for one in self.protocol.params.values()
        ]
        if rows:
            yield Heading(2, "Parameters")
            yield PageTable(("parameter", "type", "default", "meaning"), rows)

    # ---- frames -------------------------------------------------------------------------------------------

    def drawn(self, frame: Frame) -> DrawnFrame:
        where = "inside of other frames" if frame.inner else _SENDERS[frame.side]
        about = f"{frame.doc.rstrip('.')}. " * bool(frame.doc) + f"{_bytes(self.sizes.frame(frame.name))}, {where}."
        return DrawnFrame(frame.name, about, tuple(self._boxes(self.sizes.segments(frame))))

    def _frame(self, frame: Frame) -> Iterator[Block]:
        segments, drawn = self.sizes.segments(frame), self.drawn(frame)
        yield Heading(3, frame.name)
        yield Paragraph(drawn.about)
        yield Picture(_file_name(frame.name), f"The bytes of {frame.name}", byte_diagram(frame.name, drawn.boxes))
        lines = list(self._lines(segments, NOTHING, 0))
        rows = [(one.offset, one.size, "· " * one.depth + one.name, one.what) for one in lines]
        yield PageTable(("offset", "bytes", "name", "what"), rows)
        example = self.examples.get(frame.name)
        if example is not None and example.wire.exact is not None:
            values = json.dumps(example.values, default=str, ensure_ascii=False)
            yield Paragraph(f"An example{f' ({example.source})' if example.source else ''}:")
            yield Listing("text", f"{example.wire.exact.hex(' ').upper()}\n{values}")

    def _boxes(self, segments: Segments) -> Iterator[Box]:
        for segment in segments:
            sizes = segment.sizes(self.sizes.frame)
            if sizes.most == 0:
                continue
            exact = sizes.most if sizes.least == sizes.most else None
            below = "" if segment.blocks or segment.inner_record is not None else _after_name(segment)
            optional = segment.when is not None or sizes.least == 0
            yield Box(_name(segment), below, _number(sizes), exact, _shade(segment), optional)

    def _lines(self, segments: Segments, at: Sizes, depth: int) -> Iterator[FieldLine]:
        """Yield the lines of a list, from offset `at` on."""
        for segment in segments:
            sizes = segment.sizes(self.sizes.frame)
            if segment.when is not None:
                sizes = Sizes(0, sizes.most)
            offset = _number(at) if at.least == at.most else ""
            takes_bytes = sizes.most != 0
            yield FieldLine(
                offset if takes_bytes else "",
                _number(sizes) if takes_bytes else "",
                _name(segment),
                _what(segment),
                depth,
            )
            if isinstance(segment, Bits):
                yield from (
                    FieldLine("", "", part.name, _places(part.low, part.high), depth + 1) for part in segment.parts
                )
            if depth < DEEPEST:
                for inside in (*segment.blocks, *([segment.inner_record] if segment.inner_record is not None else [])):
                    alone = segment.is_there_inside or (segment.is_record and segment.inner_record is inside)
                    yield from self._lines(inside, at if alone and segment.when is None else ANY, depth + 1)
            at += sizes

    # ---- requests -----------------------------------------------------------------------------------------

    def _areas(self) -> Iterator[Block]:
        if self.protocol.areas:
            yield Heading(2, "Areas and addresses")
            rows = [(one.name, str(one.unit), str(one.size)) for one in self.protocol.areas.values()]
            yield PageTable(("area", "unit", "elements"), rows)
        if self.protocol.addresses:
            yield PageTable(("address", "unit"), [(form.text, form.unit or "") for form in self.protocol.addresses])

    def _services(self) -> Iterator[Block]:
        rows = [
            (
                name,
                ", ".join(one.name for one in row.takes),
                _frames(row.request),
                _frames([reply.frame for reply in row.reply]),
            )
            for name, found in self.protocol.services.items()
            for row in found
        ]
        if rows:
            yield Heading(2, "Services")
            yield PageTable(("service", "takes", "request", "reply"), rows)
        for name, table in self.protocol.tables.items():
            if self.protocol.errors is not None and any(one.table == name for one in self.protocol.errors.names):
                yield Heading(3, f"Codes of errors: {name}")
                yield PageTable(("code", "name"), [(str(key), str(value)) for key, value in table.entries.items()])


def _frames(value: object) -> str:
    return ", ".join(dict.fromkeys(one.frame for one in parts_of(value, FrameOf)))


def _name(segment: Segment) -> str:
    if segment.name and not segment.name.startswith("_"):
        return segment.name
    return segment.called()


def _what(segment: Segment) -> str:
    """Describe a segment in the words of docstrings of generated code; a list without its items."""
    if segment.blocks or segment.inner_record is not None:
        described = f"{segment.called()}" + (f" if {segment.when}" if segment.when is not None else "")
    else:
        described = _after_name(segment) + (f", if {segment.when}" if segment.when is not None else "")
    return f"{described}: {segment.doc}" if segment.doc else described


def _after_name(segment: Segment) -> str:
    """Return the part of the summary after the name, without the condition."""
    text = summary([segment]).removesuffix(f" if {segment.when}")
    for prefix in (segment.name, segment.called()):
        text = text.removeprefix(f"{prefix} ") if prefix else text
    return text[1:-1] if text.startswith("(") and text.endswith(")") else text


_SHADES: Mapping[str, Shade] = {
    "const": "constant", "text": "constant", "length": "size", "count": "size", "check": "check",
}  # fmt: skip


def _shade(segment: Segment) -> Shade:
    inside = segment.frames_inside or segment.blocks or segment.inner_record is not None
    return "inside" if inside else _SHADES.get(segment.KEY, "value")


def _number(sizes: Sizes) -> str:
    if sizes.least == sizes.most:
        return str(sizes.least)
    return f"{sizes.least} or more" if sizes.most is None else f"{sizes.least} to {sizes.most}"


def _bytes(sizes: Sizes) -> str:
    return plural(sizes.least, "byte") if sizes.least == sizes.most else f"{_number(sizes)} bytes"


def _places(low: int, high: int) -> str:
    return f"bit {low}" if low == high else f"bits {low} to {high}"


def _file_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]", "_", text)[:80]


# ---- Markdown -----------------------------------------------------------------------------------------------


def markdown(blocks: Sequence[Block], pictures: str) -> tuple[str, dict[str, str]]:
    """Return the text, and the pictures by the names of their files in the folder `pictures`."""
    files: dict[str, str] = {}
    return "\n".join(_as_markdown(block, pictures, files) for block in blocks), files


def _as_markdown(block: Block, pictures: str, files: dict[str, str]) -> str:
    match block:
        case Heading(level, text):
            return f"{'#' * level} {_plain(text)}\n"
        case Paragraph(text):
            return f"{_plain(text)}\n"
        case PageTable(head, rows):
            lines = [list(head), ["---"] * len(head), *rows]
            return "".join("| " + " | ".join(_plain(cell) for cell in line) + " |\n" for line in lines)
        case Picture(name, title, svg):
            file = f"{name}.svg"
            files[file] = svg
            return f"![{_plain(title)}]({pictures}/{file})\n"
        case Listing(language, text):
            fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
            return f"{fence}{language}\n{visible(text.rstrip())}\n{fence}\n"


_ENTITIES = {sign: f"&{name};" for sign, name in (("&", "amp"), ("<", "lt"), (">", "gt"))} | {
    sign: f"&#{ord(sign)};" for sign in "|~$"
}
r"""Characters that `\` does not make literal in every Markdown."""


def _plain(text: str) -> str:
    """Return the text in one line without any meaning in Markdown."""
    escaped = re.sub(r"([\\`*{}\[\]#!]|(?<!\w)_|_(?!\w))", r"\\\1", " ".join(visible(text).split()))
    return "".join(_ENTITIES.get(sign, sign) for sign in escaped)


# ---- HTML ---------------------------------------------------------------------------------------------------

_STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:920px;margin:2em auto;padding:0 1em;color:#1b1f24}
table{border-collapse:collapse;margin:.6em 0}td,th{border:1px solid #d0d7de;padding:.2em .6em;text-align:left}
pre{background:#f6f8fa;padding:.6em;overflow:auto}svg{max-width:100%;height:auto}h3{margin-top:2em}"""


def html(blocks: Sequence[Block]) -> str:
    """Return a single page with the whole document."""
    title = next((block.text for block in blocks if isinstance(block, Heading)), "")
    body = "\n".join(_as_html(block) for block in blocks)
    head = f'<meta charset="utf-8"><title>{_as_text(title)}</title><style>{_STYLE}</style>'
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n</body></html>\n'


def _as_text(text: str) -> str:
    return escape(visible(text))


def _as_html(block: Block) -> str:
    match block:
        case Heading(level, text):
            return f"<h{level}>{_as_text(text)}</h{level}>"
        case Paragraph(text):
            return f"<p>{_as_text(text)}</p>"
        case PageTable(head, rows):
            top = "".join(f"<th>{_as_text(cell)}</th>" for cell in head)
            lines = "".join("<tr>" + "".join(f"<td>{_as_text(cell)}</td>" for cell in row) + "</tr>" for row in rows)
            return f"<table><tr>{top}</tr>{lines}</table>"
        case Picture(_, _, svg):
            return svg
        case Listing(language, text):
            kind = ' class="mermaid"' if language == "mermaid" else ""
            return f"<pre{kind}>{_as_text(text)}</pre>"
