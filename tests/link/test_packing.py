"""Packing of elements: the forms of the language, sizes, and lossless round trips."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from framekit.definition.model.services import Packing
from framekit.link.packing import Packer, PackingError, cut_memory, join_memory, memory_of, values_of
from framekit.memory.memory import unit_bits

UNITS = ["bit", "byte", "word", "dword", "lword", "6 bytes", "3 bytes"]


def packer(unit: str, order: str = "little", bits: str = "packed") -> Packer:
    return Packer(Packing(order=order, bits=bits), unit)  # type: ignore[arg-type]


def packed(values: list[int], unit: str, start: int = 0, **packing: str) -> bytes:
    return packer(unit, **packing).to_data(memory_of(values, unit), start, len(values))


@pytest.mark.parametrize(
    ("unit", "order", "values", "data"),
    [
        ("byte", "big", [1, 2, 3], "01 02 03"),
        ("word", "big", [0x1234, 0x5678], "12 34 56 78"),
        ("word", "little", [0x1234, 0x5678], "34 12 78 56"),
        ("dword", "big", [0x12345678], "12 34 56 78"),
        ("dword", "little", [0x12345678], "78 56 34 12"),
        ("lword", "big", [0x1122334455667788], "11 22 33 44 55 66 77 88"),
        ("6 bytes", "big", [0x112233445566, 1], "11 22 33 44 55 66 00 00 00 00 00 01"),
        ("6 bytes", "little", [0x112233445566], "66 55 44 33 22 11"),
        ("word", "big", [-2], "FF FE"),
    ],
)
def test_the_order_is_that_of_one_unit(unit: str, order: str, values: list[int], data: str) -> None:
    assert packed(values, unit, order=order) == bytes.fromhex(data)


@pytest.mark.parametrize(
    ("bits", "start", "values", "data"),
    [
        ("packed", 0, [1, 0, 1, 1, 0, 0, 1, 1, 1], "CD 01"),
        ("packed", 3, [1, 0, 1, 1, 0, 0, 1, 1, 1], "CD 01"),
        ("aligned", 0, [1, 0, 1], "05"),
        ("aligned", 2, [1, 0, 1, 1, 0, 1], "B4"),
        ("aligned", 6, [1, 1, 1], "C0 01"),
        ("aligned", 15, [1, 1], "80 01"),
        ("byte_each", 5, [1, 0, 1], "01 00 01"),
        ("nibble_each", 5, [1, 0, 1, 1], "10 11"),
        ("nibble_each", 5, [1, 0, 1], "10 10"),
        ("nibble_each", 0, [], ""),
        ("digit_each", 5, [1, 0, 1], "31 30 31"),
    ],
)
def test_the_forms_of_bits(bits: str, start: int, values: list[int], data: str) -> None:
    assert packed(values, "bit", start, bits=bits) == bytes.fromhex(data)


def test_padding_bits_of_an_answer_do_not_count() -> None:
    assert packer("bit", bits="aligned").to_memory(b"\xff", 2, 3) == b"\x07"
    assert packer("bit").to_memory(b"\xff", 0, 3) == b"\x07"
    assert packer("bit", bits="nibble_each").to_memory(b"\x11\x1f", 0, 3) == b"\x07"


def test_how_much_fits() -> None:
    assert packer("word").most(0, 121) == 60
    assert packer("bit").most(5, 10) == 80
    assert packer("bit", bits="aligned").most(5, 10) == 75
    assert packer("bit", bits="aligned").most(5, 0) == 0
    assert packer("bit", bits="byte_each").most(0, 10) == 10
    assert packer("bit", bits="nibble_each").most(5, 10) == 20
    assert packer("bit", bits="digit_each").most(5, 10) == 10
    assert packer("6 bytes").count_in(0, 18) == 3
    with pytest.raises(PackingError, match="no whole number"):
        packer("6 bytes").count_in(0, 20)


@pytest.mark.parametrize(
    ("unit", "bits", "data", "count"),
    [
        ("word", "packed", b"\1\2\3", 1),
        ("word", "packed", b"", 1),
        ("bit", "packed", b"\1\2", 8),
        ("bit", "byte_each", b"\2", 1),
        ("bit", "nibble_each", b"\x20", 1),
        ("bit", "nibble_each", b"\x12", 2),
        ("bit", "nibble_each", b"\x10\x10", 2),
        ("bit", "digit_each", b"2", 1),
        ("bit", "digit_each", b"\1", 1),
        ("bit", "digit_each", b"1 ", 2),
    ],
)
def test_data_that_do_not_hold_what_was_asked_are_refused(unit: str, bits: str, data: bytes, count: int) -> None:
    with pytest.raises(PackingError):
        packer(unit, bits=bits).to_memory(data, 0, count)


@pytest.mark.parametrize(
    ("unit", "value"), [("bit", 2), ("byte", 256), ("word", -32769), ("dword", 1 << 32), ("word", "7")]
)
def test_values_that_do_not_fit_are_refused(unit: str, value: int) -> None:
    with pytest.raises(PackingError):
        memory_of([value], unit)


@given(
    st.sampled_from(UNITS), st.sampled_from(["big", "little"]),
    st.sampled_from(["packed", "aligned", "byte_each", "nibble_each", "digit_each"]), st.integers(0, 40), st.data(),
)  # fmt: skip
def test_there_and_back(unit: str, order: str, bits: str, start: int, data: st.DataObject) -> None:
    values = data.draw(st.lists(st.integers(0, (1 << unit_bits(unit)) - 1), max_size=40))
    one = packer(unit, order, bits)
    sent = one.to_data(memory_of(values, unit), start, len(values))
    assert len(sent) == one.size(start, len(values))
    assert values_of(one.to_memory(sent, start, len(values)), unit, len(values)) == values
    assert one.most(start, len(sent)) >= len(values)


@given(st.lists(st.lists(st.integers(0, 1), max_size=20), max_size=6), st.data())
def test_pieces_joined_and_cut_are_the_whole(pieces: list[list[int]], data: st.DataObject) -> None:
    whole = [bit for piece in pieces for bit in piece]
    memory = join_memory([(memory_of(piece, "bit"), len(piece)) for piece in pieces])
    assert values_of(memory, "bit", len(whole)) == whole
    first = data.draw(st.integers(0, len(whole)))
    count = data.draw(st.integers(0, len(whole) - first))
    assert values_of(cut_memory(memory, first, count), "bit", count) == whole[first : first + count]
