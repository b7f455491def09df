"""`field`: one value."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from collections.abc import Mapping as MappingOf
from dataclasses import dataclass, replace
from itertools import islice
from typing import ClassVar

from framekit.definition.expression import Bytes, Expression, Real, Text, real_number
from framekit.definition.keys import (
    ADDRESS,
    IDENTIFIER,
    NUMBER,
    RANGE,
    Form,
    KeyReading,
    ValueKind,
    key,
    mapping_of,
    mapping_schema,
    ref,
    words,
)
from framekit.definition.kinds.base import (
    VALUE_NAMES,
    Contents,
    Fixing,
    Given,
    Segment,
    bytes_of_number,
    constant_number,
    limits_that_do_not_fit,
    number_written,
    too_large,
    zero_with_a_sign,
)
from framekit.definition.load.reader import Reader, literal_bytes
from framekit.definition.problems import Position, Problem
from framekit.definition.times import format_time
from framekit.definition.tree import Node, Scalar
from framekit.definition.wire_types import EVERY_BYTE, FieldType, Sizes, type_keys


@dataclass(frozen=True, slots=True, kw_only=True)
class Long:
    """Values from `mark` on are written as the mark and a second, longer number."""

    mark: int = key("mark", NUMBER, "The number that says: the long form follows.")
    type: FieldType = type_keys(
        "type", "Type of the long form.", size="Number of bytes or digits of the long form.", case=False
    )


def _given(reading: KeyReading, node: Node) -> Expression:
    """Return a default: bytes for a field of bytes, an empty text for an empty scalar, else an expression."""
    reader = reading.reader
    scalar = reader.scalar(node)
    if reading.found["type"].kind == "bytes" and not scalar.text.strip().startswith("h'"):
        try:
            return literal_bytes(scalar)
        except ValueError:
            return reader.expression(node)
    type_ = reading.found["type"]
    if type_.has_fractions:
        real = real_number(scalar.text, scalar.at, type_.float_bits)
        if real is not None:
            return real
    return reader.expression_text(scalar.text or "''", scalar.at)


def _only(reading: KeyReading, node: Node) -> bool:
    if reading.found["values"] is None:
        reading.reader.note(reading.keys.at, "only: values needs values", "add values: with a table")
    return reading.found["values"] is not None


GIVEN = Form(ref("text"), _given)
UNIT_OF_TIME = Form(
    {
        "type": "string",
        "pattern": "^\\s*([0-9]+(\\.[0-9]+)?\\s*)?(ns|us|ms|s|min|h|d)\\s*$",
        "x-expected": "a unit of time (ms or 10 ms)",
    },
    lambda r, node: r.reader.time(node),
)
LONG = mapping_of(
    Long,
    mapping_schema(Long, "long form", description="Values from the mark on are sent as the mark and a longer number."),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Field(Segment):
    """A value. `is_` always computes it; `build` and `default` apply if no value is given."""

    KEY: ClassVar[str] = "field"
    VALUE: ClassVar[ValueKind | None] = "any"
    HINTS: ClassVar[MappingOf[str, str]] = {
        "signed": "write a type that has a sign, such as i16; in text type: decimal, with sign: minus, always or space",
        "precision": "write decimals:",
        "separator": "write end:, or repeat: with a separator",
        "factor": "write scale:",
        "multiplier": "write scale:",
    }

    name: str = key("field", IDENTIFIER, "Name of the value.")
    type: FieldType = type_keys(
        "type",
        "How the value is written: u8 to u64, i8 to i64, f32, f64, uint, hex, dec, oct, bcd, decimal, ascii, bytes.",
        texts=True,
    )
    values: MappingOf[int, str] | None = key(
        "values", VALUE_NAMES, "Names of the numbers: a table, or code: name.", default=None
    )
    only: bool = key(
        "only",
        Form(words("a limit", "values"), _only),
        "values: numbers without a name are refused.",
        default=False,
    )
    """Whether numbers without a name in `values` are refused."""
    is_: Expression | None = key(
        "is", GIVEN, "Always this; computed when building, compared when reading.", default=None
    )
    build: Expression | None = key("build", GIVEN, "Computed when building, if no value is given.", default=None)
    default: Expression | None = key(
        "default",
        GIVEN,
        "Used when building, if no value is given and there is no build; the value of a field that is absent by when.",
        default=None,
    )
    limits: tuple[int, int] | None = key("range", RANGE, "Least and greatest value, 1..16.", default=None)
    """Least and greatest value."""
    plus: int = key("plus", NUMBER, "The number on the wire is the value plus this.", default=0)
    """Number on the wire = value + plus."""
    unit: int | None = key(
        "unit", UNIT_OF_TIME, "The value is a time; the number on the wire counts this.", default=None
    )
    """For a time: number on the wire × unit nanoseconds."""
    long: Long | None = key("long", LONG, default=None)
    zero_means: int | None = key("zero_means", NUMBER, "The value that a 0 on the wire means.", default=None)
    """Value that a 0 on the wire means."""
    constants: tuple[int | str | bytes, ...] | None = None
    """Values fixed by `where` of the frame; the first is sent."""
    memory: str | None = key(
        "memory", ADDRESS, "Default address of the value for SEND and RECEIVE blocks.", default=None
    )

    @property
    def number_type(self) -> FieldType:
        return self.type

    @property
    def span(self) -> tuple[int, int] | None:
        """Return the least and the greatest number it can be sent with; None for a value that is no plain number."""
        bounds = self.type.bounds
        if bounds is None or self.unit is not None or self.long is not None or self.zero_means is not None:
            return None
        low, high = self.limits or (bounds[0] - self.plus, bounds[1] - self.plus)
        return max(low, bounds[0] - self.plus), min(high, bounds[1] - self.plus)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        sizes = self.type.sizes
        return sizes if self.long is None else Sizes(sizes.least, (sizes + self.long.type.sizes).most)

    @property
    def wire_values(self) -> tuple[int | str | bytes, ...] | None:
        """Return its possible values on the wire by `where`, `is` or `only: values`; None if these do not restrict
        them.
        """
        allowed: tuple[int | str | bytes, ...] | None = None
        if self.constants is not None:
            allowed = self.constants
        elif (number := constant_number(self.is_)) is not None:
            allowed = (number,)
        elif self.only and self.values is not None:
            allowed = tuple(self.values)
        if allowed is None or self.unit is not None or self.zero_means is not None:
            return None
        return tuple(value + self.plus if isinstance(value, int) else value for value in allowed)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        if self.long is not None:
            return EVERY_BYTE
        values = None if self.refuse is not None else self.wire_values
        forms = [None] if values is None else [self.type.plain_bytes(value) for value in values]
        if None not in forms:
            return frozenset(byte for form in forms for byte in form or b"")
        return self.type.contents if self.unit is not None else bytes_of_number(self, self.plus)

    def value_kinds(self) -> Iterator[tuple[str, ValueKind]]:
        yield self.name, self.value_kind

    @property
    def value_kind(self) -> ValueKind:
        if self.values is not None:
            return "any"
        return self.type.value_kind if self.unit is None else "time"

    def numbers_with_names(self) -> Iterator[tuple[str, MappingOf[int, str] | None]]:
        yield self.name, self.values

    @property
    def wanted_names(self) -> tuple[str, ...]:
        given = (self.is_, self.build, self.default, self.constants)
        return (self.name,) if all(one is None for one in given) else ()

    @property
    def given_names(self) -> tuple[str, ...]:
        return (self.name,) if self.is_ is None else ()

    @property
    def may_be_given(self) -> bool:
        return self.is_ is None

    def needed(self) -> Iterator[tuple[str, Expression]]:
        yield from Segment.needed(self)
        if self.when is not None and self.default is not None:
            yield "default of what may be absent", self.default

    def given(self) -> Iterator[Given]:
        yield from Segment.given(self)
        for expression in (self.is_, self.build, self.default):
            yield expression, self.value_kind, self.values

    def computed(self) -> Iterator[tuple[str, Expression]]:
        for expression in (self.is_, self.build, self.default):
            if expression is not None:
                yield self.name, expression

    # ---- `where` ------------------------------------------------------------------------------------------

    def fixed(self, reader: Reader, wheres: MappingOf[str, Fixing], used: set[str]) -> Segment:
        if self.name not in wheres:
            return self
        used.add(self.name)
        where = wheres[self.name]
        if where.build is not None:
            return replace(self, build=where.build)
        constants = tuple(self._constant(reader, scalar) for scalar in where.constants)
        for scalar, constant in zip(where.constants, constants, strict=True):
            self._fits(reader, scalar, constant)
        return replace(self, constants=constants)

    def _constant(self, reader: Reader, scalar: Scalar) -> int | str | bytes:
        if self.type.value_kind == "text":
            return scalar.text
        named = scalar.text in (self.values or {}).values()
        if self.unit is not None and not named and not scalar.text.isdigit():
            return reader.time(scalar)
        return reader.bytes(scalar) if self.type.value_kind == "bytes" else number_written(reader, self, scalar)

    def _fits(self, reader: Reader, scalar: Scalar, constant: int | str | bytes) -> None:
        """Note a constant that does not have the size of its field, or contradicts the keys of the field."""
        if isinstance(constant, int):
            self._number_fits(reader, scalar, constant)
            return
        size = self.type.fixed_size
        padded = self.type.pad is not None
        if size is not None and (len(constant) > size or (len(constant) < size and not padded)):
            what = f"'{scalar.text}' has {len(constant)} bytes, '{self.name}' has {size}"
            reader.note(scalar.at, what, "shorten it" if padded else "correct it, or add pad: to the field")

    def _number_fits(self, reader: Reader, scalar: Scalar, number: int) -> None:
        bounds, unit = self.type.bounds if self.long is None else None, self.unit or 1
        if number % unit:
            what = f"{scalar.text} is between two values of '{self.name}', which counts {format_time(unit)}"
            reader.note(scalar.at, what, "correct one of them")
        elif bounds is not None and not bounds[0] <= number // unit + self.plus <= bounds[1]:
            write = str if self.unit is None else format_time
            low, high = (write((one - self.plus) * unit) for one in bounds)
            what = f"{scalar.text} does not fit: '{self.name}' holds {low} to {high}"
            reader.note(scalar.at, what, "use a wider type, or correct it")
        else:
            reader.problems.extend(islice(self._allowed(number, scalar.at), 1))

    def _allowed(self, number: int, at: Position) -> Iterator[Problem]:
        """Report a constant that contradicts the keys of the field about its values."""
        if self.limits is not None and self.unit is None and not self.limits[0] <= number <= self.limits[1]:
            low, high = self.limits
            yield Problem(at, f"{number} is not in {low}..{high}, the range of '{self.name}'", "correct one of them")
        if self.only and self.values is not None and number not in self.values:
            yield Problem(at, f"{number} has no name in the values of '{self.name}'", "add it there, or correct it")

    # ---- checking -----------------------------------------------------------------------------------------

    def check(self) -> Iterator[Problem]:
        yield from self._contradictions()
        if not self.type.is_whole_number:
            yield from self._no_number()
            return
        if self.type.kind == "digits" and isinstance(self.type.size, int) and self.type.size > 32:
            yield Problem(self.at, f"a number of {self.type.size} digits is too long", "use data: for it")
        if self.long is not None and isinstance(self.type.size, Expression):
            what = f"'{self.name}' has a computed size, so its mark for long: has none"
            yield Problem(self.at, what, "give a size that is a number, or leave long out")
        if self.only and self.long is not None:
            yield Problem(self.at, "only: values cannot go with long:", "leave one of them out")
        bounds = self.type.bounds
        if bounds is not None and self.long is not None and not bounds[0] <= self.long.mark <= bounds[1]:
            what = f"the mark {self.long.mark} does not fit: '{self.name}' holds {bounds[0]} to {bounds[1]}"
            yield Problem(self.at, what, "give a mark that it can hold, or use a wider type")
        if bounds is not None and self.long is None:
            yield from self._numbers(bounds)
        if self.unit is not None and any(0 < limit < self.unit for limit in self.limits or ()):
            what = f"the range of '{self.name}' is between two of its values: it counts {format_time(self.unit)}"
            yield Problem(self.at, what, "write times, such as 1 s..5 s")
        yield from zero_with_a_sign(self)

    def _contradictions(self) -> Iterator[Problem]:
        given = [key for key, value in (("build", self.build), ("default", self.default)) if value is not None]
        if self.is_ is not None and given:
            what = f"is: computes '{self.name}' always, {given[0]}: has no effect"
            yield Problem(self.at, what, "leave one of them out")
        if self.is_ is not None and self.constants is not None:
            yield Problem(self.at, f"'{self.name}' is computed by is: and fixed by where:", "leave one of them out")
        names: dict[str, int] = {}
        for number, name in (self.values or {}).items():
            if name in names:
                what = f"the name '{name}' stands for {names[name]} and for {number}"
                yield Problem(self.at, what, "give each number its own name", warning=True)
            names[name] = number

    def _no_number(self) -> Iterator[Problem]:
        """Report keys that are for numbers only, and computed constants that are not as long as the field."""
        is_float = self.type.value_kind == "number"
        kind = {"text": "text", "bytes": "bytes"}.get(self.type.value_kind, "a number with a fraction")
        present_keys = {
            "range": self.limits is not None and not is_float,
            "plus": self.plus != 0,
            "unit": self.unit is not None,
            "long": self.long is not None,
            "zero_means": self.zero_means is not None,
            "values": self.values is not None,
        }
        for key_ in (name for name, is_there in present_keys.items() if is_there):
            yield Problem(self.at, f"{key_}: belongs to whole numbers, '{self.name}' is {kind}", f"leave {key_} out")
        if self.limits is not None and self.type.form is not None and self.type.form.empty:
            what = f"'{self.name}' may be empty, and nothing is in no range"
            yield Problem(self.at, what, "leave empty or range out")
        for given in (self.is_, self.build, self.default):
            if given is not None and isinstance(given.root, Real) and not self.type.writes(given.root.value):
                what = f"{given} does not fit: it is between two values of '{self.name}'"
                yield Problem(given.at, what, "correct one of them")
        root = None if self.is_ is None else self.is_.root
        if isinstance(root, (Text, Bytes)):
            yield from self._size_of_constant(root.value)

    def _size_of_constant(self, constant: str | bytes) -> Iterator[Problem]:
        size, padded = self.type.fixed_size, self.type.pad is not None
        if size is None or (len(constant) <= size if padded else len(constant) == size):
            return
        shown = f"'{constant}'" if isinstance(constant, str) else constant.hex(" ").upper()
        what = f"{shown} has {len(constant)} bytes, '{self.name}' has {size}"
        yield Problem(self.at, what, "correct one of them" if padded else "correct it, or add pad:")

    def _numbers(self, bounds: tuple[int, int]) -> Iterator[Problem]:
        """Report numbers that do not fit into the field: names, limits, and constant expressions."""
        if self.unit is None:
            yield from limits_that_do_not_fit(self, self.plus)
        for number in self.values or ():
            if not bounds[0] <= number + self.plus <= bounds[1]:
                yield too_large(self, number, bounds, self.at)
        for expression in (self.is_, self.build, self.default):
            given = constant_number(expression)
            if expression is None or given is None or self.unit is not None:
                continue
            if not bounds[0] <= given + self.plus <= bounds[1]:
                yield too_large(self, given, bounds, expression.at)
            else:
                yield from self._allowed(given, expression.at)
