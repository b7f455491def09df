"""Recognition of text fields: printable characters in all frames, in a number that rules out chance."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from math import log2

from framekit.extras.guess.model import Evidence, GuessedField

PRINTABLE = frozenset(range(0x20, 0x7F))
NUMBER_SIGNS = frozenset(b"0123456789.")
LEADING_SIGNS = frozenset(b"+- ")
_DECIMAL = re.compile(rb"(?P<pad> *)(?P<sign>[+-]?)[0-9]+(?P<fraction>\.[0-9]+)?")
LUCK = 12.0
"""Evidence (bits) from which printable characters are text."""
BITS = log2(256 / len(PRINTABLE))
"""Evidence for text of one printable byte value (bits)."""
ENOUGH = 200
"""Largest number of texts used for the evidence."""
LONGEST_SHOWN = 24


def with_texts(fields: Sequence[GuessedField], texts: Sequence[bytes]) -> list[GuessedField]:
    """Merge adjacent unknown bytes that are printable in all frames into text fields.

    Adjacent digits are one field, even if the leading digits are constant.
    """
    found: list[GuessedField] = []
    before_text = LUCK if fields and fields[-1].kind == "text" else 0.0
    for is_open, group in groupby(fields, lambda one: one.size > 0 and one.name in ("unknown", "constant")):
        run = list(group)
        found += _parted(run, texts, before_text) if is_open else run
    return found


def shown_text(text: bytes) -> str:
    """Return the beginning of a text in quotes, with other bytes as `·`."""
    signs = "".join(chr(byte) if byte in PRINTABLE else "·" for byte in text[:LONGEST_SHOWN])
    return f"'{signs}'" + (" …" if len(text) > LONGEST_SHOWN else "")


def decimal_of(text: bytes) -> int | float | None:
    """Return the number that a text represents, such as `+012.5`; None if it is no number."""
    match = _DECIMAL.fullmatch(text)
    if match is None:
        return None
    return float(text) if match["fraction"] else int(text)


def decimal_keys(texts: Sequence[bytes]) -> str | None:
    """Return the keys, apart from the size, of the number format that all texts share; None if they differ."""
    matches = [_DECIMAL.fullmatch(text) for text in texts]
    found = [match for match in matches if match is not None]
    places = {len(match["fraction"] or b"") for match in found}
    if len(found) < len(texts) or len(places) != 1:
        return None
    signs = {match["sign"] for match in found}
    keys = ", sign: always" if b"" not in signs else "" if b"+" not in signs else None
    if keys is None:
        return None
    keys += ", pad: 20" if any(match["pad"] for match in found) else ""
    decimals = places.pop()
    return keys + (f", decimals: {decimals - 1}" if decimals else "")


def _parted(run: Sequence[GuessedField], texts: Sequence[bytes], known: float) -> Iterator[GuessedField]:
    """Yield the fields of a run of bytes, with text fields for printable bytes.

    `known`: evidence (bits) for text so far.
    """
    first, end = run[0].offset, run[-1].offset + run[-1].size
    seen = {place: {text[place] for text in texts} for place in range(first, end)}
    for is_text, group in groupby(range(first, end), lambda place: seen[place] <= PRINTABLE):
        places = list(group)
        luck = known + BITS * sum(len(seen[place]) for place in places)
        if is_text and len(places) > 1 and luck >= LUCK:
            yield from _fields(places, seen, texts, luck)
        else:
            yield from _as_before(run, places)


def _as_before(run: Sequence[GuessedField], places: Sequence[int]) -> Iterator[GuessedField]:
    """Yield the earlier fields within the range, with constants cut to it."""
    for one in run:
        begin, end = max(one.offset, places[0]), min(one.offset + one.size, places[-1] + 1)
        if begin < end and one.kind == "constant":
            about = " ".join(one.about.split()[begin - one.offset : end - one.offset])
            yield replace(one, offset=begin, size=end - begin, about=about)
        elif begin < end:
            yield one


def _fields(
    places: Sequence[int], seen: dict[int, set[int]], texts: Sequence[bytes], luck: float
) -> Iterator[GuessedField]:
    """Yield fields for numbers and for the text between them; constant parts are separated from varying parts."""
    parts: list[list[int]] = []
    for place in places:
        is_digit = seen[place] <= NUMBER_SIGNS
        begins = is_digit != bool(parts and parts[-1] and seen[parts[-1][-1]] <= NUMBER_SIGNS)
        after_sign = is_digit and parts and len(parts[-1]) == 1 and seen[parts[-1][0]] <= LEADING_SIGNS
        leads = not is_digit and seen[place] <= LEADING_SIGNS
        if not parts or leads or (begins and not after_sign):
            parts.append([place])
        else:
            parts[-1].append(place)
    for varies, group in groupby(parts, lambda part: any(len(seen[place]) > 1 for place in part)):
        own = list(group)
        for part in own if varies else [[place for one in own for place in one]]:
            yield _field(part[0], len(part), varies, texts, luck)


def _field(at: int, size: int, varies: bool, texts: Sequence[bytes], luck: float) -> GuessedField:
    values = sorted({text[at : at + size] for text in texts})
    evidence = Evidence(len(texts), len(texts), luck)
    if not varies:
        return GuessedField("constant", at, size, "text", f"always {shown_text(values[0])}", evidence)
    about = f"{len(values)} values, {shown_text(values[0])} to {shown_text(values[-1])}"
    return GuessedField("text", at, size, "text", about, evidence)


def is_text(texts: Sequence[bytes]) -> bool:
    """Return whether all bytes are printable, in a number that rules out chance."""
    if not all(PRINTABLE.issuperset(text) for text in texts):
        return False
    seen = {sign for text in texts[:ENOUGH] for sign in enumerate(text)}
    return BITS * len(seen) >= LUCK
