"""Write the source that converts a field's bytes to its value and back, and a check code to its bytes.

The *wire* value is the meaning of the bytes by their type alone; `plus`, `unit` and `zero_means` convert it to the
field's value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from framekit.codec.python.module import Module
from framekit.codec.python.source import bytes_literal, literal, quoted
from framekit.definition.expression import Expression
from framekit.definition.kinds.check import Added
from framekit.definition.model.segments import Check, Count, Data, Field, FieldType, Length

INT_CODES = {1: "B", 2: "H", 4: "I", 8: "Q"}
_FLOAT_CODES = {4: "f", 8: "d"}
_DIGIT_NAMES = {16: "hex", 10: "dec", 8: "oct"}
Numbered = Field | Length | Count


class Functions(Protocol):
    """Provide the names of functions that generated source calls, and collect the imports it requires."""

    imports: set[str]

    def function(self, helper: str | Callable[..., Any]) -> str: ...


def struct_code(type_: FieldType) -> tuple[str, str] | None:
    """Return the `struct` code of a type and its byte order (`<`, `>`, '' for any); None if it has no code."""
    if type_.fixed_size is None:
        return None
    size = type_.fixed_size
    if type_.kind == "int" and size == 1:
        return ("b" if type_.signed else "B"), ""
    codes = {"int": INT_CODES, "float": _FLOAT_CODES}.get(type_.kind, {})
    if size in codes and type_.order in ("big", "little"):
        code = codes[size].lower() if type_.kind == "int" and type_.signed else codes[size]
        return code, "<" if type_.order == "little" else ">"
    return f"{size}s", ""


def check_code(check: Check) -> tuple[str, str]:
    """Return the `struct` code of a check code and its byte order (`<`, `>`, '' for any)."""
    if check.form == "raw" and check.size in INT_CODES:
        return INT_CODES[check.size], "" if check.size == 1 else "<" if check.order == "little" else ">"
    return f"{check.size}s", ""


def rule_type(type_: FieldType) -> str:
    """Return the name that rules use for the values of a type."""
    kinds = {
        "ascii": "text", "bytes": "bytes", "float": "float", "hex_float": "float", "fraction": "decimal",
        "scaled": "decimal",
    }  # fmt: skip
    return kinds.get(type_.kind, "number")


def is_slice(type_: FieldType) -> bool:
    """Return whether unpacking gives bytes that need further conversion."""
    code = struct_code(type_)
    return code is None or code[0].endswith("s")


def hex_places(type_: FieldType) -> int | None:
    """Return the number of bytes that hex digits encode, if `unhexlify` and a struct can read them.

    None for any number of digits other than 2, 4, 8 or 16.
    """
    if type_.kind == "digits" and type_.base == 16 and type_.fixed_size in (2, 4, 8, 16):
        return type_.fixed_size // 2
    return None


def parse(functions: Functions, type_: FieldType, raw: str) -> str:
    """Return the source of the wire value in the bytes `raw` (source of a slice)."""
    return WIRE_FORMS[type_.kind].parse(functions, type_, raw)


def build(functions: Functions, type_: FieldType, wire: str, size: str) -> str:
    """Return the source of the bytes of a wire value; `size` is the source of the type's size."""
    return WIRE_FORMS[type_.kind].build(functions, type_, wire, size)


@dataclass(frozen=True, slots=True)
class WireForm:
    """The encoding of a kind of type: functions that return the source to read and to build its bytes."""

    parse: Callable[[Functions, FieldType, str], str]
    """Takes the source of a slice."""
    build: Callable[[Functions, FieldType, str, str], str]
    """Takes the source of the value and that of the size in bytes."""


def _parse_int(functions: Functions, type_: FieldType, raw: str) -> str:
    signed = ", True" if type_.signed else ""
    if type_.order in ("BADC", "CDAB"):
        return f"{functions.function('parse_int')}({raw}, {quoted(type_.order)}{signed})"
    return f"int.from_bytes({raw}, {quoted(type_.order)}{', signed=True' if type_.signed else ''})"


def _build_int(functions: Functions, type_: FieldType, wire: str, size: str) -> str:
    if type_.order in ("BADC", "CDAB"):
        signed = ", True" if type_.signed else ""
        return f"{functions.function('build_int')}({wire}, {size}, {quoted(type_.order)}{signed})"
    return f"({wire}).to_bytes({size}, {quoted(type_.order)}{', signed=True' if type_.signed else ''})"


def digits_number(functions: Functions, base: int, little: bool, digits: str) -> str:
    """Return the source of the number that digits show; little-endian hex digits are reversed in pairs."""
    pairs = "_little" if little and base == 16 else ""
    turned = "[::-1]" if little and not pairs else ""
    return f"{functions.function(f'parse_{_DIGIT_NAMES[base]}{pairs}')}({digits}{turned})"


def digits_text(functions: Functions, base: int, little: bool, lower: bool, number: str, size: str) -> str:
    """Return the source of the digits of a number; little-endian hex digits are reversed in pairs."""
    pairs = "_little" if little and base == 16 else ""
    turned = "[::-1]" if little and not pairs else ".lower()" if lower else ""
    return f"{functions.function(f'build_{_DIGIT_NAMES[base]}{pairs}')}({number}, {size}){turned}"


def _turned(type_: FieldType) -> str:
    return "[::-1]" if type_.order == "little" else ""


def _parse_text(functions: Functions, type_: FieldType, raw: str) -> str:
    if type_.end is not None:
        raw = f"{raw}.split({bytes_literal(type_.end)}, 1)[0]"
    strip = "" if type_.pad is None else f".rstrip({bytes_literal(type_.pad)})"
    return f'{raw}{strip}.decode("latin-1")'


def _build_text(functions: Functions, type_: FieldType, wire: str, size: str) -> str:
    if type_.end is not None and type_.size is None:
        return f"{functions.function('build_terminated')}({wire}, {bytes_literal(type_.end)})"
    if type_.stops:
        return f"{functions.function('build_stopped')}({wire}, {stops_literal(type_)})"
    if wire.startswith('"'):
        return bytes_literal(eval(wire).encode("latin-1"))
    pad = type_.pad if type_.end is None else (type_.pad or b"\0")
    return f'{wire}.encode("latin-1")' + ("" if pad is None else f".ljust({size}, {bytes_literal(pad)})")


def _form_arguments(type_: FieldType) -> str:
    assert type_.form is not None
    return ", ".join(literal(one) for one in type_.form.arguments)


def refusing(functions: Functions, type_: FieldType) -> str:
    """Return the source of a function that raises an error for numbers a type cannot hold.

    The result is empty if a range is enough.
    """
    if type_.scale is not None:
        return f"lambda value: {_unscaled(functions, type_, 'value')}"
    size = type_.fixed_size or 0
    return f"lambda value: {_build_decimal(functions, type_, 'value', str(size))}" if type_.form is not None else ""


def _inside(type_: FieldType) -> tuple[FieldType, str]:
    """Return the type of the encoded number, and the source of the arguments of its scale."""
    assert type_.inside is not None and type_.scale is not None
    return type_.inside, ", ".join(map(str, type_.scale.arguments))


def _unscaled(functions: Functions, type_: FieldType, value: str) -> str:
    inside, scale = _inside(type_)
    limits = wire_range(inside)
    return f"{functions.function('unscaled')}({value}, {scale}, {limits.least}, {limits.most})"


def _parse_scaled(functions: Functions, type_: FieldType, raw: str) -> str:
    inside, scale = _inside(type_)
    return f"{functions.function('scaled')}({parse(functions, inside, raw)}, {scale})"


def _build_scaled(functions: Functions, type_: FieldType, wire: str, size: str) -> str:
    return build(functions, _inside(type_)[0], _unscaled(functions, type_, wire), size)


def find_end(functions: Functions, type_: FieldType, buffer: str, place: str) -> str:
    """Return the source of the offset where a delimited value that begins at `place` ends."""
    if type_.end is not None:
        return f"{buffer}.index({bytes_literal(type_.end)}, {place})"
    return f"{functions.function('index_stop')}({buffer}, {stops_literal(type_)}, {place})"


def stops_literal(type_: FieldType) -> str:
    """Return the literal of the delimiters before which a value ends.

    This is a bytes literal of single bytes, or a tuple if any delimiter is longer.
    """
    return literal(type_.stops) if type_.has_long_stops else bytes_literal(b"".join(type_.stops))


def _parse_decimal(functions: Functions, type_: FieldType, raw: str) -> str:
    assert type_.form is not None
    text = f"{functions.function('parse_decimal')}({raw}, {type_.size is not None}, {_form_arguments(type_)})"
    return f"({text} if {raw} else None)" if type_.form.empty else text


def _build_decimal(functions: Functions, type_: FieldType, wire: str, size: str) -> str:
    end = "" if type_.end is None else f" + {bytes_literal(type_.end)}"
    size = size if type_.size is not None else "None"
    return f"{functions.function('build_decimal')}({wire}, {size}, {_form_arguments(type_)}){end}"


def _in_hex(type_: FieldType) -> FieldType:
    """Return the type of the bytes that the hex digits encode."""
    kind = "int" if type_.kind == "hex_int" else "float"
    return FieldType(kind, (type_.fixed_size or 2) // 2, signed=True, order=type_.order)


def _parse_hex(functions: Functions, type_: FieldType, raw: str) -> str:
    functions.imports.add("from binascii import unhexlify")
    return parse(functions, _in_hex(type_), f"unhexlify({raw})")


def _build_hex(functions: Functions, type_: FieldType, wire: str, size: str) -> str:
    functions.imports.add("from binascii import hexlify")
    inside = _in_hex(type_)
    return f"hexlify({build(functions, inside, wire, str(inside.size))}){'.upper()' if type_.upper else ''}"


WIRE_FORMS: dict[str, WireForm] = {
    "int": WireForm(_parse_int, _build_int),
    "float": WireForm(
        lambda functions, type_, raw: f"{functions.function('parse_float')}({raw}, {quoted(type_.order)})",
        lambda functions, type_, wire, size: (
            f"{functions.function('build_float')}({wire}, {size}, {quoted(type_.order)})"
        ),
    ),
    "digits": WireForm(
        lambda functions, type_, raw: digits_number(functions, type_.base, type_.order == "little", raw),
        lambda functions, type_, wire, size: digits_text(
            functions, type_.base, type_.order == "little", type_.base == 16 and not type_.upper, wire, size
        ),
    ),
    "bcd": WireForm(
        lambda functions, type_, raw: f"{functions.function('parse_bcd')}({raw}{_turned(type_)})",
        lambda functions, type_, wire, size: f"{functions.function('build_bcd')}({wire}, {size}){_turned(type_)}",
    ),
    "hex_int": WireForm(_parse_hex, _build_hex),
    "hex_float": WireForm(_parse_hex, _build_hex),
    "decimal": WireForm(_parse_decimal, _build_decimal),
    "fraction": WireForm(_parse_decimal, _build_decimal),
    "scaled": WireForm(_parse_scaled, _build_scaled),
    "ascii": WireForm(_parse_text, _build_text),
    "bytes": WireForm(lambda functions, type_, raw: raw, lambda functions, type_, wire, size: wire),
}
"""The encodings by kind of type; `definition/wire_types.py` defines the other properties of the kinds."""


def plus_text(number: int) -> str:
    """Return the source that adds a number to the preceding expression; empty for 0."""
    return f" + {number}" if number > 0 else f" - {-number}" if number else ""


def value_of(field: Numbered, wire: str) -> str:
    """Return the source of the field's value, given the source of its wire value."""
    text = wire
    if isinstance(field, Field):
        text += plus_text(-field.plus)
        if field.unit is not None and field.unit != 1:
            text = f"({text})" if field.plus else text
            text = f"{text} * {field.unit:_}"
    if field.zero_means is not None:
        return f"{wire} or {field.zero_means}" if text == wire else f"{text} if {wire} else {field.zero_means}"
    return text


def wire_of(field: Numbered, value: str) -> str:
    """Return the source of the wire value, given the source of the field's value (a name)."""
    text = value
    if isinstance(field, Field):
        if field.unit is not None and field.unit != 1:
            text = f"{text} // {field.unit:_}"
        text += plus_text(field.plus)
    if field.zero_means is not None:
        return f"0 if {value} == {field.zero_means} else {text}"
    return text


def reads_twice(field: Numbered) -> bool:
    """Return whether the source of the value contains the wire value twice."""
    return field.zero_means is not None and value_of(field, "wire").count("wire") > 1


def changes_value(field: Numbered) -> bool:
    """Return whether the value differs from the wire value."""
    return value_of(field, "x") != "x"


@dataclass(frozen=True, slots=True)
class Range:
    """Least and greatest number; None for no bound."""

    least: int | None
    most: int | None


def wire_range(type_: FieldType) -> Range:
    """Return the range of numbers that the type can hold."""
    bounds = type_.bounds
    if bounds is not None:
        return Range(*bounds)
    return Range(None if type_.signed else 0, None)


def value_range(field: Numbered) -> Range:
    """Return the range of values that the field can hold, by its type and its limits."""
    if isinstance(field, Field) and field.long is not None:
        found = wire_range(field.long.type)
    else:
        found = wire_range(field.type)
    least, most = found.least, found.most
    if field.zero_means is not None:
        least = least or 1
    if isinstance(field, Field):
        least = None if least is None else (least - field.plus) * (field.unit or 1)
        most = None if most is None else (most - field.plus) * (field.unit or 1)
    if field.zero_means is not None and most is not None:
        most = max(most, field.zero_means)
    if field.limits is not None:
        least = field.limits[0] if least is None else max(least, field.limits[0])
        most = field.limits[1] if most is None else min(most, field.limits[1])
    return Range(least, most)


def memory_text(functions: Functions, data: Data, wire: str) -> str:
    """Return the source of the bytes in memory, given the encoded bytes: conversion, then swap."""
    if data.convert == "hex_to_ascii":
        wire = _converted(functions, "ascii_to_hex", wire)
    elif data.convert == "ascii_to_hex":
        wire = _converted(functions, "hex_to_ascii", wire)
    return f"{functions.function('swap')}({wire}, {data.swap})" if data.swap else wire


def wire_text(functions: Functions, data: Data, memory: str) -> str:
    """Return the source of the encoded bytes, given the bytes in memory: swap, then conversion."""
    if data.swap:
        memory = f"{functions.function('swap')}({memory}, {data.swap})"
    if data.convert is None:
        return memory
    return _converted(functions, data.convert, memory)


def holds_never(data: Data, local: str) -> str:
    """Return the source of the condition that bytes contain a forbidden byte."""
    never = bytes_literal(data.never)
    return f"{never} in {local}" if len(data.never) == 1 else f"{local}.translate(None, {never}) != {local}"


def _converted(functions: Functions, convert: str, text: str) -> str:
    """Return the source of a conversion, inlined instead of a call of the function of the same name."""
    if convert == "hex_to_ascii":
        functions.imports.add("from binascii import hexlify")
        return f"hexlify({text}).upper()"
    functions.imports.add("from binascii import unhexlify")
    return f"unhexlify({text})"


# ---- check codes ---------------------------------------------------------------------------------------------


def needs(check: Check, text: Callable[[Expression], str], context: str = "ctx") -> str:
    """Return the source of the further input of a check code.

    This is its key, or for an expression the whole context; empty for other check codes.
    """
    if check.method.kind == "code":
        return context
    return "" if check.key is None else text(check.key)


def code_text(module: Module, check: Check, covered: str, key: str = "") -> str:
    """Return the source of a check code as a number, cut to its encoded width, as an operand of a comparison.

    `key`: the source of its further input.
    """
    return operand(_number(module, check, covered, key))


def _number(module: Module, check: Check, covered: str, key: str) -> str:
    if check.method.is_keyed:
        return module.mac(check.method, covered, key, check.code_size)
    code = module.check(check.method, covered)
    bits = {"raw": 8, "nibbles": 4, "hex": 4, "HEX": 4, "dec": 0}[check.form] * check.size
    if bits and check.method.width > bits:
        code = f"({code}) & {(1 << bits) - 1:#x}"
    return code


def code_bytes(module: Module, check: Check, covered: str, key: str = "") -> str:
    """Return the source of the bytes of a check code over `covered` (source)."""
    code = code_text(module, check, covered, key)
    little = check.order == "little"
    if check.form == "raw":
        if check.size in INT_CODES:  # a little faster than `to_bytes`
            struct = module.struct(*check_code(check))
            return f"{struct}.pack({_number(module, check, covered, key)})"
        return f"{code}.to_bytes({check.size}, {quoted(check.order)})"
    if check.form == "dec":
        return digits_text(module, 10, little, False, code, str(check.size))
    if check.form == "nibbles" and little:
        return f'{module.function("split_nibbles")}({code}.to_bytes({check.size // 2}, "little"))'
    if check.form == "nibbles":
        return f"{module.function('build_nibbles')}({code}, {check.size // 2})"
    if check.size == 2 and not little:
        return f"{bytes_literal(b'%02x' if check.form == 'hex' else b'%02X')} % {code}"
    return digits_text(module, 16, little, check.form == "hex", code, str(check.size))


def code_number(module: Module, check: Check, raw: str) -> str:
    """Return the source of the number that a check code's bytes encode."""
    little = check.order == "little"
    if check.form == "raw":
        return f"int.from_bytes({raw}, {quoted(check.order)})"
    if check.form == "dec":
        return digits_number(module, 10, little, raw)
    if check.form == "nibbles" and little:
        return f'int.from_bytes({module.function("join_nibbles")}({raw}), "little")'
    if check.form == "nibbles":
        return f"{module.function('parse_nibbles')}({raw})"
    if check.size == 2:
        module.imports.add("from binascii import unhexlify")
        return f"unhexlify({raw})[0]"
    return digits_number(module, 16, little, raw)


def wrong_code(module: Module, check: Check, found: str, code: str) -> str:
    """Return the source of the condition that a check code is wrong, given the sources of both numbers.

    Codes made with a key are compared in constant time.
    """
    if not check.method.is_keyed:
        return f"{found} != {code}"
    return f"not {module.function('is_same_code')}({found}, {code}, {check.code_size})"


def added_text(functions: Functions, added: Added, value: str) -> str:
    """Return the source of bytes that a check code covers but no segment holds.

    `value` is the source of their expression.
    """
    if added.type is None:
        return value
    return build(functions, added.type, value, str(added.type.fixed_size))


def operand(text: str) -> str:
    """Return a source as an operand of a comparison, in parentheses if it needs them."""
    return text if is_call(text) else f"({text})"


def is_call(text: str) -> bool:
    """Return whether a source is a single name or call, which needs no parentheses."""
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
