"""The server: inverse evaluation of requests, order of refusals, mapped memory, and all kinds of services."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link.service_loop import Loop

from framekit.codec.errors import FrameError
from framekit.link.addresses import Address
from framekit.link.services.rows import ServiceError
from framekit.link.services.work import CompiledBlock
from framekit.link.values import FrameValue, Names
from framekit.memory.memory import Area, DeviceMemory
from framekit.memory.profile import load_profile

# ---- the ASCII protocol: what its specification says is refused -----------------------------------------------------


def with_check(text: str, head: str = "\x05", tail: str = "\x04") -> bytes:
    """Return a frame of the ASCII protocol with its check code (lower-case command)."""
    body = (head + text + tail).encode()
    return body + f"{sum(body) & 0xFF:02X}".encode()


def block(name: str, data: str = "") -> str:
    return f"{len(name):02X}{name}{data}"


MALFORMED = [
    (0x0003, "01rSS11" + block("%MW1") * 17),
    (0x0003, "01rSS00"),
    (0x0004, "01rSS01" + block("%MW00000000000001")),
    (0x0011, "01rSB00" + "01"),
    (0x0007, "01rSS01" + block("%MQ1")),
    (0x0007, "01rSB" + block("%MX1") + "01"),
    (0x0011, "01rSS01" + block("MW100")),
    (0x0011, "01rSB" + block("%MW1") + "00"),
    (0x0011, "01wSS01" + block("%MX1", "02")),
    (0x0090, "01y05"),
    (0x0190, "01y20"),
    (0x0290, "01x20RSS01" + block("%MW1")),
    (0x0290, "01xFFRSB" + block("%MW1") + "01"),
    (0x1132, "01rSS01" + block("%QW1")),
    (0x1132, "01rSB" + block("%QW1") + "01"),
    (0x1132, "01wSS01" + block("%FW1", "0001")),
    (0x1232, "01rSB" + block("%MW1") + "3D"),
    (0x1232, "01rSS10" + block("%ML1") * 16),
    (0x1234, "01rSS01" + block("%MW1") + "X"),
    (0x1234, "01wSB" + block("%MW1") + "01" + "00010"),
    (0x1332, "01rSS02" + block("%MW1") + block("%MD1")),
    (0x1432, "01wSS01" + block("%MW1", "00G0")),
    (0x1432, "01wSB" + block("%MW1") + "01" + "12x4"),
    (0x7132, "01rSS01" + block("%MW2048")),
    (0x7132, "01rSB" + block("%MW2047") + "02"),
    (0x7132, "01wSB" + block("%MW2047") + "02" + "00010002"),
    (0x7132, "01wSS02" + block("%MW1", "1111") + block("%MW4096", "2222")),
    (0x7132, "01x01RSB" + block("%MW2047") + "02"),
]


@pytest.mark.parametrize(("code", "text"), MALFORMED)
def test_malformed_and_impossible_requests_get_their_code(code: int, text: str) -> None:
    loop = Loop("mldp")
    before = loop.memory.snapshot()
    raw = with_check(text)
    if len(raw) <= 256:
        assert loop.answer(raw) == with_check(f"{text[:5]}{code:04X}", "\x15", "\x03")
    assert loop.serve(loop.request(raw)).refusal == code
    assert loop.memory.snapshot() == before and loop.troubles == []


def test_every_code_of_the_specification_is_among_these() -> None:
    codes = {0x0003, 0x0004, 0x0007, 0x0011, 0x0090, 0x0190, 0x0290, 0x1132, 0x1232, 0x1234, 0x1332, 0x1432, 0x7132}
    assert {code for code, _ in MALFORMED} == codes


@pytest.mark.parametrize(
    ("text", "reply"),
    [
        ("01rSS02" + block("%MW020") + block("%PW001"), "01rSS02" + "021234" + "025678"),
        ("0ArSB" + block("%MW000") + "02", "0ArSB01" + "04" + "AA15BB16"),
        ("01wSS01" + block("%MW230", "00FF"), "01wSS"),
        ("01wSB" + block("%DW000") + "01" + "AA15", "01wSB"),
        ("01RSS01" + block("%MX1"), None),
    ],
)
def test_the_examples_of_the_guide(text: str, reply: str | None) -> None:
    loop = Loop("mldp")
    loop.memory.write("M", "word", 20, [0x1234])
    loop.memory.write("P", "word", 1, [0x5678])
    loop.memory.write("M", "word", 0, [0xAA15, 0xBB16])
    if reply is None:
        assert loop.answer(f"\x05{text}\x04".encode()) == b"\x0601RSS010100\x03"
    else:
        assert loop.answer(with_check(text)) == with_check(reply, "\x06", "\x03")
    if "wSS" in text:
        assert loop.memory.read("M", "word", 230) == [0xFF]
    if "wSB" in text:
        assert loop.memory.read("D", "word", 0) == [0xAA15]


def test_a_monitor_of_the_guide() -> None:
    loop = Loop("mldp")
    loop.memory.write("M", "word", 0, [0x2342])
    assert loop.answer(with_check("01x01RSS01" + block("%MW000"))) == with_check("01x01", "\x06", "\x03")
    assert loop.answer(with_check("01y01")) == with_check("01y0101022342", "\x06", "\x03")


def test_the_form_of_continuous_replies_is_a_setting() -> None:
    loop = Loop("mldp", params={"blocks_field": 0})
    loop.memory.write("M", "word", 0, [0x1234, 0x5678])
    assert loop.answer(with_check("0ArSB" + block("%MW000") + "02")) == with_check("0ArSB0412345678", "\x06", "\x03")


def test_a_list_is_written_as_a_whole_or_not_at_all() -> None:
    loop = Loop("mldp")
    assert loop.serve(loop.request(with_check("01wSS02" + block("%MW1", "1111") + block("%FW4", "2222")))).refusal
    assert loop.memory.read("M", "word", 1) == [0]


# ---- Modbus ----------------------------------------------------------------------------------------------------------


def pdu(loop: Loop, raw: bytes) -> bytes:
    return loop.answer(raw)


def guide_loop(**params: Any) -> Loop:
    """Return a loop with areas mapped as in the guide's chapter 9: DI P20, DO M300, AI M400, AO M500."""
    mapping = {"input": ("P", 320), "coil": ("M", 4800), "input_register": ("M", 400), "holding": ("M", 500)}
    return Loop("modbus-rtu", memory=load_profile("masterlogic").create(), mapping=mapping, params=params)


def test_bit_areas_lie_on_word_memory() -> None:
    loop = guide_loop()
    assert pdu(loop, bytes.fromhex("0F 00 03 00 0A 02 FF 03")) == bytes.fromhex("0F 00 03 00 0A")
    assert loop.memory.read("M", "word", 300, 2) == [0x1FF8, 0]
    assert pdu(loop, bytes.fromhex("05 00 10 FF 00")) == bytes.fromhex("05 00 10 FF 00")
    assert loop.memory.read("M", "word", 300, 2) == [0x1FF8, 1]
    assert pdu(loop, bytes.fromhex("01 00 02 00 0C")) == bytes.fromhex("01 02 FE 07")
    loop.memory.write("P", "word", 20, [0x8001])
    assert pdu(loop, bytes.fromhex("02 00 00 00 11")) == bytes.fromhex("02 03 01 80 00")
    loop.memory.write("M", "word", 400, [0x1234])
    assert pdu(loop, bytes.fromhex("04 00 00 00 01")) == bytes.fromhex("04 02 12 34")


def test_word_areas_lie_on_bit_memory() -> None:
    memory = DeviceMemory([Area("bits", size=100, unit="bit")])
    loop = Loop("modbus-rtu", memory=memory, mapping={"holding": ("bits", 2), "coil": ("bits", 3)})
    assert pdu(loop, bytes.fromhex("06 00 00 12 34")) == bytes.fromhex("06 00 00 12 34")
    assert memory.read("bits", "word", 2) == [0x1234]
    assert pdu(loop, bytes.fromhex("03 00 00 00 01")) == bytes.fromhex("03 02 12 34")
    assert pdu(loop, bytes.fromhex("0F 00 00 00 03 01 05")) == bytes.fromhex("0F 00 00 00 03")
    assert memory.read("bits", "bit", 0, 8) == [0, 0, 0, 1, 0, 1, 0, 0]
    assert pdu(loop, bytes.fromhex("06 00 04 12 34")) == bytes.fromhex("86 02")


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("03 00 00 00 7E", 3),
        ("03 00 00 00 00", 3),
        ("10 00 00 00 79 F2" + " 00" * 242, 3),
        ("10 00 00 00 02 03 00 00 00", 3),
        ("05 00 00 12 34", 3),
        ("03 FF FF 00 02", 2),
        ("2B 0E 01 00", 1),
        ("01 75 30 00 02", 2),
    ],
)
def test_exceptions(request_: str, code: int) -> None:
    loop = guide_loop(limit_write_words=120)
    raw = bytes.fromhex(request_)
    assert pdu(loop, raw) == bytes([raw[0] | 0x80, code])
    assert loop.troubles == []


def test_an_area_that_is_mapped_to_nothing_is_unknown() -> None:
    memory = DeviceMemory([Area("coil", size=100, unit="bit")])
    loop = Loop("modbus-rtu", memory=memory)
    assert pdu(loop, bytes.fromhex("03 00 00 00 01")) == bytes.fromhex("83 02")
    assert pdu(loop, bytes.fromhex("01 00 00 00 01")) == bytes.fromhex("01 01 00")


def test_memory_that_is_read_only_cannot_be_written_through_any_area() -> None:
    memory = DeviceMemory([Area("F", size=10, access="read")])
    loop = Loop("modbus-rtu", memory=memory, mapping={"holding": ("F", 0)})
    assert pdu(loop, bytes.fromhex("06 00 00 12 34")) == bytes.fromhex("86 02")
    assert pdu(loop, bytes.fromhex("16 00 00 00 00 00 01")) == bytes.fromhex("96 02")
    assert memory.read("F", "word", 0) == [0]


def test_changing_single_bits_of_a_word() -> None:
    loop = guide_loop()
    loop.memory.write("M", "word", 504, [0x12])
    assert loop.do("call", "mask_write", {"address": 4, "and_mask": 0xF2, "or_mask": 0x25}).ok
    assert loop.memory.read("M", "word", 504) == [0x17]


def test_writing_comes_before_reading() -> None:
    loop = guide_loop()
    arguments = {"address": 3, "count": 6, "write_address": 4, "values": bytes.fromhex("00 FF 00 FE 00 FD")}
    assert loop.do("call", "exchange_words", arguments).gives["values"].hex() == "000000ff00fe00fd00000000"


def test_the_state_of_a_device_is_served() -> None:
    loop = Loop("modbus-rtu")
    loop.device.set("exception_status", 0x6D)
    assert pdu(loop, b"\7") == b"\7\x6d"
    assert pdu(loop, b"\x11") == b"\x11\3\x66\x6b\1"
    assert pdu(loop, bytes.fromhex("08 00 00 A5 37")) == bytes.fromhex("08 00 00 A5 37")


TWO_WAYS = """
protocol: two_ways
extends: standard
groups:
  request: {from: client, head: [{const: STX}]}
  reply: {from: server, head: [{const: ACK}]}
frames:
  short: {group: request, body: [{const: 01}, {field: address, type: u16}]}
  long: {group: request, body: [{const: 02}, {field: address, type: u16}, {field: count, type: u8}]}
  values: {group: reply, body: [{const: 01}, {length: n, type: u8, of: [values]}, {data: values, size: n}]}
areas:
  D: {unit: word, size: 1000}
addresses:
  - {form: "{area}{start:dec}"}
services:
  peek:
    - {server_only: yes, request: {short: {address: 999}}, reply: {values: {values: h'07'}}}
  read:
    - {server_only: yes, areas: [D], request: {short: {address: start}}, reply: {values: {values: data}}}
    - {areas: [D], request: {long: {address: start, count: count}}, reply: {values: {values: data}}}
"""


def test_a_row_for_servers_only_is_answered_and_never_asked() -> None:
    loop = Loop(TWO_WAYS)
    loop.memory.write("D", "word", 5, [0x1234])
    assert loop.do("read", "D5").values == [0x1234]
    assert loop.log[0][0] == bytes.fromhex("02 02 00 05 01")
    assert loop.serve(FrameValue("short", {"address": 5})).reply.fields["values"] == b"\x12\x34"
    assert loop.serve(FrameValue("short", {"address": 999})).reply.fields["values"] == b"\x07"
    with pytest.raises(ServiceError, match="no service 'peek'"):
        loop.do("call", "peek")


# ---- rows that speak of their items, their unit, or a layout -----------------------------------------------------


LIST_OF_PLACES = """\
protocol: list_of_places
extends: standard
groups: {request: {from: client}}
frames:
  ask:
    group: request
    body:
      - const: STX
      - {count: n, type: u8, of: items}
      - {repeat: items, times: n, of: [{field: area, type: u8}, {field: at, type: u16}]}
  back:
    from: server
    body:
      - const: ACK
      - {count: n, type: u8, of: items}
      - {repeat: items, times: n, of: [{field: area, type: u8}, {field: at, type: u16}, {data: data, size: SIZE}]}
areas: {D: {unit: word, size: 100, code: 7}, C: {unit: word, size: 100, code: 8}}
addresses: [{form: "{area}D{start:dec}", unit: dword}, {form: "{area}{start:dec}"}]
services:
  read:
    - areas: [D, C]
      units: [UNIT]
      variables: {max: 8, same: unit}
      limit: {count: 1}
      request: {ask: {items: {each: {area: code, at: PLACE}}}}
      reply: {back: {items: {each: {area: code, at: start, data: data}}}}
"""


def list_of_places(unit: str, size: int, place: str) -> Loop:
    return Loop(LIST_OF_PLACES.replace("UNIT", unit).replace("SIZE", str(size)).replace("PLACE", place))


def test_every_item_of_a_reply_has_the_names_of_its_own_place() -> None:
    loop = list_of_places("word", 2, "start")
    loop.memory.write("D", "word", 60, [0x1234])
    loop.memory.write("C", "word", 3, [7])
    assert loop.do("read_variables", ["D60", "C3"]).values == [0x1234, 7]
    assert loop.log[0][1] == bytes.fromhex("06 02 07 003C 1234 08 0003 0007")
    assert loop.troubles == []


def test_a_row_counts_in_its_own_unit_when_it_is_served() -> None:
    loop = list_of_places("dword", 4, "start * 2")
    loop.memory.write("D", "word", 4, [0x5678, 0x1234])
    assert loop.do("read_variables", ["DD2", "CD0"]).values == [0x12345678, 0]
    assert loop.log[0][:2] == (
        bytes.fromhex("02 02 07 0004 08 0000"),
        bytes.fromhex("06 02 07 0002 12345678 08 0000 00000000"),
    )


HIDDEN_PLACES = LIST_OF_PLACES.replace("units: [UNIT]", "units: [word]").replace("SIZE", "2")
HIDDEN_PLACES = HIDDEN_PLACES.replace("at: PLACE}}}}", "at: start ^ 0x55}}}}\n      back: {each: {start: at ^ 0x55}}")


def test_what_back_says_of_each_item_is_worked_out_from_its_own_fields() -> None:
    loop = Loop(HIDDEN_PLACES)
    loop.memory.write("D", "word", 60, [0x1234])
    loop.memory.write("C", "word", 3, [7])
    assert loop.do("read_variables", ["D60", "C3", "D60"]).values == [0x1234, 7, 0x1234]
    assert loop.log[0][0] == bytes.fromhex("02 03 07 0069 08 0056 07 0069")
    assert loop.troubles == []


def test_the_fields_of_an_item_go_before_the_names_of_its_place() -> None:
    text = HIDDEN_PLACES.replace("{area: code, at:", "{area: area.name, at:").replace("area: code", "area: request.n")
    text = text.replace("D: {unit: word, size: 100, code: 7}", "D: {unit: word, size: 100, name: 7}")
    text = text.replace("C: {unit: word, size: 100, code: 8}", "C: {unit: word, size: 100, name: 8}")
    text = text.replace("back: {each: {", "back: {each: {area: \"'D' if area == 7 else 'C'\", ")
    loop = Loop(text)
    loop.memory.write("D", "word", 60, [0x1234])
    loop.memory.write("C", "word", 60, [7])
    assert loop.do("read_variables", ["D60", "C60"]).values == [0x1234, 7]


TWO_LISTS = """\
protocol: two_lists
extends: standard
groups: {request: {from: client}}
frames:
  ask:
    group: request
    body:
      - const: STX
      - {count: n, type: u8, of: places}
      - {repeat: places, times: n, of: [{field: at, type: u16}]}
      - {count: m, type: u8, of: values}
      - {repeat: values, times: m, of: [{data: data, size: 2}]}
  done: {from: server, body: [{const: ACK}]}
  no: {from: server, body: [{const: NAK}, {field: code, type: u8}]}
areas: {D: {unit: word, size: 100}}
addresses: [{form: "{area}{start:dec}"}]
errors: {frame: no, code: code, answer: {no: {code: code}}, memory: {unknown: 1, range: 2, access: 3, no_service: 4}}
services:
  write:
    - areas: [D]
      variables: {max: 8}
      limit: {count: 1}
      request: {ask: {places: {each: {at: start}}, values: {each: {data: data}}}}
      reply: {done: {}}
"""


def test_two_lists_of_a_request_speak_of_the_same_variables() -> None:
    loop = Loop(TWO_LISTS)
    loop.do("write_variables", ["D5", "D9"], [0x1111, 0x2222])
    assert loop.log[0][0] == bytes.fromhex("02 02 0005 0009 02 1111 2222")
    assert loop.memory.read("D", "word", 5, 1) == [0x1111] and loop.memory.read("D", "word", 9, 1) == [0x2222]
    assert loop.answer(bytes.fromhex("02 02 0005 0009 01 1111")) == bytes.fromhex("15 04"), "a value is missing"


RANGES = """\
protocol: ranges
extends: standard
order: little
station: {type: none}
layouts:
  range: [{field: start, type: u8}, {field: count, type: u8}]
groups: {request: {from: client}}
frames:
  ask: {group: request, body: [{const: STX}, {length: n, type: u8, of: [objects]}, {data: objects, size: n}]}
  tell: {from: server, body: [{const: ACK}, {length: n, type: u8, of: [values]}, {data: values, size: n}]}
  no: {from: server, body: [{const: NAK}, {field: code, type: u8}]}
areas: {D: {unit: byte, size: 100}}
addresses: [{form: "D{start:dec}", area: D}]
errors: {frame: no, code: code, answer: {no: {code: code}}, memory: {unknown: 1, range: 2, access: 3, no_service: 4}}
services:
  read:
    - {areas: [D], request: {ask: {objects: {range: {start: start, count: count}}}}, reply: {tell: {values: data}}}
  all:
    - request: {ask: {objects: h'CA'}}
      serve: {read: {area: D, start: 0, count: 3}}
      reply: {tell: {values: data}}
      gives: {values: reply.values}
  none:
    - {request: {ask: {objects: h'CB 01 FF FF'}}, reply: {tell: {values: h''}}, gives: {values: reply.values}}
"""


def test_bytes_that_are_no_such_layout_are_left_to_later_rows() -> None:
    loop = Loop(RANGES)
    loop.memory.write("D", "byte", 0, [5, 6, 7, 8])
    assert loop.do("read", "D1", count=2).values == [6, 7]
    assert loop.do("call", "all").gives == {"values": bytes((5, 6, 7))}
    assert loop.do("call", "none").gives == {"values": b""}
    assert loop.answer(bytes.fromhex("02 01 CC")) == bytes.fromhex("15 02"), "the layout is cut off"
    assert loop.answer(bytes.fromhex("02 03 01 02 03")) == bytes.fromhex("15 02"), "the layout has no third byte"
    assert loop.troubles == []


# ---- a device with everything else: tests/data/rack.yaml -------------------------------------------------------------


def rack(**params: Any) -> Loop:
    return Loop("rack.yaml", params=params)


def frame(name: str, **fields: Any) -> FrameValue:
    return FrameValue(name, {"function": 0, **fields})


def test_small_data_travel_in_the_request_and_large_ones_beside_it() -> None:
    loop = rack()
    assert loop.do("write", "R5", [1, 2, 3]).ok and loop.do("write", "R8", list(range(9))).ok
    assert [served.reply.frame for _, _, served in loop.log if served.reply] == ["done", "done"]
    assert loop.do("read", "R5", count=3).values == [1, 2, 3]
    assert loop.do("read", "R5", count=12).values == [1, 2, 3, *range(9)]
    assert loop.log[2][2].reply_buffer == b"" and len(loop.log[3][2].reply_buffer) == 24


def test_conditions_hold_after_reading_backwards() -> None:
    loop = rack()
    large = frame("write", code=1, start=0, count=9, inline=b"\1" * 8)
    assert loop.serve(large, bytes(range(18))).refusal == 0
    assert loop.memory.read("R", "word", 0) == [0x0100]
    assert loop.serve(large, b"").refusal == 3
    assert loop.serve(large, bytes(17)).refusal == 3


def test_bytes_beside_a_request_are_never_dropped() -> None:
    loop = rack()
    small = frame("write", code=1, start=0, count=2, inline=b"\1" * 8)
    assert loop.serve(small, b"\7\0\x08\0").refusal == 0
    assert loop.memory.read("R", "word", 0, 2) == [7, 8]


def test_padding_of_a_request_is_cut() -> None:
    loop = rack()
    loop.memory.write("R", "word", 0, [9] * 4)
    assert loop.serve(frame("write", code=1, start=0, count=1, inline=b"\1\0\2\0\3\0\4\0")).refusal == 0
    assert loop.memory.read("R", "word", 0, 4) == [1, 9, 9, 9]


def test_judging_does_nothing_and_leaves_what_comes_later_out() -> None:
    loop = rack()
    served = loop.serve(frame("write", code=1, start=0, count=9, inline=bytes(8)), check=True)
    assert (served.refusal, served.reply) == (0, None)
    assert loop.serve(frame("write", code=1, start=2047, count=2, inline=bytes(8)), check=True).refusal == 3
    small = frame("write", code=1, start=0, count=1, inline=b"\1" * 8)
    assert loop.serve(small, check=True).refusal == 0 and loop.memory.read("R", "word", 0) == [0]


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (frame("read", code=99, start=0, count=1), 2),
        (frame("write", code=99, start=0, count=1, inline=bytes(8)), 2),
        (frame("write", code=5, start=0, count=1, inline=bytes(8)), 4),
        (frame("read", code=1, start=2048, count=1), 3),
        (frame("read", code=1, start=0, count=0), 3),
        (frame("read", code=0x31, start=15, count=2), 3),
        (frame("nothing"), 1),
        (frame("read", code=1, start=13, count=1), 0x22),
        (frame("read", code=99, start=13, count=1), 0x22),
        (FrameValue("read", {"code": 1}, refusal=0x77), 0x77),
    ],
)
def test_refusals_in_their_order(request_: FrameValue, code: int) -> None:
    loop = rack()
    served = loop.serve(request_)
    assert served.refusal == code and served.reply is not None and served.reply.fields["code"] == code
    assert loop.troubles == []


def test_single_points_are_read_backwards_by_hand() -> None:
    loop = rack()
    assert loop.do("write", "Q3", [1]).ok
    assert loop.requests[0].hex(" ") == "06 02 00 02 01"
    assert loop.memory.read("Q", "bit", 0, 4) == [0, 0, 1, 0]
    assert loop.do("write", "Q3", [0]).ok and loop.memory.read("Q", "bit", 0, 4) == [0] * 4


def test_bits_at_their_natural_place() -> None:
    loop = rack()
    assert loop.do("write", "Q3", [1, 0, 1, 1, 0, 1, 1]).ok
    assert loop.requests[0].hex(" ") == "02 21 00 02 07 b4 01" + " 00" * 6
    assert loop.do("read", "Q1", count=16).values == [0, 0, 1, 0, 1, 1, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0]


def test_an_area_of_state_is_built_at_every_read() -> None:
    loop = rack()
    loop.device.set("errors", 0x1234)
    assert loop.do("read", "STATUS0", count=4).values == [0x34, 0x12, 7, 0]
    loop.device.set("errors", 1)
    assert loop.do("read", "STATUS0").values == [1]
    assert loop.do("read", "FACTS1", count=3).values == [0, 0, 0]
    loop.device.set("facts", {"kind": 5, "size": 6})
    assert loop.do("read", "FACTS0", count=5).values == [5, 6, 0, 0, 0]
    assert loop.serve(frame("write", code=6, start=0, count=1, inline=bytes(8))).refusal == 4


def test_records_in_tables_are_made_changed_read_and_dropped() -> None:
    loop = rack()
    assert loop.do("call", "define", {"id": 3, "kind": 1}).gives == {"free": 1}
    assert loop.device["groups_"][3] == {"kind": 1, "points": []}
    points = [{"code": 1, "start": 2, "count": 2}, {"code": 0x21, "start": 3, "count": 5}]
    assert loop.do("call", "fill", {"id": 3, "points": points}).ok
    assert loop.device["groups_"][3] == {"kind": 1, "points": points}
    loop.memory.write("R", "word", 2, [0x1122, 0x3344])
    loop.memory.write("Q", "bit", 3, [1, 1, 1, 1, 1])
    assert loop.do("call", "collect", {"id": 3}).gives == {"data": bytes.fromhex("22 11 44 33 F8")}
    assert loop.do("call", "collect", {"id": 4}).code == 0x40
    loop.do("call", "define", {"id": 5, "kind": 2})
    assert loop.do("call", "remove", {"kind": 1}).ok and list(loop.device["groups_"]) == [5]


def test_a_damaged_buffer_is_refused_with_its_own_code_or_as_out_of_range() -> None:
    loop = rack()
    loop.do("call", "define", {"id": 3, "kind": 1})
    assert loop.serve(frame("fill", id=3), b"\3\1").refusal == 3
    assert loop.serve(frame("fill", id=3), b"\x09" + bytes(36)).refusal == 0x55


def test_several_places_are_changed_together_or_not_at_all() -> None:
    loop = rack()
    loop.memory.write("R", "word", 0, [0xFF, 0x0F, 0xF0])
    sets = [{"place": 0, "mask": 0x0F}, {"place": 2, "mask": 0x30}]
    assert loop.do("call", "clear_bits", {"sets": sets}).ok
    assert loop.memory.read("R", "word", 0, 3) == [0xF0, 0x0F, 0xC0]
    assert loop.do("call", "clear_bits", {"sets": [{"place": 1, "mask": 1}, {"place": 2048, "mask": 1}]}).code == 3
    assert loop.memory.read("R", "word", 1) == [0x0F]


def test_text_and_memory_areas_by_name() -> None:
    loop = rack()
    loop.memory.write("R", "word", 7, [0x0201])
    assert loop.do("call", "peek", {"where": "R7"}).gives == {"data": b"\1\2"}
    assert loop.do("call", "peek", {"where": "X7"}).code == 3
    loop.memory.write("store", "byte", 3, [9])
    assert loop.do("call", "poke", {"place": 3}).ok and loop.memory.read("store", "byte", 3) == [10]


def test_values_that_do_not_fit_the_state_are_refused_and_reported() -> None:
    loop = rack()
    assert loop.do("call", "tune", {"limit": 5}).ok and loop.device["limit_"] == 5
    assert loop.do("call", "tune", {"limit": 200}).code == 3
    assert loop.device["limit_"] == 5 and "tune" in loop.troubles[0]


def test_blocks_are_started_by_the_run() -> None:
    started: list[tuple[Any, Any, Any]] = []

    def start(block: CompiledBlock, names: Names) -> None:
        assert block.station is not None and block.read is not None and block.into is not None
        started.append((block.station(names), block.read.on(names), block.into.on(names)))

    loop = rack()
    assert loop.do("call", "start", {"what": 4}).code == 1
    loop.server.on_block = start
    assert loop.do("call", "start", {"what": 4}).ok
    assert started == [(4, {"area": "R", "start": 3}, {"area": "Q", "start": 0, "count": 16})]
    loop.server.on_block = lambda block, names: 0x66
    assert loop.do("call", "start", {"what": 4}).code == 0x66


# ---- there and back --------------------------------------------------------------------------------------------------


@given(
    st.sampled_from(["P", "M", "L", "D", "R", "ZR"]),
    st.sampled_from(["bit", "byte", "word", "dword", "lword"]),
    st.data(),
)
@settings(max_examples=60, deadline=None)
def test_what_the_ascii_protocol_writes_it_reads(area: str, unit: str, data: st.DataObject) -> None:
    there_and_back("mldp", area, unit, data)


@given(st.sampled_from(["coil", "holding"]), st.sampled_from(["bit", "word", "dword"]), st.data())
@settings(max_examples=60, deadline=None)
def test_what_modbus_writes_it_reads(area: str, unit: str, data: st.DataObject) -> None:
    there_and_back("modbus-rtu", area, "word" if area == "holding" and unit == "bit" else unit, data)


@given(st.sampled_from(["R", "Q"]), st.sampled_from(["bit", "word", "dword"]), st.data())
@settings(max_examples=60, deadline=None)
def test_what_the_rack_writes_it_reads(area: str, unit: str, data: st.DataObject) -> None:
    there_and_back("rack.yaml", area, "word" if area == "R" and unit == "bit" else unit, data)


loop_of = cache(Loop)


def there_and_back(name: str, area: str, unit: str, data: st.DataObject) -> None:
    loop = loop_of(name)
    model = loop.protocol.areas[area]
    bits = Address(area, unit, 0).unit_bits
    size = model.size * model.element_bits // bits
    count = data.draw(st.integers(1, min(size, 90)))
    start = data.draw(st.integers(0, size - count).filter(lambda start: (name, start) != ("rack.yaml", 13)))
    values = data.draw(st.lists(st.integers(0, (1 << bits) - 1), min_size=count, max_size=count))
    for place in loop.memory:
        place.write_bytes(0, bytes(place.size_bytes), force=True)
    written = loop.do("write", Address(area, unit, start), values)
    assert written.ok, written
    result = loop.do("read", Address(area, unit, start), count=count)
    assert result.ok and result.values == values
    assert loop.memory.read(area, unit, start, count) == values
    touched = sum(int.from_bytes(part).bit_count() for part in loop.memory.snapshot().values())
    assert touched == sum(value.bit_count() for value in values)
    assert loop.troubles == []


# ---- anything from the wire ------------------------------------------------------------------------------------------

SEEDS = {
    "mldp": [with_check(text) for _, text in MALFORMED],
    "modbus-rtu": [
        bytes.fromhex(t) for t in ("0300000001", "10000000020400010002", "0F000003010500", "1600000000FFFF")
    ],
    "rack.yaml": [
        bytes.fromhex(t) for t in ("0101000003", "0201000001" + "00" * 8, "0B03", "0C03", "0E00010001", "0F52370000")
    ],
}


@given(st.sampled_from(sorted(SEEDS)), st.data())
@settings(max_examples=150, deadline=None)
def test_no_request_gets_an_exception_out_of_a_server(name: str, data: st.DataObject) -> None:
    loop = loop_of(name)
    raw = bytearray(data.draw(st.sampled_from(SEEDS[name])))
    for _ in range(data.draw(st.integers(0, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    for frame_name in loop.protocol.frames_of("request"):
        try:
            request = loop.arrived(frame_name, bytes(raw))
        except FrameError:
            continue
        served = loop.serve(request, data.draw(st.binary(max_size=12)), check=data.draw(st.booleans()))
        assert served.refusal >= 0
        assert served.refusal == 0 or served.reply is not None


ABSENT = """\
protocol: absent
station: {type: none}
line: {kind: stream, tcp: 4000}
extends: standard
state: {seen: {scope: device, type: u16}, more: {scope: device, type: u8}}
groups: {request: {from: client}, reply: {from: server}}
frames:
  ask: {group: request, body: [{const: 01}, {length: n, type: u8, of: [a, part]}, {field: a, type: u8}, %s]}
  told:
    group: reply
    body: [{const: 02}, {field: c, type: u8}, {field: d, type: u8, default: 9}, {bits: {e: 0}, of: u8}]
services:
  put:
    - takes: {v: {type: number}}
      request: {ask: {a: v}}
      serve: {set: {seen: request.a, more: 'either(request.b, 3)'}}
      reply: {told: {c: more}}
"""


@pytest.mark.parametrize("content", ["{optional: [{field: b, type: u8}]}", "{field: b, type: u8, when: n == 2}"])
def test_a_field_that_is_absent_is_nothing_and_fields_not_given_have_their_default(content: str) -> None:
    """Absent in the values that a service sets, and in its reply; bits of the reply without a value are 0."""
    loop = Loop(ABSENT % f"{{wrap: none, name: part, size: n - 1, of: [{content}]}}")
    assert loop.answer(bytes.fromhex("01 01 05")).hex(" ") == "02 03 09 00"
    assert loop.answer(bytes.fromhex("01 02 05 06")).hex(" ") == "02 06 09 00"
    assert (loop.device["seen"], loop.device["more"], loop.troubles) == (5, 6, [])


def test_arithmetic_with_nothing_is_a_fault() -> None:
    text = (ABSENT % "{wrap: none, name: part, size: n - 1, of: [{optional: [{field: b, type: u8}]}]}").replace(
        "'either(request.b, 3)'", "request.b + 1"
    )
    loop = Loop(text)
    loop.serve(loop.request(bytes.fromhex("01 01 05")))
    assert len(loop.troubles) == 1
    assert loop.device["more"] == 0


@pytest.mark.parametrize(
    ("order", "packing", "unit", "data"),
    [
        ("order: big", "", "word", "12 34 56 78 9A BC"),  # words of data are numbers like all others
        ("", "", "word", "12 34 56 78 9A BC"),
        ("order: little", "", "word", "34 12 78 56 BC 9A"),
        ("order: big", "packing: {order: little}", "word", "34 12 78 56 BC 9A"),
        ("order: big", "packing: {bits: packed}", "word", "12 34 56 78 9A BC"),
        ("order: big", "", "6 bytes", "34 12 78 56 BC 9A"),  # not a number: unchanged
        ("order: big", "packing: {order: big}", "6 bytes", "9A BC 56 78 12 34"),
    ],
)
def test_words_have_the_byte_order_of_the_file(order: str, packing: str, unit: str, data: str) -> None:
    text = TWO_WAYS.replace("areas:\n  D: {unit: word,", f"{order}\nareas:\n  D: {{unit: {unit},")
    row = "request: {long: {address: start, count: count}}, "
    assert row in text
    loop = Loop(text.replace(row, row + packing + (", " if packing else "")))
    loop.memory.write_bytes("D", 0, bytes.fromhex("34 12 78 56 BC 9A"))
    count = 1 if unit == "6 bytes" else 3
    request = FrameValue("long", {"address": 0, "count": count})
    assert loop.serve(request).reply.fields["values"] == bytes.fromhex(data)
