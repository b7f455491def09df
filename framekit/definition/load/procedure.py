"""Sequences: steps, rows and actions."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from framekit.definition.expression.syntax import Expression
from framekit.definition.keys import read_keys
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.load.values import ValueLoader
from framekit.definition.model.procedure import (
    HANDLERS,
    Action,
    CallOf,
    Row,
    Sequence,
    Step,
    places_of,
)
from framekit.definition.model.values import FrameOf, Value
from framekit.definition.nodes import Entry, Mapping, Node, Scalar

T = TypeVar("T")
P = TypeVar("P", Action, Row, Step)


class ProcedureLoader:
    """Reads the section `sequences`. `partly`: sequences of which something is missing."""

    def __init__(self, values: ValueLoader) -> None:
        self.values = values
        self.reader: Reader = values.reader
        self.space = values.space
        self.spoilt = False
        self.serves = False
        self.partly: set[str] = set()

    def _maybe(self, read: Callable[[Node], T], node: Node | None) -> T | None:
        """What stands under a key; None for nothing, and for something broken: the rest is read all the same."""
        try:
            return None if node is None else read(node)
        except Broken:
            self.spoilt = True
            return None

    def _spoil(self) -> None:
        self.spoilt = True

    # ---- what keys of steps, rows and actions hold ----------------------------------------------------------

    def action(self, node: Node) -> Action:
        """One action; a bare word stands for `then`. Raises Broken."""
        if isinstance(node, Scalar):
            return Action(at=node.at, places={"then": node.at}, then=node.text)
        return self._read(Action, node)

    def _read(self, part: type[P], node: Node) -> P:
        """What a mapping says by the keys of its class; keys that are broken are left out."""
        mapping = self.reader.mapping(node)
        return part(at=mapping.at, places=places_of(mapping), **read_keys(part, self, mapping, self._spoil))

    def actions(self, node: Node) -> tuple[Action, ...]:
        """One action or a list of them."""
        return tuple(self.action(item) for item in self.reader.items(node))

    def sent(self, node: Node) -> Value:
        """What `send` and `deliver` take; `reply` is what the sequence has served, even where a frame is called so."""
        served = self.serves and isinstance(node, Scalar) and node.text == "reply"
        return self.values.value(node) if served else self.values.sent(node)

    def stores(self, node: Node) -> tuple[tuple[Expression, str], ...]:
        reader = self.reader
        return tuple((reader.expression(entry.key), reader.text(entry.value)) for entry in reader.entries(node))

    def puts(self, node: Node) -> tuple[tuple[str, dict[str, Value]], ...]:
        return tuple((entry.key.text, self.values.fields(entry.value)) for entry in self.reader.entries(node))

    def arrivals(self, keys: Mapping) -> tuple[str, ...]:
        """The frames that `frame` of a row names."""
        frames: list[str] = []
        for item in self.reader.items(keys.get("frame")):
            if self.reader.text(item) != "expected":
                found = self._maybe(lambda name: self.values.frames.find(self.values.space, name), item)
                frames.extend(name for name in found or () if name not in frames)
        return tuple(frames)

    def expects(self, keys: Mapping) -> bool:
        return "expected" in self.reader.texts(keys.get("frame"))

    def rows(self, node: Node | None) -> tuple[Row, ...]:
        found = [self._maybe(lambda one: self._read(Row, one), item) for item in self.reader.items(node)]
        return tuple(row for row in found if row is not None)

    def handlers(self, keys: Mapping) -> dict[str, tuple[Action, ...]]:
        return {
            name: self._maybe(self.actions, node) or () for name in HANDLERS if (node := keys.get(name)) is not None
        }

    def call(self, keys: Mapping) -> CallOf | None:
        node = keys.get("call")
        if node is None:
            return None
        return CallOf(self.reader.text(node), self.values.fields(keys.get("with")), self.into(keys))

    def into(self, keys: Mapping) -> dict[str, str]:
        return {entry.key.text: self.reader.text(entry.value) for entry in self.reader.entries(keys.get("into"))}

    def ask(self, node: Node) -> FrameOf:
        """`{service: {argument: value}}`: the service's name stands where a constructor has its frame."""
        mapping = self.reader.mapping(node)
        if len(mapping.read_all()) != 1:
            raise self.reader.broken(
                mapping.at, "ask runs exactly one service", "write ask: {service: {argument: value}}"
            )
        entry = mapping.entries[0]
        return FrameOf(entry.key.text, self.values.fields(entry.value), entry.key.at)

    # ---- sequences ----------------------------------------------------------------------------------------

    def sequence(self, entry: Entry) -> Sequence:
        """Raises Broken when nothing of it can be read."""
        reader, keys = self.reader, self.reader.mapping(entry.value)
        self.spoilt = False
        items = reader.items(keys.get("steps"))
        self.serves = any(isinstance(item, Mapping) and "serve" in item for item in items)
        steps = [step for item in items if (step := self._maybe(lambda one: self._read(Step, one), item)) is not None]
        always = self.rows(keys.get("always"))
        handlers = self.handlers(keys)
        gives = self._maybe(self.values.expressions, keys.get("gives")) or {}
        if self.spoilt:
            self.partly.add(entry.key.text)
        if not steps:
            raise Broken(entry.key.text)
        return Sequence(
            name=entry.key.text,
            at=entry.key.at,
            takes=reader.texts(keys.get("takes")),
            gives=gives,
            local={local.key.text: reader.text(local.value) for local in reader.entries(keys.get("local"))},
            always=always,
            handlers=handlers,
            steps=tuple(steps),
        )
