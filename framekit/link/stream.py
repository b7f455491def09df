"""The bytes a receiver has not used yet, with their times and damaged characters.

Offsets are those of the stream: they count bytes from its start and stay valid when the buffer moves. Besides: the
pauses between bytes, the noise that is being collected, and the ninth bits of characters. On a line of nine bits
(guide: lines) a marked byte is the first of some frames and the last of others; no other byte is marked. So a frame
ends before the next marked byte, or with it, whatever its bytes say.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable

from framekit.definition.expression import Expression
from framekit.definition.model.sections import Receiver as Rules
from framekit.link.arrivals import Noise, new_tuple
from framekit.link.events import CharacterFault, LineFault
from framekit.link.frame_table import FrameInfo
from framekit.link.scope import LineTimes, Scope
from framekit.link.values import EVALUATION_ERRORS, Evaluate, Names, compile_expression

COPIED = 4096
"""A rest of so many bytes is copied when more come; to a longer rest they are appended, which grows no slower."""


QUIET_CHARACTERS, QUIET_ON_STREAM = 3, 50_000_000
"""Silence that ends noise, and frames without another end, where a definition does not say `quiet`.

Characters on a line. On a stream characters take no time, so it is a time (ns): else each piece would end noise.
"""

GAP_CHARACTERS, GAP_TIME, GAP_ON_STREAM = 20, 50_000_000, 10_000_000_000
"""The longest pause inside a frame while no step limits its time and the definition has no `gap`.

Characters and time (ns) on a line. A stream loses no byte, and a slow network may part a frame anywhere.
"""

LONGEST = 65536
"""A run is reported in pieces of this many bytes, so that endless noise takes no endless memory."""


class Stream:
    """A buffer from `position` on. `base` is the offset of `buffer[0]`; pauses are offsets of the byte after them.

    `ends` and `times`: of the pieces the bytes came in, their end offsets and times. The buffer is
    `bytes` as long as it is short, so that it is not copied. `taken_out`: bytes removed after the position, so
    that offsets there do not count on evenly; `removed`: how many bytes have been before it. `is_marked`: there may be
    something in it, or a fault, silence or pause. `marks`: offsets of the bytes whose ninth bit is set.
    `broken_at`: the offset where a break stands that is a fault of the line; -1 for none.
    """

    __slots__ = (
        "base", "broken_at", "buffer", "ends", "faults", "is_marked", "last", "marks", "pauses", "position",
        "removed", "silences", "taken_out", "times",
    )  # fmt: skip

    def __init__(self) -> None:
        self.buffer: bytes | bytearray = b""
        self.position = 0
        self.base = 0
        self.broken_at = -1
        self.removed = 0
        self.taken_out: list[tuple[int, int]] = []
        self.last = 0
        self.ends: list[int] = []
        self.times: list[int] = []
        self.faults: list[tuple[int, LineFault]] = []
        self.silences: list[int] = []
        self.pauses: list[int] = []
        self.marks: list[int] = []
        self.is_marked = False

    @property
    def offset(self) -> int:
        """Return the stream offset of the position, frames taken out of the middle of others included."""
        return self.offset_of(self.position)

    def offset_of(self, index: int) -> int:
        """Return the stream offset of `buffer[index]`; indices before it must not be asked for afterwards."""
        place = self.base + index
        if not self.taken_out:
            return place + self.removed
        while self.taken_out and self.taken_out[0][0] <= place:
            self.removed += self.taken_out.pop(0)[1]
        return place + self.removed

    def add(self, data: bytes, now: int, faults: Iterable[CharacterFault]) -> bool:
        """Append bytes, the last of which came at `now`; return whether unused bytes remained before them.

        Used bytes are dropped, unless many unused bytes follow.
        """
        rest = len(self.buffer) - self.position
        if rest > COPIED or self.is_marked or faults:
            return self._add(data, now, faults)
        self.base = base = self.base + self.position
        self.last = now
        if not rest:
            self.buffer = bytes(data)
            self.ends, self.times = [base + len(data)], [now]
            self.position = 0
            return False
        self.buffer = buffer = bytes(self.buffer[self.position :]) + data
        self.position, ends, times = 0, self.ends, self.times
        if ends[0] <= base:
            used = bisect_right(ends, base)
            del ends[:used], times[:used]
        ends.append(base + len(buffer))
        times.append(now)
        return True

    def _add(self, data: bytes, now: int, faults: Iterable[CharacterFault]) -> bool:
        """Append bytes as `add` does, also with faults, marks or many unused bytes."""
        rest = len(self.buffer) - self.position
        if self.position and (rest <= COPIED or self.position > rest):
            self.tidy()
        if rest <= COPIED:
            self.buffer = bytes(self.buffer) + data
        else:
            self.buffer = bytearray(self.buffer) if type(self.buffer) is bytes else self.buffer
            self.buffer += data
        end = self.base + len(self.buffer)
        self.ends.append(end)
        self.times.append(now)
        for fault in faults:
            if fault.fault is LineFault.MARK:
                self.marks.append(end - len(data) + fault.index)
            else:
                self.faults.append((end - len(data) + fault.index, fault.fault))
        self.is_marked = bool(self.faults or self.silences or self.pauses or self.taken_out or self.marks)
        self.last = now
        return bool(rest)

    def give_back(self) -> bytes:
        """Return the last byte of the buffer if only that byte is unused; else no bytes.

        The byte is added again, at the same offset, with the next bytes, and has their time.
        """
        if len(self.buffer) - self.position > 1:
            return b""
        last = bytes(self.buffer[-1:])
        self.position = len(self.buffer)
        self.base -= 1
        return last

    def mark(self, places: list[int], place: int) -> None:
        """Add a place after all other `places`."""
        places.append(place)
        self.is_marked = True

    def tidy(self) -> None:
        """Forget the used part of the buffer."""
        self.buffer = buffer = self.buffer[self.position :]
        self.base = base = self.base + self.position
        self.position, ends = 0, self.ends
        if not buffer:
            self.ends, self.times = [], []
        else:
            used = bisect_right(ends, base)
            self.ends, self.times = ends[used:], self.times[used:]
        if self.is_marked:
            self.faults = [item for item in self.faults if buffer and item[0] >= base]
            self.silences = [item for item in self.silences if buffer and item >= base]
            self.pauses = [item for item in self.pauses if buffer and item >= base]
            self.marks = [item for item in self.marks if buffer and item >= base]
            self.is_marked = bool(self.faults or self.silences or self.pauses or self.taken_out or self.marks)

    def time_of(self, index: int) -> int:
        """Return when the byte at `buffer[index]` came."""
        place = self.base + index
        return self.times[0 if place < self.ends[0] else bisect_right(self.ends, place)]

    def times_of(self, start: int, end: int) -> tuple[int, int]:
        """Return when the first and the last byte of `buffer[start:end]` came; there has to be one."""
        ends, times = self.ends, self.times
        if len(ends) == 1 or ends[-2] <= self.base + start:
            return times[-1], times[-1]
        if len(ends) == 2:
            return times[0], times[0 if self.base + end <= ends[0] else 1]
        first = bisect_right(ends, self.base + start)
        if self.base + end <= ends[first]:
            return times[first], times[first]
        return times[first], times[bisect_right(ends, self.base + end - 1)]

    def fault_in(self, start: int, end: int) -> LineFault | None:
        """Return the first fault of a character in `buffer[start:end]`."""
        low, high = self.base + start, self.base + end
        for place, fault in self.faults:
            if low <= place < high:
                return fault
        return None

    def first_after(self, places: list[int], index: int) -> int | None:
        """Return the buffer index of the first of `places` after `index`."""
        found = bisect_right(places, self.base + index)
        return places[found] - self.base if found < len(places) else None

    def remove(self, start: int, end: int) -> None:
        """Take `buffer[start:end]` out of the middle; later bytes move up."""
        low, count = self.base + start, end - start
        self.buffer = self.buffer[:start] + self.buffer[end:]
        self.taken_out.append((low + 1, count))
        self.is_marked = True
        self.ends = [place - count if place > low else place for place in self.ends]
        self.faults = [
            (place - count if place >= low + count else place, fault)
            for place, fault in self.faults
            if not low <= place < low + count
        ]
        self.marks = [
            place - count if place >= low + count else place for place in self.marks if not low <= place < low + count
        ]
        self.broken_at = max(self.broken_at - count, low) if self.broken_at > low else self.broken_at
        self.silences = [max(place - count, low) if place > low else place for place in self.silences]
        self.pauses = [max(place - count, low) if place > low else place for place in self.pauses]

    def clear(self) -> None:
        """Forget every byte."""
        self.position = len(self.buffer)
        self.tidy()


class Pauses:
    """The silence that ends things (`quiet`) and the longest pause inside a frame (`gap`).

    What bytes themselves take on the line is no pause, so it does not matter in which pieces a port hands them over.
    Times (ns) are worked out anew when a variable or parameter has changed.

    `own_gap` false: the waiting step allows any pause, or limits it itself. `is_unlimited`: no waiting step limits the
    time of a frame, so where the definition has no `gap` either, the usual one holds. `line`: what bytes take on it.
    """

    __slots__ = (
        "_gap_of", "_names", "_quiet_of", "_scope", "_stream", "_worked_out", "is_unlimited", "line", "own_gap",
    )  # fmt: skip

    def __init__(self, rules: Rules, names: Names, stream: Stream) -> None:
        self._names = names
        self._stream = stream
        self._scope = scope_of(names)
        self._quiet_of = _maybe(rules.quiet)
        self._gap_of = _maybe(rules.gap)
        line = names.get("line")
        self.line = line if isinstance(line, LineTimes) else LineTimes(None)
        self._worked_out: tuple[int, int, int | None] | None = None
        self.own_gap = True
        self.is_unlimited = False

    def limits(self) -> tuple[int, int | None]:
        """Return `quiet`, and the gap in force or None."""
        version = -1 if self._scope is None else self._scope.version
        found = self._worked_out
        if found is None or found[0] != version:
            quiet = self._time(self._quiet_of) or self.line.chars(QUIET_CHARACTERS) or QUIET_ON_STREAM
            found = self._worked_out = (version, quiet, self._time(self._gap_of))
        if not self.own_gap:
            return found[1], None
        return found[1], self._usual_gap() if self.is_unlimited and self._gap_of is None else found[2]

    def _usual_gap(self) -> int:
        """Return the longest pause in a frame that begins while no step waits."""
        return self.line.chars(GAP_CHARACTERS) + GAP_TIME if self.line.character else GAP_ON_STREAM

    @property
    def defines_gap(self) -> bool:
        return self._gap_of is not None

    def _time(self, evaluate: Evaluate | None) -> int | None:
        """Return a time, or None if it is not given or cannot be evaluated."""
        try:
            return None if evaluate is None else int(evaluate(self._names))
        except EVALUATION_ERRORS:
            return None

    def note(self, last: int, count: int, may_end_frame: bool) -> None:
        """Mark a pause before the `count` bytes that came last; those before them came at `last`.

        `may_end_frame`: a pause longer than the gap ends the frame before it; otherwise it only counts as a silence.
        """
        stream = self._stream
        pause = stream.last - last - self.line.chars(count)
        if pause <= 0:
            return
        quiet, gap = self.limits()
        place = stream.base + len(stream.buffer) - count
        if pause > quiet:
            stream.mark(stream.silences, place)
        if may_end_frame and gap is not None and pause > gap:
            stream.mark(stream.pauses, place)

    def is_quiet(self, now: int) -> bool:
        """Return whether no byte has come for `quiet`."""
        return now - self._stream.last >= self.limits()[0]

    def reach(self, now: int) -> tuple[int, bool]:
        """Return how far a frame at the position can reach (buffer index), and whether too long a pause ends it."""
        stream = self._stream
        if stream.pauses:
            pause = stream.first_after(stream.pauses, stream.position)
            if pause is not None:
                return pause, True
        end = len(stream.buffer)
        if now == stream.last:
            return end, False
        gap = self.limits()[1]
        return end, gap is not None and now - stream.last >= gap

    def silence_behind(self, index: int, now: int) -> int | None:
        """Return the buffer index after `index` where a silence stands, the present silence included, or None."""
        stream = self._stream
        found = stream.first_after(stream.silences, index)
        cut = stream.first_after(stream.pauses, index)
        if cut is not None and (found is None or cut < found):
            found = cut
        if found is None and self.is_quiet(now):
            return len(stream.buffer)
        return found


class NoiseRun:
    """A run of bytes that fit no frame, until it ends. `skipped`: a bad frame that has been reported left them."""

    __slots__ = ("_last", "_offset", "_started", "data", "skipped")

    def __init__(self) -> None:
        self.data = bytearray()
        self._offset = self._started = self._last = 0
        self.skipped = False

    def __bool__(self) -> bool:
        return bool(self.data)

    @property
    def is_long(self) -> bool:
        return len(self.data) >= LONGEST

    def collect(self, stream: Stream, start: int, end: int, skipped: bool) -> None:
        """Take `buffer[start:end]` of the stream; the stream's position is not moved."""
        started, self._last = stream.times_of(start, end)
        if not self.data:
            self.skipped, self._started = skipped, started
            self._offset = stream.offset + start - stream.position
        self.data += stream.buffer[start:end]

    def take(self) -> Noise:
        """Return the run as it stands; it begins anew."""
        noise = new_tuple(Noise, (bytes(self.data), self._offset, self._started, self._last, self.skipped))
        self.data.clear()
        return noise


def scope_of(names: Names) -> Scope | None:
    """Return the protocol-level names that `names` end in."""
    found: Names | None = names
    while found is not None and not isinstance(found, Scope):
        found = found.parent
    return found


def _maybe(expression: Expression | None) -> Evaluate | None:
    return None if expression is None else compile_expression(expression)


# ---- the ninth bit of characters ---------------------------------------------------------------------------


def marked_in(info: FrameInfo, size: int) -> int | None:
    """Return which byte of a frame of `size` bytes is marked; None for none."""
    mark = info.frame.mark
    if mark == "first":
        return 0
    return size - 1 if mark == "last" else None


class Marks:
    """Looks at the marks in a stream."""

    __slots__ = ("_stream",)

    def __init__(self, stream: Stream) -> None:
        self._stream = stream

    def next(self, index: int) -> int | None:
        """Return the buffer index of the first marked byte from `index` on."""
        marks = self._stream.marks
        found = bisect_left(marks, self._stream.base + index)
        return marks[found] - self._stream.base if found < len(marks) else None

    def end_for(self, info: FrameInfo, limit: int) -> int:
        """Return how far a frame that begins at the present place can reach, up to `limit` (buffer index)."""
        found = self._end(info)
        return limit if found is None else min(limit, found + (info.frame.mark == "last"))

    def ends(self, info: FrameInfo, size: int) -> bool:
        """Return whether a frame of `size` bytes at the position may end there: a marked last byte needs its mark."""
        last = self._stream.position + size - 1
        return info.frame.mark != "last" or self.next(last) == last

    def stops(self, info: FrameInfo, limit: int) -> bool:
        """Return whether a mark ends a frame that begins at the present place before `limit` (buffer index)."""
        found = self._end(info)
        return found is not None and found < limit

    def _end(self, info: FrameInfo) -> int | None:
        """Return the mark that ends it."""
        return self.next(self._stream.position + (info.frame.mark != "last"))

    def wrong_in(self, info: FrameInfo, start: int, end: int) -> int | None:
        """Return the first byte of a frame in `buffer[start:end]` (0 = first) whose mark is missing or unexpected."""
        wanted = marked_in(info, end - start)
        found = self.next(start)
        is_there = found is not None and found < end
        if wanted is None:
            return found - start if is_there and found is not None else None
        if not is_there or found is None or found - start > wanted:
            return wanted
        if found - start < wanted:
            return found - start
        more = self.next(found + 1)
        return more - start if more is not None and more < end else None
