"""Output of a run, for people or as JSON: its events, its status, the load of its channels."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, replace
from functools import cached_property
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from framekit.api.rows import (
    BLOCK_HEAD,
    CHANNEL_HEAD,
    JOB_HEAD,
    POINT_HEAD,
    SINK_HEAD,
    TROUBLE_HEAD,
    block_row,
    block_state,
    channel_row,
    job_row,
    percent,
    point_rows,
    removed_row,
    shown_bytes,
    shown_hex,
    sink_row,
    trouble_row,
)
from framekit.cli.common import (
    ARROWS,
    OUTPUT,
    json_line,
    plain,
    print_trouble,
    seen_data,
    seen_text,
    table,
    tables,
    told,
)
from framekit.cli.run_values import Change, ValueChanges, ValueTable, draws
from framekit.codec.shown import shown
from framekit.definition.problems import plural
from framekit.definition.times import format_time, milliseconds

if TYPE_CHECKING:
    from framekit import BlockStatus, Seen
    from framekit.api.check import BlockLoad, ChannelLoad
    from framekit.api.run import (
        Block,
        Channel,
        Edit,
        JobsStatus,
        Record,
        RemovedBlocks,
        RunCalls,
        RunModel,
        RunStatus,
        Trouble,
        TroubleReport,
    )
    from framekit.cli.live_output import LiveOutput
    from framekit.codec.contents import Requests


LOAD_HEAD = ("block", "what", "starts", "frames", "bytes", "takes", "load", "note")


def load_line(load: ChannelLoad) -> str:
    """Return a line such as `channel 1 (19200 8E1): load 6.9 %, line 4.9 %`."""
    line = "" if load.line is None else f", line {percent(load.line)}"
    settings = "" if load.channel.line is None else f" ({load.channel.line})"
    return f"channel {load.channel.number}{settings}: load {percent(load.busy)}{line}"


def load_table(load: ChannelLoad) -> str:
    """Return a table of the blocks of a channel with the cost of their exchanges."""
    return table([_load_row(one) for one in load.blocks], LOAD_HEAD)


def load_data(load: ChannelLoad) -> dict[str, Any]:
    """Return the load for JSON output; times in seconds, loads as shares (above 1: overloaded)."""
    return {
        "channel": load.channel.number,
        "settings": None if load.channel.line is None else str(load.channel.line),
        "load": round(load.busy, 6),
        "line": None if load.line is None else round(load.line, 6),
        "blocks": [_load_data(one) for one in load.blocks],
    }


def _load_row(one: BlockLoad) -> tuple[str, ...]:
    cost = one.cost
    starts = "as it comes" if one.block.instruction == "receive" else "on demand"
    if one.period:
        starts = f"every {format_time(one.period)}"
    note = cost.doubt
    if one.missed:
        note = "; ".join(filter(None, (f"misses {percent(one.missed)}", note)))
    return (
        one.block.label, one.block.what, starts, str(cost.frames), str(cost.bytes),
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


def status_text(status: RunStatus, began: int) -> str:
    """Return tables of the channels, the blocks and the jobs; `began`: start of the run, by its clock."""
    parts = [table([channel_row(one) for one in status.channels], CHANNEL_HEAD)] if status.channels else []
    blocks = [block_row(one) for one in status.blocks]
    parts.append(table([*blocks, *(removed_row(one) for one in status.removed)], BLOCK_HEAD))
    if status.sinks:
        parts.append(table([sink_row(one) for one in status.sinks], SINK_HEAD))
    if status.troubles:
        parts.append(table([trouble_row(one, status.at) for one in status.troubles], TROUBLE_HEAD))
    if status.jobs is not None:
        parts += jobs_text(status.jobs, began)
    return "\n\n".join(parts)


def jobs_text(jobs: JobsStatus, began: int) -> list[str]:
    """Return the slots that have had a job, the counters of commands, and the log."""
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


def status_data(status: RunStatus, began: int) -> dict[str, Any]:
    """Return the status for JSON output; times in seconds of the run."""
    blocks = []
    for one in status.blocks:
        block = {name: value for name, value in asdict(one).items() if name not in ("last_failure", "last_end")}
        block |= {"state": block_state(one), "error": one.error}
        block["last_failure"] = None if one.last_failure is None else str(one.last_failure)
        blocks.append(block)
    channels = [_plain(asdict(one)) for one in status.channels]
    time = (status.at - began) / 1e9
    shown = {"event": "status", "time": time, "run": status.run, "channels": channels, "blocks": blocks}
    if status.sinks:
        shown["sinks"] = [asdict(one) for one in status.sinks]
    if status.troubles:
        shown["troubles"] = [trouble_data(one) | {"since": (one.since - began) / 1e9} for one in status.troubles]
    if status.removed:
        shown["removed"] = [removed_data(one) for one in status.removed]
    return shown if status.jobs is None else shown | {"jobs": _jobs_data(status.jobs, began)}


def trouble_data(trouble: Trouble) -> dict[str, Any]:
    """Return a trouble for JSON output; `reason` is empty when the part works again."""
    return {
        "name": trouble.name, "reason": trouble.reason, "waiting": trouble.waiting, "lost": trouble.lost,
        "points": dict(trouble.points),
    }  # fmt: skip


def removed_data(gone: RemovedBlocks) -> dict[str, Any]:
    """Return the counters of removed blocks."""
    return asdict(replace(gone, reasons=Counter())) | {"reasons": dict(gone.reasons)}


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
    load = channel["load"]
    channel["station"] = plain(channel["station"])
    channel["load"] = None if load is None else round(load, 6)
    return channel


SOON = 20_000_000
"""Longest delay (ns) of the output of an event; all events until then are printed together."""


FRAMES = ("frame", "bad", "noise", "not_taken", "break")
"""Kinds of events that only `--frames` shows."""


GOES_ON = "the run goes on as before"


class RunOutput:
    """Watches a run, which is `at_work` once it has been made with this output as its monitor.

    `with_frames`: show frames and damaged bytes. `quiet`: show troubles only.
    """

    def __init__(
        self, run: RunModel, loads: tuple[ChannelLoad, ...] = (), *, with_frames: bool = False, quiet: bool = False
    ) -> None:
        self.run = run
        self.loads = loads
        self.with_frames, self.quiet = with_frames, quiet
        self.as_ascii = False
        self.live: LiveOutput | None = None
        """The output of a run in real time; on a terminal it shows the table of the points."""
        self._values: ValueChanges | None = None
        self.at_work: RunCalls | None = None
        from framekit.api.run import Tape

        self.tape = Tape(self._begins)
        """The monitor of the run."""
        self._channels: dict[int, Channel] = {}
        """Channels of the records of the tape."""

    def seconds(self, time: int) -> float:
        return (time - self.at_work.began) / 1e9 if self.at_work is not None else 0.0

    def warning(self, text: str) -> None:
        print(text, file=sys.stderr)

    @property
    def run_at_work(self) -> RunCalls:
        assert self.at_work is not None
        return self.at_work

    def watches(self, run: RunCalls) -> None:
        """Print the events of this run, which has been made and not begun."""
        self.at_work = run
        if not self.quiet:
            self._values = ValueChanges(run, self.described, self._begins)
        self._channels = {number: run.channel(number) for number in run.lines()}
        run.on_channel = self._is_other
        run.watch_troubles(self.trouble)
        if self.tape.records:
            self._begins()

    def _is_other(self, number: int) -> None:
        """Print the records of a channel before another takes its number."""
        self.catch_up()
        self._channels[number] = self.run_at_work.channel(number)

    def trouble(self, report: TroubleReport) -> None:
        """Print a trouble at once, as a whole line; any thread."""
        print_trouble(report)

    def _begins(self) -> None:
        """Print the records soon."""
        if self.at_work is not None:
            self.at_work.later(SOON, self.catch_up)

    def catch_up(self) -> None:
        """Print everything that was seen and is not printed yet."""
        records = self.tape.take()
        if not self.with_frames:
            records = [
                record
                for record in records
                if len(record) == 2 and record[1].kind not in FRAMES and self.is_news(record[0], record[1])
            ]
        lines = list(self.lines(records)) if records else []
        if self._values is not None and (changes := self._values.take()):
            timed = [*zip(map(_time_of, records), lines, strict=True), *self.value_lines(self._values, changes)]
            lines = [line for _, line in sorted(timed, key=itemgetter(0))]
        if lines:
            put("\n".join([*lines, ""]))

    def is_news(self, channel: int, seen: Seen) -> bool:
        """Return whether an event is shown in an output without frames."""
        return True

    def lines(self, records: list[Record]) -> Iterable[str]:
        """Return a line for each record."""
        raise NotImplementedError

    def value_lines(self, values: ValueChanges, changes: list[Change]) -> Iterable[tuple[int, str]]:
        """Return time and line of the changes of values."""
        raise NotImplementedError

    def edited(self, edit: Edit) -> None:
        """Take over an edited run; forget the loads of the channels that the edit has touched."""
        self.catch_up()
        self.run = edit.run
        if self._values is not None:
            self._values.know(edit.run)
        self.loads = tuple(load for load in self.loads if load.channel.number not in edit.touched)
        for warning in edit.warnings:
            self.warning(told(warning))

    def refused(self, reasons: list[str]) -> None:
        """Print why an edited run cannot be applied; the previous run continues."""
        self.catch_up()
        for reason in reasons:
            self.warning(reason)

    def blocks(self, status: RunStatus) -> list[tuple[Block, BlockStatus, str]]:
        """Return the blocks with their status and the last failure of each, '' if it ended well."""
        models = {block.id: block for block in self.run.blocks}
        found = []
        for one in status.blocks:
            failure = one.last_failure
            found.append((models[one.id], one, "" if failure is None or failure.at != one.last_end else str(failure)))
        return found

    def described(self, block: Block) -> str:
        """Return the text of a block, with the points that it reads and, if its channel has several, the station."""
        from framekit.api.run import POINTS_SET

        text = f"{block.what} ({block.name})" if block.set == POINTS_SET else block.what
        stations = {_station_of(other) for other in self.run.blocks if other.channel == block.channel} - {None}
        station = _station_of(block)
        return text if station is None or len(stations) < 2 else f"{text}, station {station}"

    def summary(self, run: RunCalls) -> None:
        raise NotImplementedError


def _station_of(block: Block) -> str | None:
    """Return the station of a block as text, the place in memory that names it, or None."""
    if block.station_from is not None:
        return f"in {block.station_from.text}"
    return None if block.station is None or block.job is not None else str(shown(block.station))


def _time_of(record: Record) -> int:
    time: int = record[1].at if len(record) == 2 else record[2]
    return time


def put(text: str) -> None:
    """Print whole lines at once."""
    sys.stdout.write(text)
    sys.stdout.flush()


class TextOutput(RunOutput):
    """A line for each change of a value, or a table of the values on a terminal; the counters at the end."""

    def __init__(
        self, run: RunModel, loads: tuple[ChannelLoad, ...] = (), *, with_frames: bool = False, quiet: bool = False
    ) -> None:
        super().__init__(run, loads, with_frames=with_frames, quiet=quiet)
        self._states: dict[int, tuple[str, str]] = {}
        """Whether the port of each channel is open, and why it is not."""

    def watches(self, run: RunCalls) -> None:
        super().watches(run)
        live, values = self.live, self._values
        self._has_table = False
        if live is not None and values is not None and not self.with_frames and len(run.points) and draws(live.output):
            self._has_table = True
            ValueTable(run, values, live.output)

    def value_lines(self, values: ValueChanges, changes: list[Change]) -> Iterable[tuple[int, str]]:
        return () if self._has_table else values.lines(changes)

    def is_news(self, channel: int, seen: Seen) -> bool:
        """Return False for another failure to open the port of a channel, for the same reason."""
        if seen.kind not in ("open", "closed"):
            return True
        before = self._states.get(channel)
        self._states[channel] = seen.kind, seen.reason
        return seen.kind == "open" or before != self._states[channel]

    def lines(self, records: list[Record]) -> Iterable[str]:
        began, as_ascii = self.run_at_work.began, self.as_ascii
        found: list[str] = []
        for record in records:
            if len(record) == 2:
                channel, seen = record
                found.append(seen_text(seen, (seen.at - began) / 1e9, f"ch {channel}", as_ascii))
            else:
                channel, direction, at, raw, frame, _, _, _ = record
                shown = shown_bytes(raw, True) if as_ascii else shown_hex(raw)
                found.append(
                    f"{(at - began) / 1e9:10.3f}  ch {channel} {ARROWS[direction]} {frame:<22}{len(raw):4d} {shown}"
                )
        return found

    def edited(self, edit: Edit) -> None:
        super().edited(edit)
        print(f"edit applied: {edit}", flush=True)

    def refused(self, reasons: list[str]) -> None:
        super().refused(reasons)
        self.warning(f"edit refused – {GOES_ON}")

    def summary(self, run: RunCalls) -> None:
        self.catch_up()
        if self.quiet:
            return
        status = run.status()
        rows = []
        for block, one, last in self.blocks(status):
            last = last or "-"
            counts = (one.started, one.done, one.failed, int(one.running), one.overruns)
            last = f"{last}, station is dead" if one.dead else last
            rows.append((block.label, self.described(block), *map(str, counts), last))
        for gone in status.removed:
            what = f"{plural(gone.blocks, 'removed block')} of channel {gone.channel}"
            rows.append(("-", what, *map(str, (gone.started, gone.done, gone.failed, 0, gone.overruns)), "-"))
        print()
        print(table(rows, ("block", "what", "started", "done", "failed", "running", "overruns", "last")))
        measured = {channel.number: channel.load for channel in status.channels}
        loads = [
            (str(load.channel.number), str(load.channel.line), percent(load.line), percent(part))
            for load in self.loads
            if load.line is not None and (part := measured[load.channel.number]) is not None
        ]
        published = [(str(n), name, str(value)) for n, some in run.published().items() for name, value in some.items()]
        more = tables(
            (loads, ("channel", "settings", "line load expected", "measured")),
            (point_rows(run.points), POINT_HEAD),
            (run.stored(), ("memory", "words")),
            (published, ("channel", "status", "value")),
        )
        print(more, end="")


class JsonOutput(RunOutput):
    """Print one JSON object a line: values and events, then `block`, `point` and `channel` objects at the end."""

    @cached_property
    def _requests(self) -> Requests:
        from framekit.codec.contents import Requests

        return Requests()

    def value_lines(self, values: ValueChanges, changes: list[Change]) -> Iterable[tuple[int, str]]:
        return values.json_lines(changes)

    def lines(self, records: list[Record]) -> Iterable[str]:
        from framekit.api.monitor import result_of
        from framekit.api.run import seen_of
        from framekit.codec.contents import contents_of

        for record in records:
            number, seen = record[0], seen_of(record)
            channel = self._channels[number]
            result, contents = result_of(channel.protocol, seen, channel.role), contents_of(channel.protocol)
            self._requests.attach(contents, seen, number)
            line = seen_data(seen, self.seconds(seen.at), contents, channel=number, result=result)
            yield json_line(line)

    def edited(self, edit: Edit) -> None:
        super().edited(edit)
        self.data(event="edited", what=str(edit))

    def refused(self, reasons: list[str]) -> None:
        self.data(event="refused", reasons=reasons)

    def data(self, **line: Any) -> None:
        self.catch_up()
        print(json_line(line, default=str), flush=True)

    def summary(self, run: RunCalls) -> None:
        self.catch_up()
        if self.quiet:
            return
        status = run.status()
        for block, one, last in self.blocks(status):
            self.data(
                event="block", set=block.set, block=block.number, name=block.name, instruction=block.instruction,
                channel=block.channel, station=plain(block.station), started=one.started, done=one.done,
                failed=one.failed, running=int(one.running), overruns=one.overruns, dead=one.dead, last=last,
            )  # fmt: skip
        for gone in status.removed:
            self.data(event="removed", **removed_data(gone))
        for value in run.points.now():
            self.data(
                event="point", point=value.name, value=value.value, unit=run.points[value.name].unit,
                quality=value.quality, reason=value.reason, time=value.text_time,
            )  # fmt: skip
        for number, found in run.published().items():
            if found:
                self.data(event="status", channel=number, status=found)
        measured = {channel.number: channel.load for channel in status.channels}
        for load in self.loads:
            part, line = measured[load.channel.number], load.line
            self.data(
                event="channel", channel=load.channel.number, line_expected=None if line is None else round(line, 6),
                line_measured=None if part is None else round(part, 6),
            )  # fmt: skip

    def trouble(self, report: TroubleReport) -> None:
        found = report.trouble
        if found.name == OUTPUT:
            print_trouble(report)
        line = {"event": "run_trouble", "time": self.seconds(report.at), "what": report.event, "text": report.text}
        sys.stdout.write(f"{json_line(line | trouble_data(found))}\n")
        sys.stdout.flush()

    def warning(self, text: str) -> None:
        self.data(event="warning", reason=text)
