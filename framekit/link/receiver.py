"""Bytes to frames: a receiver finds expected frames, other frames, bad frames and noise in a stream.

Guide: receiving. Sans-I/O and pull-based: each call names the frames to look for. The result does not depend on how the
stream is cut into pieces. One loop: tables select the candidates at a position; they are measured, complete candidates
are decoded, and the result is reported. The receiver knows no sequences: which step takes a frame is decided elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from itertools import repeat
from operator import itemgetter
from typing import Any

from framekit.codec.errors import FrameError
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER
from framekit.link.arrivals import Arrival, BadFrame, FrameArrived, Noise
from framekit.link.bad_frames import BadFrames, Trouble
from framekit.link.candidates import CandidateGroup, Candidates, ExpectedFrames, Levels, in_order, size_by_byte
from framekit.link.events import CharacterFault
from framekit.link.frame_table import FrameInfo, FrameTable, ProtocolCodec, table_of
from framekit.link.inside import InsideFinder
from framekit.link.quick_look import UNKNOWN
from framekit.link.stream import LONGEST, Marks, NoiseRun, Pauses, Stream, scope_of
from framekit.link.values import CODEC_ERRORS, FrameValue, Names

MOST_BAD, BAD_TIME, BAD_APART = 8, 10_000_000, 256
"""The number of bad frames without a good frame between them that are reported in a row; then one is reported for each
such time (ns), and, if they come faster, one for this number of bytes. Bytes between them are noise, marked as skipped.
"""

from_bytes = int.from_bytes

GOES_ON = ("next_start", "after_frame")
"""The values of `resync` with which reading goes on at once after a bad frame, so that bad frames come in crowds."""

MEASURED_AGAIN = 256
"""The progress of measuring is remembered for frames of more bytes: measuring fewer again is cheaper."""

MADE_GOOD = 4
"""The number of bad frames that a good frame makes up for."""


class Again:
    """The position has changed: look again."""


AGAIN = Again()
Found = FrameValue | Arrival | Again | None
"""An arrival; or that the position has changed; or None while more bytes or time are needed."""

Reading = tuple[FrameInfo, dict[str, Any], bytes, int | None]
"""A good frame: its fields, bytes and refusal code."""


class Verdict:
    """The result of a position where no candidate is good and no candidate waits for more."""

    __slots__ = ("silent", "size", "sole", "stop")

    def __init__(
        self, size: int, sole: FrameInfo | None = None, silent: Iterable[FrameInfo] = (), stop: int = 0
    ) -> None:
        self.size, self.sole = size, sole
        """The size of the first bad candidate; 0 if its end is not known, -1 if no candidate is bad. And the candidate,
        if it is the only one."""
        self.silent, self.stop = silent, stop
        """The bad candidates that a silence at buffer index `stop` ends."""


NO_FRAME, NO_END = Verdict(-1), Verdict(0)
UNSEEN, UNASKED = (0, 0), -1


class Receiver:
    """Finds frames in the bytes of one direction of a line.

    `names` are the names that expressions of frames read; `trouble` is called for expressions that fail.
    """

    def __init__(
        self,
        codec: ProtocolCodec,
        protocol: Protocol,
        names: Names,
        table: FrameTable | None = None,
        trouble: Trouble = lambda frame, error: None,
    ) -> None:
        self.table = table or table_of(protocol, codec)
        self.stream = Stream()
        self.pauses = Pauses(protocol.receiver, names, self.stream)
        """The lengths of silences and gaps."""
        self.broken = False
        """The stream is out of step and the definition wants the connection closed; bytes are dropped until `reset`."""
        self.waiting: tuple[str, ...] = ()
        """The candidates that the bytes at hand fit so far."""
        self.has_unread = False
        """Whether bytes are at hand that are no frame yet, or noise, or that no call has looked at."""
        self.has_exact_times = True
        """Whether bytes came when `append` says; if not, only a pause that `tick` notes may end a frame."""
        self.on_scan: Callable[[], None] = lambda: None
        """Called before pauses matter, to set how long they may be."""
        self._rules = protocol.receiver
        self._delimiter = protocol.receiver.delimiter
        self._is_open = False
        """The last byte of the buffer is a delimiter that may begin a frame."""
        self._names = names
        self._scope = scope_of(names)
        self._trouble = trouble
        self._quiet, self._lost = codec.QUIET, codec.LOST
        self._bad_frames = BadFrames(self.stream, names, codec.QUIET, codec.LOST, trouble)
        inside = InsideFinder(self.table, names, codec.QUIET, codec.LOST)
        self._inside = inside if inside else None
        self._frames = self.expect((), ())
        self._now = 0
        self._noise = NoiseRun()
        self._all: list[Arrival] | None = None
        """Where `arrivals` collects; None while single arrivals are asked for."""
        self._taken_at = -1
        """The buffer index of the frame that was handed over last; -1 if other bytes have been used since."""
        self._inside_frame: FrameArrived | None = None
        """The last frame that stood in the middle of another frame."""
        self._declined: list[str] = []
        """The readings of the frame at `_taken_at` that were handed over."""
        self._needs_silence = False
        """A waiting candidate ends by silence."""
        self._skipping = False
        """After a bad frame, bytes are skipped until a silence."""
        self._bad_end = self._bad_until = 0
        """The end of the last reported bad frame, and the offset where the next one may be reported."""
        self._bad_busy = 0
        """Until when reported bad frames use up the time that each takes."""
        self._good_since = False
        self._stop: int | None = UNASKED
        """The buffer index where the next silence stands, once it was asked for."""
        self._marks: Marks | None = None
        self._seen: dict[str, tuple[int, int]] = {}
        """The progress of measuring at offset `_seen_at`: by group, the bytes there were, and how many of them surely
        do not hold the end of a frame."""
        self._seen_at = self._seen_version = -1
        self._is_simple = self._delimiter is None

    def hear_marks(self, on: bool) -> None:
        """Set whether the line reports the ninth bits of characters, so that frames have to be marked correctly."""
        self._marks = self._bad_frames.marks = Marks(self.stream) if on else None
        self._is_simple = self._delimiter is None and not on

    @property
    def hears_marks(self) -> bool:
        """Return whether the line reports the ninth bits of characters."""
        return self._marks is not None

    # ---- bytes in -----------------------------------------------------------------------------------------

    def append(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> None:
        """Add bytes, the last of which came at `now` (ns), with the faults of single characters."""
        if not data or self.broken:
            return
        self._now, self._taken_at = now, -1
        stream = self.stream
        if self.has_unread or self._is_open or stream.is_marked or faults:
            self._append(data, now, faults)
        else:
            stream.base = base = stream.base + stream.position
            stream.buffer = data if type(data) is bytes else bytes(data)
            stream.position, stream.last = 0, now
            stream.ends, stream.times = [base + len(data)], [now]
        self.has_unread = True

    def _append(self, data: bytes, now: int, faults: Iterable[CharacterFault]) -> None:
        """Add bytes to others that are still at hand, with the pause before them."""
        stream = self.stream
        last = stream.last
        if self._is_open:
            self._is_open = False
            before = stream.give_back()
            data = before + data
            faults = [CharacterFault(len(before) + one.index, one.fault) for one in faults]
        goes_on = stream.add(data, now, faults)
        if (goes_on or self._noise.data or self._skipping) and now - last > self.pauses.line.character * len(data):
            is_inside = goes_on and bool(self.waiting) and not self.has_exact_times
            if not (is_inside and self._needs_silence):
                self.pauses.note(last, len(data), not is_inside)

    def tick(self, now: int) -> None:
        """Note that no byte has come until `now`; the next call that looks for frames reports the consequences."""
        self._now = max(self._now, now)

    def cut(self) -> None:
        """End an unfinished frame here: the waiting step allows no longer pause."""
        stream = self.stream
        place = stream.base + len(stream.buffer)
        if not stream.pauses or stream.pauses[-1] != place:
            stream.mark(stream.pauses, place)

    def broke(self, now: int) -> None:
        """End an unfinished frame by a break at `now`.

        The break is a fault of the line for a frame that only silence ends and that no check code proves complete,
        unless the definition says that a break ends frames, or the silence was long enough.
        """
        has_ended = self.has_exact_times and self.pauses.is_quiet(now)
        if not (has_ended or self._rules.break_ends):
            self.stream.broken_at = self.stream.base + len(self.stream.buffer)
        self.cut()
        self.tick(now)

    def answered(self) -> None:
        """Note that this side has sent something: following bytes answer it, and need no silence before them."""
        if self._skipping:
            self._skipping = False
            if self.stream.position < len(self.stream.buffer):
                self._collect(len(self.stream.buffer), True)
            self._note_unread()

    def flush(self) -> list[Noise]:
        """Drop everything that has not become a frame, and return it as noise."""
        found = [self._noise.take()] if self._noise else []
        stream = self.stream
        self._taken_at = -1
        if stream.position < len(stream.buffer):
            self._collect(len(stream.buffer), False)
            found.append(self._noise.take())
        stream.clear()
        self._skipping = self._is_open = self.has_unread = False
        self.waiting = ()
        return found

    def reset(self) -> list[Noise]:
        """Do as `flush`, and let a broken stream begin anew."""
        self.broken = False
        return self.flush()

    # ---- what is at hand ----------------------------------------------------------------------------------

    @property
    def is_empty(self) -> bool:
        """Whether every byte has been used or reported."""
        return self.stream.position >= len(self.stream.buffer) and not self._noise.data

    @property
    def waiting_since(self) -> int:
        """When the first byte came that the candidates in `waiting` fit."""
        return self.stream.time_of(self.stream.position)

    @property
    def deadline(self) -> int:
        """When `tick` has to be called if no byte comes."""
        stream = self.stream
        if self.waiting:
            quiet, gap = self.pauses.limits()
            deadline = NEVER if gap is None else stream.last + gap
            if self._needs_silence:
                deadline = min(deadline, stream.last + quiet)
        elif not self.has_unread:
            return NEVER
        else:
            deadline = stream.last + self.pauses.limits()[0]
        return deadline if deadline > self._now else NEVER

    # ---- frames out ---------------------------------------------------------------------------------------

    def expect(self, expected: tuple[str, ...], others: tuple[str, ...] = ()) -> ExpectedFrames:
        """Return the tables to look for `expected` frames, then `others`."""
        return self.table.once(ExpectedFrames, self.table, expected, others, self._rules.symbols)

    def next(self, expected: tuple[str, ...], others: tuple[str, ...] = ()) -> Arrival | None:
        """As `next_of`, with the names of frames; a frame with its offset and times."""
        found = self.next_of(self.expect(expected, others))
        if not isinstance(found, FrameValue):
            return found
        if self._taken_at < 0:
            return self._inside_frame
        return self._arrived(self.table.infos[found.frame], found.fields, found.raw or b"", self._taken_at, found)

    def arrivals(self, expected: tuple[str, ...], others: tuple[str, ...] = ()) -> list[Arrival]:
        """Return all arrivals until more bytes or time are needed."""
        found: list[Arrival] = []
        self._all = found
        self.next_of(self.expect(expected, others), found)
        self._all, self._taken_at = None, -1
        return found

    @property
    def given_since(self) -> int:
        """When the first byte came of the frame that was handed over last."""
        start, inside = self._taken_at, self._inside_frame
        return self.stream.times_of(start, start + 1)[0] if start >= 0 or inside is None else inside.times[0]

    def other_reading(self) -> FrameArrived | None:
        """Return another frame that fits the bytes of the last frame, in the order of rows; None if no frame does."""
        start, stream = self._taken_at, self.stream
        if start < 0:
            return None
        after, stream.position = stream.position, start
        for level in self._frames.at(stream.buffer[start]):
            for group in level.singles:
                size = 0 if group.name in self._declined else self._size(group, start, len(stream.buffer), None)
                good = self._read(group.infos[0], start, start + size) if size > 0 else None
                if good is not None:
                    info = group.infos[0]
                    self._take(info, start, len(good[2]))
                    self._note_unread()
                    return self._arrived(*good[:3], start, info.make(*good[1:]))
        stream.position = after
        return None

    # ---- the loop -----------------------------------------------------------------------------------------

    def next_of(self, frames: ExpectedFrames, found: list[Arrival] | None = None) -> FrameValue | Arrival | None:
        """Return the next arrival where `frames` are looked for, a frame as its value; None if there is none yet.

        Until the next call, `other_reading` can read the bytes of the frame differently. With `found`, all arrivals are
        added to it. A usual frame is read by its row; every other position is looked at with care.
        """
        stream, noise = self.stream, self._noise.data
        starting, names = frames.starting, self._names
        self._frames, self.waiting = frames, ()
        while True:
            buffer, place = stream.buffer, stream.position
            end = len(buffer)
            if self._is_simple and not (stream.is_marked or self._skipping or self._seen):
                if found is not None:
                    offset, times = stream.base + stream.removed, (stream.last, stream.last)
                    newest = stream.ends[-2] - stream.base if len(stream.ends) > 1 else 0
                try:
                    while place < end:
                        start = starting[buffer[place]] or frames.start(buffer[place])
                        row = start.rows[buffer[place + start.told_by]]
                        if row is None:
                            break
                        size, counted, read, info, is_doubtful, waiting = row
                        if counted:
                            size += buffer[place + counted]
                        elif not size:
                            if info.counted is None:
                                size = info.extent(buffer, place, end, names)
                            else:  # reading fails if the number is wrong
                                size, first, last, order = info.counted
                                size += from_bytes(buffer[place + first : place + last], order)
                            if size <= 0:
                                waiting = waiting if self._quiet < size < 0 and end - place <= MEASURED_AGAIN else ()
                                size = UNKNOWN
                        stop = place + size
                        if stop > end:
                            if waiting and self._waits(waiting, place):
                                return None
                            break
                        raw = bytes(buffer[place:stop])
                        if noise and info.intact is not None and not info.intact(raw):
                            break
                        fields = read(raw, names)
                        if is_doubtful is not None and is_doubtful(raw, fields):
                            break
                        if noise:
                            if found is None:
                                return self._noise.take()
                            found.append(self._noise.take())
                        if found is None:
                            stream.position, self._taken_at, self._declined = stop, place, [info.name]
                            self._good_since, self.has_unread = True, stop < end
                            return info.make(fields, raw, None)
                        arrived = FrameArrived()
                        arrived.make, arrived.decoded, arrived.raw = info.make, fields, raw
                        arrived.offset = offset + place
                        arrived.times = times if place >= newest else stream.times_of(place, stop)
                        found.append(arrived)
                        place, self._good_since = stop, True
                except CODEC_ERRORS:
                    pass
                stream.position = place
            event = self._look(frames)
            if event is None or (found is None and not isinstance(event, Again)):
                self._note_unread()
                return event
            if found is not None and not isinstance(event, Again | FrameValue):
                found.append(event)

    def _note_unread(self) -> None:
        stream = self.stream
        self.has_unread = stream.position < len(stream.buffer) or bool(self._noise.data) or self._skipping

    def _waits(self, names: tuple[str, ...], place: int) -> bool:
        """Wait for frames `names` at buffer index `place`, which want more bytes; return whether only they matter."""
        stream = self.stream
        if place > stream.position:
            stream.position, self._good_since = place, True
        if (
            self._now != stream.last
            or self._noise.is_long
            or (self._inside is not None and not self._inside.is_none_behind(stream))
        ):
            return False
        self.on_scan()
        self.waiting, self._needs_silence = names, False
        return True

    def _look(self, frames: ExpectedFrames) -> Found:
        """Look at the position with care, and pass over noise from there on."""
        stream, noise = self.stream, self._noise
        if stream.position >= len(stream.buffer) and not (noise.data or self._skipping):
            return None
        self.on_scan()
        if self._delimiter is not None:
            passed = self._pass_fill()
            if passed is not None:
                return passed
        first = stream.position
        if first >= len(stream.buffer):
            return self._at_end()
        if self._skipping:
            return self._skip()
        if noise.data:
            is_after_silence = bool(stream.silences) and stream.first_after(stream.silences, first - 1) == first
            if noise.is_long or is_after_silence:
                return noise.take()
        return self._pass_noise(frames, first)

    def _pass_fill(self) -> Found:
        """Pass over delimiters that begin no frame: another delimiter follows them, or no byte yet.

        The last delimiter begins a frame if another byte follows (`append`), and noise may go on with that frame; noise
        surely ends before any other delimiter.
        """
        stream, delimiter = self.stream, self._delimiter
        buffer, place = stream.buffer, stream.position
        end, passed = len(buffer), stream.position
        while passed < end and buffer[passed] == delimiter and (passed + 1 == end or buffer[passed + 1] == delimiter):
            passed += 1
        if passed == place or self._skipping:
            return None
        self._is_open = passed == end
        stream.position, self._seen = passed, {}
        return self._noise.take() if self._noise.data and passed - place > self._is_open else AGAIN

    def _pass_noise(self, frames: ExpectedFrames, first: int) -> Found:
        """Look at the positions from `first` on, up to a frame, a bad frame to report, or a change of conditions."""
        stream, noise, rules = self.stream, self._noise, self._rules
        buffer, base, symbol, stops = stream.buffer, stream.base, rules.symbols, frames.stops
        starting, is_marked = frames.starting, self._marks is not None
        self._needs_silence, self._stop = False, UNASKED
        limit, is_cut = self.pauses.reach(self._now)
        is_new, passed = base + first >= self._bad_until, 0
        if not (is_new or is_marked):  # up to there only good frames and unfinished frames matter
            passed = (self._bad_end if rules.resync == "after_frame" else self._bad_until) - base
        end, place = first + 1, first
        while place < end:
            start = starting[buffer[place]] or frames.start(buffer[place])
            at, step = place + start.at, 1
            here = start.left[buffer[at]] if at < limit else start.every
            at = place + here.skip_at
            skip = here.skips[buffer[at]] if at < limit and not is_marked else None
            is_open = skip is None or (skip and (is_new or limit - place <= skip))
            if is_open and place < passed and not (self._seen and base + place == self._seen_at):
                is_open = not self._passes(here, place, limit, is_cut)
            if is_open:
                levels = here.levels
                if is_marked or here.is_holding:
                    self._collect(place, not is_new)
                    levels = self._marked(levels)
                    taken_out = self._frame_inside(levels, limit)
                    if taken_out is not None:
                        return taken_out
                verdict = self._judge(levels, place, limit, is_cut, is_new)
                if (is_new and verdict is not NO_FRAME) or not isinstance(verdict, Verdict):
                    self._collect(place, not is_new)
                    return self._noise_before() or self._found(levels, verdict, limit) if verdict else None
                if verdict.size > 0 and base + place >= self._bad_end:
                    step = self._without_shared(place, verdict.size)
            if place == first:
                end = self._end_of_run(first, limit, is_new)
                if noise.data and noise.skipped is is_new:
                    return noise.take()
                if rules.resync == "never":
                    self._collect(place + 1, False)
                    self._break_off()
                    return noise.take()
            if symbol is not None and buffer[place] == symbol and step == 1:
                step = min(2, len(buffer) - place)
                if step == 1 and not self.pauses.is_quiet(self._now):
                    self._collect(place, not is_new)
                    return None
            place += step
            if stops is not None and place < end:
                match = stops.search(buffer, place, end)
                place = end if match is None else match.start()
        self._collect(place, not is_new)
        return AGAIN

    def _found(self, levels: Levels, verdict: Reading | Verdict, limit: int) -> FrameValue | Arrival:
        """Hand over the good frame at the stream's position, or report the bad frame."""
        return self._bad(levels, verdict, limit) if isinstance(verdict, Verdict) else self._good(verdict)

    def _end_of_run(self, first: int, limit: int, is_new: bool) -> int:
        """Return how far conditions stay the same: up to a pause, a silence, or the end of a reported bad frame."""
        stream = self.stream
        end = min(limit, first + LONGEST - len(self._noise.data))
        if self._delimiter is not None and (delimiter := stream.buffer.find(self._delimiter, first + 1, end)) >= 0:
            end = delimiter
        if stream.silences and (silence := stream.first_after(stream.silences, first)) is not None:
            end = min(end, silence)
        return end if is_new else min(end, self._bad_until - stream.base)

    def _frame_inside(self, levels: Levels, limit: int) -> Noise | FrameValue | FrameArrived | None:
        """Return a frame in the middle of a candidate at the stream's position, and take it out of the stream."""
        inside, stream = self._inside, self.stream
        if inside is None:
            return None
        inside.move(stream.base + stream.position)
        if not inside.places and inside.is_none_behind(stream):
            return None
        found = inside.find(stream, tuple(info for level in levels for info in level.infos), limit)
        return None if found is None else self._noise_before() or self._taken_out(*found)

    def _marked(self, levels: Levels) -> Levels:
        """Return the candidates that may begin as the ninth bit says; all if none may, so that one is reported."""
        if self._marks is None:
            return levels
        is_marked = self._marks.next(self.stream.position) == self.stream.position
        fitting = [
            tuple(one for one in level.infos if one.frame.mark == "last" or (one.frame.mark == "first") is is_marked)
            for level in levels
        ]
        return tuple(self._frames.level(infos) for infos in fitting if infos) or levels

    def _without_marks(self, complete: list[tuple[int, CandidateGroup]]) -> bool:
        """Drop the complete frames that lack the mark at their end; return whether there are any."""
        marks, count = self._marks, len(complete)
        complete[:] = [one for one in complete if marks is None or marks.ends(one[1].infos[0], one[0])]
        return len(complete) < count

    # ---- candidates at a position ---------------------------------------------------------------------------

    def _judge(self, levels: Levels, place: int, limit: int, is_cut: bool, is_new: bool) -> Reading | Verdict | None:
        """Return the shortest good frame at `place`, or a verdict; None while a candidate wants more.

        Bytes up to buffer index `limit` count. `is_cut`: a pause that ends every frame follows. `is_new`: a bad frame
        will be reported; it is not awaited that a longer frame becomes complete if its bytes contradict that.
        """
        inside, quiet, lost = self._inside, self._quiet, self._lost
        is_special = self._marks is not None or (inside is not None and inside.is_partly(self.stream.base + place))
        seen = self._progress(place) if self._seen else None
        silent: list[FrameInfo] = []
        bad: list[tuple[int, CandidateGroup]] = []
        verdict, end = NO_FRAME, limit
        for level in levels:
            complete: list[tuple[int, CandidateGroup]] = []
            wanting: list[CandidateGroup] = []
            ending: list[CandidateGroup] = []
            for group in level.singles if is_special else level.groups:
                if is_special:
                    end = self._reach_of(group.infos[0], limit)
                size = self._size(group, place, end, seen)
                if not size:
                    continue
                if size > 0:
                    complete.append((size, group))
                elif size == quiet:
                    ending.append(group)
                elif size == lost:
                    verdict = NO_END if verdict is NO_FRAME else verdict
                else:
                    wanting.append(group)
            if complete:
                is_unmarked = self._marks is not None and self._without_marks(complete)
                good = self._first_good(complete, place) if complete else None
                if good is not None:
                    return good
                bad += complete
                if is_unmarked and not (bad or wanting or ending or silent):
                    verdict = NO_END
            if bad and verdict is NO_FRAME:
                verdict = NO_END
                if is_new and not is_special and len(levels) == 1 == len(level.infos):
                    verdict = Verdict(bad[0][0], level.infos[0])
                elif self._rules.resync == "after_frame":
                    verdict = Verdict(min(bad, key=itemgetter(0))[0])
            if ending:
                silent += in_order(ending)
            if wanting:
                going_on = self._not_bad(in_order(wanting), bad if is_new else [], place)
                if not is_cut and self._wait(going_on, silent, limit):
                    self._remember(wanting, place, limit)
                    return None
                if going_on and verdict is NO_FRAME:
                    verdict = NO_END
        return self._at_silence(silent, place) if silent and verdict is NO_FRAME else verdict

    def _first_good(self, complete: list[tuple[int, CandidateGroup]], place: int) -> Reading | None:
        """Return the shortest good frame of complete groups, of equally long frames the first."""
        if len(complete) == 1:
            entries = zip(repeat(complete[0][0]), complete[0][1].infos, strict=False)
        else:
            ordered = sorted((size, *member) for size, group in complete for member in group.members)
            entries = zip(map(itemgetter(0), ordered), map(itemgetter(2), ordered), strict=True)
        for size, info in entries:
            good = self._read(info, place, place + size)
            if good is not None:
                return good
        return None

    def _read(self, info: FrameInfo, start: int, end: int) -> Reading | None:
        """Return these bytes as a good frame, or as a frame to be refused; None if they are not."""
        stream = self.stream
        raw = bytes(stream.buffer[start:end])
        if stream.faults and stream.fault_in(start, end) is not None:
            return None
        if self._marks is not None and self._marks.wrong_in(info, start, end) is not None:
            return None
        if info.intact is not None and not info.intact(raw):
            return None
        try:
            return info, info.decode(raw, self._names), raw, None
        except FrameError as error:
            return None if error.refuse is None else (info, dict(error.fields), raw, error.refuse)
        except CODEC_ERRORS as error:
            self._trouble(info.name, error)
            return None

    def _passes(self, here: Candidates, place: int, end: int, is_cut: bool) -> bool:
        """Return whether all candidates are surely bad or no frame, by tables and quick looks."""
        buffer, quiet, lost = self.stream.buffer, self._quiet, self._lost
        if here.is_holding:
            return False
        try:
            for group in here.groups:
                size = None if group.sizes is None else size_by_byte(group.sizes, buffer, place, end, quiet, lost)
                if size is None:
                    size = group.extent(buffer, place, end, self._names)
                if size > 0:
                    if group.may_fit(buffer[place : place + size]):
                        return False
                elif size == quiet:
                    stop = self._silence_after(place)
                    if stop is None or group.may_fit(buffer[place:stop]):
                        return False
                elif size and size != lost and not is_cut:
                    return False
        except CODEC_ERRORS:
            return False
        return True

    def _silence_after(self, place: int) -> int | None:
        """Return where the next silence stands, the same for all positions of one run; None if it has not come."""
        if self._stop == UNASKED:
            self._stop = self.pauses.silence_behind(place, self._now)
        return self._stop

    def _size(self, group: CandidateGroup, place: int, end: int, seen: dict[str, tuple[int, int]] | None) -> int:
        """Return the result of measuring a group: its size, or the code of the codec for other results."""
        buffer = self.stream.buffer
        try:
            if seen is not None:
                return group.measure(buffer, place, end, self._names, seen.get(group.name, UNSEEN)[1])
            size = (
                None if group.sizes is None else size_by_byte(group.sizes, buffer, place, end, self._quiet, self._lost)
            )
            return group.measure(buffer, place, end, self._names, 0) if size is None else size
        except CODEC_ERRORS as error:
            for info in group.infos:
                self._trouble(info.name, error)
            return 0

    def _at_silence(self, silent: list[FrameInfo], place: int) -> Reading | Verdict | None:
        """Return what candidates are that only silence ends; None while the silence has not come."""
        stop, end = self._silence_after(place), len(self.stream.buffer)
        if stop is None:
            stop = end
            marks = self._marks
            waiting = silent if marks is None else [info for info in silent if not marks.stops(info, end)]
            if waiting:
                self._needs_silence = True
                self.waiting = tuple([info.name for info in waiting])
                return None
        for info in silent:
            last = self._end_for(info, stop)
            good = None if self._bad_frames.is_broken(info, last) else self._read(info, place, last)
            if good is not None:
                return good
        size = self._end_for(silent[0], stop) - place if self._rules.resync == "after_frame" else 0
        return Verdict(size, None, silent, stop)

    def _not_bad(self, wanting: list[FrameInfo], bad: list[tuple[int, CandidateGroup]], place: int) -> list[FrameInfo]:
        """Return the candidates that can become good, given the bad frames at `place`.

        A frame of fixed size cannot if it lacks a constant byte within a bad frame that has all its own constants.
        """
        if not bad or self._inside is not None:
            return wanting
        buffer = self.stream.buffer
        sizes = [size for size, group in bad for info in group.infos if size and info.fits(buffer, place, size) == size]
        if not sizes:
            return wanting
        shortest = min(sizes)
        return [info for info in wanting if not (info.is_fixed and info.fits(buffer, place, shortest) < shortest)]

    def _wait(self, infos: list[FrameInfo], silent: list[FrameInfo], limit: int) -> bool:
        """Wait for the candidates that no mark ends, if there are any."""
        if self._marks is not None:
            marks = self._marks
            infos = [info for info in infos if not marks.stops(info, limit)]
        if infos:
            self.waiting = tuple([info.name for info in (*infos, *silent)])
        return bool(infos)

    def _end_for(self, info: FrameInfo, limit: int) -> int:
        """Return the buffer index where a frame at the position has to end: `limit`, or a mark before it."""
        return limit if self._marks is None else self._marks.end_for(info, limit)

    def _reach_of(self, info: FrameInfo, limit: int) -> int:
        """As `_end_for`, and not beyond bytes where a frame in the middle may begin."""
        if self._inside is not None:
            limit = self._inside.end_for(info.name, limit, self.stream.base)
        return self._end_for(info, limit)

    def _progress(self, place: int) -> dict[str, tuple[int, int]] | None:
        """Return the progress of measuring at `place`, while the names that it depends on are the same."""
        version = 0 if self._scope is None else self._scope.version
        if self._seen_at == self.stream.base + place and self._seen_version == version:
            return self._seen
        self._seen = {}
        return None

    def _remember(self, wanting: list[CandidateGroup], place: int, limit: int) -> None:
        """Remember how far groups that want more have been measured."""
        if limit - place <= MEASURED_AGAIN:
            return
        seen = {}
        for group in wanting:
            had, before = self._reach_of(group.infos[0], limit) - place, self._seen.get(group.name, UNSEEN)
            seen[group.name] = (had, before[0]) if had > before[0] else before
        self._seen, self._seen_at = seen, self.stream.base + place
        self._seen_version = 0 if self._scope is None else self._scope.version

    # ---- good frames --------------------------------------------------------------------------------------

    def _good(self, good: Reading) -> FrameValue | FrameArrived:
        """Hand over a frame at the stream's position; for `arrivals` with its offset and times."""
        info, fields, raw, refusal = good
        start = self.stream.position
        self._declined = []
        self._take(info, start, len(raw))
        if self._all is None:
            return info.make(fields, raw, refusal)
        return self._arrived(info, fields, raw, start, None if refusal is None else info.make(fields, raw, refusal))

    def _take(self, info: FrameInfo, start: int, size: int) -> None:
        """Go on after a frame at buffer index `start`."""
        self.stream.position = start + (size if self._delimiter is None else self._without_shared(start, size))
        self._taken_at, self._good_since, self._seen = start, True, {}
        self._declined.append(info.name)

    def _arrived(
        self,
        info: FrameInfo,
        fields: dict[str, Any],
        raw: bytes,
        start: int,
        value: FrameValue | None,
        offset: int | None = None,
    ) -> FrameArrived:
        """Return a frame at buffer index `start` with its offset and times."""
        stream, arrived = self.stream, FrameArrived()
        arrived.make, arrived.decoded, arrived.raw = info.make, fields, raw
        arrived.offset = stream.offset_of(start) if offset is None else offset
        arrived.times = stream.times_of(start, start + len(raw))
        if value is not None:
            arrived.value = value
        return arrived

    def _taken_out(self, info: FrameInfo, start: int, end: int) -> FrameValue | FrameArrived:
        """Hand over a frame in the middle of a candidate, which then goes on without these bytes."""
        stream = self.stream
        raw = bytes(stream.buffer[start:end])
        try:
            fields = info.decode(raw, self._names)
        except CODEC_ERRORS as error:
            self._trouble(info.name, error)
            fields = {}
        arrived = self._arrived(info, fields, raw, start, None, stream.offset + start - stream.position)
        stream.remove(start, end)
        self._seen, self._inside_frame, self._taken_at = {}, arrived, -1
        return arrived.value if self._all is None else arrived

    def _without_shared(self, start: int, size: int) -> int:
        """Return how many bytes a frame uses: a delimiter at its end may begin the next frame."""
        return size - 1 if size > 1 and self.stream.buffer[start + size - 1] == self._delimiter else size

    # ---- bad frames ---------------------------------------------------------------------------------------

    def _bad(self, levels: Levels, verdict: Verdict, limit: int) -> BadFrame:
        """Report the bad frame at the stream's position, and go on as `resync` says."""
        stream, mode = self.stream, self._rules.resync
        if verdict.sole is not None:
            worst = self._bad_frames.complete(verdict.sole, verdict.size)
        elif verdict.silent:
            worst = self._bad_frames.at_silence(verdict.silent, partial(self._end_for, limit=verdict.stop))
        else:
            worst = self._bad_frames.worst(levels, limit, partial(self._reach_of, limit=limit), self._inside is None)
        start, size = stream.position, self._without_shared(stream.position, worst.size)
        self._begin_bad(worst.frame, size)
        if mode == "never":
            self._break_off()
        elif mode == "after_quiet":
            self._skipping = True
            self._collect(start + size, True)
            self._noise.take()
        elif mode == "after_frame" and worst.has_end:
            stream.position, self._seen = start + size, {}
        else:
            is_pair = stream.buffer[start] == self._rules.symbols
            self._collect(min(start + 1 + is_pair, len(stream.buffer)), True)
        return worst.frame

    def _begin_bad(self, bad: BadFrame, size: int) -> None:
        """Report no bad frame before the end of `bad`, or later in a crowd of bad frames."""
        start, came = self.stream.base + self.stream.position, bad.started_at
        busy = self._bad_busy - MADE_GOOD * BAD_TIME if self._good_since else self._bad_busy
        busy, most = (came if came > busy else busy) + BAD_TIME, came + MOST_BAD * BAD_TIME
        self._good_since = False
        self._bad_end = self._bad_until = start + size
        self._bad_busy = busy
        if busy > most:
            self._bad_busy = most
            if self._rules.resync in GOES_ON:
                self._bad_until = start + max(size, BAD_APART)

    def _break_off(self) -> None:
        self.broken = True
        self._is_open, self._seen = False, {}
        self.stream.clear()

    def _skip(self) -> Again:
        """After a bad frame, skip bytes up to a silence, or up to a marked byte that begins a frame."""
        stream, marks = self.stream, self._marks
        place = self.pauses.silence_behind(stream.position - 1, self._now)
        if marks is not None and self._frames.begins_with_mark:
            marked = marks.next(stream.position)
            place = marked if marked is not None and (place is None or marked < place) else place
        self._skipping = place is None
        self._collect(len(stream.buffer) if place is None else place, True)
        return AGAIN

    # ---- noise --------------------------------------------------------------------------------------------

    def _at_end(self) -> Noise | None:
        """Return the noise that silence ends at the end of the buffer."""
        if (self._noise or self._skipping) and self.pauses.is_quiet(self._now):
            self._skipping = False
            return self._noise.take() if self._noise else None
        return None

    def _collect(self, end: int, skipped: bool) -> None:
        """Take the bytes up to buffer index `end` as noise; `skipped` if a bad frame left them."""
        stream = self.stream
        if end > stream.position:
            self._seen = {}
            self._noise.collect(stream, stream.position, end, skipped)
            stream.position = end

    def _noise_before(self) -> Noise | None:
        """Return the noise before another arrival; None if there is none, or `arrivals` collects it."""
        if not self._noise.data:
            return None
        noise = self._noise.take()
        if self._all is None:
            return noise
        self._all.append(noise)
        return None
