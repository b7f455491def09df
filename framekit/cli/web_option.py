"""The option `--web` of `run`, `serve` and `guess`: a page that shows them in a browser while they run."""

from __future__ import annotations

import argparse
import errno
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from framekit.cli.common import VerbError, WordsError, print_json
from framekit.definition.problems import error_text

if TYPE_CHECKING:
    from framekit import AsyncServer, Seen
    from framekit.api.monitor import LiveView
    from framekit.api.run import OnSeen, RunCalls, Tape
    from framekit.extras.web.messages import PageBoard
    from framekit.extras.web.server import WebServer

USUAL = "127.0.0.1:8040"
MISSING = (
    "the page needs starlette and uvicorn – install framekit with the extra 'web': pip install '.[web]' in its folder"
)


def add_web(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--web", nargs="?", const=USUAL, metavar="ADDRESS:PORT", type=_no_file,
        help=f"show a page in the browser, at {USUAL} unless said, port 0 for a free one; needs the extra 'web'",
    )  # fmt: skip
    parser.add_argument(
        "--web-token", metavar="env:NAME|file:NAME",
        help="where the token stands with which the page fires and writes; without it one is made and told",
    )  # fmt: skip


def _no_file(text: str) -> str:
    """Return the value of `--web`; refuse a file that was meant as the run. Raises ArgumentTypeError."""
    if text.endswith((".yaml", ".yml")):
        raise argparse.ArgumentTypeError(f"'{text}' is no place to listen on – write files before --web")
    return text


class WebPage:
    """The page of a command line, which already listens, or no page. Raises WordsError, VerbError."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.server: WebServer | None = None
        self._json: bool = arguments.json
        self._view: LiveView | None = None
        if arguments.web is not None:
            from framekit.api.monitor import FrameLog

            self.server = _listening(arguments.web, arguments.web_token)
            self.log = FrameLog()
        elif arguments.web_token is not None:
            raise WordsError("--web-token has no effect without --web")

    def monitor(self, tape: Tape | None) -> OnSeen | Tape | None:
        """Return the monitor of a run: `tape`, or the page that shows it instead; both with --json."""
        if self.server is None:
            return tape
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
        if self.server is None:
            yield
            return
        from framekit.api.run import view_of
        from framekit.extras.web.board import WebBoard
        from framekit.extras.web.shown import shown_run

        async with self.shows(WebBoard(shown_run(run, view_of(run, self.log)))):
            yield

    def watch(self, devices: AsyncServer) -> None:
        """Show the traffic of devices, not yet opened, on the page, in addition to their monitor."""
        if self.server is None:
            return
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
        if self.server is None or self._view is None:
            yield
            return
        from framekit.extras.web.board import WebBoard
        from framekit.extras.web.shown import shown_server

        async with self.shows(WebBoard(shown_server(devices, self._view)), "set values and switch faults"):
            yield

    @asynccontextmanager
    async def shows(self, board: PageBoard, to: str = "fire and write") -> AsyncIterator[None]:
        """Show a board while the context lasts. `to`: the actions that the token allows; '' if there are none."""
        assert self.server is not None
        self.server.begin(board)
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
        why = "the address is in use – end what is there, or give another port, such as 0 for a free one"
        raise VerbError(f"--web {place}: {why if in_use else error_text(error)}") from None
