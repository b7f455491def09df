"""The status of a run at work: the state of its channels, stations, blocks, sinks and troubles at one moment."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from framekit.definition.times import LineSettings
from framekit.run.block_state import BlockState, BlockStatus
from framekit.run.edit import Removed
from framekit.run.model import RunModel
from framekit.run.status import USER_DEFINED, ChannelStatus, RunStatus, StationStatus
from framekit.run.trouble import Troubles
from framekit.service.channel import ChannelService, Exchanges
from framekit.service.run_jobs import RunJobs
from framekit.service.sinks import SinkService
from framekit.service.value_troubles import ANSWERED, OF_BLOCK, is_refused
from framekit.transport.clock import Clock
from framekit.transport.schemes import without_files


class RunAtWork(Protocol):
    """The parts of a run that its status is made of; `framekit.service.run.RunService` has them."""

    running: bool

    @property
    def run(self) -> RunModel: ...
    @property
    def clock(self) -> Clock: ...
    @property
    def channels(self) -> Mapping[int, ChannelService]: ...
    @property
    def states(self) -> Mapping[int, BlockState]: ...
    @property
    def exchanges(self) -> Exchanges: ...
    @property
    def jobs(self) -> RunJobs | None: ...
    @property
    def removed(self) -> Removed: ...
    @property
    def sinks(self) -> SinkService: ...
    @property
    def troubles(self) -> Troubles: ...
    def status(self) -> Sequence[BlockStatus]: ...


def run_status(service: RunAtWork) -> RunStatus:
    """Return the state of a run and its channels and blocks."""
    now = service.clock.now()
    return RunStatus(
        run=service.run.name,
        at=now,
        running=service.running,
        channels=tuple(_channel_status(service, channel, now) for channel in service.channels.values()),
        blocks=tuple(service.status()),
        jobs=None if service.jobs is None else service.jobs.status(),
        removed=tuple(replace(one, reasons=one.reasons.copy()) for one in service.removed),
        sinks=tuple(service.sinks.status),
        troubles=service.troubles.present(),
        stations=tuple(_stations(service)),
    )


def _stations(service: RunAtWork) -> Iterator[StationStatus]:
    """Yield the stations of blocks, by their present settings, in the order of the blocks."""
    found: dict[tuple[int, Hashable], list[BlockState]] = {}
    for state in service.states.values():
        station = service.exchanges.station_of(state)
        if station is not None:
            found.setdefault((state.block.channel, station), []).append(state)
    for (channel, station), states in found.items():
        is_dead = any(state.dead for state in states)
        yield StationStatus(
            channel=channel,
            station=station,
            blocks=len(states),
            done=sum(state.done for state in states),
            failed=sum(state.failed for state in states),
            dead=is_dead,
            answers=not is_dead and _answers(states),
        )


UNRELATED = (OF_BLOCK | {"cancelled", "interrupted", "queue_full"}) - ANSWERED
"""Outcomes that do not show whether a station answers."""


def _answers(states: Sequence[BlockState]) -> bool:
    """Return whether the station answered in the last exchange of these blocks that shows whether it does."""
    ends = [(state.last_end, _has_answered(state)) for state in states if state.last_end is not None]
    shown = [(end, answered) for end, answered in ends if answered is not None]
    last = max((end for end, _ in shown), default=None)
    return any(answered for end, answered in shown if end == last)


def _has_answered(state: BlockState) -> bool | None:
    """Return whether the station answered in the last exchange of a block; None if the exchange does not show it."""
    failure = None if state.ended_well else state.last_failure
    if failure is None or is_refused(failure):
        return True
    return None if failure.outcome in UNRELATED else False


def _channel_status(service: RunAtWork, at_work: ChannelService, now: int) -> ChannelStatus:
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
        port=without_files(channel.port),
        driver=USER_DEFINED if protocol.frames_alone else protocol.name,
        role=channel.role,
        station=channel.own,
        line="" if channel.line is None else str(channel.line),
        line_type=line_type(channel.wiring),
        mode="run" if service.running else "stop",
        state=at_work.state,
        blocks=len(states),
        services=removed.done + sum(state.done for state in states) + at_work.counters.services,
        errors=removed.failed + sum(state.failed for state in states) + beside.total(),
        reasons=dict(reasons),
        frames_in=counters.received,
        bad=counters.bad,
        noise_bytes=counters.noise_bytes,
        late=counters.late,
        repeated=counters.repeated,
        slow=tuple(map(str, at_work.engine.late.slow.present)),
        bytes_in=load.bytes_in,
        bytes_out=load.bytes_out,
        load=load.share(now),
        reopenings=at_work.driver.reopenings,
        step=at_work.engine.late.state_at(now),
    )


def line_type(wiring: LineSettings) -> str:
    """Return the description of the wiring; '' for a plain port."""
    kind = {"rs232": "RS-232", "rs422": "RS-422", "rs485": "RS-485"}.get(wiring.type or "", "")
    return f"{kind} half duplex".lstrip() if wiring.half_duplex else kind
