"""The client for programs without asyncio: the calls of the async client, each waiting for its end.

A loop in a thread of its own does the work, so any number of threads may use one client. No call is explained twice:
what it does is told at `AsyncClient`.
"""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Concatenate, ParamSpec, TypeVar, overload

from framekit.api.async_client import AsyncClient, aconnect
from framekit.api.errors import LineClosedError
from framekit.api.loop_thread import Closing, LoopStoppedError, LoopThread, with_arguments_of
from framekit.api.settings import ProtocolGiven
from framekit.api.values import FloatType, IntType, Reading, TextType
from framekit.definition.model.protocol import Protocol
from framekit.link.addresses import Address
from framekit.memory.memory import DeviceMemory
from framekit.memory.views import Order
from framekit.run.commands import CommandBlocks

T = TypeVar("T")
P = ParamSpec("P")


def _waiting(
    method: Callable[Concatenate[AsyncClient, P], Coroutine[Any, Any, T]],
) -> Callable[Concatenate[Client, P], T]:
    """The call that waits for the end of the async client's."""

    @functools.wraps(method)
    def call(self: Client, /, *arguments: P.args, **options: P.kwargs) -> T:
        return self.wait(method(self.client, *arguments, **options))

    return call


class Client(Closing):
    """A client on an open port, made by `framekit.connect`; `with` or `close` closes it.

    Threads may call it side by side. Where a program forgets to close it, the port closes when nothing refers to
    the client any more, or at the program's end. `read_many`, `write`, `write_many`, `call`, `command`, `send` and
    `wait_for` take and give what those of `AsyncClient` do.
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
        """Closes the port; calls under way in other threads raise LineClosedError. Closing twice does nothing."""
        self._end()

    @property
    def is_open(self) -> bool:
        """Whether the port is open now. One that was lost is opened again by itself."""
        return self.client.is_open

    @property
    def protocol(self) -> Protocol:
        """The definition that is spoken."""
        return self.client.protocol

    def place(self, address: str) -> Address:
        """Where an address is, and what it usually holds. Raises RequestError, LineClosedError."""
        return self.client.place(address)

    def wait(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """The result of a coroutine of `client`."""
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
        """`count` values from an address on."""
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
        """Command blocks on this line."""
        return self.client.command_blocks(application, memory)


@with_arguments_of(aconnect)
def connect(client: AsyncClient) -> Client:
    """Opens a port and speaks a protocol on it; `framekit.aconnect` does the same for asyncio.

    `protocol`: name or file of a definition, or what `framekit.load` gave. `port`: a device (`/dev/ttyUSB0`),
    `tcp://HOST:PORT`, a pyserial URL, or `sim:FILE[,FILE…]`, simulated devices in this process. `station`: the other
    side's where a call names none.
    `speed`, `format` (such as `8E1`): the protocol's own where they are not given. `params`: the protocol's parameters.
    `role`, `own`: what this side is, where the protocol leaves a choice. `frames_alone`: no exchanges; every frame that
    comes is for `wait_for`. `open_within`: seconds. `monitor` gets everything seen on the line, in another thread.

    Raises DefinitionError for a wrong definition, RequestError for settings that do not fit it, and LineClosedError.
    """
    return Client(client)
