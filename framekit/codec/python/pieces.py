"""Bytes from values: runs of fixed segments packed at once, the others one by one, check codes over what stands there.

All values are in locals when this begins; it writes the lines that put them together.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from framekit.codec.python import forms
from framekit.codec.python.codes import code_bytes
from framekit.codec.python.coverage import Coverage
from framekit.codec.python.expressions import Scope
from framekit.codec.python.function import leaves
from framekit.codec.python.module import Module
from framekit.codec.python.runs import struct_order, type_of
from framekit.codec.python.shape import Fill, without_when
from framekit.codec.python.source import bytes_literal, quoted
from framekit.codec.python.values import ValueWriter
from framekit.definition.expression.emit import OR
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import (
    Bits,
    Check,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Record,
    Repeat,
    Require,
    Segment,
    Skip,
    Value,
    Wrap,
)

_CODES = {1: "B", 2: "H", 4: "I", 8: "Q"}
_MOST_PLUSES = 4
"""More pieces than so many are joined."""
Placed = tuple[Segment, Scope]
Number = Field | Length | Count | Bits


@dataclass(slots=True)
class Part:
    """Some bytes of a buffer: the names of the segments in them, and their text."""

    names: tuple[str, ...]
    text: str


@dataclass(slots=True)
class Argument:
    """One argument of a struct: code, byte order, text; `digits`: the numbers whose hex digits it is."""

    code: str
    order: str
    text: str
    digits: tuple[FieldType, ...] = ()


class PieceWriter(ValueWriter):
    """Writes the bytes of segments whose values are known. `parts`: what checks may ask for."""

    def __init__(self, module: Module, title: str, segments: tuple[Segment, ...]) -> None:
        super().__init__(module, title, segments)
        self.coverage = Coverage(segments)
        self.parts: list[Part] = []

    def placed(self, segments: Iterable[Segment], scope: Scope) -> list[Placed]:
        """The segments with those of records; what takes no bytes is left out."""
        found: list[Placed] = []
        for segment in segments:
            if isinstance(segment, Record) and segment.when is None:
                inside = scope.entries[segment.name].inside
                assert inside is not None
                found.extend(self.placed(segment.of, inside))
            elif not isinstance(segment, (Value, Require)):
                found.append((segment, scope))
        return found

    def region(self, segments: Iterable[Segment], scope: Scope, buffer: str) -> str:
        """Text of the bytes of a whole buffer; checks are worked out on what is in the local `buffer` by then."""
        placed = self.placed(segments, scope)
        texts: list[str] = []
        place = 0
        while place < len(placed):
            segment, inside = placed[place]
            count = 1
            if isinstance(segment, Check):
                if segment.name in self.coverage.whole:
                    texts = [self._gather(texts, buffer)]
                texts.append(self._check(segment, inside, buffer))
                self.parts.append(Part((segment.name or "",), texts[-1]))
            elif isinstance(segment, Fill):
                texts = [self._filled(segment, placed[place + 1 :], texts, buffer)]
            else:
                count = self._length_of_run(placed[place:])
                texts.append(self._kept(placed[place : place + count], self._run(placed[place : place + count])))
            place += count
        return _sum(texts)

    def _gather(self, texts: list[str], buffer: str) -> str:
        """Puts everything so far into the buffer's local."""
        text = _sum(texts)
        if text != buffer:
            self.add(f"{buffer} = {text}")
        return buffer

    def _filled(self, fill: Fill, behind: list[Placed], texts: list[str], buffer: str) -> str:
        """Everything so far, filled up so that the frame gets its size."""
        self._gather(texts, buffer)
        fixed, parts = 0, []
        for segment, scope in behind:
            size = self.shapes.present(segment).fixed or 0
            if segment.when is None:
                fixed += size
            else:
                parts.append(self.if_present(segment, scope, str(size), "0"))
        room = " - ".join([str(fill.total - fixed), *parts])
        with self.out.block(f"if len({buffer}) > {room}:"):
            self.add(f'raise EncodeError("", f"the values take {{len({buffer})}} bytes, more than {{{room}}}")')
        self.add(f"{buffer} = {buffer}.ljust({room}, {bytes_literal(bytes((fill.byte,)))})")
        return buffer

    # ---- what checks cover --------------------------------------------------------------------------------

    def _kept(self, placed: list[Placed], text: str) -> str:
        """The text of a run; in a local, if a check asks for these bytes."""
        if isinstance(placed[0][0], Wrap):
            return text
        names = tuple(leaf.name or "" for segment, _ in placed for leaf in leaves((segment,)))
        if self.coverage.of(names) and not text.isidentifier() and not text.startswith('b"'):
            named = [name for name in names if not name.startswith("_")]
            local = self.names.fresh(f"{named[0]}_bytes" if len(named) == 1 else "covered")
            self.add(f"{local} = {text}")
            text = local
        self.parts.append(Part(names, text))
        return text

    def _check(self, check: Check, scope: Scope, buffer: str) -> str:
        covered = buffer
        if check.name not in self.coverage.whole:
            covered = _sum(self._parts_of(self.coverage.names(check) or []))
        return self.if_present(check, scope, code_bytes(self.module, replace(check, when=None), covered), 'b""')

    def _parts_of(self, names: list[str]) -> list[str]:
        texts: list[str] = []
        left = list(names)
        while left:
            part = next((part for part in reversed(self.parts) if left[0] in part.names), None)
            texts.extend([] if part is None else [part.text])
            left = left[max(1, 0 if part is None else sum(name in left for name in part.names)) :]
        return texts

    # ---- runs ---------------------------------------------------------------------------------------------

    def _length_of_run(self, placed: list[Placed]) -> int:
        """How many of the segments can be put together at once."""
        order, first = "", placed[0][0]
        mark = self.coverage.of(leaf.name or "" for leaf in leaves((first,)))
        for count, (segment, scope) in enumerate(placed):
            wanted = None if isinstance(segment, (Check, Fill)) else struct_order(without_when(segment))
            same_when = str(segment.when) == str(first.when) and (segment.when is None or scope is placed[0][1])
            marked = self.coverage.of((segment.name or "",)) != mark
            if wanted is None or not same_when or marked or (order and wanted and wanted != order):
                return max(count, 1)
            order = order or wanted
        return len(placed)

    def _run(self, placed: list[Placed]) -> str:
        """Text of the bytes of a run; it depends on the condition its segments stand under."""
        segment, scope = placed[0]
        if len(placed) == 1 and (struct_order(without_when(segment)) is None):
            return self.single(segment, scope)
        arguments: list[Argument] = []
        for one, inside in placed:
            self._append(arguments, self._argument(one, inside))
        text = self._packed([self._with_digits(argument) for argument in arguments])
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
            both = _merged([last.text, new.text])
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
                if not fill.strip(b"\0"):
                    return Argument(f"{size}x" if size > 1 else "x", "", "")
                return Argument(f"{size}s", "", bytes_literal((fill * size)[:size]))
            case Data():
                return Argument(f"{size}s", "", self._data_text(segment, scope))
        assert isinstance(segment, (Field, Length, Count, Bits))
        wire = self._wire(segment, scope)
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
                letter = "X" if types[0].upper else "x"
                text = f'b"%0{size}{letter}" % {_operand(argument.text)}'
            return Argument(f"{size}s", "", text)
        self.module.imports.add("from binascii import hexlify")
        codes = "".join(_CODES[(type_.fixed_size or 2) // 2] for type_ in types)
        order = next(("<" if type_.order == "little" else ">" for type_ in types if type_.fixed_size != 2), "")
        constant = self.module.struct(codes, order, self.title, "digits")
        upper = ".upper()" if types[0].upper else ""
        return Argument(f"{size}s", "", f"hexlify({constant}.pack({argument.text})){upper}")

    def _packed(self, arguments: list[Argument]) -> str:
        """Text of the bytes of the arguments of one struct."""
        if all(argument.code[-1] in "sx" for argument in arguments):
            texts = [argument.text or bytes_literal(bytes(int(argument.code[:-1] or 1))) for argument in arguments]
            merged = _merged(texts)
            return merged[0] if len(merged) == 1 else f"{' + '.join(merged)}"
        if len(arguments) == 1 and arguments[0].code == "B":
            return f"bytes(({arguments[0].text},))"
        order = next((argument.order for argument in arguments if argument.order), "")
        constant = self.module.struct("".join(argument.code for argument in arguments), order, self.title)
        return f"{constant}.pack({', '.join(argument.text for argument in arguments if argument.text)})"

    # ---- single segments ----------------------------------------------------------------------------------

    def _wire(self, segment: Number, scope: Scope) -> str:
        """Text of the number or text that is written."""
        if isinstance(segment, Bits):
            parts = []
            for part in segment.parts:
                text = scope.entries[part.name].text
                if text != "0":
                    parts.append(f"{text} << {part.low}" if part.low else text)
            return " | ".join(parts) or "0"
        return forms.wire_of(segment, scope.entries[segment.name].text)

    def _data_text(self, data: Data, scope: Scope) -> str:
        """Text of the bytes of data on the wire."""
        local = scope.entries[data.name].text
        if data.pad is not None and data.size != "rest":
            size = str(data.size) if isinstance(data.size, int) else self.text(data.size, scope)
            local = f"{local}.ljust({size}, {bytes_literal(bytes((data.pad,)))})"
        return forms.wire_text(self.module, data, local)

    def single(self, segment: Segment, scope: Scope) -> str:
        """Text of the bytes of a segment that is in no run."""
        known = self.wires.get(segment.name or "")
        if known is not None:
            return known
        return self.if_present(segment, scope, self._single(without_when(segment), scope), 'b""')

    def _single(self, segment: Segment, scope: Scope) -> str:
        match segment:
            case Data():
                return self._data_text(segment, scope)
            case Field(long=None):
                size = segment.type.size
                text = self.text(size, scope) if isinstance(size, Expression) else str(size or f"len({segment.name})")
                if size is None and segment.type.end is None:
                    text = f"len({scope.entries[segment.name].text})"
                return forms.build(self.module, segment.type, self._wire(segment, scope), text)
            case Field():
                return self._long(segment, scope)
            case Length() | Count() | Bits():
                size = segment.type.size
                text = self.text(size, scope) if isinstance(size, Expression) else str(size)
                return forms.build(self.module, segment.type, self._wire(segment, scope), text)
            case Repeat(of=FieldType() as of):
                return self._list_bytes(of, scope.entries[segment.name].text)
            case Wrap():
                return self._wrap(segment, scope)
            case Inner(name=name, frames=frames):
                choice, encode = self.module.choice(frames, self.title, name), self.module.function("encode_one")
                return f"{encode}({choice}, {scope.entries[name].text}, {quoted(name)}, ctx)"
        raise TypeError(f"no segment to build: {segment!r}")

    def _long(self, field: Field, scope: Scope) -> str:
        assert field.long is not None
        wire = self._wire(field, scope)
        short = forms.build(self.module, field.type, wire, str(field.type.fixed_size))
        if field.type.fixed_size == 1:
            short = f"bytes(({wire},))"
        mark = bytes_literal(field.long.mark.to_bytes(field.type.fixed_size or 1, _byte_order(field.type)))
        longer = forms.build(self.module, field.long.type, wire, str(field.long.type.fixed_size))
        return f"({short} if {wire} < {field.long.mark:#x} else {mark} + {longer})"

    def _list_bytes(self, of: FieldType, local: str) -> str:
        code = forms.struct_code(of)
        if code == ("B", ""):
            return f"bytes([*{local}])"
        if code is not None and not code[0].endswith("s"):
            self.module.imports.add("import struct")
            return f'struct.pack(f"{code[1] or ">"}{{len({local})}}{code[0]}", *{local})'
        one = forms.build(self.module, of, "value", str(of.fixed_size))
        return f'b"".join([{one} for value in {local}])'

    def _wrap(self, wrap: Wrap, scope: Scope) -> str:
        buffer = self.names.fresh("plain")
        text = self.region(wrap.of, scope, buffer)
        if wrap.least or wrap.most is not None:
            text = self._gather([text], buffer)
            self._limit_wrap(wrap, scope, buffer)
        if wrap.how == "hex":
            return f"{self.module.function('hex_to_ascii')}({text})"
        return f"{self.module.function('double_escape')}({text}, {wrap.escape or 0:#04x})"

    def _limit_wrap(self, wrap: Wrap, scope: Scope, buffer: str) -> None:
        tests = [f"len({buffer}) < {wrap.least}"] if wrap.least else []
        if wrap.most is not None:
            most = str(wrap.most) if isinstance(wrap.most, int) else self.text(wrap.most, scope, OR)
            tests.append(f"len({buffer}) > {most}")
        with self.out.block(f"if {' or '.join(tests)}:"):
            self.add(f'raise EncodeError("", f"the content takes {{len({buffer})}} bytes, that is not allowed")')


def _byte_order(type_: FieldType) -> str:
    return "little" if type_.order == "little" else "big"


def _operand(text: str) -> str:
    return text if text.isidentifier() or text.isdigit() else f"({text})"


def _sum(texts: list[str]) -> str:
    """Text of all these bytes one behind the other."""
    merged = _merged(texts)
    if len(merged) > _MOST_PLUSES:
        return f'b"".join(({", ".join(merged)}))'
    return " + ".join(merged) or 'b""'


def _merged(texts: list[str]) -> list[str]:
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
