"""Names of the numbers in the results of services, from the layouts and reply frames that the results are read from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from framekit.codec.plain import names_of
from framekit.codec.shown import shown, with_names
from framekit.definition.expression import Attribute, Expression, Name
from framekit.definition.model.frames import everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.values import ReadAs, RecordOf, Value

Names = Mapping[str, Mapping[int, str]]
"""Names of numbers, by field."""


class ResultNames:
    """Finds the names of numbers in the results of a protocol's services; those of a service are kept."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self._of_service: dict[str, dict[str, Names]] = {}

    def with_names(self, service: str, results: Mapping[str, Any]) -> dict[str, Any]:
        """Return the results of a service in plain form, each number with its name: `18 (low CPU battery)`."""
        names = self._known(service)
        return {name: with_names(names.get(name, {}), name, shown(value)) for name, value in results.items()}

    def by_path(self, service: str, results: Mapping[str, Any]) -> dict[str, str]:
        """Return the names of the numbers by their places: `{"faults.faults[0].group": "low CPU battery"}`."""
        found: dict[str, str] = {}
        for result, names in self._known(service).items():
            if names and result in results:
                found.update(named_paths(names, result, result, results[result]))
        return found

    def _known(self, service: str) -> dict[str, Names]:
        names = self._of_service.get(service)
        if names is None:
            names = self._of_service[service] = _names_of_results(self.protocol, service)
        return names


def named_paths(names: Names, field: str, path: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the places and names of the named numbers in a value; `field` is the name of its field."""
    if isinstance(value, dict):
        for name, item in value.items():
            yield from named_paths(names, name, f"{path}.{name}", item)
    elif isinstance(value, list):
        for place, item in enumerate(value):
            yield from named_paths(names, field, f"{path}[{place}]", item)
    elif type(value) is int and (name := names.get(field, {}).get(value)) is not None:
        yield path, name


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
        return names_in_layout(protocol, value.layout)
    if isinstance(value, Expression):
        field = _field_of_reply(value)
        names = _in_replies(protocol, row) if field else {}
        return {**names, result: names[field]} if field in names else names
    return {}


def names_in_layout(protocol: Protocol, layout: str) -> Names:
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
