"""Services, areas, addresses and errors, the server's refusals, and command blocks. Reference, sections 9 to 13."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from itertools import pairwise

from framekit.definition.expression.syntax import Expression, Text
from framekit.definition.load.reader import MOST_ELEMENTS, Reader
from framekit.definition.load.sections import item_type, literal_or_expression
from framekit.definition.load.values import ValueLoader
from framekit.definition.model.services import (
    UNIT_BITS,
    AddressForm,
    After,
    Area,
    Argument,
    BlockWork,
    CommandCall,
    CommandRules,
    Errors,
    JobWork,
    Limit,
    Literally,
    Maybe,
    NameTable,
    Packing,
    Part,
    PlaceOf,
    Refusal,
    ReplyRow,
    ServeWork,
    ServiceRow,
)
from framekit.definition.model.values import Constant, Value
from framekit.definition.nodes import Entry, Mapping, Node, Scalar
from framekit.definition.problems import Position, did_you_mean
from framekit.definition.wire_types import given_order

SESSION_WORDS = ("new", "end")
JOBS = ("job", "abort", "inspect")
DEFAULT_MOST = 512
"""The most words of a command block where the definition does not say."""

WordOrValue = Callable[[str, Node], Value]


class CommandLoader:
    """Reads blocks and the section; `word_or_value` reads the parts of a place."""

    def __init__(self, values: ValueLoader, word_or_value: WordOrValue) -> None:
        self.values = values
        self.reader: Reader = values.reader
        self._word_or_value = word_or_value

    def block(self, node: Node) -> BlockWork:
        """The exchange that a request asks for. Raises Broken."""
        reader, values, keys = self.reader, self.values, self.reader.mapping(node)
        kinds = [key for key in ("read", "write", "call") if key in keys]
        for one, other in pairwise(kinds):
            at = keys.get(other)
            reader.note(node.at if at is None else at.at, f"a block has {one} and {other}", "leave one of them out")
        for kind, own in (("read", "into"), ("write", "from")):
            if kind in keys and not {own, "then"} & {*_words(keys)} and "data" not in _words(keys.get(kind)):
                reader.note(node.at, f"a block has {kind}, but no {own}", f"add {own}: with a place of the own memory")
            if own in keys and kind not in keys and "inspect" not in keys:
                reader.note(node.at, f"a block has {own}, but no {kind}", f"add {kind}: with a place of the other side")
        return BlockWork(
            station=reader.maybe(values.value, keys.get("station")),
            params=values.fields(keys.get("params")),
            session=reader.maybe(self._session, keys.get("session")),
            read=self._place(keys.get("read")),
            write=self._place(keys.get("write")),
            into=self._place(keys.get("into")),
            source=self._place(keys.get("from")),
            calls=self._calls(keys.get("call")),
            then=self._then(keys.get("then")),
            job=self._job(keys),
            at=keys.at,
        )

    def _job(self, keys: Mapping) -> JobWork | None:
        """The command to the run's jobs, if it is one."""
        kind = next((name for name in JOBS if name in keys), None)
        if kind is None:
            return None
        reader, values = self.reader, self.values
        if kind == "job" and not {"read", "write", "report"} & {*_words(keys)}:
            reader.note(keys.at, "a job moves nothing", "add read:, write: or report:")
        return JobWork(
            kind=kind,
            slot=values.value(keys.get(kind) or keys),
            report=self._place(keys.get("report")),
            host=reader.maybe(values.value, keys.get("host")),
            every=reader.maybe(values.value, keys.get("every")),
            late=reader.maybe(values.value, keys.get("late")),
            times=reader.maybe(values.value, keys.get("times")),
            at=keys.at,
        )

    def _session(self, node: Node) -> Expression:
        """A bare word, or an expression that gives one."""
        scalar = self.reader.scalar(node)
        if scalar.text in SESSION_WORDS:
            return Expression(scalar.text, Text(scalar.at, scalar.text))
        return self.reader.expression(node)

    def _place(self, node: Node | None) -> PlaceOf | None:
        if node is None:
            return None
        entries = self.reader.entries(node)
        return {entry.key.text: self._word_or_value(entry.key.text, entry.value) for entry in entries}

    def _calls(self, node: Node | None) -> tuple[CommandCall, ...]:
        calls = []
        for item in () if node is None else self.reader.items(node):
            for entry in self.reader.entries(item):
                calls.append(
                    CommandCall(service=entry.key.text, arguments=self.values.fields(entry.value), at=entry.key.at)
                )
        return tuple(calls)

    def _then(self, node: Node | None) -> tuple[After, ...]:
        return tuple(self._after(self.reader.mapping(item)) for item in self.reader.items(node))

    def _after(self, keys: Mapping) -> After:
        return After(
            when=self.reader.maybe(self.reader.expression, keys.get("when")),
            set=self.values.settings(keys.get("set")),
            store=self._place(keys.get("store")),
            at=keys.at,
        )

    def rules(self, node: Node) -> CommandRules:
        """The section `commands` of an application. Raises Broken."""
        reader, keys = self.reader, self.reader.mapping(node)
        frame = keys.get("frame")
        if frame is not None and reader.text(frame) not in self.values.frames.outlines:
            known = list(self.values.frames.outlines)
            what = f"there is no frame '{reader.text(frame)}'"
            raise reader.broken(frame.at, what, did_you_mean(reader.text(frame), known))
        missing = [name for name in ("frame", "request", "status", "failed") if name not in keys]
        if missing:
            raise reader.broken(keys.at, f"commands: has no {', '.join(missing)}", "add it")
        request, failed, most = keys.get("request"), keys.get("failed"), keys.get("most")
        return CommandRules(
            frame=reader.maybe(reader.text, frame) or "",
            request=reader.maybe(reader.text, request) or "",
            most=DEFAULT_MOST if most is None else reader.number(most),
            status=self._place(keys.get("status")) or {},
            done=reader.maybe(reader.expression, keys.get("done")),
            failed=reader.expression(failed),
            meaning=reader.maybe(reader.expression, keys.get("meaning")),
            waits=reader.maybe(reader.expression, keys.get("waits")),
            then=self._then(keys.get("then")),
            at=keys.at,
        )


def _words(node: Node | None) -> list[str]:
    """The keys of a mapping."""
    return [entry.key.text for entry in node.entries] if isinstance(node, Mapping) else []


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


BASES = {"dec": 10, "hex": 16, "oct": 8}
_WIDTH = re.compile(r"(?:(?P<least>\w+)-)?(?P<most>\w+)")


def load_address_forms(
    reader: Reader, node: Node | None, areas: Collection[str], tables: Collection[str]
) -> tuple[AddressForm, ...]:
    """The forms of an `addresses` section; broken ones are noted and left out."""
    found = []
    for item in reader.items(node):
        with reader.going_on():
            found.append(_form(reader, reader.mapping(item), areas, tables))
    return tuple(found)


def _form(reader: Reader, keys: Mapping, areas: Collection[str], tables: Collection[str]) -> AddressForm:
    form = reader.scalar(keys.get("form"))
    area, unit = keys.get("area"), reader.maybe(reader.text, keys.get("unit"))
    parts = _Parts(reader, form).whole()
    if unit is not None and unit in tables and unit not in UNIT_BITS:
        unit, table = None, unit
    else:
        table = None
    named = ("form", "area", "unit", "type", "wire", "case", "doc")
    return AddressForm(
        text=form.text,
        parts=parts,
        area=None if area is None else _area(reader, reader.scalar(area), areas),
        unit=unit,
        units_table=table,
        results={
            entry.key.text: reader.expression(entry.value) for entry in keys.read_all() if entry.key.text not in named
        },
        wire=reader.flag(keys.get("wire")),
        at=keys.at,
        type=reader.maybe(reader.text, keys.get("type")),
        any_case=keys.get("case") is not None,
    )


def _area(reader: Reader, scalar: Scalar, areas: Collection[str]) -> Expression | str:
    return scalar.text if scalar.text in areas else reader.expression(scalar)


MOST_OPTIONAL = 4
"""A form has so many optional parts at most: each doubles the ways to read an address."""


class _Parts:
    """Cuts the text of a form into literal text, parts in braces and optional text in brackets."""

    def __init__(self, reader: Reader, form: Scalar) -> None:
        self.reader = reader
        self.text = form.text
        self.at = form.at
        self.place = 0

    def whole(self) -> tuple[Literally | Part | Maybe, ...]:
        parts = self._until("")
        optional = sum(isinstance(part, Maybe) for part in parts)
        if optional > MOST_OPTIONAL:
            todo = "write several forms"
            raise self._error(f"it has {optional} optional parts, {MOST_OPTIONAL} are possible", todo)
        return parts

    def _until(self, end: str) -> tuple[Literally | Part | Maybe, ...]:
        parts: list[Literally | Part | Maybe] = []
        literal = ""
        while self.place < len(self.text):
            sign = self.text[self.place]
            if sign == end:
                break
            if self.text.startswith(("[[", "]]", "{{", "}}"), self.place):
                literal, self.place = literal + sign, self.place + 2
                continue
            if sign in "{[":
                parts, literal = [*parts, Literally(literal)] if literal else parts, ""
                parts.append(self._part() if sign == "{" else self._maybe(end))
                continue
            literal, self.place = literal + sign, self.place + 1
        if end and self.place >= len(self.text):
            raise self._error(f"'{end}' is missing")
        return tuple([*parts, Literally(literal)] if literal else parts)

    def _maybe(self, end: str) -> Maybe:
        if end:
            raise self._error("an optional part cannot hold another one")
        self.place += 1
        parts = self._until("]")
        self.place += 1
        return Maybe(tuple(part for part in parts if not isinstance(part, Maybe)))

    def _part(self) -> Part:
        close = self.text.find("}", self.place)
        if close < 0:
            raise self._error("'}' is missing")
        words = self.text[self.place + 1 : close].split(":")
        self.place = close + 1
        name = words[0].strip()
        if len(words) == 1:
            if name in ("area", "unit"):
                return Part("area" if name == "area" else "unit", name)
            return Part("column", name.partition(".")[2]) if name.startswith("area.") else Part("word", name)
        if words[1] not in BASES:
            raise self._error(f"'{words[1]}' is not a kind of number", "write dec, hex or oct")
        least, most = self._width(words[2] if len(words) > 2 else "")
        return Part("number", name, BASES[words[1]], least, most)

    def _width(self, text: str) -> tuple[int | str | None, int | str | None]:
        if not text:
            return None, None
        match = _WIDTH.fullmatch(text.strip())
        if match is None:
            raise self._error(f"'{text}' is not a number of places", "write 4, 1-3, or a column of the areas")
        most = _places(match["most"])
        return (most if match["least"] is None else _places(match["least"])), most

    def _error(self, what: str, todo: str = "") -> Exception:
        at = Position(self.at.file, self.at.line, self.at.column)
        return self.reader.broken(at, f'in the form "{self.text}": {what}', todo)


def _places(text: str) -> int | str:
    return int(text) if text.isdigit() else text
