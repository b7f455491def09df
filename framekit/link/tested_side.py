"""The tested side of a conversation as definitions have it: a client for what is to be done, a server on a memory.

The memory has the areas of the protocol; a case gives start values and reads them back by the protocol's addresses.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.codec.plain import PlainValues
from framekit.definition.load.scalars import parse_number
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.vectors import Conversation
from framekit.link.addresses import AddressGrammar
from framekit.link.client import Client
from framekit.link.conversation import Asked, SideUnderTest, station_of
from framekit.link.engine import Engine
from framekit.link.events import Command
from framekit.link.exchange import Exchange, Outcome
from framekit.link.frame_table import Codec
from framekit.link.serving import MemoryServer
from framekit.link.transfer import TransferResult
from framekit.memory.area import Area
from framekit.memory.memory import DeviceMemory


def make_tested_side(case: Conversation, protocol: Protocol, codec: Codec) -> SideUnderTest:
    """Client, server and memory of a protocol. Raises ValueError for a case that cannot be set up."""
    memory = ConversationMemory(protocol)
    for address, values in case.memory.items():
        memory.put(address, [parse_number(item) for item in (values if isinstance(values, list) else [values])])
    return SideUnderTest(
        server=MemoryServer(protocol, codec, memory.device) if protocol.services else None,
        memory=memory,
        ask=lambda engine: Client(protocol, codec, engine).ask,
        start=Starter(protocol, codec).start,
        read_memory=memory.values,
    )


class ConversationMemory:
    """A device memory, by the addresses of the protocol. Every method raises ValueError for what is not there."""

    def __init__(self, protocol: Protocol) -> None:
        sizes: dict[str, tuple[str, int]] = {}
        for area in protocol.areas.values():
            if area.layout is None:
                sizes.setdefault(area.memory, (area.unit, area.size))
        self.device = DeviceMemory(Area(name, size=size, unit=unit) for name, (unit, size) in sizes.items())
        self.grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
        self._names = {name: area.memory for name, area in protocol.areas.items()}

    def put(self, address: str, values: list[int]) -> None:
        place = self.grammar.parse(address)
        self.device.write(self._names[place.area], place.unit, place.start, values, force=True)

    def values(self, address: str, count: int) -> list[int]:
        place = self.grammar.parse(address)
        return self.device.read(self._names[place.area], place.unit, place.start, count)

    def read(self, address: str, size: int) -> bytes:
        place = self.grammar.parse(address)
        return self.device.read_bytes(self._names[place.area], place.first_bit // 8, size)

    def write(self, address: str, data: bytes) -> None:
        place = self.grammar.parse(address)
        self.device.write_bytes(self._names[place.area], place.first_bit // 8, data, force=True)


class Starter:
    """Begins what a case asks for: `read`, `write`, another service, or `send: {FRAME: {…}}` for a frame by itself."""

    def __init__(self, protocol: Protocol, codec: Codec) -> None:
        self.protocol = protocol
        self.codec = codec

    def start(self, engine: Engine, do: Mapping[str, Any], station: Any, now: int, on_done: Asked) -> list[Command]:
        """Raises ValueError for what cannot be asked for at all."""
        given = dict(do)
        unit, count = given.pop("unit", None), parse_number(given.pop("count", "1"))
        if "station" in given:
            station = station_of(self.protocol, given.pop("station"))
        if "send" in given:
            return self._send(engine, given["send"], now, on_done)
        if "exchange" in given:
            return self._exchange(engine, given, station, now, on_done)
        client = Client(self.protocol, self.codec, engine)
        if "read" in given:
            address = given["read"]
            if isinstance(address, list):
                return client.read_variables(address, station=station, unit=unit, now=now, on_done=on_done)
            return client.read(address, station=station, unit=unit, count=count, now=now, on_done=on_done)
        if "write" in given:
            return self._write(client, given["write"], given.get("values"), station, unit, now, on_done)
        ((service, arguments),) = given.items()
        plain = dict(arguments) if isinstance(arguments, Mapping) else {}
        addresses = plain.pop("addresses", [])
        return client.call(
            service, plain, station=station, unit=unit, count=count, now=now, on_done=on_done,
            addresses=addresses if isinstance(addresses, list) else [addresses],
        )  # fmt: skip

    def _write(
        self, client: Client, where: Any, values: Any, station: Any, unit: str | None, now: int, on_done: Asked
    ) -> list[Command]:
        """`write: ADDRESS, values: [...]` for consecutive places, `write: [ADDRESSES], values: [...]` for one each."""
        if isinstance(where, Mapping):
            where, values = list(where), list(where.values())
            if len(where) == 1:
                where, values = where[0], values[0]
        if values is None:
            raise ValueError("write needs values: write: ADDRESS, values: [...]")
        numbers = [parse_number(item) for item in (values if isinstance(values, list) else [values])]
        if isinstance(where, list):
            return client.write_variables(where, numbers, station=station, unit=unit, now=now, on_done=on_done)
        return client.write(where, numbers, station=station, unit=unit, now=now, on_done=on_done)

    def _send(self, engine: Engine, what: Any, now: int, on_done: Asked) -> list[Command]:
        """A frame by itself; done when it has left."""
        ((frame, fields),) = what.items()
        values = PlainValues(self.protocol).from_plain(frame, fields or {})
        return engine.send_frame(frame, now, values, on_sent=lambda: on_done(TransferResult(True)))

    def _exchange(
        self, engine: Engine, given: Mapping[str, Any], station: Any, now: int, on_done: Asked
    ) -> list[Command]:
        """`exchange: {FRAME: {…}}` with `expected: [FRAMES]` and `run: SEQUENCE`: the procedure without a service."""
        ((frame, fields),) = given["exchange"].items()
        values = PlainValues(self.protocol).from_plain(frame, fields or {})
        expected = given.get("expected", [])

        def ended(outcome: Outcome) -> None:
            on_done(TransferResult(outcome.ok, outcome=outcome.outcome, cause=outcome.cause, raw=outcome.raw))

        exchange = Exchange(
            run=given.get("run"),
            station=station,
            request=engine.machine.table.made(frame, values, engine.scope),
            expected=tuple(expected if isinstance(expected, list) else [expected]),
            on_done=ended,
        )
        return engine.start(exchange, now)
