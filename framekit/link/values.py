"""Values that sequences and services work with: frames as values, and what a dot in an expression means.

Codecs give and take plain dictionaries; an inner frame there is `{frame: fields}`, here it is a `FrameValue`.
Knows nothing of sequences, services or the line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any


class FrameValue:
    """A frame as a value: received (`raw`, perhaps `refusal`), or made by a constructor and not yet sent.

    `fields` are the values a codec decodes or is to encode. What is computed when a frame is built stands beside them
    once it has been sent; `pending` reads it at the first use of what `known` has not. `'name' in value` asks for a
    field.
    """

    __slots__ = ("fields", "frame", "known", "pending", "raw", "refusal")

    def __init__(
        self, frame: str, fields: dict[str, Any], raw: bytes | None = None, refusal: int | None = None
    ) -> None:
        self.frame = frame
        self.fields = fields
        self.raw = raw
        self.refusal = refusal
        self.pending: Callable[[], dict[str, Any]] | None = None
        self.known: dict[str, Any] | None = None

    def complete(self) -> dict[str, Any]:
        """All fields, the computed ones of a sent frame included."""
        if self.pending is not None:
            read, self.pending = self.pending, None
            self.known = read()
        return self.fields if self.known is None else {**self.known, **self.fields}

    @property
    def was_built(self) -> bool:
        """Whether it has become bytes, on its own or inside another frame."""
        return self.raw is not None or self.pending is not None or self.known is not None

    def field(self, name: str) -> Any:
        """A field by name. Raises KeyError."""
        if name in self.fields:
            return self.fields[name]
        if self.pending is not None and (self.known is None or name not in self.known):
            self.complete()
        if self.known is None:
            raise KeyError(name)
        return self.known[name]

    def set_field(self, name: str, value: Any) -> None:
        """Changes a field; what was computed for the old ones is gone."""
        self.fields[name] = value
        self.raw = self.pending = self.known = None

    def language_attribute(self, name: str) -> Any:
        """`value.name` for callers that know only the protocol of attributes, generated codecs for one."""
        return attribute(self, name)

    def copy(self) -> FrameValue:
        """The same frame with fields of its own, to be changed and sent."""
        return FrameValue(self.frame, dict(self.fields), self.raw, self.refusal)

    def __contains__(self, name: object) -> bool:
        return name in self.fields or ((self.pending is not None or self.known is not None) and name in self.complete())

    def __repr__(self) -> str:
        return f"<{self.frame} {self.fields}>"


def attribute(value: Any, name: str) -> Any:
    """`value.name` of the language. A list has its items' attributes. Raises KeyError for what is not there."""
    if type(value) is FrameValue:
        if name in value.fields:
            return value.fields[name]
        if name == "frame":
            return value.frame
        if name == "refusal" and name not in value:
            return value.refusal or 0
        return value.field(name)
    if type(value) is dict or isinstance(value, Mapping):
        return value[name]
    if isinstance(value, (list, tuple)):
        return [attribute(item, name) for item in value]
    return value.language_attribute(name)


def plain(value: Any) -> Any:
    """The value as codecs take it: frame values inside become `{frame: fields}`, as sent if they have been sent."""
    if type(value) is FrameValue:
        fields = value.fields if value.raw is None else value.complete()
        return {value.frame: {name: plain(item) if type(item) in HOLDERS else item for name, item in fields.items()}}
    if type(value) is dict:
        return {name: plain(item) if type(item) in HOLDERS else item for name, item in value.items()}
    if type(value) is list:
        return [plain(item) for item in value]
    return value


HOLDERS = frozenset((FrameValue, dict, list))
"""What may hold frame values."""


def frames_in(value: Any) -> Iterator[str]:
    """The names of a frame and of those in it."""
    if type(value) is FrameValue:
        yield value.frame
        value = value.fields
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from frames_in(part)
