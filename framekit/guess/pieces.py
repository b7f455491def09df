"""The bytes of a line as they came: pieces between pauses, and the streams that they make up."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from framekit.guess.model import Direction, HeardBytes

SPEEDS = (300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
BITS = (10, 11, 12)
"""Bits of a character: start, 7 or 8, parity, stop."""
TOLERANCE = 0.02
LEAST_SIZES = 3
"""Chunks of so many sizes follow each other at the same time for each character, where that is one."""
SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class PieceStream:
    """All bytes that went one way. `starts`: where pieces begin, the first at 0; `times`: when those came, if known;
    `numbers`: which pieces of the whole line they are; `signals`: the starts of short answers that are always the same,
    such as ACK."""

    direction: Direction
    data: bytes
    starts: tuple[int, ...]
    times: tuple[int | None, ...]
    numbers: tuple[int, ...]
    signals: frozenset[int] = frozenset()

    @property
    def pieces(self) -> list[bytes]:
        """The pieces, in order."""
        ends = (*self.starts[1:], len(self.data))
        return [self.data[start:end] for start, end in zip(self.starts, ends, strict=True)]

    def piece_at(self, place: int) -> int:
        """The index of the piece in which a byte stands."""
        return bisect_right(self.starts, place) - 1


def character_time(chunks: Sequence[HeardBytes]) -> tuple[float, int] | None:
    """Nanoseconds of a character, where chunks follow each other without a pause at a usual speed; and whether times
    are those of first bytes (0), or of last ones (1). None where that cannot be seen."""
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
    rate = rates[0][0]  # nothing comes sooner than without a pause
    near = {size for other, size in rates if abs(other - rate) <= TOLERANCE * rate}
    if len(near) < LEAST_SIZES:
        return None  # the same time for one size says nothing of a speed
    for speed in SPEEDS:
        for bits in BITS:
            usual = bits * SECOND / speed
            if abs(rate - usual) <= TOLERANCE * usual:
                return usual
    return None


def joined(chunks: Sequence[HeardBytes]) -> list[HeardBytes]:
    """Chunks between which there was no pause are one."""
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
    """Short pieces that come again and again, and are no parts of frames: no other piece begins or ends so, but where
    a frame follows at once."""
    often = Counter(texts)
    short = [text for text, count in often.items() if len(text) <= LARGEST_SIGNAL and count >= LEAST_SIGNALS]
    longer = [text for text in texts if len(text) > LARGEST_SIGNAL]
    heads = Counter(text[:2] for text in longer)
    found = set[bytes]()
    for signal in short:
        behind = [text[len(signal) :] for text in longer if text.startswith(signal)]
        alone = sum(heads[text[:2]] < LEAST_SIGNALS or text[:2] == signal[:2] for text in behind)
        ends = sum(text.endswith(signal) for text in longer)
        if longer and alone <= 0.1 * often[signal] and ends <= 0.1 * len(longer):
            found.add(signal)
    return frozenset(found)


def apart(pieces: Sequence[HeardBytes], signals: frozenset[bytes]) -> list[HeardBytes]:
    """The pieces, with signals before a frame as pieces of their own."""
    found = list[HeardBytes]()
    for piece in pieces:
        first = next((one for one in signals if piece.data.startswith(one) and len(piece.data) > len(one)), b"")
        found += [piece._replace(data=data) for data in (first, piece.data[len(first) :]) if data]
    return found


def streams_of(pieces: Sequence[HeardBytes]) -> list[PieceStream]:
    """A stream for each way."""
    signals = signals_of([piece.data for piece in pieces])
    pieces = apart(pieces, signals) if signals else pieces
    found = []
    for direction in dict.fromkeys(piece.direction for piece in pieces):
        own = [(number, piece) for number, piece in enumerate(pieces) if piece.direction == direction]
        starts, at = [], 0
        for _, piece in own:
            starts.append(at)
            at += len(piece.data)
        times = tuple(piece.time for _, piece in own)
        data = b"".join(piece.data for _, piece in own)
        short = frozenset(start for start, (_, piece) in zip(starts, own, strict=True) if piece.data in signals)
        found.append(PieceStream(direction, data, tuple(starts), times, tuple(number for number, _ in own), short))
    return found
