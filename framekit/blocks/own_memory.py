"""The own memory at the places of a run: pieces of it in memory's form, read and stored whole.

Everything goes by bits over the whole area, so a double word may begin at any word. What cannot be stored is refused
before anything is changed. What a piece means is not known here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from framekit.blocks.model import Place
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import AddressForm, Area
from framekit.definition.model.values import Table
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.memory.memory import AccessError, DeviceMemory, MemoryRangeError
from framekit.memory.profile import MemoryProfile

Piece = tuple[Place, int, bytes]
"""A place, how many bits from there on, and what they are, in memory's form."""

_LIKE_AN_ADDRESS = re.compile(r"%?\w[\w.:/]*")


class OwnAddresses(AddressGrammar):
    """The addresses of a memory: its forms, and the names that its profile gives to single places."""

    def __init__(
        self, forms: Sequence[AddressForm], areas: Mapping[str, Area], tables: Mapping[str, Table],
        names: Mapping[str, str],
    ) -> None:  # fmt: skip
        super().__init__(forms, areas, tables)
        self._names = names

    def parse(self, text: str, unit: str | None = None, *, check: bool = True) -> Address:
        """As for every grammar; a name stands for its address."""
        return super().parse(self._names.get(text.strip(), text), unit, check=check)


class AnyAddresses(OwnAddresses):
    """Stands for the addresses of a memory whose description is wrong: what looks like an address is taken for one.

    So everything else that a file says can still be looked at.
    """

    def __init__(self) -> None:
        super().__init__((), {}, {}, {})

    def parse(self, text: str, unit: str | None = None, *, check: bool = True) -> Address:
        """A place as wide as there are. Raises AddressError for what has blanks or operators in it."""
        text = text.strip()
        if _LIKE_AN_ADDRESS.fullmatch(text) is None:
            raise AddressError(f"'{text}' is not an address – write it as one word")
        return Address("", unit or "lword", 0, text, type="float64")

    def check(self, address: Address, count: int = 1) -> None:
        """There is room everywhere."""


class ProtocolAddresses(AddressGrammar):
    """The addresses of a memory that has a protocol's areas, those in `sizes` as large as there.

    An area stands there under its `memory` name; an address form may say another one by a result `memory`.
    """

    def __init__(self, protocol: Protocol, sizes: Mapping[str, Area] | None = None) -> None:
        super().__init__(protocol.addresses, protocol.areas, protocol.tables)
        self._memory = {name: area.memory for name, area in protocol.areas.items()}
        self._there = {area.memory: area for area in protocol.areas.values()} | dict(protocol.areas) | dict(sizes or {})

    def place(self, text: str, unit: str | None = None) -> Address:
        """The place in memory, which need not be there; the part `area` is the area of the protocol."""
        address = super().parse(text, unit, check=False)
        memory = str(address.parts.get("memory") or self._memory[address.area])
        return replace(address, area=memory, parts={**address.parts, "area": address.area})

    def parse(self, text: str, unit: str | None = None, *, check: bool = True) -> Address:
        """As for every grammar; `area` is the memory's."""
        address = self.place(text, unit)
        if check:
            self.check(address)
        return address

    def check(self, address: Address, count: int = 1) -> None:
        """As for every grammar. Raises AddressError for an area that the memory does not have, too."""
        area = self._there.get(address.area)
        if area is None or not area.size:
            what = f"{address} is in {address.area}, which this memory does not have"
            raise AddressError(f"{what} – say under 'sizes' how many elements it has")
        self.check_in(area, address, count)


def addresses_of(profile: MemoryProfile) -> OwnAddresses:
    """The addresses of a memory with this profile."""
    names = {name: place.address for name, place in profile.named.items()}
    return OwnAddresses(profile.addresses, profile.areas, profile.tables, names)


def read_piece(memory: DeviceMemory, place: Place, bits: int) -> bytes:
    """`bits` bits from a place on, in memory's form. Raises DeviceMemoryError."""
    return piece_reader(memory, place, bits)()


def piece_reader(memory: DeviceMemory, place: Place, bits: int) -> Callable[[], bytes]:
    """Does the same at every call. Raises UnknownAreaError."""
    area, first = memory.area(place.address.area), place.address.first_bit
    if first % 8 == 0 and bits % 8 == 0:
        return area.bytes_reader(first // 8, bits // 8)
    return partial(area.read_bits, first, bits)


def piece_writer(memory: DeviceMemory, place: Place, bits: int) -> Callable[[bytes], None]:
    """`store_pieces` for one piece, to be called again and again. Raises UnknownAreaError."""
    area, first = memory.area(place.address.area), place.address.first_bit
    if area.access == "read" or first + bits > area.size_bits:
        return lambda data: store_pieces(memory, [(place, bits, data)])
    if first % 8 == 0 and bits % 8 == 0:
        return partial(area.write_bytes, first // 8)
    return partial(area.write_bits, first, bits)


def store_pieces(memory: DeviceMemory, pieces: Sequence[Piece]) -> None:
    """Stores all pieces, or, when one cannot be stored, none. Raises DeviceMemoryError."""
    for place, bits, _ in pieces:
        area = memory.area(place.address.area)
        if area.access == "read":
            raise AccessError(f"{place.text} is in area {area.name}, which can only be read")
        if place.address.first_bit + bits > area.size_bits:
            raise MemoryRangeError(f"{bits} bits from {place.text} on are not in area {area.name}")
    for place, bits, data in pieces:
        area, first = memory.area(place.address.area), place.address.first_bit
        if first % 8 == 0 and bits % 8 == 0:
            area.write_bytes(first // 8, data)
        else:
            area.write_bits(first, bits, data)
