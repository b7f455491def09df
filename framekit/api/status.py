"""The status of a run as one value; how a run is controlled from outside, by words and by changes of its file."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.api.monitor import USER_DEFINED
from framekit.definition.problems import DefinitionError
from framekit.memory.memory import unit_bits
from framekit.run.block_state import BlockState, BlockStatus
from framekit.run.edit import RemovedBlocks as RemovedBlocks
from framekit.run.job_table import Event, TableCounters
from framekit.run.job_table import JobStatus as JobStatus
from framekit.run.model import BLOCKS_IN_SET, OwnPlace, RunModel
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService

if TYPE_CHECKING:
    from framekit.definition.times import LineSettings
    from framekit.run.job_table import JobTable
    from framekit.service.channel import ChannelService


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelStatus:
    """A channel: what it is (module information), and what it has done (service status).

    `driver`: protocol and role, or user-defined; `line`: speed and format, '' on connections; `line_type`:
    kind of interface and half duplex, '' where nothing is said of it; `mode`: run or stop;
    `state`: open, or why not. `services` and `errors` count exchanges that ended, of blocks and of jobs, and requests
    that were served here; `reasons` the errors by outcome.
    `frames_in` are good frames by themselves, `bad` and `noise_bytes` what was none. `load`: the part of the time that
    the line was busy, None without a speed.
    """

    number: int
    port: str
    driver: str
    role: str | None
    station: Any
    line: str
    line_type: str
    mode: str
    state: str
    blocks: int
    services: int
    errors: int
    reasons: Mapping[str, int]
    frames_in: int
    bad: int
    noise_bytes: int
    bytes_in: int
    bytes_out: int
    load: float | None
    reopenings: int


@dataclass(frozen=True, slots=True, kw_only=True)
class JobsStatus:
    """The jobs of a run: their slots, the last events, oldest first, of `events` there were, and counted commands."""

    slots: tuple[JobStatus, ...]
    log: tuple[Event, ...]
    events: int
    counters: TableCounters


@dataclass(frozen=True, slots=True, kw_only=True)
class RunStatus:
    """Everything at one moment; `at` is in nanoseconds of the run's clock. `jobs`: None where the run has none.

    `removed`: what blocks counted that edits took out; the channels' totals have it too.
    """

    run: str
    at: int
    running: bool
    channels: tuple[ChannelStatus, ...]
    blocks: tuple[BlockStatus, ...]
    jobs: JobsStatus | None = None
    removed: tuple[RemovedBlocks, ...] = ()


def run_status(service: RunService) -> RunStatus:
    """How a run and its channels and blocks are doing now."""
    now = service.clock.now()
    return RunStatus(
        run=service.run.name,
        at=now,
        running=service.running,
        channels=tuple(_channel_status(service, channel, now) for channel in service.channels.values()),
        blocks=tuple(service.status()),
        jobs=None if service.jobs is None else _jobs_status(service.jobs.table),
        removed=tuple(replace(one, reasons=one.reasons.copy()) for one in service.removed),
    )


def _jobs_status(table: JobTable) -> JobsStatus:
    counters = replace(table.counters, kinds=dict(table.counters.kinds))
    return JobsStatus(slots=tuple(table.status()), log=tuple(table.log), events=table.log.total, counters=counters)


def _channel_status(service: RunService, at_work: ChannelService, now: int) -> ChannelStatus:
    channel, counters, load = at_work.channel, at_work.engine.counters, at_work.driver.load
    states = [state for state in service.states.values() if state.block.channel == channel.number]
    removed = service.removed.of(channel.number)
    reasons = removed.reasons.copy()
    for state in states:
        reasons.update(state.reasons)
    protocol = channel.protocol
    beside = at_work.counters.reasons(protocol)
    reasons.update(beside)
    return ChannelStatus(
        number=channel.number,
        port=channel.port,
        driver=USER_DEFINED if protocol.frames_alone else protocol.name,
        role=channel.role,
        station=channel.own,
        line="" if channel.line is None else str(channel.line),
        line_type=line_type(channel.wiring),
        mode="run" if service.running else "stop",
        state=at_work.state,
        blocks=len(states),
        services=removed.done + sum(state.counters.done for state in states) + at_work.counters.services,
        errors=removed.failed + sum(state.counters.failed for state in states) + beside.total(),
        reasons=dict(reasons),
        frames_in=counters.received,
        bad=counters.bad,
        noise_bytes=counters.noise_bytes,
        bytes_in=load.bytes_in,
        bytes_out=load.bytes_out,
        load=load.share(now),
        reopenings=at_work.driver.reopenings,
    )


MOST_WORDS = 12
"""So many words of a place are read."""


def stored_words(service: RunService) -> list[tuple[str, str]]:
    """The places that blocks have put something into, and the words that stand there, as many as are easily read."""
    found = []
    for state in service.states.values():
        for place, bits in _stored_by(service, state) if state.counters.done else ():
            area = service.memory.area(place.address.area)
            first = place.address.first_bit // 16
            there = -(-area.size_bits // 8) - 2 * first  # the last word may be half a word
            data = area.read_bytes(2 * first, min(2 * max(1, bits // 16), 2 * MOST_WORDS, there))
            words = (data[at : at + 2] for at in range(0, len(data), 2))
            found.append((place.text, " ".join(f"{int.from_bytes(word, 'little'):04X}" for word in words)))
    return found


def _stored_by(service: RunService, state: BlockState) -> list[tuple[OwnPlace, int]]:
    """Where a block puts what it brings, and how many bits that are."""
    block = state.block
    if block.instruction not in ("read", "receive") and not block.results:
        return []
    frames = service.channels[block.channel].channel.protocol.frames
    segments = frames[block.frame].segments if block.frame else ()
    sizes = {part.name: getattr(part, "size", None) for part in segments}
    places = [(place, block.count * unit_bits(block.unit or place.address.unit)) for place in block.places]
    for name, place in block.data.items():
        size = sizes.get(name)
        places.append((place, 8 * size if isinstance(size, int) else place.address.unit_bits))
    return [*places, *((result.place, result.bits) for result in block.results)]


def line_type(wiring: LineSettings) -> str:
    """What is said of the wiring, in words; '' for a plain port."""
    kind = {"rs232": "RS-232", "rs422": "RS-422", "rs485": "RS-485"}.get(wiring.type or "", "")
    return f"{kind} half duplex".lstrip() if wiring.half_duplex else kind


COMMANDS = "fire N, enable N, disable N (a block, SET.BLOCK, set N or channel N), reset or stop"

_BLOCK = re.compile(r"(fire|enable|disable)\s+(?:block\s+)?(?:([0-9]+)\.)?([0-9]+)")
_WHOLE = re.compile(r"(enable|disable)\s+(set|channel)\s+([0-9]+)")


class ControlError(ValueError):
    """A line that cannot be carried out; a sentence with what to do."""


def carry_out(service: RunService, line: str) -> None:
    """Carries one line out; empty ones and those that begin with # do nothing. Raises ControlError."""
    words = line.split("#")[0].strip().lower()
    if not words:
        return
    if words == "reset":
        service.reset()
        return
    whole = _WHOLE.fullmatch(words)
    if whole is not None:
        _switch(service, whole[2], int(whole[3]), whole[1] == "enable")
        return
    match = _BLOCK.fullmatch(words)
    if match is None:
        raise ControlError(f"'{words}' is no command – write {COMMANDS}")
    verb, set_number, block = match[1], int("1" if match[2] is None else match[2]), int(match[3])
    number = BLOCKS_IN_SET * (set_number - 1) + block
    if block >= BLOCKS_IN_SET or number not in service.states:
        known = ", ".join(_name(one) for one in sorted(service.states))
        raise ControlError(f"there is no block {words.split()[-1]} – known: {known}")
    if verb == "fire":
        try:
            service.fire(number)
        except ValueError as error:
            raise ControlError(str(error)) from None
    else:
        service.enable(number, verb == "enable")


def _switch(service: RunService, what: str, number: int, on: bool) -> None:
    """A set or a channel on or off. Raises ControlError for one there is not."""
    known = service.run.sets if what == "set" else service.channels
    if number not in known:
        raise ControlError(f"there is no {what} {number} – known: {', '.join(map(str, sorted(known)))}")
    if what == "set":
        service.enable_set(number, on)
    else:
        service.enable_channel(number, on)


def _name(number: int) -> str:
    """A block as lines name it."""
    set_number, block = divmod(number, BLOCKS_IN_SET)
    return f"{set_number + 1}.{block}" if set_number else str(block)


INTERVAL = 1.0
"""Seconds between two looks; a content is taken when two looks in a row find it."""


class FileWatch:
    """Loads the run of `path` anew when its content has changed, or when `look_now` is called.

    `changed` gets the run; what it raises as DefinitionError or ValueError, and what is wrong with the file, goes to
    `refused`. One content is tried once; `known` is the one that the run began with.
    """

    def __init__(
        self,
        path: Path,
        known: bytes | None,
        changed: Callable[[RunModel], None],
        refused: Callable[[ValueError], None],
    ) -> None:
        self.path = path
        self.changed = changed
        self.refused = refused
        self._asked = asyncio.Event()
        self._seen = self._tried = known

    def look_now(self) -> None:
        """Loads the file as it is, changed or not."""
        self._asked.set()

    async def watch(self) -> None:
        """Goes on until it is cancelled."""
        while True:
            try:
                await asyncio.wait_for(self._asked.wait(), INTERVAL)
                self._asked.clear()
                asked = True
            except TimeoutError:
                asked = False
            content = await asyncio.to_thread(content_of, self.path)
            settled, self._seen = content == self._seen, content
            if asked or (settled and content is not None and content != self._tried):
                self._tried = content
                await self._load()

    async def _load(self) -> None:
        try:
            self.changed(await asyncio.to_thread(load_run, self.path))
        except ValueError as error:
            self.refused(error)


def content_of(path: Path) -> bytes | None:
    """None: it cannot be read now, which an editor that replaces files may cause for a moment."""
    try:
        return path.read_bytes()
    except OSError:
        return None


def reasons(error: ValueError) -> list[str]:
    """Why an edit was refused, one sentence each, with places in files where there are any."""
    if isinstance(error, DefinitionError):
        return [str(problem) for problem in error.problems if not problem.warning]
    return [str(error)]
