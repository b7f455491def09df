"""Areas, addresses, services and errors: the requests for READ and WRITE; command blocks.

Guide: areas, services, errors.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from framekit.definition.expression import (
    Compare,
    Expression,
    Logic,
    Name,
    Number,
    Text,
    inverse_steps,
    is_constant,
    names_in,
    ordered_by_need,
    walk,
)
from framekit.definition.keys import (
    CONDITION,
    COUNT,
    EXPRESSION,
    FLAG,
    LABEL,
    LABELS,
    NUMBER,
    TEXT,
    Form,
    KeyReading,
    here,
    key,
    keys,
    list_of,
    mapping_of,
    properties_of,
    read_part,
    ref,
)
from framekit.definition.load.reader import MOST_ELEMENTS
from framekit.definition.model.frames import names_read
from framekit.definition.model.procedure import SETTINGS, Target
from framekit.definition.model.sections import Argument, StateVariable
from framekit.definition.model.values import Constant, FrameOf, Value
from framekit.definition.problems import Position, did_you_mean
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Node, Scalar
from framekit.definition.wire_types import given_order

PlaceOf = Mapping[str, Value]
"""A place of memory, by the words area, memory, code, text, unit, start, count; data: the value to write."""

# ---- forms of values; `r.loader` is the loader of services --------------------------------------------------

VALUE = Form(ref("expression"), lambda r, node: r.loader.values.value(node))
VALUES = Form(here("values"), lambda r, node: r.loader.values.fields(node))
EXPRESSIONS = Form(ref("expressions"), lambda r, node: r.loader.values.expressions(node))
CONSTRUCTOR = Form(here("constructor"), lambda r, node: r.loader.values.frame_of(node))
PLACE = Form(here("block_place"), lambda r, node: r.loader.place(node))


@dataclass(frozen=True, slots=True, kw_only=True)
class After:
    """The changes after an exchange: variables to set, bytes to store."""

    at: Position
    when: Expression | None = key("when", CONDITION, default=None)
    set: tuple[tuple[Target, Value], ...] = key("set", SETTINGS, default=())
    store: PlaceOf | None = key("store", PLACE, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandCall:
    """A service of the channel's protocol, with its arguments."""

    service: str
    arguments: Mapping[str, Value]
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class JobWork:
    """A command to the jobs of a run: `kind` is job, abort or inspect, `slot` its number, or 'all'.

    A job has a transfer, its `host`, the period `every` (ns), the time after which it is `late`, the number of
    `times`; `report` is the own place that a report sends.
    """

    kind: str
    slot: Value
    at: Position
    report: PlaceOf | None = key("report", PLACE, default=None)
    host: Value | None = key("host", VALUE, default=None)
    every: Value | None = key("every", VALUE, default=None)
    late: Value | None = key("late", VALUE, default=None)
    times: Value | None = key("times", VALUE, default=None)


SESSION_WORDS = ("new", "end")
JOBS = ("job", "abort", "inspect")


def word(scalar: Scalar) -> Expression:
    """Return a bare word, as an expression that gives it."""
    return Expression(scalar.text, Text(scalar.at, scalar.text))


def _session(reading: KeyReading, node: Node) -> Expression:
    """Return a bare word, or an expression that gives one."""
    scalar = reading.reader.scalar(node)
    return word(scalar) if scalar.text in SESSION_WORDS else reading.reader.expression(node)


def _calls(reading: KeyReading, node: Node) -> tuple[CommandCall, ...]:
    entries = [entry for item in reading.reader.items(node) for entry in reading.reader.entries(item)]
    values = reading.loader.values
    return reading.reader.each(
        entries, lambda one: CommandCall(service=one.key.text, arguments=values.fields(one.value), at=one.key.at)
    )


def _job(reading: KeyReading) -> JobWork | None:
    """Return the command to the run's jobs, None for other blocks."""
    keys_ = reading.keys
    kind = next((name for name in JOBS if name in keys_), None)
    if kind is None:
        return None
    if kind == "job" and not {"read", "write", "report"} & {*keys_.keys()}:
        reading.reader.note(keys_.at, "a job moves nothing", "add read:, write: or report:")
    slot = reading.loader.values.value(keys_.get(kind))
    return read_part(JobWork, reading.loader, keys_, kind=kind, slot=slot)


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockWork:
    """The exchange that a request asks for: a template of values over the request.

    One of `read` (with `into`), `write` (with `source`) and `calls`; with none of them only the session changes.
    `session` gives 'new', 'end' or ''. `read` and `write` are places of the other side, `into` and `source` of the
    own memory. With `job` it is a command to the run's jobs.
    """

    at: Position
    station: Value | None = key("station", VALUE, default=None)
    params: Mapping[str, Value] = key("params", VALUES, factory=dict)
    session: Expression | None = key("session", Form(ref("expression"), _session), default=None)
    read: PlaceOf | None = key("read", PLACE, default=None)
    write: PlaceOf | None = key("write", PLACE, default=None)
    into: PlaceOf | None = key("into", PLACE, default=None)
    source: PlaceOf | None = key("from", PLACE, default=None)
    calls: tuple[CommandCall, ...] = key("call", Form({}, _calls), default=())
    then: tuple[After, ...] = key("then", list_of(After, here("afterwards")), default=())
    job: JobWork | None = keys({name: {} for name in JOBS}, _job, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandRules:
    """The command blocks of an application: the frame of a record, the place and the values of the status word.

    `request` is the field with the inner frame that services serve; `most`: the most words of a block. `done` and
    `failed` give the status word, `meaning` its name. `waits`: the time (ns) after which a block is a fault;
    `limit`: the time after which its exchange is ended.
    """

    at: Position
    frame: str = key("frame", LABEL)
    request: str = key("request", LABEL)
    most: int = key("most", NUMBER, default=512)
    status: PlaceOf = key("status", PLACE)
    done: Expression | None = key("done", EXPRESSION, default=None)
    failed: Expression = key("failed", EXPRESSION)
    meaning: Expression | None = key("meaning", EXPRESSION, default=None)
    waits: Expression | None = key("waits", EXPRESSION, default=None)
    limit: Expression | None = key("limit", EXPRESSION, default=None)
    then: tuple[After, ...] = key("then", list_of(After, here("afterwards")), default=())


NOT_COMPARED = frozenset({"station", "own"})
"""Names whose values a server does not compare: the meaning of a request does not depend on them."""


def is_passed_over(expression: Expression) -> bool:
    """Return whether a server neither reads nor compares this value in a request."""
    if is_constant(expression):
        return False
    found = inverse_steps(expression)
    return found is None or found[0] in NOT_COMPARED


UNIT_BITS = {"bit": 1, "byte": 8, "word": 16, "dword": 32, "lword": 64}
NUMBER_BITS = {
    **{f"{kind}{bits}": bits for kind in ("int", "uint") for bits in (8, 16, 32, 64)}, "float32": 32, "float64": 64,
    "bcd16": 16, "bcd32": 32,
}  # fmt: skip
"""The types of numbers that elements may hold, and their widths."""
COUNTED_STRING = "counted_string"
"""The type of an element that is the number of characters in a word, and then these."""


def _text(reading: KeyReading, name: str) -> str | None:
    return reading.reader.maybe(reading.reader.text, reading.keys.get(name))


def _codes(reading: KeyReading, node: Node) -> dict[str, Constant]:
    """Return the codes on the wire by unit; a single code belongs to the unit of the area."""
    if isinstance(node, Keys):
        return reading.reader.by_name(node.read_all(), reading.reader.cell)
    return {_text(reading, "unit") or "": reading.reader.cell(node)}


def _unit(reading: KeyReading) -> str:
    unit = _text(reading, "unit") or next(iter(reading.found["codes"]), "")
    if not unit:
        what = f"area '{reading.found['name']}' has no unit"
        raise reading.reader.broken(reading.found["at"], what, "add unit: bit, byte, word, dword or lword")
    return unit


def _element_bits(reading: KeyReading) -> int:
    """Return the width of a unit (bits): a word of the language, or `6 bytes`. Raises Broken."""
    unit, node = reading.found["unit"], reading.keys.get("unit")
    count, _, rest = unit.partition(" ")
    if unit in UNIT_BITS:
        return UNIT_BITS[unit]
    if count.isdigit() and rest in ("bytes", "byte"):
        return int(count) * 8
    at = reading.found["at"] if node is None else node.at
    raise reading.reader.broken(at, f"'{unit}' is not a unit", did_you_mean(unit, [*UNIT_BITS, "6 bytes"]))


def _elements(reading: KeyReading, node: Node) -> int:
    return reading.reader.count(node, MOST_ELEMENTS, f"elements of area '{reading.found['name']}'")


def _columns(reading: KeyReading) -> dict[str, Constant]:
    """Return the other keys of an area."""
    own = {*properties_of(AreaModel), "about"}
    columns = [entry for entry in reading.keys.read_all() if entry.key.text not in own]
    return reading.reader.by_name(columns, reading.reader.cell)


@dataclass(frozen=True, slots=True, kw_only=True)
class AreaModel:
    """A memory area of a device. `codes`: unit → name on the wire, the first unit is the default one.

    `element_bits` is the width of the default unit; `columns` are the definition's own; `layout`: the layout of a
    read-only area; `memory` is the area of the device's memory; `type` is the usual type of an element. `order`: the
    order of bytes in larger elements, for accesses by byte; words do not depend on it.
    """

    name: str
    at: Position
    codes: Mapping[str, Constant] = key("code", Form({}, _codes), factory=dict)
    unit: str = keys({"unit": ref("unit")}, _unit)
    element_bits: int = keys({}, _element_bits)
    size: int = key("size", Form(NUMBER.schema, _elements), default=0x10000)
    memory: str = keys({"memory": LABEL.schema}, lambda r: _text(r, "memory") or r.found["name"])
    access: Literal["rw", "read"] = keys(
        {"access": ref("access")}, lambda r: "read" if _text(r, "access") == "read" else "rw", default="rw"
    )
    layout: str | None = key("layout", LABEL, default=None)
    order: Literal["big", "little", "BADC", "CDAB"] = keys(
        {"order": here("number_order")}, lambda r: given_order(r.reader, r.keys) or "little", default="little"
    )
    columns: Mapping[str, Constant] = keys({}, _columns, factory=dict)
    type: str | None = key("type", TEXT, default=None)


@dataclass(frozen=True, slots=True)
class Literally:
    """Literal text of an address form."""

    text: str


BASES = {"dec": 10, "hex": 16, "oct": 8}
"""Bases of the numbers of addresses."""


@dataclass(frozen=True, slots=True)
class FormPart:
    """`{…}` of an address form.

    `what`: `area` (name), `column` (an area's column `name`), `unit` (a key of the units table), `number` or `word`.
    Numbers have `base` and places `least`..`most`; a text instead of one of these numbers is a column of the area,
    which holds a number of places, or one of `BASES`.
    """

    what: Literal["area", "column", "unit", "number", "word"]
    name: str
    base: int | str = 10
    least: int | str | None = None
    most: int | str | None = None


@dataclass(frozen=True, slots=True)
class Maybe:
    """`[…]` of an address form: an optional part."""

    parts: tuple[Literally | FormPart, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class AddressForm:
    """A form of addresses."""

    text: str
    parts: tuple[Literally | FormPart | Maybe, ...]
    area: Expression | str | None
    unit: str | None
    """Unit of places in this form."""
    units_table: str | None
    """Name of a table of units."""
    results: Mapping[str, Expression]
    """Other keys of the row."""
    wire: bool
    at: Position
    type: str | None = None
    """Usual type of a place in this form."""
    any_case: bool = False
    """Whether letters of either case are accepted."""
    counts: str | None = None
    """Unit in which `start` counts, if an element may begin at any of these, such as a word at an odd byte."""
    ranges: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """Least and greatest value of numbers."""

    def results_in_order(self) -> list[str]:
        """Return the names of the results, each after those it depends on; circular ones are left out."""
        return ordered_by_need(self.results)

    @property
    def only_start(self) -> int | None:
        """Return the start of the place, for a form that names a single place of each area; else None."""
        start = self.results.get("start")
        root = None if start is None else start.root
        return root.value if isinstance(root, Number) and not root.is_time else None

    @property
    def parts_of_all_units(self) -> set[str]:
        """Return the parts of the text that do not depend on the unit of the place, because no result is computed from
        them.
        """
        used = {name for result in self.results.values() for name in names_in(result.root)}
        return self.names - self.results.keys() - used - {"start"}

    def may_name(self, areas: Collection[str]) -> bool:
        """Return whether it can name a place in one of these areas; without areas, True."""
        return not areas or not isinstance(self.area, str) or self.area in areas

    @property
    def names(self) -> set[str]:
        """Return the names that the form gives an address in addition to area and unit."""
        inside = [one for part in self.parts for one in (part.parts if isinstance(part, Maybe) else (part,))]
        return {*self.results, *(one.name for one in inside if isinstance(one, FormPart))}


def only_start(forms: Iterable[AddressForm], areas: Collection[str]) -> int | None:
    """Return the start of all places that addresses of these areas can name, None if they differ."""
    starts = {form.only_start for form in forms if form.may_name(areas)}
    return next(iter(starts)) if len(starts) == 1 else None


def held_type(forms: Iterable[AddressForm], area: AreaModel, unit: str) -> str | None:
    """Return the usual type of places of an area in a unit: the type of all address forms, else of the area."""
    own = area.type if unit == area.unit else None
    naming = (form for form in forms if form.may_name([area.name]))
    types = {form.type or own for form in naming if form.units_table is not None or (form.unit or area.unit) == unit}
    return next(iter(types)) if len(types) == 1 else own


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """Limits of one request."""

    count: Expression | None = key("count", COUNT, default=None)
    bytes: Expression | None = key("bytes", COUNT, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Packing:
    """Order of elements in the data bytes: byte order within a unit (as of fields), and the form of bits."""

    order: Literal["big", "little", "BADC", "CDAB"] = keys(
        {"order": here("number_order")}, lambda r: given_order(r.reader, r.keys) or "little", default="little"
    )
    bits: Literal["packed", "aligned", "byte_each", "nibble_each", "digit_each"] = key("bits", TEXT, default="packed")
    """A point is a byte (`byte_each`), four bits (`nibble_each`, high bits first) or a digit of text (`digit_each`);
    `packed` and `aligned` have eight in a byte.
    """
    words: bool = False
    """Whether the order is the file's order of numbers, and so of words; elements of other sizes are unchanged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplyRow:
    """A form of the reply: the frame (None: only bytes), the bytes in addition to it, and its condition."""

    frame: FrameOf | None
    buffer: Value | None
    when: Expression | None
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """`{when, code}`: a server answers `code` when `when` holds."""

    at: Position
    when: Expression = key("when", EXPRESSION)
    code: Expression = key("code", EXPRESSION)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeWork:
    """The work of a server for a row, in the language's order; each part is a mapping of names to values.

    `block` is an exchange with the other side that follows; `each`/`each_as` repeat span or read over a list. With
    `no_write` changes of the device by `set` and `drop` do not count as writes; a read-only server makes them, too.
    """

    at: Position
    let: Mapping[str, Value] = key("let", VALUES, factory=dict)
    write: Mapping[str, Value] | None = key("write", PLACE, default=None)
    span: Mapping[str, Value] | None = key("span", PLACE, default=None)
    update: Expression | None = key("update", EXPRESSION, default=None)
    set: tuple[tuple[Target, Value], ...] = key("set", SETTINGS, default=())
    drop: Mapping[str, Value] | None = key("drop", PLACE, default=None)
    no_write: bool = key("no_write", FLAG, default=False)
    read: Mapping[str, Value] | Expression | None = key(
        "read",
        Form({}, lambda r, node: (EXPRESSION if isinstance(node, Scalar) else PLACE).read(r, node)),
        default=None,
    )
    each: Expression | None = key("each", EXPRESSION, default=None)
    each_as: str | None = key("as", TEXT, default=None)
    block: BlockWork | None = key("block", Form(here("block"), lambda r, node: r.loader.block(node)), default=None)

    @property
    def moves_data(self) -> bool:
        """Return whether this work transfers the data itself, instead of the row."""
        return any((self.write, self.span, self.update, self.read, self.each, self.block))


def _most_variables(reading: KeyReading, node: Node) -> int:
    most = reading.reader.mapping(node).get("max")
    return 1 if most is None else reading.reader.number(most)


def _same(reading: KeyReading) -> str | None:
    node = reading.keys.get("variables")
    return None if node is None else reading.reader.maybe(reading.reader.text, reading.reader.mapping(node).get("same"))


def _arguments(reading: KeyReading) -> tuple[Argument, ...]:
    entries = reading.reader.entries(reading.keys.get("takes"))
    return reading.reader.each(
        entries, lambda one: read_part(Argument, reading.loader, one.value, name=one.key.text, at=one.key.at)
    )


def _replies(reading: KeyReading, node: Node) -> tuple[ReplyRow, ...]:
    reader = reading.reader
    return reader.each(reader.items(node), lambda item: _reply(reading, reader.mapping(item)))


def _reply(reading: KeyReading, keys_: Keys) -> ReplyRow:
    """Return a row with one frame; `buffer` and `when` are not frames."""
    reader, values = reading.reader, reading.loader.values
    frames = [entry for entry in keys_.read_all() if entry.key.text not in ("buffer", "when")]
    if len(frames) > 1:
        raise reader.broken(frames[1].key.at, "a reply row has one frame", "write a list with one row a frame")
    return ReplyRow(
        frame=values.frame_of(Keys(tuple(frames), keys_.at)) if frames else None,
        buffer=reader.maybe(values.value, keys_.get("buffer")),
        when=reader.maybe(reader.expression, keys_.get("when")),
        at=keys_.at,
    )


def _run(reading: KeyReading, node: Node) -> Expression:
    """Return the sequence to run: its bare name, or an expression for it."""
    if isinstance(node, Scalar) and node.text in reading.space.section("sequences"):
        return word(node)
    return reading.reader.expression(node)


def _back_each(reading: KeyReading) -> dict[str, Expression]:
    """Return the expressions that are read from each item of a list."""
    node = reading.keys.get("back")
    each = None if node is None else reading.reader.mapping(node).get("each")
    found: dict[str, Expression] = reading.loader.values.expressions(each)
    return found


def _packing(reading: KeyReading) -> Packing:
    """Return the packing of a row; words of read and write have the byte order of the file by default."""
    node = reading.keys.get("packing")
    found = Packing() if node is None else read_part(Packing, reading.loader, node)
    if reading.found["service"] not in ("read", "write") or (isinstance(node, Keys) and "order" in node):
        return found
    order = reading.space.order(reading.found["at"].file)
    return found if order == "little" else replace(found, order="big", words=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceRow:
    """One row of a service. Empty `areas` and `units` mean: any. `back_each` reads the items of a request's list."""

    service: str
    at: Position
    name: str = keys({"name": LABEL.schema}, lambda r: _text(r, "name") or r.found["name"])
    areas: tuple[str, ...] = key("areas", LABELS, default=())
    units: tuple[str, ...] = key("units", LABELS, default=())
    when: Expression | None = key("when", CONDITION, default=None)
    limit: Limit = key("limit", mapping_of(Limit, {}), default=Limit())
    align_bits: int = key(
        "align", Form({}, lambda r, node: r.reader.number(r.reader.mapping(node).get("bits"))), default=1
    )
    most_variables: int = key("variables", Form({}, _most_variables), default=0)
    same: str | None = keys({}, _same, default=None)
    takes: tuple[Argument, ...] = keys({"takes": {}}, _arguments, default=())
    request: FrameOf | None = key("request", CONSTRUCTOR, default=None)
    buffer: Value | None = key("buffer", VALUE, default=None)
    reply: tuple[ReplyRow, ...] = key("reply", Form({}, _replies), default=())
    packing: Packing = keys({"packing": {}}, _packing, default=Packing())
    gives: Mapping[str, Value] = key("gives", VALUES, factory=dict)
    run: Expression | None = key("run", Form(EXPRESSION.schema, _run), default=None)
    back: Mapping[str, Expression] = key(
        "back", Form({}, lambda r, node: r.loader.values.expressions(node, besides="each")), factory=dict
    )
    back_each: Mapping[str, Expression] = keys({}, _back_each, factory=dict)
    refuse: tuple[Refusal, ...] = key("refuse", list_of(Refusal, here("refusals")), default=())
    serve: ServeWork | None = key("serve", mapping_of(ServeWork, here("work")), default=None)
    client_only: bool = key("client_only", FLAG, default=False)
    server_only: bool = key("server_only", FLAG, default=False)
    outside_session: bool = key("outside_session", FLAG, default=False)

    def may_write(self, state: Mapping[str, StateVariable]) -> bool:
        """Return whether the service changes a device: its memory, or variables that the device keeps."""
        work = self.serve
        if self.service == "write":
            return True
        if work is None or work.no_write:
            return False
        kept = {name for name, variable in state.items() if variable.scope == "device"} | {"clock"}
        changes = any(target.name in kept for target, _ in work.set) or work.drop is not None
        return changes or work.write is not None or work.update is not None or work.block is not None

    @property
    def sequences(self) -> set[str]:
        """Return the names of sequences that `run` may select."""
        nodes = () if self.run is None else walk(self.run.root)
        return {node.value for node in nodes if isinstance(node, Text)}


OFFERED = frozenset({
    "area", "unit", "code", "start", "count", "bytes", "data", "bits", "value", "values", "text", "first", "done",
    "total", "element_bytes", "own_bytes", "spans", "old", "key", "entry",
})  # fmt: skip
"""Names that a row of services may use for the place, the data and the parts of a transfer."""

AS_NUMBERS = frozenset({"value", "values"})
"""Names of the elements as numbers, in rows of read and write."""
COUNTING = frozenset({"count", "bytes", "data", "bits", "values", "total"})
"""Names that give the number of elements: a row without any of them is for a single element."""


def mentions_of(row: ServiceRow) -> frozenset[str]:
    """Return the names that the request and the buffer of a row read."""
    return frozenset(names_read([row.request, row.buffer]))


def told_by(when: Expression | None) -> dict[str, int | str] | None:
    """Return the values of variables that a condition like `count == 2 and unit == 'word'` fixes; None for others."""
    if when is None:
        return {}
    parts = when.root.operands if isinstance(when.root, Logic) and when.root.operator == "and" else (when.root,)
    found: dict[str, int | str] = {}
    for part in parts:
        if not isinstance(part, Compare) or not isinstance(part.first, Name) or len(part.rest) != 1:
            return None
        operator, value = part.rest[0]
        if operator != "==" or not isinstance(value, (Number, Text)):
            return None
        found[part.first.name] = value.value
    return found


@dataclass(frozen=True, slots=True)
class NameTable:
    """A table of names of codes, with its condition; without `when` it always applies."""

    at: Position
    table: str
    when: Expression | None = None


def _answers(reading: KeyReading, node: Node) -> tuple[ReplyRow, ...]:
    """Read an answer, or a list of them. Raises Broken for a missing or superfluous condition."""
    rows = _replies(reading, node)
    for row in rows:
        if row.frame is None or row.buffer is not None:
            raise reading.reader.broken(row.at, "an answer is one frame", "write {FRAME: {…}}, and when: beside it")
        if row.when is None and row is not rows[-1]:
            what = "this answer has no condition, so those behind it are never sent"
            raise reading.reader.broken(row.at, what, "add when:, or make it the last one")
    if rows and rows[-1].when is not None:
        what = "the last answer has a condition, so some codes have no answer"
        raise reading.reader.broken(rows[-1].at, what, "leave its when: out, or add an answer for the other codes")
    return rows


def _name_tables(reading: KeyReading, node: Node) -> tuple[NameTable, ...]:
    """Read names of tables, or `{table, when}`."""
    reader = reading.reader
    given = [item if isinstance(item, Scalar) else reader.mapping(item) for item in reader.items(node)]
    return tuple(
        NameTable(one.at, one.text)
        if isinstance(one, Scalar)
        else NameTable(one.at, reader.text(one.get("table")), reader.expression(one.get("when")))
        for one in given
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Error replies of a device, by any of `frames` (or groups)."""

    at: Position
    frames: tuple[str, ...] = key("frame", LABELS, default=())
    when: Expression | None = key("when", CONDITION, default=None)
    code: Expression | None = key("code", EXPRESSION, default=None)
    names: tuple[NameTable, ...] = key("names", Form({}, _name_tables), default=())
    detail: Expression | None = key("detail", EXPRESSION, default=None)
    unanswered: Expression | None = key("unanswered", EXPRESSION, default=None)
    """Condition under which the reply means that the device did not answer."""
    answer: tuple[ReplyRow, ...] = key("answer", Form({}, _answers), default=())
    """The first row whose condition holds builds the error frame."""
    memory: Mapping[str, Expression] = key("memory", EXPRESSIONS, factory=dict)
    """Codes for errors of the memory: unknown, range, access, no_service."""
