"""Runs: in real time in a thread of their own, for asyncio, and on a virtual clock, for tests."""

from __future__ import annotations

import asyncio
import weakref
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from framekit.api.errors import NoReplyError, RequestError
from framekit.api.loop_thread import LoopStoppedError, LoopThread
from framekit.api.memory import Do, Memory
from framekit.api.monitor import LineOf
from framekit.api.status import ControlError, RunStatus, carry_out, run_status, stored_words
from framekit.codec.shown import explain
from framekit.definition.problems import DefinitionError
from framekit.definition.times import parse_time
from framekit.link.observe import Seen
from framekit.run.block_state import BlockStatus
from framekit.run.edit import Edit as Edit
from framekit.run.model import Block as Block
from framekit.run.model import Channel
from framekit.run.model import RunModel as RunModel
from framekit.runfile.run_file import load_run
from framekit.service.capture import Capture
from framekit.service.channel import ChannelService
from framekit.service.run import RunService
from framekit.service.state import StateError
from framekit.transport.clock import AsyncioClock, Clock, VirtualClock

OnBlockEnd = Callable[[BlockStatus, bool], None]
"""Told of every completion of a block: its status then, and whether it ended well."""
OnSeen = Callable[[int, Seen], None]
"""Told of everything on the lines: the channel's number, and what was seen."""


class RunCalls:
    """A run that has been loaded. Callbacks come after what they tell of is complete, one after the other.

    `monitor` gets what `on_seen` gets, but at once, from inside of what happens: it calls nothing here. `capture` is a
    file for what goes over the lines; `lost` says after the end what is not in there. `on_channel` is told of channels
    that come later, and of those that an edit changes.
    """

    def __init__(
        self, run: RunModel, clock: Clock, do: Do, on_end: OnBlockEnd | None, on_seen: OnSeen | None,
        monitor: OnSeen | None = None, capture: Path | None = None,
    ) -> None:  # fmt: skip
        self.run = run
        self.lost: list[str] = []
        self.on_channel: Callable[[int], None] = lambda number: None
        self._do = do
        self._clock = clock
        self._told_end = on_end
        self._told_seen = on_seen
        self._started = self._over = False
        self._listeners: list[OnBlockEnd] = []
        self._service = service = self._make(monitor)
        self._capture = None if capture is None else Capture(capture, tuple(service.channels), clock)
        self._captured = frozenset(service.channels)
        for number, channel in service.channels.items():
            self._tap(number, channel)
        service.on_channel = self._came
        self.began = clock.now()

    def _make(self, monitor: OnSeen | None) -> RunService:
        try:
            watch = monitor if self._told_seen is None else self._seen
            return RunService(self.run, self._clock, watch, self._ended)
        except DefinitionError:
            raise
        except (ValueError, StateError) as error:
            raise RequestError(str(error)) from None

    def _tap(self, number: int, channel: ChannelService) -> None:
        """Puts the capture around the port of a channel; one that came later has no place in it."""
        if self._capture is None:
            return
        if number in self._captured:
            channel.driver.port = self._capture.around(number, channel.driver.port)
        else:
            self.lost.append(f"channel {number} came later: it is not in the capture")

    def _came(self, number: int, channel: ChannelService) -> None:
        """A channel that an edit has brought or changed, or that jobs wanted."""
        self.on_channel(number)
        self._tap(number, channel)

    def _seen(self, channel: int, seen: Seen) -> None:
        told = self._told_seen
        if told is not None:
            self._clock.call_soon(lambda: told(channel, seen))

    def _ended(self, status: BlockStatus, ok: bool) -> None:
        for listener in list(self._listeners):
            listener(status, ok)
        told = self._told_end
        if told is not None:
            self._clock.call_soon(lambda: told(status, ok))

    def _begin(self) -> None:
        """Starts the run, if nobody has. To be called where the run is at home. Raises RequestError."""
        if self._over:
            raise RequestError("a run is started once – make a new one")
        if not self.running:
            self._started = True
            self._service.start()

    def _finish(self) -> None:
        """Ends the run for good; what it keeps is written and let go of."""
        if not self._over:
            self._over = True
            if self.running or not self._started:
                self._service.stop()
            if self._capture is not None:
                self._capture.close()
                self.lost = [*self._capture.troubles, *self.lost]

    async def _leave(self) -> None:
        """As `_finish`, in good order: open sessions are closed first."""
        if self.running:
            await leave(self._service)
        self._finish()

    # ---- from outside -------------------------------------------------------------------------------------

    def status(self) -> RunStatus:
        """How the run and its channels and blocks are doing now."""
        found: RunStatus = self._do(lambda: run_status(self._service))
        return found

    def stored(self) -> list[tuple[str, str]]:
        """Places of the own memory that blocks have put something into, with the words there, as many as are read."""
        found: list[tuple[str, str]] = self._do(lambda: stored_words(self._service))
        return found

    def published(self) -> dict[int, dict[str, Any]]:
        """What the protocol of each channel publishes."""
        found: dict[int, dict[str, Any]] = self._do(
            lambda: {number: channel.engine.status() for number, channel in self._service.channels.items()}
        )
        return found

    def lines(self) -> dict[int, LineOf]:
        """The channels, as a display shows them."""
        return {number: _line_of(channel) for number, channel in self._service.channels.items()}

    def channel(self, number: int) -> Channel:
        """What a channel is: one of the run, or one that jobs wanted."""
        return self._service.channels[number].channel

    def control(self, line: str) -> None:
        """Carries out a line such as `fire 3` or `disable set 2`. Raises RequestError."""
        try:
            self._do(lambda: carry_out(self._service, line))
        except ControlError as error:
            raise RequestError(str(error)) from None

    def edit(self, run: RunModel, applied: Callable[[Edit], None] = lambda edit: None) -> None:
        """Applies an edited run once no exchange runs on the channels it touches; `applied` is called then.

        Raises DefinitionError with the reasons when it cannot be, ValueError for a port of no known kind: then nothing
        changes.
        """
        self._do(lambda: self._service.edit(run, applied))

    def each(self, period: int, call: Callable[[], None]) -> None:
        """Calls back every so many ns of the run's time, while it goes on."""

        def go_on() -> None:
            if self.running:
                call()
                self._clock.call_at(self._clock.now() + period, go_on)

        self._clock.call_at(self.began + period, go_on)

    @property
    def now(self) -> int:
        """The time of the run's clock, in nanoseconds."""
        return self._clock.now()

    # ---- blocks -------------------------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """Whether it has been started, and not stopped."""
        return self._service.running

    @property
    def problems(self) -> list[str]:
        """What keeps the run from doing all it should, such as a state that cannot be written."""
        found: list[str] = self._do(lambda: self._service.problems)
        return found

    @property
    def blocks(self) -> list[BlockStatus]:
        """How every block is doing now, with its counters."""
        found: list[BlockStatus] = self._do(self._service.status)
        return found

    def block(self, number: int) -> BlockStatus:
        """How one block is doing now. Raises RequestError for a number there is not."""
        self._known(number)
        return next(status for status in self.blocks if status.id == number)

    def fire(self, number: int) -> None:
        """Makes a block due by hand, as a trigger would. Raises RequestError."""
        self._comes_due(number)
        self._do(lambda: self._service.fire(number))

    def enable(self, number: int, on: bool = True) -> None:
        """Switches a block on, or with `on=False` off; what runs ends as it does. Raises RequestError."""
        self._known(number)
        self._do(lambda: self._service.enable(number, on))

    def disable(self, number: int) -> None:
        """Switches a block off: its triggers do nothing. Raises RequestError."""
        self.enable(number, False)

    def enable_set(self, number: int, on: bool = True) -> None:
        """Switches a parameter set on – its time triggers count from now – or off. Raises RequestError."""
        if number not in self.run.sets:
            raise RequestError(f"there is no set {number} – known: {', '.join(map(str, self.run.sets))}")
        self._do(lambda: self._service.enable_set(number, on))

    def enable_channel(self, number: int, on: bool = True) -> None:
        """Opens the port of a channel, or closes it: what runs there fails, what is due waits. Raises RequestError."""
        if number not in self.run.channels:
            raise RequestError(f"there is no channel {number} – known: {', '.join(map(str, self.run.channels))}")
        self._do(lambda: self._service.enable_channel(number, on))

    def reset(self) -> None:
        """As after the start: counters at zero, triggers afresh, the first scan again. Memory stays as it is."""
        self._do(self._service.reset)

    # ---- waiting ------------------------------------------------------------------------------------------

    def _listen(self, number: int | None, told: Callable[[BlockStatus], None]) -> Callable[[], None]:
        """Tells of completions of a block, or of any; what is given ends that."""

        def listen(status: BlockStatus, ok: bool) -> None:
            if number in (None, status.id):
                told(status)

        self._listeners.append(listen)
        return lambda: self._listeners.remove(listen)

    async def _end_of(self, number: int | None, fire: bool, timeout: float | None) -> BlockStatus:
        """The status at the next completion, of a block that is made due first or by itself. Raises NoReplyError."""
        ended: asyncio.Future[BlockStatus] = asyncio.get_running_loop().create_future()
        end = self._listen(number, lambda status: None if ended.done() else ended.set_result(status))
        try:
            if fire and number is not None:
                self._service.fire(number)
            async with asyncio.timeout(timeout):
                return await ended
        except TimeoutError:
            what = "no block has" if number is None else f"block {number} has not"
            raise NoReplyError(f"{what} ended within {timeout:g} s", "timeout") from None
        finally:
            end()

    def _able(self, number: int) -> None:
        """Raises RequestError where a block that is fired cannot come due."""
        if not self.running:
            raise RequestError("the run has not been started, or was stopped")
        if not self.block(number).enabled:
            raise RequestError(f"block {number} is switched off")
        self._comes_due(number)

    def _comes_due(self, number: int) -> None:
        """Raises RequestError for a block that nobody can make due."""
        if self.block(number).instruction == "receive":
            raise RequestError(f"block {number} receives: nothing but its frame makes it due")

    def _known(self, number: int) -> None:
        known = [block.id for block in self.run.blocks]
        if number not in known:
            raise RequestError(f"there is no block {number} – known: {', '.join(map(str, known))}")

    # ---- memory -------------------------------------------------------------------------------------------

    @property
    def memory(self) -> Memory:
        """The own memory; what is written there triggers see."""
        service = self._service
        return Memory(service.memory, service.grammar, self._do, self._clock.call_soon, service.refresh)

    def device(self, name: str) -> Memory:
        """The memory of a simulated device of the run, by its name. Raises RequestError."""
        for service in self._service.devices:
            if service.device.name == name:
                store, grammar = service.store, service.device.grammar
                return Memory(service.memory, grammar, self._do, self._clock.call_soon, store.refresh)
        known = ", ".join(service.device.name for service in self._service.devices) or "none"
        raise RequestError(f"there is no simulated device '{name}' – known: {known}")


def _line_of(channel: ChannelService) -> LineOf:
    model = channel.channel
    line = "" if model.line is None else f" {model.line}"
    name = f"{model.protocol.name} {model.role or ''}".rstrip() + line
    return LineOf(name, lambda: channel.state, channel.driver.load)


async def leave(service: RunService) -> None:
    """Ends a run in good order: open sessions are closed, for 5 s at most, then the ports."""
    left = asyncio.Event()
    service.finish(left.set)
    await left.wait()


def loaded(run: str | Path | RunModel) -> RunModel:
    """The run in a file. Raises DefinitionError."""
    return run if isinstance(run, RunModel) else load_run(Path(run))


def nanoseconds(time: str | float) -> int:
    """A time such as `10 s`, or a number of seconds. Raises RequestError."""
    try:
        found = parse_time(time) if isinstance(time, str) else round(time * 1e9)
    except (ValueError, OverflowError) as error:
        raise RequestError(explain(error)) from None
    if found < 0:
        raise RequestError("a time is not less than 0")
    return found


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
        self, run: str | Path | RunModel, *, on_end: OnBlockEnd | None = None, on_seen: OnSeen | None = None,
        monitor: OnSeen | None = None, capture: Path | None = None,
    ) -> None:  # fmt: skip
        self._virtual = VirtualClock()
        super().__init__(loaded(run), self._virtual, lambda action: action(), on_end, on_seen, monitor, capture)

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


class AsyncRun(RunCalls):
    """A run file at work in the loop in which it is made; `async with` starts and stops it.

    Its memory may be used before the start. `on_end(status, ok)` and `on_seen(channel, seen)` are called in the loop.
    Raises DefinitionError for a wrong file, RequestError for a port of no known kind.
    """

    def __init__(
        self, run: str | Path | RunModel, *, on_end: OnBlockEnd | None = None, on_seen: OnSeen | None = None,
        monitor: OnSeen | None = None, capture: Path | None = None,
    ) -> None:  # fmt: skip
        clock = AsyncioClock(asyncio.get_running_loop())
        super().__init__(loaded(run), clock, lambda action: action(), on_end, on_seen, monitor, capture)

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
