"""Bytes to frames: a scanner that finds expected frames, other frames, bad ones and noise in a stream.

Guide: receiving. Sans-I/O and pull-based: every `next` says which frames are expected. The result does
not depend on how the stream is cut into pieces. At each place it measures the candidates that may begin there, decodes
those that are whole, and reports what it found. It knows no sequences: which step takes a frame is not decided here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from framekit.codec.errors import FrameError
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER
from framekit.link.arrivals import Arrival, BadFrame, FrameArrived, Noise
from framekit.link.candidates import (
    Bad,
    Candidates,
    Complete,
    ExpectedFrames,
    Good,
    Left,
    Start,
    Trouble,
    are_bad,
    furthest,
)
from framekit.link.events import CharacterFault
from framekit.link.frame_table import FrameInfo, FrameTable, ProtocolCodec, table_of
from framekit.link.inside import InsideFinder
from framekit.link.quick_look import any_of
from framekit.link.stream import LONGEST, Marks, NoiseRun, Pauses, Stream, scope_of
from framekit.link.values import CODEC_ERRORS, FrameValue, Names

MOST_BAD, BAD_TIME, BAD_APART = 8, 10_000_000, 256
"""Of bad frames without a good one between them so many are told in a row, then one for each such time (ns).

Of those that come faster, one is told for so many bytes; what is between is what a bad frame left.
"""

from_bytes = int.from_bytes

GOES_ON = ("next_start", "after_frame")
"""Where reading goes on at once after a bad frame: there are crowds of them."""

MEASURED_AGAIN = 256
"""What measuring a beginning has found is remembered if it has more bytes: fewer are measured again sooner."""

MADE_GOOD = 4
"""For so many bad frames a good one makes up."""


class Again:
    """The place has changed: look again."""


AGAIN = Again()


class Receiver:
    """Finds frames. `names` are what expressions of frames read; `pauses` tells how long silences and gaps are.

    `waiting` names the candidates that the bytes at hand fit so far; their first byte came at `waiting_since`.
    `broken`: the stream is out of step, and the definition wants the connection closed; everything is dropped until
    `reset`.
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
        self.broken = False
        self.waiting: tuple[str, ...] = ()
        self._rules = protocol.receiver
        self._delimiter = protocol.receiver.delimiter
        self._is_open = False
        self._names = names
        self._scope = scope_of(names)
        self._version = 0
        self._trouble = trouble
        self._quiet, self._lost = codec.QUIET, codec.LOST
        self._candidates = Candidates(self.stream, names, codec.QUIET, codec.LOST, trouble)
        inside = InsideFinder(self.table, names, codec.QUIET, codec.LOST)
        self._inside = inside if inside else None
        self._wanted: tuple[tuple[str, ...], tuple[str, ...]] = (), ()
        self._expected = self._expect((), ())
        self._all: list[Arrival] | None = None
        self._now = 0
        self._noise = NoiseRun()
        self._given = 0
        self._declined: list[str] = []
        self._needs_silence = False
        self._skipping = False
        self._bad_end = self._bad_until = 0
        self._bad_busy = 0
        self._good_since = False
        self._marks: Marks | None = None
        self.on_scan: Callable[[], None] = lambda: None
        """Told before bytes are looked at with care: whoever knows how long pauses may be says so then."""
        self._given_at = self._taken = 0
        self._taken_as = ""
        self._is_simple = self._delimiter is None and self._inside is None

    def hear_marks(self, on: bool) -> None:
        """Whether the line tells the ninth bits of characters: frames have to be marked as they say."""
        self._marks = self._candidates.marks = Marks(self.stream) if on else None
        self._is_simple = self._delimiter is None and self._inside is None and not on

    # ---- bytes in -----------------------------------------------------------------------------------------

    def append(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> None:
        """Bytes, the last of which came at `now` (ns), and what was wrong with single characters."""
        if self._given:
            self._use()
        if not data or self.broken:
            return
        self._now, self._taken = now, 0
        stream = self.stream
        last = stream.last
        if self._is_open:
            self._is_open = False
            before = stream.give_back()
            data = before + data
            faults = [CharacterFault(len(before) + one.index, one.fault) for one in faults]
        if stream.position < len(stream.buffer) or stream.is_marked or faults:
            goes_on = stream.add(data, now, faults)
        else:
            goes_on = False
            stream.base = base = stream.base + stream.position
            stream.buffer = data if type(data) is bytes else bytes(data)
            stream.position, stream.last = 0, now
            stream.ends, stream.times = [base + len(data)], [now]
        is_mid_stream = goes_on or self._noise.data or self._skipping
        if is_mid_stream and now - last > self.pauses.line.character * len(data):
            self.pauses.note(last, len(data))

    def tick(self, now: int) -> None:
        """Nothing has come until `now`; `next` tells what follows from that."""
        self._now = max(self._now, now)

    def cut(self) -> None:
        """The step that waits allows no longer pause: what is unfinished ends here."""
        stream = self.stream
        place = stream.base + len(stream.buffer)
        if not stream.pauses or stream.pauses[-1] != place:
            stream.mark(stream.pauses, place)

    def answered(self) -> None:
        """This side has sent something: what comes from now on answers that, no silence has to stand before it."""
        if self._skipping:
            self._skipping = False
            if self.stream.position < len(self.stream.buffer):
                self._collect(len(self.stream.buffer) - self.stream.position, True)

    def flush(self) -> list[Noise]:
        """Drops everything that has not become a frame; returns it as noise."""
        if self._given:
            self._use()
        found = [self._noise.take()] if self._noise else []
        stream = self.stream
        if stream.position < len(stream.buffer):
            self._collect(len(stream.buffer) - stream.position, False)
            found.append(self._noise.take())
        stream.clear()
        self._skipping = self._is_open = False
        self.waiting = ()
        return found

    def reset(self) -> list[Noise]:
        """As `flush`; and a broken stream may begin anew."""
        self.broken = False
        return self.flush()

    # ---- what is at hand ----------------------------------------------------------------------------------

    @property
    def is_empty(self) -> bool:
        """Whether every byte has been used or reported."""
        return self.stream.position + self._given >= len(self.stream.buffer) and not self._noise

    @property
    def waiting_since(self) -> int:
        """When the first byte came of those that the candidates in `waiting` fit."""
        return self.stream.time_of(self.stream.position)

    @property
    def is_idle(self) -> bool:
        """Whether nothing is at hand, so that what comes next begins anew."""
        stream = self.stream
        return stream.position + self._given >= len(stream.buffer) and not self._noise.data and not self._skipping

    @property
    def deadline(self) -> int:
        """When `tick` and `next` are to be called although nothing came."""
        stream = self.stream
        if self.waiting:
            quiet, gap = self.pauses.limits()
            deadline = NEVER if gap is None else stream.last + gap
            if self._needs_silence:
                deadline = min(deadline, stream.last + quiet)
        elif self._noise.data or self._skipping or stream.position + self._given < len(stream.buffer):
            deadline = stream.last + self.pauses.limits()[0]
        else:
            return NEVER
        return deadline if deadline > self._now else NEVER

    # ---- frames out ---------------------------------------------------------------------------------------

    def next(self, expected: tuple[str, ...], others: tuple[str, ...] = ()) -> Arrival | None:
        """The next thing in the stream where `expected` frames are looked for, then `others`; None: nothing yet.

        What it returns counts as used at the next call; until then `other_reading` may read the same bytes otherwise.
        """
        found: list[Arrival] = []
        self._scan(expected, others, found, False)
        return found[0] if found else None

    def expect(self, expected: tuple[str, ...], others: tuple[str, ...] = ()) -> ExpectedFrames:
        """What `next_of` looks for: `expected` frames, then `others`."""
        return self.table.once(ExpectedFrames, self.table, expected, others, self._rules.symbols)

    def next_of(self, frames: ExpectedFrames) -> FrameValue | BadFrame | Noise | None:
        """As `next`, with the frames as `expect` has made them; a frame as its value."""
        if self._given:
            self._use()
        self._expected, self._taken = frames, 0
        stream = self.stream
        if self._is_simple and not (stream.is_marked or self._noise.data or self._skipping or self._candidates.said):
            buffer, place = stream.buffer, stream.position
            end = len(buffer)
            try:
                start = frames.starting[buffer[place]] or frames.start(buffer[place])
                row = start.rows[buffer[place + start.told_by]]
                if row is not None and self._now == stream.last:
                    size, counted, read, info, is_doubtful, _ = row
                    if counted:
                        size += buffer[place + counted]
                    elif not size:
                        if info.counted is None:
                            size = info.extent(buffer, place, end, self._names)
                        else:  # if that is wrong, reading it fails
                            size, first, stop, order = info.counted
                            size += from_bytes(buffer[place + first : place + stop], order)
                    if 0 < size <= end - place:
                        raw = bytes(buffer[place : place + size])
                        fields = read(raw, self._names)
                        if is_doubtful is None or not is_doubtful(raw, fields):
                            self.waiting, self._good_since = (), True
                            stream.position = place + size
                            self._taken, self._taken_as = size, info.name
                            return info.make(fields, raw, None)
            except CODEC_ERRORS:
                pass
        self._wanted = frames.wanted
        self.on_scan()
        found: list[Arrival] = []
        self._scan(frames.wanted[0], frames.wanted[1], found, False)
        if not found:
            return None
        event = found[0]
        if not isinstance(event, FrameArrived):
            return event
        self._given_at = event.times[0]
        return event.value

    @property
    def given_since(self) -> int:
        """When the first byte came of the frame that was handed over last."""
        stream = self.stream
        if self._taken:
            return stream.times_of(stream.position - self._taken, stream.position)[0]
        return self._given_at

    def arrivals(self, expected: tuple[str, ...], others: tuple[str, ...] = ()) -> list[Arrival]:
        """All that `next` gives until nothing more is there; all of it counts as used."""
        found: list[Arrival] = []
        self._scan(expected, others, found, True)
        return found

    def other_reading(self) -> FrameArrived | None:
        """The same bytes as another frame that fits them, in the order of the rows; None when there is none."""
        if self._taken:  # it has been gone on behind it already
            self.stream.position -= self._taken
            self._given, self._taken = self._taken, 0
            self._declined.append(self._taken_as)
        if not self._given:
            return None
        stream, candidates = self.stream, self._candidates
        end = len(stream.buffer)
        for infos in self._expected.at(stream.buffer[stream.position]):
            for info in infos:
                if info.name not in self._declined:
                    result = candidates.measure(info, end)
                    if type(result) is Complete:
                        result = candidates.read(info, result)
                    if type(result) is Good:
                        return self._arrived(result.info, result.fields, result.raw, result.refusal)
        return None

    # ---- scanning -----------------------------------------------------------------------------------------

    def _scan(self, expected: tuple[str, ...], others: tuple[str, ...], found: list[Arrival], is_all: bool) -> None:
        """Adds the next thing that is there to `found`, or `is_all`."""
        if self._given:
            self._use()
        self.waiting = ()
        self._all = found if is_all else None
        frames, stream, candidates = self._expected, self.stream, self._candidates
        if self._wanted[0] is not expected or self._wanted[1] is not others:
            frames = self._expect(expected, others)
        if candidates.said and self._scope is not None and self._scope.version != self._version:
            candidates.forget()
        while stream.position < len(stream.buffer) or self._noise.data or self._skipping:
            is_plain = self._delimiter is None and self._now == stream.last and not self._skipping
            is_plain = is_plain and (not stream.is_marked or self._is_plain())
            if self._delimiter is not None:
                if self._pass_fill(found):
                    if found and not is_all:
                        break
                    continue
            elif self._marks is not None:
                is_plain = False
            elif not is_plain:
                self._pass_over(frames, found)
            elif self._read_row(frames, found, is_all):
                break
            if found and not is_all:
                break
            if stream.position >= len(stream.buffer) and is_plain and not self._noise.data:
                break
            arrival = self._look(frames)
            if arrival is None:
                break
            if not isinstance(arrival, Again):
                found.append(arrival)
                if not is_all:
                    break
                if self._given:
                    self._use()
        if candidates.said and self._scope is not None:
            self._version = self._scope.version

    def _expect(self, expected: tuple[str, ...], others: tuple[str, ...]) -> ExpectedFrames:
        """What is prepared for these names; the very tuples are kept, so that the next call knows them at once."""
        self._wanted = expected, others
        self._expected = self.table.once(ExpectedFrames, self.table, expected, others, self._rules.symbols)
        return self._expected

    def _is_plain(self) -> bool:
        """Whether only the bytes themselves count: no long pause, damaged character or frame taken out."""
        stream = self.stream
        return not (stream.pauses or stream.faults or stream.taken_out)

    def _read_row(self, frames: ExpectedFrames, found: list[Arrival], is_all: bool) -> bool:
        """Reads frames as long as each place tells by itself what begins there, and passes over noise between them.

        It stops where `_look` has to compare candidates, and finds nothing that `_look` would not find. Tells whether
        a frame has begun and wants more bytes.
        """
        stream, candidates = self.stream, self._candidates
        buffer, end, size = stream.buffer, len(stream.buffer), 0
        is_bytes = type(buffer) is bytes
        looked_at = (stream.position if self._noise.data else -1) if is_bytes else end
        try:
            while (place := stream.position) < end and (is_all or not found):
                start = frames.starting[buffer[place]] or frames.start(buffer[place])
                is_next = place > looked_at and (size > 0 or not (size or candidates.said))
                if is_next and place + start.enough <= end and start.rows[buffer[place + start.told_by]] is not None:
                    size = self._read_frames(frames, buffer, end, size, found, is_all)
                    looked_at = stream.position
                    if looked_at > place or (found and not is_all):
                        continue
                if place + start.at >= end:
                    return False
                left = start.left[buffer[place + start.at]]
                info = left.alone
                if info is None and left.infos and not self._noise.data:
                    info, size = self._shortest(left, place)
                elif info is not None and not size and candidates.said:
                    seen = candidates.seen(info)
                    if seen is None:
                        return False
                    size = info.measure(buffer, place, end, self._names, seen)
                    if size > 0:
                        self._moved()
                        continue
                elif info is not None and not size:
                    size = self._measured(info, left, buffer, place, end)
                is_new = stream.base + place >= self._bad_until
                if size < 0 and (is_new or size != self._lost):
                    return size > self._quiet and self._is_begun(start, left, size)
                is_noise = start.is_noise or (left.is_told and not size)
                if info is not None and size > 0:
                    raw = bytes(buffer[place : place + size])
                    if left.is_told and info.intact is not None and not info.intact(raw):
                        if is_new and not self._tell_bad(info, raw, found):
                            return False
                        is_noise = True
                    elif self._read_one(info, left, raw, found):
                        size = 0
                        continue
                    elif is_new:
                        return False
                intact = self._pass_noise(frames, end, start.is_noise) if is_noise else None
                if intact is None:
                    self._pass_over(frames, found)
                    if place == stream.position:
                        break
                size = 0
                if is_bytes and not intact:
                    looked_at = stream.position
        except CODEC_ERRORS:
            pass
        return False

    def _read_frames(
        self, frames: ExpectedFrames, buffer: Any, end: int, known: int, found: list[Arrival], is_all: bool
    ) -> int:
        """Reads good frames in a row, up to where bytes at fixed places do not tell which frame begins there.

        `buffer`: bytes, up to `end`. `known`: the size of the first, if it has been measured. Gives a size below 0
        where a frame surely wants more, else 0.
        """
        stream, names, noise, starting = self.stream, self._names, self._noise.data, frames.starting
        place, offset = stream.position, stream.base + stream.removed
        came, newest = (stream.last, stream.last), stream.ends[-2] - stream.base if len(stream.ends) > 1 else 0
        wanting, quiet = 0, self._quiet
        try:
            while place < end:
                start = starting[buffer[place]] or frames.start(buffer[place])
                if place + start.enough > end:
                    break
                row = start.rows[buffer[place + start.told_by]]
                if row is None:
                    break
                size, counted, read, info, is_doubtful, most = row
                if counted:
                    size += buffer[place + counted]
                elif not size:
                    size = known or info.extent(buffer, place, end, names)
                    known = 0
                    if size <= 0:
                        wanting = size if size > quiet else 0
                        break
                stop = place + size
                if stop > end:
                    wanting = end - stop if size <= most else 0
                    break
                raw = buffer[place:stop]
                fields = read(raw, names)
                if is_doubtful is not None and is_doubtful(raw, fields):
                    break
                if noise:
                    found.append(self._noise.take())
                    if not is_all:
                        break
                arrived = FrameArrived()
                arrived.make, arrived.decoded, arrived.raw = info.make, fields, raw
                arrived.offset = offset + place
                arrived.times = came if place >= newest else stream.times_of(place, stop)
                found.append(arrived)
                if not is_all:
                    self._given = size
                    arrived.value = info.make(fields, raw, None)
                    self._declined.append(info.name)
                    break
                place = stop
        except CODEC_ERRORS:
            pass
        if place != stream.position or self._given:
            self._good_since = True
            stream.position = place
            if self._inside is not None and self._inside.places:
                self._moved()
        return wanting

    def _measured(self, info: FrameInfo, left: Left, buffer: bytes | bytearray, place: int, end: int) -> int:
        """How long the only frame left at `place` is if it is good, of which nothing was said before."""
        row = left.rows[buffer[place + left.at]] if left.is_told and place + left.enough <= end else None
        if row is not None:
            size = row[0] + (buffer[place + row[1]] if row[1] else 0)
            if size <= left.most:
                return size if place + size <= end else end - place - size
        return info.extent(buffer, place, end, self._names)

    def _read_one(self, info: FrameInfo, left: Left, raw: bytes, found: list[Arrival]) -> bool:
        """Reads a whole frame at the present place; false if it is bad, or only `_look` can tell what it is."""
        try:
            fields = info.decode(raw, self._names)
        except FrameError:
            return False
        if info.guesses and "unknown" in fields[info.inner or ""]:
            return False
        if self._inside is not None and not (left.sure and self._inside.is_none_in(left.names, raw)):
            return False
        noise = self._noise_before()
        found.append(noise or self._arrived(info, fields, raw))
        if noise is None and self._all is not None:
            self._use()
        return True

    def _pass_noise(self, frames: ExpectedFrames, total: int, is_start: bool) -> bool | None:
        """Passes over noise here and behind, as far as fixed bytes surely tell that it is, or is left of a bad frame.

        `is_start`: nothing begins with the byte here. None: only `_pass_over` may pass over it; else whether it has
        come to a frame whose check code is right.
        """
        stream, noise, rules = self.stream, self._noise, self._rules
        buffer, first = stream.buffer, stream.position
        held = len(noise.data)
        untold, symbol = self._bad_until - stream.base, rules.symbols
        is_plain, is_skipped = rules.resync == "next_start" and symbol is None, first < untold
        if not (is_start or is_plain) or buffer[first] == symbol or rules.resync == "never" or stream.silences:
            return None
        if held and (noise.skipped is not is_skipped or held >= LONGEST):
            return None
        starting, stops, is_intact = frames.starting, frames.stops, False
        place, end = first + 1, min(total, first + LONGEST - held, untold if is_skipped else total)
        while place < end:
            if stops is not None:
                match = stops.search(buffer, place, end)
                if match is None:
                    place = end
                    break
                place = match.start()
            start = starting[buffer[place]] or frames.start(buffer[place])
            if not start.is_noise:
                if not is_plain or place + start.enough > total:
                    break
                left = start.left[buffer[place + start.at]]
                row = left.rows[buffer[place + left.at]] if left.is_told else None
                if row is None or left.alone is None:
                    break
                size, counted, _ = row
                if size:
                    size += buffer[place + counted] if counted else 0
                    intact = left.alone.intact
                    if not is_skipped or intact is None or size > left.most or place + size > total:
                        break
                    if intact(buffer[place : place + size]):
                        is_intact = True
                        break
            elif buffer[place] == symbol:
                break
            place += 1
        self._collect(place - first, is_skipped)
        return is_intact

    def _tell_bad(self, info: FrameInfo, raw: bytes, found: list[Arrival]) -> bool:
        """Tells of a frame at the present place with a wrong check code; false: something else comes first."""
        rules = self._rules
        if rules.resync != "next_start" or rules.symbols is not None or self.stream.silences or self._noise.is_long:
            return False
        noise = self._noise_before()
        if noise is not None:
            found.append(noise)
            return False
        bad = self._candidates.intact_fault(info, raw)
        self._begin_bad(bad, len(raw))
        found.append(bad)
        return True

    def _is_begun(self, start: Start, left: Left, size: int) -> bool:
        """Whether the frame that has begun here, as measuring says by `size`, wants more before anything else."""
        stream, info = self.stream, left.alone
        if info is None or stream.silences or self._noise.is_long or self._now != stream.last:
            return False
        place, end, inside = stream.position, len(stream.buffer), self._inside
        is_told = left.is_told and (place + left.enough > end or left.rows[stream.buffer[place + left.at]] is not None)
        if not left.sure:
            left = start.wanted
            if not (left.compare() if left.alike is None else left.alike):
                return False
        if inside is not None and not inside.holders.isdisjoint(left.names) and not inside.is_none_behind(stream):
            return False
        if info.guesses and size >= -info.behind and not self._candidates.said:
            size = info.measure(stream.buffer, place, end, self._names, 0)
            if size >= 0 or size <= self._quiet:
                return False
        if len(left.infos) > 1 or (not is_told and end - place > MEASURED_AGAIN):
            for one in left.infos:
                self._candidates.wants_more(one, end - place)
        self._needs_silence = False
        self.waiting = left.names
        return True

    def _shortest(self, left: Left, place: int) -> tuple[FrameInfo | None, int]:
        """The shortest frame of several that may be good at `place`; a size below 0 where that is not sure."""
        candidates, buffer, names = self._candidates, self.stream.buffer, self._names
        if not candidates.said and (left.compare() if left.alike is None else left.alike):
            size = left.infos[0].measure(buffer, place, len(buffer), names, 0)
            raw = bytes(buffer[place : place + size]) if size > 0 else b""
            for info in left.infos if raw else ():
                if info.intact is None or info.intact(raw):
                    return info, size
            return None, -1
        whole: list[tuple[int, int, FrameInfo]] = []
        for number, info in enumerate(left.infos):
            seen = candidates.seen(info)
            if seen is None:
                return None, -1
            size = info.measure(buffer, place, len(buffer), names, seen)
            if size > 0:
                whole.append((size, number, info))
        if len(whole) > 1:
            whole.sort()
        for size, _, info in whole:
            if len(whole) == 1 or info.intact is None or info.intact(bytes(buffer[place : place + size])):
                return info, size
        return None, -1 if left.infos else 0

    def _pass_over(self, frames: ExpectedFrames, found: list[Arrival]) -> None:
        """Passes over places where no good frame begins, and none that is told of or wants more bytes.

        It does at each place what `_look` does, and leaves to that all that may be anything else. Noise that ends here
        comes to `found`.
        """
        stream, inside, symbol = self.stream, self._inside, self._rules.symbols
        buffer, place = stream.buffer, stream.position
        if self._skipping or place >= len(buffer) or self._rules.resync == "never":
            return
        is_skipped = stream.base + place < self._bad_until
        goes_on = bool(self._noise.data) and self._noise.skipped is is_skipped
        total, is_cut = self.pauses.reach(self._now)
        silence = stream.first_after(stream.silences, place - 1) if stream.silences else None
        end = total if silence is None else min(total, silence)
        if end == place or self._noise.is_long:
            return
        end = min(end, place + LONGEST - (len(self._noise.data) if goes_on else 0))
        stop: int | None = None
        whole = self._bad_end - stream.base if self._rules.resync == "after_frame" else end
        if is_skipped:
            end = min(end, self._bad_until - stream.base)
            stop = self.pauses.silence_behind(place, self._now)
        if self._candidates.said and not (is_skipped and (is_cut or (self._needs_silence and stop is not None))):
            return
        names, quiet, every, stops = self._names, self._quiet, frames.every, frames.stops
        first, starting = place, every.starting
        mark = 0
        try:
            while place < end:
                start = starting[buffer[place]] or every.start(buffer[place])
                at = place + start.at
                if at >= total:
                    break
                left = start.left[buffer[at]]
                reach = total
                if inside is not None and not (left.sure and inside.holders.isdisjoint(left.names)):
                    if mark <= place:
                        mark = inside.first_mark(buffer, place, total)
                    reach = mark
                ends = left.ends or every.ends(left, buffer[place])
                groups, silent, bad, jump = ends.groups, None, None, 0
                only = ends.silent[buffer[place + ends.at]] if place + ends.at < reach else None
                if only is not None:
                    if only and not is_skipped:
                        break
                    groups = ()
                    if reach - place <= -only:
                        silent = ends.look
                for (at, sizes, counted, most), extent, measure, look, group in groups:
                    known = sizes[buffer[place + at]] if place + at < reach else None
                    if known == 0:
                        continue
                    if known is not None and (more := counted[buffer[place + at]]):
                        known = known + buffer[place + more] if place + more < reach else None
                        if known is not None and known > most:
                            known = None
                    if known is None:
                        size = extent(buffer, place, reach, names)
                        if size == 0:
                            continue
                    elif known < 0:
                        size = quiet if reach - place <= -known else self._lost
                    else:
                        size = known if place + known <= reach else reach - place - known
                    if not is_skipped or (quiet < size < 0 and not (is_cut and reach == total)):
                        break
                    if size == quiet:
                        silent = look if silent is None else any_of((silent, look))
                    elif size > 0 and look(raw := buffer[place : place + size]) and not are_bad(group, raw, names):
                        break
                    elif place < whole:
                        bad = measure
                    elif (size > 0 or jump) and (bad is not None or group[0].guesses or place + size > end):
                        break
                    else:
                        bad, jump = measure, max(size, 0)
                else:
                    if (
                        silent is not None
                        and (stop is None or silent(buffer[place:stop]))
                        and (bad is None or bad(buffer, place, total, names) in (0, quiet))
                    ):
                        break
                    step = jump or 1
                    if not jump and buffer[place] == symbol:
                        if place + 1 == total:
                            break
                        step = 2
                    if stops is None:
                        place += step
                    elif place + step < end:
                        match = stops.search(buffer, place + step, end)
                        place = end if match is None else match.start()
                    else:
                        place += step
                    continue
                break
        except CODEC_ERRORS:
            pass
        if place > first:
            if self._noise.data and not goes_on:
                found.append(self._noise.take())
            self._collect(place - first, is_skipped)

    def _pass_fill(self, found: list[Arrival]) -> bool:
        """Passes over delimiters that begin no frame: others follow them, or nothing does yet. Whether there are any.

        The last one begins a frame when something follows (`append`), and noise may go on with that frame; noise
        surely ends before another one, and comes to `found`.
        """
        stream, delimiter = self.stream, self._delimiter
        buffer, place = stream.buffer, stream.position
        end = len(buffer)
        while place < end and buffer[place] == delimiter and (place + 1 == end or buffer[place + 1] == delimiter):
            place += 1
        if place == stream.position or self._skipping:
            return False
        self._is_open = place == end
        if self._noise.data and place - stream.position > self._is_open:
            found.append(self._noise.take())
        self._move(place - stream.position)
        return True

    def _look(self, frames: ExpectedFrames) -> Arrival | Again | None:
        """What is at the present place, all candidates compared, and whatever may be strange about it."""
        stream = self.stream
        position = stream.position
        self.waiting = ()
        self._needs_silence = False
        if position >= len(stream.buffer):
            return self._at_end()
        if self._skipping:
            return self._skip()
        if self._noise and (self._noise.is_long or stream.first_after(stream.silences, position - 1) == position):
            return self._noise.take()
        limit, is_cut = self.pauses.reach(self._now)
        levels = frames.levels(stream.buffer, position, limit)
        if self._marks is not None:
            levels = self._marks.beginning(levels)
        if self._inside:
            inside = self._inside.find(stream, sum(levels, ()), limit)
            if inside is not None:
                return self._noise_before() or self._taken_out(*inside)
        bad_by_level: list[Sequence[Bad]] = []
        silent: list[FrameInfo] = []
        is_told = stream.base + position >= self._bad_until
        self._candidates.shortest_bad = None
        for infos in levels:
            good, bad, wanting = self._candidates.validate(infos, limit, silent, self._inside, is_told)
            if good is not None:
                return self._noise_before() or self._arrived(good.info, good.fields, good.raw, good.refusal)
            going_on = wanting
            if self._marks is not None:
                going_on = [info for info in wanting if not self._marks.stops(info, limit)]
            if going_on and not is_cut:
                self._wait((*going_on, *silent))
                return None
            if bad:
                bad_by_level.append(bad)
            elif wanting and not bad_by_level:
                bad_by_level.append((self._candidates.cut(wanting[0], self._end_for(wanting[0], limit)),))
        if bad_by_level and not is_told:
            return self._bad(self._unreported(bad_by_level[0]))
        if bad_by_level:
            return self._noise_before() or self._bad(furthest(bad_by_level))
        return self._ended_by_silence(silent) if silent else self._unusable()

    def _unreported(self, bad: Sequence[Bad]) -> Bad:
        """Return a bad frame that is passed over: where the size counts, the same however the bytes have come."""
        if len(bad) == 1 or self._rules.resync != "after_frame":
            return bad[0]
        return min(bad, key=lambda one: one.size if one.known_end else 0)

    def _wait(self, infos: tuple[FrameInfo, ...]) -> None:
        self.waiting = tuple(info.name for info in infos)

    def _ended_by_silence(self, silent: list[FrameInfo]) -> Arrival | Again | None:
        """Rule 4: nothing else applies; the frame ends where a silence begins."""
        stop, end = self.pauses.silence_behind(self.stream.position, self._now), len(self.stream.buffer)
        waiting = silent if stop is None else []
        if stop is None and self._marks is not None:
            waiting = [info for info in silent if not self._marks.stops(info, end)]
        if waiting:
            self._needs_silence = True
            self._wait(tuple(waiting))
            return None
        bad: list[Bad] = []
        for info in silent:
            result = self._candidates.at_silence(info, self._end_for(info, end if stop is None else stop))
            if isinstance(result, Good):
                return self._noise_before() or self._arrived(result.info, result.fields, result.raw, result.refusal)
            if isinstance(result, Bad):
                bad.append(result)
        return self._bad(furthest((bad,))) if bad else self._unusable()

    def _end_for(self, info: FrameInfo, limit: int) -> int:
        """How far a frame here can reach (buffer index): up to `limit`, where no mark ends it before."""
        return limit if self._marks is None else self._marks.end_for(info, limit)

    # ---- good frames --------------------------------------------------------------------------------------

    def _arrived(self, info: FrameInfo, fields: dict[str, Any], raw: bytes, refusal: int | None = None) -> FrameArrived:
        """A good frame at the present place, or one to be refused, is handed over."""
        self._given = self._without_shared(len(raw))
        self._good_since = True
        self._declined.append(info.name)
        arrived = self._arrival(info, fields, raw, self.stream.position)
        if refusal is not None or self._all is None:
            arrived.value = info.make(fields, raw, refusal)
        return arrived

    def _arrival(self, info: FrameInfo, fields: dict[str, Any], raw: bytes, place: int) -> FrameArrived:
        """A frame that stands at buffer index `place`."""
        stream, arrived = self.stream, FrameArrived()
        arrived.make, arrived.decoded, arrived.raw = info.make, fields, raw
        arrived.offset = stream.offset + place - stream.position
        arrived.times = stream.times_of(place, place + len(raw))
        return arrived

    def _taken_out(self, info: FrameInfo, start: int, end: int) -> FrameArrived | None:
        """A frame that stood inside the one that is arriving: handed over at once, it counts in nothing there."""
        stream = self.stream
        raw = bytes(stream.buffer[start:end])
        try:
            fields = info.decode(raw, self._names)
        except CODEC_ERRORS as error:
            self._trouble(info.name, error)
            fields = {}
        arrived = self._arrival(info, fields, raw, start)
        stream.remove(start, end)
        self._candidates.forget()
        return arrived

    def _without_shared(self, size: int) -> int:
        """How many bytes a frame of `size` bytes here takes: the delimiter at its end may begin the next one."""
        stream = self.stream
        return size - 1 if size > 1 and stream.buffer[stream.position + size - 1] == self._delimiter else size

    def _use(self) -> None:
        """Goes on behind what was handed over last."""
        self.stream.position += self._given
        self._given = 0
        self._declined.clear()
        if self._candidates.said or (self._inside is not None and self._inside.places):
            self._moved()

    def _moved(self) -> None:
        """The place in the stream has changed."""
        self._candidates.forget()
        if self._inside is not None:
            self._inside.forget()

    # ---- bad frames ---------------------------------------------------------------------------------------

    def _bad(self, worst: Bad) -> Arrival | Again | None:
        """Reports a bad frame once; bad frames that begin inside one that has been reported are not new ones."""
        stream = self.stream
        start = stream.base + stream.position
        if start < self._bad_until:
            is_whole = self._rules.resync == "after_frame" and worst.known_end and start >= self._bad_end
            return self._unusable(self._without_shared(worst.size) if is_whole else 0)
        before = self._noise_before()
        if before is not None:
            return before
        bad, size, mode = worst.bad, self._without_shared(worst.size), self._rules.resync
        self._begin_bad(bad, size)
        if mode == "never":
            self._break_off()
        elif mode == "after_quiet":
            self._skipping = True
            self._collect(size, True)
            self._noise.take()
        elif mode == "after_frame" and worst.known_end:
            self._move(size)
        else:
            self._collect(self._symbol(), True)
        return bad

    def _begin_bad(self, bad: BadFrame, size: int) -> None:
        """A bad frame at the present place is told; none that begins before its end is told anew, or further in a
        crowd.
        """
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
        self._is_open = False
        self.stream.clear()
        self._moved()

    @property
    def _begins_with_mark(self) -> bool:
        """Whether a frame that is looked for has a mark at its first byte."""
        infos = self.table.infos
        return any(infos[name].frame.mark == "first" for names in self._wanted for name in names)

    def _skip(self) -> Again | None:
        """After a bad frame, where reading goes on only behind a silence."""
        stream = self.stream
        place = self.pauses.silence_behind(stream.position - 1, self._now)
        if self._marks is not None and self._begins_with_mark:
            marked = self._marks.next(stream.position)
            place = marked if marked is not None and (place is None or marked < place) else place
        self._skipping = place is None
        stop = len(stream.buffer) if place is None else place
        if stop > stream.position:
            self._collect(stop - stream.position, True)
        return AGAIN

    # ---- noise --------------------------------------------------------------------------------------------

    def _at_end(self) -> Noise | None:
        if (self._noise or self._skipping) and self.pauses.is_quiet(self._now):
            self._skipping = False
            return self._noise.take() if self._noise else None
        return None

    def _unusable(self, whole: int = 0) -> Arrival | Again | None:
        """Rule 5: the bytes here begin nothing, or a frame of `whole` bytes that is bad but not told."""
        stream = self.stream
        skipped = stream.base + stream.position < self._bad_until
        if self._noise and self._noise.skipped != skipped:
            return self._noise.take()
        if self._rules.resync == "never":
            self._collect(1, False)
            self._break_off()
            return self._noise.take()
        symbols = self._rules.symbols
        count = whole or (self._to_next_start(skipped) if symbols is None else self._symbol())
        if count == 1 and stream.buffer[stream.position] == symbols and not self.pauses.is_quiet(self._now):
            return None
        self._collect(count, skipped)
        return AGAIN

    def _symbol(self) -> int:
        """How many bytes are passed over together: two, when the first is the escape symbol and the second is there."""
        stream = self.stream
        if stream.buffer[stream.position] != self._rules.symbols:
            return 1
        return min(2, len(stream.buffer) - stream.position)

    def _to_next_start(self, skipped: bool) -> int:
        """Bytes up to the next that may begin a frame, not over a silence or the end of a bad frame."""
        stream, starts = self.stream, self._expected.starts
        if starts is None:
            return 1
        match = starts.search(stream.buffer, stream.position + 1)
        stops = [len(stream.buffer) if match is None else match.start()]
        silence = stream.first_after(stream.silences, stream.position)
        if silence is not None:
            stops.append(silence)
        if skipped:
            stops.append(self._bad_until - stream.base)
        return max(1, min(stops) - stream.position)

    def _collect(self, count: int, skipped: bool) -> None:
        """So many bytes are noise, or are left of a bad frame."""
        stream = self.stream
        position = stream.position
        self._noise.collect(stream, position, position + count, skipped)
        stream.position = position + count
        if self._candidates.said or (self._inside is not None and self._inside.places):
            self._moved()

    def _move(self, count: int) -> None:
        self.stream.position += count
        self._moved()

    def _noise_before(self) -> Noise | None:
        """The noise before something else; None if there is none, or it has been added to all that is found."""
        if not self._noise.data:
            return None
        noise = self._noise.take()
        if self._all is None:
            return noise
        self._all.append(noise)
        return None
