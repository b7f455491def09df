"""How generated code writes and reads the content of a wrap: a row for each coding, by its class.

The functions that the rows name stand in `codec/stuffing.py` and `codec/ciphers.py`; `Module.function` inlines them.
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
"""The text of further arguments: for a module, a coding, and the size of its content, where that is always the same."""

Text = Callable[[Expression], str]
"""Writes an expression where the wrap stands."""


class WireCoding(NamedTuple):
    """The names of the functions that build, read, and read with care; what each is given beside the bytes.

    `careful` is empty where the kind `wrap` reads with care itself.

    `starts`: what stands on the wire for content that begins with some bytes, as far as these decide it.
    `brought`: the import with which the reading function comes.
    """

    build: str
    read: str
    careful: str
    build_arguments: Arguments = lambda module, coding, size: ""
    read_arguments: Arguments = lambda module, coding, size: ""
    starts: Callable[[Any, bytes], bytes] = lambda coding, plain: b""
    brought: str = ""

    def build_text(self, module: Module, coding: Coding, content: str, text: Text) -> str:
        """Text of what stands on the wire for the content, a text; `text` writes the expressions of the coding."""
        arguments = self.build_arguments(module, coding, None)
        return f"{module.function(self.build)}({content}{arguments}{_expressions(coding, text)})"

    def read_text(self, module: Module, coding: Coding, wire: str, size: int | None, text: Text) -> str:
        """Text of the content of what stands on the wire, a text; `size`: of content that always has so many bytes."""
        if self.brought:
            module.imports.add(self.brought)
            return f"{self.read}({wire})"
        arguments = self.read_arguments(module, coding, size)
        return f"{module.function(self.read)}({wire}{arguments}{_expressions(coding, text)})"

    def careful_text(self, module: Module, coding: Coding, size: int | None, text: Text) -> str:
        """Text of a function that reads with care what stands on the wire; expressions may have no value."""
        function, arguments = module.function(self.careful), self.read_arguments(module, coding, size)
        if coding.expressions:
            arguments += f", lambda: ({_expressions(coding, text).removeprefix(', ')})"
        return f"lambda raw: {function}(raw{arguments})" if arguments else function


def _expressions(coding: Coding, text: Text) -> str:
    """The values of the expressions of a coding as further arguments."""
    return "".join(f", {text(value)}" for _, value in coding.expressions)


def _one(byte: int) -> bytes:
    return bytes((byte,))


def _codes(coding: Escaped) -> tuple[tuple[bytes, bytes], ...]:
    """What each byte is on the wire, the escape byte first: it stands in all others."""
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
"""The codings there are."""


def wire_coding(coding: Coding) -> WireCoding:
    """The row of a coding."""
    return WIRE[type(coding)]


def starts(coding: Coding, plain: bytes) -> bytes:
    """The bytes on the wire with which content surely begins that begins with `plain`."""
    return wire_coding(coding).starts(coding, plain)
