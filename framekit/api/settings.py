"""Settings of a line to a device, from user input: protocol, port, role, stations, parameters.

Everything is checked before a port is opened. This module does not handle the traffic of the line.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framekit.api.errors import RequestError
from framekit.codec.shown import explain
from framekit.definition.load.protocol import load_protocol
from framekit.definition.load.reader import parse_bytes, parse_number
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import NOWHERE, Position, no_such
from framekit.definition.times import LineFormat, parse_time
from framekit.link.addresses import AddressGrammar as AddressGrammar
from framekit.link.scope import Scope
from framekit.link.values import Names as Names
from framekit.link.variables import ParameterError, given_value
from framekit.run.model import Channel
from framekit.runfile.channels import line_of, needs_own, needs_station, parse_station


class LoadedProtocol(typing.Protocol):
    """The interface of results of `framekit.load`."""

    @property
    def definition(self) -> Protocol: ...


ProtocolGiven = str | Path | Protocol | LoadedProtocol
"""A protocol by its name, by its file, or already loaded."""


def protocol_of(given: ProtocolGiven) -> Protocol:
    """Return the definition. Raises DefinitionError."""
    if isinstance(given, Protocol):
        return given
    return load_protocol(given, Path.cwd()) if isinstance(given, (str, Path)) else given.definition


@dataclass(frozen=True, slots=True)
class ClientSettings:
    """A checked line."""

    protocol: Protocol
    port: str
    role: str | None
    line: LineFormat | None
    own: Any
    station: Any
    """Default station of the other side for calls without a station."""
    params: Mapping[str, Any]
    names_own: bool
    """Whether requests contain the station of the requesting side."""
    names_station: bool
    """Whether requests contain the station of the other side."""

    def channel(self) -> Channel:
        """Return the settings as a channel of a run."""
        at = Position(self.port, 0, 0)
        return Channel(
            number=1, port=self.port, protocol=self.protocol, role=self.role, line=self.line, own=self.own,
            station=self.station, params=self.params, at=NOWHERE, port_at=at,
        )  # fmt: skip

    def check_own(self) -> None:
        """Raise RequestError if requests contain the own station and it is unknown."""
        if self.own is None and self.names_own:
            raise RequestError(
                f"requests of '{self.protocol.name}' name the asking side – say its number as own (--own N)"
            )

    def station_for(self, given: Any, *, needed: bool = True) -> Any:
        """Return the station of a call.

        Raises RequestError for a station that does not fit, or a missing required station.
        """
        if needed:
            self.check_own()
        if given is not None:
            return checked_station(self.protocol, given)
        if self.station is None and needed and self.names_station:
            raise RequestError(f"'{self.protocol.name}' needs a station – say which (station=N, --station N)")
        return self.station


def line_settings(
    protocol: ProtocolGiven,
    port: str,
    *,
    role: str | None = None,
    frames_alone: bool = False,
    speed: int | None = None,
    format: str | None = None,
    own: Any = None,
    station: Any = None,
    params: Mapping[str, Any] | None = None,
) -> ClientSettings:
    """Check settings and return them.

    Raises DefinitionError for a wrong definition, RequestError for settings that do not fit it.
    """
    found = protocol_of(protocol)
    if found.kind != "protocol":
        raise RequestError(f"'{found.name}' is carried by other protocols, it has no line of its own")
    try:
        line = line_of(found, speed, format)
    except ValueError as error:
        raise RequestError(str(error)) from None
    return ClientSettings(
        protocol=found,
        port=found.line.port_of(port),
        role=None if frames_alone else _role(found, role),
        line=line,
        own=None if own is None else checked_station(found, own),
        station=None if station is None else checked_station(found, station),
        params=checked_params(found, params or {}),
        names_own=needs_own(found),
        names_station=needs_station(found),
    )


def checked_station(protocol: Protocol, given: Any) -> Any:
    """Return a station in the form of the protocol; numbers and hex pairs may be text. Raises RequestError."""
    text = given.hex(" ") if isinstance(given, bytes) and protocol.station.type == "bytes" else str(given)
    try:
        return parse_station(text, protocol)
    except ValueError as error:
        raise RequestError(str(error)) from None


def checked_params(protocol: Protocol, params: Mapping[str, Any]) -> dict[str, Any]:
    """Check parameters of the protocol and return them.

    Raises RequestError for unknown names and values that do not fit.
    """
    for name, value in params.items():
        if name not in protocol.params:
            raise RequestError(no_such(f"'{protocol.name}' has no parameter", name, protocol.params))
        try:
            given_value(protocol.params[name], value)
        except ParameterError as error:
            raise RequestError(str(error)) from None
    return dict(params)


def _role(protocol: Protocol, role: str | None) -> str | None:
    if role is None:
        if not protocol.roles:
            return None
        role = protocol.asking_role
        if role is None:
            raise RequestError(f"name the role: one of {', '.join(protocol.roles)}")
    if role not in protocol.roles:
        raise RequestError(no_such(f"'{protocol.name}' has no role", role, protocol.roles))
    return role


def names_of(protocol: Protocol, given: Mapping[str, Any]) -> Names:
    """Return the initial parameters and variables that the bytes of frames depend on, with the values `given`.

    Values may be text. Raises RequestError for values that do not fit.
    """
    try:
        scope = Scope(protocol, params={name: value for name, value in given.items() if name in protocol.params})
        for name, value in given.items():
            if name not in protocol.params:
                _set_variable(scope, protocol, name, value)
    except ParameterError as error:
        raise RequestError(str(error)) from None
    return scope


def _set_variable(scope: Scope, protocol: Protocol, name: str, value: Any) -> None:
    """Set a state variable from a value or its text. Raises RequestError."""
    if name not in protocol.state:
        known = [*protocol.params, *protocol.state]
        raise RequestError(no_such(f"'{protocol.name}' has no parameter or variable", name, known))
    value = protocol.state[name].number_of(value)
    parsers: dict[str, Callable[[str], Any]] = {"bytes": parse_bytes, "text": str, "time": parse_time}
    parse = parsers.get(protocol.state[name].type, parse_number)
    try:
        scope.set(name, parse(value) if isinstance(value, str) else value)
    except (ValueError, TypeError) as error:
        raise RequestError(f"variable '{name}': {explain(error)}") from None


def grammar_of(protocol: Protocol) -> AddressGrammar:
    """Return the address grammar of a protocol."""
    return AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
