"""What writers of careful functions share: sizes, what stands behind, names as such functions know them."""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python.expressions import Entry, ExpressionWriter, Scope
from framekit.codec.python.function import span_names
from framekit.codec.python.module import Module
from framekit.codec.python.names import Names
from framekit.codec.python.shape import names_asked_for
from framekit.codec.python.source import Source, bytes_literal, quoted
from framekit.definition.expression.emit import BIT_OR, PRODUCT
from framekit.definition.expression.syntax import Expression, names_in
from framekit.definition.model.segments import (
    Bits,
    Check,
    Const,
    Count,
    Data,
    Field,
    Inner,
    Length,
    Record,
    Repeat,
    Segment,
    Value,
)
from framekit.definition.model.walk import everything, leaves

Behind = tuple[tuple[Segment, Scope], ...]
"""What follows a segment in its buffer, with the scopes of its names."""


class Examining:
    """State of a careful function being written."""

    def __init__(self, module: Module, segments: tuple[Segment, ...]) -> None:
        self.module = module
        self.shapes = module.shapes
        self.segments = segments
        self.by_name = {segment.name: segment for segment in everything(segments) if segment.name}
        self.out = Source()
        self.names = Names(module.words())
        self.hoisted: dict[str, str] = {}
        self.deferred: list[str] = []
        self.late_checks: list[str] = []
        self.field_names = {name for segment in everything(segments) for name in segment.value_names}
        self.read_names: set[str] = set()
        self.asked_by_name = names_asked_for(segments)
        self.asked_for = self._asked_for()

    def _asked_for(self) -> set[str]:
        """Names of segments without one of their own that a check or a length means."""
        found: set[str] = set()
        for segment in everything(self.segments):
            if isinstance(segment, Check):
                found.update(span_names(segment, self.segments))
                covered = (one for one in everything(self.segments) if one.name in (segment.over or ()))
                found.update(leaf.name or "" for leaf in leaves(covered))
            elif isinstance(segment, Length):
                found.update(segment.of)
        return found

    # ---- texts --------------------------------------------------------------------------------------------

    def context(self, name: str) -> str:
        """Context values are fetched once, outside everything that takes errors for faults of the frame."""
        if name not in self.hoisted:
            self.module.context.add(self.module.known(name, self.by_name))
            self.hoisted[name] = self.names.fresh(name)
        return self.hoisted[name]

    def writer(self, scope: Scope) -> ExpressionWriter:
        return ExpressionWriter(self.module, scope, self.context)

    def ask(self, what: int | Expression | str, scope: Scope, factor: str = "") -> str:
        """A number, or a function of `n` that gives it; `rest` is None."""
        if what == "rest":
            return "None"
        if isinstance(what, int):
            return str(what * 2 if factor == " * 2" else what // 2 if factor else what)
        assert isinstance(what, Expression)
        return f"lambda n: {self.writer(scope).text(what, PRODUCT if factor else 0)}{factor}"

    def behind(self, after: Behind) -> str:
        """Text of the bytes behind a segment that reaches to the end; a `lambda` if some may be absent."""
        fixed, parts = 0, []
        for segment, scope in after:
            size = self.shapes.present(segment).fixed
            if size is None or not self.is_told(segment):
                return self._constant_behind(after[0][0])
            if segment.when is None:
                fixed += size
            elif size:
                parts.append(f"({size} if {self.writer(scope).text(segment.when, BIT_OR)} else 0)")
        if not parts:
            return str(fixed)
        return "lambda n: " + " + ".join([*([str(fixed)] if fixed else []), *parts])

    def is_told(self, segment: Segment) -> bool:
        """Whether it can be told already if the segment is there."""
        return segment.when is None or not names_in(segment.when.root) & (self.field_names - self.read_names)

    def _constant_behind(self, segment: Segment) -> str:
        data = segment.data if isinstance(segment, Const) else b""
        return f"lambda n: n.end - n.data.index({bytes_literal(data)}, n.at, n.end)"

    def named(self, segment: Segment) -> str:
        """A segment's name as the careful functions know it: its kind, if it has no name and nobody asks for it."""
        name = segment.name or ""
        if name and (not name.startswith("_") or name in self.asked_for):
            return quoted(name)
        return quoted(type(segment).__name__.lower())

    @staticmethod
    def refuse(segment: Segment) -> str:
        return "" if segment.refuse is None else f", refuse={segment.refuse:#x}"

    # ---- names --------------------------------------------------------------------------------------------

    def declare(self, segments: Iterable[Segment], scope: Scope) -> None:
        """Every field of a list by `n["name"]`."""
        for segment in segments:
            for block in segment.blocks:
                self.declare(block, scope)
            match segment:
                case Bits(parts=parts):
                    for part in parts:
                        scope.entries[part.name] = Entry(f"n[{quoted(part.name)}]")
                    if segment.name:
                        scope.entries[segment.name] = Entry("0", sized=False, wire=f"n.room({quoted(segment.name)})")
                case Record(name=name, of=of):
                    inside = Scope(scope)
                    self.declare(of, inside)
                    scope.entries[name] = Entry(f"n[{quoted(name)}]", "record", inside)
                case Repeat(name=name, of=of):
                    inside = Scope(scope)
                    if isinstance(of, tuple):
                        self.declare(of, inside)
                    scope.entries[name] = Entry(f"n[{quoted(name)}]", "list", inside)
                case Inner(name=name):
                    scope.entries[name] = Entry(f"n[{quoted(name)}]", "inner")
                case Data(name=name) | Value(name=name):
                    scope.entries[name] = Entry(f"n[{quoted(name)}]")
                case Field(name=name, type=type_) | Length(name=name, type=type_) | Count(name=name, type=type_):
                    sized = type_.kind in ("ascii", "bytes")
                    entry = Entry(f"n[{quoted(name)}]", sized=sized, wire=f"n.room({quoted(name)})")
                    scope.entries[name] = entry
