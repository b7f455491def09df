"""Choose between several inner frames: a `switch-on` of the bytes that distinguish them."""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python.choices import Leaf, Switch, tree_of
from framekit.definition.model.segments import Inner
from framekit.extras.kaitai.source import KsyNames
from framekit.extras.kaitai.state import UNEXPECTED, Keys, KsyFile

HERE = "_io.size - _io.pos"
"""The number of remaining bytes."""


class FramesInside:
    """Write the choice between frames; `names` and `instances` belong to the type that holds them."""

    def __init__(self, file: KsyFile, names: KsyNames, instances: dict[str, Keys]) -> None:
        self.file, self.names, self.instances = file, names, instances

    def told_apart(self, inner: Inner, path: str, frames: tuple[str, ...], room: int | str) -> Keys:
        """Return the type key that selects the frame by bytes at fixed offsets."""
        tree = tree_of(self.file.static, frames)
        types = {name: self.file.types[name] for name in frames}
        if isinstance(tree, Switch):
            branches = [leaf for _, leaf in tree.cases]
            if all(isinstance(one, Leaf) and len(one.frames) == 1 for one in branches) and not tree.others.frames:
                cases: Keys = {str(value): types[leaf.frames[0]] for value, leaf in tree.cases}
                return {"switch-on": self._peek(path, tree.at), "cases": {**cases, "_": UNEXPECTED}}
        peeks: dict[int, str] = {}
        text = self._which(inner, tree, path, frames, str(room), peeks)
        which = self.names.new(f"{path}_which")
        self.instances[which] = {"value": text}
        cases = {str(number): types[name] for number, name in enumerate(frames)}
        return {"switch-on": which, "cases": {**cases, "_": UNEXPECTED}}

    def _peek(self, path: str, place: int) -> str:
        name = self.names.new(f"{path}_at_{place}")
        pos = f"_io.pos + {place}" if place else "_io.pos"
        self.instances[name] = {"pos": pos, "type": "u1", "if": f"{HERE} > {place}"}
        return name

    def _which(
        self, inner: Inner, tree: Leaf | Switch, path: str, frames: tuple[str, ...], room: str, peeks: dict[int, str]
    ) -> str:  # fmt: skip
        """Return the text of the index of the frame in `frames`; -1 for no frame."""
        if isinstance(tree, Leaf):
            return self._by_size(inner, tree.frames, frames, room)
        if tree.at not in peeks:
            peeks[tree.at] = self._peek(path, tree.at)
        peek = peeks[tree.at]
        text = self._which(inner, tree.others, path, frames, room, peeks)
        rows: dict[str, list[int]] = {}
        for value, branch in tree.cases:
            rows.setdefault(self._which(inner, branch, path, frames, room, peeks), []).append(value)
        for which, values in reversed(rows.items()):
            text = f"({HERE} > {tree.at} and {_one_of(peek, values)} ? {which} : {text})"
        return text

    def _by_size(self, inner: Inner, left: tuple[str, ...], frames: tuple[str, ...], room: str) -> str:
        """Return the first frame of fitting size among those that no byte distinguishes, except refused frames."""
        if not left:
            return "-1"
        known = [name for name in left if self.file.protocol.frames[name].refuse is None] or [*left[:1]]
        sizes = [self.file.static.frame(name).fixed for name in known]
        if None in sizes[:-1] or len({*sizes}) < len(sizes):
            what = f"of {', '.join(known)} in '{inner.name}' the first is read whose size fits"
            self.file.tell(
                inner.at, what, "no byte at a fixed place tells them apart, and Kaitai does not try one after the other"
            )
        text = "-1"
        for name, size in reversed([*zip(known, sizes, strict=True)]):
            number = str(frames.index(name))
            text = number if size is None or len(known) == 1 else f"({room} == {size} ? {number} : {text})"
        return text


def _one_of(path: str, values: Iterable[int]) -> str:
    """Return the condition that a number is one of these, with consecutive numbers as ranges."""
    rows: list[list[int]] = []
    for value in sorted(values):
        if rows and rows[-1][1] == value - 1:
            rows[-1][1] = value
        else:
            rows.append([value, value])
    parts = (f"{path} == {a}" if a == b else f"({path} >= {a} and {path} <= {b})" for a, b in rows)
    return f"({' or '.join(parts)})"
