"""Check codes: the covered bytes, the method and the wire form.

Wrapped content is covered before the wrap is applied.
"""

from __future__ import annotations

from functools import partial
from io import BytesIO
from typing import Any

from construct import ConstructError, Container

from construct_oracle.base import SegmentConstruct
from construct_oracle.evaluate import evaluate
from construct_oracle.faults import ConstructEncodeError, Place
from construct_oracle.filling import Filling
from construct_oracle.forms import form_of
from construct_oracle.keyed import code_with_key
from construct_oracle.names import Names
from construct_oracle.sizes import Evaluate
from construct_oracle.state import Leaf, Mark, Reading, State, Unopened, Writing, is_marked, mark_of
from framekit.codec import support
from framekit.codec.checks import compute
from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName
from framekit.definition.kinds.check import Added, Edges
from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.segments import Check


class CheckConstruct(SegmentConstruct):
    """A check code over everything before it, over named segments, or over a span of them.

    Parsing compares after the whole frame is read, and notes `check` for a wrong code (unless `verify` disables it).
    Building reserves the bytes and writes the code after all covered segments.
    """

    segment: Check

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        start, leaves = stream.tell(), len(reading.leaves)
        found = reading.take(stream, self.segment.size, place)
        reading.leaf(found)
        if self.segment.verify != "error":
            return

        def compare() -> None:
            if reading.stopped and not all(is_marked(context, name) for name in self._mentioned()):
                reading.faults.unchecked = True
                return
            try:
                value_of = partial(reading.evaluate, context=context)
                covered = self._covered(reading, context, stream.getvalue()[:start], stream, leaves, value_of)
                code = self._code(covered, reading.names, value_of)
            except Unopened:
                reading.note(place, "value", "values it can be worked out from", "none")
                reading.faults.unchecked = True
                return
            except (ConstructError, MissingName, *EVALUATION_ERRORS):
                reading.note(place, "value", "values it can be worked out from", "none")
                return
            if self._number(found) != code:
                keyed = self.segment.method.is_keyed
                reading.note(place, "check", "the code made with the key" if keyed else self.written(code), found)

        reading.later.append(compare)

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        writing: Writing = context._state
        start, leaves = stream.tell(), len(writing.leaves)
        stream.write(bytes(self.segment.size))
        leaf = writing.leaf(bytes(self.segment.size))
        writing.later.append(partial(self._fill_in, filling, stream, context, start, leaves, leaf))

    def _fill_in(
        self, filling: Filling, stream: BytesIO, context: Container, start: int, leaves: int, leaf: Leaf
    ) -> None:
        state: Writing = context._state
        value_of = partial(filling.compute, own=self.label)
        try:
            covered = self._covered(state, context, stream.getvalue()[:start], stream, leaves, value_of)
            code = self._code(covered, state.names, value_of)
        except (ConstructError, TypeError, ValueError) as error:
            if isinstance(error, ConstructEncodeError):
                raise
            raise filling.error(self.label, f"what '{self.label}' counts cannot be worked out") from None
        leaf.data = self.written(code)
        end = stream.tell()
        stream.seek(start)
        stream.write(leaf.data)
        stream.seek(end)

    def _code(self, covered: bytes, names: Names, value_of: Evaluate) -> int:
        check = self.segment
        size = check.size if check.form == "raw" else check.size // 2
        if check.method.kind == "code" and check.method.expression is not None:
            found = evaluate(check.method.expression.root, Names({"data": covered}, names).__getitem__)
            if not isinstance(found, bytes) or len(found) < size:
                raise ValueError("no code")
            return int.from_bytes(found[:size], "big")
        if check.key is None:
            return code_of(check.method, covered, names)
        return code_with_key(check.method.kind, value_of(check.key), covered, size)

    # ---- what is covered ----------------------------------------------------------------------------------

    def _covered(
        self, state: State, context: Container, before: bytes, stream: BytesIO, leaves: int, value_of: Evaluate
    ) -> bytes:
        """Return the bytes that the code covers; `before` and `leaves` are the bytes before the check."""
        if self.segment.covers is None:
            return before
        here = Mark(leaves, leaves, 0, len(before))
        parts = self.segment.covers
        return b"".join(
            _added(part, value_of(part.value))
            if isinstance(part, Added)
            else self._part(part, state, context, stream, here)
            for part in parts
        )

    def _part(self, part: str | Edges, state: State, context: Container, stream: BytesIO, here: Mark) -> bytes:
        first, last = (part, part) if isinstance(part, str) else part
        try:
            begin, end = mark_of(context, first), here if last == "here" else mark_of(context, last)
        except KeyError:
            return b""  # an absent segment adds no bytes
        if self.segment.wire:
            return stream.getvalue()[begin.start : end.start + end.wire]
        return state.bytes_of(begin.first, end.last)

    def _mentioned(self) -> tuple[str, ...]:
        """Return the names of the covered segments."""
        return *self.segment.names, *self.segment.edges

    # ---- how it is written --------------------------------------------------------------------------------

    def written(self, code: int) -> bytes:
        """Return the wire form of the code. Raises OverflowError or ValueError if it does not fit its size."""
        check, little = self.segment, self.segment.order == "little"
        if check.form == "raw":
            return code.to_bytes(check.size, check.order)
        if check.form == "dec":
            return support.build_dec(code, check.size)[:: -1 if little else 1]
        if check.form == "nibbles":
            return support.split_nibbles(code.to_bytes(check.size // 2, check.order))
        digits = support.build_hex_little(code, check.size) if little else support.build_hex(code, check.size)
        return digits.lower() if check.form == "hex" else digits

    def _number(self, data: bytes) -> int | None:
        """Return the code that the wire bytes represent, or None if they are invalid."""
        check, little = self.segment, self.segment.order == "little"
        try:
            if check.form == "raw":
                return int.from_bytes(data, check.order)
            if check.form == "dec":
                return support.parse_dec(data[:: -1 if little else 1])
            if check.form == "nibbles":
                return int.from_bytes(support.join_nibbles(data), check.order)
            return support.parse_hex_little(data) if little else support.parse_hex(data)
        except ValueError:
            return None


def _added(part: Added, value: Any) -> bytes:
    """Return covered bytes that are not transmitted."""
    if part.type is None:
        if not isinstance(value, (bytes, bytearray)):
            raise TypeError("no bytes")
        return bytes(value)
    return bytes(form_of(part.type, part.type.fixed_size or 0).build(value))


def code_of(method: CheckMethod, data: bytes, names: Names) -> int:
    """Return the check code of `data`; the expression of a fold is evaluated byte by byte."""
    if method.expression is None:
        return compute(method, data)
    mask, code = (1 << method.width) - 1, method.initial
    for byte in data:
        code = evaluate(method.expression.root, Names({"acc": code, "byte": byte}, names).__getitem__) & mask
    if method.complement is not None:
        code = ~code & mask if method.complement == "ones" else -code & mask
    return code if method.mask is None else code & method.mask
