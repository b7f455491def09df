"""How long characters and bits take on a line, as expressions of a definition ask for it: whole nanoseconds.

It knows the line's speed and format, and nothing of what is sent there.
"""

from __future__ import annotations

from framekit.definition.times import LineFormat


class LineTimes:
    """`line` of the language: its speed, and how long characters and bits take. On a stream they take no time."""

    __slots__ = ("_bit", "character", "speed")

    def __init__(self, line: LineFormat | None) -> None:
        self.speed = 0 if line is None else line.speed
        self._bit = 0.0 if line is None else 1_000_000_000 / line.speed
        self.character = 0.0 if line is None else self._bit * line.character_bits

    def chars(self, numerator: int, denominator: int = 1) -> int:
        """Nanoseconds that numerator / denominator characters take."""
        return round(self.character * numerator / denominator)

    def bits(self, numerator: int, denominator: int = 1) -> int:
        """Nanoseconds that numerator / denominator bits take."""
        return round(self._bit * numerator / denominator)

    def language_attribute(self, name: str) -> int:
        if name == "speed":
            return self.speed
        raise KeyError(name)
