"""Segments whose size other values give: data, texts, long numbers; and values that take no bytes."""

from __future__ import annotations

from framekit.codec.python import forms
from framekit.codec.python.places import Place, between, index
from framekit.codec.python.reader import Item
from framekit.codec.python.runs import RunReader, shown_name
from framekit.codec.python.source import bytes_literal
from framekit.definition.expression.emit import PRODUCT
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import Bits, Count, Data, Field, FieldType, Fill, Length, Require, Value


class SizedReader(RunReader):
    """Reads single segments of variable size, and those of none."""

    def read_sized(self, item: Item, after: tuple[Item, ...]) -> bool:
        """Reads the segment if it is one of these kinds."""
        match item.segment:
            case Value() as value:
                self.when_known(value.read, item.scope, lambda: self._value(item, value))
            case Require() as require:
                self.when_known(require.condition, item.scope, lambda: self._require(item, require))
            case Data() as data:
                self._data(item, data, after)
            case Fill(total=total):
                self.take_rest(item, after)
                self.function.misfit_if(f"len({self.buffer}) != {total}")
            case Field(long=None) as field:
                self._field(item, field, after)
            case Field() as field:
                self._long(item, field)
            case Length() | Count() as number:
                self._counting(item, number)
            case Bits() as bits:
                self._bits(item, bits)
            case _:
                return False
        return True

    def _require(self, item: Item, require: Require) -> None:
        self.function.misfit_if(self.function.writer(item.scope).negated(require.condition))

    def _value(self, item: Item, value: Value) -> None:
        local = self.function.local(value.name, item.scope)
        self.function.add(f"{local} = {self.function.writer(item.scope).value(value.read)}")
        self.declare(item, value.name, local)

    def _data(self, item: Item, data: Data, after: tuple[Item, ...]) -> None:
        if data.size == "rest":
            first, last = self.take_rest(item, after)
        elif isinstance(data.size, int):
            first, last = self.take(item, str(data.on_wire(data.size)))
        elif data.convert is None:
            first, last = self.take(item, self.size_text(data.size, item.scope))
        else:
            size = self.size_text(data.size, item.scope, PRODUCT + 1)
            first, last = self.take(item, f"2 * {size}" if data.convert == "hex_to_ascii" else f"{size} // 2")
        local = self.function.local(data.name, item.scope)
        wire = between(self.buffer, first, last)
        self.function.add(f"{local} = {forms.memory_text(self.module, data, wire)}")
        self.declare(item, data.name, local)
        if data.convert == "ascii_to_hex" and isinstance(data.size, Expression):
            self.function.misfit_if(f"len({local}) != {self.size_text(data.size, item.scope)}")
        if data.least:
            self.function.misfit_if(f"len({local}) < {data.least}")

    def _field(self, item: Item, field: Field, after: tuple[Item, ...]) -> None:
        """A field whose size is an expression, whose end is marked, or that takes the rest."""
        type_, local = field.type, self.function.local(field.name, item.scope)
        if isinstance(type_.size, Expression):
            first, last = self.take(item, self.size_text(type_.size, item.scope))
        elif type_.fixed_size is not None:
            first, last = self.take(item, str(type_.fixed_size))
        elif type_.end is not None:
            first, last = self._terminated(item, field, type_.end)
            type_ = FieldType("ascii", None, pad=type_.pad)
        else:
            first, last = self.take_rest(item, after)
        wire = forms.parse(self.module, type_, between(self.buffer, first, last))
        self.function.add(f"{local} = {forms.value_of(field, wire)}")
        sized = type_.kind in ("ascii", "bytes")
        self.declare(item, field.name, local, sized=sized, wire=self.function.wire_size(field.name))
        self.judge_field(item, field, local)

    def _counting(self, item: Item, number: Length | Count) -> None:
        """A length or a count whose size is an expression."""
        local = self.function.local(number.name, item.scope)
        self.function.add(f"{local} = {forms.value_of(number, self._sized_number(item, number))}")
        self.declare(item, number.name, local, sized=False, wire=self.function.wire_size(number.name))
        self.judge_limits(number, local)
        if isinstance(number, Length):
            self.compare_length(item, number)
        else:
            self.compare_count(item, number)

    def _bits(self, item: Item, bits: Bits) -> None:
        """Named bits of a number whose size is an expression."""
        local = self.function.names.fresh(shown_name(bits, "bits"))
        self.function.add(f"{local} = {self._sized_number(item, bits)}")
        self.read_bits(item, bits, local)

    def _sized_number(self, item: Item, segment: Length | Count | Bits) -> str:
        """Text of the number on the wire."""
        size = segment.type.size
        first, last = self.take(item, self.size_text(size, item.scope) if isinstance(size, Expression) else str(size))
        return forms.parse(self.module, segment.type, between(self.buffer, first, last))

    def _terminated(self, item: Item, field: Field, end: bytes) -> tuple[Place, Place]:
        stop = self.function.names.fresh(f"{field.name}_end")
        first = self.keep(self.place)
        self.function.add(f"{stop} = {self.buffer}.index({bytes_literal(end)}, {first.text(self.buffer)})")
        self.advance(f"{stop} + {len(end)}")
        self.function.stands(item.segment, self.buffer, first, self.place)
        return first, Place(stop, 0)

    def _long(self, item: Item, field: Field) -> None:
        """A number whose values from the mark on follow as a longer number."""
        assert field.long is not None
        local = self.function.local(field.name, item.scope)
        short, longer = field.type.fixed_size or 1, field.long.type.fixed_size or 0
        first = self.keep(self.place) if field.name in self.function.tracked else self.place
        if short == 1 and field.type.kind == "int" and not field.type.signed:
            self.function.add(f"{local} = {index(self.buffer, first)}")
        else:
            raw = between(self.buffer, first, first.plus(short))
            self.function.add(f"{local} = {forms.parse(self.module, field.type, raw)}")
        self.advance(first.plus(short).text(self.buffer))
        with self.function.out.block(f"if {local} == {field.long.mark:#x}:"):
            raw = between(self.buffer, self.place, self.place.plus(longer))
            self.function.add(f"{local} = {forms.parse(self.module, field.long.type, raw)}")
            self.function.add(f"{self.at} += {longer}")
        if forms.changes_value(field):
            self.function.add(f"{local} = {forms.value_of(field, local)}")
        self.function.stands(field, self.buffer, first, self.place)
        self.declare(item, field.name, local, sized=False, wire=self.function.wire_size(field.name))
        self.judge_field(item, field, local)
