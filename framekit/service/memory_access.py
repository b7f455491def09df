"""A device's memory as sequences see it: bytes at addresses written as users write them."""

from __future__ import annotations

from framekit.link.addresses import AddressGrammar
from framekit.memory.memory import DeviceMemory


class AddressedMemory:
    """`memory('M0', 24)` and `store` of the language on a device memory. Raises ValueError for what is not there."""

    def __init__(self, memory: DeviceMemory, grammar: AddressGrammar) -> None:
        self.memory = memory
        self.grammar = grammar

    def read(self, address: str, size: int) -> bytes:
        place = self.grammar.parse(address)
        return self.memory.read_bytes(place.area, place.first_bit // 8, size)

    def write(self, address: str, data: bytes) -> None:
        place = self.grammar.parse(address)
        self.memory.write_bytes(place.area, place.first_bit // 8, data, force=True)
