"""The interpreter of expressions, alone and compared with the emitter of compilers and engines."""

from __future__ import annotations

from typing import Any

import pytest
from construct_oracle.evaluate import FUNCTIONS, evaluate
from construct_oracle.names import Names
from hypothesis import given
from hypothesis import strategies as st

from framekit.codec import support
from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName
from framekit.definition.expression import FUNCTIONS as KNOWN_FUNCTIONS
from framekit.definition.expression import Attribute, LineTime, Name, emit, parse_expression
from framekit.definition.problems import NOWHERE

VALUES: dict[str, Any] = {
    "a": 5,
    "b": -3,
    "c": 0,
    "t": "Text1",
    "d": b"\x01\x02\x03",
    "items": [{"x": 1}, {"x": 1}, {"x": 2}],
    "table": {1: "one", 2: "two", "k": 7},
    "record": {"x": {"y": 4}},
}

EXPRESSIONS = [
    "a + b * 2 - c",
    "a // 2 + a % 3",
    "a << 2 | 1 ^ 3 & 6",
    "-a + ~b",
    "not a == 5 or c and t",
    "a if c else b",
    "1 if a > 0 else 2 if a < -5 else 3",
    "0 < a <= 5 != b",
    "a in [1, 5] and 'T' in t",
    "a not in [1, 5]",
    "t[0]",
    "t[1:3]",
    "d[:-1]",
    "d[1:]",
    "items.x",
    "items[0].x + record.x.y",
    "table[1]",
    "len(t) + len(d) + len(items)",
    "min(a, b, 7) + max(a, b) + abs(b) + sum(items.x)",
    "lower(t)",
    "upper(t)",
    "text(a)",
    "number('2A', 16)",
    "number(t[4:])",
    "digits(a, 4)",
    "digits(a, 3, 10)",
    "bit(a, 2)",
    "rotl8(a * 40, 3)",
    "same(items.x)",
    "same([1, 1])",
    "get(table, 9, 8)",
    "find(table, 'two')",
    "find_last(table, 'nothing')",
    "items[find(items.x, 1)].x",
    "either(items[find_last(items.x, 99)].x, 4)",
    "items[find(items.x, 99)].x + 1",
    "either(c, 4)",
    "only(t, 'Tex1t')",
    "span(a, 9)",
    "ms(3) + 5 ms",
    "limit(c)",
    "limit(a)",
    "h'10 3A' + d",
    "true and false",
    "a // c",
    "t[99]",
    "missing.x",
]


class _Names:
    """Emit names as entries of a dictionary `n`."""

    def name(self, node: Name) -> str:
        return f"n[{node.name!r}]"

    def attribute(self, node: Attribute) -> str:
        return f"attribute({emit(node.value, self)}, {node.name!r})"

    def line_time(self, node: LineTime) -> str:
        raise AssertionError

    def call(self, function: str, arguments: list[str]) -> str:
        return f"support.{function}({', '.join(arguments)})"


def attribute(value: Any, name: str) -> Any:
    if value is None:
        return None
    return [attribute(item, name) for item in value] if isinstance(value, list) else value[name]


def by_emitter(text: str, values: dict[str, Any]) -> Any:
    source = emit(parse_expression(text, NOWHERE).root, _Names())
    return eval(source, {"n": values, "support": support, "attribute": attribute})


def by_interpreter(text: str, values: dict[str, Any]) -> Any:
    return evaluate(parse_expression(text, NOWHERE).root, values.__getitem__)


def outcome(way: Any, text: str, values: dict[str, Any]) -> Any:
    try:
        return way(text, values)
    except EVALUATION_ERRORS as error:
        return type(error)


@pytest.mark.parametrize("text", EXPRESSIONS)
def test_interpreter_and_emitter_agree(text: str) -> None:
    assert outcome(by_interpreter, text, VALUES) == outcome(by_emitter, text, VALUES)


NUMBERS = st.integers(-300, 300)
LEAVES = st.sampled_from(["a", "b", "c", "1", "7", "0x10"])


def joined(operators: str) -> Any:
    return lambda inner: st.tuples(inner, st.sampled_from(operators.split()), inner).map(" ".join)


TREES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        joined("+ - * // % | ^ & << >>")(inner),
        joined("== != < <= > >=")(inner),
        joined("and or")(inner),
        inner.map("({})".format),
        inner.map("-({})".format),
        inner.map("~({})".format),
        inner.map("(not {})".format),
        st.tuples(inner, inner, inner).map(lambda parts: "({} if {} else {})".format(*parts)),
    ),
    max_leaves=8,
)


@given(TREES, NUMBERS, NUMBERS, st.integers(0, 9))
def test_interpreter_and_emitter_agree_on_any_arithmetic(text: str, a: int, b: int, c: int) -> None:
    values = {"a": a, "b": b, "c": c}
    try:
        parse_expression(text, NOWHERE)
    except ValueError:
        return
    assert outcome(by_interpreter, text, values) == outcome(by_emitter, text, values)


def test_every_function_of_the_language_is_there() -> None:
    wanted = KNOWN_FUNCTIONS.keys() - {
        "empty",
        "full",
        "memory",
        "value",
        "with_date",
        "random",
        "code",
    }  # these need an engine
    assert set(FUNCTIONS) == wanted


def test_functions_of_the_engine_are_asked_of_the_context() -> None:
    class Functions:
        def empty(self, queue: str) -> bool:
            return queue == "outbox"

    names = {"functions": Functions(), "outbox": "outbox"}
    assert by_interpreter("empty(outbox)", names) is True


def test_times_in_characters_are_asked_of_the_line() -> None:
    class Line:
        def chars(self, numerator: int, denominator: int) -> int:
            return 1000 * numerator // denominator

    assert by_interpreter("3.5 chars + 1", {"line": Line()}) == 3501


def test_a_name_nobody_knows_is_no_fault_of_a_frame() -> None:
    names = Names({}, {"known": 1})
    assert evaluate(parse_expression("known + 1", NOWHERE).root, names.__getitem__) == 2
    with pytest.raises(MissingName, match="'other'"):
        evaluate(parse_expression("other", NOWHERE).root, names.__getitem__)
    assert not issubclass(MissingName, EVALUATION_ERRORS)
