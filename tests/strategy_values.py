"""Single values for the strategies, and facts about segments."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from typing import Any

from hypothesis import strategies as st
from strategy_hints import Hints

from framekit.definition.expression import Expression
from framekit.definition.model import segments as model
from framekit.definition.model.segments import FieldType, Segment

Draw = Callable[[st.SearchStrategy[Any]], Any]
LETTERS = "".join(chr(code) for code in range(0x21, 0x7F))


class Values:
    """Draw single values that match types, sizes and hints."""

    def __init__(self, draw: Draw, small: bool) -> None:
        self.draw = draw
        self.small = small
        self.forbidden = b""

    def text(self, least: int, most: int, hints: Hints, kind: FieldType) -> str | None:
        """Draw text of a length, with the letters that conditions require at their offsets."""
        taken = self.forbidden + (kind.pad or b"") + (kind.end or b"") + b"".join(kind.stops)
        alphabet = "".join(letter for letter in LETTERS if letter.encode() not in taken)
        least = max([least, *(place + 1 for place in hints.letters)])
        if least > most:
            return None
        if hints.allowed is not None:
            fitting = [text for text in hints.allowed if isinstance(text, str) and least <= len(text) <= most]
            return self.draw(st.sampled_from(fitting)) if fitting else None
        letters = list(self.draw(st.text(alphabet, min_size=least, max_size=most)))
        for place, (allowed, denied) in hints.letters.items():
            choice = [letter for letter in (allowed if allowed is not None else alphabet) if letter not in denied]
            if not choice:
                return None
            letters[place] = self.draw(st.sampled_from(choice))
        return "".join(letters)

    def bytes(self, size: int) -> bytes:
        data: bytes = self.draw(st.binary(min_size=size, max_size=size))
        for byte in self.forbidden:
            data = data.replace(bytes((byte,)), bytes((byte ^ 0x40,)))
        return data

    def number(self, least: int, most: int) -> int:
        """Draw a number; mostly a small number, so that lists and data counted by it stay short."""
        near = min(most, least + 12)
        if self.small:
            near = min(most, least + 3)
        choice = [st.integers(least, near), st.integers(least, near)]
        if not self.small:
            choice.append(st.integers(least, most))
        return int(self.draw(st.one_of(choice)))


# ---- facts about segments -----------------------------------------------------------------------------------


def flat(segments: tuple[Segment, ...]) -> list[Segment]:
    """Return the segments whose values belong to one record, including those in wraps, choices and optional parts."""
    found: list[Segment] = []
    for segment in segments:
        found.append(segment)
        if isinstance(segment, (model.Wrap, model.Optional)):
            found += flat(segment.of)
        elif isinstance(segment, model.Choose):
            for _, case in segment.cases:
                found += flat(case)
            found += flat(segment.otherwise or ())
    return found


def built(segment: Segment) -> list[Expression]:
    """Return the expressions that compute a value from other values when building."""
    if isinstance(segment, model.Bits):
        return [part.build for part in segment.parts if part.build is not None]
    build = segment.build if isinstance(segment, (model.Field, model.Value)) else None
    return [] if build is None else [build]


def fractions(type_: FieldType) -> st.SearchStrategy[Any]:
    """Draw numbers that a decimal text may contain; some have too many digits for a text of fixed size."""
    form = type_.form
    assert form is not None
    decimals = 4 if form.decimals is None else form.decimals
    figures = 10 ** ((type_.fixed_size or 8) - 1 - max(decimals, 1) + decimals) - 1
    numbers = st.integers(0 if form.sign == "never" else -figures, figures)
    found: st.SearchStrategy[Any] = st.builds(
        lambda number, places: Decimal(number).scaleb(-places), numbers, st.integers(0, decimals)
    )
    return found | st.none() if form.empty else found


def floats(type_: FieldType) -> st.SearchStrategy[float]:
    """Draw numbers that a float of the type's size represents exactly."""
    size = (type_.fixed_size or 4) // (2 if type_.kind == "hex_float" else 1)
    widths = {2: st.floats(width=16), 4: st.floats(width=32), 8: st.floats(width=64)}
    return widths[size].filter(lambda number: number == number)


def span_of(type_: FieldType, size: int | None) -> tuple[int, int]:
    """Return the smallest and largest number of a type; `size` is its size if that is computed."""
    size = type_.fixed_size if size is None else size
    assert size is not None or type_.is_delimited
    if type_.kind == "digits":
        return 0, type_.base**size - 1
    if type_.form is not None:
        most = 10 ** ((size or 6) - (type_.form.sign in ("always", "space"))) - 1
        return (0 if type_.form.sign == "never" else min(0, 1 - 10 ** ((size or 6) - 1))), most
    if type_.kind == "hex_int":
        size = size // 2
    if type_.kind == "bcd":
        return 0, 100**size - 1
    bits = 8 * size
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if type_.signed else (0, (1 << bits) - 1)
