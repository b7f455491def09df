"""Define `SegmentKind`, the base class of everything the compiler knows about a kind of segment.

`register` files an instance of each kind under its model class (`python.registry.KINDS`).
"""

from __future__ import annotations

from collections.abc import Mapping
from random import Random
from typing import Any, Generic, TypeVar

from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import Cases, ConsumedValues, EncodeWriter
from framekit.codec.python.encode_plan import Lengths, PackArgument, Rules, RuleWriter, Task
from framekit.codec.python.expressions import FieldScope, Kind, NameEntry
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.module import add_helpers
from framekit.codec.python.reader import BufferReader, ScopedSegment, Slot
from framekit.codec.python.registry import KINDS
from framekit.codec.python.source import quoted
from framekit.definition.brought import bring
from framekit.definition.expression import PRODUCT, Expression
from framekit.definition.kinds.base import KINDS as KINDS_BY_KEY
from framekit.definition.kinds.base import add_kind
from framekit.definition.model.segments import Bits, Count, Field, FieldType, Length, Segment

S = TypeVar("S", bound=Segment)


class SegmentKind(Generic[S]):
    """Describe one kind of segment to the compiler. The writers of generated functions call its methods."""

    model: type[S]
    """The model class of the segments that this kind handles."""
    may_be_absent = False
    """Whether a builder of nested frames can pack the segment directly although it has a condition."""

    def is_plain(self, segment: S) -> bool:
        """Return whether a fused function (a frame together with its outer frame) can read or build the segment.

        False for a segment that holds a frame or a list of records.
        """
        return self.may_be_absent

    def describe(self, segment: S) -> str:
        """Return a short description of the segment for docstrings; empty if it needs none."""
        return ""

    def struct_order(self, segment: S) -> str | None:
        """Return the byte order of the segment in a struct ('' for any), or None if no struct can hold it."""
        return None

    # ---- decoding -----------------------------------------------------------------------------------------

    def slot(self, r: BufferReader, item: ScopedSegment, segment: S, size: int) -> Slot:
        """Return the slot of a fixed-size segment in the struct that unpacks a run; padding unless overridden."""
        return Slot(item, size, "x", "", None)

    def unpacked(self, r: BufferReader, slot: Slot, segment: S, source: str, converted: bool) -> None:
        """Write the conversion of the unpacked number or bytes (`source`) to the value, and the checks of the value.

        `r.place` is the offset of the segment. `converted`: `source` is the final number and needs no conversion.
        """

    def read(self, r: BufferReader, item: ScopedSegment, segment: S, after: tuple[ScopedSegment, ...]) -> None:
        """Write the reading of a present segment that is not part of a run; `after` lists the items that follow it."""
        raise TypeError(f"no segment to read: {segment!r}")

    # ---- encoding -----------------------------------------------------------------------------------------

    def tasks(self, w: EncodeWriter, segment: S, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        """Return the tasks that put the values of the segment into locals, each with its prerequisites."""
        return []

    def cases(self, w: EncodeWriter, segment: S, scope: FieldScope, given: ConsumedValues) -> Cases:
        """Return the alternative segment lists with the header line of each; a list of None marks a forbidden case."""
        raise TypeError(f"no cases: {segment!r}")

    def argument(self, w: EncodeWriter, segment: S, scope: FieldScope, size: int) -> PackArgument:
        """Return the argument of a fixed-size segment for the struct that packs a run."""
        raise TypeError(f"no segment of a run: {segment!r}")

    def bytes_text(self, w: EncodeWriter, segment: S, scope: FieldScope) -> str:
        """Return the source of the bytes of a present segment that is not part of a run."""
        raise TypeError(f"no segment to build: {segment!r}")

    def room(self, w: EncodeWriter, segment: S, scope: FieldScope, plain: bool) -> str | None:
        """Return the source of the size of a segment of variable size, in bytes, or None if no length needs it.

        `plain`: the size before conversion.
        """
        return None

    def room_waits(self, w: EncodeWriter, segment: S) -> set[str]:
        """Return the tokens that must be available before `room` can be computed."""
        return {f"bytes of {segment.path}"}

    def rules(self, w: RuleWriter, segment: S, always: bool, lengths: Lengths) -> Rules:
        """Yield each value name with the source of the `Rule` that its value obeys.

        `always`: the segment is present in every frame. `lengths`: limits of the size of values, from their length
        fields.
        """
        return ()

    # ---- samples ------------------------------------------------------------------------------------------

    def sample(self, random: Random, segment: S) -> Mapping[str, Any]:
        """Return random values for sample frames; empty if the values follow from other segments."""
        return {}

    # ---- diagnosis ----------------------------------------------------------------------------------------

    def declare(self, d: DiagnosisWriter, segment: S, scope: FieldScope) -> None:
        """Add the names that expressions may read to `scope`, in the form that careful functions use."""
        for name in segment.value_names:
            scope.entries[name] = NameEntry(f"n[{quoted(name)}]")

    def diagnose(self, d: DiagnosisWriter, segment: S, scope: FieldScope, behind: Behind) -> None:
        """Write the calls that read a present segment carefully, given the later segments of its buffer."""
        raise NotImplementedError

    # ---- measuring ----------------------------------------------------------------------------------------

    def measure(self, m: MeasureWriter, segment: S, scope: FieldScope, after: Pairs) -> None:
        """Write how a measuring function passes a present segment; `after` lists the later segments of the frame.

        Raises Finished if no later segment can change the result.
        """
        m.skip(str(m.static.present(segment).fixed or 0))


def register(*kinds: type[SegmentKind[Any]]) -> None:
    """Register kinds of segments, of framekit or of a program, for use in definitions.

    Raises ValueError for a key word or a model that another module has registered, and for keys with an invalid schema.
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
    """Write and measure a segment that has a type; a kind overrides the differences."""

    def struct_order(self, segment: T) -> str | None:
        code = forms.struct_code(segment.type)
        return None if code is None else code[1]

    def argument(self, w: EncodeWriter, segment: T, scope: FieldScope, size: int) -> PackArgument:
        return w.number_argument(segment, scope, size)

    def bytes_text(self, w: EncodeWriter, segment: T, scope: FieldScope) -> str:
        size = segment.type.size
        text = w.bounded(size, scope) if isinstance(size, Expression) else str(size)
        return forms.build(w.module, segment.type, w.wire(segment, scope), text)

    def room_waits(self, w: EncodeWriter, segment: T) -> set[str]:
        return w.waits(segment.type.size if isinstance(segment.type.size, Expression) else None)

    def room(self, w: EncodeWriter, segment: T, scope: FieldScope, plain: bool) -> str | None:
        return w.text(segment.type.size, scope, PRODUCT + 1) if isinstance(segment.type.size, Expression) else None

    def measure(self, m: MeasureWriter, segment: T, scope: FieldScope, after: Pairs) -> None:
        m.number(segment, scope, after)


V = TypeVar("V", Field, Length, Count)


class TypedValueKind(TypedKind[V]):
    """Read one value of a type; each kind adds its own checks of the value."""

    def must_hold(self, r: BufferReader, item: ScopedSegment, segment: V, local: str) -> None:
        """Write the checks of the value in `local`."""
        raise NotImplementedError

    def slot(self, r: BufferReader, item: ScopedSegment, segment: V, size: int) -> Slot:
        code, order = forms.struct_code(segment.type) or ("", "")
        return Slot(item, size, code, order, r.function.local(segment.name, item.scope))

    def unpacked(self, r: BufferReader, slot: Slot, segment: V, source: str, converted: bool) -> None:
        item, local = slot.item, slot.text
        r.assign(local, r.value_text(segment, local, r.wire(segment.type, source, converted)))
        r.declare(item, segment.name, local, sized=has_length(segment.type), wire=str(slot.size))
        self.must_hold(r, item, segment, local)

    def declare(self, d: DiagnosisWriter, segment: V, scope: FieldScope) -> None:
        scope.entries[segment.name] = careful_entry(segment, sized=has_length(segment.type))


def careful_entry(segment: Segment, kind: Kind = "value", *, sized: bool) -> NameEntry:
    """Return the scope entry of a segment's name for the careful functions."""
    room = f"n.room({quoted(segment.path)})"
    return NameEntry(f"n[{quoted(segment.name or '')}]", kind, sized=sized, wire=room, path=segment.path)


def has_length(type_: FieldType) -> bool:
    """Return whether values of this type have a length (text and bytes)."""
    return type_.kind in ("ascii", "bytes")
