"""Search for check codes: framekit and crcglot, which recovers CRCs from codewords, on the same frames.

`python -m benchmarks.check_search` needs crcglot (pip install crcglot). A result is right if it computes the codes of
other frames of the same protocol.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.guess_score import bitwise_crc
from framekit.definition.model.checks import crc_catalogue
from framekit.extras.guess.checks import find_checks, holds

Words = tuple[int, int, int, bool, bool, int]


@dataclass
class Frames:
    """Frames with a CRC that ignores the first `start` bytes and precedes the last `tail` bytes.

    `fresh` are further frames.
    """

    words: Words
    start: int
    tail: int
    seen: list[bytes]
    fresh: list[bytes]


def drawn(rng: random.Random, kind: str) -> Frames:
    """Draw 20 frames of three sizes, big-endian. Kinds: plain, unlisted (any polynomial), inside, damaged."""
    method = rng.choice([entry.method for entry in crc_catalogue() if entry.method.width in (16, 32)])
    words: Words = method.width, method.poly, method.initial, method.refin, method.refout, method.xorout
    if kind == "unlisted":
        refin = rng.random() < 0.5
        words = 16, rng.randrange(1 << 16) | 1, rng.randrange(1 << 16), refin, refin, rng.randrange(1 << 16)
    start, tail = (1, 1) if kind == "inside" else (0, 0)

    def frame() -> bytes:
        size = rng.choice([6, 9, 14])
        data = bytes([rng.randrange(1, 30)]) + bytes(rng.choice([0, rng.randrange(256)]) for _ in range(size))
        code = bitwise_crc(data[start:], *words).to_bytes(words[0] // 8, "big")
        return data + code + b"\x03" * tail

    seen, fresh = [frame() for _ in range(20)], [frame() for _ in range(20)]
    if kind == "damaged":
        seen[7] = seen[7][:3] + bytes([seen[7][3] ^ 4]) + seen[7][4:]
    return Frames(words, start, tail, seen, fresh)


def by_framekit(frames: Frames) -> bool:
    found = find_checks(frames.seen, 0, frames.tail)
    return bool(found) and all(holds(found[0], frame) for frame in frames.fresh)


def by_crcglot(frames: Frames) -> bool:
    import crcglot

    size = frames.words[0] // 8
    try:
        result = crcglot.reverse_packets(frames.seen, std_algo_only=False)
    except ValueError:
        return False
    if not result or result.info is None:
        return False
    own = result.info
    words = own.width, own.poly, own.init, own.refin, own.refout, own.xorout
    return all(bitwise_crc(frame[:-size], *words).to_bytes(size, "big") == frame[-size:] for frame in frames.fresh)


def main() -> None:
    print(f"{'frames':<10} {'framekit':>16} {'crcglot':>16}")
    for kind in ("plain", "unlisted", "inside", "damaged"):
        cases = [drawn(random.Random(f"{kind} {seed}"), kind) for seed in range(60)]
        row = []
        for find in (by_framekit, by_crcglot):
            row.append(_figures(find, cases))
        print(f"{kind:<10} {row[0]:>16} {row[1]:>16}")


def _figures(find: Callable[[Frames], bool], cases: list[Frames]) -> str:
    began = time.perf_counter()
    right = sum(find(case) for case in cases)
    each = (time.perf_counter() - began) / len(cases)
    return f"{right / len(cases):.0%}, {each * 1e3:.0f} ms"


if __name__ == "__main__":
    main()
