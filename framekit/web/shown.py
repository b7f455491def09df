"""What a page shows of a run or of devices: the tables, the points, the frames, and what may be done there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from framekit.api.monitor import FrameLog, LiveView
from framekit.api.points import RunPoints
from framekit.api.rows import (
    BLOCK_HEAD,
    CHANNEL_HEAD,
    JOB_HEAD,
    SINK_HEAD,
    STATION_HEAD,
    block_row,
    block_state,
    channel_row,
    job_row,
    percent,
    sink_row,
    station_row,
)
from framekit.api.run import RunCalls
from framekit.api.server import AsyncServer
from framekit.run.model import POINTS_SET
from framekit.web.changes import ShownRow

Rows = Mapping[str, ShownRow]
STATES = {"open": "", "closed": "off", "switched off": "off"}
"""How channels are shown that are as they should be; the state of all others says what is wrong."""


class ShownTable(NamedTuple):
    """A table of the page by its name, with the heads of its columns."""

    name: str
    head: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """What one page shows. `rows` gives those of every table; `groups` are the points, each group with its name.

    `control` carries out a line such as `fire 3`, and raises RequestError; None: there is nothing to be fired.
    """

    title: str
    view: LiveView
    tables: tuple[ShownTable, ...]
    rows: Callable[[], Mapping[str, Rows]]
    groups: Sequence[tuple[str, RunPoints]]
    control: Callable[[str], None] | None = None

    @property
    def log(self) -> FrameLog:
        return self.view.log


def shown_run(run: RunCalls, view: LiveView) -> Shown:
    """A run with its channels, stations, blocks, jobs, sinks and points."""

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
        }

    tables = (
        ShownTable("channels", (*CHANNEL_HEAD, "load now")),
        ShownTable("stations", STATION_HEAD),
        ShownTable("blocks", BLOCK_HEAD),
        ShownTable("jobs", JOB_HEAD),
        ShownTable("sinks", SINK_HEAD),
    )
    groups = [("", run.points)]
    return Shown(
        title=f"run {run.run.name}", view=view, tables=tables, rows=rows, groups=groups, control=run.control
    )  # fmt: skip


def shown_server(server: AsyncServer, view: LiveView) -> Shown:
    """Devices that answer, with the values of their memory. It has been opened."""
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
