"""A text of StreamDevice, as `out` sends it or `in` takes it, as the body of a frame.

A converter is converted exactly or not at all: a built frame has the bytes that StreamDevice sends, and a read frame
the value that StreamDevice reads. A frame may accept less than StreamDevice does (such as numbers with a leading plus
sign or spaces); that is noted. A converter without an equivalent segment raises CannotSayError. Source: StreamDevice 2,
"Format Converters", and the output of printf of C.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

from framekit.definition.decimals import DecimalForm
from framekit.definition.problems import CannotSayError, Position
from framekit.definition.sources import shipped_folder
from framekit.extras.streamdevice.stream_file import (
    ESCAPED,
    AnyByte,
    Converter,
    Element,
    Literal,
    StreamArgument,
    StreamSettings,
)

Segment = dict[str, Any]

MOST_SEGMENTS = 3_000
MOST_BYTES = 50_000
"""Largest size of a text (bytes); longer texts are refused, since frames have a size limit too."""
MOST_CHECKS = 8
MOST_WORDS = 2_000
"""Largest number of characters of all words of an enumeration together."""

BY_HAND = "write its frames by hand"


def quoted(text: str) -> str:
    """Return a text as a literal of expressions."""
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


_SPACES = " \t\n\v\f\r"
_NUL = quoted("\0")
_DIGITS = frozenset(b"0123456789")
_HEX = frozenset(b"0123456789abcdefABCDEF")

NUMBERS = "numbers"
FIXED = "fixed"
EXTRA = "extra"
SILENCE = "silence"
HEARD: dict[str, tuple[str, str]] = {
    NUMBERS: (
        "numbers are taken as -12 or 1.5; with a plus sign, an exponent, or spaces or zeros in front they are bad",
        "say by sign:, digits:, pad: or exponent: how the device writes them",
    ),
    FIXED: (
        "a width is the exact number of characters: shorter and longer texts are refused",
        "write end: in place of size: if the device's width varies",
    ),
    EXTRA: (
        "nothing says where this ends and ExtraInput begins: with extra input the reply is bad",
        "write behind it what the device sends there",
    ),
    SILENCE: (
        "only silence ends what is read: bytes behind it are noise here, a mismatch there",
        "set InTerminator, or MaxInput to its size",
    ),
}
"""Forms that StreamDevice accepts and frames do not, with remedies."""


class StreamValue(NamedTuple):
    """A value of a frame."""

    field: str
    """Its name in the frame."""
    kind: str
    """number, decimal or text."""
    wanted: str
    """Its name in the file."""
    is_given: bool = True
    """Whether it is an argument or result of the service; other values are skipped."""
    start: int | str = 0
    """Expression for a valid value."""


@dataclass(slots=True)
class StreamBody:
    """Segments of a frame, its values, and the numbers of its arguments."""

    segments: list[Segment] = field(default_factory=list)
    values: list[StreamValue] = field(default_factory=list)
    arguments: list[int] = field(default_factory=list)
    checks: dict[str, Segment] = field(default_factory=dict)
    """Own check codes by name."""
    before: bytes = b""
    """Constant bytes at its beginning."""
    varies: bool = False
    """Whether it has a variable part."""
    narrower: list[tuple[str, Position]] = field(default_factory=list)


def body_of(elements: Sequence[Element], settings: StreamSettings, reads: bool, at: Position) -> StreamBody:
    """Return the body of the text that `out` sends, or `in` takes (`reads`). Raises CannotSayError."""
    return _BodyMaker(elements, settings, reads, at).body


def constants(data: bytes) -> Iterator[Segment]:
    """Yield runs of printable bytes as text, others in hex."""
    for run in re.findall(rb"[ -~]+|[^ -~]+", data):
        printable = 0x20 <= run[0] < 0x7F
        yield {"text": run.decode("ascii")} if printable else {"const": run.hex(" ").upper()}


class _BodyMaker:
    def __init__(self, elements: Sequence[Element], settings: StreamSettings, reads: bool, at: Position) -> None:
        self.body = StreamBody()
        self._reads = reads
        self._ending = (settings.in_terminator if reads else settings.out_terminator) or b""
        self._ignores_extra = reads and settings.ignores_extra
        self._elements = list(_joined(elements))
        self._least = 0
        self._is_exact = True  # everything before has _least bytes
        self._begins: set[int] = set()
        self._starts = {one.width for one in self._elements if isinstance(one, Converter) and one.kind == "<"}
        self._numbers: dict[str, int] = {}
        self._place = 0
        self._refuse_what_cannot_be(settings, at)
        for place, element in enumerate(self._elements):
            self._place = place
            self._add(element)
        if self._ignores_extra:
            self._pass_over_the_rest(at)
        if reads and settings.most_input and self._least > settings.most_input:
            what = f"MaxInput {settings.most_input} ends it before its {self._least} bytes"
            raise CannotSayError(at, what, "correct one of them")
        if reads and settings.in_terminator == b"" and self._least != settings.most_input:
            self._narrower(SILENCE, at)
        self._constant(self._ending)
        if not self.body.segments:
            raise CannotSayError(at, "there are no bytes in it", "write what is sent, or the terminator")
        if len(self.body.segments) > MOST_SEGMENTS:
            raise CannotSayError(at, f"it has more than {MOST_SEGMENTS} parts", BY_HAND)

    def _refuse_what_cannot_be(self, settings: StreamSettings, at: Position) -> None:
        size = 0
        for element in self._elements:
            if isinstance(element, Literal):
                size += len(element.data)
                if self._reads and self._ending and self._ending in element.data:
                    raise CannotSayError(element.at, "the terminator stands in it, so it never comes", "correct it")
        if len(self._starts) > MOST_CHECKS:
            raise CannotSayError(at, f"it has check codes from more than {MOST_CHECKS} places on", BY_HAND)
        if size > MOST_BYTES:
            raise CannotSayError(at, f"it has more than {MOST_BYTES} bytes", BY_HAND)
        if self._reads and settings.most_input and self._ending:
            what = f"MaxInput {settings.most_input} beside a terminator: either ends what is read"
            raise CannotSayError(at, what, "remove one of them")

    # ---- where things end ---------------------------------------------------------------------------------

    @property
    def _is_last(self) -> bool:
        return self._place == len(self._elements) - 1

    def _follows(self) -> bytes:
        """Return the constant directly after the element: the following literal, else the terminator."""
        if self._is_last:
            return self._ending
        follows = self._elements[self._place + 1]
        return follows.data if isinstance(follows, Literal) else b""

    def _ends(self, at: Position, what: str) -> list[str]:
        """Return the ends of an element: the constant after it, and the terminator, which ends reading in any case."""
        mark = self._follows()
        if not mark:
            raise CannotSayError(at, f"{what} with nothing behind it that ends it", BY_HAND)
        ends = [mark]
        if not self._is_last and self._ending and mark not in self._ending and self._ending not in mark:
            ends.append(self._ending)
        return [one.hex(" ").upper() for one in ends]

    def _number_ends(self, one: Converter, never: frozenset[int]) -> list[str]:
        ends = self._ends(one.at, f"a number ({one})")
        if self._follows()[0] in never:
            what = f"a number ({one}) before {_shown(self._follows())}, which could belong to it"
            raise CannotSayError(one.at, what, BY_HAND)
        return ends

    # ---- parts of the body --------------------------------------------------------------------------------

    def _constant(self, data: bytes) -> None:
        """Add a constant, split where a check code begins."""
        cuts = sorted(one - self._least for one in self._starts if 0 < one - self._least < len(data))
        for begin, end in pairwise((0, *(cuts if self._is_exact else ()), len(data))):
            for segment in constants(data[begin:end]):
                self.body.segments.append(segment)
            self._mark_begin()
            self._least += end - begin
        if not self.body.varies:
            self.body.before += data

    def _mark_begin(self) -> None:
        """Note the begin of a segment."""
        if self._is_exact:
            self._begins.add(self._least)

    def _unused(self, word: str) -> str:
        self._numbers[word] = number = self._numbers.get(word, 0) + 1
        return word if number == 1 else f"{word}_{number}"

    def _field(self, one: Converter, kind: str, start: int | str = 0, **keys: Any) -> str:
        name = self._value(one, kind, start)
        self.body.segments.append({"field": name, **keys})
        return name

    def _value(self, one: Converter, kind: str, start: int | str) -> str:
        name = self._unused("value")
        self.body.values.append(StreamValue(name, kind, one.redirect, "*" not in one.flags, start))
        return name

    def _require(self, condition: str) -> None:
        self.body.segments.append({"require": condition})

    def _narrower(self, kind: str, at: Position) -> None:
        self.body.narrower.append((kind, at))

    def _word(
        self,
        one: Converter,
        value: Callable[[str], str],
        build: Callable[[str], str],
        start: int | str = 0,
        **keys: Any,
    ) -> str:
        """Add a text and the number computed from it; return the name of the text.

        `value`: expression for the number from the text, when reading; `build`: for the text from the number.
        """
        word, name = self._unused("word"), self._value(one, "number", start)
        self.body.segments.append({"field": word, "type": "ascii", **keys, "build": build(name)})
        self.body.segments.append({"value": name, "read": value(word)})
        return word

    def _add(self, element: Element) -> None:
        if isinstance(element, Literal):
            self._constant(element.data)
            return
        self.body.varies = True
        self._mark_begin()
        before = len(self.body.segments)
        if isinstance(element, AnyByte):
            self.body.segments.append({"skip": 1})
            self._least += 1
        elif isinstance(element, StreamArgument):
            self._argument(element)
        else:
            self._converter(element)
        self._is_exact &= not any("end" in segment for segment in self.body.segments[before:])

    def _argument(self, one: StreamArgument) -> None:
        ends = self._ends(one.at, f"the argument \\${one.number}")
        name = f"arg_{one.number}"
        keys = {"type": "ascii", "end": ends}
        if one.number in self.body.arguments:
            self.body.segments.append({"field": self._unused("again"), **keys, "is": name})
        else:
            self.body.arguments.append(one.number)
            self.body.segments.append({"field": name, **keys})

    def _pass_over_the_rest(self, at: Position) -> None:
        """Skip the rest of the input (ExtraInput = Ignore). Raises CannotSayError."""
        last = self._elements[-1] if self._elements else None
        if not self._ending:
            raise CannotSayError(at, "ExtraInput without a terminator: nothing ends what is passed over", BY_HAND)
        if isinstance(last, (Converter, StreamArgument)) and not {"size", "check"} & self.body.segments[-1].keys():
            self._narrower(EXTRA, last.at)
            return
        self.body.varies = True
        self.body.values.append(StreamValue("extra", "text", "", False, "''"))
        self.body.segments.append({"field": "extra", "type": "ascii", "end": [self._ending.hex(" ").upper()]})

    # ---- converters ---------------------------------------------------------------------------------------

    def _converter(self, one: Converter) -> None:
        if self._reads and one.precision is not None and one.kind not in "<D":
            raise CannotSayError(one.at, f"{one}: in takes no precision", "remove it")
        for flag, why in (("?", "takes what does not fit as 0"), ("=", "compares with a value of a record")):
            if flag in one.flags:
                raise CannotSayError(one.at, f"{one}: the flag {flag} {why}", BY_HAND)
        if not self._reads and ("*" in one.flags or "!" in one.flags):
            raise CannotSayError(one.at, f"{one}: the flags * and ! are for in", "correct it")
        if one.kind in "diu":
            self._whole(one)
        elif one.kind in "feEgG":
            self._decimal(one)
        elif one.kind in "xXo":
            self._digits(one)
        elif one.kind == "s":
            self._text(one)
        elif one.kind == "c":
            self._characters(one)
        elif one.kind == "[":
            self._of_a_set(one)
        elif one.kind == "{":
            self._enumeration(one)
        elif one.kind in "rRD":
            self._raw(one)
        elif one.kind == "<":
            self._check(one)
        else:
            raise CannotSayError(one.at, f"{one}: no segment is like it", BY_HAND)

    def _sized(self, one: Converter) -> Segment:
        """Return the keys of a number in decimal digits with a width, and those of its sign."""
        keys: Segment = {}
        if one.kind != "u" and "+" in one.flags:
            keys["sign"] = "always"
        elif one.kind != "u" and " " in one.flags and not self._reads:
            keys["sign"] = "space"
        elif one.kind == "u":
            keys["sign"] = "never"
        if not one.width:
            return keys
        if "-" in one.flags and not self._reads:
            raise CannotSayError(one.at, f"{one}: spaces stand behind the number", BY_HAND)
        if one.width > 200:
            raise CannotSayError(one.at, f"{one}: it is wider than 200 characters", BY_HAND)
        self._narrower(FIXED, one.at)
        self._least += one.width
        zeros = "0" in one.flags and not (one.kind == "i" and self._reads)  # which reads 010 as octal
        return {"size": one.width, **({} if zeros else {"pad": "20"}), **keys}

    def _whole(self, one: Converter) -> None:
        keys = self._sized(one)
        if one.precision is not None:
            if one.width or not 1 <= one.precision <= 200:
                raise CannotSayError(one.at, f"{one}: this width and precision", BY_HAND)
            keys["digits"] = one.precision
        if "size" not in keys:
            never = _DIGITS | frozenset(b"" if one.kind == "u" else b"+-")
            never |= frozenset(b"xX" if one.kind == "i" else b"") | frozenset(
                b" " if keys.get("sign") == "space" else b""
            )
            keys["end"] = self._number_ends(one, never)
            self._least += 1
        if self._reads:
            self._narrower(NUMBERS, one.at)
        self._written(one, "number", keys)

    def _decimal(self, one: Converter) -> None:
        if not self._reads and one.kind in "egG":
            why = "writes a small e" if one.kind == "e" else "chooses how it is written by the size of the number"
            raise CannotSayError(one.at, f"{one} {why}", "write %f or %E with a precision")
        keys = self._sized(one)
        if self._reads:
            keys["decimals"] = "any"
            self._narrower(NUMBERS, one.at)
        else:
            keys["decimals"] = 6 if one.precision is None else one.precision
            if keys["decimals"] > 100:
                raise CannotSayError(one.at, f"{one}: more than 100 decimals", BY_HAND)
            if one.kind == "E":
                keys["exponent"] = 2
            if "#" in one.flags and not keys["decimals"]:
                keys["point"] = "always"
        if "size" not in keys:
            never = _DIGITS | frozenset(b"+-.eExX") | frozenset(b" " if keys.get("sign") == "space" else b"")
            keys["end"] = self._number_ends(one, never)
            self._least += 1
        self._written(one, "decimal", keys)

    def _written(self, one: Converter, kind: str, keys: Segment) -> None:
        form = DecimalForm(
            None if keys.get("decimals") == "any" else keys.get("decimals", 0), keys.get("sign", "minus"),
            keys.get("digits", 1), exponent=keys.get("exponent", 0), point="point" in keys,
        )  # fmt: skip
        if keys.get("size", form.least) < form.least:
            what = f"{one}: the narrowest such number has {form.least} characters"
            raise CannotSayError(one.at, what, "write that width, or none")
        self._field(one, kind, type="decimal", **keys)

    def _digits(self, one: Converter) -> None:
        """Add hex or octal digits. StreamDevice cuts hex numbers to their width, so their size is constant."""
        base, size = (8 if one.kind == "o" else 16), one.width
        keys: Segment = {"type": "oct" if base == 8 else "hex"}
        if one.kind == "x":
            keys["case"] = "lower"
        if not self._reads:
            if "#" in one.flags:
                raise CannotSayError(one.at, f"{one}: 0x or 0 stands before the digits, but not before 0", BY_HAND)
            if one.precision is not None:
                size = 0 if one.width else one.precision
            elif size > 1 and ("0" not in one.flags or "-" in one.flags):
                raise CannotSayError(one.at, f"{one}: spaces stand in place of zeros", f"write %0{size}{one.kind}")
            elif base == 8 and "0" not in one.flags:
                size = 0
            if not size:
                todo = f"write a width with zeros, %04{one.kind}"
                raise CannotSayError(one.at, f"{one}: the number has as many digits as it needs", todo)
        if size > 32:
            raise CannotSayError(one.at, f"{one}: it has more than 32 digits", BY_HAND)
        if size:
            self._narrower(FIXED, one.at)
            self._least += size
            self._field(one, "number", **keys, size=size)
            return
        ends = self._number_ends(one, _HEX | frozenset(b"xX+-"))
        word = self._word(
            one, lambda word: f"number({word}, {base})", lambda name: f"digits({name}, 8, {base})", end=ends
        )
        self._require(f"number({word}, {base}) == {self.body.values[-1].field}")
        self._least += 1

    def _text(self, one: Converter) -> None:
        if "+" in one.flags:
            raise CannotSayError(one.at, f"{one}: a text has no sign", "correct it")
        if self._reads:
            self._text_read(one)
        else:
            self._text_sent(one)

    def _text_sent(self, one: Converter) -> None:
        if one.precision is not None or (one.width and ("-" not in one.flags or "0" in one.flags)):
            why = "the text is cut" if one.precision is not None else "fill stands before the text"
            raise CannotSayError(one.at, f"{one}: {why}", BY_HAND)
        if one.width:
            self._narrower(FIXED, one.at)
            self._least += one.width
            self._field(one, "text", "''", type="ascii", size=_size(one), pad="20")
        else:
            self._field(one, "text", "''", type="ascii", end=self._ends(one.at, f"a text ({one})"))

    def _text_read(self, one: Converter) -> None:
        mark = "" if self._is_last else chr((self._follows() or b"\0")[0])
        if mark and ("#" in one.flags or mark not in _SPACES):
            if not one.width or "#" in one.flags:
                what = f"{one} goes on to {'the end' if '#' in one.flags else 'a space'}, over what stands behind it"
                raise CannotSayError(one.at, what, "write %[^…] with the sign that ends the text")
            self._narrower(FIXED, one.at)
            self._least += one.width
            name = self._field(one, "text", quoted("x" * _size(one)), type="ascii", size=one.width)
        else:
            start = "''" if self._is_last else "'x'"
            name = self._field(one, "text", start, type="ascii", end=self._ends(one.at, f"a text ({one})"))
            if one.width:
                self._require(f"len({name}) {'==' if '!' in one.flags else '<='} {one.width}")
            if not self._is_last:
                self._require(f"{name} != ''")
        if "#" not in one.flags:
            self._require(" and ".join(f"{quoted(sign)} not in {name}" for sign in f"{_SPACES}\0"))
        elif " " not in one.flags:
            self._require(f"{_NUL} not in {name} and {name}[0:1] not in [{', '.join(map(quoted, _SPACES))}]")
        else:
            self._require(f"{_NUL} not in {name}")

    def _characters(self, one: Converter) -> None:
        count = one.width or 1
        if set(one.flags) & set("+ 0#") or ("-" in one.flags and not self._reads):
            raise CannotSayError(one.at, f"{one}: %c has no such flag", "remove it")
        if not self._reads:
            if count != 1 or one.precision is not None:
                raise CannotSayError(one.at, f"{one}: out sends one character by its number", "write %c")
            self._least += 1
            self._field(one, "number", type="u8")
        elif self._is_last and count > 1 and "!" not in one.flags and self._ending:
            ends = self._ends(one.at, f"a text ({one})")
            name = self._field(one, "text", "''", type="ascii", end=ends)
            self._require(f"len({name}) <= {count} and {_NUL} not in {name}")
        else:
            self._least += _size(one)
            name = self._field(one, "text", quoted(" " * count), type="ascii", size=count)
            self._require(f"{_NUL} not in {name}")

    def _of_a_set(self, one: Converter) -> None:
        if not self._reads or set(one.flags) & set("-+ 0#"):
            raise CannotSayError(one.at, f"{one}: only in has it, and without flags", "write %s")
        allowed = _members(one)
        mark = b"" if self._is_last else self._follows()
        if mark and mark[0] in allowed:
            what = f"{one} goes on over {_shown(mark)}, which stands behind it"
            raise CannotSayError(one.at, what, "leave the sign that ends the text out of the set")
        name = self._field(one, "text", "''", type="ascii", end=self._ends(one.at, f"a text ({one})"))
        if one.width:
            self._require(f"len({name}) {'==' if '!' in one.flags else '<='} {one.width}")
        refused = frozenset(range(256)) - allowed
        if mark:
            refused -= frozenset(mark[:1] if len(mark) == 1 else b"")
        if len(refused) <= 8:
            if refused:
                self._require(" and ".join(f"{quoted(chr(sign))} not in {name}" for sign in sorted(refused)))
        else:
            self._require(f"only({name}, {quoted(''.join(map(chr, sorted(allowed))))})")

    def _enumeration(self, one: Converter) -> None:
        if set(one.flags) & set("-+ 0"):
            raise CannotSayError(one.at, f"{one}: an enumeration has no such flag", "remove it")
        numbers, words = _choices(one)
        longest = {len(word) for word in words}
        mark = self._follows()
        shared = next((word for word in words if mark and mark.decode("latin-1") in word), None)
        if len(longest) == 1 and words[0]:
            keys: Segment = {"size": len(words[0])}
        elif shared is not None:
            raise CannotSayError(one.at, f"{one}: {_shown(mark)} stands in {shared!r} and behind it", BY_HAND)
        else:
            keys = {"end": self._ends(one.at, f"an enumeration ({one})")}
        if self._reads:
            known: set[str] = set()
            for word in words:
                if any(word[:size] in known for size in longest if size < len(word)):
                    what = f"{one}: {word!r} begins with a word before it, so that it is never found"
                    raise CannotSayError(one.at, what, "write the longer word first")
                known.add(word)
        self._least += min(longest)
        every = f"[{', '.join(map(quoted, words))}]"
        codes = f"[{', '.join(map(str, numbers))}]"
        in_order = numbers == list(range(len(numbers)))

        def value(word: str) -> str:
            return f"find({every}, {word})" if in_order else f"{codes}[find({every}, {word})]"

        def build(name: str) -> str:
            return f"{every}[{name}]" if in_order else f"{every}[find({codes}, {name})]"

        word = self._word(one, value, build, numbers[0], **keys)
        self._require(f"{word} in {every}")
        self._require(f"{self.body.values[-1].field} in {codes}")

    def _raw(self, one: Converter) -> None:
        keys_of = {"R": self._raw_float, "r": self._raw_number}.get(one.kind, self._raw_bcd)
        size, keys = keys_of(one, {"order": "little"} if "#" in one.flags else {})
        self._least += size
        self._field(one, "decimal" if one.kind == "R" else "number", **keys)

    def _raw_float(self, one: Converter, order: Segment) -> tuple[int, Segment]:
        """Return the size and the keys of `%R`."""
        if one.width not in (0, 4, 8):
            raise CannotSayError(one.at, f"{one}: a float has 4 or 8 bytes", "correct it")
        size = one.width or 4
        return size, {"type": f"f{8 * size}", **order}

    def _raw_number(self, one: Converter, order: Segment) -> tuple[int, Segment]:
        """Return the size and the keys of `%r`."""
        size = one.width or 1
        if not self._reads:
            size = 1 if one.precision is None else one.precision
            if one.width > size:
                raise CannotSayError(one.at, f"{one}: it sends less of the number than it has room for", BY_HAND)
        if not 1 <= size <= 8:
            raise CannotSayError(one.at, f"{one}: a number has 1 to 8 bytes", BY_HAND)
        is_signed = "0" not in one.flags
        if size in (1, 2, 4, 8):
            return size, {"type": f"{'i' if is_signed else 'u'}{8 * size}", **(order if size > 1 else {})}
        return size, {"type": "int" if is_signed else "uint", "size": size, **order}

    def _raw_bcd(self, one: Converter, order: Segment) -> tuple[int, Segment]:
        """Return the size and the keys of `%D`."""
        size = one.width or 1
        if not self._reads:
            digits = 16 if one.precision is None else one.precision
            size = digits // 2
            if digits % 2 or one.width > size:
                raise CannotSayError(one.at, f"{one}: it has another number of digits than of places", BY_HAND)
        if "+" in one.flags or not 1 <= size <= 8:
            raise CannotSayError(one.at, f"{one}: no segment is like it", BY_HAND)
        return size, {"type": "bcd", "size": size, **order}

    def _check(self, one: Converter) -> None:
        method, size, own = check_method(one)
        starts = not one.width or one.width in self._begins - {self._least}
        if one.precision or not starts or not self.body.segments:
            raise CannotSayError(one.at, f"{one}: it covers other bytes than those right before it", BY_HAND)
        if own:
            self.body.checks[method] = own
        keys: Segment = {"check": method}
        if "+" in one.flags:
            keys["as"] = "dec"
        elif "0" in one.flags:
            keys["as"] = "hex"
        elif "-" in one.flags:
            keys["as"] = "nibbles"
        if size > 1:
            keys["order"] = "little" if "#" in one.flags and "+" not in one.flags else "big"
        if one.width:
            keys["over"] = f"{one.width}..here"
        self._least += size
        self.body.segments.append(keys)


def _joined(elements: Sequence[Element]) -> Iterator[Element]:
    """Yield the elements with adjacent literals joined."""
    data: list[bytes] = []
    at: Position | None = None
    for element in elements:
        if isinstance(element, Literal):
            at = at or element.at
            data.append(element.data)
            continue
        if at is not None:
            yield Literal(b"".join(data), at)
            data, at = [], None
        yield element
    if at is not None:
        yield Literal(b"".join(data), at)


def _shown(data: bytes) -> str:
    return (
        repr(data.decode("latin-1")) if data.isascii() and data.decode("ascii").isprintable() else data.hex(" ").upper()
    )


def _size(one: Converter) -> int:
    size = one.width or 1
    if size > 4096:
        raise CannotSayError(one.at, f"{one}: it is longer than 4096 characters", BY_HAND)
    return size


def _members(one: Converter) -> frozenset[int]:
    """Return the bytes of a set such as `^,;` or `A-Z_`; a minus sign between two characters is a range."""
    text = one.about.removeprefix("^")
    members: set[int] = set()
    last, place = 0, 0
    while place < len(text):
        code = ord(text[place])
        is_escaped = code >= ESCAPED
        code = code - ESCAPED if is_escaped else code
        if not 0 <= code < 256:
            raise CannotSayError(one.at, f"{one}: an argument stands in it", BY_HAND)
        if not is_escaped and text[place] == "-" and last and place + 1 < len(text):
            place += 1
            code = ord(text[place]) & 0xFF
            members.update(range(min(last, code), max(last, code) + 1))
        members.add(code)
        last, place = (0 if is_escaped else code), place + 1
    every = frozenset(range(1, 256))
    return every - members if one.about.startswith("^") else frozenset(members) & every


def _choices(one: Converter) -> tuple[list[int], list[str]]:
    """Return the numbers and words of an enumeration."""
    numbers: list[int] = []
    words: list[str] = []
    if len(one.about) > MOST_WORDS:
        raise CannotSayError(one.at, f"{one}: its words have more than {MOST_WORDS} characters", BY_HAND)
    number = 0
    for part in one.about.split("|"):
        word, equals, code = part.partition("=") if "#" in one.flags else (part, "", "")
        if equals and code.strip() == "?":
            raise CannotSayError(one.at, f"{one}: the word for all other numbers", BY_HAND)
        if equals:
            match = re.fullmatch(r"\s*(-?)(?:0[xX]([0-9a-fA-F]{1,8})|(0[0-7]{0,10})|([1-9][0-9]{0,8}))", code)
            if match is None:
                raise CannotSayError(one.at, f"{one}: no number stands behind =", "write a number, or escape the sign")
            plain = next(int(match[group], base) for group, base in ((2, 16), (3, 8), (4, 10)) if match[group])
            number = -plain if match[1] else plain
        codes = [ord(sign) - ESCAPED if ord(sign) >= ESCAPED else ord(sign) for sign in word]
        if any(not 1 <= code_ < 256 for code_ in codes):
            raise CannotSayError(one.at, f"{one}: a word has a byte that no text has", BY_HAND)
        numbers.append(number)
        words.append("".join(map(chr, codes)))
        number += 1
    return numbers, words


_SUMS = {1: "sum8", 2: "sum16", 4: "sum32"}


@cache
def _codes() -> dict[str, tuple[int, Segment]]:
    """Return the check codes of StreamDevice in order: the bytes of each, and its equivalent segment keys, if any."""
    rows = json.loads((shipped_folder("frames") / "streamdevice.json").read_text("utf-8"))
    return {name: (row["bytes"], row.get("code", {})) for name, row in rows.items()}


def check_method(one: Converter) -> tuple[str, int, Segment]:
    """Return the name of a check code, its bytes, and its entry in `checks:` if it needs one. Raises CannotSayError.

    StreamDevice takes the first code whose name begins with the given name, after a prefix `-`, `neg` or `n`, `~` or
    `not`.
    """
    name = one.about.lower()
    given = name
    is_negative = name.startswith("-")
    name = name.removeprefix("-")
    is_negative = is_negative or name.startswith("neg")
    name = name.removeprefix("neg")
    is_inverted = name.startswith(("~", "not"))
    name = name.removeprefix("~").removeprefix("not")
    found = ""
    for known in _codes():
        if name and known.startswith(name):
            found = known
            break
        if name.startswith("n") and len(name) > 1 and known.startswith(name[1:]):
            found, is_negative = known, True
            break
    if not found:
        raise CannotSayError(one.at, f"{one}: there is no such check code", "correct its name")
    size, code = _codes()[found]
    if is_negative or is_inverted:
        if code != {"method": _SUMS.get(size)} or (is_negative and is_inverted):
            raise CannotSayError(one.at, f"{one}: no check code is like it", "write it in checks: by hand")
        code = {**code, "complement": "twos" if is_negative else "ones"}
    if not code:
        raise CannotSayError(one.at, f"{one}: no check code is like it", "write it in checks: by hand")
    if len(code) == 1:
        return str(code["method"]), size, {}
    return "stream_" + re.sub(r"[^a-z0-9]", "_", given.replace("-", "neg").replace("~", "not")), size, code
