"""Ciphers as codings of a `wrap`: AES with CBC, CTR and GCM (NIST SP 800-38A and 800-38D).

The bytes are made in `codec/ciphers.py` by the library `cryptography`, which is an extra.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Literal, NamedTuple

from framekit.definition.coding import Coding
from framekit.definition.expression import Binary, Bytes, Expression, Node, Number
from framekit.definition.keys import EXPRESSION, NUMBER, KeyReading, Schema, words
from framekit.definition.load.reader import MOST_BYTES, Reader
from framekit.definition.model.macs import AES_KEY_SIZES
from framekit.definition.problems import Position, Problem, plural
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Node as TreeNode
from framekit.definition.wire_types import Sizes

BLOCK = 16
"""Bytes of a block of AES."""
Padding = Literal["none", "pkcs7", "iso7816"]
PADDINGS: Mapping[str, Padding] = {"none": "none", "pkcs7": "pkcs7", "iso7816": "iso7816"}
TAG_SIZES = (4, 16)
LIBRARY = "cryptography"


class _Cipher(NamedTuple):
    """Fewest and most bytes of the initial value, and which of the keys it has that only some ciphers have."""

    iv: tuple[int, int]
    pads: bool = False
    tags: bool = False


CIPHERS: Mapping[str, _Cipher] = {
    "aes-cbc": _Cipher((16, 16), pads=True),
    "aes-ctr": _Cipher((16, 16)),
    "aes-gcm": _Cipher((8, 128), tags=True),
}


def not_installed(at: Position, what: str) -> Iterator[Problem]:
    """That the library is not there which `what` needs; nothing if it is."""
    if find_spec(LIBRARY) is None:
        told = f"{what} needs the library {LIBRARY}, which is not installed"
        yield Problem(at, told, "install it: pip install 'framekit[crypto]'")


def wrong_size(name: str, value: Expression, allowed: tuple[int, ...], what: str) -> Iterator[Problem]:
    """That bytes which the definition itself gives are too few or too many."""
    if isinstance(value.root, Bytes) and len(value.root.value) not in allowed:
        told = f"{name} has {plural(len(value.root.value), 'byte')}"
        yield Problem(value.root.at, told, what)


@dataclass(frozen=True, slots=True)
class Ciphered(Coding):
    """Content that is enciphered as a whole.

    Its first `clear` bytes stand as they are. `pad` fills the others up to whole blocks (CBC). Behind them stand
    `tag` bytes that tell whether content, key, initial value and the bytes `also` are right (GCM).
    """

    cipher: str
    key: Expression
    iv: Expression
    pad: Padding = "none"
    tag: int = 0
    also: Expression | None = None
    clear: int = 0

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
    "tag": {**NUMBER.schema, "description": "Bytes of the tag behind the content (aes-gcm); default 16."},
    "clear": {**NUMBER.schema, "description": "So many bytes at the beginning are not enciphered: 1 or more."},
    "also": {**EXPRESSION.schema, "description": "Bytes that count in the tag and are not enciphered (aes-gcm)."},
}
"""The keys of `wrap` for ciphers."""


def load_cipher(reading: KeyReading, node: Keys) -> Ciphered:
    """The cipher that `wrap` names. Raises Broken."""
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


def _clear(reader: Reader, node: TreeNode) -> int:
    """How many bytes stand as they are. Raises Broken for fewer than 1."""
    clear = reader.number(node)
    if not 1 <= clear <= MOST_BYTES:
        raise reader.broken(
            node.at, f"clear: {clear} is not possible", f"give 1 to {MOST_BYTES} bytes, or leave it out"
        )
    return clear
