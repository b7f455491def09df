"""Write a type of a Kaitai file: the attributes in order, and the instances that compute values from them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace

from framekit.codec.python.choices import in_order
from framekit.definition.codings import Plain
from framekit.definition.expression import Expression, Name, Real, Text, names_in
from framekit.definition.model.frames import by_value_name, everything, expressions_of
from framekit.definition.model.segments import (
    INDEX,
    PLAIN,
    Bits,
    BitsPart,
    Check,
    Choose,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Fill,
    Inner,
    ItemEnd,
    Length,
    Nested,
    Optional,
    Repeat,
    Require,
    Segment,
    Segments,
    Skip,
    Value,
    Wrap,
)
from framekit.definition.problems import CannotSayError
from framekit.extras.kaitai.expressions import KsyEntry, Presence, Said, TypeScope
from framekit.extras.kaitai.forms import KsyForm, form_of, wide
from framekit.extras.kaitai.inside import HERE, FramesInside
from framekit.extras.kaitai.source import KsyNames, data, prose, string
from framekit.extras.kaitai.state import UNEXPECTED, Keys, KsyFrame

_LATER = KsyEntry("", "any", {}, "Kaitai reads it only later")
_MOST_MORE = 2000
"""Limit of the length of the text for conditional bytes after a part."""


@dataclass(frozen=True, slots=True)
class BytesBehind:
    """The number of bytes after a part of a stream."""

    fixed: int = 0
    """The constant number of bytes."""
    more: str = ""
    """The text of the bytes that depend on parameters."""
    is_open: bool = False
    """Whether the number is unknown."""

    @property
    def text(self) -> str:
        return f"{self.fixed}{self.more}"

    @property
    def is_nothing(self) -> bool:
        return not (self.fixed or self.more or self.is_open)


NOTHING_BEHIND = BytesBehind()
OPEN = BytesBehind(is_open=True)


class KsyBlock:
    """Write a type. Raises CannotSayError for a part that is required to read it."""

    def __init__(self, frame: KsyFrame, scope: TypeScope, segments: Segments = ()) -> None:
        self.frame, self.file, self.scope = frame, frame.file, scope
        self.expressions = frame.file.expressions
        self.names = KsyNames()
        self.own = {name: self.names.new(name) for segment in segments for name in segment.value_names}
        """The names of values, reserved before the names of raw numbers and other helpers."""
        self.params: list[Keys] = []
        self.seq: list[Keys] = []
        self.instances: dict[str, Keys] = {}
        self.always: set[str] = set()
        """Values that exist regardless of their condition, because they have a default."""
        self.at_end: list[tuple[Segment, Callable[[], None]]] = []
        """Writers that need values of the whole record."""
        self.segments = segments
        scope.entries |= dict.fromkeys(by_value_name(segments), _LATER)

    def keys(self) -> Keys:
        """Return the keys of the type in the file."""
        parts = {"params": self.params, "seq": self.seq, "instances": self.instances}
        return {name: part for name, part in parts.items() if part} or {"seq": []}

    def write(self, behind: BytesBehind) -> None:
        """Write the segments, given the bytes after them in the stream."""
        after = self._all_behind(behind)
        for place, segment in enumerate(self.segments):
            following = self.segments[place + 1] if place + 1 < len(self.segments) else None
            with self._under(segment) as condition:
                self._segment(segment, after[place], following, condition)
        for segment, write in self.at_end:
            with self._under(segment):
                write()

    def _own(self, name: str) -> str:
        """Return the name of a value, or a new similar name."""
        return self.own[name] if name in self.own else self.names.new(name)

    def _all_behind(self, behind: BytesBehind) -> list[BytesBehind]:
        """Return the bytes after each segment: those of later segments, and those after the list."""
        found = [behind]
        for segment in reversed(self.segments[1:]):
            found.append(self._behind(segment, found[-1]))
        return found[::-1]

    def _behind(self, segment: Segment, behind: BytesBehind) -> BytesBehind:
        """Return the bytes of a segment and those after it."""
        size = self.file.static.present(segment).fixed
        if size is None or behind.is_open:
            return OPEN
        if segment.when is None or size == 0:
            return replace(behind, fixed=behind.fixed + size)
        names = names_in(segment.when.root)
        if any(self.scope.find(name) is not None or name not in self.file.protocol.params for name in names):
            return OPEN
        try:
            more = f"{behind.more} - ({self.expressions.condition(segment.when, self.scope)} ? {size} : 0)"
        except CannotSayError:
            return OPEN
        return OPEN if len(more) > _MOST_MORE else replace(behind, more=more)

    @contextmanager
    def _under(self, segment: Segment) -> Iterator[str | None]:
        """Add the condition of the segment to everything written in the context; the context value is the condition."""
        if segment.when is None:
            yield None
            return
        first, made = len(self.seq), len(self.instances)
        known = {name: self.scope.entries.get(name) for name in by_value_name((segment,))}
        condition = self.expressions.condition(segment.when, self.scope)
        holds = self.scope.conditions(segment.when.root) - self.scope.holds
        self.scope.holds |= holds
        yield condition
        self.scope.holds -= holds
        for one in self.seq[first:]:
            one["if"] = f"{condition} and {one['if']}" if "if" in one else condition
        for path, one in [*self.instances.items()][made:]:
            if "pos" not in one and path not in self.always:
                one.setdefault("if", condition)
        needs = frozenset({self.scope.condition(segment.when.root)})
        for name, before in known.items():
            entry = self.scope.entries.get(name)
            if entry is not None and entry is not before and entry.path not in self.always:
                self.scope.entries[name] = replace(entry, needs=entry.needs | needs)

    def _segment(
        self, segment: Segment, after: BytesBehind, following: Segment | None, condition: str | None
    ) -> None:  # fmt: skip
        first = len(self.seq)
        match segment:
            case Const():
                self.seq.append({"contents": list(segment.data)})
            case Field():
                self._field(segment, condition)
            case Length() | Count():
                self._number(segment, segment.name, segment.type, segment.limits, 0, segment.zero_means)
                self.at_end.append((segment, lambda: self._counted(segment)))
            case Bits():
                self._bits(segment)
            case Data():
                self._data(segment, after, following)
            case Check():
                self._check(segment)
            case Skip():
                self.seq.append({"size": segment.size})
            case Fill():
                self.seq.append({"size": self._room(segment, after)})
            case Value():
                if not self._value(segment):
                    self.at_end.append((segment, lambda: self._last_value(segment)))
            case Require():
                self._require(segment)
            case ItemEnd():
                pass
            case _:
                self._composite(segment, after, following)
        if segment.doc and len(self.seq) > first:
            self.seq[first].setdefault("doc", prose(segment.doc))

    def _composite(self, segment: Segment, after: BytesBehind, following: Segment | None) -> None:
        """Write a segment that is made of other segments or of frames."""
        match segment:
            case Repeat():
                self._repeat(segment, after)
            case Choose():
                self._choose(segment, after)
            case Optional():
                self._optional(segment, after)
            case Wrap():
                self._wrap(segment, after, following)
            case Inner():
                self._inner(segment, after)
            case Nested():
                self._nested(segment)
            case Segment(is_record=True):
                self._record(segment, after)
            case _:
                raise self._not(segment, "a kind of segment of a program's own", "Kaitai has nothing like it")

    def _check(self, check: Check) -> None:
        self.seq.append({"id": self.names.new(_name(check, "check")), "size": check.size})
        what = f"the check code {check.method.name} is read and not verified"
        self._tell(check, what, "Kaitai works out no check codes")

    def _nested(self, nested: Nested) -> None:
        path = self._own(nested.name)
        self.seq.append({"id": path, "type": self.file.types[nested.frame]})
        self.file.without_end.add(nested.frame)
        self.scope.entries[nested.name] = KsyEntry(path, "record")

    def _record(self, record: Segment, after: BytesBehind) -> None:
        name = record.name or "record"
        type_, block = self._child(name, record.members, after)
        path = self._own(name)
        self.seq.append({"id": path, "type": type_})
        self.scope.entries[name] = KsyEntry(path, "record", block.scope.entries)

    # ---- words ----------------------------------------------------------------------------------------------

    def _not(self, segment: Segment, what: str, why: str) -> CannotSayError:
        return CannotSayError(segment.at, what, why)

    def _tell(self, segment: Segment, what: str, why: str) -> None:
        self.file.tell(segment.at, what, why)

    def _room(self, segment: Segment, after: BytesBehind) -> str:
        """Return the text of the remaining bytes for a segment. Raises CannotSayError."""
        if after.is_open:
            raise self._not(segment, f"where {segment.title} ends", "what stands behind it has no fixed size")
        return HERE if after.is_nothing else f"{HERE} - {after.text}"

    def _child(
        self, name: str, segments: Segments, behind: BytesBehind, *, apart: bool = False, items: bool = False,
        whole: bool = False, part: Presence | None = None,
    ) -> tuple[str, KsyBlock]:  # fmt: skip
        """Return a new type for segments, by its name and its block.

        `apart`: the type cannot access its surroundings; `items`: it gets its index as a parameter if it needs it;
        `whole`: it fills its stream; `part`: the condition under which it is read, if it is a part of this record that
        may be absent.
        """
        scope = TypeScope(self.scope, is_record=part is None, is_apart=apart)
        scope.holds |= set() if part is None else {part}
        block = KsyBlock(self.frame, scope, segments)
        type_ = self.frame.names.new_type(name)
        if items and any(INDEX in names_in(one.root) for one in expressions_of(segments)):
            index = block.names.new("index")
            block.params.append({"id": index, "type": "s4"})
            scope.entries[INDEX] = KsyEntry(index, "int", is_natural=True)
        block.write(behind)
        if whole:
            block.seq.append({"size": 0, "valid": {"expr": "_io.eof"}})
        self.frame.types[type_] = block.keys()
        scope.entries.pop(INDEX, None)
        return type_, block

    def _up(self, block: KsyBlock, path: str, part: Presence | None = None) -> None:
        """Add the values of an inner type to this record; `part`: see `_child`."""
        for name, entry in block.scope.entries.items():
            known = self.scope.entries.get(name, _LATER)
            found = entry.behind(path)
            found = found if part is None else replace(found, needs=found.needs | {part})
            self.scope.entries[name] = found if known is _LATER else replace(
                found, why_not="it stands in several cases, each of them a type of its own in Kaitai"
            )  # fmt: skip

    # ---- numbers and texts ----------------------------------------------------------------------------------

    def _size(self, size: int | Expression | None) -> int | str:
        if isinstance(size, Expression):
            return self.expressions.number(size, self.scope)
        return size or 0

    def _attribute(self, segment: Segment, name: str, type_: FieldType) -> tuple[Keys, KsyForm]:
        form = form_of(type_)
        keys = dict(form.keys)
        if form.takes_size:
            keys["size"] = self._size(type_.size)
        elif "terminator" not in keys and keys.get("type") == "str":
            raise self._not(segment, f"where '{name}' ends", "Kaitai ends a text at one byte, not at one of several")
        if form.not_said:
            self._tell(segment, f"'{name}' is not the value that framekit reads", form.not_said)
        elif form.not_looked_at:
            self._tell(segment, f"'{name}' is read less exactly", form.not_looked_at)
        if form.valid is not None:
            keys["valid"] = {"expr": form.valid("_")}
        return keys, form

    def _field(self, field: Field, condition: str | None) -> None:
        if field.long is not None:
            self._long(field, condition)
            return
        keys, number = self._number(
            field, field.name, field.type, field.limits, field.plus, field.zero_means, field.unit or 1,
            values=field.values, default=field.default if field.when is not None else None, condition=condition,
        )  # fmt: skip
        value = "_" if number.value is None else number.value("_")
        if number.not_said:
            return
        for text in self._valid(field, value):
            self._verify(keys, text, field.name)
        if field.is_ is not None and field.constants is None:
            self._compare_is(field, lambda text: self._verify(keys, f"{value} == {text}", field.name), number.kind)

    def _compare_is(self, field: Field, verify: Callable[[str], None], kind: str) -> None:
        """Write the comparison with `is`, immediately or after all names are known."""
        assert field.is_ is not None
        is_ = field.is_

        def last() -> None:
            try:
                text = self._constant(is_, field.values, field.type)
            except CannotSayError as error:
                self._tell(field, f"'{field.name}' is not compared: {error.problem.what}", error.problem.todo)
                return
            path = self.scope.entries[field.name].path
            text = f"{path} == {text}"
            self._verify_here(field.name, text)

        try:
            verify(self._constant(is_, field.values, field.type))
        except CannotSayError:
            self.at_end.append((field, last))

    def _verify_here(self, name: str, text: str) -> None:
        self.seq.append({"id": self.names.new(f"{name}_valid"), "size": 0, "valid": {"expr": text}})

    def _long(self, field: Field, condition: str | None) -> None:
        assert field.long is not None
        paths = []
        for word, type_ in (("short", field.type), ("long", field.long.type)):
            keys, form = self._attribute(field, field.name, type_)
            if form.not_said or form.kind != "int":
                raise self._not(field, f"the {word} form of '{field.name}'", form.not_said or "it is no whole number")
            raw = self.names.new(f"{field.name}_{word}")
            self.seq.append({"id": raw, **keys})
            paths.append(wide(form.value(raw) if form.value is not None else raw))
        short, long = paths
        is_long = f"{short} == {field.long.mark}"
        self.seq[-1]["if"] = is_long
        value = _value_text(f"({is_long} ? {long} : {short})", field.plus, field.zero_means, field.unit or 1)
        if field.default is not None and condition is not None:
            fallback = self._default(field, field.default, field.values)
            value = value if fallback is None else f"({condition} ? {value} : {fallback})"
        else:
            fallback = None
        path = self._own(field.name)
        number = path if field.values is None else self.names.new(f"{field.name}_number")
        self.instances[number] = {"value": wide(value)}
        if field.values is not None:
            enum = self.file.enum(field.name, field.values, field.at)
            self.instances[path] = {"value": number, **({} if enum is None else {"enum": enum})}
        self.always |= {path, number} if fallback is not None else set()
        self.scope.entries[field.name] = KsyEntry(number, "int")
        if field.limits is not None:
            self._verify_here(field.name, f"{number} >= {field.limits[0]} and {number} <= {field.limits[1]}")
        for text in self._valid(field, number):
            self._verify_here(field.name, text)
        if field.is_ is not None and field.constants is None:
            self._compare_is(field, lambda text: self._verify_here(field.name, f"{number} == {text}"), "int")

    def _number(
        self, segment: Segment, name: str, type_: FieldType, limits: tuple[int, int] | None, plus: int,
        zero_means: int | None, unit: int = 1, *, values: Mapping[int, str] | None = None,
        default: Expression | None = None, condition: str | None = None,
    ) -> tuple[Keys, KsyForm]:  # fmt: skip
        """Write a value; return its keys, and its form, whose `value` converts the number to framekit's value."""
        keys, form = self._attribute(segment, name, type_)
        value = _value_of(form, plus, zero_means, unit)
        is_plain = value("_") == "_"
        enum = None if values is None or form.kind != "int" else self.file.enum(name, values, segment.at)
        path = self.names.new(f"{name}_raw") if form.not_said else self._own(name)
        fallback = None
        if default is not None and condition is not None and not form.not_said:
            fallback = self._default(segment, default, values, type_)
        apart = not is_plain or fallback is not None or (enum is not None and name in self.frame.asked)
        raw = self.names.new(f"{name}_raw") if apart else path
        keys = {"id": raw, **keys}
        self.seq.append(keys)
        if form.more:
            self.seq.append({"contents": list(form.more)})
        number = path
        if apart:
            is_short = _is_short(type_, plus != 0 or unit != 1)
            text = value(raw) if is_plain or form.kind != "int" or is_short else wide(value(raw))
            text = text if fallback is None else f"({condition} ? {text} : {fallback})"
            number = self._instance(name, path, raw, text, enum, is_raw=is_plain and fallback is None)
            self.always |= {path, number} if fallback is not None else set()
        elif enum is not None:
            keys["enum"] = enum
        is_natural = _is_natural(type_, limits, plus)
        self.scope.entries[name] = KsyEntry(number, form.kind, {}, form.not_said, is_natural)
        if limits is not None and form.is_number and not form.not_said:
            low, high = limits
            self._verify(keys, f"{value('_')} >= {low} and {value('_')} <= {high}", name)
        return keys, replace(form, value=None if is_plain else value)

    def _instance(self, name: str, path: str, raw: str, text: str, enum: str | None, *, is_raw: bool) -> str:
        """Add the instance of a value; return the path of its number, which an enumeration would hide.

        `is_raw`: the value is its raw number. Otherwise the number is an instance of its own if expressions read it.
        """
        if enum is None:
            self.instances[path] = {"value": text}
            return path
        number = raw
        if not is_raw and name in self.frame.asked:
            number = self.names.new(f"{name}_number")
            self.instances[number] = {"value": text}
            text = number
        self.instances[path] = {"value": text, "enum": enum}
        return number

    def _default(
        self, segment: Segment, default: Expression, values: Mapping[int, str] | None, type_: FieldType | None = None
    ) -> str | None:  # fmt: skip
        try:
            return self._constant(default, values, type_)
        except CannotSayError as error:
            self._tell(segment, f"{segment.title} has no default: {error.problem.what}", error.problem.todo)
            return None

    def _constant(
        self, expression: Expression, values: Mapping[int, str] | None, type_: FieldType | None = None
    ) -> str:  # fmt: skip
        """Return the text of an expression.

        A name becomes its number, a fraction is rounded as a field of the type does.
        """
        if isinstance(expression.root, Real):
            number = float(expression.root.value)
            if type_ is not None and type_.float_bits == 32:
                number = struct.unpack("f", struct.pack("f", number))[0]
            return f"({number!r})"
        if isinstance(expression.root, (Text, Name)):
            word = expression.root.value if isinstance(expression.root, Text) else expression.root.name
            for number, name in (values or {}).items():
                if name == word:
                    return str(number)
        return self.expressions.value(expression, self.scope).text

    def _valid(self, field: Field, value: str) -> Iterator[str]:
        """Yield the conditions on a value with constants or exclusive names."""
        if field.constants is not None:
            yield " or ".join(f"{value} == {_literal(one)}" for one in field.constants)
        if field.only and field.values:
            yield " or ".join(f"{value} == {number}" for number in field.values)

    def _verify(self, keys: Keys, text: str, name: str) -> None:
        """Add a condition on `_`, the value read under this name."""
        enum = keys.pop("enum", None)
        if enum is not None:  # compare the number; the value is its name
            path = keys["id"]
            keys["id"] = self.names.new(f"{path}_raw")
            self.instances[path] = {"value": keys["id"], "enum": enum}
            self.scope.entries[name] = replace(self.scope.entries[name], path=keys["id"])
        known = keys.get("valid", {}).get("expr")
        keys["valid"] = {"expr": text if known is None else f"({known}) and ({text})"}

    def _counted(self, segment: Length | Count) -> None:
        """Compare a length or count with the counted segments, unless their size follows from it."""
        try:
            number = self._known(segment, segment.name)
            text = self._items_of(segment) if isinstance(segment, Count) else self._bytes_of(segment)
        except CannotSayError as error:
            what = f"the {segment.KEY} '{segment.name}' is read and not compared"
            self._tell(segment, f"{what}: {error.problem.what}", error.problem.todo)
            return
        if text:
            self._verify_here(segment.name, f"{number} == {_plus(text, segment.plus)}")

    def _items_of(self, count: Count) -> str:
        """Return the text of the number of items; empty if the list takes its length from the count."""
        counted = next((one for one in self.segments if one.name == count.of and isinstance(one, Repeat)), None)
        if counted is None:
            raise self._not(count, f"'{count.of}'", "it is a part of something else")
        if not count.plus and counted.when is None and _is_name(counted.times, count.name):
            return ""
        return f"{self._known(counted, count.of)}.size"

    def _bytes_of(self, length: Length) -> str:
        """Return the text of the counted bytes in the unit of a length; empty if their size follows from the length."""
        counted = [one for one in self.segments if one.name in length.of]
        if len(counted) < len(length.of):
            raise self._not(length, "what it counts", "it is a part of something else")
        if len(counted) == 1 and length.unit == 1 and not length.plus and counted[0].when is None:
            one = counted[0]
            converted = getattr(one, "convert", None)
            is_same = converted is None or (converted == "hex_to_ascii" and length.plain)
            is_same = is_same and not (length.plain and isinstance(one, Wrap)) and getattr(one, "long", None) is None
            if is_same and _is_name(one.size_expression, length.name):
                return ""
        text = " + ".join(self._bytes_in(length, one) for one in counted)
        return f"({text})" if length.unit == 1 else f"(({text}) / {length.unit})"

    def _bytes_in(self, length: Length, segment: Segment) -> str:
        """Return the text of the size of a segment, encoded or before its conversion. Raises CannotSayError."""
        is_plain_size = length.plain and (getattr(segment, "convert", None) or isinstance(segment, Wrap))
        fixed = self.file.static.present(segment).fixed
        if fixed is not None and not is_plain_size:
            if segment.when is None or fixed == 0:
                return str(fixed)
            return f"({self.expressions.condition(segment.when, self.scope)} ? {fixed} : 0)"
        if isinstance(segment, Data):
            path = self._known(segment, segment.name)
            convert = segment.convert if length.plain else None
            return f"{path}.length{ {'hex_to_ascii': ' / 2', 'ascii_to_hex': ' * 2'}.get(convert or '', '') }"
        if isinstance(segment, Repeat):
            each = None if segment.align > 1 else self._size_of_items(segment)
            if each is not None:
                return f"{self._known(segment, segment.name)}.size * {each}"
        raise self._not(length, segment.title, "Kaitai does not tell how many bytes it takes")

    def _size_of_items(self, repeat: Repeat) -> int | None:
        if isinstance(repeat.of, FieldType):
            return repeat.of.fixed_size
        return self.file.static.all(repeat.of).fixed

    def _known(self, segment: Segment, name: str) -> str:
        """Return the path of a value that is always present. Raises CannotSayError for other values."""
        entry = self.scope.entries[name]
        if entry.why_not or not self.scope.is_there(entry):
            raise self._not(segment, f"'{name}'", entry.why_not or "it may be absent")
        return entry.path

    def _bits(self, bits: Bits) -> None:
        size, type_ = bits.type.fixed_size, bits.type
        if size is None:
            raise self._not(bits, "bits of a number of any size", "Kaitai has bits of fixed places")
        if type_.kind == "int" and size <= 8 and (size == 1 or type_.order in ("big", "little")):
            endian = "le" if type_.order == "little" else "be"
            self._native(bits, 8 * size, endian)
            return
        keys, form = self._attribute(bits, "bits", type_)
        if form.not_said or form.kind != "int":
            raise self._not(bits, f"bits of {bits.title}", form.not_said or "they belong to no whole number")
        path = self.names.new("bits")
        self.seq.append({"id": path, **keys})
        number = path if form.value is None else form.value(path)
        for part in bits.parts:
            name = self._own(part.name)
            most = (1 << part.high - part.low + 1) - 1
            shown = f"(({number} >> {part.low}) & {most})"
            self.instances[name] = {"value": shown if most < 1 << 31 else wide(shown)}
            self.scope.entries[part.name] = KsyEntry(name, "int", is_natural=True)
            enum = None if part.values is None else self.file.enum(part.name, part.values, part.at)
            if enum is not None:
                number_of = self.names.new(f"{name}_number")
                self.instances[number_of] = self.instances.pop(name)
                self.instances[name] = {"value": number_of, "enum": enum}
                self.scope.entries[part.name] = KsyEntry(number_of, "int", is_natural=True)
            self._bits_are(bits, part, None, "")

    def _native(self, bits: Bits, width: int, endian: str) -> None:
        """Write bits as Kaitai's bit fields, from the highest or, in a little-endian number, from the lowest."""
        parts = sorted(bits.parts, key=lambda one: one.low, reverse=endian == "be")
        place = width if endian == "be" else 0
        for part in [*parts, None]:
            if part is None:
                gap = place if endian == "be" else width - place
            else:
                gap = place - part.high - 1 if endian == "be" else part.low - place
                place = part.low if endian == "be" else part.high + 1
            if gap > 0:
                self.seq.append({"type": f"b{gap}{endian}"})
            if part is not None:
                self._native_part(bits, part, endian)

    def _native_part(self, bits: Bits, part: BitsPart, endian: str) -> None:
        count = part.high - part.low + 1
        path = name = self._own(part.name)
        kind = "bool" if count == 1 else "int"
        enum = None if part.values is None else self.file.enum(part.name, part.values, part.at)
        if enum is not None:
            path = self.names.new(f"{name}_raw")
            self.instances[name] = {"value": f"({path} ? 1 : 0)" if kind == "bool" else path, "enum": enum}
        keys: Keys = {"id": path, "type": f"b{count}{endian}"}
        self.scope.entries[part.name] = KsyEntry(path, kind, is_natural=True)
        self.seq.append(keys)
        value = "(_ ? 1 : 0)" if kind == "bool" else "_"
        self._bits_are(bits, part, keys, value)

    def _bits_are(self, bits: Bits, part: BitsPart, keys: Keys | None, value: str) -> None:
        """Compare bits with their constants, or with `is`, immediately or after all names are known.

        `keys`: the attribute that reads `value`; None: the bits are compared by their path in a later attribute.
        """

        def path() -> str:
            entry = self.scope.entries[part.name]
            return f"({entry.path} ? 1 : 0)" if entry.kind == "bool" else entry.path

        def verify(text: str) -> None:
            if keys is None:
                self._verify_here(part.name, text)
            else:
                self._verify(keys, text, part.name)

        is_ = part.is_
        if part.constants is not None:
            verify(" or ".join(f"{value or path()} == {number}" for number in part.constants))
            return
        if is_ is None:
            return

        def last() -> None:
            try:
                self._verify_here(part.name, f"{path()} == {self._constant(is_, part.values)}")
            except CannotSayError as error:
                self.file.tell(part.at, f"'{part.name}' is not compared: {error.problem.what}", error.problem.todo)

        try:
            verify(f"{value or path()} == {self._constant(is_, part.values)}")
        except CannotSayError:
            self.at_end.append((bits, last))

    # ---- bytes ----------------------------------------------------------------------------------------------

    def _data(self, segment: Data, after: BytesBehind, following: Segment | None) -> None:
        is_raw = segment.convert is not None or segment.swap
        path = self.names.new(f"{segment.name}_raw") if is_raw else self._own(segment.name)
        if segment.size == "rest":
            size = self._rest(segment, after, following, segment.never)
        elif isinstance(segment.size, int):
            size = {"size": segment.on_wire(segment.size)}
        else:
            text = self.expressions.number(segment.size, self.scope)
            shown = {"hex_to_ascii": f"{text} * 2", "ascii_to_hex": f"{text} / 2"}.get(segment.convert or "", text)
            size = {"size": shown}
        keys: Keys = {"id": path, **size}
        self.seq.append(keys)
        if segment.least and not isinstance(segment.size, int):
            least = -(-segment.least // 2) if segment.convert == "ascii_to_hex" else segment.on_wire(segment.least)
            keys["valid"] = {"expr": f"_.length >= {least}"}
        if segment.never and [*segment.never] != [size.get("terminator")]:
            what = f"the bytes of '{segment.name}' are not looked at"
            self._tell(segment, what, "Kaitai does not look for bytes that never stand in them")
        why = ""
        if is_raw:
            why = "Kaitai makes no bytes of digits" if segment.convert is not None else "Kaitai turns no bytes round"
            self._tell(segment, f"'{segment.name}' stays as it is on the wire", why)
        self.scope.entries[segment.name] = KsyEntry(path, "bytes", {}, why)

    def _rest(self, segment: Segment, after: BytesBehind, following: Segment | None, never: bytes = b"") -> Keys:
        """Return the keys for the end of a segment that takes the rest: end of the stream, size, or terminator."""
        if after.is_nothing:
            return {"size-eos": True}
        if not after.is_open:
            return {"size": self._room(segment, after)}
        if isinstance(following, Const) and following.when is None and following.data[0] in never:
            return {"terminator": following.data[0], "consume": False}
        return {"size": self._room(segment, after)}

    def _value(self, value: Value) -> bool:
        """Write a computed value if all names it needs are known; return whether they are."""
        try:
            said = self.expressions.value(value.read, self.scope)
        except CannotSayError as error:
            self.scope.entries[value.name] = KsyEntry("", "any", {}, error.problem.todo)
            return False
        path = self._own(value.name)
        self.instances[path] = {"value": wide(said.text) if said.kind == "int" else said.text}
        self.scope.entries[value.name] = KsyEntry(path, said.kind)
        return True

    def _last_value(self, value: Value) -> None:
        """Write a value that depends on later segments."""
        try:
            self.expressions.value(value.read, self.scope)
        except CannotSayError as error:
            what = f"the value '{value.name}' is left out: {error.problem.what}"
            self._tell(value, what, error.problem.todo)
            return
        self._value(value)

    def _require(self, require: Require) -> None:
        try:
            text = self.expressions.condition(require.condition, self.scope)
        except CannotSayError as error:
            self._tell(require, f"a condition is not looked at: {error.problem.what}", error.problem.todo)
            return
        self.seq.append({"id": self.names.new("require"), "size": 0, "valid": {"expr": text}})

    # ---- what holds others ----------------------------------------------------------------------------------

    def _repeat(self, repeat: Repeat, after: BytesBehind) -> None:
        if repeat.align > 1:
            raise self._not(repeat, f"the items of '{repeat.name}', which are aligned", "Kaitai fills nothing up")
        region = repeat.times == "rest" and not after.is_nothing
        room = self._room(repeat, after) if region else None
        path = self._own(repeat.name)
        if region:  # a separate stream that the items fill
            holder = KsyBlock(self.frame, TypeScope(self.scope))
            holder.scope.entries[repeat.name] = _LATER
            holder._items(repeat, "items")
            type_ = self.frame.names.new_type(f"{repeat.name}_list")
            self.frame.types[type_] = holder.keys()
            raw = self.names.new(f"{repeat.name}_raw")
            self.seq.append({"id": raw, "size": room, "type": type_})
            self.instances[path] = {"value": f"{raw}.items"}
            members = holder.scope.entries[repeat.name].members
            self.scope.entries[repeat.name] = KsyEntry(path, "list", members)
        else:
            self._items(repeat, path)

    def _items(self, repeat: Repeat, path: str) -> None:
        of = repeat.of
        keys: Keys
        members: Mapping[str, KsyEntry] = {}
        if isinstance(of, FieldType):
            form = form_of(of)
            if form.value is None and not form.more and not form.not_said:
                keys, _ = self._attribute(repeat, repeat.name, of)
            else:
                of = (Field(at=repeat.at, name=PLAIN, type=of),)
        if not isinstance(of, FieldType):
            type_, block = self._child(f"{repeat.name}_item", of, OPEN, items=True)
            members = {} if repeat.plain_type is not None else block.scope.entries
            keys = {"type": f"{type_}(_index)" if block.params else type_}
        if repeat.times == "rest":
            keys["repeat"] = "eos"
        elif repeat.times is not None:
            times = self._size(repeat.times)
            if isinstance(repeat.times, Expression) and not self.expressions.is_natural(repeat.times, self.scope):
                self._verify_here(f"{repeat.name}_times", f"{times} >= 0")
            keys |= {"repeat": "expr", "repeat-expr": times}
        else:
            assert repeat.until is not None
            scope = TypeScope(self.scope, "")
            scope.entries = {name: entry.behind("_") for name, entry in block.scope.entries.items()}
            scope.entries[INDEX] = KsyEntry("_index", "int", is_natural=True)
            keys |= {"repeat": "until", "repeat-until": self.expressions.condition(repeat.until, scope)}
        self.seq.append({"id": path, **keys})
        self.scope.entries[repeat.name] = KsyEntry(path, "list", members)

    def _choose(self, choose: Choose, after: BytesBehind) -> None:
        on = self.expressions.said(choose.on.root, self.scope)
        on = Said(f"({on.text} ? 1 : 0)", "int") if on.kind == "bool" else on
        path = self.names.new(_name(choose, "choice"))
        cases: Keys = {}
        chosen = object()
        for number, (keys, segments) in enumerate(choose.cases):
            part: Presence = chosen, number
            type_, block = self._child(f"case_{'_'.join(map(str, keys[:2]))}", segments, after, part=part)
            self._up(block, f"{path}.as<{type_}>", part)
            cases |= {string(one) if isinstance(one, str) else str(one): type_ for one in keys}
        if choose.otherwise is not None:
            part = chosen, None
            type_, block = self._child("case_else", choose.otherwise, after, part=part)
            self._up(block, f"{path}.as<{type_}>", part)
            cases["_"] = type_
        else:
            cases["_"] = UNEXPECTED
        self.seq.append({"id": path, "type": {"switch-on": on.text, "cases": cases}})

    def _optional(self, optional: Optional, after: BytesBehind) -> None:
        room = self._room(optional, after)
        path = self.names.new(_name(optional, "optional"))
        part: Presence = object(), None
        type_, block = self._child(path, optional.of, after, part=part)
        self.seq.append({"id": path, "type": type_, "if": f"{room} > 0"})
        self._up(block, path, part)

    def _wrap(self, wrap: Wrap, after: BytesBehind, following: Segment | None) -> None:
        path = self.names.new(_name(wrap, "content"))
        never = bytes(sorted(wrap.coding.never))
        size = {"size": self._size(wrap.size)} if wrap.size is not None else self._rest(wrap, after, following, never)
        if isinstance(wrap.coding, Plain):
            type_, block = self._child(path, wrap.of, NOTHING_BEHIND, whole=True, part=(object(), None))
            self.seq.append({"id": path, **size, "type": type_})
            self._up(block, path)
            for sign, most in ((">=", wrap.least or None), ("<=", wrap.most)):
                if most is not None:
                    self._verify_here(path, f"{path}._io.size {sign} {self._size(most)}")
            return
        self.seq.append({"id": path, **size})
        doc = f"Coded: {prose(wrap.coding.shown)}."
        try:
            type_, block = self._child(f"{path}_plain", wrap.of, NOTHING_BEHIND, apart=True, whole=True)
            doc += f" The type {type_} reads it when that is undone."
        except CannotSayError as error:
            what = f"the content of {wrap.title} is left out: {error.problem.what}"
            self.file.tell(error.problem.at, what, error.problem.todo)
        self.seq[-1]["doc"] = doc
        why = f"Kaitai does not undo {wrap.coding.shown}"
        self._tell(wrap, f"the content of {wrap.title} stays as it is on the wire", why)
        self.scope.entries |= {name: KsyEntry("", "any", {}, why) for name in by_value_name(wrap.of)}

    # ---- frames inside --------------------------------------------------------------------------------------

    def _inner(self, inner: Inner, after: BytesBehind) -> None:
        path = self._own(inner.name)
        keys: Keys = {"id": path}
        if isinstance(inner.size, (int, Expression)):
            keys["size"] = self._size(inner.size)
        elif not after.is_open:
            keys |= self._rest(inner, after, None)
        else:
            seen: set[str] = set()
            if any(self._needs_end(name, seen) for name in inner.frames):
                why = "what stands behind it has no fixed size"
                raise self._not(inner, f"where the frame '{inner.name}' ends", why)
            self.file.without_end |= seen
        self.file.inside |= {*inner.frames} if len(keys) > 1 else set()
        frames = in_order(self.file.static, inner.frames)
        if len(frames) == 1:
            keys["type"] = self.file.types[frames[0]]
        else:
            keys["type"] = FramesInside(self.file, self.names, self.instances).told_apart(
                inner, path, frames, keys.get("size", HERE)
            )
            if "size" in keys or "size-eos" in keys:  # in a sized region, bytes that are no frame stay bytes
                keys["type"]["cases"].pop("_", None)
        self.seq.append(keys)
        self.scope.entries[inner.name] = KsyEntry(path, "inner")

    def _needs_end(self, name: str, seen: set[str]) -> bool:
        """Return whether a frame is read up to the end of the stream; `seen`: the frames already visited."""
        if name in seen:
            return False
        seen.add(name)
        parts = [*everything(self.file.static.segments(self.file.protocol.frames[name]))]
        inside = (one for part in parts for one in part.frames_inside)
        return any(map(_takes_rest, parts)) or any(self._needs_end(one, seen) for one in inside)


def _value_of(form: KsyForm, plus: int, zero_means: int | None, unit: int) -> Callable[[str], str]:
    """Return a function that converts the path of a raw value to the text of framekit's value."""
    is_wide = plus != 0 or unit != 1

    def value(path: str) -> str:
        text = form.value(path) if form.value is not None else path
        return _value_text(wide(text) if is_wide else text, plus, zero_means, unit) if form.is_number else text

    return value


def _is_natural(type_: FieldType, limits: tuple[int, int] | None, plus: int) -> bool:
    """Return whether a value is never less than 0."""
    bounds = limits or type_.bounds
    return bounds is not None and bounds[0] >= 0 and (limits is not None or plus <= 0)


def _is_short(type_: FieldType, is_changed: bool) -> bool:
    """Return whether a computed number has at most 32 bits."""
    bounds = type_.bounds
    return not is_changed and bounds is not None and bounds[0] >= -(1 << 31) and bounds[1] < 1 << 31


def _value_text(number: str, plus: int, zero_means: int | None, unit: int) -> str:
    """Return the text of the value that an encoded number represents."""
    text = _plus(number, -plus)
    text = f"({text} * {unit})" if unit != 1 else text
    return text if zero_means is None else f"({number} == 0 ? {zero_means} : {text})"


def _plus(number: str, more: int) -> str:
    return f"({number} {'+' if more > 0 else '-'} {abs(more)})" if more else number


def _is_name(size: object, name: str) -> bool:
    """Return whether a size consists only of this name."""
    return isinstance(size, Expression) and isinstance(size.root, Name) and size.root.name == name


def _takes_rest(segment: Segment) -> bool:
    """Return whether a segment ends with the stream."""
    if isinstance(segment, Inner):
        return not isinstance(segment.size, (int, Expression))
    return segment.takes_rest or isinstance(segment, (Fill, Optional)) or getattr(segment, "times", 0) == "rest"


def _name(segment: Segment, word: str) -> str:
    """Return the name of a segment in the definition, or `word` if it has none."""
    return segment.name if segment.name and not segment.name.startswith("_") else word


def _literal(value: int | str | bytes) -> str:
    if isinstance(value, int):
        return str(value) if value >= 0 else f"({value})"
    return string(value) if isinstance(value, str) else data(value)
