"""Segments: from the nodes of a head, body, tail or layout to the model, with includes put in place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from framekit.definition.expression.syntax import Expression, Logic, names_in
from framekit.definition.load.namespace import Namespace
from framekit.definition.load.plain_segments import PlainSegmentLoader
from framekit.definition.load.reader import Broken
from framekit.definition.load.scalars import parse_key
from framekit.definition.load.types import load_size, load_type
from framekit.definition.model import segments as model
from framekit.definition.model.walk import field_names
from framekit.definition.nodes import Mapping, Node, Scalar, Sequence

KINDS = (
    "const", "text", "field", "bits", "data", "length", "count", "repeat", "choose", "optional", "include", "inner",
    "wrap", "check", "skip", "require", "value",
)  # fmt: skip
MOST_SEGMENTS = 4000
"""Of one frame, with everything it includes."""


class SegmentLoader(PlainSegmentLoader):
    """Reads lists of segments. `find_frames` gives the frames that an `inner` or `inside` means by a name.

    `aliases` collects what a named include stands for: its name → the names of its segments. `spoilt` says that
    segments were left out because they are broken.
    """

    def __init__(self, space: Namespace, find_frames: Callable[[Namespace, Node], tuple[str, ...]]) -> None:
        super().__init__(space)
        self.find_frames = find_frames
        self.aliases: dict[str, tuple[str, ...]] = {}
        self.under_way: list[tuple[str, Sequence]] = []
        self.read = 0
        self.unnamed = 0
        self.spoilt = False

    def load(self, node: Node | None) -> tuple[model.Segment, ...]:
        """The segments of a list; those that are broken are left out after their problem is noted."""
        found: list[model.Segment] = []
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

    def _segment(self, keys: Mapping) -> tuple[model.Segment, ...]:
        kinds = [entry.key.text for entry in keys.entries if entry.key.text in KINDS]
        if len(kinds) != 1:
            raise Broken("the schema has told what is wrong with the kind")
        kind = kinds[0]
        if kind == "include":
            return self._include(keys)
        make: Callable[[Mapping, dict[str, Any]], model.Segment] = getattr(self, "_" + kind)
        return (make(keys, self._common(keys, kind)),)

    def _common(self, keys: Mapping, kind: str) -> dict[str, Any]:
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

    # ---- segments that hold others ------------------------------------------------------------------------

    def _repeat(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        times, of = keys.get("times"), keys.get("of")
        if times is None or of is None:
            raise Broken("the schema asks for times and of")
        items = self.load(of) if isinstance(of, Sequence) else load_type(self.space, keys, of)
        return model.Repeat(times=load_size(self.reader, times), of=items, **self._named(keys, "repeat", common))

    def _choose(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        otherwise = keys.get("else")
        cases = tuple(
            (tuple(parse_key(part) for part in entry.key.text.split(",")), self.load(entry.value))
            for entry in self.reader.entries(keys.get("cases"))
        )
        return model.Choose(
            on=self.reader.expression(keys.get("choose")),
            cases=cases,
            otherwise=None if otherwise is None else self.load(otherwise),
            **common,
        )

    def _optional(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        return model.Optional(of=self.load(keys.get("optional")), **common)

    def _include(self, keys: Mapping) -> tuple[model.Segment, ...]:
        node = keys.get("include")
        assert node is not None
        segments = self.layout(node)
        when = self.reader.maybe(self.reader.expression, keys.get("when"))
        refuse = self.reader.maybe(self.reader.number, keys.get("refuse"))
        record = keys.get("as")
        if record is not None:
            name = self.reader.text(record)
            return (model.Record(at=keys.at, name=name, of=segments, when=when, refuse=refuse),)
        if (name_node := keys.get("name")) is not None:
            self.aliases[self.reader.text(name_node)] = tuple(part.name for part in segments if part.name)
        return tuple(_under(part, when, refuse) for part in segments)

    def layout(self, node: Node) -> tuple[model.Segment, ...]:
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

    def _inner(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        frames: list[str] = []
        for item in self.reader.items(keys.get("of")):
            frames.extend(name for name in self.find_frames(self.space, item) if name not in frames)
        size = keys.get("size")
        return model.Inner(
            frames=tuple(frames),
            size=None if size is None else load_size(self.reader, size),
            **self._named(keys, "inner", common),
        )

    def _most(self, node: Node | None) -> int | Expression | None:
        size = None if node is None else load_size(self.reader, node)
        return None if size == "rest" else size

    def _wrap(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        how = keys.get("wrap")
        inside = [name for item in reader.items(keys.get("inside")) for name in self.find_frames(self.space, item)]
        return model.Wrap(
            how="hex" if isinstance(how, Scalar) else "escape",
            escape=None if isinstance(how, Scalar) else reader.byte(reader.mapping(how).get("escape")),
            of=self.load(keys.get("of")),
            inside=tuple(inside),
            insert=reader.maybe(reader.expression, keys.get("insert")),
            least=reader.maybe(reader.number, keys.get("min")) or 0,
            most=self._most(keys.get("max")),
            **common,
        )


def in_order(*lists: tuple[model.Segment, ...]) -> list[tuple[model.Segment, ...]]:
    """Lists that stand one behind the other, with every `value` behind what it reads: it takes no bytes."""
    given = [{segment.name, *field_names((segment,))} for segments in lists for segment in segments]
    late = {name for names in given for name in names if name is not None}
    if not any(isinstance(segment, model.Value) for segments in lists for segment in segments):
        return list(lists)
    waiting: list[model.Value] = []
    found: list[tuple[model.Segment, ...]] = []

    def place(segment: model.Segment, here: list[model.Segment]) -> None:
        here.append(segment)
        late.difference_update({segment.name, *field_names((segment,))})
        for value in waiting:
            if not late & _read_by(value):
                waiting.remove(value)
                return place(value, here)

    for segments in lists:
        here: list[model.Segment] = []
        for segment in segments:
            if isinstance(segment, model.Value) and late & _read_by(segment) - {segment.name}:
                waiting.append(segment)
            else:
                place(segment, here)
        if segments is lists[-1]:
            here += waiting
        found.append(tuple(here))
    return found


def _read_by(value: model.Value) -> set[str]:
    return names_in(value.read.root) | (set() if value.when is None else names_in(value.when.root))


def _under(segment: model.Segment, when: Expression | None, refuse: int | None) -> model.Segment:
    """An included segment with the `when` and `refuse` of its include."""
    if when is not None:
        segment = replace(segment, when=both(when, segment.when))
    if refuse is not None and segment.refuse is None:
        segment = replace(segment, refuse=refuse)
    return segment


def both(first: Expression, second: Expression | None) -> Expression:
    """`first and second`."""
    if second is None:
        return first
    return Expression(f"({first}) and ({second})", Logic(first.at, "and", (first.root, second.root)))
