"""Values of procedures and services: expressions and constructors."""

from __future__ import annotations

import re

from framekit.definition.expression.syntax import Expression
from framekit.definition.load.frames import FrameLoader
from framekit.definition.load.namespace import Namespace
from framekit.definition.load.reader import Reader
from framekit.definition.model.procedure import Target
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, ReadAs, RecordOf, Value
from framekit.definition.nodes import Entry, Mapping, Node, Scalar, Sequence
from framekit.definition.problems import did_you_mean

_TARGET = re.compile(r"(?P<name>\w+)(?:\[(?P<key>.*)\])?(?:\.(?P<field>\w+))?")


class ValueLoader:
    """Reads values; it knows which words are frames and layouts."""

    def __init__(self, space: Namespace, frames: FrameLoader) -> None:
        self.space = space
        self.reader: Reader = space.reader
        self.frames = frames

    def value(self, node: Node | None) -> Value:
        """Any value. Raises Broken."""
        if isinstance(node, Mapping):
            return self._mapping(node)
        if isinstance(node, Sequence):
            return ListOf(tuple(self.value(item) for item in node.items), node.at)
        return self.reader.expression(node)

    def sent(self, node: Node | None) -> Value:
        """What `send` and `deliver` take: also the bare name of a frame."""
        if isinstance(node, Scalar) and node.text in self.frames.outlines:
            return FrameOf(node.text, {}, node.at)
        return self.value(node)

    def fields(self, node: Node | None) -> dict[str, Value]:
        return {entry.key.text: self.value(entry.value) for entry in self.reader.entries(node)}

    def frame_of(self, node: Node | None) -> FrameOf:
        """`{frame: {…}}` where a frame must stand. Raises Broken."""
        mapping = self.reader.mapping(node)
        entries = mapping.read_all()
        if len(entries) != 1:
            raise self.reader.broken(mapping.at, "exactly one frame is wanted here", "write {frame: {field: value}}")
        return self._frame(entries[0])

    def _frame(self, entry: Entry) -> FrameOf:
        name = entry.key.text
        if name not in self.frames.outlines:
            raise self.reader.broken(
                entry.key.at, f"there is no frame '{name}'", did_you_mean(name, self.frames.outlines)
            )
        empty = isinstance(entry.value, Scalar) and not entry.value.text
        return FrameOf(name, {} if empty else self.fields(entry.value), entry.key.at)

    def _mapping(self, node: Mapping) -> Value:
        if len(node.entries) == 1:
            entry = node.read_all()[0]
            if entry.key.text == "each":
                return EachOf(self.fields(entry.value), node.at)
            if entry.key.text in self.frames.outlines and not isinstance(entry.value, Scalar):
                return self._frame(entry)
            if self._is_layout(entry.key.text):
                if isinstance(entry.value, Mapping) and not self._is_constructor(entry.value):
                    return LayoutOf(entry.key.text, self.fields(entry.value), node.at)
                return ReadAs(entry.key.text, self.value(entry.value), node.at)
        return RecordOf(self.fields(node), node.at)

    def _is_layout(self, name: str) -> bool:
        if name in self.space.section("layouts"):
            return True
        found = self.space.elsewhere(name)
        return found is not None and found[0] in found[1].section("layouts")

    def _is_constructor(self, node: Mapping) -> bool:
        return len(node.entries) == 1 and self._is_layout(node.entries[0].key.text)

    # ---- what `set` writes --------------------------------------------------------------------------------

    def settings(self, node: Node | None) -> tuple[tuple[Target, Value], ...]:
        """`set: {target: value}` in the order written."""
        return tuple((self.target(entry.key), self.value(entry.value)) for entry in self.reader.entries(node))

    def target(self, key: Scalar) -> Target:
        match = _TARGET.fullmatch(key.text.strip())
        if match is None:
            raise self.reader.broken(
                key.at, f"'{key.text}' cannot be set", "name a variable, table[key] or frame.field – quote it in YAML"
            )
        index = match["key"]
        return Target(
            match["name"],
            None if index is None else self.reader.expression_text(index, key.at),
            match["field"],
        )

    def expressions(self, node: Node | None, besides: str = "") -> dict[str, Expression]:
        """The expressions of a mapping by name; what stands at the key `besides` is read elsewhere."""
        entries = (entry for entry in self.reader.entries(node) if entry.key.text != besides)
        return {entry.key.text: self.reader.expression(entry.value) for entry in entries}
