"""Start values of a device's state that a command line or a program gives in place of those of its file.

They are constants: text for a table, list or record is YAML in one line, `{2: SECRET}`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from framekit.definition.given_values import GivenEntry, GivenValue, given_value
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import StateVariable
from framekit.definition.nodes import read_text
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean
from framekit.definition.start_values import StartValues


def with_state(protocol: Protocol, state: Mapping[str, Any]) -> Protocol:
    """Return the protocol with these start values. Raises DefinitionError with all problems of the values."""
    problems: list[Problem] = []
    values = StartValues(protocol.layouts)
    changed: dict[str, StateVariable] = {}
    for name, value in state.items():
        at = Position(f"--state {name}", 0, 0)
        variable = protocol.state.get(name)
        if variable is None or variable.scope == "line":
            known = [one.name for one in protocol.state.values() if one.scope != "line"]
            what = f"'{protocol.name}' has no state variable '{name}'"
            problems.append(Problem(at, what, did_you_mean(name, known) or f"known: {', '.join(known)}"))
            continue
        given = _text_given(variable, value, at) if isinstance(value, str) else _given(value, at)
        changed[name] = replace(variable, initial=None, given=given)
        values.of(changed[name])
    problems += values.problems
    if problems:
        raise DefinitionError(problems)
    return replace(protocol, state={**protocol.state, **changed})


def _text_given(variable: StateVariable, text: str, at: Position) -> GivenValue:
    """Return a value from its text; only the text of a table, list or record is YAML."""
    if variable.keys is None and variable.layout is None:
        return GivenValue(at, text)
    return given_value(read_text(text, at.file, begin="{KEY: value} or [value, …]"))


def _given(value: Any, at: Position) -> GivenValue:
    """Return a value of a program."""
    if isinstance(value, Mapping):
        entries = tuple(GivenEntry(str(name), at, _given(item, at)) for name, item in value.items())
        return GivenValue(at, entries, is_map=True)
    if isinstance(value, (list, tuple)):
        return GivenValue(at, tuple(_given(item, at) for item in value))
    if isinstance(value, (bytes, bytearray)):
        return GivenValue(at, value.hex(" "))
    if isinstance(value, bool):
        return GivenValue(at, "yes" if value else "no")
    return GivenValue(at, str(value))
