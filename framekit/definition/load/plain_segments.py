"""Segments that hold no others: constants, fields, data, lengths and counts, from their nodes to the model.

What lists of segments are, includes, and segments around others are not known here.
"""

from __future__ import annotations

from collections.abc import Mapping as MappingOf
from typing import Any, Literal

from framekit.definition.expression.syntax import Bytes, Expression
from framekit.definition.load.checks import load_check_segment
from framekit.definition.load.namespace import Namespace
from framekit.definition.load.reader import Broken
from framekit.definition.load.scalars import parse_bytes
from framekit.definition.load.types import load_size, load_type
from framekit.definition.model import segments as model
from framekit.definition.model.frames import Side
from framekit.definition.nodes import Mapping, Node, Scalar

LENGTH_UNITS = {"bytes": 1, "words": 2, "dwords": 4, "lwords": 8, "digits": 1}


class PlainSegmentLoader:
    """Reads one segment at a time: a method for each kind, by its keys and what all kinds have in common.

    `space` gives the meaning of the names of types, tables and checks. `side`: who sends the frame they belong to.
    """

    def __init__(self, space: Namespace) -> None:
        self.space = space
        self.reader = space.reader
        self.side: Side | None = None

    def _named(self, keys: Mapping, kind: str, common: dict[str, Any]) -> dict[str, Any]:
        """The common keys of a segment whose kind key holds its name."""
        return {**common, "name": self.reader.text(keys.get(kind))}

    def _const(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        return model.Const(data=self.reader.bytes(keys.get("const")), **common)

    def _text(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        node = self.reader.scalar(keys.get("text"))
        try:
            return model.Const(data=node.text.encode("latin-1"), **common)
        except UnicodeEncodeError:
            curly = any(sign in node.text for sign in "“”„‘’")
            todo = "use straight quotes" if curly else "use const: with hex"
            raise self.reader.broken(node.at, "the text has characters that are no bytes", todo) from None

    def _field(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        type_ = load_type(self.space, keys, keys.get("type"))
        values = self.values(keys.get("values"))
        only = keys.get("only") is not None
        if only and values is None:
            reader.note(keys.at, "only: values needs values", "add values: with a table")
        unit = keys.get("unit")
        return model.Field(
            type=type_,
            is_=self._given(keys.get("is"), type_),
            build=self._given(keys.get("build"), type_),
            default=self._given(keys.get("default"), type_),
            values=values,
            only=only and values is not None,
            limits=reader.maybe(reader.range, keys.get("range")),
            plus=reader.maybe(reader.number, keys.get("plus")) or 0,
            unit=None if unit is None else reader.time(unit),
            long=self._long(keys.get("long")),
            zero_means=reader.maybe(reader.number, keys.get("zero_means")),
            memory=reader.maybe(reader.text, keys.get("memory")),
            **self._named(keys, "field", common),
        )

    def _given(self, node: Node | None, type_: model.FieldType) -> Expression | None:
        """A default: bytes for a field of bytes, an empty text for an empty scalar, else an expression."""
        if node is None:
            return None
        scalar = self.reader.scalar(node)
        if type_.kind == "bytes" and not scalar.text.strip().startswith("h'"):
            try:
                return literal_bytes(scalar)
            except ValueError:
                return self.reader.expression(node)
        return self.reader.expression_text(scalar.text or "''", scalar.at)

    def _long(self, node: Node | None) -> model.Long | None:
        if node is None:
            return None
        keys = self.reader.mapping(node)
        return model.Long(mark=self.reader.number(keys.get("mark")), type=load_type(self.space, keys, keys.get("type")))

    def values(self, node: Node | None) -> MappingOf[int, str] | None:
        """Names of numbers: a table's name, or a mapping code: name."""
        if node is None:
            return None
        if isinstance(node, Mapping):
            return {self.reader.number(entry.key): self.reader.text(entry.value) for entry in node.read_all()}
        name = self.reader.text(node)
        table = self.space.table(name)
        if table is None:
            known = list(self.space.section("tables"))
            raise self.reader.unknown(node.at, "table", name, known)
        return {key: str(text) for key, text in table.entries.items() if isinstance(key, int)}

    def _bits(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        type_ = load_type(self.space, keys, keys.get("of"))
        given = {
            key: {entry.key.text: entry.value for entry in reader.entries(keys.get(key))}
            for key in ("is", "build", "values")
        }
        parts = []
        for entry in reader.entries(keys.get("bits")):
            low, high = reader.places(entry.value)
            name = entry.key.text
            parts.append(
                model.BitsPart(
                    name=name,
                    low=low,
                    high=high,
                    is_=reader.maybe(reader.expression, given["is"].pop(name, None)),
                    build=reader.maybe(reader.expression, given["build"].pop(name, None)),
                    values=self.values(given["values"].pop(name, None)),
                    at=entry.key.at,
                )
            )
        for names in given.values():
            for name, node in names.items():
                reader.note(node.at, f"there are no bits '{name}' here", "name one of the bits above")
        return model.Bits(parts=tuple(parts), type=type_, **common)

    def _data(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        size = keys.get("size")
        if size is None:
            raise Broken("the schema asks for a size")
        swap = reader.maybe(reader.number, keys.get("swap")) or 0
        if swap not in (0, 2, 4, 8):
            raise reader.broken(keys.at, f"a swap of {swap} bytes does not exist", "use 2, 4 or 8")
        loaded = load_size(reader, size)
        if swap and isinstance(loaded, int) and loaded % swap:
            reader.warn(size.at, f"{loaded} bytes are not full units of {swap}", "the rest stays as it is")
        return model.Data(
            size=loaded,
            convert=self._conversion(keys),
            swap=swap,
            pad=reader.maybe(reader.byte, keys.get("pad")),
            least=reader.maybe(reader.number, keys.get("min")) or 0,
            memory=reader.maybe(reader.text, keys.get("memory")),
            **self._named(keys, "data", common),
        )

    def _conversion(self, keys: Mapping) -> Literal["hex_to_ascii", "ascii_to_hex"] | None:
        """From memory to wire, whatever the definition's way to name it."""
        node = keys.get("convert")
        name = self.reader.maybe(self.reader.text, node)
        if node is None or name not in ("hex_to_ascii", "ascii_to_hex"):
            return None
        if not self.space.turns_conversions(node.at.file):
            return "hex_to_ascii" if name == "hex_to_ascii" else "ascii_to_hex"
        if self.side not in ("client", "server"):
            what = "conversions are named by the direction of the frame, and this has none"
            todo = "say from: client or server in its group, or leave conversions: out"
            raise self.reader.broken(node.at, what, todo)
        to_digits = (name == "hex_to_ascii") == (self.side == "client")
        return "hex_to_ascii" if to_digits else "ascii_to_hex"

    def _length(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        unit = keys.get("unit")
        of = reader.texts(keys.get("of"))
        if not of:
            name = reader.text(keys.get("length"))
            reader.note(keys.at, f"the length '{name}' counts nothing", "add of: [names of segments]")
        return model.Length(
            type=load_type(self.space, keys, keys.get("type")),
            of=of,
            plain=reader.flag(keys.get("plain")),
            unit=1 if unit is None else self._length_unit(unit),
            plus=reader.maybe(reader.number, keys.get("plus")) or 0,
            limits=reader.maybe(reader.range, keys.get("range")),
            zero_means=reader.maybe(reader.number, keys.get("zero_means")),
            **self._named(keys, "length", common),
        )

    def _length_unit(self, node: Node) -> int:
        text = self.reader.text(node)
        return LENGTH_UNITS[text] if text in LENGTH_UNITS else self.reader.number(node)

    def _count(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        reader = self.reader
        return model.Count(
            type=load_type(self.space, keys, keys.get("type")),
            of=reader.text(keys.get("of")),
            plus=reader.maybe(reader.number, keys.get("plus")) or 0,
            limits=reader.maybe(reader.range, keys.get("range")),
            zero_means=reader.maybe(reader.number, keys.get("zero_means")),
            **self._named(keys, "count", common),
        )

    def _skip(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        fill = keys.get("fill")
        return model.Skip(
            size=self.reader.bytes_at_most(keys.get("skip")),
            fill=b"\0" if fill is None else self.reader.bytes(fill),
            **common,
        )

    def _value(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        return model.Value(
            read=self.reader.expression(keys.get("read")),
            build=self.reader.maybe(self.reader.expression, keys.get("build")),
            **self._named(keys, "value", common),
        )

    def _require(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        return model.Require(condition=self.reader.expression(keys.get("require")), **common)

    def _check(self, keys: Mapping, common: dict[str, Any]) -> model.Segment:
        return load_check_segment(self.space, keys, common)


def literal_bytes(scalar: Scalar) -> Expression:
    """Bytes written as hex pairs, as an expression. Raises ValueError."""
    return Expression(scalar.text, Bytes(scalar.at, parse_bytes(scalar.text) if scalar.text.strip() else b""))
