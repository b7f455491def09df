"""Values that runs and devices give to a protocol: stations and parameters, checked against what it declares."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from framekit.definition.load.reader import Reader
from framekit.definition.load.scalars import parse_bytes, parse_number
from framekit.definition.model.protocol import Parameter, Protocol, StationType
from framekit.definition.nodes import Entry, Node, Sequence
from framekit.definition.problems import did_you_mean, plural
from framekit.link.parameters import ParameterError, given_item, given_value


def read_station(reader: Reader, node: Node, protocol: Protocol) -> Any:
    """The number, text or bytes that names a station of a protocol. Raises Broken."""
    try:
        return parse_station(reader.text(node), protocol)
    except ValueError as error:
        what, _, todo = str(error).partition(" – ")
        raise reader.broken(node.at, what, todo) from None


def parse_station(text: str, protocol: Protocol) -> Any:
    """Raises ValueError with a sentence for what is no station of this protocol."""
    station = protocol.station
    if station.type == "none":
        raise ValueError(f"'{protocol.name}' has no stations – leave the station out")
    if station.type == "number":
        number = parse_number(text)
        if station.limits is not None and not station.limits[0] <= number <= station.limits[1]:
            raise ValueError(f"station {number} is not in {station.limits[0]}..{station.limits[1]}")
        return number
    if station.type == "bytes":
        filled = _filled(text, station)
        data = parse_bytes(text) if filled is None else filled
        if station.size is not None and len(data) != station.size:
            raise ValueError(f"station {text} has {plural(len(data), 'byte')}, it needs {station.size}")
        return data
    if station.size is not None and len(text) > station.size:
        raise ValueError(f"station '{text}' has {len(text)} characters, at most {station.size} are possible")
    return text


def _filled(text: str, station: StationType) -> bytes | None:
    """The bytes of a station that is given as a text; None where the text can only be hex pairs."""
    if station.pad is None or station.size is None or len(text) > station.size or not text.isascii():
        return None
    return text.encode("ascii").ljust(station.size, bytes((station.pad,)))


def read_params(reader: Reader, entries: Iterable[Entry], protocol: Protocol) -> dict[str, Any]:
    """Parameters in their YAML form, each tried; those that do not fit are noted and left out."""
    found: dict[str, Any] = {}
    for entry in entries:
        with reader.going_on():
            name = entry.key.text
            if name not in protocol.params:
                hint = did_you_mean(name, protocol.params)
                raise reader.broken(entry.key.at, f"'{protocol.name}' has no parameter '{name}'", hint)
            value = raw_value(reader, entry.value)
            parameter = protocol.params[name]
            if parameter.type == "list" and isinstance(entry.value, Sequence):
                if _items_fit(reader, entry.value, parameter):
                    found[name] = value
                continue
            try:
                given_value(parameter, value)
            except ParameterError as error:
                what, _, todo = str(error).partition(" – ")
                raise reader.broken(entry.value.at, what, todo) from None
            found[name] = value
    return found


def _items_fit(reader: Reader, node: Sequence, parameter: Parameter) -> bool:
    """Whether every item is what the list holds; each that is not is noted at its place."""
    fits = True
    for item in node.items:
        try:
            given_item(parameter, reader.text(item))
        except ParameterError as error:
            what, _, todo = str(error).partition(" – ")
            reader.note(item.at, what, todo)
            fits = False
    return fits


def raw_value(reader: Reader, node: Node) -> Any:
    """Text, or a list of texts: a value in its YAML form."""
    return [reader.text(item) for item in node.items] if isinstance(node, Sequence) else reader.text(node)
