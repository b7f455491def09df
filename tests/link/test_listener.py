"""A passive listener: both sides on the same wires, in any pieces, with noise, damage and pauses."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.api.monitor import FrameLog
from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.definition.times import NEVER, parse_format
from framekit.link.events import CharacterFault, LineFault, Seen
from framekit.link.listener import LONGEST_PAUSE, Listener

MS = 1_000_000
CHARACTER = 1_145_833  # 9600 8E1
ASK = bytes.fromhex("11 03 00 6B 00 03 76 87")
ANSWER = bytes.fromhex("11 03 06 AE 41 56 52 43 40 49 AD")
SET = bytes.fromhex("11 06 00 01 00 03 9A 9B")


class Bench:
    """A listener with the frames it has seen; its calls advance the time."""

    def __init__(self, name: str, **options: object) -> None:
        protocol = load_protocol(name, Path.cwd())
        self.seen: list[Seen] = []
        line = parse_format("8E1", 9600)
        self.listener = Listener(protocol, compile_protocol(protocol), self.seen.append, line=line, **options)  # type: ignore[arg-type]
        self.now = 0

    def hear(self, data: bytes, pause: int = 50 * MS, direction: str = "in", piece: int = 0) -> None:
        """Receive bytes after a pause, character by character, in pieces."""
        self.now += pause
        size = piece or len(data)
        for start in range(0, len(data), size):
            part = data[start : start + size]
            self.now += len(part) * CHARACTER
            self.listener.receive(part, self.now, (), direction)  # type: ignore[arg-type]

    def rest(self, time: int) -> None:
        self.now += time
        self.listener.tick(self.now)

    @property
    def told(self) -> list[tuple[str, str]]:
        return [(seen.kind, seen.frame) for seen in self.seen]


@pytest.mark.parametrize("piece", [0, 1, 3])
def test_requests_and_replies_on_the_same_wires(piece: int) -> None:
    """The reply to a write equals its request; the previous frame decides which it is."""
    bench = Bench("modbus-rtu")
    for data in (ASK, ANSWER, SET, SET, ASK, ANSWER):
        bench.hear(data, piece=piece)
    bench.rest(50 * MS)
    sides = ["request_adu", "reply_adu"] * 3
    assert bench.told == [("frame", name) for name in sides]
    assert bench.seen[0].fields["pdu"] == {"read_holding": {"function": 3, "address": 107, "count": 3}}
    assert bench.seen[1].raw == ANSWER
    assert bench.seen[1].at == bench.seen[1].started_at + (
        0 if not piece else bench.seen[1].at - bench.seen[1].started_at
    )


def test_a_request_without_a_reply_is_followed_by_another_request() -> None:
    """`11 03 10 …` begins like a reply of 16 bytes; the pause after it shows that it is a request."""
    other = bytes.fromhex("11 03 10 00 00 01")
    crc = 0xFFFF
    for byte in other:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 * (crc & 1)
    other += crc.to_bytes(2, "little")
    bench = Bench("modbus-rtu")
    for data in (ASK, other, ASK, ANSWER):
        bench.hear(data)
    bench.rest(50 * MS)
    assert bench.told == [("frame", "request_adu")] * 3 + [("frame", "reply_adu")]


def test_noise_damage_and_an_unfinished_frame_are_shown() -> None:
    bench = Bench("mldp")
    ask = bytes.fromhex("05 30 31 72 53 53 30 31 30 36 25 4D 57 31 30 30 04")
    ask += b"%02X" % (sum(ask) & 0xFF)
    bench.hear(b"\x00\xff\x01")
    bench.hear(ask[:-2] + b"00")
    bench.hear(ask)
    bench.hear(ask[:9])
    bench.rest(10_000 * MS)
    kinds = [seen.kind for seen in bench.seen]
    assert kinds[0] == "noise"
    assert bench.seen[0].raw == b"\x00\xff\x01"
    bad = [seen for seen in bench.seen if seen.kind == "bad"]
    assert [seen.reason for seen in bad] == ["check", "cut"]
    assert bad[0].place == 17 or bad[0].segment
    assert ("frame", "read_individual") in bench.told
    assert bench.listener.counters.received == 1
    assert bench.listener.counters.bad == 2


def test_a_damaged_character_makes_a_bad_frame() -> None:
    bench = Bench("modbus-rtu")
    bench.listener.receive(ASK, 20 * MS, (CharacterFault(2, LineFault.PARITY),))
    bench.listener.ended(100 * MS)
    assert (bench.seen[0].kind, bench.seen[0].reason) == ("bad", "parity")


def test_two_directions_are_two_streams() -> None:
    """Pieces of a reply and of a simultaneous request are not mixed."""
    bench = Bench("modbus-rtu", client="out")
    bench.hear(ASK, direction="out")
    bench.hear(ANSWER[:5], direction="in")
    bench.hear(SET, direction="out", pause=0)
    bench.listener.receive(ANSWER[5:], bench.now + 1, (), "in")
    bench.listener.ended(bench.now + 100 * MS)
    frames = [(seen.direction, seen.frame) for seen in bench.seen if seen.kind == "frame"]
    assert ("out", "request_adu") in frames
    assert frames.count(("out", "request_adu")) == 2


def test_without_a_gap_a_long_silence_ends_what_is_unfinished() -> None:
    bench = Bench("ccm")
    assert bench.listener.deadline == NEVER
    bench.hear(bytes.fromhex("01 30 31"))
    assert bench.listener.deadline == bench.now + LONGEST_PAUSE
    bench.rest(LONGEST_PAUSE)
    assert bench.seen[0].kind == "bad"
    assert bench.listener.deadline == NEVER


@pytest.mark.parametrize(("size", "kind"), [(4, "bad"), (len(ASK), "frame")])
def test_a_frame_that_a_break_ends_is_good_and_one_that_it_breaks_off_is_bad(size: int, kind: str) -> None:
    bench = Bench("modbus-rtu")
    bench.hear(ASK[:size])
    bench.listener.line_break(bench.now + MS)
    assert [(seen.kind, seen.raw) for seen in bench.seen] == [(kind, ASK[:size]), ("break", b"")]


def test_another_sender_drops_what_is_unfinished() -> None:
    bench = Bench("modbus-rtu")
    bench.hear(ASK[:4])
    bench.listener.other_sender(bench.now + MS)
    assert [(seen.kind, seen.raw) for seen in bench.seen] == [("noise", ASK[:4])]


@pytest.mark.parametrize("name", ["modbus-rtu", "ccm"])
def test_a_bad_frame_is_one_thing_in_every_view(name: str) -> None:
    """A frame with a wrong check code counts as a bad frame; its bytes do not also count as noise."""
    bench = Bench(name)
    data = ASK[:-1] + b"\x00" if name == "modbus-rtu" else bytes.fromhex("01 30 31 30 31 30 31 30 31 30 31 30 31 17 77")
    bench.hear(data)
    bench.rest(2_000 * MS)
    bench.hear(data)
    bench.rest(2_000 * MS)
    log = FrameLog({1: bench.listener.protocol})
    for seen in bench.seen:
        log.add(1, seen)
    assert log.counts == {"bad": 2}
    assert [seen.kind for seen in bench.seen] == ["bad", "bad"]
    assert (bench.listener.counters.bad, bench.listener.counters.noise_bytes) == (2, 0)


@pytest.mark.parametrize("name", ["modbus-rtu", "mldp"])
def test_a_pause_that_no_tick_has_noted_ends_no_frame_where_times_are_those_of_reading(name: str) -> None:
    """The process was stalled between two reads; the rest of the frame waited in the port."""
    frame = ANSWER if name == "modbus-rtu" else bytes.fromhex("05 30 31 72 53 53 30 31 30 36 25 4D 57 31 30 30 04")
    frame += b"" if name == "modbus-rtu" else b"%02X" % (sum(frame) & 0xFF)
    for size in range(1, len(frame)):
        bench = Bench(name)
        bench.listener.hear_late()
        bench.hear(frame[:size])
        bench.hear(frame[size:], pause=5000 * MS)
        bench.rest(10_000 * MS)
        assert [(seen.kind, seen.raw) for seen in bench.seen] == [("frame", frame)]


def test_a_pause_that_a_tick_has_noted_ends_a_frame_where_times_are_those_of_reading() -> None:
    bench = Bench("modbus-rtu")
    bench.listener.hear_late()
    bench.hear(ANSWER[:6])
    bench.rest(1000 * MS)
    bench.hear(ANSWER)
    bench.rest(1000 * MS)
    assert [seen.kind for seen in bench.seen] == ["bad", "frame"] and bench.seen[1].raw == ANSWER


def test_a_silence_that_no_tick_has_noted_is_a_place_to_begin_again() -> None:
    """A broken frame and the next frame were read in succession, too fast for a tick between them."""
    bench = Bench("modbus-rtu")
    bench.listener.hear_late()
    bench.hear(ANSWER[:6])
    bench.hear(ASK, pause=20 * MS)
    bench.rest(1000 * MS)
    assert bench.seen[-1].kind == "frame" and bench.seen[-1].raw == ASK
