"""Which fields of a protocol's frames carry a station: those that the definition fills with one.

Worked out from constructors (`{frame: {field: station}}`), assignments and `echo`; no field's name means anything.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from framekit.definition.expression.syntax import Attribute, Expression, Name
from framekit.definition.model.procedure import Action, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.values import FrameOf
from framekit.definition.model.walk import parts_of

STATIONS = ("station", "own")


def station_fields(protocol: Protocol) -> frozenset[str]:
    """Names of the fields that carry a station."""
    found = {name for name, value in _filled(protocol) if isinstance(value, Expression) and _is_station(value)}
    for frame in protocol.frames.values():
        for name, expression in frame.echo.items():
            if isinstance(expression.root, Name) and expression.root.name in found:
                found.add(name)
    return frozenset(found)


def _filled(protocol: Protocol) -> Iterator[tuple[str, Any]]:
    """Every field of a frame with what it is filled with."""
    procedure = (dict(protocol.sequences), dict(protocol.services), protocol.errors)
    for frame in parts_of(procedure, FrameOf):
        yield from frame.fields.items()
    actions = [action.set for action in parts_of(procedure, Action)]
    for assignments in (*actions, *(step.set for step in parts_of(procedure, Step))):
        for target, value in assignments:
            if target.field is not None:
                yield target.field, value


def _is_station(expression: Expression) -> bool:
    root = expression.root
    if isinstance(root, Attribute):
        return root.name == "station"
    return isinstance(root, Name) and root.name in STATIONS
