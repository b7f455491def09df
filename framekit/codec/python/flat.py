"""Builders: one function for a frame and those inside it, with a keyword for every value.

Where the frames are plain, their bytes are put together at once, and whatever does not fit is left to the frame's own
encoder, which is where faults are told; else the values are handed to that encoder. Both give what it gives.
"""

from __future__ import annotations

import builtins
import re

from framekit.codec.python.encode import EncodeWriter, Given, as_bytes, tail_of
from framekit.codec.python.expressions import Scope
from framekit.codec.python.joined import counting, is_plain, names_of, renamed
from framekit.codec.python.module import Module
from framekit.codec.python.parameters import LEFT_OUT, Level, Parameters
from framekit.codec.python.registry import summary, write_docstring
from framekit.codec.python.shape import names_read
from framekit.codec.python.source import Code, Source
from framekit.definition.expression import BIT_OR, Binary, Expression, Name, Node, Number
from framekit.definition.model.frames import StaticSizes, everything, without_when
from framekit.definition.model.segments import (
    Bits,
    Check,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Fill,
    Inner,
    Length,
    Repeat,
    Require,
    Segment,
    Skip,
    Value,
)


class NotPlain(Exception):  # noqa: N818 - no error, the encoder does it then
    """Some frames cannot be built by one function without a look at nested values."""


def shown(levels: tuple[Level, ...]) -> tuple[Segment, ...]:
    """The segments of the frames, each in the place where it stands in the one before it."""
    *before, last = levels
    found = last.frame.segments
    for level in reversed(before):
        assert level.inner is not None
        found = _put_in(level.frame.segments, level.inner, found)
    return found


def _put_in(segments: tuple[Segment, ...], inner: Inner, inside: tuple[Segment, ...]) -> tuple[Segment, ...]:
    """The segments with others in the place of an inner frame."""
    found: list[Segment] = []
    for segment in segments:
        if segment is inner:
            found.extend(inside)
        else:
            found.append(segment.with_blocks(lambda block: _put_in(block, inner, inside)))
    return tuple(found)


class Together:
    """Some frames as one list of segments, and the sizes that have to come out: expression, names of what it counts.

    Raises NotPlain where they cannot be built so.
    """

    def __init__(self, shapes: StaticSizes, levels: tuple[Level, ...]) -> None:
        self.shapes = shapes
        self.sizes: list[tuple[Expression, tuple[str, ...]]] = []
        found: tuple[Segment, ...] = ()
        for level in reversed(levels):
            segments = shapes.segments(level.frame)
            found = segments if level.inner is None else self._around(segments, level.inner, found)
            if level is not levels[0]:
                found = self._inside(level, tuple(renamed(segment) for segment in found))
        self.segments = found
        if not all(_is_simple(segment) for segment in everything(found)):
            raise NotPlain

    def _inside(self, level: Level, segments: tuple[Segment, ...]) -> tuple[Segment, ...]:
        """A frame that is to stand in another one, if it may."""
        frame, most = level.frame, self.shapes.all(segments).most
        if frame.delimited or not is_plain(_as_if_there(segments)):
            raise NotPlain
        if frame.most is not None and (most is None or most > frame.most):
            raise NotPlain
        return segments

    def _around(self, segments: tuple[Segment, ...], inner: Inner, inside: tuple[Segment, ...]) -> tuple[Segment, ...]:
        around = _put_in(segments, inner, ())
        theirs, ours = names_of(inside), names_of(around) | {inner.name}
        if theirs & ours or names_read(around) & (theirs | {inner.name}):
            raise NotPlain
        if names_read(inside) & ours or inner.when is not None:
            raise NotPlain
        if any(isinstance(one, Check) and inner.name in (one.span or ()) for one in everything(around)):
            raise NotPlain
        parts = tuple(one.name for one in inside if one.name and one.takes_bytes)
        if isinstance(inner.size, int) and self.shapes.all(inside).fixed != inner.size:
            raise NotPlain
        if isinstance(inner.size, Expression) and not self._is_told(inner, inner.size, segments):
            self.sizes.append((inner.size, parts))
        return _put_in(_counting_in(segments, inner, parts), inner, inside)

    def _is_told(self, inner: Inner, size: Expression, segments: tuple[Segment, ...]) -> bool:
        """Whether a size is nothing but a length that counts the frame, less what else it counts."""
        root, less = _without_number(size.root)
        named = {one.name: one for one in segments if one.name is not None}
        length = named.get(root.name) if isinstance(root, Name) else None
        if not isinstance(length, Length) or length.unit != 1 or length.plus or inner.name not in length.of:
            return False
        others = [named[name] for name in length.of if name != inner.name and name in named]
        return len(others) == len(length.of) - 1 and self.shapes.all(others).fixed == less


def _without_number(node: Node) -> tuple[Node, int]:
    """What a number is taken from, and the number."""
    if isinstance(node, Binary) and node.operator == "-" and isinstance(node.right, Number):
        return node.left, node.right.value
    return node, 0


def _counting_in(segments: tuple[Segment, ...], inner: Inner, parts: tuple[str, ...]) -> tuple[Segment, ...]:
    """The segments, those in wraps too, with lengths and checks over the frame inside being over its segments."""
    return tuple(
        one.with_blocks(lambda block: _counting_in(block, inner, parts))
        if one.is_there_inside
        else counting(one, inner, parts)
        for one in segments
    )


def _is_simple(segment: Segment) -> bool:
    """Whether a segment has its values at hand, and holds no frame."""
    is_whole = segment.is_there_inside or isinstance(segment, Fill)
    return isinstance(segment, Check) or (is_whole and segment.when is None) or is_plain(_as_if_there((segment,)))


def _as_if_there(segments: tuple[Segment, ...]) -> tuple[Segment, ...]:
    """The segments without the conditions under which single values are there."""
    return tuple(without_when(one) if isinstance(one, _MAY_BE_ABSENT) else one for one in segments)


_MAY_BE_ABSENT = (Bits, Const, Count, Data, Field, Length, Repeat, Require, Skip)


_MOST_PACKS = 256
"""As many numbers of values in a list are prepared at most."""


def write_builder(module: Module, name: str, encoder: str, levels: tuple[Level, ...]) -> Source:
    """The source of the builder `name` of some frames; `encoder` is the name of the outermost frame's.

    The context is a name of the module.
    """
    parameters = Parameters(module, levels)
    try:
        lines = FlatWriter(module, name, parameters).lines(encoder)
    except NotPlain:
        parameters.write_call(lines := Source(), encoder)
    return _function(name, parameters, lines, "")


def write_plain_builder(
    module: Module, name: str, encoder: str, levels: tuple[Level, ...], context: str
) -> Source | None:
    """As `write_builder`, with a last parameter `context`; None where it would only hand values on to the encoder."""
    parameters = Parameters(module, levels)
    try:
        lines = FlatWriter(module, name, parameters).lines(encoder)
    except NotPlain:
        return None
    return _function(name, parameters, lines, context)


def _function(name: str, parameters: Parameters, lines: Source, context: str) -> Source:
    out, levels = Source(), parameters.levels
    keywords = [parameter.text for parameter in parameters.all]
    keywords += [context] if context else []
    header = ", ".join(["*", *keywords] if keywords else [])
    with out.block(f"def {name}({header}) -> bytes:"):
        names = [f"`{level.frame.name}`" for level in levels]
        inside = f" with {' with '.join(names[1:])} inside" if names[1:] else ""
        about = f"Build the frame {names[0]}{inside} of single values. Raises EncodeError."
        write_docstring(out, about, summary(shown(levels)), notes=parameters.notes())
        out.extend(lines)
    return out


# ---- the function -------------------------------------------------------------------------------------------


class ByKeyword(Given):
    """Values that are given as the parameters of a function."""

    def __init__(self, keywords: dict[str, str], worked_out: set[str]) -> None:
        super().__init__("", "")
        self.keywords, self.worked_out = keywords, worked_out

    def value(self, name: str) -> str:
        return self.keywords[name]

    def value_or(self, name: str, otherwise: str) -> str:
        return self.value_or_worked_out(name, otherwise) if name in self.worked_out else self.keywords[name]

    def value_or_worked_out(self, name: str, otherwise: str) -> str:
        return f"{self.value(name)} if {self.value(name)} is not {LEFT_OUT} else {otherwise}"


class FlatWriter(EncodeWriter):
    """Writes the lines that put some frames together at once.

    `most_values`: how many a list may have, by its local; with more there is nothing that packs it.
    """

    def __init__(self, module: Module, title: str, parameters: Parameters) -> None:
        self.parameters = parameters
        self.together = Together(module.shapes, parameters.levels)
        super().__init__(module, title, self.together.segments)
        self.keywords = {one.key: one.name for one in parameters.all}
        self.worked_out = {one.key for one in parameters.all if one.default == LEFT_OUT}
        words = {*module.words(), *dir(builtins), "hexlify", "unhexlify"} - {"format", "id", "type"}
        if any(name in words or name != name.lower() for name in self.keywords.values()):
            raise NotPlain
        if any(isinstance(one, Value) and one.name in self.keywords and one.build is None for one in self.segments):
            raise NotPlain
        self.most_values: dict[str, int] = {}
        self.names.reserve(self.keywords.values())
        if "frame" in self.keywords.values():
            self.buffer = self.names.fresh("frame")

    def lines(self, encoder: str) -> Source:
        """The lines of the function; `encoder` gets values that do not fit."""
        frame, segments = self.parameters.levels[0].frame, self.segments
        given, scope, out = ByKeyword(self.keywords, self.worked_out), Scope(), Source()
        self.values(segments, scope, given)
        for there, names in self.conditions_of(given):
            wrong = [f"{known} is not {LEFT_OUT}" for name in names if (known := self.keywords.get(name)) is not None]
            if wrong:
                self.refuse_if(f"(not ({there}) and ({' or '.join(wrong)}))")
        for size, names in self.together.sizes:
            self.refuse_if(f"{self.text(size, scope, BIT_OR)} != {self.room(names, scope)}")
        self.flush()
        longest = self.shapes.all(segments).most
        is_limited = frame.most is not None and (longest is None or longest > frame.most)
        if frame.most is not None and is_limited:
            is_limited = not self._limit_list(frame.most, scope)
        text = self.region(segments, scope, self.buffer, tail=tail_of(self.module, frame))
        if frame.most is not None and is_limited:
            self.limit(text, frame.most)
            text = self.buffer
        with out.block("try:"):
            out.extend(self.out)
            out.add(f"return {as_bytes(text, segments)}")
        with out.block("except MISFITS:"):
            self.parameters.write_call(out, encoder)
        return out

    def _limit_list(self, most: int, scope: Scope) -> bool:
        """Limits the frame by the number of values in the list that alone varies, if there is one."""
        longer = [one for one in self.segments if self.shapes.of(one).fixed is None]
        if len(longer) != 1 or not isinstance(longer[0], Repeat) or not isinstance(longer[0].of, FieldType):
            return False
        rest = self.shapes.all(one for one in self.segments if one is not longer[0]).fixed
        if rest is None or not longer[0].of.fixed_size:
            return False
        local, count = scope.entries[longer[0].name].text, (most - rest) // longer[0].of.fixed_size
        if count <= _MOST_PACKS and self.numbers_of(longer[0]) is not None:
            self.most_values[local] = count
        else:
            self.complain(f"{self.count_of(local)} > {count}", "", "")
        return True

    def packs(self, local: str, before: str, code: str, order: str) -> str:
        most = self.most_values.get(local)
        return self.module.list_structs(before, code, order, self.title, "values", packs=True, most=most)

    def check_names(self, given: Given) -> None:
        """Of a record, what is given beyond what is needed."""
        self.complain(self.more_than_needed(given), "", "")

    def refuse_if(self, condition: str) -> None:
        """A list is by far the most frequent where one may be given; to ask that takes half the time."""
        if (other := re.fullmatch(r"not isinstance\((\w+), \(list, tuple\)\)", condition)) is not None:
            self.complain(f"{self.is_other(other[1], 'list')} and {condition}", "", "")
        else:
            super().refuse_if(condition)

    def is_other(self, local: str, type_: str) -> str:
        """A parameter that is called `type` hides what tells the types of the others."""
        return (
            f"{local}.__class__ is not {type_}" if "type" in self.keywords.values() else super().is_other(local, type_)
        )

    def is_measured(self, name: str) -> bool:
        return super().is_measured(name) or any(name in names for _, names in self.together.sizes)

    def no_bytes(self, local: str) -> None:
        self.complain(f"{self.is_other(local, 'bytes')} and {self.is_other(local, 'bytearray')}", "", "")

    def local(self, name: str, given: Given) -> str:
        known = self.keywords.get(name) if isinstance(given, ByKeyword) else None
        return self.names.fresh(name) if known is None or name in self.worked_out else known

    def bind(self, local: str, text: str) -> None:
        if local != text:
            super().bind(local, text)

    @staticmethod
    def with_missing(scope: Scope, given: Given, missing: set[str]) -> Scope:
        if missing:
            raise NotPlain
        return scope

    def complain(self, condition: str, field: str, message: str) -> None:
        self.module.function("Misfit")
        with self.out.block(f"if {condition}:"):
            self.add("raise Misfit")

    def compare_size(self, path: tuple[str | Code, ...], found: str, wanted: str, conditions: list[str]) -> None:
        self.complain(" and ".join([*conditions, f"{found} != {wanted}"]), "", "")
