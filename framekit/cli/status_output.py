"""How the status of a run is shown: tables for people, one object for programs."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from framekit.cli.common import table
from framekit.cli.load_output import percent

if TYPE_CHECKING:
    from framekit.blocks.block_status import BlockStatus
    from framekit.service.status import ChannelStatus, RunStatus

CHANNEL_HEAD = (
    "channel", "driver", "station", "line", "mode", "state", "services", "errors", "frames", "bad", "line load", "why",
)  # fmt: skip
BLOCK_HEAD = ("set", "block", "what", "channel", "state", "done", "failed", "overruns", "last failure")


def status_text(status: RunStatus) -> str:
    """The channels and the blocks."""
    channels = table([channel_row(one) for one in status.channels], CHANNEL_HEAD)
    return channels + "\n\n" + table([block_row(one) for one in status.blocks], BLOCK_HEAD)


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


def status_data(status: RunStatus, seconds: float) -> dict[str, Any]:
    """The same for programs; times in seconds of the run."""
    blocks = []
    for one in status.blocks:
        block = {name: value for name, value in asdict(one).items() if name not in ("last_failure", "last_end")}
        block |= {"state": block_state(one), "error": one.error}
        block["last_failure"] = None if one.last_failure is None else str(one.last_failure)
        blocks.append(block)
    channels = [_plain(asdict(one)) for one in status.channels]
    return {"event": "status", "time": seconds, "run": status.run, "channels": channels, "blocks": blocks}


def _plain(channel: dict[str, Any]) -> dict[str, Any]:
    station, load = channel["station"], channel["load"]
    channel["station"] = station.hex(" ").upper() if isinstance(station, bytes) else station
    channel["load"] = None if load is None else round(load, 6)
    return channel
