"""The end of a run in good order: open sessions are closed before the ports are, within a bound.

What a session is, and how one is closed, is the protocol's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

from framekit.service.channel import ChannelService
from framekit.transport.clock import Clock

LONGEST_FAREWELL = 5_000_000_000
"""A run ends after this (ns) even if a session could not be closed."""


class Ending:
    """Closes the sessions of channels; `end` is called once, when all are closed or `within` ns have passed.

    Where no channel has a session it is called at once.
    """

    def __init__(self, channels: Iterable[ChannelService], clock: Clock, within: int, end: Callable[[], None]) -> None:
        self._clock = clock
        self._end: Callable[[], None] | None = end
        with_session = [channel for channel in channels if channel.has_session]
        self._waiting = {channel.channel.number for channel in with_session}
        if not with_session:
            self._over()
            return
        self._limit = clock.call_at(clock.now() + within, self._over)
        for channel in with_session:
            channel.close_session(partial(self._left, channel.channel.number))

    def _left(self, number: int) -> None:
        """Told from inside of an engine, which is to be left before anything ends."""
        self._waiting.discard(number)
        if not self._waiting:
            self._limit.cancel()
            self._clock.call_soon(self._over)

    def _over(self) -> None:
        end, self._end = self._end, None
        if end is not None:
            end()
