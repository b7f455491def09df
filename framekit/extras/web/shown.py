"""The content of a page for a run or for devices: tables, points, frames, and the available controls.

Rows and point values have the number of the round in which they last changed. Updates are not queued: each query reads
the current state, so that a slow reader gets fewer updates but never an old state.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Any, NamedTuple

from framekit.api.monitor import FrameLog, LiveView
from framekit.api.points import RunPoint, RunPoints
from framekit.api.rows import (
    BLOCK_HEAD,
    CHANNEL_HEAD,
    JOB_HEAD,
    SINK_HEAD,
    STATION_HEAD,
    TROUBLE_HEAD,
    block_row,
    block_state,
    channel_row,
    job_row,
    percent,
    sink_row,
    station_row,
    trouble_row,
)
from framekit.api.run import RunCalls
from framekit.api.server import AsyncServer
from framekit.run.model import POINTS_SET
from framekit.run.points import PointValue


class ShownRow(NamedTuple):
    """Cells of text; `state`: a word that the page may show as a color."""

    state: str
    cells: tuple[str, ...]


@dataclass(slots=True)
class ChangingRows:
    """A table. `put` begins a new round; every row has the number of the round of its last change."""

    round: int = 0
    keys_round: int = 0
    _rows: dict[str, tuple[int, ShownRow]] = field(default_factory=dict)

    def put(self, rows: Mapping[str, ShownRow]) -> None:
        """Replace the rows by their current state, in this order."""
        self.round += 1
        before = self._rows
        if list(rows) != list(before):
            self.keys_round = self.round
        nothing = (0, None)
        self._rows = {
            key: (seen, row) if (seen := before.get(key, nothing)[0]) and before[key][1] == row else (self.round, row)
            for key, row in rows.items()
        }

    @property
    def keys(self) -> list[str]:
        return list(self._rows)

    def since(self, number: int) -> dict[str, ShownRow]:
        """Return the rows that have changed after a round."""
        return {key: row for key, (seen, row) in self._rows.items() if seen > number}


class ChangingValues:
    """The values of points, numbered from 0 through all groups."""

    def __init__(self, groups: Sequence[RunPoints]) -> None:
        self.round = 0
        self._groups = groups
        self.values: list[PointValue] = []
        self._rounds: list[int] = []

    def look(self) -> None:
        """Begin a new round. A value that was read again without a difference has not changed."""
        self.round = number = self.round + 1
        now = [value for group in self._groups for value in group.now()]
        if len(now) != len(self.values):
            self._rounds = [number] * len(now)
        else:
            rounds = self._rounds
            for at, (value, before) in enumerate(zip(now, self.values, strict=True)):
                if value is not before and _differs(value, before):
                    rounds[at] = number
        self.values = now

    def since(self, number: int) -> Iterator[tuple[int, PointValue, RunPoint]]:
        """Yield the number, value and point of each point that has changed after a round."""
        values = self.values
        points = [point for group in self._groups for point in group.values()]
        return ((at, values[at], points[at]) for at, seen in enumerate(self._rounds) if seen > number)


def _differs(value: PointValue, before: PointValue) -> bool:
    return (value.value, value.quality, value.reason) != (before.value, before.quality, before.reason)


def value_cells(value: PointValue, point: RunPoint) -> list[Any]:
    """Return the cells of a value for the page: text, quality, reason, and the number to draw."""
    number = number_of(value)
    return [point.text_of(value.value), value.quality, value.reason, number if isfinite(number) else None]


def number_of(value: PointValue) -> float:
    """Return the number to draw for a value; nan if it is not good, or not a number."""
    number = value.number
    if value.quality != "good" or not isinstance(number, (int, float)):
        return nan
    try:
        return float(number)
    except OverflowError:
        return nan


MOST_KEPT = 600
MOST_NUMBERS = 2_000_000
"""Limits of the history: moments per point, and numbers in all (8 bytes each)."""


class PointHistory:
    """The latest moments of all points: `size` numbers for each, taken at common times (seconds since 1970)."""

    def __init__(self, points: int) -> None:
        self.size = max(2, min(MOST_KEPT, MOST_NUMBERS // max(1, points)))
        self.taken = 0
        self._times = array("d", bytes(8 * self.size))
        self._numbers = [array("d", bytes(8 * self.size)) for _ in range(points)]

    def take(self, time: float, values: Sequence[PointValue]) -> None:
        """Add a moment; it replaces the oldest if the history is full."""
        at = self.taken % self.size
        self._times[at] = time
        for numbers, value in zip(self._numbers, values, strict=True):
            numbers[at] = number_of(value)
        self.taken += 1

    def last(self, point: int, most: int) -> tuple[list[float], list[float | None]]:
        """Return the latest moments of a point, oldest first: times, and numbers or None."""
        count = min(most, self.taken, self.size)
        places = [at % self.size for at in range(self.taken - count, self.taken)]
        numbers = self._numbers[point]
        return (
            [self._times[at] for at in places],
            [number if isfinite(number := numbers[at]) else None for at in places],
        )


Rows = Mapping[str, ShownRow]
STATES = {"open": "", "closed": "off", "switched off": "off"}
"""The states of healthy channels, with the state that the page shows; all other states count as lost."""


class ShownTable(NamedTuple):
    """A table of the page: its name and the titles of its columns."""

    name: str
    head: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """The content of one page."""

    title: str
    view: LiveView
    tables: tuple[ShownTable, ...]
    rows: Callable[[], Mapping[str, Rows]]
    """Returns the rows of every table by its name."""
    groups: Sequence[tuple[str, RunPoints]]
    """The points in groups, each with the name of the group."""
    control: Callable[[str], None] | None = None
    """Executes a command such as `fire 3`, and raises RequestError; None if the page has no commands."""

    @property
    def log(self) -> FrameLog:
        return self.view.log


def shown_run(run: RunCalls, view: LiveView) -> Shown:
    """Return the content for a run: channels, stations, blocks, jobs, sinks, troubles and points."""

    def load_now(channel: int) -> str:
        line = view.lines.get(channel)
        load = None if line is None else line.load.since_last(run.now)
        return "-" if load is None else percent(load)

    def rows() -> Mapping[str, Rows]:
        status = run.status()
        jobs = () if status.jobs is None else status.jobs.slots
        return {
            "channels": {
                str(one.number): ShownRow(STATES.get(one.state, "lost"), (*channel_row(one), load_now(one.number)))
                for one in status.channels
            },
            "stations": {
                f"{one.channel} {one.station}": ShownRow("lost" if one.dead else "", station_row(one))
                for one in status.stations
            },
            "blocks": {
                one.label: ShownRow(block_state(one), block_row(one)) for one in status.blocks if one.set != POINTS_SET
            },
            "jobs": {str(one.slot): ShownRow("", job_row(one)) for one in jobs if one.kind},
            "sinks": {
                str(number): ShownRow("lost" if one.problem else "", sink_row(one))
                for number, one in enumerate(status.sinks)
            },
            "troubles": {
                one.name: ShownRow("lost" if one.reason else "", trouble_row(one, status.at)) for one in status.troubles
            },
        }

    tables = (
        ShownTable("channels", (*CHANNEL_HEAD, "load now")),
        ShownTable("stations", STATION_HEAD),
        ShownTable("blocks", BLOCK_HEAD),
        ShownTable("jobs", JOB_HEAD),
        ShownTable("sinks", SINK_HEAD),
        ShownTable("troubles", TROUBLE_HEAD),
    )
    groups = [("", run.points)]
    return Shown(
        title=f"run {run.run.name}", view=view, tables=tables, rows=rows, groups=groups, control=run.control
    )  # fmt: skip


def shown_server(server: AsyncServer, view: LiveView) -> Shown:
    """Return the content for devices that answer, with the values of their memory. The server must be open."""
    alone = [device for device in server.devices if not device.shares]

    def rows() -> Mapping[str, Rows]:
        devices = {}
        for number, one in enumerate(server.status(), 1):
            why = ", ".join(f"{count} × {reason}" for reason, count in sorted(one.reasons.items()))
            cells = (one.device.name, one.device.protocol.name, one.device.station or "-")
            devices[str(number)] = ShownRow("", (*cells, str(one.services), str(one.errors), why or "-"))
        errors = {reason: ShownRow("", (reason, str(count))) for reason, count in sorted(server.line_errors.items())}
        return {"devices": devices, "line": errors}

    tables = (
        ShownTable("devices", ("device", "protocol", "station", "services", "errors", "why")),
        ShownTable("line", ("on the line", "count")),
    )
    names = ["" if len(alone) == 1 else device.name for device in alone]
    groups = list(zip(names, server.points, strict=True))
    return Shown(title=f"serve {server.about}", view=view, tables=tables, rows=rows, groups=groups)
