"""Forms of addresses: the place that each names, its units, and the names that its results read.

Also the possible units of the elements of a service row, which follow from areas and forms.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping

from framekit.definition.expression import Attribute, Expression, Name, inverse_steps, names_in, walk
from framekit.definition.model.frames import names_read
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import (
    BASES,
    NUMBER_BITS,
    UNIT_BITS,
    AddressForm,
    AreaModel,
    FormPart,
    Maybe,
    ServiceRow,
    mentions_of,
)
from framekit.definition.model.values import Table
from framekit.definition.problems import Problem, did_you_mean

MOST_PLACES = 18
_UNIT = re.compile(r"[1-9]\d* bytes?")


def check_forms(
    forms: tuple[AddressForm, ...],
    areas: Mapping[str, AreaModel],
    tables: Mapping[str, Table],
    broken: Collection[str] = (),
) -> Iterator[Problem]:
    """Report all problems of the forms of an `addresses` section.

    `broken`: names of areas and tables with errors; forms that name them are not checked.
    """
    columns = {name for area in areas.values() for name in area.columns}
    for form in forms:
        parts = tuple(parts_in(form))
        named = names_read(form) | {form.area, form.unit, form.units_table, *(part.base for part in parts)}
        if not named.isdisjoint(broken):
            continue
        yield from _start(form, parts)
        yield from _area(form, parts)
        for part in parts:
            yield from _part(form, part, areas, columns)
        yield from _unit(form, parts, areas, tables)
        yield from _type(form)
        yield from _counts(form, tables)
        yield from _ranges(form, parts)
        yield from _names(form, parts, columns, tables, areas)


def check_parts(protocol: Protocol) -> Iterator[Problem]:
    """Report numbers and words of forms that no expression reads: addresses that differ in them would name the same
    place.
    """
    read = names_read(protocol.service_rows)
    for form in protocol.addresses:
        known = read.union(*(names_in(result.root) for result in form.results.values()))
        for part in parts_in(form):
            if part.what not in ("area", "column", "unit") and part.name != "start" and part.name not in known:
                what = f"nothing reads '{part.name}' of the form \"{form.text}\": it has no effect"
                yield Problem(form.at, what, f"say in start: what '{part.name}' does, or send it", warning=True)


def is_unit(text: str) -> bool:
    """Return whether a text has the form of a unit: a word of the language, or `6 bytes`."""
    return text in UNIT_BITS or _UNIT.fullmatch(text) is not None


def parts_in(form: AddressForm) -> Iterator[FormPart]:
    """Yield the parts in braces, including those in optional text."""
    for item in form.parts:
        for part in item.parts if isinstance(item, Maybe) else (item,):
            if isinstance(part, FormPart):
                yield part


def _start(form: AddressForm, parts: tuple[FormPart, ...]) -> Iterator[Problem]:
    if "start" not in form.results and not any(part.name == "start" for part in parts):
        what = f'the form "{form.text}" does not say where a place is'
        yield Problem(form.at, what, "add {start:dec} to it, or start: EXPRESSION")
    seen: set[str] = set()
    for part in parts:
        if part.what == "number" and part.name in seen:
            yield Problem(form.at, f"the form \"{form.text}\" has two parts '{part.name}'", "rename one of them")
        seen.add(part.name)
    ordered = form.results_in_order()
    circle = [result for name, result in form.results.items() if name not in ordered]
    if circle:
        what = f'the results of the form "{form.text}" depend on each other in a circle'
        yield Problem(circle[-1].at, what, "break the circle")


def _area(form: AddressForm, parts: tuple[FormPart, ...]) -> Iterator[Problem]:
    if form.area is None and not any(part.what in ("area", "column") for part in parts):
        what = f'the form "{form.text}" does not say which area it is'
        yield Problem(form.at, what, "add {area} to it, or area: NAME")


def _part(form: AddressForm, part: FormPart, areas: Mapping[str, AreaModel], columns: set[str]) -> Iterator[Problem]:
    if part.what == "column" and part.name not in columns and areas:
        yield Problem(form.at, f"no area has a column '{part.name}'", did_you_mean(part.name, columns))
    if isinstance(part.base, str):
        yield from _base(form, part.base, areas)
    for width in (part.least, part.most):
        if isinstance(width, str) and width not in columns and areas:
            yield Problem(form.at, f"no area has a column '{width}' for a number of places", "write 4 or 1-3")
        elif isinstance(width, int) and not 1 <= width <= MOST_PLACES:
            yield Problem(form.at, f"a number of {width} places cannot be", f"write 1 to {MOST_PLACES}")
    if isinstance(part.least, int) and isinstance(part.most, int) and part.least > part.most:
        yield Problem(form.at, f"{part.least}-{part.most} places cannot be", f"write {part.most}-{part.least}")


def _base(form: AddressForm, base: str, areas: Mapping[str, AreaModel]) -> Iterator[Problem]:
    """Report wrong uses of a number whose base (dec, hex or oct) is given by a column of the area."""
    having = [area for area in areas.values() if base in area.columns]
    if not having:
        what = f"'{base}' is neither a kind of number nor a column of an area"
        yield Problem(form.at, what, did_you_mean(base, BASES))
    elif isinstance(form.area, Expression):
        what = f"the form \"{form.text}\" works out its area, so its numbers cannot be written as column '{base}' says"
        yield Problem(form.at, what, "write {area} into it, area: NAME, or dec, hex or oct")
    elif isinstance(form.area, str) and all(area.name != form.area for area in having):
        yield Problem(form.at, f"area '{form.area}' has no column '{base}'", "write dec, hex or oct")
    for area in having:
        if area.columns[base] not in BASES:
            what = f"{str(area.columns[base])!r} in the column '{base}' of area '{area.name}' is not a kind of number"
            yield Problem(area.at, what, "write dec, hex or oct")


def _unit(
    form: AddressForm, parts: tuple[FormPart, ...], areas: Mapping[str, AreaModel], tables: Mapping[str, Table]
) -> Iterator[Problem]:
    units = {*UNIT_BITS, *(area.unit for area in areas.values())}
    if form.unit is not None and form.unit not in units and not _UNIT.fullmatch(form.unit):
        hint = did_you_mean(form.unit, [*units, *tables])
        yield Problem(form.at, f"'{form.unit}' is neither a unit nor a table of units", hint)
    if any(part.what == "unit" for part in parts) and form.units_table is None and form.unit is None:
        yield Problem(form.at, f'nothing says what {{unit}} of "{form.text}" may be', "add unit: TABLE, letter: unit")
    table = tables.get(form.units_table or "")
    for key, unit in table.entries.items() if table is not None else ():
        if not isinstance(unit, str) or (unit not in units and not _UNIT.fullmatch(unit)):
            what = f"{unit!r} stands for '{key}' in the table '{form.units_table}' and is no unit"
            yield Problem(form.at, what, did_you_mean(str(unit), units))


def _ranges(form: AddressForm, parts: tuple[FormPart, ...]) -> Iterator[Problem]:
    """Report ranges for names that are no numbers of the form."""
    numbers = [part.name for part in parts if part.what == "number"]
    for name in form.ranges:
        if name not in numbers:
            what = f"the form \"{form.text}\" has no number '{name}', whose range it says"
            yield Problem(form.at, what, did_you_mean(name, numbers))


def check_texts(protocol: Protocol) -> Iterator[Problem]:
    """Report forms of the wire whose text cannot be computed: a request can carry a place that a user wrote, but no
    later place.
    """
    asking = (row for row in protocol.service_rows if not row.server_only)
    if not any("text" in mentions_of(row) - {one.name for one in row.takes} for row in asking):
        return
    for form in protocol.addresses:
        start = form.results.get("start")
        if not form.wire or start is None or not names_in(start.root) or inverse_steps(start) is not None:
            continue
        numbers = {part.name for part in parts_in(form) if part.what == "number"}
        if len(numbers - form.ranges.keys()) > 1 or not numbers & form.ranges.keys():
            what = f'no text can be worked out of the start of the form "{form.text}":'
            what += " a request can carry the place that a user wrote, and none after it"
            ranged = ", ".join(f"{name}: 0..15" for name in sorted(numbers)[:1])
            todo = f"say the range of all its numbers but one, such as range: {{{ranged}}}"
            yield Problem(start.at, what, todo, warning=True)


def _type(form: AddressForm) -> Iterator[Problem]:
    if form.type is None:
        return
    if form.unit is None:
        what = f'the form "{form.text}" has a type and no unit of its own'
        yield Problem(form.at, what, "say unit: too, or give the area the type")
    elif UNIT_BITS.get(form.unit) != NUMBER_BITS.get(form.type):
        yield Problem(form.at, f"a {form.type} is no {form.unit}", "give a type of that width")


def _counts(form: AddressForm, tables: Mapping[str, Table]) -> Iterator[Problem]:
    """Report units that are not a whole number of the unit in which the form counts."""
    if form.counts is None:
        return
    table = tables.get(form.units_table or "")
    units = [form.unit] if form.unit else [str(unit) for unit in table.entries.values()] if table is not None else []
    if not units:
        yield Problem(form.at, f'the form "{form.text}" counts in a unit and has none of its own', "say unit: too")
    elif form.counts not in UNIT_BITS:
        yield Problem(form.at, f"'{form.counts}' is no unit to count in", did_you_mean(form.counts, UNIT_BITS))
    elif all(unit == form.counts for unit in units):
        yield Problem(form.at, f"counts: {form.counts} has no effect: the unit is {form.counts}", "leave it out")
    for unit in units:
        if UNIT_BITS.get(unit, 8) % UNIT_BITS.get(form.counts, 1):
            what = f"a {unit} is no whole number of {form.counts} elements, in which this form counts"
            yield Problem(form.at, what, "count in a smaller unit")


def _names(
    form: AddressForm,
    parts: tuple[FormPart, ...],
    columns: set[str],
    tables: Mapping[str, Table],
    areas: Mapping[str, AreaModel],
) -> Iterator[Problem]:
    """Report unknown names in the results: known are parts, other results, tables, and columns as `area.NAME`."""
    known = {"area", *(part.name for part in parts), *form.results, *tables}
    for expression in (*form.results.values(), form.area):
        if expression is None or isinstance(expression, str):
            continue
        for node in walk(expression.root):
            if (
                isinstance(node, Name)
                and node.name not in known
                and node is expression.root
                and expression is form.area
            ):
                yield Problem(node.at, f"there is no area '{node.name}'", did_you_mean(node.name, areas))
            elif isinstance(node, Name) and node.name not in known:
                yield Problem(node.at, f"there is no name '{node.name}' here", did_you_mean(node.name, known))
            of_area = isinstance(node, Attribute) and isinstance(node.value, Name) and node.value.name == "area"
            if of_area and isinstance(node, Attribute) and node.name not in columns | {"size"}:
                yield Problem(node.at, f"no area has a column '{node.name}'", did_you_mean(node.name, columns))


PAIRED = ("BADC", "CDAB")
"""Orders that exchange words, or the bytes of each word."""


def is_odd(unit: str) -> bool:
    """Return whether a unit has an odd number of bytes, such as `3 bytes`, and so cannot be divided into words."""
    return is_unit(unit) and unit not in UNIT_BITS and int(unit.split()[0]) % 2 == 1 and unit != "1 byte"


def units_of(protocol: Protocol, form: AddressForm) -> set[str]:
    """Return the units of addresses in this form; an empty set if the area determines the unit."""
    table = protocol.tables.get(form.units_table or "")
    return {form.unit} if form.unit else set() if table is None else set(map(str, table.entries.values()))


def units_in(protocol: Protocol, row: ServiceRow) -> set[str]:
    """Return the units that the elements of a row may have for some request."""
    if row.units and all(map(is_unit, row.units)) and not {"unit"} & {*row.back, *row.back_each}:
        return set(row.units)
    areas = [area for name, area in protocol.areas.items() if not row.areas or name in row.areas]
    units = {unit for area in areas for unit in (area.unit, *area.codes)}
    others = protocol.areas.keys() - set(row.areas) if row.areas else ()
    forms = (form for form in protocol.addresses if form.area not in others)
    return units.union(*(units_of(protocol, form) for form in forms))
