"""What used files bring along: the tables, state and parameters that parts taken from them mention, no more."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from framekit.definition.expression.syntax import names_in
from framekit.definition.load.namespace import Namespace, Owned
from framekit.definition.model.walk import expressions_of

SECTIONS = ("tables", "state", "params")


def names_mentioned(parts: Iterable[Any]) -> set[str]:
    """Bare words read by any expression in these parts of a model."""
    return {name for part in parts for expression in expressions_of(part) for name in names_in(expression.root)}


def used_entries(space: Namespace, section: str) -> dict[str, tuple[Namespace, Owned]]:
    """Entries of a section in the files used, also indirectly; the nearest wins."""
    found: dict[str, tuple[Namespace, Owned]] = {}
    for used in space.uses.values():
        for name, owned in used.section(section).items():
            found.setdefault(name, (used, owned))
    for used in space.uses.values():
        for name, entry in used_entries(used, section).items():
            found.setdefault(name, entry)
    return found
