"""Places in a buffer as text: where reading stands, slices between two places; and dictionaries being put together."""

from __future__ import annotations

from dataclasses import dataclass

from framekit.codec.python.source import Source, quoted


@dataclass(frozen=True, slots=True)
class Place:
    """`offset` bytes behind `base`: '' is the start, 'end' the end of the buffer, else a local variable."""

    base: str
    offset: int

    def plus(self, size: int) -> Place:
        return Place(self.base, self.offset + size)

    def text(self, buffer: str) -> str:
        """The place as a number."""
        if self.base == "":
            return str(self.offset)
        base = f"len({buffer})" if self.base == "end" else self.base
        return _sum(base, self.offset)


def _sum(base: str, offset: int) -> str:
    if offset == 0:
        return base
    return f"{base} + {offset}" if offset > 0 else f"{base} - {-offset}"


def index(buffer: str, place: Place) -> str:
    """One byte of the buffer."""
    return f"{buffer}[{place.offset if place.base == 'end' else place.text(buffer)}]"


def between(buffer: str, first: Place, last: Place) -> str:
    """The bytes between two places."""
    if first == Place("", 0) and last == Place("end", 0):
        return buffer
    start = "" if first == Place("", 0) else _bound(buffer, first)
    stop = "" if last == Place("end", 0) else _bound(buffer, last)
    spaced = " " in start or " " in stop
    colon = " : " if spaced and start and stop else " :" if spaced and start else ": " if spaced else ":"
    return f"{buffer}[{start}{colon}{stop}]"


def _bound(buffer: str, place: Place) -> str:
    if place.base == "end":
        return str(place.offset) if place.offset else f"len({buffer})"
    return place.text(buffer)


class Fields:
    """A dictionary of values in generated code: a literal as long as possible, then a variable that grows."""

    def __init__(self, variable: str, outer: tuple[Fields, str] | None = None) -> None:
        self.variable = variable
        self.outer = outer
        self.entries: list[tuple[str, str | Fields]] = []
        self.is_open = False

    def attach(self) -> None:
        """Becomes a value of the dictionary around it, when its first value is read."""
        if self.outer is not None:
            (fields, name), self.outer = self.outer, None
            fields.add(name, self)

    def add(self, name: str, value: str | Fields) -> None:
        self.attach()
        self.entries.append((name, value))

    def text(self, out: Source) -> str:
        """The dictionary as an expression, with everything in it that was added."""
        if self.is_open:
            self.flush(out)
            return self.variable
        parts = [
            f"{quoted(name)}: {value if isinstance(value, str) else value.text(out)}" for name, value in self.entries
        ]
        return "{" + ", ".join(parts) + "}"

    def open(self, out: Source) -> None:
        """Makes it a variable, so that what comes next may be there or not."""
        if self.is_open:
            self.flush(out)
            return
        out.add(f"{self.variable} = {self.text(out)}")
        self.is_open = True
        self.entries = []

    def flush(self, out: Source) -> None:
        """Writes the entries that a variable does not have yet; one that is no variable yet is written as a whole."""
        if not self.is_open:
            return
        entries, self.entries = self.entries, []
        for name, value in entries:
            out.add(f"{self.variable}[{quoted(name)}] = {value if isinstance(value, str) else value.text(out)}")
