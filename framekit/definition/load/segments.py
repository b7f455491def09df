"""Segments and types: from the nodes of a head, body, tail or layout to the model, with includes put in place."""

from __future__ import annotations

import re
from collections.abc import Callable
from collections.abc import Mapping as MappingOf
from dataclasses import replace
from typing import Any, Literal, TypeVar, get_args

from framekit.definition.expression.syntax import Bytes, Expression, Logic, names_in
from framekit.definition.load.namespace import Namespace
from framekit.definition.load.reader import Broken, Reader, parse_bytes, parse_key
from framekit.definition.model import segments as model
from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.frames import Side
from framekit.definition.model.segments import Check, FieldType, Order, Size
from framekit.definition.model.walk import field_names
from framekit.definition.nodes import Mapping, Node, Scalar, Sequence
from framekit.definition.problems import did_you_mean

T = TypeVar("T")
Form = Literal["raw", "hex", "HEX", "dec", "nibbles"]
FORMS: dict[str, Form] = {"raw": "raw", "hex": "HEX", "HEX": "HEX", "dec": "dec", "nibbles": "nibbles"}
VERIFY: dict[str, Literal["error", "warn", "off"]] = {"error": "error", "warn": "warn", "off": "off"}


def load_check_segment(space: Namespace, keys: Mapping, common: dict[str, Any]) -> Check:
    """Raises Broken. `hex` digits are upper-case unless `case: lower`."""
    reader = space.reader
    node = keys.get("check")
    assert node is not None
    method = space.check(node)
    form = _word(reader, keys.get("as"), FORMS, "a form of a check code") or "raw"
    if form == "HEX" and reader.maybe(reader.text, keys.get("case")) == "lower":
        form = "hex"
    over, span = _range(reader, keys.get("over"))
    order = reader.maybe(reader.text, keys.get("order")) or "big"
    size = keys.get("size")
    return Check(
        method=method,
        over=over,
        span=span,
        form=form,
        order="little" if order == "little" else "big",
        size=_check_size(method, form) if size is None else reader.number(size),
        verify=_word(reader, keys.get("verify"), VERIFY, "a way to verify") or "error",
        **common,
    )


def _word(reader: Reader, node: Node | None, words: MappingOf[str, T], kind: str) -> T | None:
    return None if node is None else reader.one_of(node, words, kind)


def _range(reader: Reader, node: Node | None) -> tuple[tuple[str, ...] | None, tuple[str, str] | None]:
    if node is None:
        return None, None
    if isinstance(node, Sequence):
        return reader.texts(node), None
    text = reader.text(node)
    first, dots, last = text.partition("..")
    if not dots:
        return (text,), None
    return None, (first.strip(), last.strip())


def _check_size(method: CheckMethod, form: Form) -> int:
    """Bytes on the wire of a check code."""
    if form == "dec":
        return len(str((1 << method.width) - 1))
    return method.size * (1 if form == "raw" else 2)


DIGIT_BASES = {"hex": 16, "HEX": 16, "dec": 10, "oct": 8}
ORDERS: dict[str, Order] = {
    "big": "big", "ABCD": "big", "little": "little", "DCBA": "little", "BADC": "BADC", "CDAB": "CDAB",
}  # fmt: skip
TYPES = (
    *(f"{sign}{bits}" for sign in "ui" for bits in (8, 16, 24, 32, 40, 48, 56, 64)),
    "f32", "f64", "uint", "int", *DIGIT_BASES, "bcd", "ascii", "bytes",
)  # fmt: skip

MOST_OF_NUMBER = 256
"""A number has so many bytes at most."""

assert set(ORDERS.values()) == set(get_args(Order))


def load_size(reader: Reader, node: Node) -> Size:
    """A number of bytes, `rest`, or an expression."""
    text = reader.text(node).strip()
    if text == "rest":
        return "rest"
    return reader.bytes_at_most(node) if re.fullmatch(r"\d+|0x[0-9a-fA-F]+", text) else reader.expression(node)


def load_type(space: Namespace, keys: Mapping, type_node: Node | None, *, digits_of: bool = False) -> FieldType:
    """The type named by `type_node`, completed by `size order case pad end` of `keys`. Raises Broken."""
    reader = space.reader
    scalar = reader.scalar(type_node)
    name = scalar.text
    if name not in TYPES:
        raise reader.broken(scalar.at, f"there is no type '{name}'", did_you_mean(name, TYPES))
    if name in DIGIT_BASES:
        return _digits(space, keys, scalar)
    if match := re.fullmatch(r"([ui])(\d+)", name):
        size = int(match[2]) // 8
        return FieldType("int", size, signed=match[1] == "i", order=_order(space, keys, size, scalar))
    if match := re.fullmatch(r"f(\d+)", name):
        size = int(match[1]) // 8
        return FieldType("float", size, signed=True, order=_order(space, keys, size, scalar))
    if name == "ascii":
        return _ascii(space, keys, scalar)
    wanted = _size(reader, keys, scalar)
    if name != "bytes" and isinstance(wanted, int) and wanted > MOST_OF_NUMBER:
        what = f"a number of {wanted} bytes is too long: {MOST_OF_NUMBER} are possible"
        raise reader.broken(scalar.at, what, "use data: for it")
    if name == "bcd":
        return FieldType("bcd", wanted, order=given_order(reader, keys) or "big")
    if name == "bytes":
        return FieldType("bytes", wanted)
    return FieldType("int", wanted, signed=name == "int", order=_order(space, keys, wanted, scalar))


def _size(reader: Reader, keys: Mapping, scalar: Scalar) -> int | Expression:
    node = keys.get("size")
    if node is None:
        raise reader.broken(scalar.at, f"a field of type '{scalar.text}' needs a size", "add size: N")
    size = load_size(reader, node)
    if size == "rest":
        raise reader.broken(node.at, f"a field of type '{scalar.text}' cannot take the rest", "use data: … size: rest")
    if size == 0:
        raise reader.broken(node.at, "a size of 0 holds nothing", "give the number of bytes or digits")
    return size


def given_order(reader: Reader, keys: Mapping) -> Order | None:
    """The byte order that keys say, if they do. Raises Broken."""
    node = keys.get("order")
    return None if node is None else reader.one_of(node, ORDERS, "a byte order")


def _order(space: Namespace, keys: Mapping, size: int | Expression, scalar: Scalar) -> Order:
    order = given_order(space.reader, keys)
    if order is None:
        return ORDERS[space.order(scalar.at.file)]
    if order in ("BADC", "CDAB") and size not in (2, 4, 8):
        at = keys.get("order")
        assert at is not None
        raise space.reader.broken(at.at, f"{order} needs a type of 2, 4 or 8 bytes", "use big or little")
    return order


def _digits(space: Namespace, keys: Mapping, scalar: Scalar) -> FieldType:
    reader = space.reader
    order = given_order(reader, keys) or "big"
    case = reader.maybe(reader.text, keys.get("case")) or "upper"
    return FieldType(
        "digits", _size(reader, keys, scalar), order=order, base=DIGIT_BASES[scalar.text], upper=case != "lower"
    )


def _ascii(space: Namespace, keys: Mapping, scalar: Scalar) -> FieldType:
    reader = space.reader
    pad, end = reader.maybe(reader.bytes, keys.get("pad")), reader.maybe(reader.bytes, keys.get("end"))
    if end is not None and keys.get("size") is None:
        return FieldType("ascii", None, end=end)
    return FieldType("ascii", _size(reader, keys, scalar), pad=pad, end=end)


LENGTH_UNITS = {"bytes": 1, "words": 2, "dwords": 4, "lwords": 8, "digits": 1}
KINDS = (
    "const", "text", "field", "bits", "data", "length", "count", "repeat", "choose", "optional", "include", "inner",
    "wrap", "check", "skip", "require", "value",
)  # fmt: skip
MOST_SEGMENTS = 4000
"""Of one frame, with everything it includes."""


class SegmentLoader:
    """Reads lists of segments: a method for each kind, by its keys and what all kinds have in common.

    `space` gives the meaning of the names of types, tables and checks, `find_frames` the frames that an `inner` or
    `inside` means by a name. `side`: who sends the frame they belong to. `aliases` collects what a named include stands
    for: its name → the names of its segments. `spoilt` says that segments were left out because they are broken.
    """

    def __init__(self, space: Namespace, find_frames: Callable[[Namespace, Node], tuple[str, ...]]) -> None:
        self.space = space
        self.reader = space.reader
        self.side: Side | None = None
        self.find_frames = find_frames
        self.aliases: dict[str, tuple[str, ...]] = {}
        self.under_way: list[tuple[str, Sequence]] = []
        self.read = 0
        self.unnamed = 0
        self.spoilt = False

    def _named(self, keys: Mapping, kind: str, common: dict[str, Any]) -> dict[str, Any]:
        """The common keys of a segment whose kind key holds its name."""
        return {**common, "name": self.reader.text(keys.get(kind))}

    def _const(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        return model.Const(data=self.reader.bytes(keys.get("const")), **common)

    def _text(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        node = self.reader.scalar(keys.get("text"))
        try:
            return model.Const(data=node.text.encode("latin-1"), **common)
        except UnicodeEncodeError:
            curly = any(sign in node.text for sign in "“”„‘’")
            todo = "use straight quotes" if curly else "use const: with hex"
            raise self.reader.broken(node.at, "the text has characters that are no bytes", todo) from None

    def _field(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        type_ = load_type(self.space, keys, keys.get("type"))
        values = self.values(keys.get("values"))
        only = keys.get("only") is not None
        if only and values is None:
            reader.note(keys.at, "only: values needs values", "add values: with a table")
        unit = keys.get("unit")
        return model.Field(
            type=type_,
            is_=self._given(keys.get("is"), type_),
            build=self._given(keys.get("build"), type_),
            default=self._given(keys.get("default"), type_),
            values=values,
            only=only and values is not None,
            limits=reader.maybe(reader.range, keys.get("range")),
            plus=reader.maybe(reader.number, keys.get("plus")) or 0,
            unit=None if unit is None else reader.time(unit),
            long=self._long(keys.get("long")),
            zero_means=reader.maybe(reader.number, keys.get("zero_means")),
            memory=reader.maybe(reader.text, keys.get("memory")),
            **self._named(keys, "field", common),
        )

    def _given(self, node: Node | None, type_: model.FieldType) -> Expression | None:
        """A default: bytes for a field of bytes, an empty text for an empty scalar, else an expression."""
        if node is None:
            return None
        scalar = self.reader.scalar(node)
        if type_.kind == "bytes" and not scalar.text.strip().startswith("h'"):
            try:
                return literal_bytes(scalar)
            except ValueError:
                return self.reader.expression(node)
        return self.reader.expression_text(scalar.text or "''", scalar.at)

    def _long(self, node: Node | None) -> model.Long | None:
        if node is None:
            return None
        keys = self.reader.mapping(node)
        return model.Long(mark=self.reader.number(keys.get("mark")), type=load_type(self.space, keys, keys.get("type")))

    def values(self, node: Node | None) -> MappingOf[int, str] | None:
        """Names of numbers: a table's name, or a mapping code: name."""
        if node is None:
            return None
        if isinstance(node, Mapping):
            return {self.reader.number(entry.key): self.reader.text(entry.value) for entry in node.read_all()}
        name = self.reader.text(node)
        table = self.space.table(name)
        if table is None:
            known = list(self.space.section("tables"))
            raise self.reader.unknown(node.at, "table", name, known)
        return {key: str(text) for key, text in table.entries.items() if isinstance(key, int)}

    def _bits(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        type_ = load_type(self.space, keys, keys.get("of"))
        given = {
            key: {entry.key.text: entry.value for entry in reader.entries(keys.get(key))}
            for key in ("is", "build", "values")
        }
        parts = []
        for entry in reader.entries(keys.get("bits")):
            low, high = reader.places(entry.value)
            name = entry.key.text
            parts.append(
                model.BitsPart(
                    name=name,
                    low=low,
                    high=high,
                    is_=reader.maybe(reader.expression, given["is"].pop(name, None)),
                    build=reader.maybe(reader.expression, given["build"].pop(name, None)),
                    values=self.values(given["values"].pop(name, None)),
                    at=entry.key.at,
                )
            )
        for names in given.values():
            for name, node in names.items():
                reader.note(node.at, f"there are no bits '{name}' here", "name one of the bits above")
        return model.Bits(parts=tuple(parts), type=type_, **common)

    def _data(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        size = keys.get("size")
        if size is None:
            raise Broken("the schema asks for a size")
        swap = reader.maybe(reader.number, keys.get("swap")) or 0
        if swap not in (0, 2, 4, 8):
            raise reader.broken(keys.at, f"a swap of {swap} bytes does not exist", "use 2, 4 or 8")
        loaded = load_size(reader, size)
        if swap and isinstance(loaded, int) and loaded % swap:
            reader.warn(size.at, f"{loaded} bytes are not full units of {swap}", "the rest stays as it is")
        return model.Data(
            size=loaded,
            convert=self._conversion(keys),
            swap=swap,
            pad=reader.maybe(reader.byte, keys.get("pad")),
            least=reader.maybe(reader.number, keys.get("min")) or 0,
            memory=reader.maybe(reader.text, keys.get("memory")),
            **self._named(keys, "data", common),
        )

    def _conversion(self, keys: Mapping) -> Literal["hex_to_ascii", "ascii_to_hex"] | None:
        """From memory to wire, whatever the definition's way to name it."""
        node = keys.get("convert")
        name = self.reader.maybe(self.reader.text, node)
        if node is None or name not in ("hex_to_ascii", "ascii_to_hex"):
            return None
        if not self.space.turns_conversions(node.at.file):
            return "hex_to_ascii" if name == "hex_to_ascii" else "ascii_to_hex"
        if self.side not in ("client", "server"):
            what = "conversions are named by the direction of the frame, and this has none"
            todo = "say from: client or server in its group, or leave conversions: out"
            raise self.reader.broken(node.at, what, todo)
        to_digits = (name == "hex_to_ascii") == (self.side == "client")
        return "hex_to_ascii" if to_digits else "ascii_to_hex"

    def _length(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        unit = keys.get("unit")
        of = reader.texts(keys.get("of"))
        if not of:
            name = reader.text(keys.get("length"))
            reader.note(keys.at, f"the length '{name}' counts nothing", "add of: [names of segments]")
        return model.Length(
            type=load_type(self.space, keys, keys.get("type")),
            of=of,
            plain=reader.flag(keys.get("plain")),
            unit=1 if unit is None else self._length_unit(unit),
            plus=reader.maybe(reader.number, keys.get("plus")) or 0,
            limits=reader.maybe(reader.range, keys.get("range")),
            zero_means=reader.maybe(reader.number, keys.get("zero_means")),
            **self._named(keys, "length", common),
        )

    def _length_unit(self, node: Node) -> int:
        text = self.reader.text(node)
        return LENGTH_UNITS[text] if text in LENGTH_UNITS else self.reader.number(node)

    def _count(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        return model.Count(
            type=load_type(self.space, keys, keys.get("type")),
            of=reader.text(keys.get("of")),
            plus=reader.maybe(reader.number, keys.get("plus")) or 0,
            limits=reader.maybe(reader.range, keys.get("range")),
            zero_means=reader.maybe(reader.number, keys.get("zero_means")),
            **self._named(keys, "count", common),
        )

    def _skip(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        fill = keys.get("fill")
        return model.Skip(
            size=self.reader.bytes_at_most(keys.get("skip")),
            fill=b"\0" if fill is None else self.reader.bytes(fill),
            **common,
        )

    def _value(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        return model.Value(
            read=self.reader.expression(keys.get("read")),
            build=self.reader.maybe(self.reader.expression, keys.get("build")),
            **self._named(keys, "value", common),
        )

    def _require(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        return model.Require(condition=self.reader.expression(keys.get("require")), **common)

    def _check(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        return load_check_segment(self.space, keys, common)

    def load(self, node: Node | None) -> tuple[model.Segment, ...]:
        """The segments of a list; those that are broken are left out after their problem is noted."""
        found: list[model.Segment] = []
        for item in self.reader.items(node):
            try:
                self._number(item)
                found.extend(self._segment(self.reader.mapping(item)))
            except Broken:
                self.spoilt = True
        return in_order(tuple(found))[0]

    def _number(self, item: Node) -> None:
        """Includes of includes multiply; nothing sensible has so many segments."""
        self.read += 1
        if self.read == MOST_SEGMENTS and not self.space.too_much:
            self.space.too_much = True
            what = f"the frame has more than {MOST_SEGMENTS} segments with all it includes"
            self.reader.note(item.at, what, "take repeat: for what comes several times")
        if self.read >= MOST_SEGMENTS:
            raise Broken("too many segments")

    def _segment(self, keys: Mapping) -> tuple[model.Segment, ...]:
        kinds = [entry.key.text for entry in keys.entries if entry.key.text in KINDS]
        if len(kinds) != 1:
            raise Broken("the schema has told what is wrong with the kind")
        kind = kinds[0]
        if kind == "include":
            return self._include(keys)
        make: Callable[[Mapping, dict[str, Any]], model.Segment] = getattr(self, "_" + kind)
        return (make(keys, self._common(keys, kind)),)

    def _common(self, keys: Mapping, kind: str) -> dict[str, Any]:
        reader = self.reader
        name = keys.get("name")
        if name is None:
            self.unnamed += 1
        return {
            "at": keys.at,
            "name": f"_{kind}_{self.unnamed}" if name is None else reader.text(name),
            "when": reader.maybe(reader.expression, keys.get("when")),
            "refuse": reader.maybe(reader.number, keys.get("refuse")),
            "doc": reader.maybe(reader.text, keys.get("doc")) or "",
        }

    # ---- segments that hold others ------------------------------------------------------------------------

    def _repeat(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        times, of = keys.get("times"), keys.get("of")
        if times is None or of is None:
            raise Broken("the schema asks for times and of")
        items = self.load(of) if isinstance(of, Sequence) else load_type(self.space, keys, of)
        return model.Repeat(times=load_size(self.reader, times), of=items, **self._named(keys, "repeat", common))

    def _choose(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        otherwise = keys.get("else")
        cases = tuple(
            (tuple(parse_key(part) for part in entry.key.text.split(",")), self.load(entry.value))
            for entry in self.reader.entries(keys.get("cases"))
        )
        return model.Choose(
            on=self.reader.expression(keys.get("choose")),
            cases=cases,
            otherwise=None if otherwise is None else self.load(otherwise),
            **common,
        )

    def _optional(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        return model.Optional(of=self.load(keys.get("optional")), **common)

    def _include(self, keys: Mapping) -> tuple[model.Segment, ...]:
        node = keys.get("include")
        assert node is not None
        segments = self.layout(node)
        when = self.reader.maybe(self.reader.expression, keys.get("when"))
        refuse = self.reader.maybe(self.reader.number, keys.get("refuse"))
        record = keys.get("as")
        if record is not None:
            name = self.reader.text(record)
            return (model.Record(at=keys.at, name=name, of=segments, when=when, refuse=refuse),)
        if (name_node := keys.get("name")) is not None:
            self.aliases[self.reader.text(name_node)] = tuple(part.name for part in segments if part.name)
        return tuple(_under(part, when, refuse) for part in segments)

    def layout(self, node: Node) -> tuple[model.Segment, ...]:
        """The segments of the layout that `node` names, read in its own namespace. Raises Broken."""
        nodes, space = self.space.layout(node)
        names = [name for name, _ in self.under_way]
        place = next((place for place, (_, other) in enumerate(self.under_way) if other is nodes), None)
        if place is not None:
            raise self._circle(node, names[place:])
        outer, self.space = self.space, space
        self.under_way.append((self.reader.text(node), nodes))
        try:
            return self.load(nodes)
        finally:
            self.space = outer
            self.under_way.pop()

    def _circle(self, node: Node, names: list[str]) -> Broken:
        """Layouts that include each other; told once, whichever of them it was found from."""
        if frozenset(names) in self.space.circles:
            return Broken(names[0])
        self.space.circles.add(frozenset(names))
        chain = " → ".join([*names, names[0]])
        what = f"layouts include each other in a circle: {chain}" if len(names) > 1 else f"'{names[0]}' includes itself"
        return self.reader.broken(node.at, what, "break the circle")

    def _inner(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        frames: list[str] = []
        for item in self.reader.items(keys.get("of")):
            frames.extend(name for name in self.find_frames(self.space, item) if name not in frames)
        size = keys.get("size")
        return model.Inner(
            frames=tuple(frames),
            size=None if size is None else load_size(self.reader, size),
            **self._named(keys, "inner", common),
        )

    def _most(self, node: Node | None) -> int | Expression | None:
        size = None if node is None else load_size(self.reader, node)
        return None if size == "rest" else size

    def _wrap(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        how = keys.get("wrap")
        inside = [name for item in reader.items(keys.get("inside")) for name in self.find_frames(self.space, item)]
        return model.Wrap(
            how="hex" if isinstance(how, Scalar) else "escape",
            escape=None if isinstance(how, Scalar) else reader.byte(reader.mapping(how).get("escape")),
            of=self.load(keys.get("of")),
            inside=tuple(inside),
            insert=reader.maybe(reader.expression, keys.get("insert")),
            least=reader.maybe(reader.number, keys.get("min")) or 0,
            most=self._most(keys.get("max")),
            **common,
        )


def literal_bytes(scalar: Scalar) -> Expression:
    """Bytes written as hex pairs, as an expression. Raises ValueError."""
    return Expression(scalar.text, Bytes(scalar.at, parse_bytes(scalar.text) if scalar.text.strip() else b""))


def in_order(*lists: tuple[model.Segment, ...]) -> list[tuple[model.Segment, ...]]:
    """Lists that stand one behind the other, with every `value` behind what it reads: it takes no bytes."""
    given = [{segment.name, *field_names((segment,))} for segments in lists for segment in segments]
    late = {name for names in given for name in names if name is not None}
    if not any(isinstance(segment, model.Value) for segments in lists for segment in segments):
        return list(lists)
    waiting: list[model.Value] = []
    found: list[tuple[model.Segment, ...]] = []

    def place(segment: model.Segment, here: list[model.Segment]) -> None:
        here.append(segment)
        late.difference_update({segment.name, *field_names((segment,))})
        for value in waiting:
            if not late & _read_by(value):
                waiting.remove(value)
                return place(value, here)

    for segments in lists:
        here: list[model.Segment] = []
        for segment in segments:
            if isinstance(segment, model.Value) and late & _read_by(segment) - {segment.name}:
                waiting.append(segment)
            else:
                place(segment, here)
        if segments is lists[-1]:
            here += waiting
        found.append(tuple(here))
    return found


def _read_by(value: model.Value) -> set[str]:
    return names_in(value.read.root) | (set() if value.when is None else names_in(value.when.root))


def _under(segment: model.Segment, when: Expression | None, refuse: int | None) -> model.Segment:
    """An included segment with the `when` and `refuse` of its include."""
    if when is not None:
        segment = replace(segment, when=both(when, segment.when))
    if refuse is not None and segment.refuse is None:
        segment = replace(segment, refuse=refuse)
    return segment


def both(first: Expression, second: Expression | None) -> Expression:
    """`first and second`."""
    if second is None:
        return first
    return Expression(f"({first}) and ({second})", Logic(first.at, "and", (first.root, second.root)))
