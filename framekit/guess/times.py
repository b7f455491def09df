"""Times of a line: who answers whom and after how long, what happens when no reply comes, what comes again and again.

Times are those of the recording. A frame has the time at which its first piece was handed over.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import NamedTuple

MILLISECOND = 1_000_000
LEAST_PERIODS = 4
"""What is asked so often has a period, if the steps are alike."""
NEAR = 0.2
"""Steps that differ so little from the middle one are alike."""
SHORTEST_PERIOD = 10 * MILLISECOND
"""What comes faster follows something else, not a clock."""
MOST_PERIODS = 8
LEAST_GIVEN_UP = 2
"""So many requests without a reply tell how often they are repeated."""


class TimedFrame(NamedTuple):
    """A frame with its time (ns), who sent it ('' where that is not known), its kind ('' of a damaged one), and its
    bytes."""

    time: int | None
    side: str
    kind: str
    data: bytes


@dataclass(frozen=True, slots=True)
class TimeSpread:
    """Times in ns: the least, the middle and the greatest of so many."""

    least: int
    middle: int
    greatest: int
    count: int

    def __str__(self) -> str:
        least, middle, greatest = map(shown, (self.least, self.middle, self.greatest))
        if least == greatest:
            return middle
        if least.partition(" ")[2] == greatest.partition(" ")[2]:
            least = least.partition(" ")[0]
        return f"{least} to {greatest}, half of them within {middle}"


def shown(time: int) -> str:
    """Return a time in words, with three digits."""
    return f"{time / 1e9:.3g} s" if time >= 1_000_000_000 else f"{time / 1e6:.3g} ms"


@dataclass(frozen=True, slots=True)
class AnswerTimes:
    """Requests of a kind: which kinds of frames answer how many of them, of how many, and after how long."""

    asked: str
    told: tuple[tuple[str, int], ...]
    of: int
    delay: TimeSpread | None

    @property
    def answered(self) -> int:
        return sum(count for _, count in self.told)


@dataclass(frozen=True, slots=True)
class Unanswered:
    """Requests that no reply followed. `wait`: until the client's next frame. `pause`: what the client waits after a
    reply, in the middle. `repeats`: how often it repeats before it gives up, None where that was not seen; so it was
    in `alike` of `given_up` cases."""

    count: int
    of: int
    wait: TimeSpread | None
    pause: int | None
    repeats: int | None
    alike: int
    given_up: int


@dataclass(frozen=True, slots=True)
class PollPeriod:
    """What comes again and again: a kind of frames, or one request (`data`). `near` of `of` steps are like the middle
    one."""

    kind: str
    data: bytes
    every: TimeSpread
    near: int
    of: int


@dataclass(frozen=True, slots=True)
class GuessedTimes:
    """All of that."""

    answers: tuple[AnswerTimes, ...] = ()
    unanswered: Unanswered | None = None
    periods: tuple[PollPeriod, ...] = ()

    @property
    def slowest(self) -> int:
        """Return the longest time after which a reply came; 0 for none."""
        return max((one.delay.greatest for one in self.answers if one.delay is not None), default=0)

    @property
    def longest_timeout(self) -> int | None:
        """The client that was heard waits so long for a reply at most; None where nothing tells it."""
        if self.unanswered is None or self.unanswered.wait is None:
            return None
        least = self.unanswered.wait.least
        return least if least > self.slowest else None


def times_of(frames: Sequence[TimedFrame]) -> GuessedTimes:
    """Return the times of frames in their order, those that were damaged among them."""
    asked = [number for number, frame in enumerate(frames) if frame.side == "client"]
    has_replies = any(frame.side == "server" for frame in frames)
    answers = tuple(_answers(frames, asked)) if has_replies else ()
    unanswered = _unanswered(frames, asked) if has_replies else None
    return GuessedTimes(answers, unanswered, tuple(_periods(frames, asked if has_replies else range(len(frames)))))


def _spread(times: Sequence[int]) -> TimeSpread | None:
    if not times:
        return None
    return TimeSpread(min(times), round(median(times)), max(times), len(times))


def _between(one: TimedFrame, two: TimedFrame) -> int | None:
    if one.time is None or two.time is None or two.time < one.time:
        return None
    return two.time - one.time


def _is_answered(frames: Sequence[TimedFrame], number: int) -> bool:
    return number + 1 < len(frames) and frames[number + 1].side != "client"


def _answers(frames: Sequence[TimedFrame], asked: Sequence[int]) -> list[AnswerTimes]:
    kinds: dict[str, list[int]] = defaultdict(list)
    for number in asked:
        if frames[number].kind:
            kinds[frames[number].kind].append(number)
    found = []
    for kind, numbers in kinds.items():
        told = Counter[str]()
        delays = []
        for number in numbers:
            if number + 1 < len(frames) and frames[number + 1].side == "server":
                told[frames[number + 1].kind or "a damaged frame"] += 1
                delay = _between(frames[number], frames[number + 1])
                delays += [delay] if delay is not None else []
        found.append(AnswerTimes(kind, tuple(told.most_common()), len(numbers), _spread(delays)))
    return found


def _unanswered(frames: Sequence[TimedFrame], asked: Sequence[int]) -> Unanswered | None:
    silent = [number for number in asked if number + 1 < len(frames) and not _is_answered(frames, number)]
    if not silent:
        return None
    waits = [_between(frames[number], frames[number + 1]) for number in silent]
    turns = [(one, two) for one, two in pairwise(frames) if one.side == "server" and two.side == "client"]
    pause = _spread([time for one, two in turns if (time := _between(one, two)) is not None])
    runs = _given_up(frames, set(silent))
    repeats, alike = Counter(runs).most_common(1)[0] if len(runs) >= LEAST_GIVEN_UP else (None, 0)
    known = _spread([time for time in waits if time is not None])
    return Unanswered(
        len(silent), len(asked), known, None if pause is None else pause.middle, repeats, alike, len(runs)
    )


def _given_up(frames: Sequence[TimedFrame], silent: set[int]) -> list[int]:
    """How often each request was repeated to which no reply came at all. One that goes on until the recording ends, or
    that is never anything else, tells nothing."""
    found, again = list[int](), 0
    for number in range(len(frames) - 1):
        if number not in silent:
            again = 0
        elif frames[number + 1].data == frames[number].data:
            again += 1
        else:
            found.append(again)
            again = 0
    return found


def _periods(frames: Sequence[TimedFrame], numbers: Sequence[int]) -> list[PollPeriod]:
    """Of each request that often comes with the same bytes; of kinds of frames where bytes differ. Repeats do not
    count."""
    first = [
        number for at, number in enumerate(numbers)
        if not at or frames[numbers[at - 1]].data != frames[number].data or _is_answered(frames, numbers[at - 1])
    ]  # fmt: skip
    texts, kinds = defaultdict[bytes, list[int]](list), defaultdict[str, list[int]](list)
    for number in first:
        texts[frames[number].data].append(number)
        kinds[frames[number].kind].append(number)
    found: list[PollPeriod] = []
    by_text = {text: own for text, own in texts.items() if len(own) > LEAST_PERIODS}
    for text, own in by_text.items():
        found += _period(frames, own, text)
    rest = set(first).difference(*by_text.values())
    for own in kinds.values():
        if all(number in rest for number in own):
            found += _period(frames, own, b"")
    return sorted(found, key=lambda one: -one.of)[:MOST_PERIODS]


def _period(frames: Sequence[TimedFrame], numbers: Sequence[int], text: bytes) -> list[PollPeriod]:
    steps = [_between(frames[one], frames[two]) for one, two in pairwise(numbers)]
    known = [step for step in steps if step is not None]
    every = _spread(known)
    if every is None or len(known) < LEAST_PERIODS or every.middle < SHORTEST_PERIOD:
        return []
    near = sum(abs(step - every.middle) <= NEAR * every.middle for step in known)
    return [PollPeriod(frames[numbers[0]].kind, text, every, near, len(known))] if near >= 0.8 * len(known) else []
