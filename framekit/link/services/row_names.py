"""How names are written in the function of a served row: as variables where the request gives them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.codec.evaluate import LookedUp
from framekit.definition.expression import Name
from framekit.link.value_source import ValueNames
from framekit.link.values import Inverse, Names

PARAMETERS = ("request", "buffer", "station")
"""Parameters of the function that are names of the language."""

KNOWN = 'Names({"request": request, "buffer": buffer, "station": station}, names)'
"""Source of the names that a request has without its fields."""


class WriterLevel:
    """The names that are known at a place in the function: of the request, or of an item of one of its lists."""

    def __init__(self) -> None:
        self.values: dict[str, str] = {}
        """The variable of each name."""
        self.history: list[tuple[str, str]] = []
        """Names with their variables, in the order of their assignments."""
        self.pending: list[tuple[Inverse, str]] = []
        """Expressions that are still to be solved for their name, with the variable of their result."""
        self.padded = False
        """Padding may follow the data."""
        self.parts: str | None = None
        """The variable with the other parts of an address that the request gives as text."""
        self.memory = "None"
        """The variable with the data as memory has them."""
        self.type = ""
        """Source of the type that the address names."""
        self.shift = ""
        """Source of one more argument: the number of bits between an element's place and its beginning."""
        self.item = "None"
        """The variable with the fields of a list's item."""

    def put(self, name: str, variable: str) -> None:
        """Give a name a variable."""
        self.values[name] = variable
        self.history.append((name, variable))

    @property
    def held(self) -> str:
        """Return every variable so far, as the items of a tuple."""
        found = [*self.values.values(), *(variable for _, variable in self.pending)]
        found += [self.item] * (self.item != "None")
        return "".join(f"{variable}, " for variable in dict.fromkeys(found))

    @property
    def items(self) -> str:
        """Return the source of a dictionary of all known names."""
        parts = f"**{self.parts}, " if self.parts else ""
        return f"{{{parts}{', '.join(f'{name!r}: {value}' for name, value in self.values.items())}}}"

    @property
    def known(self) -> str:
        """Return the source of `Names` with all known names."""
        return f"Names({self.items}, {KNOWN})" if self.parts or self.values else KNOWN

    @property
    def names(self) -> ValueNames:
        """Return the names for values that are written at this level."""
        return ValueNames(Written(self), self.known)


class Written(LookedUp):
    """Names at a level: variables if they are known, else looked up in the names of the engine.

    `of_item`: the fields of a list's item are names, and precede all others.
    """

    def __init__(self, level: WriterLevel, of_item: bool = False) -> None:
        super().__init__("names")
        self.level = level
        self.item = level.item if of_item else "None"

    def name(self, node: Name) -> str:
        known = self._known(node)
        return (
            known
            if self.item == "None"
            else f"({self.item}[{node.name!r}] if {node.name!r} in {self.item} else {known})"
        )

    def _known(self, node: Name) -> str:
        found = self.level.values.get(node.name)
        if found is not None:
            return found
        if node.name in PARAMETERS:
            return node.name
        if self.level.parts is not None:
            return f"said({self.level.parts}, names, {node.name!r})"
        return super().name(node)


def said(parts: Mapping[str, Any], names: Names, name: str) -> Any:
    """Return the value of a name that the parts of an address may contain."""
    return parts[name] if name in parts else names[name]
