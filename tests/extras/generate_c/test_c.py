"""Generated C compared with Python: the same values of the same bytes, or the same reason at the same offset.

gcc compiles it with all warnings as errors, and it runs with AddressSanitizer and UBSan.
"""

from __future__ import annotations

import re
from pathlib import Path
from random import Random

import pytest
from extras.generate_c.c_fuzz import fuzz
from extras.generate_c.c_harness import GCC, CProtocol, differences, encode_trial, measure_trial, stream_trial, trial
from segment_cases import CASES, Case
from shipped import APPLICATIONS, PROTOCOLS
from spread import many

from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.extras.generate_c.generate import generate
from framekit.extras.generate_c.source import CannotSayError, CNames, comment, identifier, string

needs_gcc = pytest.mark.skipif(GCC is None, reason="gcc is missing")
QUICK = ("ccm", "dynamixel", "modbus-rtu")


def omissions(text: str) -> list[str]:
    """Return the messages for omitted parts, each with its line in the file."""
    made = generate(load_protocol_text(text, "small"))
    return [re.sub(r"^.*small\.yaml:", "", str(problem)) for _, problem in made.left_out]


def compiled(text: str, folder: Path) -> CProtocol:
    return CProtocol(load_protocol_text(text, "small"), folder)


@needs_gcc
@pytest.mark.parametrize("name", QUICK)
def test_shipped_frames_are_read_and_built_as_by_python(name: str, tmp_path: Path) -> None:
    c = CProtocol(load_protocol(name), tmp_path)
    assert c.generated.frames
    assert trial(c, seed=7, samples=3, changes=6) == []
    assert encode_trial(c, seed=8, samples=3, changes=4) == []
    assert measure_trial(c, seed=9, samples=2, changes=1) == []
    for noisy in (False, True):
        different, tried = stream_trial(c, seed=10, noisy=noisy, count=3)
        assert tried and different == []


@needs_gcc
@pytest.mark.long
@pytest.mark.parametrize("name", [*PROTOCOLS, *APPLICATIONS])
def test_all_shipped_frames_are_read_and_built_as_by_python(name: str, tmp_path: Path) -> None:
    definition = load_protocol(name)
    if not generate(definition).frames:
        pytest.skip("no frames")
    c = CProtocol(definition, tmp_path)
    assert trial(c, seed=20, samples=8, changes=30) == []
    assert encode_trial(c, seed=21, samples=8, changes=20) == []
    assert measure_trial(c, seed=22, samples=6, changes=6) == []
    if c.generated.in_streams:
        assert stream_trial(c, seed=23, noisy=False, count=30)[0] == []
        different, tried = stream_trial(c, seed=24, noisy=True, count=60)
        assert len(different) * 20 <= tried, different  # docs/generate-c.md explains the differences
        assert_no_harm(name, tmp_path)


@needs_gcc
@pytest.mark.long
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.title)
def test_every_kind_of_segment_is_read_and_built_as_by_python(case: Case, tmp_path: Path) -> None:
    definition = load_protocol_text(case.yaml)
    if "f" not in generate(definition).frames:
        pytest.skip("left out")
    c = CProtocol(definition, tmp_path)
    assert differences(c, [("f", case.bytes), *(("f", bytes.fromhex(data)) for data in case.bad)]) == []
    assert trial(c, seed=31, samples=5, changes=25) == []
    assert encode_trial(c, seed=32, samples=4, changes=12) == []
    assert measure_trial(c, seed=33, samples=4, changes=4) == []
    if c.generated.in_streams:
        assert stream_trial(c, seed=34, noisy=False, count=3)[0] == []


def assert_no_harm(name: str, folder: Path) -> None:
    """Put damaged streams into the parser of a protocol; assert that it neither crashes nor loses frames."""
    size = many(60_000, 300_000)
    found = fuzz(name, size, seed=5, folder=folder)
    assert found is None or (found.fault == "" and found.bytes >= size and found.good > size // 3000 and found.bad)


@needs_gcc
def test_damaged_streams_do_no_harm(tmp_path: Path) -> None:
    assert_no_harm("cobs", tmp_path)


DECIMALS = (
    "size: 4", "size: 5, pad: 20", "size: 3, sign: never", "size: 6, sign: always, decimals: 1",
    "size: 6, sign: space, decimals: 2", "size: 4, point: always", "size: 18", "end: 2C",
    "end: 2C, decimals: any, digits: 3", "end: 2C, decimals: any, point: always",
    "end: 2C, decimals: 3, exponent: 2, sign: always",
    "end: 2C, decimals: 1, exponent: 1", "end: 2C, decimals: 1, empty: yes", "end: [2C, 2A], digits: 0, decimals: 2",
)  # fmt: skip


@needs_gcc
@pytest.mark.long
def test_numbers_in_text_are_read_and_built_as_by_python(tmp_path: Path) -> None:
    frames = "".join(
        f"  f{number}: {{body: [{{field: a, type: decimal, {keys}}}, {{field: b, type: u8}}]}}\n"
        for number, keys in enumerate(DECIMALS)
    )
    c = compiled(f"protocol: small\nframes:\n{frames}", tmp_path)
    assert len(c.generated.frames) == len(DECIMALS) and not c.generated.not_built
    random_, cases = Random(3), []
    for frame in c.generated.frames:
        for data in c.samples(frame, 20):
            cases += [(frame, data), *((frame, _some_signs_changed(random_, data)) for _ in range(60))]
        for _ in range(1500):
            cases.append((frame, bytes(random_.choices(b"0012459+-.E ", k=random_.randrange(1, 7))) + b",b"))
    assert differences(c, cases) == []
    assert encode_trial(c, seed=4, samples=20, changes=40) == []
    assert measure_trial(c, seed=5, samples=4, changes=6) == []


def _some_signs_changed(random_: Random, data: bytes) -> bytes:
    found = bytearray(data)
    for _ in range(random_.choice((1, 1, 2))):
        found[random_.randrange(len(found))] = random_.choice(b"0019+-.E ,")
    return bytes(found)


# ---- text of a definition ---------------------------------------------------------------------------------------

HOSTILE = r"""
protocol: hostile
about: "*/ int x; /* ??/ \" \\ %s \n"
params: {limit: {type: number, default: 5}}
groups:
  int: {head: [{text: "a\"*/??)\\"}, {field: int, type: u8, values: {1: '*/ boom(', 2: '??/', 3: "x\"y"}}]}
frames:
  struct:
    group: int
    doc: "*/ boom(); /* ??/ \\"
    body: [{field: memcpy, type: u8}, {field: NULL, type: u8}, {const: 22 5C 3F}]
  1-2.3:
    body: [{text: "??/"}, {field: UINT8_MAX, type: u16, is: int_ + 1}, {field: int_, type: u8}, {field: _, type: u8}]
"""


@needs_gcc
def test_text_of_a_definition_stays_text(tmp_path: Path) -> None:
    c = compiled(HOSTILE, tmp_path)
    assert c.generated.left_out == ()
    good = b'a"*/??)\\\x01\x02\x03"\\?', b"??/\x00\x06\x05\x07"
    assert (
        differences(c, [("struct", good[0]), ("struct", good[0][:-1]), ("1-2.3", good[1]), ("1-2.3", good[1][:3])])
        == []
    )
    assert c.ask(["d struct_ x" + good[0].hex()]) == ["= 1 2 3"]
    for text in (c.generated.header, c.generated.source):
        assert "boom(" not in re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        assert text.isascii() and "??" not in text


def test_texts_that_end_comments_and_strings() -> None:
    assert comment("a */ b /* c ??/ d \\") == "/* a * / b / * c ? ?/ d */"
    assert comment("ä\n\u2028") == "/* \\xe4 \\u2028 */"
    assert string(b'"\\\n1?\xff') == '"\\042\\134\\0121\\077\\377"'


def test_names_of_c() -> None:
    assert [identifier(name) for name in ("int", "a-b", "9x", "_T", "a__b", "UINT8_MAX", "é", "")] == [
        "int_", "a_b", "x9x", "x_T", "a_b", "UINT8_MAX_", "x_", "x",
    ]  # fmt: skip
    names = CNames("a struct")
    assert names.take("a_b", "'a-b'") == "a_b"
    with pytest.raises(CannotSayError, match=r"'a\.b' and 'a-b' are both called 'a_b' in a struct"):
        names.take("a_b", "'a.b'")


def test_frames_with_a_name_of_every_file_are_left_out() -> None:
    frames = "".join(
        f"  {name}: {{body: [{{const: {at:02X}}}]}}\n"
        for at, name in enumerate(("parser", "context", "defaults", "UNKNOWN", "fine"))
    )
    made = generate(load_protocol_text(f"protocol: own\nframes:\n{frames}"))
    assert {frame for frame, _ in made.left_out} == {"parser", "context", "defaults", "UNKNOWN"}
    assert all("what stands in every such file" in problem.what for _, problem in made.left_out)


def test_frames_with_one_name_in_c_are_left_out() -> None:
    text = "protocol: p\nframes:\n  a-b: {body: [{const: 01}]}\n  a.b: {body: [{const: 02}]}\n"
    assert generate(load_protocol_text(text, "small")).frames == ("a-b",)
    assert omissions(text) == [
        "4:3: the frame 'a.b' and the frame 'a-b' are both called 'p_a_b' in the C of 'p' – rename one of them"
    ]


@needs_gcc
def test_a_frame_that_the_buffer_cannot_hold_does_not_stop_the_parser(tmp_path: Path) -> None:
    text = (
        "protocol: p\nframes:\n"
        "  long: {body: [{const: AA}, {length: n, type: u16, of: [d]}, {data: d, size: n}, {check: sum8}]}\n"
    )
    c = compiled(text, tmp_path)
    good = bytes.fromhex("AA 00 01 05 B0")
    stream = b"\xaa\x40\x00" + good * 400
    assert c.ask([f"s client x{stream.hex()} 70000"])[0].split()[:3] == ["B", "1", "no_room"]
    assert len(c.ask([f"s client x{stream.hex()} 70000"])[0].split("F 1 ")) == 401


def test_what_cannot_be_said_is_left_out_with_its_place() -> None:
    text = (
        "protocol: p\nparams: {k: {type: bytes, size: 16, secret: yes}}\nframes:\n"
        "  plain: {body: [{field: a, type: u8}]}\n"
        "  keyed: {body: [{field: a, type: u8}, {check: hmac-md5, key: k, size: 4}]}\n"
    )
    assert generate(load_protocol_text(text, "small")).frames == ("plain",)
    assert omissions(text) == ["5:40: 'hmac-md5', a code that is made with a key"]


def test_decimals_that_64_bits_do_not_hold_are_left_out() -> None:
    keys = ("size: 20", "end: 2C, decimals: 19", "end: 2C, decimals: 18, range: 0..10", "end: 2C, decimals: 18")
    text = "protocol: p\nframes:\n" + "".join(
        f"  f{number}: {{body: [{{field: a, type: decimal, {one}}}]}}\n" for number, one in enumerate(keys)
    )
    assert generate(load_protocol_text(text, "small")).frames == ("f3",)
    assert {omission.partition(": ")[2] for omission in omissions(text)} == {"'a' is a number of more than 64 bits"}
