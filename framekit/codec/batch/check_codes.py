"""Check codes of many rows of bytes at once. A method that is not known here has none, and its frames no batch."""

from __future__ import annotations

from typing import Any

from framekit.codec import support
from framekit.definition.model.checks import CheckMethod


def codes_of(numpy: Any, method: CheckMethod, table: Any) -> Any:
    """The codes of every row of `table` (rows × bytes), as numbers of 64 bits; None for an unknown method."""
    code = _raw(numpy, method, table)
    if code is None:
        return None
    ones = (1 << method.width) - 1
    if method.complement is not None:
        code = ~code if method.complement == "ones" else -code
    return code & (ones if method.mask is None else ones & method.mask)


def _raw(numpy: Any, method: CheckMethod, table: Any) -> Any:
    if method.kind == "sum":
        return table.sum(axis=1, dtype=numpy.int64) + method.initial
    if method.kind == "xor" and method.width == 8:
        return numpy.bitwise_xor.reduce(table, axis=1).astype(numpy.int64) ^ method.initial
    if method.kind == "crc" and 8 <= method.width <= 32 and method.refin == method.refout:
        return _crc(numpy, method, table)
    return None


def _crc(numpy: Any, method: CheckMethod, table: Any) -> Any:
    """Byte by byte, but all rows together."""
    width, steps = (
        method.width,
        numpy.array(support.make_crc_table(method.width, method.poly, method.refin), dtype=numpy.int64),
    )
    start = support.reflect(method.initial, width) if method.refin else method.initial
    code = numpy.full(len(table), start, dtype=numpy.int64)
    shift, low = width - 8, (1 << width - 8) - 1
    for place in range(table.shape[1]):
        byte = table[:, place]
        if method.refin:
            code = code >> 8 ^ steps[(code ^ byte) & 0xFF]
        else:
            code = (code & low) << 8 ^ steps[code >> shift ^ byte]
    return code ^ method.xorout
