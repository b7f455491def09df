"""What is printed of a run: what it does, its status, the load of its channels, for people or as JSON."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from framekit.cli.common import VerbError, seen_data, seen_text, table, told
from framekit.codec.shown import code_text
from framekit.definition.problems import plural
from framekit.definition.times import format_time
from framekit.memory.memory import unit_bits
from framekit.run.feasibility import milliseconds

if TYPE_CHECKING:
    from framekit.api.status import ChannelStatus, JobsStatus, RunStatus
    from framekit.definition.model.segments import Segment
    from framekit.link.observe import Seen
    from framekit.run.block_state import BlockState, BlockStatus
    from framekit.run.edit import Edit, RemovedBlocks
    from framekit.run.feasibility import BlockLoad, ChannelLoad
    from framekit.run.job_table import JobStatus
    from framekit.run.model import Block, RunModel
    from framekit.service.run import RunService
    from framekit.transport.clock import Clock


LOAD_HEAD = ("block", "what", "starts", "frames", "bytes", "takes", "load", "note")


def load_line(load: ChannelLoad) -> str:
    """`channel 1 (19200 8E1): load 6.9 %, line 4.9 %`."""
    line = "" if load.line is None else f", line {percent(load.line)}"
    settings = "" if load.channel.line is None else f" ({load.channel.line})"
    return f"channel {load.channel.number}{settings}: load {percent(load.busy)}{line}"


def load_table(load: ChannelLoad) -> str:
    """Every block of a channel, with what its exchanges take."""
    return table([_load_row(one) for one in load.blocks], LOAD_HEAD)


def load_data(load: ChannelLoad) -> dict[str, Any]:
    """The same for programs; times in seconds, loads from 0 to 1 and more."""
    return {
        "channel": load.channel.number,
        "settings": None if load.channel.line is None else str(load.channel.line),
        "load": round(load.busy, 6),
        "line": None if load.line is None else round(load.line, 6),
        "blocks": [_load_data(one) for one in load.blocks],
    }


def percent(part: float) -> str:
    return f"{100 * part:.1f} %"


def what_of(block: Block) -> str:
    """`READ M0100, M0110`, `SEND WR.REQ`."""
    from framekit.run.model import JobCommand

    if isinstance(block.job, JobCommand):
        slot = "ALL" if block.job.slot is None else str(block.job.slot)
        order = block.job.order
        return f"{block.instruction.upper()} {slot}" + (f" {order.kind} {order.remote}".rstrip() if order else "")
    return f"{block.instruction.upper()} {block.frame or block.service or ', '.join(block.targets)}"


def _load_row(one: BlockLoad) -> tuple[str, ...]:
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


def _load_data(one: BlockLoad) -> dict[str, Any]:
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


MOST_WORDS = 12


class RunOutput:
    """Watches a run. `service` makes the run's service with this output as its monitor."""

    def __init__(self, run: RunModel, loads: tuple[ChannelLoad, ...] = ()) -> None:
        self.run = run
        self.loads = loads
        self.began = 0
        self.as_ascii = False
        self.at_work: RunService | None = None

    def service(self, run: RunModel, clock: Clock) -> RunService:
        """Raises DefinitionError for a wrong device, VerbError for a port of no known kind."""
        from framekit.definition.problems import DefinitionError
        from framekit.service.run import RunService

        try:
            self.at_work = RunService(run, clock, self.seen)
        except DefinitionError:
            raise
        except ValueError as error:
            raise VerbError(str(error)) from None
        self.began = clock.now()  # not before devices and protocols are there, which takes its time
        return self.at_work

    def seconds(self, time: int) -> float:
        return (time - self.began) / 1e9

    def warning(self, text: str) -> None:
        print(text, file=sys.stderr)

    def seen(self, channel: int, seen: Seen) -> None:
        raise NotImplementedError

    def edited(self, edit: Edit) -> None:
        """An edited run is at work; what was worked out for channels that are others now is forgotten."""
        self.run = edit.run
        self.loads = tuple(load for load in self.loads if load.channel.number not in edit.touched)
        for warning in edit.warnings:
            self.warning(told(warning))

    def refused(self, reasons: list[str]) -> None:
        """An edited run cannot be; the one before goes on."""
        for reason in reasons:
            self.warning(reason)

    def summary(self, service: RunService) -> None:
        raise NotImplementedError


class TextOutput(RunOutput):
    """A line for everything seen, and a table at the end."""

    def seen(self, channel: int, seen: Seen) -> None:
        print(seen_text(seen, self.seconds(seen.at), f"ch {channel}", self.as_ascii), flush=True)

    def edited(self, edit: Edit) -> None:
        super().edited(edit)
        print(f"edit applied: {edit}", flush=True)

    def refused(self, reasons: list[str]) -> None:
        super().refused(reasons)
        print("edit refused, the run goes on as before", flush=True)

    def summary(self, service: RunService) -> None:
        rows = [_row(state) for state in service.states.values()]
        rows += [_removed_row(one) for one in service.removed]
        print()
        print(table(rows, ("block", "what", "started", "done", "failed", "running", "overruns", "last")))
        loads = [row for load in self.loads if (row := _measured_row(load, service))]
        if loads:
            print("\n" + table(loads, ("channel", "settings", "line load expected", "measured")))
        stored = [line for state in service.states.values() for line in _stored(service, state)]
        if stored:
            print("\n" + table(stored, ("memory", "words")))
        status = [(str(n), name, str(value)) for n, found in _published(service) for name, value in found.items()]
        if status:
            print("\n" + table(status, ("channel", "status", "value")))


class JsonOutput(RunOutput):
    """One JSON object a line: `seen` for what goes by, `block` and `channel` for each of these at the end."""

    def seen(self, channel: int, seen: Seen) -> None:
        from framekit.api.monitor import result_of
        from framekit.codec.plain import PlainValues

        assert self.at_work is not None
        model = self.at_work.channels[channel].channel
        result = result_of(model.protocol, seen, model.role)
        line = seen_data(seen, self.seconds(seen.at), PlainValues(model.protocol), channel=channel, result=result)
        print(json.dumps(line, ensure_ascii=False), flush=True)

    def edited(self, edit: Edit) -> None:
        super().edited(edit)
        print(json.dumps({"event": "edited", "what": str(edit)}, ensure_ascii=False), flush=True)

    def refused(self, reasons: list[str]) -> None:
        print(json.dumps({"event": "refused", "reasons": reasons}, ensure_ascii=False), flush=True)

    def summary(self, service: RunService) -> None:
        for state in service.states.values():
            counters = state.counters
            line = {
                "event": "block",
                "set": state.block.set,
                "block": state.block.number,
                "name": state.block.name,
                "instruction": state.block.instruction,
                "channel": state.block.channel,
                "started": counters.started,
                "done": counters.done,
                "failed": counters.failed,
                "running": counters.running,
                "overruns": counters.overruns,
                "dead": state.dead,
                "last": state.last_outcome,
            }
            print(json.dumps(line, ensure_ascii=False), flush=True)
        for one in service.removed:
            print(json.dumps({"event": "removed", **asdict(one)}, ensure_ascii=False), flush=True)
        for number, found in _published(service):
            if found:
                line = {"event": "status", "channel": number, "status": found}
                print(json.dumps(line, ensure_ascii=False, default=str), flush=True)
        for load in self.loads:
            measured = measured_load(load, service)
            line = {
                "event": "channel",
                "channel": load.channel.number,
                "line_expected": None if load.line is None else round(load.line, 6),
                "line_measured": None if measured is None else round(measured, 6),
            }
            print(json.dumps(line), flush=True)

    def warning(self, text: str) -> None:
        print(json.dumps({"event": "warning", "reason": text}, ensure_ascii=False), flush=True)


def _stored(service: RunService, state: BlockState) -> list[tuple[str, str]]:
    """The words that a block has put into the memory, as many as are easily read."""
    block = state.block
    if (block.instruction not in ("read", "receive") and not block.results) or not state.counters.done:
        return []
    sizes = {part.name: getattr(part, "size", None) for part in _segments(service, state)}
    places = [(place, block.count * unit_bits(block.unit or place.address.unit)) for place in block.places]
    for name, place in block.data.items():
        size = sizes.get(name)
        places.append((place, 8 * size if isinstance(size, int) else place.address.unit_bits))
    places += [(result.place, result.bits) for result in block.results]
    found = []
    for place, bits in places:
        area = service.memory.area(place.address.area)
        first = place.address.first_bit // 16
        there = -(-area.size_bits // 8) - 2 * first  # the last word may be half a word
        data = area.read_bytes(2 * first, min(2 * max(1, bits // 16), 2 * MOST_WORDS, there))
        words = (data[at : at + 2] for at in range(0, len(data), 2))
        found.append((place.text, " ".join(f"{int.from_bytes(word, 'little'):04X}" for word in words)))
    return found


def _published(service: RunService) -> list[tuple[int, dict[str, Any]]]:
    """What the protocol of each channel publishes."""
    return [(number, channel.engine.status()) for number, channel in service.channels.items()]


def _segments(service: RunService, state: BlockState) -> tuple[Segment, ...]:
    """The segments of the frame that a RECEIVE block takes."""
    frames = service.channels[state.block.channel].channel.protocol.frames
    return frames[state.block.frame].segments if state.block.frame else ()


def _row(state: BlockState) -> tuple[str, ...]:
    block, counters = state.block, state.counters
    numbers = (counters.started, counters.done, counters.failed, counters.running, counters.overruns)
    last = state.last_outcome or "-"
    return (block.label, what_of(block), *map(str, numbers), f"{last}, station is dead" if state.dead else last)


def _removed_row(one: RemovedBlocks) -> tuple[str, ...]:
    numbers = (one.started, one.done, one.failed, 0, one.overruns)
    return ("-", f"{plural(one.blocks, 'removed block')} of channel {one.channel}", *map(str, numbers), "-")


def measured_load(load: ChannelLoad, service: RunService) -> float | None:
    """The part of the time so far that a channel's line carried bytes; None where there is no line speed."""
    return service.channels[load.channel.number].driver.load.share(service.clock.now())


def _measured_row(load: ChannelLoad, service: RunService) -> tuple[str, ...] | None:
    measured = measured_load(load, service)
    if measured is None or load.line is None:
        return None
    return str(load.channel.number), str(load.channel.line), percent(load.line), percent(measured)
