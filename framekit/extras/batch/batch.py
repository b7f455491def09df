"""Decode many frames at once, in columns, with NumPy if it is installed; the values equal those of `decode`.

A plan describes frames of one length: columns, tests, and the span of the inner frame. Only simple segments have a
plan: constants, numbers of whole bytes, bits, bytes, a length, and a check code over the whole frame. Frames with other
segments or conditions are decoded individually.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from framekit.codec import support
from framekit.codec.codec import Context
from framekit.codec.columns import Batch, BatchGroup, Cut, Path
from framekit.codec.errors import FrameError
from framekit.codec.python.choices import fixed_bytes
from framekit.codec.python.expressions import constant_of
from framekit.definition.expression import Expression, Name, names_in
from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.frames import Frame, StaticSizes, fixed_size
from framekit.definition.model.segments import Bits, Check, Const, Count, Data, Field, FieldType, Inner, Length, Segment


@dataclass(frozen=True, slots=True)
class Column:
    """A value at a fixed offset: a number or bytes, or some bits of a number."""

    path: Path
    offset: int
    size: int
    """Size in bytes."""
    order: str = ""
    """Byte order of a number; '' for bytes."""
    signed: bool = False
    shift: int = 0
    """Position of the lowest bit."""
    mask: int = 0
    """Mask of the bits after the shift; 0 for the whole number."""
    allowed: tuple[int, ...] | None = None
    limits: tuple[int, int] | None = None


@dataclass(slots=True)
class BatchPlan:
    """The plan of frames of one length."""

    columns: list[Column] = field(default_factory=list)
    """The values, in frame order."""
    constants: list[tuple[int, bytes]] = field(default_factory=list)
    """Offset and bytes of each constant."""
    check: tuple[CheckMethod, int, int, str] | None = None
    """Method, offset, size and byte order of the check code."""
    requires: list[tuple[Path, ...]] = field(default_factory=list)
    """For each condition the paths that it reads."""
    inner: tuple[int, int, Path, tuple[str, ...]] | None = None
    """Offset, size, path and candidates of the inner frame."""


class NoPlanError(Exception):
    """Raised for a segment that plans do not support, or a length that the frame cannot have."""


class BatchPlanner:
    """Make plans of a protocol's frames."""

    def __init__(self, frames: Mapping[str, Frame]) -> None:
        self._frames = frames
        self._static = StaticSizes(frames)

    def plan(self, name: str, size: int, offset: int = 0, path: Path = ()) -> BatchPlan:
        """Return the plan of a frame of `size` bytes at `offset`. Raises NoPlanError."""
        frame = self._frames[name]
        if frame.most is not None and size > frame.most:
            raise NoPlanError
        segments = self._static.segments(frame)
        fixed = [_fixed(segment) for segment in segments]
        loose = fixed.count(None)
        room = size - sum(one for one in fixed if one is not None)
        if loose > 1 or room < 0 or (not loose and room):
            raise NoPlanError
        plan = BatchPlan()
        sizes: dict[str, int] = {}
        whole = zip(segments, fixed, strict=True)
        for segment, known in [(segment, room if known is None else known) for segment, known in whole]:
            if segment.name is not None:
                sizes[segment.name] = known
            self._add(plan, segment, offset, known, path, segments)
            offset += known
        for segment in segments:
            if isinstance(segment, Length):
                self._add_length(plan, segment, sizes, path)
            elif segment.condition is not None:
                read = {(*path, name) for name in names_in(segment.condition.root)}
                plan.requires.append(tuple(column.path for column in plan.columns if column.path in read))
        return plan

    def _add(
        self, plan: BatchPlan, segment: Segment, offset: int, size: int, path: Path, segments: tuple[Segment, ...]
    ) -> None:
        if segment.when is not None:
            raise NoPlanError
        match segment:
            case Const(data=data):
                plan.constants.append((offset, data))
            case Field() | Length() | Count():
                plan.columns.append(_number(segment, offset, path))
            case Bits():
                plan.columns += _bits(segment, offset, path)
            case Data(convert=None, swap=0, pad=None, least=0, never=b""):
                _known_size(segment, segments)
                plan.columns.append(Column((*path, segment.name), offset, size))
            case Inner(size=None) if not path:
                frames = sorted(segment.frames, key=lambda frame: self._frames[frame].refuse is not None)
                plan.inner = offset, size, (segment.name,), tuple(frames)
            case Check() if segment is segments[-1] and not path:
                plan.check = _check(segment, offset)
            case _ if not segment.is_ignored and segment.condition is None:
                raise NoPlanError

    def _add_length(self, plan: BatchPlan, length: Length, sizes: Mapping[str, int], path: Path) -> None:
        if len(length.of) != 1 or length.of[0] not in sizes or length.unit != 1 or length.plus:
            raise NoPlanError
        where = next(place for place, column in enumerate(plan.columns) if column.path == (*path, length.name))
        old = plan.columns[where]
        plan.columns[where] = Column(
            old.path, old.offset, old.size, old.order, old.signed, allowed=(sizes[length.of[0]],), limits=old.limits
        )


def _fixed(segment: Segment) -> int | None:
    """Return the fixed size of a segment in bytes, or None if the frame's length determines it. Raises NoPlanError."""
    if isinstance(segment, Inner):
        return None
    size = fixed_size(segment)
    if size is None and not isinstance(segment, Data):
        raise NoPlanError
    return size


def _number(segment: Field | Length | Count, offset: int, path: Path) -> Column:
    allowed: tuple[int, ...] | None = None
    if segment.zero_means is not None or isinstance(segment, Count):
        raise NoPlanError
    if isinstance(segment, Field):
        if segment.long is not None or segment.unit is not None or segment.plus:
            raise NoPlanError
        constant = constant_of(segment.is_)
        if segment.is_ is not None and constant is None:
            raise NoPlanError
        if constant is not None:
            allowed = (constant,)
        elif segment.constants is not None:
            allowed = tuple(value for value in segment.constants if isinstance(value, int))
        elif segment.only and segment.values is not None:
            allowed = tuple(segment.values)
    size, order = _plain(segment.type)
    return Column(
        (*path, segment.name), offset, size, order, segment.type.signed, allowed=allowed, limits=segment.limits
    )


def _bits(segment: Bits, offset: int, path: Path) -> list[Column]:
    size, order = _plain(segment.type)
    if segment.type.signed:
        raise NoPlanError
    columns = []
    for part in segment.parts:
        constant = constant_of(part.is_)
        if part.is_ is not None and constant is None:
            raise NoPlanError
        allowed = part.constants if constant is None else (constant,)
        mask = (1 << part.high - part.low + 1) - 1
        columns.append(Column((*path, part.name), offset, size, order, False, part.low, mask, allowed))
    return columns


def _plain(type_: FieldType) -> tuple[int, str]:
    """Return size and byte order of a plain number. Raises NoPlanError for other types."""
    if type_.kind != "int" or type_.fixed_size not in (1, 2, 4, 8) or type_.order not in ("big", "little"):
        raise NoPlanError
    return type_.fixed_size, type_.order


def _known_size(data: Data, segments: tuple[Segment, ...]) -> None:
    """Raise NoPlanError unless the size follows from the frame's length.

    That is a number, the rest, or a length that counts only these data.
    """
    if isinstance(data.size, Expression):
        root = data.size.root
        lengths = [one for one in segments if isinstance(one, Length) and one.of == (data.name,)]
        if not isinstance(root, Name) or root.name not in [one.name for one in lengths]:
            raise NoPlanError


def _check(check: Check, offset: int) -> tuple[CheckMethod, int, int, str]:
    if check.form != "raw" or check.verify != "error" or check.covers is not None:
        raise NoPlanError
    return check.method, offset, check.size, check.order


def codes_of(numpy: Any, method: CheckMethod, table: Any) -> Any:
    """Return the check codes of every row of `table` (rows × bytes) as 64-bit numbers.

    None for an unsupported method.
    """
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
    """Compute a CRC byte by byte, for all rows together."""
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


# ---- decoding ------------------------------------------------------------------------------------------------

if TYPE_CHECKING:
    from framekit.codec.codec import Codec

try:
    import numpy
except ImportError:  # NumPy is an optional dependency
    numpy = None  # type: ignore[assignment]

CHUNK = 65536
"""Frames that are processed together: many enough to amortize NumPy's calls, few enough for the processor's cache."""
MANY = 4096
"""Limit of the distinct inputs of a condition that are tested individually.

With more, all frames are decoded singly.
"""


class BatchDecoder:
    """Decode many frames called `frame` of a codec, with the context `ctx` as for `decode`."""

    def __init__(self, codec: Codec, frame: str, ctx: Context | None = None) -> None:
        """Raise KeyError for an unknown frame."""
        self._decode_one = codec.decoders[frame]
        self._frame = frame
        self._frames = codec.protocol.frames
        self._ctx = codec.defaults if ctx is None else ctx
        self._planner = BatchPlanner(codec.protocol.frames)

    def decode(self, cut: Cut) -> Batch:
        """Return the values of all frames; the FrameError of an invalid frame is in `Batch.singles`."""
        groups: list[BatchGroup] = []
        left: list[int] = []
        if numpy is None:
            left = list(range(len(cut)))
        else:
            self._in_columns(cut, groups, left)
        singles = {index: self._single(cut[index]) for index in left}
        return Batch(len(cut), groups, singles)

    def _single(self, data: bytes) -> dict[str, Any] | FrameError:
        try:
            return self._decode_one(data, self._ctx)
        except FrameError as error:
            return error

    # ---- columns ------------------------------------------------------------------------------------------

    def _in_columns(self, cut: Cut, groups: list[BatchGroup], left: list[int]) -> None:
        buffer = numpy.frombuffer(cut.data, dtype=numpy.uint8)
        starts = numpy.frombuffer(cut.starts, dtype=numpy.int64)
        lengths = numpy.frombuffer(cut.lengths, dtype=numpy.int64)
        for size in numpy.unique(lengths).tolist():
            rows = numpy.flatnonzero(lengths == size)
            for first in range(0, len(rows), CHUNK):
                some = rows[first : first + CHUNK]
                table = buffer[starts[some][:, None] + numpy.arange(size)]
                left += _OneLength(self, table, some, cut, groups).take().tolist()

    def agrees(self, group: BatchGroup, cut: Cut) -> bool:
        """Return whether the group's first frame has the values that `decode` returns."""
        return self._single(cut[int(group.rows[0])]) == group.values(0)


class _OneLength:
    """Frames of one length: `table` holds a row of bytes for each, `rows` their numbers."""

    def __init__(self, decoder: BatchDecoder, table: Any, rows: Any, cut: Cut, groups: list[BatchGroup]) -> None:
        self.decoder = decoder
        self.table = table
        self.rows = rows
        self.cut = cut
        self.groups = groups
        self.left = numpy.zeros(len(rows), dtype=bool)

    def take(self) -> Any:
        """Form groups of frames; return the numbers of the frames that must be decoded individually."""
        size = self.table.shape[1]
        try:
            plan = self.decoder._planner.plan(self.decoder._frame, size)
        except NoPlanError:
            return self.rows
        good = self._check(plan)
        if good is None:
            return self.rows
        good &= self._fits(plan, self.table)
        self.left = ~good
        if plan.inner is None:
            self._group(numpy.flatnonzero(good), plan.columns, plan.requires)
        else:
            self._inside(plan, good)
        return self.rows[self.left]

    def _check(self, plan: BatchPlan) -> Any:
        """Return a mask of the rows with a correct check code; None if the method is not supported."""
        if plan.check is None:
            return numpy.ones(len(self.rows), dtype=bool)
        method, offset, size, order = plan.check
        codes = codes_of(numpy, method, self.table[:, :offset])
        if codes is None:
            return None
        return codes & (1 << 8 * size) - 1 == _numbers(self.table, Column((), offset, size, order))

    def _fits(self, plan: BatchPlan, table: Any) -> Any:
        """Return a mask of the rows whose constants and limits are correct."""
        good = numpy.ones(len(table), dtype=bool)
        for offset, data in plan.constants:
            good &= (table[:, offset : offset + len(data)] == numpy.frombuffer(data, numpy.uint8)).all(axis=1)
        for column in plan.columns:
            if column.allowed is not None:
                good &= _among(_numbers(table, column), column.allowed)
            if column.limits is not None:
                numbers = _numbers(table, column)
                good &= (numbers >= column.limits[0]) & (numbers <= column.limits[1])
        return good

    def _inside(self, plan: BatchPlan, good: Any) -> None:
        """Group rows by inner frame: each row belongs to the first candidate that no constant byte contradicts."""
        assert plan.inner is not None
        offset, size, path, frames = plan.inner
        open_ = good
        for name in frames:
            mine = open_.copy()
            for place, allowed in fixed_bytes(self.decoder._frames[name].segments):
                if place < size:
                    mine &= _among(self.table[:, offset + place], tuple(allowed))
            open_ = open_ & ~mine
            places = numpy.flatnonzero(mine)
            if not len(places):
                continue
            try:
                inner = self.decoder._planner.plan(name, size, offset, (*path, name))
            except NoPlanError:
                self.left |= mine
                continue
            fits = self._fits(inner, self.table[places])
            self.left[places[~fits]] = True
            places = places[fits]
            columns = [column for column in plan.columns if column.offset < offset]
            columns += inner.columns
            columns += [column for column in plan.columns if column.offset >= offset]
            self._group(places, columns, plan.requires + inner.requires)
        self.left |= open_

    def _group(self, places: Any, columns: list[Column], requires: list[tuple[Path, ...]]) -> None:
        if not len(places):
            return
        table = self.table[places]
        found: dict[Path, Any] = {column.path: _values(table, column) for column in columns}
        held = numpy.ones(len(places), dtype=bool)
        for paths in requires:
            held &= self._held([found[path] for path in paths], places)
        if not held.all():
            self.left[places[~held]] = True
            places = places[held]
            found = {path: column[held] for path, column in found.items()}
        group = BatchGroup(self.rows[places], found)
        if len(places) and self.decoder.agrees(group, self.cut):
            self.groups.append(group)
        else:
            self.left[places] = True

    def _held(self, columns: list[Any], places: Any) -> Any:
        """Return a mask of the rows that fulfil a condition over these columns.

        One frame of each distinct input is decoded.
        """
        key = numpy.zeros(len(places), dtype=numpy.int64)
        for column in columns:
            if column.ndim != 1:
                return numpy.zeros(len(places), dtype=bool)
            _, numbers = numpy.unique(column, return_inverse=True)
            key = key * (int(numbers.max()) + 1) + numbers
        _, examples, which = numpy.unique(key, return_index=True, return_inverse=True)
        if len(examples) > MANY:
            return numpy.zeros(len(places), dtype=bool)
        rows = self.rows[places[examples]].tolist()
        return numpy.array([type(self.decoder._single(self.cut[row])) is dict for row in rows])[which]


def _numbers(table: Any, column: Column) -> Any:
    """Return the numbers of a column."""
    kind = f"{'>' if column.order == 'big' else '<'}{'i' if column.signed else 'u'}{column.size}"
    raw = numpy.ascontiguousarray(table[:, column.offset : column.offset + column.size])
    numbers = raw.view(kind)[:, 0]
    if column.mask:
        numbers = numbers >> column.shift & column.mask
    return numbers


def _among(numbers: Any, allowed: tuple[int, ...]) -> Any:
    """Return a mask of the numbers that are allowed; a single allowed number, the usual case, needs no search."""
    return numbers == allowed[0] if len(allowed) == 1 else numpy.isin(numbers, allowed)


def _values(table: Any, column: Column) -> Any:
    """Return the numbers of a column in native byte order, or its rows of bytes."""
    if not column.order:
        return numpy.ascontiguousarray(table[:, column.offset : column.offset + column.size])
    numbers = _numbers(table, column)
    return numbers.astype(numbers.dtype.newbyteorder("="))
