"""Evaluate expressions directly on their tree, as the reference for emitted expressions."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any

from construct_oracle.keyed import chained
from framekit.codec import support
from framekit.codec.evaluate import ENGINE_FUNCTIONS, MissingName
from framekit.definition import expression as syntax
from framekit.definition.expression import Node
from framekit.definition.times import NEVER

Lookup = Callable[[str], Any]

WIDEST_SHIFT = 256

_BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "|": operator.or_,
    "^": operator.xor,
    "&": operator.and_,
    "+": operator.add,
    "-": operator.sub,
    "*": support.times,
    "//": operator.floordiv,
    "%": operator.mod,
    "<<": lambda left, right: left << min(right, WIDEST_SHIFT),
    ">>": lambda left, right: left >> min(right, WIDEST_SHIFT),
}
_COMPARE: dict[str, Callable[[Any, Any], Any]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "in": lambda item, holder: item in holder,
    "not in": lambda item, holder: item not in holder,
}
_UNARY: dict[str, Callable[[Any], Any]] = {"-": operator.neg, "~": operator.invert, "not": operator.not_}


BYTES_OF = "bytes of "
"""Prefix of the lookup name (not a name of the language) for the size of an inner frame."""


def _is_frame(value: Any) -> bool:
    return isinstance(value, Mapping) and not hasattr(value, "value_or_nothing")


def evaluate(node: Node, lookup: Lookup) -> Any:
    """Return the value of `node` with names from `lookup`. Raises one of EVALUATION_ERRORS, or MissingName."""
    match node:
        case syntax.Real(value=value, is_float=is_float):
            return float(value) if is_float else value
        case syntax.Number(value=value) | syntax.Text(value=value) | syntax.Bytes(value=value):
            return value
        case syntax.Name(name=name):
            return lookup(name)
        case syntax.Attribute(value=value, name=name):
            return attribute(evaluate(value, lookup), name)
        case syntax.Index(value=value, index=syntax.Call(function="find" | "find_last") as index):
            place = evaluate(index, lookup)
            return None if place is None else evaluate(value, lookup)[place]
        case syntax.Index(value=value, index=index):
            return evaluate(value, lookup)[evaluate(index, lookup)]
        case syntax.Slice(value=value, start=start, stop=stop):
            first = None if start is None else evaluate(start, lookup)
            last = None if stop is None else evaluate(stop, lookup)
            return evaluate(value, lookup)[first:last]
        case syntax.Call(function="len", arguments=(syntax.Name(name=name),)) if _is_frame(value := lookup(name)):
            try:
                return lookup(f"{BYTES_OF}{name}")
            except (KeyError, MissingName):  # a table
                return len(value)
        case syntax.Call(function=function, arguments=arguments):
            return _call(function, [evaluate(argument, lookup) for argument in arguments], lookup)
        case syntax.List(items=items):
            return [evaluate(item, lookup) for item in items]
        case syntax.LineTime(count=count, unit=unit):
            return getattr(lookup("line"), unit)(*count)
        case _:
            return _operate(node, lookup)


def _operate(node: Node, lookup: Lookup) -> Any:
    match node:
        case syntax.Unary(operator=sign, operand=operand):
            return _UNARY[sign](evaluate(operand, lookup))
        case syntax.Binary(operator=sign, left=left, right=right):
            return _BINARY[sign](evaluate(left, lookup), evaluate(right, lookup))
        case syntax.Compare(first=first, rest=rest):
            return _compare(evaluate(first, lookup), rest, lookup)
        case syntax.Logic(operator=word, operands=operands):
            return _logic(word, operands, lookup)
        case syntax.Conditional(condition=condition, then=then, otherwise=otherwise):
            return evaluate(then if evaluate(condition, lookup) else otherwise, lookup)
    raise TypeError(f"no expression node: {node!r}")


def _compare(left: Any, rest: tuple[tuple[str, Node], ...], lookup: Lookup) -> Any:
    """Evaluate chained comparisons; operands after the first false comparison are not evaluated."""
    result: Any = True
    for sign, operand in rest:
        right = evaluate(operand, lookup)
        result = _COMPARE[sign](left, right)
        if not result:
            break
        left = right
    return result


def _logic(word: str, operands: tuple[Node, ...], lookup: Lookup) -> Any:
    """Return the first false operand of `and`, the first true operand of `or`, else the last operand."""
    value: Any = None
    for operand in operands:
        value = evaluate(operand, lookup)
        if bool(value) == (word == "or"):
            break
    return value


def attribute(value: Any, name: str) -> Any:
    """Return `value.name`: an entry of a mapping, an attribute of an object, or the attributes of all list items.

    An attribute of an absent value is absent, too.
    """
    if value is None:
        return None
    if isinstance(value, Mapping):
        of_record = getattr(value, "value_or_nothing", None)
        return value[name] if of_record is None else of_record(name)
    if isinstance(value, (list, tuple)):
        return [attribute(item, name) for item in value]
    fields = getattr(value, "fields", None)
    if isinstance(fields, Mapping) and name in fields:
        return fields[name]
    if hasattr(value, "language_attribute"):
        return value.language_attribute(name)
    if isinstance(fields, Mapping) and name in ("frame", "refusal"):
        return getattr(value, name) or 0
    raise KeyError(name)


# ---- functions ----------------------------------------------------------------------------------------------


def _call(function: str, arguments: list[Any], lookup: Lookup) -> Any:
    if function in ENGINE_FUNCTIONS:
        return getattr(lookup("functions"), function)(*arguments)
    return FUNCTIONS[function](*arguments)


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "len": len,
    "min": min,
    "max": max,
    "abs": abs,
    "sum": sum,
    "text": str,
    "lower": lambda text: text.lower(),
    "upper": lambda text: text.upper(),
    "get": lambda table, key, default: table.get(key, default),
    "ms": lambda count: count * 1_000_000,
    "limit": lambda time: time or NEVER,
    "number": support.number,
    "digits": support.digits,
    "bit": support.bit,
    "rotl8": support.rotl8,
    "same": support.same,
    "find": support.find,
    "find_last": support.find_last,
    "free": support.free,
    "either": support.either,
    "none": lambda: None,
    "only": support.only,
    "span": support.span,
    "xor": lambda one, other: bytes(a ^ b for a, b in zip(one, other, strict=True)),
    "aes": chained,
}
