"""Noise: processor time per byte for every shipped protocol and role, on random bytes and on the worst bytes found."""

from __future__ import annotations

from random import Random

from benchmarks.measure import quartiles
from benchmarks.noise import PIECE, SMALL, Link, links, seconds, shipped, turn, worst
from benchmarks.row import Row, Target

NAME = "Noise, time a byte and a turn of the loop"
TARGET = (
    "≤ 3 µs a byte of random noise, ≤ 6 µs of the worst that a search of a few seconds finds, also in small pieces; "
    "a turn ≤ 10 ms"
)
SEARCH = 0.5
"""Seconds of search for each role and size of pieces."""


def run(rounds: int) -> list[Row]:
    found = []
    usual = Random(1).randbytes(65_536)
    for link in links(shipped()):
        for piece, cut in ((PIECE, ""), (SMALL, ", small pieces")):
            bad = worst(link, SEARCH, piece)[1] * 20
            found.append(_row(link, f"random bytes{cut}", usual, piece, 3, rounds))
            found.append(_row(link, f"worst bytes{cut}", bad, piece, 6, rounds))
            if piece == PIECE:
                longest = 1000 * turn(link, bad)
                found.append(Row(f"{link}: turn with them", "", longest, longest, longest, Target("at most", 10), "ms"))
    return found


def _row(link: Link, kind: str, data: bytes, piece: int, most: float, rounds: int) -> Row:
    times = sorted(1e6 * seconds(link, data, piece) for _ in range(min(rounds, 3)))
    low, high = quartiles(times)
    return Row(f"{link}: {kind}", "", times[len(times) // 2], low, high, Target("at most", most), "µs")
