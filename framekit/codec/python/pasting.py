"""Source of helpers as it goes into generated modules: functions, and classes with only the methods that are used."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Iterable
from functools import cache
from typing import Any

_ALWAYS = ("fault", "error")


@cache
def whole_source(value: Any) -> str:
    """The source of a function or class."""
    return inspect.getsource(value)


def used_methods(classes: Iterable[type], text: str) -> set[str]:
    """The methods that calls `n.method` in `text` come to, with those that these call in turn."""
    bodies = {name: source for one in classes for name, source in _methods(one)}
    wanted = set(re.findall(r"\bn\.(\w+)", text)) | set(_ALWAYS)
    wanted |= {name for name in bodies if name.startswith("__")}
    known: set[str] = set()
    while wanted - known:
        name = min(wanted - known)
        known.add(name)
        wanted |= set(re.findall(r"\bself\.(\w+)", bodies.get(name, "")))
    return known & set(bodies)


def class_source(one: type, methods: set[str]) -> str:
    """The source of a class with only some of its methods."""
    text = whole_source(one)
    first = next(iter(_functions(text)), None)
    if first is None:
        return text
    head = text.splitlines()[: _first_line(first) - 1]
    while head and (not head[-1].strip() or head[-1].strip().startswith("# ----")):
        head.pop()
    kept = [source for name, source in _methods(one) if name in methods]
    return "\n".join(head) + "\n\n" + "\n\n".join(kept) + "\n" if kept else "\n".join(head) + "\n"


@cache
def _methods(one: type) -> tuple[tuple[str, str], ...]:
    text = whole_source(one)
    lines = text.splitlines()
    return tuple(
        (function.name, "\n".join(lines[_first_line(function) - 1 : function.end_lineno]))
        for function in _functions(text)
    )


@cache
def _functions(text: str) -> tuple[ast.FunctionDef, ...]:
    (found,) = ast.parse(textwrap.dedent(text)).body
    assert isinstance(found, ast.ClassDef)
    return tuple(part for part in found.body if isinstance(part, ast.FunctionDef))


def _first_line(function: ast.FunctionDef) -> int:
    return min([function.lineno, *(decorator.lineno for decorator in function.decorator_list)])
