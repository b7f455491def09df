"""The jobs of a run, as the run sees them; the extra `commreq` brings them."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from typing import Protocol as Interface

from framekit.memory.memory import DeviceMemory
from framekit.run.model import Channel, JobCommand, JobRecord, JobsSection
from framekit.run.status import JobsStatus
from framekit.service.channel import ChannelService
from framekit.table_of_extras import OPTIONS, load
from framekit.transport.clock import Clock

Found = Callable[[list[str] | None], None]
"""Callback for the addresses of a name: empty if the name is unknown, None if the resolver failed."""

ResolveHost = Callable[[str, Found], None]


class ChannelOpener(Interface):
    """Owner of the channels, which can open more of them."""

    def open_for_jobs(self, channel: Channel) -> None:
        """Make and open a channel. Raises ValueError for a port that cannot be made."""

    def close_for_jobs(self, number: int) -> None:
        """Close and remove a channel opened for jobs."""


class JobHosts(Interface):
    """The channels of jobs to hosts."""

    opened: list[int]
    """Channels that jobs requested, the most recently requested last."""

    def close_all(self) -> None:
        """Close these channels."""


class RunJobs(Interface):
    """The jobs of a run at work."""

    @property
    def hosts(self) -> JobHosts:
        """Return the channels to hosts."""

    @property
    def deadline(self) -> int:
        """Return the time of the next work for `tick`."""

    def start(self) -> None:
        """Accept commands from now on."""

    def stop(self) -> None:
        """Abort all jobs."""

    def reset(self) -> None:
        """Reset to the state after the start."""

    def tick(self, now: int) -> None:
        """Do the work that is due."""

    def take(self, command: JobCommand | JobRecord) -> None:
        """Carry out a command of a block."""

    def opened(self, number: int, is_open: bool) -> None:
        """Begin or end the jobs of a channel that has been opened or closed."""

    def give_up(self, blocks: Container[int]) -> None:
        """End the jobs that these blocks have started."""

    def status(self) -> JobsStatus:
        """Return the state of the slots, the last events, and the counted commands."""


def jobs_at_work(
    section: JobsSection,
    memory: DeviceMemory,
    channels: Mapping[int, ChannelService],
    clock: Clock,
    finished: Callable[..., None],
    wake: Callable[[], None],
    resolve: ResolveHost | None,
    opener: ChannelOpener,
) -> RunJobs:
    """Return the jobs of a run. `finished` is called at the end of each command, `wake` when times change."""
    made: RunJobs = load(OPTIONS["jobs:"])(section, memory, channels, clock, finished, wake, resolve, opener)
    return made
