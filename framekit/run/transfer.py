"""Execute the transfers of blocks: memory to requests, replies to memory; arguments and results of calls."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import partial
from itertools import pairwise
from typing import Any, Generic, Literal, TypeVar

from framekit.codec.shown import explain
from framekit.definition.expression import Attribute, Conditional, Expression, Index, List, Name, Node, Number
from framekit.definition.model.frames import Frame, flat
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import StationType
from framekit.definition.model.segments import Bits, Count, Data, Field, FieldType, Length, Repeat, Segment
from framekit.definition.model.services import Packing, ServiceRow
from framekit.definition.model.values import LayoutOf, ReadAs, RecordOf, Value
from framekit.definition.problems import did_you_mean
from framekit.definition.times import NEVER
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.link.engine import Engine
from framekit.link.events import Command
from framekit.link.packing import Packer, cut_memory, join_memory, values_of
from framekit.link.services.client import Done, ReadKey, ServiceClient, Transfer, TransferPlan, TransferResult
from framekit.link.values import EVALUATION_ERRORS, FrameValue, Names, compile_expression
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, unit_bits
from framekit.memory.views import as_signed
from framekit.run.block_state import Failure, failure_of
from framekit.run.commands import CommandBlocks, CommandEnd, Later, ParamsOf
from framekit.run.model import ArgumentPlace, Block, Merge, ResultPlace
from framekit.run.own_memory import (
    FrameFields,
    FramePart,
    Piece,
    parts_of,
    piece_writer,
    read_piece,
    store_pieces,
    stored_numbers,
    to_memory,
)

Ended = Callable[[Failure | None], None]
"""Called once with the result of an exchange of a block; None for success."""


class BlockTransfers:
    """Starts the exchanges of the blocks of one channel."""

    def __init__(
        self,
        engine: Engine,
        client: ServiceClient | None,
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
        self._fields: dict[tuple[int, int], FrameFields] = {}
        self._sending: list[Ended] = []

    def closed(self, reason: str) -> None:
        """Report failure of all frames that were not sent before the connection closed."""
        sending, self._sending = self._sending, []
        for ended in sending:
            ended(Failure(outcome="closed", cause=reason))

    def forget(self, block: Block) -> None:
        """Discard the prepared data of a removed block."""
        self._fields.pop((block.set, block.number), None)

    def prepare(self, block: Block) -> None:
        """Prepare the first start of a block; errors are reported at the start."""
        if block.instruction == "send":
            with suppress(DeviceMemoryError, ValueError):
                self.fields_of(block)

    def starts_of(self, block: Block, ended: Ended, carry_out: Callable[[list[Command]], None]) -> BlockStarts:
        """Return the object that starts the exchanges of a block, each time it is due."""
        if block.instruction == "read" and len(block.targets) == 1:
            return BlockReads(self, block, ended, carry_out)
        return BlockStarts(self, block, ended, carry_out)

    def begin(self, block: Block, station: Any, now: int, ended: Ended) -> list[Command]:
        """Begin one exchange. Raise DeviceMemoryError or EVALUATION_ERRORS."""
        if block.frame is not None and block.instruction == "send":
            fields, told = self.fields_of(block).read(), partial(self._has_sent, ended)
            commands = self.engine.send_frame(block.frame, now, fields, told)
            self._sending.append(ended)
            return commands
        if block.instruction == "command":
            return self.commands.start(block, station, now, ended)
        return self._transfer(block, station, now, partial(self._done, block, ended)).commands

    def _transfer(self, block: Block, station: Any, now: int, done: Done) -> Transfer:
        client, targets, unit = self.client, block.targets, block.unit
        assert client is not None
        if block.instruction == "read":
            transfer = client.read_variables(targets, station=station, unit=unit, now=now, on_done=done)
            transfer.gives_way = True
            return transfer
        if block.instruction == "write":
            values = self.values_of(block)
            if len(targets) > 1:
                return client.write_variables(targets, values, station=station, unit=unit, now=now, on_done=done)
            return client.write(targets[0], values, station=station, unit=unit, now=now, on_done=done)
        assert block.service is not None
        given = arguments_of_call(block, self.memory)
        return client.call(
            block.service, given, station=station, addresses=block.addresses, unit=unit, count=block.count,
            now=now, on_done=done,
        )  # fmt: skip

    def start_joined(self, reads: Sequence[Read[tuple[Block, Ended]]], now: int) -> list[Command]:
        """Begin one read for several blocks of a station; each block gets its own part and its own result."""
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
                self._done(block, ended, part)

        try:
            station = self.station_of(reads[0].key[0])
            transfer = self.client.read(address, station=station, count=count, now=now, on_done=done)
            transfer.gives_way = True
            return transfer.commands
        except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
            for read in reads:
                read.key[1](Failure(outcome="cannot_send", cause=explain(error)))
            return []

    def read_of(self, block: Block, ended: Ended) -> Read[tuple[Block, Ended]] | None:
        """Return the read of a READ block with one place, for joining with others; None for every other block."""
        if block.instruction != "read" or len(block.targets) != 1 or not block.merge or self.client is None:
            return None
        try:
            address = self.client.grammar.parse(block.targets[0], block.unit)
        except AddressError:
            return None
        return Read((block, ended), address, block.count)

    def station_of(self, block: Block) -> Any:
        """Return the station of the other side: fixed, or read from the own memory now. Raise ValueError."""
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
        """Return the elements that a WRITE block writes now: its constants, or elements from its places."""
        if block.values is not None:
            return list(block.values)
        if len(block.targets) > 1:
            pairs = zip(block.places, block.units, strict=True)
            return [values_of(read_piece(self.memory, place, unit_bits(unit)), unit, 1)[0] for place, unit in pairs]
        unit = block.units[0]
        return values_of(read_piece(self.memory, block.places[0], block.count * unit_bits(unit)), unit, block.count)

    def _done(self, block: Block, ended: Ended, result: TransferResult) -> None:
        """Store the data of a transfer in memory, and report the result."""
        if result.ok and (block.instruction == "read" or block.results):
            try:
                if block.results:
                    store_pieces(self.memory, list(result_pieces(block, result)))
                elif len(block.targets) == 1:
                    bits = block.count * unit_bits(block.units[0])
                    piece_writer(self.memory, block.places[0], bits)(result.data)
                else:
                    store_pieces(self.memory, self.pieces_of(block, result.data))
            except (DeviceMemoryError, ValueError) as error:
                ended(Failure(outcome="cannot_store", cause=str(error)))
                return
        ended(None if result.ok else failure_of(result))

    def pieces_of(self, block: Block, data: bytes) -> list[Piece]:
        """Return the data of a READ block with several places, in the form of the memory, by place."""
        starts = [0]
        for unit in block.units:
            starts.append(starts[-1] + unit_bits(unit))
        spans = zip(block.places, pairwise(starts), strict=True)
        return [(place, end - start, cut_memory(data, start, end - start)) for place, (start, end) in spans]

    # ---- SEND and RECEIVE ---------------------------------------------------------------------------------

    def _has_sent(self, ended: Ended) -> None:
        """Report that the frame of a block was sent."""
        if ended in self._sending:
            self._sending.remove(ended)
            ended(None)

    def _parts_of(self, frame: str) -> dict[str, FramePart]:
        if frame not in self._parts:
            self._parts[frame] = dict(parts_of(self.frames[frame].segments))
        return self._parts[frame]

    def fields_of(self, block: Block) -> FrameFields:
        """Return the reader of the fields of a SEND block. Raise DeviceMemoryError or ValueError."""
        key = block.set, block.number
        found = self._fields.get(key)
        if found is None or found.block is not block:
            assert block.frame is not None
            found = self._fields[key] = FrameFields(block, self._parts_of(block.frame), self.memory)
        return found

    def store_frame(self, block: Block, frame: FrameValue) -> None:
        """Store all fields of a received frame at the places of a block, or none.

        Raise DeviceMemoryError or ValueError.
        """
        parts = self._parts_of(frame.frame)
        pieces: list[Piece] = []
        for name, place in block.data.items():
            value = frame.fields.get(name)
            if value is not None:
                bits, data = to_memory(parts[name], place, value, block.sizes.get(name))
                pieces.append((place, bits, data))
        store_pieces(self.memory, pieces)


class BlockStarts:
    """Starts the exchanges of one block on one channel, with the constant parts prepared.

    `ended` is called exactly once for each exchange, perhaps before `go` returns.
    """

    def __init__(
        self, transfers: BlockTransfers, block: Block, ended: Ended, carry_out: Callable[[list[Command]], None]
    ) -> None:
        self.transfers, self.block, self.ended, self._carry_out = transfers, block, ended, carry_out

    def go(self, now: int) -> None:
        """Begin an exchange."""
        try:
            commands = self._begin(now)
        except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
            self.ended(Failure(outcome="cannot_send", cause=explain(error)))
            commands = []
        self._carry_out(commands)

    def _begin(self, now: int) -> list[Command]:
        return self.transfers.begin(self.block, self.transfers.station_of(self.block), now, self.ended)


class BlockReads(BlockStarts):
    """The reads of a block with one place: the prepared request, and the writer of the place."""

    def __init__(
        self, transfers: BlockTransfers, block: Block, ended: Ended, carry_out: Callable[[list[Command]], None]
    ) -> None:
        super().__init__(transfers, block, ended, carry_out)
        assert transfers.client is not None
        self._client, self._engine = transfers.client, transfers.engine
        self.write: Callable[[bytes], None] = self._write_first
        """Store the data of a read. Raise DeviceMemoryError."""
        self.spare: BlockRead | None = None
        """A finished read that can be begun again."""
        self._asked: ReadKey = block.targets[0], block.unit, block.count, block.station

    def _begin(self, now: int) -> list[Command]:
        key = self._asked
        if self.block.station_from is not None:
            key = (*key[:3], self.transfers.station_of(self.block))
        plan, read = self._client.reading(key).plan(self._client), self.spare
        if read is not None:
            self.spare = None
            commands = read.again(plan, now, read.over)
            if commands is not None:
                return commands
        return BlockRead(plan, self._engine, now, self).commands

    def _write_first(self, data: bytes) -> None:
        """Store the data of a read, and keep the writer of the place."""
        bits = self.block.count * unit_bits(self.block.units[0])
        self.write = piece_writer(self.transfers.memory, self.block.places[0], bits)
        self.write(data)


class BlockRead(Transfer):
    """One read of a block. Its data go directly into memory, without a list of numbers."""

    __slots__ = ("_reads",)

    def __init__(self, plan: TransferPlan, engine: Engine, now: int, reads: BlockReads) -> None:
        self._reads = reads
        Transfer.__init__(self, plan, engine, now, self.over)
        self.gives_way = True

    def brought(self, data: bytes, reply: FrameValue | None, buffer: bytes, done: Done) -> None:
        """Store the data; the read may be begun again."""
        reads = self._reads
        reads.spare = self
        try:
            reads.write(data)
        except (DeviceMemoryError, ValueError) as error:
            reads.ended(Failure(outcome="cannot_store", cause=str(error)))
        else:
            reads.ended(None)

    def over(self, result: TransferResult) -> None:
        """Report the result of a read with several exchanges, or a failure."""
        reads, failure = self._reads, failure_of(result)
        if failure is None:
            try:
                reads.write(result.data)
            except (DeviceMemoryError, ValueError) as error:
                failure = Failure(outcome="cannot_store", cause=str(error))
        reads.ended(failure)


Key = TypeVar("Key")


@dataclass(frozen=True, slots=True)
class Read(Generic[Key]):
    """`count` elements from `address` on, for `key`."""

    key: Key
    address: Address
    count: int

    @property
    def end(self) -> int:
        return self.address.start + self.count


def neighbours(first: Read[Key], others: Sequence[Read[Key]], merge: Merge, grammar: AddressGrammar) -> list[Read[Key]]:
    """Return the reads that fit into one request with the first: gaps and total size are within the limits."""
    chosen = [first]
    least, end = first.address.start, first.end
    added = True
    while added:
        added = False
        for other in others:
            gap = max(other.address.start - end, least - other.end, 0)
            low, high = min(least, other.address.start), max(end, other.end)
            if gap > merge.gap or (merge.most is not None and high - low > merge.most) or other in chosen:
                continue
            if _same_row(first.address, other.address, grammar):
                chosen.append(other)
                least, end, added = low, high, True
    return chosen[1:]


def _same_row(one: Address, other: Address, grammar: AddressGrammar) -> bool:
    """Return whether both addresses are in the same sequence of elements, not in another file or table."""
    if (one.area, one.unit) != (other.area, other.unit):
        return False
    try:
        return grammar.print(replace(one, start=other.start)) == grammar.print(other)
    except AddressError:
        return False


def joined(reads: Sequence[Read[Key]]) -> tuple[Address, int]:
    """Return the first address of a read for all reads, and its number of elements."""
    first = min(reads, key=lambda read: read.address.start)
    return first.address, max(read.end for read in reads) - first.address.start


class CommandTransfers:
    """Starts the command blocks of one channel."""

    def __init__(
        self,
        engine: Engine,
        client: ServiceClient | None,
        memory: DeviceMemory,
        mapping: Mapping[str, tuple[str, int]],
        later: Later | None,
        params_of: ParamsOf | None,
    ) -> None:
        self._engine = engine
        self._client = client
        self._memory = memory
        self._mapping = mapping
        self._later = later
        self._params_of = params_of
        self._commands: dict[str, CommandBlocks] = {}

    def start(self, block: Block, station: Any, now: int, ended: Ended) -> list[Command]:
        """Start a command block with a copy of its words; later changes of the words have no effect."""
        assert block.commands is not None
        commands, place = self.commands_of(block.commands), block.places[0]
        area = self._memory.area(place.address.area)
        first = place.address.first_bit // 8
        data = area.read_bytes(first, min(2 * commands.rules.most, area.size_bytes - first))
        over = False

        def late(_: int) -> list[Command]:
            if not over:
                self._show_fault(block, True)
            return []

        def done(end: CommandEnd) -> None:
            nonlocal over
            over = True
            if end.fault:
                self._show_fault(block, True)
                ended(Failure(outcome="cannot_send", cause=end.fault))
            else:
                ended(end.failure)

        self._show_fault(block, False)
        waits = commands.waits_for(data)
        if waits <= 0:
            late(now)
        elif waits < NEVER and self._later is not None:
            self._later(waits, late)
        return commands.start(data, station, now, done, lambda station: self._params(block, station))

    def _params(self, block: Block, station: Any) -> dict[str, Any]:
        """Return the parameters of the channel for a station, without those that the block sets."""
        given = {} if self._params_of is None else self._params_of(station)
        return {name: value for name, value in given.items() if name not in block.params}

    def commands_of(self, application: Protocol) -> CommandBlocks:
        """Return the command blocks of an application on this channel."""
        found = self._commands.get(application.name)
        if found is None or found.words.application != application:
            found = self._commands[application.name] = CommandBlocks(
                application,
                self._memory,
                channel=self._engine.scope,
                engine=self._engine,
                client=self._client,
                mapping={name: place for name, place in self._mapping.items() if name in application.areas},
                later=self._later,
            )
        return found

    def _show_fault(self, block: Block, fault: bool) -> None:
        if block.fault is not None:
            store_pieces(self._memory, [(block.fault, 1, bytes([fault]))])


MILLISECOND = 1_000_000
LONGEST = 65536
"""Maximum number of elements of a list, or of bytes, of one result or argument."""


# ---- shapes of results -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """The statically known properties of a result."""

    kind: Literal["any", "number", "bytes", "text", "list", "record"] = "any"
    is_real: bool = False
    """Whether a number may have a fraction."""
    size: int | None = None
    """The number of bytes of data or text with a fixed size."""
    scale: int = 1
    """Nanoseconds per count of a time; 1 for other numbers."""
    item: Shape | None = None
    """The shape of the items of a list."""
    parts: Mapping[str, Shape] | None = None
    """The shapes of the fields of a record."""

    @property
    def is_long(self) -> bool:
        """Return whether the number of elements or bytes is not fixed."""
        return self.kind == "list" or (self.kind in ("bytes", "text") and self.size is None)


ANY = Shape()
_WORDS = {"number": "a number", "bytes": "bytes", "text": "a text"}


class NoResultError(ValueError):
    """Raised if a service does not return the named result; `hint` is the remedy."""

    def __init__(self, what: str, hint: str) -> None:
        super().__init__(what)
        self.hint = hint


def shapes_of(protocol: Protocol, row: ServiceRow) -> dict[str, Shape]:
    """Return the shapes of the results of one row of a service, including the frame and the buffer of the reply."""
    frames = [reply.frame.frame for reply in row.reply if reply.frame is not None]
    parts = [_parts(protocol.frames[name].segments) for name in frames if name in protocol.frames]
    known = {"buffer": Shape(kind="bytes")}
    if parts:
        known["reply"] = Shape(kind="record", parts=_either(parts))
    return known | {name: _given(protocol, value, known) for name, value in row.gives.items()}


def shape_at(expression: Expression, known: Mapping[str, Shape]) -> Shape:
    """Return the shape of the result that an expression names. Raise NoResultError."""
    return _followed(expression.root, known)


def is_path(node: Node) -> bool:
    """Return whether an expression is only a path: `time.hour`, `faults[0].code`."""
    if isinstance(node, Index):
        return isinstance(node.index, Number) and is_path(node.value)
    return isinstance(node, Name) or (isinstance(node, Attribute) and is_path(node.value))


def _followed(node: Node, known: Mapping[str, Shape]) -> Shape:
    match node:
        case Name(name=name):
            if name not in known:
                given = [one for one in known if one not in ("reply", "buffer")] or list(known)
                raise NoResultError(f"no result '{name}'", did_you_mean(name, given))
            return known[name]
        case Attribute(value=value, name=name):
            return _part(_followed(value, known), name)
        case Index(value=value):
            shape = _followed(value, known)
            return shape.item or ANY if shape.kind == "list" else Shape(kind="number") if shape.kind == "bytes" else ANY
        case Conditional(then=first, otherwise=second):
            one, other = _followed(first, known), _followed(second, known)
            return one if one.kind == other.kind else ANY
        case List():
            return Shape(kind="list", item=_followed(node.items[0], known) if node.items else ANY)
    return ANY


def _part(shape: Shape, name: str) -> Shape:
    if shape.kind == "list":
        return Shape(kind="list", item=_part(shape.item or ANY, name))
    if shape.kind == "record" and shape.parts is not None:
        if name not in shape.parts:
            raise NoResultError(f"no '{name}' in it", did_you_mean(name, shape.parts))
        return shape.parts[name]
    if shape.kind in ("number", "bytes", "text"):
        raise NoResultError(f"no '{name}' in it: it is {_WORDS[shape.kind]}", f"leave .{name} out")
    return ANY


def _given(protocol: Protocol, value: Value, known: Mapping[str, Shape]) -> Shape:
    match value:
        case ReadAs(layout=layout) if layout in protocol.layouts:
            return Shape(kind="record", parts=_parts(protocol.layouts[layout].segments))
        case LayoutOf():
            return Shape(kind="bytes")
        case RecordOf(fields=fields):
            return Shape(kind="record", parts={name: _given(protocol, one, known) for name, one in fields.items()})
        case Expression():
            try:
                return _followed(value.root, known)
            except NoResultError:
                return ANY
    return ANY


def _either(records: Sequence[Mapping[str, Shape]]) -> dict[str, Shape]:
    """Return the fields of a value that is one of these records; a field with different shapes can be anything."""
    found: dict[str, Shape] = {}
    for record in records:
        for name, shape in record.items():
            found[name] = shape if found.get(name, shape) == shape else ANY
    return found


def _parts(segments: Iterable[Segment]) -> dict[str, Shape]:
    found: dict[str, Shape] = {}
    for segment in flat(segments):
        if isinstance(segment, Bits):
            found |= {part.name: Shape(kind="number") for part in segment.parts}
        elif segment.name is not None:
            shape = _of_segment(segment)
            found[segment.name] = shape if found.get(segment.name, shape) == shape else ANY
    return found


def _of_segment(segment: Segment) -> Shape:
    match segment:
        case Field():
            return replace(_of_type(segment.type), scale=segment.unit or 1)
        case Data():
            return Shape(kind="bytes", size=segment.size if isinstance(segment.size, int) else None)
        case Length() | Count():
            return Shape(kind="number")
        case Segment(is_record=True):
            return Shape(kind="record", parts=_parts(segment.members))
        case Repeat():
            of = segment.plain_type
            item = Shape(kind="record", parts=_parts(segment.members)) if of is None else _of_type(of)
            return Shape(kind="list", item=item)
    return ANY


def _of_type(type_: FieldType) -> Shape:
    if type_.kind in ("ascii", "bytes"):
        return Shape(
            kind="text" if type_.kind == "ascii" else "bytes", size=type_.size if isinstance(type_.size, int) else None
        )
    return Shape(kind="number", is_real=type_.has_fractions)


# ---- results into memory ---------------------------------------------------------------------------------


def result_pieces(block: Block, result: TransferResult) -> Iterator[Piece]:
    """Yield the results of a call at the places of its block. Raise ValueError for a result that cannot be stored."""
    names = Names({"reply": result.reply, "buffer": result.buffer, **result.gives})
    for place in block.results:
        try:
            value = compile_expression(place.result)(names)
        except EVALUATION_ERRORS:
            raise ValueError(f"the call gave no '{place.result}'") from None
        if value is None:
            if place.is_required:
                raise ValueError(f"the reply has no '{place.result}'")
            continue  # the place stays as it is, as after a received frame without the field
        bits, data = _stored(place, value, block.packing or Packing())
        yield place.place, bits, data


def _stored(place: ResultPlace, value: Any, packing: Packing) -> tuple[int, bytes]:
    """Return size in bits and content in the form of the memory.

    A value shorter than its place is filled with zeros.
    """
    address, name = place.place.address, str(place.result)
    if isinstance(value, (int, float, Decimal)):
        return _numbers(place, [value])
    if isinstance(value, (bytes, str)):
        text = isinstance(value, str)
        data = value.encode("latin-1", "replace") if isinstance(value, str) else value
        bits, data = (8 * len(data), data) if text else _bytes(place, data.ljust(place.size or 0, b"\0"), packing)
        room = None if place.size is None else 8 * place.size
        what = f"{len(value)} {'characters' if text else 'bytes'}"
    elif isinstance(value, list) and all(isinstance(item, bytes) for item in value):
        bits, data = _bytes(place, b"".join(value), packing)
        room, what = _elements(place), f"{bits // address.unit_bits} elements"
    elif isinstance(value, list) and all(isinstance(item, (int, float, Decimal)) for item in value):
        bits, data = _numbers(place, value)
        room, what = _elements(place), f"{len(value)} elements"
    else:
        raise ValueError(f"'{name}' is neither a number nor data, but {_shown(value)}")
    if room is None:
        raise ValueError(f"nothing says how much room '{name}' has, and it has {what} – give the block size:")
    if bits > room:
        raise ValueError(f"'{name}' has {what}, and there is room for {place.size}")
    return room, join_memory([(data, bits), (bytes((room - bits + 7) // 8), room - bits)])


def _elements(place: ResultPlace) -> int | None:
    return None if place.size is None else place.size * (place.float_bits or place.place.address.unit_bits)


def _numbers(place: ResultPlace, values: Sequence[float | Decimal]) -> tuple[int, bytes]:
    """Return numbers in the form of the memory, as floating-point numbers if the place holds such numbers."""
    address = place.place.address
    scaled: list[Any] = [value // place.scale if place.scale > 1 else value for value in values]
    bits = place.float_bits
    return len(scaled) * (bits or address.unit_bits), stored_numbers(str(place.result), place.place, scaled, bits)


def _bytes(place: ResultPlace, data: bytes, packing: Packing) -> tuple[int, bytes]:
    """Return data as elements of the place, as the row of the service packs them."""
    packer = Packer(packing, place.place.address.unit)
    count = packer.count_in(0, len(data))
    return count * packer.bits, packer.to_memory(data, 0, count)


def _shown(value: Any) -> str:
    return "a list of such" if isinstance(value, list) else "nothing" if value is None else "a record of several"


# ---- arguments from memory -------------------------------------------------------------------------------


def arguments_of_call(block: Block, memory: DeviceMemory) -> dict[str, Any]:
    """Return the arguments of a call at this moment. Raise DeviceMemoryError."""
    return {**block.arguments, **{name: _argument(place, memory) for name, place in block.argument_places.items()}}


def _argument(given: ArgumentPlace, memory: DeviceMemory) -> Any:
    address = given.place.address
    if given.type in ("text", "choice", "bytes"):
        data = read_piece(memory, given.place, 8 * given.size)
        return data if given.type == "bytes" else data.rstrip(b"\0").decode("latin-1")
    numbers: Sequence[Any] = values_of(
        read_piece(memory, given.place, given.size * address.unit_bits), address.unit, given.size
    )
    if given.signed and address.unit_bits > 1:
        numbers = as_signed(numbers, address.unit)
    if given.type == "list":
        return list(numbers)
    return numbers[0] * MILLISECOND if given.type == "time" else numbers[0]


def argument_bits(type_: str, size: int, unit: str) -> int:
    """Return the size of an argument in memory, in bits."""
    return 8 * size if type_ in ("text", "choice", "bytes") else size * unit_bits(unit)
