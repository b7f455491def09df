"""Bytes from values: runs of fixed segments packed at once, the others one by one, check codes over what stands there.

All values are in locals when this begins; it writes the lines that put them together.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from framekit.codec.python import forms
from framekit.codec.python.codes import code_bytes
from framekit.codec.python.expressions import Scope
from framekit.codec.python.function import covers_later
from framekit.codec.python.module import Module
from framekit.codec.python.packing import PackingWriter, Placed, sum_of
from framekit.codec.python.reader import not_possible
from framekit.codec.python.source import Code, bytes_literal, quoted, text_source
from framekit.codec.support import build_int
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
    Fill,
    Inner,
    Length,
    Record,
    Repeat,
    Require,
    Segment,
    Value,
    Wrap,
)
from framekit.definition.model.walk import leaves, without_when


@dataclass(slots=True)
class Part:
    """Some bytes of a buffer: the names of the segments in them, and their text."""

    names: tuple[str, ...]
    text: str


class PieceWriter(PackingWriter):
    """Writes the bytes of segments whose values are known.

    `buffer`: the local of the whole frame. `parts`: what checks may ask for. `late`: the cases of choices with check
    codes: header, segments, scope. `gathered`: the buffers that hold sums of bytes, by the text of the sum.
    """

    def __init__(self, module: Module, title: str, segments: tuple[Segment, ...]) -> None:
        super().__init__(module, title, segments)
        self.buffer = "frame"
        self.gathered: dict[str, str] = {}
        self.parts: list[Part] = []
        self.begun: set[str] = set()
        self.late: dict[str, list[tuple[str, tuple[Segment, ...], Scope]]] = {}

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

    def region(
        self,
        segments: Iterable[Segment],
        scope: Scope,
        buffer: str,
        before: str = "",
        tail: tuple[Const, int] | None = None,
    ) -> str:
        """Text of the bytes of a list of segments.

        Checks are worked out on what is in the local `buffer` by then, and on what stands `before` it (a text). `tail`:
        the constant whose first byte must not stand before it, from so many bytes on.
        """
        placed = self.placed(segments, scope)
        texts: list[str] = []
        waiting: list[tuple[str, Check, Scope]] = []
        place = 0
        while place < len(placed):
            segment, inside = placed[place]
            count = 1
            if tail is not None and segment is tail[0]:
                texts = [self.gather(texts, buffer)]
                self._keep_apart(buffer, tail)
            if isinstance(segment, Check) and covers_later(segment, self.segments):
                texts.append(f"<{segment.name}>")
                waiting.append((texts[-1], segment, inside))
            elif isinstance(segment, Check):
                if segment.name in self.coverage.whole:
                    texts = [self.gather(texts, buffer)] if texts else []
                texts.append(self._check(segment, inside, [before, *texts]))
                self.parts.append(Part((segment.name or "",), texts[-1]))
            elif isinstance(segment, Fill):
                texts = [self._filled(segment, placed[place + 1 :], texts, buffer)]
            elif segment.name in self.late:
                texts = [self.gather(texts, buffer)] if texts else []
                texts.append(self._late(segment.name or "", [before, *texts]))
                self.parts.append(Part(tuple(leaf.name or "" for leaf in leaves((segment,))), texts[-1]))
            else:
                count = self.length_of_run(placed[place:])
                texts.append(self._kept(placed[place : place + count], self.run(placed[place : place + count])))
            place += count
        for mark, check, inside in waiting:
            if mark not in texts:
                raise not_possible(check, "a check covers what comes later, and is covered itself", "put it last")
            texts[texts.index(mark)] = self._check(check, inside, [])
        return sum_of(texts)

    def _keep_apart(self, buffer: str, tail: tuple[Const, int]) -> None:
        """A delimited body must not hold what ends it."""
        mark = bytes_literal(tail[0].data[:1])
        body = f"{buffer}[{tail[1]}:]" if tail[1] else buffer
        message = f"the body holds {tail[0].data[0]:02X}, which ends it"
        self.complain(f"{mark} in {body}", '""', quoted(message))

    def _late(self, name: str, before: list[str]) -> str:
        """The bytes of a choice with check codes in it: they are put together when what stands before is known."""
        wire = self.names.fresh("case_bytes")
        self.add(f'{wire} = b""')
        for header, segments, scope in self.late[name]:
            with self.out.block(header):
                self.add(f"{wire} = {self.region(segments, scope, self.names.fresh('part'), sum_of(before))}")
        return wire

    def gather(self, texts: list[str], buffer: str) -> str:
        """Puts everything so far into the buffer's local."""
        text = sum_of(texts)
        if text != buffer:
            first = buffer not in self.begun
            self.begun.add(buffer)
            self.add(f"{buffer}{': bytes' if first else ''} = {text}")
            self.gathered = {known: local for known, local in self.gathered.items() if local != buffer}
            if " + " in text and buffer not in text and not self.out.depth:
                self.gathered[text] = buffer
        return buffer

    def _filled(self, fill: Fill, behind: list[Placed], texts: list[str], buffer: str) -> str:
        """Everything so far, filled up so that the frame gets its size."""
        self.gather(texts, buffer)
        fixed, parts = 0, []
        for segment, scope in behind:
            size = self.shapes.present(segment).fixed or 0
            if segment.when is None:
                fixed += size
            else:
                parts.append(self.if_present(segment, scope, str(size), "0"))
        room = " - ".join([str(fill.total - fixed), *parts])
        message = text_source("the values take ", Code(f"len({buffer})"), " bytes, more than ", Code(room))
        self.complain(f"len({buffer}) > {room}", '""', message)
        self.gathered.clear()
        names = (fill.name or "",)
        if self.coverage.of(names):
            local = self.names.fresh("fill")
            self.add(f"{local} = b''.ljust({room} - len({buffer}), {bytes_literal(bytes((fill.byte,)))})")
            self.parts.append(Part(names, local))
            self.add(f"{buffer} += {local}")
        else:
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

    def _check(self, check: Check, scope: Scope, before: list[str]) -> str:
        covered = sum_of([text for text in before if text])
        if check.name not in self.coverage.whole:
            covered = sum_of(self._parts_of(self.coverage.names(check) or []))
            for text, buffer in self.gathered.items():
                if covered == text or covered.startswith(f"{text} + "):
                    covered = buffer + covered.removeprefix(text)
        return self.if_present(check, scope, code_bytes(self.module, replace(check, when=None), covered), 'b""')

    def _parts_of(self, names: list[str]) -> list[str]:
        texts: list[str] = []
        left = list(names)
        while left:
            part = next((part for part in reversed(self.parts) if left[0] in part.names), None)
            texts.extend([] if part is None else [part.text])
            left = left[max(1, 0 if part is None else sum(name in left for name in part.names)) :]
        return texts

    # ---- single segments ----------------------------------------------------------------------------------

    def single(self, segment: Segment, scope: Scope) -> str:
        """Text of the bytes of a segment that is in no run."""
        known = self.wires.get(segment.name or "")
        if known is not None:
            return known
        if isinstance(segment, Inner):
            return self._inner(segment, scope)
        return self.if_present(segment, scope, self._single(without_when(segment), scope), 'b""')

    def _single(self, segment: Segment, scope: Scope) -> str:
        match segment:
            case Data():
                return self.data_text(segment, scope)
            case Field(long=None):
                size = segment.type.size
                local = scope.entries[segment.name].text
                if (size is None and segment.type.end is None) or self.size_by_length(segment) is not None:
                    text = f"len({local})"
                else:
                    text = self.bounded(size, scope) if isinstance(size, Expression) else str(size or f"len({local})")
                return forms.build(self.module, segment.type, self.wire(segment, scope), text)
            case Field():
                return self._long(segment, scope)
            case Length() | Count() | Bits():
                size = segment.type.size
                text = self.bounded(size, scope) if isinstance(size, Expression) else str(size)
                return forms.build(self.module, segment.type, self.wire(segment, scope), text)
            case Repeat(of=FieldType() as of):
                return self._list_bytes(of, scope.entries[segment.name].text)
            case Wrap():
                return self._wrap(segment, scope)
        raise TypeError(f"no segment to build: {segment!r}")

    def _inner(self, inner: Inner, scope: Scope) -> str:
        """The bytes of a frame inside. What is in the way of the first try is told by the second, which costs more."""
        name, value = inner.name, scope.entries[inner.name].text
        choice, encode = self.module.choice(inner.frames, self.title, name), self.module.function("encode_one")
        if inner.when is not None:
            return self.if_present(inner, scope, f"{encode}({choice}, {value}, {quoted(name)}, ctx)", 'b""')
        wire, frame, fields = (self.names.fresh(one) for one in (f"{name}_bytes", "frame_name", "fields"))
        self.flush()
        with self.out.block("try:"):
            self.add(f"(({frame}, {fields}),) = {value}.items()")
            self.add(f"{wire} = {choice}.encoders[{frame}]({fields}, ctx)")
        with self.out.block("except MISFITS:"):
            self.add(f"{wire} = {encode}({choice}, {value}, {quoted(name)}, ctx)")
        return wire

    def _long(self, field: Field, scope: Scope) -> str:
        assert field.long is not None
        wire = self.wire(field, scope)
        short = forms.build(self.module, field.type, wire, str(field.type.fixed_size))
        if field.type.fixed_size == 1 and field.type.kind == "int" and not field.type.signed:
            short = f"bytes(({wire},))"
        mark = self._mark(field.type, field.long.mark)
        longer = forms.build(self.module, field.long.type, wire, str(field.long.type.fixed_size))
        return f"({short} if {wire} < {field.long.mark:#x} else {mark} + {longer})"

    def _mark(self, type_: FieldType, mark: int) -> str:
        """The bytes that say that the long form follows."""
        size = type_.fixed_size or 1
        if type_.kind == "int":
            return bytes_literal(build_int(mark, size, type_.order, type_.signed))
        return forms.build(self.module, type_, str(mark), str(size))

    def _list_bytes(self, of: FieldType, local: str) -> str:
        code = forms.struct_code(of)
        if code == ("B", ""):
            return f"bytes([*{local}])"
        if code is not None and not code[0].endswith("s"):
            return f"{self.packs(local, '', *code)}[{self.count_of(local)}](*{local})"
        one = forms.build(self.module, of, "value", str(of.fixed_size))
        return f'b"".join([{one} for value in {local}])'

    def _wrap(self, wrap: Wrap, scope: Scope) -> str:
        buffer = self.names.fresh("plain")
        text = self.region(wrap.of, scope, buffer)
        if wrap.least or wrap.most is not None:
            text = self.gather([text], buffer)
            self._limit_wrap(wrap, scope, buffer)
        if wrap.how == "hex":
            return f"{self.module.function('hex_to_ascii')}({text})"
        if text.isidentifier():
            single = bytes((wrap.escape or 0,))
            return f"{text}.replace({bytes_literal(single)}, {bytes_literal(2 * single)})"
        return f"{self.module.function('double_escape')}({text}, {wrap.escape or 0:#04x})"

    def _limit_wrap(self, wrap: Wrap, scope: Scope, buffer: str) -> None:
        tests = [f"len({buffer}) < {wrap.least}"] if wrap.least else []
        if wrap.most is not None:
            most = str(wrap.most) if isinstance(wrap.most, int) else self.text(wrap.most, scope, OR)
            tests.append(f"len({buffer}) > {most}")
        message = text_source("the content takes ", Code(f"len({buffer})"), " bytes, that is not allowed")
        self.complain(" or ".join(tests), '""', message)
