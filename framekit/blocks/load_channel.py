"""Reads the channels of a run: port, line, protocol, role, stations and parameters."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import TypeVar

from framekit.blocks.fault_plan import FaultPlan
from framekit.blocks.given import read_station
from framekit.blocks.load_fault_plan import read_fault_plan
from framekit.blocks.load_line import LineLoader
from framekit.blocks.load_rules import RulesLoader
from framekit.blocks.model import DEFAULT_LIMITS, Channel, ConnectionLimits
from framekit.definition.expression.syntax import names_in
from framekit.definition.load.library import load_protocol
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.protocol import WITHOUT_NUMBER, Protocol
from framekit.definition.model.walk import expressions_of
from framekit.definition.nodes import Entry, Mapping, Node
from framekit.definition.problems import DefinitionError, Problem, did_you_mean
from framekit.definition.times import LineFormat, parse_format

T = TypeVar("T")

_HOST_AND_PORT = re.compile(r"[A-Za-z0-9.-]+:\d+")


class ChannelLoader:
    """Reads channels of the run in `folder`. `protocols`: those loaded so far, None for one that is wrong."""

    def __init__(self, reader: Reader, folder: Path, root: Mapping) -> None:
        self.reader = reader
        self.rules = RulesLoader(reader, root)
        self.folder = folder
        self.protocols: dict[str, Protocol | None] = {}
        self.spoilt = False

    def _maybe(self, read: Callable[[Node], T], node: Node | None) -> T | None:
        """What stands under a key; None for nothing, and for something broken: the rest is read all the same."""
        try:
            return None if node is None else read(node)
        except Broken:
            self.spoilt = True
            return None

    def channel(self, entry: Entry) -> Channel:
        """Raises Broken when anything of it is wrong."""
        self.spoilt = False
        return self._channel(entry, self._maybe(self.reader.number, entry.key))

    def template(self, entry: Entry) -> Channel:
        """A channel whose number is not known yet. Raises Broken."""
        self.spoilt = False
        return self._channel(entry, None)

    def _channel(self, entry: Entry, number: int | None) -> Channel:
        reader, keys = self.reader, self.reader.mapping(entry.value)
        port_node = keys.get("port") or entry.key
        port = self._maybe(self._port, keys.get("port"))
        answer = self._maybe(reader.time, keys.get("answer"))
        protocol = self._protocol(keys)
        port = self._with_number(port or "", port_node, protocol)
        line = self._line(keys, protocol)
        wires = LineLoader(reader, keys, protocol, port, line)
        silence = self.rules.silence(keys, line)
        channel = Channel(
            number=number or 0,
            port=port,
            protocol=protocol,
            role=self._role(keys, entry, protocol),
            line=line,
            wiring=wires.settings(),
            host=self._maybe(reader.text, keys.get("host")) or "",
            own=self._maybe(lambda node: read_station(reader, node, protocol), keys.get("own")),
            station=self._maybe(lambda node: read_station(reader, node, protocol), keys.get("station")),
            params=self.rules.params(keys, protocol),
            pause=silence.between,
            silence=silence,
            dead=self.rules.dead(keys),
            merge=self.rules.merge(keys),
            stations=self.rules.stations(keys, protocol),
            enabled=reader.flag(keys.get("enabled"), default=True),
            answer=answer or 0,
            at=entry.key.at,
            port_at=port_node.at,
            faults=self._faults(keys.get("faults"), port, protocol),
            limits=self._maybe(self._limits, keys.get("clients")) or DEFAULT_LIMITS,
        )
        clients = keys.get("clients")
        if clients is not None and not channel.listens:
            what = f"channel {entry.key.text} does not listen, so it has no clients"
            reader.note(clients.at, what, "leave clients out, or listen with an answering role at tcp-listen://")
        if channel.listens and channel.asks:
            what = f"channel {entry.key.text} listens for connections, and nothing it does begins on one"
            reader.note(port_node.at, what, "give it an answering role, or write tcp:// to connect to the other side")
        if self.spoilt:
            raise Broken(entry.key.text)
        return channel

    def _with_number(self, port: str, node: Node, protocol: Protocol) -> str:
        """The port with the protocol's own port number where it names none."""
        found = protocol.line.port_of(port)
        if WITHOUT_NUMBER.fullmatch(found):
            what = f"'{port}' names no port number, and '{protocol.name}' has none of its own"
            self.reader.note(node.at, what, f"write {port.rstrip('/')}:NUMBER")
            self.spoilt = True
        return found

    def _limits(self, node: Node) -> ConnectionLimits:
        """What clients of a port that listens may do. Raises Broken."""
        reader, keys = self.reader, self.reader.mapping(node)
        idle, connections = keys.get("idle_timeout"), keys.get("connections")
        try:
            return ConnectionLimits(
                DEFAULT_LIMITS.idle if idle is None else reader.time(idle),
                DEFAULT_LIMITS.per_address if connections is None else reader.number(connections),
            )
        except ValueError as error:
            what, _, todo = str(error).partition(" – ")
            raise reader.broken(node.at, what, todo) from None

    def _port(self, node: Node) -> str:
        port = self.reader.text(node)
        if _HOST_AND_PORT.fullmatch(port) and not port.startswith("sim:"):
            raise self.reader.broken(node.at, f"'{port}' is no port", f"write tcp://{port} for a connection")
        for name in port.removeprefix("sim:").split(",") if port.startswith("sim:") else ():
            if not name.strip():
                raise self.reader.broken(node.at, "a simulated device has no name", "write sim:FILE")
            self._inside(name.strip(), node)
        return port

    def _inside(self, name: str, node: Node) -> None:
        """Files of a run stand beside it, below it, or are shipped."""
        if name.startswith(("/", "~")) or "\\" in name or ".." in PurePosixPath(name).parts:
            what = f"'{name}' leaves the run's folder"
            raise self.reader.broken(node.at, what, "name a file beside it or a shipped one")

    def _faults(self, node: Node | None, port: str | None, protocol: Protocol) -> FaultPlan | None:
        if node is not None and port is not None and not port.startswith("sim:"):
            self.reader.note(node.at, f"'{port}' is no simulated line", "faults are for sim: ports")
        return read_fault_plan(self.reader, node, self.folder, protocol, line=True)

    # ---- protocol and role --------------------------------------------------------------------------------

    def _protocol(self, keys: Mapping) -> Protocol:
        node = keys.get("protocol")
        if node is None:
            raise Broken("the schema asks for a protocol")
        name = self.reader.text(node)
        self._inside(name, node)
        if name not in self.protocols:
            self.protocols[name] = None
            try:
                self.protocols[name] = load_protocol(self._beside(name), self.folder)
            except DefinitionError as error:
                for problem in error.problems:
                    there = problem.at.file != name
                    self.reader.problems.append(problem if there else Problem(node.at, problem.what, problem.todo))
        protocol = self.protocols[name]
        if protocol is None:
            raise Broken(name)
        return protocol

    def _beside(self, name: str) -> str | Path:
        file = self.folder / name
        return file if file.suffix == ".yaml" and file.is_file() else name

    def _role(self, keys: Mapping, entry: Entry, protocol: Protocol) -> str | None:
        """The role given, or the usual one of a side that asks."""
        node = keys.get("role")
        if not protocol.roles:
            if node is not None:
                self.reader.note(node.at, f"'{protocol.name}' has no roles", "leave role out")
            return None
        if node is None:
            role = protocol.asking_role
            if role is None:
                known = ", ".join(protocol.roles)
                self.reader.note(entry.key.at, f"channel {entry.key.text} says no role", f"add role: one of {known}")
                self.spoilt = True
            return role
        role = self.reader.text(node)
        if role not in protocol.roles:
            hint = did_you_mean(role, protocol.roles)
            self.reader.note(node.at, f"'{protocol.name}' has no role '{role}'", hint)
            self.spoilt = True
        return role

    # ---- line ---------------------------------------------------------------------------------------------

    def _line(self, keys: Mapping, protocol: Protocol) -> LineFormat | None:
        """The speed and format of the channel; the protocol's own where the run says nothing. None for a stream."""
        reader, line = self.reader, protocol.line
        speed_node, format_node = keys.get("speed"), keys.get("format")
        if line.kind == "stream":
            for node in (speed_node, format_node):
                if node is not None:
                    reader.warn(node.at, f"'{protocol.name}' runs on connections, which have no speed", "leave it out")
            return None
        speed = self._maybe(reader.number, speed_node) or line.speed
        if speed_node is not None and line.speeds and speed not in line.speeds:
            hint = "choose one of " + ", ".join(map(str, line.speeds))
            reader.warn(speed_node.at, f"'{protocol.name}' does not list a speed of {speed}", hint)
        text = line.format if format_node is None else reader.text(format_node)
        if format_node is not None and line.formats and text not in line.formats:
            hint = "choose one of " + ", ".join(line.formats)
            reader.warn(format_node.at, f"'{protocol.name}' does not list a format of {text}", hint)
        try:
            return parse_format(text, speed)
        except ValueError as error:
            what, _, todo = str(error).partition(" – ")
            reader.note((format_node or speed_node or keys).at, what, todo)
            self.spoilt = True
            return None


def needs_station(protocol: Protocol) -> bool:
    """Whether exchanges of a protocol name the other side, and nothing says which it is by itself."""
    if protocol.station.type == "none" or protocol.station.default is not None:
        return False
    holders = [row.request for rows in protocol.services.values() for row in rows]
    exchanges = {name for role in protocol.roles.values() for lane in role.lanes for name in lane.exchange}
    sequences = [protocol.sequences[name] for name in exchanges if name in protocol.sequences]
    expressions = (*expressions_of(holders), *expressions_of(sequences))
    return any("station" in names_in(expression.root) for expression in expressions)


def needs_own(protocol: Protocol) -> bool:
    """Whether requests of a protocol name the side that asks, and nothing says which it is by itself."""
    if protocol.station.type == "none" or protocol.station.default is not None:
        return False
    requests = [row.request for rows in protocol.services.values() for row in rows]
    return any("own" in names_in(expression.root) for expression in expressions_of(requests))
