"""Sample values of frames, drawn from the model: the same samples in every run.

Values respect types, ranges, tables, sizes, `where` and conditions as far as these are plain. The encoder refuses
values that do not fit together; the sampler then tries again. Computed values are left out.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
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
"""Return the value of a part of an expression, or None while the value is unknown."""

_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}


@dataclass(slots=True)
class Hints:
    """Facts about one field that follow from conditions."""

    least: int | None = None
    most: int | None = None
    allowed: list[Any] | None = None
    """The allowed values; None for any."""
    denied: set[Any] = field(default_factory=set)
    """The forbidden values."""
    letters: dict[int, list[str]] = field(default_factory=dict)
    """Position in the text → letters that are possible there."""
    rest: tuple[int, str] | None = None
    """A position in the text, and the letters that are possible from there on."""
    holds: list[str] = field(default_factory=list)
    """Texts that the field contains."""

    def add(self, operator: str, value: Any) -> None:
        """Note the fact `field operator value`."""
        if operator in ("==", "in"):
            values = [value] if operator == "==" else list(value)
            self.allowed = values if self.allowed is None else [one for one in self.allowed if one in values]
        elif operator in ("!=", "not in"):
            self.denied.update(one for one in ([value] if operator == "!=" else value) if isinstance(one, Hashable))
        elif isinstance(value, int):
            bound = value + {"<": -1, ">": 1}.get(operator, 0)
            if operator in ("<", "<="):
                self.most = bound if self.most is None else min(self.most, bound)
            else:
                self.least = bound if self.least is None else max(self.least, bound)

    def add_letter(self, place: int, operator: str, value: Any) -> None:
        """Note the fact `field[place] operator value`."""
        if operator in ("==", "in"):
            values = [value] if operator == "==" else [one for one in value if isinstance(one, str)]
            before = self.letters.get(place)
            self.letters[place] = values if before is None else [one for one in before if one in values]


Fact = Callable[[Hints, Evaluate], None]
"""Add one fact to the hints of a field. The other side of its comparison is evaluated then."""


class Conditions:
    """The conditions of one record, indexed by the fields that they restrict."""

    def __init__(self, segments: Iterable[Segment]) -> None:
        segments = tuple(segments)
        self._derived = {
            part.name: part.read.root for part in segments if isinstance(part, Value) and part.build is None
        }
        self._facts: dict[str, list[Fact]] = {}
        for node in _conditions(segments):
            self._index(node)

    def hints(self, name: str, evaluate: Evaluate) -> Hints:
        """Return the hints about a field; `evaluate` gives the values that it is compared with."""
        found = Hints()
        for fact in self._facts.get(name, ()):
            fact(found, evaluate)
        return found

    def _index(self, node: Node) -> None:
        """Index one condition: `only(field[place:], letters)` or a comparison."""
        match node:
            case Call(
                function="only", arguments=(Slice(value=Name(name=name), start=start, stop=None), Text(value=letters))
            ):
                rest = start.value if isinstance(start, Number) else 0, letters
                self._add(name, lambda hints, _: setattr(hints, "rest", rest))
            case Compare(first=left, rest=comparisons):
                for operator, right in comparisons:
                    self._compare(left, operator, right)
                    if operator in _MIRRORED:
                        self._compare(right, _MIRRORED[operator], left)
                    if operator == "in":
                        self._contains(right, left)
                    left = right

    def _add(self, name: str, fact: Fact) -> None:
        self._facts.setdefault(name, []).append(fact)

    def _contains(self, whole: Node, part: Node) -> None:
        """Index `'text' in field`, also in `lower(field)` and `upper(field)`."""

        def fact(hints: Hints, evaluate: Evaluate) -> None:
            value = evaluate(part)
            if isinstance(value, str):
                hints.holds.append(value)

        subject = self._subject(whole)
        if isinstance(subject, Name):
            self._add(subject.name, fact)

    def _compare(self, subject: Node, operator: str, other: Node) -> None:
        """Index `subject operator other` under the field that the subject reads."""

        def fact_of(add: Callable[[Hints, Any], None]) -> Fact:
            def fact(hints: Hints, evaluate: Evaluate) -> None:
                value = evaluate(other)
                if value is not None and (operator not in ("in", "not in") or hasattr(value, "__iter__")):
                    add(hints, value)

            return fact

        compared = fact_of(lambda hints, value: hints.add(operator, value))
        if isinstance(subject, Name) and subject.name in self._derived:  # a derived value may be given
            self._add(subject.name, compared)
        subject = self._subject(subject)
        if isinstance(subject, Name):
            self._add(subject.name, compared)
        elif isinstance(subject, Index) and isinstance(subject.index, Number) and isinstance(subject.value, Name):
            place = subject.index.value
            self._add(subject.value.name, fact_of(lambda hints, value: hints.add_letter(place, operator, value)))

    def _subject(self, node: Node) -> Node:
        """Return the field that a condition looks at: without `lower` and `upper`, derived values replaced."""
        if isinstance(node, Name):
            node = self._derived.get(node.name, node)
        if isinstance(node, Call) and node.function in ("upper", "lower"):
            node = node.arguments[0]
        return node


def _conditions(segments: Iterable[Segment]) -> Iterator[Node]:
    """Yield the conditions; those joined by `and` apart."""
    for segment in segments:
        if segment.condition is not None:
            root = segment.condition.root
            yield from root.operands if isinstance(root, Logic) and root.operator == "and" else (root,)


LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789%"
"""The characters of texts without restrictions."""
LARGEST = 600
"""Bytes or items of one value; larger values show no further difference."""

MOST_ITEMS = 20_000
"""Items of lists in all samples of a frame together."""

SHOWN = 24
"""Number of bytes of a sample in a message."""

DEEPEST = 6
"""Limit of the nesting depth of records and inner frames."""
_LEFT_OUT: Any = object()
_GIVEN = (model.Field, model.Data, model.Value)
"""Segments that a condition may read although they follow it: their values are given."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Values of a frame, its bytes, and the values that decoding these bytes gives, computed values included."""

    values: Mapping[str, Any]
    data: bytes
    read: Mapping[str, Any]


def beginning(data: bytes) -> str:
    """Return the bytes of a sample as a message shows them."""
    return data[:SHOWN].hex(" ").upper() + (" …" if len(data) > SHOWN else "")


class RecordShape:
    """The segments of one record, indexed once for all its samples."""

    def __init__(self, segments: tuple[Segment, ...]) -> None:
        self.segments = segments
        every = tuple(flat(segments))
        self.by_name = _by_name(every)
        self.conditions = Conditions(every)
        self.inputs = {name for segment in every for part in _built(segment) for name in names_in(part.root)}
        """The names that encoding computes other values from."""
        self.lengths: dict[str, list[model.Length]] = {}
        self.counts: dict[str, model.Count] = {}
        for segment in every:
            if isinstance(segment, model.Length):
                for name in segment.of:
                    self.lengths.setdefault(name, []).append(segment)
            elif isinstance(segment, model.Count):
                self.counts.setdefault(segment.of, segment)


class Sampler:
    """Make samples of the frames of one protocol, in one context."""

    def __init__(self, codec: Codec, context: Mapping[str, Any]) -> None:
        self.codec = codec
        self.context = context
        self._made: dict[str, tuple[Sample, ...]] = {}
        self._items = 0
        self._frames: dict[str, RecordShape] = {}
        self._records: dict[tuple[int, bool], RecordShape] = {}

    def samples(self, frame: str, count: int = 8, tries: int = 80) -> tuple[Sample, ...]:
        """Return up to `count` different samples that can be encoded and decoded; fewer when the tries run out."""
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
        """Yield the samples of `size` bytes, also those that have this size when one value is resized."""
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
        """Return the names of the frames for which no sample was found."""
        return [frame for frame, made in self._made.items() if not made]

    def count(self, items: int) -> None:
        """Count items before they are made. Raise ValueError above `MOST_ITEMS`."""
        self._items += items
        if self._items > MOST_ITEMS:
            raise ValueError("too much for a sample")

    def frame(self, name: str) -> RecordShape:
        """Return the shape of a frame."""
        if name not in self._frames:
            self._frames[name] = RecordShape(self.codec.protocol.frames[name].segments)
        return self._frames[name]

    def record(self, record: Segment) -> RecordShape:
        """Return the shape of a record inside a frame."""
        return self._inside(record, False, lambda: record.members)

    def item(self, repeat: model.Repeat, is_last: bool) -> RecordShape:
        """Return the shape of an item of a list."""
        return self._inside(repeat, is_last, lambda: item_of(repeat, is_last))

    def _inside(self, holder: Segment, is_last: bool, members: Callable[[], tuple[Segment, ...]]) -> RecordShape:
        """Return the shape of a record or an item, cached by its holder, a segment of the protocol."""
        key = id(holder), is_last
        if key not in self._records:
            self._records[key] = RecordShape(members())
        return self._records[key]

    def _try(self, frame: str, random_: random.Random) -> Sample | None:
        try:
            values = _Record(self, random_, self.frame(frame), None).make()
        except (MissingName, *EVALUATION_ERRORS):
            return None
        return self._read_back(frame, values)

    def _read_back(self, frame: str, values: Mapping[str, Any]) -> Sample | None:
        """Return a sample of these values; None where they cannot be encoded and decoded."""
        try:
            data = self.codec.encode(frame, values, self.context)
            read = self.codec.decode(frame, data, self.context)
        except (EncodeError, FrameError, MissingName, *EVALUATION_ERRORS):
            return None
        return Sample(values, data, read)


class _Record:
    """The values of one record while they are drawn. Expressions see the values drawn so far, and those they imply."""

    def __init__(self, sampler: Sampler, random_: random.Random, shape: RecordShape, outer: _Record | None) -> None:
        self.sampler = sampler
        self.random = random_
        self.shape = shape
        self.outer = outer
        self.depth: int = 0 if outer is None else outer.depth + 1
        self.given: dict[str, Any] = {}
        self.words: dict[str, Any] = {}
        """The words of an item: `index`, `last`, `previous`."""
        self.records: dict[str, _Record | list[_Record]] = {}
        self.by_name = shape.by_name
        self.working: set[str] = set()

    # ---- names --------------------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> Any:
        """Return a value of this record (evaluated if necessary), of a record around it, or of the context."""
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
            with suppress(KeyError):  # a context may lack names that expressions read elsewhere
                return self.sampler.context[name]
        raise MissingName(name)

    def language_attribute(self, name: str) -> Any:
        """Return the value that a dot finds in this record, computed values included; None for an absent segment."""
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
            expression = segment.build or (None if name in self.shape.inputs else segment.read)
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
        """Return the value of a part of an expression; None while a name in it has no value."""
        try:
            return evaluate(node, self)
        except (MissingName, *EVALUATION_ERRORS):
            return None

    def _hints(self, name: str) -> Hints:
        return self.shape.conditions.hints(name, self.known)

    # ---- values -------------------------------------------------------------------------------------------

    def make(self) -> dict[str, Any]:
        """Return values of all segments, in their order. Raise the error of an expression that cannot be evaluated."""
        self._all(self.shape.segments)
        return self.given

    def _all(self, segments: tuple[Segment, ...]) -> None:
        for segment in segments:
            if segment.when is not None and not self._holds(segment.when):
                continue
            if segment.name in self.given:
                continue  # an earlier condition has read it
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
        """Return whether a condition holds; later segments that it reads get their values first."""
        for _ in self.by_name:
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
                record = _Record(self.sampler, self.random, self.sampler.record(segment), self)
                values = record.make()
                self.records.update((name, record) for name in segment.value_names)
                return values
            case model.Inner(frames=frames):
                return self._inner(frames)
            case model.Nested(frame=frame):
                return self._inner((frame,))[frame]
            case model.Value(build=None, name=name) if name in self.shape.inputs:
                allowed = self._hints(name).allowed
                return self.random.choice(allowed) if allowed else self._as_read(segment)
        return _LEFT_OUT

    def _as_read(self, value: model.Value) -> Any:
        """Return a value as decoding would give it: evaluated from free values of the fields that it reads."""
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

    def _inner(self, frames: tuple[str, ...]) -> Any:
        known = self.sampler.codec.protocol.frames
        usual = [name for name in frames if known[name].refuse is None] or list(frames)
        if self.depth > DEEPEST or not usual:
            raise KeyError("inner")
        name = self.random.choice(usual)
        return {name: _Record(self.sampler, self.random, self.sampler.frame(name), self).make()}

    def _bits(self, part: model.BitsPart) -> Any:
        if part.is_ is not None or part.build is not None:
            return _LEFT_OUT
        if part.constants:
            return self.random.choice(part.constants)
        hints = self._hints(part.name)
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
        hints = self._hints(field.name)
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
        """Return the least and the greatest number on the wire less `plus`, in units."""
        type_ = field.type if field.long is None else field.long.type
        bounds = type_.bounds or (0, 10 ** min(self._size(type_.size), 8) - 1)
        least, most = bounds[0] - field.plus, bounds[1] - field.plus
        if field.zero_means is not None:
            least, most = max(least, 1), min(most, field.zero_means)
        if field.limits is not None:
            least, most = max(least, -(-field.limits[0] // unit)), min(most, field.limits[1] // unit)
        return least, most

    def _some(self, least: int, most: int) -> int:
        """Return a number, mostly a small number, because it may be a count."""
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
        """Return a size in bytes or digits: the constant, the value of the expression, or else a small free size."""
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
        """Return a size for data whose length field is computed from it."""
        unit, most = 1, least + 8
        for segment in self.shape.lengths.get(name, ()):
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
                record = _Record(self.sampler, self.random, self.sampler.item(repeat, place == times - 1), self)
                previous = records[-1] if records else None
                record.words = {model.INDEX: place, model.LAST: place == times - 1, model.PREVIOUS: previous}
                record.make()
            records.append(record)
        return [record.given[model.PLAIN] if repeat.single else dict(record.given) for record in records]

    def _times(self, repeat: model.Repeat) -> int:
        count = self.shape.counts.get(repeat.name)
        if count is not None:
            least, most = count.limits or (0, 3)
            return self.random.randint(least, max(least, min(most, least + 2)))
        if repeat.times is None or repeat.times == "rest":
            return self.random.randint(1, 3)
        return self._size(repeat.times, repeat.name)


def item_of(repeat: model.Repeat, is_last: bool) -> tuple[Segment, ...]:
    """Return the segments of an item, with the condition that it ends the list, or does not end it."""
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
    """Return the expressions by which encoding computes a value of the segment from other values."""
    if isinstance(segment, model.Bits):
        return [part.build for part in segment.parts if part.build is not None]
    build = segment.build if isinstance(segment, (model.Field, model.Value)) else None
    return [] if build is None else list(expressions_of(build))
