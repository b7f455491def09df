"""A Kaitai Struct file from a definition: a type for each frame, and one above them that is told which frame it is.

The stream holds one whole frame, as `framekit decode` is given it. What Kaitai cannot say is told with its place; a
frame that cannot be read without it becomes a type that reads nothing and fails, so that no wrong value is shown.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from framekit.codec.kaitai.expressions import KaitaiExpressions, KsyEntry, Said, Scope
from framekit.codec.kaitai.forms import KsyForm, form_of
from framekit.codec.kaitai.source import KsyNames, data, identifier, string
from framekit.codec.python.choices import Leaf, Switch, in_order, tree_of
from framekit.definition.codings import Plain
from framekit.definition.expression import Expression, Name, Text, names_in
from framekit.definition.model.frames import Frame, StaticSizes, by_value_name, everything, expressions_of
from framekit.definition.model.protocol import Protocol
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
from framekit.definition.problems import CannotSayError, Position, Problem, printable
from framekit.definition.written import comment, yaml_lines

Keys = dict[str, Any]
_HERE = "_io.size - _io.pos"
_FAILS: Keys = {"seq": [{"id": "nothing", "size": 0, "valid": {"expr": "false"}}]}


@dataclass(frozen=True, slots=True)
class KaitaiFile:
    """The file. `types`: frame → name of its type; `frames`: those that are read; `params`: what the top type takes."""

    name: str
    text: str
    types: Mapping[str, str]
    frames: tuple[str, ...]
    params: tuple[str, ...]
    left_out: tuple[Problem, ...]


def generate_kaitai(protocol: Protocol) -> KaitaiFile:
    """The file of a protocol."""
    return _FileWriter(protocol).write()


@dataclass(frozen=True, slots=True)
class BytesBehind:
    """The bytes behind a part of a stream: a number, and what parameters add. `is_open`: nothing says how many."""

    fixed: int = 0
    more: str = ""
    is_open: bool = False

    @property
    def text(self) -> str:
        return f"{self.fixed}{self.more}"

    @property
    def is_nothing(self) -> bool:
        return not (self.fixed or self.more or self.is_open)


NOTHING_BEHIND = BytesBehind()
OPEN = BytesBehind(is_open=True)


class _FileWriter:
    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.static = StaticSizes(protocol.frames)
        self.expressions = KaitaiExpressions(protocol)
        self.problems: dict[Problem, None] = {}
        self.enums: dict[str, Mapping[int, str]] = {}
        self.names = KsyNames(("frame_kind", "unexpected"))
        self.name = self.names.new(protocol.name)
        self.types = {frame: self.names.new(frame) for frame in protocol.frames}

    def tell(self, at: Position, what: str, why: str) -> None:
        self.problems.setdefault(Problem(at, what, why))

    def enum(self, name: str, values: Mapping[int, str]) -> str:
        """The name of an enumeration of these numbers."""
        for known, numbers in self.enums.items():
            if numbers == values:
                return known
        made = self.names.new(name)
        self.enums[made] = values
        return made

    def write(self) -> KaitaiFile:
        protocol = self.protocol
        self.tell(
            protocol.at,
            "of the definition its frames stand here",
            "Kaitai knows no lines, time limits, repeats, sequences, services and addresses",
        )
        written: dict[str, Keys] = {}
        read: list[str] = []
        for name, frame in protocol.frames.items():
            try:
                written[self.types[name]] = _FrameWriter(self, frame).write()
                read.append(name)
            except CannotSayError as error:
                self.tell(error.problem.at, f"frame '{name}' is left out: {error.problem.what}", error.problem.todo)
                written[self.types[name]] = dict(_FAILS)
        params = self.expressions.params
        kinds = {"frame_kind": dict(enumerate(self.types.values()))} if self.types else {}
        top: Keys = {
            "meta": {
                "id": self.name,
                "title": f"{protocol.name}: {protocol.about}" if protocol.about else protocol.name,
                "ks-version": "0.11",
                "endian": "le" if protocol.order == "little" else "be",
                "bit-endian": "be",
            },
            "doc": "One whole frame; the parameter frame says which. Made by framekit from the definition.",
            "params": [
                {"id": "frame", "type": "s4", **({"enum": "frame_kind"} if self.types else {})},
                *({"id": identifier(name), "type": type_} for name, type_ in params.items()),
            ],
            "seq": [self._content(), {"id": "end", "size": 0, "valid": {"expr": "_io.eof"}}],
            "enums": {
                **kinds,
                **{name: _members(values) for name, values in self.enums.items()},
            },
            "types": {**written, "unexpected": _FAILS},
        }
        lines = [comment(f"What Kaitai does not say of {protocol.name}:"), *map(_told, self.problems), ""]
        text = "\n".join([*lines, *yaml_lines(top)]) + "\n"
        return KaitaiFile(self.name, text, self.types, tuple(read), ("frame", *params), tuple(sorted(self.problems)))

    def _content(self) -> Keys:
        cases = {f"frame_kind::{type_}": type_ for type_ in self.types.values()}
        return {"id": "content", "type": {"switch-on": "frame", "cases": cases or {"_": "unexpected"}}}


def _members(values: Mapping[int, str]) -> Keys:
    names = KsyNames()
    found: Keys = {}
    for number, text in values.items():
        name = names.new(text)
        found[str(number)] = name if name == text else {"id": name, "doc": text}
    return {int(number): one for number, one in found.items()}  # type: ignore[misc]


def _told(problem: Problem) -> str:
    place = f"{Path(problem.at.file).name}:{problem.at.line}:{problem.at.column}"
    return comment(printable(f"  {place}: {problem.what} – {problem.todo}"))


class _FrameWriter:
    """Writes a frame: its type, and the types of records, items and cases inside that."""

    def __init__(self, file: _FileWriter, frame: Frame) -> None:
        self.file = file
        self.frame = frame
        self.names = KsyNames((*file.types.values(), "unexpected"))
        self.types: dict[str, Keys] = {}
        self.asked = {name for one in expressions_of(frame.segments) for name in names_in(one.root)}

    def write(self) -> Keys:
        block = KsyBlock(self, Scope())
        if self.frame.inside:
            what = f"frames that interrupt '{self.frame.name}' are left out"
            self.file.tell(self.frame.at, what, "Kaitai cannot pass over bytes in between")
        block.write(self.file.static.segments(self.frame), NOTHING_BEHIND)
        doc = {"doc": self.frame.doc} if self.frame.doc else {}
        return {**doc, **block.keys(), **({"types": self.types} if self.types else {})}


class KsyBlock:
    """A type being written. Raises CannotSayError for what it cannot be read without."""

    def __init__(self, frame: _FrameWriter, scope: Scope) -> None:
        self.frame, self.file, self.scope = frame, frame.file, scope
        self.expressions = frame.file.expressions
        self.names = KsyNames()
        self.params: list[Keys] = []
        self.seq: list[Keys] = []
        self.instances: dict[str, Keys] = {}
        self.always: set[str] = set()
        """Values that are there whatever their condition says: they have a default."""

    def keys(self) -> Keys:
        parts = {"params": self.params, "seq": self.seq, "instances": self.instances}
        return {name: part for name, part in parts.items() if part} or {"seq": []}

    def write(self, segments: Segments, behind: BytesBehind) -> None:
        """The segments; `behind`: bytes that stand behind them in the stream."""
        for place, segment in enumerate(segments):
            after = self._behind(segments[place + 1 :], behind)
            following = segments[place + 1] if place + 1 < len(segments) else None
            self._segment(segment, after, following)

    def _behind(self, segments: Segments, behind: BytesBehind) -> BytesBehind:
        """What stands behind a segment: the others of its list, and what is behind that."""
        fixed, more = behind.fixed, behind.more
        for one in segments:
            size = self.file.static.present(one).fixed
            if size is None or behind.is_open:
                return OPEN
            if one.when is None or size == 0:
                fixed += size
                continue
            names = names_in(one.when.root)
            if any(self.scope.find(name) is not None or name not in self.file.protocol.params for name in names):
                return OPEN
            try:
                more += f" - ({self.expressions.condition(one.when, self.scope)} ? {size} : 0)"
            except CannotSayError:
                return OPEN
        return BytesBehind(fixed, more, behind.is_open)

    def _segment(self, segment: Segment, after: BytesBehind, following: Segment | None) -> None:
        first = len(self.seq)
        made = len(self.instances)
        condition = None if segment.when is None else self.expressions.condition(segment.when, self.scope)
        match segment:
            case Const():
                self.seq.append({"contents": list(segment.data)})
            case Field():
                self._field(segment, condition)
            case Length() | Count():
                self._number(segment, segment.name, segment.type, segment.limits, 0, segment.zero_means)
                if isinstance(segment, Length) and segment.name not in self.frame.asked:
                    what = f"the length '{segment.name}' is read and not compared"
                    self._tell(segment, what, "what it counts ends in another way, and stands behind it")
            case Bits():
                self._bits(segment)
            case Data():
                self._data(segment, after, following)
            case Check():
                self.seq.append({"id": self.names.new(_name(segment, "check")), "size": segment.size})
                what = f"the check code {segment.method.name} is read and not verified"
                self._tell(segment, what, "Kaitai works out no check codes")
            case Skip():
                self.seq.append({"size": segment.size})
            case Fill():
                self.seq.append({"size": self._room(segment, after)})
            case Value():
                self._value(segment, condition)
            case Require():
                self._require(segment)
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
                path = self.names.new(segment.name)
                self.seq.append({"id": path, "type": self.file.types[segment.frame]})
                self.scope.entries[segment.name] = KsyEntry(path, "record")
            case ItemEnd():
                pass
            case Segment(is_record=True):
                name = segment.name or "record"
                type_, block = self._child(name, segment.members, after)
                path = self.names.new(name)
                self.seq.append({"id": path, "type": type_})
                self.scope.entries[name] = KsyEntry(path, "record", block.scope.entries)
            case _:
                raise self._not(segment, "a kind of segment of a program's own", "Kaitai has nothing like it")
        if condition is not None:
            for one in self.seq[first:]:
                one["if"] = f"{condition} and {one['if']}" if "if" in one else condition
            for path, one in [*self.instances.items()][made:]:
                if "pos" not in one and path not in self.always:
                    one.setdefault("if", condition)
        if segment.doc and len(self.seq) > first:
            self.seq[first].setdefault("doc", segment.doc)

    # ---- words ----------------------------------------------------------------------------------------------

    def _not(self, segment: Segment, what: str, why: str) -> CannotSayError:
        return CannotSayError(segment.at, what, why)

    def _tell(self, segment: Segment, what: str, why: str) -> None:
        self.file.tell(segment.at, what, why)

    def _room(self, segment: Segment, after: BytesBehind) -> str:
        """The bytes that are left for a segment. Raises CannotSayError."""
        if after.is_open:
            raise self._not(segment, f"where {segment.title} ends", "what stands behind it has no fixed size")
        return _HERE if after.is_nothing else f"{_HERE} - {after.text}"

    def _child(
        self, name: str, segments: Segments, behind: BytesBehind, *, apart: bool = False, items: bool = False
    ) -> tuple[str, KsyBlock]:
        """A type of its own. `apart`: it knows nothing of what is around; `items`: it is told its index, if it asks."""
        scope = Scope() if apart else Scope(self.scope)
        block = KsyBlock(self.frame, scope)
        type_ = self.frame.names.new(name)
        if items and any(INDEX in names_in(one.root) for one in expressions_of(segments)):
            index = block.names.new("index")
            block.params.append({"id": index, "type": "s4"})
            scope.entries[INDEX] = KsyEntry(index, "int")
        block.write(segments, behind)
        self.frame.types[type_] = block.keys()
        scope.entries.pop(INDEX, None)
        return type_, block

    def _up(self, block: KsyBlock, path: str) -> None:
        """Values of a type inside that belong to the record of this one."""
        for name, entry in block.scope.entries.items():
            known = self.scope.entries.get(name)
            found = entry.behind(path)
            self.scope.entries[name] = found if known is None else replace(
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
        return keys, form

    def _field(self, field: Field, condition: str | None) -> None:
        if field.long is not None:
            self._long(field, condition)
            return
        number = self._number(
            field, field.name, field.type, field.limits, field.plus, field.zero_means, field.unit or 1,
            values=field.values, default=field.default if field.when is not None else None, condition=condition,
        )  # fmt: skip
        for text in self._valid(field, number):
            self._verify(self.seq[-1], text)

    def _long(self, field: Field, condition: str | None) -> None:
        assert field.long is not None
        self._number(field, f"{field.name}_short", field.type, None, 0, None)
        first = self.scope.entries.pop(f"{field.name}_short")
        is_long = f"{first.path} == {field.long.mark}"
        self._number(field, f"{field.name}_long", field.long.type, None, 0, None)
        self.seq[-1]["if"] = is_long
        second = self.scope.entries.pop(f"{field.name}_long")
        value = f"({is_long} ? {second.path} : {first.path})"
        value = f"{value} - {field.plus}" if field.plus else value
        path = self.names.new(field.name)
        if field.default is not None and condition is not None:
            fallback = self._default(field, field.default, field.values)
            value = value if fallback is None else f"({condition} ? {value} : {fallback})"
            self.always |= {path} if fallback is not None else set()
        self.instances[path] = {"value": value}
        self.scope.entries[field.name] = KsyEntry(path, "int")

    def _number(
        self, segment: Segment, name: str, type_: FieldType, limits: tuple[int, int] | None, plus: int,
        zero_means: int | None, unit: int = 1, *, values: Mapping[int, str] | None = None,
        default: Expression | None = None, condition: str | None = None,
    ) -> KsyForm:  # fmt: skip
        """One value; gives its form, whose `value` makes of what was read what framekit does."""
        keys, form = self._attribute(segment, name, type_)

        def value(path: str) -> str:
            text = form.value(path) if form.value is not None else path
            text = f"({text} - {plus})" if plus > 0 else f"({text} + {-plus})" if plus else text
            text = f"({text} * {unit})" if unit != 1 else text
            number = form.value(path) if form.value is not None else path
            return text if zero_means is None else f"({number} == 0 ? {zero_means} : {text})"

        is_plain = value("_") == "_"
        enum = None if values is None or form.kind != "int" else self.file.enum(name, values)
        path = self.names.new(f"{name}_raw" if form.not_said else name)
        fallback = None
        if default is not None and condition is not None:
            fallback = self._default(segment, default, values)
        apart = not is_plain or fallback is not None or (enum is not None and name in self.frame.asked)
        raw = self.names.new(f"{name}_raw") if apart else path
        self.seq.append({"id": raw, **keys})
        if form.more:
            self.seq.append({"contents": list(form.more)})
        if apart:
            text = value(raw)
            text = text if fallback is None else f"({condition} ? {text} : {fallback})"
            asked = path
            if enum is not None and not is_plain and name in self.frame.asked:
                asked = self.names.new(f"{name}_number")
                self.instances[asked] = {"value": text}
                text = asked
            elif enum is not None:
                asked = raw
            self.instances[path] = {"value": text, **({"enum": enum} if enum is not None else {})}
            self.always |= {path} if fallback is not None else set()
        else:
            asked = path
            if enum is not None:
                self.seq[-1]["enum"] = enum
        self.scope.entries[name] = KsyEntry(asked, form.kind)
        if form.not_said and form.kind != "str":
            self.scope.entries[name] = KsyEntry(asked, form.kind, {}, form.not_said)
        if limits is not None and unit == 1 and form.kind in ("int", "float"):
            low, high = limits
            self._verify(self.seq[-1], f"{value('_')} >= {low} and {value('_')} <= {high}")
        return replace(form, value=None if is_plain else value)

    def _default(self, segment: Segment, default: Expression, values: Mapping[int, str] | None) -> str | None:
        try:
            return self._constant(default, values)
        except CannotSayError as error:
            self._tell(segment, error.problem.what, error.problem.todo)
            return None

    def _constant(self, expression: Expression, values: Mapping[int, str] | None) -> str:
        """An expression, or the number of a name."""
        if isinstance(expression.root, (Text, Name)):
            word = expression.root.value if isinstance(expression.root, Text) else expression.root.name
            for number, name in (values or {}).items():
                if name == word:
                    return str(number)
        return self.expressions.value(expression, self.scope).text

    def _valid(self, field: Field, form: KsyForm) -> Iterator[str]:
        """The conditions on `_`, what was read."""
        value = "_" if form.value is None else form.value("_")
        if form.not_said and form.kind != "str":
            return
        if field.constants is not None:
            options = (f"{value} == {_literal(one)}" for one in field.constants)
            yield " or ".join(options)
        elif field.is_ is not None:
            try:
                yield f"{value} == {self._constant(field.is_, field.values)}"
            except CannotSayError as error:
                self._tell(field, f"'{field.name}' is not compared: {error.problem.what}", error.problem.todo)
        if field.only and field.values:
            yield " or ".join(f"{value} == {number}" for number in field.values)

    def _verify(self, keys: Keys, text: str) -> None:
        enum = keys.pop("enum", None)
        if enum is not None:  # what is compared is a number, and the value is the name of one
            path = keys["id"]
            keys["id"] = self.names.new(f"{path}_raw")
            self.instances[path] = {"value": keys["id"], "enum": enum}
            for name, entry in self.scope.entries.items():
                if entry.path == path:
                    self.scope.entries[name] = replace(entry, path=keys["id"])
        known = keys.get("valid", {}).get("expr")
        keys["valid"] = {"expr": text if known is None else f"({known}) and ({text})"}

    def _bits(self, bits: Bits) -> None:
        size, type_ = bits.type.fixed_size, bits.type
        if size is None:
            raise self._not(bits, "bits of a number of any size", "Kaitai has bits of fixed places")
        if type_.kind == "int" and size <= 8 and (size == 1 or type_.order in ("big", "little")):
            endian = "le" if type_.order == "little" else "be"
            self._native(bits, 8 * size, endian)
            return
        keys, form = self._attribute(bits, "bits", type_)
        path = self.names.new("bits")
        self.seq.append({"id": path, **keys})
        number = path if form.value is None else form.value(path)
        for part in bits.parts:
            name = self.names.new(part.name)
            self.instances[name] = {"value": f"(({number} >> {part.low}) & {part.most})"}
            self.scope.entries[part.name] = KsyEntry(name, "int")
            for text in self._of_bits(part, name):
                self.seq.append({"id": self.names.new(f"{name}_valid"), "size": 0, "valid": {"expr": text}})
            if part.values is not None:
                enum = self.file.enum(part.name, part.values)
                number_of = self.names.new(f"{name}_number")
                self.instances[number_of] = self.instances.pop(name)
                self.instances[name] = {"value": number_of, "enum": enum}
                self.scope.entries[part.name] = KsyEntry(number_of, "int")

    def _native(self, bits: Bits, width: int, endian: str) -> None:
        """Bits as Kaitai has them, from the highest or, in a little-endian number, from the lowest."""
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
                self._native_part(part, endian)

    def _native_part(self, part: BitsPart, endian: str) -> None:
        count = part.high - part.low + 1
        path = name = self.names.new(part.name)
        keys: Keys = {"type": f"b{count}{endian}"}
        kind = "bool" if count == 1 else "int"
        if part.values is not None:
            enum = self.file.enum(part.name, part.values)
            path = self.names.new(f"{name}_raw")
            self.instances[name] = {"value": f"({path} ? 1 : 0)" if kind == "bool" else path, "enum": enum}
        keys = {"id": path, **keys}
        self.scope.entries[part.name] = KsyEntry(path, kind)
        self.seq.append(keys)
        for text in self._of_bits(part, "(_ ? 1 : 0)" if kind == "bool" else "_"):
            self._verify(keys, text)

    def _of_bits(self, part: BitsPart, value: str) -> Iterator[str]:
        if part.constants is not None:
            yield " or ".join(f"{value} == {number}" for number in part.constants)
        elif part.is_ is not None:
            try:
                yield f"{value} == {self._constant(part.is_, part.values)}"
            except CannotSayError as error:
                self.file.tell(part.at, f"'{part.name}' is not compared: {error.problem.what}", error.problem.todo)

    # ---- bytes ----------------------------------------------------------------------------------------------

    def _data(self, segment: Data, after: BytesBehind, following: Segment | None) -> None:
        is_raw = segment.convert is not None or segment.swap
        path = self.names.new(f"{segment.name}_raw" if is_raw else segment.name)
        if segment.size == "rest":
            size = self._rest(segment, after, following, segment.never)
        elif isinstance(segment.size, int):
            size = {"size": segment.on_wire(segment.size)}
        else:
            text = self.expressions.number(segment.size, self.scope)
            shown = {"hex_to_ascii": f"{text} * 2", "ascii_to_hex": f"{text} / 2"}.get(segment.convert or "", text)
            size = {"size": shown}
        self.seq.append({"id": path, **size})
        why = ""
        if is_raw:
            why = "Kaitai makes no bytes of digits" if segment.convert is not None else "Kaitai turns no bytes round"
            self._tell(segment, f"'{segment.name}' stays as it is on the wire", why)
        self.scope.entries[segment.name] = KsyEntry(path, "bytes", {}, why)

    def _rest(self, segment: Segment, after: BytesBehind, following: Segment | None, never: bytes = b"") -> Keys:
        """How what takes the rest ends: with the stream, before what is behind, or at a constant."""
        if after.is_nothing:
            return {"size-eos": True}
        if not after.is_open:
            return {"size": self._room(segment, after)}
        if isinstance(following, Const) and following.when is None and following.data[0] in never:
            return {"terminator": following.data[0], "consume": False}
        return {"size": self._room(segment, after)}

    def _value(self, value: Value, condition: str | None) -> None:
        try:
            said = self.expressions.value(value.read, self.scope)
        except CannotSayError as error:
            why = error.problem.todo
            self._tell(value, f"the value '{value.name}' is left out: {error.problem.what}", why)
            self.scope.entries[value.name] = KsyEntry("", "any", {}, why)
            return
        path = self.names.new(value.name)
        self.instances[path] = {"value": said.text}
        self.scope.entries[value.name] = KsyEntry(path, said.kind)

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
        path = self.names.new(repeat.name)
        if region:  # a stream of its own, which the items fill
            holder = KsyBlock(self.frame, Scope(self.scope))
            holder._items(repeat, "items")
            type_ = self.frame.names.new(f"{repeat.name}_list")
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
            keys |= {"repeat": "expr", "repeat-expr": self._size(repeat.times)}
        else:
            assert repeat.until is not None
            scope = Scope(self.scope, "")
            scope.entries = {name: entry.behind("_") for name, entry in block.scope.entries.items()}
            scope.entries[INDEX] = KsyEntry("_index", "int")
            keys |= {"repeat": "until", "repeat-until": self.expressions.condition(repeat.until, scope)}
        self.seq.append({"id": path, **keys})
        self.scope.entries[repeat.name] = KsyEntry(path, "list", members)

    def _choose(self, choose: Choose, after: BytesBehind) -> None:
        on = self.expressions.said(choose.on.root, self.scope)
        on = Said(f"({on.text} ? 1 : 0)", "int") if on.kind == "bool" else on
        path = self.names.new(_name(choose, "choice"))
        cases: Keys = {}
        for keys, segments in choose.cases:
            type_, block = self._child(f"case_{'_'.join(map(str, keys[:2]))}", segments, after)
            self._up(block, f"{path}.as<{type_}>")
            cases |= {string(one) if isinstance(one, str) else str(one): type_ for one in keys}
        if choose.otherwise is not None:
            type_, block = self._child("case_else", choose.otherwise, after)
            self._up(block, f"{path}.as<{type_}>")
            cases["_"] = type_
        else:
            cases["_"] = "unexpected"
        self.seq.append({"id": path, "type": {"switch-on": on.text, "cases": cases}})

    def _optional(self, optional: Optional, after: BytesBehind) -> None:
        room = self._room(optional, after)
        path = self.names.new(_name(optional, "optional"))
        type_, block = self._child(path, optional.of, after)
        self.seq.append({"id": path, "type": type_, "if": f"{room} > 0"})
        self._up(block, path)

    def _wrap(self, wrap: Wrap, after: BytesBehind, following: Segment | None) -> None:
        path = self.names.new(_name(wrap, "content"))
        never = bytes(sorted(wrap.coding.never))
        size = {"size": self._size(wrap.size)} if wrap.size is not None else self._rest(wrap, after, following, never)
        if isinstance(wrap.coding, Plain):
            type_, block = self._child(path, wrap.of, NOTHING_BEHIND)
            self.seq.append({"id": path, **size, "type": type_})
            self._up(block, path)
            return
        self.seq.append({"id": path, **size})
        doc = f"Coded: {wrap.coding.shown}."
        try:
            type_, block = self._child(f"{path}_plain", wrap.of, NOTHING_BEHIND, apart=True)
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
        path = self.names.new(inner.name)
        keys: Keys = {"id": path}
        if isinstance(inner.size, (int, Expression)):
            keys["size"] = self._size(inner.size)
        elif not after.is_open:
            keys |= self._rest(inner, after, None)
        elif any(self._needs_end(name, frozenset()) for name in inner.frames):
            raise self._not(inner, f"where the frame '{inner.name}' ends", "what stands behind it has no fixed size")
        frames = in_order(self.file.static, inner.frames)
        if len(frames) == 1:
            keys["type"] = self.file.types[frames[0]]
        else:
            keys["type"] = self._told_apart(inner, path, frames, keys.get("size", _HERE))
        self.seq.append(keys)
        self.scope.entries[inner.name] = KsyEntry(path, "inner")

    def _needs_end(self, name: str, seen: frozenset[str]) -> bool:
        """Whether a frame is read up to the end of the stream."""
        if name in seen:
            return False
        parts = [*everything(self.file.static.segments(self.file.protocol.frames[name]))]
        inside = (one for part in parts for one in part.frames_inside)
        takes = any(one.takes_rest or isinstance(one, Fill) or getattr(one, "times", 0) == "rest" for one in parts)
        return takes or any(self._needs_end(one, seen | {name}) for one in inside)

    def _told_apart(self, inner: Inner, path: str, frames: tuple[str, ...], room: int | str) -> Keys:
        """Which frame it is, by the bytes at fixed places."""
        tree = tree_of(self.file.static, frames)
        types = {name: self.file.types[name] for name in frames}
        if isinstance(tree, Switch):
            branches = [leaf for _, leaf in tree.cases]
            if all(isinstance(one, Leaf) and len(one.frames) == 1 for one in branches) and len(tree.others.frames) < 2:
                peek = self._peek(path, tree.at)
                cases: Keys = {str(value): types[leaf.frames[0]] for value, leaf in tree.cases}
                cases["_"] = types[tree.others.frames[0]] if tree.others.frames else "unexpected"
                return {"switch-on": peek, "cases": cases}
        peeks: dict[int, str] = {}
        text = self._which(inner, tree, path, frames, str(room), peeks)
        which = self.names.new(f"{path}_which")
        self.instances[which] = {"value": text}
        cases = {str(number): types[name] for number, name in enumerate(frames)}
        return {"switch-on": which, "cases": {**cases, "_": "unexpected"}}

    def _peek(self, path: str, place: int) -> str:
        name = self.names.new(f"{path}_at_{place}")
        pos = f"_io.pos + {place}" if place else "_io.pos"
        self.instances[name] = {"pos": pos, "type": "u1", "if": f"{_HERE} > {place}"}
        return name

    def _which(
        self, inner: Inner, tree: Leaf | Switch, path: str, frames: tuple[str, ...], room: str, peeks: dict[int, str]
    ) -> str:  # fmt: skip
        """The number of the frame in `frames`; -1 for none."""
        if isinstance(tree, Leaf):
            return self._by_size(inner, tree.frames, frames, room)
        if tree.at not in peeks:
            peeks[tree.at] = self._peek(path, tree.at)
        peek = peeks[tree.at]
        text = self._which(inner, tree.others, path, frames, room, peeks)
        rows: dict[str, list[int]] = {}
        for value, branch in tree.cases:
            rows.setdefault(self._which(inner, branch, path, frames, room, peeks), []).append(value)
        for which, values in reversed(rows.items()):
            text = f"({_one_of(peek, values)} ? {which} : {text})"
        return f"({_HERE} > {tree.at} ? {text} : -1)"

    def _by_size(self, inner: Inner, left: tuple[str, ...], frames: tuple[str, ...], room: str) -> str:
        """Of frames that no byte tells apart, the first whose size fits; not those that exist to be refused."""
        if not left:
            return "-1"
        known = [name for name in left if self.file.protocol.frames[name].refuse is None] or [*left[:1]]
        sizes = [self.file.static.frame(name).fixed for name in known]
        if None in sizes[:-1] or len({*sizes}) < len(sizes):
            what = f"of {', '.join(known)} in '{inner.name}' the first is read whose size fits"
            self._tell(
                inner, what, "no byte at a fixed place tells them apart, and Kaitai does not try one after the other"
            )
        text = "-1"
        for name, size in reversed([*zip(known, sizes, strict=True)]):
            number = str(frames.index(name))
            text = number if size is None or len(known) == 1 else f"({room} == {size} ? {number} : {text})"
        return text


def _name(segment: Segment, word: str) -> str:
    """The name that a definition gives a segment, or what it is."""
    return segment.name if segment.name and not segment.name.startswith("_") else word


def _one_of(path: str, values: Iterable[int]) -> str:
    """Whether a number is one of these, rows of neighbours as ranges."""
    rows: list[list[int]] = []
    for value in sorted(values):
        if rows and rows[-1][1] == value - 1:
            rows[-1][1] = value
        else:
            rows.append([value, value])
    parts = (f"{path} == {a}" if a == b else f"({path} >= {a} and {path} <= {b})" for a, b in rows)
    return f"({' or '.join(parts)})"


def _literal(value: int | str | bytes) -> str:
    if isinstance(value, int):
        return str(value) if value >= 0 else f"({value})"
    return string(value) if isinstance(value, str) else data(value)
