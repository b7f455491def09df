"""Types of variables: initial values, and the values that fit."""

from __future__ import annotations

import pytest

from framekit.link.variables import StateTable, empty_of, fit_of


def test_bytes_of_a_size_are_zeros_and_take_nothing_else() -> None:
    assert empty_of("bytes", 6) == bytes(6)
    fit = fit_of("bytes", size=4)
    assert fit(bytearray(b"abcd")) == b"abcd"
    for wrong in (b"abc", b"abcde", "abcd", 4):
        with pytest.raises(TypeError):
            fit(wrong)


def test_numbers_wrap_at_their_width() -> None:
    assert fit_of("u8")(0x1FF) == 0xFF
    assert fit_of("i8")(0x80) == -128
    assert empty_of("u8") == 0


def test_a_table_has_room_for_the_keys_of_its_range() -> None:
    table = StateTable((1, 3), fit_of("u8"), None)
    table.put(2, 7)
    assert table[2] == 7 and table.get(1) is None
    with pytest.raises(ValueError, match="is not a key"):
        table.put(4, 1)
