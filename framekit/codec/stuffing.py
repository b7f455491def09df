"""Encode and decode the content of wraps: `stuff_…` etc. encode, `unstuff_…` etc. decode, `open_…` decode carefully.

`open_…` returns the content, the offset of each byte and of the end in the encoded bytes, and the cause of a fault;
with a fault the last offset is that of the fault. After the cause of a wrong check code follow the correct and the
received code; after another cause may follow the expected content. Generated code contains copies of these functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from framekit.codec.support import Unfit

Opened = tuple[bytes, Sequence[int], *tuple[str, ...]]
"""Content, offsets of its bytes, cause of a fault ('' for none), and details of the fault."""


# ---- content unchanged


def stuff_none(data: bytes) -> bytes:
    """Return content that is encoded unchanged."""
    return data


def open_none(raw: bytes) -> tuple[bytes, Sequence[int], str]:
    """Return the content unchanged, with the offset of each byte."""
    return raw, range(len(raw) + 1), ""


# ---- doubled escape bytes


def stuff(data: bytes | bytearray, escape: int) -> bytes:
    """Return the content with every byte `escape` doubled."""
    single = b"%c" % escape
    return bytes(data.replace(single, single + single))


def unstuff(data: bytes | bytearray, single: bytes, double: bytes) -> bytes | bytearray:
    """Return the content with every doubled escape byte single, given the escape byte singly and doubled.

    Raises ValueError for an escape byte that is not doubled.
    """
    if data.count(single) != 2 * data.count(double):
        raise Unfit(f"an escape byte {single.hex().upper()} is not doubled")
    return data.replace(double, single)


def unstuffed(raw: bytes, escape: int, embedded: tuple[bytes, ...] = ()) -> Opened:
    """Decode carefully a content with doubled escape bytes, without the frames embedded in it."""
    plain, places, place = bytearray(), [], 0
    while place < len(raw):
        frame = next((frame for frame in embedded if raw.startswith(frame, place)), None)
        if frame is not None:
            place += len(frame)
            continue
        places.append(place)
        plain.append(raw[place])
        if raw[place] == escape:
            place += 1
            if raw[place : place + 1] != raw[place - 1 : place]:
                return b"", [place - 1], "constant"
        place += 1
    return bytes(plain), [*places, len(raw)], ""


# ---- escaped bytes: `codes` lists the code of each, first that of the escape byte; `never`: forbidden without escape


def stuff_escaped(data: bytes | bytearray, codes: tuple[tuple[bytes, bytes], ...]) -> bytes:
    """Return the content with each escaped byte replaced by its two-byte code."""
    for plain, wire in codes:
        data = data.replace(plain, wire)
    return bytes(data)


def unstuff_escaped(
    data: bytes | bytearray, escape: bytes, plain: dict[int, bytes], flip: int | None, never: bytes
) -> bytes:
    """Return the decoded content; `plain` maps the byte after the escape byte to the content byte.

    Raises ValueError for a forbidden byte, an unknown code, or a missing code.
    """
    if never and data.translate(None, never) != data:
        raise Unfit("a byte that is to be escaped stands alone")
    if escape not in data:
        return bytes(data)
    first, *parts = data.split(escape)
    found = [first]
    for part in parts:
        if not part:
            raise Unfit(f"nothing stands behind an escape byte {escape.hex().upper()}")
        one = plain.get(part[0])
        if one is None:
            if flip is None:
                raise Unfit(f"{part[0]:02X} is no code behind {escape.hex().upper()}")
            one = b"%c" % (part[0] ^ flip)
        found += one, part[1:]
    return b"".join(found)


def open_escaped(raw: bytes, escape: bytes, plain: dict[int, bytes], flip: int | None, never: bytes) -> Opened:
    """Decode carefully a content with escaped bytes."""
    content, places, place = bytearray(), [], 0
    while place < len(raw):
        places.append(place)
        size = 2 if raw[place] == escape[0] else 1
        try:
            content += unstuff_escaped(raw[place : place + size], escape, plain, flip, never)
        except ValueError:
            return b"", places, "constant"
        place += size
    return bytes(content), [*places, len(raw)], ""


# ---- COBS: groups, each after a byte with the offset of the next group; a 00 between groups of less than 254 bytes


def stuff_cobs(data: bytes | bytearray) -> bytes:
    """Return the content encoded without any byte 00."""
    found: list[bytes] = []
    parts = [bytes(part) for part in data.split(b"\0")]
    for number, part in enumerate(parts, 1):
        while len(part) >= 254:
            found.append(b"\xff" + part[:254])
            part = part[254:]
            if not part and number == len(parts):
                return b"".join(found)
        found.append(b"%c" % (len(part) + 1) + part)
    return b"".join(found)


def unstuff_cobs(data: bytes | bytearray) -> bytes:
    """Return the decoded content. Raises ValueError for an incomplete or empty group, or a byte 00."""
    found, place, end = [], 0, len(data)
    while place < end:
        size = data[place]
        stop = place + size
        found.append(data[place + 1 : stop])
        if not size or stop > end:
            raise Unfit(f"the group at {place} does not end")
        if size < 255 and stop < end:
            found.append(b"\0")
        place = stop
    if not end or 0 in data:
        raise Unfit("a group is empty, or holds 00")
    return b"".join(found)


def open_cobs(raw: bytes) -> Opened:
    """Decode carefully a content in COBS."""
    content, place = bytearray(), 0
    places: list[int] = []
    while place < len(raw):
        size = raw[place]
        group = raw[place + 1 : place + size]
        if not size or len(group) < size - 1 or 0 in group:
            return b"", [*places, place], "constant"
        content += group
        places += range(place + 1, place + size)
        place += size
        if size < 255 and place < len(raw):
            content.append(0)
            places.append(place)
    if not raw:
        return b"", [0], "constant"
    if content:
        places[0] = 0  # the first content byte includes the length of the first group
    return bytes(content), [*places, len(raw)], ""


# ---- inserted bytes


def stuff_inserted(data: bytes | bytearray, after: bytes, insert: bytes) -> bytes:
    """Return the content with `insert` added after every `after`."""
    return bytes(data.replace(after, after + insert))


def unstuff_inserted(data: bytes | bytearray, after: bytes, insert: bytes) -> bytes:
    """Return the decoded content. Raises ValueError if `insert` is missing after an `after`."""
    plain = bytes(data.replace(after + insert, after))
    if stuff_inserted(plain, after, insert) != data:
        raise Unfit(f"nothing is put in behind {after.hex(' ').upper()}")
    return plain


def open_inserted(raw: bytes, after: bytes, insert: bytes) -> Opened:
    """Decode carefully a content with inserted bytes."""
    content, start = bytearray(), 0
    places: list[int] = []
    while (place := raw.find(after, start)) >= 0:
        stop = place + len(after)
        content += raw[start:stop]
        places += range(start, stop)
        if not raw.startswith(insert, stop):
            return b"", [*places, place], "constant"
        start = stop + len(insert)
    content += raw[start:]
    return bytes(content), [*places, *range(start, len(raw) + 1)], ""


# ---- blocks of `size` bytes with check codes, and an incomplete block at the end


def add_codes(data: bytes | bytearray, size: int, code: Callable[[bytes], bytes]) -> bytes:
    """Return the content in blocks of `size` bytes, each followed by its check code."""
    found: list[bytes] = []
    for place in range(0, len(data), size):
        block = bytes(data[place : place + size])
        found += block, code(block)
    return b"".join(found)


def strip_codes(
    data: bytes | bytearray, size: int, code: Callable[[bytes], bytes], width: int, digits: bool = False
) -> bytes:
    """Return the decoded content; `digits`: digits of codes match in either case.

    Raises ValueError for a wrong or missing code.
    """
    found: list[bytes] = []
    for place in range(0, len(data), size + width):
        part = bytes(data[place : place + size + width])
        block, there = part[:-width], part[-width:]
        if not block or (there != code(block) and not (digits and there.upper() == code(block).upper())):
            raise Unfit(f"the check code of the block at {place} is wrong")
        found.append(block)
    return b"".join(found)


def open_codes(raw: bytes, size: int, code: Callable[[bytes], bytes], width: int, digits: bool = False) -> Opened:
    """Decode carefully a content in blocks; the content is returned even if a code is wrong."""
    content: list[bytes] = []
    places: list[int] = []
    expected = found = ""
    bad = -1
    for place in range(0, len(raw), size + width):
        part = raw[place : place + size + width]
        block, there = part[:-width], part[-width:]
        if not block:
            return b"", [*places, place], "short"
        wanted = code(block)
        if bad < 0 and there != wanted and not (digits and there.upper() == wanted.upper()):
            expected, found, bad = wanted.hex(" ").upper(), there.hex(" ").upper(), place + len(block)
        content.append(block)
        places += range(place, place + len(block))
    if bad >= 0:
        return b"".join(content), [*places, len(raw), bad], "check", expected, found
    return b"".join(content), [*places, len(raw)], ""


# ---- omitted fill bytes at the end


def shorten(data: bytes | bytearray, fill: bytes, least: int) -> bytes:
    """Return the content without trailing fill bytes; at least the first `least` bytes remain."""
    return bytes(data[: max(len(data.rstrip(fill)), least)])


def fill_up(data: bytes | bytearray, fill: bytes, least: int, size: int) -> bytes:
    """Return the decoded content of `size` bytes.

    Raises ValueError for fewer than `least` or more than `size` bytes.
    """
    if not least <= len(data) <= size:
        raise Unfit(f"{len(data)} bytes are none of {least} to {size}")
    return bytes(data.ljust(size, fill))


def open_short(raw: bytes, fill: bytes, least: int, size: int) -> Opened:
    """Decode carefully a content without its trailing fill bytes.

    Omitted bytes have the offset of the end of the region.
    """
    if len(raw) < least:
        return b"", [len(raw)], "short"
    if len(raw) > size:
        return b"", [size], "too_long"
    return raw.ljust(size, fill), [min(place, len(raw)) for place in range(size + 1)], ""
