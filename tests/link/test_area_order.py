"""Areas whose words do not begin with the low byte, and elements at any byte: in clients, devices and memory."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link.service_loop import Loop

from framekit.link.addresses import AddressError
from framekit.link.packing import in_unit
from framekit.link.services.client import TransferResult
from framekit.memory.memory import Area, DeviceMemory, MemoryValueError, OrderedArea, ordered

PROTOCOL = """
protocol: blocks
order: big
station: {type: none}
groups:
  request: {from: client, head: [{field: kind, type: u8}], tail: [{check: sum8}]}
  reply: {from: server, head: [{const: 06}], tail: [{check: sum8}]}
frames:
  READ: {group: request, where: {kind: 1}, body: [{field: place, type: u16}, {field: count, type: u8}]}
  WRITE:
    group: request
    where: {kind: 2}
    body: [{field: place, type: u16}, {length: n, type: u8, of: [values]}, {data: values, size: n}]
  READ_WORDS: {group: request, where: {kind: 3}, body: [{field: place, type: u16}, {field: count, type: u8}]}
  VALUES: {group: reply, body: [{length: n, type: u8, of: [values]}, {data: values, size: n}]}
areas:
  DB: {unit: byte, size: 100, order: ORDER}
  W:  {unit: word, size: 50, order: ORDER}
tables: {letters: {W: word, D: dword}}
addresses:
  - {form: "{area}{start:dec}"}
  - {form: "DB{unit}{start:dec}", area: DB, unit: letters, counts: byte}
  - {form: "DB{byte:dec}.{bit:dec:1}", area: DB, unit: bit, start: byte * 8 + bit}
services:
  read:
    - areas: [DB]
      units: [byte]
      limit: {count: 100}
      request: {READ: {place: start, count: count}}
      reply: {VALUES: {values: data}}
    - areas: [W]
      units: [word]
      limit: {count: 50}
      request: {READ_WORDS: {place: start, count: count}}
      reply: {VALUES: {values: data}}
      packing: {order: big}
  write:
    - areas: [DB]
      units: [byte]
      limit: {count: 100}
      request: {WRITE: {place: start, values: data}}
      reply: {VALUES: {values: h''}}
"""
ORDERS = ("big", "little", "CDAB", "BADC")
FORMS = {"big": ">", "little": "<"}


def loop(order: str, **keys: Any) -> Loop:
    return Loop(PROTOCOL.replace("ORDER", order), **keys)


def read(loop: Loop, address: str, **keys: Any) -> TransferResult:
    done: list[TransferResult] = []
    loop.client.read(address, now=0, on_done=done.append, **keys)
    return done[0]


def write(loop: Loop, address: str, values: list[int], **keys: Any) -> TransferResult:
    done: list[TransferResult] = []
    loop.client.write(address, values, now=0, on_done=done.append, **keys)
    return done[0]


def test_bytes_words_and_double_words_of_one_memory() -> None:
    one = loop("big")
    one.memory.write("DB", "byte", 0, [0x12, 0x34, 0x56, 0x78, 0x9A])
    assert one.memory.read("DB", "word", 0, 2) == [0x1234, 0x5678]
    assert read(one, "DB0", unit="word", count=2).values == [0x1234, 0x5678]
    assert read(one, "DB1", unit="word").values == [0x3456]  # a word at an odd byte
    assert read(one, "DB0", unit="dword").values == [0x12345678]
    assert read(one, "DB1", unit="dword").values == [0x3456789A]  # and a double word
    assert read(one, "DB0", count=3).values == [0x12, 0x34, 0x56]
    assert read(one, "DB1.2").values == [1]
    assert one.log[0][1].hex(" ").startswith("06 04 12 34 56 78")


def test_what_is_written_stands_as_the_device_has_it() -> None:
    one = loop("big")
    assert write(one, "DB1", [0x1234, -2], unit="word").ok
    assert one.memory.read("DB", "byte", 0, 6) == [0, 0x12, 0x34, 0xFF, 0xFE, 0]
    assert write(one, "DB8", [0x01020304], unit="dword").ok
    assert one.memory.read("DB", "byte", 8, 4) == [1, 2, 3, 4]
    assert one.memory.read("DB", "dword", 2) == [0x01020304]


def test_bytes_of_an_area_that_is_read_by_words() -> None:
    one = loop("big")
    one.memory.write("W", "word", 0, [0x1234, 0x5678])
    assert read(one, "W0", count=2).values == [0x1234, 0x5678]
    assert read(one, "W0", unit="byte", count=3).values == [0x12, 0x34, 0x56]
    assert read(one, "W0", unit="dword").values == [0x12345678]
    assert read(one, "W0", unit="dword").data == b"\x78\x56\x34\x12"


def test_an_element_may_begin_at_any_byte() -> None:
    one = loop("big")
    one.memory.write("DB", "byte", 0, [0x12, 0x34, 0x56, 0x78, 0x9A, 0xBC])
    assert read(one, "DBW1").values == [0x3456]
    assert read(one, "DBW0", count=3).values == [0x1234, 0x5678, 0x9ABC]
    assert read(one, "DBW1", count=2).values == [0x3456, 0x789A]
    assert read(one, "DBD1").values == [0x3456789A]
    assert read(one, "DBW1", unit="dword").values == [0x3456789A]
    assert read(one, "DBW1", unit="byte", count=2).values == [0x34, 0x56]
    assert write(one, "DBW3", [0xAABB]).ok
    assert write(one, "DBD91", [0x01020304]).ok
    assert one.memory.read("DB", "byte", 2, 4) == [0x56, 0xAA, 0xBB, 0xBC]
    assert one.memory.area("DB").read_from(91 * 8, "dword") == [0x01020304]
    one.memory.area("DB").write_from(31 * 8, "word", [0x5566])
    assert read(one, "DB31", count=2).values == [0x55, 0x66]


def test_addresses_of_elements_at_any_byte() -> None:
    grammar = loop("big").client.grammar
    place = grammar.parse("DBW3")
    assert (place.unit, place.start, place.shift, place.first_bit) == ("word", 1, 8, 24)
    assert grammar.print(place) == "DBW3"
    assert grammar.print(grammar.advance(place, 2)) == "DBW7"
    assert grammar.in_unit(place, "byte").start == 3
    with pytest.raises(AddressError, match="DBW3 is not at the start of a dword"):
        grammar.in_unit(place, "dword")
    grammar.parse("DBW98")
    for text in ("DBW99", "DBD97"):
        with pytest.raises(AddressError, match="is not in area DB"):
            grammar.parse(text)


@pytest.mark.parametrize("order", ORDERS)
def test_a_memory_that_keeps_words_as_a_run_does(order: str) -> None:
    memory = DeviceMemory([Area("R", size=60)])
    memory.write("R", "word", 10, [0x1234, 0x5678])
    one = loop(order, memory=memory, mapping={"DB": ("R", 20), "W": ("R", 10)})
    assert read(one, "DB0", unit="word", count=2).values == [0x1234, 0x5678]
    assert read(one, "W0", count=2).values == [0x1234, 0x5678]
    first = [0x12, 0x34] if order in ("big", "CDAB") else [0x34, 0x12]
    assert read(one, "DB0", count=2).values == first
    assert write(one, "DB3", [0xAA]).ok
    changed = 0x56AA if order in ("big", "CDAB") else 0xAA78
    assert memory.read("R", "word", 10, 3) == [0x1234, changed, 0]
    assert write(one, "DB1", [1, 2]).ok
    assert read(one, "DB0", count=4).values == [first[0], 1, 2, 0xAA]


@given(st.sampled_from(ORDERS), st.integers(0, 90), st.sampled_from(["word", "dword", "lword"]), st.data())
def test_what_is_written_is_read_wherever_it_begins(order: str, start: int, unit: str, data: st.DataObject) -> None:
    one = loop(order)
    width = {"word": 2, "dword": 4, "lword": 8}[unit]
    values = data.draw(
        st.lists(st.integers(0, (1 << 8 * width) - 1), min_size=1, max_size=max(1, (100 - start) // width))
    )
    assert write(one, f"DB{start}", values, unit=unit).ok
    assert read(one, f"DB{start}", unit=unit, count=len(values)).values == values
    if order in FORMS:
        raw = bytes(one.memory.read("DB", "byte", start, width * len(values)))
        cut = [raw[at : at + width] for at in range(0, len(raw), width)]
        assert [int.from_bytes(part, "big" if order == "big" else "little") for part in cut] == values


@given(st.sampled_from(ORDERS), st.binary(min_size=8, max_size=8), st.sampled_from(["byte", "word", "dword", "lword"]))
def test_units_and_back(order: str, data: bytes, unit: str) -> None:
    assert in_unit(in_unit(data, order, "byte", unit), order, unit, "byte") == data
    assert ordered(ordered(data, order, 4), order, 4) == data


def test_values_that_do_not_fit_are_refused() -> None:
    area = OrderedArea("A", size=4, order="big")
    with pytest.raises(MemoryValueError):
        area.write("word", 0, [0x10000])
    assert area.read("word", 0, 4) == [0, 0, 0, 0]


@pytest.mark.parametrize("order", ["big", "CDAB", "BADC"])
def test_a_memory_of_an_odd_number_of_bytes_is_written_to_its_end(order: str) -> None:
    memory = DeviceMemory([Area("M", size=5, unit="byte")])
    one = loop(order, memory=memory, mapping={"DB": ("M", 0)})
    for place in range(5):
        assert write(one, f"DB{place}", [place + 1]).ok
    assert read(one, "DB0", count=5).values == [1, 2, 3, 4, 5]
    assert memory.read("M", "byte", 0, 5) == ([1, 2, 3, 4, 5] if order == "BADC" else [2, 1, 4, 3, 5])
    assert not write(one, "DB5", [6]).ok
