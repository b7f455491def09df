"""Small definitions as users write them: DNP3's link frame, MAVLink 2, a text protocol with a check code before its CR.

The bytes come from other sources: DNP3 from the tests of opendnp3 (TestLinkFrame.cpp), MAVLink from pymavlink 2.4.50
(dialect common, MAVLink 2, source system and component 1).
"""

from __future__ import annotations

import random
from functools import cache

import pytest
from construct_oracle import compile_construct
from link.link_world import cut_at, feed, receiver_of

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError

DNP3 = """
protocol: dnp3-link
order: little
line: {speed: 9600}
frames:
  link:
    max: 292
    body:
      - const: 05 64
      - {length: n, type: u8, of: [data], plus: 5, range: 5..255}
      - {field: control, type: u8}
      - {field: destination, type: u16}
      - {field: source, type: u16}
      - {check: crc16-dnp, order: little, ends: yes}
      - {wrap: {block: 16, check: crc16-dnp, order: little}, plain: n - 5, of: [{data: data, size: rest}]}
receiver: {gap: 50 ms}
"""
ANSWER = (
    "C1 E3 81 96 00 02 01 28 01 00 00 00 01 02 01 28 01 00 01 00 01 02 01 28 01 00 02 00 01 02 01 28 01 00 03 00 01 20 "
    "02 28 01 00 00 00 01 00 00 20 02 28 01 00 01 00 01 00 00 01 01 01 00 00 03 00 00 1E 02 01 00 00 01 00 01 00 00 01 "
    "00 00"
)
DNP3_VECTORS = {
    "05 64 05 C0 01 00 00 04 E9 21": (0xC0, 1, 1024, ""),
    "05 64 05 40 00 04 01 00 A3 96": (0x40, 1024, 1, ""),
    "05 64 14 F3 01 00 00 04 0A 3B C0 C3 01 3C 02 06 3C 03 06 3C 04 06 3C 01 06 9A 12": (
        0xF3, 1, 1024, "C0 C3 01 3C 02 06 3C 03 06 3C 04 06 3C 01 06",
    ),
    "05 64 53 73 00 04 01 00 03 FC C1 E3 81 96 00 02 01 28 01 00 00 00 01 02 01 28 05 24 01 00 01 00 01 02 01 28 01 00 "
    "02 00 01 02 01 28 B4 77 01 00 03 00 01 20 02 28 01 00 00 00 01 00 00 20 A5 25 02 28 01 00 01 00 01 00 00 01 01 01 "
    "00 00 03 00 2F AC 00 1E 02 01 00 00 01 00 01 00 00 01 00 00 16 ED": (0x73, 1024, 1, ANSWER),
}  # fmt: skip

MAVLINK = """
protocol: mavlink2
order: little
line: {kind: stream}
tables: {crc_extra: {0: 50, 2: 137, 4: 237}}
groups:
  message:
    head:
      - const: FD
      - {length: n, type: u8, of: [payload]}
      - {field: incompatible, type: u8, default: 0}
      - {field: compatible, type: u8, default: 0}
      - {field: sequence, type: u8}
      - {field: system, type: u8}
      - {field: component, type: u8}
      - {field: id, type: u24}
    tail: [{check: crc16-mcrf4xx, order: little, over: [n..here, {bytes: "crc_extra[id]", type: u8}], wire: yes}]
frames:
  HEARTBEAT:
    group: message
    where: {id: 0}
    body:
      - name: payload
        wrap: {short: 00, min: 1}
        size: n
        of:
          - {field: custom_mode, type: u32}
          - {field: type, type: u8}
          - {field: autopilot, type: u8}
          - {field: base_mode, type: u8}
          - {field: system_status, type: u8}
          - {field: mavlink_version, type: u8}
  SYSTEM_TIME:
    group: message
    where: {id: 2}
    body:
      - name: payload
        wrap: {short: 00, min: 1}
        size: n
        of: [{field: time_unix_usec, type: u64}, {field: time_boot_ms, type: u32}]
  PING:
    group: message
    where: {id: 4}
    body:
      - name: payload
        wrap: {short: 00, min: 1}
        size: n
        of:
          - {field: time_usec, type: u64}
          - {field: seq, type: u32}
          - {field: target_system, type: u8}
          - {field: target_component, type: u8}
"""
MAVLINK_VECTORS = {
    "FD 09 00 00 07 01 01 00 00 00 00 00 00 00 02 03 51 04 03 A4 AC": (
        "HEARTBEAT", 7,
        {"custom_mode": 0, "type": 2, "autopilot": 3, "base_mode": 81, "system_status": 4, "mavlink_version": 3},
    ),
    "FD 01 00 00 08 01 01 00 00 00 00 69 01": (
        "HEARTBEAT", 8,
        {"custom_mode": 0, "type": 0, "autopilot": 0, "base_mode": 0, "system_status": 0, "mavlink_version": 0},
    ),
    "FD 09 00 00 09 01 01 04 00 00 87 D6 12 00 00 00 00 00 05 50 5C": (
        "PING", 9, {"time_usec": 1234567, "seq": 5, "target_system": 0, "target_component": 0},
    ),
    "FD 01 00 00 0A 01 01 02 00 00 00 D6 17": ("SYSTEM_TIME", 10, {"time_unix_usec": 0, "time_boot_ms": 0}),
}  # fmt: skip

TEXT = """
protocol: text
line: {speed: 9600}
frames:
  line:
    max: 80
    body:
      - text: '#'
      - {field: address, type: dec, size: 2}
      - {data: command, size: rest}
      - {check: sum8, as: hex}
      - const: CR
receiver: {gap: 1 s}
"""


@cache
def both(text: str) -> tuple[object, ...]:
    protocol = load_protocol_text(text, "small")
    return compile_protocol(protocol), compile_construct(protocol)


@pytest.mark.parametrize("wire", DNP3_VECTORS)
def test_dnp3(wire: str) -> None:
    control, destination, source, data = DNP3_VECTORS[wire]
    values = {"control": control, "destination": destination, "source": source, "data": bytes.fromhex(data)}
    for codec in both(DNP3):
        assert codec.encode("link", values).hex(" ").upper() == wire
        assert codec.decode("link", bytes.fromhex(wire)) == {"n": len(values["data"]) + 5, **values}


def test_every_bit_of_a_dnp3_frame_counts() -> None:
    codec = both(DNP3)[0]
    for wire in DNP3_VECTORS:
        for bit in range(len(bytes.fromhex(wire)) * 8):
            damaged = bytearray.fromhex(wire)
            damaged[bit // 8] ^= 1 << bit % 8
            with pytest.raises(FrameError) as error:
                codec.decode("link", bytes(damaged))
            assert error.value.cause == "check"


def test_dnp3_in_streams() -> None:
    """A damaged header costs no other frame; a damaged block makes its frame bad, and the next frame is found."""
    choose = random.Random(3)
    frames = [bytes.fromhex(wire) for wire in DNP3_VECTORS]
    stream, sent = b"", []
    for _ in range(80):
        frame = bytearray(choose.choice(frames))
        if choose.random() < 0.3:
            frame[choose.randrange(len(frame))] ^= 1 << choose.randrange(8)
        else:
            sent.append(bytes(frame))
        stream += frame
    whole = feed(receiver_of(DNP3), [stream], ("link",))
    assert [event[2] for event in whole if event[0] == "frame"] == sent
    assert {event[2] for event in whole if event[0] == "bad"} <= {"check", "range"}
    assert feed(receiver_of(DNP3), [stream[at : at + 1] for at in range(len(stream))], ("link",)) == whole
    for _ in range(4):
        parts = cut_at(stream, sorted(choose.choices(range(len(stream)), k=60)))
        assert feed(receiver_of(DNP3), parts, ("link",)) == whole


@pytest.mark.parametrize("wire", MAVLINK_VECTORS)
def test_mavlink(wire: str) -> None:
    frame, sequence, payload = MAVLINK_VECTORS[wire]
    values = {"sequence": sequence, "system": 1, "component": 1, **payload}
    for codec in both(MAVLINK):
        assert codec.encode(frame, values).hex(" ").upper() == wire
        read = codec.decode(frame, bytes.fromhex(wire))
        assert {name: read[name] for name in values} == values


def test_a_mavlink_message_with_all_its_zeros_is_read_too() -> None:
    """Senders may transmit trailing zeros; a shortened message has all fields nevertheless."""
    codec = both(MAVLINK)[0]
    body = bytes.fromhex("09 00 00 08 01 01 00 00 00") + bytes(9)
    code = codec.encode(
        "HEARTBEAT",
        {
            "sequence": 8,
            "system": 1,
            "component": 1,
            **dict.fromkeys(("custom_mode", "type", "autopilot", "base_mode", "system_status"), 0),
            "mavlink_version": 0,
        },
    )
    assert len(code) == 13
    crc = 0xFFFF
    for byte in body + b"\x32":  # as the MAVLink guide has it, byte by byte
        mixed = byte ^ (crc & 0xFF)
        mixed = (mixed ^ (mixed << 4)) & 0xFF
        crc = (crc >> 8) ^ (mixed << 8) ^ (mixed << 3) ^ (mixed >> 4)
    read = codec.decode("HEARTBEAT", b"\xfd" + body + crc.to_bytes(2, "little"))
    assert read["mavlink_version"] == 0 and read["n"] == 9


def test_mavlink_in_streams() -> None:
    choose = random.Random(4)
    names = ("HEARTBEAT", "SYSTEM_TIME", "PING")
    sent = [bytes.fromhex(choose.choice(list(MAVLINK_VECTORS))) for _ in range(60)]
    stream = b"".join(sent)
    whole = feed(receiver_of(MAVLINK), [stream], names)
    assert [event[2] for event in whole] == sent
    assert feed(receiver_of(MAVLINK), [stream[at : at + 1] for at in range(len(stream))], names) == whole
    parts = cut_at(stream, sorted(choose.choices(range(len(stream)), k=60)))
    assert feed(receiver_of(MAVLINK), parts, names) == whole


def test_a_text_protocol_is_found_by_its_end() -> None:
    """The offset of the check digits is counted back from the CR, without waiting for silence.

    A CR in the data is skipped.
    """
    codec, oracle = both(TEXT)
    wire = b"#07READ 4FA\r"
    assert sum(wire[:-3]) & 0xFF == 0xFA
    for one in (codec, oracle):
        assert one.encode("line", {"address": 7, "command": b"READ 4"}) == wire
        assert one.decode("line", wire) == {"address": 7, "command": b"READ 4"}
    frames = [codec.encode("line", {"address": place, "command": b"A\rB" * (place % 3)}) for place in range(20)]
    stream = b"".join(frames)
    whole = feed(receiver_of(TEXT), [stream], ("line",))
    assert [event[2] for event in whole] == frames
    assert feed(receiver_of(TEXT), [stream[at : at + 1] for at in range(len(stream))], ("line",)) == whole


DELIMITED = """
protocol: delimited
groups:
  line: {delimited: yes, head: [{const: 7E}], tail: [{const: 7E}], max: 60}
frames:
  f: {group: line, body: [{field: a, type: hex, size: 2}, {data: d, size: rest, never: [7E]}]}
receiver: {gap: 50 ms}
"""


def test_bytes_that_never_stand_in_data_make_delimited_frames_possible() -> None:
    codec, oracle = both(DELIMITED)
    for one in (codec, oracle):
        assert one.encode("f", {"a": 0x1F, "d": b"\x41\x42"}) == b"~1FAB~"
        assert one.decode("f", b"~1FAB~") == {"a": 0x1F, "d": b"AB"}
        with pytest.raises(EncodeError, match="never stands in it"):
            one.encode("f", {"a": 0x1F, "d": b"A~B"})
    frames = [codec.encode("f", {"a": place, "d": bytes(place)}) for place in range(20)]
    stream = b"~" + b"".join(frames)
    whole = feed(receiver_of(DELIMITED), [stream], ("f",))
    assert [event[2] for event in whole if event[0] == "frame"] == frames
    assert feed(receiver_of(DELIMITED), [stream[at : at + 1] for at in range(len(stream))], ("f",)) == whole


@pytest.mark.parametrize(
    "data, wrong",
    [
        ("{data: d, size: rest, never: [7E], convert: hex_to_ascii}", "is converted"),
        ("{data: d, size: 4, never: [00], pad: 00}", "which never stands in it"),
        ("{data: d, size: rest, never: []}", "never"),
        ("{wrap: {short: 00}, of: [{data: d, size: rest}]}", "content of any size"),
        ("{wrap: {short: 00, min: 3}, of: [{data: d, size: 2}]}", "3 are never left out"),
        ("{wrap: {block: 0, check: sum8}, of: [{data: d, size: 2}]}", "a block of no bytes"),
        ("{wrap: {block: 2}, of: [{data: d, size: 2}]}", "these keys together are no wrap"),
        ("{wrap: {block: 2, check: crc32, size: 1}, of: [{data: d, size: 2}]}", "does not fit"),
        ("{wrap: cobs, plain: 4, of: [{data: d, size: 4}]}", "depends on the content"),
        ("{wrap: hex, plain: 4, size: 8, of: [{data: d, size: 4}]}", "leave one out"),
        ("{wrap: hex, plain: 3, of: [{data: d, size: 4}]}", "correct size"),
    ],
)
def test_keys_that_do_not_fit_together_are_refused(data: str, wrong: str) -> None:
    with pytest.raises(DefinitionError) as error:
        load_protocol_text(f"protocol: p\nframes: {{f: {{body: [{data}]}}}}\n", "small")
    assert wrong in str(error.value), str(error.value)


COMMANDS = """
protocol: commands
groups:
  request:
    head: [{const: 02}, {length: n, type: u8, of: [k, body], plus: 2}, {field: k, type: u8}]
    tail: [{check: sum8, over: [n, k, body]}]
frames:
  PING: {group: request, where: {k: 1}, body: []}
  READ: {group: request, where: {k: 2}, body: [{field: at, type: u8}]}
"""


@pytest.mark.parametrize(
    ("frame", "values", "data"), [("PING", {}, "02 03 01 04"), ("READ", {"at": 5}, "02 04 02 05 0B")]
)
def test_a_length_of_the_body_counts_an_empty_one(frame: str, values: dict[str, int], data: str) -> None:
    protocol, wire = load_protocol_text(COMMANDS), bytes.fromhex(data)
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        assert codec.encode(frame, values) == wire
        assert codec.decode(frame, wire)["n"] == wire[1]
        with pytest.raises(FrameError):
            codec.decode(frame, bytes((wire[0], wire[1] + 1)) + wire[2:])
    stream = wire * 3
    whole = feed(receiver_of(COMMANDS), [stream], tuple(protocol.frames))
    assert [event[:2] for event in whole] == [("frame", frame)] * 3
    parts = [stream[at : at + 1] for at in range(len(stream))]
    assert feed(receiver_of(COMMANDS), parts, tuple(protocol.frames)) == whole


def test_fractions_of_more_digits_than_python_works_with_are_built_whole() -> None:
    protocol = load_protocol_text(
        "protocol: long\nframes:\n  f:\n    body:\n"
        "      - {field: a, type: decimal, size: 40, decimals: 15, default: 1234567890123456789.123456789012345}\n"
        "      - {field: b, type: u8, scale: 12345678901234567890.12345678901234567890,\n"
        "         default: 12345678901234567890.12345678901234567890}\n"
    )
    wire = b"1234567890123456789.123456789012345".rjust(40, b"0") + b"\x01"
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        assert codec.encode("f", {}) == wire
        assert str(codec.decode("f", wire)["b"]) == "12345678901234567890.12345678901234567890"
