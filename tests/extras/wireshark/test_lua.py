"""Generated dissectors in tshark: the fields of tshark compared with the values of framekit.

tshark takes longer to start than to read: one capture has the frames of many protocols, and tshark runs again only for
other parameters of a protocol. Skipped only if tshark is not installed.
"""

from __future__ import annotations

import re
from pathlib import Path
from random import Random

import pytest
from definition_trial import Trial as DefinitionTrial
from definition_trial import damaged
from drawn_definitions import DrawnDefinition
from extras.wireshark.tshark_world import (
    SECOND,
    DissectorInput,
    Packet,
    Trial,
    compare,
    needs_tshark,
    packets_of,
    preferences,
    run,
    serial_capture,
    tcp_capture,
    trials,
    udp_capture,
)
from segment_cases import CASES
from shipped import vectors_of
from strategies import base_context

from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.problems import DefinitionError
from framekit.definition.sources import shipped_definitions
from framekit.extras.wireshark.generate import generate_dissector
from framekit.extras.wireshark.source import comment, string, utf8
from framekit.service.capture import GLOBAL_HEADER, PcapRecords
from framekit.transport.port import LineEvent

QUICK = ("ccm", "mldp", "modbus-rtu")
VECTORS = [path.name.removesuffix(".vectors.yaml") for path in shipped_definitions("*.vectors.yaml")]


@needs_tshark
def test_vectors_show_what_framekit_reads(tmp_path: Path) -> None:
    for found in trials(QUICK, tmp_path).values():
        assert_shown(found)
        assert found.checks > 5, "wrong check codes are told by both"


@needs_tshark
@pytest.mark.long
def test_vectors_of_all_protocols_show_what_framekit_reads(tmp_path: Path) -> None:
    for found in trials([name for name in VECTORS if name not in QUICK], tmp_path).values():
        assert_shown(found)


def assert_shown(found: Trial) -> None:
    assert found.differences == []
    assert found.vectors and found.fields > found.vectors and not found.left_out


def test_preferences_say_the_parameters_of_vectors() -> None:
    protocol = load_protocol("df1")
    context = base_context(protocol) | {"check_kind": "bcc", "max_packet": 100}
    assert preferences(protocol, context) == {
        "check_kind": ("set_check_kind", "bcc"), "max_packet": ("set_max_packet", "100")
    }  # fmt: skip


@needs_tshark
@pytest.mark.long
def test_every_kind_of_segment(tmp_path: Path) -> None:
    comparisons = []
    for number, case in enumerate(CASES):
        protocol = load_protocol_text(case.yaml.replace("protocol: case\n", f"protocol: case-{number}\n", 1))
        frames = [case.bytes, *(bytes.fromhex(bad) for bad in case.bad if bad), case.bytes]
        comparisons.append(DissectorInput(protocol, base_context(protocol), frames, Trial()))
    compare(comparisons, tmp_path)
    for case, comparison in zip(CASES, comparisons, strict=True):
        assert comparison.found.differences == [], case.title
        is_told = not comparison.found.left_out or generate_dissector(comparison.protocol).left_out
        assert is_told, f"{case.title}: what is not shown was told"


@needs_tshark
@pytest.mark.long
def test_drawn_definitions(tmp_path: Path) -> None:
    comparisons = []
    for seed in range(60, 120):
        drawn, random = DrawnDefinition(seed, alike=bool(seed % 2)), Random(seed)
        text = drawn.text.replace('"protocol": "drawn"', f'"protocol": "drawn-{seed}"', 1)
        try:
            trial = DefinitionTrial(text, drawn.values, seed)
        except DefinitionError:
            continue  # many definitions are refused; the tests of both compilers try them
        data = trial.built()
        if data:
            frames = [data, *filter(None, (damaged(data, random) for _ in range(5))), data]
            comparisons.append(DissectorInput(trial.protocol, base_context(trial.protocol), frames, Trial(), 1))
    assert len(comparisons) > 15
    compare(comparisons, tmp_path)
    for comparison in comparisons:
        assert comparison.found.differences == []


@needs_tshark
def test_numbers_of_more_than_53_bits_are_shown_exactly(tmp_path: Path) -> None:
    text = """
protocol: wide
frames:
  f:
    body:
      - {const: 5A}
      - {field: a, type: u64}
      - {field: b, type: i64, order: little}
      - {field: c, type: uint, size: 11}
      - {field: twice, type: u8, when: a > 9}
"""
    protocol, found = load_protocol_text(text), Trial()
    frames = []
    for a, b in ((9, -1), (0x20_0000_0000_0001, -(1 << 63)), ((1 << 64) - 1, -(1 << 53) - 1), (3, (1 << 63) - 1)):
        wide = (a << 20 | 1).to_bytes(11, "big")
        frames.append(b"\x5a" + a.to_bytes(8, "big") + b.to_bytes(8, "little", signed=True) + wide)
    compare([DissectorInput(protocol, base_context(protocol), [*frames[:1], *frames[3:]], found)], tmp_path / "exact")
    assert found.differences == [] and found.fields == 8
    script, capture = tmp_path / "wide.lua", tmp_path / "wide.pcap"
    source = generate_dissector(protocol).source
    script.write_text(source.replace('when = function(n) return X.gt(X.of(n, "a"), 9) end', "when = nil"))
    serial_capture(capture, [frame + b"\0" for frame in frames])
    shown = packets_of(run(script, capture, "-T", "pdml"), "fk_wide")
    assert [packet.value("fk_wide.a") for packet in shown] == [
        str(int.from_bytes(frame[1:9], "big")) for frame in frames
    ]
    assert [packet.value("fk_wide.b") for packet in shown] == [
        str(int.from_bytes(frame[9:17], "little", signed=True)) for frame in frames
    ]
    serial_capture(capture, [frames[1]])
    script.write_text(source)
    (packet,) = packets_of(run(script, capture, "-T", "pdml"), "fk_wide")
    assert packet.experts == ["unsaid"] and "53 bits" in packet.messages[0], "an expression is not worked out wrongly"


SECURED = """
protocol: secured
params: {k: {type: bytes, size: 16, secret: yes}}
frames:
  plain: {body: [{const: 01}, {field: a, type: u8}]}
  signed: {body: [{const: 02}, {field: a, type: u8}, {check: cmac-aes, key: k, size: 4}]}
  sealed:
    body: [{const: 03}, {wrap: {cipher: aes-cbc, key: k, iv: k}, of: [{data: d, size: rest}]}]
"""


def test_constants_of_more_than_53_bits_are_told() -> None:
    text = "protocol: wide\nframes: {f: {body: [{field: a, type: u64, is: 0x20000000000001}, {field: b, type: u8}]}}"
    ((problem, frames),) = generate_dissector(load_protocol_text(text)).left_out
    assert problem.what == "the number 9007199254740993, which has more than 53 bits" and frames == ("f",)


def test_what_cannot_be_said_is_told_with_its_place() -> None:
    left = generate_dissector(load_protocol_text(SECURED, "secured")).left_out
    assert [(problem.at.line, problem.what, problem.todo, frames) for problem, frames in left] == [
        (6, "the check code cmac-aes is made with a key", "it is shown, and not verified", ("signed",)),
        (8, "the content is enciphered", "where it is reached, the frame is shown as bytes", ("sealed",)),
    ]


@needs_tshark
def test_what_cannot_be_said_is_shown_as_bytes(tmp_path: Path) -> None:
    script, capture = tmp_path / "secured.lua", tmp_path / "secured.pcap"
    script.write_text(generate_dissector(load_protocol_text(SECURED, "secured")).source)
    serial_capture(capture, [bytes.fromhex(digits) for digits in ("01 07", "02 07 01 02 03 04", "03" + " 55" * 16)])
    plain, signed, sealed = packets_of(run(script, capture, "-T", "pdml"), "fk_secured")
    assert (plain.frames, plain.experts) == (["plain"], [])
    assert (signed.frames, signed.experts, signed.value("fk_secured.a")) == (["signed"], ["unverified"], "7")
    assert (sealed.frames, sealed.experts, sealed.fields) == ([], ["unsaid"], [])


# ---- streams ------------------------------------------------------------------------------------------------


def cross_references(packets: list[Packet], prefix: str) -> list[tuple[list[str], dict[str, str]]]:
    """Return the frames of each packet, and the fields that refer to other packets."""
    names = ("request_in", "response_in", "time")
    return [
        (packet.frames, {name: value for name in names if (value := packet.value(f"{prefix}.{name}")) is not None})
        for packet in packets
    ]


@needs_tshark
def test_frames_in_segments_of_tcp_and_the_request_of_a_reply(tmp_path: Path) -> None:
    ask, answer, ask_2, answer_2, ask_3, answer_3 = (
        frame.wire.exact[:1] + bytes((number // 2,)) + frame.wire.exact[2:]
        for number, frame in enumerate(vectors_of("modbus-tcp").frames[:6])
        if frame.wire.exact is not None
    )
    script, capture = tmp_path / "modbus.lua", tmp_path / "modbus.pcap"
    script.write_text(generate_dissector(load_protocol("modbus-tcp")).source)
    segments = [
        ("client", ask[:3]), ("client", ask[3:8]), ("client", ask[8:]), ("server", answer),
        ("client", ask_2 + ask_3[:5]), ("client", ask_3[5:]), ("server", answer_3[:6]),
        ("server", answer_3[6:] + answer_2),
    ]  # fmt: skip
    tcp_capture(capture, 502, segments)
    found = packets_of(run(script, capture, "-2", "-T", "pdml"), "fk_modbus_tcp")
    assert cross_references(found, "fk_modbus_tcp") == [
        ([], {}),
        ([], {}),
        (["request_adu"], {"response_in": "4"}),
        (["reply_adu"], {"request_in": "3", "time": "0.010000000"}),
        (["request_adu"], {"response_in": "8"}),
        (["request_adu"], {"response_in": "8"}),
        ([], {}),
        (["reply_adu", "reply_adu"], {"request_in": "6", "time": "0.020000000"}),
    ]
    both = [field.value for field in found[7].fields if field.name.endswith("request_in")]
    assert both == ["6", "5"], "each reply has the request whose transaction it repeats"


@needs_tshark
def test_several_dissectors_and_one_that_is_chosen(tmp_path: Path) -> None:
    ask = bytes.fromhex("11 03 00 6B 00 03 76 87")
    scripts, capture = [tmp_path / "ccm.lua", tmp_path / "modbus-rtu.lua"], tmp_path / "rtu.pcap"
    for script in scripts:
        script.write_text(generate_dissector(load_protocol(script.stem)).source)
    serial_capture(capture, [ask])
    more = ("-X", f"lua_script:{scripts[1]}", "-T", "pdml")
    (packet,) = packets_of(run(scripts[0], capture, *more, "-d", "rtacser.data,fk_modbus_rtu"), "fk_modbus_rtu")
    assert packet.frames == ["request_adu"]
    assert "fk_ccm" not in run(scripts[0], capture, *more), "with several none is taken by itself"


@needs_tshark
def test_frames_in_datagrams(tmp_path: Path) -> None:
    ask = bytes.fromhex("15 01 00 00 00 06 11 01 00 13 00 13")
    script, capture = tmp_path / "modbus.lua", tmp_path / "modbus.pcap"
    script.write_text(generate_dissector(load_protocol("modbus-tcp")).source)
    udp_capture(capture, 40_502, [ask, ask + ask, ask[:7]])
    shown = run(script, capture, "-d", "udp.port==40502,fk_modbus_tcp", "-T", "pdml")
    found = packets_of(shown, "fk_modbus_tcp")
    assert [packet.frames for packet in found] == [["request_adu"], ["request_adu"] * 2, []]
    assert [packet.experts for packet in found] == [[], [], ["bad"]]


@needs_tshark
def test_a_serial_line_in_pieces_and_who_sends_what(tmp_path: Path) -> None:
    write = bytes.fromhex("11 06 00 01 00 03 9A 9B")  # its reply is the same bytes
    read, values = bytes.fromhex("11 03 00 6B 00 03 76 87"), bytes.fromhex("11 03 06 02 2B 00 00 00 64 C8 BA")
    script, capture = tmp_path / "rtu.lua", tmp_path / "rtu.pcap"
    script.write_text(generate_dissector(load_protocol("modbus-rtu")).source)
    pieces = [
        ("out", 0, read[:5]), ("out", 3, read[5:]), ("in", 20, values[:1]), ("in", 22, values[1:]),
        ("out", 40, write), ("in", 60, write), ("out", 3000, read[:4]), ("out", 6000, read),
        ("in", 6020, b"\xff" + values),
    ]  # fmt: skip
    records = PcapRecords(0)
    lines = [LineEvent("data", SECOND + at * 1_000_000, way, data) for way, at, data in pieces]
    capture.write_bytes(GLOBAL_HEADER + b"".join(map(records.of, lines)))
    found = packets_of(run(script, capture, "-2", "-T", "pdml"), "fk_modbus_rtu")
    assert cross_references(found, "fk_modbus_rtu") == [
        ([], {}),
        (["request_adu"], {"response_in": "4"}),
        ([], {}),
        (["reply_adu"], {"request_in": "2", "time": "0.019000000"}),
        (["request_adu"], {"response_in": "6"}),
        (["reply_adu"], {"request_in": "5", "time": "0.020000000"}),
        ([], {}),
        (["request_adu"], {"response_in": "9"}),
        (["reply_adu"], {"request_in": "8", "time": "0.020000000"}),
    ]
    assert [packet.experts for packet in found] == [["part"], [], ["part"], [], [], [], ["check"], [], ["noise"]]
    assert found[0].messages == ["The frame goes on in packet 2"]


@needs_tshark
def test_noise_is_told_and_ends(tmp_path: Path) -> None:
    """Random bytes, also many at once: the script raises no error, and its work is bounded."""
    random, script, capture = Random(3), tmp_path / "rtu.lua", tmp_path / "rtu.pcap"
    script.write_text(generate_dissector(load_protocol("modbus-rtu")).source)
    serial_capture(capture, [*(random.randbytes(random.randint(1, 200)) for _ in range(30)), random.randbytes(3000)])
    found = packets_of(run(script, capture, "-2", "-T", "pdml"), "fk_modbus_rtu")
    assert all(packet.experts or packet.frames for packet in found)
    assert sum(bool({"noise", "bad", "check", "part"} & {*packet.experts}) for packet in found) > 25


# ---- text of a file is never code -------------------------------------------------------------------------------

HOSTILE = ']] --[[ "; os.exit(1) --\n\'\\" .. error() .. " \u2028 %s'
TEXTS = """
protocol: texts
about: ABOUT
params: {{p: {{type: text, default: DEFAULT}}}}
tables: {{t: {{1: ABOUT, 2: b}}}}
frames:
  NAME:
    doc: ABOUT
    body:
      - {{const: 5A}}
      - {{field: a, type: u8, values: {{1: ABOUT, 2: two}}, doc: ABOUT}}
      - {{field: w, type: ascii, end: 00, is: DEFAULT}}
      - {{require: REQUIRE}}
  inner: {{from: none, body: [{{text: ABOUT2}}]}}
"""


def source_with(hostile: str) -> str:
    quoted = "'" + hostile.replace("\\", "\\\\").replace("'", "\\'") + "'"
    words = {
        "ABOUT2": "".join(sign for sign in hostile if ord(sign) < 256), "ABOUT": hostile, "DEFAULT": quoted,
        "NAME": "ok", "REQUIRE": f"p == {quoted} or a == 1",
    }  # fmt: skip
    text = TEXTS.replace("{{", "{").replace("}}", "}")
    for word, meant in words.items():
        text = re.sub(rf"\b{word}\b", lambda _, meant=meant: yaml(meant), text)
    return generate_dissector(load_protocol_text(text)).source


def yaml(text: str) -> str:
    shown = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\u2028", "\\u2028")
    return f'"{shown}"'


def skeleton(source: str) -> str:
    """Return the source without comments and with empty strings."""
    without = re.sub(r"^-- .*$", "--", source, flags=re.MULTILINE)
    return re.sub(r'"(?:[^"\\\n]|\\.)*"', '""', without)


def test_hostile_text_stays_text() -> None:
    assert skeleton(source_with(HOSTILE)) == skeleton(source_with(re.sub("[^\u2028]", "h", HOSTILE, flags=re.DOTALL)))


@needs_tshark
def test_hostile_text_is_shown_as_it_is(tmp_path: Path) -> None:
    script, capture = tmp_path / "texts.lua", tmp_path / "texts.pcap"
    hostile = HOSTILE.replace("\u2028", "é")
    script.write_text(source_with(hostile), encoding="utf-8")
    serial_capture(capture, [b"\x5a\x01" + hostile.encode("latin-1") + b"\0"])
    (packet,) = packets_of(run(script, capture, "-T", "pdml"), "fk_texts")
    assert (packet.frames, packet.experts) == (["ok"], [])
    shown = packet.value("fk_texts.w")
    assert shown is not None and "os.exit(1)" in shown and "é" in shown


def test_literals_and_comments() -> None:
    assert string('a"\\\n]]é') == '"a\\034\\092\\010\\093\\093\\233"'
    assert string(bytes((0, 49))) == '"\\0001"'
    assert utf8("é") == '"\\195\\169"'
    assert comment("a\n[[ b\u2028") == "-- a [[ b"
