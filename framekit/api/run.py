"""Runs for programs without asyncio: in real time in a thread of their own, or on a virtual clock, for tests."""

from __future__ import annotations

import weakref
from pathlib import Path
from types import TracebackType
from typing import Self

from framekit.api.errors import NoReplyError, RequestError
from framekit.api.loop_thread import LoopStoppedError, LoopThread
from framekit.api.run_calls import OnBlockEnd, OnSeen, RunCalls, leave, loaded, nanoseconds
from framekit.blocks.block_status import BlockStatus
from framekit.blocks.model import Run as RunModel
from framekit.service.run import RunService
from framekit.transport.clock import AsyncioClock, VirtualClock


class Run(RunCalls):
    """A run file at work in real time; `with` starts and stops it. Threads may share it.

    Its memory may be used before the start and after the end. `on_end(status, ok)` and `on_seen(channel, seen)` are
    called in the run's thread, and may call everything here but `next_end`, `start` and `stop`. Raises DefinitionError
    for a wrong file, RequestError for a port of no known kind.
    """

    def __init__(
        self, run: str | Path | RunModel, *, on_end: OnBlockEnd | None = None, on_seen: OnSeen | None = None
    ) -> None:
        model = loaded(run)
        self._thread = thread = LoopThread(f"framekit run {model.name}")
        try:
            super().__init__(model, AsyncioClock(thread.loop), thread.do_even_stopped, on_end, on_seen)
        except BaseException:
            thread.stop()
            raise
        self._end = weakref.finalize(self, _end, thread, self._service)

    def start(self) -> None:
        """Opens the ports and arms the triggers. Raises RequestError if it was stopped before."""
        try:
            self._thread.do(self._begin)
        except LoopStoppedError:
            raise RequestError("a run is started once – make a new one") from None

    def stop(self) -> None:
        """No block starts any more; open sessions are closed, for 5 s at most, then the ports. Twice does nothing."""
        self._end()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def next_end(self, number: int | None = None, *, timeout: float | None = None) -> BlockStatus:
        """The status at the next completion of a block, or of any; `timeout` in seconds. Raises NoReplyError."""
        if number is not None:
            self._known(number)
        return self._wait(number, False, timeout)

    def carry_out(self, number: int, *, timeout: float | None = None) -> BlockStatus:
        """Makes a block due by hand, and gives its status when it has ended. Raises RequestError, NoReplyError."""
        self._able(number)
        return self._wait(number, True, timeout)

    def _wait(self, number: int | None, fire: bool, timeout: float | None) -> BlockStatus:
        try:
            return self._thread.wait(self._end_of(number, fire, timeout))
        except LoopStoppedError:
            raise RequestError("the run was stopped") from None


def _end(thread: LoopThread, service: RunService) -> None:
    """Closes the ports and ends the thread; at the program's end for a run that nobody has stopped."""
    try:
        if service.running:
            thread.wait(leave(service))
        else:
            thread.do(service.stop)
    except LoopStoppedError:
        return
    thread.stop()


class VirtualRun(RunCalls):
    """A run file on simulated time, for tests: its channels have `sim:` ports, and an hour passes in a moment.

    Nothing happens by itself: `run_for` lets time pass. `with` starts and stops it. What a callback raises comes out of
    `run_for`.
    """

    def __init__(
        self, run: str | Path | RunModel, *, on_end: OnBlockEnd | None = None, on_seen: OnSeen | None = None
    ) -> None:
        self._virtual = VirtualClock()
        super().__init__(loaded(run), self._virtual, lambda action: action(), on_end, on_seen)

    def start(self) -> None:
        """Opens the ports and arms the triggers. Raises RequestError after the stop."""
        self._begin()

    def stop(self) -> None:
        """No block starts any more; open sessions are closed, for 5 s of its time at most."""
        if self.running:
            left: list[bool] = []
            self._service.finish(lambda: left.append(True))
            while not left and self._virtual.advance():
                pass
        self._finish()

    @property
    def now(self) -> int:
        """The simulated time since the making, in nanoseconds."""
        return self._virtual.now()

    def run_for(self, time: str | float) -> None:
        """Lets time pass: `"10 s"`, `"24 h"`, or a number of seconds. Starts the run if nobody has."""
        if not self.running:
            self.start()
        self._virtual.run_for(nanoseconds(time))

    def carry_out(self, number: int, *, within: str | float = "1 min") -> BlockStatus:
        """Makes a block due by hand and lets time pass until it has ended; its status then.

        Raises RequestError, NoReplyError when that takes longer than `within`.
        """
        self._able(number)
        ended: list[BlockStatus] = []
        limit = self._virtual.now() + nanoseconds(within)
        end = self._listen(number, ended.append)
        try:
            self._service.fire(number)
            while not ended and (due := self._virtual.next_call) is not None and due <= limit:
                self._virtual.advance()
        finally:
            end()
        if not ended:
            raise NoReplyError(f"block {number} has not ended within {within}", "timeout")
        return ended[0]

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
