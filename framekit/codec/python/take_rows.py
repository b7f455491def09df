"""Functions that take frame after frame out of a buffer, as long as each is good and one of those taken at once.

For frames that hold one of several plain ones, which a byte tells: a loop that has all of them in it is quicker than a
call for each. What comes of them is made by whoever calls; it is not known here.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby

from framekit.codec.python.choices import Leaf, Switch, in_order, tree_of
from framekit.codec.python.function import Function
from framekit.codec.python.joined import place_of
from framekit.codec.python.module import Module
from framekit.codec.python.source import Source
from framekit.codec.python.take import PairTakeWriter
from framekit.codec.python.take_reader import BEGIN
from framekit.definition.model.frame_sizes import StaticSizes
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import Inner, Segment

FEWEST = 4
"""Frames that hold fewer plain ones than these are worth no function more."""
_LOCALS = ("add", "arrival", "arrived", "behind", "decoded", "first", "kind", "last", "make", "offset", "others")
_Branch = tuple[int, int, "RowWriter | str"]
"""The first of the bytes that lead here, how many do, and what takes the frame; or what is returned instead."""


class RowWriter(PairTakeWriter):
    """Writes what takes a frame and the plain one inside it, as a part of a loop."""

    answer = "return begin, "

    def _function(self) -> tuple[Function, tuple[Segment, ...]]:
        function, segments = super()._function()
        for name in _LOCALS:
            function.names.fresh(name)
        return function, segments

    def write(self, out: Source, there: int, place: int, byte: int | None) -> None:
        """The locals `raw`, `decoded` and `behind`. So many bytes are `there`; `byte`: the one at `place`, if known."""
        known = [] if byte is None else [f"{name} != {byte}" for name in self._read_at(place)]
        result, front = self.result(known), self.front()
        if front > there:
            with out.block(f"if begin + {front} > end:"):
                out.add(f"{self.answer}()")
        self.hoist(out, f"{self.answer}None")
        out.extend(self.function.out)
        out.add(f"decoded = {result}")
        out.add(f"behind = {self.reader.place.text('data')}")

    def _read_at(self, place: int) -> list[str]:
        """The locals of fields that are the byte at a place."""
        function, first, last = self.function, BEGIN.plus(place), BEGIN.plus(place + 1)
        names = [name for name, found in function.bounds.items() if (found.first, found.last) == (first, last)]
        return [function.names_of_values[name] for name in names if name in function.names_of_values]


def write_rows(
    module: Module, identifier: str, frame: Frame, pairs: Mapping[str, PairTakeWriter], none_is: str
) -> Source | None:
    """The source of `rows_…`; None where that is not worth it. `none_is`: what is found where no frame may stand."""
    found = place_of(module.shapes, frame)
    if found is None or len(pairs) < FEWEST:
        return None
    inner, place = found
    writers = {name: RowWriter(module, identifier, frame, writer.pair) for name, writer in pairs.items()}
    branches = _branches(module.shapes, inner, writers, none_is)
    there = max(place + 1, min(writer.front() for writer in writers.values()))
    parameters = "data: bytes, begin: int, end: int, ctx: Context, first: Any, others: Any, offset: int"
    out = Source()
    with out.block(f"def rows_{identifier}({parameters}, arrival: Any, make: Any, add: Any) -> tuple[int, Taken]:"):
        out.docstring(
            f"Add all `{frame.name}` in a row from data[begin] on; where it ends, and what is taken there.",
            "",
            "`first`, `others`: the times of the first one, and of those behind it.",
        )
        out.add(f"last = end - {there - 1}")
        with out.block("try:"), out.block("while begin < last:"):
            out.add(f"kind = data[begin + {place}]")
            _choose(out, branches, there, place)
            out.lines.extend(_arrival(out.depth))
        with out.block("except MISFITS:"):
            out.add("pass")
        out.add("return begin, None")
    return out


def _arrival(depth: int) -> list[str]:
    out = Source(depth)
    out.add("arrived = arrival()")
    for name, text in (("make", "make"), ("decoded", "decoded"), ("raw", "raw"), ("offset", "offset + begin")):
        out.add(f"arrived.{name} = {text}")
    out.add("arrived.times = first")
    out.add("first = others")
    out.add("add(arrived)")
    out.add("begin = behind")
    return out.lines


def _branches(shapes: StaticSizes, inner: Inner, writers: Mapping[str, RowWriter], none_is: str) -> list[_Branch]:
    """What is done for each byte, those next to each other together; each frame is written once."""
    tree = tree_of(shapes, in_order(shapes, inner.frames))
    assert isinstance(tree, Switch), "there are several, told apart by a byte"
    cases, left = dict(tree.cases), dict(writers)
    by_byte: list[str] = []
    for byte in range(256):
        leaf = cases.get(byte, tree.others)
        names = leaf.frames if isinstance(leaf, Leaf) and len(leaf.frames) <= 2 else ("",)
        by_byte.append(names[0] if names else none_is)
    return [
        (first, 1 + len(others), left.pop(name, none_is if name == none_is else "None"))
        for name, ((first, _), *others) in groupby(enumerate(by_byte), key=lambda item: item[1])
    ]


def _choose(out: Source, branches: list[_Branch], there: int, place: int) -> None:
    """Halves the bytes at `place` until one branch is left; so many bytes are `there`."""
    if len(branches) > 1:
        half = len(branches) // 2
        with out.block(f"if kind < {branches[half][0]:#04x}:"):
            _choose(out, branches[:half], there, place)
        with out.block("else:"):
            _choose(out, branches[half:], there, place)
        return
    ((first, count, writer),) = branches
    if isinstance(writer, str):
        out.add(f"{RowWriter.answer}{writer}")
    else:
        writer.write(out, there, place, first if count == 1 else None)
