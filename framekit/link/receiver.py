"""Bytes to frames: finds expected frames, other frames, bad ones and noise in a stream (language reference, section 6).

Sans-I/O and pull-based: whoever waits says at every `next` what he waits for. The result does not depend on how the
stream is cut into pieces. It knows no sequences; who takes a frame and what follows is not its business.
"""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.errors import FrameError
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER
from framekit.link.arrivals import Arrival, FrameArrived, Noise
from framekit.link.candidates import Bad, Candidates, Complete, Good, Trouble, Unfinished, worse
from framekit.link.evaluate import EVALUATION_ERRORS, Names
from framekit.link.events import CharacterFault
from framekit.link.frame_table import Codec, FrameInfo, FrameTable
from framekit.link.inside import InsideFinder
from framekit.link.interest import Interest
from framekit.link.pauses import Pauses, scope_of
from framekit.link.recovery import Again, Recovery
from framekit.link.stream import Stream


def _ignore(frame: str, error: Exception) -> None:
    return None


class Receiver(Recovery):
    """Finds frames. `names` are what expressions of frames read; `pauses` tells how long silences and gaps are.

    `deadline`: when `tick` and `next` are to be called although nothing came. `waiting` names the candidates that the
    bytes at hand fit so far; their first byte came at `waiting_since`. `broken`: the stream is out of step, and the
    definition wants the connection closed; everything is dropped until `reset`.
    """

    def __init__(
        self,
        codec: Codec,
        protocol: Protocol,
        names: Names,
        table: FrameTable | None = None,
        trouble: Trouble = _ignore,
    ) -> None:
        super().__init__(protocol.receiver)
        self.table = table or FrameTable(protocol, codec)
        self.stream = Stream()
        self.pauses = Pauses(protocol.receiver, names, self.stream)
        self.deadline = NEVER
        self.waiting: tuple[str, ...] = ()
        self.waiting_since = 0
        self._names = names
        self._scope = scope_of(names)
        self._candidates = Candidates(self.stream, names, codec.QUIET, codec.LOST, trouble)
        inside = InsideFinder(self.table, names)
        self._inside = inside if inside else None
        self._trouble = trouble
        self._interests: dict[tuple[tuple[str, ...], tuple[str, ...]], Interest] = {}
        self._interest = self._interest_of((), ())
        self._version = 0
        self._given = 0
        self._declined: list[str] = []
        self._needs_silence = False

    # ---- bytes in -----------------------------------------------------------------------------------------

    def append(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> None:
        """Bytes, the last of which came at `now` (ns), and what was wrong with single characters."""
        if self._given:
            self._use()
        if not data or self.broken:
            return
        self._now = now
        stream = self.stream
        stream.tidy()
        if stream.buffer or self._noise or self._skipping:
            self.pauses.note(now, len(data))
        stream.add(data, now, faults)

    def tick(self, now: int) -> None:
        """Nothing has come until `now`; `next` tells what follows from that."""
        self._now = max(self._now, now)

    def cut(self) -> None:
        """Whoever waits allows no longer pause: what is unfinished ends here."""
        stream = self.stream
        place = stream.base + len(stream.buffer)
        if not stream.pauses or stream.pauses[-1] != place:
            stream.pauses.append(place)

    @property
    def is_empty(self) -> bool:
        """Whether every byte has been used or reported."""
        return self.stream.position + self._given >= len(self.stream.buffer) and not self._noise

    # ---- frames out ---------------------------------------------------------------------------------------

    def next(self, expected: tuple[str, ...], others: tuple[str, ...] = ()) -> Arrival | None:
        """The next thing in the stream for those who wait for `expected`, then `others`; None: nothing yet.

        What it returns counts as used at the next call; until then `other_reading` may read the same bytes otherwise.
        """
        if self._given:
            self._use()
        interest = self._interest
        if interest.expected is not expected or interest.others is not others:
            interest = self._interest_of(expected, others)
        if self._candidates.said and self._scope is not None and self._scope.version != self._version:
            self._candidates.forget()
        stream = self.stream
        if stream.position >= len(stream.buffer) and not self._noise.data and not self._skipping:
            self.waiting = ()
            self.deadline = NEVER
            return None
        usual = self._at_once(interest)
        if usual is not None:
            return usual
        if self._scope is not None:
            self._version = self._scope.version
        while True:
            found = self._look(interest)
            if not isinstance(found, Again):
                if found is None:
                    self._set_deadline()
                return found

    def other_reading(self) -> FrameArrived | None:
        """The same bytes as another frame that fits them, in the order of the rows; None when there is none."""
        if not self._given:
            return None
        stream, interest = self.stream, self._interest
        end = len(stream.buffer)
        for level, infos in enumerate(interest.at(stream.buffer[stream.position])):
            for info in infos:
                if info.name not in self._declined:
                    result = self._candidates.ask(info, end)
                    if type(result) is Complete:
                        result = self._candidates.read(info, result)
                    if type(result) is Good:
                        return self._arrived(result, level == 1)
        return None

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
        self._skipping = False
        self.waiting = ()
        self.deadline = NEVER
        return found

    def reset(self) -> list[Noise]:
        """As `flush`; and a broken stream may begin anew."""
        self.broken = False
        return self.flush()

    # ---- one place ----------------------------------------------------------------------------------------

    def _at_once(self, interest: Interest) -> FrameArrived | None:
        """The usual case: nothing strange has happened, and a frame is there whole. Else None; nothing is changed."""
        stream = self.stream
        if self._noise.data or self._skipping or self._now != stream.last or stream.pauses or stream.faults:
            return None
        buffer, position, names = stream.buffer, stream.position, self._names
        end, whole = len(buffer), []
        said = self._candidates.said
        likely = interest.likely(buffer, position)
        try:
            for info in likely:
                seen = 0
                if said:
                    before = said.get(info.name)
                    if type(before) is not Unfinished or before.silent:
                        return None
                    if end - position < before.wanted:
                        continue
                    seen = before.seen
                length = info.measure(buffer, position, end, names, seen)
                if length > 0:
                    whole.append((length, info))
        except EVALUATION_ERRORS:
            return None
        if len(whole) > 1:
            whole.sort(key=_size_of)
        for size, info in whole:
            raw = bytes(buffer[position : position + size])
            if len(whole) > 1 and info.intact is not None and not info.intact(raw):
                continue
            if self._inside is not None and not self._inside.nothing_in(
                stream, position + size, info, interest.at(buffer[position])
            ):
                return None
            try:
                fields = info.decode(raw, names)
            except FrameError as error:
                if error.refuse is not None:
                    return None
                continue
            except EVALUATION_ERRORS:
                return None
            self._given = size
            self._declined.append(info.name)
            value = self.table.received_as(info, fields, raw, None)
            started = stream.time_of(position)
            ended = started if stream.came_at_once else stream.time_of(position + size - 1)
            return FrameArrived(value, raw, stream.offset, started, ended)
        return None

    def _look(self, interest: Interest) -> Arrival | Again | None:
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
        levels = interest.at(stream.buffer[position])
        if self._inside:
            found = self._inside.find(stream, (*levels[0], *levels[1]))
            if found is not None:
                return self._noise_before() or self._taken_out(*found)
        limit, is_cut = self.pauses.reach(self._now)
        worst: Bad | None = None
        silent: list[FrameInfo] = []
        for level, infos in enumerate(levels):
            good, bad, wanting = self._candidates.judge(infos, limit, silent, self._inside)
            if good is not None:
                return self._noise_before() or self._arrived(good, level == 1)
            if wanting and not is_cut:
                self._wait((*wanting, *silent))
                return None
            worst = bad if worst is None or (bad is not None and bad.bad.place > worst.bad.place) else worst
            if wanting and worst is None:
                worst = self._candidates.cut(wanting[0], limit)
        if worst is not None:
            return self._bad(worst)
        return self._ended_by_silence(silent) if silent else self._unusable()

    def _wait(self, infos: tuple[FrameInfo, ...]) -> None:
        self.waiting = tuple(info.name for info in infos)
        self.waiting_since = self.stream.time_of(self.stream.position)

    def _ended_by_silence(self, silent: list[FrameInfo]) -> Arrival | Again | None:
        """Rule 4: nothing else applies; the frame ends where a silence begins."""
        stop = self.pauses.silence_behind(self.stream.position, self._now)
        if stop is None:
            self._needs_silence = True
            self._wait(tuple(silent))
            return None
        worst: Bad | None = None
        for info in silent:
            result = self._candidates.at_silence(info, stop)
            if isinstance(result, Good):
                return self._noise_before() or self._arrived(result, info.name not in self._interest.expected)
            if isinstance(result, Bad):
                worst = worse(worst, result)
        return self._unusable() if worst is None else self._bad(worst)

    def _arrived(self, good: Good, other: bool) -> FrameArrived:
        stream = self.stream
        position, size = stream.position, len(good.raw)
        self._given = size
        self._declined.append(good.info.name)
        value = self.table.received_as(good.info, good.fields, good.raw, good.refusal)
        started = stream.time_of(position)
        ended = stream.time_of(position + size - 1)
        return FrameArrived(value, good.raw, stream.offset, started, ended, other)

    def _taken_out(self, info: FrameInfo, start: int, end: int) -> FrameArrived | None:
        """A frame that stood inside the one that is arriving: handed over at once, it counts in nothing there."""
        stream = self.stream
        raw = bytes(stream.buffer[start:end])
        offset = stream.offset + start - stream.position
        times = stream.time_of(start), stream.time_of(end - 1)
        stream.remove(start, end)
        self._candidates.forget()
        try:
            value = self.table.received(info.name, info.decode(raw, self._names), raw, None)
        except EVALUATION_ERRORS as error:
            self._trouble(info.name, error)
            value = self.table.received(info.name, {}, raw, None)
        return FrameArrived(value, raw, offset, *times)

    def _use(self) -> None:
        """Goes on behind what was handed over last."""
        self.stream.position += self._given
        self._given = 0
        self._declined.clear()
        if self._candidates.said or self._inside is not None:
            self._moved()

    def _moved(self) -> None:
        self._candidates.forget()
        if self._inside is not None:
            self._inside.forget()

    # ---- time ---------------------------------------------------------------------------------------------

    def _set_deadline(self) -> None:
        stream = self.stream
        deadline = NEVER
        if self.waiting:
            quiet, gap = self.pauses.limits()
            if gap is not None:
                deadline = stream.last + gap
            if self._needs_silence:
                deadline = min(deadline, stream.last + quiet)
        elif self._noise or self._skipping or stream.position < len(stream.buffer):
            deadline = stream.last + self.pauses.limits()[0]
        self.deadline = deadline if deadline > self._now else NEVER

    def _interest_of(self, expected: tuple[str, ...], others: tuple[str, ...]) -> Interest:
        """The prepared interest; it keeps these very tuples, so that the next call sees at once they are the same."""
        interest = self._interests.get((expected, others))
        if interest is None:
            interest = self._interests[expected, others] = Interest(self.table, expected, others)
        interest.expected, interest.others = expected, others
        self._interest = interest
        self.starts = interest.starts
        return interest


def _size_of(item: tuple[int, FrameInfo]) -> int:
    return item[0]
