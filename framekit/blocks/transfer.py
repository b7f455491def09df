"""What a block does on its channel: memory into requests, replies into memory.

A reply that did not end well stores nothing. The channel's client and engine do the exchange; this module only knows
which places of the own memory belong to it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from framekit.blocks.model import Block, Place
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import Data, Field
from framekit.link.client import Client, TransferResult
from framekit.link.engine import Engine
from framekit.link.events import Command
from framekit.link.values import FrameValue
from framekit.memory.errors import DeviceMemoryError
from framekit.memory.memory import DeviceMemory
from framekit.memory.numbers import unit_bits

Ended = Callable[[bool, str], None]
"""Told once how a block's exchange ended: well or not, and the outcome in a word ('' when all is well)."""


class BlockTransfers:
    """Starts the exchanges of the blocks of one channel."""

    def __init__(self, engine: Engine, client: Client | None, memory: DeviceMemory, frames: dict[str, Frame]) -> None:
        self.engine = engine
        self.client = client
        self.memory = memory
        self.frames = frames
        self._sending: list[Ended] = []

    def closed(self, reason: str) -> None:
        """The connection is gone: frames that have not left yet never will."""
        sending, self._sending = self._sending, []
        for ended in sending:
            ended(False, reason)

    def start(self, block: Block, now: int, ended: Ended) -> list[Command]:
        """Begins the exchange of a block; `ended` is called exactly once, perhaps before this returns."""
        try:
            return self._start(block, now, ended)
        except (DeviceMemoryError, ValueError) as error:
            ended(False, str(error))
            return []

    def _start(self, block: Block, now: int, ended: Ended) -> list[Command]:
        station = self.station_of(block)
        if block.instruction == "send":
            assert block.frame is not None
            commands = self.engine.send_frame(block.frame, now, self.fields_of(block), self._sent)
            self._sending.append(ended)
            return commands
        assert self.client is not None
        done = self._finisher(block, ended)
        if block.instruction == "read":
            if len(block.targets) > 1:
                return self.client.read_variables(
                    block.targets, station=station, unit=block.unit, now=now, on_done=done
                )
            return self.client.read(
                block.targets[0], station=station, unit=block.unit, count=block.count, now=now, on_done=done
            )
        if block.instruction == "write":
            return self._write(block, station, now, done)
        assert block.service is not None
        return self.client.call(block.service, dict(block.arguments), station=station, now=now, on_done=done)

    def _sent(self) -> None:
        """The oldest frame that was to be sent by itself has left."""
        if self._sending:
            self._sending.pop(0)(True, "")

    def _write(self, block: Block, station: Any, now: int, done: Callable[[TransferResult], None]) -> list[Command]:
        assert self.client is not None
        if len(block.targets) > 1:
            values = list(block.values or (self.elements(place, block.unit, 1)[0] for place in block.places))
            return self.client.write_variables(
                block.targets, values, station=station, unit=block.unit, now=now, on_done=done
            )
        values = list(block.values or self.elements(block.places[0], block.unit, block.count))
        return self.client.write(block.targets[0], values, station=station, unit=block.unit, now=now, on_done=done)

    def station_of(self, block: Block) -> Any:
        """The other side's station: fixed, or from the word that holds it now."""
        return block.station if block.station_from is None else self.elements(block.station_from, None, 1)[0]

    # ---- own memory ---------------------------------------------------------------------------------------

    def elements(self, place: Place, unit: str | None, count: int) -> list[int]:
        """`count` elements of `unit` (default: the address's own) from a place on."""
        address = place.address
        wanted = unit or address.unit
        start = address.first_bit // unit_bits(wanted)
        return self.memory.read(address.area, wanted, start, count)

    def _finisher(self, block: Block, ended: Ended) -> Callable[[TransferResult], None]:
        def done(result: TransferResult) -> None:
            if result.ok and block.instruction == "read":
                try:
                    self._store(block, result.values)
                except (DeviceMemoryError, ValueError) as error:
                    ended(False, str(error))
                    return
            ended(result.ok, result.outcome)

        return done

    def _store(self, block: Block, values: list[int]) -> None:
        if len(block.targets) > 1:
            for place, value in zip(block.places, values, strict=True):
                self._put(place, block.unit, [value])
        elif block.places:
            self._put(block.places[0], block.unit, values)

    def _put(self, place: Place, unit: str | None, values: list[int]) -> None:
        address = place.address
        wanted = unit or address.unit
        start = address.first_bit // unit_bits(wanted)
        self.memory.write(address.area, wanted, start, values)

    # ---- SEND and RECEIVE ---------------------------------------------------------------------------------

    def fields_of(self, block: Block) -> dict[str, Any]:
        """The fields of a SEND block's frame: constants of the block, and data from the own memory."""
        assert block.frame is not None
        fields: dict[str, Any] = dict(block.values or {})
        segments = {part.name: part for part in self.frames[block.frame].segments if part.name}
        for name, place in block.data.items():
            segment = segments.get(name)
            if isinstance(segment, Data):
                size = block.sizes.get(name) or segment.size
                if not isinstance(size, int):
                    raise ValueError(f"the size of '{name}' is not known – give the block size: {{{name}: N}}")
                fields[name] = self.memory.read_bytes(place.address.area, place.address.first_bit // 8, size)
            elif isinstance(segment, Field):
                fields[name] = self.elements(place, None, 1)[0]
        return fields

    def store_frame(self, block: Block, frame: FrameValue) -> None:
        """Puts the fields of a received frame where the block says. Raises DeviceMemoryError, ValueError."""
        for name, place in block.data.items():
            value = frame.fields.get(name)
            if isinstance(value, (bytes, bytearray)):
                self.memory.write_bytes(place.address.area, place.address.first_bit // 8, bytes(value))
            elif isinstance(value, int):
                self._put(place, None, [value])
