"""Runs of fixed segments packed at once: arguments of one struct, hex digits of neighbours formatted together."""

from __future__ import annotations

import re
from dataclasses import dataclass

from framekit.codec.python import forms
from framekit.codec.python.coverage import Coverage
from framekit.codec.python.expressions import Scope
from framekit.codec.python.module import Module
from framekit.codec.python.nested_values import NestedValueWriter
from framekit.codec.python.source import bytes_literal
from framekit.definition.model.segments import (
    Bits,
    Check,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Fill,
    Length,
    Repeat,
    Segment,
    Skip,
)
from framekit.definition.model.walk import leaves, without_when

_DIGITS = re.compile(r'b"(%0\d+[Xx])" % (\w+|\([^()]*\))')
_MOST_PLUSES = 4
"""More pieces than so many are joined."""
Placed = tuple[Segment, Scope]
Number = Field | Length | Count | Bits


@dataclass(slots=True)
class Argument:
    """One argument of a struct: code, byte order, text; `digits`: the numbers whose hex digits it is."""

    code: str
    order: str
    text: str
    digits: tuple[FieldType, ...] = ()


class PackingWriter(NestedValueWriter):
    """Writes the bytes of runs of segments whose values are known."""

    def __init__(self, module: Module, title: str, segments: tuple[Segment, ...]) -> None:
        super().__init__(module, title, segments)
        self.coverage = Coverage(segments)

    # ---- runs ---------------------------------------------------------------------------------------------

    def length_of_run(self, placed: list[Placed]) -> int:
        """How many of the segments can be put together at once."""
        order, first = "", placed[0][0]
        mark = self.coverage.of(leaf.name or "" for leaf in leaves((first,)))
        for count, (segment, scope) in enumerate(placed):
            numbers = self.numbers_of(segment)
            wanted = None if isinstance(segment, (Check, Fill)) else forms.struct_order(without_when(segment))
            if numbers is not None and count:
                wanted = numbers[1]
            same_when = str(segment.when) == str(first.when) and (segment.when is None or scope is placed[0][1])
            marked = self.coverage.of((segment.name or "",)) != mark
            if wanted is None or not same_when or marked or (order and wanted and wanted != order):
                return max(count, 1)
            if numbers is not None:
                return count + 1
            order = order or wanted
        return len(placed)

    def numbers_of(self, segment: Segment) -> tuple[str, str] | None:
        """The `struct` code of a list of numbers, and its order; a list ends a run. None for all other segments."""
        if not isinstance(segment, Repeat) or not isinstance(segment.of, FieldType) or segment.name in self.wires:
            return None
        code = forms.struct_code(segment.of)
        return None if code is None or code == ("B", "") or code[0].endswith("s") else code

    def run(self, placed: list[Placed]) -> str:
        """Text of the bytes of a run; it depends on the condition its segments stand under."""
        segment, scope = placed[0]
        if len(placed) == 1 and (forms.struct_order(without_when(segment)) is None):
            return self.single(segment, scope)
        arguments: list[Argument] = []
        last, numbers = placed[-1], self.numbers_of(placed[-1][0])
        for one, inside in placed if numbers is None else placed[:-1]:
            self._append(arguments, self._argument(one, inside))
        arguments = [self._with_digits(argument) for argument in arguments]
        if numbers is None:
            text = self._packed(arguments)
        else:
            text = self._packed_with_list(arguments, numbers, last[1].entries[last[0].name or ""].text)
        return self.if_present(segment, scope, text, 'b""')

    def _append(self, arguments: list[Argument], new: Argument) -> None:
        """Adds an argument; zeros, literals and hex digits are put together with those before."""
        last = arguments[-1] if arguments else None
        if last is not None and last.digits and new.digits:
            orders = {type_.order for type_ in (*last.digits, *new.digits) if type_.fixed_size != 2}
            if len(orders) <= 1 and last.digits[0].upper == new.digits[0].upper:
                last.text, last.digits = f"{last.text}, {new.text}", (*last.digits, *new.digits)
                return
        if last is not None and last.code.endswith("s") and new.code.endswith("s"):
            both = merged([last.text, new.text])
            if len(both) == 1 and both[0].startswith('b"'):
                last.code, last.text = f"{int(last.code[:-1]) + int(new.code[:-1])}s", both[0]
                return
        if last is not None and last.code.endswith("x") and new.code.endswith("x"):
            last.code = f"{int(last.code[:-1] or 1) + int(new.code[:-1] or 1)}x"
            return
        arguments.append(new)

    def _argument(self, segment: Segment, scope: Scope) -> Argument:
        size = self.shapes.present(segment).fixed or 0
        match segment:
            case Const(data=data):
                return Argument(f"{size}s", "", bytes_literal(data))
            case Skip(fill=fill):
                if size and not fill.strip(b"\0"):
                    return Argument(f"{size}x" if size > 1 else "x", "", "")
                return Argument(f"{size}s", "", bytes_literal((fill * size)[:size]))
            case Data():
                return Argument(f"{size}s", "", self.data_text(segment, scope))
        assert isinstance(segment, (Field, Length, Count, Bits))
        wire = self.wire(segment, scope)
        if forms.hex_places(segment.type) is not None:
            return Argument(f"{size}s", "", wire, (segment.type,))
        code, order = forms.struct_code(segment.type) or (f"{size}s", "")
        if code.endswith("s"):
            return Argument(code, "", forms.build(self.module, segment.type, wire, str(size)))
        return Argument(code, order, wire)

    def _with_digits(self, argument: Argument) -> Argument:
        """Hex digits of one number are formatted, those of several packed and converted at once."""
        types = argument.digits
        if not types:
            return argument
        size = sum(type_.fixed_size or 0 for type_ in types)
        if len(types) == 1:
            if types[0].order == "little" and size > 2:
                text = forms.build(self.module, types[0], argument.text, str(size))
            else:
                form = f"%0{size}{'X' if types[0].upper else 'x'}"
                text = f"{bytes_literal(form.encode())} % {_operand(argument.text)}"
            return Argument(f"{size}s", "", text)
        self.module.imports.add("from binascii import hexlify")
        codes = "".join(forms.INT_CODES[(type_.fixed_size or 2) // 2] for type_ in types)
        order = next(("<" if type_.order == "little" else ">" for type_ in types if type_.fixed_size != 2), "")
        constant = self.module.struct(codes, order, self.title, "digits")
        upper = ".upper()" if types[0].upper else ""
        return Argument(f"{size}s", "", f"hexlify({constant}.pack({argument.text})){upper}")

    def _packed(self, arguments: list[Argument]) -> str:
        """Text of the bytes of the arguments of one struct."""
        if all(argument.code[-1] in "sx" for argument in arguments):
            texts = [argument.text or bytes_literal(bytes(int(argument.code[:-1] or 1))) for argument in arguments]
            return _formatted(merged(texts)) or 'b""'
        if len(arguments) == 1 and arguments[0].code == "B":
            return f"{self.module.struct('B', '')}.pack({arguments[0].text})"  # half the time of bytes((…,))
        order = next((argument.order for argument in arguments if argument.order), "")
        constant = self.module.struct("".join(argument.code for argument in arguments), order, self.title)
        return f"{constant}.pack({', '.join(argument.text for argument in arguments if argument.text)})"

    def _packed_with_list(self, arguments: list[Argument], numbers: tuple[str, str], local: str) -> str:
        """Text of the bytes of the arguments with a list of numbers behind them: one struct for both."""
        order = next((argument.order for argument in arguments if argument.order), numbers[1])
        before = "".join(argument.code for argument in arguments)
        packs = self.packs(local, before, numbers[0], order)
        texts = ", ".join(argument.text for argument in arguments if argument.text)
        return f"{packs}[{self.count_of(local)}]({texts}, *{local})"

    def packs(self, local: str, before: str, code: str, order: str) -> str:
        """The module constant with what packs a list behind what is `before` it, by the number of its values."""
        return self.module.list_structs(before, code, order, self.title, "values", packs=True)

    def wire(self, segment: Number, scope: Scope) -> str:
        """Text of the number or text that is written."""
        if isinstance(segment, Bits):
            parts = []
            for part in segment.parts:
                text = scope.entries[part.name].text
                if text != "0":
                    parts.append(f"{text} << {part.low}" if part.low else text)
            return " | ".join(parts) or "0"
        return forms.wire_of(segment, scope.entries[segment.name].text)

    def data_text(self, data: Data, scope: Scope) -> str:
        """Text of the bytes of data on the wire."""
        return forms.wire_text(self.module, data, scope.entries[data.name].text)

    def single(self, segment: Segment, scope: Scope) -> str:
        """Text of the bytes of a segment that is in no run."""
        raise NotImplementedError


def _operand(text: str) -> str:
    return text if text.isidentifier() or text.isdigit() else f"({text})"


def sum_of(texts: list[str]) -> str:
    """Text of all these bytes one behind the other."""
    parts = merged([text for text in texts if text])
    if len(parts) > _MOST_PLUSES:
        return f'b"".join(({", ".join(parts)}))'
    return " + ".join(parts) or 'b""'


def _formatted(parts: list[str]) -> str:
    """Text of all these bytes; where several are numbers in digits, formatted at once in half the time of a sum."""
    numbers = [_DIGITS.fullmatch(part) for part in parts]
    if sum(number is not None for number in numbers) < 2:
        return " + ".join(parts)
    form, operands = "", []
    for part, number in zip(parts, numbers, strict=True):
        if number is not None:
            form += number[1]
            operands.append(number[2].removeprefix("(").removesuffix(")") if number[2][0] == "(" else number[2])
        elif part.startswith('b"') and part.count('"') == 2 and part.endswith('"'):
            form += part[2:-1].replace("%", "%%")
        else:
            form += "%b"
            operands.append(part)
    return 'b"' + form + '" % (' + ", ".join(operands) + ")"


def merged(texts: list[str]) -> list[str]:
    """Neighbouring literals put together, empty ones left out."""
    found: list[str] = []
    for text in texts:
        simple = text.startswith('b"') and text.count('"') == 2 and text.endswith('"')
        if text == 'b""':
            continue
        if simple and found and found[-1].startswith('b"') and found[-1].count('"') == 2 and found[-1].endswith('"'):
            found[-1] = found[-1][:-1] + text[2:]
        else:
            found.append(text)
    return found
