"""Bytes captured on an unknown line, and the statements about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from framekit.definition.model.checks import CheckMethod
from framekit.extras.guess.times import GuessedTimes

Direction = Literal["in", "out", ""]
"""Direction of the bytes; '' if one wire carries both directions or the direction is unknown."""
Order = Literal["big", "little"]
Form = Literal["binary", "hex", "decimal"]
"""Form of a number on the wire: bytes, two hex digits (ASCII) for each byte, or decimal digits."""


class HeardBytes(NamedTuple):
    """Bytes that arrived together."""

    time: int | None
    """Time of the first byte (ns); None if unknown."""
    direction: Direction
    data: bytes


class HeardFrame(NamedTuple):
    """A frame as on the line, with all bytes of its framing."""

    time: int | None
    direction: Direction
    data: bytes


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence: a statement holds in `holds` of `of` cases."""

    holds: int
    of: int
    chance: float = 0.0
    """Improbability of this result by chance, in bits; greater is more certain."""

    def __str__(self) -> str:
        return f"{self.holds} of {self.of}"


@dataclass(frozen=True, slots=True)
class Statement:
    """A statement about a line, in words."""

    text: str
    evidence: Evidence
    is_sure: bool
    """Whether an error in this statement would be a defect of the program."""
    against: str = ""
    """Description of the observation that would contradict the statement."""


@dataclass(frozen=True, slots=True)
class LengthField:
    """A length field: a number of `width` bytes at `offset`."""

    offset: int
    width: int
    order: Order
    plus: int
    """Bytes of the frame in addition to the counted bytes."""
    unit: int = 1
    """Bytes for each count (2 for words)."""
    form: Form = "binary"
    """`hex`: the number takes 2 × `width` characters; `decimal`: it has `width` digits."""

    @property
    def size(self) -> int:
        """Return the size on the wire (bytes)."""
        return self.width * (2 if self.form == "hex" else 1)

    @property
    def end(self) -> int:
        """Return the offset of the first byte after the field."""
        return self.offset + self.size


@dataclass(frozen=True, slots=True)
class Stuffing:
    """Stuffing: the encoding of bytes that would otherwise end a frame, as in `wrap` of the language."""

    kind: Literal["escape_xor", "escape_codes", "doubled", "cobs", "hex"]
    """`escape_xor`: escape byte, then the byte xor `xor`; `escape_codes`: escape byte, then a code; `doubled`: the
    escape byte is doubled, and a frame begins and ends with the escape byte and another byte; `cobs`; `hex`: two digits
    for each byte.
    """
    escape: int = 0
    xor: int = 0
    codes: tuple[tuple[int, int], ...] = ()
    """Pairs (code, byte) of `escape_codes`."""


@dataclass(frozen=True, slots=True)
class Framing:
    """Framing: the rule by which frames begin and end."""

    kind: Literal["pauses", "marks", "length", "fixed"]
    """`pauses`: silence around frames, or the pieces as captured; `marks`: a start mark, an end mark, or both;
    `length`: a length field; `fixed`: constant size.
    """
    start: bytes = b""
    """Bytes that begin every frame, for every kind."""
    end: bytes = b""
    """Bytes that end every frame, for every kind."""
    length: LengthField | None = None
    stuffing: Stuffing | None = None
    fixed: int = 0
    """Size of every frame of kind `fixed` (bytes)."""
    evidence: Evidence = Evidence(0, 0)
    behind: int = 0
    """Number of bytes after the end mark, such as a check code outside of the marks."""

    @property
    def plain_end(self) -> bytes:
        """Return the end mark of a frame without its stuffing: without the escape byte if a code follows the mark."""
        return self.end[1:] if self.behind else self.end


@dataclass(frozen=True, slots=True)
class CheckPlace:
    """Place of a check code in a frame without stuffing, and the range it covers."""

    size: int
    """Bytes of the code; of form `hex`, characters."""
    order: Order = "big"
    form: Form = "binary"
    tail: int = 0
    """Bytes between the code and the end of the frame, unless `at` is given."""
    at: int | None = None
    """Offset of the code, if it is in the head of the frame."""
    start: int = 0
    """First covered byte: offset in the frame, or, if `at` is given, distance from the end of the code."""
    stop: int = 0
    """Number of uncovered bytes before the code, or, if `at` is given, before the end of the frame."""
    counted: Form = "binary"
    """`hex` if the check covers the bytes that the hex digits represent."""

    @property
    def behind(self) -> int:
        """Return the number of uncovered bytes at the end of the frame; 0 if the code is in the head."""
        return 0 if self.at is not None else self.stop + self.size + self.tail


@dataclass(frozen=True, slots=True)
class CheckGuess:
    """A check that fits the frames."""

    place: CheckPlace
    method: CheckMethod
    """The method, possibly with parameters that no catalogued method has."""
    name: str
    """Name of the catalogued method, or ''."""
    evidence: Evidence
    plus: int = 0
    """Value added (sums) or combined by exclusive or (other methods) at the end, if no catalogued method does so."""
    others: tuple[str, ...] = ()
    """Equivalent descriptions that the frames do not exclude."""
    is_sure: bool = True
    """False if frames of other sizes may show another begin or end of the covered range."""


FieldKind = Literal[
    "constant", "counter", "address", "function", "length", "count", "copy", "check", "text", "value", "unknown",
    "named",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class GuessedField:
    """A field of a frame."""

    name: str
    offset: int
    size: int
    kind: FieldKind
    about: str = ""
    """Description, in words."""
    evidence: Evidence = Evidence(0, 0)
    is_mark: bool = False
    """Whether the field is constant and identifies frames of this kind."""
    plus: int = 0
    """For a count: bytes of the frame in addition to `unit` times the count."""
    unit: int = 1
    wire: str = ""
    """Type that a user chose together with the name; '' if none."""
    order: str = "big"
    keys: str = ""
    """Further keys of the type in the definition."""


@dataclass(frozen=True, slots=True)
class FrameKind:
    """Frames of one form: one direction, and the same fields."""

    name: str
    direction: Direction
    fields: tuple[GuessedField, ...]
    frames: tuple[HeardFrame, ...]
    side: str = ""
    """client or server; '' if unknown."""
    check: CheckGuess | None = None
    """Their check, if any."""


@dataclass(slots=True)
class Guess:
    """Statements about a line, with the data they were derived from."""

    chunks: Sequence[HeardBytes]
    framing: Framing | None = None
    frames: list[HeardFrame] = field(default_factory=list)
    noise: int = 0
    check: CheckGuess | None = None
    kinds: list[FrameKind] = field(default_factory=list)
    times: GuessedTimes = field(default_factory=GuessedTimes)
    statements: list[Statement] = field(default_factory=list)
