"""Areas, services, errors and the server's refusals."""

from __future__ import annotations

from framekit.definition.expression.syntax import Expression, Text
from framekit.definition.load.commands import CommandLoader
from framekit.definition.load.reader import MOST_ELEMENTS, Reader
from framekit.definition.load.sections import item_type, literal_or_expression
from framekit.definition.load.types import given_order
from framekit.definition.load.values import ValueLoader
from framekit.definition.model.services import (
    UNIT_BITS,
    Area,
    Argument,
    Errors,
    Limit,
    NameTable,
    Packing,
    Refusal,
    ReplyRow,
    ServeWork,
    ServiceRow,
)
from framekit.definition.model.values import Constant, Value
from framekit.definition.nodes import Entry, Mapping, Node, Scalar
from framekit.definition.problems import did_you_mean

UNIT_WORDS = (*UNIT_BITS, "own")
AREA_KEYS = {"unit", "size", "access", "code", "memory", "layout", "type", "about"}


def load_area(reader: Reader, entry: Entry) -> Area:
    """An area of a device. Raises Broken."""
    keys, name = reader.mapping(entry.value), entry.key.text
    codes = _codes(reader, keys)
    unit_node = keys.get("unit")
    unit = reader.text(unit_node) if unit_node is not None else next(iter(codes), "")
    if not unit:
        raise reader.broken(entry.key.at, f"area '{name}' has no unit", "add unit: bit, byte, word, dword or lword")
    size = keys.get("size")
    memory = reader.maybe(reader.text, keys.get("memory")) or name
    return Area(
        name=name,
        unit=unit,
        element_bits=unit_bits(reader, unit, unit_node or entry.key),
        size=0x10000 if size is None else reader.count(size, MOST_ELEMENTS, f"elements of area '{name}'"),
        access="read" if (reader.maybe(reader.text, keys.get("access")) or "rw") == "read" else "rw",
        codes={unit: codes[""]} if "" in codes else codes,
        memory=memory,
        layout=reader.maybe(reader.text, keys.get("layout")),
        columns={
            column.key.text: _constant(reader, column.value)
            for column in keys.read_all()
            if column.key.text not in AREA_KEYS
        },
        at=entry.key.at,
        type=reader.maybe(reader.text, keys.get("type")),
    )


def unit_bits(reader: Reader, unit: str, node: Node) -> int:
    """Width of a unit: a word of the language, or `6 bytes`. Raises Broken."""
    if unit in UNIT_BITS:
        return UNIT_BITS[unit]
    count, _, rest = unit.partition(" ")
    if count.isdigit() and rest in ("bytes", "byte"):
        return int(count) * 8
    raise reader.broken(node.at, f"'{unit}' is not a unit", did_you_mean(unit, [*UNIT_BITS, "6 bytes"]))


def _codes(reader: Reader, keys: Mapping) -> dict[str, Constant]:
    node = keys.get("code")
    if node is None:
        return {}
    if isinstance(node, Mapping):
        return {entry.key.text: _constant(reader, entry.value) for entry in node.read_all()}
    return {"": _constant(reader, node)}


def _constant(reader: Reader, node: Node) -> Constant:
    return reader.cell(node)


class ServiceLoader:
    """Reads the sections `services`, `errors` and `server`."""

    def __init__(self, values: ValueLoader) -> None:
        self.values = values
        self.reader: Reader = values.reader
        self.commands = CommandLoader(values, self._word_or_value)

    def rows(self, entry: Entry) -> tuple[ServiceRow, ...]:
        """The rows of one service, in order; broken ones are left out."""
        found = []
        for number, item in enumerate(self.reader.items(entry.value)):
            with self.reader.going_on():
                found.append(self._row(entry.key.text, number, self.reader.mapping(item)))
        return tuple(found)

    def _row(self, service: str, number: int, keys: Mapping) -> ServiceRow:
        reader, values = self.reader, self.values
        request, buffer, serve = keys.get("request"), keys.get("buffer"), keys.get("serve")
        variables, back = keys.get("variables"), keys.get("back")
        each = None if back is None else reader.mapping(back).get("each")
        variables = None if variables is None else reader.mapping(variables)
        most = None if variables is None else variables.get("max")
        align = keys.get("align")
        return ServiceRow(
            service=service,
            name=reader.maybe(reader.text, keys.get("name")) or f"{service} {number + 1}",
            at=keys.at,
            areas=reader.texts(keys.get("areas")),
            units=reader.texts(keys.get("units")),
            when=reader.maybe(reader.expression, keys.get("when")),
            limit=self._limit(keys.get("limit")),
            align_bits=1 if align is None else reader.number(reader.mapping(align).get("bits")),
            most_variables=0 if variables is None else (1 if most is None else reader.number(most)),
            same=None if variables is None else reader.maybe(reader.text, variables.get("same")),
            takes=tuple(load_argument(reader, argument) for argument in reader.entries(keys.get("takes"))),
            request=None if request is None else values.frame_of(request),
            buffer=None if buffer is None else values.value(buffer),
            reply=self._replies(keys.get("reply")),
            packing=self._packing(keys.get("packing")),
            gives=values.fields(keys.get("gives")),
            run=self._run(keys.get("run")),
            back=values.expressions(back, besides="each"),
            back_each=values.expressions(each),
            refuse=tuple(self.refusal(item) for item in reader.items(keys.get("refuse"))),
            serve=None if serve is None else self._work(serve),
            client_only=reader.flag(keys.get("client_only")),
            server_only=reader.flag(keys.get("server_only")),
            outside_session=reader.flag(keys.get("outside_session")),
        )

    def _limit(self, node: Node | None) -> Limit:
        if node is None:
            return Limit()
        reader, keys = self.reader, self.reader.mapping(node)
        return Limit(
            count=reader.maybe(reader.expression, keys.get("count")),
            bytes=reader.maybe(reader.expression, keys.get("bytes")),
        )

    def _packing(self, node: Node | None) -> Packing:
        if node is None:
            return Packing()
        reader, keys = self.reader, self.reader.mapping(node)
        bits = reader.maybe(reader.text, keys.get("bits")) or "packed"
        return Packing(order=given_order(reader, keys) or "little", bits=bits)  # type: ignore[arg-type]

    def _replies(self, node: Node | None) -> tuple[ReplyRow, ...]:
        return tuple(self._reply(self.reader.mapping(item)) for item in self.reader.items(node))

    def _reply(self, keys: Mapping) -> ReplyRow:
        buffer = keys.get("buffer")
        frames = [entry for entry in keys.read_all() if entry.key.text not in ("buffer", "when")]
        if len(frames) > 1:
            raise self.reader.broken(keys.at, "a reply row has one frame", "write a list with one row a frame")
        return ReplyRow(
            frame=self.values.frame_of(Mapping(tuple(frames), keys.at)) if frames else None,
            buffer=None if buffer is None else self.values.value(buffer),
            when=self.reader.maybe(self.reader.expression, keys.get("when")),
            at=keys.at,
        )

    def refusal(self, node: Node) -> Refusal:
        """`{when, code}`. Raises Broken."""
        reader, keys = self.reader, self.reader.mapping(node)
        return Refusal(when=reader.expression(keys.get("when")), code=reader.expression(keys.get("code")), at=keys.at)

    def _word_or_value(self, key: str, node: Node) -> Value:
        """Areas, units and the name of an item are written as bare words; everything else is a value."""
        if isinstance(node, Scalar):
            areas = self.values.space.section("areas")
            word = key == "as" or (key == "unit" and node.text in UNIT_WORDS) or (key == "area" and node.text in areas)
            if word:
                return Expression(node.text, Text(node.at, node.text))
        return self.values.value(node)

    def _run(self, node: Node | None) -> Expression | None:
        """The sequence to run: its bare name, or an expression that gives it."""
        if isinstance(node, Scalar) and node.text in self.values.space.section("sequences"):
            return Expression(node.text, Text(node.at, node.text))
        return self.reader.maybe(self.reader.expression, node)

    def _work(self, node: Node) -> ServeWork:
        reader, values, keys = self.reader, self.values, self.reader.mapping(node)

        def fields(key: str) -> dict[str, Value] | None:
            entries = None if keys.get(key) is None else reader.entries(keys.get(key))
            if entries is None:
                return None
            return {entry.key.text: self._word_or_value(entry.key.text, entry.value) for entry in entries}

        read = keys.get("read")
        return ServeWork(
            let=values.fields(keys.get("let")),
            write=fields("write"),
            span=fields("span"),
            update=reader.maybe(reader.expression, keys.get("update")),
            set=values.settings(keys.get("set")),
            drop=fields("drop"),
            read=reader.expression(read) if isinstance(read, Scalar) else fields("read"),
            each=reader.maybe(reader.expression, keys.get("each")),
            each_as=reader.maybe(reader.text, keys.get("as")),
            block=reader.maybe(self.commands.block, keys.get("block")),
            at=keys.at,
        )

    def errors(self, node: Node) -> Errors:
        """Raises Broken."""
        reader, keys = self.reader, self.reader.mapping(node)
        answer = keys.get("answer")
        for frame in reader.items(keys.get("frame")):
            if not self.values.frames.members(reader.text(frame)):
                raise reader.unknown(frame.at, "frame", reader.text(frame), list(self.values.frames.outlines))
        return Errors(
            frames=reader.texts(keys.get("frame")),
            when=reader.maybe(reader.expression, keys.get("when")),
            code=reader.maybe(reader.expression, keys.get("code")),
            names=tuple(self._name_table(item) for item in reader.items(keys.get("names"))),
            detail=reader.maybe(reader.expression, keys.get("detail")),
            unanswered=reader.maybe(reader.expression, keys.get("unanswered")),
            answer=None if answer is None else self.values.frame_of(answer),
            memory=self.values.expressions(keys.get("memory")),
            at=keys.at,
        )

    def _name_table(self, node: Node) -> NameTable:
        """A table's name, or `{table, when}`. Raises Broken."""
        if isinstance(node, Scalar):
            return NameTable(self.reader.text(node))
        keys = self.reader.mapping(node)
        return NameTable(self.reader.text(keys.get("table")), self.reader.expression(keys.get("when")))


def load_argument(reader: Reader, entry: Entry) -> Argument:
    """An argument of a service: `NAME: {type, default, range}`. Raises Broken."""
    keys = reader.mapping(entry.value)
    type_ = reader.maybe(reader.text, keys.get("type")) or "number"
    default = keys.get("default")
    choices = reader.texts(keys.get("of")) if type_ == "choice" else ()
    items = item_type(reader, keys.get("of")) if type_ == "list" else None
    return Argument(
        name=entry.key.text,
        type=type_,
        default=None if default is None else literal_or_expression(reader, default, type_, choices, items),
        limits=reader.maybe(reader.range, keys.get("range")),
        choices=choices,
        items=items,
    )
