"""Register the kinds of segments by model class, and describe frames for docstrings.

`codec.kinds` fills the registry. A description looks like `station u8 · function u8 = 3 · count u16 big · check
crc16-arc`.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from decimal import Decimal
from typing import Any

from framekit.codec.python.source import Source
from framekit.definition.model.segments import FieldType, Segment

KINDS: dict[type[Segment], Any] = {}
"""The kinds of segments, by model class."""


def kind_of(segment: Segment) -> Any:
    """Return the kind of a segment. Raises KeyError if it is not registered."""
    return KINDS[type(segment)]


def struct_order(segment: Segment) -> str | None:
    """Return the byte order of a segment in a struct ('' for any); None if no struct can hold it."""
    found: str | None = None if segment.when is not None else kind_of(segment).struct_order(segment)
    return found


_DIGITS = {16: "hex", 10: "dec", 8: "oct"}


def summary(segments: Iterable[Segment]) -> str:
    """Return the description of the segments in order."""
    return " · ".join(part for segment in segments if (part := _with_condition(segment)))


def write_docstring(out: Source, first: str, layout: str, *more: str, notes: Sequence[str] = ()) -> None:
    """Write a docstring: one line if everything fits, else the sentence, a blank line and the layout.

    `notes` follow at its end.
    """
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
    text: str = kind_of(segment).describe(segment)
    if not text or segment.when is None:
        return text
    return f"{text} if {segment.when}"


def type_text(type_: FieldType) -> str:
    """Return a type in the notation of the language: `u16 little`, `hex 4`, `ascii 8`."""
    size = type_.fixed_size
    if type_.kind == "int" and size is not None:
        order = "" if size == 1 else f" {type_.order}"
        return f"{'i' if type_.signed else 'u'}{8 * size}{order}"
    if type_.kind == "float" and size is not None:
        return f"f{8 * size} {type_.order}"
    if type_.inside is not None and type_.scale is not None:
        factor = Decimal(f"{type_.scale.factor}E-{type_.scale.places}")
        return f"{type_text(type_.inside)} × {factor}"
    if type_.kind in ("hex_int", "hex_float"):
        return f"{'i' if type_.kind == 'hex_int' else 'f'}{4 * (size or 0)} {type_.order} in hex"
    if type_.form is not None:
        point = f" with {'any' if type_.form.decimals is None else type_.form.decimals} decimals"
        return f"decimal{'' if type_.size is None else f' {type_.size}'}{point if type_.form.decimals != 0 else ''}"
    name = _DIGITS[type_.base] if type_.kind == "digits" else "uint" if type_.kind == "int" else type_.kind
    return name if type_.size is None else f"{name} {type_.size}"
