"""Which kind of value has what: segments, variables and parameters by their types."""

from __future__ import annotations

from collections.abc import Iterable

from framekit.definition.check.kinds import Kind
from framekit.definition.model.protocol import StateVariable
from framekit.definition.model.segments import Bits, Count, Data, Field, FieldType, Inner, Length, Repeat, Segment
from framekit.definition.model.walk import flat

VARIABLE_KINDS: dict[str, Kind] = {
    "flag": "number", "number": "number", "time": "time", "text": "text", "choice": "text", "bytes": "bytes",
    "list": "list", "frame": "frame",
}  # fmt: skip
_TYPES: dict[str, Kind] = {"int": "number", "float": "number", "digits": "number", "bcd": "number", "ascii": "text"}


def field_kinds(segments: Iterable[Segment]) -> dict[str, Kind]:
    """Kinds of the values of segments; a field whose numbers have names is `any`, since names stand for numbers."""
    found: dict[str, Kind] = {}
    for segment in flat(segments):
        if isinstance(segment, Bits):
            for part in segment.parts:
                add_kind(found, part.name, "number" if part.values is None else "any")
        elif segment.name:
            add_kind(found, segment.name, kind_of_segment(segment))
    return found


def named_numbers(segments: Iterable[Segment]) -> frozenset[str]:
    """The names of values that are numbers for every function, and that a text may be compared with."""
    values = [*flat(segments)]
    fields = {one.name for one in values if isinstance(one, Field) and one.values is not None}
    parts = {part.name for one in values if isinstance(one, Bits) for part in one.parts if part.values is not None}
    others = {one.name for one in values if one.name and not (isinstance(one, Field) and one.values is not None)}
    return frozenset((fields | parts) - others)


def add_kind(found: dict[str, Kind], name: str, kind: Kind) -> None:
    """Notes the kind of a name; one with two kinds is `any`."""
    found[name] = kind if found.get(name, kind) == kind else "any"


def kind_of_segment(segment: Segment) -> Kind:
    """The kind of the value of a segment."""
    match segment:
        case Field(values=None, unit=None, type=type_):
            return _kind_of_type(type_)
        case Field(values=None):
            return "time"
        case Data():
            return "bytes"
        case Length() | Count():
            return "number"
        case Repeat():
            return "list"
        case Inner():
            return "frame"
    return "any"


def _kind_of_type(type_: FieldType) -> Kind:
    return _TYPES.get(type_.kind, "bytes")


def kind_of_variable(type_: str) -> Kind:
    """The kind of a parameter, argument or variable of that type."""
    return "number" if type_[:1] in "ui" and type_[1:].isdigit() else VARIABLE_KINDS.get(type_, "any")


def kind_of_state(variable: StateVariable) -> Kind:
    """The kind of a state variable."""
    if variable.keys is not None:
        return "table"
    return "any" if variable.values else kind_of_variable(variable.type)
