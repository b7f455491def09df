"""Lists of plain numbers in generated Python: packed and unpacked as a block, as the construct codec does."""

from __future__ import annotations

from typing import Any

import pytest
from construct_oracle import compile_construct
from small_protocol import small_protocol

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import EncodeError, FrameError

COUNTED = "{count: n, type: u16, of: list}, {repeat: list, times: n, of: %s}"


def agreed(body: str, values: dict[str, Any]) -> tuple[Codec, bytes]:
    """Assert that both compilers agree on the values; return the codec and the bytes."""
    protocol = small_protocol(body)
    codec, reference = compile_protocol(protocol), compile_construct(protocol)
    data = codec.encode("f", values)
    assert data == reference.encode("f", values)
    fields = codec.decode("f", data)
    assert fields == reference.decode("f", data)
    assert fields | values == fields
    return codec, data


@pytest.mark.parametrize("kind", ["u8", "i8", "u16", "i32", "u64", "u24", "f64", "bcd, size: 2", "hex, size: 4"])
@pytest.mark.parametrize("count", [0, 1, 3, 256, 257, 600])
def test_lists_of_any_length(kind: str, count: int) -> None:
    values: list[Any] = [number % 100 for number in range(count)]
    codec, data = agreed(f"[{{const: AA}}, {COUNTED % kind}, {{field: z, type: u8}}]", {"list": values, "z": 7})
    for wrong in (data[:-1], data + b"\0"):
        with pytest.raises(FrameError):
            codec.decode("f", wrong)


def test_structs_of_long_lists_are_not_kept() -> None:
    codec, _ = agreed(f"[{COUNTED % 'u16'}]", {"list": [1, 2, 3]})
    kept = vars(codec.module)["BIG_HS"]
    for count in (256, 257, 5000):
        codec.decode("f", codec.encode("f", {"list": [7] * count}))
    assert set(kept) == {3, 256}


@pytest.mark.parametrize(
    "body",
    [
        "[{field: a, type: u16, order: little}, {repeat: list, times: 2, of: u16}]",
        "[{field: a, type: u16}, {repeat: list, times: 2, of: u16}, {field: b, type: u16, default: 1}]",
        "[{text: AB}, {data: d, size: 2}, {skip: 2}, {field: a, type: u8}, {repeat: list, times: rest, of: i16}]",
        "[{field: a, type: hex, size: 2}, {repeat: list, times: 2, of: i16}]",
        "[{field: a, type: u8}, {repeat: list, times: 2, of: u16, when: a > 1}]",
        "[{field: a, type: u8, when: 1 == 1}, {repeat: list, times: 2, of: u16}, {check: sum8, over: [list]}]",
        "[{field: a, type: u8}, {wrap: hex, of: [{repeat: list, times: rest, of: u16}]}]",
        "[{field: a, type: u8}, {repeat: list, times: rest, of: u32, order: CDAB}]",
        "[{field: a, type: u16, order: little}, {repeat: list, times: rest, of: f32}]",
    ],
)
def test_lists_beside_other_segments(body: str) -> None:
    given = {"d": b""} if "data: d" in body else {}
    agreed(body, {"a": 5, "list": [1, 0x102]} | dict.fromkeys(given, b"xy"))


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"list": [1, 70000]}, "list[1]"),
        ({"list": [1, -1]}, "list[1]"),
        ({"list": [1, "2"]}, "list[1]"),
        ({"list": [1, 2.5]}, "list[1]"),
        ({"list": b"\1\2"}, "list"),
        ({"list": None}, "list"),
        ({"list": {}}, "list"),
        ({}, "list"),
        ({"list": [1], "n": 3}, "n"),
        ({"list": [1] * 200}, ""),
    ],
)
def test_what_a_list_cannot_hold(values: dict[str, Any], field: str) -> None:
    protocol = small_protocol("[{length: n, type: u8, of: [list]}, {repeat: list, times: n // 2, of: u16}]")
    with pytest.raises(EncodeError) as error:
        compile_protocol(protocol).encode("f", values)
    assert error.value.field == field or not field
    with pytest.raises(EncodeError):
        compile_construct(protocol).encode("f", values)


@pytest.mark.parametrize("number", ["field: n, type: u8", "length: n, type: u8, of: [other]"])
def test_a_count_of_another_case_does_not_count_this_list(number: str) -> None:
    body = f"""[{{field: kind, type: u8}}, {{data: other, size: 1}}, {{choose: kind, cases: {{
        1: [{{{number}}}, {{repeat: list, times: n, of: u8}}],
        2: [{{count: n, type: u8, of: list}}, {{repeat: list, times: n, of: u8}}]}}}}]"""
    given = {"n": 3} if "field" in number else {}
    values = {"kind": 1, "other": b"x", "list": [1, 2], **given}
    protocol = small_protocol(body)
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        with pytest.raises(EncodeError):
            codec.encode("f", values)
        assert codec.encode("f", values | {"kind": 2, "n": 2}) == bytes((2, 0x78, 2, 1, 2))


@pytest.mark.parametrize(
    ("length", "times"),
    [
        ("{length: n, type: u8, of: [list], plus: 2}", "n // 2"),
        ("{length: n, type: u8, of: [list]}", "n // 4"),
        ("{length: n, type: u8, of: [list]}", "n"),
        ("{length: n, type: u8, of: [list, more]}", "n // 3"),
        ("{length: n, type: u8, of: [list], unit: words}", "n // 2"),
    ],
)
def test_lengths_that_tell_something_else(length: str, times: str) -> None:
    """The length and the number of items contradict each other, so such a list cannot be sent."""
    protocol = small_protocol(f"[{length}, {{repeat: list, times: {times}, of: u16}}, {{data: more, size: 1}}]")
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        with pytest.raises(EncodeError):
            codec.encode("f", {"list": [1, 2, 3], "more": b"x"})


@pytest.mark.parametrize(
    ("body", "data", "expected"),
    [
        ("[{repeat: r, times: rest, of: u16}]", "00 01 02", ("short", "r", 0, None)),
        ("[{field: a, type: u8}, {repeat: r, times: rest, of: u16, refuse: 4}, {check: sum8}]", "05 00 01 02 08", 4),
        ("[{field: a, type: u8}, {repeat: r, times: rest, of: u16, refuse: 4}, {check: sum8}]", "05 00 01 02 09", None),
    ],
)
def test_part_of_a_value_is_a_fault_of_the_list(body: str, data: str, expected: Any) -> None:
    """The segments after the list are read at their own offset, so the fault is a refusal if the check is right."""
    protocol, found = small_protocol(body), []
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        with pytest.raises(FrameError) as error:
            codec.decode("f", bytes.fromhex(data))
        found.append((error.value.cause, error.value.segment, error.value.offset, error.value.refuse))
    assert found[0] == found[1]
    assert found[0] == expected or found[0][3] == expected
