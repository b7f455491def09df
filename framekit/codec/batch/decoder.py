"""Decodes many frames of one kind: those of one length together, by their plan; what does not fit, one by one.

The first row of every group is decoded by itself too; should the values differ, all of the group are. So a plan that
is wrong costs time, not values. Without NumPy everything is decoded one by one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from framekit.codec.batch.plan import BatchPlan, BatchPlanner, Column, NoPlanError, codes_of
from framekit.codec.batch.result import Batch, BatchGroup, Cut, Path
from framekit.codec.codec import Context
from framekit.codec.errors import FrameError
from framekit.codec.python.choices import fixed_bytes

if TYPE_CHECKING:
    from framekit.codec.codec import Codec

try:
    import numpy
except ImportError:  # an optional dependency
    numpy = None  # type: ignore[assignment]

CHUNK = 65536
"""Frames that are worked on together: enough that NumPy's calls cost nothing, few enough for the caches."""
MANY = 4096
"""So many different contents of a condition are tried one by one; if there are more, so are the frames."""


class BatchDecoder:
    """Decodes frames called `frame` of a codec. `ctx` as for `decode`."""

    def __init__(self, codec: Codec, frame: str, ctx: Context | None = None) -> None:
        """Raises KeyError for an unknown frame."""
        self._decode_one = codec.decoders[frame]
        self._frame = frame
        self._frames = codec.protocol.frames
        self._ctx = codec.defaults if ctx is None else ctx
        self._planner = BatchPlanner(codec.protocol.frames)

    def decode(self, cut: Cut) -> Batch:
        """The values of all frames. A frame that is none is told by its FrameError in `Batch.singles`."""
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
        """Whether the group's first frame has the values that `decode` gives."""
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
        """Makes groups; the numbers of the rows that are left over."""
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
        """Where the check code is right; None where it cannot be worked out here."""
        if plan.check is None:
            return numpy.ones(len(self.rows), dtype=bool)
        method, offset, size, order = plan.check
        codes = codes_of(numpy, method, self.table[:, :offset])
        if codes is None:
            return None
        return codes & (1 << 8 * size) - 1 == _numbers(self.table, Column((), offset, size, order))

    def _fits(self, plan: BatchPlan, table: Any) -> Any:
        """Where constants and limits are kept."""
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
        """The frame inside: each row goes to the first candidate that no constant byte contradicts."""
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
        """Where a condition over these columns holds: one frame of every different content is decoded by itself."""
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
    """The numbers of a column."""
    kind = f"{'>' if column.order == 'big' else '<'}{'i' if column.signed else 'u'}{column.size}"
    raw = numpy.ascontiguousarray(table[:, column.offset : column.offset + column.size])
    numbers = raw.view(kind)[:, 0]
    if column.mask:
        numbers = numbers >> column.shift & column.mask
    return numbers


def _among(numbers: Any, allowed: tuple[int, ...]) -> Any:
    """Where a number is one of a few; a single one, the usual case, needs no search."""
    return numbers == allowed[0] if len(allowed) == 1 else numpy.isin(numbers, allowed)


def _values(table: Any, column: Column) -> Any:
    """Numbers in the machine's order, or rows of bytes."""
    if not column.order:
        return numpy.ascontiguousarray(table[:, column.offset : column.offset + column.size])
    numbers = _numbers(table, column)
    return numbers.astype(numbers.dtype.newbyteorder("="))
