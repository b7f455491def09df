"""What kinds that hold a number have in common: constants that fit, limits, a meaning of 0, names of numbers."""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping as MappingOf
from typing import Any
from typing import Protocol as Interface

from framekit.definition.expression.syntax import Expression, Number, Unary
from framekit.definition.keys import Form, Meanings, ref
from framekit.definition.load.reader import Reader, parse_number
from framekit.definition.problems import Position, Problem, did_you_mean
from framekit.definition.tree import Mapping, Node, Scalar
from framekit.definition.wire_types import FieldType


class Numbered(Interface):
    """A segment with one number."""

    @property
    def at(self) -> Position: ...
    @property
    def name(self) -> str: ...
    @property
    def type(self) -> FieldType: ...
    @property
    def plus(self) -> int: ...
    @property
    def limits(self) -> tuple[int, int] | None: ...
    @property
    def zero_means(self) -> int | None: ...


def value_names(space: Meanings, node: Node) -> MappingOf[int, str]:
    """Names of numbers: a table's name, or a mapping code: name. Raises Broken."""
    reader = space.reader
    if isinstance(node, Mapping):
        return {reader.number(entry.key): reader.text(entry.value) for entry in node.read_all()}
    name = reader.text(node)
    table = space.table(name)
    if table is None:
        raise reader.unknown(node.at, "table", name, list(space.section("tables")))
    return {key: str(text) for key, text in table.entries.items() if isinstance(key, int)}


VALUE_NAMES = Form(ref("value_names"), lambda r, node: value_names(r.space, node))


def constant_number(expression: Expression | None) -> int | None:
    """The number, if the expression is just one."""
    match expression.root if expression is not None else None:
        case Number(value=value, is_time=False):
            return value
        case Unary(operator="-", operand=Number(value=value, is_time=False)):
            return -value
    return None


def limits_that_do_not_fit(segment: Numbered, plus: int = 0) -> Iterator[Problem]:
    bounds = segment.type.bounds
    if bounds is not None and segment.limits is not None:
        for number in segment.limits:
            if not bounds[0] <= number + plus <= bounds[1]:
                yield too_large(segment, number, bounds, segment.at)
                return


def too_large(segment: Numbered, number: int, bounds: tuple[int, int], at: Position) -> Problem:
    what = f"{number} does not fit: '{segment.name}' holds {bounds[0] - segment.plus} to {bounds[1] - segment.plus}"
    return Problem(at, what, "use a wider type")


def zero_with_a_sign(segment: Numbered) -> Iterator[Problem]:
    if segment.zero_means is not None and segment.type.signed:
        what = f"'{segment.name}' has a sign: its 0 stands between other numbers and cannot mean {segment.zero_means}"
        yield Problem(segment.at, what, "take a type without sign, or leave zero_means out")


def number_written(reader: Reader, holder: Any, scalar: Scalar) -> int:
    """A number, or a name of one among the `values` of a field or of bits. Raises Broken."""
    for number, name in (holder.values or {}).items():
        if name == scalar.text:
            return int(number)
    try:
        return parse_number(scalar.text)
    except ValueError as error:
        what, _, todo = str(error).partition(" – ")
        if holder.values:
            what = f"'{scalar.text}' is neither a number nor a name in the values of '{holder.name}'"
            todo = did_you_mean(scalar.text, holder.values.values())
        raise reader.broken(scalar.at, what, todo) from None
