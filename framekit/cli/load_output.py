"""How the load of a run's channels is shown: a line for each channel, a table of its blocks, and both as data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from framekit.blocks.feasibility import milliseconds
from framekit.cli.common import table
from framekit.definition.times import format_time

if TYPE_CHECKING:
    from framekit.blocks.feasibility import BlockLoad, ChannelLoad
    from framekit.blocks.model import Block

HEAD = ("block", "what", "starts", "frames", "bytes", "takes", "load", "note")


def load_line(load: ChannelLoad) -> str:
    """`channel 1 (19200 8E1): load 6.9 %, line 4.9 %`."""
    line = "" if load.line is None else f", line {percent(load.line)}"
    settings = "" if load.channel.line is None else f" ({load.channel.line})"
    return f"channel {load.channel.number}{settings}: load {percent(load.busy)}{line}"


def load_table(load: ChannelLoad) -> str:
    """Every block of a channel, with what its exchanges take."""
    return table([_row(one) for one in load.blocks], HEAD)


def load_data(load: ChannelLoad) -> dict[str, Any]:
    """The same for programs; times in seconds, loads from 0 to 1 and more."""
    return {
        "channel": load.channel.number,
        "settings": None if load.channel.line is None else str(load.channel.line),
        "load": round(load.busy, 6),
        "line": None if load.line is None else round(load.line, 6),
        "blocks": [_data(one) for one in load.blocks],
    }


def percent(part: float) -> str:
    return f"{100 * part:.1f} %"


def what_of(block: Block) -> str:
    """`READ M0100, M0110`, `SEND WR.REQ`."""
    from framekit.blocks.jobs.order import Command

    if isinstance(block.job, Command):
        slot = "ALL" if block.job.slot is None else str(block.job.slot)
        order = block.job.order
        return f"{block.instruction.upper()} {slot}" + (f" {order.kind} {order.remote}".rstrip() if order else "")
    return f"{block.instruction.upper()} {block.frame or block.service or ', '.join(block.targets)}"


def _row(one: BlockLoad) -> tuple[str, ...]:
    cost = one.cost
    starts = "as it comes" if one.block.instruction == "receive" else "on demand"
    if one.period:
        starts = f"every {format_time(one.period)}"
    note = cost.doubt
    if one.missed:
        note = "; ".join(filter(None, (f"misses {percent(one.missed)}", note)))
    return (
        one.block.label, what_of(one.block), starts, str(cost.frames), str(cost.bytes),
        milliseconds(cost.duration), percent(one.busy) if one.period else "-", note,
    )  # fmt: skip


def _data(one: BlockLoad) -> dict[str, Any]:
    return {
        "set": one.block.set,
        "block": one.block.number,
        "period": None if one.period is None else one.period / 1e9,
        "frames": one.cost.frames,
        "bytes": one.cost.bytes,
        "takes": one.cost.duration / 1e9,
        "load": round(one.busy, 6),
        "missed": round(one.missed, 6),
        "note": one.cost.doubt,
    }
