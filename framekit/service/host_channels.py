"""Which channel leads to the host of a job: one of the run, or one that is opened when it is wanted.

Names are looked up as the run says, then by the system. What jobs do on a channel is not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Protocol

from framekit.run.job_status import Attempt
from framekit.run.model import Channel, JobsSection, channel_to, is_address
from framekit.service.channel import ChannelService
from framekit.service.resolver import Resolve
from framekit.transport.clock import Clock

FIRST_OPENED = 1001
"""Channels that are opened when they are wanted are numbered from here on, past those of a run."""

Way = Callable[[int | None, str], None]
"""Told the number of a channel; None with the reason, one of a job profile's words, when there is none."""


class ChannelOpener(Protocol):
    """Who has the channels, and makes more of them."""

    def open_for_jobs(self, channel: Channel) -> None:
        """Makes and opens a channel. Raises ValueError for a port that cannot be made."""

    def close_for_jobs(self, number: int) -> None:
        """Closes such a channel, and forgets it."""


class HostChannels:
    """Finds ways to hosts. `in_use`: whether a job is on a channel, or waits for it."""

    def __init__(
        self,
        section: JobsSection,
        channels: Mapping[int, ChannelService],
        clock: Clock,
        resolve: Resolve,
        opener: ChannelOpener,
        in_use: Callable[[int], bool],
    ) -> None:
        self._section = section
        self._channels = channels
        self._clock = clock
        self._resolve = resolve
        self._opener = opener
        self._in_use = in_use
        self.opened: list[int] = []
        """Channels opened here; the one that was wanted last is the last."""

    def find(self, attempt: Attempt, wanted: Callable[[], bool], way: Way) -> None:
        """By what the run says, else by the address that the name has. Nothing is opened for what is not `wanted`."""
        host = attempt.order.host
        if attempt.order.channel is not None:
            way(attempt.order.channel, "no_channel")
            return
        number = self._channel_to(host)
        if number is None and host in self._section.hosts:
            host = self._section.hosts[host]
            number = self._channel_to(host)
        opening = self._section.opening
        if number is not None or is_address(host) or (opening is not None and opening.leads_anywhere):
            self._lead(number, host, way)
            return

        def found(addresses: list[str] | None) -> None:
            """Told the addresses of the name; none: nobody knows it; None: asking failed."""
            if not wanted():
                return
            if not addresses:
                way(None, "no_resolver" if addresses is None else "unknown_host")
                return
            numbers = (self._channel_to(address) for address in addresses)
            self._lead(next((number for number in numbers if number is not None), None), addresses[0], way)

        self._resolve(host, found)

    def _channel_to(self, host: str) -> int | None:
        return channel_to(host, {number: channel.channel for number, channel in self._channels.items()})

    # ---- opened when wanted -------------------------------------------------------------------------------

    def _lead(self, number: int | None, address: str, way: Way) -> None:
        if number is None:
            with suppress(ValueError):  # a port that cannot be made leads nowhere
                number = self._open(address)
        if number in self.opened:
            self.opened.remove(number)
            self.opened.append(number)
        way(number, "no_channel")

    def open_now(self) -> None:
        """Opens the channel that leads to every host, before a job wants it. Raises ValueError."""
        opening = self._section.opening
        if opening is not None and opening.leads_anywhere:
            self._open("")

    def _open(self, address: str) -> int | None:
        """A channel to an address, where the run allows one more; None where not. Raises ValueError."""
        opening = self._section.opening
        if opening is None:
            return None
        port = opening.port_to(address)
        same = next((number for number in self.opened if self._channels[number].channel.port == port), None)
        if same is not None:
            return same
        if len(self.opened) >= opening.connections and not self._make_room():
            return None
        number = FIRST_OPENED
        while number in self._channels:
            number += 1
        self._opener.open_for_jobs(replace(opening.channel, number=number, port=port, host=address))
        self.opened.append(number)
        return number

    def _make_room(self) -> bool:
        """Closes the channel that nobody uses for the longest time; whether there is one."""
        idle = next((number for number in self.opened if not self._in_use(number)), None)
        if idle is not None:
            self._close(idle)
        return idle is not None

    def _close(self, number: int) -> None:
        self.opened.remove(number)
        self._opener.close_for_jobs(number)

    def lost(self, number: int) -> None:
        """A channel is not open any more: one that was opened here is given up, unless a job wants it again."""
        if number in self.opened:
            self._clock.call_soon(lambda: self._give_up(number))

    def _give_up(self, number: int) -> None:
        if number in self.opened and self._channels[number].state != "open" and not self._in_use(number):
            self._close(number)

    def close_all(self) -> None:
        """Closes every channel that was opened here."""
        for number in tuple(self.opened):
            self._close(number)
