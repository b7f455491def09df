"""What a run says about its jobs, and which of its channels leads to a host.

Names that the run does not know are left to whoever can ask the system.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from framekit.blocks.jobs.profile import JobProfile
from framekit.definition.problems import Position
from framekit.transport.schemes import host_of as port_host

if TYPE_CHECKING:
    from framekit.blocks.model import Channel, Place
    from framekit.definition.model.protocol import Protocol

HOST = "{host}"
"""Stands for a host's address in the port of channels that are opened when they are wanted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opening:
    """The channel that is opened for a host to which none leads: `{host}` in its port stands for the address.

    `connections`: so many of these at once.
    """

    channel: Channel
    connections: int

    @property
    def leads_anywhere(self) -> bool:
        """Whether the port is the same for every host: then nobody asks where one is."""
        return HOST not in self.channel.port

    def port_to(self, address: str) -> str:
        """The port that leads to an address."""
        port = self.channel.port
        return port.replace(HOST, f"[{address}]" if ":" in address and "://" in port else address)


@dataclass(frozen=True, slots=True, kw_only=True)
class JobsSection:
    """The profile with what the run changes of it, where status bits stand, and addresses of hosts by name.

    `waits`: commands of blocks that are too many for a scan wait for the next one; else they are lost. `commands` reads
    commands whose words stand in memory. `opening`: what is done for hosts without a channel; None: nothing.
    """

    profile: JobProfile
    status: Place | None = None
    hosts: Mapping[str, str] = field(default_factory=dict)
    waits: bool = True
    commands: Protocol | None = None
    opening: Opening | None = None
    at: Position


def host_of(channel: Channel) -> str:
    """How jobs call the other side of a channel; empty where nothing says it."""
    return channel.host or port_host(channel.port)


def channel_to(host: str, channels: Mapping[int, Channel]) -> int | None:
    """The first channel that leads to a host, by what it is called there."""
    return next((number for number, channel in channels.items() if host_of(channel) == host), None)


def is_address(host: str) -> bool:
    """Whether a host is given by its address, and needs no name service."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
