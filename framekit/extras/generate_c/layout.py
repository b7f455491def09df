"""Lay out the values of a frame in C: the members of its struct, from the segments that hold values.

Members have the names of the definition. A value that may be absent, or left to its default, has a flag `has_NAME`.
Texts and bytes are views: into the received bytes, or into a buffer of the struct for bytes that are encoded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from framekit.codec.python import forms
from framekit.definition.codings import Plain
from framekit.definition.expression import Expression
from framekit.definition.model.frames import Frame, StaticSizes, flat
from framekit.definition.model.segments import (
    Bits,
    Choose,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Nested,
    Optional,
    Record,
    Repeat,
    Segment,
    Segments,
    Value,
    Wrap,
)
from framekit.definition.problems import CannotSayError, Position
from framekit.extras.generate_c.expressions import CExpressionWriter, CFacts, CScope, Val
from framekit.extras.generate_c.source import CNames, CSource, comment, identifier

MemberKind = Literal["number", "float", "decimal", "bytes", "record", "list", "values", "inner"]
INT64 = (-(1 << 63), (1 << 63) - 1)
"""The range of an int64_t."""


@dataclass(slots=True)
class CMember:
    """A value in a struct."""

    name: str
    kind: MemberKind
    cname: str
    at: Position
    low: int = 0
    """The least number."""
    high: int = 0
    """The greatest number."""
    has: bool = False
    """Whether a flag records its presence."""
    size: int = 0
    """The size of a float in bytes."""
    capacity: int = 0
    """The maximum number of items of a list, or the size of `room` in bytes."""
    room: str = ""
    """The name of the buffer for decoded bytes; empty for none."""
    places: int = 0
    """The number of decimals: the member holds the value times 10 to the power of `places`."""
    is_text: bool = False
    inside: CStruct | None = None
    item: CMember | None = None
    frames: tuple[str, ...] = ()
    always_valued: bool = False
    is_single: bool = False
    most_size: int | None = None
    flag: str = ""
    """The name of its flag."""

    @property
    def ctype(self) -> str:
        if self.kind == "float":
            return "float" if self.size == 4 else "double"
        if self.kind == "bytes":
            return "struct framekit_bytes"
        if self.kind == "decimal":
            return "struct framekit_decimal"
        return number_type(self.low, self.high)

    def same_as(self, other: CMember) -> bool:
        ours, theirs = (replace(one, at=self.at, has=False, inside=None) for one in (self, other))
        inside = (self.inside is None) == (other.inside is None)
        if inside and self.inside is not None and other.inside is not None:
            inside = self.inside.same_as(other.inside)
        return ours == theirs and inside


@dataclass(slots=True)
class CStruct:
    """The values of a frame, a record or an item."""

    where: str
    members: dict[str, CMember] = field(default_factory=dict)
    rooms: dict[str, int] = field(default_factory=dict)
    """The names and sizes in bytes of the buffers for decoded bytes."""
    reserved: set[str] = field(default_factory=set)
    """Names of values, which flags may not use."""
    names: CNames = field(init=False)

    def __post_init__(self) -> None:
        self.names = CNames(self.where)

    def same_as(self, other: CStruct) -> bool:
        if self.rooms != other.rooms or self.members.keys() != other.members.keys():
            return False
        return all(one.same_as(other.members[name]) and one.has == other.members[name].has
                   for name, one in self.members.items())  # fmt: skip


def number_type(low: int, high: int) -> str:
    """Return the smallest type that holds these numbers."""
    if low >= 0:
        bits = next(bits for bits in (8, 16, 32, 64) if high < 1 << bits)
        return f"uint{bits}_t"
    bits = next(bits for bits in (8, 16, 32, 64) if -low <= 1 << bits - 1 and high < 1 << bits - 1)
    return f"int{bits}_t"


def number_range(segment: Field | Length | Count | Repeat, type_: FieldType) -> tuple[int, int]:
    """Return the least and the greatest number that can be read, ignoring the limits of the field."""
    if isinstance(segment, Repeat):
        found = forms.wire_range(type_)
    else:
        found = forms.value_range(replace(segment, limits=None))
    size = type_.size
    low, high = found.least, found.most
    if high is None and (isinstance(size, Expression) or type_.is_delimited):
        low, high = (INT64[0], INT64[1]) if type_.signed else (0, INT64[1])
        if isinstance(segment, Field) and (segment.plus or segment.unit):
            raise CannotSayError(segment.at, "a number of computed size with plus: or unit:")
    if isinstance(segment, Field | Length | Count) and segment.zero_means is not None:
        low = min(low or 0, segment.zero_means)
    if low is None or high is None or low < INT64[0] or high >= 1 << 64 or (low < 0 and high > INT64[1]):
        raise CannotSayError(segment.at, f"'{segment.name}' is a number of more than 64 bits")
    return low, high


class Layouts:
    """The structs of all frames. `most`: size in bytes of a frame whose definition sets no limit."""

    def __init__(self, frames: Mapping[str, Frame], static: StaticSizes, outside: CFacts, most: int) -> None:
        self.frames = frames
        self.static = static
        self.outside = outside
        self.most = most

    def most_of(self, frame: Frame) -> int:
        """Return the maximum size of a frame in bytes."""
        found = self.static.all(self.static.segments(frame)).most
        known = [one for one in (found, frame.most) if one is not None]
        return min(known) if known else self.most

    def struct(self, frame: Frame) -> CStruct:
        struct = CStruct(f"frame '{frame.name}'")
        segments = self.static.segments(frame)
        _Laying(self, max(self.most_of(frame), 1)).all(segments, struct, False)
        self._values(segments, struct)
        return struct

    def _values(self, segments: Segments, struct: CStruct, outer: CScope | None = None) -> None:
        """Add the values that take no bytes, with the kind of the expression they are computed from."""
        waiting = [one for one in flat(segments) if isinstance(one, Value)]
        while waiting:
            scope = scope_of(struct, "", outer)
            names = {one.name for one in waiting}
            ready = [one for one in waiting if not names & _read(one)]
            if not ready:
                raise CannotSayError(waiting[0].at, "values that follow from each other")
            for one in ready:
                value = CExpressionWriter(self.outside, scope).value(one.read)
                self._value(one, value, struct)
            waiting = [one for one in waiting if one not in ready]
        for segment in flat(segments):
            member = struct.members.get(segment.name or "")
            if segment.inner_record is not None and member is not None and member.inside is not None:
                self._values(segment.members, member.inside, scope_of(struct, "", outer))

    @staticmethod
    def _value(segment: Value, value: Val, struct: CStruct) -> None:
        if value.fold and value.most_size is not None and value.most_size <= 64:
            member = CMember(segment.name, "bytes", "", segment.at, capacity=value.most_size, room="room")
            _add(struct, segment.name, member, True)
            return
        if value.fold or value.kind not in ("number", "bytes"):
            raise CannotSayError(segment.at, f"the value '{segment.name}' is no number, text or bytes of the frame")
        if isinstance(value.constant, bytes):
            raise CannotSayError(segment.at, f"the value '{segment.name}' is a constant text")
        kind: MemberKind = "number" if value.kind == "number" else "bytes"
        _add(
            struct,
            segment.name,
            CMember(segment.name, kind, "", segment.at, value.low, value.high, is_text=value.is_text),
            True,
        )


def _read(value: Value) -> set[str]:
    from framekit.definition.expression import names_in

    return names_in(value.read.root) - {value.name}


def _add(struct: CStruct, name: str, member: CMember, has: bool) -> CMember:
    """Add a member under its name; a member of several cases is added once, with the range of all."""
    there = struct.members.get(name)
    if there is not None:
        both_numbers = there.kind == member.kind == "number" and there.places == member.places
        if both_numbers:
            there.low, there.high = min(there.low, member.low), max(there.high, member.high)
            if there.low < 0 and there.high > INT64[1]:
                raise CannotSayError(member.at, f"'{name}' is a number of more than 64 bits in one of its cases")
        elif there.kind == member.kind == "bytes":
            there.is_text = there.is_text and member.is_text
            sizes = there.most_size, member.most_size
            there.most_size = None if None in sizes else max(one for one in sizes if one is not None)
            if member.room:
                struct.rooms[there.cname + "_room"] = max(member.capacity, struct.rooms.get(there.cname + "_room", 0))
                there.room = there.cname + "_room"
                there.capacity = struct.rooms[there.room]
        else:
            member.cname, member.room = there.cname, there.room
            if not there.same_as(member):
                raise CannotSayError(member.at, f"'{name}' is of another kind in another case")
        there.has = there.has or has
        return there
    member.cname = struct.names.take(identifier(name), f"'{name}'", member.at)
    member.has = has
    flag = f"has_{member.cname}"  # if the flag's name is a value of the definition, the words are exchanged
    flag = f"{member.cname}_given" if flag in struct.reserved else flag
    member.flag = struct.names.take(flag, f"the flag of '{name}'", member.at)
    if member.room:
        member.room = struct.names.take(f"{member.cname}_room", f"the room of '{name}'", member.at)
        struct.rooms[member.room] = member.capacity
    struct.members[name] = member
    return member


class _Laying:
    """Add the members of a list of segments to a struct; `most`: size of the frame in bytes."""

    def __init__(self, layouts: Layouts, most: int) -> None:
        self.layouts = layouts
        self.most = most
        self.limits: dict[str, int] = {}

    def all(self, segments: Segments, struct: CStruct, conditional: bool) -> None:
        self.limits |= {one.name: one.limits[1] for one in flat(segments) if isinstance(one, Length) and one.limits}
        struct.reserved |= {identifier(name) for one in flat(segments) for name in one.value_names}
        for segment in segments:
            self.one(segment, struct, conditional or segment.when is not None)

    def one(self, segment: Segment, struct: CStruct, maybe: bool) -> None:
        match segment:
            case Field():
                self._field(segment, struct, maybe)
            case Length() | Count():
                low, high = number_range(segment, segment.type)
                _add(struct, segment.name, CMember(segment.name, "number", "", segment.at, low, high), maybe)
            case Bits():
                self._bits(segment, struct, maybe)
            case Data():
                self._data(segment, struct, maybe)
            case Record():
                inside = CStruct(f"record '{segment.name}'")
                self.all(segment.of, inside, False)
                _add(struct, segment.name, CMember(segment.name, "record", "", segment.at, inside=inside), maybe)
            case Repeat():
                self._repeat(segment, struct, maybe)
            case Inner():
                names = tuple(dict.fromkeys(segment.frames))
                _add(struct, segment.name, CMember(segment.name, "inner", "", segment.at, frames=names), maybe)
            case Nested():
                raise CannotSayError(segment.at, f"the layout '{segment.layout}' stands in itself")
            case Choose() | Optional():
                for block in segment.blocks:
                    self.all(block, struct, True)
            case Wrap():
                if not isinstance(segment.coding, Plain):
                    self._room_of(segment, struct)
                self.all(segment.of, struct, maybe)
            case Value():
                pass  # added after the kinds of its operands are known
            case _ if segment.value_names:
                raise CannotSayError(segment.at, f"a segment of the kind '{segment.KEY}'")

    def _bits(self, segment: Bits, struct: CStruct, maybe: bool) -> None:
        for part in segment.parts:
            if part.most is None or part.most > INT64[1]:
                raise CannotSayError(part.at, f"'{part.name}' is a number of more than 63 bits")
            chosen = part.build is not None or (part.constants is not None and len(part.constants) > 1)
            has = maybe or (chosen and part.is_ is None)
            _add(struct, part.name, CMember(part.name, "number", "", part.at, 0, part.most), has)

    def _data(self, segment: Data, struct: CStruct, maybe: bool) -> None:
        turned = segment.convert is not None or segment.swap
        size = segment.size if isinstance(segment.size, int) else self.most * (
            2 if segment.convert == "ascii_to_hex" else 1)  # fmt: skip
        member = CMember(segment.name, "bytes", "", segment.at, capacity=size if turned else 0,
                        room="room" if turned else "")  # fmt: skip
        _add(struct, segment.name, member, maybe)

    def _room_of(self, segment: Wrap, struct: CStruct) -> None:
        """Add the room for the plain content of a wrap."""
        content = self.layouts.static.all(segment.of).most
        size = max(self.most, content or 0) if content is None or content > self.most else content
        name = segment.name or ""
        plain = name.strip("_") if name.startswith("_") else name
        cname = struct.names.take(f"{identifier(plain)}_plain", f"the content of {segment.title}", segment.at)
        struct.rooms[cname] = max(size, 1)

    def _field(self, segment: Field, struct: CStruct, maybe: bool) -> None:
        chosen = segment.build is not None or segment.default is not None
        chosen = chosen or (segment.constants is not None and len(segment.constants) > 1)
        has = maybe or (chosen and segment.is_ is None)
        if segment.type.form is not None and segment.type.form.empty:
            if has or segment.is_ is not None or segment.limits is not None:
                raise CannotSayError(segment.at, f"'{segment.name}', a number whose text may be empty, with more keys")
            has = True
        member = self._member(segment.name, segment.type, segment)
        if member.places and max(map(abs, segment.limits or (0,))) * 10**member.places > INT64[1]:
            raise CannotSayError(segment.at, f"'{segment.name}' is a number of more than 64 bits")
        member.always_valued = segment.when is not None and segment.default is not None
        _add(struct, segment.name, member, has)

    def _member(self, name: str, type_: FieldType, segment: Field | Repeat) -> CMember:
        at = segment.at
        if type_.kind in ("ascii", "bytes"):
            size = type_.size if isinstance(type_.size, int) else self.limits.get(str(type_.size))
            return CMember(name, "bytes", "", at, is_text=type_.kind == "ascii", most_size=size)
        if type_.kind in ("float", "hex_float"):
            size = (type_.fixed_size or 0) // (2 if type_.kind == "hex_float" else 1)
            return CMember(name, "float", "", at, size=size)
        if type_.kind == "scaled":
            assert type_.inside is not None and type_.scale is not None
            low, high = self._bounds(segment, type_.inside)
            ends = sorted(one * type_.scale.factor + type_.scale.offset for one in (low, high))
            if ends[0] < INT64[0] or ends[1] > INT64[1]:
                raise CannotSayError(at, f"'{name}' is a number of more than 64 bits")
            return CMember(name, "number", "", at, ends[0], ends[1], places=type_.scale.places)
        if type_.kind == "fraction":
            form = type_.form
            assert form is not None
            if form.decimals is None or form.exponent:
                return CMember(name, "decimal", "", at)
            if form.decimals > 18:
                raise CannotSayError(at, f"'{name}' is a number of more than 64 bits")
            digits = min((type_.fixed_size or 18) - (form.decimals > 0), 18)
            most = 10**digits - 1 if type_.fixed_size is not None and digits < 18 else INT64[1]
            return CMember(name, "number", "", at, -most if type_.signed else 0, most, places=form.decimals)
        low, high = self._bounds(segment, type_)
        return CMember(name, "number", "", at, low, high)

    @staticmethod
    def _bounds(segment: Field | Repeat, type_: FieldType) -> tuple[int, int]:
        if type_ is not (segment.type if isinstance(segment, Field) else segment.of):
            found = forms.wire_range(type_)
            if found.least is None or found.most is None:
                raise CannotSayError(segment.at, f"'{segment.name}' is a number of computed size")
            return found.least, found.most
        return number_range(segment, type_)

    def _repeat(self, segment: Repeat, struct: CStruct, maybe: bool) -> None:
        least = (
            segment.of.sizes.least if isinstance(segment.of, FieldType) else self.layouts.static.all(segment.of).least
        )
        capacity = segment.times if isinstance(segment.times, int) else self.most // max(least, 1)
        if isinstance(segment.of, FieldType):
            item = self._member(segment.name, segment.of, segment)
            if item.kind == "bytes":
                raise CannotSayError(segment.at, f"'{segment.name}' is a list of texts")
            item.cname = "item"
            member = CMember(segment.name, "values", "", segment.at, item=item, capacity=max(capacity, 1))
        else:
            inside = CStruct(f"items of '{segment.name}'")
            self.all(segment.of, inside, False)
            member = CMember(segment.name, "list", "", segment.at, inside=inside, capacity=max(capacity, 1))
            member.is_single = segment.single
        _add(struct, segment.name, member, maybe)


# ---- the struct as C ----------------------------------------------------------------------------------------


def declare(struct: CStruct, out: CSource, prefix: str, enum_of: Mapping[str, str]) -> None:
    """Write the members of a struct."""
    for member in struct.members.values():
        if member.has:
            out.add(f"bool {member.flag};")
        match member.kind:
            case "record":
                assert member.inside is not None
                with out.block("struct", f" {member.cname};"):
                    declare(member.inside, out, prefix, enum_of)
            case "list":
                assert member.inside is not None
                with out.block("struct", f" {member.cname};"):
                    out.add("size_t count;")
                    with out.block("struct", f" items[{member.capacity}];"):
                        declare(member.inside, out, prefix, enum_of)
            case "values":
                assert member.item is not None
                behind = f" {comment(f'counts 10^-{member.item.places}')}" if member.item.places else ""
                with out.block("struct", f" {member.cname};"):
                    out.add("size_t count;", f"{member.item.ctype} items[{member.capacity}];{behind}")
            case "inner":
                with out.block("struct", f" {member.cname};"):
                    out.add(f"enum {prefix}_frame frame;")
                    with out.block("union", " of;"):
                        out.add("struct framekit_bytes unknown;")
                        for name in member.frames:
                            out.add(f"struct {enum_of[name]} {inner_name(name)};")
            case _:
                behind = f" {comment(f'counts 10^-{member.places}')}" if member.places else ""
                out.add(f"{member.ctype} {member.cname};{behind}")
    for name, size in struct.rooms.items():
        out.add(f"uint8_t {name}[{size}];")
    if not struct.members and not struct.rooms:
        out.add("uint8_t nothing;")


def inner_name(frame: str) -> str:
    """Return the member of a union that holds a frame."""
    found = identifier(frame)
    return "unknown_" if found == "unknown" else found


def scope_of(struct: CStruct, path: str, parent: CScope | None = None) -> CScope:
    """Return the scope of a struct of which all values have been read; `path` leads to it."""
    scope = CScope(parent)
    for name, member in struct.members.items():
        scope.entries[name] = val_of(member, f"{path}{member.cname}", f"{path}{member.flag}" if member.has else "")
    return scope


def val_of(member: CMember, text: str, there: str = "") -> Val:
    """Return a member as a value in expressions."""
    match member.kind:
        case "number" if not member.places and member.high <= INT64[1]:
            return Val("number", f"(int64_t){text}", member.low, member.high, there)
        case "bytes":
            return Val("bytes", text, there=there, most_size=member.most_size, is_text=member.is_text)
        case "record":
            assert member.inside is not None
            return Val("record", text, there=there, inside=scope_of(member.inside, f"{text}."), wire="true")
        case "list":
            assert member.inside is not None
            item = scope_of(member.inside, f"{text}.items[@].")
            item.entries = {name: one for name, one in item.entries.items() if one.kind == "bytes"}
            return Val("list", text, there=there, wire=f"{text}.count", item=item)
        case "values":
            return Val("list", text, there=there, wire=f"{text}.count")
        case "inner":
            return Val("record", text, there=there, wire="")
    return Val("other", text)
