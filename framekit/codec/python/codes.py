"""Check codes on the wire: the bytes a code is sent as."""

from __future__ import annotations

from framekit.codec.python import forms
from framekit.codec.python.module import Module
from framekit.codec.python.source import bytes_literal, quoted
from framekit.definition.model.segments import Check


def code_text(module: Module, check: Check, covered: str) -> str:
    """Text of the number a check code is, cut to the room it has on the wire; an operand of a comparison."""
    code = _number(module, check, covered)
    return code if is_call(code) else f"({code})"


def _number(module: Module, check: Check, covered: str) -> str:
    code = module.check(check.method, covered)
    bits = {"raw": 8, "nibbles": 4, "hex": 4, "HEX": 4, "dec": 0}[check.form] * check.size
    if bits and check.method.width > bits:
        code = f"({code}) & {(1 << bits) - 1:#x}"
    return code


def code_bytes(module: Module, check: Check, covered: str) -> str:
    """Text of the bytes of a check code over `covered` (a text)."""
    code = code_text(module, check, covered)
    little = "_little" if check.order == "little" else ""
    if check.form == "raw":
        if check.size in forms.INT_CODES:  # a little sooner than to_bytes
            order = "" if check.size == 1 else "<" if check.order == "little" else ">"
            struct = module.struct(forms.INT_CODES[check.size], order)
            return f"{struct}.pack({_number(module, check, covered)})"
        return f"{code}.to_bytes({check.size}, {quoted(check.order)})"
    if check.form == "dec":
        return f"{module.function(f'build_dec{little}')}({code}, {check.size})"
    if check.form == "nibbles" and little:
        return f'{module.function("split_nibbles")}({code}.to_bytes({check.size // 2}, "little"))'
    if check.form == "nibbles":
        return f"{module.function('build_nibbles')}({code}, {check.size // 2})"
    lower = "_lower" if check.form == "hex" else ""
    if check.size == 2 and not little:
        return f"{bytes_literal(b'%02x' if lower else b'%02X')} % {code}"
    return f"{module.function(f'build_hex{little}{lower}')}({code}, {check.size})"


def is_call(text: str) -> bool:
    """Whether a text is one name or call, so that it needs no parentheses around it."""
    if text.replace("_", "").isalnum():
        return True
    if not text.endswith(")") or text.startswith("("):
        return False
    depth = 0
    for place, sign in enumerate(text):
        depth += (sign in "([") - (sign in ")]")
        if depth == 0 and sign in " )" and place < len(text) - 1:
            return False
    return True
