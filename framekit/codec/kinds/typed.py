"""What segments of one type have in common: fields, lengths, counts, bits."""

from __future__ import annotations

from typing import TypeVar

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.encode import EncodeWriter, PackArgument
from framekit.codec.python.expressions import Scope
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.definition.expression.emit import PRODUCT
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import Bits, Count, Field, Length

T = TypeVar("T", Field, Length, Count, Bits)


class TypedKind(SegmentKind[T]):
    """How the value is written and measured; a kind overrides what is different with it."""

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
