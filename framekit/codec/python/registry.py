"""The kinds of segments by their class in the model. `codec.kinds` fills it."""

from __future__ import annotations

from typing import Any

from framekit.definition.model.segments import Segment

KINDS: dict[type[Segment], Any] = {}


def kind_of(segment: Segment) -> Any:
    """The kind of a segment. Raises KeyError if it is not registered."""
    return KINDS[type(segment)]


def struct_order(segment: Segment) -> str | None:
    """The byte order a segment needs in a struct ('' for any); None if it does not fit into one."""
    found: str | None = None if segment.when is not None else kind_of(segment).struct_order(segment)
    return found
