"""Functions of expressions that need the engine: queues, the device's memory, the clock."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from framekit.link.clock import with_date

if TYPE_CHECKING:
    from framekit.link.machine import Machine


class EngineFunctions:
    """What expressions find under the name `functions`."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    def empty(self, queue: str) -> int:
        return int(self._machine.queues.empty(queue))

    def full(self, queue: str) -> int:
        return int(self._machine.queues.full(queue))

    def memory(self, address: str, size: int) -> bytes:
        """Bytes of the device's memory. Raises ValueError."""
        if self._machine.memory is None:
            raise ValueError("there is no memory to read")
        return self._machine.memory.read(address, size)

    def with_date(self, clock: Mapping[str, int], frame: Any, mode: int | str) -> dict[str, int]:
        return with_date(clock, frame, mode)
