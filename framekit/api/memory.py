"""The memory of a device or a run, read and written by address with the types of the API, from any thread.

The owner of the memory provides the calls into the right thread. Watches and triggers see the writes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from framekit.api.errors import RequestError
from framekit.api.values import typed, values_given
from framekit.link.addresses import AddressGrammar
from framekit.link.packing import Typed, Value, memory_of, values_of
from framekit.memory.memory import ALL_BITS, Area, DeviceMemory, DeviceMemoryError, Watch, ordered, unit_bits
from framekit.memory.views import Order

Do = Callable[[Callable[[], Any]], Any]
"""Function that executes a call in the memory's thread, and returns its result."""

Soon = Callable[[Callable[[], None]], object]
"""Function that executes a call in the memory's thread, after the present event."""


class Memory:
    """Memory by address: `memory["M100"]` is one value of the address's own unit; `read` and `write` take counts and
    types.
    """

    def __init__(
        self, memory: DeviceMemory, grammar: AddressGrammar, do: Do, soon: Soon, refresh: Callable[[], None]
    ) -> None:
        self._memory = memory
        self._soon = soon
        self._grammar = grammar
        self._do = do
        self._refresh = refresh

    def read(
        self, address: str, count: int = 1, *, type: str | None = None, order: Order | None = None
    ) -> list[Any]:  # fmt: skip
        """Return `count` values from an address on (a string is a single value of `count` characters).

        Raises RequestError.
        """
        how = typed(self._grammar, address, type, order, count)
        first, bits, unit = self._place(how, address)

        def read() -> bytes:
            self._refresh()
            area = self._memory.area(self._grammar.parse(address).area)
            if (first | bits) % 8:
                return area.read_bits(first, bits)
            return ordered(area.read_bytes(first // 8, bits // 8), area.order, unit_bits(unit) // 8)

        data: bytes = self._carry_out(read)
        try:
            return how.values(data, values_of(data, unit, how.units))
        except ValueError as error:
            raise RequestError(f"{address}: {error}") from None

    def write(
        self, address: str, values: Value | Sequence[Value], *, type: str | None = None, order: Order | None = None,
        count: int | None = None,
    ) -> None:  # fmt: skip
        """Write values from an address on, also to areas that are read-only for clients. Raises RequestError.

        A string is padded with 00 to `count` characters.
        """
        given = values_given(values)
        several = len(given[0]) if type == "string" and given and isinstance(given[0], str) else len(given)
        how = typed(self._grammar, address, type, order, several if count is None else count)
        first, bits, unit = self._place(how, address)
        try:
            data = memory_of(how.numbers(given), unit)
        except ValueError as error:
            raise RequestError(str(error)) from None

        def write() -> None:
            area = self._memory.area(self._grammar.parse(address).area)
            if (first | bits) % 8:
                area.write_bits(first, bits, data, force=True)
            else:
                area.write_bytes(first // 8, ordered(data, area.order, unit_bits(unit) // 8), force=True)

        self._carry_out(write)

    def watch(
        self, address: str, callback: Callable[[list[Any]], None], count: int = 1, *, type: str | None = None,
        order: Order | None = None,
    ) -> MemoryWatch:  # fmt: skip
        """Call `callback(values)` when the values from an address on have changed, until `cancel`. Raises RequestError.

        The values are those of `read`. The call comes in the memory's thread, after the event that changed them:
        several changes until then give one call, with the last values, and a change that was undone gives none.
        """
        how = typed(self._grammar, address, type, order, count)
        first, bits, _ = self._place(how, address)
        read = partial(self.read, address, count, type=type, order=order)
        watch = MemoryWatch(read, callback, self._do, self._soon)
        area = self._memory.area(self._grammar.parse(address).area)
        self._carry_out(partial(watch.begin, area, first, bits))
        return watch

    def __getitem__(self, address: str) -> Any:
        return self.read(address)[0]

    def __setitem__(self, address: str, value: Value | Sequence[Value]) -> None:
        self.write(address, value)

    def _place(self, how: Typed, address: str) -> tuple[int, int, str]:
        """Return the first bit, the number of bits, and the unit of the elements. Raises RequestError."""
        if how.units < 1:
            raise RequestError("there is nothing to read or write: the count is 0")
        place = self._grammar.parse(address)
        return place.first_bit, how.bits, how.carrier

    def _carry_out(self, action: Callable[[], Any]) -> Any:
        try:
            return self._do(action)
        except DeviceMemoryError as error:
            raise RequestError(str(error)) from None


class MemoryWatch:
    """A watched place; made by `Memory.watch`."""

    def __init__(
        self, read: Callable[[], list[Any]], callback: Callable[[list[Any]], None], do: Do, soon: Soon
    ) -> None:  # fmt: skip
        self._read = read
        self._callback = callback
        self._do = do
        self._soon = soon
        self._told: list[Any] = []
        self._due = False
        self._watch: Watch | None = None

    def begin(self, area: Area, first: int, bits: int) -> None:
        """Watch `bits` bits from `first` on, starting from their present values."""
        self._told = self._read()
        word, words = first // 16, (first + bits + 15) // 16 - first // 16
        mask = ((1 << bits) - 1) << first % 16 if words == 1 else ALL_BITS
        self._watch = area.watch(word, words, self._changed, mask)

    def cancel(self) -> None:
        """End the calls. Calling twice has no effect."""
        if self._watch is not None:
            self._do(self._watch.cancel)

    def _changed(self, area: Area, word: int, words: int) -> None:
        if not self._due:
            self._due = True
            with suppress(RuntimeError):  # the loop has ended: no further calls
                self._soon(self._tell)

    def _tell(self) -> None:
        self._due = False
        values = self._read()
        if values != self._told and self._watch is not None and self._watch.active:
            self._told = values
            self._callback(values)
