"""What must hold for values that were read: limits, constants, names, bits, check codes, as conditions of a decoder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from framekit.codec.checks import residue_of
from framekit.codec.python import forms
from framekit.codec.python.codes import code_text, is_call
from framekit.codec.python.expressions import Entry, Scope, constant_of
from framekit.codec.python.function import covers_later, span_names
from framekit.codec.python.places import between
from framekit.codec.python.reader import BufferReader, Item, not_possible
from framekit.codec.python.shape import Target, is_always_there, is_followed, is_plain_name, targets_of
from framekit.codec.python.source import literal, quoted
from framekit.definition.expression.emit import BIT_OR
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import Bits, BitsPart, Check, Count, Field, Length, Repeat

_ANY_WIDTH = 1 << 20
_FEW = 6
"""Up to so many allowed values are written into the condition."""


class JudgingReader(BufferReader):
    """Turns what a definition demands of values into conditions."""

    def judge_field(self, item: Item, field: Field, local: str) -> None:
        self._judge_value(item.scope, field.is_, field.constants, local)
        if field.only and field.values is not None and field.constants is None:
            self._judge_among(local, tuple(field.values), field)
        self.judge_limits(field, local)

    def _judge_value(
        self,
        scope: Scope,
        is_: Expression | None,
        constants: tuple[int | str | bytes, ...] | None,
        local: str,
    ) -> None:
        if constants is not None:
            if len(constants) == 1:
                self.function.misfit_if(f"{local} != {literal(constants[0])}")
            else:
                self.function.misfit_if(f"{local} not in {literal(constants)}")
        if is_ is not None:
            number = constant_of(is_)

            def compare() -> None:
                text = self.function.writer(scope).text(is_, BIT_OR)
                self.function.misfit_if(f"{local} != {text if number is None else number}")

            self.when_known(is_, scope, compare)

    def _judge_among(self, local: str, allowed: tuple[int, ...], field: Field) -> None:
        if len(allowed) <= _FEW:
            self.function.misfit_if(f"{local} not in {literal(allowed)}")
        elif field.values is not None:
            names = self.module.value_names(field.values, f"{self.function.title} {field.name}")
            self.function.misfit_if(f"{local} not in {names}")

    def judge_limits(self, number: Field | Length | Count, local: str) -> None:
        """Limits that the type does not keep by itself."""
        if number.limits is None:
            return
        least, most = number.limits
        free = forms.value_range(_without_limits(number))
        low = free.least is None or least > free.least
        high = free.most is None or most < free.most
        if low and high:
            self.function.misfit_if(f"not {least} <= {local} <= {most}")
        elif low:
            self.function.misfit_if(f"{local} < {least}")
        elif high:
            self.function.misfit_if(f"{local} > {most}")

    def read_bits(self, item: Item, bits: Bits, whole: str) -> None:
        """Cuts a number into its named bits."""
        fixed = bits.type.fixed_size  # one of computed size may have more bits than any name takes
        width = _ANY_WIDTH if fixed is None else 8 * fixed // (2 if bits.type.kind == "digits" else 1)
        for part in bits.parts:
            local = self.function.local(part.name, item.scope)
            self.function.add(f"{local} = {bits_text(part, whole, width)}")
            self.declare(item, part.name, local)
            self._judge_value(item.scope, part.is_, part.constants, local)
        if bits.name is not None:
            wire = self.function.wire_size(bits.name) if fixed is None else str(fixed)
            item.scope.entries[bits.name] = Entry(whole, sized=False, wire=wire)

    # ---- check codes --------------------------------------------------------------------------------------

    def judge_check(self, check: Check, local: str, is_slice: bool) -> None:
        """Compares a check code that was read into `local` with that of its range."""
        if covers_later(check, self.function.segments):
            if self.function.in_branch:
                raise not_possible(check, "a check under a condition covers what comes later", "put it behind that")
            self.function.late.append(lambda: self._compare_check(check, local, is_slice))
        else:
            self._compare_check(check, local, is_slice)

    def _compare_check(self, check: Check, local: str, is_slice: bool) -> None:
        code = code_text(self.module, check, self.range_text(check))
        found = self._code_of(check, local) if is_slice else local
        self.function.misfit_if(f"{found} != {code}")

    def residue(self, check: Check) -> int | None:
        """What the code over everything up to the check's own end must be; None where it has to be compared."""
        if check.form != "raw" or check.over is not None or check.span is not None or check.verify != "error":
            return None
        return residue_of(check.method, check.size, check.order)

    def judge_residue(self, check: Check, residue: int, last: bool) -> None:
        """One call over the check and all before it, instead of cutting, reading and comparing. `last`: that is all
        there may be."""
        covered = self.buffer if last else between(self.buffer, self.begin, self.place.plus(check.size))
        self.compare_residue(check, covered, residue)

    def compare_residue(self, check: Check, covered: str, residue: int) -> None:
        """What the code over `covered` (a text) has to be."""
        code = self.module.check(check.method, covered)
        self.function.misfit_if(f"({code}) != {residue:#x}" if not is_call(code) or residue else code)

    def _code_of(self, check: Check, local: str) -> str:
        """Text of the number behind a check code's bytes."""
        little = "_little" if check.order == "little" else ""
        if check.form == "raw":
            return f"int.from_bytes({local}, {quoted(check.order)})"
        if check.form == "dec":
            return f"{self.module.function(f'parse_dec{little}')}({local})"
        if check.form == "nibbles" and little:
            return f'int.from_bytes({self.module.function("join_nibbles")}({local}), "little")'
        if check.form == "nibbles":
            return f"{self.module.function('parse_nibbles')}({local})"
        if check.size == 2:
            self.module.imports.add("from binascii import unhexlify")
            return f"unhexlify({local})[0]"
        return f"{self.module.function(f'parse_hex{little}')}({local})"

    def range_text(self, check: Check) -> str:
        """Text of the bytes a check covers; the check itself begins at the present place."""
        if check.over is not None:
            return self.function.bytes_between(check.over)
        if check.span is not None:
            names = [name for name in span_names(check, self.function.segments) if name in self.function.bounds]
            if not names:
                return 'b""'
            first = self.function.bounds[names[0]]
            if {self.function.bounds[name].buffer for name in names} != {first.buffer}:
                return self.function.bytes_between(names)
            if first.buffer == self.buffer and check.span[1] == "here":
                return between(self.buffer, first.first, self.place)
            return between(first.buffer, first.first, self.function.bounds[names[-1]].last)
        return between(self.buffer, self.begin, self.place)

    # ---- what is compared when everything is read ---------------------------------------------------------

    def compare_length(self, item: Item, length: Length) -> None:
        """A length whose segments are not sized by it is compared with the room they take."""
        targets = targets_of(length, self.function.segments)
        if is_followed(length, targets):
            return
        local = item.scope.entries[length.name].text
        self.deferred.append(lambda: self.function.misfit_if(f"{local} != {self.room_text(length, targets)}"))

    def compare_count(self, item: Item, count: Count) -> None:
        """A count that does not say itself how often something is repeated is compared with the list."""
        repeat = self.function.by_name.get(count.of)
        there = is_always_there(count.of, self.function.segments)
        followed = isinstance(repeat, Repeat) and count.plus == 0 and is_plain_name(repeat.times, count.name)
        if not isinstance(repeat, Repeat) or (there and followed):
            return
        local = item.scope.entries[count.name].text
        plus = f" + {count.plus}" if count.plus > 0 else f" - {-count.plus}" if count.plus else ""

        def compare() -> None:
            items = item.scope.find(count.of)
            if items is not None:
                self.function.misfit_if(f"{local} != len({items.text}{'' if there else ' or ()'}){plus}")

        self.deferred.append(compare)

    def room_text(self, length: Length, targets: Mapping[str, Target]) -> str:
        """Text of what a length counts, when everything is read."""
        total = self.function.room(targets, plain=length.plain)
        if length.unit != 1:
            total = f"{total} // {length.unit}" if total.isalnum() else f"({total}) // {length.unit}"
        if length.plus:
            total = f"{total} + {length.plus}" if length.plus > 0 else f"{total} - {-length.plus}"
        return total


def bits_text(part: BitsPart, whole: str, width: int) -> str:
    """Text of some bits of the number `whole`, which has `width` bits."""
    text = f"{whole} >> {part.low}" if part.low else whole
    return text if part.high >= width - 1 else f"{text} & {(1 << part.high - part.low + 1) - 1:#x}"


def _without_limits(number: Field | Length | Count) -> Field | Length | Count:
    return replace(number, limits=None)
