"""Addresses as users write them, and the places they mean: `%MW100`, `40010`, `N7:0`, `T4:2.ACC`, `%R3`.

A form parses and prints addresses. Its patterns are compiled once; areas with the same widths share a pattern. The
grammar takes forms, areas and tables, so it serves protocols and memory profiles and depends on neither. Places are
counted in units over the whole area, from 0. `check_addresses` tests forms: an address that a form prints must mean the
same place when any form parses it. Guide: areas, checker.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import product
from math import prod
from typing import Any

from framekit.definition.expression import names_in
from framekit.definition.model.services import BASES, AddressForm, AreaModel, FormPart, Literally, Maybe
from framekit.definition.model.values import Constant, Table
from framekit.definition.problems import Problem, did_you_mean
from framekit.link.values import EVALUATION_ERRORS, Evaluate, Inverse, Names, compile_expression, inverse_of
from framekit.link.variables import table_values
from framekit.memory.memory import unit_bits
from framekit.memory.profile import ProfileArea

# ---- areas in expressions ----------------------------------------------------------------------------------


class AreaView(str):
    """The name of an area. `area.COLUMN` is the value of a column, or a table if the column names a table."""

    columns: Mapping[str, Any]

    def language_attribute(self, name: str) -> Any:
        """Return the value of a column. Raise KeyError for a column that the area does not have."""
        return self.columns[name]


def area_views(areas: Mapping[str, AreaModel], values: Mapping[str, Any]) -> dict[str, AreaView]:
    """Return the views of all areas; `values`: tables by their names."""

    def column(value: Constant) -> Any:
        return values[value] if isinstance(value, str) and value in values else value

    views = {}
    for name, area in areas.items():
        view = AreaView(name)
        view.columns = {"size": area.size, **{key: column(value) for key, value in area.columns.items()}}
        views[name] = view
    return views


def code_of(area: AreaModel, unit: str) -> Constant | None:
    """Return the code of the area on the wire when it is addressed in `unit`; a single code is valid for every unit."""
    if unit in area.codes:
        return area.codes[unit]
    return next(iter(area.codes.values())) if len(area.codes) == 1 else None


# ---- one form ----------------------------------------------------------------------------------------------


_DIGITS = {10: "[0-9]", 16: "[0-9A-Fa-f]", 8: "[0-7]"}
_FORMATS = {10: "d", 16: "X", 8: "o"}
MOST_TRIED = 256
"""The limit of combinations of numbers with ranges that are tried to print a place."""
_MOST_PLACES = 18
"""The most digits of a number without a width; no area needs more."""

Parts = dict[str, Any]


class _MissingColumnError(Exception):
    """The area lacks a column that the form needs, or has no places for a number there."""


class FormMatcher:
    """An address form with the areas that it can name."""

    def __init__(self, form: AddressForm, areas: Mapping[str, AreaModel], tables: Mapping[str, Table]) -> None:
        self.form = form
        self.areas, self.tables = areas, tables
        entries = tables[form.units_table].entries if form.units_table is not None else {}
        self.units = {str(key): str(unit) for key, unit in entries.items()}
        """The units that a `{unit}` part can mean, by their key."""
        self._units_read = {self._folded(key): unit for key, unit in self.units.items()}
        self.fixed_area = form.area if isinstance(form.area, str) else None
        self.area_of = None if form.area is None or isinstance(form.area, str) else compile_expression(form.area)
        self.results = _in_order(form)
        self.start_inverse: Inverse | None = None if "start" not in form.results else inverse_of(form.results["start"])
        start = form.results.get("start")
        only = None if start is None or any(True for _ in names_in(start.root)) else compile_expression(start)(Names())
        self.only_start = only if isinstance(only, int) else None
        """The start that the form gives if it names a single place of each area, else None."""
        self.flat = [part for item in form.parts for part in (item.parts if isinstance(item, Maybe) else (item,))]
        self.patterns = self._patterns()
        if not self.has_start:
            raise ValueError(f'the address form "{form.text}" does not say where a place is: it needs a start')

    @property
    def has_start(self) -> bool:
        return "start" in self.form.results or any(isinstance(p, FormPart) and p.name == "start" for p in self.flat)

    # ---- patterns -----------------------------------------------------------------------------------------

    def _patterns(self) -> list[tuple[re.Pattern[str], dict[str, list[str | None]]]]:
        """Return the patterns of the form, each with its area texts and the names of the areas that a text can mean."""
        naming = [part for part in self.flat if isinstance(part, FormPart) and part.what in ("area", "column")]
        if not naming:
            try:
                return [(self._compiled(self._pattern(self.fixed_area, "")), {"": [self.fixed_area]})]
            except _MissingColumnError:
                return []
        groups: dict[tuple[str, str], dict[str, list[str | None]]] = {}
        for name in [self.fixed_area] if self.fixed_area else self.areas:
            for text in self._area_texts(naming[0], name):
                try:
                    key = (self._pattern(name, "\0"), "" if len(naming) == 1 else name)
                except _MissingColumnError:
                    continue
                groups.setdefault(key, {}).setdefault(self._folded(text), []).append(name)
        result = []
        for (pattern, _), texts in groups.items():
            longest_first = sorted(texts, key=len, reverse=True)
            result.append((self._compiled(pattern.replace("\0", "|".join(map(re.escape, longest_first)))), texts))
        return result

    def _compiled(self, pattern: str) -> re.Pattern[str]:
        return re.compile(pattern, re.IGNORECASE | re.ASCII if self.form.any_case else 0)

    def _folded(self, text: str) -> str:
        """Return a word of the form as a key for texts, in lower case if the form accepts any case."""
        return text.lower() if self.form.any_case else text

    def _area_texts(self, part: FormPart, name: str) -> list[str]:
        area = self.areas[name]
        if part.what == "column":
            return [str(area.columns.get(part.name, area.name))]  # an area without the column has its own name
        return [name, *(area.aliases if isinstance(area, ProfileArea) else ())]

    def _pattern(self, area: str | None, texts: str) -> str:
        pattern, number = "", 0
        for item in self.form.parts:
            inner = ""
            for part in item.parts if isinstance(item, Maybe) else (item,):
                inner += self._piece(part, area, texts, number)
                number += 1
            pattern += f"(?:{inner})?" if isinstance(item, Maybe) else inner
        return pattern

    def _piece(self, part: Literally | FormPart, area: str | None, texts: str, number: int) -> str:
        if isinstance(part, Literally):
            return re.escape(part.text)
        if part.what in ("area", "column"):
            first = next(p for p in self.flat if isinstance(p, FormPart) and p.what in ("area", "column"))
            if part is first:
                return f"(?P<area>{texts})"
            assert area is not None
            return re.escape(self._area_texts(part, area)[0])
        if part.what == "unit":
            return f"(?P<p{number}>{'|'.join(map(re.escape, sorted(self.units, key=len, reverse=True)))})"
        if part.what == "word":
            return f"(?P<p{number}>\\w+)"
        least, most = self._places(part, area)
        return f"(?P<p{number}>{_DIGITS[self._base(part, area)]}{{{least or 1},{most or _MOST_PLACES}}})"

    def _places(self, part: FormPart, area: str | None) -> tuple[int | None, int | None]:
        return self._width(part.least, area), self._width(part.most, area)

    def _base(self, part: FormPart, area: str | None) -> int:
        if not isinstance(part.base, str):
            return part.base
        base = None if area is None else BASES.get(str(self.areas[area].columns.get(part.base)))
        if base is None:
            raise _MissingColumnError
        return base

    def _width(self, width: int | str | None, area: str | None) -> int | None:
        if not isinstance(width, str):
            return width
        places = None if area is None else self.areas[area].columns.get(width)
        if not isinstance(places, int) or places == 0:
            raise _MissingColumnError
        return places

    # ---- reading ------------------------------------------------------------------------------------------

    def match(self, text: str) -> Iterator[tuple[str | None, Parts]]:
        """Return the areas and parts that `text` can mean in this form, the longest area name first."""
        found = []
        for pattern, texts in self.patterns:
            match = pattern.fullmatch(text)
            if match is not None:
                named = self._folded(match["area"]) if "area" in pattern.groupindex else ""
                parts = self._values(match, texts[named][0])
                if next(self._out_of_range(parts), None) is None:
                    found.append((named, texts[named], parts))
        found.sort(key=lambda item: -len(item[0]))
        return ((area, parts) for _, areas, parts in found for area in areas)

    def _out_of_range(self, parts: Mapping[str, Any]) -> Iterator[str]:
        """Yield the names of the numbers outside their range."""
        for name, (low, high) in self.form.ranges.items():
            value = parts.get(name)
            if isinstance(value, int) and not low <= value <= high:
                yield name

    def beyond(self, text: str) -> str:
        """Return a message about a number outside its range, or an empty text."""
        for pattern, texts in self.patterns:
            match = pattern.fullmatch(text)
            if match is not None:
                named = self._folded(match["area"]) if "area" in pattern.groupindex else ""
                parts = self._values(match, texts[named][0])
                for name in self._out_of_range(parts):
                    low, high = self.form.ranges[name]
                    return f"{name} is {parts[name]} in it, and can be {low} to {high}"
        return ""

    def _values(self, match: re.Match[str], area: str | None) -> Parts:
        """Return the values of the parts of a text; areas that share a pattern write their numbers in one way."""
        parts: Parts = {}
        for number, part in enumerate(self.flat):
            if isinstance(part, FormPart) and part.what in ("unit", "number", "word"):
                text = match[f"p{number}"]
                if part.what == "unit":
                    parts["unit"] = self._units_read[self._folded(text)]
                else:
                    is_number = text and part.what == "number"
                    parts[part.name] = int(text, self._base(part, area)) if is_number else text
        return parts

    def evaluate(self, parts: Parts, names: Names) -> Parts:
        """Return the parts and the results of the form. Raise EVALUATION_ERRORS if the form does not fit."""
        found = Names(parts, names)
        for name, evaluate in self.results:
            found[name] = evaluate(found)
        return dict(found)

    # ---- writing ------------------------------------------------------------------------------------------

    def can_print(self, area: str, unit: str) -> bool:
        """Return whether addresses of this area and unit can be printed in this form at all."""
        if self.fixed_area not in (None, area) or self.area_of is not None:
            return False
        return unit in self._written_units(area)

    def _written_units(self, area: str) -> tuple[str, ...]:
        if self.units:
            return tuple(self.units.values())
        return (self.form.unit or self.areas[area].unit,)

    def print(self, area: str, unit: str, first_bit: int, parts: Mapping[str, Any], names: Names) -> str | None:
        """Return the text of a place, or None if this form cannot print it."""
        if not self.can_print(area, unit):
            return None
        start, over = divmod(first_bit, unit_bits(self.form.counts or unit))
        if over:
            return None
        known = dict(parts)
        if self.start_inverse is not None:
            try:
                known[self.start_inverse.name] = self.start_inverse.solve(start, names)
            except EVALUATION_ERRORS:
                return None
        elif "start" in self.form.results and start != self.only_start and not self._says(start, known, names):
            solved = self._solved(start, known, names)
            if solved is None:
                return None
            known = solved
        known["start"] = start
        return self._text(area, unit, known)

    def _says(self, start: int, parts: Parts, names: Names) -> bool:
        """Return whether these parts give this start, for a form whose start has no inverse."""
        try:
            return bool(self.evaluate(parts, names)["start"] == start)
        except EVALUATION_ERRORS:
            return False

    def _solved(self, start: int, parts: Parts, names: Names) -> Parts | None:
        """Return parts that give this start, or None.

        The form may have numbers with ranges, and one other number on which the start depends linearly.
        """
        numbers = dict.fromkeys(part.name for part in self.flat if isinstance(part, FormPart) and part.what == "number")
        free = [name for name in numbers if name not in self.form.ranges]
        spans = [range(low, high + 1) for low, high in self.form.ranges.values()]
        if len(free) > 1 or not spans or prod(map(len, spans)) > MOST_TRIED:
            return None
        for values in product(*spans):
            known = {**parts, **dict(zip(self.form.ranges, values, strict=True))}
            if free and not self._solve_one(free[0], start, known, names):
                continue
            if self._says(start, known, names):
                return known
        return None

    def _solve_one(self, name: str, start: int, parts: Parts, names: Names) -> bool:
        """Set a part on which the start depends linearly; return False if no whole number gives this start."""
        try:
            first, second = (self.evaluate({**parts, name: one}, names)["start"] for one in (0, 1))
            found, over = divmod(start - first, second - first)
        except EVALUATION_ERRORS:
            return False
        parts[name] = found
        return bool(over == 0 and found >= 0)

    @property
    def variable(self) -> int:
        """Return the number of variable parts of the form."""
        return sum(isinstance(part, FormPart) for part in self.flat)

    def sample(self, area: str) -> str | None:
        """Return an example of this form, which may name a missing place; None if the form cannot name the area.

        Parts that are columns of the area have the value of the column; every other number is 1.
        """
        columns = self.areas[area].columns
        unit = self._written_units(area)[0]
        known = {part.name: columns.get(part.name, 1) for part in self.flat if isinstance(part, FormPart)}
        known |= {part.name: part.name for part in self.flat if isinstance(part, FormPart) and part.what == "word"}
        if self.fixed_area not in (None, area):
            return None
        return self._text(area, unit, known)

    def _text(self, area: str, unit: str, known: Mapping[str, Any]) -> str | None:
        """Return the text with these values, or None if a required value is missing or does not fit."""
        text = ""
        for item in self.form.parts:
            parts = item.parts if isinstance(item, Maybe) else (item,)
            says_something = not isinstance(item, Maybe) or any(isinstance(part, FormPart) for part in parts)
            pieces = [self._written(part, area, unit, known) for part in parts]
            if says_something and None not in pieces:
                text += "".join(piece or "" for piece in pieces)
            elif not isinstance(item, Maybe):
                return None
        return text

    def _written(self, part: Literally | FormPart, area: str, unit: str, known: Mapping[str, Any]) -> str | None:
        if isinstance(part, Literally):
            return part.text
        if part.what in ("area", "column"):
            return self._area_texts(part, area)[0]
        if part.what == "unit":
            return next((key for key, value in self.units.items() if value == unit), None)
        value = known.get(part.name)
        if part.what == "word" or not isinstance(value, int):
            return value if isinstance(value, str) else None
        try:
            (least, most), base = self._places(part, area), self._base(part, area)
        except _MissingColumnError:
            return None
        low, high = self.form.ranges.get(part.name, (0, value))
        if not low <= value <= high:
            return None
        text = format(value, f"0{least or 1}{_FORMATS[base]}")
        return None if value < 0 or len(text) > (most or _MOST_PLACES) else text


def _in_order(form: AddressForm) -> list[tuple[str, Evaluate]]:
    """Return the results, each after the results that it depends on. Raise ValueError for a circular dependency."""
    ordered = form.results_in_order()
    if len(ordered) < len(form.results):
        raise ValueError(f'the results of the address form "{form.text}" depend on each other in a circle')
    return [(name, compile_expression(form.results[name])) for name in ordered]


# ---- all forms ---------------------------------------------------------------------------------------------


MOST_EXAMPLES, MOST_AREAS = 4, 12
"""The limits of forms and areas in a message."""
RAW = re.compile(r"0[xX][0-9a-fA-F]+|\d{1,4}")
"""Numbers of elements from 0, as other programs write them."""


class AddressError(ValueError):
    """A text that is no address, or a place that does not exist. The message is one sentence with the known facts."""


@dataclass(frozen=True, slots=True)
class Address:
    """A place: element `start` of `area`, counted from 0 in `unit`."""

    area: str
    unit: str
    start: int
    text: str = ""
    parts: Mapping[str, Any] = field(default_factory=dict, hash=False)
    """The other named parts of the text."""
    type: str | None = None
    """The type of number that is usual at this place; None: unsigned."""
    shift: int = 0
    """The distance in bits from the beginning of the element to the place, for example 8 for a word at an odd byte."""
    form: str = field(default="", compare=False, repr=False)
    """The text of the form in which the address is written."""

    @property
    def unit_bits(self) -> int:
        """Return the width of an element in bits."""
        return unit_bits(self.unit)

    @property
    def first_bit(self) -> int:
        """Return the offset of the place in its area, in bits."""
        return self.start * self.unit_bits + self.shift

    def __str__(self) -> str:
        shift = f" + {self.shift} bits" if self.shift else ""
        return self.text or f"{self.unit} {self.start}{shift} of {self.area}"


NOT_READ: Any = object()
MOST_KNOWN = 1024
"""The size of the caches of parsed texts and of compiled forms; a full cache is cleared."""


_made: dict[tuple[int, int, int], FormMatcher] = {}


def _matcher(form: AddressForm, areas: Mapping[str, AreaModel], tables: Mapping[str, Table]) -> FormMatcher:
    """Return the compiled form, which never changes and is shared by all grammars of a definition."""
    key = id(form), id(areas), id(tables)
    found = _made.get(key)
    if found is None:
        if len(_made) >= MOST_KNOWN:
            _made.clear()
        found = _made[key] = FormMatcher(form, areas, tables)
    return found


class AddressGrammar:
    """The address forms of some areas. Raise ValueError for a form without a start."""

    def __init__(
        self, forms: Sequence[AddressForm], areas: Mapping[str, AreaModel], tables: Mapping[str, Table]
    ) -> None:
        self.areas = areas
        self._tables = Names({name: table_values(table) for name, table in tables.items()})
        self.views: dict[str, AreaView] = area_views(areas, self._tables)
        self._forms = [_matcher(form, areas, tables) for form in forms]
        self.serves: Callable[[Address], bool] = lambda address: True
        """Return whether another device can be asked for a place; messages name only such places."""
        self._read_before: dict[str, Address | None] = {}
        self._wire = [form for form in self._forms if form.form.wire]
        self._own_first = {
            one.form.text: sorted(self._wire, key=lambda form: form.form.text != one.form.text) for one in self._wire
        }
        """The forms marked `wire` in the order of attempts, by the text of the form that comes first."""

    def naming(self, serves: Callable[[Address], bool]) -> AddressGrammar:
        """Return the same addresses; messages name only places that `serves` accepts."""
        same = copy(self)
        same.serves = serves
        return same

    # ---- reading ------------------------------------------------------------------------------------------

    def parse(self, text: str, unit: str | None = None, *, check: bool = True) -> Address:
        """Return the place that `text` names; with `unit`, the place is counted in `unit`.

        Raise AddressError for text that fits no form, for a place that is not at a multiple of `unit`, and, with
        `check`, for a place beyond the area.
        """
        text = text.strip()
        address = self._read(text)
        if address is None:
            raise AddressError(self._unknown(text))
        if unit is not None:
            address = self.in_unit(address, unit)
        if check:
            self.check(address)
        return address

    def find(self, text: str) -> Address | None:
        """Return the place that `text` names; None if no form accepts the text or the area does not have the place."""
        address = self._read(text)
        return address if address is not None and self._has(self.areas[address.area], address, 1) else None

    @staticmethod
    def _has(area: AreaModel, address: Address, count: int) -> bool:
        end = address.first_bit + count * address.unit_bits
        return address.start >= 0 and end <= area.size * area.element_bits

    def _read(self, text: str) -> Address | None:
        """Return the place that a text means, from a cache: a server receives the same addresses again and again."""
        found: Address | None = self._read_before.get(text, NOT_READ)
        if found is NOT_READ:
            found = self._read_now(text)
            if len(self._read_before) >= MOST_KNOWN:
                self._read_before.clear()
            self._read_before[text] = found
        return found

    def _read_now(self, text: str) -> Address | None:
        for form in self._forms:
            for area, parts in form.match(text):
                with suppress(*EVALUATION_ERRORS):
                    return self._address(form, area, parts, text)
        return None

    def _address(self, form: FormMatcher, area: str | None, parts: dict[str, Any], text: str) -> Address:
        known = self._tables if area is None else Names({"area": self.views[area]}, self._tables)
        found = form.evaluate(parts, known)
        if form.area_of is not None:
            area = str(form.area_of(Names(found, known)))
        if area is None or area not in self.areas:
            raise KeyError(area)
        unit = found.pop("unit", None) or form.form.unit or self.areas[area].unit
        unit_bits(unit)
        type_ = form.form.type or (self.areas[area].type if unit == self.areas[area].unit else None)
        start, shift = found.pop("start"), 0
        if form.form.counts is not None:
            start, shift = divmod(start * unit_bits(form.form.counts), unit_bits(unit))
        return Address(area, unit, start, text, found, type_, shift, form.form.text)

    def _unknown(self, text: str) -> str:
        if text in self.areas:
            return f"'{text}' is not an address – add the number of a place in area {text}"
        beyond = next(filter(None, (form.beyond(text) for form in self._forms)), "")
        if beyond:
            return f"'{text}' is not an address: {beyond}"
        hint = did_you_mean(text, self.areas) if text.isalpha() else ""
        counted = [f"{area}:{text}" for area in self.areas if RAW.fullmatch(text) and self._read(f"{area}:{text}")]
        from_zero = f"; counted from 0: {', '.join(counted[:MOST_EXAMPLES])}" if counted else ""
        hint = hint if hint.startswith("did you mean") else self._examples()
        return f"'{text}' is not an address – {hint}{from_zero}"

    def _examples(self) -> str:
        """Return a hint with example addresses: short forms of whole elements first, each with an area of its own."""
        if not self._forms:
            return "nothing has an address here"
        forms = sorted(self._forms, key=lambda form: (form.form.unit == "bit", form.variable))
        found = [self._samples(form) for form in forms]
        texts: dict[str, str] = {}
        while len(texts) < MOST_EXAMPLES:
            before = len(texts)
            for samples in found:
                texts |= dict([(area, text) for area, text in samples.items() if area not in texts][:1])
            if len(texts) == before:
                break
        served = [area for area in self.areas if any(area in samples for samples in found)] or list(self.areas)
        examples = dict.fromkeys(texts.values())  # areas may share an address
        shown = ", ".join([*examples][:MOST_EXAMPLES] or [form.form.text for form in self._forms[:MOST_EXAMPLES]])
        return f"write it like {shown}; areas: {', '.join(served[:MOST_AREAS])}" + (", …" * (len(served) > MOST_AREAS))

    def _samples(self, form: FormMatcher) -> dict[str, str]:
        """Return an address in this form for each area, if the place exists and is served."""
        found = {}
        for name, area in self.areas.items():
            names = Names({"area": self.views[name]}, self._tables)
            for text in (form.print(name, area.unit, 10 * area.element_bits, {}, names), form.sample(name)):
                address = None if text is None or name in found else self._read(text)
                with suppress(AddressError):
                    if text is not None and address is not None and self.serves(address):
                        self.check(address)
                        found[name] = text
        return found

    def check(self, address: Address, count: int = 1) -> None:
        """Raise AddressError if any of `count` elements is beyond the area."""
        self.check_in(self.areas[address.area], address, count)

    def check_in(self, area: AreaModel, address: Address, count: int) -> None:
        """Raise AddressError if any of `count` elements is beyond an area of the size of `area`."""
        if not self._has(area, address, count):
            there = area.size * area.element_bits // address.unit_bits
            has = self._range_of(address, there) if there else f"no whole {address.unit}"
            asked = str(address) if count == 1 else f"{count} × {address.unit} from {address} on"
            raise AddressError(f"{asked} is not in area {area.name}, which has {has}")

    def _range_of(self, address: Address, count: int) -> str:
        """Return the range of an area of `count` elements, as printed addresses if their numbers do not start at 0."""
        if address.area not in self.views:
            return f"{address.unit} 0 to {count - 1}"
        first, last = (self._written(replace(address, start=start, text="")) for start in (0, count - 1))
        numbers = re.findall(r"\d+", first or "")
        from_0 = last is None or not numbers or not numbers[-1].strip("0")
        return f"{address.unit} 0 to {count - 1}" if from_0 else f"{first} to {last}"

    # ---- places -------------------------------------------------------------------------------------------

    def in_unit(self, address: Address, unit: str) -> Address:
        """Return the same place counted in another unit. Raise AddressError if it is not at a multiple of the unit."""
        if unit == address.unit:
            return address
        try:
            width = unit_bits(unit)
        except ValueError as error:
            raise AddressError(str(error)) from None
        start, over = divmod(address.first_bit, width)
        if over:
            raise AddressError(f"{address} is not at the start of a {unit}")
        return replace(address, unit=unit, start=start, type=None, shift=0)

    def advance(self, address: Address, elements: int) -> Address:
        """Return the place `elements` further on, with its text; the other parts of the address stay."""
        moved = replace(address, start=address.start + elements, text="")
        return replace(moved, text=self._written(moved) or "")

    def parts_of_all_units(self, address: Address) -> set[str]:
        """Return the names of parts of the address that hold for the place in any unit."""
        forms = (matcher.form for matcher in self._forms if matcher.form.text == address.form)
        found = next(forms, None)
        return set() if found is None else found.parts_of_all_units

    # ---- writing ------------------------------------------------------------------------------------------

    def print(self, address: Address) -> str:
        """Return the text of a place.

        Forms marked `wire` are tried, beginning with the form of the address; if no form is marked, all forms are
        tried. Raise AddressError if no form can print the place.
        """
        text = self._written(address)
        if text is None:
            forms = ", ".join(form.form.text for form in self._wire or self._forms)
            raise AddressError(f"{address} cannot be written in any of these forms: {forms}")
        return text

    def can_print(self, area: str, unit: str) -> bool:
        """Return whether a form marked `wire` prints places of this area and unit."""
        return any(form.can_print(area, unit) for form in self._wire)

    def _written(self, address: Address) -> str | None:
        names = Names({"area": self.views[address.area]}, self._tables)
        for form in self._own_first.get(address.form) or self._wire or self._forms:
            text = form.print(address.area, address.unit, address.first_bit, address.parts, names)
            if text is not None:
                return text
        return None


# ---- forms tried out ---------------------------------------------------------------------------------------


STARTS = (0, 1, 2, 7, 8, 9, 10, 11, 15, 16, 17, 31, 99, 100, 101, 255, 256, 999, 1000, 4095, 9999)
"""The starts that are tested, in addition to the last element of the area."""


def check_addresses(
    forms: Sequence[AddressForm], areas: Mapping[str, AreaModel], tables: Mapping[str, Table]
) -> list[Problem]:
    """Return the conflicts between forms, at most one problem for every pair of forms."""
    alone = [AddressGrammar([form], _areas_of(form, areas), tables) for form in forms]
    beginnings: dict[str, list[int]] = {}
    """The forms by the text that they begin with, which is '' for many."""
    for place, form in enumerate(forms):
        first = form.parts[0] if form.parts else None
        beginnings.setdefault(first.text.casefold() if isinstance(first, Literally) else "", []).append(place)
    found: dict[tuple[int, int], Problem] = {}
    for place, grammar in enumerate(alone):
        for meant, text in _texts(forms[place], grammar):
            ends = range(len(text) + 1)
            for other in sorted({one for end in ends for one in beginnings.get(text[:end].casefold(), ())}):
                read = alone[other].find(text)
                pair = (min(place, other), max(place, other))
                if read is not None and not _agree(meant, read) and pair not in found:
                    found[pair] = _problem(forms, place, other, text, meant, read)
    return list(found.values())


def _areas_of(form: AddressForm, areas: Mapping[str, AreaModel]) -> Mapping[str, AreaModel]:
    """Return the areas whose places a form can name."""
    return {form.area: areas[form.area]} if isinstance(form.area, str) and form.area in areas else areas


def _texts(form: AddressForm, grammar: AddressGrammar) -> Iterator[tuple[Address, str]]:
    """Yield addresses that this form prints, each with its place."""
    units = {form.unit} if form.unit else set()
    for name, area in grammar.areas.items():
        for unit in sorted(units or {area.unit, "bit", "byte", "word", "dword", "lword"}):
            last = area.size * area.element_bits // unit_bits(unit) - 1
            for start in (*(start for start in STARTS if start < last), last):
                if start < 0:
                    continue
                meant = Address(name, unit, start)
                try:
                    yield meant, grammar.print(meant)
                except AddressError:
                    break


def _agree(one: Address, other: Address) -> bool:
    return (one.area, one.unit, one.first_bit) == (other.area, other.unit, other.first_bit)


def _problem(forms: Sequence[AddressForm], place: int, other: int, text: str, meant: Address, read: Address) -> Problem:
    if place == other:
        what = f"'{text}' is written for {_place(meant)} and read as {_place(read)}"
        return Problem(forms[place].at, what, "correct start, or the numbers of the form")
    first, second = (meant, read) if place < other else (read, meant)
    what = (
        f"'{text}' is {_place(first)} by the form \"{forms[min(place, other)].text}\", and {_place(second)} by this one"
    )
    return Problem(forms[max(place, other)].at, what, "give the numbers other places, or another sign between them")


def _place(address: Address) -> str:
    return f"{address.unit} {address.start} of {address.area}"
