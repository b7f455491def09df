"""Write builders: one function for a frame and its inner frames, with a keyword for every value.

If the frames are plain, their bytes are packed at once; values that do not fit are passed to the frame's own encoder,
which reports faults. Otherwise all values are passed to that encoder. Both return the encoder's result.
"""

from __future__ import annotations

import builtins
import keyword
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from framekit.codec.python import forms
from framekit.codec.python.decode import counting, is_plain, names_of, renamed
from framekit.codec.python.encode import ConsumedValues, EncodeWriter, as_bytes, tail_of, texts_inside
from framekit.codec.python.expressions import ExpressionWriter, FieldScope, default_text
from framekit.codec.python.facts import is_fixed
from framekit.codec.python.module import Module
from framekit.codec.python.registry import kind_of, summary, write_docstring
from framekit.codec.python.source import Code, Source, identifier, literal, quoted
from framekit.definition.expression import BIT_OR, Binary, Bytes, Expression, Name, Node, Number, Text, names_in
from framekit.definition.model.frames import Frame, StaticSizes, certain, everything, flat, names_read, without_when
from framekit.definition.model.segments import (
    Bits,
    BitsPart,
    Check,
    Data,
    Field,
    FieldType,
    Fill,
    Inner,
    Length,
    Nested,
    Repeat,
    Segment,
    Value,
    lack_default,
)
from framekit.definition.times import format_time


class NotPlain(Exception):  # noqa: N818 - not an error: the encoder is used instead
    """Raised for frames that a single function cannot build without reading nested values."""


def shown(levels: tuple[NestingLevel, ...]) -> tuple[Segment, ...]:
    """Return the segments of nested frames, each frame's segments in place of the inner frame around them."""
    *before, last = levels
    found = last.frame.segments
    for level in reversed(before):
        assert level.inner is not None
        found = _put_in(level.frame.segments, level.inner, found)
    return found


def _put_in(segments: tuple[Segment, ...], inner: Inner, inside: tuple[Segment, ...]) -> tuple[Segment, ...]:
    """Return the segments with an inner frame replaced by other segments."""
    found: list[Segment] = []
    for segment in segments:
        if segment is inner:
            found.extend(inside)
        else:
            found.append(segment.with_blocks(lambda block: _put_in(block, inner, inside)))
    return tuple(found)


class FusedFrames:
    """Nested frames as one list of segments. Raises NotPlain if they cannot be built together."""

    def __init__(self, static: StaticSizes, levels: tuple[NestingLevel, ...]) -> None:
        self.static = static
        self.sizes: list[tuple[Expression, tuple[str, ...]]] = []
        """The sizes to compare: expression, and names of the segments that it counts."""
        found: tuple[Segment, ...] = ()
        for level in reversed(levels):
            segments = static.segments(level.frame)
            found = segments if level.inner is None else self._around(segments, level.inner, found)
            if level is not levels[0]:
                found = self._inside(level, tuple(renamed(segment) for segment in found))
        self.segments = found
        if not all(_is_simple(segment) for segment in everything(found)):
            raise NotPlain

    def _inside(self, level: NestingLevel, segments: tuple[Segment, ...]) -> tuple[Segment, ...]:
        """Return the segments of an inner frame, or raise NotPlain if it cannot be fused."""
        frame, most = level.frame, self.static.all(segments).most
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
        if any(isinstance(one, Check) and inner.name in one.edges for one in everything(around)):
            raise NotPlain
        parts = tuple(one.name for one in inside if one.name and one.takes_bytes)
        if isinstance(inner.size, int) and self.static.all(inside).fixed != inner.size:
            raise NotPlain
        if isinstance(inner.size, Expression) and not self._is_told(inner, inner.size, segments):
            self.sizes.append((inner.size, parts))
        return _put_in(_counting_in(segments, inner, parts), inner, inside)

    def _is_told(self, inner: Inner, size: Expression, segments: tuple[Segment, ...]) -> bool:
        """Return whether the size of the inner frame follows from a length over it and other segments of fixed size."""
        root, less = _without_number(size.root)
        named = {one.name: one for one in segments if one.name is not None}
        length = named.get(root.name) if isinstance(root, Name) else None
        if not isinstance(length, Length) or length.unit != 1 or length.plus or inner.name not in length.of:
            return False
        others = [named[name] for name in length.of if name != inner.name and name in named]
        return len(others) == len(length.of) - 1 and self.static.all(others).fixed == less


def _without_number(node: Node) -> tuple[Node, int]:
    """Return the minuend of a subtraction of a number, and the number; the node itself and 0 for other nodes."""
    if isinstance(node, Binary) and node.operator == "-" and isinstance(node.right, Number):
        return node.left, node.right.value
    return node, 0


def _counting_in(segments: tuple[Segment, ...], inner: Inner, parts: tuple[str, ...]) -> tuple[Segment, ...]:
    """Return the segments, with lengths and checks over the inner frame applied to its segments, in wraps too."""
    return tuple(
        one.with_blocks(lambda block: _counting_in(block, inner, parts))
        if one.is_there_inside
        else counting(one, inner, parts)
        for one in segments
    )


def _is_simple(segment: Segment) -> bool:
    """Return whether a segment takes its values directly from the keywords and holds no frame."""
    is_whole = segment.is_there_inside or isinstance(segment, Fill)
    return isinstance(segment, Check) or (is_whole and segment.when is None) or is_plain(_as_if_there((segment,)))


def _as_if_there(segments: tuple[Segment, ...]) -> tuple[Segment, ...]:
    """Return the segments without the conditions of single values."""
    return tuple(without_when(one) if kind_of(one).may_be_absent else one for one in segments)


_MOST_PACKS = 256
"""Limit of the list sizes for which packers are prepared."""


def write_builder(module: Module, name: str, encoder: str, levels: tuple[NestingLevel, ...]) -> Source:
    """Return the source of the builder `name` of nested frames; `encoder` is the name of the outermost frame's encoder.

    The context is a name of the module.
    """
    parameters = Parameters(module, levels)
    try:
        lines = FlatWriter(module, name, parameters).lines(encoder)
    except NotPlain:
        parameters.write_call(lines := Source(), encoder)
    return _function(name, parameters, lines, "")


def write_plain_builder(
    module: Module, name: str, encoder: str, levels: tuple[NestingLevel, ...], context: str
) -> Source | None:
    """Return a builder as `write_builder`, with `context` as last parameter; None if it would only call the encoder."""
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


class ByKeyword(ConsumedValues):
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
    """Write the lines that build nested frames directly."""

    def __init__(self, module: Module, title: str, parameters: Parameters) -> None:
        self.parameters = parameters
        self.fused = FusedFrames(module.static, parameters.levels)
        super().__init__(module, title, self.fused.segments)
        self.keywords = {one.key: one.name for one in parameters.all}
        self.worked_out = {one.key for one in parameters.all if one.default == LEFT_OUT}
        words = {*module.words(), *dir(builtins), "hexlify", "unhexlify"} - {"format", "id", "type"}
        if any(name in words or name != name.lower() for name in self.keywords.values()):
            raise NotPlain
        if texts_inside(self.segments):  # such texts are read back from the finished frame
            raise NotPlain
        if any(isinstance(one, Value) and one.name in self.keywords and one.build is None for one in self.segments):
            raise NotPlain
        self.most_values: dict[str, int] = {}
        """Limit of the number of values in a list, by its local; a longer list has no packer."""
        self.names.reserve(self.keywords.values())
        if "frame" in self.keywords.values():
            self.buffer = self.names.fresh("frame")

    def lines(self, encoder: str) -> Source:
        """Return the lines of the function; `encoder` is called for values that do not fit."""
        frame, segments = self.parameters.levels[0].frame, self.segments
        given, scope, out = ByKeyword(self.keywords, self.worked_out), FieldScope(), Source()
        self.values(segments, scope, given)
        for there, names in self.conditions_of(given):
            wrong = [f"{known} is not {LEFT_OUT}" for name in names if (known := self.keywords.get(name)) is not None]
            if wrong:
                self.refuse_if(f"(not ({there}) and ({' or '.join(wrong)}))")
        for size, names in self.fused.sizes:
            self.refuse_if(f"{self.text(size, scope, BIT_OR)} != {self.room(names, scope)}")
        self.flush()
        longest = self.static.all(segments).most
        is_limited = frame.most is not None and (longest is None or longest > frame.most)
        if frame.most is not None and is_limited:
            is_limited = not self._limit_list(frame.most, scope)
        text = self.region(segments, scope, self.buffer, tail=tail_of(self.module, frame), is_whole=True)
        if frame.most is not None and is_limited:
            self.limit(text, frame.most)
            text = self.buffer
        with out.block("try:"):
            out.extend(self.out)
            out.add(f"return {as_bytes(text, segments)}")
        with out.block("except MISMATCHES:"):
            self.parameters.write_call(out, encoder)
        return out

    def _limit_list(self, most: int, scope: FieldScope) -> bool:
        """Limit the frame size by the number of values in a list, if only that list varies; return whether it does."""
        longer = [one for one in self.segments if self.static.of(one).fixed is None]
        if len(longer) != 1 or not isinstance(longer[0], Repeat) or not isinstance(longer[0].of, FieldType):
            return False
        rest = self.static.all(one for one in self.segments if one is not longer[0]).fixed
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

    def check_names(self, given: ConsumedValues) -> None:
        """Write the refusal of a record with values beyond the required ones."""
        self.complain(self.more_than_needed(given), "", "")

    def refuse_if(self, condition: str) -> None:
        """Refuse the values if `condition` holds.

        The test for lists first tests for exactly `list`, in half the time.
        """
        if (other := re.fullmatch(r"not isinstance\((\w+), \(list, tuple\)\)", condition)) is not None:
            self.complain(f"{self.is_other(other[1], 'list')} and {condition}", "", "")
        else:
            super().refuse_if(condition)

    def is_other(self, local: str, type_: str) -> str:
        """Return the type test without calling `type` if a parameter has that name."""
        return (
            f"{local}.__class__ is not {type_}" if "type" in self.keywords.values() else super().is_other(local, type_)
        )

    def is_measured(self, name: str) -> bool:
        return super().is_measured(name) or any(name in names for _, names in self.fused.sizes)

    def no_bytes(self, local: str) -> None:
        self.complain(f"{self.is_other(local, 'bytes')} and {self.is_other(local, 'bytearray')}", "", "")

    def local(self, name: str, given: ConsumedValues) -> str:
        known = self.keywords.get(name) if isinstance(given, ByKeyword) else None
        return self.names.fresh(name) if known is None or name in self.worked_out else known

    def bind(self, local: str, text: str) -> None:
        if local != text:
            super().bind(local, text)

    @staticmethod
    def with_missing(scope: FieldScope, given: ConsumedValues, missing: set[str]) -> FieldScope:
        if missing:
            raise NotPlain
        return scope

    def complain(self, condition: str, field: str, message: str) -> None:
        self.module.function("Mismatch")
        with self.out.block(f"if {condition}:"):
            self.add("raise Mismatch")

    def compare_size(self, path: tuple[str | Code, ...], found: str, wanted: str, conditions: list[str]) -> None:
        self.complain(" and ".join([*conditions, f"{found} != {wanted}"]), "", "")


# ---- keyword parameters ---------------------------------------------------------------------------------------

LEFT_OUT = "None"
"""The default of values that may be omitted and are computed then."""
_MOST_NAMED = 8
"""Limit of the names of numbers in a note."""
_LONG = 60
"""A source longer than this gets a line of its own."""
_OWN_NAMES = ("ctx", "without_none")
"""Names that builders use themselves."""


@dataclass(frozen=True, slots=True)
class Keyword:
    """A keyword parameter of a builder."""

    name: str
    key: str
    """Its name among the values of the frame."""
    depth: int
    """The nesting depth of the frame."""
    default: str | None
    """The source of the default; None for a required value."""
    annotation: str
    note: str = ""
    """Further explanation for the docstring."""

    @property
    def text(self) -> str:
        """Return the parameter as in the header of a function."""
        if self.default is None:
            return f"{self.name}: {self.annotation}"
        optional = f" | {LEFT_OUT}" if self.default == LEFT_OUT and self.annotation != "Any" else ""
        return f"{self.name}: {self.annotation}{optional} = {self.default}"


@dataclass(frozen=True, slots=True)
class NestingLevel:
    """A frame of a builder, and the segment that holds the next frame; None for the last."""

    frame: Frame
    inner: Inner | None


def inner_frames(frame: Frame) -> dict[str, Inner]:
    """Return the frames that a frame may contain, each with the first segment that may hold it."""
    found: dict[str, Inner] = {}
    for segment in flat(frame.segments):
        if isinstance(segment, Inner):
            for name in segment.frames:
                found.setdefault(name, segment)
    return found


def levels_of(frames: Mapping[str, Frame], names: Iterable[str]) -> tuple[NestingLevel, ...]:
    """Return the frames of these names, each inside the previous one. Raises KeyError if a frame cannot be inside."""
    first, *others = names
    found, frame = list[NestingLevel](), frames[first]
    for name in others:
        found.append(NestingLevel(frame, inner_frames(frame)[name]))
        frame = frames[name]
    return (*found, NestingLevel(frame, None))


def rows_of(frames: Mapping[str, Frame], *names: str) -> Iterator[tuple[NestingLevel, ...]]:
    """Yield all rows of nested frames that begin with these names, down to a frame without inner frames."""
    inside = inner_frames(frames[names[-1]])
    if not inside:
        yield levels_of(frames, names)
    for name in inside:
        if name not in names:
            yield from rows_of(frames, *names, name)


class Parameters:
    """The parameters of the builder of nested frames, in frame order."""

    def __init__(self, module: Module, levels: tuple[NestingLevel, ...]) -> None:
        self._module = module
        self.levels = levels
        given = list(self._at(0))
        self.all = tuple(self._named(given))
        self.names = {(one.depth, one.key): one.name for one in self.all}

    def _at(self, depth: int) -> Iterator[Keyword]:
        level = self.levels[depth]
        segments, seen = level.frame.segments, set[str]()
        for segment, is_certain in certain(segments):
            if segment is level.inner:
                yield from self._at(depth + 1)
            for one in self._of(segment, is_certain and segment.when is None, segments):
                if one.key not in seen:  # cases of a choice may share a name
                    seen.add(one.key)
                    yield replace(one, depth=depth)

    def _named(self, given: list[Keyword]) -> Iterator[Keyword]:
        """Yield the parameters with unique names.

        A name that several frames have belongs to the outermost frame; the others are prefixed with the name of their
        frame.
        """
        outermost: dict[str, int] = {}
        for one in given:
            outermost[one.key] = min(one.depth, outermost.get(one.key, one.depth))
        taken = Counter[str]()
        for one in given:
            wanted = one.key if one.depth == outermost[one.key] else f"{self.levels[one.depth].frame.name}_{one.key}"
            name = wanted if wanted.isidentifier() else identifier(wanted)
            name += "_" * name.startswith("encode_")
            while keyword.iskeyword(name) or name in _OWN_NAMES or taken[name]:
                name += "_"
            taken[name] += 1
            yield replace(one, name=name)

    # ---- values -------------------------------------------------------------------------------------------

    def _of(self, segment: Segment, is_certain: bool, segments: tuple[Segment, ...]) -> Iterator[Keyword]:
        match segment:
            case Field(name=name, is_=None) if not is_fixed(segment):
                default = self._default_of(segment) if is_certain else LEFT_OUT
                annotation = _type(segment.type) if segment.values is None else "int | str"
                yield Keyword("", name, 0, default, annotation, _note_of(segment))
            case Bits():
                yield from self._of_bits(segment, is_certain)
            case Data(name=name, pad=pad):
                default = LEFT_OUT if not is_certain else None if pad is None else 'b""'
                yield Keyword("", name, 0, default, "bytes", segment.doc)
            case Repeat(name=name, plain_type=of):
                item = "Any" if of is None else _type(of)
                default = None if is_certain else LEFT_OUT
                yield Keyword("", name, 0, default, f"list[{item}] | tuple[{item}, ...]", segment.doc)
            case Segment(is_record=True):
                default = None if is_certain and lack_default(segment.members) else LEFT_OUT
                yield Keyword("", segment.value_names[0], 0, default, "Mapping[str, Any]", segment.doc)
            case Inner(name=name) if all(segment is not level.inner for level in self.levels):
                default = None if is_certain else LEFT_OUT
                yield Keyword("", name, 0, default, "Mapping[str, Any]", "one frame as {name: values}")
            case Nested(name=name):
                yield Keyword("", name, 0, LEFT_OUT, "Mapping[str, Any]", segment.doc)
            case Value(name=name) if segment.build is not None or _is_given(name, segments):
                yield Keyword("", name, 0, LEFT_OUT, "Any", segment.doc)

    def _of_bits(self, bits: Bits, is_certain: bool) -> Iterator[Keyword]:
        for part in bits.parts:
            if part.is_ is None and (part.constants is None or len(part.constants) > 1):
                default = self._default_of_bits(part) if is_certain else LEFT_OUT
                annotation = "int" if part.values is None else "int | str"
                yield Keyword("", part.name, 0, default, annotation, _names(part.values))

    def _default_of(self, item: Field) -> str | None:
        if item.constants is not None:
            return literal(item.constants[0])
        expression = item.build or item.default
        if expression is None:
            return None
        return default_text(text, item) if (text := self._constant(expression)) != LEFT_OUT else text

    def _default_of_bits(self, part: BitsPart) -> str:
        if part.build is None:
            return str(0 if part.constants is None else part.constants[0])
        return self._constant(part.build) if isinstance(part.build.root, Number) else LEFT_OUT

    def _constant(self, expression: Expression) -> str:
        if not isinstance(expression.root, (Number, Text, Bytes)):
            return LEFT_OUT
        return ExpressionWriter(self._module, FieldScope(), self._module.given).value(expression)

    # ---- texts --------------------------------------------------------------------------------------------

    def write_call(self, out: Source, encoder: str) -> None:
        """Write the call of an encoder with the nested values."""
        text, local = "", "inside"
        while any(one.name == local for one in self.all):
            local += "_"
        for depth, level in reversed(list(enumerate(self.levels))):
            if len(text) > _LONG:
                out.add(f"{local} = {text}")
                text = local
            inside = "" if level.inner is None else f"{{{quoted(self.levels[depth + 1].frame.name)}: {text}}}"
            text = self._values(depth, inside)
        out.add(f"return {encoder}({text}, ctx)")

    def _values(self, depth: int, inside: str) -> str:
        """Return the source of the values of a frame."""
        inner, always, perhaps = self.levels[depth].inner, list[str](), list[str]()
        for one in self.all:
            if one.depth == depth:
                (perhaps if one.default == LEFT_OUT else always).append(f"{quoted(one.key)}: {one.name}")
        if inner is not None:
            always.append(f"{quoted(inner.name)}: {inside}")
        if perhaps:
            always.append(f"**{self._module.function('without_none')}({{{', '.join(perhaps)}}})")
        return f"{{{', '.join(always)}}}"

    def notes(self) -> list[str]:
        """Return a line for every parameter with a note."""
        return [f"`{one.name}`: {one.note}" for one in self.all if one.note]


def _is_given(name: str, segments: tuple[Segment, ...]) -> bool:
    """Return whether another value is built from a computed value, which may therefore be given."""
    expressions: list[Expression | None] = []
    for segment in everything(segments):
        if isinstance(segment, Field):
            expressions += [segment.is_, segment.build, segment.default]
        elif isinstance(segment, Bits):
            expressions += [one for part in segment.parts for one in (part.is_, part.build)]
        elif isinstance(segment, Value):
            expressions.append(segment.build)
    return any(expression is not None and name in names_in(expression.root) for expression in expressions)


def _type(type_: FieldType) -> str:
    return {"ascii": "str", "bytes": "bytes", "float": "float"}.get(type_.kind, "int")


def _note_of(item: Field) -> str:
    """Return the documentation of a field, and its allowed values if its type does not define them."""
    parts = [item.doc] if item.doc else []
    if item.values is not None:
        parts.append(_names(item.values))
    elif item.constants is not None:
        parts.append(f"one of {', '.join(str(one) for one in item.constants)}")
    elif item.unit is not None:
        parts.append(f"whole nanoseconds, a multiple of {format_time(item.unit)}")
    elif item.limits is not None or item.zero_means is not None or item.plus:
        limits = forms.value_range(item)
        parts.append(f"at least {limits.least}" if limits.most is None else f"{limits.least}..{limits.most}")
    return "; ".join(parts)


def _names(values: Mapping[int, str] | None) -> str:
    if values is None:
        return ""
    shown = [f"{number} ({name})" for number, name in list(values.items())[:_MOST_NAMED]]
    return ", ".join([*shown, "…"] if len(values) > _MOST_NAMED else shown)
