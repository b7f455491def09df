"""Search for the check code of unknown frames: every place, range and method, accepted if it holds in nearly all
frames.

Sums and exclusive ors are tried with any constant, CRCs of the catalogue with any initial register, other CRCs by
algebra. Each hypothesis is tried on a few pairs of frames first; the survivors are tested on all frames.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

from framekit.codec.checks import compute
from framekit.definition.expression import parse_expression
from framekit.definition.model.checks import CheckMethod, crc_catalogue, ready_methods
from framekit.definition.problems import NOWHERE
from framekit.extras.guess.crc_algebra import difference, plain_crc, polynomials, starts_of
from framekit.extras.guess.model import CheckGuess, CheckPlace, Evidence, Order
from framekit.extras.guess.stuffing import StuffingError, from_digits

LARGEST_START = 6
"""Number of offsets tried as the first byte that the check covers."""
LARGEST_TAIL = 3
NEARLY = 0.6
"""Least share of frames in which a CRC of 16 bits or more must hold: the rest may be damaged or badly cut."""
MOST = 0.8
"""Least share of frames in which any other code must hold."""
SURE = 24.0
"""Evidence (bits) from which a check is accepted."""
TRIED = 16.0
"""Bits subtracted from the evidence to account for the number of hypotheses."""
LEAST_CODES = 24
"""Least number of distinct values of a check code (or half the number of frames, if that is less): a field that hardly
ever changes is no check code.
"""
MOST_PAIRS = 7
MOST_SOLVED = 4
FLETCHER = "(((acc & 0xFF) + byte) & 0xFF) | ((((acc >> 8) + (acc & 0xFF) + byte) & 0xFF) << 8)"


class CountedBytes(NamedTuple):
    """A frame cut for a check: the covered bytes, and the code."""

    data: bytes
    code: int


class Family(NamedTuple):
    """CRCs that differ in initial register and final value only."""

    width: int
    poly: int
    refin: bool
    refout: bool


@cache
def families() -> tuple[Family, ...]:
    """Return the CRC families of the catalogue whose width is a whole number of bytes."""
    methods = [entry.method for entry in crc_catalogue() if entry.method.width in (8, 16, 24, 32)]
    return tuple(dict.fromkeys(Family(one.width, one.poly, one.refin, one.refout) for one in methods))


@cache
def _ready_crcs() -> dict[tuple[Family, int, int], str]:
    found: dict[tuple[Family, int, int], str] = {}
    for name, one in ready_methods().items():
        if one.kind == "crc":
            family = Family(one.width, one.poly, one.refin, one.refout)
            found.setdefault((family, one.initial, one.xorout), name)
    return found


def fletcher(data: bytes) -> int:
    """Return Fletcher's check code of two bytes: the sum in the low byte, the sum of the sums in the high byte."""
    low = high = 0
    for byte in data:
        low = low + byte & 0xFF
        high = high + low & 0xFF
    return high << 8 | low


def code_of(check: CheckGuess, data: bytes) -> int:
    """Return the check code over these bytes."""
    return fletcher(data) if check.method.kind == "fold" else compute(check.method, data)


def alike(check: CheckGuess) -> list[CheckGuess]:
    """Return the catalogued CRCs that differ from `check` in register and final value only, over the same range or from
    byte 0.
    """
    method = check.method
    own = Family(method.width, method.poly, method.refin, method.refout)
    return [
        replace(check, place=replace(check.place, start=start), method=ready_methods()[name], name=name, others=())
        for (family, _, _), name in _ready_crcs().items()
        for start in dict.fromkeys((0, check.place.start))
        if family == own
    ]


def holds(check: CheckGuess, frame: bytes) -> bool:
    """Return whether the check of a frame, without its stuffing, is right."""
    cut = cut_at(check.place, frame)
    return cut is not None and cut.code == code_of(check, cut.data)


def cut_at(place: CheckPlace, frame: bytes) -> CountedBytes | None:
    """Return the covered bytes of a frame and its check code; None if the frame is too short or has characters that are
    no digits.
    """
    end = len(frame) - place.tail
    begin = end - place.size if place.at is None else place.at
    if place.at is not None:
        data = frame[begin + place.size + place.start : len(frame) - place.stop]
        end = begin + place.size
    else:
        data = frame[place.start : max(0, begin - place.stop)]
    if begin < place.start and place.at is None:
        return None
    raw = frame[begin:end]
    if len(raw) < place.size or not data:
        return None
    if place.form == "hex":
        number = _digits(raw)
        if number is None:
            return None
        raw = number
    if place.counted == "hex":
        number = _digits(data)
        if number is None:
            return None
        data = number
    return CountedBytes(data, int.from_bytes(raw, place.order))


def _digits(text: bytes) -> bytes | None:
    try:
        return from_digits(text)
    except StuffingError:
        return None


def find_checks(frames: Sequence[bytes], start: int = 0, tail: int = 0, most: int = 3) -> list[CheckGuess]:
    """Return the best `most` checks that hold, best first; an empty list if none is certain.

    Frames are whole and unstuffed, begin with `start` constant bytes and end with `tail` constant bytes.
    """
    distinct = list(dict.fromkeys(frames))
    if len(distinct) < 3:
        return []
    found: list[CheckGuess] = []
    for place in _places(distinct, start, tail):
        found += _at_place(place, distinct)
        if any(one.name and _is_good_enough(one, distinct) for one in found):
            break
    if not any(_is_good_enough(one, distinct) for one in found):
        for place in _places(distinct, start, tail):
            found += _by_algebra(place, distinct)
            if found:
                break
    found.sort(key=_rank, reverse=True)
    return _together(found)[:most]


def _is_good_enough(one: CheckGuess, frames: Sequence[bytes]) -> bool:
    return one.evidence.holds >= 0.95 * len(frames) and one.evidence.chance > 2 * SURE


def _rank(one: CheckGuess) -> tuple[float, ...]:
    method = one.method
    ones = (1 << method.width) - 1
    plain = int(method.initial in (0, ones)) + int(method.kind != "crc" or method.xorout in (0, ones))
    share = round(one.evidence.holds / one.evidence.of, 2)
    known = bool(one.name) or method.kind == "fold"
    return (
        share, one.place.at is None, -one.place.tail, known, method.kind != "crc", plain, -one.place.stop,
        -one.place.start,
    )  # fmt: skip


def _together(found: Sequence[CheckGuess]) -> list[CheckGuess]:
    """Return the best check of each place, with descriptions of the others."""
    groups: dict[tuple[int | None, int, int], list[CheckGuess]] = defaultdict(list)
    for one in found:
        groups[one.place.at, one.place.tail, one.place.size].append(one)
    result = []
    for group in groups.values():
        best = group[0]
        starts = {best.place.start}
        others = []
        for other in group[1:]:
            if other.place.start not in starts and other.evidence.holds >= best.evidence.holds:
                starts.add(other.place.start)
                others.append(f"{other.name or other.method.kind} from byte {other.place.start} on")
        result.append(replace(best, others=tuple(others)))
    return result


def _places(frames: Sequence[bytes], start: int, tail: int) -> Iterator[CheckPlace]:
    """Yield the possible places of a check code with the ranges it may cover, usual places first."""
    shortest = sorted(map(len, frames))[len(frames) // 4]  # a few may be cut
    tails = dict.fromkeys((tail, *range(LARGEST_TAIL + 1)))
    starts = list(dict.fromkeys((0, start, *range(LARGEST_START + 1))))
    for after in tails:
        for size in (2, 1, 4, 3):
            for stop in _stops(frames, size + after):
                for first in starts:
                    if first + stop + size + after >= shortest:
                        continue
                    orders: tuple[Order, ...] = ("big",) if size == 1 else ("little", "big")
                    for order in orders:
                        yield CheckPlace(size, order, tail=after, start=first, stop=stop)
        if all(_digits(frame[len(frame) - after - 2 : len(frame) - after]) for frame in frames[:20]):
            for size in (4, 2, 8, 6):
                for stop in _stops(frames, size + after):
                    for first in starts[:4]:
                        if first + stop + size + after >= shortest:
                            continue
                        orders = ("big",) if size == 2 else ("big", "little")
                        for order in orders:
                            place = CheckPlace(size, order, "hex", after, start=first, stop=stop)
                            yield place
                            yield replace(place, counted="hex")
    for at in range(start, min(start + LARGEST_START, shortest - 3)):
        for size in (1, 2):
            for stop in dict.fromkeys((0, tail)):
                orders = ("big",) if size == 1 else ("little", "big")
                for order in orders:
                    yield CheckPlace(size, order, at=at, stop=stop)


def _stops(frames: Sequence[bytes], behind: int) -> tuple[int, ...]:
    """Return the numbers of uncovered bytes to try before a code: 0, or also 1 if that byte is nearly constant, such as
    `*`.
    """
    before = Counter(frame[-behind - 1] for frame in frames if len(frame) > behind)
    return (0, 1) if before and before.most_common(1)[0][1] >= 0.9 * len(frames) else (0,)


def _cuts(place: CheckPlace, frames: Sequence[bytes]) -> list[CountedBytes]:
    cuts = [cut_at(place, frame) for frame in frames]
    return list(dict.fromkeys(cut for cut in cuts if cut is not None))


def _bytes_of(place: CheckPlace) -> int:
    return place.size // 2 if place.form == "hex" else place.size


def _at_place(place: CheckPlace, frames: Sequence[bytes]) -> Iterator[CheckGuess]:
    cuts = _cuts(place, frames)
    if len(cuts) < max(3, NEARLY * len(frames)) or len({cut.code for cut in cuts}) < min(LEAST_CODES, len(cuts) / 2):
        return
    width = 8 * _bytes_of(place)
    if width <= 16:
        yield from _simple(place, cuts, width, len(frames))
    yield from _crcs(place, cuts, width, len(frames))


# ---- sums and exclusive ors -------------------------------------------------------------------------------------


@cache
def _plain_methods(width: int) -> tuple[tuple[CheckMethod, bool], ...]:
    """Return the methods of a width that start at 0, each with whether it adds (True) or combines by exclusive or
    (False).
    """
    names = {8: ("sum8", "xor8"), 16: ("sum16", "wsum16", "wsum16-little", "xor16", "xor16-little")}[width]
    return tuple((ready_methods()[name], "sum" in name) for name in names)


def _simple(place: CheckPlace, cuts: Sequence[CountedBytes], width: int, of: int) -> Iterator[CheckGuess]:
    ones = (1 << width) - 1
    sample = cuts[:: max(1, len(cuts) // 12)][:12]
    for method, adds in _plain_methods(width):
        for complement in ("", "twos") if adds else ("",):
            if _mode(sample, method, adds, complement, ones)[1] < 0.6 * len(sample):
                continue
            constant, held = _mode(cuts, method, adds, complement, ones)
            if held >= MOST * of:
                yield from _simple_guess(place, cuts, method, constant, complement, held, of)
    if width == 8 and all(cut.code < 0x80 for cut in cuts):
        for name in ("sum7", "xor7"):
            held = sum(compute(ready_methods()[name], cut.data) == cut.code for cut in cuts)
            if held >= MOST * of and 7 * (held - 1) - TRIED >= SURE and not _is_copy(cuts, 0.6):
                yield CheckGuess(place, ready_methods()[name], name, Evidence(held, of, 7 * (held - 1) - TRIED))
    if width == 16:
        held = sum(fletcher(cut.data) == cut.code for cut in cuts)
        if held >= MOST * of and 16 * held - TRIED >= SURE:
            method = CheckMethod(name="fletcher", kind="fold", width=16, expression=parse_expression(FLETCHER, NOWHERE))
            yield CheckGuess(place, method, "", Evidence(held, of, 16.0 * held - TRIED))


def _mode(
    cuts: Sequence[CountedBytes], method: CheckMethod, adds: bool, complement: str, ones: int
) -> tuple[int, int]:  # fmt: skip
    """Return the most frequent constant between code and method, and the number of frames with it."""
    if not adds:
        rests = Counter(cut.code ^ compute(method, cut.data) for cut in cuts)
    elif complement:
        rests = Counter(cut.code + compute(method, cut.data) & ones for cut in cuts)
    else:
        rests = Counter(cut.code - compute(method, cut.data) & ones for cut in cuts)
    return rests.most_common(1)[0]


def _simple_guess(
    place: CheckPlace,
    cuts: Sequence[CountedBytes],
    method: CheckMethod,
    constant: int,
    complement: str,
    held: int,
    of: int,
) -> Iterator[CheckGuess]:
    width, ones = method.width, (1 << method.width) - 1
    chance = width * (held - 1) - TRIED
    if width > 8 and constant and _swallows_mark(cuts):
        return
    if chance < SURE or _is_copy(cuts, 0.9 if held >= 0.95 * of else 0.6):
        return
    name = method.name
    if complement and constant == ones:
        found = _changed(method, complement="ones")
    elif complement:
        found = ready_methods()["lrc8"] if not constant and name == "sum8" else _changed(
            method, complement="twos", initial=-constant & ones
        )  # fmt: skip
    else:
        found = method if not constant else _changed(method, initial=constant)
    ready = found.name if found in ready_methods().values() else ""
    yield CheckGuess(place, found, ready, Evidence(held, of, chance))


def _swallows_mark(cuts: Sequence[CountedBytes]) -> bool:
    """Return whether a byte of the code is constant and neither 00 nor FF: then it is a mark next to a shorter code."""
    for shift in (0, 8):
        value, often = Counter(cut.code >> shift & 0xFF for cut in cuts).most_common(1)[0]
        if often >= 0.9 * len(cuts) and value not in (0, 0xFF):
            return True
    return False


def _changed(method: CheckMethod, **parameters: object) -> CheckMethod:
    return replace(method, name="own", **parameters)  # type: ignore[arg-type]


def _is_copy(cuts: Sequence[CountedBytes], share: float) -> bool:
    """Return whether a byte of the code depends on a single byte of the frame in at least `share` of the frames, as the
    bytes of two counters do.
    """
    shortest = min(len(cut.data) for cut in cuts)
    for shift in (0, 8):
        codes = [cut.code >> shift & 0xFF for cut in cuts]
        if len(set(codes)) < 2:
            continue
        for place in [*range(min(shortest, 32)), *range(-min(shortest, 8), 0)]:
            column = [cut.data[place] for cut in cuts]
            if len(set(column)) < 2:
                continue
            for combined in (
                [code - byte & 0xFF for code, byte in zip(codes, column, strict=True)],
                [code + byte & 0xFF for code, byte in zip(codes, column, strict=True)],
                [code ^ byte for code, byte in zip(codes, column, strict=True)],
            ):
                if Counter(combined).most_common(1)[0][1] >= share * len(cuts):
                    return True
    return False


def _exclusive_or(place: CheckPlace, frames: Sequence[bytes]) -> Iterator[CheckGuess]:
    """Yield the exclusive or of eight bits, over the range that needs no constant; else over the range of `place`."""
    method = ready_methods()["xor8"]
    starts = dict.fromkeys((place.start, *range(LARGEST_START + 1)))
    ranges = [replace(place, start=start, stop=stop) for start in starts for stop in dict.fromkeys((place.stop, 0, 1))]
    found: list[CheckGuess] = []
    for one in ranges:
        cuts = _cuts(one, frames)
        if len(cuts) < max(4, NEARLY * len(frames)):
            continue
        constant, held = _mode(cuts, method, False, "", 0xFF)
        if held >= MOST * len(frames):
            found += _simple_guess(one, cuts, method, constant, "", held, len(frames))
    yield from [one for one in found if one.name][:1] or found[:1]


# ---- CRCs -------------------------------------------------------------------------------------------------------


def _pairs(cuts: Sequence[CountedBytes]) -> list[tuple[CountedBytes, CountedBytes]]:
    """Return pairs of different frames of equal size; each frame is used once."""
    groups: dict[int, list[CountedBytes]] = defaultdict(list)
    for cut in cuts:
        groups[len(cut.data)].append(cut)
    found = []
    for group in sorted(groups.values(), key=len, reverse=True):
        found += [(one, two) for one, two in zip(group[::2], group[1::2], strict=False) if one.data != two.data]
    return found


def _crcs(place: CheckPlace, cuts: Sequence[CountedBytes], width: int, of: int) -> Iterator[CheckGuess]:
    pairs = _pairs(cuts)
    step = max(1, len(pairs) // MOST_PAIRS)
    some = pairs[::step][:MOST_PAIRS]
    alone = cuts[:: max(1, len(cuts) // MOST_PAIRS)][:MOST_PAIRS]
    changed = [(_combined(one.data, two.data), one.code ^ two.code) for one, two in some]
    for family in families():
        if family.width != width:
            continue
        if len(some) >= 2:
            if _agrees(family, changed):
                yield from _with_start(place, cuts, family, of)
        else:
            yield from _ready_in(place, cuts, alone, family, of)


def _combined(one: bytes, two: bytes) -> bytes:
    """Return the exclusive or of two byte strings of equal size."""
    return (int.from_bytes(one, "big") ^ int.from_bytes(two, "big")).to_bytes(len(one), "big")


def _agrees(family: Family, changed: Sequence[tuple[bytes, int]]) -> bool:
    """Return whether at least two pairs, and at least 60 % of them, differ as the CRC family requires."""
    wrong = 0
    for data, code in changed:
        wrong += plain_crc(data, *family) != code
        if wrong > 0.4 * len(changed):
            return False
    return len(changed) - wrong >= 2


def _ready_in(
    place: CheckPlace, cuts: Sequence[CountedBytes], alone: Sequence[CountedBytes], family: Family, of: int
) -> Iterator[CheckGuess]:
    """Yield the catalogued CRCs of a family, for lines with too few frames of equal size."""
    for (other, init, xorout), name in _ready_crcs().items():
        if other != family:
            continue
        good = sum(plain_crc(cut.data, *family, init) ^ xorout == cut.code for cut in alone)
        if good >= 0.6 * len(alone):
            held = sum(plain_crc(cut.data, *family, init) ^ xorout == cut.code for cut in cuts)
            chance = family.width * held - TRIED
            if held >= NEARLY * of and chance >= SURE:
                yield CheckGuess(place, ready_methods()[name], name, Evidence(held, of, chance))


def _with_start(place: CheckPlace, cuts: Sequence[CountedBytes], family: Family, of: int) -> Iterator[CheckGuess]:
    """Yield a CRC of the family, with initial register and final value that explain the frames."""
    rests: dict[int, Counter[int]] = defaultdict(Counter)
    for cut in cuts:
        rests[len(cut.data)][cut.code ^ plain_crc(cut.data, *family)] += 1
    known = {size: counts.most_common(1)[0] for size, counts in rests.items()}
    if all(often < 2 for _, often in known.values()):
        return
    ones = (1 << family.width) - 1
    likely = [init for (other, init, _) in _ready_crcs() if other == family]
    found = 0
    for init, xorout in starts_of(known, *family, [*likely, 0, ones]):
        held = sum(plain_crc(cut.data, *family, init) ^ xorout == cut.code for cut in cuts)
        if held < (NEARLY if family.width >= 16 else MOST) * of:
            continue
        fitted = 1 if len(known) == 1 or init in (0, ones, *likely) else 2
        chance = family.width * (held - fitted - 1) - TRIED
        name = _ready_crcs().get((family, init, xorout), "")
        if name:
            chance = family.width * held - TRIED
        if chance < SURE:
            continue
        method = ready_methods()[name] if name else CheckMethod(
            name="own", kind="crc", width=family.width, poly=family.poly, initial=init, refin=family.refin,
            refout=family.refout, xorout=xorout,
        )  # fmt: skip
        usual = init in (0, ones, *likely) or xorout in (0, ones)
        is_sure = bool(name) or (held >= 0.9 * of and (len(known) > 2 or (len(known) == 2 and usual)))
        yield CheckGuess(place, method, name, Evidence(held, of, chance), is_sure=is_sure)
        found += 1
        if found == MOST_SOLVED:
            return


def _by_algebra(place: CheckPlace, frames: Sequence[bytes]) -> Iterator[CheckGuess]:
    """Yield CRCs whose polynomial is not in the catalogue."""
    if place.counted == "hex" and place.form != "hex":
        return
    cuts = _cuts(place, frames)
    width = 8 * _bytes_of(place)
    if len(cuts) < max(4, NEARLY * len(frames)) or len({cut.code for cut in cuts}) < 3:
        return
    pairs = _pairs(cuts)
    if len(pairs) < 2:
        return
    for mirrored in (False, True):
        tried: set[int] = set()
        for turn in range(3):
            some = pairs[turn::3] if len(pairs) >= 12 else pairs
            multiples = [difference(one.data, two.data, one.code ^ two.code, width, mirrored) for one, two in some[:6]]
            differences = [one for one in multiples if one]
            if len(differences) < 2:
                continue
            for poly in polynomials(differences, width):
                if poly in tried:
                    continue
                tried.add(poly)
                if poly == 1 and width == 8:  # a CRC with this polynomial is the exclusive or of the bytes
                    yield from _exclusive_or(place, frames)
                    continue
                family = Family(width, poly, mirrored, mirrored)
                yield from _with_start(place, cuts, family, len(frames))
            if len(pairs) < 12:
                break
