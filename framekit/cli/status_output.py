"""How the status of a run is shown: tables for people, one object for programs."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from framekit.cli.common import table
from framekit.cli.load_output import percent
from framekit.link.codes import code_text

if TYPE_CHECKING:
    from framekit.blocks.block_status import BlockStatus
    from framekit.blocks.jobs.diagnosis import JobStatus
    from framekit.blocks.removed_blocks import RemovedBlocks
    from framekit.service.status import ChannelStatus, JobsStatus, RunStatus

CHANNEL_HEAD = (
    "channel", "driver", "station", "line", "mode", "state", "services", "errors", "frames", "bad", "line load", "why",
)  # fmt: skip
JOB_HEAD = ("job", "what", "host", "state", "every", "left", "good", "refused", "late", "broken off", "last")
BLOCK_HEAD = ("set", "block", "what", "channel", "state", "done", "failed", "overruns", "last failure")


def status_text(status: RunStatus, began: int) -> str:
    """The channels, the blocks and the jobs; `began`: when the run did, by its clock."""
    parts = [table([channel_row(one) for one in status.channels], CHANNEL_HEAD)] if status.channels else []
    blocks = [block_row(one) for one in status.blocks]
    parts.append(table([*blocks, *(removed_row(one) for one in status.removed)], BLOCK_HEAD))
    if status.jobs is not None:
        parts += jobs_text(status.jobs, began)
    return "\n\n".join(parts)


def jobs_text(jobs: JobsStatus, began: int) -> list[str]:
    """The slots that have had a job, what became of commands, and the log."""
    from framekit.definition.problems import plural

    rows = [job_row(one) for one in jobs.slots if one.kind]
    counters = jobs.counters
    kinds = "".join(f", {number} {kind}" for kind, number in sorted(counters.kinds.items()))
    commands = (
        f"commands: {counters.taken} taken{kinds}; {counters.refused} refused, {counters.lost} lost, "
        f"{plural(counters.faults, 'fault')}"
    )
    events = [f"{(event.at - began) / 1e9:.3f} s {event.what}" for event in jobs.log]
    log = "\n".join([f"events: {jobs.events}" + (f", the last {len(events)}:" if events else ""), *events])
    return [*([table(rows, JOB_HEAD)] if rows else []), commands, log]


def job_row(one: JobStatus) -> tuple[str, ...]:
    """A slot with the job in it, or that was in it last."""
    from framekit.definition.times import format_time

    every = "-" if not one.period else format_time(one.period)
    left = "-" if one.left is None else str(one.left)
    counters = one.counters
    return (
        str(one.slot), f"{one.kind} {one.remote or one.own}", one.host or "-", one.state, every, left,
        str(counters.good), str(counters.refused), str(counters.late + counters.over_period), str(counters.ended),
        f"{code_text(one.word)} {one.text}".rstrip(),
    )  # fmt: skip


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
    from framekit.definition.problems import plural

    why = ", ".join(f"{count} × {reason}" for reason, count in sorted(one.reasons.items()))
    return (
        "-", "-", plural(one.blocks, "removed block"), str(one.channel), "gone", str(one.done), str(one.failed),
        str(one.overruns), why or "-",
    )  # fmt: skip


def status_data(status: RunStatus, began: int) -> dict[str, Any]:
    """The same for programs; times in seconds of the run."""
    blocks = []
    for one in status.blocks:
        block = {name: value for name, value in asdict(one).items() if name not in ("last_failure", "last_end")}
        block |= {"state": block_state(one), "error": one.error}
        block["last_failure"] = None if one.last_failure is None else str(one.last_failure)
        blocks.append(block)
    channels = [_plain(asdict(one)) for one in status.channels]
    time = (status.at - began) / 1e9
    shown = {"event": "status", "time": time, "run": status.run, "channels": channels, "blocks": blocks}
    if status.removed:
        shown["removed"] = [asdict(one) for one in status.removed]
    return shown if status.jobs is None else shown | {"jobs": _jobs_data(status.jobs, began)}


def _jobs_data(jobs: JobsStatus, began: int) -> dict[str, Any]:
    def seconds(at: int | None) -> float | None:
        return None if at is None else (at - began) / 1e9

    slots = []
    for one in (one for one in jobs.slots if one.kind):
        slot = asdict(one)
        slot |= {"period": one.period / 1e9, "last_good": seconds(one.last_good), "last_error": seconds(one.last_error)}
        slots.append(slot)
    log = [
        {"time": seconds(one.at), "event": one.name, "slot": one.slot, "word": one.word, "text": one.what}
        for one in jobs.log
    ]
    return {"slots": slots, "log": log, "events": jobs.events, "commands": asdict(jobs.counters)}


def _plain(channel: dict[str, Any]) -> dict[str, Any]:
    station, load = channel["station"], channel["load"]
    channel["station"] = station.hex(" ").upper() if isinstance(station, bytes) else station
    channel["load"] = None if load is None else round(load, 6)
    return channel
