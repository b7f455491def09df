"""SEND and RECEIVE blocks: their frame, and where each of its fields comes from or goes to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from framekit.blocks.fields import FramePart, may_overflow, misfit, no_number, parts_of
from framekit.blocks.model import Place
from framekit.definition.expression.syntax import Expression, Name
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Data, Field
from framekit.definition.model.walk import field_names
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.nodes import Node, Scalar
from framekit.definition.problems import did_you_mean
from framekit.link.parameters import ParameterError, given_value


class FrameBlockLoader:
    """Reads keys of blocks of single frames. `place` reads addresses of the own memory, `written` those to write."""

    def __init__(self, reader: Reader, place: Callable[[Node], Place], written: Callable[[Node], Place]) -> None:
        self.reader = reader
        self.place = place
        self.written = written
        self.received: dict[tuple[int, str], int] = {}
        self.spoilt = False

    def read(
        self, instruction: str, keys: MappingNode, protocol: Protocol, channel: int, number: int
    ) -> dict[str, Any]:
        """`frame`, `data`, `values`, `sizes` of a block. Raises Broken for a frame there is not."""
        reader = self.reader
        node = keys.get(instruction)
        name = reader.text(node)
        if node is None or name not in protocol.frames:
            at = keys.at if node is None else node.at
            raise reader.broken(at, f"'{protocol.name}' has no frame '{name}'", did_you_mean(name, protocol.frames))
        frame = protocol.frames[name]
        self.spoilt = False
        if protocol.frames_alone:
            self._direction(instruction, frame, node)
        self._once(instruction, frame, node, (channel, frame.name), number)
        fields = dict(parts_of(frame.segments))
        where = self.written if instruction == "receive" else self.place
        data = dict(self._own_memory(fields))
        for entry in reader.entries(keys.get("data")):
            with self._going_on():
                self._known(entry.key, frame, fields)
                place = where(entry.value)
                self._fits(fields[entry.key.text], place, instruction, entry.value)
                data[entry.key.text] = place
        values = self._values(keys.get("values"), frame, fields) if instruction == "send" else {}
        sizes = self._sizes(keys.get("size"), frame, fields)
        sized_by = self._sized_by(keys.get("size"), fields, protocol) if instruction == "send" else {}
        if instruction == "send" and not self.spoilt:
            self._missing(frame, {*data, *values}, data.keys() - values.keys() - sizes.keys(), keys)
        return {"frame": name, "data": data, "values": values, "sizes": sizes, "sized_by": sized_by}

    @contextmanager
    def _going_on(self) -> Iterator[None]:
        """What is broken inside is left out; nothing is said to be missing then."""
        try:
            yield
        except Broken:
            self.spoilt = True

    def _own_memory(self, fields: Mapping[str, FramePart]) -> Iterator[tuple[str, Place]]:
        """Places that the definition of a frame names itself."""
        for name, part in fields.items():
            memory = getattr(part, "memory", None)
            if memory:
                with self._going_on():
                    yield name, self.place(Scalar(memory, part.at, False))

    def _fits(self, part: FramePart, place: Place, instruction: str, node: Node) -> None:
        """A place that can hold the values of a field."""
        wrong = misfit(part, place)
        if wrong is not None:
            self.reader.note(node.at, *wrong)
        elif instruction == "receive" and may_overflow(part, place):
            what = f"{place.text} ({place.address.unit}) cannot hold every value of '{part.name}'"
            self.reader.warn(node.at, what, "name a wider place; values that do not fit are refused")

    def _direction(self, instruction: str, frame: Frame, node: Node) -> None:
        """A run is the client where a protocol knows no roles."""
        wrong, done, other = ("server", "sent", "receive") if instruction == "send" else ("client", "received", "send")
        if frame.side == wrong:
            what = f"'{frame.name}' comes from the {wrong}, it cannot be {done}"
            self.reader.note(node.at, what, f"use {other}:, or another frame")

    def _once(self, instruction: str, frame: Frame, node: Node, key: tuple[int, str], number: int) -> None:
        """A frame is received by one block of a channel, and never when it stands inside others."""
        if frame.inner:
            self.reader.note(node.at, f"'{frame.name}' stands inside other frames", "name a frame that carries it")
        if instruction == "receive":
            first = self.received.setdefault(key, number)
            if first != number:
                self.reader.note(node.at, f"block {first} receives '{frame.name}' already", "let one block take it")

    def _known(self, key: Scalar, frame: Frame, fields: Mapping[str, FramePart]) -> None:
        if key.text not in fields:
            hint = did_you_mean(key.text, fields)
            raise self.reader.broken(key.at, f"frame '{frame.name}' has no field '{key.text}'", hint)

    def _values(self, node: Node | None, frame: Frame, fields: Mapping[str, FramePart]) -> dict[str, Any]:
        known = dict.fromkeys(field_names(frame.segments))
        found: dict[str, Any] = {}
        for entry in self.reader.entries(node):
            with self._going_on():
                if entry.key.text not in known:
                    what = f"frame '{frame.name}' has no field '{entry.key.text}'"
                    raise self.reader.broken(entry.key.at, what, did_you_mean(entry.key.text, known))
                value = found[entry.key.text] = self.reader.constant(entry.value)
                wrong = no_number(fields.get(entry.key.text), value)
                if wrong is not None:
                    self.reader.note(entry.value.at, wrong, "correct it")
        return found

    def _sizes(self, node: Node | None, frame: Frame, fields: Mapping[str, FramePart]) -> dict[str, int]:
        found: dict[str, int] = {}
        for entry in self.reader.entries(node):
            with self._going_on():
                self._known(entry.key, frame, fields)
                size = self.reader.number(entry.value)
                fixed = getattr(fields[entry.key.text], "size", None)
                if size < 0 or (isinstance(fixed, int) and size != fixed):
                    has = f"has {fixed} bytes, not {size}" if isinstance(fixed, int) else f"cannot have {size} bytes"
                    raise self.reader.broken(entry.value.at, f"'{entry.key.text}' {has}", "leave the size out")
                found[entry.key.text] = size
        return found

    def _sized_by(self, node: Node | None, fields: Mapping[str, FramePart], protocol: Protocol) -> dict[str, str]:
        """Fields whose size the block says and the frame takes from a parameter, with that."""
        found = {}
        for entry in self.reader.entries(node):
            size = getattr(fields.get(entry.key.text), "size", None)
            name = size.root.name if isinstance(size, Expression) and isinstance(size.root, Name) else ""
            if name in protocol.params and name not in fields:
                with self._going_on():
                    found[entry.key.text] = name
                    try:
                        given_value(protocol.params[name], self.reader.number(entry.value))
                    except ParameterError as error:
                        what, _, todo = str(error).partition(" – ")
                        raise self.reader.broken(entry.value.at, what, todo) from None
        return found

    def _missing(self, frame: Frame, given: set[str], unsized: set[str], keys: MappingNode) -> None:
        """Fields that nothing gives a value, and data whose size nobody says."""
        for part in frame.segments:
            if part.when is not None or not isinstance(part, (Data, Field)):
                continue
            if part.name not in given and not _has_value(part):
                what = f"nothing gives '{part.name}' of '{frame.name}'"
                self.reader.note(keys.at, what, f"add data: {{{part.name}: ADDRESS}}, or values")
            elif isinstance(part, Data) and part.name in unsized and not isinstance(part.size, int):
                what = f"nothing says how many bytes '{part.name}' of '{frame.name}' has"
                self.reader.note(keys.at, what, f"add size: {{{part.name}: N}}")


def _has_value(part: Data | Field) -> bool:
    if isinstance(part, Data):
        return False
    return any(value is not None for value in (part.is_, part.build, part.default, part.constants))
