"""Device memory: areas of bytes under their names, little-endian, with watches that report changes.

An area is accessed as bits, bytes, words, double words or long words. Every view counts from 0 in its own unit over the
whole area: byte 3 is the high byte of word 1, bit 17 is bit 1 of word 1, dword 2 is words 4 and 5. Memory has neither
addresses nor a clock; it is used by one thread.
"""

from __future__ import annotations

import itertools
import struct
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, partial, reduce
from operator import or_
from typing import Literal, TypeVar

from framekit.codec.support import swap
from framekit.definition.model.services import UNIT_BITS
from framekit.definition.problems import no_such


class DeviceMemoryError(Exception):
    """Base class of refusals of the device memory."""


class UnknownAreaError(DeviceMemoryError, LookupError):
    """The memory has no area of this name."""


class MemoryRangeError(DeviceMemoryError, IndexError):
    """A place beyond the area."""


class AccessError(DeviceMemoryError):
    """A write to an area that is read-only for others."""


class MemoryValueError(DeviceMemoryError, ValueError):
    """A value that does not fit its place."""


UNSIGNED_CODES = {8: "B", 16: "H", 32: "I", 64: "Q"}
"""Codes of unsigned numbers in `struct`, by their size in bits."""


@cache
def unit_bits(unit: str | int) -> int:
    """Return the width in bits of `bit`, `byte`, `word`, `dword`, `lword`, `6 bytes`, or of N bytes.

    Raises ValueError.
    """
    if isinstance(unit, str):
        known = UNIT_BITS.get(unit)
        if known is not None:
            return known
        number, _, kind = unit.partition(" ")
        if kind not in ("byte", "bytes") or not number.isdecimal():
            known_units = ", ".join(UNIT_BITS)
            raise ValueError(f"'{unit}' is not a unit – write {known_units}, or a size such as 6 bytes")
        unit = int(number)
    if unit < 1:
        raise ValueError("a unit has at least one byte")
    return 8 * unit


def pack_bits(bits: Sequence[int]) -> bytes:
    """Pack bits into bytes, the first in bit 0 of the first byte, padded with 0. Raises MemoryValueError."""
    if not bits:
        return b""
    for bit in bits:
        if bit != 0 and bit != 1:
            raise MemoryValueError(f"{bit} is not a bit – only 0 and 1 are")
    number = int("".join(["1" if bit else "0" for bit in reversed(bits)]), 2)
    return number.to_bytes((len(bits) + 7) // 8, "little")


def unpack_bits(data: bytes, count: int) -> list[int]:
    """Return the first `count` bits of `data`, bit 0 of the first byte first; bits after the data are 0."""
    if not count:
        return []
    number = int.from_bytes(data, "little") & ((1 << count) - 1)
    return [int(digit) for digit in reversed(f"{number:0{count}b}")]


def ordered(data: bytes, order: str, size: int) -> bytes:
    """Convert little-endian elements of `size` bytes to another order (as of fields), or back: each conversion is its
    own inverse.
    """
    if order == "little" or size < 2:
        return data
    swapped = swap(data, 2) if order == "BADC" and not size % 2 else data
    if order == "CDAB" and not size % 2:
        return swap(data, 2)
    if size in (2, 4, 8):
        return swap(swapped, size)
    return b"".join([swapped[at : at + size][::-1] for at in range(0, len(swapped), size)])


_PACK_WORD = struct.Struct("<H").pack
_SINGLE = {bits: struct.Struct(f"<{code}") for bits, code in UNSIGNED_CODES.items()}

Changed = Callable[["Area", int, int], None]
"""Callback with the area, the first changed word and the number of words from it to the last changed one."""

ALL_BITS = 0xFFFF

Content = TypeVar("Content")


class Area:
    """`size` elements of `unit`: bit, byte, word, dword, lword, `6 bytes`, or a number of bytes.

    `access` is `rw`, or `read` if only the owner, by `force=True`, may write. Values are unsigned. Methods raise
    MemoryRangeError for a place beyond the area, AccessError for a write that is not allowed, MemoryValueError for a
    value that does not fit, ValueError for an unknown unit.
    """

    __slots__ = (
        "_data",
        "_spare",
        "_watches",
        "access",
        "aliases",
        "element_bits",
        "name",
        "order",
        "size",
        "size_bits",
        "unit",
    )

    def __init__(
        self,
        name: str,
        *,
        size: int,
        unit: str | int = "word",
        access: Literal["rw", "read"] = "rw",
        aliases: Iterable[str] = (),
    ) -> None:
        if size < 1:
            raise ValueError(f"area {name} has no size")
        self.element_bits = unit_bits(unit)
        self.name = name
        self.unit = unit if isinstance(unit, str) else f"{unit} bytes"
        self.size = size
        self.access = access
        self.order = "little"
        self.aliases = tuple(aliases)
        self.size_bits = size * self.element_bits
        self._data = bytearray((self.size_bits + 7) // 8)
        self._spare = -self.size_bits % 8
        self._watches: WatchTable | None = None

    def __repr__(self) -> str:
        return f"<area {self.name}: {self.size} × {self.unit}, {self.access}>"

    def anew(self) -> Area:
        """Return an area of this kind, with the same properties, filled with 0."""
        return type(self)(self.name, size=self.size, unit=self.unit, access=self.access, aliases=self.aliases)

    @property
    def size_bytes(self) -> int:
        return len(self._data)

    @property
    def size_words(self) -> int:
        """Return the number of words of 16 bits; the last may be incomplete."""
        return (len(self._data) + 1) // 2

    # --- bytes

    def read_bytes(self, offset: int, count: int) -> bytes:
        """Return `count` bytes from byte `offset` on."""
        if offset < 0 or count < 0 or offset + count > len(self._data):
            raise self._beyond("byte", offset, count, len(self._data))
        return bytes(self._data[offset : offset + count])

    def bytes_reader(self, offset: int, count: int) -> Callable[[], bytes]:
        """Return a function that reads like `read_bytes`, for repeated calls without a Python frame."""
        if offset < 0 or count < 0 or offset + count > len(self._data):
            return partial(self.read_bytes, offset, count)
        return partial(bytes, memoryview(self._data)[offset : offset + count])

    def bytes_writer(self, offset: int, count: int) -> Callable[[bytes], None]:
        """Return a function that writes `count` bytes with `force`, for repeated calls: the range is checked once."""
        if offset < 0 or offset + count > len(self._data) - bool(self._spare):
            return partial(self.write_bytes, offset, force=True)
        return partial(self._store, offset)

    def byte_reader(self, offset: int) -> Callable[[], int]:
        """Return a function that returns byte `offset` as a number."""
        return partial(self._data.__getitem__, offset)

    def holder(self, offset: int, data: bytes) -> Callable[[], bool]:
        """Return a function that returns whether these bytes are present at byte `offset`."""
        return partial(self._data.startswith, data, offset)

    def write_bytes(self, offset: int, data: bytes, *, force: bool = False) -> None:
        """Write `data` at byte `offset`. Bits of the last byte that are beyond the area stay 0."""
        end = offset + len(data)
        if offset < 0 or end > len(self._data):
            raise self._beyond("byte", offset, len(data), len(self._data))
        if self.access == "read" and not force:
            raise self._read_only()
        if self._spare and data and end == len(self._data):
            data = data[:-1] + bytes([data[-1] & (0xFF >> self._spare)])
        self._store(offset, data)

    # --- numbers of any unit

    def read(self, unit: str | int, start: int, count: int = 1) -> list[int]:
        """Return `count` unsigned values of `unit`, from number `start` on."""
        bits = unit_bits(unit)
        self._within(unit, bits, start, count)
        if bits == 1:
            return unpack_bits(self.read_bits(start, count), count)
        size = bits // 8
        code = UNSIGNED_CODES.get(bits)
        if code is not None:
            return list(struct.unpack_from(f"<{count}{code}", self._data, start * size))
        data = self._data[start * size : (start + count) * size]
        return [int.from_bytes(data[at : at + size], "little") for at in range(0, len(data), size)]

    def write(self, unit: str | int, start: int, values: Sequence[int], *, force: bool = False) -> None:
        """Write unsigned `values` of `unit` from number `start` on, all or none."""
        may = force or self.access != "read"
        if may and unit == "word" and len(values) == 1 and 0 <= start < self.size_bits >> 4:
            try:  # the usual write, without detours
                data = _PACK_WORD(values[0])
            except struct.error:
                pass
            else:  # a write notifies its watches before any other access, as in `_put_word`
                memory, watches, at = self._data, self._watches, 2 * start
                mask = 0 if watches is None else watches.masks[start]
                changed = mask and mask & (memory[at] ^ data[0] | (memory[at + 1] ^ data[1]) << 8)
                memory[at : at + 2] = data
                if changed and watches is not None:
                    for watch in watches.by_word[start]:
                        if changed & watch.mask and watch.active:
                            watch.callback(self, start, 1)
                return
        bits = unit_bits(unit)
        if start < 0 or (start + len(values)) * bits > self.size_bits:
            raise self._beyond(unit, start, len(values), self.size_bits // bits)
        if not may:
            raise self._read_only()
        if bits == 1:
            self._put_bits(start, len(values), pack_bits(values))
            return
        self._store(start * bits // 8, _encode(values, bits))

    # --- numbers that begin at any bit

    def read_from(self, first_bit: int, unit: str | int, count: int = 1) -> list[int]:
        """Return `count` unsigned values of `unit`, of which the first begins at bit `first_bit`."""
        bits = unit_bits(unit)
        start, shift = divmod(first_bit, bits)
        if not shift:
            return self.read(unit, start, count)
        data, size = self.read_bits(first_bit, count * bits), bits // 8
        data = ordered(data, self.order, size)
        return [int.from_bytes(data[at : at + size], "little") for at in range(0, len(data), size)]

    def write_from(self, first_bit: int, unit: str | int, values: Sequence[int], *, force: bool = False) -> None:
        """Write unsigned `values` of `unit`, the first at bit `first_bit`, all or none."""
        bits = unit_bits(unit)
        start, shift = divmod(first_bit, bits)
        if not shift:
            self.write(unit, start, values, force=force)
            return
        data = ordered(_encode(values, bits), self.order, bits // 8)
        self.write_bits(first_bit, len(values) * bits, data, force=force)

    # --- bits, packed

    def read_bit(self, start: int) -> bool:
        """Return a bit."""
        if not 0 <= start < self.size_bits:
            raise self._beyond("bit", start, 1, self.size_bits)
        return bool(self._data[start >> 3] >> (start & 7) & 1)

    def read_bits(self, start: int, count: int) -> bytes:
        """Return `count` bits packed into bytes, the first in bit 0 of the first byte, unused bits 0."""
        self._within("bit", 1, start, count)
        if not count:
            return b""
        number = int.from_bytes(self._data[start >> 3 : (start + count + 7) >> 3], "little") >> (start & 7)
        return (number & ((1 << count) - 1)).to_bytes((count + 7) // 8, "little")

    def write_bits(self, start: int, count: int, data: bytes, *, force: bool = False) -> None:
        """Write the first `count` bits of `data`, packed as by `read_bits`; `data` must not have fewer."""
        self._within("bit", 1, start, count)
        if self.access == "read" and not force:
            raise self._read_only()
        if len(data) * 8 < count:
            raise MemoryValueError(f"{len(data)} bytes do not hold {count} bits")
        self._put_bits(start, count, data)

    # --- change

    def watch(self, first_word: int, count: int, callback: Changed, mask: int = ALL_BITS) -> Watch:
        """Call `callback(area, word, words)` once for every write that changes a watched word; return the watch.

        `mask`: only the bits that are 1 there are watched, in each word. The calls follow the order of registration,
        after the data are stored, with the first changed word and the number of words up to the last changed word. A
        callback should note the change and return: if it writes to a watched word itself, later watches are called for
        that second write first.
        """
        if first_word < 0 or count < 1 or first_word + count > self.size_words:
            raise self._beyond("word", first_word, count, self.size_words)
        if self._watches is None:
            self._watches = WatchTable(self.size_words)
        watch = Watch(self._watches, self, first_word, count, callback, mask)
        self._watches.add(watch)
        return watch

    def _store(self, offset: int, data: bytes) -> None:
        end = offset + len(data)
        watches = self._watches
        if watches is None or not data:
            self._data[offset:end] = data
        elif offset >> 1 == (end - 1) >> 1:
            if len(data) == 2:
                self._put_word(offset >> 1, data)
            else:
                self._put_byte(watches, offset, data)
        elif watches.marks.find(1, offset >> 1, (end + 1) >> 1) < 0:
            self._data[offset:end] = data
        else:
            first, stop = offset >> 1, (end + 1) >> 1
            before = bytes(self._data[2 * first : 2 * stop])
            self._data[offset:end] = data
            after = bytes(self._data[2 * first : 2 * stop])
            if before != after:
                for watch, word, count in watches.changed(first, before, after):
                    if watch.active:
                        watch.callback(self, word, count)

    def _put_word(self, word: int, data: bytes) -> None:
        memory, watches, at = self._data, self._watches, 2 * word
        mask = 0 if watches is None else watches.masks[word]
        changed = mask and mask & (memory[at] ^ data[0] | (memory[at + 1] ^ data[1]) << 8)
        memory[at : at + 2] = data
        if changed and watches is not None:
            self._tell(watches, word, changed)

    def _put_byte(self, watches: WatchTable, offset: int, data: bytes) -> None:
        changed = (self._data[offset] ^ data[0]) << 8 * (offset & 1) & watches.masks[offset >> 1]
        self._data[offset] = data[0]
        if changed:
            self._tell(watches, offset >> 1, changed)

    def _tell(self, watches: WatchTable, word: int, changed: int) -> None:
        """Call the watches of the bits that have changed in a word."""
        for watch in watches.by_word[word]:
            if changed & watch.mask and watch.active:
                watch.callback(self, word, 1)

    def _put_bits(self, start: int, count: int, data: bytes) -> None:
        if not count:
            return
        first, stop = start >> 3, (start + count + 7) >> 3
        shift = start & 7
        mask = ((1 << count) - 1) << shift
        old = int.from_bytes(self._data[first:stop], "little")
        new = (old & ~mask) | (int.from_bytes(data, "little") << shift & mask)
        self._store(first, new.to_bytes(stop - first, "little"))

    # --- refusals

    def _read_only(self) -> AccessError:
        return AccessError(f"area {self.name} can only be read")

    def _within(self, unit: str | int, bits: int, start: int, count: int) -> None:
        if start < 0 or count < 0 or (start + count) * bits > self.size_bits:
            raise self._beyond(unit, start, count, self.size_bits // bits)

    def _beyond(self, unit: str | int, start: int, count: int, there: int) -> MemoryRangeError:
        asked = f"{unit} {start}" if count == 1 else f"{count} × {unit} from {start} on"
        has = f"{unit} 0 to {there - 1}" if there else f"no whole {unit}"
        return MemoryRangeError(f"{asked} is not in area {self.name}, which has {has}")


class OrderedArea(Area):
    """An area whose elements of several bytes do not begin with the low byte: `order` is big, CDAB or BADC.

    Bytes are in the order of the device: byte 2 is the high byte of word 1 if the order is big.
    """

    __slots__ = ()

    def __init__(self, name: str, *, size: int, unit: str | int = "word", order: str) -> None:
        super().__init__(name, size=size, unit=unit)
        self.order = order

    def anew(self) -> OrderedArea:
        return OrderedArea(self.name, size=self.size, unit=self.unit, order=self.order)

    def read(self, unit: str | int, start: int, count: int = 1) -> list[int]:
        bits = unit_bits(unit)
        if bits <= 8:
            return super().read(unit, start, count)
        self._within(unit, bits, start, count)
        size = bits // 8
        data = ordered(self.read_bytes(start * size, count * size), self.order, size)
        return [int.from_bytes(data[at : at + size], "little") for at in range(0, len(data), size)]

    def write(self, unit: str | int, start: int, values: Sequence[int], *, force: bool = False) -> None:
        bits = unit_bits(unit)
        if bits <= 8:
            super().write(unit, start, values, force=force)
            return
        self._within(unit, bits, start, len(values))
        self.write_bytes(start * bits // 8, ordered(_encode(values, bits), self.order, bits // 8), force=force)


class LateArea(Area):
    """An area whose owner writes a part of it late: before the area is read, written or watched.

    Without an owner it behaves as `Area`; functions that it returned before `own` do not call the owner.
    """

    _bring: Callable[[], None] | None = None
    """Let the owner write the late part."""
    _watched: Callable[[], None] | None = None
    """Report a new watch to the owner."""

    def own(self, bring: Callable[[], None], watched: Callable[[], None]) -> None:
        """Call `bring` before each access, so that the owner writes pending values; call `watched` before a new
        watch.
        """
        self._bring, self._watched = bring, watched

    def _up_to_date(self) -> None:
        if self._bring is not None:
            self._bring()

    def read_bytes(self, offset: int, count: int) -> bytes:
        self._up_to_date()
        return super().read_bytes(offset, count)

    def bytes_reader(self, offset: int, count: int) -> Callable[[], bytes]:
        return self._after_bringing(super().bytes_reader(offset, count))

    def byte_reader(self, offset: int) -> Callable[[], int]:
        return self._after_bringing(super().byte_reader(offset))

    def holder(self, offset: int, data: bytes) -> Callable[[], bool]:
        return self._after_bringing(super().holder(offset, data))

    def _after_bringing(self, read: Callable[[], Content]) -> Callable[[], Content]:
        """Return a function that calls `read` after the owner has written pending values."""
        bring = self._bring
        if bring is None:
            return read

        def look() -> Content:
            bring()
            return read()

        return look

    def write_bytes(self, offset: int, data: bytes, *, force: bool = False) -> None:
        self._up_to_date()
        super().write_bytes(offset, data, force=force)

    def bytes_writer(self, offset: int, count: int) -> Callable[[bytes], None]:
        bring, write = self._bring, super().bytes_writer(offset, count)
        if bring is None:
            return write

        def store(data: bytes) -> None:
            bring()
            write(data)

        return store

    def read(self, unit: str | int, start: int, count: int = 1) -> list[int]:
        self._up_to_date()
        return super().read(unit, start, count)

    def write(self, unit: str | int, start: int, values: Sequence[int], *, force: bool = False) -> None:
        self._up_to_date()
        super().write(unit, start, values, force=force)

    def read_bit(self, start: int) -> bool:
        self._up_to_date()
        return super().read_bit(start)

    def read_bits(self, start: int, count: int) -> bytes:
        self._up_to_date()
        return super().read_bits(start, count)

    def write_bits(self, start: int, count: int, data: bytes, *, force: bool = False) -> None:
        self._up_to_date()
        super().write_bits(start, count, data, force=force)

    def watch(self, first_word: int, count: int, callback: Changed, mask: int = ALL_BITS) -> Watch:
        if self._watched is not None:
            self._watched()
        return super().watch(first_word, count, callback, mask)


def _encode(values: Sequence[int], bits: int) -> bytes:
    code = UNSIGNED_CODES.get(bits)
    try:
        if code is not None and len(values) == 1:
            return _SINGLE[bits].pack(values[0])
        if code is not None:
            return struct.pack(f"<{len(values)}{code}", *values)
        return b"".join([value.to_bytes(bits // 8, "little") for value in values])
    except (struct.error, OverflowError) as problem:
        wrong = next(value for value in values if not isinstance(value, int) or not 0 <= value < 1 << bits)
        raise MemoryValueError(f"{wrong} does not fit into {bits} bits: 0 to {(1 << bits) - 1}") from problem


class Watch:
    """A watch of `count` words from `first_word` on, of the bits of `mask` in each, until `cancel`."""

    __slots__ = ("_table", "active", "area", "callback", "count", "first_word", "mask", "number")

    def __init__(
        self, table: WatchTable, area: Area, first_word: int, count: int, callback: Changed, mask: int
    ) -> None:
        self._table = table
        self.area = area
        self.first_word = first_word
        self.count = count
        self.callback = callback
        self.mask = mask
        self.number = table.next_number()
        self.active = True

    def cancel(self) -> None:
        """End the calls, even for the write that is being reported now. Calling twice has no effect."""
        if self.active:
            self.active = False
            self._table.remove(self)


class WatchTable:
    """The watches of an area of `words` words.

    `marks`: 1 for a watched word, else 0; `masks`: the watched bits of each word; `by_word`: the watches of each word,
    in order of registration.
    """

    __slots__ = ("by_word", "marks", "masks", "next_number")

    def __init__(self, words: int) -> None:
        self.next_number = itertools.count().__next__
        self.marks = bytearray(words)
        self.masks = array("H", bytes(2 * words))
        self.by_word: dict[int, tuple[Watch, ...]] = {}

    def add(self, watch: Watch) -> None:
        for word in range(watch.first_word, watch.first_word + watch.count):
            self._listen(word, (*self.by_word.get(word, ()), watch))

    def remove(self, watch: Watch) -> None:
        for word in range(watch.first_word, watch.first_word + watch.count):
            self._listen(word, tuple(other for other in self.by_word[word] if other is not watch))

    def _listen(self, word: int, watches: tuple[Watch, ...]) -> None:
        """Set the watches of a word."""
        self.marks[word] = bool(watches)
        self.masks[word] = reduce(or_, (watch.mask for watch in watches), 0)
        if watches:
            self.by_word[word] = watches
        else:
            del self.by_word[word]

    def changed(self, first: int, before: bytes, after: bytes) -> list[tuple[Watch, int, int]]:
        """Return (watch, its first changed word, number of words up to its last changed word) in order of registration.

        `before` and `after` are the bytes from word `first` on, and differ; the last word may be half a word.
        """
        found: dict[Watch, tuple[int, int]] = {}
        for word in self._watched(first, first + (len(after) + 1) // 2):
            at = 2 * (word - first)
            changed = int.from_bytes(before[at : at + 2], "little") ^ int.from_bytes(after[at : at + 2], "little")
            if changed & self.masks[word]:
                for watch in self.by_word[word]:
                    if changed & watch.mask:
                        start = found[watch][0] if watch in found else word
                        found[watch] = (start, word)
        in_order = sorted(found.items(), key=lambda item: item[0].number)
        return [(watch, start, last - start + 1) for watch, (start, last) in in_order]

    def _watched(self, first: int, end: int) -> Iterator[int]:
        word = self.marks.find(1, first, end)
        while word >= 0:
            yield word
            word = self.marks.find(1, word + 1, end)


class DeviceMemory:
    """Areas, found by name or alias. Raises ValueError if two areas have the same name.

    Every method with an area's name as argument raises UnknownAreaError, and the errors of `Area`.
    """

    def __init__(self, areas: Iterable[Area]) -> None:
        self.areas: dict[str, Area] = {}
        self._by_name: dict[str, Area] = {}
        for area in areas:
            self.add(area)

    def add(self, area: Area) -> None:
        """Add an area. Raises ValueError if another area has its name."""
        self.areas[area.name] = area
        for name in (area.name, *area.aliases):
            if name in self._by_name:
                raise ValueError(f"two areas of the memory are named {name}")
            self._by_name[name] = area

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def __iter__(self) -> Iterator[Area]:
        return iter(self.areas.values())

    def area(self, name: str) -> Area:
        """Return the area with this name or alias."""
        found = self._by_name.get(name)
        if found is None:
            raise UnknownAreaError(no_such("the memory has no area", name, self._by_name))
        return found

    # --- access; see Area

    def read(self, area: str, unit: str | int, start: int, count: int = 1) -> list[int]:
        """Return `count` unsigned values of `unit`, from number `start` on."""
        return self.area(area).read(unit, start, count)

    def write(self, area: str, unit: str | int, start: int, values: Sequence[int], *, force: bool = False) -> None:
        """Write unsigned values from number `start` on, all or none."""
        (self._by_name.get(area) or self.area(area)).write(unit, start, values, force=force)

    def read_bytes(self, area: str, offset: int, count: int) -> bytes:
        """Return `count` bytes from byte `offset` on."""
        return self.area(area).read_bytes(offset, count)

    def write_bytes(self, area: str, offset: int, data: bytes, *, force: bool = False) -> None:
        """Write `data` at byte `offset`."""
        self.area(area).write_bytes(offset, data, force=force)

    def watch(self, area: str, first_word: int, count: int, callback: Changed, mask: int = ALL_BITS) -> Watch:
        """Call `callback(area, first_changed_word, words)` once for every write that changes these words; see
        `Area.watch`.
        """
        return self.area(area).watch(first_word, count, callback, mask)

    # --- the whole

    @property
    def shape(self) -> Shape:
        """Return name, unit and size of every area."""
        return tuple((area.name, area.unit, area.size) for area in self)

    def snapshot(self) -> dict[str, bytes]:
        """Return the bytes of every area."""
        return {area.name: area.read_bytes(0, area.size_bytes) for area in self}


Shape = tuple[tuple[str, str, int], ...]
"""Name, unit and size of every area."""
