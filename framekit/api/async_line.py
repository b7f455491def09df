"""A line to a device for asyncio: opening, closing, and frames sent and received by themselves.

It waits and raises; what goes over the line is the service layer's business. Transfers are built on top.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from framekit.api.errors import LineClosedError, NoReplyError, RequestError
from framekit.api.results import Frame
from framekit.api.settings import LineSettings
from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import DefinitionError, did_you_mean
from framekit.link.observe import Seen
from framekit.link.values import FrameValue, plain
from framekit.service.client import ClientService
from framekit.service.device import DeviceService
from framekit.service.ending import LONGEST_FAREWELL
from framekit.service.ports import devices_of, port_for
from framekit.transport.clock import AsyncioClock

OPEN_WITHIN = 15.0
"""How long opening a port may take where nothing else is said (s)."""


class AsyncLine:
    """A protocol's side of a line. `async with` opens and closes it; so do `await` and `close`."""

    def __init__(
        self, settings: LineSettings, *, open_within: float = OPEN_WITHIN, monitor: Callable[[Seen], None] | None = None
    ) -> None:
        self.settings = settings
        self._open_within = open_within
        self._monitor = monitor
        self._service: ClientService | None = None
        self._devices: list[DeviceService] = []
        self._troubles, self._last_trouble = 0, ""
        self._opening: asyncio.Future[None] | None = None
        self._waiting: list[tuple[tuple[str, ...], asyncio.Future[FrameValue]]] = []
        self._why = "it has not been opened"

    def __repr__(self) -> str:
        settings = self.settings
        station = "" if settings.station is None else f", station {settings.station!r}"
        state = "open" if self.is_open else "not open"
        return f"<{type(self).__name__} of {settings.protocol.name} on {settings.port}{station}, {state}>"

    # ---- life ---------------------------------------------------------------------------------------------

    async def open(self) -> Self:
        """Opens the port. Raises LineClosedError, DefinitionError for a wrong device, RequestError for no port."""
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
        """A simulated device could not do what it should."""
        self._troubles, self._last_trouble = self._troubles + 1, what
        if self._monitor is not None:
            self._monitor(Seen("", "trouble", 0 if self._service is None else self._service.clock.now(), reason=what))

    def _new_trouble(self) -> Callable[[], str]:
        """What tells the last thing that a simulated device could not do since it told before; '' for none."""
        told = self._troubles

        def tell() -> str:
            nonlocal told
            before, told = told, self._troubles
            return self._last_trouble if told > before else ""

        return tell

    async def close(self) -> None:
        """Closes the port; calls under way raise LineClosedError. Closing twice does nothing.

        Where the protocol has sessions, what is under way is waited for and the session closed first, for 5 s at most.
        """
        service = self._service
        if service is not None and service.has_session:
            left = asyncio.Event()
            service.close_session(left.set)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LONGEST_FAREWELL / 1e9):
                    await left.wait()
        self.close_now()
        await asyncio.sleep(0)

    def close_now(self) -> None:
        """As `close`, without letting the loop go on: network connections are told at its next turn."""
        service, self._service = self._service, None
        if service is None:
            return
        self._why = "it was closed"
        service.stop()
        for device in self._devices:
            device.stop()
        self._fail_waiting()

    def __await__(self) -> Generator[Any, None, Self]:
        return self.open().__await__()

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    @property
    def is_open(self) -> bool:
        """Whether the port is open now. One that was lost is opened again by itself."""
        return self._service is not None and self._service.is_open

    @property
    def protocol(self) -> Protocol:
        """The definition that is spoken."""
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
        """The service, which is open."""
        if self._service is None or not self._service.is_open:
            raise LineClosedError(f"{self.settings.port} is not open: {self._why}", "closed", self._why)
        return self._service

    # ---- frames -------------------------------------------------------------------------------------------

    async def send(self, frame: str, fields: Mapping[str, Any] | None = None) -> None:
        """Sends a frame by itself and returns when it has left. Raises RequestError, LineClosedError."""
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
        """The next frame of one of these names (of any, without names) that no exchange took.

        One that came before the call counts, if nobody took it. `timeout` in seconds. Raises NoReplyError when that is
        over, LineClosedError, RequestError where frames are only looked for during exchanges.
        """
        service = self._working()
        for name in frames:
            self._known(name)
        role = None if self.settings.role is None else self.protocol.roles[self.settings.role]
        if role is not None and not any(lane.listen for lane in role.lanes):
            what = f"the role '{role.name}' listens only while it asks – connect with frames_alone=True"
            raise RequestError(what)
        there = service.take_frame(frames)
        if there is not None:
            return frame_of(there)
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
            hint = did_you_mean(frame, self.protocol.frames)
            raise RequestError(f"'{self.protocol.name}' has no frame '{frame}'" + (f" – {hint}" if hint else ""))

    def _on_frame(self) -> None:
        """A frame that nobody took has come: whoever waits for it longest gets it."""
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


def frame_of(value: FrameValue) -> Frame:
    """A frame of the engine as users get it."""
    fields = {name: plain(item) for name, item in value.complete().items()}
    return Frame(value.frame, fields, value.raw or b"", value.refusal)
