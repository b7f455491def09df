"""Candidates at one place in the stream: which frames are expected there, and what each one is.

For each byte a frame may begin with: the expected candidates and the others, in the order of the rows; and which of
them are left when a second byte has told them apart. Each is no such frame, one that wants more, a good one or a bad
one. What it said is remembered, so that it is measured again only when the bytes it lacked are there.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Any

from framekit.codec.errors import FrameError
from framekit.definition.model.segments import Const
from framekit.link.arrivals import ONLY_CHECK, AnyBad, BadFrame, Fault, furthest_of
from framekit.link.events import LineFault
from framekit.link.frame_table import FrameInfo, FrameTable
from framekit.link.inside import InsideFinder, rules_and_marks
from framekit.link.quick_look import NO_SIZES, NOT_QUICK, Intact, SizesByByte, any_of
from framekit.link.stream import Marks, Stream, marked_in
from framekit.link.values import CODEC_ERRORS, Names

Trouble = Callable[[str, Exception], None]
"""Told about an expression of a frame that could not be worked out: the frame's name and what happened."""


class Good:
    """A complete frame; `refusal` is the code it is to be refused with."""

    __slots__ = ("fields", "info", "raw", "refusal")

    def __init__(self, info: FrameInfo, raw: bytes, fields: dict[str, Any], refusal: int | None) -> None:
        self.info, self.raw, self.fields, self.refusal = info, raw, fields, refusal


class Bad:
    """A frame with a fault. `known_end`: its end does not depend on content that may be damaged.

    `open_at(size)`: of one that grew too long, whether silence could still have ended it with so many bytes.

    Most are never reported, so the report is made when it is asked for, and so is `size` where it takes work; that has
    to be before the place in the stream changes.
    """

    __slots__ = ("_bad", "_report", "_size", "_size_of", "known_end", "open_at")

    def __init__(
        self,
        report: Callable[[], BadFrame],
        size: int | Callable[[], int],
        known_end: bool,
        open_at: Callable[[int], bool] | None = None,
    ) -> None:
        self._report = report
        self.open_at = open_at
        self._bad: BadFrame | None = None
        self._size: int | None = None
        if isinstance(size, int):
            self._size = size
        else:
            self._size_of = size
        self.known_end = known_end

    @property
    def bad(self) -> BadFrame:
        if self._bad is None:
            self._bad = self._report()
        return self._bad

    @property
    def size(self) -> int:
        if self._size is None:
            self._size = self._size_of()
        return self._size


class Complete:
    """All its `size` bytes are there; whether anything is wrong with them has not been looked at yet."""

    __slots__ = ("size",)

    def __init__(self, size: int) -> None:
        self.size = size


class Unfinished:
    """Fits so far and wants more, or, if `silent`, waits for a silence.

    Its end does not stand in the first `seen` bytes. It may have found its end and lack only what follows: what it
    had at the call before is what is certain, so `seen` is one call behind `had`.
    """

    __slots__ = ("had", "seen", "silent")

    def __init__(self, silent: bool, had: int, seen: int) -> None:
        self.silent, self.had, self.seen = silent, had, seen


class _No:
    __slots__ = ()


NO = _No()
Result = Good | Bad | Complete | Unfinished | _No


class Candidates:
    """What candidates said about the current place (`said`, by their names); `forget` when the place changes.

    `marks`: looks at the ninth bits, where the line tells them.

    `shortest_bad`: the size of the shortest complete bad frame of this look that has the bytes it always has.
    """

    __slots__ = ("_context", "_lost", "_quiet", "_stream", "_trouble", "marks", "said", "shortest_bad")

    def __init__(self, stream: Stream, context: Names, quiet: int, lost: int, trouble: Trouble) -> None:
        self._stream = stream
        self._context = context
        self._quiet = quiet
        self._lost = lost
        self._trouble = trouble
        self.said: dict[str, Result] = {}
        self.shortest_bad: int | None = None
        self.marks: Marks | None = None

    def forget(self) -> None:
        if self.said:
            self.said = {}

    # ---- size ---------------------------------------------------------------------------------------------

    def measure(self, info: FrameInfo, end: int) -> Result:
        """What `info` is at the current place, with the bytes up to buffer index `end`."""
        said = self.said.get(info.name)
        stream = self._stream
        position = stream.position
        seen = before = 0
        if said is not None:
            if type(said) is not Unfinished or end - position <= said.had:
                return said
            seen, before = said.seen, said.seen if said.silent else said.had
        length = self._length(info, position, end, seen)
        result: Result
        if length > 0:
            result = Complete(length)
        elif length == 0:
            result = NO
        elif length == self._lost:
            result = self._without_end(info, end - position)
        else:
            result = Unfinished(length == self._quiet, end - position, before)
        self.said[info.name] = result
        return result

    def seen(self, info: FrameInfo) -> int | None:
        """How many bytes surely do not hold its end; None where it said anything but that it wants more."""
        said = self.said.get(info.name)
        if said is None:
            return 0
        return said.seen if type(said) is Unfinished and not said.silent else None

    def wants_more(self, info: FrameInfo, had: int) -> None:
        """It wants more than `had` bytes."""
        said = self.said.get(info.name)
        self.said[info.name] = Unfinished(False, had, said.had if type(said) is Unfinished else 0)

    def _length(self, info: FrameInfo, start: int, end: int, seen: int = 0) -> int:
        """What measuring says; where it fails, that no such frame begins here."""
        try:
            return info.measure(self._stream.buffer, start, end, self._context, seen)
        except CODEC_ERRORS as error:
            self._trouble(info.name, error)
            return 0

    # ---- content ------------------------------------------------------------------------------------------

    def validate(
        self,
        infos: tuple[FrameInfo, ...],
        limit: int,
        silent: list[FrameInfo],
        inside: InsideFinder | None,
        is_told: bool,
    ) -> tuple[Good | None, tuple[Bad, ...], list[FrameInfo]]:
        """Return the good frame of these, the bad ones, and those that want more than there is up to `limit`.

        The shortest good frame is taken, of equally long ones the first: as if the bytes had come one by one. Those
        that silence ends are added to `silent`. Where a bad one `is_told`, it is reported at once, before a longer one
        that lacks a byte already within its size. A frame that lacks its mark, and no more, is bad where no other can
        stand here.
        """
        told_at_once = is_told and inside is None
        complete: list[tuple[int, int, FrameInfo, Complete]] = []
        wanting: list[FrameInfo] = []
        unmarked: list[tuple[FrameInfo, Complete]] = []
        bad: tuple[Bad, ...] = ()
        shortest: Good | None = None
        for place, info in enumerate(infos):
            end = limit if inside is None else inside.end_for(info.name, limit, self._stream.base)
            if self.marks is not None:
                end = self.marks.end_for(info, end)
            result = self.measure(info, end)
            if type(result) is Complete and self.marks is not None and not self.marks.ends(info, result.size):
                unmarked.append((info, result))
            elif type(result) is Complete:
                complete.append((result.size, place, info, result))
            elif type(result) is Unfinished:
                (silent if result.silent else wanting).append(info)
            elif type(result) is Bad:
                bad = (*bad, result)
                if result.known_end:
                    self._note_bad(info, result.size)
            elif type(result) is Good and (shortest is None or len(result.raw) < len(shortest.raw)):
                shortest = result
        if len(complete) > 1:
            complete.sort(key=itemgetter(0, 1))
        for size, _, info, found in complete:
            if shortest is not None and size >= len(shortest.raw):
                break
            if told_at_once and self._lacks(info, size):
                continue
            result = self.read(info, found)
            if type(result) is Good:
                return result, bad, wanting
            if type(result) is Bad:
                bad = (*bad, result)
                self._note_bad(info, size)
        if unmarked and not (bad or wanting or silent or shortest):
            result = self.read(*unmarked[0])
            bad = (result,) if type(result) is Bad else ()
        if wanting and told_at_once and self.shortest_bad is not None:
            wanting = [info for info in wanting if not self._lacks(info)]
        return shortest, bad, wanting

    def _note_bad(self, info: FrameInfo, size: int) -> None:
        """A complete frame is bad, and may be what was sent: it has all bytes that it always has."""
        shorter = self.shortest_bad is None or size < self.shortest_bad
        if shorter and info.fits(self._stream.buffer, self._stream.position, size) == size:
            self.shortest_bad = size

    def _lacks(self, info: FrameInfo, size: int | None = None) -> bool:
        """Whether a frame (of this size) that is longer than a bad one is bad too, as the bytes of that one tell."""
        shortest = self.shortest_bad
        if shortest is None or not info.is_fixed or (size is not None and size <= shortest):
            return False
        return info.fits(self._stream.buffer, self._stream.position, shortest) < shortest

    def read(self, info: FrameInfo, complete: Complete) -> Result:
        """What a complete candidate holds: a good frame or a bad one."""
        position = self._stream.position
        result = self.said[info.name] = self._read(info, position, position + complete.size)
        return result

    def at_silence(self, info: FrameInfo, end: int) -> Result:
        """A frame that silence ends, ended at buffer index `end`."""
        result = self._read(info, self._stream.position, end)
        self.said[info.name] = result
        return result

    def cut(self, info: FrameInfo, end: int) -> Bad:
        """A frame that fitted and was broken off before buffer index `end`."""
        start = self._stream.position
        raw = bytes(self._stream.buffer[start:end])
        fault = self._stream.fault_in(start, end)
        wrong = None if self.marks is None else self.marks.wrong_in(info, start, end)
        if fault is None and wrong is not None and self.marks is not None:
            return self._wrongly_marked(info, raw, wrong)
        what = "a pause" if self.marks is None or self.marks.next(end) != end else "the first byte of another frame"
        cause = "cut" if fault is None else fault.value
        found = Fault(cause, place=len(raw), expected="more bytes", found=what, reach=len(raw))
        return self._bad(info, raw, partial(self._broken_off, info, raw, found), False)

    def _broken_off(self, info: FrameInfo, raw: bytes, found: Fault) -> Fault:
        """What is wrong with a frame that was waited for in vain: its code, if it ends by a fitting one, or `found`."""
        if found.cause == "cut":
            try:
                info.decode(raw, self._context)
            except CODEC_ERRORS as error:
                if isinstance(error, FrameError) and error.cause == "check" and error.also is None:
                    return fault_of(error)
        return found

    def _read(self, info: FrameInfo, start: int, end: int) -> Result:
        raw = bytes(self._stream.buffer[start:end])
        fault = self._stream.fault_in(start, end)
        if fault is not None:
            return self._damaged(info, raw, fault, True)
        if self.marks is not None and (wrong := self.marks.wrong_in(info, start, end)) is not None:
            return self._wrongly_marked(info, raw, wrong)
        if info.intact is not None and not info.intact(raw):
            return self.misread(info, raw, info.misread(raw, self._context), True)
        try:
            return Good(info, raw, info.decode(raw, self._context), None)
        except CODEC_ERRORS as error:
            return self._refused(info, raw, error, True)

    # ---- bad frames ---------------------------------------------------------------------------------------

    def _refused(self, info: FrameInfo, raw: bytes, error: Exception, known_end: bool) -> Result:
        """What decoding has not taken: a bad frame, or a good one that is to be answered with a refusal."""
        if not isinstance(error, FrameError):
            self._trouble(info.name, error)
            return self._bad(info, raw, lambda: Fault("value", expected="values that fit together"), known_end)
        if error.refuse is not None:
            return Good(info, raw, dict(error.fields), error.refuse)
        return self.misread(info, raw, error, known_end)

    def misread(self, info: FrameInfo, raw: bytes, error: FrameError, known_end: bool) -> Bad:
        return self._bad(info, raw, partial(fault_of, error), known_end)

    def intact_fault(self, info: FrameInfo, raw: bytes) -> BadFrame:
        """A frame at the current place that is not intact, told."""
        return self._report(info, raw, lambda: fault_of(info.misread(raw, self._context)))

    def _damaged(self, info: FrameInfo, raw: bytes, fault: LineFault, known_end: bool) -> Bad:
        return self._bad(info, raw, lambda: Fault(fault.value, found="a damaged character"), known_end)

    def _wrongly_marked(self, info: FrameInfo, raw: bytes, wrong: int) -> Bad:
        """A byte of it has the ninth bit of another one."""
        expected, found = "no mark", "a mark"
        if wrong == marked_in(info, len(raw)):
            expected, found = found, expected
        return self._bad(info, raw, lambda: Fault("mark", "", wrong, expected, found, reach=wrong), True)

    def _bad(self, info: FrameInfo, raw: bytes, explain: Callable[[], Fault], known_end: bool) -> Bad:
        return Bad(partial(self._report, info, raw, explain), len(raw), known_end)

    def _report(self, info: FrameInfo, raw: bytes, explain: Callable[[], Fault]) -> BadFrame:
        stream = self._stream
        place = stream.position
        started, ended = stream.times_of(place, place + len(raw) if raw else place + 1)
        limit = ONLY_CHECK
        if not info.frame.inside and (fits := info.fits(raw, 0, len(raw))) < len(raw):
            limit = fits
        return BadFrame(info.name, raw, stream.offset, started, ended, explain, limit)

    def _without_end(self, info: FrameInfo, size: int) -> Bad:
        """A frame at the current place whose end is lost, as `size` bytes show.

        Most begin in noise and are not told: how it is bad is worked out on demand. The buffer may have let used bytes
        go by then, so that the place has another index.
        """
        whole: list[Bad] = []

        def bad() -> Bad:
            if not whole:
                place = self._stream.position
                whole.append(self._shortest_without_end(info, place, place + size))
            return whole[0]

        def report() -> BadFrame:
            found = bad().bad
            found.limit = min(found.limit, bad().size - 1)  # its last byte shows a fault
            return found

        def open_at(size: int) -> bool:
            place = self._stream.position
            return self._length(info, place, place + size) == self._quiet

        return Bad(report, lambda: bad().size, False, open_at)

    def _shortest_without_end(self, info: FrameInfo, start: int, end: int) -> Bad:
        """The fewest bytes that show that the end is lost, however many came at once."""
        low, high = start + 1, end
        while low < high:
            middle = (low + high) // 2
            if self._length(info, start, middle) == self._lost:
                high = middle
            else:
                low = middle + 1
        raw = bytes(self._stream.buffer[start:low])
        fault = self._stream.fault_in(start, low)
        if fault is not None:
            return self._damaged(info, raw, fault, False)
        try:
            info.decode(raw, self._context)
        except CODEC_ERRORS as error:
            found = self._refused(info, raw, error, False)
            return found if type(found) is Bad else self._endless(info, raw)
        return self._endless(info, raw)

    def _endless(self, info: FrameInfo, raw: bytes) -> Bad:
        return self._bad(info, raw, lambda: Fault("length", expected="a findable end", found="none"), False)


def fault_of(error: FrameError) -> Fault:
    """Return what is wrong, as decoding has found."""
    other = error.also if error.cause == "check" else error
    reach = ONLY_CHECK if other is None else other.offset
    return Fault(error.cause, error.segment, error.offset, error.expected, error.found, str(error), reach)


def furthest(levels: Sequence[Sequence[Bad]]) -> Bad:
    """Return the bad frame that is to be reported: of those expected, of the others …, each in the order of the rows.

    It is the one that was right furthest; of equals one with all its fixed bytes, then the longest, then the first. So
    the choice rests on the bytes, not on when the candidates became complete. Where all end at the same place, it is
    made when the fault is asked for.
    """
    if len(levels) == 1 == len(levels[0]):
        return levels[0][0]
    at_end = [(bad.size, bad.known_end, bad) for level in levels for bad in level]
    last = _without_open(at_end)
    ranked = sorted(
        (-bad.bad.limit, -size, not known_end, row, bad)
        for row, (size, known_end, bad) in enumerate(at_end)
        if size <= last
    )
    found = [bad for *_, bad in ranked]
    first, frames = found[0], [bad.bad for bad in found]
    if len({(size, unsure) for _, size, unsure, _, _ in ranked}) == 1:
        return first if len(found) == 1 else Bad(lambda: AnyBad(frames), first.size, first.known_end)
    return found[frames.index(furthest_of(frames))]


def _without_open(at_end: Sequence[tuple[int, bool, Bad]]) -> int:
    """Return the size up to which frames were bad ones when the first of them was to be reported.

    That is when every longer one waited for no more than a silence, which could still have ended it.
    """
    sizes = sorted({size for size, _, _ in at_end})
    for last in sizes[:-1]:
        if all(bad.open_at is not None and bad.open_at(last) for size, _, bad in at_end if size > last):
            return last
    return sizes[-1]


Level = tuple[FrameInfo, ...]


FrameRow = tuple[
    int, int, Callable[..., dict[str, Any]], FrameInfo, Callable[[bytes, dict[str, Any]], bool] | None, int
]
"""How the only frame that begins somewhere is read: its size (0: it is to be measured), the place of a byte that is
added to it (0: none), what reads it, the frame, what says of its bytes and fields that more has to be looked at, and up
to which size these bytes surely tell it."""


class Left:
    """The expected candidates that two bytes leave.

    `alone`: the only one. `sure`: every other candidate, the others included, begins with other constants than there
    are, so that it is surely none. `ends`: what finds their ends, once that was asked for. `names`: theirs. `alike`:
    whether all are measured alike, once that was asked for. `at`, `enough`, `most`, `rows`: the `quick` of the only
    one; `enough` is more than there ever is where nothing is told quickly. `is_told`: the rows surely tell what stands
    here.
    """

    __slots__ = ("alike", "alone", "at", "ends", "enough", "infos", "is_told", "most", "names", "rows", "sure")

    def __init__(self, infos: Level, sure: bool) -> None:
        self.infos = infos
        self.sure = sure
        self.names = tuple(info.name for info in infos)
        self.alone = infos[0] if len(infos) == 1 else None
        self.at, self.enough, self.most, self.rows = self.alone.quick if self.alone is not None else NOT_QUICK
        self.is_told = sure and self.alone is not None and self.alone.sizes is not NO_SIZES
        self.ends: Ends | None = None
        self.alike: bool | None = None

    def frame_rows(
        self, place: int, values: Iterable[int], holders: Collection[str], marks: re.Pattern[bytes] | None
    ) -> dict[int, FrameRow]:
        """How the only frame is read, by the byte at `place`; without those where none begins, or more is compared.

        `holders` are frames that others may stand in, and `marks` what these begin with, if that is known.
        """
        info = self.alone
        if info is None or (holders and not self.sure) or (info.name in holders and marks is None):
            return {}
        within = marks if info.name in holders else None
        unread, plain = _doubt(info.inner if info.guesses else None, within), _doubt(None, within)
        most, is_quick, found = self.most if self.is_told else 0, info.flat or self.at == place, {}
        for byte in values:
            quick = self.rows[byte] if is_quick else None
            size, counted, read = quick or (0, 0, None)
            if quick is None or size:
                found[byte] = size, counted, read or info.decode, info, unread if read is None else plain, most
        return found

    def compare(self) -> bool:
        """Whether all are measured alike, so that they have the same end."""
        self.alike = len({function_does(info.measure) for info in self.infos}) == 1
        return self.alike


def _doubt(inner: str | None, marks: re.Pattern[bytes] | None) -> Callable[[bytes, dict[str, Any]], bool] | None:
    """What says that the frame `inner` is none that is known, or that `marks` stand in the bytes."""
    if inner is None and marks is None:
        return None

    def is_doubtful(raw: bytes, fields: dict[str, Any]) -> bool:
        is_unknown = inner is not None and "unknown" in fields[inner]
        return is_unknown or (marks is not None and marks.search(raw) is not None)

    return is_doubtful


class Start:
    """What may begin with one byte: `at` is the place of the byte that tells the candidates apart (0: none does).

    `left`: what is left by each of its values. `wanted`: all that are expected. `is_noise`: nothing begins with it.
    `rows`: how a frame is read by the byte at `told_by`, None where none begins or more has to be looked at; `enough`:
    so many bytes have to be there.
    """

    __slots__ = ("at", "enough", "is_noise", "left", "rows", "told_by", "wanted")

    def __init__(
        self,
        at: int,
        left: Mapping[int, Left],
        others: Left,
        wanted: Left,
        holders: Collection[str],
        marks: re.Pattern[bytes] | None,
    ) -> None:
        self.at = at
        self.is_noise = wanted.sure and not wanted.infos
        self.wanted = wanted
        self.left = [left.get(byte, others) for byte in range(256)]
        self.told_by = at or others.at
        rows = others.frame_rows(self.told_by, range(256), holders, marks)
        self.rows: list[FrameRow | None] = [None] * 256
        for byte, one in left.items():
            rows.pop(byte, None)
            rows |= one.frame_rows(self.told_by, (byte,), holders, marks)
        for byte, row in rows.items():
            self.rows[byte] = row
        self.enough = max([self.told_by, at, *[row[1] for row in rows.values()]]) + 1


class ExpectedFrames:
    """The candidates for one pair of name lists, for all receivers of a table.

    `starting`: what `start` has found, by the first byte.

    `every`: for those as well as the others, told apart together. `starts` matches a byte that may begin a frame; None
    where any byte may; `stops` as well the symbol before a byte that belongs to it.
    """

    __slots__ = (
        "_found", "_rest", "_starts", "_table", "_wanted", "every", "starting", "starts", "stops", "wanted"
    )  # fmt: skip

    def __init__(
        self, table: FrameTable, expected: tuple[str, ...], others: tuple[str, ...] = (), symbol: int | None = None
    ) -> None:
        self._table = table
        self.wanted = expected, others
        self._wanted = _on_line(table, expected)
        self._rest = _on_line(table, tuple(name for name in others if name not in expected))
        self._found: dict[int, tuple[Level, Level]] = {}
        self._starts: dict[tuple[Level, Level], Start] = {}
        self.starting: list[Start | None] = [None] * 256
        self.starts = self._start_pattern()
        self.stops = self.starts if symbol is None else self._start_pattern(symbol)
        self.every: ExpectedFrames = self
        if self._rest:
            self.every = ExpectedFrames(table, tuple(info.name for info in (*self._wanted, *self._rest)))

    def at(self, byte: int) -> tuple[Level, Level]:
        """The candidates that may begin with `byte`."""
        found = self._found.get(byte)
        if found is None:
            found = (_beginning(self._wanted, byte), _beginning(self._rest, byte))
            self._found[byte] = found
        return found

    def levels(self, buffer: bytes | bytearray, place: int, end: int) -> tuple[Level, ...]:
        """The candidates that may begin at `place`, without those that the byte before `end` excludes that tells."""
        start = self.starting[buffer[place]] or self.start(buffer[place])
        at = place + start.at
        if at < end:
            left = start.left[buffer[at]]
            if left.sure:
                return (left.infos,)
        return self.at(buffer[place])

    def ends(self, left: Left, byte: int) -> Ends:
        """What finds the ends of the expected candidates behind `byte`: those left, if that is sure."""
        if left.ends is None:
            left.ends = self._table.once(Ends, left.infos if left.sure else self.at(byte)[0])
        return left.ends

    def start(self, byte: int) -> Start:
        """The candidates that may begin with `byte`, told apart by another one; for the same ones the same object."""
        levels = self.at(byte)
        found = self._starts.get(levels)
        if found is None:
            found = self._starts[levels] = self._told_apart(*levels)
        self.starting[byte] = found
        return found

    def _told_apart(self, infos: Level, rest: Level) -> Start:
        """By the place with the fewest candidates left, whatever byte stands there."""
        wanted = Left(infos, not rest)
        rules, marks = self._table.once(rules_and_marks, self._table)
        best = Start(0, {}, wanted, wanted, rules, marks)
        most = len(infos)
        allowed = [{} if info.frame.inside else dict(info.fixed_bytes) for info in infos]
        for place in sorted({place for one in allowed for place in one if place}):
            rows = [(info, one.get(place)) for info, one in zip(infos, allowed, strict=True)]
            values = {value for _, one in rows for value in one or ()}
            left = {value: tuple(info for info, one in rows if one is None or value in one) for value in values}
            others = tuple(info for info, one in rows if one is None)
            fewest = max(len(group) for group in (*left.values(), others))
            if fewest < most:
                every, most = (*infos, *rest), fewest
                by_value = {
                    value: Left(group, _sure(every, group, place, {value}, False)) for value, group in left.items()
                }
                rest_left = Left(others, _sure(every, others, place, values, True))
                best = Start(place, by_value, rest_left, wanted, rules, marks)
        return best

    def _start_pattern(self, *more: int) -> re.Pattern[bytes] | None:
        """Matches a byte that some candidate begins with, or one `more`; None when any byte may begin one."""
        firsts = {*more, *(info.first for info in (*self._wanted, *self._rest))}
        known = bytes(sorted(first for first in firsts if first is not None))
        if len(known) < len(firsts):
            return None
        return re.compile(b"[" + re.escape(known) + b"]") if known else re.compile(rb"[^\x00-\xff]")


def _on_line(table: FrameTable, names: tuple[str, ...]) -> Level:
    """Each frame once; frames that only stand in others are never looked for."""
    return tuple(info for name in dict.fromkeys(names) if (info := table.infos[name]).on_line)


def _sure(every: Level, left: Level, place: int, values: set[int], none_of_them: bool) -> bool:
    """Whether the constants that all others begin with contradict a byte at `place`: one of `values`, or none of them.

    What measures frames compares these constants; the value of a field it does not compare.
    """
    for info in every:
        if info not in left:
            first = info.frame.segments[0] if info.frame.segments else None
            constant = first.data if isinstance(first, Const) and first.when is None else b""
            if info.frame.inside:  # what interrupts it may stand at this place
                return False
            if len(constant) <= place or (constant[place] in values) is not none_of_them:
                return False
    return True


def _beginning(infos: Level, byte: int) -> Level:
    return tuple(info for info in infos if info.first is None or info.first == byte)


Group = tuple[SizesByByte, Callable[..., int], Callable[..., int], Intact, Sequence[FrameInfo]]
"""Candidates that are measured alike: their `sizes`, `extent` and `measure`, a quick look whether one may be good, and
they."""


class Ends:
    """What finds the ends of candidates: together where the functions that do it do the very same.

    By the byte at `at`, `silent` is 0 where no frame begins, minus the most where nothing does but frames that silence
    ends; None where more has to be looked at. `look`: a quick look whether one of those that silence ends may be good.
    """

    __slots__ = ("at", "groups", "look", "silent")

    def __init__(self, infos: Sequence[FrameInfo]) -> None:
        alike: dict[Any, list[FrameInfo]] = {}
        for info in infos:
            alike.setdefault(function_does(info.extent), []).append(info)
        groups = alike.values()
        self.groups: tuple[Group, ...] = tuple(
            (group[0].sizes, group[0].extent, group[0].measure, any_intact(group), group) for group in groups
        )
        tables = [group[0].sizes for group in groups]
        self.at = tables[0].at if tables else 0
        self.silent: Sequence[int | None] = NO_SIZES.sizes
        if all(table.at == self.at for table in tables):
            self.silent = [_silent_of([table.sizes[byte] for table in tables]) for byte in range(256)]
        self.look = any_of(
            [look for table, _, _, look, _ in self.groups if any(size is not None and size < 0 for size in table.sizes)]
        )


def _silent_of(sizes: Iterable[int | None]) -> int | None:
    """Of candidates: 0 if none begins, minus the most if only silence ends those that do; None if that differs."""
    found = set(sizes) - {0}
    most = next(iter(found), 0)
    return most if len(found) <= 1 and most is not None and most <= 0 else None


def function_does(function: Callable[..., int]) -> Any:
    """The same for generated functions that do the very same."""
    code = getattr(function, "__code__", None)
    if code is None:
        return id(function)
    constants = tuple((type(one), one) for one in code.co_consts if one != function.__doc__)
    return code.co_code, constants, code.co_names


def are_bad(infos: Sequence[FrameInfo], raw: bytes | bytearray, names: Names) -> bool:
    """Whether these bytes are surely none of several frames, neither good nor to be refused."""
    for info in infos:
        if info.intact is not None and not info.intact(raw):
            continue
        try:
            info.decode(bytes(raw), names)
        except FrameError as error:
            if error.refuse is None:
                continue
        except CODEC_ERRORS:
            pass
        return False
    return True


def any_intact(infos: Sequence[FrameInfo]) -> Intact:
    """Whether bytes may be a good one of several frames, told apart by one byte first; always where nothing tells."""
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
