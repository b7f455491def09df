"""The lanes of a run, and when each wants to be looked at: of many channels only those with something to do are asked.

Which block of a lane goes first is the lane's business; what makes blocks wait there is not known here.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Collection, Hashable, Sequence

from framekit.blocks.block_state import BlockState
from framekit.blocks.lanes import Lane, LaneRules
from framekit.definition.times import NEVER


class Turns:
    """Lanes by number. Whoever changes a lane says so by `stir`; `due` then names it when its time has come."""

    def __init__(self, station_of: Callable[[BlockState], Hashable]) -> None:
        self.lanes: dict[int, Lane] = {}
        self._station_of = station_of
        self._number = itertools.count()
        self._heap: list[tuple[int, int, Lane]] = []

    def add(self, number: int, rules: LaneRules) -> Lane:
        """The lane of this number, which is made if there is none."""
        lane = self.lanes.get(number)
        if lane is None:
            lane = self.lanes[number] = Lane(rules, self._station_of, next(self._number))
        return lane

    def remove(self, number: int) -> None:
        """Nothing waits there any more."""
        del self.lanes[number]

    def hold(self, numbers: Collection[int]) -> None:
        """Nothing starts in these lanes until the next call; in all others it does."""
        for number, lane in self.lanes.items():
            lane.held = number in numbers
            self.stir(lane)

    def idle(self, numbers: Collection[int]) -> bool:
        """Whether nothing runs in any of these lanes."""
        return not any(self.lanes[number].busy for number in numbers if number in self.lanes)

    def clear(self, which: Callable[[BlockState], bool] = lambda state: True) -> None:
        """Forgets blocks that wait."""
        for lane in self.lanes.values():
            lane.clear(which)

    def stir(self, lane: Lane) -> None:
        """Something about the lane is different: it may have something to do at another time."""
        when = lane.deadline
        if when < lane.asked_for:
            lane.asked_for = when
            heapq.heappush(self._heap, (when, lane.order, lane))

    def due(self, now: int) -> Sequence[Lane]:
        """Lanes that may start something now, in their order; each has to be stirred afterwards."""
        heap, found = self._heap, []
        while heap and heap[0][0] <= now:
            when, _, lane = heapq.heappop(heap)
            if when == lane.asked_for:
                lane.asked_for = NEVER
                if lane.deadline <= now:
                    found.append(lane)
                else:
                    self.stir(lane)
        if len(found) > 1:
            found.sort(key=lambda lane: lane.order)
        return found

    @property
    def deadline(self) -> int:
        """When the first of them has something to do."""
        heap = self._heap
        while heap:
            when, _, lane = heap[0]
            if when == lane.asked_for == lane.deadline:
                return when
            heapq.heappop(heap)
            if when == lane.asked_for:
                lane.asked_for = NEVER
                self.stir(lane)
        return NEVER
