"""A definition converted from another program's description of a protocol, with the parts that were not converted."""

from __future__ import annotations

from dataclasses import dataclass

from framekit.definition.problems import Problem


@dataclass(frozen=True, slots=True)
class ImportedDefinition:
    """The definition as YAML, and the omitted parts, each with its place in the file that was read."""

    text: str
    left_out: tuple[Problem, ...]
