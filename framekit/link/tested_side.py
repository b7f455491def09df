"""Begins what the tested side of a conversation is to do: reads, writes, other services, or frames by themselves.

Which memory stands behind it is not known here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.codec.plain import PlainValues
from framekit.definition.load.reader import parse_number
from framekit.definition.model.protocol import Protocol
from framekit.link.conversation import Asked, station_of
from framekit.link.engine import Engine
from framekit.link.events import Command
from framekit.link.exchange import Exchange, Outcome
from framekit.link.frame_table import ProtocolCodec
from framekit.link.services.client import Client, TransferResult


class Starter:
    """Begins what a case asks for: `read`, `write`, another service, or `send: {FRAME: {…}}` for a frame by itself."""

    def __init__(self, protocol: Protocol, codec: ProtocolCodec) -> None:
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
                return client.read_variables(address, station=station, unit=unit, now=now, on_done=on_done).commands
            return client.read(address, station=station, unit=unit, count=count, now=now, on_done=on_done).commands
        if "write" in given:
            return self._write(client, given["write"], given.get("values"), station, unit, now, on_done)
        ((service, arguments),) = given.items()
        plain = dict(arguments) if isinstance(arguments, Mapping) else {}
        addresses = plain.pop("addresses", [])
        return client.call(
            service, plain, station=station, unit=unit, count=count, now=now, on_done=on_done,
            addresses=addresses if isinstance(addresses, list) else [addresses],
        ).commands  # fmt: skip

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
            return client.write_variables(where, numbers, station=station, unit=unit, now=now, on_done=on_done).commands
        return client.write(where, numbers, station=station, unit=unit, now=now, on_done=on_done).commands

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
