"""Define how generated code builds and reads the content of a wrap: a row for each coding, by its class.

The named functions are in `codec/stuffing.py` and `codec/ciphers.py`; `Module.function` inlines them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from framekit.codec import stuffing, support
from framekit.codec.python.forms import code_bytes
from framekit.codec.python.module import Module
from framekit.codec.python.source import bytes_literal, literal, quoted
from framekit.definition.codings import Blocks, Ciphered, Cobs, Coding, Doubled, Escaped, Hex, Inserted, Plain, Short
from framekit.definition.expression import Expression

Arguments = Callable[[Module, Any, int | None], str]
"""Return the source of further arguments, given a module, a coding, and the content size if it is constant."""

Text = Callable[[Expression], str]
"""Write an expression in the scope of the wrap."""


class WireCoding(NamedTuple):
    """The functions of a coding: names, and the arguments after the bytes."""

    build: str
    """The function that encodes content."""
    read: str
    """The function that decodes content."""
    careful: str
    """The function that decodes carefully; empty if the kind `wrap` does this itself."""
    build_arguments: Arguments = lambda module, coding, size: ""
    read_arguments: Arguments = lambda module, coding, size: ""
    starts: Callable[[Any, bytes], bytes] = lambda coding, plain: b""
    """Returns the encoded bytes at the start, as far as the first bytes of the content determine them."""
    brought: str = ""
    """The import line of the decoding function."""

    def build_text(self, module: Module, coding: Coding, content: str, text: Text) -> str:
        """Return the source of the encoded content; `text` writes the expressions of the coding."""
        arguments = self.build_arguments(module, coding, None)
        return f"{module.function(self.build)}({content}{arguments}{_expressions(coding, text)})"

    def read_text(self, module: Module, coding: Coding, wire: str, size: int | None, text: Text) -> str:
        """Return the source of the decoded content; `size` is the content size if it is constant."""
        if self.brought:
            module.imports.add(self.brought)
            return f"{self.read}({wire})"
        arguments = self.read_arguments(module, coding, size)
        return f"{module.function(self.read)}({wire}{arguments}{_expressions(coding, text)})"

    def careful_text(self, module: Module, coding: Coding, size: int | None, text: Text) -> str:
        """Return the source of a function that decodes carefully; expressions of the coding may lack a value."""
        function, arguments = module.function(self.careful), self.read_arguments(module, coding, size)
        if coding.expressions:
            arguments += f", lambda: ({_expressions(coding, text).removeprefix(', ')})"
        return f"lambda raw: {function}(raw{arguments})" if arguments else function


def _expressions(coding: Coding, text: Text) -> str:
    """Return the values of a coding's expressions as further arguments."""
    return "".join(f", {text(value)}" for _, value in coding.expressions)


def _one(byte: int) -> bytes:
    return bytes((byte,))


def _codes(coding: Escaped) -> tuple[tuple[bytes, bytes], ...]:
    """Return the encoding of each escaped byte, first the escape byte, which is part of all others."""
    codes = sorted(coding.codes, key=lambda one: one[0] != coding.escape)
    return tuple((_one(byte), bytes((coding.escape, code))) for byte, code in codes)


def _escaped_arguments(module: Module, coding: Escaped, size: int | None) -> str:
    plain = {code: _one(byte) for byte, code in coding.codes}
    never = bytes(sorted(coding.never))
    return f", {bytes_literal(_one(coding.escape))}, {literal(plain)}, {literal(coding.flip)}, {bytes_literal(never)}"


def _inserted_arguments(module: Module, coding: Inserted, size: int | None) -> str:
    return f", {bytes_literal(coding.after)}, {bytes_literal(coding.insert)}"


def _blocks_arguments(module: Module, coding: Blocks, size: int | None) -> str:
    return f", {coding.size}, lambda block: {code_bytes(module, coding.check_code, 'block')}"


def _cipher_arguments(module: Module, coding: Ciphered, size: int | None) -> str:
    return f", {quoted(coding.cipher)}, {quoted(coding.pad)}, {coding.tag}, {coding.clear}"


def _read_blocks_arguments(module: Module, coding: Blocks, size: int | None) -> str:
    digits = ", True" if coding.check_code.form in ("hex", "HEX") else ""
    return f"{_blocks_arguments(module, coding, size)}, {coding.check_code.size}{digits}"


WIRE: Mapping[type[Coding], WireCoding] = {
    Hex: WireCoding(
        "hex_to_ascii",
        "unhexlify",
        "hex_content",
        brought="from binascii import unhexlify",
        starts=lambda coding, plain: support.hex_to_ascii(plain),
    ),
    Doubled: WireCoding(
        "stuff",
        "unstuff",
        "",
        lambda module, coding, size: f", {coding.escape:#04x}",
        lambda module, coding, size: (
            f", {bytes_literal(_one(coding.escape))}, {bytes_literal(2 * _one(coding.escape))}"
        ),
        lambda coding, plain: stuffing.stuff(plain, coding.escape),
    ),
    Escaped: WireCoding(
        "stuff_escaped",
        "unstuff_escaped",
        "open_escaped",
        lambda module, coding, size: f", {literal(_codes(coding))}",
        _escaped_arguments,
        lambda coding, plain: stuffing.stuff_escaped(plain, _codes(coding)),
    ),
    Plain: WireCoding("stuff_none", "stuff_none", "open_none", starts=lambda coding, plain: plain),
    Cobs: WireCoding("stuff_cobs", "unstuff_cobs", "open_cobs"),
    Inserted: WireCoding(
        "stuff_inserted", "unstuff_inserted", "open_inserted", _inserted_arguments, _inserted_arguments
    ),
    Blocks: WireCoding("add_codes", "strip_codes", "open_codes", _blocks_arguments, _read_blocks_arguments),
    Ciphered: WireCoding(
        "encipher",
        "decipher",
        "open_ciphered",
        _cipher_arguments,
        _cipher_arguments,
        lambda coding, plain: plain[: coding.clear],
    ),
    Short: WireCoding(
        "shorten",
        "fill_up",
        "open_short",
        lambda module, coding, size: f", {bytes_literal(_one(coding.fill))}, {coding.least}",
        lambda module, coding, size: f", {bytes_literal(_one(coding.fill))}, {coding.least}, {size}",
    ),
}
"""All codings."""


def wire_coding(coding: Coding) -> WireCoding:
    """Return the row of a coding."""
    return WIRE[type(coding)]


def starts(coding: Coding, plain: bytes) -> bytes:
    """Return the encoded bytes that are certain at the start of content that begins with `plain`."""
    return wire_coding(coding).starts(coding, plain)
