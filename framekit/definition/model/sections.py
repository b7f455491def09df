"""The small sections: line, station, receiver, params, state, queues. Each class is the table of its keys."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from framekit.definition.expression import Bytes, Expression, List, Number, Text, real_number
from framekit.definition.given_values import GivenValue, given_value
from framekit.definition.keys import (
    BYTE,
    EXPRESSION,
    FLAG,
    LABEL,
    NUMBER,
    RANGE,
    TEXT,
    TIME,
    Form,
    KeyReading,
    key,
    keys,
    ref,
    words,
)
from framekit.definition.kinds.base import VALUE_NAMES
from framekit.definition.load.reader import FLAGS, Broken, Reader, inside, literal_bytes
from framekit.definition.problems import NOWHERE, Position, is_nearly, parted
from framekit.definition.times import parse_format
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Node, Scalar, Sequence

if TYPE_CHECKING:
    from framekit.definition.model.values import Constant

WITHOUT_NUMBER = re.compile(r"tcp(-listen)?://(\[[^\]]+\]|[^:/\[\]]+)/?")
"""URL of a connection to a host, or of a listener, without a port number."""
ITEM_TYPES = ("time", "number", "flag", "text", "bytes")
FLOAT_BITS = {"decimal": 0, "f32": 32, "f64": 64}
"""Types of parameters, arguments and variables whose values may have a fraction; 0 for exact ones."""
PARAMETER_TYPES = ("time", "number", "decimal", "flag", "choice", "text", "bytes", "list")

# ---- defaults and initial values ----------------------------------------------------------------------------


def _given(reading: KeyReading, node: Node) -> Expression:
    found = reading.found
    return _literal(reading.reader, node, found["type"], found.get("choices", ()), found.get("items"))


def _literal(
    reader: Reader, node: Node, type_: str, choices: tuple[str, ...] = (), items_type: str | None = None
) -> Expression:
    """Read a default: a literal if the type distinguishes it from an expression, else an expression. Raises Broken."""
    if isinstance(node, Sequence):
        items = tuple(_literal(reader, item, items_type or "number").root for item in node.items)
        return Expression("[…]", List(node.at, items))
    scalar = reader.scalar(node)
    text = scalar.text.strip()
    if type_ == "flag" and text.lower() in FLAGS:
        return Expression(text, Number(scalar.at, FLAGS[text.lower()]))
    if (type_ == "choice" and text in choices) or (type_ in ("text", "choice") and not text):
        return Expression(text, Text(scalar.at, text))
    real = real_number(text, scalar.at, FLOAT_BITS[type_]) if type_ in FLOAT_BITS else None
    if real is not None:
        return real
    if type_ == "bytes":
        try:
            return literal_bytes(scalar) if text else Expression("", Bytes(scalar.at, b""))
        except ValueError:
            return reader.expression(node)
    return reader.expression_text(scalar.text, inside(scalar))


GIVEN = Form(ref("plain_value"), _given)


def _size_in_bytes(thing: str) -> Form:
    """Return the reader for the size of a variable or parameter (bytes), which only the type bytes has."""

    def read(reading: KeyReading, node: Node) -> int:
        if (type_ := reading.found["type"]) != "bytes":
            what = f"a {thing} of type {type_} has no size"
            raise reading.reader.broken(node.at, what, "remove it, or write type: bytes")
        return reading.reader.number(node)

    return Form(NUMBER.schema, read)


# ---- line and receiver --------------------------------------------------------------------------------------


def _one_or_choices(reading: KeyReading, name: str) -> tuple[Scalar | None, list[Scalar]]:
    """Read a single value, or `{default, choices}`."""
    reader, node = reading.reader, reading.keys.get(name)
    if isinstance(node, Keys):
        choices = [reader.scalar(item) for item in reader.items(node.get("choices"))]
        return reader.maybe(reader.scalar, node.get("default")), choices
    return reader.maybe(reader.scalar, node), []


def _speed(reading: KeyReading) -> int:
    speed, _ = _one_or_choices(reading, "speed")
    return 9600 if speed is None else reading.reader.number(speed)


def _formats(reading: KeyReading) -> tuple[str, ...]:
    default, formats = _one_or_choices(reading, "format")
    for scalar in formats or ([default] if default else []):
        try:
            parse_format(scalar.text, 9600)
        except ValueError as error:
            reading.reader.note(scalar.at, *parted(error))
    return tuple(scalar.text for scalar in formats)


def _format(reading: KeyReading) -> str:
    default, _ = _one_or_choices(reading, "format")
    return "8N1" if default is None else default.text


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """Properties of the line of a protocol."""

    kind: Literal["serial", "stream"] = key(
        "kind", TEXT._replace(schema=words("a kind of line", "serial", "stream")), default="serial"
    )
    speeds: tuple[int, ...] = keys(
        {}, lambda r: tuple(r.reader.number(item) for item in _one_or_choices(r, "speed")[1]), default=()
    )
    """Possible speeds (bits a second)."""
    speed: int = keys({"speed": {}}, _speed, default=9600)
    formats: tuple[str, ...] = keys({}, _formats, default=())
    format: str = keys({"format": {}}, _format, default="8N1")
    turnaround: Expression | None = key("turnaround", TIME, default=None)
    key_delay: Expression | None = key("key_delay", TIME, default=None)
    clear_time: Expression | None = key("clear_time", TIME, default=None)
    """Longest time for which clear-to-send may hold back frames; None: no limit."""
    late: Expression | None = key("late", TIME, default=None)
    """Time after its time limit in which a reply may still arrive; None: as long as the limit itself."""
    tcp: int | None = key("tcp", NUMBER, default=None)
    """Port number for `tcp://HOST`."""
    at: Position = NOWHERE

    @property
    def has_marks(self) -> bool:
        """Return whether characters have a ninth bit, which marks a byte of each frame."""
        return self.kind == "serial" and self.format.strip().startswith("9")

    def port_of(self, url: str) -> str:
        """Return a port URL completed: `tcp://HOST` gets the protocol's own port number."""
        if self.tcp is None or not WITHOUT_NUMBER.fullmatch(url):
            return url
        return f"{url.rstrip('/')}:{self.tcp}"


def _place(node: Node | None) -> Position:
    return NOWHERE if node is None else node.at


_WAYS_ON = ("next_start", "after_frame", "after_quiet", "never")


@dataclass(frozen=True, slots=True, kw_only=True)
class Receiver:
    """Parameters for finding frames in the received bytes."""

    gap: Expression | None = key("gap", TIME, default=None)
    quiet: Expression | None = key("quiet", TIME, default=None)
    symbols: int | None = key("symbols", BYTE, default=None)
    """Escape byte that is skipped together with the next byte."""
    delimiter: int | None = key("delimiter", BYTE, default=None)
    """Byte with which frames begin and end; the end of a frame may be the begin of the next."""
    delimiter_at: Position = keys({}, lambda r: _place(r.keys.get("delimiter")), default=NOWHERE)
    resync: Literal["next_start", "after_frame", "after_quiet", "never"] = key(
        "resync", TEXT._replace(schema=words("a way to go on", *_WAYS_ON)), default="next_start"
    )
    break_ends: bool = key("break_ends", FLAG, default=False)
    """Whether a break ends a frame as silence does; else it damages a frame that only silence would end."""


# ---- the station --------------------------------------------------------------------------------------------


def _pad(reading: KeyReading, node: Node) -> int:
    if reading.found["type"] != "bytes" or "size" not in reading.keys:
        reading.reader.note(node.at, "pad fills texts for stations of type bytes with a size", "leave pad out")
    return reading.reader.byte(node)


def _if_type(name: str, form: Form, *types: str) -> Any:
    """Declare an attribute that a key gives only with these types; with others it has no effect."""

    def read(reading: KeyReading) -> Any:
        node = reading.keys.get(name) if reading.found["type"] in types else None
        return None if node is None else form.read(reading, node)

    return keys({name: form.schema}, read, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class StationType:
    """The type of station numbers or names."""

    type: Literal["number", "text", "bytes", "none"] = key(
        "type", TEXT._replace(schema=words("a type of station", "number", "text", "bytes", "none")), default="number"
    )
    limits: tuple[int, int] | None = _if_type("range", RANGE, "number")
    size: int | None = _if_type("size", NUMBER, "text", "bytes")
    pad: int | None = key("pad", Form(BYTE.schema, _pad), default=None)
    """Byte that fills up a text given for bytes of a known `size`."""
    default: Expression | None = key("default", GIVEN, default=None)


# ---- the probe ----------------------------------------------------------------------------------------------


def _constants(reading: KeyReading, node: Node) -> dict[str, Constant]:
    return reading.reader.by_name(reading.reader.entries(node), reading.reader.cell)


@dataclass(frozen=True, slots=True, kw_only=True)
class Probe:
    """A harmless request that shows whether a device is present: a read of an address, or the call of a service."""

    at: Position = NOWHERE
    read: str | None = key("read", TEXT, default=None)
    call: str | None = key("call", LABEL, default=None)
    arguments: Mapping[str, Constant] = key("with", Form({}, _constants), factory=dict)
    """Arguments of the service."""


# ---- parameters, variables, queues --------------------------------------------------------------------------


def _parameter_type(reading: KeyReading) -> str:
    reader, node = reading.reader, reading.keys.get("type")
    if node is None:
        what = f"parameter '{reading.found['name']}' has no type"
        todo = "add type: time, number, flag, choice, text, bytes or list"
        raise reader.broken(reading.found["at"], what, todo)
    return reader.one_of(node, {name: name for name in PARAMETER_TYPES}, "a type of parameter")


def _items(reading: KeyReading) -> str | None:
    """Return the type of the items of a list, from `of:`."""
    reader, node = reading.reader, reading.keys.get("of") if reading.found["type"] == "list" else None
    return None if node is None else reader.one_of(node, {name: name for name in ITEM_TYPES}, "a type of items")


def _formula(reading: KeyReading) -> Expression | None:
    found, formula = reading.found, reading.keys.get("is")
    if found["default"] is None and formula is None and found["type"] != "list" and "secret" not in reading.keys:
        what = f"parameter '{found['name']}' has no default"
        reading.reader.warn(found["at"], what, "every run will have to give it")
    return reading.reader.maybe(reading.reader.expression, formula)


def _secret(reading: KeyReading, node: Node) -> bool:
    """Read `secret`: it applies to keys and passwords, whose faults can be described without showing them."""
    if reading.found["type"] not in ("bytes", "text"):
        reading.reader.note(node.at, "secret keeps keys and passwords", "take type: bytes or text, or leave secret out")
    return reading.reader.flag(node)


_OF_CLIENT = Form(
    words("a side of a parameter", "client"),
    lambda r, node: r.reader.one_of(node, {"client": True}, "a side of a parameter"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A named setting."""

    name: str
    at: Position
    type: str = keys({"type": {}}, _parameter_type)
    """One of `PARAMETER_TYPES`."""
    choices: tuple[str, ...] = keys(
        {"of": {}},
        lambda r: r.reader.texts(r.keys.get("of")) if r.found["type"] == "choice" else (),
        default=(),
    )
    items: str | None = keys({}, _items, default=None)
    """Type of the items of a list; None for any."""
    default: Expression | None = key("default", GIVEN, default=None)
    is_: Expression | None = keys({"is": EXPRESSION.schema}, _formula, default=None)
    """Formula that always gives the value."""
    limits: tuple[int, int] | None = key("range", RANGE, default=None)
    """Least and greatest number; for a list, of each item."""
    doc: str = key("doc", TEXT, default="")
    size: int | None = key("size", _size_in_bytes("parameter"), default=None)
    """Number of bytes."""
    secret: bool = key("secret", Form(FLAG.schema, _secret), default=False)
    """Whether the value is never shown."""
    of_client: bool = key("from", _OF_CLIENT, default=False)
    """Whether only the client has it; a server takes it from the request."""

    @property
    def is_compared(self) -> bool:
        """Return whether a server ignores a request with another value: a value that both sides have, no secret, time
        or list.
        """
        is_shared = self.is_ is None and not self.of_client and not self.secret
        return is_shared and self.type in ("number", "text", "bytes")


@dataclass(frozen=True, slots=True, kw_only=True)
class Argument(Parameter):
    """An argument of a service other than read and write; also a record or a frame."""

    type: str = key("type", TEXT, default="number")
    is_: Expression | None = None
    size: int | None = None
    secret: bool = False
    of_client: bool = False


def _variable_type(reading: KeyReading) -> str:
    keys, is_table = reading.keys, "table" in reading.keys
    for name in () if is_table else ("list", "record"):
        if name in keys:
            return name
    node = (keys.get("holds") if is_table else None) or keys.get("type")
    if node is None:
        todo = "add holds:" if is_table else "add type:, list: or record:"
        raise reading.reader.broken(reading.found["at"], f"variable '{reading.found['name']}' has no type", todo)
    return reading.reader.text(node)


def _layout(reading: KeyReading) -> str | None:
    """Return the layout of the records of a variable that is no table."""
    if "table" in reading.keys or reading.found["type"] not in ("list", "record"):
        return None
    return reading.reader.maybe(reading.reader.text, reading.keys.get(reading.found["type"]))


def _initial(reading: KeyReading, node: Node) -> Expression | None:
    """Return the expression of a start value; None for a list, record or map of constants."""
    return None if _is_given(reading, node) else _given(reading, node)


def _given_start(reading: KeyReading) -> GivenValue | None:
    node = reading.keys.get("initial")
    return None if node is None or not _is_given(reading, node) else given_value(node)


def _is_given(reading: KeyReading, node: Node) -> bool:
    if "table" in reading.keys:
        return isinstance(node, Keys)
    return not isinstance(node, Scalar) and reading.found["layout"] is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class StateVariable:
    """A variable of the link."""

    name: str
    at: Position
    announced: bool
    """Whether frames announce it."""
    values: Mapping[int, str] | None = key("values", VALUE_NAMES, default=None)
    type: str = keys({"type": {}, "list": {}, "record": {}, "holds": {}}, _variable_type)
    """One of u8…u64, i8…i64, f32, f64, flag, text, bytes, time, list, record, frame."""
    layout: str | None = keys({}, _layout, default=None)
    initial: Expression | None = key("initial", Form(ref("any_value"), _initial), default=None)
    given: GivenValue | None = keys({}, _given_start, default=None)
    scope: Literal["line", "session", "device"] = key("scope", TEXT, default="line")
    keys: tuple[int, int] | None = key("table", RANGE, default=None)
    """Range of keys, for a table; else None."""
    most: int | None = _if_type("max", NUMBER, "list")
    size: int | None = key("size", _size_in_bytes("variable"), default=None)
    """Required number of bytes."""
    publish: bool = key("publish", FLAG, default=False)

    def number_of(self, value: Any) -> Any:
        """Return the number that a name of `values` stands for; any other value unchanged."""
        return next((number for number, name in (self.values or {}).items() if name == value), value)


def _holds(reading: KeyReading) -> dict[str, str]:
    given = reading.keys.keys()
    if "holds" not in given and any(is_nearly("holds", word) for word in given):
        raise Broken("the schema has reported a misspelt key")
    return reading.reader.by_name(reading.reader.entries(reading.keys.get("holds")), reading.reader.text)


@dataclass(frozen=True, slots=True, kw_only=True)
class Queue:
    """A queue between lanes: fields of an item (name → type) and its capacity."""

    name: str
    at: Position
    holds: Mapping[str, str] = keys({"holds": {}}, _holds, factory=dict)
    size: int = key("size", NUMBER, default=8)
