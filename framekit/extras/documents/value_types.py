"""The types of decoded values, as `framekit decode --json` prints them: JSON Schema, and TypeScript.

`{"frame": NAME, "fields": {...}}`, in which the fields of each frame are an object of its own. Bytes are hex pairs in
text, times are text with a unit, exact decimals are numbers, or text if a float would change the number. `names`
has the names of numbers by their places in the fields.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from typing import Any

from framekit.definition.kinds.base import Segments
from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Bits, Field, FieldType, Nested, Segment

DRAFT = "https://json-schema.org/draft/2020-12/schema"
_BYTES = {"type": "string", "pattern": "^([0-9A-F]{2}( [0-9A-F]{2})*)?$"}
_NAMES = {"type": "object", "additionalProperties": {"type": "string"}}
_SAFE = 1 << 53
"""Whole numbers up to this are exact in JavaScript."""

Schema = dict[str, Any]


def json_schema(protocol: Protocol) -> Schema:
    """Return the schema of all decoded values: one of the frames of the line; each frame has its own definition."""
    definitions = {frame.name: _object(frame.segments) for frame in protocol.frames.values()}
    frames = [frame for frame in protocol.frames.values() if not frame.inner] or list(protocol.frames.values())
    return {
        "$schema": DRAFT,
        "title": protocol.name,
        **({"description": protocol.about} if protocol.about else {}),
        **({"oneOf": [_decoded(frame) for frame in frames]} if frames else {"not": {}}),
        "$defs": definitions,
    }


def _decoded(frame: Frame) -> Schema:
    return {
        "type": "object",
        "required": ["frame", "fields"],
        "properties": {"frame": {"const": frame.name}, "fields": {"$ref": _place(frame.name)}, "names": _NAMES},
        **({"description": frame.doc} if frame.doc else {}),
    }


def _place(name: str) -> str:
    return "#/$defs/" + name.replace("~", "~0").replace("/", "~1")


def _object(segments: Segments) -> Schema:
    """Return the schema of the values of a record; values that may be absent are not required."""
    properties: Schema = {}
    required: list[str] = []
    for segment, always in _segments(segments, True):
        for name in segment.value_names:
            known = properties.get(name)
            one = _value(segment, name)
            if segment.doc:
                one = {**one, "description": segment.doc}
            properties[name] = one if known in (None, one) else {"anyOf": [*_alternatives(known), one]}
            if always and segment.takes_bytes and name not in required:
                required.append(name)
    found: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    return {**found, "required": required} if required else found


def _alternatives(known: Schema) -> list[Schema]:
    return list(known["anyOf"]) if set(known) == {"anyOf"} else [known]


def _segments(segments: Segments, always: bool) -> Iterator[tuple[Segment, bool]]:
    """Yield the segments of one record, with whether each is always present."""
    for segment in segments:
        here = always and segment.when is None
        yield segment, here
        for block in segment.blocks:
            yield from _segments(block, here and segment.is_there_inside)


def _value(segment: Segment, name: str) -> Schema:
    if isinstance(segment, Bits):
        width = next((part.high - part.low + 1 for part in segment.parts if part.name == name), None)
        return {"type": "integer", "minimum": 0} | ({} if width is None else {"maximum": (1 << width) - 1})
    if isinstance(segment, Nested):
        return {"$ref": _place(segment.frame)}
    if segment.frames_inside:
        return {"oneOf": [_one_frame(frame) for frame in segment.frames_inside]}
    if segment.inner_record is not None:
        record = _object(segment.inner_record)
        return {"type": "array", "items": record} if segment.is_list else record
    if segment.is_list:
        of: FieldType | None = getattr(segment, "plain_type", None)
        return {"type": "array", "items": {} if of is None else _typed(of)}
    if isinstance(segment, Field) and segment.unit is not None:
        return {"type": "string"}
    type_ = segment.number_type
    if type_ is not None:
        schema = _typed(type_)
        limits = segment.span if isinstance(segment, Field) else None
        return _whole(limits) if schema["type"] == "integer" else schema
    kind = dict(segment.value_kinds()).get(name, "any")
    kinds: dict[str, Schema] = {"bytes": _BYTES, "text": {"type": "string"}, "number": {"type": "integer"}}
    return kinds.get(kind, {})


def _one_frame(frame: str) -> Schema:
    return {
        "type": "object",
        "required": [frame],
        "properties": {frame: {"$ref": _place(frame)}},
        "additionalProperties": False,
    }


def _typed(type_: FieldType) -> Schema:
    if type_.value_kind != "number":
        return _BYTES if type_.value_kind == "bytes" else {"type": "string"}
    if not type_.is_whole_number:
        empty = type_.form is not None and type_.form.empty
        return {"type": ["number", "string", *(["null"] if empty else [])]}
    return _whole(None if type_.scale is not None else type_.bounds)


def _whole(limits: tuple[int, int] | None) -> Schema:
    """Return the schema of a whole number, with its limits if JavaScript represents them exactly."""
    found: Schema = {"type": "integer"}
    if limits is not None and limits[0] > -_SAFE:
        found["minimum"] = limits[0]
    if limits is not None and limits[1] < _SAFE:
        found["maximum"] = limits[1]
    return found


# ---- TypeScript ---------------------------------------------------------------------------------------------


def typescript(protocol: Protocol) -> str:
    """Return a module with an interface for each frame, and `Decoded` for the output of `framekit decode --json`."""
    schema = json_schema(protocol)
    names = _interfaces(schema["$defs"])
    lines = [f"// Types of {json.dumps(protocol.name)}, as `framekit decode --json` prints its frames.", ""]
    for frame, one in schema["$defs"].items():
        lines += [f"export interface {names[frame]} {_type(one, names, 0)}", ""]
    frames = [one["properties"]["frame"]["const"] for one in schema.get("oneOf", ())]
    lines.append("export type Decoded =" + ("" if frames else " never"))
    more = "names?: Record<string, string>"
    lines += [f"  | {{ frame: {json.dumps(frame)}; fields: {names[frame]}; {more} }}" for frame in frames]
    return "\n".join(lines) + ";\n"


def _interfaces(frames: Iterable[str]) -> dict[str, str]:
    """Return the name of an interface for each frame: unique, of letters and digits."""
    found: dict[str, str] = {}
    for frame in frames:
        words = "".join(word[:1].upper() + word[1:] for word in re.findall(r"[A-Za-z0-9]+", frame))
        name = base = f"Frame{words}" if not words[:1].isalpha() or words == "Decoded" else words
        number = 2
        while name in found.values():
            name, number = f"{base}{number}", number + 1
        found[frame] = name
    return found


def _type(schema: Schema, names: dict[str, str], depth: int) -> str:
    if "$ref" in schema:
        return names[schema["$ref"].removeprefix("#/$defs/").replace("~1", "/").replace("~0", "~")]
    for key in ("oneOf", "anyOf"):
        if key in schema:
            return " | ".join(dict.fromkeys(_type(one, names, depth) for one in schema[key]))
    kind = schema.get("type")
    if kind == "object":
        space, required = "  " * (depth + 1), schema.get("required", ())
        rows = [
            f"{space}{json.dumps(name)}{'' if name in required else '?'}: {_type(one, names, depth + 1)};\n"
            for name, one in schema["properties"].items()
        ]
        return "{\n" + "".join(rows) + "  " * depth + "}"
    if kind == "array":
        return f"Array<{_type(schema['items'], names, depth)}>"
    words = {"integer": "number", "number": "number", "string": "string", "null": "null"}
    kinds = kind if isinstance(kind, list) else [kind]
    return " | ".join(words.get(str(one), "unknown") for one in kinds)
