"""Compare a running run with its edited file: list the differences, and refuse changes that need a restart.

Positions in the file do not count: a block that only moved is the same. This module only plans; it applies no change.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import zip_longest

from framekit.definition.fingerprint import fingerprint
from framekit.definition.problems import DefinitionError, Position, Problem, listed
from framekit.run.block_state import BlockState
from framekit.run.model import Block, Point, RunModel

MOST_NAMES = 5
"""Largest number of names of points in a message; the others are counted."""

RESTART = "stop the run and start it again"


@dataclass(frozen=True, slots=True)
class Changes:
    """The numbers of removed, changed and new items, each in order."""

    gone: tuple[int, ...]
    changed: tuple[int, ...]
    new: tuple[int, ...]

    @classmethod
    def between(cls, old: Mapping[int, object], new: Mapping[int, object]) -> Changes:
        """Return the changes that lead from `old` to `new`."""
        both = sorted(old.keys() & new.keys())
        return cls(
            tuple(sorted(old.keys() - new.keys())),
            tuple(number for number in both if fingerprint(old[number]) != fingerprint(new[number])),
            tuple(sorted(new.keys() - old.keys())),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Edit:
    """An edited run, and the changes to apply."""

    run: RunModel
    channels: Changes
    blocks: Changes
    touched: frozenset[int]
    """The channels that must be idle before the changes are applied: removed and changed channels, and the channels of
    removed and changed blocks."""
    warnings: tuple[Problem, ...]
    """Differences that only take effect at the next start."""

    def __str__(self) -> str:
        """Return the changes in words, for example `channel 2 changed, blocks 0 and 3 new`."""
        found = []
        for what, changes in (("channel", self.channels), ("block", self.blocks)):
            for how in ("gone", "changed", "new"):
                numbers: tuple[int, ...] = getattr(changes, how)
                if numbers:
                    found.append(f"{what if len(numbers) == 1 else f'{what}s'} {listed(numbers)} {how}")
        return ", ".join(found) or "nothing is different"


def plan_edit(old: RunModel, new: RunModel) -> Edit:
    """Return the changes from one run to the other. Raise DefinitionError for changes that need a restart."""
    problems = list(_refusals(old, new))
    if problems:
        raise DefinitionError(problems)
    old_blocks, new_blocks = ({block.id: block for block in run.blocks} for run in (old, new))
    channels, blocks = Changes.between(old.channels, new.channels), Changes.between(old_blocks, new_blocks)
    touched = {*channels.gone, *channels.changed}
    touched |= {old_blocks[number].lane for number in (*blocks.gone, *blocks.changed)}
    warnings = tuple(_warnings(old, new))
    return Edit(run=new, channels=channels, blocks=blocks, touched=frozenset(touched), warnings=warnings)


def _refusals(old: RunModel, new: RunModel) -> Iterator[Problem]:
    if fingerprint(old.memory) != fingerprint(new.memory):
        at = new.memory.at if new.memory.at.file == new.at.file else new.at
        yield Problem(at, "the memory of a run that goes on stays as it is, and this is another one", RESTART)
    if fingerprint(old.points) != fingerprint(new.points):
        yield Problem(*_of_points(old, new), RESTART)
    if fingerprint(old.sinks) != fingerprint(new.sinks):
        pairs = zip_longest(old.sinks, new.sinks)
        places = [sink.at for before, sink in pairs if sink is not None and _is_other(before, sink)]
        at = [*places, *(sink.at for sink in new.sinks), new.at][0]
        yield Problem(at, "where the values of a run go cannot change while it goes on", RESTART)
    if fingerprint(old.fleet) != fingerprint(new.fleet):
        at = new.at if new.fleet is None else new.fleet.at
        yield Problem(at, "the fleet of a run that goes on stays as it is, and this is another one", RESTART)
    if old.status != new.status:
        yield Problem(new.at, "whether blocks have words in memory cannot change while the run goes on", RESTART)
    if fingerprint(old.jobs) != fingerprint(new.jobs):
        at = new.at if new.jobs is None else new.jobs.at
        yield Problem(at, "what the run says of its jobs cannot change while it goes on", RESTART)
    if fingerprint(old.state) != fingerprint(new.state) or (old.state is not None and old.name != new.name):
        at = new.at if new.state is None else new.state.at
        yield Problem(at, "where the state is kept, and under which name, cannot change while the run goes on", RESTART)


def _of_points(old: RunModel, new: RunModel) -> tuple[Position, str]:
    """Return the place of the first changed or new point, and a message with the names of the different points."""
    before, after = ({point.name: point for point in run.points} for run in (old, new))
    changed = [name for name, point in after.items() if name in before and _is_other_point(before[name], point)]
    added, gone = [name for name in after if name not in before], [name for name in before if name not in after]
    found = []
    for how, names in (("changed", changed), ("new", added), ("gone", gone)):
        if names:
            shown = names if len(names) <= MOST_NAMES else [*names[:MOST_NAMES], f"{len(names) - MOST_NAMES} others"]
            found.append(f"{'point' if len(names) == 1 else 'points'} {listed(shown)} {how}")
    at = next((point.at for point in new.points if point.name in (*changed, *added)), None)
    if at is None:
        at = new.points[0].at if new.points else new.at
    what = "the points of a run that goes on stay as they are"
    return at, f"{what}: {', '.join(found) or 'their order is another'}"


def _is_other_point(old: Point, new: Point) -> bool:
    """Return whether two points differ.

    The place in memory of a point that is read from a channel does not count: it depends on the points before it.
    """
    if new.channel is not None:
        new = replace(new, place=old.place, blocks=old.blocks)
    return _is_other(old, new)


def _is_other(old: object, new: object) -> bool:
    """Return whether two parts of a run differ in more than their places in the file."""
    return fingerprint(old) != fingerprint(new)


def _warnings(old: RunModel, new: RunModel) -> Iterator[Problem]:
    if fingerprint(old.initial) != fingerprint(new.initial):
        what = "memory stays as it is: other start values count from the next start on"
        yield Problem(new.at, what, "", warning=True)


def added_blocks(edit: Edit) -> list[Block]:
    """Return the blocks that start anew."""
    return [block for block in edit.run.blocks if block.id in (*edit.blocks.changed, *edit.blocks.new)]


@dataclass(slots=True)
class RemovedBlocks:
    """The counts of all removed blocks of a channel; commands to jobs count for channel 0.

    A changed block counts as removed, because its counts start anew. No removed block runs.
    """

    channel: int
    blocks: int = 0
    """The number of removed blocks that had started or overrun."""
    started: int = 0
    done: int = 0
    failed: int = 0
    overruns: int = 0
    reasons: Counter[str] = field(default_factory=Counter)


class Removed:
    """The counts of the removed blocks of a run, by channels; empty before the first edit."""

    def __init__(self) -> None:
        self._channels: dict[int, RemovedBlocks] = {}

    def __iter__(self) -> Iterator[RemovedBlocks]:
        return iter([one for _, one in sorted(self._channels.items())])

    def of(self, channel: int) -> RemovedBlocks:
        """Return the counts of the removed blocks of a channel."""
        return self._channels.get(channel) or RemovedBlocks(channel)

    def add(self, state: BlockState) -> None:
        """Add the counts of a removed block."""
        if not (state.started or state.overruns):
            return
        one = self._channels.setdefault(state.block.channel, RemovedBlocks(state.block.channel))
        one.blocks += 1
        one.started += state.started
        one.done += state.done
        one.failed += state.failed
        one.overruns += state.overruns
        one.reasons.update(state.reasons)

    def clear(self) -> None:
        """Start counting anew."""
        self._channels.clear()
