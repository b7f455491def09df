"""Define Wireshark's filter fields: one for each name of a protocol if all its frames give it the same type.

If the types differ, the name of the frame precedes that of the field.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from framekit.codec.python.expressions import is_flag
from framekit.definition.expression import FUNCTIONS, Binary, Call, Conditional, Name, Node, Number, Text, Unary
from framekit.definition.expression import Bytes as BytesNode
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import Bits, BitsPart, Count, Field, FieldType, Length, Segment
from framekit.extras.wireshark.source import identifier

OWN = frozenset({"frame", "request_in", "response_in", "time", "expert"})
"""Names that the dissector itself uses; a value with the same name gets a trailing underscore."""
Bounds = tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class FieldUse:
    """The display of a value."""

    kind: str
    """The type of Wireshark's field."""
    values: tuple[tuple[int, str], ...] = ()
    """The names of numbers, sorted by number."""

    @classmethod
    def of_field(cls, field: Field) -> FieldUse:
        bounds = field.type.bounds if field.long is None else field.long.type.bounds
        if bounds is not None and field.type.is_whole_number:
            unit = field.unit or 1
            low, high = (min(0, (bounds[0] - field.plus) * unit), max((bounds[1] - field.plus) * unit, 0))
            high = max(high, field.zero_means or 0)
            bounds = low, high
        return cls(_kind(field.type, bounds), _names(field.values))

    @classmethod
    def of_number(cls, type_: FieldType) -> FieldUse:
        return cls(_kind(type_, type_.bounds))

    @classmethod
    def of_bits(cls, part: BitsPart) -> FieldUse:
        return cls(_of_bounds((0, part.most or 1 << 1024)), _names(part.values))

    @classmethod
    def of_expression(cls, node: Node, fields: Mapping[str, Segment]) -> FieldUse:
        """Return the use for the result of an expression, a string if its type is unknown."""
        return cls(_of_node(node, fields))


def _names(values: Mapping[int, str] | None) -> tuple[tuple[int, str], ...]:
    found = sorted((values or {}).items())
    return tuple((number, name) for number, name in found if -(1 << 31) <= number < 1 << 32)


def _kind(type_: FieldType, bounds: Bounds) -> str:
    if type_.value_kind == "text":
        return "string"
    if type_.value_kind == "bytes":
        return "bytes"
    if not type_.is_whole_number:
        return "double"
    return "uint64" if bounds is None else _of_bounds(bounds)


def _of_bounds(bounds: tuple[int, int]) -> str:
    low, high = bounds
    if low >= 0:
        return "uint32" if high < 1 << 32 else "uint64" if high < 1 << 64 else "string"
    if low >= -(1 << 31) and high < 1 << 31:
        return "int32"
    return "int64" if low >= -(1 << 63) and high < 1 << 63 else "string"


def _of_node(node: Node, fields: Mapping[str, Segment]) -> str:
    if is_flag(node):
        return "uint32"
    match node:
        case Number() | Binary() | Unary():
            return "int64"
        case Text():
            return "string"
        case BytesNode():
            return "bytes"
        case Call(function=function):
            gives = FUNCTIONS[function].gives
            return {"number": "int64", "time": "int64", "bytes": "bytes"}.get(gives, "string")
        case Conditional(then=then, otherwise=otherwise):
            first, second = _of_node(then, fields), _of_node(otherwise, fields)
            return first if first == second else _joined({first, second}) or "string"
        case Name(name=name):
            segment = fields.get(name)
            if isinstance(segment, Field):
                return FieldUse.of_field(segment).kind
            if isinstance(segment, (Length, Count, Bits)):
                return "uint64"
    return "string"


_WHOLE = ("uint32", "int32", "uint64", "int64")


def _joined(kinds: set[str]) -> str | None:
    """Return a field type that holds all values of the given types; None if no such type exists."""
    if len(kinds) == 1:
        return next(iter(kinds))
    if kinds <= {"uint32", "uint64"}:
        return "uint64"
    if kinds <= {"uint32", "int32", "int64"}:
        return "int64"
    return None


@dataclass(frozen=True, slots=True)
class FilterField:
    """A field of Wireshark: its filter name, its label, its display and its documentation."""

    filter: str
    label: str
    use: FieldUse
    doc: str


class FilterFields:
    """The fields of a protocol; each use has a number, by which the tables of frames refer to it."""

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix
        self._uses: dict[tuple[str, str, FieldUse], tuple[int, str]] = {}

    def use(self, frame: Frame, name: str, use: FieldUse, doc: str) -> int:
        """Return the number of a use of a name in a frame, registered if it is new."""
        return self._uses.setdefault((frame.name, name, use), (len(self._uses) + 1, doc))[0]

    def all(self) -> tuple[dict[int, int], list[FilterField]]:
        """Return the index of the field for each use, and the fields."""
        kinds: dict[str, set[str]] = {}
        for _, name, use in self._uses:
            kinds.setdefault(identifier(name), set()).add(use.kind)
        found: dict[FilterField, int] = {}
        places: dict[int, int] = {}
        for (frame, name, use), (number, doc) in self._uses.items():
            short = identifier(name)
            own = f"{short}_" if short in OWN else short
            joined = _joined(kinds[short])
            if joined is None:
                own, joined = f"{identifier(frame)}.{short}", use.kind
            shown = FilterField(f"{self.prefix}.{own}", name, FieldUse(joined, use.values), doc)
            places[number] = found.setdefault(shown, len(found) + 1)
        return places, list(found)
