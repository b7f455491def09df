"""Segments: from the nodes of a head, body, tail or layout to the model, with includes put in place.

Which kinds there are, and how each is read, stands in `definition/kinds`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from framekit.definition.expression.syntax import names_in
from framekit.definition.keys import Meanings
from framekit.definition.kinds.base import KINDS, Segment, Segments
from framekit.definition.load.reader import Broken
from framekit.definition.model.walk import field_names
from framekit.definition.tree import Mapping, Node, Sequence

MOST_SEGMENTS = 4000
"""Of one frame, with everything it includes."""


class SegmentLoader:
    """Reads lists of segments.

    `space` gives the meaning of the names of types, tables and checks, `find_frames` the frames that an `inner` or
    `inside` means by a name. `side`: who sends the frame they belong to. `aliases` collects what a named include stands
    for: its name → the names of its segments. `spoilt` says that segments were left out because they are broken.
    """

    def __init__(self, space: Meanings, find_frames: Callable[[Any, Node], tuple[str, ...]]) -> None:
        self.space = space
        self.reader = space.reader
        self.side: str | None = None
        self.find_frames = find_frames
        self.aliases: dict[str, tuple[str, ...]] = {}
        self.under_way: list[tuple[str, Sequence]] = []
        self.read = 0
        self.unnamed = 0
        self.spoilt = False

    def load(self, node: Node | None) -> Segments:
        """The segments of a list; those that are broken are left out after their problem is noted."""
        found: list[Segment] = []
        for item in self.reader.items(node):
            try:
                self._number(item)
                found.extend(self._segment(self.reader.mapping(item)))
            except Broken:
                self.spoilt = True
        return in_order(tuple(found))[0]

    def _number(self, item: Node) -> None:
        """Includes of includes multiply; nothing sensible has so many segments."""
        self.read += 1
        if self.read == MOST_SEGMENTS and not self.space.too_much:
            self.space.too_much = True
            what = f"the frame has more than {MOST_SEGMENTS} segments with all it includes"
            self.reader.note(item.at, what, "take repeat: for what comes several times")
        if self.read >= MOST_SEGMENTS:
            raise Broken("too many segments")

    def _segment(self, keys: Mapping) -> Segments:
        kinds = [entry.key.text for entry in keys.entries if entry.key.text in KINDS]
        if len(kinds) != 1:
            raise Broken("the schema has told what is wrong with the kind")
        return KINDS[kinds[0]].load(self, keys)

    def common(self, keys: Mapping, kind: str) -> dict[str, Any]:
        """What the keys say that all kinds have; a segment without a name gets one."""
        reader = self.reader
        name = keys.get("name")
        if name is None:
            self.unnamed += 1
        return {
            "at": keys.at,
            "name": f"_{kind}_{self.unnamed}" if name is None else reader.text(name),
            "when": reader.maybe(reader.expression, keys.get("when")),
            "refuse": reader.maybe(reader.number, keys.get("refuse")),
            "doc": reader.maybe(reader.text, keys.get("doc")) or "",
        }

    def layout(self, node: Node) -> Segments:
        """The segments of the layout that `node` names, read in its own namespace. Raises Broken."""
        nodes, space = self.space.layout(node)
        names = [name for name, _ in self.under_way]
        place = next((place for place, (_, other) in enumerate(self.under_way) if other is nodes), None)
        if place is not None:
            raise self._circle(node, names[place:])
        outer, self.space = self.space, space
        self.under_way.append((self.reader.text(node), nodes))
        try:
            return self.load(nodes)
        finally:
            self.space = outer
            self.under_way.pop()

    def _circle(self, node: Node, names: list[str]) -> Broken:
        """Layouts that include each other; told once, whichever of them it was found from."""
        if frozenset(names) in self.space.circles:
            return Broken(names[0])
        self.space.circles.add(frozenset(names))
        chain = " → ".join([*names, names[0]])
        what = f"layouts include each other in a circle: {chain}" if len(names) > 1 else f"'{names[0]}' includes itself"
        return self.reader.broken(node.at, what, "break the circle")


def in_order(*lists: Segments) -> list[Segments]:
    """Lists that stand one behind the other, with every value that takes no bytes behind what it follows from."""
    if not any(segment.follows for segments in lists for segment in segments):
        return list(lists)
    late = {name for segments in lists for segment in segments for name in _names_of(segment)}
    waiting: list[Segment] = []
    found: list[Segments] = []

    def place(segment: Segment, here: list[Segment]) -> None:
        here.append(segment)
        late.difference_update(_names_of(segment))
        for value in waiting:
            if not late & _read_by(value):
                waiting.remove(value)
                return place(value, here)

    for segments in lists:
        here: list[Segment] = []
        for segment in segments:
            if segment.follows is not None and late & _read_by(segment) - {segment.name}:
                waiting.append(segment)
            else:
                place(segment, here)
        if segments is lists[-1]:
            here += waiting
        found.append(tuple(here))
    return found


def _names_of(segment: Segment) -> set[str]:
    return {name for name in (segment.name, *field_names((segment,))) if name is not None}


def _read_by(value: Segment) -> set[str]:
    return {name for one in (value.follows, value.when) if one is not None for name in names_in(one.root)}
