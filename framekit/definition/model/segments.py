"""The segments of a frame: what stands on the wire, one class a kind.

Sizes are in bytes unless a docstring says otherwise. Language reference, section 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from framekit.definition.expression.syntax import Expression
from framekit.definition.model.checks import CheckMethod
from framekit.definition.problems import Position

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """What every segment may have. `refuse` is the code of a fault here that is to be answered, not dropped."""

    at: Position
    name: str | None = None
    when: Expression | None = None
    refuse: int | None = None
    doc: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Const(Segment):
    """Bytes that are always there (`const`, `text`)."""

    data: bytes


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Count(Segment):
    """How many items the repeat named in `of` has."""

    name: str
    type: FieldType
    of: str
    plus: int = 0
    limits: tuple[int, int] | None = None
    zero_means: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeat(Segment):
    """A list: of records when `of` is segments, of plain values when it is a type."""

    name: str
    times: Size
    of: tuple[Segment, ...] | FieldType


@dataclass(frozen=True, slots=True, kw_only=True)
class Choose(Segment):
    """The case whose keys hold the value of `on`; its fields belong to the frame around. None fits: a fault."""

    on: Expression
    cases: tuple[tuple[tuple[int | str, ...], tuple[Segment, ...]], ...]
    otherwise: tuple[Segment, ...] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Optional(Segment):
    """Segments that are there when their values are given, and read when bytes are left in the region."""

    of: tuple[Segment, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Record(Segment):
    """A layout included `as` a name: its fields make one value, a mapping."""

    name: str
    of: tuple[Segment, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Inner(Segment):
    """A frame inside this one. `frames` are the candidates in the order they are tried; value `{frame: fields}`."""

    name: str
    frames: tuple[str, ...]
    size: Size | None = None


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Skip(Segment):
    """Bytes nobody looks at; `fill` is repeated to `size` when building."""

    size: int
    fill: bytes = b"\0"


@dataclass(frozen=True, slots=True, kw_only=True)
class Value(Segment):
    """A value without bytes: `read` derives it from what was read; building: given, else `build`, else `read`."""

    name: str
    read: Expression
    build: Expression | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Require(Segment):
    """A condition that must hold, when building and when reading."""

    condition: Expression
