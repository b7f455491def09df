"""The fields of a SEND block's frame: what the block says itself, and what stands in the own memory when it is sent.

Where in memory that is, and what it becomes there, is worked out once for a block; its settings make another block.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from framekit.blocks.fields import FramePart, fixed_bytes, from_memory, takes_bytes
from framekit.blocks.model import Block, Place
from framekit.blocks.own_memory import piece_reader
from framekit.definition.model.segments import Field
from framekit.memory.memory import DeviceMemory

Read = Callable[[], Any]


class FrameFields:
    """The fields of one SEND block: those that are the same every time, and what reads the others.

    Raises ValueError where nobody says how long data are, UnknownAreaError.
    """

    def __init__(self, block: Block, parts: Mapping[str, FramePart], memory: DeviceMemory) -> None:
        self.block = block
        self.constants: dict[str, Any] = dict(block.values or {})
        self.readers = tuple(
            (name, field_reader(parts[name], place, block.sizes.get(name), memory))
            for name, place in block.data.items()
        )

    def read(self) -> dict[str, Any]:
        """The fields as they are now. Raises DeviceMemoryError, ValueError."""
        fields = self.constants.copy()
        for name, read in self.readers:
            fields[name] = read()
        return fields


def field_reader(part: FramePart, place: Place, size: int | None, memory: DeviceMemory) -> Read:
    """Reads the value of a field from its place at every call; `size` bytes where it takes as many as one likes."""
    if not takes_bytes(part):
        return partial(_converted, part, place, piece_reader(memory, place, place.address.unit_bits))
    if size is None:
        size = fixed_bytes(part)
    if size is None:
        raise ValueError(f"the size of '{part.name}' is not known – give the block size: {{{part.name}: N}}")
    read = piece_reader(memory, place, 8 * size)
    is_text = isinstance(part, Field) and part.type.kind == "ascii"
    return partial(_converted, part, place, read) if is_text else read


def _converted(part: FramePart, place: Place, read: Callable[[], bytes]) -> Any:
    return from_memory(part, place, read())
