"""Trouble of a run: which part fails, why, since when, how many samples wait for it, and which were lost.

Each part of a run that keeps or sends data (a sink, a store, the state file, a capture) has one `TroubleSource`. The
sources of a run belong to its `Troubles`: terminal, status, page, JSON and metrics read them there, and a listener
receives a report when trouble begins, when data are lost, and when the part works again.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

from framekit.definition.problems import plural

log = logging.getLogger(__name__)

MOST_REPORTS = 100
"""Reports kept for a listener that registers later."""
MOST_NAMED = 5
"""Points that a message names, and parts that a joined report names."""
AT_ONCE = 20
"""Reports that are passed on within the time `CROWDED`; further ones are joined to one for each event. Also the number
of parts that are listed at the end of a run; the others are counted.
"""
MOST_REASONS = 3
"""Reasons that a joined report names."""

SECOND, MINUTE, HOUR = 1_000_000_000, 60_000_000_000, 3_600_000_000_000

CROWDED = 10 * SECOND

Event = Literal["begins", "changes", "loses", "ends", "note"]
"""`changes`: another cause of a lasting trouble. `note`: an event that does not last, such as a jump of the clock."""


MORE: dict[Event, str] = {
    "begins": "are in trouble", "changes": "fail for another reason", "loses": "lose data", "ends": "work again",
    "note": "have a message",
}  # fmt: skip
"""What the parts of a joined report do."""

REMEDIES = (
    ("no space left on device", "make room there"),
    ("disk is full", "make room there"),
    ("disk quota exceeded", "make room there"),
    ("file too large", "make room there"),
    ("does not exist", "make the folder"),
    ("permission denied", "change its permissions"),
    ("no permission", "change its permissions"),
    ("is no folder", "check the path"),
    ("is a link that leads to itself", "mend the link"),
    ("takes no new files", "check the path"),
    ("name is too long", "shorten it"),
    ("read-only file system", "make it writable"),
    ("readonly database", "change its permissions"),
)
"""Remedies of users for failures of files whose reasons contain a text, in lower case."""


def remedy_of(reason: str) -> str:
    """Return a remedy for the failure of a file, from its reason; '' if none is known."""
    small = reason.lower()
    return next((remedy for text, remedy in REMEDIES if text in small), "")


def _without_name(reason: str, name: str) -> str:
    """Return a reason about a part without the target of the part, which its name ends with."""
    subject, _, rest = reason.partition(" is ")
    return f"this is {rest}" if rest and name.endswith(f" {subject}") else reason


class SampleCount(NamedTuple):
    """Samples of a part: how many wait, how many are lost, and the lost values by point."""

    waiting: int = 0
    lost: int = 0
    points: Mapping[str, int] = {}


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """The trouble of one part of a run, or its losses."""

    name: str
    """The part: its kind and its target, such as `sink csv r.csv`."""
    reason: str
    """Why the part fails; empty while it works."""
    since: int
    """When the part began to fail, or to work again (ns of the run's clock)."""
    waiting: int
    """Samples that wait for the part."""
    lost: int
    """Samples (of a capture: events) lost since the start of the run."""
    points: Mapping[str, int] = field(default_factory=dict)
    """Lost values by point."""
    unit: str = "sample"
    """The noun for a lost item; empty if losses are not counted."""

    @property
    def loss(self) -> str:
        """Describe the losses, such as `3 samples were lost (level 2, state 1)`; empty without losses."""
        return _loss(self.lost, self.unit, self.points)

    def __str__(self) -> str:
        wait = ""
        if self.reason and self.waiting and self.unit == "sample":  # lines of an output wait for its reader alone
            wait = f"{plural(self.waiting, 'sample')} {'waits' if self.waiting == 1 else 'wait'}"
        return f"{self.name}: {', '.join(filter(None, (self.reason, wait, self.loss)))}"


def _loss(number: int, unit: str, points: Mapping[str, int]) -> str:
    if not number:
        return ""
    named = [f"{name} {count}" for name, count in Counter(points).most_common(MOST_NAMED)]
    if len(points) > MOST_NAMED:
        named.append(f"and {plural(len(points) - MOST_NAMED, 'more point')}")
    where = f" ({', '.join(named)})" if named else ""
    return f"{plural(number, unit)} {'was' if number == 1 else 'were'} lost{where}"


def most_frequent(counts: Mapping[str, int], most: int) -> str:
    """Return the most frequent texts, the most frequent first; further ones are counted."""
    named = [text for text, _ in Counter(counts).most_common(most)]
    return "; ".join([*named, f"{len(counts) - most} more reasons"] if len(counts) > most else named)


def listed_troubles(troubles: Sequence[Trouble]) -> list[str]:
    """Return a line for each trouble, at most `AT_ONCE`; a last line joins the others with the sums of their losses."""
    if len(troubles) <= AT_ONCE + 1:
        return [str(trouble) for trouble in troubles]
    others = troubles[AT_ONCE:]
    points, losses = Counter[str](), Counter[str]()
    for trouble in others:
        points.update(trouble.points)
        losses[trouble.unit] += trouble.lost
    lost = [_loss(number, unit, points if unit == "sample" else {}) for unit, number in losses.items() if unit]
    reasons = Counter(_cause(trouble) for trouble in others if trouble.reason)
    line = ", ".join(filter(None, (most_frequent(reasons, MOST_REASONS), *lost)))
    return [*map(str, troubles[:AT_ONCE]), f"{len(others)} more parts: {line}"]


def _cause(trouble: Trouble) -> str:
    """Return the reason of a trouble without remedy and effect."""
    return trouble.reason.partition(" – ")[0]


def waiting_text(number: int, most: int, where: str = "") -> str:
    """Return a message such as `12 samples wait, the oldest are dropped from 100,000 on`; 0 has no number."""
    wait = f"{plural(number, 'sample') if number else 'samples'} {'waits' if number == 1 else 'wait'}{where}"
    return f"{wait}, the oldest are dropped from {most:,} on"


def lasted(time: int) -> str:
    """Write a duration for people: `0.8 s`, `12 s`, `10 min`, `3 h`."""
    if time < 10 * SECOND:
        return f"{time / SECOND:.1f} s"
    if time < 2 * MINUTE:
        return f"{time / SECOND:.0f} s"
    return f"{time / MINUTE:.0f} min" if time < 2 * HOUR else f"{time / HOUR:,.0f} h"


class TroubleReport(NamedTuple):
    """An event of a trouble, and the sentence for it."""

    event: Event
    trouble: Trouble
    text: str
    at: int
    """Time of the event (ns of the run's clock)."""


class Dropped:
    """Count dropped samples, and their values by point.

    A sample that is dropped while a sink sends it counts until the sink has confirmed it.
    """

    def __init__(self) -> None:
        self.samples = 0
        self.points: Counter[str] = Counter()
        self._sent_up_to = 0
        self._in_flight: list[tuple[int, tuple[str, ...]]] = []

    def sending(self, end: int) -> None:
        """Note that the samples before the number `end` are being sent; earlier attempts are over."""
        self._sent_up_to = end
        self._in_flight.clear()

    def drop(self, number: int, points: Iterable[str]) -> None:
        """Count a sample with values of these points."""
        names = tuple(points)
        self.samples += 1
        self.points.update(names)
        if number < self._sent_up_to:
            self._in_flight.append((number, names))

    def destroyed(self, samples: int, points: Mapping[str, int]) -> None:
        """Count lost samples that had been stored; `points` has the number of their values by point."""
        self.samples += samples
        self.points.update(points)

    def confirmed(self, end: int) -> None:
        """Note that the samples before the number `end` have arrived: dropped samples among them do not count."""
        for number, names in self._in_flight:
            if number < end:
                self.samples -= 1
                self.points.subtract(names)
        self._in_flight = [one for one in self._in_flight if one[0] >= end]
        self.points += Counter()  # removes the counts of 0


class TroubleSource:
    """The trouble of one part of a run. Its methods may be called from any thread.

    `effect` describes the consequence for the data, for the first report; `count` gives the samples of the part.
    `well`: the sentence for the end of a trouble; `is_whole`: whether a reason already has its remedy and its effect.
    `is_file`: whether the part writes a file; only then `remedy_of` fits its reasons.
    """

    def __init__(
        self, troubles: Troubles, name: str, effect: Callable[[], str], count: Callable[[], SampleCount], unit: str,
        well: str, is_whole: bool, is_file: bool,
    ) -> None:  # fmt: skip
        self.name = name
        self.reason = ""
        self._well, self._is_whole, self._is_file = well, is_whole, is_file
        self._troubles = troubles
        self._effect, self._count, self._unit = effect, count, unit
        self._since = 0
        self._lost_before = 0
        self._loss_reported = False

    def begins(self, reason: str, since: int | None = None) -> None:
        """Report that the part fails, unless it failed already; a changed reason is only logged (see `changes`).

        `since`: when it began to fail; default: now.
        """
        reason = _without_name(reason, self.name)
        with self._troubles.lock:
            before, self.reason = self.reason, reason
            if not before:
                self._since = self._troubles.now() if since is None else since
                self._lost_before = self._count().lost
        if not before:
            remedy = remedy_of(reason) if self._is_file else ""
            more = "" if self._is_whole else "; ".join(filter(None, (remedy, self._effect())))
            self._report("begins", f"{self.name}: {reason}{f' – {more}' if more else ''}")
        elif before != reason:
            log.warning("%s: %s", self.name, reason)

    def changes(self, reason: str) -> None:
        """Report another reason of a trouble that lasts."""
        with self._troubles.lock:
            self.reason = reason
        self._report("changes", f"{self.name}: {reason}")

    def ends(self, well: str = "") -> None:
        """Report that the part works again, if it failed; `well` replaces its sentence for the end."""
        with self._troubles.lock:
            before, self.reason = self.reason, ""
            if not before:
                return
            now = self._troubles.now()
            duration, self._since = now - self._since, now
            count, self._loss_reported = self._count(), False
            lost = count.lost - self._lost_before
        text = f"{self.name}: {well or self._well} after {lasted(duration)}"
        if self._unit:
            text += f", {_loss(lost, self._unit, count.points) or f'no {self._unit} was lost'}"
        self._report("ends", text)

    def loses(self, why: str) -> None:
        """Report that data are lost, once for a trouble."""
        with self._troubles.lock:
            reported, self._loss_reported = self._loss_reported, True
        if reported:
            log.debug("%s: %s", self.name, why)
        else:
            self._report("loses", f"{self.name}: {why}")

    def _report(self, event: Event, text: str) -> None:
        self._troubles.report(TroubleReport(event, self.trouble, text, self._troubles.now()))

    @property
    def trouble(self) -> Trouble:
        """Return the present state."""
        count = self._count()
        return Trouble(
            name=self.name, reason=self.reason, since=self._since, waiting=count.waiting, lost=count.lost,
            points=dict(count.points), unit=self._unit,
        )  # fmt: skip


@dataclass(slots=True)
class _Joined:
    """Reports of one event that were not passed on."""

    first: TroubleReport
    number: int = 0
    names: list[str] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)

    def add(self, report: TroubleReport) -> None:
        self.number += 1
        trouble = report.trouble
        if len(self.names) < MOST_NAMED:
            self.names.append(trouble.name)
        if report.event in ("loses", "note"):  # their reason is not that of a trouble that lasts
            self.reasons[report.text.removeprefix(f"{trouble.name}: ")] += 1
        elif trouble.reason:
            self.reasons[_cause(trouble)] += 1

    def report(self, event: Event, now: int) -> TroubleReport:
        if self.number == 1:
            return self.first
        reason = most_frequent(self.reasons, MOST_REASONS)
        names = ", ".join([*self.names, *(["…"] if self.number > len(self.names) else ())])
        text = f"{self.number} more {MORE[event]}: {' – '.join(filter(None, (reason, names)))}"
        trouble = Trouble(name="other parts", reason=reason, since=now, waiting=0, lost=0, unit="")
        return TroubleReport(event, trouble, text, now)


class Troubles:
    """The troubles of a run. `now`: the run's clock.

    When many parts fail at once, such as all files on a full disk, the first reports are passed on, and the others are
    joined to one report for each event: see `flush`.
    """

    def __init__(self, now: Callable[[], int]) -> None:
        self.now = now
        self._passed: deque[int] = deque(maxlen=AT_ONCE)
        """Times of the last reports that were passed on."""
        self._joined: dict[Event, _Joined] = {}
        self._joined_since = 0
        self.lock = threading.RLock()
        self._sources: list[TroubleSource] = []
        self._listener: Callable[[TroubleReport], None] | None = None
        self._pending: deque[TroubleReport] = deque(maxlen=MOST_REPORTS)
        self._delivering = threading.Lock()

    def source(
        self, name: str, effect: Callable[[], str] = lambda: "", count: Callable[[], SampleCount] = SampleCount,
        unit: str = "sample", well: str = "works again", is_whole: bool = False, is_file: bool = True,
    ) -> TroubleSource:  # fmt: skip
        """Register a part of the run."""
        found = TroubleSource(self, name, effect, count, unit, well, is_whole, is_file)
        self._sources.append(found)
        return found

    def note(self, name: str, text: str) -> None:
        """Report an event that does not last."""
        trouble = Trouble(name=name, reason=text, since=self.now(), waiting=0, lost=0)
        self.report(TroubleReport("note", trouble, f"{name}: {text}", trouble.since))

    def present(self) -> tuple[Trouble, ...]:
        """Return the parts that fail now or have lost data, in the order of registration.

        Troubles of the same name are joined, so each name is unique.
        """
        found: dict[str, Trouble] = {}
        for one in [source.trouble for source in self._sources]:
            if not (one.reason or one.lost):
                continue
            before = found.get(one.name)
            if before is not None and before.reason and one.reason:
                one = replace(one, reason=f"{before.reason}; {one.reason}", since=min(before.since, one.since))
            found[one.name] = one
        return tuple(found.values())

    def listen(self, listener: Callable[[TroubleReport], None]) -> None:
        """Give the reports to `listener`, one at a time, in the thread that met the trouble; first those not heard."""
        self._listener = listener
        self._deliver()

    def report(self, report: TroubleReport) -> None:
        """Log a report, marked as `is_report` for programs that show reports, and give it to the listener."""
        level = logging.INFO if report.event == "ends" else logging.WARNING
        log.log(level, "%s", report.text, extra={"is_report": True})
        self.flush()
        with self.lock:
            now = self.now()
            if self._joined or (len(self._passed) == AT_ONCE and now - self._passed[0] < CROWDED):
                self._joined_since = self._joined_since if self._joined else now
                self._joined.setdefault(report.event, _Joined(report)).add(report)
            else:
                self._passed.append(now)
                self._pending.append(report)
        self._deliver()

    def flush(self, *, at_end: bool = False) -> None:
        """Pass on the joined reports, if the first of them is old enough or at the end of the run."""
        with self.lock:
            now = self.now()
            if not self._joined or (now - self._joined_since < CROWDED and not at_end):
                return
            self._pending.extend(joined.report(event, now) for event, joined in self._joined.items())
            self._joined = {}
        self._deliver()

    def _deliver(self) -> None:
        """Deliver the pending reports, unless another thread delivers now: it delivers these, too. Never waits."""
        while self._listener is not None and self._pending and self._delivering.acquire(blocking=False):
            try:
                while self._pending:
                    self._listener(self._pending.popleft())
            except (OSError, ValueError) as error:  # the output has gone or is closed; the work goes on
                log.warning("a report of trouble was not delivered: %s", error)
            finally:
                self._delivering.release()
