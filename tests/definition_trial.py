"""Invariants of every definition that `check` accepts, tested on definitions of any content."""

from __future__ import annotations

import re
from inspect import signature
from random import Random
from typing import Any

from construct_oracle import ConstructCodec, compile_construct
from link_world import feed

from framekit.codec.ambiguity import check_matrices
from framekit.codec.codec import Builders, Codec, compile_protocol
from framekit.codec.columns import Cut
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.model.frames import parts_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Field, Inner
from framekit.definition.times import LineFormat
from framekit.extras.batch.batch import BatchDecoder
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope

PYTHONS_WORDS = re.compile(
    r"not supported between|unsupported operand|object is not|NoneType|'(dict|list|tuple|bytearray)'|Error\b|too"
    r" big to convert|out of range|has no attribute|invalid literal|required argument|subscriptable|modulo by zero"
    r"|not iterable|can't concat|a bytes-like|unpack|negative shift|must be str|Container|Traceback"
)
"""Phrases of Python's own exceptions, which no message may contain."""
MOST_REPAIRS = 12


class Trial:
    """A definition compiled by both compilers, with all checks on it. Raises DefinitionError if it is refused."""

    def __init__(self, text: str, values: dict[str, Any], seed: int | str = 0) -> None:
        self.protocol: Protocol = load_protocol_text(text, "drawn")
        self.codec: Codec = compile_protocol(self.protocol)
        self.reference: ConstructCodec = compile_construct(self.protocol)
        self.values = values
        self.random = Random(seed)
        self.goes_round = False

    def run(self) -> bytes | None:
        """Run all checks; return the bytes, or None if no fitting values were found."""
        data = self.built()
        if data is None:
            return None
        if not self.is_read_as_sent(data) and self.told("is always taken for", "may be the beginning of"):
            return None
        if not self.goes_round:
            self.built_by_keywords(data)
        self.read(data)
        self.measure(data)
        for _ in range(6):
            self.damaged(damaged(data, self.random))
        self.receive(data)
        self.together(data)
        return data

    def told(self, *what: str) -> bool:
        """Return whether a matrix error of `check` contains one of these texts."""
        problems = [problem.what for problem in check_matrices(self.protocol) if not problem.warning]
        return any(words in problem for words in what for problem in problems)

    # ---- building -----------------------------------------------------------------------------------------

    def built(self) -> bytes | None:
        """Return the bytes of the values or of repaired values, or None; assert that both compilers agree."""
        for _ in range(MOST_REPAIRS):
            first, second = self.build(self.codec), self.build(self.reference)
            if isinstance(first, EncodeError) and "which ends it" in str(first):
                return None  # the construct codec tries every possible end, so it can decode this text
            if isinstance(first, EncodeError) or isinstance(second, EncodeError):
                assert isinstance(first, EncodeError), f"only constructs refuse {self.values}: {second}"
                if not isinstance(second, EncodeError):
                    return self.built_of_all(first, second)
                if not (repaired(self.values, second) or repaired(self.values, first)):
                    return None
                continue
            assert first == second, f"{first.hex(' ')} is not {second.hex(' ')}"
            return first
        return None

    def built_of_all(self, error: EncodeError, data: bytes) -> bytes:
        """Accept an error of generated code only for values that depend on each other.

        Decoding gives all values; with them, generated code must build the same bytes. Return `data`.
        """
        named = "is missing" in str(error) or "cannot be worked out" in str(error)
        assert named, f"only generated code refuses {self.values}: {error}"
        self.goes_round = True
        self.values = self.reference.decode("f", data)
        found = self.build(self.codec)
        assert found == data, f"generated code makes {found!r} of all values {self.values}, not {data.hex(' ')}"
        return data

    def built_by_keywords(self, data: bytes) -> None:
        """Assert that a builder makes the same bytes; constants of `where` are not among its keywords."""
        fixed = {
            segment.name
            for segment in self.protocol.frames["f"].segments
            if isinstance(segment, Field) and segment.constants
        }
        builder = Builders(self.codec, self.codec.defaults).builder("f")
        fixed -= set(signature(builder).parameters)
        made = builder(**{name: value for name, value in self.values.items() if name not in fixed})
        assert made == data, f"the builder makes {made.hex(' ')}, not {data.hex(' ')}"

    def build(self, codec: Codec | ConstructCodec) -> bytes | EncodeError:
        try:
            return codec.encode("f", self.values)
        except EncodeError as error:
            assert not PYTHONS_WORDS.search(str(error)), f"Python's own words: {error}"
            return error

    def is_read_as_sent(self, data: bytes) -> bool:
        """Return whether the inner frames are decoded as the frames that were encoded."""
        read_, sent = read(self.codec, data), self.values
        names = [part.name for part in parts_of(self.protocol.frames["f"].segments, Inner)]
        return isinstance(read_, dict) and all(_frames(read_, name) == _frames(sent, name) for name in names)

    # ---- reading ------------------------------------------------------------------------------------------

    def read(self, data: bytes) -> None:
        fields = self.codec.decode("f", data)
        assert fields == self.reference.decode("f", data)
        for codec in (self.codec, self.reference):
            again = codec.encode("f", fields)
            assert again == data, f"{again.hex(' ')} is not {data.hex(' ')}, of {fields}"
        found, _, fault = self.codec.trace("f", data)
        assert fault is None and found == fields, f"{fault}, {found} is not {fields}"

    def damaged(self, data: bytes) -> None:
        """Assert that both codecs and `trace` decode the damaged frame alike or raise the same frame error."""
        first, second = read(self.codec, data), read(self.reference, data)
        found, _, fault = self.codec.trace("f", data)
        traced = found if fault is None else (fault.cause, fault.refuse)
        assert same(first, traced), f"{data.hex(' ')}: decoded {first}, traced {traced} {fault}"
        good, other = isinstance(first, dict), isinstance(second, dict)
        if good != other and "'unknown': {'data'" in str(first if good else second):
            return  # unknown bytes of an inner frame may also be a fault, depending on their known size
        assert good == other, f"{data.hex(' ')}: {first} is not {second}"
        if good:
            assert same(first, second), data.hex(" ")
        for have in range(len(data) + 1):
            self.codec.measure("f", data, 0, have)

    # ---- measuring ----------------------------------------------------------------------------------------

    def measure(self, data: bytes) -> None:
        """Assert that `measure` is right for the whole frame, for every prefix, and with further bytes after the frame.

        Prefixes are measured like a receiver does: with the length that earlier calls have already seen.
        """
        codec = self.codec
        whole = codec.measure("f", data)
        if codec.QUIET < whole < 0:
            assert self.told("may be the beginning of"), f"{data.hex(' ')} is measured as {whole}"
            return
        assert not data or whole == codec.QUIET or 0 < whole <= len(data), f"{data.hex(' ')} is measured as {whole}"
        if whole != len(data) or not data:
            return  # ends by silence, or its data contain an end mark
        seen = wanted = 0
        for have in range(len(data)):
            if have >= wanted:
                found = codec.measure("f", data, 0, have, None, seen)
                assert codec.QUIET < found < 0, f"the first {have} of {data.hex(' ')} are measured as {found}"
                assert found == codec.measure("f", data, 0, have), f"{have} of {data.hex(' ')} depends on what was seen"
                assert have - found <= len(data), f"{have} of {data.hex(' ')} want {-found} more"
                seen, wanted = have, have - found
        assert codec.measure("f", data, 0, None, None, seen) == len(data)
        assert codec.measure("f", b"\x10" + data + b"\x10\x03\x00", 1) == len(data)

    # ---- streams and many at once -------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        """Assert that a receiver's events do not depend on cuts, and that it finds the frame if `measure` does."""
        stream = data + damaged(data, self.random) + data
        places = sorted(self.random.randrange(len(stream) + 1) for _ in range(3))
        cuts = zip([0, *places], [*places, len(stream)], strict=True)
        whole = self._received([stream])
        for pieces in ([stream[place : place + 1] for place in range(len(stream))], [stream[a:b] for a, b in cuts]):
            found = self._received(pieces)
            assert found == whole, f"{stream.hex(' ')} cut otherwise: {found} is not {whole}"
        if data and self.codec.measure("f", data) == len(data):
            first = self._received([data])[:1]
            assert [event[:3] for event in first] == [("frame", "f", data)], f"{data.hex(' ')} is received as {first}"

    def _received(self, pieces: list[bytes]) -> list[tuple[Any, ...]]:
        receiver = Receiver(self.codec, self.protocol, Scope(self.protocol, params={}, line=LineFormat(9600)))
        return feed(receiver, pieces, ("f",))

    def together(self, data: bytes) -> None:
        """Assert that decoding several frames in a batch gives the same results as decoding each alone."""
        frames = [data, damaged(data, self.random), data]
        found = BatchDecoder(self.codec, "f").decode(Cut.of(frames))
        for frame, decoded in zip(frames, found, strict=True):
            alone = read(self.codec, frame)
            result = (decoded.cause, decoded.refuse) if isinstance(decoded, FrameError) else decoded
            assert same(result, alone), f"{frame.hex(' ')} among others: {result} is not {alone}"


def _frames(values: Any, name: str) -> list[str]:
    """Return the names of all inner frames under a name, at any depth."""
    found: list[str] = []
    for one in values if isinstance(values, list) else [values] if isinstance(values, dict) else []:
        for key, value in one.items() if isinstance(one, dict) else ():
            found += list(value) if key == name else _frames(value, name)
    return found


def read(codec: Codec | ConstructCodec, data: bytes) -> Any:
    try:
        return codec.decode("f", data)
    except FrameError as error:
        assert not PYTHONS_WORDS.search(str(error)), f"Python's own words: {error}"
        return error.cause, error.refuse


def same(first: Any, second: Any) -> bool:
    """Return whether two results are equal; NaN, as in a damaged float, equals NaN."""
    return bool(first == second) or repr(first) == repr(second)


def damaged(data: bytes, random: Random) -> bytes:
    """Return the bytes with some bytes changed, removed or inserted."""
    changed = bytearray(data)
    for _ in range(random.choice([1, 1, 2])):
        place, way = random.randrange(len(changed) + 1), random.random()
        if place < len(changed) and way < 0.6:
            changed[place] = random.choice([random.randrange(256), changed[place] ^ 1 << random.randrange(8)])
        elif place < len(changed) and way < 0.75:
            del changed[place]
        elif way < 0.85:
            del changed[place:]
        else:
            changed.insert(place, random.choice([0x10, 0x03, 0x30, 0x00]))
    return bytes(changed)


# ---- values that nearly fit ---------------------------------------------------------------------------------


def repaired(values: dict[str, Any], error: EncodeError) -> bool:
    """Change the value in an error as its message demands; return whether a value was changed."""
    message = str(error)
    if "not part of this frame" in message or "there is no" in message or "is computed as" in message:
        return _change(values, error.field, None)
    if found := re.search(r"'([^']+)' has a length of (\d+), it must be (\d+)", message):
        return _change(values, found[1], int(found[3]))
    if found := re.search(r"'([^']+)' has a length of (\d+), (less|more) than (\d+)", message):
        return _change(values, found[1], int(found[4]))
    return False


def _change(values: Any, path: str, size: int | None) -> bool:
    *outer, last = re.findall(r"\w+", path) or [""]
    for part in outer:
        if isinstance(values, dict) and part in values:
            values = values[part]
        elif isinstance(values, list) and part.isdigit() and int(part) < len(values):
            values = values[int(part)]
        else:
            return False
    if not isinstance(values, dict) or last not in values:
        return False
    if size is None:
        del values[last]
        return True
    found = values[last]
    if isinstance(found, (bytes, str, list)) and size < 300:
        while len(found) < size:
            found = found + (found or {bytes: b"a", str: "a", list: [1]}[type(found)])
        values[last] = found[:size]
        return True
    return False
