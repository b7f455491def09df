"""Times of a line: response times, behaviour without a reply, periods of recurring frames.

Times are those of the recording. The time of a frame is the time at which its first piece was handed over.
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
"""Least number of steps, of similar length, that make a period."""
NEAR = 0.2
"""Largest relative difference from the median step of steps that count as equal."""
SHORTEST_PERIOD = 10 * MILLISECOND
"""Shortest period (ns): faster frames follow another event, not a clock."""
MOST_PERIODS = 8
LEAST_GIVEN_UP = 2
"""Least number of unanswered requests from which the number of repeats is derived."""


class TimedFrame(NamedTuple):
    """A frame with its time."""

    time: int | None
    """Time (ns)."""
    side: str
    """Sender; '' if unknown."""
    kind: str
    """Name of the kind; '' for a damaged frame."""
    data: bytes


@dataclass(frozen=True, slots=True)
class TimeSpread:
    """Distribution of times (ns): least, median, greatest, and the number of times."""

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
    """Return a time as text with three digits."""
    return f"{time / 1e9:.3g} s" if time >= 1_000_000_000 else f"{time / 1e6:.3g} ms"


@dataclass(frozen=True, slots=True)
class AnswerTimes:
    """Response times to requests of one kind."""

    asked: str
    """The kind of the requests."""
    told: tuple[tuple[str, int], ...]
    """Kinds of the replies, with their numbers."""
    of: int
    """Number of requests."""
    delay: TimeSpread | None
    """Distribution of the response times."""

    @property
    def answered(self) -> int:
        return sum(count for _, count in self.told)


@dataclass(frozen=True, slots=True)
class Unanswered:
    """Requests without a reply."""

    count: int
    of: int
    wait: TimeSpread | None
    """Time to the client's next frame."""
    pause: int | None
    """Median pause of the client after a reply (ns)."""
    repeats: int | None
    """Number of repeats before the client gives up; None if that was not observed."""
    alike: int
    """Number of cases, of `given_up`, with this number of repeats."""
    given_up: int


@dataclass(frozen=True, slots=True)
class PollPeriod:
    """A frame that recurs: a kind of frames, or a single request."""

    kind: str
    data: bytes
    """Bytes of the request; empty for a kind."""
    every: TimeSpread
    near: int
    """Number of steps, out of `of`, close to the median."""
    of: int


@dataclass(frozen=True, slots=True)
class GuessedTimes:
    """All times derived from a line."""

    answers: tuple[AnswerTimes, ...] = ()
    unanswered: Unanswered | None = None
    periods: tuple[PollPeriod, ...] = ()

    @property
    def slowest(self) -> int:
        """Return the longest time after which a reply came; 0 for none."""
        return max((one.delay.greatest for one in self.answers if one.delay is not None), default=0)

    @property
    def longest_timeout(self) -> int | None:
        """Return the longest time that the observed client waits for a reply (ns); None if unknown."""
        if self.unanswered is None or self.unanswered.wait is None:
            return None
        least = self.unanswered.wait.least
        return least if least > self.slowest else None


def times_of(frames: Sequence[TimedFrame]) -> GuessedTimes:
    """Return the times of frames, which are in order and include damaged frames."""
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
        replies = Counter[str]()
        delays = []
        for number in numbers:
            if number + 1 < len(frames) and frames[number + 1].side == "server":
                replies[frames[number + 1].kind or "a damaged frame"] += 1
                delay = _between(frames[number], frames[number + 1])
                delays += [delay] if delay is not None else []
        found.append(AnswerTimes(kind, tuple(replies.most_common()), len(numbers), _spread(delays)))
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
    """Return the number of repeats of each request that got no reply at all.

    Requests that repeat until the recording ends are not included.
    """
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
    """Return the periods of requests that recur with the same bytes, and of kinds of frames whose bytes differ.

    Repeats are not counted.
    """
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
