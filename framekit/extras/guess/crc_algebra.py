"""CRC parameters by algebra: the polynomial as common divisor of differences, and the initial register.

Two frames of one size with the codes c and d over the data A and B: whatever init and xorout are, c ^ d is the
remainder of (A ^ B)·x^w. So the polynomial divides (A ^ B)·x^w ^ c ^ d; the greatest common divisor of several such
differences is usually the polynomial itself. Polynomials over GF(2) are whole numbers here, the lowest power in the
lowest bit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache

from framekit.codec.support import crc, make_crc_table, reflect

MIRROR = bytes(reflect(byte, 8) for byte in range(256))
MOST_FACTOR = 8
"""Largest degree of the extra factor that the differences may share by chance."""
MOST = 0.7
"""Least share of frames that an initial register must explain."""


def remainder(number: int, divisor: int) -> int:
    """Return the remainder of polynomial `number` divided by `divisor`."""
    degree = divisor.bit_length()
    while (excess := number.bit_length() - degree) >= 0:
        number ^= divisor << excess
    return number


def quotient(number: int, divisor: int) -> int | None:
    """Return the polynomial that gives `number` when multiplied by `divisor`; None if there is a remainder."""
    found, degree = 0, divisor.bit_length()
    while (excess := number.bit_length() - degree) >= 0:
        number ^= divisor << excess
        found |= 1 << excess
    return None if number else found


def common_divisor(numbers: Iterable[int]) -> int:
    """Return the greatest common divisor of polynomials; 0 if all are 0."""
    found = 0
    for number in numbers:
        rest = number
        while rest:
            found, rest = rest, remainder(found, rest)
    return found


def difference(one: bytes, other: bytes, code: int, width: int, mirrored: bool) -> int:
    """Return a multiple of the polynomial: computed from two data of equal size and the exclusive or of their codes."""
    if mirrored:
        one, other, code = one.translate(MIRROR), other.translate(MIRROR), reflect(code, width)
    return (int.from_bytes(one, "big") ^ int.from_bytes(other, "big")) << width ^ code


def polynomials(differences: Sequence[int], width: int) -> Iterator[int]:
    """Yield the polynomials of degree `width` that divide all differences, without their highest power."""
    found = common_divisor(differences)
    extra = found.bit_length() - 1 - width
    if not 0 <= extra <= MOST_FACTOR:
        return
    for factor in range(1 << extra, 2 << extra):
        poly = quotient(found, factor)
        if poly is not None and poly & 1:
            yield poly ^ 1 << width


@cache
def table_of(width: int, poly: int, refin: bool) -> tuple[int, ...]:
    """Return the lookup table for `crc`."""
    return make_crc_table(width, poly, refin)


def plain_crc(data: bytes, width: int, poly: int, refin: bool, refout: bool, init: int = 0) -> int:
    """Return the CRC with final value 0."""
    return crc(data, table_of(width, poly, refin), width, init, refin, refout, 0)


def starts_of(
    rests: Mapping[int, tuple[int, int]], width: int, poly: int, refin: bool, refout: bool, likely: Sequence[int]
) -> Iterator[tuple[int, int]]:
    """Yield pairs (init, xorout) that may explain the codes.

    `rests`: for each size of the data, the exclusive or of the code and the CRC with init 0, and the number of frames
    with it. The order is: pairs that explain all sizes, with likely registers first and then registers solved from the
    sizes; likely registers that explain most frames; registers solved from the sizes that most frames have.
    """

    def xorout_of(init: int) -> tuple[int, float]:
        counts = Counter[int]()
        for size, (rest, often) in rests.items():
            counts[rest ^ plain_crc(bytes(size), width, poly, refin, refout, init)] += often
        best, often = counts.most_common(1)[0]
        return best, often / counts.total()

    found = [(init, *xorout_of(init)) for init in dict.fromkeys(likely)]
    yield from ((init, xorout) for init, xorout, share in found if share == 1)
    often = sorted(rests, key=lambda size: -rests[size][1])
    if all(share < 1 for _, _, share in found):
        for init in _solved({size: rests[size][0] for size in often}, width, poly, refin, refout):
            yield init, xorout_of(init)[0]
    yield from ((init, xorout) for init, xorout, share in found if MOST <= share < 1)
    if all(share < MOST for _, _, share in found):
        for sizes in (often[:3], often[:2]):
            for init in _solved({size: rests[size][0] for size in sizes}, width, poly, refin, refout):
                yield init, xorout_of(init)[0]


def _solved(rests: Mapping[int, int], width: int, poly: int, refin: bool, refout: bool) -> Iterator[int]:
    """Yield the initial registers that explain how the rests of several sizes differ, by linear equations over
    GF(2).
    """
    sizes = sorted(rests)
    if len(sizes) < 2:
        return
    first = sizes[0]
    rows: list[tuple[int, int]] = []
    unit = [
        {size: plain_crc(bytes(size), width, poly, refin, refout, 1 << bit) for size in sizes} for bit in range(width)
    ]
    for size in sizes[1:]:
        wanted = rests[size] ^ rests[first]
        columns = [unit[bit][size] ^ unit[bit][first] for bit in range(width)]
        for place in range(width):
            row = sum((columns[bit] >> place & 1) << bit for bit in range(width))
            rows.append((row, wanted >> place & 1))
    pivots: dict[int, tuple[int, int]] = {}
    for row, value in rows:
        while row:
            top = row.bit_length() - 1
            if top not in pivots:
                pivots[top] = row, value
                break
            other, other_value = pivots[top]
            row, value = row ^ other, value ^ other_value
        else:
            if value:
                return
    init = 0
    for top in sorted(pivots):
        row, value = pivots[top]
        lower = (row & ((1 << top) - 1) & init).bit_count() & 1
        if value ^ lower:
            init |= 1 << top
    yield init
