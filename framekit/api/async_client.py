"""The client for asyncio: reads, writes and services of one device line, as coroutines.

It turns typed values into transfers and back, and failures into exceptions.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Any, overload

from framekit.api.async_line import OPEN_WITHIN, AsyncLine, frame_of
from framekit.api.errors import LineClosedError, RequestError, error_of
from framekit.api.poll import OnError, OnValues, Poll
from framekit.api.results import Answer, Reading
from framekit.api.settings import LineSettings, ProtocolGiven, checked_params, line_settings, protocol_of
from framekit.api.typed import FloatType, IntType, Order, TextType, Typed, Value, typed, typed_each, values_given
from framekit.blocks.commands import CommandBlocks, CommandEnd
from framekit.blocks.load_channel import needs_own
from framekit.blocks.memory_settings import memory_of
from framekit.codec.codec import compile_protocol
from framekit.link.addresses import Address, AddressError
from framekit.link.observe import Seen
from framekit.link.services.client import MOST_KEPT, TransferResult
from framekit.memory.memory import DeviceMemory, DeviceMemoryError
from framekit.service.client import Begin


class AsyncClient(AsyncLine):
    """A client on a port, made by `framekit.aconnect`. `async with` opens and closes it; so do `await` and `close`.

    It belongs to the loop in which it was opened; its tasks may call it side by side. A call that is cancelled leaves
    the line in order: what was asked is waited for and dropped before the next request goes out.
    """

    def __init__(
        self, settings: LineSettings, *, open_within: float = OPEN_WITHIN, monitor: Callable[[Seen], None] | None = None
    ) -> None:
        super().__init__(settings, open_within=open_within, monitor=monitor)
        self._command_turn = asyncio.Lock()
        self._polls: list[Poll] = []
        self._known_reads: dict[tuple[str, str | None, Order | None, int], Typed] = {}

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
        """`count` values from an address on; of a string, so many characters.

        `type`: a unit of memory (`bit byte word dword lword`), or `int16`, `uint32`, `float32`, `string` …; default:
        what the protocol says such a place holds, else the address's own unit. `order`: where their bytes stand.
        `params`: other values of parameters, for this call.
        Raises RequestError, NoReplyError, RefusedError, ReplyError, LineClosedError.
        """
        self._working()
        to = self.settings.station_for(station)
        how = self._how(address, type, order, count)
        result = await self._transfer(
            lambda client, now, done: client.read(
                address, station=to, unit=how.unit, count=how.units, params=self._params(params), now=now, on_done=done
            )
        )
        return self._reading(how, result, (address,), to)

    def place(self, address: str) -> Address:
        """Where an address is, and what it usually holds. Raises RequestError, LineClosedError."""
        try:
            return self._working().client.grammar.parse(address)
        except AddressError as error:
            raise RequestError(str(error)) from None

    def _how(self, address: str, type: str | None, order: Order | None, count: int) -> Typed:
        """As `typed`, once for reads that are repeated."""
        key = (address, type, order, count)
        try:
            how = self._known_reads.get(key)
        except TypeError:  # a list of addresses, say
            how = None
        if how is None:
            how = typed(self._working().client.grammar, address, type, order, count)
            if len(self._known_reads) >= MOST_KEPT:
                self._known_reads.clear()
            self._known_reads[key] = how
        return how

    def poll(
        self, address: str, count: int = 1, *, on_values: OnValues, on_error: OnError | None = None,
        every: float = 0.0, station: Any = None, type: str | None = None, order: Order | None = None,
    ) -> Poll:  # fmt: skip
        """Reads again and again until it is stopped; `on_values` gets the values of each reply, a tuple.

        A read begins `every` seconds after the one before; 0: as soon as that is answered. This costs far less than a
        loop around `read`. A read that fails goes to `on_error`, and the next begins 0.1 s later at the earliest;
        without `on_error`, or when a callback raises, that is the end, and `await` raises it. Other arguments as for
        `read`. Raises RequestError, LineClosedError.
        """
        service = self._working()
        to = self.settings.station_for(station)
        how = self._how(address, type, order, count)
        try:
            poll = Poll(service, how, address, to, every, on_values, on_error, self._new_trouble())
        except (ValueError, DeviceMemoryError) as error:
            raise RequestError(str(error)) from None
        self._polls = [*(one for one in self._polls if one.is_running), poll]
        return poll

    async def close(self) -> None:
        self._stop_polls()  # the session is closed when the line has come to rest
        await super().close()

    def close_now(self) -> None:
        self._stop_polls()
        super().close_now()

    def _stop_polls(self) -> None:
        for poll in self._polls:
            poll.stop()

    async def read_many(
        self, addresses: Sequence[str], *, station: Any = None, type: str | None = None, order: Order | None = None,
        params: Mapping[str, Any] | None = None,
    ) -> Reading[Any]:  # fmt: skip
        """One value of each address, in their order; in one request where the protocol has lists. Else as `read`."""
        service = self._working()
        to = self.settings.station_for(station)
        if type == "string":
            raise RequestError("read_many reads one number of each address – texts are read one by one")
        how = typed_each(service.client.grammar, addresses, type, order)
        result = await self._transfer(
            lambda client, now, done: client.read_variables(
                addresses, station=to, unit=how.unit, params=self._params(params), now=now, on_done=done
            )
        )
        values = tuple(how.values(result.values))
        return Reading(values, how.type, tuple(addresses), to, result.data, result.raw)

    @staticmethod
    def _reading(how: Typed, result: TransferResult, addresses: tuple[str, ...], station: Any) -> Reading[Any]:
        values = tuple(how.values(result.data, result.values))
        return Reading(values, how.type, addresses, station, result.data, result.raw)

    # ---- writing ------------------------------------------------------------------------------------------

    async def write(
        self, address: str, values: Value | Sequence[Value], *, station: Any = None, type: str | None = None,
        order: Order | None = None, count: int | None = None, params: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Writes one value, or several from an address on; a text is filled up with 00 to `count` characters.

        `type` and `order` as for `read`; negative numbers are written as two's complement. Raises what `read` raises;
        `written` of the error counts what was written before a later part failed.
        """
        service = self._working()
        to = self.settings.station_for(station)
        given = values_given(values)
        several = len(given[0]) if type == "string" and given and isinstance(given[0], str) else len(given)
        how = typed(service.client.grammar, address, type, order, several if count is None else count)
        numbers = how.numbers(given)
        await self._transfer(
            lambda client, now, done: client.write(
                address, numbers, station=to, unit=how.unit, params=self._params(params), now=now, on_done=done
            )
        )

    async def write_many(
        self, values: Mapping[str, int | float], *, station: Any = None, type: str | None = None,
        order: Order | None = None, params: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Writes one value to each address; in one request where the protocol has lists. Else as `write`."""
        service = self._working()
        to = self.settings.station_for(station)
        if type == "string":
            raise RequestError("write_many writes one number to each address – texts are written one by one")
        addresses = list(values)
        how = typed_each(service.client.grammar, addresses, type, order)
        numbers = how.numbers(list(values.values()))
        await self._transfer(
            lambda client, now, done: client.write_variables(
                addresses, numbers, station=to, unit=how.unit, params=self._params(params), now=now, on_done=done
            )
        )

    # ---- services -----------------------------------------------------------------------------------------

    async def call(
        self, service: str, arguments: Mapping[str, Any] | None = None, *, station: Any = None,
        addresses: Sequence[str] = (), unit: str | None = None, count: int = 1,
        params: Mapping[str, Any] | None = None,
    ) -> Answer:  # fmt: skip
        """Runs any other service of the protocol. One address stands for `count` elements, several for one each.

        Raises what `read` raises.
        """
        self._working()
        to = self.settings.station_for(station, needed=False)
        result = await self._transfer(
            lambda client, now, done: client.call(
                service, arguments, station=to, addresses=addresses, unit=unit, count=count,
                params=self._params(params), now=now, on_done=done,
            )
        )  # fmt: skip
        return Answer(result.gives, None if result.reply is None else frame_of(result.reply), result.raw)

    # ---- command blocks -----------------------------------------------------------------------------------

    def command_blocks(
        self, application: ProtocolGiven | None = None, memory: DeviceMemory | None = None
    ) -> CommandBlocks:
        """Command blocks on this line, as an application of commands reads them; default: the one its protocol names.

        `memory`: where their data and status words stand; default: one with the application's areas. Raises
        DefinitionError and LineClosedError, ValueError when the application has no command blocks.
        """
        service = self._working()
        found = protocol_of(application or self.settings.protocol.commands_file)
        own = DeviceMemory(memory_of(found)[0]) if memory is None else memory
        return CommandBlocks(
            found,
            compile_protocol(found),
            own,
            channel=service.engine.scope,
            engine=service.engine,
            client=service.client,
        )

    async def command(self, blocks: CommandBlocks, words: bytes) -> CommandEnd:
        """Carries out the command block that begins with these bytes; how it ended, failures too.

        One is carried out after the other, whoever asks: each finds the memory as those before have left it. Raises
        RequestError where requests need a number of the own side, LineClosedError.
        """
        if self.settings.own is None and needs_own(self.settings.protocol):
            raise RequestError(
                f"requests of '{self.settings.protocol.name}' name the asking side – say its number as own (--own N)"
            )
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

    async def _transfer(self, begin: Begin) -> TransferResult:
        """Starts a transfer and waits for it. Raises what it failed with."""
        service = self._working()
        trouble = self._new_trouble() if self._devices else str
        future: asyncio.Future[TransferResult] = asyncio.get_running_loop().create_future()
        try:
            request = service.request(begin, lambda result: None if future.done() else future.set_result(result))
        except (ValueError, DeviceMemoryError) as error:
            raise RequestError(str(error)) from None
        try:
            result = await future
        except asyncio.CancelledError:
            service.give_up(request)
            raise
        if not result.ok:
            raise error_of(result, trouble())
        return result


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
    """A client for asyncio, opened by `async with` or `await`; see `framekit.connect` for the arguments."""
    settings = line_settings(
        protocol, port, role=role, frames_alone=frames_alone, speed=speed, format=format, own=own, station=station,
        params=params,
    )  # fmt: skip
    return AsyncClient(settings, open_within=open_within, monitor=monitor)
