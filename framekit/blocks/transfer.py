"""What a block does on its channel: memory into requests, replies into memory.

A reply that did not end well stores nothing. The channel's client and engine do the exchange; this module only knows
which places of the own memory belong to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

from framekit.blocks.block_status import Failure, failure_of
from framekit.blocks.command_transfers import CommandTransfers, Later
from framekit.blocks.fields import FramePart, parts_of, to_memory
from framekit.blocks.frame_fields import FrameFields
from framekit.blocks.merging import Read, joined
from framekit.blocks.model import Block
from framekit.blocks.operations import ParamsOf
from framekit.blocks.own_memory import Piece, read_piece, store_pieces
from framekit.blocks.results import arguments_of_call, result_pieces
from framekit.codec.shown import explain
from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import StationType
from framekit.link.addresses import AddressError
from framekit.link.engine import Engine
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.events import Command
from framekit.link.frame_sender import FrameSender
from framekit.link.packing import cut_memory, values_of
from framekit.link.services.client import Client, TransferResult
from framekit.link.values import FrameValue
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, unit_bits

Ended = Callable[[Failure | None], None]
"""Told once how a block's exchange ended; None when all is well."""


class BlockTransfers:
    """Starts the exchanges of the blocks of one channel."""

    def __init__(
        self,
        engine: Engine,
        client: Client | None,
        memory: DeviceMemory,
        frames: Mapping[str, Frame],
        station: StationType,
        mapping: Mapping[str, tuple[str, int]] | None = None,
        later: Later | None = None,
        params_of: ParamsOf | None = None,
    ) -> None:
        self.engine = engine
        self.client = client
        self.memory = memory
        self.frames = frames
        self.station = station
        self.commands = CommandTransfers(engine, client, memory, mapping or {}, later, params_of)
        self._parts: dict[str, dict[str, FramePart]] = {}
        self._fields: dict[int, FrameFields] = {}
        self._senders: dict[str, FrameSender] = {}
        self._sending: list[Ended] = []

    def closed(self, reason: str) -> None:
        """The connection is gone: frames that have not left yet never will."""
        sending, self._sending = self._sending, []
        for ended in sending:
            ended(Failure(outcome="closed", cause=reason))

    def forget(self, block: Block) -> None:
        """A block is no more: what was prepared for it is not kept."""
        self._fields.pop(block.id, None)

    def start(self, block: Block, now: int, ended: Ended) -> list[Command]:
        """Begins the exchange of a block; `ended` is called exactly once, perhaps before this returns."""
        try:
            return self._start(block, now, ended)
        except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
            ended(Failure(outcome="cannot_send", cause=explain(error)))
            return []

    def _start(self, block: Block, now: int, ended: Ended) -> list[Command]:
        if block.instruction == "send":
            return self._send(block, now, ended)
        if block.instruction == "command":
            return self.commands.start(block, self.station_of(block), now, ended)
        assert self.client is not None
        station, done = self.station_of(block), self._finisher(block, ended)
        if block.instruction == "read":
            if len(block.targets) > 1:
                return self.client.read_variables(
                    block.targets, station=station, unit=block.unit, now=now, on_done=done
                )
            return self.client.read(
                block.targets[0], station=station, unit=block.unit, count=block.count, now=now, on_done=done
            )
        if block.instruction == "write":
            values = self.values_of(block)
            if len(block.targets) > 1:
                return self.client.write_variables(
                    block.targets, values, station=station, unit=block.unit, now=now, on_done=done
                )
            return self.client.write(block.targets[0], values, station=station, unit=block.unit, now=now, on_done=done)
        assert block.service is not None
        given = arguments_of_call(block, self.memory)
        return self.client.call(
            block.service, given, station=station, addresses=block.addresses, unit=block.unit, count=block.count,
            now=now, on_done=done,
        )  # fmt: skip

    def start_joined(self, reads: Sequence[Read[tuple[Block, Ended]]], now: int) -> list[Command]:
        """One read for several blocks of one station; each gets its own part, and its own end."""
        assert self.client is not None
        address, count = joined(reads)

        def done(result: TransferResult) -> None:
            bits = address.unit_bits
            for read in reads:
                block, ended = read.key
                part = result
                if result.ok:
                    data = cut_memory(result.data, (read.address.start - address.start) * bits, read.count * bits)
                    part = TransferResult(True, data=data)
                self._finisher(block, ended)(part)

        try:
            station = self.station_of(reads[0].key[0])
            return self.client.read(address, station=station, count=count, now=now, on_done=done)
        except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
            for read in reads:
                read.key[1](Failure(outcome="cannot_send", cause=explain(error)))
            return []

    def read_of(self, block: Block, ended: Ended) -> Read[tuple[Block, Ended]] | None:
        """What a READ block with one place reads, as others may join it; None for every other block."""
        if block.instruction != "read" or len(block.targets) != 1 or not block.merge or self.client is None:
            return None
        try:
            address = self.client.grammar.parse(block.targets[0], block.unit)
        except AddressError:
            return None
        return Read((block, ended), address, block.count)

    def station_of(self, block: Block) -> Any:
        """The other side's station: fixed, or from the own memory as it is now. Raises ValueError."""
        place = block.station_from
        if place is None:
            return block.station
        if self.station.type == "bytes":
            return read_piece(self.memory, place, 8 * (self.station.size or 1))
        number = values_of(read_piece(self.memory, place, place.address.unit_bits), place.address.unit, 1)[0]
        limits = self.station.limits
        if limits is not None and not limits[0] <= number <= limits[1]:
            raise ValueError(f"station {number} in {place.text} is not in {limits[0]}..{limits[1]}")
        return number

    # ---- READ and WRITE -----------------------------------------------------------------------------------

    def values_of(self, block: Block) -> list[int]:
        """What a WRITE block writes now: its constants, or elements from its places."""
        if block.values is not None:
            return list(block.values)
        if len(block.targets) > 1:
            pairs = zip(block.places, block.units, strict=True)
            return [values_of(read_piece(self.memory, place, unit_bits(unit)), unit, 1)[0] for place, unit in pairs]
        unit = block.units[0]
        return values_of(read_piece(self.memory, block.places[0], block.count * unit_bits(unit)), unit, block.count)

    def _finisher(self, block: Block, ended: Ended) -> Callable[[TransferResult], None]:
        def done(result: TransferResult) -> None:
            if result.ok and (block.instruction == "read" or block.results):
                try:
                    pieces = list(result_pieces(block, result)) if block.results else self.pieces_of(block, result.data)
                    store_pieces(self.memory, pieces)
                except (DeviceMemoryError, ValueError) as error:
                    ended(Failure(outcome="cannot_store", cause=str(error)))
                    return
            ended(failure_of(result))

        return done

    def pieces_of(self, block: Block, data: bytes) -> list[Piece]:
        """What a READ block has read, in memory's form, at its places."""
        if len(block.targets) == 1:
            return [(block.places[0], block.count * unit_bits(block.units[0]), data)]
        starts = [0]
        for unit in block.units:
            starts.append(starts[-1] + unit_bits(unit))
        spans = zip(block.places, pairwise(starts), strict=True)
        return [(place, end - start, cut_memory(data, start, end - start)) for place, (start, end) in spans]

    # ---- SEND and RECEIVE ---------------------------------------------------------------------------------

    def _send(self, block: Block, now: int, ended: Ended) -> list[Command]:
        assert block.frame is not None

        fields = self.fields_of(block)
        commands = self._sender_of(block.frame).send(fields, now, partial(self.has_sent, ended))
        self._sending.append(ended)
        return commands

    def prepared_frame(self, block: Block) -> tuple[FrameSender, FrameFields]:
        """What sends the frame of a SEND block, and what reads its fields. Raises as `fields_of`."""
        assert block.frame is not None
        return self._sender_of(block.frame), self._reader_of(block)

    def is_sending(self, ended: Ended) -> None:
        """Somebody sends a block's frame by what is prepared; `has_sent` follows unless the connection is lost."""
        self._sending.append(ended)

    def _sender_of(self, frame: str) -> FrameSender:
        if frame not in self._senders:
            self._senders[frame] = FrameSender(self.engine, frame)
        return self._senders[frame]

    def has_sent(self, ended: Ended) -> None:
        """The frame of a block has left."""
        if ended in self._sending:
            self._sending.remove(ended)
            ended(None)

    def _parts_of(self, frame: str) -> dict[str, FramePart]:
        if frame not in self._parts:
            self._parts[frame] = dict(parts_of(self.frames[frame].segments))
        return self._parts[frame]

    def fields_of(self, block: Block) -> dict[str, Any]:
        """The fields of a SEND block's frame as they are now. Raises DeviceMemoryError, ValueError."""
        return self._reader_of(block).read()

    def _reader_of(self, block: Block) -> FrameFields:
        found = self._fields.get(block.id)
        if found is None or found.block is not block:
            assert block.frame is not None
            found = self._fields[block.id] = FrameFields(block, self._parts_of(block.frame), self.memory)
        return found

    def store_frame(self, block: Block, frame: FrameValue) -> None:
        """Puts the fields of a received frame where the block says, or none. Raises DeviceMemoryError, ValueError."""
        parts = self._parts_of(frame.frame)
        pieces: list[Piece] = []
        for name, place in block.data.items():
            value = frame.fields.get(name)
            if value is not None:
                bits, data = to_memory(parts[name], place, value, block.sizes.get(name))
                pieces.append((place, bits, data))
        store_pieces(self.memory, pieces)
