"""Frames separated by a delimiter, which two frames may share; SLIP, COBS and PPP compared with other programs."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link.link_world import comparable, compiled, cut_at, feed, receiver_of
from shipped import file_of

from framekit.definition.times import NEVER
from framekit.link.events import CharacterFault, LineFault

CONTROLS = ", ".join(f"{byte:02X}" for byte in range(0x20))
PPP = """protocol: ppp
about: PPP in HDLC-like framing (RFC 1662), all control characters escaped
receiver: {delimiter: 7E, gap: 50 ms}
frames:
  frame:
    body:
      - {const: 7E}
      - wrap: {escape: 7D, xor: 20, bytes: [7D, 7E, CONTROLS]}
        of:
          - {const: FF 03}
          - {field: protocol, type: u16}
          - {data: data, size: rest}
          - {check: crc16-ibm-sdlc, order: little}
      - {const: 7E}
""".replace("CONTROLS", CONTROLS)
SLIP = file_of("slip.yaml").read_text(encoding="utf-8")
COBS = file_of("cobs.yaml").read_text(encoding="utf-8")


def ppp(protocol: int, data: str) -> bytes:
    made: bytes = compiled(PPP)[1].encode("frame", {"protocol": protocol, "data": bytes.fromhex(data)})
    return made


@pytest.mark.parametrize(
    "data, wire",
    [
        # Zephyr, tests/subsys/modem/modem_ppp: a configure request of LCP
        ("01 01 00 04", "7E FF 7D 23 C0 21 7D 21 7D 21 7D 20 7D 24 D1 B5 7E"),
        # Zephyr, tests/net/ppp/driver: the same with options, as pppd sends it
        (
            "01 01 00 14 02 06 00 00 00 00 05 06 5D 58 CF 41 07 02 08 02",
            "7E FF 7D 23 C0 21 7D 21 7D 21 7D 20 7D 34 7D 22 7D 26 7D 20 7D 20 7D 20 7D 20 7D 25 7D 26 5D 58 CF 41 "
            "7D 27 7D 22 7D 28 7D 22 C4 C9 7E",
        ),
    ],
)
def test_ppp_frames_of_other_programs(data: str, wire: str) -> None:
    assert ppp(0xC021, data) == bytes.fromhex(wire)
    assert compiled(PPP)[1].decode("frame", bytes.fromhex(wire)) == {"protocol": 0xC021, "data": bytes.fromhex(data)}


def test_escapes_of_rfc_1662() -> None:
    """RFC 1662, section 4.2: the wire form of 7E, 7D and 03."""
    wire = ppp(0xC021, "7E 7D 03")
    assert wire[6:-1].startswith(bytes.fromhex("7D 5E 7D 5D 7D 23"))


def test_a_check_code_in_a_wrap_is_stuffed_too() -> None:
    """Each escaped byte occurs in the check codes of some of the 4096 frames."""
    codec, seen = compiled(PPP)[1], set()
    for number in range(4096):
        data = number.to_bytes(2, "big")
        wire = codec.encode("frame", {"protocol": 0xC021, "data": data})
        plain = bytearray()
        inside = iter(wire[1:-1])
        for byte in inside:
            plain.append(next(inside) ^ 0x20 if byte == 0x7D else byte)
        seen |= set(plain[-2:])
        assert 0x7E not in wire[1:-1] and plain[:-2] == b"\xff\x03\xc0\x21" + data
        assert codec.decode("frame", wire)["data"] == data
    assert {0x7D, 0x7E, 0x11} <= seen


FRAMES_OF = {
    "ppp": (PPP, "frame", [ppp(0x21, text) for text in ("01", "7E", "7D 7E 00", "42 43 44 45 46")]),
    "slip": (
        SLIP,
        "packet",
        [compiled(SLIP)[1].encode("packet", {"packet": content}) for content in (b"a", b"\xc0", b"\xdb" * 9)],
    ),
}


def others(found: list[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    return [event for event in found if event[0] != "frame"]


@pytest.mark.parametrize("name", FRAMES_OF)
@pytest.mark.parametrize("between", [-1, 0, 1, 5])
def test_a_delimiter_ends_a_frame_and_begins_the_next(name: str, between: int) -> None:
    """Delimiters may be shared, double, or repeated as fill: between frames, before the first, after the last."""
    text, frame, sent = FRAMES_OF[name]
    flag = sent[0][:1]
    stream = flag * max(between, 0) + sent[0]
    for one in sent[1:]:
        stream += one[1:] if between < 0 else flag * between + one
    stream += flag * max(between, 0)
    whole = feed(receiver_of(text), [stream], (frame,))
    assert [event[2] for event in whole] == sent and not others(whole)
    assert all(stream[offset : offset + len(raw)] == raw for _, _, raw, offset, _ in whole)
    assert feed(receiver_of(text), [stream[at : at + 1] for at in range(len(stream))], (frame,)) == whole
    choose = random.Random(between)
    for _ in range(20):
        places = sorted(choose.randrange(len(stream)) for _ in range(8))
        assert feed(receiver_of(text), cut_at(stream, places), (frame,)) == whole
    receiver = receiver_of(text)
    receiver.append(stream, 0)
    assert [comparable(event) for event in receiver.arrivals((frame,))] == whole
    assert not receiver.has_unread and receiver.is_empty and not receiver.waiting and receiver.deadline == NEVER


@pytest.mark.parametrize("name", FRAMES_OF)
@pytest.mark.parametrize("resync", ["next_start", "after_frame", "after_quiet"])
def test_what_is_damaged_costs_nothing_else(name: str, resync: str) -> None:
    """A bad frame ends at its delimiter, and the next frame begins there."""
    text, frame, sent = FRAMES_OF[name]
    text = text.replace("delimiter:", f"resync: {resync}\n  delimiter:") if name == "slip" else text
    text = (
        text.replace("\n  resync: after_frame\n", "\n")
        if name == "slip"
        else text.replace("gap:", f"resync: {resync}, gap:")
    )
    broken = sent[0][:-2] + (b"\xdb\x00" if name == "slip" else b"\x00\x00") + sent[0][-1:]
    stream = b"xy" + sent[1] + broken[1:] + sent[2][1:]
    whole = feed(receiver_of(text), [stream], (frame,))
    good = [sent[1]] if resync == "after_quiet" else [sent[1], sent[2]]
    assert [event[2] for event in whole if event[0] == "frame"] == good
    assert [event[3] for event in whole if event[0] == "bad"] == [broken]
    assert whole[0] == ("noise", b"xy", 0, False)
    assert feed(receiver_of(text), [stream[at : at + 1] for at in range(len(stream))], (frame,)) == whole


def test_a_pause_between_frames_is_none_in_a_frame() -> None:
    """The delimiter that ended the last frame gets the time of the bytes that follow it, however late they arrive."""
    frame, receiver = ppp(0x21, "01"), receiver_of(PPP)
    receiver.append(frame, 0)
    assert [comparable(event)[2] for event in receiver.arrivals(("frame",))] == [frame]
    receiver.tick(10**12)
    assert receiver.arrivals(("frame",)) == []
    receiver.cut()
    receiver.append(frame[1:], 2 * 10**12)
    (arrived,) = receiver.arrivals(("frame",))
    assert comparable(arrived) == ("frame", "frame", frame, len(frame) - 1, None)
    assert arrived.times == (2 * 10**12, 2 * 10**12)  # type: ignore[union-attr]
    receiver.append(frame[1:], 3 * 10**12, [CharacterFault(1, LineFault.PARITY)])
    assert [comparable(event)[:3] for event in receiver.arrivals(("frame",))][:1] == [("bad", "frame", "parity")]
    receiver.flush()
    assert receiver.is_empty and not receiver.flush()


@given(data=st.lists(st.sampled_from(b"\x00\x01\x7d\x7e\xc0\xdb\xdc\xdd\xff"), max_size=400).map(bytes))
def test_the_same_as_sliplib(data: bytes) -> None:
    sliplib = pytest.importorskip("sliplib", reason="sliplib is not installed")
    codec = compiled(SLIP)[1]
    packet = data + b"\x42"
    wire = b"\xc0" + sliplib.encode(packet) + b"\xc0"
    assert codec.encode("packet", {"packet": packet}) == wire
    assert codec.decode("packet", wire)["packet"] == sliplib.decode(wire[1:-1]) == packet


def test_packets_of_sliplib_in_a_stream() -> None:
    """sliplib writes one END between two packets; its driver reads our packets."""
    sliplib = pytest.importorskip("sliplib", reason="sliplib is not installed")
    packets = [b"\xc0", b"\xdb\xdc", b"plain", bytes(range(256))]
    stream = b"\xc0" + b"\xc0".join(sliplib.encode(packet) for packet in packets) + b"\xc0"
    found = feed(receiver_of(SLIP), [stream], ("packet",))
    codec = compiled(SLIP)[1]
    assert [codec.decode("packet", event[2])["packet"] for event in found] == packets
    reader = sliplib.Driver()
    reader.receive(b"".join(codec.encode("packet", {"packet": packet}) for packet in packets))
    assert [reader.get(block=False) for _ in packets] == packets


@given(st.lists(st.integers(0, 255), max_size=20).map(bytes), st.integers(0, 600))
def test_the_same_as_cobs(start: bytes, more: int) -> None:
    cobs: Any = pytest.importorskip("cobs.cobs", reason="cobs is not installed")
    codec, packet = compiled(COBS)[1], start + bytes(1 + number % 255 for number in range(more)) + b"\0"
    wire: Callable[[bytes], bytes] = lambda one: cobs.encode(one) + b"\0"  # noqa: E731
    assert codec.encode("packet", {"packet": packet}) == wire(packet)
    assert codec.decode("packet", wire(packet))["packet"] == packet
    found = feed(receiver_of(COBS), [wire(packet) + wire(start + b"\1")], ("packet",))
    assert [codec.decode("packet", event[2])["packet"] for event in found] == [packet, start + b"\1"]
