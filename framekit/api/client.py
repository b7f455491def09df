"""The client, for asyncio and without: reads, writes, services, frames and polls of one device line.

It waits and raises, and turns typed values into transfers and back; the service layer makes the exchanges.
For programs without asyncio a loop in a thread of its own does the work, so any number of threads may use one
client. See `AsyncClient` for the documentation of each method.
"""

from __future__ import annotations

import asyncio
import functools
import inspect
import math
import weakref
from collections.abc import Callable, Coroutine, Generator, Hashable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, Self, TypeVar, overload

from framekit.api.errors import ExchangeError, FramekitError, LineClosedError, NoReplyError, RequestError, error_of
from framekit.api.loop_thread import Closing, LoopStoppedError, LoopThread, with_arguments_of
from framekit.api.settings import ClientSettings, ProtocolGiven, checked_params, line_settings, protocol_of
from framekit.api.values import (
    Answer,
    FloatType,
    Frame,
    IntType,
    Reading,
    TextType,
    answered,
    asked,
    typed,
    typed_each,
    values_given,
)
from framekit.codec.result_names import ResultNames
from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import DefinitionError, no_such
from framekit.link.addresses import Address, AddressError
from framekit.link.events import Seen
from framekit.link.packing import Typed, Value
from framekit.link.services.client import MOST_KEPT, TransferResult
from framekit.link.values import FrameValue, plain
from framekit.memory.memory import DeviceMemory, DeviceMemoryError
from framekit.memory.views import Order
from framekit.run.commands import CommandBlocks, CommandEnd
from framekit.runfile.devices import memory_of
from framekit.service.client import Begin, ClientService, Polling
from framekit.service.device import DeviceService, devices_of, port_for
from framekit.service.run import LONGEST_SHUTDOWN, close_sessions
from framekit.transport.clock import AsyncioClock

OPEN_WITHIN = 15.0
"""Default time limit for opening a port (s)."""


class AsyncClient:
    """A client on a port, made by `framekit.aconnect`. `async with` opens and closes it; so do `await` and `close`.

    It belongs to the loop in which it was opened; its tasks may call it side by side. A call that is cancelled leaves
    the line in order: its reply is awaited and dropped before the next request goes out.
    """

    def __init__(
        self,
        settings: ClientSettings,
        *,
        open_within: float = OPEN_WITHIN,
        monitor: Callable[[Seen], None] | None = None,
    ) -> None:
        self.settings = settings
        self._result_names = ResultNames(settings.protocol)
        self._open_within = open_within
        self._monitor = monitor
        self._service: ClientService | None = None
        self._devices: list[DeviceService] = []
        self._troubles, self._last_trouble = 0, ""
        self._opening: asyncio.Future[None] | None = None
        self._waiting: list[tuple[tuple[str, ...], asyncio.Future[FrameValue]]] = []
        self._why = "it has not been opened"
        self._command_turn = asyncio.Lock()
        self._polls: list[Poll] = []
        self._known_reads: dict[Hashable, tuple[Typed, Any, Begin]] = {}

    def __repr__(self) -> str:
        settings = self.settings
        station = "" if settings.station is None else f", station {settings.station!r}"
        state = "open" if self.is_open else "not open"
        return f"<{type(self).__name__} of {settings.protocol.name} on {settings.port}{station}, {state}>"

    # ---- life ---------------------------------------------------------------------------------------------

    async def open(self) -> Self:
        """Open the port.

        Raises LineClosedError, DefinitionError for a wrong device, RequestError for an invalid port.
        """
        if self._service is not None:
            return self
        loop = asyncio.get_running_loop()
        self._service = service = self._make(AsyncioClock(loop))
        self._opening = loop.create_future()
        try:
            for device in self._devices:
                device.start()
            service.start()
            async with asyncio.timeout(self._open_within):
                await self._opening
        except TimeoutError:
            self.close_now()
            raise LineClosedError(f"{self.settings.port} did not open in {self._open_within:g} s", "closed") from None
        except BaseException:
            self.close_now()
            raise
        return self

    def _make(self, clock: AsyncioClock) -> ClientService:
        settings = self.settings
        self._known_reads.clear()
        channel = settings.channel()
        found = devices_of(channel, Path.cwd())
        try:
            port, self._devices = port_for(channel, found, clock)
            for device in self._devices:
                device.watch_troubles(self._trouble)
            return ClientService(
                settings.protocol, port, clock, role=settings.role, params=settings.params, line=settings.line,
                own=settings.own, on_state=self._on_state, on_frame=self._on_frame, monitor=self._monitor,
            )  # fmt: skip
        except ValueError as error:
            if isinstance(error, DefinitionError):
                raise
            raise RequestError(str(error)) from None

    def _trouble(self, what: str) -> None:
        """Note the failure of an action of a simulated device."""
        self._troubles, self._last_trouble = self._troubles + 1, what
        if self._monitor is not None:
            self._monitor(Seen("", "trouble", 0 if self._service is None else self._service.clock.now(), reason=what))

    def _new_trouble(self) -> Callable[[], str]:
        """Return a function that returns the last failure of a simulated device since its last call, or ''."""
        seen = self._troubles

        def trouble() -> str:
            nonlocal seen
            before, seen = seen, self._troubles
            return self._last_trouble if seen > before else ""

        return trouble

    async def close(self) -> None:
        """Close the port; calls under way raise LineClosedError. A second call has no effect.

        If the protocol has sessions, calls under way end and the session is closed first, within 5 s.
        """
        self._stop_polls()  # the session is closed when the line has come to rest
        service = self._service
        if service is not None:
            left = asyncio.Event()
            close_sessions((service,), service.clock, LONGEST_SHUTDOWN, left.set)
            await left.wait()
        self.close_now()
        await asyncio.sleep(0)

    def close_now(self) -> None:
        """Close the port without a turn of the loop: network connections end at its next turn."""
        self._stop_polls()
        service, self._service = self._service, None
        if service is None:
            return
        self._why = "it was closed"
        service.stop()
        for device in self._devices:
            device.end()
        self._fail_waiting()

    def __await__(self) -> Generator[Any, None, Self]:
        return self.open().__await__()

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(self, *error: object) -> None:
        await self.close()

    @property
    def is_open(self) -> bool:
        """Return whether the port is open now. A lost port is opened again automatically."""
        return self._service is not None and self._service.is_open

    @property
    def protocol(self) -> Protocol:
        """Return the definition of the protocol."""
        return self.settings.protocol

    def _on_state(self, is_open: bool, reason: str) -> None:
        opening = self._opening
        if not is_open:
            self._why = reason
            self._fail_waiting()
        if opening is not None and not opening.done():
            if is_open:
                opening.set_result(None)
            else:
                opening.set_exception(LineClosedError(reason, "closed", reason))

    def _working(self) -> ClientService:
        """Return the open service. Raises LineClosedError."""
        service = self._service
        if service is None or not service.driver.is_open:
            raise LineClosedError(f"{self.settings.port} is not open: {self._why}", "closed", self._why)
        return service

    # ---- reading ------------------------------------------------------------------------------------------

    @overload
    async def read(
        self, address: str, count: int = ..., *, station: Any = ..., type: IntType,
        order: Order | None = ..., params: Mapping[str, Any] | None = ...,
    ) -> Reading[int]: ...  # fmt: skip
    @overload
    async def read(
        self, address: str, count: int = ..., *, station: Any = ..., type: FloatType,
        order: Order | None = ..., params: Mapping[str, Any] | None = ...,
    ) -> Reading[float]: ...  # fmt: skip
    @overload
    async def read(
        self, address: str, count: int = ..., *, station: Any = ..., type: TextType,
        order: Order | None = ..., params: Mapping[str, Any] | None = ...,
    ) -> Reading[str]: ...  # fmt: skip
    @overload
    async def read(
        self, address: str, count: int = ..., *, station: Any = ..., type: str | None = ...,
        order: Order | None = ..., params: Mapping[str, Any] | None = ...,
    ) -> Reading[Any]: ...  # fmt: skip
    async def read(
        self, address: str, count: int = 1, *, station: Any = None, type: str | None = None,
        order: Order | None = None, params: Mapping[str, Any] | None = None,
    ) -> Reading[Any]:  # fmt: skip
        """Read `count` values from an address on; of a string, `count` characters.

        `type`: a unit of memory (`bit byte word dword lword`), or `int16`, `uint32`, `float32`, `string` …; default:
        the type that the protocol gives the place, else the unit of the address. `order`: order of the bytes of a
        number. `params`: other values of parameters, for this call. Raises RequestError, NoReplyError, RefusedError,
        ReplyError, LineClosedError.
        """
        service = self._working()
        how, to, begin = self._how(address, type, order, count, station)
        if params is not None:
            given = self._params(params)
            begin = lambda client, now, done: client.read(  # noqa: E731 - the read of `_how` has no parameters
                address, station=to, unit=how.unit, count=how.units, params=given, now=now, on_done=done
            )
        result = await self._transfer(service, begin)
        data = result.data
        return Reading(tuple(answered(how.values, data, result.values)), how.type, (address,), to, data, result.raw)

    def place(self, address: str) -> Address:
        """Return the place of an address, and its usual type. Raises RequestError, LineClosedError."""
        try:
            return self._working().client.grammar.parse(address)
        except AddressError as error:
            raise RequestError(str(error)) from None

    def _how(
        self, address: str, type: str | None, order: Order | None, count: int, station: Any
    ) -> tuple[Typed, Any, Begin]:
        """Return the conversion of the values, the station, and a function that begins the read, for repeated reads
        too.
        """
        key = (address, type, order, count, station, station.__class__)
        try:
            known = self._known_reads.get(key)
        except TypeError:  # such as a list of addresses
            known = None
        if known is None:
            to = self.settings.station_for(station)
            client = self._working().client
            how = typed(client.grammar, address, type, order, count)
            known = how, to, client.reading((address, how.unit, how.units, to)).start
            if len(self._known_reads) >= MOST_KEPT:
                self._known_reads.clear()
            self._known_reads[key] = known
        return known

    def poll(
        self, address: str, count: int = 1, *, on_values: OnValues, on_error: OnError | None = None,
        every: float = 0.0, station: Any = None, type: str | None = None, order: Order | None = None,
    ) -> Poll:  # fmt: skip
        """Read repeatedly until the poll is stopped; `on_values` gets the values of each reply, a tuple.

        A read begins `every` seconds after the previous; 0: as soon as the previous is answered. This costs a little
        less than a loop around `read`. A failed read is passed to `on_error`, and the next begins 0.1 s later at the
        earliest; without `on_error`, or if a callback raises, the poll ends, and `await` raises the error. Other
        arguments as for `read`. Raises RequestError, LineClosedError.
        """
        service = self._working()
        how, to, _ = self._how(address, type, order, count, station)
        try:
            poll = Poll(service, how, address, to, every, on_values, on_error, self._new_trouble())
        except (ValueError, DeviceMemoryError) as error:
            raise RequestError(str(error)) from None
        self._polls = [*(one for one in self._polls if one.is_running), poll]
        return poll

    def _stop_polls(self) -> None:
        for poll in self._polls:
            poll.stop()

    async def read_many(
        self, addresses: Sequence[str], *, station: Any = None, type: str | None = None, order: Order | None = None,
        params: Mapping[str, Any] | None = None,
    ) -> Reading[Any]:  # fmt: skip
        """Read one value of each address, in their order; in one request if the protocol has lists.

        Other arguments as for `read`.
        """
        service = self._working()
        to = self.settings.station_for(station)
        if type == "string":
            raise RequestError("read_many reads one number of each address – texts are read one by one")
        how = typed_each(service.client.grammar, addresses, type, order)
        result = await self._transfer(
            service,
            lambda client, now, done: client.read_variables(
                addresses, station=to, unit=how.unit, params=self._params(params), now=now, on_done=done
            ),
        )
        values = tuple(answered(how.values, result.values))
        return Reading(values, how.type, tuple(addresses), to, result.data, result.raw)

    # ---- writing ------------------------------------------------------------------------------------------

    async def write(
        self, address: str, values: Value | Sequence[Value], *, station: Any = None, type: str | None = None,
        order: Order | None = None, count: int | None = None, params: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Write a value, or several from an address on; a text is padded with 00 to `count` characters.

        `type` and `order` as for `read`; negative numbers are written as two's complement. Raises the errors of `read`;
        `written` of the error counts the values written before a later part failed.
        """
        service = self._working()
        to = self.settings.station_for(station)
        given = values_given(values)
        several = len(given[0]) if type == "string" and given and isinstance(given[0], str) else len(given)
        how = typed(service.client.grammar, address, type, order, several if count is None else count)
        numbers = asked(how.numbers, given)
        await self._transfer(
            service,
            lambda client, now, done: client.write(
                address, numbers, station=to, unit=how.unit, params=self._params(params), now=now, on_done=done
            ),
        )

    async def write_many(
        self, values: Mapping[str, int | float], *, station: Any = None, type: str | None = None,
        order: Order | None = None, params: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Write one value to each address; in one request if the protocol has lists. Other arguments as for `write`."""
        service = self._working()
        to = self.settings.station_for(station)
        if type == "string":
            raise RequestError("write_many writes one number to each address – texts are written one by one")
        addresses = list(values)
        how = typed_each(service.client.grammar, addresses, type, order)
        numbers = asked(how.numbers, list(values.values()))
        await self._transfer(
            service,
            lambda client, now, done: client.write_variables(
                addresses, numbers, station=to, unit=how.unit, params=self._params(params), now=now, on_done=done
            ),
        )

    # ---- services -----------------------------------------------------------------------------------------

    async def call(
        self, service: str, arguments: Mapping[str, Any] | None = None, *, station: Any = None,
        addresses: Sequence[str] = (), unit: str | None = None, count: int = 1,
        params: Mapping[str, Any] | None = None,
    ) -> Answer:  # fmt: skip
        """Run any other service of the protocol. A single address stands for `count` elements, several for one element
        each.

        Raises the errors of `read`.
        """
        working = self._working()
        to = self.settings.station_for(station, needed=False)
        result = await self._transfer(
            working,
            lambda client, now, done: client.call(
                service, arguments, station=to, addresses=addresses, unit=unit, count=count,
                params=self._params(params), now=now, on_done=done,
            )
        )  # fmt: skip
        reply = None if result.reply is None else frame_of(result.reply)
        return Answer(result.gives, reply, result.raw, self._result_names.by_path(service, result.gives))

    # ---- command blocks -----------------------------------------------------------------------------------

    def command_blocks(
        self, application: ProtocolGiven | None = None, memory: DeviceMemory | None = None
    ) -> CommandBlocks:
        """Return command blocks on this line, as an application of commands reads them; default: the application its
        protocol names.

        `memory`: memory with their data and status words; default: a memory with the application's areas. Raises
        DefinitionError and LineClosedError, ValueError if the application has no command blocks.
        """
        service = self._working()
        found = protocol_of(application or self.settings.protocol.commands_file)
        own = DeviceMemory(memory_of(found)[0]) if memory is None else memory
        engine, client = service.engine, service.client
        return CommandBlocks(found, own, channel=engine.scope, engine=engine, client=client, later=service.driver.later)

    async def command(self, blocks: CommandBlocks, words: bytes) -> CommandEnd:
        """Carry out the command block that begins with these bytes, and return its end, also after failures.

        Commands run one after the other: each sees the memory that the previous commands left. Raises RequestError if
        requests need a number of the own side, LineClosedError.
        """
        self.settings.check_own()
        future: asyncio.Future[CommandEnd] = asyncio.get_running_loop().create_future()
        station = self.settings.station
        turn = self._command_turn

        def ended(end: CommandEnd) -> None:
            turn.release()
            if not future.done():
                future.set_result(end)

        await turn.acquire()
        try:
            service = self._working()
        except LineClosedError:
            turn.release()
            raise
        service.driver.do(lambda now: blocks.start(words, station, now, ended))
        return await future

    def _params(self, params: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
        return None if params is None else checked_params(self.settings.protocol, params)

    async def _transfer(self, service: ClientService, begin: Begin) -> TransferResult:
        """Start a transfer and wait for it. Raises the error of the transfer."""
        trouble = self._new_trouble() if self._devices else str
        future: asyncio.Future[TransferResult] = asyncio.get_running_loop().create_future()
        done = partial(_settle, future)
        try:
            request = service.request(begin, done)
        except (ValueError, DeviceMemoryError) as error:
            raise RequestError(str(error)) from None
        try:
            result = await future
        except asyncio.CancelledError:
            service.give_up(request, done)
            raise
        if not result.ok:
            raise error_of(result, trouble())
        return result

    # ---- frames -------------------------------------------------------------------------------------------

    async def send(self, frame: str, fields: Mapping[str, Any] | None = None) -> None:
        """Send a frame without an exchange and return when it has left. Raises RequestError, LineClosedError."""
        service = self._working()
        self._known(frame)
        left: asyncio.Future[bool] = asyncio.get_running_loop().create_future()
        try:
            service.send(frame, fields or {}, lambda sent: None if left.done() else left.set_result(sent))
        except (ValueError, LookupError, TypeError) as error:
            raise RequestError(f"frame '{frame}': {explain(error)}") from None
        if not await left:
            raise LineClosedError(f"the line was closed before '{frame}' had left", "closed")

    async def wait_for(self, *frames: str, timeout: float | None = None) -> Frame:
        """Return the next frame of one of these names (of any, without names) that no exchange took.

        A frame that arrived before the call counts, unless it was taken. `timeout` in seconds. Raises NoReplyError
        after the timeout, LineClosedError, RequestError if the role receives frames only during exchanges.
        """
        service = self._working()
        for name in frames:
            self._known(name)
        role = None if self.settings.role is None else self.protocol.roles[self.settings.role]
        if role is not None and not any(lane.listen for lane in role.lanes):
            what = f"the role '{role.name}' listens only while it asks – connect with frames_alone=True"
            raise RequestError(what)
        available = service.take_frame(frames)
        if available is not None:
            return frame_of(available)
        future: asyncio.Future[FrameValue] = asyncio.get_running_loop().create_future()
        waiting = (frames, future)
        self._waiting.append(waiting)
        try:
            async with asyncio.timeout(timeout):
                return frame_of(await future)
        except TimeoutError:
            raise NoReplyError(f"no {' or '.join(frames) or 'frame'} came in {timeout:g} s", "timeout") from None
        finally:
            if waiting in self._waiting:
                self._waiting.remove(waiting)

    def _known(self, frame: str) -> None:
        if frame not in self.protocol.frames:
            raise RequestError(no_such(f"'{self.protocol.name}' has no frame", frame, self.protocol.frames))

    def _on_frame(self) -> None:
        """Pass a frame that no exchange took to the call that has waited longest."""
        assert self._service is not None
        for waiting in list(self._waiting):
            names, future = waiting
            if future.done():
                continue
            found = self._service.take_frame(names)
            if found is not None:
                future.set_result(found)
                self._waiting.remove(waiting)

    def _fail_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for _, future in waiting:
            if not future.done():
                future.set_exception(LineClosedError(f"the line was closed: {self._why}", "closed", self._why))


def aconnect(
    protocol: ProtocolGiven,
    port: str,
    *,
    station: Any = None,
    speed: int | None = None,
    format: str | None = None,
    params: Mapping[str, Any] | None = None,
    role: str | None = None,
    own: Any = None,
    frames_alone: bool = False,
    open_within: float = OPEN_WITHIN,
    monitor: Callable[[Seen], None] | None = None,
) -> AsyncClient:
    """Return a client for asyncio, opened by `async with` or `await`; see `framekit.connect` for the arguments."""
    settings = line_settings(
        protocol, port, role=role, frames_alone=frames_alone, speed=speed, format=format, own=own, station=station,
        params=params,
    )  # fmt: skip
    return AsyncClient(settings, open_within=open_within, monitor=monitor)


OnValues = Callable[[tuple[Any, ...]], None]
OnError = Callable[[FramekitError], None]


class Poll:
    """Reads that follow each other until `stop`, made by `AsyncClient.poll`. `reads` and `failures` count them.

    `await` waits for the end, and raises its error; a cancelled wait does not stop the polls. Raises ValueError for
    an impossible request.
    """

    def __init__(
        self, service: ClientService, how: Typed, address: str, station: Any, every: float, on_values: OnValues,
        on_error: OnError | None, trouble: Callable[[], str],
    ) -> None:  # fmt: skip
        if not isinstance(every, int | float) or not 0 <= every < math.inf:
            raise ValueError(f"every is {every!r}: it is the seconds from one read to the next, 0 or more")
        _check_callback("on_values", on_values)
        if on_error is not None:
            _check_callback("on_error", on_error)
        self.failures = 0
        self._address, self._every = address, every
        self._error: Exception | None = None
        self._reads = 0
        self._how = how
        self._on_values = on_values
        self._on_error = on_error
        self._trouble = trouble
        self._ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._polling = Polling(
            service, address, station=station, unit=how.unit, count=how.units, every=round(every * 1e9),
            on_result=self._result,
        )  # fmt: skip
        self._polling.start()

    @property
    def reads(self) -> int:
        """Return the number of successful reads."""
        return self._reads

    @property
    def is_running(self) -> bool:
        """Return whether polling continues."""
        return self._polling.is_running

    def stop(self) -> None:
        """Stop polling: no further callback is called."""
        self._polling.stop()
        if not self._ended.done():
            self._ended.set_result(None)

    def __repr__(self) -> str:
        how, first = self._how, self._address
        what = first if how.count == 1 else f"{how.count} × {how.type} from {first} on"
        often = f"every {self._every:g} s" if self._every else "without pause"
        state = "running" if self.is_running else "stopped"
        if not self.is_running and self._error is not None:
            state = f"ended by {self._error!r}"
        return f"<Poll of {what}, {often}: {self.reads} reads, {self.failures} failures, {state}>"

    def __await__(self) -> Generator[Any, None, None]:
        yield from asyncio.wait([self._ended]).__await__()  # a cancelled wait affects no other wait
        self._ended.result()

    def _result(self, result: TransferResult) -> None:
        try:
            if not result.ok:
                raise error_of(result, self._trouble())
            values = tuple(answered(self._how.values, result.data, result.values))
        except ExchangeError as error:
            self._failed(error)
        else:
            self._numbers(values)

    def _failed(self, error: ExchangeError) -> None:
        self.failures += 1
        if self._on_error is None:
            self._fail(error)
            return
        try:
            self._on_error(error)
        except Exception as another:
            self._fail(another)

    def _numbers(self, values: tuple[Any, ...]) -> None:
        self._reads += 1
        try:
            self._on_values(values)
        except Exception as error:  # any error belongs to the caller that waits for the end
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self._polling.stop()
        if not self._ended.done():
            self._error = error
            self._ended.set_exception(error)


def _check_callback(name: str, callback: object) -> None:
    """Raise ValueError for an object that is not callable, or is a coroutine function: its values would be lost
    silently.
    """
    if not callable(callback):
        raise ValueError(f"{name} has to be a plain function, not {callback!r}")
    if inspect.iscoroutinefunction(callback):
        raise ValueError(
            f"{name} has to be a plain function: it is called, not awaited – for tasks, hand over an asyncio.Queue's "
            "put_nowait"
        )


def _settle(future: asyncio.Future[TransferResult], result: TransferResult) -> None:
    """Set the result of a future, unless its waiter has been cancelled."""
    if not future.done():
        future.set_result(result)


def frame_of(value: FrameValue) -> Frame:
    """Return a frame of the engine in the form of the API."""
    fields = {name: plain(item) for name, item in value.complete().items()}
    return Frame(value.frame, fields, value.raw or b"", value.refusal)


# ---- without asyncio ------------------------------------------------------------------------------------------


T = TypeVar("T")
P = ParamSpec("P")


def _waiting(
    method: Callable[Concatenate[AsyncClient, P], Coroutine[Any, Any, T]],
) -> Callable[Concatenate[Client, P], T]:
    """Return a method that calls the method of the async client and waits for its end."""

    @functools.wraps(method)
    def call(self: Client, /, *arguments: P.args, **options: P.kwargs) -> T:
        return self.wait(method(self.client, *arguments, **options))

    return call


class Client(Closing):
    """A client on an open port, made by `framekit.connect`; `with` or `close` closes it.

    Threads may call it side by side. If a program does not close it, the port closes with the last reference to the
    client, or at the program's end. See `AsyncClient` for the arguments and results of `read_many`, `write`,
    `write_many`, `call`, `command`, `send` and `wait_for`.
    """

    def __init__(self, client: AsyncClient) -> None:
        self.client = client
        self._thread = LoopThread(f"framekit {client.settings.port}")
        self._end = weakref.finalize(self, self._thread.end_with, client.close_now, client.close)
        try:
            self.wait(client.open())
        except BaseException:
            self._end()
            raise

    def __repr__(self) -> str:
        return repr(self.client).replace("Async", "", 1)

    def close(self) -> None:
        """Close the port; calls under way in other threads raise LineClosedError. A second call has no effect."""
        self._end()

    @property
    def is_open(self) -> bool:
        """Return whether the port is open now. A lost port is opened again automatically."""
        return self.client.is_open

    @property
    def protocol(self) -> Protocol:
        """Return the definition of the protocol."""
        return self.client.protocol

    def place(self, address: str) -> Address:
        """Return the place of an address, and its usual type. Raises RequestError, LineClosedError."""
        return self.client.place(address)

    def wait(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Return the result of a coroutine of `client`."""
        try:
            return self._thread.wait(coroutine)
        except LoopStoppedError:
            raise LineClosedError(f"{self.client.settings.port} is not open: it was closed", "closed") from None

    # ---- read and write -----------------------------------------------------------------------------------

    @overload
    def read(
        self, address: str, count: int = ..., *, station: Any = ..., type: IntType,
        order: Order | None = ..., params: Mapping[str, Any] | None = ...,
    ) -> Reading[int]: ...  # fmt: skip
    @overload
    def read(
        self, address: str, count: int = ..., *, station: Any = ..., type: FloatType,
        order: Order | None = ..., params: Mapping[str, Any] | None = ...,
    ) -> Reading[float]: ...  # fmt: skip
    @overload
    def read(
        self, address: str, count: int = ..., *, station: Any = ..., type: TextType,
        order: Order | None = ..., params: Mapping[str, Any] | None = ...,
    ) -> Reading[str]: ...  # fmt: skip
    @overload
    def read(
        self, address: str, count: int = ..., *, station: Any = ..., type: str | None = ...,
        order: Order | None = ..., params: Mapping[str, Any] | None = ...,
    ) -> Reading[Any]: ...  # fmt: skip
    def read(
        self, address: str, count: int = 1, *, station: Any = None, type: str | None = None,
        order: Order | None = None, params: Mapping[str, Any] | None = None,
    ) -> Reading[Any]:  # fmt: skip
        """Read `count` values from an address on; see `AsyncClient.read`."""
        return self.wait(self.client.read(address, count, station=station, type=type, order=order, params=params))

    read_many = _waiting(AsyncClient.read_many)
    write = _waiting(AsyncClient.write)
    write_many = _waiting(AsyncClient.write_many)
    call = _waiting(AsyncClient.call)
    command = _waiting(AsyncClient.command)
    send = _waiting(AsyncClient.send)
    wait_for = _waiting(AsyncClient.wait_for)

    def command_blocks(
        self, application: ProtocolGiven | None = None, memory: DeviceMemory | None = None
    ) -> CommandBlocks:
        """Return command blocks on this line; see `AsyncClient.command_blocks`."""
        return self.client.command_blocks(application, memory)


@with_arguments_of(aconnect)
def connect(client: AsyncClient) -> Client:
    """Open a port and return a client with a protocol on it; `framekit.aconnect` does the same for asyncio.

    `protocol`: name or file of a definition, or a result of `framekit.load`. `port`: a device (`/dev/ttyUSB0`),
    `tcp://HOST:PORT`, a pyserial URL, or `sim:FILE[,FILE…]`, simulated devices in this process. `station`: default
    station of the other side for calls without a station. `speed`, `format` (such as `8E1`): default: the protocol's
    own. `params`: the protocol's parameters. `role`, `own`: role and station of this side, if the protocol leaves a
    choice. `frames_alone`: no exchanges; every received frame is for `wait_for`. `open_within`: seconds. `monitor` gets
    everything seen on the line, in another thread.

    Raises DefinitionError for a wrong definition, RequestError for settings that do not fit it, and LineClosedError.
    """
    return Client(client)
