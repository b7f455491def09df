"""Requests compared with what a service row writes down, so that names get the values the request holds for them.

What cannot be read backwards is passed over; `station` and `own` are not compared. What the names mean is decided
elsewhere. Language reference, section 11 (read backwards).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, RecordOf, Value
from framekit.link.construct_values import read_layout
from framekit.link.evaluate import EVALUATION_ERRORS, Names, compile_expression
from framekit.link.frame_table import Codec, FrameTable
from framekit.link.invert import Inverse, bare_name, inverse_of, is_constant
from framekit.link.service_rows import padded_names
from framekit.link.values import FrameValue, attribute

NOT_COMPARED = frozenset({"station", "own"})


class MismatchError(Exception):
    """The request is not what the row writes down."""


class DamagedBufferError(Exception):
    """Bytes of a request do not have the layout they should; `refuse` is the code for that, if there is one."""

    def __init__(self, cause: ValueError) -> None:
        super().__init__(str(cause))
        self.refuse: int | None = getattr(cause, "refuse", None)


@dataclass(slots=True)
class Binding:
    """What was read: names with values, results whose names are still to be worked out, one binding a variable.

    `item`: the fields of the item that a variable is, of all lists that have one for each.
    """

    values: dict[str, Any] = field(default_factory=dict)
    pending: list[tuple[Inverse, int]] = field(default_factory=list)
    variables: list[Binding] | None = None
    item: dict[str, Any] = field(default_factory=dict)
    padded: bool = False

    def bind(self, name: str, value: Any) -> None:
        """Raises MismatchError when the name already has another value."""
        if self.values.setdefault(name, value) != value:
            raise MismatchError(name)


Match = Callable[[Any, Binding, Names], None]


def passed_over(actual: Any, binding: Binding, names: Names) -> None:
    """Nothing is read or compared here."""


class LeafCompiler:
    """Makes matchers of the values of a row."""

    def __init__(self, protocol: Protocol, codec: Codec, table: FrameTable) -> None:
        self.protocol = protocol
        self.codec = codec
        self.table = table

    def match(self, value: Value, numbers: Mapping[str, int] | None = None, padded: bool = False) -> Match:
        """A matcher. `numbers` are those with names of the field it stands in, `padded` says that it is filled up."""
        match value:
            case Expression():
                return _leaf(value, numbers or {}, padded)
            case FrameOf(frame=frame, fields=fields):
                info = self.table.infos[frame]
                padding = padded_names(self.protocol.frames[frame].segments)
                return _frame(frame, self._fields(fields, info.numbers, padding))
            case RecordOf(fields=fields):
                return self._fields(fields, {}, frozenset())
            case LayoutOf(layout=layout, fields=fields):
                padding = padded_names(self.protocol.layouts[layout].segments)
                return _layout(self.codec.layouts[layout][1], self._fields(fields, {}, padding), padded)
            case ListOf(items=items):
                return _list([self.match(item) for item in items])
            case EachOf(fields=fields):
                return _each(self._fields(fields, {}, frozenset()))
        return passed_over

    def _fields(
        self, fields: Mapping[str, Value], numbers: Mapping[str, Mapping[str, int]], padding: frozenset[str]
    ) -> Match:
        compiled = [(name, self.match(value, numbers.get(name), name in padding)) for name, value in fields.items()]
        wanted = [(name, match) for name, match in compiled if match is not passed_over]

        def match_fields(actual: Any, binding: Binding, names: Names) -> None:
            for name, match in wanted:
                try:
                    part = attribute(actual, name)
                except (KeyError, AttributeError):
                    raise MismatchError(name) from None
                match(part, binding, names)

        return match_fields


def _leaf(expression: Expression, numbers: Mapping[str, int], padded: bool) -> Match:
    if is_constant(expression):
        constant = compile_expression(expression)(Names())
        if isinstance(constant, str):
            constant = numbers.get(constant, constant)
        return _beginning(constant) if padded and isinstance(constant, bytes) else _constant(constant)
    name = bare_name(expression)
    if name is not None:
        return passed_over if name in NOT_COMPARED else _name(name, padded)
    inverse = inverse_of(expression)
    return passed_over if inverse is None or inverse.name in NOT_COMPARED else _result(inverse)


def _constant(constant: Any) -> Match:
    def match(actual: Any, binding: Binding, names: Names) -> None:
        if actual != constant:
            raise MismatchError(repr(constant))

    return match


def _beginning(constant: bytes) -> Match:
    """Bytes that padding follows."""

    def match(actual: Any, binding: Binding, names: Names) -> None:
        if not isinstance(actual, bytes) or not actual.startswith(constant):
            raise MismatchError(repr(constant))

    return match


def _name(name: str, padded: bool) -> Match:
    def match(actual: Any, binding: Binding, names: Names) -> None:
        binding.bind(name, actual)
        if name == "data":
            binding.padded = padded

    return match


def _result(inverse: Inverse) -> Match:
    def match(actual: Any, binding: Binding, names: Names) -> None:
        if not isinstance(actual, int):
            raise MismatchError(inverse.name)
        binding.pending.append((inverse, actual))

    return match


def _frame(frame: str, fields: Match) -> Match:
    def match(actual: Any, binding: Binding, names: Names) -> None:
        if type(actual) is not FrameValue or actual.frame != frame:
            raise MismatchError(frame)
        fields(actual, binding, names)

    return match


def _layout(decode: Callable[..., dict[str, Any]], fields: Match, padded: bool) -> Match:
    """Bytes that must be the layout, and nothing more unless they are `padded`."""

    def match(actual: Any, binding: Binding, names: Names) -> None:
        try:
            record = read_layout(decode, actual, names) if padded else decode(actual, names)
        except EVALUATION_ERRORS as error:
            raise DamagedBufferError(error if isinstance(error, ValueError) else ValueError(explain(error))) from None
        fields(record, binding, names)

    return match


def _list(items: list[Match]) -> Match:
    def match(actual: Any, binding: Binding, names: Names) -> None:
        if not isinstance(actual, list) or len(actual) != len(items):
            raise MismatchError("list")
        for item, part in zip(items, actual, strict=True):
            item(part, binding, names)

    return match


def _each(fields: Match) -> Match:
    def match(actual: Any, binding: Binding, names: Names) -> None:
        if not isinstance(actual, list):
            raise MismatchError("list")
        if binding.variables is None:
            binding.variables = [Binding() for _ in actual]
        elif len(binding.variables) != len(actual):
            raise MismatchError("list")  # several lists speak of the same variables
        for part, one in zip(actual, binding.variables, strict=True):
            if isinstance(part, dict):
                one.item = {**one.item, **part} if one.item else part
            fields(part, one, names)

    return match
