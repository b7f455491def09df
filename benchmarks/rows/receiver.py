"""The receiver on streams of mixed frames in random pieces with noise, compared with decoding the separate frames."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from benchmarks.measure import Timing, compare_once
from benchmarks.row import Row, Target, slower
from benchmarks.streams import KINDS, Kind, Sample, sample
from framekit.definition.times import LineFormat
from framekit.link.arrivals import FrameArrived
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope

NAME = "Receiver on a stream with 1 % noise"
TARGET = "10 MB in random pieces: ≤ 4 × one decode call per ready-cut frame; linear from 1 to 100 MB"
MILLION = 1_000_000
AT_MOST = Target("at most", 4)
LINEAR = Target("at most", 1.1)
CHARACTER = 500_000
"""Approximate duration of a character in ns; noise is detected by content, not by silence."""


def run(rounds: int) -> list[Row]:
    rows = [_against_decode(kind, min(rounds, 3)) for kind in KINDS]
    return rows + _growth(KINDS[0])


def _against_decode(kind: Kind, rounds: int) -> Row:
    stream = sample(kind, 10 * MILLION)
    pieces = list(stream.pieces())
    found = compare_once(
        {"framekit": lambda: receive(kind, pieces), "ready-cut": lambda: _decode(kind, stream)}, rounds
    )
    row = slower(f"{kind.name}: 10 MB", "decode ready-cut", found["framekit"], found["ready-cut"], AT_MOST, 1e3)
    frames, missed = len(stream.frames), len(stream.frames) - receive(kind, pieces)
    return replace(row, details={**row.details, "frames": frames, "lost to noise": missed})


def receive(kind: Kind, pieces: list[bytes]) -> int:
    """Return the number of frames that a receiver finds in pieces of a port."""
    codec = kind.codec
    line = None if codec.protocol.line.kind == "stream" else LineFormat(9600)
    receiver = Receiver(codec, codec.protocol, Scope(codec.protocol, line=line))
    expected = tuple(dict.fromkeys(name for name, _ in kind.frames))
    count = now = 0
    for piece in pieces:
        now += CHARACTER * len(piece)
        receiver.append(piece, now)
        for arrival in receiver.arrivals(expected):
            count += type(arrival) is FrameArrived
    return count


def _decode(kind: Kind, stream: Sample) -> None:
    decoders, context = kind.codec.decoders, Scope(kind.codec.protocol)
    for name, data in stream.frames:
        decoders[name](data, context)


def _growth(kind: Kind) -> list[Row]:
    """Measure the time per byte at 10 and 100 MB, as multiples of the time at 1 MB."""
    pieces = {size: list(sample(kind, size * MILLION).pieces()) for size in (1, 10, 100)}
    found = compare_once({str(size): partial(receive, kind, cut) for size, cut in pieces.items()}, 1)
    each = {size: Timing(tuple(it / size for it in found[str(size)].rounds)) for size in pieces}
    names = {size: f"{kind.name}: {size} MB, time a byte" for size in (10, 100)}
    return [slower(names[size], "1 MB", each[size], each[1], LINEAR, 1e3) for size in (10, 100)]
