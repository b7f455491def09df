"""Frames in words, for docstrings: `station u8 · function u8 = 3 · count u16 big · check crc16-arc`."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from framekit.codec.python.source import Source, literal
from framekit.definition.model.segments import (
    Bits,
    Check,
    Choose,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Optional,
    Record,
    Repeat,
    Require,
    Segment,
    Skip,
    Value,
    Wrap,
)

_DIGITS = {16: "hex", 10: "dec", 8: "oct"}


def summary(segments: Iterable[Segment]) -> str:
    """The segments in order."""
    return " · ".join(part for segment in segments if (part := _with_condition(segment)))


def write_docstring(out: Source, first: str, layout: str, *more: str, notes: Sequence[str] = ()) -> None:
    """A docstring: one line if everything fits, else the sentence, a blank line and the layout; `notes` at its end."""
    lines = [first]
    for text in (layout, *more):
        if text:
            lines += ["", *textwrap.wrap(text, 100)]
    if notes:
        lines.append("")
    for note in notes:
        lines += textwrap.wrap(note, 100, subsequent_indent="    ")
    out.docstring(*lines)


def _with_condition(segment: Segment) -> str:
    text = _one(segment)
    if not text or segment.when is None:
        return text
    return f"{text} if {segment.when}"


def _one(segment: Segment) -> str:
    match segment:
        case Const(data=data):
            return f"{data.hex(' ').upper()}" if not data.isalnum() else literal(data.decode("latin-1"))
        case Field():
            return _field(segment)
        case Bits(parts=parts, type=type_):
            names = ", ".join(f"{part.name} {_places(part.low, part.high)}" for part in parts)
            return f"bits {type_text(type_)} ({names})"
        case Data(name=name, size=size, convert=convert):
            how = "" if convert is None else f" {convert}"
            return f"{name} bytes[{size}]{how}"
        case Length(name=name, type=type_, of=of):
            return f"{name} {type_text(type_)} = length of {_names(of)}"
        case Count(name=name, type=type_, of=of):
            return f"{name} {type_text(type_)} = number of {of}"
        case Repeat(name=name, times=times, of=of):
            inside = type_text(of) if isinstance(of, FieldType) else f"({summary(of)})"
            return f"{name} {times} × {inside}"
        case Value(name=name, read=read):
            return f"{name} := {read}"
        case Skip(size=size):
            return f"{size} bytes" if size > 1 else "1 byte"
        case Check(method=method, form=form):
            return f"check {method.name}" + ("" if form == "raw" else f" as {form}")
        case Require(condition=condition):
            return f"({condition})"
    return _with_others(segment)


def _with_others(segment: Segment) -> str:
    match segment:
        case Record(name=name, of=of):
            return f"{name} ({summary(of)})"
        case Inner(name=name, frames=frames):
            shown = ", ".join(frames[:3]) + (", …" if len(frames) > 3 else "")
            return f"{name} (one of {shown})" if len(frames) > 1 else f"{name} ({shown})"
        case Wrap(how=how, of=of, escape=escape):
            return f"{'hex digits' if how == 'hex' else f'{escape:02X} doubled'} ({summary(of)})"
        case Choose(on=on, cases=cases):
            shown = "; ".join(f"{', '.join(str(key) for key in keys)}: {summary(of)}" for keys, of in cases)
            return f"by {on} ({shown})"
        case Optional(of=of):
            return f"[{summary(of)}]"
    return ""


def _names(names: tuple[str, ...]) -> str:
    return ", ".join(name for name in names if not name.startswith("_")) or "what follows"


def _places(low: int, high: int) -> str:
    return str(low) if low == high else f"{low}-{high}"


def _field(field: Field) -> str:
    text = f"{field.name} {type_text(field.type)}"
    if field.constants is not None:
        return f"{text} = {' or '.join(_constant(value) for value in field.constants)}"
    if field.is_ is not None:
        return f"{text} = {field.is_}"
    return text


def _constant(value: int | str | bytes) -> str:
    return value.hex(" ").upper() if isinstance(value, bytes) else str(value)


def type_text(type_: FieldType) -> str:
    """A type as the language writes it: `u16 little`, `hex 4`, `ascii 8`."""
    size = type_.fixed_size
    if type_.kind == "int" and size is not None:
        order = "" if size == 1 else f" {type_.order}"
        return f"{'i' if type_.signed else 'u'}{8 * size}{order}"
    if type_.kind == "float" and size is not None:
        return f"f{8 * size} {type_.order}"
    name = _DIGITS[type_.base] if type_.kind == "digits" else "uint" if type_.kind == "int" else type_.kind
    return name if type_.size is None else f"{name} {type_.size}"
