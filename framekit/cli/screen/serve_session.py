"""What the live display shows of devices that serve on a port: each device as a channel, with everything on its line.

It starts and stops serving; how things are drawn is not known here.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from framekit.cli.screen.session import Session
from framekit.service.frame_log import FrameLog
from framekit.service.line_load import LineLoad
from framekit.service.live_view import LineOf, LiveView
from framekit.transport.clock import AsyncioClock

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from framekit.blocks.device import Device
    from framekit.definition.times import LineFormat
    from framekit.link.observe import Seen
    from framekit.service.serving import Serving


class ServeSession(Session):
    """Devices on one line; the first is channel 1, and shows what all of them hear."""

    def __init__(
        self, arguments: argparse.Namespace, devices: list[Device], line: LineFormat | None, duration: int | None
    ) -> None:
        self.title = f"serve {arguments.port}"
        self.devices = devices
        self.problems: list[str] = []
        self.serving: Serving | None = None
        self._lost: list[str] = []
        self._arguments = arguments
        self._line = line
        self._duration = duration
        self._stack = contextlib.ExitStack()
        self._opening: asyncio.Task[None] | None = None
        self._state = "opening"
        self._view: LiveView | None = None

    def begin(self) -> LiveView:
        clock = AsyncioClock(asyncio.get_running_loop())
        numbered = dict(enumerate(self.devices, 1))
        log = FrameLog(
            {number: device.protocol for number, device in numbered.items()},
            {number: device.role for number, device in numbered.items()},
            {number: device.params for number, device in numbered.items()},
        )
        load = LineLoad(self._line, clock.now())
        lines = {number: LineOf(self._name(device), lambda: self._state, load) for number, device in numbered.items()}
        self._view = LiveView(log, clock, lines)
        self._opening = asyncio.get_running_loop().create_task(self._open(clock, _watcher(log, load)))
        return self._view

    def _name(self, device: Device) -> str:
        own = f" station {device.station}" if device.station else ""
        return f"{device.protocol.name}{own}" + ("" if self._line is None else f" {self._line}")

    async def _open(self, clock: AsyncioClock, monitor: Callable[[str, int, Seen], None]) -> None:
        from framekit.cli.main import Failure
        from framekit.cli.serve_verb import begin, warnings_of

        for device in self.devices:
            self.problems += warnings_of(device)
        try:
            self.serving, served = await begin(
                self._arguments, self.devices, self._line, clock, monitor, self._lost.append, self._stack
            )
        except Failure as failure:
            self.failure = failure
        else:
            self._state = f"on {served.about}"

    @property
    def is_over(self) -> bool:
        late = self._duration is not None and self._view is not None and self._view.elapsed >= self._duration
        return late or self.failure is not None

    async def end(self) -> None:
        if self._opening is not None:
            self._opening.cancel()
            await asyncio.gather(self._opening, return_exceptions=True)
        self._stack.close()
        self.problems += self._lost
        self.lost = bool(self._lost)


def _watcher(log: FrameLog, load: LineLoad) -> Callable[[str, int, Seen], None]:
    """Every device hears what comes: the first one's ears are enough."""

    def watch(port: str, number: int, seen: Seen) -> None:
        sent = seen.direction == "out"
        if number and not sent and seen.kind != "trouble":
            return
        log.add(number + 1, seen)
        if sent:
            load.bytes_out += len(seen.raw)
        else:
            load.bytes_in += len(seen.raw)

    return watch
