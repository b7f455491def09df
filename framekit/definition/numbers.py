"""Whole numbers of files: digits become a number only within a bound.

A file may hold a number of any length, and Python refuses to print a number of more than 4,300 digits. No number of a
protocol comes near `MOST_DIGITS`.
"""

from __future__ import annotations

MOST_DIGITS = 1_000
"""Digits of a number in a file, at most."""


def whole_number(text: str, base: int = 10) -> int:
    """Return the number that digits (with sign or prefix) write. Raises ValueError for other text and too many digits.

    The message begins with the beginning of the text.
    """
    if len(text) > MOST_DIGITS:
        raise ValueError(
            f"'{text[:20]}…' has {len(text)} characters – a number has {MOST_DIGITS} at most; put a text in quotes"
        )
    return int(text, base)
