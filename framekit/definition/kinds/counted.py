"""`length`, `count`: numbers for the size of other segments and for the items of a list."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

from framekit.definition.keys import FLAG, IDENTIFIER, LABEL, LABELS, NUMBER, RANGE, Form, KeyReading, ValueKind, key
from framekit.definition.kinds.base import (
    Contents,
    References,
    Segment,
    bytes_of_number,
    limits_that_do_not_fit,
    zero_with_a_sign,
)
from framekit.definition.problems import Problem, did_you_mean
from framekit.definition.tree import Node
from framekit.definition.wire_types import FieldType, type_keys

LENGTH_UNITS = {"bytes": 1, "words": 2, "dwords": 4, "lwords": 8, "digits": 1}


def _unit(reading: KeyReading, node: Node) -> int:
    text = reading.reader.text(node)
    return LENGTH_UNITS[text] if text in LENGTH_UNITS else reading.reader.number(node)


def _counted(reading: KeyReading, node: Node) -> tuple[str, ...]:
    of = reading.reader.texts(node)
    if not of:
        name = reading.reader.text(reading.keys.get("length"))
        reading.reader.note(reading.keys.at, f"the length '{name}' counts nothing", "add of: [names of segments]")
    return of


UNIT = Form(
    {
        "type": ["string", "integer"],
        "pattern": "^(bytes|words|dwords|lwords|digits|[0-9]+)$",
        "x-expected": "a unit (bytes, words, dwords, lwords or digits)",
    },
    _unit,
)


class Counting(Segment):
    """A number that gives the size or number of items of another part."""

    VALUE: ClassVar[ValueKind | None] = "number"

    __slots__ = ()
    name: str
    type: FieldType
    plus: int
    limits: tuple[int, int] | None
    zero_means: int | None

    @property
    def number_type(self) -> FieldType:
        return self.type

    @property
    def given_names(self) -> tuple[str, ...]:
        return ()

    def contents(self, of_frame: Contents) -> frozenset[int]:
        return bytes_of_number(self)

    def check(self) -> Iterator[Problem]:
        if not self.type.is_whole_number:
            what = f"a {self.KEY} is a whole number, '{self.name}' is of another type"
            yield Problem(self.at, what, "use u8, u16, hex, dec or bcd")
            return
        yield from limits_that_do_not_fit(self)
        yield from zero_with_a_sign(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Length(Counting):
    """Size of the segments named in `of`: value = bytes on the wire // unit + plus.

    `plain`: size before conversion; `unit`: bytes for each count; `limits` and `zero_means` as for a field.
    """

    KEY: ClassVar[str] = "length"

    name: str = key("length", IDENTIFIER, "Name of the number.")
    type: FieldType = type_keys("type", "How the number is written.")
    of: tuple[str, ...] = key("of", LABELS._replace(read=_counted), "The segments whose bytes are counted.")
    plain: bool = key("plain", FLAG, "yes: bytes are counted before conversion.", default=False)
    unit: int = key("unit", UNIT, "What is counted: bytes, words, dwords or lwords.", default=1)
    plus: int = key("plus", NUMBER, "Added to the number of bytes.", default=0)
    limits: tuple[int, int] | None = key("range", RANGE, "Least and greatest number, 1..16.", default=None)
    zero_means: int | None = key("zero_means", NUMBER, "The length that a 0 on the wire means.", default=None)

    @property
    def counted(self) -> tuple[str, ...]:
        """Return the paths of the segments whose bytes it counts."""
        return tuple(map(self.sibling_path, self.of))

    def resolved(self, references: References) -> Segment:
        return replace(self, of=references.written_out(self.of, self.at))

    def check(self) -> Iterator[Problem]:
        yield from Counting.check(self)
        if self.type.is_whole_number and self.unit < 1:
            yield Problem(self.at, f"a unit of {self.unit} bytes counts nothing", "give 1 or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class Count(Counting):
    """Number of items of the list named in `of`."""

    KEY: ClassVar[str] = "count"

    name: str = key("count", IDENTIFIER, "Name of the number.")
    type: FieldType = type_keys("type", "How the number is written.")
    of: str = key("of", LABEL, "The list whose items are counted.")
    plus: int = key("plus", NUMBER, "Added to the number of items.", default=0)
    limits: tuple[int, int] | None = key("range", RANGE, "Least and greatest number, 1..16.", default=None)
    zero_means: int | None = key("zero_means", NUMBER, "The count that a 0 on the wire means.", default=None)

    @property
    def counted(self) -> str:
        """Return the path of the list whose items it counts."""
        return self.sibling_path(self.of)

    def resolved(self, references: References) -> Segment:
        counted = references.names.get(self.of)
        if counted is None or not counted.is_list:
            known = [name for name, segment in references.names.items() if name and segment.is_list]
            todo = did_you_mean(self.of, known) or "name a segment repeat: in of"
            if counted is not None and _has_bytes(counted):
                todo = f"write length: {self.name} for the number of bytes"
            references.reader.note(self.at, f"there is no repeat '{self.of}' to count", todo)
        return self


def _has_bytes(segment: Segment) -> bool:
    """Return whether it is a plain value with bytes that a length could count."""
    inside = segment.inner_record or segment.frames_inside or isinstance(segment, Counting)
    return segment.takes_bytes and segment.value_names == (segment.name,) and not inside
