"""Recordings cut into other pieces, as a port that is read byte by byte, an adapter or a dump hands bytes over."""

from __future__ import annotations

import random
from collections import defaultdict
from collections.abc import Callable, Sequence

from framekit.extras.guess.model import HeardBytes

MS = 1_000_000
CHARACTER = 10_000_000_000 // 9600
PAUSE = 25 * MS
"""Between two frames, and longer than an adapter waits."""


def timed(frames: Sequence[HeardBytes]) -> list[HeardBytes]:
    """Frames with the times of a line of 9600 bits per second, one after the other; each has that of its last byte."""
    now, found = 1_000 * MS, list[HeardBytes]()
    for frame in frames:
        now += PAUSE + len(frame.data) * CHARACTER
        found.append(frame._replace(time=now))
    return found


def byte_times(frames: Sequence[HeardBytes]) -> list[HeardBytes]:
    """Each byte with its own time."""
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
    """As a dump of 16 bytes a line, without times: one stream for each way."""
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
    """So many of the frames in two, at a place that is drawn."""

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
