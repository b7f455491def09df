"""`const`, `text`, `skip`: constant bytes, and bytes without a meaning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from framekit.definition.keys import BYTES, BYTES_AT_MOST, Form, KeyReading, key
from framekit.definition.kinds.base import Contents, Segment, SegmentLoading, Segments
from framekit.definition.tree import Mapping, Node
from framekit.definition.wire_types import ANY, Sizes, exactly


def _characters(reading: KeyReading, node: Node) -> bytes:
    reader = reading.reader
    scalar = reader.scalar(node)
    try:
        return scalar.text.encode("latin-1")
    except UnicodeEncodeError:
        curly = any(sign in scalar.text for sign in "“”„‘’")
        todo = "use straight quotes" if curly else "use const: with hex"
        raise reader.broken(scalar.at, "the text has characters that are no bytes", todo) from None


CHARACTERS = Form({"type": ["string", "integer", "number", "boolean"], "minLength": 1}, _characters)


@dataclass(frozen=True, slots=True, kw_only=True)
class Const(Segment):
    """Constant bytes (`const`, `text`)."""

    KEY: ClassVar[str] = "const"

    data: bytes = key("const", BYTES, "Bytes that are always there, as hex pairs and control names.")

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return exactly(len(self.data))

    def contents(self, of_frame: Contents) -> frozenset[int]:
        return frozenset(self.data)

    @property
    def title(self) -> str:
        return f"the constant {self.data.hex(' ').upper()}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TextKeys(Const):
    """The keys of `text`; they are read into a `Const`."""

    KEY: ClassVar[str] = "text"

    data: bytes = key("text", CHARACTERS, "Characters that are always there.")

    @classmethod
    def load(cls, loader: SegmentLoading, keys: Mapping) -> Segments:
        return (Const(**loader.common(keys, "text"), **cls.attributes(loader, keys)),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Skip(Segment):
    """Bytes without meaning; `fill` is repeated to `size` when building."""

    KEY: ClassVar[str] = "skip"
    is_ignored: ClassVar[bool] = True

    size: int = key("skip", BYTES_AT_MOST, "Number of bytes without meaning.")
    fill: bytes = key("fill", BYTES, "What is sent there; default 00.", default=b"\0")

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return exactly(self.size)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fill(Segment):
    """Filling of a frame of fixed size between body and tail."""

    total: int
    """Size of the whole frame (bytes)."""
    byte: int
    """Byte that fills."""

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return ANY

    @property
    def whole_frame(self) -> int | None:
        return self.total
