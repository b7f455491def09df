"""Runs of segments of fixed size: one struct for all of them, hex digits of neighbours decoded at once.

Constants are compared as slices, check codes as numbers. Everything is a condition; nothing is raised here.
"""

from __future__ import annotations

from dataclasses import dataclass

from framekit.codec.python import forms
from framekit.codec.python.places import Place, between, index
from framekit.codec.python.reader import START, Item
from framekit.codec.python.source import bytes_literal, quoted
from framekit.codec.python.verdict import JudgingReader
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

_FEW_BYTES = 4
"""So many single bytes are read sooner one by one than by a struct."""


@dataclass(slots=True)
class Piece:
    """One segment of a run: its bytes, its struct code with the order that needs, and the local for its value.

    `source`: where the value is taken from, the local itself once it is unpacked.
    """

    item: Item
    size: int
    code: str
    order: str
    local: str | None
    source: str = ""

    @property
    def is_pad(self) -> bool:
        return self.local is None


@dataclass(slots=True)
class Chunk:
    """What takes one value of the struct: a piece, several paddings, or several fields of hex digits."""

    pieces: list[Piece]
    local: str | None

    @property
    def size(self) -> int:
        return sum(piece.size for piece in self.pieces)

    @property
    def code(self) -> str:
        if self.local is None:
            return f"{self.size}x" if self.size != 1 else "x"
        return self.pieces[0].code if len(self.pieces) == 1 else f"{self.size}s"

    @property
    def order(self) -> str:
        return self.pieces[0].order if len(self.pieces) == 1 and not self.code.endswith("s") else ""


class RunReader(JudgingReader):
    """Reads runs of fixed segments."""

    def length_of_run(self, items: list[Item]) -> int:
        """How many of the items from the first on fit into one struct."""
        order = ""
        for count, item in enumerate(items):
            segment = item.segment
            free = isinstance(segment, Check) and segment.when is None and self.residue(segment) is not None
            wanted = "" if free else forms.struct_order(segment)
            if wanted is None or (order and wanted and wanted != order):
                return count
            order = order or wanted
        return len(items)

    def read_run(self, items: list[Item], whole: bool, last: bool) -> None:
        """Reads the items; `whole`: they are all there is, so that the struct itself sees to the buffer's size; `last`:
        nothing stands behind them."""
        pieces = [self._piece(item) for item in items]
        chunks = self._chunks(pieces)
        base = self.place
        exact = self._unpack(chunks, base, whole)
        for piece in pieces:
            self.function.stands(piece.item.segment, self.buffer, self.place, self.place.plus(piece.size))
            self.place = self.place.plus(piece.size)
        self.place = base
        for chunk in chunks:
            if len(chunk.pieces) > 1 and chunk.local is not None:
                self._digits_of(chunk)
        constant: tuple[Place, bytes] | None = None
        for piece in pieces:
            if isinstance(piece.item.segment, Const):
                start, data = constant or (self.place, b"")
                constant = start, data + piece.item.segment.data
            else:
                self._compare_constant(constant)
                constant = None
                joined = any(piece in chunk.pieces for chunk in chunks if len(chunk.pieces) > 1)
                self._finish(piece, converted=joined, last=last and piece is pieces[-1])
            self.place = self.place.plus(piece.size)
        self._compare_constant(constant)
        if exact:
            self.place = Place("end", 0)

    # ---- unpacking ----------------------------------------------------------------------------------------

    def _piece(self, item: Item) -> Piece:
        segment = item.segment
        size = self.shapes.present(segment).fixed or 0
        match segment:
            case Field(name=name, type=type_) | Length(name=name, type=type_) | Count(name=name, type=type_):
                code, order = forms.struct_code(type_) or ("", "")
                return Piece(item, size, code, order, self.function.local(name, item.scope))
            case Bits(type=type_):
                code, order = forms.struct_code(type_) or ("", "")
                return Piece(item, size, code, order, self.function.names.fresh(shown_name(segment, "bits")))
            case Data(name=name):
                return Piece(item, size, f"{size}s", "", self.function.local(name, item.scope))
            case Check(verify="error") if self.residue(segment) is None:
                code, order = forms.check_code(segment)
                return Piece(item, size, code, order, self.function.names.fresh("check"))
        return Piece(item, size, "x", "", None)

    def _chunks(self, pieces: list[Piece]) -> list[Chunk]:
        chunks: list[Chunk] = []
        for piece in pieces:
            last = chunks[-1] if chunks else None
            if last is not None and piece.is_pad and last.local is None:
                last.pieces.append(piece)
            elif last is not None and _join_as_digits(last, piece):
                last.local = self.function.names.fresh("digits") if len(last.pieces) == 1 else last.local
                last.pieces.append(piece)
            else:
                chunks.append(Chunk([piece], piece.local))
        return chunks

    def _unpack(self, chunks: list[Chunk], base: Place, whole: bool) -> bool:
        """Writes the line that takes all values; whether it sees to the size of the buffer itself."""
        wanted = [chunk for chunk in chunks if chunk.local is not None]
        if not wanted:
            return False
        first, last = chunks.index(wanted[0]), chunks.index(wanted[-1])
        place = base.plus(sum(chunk.size for chunk in chunks[:first]))
        if len(wanted) == 1 and wanted[0].code[-1] in "Bs":
            size = wanted[0].size
            is_byte = wanted[0].code == "B"
            text = index(self.buffer, place) if is_byte else between(self.buffer, place, place.plus(size))
            if len(wanted[0].pieces) == 1:
                wanted[0].pieces[0].source = text
            else:
                wanted[0].local = text
            return False
        exact = whole and base == START
        if not exact and self._single_bytes(chunks, wanted, base):
            return False
        for chunk in wanted:
            chunk.pieces[0].source = chunk.local or ""
        taken = chunks if exact else chunks[first : last + 1]
        order = next((chunk.order for chunk in wanted if chunk.order), "")
        constant = self.module.struct("".join(chunk.code for chunk in taken), order, self.function.title)
        targets = ", ".join(chunk.local or "" for chunk in wanted)
        targets = f"({targets},)" if len(wanted) == 1 else targets
        offset = place.text(self.buffer)
        behind = "" if exact or offset == "0" else f", {place.offset if place.base == 'end' else offset}"
        self.function.add(f"{targets} = {constant}.unpack{'' if exact else '_from'}({self.buffer}{behind})")
        return exact

    def _single_bytes(self, chunks: list[Chunk], wanted: list[Chunk], base: Place) -> bool:
        """Takes single bytes one by one, if there are few of them at fixed places."""
        if len(wanted) > _FEW_BYTES or base.base not in ("", "end") or any(chunk.code != "B" for chunk in wanted):
            return False
        place = base
        for chunk in chunks:
            if chunk.local is not None:
                chunk.pieces[0].source = index(self.buffer, place)
            place = place.plus(chunk.size)
        return True

    def _digits_of(self, chunk: Chunk) -> None:
        """Neighbouring fields of hex digits become their numbers in one go."""
        self.module.imports.add("from binascii import unhexlify")
        codes, orders = "", set()
        for piece in chunk.pieces:
            type_ = type_of(piece.item.segment)
            places = forms.hex_places(type_) or 0
            codes += forms.INT_CODES[places]
            if places > 1:
                orders.add("<" if type_.order == "little" else ">")
        constant = self.module.struct(codes, next(iter(orders), ""), self.function.title, "digits")
        targets = ", ".join(piece.local or "" for piece in chunk.pieces)
        self.function.add(f"{targets} = {constant}.unpack(unhexlify({chunk.local}))")

    # ---- what becomes of the values -----------------------------------------------------------------------

    def _compare_constant(self, constant: tuple[Place, bytes] | None) -> None:
        if constant is None:
            return
        place, data = constant
        if len(data) == 1:
            self.function.misfit_if(f"{index(self.buffer, place)} != {data[0]:#04x}")
        else:
            text = between(self.buffer, place, place.plus(len(data)))
            self.function.misfit_if(f"{text} != {bytes_literal(data)}")

    def _finish(self, piece: Piece, converted: bool, last: bool) -> None:
        """From what the struct gave to the value, and what must hold for it. `self.place`: where the segment begins."""
        item, local = piece.item, piece.local
        if local is None:
            residue = self.residue(item.segment) if isinstance(item.segment, Check) else None
            if isinstance(item.segment, Check) and residue is not None:
                self.judge_residue(item.segment, residue, last)
            return
        source = local if converted else piece.source
        match item.segment:
            case Field() as field:
                wire = self._wire(field.type, source, converted)
                self._assign(local, self._value_text(field, local, wire))
                sized = field.type.kind in ("ascii", "bytes")
                self.declare(item, field.name, local, sized=sized, wire=str(piece.size))
                self.judge_field(item, field, local)
            case Length() | Count() as number:
                self._assign(local, self._value_text(number, local, self._wire(number.type, source, converted)))
                self.declare(item, number.name, local, sized=False, wire=str(piece.size))
                self.judge_limits(number, local)
                if isinstance(number, Length):
                    self.compare_length(item, number)
                else:
                    self.compare_count(item, number)
            case Bits() as bits:
                self._assign(local, self._wire(bits.type, source, converted))
                self.read_bits(item, bits, local)
            case Data() as data:
                self._assign(local, forms.memory_text(self.module, data, source))
                self.declare(item, data.name, local)
                if isinstance(data.size, int) and data.least > data.size:
                    self.function.misfit_if(f"len({local}) < {data.least}")
            case Check() as check:
                self.judge_check(check, source, piece.code.endswith("s"))

    def _value_text(self, number: Field | Length | Count, local: str, wire: str) -> str:
        """Text of the value; a wire value that is looked at twice is put into the local first."""
        if forms.reads_twice(number) and wire != local:
            self.function.add(f"{local} = {wire}")
            wire = local
        return forms.value_of(number, wire)

    def _assign(self, local: str, text: str) -> None:
        if text != local:
            self.function.add(f"{local} = {text}")

    def _wire(self, type_: FieldType, source: str, converted: bool) -> str:
        """Text of the wire value of what the struct gave."""
        if converted or not forms.is_slice(type_):
            return source
        if type_.kind == "bcd" and type_.fixed_size == 1:
            return f"{self.module.bcd_numbers()}[{source}]"
        places = forms.hex_places(type_)
        if places is None:
            return forms.parse(self.module, type_, source)
        self.module.imports.add("from binascii import unhexlify")
        raw = f"unhexlify({source})"
        return f"{raw}[0]" if places == 1 else f"int.from_bytes({raw}, {quoted(type_.order)})"


def type_of(segment: Segment) -> FieldType:
    """The type of a segment that has one."""
    assert isinstance(segment, (Field, Bits, Length, Count))
    return segment.type


def shown_name(segment: Segment, otherwise: str) -> str:
    """A segment's own name; `otherwise` when it has none."""
    return otherwise if segment.name is None or segment.name.startswith("_") else segment.name


def _join_as_digits(chunk: Chunk, piece: Piece) -> bool:
    """Whether a field of hex digits may be decoded together with those before it."""
    types = []
    for other in (*chunk.pieces, piece):
        if not isinstance(other.item.segment, (Field, Bits, Length, Count)):
            return False
        type_ = other.item.segment.type
        if forms.hex_places(type_) is None:
            return False
        types.append(type_)
    return len({type_.order for type_ in types if type_.fixed_size != 2}) <= 1
