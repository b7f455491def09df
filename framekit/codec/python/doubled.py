"""Helpers of generated code for regions in which every escape byte is doubled: where they end, what stands in them.

Pasted into generated modules as they stand here, as those of `runtime` are.
"""

from __future__ import annotations


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

IMPORTS: dict[str, tuple[str, ...]] = {}
"""The import lines that a helper's source stands on."""
