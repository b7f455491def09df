"""Careful functions: the calls of single segments, in which `parse` functions and rules are written out."""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python import forms
from framekit.codec.python.codes import code_bytes
from framekit.codec.python.examining import Behind, Examining
from framekit.codec.python.expressions import Scope, constant_of
from framekit.codec.python.function import covers_later, span_names
from framekit.codec.python.shape import is_always_there, is_followed, is_plain_name, targets_of
from framekit.codec.python.source import bytes_literal, literal, quoted
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
    Require,
    Segment,
    Skip,
    Value,
    Wrap,
)
from framekit.definition.model.walk import leaves


class SegmentExaminer(Examining):
    """Writes the call of every segment that holds no others."""

    def segment(self, segment: Segment, scope: Scope, behind: Behind) -> None:
        """The call of a segment that is there."""
        add, name, refuse = self.out.add, self.named(segment), self.refuse(segment)
        match segment:
            case Const(data=data):
                add(f"n.const({name}, {bytes_literal(data)}{refuse})")
            case Skip(size=size):
                add(f"n.skip({name}, {size})")
            case Fill(total=total):
                add(f'n.skip("fill", n.rest({self.behind(behind)}, "fill"))')
                add(f'n.expect("short", "frame", n.end, {quoted(f"{total} bytes")}, lambda n: n.end >= {total})')
                add(f'n.expect("surplus", "frame", {total}, "its end", lambda n: n.end <= {total})')
            case Field():
                self._field(segment, scope, behind)
            case Length() | Count():
                self._counted(segment, scope)
            case Bits():
                self._bits(segment, scope)
            case Data():
                self._data(segment, scope, behind)
            case Value(read=read):
                add(f"n.value({name}, lambda n: {self.writer(scope).value(read)}{refuse})")
            case Require(condition=condition):
                text = self.writer(scope).text(condition)
                add(f"n.require({quoted(condition.text)}, lambda n: {text}{refuse})")
            case Check():
                self._check(segment)
            case _:
                self.nested(segment, scope, behind)

    def parse(self, type_: FieldType, number: Field | Length | Count | None = None) -> str:
        """A function from the bytes on the wire to the value."""
        wire = forms.parse(self.module, type_, "raw")
        if number is None or not forms.changes_value(number):
            return f"lambda raw: {wire}"
        if number.zero_means is not None and not (isinstance(number, Field) and (number.plus or number.unit)):
            return f"lambda raw: {wire} or {number.zero_means}"
        text = forms.value_of(number, wire)
        if number.zero_means is not None:
            text = forms.value_of(number, "wire")
            return f"lambda raw: (lambda wire: {text})({wire})"
        return f"lambda raw: {text}"

    def _rules(self, field: Field) -> str:
        rules = ""
        if field.constants is not None:
            rules = f', among={literal(field.constants)}, cause="where"'
        elif field.is_ is not None and (number := constant_of(field.is_)) is not None:
            rules = f", among=({number},)"
        elif field.only and field.values is not None:
            rules = f", among={literal(tuple(field.values))}"
        if field.limits is not None:
            rules += f", limits={literal(field.limits)}"
        return rules

    def _field(self, field: Field, scope: Scope, behind: Behind) -> None:
        name, type_ = quoted(field.name), field.type
        behind_it = f"{self.refuse(field)}{self._rules(field)})"
        if field.long is not None:
            longer = FieldType(**{slot: getattr(field.long.type, slot) for slot in FieldType.__slots__})
            self.out.add(
                f"n.long({name}, {type_.fixed_size}, {self.parse(type_, field)},"
                f" lambda raw: {forms.parse(self.module, type_, 'raw')} == {field.long.mark:#x},"
                f" {longer.fixed_size}, {self.parse(longer, field)}{behind_it}"
            )
        elif type_.size is None and type_.end is not None:
            plain = FieldType("ascii", None, pad=type_.pad)
            self.out.add(f"n.until({name}, {bytes_literal(type_.end)}, {self.parse(plain, field)}{behind_it}")
        elif type_.size is None:
            size = f"lambda n: n.rest({self.behind(behind)}, {name})"
            self.out.add(f"n.field({name}, {size}, {self.parse(type_, field)}{behind_it}")
        else:
            self.out.add(f"n.field({name}, {self.ask(type_.size, scope)}, {self.parse(type_, field)}{behind_it}")
        if field.is_ is not None and (field.constants is not None or constant_of(field.is_) is None):
            wanted = self.writer(scope).value(field.is_)
            self.deferred.append(f'n.same("value", {name}, lambda n: {wanted}{self.refuse(field)})')

    def _counted(self, number: Length | Count, scope: Scope) -> None:
        limits = "" if number.limits is None else f", limits={literal(number.limits)}"
        name = quoted(number.name)
        size = self.ask(number.type.size if number.type.size is not None else 0, scope)
        self.out.add(f"n.field({name}, {size}, {self.parse(number.type, number)}{self.refuse(number)}{limits})")
        wanted = self._wanted_length(number) if isinstance(number, Length) else self._wanted_count(number)
        if wanted is not None:
            plus = "" if not number.plus else f" + {number.plus}" if number.plus > 0 else f" - {-number.plus}"
            self.deferred.append(f'n.same("length", {name}, lambda n: {wanted}{plus}{self.refuse(number)})')

    def _wanted_length(self, length: Length) -> str | None:
        targets = targets_of(length, self.segments)
        if is_followed(length, targets):
            return None
        single = [target.only for target in targets.values()]
        converted = [t for t in single if length.plain and isinstance(t, Data) and t.convert is not None]
        rooms = [quoted(name) for name in length.of if name not in {target.name for target in converted}]
        parts = [f"n.room({', '.join(rooms)})"] if rooms else []
        parts += [f"len(n[{quoted(target.name)}])" for target in converted]
        total = " + ".join(parts) or "0"
        if length.unit != 1:
            total = f"({total}) // {length.unit}" if len(parts) > 1 else f"{total} // {length.unit}"
        return total

    def _wanted_count(self, count: Count) -> str | None:
        repeat = self.by_name.get(count.of)
        there = is_always_there(count.of, self.segments)
        followed = isinstance(repeat, Repeat) and count.plus == 0 and is_plain_name(repeat.times, count.name)
        if not isinstance(repeat, Repeat) or (there and followed):
            return None
        return f"len(n[{quoted(count.of)}]{'' if there else ' or ()'})"

    def _bits(self, bits: Bits, scope: Scope) -> None:
        parts = {part.name: (part.low, (1 << part.high - part.low + 1) - 1) for part in bits.parts}
        among: dict[str, tuple[tuple[int, ...], str]] = {}
        for part in bits.parts:
            if part.constants is not None:
                among[part.name] = part.constants, "where"
            elif part.is_ is not None and (number := constant_of(part.is_)) is not None:
                among[part.name] = (number,), "value"
            if part.is_ is not None and part.name not in among:
                wanted = self.writer(scope).value(part.is_)
                self.deferred.append(f'n.same("value", {quoted(part.name)}, lambda n: {wanted}{self.refuse(bits)})')
        rules = f", among={literal(among)}" if among else ""
        size = self.ask(bits.type.size if bits.type.size is not None else 0, scope)
        self.out.add(
            f"n.bits({self.named(bits)}, {size}, {self.parse(bits.type)}, {literal(parts)}{self.refuse(bits)}{rules})"
        )

    def _data(self, data: Data, scope: Scope, behind: Behind) -> None:
        factor = {"hex_to_ascii": " * 2", "ascii_to_hex": " // 2", None: ""}[data.convert]
        options = self.refuse(data)
        if data.size == "rest" and (bytes_behind := self.behind(behind)) != "0":
            options += f", behind={bytes_behind}"
        if data.least:
            options += f", least={data.least}"
        parse = f"lambda raw: {forms.memory_text(self.module, data, 'raw')}"
        self.out.add(f"n.data_field({quoted(data.name)}, {self.ask(data.size, scope, factor)}, {parse}{options})")

    def _check(self, check: Check) -> None:
        if check.span is not None and not span_names(check, self.segments):
            covered = 'b""'
        elif check.over is not None:
            covered = f"n.bytes_of({', '.join(quoted(name) for name in check.over)})"
        elif check.span is not None and check.span[1] == "here" and self._in_one_buffer(check):
            covered = f"n.bytes_from({quoted(span_names(check, self.segments)[0])})"
        elif check.span is not None:
            covered = f"n.bytes_of({', '.join(quoted(name) for name in span_names(check, self.segments))})"
        else:
            covered = "n.data[: n.at]"
        code = code_bytes(self.module, check, covered)
        options = ", digits=True" if check.form in ("hex", "HEX") else ""
        options += "" if check.verify == "error" else ", verify=False"
        if check.verify == "off":
            self.out.add(f"n.skip({self.named(check)}, {check.size})")
        elif covers_later(check, self.segments):
            name = quoted(check.name or "check")
            self.out.add(f"n.skip({name}, {check.size})")
            self.late_checks.append(f"n.verify({name}, lambda n: {code}{options})")
        else:
            self.out.add(f"n.check({self.named(check)}, {check.size}, lambda n: {code}{options})")

    def compare_late_checks(self) -> None:
        """Check codes that stand before what they cover."""
        for line in self.late_checks:
            self.out.add(line)

    def _in_one_buffer(self, check: Check) -> bool:
        """Whether a check stands in the same buffer as everything it covers."""
        names = set(span_names(check, self.segments))
        return any(
            check in segments and names <= {leaf.name for segment in segments for leaf in _unwrapped(segment)}
            for segments in self._buffers(self.segments)
        )

    def _buffers(self, segments: tuple[Segment, ...]) -> Iterable[tuple[Segment, ...]]:
        yield segments
        for segment in segments:
            if isinstance(segment, Wrap):
                yield from self._buffers(segment.of)

    def nested(self, segment: Segment, scope: Scope, behind: Behind) -> None:
        """The calls of a segment with others inside."""
        raise NotImplementedError


def _unwrapped(segment: Segment) -> Iterable[Segment]:
    """The leaves of a segment that stand in the buffer itself."""
    return () if isinstance(segment, Wrap) else leaves((segment,))
