"""`inner`: a frame inside another frame, and a layout that contains itself, which is read as an inner frame, too."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import ClassVar

from framekit.definition.keys import IDENTIFIER, Form, KeyReading, ValueKind, key, ref
from framekit.definition.kinds.base import Contents, Segment, contents_of
from framekit.definition.problems import Problem
from framekit.definition.tree import Node
from framekit.definition.wire_types import ANY, EVERY_BYTE, SIZE, Size, Sizes, either, exactly


def _frames(reading: KeyReading, node: Node) -> tuple[str, ...]:
    loader = reading.loader
    found = reading.reader.each(reading.reader.items(node), partial(loader.find_frames, loader.space))
    return tuple(dict.fromkeys(chain(*found)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Inner(Segment):
    """An inner frame. `frames` are the candidates in the order they are tried; its value is `{frame: fields}`."""

    KEY: ClassVar[str] = "inner"
    VALUE: ClassVar[ValueKind | None] = "frame"
    WANTED: ClassVar[bool] = True

    name: str = key("inner", IDENTIFIER, "Name of the frame inside this one.")
    frames: tuple[str, ...] = key(
        "of",
        Form(ref("labels"), _frames),
        "Groups or frames it may be, tried in this order; FILE.group for one of a used file.",
    )
    size: Size | None = key("size", SIZE, "Number of its bytes, if this is known.", default=None)

    @classmethod
    def called(cls) -> str:
        return "inner frame"

    @property
    def frames_inside(self) -> tuple[str, ...]:
        return self.frames

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        if isinstance(self.size, int):
            return exactly(self.size)
        return ANY if self.size is not None else either(of_frame(name) for name in self.frames)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        found: frozenset[int] = frozenset()
        for name in self.frames:
            segments = of_frame(name)
            if segments is None:
                return EVERY_BYTE
            # frames of this segment inside themselves are not followed
            found |= contents_of(segments, lambda inside: None if inside in self.frames else of_frame(inside))
        return found

    def check(self) -> Iterator[Problem]:
        if not self.frames:
            yield Problem(self.at, f"'{self.name}' can hold no frame", "name a group that has frames")


@dataclass(frozen=True, slots=True, kw_only=True)
class Nested(Segment):
    """A record of the surrounding layout, one level deeper: the fields of the frame `frame`, which determines its own
    end.
    """

    VALUE: ClassVar[ValueKind | None] = "any"
    WANTED: ClassVar[bool] = True

    name: str
    layout: str
    frame: str

    @property
    def frames_inside(self) -> tuple[str, ...]:
        return (self.frame,)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return of_frame(self.frame)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        segments = of_frame(self.frame)
        return EVERY_BYTE if segments is None else contents_of(segments, of_frame)
