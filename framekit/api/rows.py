"""How a run is doing at one moment, as rows of text: its channels, blocks, stations, jobs, sinks and points."""

from __future__ import annotations

from typing import TYPE_CHECKING

from framekit.codec.shown import code_text, shown
from framekit.definition.problems import plural
from framekit.definition.times import format_time

if TYPE_CHECKING:
    from framekit.api.points import RunPoints
    from framekit.run.block_state import BlockStatus
    from framekit.run.edit import RemovedBlocks
    from framekit.run.job_table import JobStatus
    from framekit.run.status import ChannelStatus, SinkStatus, StationStatus

SINK_HEAD = ("sink", "to", "taken", "waiting", "dropped", "problem")
CHANNEL_HEAD = (
    "channel", "driver", "station", "line", "mode", "state", "services", "errors", "frames", "bad", "line load", "why",
)  # fmt: skip
JOB_HEAD = ("job", "what", "host", "state", "every", "left", "good", "refused", "late", "broken off", "last")
BLOCK_HEAD = ("set", "block", "what", "channel", "state", "done", "failed", "overruns", "last failure")
STATION_HEAD = ("channel", "station", "state", "blocks", "done", "failed")
POINT_HEAD = ("point", "value", "unit", "quality")


def percent(part: float) -> str:
    return f"{100 * part:.1f} %"


def channel_row(one: ChannelStatus) -> tuple[str, ...]:
    driver = one.driver if one.role is None else f"{one.driver} {one.role}"
    line = f"{one.line} {one.line_type}".strip() or "-"
    why = ", ".join(f"{count} × {reason}" for reason, count in sorted(one.reasons.items()))
    return (
        str(one.number), driver, "-" if one.station is None else str(one.station), line, one.mode, one.state,
        str(one.services), str(one.errors), str(one.frames_in), str(one.bad),
        "-" if one.load is None else percent(one.load), why or "-",
    )  # fmt: skip


def block_state(one: BlockStatus) -> str:
    """One word: off, dead, runs, waits, ready."""
    if not one.enabled:
        return "off"
    if one.running:
        return "runs"
    if one.waiting:
        return "waits"
    return "dead" if one.dead else "ready"


def block_row(one: BlockStatus) -> tuple[str, ...]:
    what = f"{one.instruction} {one.name}".rstrip()
    return (
        str(one.set), str(one.block), what, str(one.channel), block_state(one), str(one.done), str(one.failed),
        str(one.overruns), "-" if one.last_failure is None else str(one.last_failure),
    )  # fmt: skip


def removed_row(one: RemovedBlocks) -> tuple[str, ...]:
    """What is left of blocks that an edit took out."""
    why = ", ".join(f"{count} × {reason}" for reason, count in sorted(one.reasons.items()))
    return (
        "-", "-", plural(one.blocks, "removed block"), str(one.channel), "gone", str(one.done), str(one.failed),
        str(one.overruns), why or "-",
    )  # fmt: skip


def job_row(one: JobStatus) -> tuple[str, ...]:
    """A slot with the job in it, or that was in it last."""
    every = "-" if not one.period else format_time(one.period)
    left = "-" if one.left is None else str(one.left)
    counters = one.counters
    return (
        str(one.slot), f"{one.kind} {one.remote or one.own}", one.host or "-", one.state, every, left,
        str(counters.good), str(counters.refused), str(counters.late + counters.over_period), str(counters.ended),
        f"{code_text(one.word)} {one.text}".rstrip(),
    )  # fmt: skip


def sink_row(one: SinkStatus) -> tuple[str, ...]:
    return one.kind, one.target, str(one.written), str(one.waiting), str(one.dropped), one.problem or "-"


def station_row(one: StationStatus) -> tuple[str, ...]:
    state = "dead" if one.dead else "answers" if one.done else "-"
    return str(one.channel), str(shown(one.station)), state, str(one.blocks), str(one.done), str(one.failed)


def point_rows(points: RunPoints) -> list[tuple[str, ...]]:
    """The points as they are now: value, unit, quality."""
    rows: list[tuple[str, ...]] = []
    for value in points.now():
        shown = "-" if value.value is None else str(value.value)
        quality = value.quality + (f", {value.reason}" if value.reason else "")
        rows.append((value.name, shown, points[value.name].unit, quality))
    return rows
