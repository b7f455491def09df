from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from framekit.memory.memory import (
    AccessError,
    Area,
    DeviceMemoryError,
    MemoryRangeError,
    MemoryValueError,
    pack_bits,
    unit_bits,
    unpack_bits,
)
from framekit.memory.views import as_signed, float_view

UNITS = {"bit": 1, "byte": 8, "word": 16, "dword": 32, "lword": 64, "3 bytes": 24}
SIZE = 12  # words


def model_read(bits: list[int], width: int, start: int, count: int) -> list[int]:
    """Return the elements that an area of these bits must have.

    Element i has the bits from i·width on, least significant first.
    """
    return [
        sum(bit << place for place, bit in enumerate(bits[at * width : (at + 1) * width]))
        for at in range(start, start + count)
    ]


@st.composite
def writes(draw: st.DrawFn) -> tuple[str, int, list[int]]:
    unit = draw(st.sampled_from(sorted(UNITS)))
    size = SIZE * 16 // UNITS[unit]
    start = draw(st.integers(0, size))
    value = st.integers(0, (1 << UNITS[unit]) - 1)
    return unit, start, draw(st.lists(value, max_size=min(size - start, 40)))


@given(st.lists(writes(), max_size=8))
def test_every_view_agrees_with_a_model_of_single_bits(history: list[tuple[str, int, list[int]]]) -> None:
    area = Area("M", size=SIZE)
    bits = [0] * (SIZE * 16)
    for unit, start, values in history:
        area.write(unit, start, values)
        width = UNITS[unit]
        for number, value in enumerate(values, start):
            bits[number * width : (number + 1) * width] = [value >> place & 1 for place in range(width)]
    for unit, width in UNITS.items():
        size = SIZE * 16 // width
        assert area.read(unit, 0, size) == model_read(bits, width, 0, size)
    assert list(area.read_bytes(0, 2 * SIZE)) == model_read(bits, 8, 0, 2 * SIZE)


@given(st.lists(st.integers(0, 1), min_size=SIZE * 16, max_size=SIZE * 16), st.data())
def test_packed_bits_move_any_stretch(bits: list[int], data: st.DataObject) -> None:
    source, target = Area("S", size=SIZE), Area("T", size=SIZE)
    source.write("bit", 0, bits)
    target.write("byte", 0, [0xFF] * (2 * SIZE))
    start = data.draw(st.integers(0, SIZE * 16))
    count = data.draw(st.integers(0, SIZE * 16 - start))
    to = data.draw(st.integers(0, SIZE * 16 - count))
    packed = source.read_bits(start, count)
    assert packed == pack_bits(bits[start : start + count])
    target.write_bits(to, count, packed)
    assert target.read("bit", 0, SIZE * 16) == [1] * to + bits[start : start + count] + [1] * (SIZE * 16 - to - count)


def test_places_are_counted_as_the_field_counts_them() -> None:
    area = Area("M", size=8)
    area.write("word", 1, [0x1234])
    assert area.read("byte", 2, 2) == [0x34, 0x12]
    area.write_bytes(0, bytes(16))
    area.write_bits(17, 1, b"\x01")
    assert area.read("word", 1) == [0x0002]
    assert area.read_bit(17) and not area.read_bit(16)
    area.write("dword", 2, [0xAABBCCDD])
    assert area.read("word", 4, 2) == [0xCCDD, 0xAABB]
    area.write("lword", 1, [0x1111222233334444])
    assert area.read("word", 4, 4) == [0x4444, 0x3333, 0x2222, 0x1111]


def test_readers_for_again_and_again_see_what_is_there_then() -> None:
    area = Area("D", size=4)
    two, one, beyond = area.bytes_reader(2, 2), area.byte_reader(3), area.bytes_reader(6, 4)
    for word in (0x1234, 0xFFFF, 0):
        area.write("word", 1, [word])
        assert (two(), one()) == (word.to_bytes(2, "little"), word >> 8)
    area.write_bytes(0, bytes(range(8)))
    assert (two(), one()) == (b"\x02\x03", 3)
    assert isinstance(two(), bytes)
    with pytest.raises(MemoryRangeError):
        beyond()


def test_elements_of_odd_size() -> None:
    timers = Area("T", size=3, unit="6 bytes")
    assert (timers.size_bytes, timers.unit, Area("T", size=3, unit=6).unit) == (18, "6 bytes", "6 bytes")
    timers.write("word", 4, [0xBEEF])  # element 1, second word
    assert timers.read("6 bytes", 0, 3) == [0, 0xBEEF0000, 0]
    timers.write(6, 2, [1 << 47])
    assert timers.read("byte", 17) == [0x80]
    with pytest.raises(MemoryRangeError, match="lword 2 is not in area T, which has lword 0 to 1"):
        timers.read("lword", 2)


def test_area_of_bits_keeps_to_its_size() -> None:
    coils = Area("Q", size=13, unit="bit")
    assert (coils.size_bytes, coils.size_words) == (2, 1)
    coils.write("bit", 0, [1] * 13)
    coils.write_bytes(0, b"\xff\xff")
    assert coils.read_bytes(0, 2) == b"\xff\x1f"
    for start, count in ((13, 1), (0, 14), (-1, 1), (0, -1)):
        with pytest.raises(MemoryRangeError):
            coils.read("bit", start, count)
    with pytest.raises(MemoryRangeError):
        coils.read("byte", 1)
    with pytest.raises(MemoryRangeError):
        coils.read_bit(13)
    with pytest.raises(MemoryRangeError):
        coils.write_bits(-1, 1, b"\x01")


@pytest.mark.parametrize(
    ("unit", "start", "values"),
    [
        ("word", 4, [0]),
        ("word", 3, [0, 0]),
        ("word", -1, [0]),
        ("lword", 1, [0]),
        ("bit", 64, [0]),
        ("byte", 7, [0, 0]),
    ],
)
def test_nothing_is_written_beyond_the_area(unit: str, start: int, values: list[int]) -> None:
    area = Area("M", size=4)
    with pytest.raises(MemoryRangeError, match="is not in area M"):
        area.write(unit, start, values)
    with pytest.raises(IndexError):
        area.write_bytes(7, b"ab")
    with pytest.raises(LookupError):
        area.read_bytes(0, 9)
    assert area.read_bytes(0, 8) == bytes(8)


@pytest.mark.parametrize(
    ("unit", "bad"), [("bit", 2), ("bit", -1), ("byte", 256), ("word", -1), ("dword", 1 << 32), ("3 bytes", 1 << 24)]
)
def test_a_value_that_does_not_fit_spoils_the_whole_write(unit: str, bad: int) -> None:
    area = Area("M", size=8)
    with pytest.raises(MemoryValueError, match=str(bad)):
        area.write(unit, 0, [1, bad])
    assert area.read_bytes(0, 16) == bytes(16)


def test_only_the_owner_writes_a_read_only_area() -> None:
    area = Area("F", size=4, access="read")
    for write in (
        lambda: area.write("word", 0, [1]),
        lambda: area.write("bit", 0, [1]),
        lambda: area.write_bytes(0, b"\1"),
        lambda: area.write_bits(0, 1, b"\x01"),
        lambda: area.write_bits(0, 1, b"\1"),
    ):
        with pytest.raises(AccessError, match="area F can only be read"):
            write()
    assert area.read_bytes(0, 8) == bytes(8)
    area.write("word", 0, [1], force=True)
    area.write_bits(17, 1, b"\x01", force=True)
    area.write_bits(32, 2, b"\3", force=True)
    area.write_bytes(6, b"\4", force=True)
    assert area.read("word", 0, 4) == [1, 2, 3, 4]


def test_short_packed_bits_and_bad_shapes_are_refused() -> None:
    with pytest.raises(MemoryValueError):
        Area("M", size=4).write_bits(0, 9, b"\1")
    with pytest.raises(ValueError, match="no size"):
        Area("M", size=0)
    for unit in ("words", "0 bytes", "x bytes", "", "6 byte s"):
        with pytest.raises(ValueError, match="unit"):
            unit_bits(unit)
    assert issubclass(MemoryRangeError, DeviceMemoryError)


@given(st.sampled_from(["byte", "word", "dword", "lword", "6 bytes"]), st.data())
def test_signed_numbers(unit: str, data: st.DataObject) -> None:
    half = 1 << (unit_bits(unit) - 1)
    values = data.draw(st.lists(st.integers(-half, half - 1)))
    assert as_signed([value & (2 * half - 1) for value in values], unit) == values


@given(st.lists(st.floats(width=32, allow_nan=False)))
def test_floating_point_numbers_round_trip(values: list[float]) -> None:
    for unit in ("dword", "lword"):
        assert float_view(unit).read(float_view(unit).write(values)) == values


def test_floating_point_limits() -> None:
    assert float_view("dword").write([1.0]) == bytes.fromhex("0000803F")
    with pytest.raises(MemoryValueError):
        float_view("dword").write([1e300])
    with pytest.raises(ValueError, match="floating-point"):
        float_view("word")


@given(st.lists(st.integers(0, 1)))
def test_bits_pack_and_unpack(bits: list[int]) -> None:
    packed = pack_bits(bits)
    assert len(packed) == -(-len(bits) // 8)
    assert unpack_bits(packed, len(bits)) == bits
    assert unpack_bits(packed, len(bits) + 5) == bits + [0] * 5
