"""The bytes of a recording as rows for display: each frame with its fields, the bytes between frames, and the values
that bytes have in all frames of a kind.

Rows are made from a guess, or from frames that a definition reads. A row is cut into lines of a given width; a display
requests a few lines at a time, at a cost that does not grow with the recording.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

from framekit.api.monitor import field_rows
from framekit.codec.codec import Codec, compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.frames import everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Check, Count, Field, Length
from framekit.extras.guess.model import Direction, Guess, GuessedField, HeardBytes
from framekit.extras.guess.naming import number_of, types_of
from framekit.extras.guess.pieces import PieceStream, joined, streams_of
from framekit.extras.guess.recordings import seen_by
from framekit.extras.guess.stuffing import StuffingError, plain_frame
from framekit.extras.guess.texts import shown_text
from framekit.link.events import Seen

NOISE = -1
"""Index of the kind of rows that are no frame."""
MOST_LOOKED = 10_000
"""Largest number of frames of a kind that are examined for the values of some bytes."""
LEAST_USUAL, MOST_USUAL = 1e-4, 1e7
"""Range of floating-point numbers that are plausible."""
LARGEST_SHOWN = 10**12
"""Limit from which numbers are shown by their first digits."""
MOST_SPANS = 500
"""Largest number of fields of a frame that are shown."""
MOST_KEPT = 8
MOST_VALUES = 512
MOST_SPANNED = 1024
"""Sizes of caches: ways to cut rows into lines, values of places, and rows with their fields."""


class HexRow(NamedTuple):
    """A frame without its stuffing, or the bytes between frames."""

    time: int | None
    """Time in ns; None if unknown."""
    direction: Direction
    data: bytes
    kind: int
    """Index of its kind, or NOISE."""
    fault: str = ""
    """Reason why it is no good frame; '' for a good frame."""


class HexSpan(NamedTuple):
    """Bytes of a row that form a field."""

    offset: int
    size: int
    name: str
    shade: str
    """Category of the field, for its colour."""
    about: str
    """Description of the field, or its value."""


@dataclass(slots=True)
class HexKind:
    """Frames of one kind."""

    name: str
    side: str
    """client or server; '' if unknown."""
    frame: str = ""
    """Name of the frame in a definition that reads them."""
    rows: list[int] = field(default_factory=list)
    """Numbers of their rows."""


class HexLine(NamedTuple):
    """A part of a row: from the byte `offset` on."""

    row: int
    offset: int


class TypedValues(NamedTuple):
    """Values of bytes as a type: the least and the greatest in all frames, and the number of different values."""

    type: str
    order: str
    least: str
    greatest: str
    different: int


class PlaceValues(NamedTuple):
    """Values at a place of a number of frames: the number of different values, and their values as each type."""

    frames: int
    different: int
    types: tuple[TypedValues, ...]


SpansOf = Callable[[HexRow], list[HexSpan]]


class HexTable:
    """The rows of a recording. `spans_of` finds the fields of a row."""

    def __init__(self, rows: Sequence[HexRow], kinds: list[HexKind], spans_of: SpansOf) -> None:
        self.rows = rows
        self.kinds = kinds
        self.use(spans_of)
        self.others: list[int] = []
        """Rows that are no frames of a kind."""
        for number, row in enumerate(rows):
            (self.others if row.kind == NOISE else kinds[row.kind].rows).append(number)
        self.began = next((row.time for row in rows if row.time is not None), None)
        self.longest_time = max((len(f"{self.seconds(row):.3f}") for row in rows if row.time is not None), default=0)
        """Number of characters of the longest time; 0 without times."""
        self._starts = lru_cache(MOST_KEPT)(self._starts_of)
        self._values = lru_cache(MOST_VALUES)(self._values_of)

    def use(self, spans_of: SpansOf) -> None:
        """Use another function for fields from now on, after names were given."""
        self._spans = lru_cache(MOST_SPANNED)(lambda number: tuple(spans_of(self.rows[number])[:MOST_SPANS]))

    def spans(self, number: int) -> tuple[HexSpan, ...]:
        """Return the fields of a row, in order, without overlaps."""
        return self._spans(number)

    # ---- lines --------------------------------------------------------------------------------------------

    def count(self, kind: int | None, width: int) -> int:
        """Return the number of lines, of all rows or of one kind."""
        starts = self._starts(kind, width)
        return starts[-1]

    def lines(self, kind: int | None, width: int, first: int, most: int) -> Iterator[HexLine]:
        """Yield up to `most` lines, from line `first` on."""
        starts, chosen = self._starts(kind, width), self._chosen(kind)
        at = bisect_right(starts, first) - 1
        for number in range(first, min(first + most, starts[-1])):
            while starts[at + 1] <= number:
                at += 1
            yield HexLine(chosen[at], (number - starts[at]) * width)

    def _chosen(self, kind: int | None) -> Sequence[int]:
        if kind is None:
            return range(len(self.rows))
        return self.others if kind == NOISE else self.kinds[kind].rows

    def _starts_of(self, kind: int | None, width: int) -> list[int]:
        """Return the first line of each row, and at the end the number of lines."""
        sizes = (max(1, -(-len(self.rows[number].data) // width)) for number in self._chosen(kind))
        return [0, *accumulate(sizes)]

    # ---- values -------------------------------------------------------------------------------------------

    def values(self, number: int, offset: int, size: int) -> PlaceValues:
        """Return the values at a place in the frames of a row's kind, up to `MOST_LOOKED` frames."""
        kind = self.rows[number].kind
        return self._values(kind, number if kind == NOISE else -1, offset, size)

    def _alike(self, kind: int, number: int) -> Sequence[int]:
        own = [number] if kind == NOISE else self.kinds[kind].rows
        return own[:: -(-len(own) // MOST_LOOKED)]

    def _values_of(self, kind: int, number: int, offset: int, size: int) -> PlaceValues:
        own = self._alike(kind, number)
        places = (self.rows[one].data[offset : offset + size] for one in own)
        texts = list(dict.fromkeys(text for text in places if len(text) == size))
        likely, found = list[TypedValues](), list[TypedValues]()
        for type_, order in types_of(texts):
            if type_ == "text":
                found.append(TypedValues(type_, order, shown_text(min(texts)), shown_text(max(texts)), len(texts)))
            elif type_ in ("bits", "bytes"):
                found.append(TypedValues(type_, order, "", "", len(texts)))
            else:
                numbers = {known for text in texts if (known := number_of(type_, order, text)) is not None}
                if numbers:
                    ends = shown_number(min(numbers)), shown_number(max(numbers))
                    values = TypedValues(type_, order, *ends, len(numbers))
                    is_likely = type_ in ("f32", "f64") and len(texts) > 1 and _are_usual(numbers, len(texts))
                    (likely if is_likely else found).append(values)
        found[:0] = likely
        return PlaceValues(len(own), len(texts), tuple(found))

    def course(
        self, number: int, offset: int, size: int, type_: str, order: str, most: int
    ) -> list[tuple[float, float]]:
        """Return the numbers at a place, with their times (s), or with the numbers of their rows if no times are
        known.
        """
        own = self._alike(self.rows[number].kind, number)
        found = []
        for one in own[:: -(-len(own) // most)]:
            row = self.rows[one]
            value = number_of(type_, order, text) if len(text := row.data[offset : offset + size]) == size else None
            if value is not None:
                found.append((self.seconds(row) if row.time is not None else float(one), float(value)))
        return found

    def seconds(self, row: HexRow) -> float:
        """Return the time since the first row (s)."""
        return 0.0 if row.time is None or self.began is None else (row.time - self.began) / 1e9


def _are_usual(numbers: Collection[float], of: int) -> bool:
    """Return whether all floats have a plausible size: arbitrary bytes seldom have it."""
    return len(numbers) == of and all(number == 0 or LEAST_USUAL <= abs(number) <= MOST_USUAL for number in numbers)


def shown_as(type_: str, order: str, data: bytes) -> str:
    """Return bytes as a value of a type, formatted for a cell."""
    if type_ == "text":
        return shown_text(data)
    if type_ == "bits" and len(data) <= 2:
        return " ".join(f"{byte:08b}" for byte in data)
    return data[:8].hex(" ").upper() if type_ in ("bits", "bytes") else shown_number(number_of(type_, order, data))


def shown_number(number: int | float | None) -> str:
    """Return a number formatted for a cell."""
    if number is None:
        return "-"
    return str(number) if isinstance(number, int) and abs(number) < LARGEST_SHOWN else f"{number:.6g}"


# ---- of a guess -------------------------------------------------------------------------------------------------


class FramePlace(NamedTuple):
    """A frame as on the line.

    `kind`: the index of its kind, or NOISE with its `fault`; without bytes, the reason why the next bytes are no frame.
    """

    data: bytes
    direction: Direction
    kind: int
    fault: str = ""


def guessed_table(found: Guess) -> HexTable:
    """Return the rows of a guess, with its present fields: a name given later requires a new table."""
    framing = found.framing
    if framing is None:
        return HexTable([], [], lambda row: [])
    index = {id(frame): number for number, kind in enumerate(found.kinds) for frame in kind.frames}
    fault = "its stuffing is wrong" if found.check is None else "its check is wrong"
    frames = [
        FramePlace(frame.data, frame.direction, kind, fault if kind == NOISE else "")
        for frame in found.frames
        for kind in (index.get(id(frame), NOISE),)
    ]
    shares_mark = framing.kind == "marks" and len(framing.start) == 1 and framing.start == framing.end

    def plain(data: bytes) -> bytes:
        try:
            return plain_frame(framing, data)
        except StuffingError:
            return data

    rows = [
        row._replace(data=plain(row.data)) if row.kind != NOISE else row
        for row in rows_of(found.chunks, frames, int(shares_mark))
    ]
    return HexTable(rows, [HexKind(kind.name, kind.side) for kind in found.kinds], guessed_spans(found))


def guessed_spans(found: Guess) -> SpansOf:
    """Return a function that finds the fields of a row in the present guess with its names."""

    def spans(row: HexRow) -> list[HexSpan]:
        return [] if row.kind == NOISE else list(_placed(found.kinds[row.kind].fields, len(row.data)))

    return spans


def _placed(fields: Sequence[GuessedField], size: int) -> Iterator[HexSpan]:
    """Yield the fields of a frame of this size."""
    tail = sum(one.size for one in fields if one.offset < 0)
    for one in fields:
        begin = one.offset if one.offset >= 0 else size + one.offset
        length = one.size or max(0, size - tail - begin)
        if length:
            yield HexSpan(begin, length, one.name, shade_of(one), one.about)


def shade_of(one: GuessedField) -> str:
    """Return the category of a field in the legend."""
    if one.wire:
        return "named"
    if one.name in ("start", "end", "mark"):
        return "mark"
    if one.kind == "text" and one.about.startswith("always"):
        return "constant"
    return "function" if one.is_mark else "value" if one.kind == "unknown" else one.kind


def rows_of(chunks: Sequence[HeardBytes], frames: Sequence[FramePlace], shared: int) -> list[HexRow]:
    """Return the frames at their places, and the bytes between them.

    `shared`: bytes that two adjacent frames may share.
    """
    by_way: dict[Direction, list[FramePlace]] = defaultdict(list)
    for frame in frames:
        by_way[frame.direction].append(frame)
    found: list[tuple[int, int, HexRow]] = []
    for stream in streams_of(joined(chunks)):
        at = begin = 0
        fault = ""
        for frame in by_way[stream.direction]:
            if frame.kind == NOISE and not frame.data:
                fault = frame.fault
                continue
            place = stream.data.find(frame.data, max(begin, at - shared))
            if place < 0:
                continue
            found += _between(stream, at, place, fault)
            piece = stream.heard_at(place)
            row = HexRow(stream.times[piece], stream.direction, frame.data, frame.kind, frame.fault)
            found.append((stream.numbers[piece], place, row))
            begin, at, fault = place + 1, place + len(frame.data), ""
        found += _between(stream, at, len(stream.data), fault)
    found.sort(key=lambda one: one[:2])
    return [row for _, _, row in found]


def _between(stream: PieceStream, begin: int, end: int, fault: str) -> Iterator[tuple[int, int, HexRow]]:
    """Yield the bytes outside of frames, piece by piece as captured."""
    while begin < end:
        piece = stream.heard_at(begin)
        until = min(end, stream.heard[piece + 1] if piece + 1 < len(stream.heard) else end)
        row = HexRow(stream.times[piece], stream.direction, stream.data[begin:until], NOISE, fault)
        yield stream.numbers[piece], begin, row
        begin = until


# ---- of a definition --------------------------------------------------------------------------------------------


def definition_table(name: str | Path, chunks: Sequence[HeardBytes]) -> HexTable:
    """Return the rows of a recording as read by a definition; the fields of a row are found on request.

    Raises DefinitionError.
    """
    protocol = load_protocol(name)
    codec, shades = compile_protocol(protocol), _shades(protocol)
    kinds: dict[tuple[str, ...], tuple[int, HexKind]] = {}
    frames: list[FramePlace] = []
    for one in seen_by(protocol, chunks):
        if one.kind == "frame":
            path = _inner_names(protocol, one.frame, one.fields)
            side = protocol.frames[one.frame].side
            kind = HexKind(path[-1], side if side in ("client", "server") else "", one.frame)
            frames.append(FramePlace(one.raw, one.direction, kinds.setdefault(path, (len(kinds), kind))[0]))
        elif one.kind == "bad":
            name = f"bad {one.frame}".rstrip()
            frames.append(FramePlace(b"", one.direction, NOISE, f"{name}: {one.reason} at byte {one.place}"))
    rows = rows_of(chunks, frames, 0)
    named = [kind for _, kind in kinds.values()]
    return HexTable(rows, named, lambda row: _read_spans(protocol, codec, named, shades, row))


def _inner_names(protocol: Protocol, name: str, fields: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of a frame and of its inner frames."""
    for value in fields.values():
        if isinstance(value, Mapping) and len(value) == 1:
            ((inner, inside),) = value.items()
            if inner in protocol.frames and isinstance(inside, Mapping):
                return name, *_inner_names(protocol, inner, inside)
    return (name,)


def _read_spans(
    protocol: Protocol, codec: Codec, kinds: Sequence[HexKind], shades: Mapping[str, str], row: HexRow
) -> list[HexSpan]:
    """Return the fields of a frame of a definition: of nested fields the inner ones."""
    if row.kind == NOISE:
        return []
    rows = field_rows(codec, protocol, Seen(row.direction, "frame", 0, row.data, kinds[row.kind].frame))
    owner: list[int | None] = [None] * len(row.data)
    for number, one in sorted(enumerate(rows), key=lambda each: -len(each[1].data)):
        owner[one.offset : one.offset + len(one.data)] = [number] * len(one.data)
    found: list[HexSpan] = []
    begin = 0
    for at in range(1, len(owner) + 1):
        if at < len(owner) and owner[at] == owner[begin]:
            continue
        number_here = owner[begin]
        if number_here is not None:
            one = rows[number_here]
            shade = shades.get(one.path.rpartition(".")[2].partition("[")[0], "named")
            found.append(HexSpan(begin, at - begin, one.path, shade, one.value))
        begin = at
    return found


def _shades(protocol: Protocol) -> dict[str, str]:
    """Return the categories of the fields of a definition by name; fields without a special category are `named`."""
    found = {"const": "constant", "text": "constant", "skip": "constant", "check": "check"}
    for frame in protocol.frames.values():
        for one in everything(frame.segments):
            kinds: dict[type, str] = {Length: "length", Count: "count", Check: "check"}
            kind = kinds.get(type(one), "")
            for name in one.value_names:
                stem = name.rpartition("_")[0]
                if kind:
                    found[name] = kind
                elif stem in ("unknown", "constant", "copy") and isinstance(one, Field):
                    found[name] = {"unknown": "value"}.get(stem, stem)
                else:
                    found.setdefault(name, "named")
    return found
