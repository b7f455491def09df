"""The bytes of a line as captured: pieces between pauses, and the streams that they form."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from math import sqrt
from typing import Literal, NamedTuple

from framekit.extras.guess.model import Direction, HeardBytes

SPEEDS = (300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
BITS = (10, 11, 12)
"""Possible numbers of bits of a character: start, 7 or 8 data bits, parity, stop."""
TOLERANCE = 0.02
LEAST_SIZES = 3
"""Least number of different chunk sizes that must confirm the same time per character."""
SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class PieceStream:
    """All bytes of one direction."""

    direction: Direction
    data: bytes
    starts: tuple[int, ...]
    """Offsets at which pieces begin, the first 0."""
    heard: tuple[int, ...]
    """Offsets at which captured chunks begin; joined pieces consist of several chunks."""
    times: tuple[int | None, ...]
    """Time of each chunk (ns), if known."""
    numbers: tuple[int, ...]
    """Index of each chunk in the whole line."""
    signals: frozenset[int] = frozenset()
    """Offsets of short constant answers, such as ACK."""

    @property
    def pieces(self) -> list[bytes]:
        """Return the pieces, in order."""
        ends = (*self.starts[1:], len(self.data))
        return [self.data[start:end] for start, end in zip(self.starts, ends, strict=True)]

    def heard_at(self, place: int) -> int:
        """Return the index of the chunk that contains the byte at `place`."""
        return bisect_right(self.heard, place) - 1


def character_time(chunks: Sequence[HeardBytes]) -> tuple[float, int] | None:
    """Return the duration of a character (ns), and whether times are those of first bytes (0) or of last bytes (1).

    Chunks without a pause between them must follow at a usual speed; None if that is not observed.
    """
    pairs = [
        (after.time - before.time, (len(before.data), len(after.data)))
        for before, after in pairwise(chunks)
        if before.time is not None and after.time is not None and before.direction == after.direction
    ]
    for which in (0, 1):
        usual = _usual_rate(sorted((step / max(1, sizes[which]), sizes[which]) for step, sizes in pairs))
        if usual is not None:
            return usual, which
    return None


def _usual_rate(rates: list[tuple[float, int]]) -> float | None:
    if not rates:
        return None
    rate = rates[0][0]  # chunks without a pause are the fastest
    near = {size for other, size in rates if abs(other - rate) <= TOLERANCE * rate}
    if len(near) < LEAST_SIZES:
        return None  # the same time for one size is no evidence of a speed
    for speed in SPEEDS:
        for bits in BITS:
            usual = bits * SECOND / speed
            if abs(rate - usual) <= TOLERANCE * usual:
                return usual
    return None


def joined(chunks: Sequence[HeardBytes]) -> list[HeardBytes]:
    """Join chunks that no pause separates."""
    known = character_time(chunks)
    found: list[HeardBytes] = []
    before: HeardBytes | None = None
    for chunk in chunks:
        if not chunk.data:
            continue
        if known is not None and before is not None and before.direction == chunk.direction:
            character, which = known
            most = (len((before, chunk)[which].data) + 1.5) * character
            if before.time is not None and chunk.time is not None and chunk.time - before.time <= most:
                found[-1] = found[-1]._replace(data=found[-1].data + chunk.data)
                before = chunk
                continue
        found.append(chunk)
        before = chunk
    return found


LARGEST_SIGNAL = 3
LEAST_SIGNALS = 3


def signals_of(texts: Sequence[bytes]) -> frozenset[bytes]:
    """Return the short pieces that recur and are no parts of frames: no other piece begins or ends with them, unless a
    frame follows at once.
    """
    often = Counter(texts)
    short = [text for text, count in often.items() if len(text) <= LARGEST_SIGNAL and count >= LEAST_SIGNALS]
    longer = [text for text in texts if len(text) > LARGEST_SIGNAL]
    heads = Counter(text[:2] for text in longer)
    found = set[bytes]()
    for signal in short:
        rests = [text[len(signal) :] for text in longer if text.startswith(signal)]
        alone = sum(heads[text[:2]] < LEAST_SIGNALS or text[:2] == signal[:2] for text in rests)
        ends = sum(text.endswith(signal) for text in longer)
        if longer and alone <= 0.1 * often[signal] and ends <= 0.1 * len(longer):
            found.add(signal)
    return frozenset(found)


def apart(pieces: Sequence[HeardBytes], signals: frozenset[bytes]) -> list[HeardBytes]:
    """Return the pieces, with a signal before a frame separated as a piece of its own."""
    found = list[HeardBytes]()
    for piece in pieces:
        first = next((one for one in signals if piece.data.startswith(one) and len(piece.data) > len(one)), b"")
        found += [piece._replace(data=data) for data in (first, piece.data[len(first) :]) if data]
    return found


def streams_of(pieces: Sequence[HeardBytes], heard: Sequence[HeardBytes] = ()) -> list[PieceStream]:
    """Return a stream for each direction.

    `heard`: the chunks that the pieces were joined from, for times within frames.
    """
    signals = signals_of([piece.data for piece in pieces])
    pieces = apart(pieces, signals) if signals else pieces
    found = []
    for direction in dict.fromkeys(piece.direction for piece in pieces):
        own = [piece.data for piece in pieces if piece.direction == direction]
        parts = [(number, one) for number, one in enumerate(heard or pieces) if one.direction == direction and one.data]
        starts = _starts(own)
        found.append(
            PieceStream(
                direction, b"".join(own), starts, _starts([one.data for _, one in parts]),
                tuple(one.time for _, one in parts), tuple(number for number, _ in parts),
                frozenset(start for start, data in zip(starts, own, strict=True) if data in signals),
            )
        )  # fmt: skip
    return found


def _starts(parts: Sequence[bytes]) -> tuple[int, ...]:
    return tuple(accumulate((len(part) for part in parts[:-1]), initial=0))


# ---- other cuttings ---------------------------------------------------------------------------------------------

LATENCY = 20_000_000
"""Latency of USB adapters (ns): they hand over received bytes every 16 ms; the margin is included."""
MOST_GAPS = 3
"""Number of pauses tried as the shortest pause between frames."""
LEAST_RATIO = 1.4
"""Least ratio of pauses between frames to pauses within frames."""
LEAST_JOINED = 0.05
"""Least share of pieces that a pause must join to be worth a trial."""
LEAST_TURNS = 6
SMALL = 2
MANY = 0.2
MOSTLY = 0.5
NEARLY_ALL = 0.85
USUAL_SIZES = frozenset({1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024})
"""Sizes of blocks in which programs and adapters hand over bytes, or lines of a dump."""


class Cutting(NamedTuple):
    """A cutting of a line into pieces: as captured (`heard`), at pauses longer than others (`pauses`), at changes of
    direction (`turns`), or uncut (`whole`).
    """

    kind: Literal["heard", "pauses", "turns", "whole"]
    pieces: tuple[HeardBytes, ...]


def other_cuttings(chunks: Sequence[HeardBytes]) -> list[Cutting]:
    """Return the cuttings of the bytes other than the captured pieces, without duplicates."""
    chunks = [chunk for chunk in chunks if chunk.data]
    found = [Cutting("pauses", _within(chunks, gap)) for gap in _gaps(chunks)]
    turns = _within(chunks, None)
    if len(turns) >= LEAST_TURNS:
        found.append(Cutting("turns", turns))
    ways = {chunk.direction: chunk for chunk in reversed(chunks)}
    data = {way: b"".join(chunk.data for chunk in chunks if chunk.direction == way) for way in ways}
    found.append(Cutting("whole", tuple(first._replace(data=data[way]) for way, first in ways.items())))
    sizes, different = {tuple(len(chunk.data) for chunk in chunks)}, list[Cutting]()
    for cutting in found:
        own = tuple(len(piece.data) for piece in cutting.pieces)
        if own not in sizes:
            sizes.add(own)
            different.append(cutting)
    return different


def _within(chunks: Sequence[HeardBytes], gap: float | None) -> tuple[HeardBytes, ...]:
    """Join chunks of one direction that no pause longer than `gap` (ns) separates; None: any pause."""
    found: list[HeardBytes] = []
    parts: list[bytes] = []
    for before, chunk in zip([None, *chunks], chunks, strict=False):
        if before is not None and before.direction == chunk.direction and _is_near(before, chunk, gap):
            parts.append(chunk.data)
            continue
        if found:
            found[-1] = found[-1]._replace(data=b"".join(parts))
        found.append(chunk)
        parts = [chunk.data]
    if found:
        found[-1] = found[-1]._replace(data=b"".join(parts))
    return tuple(found)


def _is_near(before: HeardBytes, chunk: HeardBytes, gap: float | None) -> bool:
    if gap is None:
        return True
    return before.time is not None and chunk.time is not None and 0 <= chunk.time - before.time <= gap


def _gaps(chunks: Sequence[HeardBytes]) -> list[float]:
    """Return pauses (ns) that may be the longest within a frame: gaps in the distribution of pauses, and the latency of
    adapters.
    """
    steps = sorted(
        max(1000, after.time - before.time)
        for before, after in pairwise(chunks)
        if before.time is not None and after.time is not None and before.direction == after.direction
        if after.time >= before.time
    )
    if not steps:
        return []
    least = max(1, round(LEAST_JOINED * len(chunks)))
    jumps = [
        (two / one, sqrt(one * two))
        for at, (one, two) in enumerate(pairwise(steps), 1)
        if two >= LEAST_RATIO * one and at >= least
    ]
    best = [gap for _, gap in sorted(jumps, reverse=True)[:MOST_GAPS]]
    joined_by_latency = sum(step <= LATENCY for step in steps)
    return [*best, LATENCY] if joined_by_latency >= least else best


def say_little(pieces: Sequence[HeardBytes]) -> bool:
    """Return whether pieces are weak evidence, as portions of a transfer are: mostly one or two bytes, or nearly all of
    one usual size.
    """
    sizes = Counter(len(piece.data) for piece in pieces)
    count = sum(sizes.values())
    if count < 2:
        return False
    usual, often = sizes.most_common(1)[0]
    return sum(sizes[size] for size in range(SMALL + 1)) > MOSTLY * count or (
        usual in USUAL_SIZES and often >= NEARLY_ALL * count
    )


def are_portions(pieces: Sequence[HeardBytes]) -> bool:
    """Return whether many pieces follow another piece of their direction within the latency of an adapter."""
    soon = sum(
        before.direction == piece.direction and _is_near(before, piece, LATENCY) for before, piece in pairwise(pieces)
    )
    return soon >= MANY * len(pieces) > 0
