"""Requests as a server reads them: the meaning of each service row, and the row that a request selects.

A request is read backwards, by the same rows that clients build it by.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from framekit.definition.check.addresses import parts_in, units_in
from framekit.definition.expression import (
    COLUMNS,
    Attribute,
    Call,
    Compare,
    Expression,
    Name,
    Node,
    children,
    inverse_steps,
    is_constant,
    names_in,
    walk,
)
from framekit.definition.fingerprint import fingerprint
from framekit.definition.kinds.base import Segment
from framekit.definition.model.frames import (
    Frame,
    attributes_in,
    expressions_of,
    field_names,
    names_always_there,
    names_read,
    parts_of,
)
from framekit.definition.model.procedure import Row, Sequence
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Data
from framekit.definition.model.services import (
    AS_NUMBERS,
    NOT_COMPARED,
    OFFERED,
    ServiceRow,
    is_passed_over,
    mentions_of,
    only_start,
    told_by,
)
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, RecordOf, Value
from framekit.definition.problems import Problem


def check_request_matching(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """Report reasons why a server cannot understand the requests of this row."""
    yield from _items(row)
    yield from _sent(row)
    yield from _lists_of_some(protocol, row)
    if row.service not in ("read", "write") or (row.serve is not None and row.serve.moves_data):
        return  # their `serve` gives the source of its places
    if row.client_only or row.request is None or not serves(protocol):
        return
    if row.service == "write":
        yield from _uncounted(protocol, row)
    if row.serve is not None:
        return
    read = {*row.back, *row.back_each, *_told_of_lists(row)}
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
        return  # misspelt names are reported elsewhere
    if "text" not in read:
        yield from _parts_of_addresses(protocol, row, read)
    if row.service == "write" and not read & SENT and mentions_of(row) & SENT:
        what = "a server cannot tell what this write brings"
        todo = "each: {value: …}" if _list_names(row) else "value: …"
        yield Problem(row.at, what, f"add back: {{{todo}}} with what it means, or client_only: yes")
    for missing in _missing_names(protocol, row, read):
        what = f"a server cannot tell the {missing} that this {row.service} asks for"
        yield Problem(row.at, what, f"put it into the request, or add back: {{{missing}: …}}, or client_only: yes")


def _parts_of_addresses(protocol: Protocol, row: ServiceRow, read: set[str]) -> Iterator[Problem]:
    """Report parts of an address that `back` uses although the request does not give them: no such request fits."""
    parts = {part.name for form in protocol.addresses for part in parts_in(form)}
    unknown = parts - read - {"area", "unit", "start", "count"} - protocol.params.keys() - protocol.state.keys()
    unknown -= {name for form in protocol.addresses for name in form.results}
    for expression in row.back.values():
        for node in walk(expression.root):
            if isinstance(node, Name) and node.name in unknown:
                what = f"a server does not know '{node.name}', a part of the address, when it reads a request"
                yield Problem(node.at, what, f"write request.{node.name} for a field of the request, or give text:")


SENT = frozenset({"data", "bits", *AS_NUMBERS})
"""Names of the values that a write carries."""


def _sent(row: ServiceRow) -> Iterator[Problem]:
    """Report `back` that gives the written values twice, or gives values in a row of a service that writes none."""
    back = {**row.back, **row.back_each}
    given = sorted(SENT & back.keys())
    for name in given if row.service != "write" else ():
        what = f"{name} has no effect in back: a row of {row.service} writes no elements"
        yield Problem(back[name].at, what, "leave it out")
    for name in given[1:] if row.service == "write" else ():
        yield Problem(back[name].at, f"back says twice what is written: {given[0]} and {name}", "leave one of them out")


def _items(row: ServiceRow) -> Iterator[Problem]:
    """Report keys of items that `back` gives for a whole list, and `each` without a list."""
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


OF_SOME = ("unit", "count", "bytes")
"""Variables of a list whose value its `when` may give to a server."""


def _told_of_lists(row: ServiceRow) -> set[str]:
    """Return the variables of a request whose values follow from the conditions of its lists."""
    lists = parts_of([row.request, row.buffer], EachOf)
    return {name for each in lists for name in told_by(each.when) or ()} & {*OF_SOME}


def _lists_of_some(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """Report lists for some of the variables that may overlap, or whose items a server cannot identify."""
    asked = list(parts_of([row.request, row.buffer], EachOf))
    is_split = any(each.when is not None for each in asked)
    for lists in (asked, *(list(parts_of([reply.frame, reply.buffer], EachOf)) for reply in row.reply)):
        conditions = [each.when for each in lists if each.when is not None]
        for each in lists:
            if each.when is None and (conditions or is_split):
                what = "other lists of this row are for some of the variables, and this one does not say for which"
                yield Problem(each.at, what, "add when: beside each:")
        yield from _both_hold(conditions)
    for when in (each.when for each in asked if each.when is not None):
        says = told_by(when)
        if serves(protocol) and not row.client_only and (says is None or not says.keys() <= {*OF_SOME}):
            what = f"a server cannot tell from '{when}' what the items of this list are"
            yield Problem(when.at, what, "compare count, bytes or unit with a value by ==, or add client_only: yes")


def _both_hold(conditions: list[Expression]) -> Iterator[Problem]:
    """Report conditions of lists that may both hold for a variable, which would then be in two lists."""
    for place, later in enumerate(conditions):
        for earlier in conditions[:place]:
            one, other = told_by(earlier), told_by(later)
            if one is None or other is None or fingerprint(earlier) == fingerprint(later):
                continue
            if all(one[name] == other[name] for name in one.keys() & other.keys()):
                what = f"a variable may be in two lists: '{earlier}' and '{later}' may both hold"
                yield Problem(later.at, what, "compare the same name with another value in each")


def _reads_of(node: Node, lists: Mapping[str, EachOf]) -> Iterator[Attribute]:
    """Yield the places where an expression reads a list of the request, other than for its number of items."""
    if isinstance(node, Attribute) and node.name in lists and "request" in names_in(node):
        yield node
    elif not (isinstance(node, Call) and node.function == "len"):
        for child in children(node):
            yield from _reads_of(child, lists)


def _list_names(row: ServiceRow) -> dict[str, EachOf]:
    """Return the lists of the request with an item for each variable, by name."""
    sent = [row.request, row.buffer]
    holders: list[FrameOf | LayoutOf | RecordOf] = [*parts_of(sent, FrameOf), *parts_of(sent, LayoutOf)]
    holders += parts_of(sent, RecordOf)
    return {name: value for made in holders for name, value in made.fields.items() if isinstance(value, EachOf)}


def item_names(protocol: Protocol, row: ServiceRow) -> set[str]:
    """Return the fields of the items of the request's lists."""
    sent, lists, found = [row.request, row.buffer], _list_names(row), set[str]()
    frames = [protocol.frames.get(made.frame) for made in parts_of(sent, FrameOf)]
    layouts = [protocol.layouts.get(made.layout) for made in parts_of(sent, LayoutOf)]
    for repeat in parts_of([holder.segments for holder in (*frames, *layouts) if holder is not None], Segment):
        if repeat.is_list and repeat.name in lists:
            found |= field_names(repeat.inner_record or ())
    return found


def _known_names(protocol: Protocol, row: ServiceRow) -> set[str]:
    """Return the names that the leaves of a request may have."""
    known = {*OFFERED, *NOT_COMPARED, "memory", *row.back, *row.back_each, *(argument.name for argument in row.takes)}
    known |= protocol.params.keys() | protocol.state.keys() | protocol.tables.keys()
    for form in protocol.addresses:
        known |= form.names
    return known


def _missing_names(protocol: Protocol, row: ServiceRow, read: set[str]) -> Iterator[str]:
    """Yield `area` and `start` if no part of the request gives them."""
    if "text" in read:
        return
    if not read & {"area", "memory", "code"} and len(row.areas) != 1:
        yield "area"
    if "start" not in read and only_start(protocol.addresses, row.areas) is None:
        yield "start"


_FILLED_UP = ("packed", "aligned", "nibble_each")
"""Forms of bits whose data are padded to whole bytes."""


def _uncounted(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """Report writes without a count whose data may be longer than the written elements: a server would write the rest,
    too.
    """
    sent = [part for part in (row.request, row.buffer) if part is not None]
    found = (inverse_steps(leaf) for leaf in _compared(sent))
    read = {*row.back, *row.back_each, *_told_of_lists(row), *(one[0] for one in found if one is not None)}
    if read & {"count", "bits"} or not read & {"data", "bytes"}:
        return
    form = row.packing.bits
    step = 2 if form == "nibble_each" else 8
    if form in _FILLED_UP and row.align_bits % step and "bit" in units_in(protocol, row):
        what = f"bits: {form} fills the data up to whole bytes, so a server cannot tell how many bits this write is for"
    elif "bytes" not in read and any(name in _padded(protocol, sent) for name in _holders_of_data(sent)):
        what = "padding may follow the data, so a server cannot tell how many elements this write is for"
    else:
        return
    todo = "each: {count: …}" if _list_names(row) else "count: …"
    yield Problem(row.at, what, f"give count: put it into the request, or add back: {{{todo}}}, or client_only: yes")


def _holders_of_data(values: Iterable[Value]) -> Iterator[str]:
    """Yield the fields that hold `data`."""
    for made in values:
        if isinstance(made, (FrameOf, LayoutOf, RecordOf, EachOf)):
            for name, value in made.fields.items():
                if isinstance(value, Expression) and isinstance(value.root, Name) and value.root.name == "data":
                    yield name
            yield from _holders_of_data(made.fields.values())


def _padded(protocol: Protocol, sent: list[Value]) -> set[str]:
    """Return the names of padded data in the frames and layouts of a request."""
    frames = [protocol.frames.get(made.frame) for made in parts_of(sent, FrameOf)]
    layouts = [protocol.layouts.get(made.layout) for made in parts_of(sent, LayoutOf)]
    holders = [holder.segments for holder in (*frames, *layouts) if holder is not None]
    return {one.name for one in parts_of(holders, Data) if one.pad is not None}


def serves(protocol: Protocol) -> bool:
    """Return whether devices can use this definition; for an application, the protocol that carries it decides."""
    if protocol.kind == "application":
        return True
    return any(step.serve is not None for sequence in protocol.sequences.values() for step in sequence.steps)


def check_stations(protocol: Protocol) -> Iterator[Problem]:
    """Report requests with a station that no device compares with its own: every device would answer them."""
    for name in dict.fromkeys(name for role in protocol.roles.values() for name in role.listens):
        sequences = protocol.called_from([name])
        if protocol.station.type != "none" and any(step.serve for one in sequences for step in one.steps):
            yield from _stations_not_compared(protocol, name, sequences)


def _requests_received(
    protocol: Protocol, sequences: Collection[Sequence]
) -> Iterator[tuple[ServiceRow, FrameOf, Frame]]:
    """Yield the rows of services whose request these sequences receive, with request and frame."""
    received = {frame for row in parts_of(sequences, Row) for frame in row.frames}
    for row in protocol.service_rows:
        frame = None if row.request is None else protocol.frames.get(row.request.frame)
        if row.request is not None and frame is not None and frame.name in received and not row.client_only:
            yield row, row.request, frame


def _stations_not_compared(protocol: Protocol, name: str, sequences: Collection[Sequence]) -> Iterator[Problem]:
    """Report fields with a station that the sequences which serve from sequence `name` on do not compare."""
    nodes = [node for one in expressions_of(sequences) for node in walk(one.root)]
    read = {node.name for node in nodes if isinstance(node, Attribute)}
    compared = {field for node in nodes if isinstance(node, Compare) for field in _compared_with_own(node)}
    reported: set[str] = set()
    for _, made, frame in _requests_received(protocol, sequences):
        if any("own" in names_in(rule.root) for rule in expressions_of(frame)):
            continue  # a frame's own rules look at the station
        if made.fields.keys() & compared:
            continue
        fields = field_names(frame.segments)
        for field_name, value in made.fields.items():
            has_station = isinstance(value, Expression) and "station" in names_in(value.root)
            if not has_station or field_name not in fields or field_name in read | reported:
                continue
            reported.add(field_name)
            what = f"'{field_name}' of a request is not compared with the device's own station in '{name}', so every "
            plain = isinstance(value, Expression) and isinstance(value.root, Name)
            todo = "station: own" if plain else f"when: it.{field_name} == …"
            todo = f"add {todo} to the row that receives it"
            yield Problem(value.at, what + "device answers every station", todo, warning=True)


def check_settings(protocol: Protocol) -> Iterator[Problem]:
    """Report requests with a parameter that the device does not compare: it would answer requests for other devices."""
    compared = {name for name, one in protocol.params.items() if one.is_compared}
    listening = [name for role in protocol.roles.values() for name in role.listens]
    sequences = protocol.called_from(listening)
    if not compared or not any(step.serve for one in sequences for step in one.steps):
        return
    read = attributes_in(sequences)
    of_places = {name for form in protocol.addresses for name in form.names}
    reported: set[tuple[str, str]] = set()
    for row, request, frame in _requests_received(protocol, sequences):
        hidden = of_places if row.service in ("read", "write") else {argument.name for argument in row.takes}
        own = compared - hidden
        seen = read | attributes_in([row.back, row.back_each, row.when, row.refuse, row.serve])
        ruled = names_read(frame)
        for field_name, value in _leaves_of(request):
            found = inverse_steps(value)
            if found is None or found[0] not in own - ruled or field_name in seen or (field_name, found[0]) in reported:
                continue
            reported.add((field_name, found[0]))
            yield _not_compared(field_name, value, found[0])


def _not_compared(field_name: str, value: Expression, parameter: str) -> Problem:
    what = f"'{field_name}' of a request is not compared with the device's parameter '{parameter}', so a device"
    todo = f"add station: own (or when: it.{field_name} == {value}) to the row that receives it; or, if only the "
    todo += "client has this parameter, add from: client to it"
    return Problem(value.at, f"{what} answers requests to others", todo, warning=True)


def check_of_client(protocol: Protocol) -> Iterator[Problem]:
    """Report `from: client` for a parameter that no device would compare anyway."""
    served = [row for row in protocol.service_rows if not row.client_only] if serves(protocol) else []
    sent: list[Any] = [part for row in served for part in (row.request, row.buffer)]
    frames = (protocol.frames.get(made.frame) for made in parts_of(sent, FrameOf))
    sent += [frame.segments for frame in frames if frame is not None]
    sent_names = names_read(sent)
    for one in protocol.params.values():
        if not one.of_client or one.at.file != protocol.at.file:
            continue  # of an application: some of its carriers use it
        if not replace(one, of_client=False).is_compared:
            kind = "a secret" if one.secret else "one with is:" if one.is_ is not None else f"a {one.type}"
            what = f"from: client has no effect: '{one.name}' is {kind}, which no device compares"
        elif one.name not in sent_names:
            what = f"from: client has no effect: no request that a device serves tells '{one.name}'"
        else:
            continue
        yield Problem(one.at, what, "leave it out")


def _leaves_of(made: FrameOf | LayoutOf | RecordOf) -> Iterator[tuple[str, Expression]]:
    """Yield the fields and the expressions that fill them, those of inner records and layouts included."""
    for name, value in made.fields.items():
        if isinstance(value, Expression):
            yield name, value
        elif isinstance(value, (LayoutOf, RecordOf)):
            yield from _leaves_of(value)


def _compared_with_own(node: Compare) -> Iterator[str]:
    """Yield the fields in a comparison with the own station."""
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


REMEDY = "tell them apart by a constant in the request or by when:, or add client_only: yes"


def check_unserved(protocol: Protocol) -> Iterator[Problem]:
    """Report rows whose requests a server reads by an earlier row."""
    if not serves(protocol):
        return
    above: dict[str, _Earlier] = {}
    for row in protocol.service_rows:
        if row.request is None or row.client_only or row.request.frame not in protocol.frames:
            continue
        earlier = above.setdefault(row.request.frame, _Earlier())
        for one in earlier.possible(row):
            alike = _Alike(protocol)
            if _takes_all(alike, one, row):  # the first matching row answers
                if not alike.same or _told(one) != _told(row):
                    what = f"a server never comes to this row of {row.service}: it reads every '{row.request.frame}' "
                    where = "" if one.at.file == row.at.file else f" of {Path(one.at.file).name}"
                    what += f"that fits here by the row of {one.service} in line {one.at.line}{where}"
                    yield Problem(row.at, what, REMEDY)
                break
        earlier.add(row)


class _Earlier:
    """The rows with requests of one frame, by their constants: a row takes only requests with the same constants."""

    def __init__(self) -> None:
        self._rows: dict[tuple[str, ...], dict[tuple[str | None, ...], list[tuple[int, ServiceRow]]]] = {}
        """The rows with their numbers, by the names of their constants and by the constants."""
        self._count = 0

    def add(self, row: ServiceRow) -> None:
        constants = _constants(row)
        same = self._rows.setdefault(tuple(constants), {})
        same.setdefault(tuple(constants.values()), []).append((self._count, row))
        self._count += 1

    def possible(self, later: ServiceRow) -> list[ServiceRow]:
        """Return the rows that may take the requests of a later row, in their order."""
        constants = _constants(later)
        found = [
            numbered
            for names, rows in self._rows.items()
            for numbered in rows.get(tuple(constants.get(name) for name in names), ())
        ]
        return [row for _, row in sorted(found, key=lambda numbered: numbered[0])]


def _constants(row: ServiceRow) -> dict[str, str]:
    """Return fingerprints of the constant fields of a request by name, and of its condition under ''."""
    fields = {} if row.request is None else row.request.fields
    found = {
        name: fingerprint(value)
        for name, value in sorted(fields.items())
        if isinstance(value, Expression) and is_constant(value)
    }
    when = _when(row)
    return found if when is None else {"": fingerprint(when), **found}


def _takes_all(alike: _Alike, earlier: ServiceRow, later: ServiceRow) -> bool:
    """Return whether the earlier row matches every request that the later row matches."""
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
    """Return whether `back` of the earlier row can be computed whenever that of the later row can."""
    read = [(later.back.get(name), value) for name, value in earlier.back.items() if name != "when"]
    read += [(later.back_each.get(name), value) for name, value in earlier.back_each.items()]
    return all(
        not names_in(value.root) or isinstance(value.root, Name) or fingerprint(value) == fingerprint(other)
        for other, value in read
    )


def _areas_fit(earlier: ServiceRow, later: ServiceRow) -> bool:
    """Return whether the earlier row is for every area that a request of the later row can name."""
    source = _area_source(earlier)
    if source == "code" and _area_source(later) != "code":
        return False
    if source not in ("text", "code") or not earlier.areas:
        return True
    return _area_source(later) == source and bool(later.areas) and set(later.areas) <= set(earlier.areas)


def _area_source(row: ServiceRow) -> str:
    """Return the source of the area for a server: `text`, `code`, `area` of back, or '' for the row itself."""
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
    """Return a fingerprint of all that a server derives from a row once its request is read."""
    places = () if _area_source(row) else (row.areas, row.units)
    transfer = row.service if row.service in ("read", "write") else ""
    back = {name: value for name, value in row.back.items() if name != "when"}
    return fingerprint((transfer, places, back, row.back_each, row.reply, row.refuse, row.serve, row.packing))


@dataclass
class _Alike:
    """Comparison of the requests of two rows."""

    protocol: Protocol
    names: list[str] = field(default_factory=list)
    """Names that the first row reads."""
    same: bool = True
    """Whether both rows read the same names at the same places."""

    def covers(self, one: Value, other: Value | None) -> bool:
        """Return whether the first value accepts everything that the other value may be."""
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
            case RecordOf(fields=fields), RecordOf(fields=given):
                return self._fields(fields, given, ())
            case EachOf(fields=fields, when=when), EachOf(fields=given, when=there):
                return fingerprint(when) == fingerprint(there) and self._fields(fields, given, ())
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
