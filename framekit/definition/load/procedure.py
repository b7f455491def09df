"""Values of procedures and services; sequences: steps, rows and actions."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from framekit.definition.expression import Expression, real_number
from framekit.definition.keys import read_keys
from framekit.definition.load.frames import FrameLoader
from framekit.definition.load.namespace import Namespace
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.procedure import HANDLERS, Action, CallOf, Row, Sequence, Step, Target, places_of
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, ReadAs, RecordOf, Value
from framekit.definition.nodes import Entry, Mapping, Node, Scalar
from framekit.definition.problems import did_you_mean
from framekit.definition.tree import Sequence as Items


class ValueLoader:
    """Reads values; it recognizes the names of frames and layouts."""

    def __init__(self, space: Namespace, frames: FrameLoader) -> None:
        self.space = space
        self.reader: Reader = space.reader
        self.frames = frames

    def value(self, node: Node | None) -> Value:
        """Read any value. Raises Broken."""
        if isinstance(node, Mapping):
            return self._mapping(node)
        if isinstance(node, Items):
            return ListOf(self.reader.each(node.items, self.value), node.at)
        return self.reader.expression(node)

    def sent(self, node: Node | None) -> Value:
        """Read the value of `send` or `deliver`, which may also be the bare name of a frame."""
        if isinstance(node, Scalar) and node.text in self.frames.outlines:
            return FrameOf(node.text, {}, node.at)
        return self.value(node)

    def fields(self, node: Node | None) -> dict[str, Value]:
        return self.reader.by_name(self.reader.entries(node), self.value)

    def filled(self, node: Node | None) -> dict[str, Value]:
        """Return the values for the fields of a constructor: values, or plain numbers with a fraction."""
        return self.reader.by_name(self.reader.entries(node), self._given)

    def _given(self, node: Node) -> Value:
        real = real_number(node.text, node.at) if isinstance(node, Scalar) and not node.quoted else None
        return self.value(node) if real is None else real

    def frame_of(self, node: Node | None) -> FrameOf:
        """Read `{frame: {…}}` at a place that requires a frame. Raises Broken."""
        return self._frame(self.only_entry(node))

    def only_entry(self, node: Node | None) -> Entry:
        """Return the only entry of a mapping.

        Raises Broken for another number of entries, at the place where a schema reports it.
        """
        mapping = self.reader.mapping(node)
        entries = mapping.read_all()
        if len(entries) != 1:
            at = entries[1].key.at if entries else mapping.at
            raise self.reader.broken(at, "exactly one entry is wanted here", "write {NAME: {name: value}}")
        return entries[0]

    def _frame(self, entry: Entry) -> FrameOf:
        name = entry.key.text
        if name not in self.frames.outlines:
            raise self.reader.broken(
                entry.key.at, f"there is no frame '{name}'", did_you_mean(name, self.frames.outlines)
            )
        empty = isinstance(entry.value, Scalar) and not entry.value.text
        return FrameOf(name, {} if empty else self.filled(entry.value), entry.key.at)

    def _mapping(self, node: Mapping) -> Value:
        if {entry.key.text for entry in node.entries} in ({"each"}, {"each", "when"}):
            when = self.reader.maybe(self.reader.expression, node.get("when"))
            return EachOf(self.filled(node.get("each")), node.at, when)
        if len(node.entries) == 1:
            entry = node.read_all()[0]
            if entry.key.text in self.frames.outlines and not isinstance(entry.value, Scalar):
                if self._is_layout(entry.key.text):
                    what = f"'{entry.key.text}' is a frame and a layout, and a value by that name is the frame"
                    self.reader.note(entry.key.at, what, "give one of them another name")
                return self._frame(entry)
            if self._is_layout(entry.key.text):
                inside = entry.value.entries if isinstance(entry.value, Mapping) else ()
                is_made = len(inside) == 1 and self._is_layout(inside[0].key.text)
                if isinstance(entry.value, Mapping) and not is_made:
                    return LayoutOf(entry.key.text, self.filled(entry.value), node.at)
                return ReadAs(entry.key.text, self.value(entry.value), node.at)
        return RecordOf(self.filled(node), node.at)

    def _is_layout(self, name: str) -> bool:
        if name in self.space.section("layouts"):
            return True
        found = self.space.elsewhere(name)
        return found is not None and found[0] in found[1].section("layouts")

    # ---- targets of `set` ---------------------------------------------------------------------------------

    def settings(self, node: Node | None) -> tuple[tuple[Target, Value], ...]:
        """Return the targets and values of `set: {target: value}` in the order written."""
        entries = self.reader.entries(node)
        return self.reader.each(entries, lambda entry: (self.target(entry.key), self.value(entry.value)))

    def target(self, key: Scalar) -> Target:
        name, index, field = self.reader.target(key)
        return Target(name, index, field)

    def expressions(self, node: Node | None, besides: str = "") -> dict[str, Expression]:
        """Return the expressions of a mapping by name, without the key `besides`."""
        entries = (entry for entry in self.reader.entries(node) if entry.key.text != besides)
        return self.reader.by_name(entries, self.reader.expression)


T = TypeVar("T")
P = TypeVar("P", Action, Row, Step)


class ProcedureLoader:
    """Reads the section `sequences`. `partly`: sequences with broken parts left out."""

    def __init__(self, values: ValueLoader) -> None:
        self.values = values
        self.reader: Reader = values.reader
        self.space = values.space
        self.spoilt = False
        self.serves = False
        self.partly: set[str] = set()

    def _maybe(self, read: Callable[[Node], T], node: Node | None) -> T | None:
        """Read the value of a key; return None if it is missing or broken, so that the rest is read all the same."""
        try:
            return None if node is None else read(node)
        except Broken:
            self.spoilt = True
            return None

    def _spoil(self) -> None:
        self.spoilt = True

    # ---- values of the keys of steps, rows and actions ------------------------------------------------------

    def action(self, node: Node) -> Action:
        """Read an action; a bare word stands for `then`. Raises Broken."""
        if isinstance(node, Scalar):
            return Action(at=node.at, places={"then": node.at}, then=node.text)
        return self._read(Action, node)

    def _read(self, part: type[P], node: Node) -> P:
        """Read a mapping by the keys of its class; broken keys are left out."""
        mapping = self.reader.mapping(node)
        return part(at=mapping.at, places=places_of(mapping), **read_keys(part, self, mapping, self._spoil))

    def actions(self, node: Node) -> tuple[Action, ...]:
        """Read an action or a list of them."""
        return self.reader.each(self.reader.items(node), self.action)

    def sent(self, node: Node) -> Value:
        """Read the value of `send` or `deliver`; `reply` is the reply of the served request, even if a frame has this
        name.
        """
        served = self.serves and isinstance(node, Scalar) and node.text == "reply"
        return self.values.value(node) if served else self.values.sent(node)

    def stores(self, node: Node) -> tuple[tuple[Expression, str], ...]:
        reader = self.reader
        return reader.each(reader.entries(node), lambda entry: (reader.expression(entry.key), reader.text(entry.value)))

    def puts(self, node: Node) -> tuple[tuple[str, dict[str, Value]], ...]:
        return tuple(self.reader.by_name(self.reader.entries(node), self.values.fields).items())

    def arrivals(self, keys: Mapping) -> tuple[str, ...]:
        """Return the frames named by `frame` of a row."""
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
        """Read `{service: {argument: value}}`; the name of the service takes the place of a constructor's frame."""
        entry = self.values.only_entry(node)
        return FrameOf(entry.key.text, self.values.fields(entry.value), entry.key.at)

    # ---- sequences ----------------------------------------------------------------------------------------

    def sequence(self, entry: Entry) -> Sequence:
        """Read a sequence. Raises Broken if no step can be read."""
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
