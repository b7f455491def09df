"""Views: the same words read as other types; a written value is read back, in every order."""

from __future__ import annotations

import math
import struct
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spread import spread

from framekit.memory.memory import MemoryValueError
from framekit.memory.views import ORDERS, VIEWS, NumberView, TextView, view_of

NUMBERS = [name for name in VIEWS if name != "string"]
FORMATS = {"signed": "bhiq", "unsigned": "BHIQ"}


def in_order(value: bytes, order: str) -> bytes:
    """Return a big-endian number as words in this order, each word high byte first."""
    words = [value[at : at + 2] for at in range(0, len(value), 2)]
    if order in ("BADC", "DCBA"):
        words = [word[::-1] for word in words]
    return b"".join(words if order in ("ABCD", "BADC") else words[::-1])


@pytest.mark.parametrize(("name", "order"), spread(product(NUMBERS, ORDERS), 3))
@given(data=st.data())
def test_numbers_against_struct(name: str, order: str, data: st.DataObject) -> None:
    view = view_of(name, order)
    assert isinstance(view, NumberView)
    bits = int(name.lstrip("uintfloabcd"))
    if view.kind == "float":
        values = data.draw(st.lists(st.floats(width=32 if bits == 32 else 64), max_size=4))
        code = "f" if bits == 32 else "d"
    elif view.kind == "bcd":
        values, code = (
            data.draw(st.lists(st.integers(0, 10 ** (bits // 4) - 1), max_size=4)),
            "H" if bits == 16 else "I",
        )
    else:
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if view.kind == "signed" else (0, (1 << bits) - 1)
        values = data.draw(st.lists(st.integers(low, high), max_size=4))
        code = FORMATS[view.kind]["bhiq".index({8: "b", 16: "h", 32: "i", 64: "q"}[bits])]
    stored = [int(str(value), 16) for value in values] if view.kind == "bcd" else values
    packed = [struct.pack(">" + code, value) for value in stored]
    memory = view.write(values)
    if bits > 8:
        words = b"".join(memory[at : at + 2][::-1] for at in range(0, len(memory), 2))
        assert words == b"".join(in_order(number, order) for number in packed)
    assert all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in zip(view.read(memory), values, strict=True))


@pytest.mark.parametrize("order", ORDERS)
@given(text=st.text(st.characters(min_codepoint=1, max_codepoint=255), max_size=9))
def test_text(order: str, text: str) -> None:
    view = view_of("string", order)
    assert isinstance(view, TextView)
    for place in ("word", "byte"):
        memory = view.write(text, 9, place)
        assert len(memory) == (10 if place == "word" else 9)
        assert view.read(memory, 9, place) == text


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("int8", 128),
        ("uint8", -1),
        ("uint16", 65536),
        ("int64", 1 << 63),
        ("float32", 1e39),
        ("int16", 1.5),
        ("bcd16", 10000),
        ("bcd32", -1),
    ],
)
def test_what_does_not_fit(name: str, value: float) -> None:
    view = view_of(name)
    assert isinstance(view, NumberView)
    with pytest.raises(MemoryValueError):
        view.write([value])
