"""The pack plan of a run of segments: what one struct packs, and the texts of bytes that stand one behind the other."""

from __future__ import annotations

import re
from dataclasses import dataclass

from framekit.codec.python import forms
from framekit.codec.python.module import Module
from framekit.codec.python.source import bytes_literal
from framekit.definition.model.segments import FieldType

_DIGITS = re.compile(r'b"(%0\d+[Xx])" % (\w+|\([^()]*\))')
_MOST_PLUSES = 4
"""More pieces than so many are joined."""


@dataclass(slots=True)
class PackArgument:
    """One argument of a struct: code, byte order, text; `digits`: the numbers whose hex digits it is."""

    code: str
    order: str
    text: str
    digits: tuple[FieldType, ...] = ()


class PackPlan:
    """The arguments of one struct; `title` names its constant in the module."""

    def __init__(self, module: Module, title: str) -> None:
        self.module, self.title = module, title
        self.arguments: list[PackArgument] = []

    @property
    def order(self) -> str:
        """The byte order of those that have one; empty if none has."""
        return next((argument.order for argument in self.arguments if argument.order), "")

    def add(self, new: PackArgument) -> None:
        """Adds an argument; zeros, literals and hex digits are put together with those before."""
        last = self.arguments[-1] if self.arguments else None
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
        self.arguments.append(new)

    def finished(self) -> tuple[str, list[str]]:
        """The codes of all arguments as one, and the texts of those that have one."""
        self.arguments = [self._with_digits(argument) for argument in self.arguments]
        codes = "".join(argument.code for argument in self.arguments)
        return codes, [argument.text for argument in self.arguments if argument.text]

    def text(self) -> str:
        """Text of the bytes of all arguments."""
        codes, texts = self.finished()
        arguments = self.arguments
        if all(argument.code[-1] in "sx" for argument in arguments):
            texts = [argument.text or bytes_literal(bytes(int(argument.code[:-1] or 1))) for argument in arguments]
            return _formatted(merged(texts)) or 'b""'
        if codes == "B":
            return f"{self.module.struct('B', '')}.pack({texts[0]})"  # half the time of bytes((…,))
        return f"{self.module.struct(codes, self.order, self.title)}.pack({', '.join(texts)})"

    def _with_digits(self, argument: PackArgument) -> PackArgument:
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
            return PackArgument(f"{size}s", "", text)
        self.module.imports.add("from binascii import hexlify")
        codes = "".join(forms.INT_CODES[(type_.fixed_size or 2) // 2] for type_ in types)
        order = next(("<" if type_.order == "little" else ">" for type_ in types if type_.fixed_size != 2), "")
        constant = self.module.struct(codes, order, self.title, "digits")
        upper = ".upper()" if types[0].upper else ""
        return PackArgument(f"{size}s", "", f"hexlify({constant}.pack({argument.text})){upper}")


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
        elif is_literal(part):
            form += part[2:-1].replace("%", "%%")
        else:
            form += "%b"
            operands.append(part)
    return 'b"' + form + '" % (' + ", ".join(operands) + ")"


def merged(texts: list[str]) -> list[str]:
    """Neighbouring literals put together, empty ones left out."""
    found: list[str] = []
    for text in texts:
        if text == 'b""':
            continue
        if is_literal(text) and found and is_literal(found[-1]):
            found[-1] = found[-1][:-1] + text[2:]
        else:
            found.append(text)
    return found


def is_literal(text: str) -> bool:
    """Whether a text is a literal of bytes and nothing else, not one that goes on with `%`."""
    return text.startswith('b"') and text.endswith('"') and text.count('"') == 2
