"""The plain functions of both compilers: known vectors, round trips, refusals; their source stands alone."""

from __future__ import annotations

import builtins
import inspect
import math
import struct
from functools import reduce
from operator import or_, xor
from types import FunctionType, ModuleType
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from framekit.codec import ciphers, stuffing, support
from framekit.codec.python import runtime, runtime_diagnosis
from framekit.codec.python.module import outer_names, whole_source

UNITS = bytes.fromhex("12 34 56 78 11 22 33 44")
FLOATS = {
    2: st.floats(width=16, allow_nan=False),
    4: st.floats(width=32, allow_nan=False),
    8: st.floats(width=64, allow_nan=False),
}
ORDERS = ("big", "little", "ABCD", "DCBA", "BADC", "CDAB")
FUNCTIONS: dict[str, FunctionType] = {
    name: value
    for name, value in vars(support).items()
    if isinstance(value, FunctionType) and value.__module__ == support.__name__
}

# --- sums -----------------------------------------------------------------------------------------------------------


@given(st.binary(max_size=300))
def test_sums_by_their_definitions(data: bytes) -> None:
    assert support.xor8(data) == reduce(xor, data, 0)
    assert support.or8(data) == reduce(or_, data, 0)
    assert support.multiply(data) == math.prod(data) % 256


@pytest.mark.parametrize("length", [0, 1, 2, 39, 40, 41, 42, 63, 64, 65, 127, 128, 129, 255, 256, 257])
def test_xor8_at_every_length_where_its_folding_changes(length: int) -> None:
    data = bytes((7 * place + 3) % 251 for place in range(length))
    assert support.xor8(data) == support.xor8(bytearray(data)) == reduce(xor, data, 0)


@given(st.binary(max_size=60))
def test_word_sums_take_an_odd_last_byte_as_a_word_with_00_behind(data: bytes) -> None:
    even = data + b"\0" * (len(data) % 2)
    pairs = range(0, len(even), 2)
    big = sum(int.from_bytes(even[place : place + 2], "big") for place in pairs)
    little = sum(int.from_bytes(even[place : place + 2], "little") for place in pairs)
    assert support.word_sum_big(data) == big % 65536
    assert support.word_sum_little(data, 0xFFFFFFFF) == little


@given(st.binary(max_size=60), st.sampled_from([2, 4]))
def test_xor_of_words(data: bytes, size: int) -> None:
    whole = data + b"\0" * (-len(data) % size)
    words = [whole[place : place + size] for place in range(0, len(whole), size)]
    assert support.xor_words(data, size) == reduce(xor, (int.from_bytes(word, "big") for word in words), 0)
    assert support.xor_words(data, size, True) == reduce(xor, (int.from_bytes(word, "little") for word in words), 0)


def test_multiplying_starts_at_one_and_a_zero_byte_ends_it() -> None:
    assert support.multiply(b"") == 1
    assert support.multiply(b"\x03\x05") == 15
    assert support.multiply(b"\x03\x00\x05") == 0
    assert support.multiply(b"\x10\x10", 3, 0xFFFF) == 0x300


# --- CRC ------------------------------------------------------------------------------------------------------------


def bit_by_bit(data: bytes, width: int, poly: int, init: int, refin: bool, refout: bool, xorout: int) -> int:
    """Compute a CRC literally by the parametrised model: bit by bit, without mirrored tables."""
    register = init
    for byte in data:
        for place in range(8):
            incoming = byte >> (place if refin else 7 - place) & 1
            outgoing = register >> width - 1 & 1
            register = register << 1 & (1 << width) - 1
            if incoming != outgoing:
                register ^= poly
    if refout:
        register = sum((register >> place & 1) << width - 1 - place for place in range(width))
    return register ^ xorout


@st.composite
def crc_parameters(draw: st.DrawFn) -> tuple[int, int, int, bool, bool, int]:
    width = draw(st.integers(1, 64))
    code = st.integers(0, (1 << width) - 1)
    return width, draw(code), draw(code), draw(st.booleans()), draw(st.booleans()), draw(code)


@given(crc_parameters(), st.binary(max_size=12))
def test_table_crc_equals_bit_by_bit(parameters: tuple[int, int, int, bool, bool, int], data: bytes) -> None:
    width, poly, init, refin, refout, xorout = parameters
    table = support.make_crc_table(width, poly, refin)
    assert support.crc(data, table, width, init, refin, refout, xorout) == bit_by_bit(data, *parameters)


@given(st.integers(0, 65535), st.integers(0, 65535), st.binary(max_size=40))
def test_two_bytes_at_once_equal_one_by_one(poly: int, init: int, data: bytes) -> None:
    for refin, by_words in ((True, support.crc16_reflected), (False, support.crc16_forward)):
        table, words = support.make_crc_table(16, poly, refin), support.make_crc_words(poly, refin)
        expected = support.crc_reflected(data, table, init) if refin else support.crc_forward(data, table, 16, init)
        assert by_words(data, words, init) == expected


@given(st.integers(0, 65535), st.binary(max_size=40))
def test_the_librarys_crc_on_mirrored_bytes(init: int, data: bytes) -> None:
    expected = bit_by_bit(data, 16, 0x1021, init, True, True, 0)
    assert support.crc_1021_reflected(data, support.make_mirror(), init) == expected


@given(st.integers(1, 90).flatmap(lambda width: st.tuples(st.just(width), st.integers(0, (1 << width) - 1))))
def test_reflecting_twice_changes_nothing(case: tuple[int, int]) -> None:
    width, value = case
    mirrored = support.reflect(value, width)
    assert mirrored & 1 == value >> width - 1
    assert support.reflect(mirrored, width) == value


# --- digits ---------------------------------------------------------------------------------------------------------

DIGIT_FORMS = [
    (support.build_hex, support.parse_hex, 16, 1),
    (support.build_hex_little, support.parse_hex_little, 16, 2),
    (support.build_dec, support.parse_dec, 10, 1),
    (support.build_oct, support.parse_oct, 8, 1),
]


@pytest.mark.parametrize(("build", "parse", "base", "step"), DIGIT_FORMS)
@given(data=st.data())
def test_digits_round_trip(build: Any, parse: Any, base: int, step: int, data: st.DataObject) -> None:
    places = step * data.draw(st.integers(1, 10))
    value = data.draw(st.integers(0, base**places - 1))
    digits = build(value, places)
    assert len(digits) == places
    assert parse(digits) == parse(bytearray(digits)) == value


@pytest.mark.parametrize(("build", "parse", "base", "step"), DIGIT_FORMS)
def test_digits_refuse_what_does_not_fit(build: Any, parse: Any, base: int, step: int) -> None:
    places = 2 * step
    build(base**places - 1, places)
    for value in (base**places, -1, -(base**places)):
        with pytest.raises(ValueError, match="does not fit"):
            build(value, places)


@pytest.mark.parametrize("parse", [parse for _, parse, _, _ in DIGIT_FORMS])
@pytest.mark.parametrize("digits", [b"", b" 12 ", b"+1", b"-1", b"1_00", b"0x1F", b"1G", b"\xb2\xb3", b"12\n0"])
def test_digits_refuse_everything_else(parse: Any, digits: bytes) -> None:
    with pytest.raises(ValueError, match="is not a number"):
        parse(digits)


def test_digits_as_they_stand_on_the_wire() -> None:
    assert support.build_hex(0xAB, 4) == b"00AB"
    assert support.build_hex_little(0x12AB, 4) == b"AB12"
    assert support.build_oct(8, 3) == b"010"
    assert support.parse_hex(b"aB") == 0xAB
    assert support.parse_hex_little(b"aB12") == 0x12AB
    with pytest.raises(ValueError):
        support.parse_oct(b"18")


def test_pairs_of_digits_need_an_even_number_of_places() -> None:
    with pytest.raises(ValueError):
        support.build_hex_little(1, 3)
    with pytest.raises(ValueError):
        support.parse_hex_little(b"123")


# --- other number forms ---------------------------------------------------------------------------------------------


@given(st.integers(1, 8).flatmap(lambda size: st.tuples(st.just(size), st.integers(0, 100**size - 1))))
def test_bcd_round_trip(case: tuple[int, int]) -> None:
    size, value = case
    data = support.build_bcd(value, size)
    assert len(data) == size
    assert data.hex() == f"{value:0{2 * size}d}"
    assert support.parse_bcd(data) == value


def test_bcd_refuses() -> None:
    for value in (10000, -1, -99999):
        with pytest.raises(ValueError, match="does not fit"):
            support.build_bcd(value, 2)
    for data in (b"\x1a", b"\xa1", b""):
        with pytest.raises(ValueError, match="is not BCD"):
            support.parse_bcd(data)


@given(st.binary(max_size=20))
def test_nibbles_round_trip(data: bytes) -> None:
    nibbles = support.split_nibbles(data)
    assert nibbles == bytes(0x30 + half for byte in data for half in (byte >> 4, byte & 15))
    assert support.join_nibbles(nibbles) == data


def test_nibbles_of_a_number_high_one_first() -> None:
    assert support.build_nibbles(0x1AF9, 2) == bytes.fromhex("31 3A 3F 39")
    assert support.parse_nibbles(bytes.fromhex("31 3A 3F 39")) == 0x1AF9
    with pytest.raises(OverflowError):
        support.build_nibbles(256, 1)


@pytest.mark.parametrize("nibbles", [b"4", b"4A", b"4a", b"4@", b"/0"])
def test_nibbles_refuse_letters_and_odd_counts(nibbles: bytes) -> None:
    with pytest.raises(ValueError):
        support.join_nibbles(nibbles)


@pytest.mark.parametrize(
    ("order", "four", "eight"),
    [
        ("ABCD", "12 34 56 78", "12 34 56 78 9A BC DE F0"),
        ("DCBA", "78 56 34 12", "F0 DE BC 9A 78 56 34 12"),
        ("BADC", "34 12 78 56", "34 12 78 56 BC 9A F0 DE"),
        ("CDAB", "56 78 12 34", "DE F0 9A BC 56 78 12 34"),
    ],
)
def test_orders_of_words_and_bytes(order: str, four: str, eight: str) -> None:
    assert support.build_int(0x12345678, 4, order) == bytes.fromhex(four)
    assert support.build_int(0x123456789ABCDEF0, 8, order) == bytes.fromhex(eight)


def test_orders_of_a_single_word_and_unknown_ones() -> None:
    assert [support.build_int(0x1234, 2, order).hex() for order in ("BADC", "CDAB")] == ["3412", "1234"]
    with pytest.raises(ValueError, match="no byte order 'middle'"):
        support.reorder(b"1234", "middle")


@given(st.sampled_from([2, 4, 8]), st.sampled_from(ORDERS), st.booleans(), st.data())
def test_integers_round_trip(size: int, order: str, signed: bool, data: st.DataObject) -> None:
    bits = 8 * size - signed
    value = data.draw(st.integers(-(1 << bits) if signed else 0, (1 << bits) - 1))
    built = support.build_int(value, size, order, signed)
    assert len(built) == size
    assert support.parse_int(built, order, signed) == value
    with pytest.raises(OverflowError):
        support.build_int(1 << bits, size, order, signed)


@given(st.sampled_from([2, 4, 8]), st.sampled_from(ORDERS), st.data())
def test_floats_round_trip(size: int, order: str, data: st.DataObject) -> None:
    value = data.draw(FLOATS[size])
    assert support.parse_float(support.build_float(value, size, order), order) == value


def test_floats_as_they_stand_on_the_wire() -> None:
    assert support.build_float(1.5, 4, "CDAB") == bytes.fromhex("00 00 3F C0")
    assert support.build_float(1.5, 4, "DCBA") == struct.pack("<f", 1.5)
    assert math.isnan(support.parse_float(support.build_float(math.nan, 4, "BADC"), "BADC"))
    with pytest.raises(OverflowError):
        support.build_float(1e39, 4, "ABCD")


# --- text -----------------------------------------------------------------------------------------------------------

LATIN = st.text(st.characters(max_codepoint=255), max_size=12)


@given(LATIN, st.sampled_from([b"\0", b"\r", b"\r\n", b"\r\r"]), st.binary(max_size=4))
def test_terminated_text_round_trip(text: str, end: bytes, rest: bytes) -> None:
    try:
        data = support.build_terminated(text, end)
    except ValueError:
        assert (text.encode("latin-1") + end).find(end) < len(text)
        return
    assert (data + rest).index(end) == len(text)


# --- conversion, swap, escape ---------------------------------------------------------------------------------------


def test_conversions_of_the_guide() -> None:
    assert support.hex_to_ascii(b"\x12\xab") == b"12AB"
    assert support.ascii_to_hex(b"4567") == b"\x45\x67"
    assert support.ascii_to_hex(b"aBcD") == b"\xab\xcd"


@pytest.mark.parametrize("digits", [b"123", b"1G", b"12 34", b" 1", b"0x", b"\xff\xff"])
def test_conversion_refuses_odd_counts_and_other_bytes(digits: bytes) -> None:
    with pytest.raises(ValueError):
        support.ascii_to_hex(digits)


@given(st.binary())
def test_conversion_round_trip(data: bytes) -> None:
    assert support.ascii_to_hex(support.hex_to_ascii(data)) == data


@pytest.mark.parametrize(
    ("size", "swapped"),
    [(2, "34 12 78 56 22 11 44 33"), (4, "78 56 34 12 44 33 22 11"), (8, "44 33 22 11 78 56 34 12")],
)
def test_swap_table_of_the_guide(size: int, swapped: str) -> None:
    assert support.swap(UNITS, size) == bytes.fromhex(swapped)


@given(st.binary(max_size=40), st.sampled_from([2, 4, 8]))
def test_swap_keeps_the_rest_and_undoes_itself(data: bytes, size: int) -> None:
    swapped = support.swap(data, size)
    whole = len(data) // size * size
    assert swapped[whole:] == data[whole:]
    units = [data[place : place + size] for place in range(0, whole, size)]
    assert swapped[:whole] == b"".join(unit[::-1] for unit in units)
    assert support.swap(bytearray(swapped), size) == data


@given(st.lists(st.sampled_from([0x10, 0x11, 0x03]), max_size=12).map(bytes))
def test_escape_round_trip(data: bytes) -> None:
    doubled = stuffing.stuff(data, 0x10)
    assert len(doubled) == len(data) + data.count(0x10)
    assert stuffing.unstuff(doubled, b"\x10", b"\x10\x10") == data


@pytest.mark.parametrize("data", [b"\x10", b"\x10A\x10", b"\x10\x10\x10", b"A\x10\x10\x10\x10\x10B"])
def test_an_escape_byte_that_is_not_doubled(data: bytes) -> None:
    with pytest.raises(ValueError, match="10 is not doubled"):
        stuffing.unstuff(data, b"\x10", b"\x10\x10")


# --- functions of expressions ---------------------------------------------------------------------------------------


def test_digits_and_number() -> None:
    assert support.digits(10, 2) == "0A"
    assert support.digits(7, 3, 10) == "007"
    assert support.digits(8, 3, 8) == "010"
    assert support.digits(5, 8, 2) == "00000101"
    assert support.number("12") == support.number(b"12") == 12
    assert support.number("1f", 16) == support.number(b"1F", 16) == 31
    for n, width, base in ((256, 2, 16), (-1, 2, 16), (1, 2, 7)):
        with pytest.raises(ValueError):
            support.digits(n, width, base)


@pytest.mark.parametrize("text", ["", " 1", "1 ", "+1", "-1", "1_0", "0x1", "1.0", "٣", b"\xb2"])
def test_number_takes_digits_only(text: str | bytes) -> None:
    with pytest.raises(ValueError, match="is not a number of base"):
        support.number(text, 10)


@given(st.integers(0, 10**6), st.sampled_from([2, 8, 10, 16]))
def test_digits_and_number_round_trip(n: int, base: int) -> None:
    assert support.number(support.digits(n, 20, base), base) == n


def test_bits() -> None:
    assert [support.bit(0b1010, n) for n in range(5)] == [0, 1, 0, 1, 0]
    assert support.rotl8(0x81, 1) == 0x03
    assert support.rotl8(0x81, 8) == 0x81
    assert support.rotl8(0x181, 0) == 0x81


@given(st.integers(0, 255), st.integers(0, 20), st.integers(0, 20))
def test_rotations_add_up(x: int, first: int, second: int) -> None:
    assert support.rotl8(support.rotl8(x, first), second) == support.rotl8(x, first + second)


def test_lists_and_tables() -> None:
    assert support.same([]) and support.same(["W"]) and support.same(["W", "W"])
    assert not support.same(["W", "W", "D"])
    assert support.same([{"a": 1}, {"a": 1}])
    table = {2: "x", 0: "x", 1: "y"}
    assert (support.find(table, "x"), support.find_last(table, "x")) == (0, 2)
    assert (support.find(table, "y"), support.find_last(table, "y")) == (1, 1)
    assert support.find(table, "z") is None and support.find_last(table, "z") is None
    assert support.either(0, 5) == 0 and support.either(None, 5) == 5


def test_free_keys_of_tables() -> None:
    class Limited(dict[int, int]):
        limits = (1, 3)

    assert support.free({}) == 0
    assert support.free({0: "", 1: "", 3: ""}) == 2
    assert support.free(Limited()) == 1
    assert support.free(Limited({1: 0, 2: 0, 3: 0})) is None


def test_only() -> None:
    assert support.only("12AB", "0123456789ABCDEF") and support.only("", "AB") and support.only(b"10", b"01")
    assert not support.only("1xA", "1A") and not support.only("A", "")


@given(st.integers(0, 100), st.integers(0, 100))
def test_span_counts_the_bytes_that_are_touched(bit: int, count: int) -> None:
    assert support.span(bit, count) == len({number // 8 for number in range(bit, bit + count)})


# --- source that stands alone ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_uses_nothing_but_functions_of_its_module_and_imports(name: str) -> None:
    carried = {*FUNCTIONS, "Unfit", "Any", "Decimal", "array", "binascii", "byteorder", "re", "struct"}
    assert set(outer_names(FUNCTIONS[name])) <= carried | set(vars(builtins))
    assert inspect.getdoc(FUNCTIONS[name])


@pytest.mark.parametrize(
    "module", [support, stuffing, ciphers, runtime, runtime_diagnosis], ids=lambda one: one.__name__
)
def test_the_source_of_a_helper_is_that_of_its_file(module: ModuleType) -> None:
    for name, value in vars(module).items():
        if isinstance(value, FunctionType | type) and value.__module__ == module.__name__:
            assert whole_source(value) == inspect.getsource(value), name


def test_inlined_source_runs() -> None:
    inlined = ["from array import array", "from typing import Any", "import struct"]
    inlined += [inspect.getsource(FUNCTIONS[name]) for name in ("swap", "reorder", "build_float")]
    names: dict[str, Any] = {}
    exec("\n".join(inlined), names)
    assert names["build_float"](1.5, 4, "CDAB") == bytes.fromhex("00 00 3F C0")
