"""Runs: in real time in a thread of their own, for asyncio, and on a virtual clock, for tests."""

from __future__ import annotations

import asyncio
import re
import weakref
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Self

from framekit.api.errors import NoReplyError, RequestError
from framekit.api.loop_thread import LoopStoppedError, LoopThread, Stopping
from framekit.api.memory import Do, Memory
from framekit.api.monitor import FrameLog, LineOf, LiveView
from framekit.api.points import RunPoints
from framekit.api.rows import point_rows
from framekit.codec.shown import explain
from framekit.definition.problems import DefinitionError, Problem, error_text, parted
from framekit.definition.times import parse_time
from framekit.link.events import FrameRecord as FrameRecord
from framekit.link.events import Record as Record
from framekit.link.events import Seen
from framekit.link.events import Tape as Tape
from framekit.link.events import seen_of as seen_of
from framekit.run.block_state import BlockState, BlockStatus
from framekit.run.block_words import status_of
from framekit.run.edit import Edit as Edit
from framekit.run.edit import RemovedBlocks as RemovedBlocks
from framekit.run.model import BLOCKS_IN_SET, OwnPlace
from framekit.run.model import POINTS_SET as POINTS_SET
from framekit.run.model import Block as Block
from framekit.run.model import Channel as Channel
from framekit.run.model import RunModel as RunModel
from framekit.run.own_memory import stored_by
from framekit.run.status import ChannelStatus as ChannelStatus
from framekit.run.status import JobsStatus as JobsStatus
from framekit.run.status import JobStatus as JobStatus
from framekit.run.status import RunStatus as RunStatus
from framekit.run.status import SinkStatus as SinkStatus
from framekit.run.trouble import SampleCount, TroubleSource
from framekit.run.trouble import Trouble as Trouble
from framekit.run.trouble import TroubleReport as TroubleReport
from framekit.runfile.run_file import load_run, only_reading
from framekit.service.capture import Capture
from framekit.service.channel import ChannelService
from framekit.service.device import DeviceStore
from framekit.service.points import DevicePoints, begun_points
from framekit.service.run import RunService
from framekit.service.run_status import run_status as run_status
from framekit.service.state import StateError
from framekit.transport.clock import AsyncioClock, Clock, VirtualClock

MOST_WORDS = 12
"""Largest number of words of a place that are read."""


def stored_words(service: RunService, number: int | None = None) -> list[tuple[str, str]]:
    """Return the places that blocks, or one block, have stored data in, and their words, up to `MOST_WORDS`."""
    found = []
    for state in service.states.values() if number is None else (service.states[number],):
        for place, bits in _stored_by(service, state.block) if state.done else ():
            area = service.memory.area(place.address.area)
            first = place.address.first_bit // 16
            available = -(-area.size_bits // 8) - 2 * first  # the last word may be half a word
            data = area.read_bytes(2 * first, min(2 * max(1, bits // 16), 2 * MOST_WORDS, available))
            words = (data[at : at + 2] for at in range(0, len(data), 2))
            found.append((place.text, " ".join(f"{int.from_bytes(word, 'little'):04X}" for word in words)))
    return found


def _stored_by(service: RunService, block: Block) -> Iterable[tuple[OwnPlace, int]]:
    """Yield the places where a block stores its data, with the number of bits; points are shown separately."""
    if block.set == POINTS_SET:
        return ()
    frames = service.channels[block.channel].channel.protocol.frames if block.frame is not None else {}
    return stored_by(block, frames)


COMMANDS = "fire N, enable N, disable N (a block, SET.BLOCK, set N or channel N), reset or stop"

_BLOCK = re.compile(r"(fire|enable|disable)\s+(?:block\s+)?(?:([0-9]+)\.)?([0-9]+)")
_WHOLE = re.compile(r"(enable|disable)\s+(set|channel)\s+([0-9]+)")


def carry_out(service: RunService, line: str) -> None:
    """Execute a control line; empty lines and lines that begin with # have no effect.

    Raises ValueError with a sentence.
    """
    words = line.split("#")[0].strip().lower()
    if whole := _WHOLE.fullmatch(words):
        switch = service.enable_set if whole[2] == "set" else service.enable_channel
        switch(int(whole[3]), whole[1] == "enable")
    elif match := _BLOCK.fullmatch(words):
        verb, set_number, block = match[1], int(match[2] or 1), int(match[3])
        number = BLOCKS_IN_SET * (set_number - 1) + block
        if block >= BLOCKS_IN_SET or number not in service.states:
            known = ", ".join(state.block.label for _, state in sorted(service.states.items()))
            raise ValueError(f"there is no block {words.split()[-1]} – known: {known}")
        if verb == "fire":
            service.fire(number)
        else:
            service.enable(number, verb == "enable")
    elif words == "reset":
        service.reset()
    elif words:
        raise ValueError(f"'{words}' is no command – write {COMMANDS}")


INTERVAL = 1.0
"""Interval of the checks for changes (s); a content is used when two checks in a row find it."""


class FileWatch:
    """Loads the run of `path` again when its content has changed, or when `look_now` is called.

    `changed` gets the run; its DefinitionError or ValueError, and problems of the file, are passed to `refused`. Each
    content is tried once, and is then `tried`; `known` is the content that the run began with. `missing` gets the
    reason, once, when the file cannot be read any more, and '' when it can be read again.
    """

    def __init__(
        self,
        path: Path,
        known: bytes | None,
        changed: Callable[[RunModel], None],
        refused: Callable[[ValueError], None],
        missing: Callable[[str], None] = lambda reason: None,
    ) -> None:
        self.path = path
        self.missing = missing
        self._is_missing = False
        self.changed = changed
        self.refused = refused
        self._asked = asyncio.Event()
        self.tried = self._seen = known

    def look_now(self) -> None:
        """Load the file now, changed or not."""
        self._asked.set()

    async def watch(self) -> None:
        """Watch the file until the task is cancelled."""
        while True:
            try:
                await asyncio.wait_for(self._asked.wait(), INTERVAL)
                self._asked.clear()
                asked = True
            except TimeoutError:
                asked = False
            content = await asyncio.to_thread(content_of, self.path)
            settled, self._seen = content == self._seen, content
            if (settled or asked) and (content is None) != self._is_missing:
                self._is_missing = content is None
                self.missing(await asyncio.to_thread(why_unreadable, self.path) if content is None else "")
            if content is not None and (asked or (settled and content != self.tried)):
                self.tried = content
                await self._load(content)

    async def _load(self, content: bytes) -> None:
        """Load this content, whatever the file has meanwhile; a text that cannot be decoded is left to the loader."""
        try:
            try:
                text = content.decode("utf-8")
            except UnicodeDecodeError:
                text = None
            self.changed(await asyncio.to_thread(load_run, self.path, text))
        except ValueError as error:
            self.refused(error)


def content_of(path: Path) -> bytes | None:
    """Return the content; None if it cannot be read now, as during the replacement by an editor."""
    try:
        return path.read_bytes()
    except OSError:
        return None


def why_unreadable(path: Path) -> str:
    """Return the reason why a file cannot be read; '' if it can."""
    try:
        path.read_bytes()
    except OSError as error:
        return error_text(error)
    return ""


OnBlockEnd = Callable[[BlockStatus, bool], None]
"""Callback for every completion of a block: its status, and whether it succeeded."""
OnSeen = Callable[[int, Seen], None]
"""Callback for everything on the lines: the channel's number, and the event."""


class RunCalls:
    """A loaded run. Callbacks come after the complete event, one after the other.

    `monitor` gets the same events as `on_seen`, but at once, in the middle of the event: it must not call the run; a
    tape gets them as records. `capture` is a file for the traffic of the lines; `lost` lists after the end the data
    missing in it. `on_channel` is called for channels that are added later, and for those that an edit changes.
    `offers_faults`: simulated devices have faults that can be switched on, in addition to their own.
    """

    def __init__(
        self, run: RunModel, clock: Clock, do: Do, on_end: OnBlockEnd | None, on_seen: OnSeen | None,
        monitor: OnSeen | Tape | None = None, capture: Path | None = None, after: RunCalls | None = None,
        offers_faults: bool = False,
    ) -> None:  # fmt: skip
        self.run = run
        self._offers_faults = offers_faults
        self.lost: list[str] = []
        self.on_channel: Callable[[int], None] = lambda number: None
        self._do = do
        self._clock = clock
        self._told_end = on_end
        self._told_seen = on_seen
        self._started = self._over = False
        self._listeners: list[OnBlockEnd] = []
        service = self._make(monitor, None if after is None else after._service)
        self._service: RunService = service
        self._capture = self._captures(capture)
        self._captured = frozenset(service.channels)
        for number, channel in service.channels.items():
            self._tap(number, channel)
        service.on_channel = self._came
        self.began = clock.now()

    def _make(self, monitor: OnSeen | Tape | None, after: RunService | None) -> RunService:
        try:
            watch: OnSeen | Tape | None = monitor if self._told_seen is None else self._seen
            on_end = None if self._told_end is None else self._ended
            return RunService(self.run, self._clock, watch, on_end, after=after, offers_faults=self._offers_faults)
        except DefinitionError:
            raise
        except StateError as error:
            assert self.run.state is not None
            raise DefinitionError([Problem(self.run.state.at, *parted(error))]) from None
        except ValueError as error:
            raise RequestError(str(error)) from None

    def _captures(self, path: Path | None) -> Capture | None:
        """Open the capture. Raises OSError."""
        if path is None:
            return None
        try:
            return Capture(path, tuple(self._service.channels), self._clock, self._service.troubles)
        except OSError:
            self._service.stop()
            raise

    def _tap(self, number: int, channel: ChannelService) -> None:
        """Put the capture around the port of a channel; a channel added later is not captured."""
        if self._capture is None:
            return
        if number in self._captured:
            channel.driver.port = self._capture.around(number, channel.driver.port)
        else:
            self.lost.append(f"channel {number} came later: it is not in the capture")

    def _came(self, number: int, channel: ChannelService) -> None:
        """Handle a channel that an edit added or changed, or that jobs requested."""
        self.on_channel(number)
        self._tap(number, channel)

    def _seen(self, channel: int, seen: Seen) -> None:
        callback = self._told_seen
        if callback is not None:
            self._clock.call_soon(lambda: callback(channel, seen))

    def _ended(self, state: BlockState, ok: bool) -> None:
        callback, status = self._told_end, status_of(state)
        for listener in list(self._listeners):
            listener(status, ok)
        if callback is not None:
            self._clock.call_soon(lambda: callback(status, ok))

    def _begin(self) -> None:
        """Start the run, unless it has been started. Call it in the thread of the run. Raises RequestError."""
        if self._over:
            raise RequestError("a run is started once – make a new one")
        if not self.running:
            self.open_sinks()
            self._started = True
            self._service.start()

    def open_sinks(self) -> None:
        """Open the files and stores of the sinks, as the start does. Call it in the thread of the run.

        Raises DefinitionError with each that cannot be opened and written.
        """
        if not self._started:
            self._service.sinks.open()

    def _finish(self) -> None:
        """End the run for good; stored data is written and its files are closed."""
        if not self._over:
            self._over = True
            if self.running or not self._started:
                self._service.stop()
            if self._capture is not None:
                self._capture.close()

    # ---- from outside -------------------------------------------------------------------------------------

    def status(self) -> RunStatus:
        """Return the state of the run and its channels and blocks."""
        found: RunStatus = self._do(lambda: run_status(self._service))
        return found

    def stored(self, number: int | None = None) -> list[tuple[str, str]]:
        """Return the places of the own memory that blocks, or one block, have stored data in.

        Each place comes with its words, up to a limit.
        """
        found: list[tuple[str, str]] = self._do(lambda: stored_words(self._service, number))
        return found

    def published(self) -> dict[int, dict[str, Any]]:
        """Return the published variables of the protocol of each channel."""
        found: dict[int, dict[str, Any]] = self._do(
            lambda: {number: channel.engine.status() for number, channel in self._service.channels.items()}
        )
        return found

    def lines(self) -> dict[int, LineOf]:
        """Return the channels in the form of a display."""
        return {number: _line_of(channel) for number, channel in self._service.channels.items()}

    def channel(self, number: int) -> Channel:
        """Return a channel of the run, or one that jobs requested."""
        return self._service.channels[number].channel

    def control(self, line: str) -> None:
        """Execute a control line such as `fire 3` or `disable set 2`. Raises RequestError."""
        self._ask(lambda: carry_out(self._service, line))

    def _ask(self, action: Callable[[], object]) -> None:
        """Execute an action that the run may refuse. Raises RequestError."""
        try:
            self._do(action)
        except ValueError as error:
            raise RequestError(str(error)) from None

    def edit(self, run: RunModel, applied: Callable[[Edit], None] = lambda edit: None) -> None:
        """Apply an edited run once no exchange runs on the affected channels; then call `applied`.

        Raises DefinitionError with the reasons if it cannot be applied, ValueError for a port of no known kind; in both
        cases the run is not changed.
        """
        self._do(lambda: self._service.edit(run, applied))

    def each(self, period: int, call: Callable[[], None]) -> None:
        """Call back every `period` ns of the run's time, while it runs."""

        def go_on() -> None:
            if self.running:
                call()
                self._clock.call_at(self._clock.now() + period, go_on)

        self._do(lambda: self._clock.call_at(self.began + period, go_on))

    def later(self, delay: int, call: Callable[[], None]) -> None:
        """Call back once, after `delay` ns, without effect on the time of the run; use it from a callback."""
        self._clock.look_at(self._clock.now() + delay, call)

    @property
    def now(self) -> int:
        """Return the time of the run's clock, in nanoseconds."""
        return self._clock.now()

    # ---- blocks -------------------------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """Return whether the run has been started and not stopped."""
        return self._service.running

    @property
    def problems(self) -> list[str]:
        """Return the parts that fail now or have lost data, each with the reason, such as a state that cannot be
        written.
        """
        found: list[str] = self._do(lambda: self._service.problems)
        return found

    @property
    def troubles(self) -> tuple[Trouble, ...]:
        """Return the present troubles: sinks, stores, the state file and captures that fail now or have lost data."""
        return self._service.troubles.present()

    def watch_troubles(self, listener: Callable[[TroubleReport], None]) -> None:
        """Call `listener` when a trouble begins, when it loses data, and when it ends: at once, one call after the
        other.

        It is called in the thread in which the trouble occurred, and must not wait for the run.
        """
        self._service.troubles.listen(listener)

    def trouble_source(
        self, name: str, effect: Callable[[], str], count: Callable[[], SampleCount], unit: str
    ) -> TroubleSource:
        """Register a part of the program whose troubles belong to the run: its status, page and metrics show them.

        Arguments as of `Troubles.source`.
        """
        return self._service.troubles.source(name, effect, count, unit)

    @property
    def never_open(self) -> list[str]:
        """Return the channels whose ports could never be opened since the start, each with the reason."""
        found: list[str] = self._do(lambda: self._service.never_open)
        return found

    @property
    def blocks(self) -> list[BlockStatus]:
        """Return the state of every block, with its counters."""
        found: list[BlockStatus] = self._do(self._service.status)
        return found

    def block(self, number: int) -> BlockStatus:
        """Return the state of a block. Raises RequestError for an unknown number."""
        self._known(number)
        return next(status for status in self.blocks if status.id == number)

    def fire(self, number: int) -> None:
        """Make a block due by hand, as a trigger would. Raises RequestError."""
        self._ask(lambda: self._service.fire(number))

    def enable(self, number: int, on: bool = True) -> None:
        """Switch a block on, or with `on=False` off; a running exchange ends normally. Raises RequestError."""
        self._ask(lambda: self._service.enable(number, on))

    def disable(self, number: int) -> None:
        """Switch a block off: its triggers have no effect. Raises RequestError."""
        self.enable(number, False)

    def enable_set(self, number: int, on: bool = True) -> None:
        """Switch a parameter set on – its time triggers count from now – or off. Raises RequestError."""
        self._ask(lambda: self._service.enable_set(number, on))

    def enable_channel(self, number: int, on: bool = True) -> None:
        """Open the port of a channel, or close it: running exchanges fail, due blocks wait. Raises RequestError."""
        self._ask(lambda: self._service.enable_channel(number, on))

    def reset(self) -> None:
        """Reset to the state after the start: counters at zero, triggers afresh, the first scan again.

        Memory stays unchanged.
        """
        self._do(self._service.reset)

    # ---- waiting ------------------------------------------------------------------------------------------

    def watch_blocks(self, callback: OnBlockEnd) -> None:
        """Call `callback` at the end of each exchange of a block, in the thread of the run, until the run ends."""
        self._listeners.append(callback)
        self._service.on_end = self._ended

    def _listen(self, number: int | None, told: Callable[[BlockStatus], None]) -> Callable[[], None]:
        """Report completions of a block, or of any; the returned function ends that."""

        def listen(status: BlockStatus, ok: bool) -> None:
            if number in (None, status.id):
                told(status)

        def end() -> None:
            self._listeners.remove(listen)
            if not self._listeners and self._told_end is None:
                self._service.on_end = None

        self._listeners.append(listen)
        self._service.on_end = self._ended
        return end

    async def _end_of(self, number: int | None, fire: bool, timeout: float | None) -> BlockStatus:
        """Return the status at the next completion of a block, which is made due first or comes due by itself.

        Raises NoReplyError.
        """
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
        """Raise RequestError if a fired block cannot come due."""
        if not self.running:
            raise RequestError("the run has not been started, or was stopped")
        if not self.block(number).enabled:
            raise RequestError(f"block {number} is switched off")
        self._ask(lambda: self._service.check_fired(number))

    def _known(self, number: int) -> None:
        known = sorted(self._service.states)
        if number not in known:
            raise RequestError(f"there is no block {number} – known: {', '.join(map(str, known))}")

    # ---- memory -------------------------------------------------------------------------------------------

    @property
    def memory(self) -> Memory:
        """Return the own memory; triggers see what is written to it."""
        service = self._service
        return Memory(service.memory, service.grammar, self._do, self._clock.call_soon, service.refresh)

    @property
    def points(self) -> RunPoints:
        """Return the points of the run."""
        return RunPoints(self._service.points, self._do)

    def device(self, name: str) -> Memory:
        """Return the memory of a simulated device of the run, by its name. Raises RequestError."""
        for service in self._service.devices:
            if service.device.name == name:
                store, grammar = service.store, service.device.grammar
                return Memory(service.memory, grammar, self._do, self._clock.call_soon, store.refresh)
        known = ", ".join(service.device.name for service in self._service.devices) or "none"
        raise RequestError(f"there is no simulated device '{name}' – known: {known}")

    @property
    def simulated(self) -> list[tuple[int, DeviceStore]]:
        """Return the channel and the data of each simulated device; a device over two protocols has one of them."""
        found: list[tuple[int, DeviceStore]] = self._do(
            lambda: [
                (number, one.store)
                for number, devices in self._service.devices_on.items()
                for one in devices
                if not one.device.shares
            ]
        )
        return found

    def device_points(self) -> list[DevicePoints]:
        """Return for each of `simulated` the values with a behaviour or a start value, updated until they are stopped.

        Call it in the thread of the run.
        """
        return begun_points([store for _, store in self.simulated], self._clock)

    def points_of(self, device: DevicePoints) -> RunPoints:
        """Return the values of a device by name."""
        return RunPoints(device.service, self._do)


def _line_of(channel: ChannelService) -> LineOf:
    model = channel.channel
    line = "" if model.line is None else f" {model.line}"
    name = f"{model.protocol.name} {model.role or ''}".rstrip() + line
    return LineOf(name, lambda: channel.state, channel.driver.load)


def view_of(run: RunCalls, log: FrameLog) -> LiveView:
    """Return the view of a run that has not been started yet, whose monitor is `log.add`."""
    lines = run.lines()
    before = run.on_channel

    def know(number: int) -> None:
        model = run.channel(number)
        log.know(number, model.protocol, model.role, model.params)

    def came(number: int) -> None:
        """Handle a channel that an edit added or changed, or that jobs requested."""
        before(number)
        know(number)
        lines[number] = run.lines()[number]

    for number in lines:
        know(number)
    run.on_channel = came
    return LiveView(
        log, lambda: run.now, lines, lambda: run.blocks, lambda: point_rows(run.points), lambda: run.problems
    )


async def leave(service: RunService) -> None:
    """End a run in good order: open sessions are closed, for 5 s at most, then the ports.

    It returns when the modems have hung up, after two minutes at most.
    """
    left = asyncio.Event()
    service.finish(left.set)
    await left.wait()


def loaded(run: str | Path | RunModel) -> RunModel:
    """Return the run of a file. Raises DefinitionError."""
    return run if isinstance(run, RunModel) else load_run(Path(run))


def reads_only(run: RunModel) -> RunModel:
    """Return the run with read-only access for clients. Raises DefinitionError if it could write into a device."""
    return only_reading(run)


def nanoseconds(time: str | float) -> int:
    """Return the nanoseconds of a time such as `10 s`, or of a number of seconds. Raises RequestError."""
    try:
        found = parse_time(time) if isinstance(time, str) else round(time * 1e9)
    except (ValueError, OverflowError) as error:
        raise RequestError(explain(error)) from None
    if found < 0:
        raise RequestError("a time is not less than 0")
    return found


class Run(RunCalls, Stopping):
    """A run file executed in real time; `with` starts and stops it. Threads may share it.

    Its memory may be used before the start and after the end. `on_end(status, ok)` and `on_seen(channel, seen)` are
    called in the run's thread, and may call every method except `next_end`, `start` and `stop`. Raises DefinitionError
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
        """Open the ports and arm the triggers. Raises RequestError if it was stopped before."""
        try:
            self._thread.do(self._begin)
        except LoopStoppedError:
            raise RequestError("a run is started once – make a new one") from None

    def stop(self) -> None:
        """Stop: no further block starts; open sessions are closed, for 5 s at most, then the ports.

        It returns when the modems have hung up, after two minutes at most. Stopping twice has no effect.
        """
        self._end()

    def next_end(self, number: int | None = None, *, timeout: float | None = None) -> BlockStatus:
        """Return the status at the next completion of a block, or of any; `timeout` in seconds. Raises NoReplyError."""
        if number is not None:
            self._known(number)
        return self._wait(number, False, timeout)

    def carry_out(self, number: int, *, timeout: float | None = None) -> BlockStatus:
        """Make a block due by hand, and return its status when it has ended. Raises RequestError, NoReplyError."""
        self._able(number)
        return self._wait(number, True, timeout)

    def _wait(self, number: int | None, fire: bool, timeout: float | None) -> BlockStatus:
        try:
            return self._thread.wait(self._end_of(number, fire, timeout))
        except LoopStoppedError:
            raise RequestError("the run was stopped") from None


def _end(thread: LoopThread, service: RunService) -> None:
    """Close the ports and end the thread; called at the program's end for a run that has not been stopped."""
    try:
        if service.running:
            thread.wait(leave(service))
        else:
            thread.do(service.stop)
    except LoopStoppedError:
        return
    thread.stop()


class VirtualRun(RunCalls, Stopping):
    """A run file on simulated time, for tests: its channels have `sim:` ports, and an hour passes in a moment.

    Time passes only in `run_for`. `with` starts and stops the run. `run_for` raises the errors of callbacks.
    """

    def __init__(
        self, run: str | Path | RunModel, *, on_end: OnBlockEnd | None = None, on_seen: OnSeen | None = None,
        monitor: OnSeen | Tape | None = None, capture: Path | None = None, offers_faults: bool = False,
    ) -> None:  # fmt: skip
        self._virtual = VirtualClock()
        super().__init__(
            loaded(run), self._virtual, lambda action: action(), on_end, on_seen, monitor, capture,
            offers_faults=offers_faults,
        )  # fmt: skip

    def start(self) -> None:
        """Open the ports and arm the triggers. Raises RequestError after the stop."""
        self._begin()

    def stop(self) -> None:
        """Stop: no further block starts; open sessions are closed, for 5 s of its time at most."""
        if self.running:
            left: list[bool] = []
            self._service.finish(lambda: left.append(True))
            while not left and self._virtual.advance():
                pass
        self._finish()

    def run_for(self, time: str | float) -> None:
        """Let time pass: `"10 s"`, `"24 h"`, or a number of seconds. Start the run unless it has been started."""
        if not self.running:
            self.start()
        self._virtual.run_for(nanoseconds(time))

    def carry_out(self, number: int, *, within: str | float = "1 min") -> BlockStatus:
        """Make a block due by hand and let time pass until it has ended; return its status.

        Raises RequestError, NoReplyError if that takes longer than `within`.
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


class AsyncRun(RunCalls):
    """A run file executed in the loop in which it is made; `async with` starts and stops it.

    Its memory may be used before the start. `on_end(status, ok)` and `on_seen(channel, seen)` are called in the loop.
    `after`: the run before it in this loop, ended; late replies to requests of that run are not taken for its own.
    `offers_faults`: simulated devices have faults that can be switched on, in addition to their own.
    Raises DefinitionError for a wrong file, RequestError for a port of no known kind.
    """

    def __init__(
        self, run: str | Path | RunModel, *, on_end: OnBlockEnd | None = None, on_seen: OnSeen | None = None,
        monitor: OnSeen | Tape | None = None, capture: Path | None = None, after: AsyncRun | None = None,
        offers_faults: bool = False,
    ) -> None:  # fmt: skip
        clock = AsyncioClock(asyncio.get_running_loop())
        super().__init__(
            loaded(run), clock, lambda action: action(), on_end, on_seen, monitor, capture, after, offers_faults
        )

    def start(self) -> None:
        """Open the ports and arm the triggers. Raises RequestError after the stop."""
        self._begin()

    def stop(self) -> None:
        """Stop: no further block starts; ports are closed at once, even during exchanges.

        Modems hang up as long as the loop runs.
        """
        self._finish()

    async def finish(self) -> None:
        """Stop: no further block starts; open sessions are closed, for 5 s at most, then the ports.

        It returns when the modems have hung up, after two minutes at most. `async with` does so. After a cancellation
        call `stop`, which waits for no modem.
        """
        if self.running:
            await leave(self._service)
        self._finish()

    async def __aenter__(self) -> Self:
        self.start()
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.finish()
        await asyncio.sleep(0)

    async def next_end(self, number: int | None = None, *, timeout: float | None = None) -> BlockStatus:
        """Return the status at the next completion of a block, or of any; `timeout` in seconds. Raises NoReplyError."""
        if number is not None:
            self._known(number)
        return await self._end_of(number, False, timeout)

    async def carry_out(self, number: int, *, timeout: float | None = None) -> BlockStatus:
        """Make a block due by hand, and return its status when it has ended. Raises RequestError, NoReplyError."""
        self._able(number)
        return await self._end_of(number, True, timeout)
