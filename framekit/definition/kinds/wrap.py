"""`wrap`: a region that is converted as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import ClassVar, Self

from framekit.definition.codings import CODING, Coding, Doubled, Hex, Plain
from framekit.definition.expression import Expression, Number
from framekit.definition.keys import EXPRESSION, NUMBER, Form, KeyReading, key, keys, ref
from framekit.definition.kinds.base import Contents, Given, Segment, Segments, all_fixed, least_size, sizes_of
from framekit.definition.kinds.choose import SEGMENTS
from framekit.definition.problems import Problem
from framekit.definition.tree import Node
from framekit.definition.wire_types import SIZE, Size, Sizes, exactly


def _inside(reading: KeyReading, node: Node) -> tuple[str, ...]:
    loader = reading.loader
    return tuple(chain(*reading.reader.each(reading.reader.items(node), partial(loader.find_frames, loader.space))))


def _most(reading: KeyReading, node: Node) -> Size | None:
    size: Size = SIZE.read(reading, node)
    return None if size == "rest" else size


def _size(reading: KeyReading) -> int | Expression | None:
    """Return the size on the wire, from `size`, or computed from `plain`. Raises Broken."""
    reader, node, plain = reading.reader, reading.keys.get("size"), reading.keys.get("plain")
    size_node = node if plain is None else plain
    if size_node is None:
        return None
    size = _most(reading, size_node)
    if size is None or size == "rest":
        raise reader.broken(size_node.at, "the rest is what a wrap takes without a size", "leave size out")
    if plain is None:
        return size
    if node is not None:
        raise reader.broken(plain.at, "size says how many bytes there are, and plain says it too", "leave one out")
    coding: Coding = reading.found["coding"]
    on_wire = coding.size_of(Number(plain.at, size) if isinstance(size, int) else size.root)
    if on_wire is None:
        what = "how many bytes the content takes on the wire depends on the content"
        raise reader.broken(plain.at, what, "take size, or let the constant behind the wrap end it")
    return coding.sizes(exactly(size)).fixed if isinstance(size, int) else Expression(f"plain: {size}", on_wire)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wrap(Segment):
    """A region that is converted as a whole by `coding`."""

    KEY: ClassVar[str] = "wrap"

    coding: Coding = key("wrap", CODING)
    of: Segments = key("of", SEGMENTS, "The content.")
    size: int | Expression | None = keys(
        {
            "size": {**SIZE.schema, "description": "Number of bytes of the content on the wire."},
            "plain": {
                **SIZE.schema,
                "description": "Number of bytes of the content; the number of bytes on the wire follows from it.",
            },
        },
        _size,
        default=None,
    )
    """Number of bytes on the wire; None if the region ends by itself (a doubled byte), at the next constant, or with
    its frame.
    """
    inside: tuple[str, ...] = key(
        "inside",
        Form(ref("labels"), _inside),
        "Frames that may come anywhere in the content; no length and no check counts them.",
        default=(),
    )
    """Frames that may occur anywhere in it."""
    insert: Expression | None = key("insert", EXPRESSION, "When such frames may be sent inside.", default=None)
    """Condition for sending such frames inside."""
    least: int = key("min", NUMBER, "Least number of plain bytes.", default=0)
    """Least size of the plain content (bytes)."""
    most: int | Expression | None = key(
        "max", SIZE._replace(read=_most), "Greatest number of plain bytes.", default=None
    )
    """Greatest size of the plain content (bytes)."""

    @property
    def blocks(self) -> tuple[Segments, ...]:
        return (self.of,)

    def with_blocks(self, change: Callable[[Segments], Segments]) -> Self:
        return replace(self, of=change(self.of))

    @property
    def is_there_inside(self) -> bool:
        return True

    @property
    def escape(self) -> int | None:
        """Return the byte that is doubled in the content; None for other codings."""
        return self.coding.escape if isinstance(self.coding, Doubled) else None

    @property
    def ends_itself(self) -> bool:
        """Return whether its end follows from its size or its content."""
        return self.size is not None or self.escape is not None

    @property
    def takes_rest(self) -> bool:
        return not self.ends_itself and not isinstance(self.coding, Hex)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        if isinstance(self.size, int):
            return exactly(self.size)
        return self.coding.sizes(sizes_of(self.of, of_frame)) if self.size is None else Sizes(0, None)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        return self.coding.contents

    def given(self) -> Iterator[Given]:
        yield from Segment.given(self)
        yield self.most if isinstance(self.most, Expression) else None, "number", None
        yield self.insert, "any", None
        for _, value in self.coding.expressions:
            yield value, "bytes", None

    def needed(self) -> Iterator[tuple[str, Expression]]:
        yield from Segment.needed(self)
        yield from self.coding.expressions

    def check(self) -> Iterator[Problem]:
        yield from self.coding.check()
        yield from self.coding.check_content(all_fixed(self.of))
        if self.size is not None and self.escape is not None:
            what = "the escape byte that is not doubled ends the content, and size says where it ends too"
            yield Problem(self.at, what, "leave size out")
        if isinstance(self.coding, Plain) and self.size is None:
            todo = "add size:, or put the content there without a wrap"
            yield Problem(self.at, "wrap: none only says how many bytes the content takes", todo)
        if self.inside and self.escape is None:
            what = "frames stand inside only where a byte is doubled"
            yield Problem(self.at, what, "leave inside out, or take wrap: {escape: BYTE}")
        least = least_size(self.of)
        if isinstance(self.most, int):
            if self.least > self.most:
                yield Problem(self.at, f"min {self.least} is more than max {self.most}", "exchange them")
            elif least > self.most:
                yield Problem(self.at, f"the content takes at least {least} bytes, max says {self.most}", "correct max")
        if not self.of:
            yield Problem(self.at, "there is nothing in this wrap", "add segments to of")
