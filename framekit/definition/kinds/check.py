"""`check`: a check code."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

from framekit.definition.keys import NUMBER, Form, KeyReading, here, key, keys, ref, words
from framekit.definition.kinds.base import Contents, References, Segment
from framekit.definition.model.checks import CheckMethod
from framekit.definition.problems import Problem, plural
from framekit.definition.tree import Node, Sequence
from framekit.definition.wire_types import DIGITS, EVERY_BYTE, Sizes, exactly

CodeForm = Literal["raw", "hex", "HEX", "dec", "nibbles"]
Verify = Literal["error", "warn", "off"]
FORMS: dict[str, CodeForm] = {"raw": "raw", "hex": "HEX", "HEX": "HEX", "dec": "dec", "nibbles": "nibbles"}
VERIFY: dict[str, Verify] = {"error": "error", "warn": "warn", "off": "off"}


def _form(reading: KeyReading) -> CodeForm:
    """`hex` digits are upper-case unless `case: lower`."""
    reader, given = reading.reader, reading.keys
    node = given.get("as")
    form: CodeForm = "raw" if node is None else reader.one_of(node, FORMS, "a form of a check code")
    return "hex" if form == "HEX" and reader.maybe(reader.text, given.get("case")) == "lower" else form


def _over(reading: KeyReading) -> tuple[str, ...] | None:
    node = reading.keys.get("over")
    if node is None or isinstance(node, Sequence):
        return None if node is None else reading.reader.texts(node)
    text = reading.reader.text(node)
    return None if ".." in text else (text,)


def _span(reading: KeyReading) -> tuple[str, str] | None:
    node = reading.keys.get("over")
    if node is None or isinstance(node, Sequence) or ".." not in reading.reader.text(node):
        return None
    first, _, last = reading.reader.text(node).partition("..")
    return first.strip(), last.strip()


def _size(reading: KeyReading) -> int:
    """Bytes on the wire of a check code."""
    node, method, form = reading.keys.get("size"), reading.found["method"], reading.found["form"]
    if node is not None:
        return reading.reader.number(node)
    if form == "dec":
        return len(str((1 << method.width) - 1))
    return int(method.size * (1 if form == "raw" else 2))


def _order(reading: KeyReading, node: Node) -> Literal["big", "little"]:
    return "little" if reading.reader.text(node) == "little" else "big"


def _verify(reading: KeyReading, node: Node) -> Verify:
    return reading.reader.one_of(node, VERIFY, "a way to verify")


METHOD = Form(ref("label"), lambda r, node: r.space.check(node))
_COVERED = "What it covers: [names], or first..last (here = up to the check); default: everything before it."


@dataclass(frozen=True, slots=True, kw_only=True)
class Check(Segment):
    """A check code over everything before it, over named segments (`over`), or from one to another (`span`).

    Each counts as it is inside its wrap: undoubled and in binary. In `span` the last name may be `here`.
    """

    KEY: ClassVar[str] = "check"

    method: CheckMethod = key(
        "check", METHOD, "Check method: a ready one such as sum8 or crc32, or one of the section checks."
    )
    form: CodeForm = keys(
        {
            "as": {**words("a form", *FORMS), "description": "How the code is written: raw, hex, HEX, dec or nibbles."},
            "case": here("digit_case"),
        },
        _form,
        default="raw",
    )
    over: tuple[str, ...] | None = keys({"over": {**here("span"), "description": _COVERED}}, _over, default=None)
    span: tuple[str, str] | None = keys({}, _span, default=None)
    order: Literal["big", "little"] = key(
        "order", Form(ref("byte_order"), _order), "Byte order of the code.", default="big"
    )
    size: int = keys(
        {"size": {**NUMBER.schema, "description": "Number of bytes or digits on the wire."}}, _size, default=1
    )
    verify: Verify = key(
        "verify",
        Form(words("a way to verify", *VERIFY, False), _verify),
        "What a wrong code is: error (the default), warn or off.",
        default="error",
    )

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return exactly(self.size)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        return DIGITS if self.form in ("hex", "HEX", "dec") else EVERY_BYTE

    def resolved(self, references: References) -> Segment:
        if self.over is not None:
            return replace(self, over=references.written_out(self.over, self.at))
        if self.span is None:
            return self
        first, last = self.span
        end = "here" if last == "here" else self._edge(references, last, -1)
        return replace(self, span=(self._edge(references, first, 0), end))

    def _edge(self, references: References, name: str, which: int) -> str:
        """The segment at one end of a range: by name, or by its offset in bytes from the start."""
        if name.isdigit():
            return references.at_offset(int(name), self.at, which)
        written = references.written_out((name,), self.at)
        return written[which] if written else ""

    def check(self) -> Iterator[Problem]:
        """A code has the places its digits need."""
        bits = {"raw": 8, "hex": 4, "HEX": 4, "nibbles": 4}.get(self.form)
        if bits is not None and self.size * bits < self.method.width:
            what = f"a code of {self.method.width} bits does not fit into {plural(self.size, 'byte')}"
            todo = "leave size out" if self.form == "raw" else "each digit holds 4 bits: leave size out"
            yield Problem(self.at, what, todo)
        if self.form == "dec" and 10**self.size <= (1 << self.method.width) - 1:
            what = f"a code of {self.method.width} bits does not fit into {self.size} decimal digits"
            yield Problem(self.at, what, "leave size out")
        if self.over is not None and self.name in self.over:
            yield Problem(self.at, "a check code cannot cover itself", "leave its name out of over")
