"""Segments left out by a `when`, a case, or a length that counts segments of some cases only.

Both compilers refuse values given for them, name them, and treat them as absent.
"""

from __future__ import annotations

from typing import Any

import pytest
from construct_oracle import compile_construct

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError

COMPILERS = {"python": compile_protocol, "construct": compile_construct}
PLAIN = "- {field: k, type: u8}\n- {field: a, type: u8, when: k == 1}"
IN_A_CASE = """\
- {field: k, type: u8}
- choose: k
  when: k < 3
  cases:
    1: [{field: a, type: u8}]
    2: [{field: b, type: u8}, {field: c, type: u8, when: b == 1}]"""
SHARED = """\
- {field: k, type: u8}
- {length: n, type: u8, of: a}
- choose: k
  cases:
    1: [{data: a, size: n}]
    2: [{field: a, type: u16}]
    3: [{field: a, type: ascii, size: n}]
    4: [{repeat: a, times: rest, of: u16}]
    5: [{field: b, type: u8}]"""


def codec(body: str, compiler: str) -> Any:
    lines = "".join(f"      {line}\n" for line in body.splitlines())
    return COMPILERS[compiler](load_protocol_text(f"protocol: case\nframes:\n  f:\n    body:\n{lines}"))


REFUSED = {
    "a field": (PLAIN, {"k": 2, "a": 5}, "a"),
    "a field that is fixed": (PLAIN.replace("u8, when", "u8, is: k + 1, when"), {"k": 2, "a": 3}, "a"),
    "a default that is not the default": (PLAIN.replace("u8, when", "u8, default: 7, when"), {"k": 2, "a": 5}, "a"),
    "bits": ("- {field: k, type: u8}\n- {bits: {x: 0, y: 1-7}, of: u8, when: k == 1}", {"k": 2, "x": 0}, "x"),
    "data": ("- {field: k, type: u8}\n- {data: d, size: 2, when: k == 1}", {"k": 2, "d": b"12"}, "d"),
    "a list": ("- {field: k, type: u8}\n- {repeat: l, times: 2, of: u8, when: k == 1}", {"k": 2, "l": [1, 2]}, "l"),
    "a length": (
        "- {field: k, type: u8}\n- {length: n, type: u8, of: d, when: k == 1}\n- {data: d, size: n, when: k == 1}",
        {"k": 2, "n": 0},
        "n",
    ),
    "in an item of a list": (
        "- repeat: l\n  times: rest\n  of: [{field: k, type: u8}, {field: a, type: u8, when: k == 1}]",
        {"l": [{"k": 1, "a": 1}, {"k": 2, "a": 1}]},
        "a",
    ),
    "in a case": (IN_A_CASE, {"k": 2, "b": 2, "c": 5}, "c"),
    "of another case": (IN_A_CASE, {"k": 1, "a": 2, "b": 5}, "b"),
    "of a choice that is left out": (IN_A_CASE, {"k": 3, "a": 2}, "a"),
}


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("case", REFUSED)
def test_values_of_what_is_left_out_are_refused_by_name(case: str, compiler: str) -> None:
    body, values, name = REFUSED[case]
    with pytest.raises(EncodeError) as caught:
        codec(body, compiler).encode("f", values)
    assert caught.value.field.endswith(name)
    assert f"{name}'" in str(caught.value)


@pytest.mark.parametrize("compiler", COMPILERS)
def test_nothing_given_for_what_is_left_out_is_no_value(compiler: str) -> None:
    assert codec(PLAIN, compiler).encode("f", {"k": 2, "a": None}) == b"\x02"
    with_default = codec(PLAIN.replace("u8, when", "u8, default: 7, when"), compiler)
    read = with_default.decode("f", b"\x02")
    assert read == {"k": 2, "a": 7}
    assert with_default.encode("f", read) == b"\x02"


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize(
    ("values", "data"),
    [
        ({"k": 1, "a": b"123"}, "0103313233"),
        ({"k": 2, "a": 1}, "02020001"),
        ({"k": 3, "a": "abcd"}, "030461626364"),
        ({"k": 4, "a": [1, 2, 3]}, "0406000100020003"),
        ({"k": 5, "b": 1}, "050001"),
    ],
)
def test_a_length_counts_what_the_case_has(compiler: str, values: dict[str, Any], data: str) -> None:
    tested = codec(SHARED, compiler)
    assert tested.encode("f", values).hex() == data
    assert tested.decode("f", bytes.fromhex(data)) == {**values, "n": int(data[2:4])}
    wrong = bytes.fromhex(f"{data[:2]}{int(data[2:4]) + 1:02x}{data[4:]}")
    with pytest.raises(FrameError):
        tested.decode("f", wrong)


@pytest.mark.parametrize("compiler", COMPILERS)
def test_a_length_means_the_name_of_its_own_list(compiler: str) -> None:
    outer = codec(
        "- {length: n, type: u8, of: a}\n- {data: a, size: n}\n- {repeat: l, times: rest, of: [{field: a, type: u16}]}",
        compiler,
    )
    assert outer.encode("f", {"a": b"123", "l": [{"a": 1}]}).hex() == "033132330001"
    inner = codec(
        "- {data: a, size: 1}\n- repeat: l\n  times: rest\n  of: [{length: n, type: u8, of: a}, {data: a, size: n}]",
        compiler,
    )
    data = inner.encode("f", {"a": b"1", "l": [{"a": b"234"}]})
    assert data.hex() == "3103323334"
    assert inner.decode("f", data) == {"a": b"1", "l": [{"n": 3, "a": b"234"}]}


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize(
    "between", ["{field: x, type: u8, when: k == 1}", "{choose: k, cases: {1: [{skip: 1}], 2: []}}"]
)
def test_a_length_is_compared_behind_what_may_be_left_out(compiler: str, between: str) -> None:
    """In every case, after all covered segments have been read."""
    body = f"- {{length: n, type: u8, of: [k, d]}}\n- {{field: k, type: u8}}\n- {between}\n- {{data: d, size: rest}}"
    tested = codec(body, compiler)
    for data in ("0401000A0B0C", "04020A0B0C"):
        assert tested.decode("f", bytes.fromhex(data))["d"] == b"\x0a\x0b\x0c"
        with pytest.raises(FrameError) as caught:
            tested.decode("f", b"\x03" + bytes.fromhex(data)[1:])
        assert caught.value.cause == "length"


def test_lengths_that_go_round_in_a_circle_are_refused_with_their_place() -> None:
    with pytest.raises(DefinitionError, match=r":9:\d+: the size of 'a'"):
        codec(SHARED.replace("size: n}]\n    2", "size: n - 1}]\n    2"), "python")


HOPS = """\
- {field: k, type: u8}
- {include: hop, as: one, when: k}
- {include: hop, as: two, when: k and one.last == 0}
- {field: b, type: u8, when: k and two.last}"""
HOP = "layouts:\n  hop: [{bits: {s: 1-7, last: 0}, of: u8, build: {last: s == 7}}]\n"


@pytest.mark.parametrize("compiler", COMPILERS)
def test_what_a_record_computes_decides_on_the_next_one(compiler: str) -> None:
    lines = "".join(f"      {line}\n" for line in HOPS.splitlines())
    tested = COMPILERS[compiler](load_protocol_text(f"protocol: case\n{HOP}frames:\n  f:\n    body:\n{lines}"))
    assert tested.encode("f", {"k": 0}) == b"\x00"
    assert tested.encode("f", {"k": 1, "one": {"s": 7}}) == b"\x01\x0f"
    assert tested.encode("f", {"k": 1, "one": {"s": 1}, "two": {"s": 2}}) == b"\x01\x02\x04"
    assert tested.encode("f", {"k": 1, "one": {}, "two": {"s": 7}, "b": 9}) == b"\x01\x00\x0f\x09"
    with pytest.raises(EncodeError, match="'one' is missing"):
        tested.encode("f", {"k": 1, "two": {"s": 7}, "b": 9})
    with pytest.raises(EncodeError) as caught:
        tested.encode("f", {"k": 1, "one": {"s": 7}, "two": {"s": 2}})
    assert caught.value.field == "two"
