"""Search for devices: one harmless request to each station, at each speed and format, on each host.

The request is the `probe:` of the definition; without one it is the read of the first readable address. A scan never
writes.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterable, Sequence
from dataclasses import dataclass
from ipaddress import ip_network
from typing import Any

from framekit.api.client import OPEN_WITHIN, AsyncClient
from framekit.api.errors import ExchangeError, LineClosedError, NoReplyError, ReplyError, RequestError
from framekit.api.settings import ClientSettings, ProtocolGiven, checked_station, grammar_of, line_settings, protocol_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import Probe
from framekit.definition.problems import Problem, parted
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.link.events import Seen

HOST = "{host}"
"""The place of the host in the port of a scan of several hosts."""
USUAL_STATIONS = (1, 32)
"""First and last station of a scan that names none."""
MOST_STATIONS = 1 << 16
MOST_HOSTS = 1 << 12
AT_ONCE = 16
"""Hosts that are asked at the same time."""
HOST_WITHIN = 3.0
"""Time limit for the connection to each of several hosts (s)."""


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """A device that has answered."""

    port: str
    station: Any
    """None if the protocol has no stations."""
    line: str
    """Speed and format, such as `9600 8E1`; empty for connections."""
    answer: str
    """`answers`, `refuses` (the reply is an error), or `damaged` (something answers, with a wrong reply)."""
    detail: str
    """The reason, if the answer is not good."""
    seconds: float
    """Duration of the exchange."""


@dataclass(frozen=True, slots=True)
class _ScannedLine:
    """A port with the settings of its line."""

    settings: ClientSettings
    line: str


class _Heard:
    """Count of frames and noise that have come from the line."""

    def __init__(self) -> None:
        self.count = 0

    def take(self, seen: Seen) -> None:
        """Count an event of the line."""
        self.count += seen.direction == "in" and seen.kind in ("frame", "bad", "noise")


class Scan:
    """A search for devices. Its arguments are checked before a port is opened.

    `stations`: their numbers or names; default: 1 to 32, as far as the protocol has them. `speeds`, `formats`: of a
    serial line; default: those of the protocol. `hosts`: names, addresses or networks for `{host}` in the port.
    `timeout`: the time limit for each reply, such as `100 ms`. Raises DefinitionError, RequestError.
    """

    def __init__(
        self, protocol: ProtocolGiven, port: str, *, stations: Iterable[Any] | None = None, speeds: Sequence[int] = (),
        formats: Sequence[str] = (), hosts: Sequence[str] = (), timeout: str | None = None, role: str | None = None,
        own: Any = None, params: dict[str, Any] | None = None,
    ) -> None:  # fmt: skip
        self.protocol = found = protocol_of(protocol)
        given = dict(params or {})
        if "retries" in found.params:
            given.setdefault("retries", "0")
        if timeout is not None:
            if "reply_timeout" not in found.params:
                raise RequestError(f"'{found.name}' has no parameter 'reply_timeout' – leave the time limit out")
            given["reply_timeout"] = timeout
        ports = _ports(port, hosts)
        self._of_hosts = bool(hosts)
        self._places: list[_ScannedLine] = []
        for one in ports:
            for speed in speeds or (None,):
                for form in formats or (None,):
                    settings = line_settings(found, one, role=role, speed=speed, format=form, own=own, params=given)
                    settings.check_own()
                    self._places.append(_ScannedLine(settings, "" if settings.line is None else str(settings.line)))
        self.stations = _stations(found, stations)
        self.probe = probe_of(found)
        self.total = len(self._places) * len(self.stations)
        """Number of requests, if all hosts can be reached."""
        self.done = 0
        """Requests that are over."""
        self.unreachable: list[str] = []
        """Hosts without a connection, with the reasons."""

    async def devices(self) -> AsyncIterator[FoundDevice]:
        """Send the requests and yield the devices as they answer.

        Raises LineClosedError if the port, or no host, can be opened; RequestError if the probe does not fit.
        """
        if not self._of_hosts:
            for place in self._places:
                async for device in self._on(place, OPEN_WITHIN):
                    yield device
            return
        found: asyncio.Queue[FoundDevice | None] = asyncio.Queue()
        limit = asyncio.Semaphore(AT_ONCE)

        async def ask(place: _ScannedLine) -> None:
            async with limit:
                try:
                    async for device in self._on(place, HOST_WITHIN):
                        found.put_nowait(device)
                except LineClosedError as error:
                    self.done += len(self.stations)
                    self.unreachable.append(f"{place.settings.port}: {error.cause or error}")

        async def ask_all() -> None:
            try:
                async with asyncio.TaskGroup() as tasks:
                    for place in self._places:
                        tasks.create_task(ask(place))
            finally:
                found.put_nowait(None)

        asking = asyncio.ensure_future(ask_all())
        try:
            while (next_device := await found.get()) is not None:
                yield next_device
        finally:
            asking.cancel()
            try:
                await asking
            except asyncio.CancelledError:
                pass
            except BaseExceptionGroup as errors:
                raise errors.exceptions[0] from None

    async def _on(self, place: _ScannedLine, within: float) -> AsyncIterator[FoundDevice]:
        """Yield the devices of one port with one setting of the line."""
        heard = _Heard()
        async with AsyncClient(place.settings, open_within=within, monitor=heard.take) as client:
            for station in self.stations:
                began = time.monotonic()
                heard.count = 0
                answer, detail = await self._asked(client, station, heard)
                self.done += 1
                if answer:
                    seconds = time.monotonic() - began
                    yield FoundDevice(place.settings.port, station, place.line, answer, detail, seconds)

    async def _asked(self, client: AsyncClient, station: Any, heard: _Heard) -> tuple[str, str]:
        """Send the probe to a station; return the kind of its answer, '' for none, and the reason. Raises
        LineClosedError, RequestError.
        """
        try:
            if self.probe.read is not None:
                await client.read(self.probe.read, station=station)
            else:
                assert self.probe.call is not None
                await client.call(self.probe.call, self.probe.arguments, station=station)
        except LineClosedError:
            raise
        except NoReplyError:
            return "", ""
        except ReplyError as error:
            return "damaged", error.cause or str(error)
        except ExchangeError as error:
            return ("refuses", str(error)) if heard.count else ("", "")  # protocols name their own time-outs
        return "answers", ""


def _ports(port: str, hosts: Sequence[str]) -> list[str]:
    """Return the port of each host. Raises RequestError."""
    if not hosts:
        if HOST in port:
            raise RequestError(f"'{port}' has {HOST}, and no hosts are given – name them, such as 10.0.0.0/28")
        return [port]
    if HOST not in port:
        raise RequestError(f"'{port}' has no place for the hosts – write {HOST} there, such as tcp://{HOST}:502")
    names: list[str] = []
    for text in hosts:
        try:
            network = ip_network(text, strict=False)
        except ValueError:
            if "/" in text or not text:
                raise RequestError(f"'{text}' is no network and no host – write it like 10.0.0.0/28") from None
            names.append(text)
            continue
        if network.num_addresses > MOST_HOSTS:
            count = f"{network.num_addresses:,}"
            raise RequestError(f"{text} has {count} addresses – give a network of at most {MOST_HOSTS:,}")
        names += [f"[{host}]" if network.version == 6 else str(host) for host in network.hosts()]
    return [port.replace(HOST, name) for name in dict.fromkeys(names)]


def _stations(protocol: Protocol, given: Iterable[Any] | None) -> list[Any]:
    """Return the stations of a scan; [None] if the protocol has none, or its stations have names. Raises
    RequestError.
    """
    kind = protocol.station
    if given is not None:
        if kind.type == "none":
            raise RequestError(f"'{protocol.name}' has no stations")
        return [checked_station(protocol, station) for station in given]
    if kind.type != "number":
        return [None]
    low, high = kind.limits or USUAL_STATIONS
    first, last = USUAL_STATIONS
    return list(range(max(low, first), min(high, last) + 1))


def stations_of(text: str) -> list[str]:
    """Return the stations of a text such as `1..32`, `1,2,5..9` or names. Raises RequestError."""
    found: list[str] = []
    for part in (part.strip() for part in text.split(",")):
        first, dots, last = part.partition("..")
        if not part:
            raise RequestError(f"'{text}' names no stations – write them like 1..32 or 1,2,5")
        if not dots:
            found.append(part)
        elif first.isdecimal() and last.isdecimal() and len(first) < 9 > len(last) and int(first) <= int(last):
            if int(last) - int(first) >= MOST_STATIONS:
                raise RequestError(f"'{part}' has more than {MOST_STATIONS:,} stations")
            found += map(str, range(int(first), int(last) + 1))
        else:
            raise RequestError(f"'{part}' is no range of stations – write it like 1..32")
    return list(dict.fromkeys(found))


def probe_of(protocol: Protocol) -> Probe:
    """Return the request that finds devices: `probe:`, or a read of the first readable address. Raises RequestError."""
    if protocol.probe is not None:
        for problem in check_probe(protocol):
            raise RequestError(str(problem))
        return protocol.probe
    grammar = grammar_of(protocol)
    if "read" in protocol.services:
        for area in protocol.areas.values():
            if (text := _first_address(grammar, area.name, area.unit)) is not None:
                return Probe(at=area.at, read=text)
    raise RequestError(f"'{protocol.name}' has no harmless request to find devices – name one with probe:")


def check_probe(protocol: Protocol) -> list[Problem]:
    """Return the problem of a probe that reads an unknown address."""
    probe = protocol.probe
    if probe is None or probe.read is None or "read" not in protocol.services:
        return []
    try:
        grammar_of(protocol).parse(probe.read)
    except AddressError as error:
        return [Problem(probe.at, *parted(error))]
    return []


def _first_address(grammar: AddressGrammar, area: str, unit: str) -> str | None:
    """Return the first address of an area as text, or None if no form can name it."""
    try:
        text = grammar.print(Address(area, unit, 0, "", {}))
        grammar.parse(text)
    except AddressError:
        return None
    return text


async def ascan(protocol: ProtocolGiven, port: str, **options: Any) -> list[FoundDevice]:
    """Return all devices that answer; `options` as of `Scan`. Raises as `Scan` and `Scan.devices` do."""
    return [device async for device in Scan(protocol, port, **options).devices()]


def scan(protocol: ProtocolGiven, port: str, **options: Any) -> list[FoundDevice]:
    """Return all devices that answer, as `ascan` does, for programs without asyncio."""
    return asyncio.run(ascan(protocol, port, **options))
