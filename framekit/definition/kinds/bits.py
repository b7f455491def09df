"""`bits`: a number cut into named bits."""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping as MappingOf
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from framekit.definition.expression import Expression
from framekit.definition.keys import KeyReading, ValueKind, keys, ref
from framekit.definition.kinds.base import (
    VALUE_NAMES,
    Contents,
    Fixing,
    Given,
    References,
    Segment,
    constant_number,
    number_written,
)
from framekit.definition.load.reader import Reader
from framekit.definition.problems import Position, Problem
from framekit.definition.wire_types import FieldType, type_keys


@dataclass(frozen=True, slots=True, kw_only=True)
class BitsPart:
    """Bits `low`..`high` (bit 0 is the least significant) of a bits segment, with the same rules as a field."""

    name: str
    low: int
    high: int
    is_: Expression | None = None
    build: Expression | None = None
    values: MappingOf[int, str] | None = None
    constants: tuple[int, ...] | None = None
    at: Position

    @property
    def most(self) -> int | None:
        """Return the greatest number that fits; None for 1024 bits and more."""
        return (1 << self.high - self.low + 1) - 1 if self.high < 1024 else None

    def check(self) -> Iterator[Problem]:
        """Report constants that do not fit into their bits."""
        constants = [(number, self.at) for number in self.values or ()]
        constants += [
            (number, expression.at)
            for expression in (self.is_, self.build)
            if expression is not None and (number := constant_number(expression)) is not None
        ]
        for number, at in constants:
            if self.most is not None and not 0 <= number <= self.most:
                yield Problem(at, f"{number} does not fit: '{self.name}' holds 0 to {self.most}", "give it more bits")

    def fixed(self, reader: Reader, where: Fixing) -> BitsPart:
        """Return the bits with the values fixed by `where`. Raises Broken."""
        if where.build is not None:
            return replace(self, build=where.build)
        constants = tuple(number_written(reader, self, scalar) for scalar in where.constants)
        most = (1 << self.high - self.low + 1) - 1
        for scalar, number in zip(where.constants, constants, strict=True):
            if not 0 <= number <= most:
                reader.note(scalar.at, f"{number} does not fit: '{self.name}' holds 0 to {most}", "give it more bits")
        return replace(self, constants=constants)


_PLACES = {
    "type": ["string", "integer"],
    "pattern": "^\\s*[0-9]+\\s*(-\\s*[0-9]+\\s*)?$",
    "x-expected": "a bit or bits (3 or 4-7)",
}
_SCHEMAS: dict[str, Any] = {
    "bits": {
        "description": "Named bits of one number, name: place or places (4-7).",
        "type": "object",
        "propertyNames": ref("identifier"),
        "additionalProperties": _PLACES,
    },
    "is": {**ref("expressions"), "description": "Bits that are always this, name: expression."},
    "build": {**ref("expressions"), "description": "Bits computed when building, name: expression."},
    "values": {
        "description": "Names of the numbers in some of the bits, name: table or {code: name}.",
        "type": "object",
        "additionalProperties": ref("value_names"),
    },
}


def _parts(reading: KeyReading) -> tuple[BitsPart, ...]:
    reader, keys_ = reading.reader, reading.keys
    given = {
        key: {entry.key.text: entry.value for entry in reader.entries(keys_.get(key))}
        for key in ("is", "build", "values")
    }
    parts = []
    for entry in reader.entries(keys_.get("bits")):
        low, high = reader.places(entry.value)
        name = entry.key.text
        values = given["values"].pop(name, None)
        parts.append(
            BitsPart(
                name=name,
                low=low,
                high=high,
                is_=reader.maybe(reader.expression, given["is"].pop(name, None)),
                build=reader.maybe(reader.expression, given["build"].pop(name, None)),
                values=None if values is None else VALUE_NAMES.read(reading, values),
                at=entry.key.at,
            )
        )
    for names in given.values():
        for name, node in names.items():
            reader.note(node.at, f"there are no bits '{name}' here", "name one of the bits above")
    return tuple(parts)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bits(Segment):
    """A number divided into named bits; `type` is its form on the wire. Bits without a name are 0, and not checked."""

    KEY: ClassVar[str] = "bits"

    type: FieldType = type_keys("of", "Type of the number they are bits of.")
    parts: tuple[BitsPart, ...] = keys(_SCHEMAS, _parts)

    @property
    def value_names(self) -> tuple[str, ...]:
        return tuple(part.name for part in self.parts)

    @property
    def number_type(self) -> FieldType:
        return self.type

    def value_kinds(self) -> Iterator[tuple[str, ValueKind]]:
        return ((part.name, "number" if part.values is None else "any") for part in self.parts)

    def numbers_with_names(self) -> Iterator[tuple[str, MappingOf[int, str] | None]]:
        return ((part.name, part.values) for part in self.parts)

    @property
    def wire_bytes(self) -> list[frozenset[int]]:
        """Return the possible values of each byte of a plain number of one or two bytes with fixed parts; empty for
        other types.

        Bits without a name may have any value when they are read.
        """
        size, type_ = self.type.fixed_size or 0, self.type
        if type_.kind != "int" or type_.signed or type_.order not in ("big", "little") or not 0 < size <= 2:
            return []
        fixed: list[tuple[int, list[int]]] = []
        for part in self.parts:
            number = constant_number(part.is_)
            constants = part.constants if part.constants is not None else None if number is None else (number,)
            if constants is not None:
                mask = (1 << part.high - part.low + 1) - 1
                fixed.append((mask << part.low, [value << part.low for value in constants if 0 <= value <= mask]))
        found = []
        for offset in range(size if fixed else 0):
            low = 8 * (offset if type_.order == "little" else size - 1 - offset)
            known, values = 0, {0}
            for mask, numbers in fixed:
                known |= mask >> low & 0xFF
                values = {value | number >> low & 0xFF for value in values for number in numbers}
            found.append(frozenset(byte for byte in range(256) if byte & known in values))
        return found

    def contents(self, of_frame: Contents) -> frozenset[int]:
        found = [] if self.refuse is not None else self.wire_bytes
        return frozenset().union(*found) if found else Segment.contents(self, of_frame)

    @property
    def given_names(self) -> tuple[str, ...]:
        return tuple(part.name for part in self.parts if part.is_ is None)

    @property
    def may_be_given(self) -> bool:
        return bool(self.given_names)

    @property
    def lacks_default(self) -> bool:
        return any(part.is_ is None and part.build is None and part.constants is None for part in self.parts)

    def given(self) -> Iterator[Given]:
        yield from Segment.given(self)
        for part in self.parts:
            for expression in (part.is_, part.build):
                yield expression, "number", part.values

    def computed(self) -> Iterator[tuple[str, Expression]]:
        for part in self.parts:
            for expression in (part.is_, part.build):
                if expression is not None:
                    yield part.name, expression

    def fixed(self, reader: Reader, wheres: MappingOf[str, Fixing], used: set[str]) -> Segment:
        parts = tuple(part.fixed(reader, wheres[part.name]) if part.name in wheres else part for part in self.parts)
        used.update(part.name for part in self.parts)
        return replace(self, parts=parts)

    def resolved(self, references: References) -> Segment:
        """Return the segment with an unsigned type: the highest bit is a bit like the others."""
        return replace(self, type=replace(self.type, signed=False)) if self.type.is_whole_number else self

    def check(self) -> Iterator[Problem]:
        if not self.type.is_whole_number:
            yield Problem(self.at, "bits are taken from a whole number", "use of: u8, u16, hex, …")
            return
        size = self.type.fixed_size
        width = 0 if size is None else size * (4 if self.type.kind == "digits" else 8)
        taken: dict[int, str] = {}
        for part in self.parts:
            if size is not None and part.high >= width:
                yield Problem(part.at, f"bit {part.high} is beyond the {width} bits there are", "use a wider type")
            for place in range(part.low, min(part.high, 1024) + 1):
                if place in taken:
                    yield Problem(part.at, f"bit {place} belongs to '{taken[place]}' already", "give each bit one name")
                    break
                taken[place] = part.name
            yield from part.check()
