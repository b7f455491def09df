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
from framekit.link.candidates import Trouble
from framekit.link.evaluate import CODEC_ERRORS, Names
from framekit.link.events import CharacterFault
from framekit.link.frame_table import Codec, FrameTable
from framekit.link.interest import Interest
from framekit.link.plain import PlainLooking
from framekit.link.recovery import Again
from framekit.link.rough import NOTHING, UNSURE, WANTING
from framekit.link.verdicts import Complete, Good


def _ignore(frame: str, error: Exception) -> None:
    return None


class Receiver(PlainLooking):
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
        super().__init__(codec, protocol, names, table or FrameTable(protocol, codec), trouble)

    # ---- bytes in -----------------------------------------------------------------------------------------

    def append(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> None:
        """Bytes, the last of which came at `now` (ns), and what was wrong with single characters."""
        if self._given:
            self._use()
        if not data or self.broken:
            return
        self._now = now
        self._looks_later = False
        stream = self.stream
        last = stream.last
        goes_on = stream.add(data, now, faults)
        if now - last > self.pauses.character * len(data) and (goes_on or self._noise.data or self._skipping):
            self.pauses.note(last, len(data))

    def tick(self, now: int) -> None:
        """Nothing has come until `now`; `next` tells what follows from that."""
        if self._looks_later:
            self._look_now()
        self._now = max(self._now, now)

    def cut(self) -> None:
        """Whoever waits allows no longer pause: what is unfinished ends here."""
        if self._looks_later:
            self._look_now()
        stream = self.stream
        place = stream.base + len(stream.buffer)
        if not stream.pauses or stream.pauses[-1] != place:
            stream.mark(stream.pauses, place)

    @property
    def is_empty(self) -> bool:
        """Whether every byte has been used or reported."""
        return self.stream.position + self._given >= len(self.stream.buffer) and not self._noise

    @property
    def is_idle(self) -> bool:
        """Whether what comes next begins anew: nothing is at hand, skipped over, or out of step."""
        stream = self.stream
        at_end = stream.position + self._given >= len(stream.buffer)
        return at_end and not self._noise.data and not self._skipping and not self.broken and self._inside is None

    def pass_by(self, size: int, now: int) -> None:
        """So many bytes came, the last of them at `now`, and were a good frame for somebody else."""
        if self._given:
            self._use()
        stream = self.stream
        if stream.buffer:
            stream.tidy()
        stream.base += size
        stream.last = self._now = now

    # ---- frames out ---------------------------------------------------------------------------------------

    def next(self, expected: tuple[str, ...], others: tuple[str, ...] = ()) -> Arrival | None:
        """The next thing in the stream for those who wait for `expected`, then `others`; None: nothing yet.

        What it returns counts as used at the next call; until then `other_reading` may read the same bytes otherwise.
        """
        interest = self._begin(expected, others)
        if interest is None:
            return None
        found: list[Arrival] = []
        while True:
            if self._noise.data:
                self._pass_over(interest)
            self._looks_later = self._plain(interest, found)
            if found:
                return found[0]
            if self._looks_later:
                return None
            arrival = self._look(interest)
            if not isinstance(arrival, Again):
                if arrival is None:
                    self._set_deadline()
                return arrival

    def arrivals(self, expected: tuple[str, ...], others: tuple[str, ...] = ()) -> list[Arrival]:
        """All that `next` gives until nothing more is there; all of it counts as used.

        For those who wait for the same whatever comes: it is much quicker.
        """
        found: list[Arrival] = []
        interest = self._interest
        if self._given or self._candidates.said or interest.expected is not expected or interest.others is not others:
            begun = self._begin(expected, others)
            if begun is None:
                return found
            interest = begun
        data = bytes(self.stream.buffer)
        while (ended := self._rows(interest, found, data)) == UNSURE:
            one: list[Arrival] = []
            self._looks_later = self._plain(interest, one)
            if self._looks_later and not one:
                return found
            arrival = one[0] if one else self._look(interest)
            if arrival is None:
                self._set_deadline()
                return found
            if not isinstance(arrival, Again):
                found.append(arrival)
                if self._given:
                    self._use()
            if len(data) != len(self.stream.buffer):  # something has been taken out of the middle, or all dropped
                data = bytes(self.stream.buffer)
        if ended == NOTHING:
            self._nothing_waits()
        self._looks_later = ended == WANTING
        return found

    def _nothing_waits(self) -> None:
        self._looks_later = False
        self._waiting = ()
        self._deadline = NEVER

    def _begin(self, expected: tuple[str, ...], others: tuple[str, ...]) -> Interest | None:
        """Who is looked for from the present place on; None if nothing is there to look at."""
        if self._given:
            self._use()
        self._looks_later = False
        interest = self._interest
        if interest.expected is not expected or interest.others is not others:
            interest = self._interest_of(expected, others)
        if self._scope is not None:
            if self._candidates.said and self._scope.version != self._version:
                self._candidates.forget()
            self._version = self._scope.version
        stream = self.stream
        if stream.position >= len(stream.buffer) and not self._noise.data and not self._skipping:
            self._nothing_waits()
            return None
        return interest

    def other_reading(self) -> FrameArrived | None:
        """The same bytes as another frame that fits them, in the order of the rows; None when there is none."""
        if not self._given:
            return None
        stream, interest = self.stream, self._interest
        end = len(stream.buffer)
        for infos in interest.at(stream.buffer[stream.position]):
            for info in infos:
                if info.name not in self._declined:
                    result = self._candidates.ask(info, end)
                    if type(result) is Complete:
                        result = self._candidates.read(info, result)
                    if type(result) is Good:
                        return self._arrived(result)
        return None

    def is_followed_by(self, frames: Iterable[str]) -> bool:
        """Whether one of these frames stands whole and good somewhere behind the one that was handed over last."""
        buffer, names = self.stream.buffer, self._names
        infos = [self.table.infos[name] for name in frames if name in self.table.on_line]
        for place in range(self.stream.position + self._given, len(buffer)):
            for info in infos:
                try:
                    size = info.measure(buffer, place, len(buffer), names, 0)
                    if size > 0:
                        info.decode(bytes(buffer[place : place + size]), names)
                        return True
                except FrameError as error:
                    if error.refuse is not None:
                        return True
                except CODEC_ERRORS:
                    continue
        return False

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
        self._nothing_waits()
        return found

    def reset(self) -> list[Noise]:
        """As `flush`; and a broken stream may begin anew."""
        self.broken = False
        return self.flush()
