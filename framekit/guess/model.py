"""What was heard on an unknown line, and what is said of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from framekit.definition.model.checks import CheckMethod
from framekit.guess.times import GuessedTimes

Direction = Literal["in", "out", ""]
"""Which way bytes went; '' where one wire has both, or nothing tells it."""
Order = Literal["big", "little"]
Form = Literal["binary", "hex", "decimal"]
"""How a number stands on the wire: as bytes, as two hex digits (ASCII) for each byte, or as decimal digits."""


class HeardBytes(NamedTuple):
    """Bytes that came together: the time of the first (ns; None where nothing tells it), the way, and the bytes."""

    time: int | None
    direction: Direction
    data: bytes


class HeardFrame(NamedTuple):
    """A frame as it stood on the line, with everything around it that marks it."""

    time: int | None
    direction: Direction
    data: bytes


@dataclass(frozen=True, slots=True)
class Evidence:
    """So many of so many hold; `chance`: as how many bits of luck that would count (greater is surer)."""

    holds: int
    of: int
    chance: float = 0.0

    def __str__(self) -> str:
        return f"{self.holds} of {self.of}"


@dataclass(frozen=True, slots=True)
class Statement:
    """Something that is said of a line, in words. `is_sure`: it would be a defect of this program if it were wrong.

    `against`: what would contradict it.
    """

    text: str
    evidence: Evidence
    is_sure: bool
    against: str = ""


@dataclass(frozen=True, slots=True)
class LengthField:
    """A number of `width` bytes at `offset` from the frame's start; a frame has that value plus `plus` bytes.

    `unit`: bytes for each count (2 for words). `form` hex: the number takes 2 × `width` characters; decimal: it has
    `width` digits.
    """

    offset: int
    width: int
    order: Order
    plus: int
    unit: int = 1
    form: Form = "binary"

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return self.width * (2 if self.form == "hex" else 1)

    @property
    def end(self) -> int:
        """The first byte behind it."""
        return self.offset + self.size


@dataclass(frozen=True, slots=True)
class Stuffing:
    """How bytes that would end a frame are written inside of it, in the words of the language's `wrap`.

    `kind`: `escape_xor` (the escape byte, then the byte xor `xor`), `escape_codes` (the escape byte, then a code:
    `codes`, code → byte), `doubled` (the escape byte stands twice; a frame begins and ends with it and another byte),
    `cobs`, `hex` (two digits for each byte).
    """

    kind: Literal["escape_xor", "escape_codes", "doubled", "cobs", "hex"]
    escape: int = 0
    xor: int = 0
    codes: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, slots=True)
class Framing:
    """Where frames begin and end.

    `kind`: `pauses` (silence around frames, or the pieces as they came), `marks` (a start and an end, or one of them),
    `length` (a number says it), `fixed` (all have `fixed` bytes). `start` and `end`: bytes that begin and end every
    frame, for every kind. `behind`: bytes that follow the end mark, as a code does that stands outside of the marks.
    """

    kind: Literal["pauses", "marks", "length", "fixed"]
    start: bytes = b""
    end: bytes = b""
    length: LengthField | None = None
    stuffing: Stuffing | None = None
    fixed: int = 0
    evidence: Evidence = Evidence(0, 0)
    behind: int = 0

    @property
    def plain_end(self) -> bytes:
        """Return the end mark of a frame without its stuffing: where a code follows it, without the escape byte."""
        return self.end[1:] if self.behind else self.end


@dataclass(frozen=True, slots=True)
class CheckPlace:
    """Where a code stands in a frame without its stuffing, and what it counts.

    It takes `size` bytes (a form of hex: that many characters). It ends `tail` bytes before the frame's end, or, where
    `at` is given, begins there. It counts from the byte `start` to `stop` bytes before the code, or, where `at` is
    given, from there to `stop` bytes before the end. `counted` hex: the bytes that the characters in between stand for
    are counted.
    """

    size: int
    order: Order = "big"
    form: Form = "binary"
    tail: int = 0
    at: int | None = None
    start: int = 0
    stop: int = 0
    counted: Form = "binary"

    @property
    def behind(self) -> int:
        """Bytes at the frame's end that do not count; 0 where the code stands in the head."""
        return 0 if self.at is not None else self.stop + self.size + self.tail


@dataclass(frozen=True, slots=True)
class CheckGuess:
    """A check that fits: `method` may have parameters of its own, `name` is that of a ready one, or ''.

    `plus`: what is added (sums) or combined by exclusive or (all others) at the end, where no ready method does so.
    `others`: how else the same could be said, as far as the frames tell. Not sure: frames of other sizes may show that
    it begins or ends with something else.
    """

    place: CheckPlace
    method: CheckMethod
    name: str
    evidence: Evidence
    plus: int = 0
    others: tuple[str, ...] = ()
    is_sure: bool = True


FieldKind = Literal[
    "constant", "counter", "address", "function", "length", "count", "copy", "check", "text", "value", "unknown",
    "named",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class GuessedField:
    """Bytes of a frame that belong together; `about`: what is known of them, in words.

    `is_mark`: constant bytes by which frames of this kind are known. `plus` and `unit` of a count: the frame has so
    many bytes more than so many times that. `wire`: the type that people gave it together with its name, '' for none;
    `keys`: what else the definition says of that type.
    """

    name: str
    offset: int
    size: int
    kind: FieldKind
    about: str = ""
    evidence: Evidence = Evidence(0, 0)
    is_mark: bool = False
    plus: int = 0
    unit: int = 1
    wire: str = ""
    order: str = "big"
    keys: str = ""


@dataclass(frozen=True, slots=True)
class FrameKind:
    """Frames of one form: they go one way, and have the same fields. `side`: client or server, '' if not known.
    `check`: theirs, if they have one."""

    name: str
    direction: Direction
    fields: tuple[GuessedField, ...]
    frames: tuple[HeardFrame, ...]
    side: str = ""
    check: CheckGuess | None = None


@dataclass(slots=True)
class Guess:
    """What is said of a line."""

    chunks: Sequence[HeardBytes]
    framing: Framing | None = None
    frames: list[HeardFrame] = field(default_factory=list)
    noise: int = 0
    check: CheckGuess | None = None
    kinds: list[FrameKind] = field(default_factory=list)
    times: GuessedTimes = field(default_factory=GuessedTimes)
    statements: list[Statement] = field(default_factory=list)
