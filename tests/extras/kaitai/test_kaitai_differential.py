"""Definitions designed to be misread: Kaitai and framekit read good and bad bytes alike.

If they do not, the file must report it; each row gives the words of the report.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from definition_trial import Trial, damaged
from drawn_definitions import DrawnDefinition
from extras.kaitai.kaitai_world import Compared, Reader, needs_compiler, readers_of
from segment_cases import CASES
from spread import many, spread
from strategies import base_context

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import FrameError
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import DefinitionError
from framekit.extras.kaitai.generate import generate_kaitai

Row = tuple[str, str]
"""The body, or a whole file, and the bytes of each frame, separated by `|`: good bytes and bad bytes.
"""

PARAMS = "params: {n: {type: number, default: 100}, k: {type: number, default: 2}, K: {type: number, default: 3}}\n"
TABLE = "tables: {t: {1: 5, 2: 6}}\n"

VALUES: Mapping[str, Row] = {
    "BCD of other digits": ("[{field: a, type: bcd, size: 2}]", "1299|1A00|FFFF"),
    "digits that are signs, spaces or prefixes": (
        "[{field: a, type: dec, size: 3}, {field: b, type: hex, size: 4}, {field: c, type: oct, size: 2}]",
        "303132303031413137|2B3132303031413137|315F32303031413137|203132303031413137|303132307831413137"
        "|303132303031412B37|303132303031416F37",
    ),
    "a signed number in hex digits": ("[{field: a, type: i16, as: hex}]", "46464645|2D303031|2B303031"),
    "bits of hex digits": ("[{bits: {w: 7, k: 0-6}, of: hex, size: 2}]", "3832|2B32|2D32"),
    "decimals have one text": (
        "[{field: a, type: decimal, size: 4, pad: 20}, {field: b, type: decimal, size: 3},"
        " {field: c, type: decimal, size: 3, sign: always}, {field: d, type: decimal, end: 2C, digits: 2}]",
        "20202D342D30322B303630372C|2B3030342D30322B303630372C|2020202D2D30322B303630372C|303032342D30322B303630372C"
        "|20202D342D30302B303630372C|20202D343030322B303630372C|20202D34315F322B303630372C|20202D342D3032303036303"
        "72C|20202D342D30322B3036372C|20202D342D30322B30363030372C",
    ),
    "byte orders and signs": (
        "[{field: a, type: i32, order: CDAB}, {field: b, type: i64, order: BADC}, {field: c, type: i24, order: little},"
        " {field: d, type: i40}]",
        "FFFEFFFDF102030405060708FEFFFFFFFFFFFFFE",
    ),
    "a long form has a range, a unit, a name": (
        "[{field: a, type: u8, range: 0..300, long: {mark: 0xFF, type: u16, order: little}},"
        " {field: b, type: u8, unit: 10 ms, long: {mark: 0xF0, type: u16}},"
        " {field: c, type: u8, plus: 2, values: {5: five}, long: {mark: 0xF0, type: u16}},"
        " {field: d, type: u8, is: a, long: {mark: 0xF0, type: u16}}]",
        "05060705|FF2C01F0012C07F0012C|FFE803060705|05060704|FF05000609F00005",
    ),
    "a range of a time": ("[{field: a, type: u8, unit: 10 ms, range: 10 ms..50 ms}]", "00|01|06"),
    "numbers of 64 bits with names": ("[{field: a, type: u64, values: {0xFFFFFFFFFFFFFFFF: most, 0: none}}]", "FF" * 8),
    "constants with a fraction": (
        "[{field: a, type: u8, scale: 0.5, is: 2.5}, {field: b, type: f32, is: 0.1},"
        " {field: c, type: u8, scale: 0.5, when: a > 9, default: 1.5}]",
        "053DCCCCCD|063DCCCCCD|053DCCCCCE",
    ),
    "a default and a name": (
        "[{field: a, type: u8}, {field: b, type: u8, plus: 3, values: {1: x, 2: y}, when: a > 1, default: \"'y'\"},"
        " {field: c, type: u8, when: b == 'y'}]",
        "0107|020507|0204|01",
    ),
    "a constant after a text that ends at two bytes": (
        "[{field: a, type: ascii, end: 0D 0A, is: \"'OK'\"}]", "4F4B0D0A|4F4C0D0A"
    ),
    "data has a least size": ("[{data: d, size: rest, min: 2}, {const: 03}]", "414203|4103|03"),
    "counts and lengths are compared": (
        "[{length: n, type: u8, of: [d, e], plus: 1}, {data: d, size: n // 2 * 2 - 2}, {field: e, type: u8},"
        " {count: m, type: u8, of: xs}, {repeat: xs, times: 2, of: u16}, {field: o, type: u8, is: m + n}]",
        "04010203020001000206|05010203020001000207|04010203030001000207",
    ),
    "a list of less than no items": (
        "[{count: n, type: u8, of: xs, plus: 1}, {repeat: xs, times: n - 1, of: u8}, {field: m, type: u8},"
        " {repeat: ys, times: m - 1, of: u8}]",
        "020701|0101|0001|020700",
    ),
    "a region has bounds": (
        "[{field: n, type: u8}, {wrap: none, size: n, min: 2, max: 3, of: [{data: d, size: rest}]}]",
        "020102|0101|0401020304",
    ),
}  # fmt: skip

NAMES: Mapping[str, Row] = {
    "parameters that differ only by case, or are words": (
        "params: {end: {type: number, default: 1}, content: {type: number, default: 2},"
        " lim: {type: number, default: 3}, LIM: {type: number, default: 4}, class: {type: number, default: 5}}\n"
        "frames: {f: {body: [{field: a, type: u8, is: end + 2 * content + 4 * lim + 8 * LIM + 16 * class}]}}\n",
        "81|82",
    ),
    "a value called like a raw number": (
        "[{field: x, type: u8, plus: 1}, {field: x_raw, type: u8}, {field: x_raw_2, type: u8, plus: 2},"
        " {value: v, read: x * 100 + x_raw * 10 + x_raw_2}]",
        "020304",
    ),
    "a value that comes later hides a parameter": (
        PARAMS + "frames: {f: {body: [{value: v, read: n + 1}, {field: a, type: u8, is: n + 2},"
        " {bits: {b: 0-3}, of: u8, is: {b: n}}, {field: n, type: u8}]}}\n",
        "090707|080707|090607",
    ),
    "a region read in the frame knows its values": (
        PARAMS + "frames: {f: {body: [{field: n, type: u8}, {wrap: none, size: 3, of: [{data: d, size: n},"
        " {data: e, size: rest}]}, {const: 7E}]}}\n",
        "020102037E",
    ),
    "instances that are words of Python": (
        "[{field: property, type: u8, plus: 1}, {field: b, type: u8, plus: 1}]", "0203",
    ),
}  # fmt: skip
for _word in ("u1", "s2", "u4be", "f4", "b8", "b1", "u2le", "str", "strz", "bool", "bytes", "any", "io", "true", "none",
              "kaitai_struct", "kaitai_stream", "int_enum"):  # fmt: skip
    NAMES = {**NAMES, f"frames, records and names of numbers called {_word}": (  # type: ignore[dict-item]
        f"layouts: {{x: [{{field: b, type: u16}}, {{field: {_word}, type: u8, values: {{1: {_word}, 2: mro}}}}]}}\n"
        f"frames: {{{_word}: {{body: [{{field: a, type: u8}}, {{include: x, as: {_word}}}]}}}}\n", "01020301|01020302",
    )}  # fmt: skip

EXPRESSIONS: Mapping[str, Row] = {
    "and and or give a value": (
        "[{field: a, type: u8}, {field: b, type: u8}, {value: v, read: a or 5}, {value: w, read: a and b},"
        " {value: x, read: not a or b}, {value: y, read: a == 3 or b}]",
        "0009|0300|0307",
    ),
    "division of negative numbers": (
        "[{field: a, type: i8}, {value: v, read: a // 3}, {value: w, read: a % 3}, {value: x, read: -a // 2 * 2}]",
        "F9|07|80|00",
    ),
    "a table without the key": (TABLE + "frames: {f: {body: [{field: a, type: u8}, {data: d, size: 't[a]'}]}}\n",
                                "010102030405|03|0301"),
    "a value under the condition that it needs": (
        "[{field: a, type: u8}, {field: n, type: u8, when: a}, {data: d, size: n, when: a},"
        " {field: e, type: u8, when: a and n == 2}, {value: v, read: n if a else 7}]",
        "00|0100|0102010203",
    ),
    "numbers, texts and flags": (
        "[{field: a, type: i8}, {value: v, read: len(text(a + 1))}, {value: w, read: 1 < a < 5},"
        " {value: x, read: (a > 1) + (a > 2)}, {value: y, read: a & 6 == 2 or a | 1 ^ 3}]",
        "05|FB|02|00",
    ),
    "items know their list's index, and nothing more of it": (
        "[{repeat: xs, until: index == 1, of: [{field: k, type: u8, is: index}]}, {value: v, read: 'xs[1].k'}]",
        "0001|0002",
    ),
}  # fmt: skip

FRAMES: Mapping[str, Row] = {
    "a greatest size": ("frames: {f: {max: 4, body: [{const: 01}, {data: d, size: rest}, {const: 03}]}}\n",
                        "010203|01020203|0102020203"),
    "a fixed size": ("frames: {f: {size: 6, fill: 20, body: [{const: 02}, {field: d, type: ascii, end: 00}]}}\n",
                     "024100202020|02410020202020|024100"),
    "a frame inside that is shorter than the byte that tells others": (
        "groups: {g: {from: both}}\nframes:\n  a: {group: g, body: [{field: x, type: u16}, {const: 05}]}\n"
        "  b: {group: g, body: [{field: y, type: u16}, {const: 06}]}\n  c: {group: g, body: [{field: z, type: u8}]}\n"
        "  f: {body: [{field: n, type: u8}, {inner: i, of: g, size: n}]}\n",
        "03000105|03000106|0107",
    ),
    "bytes left over in a region, and behind a frame inside": (
        "frames:\n  a: {body: [{const: 01}]}\n"
        "  f: {body: [{field: n, type: u8}, {wrap: none, size: n, of: [{field: b, type: u16}]},"
        " {inner: i, of: a, size: n - 1}, {const: 03}]}\n", "0200010103|030001010103|03000101010103",
    ),
    "a frame inside that is none": (
        "groups: {g: {from: both}}\nframes:\n  a: {group: g, body: [{const: 01}]}\n"
        "  b: {group: g, body: [{const: 02}]}\n"
        "  f: {body: [{field: n, type: u8}, {inner: i, of: g, size: n}]}\n",
        "0101|0102|020909",
    ),
}  # fmt: skip

LESS = {
    "numbers of 64 bits with names": {"the numbers of 'a' have no names"},
    "a constant after a text that ends at two bytes": {"'a' is read less exactly"},
}
"""The report in the files of these rows."""

TOLD: Mapping[str, tuple[str, str, str]] = {
    "each byte of data": ("[{data: d, size: 2, never: [7E, 05]}]", "0102|017E", "the bytes of 'd' are not looked at"),
    "characters of a number": ("[{field: a, type: ascii, size: 3}, {value: v, read: number(a)}]", "303132|2B3132",
                               "'number' also reads signs, spaces and '_'"),
    "digits of any number": ("[{field: n, type: u8}, {field: a, type: dec, size: n}]", "023132|022B32",
                             "'a' is read less exactly"),
    "half an end": ("[{field: a, type: ascii, end: 0D 0A}]", "610D0A|610D620D0A", "'a' is read less exactly"),
    "a text that is filled up before its end": ("[{field: a, type: ascii, size: 4, end: 00, pad: 20}]", "41200041",
                                                "'a' is not the value that framekit reads"),
    "division by a negative number": ("[{field: a, type: i8}, {value: v, read: 7 // a}]", "02|00",
                                      "the value 'v' is left out: the operator '//' is left out"),
    "what may be absent": ("[{field: a, type: u8}, {field: b, type: u8, when: a}, {require: b != 0}]", "0102|0100|00",
                           "a condition is not looked at: 'b' is not asked for"),
    "what is in another case": (
        "[{field: k, type: u8}, {choose: k, cases: {1: [{field: x, type: u8}]}, else: []}, {value: v, read: x + 1}]",
        "0102|02", "the value 'v' is left out: 'x' is not asked for"),
    "an expression that grows": (
        "[{field: a, type: i8}, {value: v, read: '" + "abs(" * 30 + "a" + ")" * 30 + "'}]", "FF",
        "the value 'v' is left out: an expression is left out"),
    "values around coded content": (
        PARAMS + "frames: {f: {body: [{field: n, type: u8}, {wrap: {escape: 7D, codes: {7E: 5E, 7D: 5D}},"
        " of: [{data: d, size: n}, {data: e, size: rest}]}, {const: 7E}]}}\n", "020102037E",
        "the content of the wrap part is left out: 'n' is not asked for"),
    "a length of what is read in another way": (
        "[{length: n, type: u8, of: [c]}, {field: c, type: ascii, end: 00}]", "024100|034100",
        "the length 'n' is read and not compared: 'c'"),
    "the item before": ("[{repeat: xs, times: 2, of: [{field: k, type: u8, is: 'len(xs)'}]}]", "0001|0101",
                        "'k' is not compared: 'xs' is not asked for"),
}  # fmt: skip


def definition(text: str) -> Protocol:
    return load_protocol_text("protocol: case\n" + (f"frames: {{f: {{body: {text}}}}}\n" if text[0] == "[" else text))


def readers(protocols: list[Protocol]) -> list[tuple[Reader, Codec]]:
    return [(reader, compile_protocol(reader.protocol)) for reader in readers_of(protocols)]


def differences(reader: Reader, codec: Codec, frame: str, data: bytes) -> list[str]:
    """Return values that differ, and bytes that only one side refuses."""
    context: dict[str, Any] = base_context(reader.protocol)
    found = Compared()
    try:
        fields = codec.frames[frame].decode(data, context)
    except FrameError as error:
        try:
            read = reader.read(frame, data, context)
        except Exception:  # errors of the runtime, and Python's errors for text that is not a number
            return []
        return [f"{data.hex(' ')} is refused ({error}), and read as {vars(read)}"]
    reader.compare_frame(frame, data, context, fields, found)
    return found.differences


@needs_compiler
@pytest.mark.parametrize(
    "rows", spread([VALUES, NAMES, EXPRESSIONS, FRAMES], 2), ids=["values", "names", "expressions", "frames"]
)
def test_good_and_bad_bytes_are_what_they_are_for_framekit(rows: Mapping[str, Row]) -> None:
    protocols = [definition(text) for text, _ in rows.values()]
    found = {}
    for title, (_, bytes_), (reader, codec) in zip(rows, rows.values(), readers(protocols), strict=True):
        messages = {problem.what for problem in reader.file.left_out if problem.at != reader.protocol.at}
        assert messages == LESS.get(title, set())
        frame, all_data = [*reader.protocol.frames][-1], map(bytes.fromhex, bytes_.split("|"))
        found[title] = [difference for data in all_data for difference in differences(reader, codec, frame, data)]
    assert {title: one for title, one in found.items() if one} == {}


@needs_compiler
def test_what_is_read_in_another_way_is_told() -> None:
    rows = [*TOLD.values()]
    for (_, bytes_, told), (reader, codec) in zip(rows, readers([definition(text) for text, *_ in rows]), strict=True):
        assert any(problem.what.startswith(told) for problem in reader.file.left_out), told
        good, *_ = bytes_.split("|")
        assert differences(reader, codec, "f", bytes.fromhex(good)) == []


CHECKS = (
    "the check code", "the content of", "is not the value", "stays as it is", "not compared", "not looked at",
    "left out", "less exactly",
)  # fmt: skip
"""Words that a file uses where bad bytes may be read."""


@pytest.mark.long
@needs_compiler
def test_the_bytes_of_every_kind_of_segment() -> None:
    pairs = readers([load_protocol_text(case.yaml) for case in CASES])
    for case, (reader, codec) in zip(CASES, pairs, strict=True):
        assert differences(reader, codec, "f", case.bytes) == [], case.title
        found = [difference for data in case.bad for difference in differences(reader, codec, "f", bytes.fromhex(data))]
        messages = [problem.what for problem in reader.file.left_out if any(word in problem.what for word in CHECKS)]
        assert messages or not found, case.title


@needs_compiler
@pytest.mark.parametrize(
    ("first", "count"),
    [(0, 25), *(pytest.param(at, 100, marks=pytest.mark.long) for at in range(25, many(200, 525), 100))],
)
def test_drawn_definitions(first: int, count: int) -> None:
    """Compare drawn definitions with segments and keys of every kind, with damaged frames.

    Inner frames may be unknown.
    """
    drawn: list[tuple[Protocol, list[bytes]]] = []
    for seed in range(first, first + count):
        definition_ = DrawnDefinition(seed, more=bool(seed % 2), alike=bool(seed % 3))
        try:
            trial = Trial(definition_.text, definition_.values, seed)
            data = trial.built()
        except DefinitionError:
            continue
        if data is not None:
            drawn.append((trial.protocol, [data, *(damaged(data, trial.random) for _ in range(8))]))
    assert len(drawn) > count // 10
    for (_, all_data), (reader, codec) in zip(drawn, readers([protocol for protocol, _ in drawn]), strict=True):
        found = [difference for data in all_data for difference in differences(reader, codec, "f", data)]
        is_reported = any(word in problem.what for problem in reader.file.left_out for word in CHECKS)
        inside = any(frame.inner or frame.name != "f" for frame in reader.protocol.frames.values())
        assert is_reported or inside or not found, reader.file.text


def test_a_definition_with_many_like_names_is_written_in_one_go() -> None:
    """Names that are equal in Kaitai get numbers; each number is found at once."""
    names = ["".join(c.upper() if at >> k & 1 else c for k, c in enumerate("abcdefghijk")) for at in range(1500)]
    body = ", ".join(f"{{field: {name}, type: u8}}, {{require: {name} < 9}}" for name in names)
    made = generate_kaitai(load_protocol_text(f"protocol: case\nframes: {{f: {{body: [{body}]}}}}\n"))
    assert "id: abcdefghijk_1500" in made.text
    assert made.text.count("id: require_") == 1500
