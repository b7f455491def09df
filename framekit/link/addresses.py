"""Addresses as users write them, and the places they mean: `%MW100`, `40010`, `N7:0`, `T4:2.ACC`, `%R3`.

The grammar takes forms, areas and tables, so it serves protocols and memory profiles alike; it knows neither. Places
are counted in units over the whole area, from 0. Language reference, section 10.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

from framekit.definition.model.services import AddressForm, Area
from framekit.definition.model.values import Table
from framekit.definition.problems import did_you_mean
from framekit.link.address_forms import FormMatcher
from framekit.link.area_view import AreaView, area_views
from framekit.link.evaluate import EVALUATION_ERRORS, Names
from framekit.link.variables import table_values
from framekit.memory.memory import unit_bits

MOST_EXAMPLES, MOST_AREAS = 4, 12
"""How many forms and areas a message names."""


class AddressError(ValueError):
    """A text that is no address, or a place that is not there. The message is one sentence with what is known."""


@dataclass(frozen=True, slots=True)
class Address:
    """Element `start` of `area`, counted from 0 in `unit`. `parts` are the other things the text says, by name.

    `type`: the type of number that such a place usually holds; None: one without sign.
    """

    area: str
    unit: str
    start: int
    text: str = ""
    parts: Mapping[str, Any] = field(default_factory=dict, hash=False)
    type: str | None = None

    @property
    def unit_bits(self) -> int:
        """Width of one element."""
        return unit_bits(self.unit)

    @property
    def first_bit(self) -> int:
        """Bits of the area before this place."""
        return self.start * self.unit_bits

    def __str__(self) -> str:
        return self.text or f"{self.unit} {self.start} of {self.area}"


class AddressGrammar:
    """Forms of addresses over areas. Raises ValueError for a form that does not say where a place is.

    `serves`: whether somebody can be asked for a place; messages name only such.
    """

    def __init__(self, forms: Sequence[AddressForm], areas: Mapping[str, Area], tables: Mapping[str, Table]) -> None:
        self.areas = areas
        self.views: dict[str, AreaView] = area_views(areas, tables)
        self._tables = Names({name: table_values(table) for name, table in tables.items()})
        self._forms = [FormMatcher(form, areas, tables) for form in forms]
        self.serves: Callable[[Address], bool] = lambda address: True
        self._wire = [form for form in self._forms if form.form.wire]

    # ---- reading ------------------------------------------------------------------------------------------

    def parse(self, text: str, unit: str | None = None, *, check: bool = True) -> Address:
        """The place that `text` names; with `unit`, the same place counted in that unit.

        Raises AddressError for what no form takes, for a place that is not at a multiple of `unit`, and, with `check`,
        for a place beyond the area.
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

    def _read(self, text: str) -> Address | None:
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
        return Address(area, unit, found.pop("start"), text, found, type_)

    def _unknown(self, text: str) -> str:
        if text in self.areas:
            return f"'{text}' is not an address – add the number of a place in area {text}"
        hint = did_you_mean(text, self.areas) if text.isalpha() else ""
        return f"'{text}' is not an address – " + (hint if hint.startswith("did you mean") else self._examples())

    def _examples(self) -> str:
        """How places are written here: short forms of whole elements first, each with an area of its own."""
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
        shown = ", ".join([*texts.values()][:MOST_EXAMPLES] or [form.form.text for form in self._forms[:MOST_EXAMPLES]])
        return f"write it like {shown}; areas: {', '.join(served[:MOST_AREAS])}" + (", …" * (len(served) > MOST_AREAS))

    def _samples(self, form: FormMatcher) -> dict[str, str]:
        """A place of each area that is there and served, in this form."""
        found = {}
        for name, area in self.areas.items():
            names = Names({"area": self.views[name]}, self._tables)
            for text in (form.print(name, area.unit, 10, {}, names), form.sample(name)):
                address = None if text is None or name in found else self._read(text)
                with suppress(AddressError):
                    if text is not None and address is not None and self.serves(address):
                        self.check(address)
                        found[name] = text
        return found

    def check(self, address: Address, count: int = 1) -> None:
        """Raises AddressError if any of `count` elements is beyond the area."""
        self.check_in(self.areas[address.area], address, count)

    def check_in(self, area: Area, address: Address, count: int) -> None:
        """The same, of an area as large as `area`."""
        width = address.unit_bits
        there = area.size * area.element_bits // width
        if address.start < 0 or address.start + count > there:
            has = self._range_of(address, there) if there else f"no whole {address.unit}"
            asked = str(address) if count == 1 else f"{count} × {address.unit} from {address} on"
            raise AddressError(f"{asked} is not in area {area.name}, which has {has}")

    def _range_of(self, address: Address, count: int) -> str:
        """The places of an area that has `count`: as they are written, where that does not begin with 0."""
        if address.area not in self.views:
            return f"{address.unit} 0 to {count - 1}"
        first, last = (self._written(replace(address, start=start, text="")) for start in (0, count - 1))
        numbers = re.findall(r"\d+", first or "")
        from_0 = last is None or not numbers or not numbers[-1].strip("0")
        return f"{address.unit} 0 to {count - 1}" if from_0 else f"{first} to {last}"

    # ---- places -------------------------------------------------------------------------------------------

    def in_unit(self, address: Address, unit: str) -> Address:
        """The same place counted in another unit. Raises AddressError if it is not at a multiple of that."""
        if unit == address.unit:
            return address
        try:
            width = unit_bits(unit)
        except ValueError as error:
            raise AddressError(str(error)) from None
        start, over = divmod(address.first_bit, width)
        if over:
            raise AddressError(f"{address} is not at the start of a {unit}")
        return replace(address, unit=unit, start=start, type=None)

    def advance(self, address: Address, elements: int) -> Address:
        """The place `elements` further on, with the text of that; what else the address says stays."""
        moved = replace(address, start=address.start + elements, text="")
        return replace(moved, text=self._written(moved) or "")

    # ---- writing ------------------------------------------------------------------------------------------

    def print(self, address: Address) -> str:
        """The text of a place, in the form marked `wire`, else in the first that can show it. Raises AddressError."""
        text = self._written(address)
        if text is None:
            raise AddressError(f"{address} cannot be written in any of these forms: {self._form_texts}")
        return text

    def can_print(self, area: str, unit: str) -> bool:
        """Whether a form marked `wire` shows places of this area and unit."""
        return any(form.can_print(area, unit) for form in self._wire)

    def _written(self, address: Address) -> str | None:
        names = Names({"area": self.views[address.area]}, self._tables)
        for form in self._wire or self._forms:
            text = form.print(address.area, address.unit, address.start, address.parts, names)
            if text is not None:
                return text
        return None

    @property
    def _form_texts(self) -> str:
        return ", ".join(form.form.text for form in self._wire or self._forms)
