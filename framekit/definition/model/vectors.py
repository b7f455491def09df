"""Test cases beside a definition, as values: frames with their bytes, and conversations on virtual time.

Language reference, section 15. What is in a case stays plain (text, lists, mappings) until a runner gives it a meaning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from framekit.definition.expression.syntax import Expression
from framekit.definition.problems import Position


@dataclass(frozen=True, slots=True)
class Wire:
    """Bytes of a case; None is a byte that is not compared. `tail` follows a computed check code, if there is one."""

    head: tuple[int | None, ...]
    tail: tuple[int | None, ...] | None = None

    @property
    def exact(self) -> bytes | None:
        """The bytes, when each of them is known."""
        if self.tail is not None or None in self.head:
            return None
        return bytes(byte for byte in self.head if byte is not None)

    def matches(self, data: bytes) -> bool:
        """Whether `data` is as written here; a check code takes whatever its place leaves, at least one byte."""
        if self.tail is None:
            return len(data) == len(self.head) and _fit(self.head, data)
        free = len(data) - len(self.head) - len(self.tail)
        return free > 0 and _fit(self.head, data) and _fit(self.tail, data[len(self.head) + free :])

    def __str__(self) -> str:
        words = _words(self.head)
        return " ".join(words if self.tail is None else [*words, "check", *_words(self.tail)])


def _fit(wanted: tuple[int | None, ...], data: bytes) -> bool:
    return all(byte is None or byte == found for byte, found in zip(wanted, data, strict=False))


def _words(wanted: tuple[int | None, ...]) -> list[str]:
    return ["xx" if byte is None else f"{byte:02X}" for byte in wanted]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameVector:
    """A frame both ways, or bytes and what becomes of them (`expect`: bad, refused or noise; the cause or number).

    `places`: where the value of a key stands, and the name of an entry under `KEY.NAME`; for messages.
    """

    at: Position
    name: str
    frame: str | None
    values: Mapping[str, Any] | None
    wire: Wire
    side: str | None = None
    params: Mapping[str, Any] = field(default_factory=dict)
    state: Mapping[str, Any] = field(default_factory=dict)
    request: Mapping[str, Any] | None = None
    expect: tuple[Literal["bad", "refused", "noise"], str | int] | None = None
    source: str = ""
    second_source: str = ""
    places: Mapping[str, Position] = field(default_factory=dict, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScriptLine:
    """One line of a script. `wire` is for send and receive, `time` for break, silence and wait, else `word`."""

    at: Position
    kind: Literal["send", "receive", "break", "silence", "wait", "line", "connection"]
    wire: Wire | None = None
    time: Expression | None = None
    word: str = ""
    not_before: Expression | None = None
    within: Expression | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What comes out; None is not looked at. `state` and `memory` are compared afterwards."""

    values: Any = None
    error: int | None = None
    outcome: str | None = None
    state: Mapping[str, Any] = field(default_factory=dict)
    memory: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversation:
    """One side, what it starts with, what it is asked to do, and what goes over the line. `places`: as in frames."""

    at: Position
    name: str
    role: str | None
    own: Any
    station: Any
    params: Mapping[str, Any]
    memory: Mapping[str, Any]
    state: Mapping[str, Any]
    do: Mapping[str, Any] | None
    script: tuple[ScriptLine, ...]
    result: Result
    source: str = ""
    second_source: str = ""
    places: Mapping[str, Position] = field(default_factory=dict, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Vectors:
    """The cases of one file; `protocol` is the definition they belong to."""

    protocol: str
    about: str
    frames: tuple[FrameVector, ...]
    conversations: tuple[Conversation, ...]
    at: Position
    protocol_at: Position
