"""Report that values do not come: from which channel and station, why, and for which points and blocks.

The failures of a channel and station are one trouble. It begins when an exchange fails, a port is lost, or a request
waits for late replies; it ends when each of its blocks and points has a good value again, or the device answers again.

Refusals of a device, and data that are no value, are another trouble of the same channel and station: a refusal
concerns a block or a point, and may last for ever, so it must not hide when the device falls silent.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Hashable, Iterable
from operator import itemgetter
from typing import NamedTuple, Protocol

from framekit.codec.shown import shown
from framekit.definition.problems import plural
from framekit.definition.times import readable_time
from framekit.link.slow import key_of, rounded
from framekit.link.unusable import without_count
from framekit.run.block_state import Failure
from framekit.run.model import POINTS_SET, Block, Point, RunModel
from framekit.run.trouble import SECOND, Troubles, lasted, remedy_of
from framekit.transport.clock import Clock, Handle

GATHER, GATHER_OLD, GATHER_WAIT = SECOND, 3 * SECOND, 5 * SECOND
"""Failures of a station within this time are one report (ns).

The second time: after values that are too old, because the exchange under way may fail and show why. The third: after
the begin of a wait for late replies, because they may come and show how slow the station is.
"""
LASTS = 10 * SECOND
"""A trouble that comes and goes is reported when it has lasted for this time (ns)."""
COMES_AND_GOES = (3, 60 * SECOND), (10, 3600 * SECOND)
"""A trouble comes and goes if it was reported so many times within the time (ns) of a pair."""
SELDOM = 3600 * SECOND
"""Time for which short troubles are not reported, from the last report of a trouble that comes and goes (ns)."""
MOST_WHILE_SELDOM, LONGER = 3, 6
"""After so many reports in this time a trouble has to last so many times as long to be reported."""
FIRST_PAUSE, LONGEST_PAUSE = 10 * SECOND, 600 * SECOND
"""Least time from the begin of a trouble to the report of another cause, and its limit: it doubles (ns)."""
MOST_NAMED = 3
"""Points and blocks that a report names."""
MOST_PARTS = 500
"""Stations with a trouble of their own; further stations share the trouble of their channel."""
MOST_CAUSES = 2
"""Causes that a report describes."""
LONG_WAIT = 3 * SECOND
"""A wait for late replies up to this time is not reported (ns)."""

LOOK_AGAIN = 3 * SECOND
"""Time between two looks for further blocks that get no value (ns)."""
SHRUNK_LASTS = 10 * SECOND
"""Fewer points without a good value are reported when that has lasted for this time (ns)."""

OWN_END = frozenset({"closed", "cancelled", "abandoned", "interrupted"})
"""Outcomes of exchanges that end for a reason that is reported elsewhere, or for none."""
NUMBERS = re.compile(r"\b[0-9A-F]{2}(?: [0-9A-F]{2})*\b|\d+(?:\.\d+)?")
"""Digits and bytes of a cause, which may differ from reply to reply while the cause is the same."""

ANSWERED = frozenset({"refused", "cannot_store"})
"""Outcomes that show that the device has answered; a device code shows it, too."""
OF_BLOCK = ANSWERED | {"bad_setting", "cannot_send", "circle", "expression", "no_sequence", "not_allowed"}
"""Outcomes that concern the block, and not its channel or station."""

BLOCK, WAIT, OLD, PORT, REFUSED, POINT = "block", "wait", "old", "port", "refused", "point"
"""Kinds of items."""
Item = tuple[str, Hashable]
"""A block without a reply, or a block that waits (its id), a point whose value is too old (its name), the port; a block
that is refused (its id), a point whose data are no value (its name).
"""
OF_BLOCKS = frozenset({BLOCK, WAIT, REFUSED})
"""Kinds whose items are blocks."""
RANKS = frozenset({BLOCK, REFUSED, POINT}), frozenset({WAIT}), frozenset({OLD})
"""Kinds of causes and, after them, of their consequences: a wait, and values that are too old because of it."""
FOLLOWING = frozenset({WAIT, OLD})
"""Kinds that follow from another cause, if the part has another."""
ALONE = frozenset({REFUSED, POINT})
"""Kinds that concern single blocks and points: they are a trouble of their own."""
PartKey = tuple[int, Hashable, bool]
"""Channel, station (None: the channel alone), and whether the kinds of the items are `ALONE`."""
GOOD = "good values again"
EXPLAINED = "explained by the reported trouble of the line"
NOT_EXPECTED = "no value is expected any more"
MOVED = "another trouble has taken its place"
"""Ends of troubles that are not reported any more although no value has come."""
ANSWERS = "answers again"
"""The end of a trouble whose blocks are all refused now."""


class Cause(NamedTuple):
    """Why an item has no good value."""

    kind: str
    """Text without numbers: causes of the same kind are one cause."""
    text: str


def cause_of(text: str) -> Cause:
    """Return the cause that a text describes."""
    return Cause(NUMBERS.sub("#", without_count(text)), text)


def _is_news(kind: str, reported: Iterable[str]) -> bool:
    """Return whether a kind of cause was not reported, not even as the beginning or the end of another.

    `no reply` is no news after `no reply: replies arrived …`, and neither is `replies arrived …`.
    """
    return not any(known == kind or known.startswith(f"{kind}:") or known.endswith(f": {kind}") for known in reported)


def comes_again(lasts: int) -> str:
    """Return the end of the last report before troubles that last less than `lasts` (ns) are not reported."""
    return f"it comes and goes: for {lasted(SELDOM)} reported only when it lasts {lasted(lasts)}"


def failure_text(failure: Failure) -> str:
    """Return a failure in words: `no reply`, `refused 2: illegal data address`."""
    outcome, _, rest = str(failure).partition(":")
    name, _, code = outcome.partition(" ")
    words = " ".join(filter(None, (name.replace("_", " "), code)))
    return f"{words}:{rest}" if rest else words


def is_refused(failure: Failure) -> bool:
    """Return whether a failure shows that the device has answered."""
    return failure.outcome in ANSWERED or (failure.device_code is not None and failure.outcome != "no_reply")


class Part:
    """A trouble of a channel or of one of its stations: its items without a good value.

    `name`: of the trouble; `key`: of the part, see `ValueTroubles`.
    """

    def __init__(self, owner: ValueTroubles, key: PartKey, name: str) -> None:
        self.key = key
        self.failing: dict[Item, Cause] = {}
        """Items without a good value, in the order of their failures."""
        self._owner, self._clock = owner, owner.clock
        self.source = owner.troubles.source(name, unit="", well=GOOD, is_whole=True)
        self._since = 0
        """Time of the first failure (ns)."""
        self._silent: list[Item] = []
        """Further blocks that get no value for the same cause, presumably: they wait, and no block of the part is well.
        """
        self._good: dict[Item, None] = {}
        """Items that have a good value again while the trouble lasts."""
        self._begun: deque[int] = deque(maxlen=max(number for number, _ in COMES_AND_GOES))
        """Times of the last reports of a begin (ns)."""
        self._seldom_until = 0
        """Time up to which a short trouble is not reported (ns)."""
        self._lasts = LASTS
        """Least time that a trouble lasts to be reported until then (ns)."""
        self._reported: tuple[frozenset[str], int] = frozenset(), 0
        """Kinds of the reported causes, and the number of points and blocks."""
        self._followed: frozenset[str] = frozenset()
        """Kinds of the consequences that were reported since the trouble began; their return is no news."""
        self._shrunk_at = 0
        """Time since which not more than half of the reported points and blocks are left (ns); 0: more are left."""
        self._reported_at = self._pause = 0
        """Time of the last report, and the least time from it to the report of another cause (ns)."""
        self._timer: Handle | None = None
        self._timer_at = 0

    def fails(self, item: Item, cause: Cause) -> None:
        """Note an item without a good value."""
        if not self.failing:
            self._since = self._clock.now()
            self._good.clear()
        known = self.failing.get(item)
        self.failing[item] = cause
        self._good.pop(item, None)
        if known is not None and known.kind == cause.kind:
            return
        if self._timer is None or not self.source.reason:
            delay = {PORT: 0, OLD: GATHER_OLD, WAIT: GATHER_WAIT}.get(item[0], GATHER)
            self._report_at(self._clock.now() + delay)

    def well(self, item: Item, sentence: str = "") -> None:
        """Note that an item is well; the trouble ends with the last, and is reported.

        `sentence`: describes the end, if no item has a good value; without it this item has a good value.
        """
        del self.failing[item]
        if not sentence:
            self._good[item] = None
        if self.failing:
            self._look_soon()
            return
        self._cancel()
        if self.source.reason:
            if not self._good:
                well = sentence
            elif self._owner.has_other_trouble(self.key):
                well = f"{GOOD} of {self._owner.named(None, tuple(self._good), '')}"
            else:
                well = GOOD
            self.source.ends(well)

    def forget(self, item: Item, why: str) -> None:
        """Forget an item that is not expected to have a value any more, or fails in another part.

        If it was the last of a reported trouble, `why` is reported as its end.
        """
        del self.failing[item]
        if self.failing:
            self._look_soon()
        else:
            self._cancel()
            self.source.ends(why)

    def end(self) -> None:
        """Report at once the trouble that waits for its report; no report follows."""
        if self._timer is not None:
            self._cancel()
            if not (self.source.reason or self._is_explained()):
                self._begin()

    def explained(self) -> None:
        """End the report of this trouble if the trouble of its line explains it."""
        if self.source.reason and self._is_explained():
            self.source.ends(EXPLAINED)
            self._report_at(self._clock.now() + LASTS)

    def _waits_for_cause(self, now: int) -> bool:
        """Return whether the report is put off: a trouble of the line explains it, or late replies soon may."""
        if self._is_explained():
            self._report_at(now + LASTS)
            return True
        kinds = {kind for kind, _ in self.failing}
        if WAIT in kinds and kinds <= FOLLOWING and now < self._since + GATHER_WAIT:
            self._report_at(self._since + GATHER_WAIT)
            return True
        return False

    def _is_explained(self) -> bool:
        """Return whether values are only too old, or wait, and a reported trouble of the line explains it."""
        return all(kind in FOLLOWING for kind, _ in self.failing) and self._owner.is_explained(self.key)

    def _look_soon(self) -> None:
        """Bring the reason up to date soon, after an item has gone; its cause may have been that of no other item."""
        if self.source.reason:
            self._report_at(self._clock.now() + GATHER)

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
        """Show the causes in the status, and report new ones; later, if the last report was a short time ago."""
        self._timer = None
        now = self._clock.now()
        if not self.failing:
            return
        if not self.source.reason and self._waits_for_cause(now):
            return
        if not self.source.reason:
            if now < self._seldom_until and now - self._since < self._lasts:
                self._report_at(self._since + self._lasts)
            else:
                self._begin()
            return
        self._look_for_silent()
        self.source.reason = self._reason()
        at = self._change_at(now)
        if at > now:
            self._report_at(at)
        elif at:
            self._note_report(FIRST_PAUSE if now - self._reported_at > 2 * self._pause else 2 * self._pause)
            self.source.changes(self._reason())

    def _change_at(self, now: int) -> int:
        """Return when to report another cause, or another number of points; 0: both are unchanged."""
        kinds, number = self._reported
        count = self._number()
        if count > 2 * number or any(_is_news(kind, kinds | self._followed) for kind in self._kinds()):
            self._shrunk_at = 0
            return max(now, self._reported_at + self._pause)
        if 2 * count > number:
            self._shrunk_at = 0
            return 0
        self._shrunk_at = self._shrunk_at or now
        return max(now, self._reported_at + self._pause, self._shrunk_at + SHRUNK_LASTS)

    def _comes_and_goes(self, now: int) -> bool:
        """Return whether the trouble was reported too often lately."""
        begun = self._begun
        return any(len(begun) >= number and now - begun[-number] < time for number, time in COMES_AND_GOES)

    def _begin(self) -> None:
        now = self._clock.now()
        self._begun.append(now)
        self._followed = frozenset()
        self._look_for_silent()
        self._note_report(FIRST_PAUSE)
        reason = self._reason()
        is_seldom = now < self._seldom_until
        if len(self._begun) >= MOST_WHILE_SELDOM if is_seldom else self._comes_and_goes(now):
            self._lasts = min(LONGER * self._lasts, SELDOM) if is_seldom else LASTS
            self._seldom_until = now + SELDOM
            self._begun.clear()
            reason += f"; {comes_again(self._lasts)}"
        self.source.begins(reason, self._since)

    def _note_report(self, pause: int) -> None:
        self._reported = self._kinds(), self._number()
        if all(kind in FOLLOWING for kind, _ in self.failing):
            self._followed |= self._reported[0]
        self._shrunk_at = 0
        self._pause = min(pause, LONGEST_PAUSE)
        self._reported_at = self._clock.now()

    def _look_for_silent(self) -> None:
        """Look for further blocks that get no value, now and again while some are found."""
        self._silent = []
        if any(kind == BLOCK for kind, _ in self.failing) and (PORT, "") not in self.failing:
            blocks = self._owner.overdue(self.key, self._since)
            self._silent = [item for item in blocks if item not in self.failing]
        if self._silent:
            self._report_at(self._clock.now() + LOOK_AGAIN)

    def _causes(self) -> dict[str, tuple[Cause, list[Item]]]:
        """Return the causes that count, the most frequent first, each with its items, by kind.

        The cause of a lost port is the cause of all items. Consequences belong to the most frequent cause.
        """
        port = self.failing.get((PORT, ""))
        if port is not None:
            return {port.kind: (port, list(self.failing))}
        if all(kind in FOLLOWING for kind, _ in self.failing) and (shown := self._owner.under_way(self.key)):
            cause = cause_of(shown)
            return {cause.kind: (cause, list(self.failing))}
        first = next(kinds for kinds in RANKS if any(kind in kinds for kind, _ in self.failing))
        found: dict[str, tuple[Cause, list[Item]]] = {}
        followed = []
        for item, cause in self.failing.items():
            if item[0] in first:
                items = found[cause.kind][1] if cause.kind in found else []
                items.append(item)
                found[cause.kind] = cause, items
            else:
                followed.append(item)
        ordered = dict(sorted(found.items(), key=lambda one: -len(one[1][1])))
        next(iter(ordered.values()))[1].extend((*followed, *self._silent))
        for kind in list(ordered):  # `no reply`, and `no reply: a reply arrived and could not be used …`
            fuller = next((one for one in ordered if one.startswith(f"{kind}:")), None)
            if fuller is not None:
                ordered[fuller][1].extend(ordered.pop(kind)[1])
        return ordered

    def _kinds(self) -> frozenset[str]:
        return frozenset(self._causes())

    def _number(self) -> int:
        """Return the number of points and blocks without success, as a report names them."""
        channel = self.key[0] if (PORT, "") in self.failing else None
        names, blocks = self._owner.affected(channel, (*self.failing, *self._silent))
        return len(names) + len(blocks)

    def _reason(self) -> str:
        """Return the two most frequent causes, each with its points and blocks: their number and the first names."""
        causes = list(self._causes().values())
        found = []
        for cause, items in causes[:MOST_CAUSES]:
            is_port = (PORT, "") in items
            effect = self._owner.named(self.key[0] if is_port else None, tuple(items))
            more = "; ".join(filter(None, (remedy_of(cause.text) if is_port else "", effect)))
            found.append(f"{cause.text} – {more}" if more else cause.text)
        left = len(causes) - MOST_CAUSES
        if left > 0:
            found.append(plural(left, "more cause"))
        wait = next((cause.text for (kind, _), cause in reversed(self.failing.items()) if kind == WAIT), "")
        if wait and not any(cause.text == wait for cause, _ in causes):
            found.append(wait)
        return "; ".join(found)


class _BlockIndex:
    """The blocks and points of a run, as reports need them."""

    def __init__(self, run: RunModel) -> None:
        self.run = run
        self.blocks = {block.id: (at, block) for at, block in enumerate(run.blocks) if block.job is None}
        """The blocks that are not part of a job, each with its place in the run."""
        self.of_channel: dict[int, list[int]] = {}
        """Their ids, by channel."""
        self.of_station: dict[tuple[int, Hashable], list[int]] = {}
        """Their ids, by channel and by the station in the run file."""
        stations: dict[int, set[str]] = {}
        for _, block in self.blocks.values():
            self.of_channel.setdefault(block.channel, []).append(block.id)
            if block.station_from is None:
                self.of_station.setdefault((block.channel, key_of(block.station)), []).append(block.id)
            asked = stations.setdefault(block.channel, set())
            asked.update([repr(block.station)] if block.station_from is None else ["", "from memory"])
        self.shared = {channel for channel, asked in stations.items() if len(asked) > 1}
        """The channels whose blocks ask several stations."""
        self.points: dict[int, list[str]] = {}
        """The names of the points, by block."""
        for point in run.points:
            for number in point.blocks:
                self.points.setdefault(number, []).append(point.name)


class WatchedRun(Protocol):
    """The contract of a run with the troubles of its values: the state of its lines and blocks."""

    run: RunModel

    def starts_by_itself(self, channel: int) -> bool:
        """Return whether an enabled block with a period asks on a channel: a value shows that the port works."""

    def overdue(self, blocks: Iterable[int], since: int) -> list[int]:
        """Return the blocks that wait since before a time; no block, if a block has ended well since."""

    def is_explained(self, channel: int, station: Hashable) -> bool:
        """Return whether a reported trouble of a channel explains that the values of a station are too old."""

    def under_way(self, channel: int, station: Hashable) -> str:
        """Describe the replies to the exchange under way that could not be used; '' without such replies."""


class ValueTroubles:
    """The troubles of the values of a run."""

    def __init__(self, troubles: Troubles, clock: Clock, line: WatchedRun) -> None:
        self.troubles, self.clock = troubles, clock
        self._line = line
        self._known_index: _BlockIndex | None = None
        self._parts: dict[PartKey, Part] = {}
        self._part_of: dict[tuple[int, Item], Part] = {}
        """The part in which each item fails; each fails in one part at most, also if its station changes."""

    @property
    def is_quiet(self) -> bool:
        """Return whether no item is without a good value."""
        return not self._part_of

    @property
    def names(self) -> set[str]:
        """Return the names of its troubles."""
        return {part.source.name for part in self._parts.values()}

    # ---- events -------------------------------------------------------------------------------------------

    def failed(self, block: Block, station: Hashable, failure: Failure) -> None:
        """Note a failed exchange of a block. Its port is open."""
        if block.job is not None or _is_answered(block) or failure.outcome in OWN_END:
            return
        channel, number = block.channel, block.id
        cause = cause_of(failure_text(failure))
        if is_refused(failure):
            self._fails(channel, station, (REFUSED, number), cause)
            self._answered(block, ANSWERS)
        elif failure.outcome in OF_BLOCK:
            self._fails(channel, station, (REFUSED, number), cause)
            self._forget(channel, (BLOCK, number))
            self._forget(channel, (WAIT, number))
        else:
            self._fails(channel, station, (BLOCK, number), cause)
            self._forget(channel, (WAIT, number))
            self._forget(channel, (PORT, ""))

    def good(self, block: Block) -> None:
        """Note a good exchange of a block: its channel works. Points of the block report for themselves."""
        self._well(block.channel, (REFUSED, block.id))
        self._answered(block)

    def _answered(self, block: Block, sentence: str = "") -> None:
        """Note a reply to a block; with a sentence it is no good value."""
        for item in ((BLOCK, block.id), (WAIT, block.id), (PORT, "")):
            self._well(block.channel, item, sentence)
        if sentence:
            for name in self._index.points.get(block.id, ()):
                self._well(block.channel, (OLD, name), sentence)

    def not_good(self, point: Point, channel: int, station: Hashable, quality: str, why: str) -> None:
        """Note a point whose data are no value, or whose value is stale; good: it has a value again."""
        if quality != "good":
            self._fails(channel, station, (OLD if quality == "stale" else POINT, point.name), cause_of(why))
        else:
            self._well(channel, (POINT, point.name))
            self._well(channel, (OLD, point.name))

    def lost(self, channel: int, why: str) -> None:
        """Note that the port of a channel is closed, and why; the next exchange, or `opened`, ends it."""
        self._fails(channel, None, (PORT, ""), cause_of(why))

    def opened(self, channel: int) -> None:
        """Note an open port: this ends its trouble if no block starts by itself."""
        if not self._line.starts_by_itself(channel):
            self._well(channel, (PORT, ""), "the port is open again")

    def waits(self, block: Block, station: Hashable, until: int) -> None:
        """Note that the request of a block is not sent before `until`, because late replies may come."""
        time = until - self.clock.now()
        if time > LONG_WAIT and block.job is None and not _is_answered(block):
            text = f"waits up to {readable_time(rounded(time))} for late replies"
            self._fails(block.channel, station, (WAIT, block.id), cause_of(text))

    def forget(self, which: Callable[[int, Item], bool]) -> None:
        """Forget the items of channels that are not expected to have values any more."""
        for channel, item in [key for key in self._part_of if which(*key)]:
            self._forget(channel, item, NOT_EXPECTED)

    def end(self) -> None:
        """Report at once the troubles that wait for their report; no report follows."""
        for part in self._parts.values():
            part.end()

    # ---- parts --------------------------------------------------------------------------------------------

    def _fails(self, channel: int, station: Hashable, item: Item, cause: Cause) -> None:
        key = self._key(channel, station, item[0] in ALONE)
        part = self._parts.get(key)
        if part is None:
            where = "" if key[1] is None else f", station {shown(station)}"
            part = self._parts[key] = Part(self, key, f"channel {channel}{where}")
        if self._part_of.get((channel, item), part) is not part:
            self._forget(channel, item)
        self._part_of[channel, item] = part
        part.fails(item, cause)

    def _well(self, channel: int, item: Item, sentence: str = "") -> None:
        part = self._part_of.pop((channel, item), None)
        if part is not None:
            part.well(item, sentence)

    def _forget(self, channel: int, item: Item, why: str = MOVED) -> None:
        part = self._part_of.pop((channel, item), None)
        if part is not None:
            part.forget(item, why)

    def _key(self, channel: int, station: Hashable, is_alone: bool) -> PartKey:
        """Return the key of a part: the channel alone if its blocks ask one station."""
        key = channel, station, is_alone
        has_own = channel in self._index.shared and (key in self._parts or len(self._parts) < MOST_PARTS)
        return key if has_own else (channel, None, is_alone)

    def overdue(self, key: PartKey, since: int) -> list[Item]:
        """Return the blocks of a part that wait since before a time; no block, if a block has ended well since."""
        channel, station, _ = key
        index = self._index
        alone = station is None and channel not in index.shared
        blocks = index.of_channel.get(channel, ()) if alone else index.of_station.get((channel, key_of(station)), ())
        found = self._line.overdue(blocks, since)
        return [(BLOCK, number) for number in found if (channel, (REFUSED, number)) not in self._part_of]

    def under_way(self, key: PartKey) -> str:
        """Describe the replies to the exchange under way of a part that could not be used."""
        return self._line.under_way(key[0], key[1])

    def is_explained(self, key: PartKey) -> bool:
        """Return whether a reported trouble of the line of a part explains that its values are too old."""
        return self._line.is_explained(key[0], key[1])

    def explained(self, channel: int) -> None:
        """Note a trouble of a line that explains old values; they are not reported while it lasts."""
        for key, part in self._parts.items():
            if key[0] == channel and part.failing:
                part.explained()

    def has_other_trouble(self, key: PartKey) -> bool:
        """Return whether the other part of the same channel and station has a trouble."""
        channel, station, is_alone = key
        other = self._parts.get((channel, station, not is_alone))
        return other is not None and bool(other.source.reason)

    @property
    def _index(self) -> _BlockIndex:
        run, known = self._line.run, self._known_index
        if known is None or known.run is not run:
            known = self._known_index = _BlockIndex(run)
        return known

    def affected(self, channel: int | None, items: tuple[Item, ...]) -> tuple[set[str], list[Block]]:
        """Return the names of the points of items, and their blocks without points, in the order of the run.

        `channel`: all its blocks count as items.
        """
        index = self._index
        failing = {number for kind, number in items if kind in OF_BLOCKS}
        failing.update(() if channel is None else index.of_channel.get(channel, ()))
        known = sorted((index.blocks[number] for number in failing if number in index.blocks), key=itemgetter(0))
        names = {str(name) for kind, name in items if kind in (POINT, OLD)}
        names.update(name for _, block in known for name in index.points.get(block.id, ()))
        return names, [block for _, block in known if block.id not in index.points and not _is_answered(block)]

    def named(self, channel: int | None, items: tuple[Item, ...], what: str = " without a good value") -> str:
        """Return the points and blocks of items: `12 points without a good value (a, b, c …)`.

        `channel`: all its blocks count as items; `what` follows the number of points.
        """
        names, blocks = self.affected(channel, items)
        found = []
        if names:
            found.append(f"{plural(len(names), 'point')}{what} ({_first(sorted(names))})")
        if blocks:
            labels = [f"{block.label} {block.what}" for block in blocks[:MOST_NAMED]]
            success = " without success" if what else ""
            found.append(f"{plural(len(blocks), 'block')}{success} ({_first(labels, len(blocks))})")
        return ", ".join(found)


def _is_answered(block: Block) -> bool:
    """Return whether a program writes a point with the block, and gets the failure itself."""
    return block.set == POINTS_SET and block.instruction == "write"


def _first(names: list[str], number: int | None = None) -> str:
    """Return the first names, and a sign if there are more; `number`: of all, if `names` has only the first."""
    more = (len(names) if number is None else number) > MOST_NAMED
    return ", ".join(names[:MOST_NAMED]) + (" …" if more else "")
