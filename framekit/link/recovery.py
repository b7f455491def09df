"""What a receiver does where nothing fits: bad frames reported once, noise collected, and where reading goes on.

The receiver stands on it. It knows the bytes and their pauses, and neither candidates nor who waits.
"""

from __future__ import annotations

import re

from framekit.definition.model.protocol import Receiver as Rules
from framekit.link.arrivals import Arrival, Noise
from framekit.link.noise import NoiseRun
from framekit.link.pauses import Pauses
from framekit.link.stream import Stream
from framekit.link.verdicts import Bad

GOING_ON = ("next_start", "after_frame")
"""How to go on after a bad frame without waiting for anything."""


MOST_BAD, BAD_TIME, BAD_APART = 16, 10_000_000, 256
"""Of bad frames without a good one between them so many are told in a row, then one for each such time (ns).

Of those that come faster, one is told for so many bytes; what is between is what a bad frame left.
"""

MADE_GOOD = 4
"""For so many bad frames a good one makes up."""


class Again:
    """The place has changed: look again."""


AGAIN = Again()


class Recovery:
    """The part of a receiver that gets over what is no good frame. `starts` matches bytes that may begin a frame.

    `broken`: the stream is out of step, and the definition wants the connection closed.
    """

    stream: Stream
    pauses: Pauses
    starts: re.Pattern[bytes] | None

    def __init__(self, rules: Rules) -> None:
        self.broken = False
        self._rules = rules
        self._now = 0
        self._noise = NoiseRun()
        self._bad_until = 0
        self._skipping = False
        self._goes_on = rules.resync in GOING_ON
        self._bad_busy = 0
        self._good_since = False

    def _moved(self) -> None:
        """The place in the stream has changed."""

    def _move(self, count: int) -> None:
        self.stream.position += count
        self._moved()

    # ---- bad frames ---------------------------------------------------------------------------------------

    def _bad(self, worst: Bad) -> Arrival | Again | None:
        """Reports a bad frame once; bad frames that begin inside one that has been reported are not new ones."""
        stream = self.stream
        start = stream.base + stream.position
        if start < self._bad_until:
            return self._unusable()
        before = self._noise_before()
        if before is not None:
            return before
        bad = worst.bad
        size = worst.size
        self._bad_until = start + self._bad_reach(size, bad.started_at)
        mode = self._rules.resync
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

    def _bad_reach(self, size: int, came: int) -> int:
        """How far behind the start of a bad frame that is told none is told anew: to its end, or further in a crowd."""
        busy = max(self._bad_busy - (MADE_GOOD * BAD_TIME if self._good_since else 0), came) + BAD_TIME
        most = came + MOST_BAD * BAD_TIME
        self._good_since = False
        self._bad_busy = min(busy, most)
        return max(size, BAD_APART) if busy > most and self._rules.resync == "next_start" else size

    def _break_off(self) -> None:
        self.broken = True
        self.stream.clear()
        self._moved()

    def _skip(self) -> Again | None:
        """After a bad frame, where reading goes on only behind a silence."""
        stream = self.stream
        place = self.pauses.silence_behind(stream.position - 1, self._now)
        self._skipping = place is None
        stop = len(stream.buffer) if place is None else place
        if stop > stream.position:
            self._collect(stop - stream.position, True)
        return AGAIN

    def answered(self) -> None:
        """This side has sent something: what comes from now on answers that, no silence has to stand before it."""
        if self._skipping:
            self._skipping = False
            if self.stream.position < len(self.stream.buffer):
                self._collect(len(self.stream.buffer) - self.stream.position, True)

    # ---- noise --------------------------------------------------------------------------------------------

    def _at_end(self) -> Noise | None:
        if (self._noise or self._skipping) and self.pauses.is_quiet(self._now):
            self._skipping = False
            return self._noise.take() if self._noise else None
        return None

    def _symbol(self) -> int:
        """How many bytes are passed over together: two, when the first is the escape symbol and the second is there."""
        stream = self.stream
        if stream.buffer[stream.position] != self._rules.symbols:
            return 1
        return min(2, len(stream.buffer) - stream.position)

    def _unusable(self) -> Arrival | Again | None:
        """Rule 5: the bytes here begin nothing."""
        stream = self.stream
        skipped = stream.base + stream.position < self._bad_until
        if self._noise and self._noise.skipped != skipped:
            return self._noise.take()
        if self._rules.resync == "never":
            self._collect(1, False)
            self._break_off()
            return self._noise.take()
        symbols = self._rules.symbols
        count = self._to_next_start(skipped) if symbols is None else self._symbol()
        if count == 1 and stream.buffer[stream.position] == symbols and not self.pauses.is_quiet(self._now):
            return None
        self._collect(count, skipped)
        return AGAIN

    def _to_next_start(self, skipped: bool) -> int:
        """Bytes up to the next that may begin a frame, not over a silence or the end of a bad frame."""
        stream, starts = self.stream, self.starts
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
        position = self.stream.position
        self._noise.collect(self.stream, position, position + count, skipped)
        self._move(count)

    def _noise_before(self) -> Noise | None:
        return self._noise.take() if self._noise else None
