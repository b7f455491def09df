"""What a kind of segment is for the compiler: everything about it in one class, found by its class in the model."""

from __future__ import annotations

from collections.abc import Mapping
from random import Random
from typing import Any, Generic, TypeVar

from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import Cases, EncodeWriter, Given
from framekit.codec.python.encode_plan import Lengths, PackArgument, Rules, RuleWriter, Task
from framekit.codec.python.expressions import Kind, NameEntry, Scope
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.module import add_helpers
from framekit.codec.python.reader import BufferReader, Item, Slot
from framekit.codec.python.registry import KINDS
from framekit.codec.python.source import quoted
from framekit.definition.brought import bring
from framekit.definition.expression import PRODUCT, Expression
from framekit.definition.kinds.base import KINDS as KINDS_BY_KEY
from framekit.definition.kinds.base import add_kind
from framekit.definition.model.segments import Bits, Count, Field, FieldType, Length, Segment

S = TypeVar("S", bound=Segment)


class SegmentKind(Generic[S]):
    """One kind. The writers of generated functions ask it for what they write of such a segment."""

    model: type[S]
    may_be_absent = False
    """Whether a builder of several frames puts its bytes together at once even if it stands under a condition."""

    def is_plain(self, segment: S) -> bool:
        """Whether one function can read or build it with the frame around its own: it holds no frame and no list of
        records.
        """
        return self.may_be_absent

    def describe(self, segment: S) -> str:
        """A segment in words, for docstrings; empty if there is nothing to say."""
        return ""

    def struct_order(self, segment: S) -> str | None:
        """The byte order it needs in a struct ('' for any), which takes a fixed size; None if it stands in none."""
        return None

    # ---- decoding -----------------------------------------------------------------------------------------

    def slot(self, r: BufferReader, item: Item, segment: S, size: int) -> Slot:
        """What a segment of fixed size takes of the struct that unpacks a run of them; padding if not overridden."""
        return Slot(item, size, "x", "", None)

    def unpacked(self, r: BufferReader, slot: Slot, segment: S, source: str, converted: bool) -> None:
        """From what the struct gave (the text `source`) to the value, and what must hold for it.

        `r.place` is where the segment begins. `converted`: the source is the number already.
        """

    def read(self, r: BufferReader, item: Item, segment: S, after: tuple[Item, ...]) -> None:
        """Reads a segment that is there and stands in no run. `after`: what follows it in the buffer."""
        raise TypeError(f"no segment to read: {segment!r}")

    # ---- encoding -----------------------------------------------------------------------------------------

    def tasks(self, w: EncodeWriter, segment: S, scope: Scope, given: Given) -> list[Task]:
        """What brings its values into locals, each with what it waits for."""
        return []

    def cases(self, w: EncodeWriter, segment: S, scope: Scope, given: Given) -> Cases:
        """The headers and segments of lists of which one is there; None: a case that must not be."""
        raise TypeError(f"no cases: {segment!r}")

    def argument(self, w: EncodeWriter, segment: S, scope: Scope, size: int) -> PackArgument:
        """What a segment of fixed size gives to the struct that packs a run of them."""
        raise TypeError(f"no segment of a run: {segment!r}")

    def bytes_text(self, w: EncodeWriter, segment: S, scope: Scope) -> str:
        """Text of the bytes of a segment that is there and stands in no run."""
        raise TypeError(f"no segment to build: {segment!r}")

    def room(self, w: EncodeWriter, segment: S, scope: Scope, plain: bool) -> str | None:
        """Text of the bytes it takes where that varies; `plain`: before conversion. None where it is not asked for."""
        return None

    def room_waits(self, w: EncodeWriter, segment: S) -> set[str]:
        """What has to be there before `room` can be told."""
        return {f"bytes of {segment.path}"}

    def rules(self, w: RuleWriter, segment: S, always: bool, lengths: Lengths) -> Rules:
        """The rules that values of these names obey, as text, by name.

        `always`: it is there in every frame. `lengths`: how long values may be by the length that counts them.
        """
        return ()

    # ---- samples ------------------------------------------------------------------------------------------

    def sample(self, random: Random, segment: S) -> Mapping[str, Any]:
        """Values that such a segment may have, for samples of frames; nothing where they follow from others."""
        return {}

    # ---- diagnosis ----------------------------------------------------------------------------------------

    def declare(self, d: DiagnosisWriter, segment: S, scope: Scope) -> None:
        """Puts the names that expressions may read into a scope, as careful functions know them."""
        for name in segment.value_names:
            scope.entries[name] = NameEntry(f"n[{quoted(name)}]")

    def diagnose(self, d: DiagnosisWriter, segment: S, scope: Scope, behind: Behind) -> None:
        """Writes the calls that read a segment that is there carefully. `behind`: what follows it in its buffer."""
        raise NotImplementedError

    # ---- measuring ----------------------------------------------------------------------------------------

    def measure(self, m: MeasureWriter, segment: S, scope: Scope, after: Pairs) -> None:
        """Writes how a measuring function passes a segment that is there. `after`: what follows it in the frame.

        Raises Finished when nothing that follows matters any more.
        """
        m.skip(str(m.static.present(segment).fixed or 0))


def register(*kinds: type[SegmentKind[Any]]) -> None:
    """Kinds that definitions may use from now on: those of framekit, and those that a program brings by itself.

    Raises ValueError for a word or a model that another module has, and for keys whose schema is wrong.
    """
    for kind in kinds:
        model, key, there = kind.model, kind.model.KEY, KINDS.get(kind.model)
        if there is not None and type(there).__module__ != kind.__module__:
            whose = type(there).__module__
            raise ValueError(f"'{whose}' has a kind of {model.__name__} already – make a model of its own")
        if key and KINDS_BY_KEY.get(key) is not model:
            from framekit.definition.schema import add_kind_of

            add_kind_of("protocol", "segment", key, model.schema(), kind.__module__)
            add_kind(model)
            add_helpers(bring(kind.__module__))
        KINDS[model] = kind()


T = TypeVar("T", Field, Length, Count, Bits)


class TypedKind(SegmentKind[T]):
    """How the value is written and measured; a kind overrides what is different with it."""

    def struct_order(self, segment: T) -> str | None:
        code = forms.struct_code(segment.type)
        return None if code is None else code[1]

    def argument(self, w: EncodeWriter, segment: T, scope: Scope, size: int) -> PackArgument:
        return w.number_argument(segment, scope, size)

    def bytes_text(self, w: EncodeWriter, segment: T, scope: Scope) -> str:
        size = segment.type.size
        text = w.bounded(size, scope) if isinstance(size, Expression) else str(size)
        return forms.build(w.module, segment.type, w.wire(segment, scope), text)

    def room_waits(self, w: EncodeWriter, segment: T) -> set[str]:
        return w.waits(segment.type.size if isinstance(segment.type.size, Expression) else None)

    def room(self, w: EncodeWriter, segment: T, scope: Scope, plain: bool) -> str | None:
        return w.text(segment.type.size, scope, PRODUCT + 1) if isinstance(segment.type.size, Expression) else None

    def measure(self, m: MeasureWriter, segment: T, scope: Scope, after: Pairs) -> None:
        m.number(segment, scope, after)


V = TypeVar("V", Field, Length, Count)


class TypedValueKind(TypedKind[V]):
    """One value of a type; a kind says what must hold for it."""

    def must_hold(self, r: BufferReader, item: Item, segment: V, local: str) -> None:
        """Writes what must hold for the value, which is in `local`."""
        raise NotImplementedError

    def slot(self, r: BufferReader, item: Item, segment: V, size: int) -> Slot:
        code, order = forms.struct_code(segment.type) or ("", "")
        return Slot(item, size, code, order, r.function.local(segment.name, item.scope))

    def unpacked(self, r: BufferReader, slot: Slot, segment: V, source: str, converted: bool) -> None:
        item, local = slot.item, slot.text
        r.assign(local, r.value_text(segment, local, r.wire(segment.type, source, converted)))
        r.declare(item, segment.name, local, sized=has_length(segment.type), wire=str(slot.size))
        self.must_hold(r, item, segment, local)

    def declare(self, d: DiagnosisWriter, segment: V, scope: Scope) -> None:
        scope.entries[segment.name] = careful_entry(segment, sized=has_length(segment.type))


def careful_entry(segment: Segment, kind: Kind = "value", *, sized: bool) -> NameEntry:
    """Return what the name of a segment stands for in the careful reading."""
    room = f"n.room({quoted(segment.path)})"
    return NameEntry(f"n[{quoted(segment.name or '')}]", kind, sized=sized, wire=room, path=segment.path)


def has_length(type_: FieldType) -> bool:
    """Whether values of a type have a length of their own."""
    return type_.kind in ("ascii", "bytes")
