"""The client for programs without asyncio: the calls of the async client, each waiting for its end.

A loop in a thread of its own does the work, so any number of threads may use one client. No call is explained twice:
what it does is told at `AsyncClient`.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Coroutine, Mapping, Sequence
from types import TracebackType
from typing import Any, TypeVar, overload

from framekit.api.async_client import OPEN_WITHIN, AsyncClient
from framekit.api.errors import LineClosedError
from framekit.api.loop_thread import LoopStoppedError, LoopThread
from framekit.api.settings import ProtocolGiven, line_settings
from framekit.api.values import Answer, FloatType, Frame, IntType, Reading, TextType, Value
from framekit.definition.model.protocol import Protocol
from framekit.link.addresses import Address
from framekit.link.observe import Seen
from framekit.memory.memory import DeviceMemory
from framekit.memory.views import Order
from framekit.run.commands import CommandBlocks, CommandEnd

T = TypeVar("T")


class Client:
    """A client on an open port, made by `framekit.connect`; `with` or `close` closes it.

    Threads may call it side by side. Where a program forgets to close it, the port is closed when nobody has the client
    any more, or at the program's end.
    """

    def __init__(self, client: AsyncClient) -> None:
        self._client = client
        self._thread = LoopThread(f"framekit {client.settings.port}")
        self._end = weakref.finalize(self, _end, self._thread, client)
        try:
            self._wait(client.open())
        except BaseException:
            self._end()
            raise

    def __repr__(self) -> str:
        return repr(self._client).replace("Async", "", 1)

    def close(self) -> None:
        """Closes the port; calls under way in other threads raise LineClosedError. Closing twice does nothing."""
        self._end()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """Whether the port is open now. One that was lost is opened again by itself."""
        return self._client.is_open

    @property
    def protocol(self) -> Protocol:
        """The definition that is spoken."""
        return self._client.protocol

    def place(self, address: str) -> Address:
        """Where an address is, and what it usually holds. Raises RequestError, LineClosedError."""
        return self._client.place(address)

    def _wait(self, coroutine: Coroutine[Any, Any, T]) -> T:
        try:
            return self._thread.wait(coroutine)
        except LoopStoppedError:
            raise LineClosedError(f"{self._client.settings.port} is not open: it was closed", "closed") from None

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
        """`count` values from an address on."""
        return self._wait(self._client.read(address, count, station=station, type=type, order=order, params=params))

    def read_many(
        self, addresses: Sequence[str], *, station: Any = None, type: str | None = None, order: Order | None = None,
        params: Mapping[str, Any] | None = None,
    ) -> Reading[Any]:  # fmt: skip
        """One value of each address, in their order."""
        return self._wait(self._client.read_many(addresses, station=station, type=type, order=order, params=params))

    def write(
        self, address: str, values: Value | Sequence[Value], *, station: Any = None, type: str | None = None,
        order: Order | None = None, count: int | None = None, params: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Writes one value, or several from an address on."""
        self._wait(
            self._client.write(address, values, station=station, type=type, order=order, count=count, params=params)
        )

    def write_many(
        self, values: Mapping[str, int | float], *, station: Any = None, type: str | None = None,
        order: Order | None = None, params: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Writes one value to each address."""
        self._wait(self._client.write_many(values, station=station, type=type, order=order, params=params))

    def command_blocks(
        self, application: ProtocolGiven | None = None, memory: DeviceMemory | None = None
    ) -> CommandBlocks:
        """Command blocks on this line."""
        return self._client.command_blocks(application, memory)

    def command(self, blocks: CommandBlocks, words: bytes) -> CommandEnd:
        """Carries a command block out."""
        return self._wait(self._client.command(blocks, words))

    def call(
        self, service: str, arguments: Mapping[str, Any] | None = None, *, station: Any = None,
        addresses: Sequence[str] = (), unit: str | None = None, count: int = 1,
        params: Mapping[str, Any] | None = None,
    ) -> Answer:  # fmt: skip
        """Runs any other service of the protocol."""
        return self._wait(
            self._client.call(
                service, arguments, station=station, addresses=addresses, unit=unit, count=count, params=params
            )
        )

    # ---- frames -------------------------------------------------------------------------------------------

    def send(self, frame: str, fields: Mapping[str, Any] | None = None) -> None:
        """Sends a frame by itself and returns when it has left."""
        self._wait(self._client.send(frame, fields))

    def wait_for(self, *frames: str, timeout: float | None = None) -> Frame:
        """The next frame of one of these names that no exchange took; `timeout` in seconds."""
        return self._wait(self._client.wait_for(*frames, timeout=timeout))


def _end(thread: LoopThread, client: AsyncClient) -> None:
    """Closes the port and ends the thread."""
    try:
        if thread.is_here:
            client.close_now()
        else:
            thread.wait(client.close())
    except LoopStoppedError:
        return
    thread.stop()


def connect(
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
) -> Client:
    """Opens a port and speaks a protocol on it; `framekit.aconnect` does the same for asyncio.

    `protocol`: name or file of a definition, or what `framekit.load` gave. `port`: a device (`/dev/ttyUSB0`),
    `tcp://HOST:PORT`, a pyserial URL, or `sim:FILE[,FILE…]`, simulated devices in this process. `station`: the other
    side's where a call names none.
    `speed`, `format` (such as `8E1`): the protocol's own where they are not given. `params`: the protocol's parameters.
    `role`, `own`: what this side is, where the protocol leaves a choice. `frames_alone`: no exchanges; every frame that
    comes is for `wait_for`. `open_within`: seconds. `monitor` gets everything seen on the line, in another thread.

    Raises DefinitionError for a wrong definition, RequestError for settings that do not fit it, and LineClosedError.
    """
    settings = line_settings(
        protocol, port, role=role, frames_alone=frames_alone, speed=speed, format=format, own=own, station=station,
        params=params,
    )  # fmt: skip
    return Client(AsyncClient(settings, open_within=open_within, monitor=monitor))
