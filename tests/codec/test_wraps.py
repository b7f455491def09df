"""Wraps: published vectors, round trips of any content, and wrapped frames found in streams with any cuts."""

from __future__ import annotations

import cProfile
import pstats
import random
import re
from pathlib import Path

import pytest
from construct_oracle.regions import coded, uncoded
from hypothesis import given
from hypothesis import strategies as st
from link.link_world import cut_at, feed, receiver_of
from small_protocol import small_protocol
from spread import spread

from framekit.codec import stuffing
from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.python.codings import wire_coding
from framekit.codec.python.module import Module
from framekit.definition.codings import Cobs, Coding, Escaped, Inserted
from framekit.definition.model.segments import Wrap
from framekit.definition.problems import DefinitionError, Position
from framekit.definition.times import LineFormat
from framekit.definition.wire_types import exactly
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope

MANUAL = Path(__file__).parents[2] / "docs" / "language" / "wraps.md"
AT = Position("test", 1, 1)
HDLC = Escaped(AT, 0x7D, tuple((byte, byte ^ 0x20) for byte in (0x7E, 0x7D, 0x11, 0x13)), 0x20)
SLIP = Escaped(AT, 0xDB, ((0xC0, 0xDC), (0xDB, 0xDD)))
DYNAMIXEL = Inserted(AT, b"\xff\xff\xfd", b"\xfd")
ALIKE = Inserted(AT, b"\x07\x07", b"\x07")
SIZE = 600
"""Size of the content that always has the same size."""
CODINGS = [HDLC, SLIP, Cobs(AT), DYNAMIXEL, ALIKE]
BYTES = bytes(range(1, 256))
PROTOCOLS = {
    "hdlc": "{const: 7E}, {wrap: {escape: 7D, xor: 20, bytes: [7E, 7D, 11, 13]}, min: 3, "
    "of: [{data: d, size: rest}, {check: crc16-ibm-sdlc, order: little, over: d..here}]}, {const: 7E}",
    "slip": "{const: C0}, {wrap: {escape: DB, codes: {C0: DC, DB: DD}}, min: 2, of: [{data: d, size: rest}, {check: xor8, over: d..here}]}, {const: C0}",  # noqa: E501
    "cobs": "{wrap: cobs, min: 2, of: [{data: d, size: rest}, {check: crc8, over: d..here}]}, {const: 00}",
    "dynamixel": "{const: FF FF FD 00}, {length: n, type: u16, order: little, of: [w], plus: 2}, "
    "{name: w, wrap: {after: FF FF FD, insert: FD}, size: n - 2, of: [{data: d, size: rest}]}, "
    "{check: crc16-umts, order: little}",
}


def functions(coding: Coding) -> tuple[str, str, str, str, str]:
    row = wire_coding(coding)
    module = Module(small_protocol("[{const: 00}]"))
    arguments = row.build_arguments(module, coding, None), row.read_arguments(module, coding, SIZE)
    return row.build, arguments[0], row.read, row.careful, arguments[1]


def stuffed(coding: Coding, plain: bytes) -> bytes:
    build, arguments, *_ = functions(coding)
    made: bytes = eval(f"{build}(plain{arguments})", {**vars(stuffing), "plain": plain})
    return made


def unstuffed(coding: Coding, wire: bytes) -> bytes:
    _, _, read, _, arguments = functions(coding)
    made: bytes = eval(f"{read}(wire{arguments})", {**vars(stuffing), "wire": wire})
    return made


@pytest.mark.parametrize(
    "coding, plain, wire",
    [
        (SLIP, b"\x01\xc0\xdb\x02", "01 DB DC DB DD 02"),  # RFC 1055
        (HDLC, b"\x7e\x7d\x11\x41", "7D 5E 7D 5D 7D 31 41"),  # RFC 1662, 4.2
        (DYNAMIXEL, b"\xff\xff\xfd\x00", "FF FF FD FD 00"),
        # Cheshire and Baker, Consistent Overhead Byte Stuffing; without the final 00
        (Cobs(AT), b"", "01"),
        (Cobs(AT), b"\0", "01 01"),
        (Cobs(AT), b"\0\0", "01 01 01"),
        (Cobs(AT), b"\0\x11\0", "01 02 11 01"),
        (Cobs(AT), b"\x11\x22\0\x33", "03 11 22 02 33"),
        (Cobs(AT), b"\x11\x22\x33\x44", "05 11 22 33 44"),
        (Cobs(AT), b"\x11\0\0\0", "02 11 01 01 01"),
        (Cobs(AT), BYTES[:254], "FF" + BYTES[:254].hex()),
        (Cobs(AT), b"\0" + BYTES[:254], "01FF" + BYTES[:254].hex()),
        (Cobs(AT), BYTES, "FF" + BYTES[:254].hex() + "02FF"),
        (Cobs(AT), BYTES[1:] + b"\0", "FF" + BYTES[1:].hex() + "0101"),
        (Cobs(AT), BYTES[2:] + b"\0\x01", "FE" + BYTES[2:].hex() + "0201"),
    ],
)
def test_published_vectors(coding: Coding, plain: bytes, wire: str) -> None:
    assert stuffed(coding, plain) == bytes.fromhex(wire)
    assert unstuffed(coding, bytes.fromhex(wire)) == plain


@pytest.mark.parametrize("coding", spread(CODINGS, 2), ids=lambda coding: coding.shown)
@given(data=st.data())
def test_any_content_there_and_back(coding: Coding, data: st.DataObject) -> None:
    """The wire form equals the byte-by-byte form of the coding's definition; its size is within the declared limits."""
    some = st.sampled_from(b"\x00\x07\x11\x7d\x7e\xc0\xdb\xdc\xfd\xff\x41")
    plain = bytes(data.draw(st.lists(some, max_size=600) | st.lists(st.integers(1, 255), min_size=250, max_size=260)))
    wire = stuffed(coding, plain)
    assert wire == coded(coding, plain) and unstuffed(coding, wire) == plain
    assert not coding.never & set(wire)
    sizes = coding.sizes(exactly(len(plain)))
    assert sizes.most is not None and sizes.least <= len(wire) <= sizes.most


@pytest.mark.parametrize("coding", spread(CODINGS, 2), ids=lambda coding: coding.shown)
@given(wire=st.lists(st.sampled_from(b"\x00\x01\x02\x03\x07\x31\x5e\x7d\x7e\xdb\xdc\xfd\xff"), max_size=12).map(bytes))
def test_what_is_no_content_is_told_with_its_place(coding: Coding, wire: bytes) -> None:
    *_, careful, arguments = functions(coding)
    found = eval(f"{careful}(wire{arguments})", {**vars(stuffing), "wire": wire})
    expected, places = uncoded(coding, wire)
    if expected is None:
        assert found[2] == "constant" and found[1][-1] == places[-1]
        with pytest.raises(ValueError):
            unstuffed(coding, wire)
    else:
        assert found[0] == expected == unstuffed(coding, wire)
        assert [*found[1]] == [*places, len(wire)]


TABLE = re.compile(r"^\| `(hex|cobs|\{.*?\})` \| `([0-9A-F ]+)`.*\|(.*)\|$", re.MULTILINE)


def test_the_table_of_the_manual() -> None:
    """The table of docs/language/wraps.md: the same content in each coding, and the bytes that never occur in it."""
    rows = TABLE.findall(MANUAL.read_text(encoding="utf-8"))
    assert len(rows) == 8
    for wrap, wire, never in rows:
        protocol = small_protocol(f"[{{wrap: {wrap}, of: [{{data: d, size: 3}}]}}]")
        (segment,) = protocol.frames["f"].segments
        assert isinstance(segment, Wrap)
        made = compile_protocol(protocol).encode("f", {"d": bytes.fromhex("7E 7D 01")})
        assert made == bytes.fromhex(wire), wrap
        absent_bytes = {int(digits, 16) for digits in re.findall("`(..)`", never)}
        assert absent_bytes == segment.coding.never or wrap == "hex"


def test_content_takes_nothing_but_bytes() -> None:
    """A number is not content: bytes(2**40) would allocate all memory."""
    for body in PROTOCOLS.values():
        codec = codec_of(body)
        for wrong in (2**40, "text", None, [1]):
            with pytest.raises(EncodeError):
                codec.encode("f", {"d": wrong})


def test_a_record_in_a_wrap_that_is_not_there_has_no_fields() -> None:
    """Expressions that read the fields get an absent value; the frame is good or bad, and no other error is raised."""
    wrap = "{when: k == 1, wrap: hex, of: [{include: part, as: r}]}"
    layouts = "layouts: {part: [{field: f, type: u8}]}"
    codec = compile_protocol(small_protocol(f"[{{field: k, type: u8}}, {wrap}, {{require: r.f != 77}}]", layouts))
    assert codec.decode("f", b"\x02") == {"k": 2}
    assert codec.decode("f", b"\x0105") == {"k": 1, "r": {"f": 5}}
    with pytest.raises(FrameError, match="require"):
        codec.decode("f", b"\x014D")


def test_a_wrap_takes_as_many_bytes_as_its_size_says() -> None:
    """Also under a condition, where a length field gives the size."""
    body = "[{field: n, type: u8}, {wrap: cobs, size: n, of: [{data: d, size: rest}]}]"
    codec = compile_protocol(small_protocol(body))
    assert codec.encode("f", {"n": 3, "d": b"ab"}) == b"\x03\x03ab"
    with pytest.raises(EncodeError, match="has a length of 3, it must be 4"):
        codec.encode("f", {"n": 4, "d": b"ab"})
    wrap = "{name: w, when: k > 1, wrap: cobs, size: n, of: [{data: d, size: rest}]}"
    codec = codec_of(f"{{field: k, type: u8}}, {{length: n, type: u8, of: [w]}}, {wrap}")
    assert codec.encode("f", {"k": 2, "d": b"ab"}) == b"\x02\x03\x03ab"
    assert codec.encode("f", {"k": 1}) == b"\x01\x00"


@pytest.mark.parametrize(
    "body",
    [
        "{check: xor8, over: [d]}, {data: d, size: 1}, {choose: len(d), cases: {1: [{check: sum8}]}, else: []}",
        "{check: xor8, over: [d, b], name: a}, {data: d, size: 1}, {check: sum8, name: b, over: [a, d]}",
        "{check: xor8, over: [d], name: a}, {data: d, size: 1}, {wrap: hex, of: [{check: sum8, over: a..here}]}",
    ],
)
def test_checks_that_wait_for_each_other_are_refused(body: str) -> None:
    """A code that covers a code computed later would be wrong."""
    with pytest.raises(DefinitionError, match="covers what comes later, and is covered itself – put it last"):
        codec_of(body)


def codec_of(body: str) -> Codec:
    return compile_protocol(small_protocol(f"[{body}]"))


@pytest.mark.parametrize("name", PROTOCOLS)
def test_frames_are_found_however_a_stream_is_cut(name: str) -> None:
    """All frames are found, also in noise that ends like a frame; no other frame is found."""
    choose = random.Random(name)
    text = f"protocol: wrapped\nframes:\n  f: {{body: [{PROTOCOLS[name]}]}}\nreceiver: {{gap: 50 ms}}\n"
    codec = codec_of(PROTOCOLS[name])
    some = b"\x00\x7e\x7d\xc0\xdb\xff\xff\xff\xfd\x11\x42"
    sent = [bytes(choose.choices(some, k=choose.randrange(1, 300))) for _ in range(30)]
    stream = b"".join(codec.encode("f", {"d": data}) for data in sent)
    whole = feed(receiver_of(text), [stream], ("f",))
    assert [event[0] for event in whole] == ["frame"] * 30
    assert [codec.decode("f", event[2] if isinstance(event[2], bytes) else event[3])["d"] for event in whole] == sent
    assert feed(receiver_of(text), [stream[at : at + 1] for at in range(len(stream))], ("f",)) == whole
    for _ in range(5):
        places = sorted(choose.randrange(len(stream)) for _ in range(40))
        assert feed(receiver_of(text), cut_at(stream, places), ("f",)) == whole


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_damaged_frame_is_bad_and_the_next_one_is_found(name: str) -> None:
    codec, choose = codec_of(PROTOCOLS[name]), random.Random(name)
    text = f"protocol: wrapped\nframes:\n  f: {{body: [{PROTOCOLS[name]}]}}\nreceiver: {{gap: 50 ms}}\n"
    good = codec.encode("f", {"d": b"next one"})
    for _ in range(200):
        damaged = bytearray(codec.encode("f", {"d": bytes(choose.choices(b"\x00\x7e\xc0\xff\xfd\x42", k=20))}))
        place = choose.randrange(1, len(damaged) - 1)
        damaged[place] ^= 1 << choose.randrange(8)
        try:
            codec.decode("f", bytes(damaged))
            continue
        except FrameError:
            pass
        found = feed(receiver_of(text), [bytes(damaged) + good * 2], ("f",))
        assert ("frame", "f") in [event[:2] for event in found]
        assert not any(event[0] == "frame" and bytes(damaged) in event for event in found)


@pytest.mark.parametrize("coding", ["cobs", "hex"])
def test_content_that_tells_a_size_behind_it_is_read_a_few_times_while_the_rest_comes(coding: str) -> None:
    end = "00" if coding == "cobs" else "03"
    protocol = small_protocol(
        f"[{{const: 02}}, {{wrap: {coding}, of: [{{field: n, type: u16}}, {{data: d, size: rest}}]}}, {{const: {end}}},"
        " {data: e, size: n}, {check: sum8}]"
    )
    codec = compile_protocol(protocol)
    data = codec.encode("f", {"n": 500, "d": bytes(range(1, 251)), "e": bytes(500)})
    profile = cProfile.Profile()
    with profile:
        found = feed(
            Receiver(codec, protocol, Scope(protocol, line=LineFormat(9600))), cut_at(data, range(len(data))), ("f",)
        )
    assert [event[2] for event in found] == [data]
    calls = {name: called[1] for (_, _, name), called in pstats.Stats(profile).stats.items()}
    assert calls["content_of"] > 500 and calls["diagnose_f"] < 5
