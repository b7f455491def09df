"""Numbers of several words whose order is in doubt: read with their words reversed, and compared by likelihood.

A device does not transmit the order of the words of a number. A number that is read in the wrong order is mostly far
too large or far too small, and the same bytes in the reverse order give a common number.
"""

from __future__ import annotations

from dataclasses import replace

from framekit.memory.memory import MemoryValueError, unit_bits
from framekit.memory.views import NumberView

UNCOMMON = 1e-9, 1e12
"""Floating-point numbers up to the first size, and from the second on, are uncommon; 0 is common."""
COMMON = 1e-4, 1e7
"""Least and greatest size of floating-point numbers that are common."""
MOST_WHOLE = 1 << 16
"""Whole numbers below are common if their reversed words give a multiple of it: 196608 is 3, with its words reversed.
"""


def order_of(view: NumberView) -> str:
    """Return the name of the order of bytes of a view."""
    if view.words_reversed:
        return "BADC" if view.bytes_swapped else "ABCD"
    return "DCBA" if view.bytes_swapped else "CDAB"


def reversed_view(view: NumberView) -> NumberView:
    """Return the view of the same type with the words in the reverse order."""
    return replace(view, words_reversed=not view.words_reversed)


def has_words(view: NumberView, place: str) -> bool:
    """Return whether numbers of a view have several words at places of the unit `place`."""
    return view.kind in ("float", "signed", "unsigned") and unit_bits(view.unit) > max(16, unit_bits(place))


def likely_with_reversed_words(view: NumberView, number: float) -> float | None:
    """Return the number with its words reversed if that is common, and the number as read is uncommon; else None."""
    try:
        other = reversed_view(view).read(view.write([number]))[0]
    except MemoryValueError:
        return None
    if view.kind != "float":
        return other if number and number % MOST_WHOLE == 0 and 0 < other < MOST_WHOLE else None
    is_common = number == 0 or UNCOMMON[0] < abs(number) < UNCOMMON[1]
    return None if is_common or not COMMON[0] <= abs(other) <= COMMON[1] else other
