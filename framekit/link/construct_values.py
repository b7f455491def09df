"""What the values of a definition come to: frame values, bytes of layouts, records and lists, worked out on names.

Compiled once, evaluated as often as needed. It knows neither sequences nor services; only `each` needs something from
outside, the list of variables that a service offers under the name `EACH`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from framekit.definition.expression import Expression
from framekit.definition.model import protocol as model
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, ReadAs, RecordOf, Value
from framekit.link.frame_table import FrameTable, ProtocolCodec, table_of
from framekit.link.values import FrameValue, Names, compile_expression, compile_optional, plain

Compute = Callable[[Names], Any]
MakeFrame = Callable[[str, dict[str, Any], Names], FrameValue]

EACH = "(each)"
"""The name (no word of the language) under which names hold one mapping of names a variable, for `{each: {…}}`."""


def compile_value(
    value: Value, protocol: model.Protocol, codec: ProtocolCodec, table: FrameTable | None = None
) -> Compute:
    """A function of names that gives the value: a `FrameValue`, bytes, a dict, a list, or what an expression gives.

    `table` spares making a new one. Evaluating raises `EVALUATION_ERRORS`; what a codec refuses is a ValueError.
    """
    return ValueCompiler(codec, (table or table_of(protocol, codec)).made).compile(value)


class ValueCompiler:
    """Compiles values; `make` makes the frame values of constructors."""

    def __init__(self, codec: ProtocolCodec, make: MakeFrame) -> None:
        self.layouts = codec.layouts
        self.make = make

    def compile(self, value: Value) -> Compute:
        """A function of names. Raises KeyError for a layout that the codec does not have."""
        match value:
            case Expression():
                return compile_expression(value)
            case FrameOf(frame=frame, fields=fields):
                return self._frame(frame, self.fields(fields))
            case LayoutOf(layout=layout, fields=fields):
                return self._layout(layout, self.fields(fields))
            case ReadAs(layout=layout, source=source):
                return self._read(layout, self.compile(source))
            case ListOf(items=items):
                parts = [self.compile(item) for item in items]
                return lambda names: [part(names) for part in parts]
            case RecordOf(fields=fields):
                return self.fields(fields)
            case EachOf(fields=fields, when=when):
                record, holds = self.fields(fields), compile_optional(when)
                if holds is None:
                    return lambda names: [record(Names(variable, names)) for variable in names[EACH]]
                return lambda names: [
                    record(known) for variable in names[EACH] if holds(known := Names(variable, names))
                ]
        raise TypeError(f"no value of a definition: {value!r}")

    def fields(self, fields: Mapping[str, Value]) -> Callable[[Names], dict[str, Any]]:
        """A function that gives the record of these fields."""
        compiled = [(name, self.compile(field)) for name, field in fields.items()]
        return lambda names: {name: compute(names) for name, compute in compiled}

    def _frame(self, frame: str, fields: Callable[[Names], dict[str, Any]]) -> Compute:
        make = self.make
        return lambda names: make(frame, fields(names), names)

    def _layout(self, layout: str, fields: Callable[[Names], dict[str, Any]]) -> Compute:
        encode = self.layouts[layout][0]
        return lambda names: encode(plain(fields(names)), names)

    def _read(self, layout: str, source: Compute) -> Compute:
        codec = self.layouts[layout]
        return lambda names: read_as(codec, source(names), names)


def read_as(codec: tuple[Callable[..., bytes], Callable[..., dict[str, Any]]], found: Any, names: Names) -> Any:
    """Bytes as the record of a layout, a record as its bytes."""
    encode, decode = codec
    return encode(plain(dict(found)), names) if isinstance(found, Mapping) else read_layout(decode, found, names)


def read_layout(decode: Callable[..., dict[str, Any]], data: bytes, names: Names) -> dict[str, Any]:
    """Reads bytes as a layout; bytes behind its end are padding without meaning. Raises ValueError."""
    try:
        return decode(data, names)
    except ValueError as error:
        end = getattr(error, "offset", None)
        if getattr(error, "cause", None) != "surplus" or not isinstance(end, int) or not 0 <= end < len(data):
            raise
        return decode(data[:end], names)
