"""A definition made of another program's description of a protocol, and what of that it does not say."""

from __future__ import annotations

from dataclasses import dataclass

from framekit.definition.problems import Problem


@dataclass(frozen=True, slots=True)
class ImportedDefinition:
    """The definition as YAML, and what was left out, each with its place in the file that was read."""

    text: str
    left_out: tuple[Problem, ...]
