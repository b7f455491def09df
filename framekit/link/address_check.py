"""Address forms tried out: what one form prints has to mean the same place when it is read again, by any form.

Reference, section 14. Forms by themselves are checked in the definition layer.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from framekit.definition.model.services import AddressForm, Area
from framekit.definition.model.values import Table
from framekit.definition.problems import Problem
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.memory.memory import unit_bits

STARTS = (0, 1, 2, 7, 8, 9, 10, 11, 15, 16, 17, 31, 99, 100, 101, 255, 256, 999, 1000, 4095, 9999)
"""Places that are tried, and the last one of the area."""


def check_addresses(
    forms: Sequence[AddressForm], areas: Mapping[str, Area], tables: Mapping[str, Table]
) -> list[Problem]:
    """One problem at most for every pair of forms."""
    alone = [AddressGrammar([form], areas, tables) for form in forms]
    found: dict[tuple[int, int], Problem] = {}
    for place, grammar in enumerate(alone):
        for meant, text in _texts(forms[place], grammar):
            for other, reading in enumerate(alone):
                read = _read(reading, text)
                pair = (min(place, other), max(place, other))
                if read is not None and not _agree(meant, read) and pair not in found:
                    found[pair] = _problem(forms, place, other, text, meant, read)
    return list(found.values())


def _texts(form: AddressForm, grammar: AddressGrammar) -> Iterator[tuple[Address, str]]:
    """Addresses as this form writes them, with the places they were written for."""
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


def _read(grammar: AddressGrammar, text: str) -> Address | None:
    try:
        return grammar.parse(text)
    except AddressError:
        return None


def _agree(one: Address, other: Address) -> bool:
    return (one.area, one.unit, one.start) == (other.area, other.unit, other.start)


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
