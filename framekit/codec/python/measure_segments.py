"""Measuring functions: segments whose size is looked up, and those that end by what follows them."""

from __future__ import annotations

from framekit.codec.python import forms
from framekit.codec.python.expressions import Scope
from framekit.codec.python.measuring import Finished, Measuring, Pairs
from framekit.codec.python.module import Module
from framekit.codec.python.places import Place, between, index
from framekit.codec.python.source import bytes_literal
from framekit.definition.expression.emit import PRODUCT, SUM
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.contents import bytes_of
from framekit.definition.model.segments import (
    Bits,
    Check,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Length,
    Segment,
)

Number = Field | Length | Count | Bits


class SegmentMeasurer(Measuring):
    """Writes how segments without others inside are passed."""

    def __init__(self, module: Module, identifier: str, segments: tuple[Segment, ...], most: int) -> None:
        super().__init__(module, segments, most)
        self.identifier = identifier

    def number(self, segment: Number, scope: Scope, after: Pairs) -> None:
        needed = any(name in self.needed for name in segment.value_names)
        type_ = segment.type
        if isinstance(segment, Field) and segment.long is not None:
            self._long(segment, scope, after)
        elif isinstance(type_.size, Expression):
            size = self.size_text(type_.size, scope)
            if needed:
                self.take(size, after)
                self._read(segment, scope, Place("at", 0), Place("stop", 0))
                self.advance("stop")
            else:
                self.skip(size)
        elif type_.size is None:
            self._text(segment, scope, after, needed)
        else:
            if needed:
                self.want(type_.size, after)
                self._read(segment, scope, self.place, self.place.plus(type_.size))
            self.skip(str(type_.size))

    def take(self, size: str, after: Pairs) -> None:
        """Lets `stop` be the end of a segment that has to be read."""
        self.settle()
        self.add(f"stop = at + {size}")
        self.want_until("stop", after)

    def _read(self, segment: Number, scope: Scope, first: Place, last: Place) -> None:
        wire = self.wire(segment.type, first, last)
        if isinstance(segment, Bits):
            whole = self.names.fresh("bits")
            self.add(f"{whole} = {wire}")
            for part in segment.parts:
                if part.name in self.needed:
                    mask = (1 << part.high - part.low + 1) - 1
                    self.set_value(part.name, scope, f"{whole} >> {part.low} & {mask:#x}")
            return
        if segment.zero_means is not None:
            wire = self.set_value(segment.name, scope, wire)
        local = self.set_value(segment.name, scope, forms.value_of(segment, wire))
        if segment.limits is not None and segment.refuse is None:
            with self.out.block(f"if not {segment.limits[0]} <= {local} <= {segment.limits[1]}:"):
                self.add("return LOST")

    def wire(self, type_: FieldType, first: Place, last: Place) -> str:
        if type_.kind == "int" and type_.fixed_size == 1 and not type_.signed:
            return index("data", first)
        self.may_fail = self.may_fail or type_.kind in ("digits", "bcd")
        return forms.parse(self.module, type_, between("data", first, last))

    def _long(self, field: Field, scope: Scope, after: Pairs) -> None:
        assert field.long is not None
        short, longer = field.type.fixed_size or 1, field.long.type.fixed_size or 0
        self.want(short, after)
        local = self.set_value(field.name, scope, self.wire(field.type, self.place, self.place.plus(short)))
        self.advance(self.place.plus(short).text(""))
        with self.out.block(f"if {local} == {field.long.mark:#x}:"):
            if field.name in self.needed:
                self.want(longer, after)
                wire = self.wire(field.long.type, self.place, self.place.plus(longer))
                self.add(f"{local} = {wire}")
            self.add(f"at += {longer}")
        if field.name in self.needed and forms.changes_value(field):
            self.add(f"{local} = {forms.value_of(field, local)}")

    def _text(self, segment: Number, scope: Scope, after: Pairs, needed: bool) -> None:
        """A text that its end marks, or that takes the rest."""
        end = segment.type.end
        if end is None:
            self.rest(segment, after)
            return
        self.settle()
        self.add(f"stop = {self.search(bytes_literal(end), 'at', after, len(end))}")
        with self.out.block("if stop < 0:"):
            self.not_found(1 + self.least(after))
        if needed and isinstance(segment, Field):
            plain = FieldType("ascii", None, pad=segment.type.pad)
            self.set_value(segment.name, scope, self.wire(plain, Place("at", 0), Place("stop", 0)))
        self.advance(f"stop + {len(end)}")

    def data(self, data: Data, scope: Scope, after: Pairs) -> None:
        if data.size == "rest":
            self.rest(data, after)
        elif isinstance(data.size, int):
            size = str(data.on_wire(data.size))
        elif data.convert is None:
            size = self.size_text(data.size, scope)
        else:
            text = self.size_text(data.size, scope, PRODUCT + 1)
            size = f"2 * {text}" if data.convert == "hex_to_ascii" else f"{text} // 2"
        if data.name not in self.needed:
            self.skip(size)
            return
        self.take(size, after)
        self.may_fail = self.may_fail or data.convert is not None
        self.set_value(data.name, scope, forms.memory_text(self.module, data, "data[at:stop]"))
        self.advance("stop")

    # ---- what ends by what follows ------------------------------------------------------------------------

    def rest(self, segment: Segment, after: Pairs) -> None:
        """Something that reaches up to a constant after it, where everything around that fits, else up to silence.

        What stands before the constant, such as a check code, is of fixed size: it is counted back from there.
        """
        place = self._constant(after)
        if place is None:
            self._until_silence(after)
            return
        first, before, behind = after[place][0], self._size_of(after[:place]), self._size_of(after[place:])
        assert isinstance(first, Const)
        may_hold = first.data[0] in bytes_of([segment, *(one for one, _ in after[:place])], self.shapes.frames)
        self.settle()
        self.add(f"behind = {behind}")
        self.add(f"at = max({'at' if before == '0' else f'at + {before}'}, start + seen - behind)")
        with self.out.block(f"while (at := data.find({bytes_literal(first.data)}, at, end)) >= 0:"):
            self.add("size = at - start + behind")
            with self.out.block(f"if size > {self.most}:"):
                self.add("return LOST")
            with self.out.block("if size > end - start:"):
                self.add("return end - start - size")
            if not may_hold or not any(isinstance(one, Check) for one, _ in after):
                self.add("return size")
            else:
                ends_here = self.module.function("ends_here")
                whole = "bytes(data[start : start + size])"
                tail = "at - start" if before == "0" else f"at - start - ({before})"
                with self.out.block(f"if {ends_here}(decode_{self.identifier}, {whole}, ctx, {tail}):"):
                    self.add("return size")
                self.add("at += 1")
        self.not_found(1)
        raise Finished

    def _constant(self, after: Pairs) -> int | None:
        """The place of the constant that is looked for; None if there is none, or too little is of fixed size."""
        if any(self.shapes.present(segment).fixed is None for segment, _ in after):
            return None
        found = (place for place, (one, _) in enumerate(after) if isinstance(one, Const) and one.when is None)
        return next(found, None)

    def _size_of(self, after: Pairs) -> str:
        """Text of the bytes of segments that are of fixed size when they are there."""
        fixed, texts = 0, []
        for segment, scope in after:
            size = self.shapes.present(segment).fixed or 0
            if segment.when is None:
                fixed += size
            elif size:
                texts.append(f"({size} if {self.text(segment.when, scope, SUM)} else 0)")
        return " + ".join([str(fixed), *texts])

    def _until_silence(self, after: Pairs) -> None:
        """Nothing but silence ends it."""
        self.settle()
        behind = self.least(after)
        shortest = f"at - start + {behind}" if behind else "at - start"
        self.add(f"size = {shortest}")
        with self.out.block("if end - start < size:"):
            self.add("return end - start - size")
        self.add(f"return QUIET if end - start <= {self.most} else LOST")
        raise Finished
