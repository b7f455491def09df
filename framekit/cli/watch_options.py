"""Options with which a run or a server is watched: capture, status, log."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from framekit.cli.common import print_json
from framekit.cli.main import WrongWords

if TYPE_CHECKING:
    from framekit.service.capture import Capture
    from framekit.service.channel import ChannelService
    from framekit.service.run import RunService
    from framekit.transport.clock import Clock

LEVELS = ("debug", "info", "warning", "error")


def add_capture(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--capture", metavar="FILE", type=Path,
        help="write everything on the lines to FILE: JSON lines (.jsonl), else pcap, a file for each channel",
    )  # fmt: skip


def add_screen(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--screen", action="store_true", help="show it live in the terminal; needs the extra 'screen'")


def add_log(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--log", choices=LEVELS, metavar="LEVEL", help=f"log to standard error: {', '.join(LEVELS)}")


def add_watch(parser: argparse.ArgumentParser) -> None:
    """--screen, --ascii, --capture, --status, --status-every and --log."""
    add_screen(parser)
    parser.add_argument("--ascii", action="store_true", help="show bytes as ASCII instead of hex")
    add_capture(parser)
    parser.add_argument("--status", action="store_true", help="show the status of channels and blocks at the end")
    parser.add_argument(
        "--status-every", metavar="TIME", help="show the status of channels and blocks so often; SIGUSR1 shows it once"
    )
    add_log(parser)


def begin_log(level: str | None) -> None:
    """Sends the log of framekit to standard error; without a level nothing is logged."""
    if level is not None:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(name)s: %(message)s"))
        logger = logging.getLogger("framekit")
        logger.handlers[:] = [one for one in logger.handlers if isinstance(one, logging.NullHandler)] + [handler]
        logger.setLevel(level.upper())


def period_of(text: str | None) -> int:
    """The time of --status-every (ns); 0 without one. Raises WrongWords."""
    from framekit.definition.times import parse_time

    if text is None:
        return 0
    try:
        period = parse_time(text)
    except ValueError as error:
        raise WrongWords(f"--status-every: {error}") from None
    if not period:
        raise WrongWords("--status-every: write a time above 0")
    return period


class Watch:
    """Watches one run as the command line asks: `begin` before it starts, `end` when it has stopped."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        """Raises WrongWords."""
        self._path: Path | None = arguments.capture
        self._json: bool = arguments.json
        self._capture: Capture | None = None
        self._service: RunService | None = None
        self._captured: set[int] = set()
        self._missing: list[str] = []
        self._began = 0
        self._every = period_of(arguments.status_every)
        self._at_end: bool = arguments.status or arguments.status_every is not None
        begin_log(arguments.log)

    def begin(self, service: RunService, clock: Clock, silent: bool = False) -> None:
        """Puts the capture around the ports and asks for the times of the status, unless `silent`. Raises OSError."""
        self._service, self._began = service, clock.now()
        if self._path is not None:
            from framekit.service.capture import Capture

            self._capture = Capture(self._path, tuple(service.channels), clock)
            self._captured = set(service.channels)
            for number, channel in service.channels.items():
                self._tap(number, channel)
            service.on_channel = self._tap
        if silent:
            return
        if self._every:
            clock.call_at(self._began + self._every, self._next)
        if hasattr(signal, "SIGUSR1"):
            with contextlib.suppress(RuntimeError):
                asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, self.show)

    def _tap(self, number: int, channel: ChannelService) -> None:
        """Puts the capture around the port of a channel; one that came later has no place in it."""
        if self._capture is None:
            return
        if number in self._captured:
            channel.driver.port = self._capture.around(number, channel.driver.port)
        else:
            self._missing.append(f"channel {number} came later: it is not in the capture")

    def _next(self) -> None:
        if self._service is not None and self._service.running:
            self.show()
            clock = self._service.clock
            clock.call_at(clock.now() + self._every, self._next)

    def at_end(self) -> None:
        """Shows the status for the last time, where it was asked for."""
        if self._at_end:
            self.show()

    def show(self) -> None:
        """Prints the status as it is now."""
        from framekit.cli.status_output import status_data, status_text
        from framekit.service.status import run_status

        if self._service is None:
            return
        status = run_status(self._service)
        if self._json:
            print_json(status_data(status, self._began))
        else:
            print(f"\nstatus at {(status.at - self._began) / 1e9:.3f} s\n{status_text(status, self._began)}\n")
        sys.stdout.flush()

    def end(self) -> list[str]:
        """Ends the capture; what is not in it is told."""
        if self._capture is None:
            return []
        self._capture.close()
        return [*self._capture.troubles, *self._missing]
