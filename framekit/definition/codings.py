"""How the content of a `wrap` may stand on the wire: with bytes escaped, without zeros, with bytes put in, enciphered.

A coding is a class here, with what must be known to validate a definition. Its bytes are made in `codec/stuffing.py`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from framekit.definition.ciphers import CIPHER_KEYS, load_cipher
from framekit.definition.coding import Coding
from framekit.definition.expression import Binary, Node, Number
from framekit.definition.keys import BYTE, NUMBER, Form, KeyReading, Schema, properties_of, ref
from framekit.definition.kinds.check import Check
from framekit.definition.problems import Problem, plural
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Node as YamlNode
from framekit.definition.wire_types import DIGITS, EVERY_BYTE, Sizes


@dataclass(frozen=True, slots=True)
class Hex(Coding):
    """Every byte as two hex digits, written upper-case, read in either case."""

    @property
    def never(self) -> frozenset[int]:
        return EVERY_BYTE - DIGITS

    def sizes(self, plain: Sizes) -> Sizes:
        return plain.times(2, 2)

    def size_of(self, plain: Node) -> Node:
        return Binary(plain.at, "*", Number(plain.at, 2), plain)

    @property
    def shown(self) -> str:
        return "hex digits"


@dataclass(frozen=True, slots=True)
class Plain(Coding):
    """Content as it is: a region of so many bytes."""

    def sizes(self, plain: Sizes) -> Sizes:
        return plain

    def size_of(self, plain: Node) -> Node:
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


@dataclass(frozen=True, slots=True)
class Blocks(Coding):
    """Behind every `size` bytes, and behind what is left, stands a check code over them."""

    size: int
    check_code: Check

    def sizes(self, plain: Sizes) -> Sizes:
        return Sizes(self._on_wire(plain.least), None if plain.most is None else self._on_wire(plain.most))

    def _on_wire(self, plain: int) -> int:
        return plain + -(-plain // self.size) * self.check_code.size

    def size_of(self, plain: Node) -> Node:
        at, block = plain.at, Number(plain.at, self.size)
        blocks = Binary(at, "//", Binary(at, "+", plain, Number(at, self.size - 1)), block)
        return Binary(at, "+", plain, Binary(at, "*", blocks, Number(at, self.check_code.size)))

    def check(self) -> Iterator[Problem]:
        if self.check_code.method.is_keyed:
            what = "a code made with a key does not stand behind blocks"
            yield Problem(self.at, what, "put a check with key behind the wrap")
        else:
            yield from self.check_code.check()

    @property
    def shown(self) -> str:
        return f"{self.check_code.method.name} behind each {plural(self.size, 'byte')}"


@dataclass(frozen=True, slots=True)
class Short(Coding):
    """Bytes `fill` at the end are left out, but not of the first `least` bytes; the content has one size."""

    fill: int
    least: int = 0

    def sizes(self, plain: Sizes) -> Sizes:
        return Sizes(min(self.least, plain.least), plain.most)

    def check_content(self, size: int | None) -> Iterator[Problem]:
        if size is None:
            yield Problem(self.at, "what is left out at the end cannot be told of content of any size", "give it sizes")
        elif self.least > size:
            what = f"the content has {plural(size, 'byte')}, and {self.least} are never left out"
            yield Problem(self.at, what, "correct min")

    @property
    def shown(self) -> str:
        return f"without {self.fill:02X} at the end"


# ---- in YAML ------------------------------------------------------------------------------------------------

_WAYS: Mapping[frozenset[str], str] = {
    frozenset({"escape"}): "doubled",
    frozenset({"escape", "xor", "bytes"}): "xor",
    frozenset({"escape", "codes"}): "codes",
    frozenset({"after", "insert"}): "inserted",
    frozenset({"short"}): "short",
    frozenset({"short", "min"}): "short",
}
_EXPECTED = (
    "hex, cobs, none, {escape: BYTE}, {escape: BYTE, xor: BYTE, bytes: [BYTES]}, {escape: BYTE, codes: {BYTE: BYTE}}, "
    "{after: BYTES, insert: BYTES}, {block: N, check: METHOD}, {short: BYTE} or {cipher: NAME, key: EXPR, iv: EXPR}"
)
_OF_BLOCKS = ("check", "as", "case", "order", "size")
"""The keys of a check code that one behind blocks may have."""
_SCHEMA: Schema = {
    "title": "wrap",
    "description": f"How the content stands on the wire: {_EXPECTED}.",
    "type": ["string", "object"],
    "pattern": "^(hex|cobs|none)$",
    "x-expected": "a wrap (hex, cobs, none, {escape: …}, {after: …}, {block: …}, {short: …} or {cipher: …})",
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
        "block": {
            **NUMBER.schema,
            "description": "Behind so many bytes, and behind what is left, stands a check code.",
        },
        **{name: one for name, one in properties_of(Check).items() if name in _OF_BLOCKS},
        "short": {**BYTE.schema, "description": "Such bytes at the end are left out, and read as if they stood there."},
        "min": {**NUMBER.schema, "description": "Number of bytes of which none is left out; default 0."},
        **CIPHER_KEYS,
    },
    "additionalProperties": False,
}


def _read(reading: KeyReading, node: YamlNode) -> Coding:
    """The coding that `wrap` names. Raises Broken."""
    reader = reading.reader
    if not isinstance(node, Keys):
        return {"hex": Hex, "none": Plain}.get(reader.text(node), Cobs)(node.at)
    given = frozenset(str(entry.key.text) for entry in node.read_all())
    if {"block", "check"} <= given <= {"block", *_OF_BLOCKS}:
        size = reader.bytes_at_most(node.get("block"))
        if size < 1:
            raise reader.broken(node.at, "a block of no bytes has no check code", "give the number of bytes of a block")
        return Blocks(node.at, size, Check(at=node.at, **Check.attributes(reading.loader, node)))
    if "cipher" in given and given <= CIPHER_KEYS.keys():
        return load_cipher(reading, node)
    way = _WAYS.get(given)
    if way is None:
        raise reader.broken(node.at, "these keys together are no wrap", f"write {_EXPECTED}")
    if way == "inserted":
        return Inserted(node.at, reader.bytes(node.get("after")), reader.bytes(node.get("insert")))
    if way == "short":
        return Short(node.at, reader.byte(node.get("short")), reader.maybe(reader.bytes_at_most, node.get("min")) or 0)
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
