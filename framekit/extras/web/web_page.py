"""The page of `--web`: it listens from the beginning of a verb, and shows a run, devices or another board."""

from __future__ import annotations

import argparse
import asyncio
import errno
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from framekit.api.monitor import FrameLog
from framekit.cli.common import VerbError, WordsError, print_json
from framekit.cli.web_option import NoPage
from framekit.definition.problems import error_text

if TYPE_CHECKING:
    from framekit import AsyncServer, Seen
    from framekit.api.monitor import LiveView
    from framekit.api.run import OnSeen, RunCalls, Tape
    from framekit.extras.web.messages import PageBoard
    from framekit.extras.web.server import WebServer

MISSING = (
    "the page needs starlette and uvicorn – install framekit with the extra 'web': pip install '.[web]' in its folder"
)


LOOK_EVERY = 1.0
"""Interval in seconds of the look at the devices of a run."""


class WebPage(NoPage):
    """The page of a command line, which already listens. Raises WordsError, VerbError."""

    switches_faults = True

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.server = _listening(arguments.web, arguments.web_token)
        """The server of the page."""
        self.log = FrameLog()
        """Frames of the run or of the devices, for the page."""
        self._json: bool = arguments.json
        self._view: LiveView | None = None

    def monitor(self, tape: Tape | None) -> OnSeen | Tape | None:
        """Return the monitor of a run: `tape`, or the page that shows it instead; both with --json."""
        shows = self.log.add
        if not self._json or tape is None:
            return shows

        def both(channel: int, seen: Seen) -> None:
            shows(channel, seen)
            tape.of(channel)(seen)

        return both

    @asynccontextmanager
    async def of_run(self, run: RunCalls) -> AsyncIterator[None]:
        """Show a run, not yet started, while the context lasts."""
        from framekit.api.run import view_of
        from framekit.extras.web.board import WebBoard
        from framekit.extras.web.server import watched
        from framekit.extras.web.shown import shown_devices, shown_run

        view = view_of(run, self.log)
        board = WebBoard(shown_run(run, view))

        def boards() -> list[WebBoard]:
            return [board, WebBoard(shown_devices(run, view))] if run.simulated else [board]

        async def follow() -> None:
            """Show other devices when an edit of the run has changed them."""
            before = run.simulated
            while True:
                await asyncio.sleep(LOOK_EVERY)
                if run.simulated != before:
                    before = run.simulated
                    self.server.show(*boards())

        async with self.shows(*boards(), to="fire and write"):
            following = watched(follow())
            try:
                yield
            finally:
                following.cancel()

    def watch(self, devices: AsyncServer) -> None:
        """Show the traffic of devices, not yet opened, on the page, in addition to their monitor."""
        from framekit.api.server import view_of_devices

        devices.offer_faults()
        before = devices.watch
        self._view = view_of_devices(devices, self.log, lambda: "open")
        shows = devices.watch
        if before is None or not self._json or shows is None:
            return

        def both(port: str, number: int, what: Seen) -> None:
            shows(port, number, what)
            before(port, number, what)

        devices.watch = both

    @asynccontextmanager
    async def of_devices(self, devices: AsyncServer) -> AsyncIterator[None]:
        """Show open devices while the context lasts."""
        if self._view is None:
            yield
            return
        from framekit.extras.web.board import WebBoard
        from framekit.extras.web.shown import shown_server

        async with self.shows(WebBoard(shown_server(devices, self._view)), to="set values and switch faults"):
            yield

    @asynccontextmanager
    async def shows(self, *boards: PageBoard, to: str) -> AsyncIterator[None]:
        """Show pages while the context lasts. `to`: the actions that the token allows; '' if there are none."""
        self.server.begin(*boards)
        self._tell(self.server, to)
        try:
            yield
        finally:
            await self.server.end()

    def _tell(self, server: WebServer, to: str) -> None:
        """Print the address of the page, and a generated token with the actions that it allows."""
        token = server.access.token if server.access.made and to else ""
        if self._json:
            print_json({"event": "web", "url": server.url} | ({"token": token} if token else {}))
        else:
            print(f"page: {server.url}" + (f" – to {to}: {server.url}#token={token}" if token else ""))
        sys.stdout.flush()


def _listening(place: str, token: str | None) -> WebServer:
    """Return the server, already listening. Raises WordsError, VerbError."""
    try:
        from framekit.extras.web.access import Access, kept_token
        from framekit.extras.web.server import WebServer, listening_at
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] == "framekit":
            raise
        raise VerbError(MISSING) from None
    try:
        host, port = listening_at(place)
    except ValueError as error:
        raise WordsError(f"--web: {error} – write a port such as 8040, or ADDRESS:PORT such as 0.0.0.0:8040") from None
    try:
        access = Access("" if token is None else kept_token(token))
    except (ValueError, OSError) as error:
        raise WordsError(f"--web-token: {error}") from None
    try:
        return WebServer(host, port, access)
    except OSError as error:
        in_use = error.errno == errno.EADDRINUSE
        why = "the address is in use – stop the program that uses it, or give another port, such as 0 for a free one"
        raise VerbError(f"--web {place}: {why if in_use else error_text(error)}") from None
