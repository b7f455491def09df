"""Collects how a run is doing now, for people, programs and sinks."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from framekit.definition.times import LineSettings
from framekit.run.job_table import JobTable
from framekit.run.status import USER_DEFINED, ChannelStatus, JobsStatus, RunStatus
from framekit.service.channel import ChannelService

if TYPE_CHECKING:
    from framekit.service.run import RunService


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
        sinks=tuple(service.sinks.status),
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
        services=removed.done + sum(state.done for state in states) + at_work.counters.services,
        errors=removed.failed + sum(state.failed for state in states) + beside.total(),
        reasons=dict(reasons),
        frames_in=counters.received,
        bad=counters.bad,
        noise_bytes=counters.noise_bytes,
        bytes_in=load.bytes_in,
        bytes_out=load.bytes_out,
        load=load.share(now),
        reopenings=at_work.driver.reopenings,
    )


def line_type(wiring: LineSettings) -> str:
    """What is said of the wiring, in words; '' for a plain port."""
    kind = {"rs232": "RS-232", "rs422": "RS-422", "rs485": "RS-485"}.get(wiring.type or "", "")
    return f"{kind} half duplex".lstrip() if wiring.half_duplex else kind
