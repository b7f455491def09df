"""Content of a wrap to the wire and back: `stuff_…` and others make what stands on the wire, `unstuff_…` the content.

`open_…` reads with care: the content, where each of its bytes stands, and the cause where something is wrong; the last
place is that of the fault. Behind the cause of a wrong check code stand the right one and the one there is; behind
another cause may stand what was expected. Generated code carries these functions along as they stand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from framekit.codec.support import Unfit

Opened = tuple[bytes, Sequence[int], *tuple[str, ...]]


# ---- as it is


def stuff_none(data: bytes) -> bytes:
    """Content that stands on the wire as it is."""
    return data


def open_none(raw: bytes) -> tuple[bytes, Sequence[int], str]:
    """The same with the place of each byte, for a careful reading."""
    return raw, range(len(raw) + 1), ""


# ---- one byte doubled


def stuff(data: bytes | bytearray, escape: int) -> bytes:
    """Every byte `escape` twice."""
    single = b"%c" % escape
    return bytes(data.replace(single, single + single))


def unstuff(data: bytes | bytearray, single: bytes, double: bytes) -> bytes | bytearray:
    """Every doubled escape byte once; the byte is given alone and twice. Raises ValueError where one is not doubled."""
    if data.count(single) != 2 * data.count(double):
        raise Unfit(f"an escape byte {single.hex().upper()} is not doubled")
    return data.replace(double, single)


def unstuffed(raw: bytes, escape: int, embedded: tuple[bytes, ...] = ()) -> Opened:
    """Content without the second ones of doubled escape bytes, and without what is embedded in it."""
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


# ---- some bytes escaped: `codes` is what stands for each, the escape byte's own first; `never` may not stand alone


def stuff_escaped(data: bytes | bytearray, codes: tuple[tuple[bytes, bytes], ...]) -> bytes:
    """Every byte that is escaped in its two bytes."""
    for plain, wire in codes:
        data = data.replace(plain, wire)
    return bytes(data)


def unstuff_escaped(
    data: bytes | bytearray, escape: bytes, plain: dict[int, bytes], flip: int | None, never: bytes
) -> bytes:
    """The content again; `plain` is by the byte behind the escape byte. Raises ValueError for what cannot be."""
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
    """The same with care."""
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


# ---- COBS: groups, each behind a byte that says where the next one begins; between two stood 00, unless they have 254


def stuff_cobs(data: bytes | bytearray) -> bytes:
    """Content without any 00."""
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
    """The content again. Raises ValueError where a group does not end, or holds 00."""
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
    """The same with care."""
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
        places[0] = 0  # the length of the first group belongs to what stands first
    return bytes(content), [*places, len(raw)], ""


# ---- bytes put in behind others


def stuff_inserted(data: bytes | bytearray, after: bytes, insert: bytes) -> bytes:
    """Behind every `after` stands `insert` too."""
    return bytes(data.replace(after, after + insert))


def unstuff_inserted(data: bytes | bytearray, after: bytes, insert: bytes) -> bytes:
    """The content again. Raises ValueError where nothing is put in."""
    plain = bytes(data.replace(after + insert, after))
    if stuff_inserted(plain, after, insert) != data:
        raise Unfit(f"nothing is put in behind {after.hex(' ').upper()}")
    return plain


def open_inserted(raw: bytes, after: bytes, insert: bytes) -> Opened:
    """The same with care."""
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


# ---- a check code behind every `size` bytes, and behind what is left


def add_codes(data: bytes | bytearray, size: int, code: Callable[[bytes], bytes]) -> bytes:
    """Blocks of content, each with its check code behind."""
    found: list[bytes] = []
    for place in range(0, len(data), size):
        block = bytes(data[place : place + size])
        found += block, code(block)
    return b"".join(found)


def strip_codes(
    data: bytes | bytearray, size: int, code: Callable[[bytes], bytes], width: int, digits: bool = False
) -> bytes:
    """The content again; digits of codes may be in either case. Raises ValueError for a wrong code, or none."""
    found: list[bytes] = []
    for place in range(0, len(data), size + width):
        part = bytes(data[place : place + size + width])
        block, there = part[:-width], part[-width:]
        if not block or (there != code(block) and not (digits and there.upper() == code(block).upper())):
            raise Unfit(f"the check code of the block at {place} is wrong")
        found.append(block)
    return b"".join(found)


def open_codes(raw: bytes, size: int, code: Callable[[bytes], bytes], width: int, digits: bool = False) -> Opened:
    """The same with care; content with a wrong code is content all the same."""
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


# ---- bytes left out at the end


def shorten(data: bytes | bytearray, fill: bytes, least: int) -> bytes:
    """Content without such bytes at its end; the first `least` bytes always stay."""
    return bytes(data[: max(len(data.rstrip(fill)), least)])


def fill_up(data: bytes | bytearray, fill: bytes, least: int, size: int) -> bytes:
    """The content again. Raises ValueError for more bytes than it has, and for too few."""
    if not least <= len(data) <= size:
        raise Unfit(f"{len(data)} bytes are none of {least} to {size}")
    return bytes(data.ljust(size, fill))


def open_short(raw: bytes, fill: bytes, least: int, size: int) -> Opened:
    """The same with care; what is left out stands where the region ends."""
    if len(raw) < least:
        return b"", [len(raw)], "short"
    if len(raw) > size:
        return b"", [size], "too_long"
    return raw.ljust(size, fill), [min(place, len(raw)) for place in range(size + 1)], ""
