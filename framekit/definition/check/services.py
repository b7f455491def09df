"""Services, areas, errors: constructors name fields there are, areas and units are known, a reply always fits."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from framekit.definition.check.addresses import is_unit
from framekit.definition.check.backwards import NOT_COMPARED, check_backwards, serves
from framekit.definition.check.known_names import OFFERED
from framekit.definition.check.segments import constant_number
from framekit.definition.check.unserved import check_unserved
from framekit.definition.expression.syntax import Expression, Name, Text, names_in
from framekit.definition.model.frames import Frame
from framekit.definition.model.procedure import Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Repeat
from framekit.definition.model.services import COUNTED_STRING, NUMBER_BITS, UNIT_BITS, ServiceRow
from framekit.definition.model.values import FrameOf, LayoutOf, ReadAs
from framekit.definition.model.walk import expressions_of, field_names, flat, names_needed, parts_of
from framekit.definition.problems import Problem, did_you_mean, listed


def check_services(protocol: Protocol, broken: Collection[str] = ()) -> list[Problem]:
    """Everything wrong with services, areas and errors; and with constructors anywhere."""
    found = list(_constructors(protocol, broken))
    for rows in protocol.services.values():
        for row in rows:
            found += _row(protocol, row, broken)
            found += _sides(protocol, row)
            found += _amounts(row)
            found += check_backwards(protocol, row)
        found += _dead(rows)
    told = {problem.at for problem in found}
    found += [problem for problem in check_unserved(protocol) if problem.at not in told]
    return [*found, *_areas(protocol), *_codes(protocol), *_errors(protocol, broken)]


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
    for layout in parts_of(holders, LayoutOf):
        if layout.layout in protocol.layouts:
            yield from _fields(layout, "layout", layout.layout, field_names(protocol.layouts[layout.layout].segments))
    for read in parts_of(holders, ReadAs):
        if read.layout not in protocol.layouts and read.layout not in broken:
            yield Problem(read.at, f"there is no layout '{read.layout}'", did_you_mean(read.layout, protocol.layouts))


def _never_built(protocol: Protocol) -> set[int]:
    """What is only compared with what comes: requests nobody asks, replies nobody gives."""
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


def _fields(made: FrameOf | LayoutOf, kind: str, name: str, known: set[str]) -> Iterator[Problem]:
    for field, value in made.fields.items():
        if field not in known:
            yield Problem(value.at, f"{kind} '{name}' has no field '{field}'", did_you_mean(field, known))


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
        lists = {part.name for part in flat(frame.segments) if isinstance(part, Repeat)}
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


def _areas(protocol: Protocol) -> Iterator[Problem]:
    for area in protocol.areas.values():
        if area.size < 1:
            yield Problem(area.at, f"area '{area.name}' has no places", "give size: 1 or more")
        if area.type == COUNTED_STRING and (area.element_bits < 32 or area.element_bits % 16):
            what = f"an element of area '{area.name}' is a {area.unit}, which holds no word of a length and characters"
            yield Problem(area.at, what, "give a unit of 4, 6, … bytes")
        elif area.type is not None and NUMBER_BITS.get(area.type, area.element_bits) != area.element_bits:
            what = f"a {area.type} is no {area.unit}, which an element of area '{area.name}' is"
            yield Problem(area.at, what, "give a type of that width")
        for unit in area.codes:
            if is_unit(unit) and unit not in UNIT_BITS and unit != area.unit:
                what = f"'{unit}' in the codes of area '{area.name}' is not a unit"
                yield Problem(area.at, what, did_you_mean(unit, UNIT_BITS))
    if protocol.areas and not protocol.addresses and {"read", "write"} & protocol.services.keys():
        what = "there are areas, but no form of address to name places in them"
        yield Problem(protocol.at, what, 'add addresses: [{form: "{area}{start:dec}"}]')


def _errors(protocol: Protocol, broken: Collection[str]) -> Iterator[Problem]:
    errors = protocol.errors
    if errors is None:
        return
    for name in dict.fromkeys(names.table for names in errors.names):
        if name not in protocol.tables and name not in broken:
            hint = did_you_mean(name, protocol.tables) or "add it to tables:"
            yield Problem(errors.at, f"there is no table '{name}'", hint)
    if errors.frames and errors.code is None:
        yield Problem(errors.at, f"nothing says where the code stands in '{errors.frames[0]}'", "add code: FIELD")


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
