"""What measuring functions are written with: places that count from `start`, wants, texts of sizes."""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python.expressions import Entry, ExpressionWriter, Scope, may_be_negative, may_fail
from framekit.codec.python.module import Module
from framekit.codec.python.names import Names
from framekit.codec.python.places import Place
from framekit.codec.python.source import Source
from framekit.definition.expression.emit import SUM
from framekit.definition.expression.syntax import Attribute, Expression, names_in, walk
from framekit.definition.model.segments import (
    Bits,
    Choose,
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
from framekit.definition.model.walk import everything, flat

Pairs = tuple[tuple[Segment, Scope], ...]
"""Segments with the scopes their names belong to."""


class Finished(Exception):  # noqa: N818 - a way out, no error
    """The rest of the function is written: nothing behind matters for the length, or it cannot be told."""


class Measuring:
    """State of a measuring function. `place` counts from `start` as long as that is fixed, then it is in `at`."""

    def __init__(self, module: Module, segments: tuple[Segment, ...], most: int) -> None:
        self.module = module
        self.shapes = module.shapes
        self.segments = segments
        self.most = most
        self.out = Source()
        self.names = Names(module.words())
        self.hoisted: dict[str, str] = {}
        self.may_fail = False
        self.place = Place("start", 0)
        self.sure = 0
        self.needed = needed_names(segments)
        self.by_name = {segment.name: segment for segment in everything(segments) if segment.name}
        self.maybe_absent: set[str] = set()
        self.in_list = False
        self.looks_for_end = False

    def add(self, text: str) -> None:
        self.out.add(text)

    def pairs(self, segments: tuple[Segment, ...], scope: Scope) -> Pairs:
        """The segments with those of records."""
        found: list[tuple[Segment, Scope]] = []
        for segment in segments:
            if isinstance(segment, Record) and segment.when is None:
                found.extend(self.pairs(segment.of, self._inside(segment, scope)))
            else:
                found.append((segment, scope))
        return tuple(found)

    @staticmethod
    def _inside(record: Record, scope: Scope) -> Scope:
        """The names of a record; two cases with a record of one name share them."""
        known = scope.entries.get(record.name)
        inside = Scope(scope) if known is None or known.inside is None else known.inside
        scope.entries[record.name] = Entry(record.name, "record", inside, direct=True)
        return inside

    def absent(self, segments: Iterable[Segment], scope: Scope) -> None:
        """Gives names that something else depends on no value, as long as nothing has been read that has them."""
        for segment in flat(segments):
            if isinstance(segment, Record):
                self.absent(segment.of, self._inside(segment, scope))
                continue
            for name in segment.value_names:
                if name in self.needed:
                    self.maybe_absent.add(name)
                    self.set_value(name, scope, "None")

    # ---- texts --------------------------------------------------------------------------------------------

    def context(self, name: str) -> str:
        """The local that holds a context value; it is fetched once, before anything is read."""
        if name not in self.hoisted:
            self.module.context.add(self.module.known(name, self.by_name))
            self.hoisted[name] = self.names.fresh(name)
        return self.hoisted[name]

    def text(self, expression: Expression, scope: Scope, level: int = 0) -> str:
        """Text of an expression; if it can fail, the function will say that the end is lost then."""
        if may_fail(expression.root) or _names_of(expression) & self.maybe_absent:
            self.may_fail = True
        return ExpressionWriter(self.module, scope, self.context).text(expression, level)

    def size_text(self, expression: Expression, scope: Scope, level: int = SUM) -> str:
        """Text of a size that is not negative. Below 0 without any field of the frame, the frame fits nothing."""
        text = self.text(expression, scope, level)
        if not may_be_negative(expression.root):
            return text
        local = self.names.fresh("length")
        self.add(f"{local} = {self.text(expression, scope)}")
        by_fields = any(scope.find(name) is not None for name in names_in(expression.root))
        with self.out.block(f"if {local} < 0:"):
            self.add("return LOST" if by_fields else "return 0")
        return local

    def set_value(self, name: str, scope: Scope, text: str) -> str:
        """Gives a name its value in a local."""
        local = scope.entries[name].text if name in scope.entries else self.names.fresh(name)
        scope.entries[name] = Entry(local)
        self.add(f"{local} = {text}")
        return local

    # ---- places and wants ---------------------------------------------------------------------------------

    def least(self, after: Pairs) -> int:
        """The fewest bytes that segments take."""
        return sum(self.shapes.of(segment).least for segment, _ in after)

    def want(self, size: int, after: Pairs) -> None:
        """Goes on only if `size` more bytes are there; else says how many are wanted at least."""
        least = size + self.least(after)
        if self.place.base == "start":
            wanted = self.place.offset + size
            if wanted > self.sure:
                self.sure = wanted
                with self.out.block(f"if end - start < {wanted}:"):
                    self.add(f"return end - start - {self.place.offset + least}")
            return
        place = self.place.text("")
        with self.out.block(f"if end < {place} + {size}:"):
            self.add(f"return end - {place} - {least}" if " " not in place else f"return end - ({place}) - {least}")

    def want_until(self, local: str, after: Pairs) -> None:
        """Goes on only if the bytes up to the place `local` are there."""
        least = self.least(after)
        behind = f" + {least}" if least else ""
        with self.out.block(f"if end < {local}:"):
            back = f" - {least}" if least else ""
            self.add(f"return end - {local}{back} if {local} - start{behind} <= {self.most} else LOST")

    def advance(self, text: str) -> None:
        if text != "at":
            further = text.removeprefix("at + ")
            self.add(f"at = {text}" if further == text else f"at += {further}")
        self.place = Place("at", 0)

    def settle(self) -> None:
        """Puts the place into its local."""
        if self.place != Place("at", 0):
            self.advance(self.place.text(""))

    def skip(self, size: str) -> None:
        """Moves on by a size that needs no look at the bytes."""
        if size.isdigit():
            self.place = self.place.plus(int(size))
        else:
            self.advance(f"{self.place.text('')} + {size}")

    def resume(self, after: Pairs, overlap: int = 0) -> str | None:
        """Text of the place a search goes on at; None if it must begin anew.

        An earlier call may have found the end and wanted what follows it, so that much is looked through again.
        """
        most = self.shapes.all(segment for segment, _ in after).most
        if most is None or self.in_list:
            return None
        return f"start + seen - {most + overlap}" if most + overlap else "start + seen"

    def search(self, what: str, place: str, after: Pairs, overlap: int = 0) -> str:
        """Text of the place of some bytes from `place` on, -1 if they are not there."""
        resume = self.resume(after, overlap)
        return f"data.find({what}, {place if resume is None else f'max({place}, {resume})'}, end)"

    def not_found(self, least: int) -> None:
        """What to say when an end is not there yet; `least` bytes come with it."""
        self.add(f"return -{least} if end - start + {least} <= {self.most} else LOST")

    def return_total(self) -> None:
        """The frame ends at the present place."""
        if self.place.base == "start":
            total = str(self.place.offset)
            self.add(f"return {total} if end - start >= {total} else end - start - {total}")
            return
        self.add(f"size = {self.place.text('')} - start")
        longest = self.shapes.all(self.segments).most
        if self.looks_for_end or longest is None or longest > self.most:
            with self.out.block(f"if size > {self.most}:"):
                self.add("return LOST")
        self.add("return size if size <= end - start else end - start - size")


def _names_of(expression: Expression) -> set[str]:
    """Every name in an expression, those of fields of records too."""
    fields = {node.name for node in walk(expression.root) if isinstance(node, Attribute)}
    return names_in(expression.root) | fields


def needed_names(segments: tuple[Segment, ...]) -> set[str]:
    """Names that sizes, counts and conditions depend on, and those these depend on."""
    found: set[str] = set()
    values: dict[str, set[str]] = {}
    records = {segment.name for segment in everything(segments) if isinstance(segment, Record)}
    for segment in everything(segments):
        if isinstance(segment, Value):
            values[segment.name] = _names_of(segment.read)
        if isinstance(segment, Field) and segment.default is not None and segment.when is not None:
            values[segment.name] = _names_of(segment.default)
        for expression in size_expressions(segment):
            found |= names_in(expression.root)
            if records & names_in(expression.root):
                found |= _names_of(expression)
    known: set[str] = set()
    while found - known:
        name = min(found - known)
        known.add(name)
        found |= values.get(name, set())
    return found


def size_expressions(segment: Segment) -> list[Expression]:
    """What decides about the size of a segment."""
    found: list[object] = [segment.when]
    match segment:
        case Data(size=size) | Inner(size=size):
            found.append(size)
        case Field(type=type_) | Bits(type=type_) | Length(type=type_) | Count(type=type_):
            found.append(type_.size)
        case Repeat(times=times):
            found.append(times)
        case Choose(on=on):
            found.append(on)
    return [expression for expression in found if isinstance(expression, Expression)]
