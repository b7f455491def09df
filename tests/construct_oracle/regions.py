"""Regions of encoded bytes: hex digits, escaped, doubled or inserted bytes, COBS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from typing import Any

from construct import ConstructError, Container

from construct_oracle.base import SegmentConstruct
from construct_oracle.check_codes import CheckConstruct, code_of
from construct_oracle.faults import ConstructEncodeError, Place, Stop
from construct_oracle.filling import Filling
from construct_oracle.holders import Segments
from construct_oracle.keyed import checked, deciphered, enciphered
from construct_oracle.names import Names
from construct_oracle.rest import rest_size
from construct_oracle.state import Reading, Region, Writing
from construct_oracle.values import evaluated_size
from framekit.codec import stuffing, support
from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName
from framekit.codec.python.facts import in_place_of_records
from framekit.definition.codings import Blocks, Ciphered, Cobs, Coding, Escaped, Hex, Inserted, Plain, Short
from framekit.definition.expression import Expression
from framekit.definition.model.segments import Const, Wrap

Embedded = Callable[[bytes, Names], int | None]
"""Return the size of the frame at the start of the bytes, if it is allowed inside a region, else None."""


class WrapConstruct(SegmentConstruct):
    """Common part of all wraps: content that is read and built separately, within limits of its decoded size.

    The values in the content belong to the enclosing record. Parsing notes `short`, `too_long` and `surplus` (content
    left over); building raises EncodeError for content outside its limits.
    """

    segment: Wrap

    def __init__(self, segment: Wrap, segments: Segments) -> None:
        super().__init__(segment)
        self.segments = segments

    def to_wire(self, plain: bytes, names: Names) -> bytes:
        raise NotImplementedError

    def read_content(
        self, plain: bytes, exact: bool, offset: Callable[[int], int], context: Container, path: str, place: Place
    ) -> int:
        """Read the segments from decoded content; return the number of bytes they took."""
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
        if isinstance(self.segment.coding, Ciphered):
            try:
                values = checked(
                    self.segment.coding,
                    *(filling.compute(one, self.label) for _, one in self.segment.coding.expressions),
                )
                wire = enciphered(self.segment.coding, plain, *values)
            except (TypeError, ValueError) as error:
                if isinstance(error, ConstructEncodeError):
                    raise
                raise filling.error(self.label, f"'{self.label}' cannot be enciphered") from None
        else:
            wire = self.to_wire(plain, writing.names)
        size = self.segment.size
        if isinstance(size, Expression) and size.text.startswith("plain:"):  # otherwise a length gives the size
            size = filling.compute(size, self.label)
        if isinstance(size, int) and size != len(wire):
            raise filling.error(self.label, f"'{self.label}' takes {len(wire)} bytes")
        stream.write(wire)

    def _most(self, evaluate: Callable[[Expression], Any]) -> int | None:
        most = self.segment.most
        return int(evaluate(most)) if isinstance(most, Expression) else most


class HexConstruct(WrapConstruct):
    """Content as hex digits, two per byte. Parsing notes `digits` for other characters, building writes upper case."""

    def to_wire(self, plain: bytes, names: Names) -> bytes:
        return support.hex_to_ascii(plain)

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        start, room = stream.tell(), reading.room(context)
        if room.exact:
            if room.end < start:
                raise reading.no_room(place, start, room)
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
            reading.unopened()
            bad = len(_leading_digits(digits))
            reading.note(replace(place, offset=place.offset + bad), "digits", "pairs of hex digits", digits[bad:])
            return None


def _leading_digits(digits: bytes) -> bytes:
    """Return the pairs of hex digits at the start."""
    count = len(digits) - len(digits.lstrip(b"0123456789ABCDEFabcdef"))
    return digits[: count - count % 2]


class EscapeConstruct(WrapConstruct):
    """Content in which every escape byte is doubled.

    Parses up to the first escape byte that is not doubled, or the bytes of content of fixed size; allowed embedded
    frames are skipped. Notes `short` if the end is missing.
    """

    def __init__(self, segment: Wrap, segments: Segments, embedded: Embedded) -> None:
        super().__init__(segment, segments)
        self.embedded = embedded
        self.escape = segment.escape or 0

    def to_wire(self, plain: bytes, names: Names) -> bytes:
        return stuffing.stuff(plain, self.escape)

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
        """Return the content, the offset of each of its bytes on the wire, and its end (None: the end is missing)."""
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


class CodedConstruct(WrapConstruct):
    """Content that is encoded on the wire by a coding.

    Parses `size` bytes if given, else up to the end of the region. Notes `constant` for bytes that the coding cannot
    make.
    """

    def to_wire(self, plain: bytes, names: Names) -> bytes:
        if isinstance(self.segment.coding, Blocks):
            return with_codes(self.segment.coding, plain, names)
        return coded(self.segment.coding, plain)

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        size: Any = self.segment.size
        if size is None:
            size = reading.sizes.of(self.segment, reading.known_in(context))
        if size is None:
            size = self._up_to_the_end(reading, stream)
        if size is None:
            size = rest_size(self, stream, context, place)
        elif isinstance(size, Expression):
            size = evaluated_size(size, reading, context, place)
        wire = reading.take(stream, size, place)
        if isinstance(self.segment.coding, Blocks):
            self._read_blocks(self.segment.coding, wire, context, path, place)
            return
        if isinstance(self.segment.coding, Ciphered):
            self._read_ciphered(self.segment.coding, wire, context, path, place)
            return
        content = None
        if isinstance(self.segment.coding, Short):
            content = reading.sizes.all(self.segment.of, reading.known_in(context))
            assert content is not None
            if not self.segment.coding.least <= len(wire) <= content:
                reading.unopened()
                cause, offset = ("short", len(wire)) if len(wire) < content else ("too_long", content)
                reading.note(replace(place, offset=place.offset + offset), cause, "wrapped content", wire)
                return
        plain, places = uncoded(self.segment.coding, wire, content)
        if plain is None:
            reading.unopened()
            cause = "digits" if isinstance(self.segment.coding, Hex) else "constant"
            reading.note(replace(place, offset=place.offset + places[-1]), cause, "wrapped content", wire)
            return
        offsets = [place.offset + at for at in [*places, len(wire)]]
        self.read_content(plain, True, lambda at: offsets[min(at, len(offsets) - 1)], context, path, place)

    def _read_blocks(self, coding: Blocks, wire: bytes, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        plain, offsets, at = b"", [0][:0], 0
        writer = CheckConstruct(coding.check_code)
        while at < len(wire):
            block = wire[at : at + coding.size + coding.check_code.size]
            block, found = block[: -coding.check_code.size], block[-coding.check_code.size :]
            wanted = writer.written(code_of(coding.check_code.method, block, reading.names))
            digits = coding.check_code.form in ("hex", "HEX")
            if not block:
                reading.unopened()
                reading.note(replace(place, offset=place.offset + at), "short", wanted, found)
                return
            if (found.upper() if digits else found) != (wanted.upper() if digits else wanted):
                reading.note(replace(place, offset=place.offset + at + len(block)), "check", wanted, found)
            plain += block
            offsets += range(place.offset + at, place.offset + at + len(block))
            at += len(block) + len(found)
        offsets.append(place.offset + at)
        self.read_content(plain, True, lambda at: offsets[min(at, len(offsets) - 1)], context, path, place)

    def _read_ciphered(self, coding: Ciphered, wire: bytes, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        try:
            values = checked(coding, *(reading.evaluate(one, context) for _, one in coding.expressions))
        except (ConstructError, MissingName, *EVALUATION_ERRORS):
            reading.unopened()
            reading.note(place, "value", "wrapped content", wire)
            return
        try:
            plain, wanted, found = deciphered(coding, wire, *values)
        except ValueError:
            reading.unopened()
            reading.note(place, "constant", "wrapped content", wire)
            return
        if wanted != found:
            tag = replace(place, offset=place.offset + len(wire) - coding.tag)
            reading.note(tag, "check", "the tag made with the key", found)
        offsets = [*range(place.offset, place.offset + len(plain)), place.offset + len(wire)]
        self.read_content(plain, True, lambda at: offsets[min(at, len(offsets) - 1)], context, path, place)

    def _up_to_the_end(self, reading: Reading, stream: BytesIO) -> int | None:
        """Return the distance to the constant that follows, if the coding cannot make its first byte; else None."""
        end = next(in_place_of_records(tuple(construct.segment for construct in reading.following)), None)
        if not isinstance(end, Const) or end.when is not None or end.data[0] not in self.segment.coding.never:
            return None
        start = stream.tell()
        found = stream.read(max(reading.region.end - start, 0)).find(end.data[:1])
        stream.seek(start)
        return None if found < 0 else found


def with_codes(coding: Blocks, plain: bytes, names: Names) -> bytes:
    """Return the content with a check code after every block."""
    check, wire = CheckConstruct(coding.check_code), b""
    while plain:
        block, plain = plain[: coding.size], plain[coding.size :]
        wire += block + check.written(code_of(coding.check_code.method, block, names))
    return wire


def coded(coding: Coding, plain: bytes) -> bytes:
    """Return the encoded content."""
    match coding:
        case Plain():
            return plain
        case Hex():
            return support.hex_to_ascii(plain)
        case Escaped(escape=escape, codes=codes):
            behind = dict(codes)
            return b"".join(bytes((escape, behind[byte])) if byte in behind else bytes((byte,)) for byte in plain)
        case Inserted(after=after, insert=insert):
            wire, since = b"", 0
            for byte in plain:
                wire, since = wire + bytes((byte,)), since + 1
                if since >= len(after) and wire.endswith(after):
                    wire, since = wire + insert, 0
            return wire
        case Cobs():
            wire, group = b"", b""
            for place, byte in enumerate(plain):
                if byte:
                    group += bytes((byte,))
                if not byte or len(group) == 254:
                    wire, group = wire + bytes((len(group) + 1,)) + group, b""
                    if byte and place == len(plain) - 1:
                        return wire
            return wire + bytes((len(group) + 1,)) + group
        case Short(fill=fill, least=least):
            while len(plain) > least and plain[-1] == fill:
                plain = plain[:-1]
            return plain
    raise NotImplementedError


def uncoded(coding: Coding, wire: bytes, size: int | None = None) -> tuple[bytes | None, list[int]]:
    """Return the decoded content, or None if it is invalid, and the wire offset of each of its bytes.

    The last offset is that of the error, if any.
    """
    plain, places, at = bytearray(), [0][:0], 0
    if isinstance(coding, Plain):
        return wire, list(range(len(wire)))
    if isinstance(coding, Cobs):
        content, found = _uncobs(wire)
        return content, [0, *found[1:]] if content else found
    if isinstance(coding, Short):
        size = size or 0
        return wire + bytes((coding.fill,)) * (size - len(wire)), [*range(len(wire)), *(size - len(wire)) * [len(wire)]]
    if isinstance(coding, Hex):
        count = len(_leading_digits(wire))
        if count < len(wire):
            return None, [count]
        return bytes.fromhex(wire.decode("ascii")), [*range(0, len(wire), 2)]
    since = 0
    while at < len(wire):
        places.append(at)
        if isinstance(coding, Escaped):
            behind = {code: byte for byte, code in coding.codes}
            byte = wire[at]
            if byte in coding.escaped and byte != coding.escape:
                return None, places
            if byte == coding.escape:
                at += 1
                if at >= len(wire) or wire[at] in coding.escaped:
                    return None, places
                if wire[at] not in behind and coding.flip is None:
                    return None, places
                byte = behind.get(wire[at], wire[at] ^ (coding.flip or 0))
            plain.append(byte)
            at += 1
            continue
        assert isinstance(coding, Inserted)
        plain.append(wire[at])
        at, since = at + 1, since + 1
        if since >= len(coding.after) and plain.endswith(coding.after):
            since = 0
            if not wire.startswith(coding.insert, at):
                return None, [*places, at - len(coding.after)]
            at += len(coding.insert)
    return bytes(plain), places


def _uncobs(wire: bytes) -> tuple[bytes | None, list[int]]:
    plain, places = bytearray(), [0][:0]
    left, before, begin = 0, 255, 0
    for at, byte in enumerate(wire):
        if byte == 0:
            return None, [*places, begin if left else at]
        if left:
            plain.append(byte)
            places.append(at)
            left -= 1
            continue
        if before < 255:
            plain.append(0)
            places.append(at)
        left, before, begin = byte - 1, byte, at
    return (None, [*places, begin]) if left or not wire else (bytes(plain), places)
