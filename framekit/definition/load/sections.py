"""The small sections: line, station, receiver, params, state, queues."""

from __future__ import annotations

from framekit.definition.expression.syntax import Bytes, Expression, List, Number, Text
from framekit.definition.load.reader import FLAGS, Reader, inside, literal_bytes
from framekit.definition.model.protocol import Line, Parameter, Queue, Receiver, StateVariable, StationType
from framekit.definition.nodes import Entry, Mapping, Node, Scalar, Sequence
from framekit.definition.problems import parted
from framekit.definition.times import parse_format

ITEM_TYPES = {name: name for name in ("time", "number", "flag", "text", "bytes")}
PARAMETER_TYPES = {name: name for name in ("time", "number", "flag", "choice", "text", "bytes", "list")}


def literal_or_expression(
    reader: Reader, node: Node, type_: str, choices: tuple[str, ...] = (), items_type: str | None = None
) -> Expression:
    """A default: literal where the type allows one to be told from an expression, else an expression. Raises Broken."""
    if isinstance(node, Sequence):
        items = tuple(literal_or_expression(reader, item, items_type or "number").root for item in node.items)
        return Expression("[…]", List(node.at, items))
    scalar = reader.scalar(node)
    text = scalar.text.strip()
    if type_ == "flag" and text.lower() in FLAGS:
        return Expression(text, Number(scalar.at, FLAGS[text.lower()]))
    if (type_ == "choice" and text in choices) or (type_ in ("text", "choice") and not text):
        return Expression(text, Text(scalar.at, text))
    if type_ == "bytes":
        try:
            return literal_bytes(scalar) if text else Expression("", Bytes(scalar.at, b""))
        except ValueError:
            return reader.expression(node)
    return reader.expression_text(scalar.text, inside(scalar))


def load_parameter(reader: Reader, entry: Entry) -> Parameter:
    """A named setting. Raises Broken."""
    keys = reader.mapping(entry.value)
    name = entry.key.text
    type_node = keys.get("type")
    if type_node is None:
        raise reader.broken(
            entry.key.at, f"parameter '{name}' has no type", "add type: time, number, flag, choice, text, bytes or list"
        )
    type_ = reader.one_of(type_node, PARAMETER_TYPES, "a type of parameter")
    choices = reader.texts(keys.get("of")) if type_ == "choice" else ()
    items = item_type(reader, keys.get("of")) if type_ == "list" else None
    default, formula = keys.get("default"), keys.get("is")
    if default is None and formula is None and type_ != "list":
        reader.warn(entry.key.at, f"parameter '{name}' has no default", "every run will have to give it")
    return Parameter(
        name=name,
        type=type_,  # type: ignore[arg-type]
        default=None if default is None else literal_or_expression(reader, default, type_, choices, items),
        is_=None if formula is None else reader.expression(formula),
        limits=reader.maybe(reader.range, keys.get("range")),
        choices=choices,
        doc=reader.maybe(reader.text, keys.get("doc")) or "",
        at=entry.key.at,
        items=items,  # type: ignore[arg-type]
        size=_size(reader, keys, type_, "parameter"),
    )


def item_type(reader: Reader, node: Node | None) -> str | None:
    """What the items of a list are, `of:` says it. Raises Broken."""
    return None if node is None else reader.one_of(node, ITEM_TYPES, "a type of items")


def load_state(reader: Reader, entry: Entry, values: object, announced: bool) -> StateVariable:
    """A variable of the link. `values`: names of its numbers, already read. Raises Broken."""
    keys = reader.mapping(entry.value)
    table = keys.get("table")
    type_ = layout = None
    if table is not None and (holds := keys.get("holds")) is not None:
        type_ = reader.text(holds)
    elif table is None and (list_node := keys.get("list")) is not None:
        type_, layout = "list", reader.text(list_node)
    elif table is None and (record := keys.get("record")) is not None:
        type_, layout = "record", reader.text(record)
    else:
        type_ = reader.maybe(reader.text, keys.get("type"))
    if type_ is None:
        todo = "add holds:" if table is not None else "add type:, list: or record:"
        raise reader.broken(entry.key.at, f"variable '{entry.key.text}' has no type", todo)
    initial, scope = keys.get("initial"), reader.maybe(reader.text, keys.get("scope")) or "line"
    return StateVariable(
        name=entry.key.text,
        scope=scope,  # type: ignore[arg-type]
        type=type_,
        initial=None if initial is None else literal_or_expression(reader, initial, type_),
        keys=reader.maybe(reader.range, table),
        layout=layout,
        most=reader.maybe(reader.number, keys.get("max")) if type_ == "list" else None,
        size=_size(reader, keys, type_, "variable"),
        publish=reader.flag(keys.get("publish")),
        values=values,  # type: ignore[arg-type]
        announced=announced,
        at=entry.key.at,
    )


def _size(reader: Reader, keys: Mapping, type_: str, thing: str) -> int | None:
    """The number of bytes of a variable or parameter; only bytes have one. Raises Broken."""
    node = keys.get("size")
    if node is not None and type_ != "bytes":
        raise reader.broken(node.at, f"a {thing} of type {type_} has no size", "remove it, or write type: bytes")
    return reader.maybe(reader.number, node)


def load_queue(reader: Reader, entry: Entry) -> Queue:
    """Raises Broken."""
    keys = reader.mapping(entry.value)
    holds = {item.key.text: reader.text(item.value) for item in reader.entries(keys.get("holds"))}
    size = keys.get("size")
    return Queue(name=entry.key.text, holds=holds, size=8 if size is None else reader.number(size), at=entry.key.at)


def load_receiver(reader: Reader, node: Node | None) -> Receiver:
    """Raises Broken."""
    if node is None:
        return Receiver()
    keys = reader.mapping(node)
    return Receiver(
        gap=reader.maybe(reader.expression, keys.get("gap")),
        quiet=reader.maybe(reader.expression, keys.get("quiet")),
        symbols=reader.maybe(reader.byte, keys.get("symbols")),
        resync=reader.maybe(reader.text, keys.get("resync")) or "next_start",  # type: ignore[arg-type]
    )


def load_station(reader: Reader, node: Node | None) -> StationType:
    """Raises Broken."""
    if node is None:
        return StationType()
    keys = reader.mapping(node)
    type_ = reader.maybe(reader.text, keys.get("type")) or "number"
    default, pad = keys.get("default"), keys.get("pad")
    if pad is not None and (type_ != "bytes" or "size" not in keys):
        reader.note(pad.at, "pad fills texts for stations of type bytes with a size", "leave pad out")
    return StationType(
        type=type_,  # type: ignore[arg-type]
        limits=reader.maybe(reader.range, keys.get("range")) if type_ == "number" else None,
        size=reader.maybe(reader.number, keys.get("size")) if type_ in ("text", "bytes") else None,
        pad=reader.maybe(reader.byte, pad),
        default=None if default is None else literal_or_expression(reader, default, type_),
    )


def load_line(reader: Reader, node: Node | None) -> Line:
    """Raises Broken."""
    if node is None:
        return Line()
    keys = reader.mapping(node)
    speed, speeds = _default(reader, keys.get("speed"))
    format_, formats = _default(reader, keys.get("format"))
    for scalar in formats or ([format_] if format_ else []):
        try:
            parse_format(scalar.text, 9600)
        except ValueError as error:
            reader.note(scalar.at, *parted(error))
    kind = reader.maybe(reader.text, keys.get("kind")) or "serial"
    return Line(
        kind=kind,  # type: ignore[arg-type]
        speed=9600 if speed is None else reader.number(speed),
        speeds=tuple(reader.number(item) for item in speeds),
        format="8N1" if format_ is None else format_.text,
        formats=tuple(item.text for item in formats),
        turnaround=reader.maybe(reader.expression, keys.get("turnaround")),
        key_delay=reader.maybe(reader.expression, keys.get("key_delay")),
        late=reader.maybe(reader.expression, keys.get("late")),
        tcp=reader.maybe(reader.number, keys.get("tcp")),
        at=keys.at,
    )


def _default(reader: Reader, node: Node | None) -> tuple[Scalar | None, list[Scalar]]:
    """A single value, or `{default, choices}`."""
    if node is None:
        return None, []
    if isinstance(node, Mapping):
        default = node.get("default")
        choices = [reader.scalar(item) for item in reader.items(node.get("choices"))]
        return (None if default is None else reader.scalar(default)), choices
    return reader.scalar(node), []
