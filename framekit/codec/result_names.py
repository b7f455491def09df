"""Names of the numbers in the results of services, from the layouts and reply frames that the results are read from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from framekit.codec.plain import names_of
from framekit.codec.shown import shown, with_name
from framekit.definition.expression import Attribute, Expression, Name
from framekit.definition.model.frames import everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.values import ReadAs, RecordOf, Value

Names = Mapping[str, Mapping[int, str]]
"""Names of numbers, by field."""


def with_names(protocol: Protocol, service: str, results: Mapping[str, Any]) -> dict[str, Any]:
    """Return the results of a service in plain form, each number with its name: `18 (low CPU battery)`."""
    names = _names_of_results(protocol, service)
    return {name: _named(names.get(name, {}), name, shown(value)) for name, value in results.items()}


def _named(names: Names, path: str, value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _named(names, name, item) for name, item in value.items()}
    if isinstance(value, list):
        return [_named(names, path, item) for item in value]
    return with_name(names, path, value)


def _names_of_results(protocol: Protocol, service: str) -> dict[str, Names]:
    found: dict[str, Names] = {}
    for row in protocol.services.get(service, ()):
        for name, value in row.gives.items():
            found.setdefault(name, _names_of_value(protocol, row, name, value))
    return found


def _names_of_value(protocol: Protocol, row: ServiceRow, result: str, value: Value) -> Names:
    """Return the names in the fields of a result; a number of its own has the key `result`."""
    if isinstance(value, RecordOf):
        inside = (_names_of_value(protocol, row, name, item) for name, item in value.fields.items())
        return {name: numbers for names in inside for name, numbers in names.items()}
    if isinstance(value, ReadAs) and value.layout in protocol.layouts:
        return _in_layout(protocol, value.layout)
    if isinstance(value, Expression):
        field = _field_of_reply(value)
        names = _in_replies(protocol, row) if field else {}
        return {**names, result: names[field]} if field in names else names
    return {}


def _in_layout(protocol: Protocol, layout: str) -> Names:
    """Return the names of the fields of a layout; fields whose names differ have none."""
    segments = everything(protocol.layouts[layout].segments)
    return _agreed((name, numbers) for segment in segments for name, numbers in segment.numbers_with_names())


def _in_replies(protocol: Protocol, row: ServiceRow) -> Names:
    """Return the names of the fields of the row's reply frames."""
    frames = [reply.frame.frame for reply in row.reply if reply.frame is not None]
    return _agreed(item for frame in frames for item in names_of(protocol, frame).items())


def _agreed(items: Iterable[tuple[str, Mapping[int, str] | None]]) -> Names:
    found: dict[str, Mapping[int, str] | None] = {}
    for name, numbers in items:
        found[name] = numbers if found.get(name, numbers) == numbers else None
    return {name: numbers for name, numbers in found.items() if numbers}


def _field_of_reply(expression: Expression) -> str:
    """Return the last field of `reply.a.b`; an empty text for other expressions."""
    node, field = expression.root, ""
    while isinstance(node, Attribute):
        field = field or node.name
        node = node.value
    return field if isinstance(node, Name) and node.name == "reply" else ""
