"""What `framekit run` shows: frames as they go by, and the blocks with their counters; as text or as JSON lines."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from framekit.cli.common import table, told
from framekit.cli.load_output import percent, what_of
from framekit.cli.main import Failure
from framekit.cli.seen_output import seen_data, seen_text
from framekit.definition.problems import plural
from framekit.memory.memory import unit_bits

if TYPE_CHECKING:
    from framekit.blocks.block_state import BlockState
    from framekit.blocks.feasibility import ChannelLoad
    from framekit.blocks.model import Run
    from framekit.blocks.removed_blocks import RemovedBlocks
    from framekit.blocks.run_edit import Edit
    from framekit.definition.model.segments import Segment
    from framekit.link.observe import Seen
    from framekit.service.run import RunService
    from framekit.transport.clock import Clock

MOST_WORDS = 12


class Output:
    """Watches a run. `service` makes the run's service with this output as its monitor."""

    def __init__(self, run: Run, loads: tuple[ChannelLoad, ...] = ()) -> None:
        self.run = run
        self.loads = loads
        self.began = 0
        self.as_ascii = False
        self.at_work: RunService | None = None

    def service(self, run: Run, clock: Clock) -> RunService:
        """Raises DefinitionError for a wrong device, Failure for a port of no known kind."""
        from framekit.definition.problems import DefinitionError
        from framekit.service.run import RunService

        try:
            self.at_work = RunService(run, clock, self.seen)
        except DefinitionError:
            raise
        except ValueError as error:
            raise Failure(str(error)) from None
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


class TextOutput(Output):
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
        loads = [row for load in self.loads if (row := _load_row(load, service))]
        if loads:
            print("\n" + table(loads, ("channel", "settings", "line load expected", "measured")))
        stored = [line for state in service.states.values() for line in _stored(service, state)]
        if stored:
            print("\n" + table(stored, ("memory", "words")))
        status = [(str(n), name, str(value)) for n, found in _published(service) for name, value in found.items()]
        if status:
            print("\n" + table(status, ("channel", "status", "value")))


class JsonOutput(Output):
    """One JSON object a line: `seen` for what goes by, `block` and `channel` for each of these at the end."""

    def seen(self, channel: int, seen: Seen) -> None:
        from framekit.codec.plain import PlainValues
        from framekit.service.frame_log import result_of

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


def _load_row(load: ChannelLoad, service: RunService) -> tuple[str, ...] | None:
    measured = measured_load(load, service)
    if measured is None or load.line is None:
        return None
    return str(load.channel.number), str(load.channel.line), percent(load.line), percent(measured)
