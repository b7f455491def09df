"""Names and types that users give to fields of guessed frames, and their effect on the adjacent bytes.

A guess is never changed: `named` returns a new guess with the names.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from framekit.codec.support import reorder
from framekit.definition.problems import did_you_mean, plural
from framekit.extras.guess.model import Evidence, FrameKind, Guess, GuessedField
from framekit.extras.guess.stuffing import StuffingError, plain_frame
from framekit.extras.guess.texts import PRINTABLE, decimal_keys, decimal_of, shown_text
from framekit.extras.guess.writing import bit_names

LONGEST_NAME = 60
LARGEST_NUMBER = 8
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
WORDS = frozenset({"if", "else", "or", "and", "not", "in", "it", "part", "request", "reply", "buffer", "own", "frame"})
"""Reserved words of expressions: they cannot name a field in an expression."""
ORDERS = ("big", "little", "BADC", "CDAB")
KEPT_KINDS = {
    "check": "the check",
    "length": "the length, which says where the frame ends",
    "count": "the count of what follows",
}
"""Kinds of fields that cannot be renamed, with their description."""


class NamingError(ValueError):
    """Raised for a name or a type that is impossible for these bytes."""


class FieldNaming(NamedTuple):
    """A name for bytes of all frames of a kind. `size` 0: the data of varying size. `type`: one of `TYPES`."""

    kind: str
    offset: int
    size: int
    name: str
    type: str
    order: str = "big"

    @property
    def end(self) -> int:
        """Return the offset after the last byte; unbounded for data of varying size."""
        return self.offset + self.size if self.size else 1 << 30


class NamedType(NamedTuple):
    """A type that can be given to bytes."""

    sizes: tuple[int, ...]
    """Possible sizes (bytes); empty for any size."""
    form: str

    def takes(self, size: int) -> bool:
        """Return whether a field of `size` bytes can have this type."""
        return size in self.sizes if self.sizes else True


TYPES: dict[str, NamedType] = {
    **{f"u{8 * size}": NamedType((size,), "unsigned") for size in range(1, LARGEST_NUMBER + 1)},
    **{f"i{8 * size}": NamedType((size,), "signed") for size in range(1, LARGEST_NUMBER + 1)},
    "f32": NamedType((4,), "float"),
    "f64": NamedType((8,), "float"),
    "bcd": NamedType(tuple(range(1, LARGEST_NUMBER + 1)), "bcd"),
    "bits": NamedType((1, 2, 4), "bits"),
    "decimal": NamedType((), "decimal"),
    "text": NamedType((), "text"),
    "bytes": NamedType((), "bytes"),
}
_FLOATS = {4: struct.Struct(">f"), 8: struct.Struct(">d")}


def orders_of(type_: str, size: int) -> tuple[str, ...]:
    """Return the byte orders possible for a number of this type and size; a single order if there is no choice."""
    if not TYPES[type_].sizes or size < 2:
        return ORDERS[:1]
    return ORDERS if size in (4, 8) and type_ not in ("bcd", "bits") else ORDERS[:2]


def number_of(type_: str, order: str, data: bytes) -> int | float | None:
    """Return the number that bytes represent in this type; None if they are no number."""
    form = TYPES[type_].form
    if form in ("text", "bytes"):
        return None
    if form == "decimal":
        return decimal_of(data)
    data = reorder(data, order) if len(data) > 1 else data
    if form == "float":
        number: float = _FLOATS[len(data)].unpack(data)[0]
        return number if math.isfinite(number) else None
    if form == "bcd":
        digits = data.hex()
        return int(digits) if digits.isdecimal() else None
    return int.from_bytes(data, "big", signed=form == "signed")


def types_of(texts: Sequence[bytes]) -> list[tuple[str, str]]:
    """Return the types possible for bytes of this size, each with its orders, the most usual types first."""
    size = len(texts[0])
    fitting = [
        (type_, order)
        for type_, what in TYPES.items()
        if what.takes(size) and what.form not in ("text", "decimal") and (what.form != "bytes" or size > 1)
        for order in orders_of(type_, size)
    ]
    fitting = [one for one in fitting if one[0] != "bcd" or all(text.hex().isdecimal() for text in texts)]
    is_text = all(PRINTABLE.issuperset(text) for text in texts)
    if is_text and size > 1 and decimal_keys(texts) is not None:
        fitting.insert(0, ("decimal", "big"))
    return [("text", "big"), *fitting] if is_text else fitting


# ---- naming -----------------------------------------------------------------------------------------------------


def named(guess: Guess, namings: Iterable[FieldNaming]) -> Guess:
    """Return the guess with these names, which must not overlap. Raises NamingError."""
    kinds = {kind.name: kind for kind in guess.kinds}
    texts = {kind.name: _plain(guess, kind) for kind in guess.kinds}
    for naming in namings:
        if naming.kind not in kinds:
            raise NamingError(f"there is no kind of frames '{naming.kind}' – {did_you_mean(naming.kind, list(kinds))}")
        for kind in _with_the_same_copy(kinds, naming):
            kinds[kind.name] = _named(kind, texts[kind.name], naming)
    return replace(guess, kinds=_echoing(guess.kinds, kinds))


def overlaps(one: FieldNaming, other: FieldNaming) -> bool:
    """Return whether two names overlap."""
    return one.kind == other.kind and one.offset < other.end and other.offset < one.end


def _plain(guess: Guess, kind: FrameKind) -> list[bytes]:
    assert guess.framing is not None
    found = []
    for frame in kind.frames:
        try:
            found.append(plain_frame(guess.framing, frame.data))
        except StuffingError:
            continue
    return found


def _with_the_same_copy(kinds: dict[str, FrameKind], naming: FieldNaming) -> list[FrameKind]:
    """Return the named kind, and the kinds of the other side if a reply repeats these bytes of its request."""
    meant = kinds[naming.kind]
    if not _covers_copies(meant, naming.offset, naming.end):
        return [meant]
    return [
        meant,
        *(one for one in kinds.values() if one is not meant and _covers_copies(one, naming.offset, naming.end)),
    ]


def _covers_copies(kind: FrameKind, first: int, end: int) -> bool:
    """Return whether the range consists of whole fields of kind `copy` only."""
    inside = [field for field in kind.fields if first <= field.offset < end]
    return (
        bool(inside)
        and all(field.kind == "copy" for field in inside)
        and inside[0].offset == first
        and inside[-1].offset + inside[-1].size == end
    )


def _named(kind: FrameKind, texts: Sequence[bytes], naming: FieldNaming) -> FrameKind:
    """Return a kind with an additional name. Raises NamingError."""
    touched = [field for field in kind.fields if _touches(field, naming, kind)]
    _check_place(kind, texts, naming, touched)
    _check_name(kind, naming, [field for field in kind.fields if field not in touched])
    own = _named_field(kind, texts, naming)
    fields: list[GuessedField] = []
    taken = {field.name for field in kind.fields} | {naming.name}
    for field in kind.fields:
        if field not in touched:
            fields.append(field)
            continue
        fields += _left(field, naming, texts, taken)
        if field is touched[-1]:
            fields.append(own)
            fields += _right(field, naming, texts, taken)
    return replace(kind, fields=tuple(fields))


def _check_place(
    kind: FrameKind, texts: Sequence[bytes], naming: FieldNaming, touched: Sequence[GuessedField]
) -> None:  # fmt: skip
    """Raise NamingError for bytes that cannot have a name of their own. `touched`: the fields that they overlap."""
    where = _where(naming)
    for field in touched:
        kept = _kept(field)
        if kept:
            belong = "belongs" if naming.size == 1 else "belong"
            raise NamingError(f"{where} of '{kind.name}' {belong} to {kept} – choose other bytes")
    shortest = min(map(len, texts))
    tail = sum(field.size for field in kind.fields if field.offset < 0)
    if not touched or (naming.size and naming.end > shortest - tail):
        raise NamingError(f"not all frames of '{kind.name}' have {where} – choose bytes that all of them have")
    counted = 0 if kind.check is None or kind.check.place.at is not None else kind.check.place.start
    if naming.offset < counted < naming.end:
        raise NamingError(f"the check begins to count at byte {counted} – choose bytes before that, or from there on")


def _named_field(kind: FrameKind, texts: Sequence[bytes], naming: FieldNaming) -> GuessedField:
    """Return the field of a name. Raises NamingError if the bytes have no values of its type."""
    where = _where(naming)
    is_copy = _covers_copies(kind, naming.offset, naming.end) and naming.type != "bits"
    own = GuessedField(
        naming.name, naming.offset, naming.size, "copy" if is_copy else "named", _about(naming, texts),
        Evidence(len(texts), len(texts)), wire=naming.type, order=naming.order,
    )  # fmt: skip
    _check_type(own, texts, where)
    if naming.type == "decimal":
        keys = decimal_keys([text[naming.offset : naming.end] for text in texts])
        if keys is None:
            raise NamingError(f"{where}: these numbers have different forms – name them as text")
        own = replace(own, keys=keys)
    return own


def _kept(field: GuessedField) -> str:
    """Return the description of a field that cannot be renamed; '' for other fields."""
    if field.wire:
        return ""
    if field.name == "mark" and field.is_mark:
        return "the mark before the check"
    if field.is_mark and field.name != "form":  # a form is a constant that the two sides never share, perhaps by chance
        return "what tells the kinds of frames apart"
    if field.name in ("start", "end"):
        return f"the mark with which frames {field.name}"
    return KEPT_KINDS.get(field.kind, "")


def _where(naming: FieldNaming) -> str:
    if not naming.size:
        return f"the bytes from {naming.offset} on"
    last = naming.end - 1
    return f"byte {last}" if naming.size == 1 else f"bytes {naming.offset} to {last}"


def _touches(field: GuessedField, naming: FieldNaming, kind: FrameKind) -> bool:
    if field.offset < 0:
        fixed = {len(frame.data) for frame in kind.frames}
        at = min(fixed) + field.offset
        return len(fixed) == 1 and bool(naming.size) and naming.offset < at + field.size and at < naming.end
    if not naming.size:
        return not field.size and field.offset == naming.offset
    return naming.offset < field.offset + (field.size or 1 << 30) and field.offset < naming.end


def _check_name(kind: FrameKind, naming: FieldNaming, others: Sequence[GuessedField]) -> None:
    name = naming.name
    if _NAME.fullmatch(name) is None or len(name) > LONGEST_NAME:
        raise NamingError(
            f"'{name[:LONGEST_NAME]}' is no name – write a letter, then letters, digits and _, such as level"
        )
    if name in WORDS:
        raise NamingError(f"'{name}' has a meaning of its own in expressions – give another name")
    new = set(value_names(name, naming.type, naming.size))
    taken = {one for field in others for one in value_names(field.name, field.wire, field.size)}
    if new & taken:
        raise NamingError(f"'{kind.name}' has a field '{min(new & taken)}' already – give another name")


def value_names(name: str, type_: str, size: int) -> list[str]:
    """Return the names of the values of a field; of bits one for each bit, lowest first."""
    return bit_names(name, size) if type_ == "bits" else [name]


def _check_type(field: GuessedField, texts: Sequence[bytes], where: str) -> None:
    """Raise NamingError if the bytes of a frame are invalid for the type of the field."""
    if field.wire not in TYPES:
        raise NamingError(f"there is no type '{field.wire[:20]}' – choose one of {', '.join(TYPES)}")
    if not TYPES[field.wire].takes(field.size) or (not field.size and field.wire not in ("text", "bytes")):
        size = plural(field.size, "byte") if field.size else "bytes of varying size"
        raise NamingError(f"{where}: {size} can be no {field.wire} – choose another type, or other bytes")
    if field.order not in orders_of(field.wire, field.size):
        raise NamingError(f"a {field.wire} of {plural(field.size, 'byte')} has no order '{field.order[:20]}'")
    if not field.size or field.wire in ("bytes", "bits"):
        return
    parts = [text[field.offset : field.offset + field.size] for text in texts]
    if field.wire == "text":
        wrong = sum(not PRINTABLE.issuperset(part) for part in parts)
    else:
        wrong = sum(number_of(field.wire, field.order, part) is None for part in parts)
    if wrong:
        raise NamingError(
            f"{where}: {wrong} of {plural(len(parts), 'frame')} have something else there than a {field.wire}"
        )


def _about(naming: FieldNaming, texts: Sequence[bytes]) -> str:
    """Describe the values of a name."""
    if not naming.size or naming.type not in TYPES or not TYPES[naming.type].takes(naming.size):
        return ""
    parts = {text[naming.offset : naming.end] for text in texts}
    if naming.order not in orders_of(naming.type, naming.size):
        return ""
    numbers = [number_of(naming.type, naming.order, part) for part in parts]
    known = [number for number in numbers if number is not None]
    if TYPES[naming.type].form == "text":
        low, high = shown_text(min(parts)), shown_text(max(parts))
    elif not known or naming.type == "bits":
        return plural(len(parts), "value")
    else:
        low, high = f"{min(known):.6g}", f"{max(known):.6g}"
    return f"always {low}" if len(parts) == 1 else f"{len(parts)} values, {low} to {high}"


def _left(
    field: GuessedField, naming: FieldNaming, texts: Sequence[bytes], taken: set[str]
) -> Iterator[GuessedField]:  # fmt: skip
    """Yield the part of a field before the named bytes."""
    if field.offset < naming.offset:
        yield _piece(field, field.offset, naming.offset - field.offset, texts, taken, field.name)


def _right(
    field: GuessedField, naming: FieldNaming, texts: Sequence[bytes], taken: set[str]
) -> Iterator[GuessedField]:  # fmt: skip
    """Yield the part of a field after the named bytes."""
    if naming.size and not field.size:
        own = [int(number) for number in re.findall(r"\d+", field.about)[:2]]
        less = naming.end - field.offset
        about = f"{own[0] - less} to {own[1] - less} bytes" if len(own) == 2 else ""
        yield replace(field, offset=naming.end, about=about)
    elif naming.size and field.offset + field.size > naming.end:
        name = field.name if field.offset >= naming.offset else ""
        yield _piece(field, naming.end, field.offset + field.size - naming.end, texts, taken, name)


def _piece(field: GuessedField, at: int, size: int, texts: Sequence[bytes], taken: set[str], name: str) -> GuessedField:
    """Return a part of a field, with a description of its values. `name`: the name it keeps, or '' for a new name."""
    parts = {text[at : at + size] for text in texts}
    kind = field.kind if field.kind in ("constant", "text") else "unknown"
    if field.wire:
        kind = "unknown"
    if not name or name == "data" or (kind == "unknown" and field.kind != "unknown"):
        stem = kind
        name = next(one for number in range(1, 10_000) if (one := f"{stem}_{number}") not in taken)
        taken.add(name)
    shown = shown_text if kind == "text" else _hex
    low, high = shown(min(parts)), shown(max(parts))
    about = f"{len(parts)} values, {low} to {high}" if len(parts) > 1 else f"always {low}"
    if kind == "constant":
        about = low
    return GuessedField(name, at, size, kind, about, field.evidence)


def _hex(data: bytes) -> str:
    return data.hex(" ").upper() if len(data) <= 16 else data[:16].hex(" ").upper() + " …"


def _echoing(before: Sequence[FrameKind], kinds: dict[str, FrameKind]) -> list[FrameKind]:
    """Return the kinds with copies kept only where all requests still have a field of the same name, offset and
    form.
    """
    asked = [kind for kind in before if kind.side == "client"]

    def is_still_there(field: GuessedField) -> bool:
        form = _form(field)
        return all(
            form in map(_form, kinds[kind.name].fields)
            for kind in asked
            if _covers_copies(kind, field.offset, field.offset + field.size)
        )

    def settled(field: GuessedField) -> GuessedField:
        if field.kind != "copy" or is_still_there(field):
            return field
        return replace(field, kind="named" if field.wire else "unknown", about="")

    return [
        replace(kind, fields=tuple(map(settled, kind.fields))) if kind.side == "server" else kind
        for kind in kinds.values()
    ]


def _form(field: GuessedField) -> tuple[str, int, int, str, str]:
    return field.name, field.offset, field.size, field.wire, field.order
