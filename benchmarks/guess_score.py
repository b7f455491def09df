"""Measure how often `framekit guess` is right about random protocols, drawn anew in each run.

`make guess-score`, or `python -m benchmarks.guess_score [--seed N] [--count N] [--one SEED]`. Check codes are computed
here bit by bit, so the score does not depend on framekit's own functions.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from framekit.definition.model.checks import CheckMethod, crc_catalogue
from framekit.extras.guess.checks import code_of, cut_at
from framekit.extras.guess.guess import guess
from framekit.extras.guess.model import Guess, HeardBytes
from framekit.extras.guess.stuffing import StuffingError, plain_frame

Code = Callable[[bytes], int]
CHARACTER = 1_041_666
"""Nanoseconds of a character at 9600 8N1."""


def bitwise_crc(data: bytes, width: int, poly: int, init: int, refin: bool, refout: bool, xorout: int) -> int:
    """Compute a CRC bit by bit, as catalogues define it."""
    register, top, ones = init, 1 << width - 1, (1 << width) - 1
    for byte in data:
        for place in range(8):
            bit = byte >> (place if refin else 7 - place) & 1
            register = (register << 1 & ones) ^ (poly if bool(register & top) != bool(bit) else 0)
    if refout:
        register = int(f"{register:0{width}b}"[::-1], 2)
    return register ^ xorout


@dataclass
class Check:
    """A check code of the truth: kind, size, byte order, notation and function."""

    kind: str
    size: int = 0
    order: Any = "big"
    is_hex: bool = False
    start: int = 0
    code: Code = lambda data: 0

    def wire(self, data: bytes) -> bytes:
        raw = self.code(data).to_bytes(self.size, self.order)
        return raw.hex().upper().encode() if self.is_hex else raw


def draw_check(rng: random.Random, text: bool, start_mark: int) -> Check:
    """Draw a method and the start of its range: the frame's start, after its start mark, or two bytes later."""
    start = rng.choice([0, start_mark, start_mark, start_mark + rng.choice([0, 1, 2])])
    kind = rng.choice(["catalogue"] * 4 + ["poly16"] * 3 + ["sum", "sum", "xor", "none"])
    order = rng.choice(["big", "little"])
    if kind == "none":
        return Check("none")
    if kind == "catalogue":
        methods = [entry.method for entry in crc_catalogue() if entry.method.width in (8, 16, 24, 32)]
        one: CheckMethod = rng.choice(methods)
        words = one.width, one.poly, one.initial, one.refin, one.refout, one.xorout
        return Check(kind, one.width // 8, order, text, start, lambda data: bitwise_crc(data, *words))
    if kind == "poly16":
        refin = rng.random() < 0.5
        words = 16, rng.randrange(1 << 16) | 1, rng.randrange(1 << 16), refin, refin, rng.choice([0, 0xFFFF, 0x1D0F])
        return Check(kind, 2, order, text, start, lambda data: bitwise_crc(data, *words))
    if kind == "sum":
        size, plus, turn = rng.choice([1, 1, 2]), rng.choice([0, 0, 0x55, 1]), rng.choice([1, 1, -1])
        return Check(kind, size, order, text, start, lambda data: (turn * sum(data) + plus) % (1 << 8 * size))
    constant = rng.choice([0, 0, 0xFF, 0x5A])

    def xor(data: bytes) -> int:
        found = constant
        for byte in data:
            found ^= byte
        return found

    return Check(kind, 1, "big", text, start, xor)


@dataclass
class Protocol:
    """The truth of a random protocol."""

    framing: str
    start: bytes = b""
    end: bytes = b""
    length: tuple[int, int, str, int] | None = None
    """Offset, width, order, and number of bytes of the frame that it does not count."""
    escape: str = ""
    check: Check = field(default_factory=lambda: Check("none"))
    text: bool = False
    counter: bool = False
    size: int = 0
    stations: tuple[int, ...] = (1,)
    functions: tuple[int, ...] = (3, 4)


def draw_protocol(rng: random.Random) -> Protocol:
    """Draw a protocol with any framing, fields and a check code."""
    framing = rng.choice(["start_end", "end", "length", "length", "fixed", "pauses", "hdlc", "slip", "cobs", "dle"])
    made = Protocol(framing)
    made.counter = rng.random() < 0.3
    made.stations = tuple(rng.sample(range(1, 32), rng.choice([1, 1, 2, 3])))
    made.functions = tuple(rng.sample(range(1, 100), rng.choice([1, 2, 3])))
    if framing == "start_end":
        made.text, made.start, made.end = (
            True,
            rng.choice([b"\x02", b":", b"\x01", b"#"]),
            rng.choice([b"\x03", b"\r\n", b"\r"]),
        )
    elif framing == "end":
        made.text, made.end = True, rng.choice([b"\r\n", b"\r", b"\n", b"\x03"])
    elif framing == "length":
        made.start = rng.choice([b"", b"\x02", b"\xaa\x55", b"\x68", bytes(rng.sample(range(1, 256), 2))])
        width = rng.choice([1, 1, 2])
        made.length = (
            len(made.start) + rng.choice([0, 1, 2]),
            width,
            rng.choice(["big", "little"]),
            rng.choice([0, 1, 99]),
        )
    elif framing == "fixed":
        made.size, made.start = rng.randrange(6, 16), rng.choice([b"", b"\xaa", b"\x55\xaa"])
    elif framing == "pauses":
        made.start = rng.choice([b"", b"", b"\x02"])
    elif framing in ("hdlc", "slip", "dle"):
        made.escape = framing
    made.check = draw_check(rng, made.text, len(made.start))
    if made.framing == "pauses" and made.check.kind == "none":
        made.check = Check("sum", 1, "big", False, 0, lambda data: sum(data) % 256)
    return made


def build(made: Protocol, rng: random.Random, number: int, reply: bool, request: bytes) -> tuple[bytes, bytes]:
    """Build a frame; return its content, which the reply repeats, and its bytes on the line."""
    if made.text:
        station = request[:2] if reply else b"%02X" % rng.choice(made.stations)
        function = request[2:4] if reply else b"%02X" % rng.choice(made.functions)
        body = b"".join(
            b"%02X" % rng.randrange(256) for _ in range(rng.choice([1, 2, 4]) if not reply else rng.choice([2, 3, 8]))
        )
        content = station + function + body
    else:
        head = request[:2] if reply else bytes([rng.choice(made.stations), rng.choice(made.functions)])
        count = bytes([number & 0xFF]) if made.counter else b""
        size = rng.choice([2, 4]) if not reply else rng.choice([1, 4, 6, 9])
        if made.size:
            size = made.size - len(made.start) - 2 - len(count) - made.check.size
            size = max(1, size)
        content = head + count + bytes(rng.choice([0, rng.randrange(256)]) for _ in range(size))
    return content, framed(made, content)


def framed(made: Protocol, content: bytes) -> bytes:
    """Return the content with its length, check code, stuffing and marks."""
    check, stuffed = made.check, made.framing in ("hdlc", "slip", "cobs", "dle")
    start = b"" if stuffed else made.start
    if made.length is not None:
        offset, width, order, less = made.length
        whole = len(start) + len(content) + width + check.size * (2 if check.is_hex else 1)
        number = whole - (offset + width if less == 99 else less)
        at = offset - len(start)
        content = content[:at] + number.to_bytes(width, order) + content[at:]  # type: ignore[arg-type]
    inner = start + content
    if check.kind != "none":
        counted = inner[max(0, check.start - len(made.start)) if stuffed else check.start :]
        inner += check.wire(counted)
    match made.framing:
        case "hdlc":
            return (
                b"~"
                + b"".join(bytes([0x7D, byte ^ 0x20]) if byte in (0x7D, 0x7E) else bytes([byte]) for byte in inner)
                + b"~"
            )
        case "slip":
            codes = {0xC0: b"\xdb\xdc", 0xDB: b"\xdb\xdd"}
            return b"\xc0" + b"".join(codes.get(byte, bytes([byte])) for byte in inner) + b"\xc0"
        case "dle":
            return b"\x10\x02" + inner.replace(b"\x10", b"\x10\x10") + b"\x10\x03"
        case "cobs":
            found, group = bytearray(), bytearray()
            for one in inner:
                if one:
                    group.append(one)
                if not one or len(group) == 254:
                    found += bytes([len(group) + 1]) + group
                    group = bytearray()
            return bytes(found + bytes([len(group) + 1]) + group + b"\0")
    return inner + made.end


@dataclass
class Case:
    """A recording of a random protocol, and its truth."""

    seed: int
    made: Protocol
    chunks: list[HeardBytes]
    good: list[bytes]
    fresh: list[bytes]
    is_damaged: bool


def draw_case(seed: int) -> Case:
    """Draw 5 to 200 frames, on one wire or two, some split or joined, clean or with 1 % damaged frames."""
    rng = random.Random(seed)
    made = draw_protocol(rng)
    damage = rng.choice([0.0, 0.01])
    two_ways, has_times = rng.random() < 0.6, made.framing in ("pauses", "fixed") or rng.random() < 0.7
    by_content = made.framing not in ("pauses", "fixed")
    frames: list[tuple[str, bytes, bool]] = []
    for number in range(rng.choice([5, 10, 20, 40, 100]) // 2 + 1):
        content, request = build(made, rng, number, False, b"")
        _, reply = build(made, rng, number, True, content)
        for way, data in (("out", request), ("in", reply)):
            is_good = rng.random() >= damage
            if not is_good:
                place = rng.randrange(len(data))
                data = data[:place] + bytes([data[place] ^ 1 << rng.randrange(8)]) + data[place + 1 :]
            frames.append((way if two_ways else "", data, is_good))
    chunks: list[HeardBytes] = []
    now = 0
    for way, data, _ in frames:
        cut = rng.randrange(1, len(data)) if by_content and rng.random() < 0.05 and len(data) > 2 else 0
        for part in (data[:cut], data[cut:]) if cut else (data,):
            time_ = now if has_times else None
            chunks.append(HeardBytes(time_, way, part))  # type: ignore[arg-type]
            now += len(part) * CHARACTER
        now += round(rng.uniform(5, 40) * CHARACTER)
    fresh = []
    for number in range(20):
        content, request = build(made, rng, number, False, b"")
        fresh.append(request if rng.random() < 0.5 else build(made, rng, number, True, content)[1])
    return Case(seed, made, chunks, [data for _, data, is_good in frames if is_good], fresh, damage > 0)


@dataclass
class Marks:
    """The result of one case; None if the case does not test the item."""

    framing: bool
    check: bool | None
    length: bool | None
    wrong: list[str]
    sure: int
    seconds: float


def judged(case: Case) -> Marks:
    """Compare the guess for a case with its truth."""
    began = time.perf_counter()
    found = guess(case.chunks)
    seconds = time.perf_counter() - began
    found_frames = Counter(frame.data for frame in found.frames)
    wanted = Counter(case.good)
    if case.made.framing in ("hdlc", "slip", "cobs"):  # a mark between two frames may belong to either
        mark = {"hdlc": b"~", "slip": b"\xc0", "cobs": b"\0"}[case.made.framing]
        found_frames, wanted = (
            Counter({score.strip(mark): 0 for score in some}) + Counter(x.strip(mark) for x in some.elements())
            for some in (found_frames, wanted)
        )
    hit = sum((found_frames & wanted).values())
    framing = hit >= 0.95 * sum(wanted.values())
    wrong: list[str] = []
    check: bool | None = None
    sizes = {len(frame) for frame in case.good}
    if case.made.check.kind != "none":
        right = found.check is not None and _check_is_right(found, case)
        if found.check is not None and found.check.is_sure and not right:
            wrong.append(f"check {found.check.name or found.check.method}")
        if len(set(case.good)) >= 10 and len(sizes) >= 2:
            check = right
    elif found.check is not None and found.check.is_sure:
        wrong.append(f"check {found.check.name or found.check.method}, and there is none")
    length: bool | None = None
    if case.made.length is not None:
        offset, width, _, _ = case.made.length
        guessed = None if found.framing is None else found.framing.length
        length = guessed is not None and (
            guessed.offset <= offset + width - 1 < guessed.end or guessed.offset == offset
        )
    sure = [statement for statement in found.statements if statement.is_sure]
    wrong += _wrong_fields(found, case)
    if found.framing is not None and found.framing.kind == "length" and case.made.length is None and framing is False:
        wrong.append("length")
    return Marks(framing, check, length, wrong, len(sure), seconds)


def _check_is_right(found: Guess, case: Case) -> bool:
    assert found.check is not None and found.framing is not None
    good = 0
    for frame in case.fresh:
        try:
            cut = cut_at(found.check.place, plain_frame(found.framing, frame))
        except StuffingError:
            cut = None
        good += cut is not None and code_of(found.check, cut.data) == cut.code
    return good == len(case.fresh)


def _wrong_fields(found: Guess, case: Case) -> list[str]:
    """Return the counters, counts and copies that are reported as sure but wrong."""
    wrong = []
    for kind in found.kinds:
        for one in kind.fields:
            if one.evidence.chance < 20 or one.kind not in ("counter", "copy"):
                continue
            if one.kind == "counter" and not case.made.counter:
                wrong.append(f"counter at {one.offset}")
    return wrong


def one_case(seed: int) -> tuple[int, str, str, bool, Marks]:
    """Return the result of a case by its seed, for worker processes."""
    case = draw_case(seed)
    return seed, case.made.framing, case.made.check.kind, case.is_damaged, judged(case)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, help="draw the same again")
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--one", type=int, metavar="SEED", help="show one case")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    words = parser.parse_args()
    if words.one is not None:
        show(draw_case(words.one))
        return
    seed = random.SystemRandom().randrange(1 << 32) if words.seed is None else words.seed
    drawn = random.Random(seed)
    seeds = [drawn.randrange(1 << 48) for _ in range(words.count)]
    with multiprocessing.Pool(words.processes) as pool:
        results = pool.map(one_case, seeds, chunksize=8)
    rows: dict[str, list[Marks]] = defaultdict(list)
    for _, framing, check, _, marks in results:
        rows[f"framing {framing}"].append(marks)
        rows[f"check {check}"].append(marks)
    print(f"seed {seed}, {len(results)} made-up protocols")
    print(f"{'':<20} {'cases':>6} {'framing':>8} {'check':>8} {'length':>8}")
    for name, some in [*sorted(rows.items()), ("all", [result[4] for result in results])]:
        shares = [share([getattr(score, what) for score in some]) for what in ("framing", "check", "length")]
        print(f"{name:<20} {len(some):>6} " + " ".join(f"{share:>8}" for share in shares))
    sure = sum(result[4].sure for result in results)
    wrong = [(result[0], said) for result in results for said in result[4].wrong]
    slowest = max(result[4].seconds for result in results)
    print(
        json.dumps(
            {
                "sure statements": sure,
                "wrong among them": len(wrong),
                "share": f"{len(wrong) / max(1, sure):.2%}",
                "slowest (s)": round(slowest, 2),
            }
        )
    )
    for one, error in wrong[:40]:
        print(f"wrong: --one {one}: {error}")
    for one, framing, check, damaged, marks in results:
        if not marks.framing or marks.check is False:
            how = ", damaged" if damaged else ""
            print(f"missed: --one {one}: framing {framing} {marks.framing}, check {check} {marks.check}{how}")


def share(some: list[bool | None]) -> str:
    known = [score for score in some if score is not None]
    return f"{sum(known) / len(known):.1%}" if known else "-"


def show(case: Case) -> None:
    """Print a case in full, with its guess."""
    made = case.made
    print(made, "damaged" if case.is_damaged else "clean")
    for chunk in case.chunks[:40]:
        print(chunk.time, chunk.direction, chunk.data.hex(" "))
    found = guess(case.chunks)
    print(found.framing, found.check)
    for statement in found.statements:
        print("sure" if statement.is_sure else "maybe", statement.text, statement.evidence)
    print(judged(case))


if __name__ == "__main__":
    main()
