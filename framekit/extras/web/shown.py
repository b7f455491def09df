"""The content of a page for a run or for devices: tables, points, frames, and the available controls.

Rows and point values have the number of the round in which they last changed. Updates are not queued: each query reads
the current state, so that a slow reader gets fewer updates but never an old state.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, NamedTuple

from framekit.api.monitor import FrameLog, LiveView
from framekit.api.points import RunPoint, RunPoints, history_file
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
from framekit.api.run import RunCalls, RunStatus
from framekit.api.server import AsyncServer
from framekit.codec.shown import shown
from framekit.extras.web.cards import Card, DeviceCards, RunCards, in_words
from framekit.extras.web.device_view import DeviceView
from framekit.extras.web.history import StoredHistory, number_of
from framekit.run.model import POINTS_SET
from framekit.run.points import PointValue
from framekit.service.device import DeviceStore


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


POINTS_EVERY = 5
"""Number of rounds after which the descriptions of the points are read again: an edit of the run may change them."""


class ChangingValues:
    """The values of points, numbered from 0 through all groups."""

    def __init__(self, groups: Sequence[RunPoints]) -> None:
        self.round = 0
        self._groups = groups
        self.values: list[PointValue] = []
        self._rounds: list[int] = []
        self._points: list[RunPoint] = []

    def look(self) -> None:
        """Begin a new round. A value that was read again without a difference has not changed."""
        self.round = number = self.round + 1
        if number % POINTS_EVERY == 1:
            self._points = [point for group in self._groups for point in group.values()]
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
        values, points = self.values, self._points
        return ((at, values[at], points[at]) for at, seen in enumerate(self._rounds) if seen > number)


def _differs(value: PointValue, before: PointValue) -> bool:
    return (value.value, value.quality, value.reason) != (before.value, before.quality, before.reason)


def value_cells(value: PointValue, point: RunPoint) -> list[Any]:
    """Return the cells of a value for the page: text, quality, reason, and the number to draw."""
    number = number_of(value)
    return [point.text_of(value.value), value.quality, in_words(value.reason), number if isfinite(number) else None]


Rows = Mapping[str, ShownRow]
STATES = {"open": "", "closed": "off", "switched off": "off"}
"""The states of healthy channels, with the state that the page shows; all other states count as lost."""


class Look(NamedTuple):
    """The content of the page apart from values and frames, at one moment."""

    rows: Mapping[str, Rows]
    """The rows of every table by its name."""
    cards: Sequence[Card]
    troubles: Mapping[str, str] = {}
    """The present troubles as sentences, each with a key that stays the same while it lasts."""


class ShownTable(NamedTuple):
    """A table of the page: its name and the titles of its columns."""

    name: str
    head: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """The content of one page."""

    name: str
    """The name of the page among the others of the same program."""
    title: str
    view: LiveView
    tables: tuple[ShownTable, ...]
    look: Callable[[Sequence[PointValue]], Look]
    """Returns the content at this moment; it gets the values of all points."""
    groups: Sequence[tuple[str, RunPoints]]
    """The points in groups, each with the name of the group."""
    control: Callable[[str], None] | None = None
    """Executes a command such as `fire 3`, and raises RequestError; None if the page has no commands."""
    stored: StoredHistory | None = None
    """Older values; None if the run keeps none."""
    devices: DeviceView | None = None
    """The memory and the faults of simulated devices; None for a run."""
    end: Callable[[], None] = lambda: None
    """Called when the content is no longer shown."""

    @property
    def log(self) -> FrameLog:
        return self.view.log


def shown_run(run: RunCalls, view: LiveView) -> Shown:
    """Return the content for a run: channels, stations, blocks, jobs, sinks, troubles and points."""
    cards = RunCards()

    def loads() -> dict[int, float]:
        found = {number: line.load.since_last(run.now) for number, line in view.lines.items()}
        return {number: load for number, load in found.items() if load is not None}

    def look(values: Sequence[PointValue]) -> Look:
        status, load = run.status(), loads()
        return Look(_rows(status, load), cards.of(status, list(load.items()), values), _troubles(status))

    tables = (
        ShownTable("channels", (*CHANNEL_HEAD, "load now")),
        ShownTable("stations", STATION_HEAD),
        ShownTable("blocks", BLOCK_HEAD),
        ShownTable("jobs", JOB_HEAD),
        ShownTable("sinks", SINK_HEAD),
        ShownTable("troubles", TROUBLE_HEAD),
    )
    file = history_file(run.run)
    return Shown(
        name="Run", title=f"run {run.run.name}", view=view, tables=tables, look=look,
        groups=[("", run.points)], control=run.control, stored=None if file is None else StoredHistory(file),
    )  # fmt: skip


def _rows(status: RunStatus, load: Mapping[int, float]) -> Mapping[str, Rows]:
    """Return the rows of the tables of a run. `load`: the present load of the channels that have a speed."""
    jobs = () if status.jobs is None else status.jobs.slots
    return {
        "channels": {
            str(one.number): ShownRow(
                STATES.get(one.state, "lost"),
                (*channel_row(one), percent(load[one.number]) if one.number in load else "-"),
            )
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


def _troubles(status: RunStatus) -> dict[str, str]:
    """Return the present troubles of a run: those of its parts, and channels and stations that no part reports."""
    found: dict[str, str] = {}
    names: Counter[str] = Counter()
    for one in status.troubles:
        names[one.name] += 1
        found[f"{one.name} {names[one.name]}"] = str(one)
    for line in status.channels:
        name = f"channel {line.number}"
        if STATES.get(line.state, "lost") == "lost" and not _is_reported(name, names):
            found[f"state of {name}"] = f"{name}: {line.state}"
    for station in status.stations:
        if station.dead and not _is_reported(f"channel {station.channel}", names):
            where = f"channel {station.channel}, station {shown(station.station)}"
            found[f"state of {where}"] = f"{where} does not answer"
    return found


def _is_reported(name: str, names: Iterable[str]) -> bool:
    """Return whether a part reports trouble of this channel, or of a station of it."""
    return any(one == name or one.startswith((f"{name},", f"{name} ")) for one in names)


DEVICE_HEAD = ("device", "protocol", "station", "services", "errors", "why")


def shown_server(server: AsyncServer, view: LiveView) -> Shown:
    """Return the content for devices that answer, with the values of their memory. The server must be open."""
    alone = [one for one in server.stores if not one.device.shares]
    named, cards = _named((f"station {one.device.station}", one) for one in alone), DeviceCards()

    def look(values: Sequence[PointValue]) -> Look:
        rows = {str(number): ShownRow("", _device_cells(one)) for number, one in enumerate(server.stores, 1)}
        line = {reason: ShownRow("", (reason, str(count))) for reason, count in sorted(server.line_errors.items())}
        return Look(
            {"devices": rows, "line": line},
            cards.of(len(named), server.about, server.stores, server.line_errors, view.now()),
        )

    tables = (ShownTable("devices", DEVICE_HEAD), ShownTable("line", ("on the line", "count")))
    names = [""] if len(named) == 1 else list(named)
    return Shown(
        name="Devices", title=f"serve {server.about}", view=view, tables=tables, look=look,
        groups=list(zip(names, server.points, strict=True)), devices=DeviceView(named),
    )  # fmt: skip


def shown_devices(run: RunCalls, view: LiveView) -> Shown:
    """Return the content for the simulated devices of a run as they are now, with the values of their memory."""
    simulated, cards = run.simulated, DeviceCards()
    points = run.device_points()
    named = _named((f"channel {number}", store) for number, store in simulated)

    def look(values: Sequence[PointValue]) -> Look:
        rows = {
            str(row): ShownRow("", (str(number), *_device_cells(store)))
            for row, (number, store) in enumerate(simulated, 1)
        }
        about = f"Simulated in the run {run.run.name}"
        return Look({"devices": rows}, cards.of(len(named), about, list(named.values()), {}, view.now()))

    def end() -> None:
        for one in points:
            one.stop()

    names = [""] if len(named) == 1 else list(named)
    return Shown(
        name="Devices", title=f"devices of {run.run.name}", view=view, look=look,
        tables=(ShownTable("devices", ("channel", *DEVICE_HEAD)),),
        groups=list(zip(names, map(run.points_of, points), strict=True)), devices=DeviceView(named), end=end,
    )  # fmt: skip


def _named(places: Iterable[tuple[str, DeviceStore]]) -> dict[str, DeviceStore]:
    """Return devices by name; devices with the same name have their place in it, and the same place a number."""
    found: dict[str, DeviceStore] = {}
    placed = list(places)
    counted = Counter(store.device.name for _, store in placed)
    for number, (place, store) in enumerate(placed, 1):
        name = store.device.name
        name = name if counted[name] == 1 else f"{name}, {place}"
        found[name if name not in found else f"{name}, number {number}"] = store
    return found


def _device_cells(store: DeviceStore) -> tuple[str, ...]:
    """Return the cells of a device: as DEVICE_HEAD."""
    device, counters = store.device, store.counters
    why = ", ".join(f"{count} × {reason}" for reason, count in sorted(counters.reasons(device.protocol).items()))
    cells = (device.name, device.protocol.name, device.station or "-")
    return (*cells, str(counters.done), str(counters.errors), why or "-")
