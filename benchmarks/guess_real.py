"""Measure how often `framekit guess` is right about recordings of other programs, whose protocols are known.

`python -m benchmarks.guess_real [--seed N] [--one NAME]`; `make guess-score` runs it, too. The first 5, 10, 20, 50, 100
and 200 frames of each file in tests/data/guess are guessed separately, clean and with 1 % of the frames damaged.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.guess_score import Marks, share
from framekit.extras.guess.checks import holds
from framekit.extras.guess.guess import guess
from framekit.extras.guess.model import CheckGuess, Guess, HeardBytes
from framekit.extras.guess.recordings import heard
from framekit.extras.guess.stuffing import StuffingError, plain_frame

FOLDER = Path(__file__).parent.parent / "tests" / "data" / "guess"
COUNTS = (5, 10, 20, 50, 100, 200)
LEAST_DAMAGED = 20
"""Number of frames from which on at least one is damaged: 1 % of fewer frames is none."""

Size = Callable[[bytes, bool], int]
"""A function of the bytes at a frame's start, and whether the client sent them; it returns the frame's size."""


def number(offset: int, width: int, order: str, plus: int) -> Size:
    """Return a size function for a length field; `plus` bytes are not counted by it."""
    return lambda data, asked: int.from_bytes(data[offset : offset + width], order) + plus  # type: ignore[arg-type]


def ended(end: bytes) -> Size:
    """Return a size function for a mark at the end."""
    return lambda data, asked: data.find(end, 1) + len(end)


def rtu(data: bytes, is_request: bool) -> int:
    function = data[1]
    if function & 0x80:
        return 5
    if function in (15, 16):
        return 9 + data[6] if is_request else 8
    return 8 if is_request or function in (5, 6) else 5 + data[2]


def df1(data: bytes, is_request: bool) -> int:
    if data[1] != 2:
        return 2
    at = 2
    while data[at : at + 2] != b"\x10\x03":
        at += 2 if data[at] == 0x10 else 1
    return at + 4


def m_bus(data: bytes, is_request: bool) -> int:
    return {0xE5: 1, 0x10: 5}.get(data[0]) or data[1] + 6


def mode_c(data: bytes, is_request: bool) -> int:
    return data.find(b"\x03") + 2 if data[0] == 2 else data.find(b"\r\n") + 2


def osdp(data: bytes, is_request: bool) -> int:
    before = data[0] == 0xFF  # optional mark before a command
    return before + int.from_bytes(data[before + 2 : before + 4], "little")


def always(frame: bytes) -> bool:
    return True


@dataclass(frozen=True)
class RealTruth:
    """The known facts of a protocol.

    `checked` selects the frames with a check code, None: no frames; `length` is offset, width and order of its length
    field; `counters`, `counts` and `copies` are the offsets that may be reported as such.
    """

    group: str
    size: Size
    checked: Callable[[bytes], bool] | None = always
    length: tuple[int, int, str] | None = None
    counters: frozenset[int] = frozenset()
    counts: frozenset[int] = frozenset()
    copies: frozenset[int] = frozenset()


def of(*places: int) -> frozenset[int]:
    return frozenset(places)


RTU = RealTruth("Modbus RTU", rtu, counts=of(2, 5, 6), copies=of(0, 1, 2, 3, 4, 5))
ASCII = RealTruth("Modbus ASCII", ended(b"\r\n"), counts=of(3, 6, 7), copies=of(*range(1, 7)))
TCP = RealTruth(
    "Modbus TCP", number(4, 2, "big", 6), None, (4, 2, "big"), counters=of(0, 1), counts=of(5, 8, 11, 12),
    copies=of(*range(4), *range(6, 12)),
)  # fmt: skip
TRUTHS = {
    "pymodbus-rtu": RTU, "minimalmodbus-rtu": RTU, "mbpoll-rtu": RTU, "mbpoll-silent": RTU,
    "pymodbus-silent": RTU,
    "pymodbus-ascii": ASCII, "minimalmodbus-ascii": ASCII, "pymodbus-tcp": TCP, "mbpoll-tcp": TCP,
    "df1": RealTruth("controllers", df1, lambda frame: len(frame) > 2, counters=of(6, 7), counts=of(8, 9)),
    "melsec-3e": RealTruth(
        "controllers", number(7, 2, "little", 9), None, (7, 2, "little"), counts=of(7, 8, 19), copies=of(*range(1, 7))
    ),
    "melsec-4e": RealTruth(
        "controllers", number(11, 2, "little", 13), None, (11, 2, "little"), counts=of(11, 12, 23),
        copies=of(*range(1, 11)),
    ),
    "melsec-3e-ascii": RealTruth(
        "controllers", lambda data, asked: 18 + int(data[14:18], 16), None, (14, 4, "big"), counts=of(*range(14, 18)),
        copies=of(*range(1, 14)),
    ),
    "fins-tcp": RealTruth(
        "controllers", number(4, 4, "big", 8), None, (4, 4, "big"), counts=of(*range(4, 8), 33), copies=of(*range(40))
    ),
    "melsec-1c": RealTruth(
        "controllers", ended(b"\r\n"), lambda frame: len(frame) > 7, counts=of(12, 13), copies=of(*range(1, 5))
    ),
    "mewtocol": RealTruth("controllers", ended(b"\r"), copies=of(1, 2, 4, 5)),
    "dynamixel-2": RealTruth(
        "drives, sensors, readers", number(5, 2, "little", 7), length=(5, 2, "little"), counts=of(5, 7, 10),
        copies=of(*range(5)),
    ),
    "shdlc": RealTruth("drives, sensors, readers", ended(b"~"), counts=of(3, 4), copies=of(1, 2)),
    "osdp": RealTruth("drives, sensors, readers", osdp, counts=of(2, 3), copies=of()),
    "m-bus": RealTruth("meters", m_bus, lambda frame: len(frame) > 1, counts=of(1, 2)),
    "iec62056-21": RealTruth("meters", mode_c, None),
    "pylontech": RealTruth("meters", ended(b"\r")),
    "nmea": RealTruth("receivers of positions", ended(b"\r\n")),
    "ubx": RealTruth("receivers of positions", number(4, 2, "little", 8), length=(4, 2, "little")),
    "sbf": RealTruth("receivers of positions", number(6, 2, "little", 0), length=(6, 2, "little"), counters=of(19)),
    "rtcm3": RealTruth("receivers of positions", number(1, 2, "big", 6), length=(1, 2, "big")),
    "esp3": RealTruth("radio and flight", lambda data, asked: 7 + data[2] + data[3], length=(1, 2, "big")),
    "xbee": RealTruth("radio and flight", number(1, 2, "big", 4), length=(1, 2, "big"), counters=of(4)),
    "msp": RealTruth("radio and flight", number(3, 1, "big", 6), length=(3, 1, "big")),
    "znp": RealTruth("radio and flight", number(1, 1, "big", 5), length=(1, 1, "big")),
}  # fmt: skip


@dataclass
class RealCase:
    """The first frames of a file.

    `good` are the undamaged frames; `all` is every frame of the file with its direction.
    """

    name: str
    truth: RealTruth
    chunks: list[HeardBytes]
    good: list[bytes]
    all: list[tuple[str, bytes]]
    is_damaged: bool
    spans: list[tuple[str, int, int]] = field(default_factory=list)


def case_of(name: str, count: int, damage: random.Random | None = None) -> RealCase:
    """Return the first `count` frames of a file; with `damage`, 1 % of them have a wrong bit."""
    truth, chunks = TRUTHS[name], heard(FOLDER / f"{name}.pcap")
    client = chunks[0].direction
    streams = {way: b"".join(chunk.data for chunk in chunks if chunk.direction == way) for way in ("in", "out")}
    ends = dict.fromkeys(streams, 0)
    every, spans = list[tuple[str, bytes]](), list[tuple[str, int, int]]()
    some, known = list[HeardBytes](), dict.fromkeys(streams, 0)
    for chunk in chunks:  # the offset of a frame is that of its last byte
        way = chunk.direction
        known[way] += len(chunk.data)
        if len(spans) < count:
            some.append(chunk)
        while ends[way] < known[way]:
            begin, stream = ends[way], streams[way]
            ends[way] = begin + truth.size(stream[begin:], way == client)
            assert begin < ends[way] <= len(stream), f"{name}: no frame at {begin} of {way}"
            every.append((way, stream[begin : ends[way]]))
            if chunk in some[-1:]:
                spans.append((way, begin, ends[way]))
    hurt = {way: bytearray(stream) for way, stream in streams.items()}
    chosen: set[int] = set()
    if damage is not None:
        chosen = {at for at in range(len(spans)) if damage.random() < 0.01}
        if not chosen and len(spans) >= LEAST_DAMAGED:
            chosen = {damage.randrange(len(spans))}
        for at in chosen:
            way, begin, end = spans[at]
            hurt[way][damage.randrange(begin, end)] ^= 1 << damage.randrange(8)
    known = dict.fromkeys(streams, 0)
    for at, chunk in enumerate(some):
        way, begin = chunk.direction, known[chunk.direction]
        known[way] = end = begin + len(chunk.data)
        some[at] = chunk._replace(data=bytes(hurt[way][begin:end]))
    good = [streams[way][begin:end] for at, (way, begin, end) in enumerate(spans) if at not in chosen]
    return RealCase(name, truth, some, good, every, damage is not None, spans)


def judged_real(case: RealCase) -> Marks:
    """Compare the guess for a case with the known protocol."""
    began = time.perf_counter()
    found = guess(case.chunks)
    seconds = time.perf_counter() - began
    found_frames, wanted = Counter(frame.data for frame in found.frames), Counter(case.good)
    framing = sum((found_frames & wanted).values()) >= 0.95 * sum(wanted.values())
    wrong: list[str] = []
    check: bool | None = None
    checked = [] if case.truth.checked is None else [frame for frame in case.all if case.truth.checked(frame[1])]
    checks_found = _checks_of(found)
    right = bool(checks_found) and all(
        any(_is_right(found, check, frame) for check in checks_found) for _, frame in checked
    )
    own = [frame for frame in case.good if case.truth.checked is not None and case.truth.checked(frame)]
    wrong += [
        f"check {rule.name or rule.method}"
        for rule in checks_found
        if rule.is_sure and not _is_true(found, rule, checked)
    ]  # fmt: skip
    if len(set(own)) >= 10 and len({len(frame) for frame in own}) >= 2:
        check = right
    length: bool | None = None
    sure = [statement for statement in found.statements if statement.is_sure]
    guessed = None if found.framing is None else found.framing.length
    if case.truth.length is not None:
        offset, width, order = case.truth.length
        low = offset if order == "little" else offset + width - 1
        length = guessed is not None and (guessed.offset <= low < guessed.end)
        if guessed is not None and guessed.width > 1:
            length = length and guessed.order == order
    sized = [statement for statement in sure if "its size is" in statement.text]
    if sized and not (framing and length):
        wrong.append(sized[0].text)
    if not framing:
        wrong += [
            statement.text for statement in sure if "by that mark" in statement.text or "inside, " in statement.text
        ]
    wrong += _wrong_fields(found, case.truth)
    return Marks(framing, check, length, wrong, len(sure), seconds)


def _checks_of(found: Guess) -> list[CheckGuess]:
    return list({id(one): one for kind in found.kinds if (one := kind.check) is not None}.values())


def _is_right(found: Guess, check: CheckGuess, frame: bytes) -> bool:
    assert found.framing is not None
    try:
        return holds(check, plain_frame(found.framing, frame))
    except StuffingError:
        return False


def _is_true(found: Guess, check: CheckGuess, checked: Sequence[tuple[str, bytes]]) -> bool:
    """Return whether the check is right in all frames of the same direction and first byte as its kinds."""
    heads = {(kind.direction, frame.data[:1]) for kind in found.kinds if kind.check is check for frame in kind.frames}
    frames = [frame for way, frame in checked if (way, frame[:1]) in heads]
    return bool(frames) and all(_is_right(found, check, frame) for frame in frames)


def _wrong_fields(found: Guess, truth: RealTruth) -> list[str]:
    """Return the counters, counts and copies that are reported as sure but wrong."""
    allowed = {"counter": truth.counters, "count": truth.counts, "copy": truth.copies}
    return [
        f"{kind.name}: {field.kind} at {field.offset}"
        for kind in found.kinds
        for field in kind.fields
        if field.kind in allowed and field.evidence.chance >= 20 and field.offset not in allowed[field.kind]
    ]


def cases_of(name: str, seed: int) -> list[RealCase]:
    """Return all cases of a file."""
    whole = len(case_of(name, 1 << 30).spans)
    counts = [count for count in COUNTS if count < whole] + [min(whole, COUNTS[-1])]
    found = []
    for count in dict.fromkeys(counts):
        found.append(case_of(name, count))
        if count >= LEAST_DAMAGED:
            found.append(case_of(name, count, random.Random(f"{seed} {name} {count}")))
    return found


def all_of(words: tuple[str, int]) -> list[tuple[str, int, bool, Marks]]:
    """Return the results of all cases of a file, for worker processes."""
    return [(case.name, len(case.spans), case.is_damaged, judged_real(case)) for case in cases_of(*words)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of the damage")
    parser.add_argument("--one", metavar="NAME", help="one file")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    words = parser.parse_args()
    names = [words.one] if words.one else sorted(TRUTHS)
    with multiprocessing.Pool(words.processes) as pool:
        results = [
            result for some in pool.map(all_of, [(name, words.seed) for name in names], chunksize=1) for result in some
        ]
    rows: dict[str, list[Marks]] = defaultdict(list)
    for name, _, _, marks in results:
        rows[TRUTHS[name].group].append(marks)
    print(f"{len(names)} recordings of programs not written here")
    print(f"{'':<26} {'cases':>6} {'framing':>8} {'check':>8} {'length':>8}")
    for title, some in [*sorted(rows.items()), ("all", [result[3] for result in results])]:
        shares = [share([getattr(result, what) for result in some]) for what in ("framing", "check", "length")]
        print(f"{title:<26} {len(some):>6} " + " ".join(f"{share:>8}" for share in shares))
    sure, wrong = sum(result[3].sure for result in results), sum(len(result[3].wrong) for result in results)
    slowest = max(result[3].seconds for result in results)
    print(f"sure statements: {sure}, wrong among them: {wrong} ({wrong / max(1, sure):.2%}), slowest {slowest:.2f} s")
    for name, count, damaged, marks in results:
        what = f"{name}, {count} frames{', damaged' if damaged else ''}"
        for text in marks.wrong:
            print(f"wrong: {what}: {text}")
        if not marks.framing or marks.check is False or marks.length is False:
            print(f"missed: {what}: framing {marks.framing}, check {marks.check}, length {marks.length}")


if __name__ == "__main__":
    main()
