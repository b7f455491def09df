"""Reads what starts a block: cycles, conditions over the own memory, ends of other blocks."""

from __future__ import annotations

import re
from collections.abc import Callable

from framekit.definition.expression.syntax import Expression
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Mapping, Node
from framekit.definition.times import NEVER
from framekit.link.addresses import Address
from framekit.run.model import After, BlockEnd, Changed, Every, Place, Rising, Trigger, While
from framekit.run.triggers import bits_of

_BLOCK_END = re.compile(r"block\s+(\d+)\s+(done|failed)")
STARTS = ("every", "when", "while", "on_change", "once", "after")


class TriggerLoader:
    """Reads triggers; `place` and `condition` read the own memory's addresses, `room` notes what is beyond an area."""

    def __init__(
        self, reader: Reader, place: Callable[[Node], Place], condition: Callable[[Node], Expression],
        room: Callable[[Node, Address, int], None],
    ) -> None:  # fmt: skip
        self.reader = reader
        self.place = place
        self.condition = condition
        self.room = room
        self.ends: list[tuple[BlockEnd, Node]] = []

    def triggers(self, keys: Mapping) -> tuple[Trigger, ...]:
        """All triggers of a block. Raises Broken after all of them have been looked at."""
        reader = self.reader
        found: list[Trigger] = []
        broken = False
        for item in (*reader.items(keys.get("when")), *(keys.get(key) for key in STARTS if key != "when")):
            if item is None:
                continue
            try:
                trigger = self._trigger(keys, item)
            except Broken:
                broken = True
                continue
            if trigger is not None:
                found.append(trigger)
        if broken:
            raise Broken("triggers")
        return tuple(found)

    def _trigger(self, keys: Mapping, node: Node) -> Trigger | None:
        """The trigger that `node` is the value of, or an item of `when`."""
        if node is keys.get("every"):
            return self._every(keys, node)
        if node is keys.get("while"):
            return While(condition=self.condition(node))
        if node is keys.get("on_change"):
            return self._changed(keys, node)
        if node is keys.get("once"):
            return After(delay=0) if self.reader.flag(node) else None
        if node is keys.get("after"):
            return After(delay=self._some_time(node))
        return self._when(node)

    def _some_time(self, node: Node) -> int:
        time = self.reader.time(node)
        if time >= NEVER:
            raise self.reader.broken(node.at, "never is no time to start at", "give a time such as 200 ms")
        return time

    def _every(self, keys: Mapping, node: Node) -> Trigger:
        period = self._some_time(node)
        if period <= 0:
            raise self.reader.broken(node.at, "a cycle of no time never ends", "give a time such as 200 ms")
        phase = keys.get("phase")
        return Every(period=period, phase=period if phase is None else self._some_time(phase))

    def _changed(self, keys: Mapping, node: Node) -> Trigger:
        address = self.place(node).address
        words = None if (count := keys.get("words")) is None else self.reader.number(count)
        if words is not None and words < 1 and count is not None:
            raise self.reader.broken(count.at, f"{words} words never change", "give 1 or more")
        trigger = Changed(address=address, words=words)
        self.room(node if count is None else count, address, bits_of(trigger))
        return trigger

    def _when(self, node: Node) -> Trigger:
        text = self.reader.text(node).strip()
        match = _BLOCK_END.fullmatch(text)
        if match is None and re.match(r"block\s", text):
            raise self.reader.broken(node.at, f"'{text}' is no end of a block", "write block N done or block N failed")
        if match is None:
            return Rising(condition=self.condition(node))
        end = BlockEnd(block=int(match[1]), ok=match[2] == "done")
        self.ends.append((end, node))
        return end

    def check_ends(self, numbers: set[int]) -> None:
        """Notes triggers that wait for a block there is not."""
        for end, node in self.ends:
            if end.block not in numbers:
                known = ", ".join(map(str, sorted(numbers)))
                self.reader.note(node.at, f"there is no block {end.block} to wait for", f"known: {known}")
        self.ends.clear()
