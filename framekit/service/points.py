"""The points of a run at run time: their values follow the blocks and the memory, and programs write some of them.

A simulated device has points too: places with a behaviour, and places with a start value, by name or address. All these
points are writable, also those that are read-only for clients.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

from framekit.definition.problems import NOWHERE, no_such
from framekit.definition.times import NEVER
from framekit.link.packing import memory_of, typed_at
from framekit.memory.memory import DeviceMemory
from framekit.run.block_state import BlockState, Failure
from framekit.run.model import Block, OwnPlace, Point
from framekit.run.own_memory import piece_writer
from framekit.run.points import PointTable, unscaled
from framekit.runfile.devices import Device
from framekit.service.device import DeviceStore
from framekit.service.run_loop import RunLoop
from framekit.transport.clock import Clock, utc_at

log = logging.getLogger(__name__)

Written = Callable[[Failure | None], None]
"""Called once with the result of the writing of a point; None for success."""


MOST_WAITING = 64
"""Maximum number of waiting values per point; further values are refused."""


class PointService:
    """The points of one memory.

    `fire` makes a block due by its id. `at_work`: the run has started and not ended. `force`: write to areas that are
    read-only for clients. `read_only`: refuse all writes, also to points with `access: rw`.
    """

    def __init__(
        self, points: Iterable[Point], blocks: Iterable[Block], memory: DeviceMemory, clock: Clock,
        wake: Callable[[], None], fire: Callable[[int], None], *, force: bool = False, read_only: bool = False,
    ) -> None:  # fmt: skip
        self.table = PointTable(points, memory, utc_at(clock), wake)
        self._memory, self._clock, self._wake, self._fire, self._force = memory, clock, wake, fire, force
        self._read_only = read_only
        self._blocks: dict[int, Block] = {block.id: block for block in blocks}
        self.at_work = False
        self._waiting: dict[int, deque[tuple[bytes, Written]]] = {}

    # ---- events ---------------------------------------------------------------------------------------------

    def ended(self, state: BlockState, ok: bool, now: int) -> None:
        """Update the points of a block that has ended."""
        failure = None if ok else state.last_failure
        if self.table.follows(state.id):
            self.table.ended(state.id, failure, now)
        waiting = self._waiting.get(state.id)
        if waiting:
            self._has_written(state.block, waiting, failure)

    def tick(self, now: int) -> None:
        """Update points whose memory has changed, and points that are too old."""
        self.table.tick(now)

    @property
    def deadline(self) -> int:
        """Return the time of the next `tick`."""
        return self.table.deadline

    # ---- writing ------------------------------------------------------------------------------------------

    def write(self, name: str, value: Any, who: str, written: Written = lambda failure: None) -> None:
        """Write a scaled value; `who` is the sender for the log. `written` is called with the result.

        Raise ValueError without writing for an unknown point, a point that is not writable, and a value that does not
        fit.
        """
        point = self.point(name)
        if self._read_only:
            log.warning("point %s: %r was refused to %s: this run only reads", name, value, who)
            raise ValueError(f"'{name}' can only be read: this run only reads – run the file without --read-only")
        if not point.is_writable:
            raise ValueError(f"'{name}' can only be read – access: rw of the point allows it")
        form = point.form
        data = memory_of(form.numbers([unscaled(point, value)]), form.carrier)
        log.info("point %s: %r → %r, written by %s", name, self.table[name].value, value, who)
        if point.writer is None:
            piece_writer(self._memory, point.place, point.bits, force=self._force)(data)
            self._wake()
            _tell(written, None)
            return
        if not self.at_work:
            raise ValueError(f"'{name}' cannot be written: the run is not at work")
        waiting = self._waiting.setdefault(point.writer, deque())
        if len(waiting) >= MOST_WAITING:
            raise ValueError(f"{MOST_WAITING} values for '{name}' wait to be written – nothing answers on its channel")
        waiting.append((data, written))
        if len(waiting) == 1:
            self._begin(self._blocks[point.writer], waiting)

    def _begin(self, block: Block, waiting: deque[tuple[bytes, Written]]) -> None:
        """Store the first waiting value at the place from which the block writes it, and start the block."""
        data, _ = waiting[0]
        piece_writer(self._memory, block.places[0], 8 * len(data))(data)
        self._fire(block.id)

    def _has_written(self, block: Block, waiting: deque[tuple[bytes, Written]], failure: Failure | None) -> None:
        """Begin the next write, or read the point again if none is waiting; then report the result."""
        _, written = waiting.popleft()
        if waiting:
            self._begin(block, waiting)
        elif failure is None:
            for reader in self.table.point(block.name).blocks:
                self._fire(reader)
        _tell(written, failure)

    def give_up(self, why: str) -> None:
        """Report all waiting writes as failed."""
        for waiting in self._waiting.values():
            while waiting:
                _tell(waiting.popleft()[1], Failure(outcome="closed", cause=why))

    def point(self, name: str) -> Point:
        """Return the description of a point. Raise ValueError for an unknown point."""
        try:
            return self.table.point(name)
        except KeyError:
            raise ValueError(no_such("there is no point", name, (one.name for one in self.table))) from None


def _tell(written: Written, failure: Failure | None) -> None:
    """Report the result of a write; an exception of the program that requested it does not stop the run."""
    try:
        written(failure)
    except Exception:
        log.exception("what waited for a point to be written has failed")


# ---- points of a simulated device ------------------------------------------------------------------------------


MOST_OF_A_ROW = 64
"""Maximum number of points for the values of one start value."""


def points_of(device: Device) -> dict[str, Point]:
    """Return the points of a device by name, places with a behaviour first."""
    found: dict[str, Point] = {}
    taken: set[tuple[str, int]] = set()
    for behaviour in sorted(device.behaviours, key=lambda one: (one.at.line, one.at.column)):
        place = behaviour.place
        name = behaviour.name or place.address
        found[name] = replace(place, name=name, is_writable=True, stale=NEVER, about=behaviour.word)
        taken.update(_bits(place))
    for start, values in device.initial:
        for number in range(min(len(values), MOST_OF_A_ROW)):
            point = _started(device, start, number)
            if point is not None and taken.isdisjoint(_bits(point)):
                found.setdefault(point.name, point)
    return found


def _bits(point: Point) -> Iterator[tuple[str, int]]:
    place = point.place.address
    return ((place.area, bit) for bit in range(place.first_bit, place.first_bit + point.bits))


def _started(device: Device, place: OwnPlace, number: int) -> Point | None:
    """Return the point of a start value; None if no text names its place."""
    address = device.grammar.advance(place.address, number) if number else place.address
    text = address.text if number else place.text
    if not text:
        return None
    form = typed_at(device.grammar, text, address.unit, None, 1)
    return Point(
        name=text, form=form, place=OwnPlace(address=address, text=text), address=text, is_writable=True,
        at=NOWHERE,
    )  # fmt: skip


def begun_points(stores: Iterable[DeviceStore], clock: Clock) -> list[DevicePoints]:
    """Return the points of each device, updated until they are stopped; of a device over two protocols once."""
    found = [DevicePoints(store.device, store.memory, clock) for store in stores if not store.device.shares]
    for one in found:
        one.start()
    return found


class DevicePoints:
    """The points of a device with this memory, between `start` and `stop`."""

    def __init__(self, device: Device, memory: DeviceMemory, clock: Clock) -> None:
        self.loop = loop = RunLoop(clock, lambda now: self.service.tick(now), lambda: self.service.deadline)
        self.service = PointService(
            points_of(device).values(), (), memory, clock, loop.wake, lambda block: None, force=True
        )  # fmt: skip

    def start(self) -> None:
        """Begin to update the points."""
        self.loop.start()
        self.service.tick(self.loop.clock.now())

    def stop(self) -> None:
        """Stop updates; the points keep their values."""
        self.loop.stop()
