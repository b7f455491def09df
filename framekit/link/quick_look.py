"""Judge the first bytes of a frame before it is decoded: its size, its decoder, and whether it may be good.

A quick look checks the check code at the end of a frame and the bytes at fixed offsets, and rejects candidates that
cannot be good. The codec judges frames that a quick look cannot handle.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import Any, Literal, NamedTuple

from framekit.codec.checks import function_of, residue_of
from framekit.codec.python.choices import Leaf, Switch, fixed_bytes, in_order, tree_of
from framekit.definition.expression import Expression, Name
from framekit.definition.model.frames import Frame, StaticSizes, parts_of
from framekit.definition.model.segments import Bits, Check, Const, Data, Field, Inner, Length, Segment

UNKNOWN = 1 << 62
"""A size that is larger than any frame."""


Fixed = tuple[int, frozenset[int]]
"""An offset in a frame, and the values that its byte can have."""


Intact = Callable[[bytes | bytearray], object]
"""Return whether these bytes may be good; a false result excludes a good frame and a frame that must be refused."""


class SizesByByte(NamedTuple):
    """The sizes of a frame by the byte at `at`, which selects the frame inside."""

    at: int
    sizes: Sequence[int | None]
    """The size by the value of the byte: 0 for no frame, `-most` if only silence ends the frame, None if the byte does
    not decide it."""
    counted: Sequence[int]
    """The offset of a byte whose value is added to the size, by the value of the byte at `at`; 0 for none."""
    most: int
    """The upper limit of the size; a larger sum has no meaning."""


NO_SIZES = SizesByByte(0, [None] * 256, [0] * 256, UNKNOWN)


Row = tuple[int, int, Callable[..., dict[str, Any]] | None]
"""The size of a good frame (0: no good frame), the offset of a byte that is added to the size (0: none), and the
decoder of the frame together with the frame inside, or None."""


class Quick(NamedTuple):
    """The decoding of good frames of one kind by the byte at `at`."""

    at: int
    rows: Sequence[Row | None]
    """The rows by the value of the byte; None if the codec must measure the frame."""


NOT_QUICK = Quick(0, [None] * 256)


def quick_of(
    frame: Frame,
    decode: Callable[..., dict[str, Any]] | None,
    by_byte: SizesByByte,
    shapes: StaticSizes,
    fused: tuple[int, Sequence[Any]] | None,
) -> Quick:
    """Return the decoding of good frames of a kind by one byte.

    `decode`: the decoder of a frame without a frame inside. `fused`: an offset, and by the value of its byte the
    decoders of the frame together with the frame inside.
    """
    if any(check.ends for check in parts_of(frame.segments, Check)):  # measuring checks this code already
        return NOT_QUICK
    fixed = None if frame.delimited else shapes.all(shapes.segments(frame)).fixed
    if fixed and decode is not None and (frame.most is None or fixed <= frame.most):
        return Quick(0, [(fixed, 0, decode)] * 256)
    if by_byte is NO_SIZES:
        return NOT_QUICK
    at, sizes, counted, _ = by_byte
    readers = fused[1] if fused is not None and fused[0] == at else [None] * 256
    every = zip(sizes, counted, readers, strict=True)
    rows = [None if size is None or size < 0 else (size, more, read) for size, more, read in every]
    return Quick(at, rows)


def sizes_by_byte(frame: Frame, shapes: StaticSizes) -> SizesByByte:
    """Return the sizes of a frame by the byte that selects the frame inside, or NO_SIZES."""
    place = next((place for place, one in enumerate(frame.segments) if isinstance(one, Inner)), 0)
    inner, around = frame.segments[place], (*frame.segments[:place], *frame.segments[place + 1 :])
    if not isinstance(inner, Inner) or inner.size is not None or inner.when is not None:
        return NO_SIZES
    if frame.size is not None or frame.most is None:
        return NO_SIZES
    tree = tree_of(shapes, in_order(shapes, inner.frames))
    if not isinstance(tree, Switch) or not all(_is_any(one, shapes) for one in around):
        return NO_SIZES
    more, most, before = shapes.all(around).least, frame.most, shapes.all(frame.segments[:place]).least

    def size_of(branch: Leaf | Switch) -> tuple[int | None, int]:
        size, counted = _size_inside(branch, tree.at, shapes)
        if not size or size == UNKNOWN:
            return -most if size else size, 0
        return (size + more if size + more <= most else None), counted and before + counted

    found = [size_of(tree.others)] * 256
    for byte, branch in tree.cases:
        found[byte] = size_of(branch)
    sizes, counted = zip(*found, strict=True)
    return SizesByByte(before + tree.at, sizes, counted, most)


Counted = tuple[int, int, int, Literal["big", "little"]]
"""The size of a frame is a constant plus the number between two offsets, in this byte order."""


def counted_of(frame: Frame, shapes: StaticSizes) -> Counted | None:
    """Return where a number counts all bytes of variable size of a frame; None if there is no such number."""
    if frame.size is not None or frame.delimited or frame.inside:
        return None
    place = 0
    for segment in frame.segments:
        fixed = shapes.present(segment).fixed if segment.when is None else None
        if (
            isinstance(segment, Length)
            and fixed in (1, 2, 4)
            and segment.type.kind == "int"
            and not segment.type.signed
        ):
            if (
                segment.unit != 1
                or segment.plain
                or segment.zero_means is not None
                or segment.type.order not in _ORDERS
            ):
                return None
            rest = 0
            for one in frame.segments:
                if one is not segment and not set(one.value_names).isdisjoint(segment.of):
                    continue
                size = shapes.present(one).fixed if one.when is None else None
                if size is None:
                    return None
                rest += size
            return rest - segment.plus, place, place + fixed, _ORDERS[segment.type.order]
        if fixed is None:
            return None
        place += fixed
    return None


_ORDERS: dict[str, Literal["big", "little"]] = {"big": "big", "little": "little"}


def _is_any(segment: Segment, shapes: StaticSizes) -> bool:
    """Return whether a segment is always present, has a fixed size and accepts any bytes."""
    if segment.when is not None or shapes.present(segment).fixed is None:
        return False
    if isinstance(segment, Field):
        return segment.constants is None and segment.is_ is None and segment.limits is None and segment.long is None
    return isinstance(segment, Data) or (isinstance(segment, Check) and not segment.ends)


def _size_inside(branch: Leaf | Switch, at: int, shapes: StaticSizes) -> tuple[int | None, int]:
    """Return the size of the only frame that the byte at `at` selects, and the offset of a byte to add, or 0.

    The size is `UNKNOWN` if only silence ends the frame, None if the byte does not decide it.
    """
    if isinstance(branch, Switch) or len(branch.frames) > 1:
        return None, 0
    if not branch.frames:
        return 0, 0
    frame = shapes.frames[branch.frames[0]]
    if frame.size is not None or frame.most is not None or frame.delimited:
        return None, 0
    size, places, counted = 0, dict[str, int](), 0
    for number, segment in enumerate(frame.segments, 1):
        is_last = number == len(frame.segments)
        if is_last and isinstance(segment, Data) and segment.size == "rest" and segment.when is None:
            return (UNKNOWN if size and not segment.least and not counted else None), 0
        if isinstance(segment, Length) and _is_byte(segment) and size and not counted:
            places[segment.name] = size
        elif not counted and (place := _counted_at(segment, places)):
            counted = place
        elif not _is_any(segment, shapes):
            is_telling = size == at and isinstance(segment, Field | Bits) and shapes.present(segment).fixed == 1
            if not is_telling or segment.when is not None:
                return None, 0
        size += shapes.present(segment).least
    return size, counted


def _is_byte(segment: Length) -> bool:
    """Return whether the segment is one byte that may have any value and represents this number."""
    type_ = segment.type
    return (
        segment.when is None and segment.limits is None and segment.zero_means is None
        and type_.kind == "int" and type_.fixed_size == 1 and not type_.signed
    )  # fmt: skip


def _counted_at(segment: Segment, places: Mapping[str, int]) -> int | None:
    """Return the offset of the number that is the size of these bytes, if `places` contains it."""
    if not isinstance(segment, Data) or segment.when is not None or segment.convert is not None or segment.least:
        return None
    size = segment.size
    return places.get(size.root.name) if isinstance(size, Expression) and isinstance(size.root, Name) else None


def intact_of(frame: Frame) -> Intact | None:
    """Return a quick look at the restricted bytes of a frame and at its check code; None for a frame with neither.

    The check code must always be at the end and cover all bytes before it.
    """
    check = _check_of(frame)
    restricted = tuple(restricted_bytes(frame, fixed_bytes(frame.segments, True), True))
    if not restricted or (check is None and frame.inside):  # frames inside may move its bytes
        return check

    fits = _fitting(restricted).match
    return fits if check is None else lambda raw: fits(raw) is not None and check(raw)


def _fitting(restricted: Iterable[tuple[int, frozenset[int]]]) -> re.Pattern[bytes]:
    """Compile a pattern of the allowed bytes at each offset, in ascending order; shorter data match it too."""
    pattern, end = b"", 0
    for place, allowed in restricted:
        one = b"[" + re.escape(bytes(sorted(allowed))) + b"]" if allowed else rb"[^\x00-\xff]"
        skipped = place - end
        pattern += b"(?:.{%d}|.{0,%d}\\Z)(?:%s|\\Z)" % (skipped, skipped, one) if skipped else b"(?:%s|\\Z)" % one
        end = place + 1
    return re.compile(pattern, re.DOTALL)


def any_of(looks: Sequence[Intact]) -> Intact:
    """Return whether one of these quick looks accepts the bytes."""
    different = tuple(dict.fromkeys(looks))
    return different[0] if len(different) == 1 else lambda raw: any(look(raw) for look in different)


def restricted_bytes(frame: Frame, found: Iterable[Fixed], digits: bool = False) -> Iterable[Fixed]:
    """Return the restricted bytes of a frame among the bytes `found`.

    The constants at the beginning are left out, because measuring compares them, and so is a tail that may move.
    """
    begin = 0
    for segment in frame.segments:
        if not isinstance(segment, Const) or segment.when is not None:
            break
        begin += len(segment.data)
    if frame.delimited or frame.size is not None:
        found = fixed_bytes(frame.head + frame.body, digits)
    return [one for one in found if one[0] >= begin]


def _check_of(frame: Frame) -> Intact | None:
    """Return a quick look at the check code at the end of a frame, before trailing constants.

    None if the code is in another form, or if it does not always have to be right.
    """
    count = len(frame.segments)
    while count and isinstance(one := frame.segments[count - 1], Const) and one.when is None and one.refuse is None:
        count -= 1
    last, behind = frame.segments[count - 1] if count else None, StaticSizes({}).all(frame.segments[count:]).least
    if not isinstance(last, Check) or last.form not in ("raw", "hex", "HEX"):
        return None
    if last.when is not None or last.verify != "error":
        return None
    if frame.size is not None and not frame.tail:  # padding follows the code
        return None
    if (
        not last.method.is_of_bytes
        or last.covers is not None
        or any(one.is_there_inside for one in parts_of(frame.segments, Segment))
    ):
        return None
    intact = _code_of(last) if last.form == "raw" else _digits_of(last)
    return intact if intact is None or not behind else _before(behind, intact)


@cache
def _before(behind: int, intact: Intact) -> Intact:
    """Return the same quick look without the last bytes; it is shared by all frames that have it."""
    return lambda raw: intact(raw[:-behind])


def _code_of(check: Check) -> Intact:
    return _look_at(
        function_of(check.method), residue_of(check.method, check.size, check.order), check.size, check.order
    )


@cache
def _look_at(code: Callable[..., int], residue: int | None, size: int, order: Literal["big", "little"]) -> Intact:
    """Return a quick look at a check code of `size` bytes at the end; it is shared by all frames that have it."""
    if residue is not None:
        return lambda raw: code(raw) == residue
    room = (1 << 8 * size) - 1

    def intact(raw: bytes | bytearray) -> bool:
        return raw[-size:] == (code(raw[:-size]) & room).to_bytes(size, order)

    return intact


def _digits_of(check: Check) -> Intact | None:
    return _look_at_digits(function_of(check.method)) if check.size == 2 else None


@cache
def _look_at_digits(code: Callable[..., int]) -> Intact:
    """Return a quick look at a check code of two digits at the end; it is shared by all frames that have it."""

    def intact(raw: bytes | bytearray) -> bool:
        return raw[-2:].upper() == b"%02X" % (code(raw[:-2]) & 0xFF)

    return intact
