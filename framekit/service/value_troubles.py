"""Report that values do not come: from which channel and station, why, and for which points and blocks.

The failures of a channel and station are one trouble. It begins when an exchange fails, a port is lost, a point cannot
be decoded, or the line waits for late replies; it ends when each of its blocks and points has a good value again.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable
from functools import partial
from typing import NamedTuple

from framekit.codec.shown import shown
from framekit.definition.problems import plural
from framekit.definition.times import readable_time
from framekit.link.slow import rounded
from framekit.run.block_state import Failure
from framekit.run.model import POINTS_SET, Block, Point
from framekit.run.trouble import SECOND, Troubles
from framekit.transport.clock import Clock, Handle

GATHER, GATHER_OLD = SECOND, 3 * SECOND
"""Failures of a station within this time are one report (ns).

The second time: after values that are too old, because the exchange under way may fail and show why.
"""
LASTS = 10 * SECOND
"""A trouble that comes and goes is reported when it has lasted for this time (ns)."""
SOON, OFTEN = 60 * SECOND, 3
"""A trouble comes and goes if it was reported so many times within this time (ns)."""
FIRST_PAUSE, LONGEST_PAUSE = 10 * SECOND, 600 * SECOND
"""Least time from the begin of a trouble to the report of another cause, and its limit: it doubles (ns)."""
MOST_NAMED = 3
"""Points and blocks that a report names."""
MOST_PARTS = 500
"""Stations with a trouble of their own; further stations share the trouble of their channel."""
LONG_WAIT = 3 * SECOND
"""A wait for late replies up to this time is not reported (ns)."""

OWN_END = frozenset({"closed", "cancelled", "abandoned", "interrupted"})
"""Outcomes of exchanges that end for a reason that is reported elsewhere, or for none."""
NUMBERS = re.compile(r"\b[0-9A-F]{2}(?: [0-9A-F]{2})*\b|\d+(?:\.\d+)?")
"""Digits and bytes of a cause, which may differ from reply to reply while the cause is the same."""

BLOCK, POINT, OLD, PORT, WAIT = "block", "point", "old", "port", "wait"
"""Kinds of items."""
Item = tuple[str, Hashable]
"""A block (its id), a point (its name), a point whose value is too old, the port, or a wait for late replies."""


class Cause(NamedTuple):
    """Why an item has no good value."""

    kind: str
    """Text without numbers: causes of the same kind are one cause."""
    text: str


def cause_of(text: str) -> Cause:
    """Return the cause that a text describes."""
    return Cause(NUMBERS.sub("#", text), text)


def failure_text(failure: Failure) -> str:
    """Return a failure in words: `no reply`, `refused 2: illegal data address`."""
    outcome, _, rest = str(failure).partition(":")
    name, _, code = outcome.partition(" ")
    words = " ".join(filter(None, (name.replace("_", " "), code)))
    return f"{words}:{rest}" if rest else words


class Part:
    """A channel, or one of its stations: its items without a good value, and their trouble."""

    def __init__(self, owner: ValueTroubles, channel: int, name: str) -> None:
        self.channel = channel
        self.failing: dict[Item, Cause] = {}
        """Items without a good value, in the order of their failures."""
        self._owner, self._clock = owner, owner.clock
        self.source = owner.troubles.source(name, self._effect, unit="", well="good values again", shows_effect=True)
        self._since = 0
        """Time of the first failure (ns)."""
        self._begun: deque[int] = deque(maxlen=OFTEN)
        """Times of the last reports of a begin (ns)."""
        self._reported: tuple[frozenset[str], int] = frozenset(), 0
        """Kinds of the reported causes, and the number of items."""
        self._next_at = self._pause = 0
        """Time before which no other cause is reported, and the time from that report to the next (ns)."""
        self._timer: Handle | None = None
        self._timer_at = 0

    def fails(self, item: Item, cause: Cause) -> None:
        """Note an item without a good value."""
        if not self.failing:
            self._since = self._clock.now()
        known = self.failing.get(item)
        self.failing[item] = cause
        if known is not None and known.kind == cause.kind:
            return
        if self._timer is None or not self.source.reason:
            delay = {PORT: 0, OLD: GATHER_OLD}.get(item[0], GATHER)
            self._report_at(self._clock.now() + delay)

    def well(self, *items: Item) -> None:
        """Note items with a good value; the trouble ends with the last."""
        known = [item for item in items if self.failing.pop(item, None) is not None]
        if not known or self.failing:
            return
        self._cancel()
        if self.source.reason:
            self.source.ends()

    def forget(self, which: Callable[[Item], bool]) -> None:
        """Forget items that are not expected to have values any more, without a report."""
        for item in [one for one in self.failing if which(one)]:
            del self.failing[item]
        if not self.failing:
            self._cancel()
            self.source.forget()

    def flush(self) -> None:
        """Report at once the trouble that waits for its report."""
        if self._timer is not None and not self.source.reason:
            self._cancel()
            self._begin()

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _report_at(self, time: int) -> None:
        """Report at this time, unless it is reported before."""
        if self._timer is not None:
            if self._timer_at <= time:
                return
            self._timer.cancel()
        self._timer_at = time
        if time <= self._clock.now():
            self._report()
        else:
            self._timer = self._clock.call_at(time, self._report)

    def _report(self) -> None:
        """Report the causes, unless they are known; later, if the last report was a short time ago."""
        self._timer = None
        now = self._clock.now()
        if not self.failing:
            return
        if not self.source.reason:
            comes_and_goes = len(self._begun) == OFTEN and now - self._begun[0] < SOON
            if comes_and_goes and now - self._since < LASTS:
                self._report_at(self._since + LASTS)
            else:
                self._begin()
            return
        kinds, number = self._reported
        if self._kinds() <= kinds and len(self.failing) <= 2 * number:
            return
        if now < self._next_at:
            self._report_at(self._next_at)
        else:
            self._note_report(2 * self._pause)
            self.source.changes(self._reason())

    def _begin(self) -> None:
        self._begun.append(self._clock.now())
        self._note_report(FIRST_PAUSE)
        self.source.begins(self._reason(), self._since)

    def _note_report(self, pause: int) -> None:
        self._reported = self._kinds(), len(self.failing)
        self._pause = min(pause, LONGEST_PAUSE)
        self._next_at = self._clock.now() + self._pause

    def _causes(self) -> list[Cause]:
        """Return the causes that count: that of the port, else those of all items that are not only too old."""
        found = dict(self.failing)
        port = found.get((PORT, ""))
        causes = [cause for (kind, _), cause in found.items() if kind != OLD]
        return [port] if port is not None else causes or list(found.values())

    def _kinds(self) -> frozenset[str]:
        return frozenset(cause.kind for cause in self._causes())

    def _reason(self) -> str:
        """Return the two most frequent causes."""
        causes = self._causes()
        count = Counter(cause.kind for cause in causes)
        texts = {cause.kind: cause.text for cause in causes}
        reasons = [texts[kind] for kind, _ in count.most_common(2)]
        return "; ".join(reasons + ([plural(len(count) - 2, "more cause")] if len(count) > 2 else []))

    def _effect(self) -> str:
        """Return the points and blocks without a good value: their number and the first names."""
        items = tuple(self.failing)
        return self._owner.named(self.channel if (PORT, "") in items else None, items)


class ValueTroubles:
    """The troubles of the values of a run. `blocks` and `points` return those of the run at present."""

    def __init__(
        self, troubles: Troubles, clock: Clock, blocks: Callable[[], Iterable[Block]],
        points: Callable[[], Iterable[Point]],
    ) -> None:  # fmt: skip
        self.troubles, self.clock = troubles, clock
        self._blocks, self._points = blocks, points
        self._parts: dict[tuple[int, Hashable], Part] = {}
        self.is_quiet = True
        """Whether no item is without a good value."""

    @property
    def names(self) -> set[str]:
        """Return the names of its troubles."""
        return {part.source.name for part in self._parts.values()}

    # ---- events -------------------------------------------------------------------------------------------

    def failed(self, block: Block, station: Hashable, failure: Failure) -> None:
        """Note a failed exchange of a block. Its port is open."""
        if block.job is not None or self._is_answered(block) or failure.outcome in OWN_END:
            return
        part = self._fails(block.channel, station, (BLOCK, block.id), cause_of(failure_text(failure)))
        part.failing.pop((WAIT, ""), None)
        if (whole := self._parts.get((block.channel, None))) is not None:
            whole.forget(lambda item: item[0] == PORT)

    def good(self, block: Block, station: Hashable) -> None:
        """Note a good exchange of a block: its channel works. Points of the block report for themselves."""
        for key in {(block.channel, None), self._key(block.channel, station)}:
            if (part := self._parts.get(key)) is not None:
                part.well((BLOCK, block.id), (PORT, ""), (WAIT, ""))
        self._look()

    def not_good(self, point: Point, channel: int, station: Hashable, quality: str, why: str) -> None:
        """Note a point whose data are no value, or whose value is stale; good: it has a value again."""
        if quality != "good":
            self._fails(channel, station, (OLD if quality == "stale" else POINT, point.name), cause_of(why))
        elif (part := self._parts.get(self._key(channel, station))) is not None:
            part.well((POINT, point.name), (OLD, point.name))
            self._look()

    def lost(self, channel: int, why: str) -> None:
        """Note that the port of a channel is not open; the next exchange, or `opened`, ends it."""
        self._fails(channel, None, (PORT, ""), cause_of(f"port not open: {why}"))

    def opened(self, channel: int) -> None:
        """Note an open port: the trouble of a channel on which no block asks ends."""
        part = self._parts.get((channel, None))
        if part is not None and not any(self._asks(channel)):
            part.well((PORT, ""))
            self._look()

    def waits(self, channel: int, station: Hashable, until: int) -> None:
        """Note that no request is sent before `until`, because late replies may come."""
        time = until - self.clock.now()
        if time > LONG_WAIT and any(self._asks(channel)):
            text = f"waits up to {readable_time(rounded(time))} for late replies"
            self._fails(channel, station, (WAIT, ""), cause_of(text))

    def forget(self, which: Callable[[int, Item], bool]) -> None:
        """Forget the items of channels that are not expected to have values any more."""
        for (channel, _), part in self._parts.items():
            part.forget(partial(which, channel))
        self._look()

    def flush(self) -> None:
        """Report at once the troubles that wait for their report."""
        for part in self._parts.values():
            part.flush()

    # ---- parts --------------------------------------------------------------------------------------------

    def _fails(self, channel: int, station: Hashable, item: Item, cause: Cause) -> Part:
        self.is_quiet = False
        key = self._key(channel, station)
        part = self._parts.get(key)
        if part is None:
            where = "" if key[1] is None else f", station {shown(station)}"
            part = self._parts[key] = Part(self, channel, f"channel {channel}{where}")
        part.fails(item, cause)
        return part

    def _key(self, channel: int, station: Hashable) -> tuple[int, Hashable]:
        """Return the key of a part: the channel alone if its blocks ask one station."""
        asked = {repr(block.station) if block.station_from is None else "" for block in self._asks(channel)}
        key = channel, station
        is_alone = len(asked) <= 1 and "" not in asked
        return (channel, None) if is_alone or (key not in self._parts and len(self._parts) >= MOST_PARTS) else key

    def _asks(self, channel: int) -> Iterable[Block]:
        return (block for block in self._blocks() if block.channel == channel and block.job is None)

    @staticmethod
    def _is_answered(block: Block) -> bool:
        """Return whether a program writes a point with the block, and gets the failure itself."""
        return block.set == POINTS_SET and block.instruction == "write"

    def _look(self) -> None:
        self.is_quiet = not any(part.failing for part in self._parts.values())

    def named(self, channel: int | None, items: tuple[Item, ...]) -> str:
        """Return the points and blocks of items: `12 points without a good value (a, b, c …)`.

        `channel`: all its blocks count as items.
        """
        failing = {number for kind, number in items if kind == BLOCK}
        failing |= {block.id for block in self._asks(channel)} if channel is not None else set()
        names = [str(name) for kind, name in items if kind in (POINT, OLD)]
        by_block: dict[Hashable, list[str]] = {}
        for point in self._points():
            for block in point.blocks:
                if block in failing:
                    by_block.setdefault(block, []).append(point.name)
        names = sorted({*names, *(name for found in by_block.values() for name in found)})
        blocks = [
            block
            for block in self._blocks()
            if block.id in failing and block.id not in by_block and not self._is_answered(block)
        ]
        found = []
        if names:
            found.append(f"{plural(len(names), 'point')} without a good value ({_first(names)})")
        if blocks:
            labels = [f"{block.label} {block.what}" for block in blocks[:MOST_NAMED]]
            found.append(f"{plural(len(blocks), 'block')} without success ({_first(labels, len(blocks))})")
        return ", ".join(found)


def _first(names: list[str], number: int | None = None) -> str:
    """Return the first names, and a sign if there are more; `number`: of all, if `names` has only the first."""
    more = (len(names) if number is None else number) > MOST_NAMED
    return ", ".join(names[:MOST_NAMED]) + (" …" if more else "")
