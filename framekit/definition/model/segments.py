"""The segments of a frame: what stands on the wire, one class a kind.

Each class also says what it holds: the lists of segments inside, the names of its values, its static size. All walks
over segments ask these. Sizes are in bytes unless a docstring says otherwise. Language reference, section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, Self

from framekit.definition.expression.syntax import Expression
from framekit.definition.model.checks import CheckMethod
from framekit.definition.problems import Position

MOST_BYTES = 1_048_576
"""Bytes of a frame, and items of its lists, at most."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Least and most bytes on the wire; `most` is None where there is no bound."""

    least: int
    most: int | None

    @property
    def fixed(self) -> int | None:
        return self.least if self.least == self.most else None

    def __add__(self, other: Sizes) -> Sizes:
        most = None if self.most is None or other.most is None else self.most + other.most
        return Sizes(self.least + other.least, most)

    def times(self, least: int, most: int | None) -> Sizes:
        bound = None if self.most is None or most is None else self.most * most
        return Sizes(self.least * least, 0 if self.most == 0 else bound)


NOTHING = Sizes(0, 0)
ANY = Sizes(0, None)


def exactly(size: int) -> Sizes:
    return Sizes(size, size)


def either(sizes: Iterable[Sizes]) -> Sizes:
    """The sizes of one of several possibilities."""
    found = list(sizes)
    if not found:
        return NOTHING
    most = [size.most for size in found]
    return Sizes(min(size.least for size in found), None if None in most else max(m for m in most if m is not None))


def of_any_frame(name: str) -> Sizes:
    """The sizes of a frame where frames are not known."""
    return ANY


Size = int | Expression | Literal["rest"]
"""A number of bytes, an expression for it, or everything up to the end of the region."""

TypeKind = Literal["int", "float", "digits", "bcd", "ascii", "bytes"]
Order = Literal["big", "little", "BADC", "CDAB"]


@dataclass(frozen=True, slots=True)
class FieldType:
    """How one value is written on the wire.

    `size` is bytes on the wire (digits: places; bcd: bytes). `base` 16, 10 or 8 and `upper` are for digits, `pad` (one
    byte) and `end` for ascii. Mid-endian orders exist for integers and floats of 2, 4 and 8 bytes.
    """

    kind: TypeKind
    size: int | Expression | None
    signed: bool = False
    order: Order = "big"
    base: int = 16
    upper: bool = True
    pad: bytes | None = None
    end: bytes | None = None

    @property
    def fixed_size(self) -> int | None:
        return self.size if isinstance(self.size, int) else None

    @property
    def sizes(self) -> Sizes:
        if isinstance(self.size, int):
            return exactly(self.size)
        return Sizes(len(self.end), None) if self.end is not None and self.size is None else ANY


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """What every segment may have, and what it can be asked.

    `refuse` is the code of a fault here that is to be answered, not dropped.
    """

    at: Position
    name: str | None = None
    when: Expression | None = None
    refuse: int | None = None
    doc: str = ""

    @property
    def value_names(self) -> tuple[str, ...]:
        """The names of the values that it holds itself."""
        return ()

    @property
    def blocks(self) -> tuple[Segments, ...]:
        """The lists of segments inside whose values belong to the same record as the segment."""
        return ()

    @property
    def is_there_inside(self) -> bool:
        """Whether what stands in `blocks` is there whenever the segment is."""
        return False

    @property
    def inner_record(self) -> Segments | None:
        """The segments inside whose values make records of their own; None if there is no such list."""
        return None

    def with_blocks(self, change: Callable[[Segments], Segments]) -> Self:
        """The same segment with every list of `blocks` changed."""
        return self

    def with_record(self, change: Callable[[Segments], Segments]) -> Self:
        """The same segment with the list of `inner_record` changed."""
        return self

    def with_lists(self, change: Callable[[Segments], Segments]) -> Self:
        """The same segment with every list in it changed."""
        return self.with_blocks(change).with_record(change)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        """Bytes on the wire when it is there; `of_frame` gives the sizes of a frame by name."""
        raise NotImplementedError


Segments = tuple[Segment, ...]


def sizes_of(segments: Segments, of_frame: Callable[[str], Sizes]) -> Sizes:
    """Bytes on the wire of a list; a segment under a condition may take none."""
    total = NOTHING
    for segment in segments:
        if isinstance(segment, Fill):
            return exactly(segment.total)
        sizes = segment.sizes(of_frame)
        total += sizes if segment.when is None else Sizes(0, sizes.most)
    return total


@dataclass(frozen=True, slots=True, kw_only=True)
class Const(Segment):
    """Bytes that are always there (`const`, `text`)."""

    data: bytes

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return exactly(len(self.data))


@dataclass(frozen=True, slots=True, kw_only=True)
class Long:
    """Values from `mark` on are written as the mark and a second, longer number."""

    mark: int
    type: FieldType


@dataclass(frozen=True, slots=True, kw_only=True)
class Field(Segment):
    """One value. `is_` computes it always, `build` and `default` when nothing is given.

    `plus`: wire number = value + plus. `unit`: the value is a time, wire number × unit nanoseconds. `limits`: least and
    greatest value. `only`: numbers without a name in `values` are refused. `zero_means`: wire 0 stands for this value.
    `constants`: fixed by the frame's `where`; the first is what is sent.
    """

    name: str
    type: FieldType
    is_: Expression | None = None
    build: Expression | None = None
    default: Expression | None = None
    values: Mapping[int, str] | None = None
    only: bool = False
    limits: tuple[int, int] | None = None
    plus: int = 0
    unit: int | None = None
    long: Long | None = None
    zero_means: int | None = None
    constants: tuple[int | str | bytes, ...] | None = None
    memory: str | None = None

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        sizes = self.type.sizes
        return sizes if self.long is None else Sizes(sizes.least, (sizes + self.long.type.sizes).most)


@dataclass(frozen=True, slots=True, kw_only=True)
class BitsPart:
    """Bits `low`..`high` (bit 0 is the least significant) of a bits segment, with the same rules as a field."""

    name: str
    low: int
    high: int
    is_: Expression | None = None
    build: Expression | None = None
    values: Mapping[int, str] | None = None
    constants: tuple[int, ...] | None = None
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class Bits(Segment):
    """A number cut into named bits; `type` is its form on the wire. Bits without a name are 0 and not looked at."""

    parts: tuple[BitsPart, ...]
    type: FieldType

    @property
    def value_names(self) -> tuple[str, ...]:
        return tuple(part.name for part in self.parts)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return self.type.sizes


@dataclass(frozen=True, slots=True, kw_only=True)
class Data(Segment):
    """Bytes. `size` counts them in memory, before conversion; `pad` fills shorter ones; `least` is the least number."""

    name: str
    size: Size
    convert: Literal["hex_to_ascii", "ascii_to_hex"] | None = None
    swap: int = 0
    pad: int | None = None
    least: int = 0
    memory: str | None = None

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    def on_wire(self, size: int) -> int:
        """Bytes on the wire for so many in memory."""
        return size * 2 if self.convert == "hex_to_ascii" else size // 2 if self.convert == "ascii_to_hex" else size

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        if isinstance(self.size, int):
            return exactly(self.on_wire(self.size))
        return Sizes(self.on_wire(self.least), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Length(Segment):
    """How much room the segments named in `of` take: value = bytes on the wire // unit + plus.

    `plain` counts before conversion; `unit` is bytes a counted unit; `limits` and `zero_means` as for a field.
    """

    name: str
    type: FieldType
    of: tuple[str, ...]
    plain: bool = False
    unit: int = 1
    plus: int = 0
    limits: tuple[int, int] | None = None
    zero_means: int | None = None

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return self.type.sizes


@dataclass(frozen=True, slots=True, kw_only=True)
class Count(Segment):
    """How many items the repeat named in `of` has."""

    name: str
    type: FieldType
    of: str
    plus: int = 0
    limits: tuple[int, int] | None = None
    zero_means: int | None = None

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return self.type.sizes


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeat(Segment):
    """A list: of records when `of` is segments, of plain values when it is a type."""

    name: str
    times: Size
    of: tuple[Segment, ...] | FieldType

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    @property
    def inner_record(self) -> Segments | None:
        return None if isinstance(self.of, FieldType) else self.of

    def with_record(self, change: Callable[[Segments], Segments]) -> Self:
        return self if isinstance(self.of, FieldType) else replace(self, of=change(self.of))

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        item = self.of.sizes if isinstance(self.of, FieldType) else sizes_of(self.of, of_frame)
        return item.times(self.times, self.times) if isinstance(self.times, int) else item.times(0, None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Choose(Segment):
    """The case whose keys hold the value of `on`; its fields belong to the frame around. None fits: a fault."""

    on: Expression
    cases: tuple[tuple[tuple[int | str, ...], tuple[Segment, ...]], ...]
    otherwise: tuple[Segment, ...] | None

    @property
    def blocks(self) -> tuple[Segments, ...]:
        cases = tuple(case for _, case in self.cases)
        return cases if self.otherwise is None else (*cases, self.otherwise)

    def with_blocks(self, change: Callable[[Segments], Segments]) -> Self:
        cases = tuple((keys, change(case)) for keys, case in self.cases)
        return replace(self, cases=cases, otherwise=None if self.otherwise is None else change(self.otherwise))

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return either(sizes_of(block, of_frame) for block in self.blocks)


@dataclass(frozen=True, slots=True, kw_only=True)
class Optional(Segment):
    """Segments that are there when their values are given, and read when bytes are left in the region."""

    of: tuple[Segment, ...]

    @property
    def blocks(self) -> tuple[Segments, ...]:
        return (self.of,)

    def with_blocks(self, change: Callable[[Segments], Segments]) -> Self:
        return replace(self, of=change(self.of))

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return Sizes(0, sizes_of(self.of, of_frame).most)


@dataclass(frozen=True, slots=True, kw_only=True)
class Record(Segment):
    """A layout included `as` a name: its fields make one value, a mapping."""

    name: str
    of: tuple[Segment, ...]

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    @property
    def inner_record(self) -> Segments | None:
        return self.of

    def with_record(self, change: Callable[[Segments], Segments]) -> Self:
        return replace(self, of=change(self.of))

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return sizes_of(self.of, of_frame)


@dataclass(frozen=True, slots=True, kw_only=True)
class Inner(Segment):
    """A frame inside this one. `frames` are the candidates in the order they are tried; value `{frame: fields}`."""

    name: str
    frames: tuple[str, ...]
    size: Size | None = None

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        if isinstance(self.size, int):
            return exactly(self.size)
        return ANY if self.size is not None else either(of_frame(name) for name in self.frames)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wrap(Segment):
    """A region that is converted as a whole: as hex digits, or with every `escape` byte doubled.

    `least` and `most` limit the plain content; `inside` are frames that may stand anywhere in it, `insert` says when
    they may be sent so.
    """

    how: Literal["hex", "escape"]
    of: tuple[Segment, ...]
    escape: int | None = None
    inside: tuple[str, ...] = ()
    insert: Expression | None = None
    least: int = 0
    most: int | Expression | None = None

    @property
    def blocks(self) -> tuple[Segments, ...]:
        return (self.of,)

    def with_blocks(self, change: Callable[[Segments], Segments]) -> Self:
        return replace(self, of=change(self.of))

    @property
    def is_there_inside(self) -> bool:
        return True

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        content = sizes_of(self.of, of_frame)
        return content.times(2, 2) if self.how == "hex" else Sizes(content.least, content.times(1, 2).most)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check(Segment):
    """A check code over everything before it, over named segments (`over`), or from one to another (`span`).

    Each counts as it is inside its wrap: undoubled and in binary. In `span` the last name may be `here`.
    """

    method: CheckMethod
    over: tuple[str, ...] | None = None
    span: tuple[str, str] | None = None
    form: Literal["raw", "hex", "HEX", "dec", "nibbles"] = "raw"
    order: Literal["big", "little"] = "big"
    size: int = 1
    verify: Literal["error", "warn", "off"] = "error"

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return exactly(self.size)


@dataclass(frozen=True, slots=True, kw_only=True)
class Skip(Segment):
    """Bytes nobody looks at; `fill` is repeated to `size` when building."""

    size: int
    fill: bytes = b"\0"

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return exactly(self.size)


@dataclass(frozen=True, slots=True, kw_only=True)
class Value(Segment):
    """A value without bytes: `read` derives it from what was read; building: given, else `build`, else `read`."""

    name: str
    read: Expression
    build: Expression | None = None

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return NOTHING


@dataclass(frozen=True, slots=True, kw_only=True)
class Require(Segment):
    """A condition that must hold, when building and when reading."""

    condition: Expression

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return NOTHING


@dataclass(frozen=True, slots=True, kw_only=True)
class Fill(Segment):
    """What a frame of fixed size leaves free between body and tail: `total` is the size of the whole frame."""

    total: int
    byte: int

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return ANY
