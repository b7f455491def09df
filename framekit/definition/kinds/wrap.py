"""`wrap`: a region that is converted as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

from framekit.definition.expression import Expression
from framekit.definition.keys import BYTE, EXPRESSION, NUMBER, Form, KeyReading, key, keys, ref
from framekit.definition.kinds.base import Contents, Given, Segment, Segments, least_size, sizes_of
from framekit.definition.kinds.choose import SEGMENTS
from framekit.definition.problems import Problem
from framekit.definition.tree import Node, Scalar
from framekit.definition.wire_types import DIGITS, EVERY_BYTE, SIZE, Size, Sizes

WRAP = {
    "title": "wrap",
    "description": "hex: the content stands as hex digits; {escape: BYTE}: this byte is doubled in the content.",
    "type": ["string", "object"],
    "pattern": "^hex$",
    "x-expected": "a wrap (hex or {escape: BYTE})",
    "required": ["escape"],
    "properties": {"escape": {**BYTE.schema, "description": "The byte that is doubled."}},
    "additionalProperties": False,
}


def _how(reading: KeyReading) -> Literal["hex", "escape"]:
    return "hex" if isinstance(reading.keys.get("wrap"), Scalar) else "escape"


def _escape(reading: KeyReading) -> int | None:
    how = reading.keys.get("wrap")
    return None if isinstance(how, Scalar) else reading.reader.byte(reading.reader.mapping(how).get("escape"))


def _inside(reading: KeyReading, node: Node) -> tuple[str, ...]:
    loader = reading.loader
    return tuple(name for item in reading.reader.items(node) for name in loader.find_frames(loader.space, item))


def _most(reading: KeyReading, node: Node) -> Size | None:
    size: Size = SIZE.read(reading, node)
    return None if size == "rest" else size


@dataclass(frozen=True, slots=True, kw_only=True)
class Wrap(Segment):
    """A region that is converted as a whole: as hex digits, or with every `escape` byte doubled.

    `least` and `most` limit the plain content; `inside` are frames that may stand anywhere in it, `insert` says when
    they may be sent so.
    """

    KEY: ClassVar[str] = "wrap"

    how: Literal["hex", "escape"] = keys({"wrap": WRAP}, _how)
    escape: int | None = keys({}, _escape, default=None)
    of: Segments = key("of", SEGMENTS, "The content.")
    inside: tuple[str, ...] = key(
        "inside",
        Form(ref("labels"), _inside),
        "Frames that may stand anywhere in the content and count in nothing.",
        default=(),
    )
    insert: Expression | None = key("insert", EXPRESSION, "When such frames may be sent inside.", default=None)
    least: int = key("min", NUMBER, "Least number of plain bytes.", default=0)
    most: int | Expression | None = key(
        "max", SIZE._replace(read=_most), "Greatest number of plain bytes.", default=None
    )

    @property
    def blocks(self) -> tuple[Segments, ...]:
        return (self.of,)

    def with_blocks(self, change: Callable[[Segments], Segments]) -> Self:
        return replace(self, of=change(self.of))

    @property
    def is_there_inside(self) -> bool:
        return True

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        content = sizes_of(self.of, of_frame)
        return content.times(2, 2) if self.how == "hex" else Sizes(content.least, content.times(1, 2).most)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        return DIGITS if self.how == "hex" else EVERY_BYTE

    def given(self) -> Iterator[Given]:
        yield from Segment.given(self)
        yield self.most if isinstance(self.most, Expression) else None, "number", None
        yield self.insert, "any", None

    def check(self) -> Iterator[Problem]:
        least = least_size(self.of)
        if isinstance(self.most, int):
            if self.least > self.most:
                yield Problem(self.at, f"min {self.least} is more than max {self.most}", "exchange them")
            elif least > self.most:
                yield Problem(self.at, f"the content takes at least {least} bytes, max says {self.most}", "correct max")
        if not self.of:
            yield Problem(self.at, "there is nothing in this wrap", "add segments to of")
