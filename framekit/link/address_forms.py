"""One address form at work: taking a text apart by it, and writing an address in it.

Patterns are made once, one for all areas that have the same widths. What a place in an area means (its size, its unit)
is decided by the grammar, not here. Language reference, section 10.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from framekit.definition.expression.syntax import names_in
from framekit.definition.model.services import AddressForm, Area, Literally, Maybe, Part
from framekit.definition.model.values import Table
from framekit.link.evaluate import EVALUATION_ERRORS, Evaluate, Names, compile_expression
from framekit.link.invert import Inverse, inverse_of
from framekit.memory.profile import ProfileArea

_DIGITS = {10: "[0-9]", 16: "[0-9A-Fa-f]", 8: "[0-7]"}
_FORMATS = {10: "d", 16: "X", 8: "o"}
_MOST_PLACES = 18
"""Numbers without a width are cut here; no area is that large."""

Parts = dict[str, Any]


class _MissingColumnError(Exception):
    """The area lacks a column that the form needs, or has no places for a number there."""


class FormMatcher:
    """A form with the areas it can name. `units` are the units a `{unit}` part may stand for, by its key."""

    def __init__(self, form: AddressForm, areas: Mapping[str, Area], tables: Mapping[str, Table]) -> None:
        self.form = form
        self.areas = areas
        entries = tables[form.units_table].entries if form.units_table is not None else {}
        self.units = {str(key): str(unit) for key, unit in entries.items()}
        self._units_read = {self._folded(key): unit for key, unit in self.units.items()}
        self.fixed_area = form.area if isinstance(form.area, str) else None
        self.area_of = None if form.area is None or isinstance(form.area, str) else compile_expression(form.area)
        self.results = _in_order(form)
        self.start_inverse: Inverse | None = None if "start" not in form.results else inverse_of(form.results["start"])
        self.flat = [part for item in form.parts for part in (item.parts if isinstance(item, Maybe) else (item,))]
        self.patterns = self._patterns()
        if not self.has_start:
            raise ValueError(f'the address form "{form.text}" does not say where a place is: it needs a start')

    @property
    def has_start(self) -> bool:
        return "start" in self.form.results or any(isinstance(p, Part) and p.name == "start" for p in self.flat)

    # ---- patterns -----------------------------------------------------------------------------------------

    def _patterns(self) -> list[tuple[re.Pattern[str], dict[str, list[str | None]]]]:
        """One pattern for the areas that share one, with the area names behind every text that may stand for them."""
        naming = [part for part in self.flat if isinstance(part, Part) and part.what in ("area", "column")]
        if not naming:
            return [(self._compiled(self._pattern(self.fixed_area, "")), {"": [self.fixed_area]})]
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
        """A word of the form as texts are looked up that are written so."""
        return text.lower() if self.form.any_case else text

    def _area_texts(self, part: Part, name: str) -> list[str]:
        area = self.areas[name]
        if part.what == "column":
            return [_column(area, part.name)]
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

    def _piece(self, part: Literally | Part, area: str | None, texts: str, number: int) -> str:
        if isinstance(part, Literally):
            return re.escape(part.text)
        if part.what in ("area", "column"):
            first = next(p for p in self.flat if isinstance(p, Part) and p.what in ("area", "column"))
            if part is first:
                return f"(?P<area>{texts})"
            assert area is not None
            return re.escape(self._area_texts(part, area)[0])
        if part.what == "unit":
            return f"(?P<p{number}>{'|'.join(map(re.escape, sorted(self.units, key=len, reverse=True)))})"
        if part.what == "word":
            return f"(?P<p{number}>\\w+)"
        least, most = self._places(part, area)
        return f"(?P<p{number}>{_DIGITS[part.base]}{{{least or 1},{most or _MOST_PLACES}}})"

    def _places(self, part: Part, area: str | None) -> tuple[int | None, int | None]:
        return self._width(part.least, area), self._width(part.most, area)

    def _width(self, width: int | str | None, area: str | None) -> int | None:
        if not isinstance(width, str):
            return width
        places = None if area is None else self.areas[area].columns.get(width)
        if not isinstance(places, int) or places == 0:
            raise _MissingColumnError
        return places

    # ---- reading ------------------------------------------------------------------------------------------

    def match(self, text: str) -> Iterator[tuple[str | None, Parts]]:
        """The areas and parts that `text` can mean in this form, the longest area name first."""
        found = []
        for pattern, texts in self.patterns:
            match = pattern.fullmatch(text)
            if match is not None:
                named = self._folded(match["area"]) if "area" in pattern.groupindex else ""
                found.append((named, texts[named], self._values(match)))
        found.sort(key=lambda item: -len(item[0]))
        return ((area, parts) for _, areas, parts in found for area in areas)

    def _values(self, match: re.Match[str]) -> Parts:
        parts: Parts = {}
        for number, part in enumerate(self.flat):
            if isinstance(part, Part) and part.what in ("unit", "number", "word"):
                text = match[f"p{number}"]
                if part.what == "unit":
                    parts["unit"] = self._units_read[self._folded(text)]
                else:
                    parts[part.name] = int(text, part.base) if text and part.what == "number" else text
        return parts

    def evaluate(self, parts: Parts, names: Names) -> Parts:
        """The parts with the form's results beside them. Raises EVALUATION_ERRORS: then the form does not fit."""
        found = Names(parts, names)
        for name, evaluate in self.results:
            found[name] = evaluate(found)
        return dict(found)

    # ---- writing ------------------------------------------------------------------------------------------

    def can_print(self, area: str, unit: str) -> bool:
        """Whether addresses of this area and unit can be written in this form at all."""
        if self.fixed_area not in (None, area) or self.area_of is not None:
            return False
        return unit in self._written_units(area)

    def _written_units(self, area: str) -> tuple[str, ...]:
        if self.units:
            return tuple(self.units.values())
        return (self.form.unit or self.areas[area].unit,)

    def print(self, area: str, unit: str, start: int, parts: Mapping[str, Any], names: Names) -> str | None:
        """The text of a place; None if this form cannot show it."""
        if not self.can_print(area, unit):
            return None
        known = dict(parts)
        if self.start_inverse is not None:
            try:
                known[self.start_inverse.name] = self.start_inverse.solve(start, names)
            except EVALUATION_ERRORS:
                return None
        elif "start" in self.form.results:
            return None
        known["start"] = start
        text = ""
        for item in self.form.parts:
            if isinstance(item, Maybe):
                text += "".join(piece or "" for piece in self._optional(item, area, unit, known))
                continue
            piece = self._written(item, area, unit, known)
            if piece is None:
                return None
            text += piece
        return text

    @property
    def variable(self) -> int:
        """How many things a text of this form says."""
        return sum(isinstance(part, Part) for part in self.flat)

    def sample(self, area: str) -> str | None:
        """A text of this form, which may mean no place that is there; None where the area has none.

        What a column of the area says is taken from there, every other number is 1.
        """
        columns = self.areas[area].columns
        unit = self._written_units(area)[0]
        known = {part.name: columns.get(part.name, 1) for part in self.flat if isinstance(part, Part)}
        known |= {part.name: part.name for part in self.flat if isinstance(part, Part) and part.what == "word"}
        if self.fixed_area not in (None, area):
            return None
        pieces: list[str | None] = []
        for item in self.form.parts:
            pieces += self._optional(item, area, unit, known) if isinstance(item, Maybe) else [
                self._written(item, area, unit, known)
            ]  # fmt: skip
        return None if None in pieces else "".join(piece or "" for piece in pieces)

    def _optional(self, item: Maybe, area: str, unit: str, known: Mapping[str, Any]) -> list[str | None]:
        pieces = [self._written(part, area, unit, known) for part in item.parts]
        return pieces if any(isinstance(part, Part) for part in item.parts) and None not in pieces else []

    def _written(self, part: Literally | Part, area: str, unit: str, known: Mapping[str, Any]) -> str | None:
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
            least, most = self._places(part, area)
        except _MissingColumnError:
            return None
        text = format(value, f"0{least or 1}{_FORMATS[part.base]}")
        return None if value < 0 or len(text) > (most or _MOST_PLACES) else text


def _column(area: Area, name: str) -> str:
    """The text of an area's column; an area without it goes by its own name."""
    return str(area.columns.get(name, area.name))


def _in_order(form: AddressForm) -> list[tuple[str, Evaluate]]:
    """The results so that each stands behind those it mentions. Raises ValueError for a circle."""
    waiting = dict(form.results)
    ordered: list[tuple[str, Evaluate]] = []
    while waiting:
        ready = [
            name for name, expression in waiting.items() if not (names_in(expression.root) & waiting.keys()) - {name}
        ]
        if not ready:
            raise ValueError(f'the results of the address form "{form.text}" depend on each other in a circle')
        for name in ready:
            ordered.append((name, compile_expression(waiting.pop(name))))
    return ordered
