"""No message contains the text of a Python exception."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import framekit
from framekit.codec.shown import explain
from framekit.definition.expression import parse_expression
from framekit.definition.problems import Position
from framekit.link.values import Names, compile_expression

FOLDER = Path(framekit.__file__).parent
PYTHONS = {
    "EVALUATION_ERRORS", "WRONG", "Exception", "TypeError", "KeyError", "IndexError", "LookupError", "AttributeError",
    "ArithmeticError", "OverflowError", "ZeroDivisionError", "struct_error", "RecursionError",
}  # fmt: skip
"""Exceptions whose text the interpreter writes."""


def shown(handler: ast.ExceptHandler) -> Iterator[int]:
    """Yield the lines of a handler that put the text of the caught exception into a message."""
    for node in ast.walk(handler):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("str", "repr"):
            value: ast.AST = node.args[0]
        elif isinstance(node, ast.FormattedValue):
            value = node.value
        else:
            continue
        if isinstance(value, ast.Name) and value.id == handler.name:
            yield node.lineno


def handlers(path: Path) -> Iterator[ast.ExceptHandler]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ExceptHandler) and node.type is not None and node.name:
            caught = {part.id for part in ast.walk(node.type) if isinstance(part, ast.Name)}
            yield from [node] if caught & PYTHONS else []


def test_what_the_interpreter_raises_is_explained() -> None:
    found = [
        f"{path.relative_to(FOLDER)}:{line}"
        for path in sorted(FOLDER.rglob("*.py"))
        for handler in handlers(path)
        for line in shown(handler)
    ]
    assert found == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a <= 3", "a value is not there, or is of another kind than is needed"),
        ("a + 'x'", "a value is not there, or is of another kind than is needed"),
        ("7 // (a - a)", "something is divided by 0"),
        ("b + 1", "there is no 'b'"),
        ("digits(700, 2, 16)", "700 does not fit into 2 digits of base 16"),
    ],
)
def test_errors_of_expressions_are_told_in_words(text: str, words: str) -> None:
    with pytest.raises(Exception) as caught:
        compile_expression(parse_expression(text, Position("test", 1, 1)))(Names({"a": None if "<=" in text else 5}))
    assert explain(caught.value) == words
