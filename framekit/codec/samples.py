"""Sample values of frames, made from the model: the same ones at every run.

Values respect types, ranges, tables, sizes, `where` and conditions as far as these are plain; what does not come
together is refused by the encoder, and another try is made. Computed things are left out.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

from framekit.codec import support
from framekit.codec.codec import Codec
from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName, evaluate
from framekit.codec.python.registry import kind_of
from framekit.definition.expression import (
    Call,
    Compare,
    Expression,
    Index,
    Logic,
    Name,
    Node,
    Number,
    Slice,
    Text,
    Unary,
    names_in,
    walk,
)
from framekit.definition.model import segments as model
from framekit.definition.model.frames import expressions_of, flat
from framekit.definition.model.segments import FieldType, Segment, Value

Evaluate = Callable[[Node], Any]
"""The value of a part of an expression, or None when it cannot be told."""

_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}


@dataclass(slots=True)
class Hints:
    """What is known about one field. `letters`: place in the text → what may stand there; `rest`: from a place on.

    `holds`: texts that stand somewhere in it.
    """

    least: int | None = None
    most: int | None = None
    allowed: list[Any] | None = None
    denied: list[Any] = field(default_factory=list)
    letters: dict[int, list[str]] = field(default_factory=dict)
    rest: tuple[int, str] | None = None
    holds: list[str] = field(default_factory=list)

    def add(self, operator: str, value: Any) -> None:
        """Notes `field operator value`."""
        if operator in ("==", "in"):
            values = [value] if operator == "==" else list(value)
            self.allowed = values if self.allowed is None else [one for one in self.allowed if one in values]
        elif operator in ("!=", "not in"):
            self.denied += [value] if operator == "!=" else list(value)
        elif isinstance(value, int):
            bound = value + {"<": -1, ">": 1}.get(operator, 0)
            if operator in ("<", "<="):
                self.most = bound if self.most is None else min(self.most, bound)
            else:
                self.least = bound if self.least is None else max(self.least, bound)

    def add_letter(self, place: int, operator: str, value: Any) -> None:
        """Notes `field[place] operator value`."""
        if operator in ("==", "in"):
            values = [value] if operator == "==" else [one for one in value if isinstance(one, str)]
            before = self.letters.get(place)
            self.letters[place] = values if before is None else [one for one in before if one in values]


def hints_of(segments: Iterable[Segment], evaluate: Evaluate) -> dict[str, Hints]:
    """Hints about the fields of a record by name; what they are compared with is worked out by `evaluate`."""
    segments = tuple(segments)
    derived = {part.name: part.read.root for part in segments if isinstance(part, Value) and part.build is None}
    found: dict[str, Hints] = {}
    for node in _conditions(segments):
        _note_rest(found, node)
        if not isinstance(node, Compare):
            continue
        left = node.first
        for operator, right in node.rest:
            _note(found, derived, left, operator, right, evaluate)
            if operator in _MIRRORED:
                _note(found, derived, right, _MIRRORED[operator], left, evaluate)
            if operator == "in":
                _note_held(found, derived, left, right, evaluate)
            left = right
    return found


def _conditions(segments: Iterable[Segment]) -> Iterator[Node]:
    """The parts of all conditions that must each hold."""
    for segment in segments:
        if segment.condition is not None:
            root = segment.condition.root
            yield from root.operands if isinstance(root, Logic) and root.operator == "and" else (root,)


def _note_rest(found: dict[str, Hints], node: Node) -> None:
    """Notes `only(field[place:], letters)`."""
    match node:
        case Call(
            function="only", arguments=(Slice(value=Name(name=name), start=start, stop=None), Text(value=letters))
        ):
            place = start.value if isinstance(start, Number) else 0
            found.setdefault(name, Hints()).rest = place, letters


def _note_held(found: dict[str, Hints], derived: dict[str, Node], part: Node, whole: Node, evaluate: Evaluate) -> None:
    """Notes `'text' in field`, also in small letters or capitals of it."""
    subject = _plain(whole, derived)
    value = evaluate(part) if isinstance(subject, Name) else None
    if isinstance(subject, Name) and isinstance(value, str):
        found.setdefault(subject.name, Hints()).holds.append(value)


def _plain(subject: Node, derived: dict[str, Node]) -> Node:
    """What a condition looks at, whether it is in small letters or capitals."""
    if isinstance(subject, Name):
        subject = derived.get(subject.name, subject)
    if isinstance(subject, Call) and subject.function in ("upper", "lower"):
        subject = subject.arguments[0]
    return subject


def _note(
    found: dict[str, Hints], derived: dict[str, Node], subject: Node, operator: str, other: Node, evaluate: Evaluate
) -> None:
    value = evaluate(other)
    if value is None or (operator in ("in", "not in") and not hasattr(value, "__iter__")):
        return
    if isinstance(subject, Name) and subject.name in derived:  # it may be given
        found.setdefault(subject.name, Hints()).add(operator, value)
    subject = _plain(subject, derived)
    place: int | None = None
    if isinstance(subject, Index) and isinstance(subject.index, Number):
        place, subject = subject.index.value, subject.value
    if not isinstance(subject, Name):
        return
    hints = found.setdefault(subject.name, Hints())
    if place is None:
        hints.add(operator, value)
    else:
        hints.add_letter(place, operator, value)


LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789%"
LARGEST = 600
"""Bytes or items of one value; larger ones tell nothing more."""

MOST_ITEMS = 20_000
"""Items of lists in all samples of a frame; longer lists would take long to make."""

SHOWN = 24
"""Bytes of a sample that a message shows."""

DEEPEST = 6
_LEFT_OUT: Any = object()
_GIVEN = (model.Field, model.Data, model.Value)
"""What conditions may read of the segments that follow them: values that are given."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Values of a frame, the bytes they make, and what is read back from these: the computed values too."""

    values: Mapping[str, Any]
    data: bytes
    read: Mapping[str, Any]


def beginning(data: bytes) -> str:
    """The bytes of a sample as a message shows them."""
    return data[:SHOWN].hex(" ").upper() + (" …" if len(data) > SHOWN else "")


class Sampler:
    """Makes samples of the frames of one protocol, in one context."""

    def __init__(self, codec: Codec, context: Mapping[str, Any]) -> None:
        self.codec = codec
        self.context = context
        self._made: dict[str, tuple[Sample, ...]] = {}
        self._items = 0

    def samples(self, frame: str, count: int = 8, tries: int = 80) -> tuple[Sample, ...]:
        """Up to `count` different samples that can be encoded and decoded again; fewer when tries run out."""
        if frame not in self._made:
            random_ = random.Random(f"framekit {frame}")
            found: dict[bytes, Sample] = {}
            self._items = 0
            for _ in range(tries):
                sample = self._try(frame, random_)
                if sample is not None:
                    found.setdefault(sample.data, sample)
                if len(found) >= count or self._items > MOST_ITEMS:
                    break
            self._made[frame] = tuple(found.values())
        return self._made[frame]

    def resized(self, frame: str, size: int) -> Iterator[Sample]:
        """The samples that have `size` bytes, or have them when one value is longer or shorter."""
        for sample in self.samples(frame):
            if len(sample.data) == size:
                yield sample
                continue
            for name, value in sample.values.items():
                if isinstance(value, (bytes, str, list)) and value:
                    longest = value * (size // len(value) + 1)
                    tried = (
                        self._read_back(frame, {**sample.values, name: longest[:many]}) for many in range(size + 1)
                    )
                    found = next((one for one in tried if one is not None and len(one.data) >= size), None)
                    if found is not None and len(found.data) == size:
                        yield found
                        break

    @property
    def in_vain(self) -> list[str]:
        """The frames that samples were wanted of, and that have none."""
        return [frame for frame, made in self._made.items() if not made]

    def count(self, items: int) -> None:
        """So many items are about to be made. Raises ValueError when that is too much."""
        self._items += items
        if self._items > MOST_ITEMS:
            raise ValueError("too much for a sample")

    def _try(self, frame: str, random_: random.Random) -> Sample | None:
        try:
            values = _Record(self, random_, self.codec.protocol.frames[frame].segments, None).make()
        except (MissingName, *EVALUATION_ERRORS):
            return None
        return self._read_back(frame, values)

    def _read_back(self, frame: str, values: Mapping[str, Any]) -> Sample | None:
        """A sample of these values; None where they cannot be encoded and decoded again."""
        try:
            data = self.codec.encode(frame, values, self.context)
            read = self.codec.decode(frame, data, self.context)
        except (EncodeError, FrameError, MissingName, *EVALUATION_ERRORS):
            return None
        return Sample(values, data, read)


class _Record:
    """The values of one record under way. Expressions see what there is so far, and what follows from it."""

    def __init__(
        self, sampler: Sampler, random_: random.Random, segments: tuple[Segment, ...], outer: _Record | None
    ) -> None:
        self.sampler = sampler
        self.random = random_
        self.segments = segments
        self.outer = outer
        self.depth: int = 0 if outer is None else outer.depth + 1
        self.given: dict[str, Any] = {}
        self.words: dict[str, Any] = {}  # what an item knows of itself
        self.records: dict[str, _Record | list[_Record]] = {}
        self.all = tuple(flat(segments))
        self.by_name = _by_name(self.all)
        self.inputs = {name for segment in self.all for part in _built(segment) for name in names_in(part.root)}
        self.working: set[str] = set()

    # ---- names --------------------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> Any:
        """A value of this record, worked out if need be, of those around it, or of the context."""
        if name in self.records:
            return self.records[name]
        if name in self.given:
            return self.given[name]
        if name in self.words:
            return self.words[name]
        segment = self.by_name.get(name)
        if segment is not None and name not in self.working:
            self.working.add(name)
            try:
                return self._computed(segment, name)
            finally:
                self.working.discard(name)
        if segment is None and self.outer is not None:
            return self.outer[name]
        if segment is None:
            with suppress(KeyError):  # what looks names up elsewhere need not hold them
                return self.sampler.context[name]
        raise MissingName(name)

    def language_attribute(self, name: str) -> Any:
        """What a dot finds in this record: what is computed too, nothing for what is not there."""
        if name not in self.by_name:
            raise KeyError(name)
        when = self.by_name[name].when
        try:
            return None if when is not None and not evaluate(when.root, self) else self[name]
        except MissingName:
            return None

    def _computed(self, segment: Segment, name: str) -> Any:
        if isinstance(segment, model.Field):
            if segment.constants:
                return segment.constants[0]
            expression = segment.is_ or segment.build or segment.default
        elif isinstance(segment, model.Value):
            expression = segment.build or (None if name in self.inputs else segment.read)
        elif isinstance(segment, model.Bits):
            part = next(part for part in segment.parts if part.name == name)
            if part.constants:
                return part.constants[0]
            expression = part.is_ or part.build
        elif isinstance(segment, model.Count) and segment.of in self.given:
            return len(self.given[segment.of]) + segment.plus
        elif isinstance(segment, model.Length) and all(type(self.given.get(one)) is bytes for one in segment.of):
            return sum(len(self.given[one]) for one in segment.of) // segment.unit + segment.plus
        else:
            expression = None
        if expression is None:
            raise MissingName(name)
        return evaluate(expression.root, self)

    def known(self, node: Node) -> Any:
        """The value of a part of an expression; None when something in it has no value yet."""
        try:
            return evaluate(node, self)
        except (MissingName, *EVALUATION_ERRORS):
            return None

    # ---- values -------------------------------------------------------------------------------------------

    def make(self) -> dict[str, Any]:
        """Values of all segments, in their order. Raises what expressions raise that cannot be worked out."""
        self._all(self.segments)
        return self.given

    def _all(self, segments: tuple[Segment, ...]) -> None:
        for segment in segments:
            if segment.when is not None and not self._holds(segment.when):
                continue
            if segment.name in self.given:
                continue  # a condition before it has asked for it
            match segment:
                case Segment(is_there_inside=True):
                    self._all(segment.usual_block)
                case Segment(has_cases=True, chooses_by=None):
                    if self.random.random() < 0.5:
                        self._all(segment.usual_block)
                case model.Choose():
                    self._all(self._case(segment))
                case model.Bits(parts=parts):
                    for part in parts:
                        self._put(part.name, self._bits(part))
                case _:
                    self._put(segment.name, self._value(segment))
                    for name, value in kind_of(segment).sample(self.random, segment).items():
                        self._put(name, value)

    def _holds(self, when: Expression) -> bool:
        """Whether a condition holds; what it reads of the segments that follow gets its value now."""
        for _ in self.all:
            try:
                return bool(evaluate(when.root, self))
            except MissingName as missing:
                later = self.by_name.get(missing.name)
                if later is None or missing.name in self.given or not isinstance(later, _GIVEN):
                    raise
                self._put(missing.name, self._value(later))
        return bool(evaluate(when.root, self))

    def _put(self, name: str | None, value: Any) -> None:
        if name is not None and value is not _LEFT_OUT:
            self.given[name] = value

    def _case(self, choose: model.Choose) -> tuple[Segment, ...]:
        wanted = evaluate(choose.on.root, self)
        fitting = [segments for keys, segments in choose.cases if wanted in keys]
        return fitting[0] if fitting else choose.otherwise or ()

    def _value(self, segment: Segment) -> Any:
        match segment:
            case model.Field():
                return self._field(segment)
            case model.Data():
                return self._data(segment)
            case model.Repeat():
                return self._repeat(segment)
            case Segment(is_record=True):
                record = _Record(self.sampler, self.random, segment.members, self)
                values = record.make()
                self.records.update((name, record) for name in segment.value_names)
                return values
            case model.Inner(frames=frames):
                return self._inner(frames)
            case model.Nested(frame=frame):
                return self._inner((frame,))[frame]
            case model.Value(build=None, name=name) if name in self.inputs:
                allowed = (hints_of(self.all, self.known).get(name) or Hints()).allowed
                return self.random.choice(allowed) if allowed else self._as_read(segment)
        return _LEFT_OUT

    def _as_read(self, value: model.Value) -> Any:
        """Return a value as it would be read: worked out of free values of the fields that it follows from."""
        keys: dict[str, list[int]] = {}
        tables = self.sampler.codec.protocol.tables
        for node in walk(value.read.root):
            match node:
                case Index(value=Name(name=table), index=Name(name=name)) if table in tables:
                    keys[name] = [key for key in tables[table].entries if isinstance(key, int)]
        before = self.given
        self.given = {**before}
        try:
            for name in sorted(names_in(value.read.root) & self.by_name.keys() - before.keys()):
                field = self.by_name[name]
                if keys.get(name):
                    self.given[name] = self.random.choice(keys[name])
                elif isinstance(field, model.Field):
                    self.given[name] = self._free(field)
            found = self.known(value.read.root)
        finally:
            self.given = before
        return self.random.randrange(32) if found is None else found

    def _inside(self, segments: tuple[Segment, ...]) -> dict[str, Any]:
        return _Record(self.sampler, self.random, segments, self).make()

    def _inner(self, frames: tuple[str, ...]) -> Any:
        known = self.sampler.codec.protocol.frames
        usual = [name for name in frames if known[name].refuse is None] or list(frames)
        if self.depth > DEEPEST or not usual:
            raise KeyError("inner")
        name = self.random.choice(usual)
        return {name: self._inside(known[name].segments)}

    def _bits(self, part: model.BitsPart) -> Any:
        if part.is_ is not None or part.build is not None:
            return _LEFT_OUT
        if part.constants:
            return self.random.choice(part.constants)
        hints = hints_of(self.all, self.known).get(part.name) or Hints()
        least, most = hints.least or 0, (1 << min(part.high - part.low + 1, 32)) - 1
        most = most if hints.most is None else min(most, hints.most)
        choice = list(part.values or ()) if hints.allowed is None else hints.allowed
        choice = [one for one in choice if one not in hints.denied]
        if choice:
            return self.random.choice(choice)
        number = self.random.randint(min(least, most), most)
        while number in hints.denied and number < most:
            number += 1
        return number

    # ---- fields -------------------------------------------------------------------------------------------

    def _field(self, field: model.Field) -> Any:
        if field.is_ is not None:
            return _LEFT_OUT
        if field.constants:
            return self.random.choice(field.constants)
        if field.build is not None and not names_in(field.build.root) & self.by_name.keys() - {field.name}:
            return _LEFT_OUT if self.known(field.build.root) is not None else self._free(field)
        if field.build is not None or (field.default is not None and self.random.random() < 0.5):
            return _LEFT_OUT
        return self._free(field)

    def _free(self, field: model.Field) -> Any:
        hints = hints_of(self.all, self.known).get(field.name) or Hints()
        match field.type.kind:
            case "ascii":
                return self._text(field, hints)
            case "bytes":
                return self.random.randbytes(self._size(field.type.size))
            case "float" | "hex_float":
                return self.random.choice([0.0, 1.5, -2.25, 100.0])
            case "scaled" if field.type.scale is not None and field.type.inside is not None:
                least, most = field.type.inside.bounds or (0, 9)
                return support.scaled(self._some(least, most), *field.type.scale.arguments)
            case "fraction":
                return self.random.choice([0, 1, 0.5, -2, 12.5])
        return self._number(field, hints)

    def _number(self, field: model.Field, hints: Hints) -> int:
        if field.values and (field.only or self.random.random() < 0.5):
            choice = [number for number in field.values if hints.allowed is None or number in hints.allowed]
        else:
            choice = [number for number in hints.allowed or () if isinstance(number, int)]
        if choice:
            return self.random.choice(choice)
        unit = field.unit or 1
        least, most = self._span(field, unit)
        least = max([least, *([hints.least // unit] if hints.least is not None else [])])
        most = min([most, *([hints.most // unit] if hints.most is not None else [])])
        number = self._some(least, most)
        while number * unit in hints.denied and number < most:
            number += 1
        return number * unit

    def _span(self, field: model.Field, unit: int) -> tuple[int, int]:
        """Least and greatest number on the wire less `plus`, in units."""
        type_ = field.type if field.long is None else field.long.type
        bounds = type_.bounds or (0, 10 ** min(self._size(type_.size), 8) - 1)
        least, most = bounds[0] - field.plus, bounds[1] - field.plus
        if field.zero_means is not None:
            least, most = max(least, 1), min(most, field.zero_means)
        if field.limits is not None:
            least, most = max(least, -(-field.limits[0] // unit)), min(most, field.limits[1] // unit)
        return least, most

    def _some(self, least: int, most: int) -> int:
        """A number; mostly a small one, so that what it counts stays small."""
        if most < least:
            raise ValueError("no number is possible")
        kind = self.random.random()
        if kind < 0.6:
            return self.random.randint(least, min(most, least + 5))
        return most if kind < 0.7 else self.random.randint(least, most)

    def _text(self, field: model.Field, hints: Hints) -> str:
        size = self._free_size(field.name, 0) if field.type.size is None else self._size(field.type.size, field.name)
        if hints.allowed:
            return str(self.random.choice(hints.allowed))
        size = max([size, *(place + 1 for place in hints.letters if isinstance(field.type.size, Expression))])
        if hints.rest is not None and isinstance(field.type.size, Expression):
            size = max(size, hints.rest[0] + 1)
        letters = [self.random.choice(LETTERS) for _ in range(size)]
        if hints.rest is not None:
            start, allowed_there = hints.rest
            letters[start:] = [self.random.choice(allowed_there) for _ in letters[start:]]
        for place, allowed in hints.letters.items():
            if allowed and place < size:
                letters[place] = self.random.choice(allowed)
        text = "".join(letters)
        for held in hints.holds:
            place = self.random.randint(0, max(0, size - len(held)))
            text = text[:place] + held + text[place + len(held) :]
        return text

    # ---- sizes --------------------------------------------------------------------------------------------

    def _size(self, size: model.Size | None, name: str = "") -> int:
        """A size in bytes or places: a number, what an expression comes to, or a small one where nothing fixes it."""
        if isinstance(size, int):
            return size
        if isinstance(size, Expression):
            found = self.known(size.root)
            if isinstance(found, int):
                if not 0 <= found <= LARGEST:
                    raise ValueError("too large for a sample")
                return found
        return self._free_size(name, 0)

    def _free_size(self, name: str, least: int) -> int:
        """How long something may be whose length is computed from it."""
        unit, most = 1, least + 8
        for segment in self.all:
            if isinstance(segment, model.Length) and name in segment.of:
                unit = max(unit, segment.unit)
                if segment.limits is not None and len(segment.of) == 1:
                    least = max(least, (segment.limits[0] - segment.plus) * segment.unit)
                    most = min(max(most, least), (segment.limits[1] - segment.plus) * segment.unit)
        size = self.random.randint(max(least, 0), max(least, most, 0))
        return -(-size // unit) * unit

    def _data(self, data: model.Data) -> bytes:
        size = self._free_size(data.name, data.least) if data.size == "rest" else self._size(data.size, data.name)
        if data.convert == "ascii_to_hex":
            return "".join(self.random.choice("0123456789ABCDEF") for _ in range(size // 2 * 2)).encode()
        free = bytes(byte for byte in range(256) if byte not in data.never)
        return bytes(self.random.choices(free, k=size)) if data.never else self.random.randbytes(size)

    def _repeat(self, repeat: model.Repeat) -> list[Any]:
        times = self._times(repeat)
        self.sampler.count(times)
        if isinstance(repeat.of, FieldType):
            of = repeat.of if repeat.of.inside is None else repeat.of.inside
            least, most = of.bounds or (0, 9)
            numbers = [self._some(least, most) for _ in range(times)]
            scale = repeat.of.scale
            return numbers if scale is None else [support.scaled(one, *scale.arguments) for one in numbers]
        records: list[_Record] = []
        self.records[repeat.name] = records
        alike = self.random.random() < 0.5 and repeat.until is None
        for place in range(times):
            if not records or not alike:
                record = _Record(self.sampler, self.random, item_of(repeat, place == times - 1), self)
                previous = records[-1] if records else None
                record.words = {model.INDEX: place, model.LAST: place == times - 1, model.PREVIOUS: previous}
                record.make()
            records.append(record)
        return [record.given[model.PLAIN] if repeat.single else dict(record.given) for record in records]

    def _times(self, repeat: model.Repeat) -> int:
        counts = [part for part in self.all if isinstance(part, model.Count) and part.of == repeat.name]
        if counts:
            least, most = counts[0].limits or (0, 3)
            return self.random.randint(least, max(least, min(most, least + 2)))
        if repeat.times is None or repeat.times == "rest":
            return self.random.randint(1, 3)
        return self._size(repeat.times, repeat.name)


def item_of(repeat: model.Repeat, is_last: bool) -> tuple[Segment, ...]:
    """The segments of an item; whether it ends the list is a condition that its values have to meet."""
    until = repeat.until
    if until is None:
        return repeat.members
    root = until.root
    opposite = {"==": "!=", "!=": "=="}
    if not is_last and isinstance(root, Compare) and len(root.rest) == 1 and root.rest[0][0] in opposite:
        operator, right = root.rest[0]
        root = replace(root, rest=((opposite[operator], right),))
    elif not is_last:
        root = Unary(root.at, "not", root)
    return (*repeat.members[:-1], model.Require(at=until.at, condition=Expression(until.text, root)))


def _by_name(segments: tuple[Segment, ...]) -> dict[str, Segment]:
    found: dict[str, Segment] = {}
    for segment in segments:
        if isinstance(segment, model.Bits):
            found |= {part.name: segment for part in segment.parts}
        elif segment.name:
            found.setdefault(segment.name, segment)
    return found


def _built(segment: Segment) -> list[Expression]:
    """The expressions that compute something from other values when building."""
    if isinstance(segment, model.Bits):
        return [part.build for part in segment.parts if part.build is not None]
    build = segment.build if isinstance(segment, (model.Field, model.Value)) else None
    return [] if build is None else list(expressions_of(build))
