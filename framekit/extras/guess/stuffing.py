"""Stuffing: encoding of bytes that would end a frame; recognition and removal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from math import log2

from framekit.extras.guess.model import Evidence, Framing, Stuffing

USUAL = {(0x7E, 0x7D): ("xor", 0x20), (0xC0, 0xDB): ("codes", 0)}
"""Customary pairs of delimiter and escape byte: few occurrences suffice to recognize them."""
LEAST_ESCAPES = 8
"""Least number of occurrences of an escape byte that is not customary."""
LEAST = 12.0
"""Least evidence (bits) for a stuffing."""


class StuffingError(ValueError):
    """The bytes are no valid result of the stuffing."""


def unstuffed(stuffing: Stuffing, data: bytes) -> bytes:
    """Return the content without stuffing. Raises StuffingError."""
    if stuffing.kind == "cobs":
        return _from_cobs(data)
    if stuffing.kind == "hex":
        return from_digits(data)
    found, at, escape = bytearray(), 0, stuffing.escape
    codes = dict(stuffing.codes)
    while at < len(data):
        byte = data[at]
        at += 1
        if byte == escape:
            if at == len(data):
                raise StuffingError("nothing stands behind the last escape byte")
            after = data[at]
            at += 1
            if stuffing.kind == "escape_xor":
                byte = after ^ stuffing.xor
            elif stuffing.kind == "doubled":
                if after != escape:
                    raise StuffingError("an escape byte is not doubled")
            elif after in codes:
                byte = codes[after]
            else:
                raise StuffingError("there is no such code")
        found.append(byte)
    return bytes(found)


HEX_DIGITS = frozenset(b"0123456789ABCDEFabcdef")


def from_digits(text: bytes) -> bytes:
    """Return the bytes that hex digits represent. Raises StuffingError."""
    if len(text) % 2 or not HEX_DIGITS.issuperset(text):
        raise StuffingError("these are no pairs of hex digits")
    return bytes.fromhex(text.decode("ascii"))


def _from_cobs(data: bytes) -> bytes:
    found, at = bytearray(), 0
    while at < len(data):
        code = data[at]
        if code == 0 or at + code > len(data):
            raise StuffingError("a group is longer than the rest")
        found += data[at + 1 : at + code]
        at += code
        if code < 0xFF and at < len(data):
            found.append(0)
    return bytes(found)


def plain_frame(framing: Framing, data: bytes) -> bytes:
    """Return a frame without its stuffing, with its marks. Raises StuffingError."""
    body = data[: len(data) - framing.behind]
    if framing.stuffing is None or not (body.startswith(framing.start) and body.endswith(framing.end)):
        return data
    inner = body[len(framing.start) : len(body) - len(framing.end)]
    return framing.start + unstuffed(framing.stuffing, inner) + framing.plain_end + data[len(body) :]


def find_stuffing(inner: Sequence[bytes], start: bytes, end: bytes) -> tuple[Stuffing, Evidence] | None:
    """Return the stuffing that the content between marks shows, with the evidence; None if no stuffing is
    recognizable.
    """
    candidates = sorted(_candidates(inner, start, end), key=lambda one: one[1].chance, reverse=True)
    if candidates and candidates[0][1].chance >= LEAST:
        return candidates[0]
    return _by_custom(inner, start, end)


def _by_custom(inner: Sequence[bytes], start: bytes, end: bytes) -> tuple[Stuffing, Evidence] | None:
    """Return the stuffing customary for these marks if the content does not contradict it; else None."""
    if len(end) != 1 or start not in (b"", end):
        return None
    for (mark, escape), (kind, xor) in USUAL.items():
        if mark == end[0]:
            stuffing = (
                Stuffing("escape_xor", escape, xor) if kind == "xor"
                else Stuffing("escape_codes", escape, codes=((0xDC, mark), (0xDD, escape)))
            )  # fmt: skip
            good = sum(_is_made(stuffing, one) for one in inner)
            return (stuffing, Evidence(good, len(inner))) if good >= 0.95 * len(inner) else None
    return None


def _is_made(stuffing: Stuffing, data: bytes) -> bool:
    try:
        unstuffed(stuffing, data)
    except StuffingError:
        return False
    return True


def _candidates(inner: Sequence[bytes], start: bytes, end: bytes) -> Iterator[tuple[Stuffing, Evidence]]:
    if len(end) == 1 and start in (b"", end) and end == b"\0":
        yield from _cobs(inner)
    if len(start) == len(end) == 2 and start[0] == end[0] and start != end:
        yield from _doubled(inner, start[0])
    if len(end) == 1 and len(start) <= 1 and end != b"\0":
        yield from _escaped(inner, start, end[0])


def _cobs(inner: Sequence[bytes]) -> Iterator[tuple[Stuffing, Evidence]]:
    stuffing, good, chance = Stuffing("cobs"), 0, 40.0  # few protocols end with 00 otherwise
    for one in inner:
        try:
            unstuffed(stuffing, one)
        except StuffingError:
            continue
        good += 1
        chance += log2(max(2, len(one)))  # the last group ends just there
    if good >= 0.9 * len(inner):
        yield stuffing, Evidence(good, len(inner), chance)


def _doubled(inner: Sequence[bytes], escape: int) -> Iterator[tuple[Stuffing, Evidence]]:
    stuffing, good, seen = Stuffing("doubled", escape), 0, 0
    for one in inner:
        try:
            plain = unstuffed(stuffing, one)
        except StuffingError:
            continue
        good += 1
        seen += len(one) - len(plain)
    if good >= 0.9 * len(inner):
        yield stuffing, Evidence(good, len(inner), LEAST + 8.0 * seen)  # escape bytes in marks are evidence


def _escaped(inner: Sequence[bytes], start: bytes, end: int) -> Iterator[tuple[Stuffing, Evidence]]:
    marks = {*start, end}
    if sum(0x20 <= byte < 0x7F for one in inner for byte in one) >= 0.98 * sum(map(len, inner)):
        return  # text
    plain_seen: Counter[int] = Counter()
    places: dict[int, Counter[int]] = {}
    after: dict[int, Counter[int]] = {}
    for one in inner:
        for at, byte in enumerate(one):
            plain_seen[byte] += 1
            places.setdefault(byte, Counter())[at] += 1
            after.setdefault(byte, Counter())[one[at + 1] if at + 1 < len(one) else -1] += 1
    for escape, followers in after.items():
        usual = USUAL.get((end, escape))
        if escape in marks or not _may_escape(places[escape], followers, usual is not None):
            continue
        count = sum(followers.values())
        seen = {byte for byte, often in followers.items() if byte >= 0 and often > 0.02 * count}
        if len(seen) > 40 or seen & {*marks, escape}:
            continue  # a byte that needs escaping never follows an escape byte
        found = _xor_of(seen, marks, escape, plain_seen, followers, usual)
        if found is not None:
            yield found
        elif usual == ("codes", 0) and seen <= {0xDC, 0xDD}:
            chance = count * log2(256 / 3)
            evidence = Evidence(sum(followers[byte] for byte in seen), count, chance)
            yield Stuffing("escape_codes", escape, codes=((0xDC, end), (0xDD, escape))), evidence


def _may_escape(places: Counter[int], followers: Counter[int], is_usual: bool) -> bool:
    """Return whether the counts of a byte by offset and by next byte (-1 for the end) fit an escape byte.

    `is_usual`: the byte is the usual escape byte of the end mark, so that weaker evidence is enough.
    """
    count = sum(followers.values())
    if followers[-1] > 0.02 * count or (count < 3 and not is_usual):
        return False
    most = places.most_common(1)[0][1]
    if is_usual:
        return count < 3 or most <= 0.6 * count  # otherwise a field
    return count >= LEAST_ESCAPES and most <= 0.25 * count  # otherwise the escaped bytes also occur unescaped


def _xor_of(
    seen: set[int], marks: set[int], escape: int, plain_seen: Counter[int], followers: Counter[int],
    usual: tuple[str, int] | None,
) -> tuple[Stuffing, Evidence] | None:  # fmt: skip
    best: tuple[Stuffing, Evidence] | None = None
    for xor in range(1, 256):
        meant = {byte ^ xor for byte in seen}
        if not meant & {*marks, escape}:
            continue
        raw = sum(plain_seen[byte] for byte in meant if byte != escape)
        if raw > 0.02 * sum(followers.values()):  # an escaped byte never occurs unescaped
            continue
        known = len(meant & {*marks, escape})
        if usual is None and known < 2:
            continue
        often = sum(count for byte, count in followers.items() if byte ^ xor in (*marks, escape))
        if often < 0.8 * sum(followers.values()) and not (xor == 0x20 and max(meant - {*marks, escape}) < 0x20):
            continue  # only marks and the escape byte are escaped, or by custom control characters too
        chance = sum(followers.values()) * log2(256 / (len(seen) + 1)) - 16 + 4 * known
        chance -= 8 if xor != 0x20 else 0
        if usual == ("xor", xor):
            chance += 16
        evidence = Evidence(sum(followers[byte] for byte in seen), sum(followers.values()), chance)
        if best is None or chance > best[1].chance:
            best = Stuffing("escape_xor", escape, xor), evidence
    return best
