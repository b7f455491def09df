"""Compute check codes: the expression of each check method, and the function compiled from it.

The source compiler writes the expression into its modules, all other callers use the function, so that both compute the
same code. The compilers handle folds and the encoding of codes themselves.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from typing import Any

from framekit.codec import support
from framekit.definition.model.checks import CheckMethod, ready_methods

FUNCTIONS: dict[str, Callable[[bytes], int]] = {}
"""The functions of check methods that a program has registered, by kind."""

_MODULES = {width: f"fastcrc.crc{width}" for width in (8, 16, 32, 64)}
_SAMPLES = (b"", b"123456789", bytes(range(256)), *(bytes([value]) for value in range(0, 256, 5)))


@dataclass(frozen=True, slots=True)
class LibraryCrc:
    """A function of the library `fastcrc`, and the number to exclusive-or with its result."""

    module: str
    name: str
    xor: int

    @property
    def alias(self) -> str:
        """Return its name in generated modules: upper case, to differ from all locals."""
        return f"{self.module.rpartition('.')[2]}_{self.name}".upper()

    @property
    def import_line(self) -> str:
        return f"from {self.module} import {self.name} as {self.alias}"


@cache
def library_crc(method: CheckMethod) -> LibraryCrc | None:
    """Return the library's function for a CRC, or None if it has none."""
    module = _MODULES.get(method.width)
    if module is None or method.kind != "crc":
        return None
    wanted, found = _codes(method), list[LibraryCrc]()
    for name, codes in _library(module):
        difference = wanted[0] ^ codes[0]
        if all(own ^ other == difference for own, other in zip(wanted, codes, strict=True)):
            found.append(LibraryCrc(module, name, difference))
    return min(found, key=lambda crc: (crc.xor != 0, crc.name), default=None)


def _codes(method: CheckMethod) -> list[int]:
    """Return the codes of the samples from our own implementation."""
    table = support.make_crc_table(method.width, method.poly, method.refin)
    rest = method.width, method.initial, method.refin, method.refout, method.xorout
    return [support.crc(sample, table, *rest) for sample in _SAMPLES]


@cache
def _library(module: str) -> list[tuple[str, list[int]]]:
    """Return the functions of a module of the library by name, with their codes of the samples."""
    functions: Any = import_module(module)
    names = sorted(functions.algorithms_available)
    return [(name, [getattr(functions, name)(sample) for sample in _SAMPLES]) for name in names]


__all__ = [
    "CheckMethod",
    "CheckSource",
    "compute",
    "function_of",
    "ready_methods",
    "residue_of",
    "size_of",
    "source_of",
]

CALL = re.compile(r"[\w.]+\([^()]*\)")
"""A single call, which needs no parentheses."""


@dataclass(frozen=True, slots=True)
class CheckSource:
    """Python source that computes a check code over `data`."""

    expression: str
    """The expression, without outer parentheses."""
    functions: tuple[str, ...] = ()
    """The functions of `support` that the expression calls."""
    constants: tuple[tuple[str, str], ...] = ()
    """Module constants that the expression reads: name and expression."""
    makers: tuple[str, ...] = ()
    """The functions of `support` that the constants call."""
    imports: tuple[str, ...] = ()
    """The import lines that the expression requires."""


def size_of(method: CheckMethod) -> int:
    """Return the size of the code in bytes, as a plain number."""
    return method.size


def compute(method: CheckMethod, data: bytes | bytearray) -> int:
    """Return the check code of `data`. Raises TypeError for a fold."""
    return function_of(method)(data)


@cache
def function_of(method: CheckMethod) -> Callable[[bytes | bytearray], int]:
    """Return the function that computes a check method. Raises TypeError for a fold or a method with a key."""
    source = source_of(method, alone=False)
    names: dict[str, Any] = {name: getattr(support, name) for name in source.functions}
    names["own"] = FUNCTIONS.get(method.kind)
    names |= {name: _constant(text, source.makers) for name, text in source.constants}
    for line in source.imports:
        exec(line, names)
    plain = source.expression.removesuffix("(data)")
    function: Callable[[bytes | bytearray], int] = names.get(plain) or eval(f"lambda data: {source.expression}", names)
    return function


def add_function(kind: str, function: Callable[[bytes], int]) -> None:
    """Register the function of a kind of check methods that a program defines."""
    FUNCTIONS[kind] = function
    function_of.cache_clear()


@cache
def residue_of(method: CheckMethod, size: int, order: str) -> int | None:
    """Return the CRC over any bytes followed by their own code of `size` bytes; None if it is not constant.

    It is constant if the byte order on the line is the order in which the register shifts.
    """
    whole = method.kind == "crc" and method.width == 8 * size and method.mask is None and method.complement is None
    if not whole or method.refin != method.refout or (size > 1 and order != ("little" if method.refin else "big")):
        return None
    data = b"123456789"
    return compute(method, data + compute(method, data).to_bytes(size, "little" if order == "little" else "big"))


@cache
def _constant(text: str, makers: tuple[str, ...]) -> Any:
    return eval(text, {name: getattr(support, name) for name in makers})


@cache
def source_of(method: CheckMethod, data: str = "data", *, alone: bool = True, own: str = "own") -> CheckSource:
    """Return the source that computes a check method over the variable `data`.

    `alone`: use the standard library only. `own`: the name of a program's own function. Raises TypeError for a fold or
    a method with a key.
    """
    if method.kind == "fold":
        raise TypeError(f"the fold '{method.name}' is an expression of its own")
    if method.is_keyed:
        raise TypeError(f"'{method.name}' takes a key")
    if method.kind == "crc":
        library = None if alone else library_crc(method)
        if library is not None:
            call = f"{library.alias}({data}){_plus('^', library.xor)}"
            return _finished(method, CheckSource(call, imports=(library.import_line,)), fits=True)
        return _finished(method, _crc(method, data), fits=True)
    if method.kind in FUNCTIONS:
        return _finished(method, CheckSource(f"{own}({data})"), fits=False)
    return _finished(method, *_simple(method, data))


def _simple(method: CheckMethod, data: str) -> tuple[CheckSource, bool]:
    """Return the source before mask and complement, and whether the result always fits the width."""
    start = method.initial
    size = (method.width + 7) // 8
    match method.kind:
        case "sum" | "sum7":
            return CheckSource(f"sum({data}){_plus('+', start)}"), False
        case "word_sum":
            name = f"word_sum_{method.order}"
            return CheckSource(f"{name}({data}, {_ones(method):#x}){_plus('+', start)}", (name,)), not start
        case "xor" if size > 1:
            little = ", True" if method.order == "little" else ""
            return CheckSource(f"xor_words({data}, {size}{little}){_plus('^', start)}", ("xor_words",)), True
        case "xor" | "xor7":
            fits = method.kind == "xor" and method.width == 8
            return CheckSource(f"xor8({data}){_plus('^', start)}", ("xor8",)), fits
        case "or":
            return CheckSource(f"or8({data}){_plus('|', start)}", ("or8",)), method.width >= 8
    return CheckSource(f"multiply({data}, {start:#x}, {_ones(method):#x})", ("multiply",)), True


def _crc(method: CheckMethod, data: str) -> CheckSource:
    source, xorout = _standard_crc(method, data) or (_table_crc(method, data), method.xorout)
    expression, functions = source.expression, source.functions
    if method.refin != method.refout:
        expression, functions = f"reflect({expression}, {method.width})", (*functions, "reflect")
    return replace(source, expression=expression + _plus("^", xorout), functions=functions)


def _standard_crc(method: CheckMethod, data: str) -> tuple[CheckSource, int] | None:
    """Return source that uses the standard library, and the remaining number to exclusive-or.

    None if it has no such CRC.

    `binascii` implements two polynomials in C: for 250 bytes 20 times as fast as a loop over a table.
    """
    library = ("import binascii",)
    if (method.width, method.poly) == (16, 0x1021):
        if not method.refin:
            return CheckSource(f"binascii.crc_hqx({data}, {method.initial:#x})", imports=library), method.xorout
        call = f"crc_1021_reflected({data}, MIRROR, {method.initial:#x})"
        constants = (("MIRROR", "make_mirror()"),)
        return CheckSource(call, ("crc_1021_reflected",), constants, ("make_mirror",)), method.xorout
    if (method.width, method.poly, method.refin, method.refout) == (32, 0x04C11DB7, True, True):
        # the library's function inverts the register before and after the computation
        start = support.reflect(method.initial, 32) ^ 0xFFFFFFFF
        call = f"binascii.crc32({data}, {start:#x})" if start else f"binascii.crc32({data})"
        return CheckSource(call, imports=library), method.xorout ^ 0xFFFFFFFF
    return None


def _table_crc(method: CheckMethod, data: str) -> CheckSource:
    width, start = method.width, method.initial
    direction = "reflected" if method.refin else "forward"
    kind = "WORDS" if width == 16 else "TABLE"
    table = f"CRC{width}_{method.poly:X}_{direction.upper()}_{kind}"
    if method.refin:
        start = support.reflect(start, width)
    if width == 16:
        name, maker = f"crc16_{direction}", "make_crc_words"
        made = f"make_crc_words({method.poly:#x}, {method.refin})"
    else:
        name, maker = f"crc_{direction}", "make_crc_table"
        made = f"make_crc_table({width}, {method.poly:#x}, {method.refin})"
    call = f"{name}({data}, {table}, {start:#x})"
    if width <= 8:
        name, left = "crc_narrow", 0 if method.refin else 8 - width
        call = f"crc_narrow({data}, {table}, {start << left:#x})" + (f" >> {left}" if left else "")
    elif width != 16 and not method.refin:
        call = f"crc_forward({data}, {table}, {width}, {start:#x})"
    return CheckSource(call, (name,), ((table, made),), (maker,))


def _ones(method: CheckMethod) -> int:
    """Return the mask of the bits of a code."""
    width = min(method.width, 7) if method.kind in ("sum7", "xor7") else method.width
    return (1 << width) - 1


def _plus(operator: str, value: int) -> str:
    """Return the source that applies `value` to an expression with an operator; empty for 0."""
    return f" {operator} {value:#x}" if value else ""


def _finished(method: CheckMethod, source: CheckSource, fits: bool) -> CheckSource:
    """Return the source with complement, width and mask applied."""
    ones = _ones(method)
    bits = ones if method.mask is None else ones & method.mask
    expression = source.expression
    if not CALL.fullmatch(expression):
        expression = f"({expression})"
    if method.complement is not None:
        expression = f"{'~' if method.complement == 'ones' else '-'}{expression} & {bits:#x}"
    elif not fits or bits != ones:
        expression = f"{expression} & {bits:#x}"
    else:
        return source
    return replace(source, expression=expression)
