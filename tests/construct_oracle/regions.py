"""Regions of bytes that stand otherwise on the wire: as hex digits, or with an escape byte doubled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from typing import Any

from construct import Container

from construct_oracle.base import SegmentConstruct
from construct_oracle.faults import Place, Stop
from construct_oracle.filling import Filling
from construct_oracle.holders import Segments
from construct_oracle.names import Names
from construct_oracle.state import Reading, Region, Writing
from framekit.codec import support
from framekit.definition.expression import Expression
from framekit.definition.model.segments import Wrap

Embedded = Callable[[bytes, Names], int | None]
"""How many bytes a frame takes that begins the given bytes and may stand inside a region; None if none does."""


class WrapConstruct(SegmentConstruct):
    """What both wraps share: content that is read and built by itself, within limits of its plain size.

    The values in the content belong to the record around. Parsing notes `short`, `too_long` and `surplus` (content left
    over), building raises EncodeError for content beyond its limits.
    """

    segment: Wrap

    def __init__(self, segment: Wrap, segments: Segments) -> None:
        super().__init__(segment)
        self.segments = segments

    def to_wire(self, plain: bytes) -> bytes:
        raise NotImplementedError

    def read_content(
        self, plain: bytes, exact: bool, offset: Callable[[int], int], context: Container, path: str, place: Place
    ) -> int:
        """Reads the segments from plain content; how many bytes of it they took."""
        reading: Reading = context._state
        wrap = self.segment
        if len(plain) < wrap.least:
            reading.note(place, "short", f"{wrap.least} bytes", len(plain))
        most = self._most(lambda expression: reading.evaluate(expression, context))
        if exact and most is not None and len(plain) > most:
            reading.note(place, "too_long", f"{most} bytes", len(plain))
        stream = BytesIO(plain)
        with reading.deeper(Region(len(plain), exact), offset):
            try:
                self.segments._parse(stream, context, path)
            except Stop:
                if not exact:
                    raise
                reading.stopped_in(wrap.of)
            else:
                if exact and stream.tell() < len(plain):
                    behind = reading.place(stream, self.label, wrap.refuse)
                    reading.note(behind, "surplus", "", plain[stream.tell() :])
        return stream.tell()

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        writing: Writing = context._state
        content = BytesIO()
        with writing.deeper():
            self.segments._build(filling, content, context, path)
        plain = content.getvalue()
        most = self._most(lambda expression: filling.compute(expression, self.label))
        if len(plain) < self.segment.least or (most is not None and len(plain) > most):
            bounds = f"{self.segment.least} to {most}"
            raise filling.error(self.label, f"'{self.label}' holds {bounds} bytes, not {len(plain)}")
        stream.write(self.to_wire(plain))

    def _most(self, evaluate: Callable[[Expression], Any]) -> int | None:
        most = self.segment.most
        return int(evaluate(most)) if isinstance(most, Expression) else most


class HexConstruct(WrapConstruct):
    """Content as hex digits, two a byte. Parsing notes `digits` for anything else, building writes upper case."""

    def to_wire(self, plain: bytes) -> bytes:
        return support.hex_to_ascii(plain)

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        start, room = stream.tell(), reading.room(context)
        if room.exact:
            if room.end < start:
                raise reading.stop(place, "short", "room for what follows", f"{room.end - start} bytes")
            plain = self._plain(stream.read(room.end - start), reading, place)
            if plain is not None:
                self.read_content(plain, True, lambda at: place.offset + 2 * at, context, path, place)
            return
        digits = stream.read(max(room.end - start, 0))
        plain = bytes.fromhex(_leading_digits(digits).decode("ascii"))
        taken = self.read_content(plain, False, lambda at: place.offset + 2 * at, context, path, place)
        stream.seek(start + 2 * taken)

    def _plain(self, digits: bytes, reading: Reading, place: Place) -> bytes | None:
        try:
            return support.ascii_to_hex(digits)
        except ValueError:
            reading.leaf(digits)
            bad = len(_leading_digits(digits))
            reading.note(replace(place, offset=place.offset + bad), "digits", "pairs of hex digits", digits[bad:])
            return None


def _leading_digits(digits: bytes) -> bytes:
    """The pairs of hex digits at the start."""
    count = len(digits) - len(digits.lstrip(b"0123456789ABCDEFabcdef"))
    return digits[: count - count % 2]


class EscapeConstruct(WrapConstruct):
    """Content in which every escape byte is doubled.

    Parses up to the first escape byte that is not doubled, or as many bytes as content of fixed size takes; frames that
    may be embedded are passed over. Notes `short` when the end is missing.
    """

    def __init__(self, segment: Wrap, segments: Segments, embedded: Embedded) -> None:
        super().__init__(segment, segments)
        self.embedded = embedded
        self.escape = segment.escape or 0

    def to_wire(self, plain: bytes) -> bytes:
        return support.stuff(plain, self.escape)

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state

        wanted = reading.sizes.all(self.segment.of, reading.known_in(context))
        start = stream.tell()
        plain, places, end = self._undoubled(stream.read(max(reading.region.end - start, 0)), wanted, reading.names)
        if end is None:
            raise reading.stop(place, "short", "an end", plain)
        stream.seek(start + end)
        offsets = [place.offset + at for at in [*places, end]]
        self.read_content(plain, True, lambda at: offsets[min(at, len(offsets) - 1)], context, path, place)

    def _undoubled(self, wire: bytes, wanted: int | None, names: Names) -> tuple[bytes, list[int], int | None]:
        """The content, where each of its bytes stands, and where it ends (None: its end is missing)."""
        plain, at = bytearray(), 0
        places: list[int] = []
        while wanted is None or len(plain) < wanted:
            if at >= len(wire):
                return bytes(plain), places, None
            if wire[at] == self.escape:
                if at + 1 >= len(wire):
                    return bytes(plain), places, None
                if wire[at + 1] != self.escape:
                    passed = self.embedded(wire[at:], names)
                    if passed is None:
                        return bytes(plain), places, at
                    at += passed
                    continue
            places.append(at)
            plain.append(wire[at])
            at += 2 if wire[at] == self.escape else 1
        return bytes(plain), places, at
