"""CRCs by algebra: the polynomial that divides what frames differ in, and what a register began with.

Two frames of one size with the codes c and d over the data A and B: whatever init and xorout are, c ^ d is the
remainder of (A ^ B)·x^w. So the polynomial divides (A ^ B)·x^w ^ c ^ d; the greatest common divisor of several such is
the polynomial itself, mostly. Polynomials over GF(2) are whole numbers here, the lowest power in the lowest bit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache

from framekit.codec.support import crc, make_crc_table, reflect

MIRROR = bytes(reflect(byte, 8) for byte in range(256))
MOST_FACTOR = 8
"""The degree of what else the differences may have in common, at most."""
MOST = 0.7
"""A register that explains so much of the frames is one that they began with."""


def remainder(number: int, divisor: int) -> int:
    """What is left of a polynomial."""
    degree = divisor.bit_length()
    while (excess := number.bit_length() - degree) >= 0:
        number ^= divisor << excess
    return number


def quotient(number: int, divisor: int) -> int | None:
    """Return the polynomial that times `divisor` is `number`; None: there is none."""
    found, degree = 0, divisor.bit_length()
    while (excess := number.bit_length() - degree) >= 0:
        number ^= divisor << excess
        found |= 1 << excess
    return None if number else found


def common_divisor(numbers: Iterable[int]) -> int:
    """Return the greatest polynomial that divides all of them; 0 for none."""
    found = 0
    for number in numbers:
        rest = number
        while rest:
            found, rest = rest, remainder(found, rest)
    return found


def difference(one: bytes, other: bytes, code: int, width: int, mirrored: bool) -> int:
    """What the polynomial divides: of two data of one size, and the exclusive or of their codes."""
    if mirrored:
        one, other, code = one.translate(MIRROR), other.translate(MIRROR), reflect(code, width)
    return (int.from_bytes(one, "big") ^ int.from_bytes(other, "big")) << width ^ code


def polynomials(differences: Sequence[int], width: int) -> Iterator[int]:
    """Polynomials of this degree that divide all of the differences, without their highest power."""
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
    """Return the table for `crc`."""
    return make_crc_table(width, poly, refin)


def plain_crc(data: bytes, width: int, poly: int, refin: bool, refout: bool, init: int = 0) -> int:
    """Return the code without anything put on at the end."""
    return crc(data, table_of(width, poly, refin), width, init, refin, refout, 0)


def starts_of(
    rests: Mapping[int, tuple[int, int]], width: int, poly: int, refin: bool, refout: bool, likely: Sequence[int]
) -> Iterator[tuple[int, int]]:
    """(init, xorout) that may explain what is left of the codes.

    `rests`: by the size of the data, for init 0, and in how many frames. First those that explain all sizes, the likely
    registers before what follows from the sizes; then likely ones that explain most frames; then what follows from the
    sizes that most frames have.
    """

    def xorout_of(init: int) -> tuple[int, float]:
        told = Counter[int]()
        for size, (rest, often) in rests.items():
            told[rest ^ plain_crc(bytes(size), width, poly, refin, refout, init)] += often
        best, often = told.most_common(1)[0]
        return best, often / told.total()

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
    """Registers at the start that explain how the rests of several sizes differ: linear equations over GF(2)."""
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
            other, told = pivots[top]
            row, value = row ^ other, value ^ told
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
