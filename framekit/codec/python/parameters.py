"""The keyword parameters of a builder: what a caller gives of a frame and of those inside it, each by one name.

Which names they get, which may be left out, what is said of them, and the nested values they stand for. How bytes are
made of them is not known here.
"""

from __future__ import annotations

import keyword
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from framekit.codec.python import forms
from framekit.codec.python.expressions import ExpressionWriter, Scope, default_text
from framekit.codec.python.module import Module
from framekit.codec.python.source import Source, identifier, literal, quoted
from framekit.definition.expression import Bytes, Expression, Number, Text, names_in
from framekit.definition.model.frames import Frame, certain, everything, flat
from framekit.definition.model.segments import (
    Bits,
    BitsPart,
    Data,
    Field,
    FieldType,
    Inner,
    Repeat,
    Segment,
    Value,
    lack_default,
)
from framekit.definition.times import format_time

LEFT_OUT = "None"
"""The default of what may be left out, and is worked out then."""
_MOST_NAMED = 8
_LONG = 60
"""A text longer than this gets a line of its own."""
_OWN_NAMES = ("ctx", "without_none")


@dataclass(frozen=True, slots=True)
class Keyword:
    """`name` is the keyword, `key` the name among the values of the frame at that `depth`.

    `default`: its text, None where a value has to be given. `note`: what else is to be said of it, in words.
    """

    name: str
    key: str
    depth: int
    default: str | None
    annotation: str
    note: str = ""

    @property
    def text(self) -> str:
        """As it stands in the header of a function."""
        if self.default is None:
            return f"{self.name}: {self.annotation}"
        optional = f" | {LEFT_OUT}" if self.default == LEFT_OUT and self.annotation != "Any" else ""
        return f"{self.name}: {self.annotation}{optional} = {self.default}"


@dataclass(frozen=True, slots=True)
class Level:
    """A frame of a builder, and the place in it where the next one stands; None for the last."""

    frame: Frame
    inner: Inner | None


def inner_frames(frame: Frame) -> dict[str, Inner]:
    """The frames that may stand in a frame, with their places; the first place, where there are several."""
    found: dict[str, Inner] = {}
    for segment in flat(frame.segments):
        if isinstance(segment, Inner):
            for name in segment.frames:
                found.setdefault(name, segment)
    return found


def levels_of(frames: Mapping[str, Frame], names: Iterable[str]) -> tuple[Level, ...]:
    """The frames of these names, each inside the one before it. Raises KeyError where one is not."""
    first, *others = names
    found, frame = list[Level](), frames[first]
    for name in others:
        found.append(Level(frame, inner_frames(frame)[name]))
        frame = frames[name]
    return (*found, Level(frame, None))


def rows_of(frames: Mapping[str, Frame], *names: str) -> Iterator[tuple[Level, ...]]:
    """The rows of frames, each inside the one before it, that begin like this, up to one in which none stands."""
    inside = inner_frames(frames[names[-1]])
    if not inside:
        yield levels_of(frames, names)
    for name in inside:
        if name not in names:
            yield from rows_of(frames, *names, name)


class Parameters:
    """The parameters of the builder of some frames, in the order of their values in the frame."""

    def __init__(self, module: Module, levels: tuple[Level, ...]) -> None:
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
        """A name that several frames have is the outermost one's; in the others the frame's name stands before it."""
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
            case Field(name=name, is_=None, constants=constants) if constants is None or len(constants) > 1:
                default = self._default_of(segment) if is_certain else LEFT_OUT
                yield Keyword("", name, 0, default, _type_of(segment), _note_of(segment))
            case Bits(parts=parts):
                for part in parts:
                    if part.is_ is None and (part.constants is None or len(part.constants) > 1):
                        default = self._default_of_bits(part) if is_certain else LEFT_OUT
                        annotation = "int" if part.values is None else "int | str"
                        yield Keyword("", part.name, 0, default, annotation, _names(part.values))
            case Data(name=name, pad=pad):
                default = LEFT_OUT if not is_certain else None if pad is None else 'b""'
                yield Keyword("", name, 0, default, "bytes", segment.doc)
            case Repeat(name=name, of=of):
                item = _type(of) if isinstance(of, FieldType) else "Any"
                default = None if is_certain else LEFT_OUT
                yield Keyword("", name, 0, default, f"list[{item}] | tuple[{item}, ...]", segment.doc)
            case Segment(is_record=True):
                default = None if is_certain and lack_default(segment.members) else LEFT_OUT
                yield Keyword("", segment.value_names[0], 0, default, "Mapping[str, Any]", segment.doc)
            case Inner(name=name) if all(segment is not level.inner for level in self.levels):
                default = None if is_certain else LEFT_OUT
                yield Keyword("", name, 0, default, "Mapping[str, Any]", "one frame as {name: values}")
            case Value(name=name) if segment.build is not None or _is_given(name, segments):
                yield Keyword("", name, 0, LEFT_OUT, "Any", segment.doc)

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
        return ExpressionWriter(self._module, Scope(), self._module.given).value(expression)

    # ---- texts --------------------------------------------------------------------------------------------

    def write_call(self, out: Source, encoder: str) -> None:
        """Writes what gives the result of an encoder, which takes nested values."""
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
        """Text of the values of one frame."""
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
        """A line for every parameter of which there is more to say."""
        return [f"`{one.name}`: {one.note}" for one in self.all if one.note]


def _is_given(name: str, segments: tuple[Segment, ...]) -> bool:
    """Whether something is built from a value that is otherwise worked out: then it may be given."""
    expressions: list[Expression | None] = []
    for segment in everything(segments):
        if isinstance(segment, Field):
            expressions += [segment.is_, segment.build, segment.default]
        elif isinstance(segment, Bits):
            expressions += [one for part in segment.parts for one in (part.is_, part.build)]
        elif isinstance(segment, Value):
            expressions.append(segment.build)
    return any(expression is not None and name in names_in(expression.root) for expression in expressions)


def _type_of(item: Field) -> str:
    return _type(item.type) if item.values is None else "int | str"


def _type(type_: FieldType) -> str:
    return {"ascii": "str", "bytes": "bytes", "float": "float"}.get(type_.kind, "int")


def _note_of(item: Field) -> str:
    """What values a field may have, where its type does not say it, and what it is for."""
    parts = [item.doc] if item.doc else []
    if item.values is not None:
        parts.append(_names(item.values))
    elif item.constants is not None:
        parts.append(f"one of {', '.join(str(one) for one in item.constants)}")
    elif item.unit is not None:
        parts.append(f"whole nanoseconds, a multiple of {format_time(item.unit)}")
    elif item.limits is not None or item.zero_means is not None or item.plus:
        limits = forms.value_range(item)
        parts.append(f"{limits.least}..{limits.most}")
    return "; ".join(parts)


def _names(values: Mapping[int, str] | None) -> str:
    if values is None:
        return ""
    shown = [f"{number} ({name})" for number, name in list(values.items())[:_MOST_NAMED]]
    return ", ".join([*shown, "…"] if len(values) > _MOST_NAMED else shown)
