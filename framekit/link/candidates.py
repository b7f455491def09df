"""Candidates: the frames that can begin at a position of the stream, arranged in tables by their first bytes.

The tables are made once for each combination of expected frames and shared by all receivers of a frame table. For each
first byte, and for one more byte that distinguishes the candidates best, they hold the remaining candidates in levels
(expected frames, then other frames), grouped by their measuring function, and how the usual good frame is read.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from operator import itemgetter
from typing import Any

from framekit.definition.model.segments import Const
from framekit.link.frame_table import FrameInfo, FrameTable
from framekit.link.inside import rules_and_marks
from framekit.link.quick_look import NO_SIZES, Intact, SizesByByte, any_of

Infos = tuple[FrameInfo, ...]


class CandidateGroup:
    """Candidates that are measured by equal functions, so that one call measures all of them."""

    __slots__ = ("extent", "infos", "may_fit", "measure", "members", "name", "sizes")

    def __init__(self, members: Sequence[tuple[int, FrameInfo]]) -> None:
        self.members = tuple(members)
        """The frames, each with its index among all candidates of equal rank."""
        self.infos = tuple(info for _, info in members)
        first = self.infos[0]
        self.name = first.name
        """The name of the first frame: the key under which the progress of measuring is remembered."""
        self.sizes: SizesByByte | None = None if first.sizes is NO_SIZES else first.sizes
        """The sizes by one byte; None if they do not depend on one byte: then only `measure` determines the size."""
        self.extent, self.measure = first.extent, first.measure
        self.may_fit = any_intact(self.infos)
        """A quick look that is false for bytes that are no good frame of the group."""


def size_by_byte(
    table: SizesByByte, buffer: bytes | bytearray, place: int, end: int, quiet: int, lost: int
) -> int | None:
    """Return the result of measuring `buffer[place:end]` if the table of sizes determines it."""
    at, sizes, counted, most = table
    at += place
    size = sizes[buffer[at]] if at < end else None
    if not size:
        return size
    if size < 0:
        return quiet if end - place <= -size else lost
    more = counted[buffer[at]]
    if more:
        if place + more >= end:
            return None
        size += buffer[place + more]
    if size > most:
        return None
    return size if place + size <= end else end - place - size


def _grouped(infos: Infos) -> tuple[CandidateGroup, ...]:
    alike: dict[Any, list[tuple[int, FrameInfo]]] = {}
    for member in enumerate(infos):
        alike.setdefault(function_does(member[1].extent), []).append(member)
    return tuple(CandidateGroup(members) for members in alike.values())


class CandidateLevel:
    """Candidates of equal rank: all expected frames, or all other frames, that can begin at a position."""

    __slots__ = ("groups", "infos", "is_holding", "names", "singles")

    def __init__(self, infos: Infos, holders: frozenset[str]) -> None:
        self.infos = infos
        self.names = tuple(info.name for info in infos)
        self.groups = _grouped(infos)
        self.singles = tuple(CandidateGroup([member]) for member in enumerate(infos))
        """Each frame as its own group, for positions where frames of one group end differently."""
        self.is_holding = not holders.isdisjoint(self.names)
        """Whether a candidate may hold frames in its middle."""


Levels = tuple[CandidateLevel, ...]


class Candidates:
    """The candidates at a position, by rank and together."""

    __slots__ = ("groups", "is_holding", "levels", "skip_at", "skips")

    def __init__(self, levels: Levels) -> None:
        self.levels = levels
        infos = tuple(info for level in levels for info in level.infos)
        self.groups = levels[0].groups if len(levels) == 1 else _grouped(infos)
        """All candidates, whatever their rank."""
        self.is_holding = any(level.is_holding for level in levels)
        self.skip_at, self.skips = _skips([info.sizes for info in infos])
        """For each value of the byte at `skip_at`, how many bytes exclude a frame; 0: no frame, None: unknown."""


FrameRow = tuple[
    int, int, Callable[..., dict[str, Any]], FrameInfo, Callable[[bytes, dict[str, Any]], bool] | None, tuple[str, ...]
]
"""How the only candidate is read: its size (0: measured), the index of a byte to be added to the size (0: none), the
decoder, the frame, a test of bytes and fields that is true where the candidates have to be compared, and the frames to
wait for until it has this size (none: the candidates have to be compared)."""


class Start:
    """The candidates that can begin with a certain byte."""

    __slots__ = ("at", "every", "left", "rows", "told_by")

    def __init__(self, every: Candidates, at: int, left: Sequence[Candidates]) -> None:
        self.every = every
        self.at = at
        """The index of the byte that excludes the most candidates; 0 if no byte does."""
        self.left = left
        """The remaining candidates for each value of the byte at `at`."""
        self.told_by = 0
        """The index of the byte that selects a row."""
        self.rows: list[FrameRow | None] = [None] * 256
        """How a good frame is read; None where no frame begins, or candidates have to be compared."""

    def add_rows(
        self, at: int, sole: Sequence[Sole | None], holders: Collection[str], marks: re.Pattern[bytes] | None
    ) -> None:
        """Fill `rows` from the sole candidate, if any, for each value of the byte at index `at` (0: for all values)."""
        first = sole[0]
        levels = self.every.levels
        alike = levels[0].names if levels and len(levels[0].groups) == 1 else ()
        self.told_by = at or (0 if first is None else first[0].quick.at)
        for byte, one in enumerate(sole):
            self.rows[byte] = None if one is None else _row(*one, alike, self.told_by, byte, holders, marks)


def _skips(tables: Sequence[SizesByByte]) -> tuple[int, Sequence[int | None]]:
    """Return the index of a byte that excludes candidates, and for its values how many bytes exclude all candidates.

    A frame that only silence ends is excluded by more bytes than its greatest length.
    """
    at = tables[0].at if tables else 0
    if any(one.at != at for one in tables):
        return 0, NO_SIZES.sizes
    sizes = [{table.sizes[byte] for table in tables} - {0} for byte in range(256)]
    return at, [
        None if None in found or any(size is not None and size > 0 for size in found)
        else max((-size for size in found if size is not None), default=0)
        for found in sizes
    ]  # fmt: skip


Sole = tuple[FrameInfo, bool]
"""The only remaining candidate, and whether constants exclude all other frames."""


def _row(
    info: FrameInfo,
    is_sure: bool,
    alike: tuple[str, ...],
    place: int,
    byte: int,
    holders: Collection[str],
    marks: re.Pattern[bytes] | None,
) -> FrameRow | None:
    """Return how the only candidate is read, given the byte at `place`; None if candidates have to be compared.

    `alike` are the candidates if all are measured alike, `holders` the frames that may hold others; `marks` matches the
    beginnings of these, if they are known.
    """
    if (holders and not is_sure) or (info.name in holders and marks is None):
        return None
    within = marks if info.name in holders else None
    quick = info.quick.rows[byte] if info.flat or info.quick.at == place else None
    if quick is None:
        waiting = () if info.guesses or info.counted is not None else alike or ((info.name,) if is_sure else ())
        return 0, 0, info.decode, info, _doubt(info.inner if info.guesses else None, within), waiting
    size, counted, read = quick
    if not size:
        return None
    doubt = _doubt(info.inner if info.guesses and not read else None, within)
    waiting = (info.name,) if is_sure and info.sizes is not NO_SIZES else ()
    return size, counted, read or info.decode, info, doubt, waiting


def _doubt(inner: str | None, marks: re.Pattern[bytes] | None) -> Callable[[bytes, dict[str, Any]], bool] | None:
    """Return a test for an unknown frame in field `inner`, or for `marks` among the bytes; None for no test."""
    if inner is None and marks is None:
        return None

    def is_doubtful(raw: bytes, fields: dict[str, Any]) -> bool:
        is_unknown = inner is not None and "unknown" in fields[inner]
        return is_unknown or (marks is not None and marks.search(raw) is not None)

    return is_doubtful


class ExpectedFrames:
    """The tables for a pair of name lists: expected frames, then other frames."""

    __slots__ = ("_found", "_holders", "_marks", "_rest", "_starts", "_table", "_wanted", "starting", "stops")

    def __init__(
        self, table: FrameTable, expected: tuple[str, ...], others: tuple[str, ...] = (), symbol: int | None = None
    ) -> None:
        self._table = table
        rules, self._marks = table.once(rules_and_marks, table)
        self._holders = frozenset(rules)
        self._wanted = _on_line(table, expected)
        self._rest = _on_line(table, tuple(name for name in others if name not in expected))
        self._found: dict[int, Levels] = {}
        self._starts: dict[Levels, Start] = {}
        self.starting: list[Start | None] = [None] * 256
        """The results of `start`, by first byte."""
        self.stops = self._start_pattern(*(() if symbol is None else (symbol,)))
        """Matches a byte that can begin a frame, or the escape symbol; None if any byte can begin a frame."""

    @property
    def begins_with_mark(self) -> bool:
        """Return whether the first byte of a wanted frame has the ninth bit set."""
        return any(info.frame.mark == "first" for info in (*self._wanted, *self._rest))

    def at(self, byte: int) -> Levels:
        """Return the candidates that can begin with `byte`."""
        found = self._found.get(byte)
        if found is None:
            levels = (_beginning(self._wanted, byte), _beginning(self._rest, byte))
            found = self._found[byte] = tuple(self.level(infos) for infos in levels if infos)
        return found

    def level(self, infos: Infos) -> CandidateLevel:
        return self._table.once(CandidateLevel, infos, self._holders)

    def start(self, byte: int) -> Start:
        """Return the tables for `byte`; equal candidates share the same object."""
        levels = self.at(byte)
        found = self._starts.get(levels)
        if found is None:
            wanted, rest = _beginning(self._wanted, byte), _beginning(self._rest, byte)
            found = self._starts[levels] = self._distinguished(levels, wanted, rest)
        self.starting[byte] = found
        return found

    def _distinguished(self, levels: Levels, infos: Infos, rest: Infos) -> Start:
        """Return the tables for the byte whose value excludes the most candidates by the constants they begin with."""
        every = (*infos, *rest)
        constants = {info: _constant(info) for info in every}
        candidates = self._table.once(Candidates, levels)
        at, most, left = 0, len(every), [candidates] * 256
        for place in range(1, max([len(one) for one in constants.values()], default=0)):
            values = {one[place] for one in constants.values() if len(one) > place}
            groups = [{info for info in every if _allows(constants[info], place, value)} for value in (*values, -1)]
            fewest = max(len(group) for group in groups)
            if fewest < most:
                at, most = place, fewest
                remaining = [self._remaining(infos, rest, group) for group in groups]
                left = [remaining[-1]] * 256
                for value, one in zip(values, remaining, strict=False):
                    left[value] = one
        start = Start(candidates, at, left)
        start.add_rows(*self._sole(infos, every), self._holders, self._marks)
        return start

    def _remaining(self, infos: Infos, rest: Infos, group: Collection[FrameInfo]) -> Candidates:
        found = (tuple(info for info in level if info in group) for level in (infos, rest))
        return self._table.once(Candidates, tuple(self.level(level) for level in found if level))

    def _sole(self, infos: Infos, every: Infos) -> tuple[int, list[Sole | None]]:
        """Return the index of the byte that leaves the fewest expected frames good, and the sole frame by its value."""
        at, most, others = 0, len(infos), infos
        values: dict[int, Infos] = {}
        allowed = [{} if info.frame.inside else dict(info.fixed_bytes) for info in infos]
        for place in sorted({place for one in allowed for place in one if place}):
            rows = [(info, one.get(place)) for info, one in zip(infos, allowed, strict=True)]
            known = {value for _, one in rows for value in one or ()}
            left = {value: tuple(info for info, one in rows if one is None or value in one) for value in known}
            unknown = tuple(info for info, one in rows if one is None)
            fewest = max(len(group) for group in (*left.values(), unknown))
            if fewest < most:
                at, most, values, others = place, fewest, left, unknown
        sure = _is_sure(every, others, at, values.keys(), True) if at else len(infos) == len(every)
        sole: list[Sole | None] = [(others[0], sure) if len(others) == 1 else None] * 256
        for value, group in values.items():
            sole[value] = (group[0], _is_sure(every, group, at, {value}, False)) if len(group) == 1 else None
        return at, sole

    def _start_pattern(self, *more: int) -> re.Pattern[bytes] | None:
        """Return a pattern of the bytes that can begin a frame, and of `more`; None if any byte can begin a frame."""
        firsts = {*more, *(info.first for info in (*self._wanted, *self._rest))}
        known = bytes(sorted(first for first in firsts if first is not None))
        if len(known) < len(firsts):
            return None
        return re.compile(b"[" + re.escape(known) + b"]") if known else re.compile(rb"[^\x00-\xff]")


def _on_line(table: FrameTable, names: tuple[str, ...]) -> Infos:
    """Return each frame once, without those that stand only in other frames."""
    return tuple(info for name in dict.fromkeys(names) if (info := table.infos[name]).on_line)


def _constant(info: FrameInfo) -> bytes:
    """Return the constant that a frame begins with: measuring compares it, and no values of fields.

    It is empty if another frame may stand at any index.
    """
    first = info.frame.segments[0] if info.frame.segments and not info.frame.inside else None
    return first.data if isinstance(first, Const) and first.when is None else b""


def _allows(constant: bytes, place: int, value: int) -> bool:
    return len(constant) <= place or constant[place] == value


def _is_sure(every: Infos, left: Infos, place: int, values: Collection[int], none_of_them: bool) -> bool:
    """Return whether the byte at `place`, with one of `values` or none of them, excludes all frames but `left`."""
    for info in every:
        if info not in left:
            constant = _constant(info)
            if len(constant) <= place or (constant[place] in values) is not none_of_them:
                return False
    return True


def _beginning(infos: Infos, byte: int) -> Infos:
    return tuple(info for info in infos if info.first is None or info.first == byte)


def function_does(function: Callable[..., int]) -> Any:
    """Return a key that is equal for generated functions with equal code."""
    code = getattr(function, "__code__", None)
    if code is None:
        return id(function)
    constants = tuple((type(one), one) for one in code.co_consts if one != function.__doc__)
    return code.co_code, constants, code.co_names


def any_intact(infos: Sequence[FrameInfo]) -> Intact:
    """Return a quick look that is false for bytes that are a good frame of none of `infos`.

    One byte distinguishes the frames first; where a frame has no quick look, the result is always true.
    """
    looks: dict[Intact | None, dict[int, frozenset[int]]] = {}
    for info in infos:
        bytes_at = dict(info.restricted)
        before = looks.get(info.intact, bytes_at)
        looks[info.intact] = {place: before[place] | allowed for place, allowed in bytes_at.items() if place in before}
    if None in looks:
        return _always
    places = sorted({place for allowed in looks.values() for place in allowed})
    if len(looks) == 1 or not places:
        return any_of([look for look in looks if look is not None])

    def left_at(place: int) -> list[tuple[Intact, ...]]:
        return [
            tuple(look for look, allowed in looks.items() if look and (place not in allowed or byte in allowed[place]))
            for byte in range(256)
        ]

    left_by = {place: left_at(place) for place in places}
    place = min(places, key=lambda place: max(len(looks) for looks in left_by[place]))
    left = left_by[place]

    def intact(raw: bytes | bytearray) -> bool:
        try:
            looks = left[raw[place]]
        except IndexError:
            return True
        for look in looks:  # noqa: SIM110 - called for noise: a generator costs as much as a look
            if look(raw):
                return True
        return False

    return intact


def _always(raw: bytes | bytearray) -> bool:
    return True


def in_order(groups: Sequence[CandidateGroup]) -> list[FrameInfo]:
    """Return the frames of groups of one level in the order of the level."""
    if len(groups) == 1:
        return list(groups[0].infos)
    return [info for _, info in sorted((member for group in groups for member in group.members), key=itemgetter(0))]
