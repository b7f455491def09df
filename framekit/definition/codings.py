"""Codings of the content of a `wrap` on the wire: escaped bytes, no zero bytes, inserted bytes, ciphers.

A coding is a class here, with the properties needed to check a definition. Its bytes are made in `codec/stuffing.py`,
those of ciphers in `codec/ciphers.py` by the library `cryptography`, which is an extra.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from framekit.definition.expression import Binary, Expression, Node, Number
from framekit.definition.keys import BYTE, EXPRESSION, NUMBER, Form, KeyReading, Schema, properties_of, ref, words
from framekit.definition.kinds.check import Check
from framekit.definition.load.reader import MOST_BYTES, Reader
from framekit.definition.model.checks import AES_KEY_SIZES, not_installed, wrong_size
from framekit.definition.problems import Position, Problem, plural
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Node as YamlNode
from framekit.definition.wire_types import DIGITS, EVERY_BYTE, Sizes


@dataclass(frozen=True, slots=True)
class Coding:
    """A coding of content on the wire.

    `never`: the bytes that never occur in encoded content.
    """

    at: Position

    @property
    def never(self) -> frozenset[int]:
        return frozenset()

    @property
    def contents(self) -> frozenset[int]:
        """Return the bytes that may occur in encoded content."""
        return EVERY_BYTE - self.never

    def sizes(self, plain: Sizes) -> Sizes:
        """Return the sizes of encoded content (bytes); by default each byte may become two."""
        return Sizes(plain.least, plain.times(1, 2).most)

    def size_of(self, plain: Node) -> Node | None:
        """Return the size of encoded content, as an expression over the plain size; None if it depends on the
        content.
        """
        return None

    @property
    def expressions(self) -> tuple[tuple[str, Expression], ...]:
        """Return the expressions (bytes) that must be known to read or build the content, with their nouns in
        messages.
        """
        return ()

    def check(self) -> Iterator[Problem]:
        """Report problems of the coding by itself."""
        return iter(())

    def check_content(self, size: int | None) -> Iterator[Problem]:
        """Report problems of content with a constant size in bytes; None: the size depends on values."""
        return iter(())

    @property
    def shown(self) -> str:
        """Return the description for documents."""
        raise NotImplementedError


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
    """Unchanged content: a region of a given size."""

    def sizes(self, plain: Sizes) -> Sizes:
        return plain

    def size_of(self, plain: Node) -> Node:
        return plain

    @property
    def shown(self) -> str:
        return "region"


@dataclass(frozen=True, slots=True)
class Doubled(Coding):
    """The byte `escape` is doubled in the content; a single one ends it."""

    escape: int

    @property
    def shown(self) -> str:
        return f"{self.escape:02X} doubled"


@dataclass(frozen=True, slots=True)
class Escaped(Coding):
    """Escaped bytes become two: `escape` and the code from `codes`, or the byte with the bits of `flip` inverted
    (`xor`).
    """

    escape: int
    codes: tuple[tuple[int, int], ...]
    flip: int | None = None

    @property
    def never(self) -> frozenset[int]:
        return self.escaped - {self.escape}

    @property
    def escaped(self) -> frozenset[int]:
        """Return the bytes that are escaped."""
        return frozenset(byte for byte, _ in self.codes)

    def check(self) -> Iterator[Problem]:
        if self.escape not in self.escaped:
            what = f"the escape byte {self.escape:02X} itself is not escaped"
            todo = "put it into bytes" if self.flip is not None else "give it a code too"
            yield Problem(self.at, what, todo)
        replacements = [code for _, code in self.codes]
        for byte, code in self.codes:
            if [other for other, _ in self.codes].count(byte) > 1:
                yield Problem(self.at, f"{byte:02X} is to be escaped twice", "give each byte once")
                return
            if code in self.escaped:
                what = f"{byte:02X} is sent as {self.escape:02X} {code:02X}, and {code:02X} is to be escaped itself"
                yield Problem(self.at, what, "choose another code or xor; escape: alone doubles the escape byte")
            elif replacements.count(code) > 1:
                yield Problem(self.at, f"{code:02X} is the code of several bytes", "give each one of its own")
                return

    @property
    def shown(self) -> str:
        return f"{' '.join(f'{byte:02X}' for byte in sorted(self.escaped))} escaped with {self.escape:02X}"


@dataclass(frozen=True, slots=True)
class Cobs(Coding):
    """Consistent Overhead Byte Stuffing: groups of up to 254 bytes, each preceded by its length, without any 00."""

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
    """The bytes `insert` are inserted after every `after` in the content."""

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
    """A check code follows every `size` bytes, and the remaining bytes."""

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
    """Bytes `fill` at the end are omitted, except within the first `least` bytes; the content has a constant size."""

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


# ---- ciphers: AES with CBC, CTR and GCM (NIST SP 800-38A and 800-38D) --------------------------------------

BLOCK = 16
"""Bytes of a block of AES."""
Padding = Literal["none", "pkcs7", "iso7816"]
PADDINGS: Mapping[str, Padding] = {"none": "none", "pkcs7": "pkcs7", "iso7816": "iso7816"}
TAG_SIZES = (4, 16)


class _Cipher(NamedTuple):
    """Properties of a cipher: least and greatest size of the initial value (bytes), and whether it pads or has a
    tag.
    """

    iv: tuple[int, int]
    pads: bool = False
    tags: bool = False


CIPHERS: Mapping[str, _Cipher] = {
    "aes-cbc": _Cipher((16, 16), pads=True),
    "aes-ctr": _Cipher((16, 16)),
    "aes-gcm": _Cipher((8, 128), tags=True),
}


@dataclass(frozen=True, slots=True)
class Ciphered(Coding):
    """Enciphered content."""

    cipher: str
    key: Expression
    iv: Expression
    pad: Padding = "none"
    """Padding to whole blocks (CBC)."""
    tag: int = 0
    """Bytes of the tag after the content that authenticates content, key, initial value and `also` (GCM)."""
    also: Expression | None = None
    """Additional authenticated bytes (GCM)."""
    clear: int = 0
    """Number of leading bytes that are not enciphered."""

    @property
    def expressions(self) -> tuple[tuple[str, Expression], ...]:
        more = () if self.also is None else (("also", self.also),)
        return ("key", self.key), ("iv", self.iv), *more

    def sizes(self, plain: Sizes) -> Sizes:
        return Sizes(self._on_wire(plain.least), None if plain.most is None else self._on_wire(plain.most))

    def _on_wire(self, plain: int) -> int:
        if self.pad == "none":
            return plain + self.tag
        return self.clear + (max(plain - self.clear, 0) // BLOCK + 1) * BLOCK

    def size_of(self, plain: Node) -> Node:
        at = plain.at
        if self.pad == "none":
            return Binary(at, "+", plain, Number(at, self.tag)) if self.tag else plain
        clear = Number(at, self.clear)
        sealed = Binary(at, "-", plain, clear) if self.clear else plain
        blocks = Binary(at, "+", Binary(at, "//", sealed, Number(at, BLOCK)), Number(at, 1))
        whole = Binary(at, "*", blocks, Number(at, BLOCK))
        return Binary(at, "+", whole, clear) if self.clear else whole

    def check(self) -> Iterator[Problem]:
        yield from not_installed(self.at, self.cipher)
        yield from wrong_size("the key", self.key, AES_KEY_SIZES, "AES takes keys of 16, 24 or 32 bytes")
        least, most = CIPHERS[self.cipher].iv
        wanted = plural(least, "byte") if least == most else f"{least} to {most} bytes"
        yield from wrong_size("iv", self.iv, tuple(range(least, most + 1)), f"{self.cipher} takes {wanted}")
        if self.tag and not TAG_SIZES[0] <= self.tag <= TAG_SIZES[1]:
            yield Problem(self.at, f"a tag of {plural(self.tag, 'byte')} is not possible", "take 4 to 16")

    def check_content(self, size: int | None) -> Iterator[Problem]:
        sealed = None if size is None else size - self.clear
        if sealed is not None and sealed < 0:
            what = f"{plural(self.clear, 'byte')} stand as they are, and the content has {size}"
            yield Problem(self.at, what, "correct clear")
        elif self.cipher == "aes-cbc" and self.pad == "none" and sealed is not None and sealed % BLOCK:
            what = f"the content has {plural(sealed, 'byte')}, and {self.cipher} takes whole blocks of {BLOCK}"
            yield Problem(self.at, what, "add pad: pkcs7 or iso7816, as the protocol says")

    @property
    def shown(self) -> str:
        return self.cipher


# ---- in YAML ------------------------------------------------------------------------------------------------

CIPHER_KEYS: Schema = {
    "cipher": {
        **words("a cipher", *CIPHERS),
        "description": "The content is enciphered by it.",
    },
    "key": {**EXPRESSION.schema, "description": "The key: bytes, mostly a parameter with secret: yes."},
    "iv": {
        **EXPRESSION.schema,
        "description": "The initial value, first counter or nonce.",
    },
    "pad": {
        **words("a padding", *PADDINGS),
        "description": "What fills the content up to whole blocks (aes-cbc): none (the default), pkcs7 or iso7816.",
    },
    "tag": {**NUMBER.schema, "description": "Bytes of the tag after the content (aes-gcm); default 16."},
    "clear": {**NUMBER.schema, "description": "So many bytes at the beginning are not enciphered: 1 or more."},
    "also": {**EXPRESSION.schema, "description": "Bytes that count in the tag and are not enciphered (aes-gcm)."},
}
"""The keys of `wrap` for ciphers."""


def load_cipher(reading: KeyReading, node: Keys) -> Ciphered:
    """Return the cipher of a `wrap`. Raises Broken."""
    reader = reading.reader
    cipher = reader.one_of(node.get("cipher"), {name: name for name in CIPHERS}, "a cipher")
    options = CIPHERS[cipher]
    for name, is_there in (("pad", options.pads), ("tag", options.tags), ("also", options.tags)):
        given = node.get(name)
        if given is not None and not is_there:
            raise reader.broken(given.at, f"{cipher} has no {name}", f"leave {name} out")
    for name in ("key", "iv"):
        if node.get(name) is None:
            raise reader.broken(node.at, f"{cipher} needs {name}", f"add {name}: bytes, or the name of a parameter")
    pad, tag, also = node.get("pad"), node.get("tag"), node.get("also")
    return Ciphered(
        node.at,
        cipher,
        reader.expression(node.get("key")),
        reader.expression(node.get("iv")),
        "none" if pad is None else reader.one_of(pad, PADDINGS, "a padding"),
        (16 if tag is None else reader.number(tag)) if options.tags else 0,
        reader.maybe(reader.expression, also),
        reader.maybe(lambda given: _clear(reader, given), node.get("clear")) or 0,
    )


def _clear(reader: Reader, node: YamlNode) -> int:
    """Return the number of bytes that are not enciphered. Raises Broken for fewer than 1."""
    clear = reader.number(node)
    if not 1 <= clear <= MOST_BYTES:
        raise reader.broken(
            node.at, f"clear: {clear} is not possible", f"give 1 to {MOST_BYTES} bytes, or leave it out"
        )
    return clear


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
"""Keys allowed for a check code of blocks."""
_SCHEMA: Schema = {
    "title": "wrap",
    "description": f"How the content stands on the wire: {_EXPECTED}.",
    "type": ["string", "object"],
    "pattern": "^(hex|cobs|none)$",
    "x-expected": "a wrap (hex, cobs, none, {escape: …}, {after: …}, {block: …}, {short: …} or {cipher: …})",
    "properties": {
        "escape": {**BYTE.schema, "description": "The byte that escapes; alone: it is doubled in the content."},
        "xor": {**BYTE.schema, "description": "After the escape byte, the byte is sent with these bits inverted."},
        "bytes": {
            "description": "The bytes that are escaped.",
            "type": ["array", "string", "integer", "number"],
            "items": BYTE.schema,
            "minItems": 1,
            "x-expected": "bytes ([7E, 7D])",
        },
        "codes": {
            "description": "The code after the escape byte for each escaped byte.",
            "type": "object",
            "propertyNames": BYTE.schema,
            "additionalProperties": BYTE.schema,
            "minProperties": 1,
        },
        "after": {**ref("bytes"), "description": "The bytes after which other bytes are inserted."},
        "insert": {**ref("bytes"), "description": "The bytes that are put in."},
        "block": {
            **NUMBER.schema,
            "description": "A check code comes after each block of this number of bytes, and after the rest.",
        },
        **{name: one for name, one in properties_of(Check).items() if name in _OF_BLOCKS},
        "short": {**BYTE.schema, "description": "Such bytes at the end are left out, and read as if they stood there."},
        "min": {**NUMBER.schema, "description": "Number of first bytes that are never left out; default 0."},
        **CIPHER_KEYS,
    },
    "additionalProperties": False,
}


def _read(reading: KeyReading, node: YamlNode) -> Coding:
    """Return the coding of a `wrap`. Raises Broken."""
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
