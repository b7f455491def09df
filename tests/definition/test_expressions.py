"""Expressions: precedence compared with Python's, literals, errors with their position, bounds."""

from __future__ import annotations

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from framekit.definition.expression import ExpressionError, names_in, parse_expression, real_number
from framekit.definition.problems import Position
from framekit.definition.times import NEVER
from framekit.link.values import Names, compile_expression

HERE = Position("f.yaml", 3, 10)


def value(text: str, **names: object) -> object:
    return compile_expression(parse_expression(text, HERE))(Names(names))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2 + 3 * 4", 14),
        ("(2 + 3) * 4", 20),
        ("7 // 2 % 2", 1),
        ("1 | 6 & 3 ^ 1", 1 | 6 & 3 ^ 1),
        ("~x & 0xFF", 0xFA),
        ("not x == 5", False),
        ("1 < x <= 5", True),
        ("x in [4, 5]", True),
        ("'a' not in 'bcd'", True),
        ("'ON' if x else 'OFF'", "ON"),
        ("h'10 3A'", b"\x10\x3a"),
        ("50 ms + 2 s", 2_050_000_000),
        ("never", NEVER),
        ("max(x, 7)", 7),
        ("lower('ABC')", "abc"),
        ("number('1F', 16)", 31),
        ("digits(31, 2)", "1F"),
        ("rotl8(0x81, 1)", 3),
        ("get({}, 1, 9)".replace("{}", "t"), 9),
        ("data[1:3]", b"bc"),
        ("points.offset", [1, 2]),
        ("true and not false", True),
        ("limit(0 ms)", NEVER),
    ],
)
def test_values(text: str, expected: object) -> None:
    found = value(text, x=5, t={}, data=b"abcd", points=[{"offset": 1}, {"offset": 2}])
    assert found == expected


operators = st.sampled_from(["+", "-", "*", "&", "|", "^", "<", "<=", "==", "and", "or"])


@given(st.lists(st.tuples(st.integers(0, 99), operators), min_size=1, max_size=6), st.integers(0, 99))
def test_precedence_is_python_s(parts: list[tuple[int, str]], last: int) -> None:
    text = " ".join(f"{number} {operator}" for number, operator in parts) + f" {last}"
    assert value(text) == eval(text)


@pytest.mark.parametrize(
    ("text", "place", "what"),
    [
        ("", 10, "it is empty"),
        ("a b", 12, "'b' was not expected here"),
        ("max(a", 15, "',' is missing at the end"),
        ("f(a)", 10, "there is no function 'f'"),
        ("len(a, b)", 10, "'len' takes 1 arguments, not 2"),
        ("a = b", 12, "'=' is no operator, comparison is '=='"),
        ("a / b", 12, "'/' is no operator, numbers are whole: use '//'"),
        ("'abc", 10, "a text has no closing quote"),
        ("h'1'", 10, "h'1' is not bytes"),
        ("a + ", 14, "it ends too early"),
        ("x.1", 12, "a name must follow the dot"),
        ("__import__('os')", 10, "there is no function '__import__'"),
        ("lambda: 1", 16, "':' was not expected here"),
    ],
)
def test_errors_say_where_and_what(text: str, place: int, what: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        parse_expression(text, HERE)
    assert caught.value.problem.at.column == place
    assert what in caught.value.problem.what


def test_nesting_is_bounded() -> None:
    with pytest.raises(ExpressionError, match="nested too deeply"):
        parse_expression("(" * 2000 + "1" + ")" * 2000, HERE)


def test_a_shift_cannot_ask_for_a_gigabyte() -> None:
    assert value("1 << x", x=1 << 40).bit_length() == 257  # type: ignore[attr-defined]


def test_names_are_those_read() -> None:
    assert names_in(parse_expression("a.b + c[d] if len(e) else 'f'", HERE).root) == {"a", "c", "d", "e"}


@given(st.text(max_size=40))
def test_any_text_parses_or_is_refused(text: str) -> None:
    try:
        parsed = parse_expression(text, HERE)
    except ExpressionError as error:
        assert error.problem.at.line == 3
    else:
        assert parsed.text == text


@pytest.mark.parametrize("text", ["-0.25", "12345678901234567890.12345678901234567890"])
def test_all_digits_of_a_fraction_count(text: str) -> None:
    given = real_number(text, HERE)
    assert given is not None
    found = compile_expression(given)(Names())
    assert isinstance(found, Decimal)
    assert found.as_tuple() == Decimal(text).as_tuple()
