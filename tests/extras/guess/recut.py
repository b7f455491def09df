"""Recordings cut into other pieces: as read byte by byte, by an adapter, or from a dump."""

from __future__ import annotations

import random
from collections import defaultdict
from collections.abc import Callable, Sequence

from framekit.extras.guess.model import HeardBytes

MS = 1_000_000
CHARACTER = 10_000_000_000 // 9600
PAUSE = 25 * MS
"""Pause between two frames; longer than an adapter waits."""


def timed(frames: Sequence[HeardBytes]) -> list[HeardBytes]:
    """Return the frames in sequence, with times of a line of 9600 bits per second: that of the last byte of each."""
    now, found = 1_000 * MS, list[HeardBytes]()
    for frame in frames:
        now += PAUSE + len(frame.data) * CHARACTER
        found.append(frame._replace(time=now))
    return found


def byte_times(frames: Sequence[HeardBytes]) -> list[HeardBytes]:
    """Return each byte with its own time."""
    return [
        HeardBytes((frame.time or 0) - (len(frame.data) - 1 - at) * CHARACTER, frame.direction, bytes([byte]))
        for frame in frames
        for at, byte in enumerate(frame.data)
    ]


def in_portions(frames: Sequence[HeardBytes]) -> list[HeardBytes]:
    """Merge the bytes received within 16 ms, per direction."""
    found = dict[tuple[int, str], HeardBytes]()
    for byte in byte_times(frames):
        at = (byte.time or 0) // (16 * MS) + 1
        before = found.get((at, byte.direction), HeardBytes(at * 16 * MS, byte.direction, b""))
        found[at, byte.direction] = before._replace(data=before.data + byte.data)
    return list(found.values())


def in_lines(frames: Sequence[HeardBytes]) -> list[HeardBytes]:
    """Return the bytes as a dump of 16 bytes per line without times: one stream per direction."""
    streams = defaultdict[str, list[bytes]](list)
    for frame in frames:
        streams[frame.direction].append(frame.data)
    return [
        HeardBytes(None, direction, data[at : at + 16])  # type: ignore[arg-type]
        for direction, parts in streams.items()
        for data in (b"".join(parts),)
        for at in range(0, len(data), 16)
    ]


def split(share: float) -> Callable[[Sequence[HeardBytes]], list[HeardBytes]]:
    """Return a function that splits this share of the frames in two, at a random place."""

    def cut(frames: Sequence[HeardBytes]) -> list[HeardBytes]:
        rng, found = random.Random(f"split {share}"), list[HeardBytes]()
        for frame in frames:
            size, time = len(frame.data), frame.time or 0
            at = rng.randrange(1, size) if size > 1 and rng.random() < share else 0
            parts = [(time - (size - at) * CHARACTER, frame.data[:at])] * bool(at) + [(time, frame.data[at:])]
            found += [HeardBytes(when, frame.direction, data) for when, data in parts]
        return found

    return cut


CUTS: dict[str, Callable[[Sequence[HeardBytes]], list[HeardBytes]]] = {
    "byte by byte": byte_times, "every 16 ms": in_portions, "16 bytes a line": in_lines,
    "20 % in two": split(0.2), "50 % in two": split(0.5),
}  # fmt: skip
