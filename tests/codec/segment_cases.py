"""Cases for every kind of segment and every option: YAML, values and bytes.

Both compilers are tested with them, and the pages of `docs/segments` are generated from them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any


@dataclass(frozen=True, slots=True)
class Case:
    """A body, values to build it from, the bytes, and the additional values of decoding.

    `bad` maps bytes that are not this frame to the cause. `top` is YAML before `frames:`, `keys` are keys of the frame.
    """

    title: str
    body: str
    values: dict[str, Any]
    data: str
    more: dict[str, Any] = field(default_factory=dict)
    bad: dict[str, str] = field(default_factory=dict)
    top: str = ""
    keys: str = ""

    @property
    def yaml(self) -> str:
        """Return a protocol whose only frame `f` has this body."""
        lines = [f"      {line}" for line in self.body.splitlines()]
        keys = f"    {self.keys}\n" if self.keys else ""
        return f"protocol: case\n{self.top}frames:\n  f:\n{keys}    body:\n" + "\n".join(lines) + "\n"

    @property
    def bytes(self) -> bytes:
        return bytes.fromhex(self.data)


KEYS = "params:\n  k: {type: bytes, size: 16, default: \"h'2B7E151628AED2A6ABF7158809CF4F3C'\"}\n"
"""The key of the examples of NIST SP 800-38A, F."""


def _text(text: str) -> str:
    return text.encode("ascii").hex(" ").upper()


SECTIONS: dict[str, tuple[Case, ...]] = {
    "Constants": (
        Case("hex bytes", "- const: 1B 54", {}, "1B 54", bad={"1B 55": "constant", "1B": "short", "1B 54 00": "surplus"}),
        Case("names of control characters", "- const: DLE STX", {}, "10 02"),
        Case("text", "- text: WR44", {}, "57 52 34 34"),
        Case("bytes that are not looked at", "- {skip: 3, fill: 20}", {}, "20 20 20"),
        Case("none of them", "- {field: a, type: u8}\n- {skip: 0}\n- {skip: 0, fill: 32, name: x}\n"
             "- {field: b, type: u8}\n- {skip: 0, fill: 32}\n- {check: sum8, over: a..x}", {"a": 1, "b": 2}, "01 02 01"),
    ),
    "Numbers": (
        Case("one byte", "- {field: a, type: u8}", {"a": 200}, "C8", bad={"": "short"}),
        Case("big-endian word (the default order)", "- {field: a, type: u16}", {"a": 0x1234}, "12 34"),
        Case("little-endian word", "- {field: a, type: u16, order: little}", {"a": 0x1234}, "34 12"),
        Case("double word ABCD", "- {field: a, type: u32, order: ABCD}", {"a": 0x0A0B0C0D}, "0A 0B 0C 0D"),
        Case("double word DCBA", "- {field: a, type: u32, order: DCBA}", {"a": 0x0A0B0C0D}, "0D 0C 0B 0A"),
        Case("double word BADC", "- {field: a, type: u32, order: BADC}", {"a": 0x0A0B0C0D}, "0B 0A 0D 0C"),
        Case("double word CDAB", "- {field: a, type: u32, order: CDAB}", {"a": 0x0A0B0C0D}, "0C 0D 0A 0B"),
        Case("signed", "- {field: a, type: i16}", {"a": -2}, "FF FE"),
        Case("three bytes", "- {field: a, type: u24}", {"a": 0x010203}, "01 02 03"),
        Case("eight bytes", "- {field: a, type: u64, order: little}", {"a": 1}, "01 00 00 00 00 00 00 00"),
        Case("float", "- {field: a, type: f32}", {"a": 1.5}, "3F C0 00 00"),
        Case("float, words swapped", "- {field: a, type: f32, order: CDAB}", {"a": 1.5}, "00 00 3F C0"),
        Case("double float", "- {field: a, type: f64}", {"a": -2.0}, "C0 00 00 00 00 00 00 00"),
        Case(
            "a number of computed size", "- {field: n, type: u8}\n- {field: a, type: uint, size: n}",
            {"n": 3, "a": 0x010203}, "03 01 02 03",
        ),
    ),
    "Numbers as digits": (
        Case("hex digits", "- {field: a, type: hex, size: 4}", {"a": 0x2F}, "30 30 32 46", bad={"30 30 32 47": "digits"}),
        Case("hex digits in lower case", "- {field: a, type: hex, size: 2, case: lower}", {"a": 0xAB}, "61 62"),
        Case("hex digits, last byte's first", "- {field: a, type: hex, size: 4, order: little}", {"a": 0x0A}, "30 41 30 30"),
        Case("decimal digits", "- {field: a, type: dec, size: 5}", {"a": 420}, "30 30 34 32 30"),
        Case("octal digits", "- {field: a, type: oct, size: 3}", {"a": 8}, "30 31 30"),
        Case("BCD", "- {field: a, type: bcd, size: 2}", {"a": 1299}, "12 99", bad={"12 9A": "digits"}),
    ),
    "Numbers as decimal text": (
        Case("a whole number", "- {field: a, type: decimal, size: 4}", {"a": -42}, _text("-042"),
             bad={_text(" -42"): "digits", _text("+042"): "digits", _text("-0.4"): "digits", _text("-000"): "digits"}),
        Case("filled up with spaces", "- {field: a, type: decimal, size: 5, pad: 20}", {"a": -42}, _text("  -42"),
             bad={_text("-0042"): "digits", _text("     "): "digits"}),
        Case("without a sign", "- {field: a, type: decimal, size: 3, sign: never}", {"a": 7}, _text("007"),
             bad={_text("-07"): "digits"}),
        Case("always with a sign, and digits behind the point",
             "- {field: a, type: decimal, size: 6, sign: always, decimals: 1}", {"a": Decimal("12.5")}, _text("+012.5"),
             bad={_text("0012.5"): "digits", _text("+12.50"): "digits"}),
        Case("a space in place of the plus", "- {field: a, type: decimal, size: 6, sign: space, decimals: 2}",
             {"a": Decimal("2.50")}, _text(" 02.50")),
        Case("up to an end", "- {field: a, type: decimal, end: 2C}\n- {field: b, type: u8}", {"a": 1200, "b": 1},
             _text("1200,") + " 01", bad={_text("01200,") + " 01": "digits", _text("1200"): "short"}),
        Case("with so many digits before the point", "- {field: a, type: decimal, digits: 4, decimals: 3, end: 0D 0A}",
             {"a": Decimal("807.038")}, _text("0807.038\r\n"), bad={_text("807.038\r\n"): "digits"}),
        Case("with as many decimals as the value has", "- {field: a, type: decimal, decimals: any, end: 2C}",
             {"a": Decimal("12.50")}, _text("12.50,"), bad={_text("12.,"): "digits"}),
        Case("a point without digits behind it", "- {field: a, type: decimal, decimals: any, point: always, end: 2C}\n"
             "- {field: b, type: decimal, point: always, size: 4}", {"a": Decimal("16.4"), "b": Decimal(-16)},
             _text("16.4,-16."), bad={_text("16,-16."): "digits"}),
        Case("an exponent", "- {field: a, type: decimal, decimals: 3, exponent: 2, sign: always, end: 0A}",
             {"a": Decimal("-0.0125")}, _text("-1.250E-02\n"), bad={_text("-12.50E-03\n"): "digits"}),
        Case("no text at all is nothing", "- {field: a, type: decimal, decimals: 1, empty: yes, end: 2C}\n"
             "- {field: b, type: decimal, decimals: 1, empty: yes, end: 2C}", {"a": None, "b": Decimal("0.5")},
             _text(",0.5,")),
        Case("one of several ends, which is part of what follows",
             "- {field: a, type: decimal, end: [2C, 2A]}\n- {field: mark, type: ascii, size: 1}",
             {"a": 12, "mark": "*"}, _text("12*"), bad={_text("12"): "short"}),
        Case("a float as hex digits of its bytes", "- {field: a, type: f32, as: hex}", {"a": 1.5}, _text("3FC00000"),
             bad={_text("3FC0000G"): "digits"}),
        Case("a signed number as hex digits", "- {field: a, type: i16, as: hex, case: lower, order: little}", {"a": -2},
             _text("feff")),
    ),
    "Texts and bytes": (
        Case("text up to one of several bytes, which follows it",
             "- {field: a, type: ascii, end: [2C, 2A]}\n- {field: mark, type: ascii, size: 1}",
             {"a": "abc", "mark": ","}, _text("abc,")),
        Case("text up to CR LF or LF, and which of them it is",
             "- {field: a, type: ascii, end: [0D 0A, 0A]}\n- {field: ending, type: u8, default: 13}\n- {const: 0A, when: ending == 13}",
             {"a": "a\rb"}, "61 0D 62 0D 0A", {"ending": 13}, {"61 0D": "short"}),
        Case("a number up to one of several ends of two bytes",
             "- {field: a, type: decimal, decimals: any, end: [20 6D, 20 6B]}\n- {text: ' k'}\n- {field: b, type: u8}",
             {"a": Decimal("1.5"), "b": 0x2E}, _text("1.5 k."), bad={_text("1.5 m."): "constant", _text("1.5 x."): "short"}),
        Case("text of fixed size", "- {field: a, type: ascii, size: 3}", {"a": "abc"}, "61 62 63"),
        Case("text filled up", "- {field: a, type: ascii, size: 5, pad: 20}", {"a": "abc"}, "61 62 63 20 20"),
        Case("text with an end", "- {field: a, type: ascii, end: 00}\n- const: 05", {"a": "abc"}, "61 62 63 00 05"),
        Case("bytes as a value", "- {field: a, type: bytes, size: 3}", {"a": b"\x01\x02\x03"}, "01 02 03"),
    ),
    "What a field may say": (
        Case("a default", "- {field: a, type: u8, default: 7}", {}, "07", {"a": 7}),
        Case("defaults with a fraction",
             "- {field: a, type: i16, scale: 0.1, default: -0.5}\n- {field: b, type: f32, default: 0.5}\n"
             "- {field: c, type: u8}\n- {field: d, type: decimal, size: 4, decimals: 1, when: c == 1, default: 2.5}",
             {"c": 2}, "FF FB 3F 00 00 00 02", {"a": Decimal("-0.5"), "b": 0.5, "d": Decimal("2.5")}),
        Case("the item of a list whose field has a value",
             "- {field: wanted, type: u8}\n- {repeat: items, times: 2, of: [{field: id, type: u8}, {field: v, type: u8}]}\n"
             "- {field: v, type: u8, is: 'items[find(items.id, wanted)].v if wanted in items.id else 0'}",
             {"wanted": 3, "items": [{"id": 1, "v": 5}, {"id": 3, "v": 7}]}, "03 01 05 03 07 07", {"v": 7},
             {"03 01 05 03 07 08": "value", "04 01 05 03 07 07": "value"}),
        Case("the item of a list that is not there",
             "- {field: wanted, type: u8}\n- {repeat: items, times: 2, of: [{field: id, type: u8}, {field: v, type: u8}]}\n"
             "- {field: v, type: u8, is: 'either(items[find(items.id, wanted)].v, 9)'}",
             {"wanted": 4, "items": [{"id": 1, "v": 5}, {"id": 3, "v": 7}]}, "04 01 05 03 07 09", {"v": 9},
             {"04 01 05 03 07 08": "value", "03 01 05 03 07 09": "value"}),
        Case("always a number with a fraction", "- {field: a, type: f32, is: 0.1}\n- {field: b, type: u8, scale: 0.5, is: 1.5}",
             {}, "3D CC CC CD 03", {"a": 0.10000000149011612, "b": Decimal("1.5")}, {"3D CC CC CC 03": "value"}),
        Case("always computed", "- {field: a, type: u8}\n- {field: b, type: u8, is: a + 1}", {"a": 4}, "04 05", {"b": 5},
             {"04 06": "value"}),
        Case("computed unless given", "- {field: a, type: u8}\n- {field: b, type: u8, build: a * 2}", {"a": 4}, "04 08",
             {"b": 8}),
        Case("a range", "- {field: a, type: u8, range: 1..9}", {"a": 9}, "09", bad={"0A": "range"}),
        Case("names of numbers", "- {field: a, type: u8, values: {6: ACK, 0x15: NAK}}", {"a": "NAK"}, "15", {"a": 0x15}),
        Case("only these", "- {field: a, type: u8, values: {6: ACK, 0x15: NAK}, only: values}", {"a": 6}, "06",
             bad={"07": "value"}),
        Case("an offset", "- {field: a, type: u8, plus: 0x20}", {"a": 7}, "27"),
        Case("a scale", "- {field: a, type: i16, scale: 0.1}", {"a": Decimal("-12.5")}, "FF 83"),
        Case("a scale of seven places", "- {field: a, type: i32, scale: 0.0000001}", {"a": Decimal("-12.3456789")}, "F8 A4 32 EB"),
        Case("a scale and an offset", "- {field: a, type: u8, scale: 0.5, offset: -40}", {"a": Decimal("87.5")}, "FF"),
        Case("a scale of digits", "- {field: a, type: decimal, size: 4, scale: 0.01}", {"a": Decimal("-0.50")}, _text("-050")),
        Case("a list of scaled numbers", "- {repeat: a, times: 2, of: i16, scale: 0.1}",
             {"a": [Decimal("1.5"), Decimal("-0.2")]}, "00 0F FF FE"),
        Case("a list of numbers that always have a point",
             "- {repeat: a, times: 2, of: decimal, size: 4, pad: 20, point: always}", {"a": [Decimal(16), Decimal(-7)]},
             _text(" 16. -7.")),
        Case("a list of decimals", "- {repeat: a, times: 2, of: decimal, size: 5, decimals: 1, sign: always}",
             {"a": [Decimal("1.5"), Decimal("-0.2")]}, _text("+01.5-00.2")),
        Case("a time", "- {field: a, type: u16, unit: 10 ms}", {"a": 500_000_000}, "00 32"),
        Case("a long form", "- {field: a, type: u8, long: {mark: 0xFF, type: u16, order: little}}", {"a": 300}, "FF 2C 01"),
        Case("the same, short", "- {field: a, type: u8, long: {mark: 0xFF, type: u16, order: little}}", {"a": 254}, "FE"),
        Case("a length of a choice, one case of which has that size", "- {length: n, type: u8, of: [c]}\n- {field: k, type: u8}\n- {choose: k, name: c, cases: {1: [{data: d, size: n}], 2: [{field: z, type: u16}]}}", {"k": 1, "d": b"ab"}, "02 01 61 62", {"n": 2}),
        Case("the same, the other case", "- {length: n, type: u8, of: [c]}\n- {field: k, type: u8}\n- {choose: k, name: c, cases: {1: [{data: d, size: n}], 2: [{field: z, type: u16}]}}", {"k": 2, "z": 7}, "02 02 00 07", {"n": 2}),
        Case("the same with a region", "- {length: n, type: u8, of: [c]}\n- {field: k, type: u8}\n- {choose: k, name: c, cases: {1: [{wrap: none, name: w, size: n, of: [{field: a, type: u8}]}], 2: [{field: z, type: u16}]}}", {"k": 1, "a": 9}, "01 01 09", {"n": 1}),
        Case("a long form of which zero means a number", "- {field: a, type: u8, zero_means: 1000, long: {mark: 0xF0, type: u16}}", {"a": 1000}, "00"),
        Case("the same, long", "- {field: a, type: u8, zero_means: 1000, long: {mark: 0xF0, type: u16}}", {"a": 240}, "F0 00 F0"),
        Case("a long form of a time", "- {field: a, type: u8, unit: ms, long: {mark: 0xF0, type: u16}}", {"a": 5_000_000}, "05"),
        Case("the same, long time", "- {field: a, type: u8, unit: ms, long: {mark: 0xF0, type: u16}}", {"a": 300_000_000}, "F0 01 2C"),
        Case("0 means 256", "- {field: a, type: u8, zero_means: 256}", {"a": 256}, "00"),
        Case("there only on a condition", "- {field: a, type: u8}\n- {field: b, type: u8, when: a > 1, default: 9}",
             {"a": 1}, "01", {"b": 9}),
        Case("what is not there is nothing, for the conditions behind it, too",
             "- {bits: {k: 0-3, more: 7}, of: u8}\n- {bits: {d: 0-3, again: 7}, of: u8, when: more}\n"
             "- {field: e, type: u8, when: again}\n- const: ETX", {"k": 1, "more": 0}, "01 03", bad={"01 04": "constant"}),
        Case("the same, in an item", "- repeat: r\n  times: 2\n  of: [{bits: {more: 7}, of: u8},"
             " {bits: {d: 0-3, again: 7}, of: u8, when: more},\n    {field: e, type: u8, when: again}, {field: v, type: u8}]\n"
             "- const: ETX",
             {"r": [{"more": 0, "v": 9}, {"more": 1, "d": 3, "again": 1, "e": 5, "v": 7}]}, "00 09 80 83 05 07 03",
             bad={"00 09 80 83 05 07 04": "constant"}),
        Case("fixed for this frame", "- {field: a, type: ascii, size: 1}", {}, "72", {"a": "r"}, {"73": "where"},
             keys="where: {a: [r, R]}"),
    ),
    "Bits": (
        Case("bits of a byte", "- {bits: {ready: 0, code: 4-7}, of: u8}", {"ready": 1, "code": 10}, "A1"),
        Case("bits of two hex digits", "- {bits: {write: 7, type: 0-6}, of: hex, size: 2}", {"write": 1, "type": 2}, "38 32"),
        Case("bits that are fixed", "- {bits: {error: 7, function: 0-6}, of: u8, is: {error: 1}}", {"function": 3}, "83",
             {"error": 1}, {"03": "value"}),
    ),
    "Data": (
        Case("a fixed size", "- {data: d, size: 3}", {"d": b"\x01\x02\x03"}, "01 02 03"),
        Case("a size from a field", "- {length: n, type: u8, of: [d]}\n- {data: d, size: n}", {"d": b"ab"}, "02 61 62",
             {"n": 2}),
        Case("the rest", "- {field: a, type: u8}\n- {data: d, size: rest}\n- const: ETX", {"a": 1, "d": b"xy"}, "01 78 79 03"),
        Case("filled up", "- {data: d, size: 4, pad: 00}", {"d": b"\x09"}, "09 00 00 00", {"d": b"\x09\x00\x00\x00"}),
        Case(
            "filled up to a size from a field",
            "- {field: n, type: u8}\n- {data: d, size: n + 1, pad: 20}",
            {"n": 2, "d": b"\x09"}, "02 09 20 20", {"d": b"\x09\x20\x20"},
        ),
        Case("bytes that never stand in it, one of which ends it", "- const: 7E\n- {data: d, size: rest, never: [7E]}\n- {check: xor8, over: [d]}\n- const: 7E",
             {"d": b"ab"}, "7E 61 62 03 7E", bad={"7E 61 7E 1F 7E": "value"}),
        Case("several such bytes, in data of fixed size", "- {data: d, size: 2, never: [0D, 0A], swap: 2}", {"d": b"ab"}, "62 61",
             bad={"61 0A": "value", "0D 0A": "value"}),
        Case("Hex To ASCII: a byte is two digits", "- {data: d, size: 2, convert: hex_to_ascii}", {"d": b"\x12\xab"},
             "31 32 41 42", bad={"31 32 41 47": "digits"}),
        Case("ASCII To Hex: two digits are a byte", "- {data: d, size: 4, convert: ascii_to_hex}", {"d": b"4567"}, "45 67"),
        Case("swap 2", "- {data: d, size: 8, swap: 2}", {"d": bytes.fromhex("1234567811223344")}, "34 12 78 56 22 11 44 33"),
        Case("swap 4", "- {data: d, size: 8, swap: 4}", {"d": bytes.fromhex("1234567811223344")}, "78 56 34 12 44 33 22 11"),
        Case("swap 8", "- {data: d, size: 8, swap: 8}", {"d": bytes.fromhex("1234567811223344")}, "44 33 22 11 78 56 34 12"),
    ),
    "Lengths and counts": (
        Case("a length", "- {length: n, type: u8, of: [d]}\n- {data: d, size: n}", {"d": b"abc"}, "03 61 62 63", {"n": 3},
             {"04 61 62 63": "short"}),
        Case("of several segments, with more", "- {length: n, type: u8, of: [a, d], plus: 2}\n- {field: a, type: u8}\n"
             "- {data: d, size: n - 3}", {"a": 9, "d": b"xy"}, "05 09 78 79", {"n": 5}),
        Case("in words", "- {length: n, type: u8, of: [d], unit: words}\n- {data: d, size: n * 2}", {"d": b"abcd"},
             "02 61 62 63 64", {"n": 2}),
        Case("before conversion", "- {length: n, type: hex, size: 2, of: [d], plain: yes}\n"
             "- {data: d, size: n, convert: hex_to_ascii}", {"d": b"\xaa\x15"}, "30 32 41 41 31 35", {"n": 2}),
        Case("a count", "- {count: n, type: u8, of: list}\n- {repeat: list, times: n, of: u16}", {"list": [1, 2]},
             "02 00 01 00 02", {"n": 2}),
        Case("a length over a list of values", "- {length: n, type: u8, of: [list]}\n"
             "- {repeat: list, times: n // 2, of: u16}", {"list": [1, 2]}, "04 00 01 00 02", {"n": 4},
             {"05 00 01 00 02": "length", "03 00 01": "length", "06 00 01 00 02": "short"}),
        Case("in words, of values", "- {length: n, type: u8, of: [list], unit: words}\n"
             "- {repeat: list, times: n, of: i16, order: little}", {"list": [-1, 2]}, "02 FF FF 02 00", {"n": 2}),
    ),
    "Lists": (
        Case("a list of records", "- {count: n, type: u8, of: list}\n- repeat: list\n  times: n\n"
             "  of: [{field: a, type: u8}, {field: b, type: u8}]", {"list": [{"a": 1, "b": 2}, {"a": 3, "b": 4}]},
             "02 01 02 03 04", {"n": 2}),
        Case("a length over a list of records", "- {length: all, type: u8, of: [a, n, list]}\n- {field: a, type: u8}\n"
             "- {count: n, type: u8, of: list}\n- repeat: list\n  times: n\n  of: [{field: b, type: u16}]",
             {"a": 7, "list": [{"b": 2}, {"b": 4}]}, "06 07 02 00 02 00 04", {"all": 6, "n": 2},
             {"05 07 02 00 02 00 04": "length"}),
        Case("records as many as a length says", "- {length: n, type: u8, of: [list]}\n- repeat: list\n  times: n // 2\n"
             "  of: [{field: a, type: u16}]", {"list": [{"a": 1}, {"a": 2}]}, "04 00 01 00 02", {"n": 4},
             {"05 00 01 00 02": "length", "06 00 01 00 02": "short"}),
        Case("items that know those before them", "- {count: n, type: u8, of: list}\n- repeat: list\n  times: n\n"
             "  of: [{field: a, type: u8}, {value: at, read: len(list)}, {field: sum, type: u8, is: sum(list.a)},\n"
             "       {data: d, size: len(list)}]", {"list": [{"a": 5, "d": b""}, {"a": 7, "d": b"x"}]},
             "02 05 00 07 05 78", {"n": 2, "list": [{"a": 5, "at": 0, "sum": 0, "d": b""}, {"a": 7, "at": 1, "sum": 5, "d": b"x"}]},
             {"02 05 00 07 06 78": "value"}),
        Case("a list of so many bytes", "- {length: n, type: u8, of: [w]}\n- wrap: none\n  name: w\n  size: n\n"
             "  of: [{repeat: list, times: rest, of: [{field: s, type: ascii, end: 00}]}]\n- const: ETX",
             {"list": [{"s": "ab"}, {"s": ""}]}, "04 61 62 00 00 03", {"n": 4}, {"03 61 62 00 00 03": "constant", "02 61 62 03": "short"}),
        Case("a list that its last item ends", "- repeat: list\n  until: more == 0\n  of: [{bits: {more: 7, value: 0-6}, of: u8}]\n"
             "- const: ETX", {"list": [{"more": 1, "value": 5}, {"more": 0, "value": 2}]}, "85 02 03",
             bad={"85 02 04": "constant", "85 82 03": "short"}),
        Case("items of any size, up to one that ends the list", "- repeat: list\n  until: tag == 0xFF\n"
             "  of: [{field: tag, type: u8}, {length: n, type: u8, of: [d]}, {data: d, size: n}]\n- {field: a, type: u8}",
             {"list": [{"tag": 1, "d": b"ab"}, {"tag": 255, "d": b""}], "a": 9}, "01 02 61 62 FF 00 09",
             {"list": [{"tag": 1, "n": 2, "d": b"ab"}, {"tag": 255, "n": 0, "d": b""}]}, {"01 02 61 62 FF 01 09": "short"}),
        Case("extension bits that follow from the number of items", "- repeat: list\n  until: more == 0\n"
             "  of: [{bits: {more: 7, value: 0-6}, of: u8, is: {more: not last}}]\n- const: ETX",
             {"list": [{"value": 5}, {"value": 2}, {"value": 1}]}, "85 82 01 03",
             {"list": [{"more": 1, "value": 5}, {"more": 1, "value": 2}, {"more": 0, "value": 1}]}),
        Case("items that know their number, the last one and the one before", "- {count: n, type: u8, of: list}\n- repeat: list\n"
             "  times: n\n  of: [{field: number, type: u8, is: index + 1}, {field: a, type: u8},\n"
             "       {field: sum, type: u8, is: 'either(previous.sum, 0) + a'}, {field: b, type: u8, when: last}]",
             {"list": [{"a": 5}, {"a": 7, "b": 9}]}, "02 01 05 05 02 07 0C 09",
             {"n": 2, "list": [{"number": 1, "a": 5, "sum": 5}, {"number": 2, "a": 7, "sum": 12, "b": 9}]},
             {"02 01 05 05 03 07 0C 09": "value", "02 01 05 05 02 07 0B 09": "value"}),
        Case("up to the end, the last item marked", "- repeat: list\n  times: rest\n  of: [{bits: {end: 7, value: 0-6}, of: u8, is: {end: last}}]",
             {"list": [{"value": 5}, {"value": 2}]}, "05 82", {"list": [{"end": 0, "value": 5}, {"end": 1, "value": 2}]},
             {"85 82": "value", "05 02": "value"}),
        Case("items that begin at multiples of 4 bytes, none filled up behind the last", "- repeat: list\n  times: rest\n  align: 4\n"
             "  between: yes\n  of: [{length: n, type: u8, of: [s]}, {field: s, type: ascii, size: n}]",
             {"list": [{"s": "a"}, {"s": "xyz"}, {"s": "b"}]}, "01 61 00 00 03 78 79 7A 01 62",
             {"list": [{"n": 1, "s": "a"}, {"n": 3, "s": "xyz"}, {"n": 1, "s": "b"}]}, {"01 61 00 00": "short", "01 61 00": "short"}),
        Case("every item filled up", "- {count: n, type: u8, of: list}\n- repeat: list\n  times: n\n  align: 4\n  fill: 20\n"
             "  of: [{field: s, type: ascii, end: 0D}]\n- const: ETX", {"list": [{"s": "a"}, {"s": "xyz"}]},
             "02 61 0D 20 20 78 79 7A 0D 03", {"n": 2}, {"02 61 0D 20 20 78 0D 03": "short"}),
        Case("items of a fixed size, filled up in between", "- repeat: list\n  times: 3\n  align: 2\n  between: yes\n"
             "  of: [{field: a, type: u8}]\n- {field: b, type: u8}", {"list": [{"a": 1}, {"a": 2}, {"a": 3}], "b": 4},
             "01 00 02 00 03 04"),
        Case("items with bytes between them", "- repeat: list\n  times: rest\n  separator: 2C 20\n  of: [{field: s, type: ascii, end: 3B}]\n"
             "- const: ETX", {"list": [{"s": "a"}, {"s": "xy"}, {"s": ""}]}, "61 3B 2C 20 78 79 3B 2C 20 3B 03", {},
             {"61 3B 2C 21 78 79 3B 2C 20 3B 03": "constant", "61 3B 2C 20 03": "short"}),
        Case("numbers as text with a comma between them", "- repeat: list\n  times: rest\n  separator: 2C\n"
             "  of: [{field: v, type: decimal, end: [2C, 0D]}]\n- const: 0D", {"list": [{"v": 12}, {"v": -7}, {"v": 3}]},
             "31 32 2C 2D 37 2C 33 0D", {}, {"31 32 2C 2C 33 0D": "digits", "31 32 2C 0D": "digits"}),
        Case("a counted list with bytes between its items", "- {count: n, type: u8, of: list}\n- repeat: list\n  times: n\n"
             "  separator: 2F\n  of: [{field: a, type: u8}]", {"list": [{"a": 1}, {"a": 2}]}, "02 01 2F 02", {"n": 2},
             {"02 01 2E 02": "constant"}),
        Case("a list with bytes between its items, whose last one tells that it is", "- repeat: list\n  until: more == 0\n"
             "  separator: 2F\n  of: [{bits: {more: 7, v: 0-6}, of: u8, is: {more: not last}}]\n- const: ETX",
             {"list": [{"v": 5}, {"v": 2}]}, "85 2F 02 03", {"list": [{"more": 1, "v": 5}, {"more": 0, "v": 2}]},
             {"85 2E 02 03": "constant"}),
        Case("plain values with bytes between them", "- repeat: list\n  times: rest\n  separator: 20\n  of: dec\n  size: 3\n- const: ETX",
             {"list": [12, 7, 300]}, "30 31 32 20 30 30 37 20 33 30 30 03", {},
             {"30 31 32 21 30 30 37 03": "constant", "30 31 41 20 30 30 37 03": "digits", "30 31 32 20 03": "short"}),
        Case("plain decimals with bytes between them", "- repeat: list\n  times: rest\n  separator: 2C\n  of: decimal\n"
             "  end: [2C, 0D]\n- const: 0D", {"list": [12, -7, 3]}, "31 32 2C 2D 37 2C 33 0D", {}, {"31 32 2C 2C 33 0D": "digits"}),
        Case("plain values that are filled up each", "- {count: n, type: u8, of: list}\n- repeat: list\n  times: n\n  align: 4\n"
             "  fill: 20\n  of: dec\n  size: 3", {"list": [12, 7]}, "02 30 31 32 20 30 30 37 20", {"n": 2},
             {"02 30 31 41 20 30 30 37 20": "digits"}),
        Case("a fixed number of values", "- {repeat: list, times: 3, of: u8}", {"list": [1, 2, 3]}, "01 02 03"),
        Case("values up to the end", "- {repeat: list, times: rest, of: u16, order: little}", {"list": [1, 2]}, "01 00 02 00"),
        Case("values behind a number of another order", "- {field: a, type: u16, order: little}\n"
             "- {repeat: list, times: rest, of: i16}", {"a": 1, "list": [2, -2]}, "01 00 00 02 FF FE"),
        Case("lengths and counts in records of the same names", "- {length: n, type: u8, of: [t, u], plus: 2}\n- {include: held, as: t}\n- {include: held, as: u}",
             {"t": {"r": [1, 2], "d": b"abc"}, "u": {"r": [3], "d": b""}}, "0C 02 06 01 02 61 62 63 01 02 03",
             {"n": 12, "t": {"c": 2, "n": 6, "r": [1, 2], "d": b"abc"}, "u": {"c": 1, "n": 2, "r": [3], "d": b""}},
             {"0C 02 06 01 02 61 62 63 01 03 03": "short", "0B 02 06 01 02 61 62 63 01 02 03": "length"},
             top="layouts: {held: [{count: c, type: u8, of: r}, {length: n, type: u8, of: [n, r, d], range: 0..9},"
             " {repeat: r, times: c, of: u8}, {data: d, size: n - 1 - c}]}\n"),
    ),
    "Records and choices": (
        Case("a record", "- {include: pair, as: p}", {"p": {"a": 1, "b": 2}}, "01 02",
             top="layouts:\n  pair: [{field: a, type: u8}, {field: b, type: u8}]\n"),
        Case("a layout that stands in itself, at most three deep", "- include: node\n- const: ETX",
             {"a": 1, "below": [{"node": {"a": 2, "below": []}}, {"node": {"a": 3, "below": [{"node": {"a": 4, "below": []}}]}}]},
             "01 02 02 00 03 01 04 00 03",
             {"n": 2, "below": [{"node": {"a": 2, "n": 0, "below": []}},
                                {"node": {"a": 3, "n": 1, "below": [{"node": {"a": 4, "n": 0, "below": []}}]}}]},
             {"01 02 02 00 03 01 04 00 04": "constant", "01 01 02 01 03 01 04 00 03": "require"},
             top="layouts:\n  node: [{field: a, type: u8}, {count: n, type: u8, of: below},\n"
                 "         {repeat: below, times: n, of: [{include: node, as: node, depth: 3}]}]\n"),
        Case("a layout that stands in itself under a condition", "- include: link\n- const: ETX",
             {"more": 1, "next": {"more": 1, "next": {"more": 0}}}, "01 01 00 03", bad={"01 01 01 00 03": "require"},
             top="layouts:\n  link: [{field: more, type: u8}, {include: link, as: next, depth: 3, when: more}]\n"),
        Case("an include", "- include: pair", {"a": 1, "b": 2}, "01 02",
             top="layouts:\n  pair: [{field: a, type: u8}, {field: b, type: u8}]\n"),
        Case("a choice", "- {field: kind, type: u8}\n- choose: kind\n  cases:\n    1: [{field: a, type: u8}]\n"
             "    2: [{field: b, type: u16}]\n  else: [{const: FF}]", {"kind": 2, "b": 5}, "02 00 05"),
        Case("cases that share names, with defaults that stand on each other",
             "- choose: kind\n  cases:\n"
             "    a: [{bits: {has_x: 0, has_y: 1, more: 2-7}, of: u8, build: {has_x: t == '', has_y: t == '' and y != 0, more: 0}},\n"
             "        {field: x, type: u8, when: has_x, default: 0}, {field: y, type: u8, when: has_y, default: 0},\n"
             "        {field: t, type: ascii, end: 00, when: not has_x and not has_y, default: ''}]\n"
             "    b: [{bits: {has_x: 0, more: 1-7}, of: u8, build: {has_x: t == '', more: 0}},\n"
             "        {field: x, type: u8, when: has_x, default: 3}, {field: t, type: ascii, end: 00, when: not has_x, default: ''}]\n",
             {"x": 7}, "01 07", {"has_x": 1, "has_y": 0, "more": 0, "y": 0, "t": ""},
             top="params: {kind: {type: choice, of: [a, b], default: a}}\n"),
        Case("the other case", "- {field: kind, type: u8}\n- choose: kind\n  cases:\n    1: [{field: a, type: u8}]\n"
             "  else: [{const: FF}]", {"kind": 9}, "09 FF"),
        Case("a choice in the other case", "- {field: kind, type: u8}\n- choose: kind\n  cases:\n    15: [{const: 01}]\n"
             "  else:\n    - {field: b, type: u8}\n    - {choose: kind, cases: {1: [{field: v, type: i8}], 2: [{field: v, type: i16}]}}\n"
             "- const: ETX", {"kind": 2, "b": 7, "v": -2}, "02 07 FF FE 03", bad={"03 07 01 03": "value"}),
        Case("an optional part", "- {field: a, type: u8}\n- optional: [{field: b, type: u8}]", {"a": 1, "b": 2}, "01 02"),
        Case("the same, left out", "- {field: a, type: u8}\n- optional: [{field: b, type: u8}]", {"a": 1}, "01"),
        Case("a derived value", "- {field: name, type: ascii, size: 3}\n- {value: letter, read: 'name[1]'}", {"name": "%MW"},
             "25 4D 57", {"letter": "M"}),
        Case("a derived value that a size needs, before what it reads", "- {value: n, read: n0 - 1}\n"
             "- {field: n0, type: u8, build: n + 1}\n- {data: d, size: n}", {"n": 2, "d": b"ab"}, "03 61 62", {"n0": 3},
             {"03 61": "short"}),
        Case("a constant under a condition that does not hold", "- {field: k, type: u8}\n- {length: n, type: u8, of: [d]}\n"
             "- {field: f, type: u8, when: k == 3}\n- {data: d, size: n}\n- {const: FF, when: k == 2}",
             {"k": 1, "d": b"ab"}, "01 02 61 62", {"n": 2}),
        Case("a condition", "- {field: a, type: u8}\n- {require: a % 2 == 0}", {"a": 4}, "04", bad={"05": "require"}),
    ),
    "Wraps": (
        Case("as hex digits", "- text: ':'\n- wrap: hex\n  of: [{field: a, type: u8}, {data: d, size: 2}]\n- const: CR LF",
             {"a": 0xF1, "d": b"\x00\x0a"}, "3A 46 31 30 30 30 41 0D 0A"),
        Case("with the escape byte doubled", "- const: DLE STX\n- wrap: {escape: DLE}\n  of: [{data: d, size: rest}]\n"
             "- const: DLE ETX", {"d": b"\x01\x10\x02"}, "10 02 01 10 10 02 10 03"),
        Case("bytes escaped, with a bit turned, and a check inside", "- const: 7E\n"
             "- wrap: {escape: 7D, xor: 20, bytes: [7E, 7D, 11, 13]}\n"
             "  of: [{data: d, size: rest}, {check: crc16-ibm-sdlc, order: little, over: d..here}]\n- const: 7E",
             {"d": b"\x7e\x13\x42\x7d"}, "7E 7D 5E 7D 33 42 7D 5D 9C BF 7E",
             bad={"7E 7D 5E 13 42 7D 5D 9C BF 7E": "constant", "7E 42 00 00 7D 7E": "constant"}),
        Case("bytes escaped, with a code for each", "- wrap: {escape: DB, codes: {C0: DC, DB: DD}}\n"
             "  of: [{field: a, type: u8}, {data: d, size: rest}]\n- const: C0", {"a": 0xC0, "d": b"\xdb\xdc"},
             "DB DC DB DD DC C0", bad={"DB DE C0": "constant", "01 DB C0": "constant"}),
        Case("COBS", "- wrap: cobs\n  of: [{field: a, type: u16}, {data: d, size: rest}]\n- const: 00",
             {"a": 0x1100, "d": b"\x00\x22"}, "02 11 01 02 22 00", bad={"03 11 00": "constant"}),
        Case("COBS, groups that are full", "- wrap: cobs\n  of: [{data: d, size: rest}]\n- const: 00",
             {"d": b"\x01" * 254}, "FF" + 254 * " 01" + " 00"),
        Case("bytes put in behind others", "- const: FF FF FD 00\n- {length: n, type: u16, order: little, of: [w]}\n"
             "- {name: w, wrap: {after: FF FF FD, insert: FD}, size: n, of: [{data: d, size: rest}]}",
             {"d": b"\xff\xff\xfd\x01"}, "FF FF FD 00 05 00 FF FF FD FD 01", {"n": 5},
             {"FF FF FD 00 04 00 FF FF FD 01": "constant"}),
    ),
    "Wraps with check codes and of shorter content": (
        Case("a check code behind each block of a body", "- {length: n, type: u8, of: [d], plus: 5}\n"
             "- {wrap: {block: 4, check: sum8}, plain: n - 5, of: [{data: d, size: rest}]}\n- {check: xor8, over: n..here}",
             {"d": b"\x01\x02\x03\x04\x05"}, "0A 01 02 03 04 0A 05 05 0B", {"n": 10},
             {"0A 01 02 03 04 0B 05 05 0B": "check", "0A 01 02 03 04 0A 05 06 0B": "check"}),
        Case("the same, with digits, up to the end", "- {wrap: {block: 2, check: sum8, as: hex}, of: [{field: a, type: u8}, {data: d, size: rest}]}",
             {"a": 1, "d": b"\x02\x05"}, "01 02 30 33 05 30 35", bad={"01 02 30 33 30 35": "short", "01 02 30 34 05 30 35": "check"}),
        Case("blocks of content of fixed size", "- {wrap: {block: 2, check: crc16-dnp, order: little}, of: [{field: a, type: u8}, {data: d, size: 3}]}\n"
             "- const: ETX", {"a": 1, "d": b"\x02\x03\x04"}, "01 02 0D 38 03 04 2C 96 03",
             bad={"01 02 0D 38 03 04 2C 97 03": "check"}),
        Case("zeros left out at the end", "- {length: n, type: u8, of: [p]}\n"
             "- {name: p, wrap: {short: 00, min: 1}, size: n, of: [{field: a, type: u16}, {field: b, type: u16, order: little}]}\n"
             "- {check: sum8, over: [p]}", {"a": 0x0100, "b": 2}, "03 01 00 02 03", {"n": 3},
             {"05 01 00 02 00 00 03": "too_long", "00 00": "short"}),
        Case("the same, with nothing but zeros", "- {length: n, type: u8, of: [p]}\n"
             "- {name: p, wrap: {short: 00, min: 1}, size: n, of: [{field: a, type: u16}, {field: b, type: u16}]}\n"
             "- {check: sum8, over: n..here, wire: yes}", {"a": 0, "b": 0}, "01 00 01", {"n": 1}),
        Case("spaces left out at the end of a frame", "- {field: k, type: u8}\n- {wrap: {short: 20}, of: [{field: t, type: ascii, size: 5}, {data: d, size: 1}]}\n"
             "- const: CR", {"k": 1, "t": "AB   ", "d": b" "}, "01 41 42 0D", bad={"01 41 42 43 44 45 46 47 0D": "too_long"}),
    ),
    "Ciphers": (
        Case("AES-CBC: two blocks of NIST SP 800-38A, F.2.1", "- {data: iv, size: 16}\n"
             "- {wrap: {cipher: aes-cbc, key: k, iv: iv}, of: [{data: d, size: 32}]}",
             {"iv": bytes(range(16)), "d": bytes.fromhex("6BC1BEE22E409F96E93D7E117393172AAE2D8A571E03AC9C9EB76FAC45AF8E51")},
             "00 01 02 03 04 05 06 07 08 09 0A 0B 0C 0D 0E 0F "
             "76 49 AB AC 81 19 B2 46 CE E9 8E 9B 12 E9 19 7D 50 86 CB 9B 50 72 19 EE 95 DB 11 3A 91 76 78 B2", top=KEYS),
        Case("AES-CBC, filled up by PKCS #7", "- {length: n, type: u8, of: [w]}\n"
             "- {name: w, wrap: {cipher: aes-cbc, key: k, iv: \"h'000102030405060708090A0B0C0D0E0F'\", pad: pkcs7}, size: n, of: [{field: a, type: u8}, {data: d, size: rest}]}",
             {"a": 1, "d": b"abc"}, "10 80 B3 28 AE 31 F7 39 DA 3E 05 92 3E 6D 69 22 24", {"n": 16},
             {"10 80 B3 28 AE 31 F7 39 DA 3E 05 92 3E 6D 69 22 25": "constant", "0F 80 B3 28 AE 31 F7 39 DA 3E 05 92 3E 6D 69 22": "constant"}, KEYS),
        Case("AES-CBC, filled up by ISO 7816-4 and told by the plain size", "- {field: n, type: u8}\n"
             "- {wrap: {cipher: aes-cbc, key: k, iv: \"h'000102030405060708090A0B0C0D0E0F'\", pad: iso7816}, plain: n, of: [{field: a, type: u8}, {data: d, size: rest}]}",
             {"n": 4, "a": 1, "d": b"abc"}, "04 9A 18 56 3C DC DD 73 60 BA 07 F0 9C CE B7 CA 08", bad={"04 80 B3 28 AE 31 F7 39 DA 3E 05 92 3E 6D 69 22 24": "constant"}, top=KEYS),
        Case("AES-CTR: a part of NIST SP 800-38A, F.5.1", "- {wrap: {cipher: aes-ctr, key: k, iv: \"h'F0F1F2F3F4F5F6F7F8F9FAFBFCFDFEFF'\"},\n"
             "   of: [{field: a, type: u16}, {data: d, size: 3}]}", {"a": 0x6BC1, "d": bytes.fromhex("BEE22E")}, "87 4D 61 91 B6", top=KEYS),
        Case("AES-GCM, with bytes that count in the tag, and a tag of 8 bytes", "- {data: s, size: 1}\n"
             "- {wrap: {cipher: aes-gcm, key: k, iv: \"h'000102030405060708090A0B'\", also: s, tag: 8}, of: [{field: a, type: u8}, {data: d, size: rest}]}",
             {"s": b"\x05", "a": 1, "d": b"abc"}, "05 5A AE 59 35 31 C9 94 C6 EC FC 58 F7",
             bad={"06 5A AE 59 35 31 C9 94 C6 EC FC 58 F7": "check", "05 5B AE 59 35 31 C9 94 C6 EC FC 58 F7": "check", "05 01 02": "constant"}, top=KEYS),
    ),
    "Codes made with a key and functions": (
        Case("a code that an expression gives: AES-CBC-MAC of the bytes, filled up, of which four stand there",
             "- {field: a, type: u8}\n- {data: d, size: 2}\n- {check: mine, size: 4}", {"a": 1, "d": b"ab"}, "01 61 62 11 BC 91 B0",
             bad={"01 61 62 11 BC 91 B1": "check"},
             top=KEYS + "checks:\n  mine: {code: \"aes(k, (data + h'80000000000000000000000000000000')[:(len(data) + 15) // 16 * 16])[-16:]\", width: 128}\n"),
        Case("AES of one block (FIPS 197, C.1), and exclusive or", "- {data: d, size: 16}\n"
             "- {value: sealed, read: \"aes(h'000102030405060708090A0B0C0D0E0F', d)\"}\n- {value: turned, read: \"xor(d[:2], h'FF0F')\"}",
             {"d": bytes.fromhex("00112233445566778899AABBCCDDEEFF")}, "00 11 22 33 44 55 66 77 88 99 AA BB CC DD EE FF",
             {"sealed": bytes.fromhex("69C4E0D86A7B0430D8CDB78070B4C55A"), "turned": b"\xff\x1e"}),
        Case("a part of the content that is not enciphered", "- {length: n, type: u8, of: [w]}\n"
             "- {name: w, wrap: {cipher: aes-cbc, key: k, iv: \"h'000102030405060708090A0B0C0D0E0F'\", pad: iso7816, clear: 1}, size: n, of: [{field: a, type: u8}, {data: d, size: rest}]}",
             {"a": 1, "d": b"abc"}, "11 01 FF C1 A7 1B 19 FD FB 21 C5 CC A7 98 CB 7F A5 32", {"n": 17},
             {"00": "constant", "11 01 FF C1 A7 1B 19 FD FB 21 C5 CC A7 98 CB 7F A5 33": "constant"}, KEYS),
    ),
    "Check codes": (
        Case("sum, low byte, as digits", "- const: STX\n- {data: d, size: 2}\n- const: ETX\n- {check: sum8, as: hex}",
             {"d": b"RD"}, "02 52 44 03 39 42", bad={"02 52 44 03 39 43": "check"}),
        Case("exclusive or", "- {data: d, size: 3}\n- {check: xor8}", {"d": b"\x01\x02\x04"}, "01 02 04 07"),
        Case("LRC", "- {data: d, size: 2}\n- {check: lrc8}", {"d": b"\x11\x03"}, "11 03 EC"),
        Case("CRC from the catalogue", "- {data: d, size: 6}\n- {check: crc16-modbus, order: little}",
             {"d": bytes.fromhex("11 03 00 6B 00 03")}, "11 03 00 6B 00 03 76 87"),
        Case("CRC by its parameters", "- {data: d, size: 9}\n- {check: mine}", {"d": b"123456789"},
             "31 32 33 34 35 36 37 38 39 29 B1",
             top="checks:\n  mine: {width: 16, poly: 0x1021, init: 0xFFFF}\n"),
        Case("two's complement of the sum", "- {data: d, size: 2}\n- {check: mine}", {"d": b"\x01\x02"}, "01 02 FD",
             top="checks:\n  mine: {method: sum8, complement: twos}\n"),
        Case("initial value and mask", "- {data: d, size: 2}\n- {check: mine}", {"d": b"\xff\x01"}, "FF 01 05",
             top="checks:\n  mine: {method: sum8, initial: 5, mask: 0x7F}\n"),
        Case("an algorithm of one's own", "- {data: d, size: 3}\n- {check: mine}", {"d": b"\x01\x02\x03"}, "01 02 03 06",
             top='checks:\n  mine: {fold: "rotl8(acc ^ byte, 1)", initial: 0}\n'),
        Case("over named segments", "- {field: a, type: u8}\n- {const: 55, name: c}\n- {data: d, size: 1}\n"
             "- {check: sum8, over: [a, d]}", {"a": 1, "d": b"\x02"}, "01 55 02 03"),
        Case("from one segment on", "- const: STX\n- {field: a, type: u8}\n- {data: d, size: 1}\n"
             "- {check: xor8, over: a..here}", {"a": 1, "d": b"\x02"}, "02 01 02 03"),
        Case("from an offset on", "- const: STX\n- {data: d, size: 2}\n- {check: xor8, over: 1..here}", {"d": b"\x01\x02"},
             "02 01 02 03"),
        Case("inside a wrap", "- text: ':'\n- wrap: hex\n  of: [{data: d, size: 2}, {check: lrc8, over: d..here}]\n- const: CR",
             {"d": b"\x11\x03"}, "3A 31 31 30 33 45 43 0D"),
        Case("over what is undoubled", "- wrap: {escape: DLE}\n  of: [{data: d, size: rest}]\n- {const: DLE}\n"
             "- {const: ETX, name: etx}\n- {check: sum8, over: [d, etx]}", {"d": b"\x10"}, "10 10 10 03 13"),
        Case("a code made with a key (AES-CMAC), of which the first bytes stand there", "- {field: a, type: u8}\n- {data: d, size: 2}\n"
             "- {check: cmac-aes, key: k, size: 4}", {"a": 1, "d": b"ab"}, "01 61 62 01 7F 21 BC",
             bad={"01 61 62 01 7F 21 BD": "check"}, top=KEYS),
        Case("the same with HMAC, in digits", "- {field: a, type: u8}\n- {data: d, size: 2}\n"
             "- {check: hmac-sha256, key: \"h'4A656665'\", as: hex, size: 8, over: a..here}", {"a": 1, "d": b"ab"},
             "01 61 62 43 39 39 43 41 43 35 38", bad={"01 61 62 30 30 30 30 30 30 30 30": "check"}),
        Case("one over another one, which covers what comes later", "- {length: n, type: u8, of: [d]}\n"
             "- {check: xor8, over: [d]}\n- {data: d, size: n}\n- const: ETX\n- {check: xor8, over: n..here}",
             {"d": b"\x10\x01"}, "02 11 10 01 03 01", {"n": 2}, {"02 11 10 01 03 10": "check"}),
        Case("over a record that ends with one of several cases", "- {field: k, type: u8}\n"
             "- {include: part, as: p}\n- {check: xor8, over: p}",
             {"k": 1, "p": {"x": 5}}, "01 05 05", bad={"01 05 06": "check"},
             top="layouts:\n  part: [{choose: k, cases: {1: [{field: x, type: u8}], 2: [{data: d, size: 2}]}}]\n"),
        Case("with bytes that are not on the wire", "- {field: kind, type: u8}\n- {data: d, size: 2}\n"
             "- {check: sum16, over: [{bytes: \"h'01 00'\"}, kind..here, {bytes: 'extra[kind]', type: u8}]}",
             {"kind": 2, "d": b"\x03\x04"}, "02 03 04 00 31", {}, {"02 03 04 00 32": "check", "09 03 04 00 31": "value"},
             top="tables: {extra: {1: 20, 2: 39}}\n"),
        Case("with numbers that are not on the wire", "- {length: n, type: u8, of: [d]}\n- {data: d, size: n}\n"
             "- {check: xor16, over: [d, {bytes: n + 0x1100, type: u16, order: little}, {bytes: 7, type: hex, size: 2}]}",
             {"d": b"ab"}, "02 61 62 53 44", {"n": 2}, {"02 61 62 53 45": "check"}),
        Case("over what stands on the wire, wraps too", "- const: STX\n- {name: w, wrap: {escape: DLE}, of: [{data: d, size: rest}]}\n"
             "- {const: DLE ETX, name: end}\n- {check: sum8, over: w..here, wire: yes}", {"d": b"\x10\x01"},
             "02 10 10 01 10 03 34", bad={"02 10 10 01 10 03 24": "check"}),
        Case("the same wrap, plain and on the wire", "- {name: w, wrap: hex, of: [{field: a, type: u8}]}\n"
             "- {check: sum8, over: w..here}\n- {check: sum8, over: [w], wire: yes}\n- {check: xor8, over: [w]}",
             {"a": 0x1F}, "31 46 1F 77 1F", bad={"31 46 1F 1F 1F": "check", "31 46 77 77 1F": "check"}),
        Case("in a case, over what stands on the wire", "- {field: k, type: u8}\n"
             "- choose: k\n  name: c\n  cases: {1: [{name: w, wrap: hex, of: [{field: a, type: u8}]}, {field: b, type: u8}]}\n  else: [{field: b, type: u8}]\n"
             "- {check: sum8, over: c..here, wire: yes}\n- {check: sum8, over: [c]}",
             {"k": 1, "a": 0x1F, "b": 2}, "01 31 46 02 79 21", bad={"01 31 46 02 21 21": "check", "02 31 30 31": "check"}),
        Case("over a record, with another one of the same names behind it", "- {field: b, type: u8}\n- {include: octets, as: t}\n"
             "- {include: octets, as: u}\n- {field: e, type: u8}\n- {check: sum8, over: b..e}",
             {"b": 0x40, "t": {"d": b"\1\1"}, "u": {"d": b"\2\2"}, "e": 5}, "40 02 01 01 02 02 02 05 4F",
             {"t": {"n": 2, "d": b"\1\1"}, "u": {"n": 2, "d": b"\2\2"}},
             {"40 02 01 01 02 02 02 05 4B": "check", "40 02 01 01 03 02 02 05 4F": "short"},
             top="layouts: {octets: [{length: n, type: u8, of: [d]}, {data: d, size: n}]}\n"),
        Case("over fields, with a record of the same names that may be absent", "- {field: d, type: u8}\n- {field: k, type: u8}\n"
             "- {include: pair, as: u, when: k > 4}\n- {choose: k, name: c, cases: {5: [{include: pair, as: v}], 6: [{field: e, type: u8}]}}\n"
             "- {check: sum8, over: d..c}\n- {check: xor8, over: [d, u]}",
             {"d": 1, "k": 5, "u": {"d": 2, "e": 3}, "v": {"d": 4, "e": 5}}, "01 05 02 03 04 05 14 00",
             bad={"01 05 02 03 04 05 10 00": "check", "01 05 02 03 04 05 14 02": "check"},
             top="layouts: {pair: [{field: d, type: u8}, {field: e, type: u8}]}\n"),
        Case("in records of the same names, over parts of each", "- {include: told, as: t}\n- {include: told, as: u}\n- {check: xor8, over: [u]}",
             {"t": {"d": b"a"}, "u": {"d": b"bc"}}, "02 61 63 03 62 63 C8 CA", {"t": {"n": 2, "d": b"a"}, "u": {"n": 3, "d": b"bc"}},
             {"02 61 62 03 62 63 C8 CA": "check", "02 61 63 03 62 63 C7 C5": "check", "02 61 63 03 62 63 C8 CB": "check"},
             top="layouts: {told: [{length: n, type: u8, of: [d], plus: 1}, {data: d, size: n - 1}, {check: sum8, over: n..d}]}\n"),
        Case("that ends a wrong frame at once", "- const: 05 64\n- {length: n, type: u8, of: [d]}\n"
             "- {check: crc16-dnp, order: little, ends: yes}\n- {data: d, size: n}\n- check: crc16-dnp\n  order: little",
             {"d": b"ab"}, "05 64 02 D3 83 61 62 4B F9", {"n": 2}, {"05 64 02 D3 84 61 62 4B F9": "check"}),
        Case("that ends it, behind parts of any size", "- {length: n, type: u8, of: [d]}\n- {data: d, size: n}\n"
             "- {field: k, type: u8}\n- {check: sum8, over: [k, {bytes: n + 1, type: u8}, d], as: hex, ends: yes}\n- {data: e, size: n}",
             {"d": b"ab", "e": b"cd", "k": 3}, "02 61 62 03 43 39 63 64", {"n": 2}, {"02 61 62 03 43 38 63 64": "check"}),
        Case("as decimal digits", "- {data: d, size: 1}\n- {check: sum8, as: dec}", {"d": b"\x07"}, "07 30 30 37"),
        Case("as split nibbles", "- {data: d, size: 1}\n- {check: sum8, as: nibbles}", {"d": b"\xab"}, "AB 3A 3B"),
        Case("not compared", "- {data: d, size: 1}\n- {check: sum8, verify: off}", {"d": b"\x07"}, "07 07"),
    ),
}  # fmt: skip

CASES = [case for cases in SECTIONS.values() for case in cases]
