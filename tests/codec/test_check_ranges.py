"""Ranges and effects of check codes: bytes not transmitted, encoded wraps, other codes, headers that end a frame."""

from __future__ import annotations

import cProfile
import pstats
import random
import re
from pathlib import Path

import pytest
from construct_oracle import compile_construct
from link.link_world import cut_at, feed, receiver_of
from small_protocol import small_protocol

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.problems import DefinitionError

HEADED = (
    "{const: 05 64}, {length: n, type: u16, of: [d]}, {check: crc16-dnp, order: little, ends: yes}, "
    "{data: d, size: n}, {check: crc16-dnp, over: [d], order: little}"
)


MANUAL = Path(__file__).parents[2] / "docs" / "language" / "checks.md"


def codec_of(body: str, more: str = "") -> Codec:
    return compile_protocol(small_protocol(f"[{body}]", more))


def found_in(body: str, parts: list[bytes]) -> list[tuple[object, ...]]:
    text = f"protocol: headed\nframes:\n  f: {{body: [{body}]}}\nreceiver: {{gap: 50 ms}}\n"
    return feed(receiver_of(text), parts, ("f",))


# ---- a header check that ends the frame ---------------------------------------------------------------------------


def test_a_wrong_header_check_ends_a_frame_before_the_rest_has_come() -> None:
    """The damaged length announces 65,000 bytes; the next frame is found without them, whole or byte by byte."""
    good = codec_of(HEADED).encode("f", {"d": b"hello"})
    damaged = good[:2] + b"\xff\x00" + good[4:6]
    both = damaged + good
    wanted = [("bad", "f", "check", damaged, 0), ("noise", damaged, 0, True), ("frame", "f", good, 6, None)]
    assert found_in(HEADED, [both]) == wanted
    assert found_in(HEADED, [both[at : at + 1] for at in range(len(both))]) == wanted
    assert found_in(HEADED, [damaged]) == wanted[:2]
    assert found_in(HEADED.replace(", ends: yes", ""), [both])[0][:3] == ("bad", "f", "cut")


def test_streams_with_damaged_headers_give_the_same_however_they_are_cut() -> None:
    choose = random.Random(7)
    codec = codec_of(HEADED)
    stream, sent = b"", []
    for _ in range(60):
        data = bytes(choose.choices(b"\x05\x64\x00\x41", k=choose.randrange(40)))
        frame = bytearray(codec.encode("f", {"d": data}))
        if choose.random() < 0.4:
            frame[choose.randrange(2, 6)] ^= 1 << choose.randrange(8)
        else:
            sent.append(bytes(frame))
        stream += frame
    whole = found_in(HEADED, [stream])
    assert [event[2] for event in whole if event[0] == "frame"] == sent
    assert found_in(HEADED, [stream[at : at + 1] for at in range(len(stream))]) == whole
    for _ in range(5):
        assert found_in(HEADED, cut_at(stream, sorted(choose.choices(range(len(stream)), k=40)))) == whole


def test_noise_like_headers_costs_no_more_than_other_noise() -> None:
    """Each offset is examined only a few times, for any lengths in the noise."""
    noise = b"\x05\x64\x7f\xff" * 5000
    profile = cProfile.Profile()
    with profile:
        found_in(HEADED, cut_at(noise, range(0, len(noise), 100)))
    calls = {name: called[1] for (_, _, name), called in pstats.Stats(profile).stats.items()}
    assert calls["measure_f"] < len(noise) / 2


@pytest.mark.parametrize(
    "body, wrong",
    [
        ("{field: a, type: u8}, {check: sum8, ends: yes}", "nothing stands behind this check code"),
        ("{data: d, size: rest}, {check: sum8, ends: yes}, {const: 0D}", "only what follows shows where 'd' ends"),
        ("{field: a, type: u8}, {check: sum8, ends: yes, when: a}, {const: 0D}", "only if it always stands in it"),
        ("{wrap: hex, of: [{field: a, type: u8}, {check: sum8, ends: yes, over: [a]}]}, {const: 0D}", "and in no wrap"),
        (
            "{wrap: hex, of: [{field: a, type: u8}]}, {check: sum8, ends: yes, over: [a]}, {const: 0D}",
            "nothing in wraps",
        ),
        ("{check: sum8, ends: yes, over: [a]}, {field: a, type: u8}", "covers what stands before it"),
        ("{field: a, type: u8}, {check: sum8, ends: yes, verify: warn}, {const: 0D}", "a wrong code is no fault here"),
        ("{field: a, type: u8}, {check: sum8, wire: yes}", "counts what stands on the wire already"),
        ("{wrap: hex, of: [{field: a, type: u8}]}, {check: sum8, over: a..here, wire: yes}", "'a' stands in a wrap"),
        ("{wrap: hex, of: [{field: a, type: u8}, {check: sum8, over: [a], wire: yes}]}", "so wire has no effect"),
        (
            "{field: a, type: u8}, {check: sum8, over: [a, {bytes: b, type: u8}]}, {field: b, type: u8}",
            "read only later",
        ),
        ("{field: a, type: u8}, {check: sum8, over: [a, {bytes: a}]}", "bytes"),
        ("{field: a, type: u8}, {check: sum8, over: [a, {bytes: \"h'00'\", type: u8}]}", "number"),
        ("{field: a, type: u8}, {check: sum8, over: [a, {bytes: a, type: f32}]}", "no type of whole numbers"),
        ("{field: a, type: u8}, {check: sum8, over: [a, {bytes: a, type: uint, size: a}]}", "of fixed size"),
        ("{field: a, type: u8}, {check: sum8, over: [a, {bytes: \"h'00'\", order: little}]}", "these are bytes"),
        ("{field: a, type: u8}, {check: sum8, over: [a, {byte: a}]}", "bytes"),
        ("{field: a, type: u8}, {check: sum8, over: [a, b..here]}", "'b'"),
        ("{field: a, type: u8}, {field: b, type: u8}, {check: sum8, over: [b..a]}", "stands behind"),
    ],
)
def test_what_has_no_sense_is_refused(body: str, wrong: str) -> None:
    with pytest.raises(DefinitionError) as error:
        codec_of(body)
    assert wrong in str(error.value), str(error.value)


# ---- what is covered ----------------------------------------------------------------------------------------------


def test_bytes_that_are_not_on_the_wire_may_come_from_tables_and_parameters() -> None:
    """An unknown kind has no such byte in the table: encoding is refused, and decoding finds a bad frame."""
    more = "tables: {extra: {1: 0x32, 2: 0x7C}}\nparams: {net: {type: bytes, size: 2, default: 0A 0B}}\n"
    body = "{field: kind, type: u8}, {check: sum8, over: [{bytes: net}, kind, {bytes: 'extra[kind]', type: u8}]}"
    codec = codec_of(body, more)
    assert codec.encode("f", {"kind": 1}) == bytes((1, 0x0A + 0x0B + 1 + 0x32))
    assert codec.encode("f", {"kind": 2}, {"net": b"\0\1"}) == bytes((2, 1 + 2 + 0x7C))
    assert codec.decode("f", bytes((2, 1 + 2 + 0x7C)), {"net": b"\0\1"}) == {"kind": 2}
    with pytest.raises(FrameError) as error:
        codec.decode("f", bytes((2, 1 + 2 + 0x7C)))
    assert error.value.cause == "check"
    with pytest.raises(EncodeError):
        codec.encode("f", {"kind": 3})
    with pytest.raises(FrameError):
        codec.decode("f", b"\x03\x03")


WRAPPED = "{name: w, wrap: {escape: DLE}, of: [{data: d, size: 2}, {check: sum8, INSIDE}]}, {check: sum8, BEHIND}"
IN_IT = {"d": b"\x10\x01"}


@pytest.mark.parametrize(
    "inside, behind, wire",
    [
        ("over: [d]", "over: [d]", "10 10 01 11 11"),
        ("over: [d]", "over: [w], wire: yes", "10 10 01 11 32"),
        ("name: c", "over: [w]", "10 10 01 11 22"),
        ("name: c", "name: e", "10 10 01 11 32"),
    ],
)
def test_a_check_without_over_counts_what_stands_before_it_in_its_region(inside: str, behind: str, wire: str) -> None:
    """In a wrap, the check covers the plain content before it, but no byte before the wrap.

    After a wrap, it covers the wrapped bytes as they are on the wire.
    """
    body = "{const: 7F}, " + WRAPPED.replace("INSIDE", inside).replace("BEHIND", behind)
    if behind == "name: e":
        wire = wire[:-2] + "B1"
    protocol = small_protocol(f"[{body}]")
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        assert codec.encode("f", IN_IT).hex(" ").upper() == f"7F {wire}"
        assert codec.decode("f", bytes.fromhex(f"7F {wire}")) == IN_IT


@pytest.mark.parametrize(
    "header, behind, wire",
    [
        ("{field: h, type: u8}, {check: xor8, name: c}", "{check: sum8, over: h..here}", "05 05 01 02 0D"),
        (
            "{check: sum8, over: [h, c, d]}, {field: h, type: u8}, {check: xor8, name: c, over: [h]}",
            "",
            "0D 05 05 01 02",
        ),
        ("{field: h, type: u8}, {check: xor8, over: [d, e]}", "{check: sum8, name: e, over: [h, d]}", "05 0B 01 02 08"),
        ("{field: h, type: u8}, {check: xor8, over: [h, d]}", "{check: sum8, over: h..here}", "05 06 01 02 0E"),
    ],
)
def test_two_checks_of_which_one_covers_the_other(header: str, behind: str, wire: str) -> None:
    """The frame's code covers the header's or vice versa, in any order on the wire."""
    protocol = small_protocol(f"[{header}, {{data: d, size: 2}}, {behind}]".replace(", ]", "]"))
    values = {"h": 5, "d": b"\x01\x02"}
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        assert codec.encode("f", values).hex(" ").upper() == wire
        assert codec.decode("f", bytes.fromhex(wire)) == values
        for place in range(5):
            damaged = bytearray.fromhex(wire)
            damaged[place] ^= 0x20
            with pytest.raises(FrameError, match="check"):
                codec.decode("f", bytes(damaged))


def test_two_checks_that_cover_each_other_are_refused() -> None:
    with pytest.raises(DefinitionError, match="covers what comes later, and is covered itself"):
        codec_of("{check: sum8, name: a, over: [b]}, {field: x, type: u8}, {check: xor8, name: b, over: [a, x]}")


def test_the_table_of_the_manual() -> None:
    """The table of docs/language/checks.md: check codes with their frames and bytes."""
    rows = re.findall(r"^\| `(\[\{.*check.*\])` \| `([0-9A-F ]+)` \|", MANUAL.read_text(encoding="utf-8"), re.MULTILINE)
    rows = [row for row in rows if "key:" not in row[0]]  # codes made with a key are tried in test_ciphers.py
    assert len(rows) == 10
    for body, wire in rows:
        protocol = small_protocol(body)
        values = {"a": 1, "d": b"\x10\x02"}
        for codec in (compile_protocol(protocol), compile_construct(protocol)):
            assert codec.encode("f", values).hex(" ").upper() == wire, body
            assert codec.decode("f", bytes.fromhex(wire)) == values, body
