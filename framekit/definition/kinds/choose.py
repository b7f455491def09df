"""`choose`, `optional`: lists of segments of which at most one is present."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from collections.abc import Mapping as MappingOf
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from framekit.definition.expression import Expression
from framekit.definition.keys import EXPRESSION, Form, KeyReading, here, key
from framekit.definition.kinds.base import Given, Segment, Segments, sizes_of
from framekit.definition.load.reader import Reader, parse_key
from framekit.definition.problems import Problem, did_you_mean
from framekit.definition.tree import Node
from framekit.definition.wire_types import Sizes, either

Cases = tuple[tuple[tuple[int | str, ...], Segments], ...]


def _cases(reading: KeyReading, node: Node) -> Cases:
    return tuple(
        (tuple(parse_key(part) for part in entry.key.text.split(",")), reading.loader.load(entry.value))
        for entry in reading.reader.entries(node)
    )


SEGMENTS = Form(here("segments"), lambda r, node: r.loader.load(node))
CASES = Form({"type": "object", "minProperties": 1, "additionalProperties": here("segments")}, _cases)


@dataclass(frozen=True, slots=True, kw_only=True)
class Choose(Segment):
    """Selects the case with the value of `on`; its fields belong to the surrounding record.

    A value without a case is a fault.
    """

    KEY: ClassVar[str] = "choose"

    cases: Cases = key(
        "cases", CASES, "Segments for each value, VALUE: [segments]; one case for several values: 1, 2: [segments]."
    )
    on: Expression = key("choose", EXPRESSION, "The value that decides.")
    otherwise: Segments | None = key("else", SEGMENTS, "Segments for any other value.", default=None)

    @property
    def blocks(self) -> tuple[Segments, ...]:
        cases = tuple(case for _, case in self.cases)
        return cases if self.otherwise is None else (*cases, self.otherwise)

    def with_blocks(self, change: Callable[[Segments], Segments]) -> Self:
        cases = tuple((keys, change(case)) for keys, case in self.cases)
        return replace(self, cases=cases, otherwise=None if self.otherwise is None else change(self.otherwise))

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return either(sizes_of(block, of_frame) for block in self.blocks)

    @property
    def usual_block(self) -> Segments:
        return self.otherwise or ()

    def needed(self) -> Iterator[tuple[str, Expression]]:
        yield from Segment.needed(self)
        yield "choice", self.on

    def given(self) -> Iterator[Given]:
        yield from Segment.given(self)
        yield self.on, "any", None

    @property
    def chooses_by(self) -> Expression | None:
        return self.on

    def with_numbers(self, reader: Reader, numbers: MappingOf[str, int] | None) -> Segment:
        if numbers is None:
            return self

        def number(key: int | str) -> int | str:
            if isinstance(key, str) and key not in numbers:
                what = f"'{key}' is not a name of this field's values"
                reader.note(self.at, what, did_you_mean(key, numbers))
            return numbers.get(key, key) if isinstance(key, str) else key

        return replace(self, cases=tuple((tuple(map(number, keys)), segments) for keys, segments in self.cases))

    def check(self) -> Iterator[Problem]:
        seen: set[int | str] = set()
        for keys, _ in self.cases:
            for one in keys:
                if one in seen:
                    yield Problem(self.at, f"there are two cases {one}", "join them")
                seen.add(one)


@dataclass(frozen=True, slots=True, kw_only=True)
class Optional(Segment):
    """Segments that are present if their values are given, and read if bytes remain in the region."""

    KEY: ClassVar[str] = "optional"

    of: Segments = key("optional", SEGMENTS, "Segments that are there if their values are given, or if bytes are left.")

    @property
    def blocks(self) -> tuple[Segments, ...]:
        return (self.of,)

    def with_blocks(self, change: Callable[[Segments], Segments]) -> Self:
        return replace(self, of=change(self.of))

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return Sizes(0, sizes_of(self.of, of_frame).most)

    @property
    def takes_rest(self) -> bool:
        return True
