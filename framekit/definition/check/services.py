"""Services, areas, errors: constructors name existing fields, areas and units are known, some reply always applies."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

from framekit.definition.check.addresses import PAIRED, is_odd, is_unit, units_in, units_of
from framekit.definition.check.requests import (
    check_of_client,
    check_request_matching,
    check_settings,
    check_stations,
    check_unserved,
    serves,
)
from framekit.definition.expression import Expression, Name, Real, Text
from framekit.definition.kinds.base import Segment, constant_number
from framekit.definition.model.frames import (
    Frame,
    Layout,
    field_names,
    flat,
    names_needed,
    names_read,
    parts_of,
)
from framekit.definition.model.procedure import Step
from framekit.definition.model.protocol import Protocol, Rest
from framekit.definition.model.segments import Field, Repeat
from framekit.definition.model.services import (
    AS_NUMBERS,
    COUNTED_STRING,
    COUNTING,
    NOT_COMPARED,
    NUMBER_BITS,
    OFFERED,
    UNIT_BITS,
    ServiceRow,
    mentions_of,
)
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ReadAs, Value
from framekit.definition.problems import Problem, did_you_mean, listed


def check_services(protocol: Protocol, broken: Collection[str] = ()) -> list[Problem]:
    """Return all problems of services, areas and errors, and of constructors anywhere."""
    found = list(_constructors(protocol, broken))
    for rows in protocol.services.values():
        for row in rows:
            found += _row(protocol, row, broken)
            found += _sides(protocol, row)
            found += _amounts(row)
            found += _limits_too_high(protocol, row)
            found += check_request_matching(protocol, row)
        found += _dead(rows)
    found += [*check_stations(protocol), *check_settings(protocol), *check_of_client(protocol)]
    reported = {problem.at for problem in found}
    found += [problem for problem in check_unserved(protocol) if problem.at not in reported]
    return [*found, *_areas(protocol, broken), *_codes(protocol), *_errors(protocol, broken), *_probe(protocol, broken)]


def _probe(protocol: Protocol, broken: Collection[str]) -> Iterator[Problem]:
    """Report a probe that names no request or two, an unknown service, or a service that writes."""
    probe = protocol.probe
    if probe is None:
        return
    if (probe.read is None) == (probe.call is None):
        what = "the probe names no request" if probe.read is None else "the probe names two requests"
        yield Problem(probe.at, what, "write one: read: ADDRESS or call: SERVICE")
        return
    if probe.call is None:
        if "read" not in protocol.services and "services" not in broken:
            yield Problem(probe.at, "the probe reads, and there is no service read", "write call: with another service")
        if probe.arguments:
            yield Problem(probe.at, "with has no effect on a read", "leave with out")
        return
    rows = protocol.services.get(probe.call)
    if rows is None:
        if probe.call not in broken:
            hint = did_you_mean(probe.call, protocol.services) or "name one of services:"
            yield Problem(probe.at, f"there is no service '{probe.call}'", hint)
        return
    if any(row.may_write(protocol.state) for row in rows):
        yield Problem(probe.at, f"service '{probe.call}' writes, and a probe may not", "name a service that only reads")
    taken = {argument.name for row in rows for argument in row.takes}
    for name in probe.arguments.keys() - taken:
        hint = did_you_mean(name, taken) or "leave it out"
        yield Problem(probe.at, f"service '{probe.call}' takes no '{name}'", hint)


def _constructors(protocol: Protocol, broken: Collection[str]) -> Iterator[Problem]:
    """Report constructors `{frame: {field: …}}` with fields that the frame lacks, and missing or impossible fields."""
    holders = [protocol.sequences, protocol.services, protocol.errors]
    asked = {id(step.ask) for step in parts_of(dict(protocol.sequences), Step) if step.ask is not None}
    never_built = _never_built(protocol)
    for made in parts_of(holders, FrameOf):
        frame = None if id(made) in asked else protocol.frames.get(made.frame)  # `ask` names a service
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


def check_constructors_of(rest: Rest, protocol: Protocol) -> Iterator[Problem]:
    """Yield unknown fields in constructors of frames with errors, and in rows with errors."""
    known = {name: field_names(frame.segments) for name, frame in protocol.frames.items()}
    partly = {frame.name: field_names(frame.segments) | frame.lost for frame in rest.frames if frame.lost is not None}
    rows = [row for row, _ in rest.rows]
    for holders, fields in ((rows, known | partly), ([protocol.sequences, protocol.services, protocol.errors], partly)):
        asked = {id(step.ask) for step in parts_of(holders, Step) if step.ask is not None}
        for made in parts_of(holders, FrameOf):
            if made.frame in fields and id(made) not in asked:
                yield from _fields(made, "frame", made.frame, fields[made.frame])


def _never_built(protocol: Protocol) -> set[int]:
    """Return the identities of constructors that are only compared: requests that no client sends, replies that no
    server sends.
    """
    rows, asks = protocol.service_rows, protocol.commands is None
    found = {id(row.request) for row in rows if row.server_only or not asks}
    return found | {id(reply.frame) for row in rows if row.client_only or not serves(protocol) for reply in row.reply}


def _missing(made: FrameOf, frame: Frame) -> Iterator[Problem]:
    """Report fields of a frame that are neither given, nor computed by its definition, nor repeated from a request."""
    if made.fields.keys() - field_names(frame.segments):
        return  # a misspelt field, reported already
    missing = [name for name in names_needed(frame.segments) if name not in made.fields and name not in frame.echo]
    if missing:
        what = f"nothing gives {listed(repr(name) for name in missing)} of '{made.frame}'"
        known = {*NOT_COMPARED, *OFFERED} - AS_NUMBERS  # fields of these names mostly hold data
        todo = ", ".join(f"{name}: {name if name in known else '…'}" for name in missing)
        yield Problem(made.at, what, f"add {todo}")


def _never_fit(protocol: Protocol, made: FrameOf, frame: Frame) -> Iterator[Problem]:
    """Report numbers in constructors, and codes of errors, that their fields cannot hold."""
    errors = protocol.errors
    answers = [] if errors is None else [row.frame for row in errors.answer]
    codes = errors.memory if errors is not None and len(answers) == 1 and made is answers[0] else {}
    for name, value in made.fields.items():
        if isinstance(value, Expression):
            yield from _fraction_never_fits(name, value, frame)
            is_code = isinstance(value.root, Name) and value.root.name == "code"
            yield from _numbers_never_fit(name, codes.values() if is_code else (value,), frame)


def _fraction_never_fits(name: str, value: Expression, frame: Frame) -> Iterator[Problem]:
    """Report a number with a fraction that no field of this name can hold."""
    if not isinstance(value.root, Real):
        return
    held = [one for one in parts_of(frame.segments, Segment) if name in one.value_names]
    types = [one.type for one in held if isinstance(one, Field) and one.value_kind == "number"]
    if types and not any(type_.has_fractions and type_.writes(value.root.value) for type_ in types):
        what = f"{value} does not fit: '{name}' of '{frame.name}' holds no such fraction"
        yield Problem(value.at, what, "correct one of them")


def _numbers_never_fit(name: str, values: Iterable[Expression], frame: Frame) -> Iterator[Problem]:
    """Report whole numbers that no field of this name can hold."""
    known = [(number, one.at) for one in values if (number := constant_number(one)) is not None]
    spans = _spans(name, frame) if known else []
    for number, at in known if spans else ():
        if not any(low <= number <= high for low, high in spans):
            low, high = spans[0]
            what = f"{number} does not fit: '{name}' of '{frame.name}' holds {low} to {high}"
            yield Problem(at, what, "correct one of them")


def _spans(name: str, frame: Frame) -> list[tuple[int, int]]:
    """Return the least and greatest numbers of the fields of this name; an empty list if a field has none."""
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
    elif row.service == "read" and row.request is None:
        what = "a row of read has no request: only rows of write can be procedures"
        yield Problem(row.at, what, "add request: {frame: {…}}, or give the service another name, and gives:")
    yield from _data(row)
    yield from _lists(protocol, row)
    yield from _units(protocol, row)
    yield from _points(protocol, row)
    sequences = protocol.exchanged
    if row.run is not None and isinstance(row.run.root, Text) and sequences and row.run.root.value not in sequences:
        what = f"'{row.run.root.value}' is no exchange of any role"
        yield Problem(row.run.at, what, did_you_mean(row.run.root.value, sequences))


def _units(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """Report rows with units that no address has: a client uses the units of forms, or else of areas."""
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
    """Report a form of bits for elements that are no bits, and an order of words for elements that are no words."""
    odd = sorted(filter(is_odd, units_in(protocol, row))) if row.packing.order in PAIRED else []
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
    """Report a read whose reply carries no data, and a write whose request carries none."""
    if row.run is not None or row.request is None:
        return
    holder = [row.reply, row.gives] if row.service == "read" else [row.request, row.buffer]
    named = names_read(holder)
    if row.server_only:
        named |= {*row.back, *row.back_each}
    if row.service == "read" and not named & {"data", *AS_NUMBERS} and not row.gives:
        yield Problem(row.at, "nothing says where the data of the reply stand", "add reply: {frame: {field: data}}")
    if row.service == "write" and not named & {"data", "bits", *AS_NUMBERS}:
        yield Problem(row.at, "nothing of what is written goes with the request", "give a field of it: data")


def _lists(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """Report lists whose values have the wrong form: `data` is bytes, `values` are numbers, and each: makes records."""
    sent = [row.request, row.buffer, *((reply.frame, reply.buffer) for reply in row.reply)]
    made: list[tuple[FrameOf | LayoutOf, str, Frame | Layout | None]] = []
    made += [(one, one.frame, protocol.frames.get(one.frame)) for one in parts_of(sent, FrameOf)]
    made += [(one, one.layout, protocol.layouts.get(one.layout)) for one in parts_of(sent, LayoutOf)]
    for holder, called, frame in made:
        for part in flat(() if frame is None else frame.segments):
            value = holder.fields.get(part.name or "") if isinstance(part, Repeat) else None
            if isinstance(part, Repeat) and value is not None:
                yield from _list_given(row, part, f"'{part.name}' of '{called}'", value)


def _list_given(row: ServiceRow, part: Repeat, called: str, value: Value) -> Iterator[Problem]:
    """Report a wrong form of the value for a list."""
    root = value.root if isinstance(value, Expression) else None
    name = root.name if isinstance(root, Name) else ""
    if name == "data":
        todo = "write values" if part.record is None else "write {each: {…}}"
        what = f"'data' is bytes, and {called} is a list"
        yield Problem(value.at, what, f"{todo}, or data: {part.name} with a size in place of the list")
    elif name == "values" and part.record is not None and row.service in ("read", "write"):
        what = f"'values' are numbers, and the items of {called} are records"
        todo = "write of: TYPE in the list, beside separator: or align:, in place of fields of an item"
        yield Problem(value.at, what, todo)
    elif isinstance(value, EachOf) and part.record is None:
        what = f"each: makes records, and the items of {called} are plain values"
        yield Problem(value.at, what, "write values, or of: [{field: NAME, type: …}] in the list")


def _sides(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """Report requests that are frames of the server, and replies that are frames of the client."""
    made = [(row.request, "server", "request")] + [(reply.frame, "client", "reply") for reply in row.reply]
    for frame_of, wrong, what in made:
        frame = protocol.frames.get(frame_of.frame) if frame_of is not None else None
        if frame is not None and frame_of is not None and frame.side == wrong:
            yield Problem(frame_of.at, f"'{frame.name}' comes from the {wrong}, it is no {what}", "take another frame")


def _amounts(row: ServiceRow) -> Iterator[Problem]:
    """Report useless limits and alignments, and defaults of arguments outside of their
    range.
    """
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
    """Return whether a request of a client's row carries no number of elements, so that it is for one element."""
    if row.service not in ("read", "write") or row.server_only or row.request is None:
        return False
    if any(True for _ in parts_of([row.request, row.buffer], EachOf)):
        return False
    return not mentions_of(row) & COUNTING


def _limits_too_high(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """Report limits above the greatest number that the count field of the request can hold."""
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
    """Report rows that a client never reaches because an earlier row takes all their areas and units."""
    asked = [row for row in rows if not row.server_only]
    for place, row in enumerate(asked):
        for earlier in asked[:place]:
            plain = earlier.when is None and earlier.align_bits == 1 and earlier.request is not None
            areas = not earlier.areas or (row.areas and set(row.areas) <= set(earlier.areas))
            units = not earlier.units or (row.units and set(row.units) <= set(earlier.units))
            alike = bool(earlier.most_variables) == bool(row.most_variables)
            alike = alike and earlier.client_only == row.client_only
            if plain and areas and units and alike and row.service in ("read", "write") and _names_places(earlier):
                what = f"this row of {row.service} is never reached: one above takes all its areas and units"
                yield Problem(row.at, what, "move it up, or add when:")
                break


def _names_places(row: ServiceRow) -> bool:
    """Return whether a row addresses places by numbers alone; a row with text or parts of addresses may not take every
    place.
    """
    named = names_read(row.request)
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
        *AS_NUMBERS,
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
        if area.order in PAIRED:
            forms = (one for one in protocol.addresses if not isinstance(one.area, str) or one.area == area.name)
            units = {area.unit, *area.codes}.union(*(units_of(protocol, form) for form in forms))
            for unit in sorted(filter(is_odd, units)):
                what = f"order: {area.order} goes by words, and {unit} are no whole number of them"
                yield Problem(area.at, f"{what}, in area '{area.name}'", "give big or little")
        for unit in area.codes:
            if is_unit(unit) and unit not in UNIT_BITS and unit != area.unit:
                what = f"'{unit}' in the codes of area '{area.name}' is not a unit"
                yield Problem(area.at, what, did_you_mean(unit, UNIT_BITS))
    has_forms = bool(protocol.addresses) or "addresses" in broken
    if protocol.areas and not has_forms and {"read", "write"} & protocol.services.keys():
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
    """Return the texts among the keys of a table of code names, if the frames of errors carry numbers."""
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
    """Report areas with the same code for a unit: a server cannot distinguish them."""
    seen: dict[tuple[str, object], str] = {}
    for area in protocol.areas.values():
        for unit, code in area.codes.items():
            other = seen.setdefault((unit, code), area.name)
            if other != area.name and code != 0:
                yield Problem(
                    area.at, f"areas '{other}' and '{area.name}' have the same code for {unit}", "give each its own"
                )
