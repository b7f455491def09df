"""A device's memory as its engine reaches it: by addresses written as users write them, and through a server.

Bits that the memory sets by itself (clocks, say) are brought up to date before anybody looks.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta

from framekit.link.addresses import Address, AddressGrammar
from framekit.link.clock import DEFAULT_START
from framekit.memory.memory import DeviceMemory, DeviceMemoryError
from framekit.transport.clock import AsyncioClock, Clock

Refresh = Callable[[], None]


def date_at(clock: Clock) -> Callable[[int], datetime]:
    """The date at a time of this clock: today's where it is real, and from 2000 on where it is not."""
    if isinstance(clock, AsyncioClock):
        return lambda now: datetime.now()
    return lambda now: DEFAULT_START + timedelta(microseconds=now // 1000)


class AddressedMemory:
    """`memory('M0', 24)` and `store` of the language on a device memory. Raises ValueError for what is not there."""

    def __init__(self, memory: DeviceMemory, grammar: AddressGrammar, refresh: Refresh = lambda: None) -> None:
        self.memory = memory
        self.grammar = grammar
        self.refresh = refresh

    def read(self, address: str, size: int) -> bytes:
        self.refresh()
        place = self._place(address)
        try:
            return self.memory.read_bytes(place.area, place.first_bit // 8, size)
        except DeviceMemoryError as error:
            raise ValueError(str(error)) from None

    def write(self, address: str, data: bytes) -> None:
        place = self._place(address)
        try:
            self.memory.write_bytes(place.area, place.first_bit // 8, data, force=True)
        except DeviceMemoryError as error:
            raise ValueError(str(error)) from None

    def _place(self, address: str) -> Address:
        place = self.grammar.parse(address)
        if place.first_bit % 8:
            raise ValueError(f"{address} is in the middle of a byte")
        return place
