"""`check`: a check code."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

from framekit.definition.expression import Expression, needs_extra
from framekit.definition.keys import EXPRESSION, FLAG, NUMBER, Form, KeyReading, here, key, keys, ref, words
from framekit.definition.kinds.base import Contents, Given, References, Segment
from framekit.definition.model.checks import MACS, CheckMethod, Mac, not_installed, wrong_size
from framekit.definition.problems import Position, Problem, plural
from framekit.definition.tree import Mapping, Node
from framekit.definition.wire_types import DIGITS, EVERY_BYTE, FieldType, Sizes, exactly, load_type

CodeForm = Literal["raw", "hex", "HEX", "dec", "nibbles"]
Verify = Literal["error", "warn", "off"]
FORMS: dict[str, CodeForm] = {"raw": "raw", "hex": "HEX", "HEX": "HEX", "dec": "dec", "nibbles": "nibbles"}
VERIFY: dict[str, Verify] = {"error": "error", "warn": "warn", "off": "off"}


def _form(reading: KeyReading) -> CodeForm:
    """Return the form of the code; `hex` digits are upper-case unless `case: lower`."""
    reader, given = reading.reader, reading.keys
    node = given.get("as")
    form: CodeForm = "raw" if node is None else reader.one_of(node, FORMS, "a form of a check code")
    return "hex" if form == "HEX" and reader.maybe(reader.text, given.get("case")) == "lower" else form


@dataclass(frozen=True, slots=True)
class Added:
    """Covered bytes that are not on the wire: an expression for bytes, or for a number written in a type."""

    at: Position
    value: Expression
    type: FieldType | None = None


Edges = tuple[str, str]
"""A range from one segment to another; the last name may be `here`."""
Covered = str | Edges | Added
"""A covered part: a named segment, a range from one segment to another, or bytes that are not on the wire."""


def _covers(reading: KeyReading) -> tuple[Covered, ...] | None:
    reader, node = reading.reader, reading.keys.get("over")
    return None if node is None else reader.each(reader.items(node), lambda item: _covered(reading, item))


def _covered(reading: KeyReading, node: Node) -> Covered:
    reader = reading.reader
    if not isinstance(node, Mapping):
        first, dots, last = (part.strip() for part in reader.text(node).partition(".."))
        return (first, last) if dots else first
    value, type_node = reader.expression(node.get("bytes")), node.get("type")
    if type_node is None:
        for key_ in ("size", "order", "case"):
            if (given := node.get(key_)) is not None:
                raise reader.broken(given.at, f"{key_} says how a number stands there, and these are bytes", "add type")
        return Added(node.at, value)
    type_ = load_type(reading.space, node, type_node)
    if not type_.is_whole_number or type_.fixed_size is None:
        what = f"'{reader.text(type_node)}' is no type of whole numbers of fixed size"
        raise reader.broken(type_node.at, what, "take u8, u16 and the like; leave type out for bytes")
    return Added(node.at, value, type_)


def _size(reading: KeyReading) -> int:
    """Return the size of a check code on the wire (bytes). A byte order without effect is noted."""
    node, method, form = reading.keys.get("size"), reading.found["method"], reading.found["form"]
    if node is not None:
        size = reading.reader.number(node)
    elif form == "dec":
        size = len(str((1 << method.width) - 1))
    else:
        size = int(method.size * (1 if form == "raw" else 2))
    order = reading.keys.get("order")
    if order is not None and size <= (1 if form in ("raw", "dec") else 2):
        reading.reader.note(order.at, "order has no effect: the code is one byte", "leave it out")
    return size


def _order(reading: KeyReading, node: Node) -> Literal["big", "little"]:
    return "little" if reading.reader.text(node) == "little" else "big"


def _verify(reading: KeyReading, node: Node) -> Verify:
    return reading.reader.one_of(node, VERIFY, "a way to verify")


METHOD = Form(ref("label"), lambda r, node: r.space.check(node))
_COVERED = (
    "What it covers: names, ranges first..last (here = up to the check), {bytes: EXPR} for bytes that are not on the "
    "wire; default: everything before it."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check(Segment):
    """A check code over everything before it, or over parts one after the other (`covers`).

    Each part is covered with its content inside of wraps, decoded and in binary; with its bytes on the wire, if `wire`
    is set.
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
    covers: tuple[Covered, ...] | None = keys(
        {"over": {**here("span"), "description": _COVERED}}, _covers, default=None
    )
    wire: bool = key(
        "wire", FLAG, "yes: it covers the bytes on the wire, also of wraps; default: the plain content.", default=False
    )
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

    ends: bool = key(
        "ends", FLAG, "yes: a wrong code ends the frame at once, whatever its length says; default: no.", default=False
    )

    key: Expression | None = key("key", EXPRESSION, "The key of a code that is made with one: bytes.", default=None)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return exactly(self.size)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        return DIGITS if self.form in ("hex", "HEX", "dec") else EVERY_BYTE

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the segments that it covers as single names."""
        return tuple(one for one in self.covers or () if isinstance(one, str))

    @property
    def edges(self) -> tuple[str, ...]:
        """Return the segments at the ends of its ranges."""
        return tuple(name for one in self.covers or () if isinstance(one, tuple) for name in one if name != "here")

    @property
    def span(self) -> Edges | None:
        """Return the covered range if that is all it covers; else None."""
        only = self.covers[0] if self.covers is not None and len(self.covers) == 1 else None
        return only if isinstance(only, tuple) else None

    @property
    def added(self) -> tuple[Added, ...]:
        """Return the covered bytes that are not on the wire."""
        return tuple(one for one in self.covers or () if isinstance(one, Added))

    @property
    def code_size(self) -> int:
        """Return the number of bytes of the code, for a code with a key, that its place on the wire holds."""
        return self.size // (2 if self.form in ("hex", "HEX", "nibbles") else 1)

    def with_names(self, change: Callable[[tuple[str, ...]], tuple[str, ...]]) -> Self:
        """Return the check with the names of covered segments replaced."""
        covers = self.covers
        if covers is not None:
            parts = ((change((one,)) if isinstance(one, str) else (one,)) for one in covers)
            covers = tuple(one for part in parts for one in part)
        return replace(self, covers=covers)

    def given(self) -> Iterator[Given]:
        yield from Segment.given(self)
        for one in self.added:
            yield one.value, "bytes" if one.type is None else "number", None
        yield self.key, "bytes", None

    def needed(self) -> Iterator[tuple[str, Expression]]:
        yield from Segment.needed(self)
        for one in self.added:
            yield "check code", one.value
        if self.key is not None:
            yield "key", self.key

    def resolved(self, references: References) -> Segment:
        found = self.with_names(lambda names: references.written_out(names, self.at))
        if found.covers is None:
            return found
        return replace(found, covers=tuple(self._range(references, one) for one in found.covers))

    def _range(self, references: References, part: Covered) -> Covered:
        if not isinstance(part, tuple):
            return part
        first, last = part
        return self._edge(references, first, 0), "here" if last == "here" else self._edge(references, last, -1)

    def _edge(self, references: References, name: str, which: int) -> str:
        """Return the segment at one end of a range: by name, or by its offset in bytes from the start."""
        if name.isdigit():
            return references.at_offset(int(name), self.at, which)
        written = references.written_out((name,), self.at, may_be_empty=False)
        return written[which] if written else ""

    def check(self) -> Iterator[Problem]:
        """Report a code that does not fit into its digits, and other problems of its parameters."""
        bits = {"raw": 8, "hex": 4, "HEX": 4, "nibbles": 4}.get(self.form)
        if self.method.is_keyed:
            yield from self._keyed()
        elif self.key is not None:
            yield Problem(self.key.at, f"{self.method.name} takes no key", "leave key out")
        elif bits is not None and self.size * bits < self.method.width:
            what = f"a code of {self.method.width} bits does not fit into {plural(self.size, 'byte')}"
            todo = "leave size out" if self.form == "raw" else "each digit holds 4 bits: leave size out"
            yield Problem(self.at, what, todo)
        if self.form == "dec" and not self.method.is_keyed and 10**self.size <= (1 << self.method.width) - 1:
            what = f"a code of {self.method.width} bits does not fit into {self.size} decimal digits"
            yield Problem(self.at, what, "leave size out")
        if self.name in self.names:
            yield Problem(self.at, "a check code cannot cover itself", "leave its name out of over")
        if self.ends and self.verify != "error":
            what = f"a wrong code is no fault here (verify: {self.verify}), so it cannot end the frame"
            yield Problem(self.at, what, "leave ends or verify out")
        if self.refuse is not None:
            what = "a frame with a wrong code is bad, and is never refused with a code"
            yield Problem(self.at, what, "leave refuse out, and say in on_bad: what is done then")
        if self.wire and self.covers is None:
            what = "without over: a check code counts what stands on the wire already"
            yield Problem(self.at, what, "leave wire out, or say in over: what it covers")

    def _keyed(self) -> Iterator[Problem]:
        """Report a code with a missing key, or with a form or size that is impossible for it; a shorter size sends its
        first bytes.
        """
        name, mac = self.method.name, MACS.get(self.method.kind, Mac(self.method.size))
        expression = self.method.expression
        if mac.is_extra or (expression is not None and needs_extra(expression)):
            yield from not_installed(self.at, name)
        if self.method.kind == "code":
            if self.key is not None:
                yield Problem(self.key.at, f"the expression of {name} says what it is made with", "leave key out")
        elif self.key is None:
            yield Problem(self.at, f"{name} needs a key", "add key: bytes, or the name of a parameter")
        elif mac.key_sizes:
            yield from wrong_size("the key", self.key, mac.key_sizes, "AES takes keys of 16, 24 or 32 bytes")
        if self.form == "dec":
            yield Problem(self.at, f"{name} has no decimal digits", "take as: raw, hex, HEX or nibbles")
        elif self.form != "raw" and self.size % 2:
            yield Problem(self.at, "two digits stand for each byte of a code made with a key", "give an even size")
        elif not 1 <= self.code_size <= mac.size:
            what = f"{name} has {plural(mac.size, 'byte')}, and {plural(self.code_size, 'byte')} are to stand there"
            yield Problem(self.at, what, "correct size, or leave it out")
