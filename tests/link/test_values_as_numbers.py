# ruff: noqa: E501 - definitions in YAML
"""Elements as numbers in rows of read and write: registers in digits, decimal text, scaled numbers, lists."""

from __future__ import annotations

from decimal import Decimal
from random import Random
from struct import pack
from typing import Any

import pytest
from link.service_loop import Loop

from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError
from framekit.link.addresses import AddressError
from framekit.link.packing import PackingError, memory_of_numbers, numbers_of
from framekit.link.services.client import TransferResult

PROTOCOL = """
protocol: numbers
order: big
station: {type: none}
groups:
  request: {from: client, head: [{const: 02}, {field: kind, type: ascii, size: 1}], tail: [{const: 03}]}
  reply: {from: server, head: [{const: 06}], tail: [{const: 03}]}
layouts:
  many: [{count: n, type: dec, size: 2, of: list}, {repeat: list, times: n, of: decimal, size: 6}]
frames:
  READ: {group: request, where: {kind: R}, body: [{field: area, type: ascii, size: 1}, {field: at, type: dec, size: 3}]}
  WRITE: {group: request, where: {kind: W}, body: [{field: area, type: ascii, size: 1}, {field: at, type: dec, size: 3}, {field: v, type: decimal, size: 8, decimals: 1, sign: always}]}
  VALUE: {group: reply, body: [{const: 31}, {field: v, type: decimal, size: 8, decimals: 1, sign: always}]}
  READ_MANY: {group: request, where: {kind: M}, body: [{field: at, type: dec, size: 3}, {field: n, type: dec, size: 2}]}
  WRITE_MANY: {group: request, where: {kind: N}, body: [{field: at, type: dec, size: 3}, {include: many}]}
  VALUES: {group: reply, body: [{const: 32}, {include: many}]}
  READ_LIST: {group: request, where: {kind: L}, body: [{count: n, type: dec, size: 2, of: items}, {repeat: items, times: n, of: [{field: at, type: dec, size: 3}]}]}
  WRITE_LIST: {group: request, where: {kind: K}, body: [{count: n, type: dec, size: 2, of: items}, {repeat: items, times: n, of: [{field: at, type: dec, size: 3}, {field: v, type: dec, size: 5}]}]}
  LIST: {group: reply, body: [{const: 33}, {count: n, type: dec, size: 2, of: items}, {repeat: items, times: n, of: [{field: v, type: dec, size: 5}]}]}
  DONE: {group: reply, body: [{const: 30}]}
  NO: {group: reply, body: [{const: 45}, {field: code, type: u8}]}
errors: {frame: NO, code: code, answer: {NO: {code: code}}, memory: {unknown: 1, range: 2, access: 3, value: 4, no_service: 5}}
areas:
  T: {unit: dword, size: 100, code: T, type: float32}
  I: {unit: word, size: 100, code: I, type: int16}
  B: {unit: word, size: 100, code: B, type: bcd16}
  D: {unit: word, size: 100, code: D}
  X: {unit: bit, size: 100, code: X}
addresses: [{form: "{area}{start:dec}"}]
services:
  read:
    - {areas: [T, I, B, X], limit: {count: 1}, request: {READ: {area: code, at: start}}, reply: {VALUE: {v: value}}}
    - {areas: [D], limit: {count: 4}, request: {READ_MANY: {at: start, n: count}}, reply: {VALUES: {list: values}}}
    - {areas: [D], variables: {max: 3}, limit: {count: 1}, request: {READ_LIST: {items: {each: {at: start}}}}, reply: {LIST: {items: {each: {v: value}}}}}
  write:
    - {areas: [T, I, B, X], limit: {count: 1}, request: {WRITE: {area: code, at: start, v: value}}, reply: {DONE: {}}}
    - {areas: [D], limit: {count: 4}, request: {WRITE_MANY: {at: start, list: values}}, reply: {DONE: {}}}
    - {areas: [D], variables: {max: 3}, limit: {count: 1}, request: {WRITE_LIST: {items: {each: {at: start, v: value}}}}, reply: {DONE: {}}}
"""


def test_a_register_in_decimal_text() -> None:
    loop = Loop(PROTOCOL)
    assert loop.do("write", "I7", [-12 & 0xFFFF]).ok and loop.do("read", "I7").values == [0xFFF4]
    assert [wire for wire, _, _ in loop.log] == [b"\2WI007-00012.0\3", b"\2RI007\3"]
    assert loop.log[1][1] == b"\0061-00012.0\3"
    number = pack("<f", 12.3)
    assert loop.do("write", "T1", [int.from_bytes(number, "little")]).ok
    assert loop.memory.read("T", "dword", 1, 1) == [int.from_bytes(number, "little")]
    assert loop.do("read", "T1").data == number and loop.log[-1][1] == b"\0061+00012.3\3"
    assert loop.do("write", "B2", [0x1234]).ok and loop.log[-1][0] == b"\2WB002+01234.0\3"
    assert loop.do("read", "B2").values == [0x1234]
    assert loop.do("write", "X3", [1]).ok and loop.do("read", "X3").values == [1]


def test_lists_of_registers() -> None:
    loop, random = Loop(PROTOCOL), Random(3)
    values = [random.randrange(10000) for _ in range(10)]
    assert loop.do("write", "D5", values).ok and loop.do("read", "D5", count=10).values == values
    assert len(loop.log) == 6 and loop.log[0][0].startswith(b"\2N00504")
    assert loop.do("read_variables", ["D5", "D9", "D7", "D14"]).values == [values[at] for at in (0, 4, 2, 9)]
    assert loop.log[6][0] == b"\2L03005009007\3"
    assert loop.do("write_variables", ["D20", "D22"], [7, 65535]).ok
    assert loop.log[-1][0] == b"\2K020200000702265535\3"
    assert loop.memory.read("D", "word", 20, 3) == [7, 0, 65535]


def test_what_does_not_fit_is_refused_on_both_sides() -> None:
    loop = Loop(PROTOCOL)
    assert loop.answer(b"\2WI007+00012.5\3") == b"\006E\4\3"  # a fraction in a whole number
    assert loop.answer(b"\2WI007+40000.0\3") == b"\006E\4\3"
    assert loop.answer(b"\2WX007+00002.0\3") == b"\006E\4\3"
    assert loop.answer(b"\2WI100+00001.0\3") == b"\006E\2\3"
    assert loop.memory.read("I", "word", 7, 1) == [0]

    def damaged(value: Any) -> TransferResult:
        def change(reply: Any) -> Any:
            reply.fields["v" if "v" in reply.fields else "list"] = value
            return reply

        loop.damage = change
        return loop.do("read", "D0", count=2) if isinstance(value, list) else loop.do("read", "I0")

    for value, cause in (
        (Decimal("0.5"), "0.5 is no whole number, as a int16 is"),
        (40000, "40000 does not fit into"),
        (None, "a value is not there"),
    ):
        result = damaged(value)
        assert (result.ok, result.outcome) == (False, "unfit_reply") and cause in result.cause
    assert "the reply has 3 values, not 2" in damaged([1, 2, 3]).cause
    assert damaged([1, 70000]).outcome == "unfit_reply"


def test_numbers_and_memory() -> None:
    random = Random(5)
    for unit, kind, numbers in (
        ("word", None, (0, 65535)), ("word", "int16", (-32768, 32767)), ("dword", "int32", (-1, 5)), ("word", "bcd16", (0, 9999)),
        ("dword", "float32", (12.3, -0.1, 3.4028235e38, float("inf"))), ("lword", "float64", (0.1,)), ("bit", None, (0, 1, 1)),
        ("dword", "int16", (4294967295,)), ("6 bytes", None, (1 << 47,)),
    ):  # fmt: skip
        memory = memory_of_numbers(numbers, unit, kind)
        assert numbers_of(memory, unit, kind, len(numbers)) == list(numbers)
    for _ in range(2000):
        memory = random.randbytes(4)
        if memory[3] & 0x7F != 0x7F or memory[2] < 0x80:  # no NaN
            assert memory_of_numbers(numbers_of(memory, "dword", "float32", 1), "dword", "float32") == memory
    with pytest.raises(PackingError):
        numbers_of(b"\x0a\0", "word", "bcd16", 1)
    for wrong in (float("nan"), "5", None, Decimal("0.1")):
        with pytest.raises(PackingError):
            memory_of_numbers([wrong], "word", None)
    for too_large in ("5", None, Decimal("1e40"), Decimal("1e400"), 10**39, 1 << 2040):
        with pytest.raises(PackingError):
            memory_of_numbers([too_large], "dword", "float32")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("{VALUE: {v: value}}", "{VALUE: {v: data}}", "a number is wanted here, 'data' is bytes – write value, which is the element as a number"),
        ("{VALUE: {v: value}}", "{VALUE: {v: values}}", "a number is wanted here, 'values' is a list"),
        ("{VALUES: {list: values}}", "{VALUES: {list: data}}", "'data' is bytes, and 'list' of 'VALUES' is a list – write values, or data: list with a size"),
        ("{LIST: {items: {each: {v: value}}}}", "{LIST: {items: values}}", "'values' are numbers, and the items of 'items' of 'LIST' are records – write of: TYPE in the list, beside separator"),
        ("{VALUES: {list: values}}", "{VALUES: {list: {each: {v: value}}}}", "each: makes records, and the items of 'list' of 'VALUES' are plain values – write values"),
        ("{VALUE: {v: value}}", "{VALUE: {v: start}}", "nothing says where the data of the reply stand"),
    ],
)  # fmt: skip
def test_check_tells_what_to_write(old: str, new: str, message: str) -> None:
    assert old in PROTOCOL
    with pytest.raises(DefinitionError, match=message):
        load_protocol_text(PROTOCOL.replace(old, new, 1), "numbers")


SEPARATED = """
protocol: separated
order: big
station: {type: none}
groups: {request: {from: client, tail: [{const: 0D}]}}
layouts: {listed: [{repeat: list, times: rest, align: 4, between: yes, fill: 20, of: dec, size: 3}]}
frames:
  READ:   {group: request, body: [{text: R}, {field: at, type: decimal, end: 20}, {field: n, type: decimal, end: [0D]}]}
  WRITE:  {group: request, body: [{text: W}, {field: at, type: decimal, end: 20}, {repeat: list, times: rest, separator: 20, of: decimal, end: [20, 0D]}]}
  ASK:    {group: request, body: [{text: A}, {field: at, type: decimal, end: 20}, {field: n, type: decimal, end: [0D]}]}
  PUT:    {group: request, body: [{text: P}, {field: at, type: decimal, end: 20}, {include: listed}]}
  VALUES: {from: server, body: [{repeat: list, times: rest, separator: 20, of: dec, size: 5}, {const: 0D 0A}]}
  LISTED: {from: server, body: [{text: L}, {include: listed}, {const: 0D 0A}]}
  DONE:   {from: server, body: [{const: 06}]}
  NO:     {from: server, body: [{const: 15}, {field: code, type: u8}]}
errors: {frame: NO, code: code, answer: {NO: {code: code}}, memory: {unknown: 1, range: 2, access: 3, value: 4, no_service: 5}}
areas: {D: {unit: word, size: 100}, S: {unit: byte, size: 100}}
addresses: [{form: "{area}{start:dec}"}]
services:
  read:
    - {areas: [D], limit: {count: 9}, request: {READ: {at: start, n: count}}, reply: {VALUES: {list: values}}}
    - {areas: [S], limit: {count: 9}, request: {ASK: {at: start, n: count}}, reply: {LISTED: {list: values}}}
  write:
    - {areas: [D], limit: {count: 9}, request: {WRITE: {at: start, list: values}}, reply: {DONE: {}}}
    - {areas: [S], limit: {count: 9}, request: {PUT: {at: start, list: values}}, reply: {DONE: {}}}
"""


def test_values_with_bytes_between_them() -> None:
    loop, random = Loop(SEPARATED), Random(4)
    values = [random.randrange(65536) for _ in range(12)]
    assert loop.do("write", "D5", values).ok and loop.do("read", "D5", count=12).values == values
    assert loop.requests[0] == b"W5 " + b" ".join(b"%d" % value for value in values[:9]) + b"\r"
    assert loop.log[2][1] == b" ".join(b"%05d" % value for value in values[:9]) + b"\r\n"
    assert loop.do("write", "S5", [1, 200, 30]).ok and loop.do("read", "S5", count=3).values == [1, 200, 30]
    assert loop.log[-2][0] == b"P5 001 200 030\r" and loop.log[-1][1] == b"L001 200 030\r\n"
    assert loop.answer(b"W5 70000\r") == b"\x15\4" and loop.memory.read("D", "word", 5, 1) == values[:1]
    assert loop.answer(b"W98 1 2 3\r") == b"\x15\2" and loop.answer(b"P5 300\r") == b"\x15\4"


TEXTS = """
protocol: texts
order: big
station: {type: none}
groups: {request: {from: client, tail: [{const: 0D}]}}
frames:
  READ:  {group: request, body: [{text: R}, {field: place, type: ascii, end: 20}, {field: n, type: decimal, end: [0D]}]}
  WORDS: {from: server, body: [{repeat: list, times: rest, separator: 20, of: decimal, sign: always, end: [20, 0D]}, {const: 0D 0A}]}
  BITS:  {from: server, body: [{text: B}, {repeat: list, times: rest, of: dec, size: 1}, {const: 0D 0A}]}
areas: {D: {unit: word, size: 100}, R: {unit: bit, size: 320}}
addresses:
  - {form: "D{start:dec}.U", area: D, case: any, wire: yes}
  - {form: "D{start:dec}.S", area: D, unit: word, type: int16, case: any, wire: yes}
  - {form: "D{start:dec}", area: D, case: any}
  - {form: "R{c:dec:1-3}{b:dec:2}", area: R, start: c * 16 + b, wire: yes}
services:
  read:
    - {areas: [D], limit: {count: 2}, request: {READ: {place: text, n: count}}, reply: {WORDS: {list: values}}}
    - {areas: [R], limit: {count: 9}, request: {READ: {place: text, n: count}}, reply: {BITS: {list: values}}}
"""


def test_text_keeps_the_form_of_the_address() -> None:
    """If several forms describe a place, `text` has the given form, also for the places after the first."""
    loop = Loop(TEXTS)
    loop.memory.write("D", "word", 7, [1, 0xFFFE, 3])
    assert loop.do("read", "D7.S", count=3).values == [1, 0xFFFE, 3] and loop.do("read", "d8.s").ok
    assert loop.requests == [b"RD7.S 2\r", b"RD9.S 1\r", b"RD8.S 1\r"]
    assert loop.log[0][1] == b"+1 -2\r\n"
    assert loop.do("read", "D8.U").ok and loop.do("read", "D8").ok  # not on the wire: the first form is used
    assert loop.requests[3:] == [b"RD8.U 1\r"] * 2


def test_text_of_a_start_that_two_parts_make() -> None:
    """The text is the given address, for a request of exactly that place."""
    loop = Loop(TEXTS)
    loop.memory.write("R", "bit", 17, [1])
    assert loop.do("read", "R101", count=3).values == [1, 0, 0] and loop.requests == [b"RR101 3\r"]
    with pytest.raises(AddressError, match="bit 26 of R cannot be written in any of these forms"):
        loop.do("read", "R101", count=10)
    assert len(loop.requests) == 1


def test_numbers_of_addresses_have_ranges() -> None:
    loop = Loop(TEXTS.replace("start: c * 16 + b,", "start: c * 16 + b, range: {b: 0..15},"))
    loop.memory.write("R", "bit", 30, [1, 0, 1, 1])
    assert loop.do("read", "R114", count=4).values == [1, 0, 1, 1] and loop.requests == [b"RR114 4\r"]
    assert loop.do("read", "R110", count=18).ok and loop.requests[1:] == [b"RR110 9\r", b"RR203 9\r"]
    for text in ("R199", "R116"):
        with pytest.raises(
            AddressError, match=f"'{text}' is not an address: b is {text[2:]} in it, and can be 0 to 15"
        ):
            loop.do("read", text)
    served = loop.serve(loop.request(b"RR199 1\r"))
    assert served.reply is None and served.refusal
    assert [loop.client.shared.grammar.parse(text).start for text in ("R000", "R015", "R100", "R1915")] == [
        0,
        15,
        16,
        319,
    ]


FORMS = """
protocol: forms
order: big
station: {type: none}
groups: {request: {from: client, tail: [{const: 0D}]}}
frames:
  READ:   {group: request, body: [{text: R}, {field: place, type: ascii, end: [0D]}]}
  WRITE:  {group: request, body: [{text: W}, {field: place, type: ascii, end: 20}, {field: v, type: decimal, decimals: any, end: [0D]}]}
  ASK:    {group: request, body: [{text: A}, {field: at, type: dec, size: 2}]}
  SET:    {group: request, body: [{text: S}, {field: at, type: dec, size: 2}, {field: v, type: decimal, end: [0D]}]}
  MANY:   {group: request, body: [{text: M}, {repeat: places, times: rest, separator: 2C, of: [{field: place, type: ascii, end: [2C, 0D]}]}]}
  VALUE:  {from: server, body: [{field: v, type: decimal, decimals: any, end: [0D]}, {const: 0D 0A}]}
  VALUES: {from: server, body: [{text: V}, {repeat: list, times: rest, separator: 2C, of: [{field: v, type: decimal, decimals: any, end: [2C, 0D]}]}, {const: 0D 0A}]}
  DONE:   {from: server, body: [{const: 06}]}
  NO:     {from: server, body: [{const: 15}, {field: code, type: u8}]}
errors: {frame: NO, code: code, answer: {NO: {code: code}}, memory: {unknown: 1, range: 2, access: 3, value: 4, no_service: 5}}
areas: {D: {unit: word, size: 100}, T: {unit: word, size: 50}}
addresses:
  - {form: "D{start:dec}", area: D, wire: yes}
  - {form: "D{start:dec}.S", area: D, unit: word, type: int16, wire: yes}
  - {form: "D{start:dec}.F", area: D, unit: dword, counts: word, type: float32, wire: yes}
  - {form: "T{start:dec}", area: T, unit: word, type: int16}
services:
  read:
    - {areas: [D], server_only: yes, request: {READ: {place: text}}, back: {count: 1}, reply: {VALUE: {v: value}}}
    - {areas: [D], server_only: yes, variables: {max: 9}, request: {MANY: {places: {each: {place: text}}}}, back: {each: {count: 1}}, reply: {VALUES: {list: {each: {v: value}}}}}
    - {areas: [T], limit: {count: 1}, request: {ASK: {at: start}}, reply: {VALUE: {v: value}}}
  write:
    - {areas: [D], server_only: yes, request: {WRITE: {place: text, v: value}}, reply: {DONE: {}}}
    - {areas: [T], limit: {count: 1}, request: {SET: {at: start, v: value}}, reply: {DONE: {}}}
"""


def test_a_server_takes_and_gives_numbers_as_the_form_of_the_address_says() -> None:
    loop = Loop(FORMS)
    assert loop.answer(b"WD7.S -2\r") == b"\6" and loop.memory.read("D", "word", 7, 1) == [0xFFFE]
    assert loop.answer(b"RD7.S\r") == b"-2\r\n" and loop.answer(b"RD7\r") == b"65534\r\n"
    assert loop.answer(b"WD8.F 12.5\r") == b"\6" and loop.answer(b"RD8.F\r") == b"12.5\r\n"
    assert loop.answer(b"MD7,D7.S,D8.F\r") == b"V65534,-2,12.5\r\n"
    assert loop.answer(b"WD7.S 40000\r") == b"\x15\4" and loop.answer(b"WD7 -40000\r") == b"\x15\4"
    assert loop.do("write", "T3", [0xFFFD]).ok and loop.requests[-1] == b"S03-3\r"  # every address of T says int16
    assert loop.do("read", "T3").values == [0xFFFD] and loop.log[-1][1] == b"-3\r\n"


def test_double_words_at_odd_words() -> None:
    """A place between two elements of its unit is requested by its text, on both sides."""
    loop = Loop(FORMS.replace("server_only: yes, request: {READ", "limit: {count: 1}, request: {READ").replace(
        "server_only: yes, request: {WRITE", "limit: {count: 1}, request: {WRITE"
    ))  # fmt: skip
    wire = int.from_bytes(pack("<f", 12.5), "little")
    assert loop.do("write", "D9.F", [wire, 0]).ok and loop.do("read", "D9.F").values == [wire]
    assert loop.requests == [b"WD9.F 12.5\r", b"WD11.F 0\r", b"RD9.F\r"]
    assert loop.memory.read("D", "word", 8, 4) == [0, wire & 0xFFFF, wire >> 16, 0]
    assert loop.answer(b"MD8.F,D9.F,D10\r").endswith(b",12.5,16712\r\n")
    assert loop.answer(b"WD97.F 1\r") == b"\6" and loop.answer(b"RD97.F\r") == b"1\r\n"
    for beyond in (b"RD99.F\r", b"WD99.F 1\r"):
        assert loop.answer(beyond) == b"\x15\2"
    with pytest.raises(AddressError):
        loop.do("read", "D99.F")


WORKED_OUT = """
protocol: worked_out
order: big
station: {type: none}
groups: {request: {from: client, head: [{const: 02}]}}
frames:
  ONE:   {group: request, body: [{text: O}, {field: at, type: u8}, {field: v, type: decimal, end: 0D, decimals: any}]}
  TEN:   {group: request, body: [{text: T}, {field: at, type: u8}, {field: v, type: u32}]}
  PAIRS: {group: request, body: [{text: P}, {field: at, type: u8}, {repeat: pairs, times: rest, of: [{field: x, type: u16}, {field: y, type: u8}]}]}
  ITEMS: {group: request, body: [{text: I}, {count: n, type: u8, of: items}, {repeat: items, times: n, of: [{field: at, type: u8}, {field: v, type: u8}]}]}
  DONE:  {from: server, body: [{const: 06}]}
  NO:    {from: server, body: [{const: 15}, {field: code, type: u8}]}
errors: {frame: NO, code: code, answer: {NO: {code: code}}, memory: {unknown: 1, range: 2, access: 3, value: 4, no_service: 5}}
areas: {D: {unit: word, size: 100}, S: {unit: word, size: 100, type: int16}, F: {unit: dword, type: float32, size: 10}, B: {unit: byte, size: 50}}
addresses: [{form: "{area}{start:dec}"}]
services:
  write:
    - {areas: [D], when: count == 1, limit: {count: 1}, request: {ONE: {at: start, v: "value - (value >> 15) * 65536"}}, back: {value: "request.v if request.v >= 0 else request.v + 65536"}, reply: {DONE: {}}}
    - {areas: [F], limit: {count: 1}, request: {TEN: {at: start, v: "value * 10 if value > 0 else 0"}}, back: {value: request.v // 10}, reply: {DONE: {}}}
    - {areas: [S], server_only: yes, request: {PAIRS: {at: start}}, back: {values: request.pairs.x}, reply: {DONE: {}}}
    - {areas: [B], variables: {max: 9}, limit: {count: 1}, request: {ITEMS: {items: {each: {at: start, v: value ^ 0xFF}}}}, back: {each: {value: v ^ 0xFF}}, reply: {DONE: {}}}
"""


def test_what_is_worked_out_of_elements_is_read_backwards() -> None:
    """`value` and `values` of `back`, for a single place and for each item."""
    loop = Loop(WORKED_OUT)
    for number in (0, 1, 0x7FFF, 0x8000, 0xFFFE):
        assert loop.do("write", "D7", [number]).ok and loop.memory.read("D", "word", 7, 1) == [number]
    assert loop.requests[-1] == b"\2O\x07-2\r"
    assert loop.answer(b"\2T\3\0\0\0\x78") == b"\6"
    assert loop.memory.read("F", "dword", 3, 1) == [int.from_bytes(pack("<f", 12.0), "little")]
    assert loop.answer(b"\2P\5\0\7\0\0\x08\0") == b"\6" and loop.memory.read("S", "word", 5, 2) == [7, 8]
    assert loop.do("write_variables", ["B3", "B9"], [7, 255]).ok and loop.requests[-1] == b"\2I\2\3\xf8\x09\0"
    assert [loop.memory.read("B", "byte", at, 1) for at in (3, 9)] == [[7], [255]]


def test_wrong_values_of_back_are_refused() -> None:
    loop = Loop(WORKED_OUT)
    assert loop.answer(b"\2O\x07-40000\r") == b"\6"  # the row computes 25536
    assert loop.answer(b"\2O\x0770000\r") == loop.answer(b"\2O\x071.5\r") == b"\x15\4"
    assert loop.answer(b"\2P\5\xff\xff\0") == b"\x15\4"  # int16 holds no 65535
    assert loop.answer(b"\2P\x63\0\1\0\0\1\0") == b"\x15\2"
    assert loop.answer(b"\2I\2\3\xf8\x60\0") == b"\x15\2" and loop.memory.read("B", "byte", 3, 1) == [0]
    assert loop.memory.read("S", "word", 5, 1) == [0]
