"""How generated code writes and reads the content of a wrap: a row for each coding, by its class.

The functions that the rows name stand in `codec/stuffing.py`; `Module.function` has them inlined.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from framekit.codec import stuffing, support
from framekit.codec.python.forms import Functions
from framekit.codec.python.source import bytes_literal, literal
from framekit.definition.codings import Cobs, Coding, Doubled, Escaped, Hex, Inserted, Plain


class WireCoding(NamedTuple):
    """The names of the functions that build, read, and read with care; what each is given beside the bytes.

    `careful` is empty where the kind `wrap` reads with care itself.

    `starts`: what stands on the wire for content that begins with some bytes, as far as these decide it.
    `brought`: the import with which the reading function comes.
    """

    build: str
    read: str
    careful: str
    build_arguments: Callable[[Any], str] = lambda coding: ""
    read_arguments: Callable[[Any], str] = lambda coding: ""
    starts: Callable[[Any, bytes], bytes] = lambda coding, plain: b""
    brought: str = ""

    def build_text(self, functions: Functions, coding: Coding, content: str) -> str:
        """Text of what stands on the wire for the content, a text."""
        return f"{functions.function(self.build)}({content}{self.build_arguments(coding)})"

    def read_text(self, functions: Functions, coding: Coding, wire: str) -> str:
        """Text of the content of what stands on the wire, a text."""
        if self.brought:
            functions.imports.add(self.brought)
            return f"{self.read}({wire})"
        return f"{functions.function(self.read)}({wire}{self.read_arguments(coding)})"

    def careful_text(self, functions: Functions, coding: Coding) -> str:
        """Text of a function that reads with care what stands on the wire."""
        function, arguments = functions.function(self.careful), self.read_arguments(coding)
        return f"lambda raw: {function}(raw{arguments})" if arguments else function


def _one(byte: int) -> bytes:
    return bytes((byte,))


def _codes(coding: Escaped) -> tuple[tuple[bytes, bytes], ...]:
    """What each byte is on the wire, the escape byte first: it stands in all others."""
    codes = sorted(coding.codes, key=lambda one: one[0] != coding.escape)
    return tuple((_one(byte), bytes((coding.escape, code))) for byte, code in codes)


def _escaped_arguments(coding: Escaped) -> str:
    plain = {code: _one(byte) for byte, code in coding.codes}
    never = bytes(sorted(coding.never))
    return f", {bytes_literal(_one(coding.escape))}, {literal(plain)}, {literal(coding.flip)}, {bytes_literal(never)}"


def _inserted_arguments(coding: Inserted) -> str:
    return f", {bytes_literal(coding.after)}, {bytes_literal(coding.insert)}"


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
        lambda coding: f", {coding.escape:#04x}",
        lambda coding: f", {bytes_literal(_one(coding.escape))}, {bytes_literal(2 * _one(coding.escape))}",
        lambda coding, plain: support.stuff(plain, coding.escape),
    ),
    Escaped: WireCoding(
        "stuff_escaped",
        "unstuff_escaped",
        "open_escaped",
        lambda coding: f", {literal(_codes(coding))}",
        _escaped_arguments,
        lambda coding, plain: stuffing.stuff_escaped(plain, _codes(coding)),
    ),
    Plain: WireCoding("stuff_none", "stuff_none", "open_none", starts=lambda coding, plain: plain),
    Cobs: WireCoding("stuff_cobs", "unstuff_cobs", "open_cobs"),
    Inserted: WireCoding(
        "stuff_inserted", "unstuff_inserted", "open_inserted", _inserted_arguments, _inserted_arguments
    ),
}
"""The codings there are."""


def wire_coding(coding: Coding) -> WireCoding:
    """The row of a coding."""
    return WIRE[type(coding)]


def starts(coding: Coding, plain: bytes) -> bytes:
    """The bytes on the wire with which content surely begins that begins with `plain`."""
    return wire_coding(coding).starts(coding, plain)
