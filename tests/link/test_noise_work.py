"""Noise costs little per byte for any cuts: calls are counted, since they do not depend on the load of the machine."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import cache
from itertools import product
from random import Random
from typing import Any

import pytest
from shipped import PROTOCOLS
from spread import spread

from benchmarks import noise as bench
from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.codec.samples import Sampler
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.link.engine import Engine
from framekit.link.events import Monitor, Seen
from framekit.link.receiver import BAD_APART, GOES_ON, MOST_BAD

SIZE = 6_000
MOST = 15
"""Largest number of function calls per byte of random noise; the most expensive protocol needs 9, apart from these."""
MOST_OF = {"m-bus": 26, "host-link": 30, "mewtocol": 24}
"""M-Bus: random bytes contain many frames of five bytes, and records that are diagnosed: 18, in small pieces 23.6.

Host Link: frames of a long response begin with any byte, so a check code is computed from each byte on: 21.5, and 28.6.
"""


@cache
def compiled(name: str) -> tuple[Any, Any]:
    protocol = load_protocol(name)
    return protocol, compile_protocol(protocol)


def engine(name: str, role: str | None, monitor: Monitor | None = None) -> Engine:
    protocol, codec = compiled(name)
    own: Any = {"number": 1, "text": "A", "bytes": bytes(protocol.station.size or 0)}.get(protocol.station.type)
    made = Engine(protocol, codec, role, own=own, monitor=monitor)
    made.opened(0)
    return made


def calls(
    name: str, role: str | None, pieces: list[bytes], monitor: Monitor | None = None, pause: int = 1000
) -> tuple[int, Engine]:
    """Return the number of function calls while these pieces arrive with pauses (ns) between them."""
    hearing = engine(name, role, monitor)
    return calls_of(hearing, pieces, pause), hearing


def calls_of(hearing: Engine, pieces: list[bytes], pause: int = 1000) -> int:
    """Return the number of calls as `calls` does, for an engine."""
    count, now = 0, 1_000_000_000

    def counted(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(counted)
    try:
        for piece in pieces:
            while hearing.deadline <= now:
                hearing.tick(hearing.deadline)
            hearing.receive(piece, now)
            now += pause
    finally:
        sys.setprofile(None)
    return count


def cut(data: bytes, size: int) -> list[bytes]:
    return [data[place : place + size] for place in range(0, len(data), size)]


NAMES = [name for name in PROTOCOLS if name != "standard"]


def roles_of(name: str) -> list[str | None]:
    return [*compiled(name)[0].roles] or [None]


@pytest.mark.parametrize("name", spread(NAMES, 6))
def test_a_byte_of_random_noise_takes_few_calls(name: str) -> None:
    data = Random(1).randbytes(SIZE)
    for role in roles_of(name):
        calls(name, role, cut(data[:1500], 150))  # build the tables that receivers share, which are not counted
    for role, size in product(roles_of(name), (64, 1500, SIZE)):
        count, hearing = calls(name, role, cut(data, size))
        assert count / len(data) < MOST_OF.get(name, MOST), (role, size)
        counters = hearing.counters
        assert counters.noise_bytes or counters.bad or hearing.receiver.stream.buffer or hearing.receiver.broken


@pytest.mark.parametrize("name", spread(NAMES, 8, 3))
def test_the_work_a_byte_does_not_grow_with_the_noise(name: str) -> None:
    data = Random(2).randbytes(4 * SIZE)
    for role in roles_of(name):
        few, many = calls(name, role, cut(data[:SIZE], 750))[0], calls(name, role, cut(data, 750))[0]
        assert many < 4 * few * 1.5 + 10_000, role


@pytest.mark.parametrize("name", ["modbus-rtu", "ge-rtu"])
def test_frames_that_silence_ends_hold_nothing_up_for_longer_than_their_greatest_length(name: str) -> None:
    hearing = engine(name, "server")
    most = compiled(name)[0].frames["request_adu"].most
    for number, piece in enumerate(cut(Random(1).randbytes(SIZE), 100)):
        hearing.receive(piece, 1_000_000_000 + 1000 * number)
        assert len(hearing.receiver.stream.buffer) - hearing.receiver.stream.position <= most + 100
    assert hearing.counters.bad > SIZE // (2 * most)


PARTS = 4
"""Number of tests among which the worst bytes are divided."""
WORST, WORST_IN_SMALL_PIECES = 36, 46
"""Largest number of calls per byte of the worst bytes that `benchmarks/noise.py` has found.

The other protocols need at most 27 and 41.
"""
WORST_OF, SMALL_OF = {"nmea0183": 46}, {"nmea0183": 64, "mewtocol": 50}
"""A damaged sentence of 14 bytes is tried as each of twelve sentences, text by text: 45.5, and 63.3 in small pieces."""


@cache
def first_bytes(name: str) -> list[bytes]:
    """Return beginnings of frames of a protocol, and frames whose last byte is wrong."""
    protocol, codec = compiled(name)
    sampler = Sampler(codec, engine(name, next(iter(protocol.roles), None)).scope)
    drawn = [sample.data for frame in protocol.frames for sample in sampler.samples(frame, 1, 5) if sample.data]
    frames = sorted(drawn, key=len)[:: max(1, len(drawn) // 4)]
    return [part for data in frames for part in (data[:3], data[:-1] + bytes([data[-1] ^ 0x55]))]


def worst(name: str) -> Iterator[bytes]:
    """Yield the most expensive streams found: a repeated byte, repeated starts, a series of damaged frames."""
    yield from (bytes([byte]) * SIZE for byte in (0x00, 0x03, 0x05, 0x06, 0x15, 0x1B, 0x10, 0xFF))
    inside = (b"\x05" * 60 + b"\x04", b"\x06" * 60 + b"\x03")
    for few in (b"\xc3\xff", b"\x10\x01", b"\x05\x41", b"\x42\x36\x04", b"\x1b\x1b\x00\x59", *inside):
        yield (few * SIZE)[:SIZE]
    for part in first_bytes(name):
        yield (part * SIZE)[:SIZE]


@pytest.mark.parametrize(("name", "part"), spread(product(NAMES, range(PARTS)), 3 * PARTS + 1, part=3))
def test_the_worst_bytes_take_few_calls_too(name: str, part: int) -> None:
    watched = (False, True) if name.endswith("rtu") else (False,)
    for role, data, is_watched in product(roles_of(name), [*worst(name)][part::PARTS], watched):
        seen: list[Seen] = []
        calls(name, role, cut(data[:300], 150))  # build the tables that receivers share, which are not counted
        count, hearing = calls(name, role, cut(data[:1500], 750), seen.append if is_watched else None)
        if hearing.counters.received * 200 < 1500:
            assert count / 1500 < WORST_OF.get(name, WORST), (role, data[:40].hex())


@pytest.mark.parametrize("part", spread(range(PARTS), PARTS + 1, PARTS))
def test_small_pieces_with_pauses_take_few_calls(part: int) -> None:
    """Applies where reading continues after a bad frame.

    Elsewhere, silence or the connection bounds the cost of a piece.
    """
    names = [name for name in NAMES if compiled(name)[0].receiver.resync in GOES_ON]
    assert len(names) > 3
    for name in names:
        for role, data in product(roles_of(name), [Random(1).randbytes(1500), *worst(name)][part::PARTS]):
            calls(name, role, cut(data[:300], 64))  # build the tables that receivers share, which are not counted
            count, hearing = calls(name, role, cut(data[:1500], 64), pause=2_000_000)
            if hearing.counters.received * 200 < 1500:
                assert count / 1500 < SMALL_OF.get(name, WORST_IN_SMALL_PIECES), (name, role, data[:40].hex())


@pytest.mark.parametrize("size", [1, 7, 300, 4000])
def test_of_a_crowd_of_bad_frames_the_first_are_told_and_then_one_for_many_bytes(size: int) -> None:
    seen: list[Seen] = []
    _, hearing = calls("modbus-rtu", "server", cut(b"\xff" * 4000, size), seen.append)
    hearing.tick(3_600_000_000_000)
    bad = [event for event in seen if event.kind == "bad"]
    assert all(event.reason and event.frame for event in bad)
    reported = sum(len(event.raw) for event in seen if event.kind in ("bad", "noise"))
    assert MOST_BAD <= len(bad) == hearing.counters.bad <= MOST_BAD + 4000 // BAD_APART + 1
    assert hearing.counters.noise_bytes == sum(len(event.raw) for event in seen if event.kind == "noise")
    assert 4000 - 2 * BAD_APART < reported <= 4000
    assert "what a bad frame left" in {event.reason for event in seen if event.kind == "noise"}


BAD_TEXT = bytes.fromhex("10 02 01 02 06 00 01 00 10 03 ff ff")
"""A DF1 message with a wrong check code; the next byte starts after it."""


@pytest.mark.parametrize(
    ("unit", "size", "most"),
    [(b"\x10\x01", 1, 400), (b"\x10\x01", 1500, 20), (BAD_TEXT, 7, 35), (BAD_TEXT, 1500, 12)],
    ids=str,
)
def test_of_a_crowd_of_frames_broken_off_or_damaged_only_some_are_told(unit: bytes, size: int, most: int) -> None:
    """Reading continues after a damaged frame (`after_frame`); no byte is lost, and a good frame is found."""
    seen: list[Seen] = []
    data = unit * (3000 // len(unit))
    count, hearing = calls("df1", "full", cut(data + b"\x10\x06", size), seen.append)
    bad = [event for event in seen if event.kind == "bad"]
    assert MOST_BAD <= len(bad) == hearing.counters.bad <= MOST_BAD + len(data) // BAD_APART + 1
    reported = [event.raw for event in seen if event.kind in ("bad", "noise")]
    assert sum(map(len, reported)) == len(data)
    assert [event.frame for event in seen if event.kind == "frame" and event.direction == "in"] == ["ack"]
    assert count / len(data) < most


def test_a_damaged_frame_that_is_not_told_is_passed_over_whole() -> None:
    """Two bytes of the check code look like an ACK; with `after_frame` they are skipped."""
    unit = BAD_TEXT[:-2] + b"\x10\x06"
    for size in (1, 5, 1500):
        _, hearing = calls("df1", "full", cut(unit * 40, size))
        assert hearing.counters.received == 0
        assert hearing.counters.bad < 25


class Searches:
    """Count the bytes in which a pattern is searched."""

    def __init__(self, pattern: Any) -> None:
        self.pattern, self.bytes = pattern, 0

    def search(self, data: bytes, start: int = 0, end: int = sys.maxsize) -> Any:
        found = self.pattern.search(data, start, end)
        self.bytes += (min(end, len(data)) if found is None else found.end()) - start
        return found


def work_byte_by_byte(name: str, role: str, data: bytes) -> tuple[int, int]:
    """Return the executed lines of framekit, and the bytes searched for inner frames, for a message byte by byte."""
    hearing, count = engine(name, role), 0
    finder: Any = hearing.receiver._inside
    finder._marks = searches = Searches(finder._marks)

    def counted(frame: object, event: str, argument: object) -> Any:
        nonlocal count
        count += event == "line"
        return counted

    sys.settrace(counted)
    try:
        for number, byte in enumerate(data):
            hearing.receive(bytes([byte]), 1_000_000_000 + 1000 * number)
    finally:
        sys.settrace(None)
    assert hearing.receiver.waiting == ("message",)
    return count, searches.bytes


@pytest.mark.parametrize("content", [b"\x10\x10", b"\x11\x10\x10", b"\x10\x10\x06"], ids=bytes.hex)
def test_a_lone_message_with_doubled_escapes_byte_by_byte_takes_work_for_each_byte_once(content: bytes) -> None:
    few, many = (work_byte_by_byte("df1", "full", b"\x10\x02" + content * count) for count in (300, 1200))
    for less, more in zip(few, many, strict=True):
        assert more < 4 * 1.2 * less
    assert many[0] < 400 * 1200 * len(content)


@pytest.mark.parametrize(
    "block",
    [b"\x0604Y" * 40 + b"\x03" * 4, b"\x0601rSB0102AAAA\x0300" * 8 + b"\x1504RSB0003\x03"],
    ids=["frames without a check code", "good frames make up for bad ones"],
)
def test_frames_that_end_alike_are_not_all_read(block: bytes) -> None:
    data = (block * 100)[:6000]
    count, hearing = calls("mldp", "server", cut(data, 1500))
    assert hearing.counters.bad
    assert count / len(data) < 32


def test_of_many_frames_inside_only_those_that_may_be_so_short_are_read() -> None:
    """The inner frame has one byte, but the second byte distinguishes fifty frames, so none of them can match."""
    frames = "\n".join(
        f"  i{code}: {{from: none, body: [{{field: a, type: u8}}, {{field: code, type: u8, is: {code}}}]}}"
        for code in range(50)
    )
    inside = ", ".join([*(f"i{code}" for code in range(50)), "single"])
    text = f"""
protocol: many-inside
frames:
{frames}
  single: {{from: none, body: [{{const: 05}}]}}
  outer:
    body: [{{length: n, type: u8, of: [pdu]}}, {{inner: pdu, of: [{inside}]}}, {{check: sum8}}]
"""
    codec = compile_protocol(load_protocol_text(text, "many-inside"))
    for data, value in ((b"\x01\x05\x06", {"single": {}}), (b"\x01\x07\x08", {"unknown": {"data": b"\x07"}})):
        assert codec.frames["outer"].decode(data)["pdu"] == value
        count = 0

        def counted(frame: object, event: str, argument: object) -> None:
            nonlocal count
            count += event == "call"

        sys.setprofile(counted)
        try:
            with pytest.raises(FrameError):
                codec.frames["outer"].decode(data[:2] + b"\0")
        finally:
            sys.setprofile(None)
        assert count < 60


MOST_BY_NUMBER = 120
"""Largest number of calls per byte of starts and damaged frames that begin every two to eleven bytes; 109 are needed.

The faults of two candidates are compared for each bad frame: the innermost fault of the better candidate is reported.
"""


@pytest.mark.long
def test_of_frames_that_a_number_behind_the_head_tells_apart_only_that_one_is_read() -> None:
    """Sixty frames have the same size, and their check code covers a byte that is not transmitted."""
    frames = "\n".join(
        f"  m{code}: {{group: message, where: {{id: {code}}}, body: [{{data: d, size: n}}]}}" for code in range(60)
    )
    text = f"""
protocol: by-number
line: {{kind: stream}}
groups:
  message:
    head: [{{const: FD}}, {{length: n, type: u8, of: [d]}}, {{field: flags, type: u8}}, {{field: id, type: u24}}]
    tail: [{{check: crc16-modbus, over: [n..here, {{bytes: id % 7, type: u8}}], wire: yes}}]
frames:
{frames}
"""
    protocol = load_protocol_text(text, "by-number")
    codec = compile_protocol(protocol)
    good = codec.frames["m42"].encode({"flags": 0, "d": b"abc"})
    bad = good[:-1] + bytes([good[-1] ^ 1])
    starts = [good[:2], good[:3], good[:4] + b"\xff"]
    for data in (Random(1).randbytes(SIZE), *((start * SIZE)[:1500] for start in starts), (bad * SIZE)[:1500]):
        for size in (64, 1500):
            seen: list[Seen] = []
            for _ in range(2):  # build the tables that receivers share, which are not counted
                hearing = Engine(protocol, codec, None, monitor=seen.append)
                hearing.opened(0)
                count = calls_of(hearing, cut(data, size))
            assert count / len(data) < MOST_BY_NUMBER, (data[:8].hex(), size)
            hearing.receive(b"\0" * 300 + good, 2_000_000_000)
            assert [event.frame for event in seen if event.kind == "frame"] == ["m42"]


@pytest.mark.parametrize("name", ["a", "b"])
def test_of_frames_that_silence_ends_with_different_checks_each_is_found_in_what_a_bad_one_left(name: str) -> None:
    text = """
protocol: two-checks
receiver: {gap: 100 ms, quiet: 10 ms, resync: next_start}
frames:
  a: {max: 20, body: [{field: s, type: u8}, {data: d, size: rest}, {check: sum8}]}
  b: {max: 30, body: [{field: t, type: u16}, {data: d, size: rest}, {check: xor8}]}
"""
    protocol = load_protocol_text(text, "two-checks")
    codec = compile_protocol(protocol)
    good = codec.frames[name].encode({"s" if name == "a" else "t": 5, "d": b"\x09\x02"})
    seen: list[Seen] = []
    hearing = Engine(protocol, codec, None, own=1, monitor=seen.append)
    hearing.opened(0)
    hearing.receive(b"\x01\x07\x03\x11\x23" + good, 1_000_000_000)
    hearing.tick(1_020_000_000)
    assert [(event.frame, event.raw) for event in seen if event.kind == "frame"] == [(name, good)]


@pytest.mark.parametrize("name", spread(NAMES, 4, part=4))
def test_the_benchmark_of_noise_has_a_line_for_every_role(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "BLOCK", 100)
    data = Random(3).randbytes(400)
    found = bench.links([name])
    assert [search.role for search in found] == roles_of(name)
    for one in found:
        line = bench.Line(one)
        line.hear(data, 64)
        assert line.busy == bool(line.address) or line.engine.receiver.broken
        assert bench.turn(one, data) > 0 and bench.worst(one, 0)[0] > 0
