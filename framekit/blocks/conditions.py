"""Conditions over device memory: expressions whose names are addresses, such as `M00002` or `MW10 > 5 and not F00099`.

A condition knows which words it reads, so that it is only looked at when one of them changes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from framekit.definition.expression.syntax import Expression, Name, names_in
from framekit.link.addresses import Address
from framekit.link.evaluate import EVALUATION_ERRORS, Names, compile_expression
from framekit.memory.memory import DeviceMemory

Resolve = Callable[[str], Address]


class Condition:
    """An expression over a memory; `addresses` are the places it reads, by the names it uses."""

    def __init__(self, expression: Expression, resolve: Resolve) -> None:
        self.expression = expression
        self.addresses = {name: resolve(name) for name in names_in(expression.root)}
        self._evaluate = compile_expression(expression)
        root = expression.root
        self._bit = self.addresses[root.name] if isinstance(root, Name) else None
        if self._bit is not None and self._bit.unit != "bit":
            self._bit = None

    def reader(self, memory: DeviceMemory) -> Callable[[], bool]:
        """Tells at every call whether it is true in this memory then; a condition that cannot be worked out is not."""
        bit = self._bit
        if bit is not None:  # most conditions are a bit, and nothing stands between a write and what it triggers
            return partial(memory.area(bit.area).read_bit, bit.start)
        return partial(self._holds, memory)

    def number_reader(self, memory: DeviceMemory) -> tuple[Callable[[], int], int]:
        """As `reader`, for whoever looks after each write: what reads a number, and the bit of it that says so.

        Of a bit it reads the byte, which takes no call of Python between a write and what it triggers.
        """
        bit = self._bit
        if bit is not None:
            return memory.area(bit.area).byte_reader(bit.start // 8), 1 << bit.start % 8
        return partial(self._holds, memory), 1

    def _holds(self, memory: DeviceMemory) -> bool:
        values = {
            name: memory.read(place.area, place.unit, place.start, 1)[0] for name, place in self.addresses.items()
        }
        try:
            return bool(self._evaluate(Names(values)))
        except EVALUATION_ERRORS:
            return False
