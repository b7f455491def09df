"""Services, areas, errors: constructors name fields there are, areas and units are known, a reply always fits.

A server can tell from a request what it asks for, and comes to every row.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from framekit.definition.check.addresses import is_unit
from framekit.definition.expression import (
    COLUMNS,
    Attribute,
    Call,
    Compare,
    Expression,
    Name,
    Node,
    Real,
    Text,
    children,
    inverse_steps,
    is_constant,
    names_in,
    walk,
)
from framekit.definition.kinds.base import Segment, constant_number
from framekit.definition.model.frames import (
    Frame,
    attributes_in,
    expressions_of,
    field_names,
    flat,
    names_always_there,
    names_needed,
    parts_of,
)
from framekit.definition.model.procedure import Action, Row, Sequence, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Data, Field
from framekit.definition.model.services import (
    COUNTED_STRING,
    COUNTING,
    NOT_COMPARED,
    NUMBER_BITS,
    UNIT_BITS,
    AddressForm,
    ServiceRow,
    is_passed_over,
    mentions_of,
)
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, ReadAs, RecordOf, Value
from framekit.definition.problems import Position, Problem, did_you_mean, listed
from framekit.definition.sources import fingerprint

BUILT_IN = frozenset({"station", "own", "role", "line", "now", "clock"})
EXCHANGE = frozenset({"request", "reply", "buffer", "reply_buffer", "expected", "refusal"})
IN_HANDLERS = frozenset({"cause", "frame", "outcome"})
ONLY_THERE = {
    "it": "it is what a row has taken: use it in a row, or in a step behind one",
    "part": "it is the piece of a step that has parts:",
    "cause": "it is known in on_bad and other handlers",
    "frame": "it is known in on_bad and other handlers; a frame's name is it.frame",
    "outcome": "it is known in on_fail",
    "reply": "it is what serve: answers: add serve: {request: …} before",
    "index": "it is the number of an item: use it in the segments of a repeat",
    "last": "it tells whether an item is the last one: use it in the segments of a repeat",
    "previous": "it is the item before: use it in the segments of a repeat",
}
"""Words that have a value only in some places."""

OFFERED = frozenset({
    "area", "unit", "code", "start", "count", "bytes", "data", "bits", "text", "first", "done", "total",
    "element_bytes", "own_bytes", "spans", "old", "key", "entry",
})  # fmt: skip
IN_BLOCKS = frozenset({
    "result", "reply", "buffer", "data", "block", "outcome", "cause", "code", "ok", "refused", "status",
    "record",
})  # fmt: skip
"""What the row of a command block knows besides, and all that is done when its exchange has ended."""
OF_EVERY_FRAME = frozenset({"frame", "refusal"})


def behind_a_refusal(frame: Frame) -> set[str]:
    """Fields that a frame may lack when it is to be refused: those from its first segment with a code on."""
    segments = list(flat(frame.segments))
    place = next((place for place, segment in enumerate(segments) if segment.refuse is not None), len(segments))
    return field_names(segments[place:]) - field_names(segments[:place])


def asked_for(expression: Expression) -> set[str]:
    """Fields that an expression asks for first: `'station' in it`."""
    return {
        node.first.value
        for node in walk(expression.root)
        if isinstance(node, Compare) and isinstance(node.first, Text) and node.rest[0][0] in ("in", "not in")
    }


def takes_something(sequence: Sequence) -> bool:
    """Whether something can have arrived that `it` may stand for."""
    if sequence.always or "on_other" in sequence.handlers:
        return True
    return any(step.receive or any(action.take for action in parts_of(step, Action)) for step in sequence.steps)


def without_parts(segment: Segment) -> list[Any]:
    """What a segment says itself, without the segments it holds (they are checked on their own)."""
    parts = [
        getattr(segment, name)
        for name in segment.__dataclass_fields__
        if name not in ("of", "cases", "otherwise", "method")
    ]
    return [part for part in parts if part is not None]


def check_request_matching(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """What keeps a server from understanding the requests of this row."""
    yield from _items(row)
    if row.service not in ("read", "write") or (row.serve is not None and row.serve.moves_data):
        return  # their work says itself where it takes its places from
    if row.client_only or row.request is None or not serves(protocol):
        return
    if row.service == "write":
        yield from _uncounted(protocol, row)
    if row.serve is not None:
        return
    read = {*row.back, *row.back_each}
    unreadable: list[Expression] = []
    for leaf in _compared([row.request, *([row.buffer] if row.buffer is not None else [])]):
        found = inverse_steps(leaf)
        if found is not None:
            read.add(found[0])
        elif names_in(leaf.root) - NOT_COMPARED:
            unreadable.append(leaf)
    if unreadable and not row.back and not row.back_each:
        leaf = unreadable[0]
        what = f"'{leaf}' of a request cannot be read backwards by a server"
        back = "back: {each: {…}}" if _list_names(row) else "back: {…}"
        yield Problem(leaf.at, what, f"add {back} with what it means, or client_only: yes")
        return
    if not read <= _known_names(protocol, row):
        return  # what is misspelt is told elsewhere
    for missing in _missing_names(row, read):
        what = f"a server cannot tell the {missing} that this {row.service} asks for"
        yield Problem(row.at, what, f"put it into the request, or add back: {{{missing}: …}}, or client_only: yes")


def _items(row: ServiceRow) -> Iterator[Problem]:
    """What is said of items is said of each: not of the list as a whole, and not where there is no list."""
    lists = _list_names(row)
    if row.back_each and not lists:
        first = next(iter(row.back_each.values()))
        what = "the request of this row has no list {each: …}, so there are no items to read"
        yield Problem(first.at, what, "write the keys of each: in back: itself")
    for name, expression in row.back.items():
        node = None if name == "when" else next(_reads_of(expression.root, lists), None)
        if node is not None:
            what = f"'{name}' is the same for all items of '{node.name}' here"
            yield Problem(node.at, what, f"write back: {{each: {{{name}: …}}}}, where the fields of the item are names")


def _reads_of(node: Node, lists: Mapping[str, EachOf]) -> Iterator[Attribute]:
    """Where an expression looks into one of these lists of the request, and does not only count its items."""
    if isinstance(node, Attribute) and node.name in lists and "request" in names_in(node):
        yield node
    elif not (isinstance(node, Call) and node.function == "len"):
        for child in children(node):
            yield from _reads_of(child, lists)


def _list_names(row: ServiceRow) -> dict[str, EachOf]:
    """The lists of the request that have an item for each variable, by name."""
    sent = [row.request, row.buffer]
    holders: list[FrameOf | LayoutOf | RecordOf] = [*parts_of(sent, FrameOf), *parts_of(sent, LayoutOf)]
    holders += parts_of(sent, RecordOf)
    return {name: value for made in holders for name, value in made.fields.items() if isinstance(value, EachOf)}


def item_names(protocol: Protocol, row: ServiceRow) -> set[str]:
    """The fields that items of the request's lists have."""
    sent, lists, found = [row.request, row.buffer], _list_names(row), set[str]()
    frames = [protocol.frames.get(made.frame) for made in parts_of(sent, FrameOf)]
    layouts = [protocol.layouts.get(made.layout) for made in parts_of(sent, LayoutOf)]
    for repeat in parts_of([holder.segments for holder in (*frames, *layouts) if holder is not None], Segment):
        if repeat.is_list and repeat.name in lists:
            found |= field_names(repeat.inner_record or ())
    return found


def _known_names(protocol: Protocol, row: ServiceRow) -> set[str]:
    """Names that the leaves of a request may have."""
    known = {*OFFERED, *NOT_COMPARED, "memory", *row.back, *row.back_each, *(argument.name for argument in row.takes)}
    known |= protocol.params.keys() | protocol.state.keys() | protocol.tables.keys()
    for form in protocol.addresses:
        known |= form.names
    return known


def _missing_names(row: ServiceRow, read: set[str]) -> Iterator[str]:
    """What of area and start no part of the request says."""
    if "text" in read:
        return
    if not read & {"area", "memory", "code"} and len(row.areas) != 1:
        yield "area"
    if "start" not in read:
        yield "start"


_FILLED_UP = ("packed", "aligned", "nibble_each")
"""Forms of bits whose data are filled up to whole bytes."""


def _uncounted(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """Data with more after them than what is written, and no count: a server would write that into the next places."""
    sent = [part for part in (row.request, row.buffer) if part is not None]
    found = (inverse_steps(leaf) for leaf in _compared(sent))
    read = {*row.back, *row.back_each, *(one[0] for one in found if one is not None)}
    if read & {"count", "bits"} or not read & {"data", "bytes"}:
        return
    form = row.packing.bits
    step = 2 if form == "nibble_each" else 8
    if form in _FILLED_UP and row.align_bits % step and "bit" in _units_in(protocol, row):
        what = f"bits: {form} fills the data up to whole bytes, so a server cannot tell how many bits this write is for"
    elif "bytes" not in read and any(name in _padded(protocol, sent) for name in _holders_of_data(sent)):
        what = "padding may follow the data, so a server cannot tell how many elements this write is for"
    else:
        return
    todo = "each: {count: …}" if _list_names(row) else "count: …"
    yield Problem(row.at, what, f"give count: put it into the request, or add back: {{{todo}}}, or client_only: yes")


_PAIRED = ("BADC", "CDAB")
"""Orders that exchange words, or the bytes of each."""


def _is_odd(unit: str) -> bool:
    """Whether a unit is `3 bytes`, say: no words."""
    return is_unit(unit) and unit not in UNIT_BITS and int(unit.split()[0]) % 2 == 1 and unit != "1 byte"


def _units_of(protocol: Protocol, form: AddressForm) -> set[str]:
    """The units that addresses of a form may have; none where their area says it."""
    table = protocol.tables.get(form.units_table or "")
    return {form.unit} if form.unit else set() if table is None else set(map(str, table.entries.values()))


def _units_in(protocol: Protocol, row: ServiceRow) -> set[str]:
    """The units that the elements of a row may have, for some request."""
    if row.units and all(map(is_unit, row.units)) and not {"unit"} & {*row.back, *row.back_each}:
        return set(row.units)
    areas = [area for name, area in protocol.areas.items() if not row.areas or name in row.areas]
    units = {unit for area in areas for unit in (area.unit, *area.codes)}
    others = protocol.areas.keys() - set(row.areas) if row.areas else ()
    forms = (form for form in protocol.addresses if form.area not in others)
    return units.union(*(_units_of(protocol, form) for form in forms))


def _holders_of_data(values: Iterable[Value]) -> Iterator[str]:
    """The fields that `data` is given to."""
    for made in values:
        if isinstance(made, (FrameOf, LayoutOf, RecordOf, EachOf)):
            for name, value in made.fields.items():
                if isinstance(value, Expression) and isinstance(value.root, Name) and value.root.name == "data":
                    yield name
            yield from _holders_of_data(made.fields.values())


def _padded(protocol: Protocol, sent: list[Value]) -> set[str]:
    """The data that are filled up with padding, in the frames and layouts of a request."""
    frames = [protocol.frames.get(made.frame) for made in parts_of(sent, FrameOf)]
    layouts = [protocol.layouts.get(made.layout) for made in parts_of(sent, LayoutOf)]
    holders = [holder.segments for holder in (*frames, *layouts) if holder is not None]
    return {one.name for one in parts_of(holders, Data) if one.pad is not None}


def serves(protocol: Protocol) -> bool:
    """Whether a device may be made of this definition; of an application, the protocol that carries it decides."""
    if protocol.kind == "application":
        return True
    return any(step.serve is not None for sequence in protocol.sequences.values() for step in sequence.steps)


def _stations(protocol: Protocol) -> Iterator[Problem]:
    """Requests with a station that no device compares with its own: each device answers for all of them."""
    for name in dict.fromkeys(name for role in protocol.roles.values() for name in role.listens):
        sequences = protocol.called_from([name])
        if protocol.station.type == "none" or not any(step.serve for one in sequences for step in one.steps):
            continue
        taken = {frame for row in parts_of(sequences, Row) for frame in row.frames}
        nodes = [node for one in expressions_of(sequences) for node in walk(one.root)]
        read = {node.name for node in nodes if isinstance(node, Attribute)}
        compared = {field for node in nodes if isinstance(node, Compare) for field in _compared_with_own(node)}
        told: set[str] = set()
        for made in (row.request for rows in protocol.services.values() for row in rows if not row.client_only):
            frame = None if made is None or made.frame not in taken else protocol.frames.get(made.frame)
            if made is None or frame is None or _validates_itself(frame):
                continue
            for field_name, value in made.fields.items():
                named = isinstance(value, Expression) and "station" in names_in(value.root)
                if (
                    not named
                    or field_name not in field_names(frame.segments)
                    or field_name in read | told
                    or made.fields.keys() & compared
                ):
                    continue
                told.add(field_name)
                what = (
                    f"'{field_name}' of a request is not compared with the device's own station in '{name}', so every "
                )
                plain = isinstance(value, Expression) and isinstance(value.root, Name)
                todo = "station: own" if plain else f"when: it.{field_name} == …"
                todo = f"add {todo} to the row that receives it"
                yield Problem(value.at, what + "device answers every station", todo, warning=True)


def _settings(protocol: Protocol) -> Iterator[Problem]:
    """Requests with a parameter of the device that it does not compare: it answers what is meant for another one."""
    compared = {name for name, one in protocol.params.items() if one.is_compared}
    listening = [name for role in protocol.roles.values() for name in role.listens]
    sequences = protocol.called_from(listening)
    if not compared or not any(step.serve for one in sequences for step in one.steps):
        return
    taken = {frame for row in parts_of(sequences, Row) for frame in row.frames}
    read = attributes_in(sequences)
    of_places = {name for form in protocol.addresses for name in form.names}
    told: set[tuple[str, str]] = set()
    for row in (row for rows in protocol.services.values() for row in rows if not row.client_only):
        frame = None if row.request is None else protocol.frames.get(row.request.frame)
        if row.request is None or frame is None or frame.name not in taken:
            continue
        hidden = of_places if row.service in ("read", "write") else {argument.name for argument in row.takes}
        own = compared - hidden
        seen = read | attributes_in([row.back, row.back_each, row.when, row.refuse, row.serve])
        ruled = {name for rule in expressions_of(frame) for name in names_in(rule.root)}
        for field_name, value in _leaves_of(row.request):
            found = inverse_steps(value)
            if found is None or found[0] not in own - ruled or field_name in seen or (field_name, found[0]) in told:
                continue
            told.add((field_name, found[0]))
            what = f"'{field_name}' of a request is not compared with the device's parameter '{found[0]}', so a device"
            todo = (
                f"add station: own (or when: it.{field_name} == {value}) to the row that receives it; or, if only the "
            )
            todo += "client has this parameter, add from: client to it"
            yield Problem(value.at, f"{what} answers requests to others", todo, warning=True)


def _of_client(protocol: Protocol) -> Iterator[Problem]:
    """`from: client` keeps a device from comparing a parameter of a request: one that it would compare."""
    rows = [row for rows in protocol.services.values() for row in rows]
    served = [row for row in rows if not row.client_only] if serves(protocol) else []
    sent: list[Any] = [part for row in served for part in (row.request, row.buffer)]
    frames = (protocol.frames.get(made.frame) for made in parts_of(sent, FrameOf))
    sent += [frame.segments for frame in frames if frame is not None]
    told = {name for one in expressions_of(sent) for name in names_in(one.root)}
    for one in protocol.params.values():
        if not one.of_client or one.at.file != protocol.at.file:
            continue  # of an application: some of its carriers tell it
        if not replace(one, of_client=False).is_compared:
            kind = "a secret" if one.secret else "one with is:" if one.is_ is not None else f"a {one.type}"
            what = f"from: client has no effect: '{one.name}' is {kind}, which no device compares"
        elif one.name not in told:
            what = f"from: client has no effect: no request that a device serves tells '{one.name}'"
        else:
            continue
        yield Problem(one.at, what, "leave it out")


def _leaves_of(made: FrameOf | LayoutOf | RecordOf) -> Iterator[tuple[str, Expression]]:
    """Fields and the expressions that fill them, those of records and layouts inside too."""
    for name, value in made.fields.items():
        if isinstance(value, Expression):
            yield name, value
        elif isinstance(value, (LayoutOf, RecordOf)):
            yield from _leaves_of(value)


def _validates_itself(frame: Frame) -> bool:
    """Whether a frame's own rules look at the station of the device."""
    return any("own" in names_in(rule.root) for rule in expressions_of(frame))


def _compared_with_own(node: Compare) -> Iterator[str]:
    """The fields in a comparison with the own station."""
    if "own" in names_in(node):
        yield from (part.name for part in (node.first, *(side for _, side in node.rest)) if isinstance(part, Attribute))


def _compared(values: list[Value]) -> Iterator[Expression]:
    for value in values:
        match value:
            case Expression():
                yield value
            case FrameOf(fields=fields) | LayoutOf(fields=fields) | RecordOf(fields=fields) | EachOf(fields=fields):
                yield from _compared(list(fields.values()))
            case ListOf(items=items):
                yield from _compared(list(items))


TODO = "tell them apart by a constant in the request or by when:, or add client_only: yes"


def check_unserved(protocol: Protocol) -> Iterator[Problem]:
    """Rows whose requests a server reads by a row above them."""
    if not serves(protocol):
        return
    above: dict[str, list[ServiceRow]] = {}
    for row in (row for rows in protocol.services.values() for row in rows):
        if row.request is None or row.client_only or row.request.frame not in protocol.frames:
            continue
        earlier = above.setdefault(row.request.frame, [])
        for one in earlier:
            alike = _Alike(protocol)
            if _takes_all(alike, one, row):  # the first that does answers
                if not alike.same or _told(one) != _told(row):
                    what = f"a server never comes to this row of {row.service}: it reads every '{row.request.frame}' "
                    where = "" if one.at.file == row.at.file else f" of {Path(one.at.file).name}"
                    what += f"that fits here by the row of {one.service} in line {one.at.line}{where}"
                    yield Problem(row.at, what, TODO)
                break
        earlier.append(row)


def _takes_all(alike: _Alike, earlier: ServiceRow, later: ServiceRow) -> bool:
    """Whether the earlier row fits every request that the later one fits."""
    assert earlier.request is not None and later.request is not None
    if earlier.buffer is None and later.buffer is not None:
        return False
    sent = alike.covers(earlier.request, later.request)
    sent = sent and (earlier.buffer is None or alike.covers(earlier.buffer, later.buffer))
    if not sent or len(set(alike.names)) < len(alike.names) or {"text", "start"} <= set(alike.names):
        return False
    by_columns = any(names_in(leaf.root) & COLUMNS for leaf in expressions_of([earlier.request, earlier.buffer]))
    if by_columns and set(earlier.areas) != set(later.areas):
        return False
    whens = _when(earlier), _when(later)
    if whens[0] is not None and (fingerprint(whens[0]) != fingerprint(whens[1]) or not alike.same):
        return False
    return _back_fits(earlier, later) and _areas_fit(earlier, later)


def _when(row: ServiceRow) -> Expression | None:
    return row.back.get("when", row.when)


def _back_fits(earlier: ServiceRow, later: ServiceRow) -> bool:
    """Whether `back` of the earlier row can be worked out whenever that of the later one can."""
    read = [(later.back.get(name), value) for name, value in earlier.back.items() if name != "when"]
    read += [(later.back_each.get(name), value) for name, value in earlier.back_each.items()]
    return all(
        not names_in(value.root) or isinstance(value.root, Name) or fingerprint(value) == fingerprint(other)
        for other, value in read
    )


def _areas_fit(earlier: ServiceRow, later: ServiceRow) -> bool:
    """Whether the earlier row is for every area that a request of the later one can name."""
    source = _area_source(earlier)
    if source == "code" and _area_source(later) != "code":
        return False
    if source not in ("text", "code") or not earlier.areas:
        return True
    return _area_source(later) == source and bool(later.areas) and set(later.areas) <= set(earlier.areas)


def _area_source(row: ServiceRow) -> str:
    """What a server takes the area from: `text`, `code`, `area` of back, or '' for the row itself."""
    back = {*row.back, *row.back_each}
    if "text" in back:
        return "text"
    leaves = {leaf.root.name for leaf in expressions_of([row.request, row.buffer]) if isinstance(leaf.root, Name)}
    named = leaves - {argument.name for argument in row.takes}
    if "text" in named:
        return "text"
    if "area" in back:
        return "area"
    return "code" if "code" in named else ""


def _told(row: ServiceRow) -> str:
    """What a server takes from a row whose request has been read."""
    places = () if _area_source(row) else (row.areas, row.units)
    transfer = row.service if row.service in ("read", "write") else ""
    back = {name: value for name, value in row.back.items() if name != "when"}
    return fingerprint((transfer, places, back, row.back_each, row.reply, row.refuse, row.serve, row.packing))


@dataclass
class _Alike:
    """Compares what two rows send; `names` are those the first one reads, `same`: neither reads another one there."""

    protocol: Protocol
    names: list[str] = field(default_factory=list)
    same: bool = True

    def covers(self, one: Value, other: Value | None) -> bool:
        """Whether everything that the other value can be fits the first one."""
        match one, other:
            case Expression(), _:
                return self._compare(one, other if isinstance(other, Expression) else None)
            case FrameOf(frame=frame, fields=fields), FrameOf(frame=there, fields=given) if frame == there:
                known = self.protocol.frames.get(frame)
                return self._fields(fields, given, set() if known is None else names_always_there(known.segments))
            case LayoutOf(layout=layout, fields=fields), LayoutOf(layout=there, fields=given) if layout == there:
                return self._fields(fields, given, ())
            case ListOf(items=items), ListOf(items=others) if len(items) == len(others):
                return all(map(self.covers, items, others))
            case (RecordOf(fields=fields), RecordOf(fields=given)) | (EachOf(fields=fields), EachOf(fields=given)):
                return self._fields(fields, given, ())
        return False

    def _fields(self, one: Mapping[str, Value], other: Mapping[str, Value], known: Collection[str]) -> bool:
        return all(
            (name in other or name in known or (isinstance(value, Expression) and is_passed_over(value)))
            and self.covers(value, other.get(name))
            for name, value in one.items()
        )

    def _compare(self, one: Expression, other: Expression | None) -> bool:
        equal = fingerprint(one) == fingerprint(other)
        if is_constant(one):
            return equal
        found = inverse_steps(one)
        if found is None or is_passed_over(one):
            return True
        name, undone = found
        self.names.append(name)
        if not equal and other is not None and names_in(other.root):
            self.same = False
        return equal or all(operator != "*" for operator, _, _ in undone)  # a product may leave a rest


def check_services(protocol: Protocol, broken: Collection[str] = ()) -> list[Problem]:
    """Everything wrong with services, areas and errors; and with constructors anywhere."""
    found = list(_constructors(protocol, broken))
    for rows in protocol.services.values():
        for row in rows:
            found += _row(protocol, row, broken)
            found += _sides(protocol, row)
            found += _amounts(row)
            found += _limits_too_high(protocol, row)
            found += check_request_matching(protocol, row)
        found += _dead(rows)
    found += [*_stations(protocol), *_settings(protocol), *_of_client(protocol)]
    told = {problem.at for problem in found}
    found += [problem for problem in check_unserved(protocol) if problem.at not in told]
    return [*found, *_areas(protocol, broken), *_codes(protocol), *_errors(protocol, broken)]


def _constructors(protocol: Protocol, broken: Collection[str]) -> Iterator[Problem]:
    """`{frame: {field: …}}` may only name fields of that frame."""
    holders = [protocol.sequences, protocol.services, protocol.errors]
    asked = {id(step.ask) for step in parts_of(dict(protocol.sequences), Step) if step.ask is not None}
    never_built = _never_built(protocol)
    for made in parts_of(holders, FrameOf):
        frame = None if id(made) in asked else protocol.frames.get(made.frame)  # what is asked are services
        if frame is not None and made.frame not in broken:
            yield from _fields(made, "frame", made.frame, field_names(frame.segments))
            yield from () if id(made) in never_built else _missing(made, frame)
            yield from () if id(made) in never_built else _never_fit(protocol, made, frame)
    for layout in parts_of(holders, LayoutOf):
        if layout.layout in protocol.layouts:
            yield from _fields(layout, "layout", layout.layout, field_names(protocol.layouts[layout.layout].segments))
    for read in parts_of(holders, ReadAs):
        if read.layout not in protocol.layouts and read.layout not in broken:
            yield Problem(read.at, f"there is no layout '{read.layout}'", did_you_mean(read.layout, protocol.layouts))


def _never_built(protocol: Protocol) -> set[int]:
    """What is only compared with what comes: requests that no client sends, replies that no server gives."""
    rows = [row for rows in protocol.services.values() for row in rows]
    asks = protocol.commands is None
    found = {id(row.request) for row in rows if row.server_only or not asks}
    return found | {id(reply.frame) for row in rows if row.client_only or not serves(protocol) for reply in row.reply}


def _missing(made: FrameOf, frame: Frame) -> Iterator[Problem]:
    """A frame is built from what is given, what its definition says itself, and what it repeats of a request."""
    if made.fields.keys() - field_names(frame.segments):
        return  # one of them is misspelt, which has been told
    missing = [name for name in names_needed(frame.segments) if name not in made.fields and name not in frame.echo]
    if missing:
        what = f"nothing gives {listed(repr(name) for name in missing)} of '{made.frame}'"
        todo = ", ".join(f"{name}: {name if name in (*NOT_COMPARED, *OFFERED) else '…'}" for name in missing)
        yield Problem(made.at, what, f"add {todo}")


def _never_fit(protocol: Protocol, made: FrameOf, frame: Frame) -> Iterator[Problem]:
    """Numbers that stand in a constructor, or that errors answer with, and their fields cannot hold."""
    errors = protocol.errors
    codes = errors.memory if errors is not None and made is errors.answer else {}
    for name, value in made.fields.items():
        if not isinstance(value, Expression):
            continue
        if isinstance(value.root, Real):
            held = [one for one in parts_of(frame.segments, Segment) if name in one.value_names]
            types = [one.type for one in held if isinstance(one, Field) and one.value_kind == "number"]
            if types and not any(type_.has_fractions and type_.writes(value.root.value) for type_ in types):
                what = f"{value} does not fit: '{name}' of '{frame.name}' holds no such fraction"
                yield Problem(value.at, what, "correct one of them")
        is_code = isinstance(value.root, Name) and value.root.name == "code"
        for number in codes.values() if is_code else (value,):
            yield from _fits(constant_number(number), number.at, name, frame)


def _fits(number: int | None, at: Position, name: str, frame: Frame) -> Iterator[Problem]:
    if number is None:
        return
    spans = _spans(name, frame)
    if spans and not any(low <= number <= high for low, high in spans):
        low, high = spans[0]
        yield Problem(
            at, f"{number} does not fit: '{name}' of '{frame.name}' holds {low} to {high}", "correct one of them"
        )


def _spans(name: str, frame: Frame) -> list[tuple[int, int]]:
    """What numbers the fields of this name hold; nothing where that is open for one of them."""
    found = [
        one.span for one in parts_of(frame.segments, Segment) if name in one.value_names and isinstance(one, Field)
    ]
    return [] if None in found else [span for span in found if span is not None]


def _fields(made: FrameOf | LayoutOf, kind: str, name: str, known: set[str]) -> Iterator[Problem]:
    for given, value in made.fields.items():
        if given not in known:
            yield Problem(value.at, f"{kind} '{name}' has no field '{given}'", did_you_mean(given, known))


def _row(protocol: Protocol, row: ServiceRow, broken: Collection[str]) -> Iterator[Problem]:
    for area in row.areas:
        if area not in protocol.areas and area not in broken:
            yield Problem(row.at, f"there is no area '{area}'", did_you_mean(area, protocol.areas))
    for unit in row.units:
        if is_unit(unit) and unit not in UNIT_BITS and all(unit != area.unit for area in protocol.areas.values()):
            yield Problem(row.at, f"'{unit}' is not a unit of any area", did_you_mean(unit, UNIT_BITS))
    if row.reply and row.reply[-1].when is not None and not row.client_only:
        yield Problem(row.reply[-1].at, "the last reply has a condition", "a server must have a reply for every case")
    if row.server_only and (row.client_only or row.request is None):
        what = "neither side uses this row" if row.client_only else "a server answers requests, this row has none"
        todo = "leave client_only or server_only out" if row.client_only else "add request: {frame: {…}}"
        yield Problem(row.at, what, todo)
    if row.service in ("read", "write") and row.request is None and row.run is None:
        yield Problem(row.at, f"a row of {row.service} has no request", "add request: {frame: {…}}")
    yield from _data(row)
    yield from _lists(protocol, row)
    yield from _units(protocol, row)
    yield from _points(protocol, row)
    sequences = {name for role in protocol.roles.values() for lane in role.lanes for name in lane.exchange}
    if row.run is not None and isinstance(row.run.root, Text) and sequences and row.run.root.value not in sequences:
        what = f"'{row.run.root.value}' is no exchange of any role"
        yield Problem(row.run.at, what, did_you_mean(row.run.root.value, sequences))


def _units(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """A client asks in the units that addresses have: those of their forms, else those of their areas."""
    if row.server_only or not protocol.addresses or any(form.units_table for form in protocol.addresses):
        return
    known = {form.unit for form in protocol.addresses if form.unit is not None}
    if any(form.unit is None for form in protocol.addresses):
        known |= {area.unit for name, area in protocol.areas.items() if not row.areas or name in row.areas}
    if row.units and all(map(is_unit, row.units)) and not known & set(row.units):
        what = f"no address is counted in {listed(row.units)}: a client never comes to this row of {row.service}"
        todo = f"add a form with unit: {row.units[0]} to addresses, or server_only: yes"
        yield Problem(row.at, what, todo, warning=True)


def _points(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """The form of bits says something only where elements are bits; an order of words only where they are words."""
    odd = sorted(filter(_is_odd, _units_in(protocol, row))) if row.packing.order in _PAIRED else []
    for unit in odd if row.service in ("read", "write") else ():
        what = f"order: {row.packing.order} goes by words, and {unit} are no whole number of them"
        yield Problem(row.at, what, "give big or little")
    form = row.packing.bits
    if form == "packed" or not row.units or "bit" in row.units or not all(map(is_unit, row.units)):
        return
    if row.serve is None and "unit" not in {*row.back, *row.back_each}:
        what = f"bits: {form} has no effect: the elements of this {row.service} are never bits"
        yield Problem(row.at, what, "leave it out, or add bit to units:")


def _data(row: ServiceRow) -> Iterator[Problem]:
    """What is read comes in the reply, what is written goes with the request."""
    if row.run is not None or row.request is None:
        return
    holder = [row.reply, row.gives] if row.service == "read" else [row.request, row.buffer]
    named = {name for expression in expressions_of(holder) for name in names_in(expression.root)}
    if row.service == "read" and "data" not in named and not row.gives:
        yield Problem(row.at, "nothing says where the data of the reply stand", "add reply: {frame: {field: data}}")
    if row.service == "write" and not named & {"data", "bits"}:
        yield Problem(row.at, "nothing of what is written goes with the request", "give a field of it: data")


def _lists(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """`data` is bytes: a list of numbers or records cannot take it."""
    for made in (row.request, *(reply.frame for reply in row.reply)):
        frame = protocol.frames.get(made.frame) if isinstance(made, FrameOf) else None
        if frame is None or not isinstance(made, FrameOf):
            continue
        lists = {name for part in flat(frame.segments) if part.is_list for name in part.value_names}
        for name in lists & made.fields.keys():
            value = made.fields[name]
            if isinstance(value, Expression) and isinstance(value.root, Name) and value.root.name == "data":
                what = f"'data' is bytes, and '{name}' of '{frame.name}' is a list"
                yield Problem(value.root.at, what, f"write data: {name} with a size in place of the list")


def _sides(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """Requests are frames of the client, replies of the server."""
    made = [(row.request, "server", "request")] + [(reply.frame, "client", "reply") for reply in row.reply]
    for frame_of, wrong, what in made:
        frame = protocol.frames.get(frame_of.frame) if frame_of is not None else None
        if frame is not None and frame_of is not None and frame.side == wrong:
            yield Problem(frame_of.at, f"'{frame.name}' comes from the {wrong}, it is no {what}", "take another frame")


def _amounts(row: ServiceRow) -> Iterator[Problem]:
    """Limits that let something through."""
    for expression in (row.limit.count, row.limit.bytes):
        number = constant_number(expression)
        if number is not None and number < 1 and expression is not None:
            yield Problem(expression.at, f"a limit of {number} lets nothing through", "give 1 or more, or leave it out")
    if row.limit.count is not None and constant_number(row.limit.count) != 1 and _asks_for_one(row):
        what = "the limit has no effect: a request that says no count, bytes or total asks for one element"
        yield Problem(row.limit.count.at, what, "name count in the request, or leave the limit out")
    if row.align_bits < 1:
        yield Problem(row.at, f"nothing can be aligned to {row.align_bits} bits", "give 8, 16, …")
    for argument in row.takes:
        number = constant_number(argument.default)
        if number is None or argument.limits is None or argument.default is None:
            continue
        if not argument.limits[0] <= number <= argument.limits[1]:
            low, high = argument.limits
            what = f"the default {number} of '{argument.name}' is not in {low}..{high}"
            yield Problem(argument.default.at, what, "correct one of them")


def _asks_for_one(row: ServiceRow) -> bool:
    """Whether a request of a client's row names nothing that says how many elements it is about."""
    if row.service not in ("read", "write") or row.server_only or row.request is None:
        return False
    if any(True for _ in parts_of([row.request, row.buffer], EachOf)):
        return False
    return not mentions_of(row) & COUNTING


def _limits_too_high(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """A limit that lets through more than the field of the request holds that says how many."""
    limits = {"count": row.limit.count, "bytes": row.limit.bytes}
    for made in () if row.server_only else parts_of(row.request, FrameOf):
        frame = protocol.frames.get(made.frame)
        for name, value in made.fields.items() if frame is not None else ():
            root = value.root if isinstance(value, Expression) else None
            limit = limits.get(root.name) if isinstance(root, Name) else None
            number = constant_number(limit)
            spans = [] if frame is None else _spans(name, frame)
            if limit is None or number is None or not spans or number <= max(high for _, high in spans):
                continue
            most = max(high for _, high in spans)
            what = f"a limit of {number} lets more through than '{name}' of '{made.frame}' holds, which is {most}"
            yield Problem(limit.at, what, f"give {most} or less")


def _dead(rows: tuple[ServiceRow, ...]) -> Iterator[Problem]:
    """A row that takes everything a later one could get."""
    for place, row in enumerate(rows):
        for earlier in rows[:place]:
            plain = earlier.when is None and earlier.align_bits == 1 and earlier.request is not None
            areas = not earlier.areas or (row.areas and set(row.areas) <= set(earlier.areas))
            units = not earlier.units or (row.units and set(row.units) <= set(earlier.units))
            alike = bool(earlier.most_variables) == bool(row.most_variables)
            alike = alike and (earlier.client_only, earlier.server_only) == (row.client_only, row.server_only)
            if plain and areas and units and alike and row.service in ("read", "write") and _names_places(earlier):
                what = f"this row of {row.service} is never reached: one above takes all its areas and units"
                yield Problem(row.at, what, "move it up, or add when:")
                break


def _names_places(row: ServiceRow) -> bool:
    """Whether a row speaks of places by numbers alone; with text or parts of addresses it may not take every one."""
    named = {name for expression in expressions_of(row.request) for name in names_in(expression.root)}
    return "start" in named and not named - {
        "station",
        "own",
        "area",
        "start",
        "count",
        "bytes",
        "data",
        "bits",
        "code",
    }


def _areas(protocol: Protocol, broken: Collection[str]) -> Iterator[Problem]:
    for area in protocol.areas.values():
        if area.size < 1:
            yield Problem(area.at, f"area '{area.name}' has no places", "give size: 1 or more")
        if area.type == COUNTED_STRING and (area.element_bits < 32 or area.element_bits % 16):
            what = f"an element of area '{area.name}' is a {area.unit}, which holds no word of a length and characters"
            yield Problem(area.at, what, "give a unit of 4, 6, … bytes")
        elif area.type is not None and NUMBER_BITS.get(area.type, area.element_bits) != area.element_bits:
            what = f"a {area.type} is no {area.unit}, which an element of area '{area.name}' is"
            yield Problem(area.at, what, "give a type of that width")
        if area.order in _PAIRED:
            forms = (one for one in protocol.addresses if not isinstance(one.area, str) or one.area == area.name)
            units = {area.unit, *area.codes}.union(*(_units_of(protocol, form) for form in forms))
            for unit in sorted(filter(_is_odd, units)):
                what = f"order: {area.order} goes by words, and {unit} are no whole number of them"
                yield Problem(area.at, f"{what}, in area '{area.name}'", "give big or little")
        for unit in area.codes:
            if is_unit(unit) and unit not in UNIT_BITS and unit != area.unit:
                what = f"'{unit}' in the codes of area '{area.name}' is not a unit"
                yield Problem(area.at, what, did_you_mean(unit, UNIT_BITS))
    told = bool(protocol.addresses) or "addresses" in broken
    if protocol.areas and not told and {"read", "write"} & protocol.services.keys():
        what = "there are areas, but no form of address to name places in them"
        yield Problem(protocol.at, what, 'add addresses: [{form: "{area}{start:dec}"}]')


def _errors(protocol: Protocol, broken: Collection[str]) -> Iterator[Problem]:
    errors = protocol.errors
    if errors is None:
        return
    for name, at in {names.table: names.at for names in errors.names}.items():
        if name not in protocol.tables and name not in broken:
            hint = did_you_mean(name, protocol.tables) or "add it to tables:"
            yield Problem(at, f"there is no table '{name}'", hint)
        for key in _texts_for_numbers(protocol, name):
            what = f"'{key}' in the table '{name}' is no number, and the code of an error is one"
            yield Problem(protocol.tables[name].at, what, "write the number of the code")
    if errors.frames and errors.code is None:
        yield Problem(errors.at, f"nothing says where the code stands in '{errors.frames[0]}'", "add code: FIELD")


def _texts_for_numbers(protocol: Protocol, table: str) -> list[str]:
    """Texts among the keys of a table that names codes, where the frames of errors have numbers for them."""
    errors = protocol.errors
    root = None if errors is None or errors.code is None else errors.code.root
    if errors is None or not isinstance(root, Name) or table not in protocol.tables:
        return []
    names = [frame for name in errors.frames if name in protocol.frames or name in protocol.groups
             for frame in protocol.frames_of(name)]  # fmt: skip
    fields = [one for name in names for one in parts_of(protocol.frames[name].segments, Field) if one.name == root.name]
    if not fields or not all(one.type.is_whole_number for one in fields):
        return []
    return [key for key in protocol.tables[table].entries if isinstance(key, str)]


def _codes(protocol: Protocol) -> Iterator[Problem]:
    """Two areas with one code for a unit can't be told apart by a server."""
    seen: dict[tuple[str, object], str] = {}
    for area in protocol.areas.values():
        for unit, code in area.codes.items():
            other = seen.setdefault((unit, code), area.name)
            if other != area.name and code != 0:
                yield Problem(
                    area.at, f"areas '{other}' and '{area.name}' have the same code for {unit}", "give each its own"
                )
