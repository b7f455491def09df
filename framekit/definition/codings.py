"""How the content of a `wrap` may stand on the wire: with bytes escaped, without zeros, with bytes put in.

A coding is a class here, with what must be known to validate a definition. Its bytes are made in `codec/stuffing.py`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from framekit.definition.keys import BYTE, Form, KeyReading, Schema, ref
from framekit.definition.problems import Position, Problem
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Node
from framekit.definition.wire_types import DIGITS, EVERY_BYTE, Sizes


@dataclass(frozen=True, slots=True)
class Coding:
    """One way in which content stands on the wire. `never`: the bytes that never stand there then."""

    at: Position

    @property
    def never(self) -> frozenset[int]:
        return frozenset()

    @property
    def contents(self) -> frozenset[int]:
        """The bytes that may stand on the wire."""
        return EVERY_BYTE - self.never

    def sizes(self, plain: Sizes) -> Sizes:
        """Bytes on the wire of so many plain ones: each may become two, if the coding says nothing else."""
        return Sizes(plain.least, plain.times(1, 2).most)

    def check(self) -> Iterator[Problem]:
        """What is wrong with it by itself."""
        return iter(())

    @property
    def shown(self) -> str:
        """What documents say of it."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Hex(Coding):
    """Every byte as two hex digits, written upper-case, read in either case."""

    @property
    def never(self) -> frozenset[int]:
        return EVERY_BYTE - DIGITS

    def sizes(self, plain: Sizes) -> Sizes:
        return plain.times(2, 2)

    @property
    def shown(self) -> str:
        return "hex digits"


@dataclass(frozen=True, slots=True)
class Plain(Coding):
    """Content as it is: a region of so many bytes."""

    def sizes(self, plain: Sizes) -> Sizes:
        return plain

    @property
    def shown(self) -> str:
        return "region"


@dataclass(frozen=True, slots=True)
class Doubled(Coding):
    """The byte `escape` stands twice; alone it ends the content."""

    escape: int

    @property
    def shown(self) -> str:
        return f"{self.escape:02X} doubled"


@dataclass(frozen=True, slots=True)
class Escaped(Coding):
    """Some bytes are two: `escape` and what `codes` say, or the byte with the bits of `flip` turned (`xor`)."""

    escape: int
    codes: tuple[tuple[int, int], ...]
    flip: int | None = None

    @property
    def never(self) -> frozenset[int]:
        return self.escaped - {self.escape}

    @property
    def escaped(self) -> frozenset[int]:
        """The bytes that are escaped."""
        return frozenset(byte for byte, _ in self.codes)

    def check(self) -> Iterator[Problem]:
        if self.escape not in self.escaped:
            what = f"the escape byte {self.escape:02X} itself is not escaped"
            todo = "put it into bytes" if self.flip is not None else "give it a code too"
            yield Problem(self.at, what, todo)
        behind = [code for _, code in self.codes]
        for byte, code in self.codes:
            if [other for other, _ in self.codes].count(byte) > 1:
                yield Problem(self.at, f"{byte:02X} is to be escaped twice", "give each byte once")
                return
            if code in self.escaped:
                what = f"{byte:02X} is sent as {self.escape:02X} {code:02X}, and {code:02X} is to be escaped itself"
                yield Problem(self.at, what, "choose another code or xor; escape: alone doubles the escape byte")
            elif behind.count(code) > 1:
                yield Problem(self.at, f"{code:02X} is the code of several bytes", "give each one of its own")
                return

    @property
    def shown(self) -> str:
        return f"{' '.join(f'{byte:02X}' for byte in sorted(self.escaped))} escaped with {self.escape:02X}"


@dataclass(frozen=True, slots=True)
class Cobs(Coding):
    """Consistent Overhead Byte Stuffing: groups of up to 254 bytes, each behind its length, so that there is no 00."""

    @property
    def never(self) -> frozenset[int]:
        return frozenset({0})

    def sizes(self, plain: Sizes) -> Sizes:
        return Sizes(plain.least + 1, None if plain.most is None else plain.most + plain.most // 254 + 1)

    @property
    def shown(self) -> str:
        return "COBS"


@dataclass(frozen=True, slots=True)
class Inserted(Coding):
    """Behind every `after` in the content the bytes `insert` are put in."""

    after: bytes
    insert: bytes

    def sizes(self, plain: Sizes) -> Sizes:
        more = 1 + -(-len(self.insert) // len(self.after))
        return Sizes(plain.least, plain.times(1, more).most)

    @property
    def shown(self) -> str:
        return f"{self.insert.hex(' ').upper()} put in behind {self.after.hex(' ').upper()}"


# ---- in YAML ------------------------------------------------------------------------------------------------

_WAYS: Mapping[frozenset[str], str] = {
    frozenset({"escape"}): "doubled",
    frozenset({"escape", "xor", "bytes"}): "xor",
    frozenset({"escape", "codes"}): "codes",
    frozenset({"after", "insert"}): "inserted",
}
_EXPECTED = (
    "hex, cobs, none, {escape: BYTE}, {escape: BYTE, xor: BYTE, bytes: [BYTES]}, {escape: BYTE, codes: {BYTE: BYTE}} "
    "or {after: BYTES, insert: BYTES}"
)
_SCHEMA: Schema = {
    "title": "wrap",
    "description": f"How the content stands on the wire: {_EXPECTED}.",
    "type": ["string", "object"],
    "pattern": "^(hex|cobs|none)$",
    "x-expected": "a wrap (hex, cobs, none, {escape: …} or {after: …})",
    "properties": {
        "escape": {**BYTE.schema, "description": "The byte that escapes; alone: it is doubled in the content."},
        "xor": {**BYTE.schema, "description": "Behind the escape byte a byte stands with these bits turned."},
        "bytes": {
            "description": "The bytes that are escaped.",
            "type": ["array", "string", "integer", "number"],
            "items": BYTE.schema,
            "minItems": 1,
            "x-expected": "bytes ([7E, 7D])",
        },
        "codes": {
            "description": "What stands behind the escape byte for each byte that is escaped.",
            "type": "object",
            "propertyNames": BYTE.schema,
            "additionalProperties": BYTE.schema,
            "minProperties": 1,
        },
        "after": {**ref("bytes"), "description": "The bytes behind which others are put in."},
        "insert": {**ref("bytes"), "description": "The bytes that are put in."},
    },
    "additionalProperties": False,
}


def _read(reading: KeyReading, node: Node) -> Coding:
    """The coding that `wrap` names. Raises Broken."""
    reader = reading.reader
    if not isinstance(node, Keys):
        return {"hex": Hex, "none": Plain}.get(reader.text(node), Cobs)(node.at)
    way = _WAYS.get(frozenset(str(entry.key.text) for entry in node.read_all()))
    if way is None:
        raise reader.broken(node.at, "these keys together are no wrap", f"write {_EXPECTED}")
    if way == "inserted":
        return Inserted(node.at, reader.bytes(node.get("after")), reader.bytes(node.get("insert")))
    escape = reader.byte(node.get("escape"))
    if way == "doubled":
        return Doubled(node.at, escape)
    if way == "xor":
        flip = reader.byte(node.get("xor"))
        escaped = b"".join(reader.bytes(item) for item in reader.items(node.get("bytes")))
        return Escaped(node.at, escape, tuple((byte, byte ^ flip) for byte in dict.fromkeys(escaped)), flip)
    codes = reader.entries(node.get("codes"))
    return Escaped(node.at, escape, tuple((reader.byte(one.key), reader.byte(one.value)) for one in codes))


CODING = Form(_SCHEMA, _read)
