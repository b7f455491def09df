"""What the live display runs: a run file, on real or simulated time, or a monitor of one line.

It starts and stops the service, and moves simulated time on; how things are drawn is not known here.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

from framekit.service.frame_log import FrameLog
from framekit.service.live_view import LineOf, LiveView
from framekit.transport.clock import AsyncioClock, Clock, VirtualClock

if TYPE_CHECKING:
    import argparse

    from framekit.blocks.model import Run
    from framekit.cli.watch_options import Watch
    from framekit.definition.model.protocol import Protocol
    from framekit.service.capture import Capture
    from framekit.service.channel import ChannelService
    from framekit.service.line_monitor import LineMonitor
    from framekit.service.run import RunService


class Session:
    """Something that can be watched. `begin` is called inside the loop and gives what is to be shown."""

    title = ""
    problems: list[str]
    """What is told when it is over."""
    lost = False
    """Whether something is lost that should have been kept."""
    failure: Exception | None = None
    """Why it could not go on."""
    controls = False
    """Whether it takes control lines."""

    def control(self, line: str) -> str:
        """Carries a control line out; why not, when it cannot be."""
        raise NotImplementedError

    def begin(self) -> LiveView:
        raise NotImplementedError

    def step(self, duration: int) -> None:
        """So much real time (ns) has passed."""

    @property
    def is_over(self) -> bool:
        """Whether its time is up."""
        return False

    async def end(self) -> None:
        raise NotImplementedError


class RunSession(Session):
    """A run; with `virtual` on simulated time that goes on as real time does. `duration` None: until it is ended.

    `controlled`: it takes control lines.
    """

    def __init__(
        self, run: Run, watch: Watch, *, virtual: bool, duration: int | None, controlled: bool = False
    ) -> None:
        self.controls = controlled
        self.title = f"run {run.name}"
        self.run = run
        self.watch = watch
        self.service: RunService | None = None
        self.problems: list[str] = []
        self._duration = duration
        self._virtual = VirtualClock() if virtual else None
        self._view: LiveView | None = None
        self._stopped = False

    def control(self, line: str) -> str:
        from framekit.service.control import ControlError, carry_out

        if line.strip().lower() == "stop":
            self._stopped = True
        elif self.service is not None:
            try:
                carry_out(self.service, line)
            except ControlError as error:
                return str(error)
        return ""

    def begin(self) -> LiveView:
        """Raises DefinitionError, ValueError, OSError."""
        from framekit.service.run import RunService

        clock: Clock = self._virtual or AsyncioClock(asyncio.get_running_loop())
        channels = self.run.channels
        log = FrameLog(
            {number: channel.protocol for number, channel in channels.items()},
            {number: channel.role for number, channel in channels.items()},
            {number: channel.params for number, channel in channels.items()},
        )
        self.service = service = RunService(self.run, clock, log.add)
        self.watch.begin(service, clock, silent=True)
        lines = {number: _line_of(channel) for number, channel in service.channels.items()}
        tapped = service.on_channel

        def came(number: int, channel: ChannelService) -> None:
            """A channel that jobs wanted."""
            model = channel.channel
            log.know(number, model.protocol, model.role, model.params)
            lines[number] = _line_of(channel)
            tapped(number, channel)

        service.on_channel = came
        self._view = LiveView(log, clock, lines, service.status)
        service.start()
        return self._view

    def step(self, duration: int) -> None:
        if self._virtual is not None:
            self._virtual.run_for(duration)

    @property
    def is_over(self) -> bool:
        if self._stopped:
            return True
        return self._duration is not None and self._view is not None and self._view.elapsed >= self._duration

    async def end(self) -> None:
        if self.service is not None:
            left = asyncio.Event()
            self.service.finish(left.set)
            if self._virtual is None:
                await left.wait()
            while not left.is_set() and self._virtual is not None and self._virtual.advance():
                pass
            self.problems = [*self.service.problems, *self.watch.end()]
            self.lost = bool(self.problems)


def _line_of(channel: ChannelService) -> LineOf:
    model = channel.channel
    line = "" if model.line is None else f" {model.line}"
    return LineOf(f"{model.protocol.name} {model.role or ''}".rstrip() + line, _state(channel), channel.driver.load)


def _state(channel: ChannelService) -> Callable[[], str]:
    return lambda: channel.state


class MonitorSession(Session):
    """A line between others."""

    def __init__(self, protocol: Protocol, arguments: argparse.Namespace, duration: int | None) -> None:
        self.title = f"monitor {arguments.port}"
        self.protocol = protocol
        self.problems: list[str] = []
        self._arguments = arguments
        self._duration = duration
        self._monitor: LineMonitor | None = None
        self._capture: Capture | None = None
        self._view: LiveView | None = None
        self._state = "opening"

    def begin(self) -> LiveView:
        """Raises Failure, OSError."""
        from framekit.cli.line_options import params_of
        from framekit.cli.monitor_verb import monitor_of

        clock = AsyncioClock(asyncio.get_running_loop())
        log = FrameLog({1: self.protocol}, params={1: params_of(self._arguments)})

        def state(text: str) -> None:
            self._state = text

        self._monitor, self._capture = monitor_of(
            self.protocol, self._arguments, clock, lambda seen: log.add(1, seen), state
        )
        settings = self._monitor.port.settings
        name = self.protocol.name + ("" if settings is None else f" {settings}")
        self._view = LiveView(log, clock, {1: LineOf(name, lambda: self._state, self._monitor.load)})
        self._monitor.start()
        return self._view

    @property
    def is_over(self) -> bool:
        return self._duration is not None and self._view is not None and self._view.elapsed >= self._duration

    async def end(self) -> None:
        if self._monitor is not None:
            self._monitor.stop()
        if self._capture is not None:
            self._capture.close()
            self.problems = self._capture.troubles
            self.lost = bool(self.problems)
