"""Helpers that generated modules carry with them: pasted as they stand here, each on its own like those of `support`.

They may use each other (`NEEDS`), standard imports (`IMPORTS`) and the names every generated module has: `Any`,
`Context`, `FrameError`, `EncodeError`, `QUIET`, `LOST`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from struct import Struct
from typing import Any

from framekit.codec.errors import FrameError

Context = Mapping[str, Any]
Reads = Callable[..., dict[str, Any]]

QUIET = -(1 << 40)
LOST = QUIET - 1


class Misfit(ValueError):  # noqa: N818 - says no more than that
    """Something does not fit; what it is, is found out afterwards."""


class Defaults(dict[str, Any]):
    """What frames need beside their fields, with the definition's start values."""

    def __missing__(self, name: str) -> Any:
        raise KeyError(f"'{name}' has no default: give it in ctx, such as DEFAULTS | {{'{name}': ...}}")


def attribute(value: Any, name: str) -> Any:
    """`value.name`: an entry of a mapping, something an object offers, or the list of a list's attributes."""
    if isinstance(value, Mapping):
        return value[name]
    if isinstance(value, (list, tuple)):
        return [attribute(item, name) for item in value]
    return value.language_attribute(name)


class RangeTable(dict[Any, Any]):
    """A table some of whose keys are ranges: (first, last, value)."""

    def __init__(self, entries: Mapping[Any, Any], ranges: tuple[tuple[int, int, Any], ...]) -> None:
        super().__init__(entries)
        self.ranges = ranges

    def __missing__(self, key: Any) -> Any:
        for first, last, value in self.ranges:
            if isinstance(key, int) and first <= key <= last:
                return value
        raise KeyError(key)

    def __contains__(self, key: object) -> bool:
        in_range = isinstance(key, int) and any(first <= key <= last for first, last, _ in self.ranges)
        return in_range or super().__contains__(key)

    def get(self, key: Any, default: Any = None) -> Any:
        try:
            return self[key]
        except KeyError:
            return default


class Structs(dict[int, Struct]):
    """Structs for lists, by the number of values in them; those of long lists are made each time."""

    def __init__(self, before: str, code: str) -> None:
        self.before = before
        self.code = code

    def __missing__(self, count: int) -> Struct:
        found = Struct(f"{self.before}{count}{self.code}")
        if count <= 256:
            self[count] = found
        return found


class Packs(dict[int, Callable[..., bytes]]):
    """What packs lists, by the number of values in them: to call these takes a sixth less than `pack` of a struct."""

    def __init__(self, before: str, code: str) -> None:
        self.before = before
        self.code = code

    def __missing__(self, count: int) -> Callable[..., bytes]:
        found = Struct(f"{self.before}{count}{self.code}").pack
        if count <= 256:
            self[count] = found
        return found


def without_none(values: Context) -> dict[str, Any]:
    """The values that are not None: those that were given."""
    return {name: value for name, value in values.items() if value is not None}


# ---- ends ---------------------------------------------------------------------------------------------------


def ends_here(decode: Callable[..., Any], data: bytes, ctx: Context, place: int) -> bool:
    """Whether everything from `place` on fits, so that the frame ends here."""
    try:
        decode(data, ctx)
    except FrameError as error:
        return error.cause != "check" and error.offset < place
    return True


def measure_hex(measure: Callable[..., int], data: bytes | bytearray, at: int, end: int, ctx: Context) -> int:
    """How many hex digits content takes whose length `measure` finds in the bytes they stand for, and one more.

    So that no digits differ from no such content; `measure` finds a byte before the content for the same reason.
    """
    digits = bytes(data[at:end])
    good = len(digits) - len(digits.lstrip(b"0123456789ABCDEFabcdef"))
    plain = b"\0" + bytes.fromhex(digits[: good - good % 2].decode("ascii"))
    size = measure(plain, 0, len(plain), ctx)
    if size > 0:
        return 2 * size - 1
    if size <= QUIET:
        return size
    return LOST if good < len(digits) else 2 * size + good % 2


# ---- regions in which every escape byte is doubled -----------------------------------------------------------


def end_of_region(data: bytes | bytearray, at: int, escape: int, embedded: tuple[bytes, ...] = ()) -> int:
    """The place of the first escape byte that is not doubled. Raises ValueError if there is none."""
    place = find_region_end(data, at, len(data), escape, 0, embedded)
    if place < 0:
        raise ValueError("the region does not end")
    return place


def find_region_end(
    data: bytes | bytearray, at: int, end: int, escape: int, seen: int = 0, embedded: tuple[bytes, ...] = ()
) -> int:
    """The place of the first escape byte before `end` that is not doubled; -1 if it is not there yet.

    `seen`: up to there nothing was found before. `embedded`: what may stand in the region all the same.
    """
    place = max(at, seen)
    while place > at and data[place - 1] == escape:
        place -= 1  # escape bytes are paired from the first one of their row
    while True:
        place = data.find(escape, place, end)
        if place < 0 or place + 1 >= end:
            return -1
        if data[place + 1] == escape:
            place += 2
            continue
        for frame in embedded:
            if data.startswith(frame[:2], place):
                place += len(frame)
                break
        else:
            return place


def without_embedded(data: bytes, escape: int, embedded: tuple[bytes, ...]) -> bytes:
    """Content of a region without the frames that stand in it."""
    for frame in embedded:
        if frame in data:
            break
    else:
        return data
    parts, start, place = [], 0, data.find(escape)
    while place >= 0:
        found = next((frame for frame in embedded if data.startswith(frame, place)), None)
        if found is not None:
            parts.append(data[start:place])
            start = place + len(found)
            place = data.find(escape, start)
        else:
            place = data.find(escape, place + (2 if data[place + 1 : place + 2] == bytes((escape,)) else 1))
    return b"".join(parts) + data[start:]


def end_of_doubled(data: bytes | bytearray, at: int, escape: int, size: int, end: int | None = None) -> int:
    """The place behind `size` plain bytes. Raises ValueError for an escape byte not doubled, IndexError if too few."""
    end = len(data) if end is None else end
    for _ in range(size):
        if at >= end:
            raise IndexError("more bytes are wanted")
        if data[at] == escape:
            at += 1
            if at >= end:
                raise IndexError("more bytes are wanted")
            if data[at] != escape:
                raise ValueError("an escape byte is not doubled")
        at += 1
    return at


NEEDS: dict[str, tuple[str, ...]] = {"end_of_region": ("find_region_end",)}
"""The names of this module that a helper uses itself."""

IMPORTS: dict[str, tuple[str, ...]] = {
    "Structs": ("from struct import Struct",),
    "Packs": ("from collections.abc import Callable", "from struct import Struct"),
}
"""The import lines that a helper's source stands on."""
