"""One place in the stream, with all that may be strange about it: silences, damaged characters, frames inside others.

What is found does not depend on how the stream is cut into pieces. It is pulled: who waits says what he waits for.
"""

from __future__ import annotations

from typing import Any

from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER
from framekit.link.arrivals import Arrival, FrameArrived
from framekit.link.candidates import Candidates, Trouble, any_of
from framekit.link.evaluate import CODEC_ERRORS, Names
from framekit.link.frame_info import FrameInfo, Make
from framekit.link.frame_table import Codec, FrameTable
from framekit.link.inside import InsideFinder
from framekit.link.interest import Interest
from framekit.link.noise import LONGEST
from framekit.link.pauses import Pauses, scope_of
from framekit.link.recovery import Again, Recovery
from framekit.link.stream import Stream
from framekit.link.verdicts import Bad, Good, worse


class Looking(Recovery):
    """The part of a receiver that looks at one place after the other, and says how long it may wait there.

    `_looks_later`: the quick way has seen that more bytes are wanted; who waits for them is found out when somebody
    asks, until more of them come.
    """

    def __init__(self, codec: Codec, protocol: Protocol, names: Names, table: FrameTable, trouble: Trouble) -> None:
        super().__init__(protocol.receiver)
        self.table = table
        self.stream = Stream()
        self.pauses = Pauses(protocol.receiver, names, self.stream)
        self._deadline = NEVER
        self._looks_later = False
        self._waiting: tuple[str, ...] = ()
        self._waiting_since = 0
        self._names = names
        self._scope = scope_of(names)
        self._candidates = Candidates(self.stream, names, codec.QUIET, codec.LOST, trouble)
        inside = InsideFinder(self.table, names)
        self._inside = inside if inside else None
        self._quiet = codec.QUIET
        self._lost = codec.LOST
        self._trouble = trouble
        self._interests: dict[tuple[tuple[str, ...], tuple[str, ...]], Interest] = {}
        self._interest = self._interest_of((), ())
        self._version = 0
        self._given = 0
        self._declined: list[str] = []
        self._needs_silence = False

    # ---- what is waited for -------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """When somebody has to look again although nothing came."""
        if self._looks_later:
            self._look_now()
        return self._deadline

    @property
    def waiting(self) -> tuple[str, ...]:
        """The names of the candidates that the bytes at hand fit so far."""
        if self._looks_later:
            self._look_now()
        return self._waiting

    @property
    def waiting_since(self) -> int:
        """When the first byte of these came."""
        if self._looks_later:
            self._look_now()
        return self._waiting_since

    def _look_now(self) -> None:
        """Somebody wants to know what is waited for, or is about to change that."""
        self._looks_later = False
        found = self._look(self._interest)
        assert found is None, "the quick way has seen that nothing is there yet"
        self._set_deadline()

    # ---- one place ----------------------------------------------------------------------------------------

    def _look(self, interest: Interest) -> Arrival | Again | None:
        stream = self.stream
        position = stream.position
        self._waiting = ()
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
        is_told = stream.base + position >= self._bad_until
        worse_of = worse if is_told else any_of
        for infos in levels:
            good, bad, wanting = self._candidates.judge(infos, limit, silent, self._inside, is_told)
            if good is not None:
                return self._noise_before() or self._arrived(good)
            if wanting and not is_cut:
                self._wait((*wanting, *silent))
                return None
            worst = worst if bad is None else worse_of(worst, bad)
            if wanting and worst is None:
                worst = self._candidates.cut(wanting[0], limit)
        if worst is not None:
            return self._bad(worst)
        return self._ended_by_silence(silent) if silent else self._unusable()

    def _pass_over(self, interest: Interest) -> None:
        """Gets over places in noise where no good frame begins, and none that is told of or wants more.

        It says of a place what `_look` says, and leaves to that all that may be anything else.
        """
        stream, rules = self.stream, self._rules
        buffer, place, end = stream.buffer, stream.position, self._plain_until()
        is_skipped = stream.base + place < self._bad_until
        if rules.resync == "never" or rules.symbols is not None or self._inside is not None:
            return
        if not self._noise.data or self._noise.skipped is not is_skipped:
            return
        end = min(end, place + LONGEST - len(self._noise.data))
        if is_skipped:
            end = min(end, self._bad_until - stream.base)
        total, starts, names, lost = len(buffer), self.starts, self._names, self._lost
        every = interest.every
        first, starting, find = place, every.starting, every.start
        try:
            while place < end:
                start = starting[buffer[place]] or find(buffer[place])
                at = place + start.at
                if at >= total:
                    break
                left = start.left[buffer[at]]
                for extent, looks in every.ends(left, buffer[place]):
                    size = extent(buffer, place, total, names)
                    if size == 0 or (is_skipped and size == lost):
                        continue
                    if not is_skipped or size < 0:
                        break
                    raw = buffer[place : place + size]
                    if any(look is None or look(raw) for look in looks):
                        break
                else:
                    if starts is None:
                        place += 1
                    else:
                        match = starts.search(buffer, place + 1, end)
                        place = end if match is None else match.start()
                    continue
                break
        except CODEC_ERRORS:
            pass
        if place > first:
            self._collect(place - first, is_skipped)

    def _plain_until(self) -> int:
        """Up to where (buffer index) nothing is strange but what the bytes say."""
        stream = self.stream
        end = len(stream.buffer)
        if self._now != stream.last or self._skipping or stream.faults or stream.taken_out:
            return stream.position
        if stream.pauses and stream.first_after(stream.pauses, stream.position - 1) is not None:
            return stream.position
        silence = stream.first_after(stream.silences, stream.position - 1) if stream.silences else None
        return end if silence is None else silence

    def _wait(self, infos: tuple[FrameInfo, ...]) -> None:
        self._waiting = tuple(info.name for info in infos)
        self._waiting_since = self.stream.time_of(self.stream.position)

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
                return self._noise_before() or self._arrived(result)
            if isinstance(result, Bad):
                worst = worse(worst, result)
        return self._unusable() if worst is None else self._bad(worst)

    def _arrived(self, good: Good) -> FrameArrived:
        stream = self.stream
        size = len(good.raw)
        self._given = size
        self._good_since = True
        self._declined.append(good.info.name)
        arrived = self._arrival(good.info.make, good.fields, good.raw, stream.position)
        arrived.value = good.info.make(good.fields, good.raw, good.refusal)
        return arrived

    def _arrival(self, make: Make, fields: dict[str, Any], raw: bytes, place: int) -> FrameArrived:
        """A frame that stands at buffer index `place`."""
        stream, arrived = self.stream, FrameArrived()
        arrived.make, arrived.decoded, arrived.raw = make, fields, raw
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
        arrived = self._arrival(info.make, fields, raw, start)
        stream.remove(start, end)
        self._candidates.forget()
        return arrived

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
        if self._waiting:
            quiet, gap = self.pauses.limits()
            if gap is not None:
                deadline = stream.last + gap
            if self._needs_silence:
                deadline = min(deadline, stream.last + quiet)
        elif self._noise or self._skipping or stream.position < len(stream.buffer):
            deadline = stream.last + self.pauses.limits()[0]
        self._deadline = deadline if deadline > self._now else NEVER

    def _interest_of(self, expected: tuple[str, ...], others: tuple[str, ...]) -> Interest:
        """The prepared interest; it keeps these very tuples, so that the next call sees at once they are the same."""
        interest = self._interests.get((expected, others))
        if interest is None:
            interest = Interest(self.table, expected, others, self._inside, self._rules.symbols)
            self._interests[expected, others] = interest
        interest.expected, interest.others = expected, others
        self._interest = interest
        self.starts = interest.starts
        return interest
