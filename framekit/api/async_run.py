"""Runs for asyncio: a run file carried out in the caller's loop."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import TracebackType
from typing import Self

from framekit.api.run_calls import OnBlockEnd, OnSeen, RunCalls, loaded
from framekit.blocks.block_status import BlockStatus
from framekit.blocks.model import Run as RunModel
from framekit.transport.clock import AsyncioClock


class AsyncRun(RunCalls):
    """A run file at work in the loop in which it is made; `async with` starts and stops it.

    Its memory may be used before the start. `on_end(status, ok)` and `on_seen(channel, seen)` are called in the loop.
    Raises DefinitionError for a wrong file, RequestError for a port of no known kind.
    """

    def __init__(
        self, run: str | Path | RunModel, *, on_end: OnBlockEnd | None = None, on_seen: OnSeen | None = None
    ) -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        super().__init__(loaded(run), clock, lambda action: action(), on_end, on_seen)

    def start(self) -> None:
        """Opens the ports and arms the triggers. Raises RequestError after the stop."""
        self._begin()

    def stop(self) -> None:
        """No block starts any more; ports are closed at once, whatever is under way."""
        self._finish()

    async def finish(self) -> None:
        """No block starts any more; open sessions are closed, for 5 s at most, then the ports. `async with` does so."""
        await self._leave()

    async def __aenter__(self) -> Self:
        self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.finish()
        await asyncio.sleep(0)

    async def next_end(self, number: int | None = None, *, timeout: float | None = None) -> BlockStatus:
        """The status at the next completion of a block, or of any; `timeout` in seconds. Raises NoReplyError."""
        if number is not None:
            self._known(number)
        return await self._end_of(number, False, timeout)

    async def carry_out(self, number: int, *, timeout: float | None = None) -> BlockStatus:
        """Makes a block due by hand, and gives its status when it has ended. Raises RequestError, NoReplyError."""
        self._able(number)
        return await self._end_of(number, True, timeout)
