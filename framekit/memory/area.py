"""One area of device memory: bytes, little-endian, seen as bits, bytes, words, double words or long words.

Every view counts from 0 in its own unit over the whole area: byte 3 is the high byte of word 1, bit 17 is bit
1 of word 1, dword 2 is words 4 and 5. An area knows no addresses, no protocol and no clock; it is used by one
thread.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Literal

from framekit.memory.errors import AccessError, MemoryRangeError, MemoryValueError
from framekit.memory.numbers import UNSIGNED_CODES, pack_bits, unit_bits, unpack_bits
from framekit.memory.watch import ALL_BITS, Changed, Watch, WatchTable

_PACK_WORD = struct.Struct("<H").pack
_SINGLE = {bits: struct.Struct(f"<{code}") for bits, code in UNSIGNED_CODES.items()}


class Area:
    """`size` elements of `unit`: bit, byte, word, dword, lword, `6 bytes`, or a number of bytes.

    `access` is `rw`, or `read` when only the owner, who says `force=True`, may write. Values are unsigned.
    Methods raise MemoryRangeError for a place beyond the area, AccessError for a write that is not allowed,
    MemoryValueError for a value that does not fit, ValueError for an unknown unit.
    """

    __slots__ = (
        "_data",
        "_spare",
        "_watches",
        "access",
        "aliases",
        "element_bits",
        "name",
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
        self.aliases = tuple(aliases)
        self.size_bits = size * self.element_bits
        self._data = bytearray((self.size_bits + 7) // 8)
        self._spare = -self.size_bits % 8
        self._watches: WatchTable | None = None

    def __repr__(self) -> str:
        return f"<area {self.name}: {self.size} × {self.unit}, {self.access}>"

    @property
    def size_bytes(self) -> int:
        return len(self._data)

    @property
    def size_words(self) -> int:
        """Words of 16 bits, the last of which may be cut short."""
        return (len(self._data) + 1) // 2

    # --- bytes

    def read_bytes(self, offset: int, count: int) -> bytes:
        """`count` bytes from byte `offset` on."""
        if offset < 0 or count < 0 or offset + count > len(self._data):
            raise self._beyond("byte", offset, count, len(self._data))
        return bytes(self._data[offset : offset + count])

    def bytes_reader(self, offset: int, count: int) -> Callable[[], bytes]:
        """`read_bytes`, to be called again and again, without a call of Python in between."""
        if offset < 0 or count < 0 or offset + count > len(self._data):
            return partial(self.read_bytes, offset, count)
        return partial(bytes, memoryview(self._data)[offset : offset + count])

    def byte_reader(self, offset: int) -> Callable[[], int]:
        """Reads byte `offset` as a number at every call."""
        return partial(self._data.__getitem__, offset)

    def holds(self, offset: int, data: bytes) -> bool:
        """Whether these bytes stand at byte `offset`."""
        return self._data.startswith(data, offset)

    def holder(self, offset: int, data: bytes) -> Callable[[], bool]:
        """`holds`, to be asked again and again."""
        return partial(self._data.startswith, data, offset)

    def write_bytes(self, offset: int, data: bytes, *, force: bool = False) -> None:
        """Puts `data` at byte `offset`. Bits of the last byte that are beyond the area stay 0."""
        end = offset + len(data)
        if offset < 0 or end > len(self._data):
            raise self._beyond("byte", offset, len(data), len(self._data))
        self._allow(force)
        if self._spare and data and end == len(self._data):
            data = data[:-1] + bytes([data[-1] & (0xFF >> self._spare)])
        self._store(offset, data)

    # --- numbers of any unit

    def read(self, unit: str | int, start: int, count: int = 1) -> list[int]:
        """`count` unsigned values of `unit`, from number `start` on."""
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
        """Puts unsigned `values` of `unit` at number `start` on. Either all are written or none."""
        may = force or self.access != "read"
        if may and unit == "word" and len(values) == 1 and 0 <= start < self.size_bits >> 4:
            try:  # the usual write, without detours
                data = _PACK_WORD(values[0])
            except struct.error:
                pass
            else:  # as `_put_word`, since nothing stands between a write and what it triggers
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

    # --- bits, packed

    def read_bit(self, start: int) -> bool:
        """One bit."""
        if not 0 <= start < self.size_bits:
            raise self._beyond("bit", start, 1, self.size_bits)
        return bool(self._data[start >> 3] >> (start & 7) & 1)

    def read_bits(self, start: int, count: int) -> bytes:
        """`count` bits packed into bytes, the first in bit 0 of the first byte, unused ones 0."""
        self._within("bit", 1, start, count)
        if not count:
            return b""
        number = int.from_bytes(self._data[start >> 3 : (start + count + 7) >> 3], "little") >> (start & 7)
        return (number & ((1 << count) - 1)).to_bytes((count + 7) // 8, "little")

    def write_bits(self, start: int, count: int, data: bytes, *, force: bool = False) -> None:
        """Puts the first `count` bits of `data`, packed as `read_bits` gives them; no fewer may be there."""
        self._within("bit", 1, start, count)
        self._allow(force)
        if len(data) * 8 < count:
            raise MemoryValueError(f"{len(data)} bytes do not hold {count} bits")
        self._put_bits(start, count, data)

    # --- change

    def watch(self, first_word: int, count: int, callback: Changed, mask: int = ALL_BITS) -> Watch:
        """Calls `callback(area, word, words)` once for every write that changes one of these words.

        `mask`: of each of these words only the bits that are 1 there count. The calls come in order of registration,
        after the data are in, with the first changed word of these and the number of words up to the last. A callback
        should note the change and return: when it writes to a watched word itself, watches called after it hear of
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
        """Those who watch one of the bits that have changed in a word hear of it."""
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

    def _allow(self, force: bool) -> None:
        if self.access == "read" and not force:
            raise self._read_only()

    def _read_only(self) -> AccessError:
        return AccessError(f"area {self.name} can only be read")

    def _within(self, unit: str | int, bits: int, start: int, count: int) -> None:
        if start < 0 or count < 0 or (start + count) * bits > self.size_bits:
            raise self._beyond(unit, start, count, self.size_bits // bits)

    def _beyond(self, unit: str | int, start: int, count: int, there: int) -> MemoryRangeError:
        asked = f"{unit} {start}" if count == 1 else f"{count} × {unit} from {start} on"
        has = f"{unit} 0 to {there - 1}" if there else f"no whole {unit}"
        return MemoryRangeError(f"{asked} is not in area {self.name}, which has {has}")


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
