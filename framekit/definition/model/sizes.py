"""Questions about lists of segments: which belong to one level, what their values are called, how large they are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from framekit.definition.model.segments import (
    Bits,
    Check,
    Choose,
    Const,
    Data,
    Field,
    FieldType,
    Inner,
    Optional,
    Repeat,
    Segment,
    Skip,
    Wrap,
)

MOST_BYTES = 1_048_576
"""Bytes of a frame, and items of its lists, at most."""


def flat(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Segments whose fields belong to one level: those inside wraps, choices and optional parts too."""
    for segment in segments:
        yield segment
        if isinstance(segment, (Wrap, Optional)):
            yield from flat(segment.of)
        elif isinstance(segment, Choose):
            for _, case in segment.cases:
                yield from flat(case)
            yield from flat(segment.otherwise or ())


def field_names(segments: Iterable[Segment]) -> set[str]:
    """The names that values of these segments have."""
    found: set[str] = set()
    for segment in flat(segments):
        found |= _own_names(segment)
    return found


def names_needed(segments: Iterable[Segment]) -> list[str]:
    """Those without which no frame can be built: nothing else gives them a value."""
    found: list[str] = []
    for segment in segments:
        if segment.when is not None:
            continue
        if isinstance(segment, Wrap):
            found += names_needed(segment.of)
        elif isinstance(segment, (Inner, Repeat)) or (isinstance(segment, Data) and segment.pad is None):
            found.append(segment.name)
        elif isinstance(segment, Field):
            given = (segment.is_, segment.build, segment.default, segment.constants)
            found += [segment.name] if all(one is None for one in given) else []
    return found


def _own_names(segment: Segment) -> set[str]:
    if isinstance(segment, Bits):
        return {part.name for part in segment.parts}
    return {segment.name} if segment.name is not None and not segment.name.startswith("_") else set()


def names_always_there(segments: Iterable[Segment]) -> set[str]:
    """Those of them that every value has, whatever it holds."""
    found: set[str] = set()
    for segment in segments:
        if segment.when is None:
            found |= names_always_there(segment.of) if isinstance(segment, Wrap) else _own_names(segment)
    return found


def fixed_size(segment: Segment) -> int | None:
    """Bytes a segment always takes; None when that depends on content."""
    if segment.when is not None:
        return None
    if isinstance(segment, Const):
        return len(segment.data)
    if isinstance(segment, (Skip, Check)):
        return segment.size
    kind = getattr(segment, "type", None)
    if kind is not None:
        return None if getattr(segment, "long", None) else kind.fixed_size
    size = getattr(segment, "size", None)
    if isinstance(size, int):
        convert = getattr(segment, "convert", None)
        return size * 2 if convert == "hex_to_ascii" else size // 2 if convert == "ascii_to_hex" else size
    return 0 if type(segment).__name__ in ("Value", "Require") else None


def bounds_of(type_: FieldType) -> tuple[int, int] | None:
    """Least and greatest number of a type; None when it holds no whole numbers or its size is computed."""
    size = type_.fixed_size
    if size is None:
        return None
    if type_.kind == "int":
        bits = size * 8
        return (-(1 << bits - 1), (1 << bits - 1) - 1) if type_.signed else (0, (1 << bits) - 1)
    if type_.kind == "digits":
        return 0, type_.base**size - 1
    return (0, 100**size - 1) if type_.kind == "bcd" else None
