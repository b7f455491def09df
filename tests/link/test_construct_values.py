"""Literal values in definitions, and inverse evaluation of expressions."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link.service_loop import codec_of

from framekit.definition.expression import is_constant, parse_expression
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, ReadAs, RecordOf, Value
from framekit.definition.problems import NOWHERE
from framekit.link.services.rows import rows_of
from framekit.link.values import EACH, FrameValue, Names, NotReadableError, inverse_of


def expression(text: str) -> Value:
    return parse_expression(text, NOWHERE)


def worked_out(value: Value, **names: object) -> object:
    protocol, codec = codec_of("rack.yaml")
    return rows_of(protocol, codec).values.compile(value)(Names(names))


def test_a_frame_knows_its_constants_and_the_numbers_behind_names() -> None:
    value = FrameOf("point", {"kind": expression("'relay'"), "number": expression("n + 1")}, NOWHERE)
    made = worked_out(value, n=4)
    assert isinstance(made, FrameValue) and made.fields == {"kind": 3, "number": 5, "function": 6}


def test_layouts_are_made_and_read() -> None:
    facts = LayoutOf("facts", {"kind": expression("k"), "size": expression("2")}, NOWHERE)
    assert worked_out(facts, k=7) == b"\7\2"
    assert worked_out(ReadAs("facts", expression("data"), NOWHERE), data=b"\7\2") == {"kind": 7, "size": 2}
    assert worked_out(ReadAs("facts", expression("data"), NOWHERE), data=b"\7\2\0\0\0\0") == {"kind": 7, "size": 2}
    assert worked_out(ReadAs("facts", expression("data"), NOWHERE), data={"kind": 1, "size": 9}) == b"\1\x09"
    with pytest.raises(ValueError):
        worked_out(ReadAs("facts", expression("data"), NOWHERE), data=b"\7")


def test_lists_records_and_one_record_a_variable() -> None:
    value = RecordOf({"all": ListOf((expression("1"), expression("x")), NOWHERE)}, NOWHERE)
    assert worked_out(value, x=b"y") == {"all": [1, b"y"]}
    each = EachOf({"name": expression("text"), "more": expression("x")}, NOWHERE)
    assert worked_out(each, x=5, **{EACH: [{"text": "a"}, {"text": "b"}]}) == [
        {"name": "a", "more": 5},
        {"name": "b", "more": 5},
    ]


class Area:
    def language_attribute(self, name: str) -> int:
        return {"first": 1, "size": 3}[name]


INVERTIBLE = [
    "start", "start + 1", "1 + start", "start - area.first", "100 - start", "start * 2", "area.size * start + 7",
    "(start + 1) * 6 - 4",
]  # fmt: skip


@pytest.mark.parametrize("text", INVERTIBLE)
@given(start=st.integers(0, 10_000))
def test_expressions_read_backwards(text: str, start: int) -> None:
    source = parse_expression(text, NOWHERE)
    inverse = inverse_of(source)
    assert inverse is not None and inverse.name == "start"
    protocol, codec = codec_of("rack.yaml")
    names = Names({"area": Area(), "start": start})
    assert inverse.solve(rows_of(protocol, codec).values.compile(source)(names), names) == start


@pytest.mark.parametrize(
    "text", ["start // 2", "1 << bit", "start + done", "start * start", "area.first", "5", "start if x else 0"]
)
def test_what_cannot_be_read_backwards(text: str) -> None:
    assert inverse_of(parse_expression(text, NOWHERE)) is None


def test_a_result_that_no_value_gives() -> None:
    inverse = inverse_of(parse_expression("start * 2", NOWHERE))
    assert inverse is not None
    with pytest.raises(NotReadableError):
        inverse.solve(5, Names())


@pytest.mark.parametrize(
    ("text", "constant"), [("h'00' if 1 else 3", True), ("3 chars", False), ("memory(1, 2)", False)]
)
def test_what_can_be_worked_out_once(text: str, constant: bool) -> None:
    assert is_constant(parse_expression(text, NOWHERE)) == constant
