"""Read the channels of a run: port, line, protocol, role, parameters, wiring, silences, dead stations."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, get_args

from framekit.definition.expression import names_in
from framekit.definition.load.protocol import load_protocol
from framekit.definition.load.reader import Broken, Reader, parse_bytes, parse_number
from framekit.definition.model.frames import expressions_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import WITHOUT_NUMBER, Parameter, StationType
from framekit.definition.nodes import Entry, Mapping, Node, Sequence
from framekit.definition.problems import DefinitionError, did_you_mean, parted, plural
from framekit.definition.sources import INSIDE, leaves_folder
from framekit.definition.times import (
    FAST,
    SPEEDS,
    Direction,
    Handshake,
    Interface,
    LineFormat,
    LineSettings,
    parse_format,
)
from framekit.link.addresses import AddressGrammar
from framekit.link.scope import LineTimes
from framekit.link.variables import ParameterError, given_item, given_value
from framekit.run.model import (
    DEFAULT_LIMITS,
    Channel,
    ConnectionLimits,
    DeadRule,
    FaultPlan,
    Merge,
    Network,
    Silence,
    StationRules,
    network_of,
)
from framekit.runfile.fault_plans import read_fault_plan
from framekit.runfile.modems import read_limit, read_modem
from framekit.transport.schemes import is_known, no_port, scheme_of

T = TypeVar("T")


class Attempts:
    """Reads parts and continues after a broken part; `spoilt` is set if any part was broken (already reported)."""

    def __init__(self) -> None:
        self.spoilt = False

    def spoil(self) -> None:
        """Note that a part was broken."""
        self.spoilt = True

    @contextmanager
    def going_on(self) -> Iterator[None]:
        """Continue after the `with` block if its body raises Broken."""
        try:
            yield
        except Broken:
            self.spoilt = True

    def to(self, read: Callable[[], T]) -> T | None:
        """Return the result of `read`, or None if it raises Broken."""
        with self.going_on():
            return read()
        return None

    def maybe(self, read: Callable[[Node], T], node: Node | None) -> T | None:
        """Return the value of a node, or None if the node is missing or broken."""
        return None if node is None else self.to(lambda: read(node))


def read_clients(reader: Reader, node: Node) -> tuple[Network, ...]:
    """Return the addresses and networks from which clients may connect: a single entry or a list. Raise Broken."""

    def network(item: Node) -> Network:
        with reader.refusing(item.at):
            return network_of(reader.text(item))

    return reader.each(reader.items(node), network)


def read_channel_number(reader: Reader, node: Node, known: Collection[str]) -> int:
    """Return the number of a channel. Raise Broken for another text, which is reported unless it is a key of `known`:
    a wrong key of the channels has been reported.
    """
    text = reader.text(node).strip()
    try:
        return parse_number(text)
    except ValueError:
        if text in known:
            raise Broken("the key of the channel has been reported") from None
        return reader.number(node)


class ChannelLoader:
    """Reads the channels of the run in `folder`. `protocols` caches the loaded protocols; None marks an invalid one."""

    def __init__(self, reader: Reader, folder: Path, root: Mapping) -> None:
        self.reader = reader
        self.rules = RulesLoader(reader, root)
        self.folder = folder
        self.protocols: dict[str, Protocol | None] = {}
        self.attempts = Attempts()
        self.broken: dict[int, Channel] = {}
        """Channels with errors in some keys, which are left out; their protocol is valid."""

    def channel(self, entry: Entry, grammar: AddressGrammar, *, numbered: bool = True) -> Channel:
        """Return a channel. Raise Broken if any key is invalid.

        `numbered`: the key is the number of the channel; without it the channel has no number yet. `grammar`: the
        addresses of the own memory.
        """
        self.attempts.spoilt = False
        number = self.attempts.maybe(self.reader.number, entry.key) if numbered else None
        reader, keys = self.reader, self.reader.mapping(entry.value)
        port_node = keys.get("port") or entry.key
        port = self.attempts.maybe(self._port, keys.get("port"))
        answer = self.attempts.maybe(reader.time, keys.get("answer"))
        protocol = self.attempts.to(lambda: self._protocol(keys))
        if protocol is None:
            self._look_at_rest(keys, port or "", port_node)
            raise Broken(entry.key.text)
        port = self._with_number(port or "", port_node, protocol)
        line = self._line(keys, protocol)
        wires = LineLoader(reader, keys, port, line)
        silence = self.rules.silence(keys, line)
        channel = Channel(
            number=number or 0,
            port=port,
            protocol=protocol,
            role=self._role(keys, entry, protocol),
            line=line,
            wiring=wires.settings(protocol),
            host=self.attempts.maybe(reader.text, keys.get("host")) or "",
            own=self.attempts.maybe(lambda node: read_station(reader, node, protocol), keys.get("own")),
            station=self.attempts.maybe(lambda node: read_station(reader, node, protocol), keys.get("station")),
            params=self.rules.params(keys, protocol),
            silence=silence,
            dead=self.rules.dead(keys),
            merge=self.rules.merge(keys),
            stations=self.rules.stations(keys, protocol),
            enabled=reader.flag(keys.get("enabled"), default=True),
            command_queue=self.attempts.maybe(reader.number, keys.get("command_queue")),
            command_start=self.attempts.maybe(reader.time, keys.get("command_start")) or 0,
            answer=answer or 0,
            mapping=read_mapping(reader, keys.get("map"), protocol, grammar),
            at=entry.key.at,
            port_at=port_node.at,
            faults=self._faults(keys.get("faults"), port, protocol),
            limits=self.attempts.maybe(self._limits, keys.get("clients")) or DEFAULT_LIMITS,
        )
        self._unused(keys, channel, entry.key.text)
        clients = keys.get("clients")
        if clients is not None and not channel.listens:
            what = f"channel {entry.key.text} does not listen, so it has no clients"
            reader.note(clients.at, what, "leave clients out, or listen with an answering role at tcp-listen://")
        if channel.listens and channel.asks and not self.attempts.spoilt:
            what = f"channel {entry.key.text} listens for connections, and nothing it does begins on one"
            reader.note(port_node.at, what, "give it an answering role, or write tcp:// to connect to the other side")
        if self.attempts.spoilt:
            if number is not None:
                self.broken.setdefault(number, channel)
            raise Broken(entry.key.text)
        return channel

    def _look_at_rest(self, keys: Mapping, port: str, port_node: Node) -> None:
        """Note problems of the keys of a channel that do not depend on its protocol."""
        reader, line = self.reader, parse_format("8N1", 9600)
        if not WITHOUT_NUMBER.fullmatch(port):
            self._check_port(port, port_node)
        self.attempts.to(lambda: self.rules.silence(keys, line))
        self.attempts.to(lambda: self.rules.dead(keys))
        self.attempts.to(lambda: self.rules.merge(keys))
        self.attempts.to(LineLoader(reader, keys, port, line).single)
        self.attempts.maybe(self._limits, keys.get("clients"))

    def _unused(self, keys: Mapping, channel: Channel, name: str) -> None:
        """Note keys without effect: for requests on an answering channel, and `map` on a channel without answers."""
        role = None if channel.role is None else channel.protocol.roles[channel.role]
        for key in () if channel.asks else OF_ASKING:
            if (node := keys.get(key)) is not None:
                todo = "write own: if its own station is meant" if key == "station" else "remove it"
                self.reader.note(node.at, f"'{key}' has no effect: channel {name} only answers", todo)
        node = keys.get("map")
        if node is not None and (role is None or not role.listens):
            self.reader.note(node.at, f"'map' has no effect: channel {name} answers nothing", "remove it")

    def _with_number(self, port: str, node: Node, protocol: Protocol) -> str:
        """Return the port, completed by the port number of the protocol if it has none."""
        found = protocol.line.port_of(port)
        if WITHOUT_NUMBER.fullmatch(found):
            what = f"'{port}' names no port number, and '{protocol.name}' has none of its own"
            self.reader.note(node.at, what, f"write {port.rstrip('/')}:NUMBER")
            self.attempts.spoilt = True
        else:
            self._check_port(found, node)
        return found

    def _check_port(self, port: str, node: Node) -> None:
        """Note an invalid place in a port, such as a number beyond 65535."""
        kind = scheme_of(port)
        if kind is not None and kind.check is not None:
            with self.attempts.going_on(), self.reader.refusing(node.at):
                kind.check(port)

    def _limits(self, node: Node) -> ConnectionLimits:
        """Return the limits for the clients of a listening port. Raise Broken."""
        reader = self.reader
        if not isinstance(node, Mapping):
            return ConnectionLimits(allowed=read_clients(reader, node))
        keys = reader.mapping(node)
        idle, connections, allow = keys.get("idle_timeout"), keys.get("connections"), keys.get("allow")
        with reader.refusing(node.at):
            return ConnectionLimits(
                DEFAULT_LIMITS.idle if idle is None else reader.time(idle),
                DEFAULT_LIMITS.per_address if connections is None else reader.number(connections),
                () if allow is None else read_clients(reader, allow),
            )

    def _port(self, node: Node) -> str:
        port = self.reader.text(node)
        if port.strip() and not is_known(port):
            raise self.reader.broken(node.at, *no_port(port))
        for name in port.removeprefix("sim:").split(",") if port.startswith("sim:") else ():
            if not name.strip():
                raise self.reader.broken(node.at, "a simulated device has no name", "write sim:FILE")
            self._inside(name.strip(), node)
        kind = scheme_of(port)
        if kind is not None and kind.placed is not None:
            with self.reader.refusing(node.at):
                return kind.placed(port, self.folder)
        return port

    def _inside(self, name: str, node: Node) -> None:
        """Raise Broken if the file name leads out of the folder of the run and its root."""
        if leaves_folder(name, self.folder):
            raise self.reader.broken(node.at, f"'{name}' leaves the run's folder", INSIDE)

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
                self.protocols[name] = load_protocol(beside(name, self.folder), self.folder)
            except DefinitionError as error:
                self.reader.of_file(error, name, node.at)
        protocol = self.protocols[name]
        if protocol is None:
            raise Broken(name)
        return protocol

    def _role(self, keys: Mapping, entry: Entry, protocol: Protocol) -> str | None:
        """Return the role as given, or the usual role for requests."""
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
                self.attempts.spoilt = True
            return role
        role = self.reader.text(node)
        if role not in protocol.roles:
            hint = did_you_mean(role, protocol.roles)
            self.reader.note(node.at, f"'{protocol.name}' has no role '{role}'", hint)
            self.attempts.spoilt = True
            return None
        return role

    # ---- line ---------------------------------------------------------------------------------------------

    def _line(self, keys: Mapping, protocol: Protocol) -> LineFormat | None:
        """Return speed and format of the channel, by default those of the protocol; None for a stream."""
        reader, line = self.reader, protocol.line
        speed_node, format_node = keys.get("speed"), keys.get("format")
        if line.kind == "stream":
            for node in (speed_node, format_node):
                if node is not None:
                    reader.warn(node.at, f"'{protocol.name}' runs on connections, which have no speed", "leave it out")
            return None
        speed = self.attempts.maybe(reader.number, speed_node) or line.speed
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
            reader.note((format_node or speed_node or keys).at, *parted(error))
            self.attempts.spoilt = True
            return None


def beside(name: str, folder: Path) -> str | Path:
    """Return the path of the YAML file with this name in a folder if it exists, else the name."""
    file = folder / name
    return file if file.suffix == ".yaml" and os.path.isfile(file) else name


def needs_station(protocol: Protocol) -> bool:
    """Return whether exchanges of a protocol use the station of the other side, without a default in the protocol."""
    if protocol.station.type == "none" or protocol.station.default is not None:
        return False
    holders = [row.request for row in protocol.service_rows]
    sequences = [protocol.sequences[name] for name in protocol.exchanged if name in protocol.sequences]
    expressions = (*expressions_of(holders), *expressions_of(sequences))
    return any("station" in names_in(expression.root) for expression in expressions)


def needs_own(protocol: Protocol) -> bool:
    """Return whether requests of a protocol use the own station number and the protocol has no default for it."""
    if protocol.station.type == "none" or protocol.station.default is not None:
        return False
    requests = [row.request for row in protocol.service_rows]
    return any("own" in names_in(expression.root) for expression in expressions_of(requests))


PARAMETERS = {
    "retries": "retries",
    "timeout": "reply_timeout",
    "reply_timeout": "reply_timeout",
    "byte_timeout": "byte_timeout",
}
"""Keys that are short forms of a parameter, if the protocol has a parameter with this name."""

OCCASIONS = ("between", "connect", "station")
OF_ASKING = ("station", "stations", "merge", "answer")
"""Keys that only matter for the requests of a channel."""

_LINE_TIME = re.compile(r"\s*(\d+)(?:\.(\d+))?\s*(char|bit)s?\s*")


def line_time(reader: Reader, node: Node, line: LineFormat | None) -> int:
    """Return a time in ns, given as a time or in characters or bits of the line. Raise Broken."""
    match = _LINE_TIME.fullmatch(reader.text(node))
    if match is None:
        return reader.time(node)
    if line is None:
        raise reader.broken(node.at, "a connection has no characters or bits", "give a time such as 5 ms")
    digits, times = match[2] or "", LineTimes(line)
    count = times.chars if match[3] == "char" else times.bits
    return count(int(match[1] + digits), 10 ** len(digits))


class RulesLoader:
    """Reads rules of channels and stations; invalid rules are noted and left out."""

    def __init__(self, reader: Reader, root: Mapping) -> None:
        self.reader = reader
        self.root = root

    def _node(self, keys: Mapping, name: str) -> Node | None:
        """Return a key of the channel, or else the same key of the run."""
        node = keys.get(name)
        return self.root.get(name) if node is None else node

    # ---- silences -----------------------------------------------------------------------------------------

    def silence(self, keys: Mapping, line: LineFormat | None) -> Silence:
        """Read `silence:` (a time, or times per occasion) and `pause:`, the silence between two exchanges."""
        pause, node = keys.get("pause"), self._node(keys, "silence")
        found = {"between": 0 if pause is None else self.time(pause, line)}
        if isinstance(node, Mapping):
            found |= {name: self.time(value, line) for name in OCCASIONS if (value := node.get(name)) is not None}
        elif node is not None:
            found["between"] = self.time(node, line)
        if pause is not None and keys.get("silence") is not None:
            self.reader.note(pause.at, "pause and silence say the same", "leave pause out")
        return Silence(**found)

    def time(self, node: Node, line: LineFormat | None) -> int:
        """Return a time in ns, given as a time or in characters or bits of the line; 0 if it is invalid."""
        return self.reader.tried(lambda given: line_time(self.reader, given, line), node) or 0

    def _number(self, node: Node | None, usual: int) -> int:
        number = self.reader.tried(self.reader.number, node)
        return usual if number is None else number

    # ---- stations -----------------------------------------------------------------------------------------

    def dead(self, keys: Mapping) -> DeadRule | None:
        return self._dead(self._node(keys, "dead"))

    def _dead(self, node: Node | None) -> DeadRule | None:
        """Read `dead: no` or `dead: {failures, after, every}`; without the key return the default rule."""
        usual = DeadRule()
        if not isinstance(node, Mapping):
            return usual if node is None else None
        failures, after, every = node.get("failures"), node.get("after"), node.get("every")
        rule = DeadRule(
            failures=self._number(failures, usual.failures),
            after=usual.after if after is None else self.time(after, None),
            every=usual.every if every is None else self.time(every, None),
        )
        if failures is not None and rule.failures < 1:
            self.reader.note(failures.at, "a station cannot be dead before it failed", "give 1 or more")
        if every is not None and (rule.every or 0) < 1:
            self.reader.note(every.at, "a dead station is asked now and then", "give a time such as 60 s")
        return rule

    def stations(self, keys: Mapping, protocol: Protocol) -> dict[Any, StationRules]:
        """Read `stations: {STATION: {params, retries, timeout, dead}}`."""
        found: dict[Any, StationRules] = {}
        for entry in self.reader.entries(keys.get("stations")):
            with self.reader.going_on():
                with self.reader.refusing(entry.key.at):
                    station = parse_station(entry.key.text, protocol)
                own = self.reader.mapping(entry.value)
                dead = own.get("dead")
                found[station] = StationRules(
                    params=self.params(own, protocol), dead=self._dead(dead), own_dead=dead is not None
                )
        return found

    def params(self, keys: Mapping, protocol: Protocol) -> dict[str, Any]:
        """Return the values of `params:` and of its short keys in their YAML form, each checked."""
        found = read_params(self.reader, self.reader.entries(keys.get("params")), protocol)
        for key, name in PARAMETERS.items():
            node = keys.get(key)
            if node is None:
                continue
            with self.reader.going_on():
                parameter = protocol.params.get(name)
                if parameter is None:
                    kind = "number" if key == "retries" else "time"
                    known = ", ".join(one for one, it in protocol.params.items() if it.type == kind)
                    what = f"'{protocol.name}' has no parameter '{name}'"
                    what += "" if key == name else f", which {key} stands for"
                    raise self.reader.broken(
                        node.at, what, f"set these by params: {known}" if known else "leave it out"
                    )
                if name in found:
                    raise self.reader.broken(node.at, f"'{name}' stands in params too", "leave one of them out")
                text = self.reader.text(node)
                if parameter.type == "time":
                    read_limit(self.reader, key, node)
                with self.reader.refusing(node.at):
                    given_value(parameter, text)
                found[name] = text
        return found

    # ---- joined reads -------------------------------------------------------------------------------------

    def merge(self, keys: Mapping) -> Merge | None:
        """Read `merge: yes|no` or `merge: {gap, max}`; None (no joined reads) without the key."""
        node = self._node(keys, "merge")
        if node is None:
            return None
        if not isinstance(node, Mapping):
            return Merge() if self.reader.flag(node, default=False) else None
        gap, most = node.get("gap"), node.get("max")
        merge = Merge(gap=self._number(gap, 0), most=None if most is None else self._number(most, 1))
        if merge.gap < 0 or (merge.most is not None and merge.most < 1):
            self.reader.note(node.at, "these limits join nothing", "give a gap of 0 or more, and a max of 1 or more")
        return merge


WIRES = ("type", "duplex", "direction", "echo", "handshake")
"""Keys that only make sense for ports with wires."""

LONGEST_KEY = 1_000_000_000


class LineLoader:
    """Reads the line settings of one channel. Problems go to the reader."""

    def __init__(self, reader: Reader, keys: Mapping, port: str, line: LineFormat | None) -> None:
        self.reader = reader
        self.keys = keys
        self.port = port
        self.line = line

    def settings(self, protocol: Protocol) -> LineSettings:
        """Return the settings on a line of a protocol; an invalid setting is noted and left out."""
        self._without_wires(protocol)
        settings = self.single()
        self._together(settings)
        self._format(settings)
        return settings

    def single(self) -> LineSettings:
        """Return the settings, each checked on its own; an invalid setting is noted and left out."""
        reader, keys = self.reader, self.keys
        kind = self._word("type", get_args(Interface))
        return LineSettings(
            type=kind,  # type: ignore[arg-type]  # the schema knows them
            half_duplex=(self._word("duplex", ("half", "full")) or ("half" if kind == "rs485" else "full")) == "half",
            echo=None if (echo := keys.get("echo")) is None else reader.tried(reader.flag, echo),
            direction=reader.tried(self._direction, keys.get("direction")),
            handshake=self._word("handshake", get_args(Handshake)) or "none",  # type: ignore[arg-type]
            connect_within=reader.tried(partial(read_limit, reader, "connect_timeout"), keys.get("connect_timeout")),
            reconnect=reader.tried(partial(read_limit, reader, "reconnect"), keys.get("reconnect")),
            modem=reader.tried(lambda node: read_modem(reader, node, self.port), keys.get("modem")),
        )

    # ---- single keys --------------------------------------------------------------------------------------

    def _word(self, key: str, words: Collection[str]) -> str | None:
        """Return the word of a key if it is in `words`, else None; the schema has reported other words."""
        node = self.keys.get(key)
        text = None if node is None else self.reader.text(node)
        return text if text in words else None

    def _direction(self, node: Node) -> Direction | None:
        """Read `none`, `rts`, `driver`, or `{by, level, before, after}`. Raise Broken."""
        if not isinstance(node, Mapping):
            by = self.reader.text(node)
            return None if by == "none" else Direction(by=by)  # type: ignore[arg-type]  # the schema knows them
        times = {key: self.reader.maybe(self._short_time, node.get(key)) or 0 for key in ("before", "after")}
        level = node.get("level")
        by = self.reader.text(node.get("by"))
        high = level is None or self.reader.text(level) == "high"
        return Direction(by=by, high=high, **times)  # type: ignore[arg-type]

    def _short_time(self, node: Node) -> int:
        time = line_time(self.reader, node, self.line)
        if time > LONGEST_KEY:
            text = self.reader.text(node).strip()
            raise self.reader.broken(node.at, f"{text} is too long to hold a line", "give 1 s or less")
        return time

    # ---- conflicts between settings -------------------------------------------------------------------------

    def _note(self, key: str, what: str, todo: str) -> None:
        node = self.keys.get(key)
        self.reader.note(self.keys.at if node is None else node.at, what, todo)

    def _without_wires(self, protocol: Protocol) -> None:
        stream = protocol.line.kind == "stream" and not self.port.startswith("sim:")
        kind = scheme_of(self.port)
        if not stream and (kind is None or kind.wires):
            return
        for key in WIRES:
            if self.keys.get(key) is not None:
                self._note(key, f"'{key}' is about wires, and '{self.port}' has none", "leave it out")

    def _together(self, settings: LineSettings) -> None:
        kind = settings.type
        if kind in ("rs232", "rs422") and settings.half_duplex:
            self._note(
                "duplex", f"{kind} has a pair of wires for each direction", "leave duplex out, or use type: rs485"
            )
        if kind == "rs232" and settings.direction is not None:
            self._note("direction", "an RS-232 port has no transmitter to switch", "leave it out, or use type: rs485")
        if kind in ("rs232", "rs422") and settings.echo:
            self._note("echo", f"{kind} ports do not hear themselves", "leave it out, or use type: rs485")
        if settings.direction is not None and settings.direction.by == "rts" and settings.handshake == "rtscts":
            self._note("handshake", "RTS switches the direction here", "use handshake: none, or direction: driver")
        if kind in ("rs422", "rs485") and settings.handshake == "rtscts":
            self._note("handshake", f"{kind} has no RTS and CTS wires", "leave it out")
        if settings.modem is not None and kind in ("rs422", "rs485"):
            self._note("modem", f"a modem is on an RS-232 port, not on {kind}", "leave it out, or use type: rs232")
        if settings.modem is not None and self.port.startswith("sim:"):
            self._note("modem", "a simulated line has no modem", "leave it out")

    def _format(self, settings: LineSettings) -> None:
        """Note speeds and formats that the interface does not have (Snet module guide, Table 14, and faster speeds)."""
        line = self.line
        if settings.type is None or line is None:
            return
        known = SPEEDS if settings.type == "rs232" else SPEEDS + FAST
        if line.speed not in known:
            near = ", ".join(map(str, sorted(sorted(known, key=lambda speed: abs(speed - line.speed))[:3])))
            self._note("speed", f"{settings.type} ports have no speed of {line.speed}", f"the nearest are {near}")
        if line.data_bits not in (7, 8, 9) or line.parity not in "NEO" or line.stop_bits not in (1, 2):
            what = f"{settings.type} ports have no format {line.data_bits}{line.parity}{line.stop_bits:g}"
            self._note("format", what, "7 or 8 data bits, parity N, E or O, 1 or 2 stop bits")


def read_station(reader: Reader, node: Node, protocol: Protocol) -> Any:
    """Return the number, text or bytes that identify a station of a protocol. Raise Broken."""
    with reader.refusing(node.at):
        return parse_station(reader.text(node), protocol)


def line_of(protocol: Protocol, speed: int | None, format: str | None) -> LineFormat | None:
    """Return the speed and format of a line, by default those of the protocol; None for connections.

    Raise ValueError.
    """
    line = protocol.line
    if line.kind == "stream":
        if speed is not None or format is not None:
            raise ValueError(f"'{protocol.name}' runs on connections, which have neither speed nor format")
        return None
    return parse_format(line.format if format is None else format, line.speed if speed is None else speed)


def parse_station(text: str, protocol: Protocol) -> Any:
    """Return the station that a text identifies.

    Raise ValueError with a full message if the protocol cannot have it.
    """
    station = protocol.station
    if station.type == "none":
        raise ValueError(f"'{protocol.name}' has no stations – leave the station out")
    if station.type == "number":
        try:
            number = parse_number(text)
        except ValueError as error:
            raise ValueError(f"station {error}") from None
        if station.limits is not None and not station.limits[0] <= number <= station.limits[1]:
            raise ValueError(f"station {number} is not in {station.limits[0]}..{station.limits[1]}")
        return number
    if station.type == "bytes":
        filled = _filled(text, station)
        try:
            data = parse_bytes(text) if filled is None else filled
        except ValueError:
            if station.pad is None or station.size is None:
                raise
            what = f"station '{text}' has {plural(len(text), 'character')}, at most {station.size} are possible"
            raise ValueError(f"{what} – or write {plural(station.size, 'byte')} in hex") from None
        if station.size is not None and len(data) != station.size:
            raise ValueError(f"station {text} has {plural(len(data), 'byte')}, it needs {station.size}")
        return data
    if station.size is not None and len(text) > station.size:
        raise ValueError(f"station '{text}' has {len(text)} characters, at most {station.size} are possible")
    return text


def _filled(text: str, station: StationType) -> bytes | None:
    """Return the padded bytes of a station given as text, or None if the text can only be hex pairs."""
    if station.pad is None or station.size is None or len(text) > station.size or not text.isascii():
        return None
    return text.encode("ascii").ljust(station.size, bytes((station.pad,)))


def read_mapping(
    reader: Reader, node: Node | None, protocol: Protocol, grammar: AddressGrammar
) -> dict[str, tuple[str, int]]:
    """Read `map: {AREA: ADDRESS}`, the start of areas of a protocol in a memory.

    Invalid entries are noted and left out.
    """
    found: dict[str, tuple[str, int]] = {}
    for entry in reader.entries(node):
        with reader.going_on():
            area = protocol.areas.get(entry.key.text)
            if area is None or area.layout is not None:
                what = f"'{protocol.name}' has no area '{entry.key.text}'"
                if area is not None:
                    what = f"area '{area.name}' is built from what the protocol knows, it stands in no memory"
                raise reader.broken(entry.key.at, what, did_you_mean(entry.key.text, protocol.areas))
            text = reader.text(entry.value)
            with reader.refusing(entry.value.at):
                address = grammar.parse(text)
            if address.first_bit % area.element_bits:
                what = f"{text} is not where a {area.unit} of area '{area.name}' can begin"
                raise reader.broken(entry.value.at, what, f"name a {area.unit}")
            found[area.name] = address.area, address.first_bit // area.element_bits
    return found


def read_params(reader: Reader, entries: Iterable[Entry], protocol: Protocol) -> dict[str, Any]:
    """Return parameters in their YAML form, each checked; invalid parameters are noted and left out."""
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
            with reader.refusing(entry.value.at):
                given_value(parameter, value)
            found[name] = value
    return found


def _items_fit(reader: Reader, node: Sequence, parameter: Parameter) -> bool:
    """Return whether every item has the item type of the list; each invalid item is noted at its position."""
    fits = True
    for item in node.items:
        try:
            given_item(parameter, reader.text(item))
        except ParameterError as error:
            reader.note(item.at, *parted(error))
            fits = False
    return fits


def raw_value(reader: Reader, node: Node) -> Any:
    """Return a value in its YAML form: a text, or a list of texts."""
    return [reader.text(item) for item in node.items] if isinstance(node, Sequence) else reader.text(node)
