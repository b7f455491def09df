"""Points: named, scaled values of a run, each with its quality and the time of its reply.

A point is a place in the memory of the run. A point that is read from a channel has its place in a separate area, which
no address can name. This module plans the reads of these points: neighbours that fit into one request form one block.
`PointTable` follows blocks and memory, and reports every change.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from decimal import Context, Decimal
from functools import partial
from typing import Any, Literal

from framekit.codec.codec import compile_protocol
from framekit.definition.expression import Expression
from framekit.definition.model.services import Packing
from framekit.definition.times import NEVER, format_time
from framekit.link.addresses import Address
from framekit.link.packing import reader_of, shortest
from framekit.link.scope import Scope
from framekit.link.services.rows import Piece, Planner, rows_of
from framekit.link.values import EVALUATION_ERRORS, Names
from framekit.memory.memory import DeviceMemory, unit_bits
from framekit.memory.views import NumberView
from framekit.run.block_state import Failure
from framekit.run.model import POINTS_AREA, POINTS_SET, Block, Channel, Merge, OwnPlace, Point, ResultPlace, block_id
from framekit.run.own_memory import piece_reader
from framekit.run.transfer import Read, neighbours
from framekit.run.triggers import Every

log = logging.getLogger(__name__)

Quality = Literal["good", "stale", "failed"]


@dataclass(frozen=True, slots=True)
class PointValue:
    """The state of a point at one moment."""

    name: str
    value: Any = None
    """The last good value; None before the first."""
    quality: Quality = "stale"
    """`good`, `stale` (not read for too long), or `failed`."""
    reason: str = "not read yet"
    """Why the value is not good."""
    time: int = 0
    """The time of the reply, or of the failure or aging, in nanoseconds since 1970 (UTC)."""
    number: Any = None
    """The value before `enum` replaces it by a word."""

    @property
    def text_time(self) -> str:
        """Return the time in ISO 8601 form; '' before the first reading."""
        return iso_time(self.time) if self.time else ""


def iso_time(time: int) -> str:
    """Return nanoseconds since 1970 (UTC) as ISO 8601 with milliseconds: `2026-03-01T12:00:00.250Z`."""
    seconds, rest = divmod(time, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1_000_000:03d}Z"


def nanoseconds_of(text: str) -> int:
    """Return a time written by `iso_time` in nanoseconds since 1970."""
    moment = datetime.fromisoformat(text)
    return round(moment.timestamp() * 1000) * 1_000_000


EXACT = Context(prec=80, traps=[])
"""The context for exact scaling, independent of the context of the program: 64-bit numbers and scales fit into it."""


def scaled(point: Point, number: Any) -> Any:
    """Return the scaled value of a number in memory. Raise ValueError for nan, for infinity, and for an overflow."""
    scaling = point.scaling
    if isinstance(number, float) and not math.isfinite(number):
        raise ValueError("not a number (NaN)" if math.isnan(number) else "the number is infinite")
    if scaling is not None:
        exact = EXACT.add(EXACT.multiply(Decimal(number), scaling.factor), scaling.offset)
        number = int(exact) if scaling.is_whole and isinstance(number, int) else float(exact)
        if not math.isfinite(number):
            raise ValueError("the scaled value is beyond all numbers")
    if point.decimals is not None and isinstance(number, float):
        number = round(number, point.decimals)
    return number


def value_text(point: Point, value: Any) -> str:
    """Return a value of a point as text: with the digits of `decimals`, `-` for None.

    A float of 32 bits has no more digits than its bits need: 12.3, not 12.300000190734863.
    """
    if value is None:
        return "-"
    is_as_read = point.decimals is None and point.scaling is None
    if is_as_read and isinstance(value, float) and point.form.bits == 32:
        return str(shortest(value))
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return str(value) if point.decimals is None or not is_number else f"{value:.{point.decimals}f}"


def unscaled(point: Point, value: Any) -> Any:
    """Return the number to store for a value, rounded if the place stores whole numbers. Raise ValueError."""
    if point.names and isinstance(value, str):
        found = next((number for number, name in point.names.items() if name == value), None)
        if found is None:
            raise ValueError(f"'{value}' is no value of {point.name} – known: {', '.join(point.names.values())}")
        value = found
    if point.form.type == "string":
        return value
    if isinstance(value, bool):
        value = int(value)
    if not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(f"{value!r} is no number")
    _within(point, value, value)
    exact = Decimal(str(value))
    if point.scaling is not None:
        exact = EXACT.divide(EXACT.subtract(exact, point.scaling.offset), point.scaling.factor)
    number: int | float = float(exact) if point.form.is_float else int(exact.to_integral_value(context=EXACT))
    _within(point, scaled(point, number), value)  # the nearest number may be outside the limits
    return number


def _within(point: Point, number: float, value: Any) -> None:
    if point.limits is not None and not point.limits[0] <= number <= point.limits[1]:
        raise ValueError(f"{value} is not in {point.limits[0]:g}..{point.limits[1]:g}, the range of {point.name}")


# ---- planning ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class PointCall:
    """The call of a service whose reply contains a point."""

    service: str
    arguments: Mapping[str, Any]
    packing: Packing
    result: Expression
    """The path of the result that is the value."""
    scale: int
    """Nanoseconds per count of a result that is a time, else 1."""


@dataclass(frozen=True, slots=True)
class PointRead:
    """A point of a channel before its place in memory is known."""

    point: Point
    address: Address
    """The address on the channel; unused with `call`."""
    every: int
    """The read period (ns)."""
    call: PointCall | None = None


def planned(asked: Sequence[PointRead], channels: Mapping[int, Channel]) -> tuple[list[Block], dict[str, Point], int]:
    """Return the blocks that read and write the points, the points by name with places, and their memory in words.

    Points of one channel and station with the same period share a request if possible: results of the same call,
    neighbours, and addresses no further apart than `merge: {gap}` of the channel.
    """
    groups: dict[tuple[Any, ...], list[PointRead]] = {}
    for one in asked:
        assert one.point.channel is not None
        call = one.call and (one.call.service, repr(sorted(one.call.arguments.items())))
        groups.setdefault((one.point.channel, one.every, repr(one.point.station), call), []).append(one)
    blocks: list[Block] = []
    points: list[Point] = []
    words = 0
    for (channel, *_, call), members in groups.items():
        if call is not None:
            words += _place_call(members, len(blocks), words, blocks, points)
            continue
        for run in _Planning(channels[channel]).runs(members):
            words += run.place(len(blocks), words, blocks, points)
    for at, point in enumerate(points):
        if point.is_writable:
            blocks.append(_writing(point, len(blocks), words))
            points[at] = replace(point, writer=blocks[-1].id)
            words += -(-point.bits // 16)
    return blocks, {point.name: point for point in points}, words


def _writing(point: Point, number: int, first_word: int) -> Block:
    """Return the block that writes a point from a separate place; only a program starts it."""
    assert point.channel is not None
    place = OwnPlace(address=Address(POINTS_AREA, "word", first_word, "", {}), text=point.name)
    return Block(
        number=number, set=POINTS_SET, name=point.name, instruction="write", channel=point.channel,
        targets=(point.address,), units=(point.form.carrier,), unit=point.form.unit,
        count=point.form.units, places=(place,), station=point.station, at=point.at,
    )  # fmt: skip


def _place_call(
    members: Sequence[PointRead], number: int, first_word: int, blocks: list[Block], points: list[Point]
) -> int:
    """Add the block of one call, and the points in its reply; return their memory in words."""
    first, results, words = members[0], [], first_word
    assert first.call is not None and first.point.channel is not None
    names = ", ".join([one.point.name for one in members[:3]] + ["…"] * (len(members) > 3))
    for one in members:
        assert one.call is not None
        form = one.point.form
        is_text = form.view is not None and not isinstance(form.view, NumberView)
        type_ = None if is_text or form.view is None else form.type
        unit = "byte" if is_text else form.carrier
        place = OwnPlace(address=Address(POINTS_AREA, unit, 0, "", {}, type_, 16 * words), text=one.point.name)
        results.append(
            ResultPlace(
                result=one.call.result, place=place, bits=form.bits, size=form.count if is_text else None,
                scale=one.call.scale, float_bits=form.bits if form.is_float else 0, is_required=True,
            )
        )  # fmt: skip
        own = OwnPlace(address=Address(POINTS_AREA, "bit", 16 * words, "", {}), text=one.point.name)
        points.append(replace(one.point, place=own, blocks=(block_id(POINTS_SET, number),)))
        words += -(-form.bits // 16)
    blocks.append(
        Block(
            number=number, set=POINTS_SET, name=names, instruction="call", channel=first.point.channel,
            service=first.call.service, arguments=first.call.arguments, packing=first.call.packing,
            results=tuple(results), station=first.point.station, triggers=(Every(period=first.every),),
            at=first.point.at,
        )
    )  # fmt: skip
    return words - first_word


@dataclass(slots=True)
class _Run:
    """Points that one read covers: `count` elements from `address` on."""

    members: list[PointRead]
    address: Address
    count: int
    is_plain: bool = False
    """A single point, read exactly as its file says."""

    def place(self, number: int, first_word: int, blocks: list[Block], points: list[Point]) -> int:
        """Add the block and its points; return their memory in words."""
        first = self.members[0]
        point = first.point
        asked_unit = point.form.unit if self.is_plain else None
        unit = asked_unit or self.address.unit
        names = ", ".join([one.point.name for one in self.members[:3]] + ["…"] * (len(self.members) > 3))
        start = Address(POINTS_AREA, "word", first_word, "", {})
        assert point.channel is not None
        blocks.append(
            Block(
                number=number, set=POINTS_SET, name=names, instruction="read", channel=point.channel,
                targets=(point.address if self.is_plain else self.address.text,), units=(unit,), unit=asked_unit,
                count=self.count, places=(OwnPlace(address=start, text=names),), station=point.station,
                triggers=(Every(period=first.every),), at=point.at,
            )
        )  # fmt: skip
        for one in self.members:
            bit = 16 * first_word + one.address.first_bit - (one if self.is_plain else self).address.first_bit
            place = OwnPlace(address=Address(POINTS_AREA, "bit", bit, "", {}), text=one.point.name)
            points.append(replace(one.point, place=place, blocks=(blocks[-1].id,)))
        return -(-self.count * unit_bits(unit) // 16)


class _Planning:
    """Plans the reads of one channel."""

    def __init__(self, channel: Channel) -> None:
        self.merge = channel.merge or Merge()
        protocol = channel.protocol
        rows = rows_of(protocol, compile_protocol(protocol))
        self.planner, self.grammar = Planner(rows), rows.grammar
        self.scope = Scope(
            protocol, role=channel.role, own=channel.own, line=channel.line, params=channel.params
        )  # fmt: skip

    def runs(self, members: Sequence[PointRead]) -> Iterator[_Run]:
        """Yield the reads, each with the points that it covers."""
        waiting: list[Read[_Run]] = []
        for one in members:
            run = self._alone(one)
            if run.is_plain:
                yield run
            else:
                waiting.append(Read(run, run.address, run.count))
        waiting.sort(key=lambda read: self._order(read.address), reverse=True)
        while waiting:
            yield self._joined(waiting)

    def _order(self, address: Address) -> tuple[str, str, str, int]:
        """Return a sort key: neighbouring places of the same file or table, by its first place, are consecutive."""
        return address.area, address.unit, self.grammar.advance(address, -address.start).text, address.start

    def _alone(self, asked: PointRead) -> _Run:
        """Return the read of a single point, in the elements that a request transfers."""
        form, address = asked.point.form, asked.address
        try:
            bits = unit_bits(form.unit or address.unit)
            if bits % address.unit_bits == 0:
                piece = self._single(address, form.units * bits // address.unit_bits, asked.point.station)
                if piece is not None:
                    return _Run([asked], piece.address, piece.count)
        except (*EVALUATION_ERRORS, ValueError):
            pass  # the plain read reports the error
        return _Run([asked], address, form.units, is_plain=True)

    def _single(self, address: Address, count: int, station: Any) -> Piece | None:
        """Return the elements that one request transfers.

        Return None if it takes several requests, or if no text names the place.
        """
        plan = self.planner.plan("read", Piece(address, count), Names({"station": station}, self.scope))
        if len(plan.exchanges) != 1 or len(plan.exchanges[0]) != 1:
            return None
        piece = plan.exchanges[0][0]
        if _place(piece.address) == _place(address) and address.text:
            return replace(piece, address=replace(piece.address, text=address.text))
        text = self.grammar.print(piece.address)
        again = self.grammar.parse(text)
        if _place(again) != _place(piece.address):
            return None
        return replace(piece, address=replace(piece.address, text=text))

    def _joined(self, waiting: list[Read[_Run]]) -> _Run:
        """Remove the last waiting read and those before it that join it, and return the joined read.

        The waiting reads are sorted, last first.
        """
        run = waiting.pop().key
        while waiting:
            read, following = Read(run, run.address, run.count), waiting[-1]
            if not neighbours(read, [following], self.merge, self.grammar):
                break
            count = max(read.end, following.end) - run.address.start
            try:
                piece = self._single(run.address, count, run.members[0].point.station)
            except (*EVALUATION_ERRORS, ValueError):
                break
            if piece is None or piece.address != run.address:
                break
            waiting.pop()
            run = _Run([*run.members, *following.key.members], run.address, count)
        return run


def _place(address: Address) -> tuple[str, str, int, int]:
    """Return the location of an address, independent of its text."""
    return address.area, address.unit, address.start, address.shift


# ---- at run time --------------------------------------------------------------------------------------------------


def decoder_of(point: Point) -> Callable[[bytes], Any]:
    """Return the function from the data of a point in memory to its value; it raises ValueError for invalid data."""
    form = point.form
    if form.view is not None and (form.is_float or not isinstance(form.view, NumberView)):
        return lambda data: scaled(point, form.values(data, ())[0])
    value = _exactly(point)
    if form.view is not None:
        return lambda data: value(form.values(data, ())[0])
    read = reader_of(form.carrier, form.units)
    return lambda data: value(next(iter(read(data))))


def _exactly(point: Point) -> Callable[[int], Any]:
    """Return `scaled` for whole numbers, with the scale as a precomputed fraction."""
    scaling, decimals = point.scaling, point.decimals
    if scaling is None:
        return lambda number: number
    (a, c), (b, d) = scaling.factor.as_integer_ratio(), scaling.offset.as_integer_ratio()
    under = math.lcm(c, d)
    a, b = a * under // c, b * under // d
    if scaling.is_whole:
        return lambda number: number * a + b

    def value(number: int) -> float:
        try:
            found = (number * a + b) / under  # rounded once, to the nearest number
        except OverflowError:
            raise ValueError("the scaled value is beyond all numbers") from None
        return found if decimals is None else round(found, decimals)

    return value


class _State:
    """The state of a point at run time, and its access to memory.

    While the point is good, `value` is only updated on access.
    """

    __slots__ = (
        "data", "decode", "failed_blocks", "groups", "made_at", "number", "point", "read", "read_at", "told", "value",
    )  # fmt: skip

    def __init__(self, point: Point, memory: DeviceMemory) -> None:
        self.point = point
        self.value = PointValue(point.name)
        self.told: Any = None
        """The last reported number."""
        self.data: bytes | None = None
        """The bytes of `number`."""
        self.number: Any = None
        self.read_at = self.made_at = 0
        """The time of the last read, and of the read that `value` shows."""
        self.failed_blocks: set[int] = set()
        """The blocks whose last end was a failure."""
        self.groups: list[_ReadGroup] = []
        self.read = piece_reader(memory, point.place, point.bits)
        self.decode = decoder_of(point)

    @property
    def last_read(self) -> int:
        """Return the time of the last read, alone or with its block."""
        last = self.read_at
        for group in self.groups:  # mostly one; a generator takes several times as long
            if group.same_at > last:
                last = group.same_at
        return last


class _ReadGroup:
    """The points that a block stores, or a single point without a block."""

    __slots__ = ("data", "read", "read_at", "same_at", "stale", "states", "waits")

    def __init__(self, states: Sequence[_State], memory: DeviceMemory) -> None:
        self.states = states
        self.data: bytes | None = None
        """The bytes of the last read after which all points were good."""
        self.read_at = self.same_at = 0
        """The time of the last read, and of the last read with the same bytes."""
        self.stale = min(state.point.stale for state in states)
        """The shortest maximum age of a point (ns)."""
        self.waits = False
        """Whether the group is in the queue for ages."""
        self.read: Callable[[], bytes] | None = None
        """Reads the span of all points at once; None if they are in several areas, or if several blocks store a point.
        """
        places = [(one.point.place.address, one.point.bits) for one in states]
        if len({place.area for place, _ in places}) == 1 and all(len(one.point.blocks) == 1 for one in states):
            first = min(place.first_bit for place, _ in places) // 8
            end = max(place.first_bit + bits + 7 for place, bits in places) // 8
            self.read = memory.area(places[0][0].area).bytes_reader(first, end - first)
        for state in states:
            state.groups.append(self)


class PointTable:
    """The points of a run. `wall` converts a time of the clock of the run to the time of day (ns since 1970, UTC).

    Listeners are called on every change of value that exceeds the dead band, and on every change of quality, in the
    order of their registration, in the thread of the run. `wake`: called after a change of memory, to request a `tick`
    soon.
    """

    def __init__(
        self, points: Iterable[Point], memory: DeviceMemory, wall: Callable[[int], int], wake: Callable[[], None]
    ) -> None:
        self.wall, self._wake = wall, wake
        self.on_quality: Callable[[Point, str, str], None] = lambda point, quality, reason: None
        """Called with quality and reason when the data of a point are no value, or stale, and when it is good again."""
        self._states = {point.name: _State(point, memory) for point in points}
        self._changed: dict[str, _State] = {}
        self._ages: list[tuple[int, int, _ReadGroup]] = []
        self._order = itertools.count()
        self.listeners: list[Callable[[PointValue], None]] = []
        by_block: dict[int, list[_State]] = {}
        for state in self._states.values():
            point = state.point
            for block in point.blocks:
                by_block.setdefault(block, []).append(state)
            if not point.blocks:
                _ReadGroup([state], memory)
            if point.channel is None:  # other blocks or clients may write it too
                self._watch(state, memory)
                if not point.blocks:
                    self._changed[point.name] = state
        self._by_block = {block: _ReadGroup(states, memory) for block, states in by_block.items()}

    def _watch(self, state: _State, memory: DeviceMemory) -> None:
        """Watch the bits of a point in memory, and no other bits of its words."""
        place = state.point.place.address
        first, end = place.first_bit, place.first_bit + state.point.bits
        for word in range(first // 16, -(-end // 16)):
            low, high = max(first - 16 * word, 0), min(end - 16 * word, 16)
            memory.watch(place.area, word, 1, partial(self._note, state), (1 << high) - (1 << low))

    def _note(self, state: _State, *_: object) -> None:
        self._changed[state.point.name] = state
        self._wake()

    def __iter__(self) -> Iterator[PointValue]:
        return iter([self._value(state) for state in self._states.values()])

    def __getitem__(self, name: str) -> PointValue:
        """Return the state of a point. Raise KeyError."""
        return self._value(self._states[name])

    def _value(self, state: _State) -> PointValue:
        """Return the state of a point with the time of its last read."""
        if state.value.quality == "good" and (last := state.last_read) > state.made_at:
            self._make(state, last)
        return state.value

    def _make(self, state: _State, at: int) -> PointValue:
        """Update and return the state of a good point that was read at this time."""
        point, number = state.point, state.number
        name = point.names.get(number, number) if point.names else number
        state.made_at = at
        state.value = value = PointValue(point.name, name, "good", "", self.wall(at), number)
        return value

    def point(self, name: str) -> Point:
        """Return the description of a point. Raise KeyError."""
        return self._states[name].point

    def __len__(self) -> int:
        return len(self._states)

    # ---- events ----------------------------------------------------------------------------------------------

    def follows(self, block: int) -> bool:
        """Return whether a block stores a point."""
        return block in self._by_block

    def ended(self, block: int, failure: Failure | None, now: int) -> None:
        """Update the points of a block that has ended.

        A point that several blocks store is good if the last end of each block was good.
        """
        group = self._by_block.get(block)
        if group is None:
            return
        if failure is not None:
            for state in group.states:
                state.failed_blocks.add(block)
                self._fail(state, _reason(failure), now)
            return
        group.read_at = now
        if not group.waits:
            self._wait(group, now + group.stale)
        data = None if group.read is None else group.read()
        if data is not None and data == group.data:
            group.same_at = now
            return
        good = True
        for state in group.states:
            if state.failed_blocks:
                state.failed_blocks.discard(block)
                if state.failed_blocks:
                    continue
            if not self._read(state, now):
                good = False
        group.data = data if good else None

    def closed(self, channel: int, reason: str, now: int) -> None:
        """Mark the points of a closed channel as failed if they were never read. Others become stale with age."""
        for state in self._states.values():
            if state.point.channel == channel and state.value.value is None and state.value.quality != "good":
                self._fail(state, reason, now)

    def forget_changes(self) -> None:
        """Discard changes of memory before the start, for points that blocks store."""
        self._changed = {name: state for name, state in self._changed.items() if not state.point.blocks}

    def tick(self, now: int) -> None:
        """Read the points whose memory has changed, and mark points that are too old."""
        if self._changed:
            changed, self._changed = self._changed, {}
            for state in changed.values():
                if not state.failed_blocks and self._read(state, now):
                    for group in state.groups:
                        group.read_at = now
                        self._wait(group, now + group.stale)
        while self._ages and self._ages[0][0] <= now:
            _, _, group = heapq.heappop(self._ages)
            group.waits = False
            due = group.read_at + group.stale
            self._wait(group, due if due > now else self._grown_old(group, now))

    def _grown_old(self, group: _ReadGroup, now: int) -> int:
        """Mark the points of a group that are too old; return when the next point is."""
        due = NEVER
        for state in group.states:
            if state.value.quality == "good":
                end = state.last_read + state.point.stale
                if end > now:
                    due = min(due, end)
                    continue
                age = f"not read for {format_time(state.point.stale)}"
                self._tell(state, replace(self._value(state), quality="stale", reason=age, time=self.wall(now)))
                self._is_new(state)
                self.on_quality(state.point, "stale", age)
        return due

    @staticmethod
    def _is_new(state: _State) -> None:
        """Clear the stored bytes, so that the next read counts as a change."""
        state.data = None
        for group in state.groups:
            group.data = None

    def _wait(self, group: _ReadGroup, due: int) -> None:
        """Add a group to the queue for ages, unless it is in the queue or never becomes stale."""
        if not group.waits and due < NEVER:
            group.waits = True
            heapq.heappush(self._ages, (due, next(self._order), group))

    @property
    def deadline(self) -> int:
        """Return when the next point may be too old."""
        return self._ages[0][0] if self._ages else NEVER

    def _read(self, state: _State, now: int) -> bool:
        """Read a point, independent of its blocks; return whether it is good."""
        data = state.read()
        state.read_at = now
        if data == state.data:
            return True
        try:
            number = state.decode(data)
        except ValueError as error:
            self._fail(state, str(error), now)
            self.on_quality(state.point, "failed", str(error))
            return False
        is_other = state.value.quality != "good"
        state.data, state.number, state.made_at = data, number, -1
        deadband = state.point.deadband
        if is_other or (number != state.told and (not deadband or _differs(state.point, number, state.told))):
            state.told = number
            if is_other:
                self.on_quality(state.point, "good", "")
            if is_other or self.listeners:
                self._tell(state, self._make(state, now))
        return True

    def _fail(self, state: _State, reason: str, now: int) -> None:
        """Mark a point as failed. A failed point with another reason is updated, but not reported."""
        before = self._value(state)
        self._is_new(state)
        value = replace(before, quality="failed", reason=reason, time=self.wall(now))
        if before.quality == "failed":
            state.value = value
        else:
            self._tell(state, value)

    def _tell(self, state: _State, value: PointValue) -> None:
        state.value = value
        for listener in tuple(self.listeners):
            try:
                listener(value)
            except Exception:  # a listener may raise anything; the run goes on
                log.exception("point %s: what listens to it has failed", value.name)


def _reason(failure: Failure) -> str:
    """Return why a block failed; for a closed channel, why it is closed."""
    return failure.cause if failure.outcome == "closed" and failure.cause else str(failure)


def _differs(point: Point, number: Any, told: Any) -> bool:
    if point.deadband and isinstance(number, (int, float)) and isinstance(told, (int, float)):
        return EXACT.abs(EXACT.subtract(Decimal(repr(number)), Decimal(repr(told)))) > Decimal(repr(point.deadband))
    return bool(number != told)
