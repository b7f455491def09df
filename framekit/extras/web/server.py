"""The server of the pages: Starlette on uvicorn, in the loop of the run or the devices.

The pages are a few files of their own, and one WebSocket for each browser. Messages of browsers are bounded in size and
number. A message that a browser does not take is dropped, so that it delays neither the run nor other browsers.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
from collections import Counter
from collections.abc import Coroutine, Iterator
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from framekit.extras.web.access import HEADERS, Access, is_known_host, is_own_origin
from framekit.extras.web.assets import chart_files, page_files
from framekit.extras.web.messages import PageBoard, PageSession, as_text
from framekit.extras.web.patience import ImpatientProtocol
from framekit.transport.network import bracketed
from framekit.transport.network import listening_at as listening_at

log = logging.getLogger(__name__)
logging.getLogger("uvicorn").addHandler(logging.NullHandler())

MOST_BROWSERS = 16
MOST_BROWSERS_OF_AN_ADDRESS = 8
MOST_CONNECTIONS = 64
MOST_ACTIONS = 8
"""Browsers and connections at a time, and open actions of one browser."""
MESSAGE_EVERY = 0.02
"""Seconds that the next message of a browser waits."""
SHOWN_EVERY = 0.2
AFTER_WRONG = 1.0
MOST_WRONG = 3
LONGEST_SEND = 30.0
LONGEST_END = 2
"""Seconds between two updates and after a wrong token; wrong tokens that end a connection; seconds for the sending of a
message, and for the end of the server."""


class Guard:
    """Refuse requests of other web pages, and put the headers on every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return

        async def told(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        headers = Headers(scope=scope)
        if is_known_host(headers.get("host", "")) and is_own_origin(headers):
            await self.app(scope, receive, told)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await PlainTextResponse("this name does not lead here", 403)(scope, receive, told)


class PageApp:
    """The routes, and the connected browsers. Until `show` has pages, browsers are refused."""

    def __init__(self, access: Access) -> None:
        self.access = access
        self.boards: dict[str, PageBoard] = {}
        """The pages by path: the first at `/`, each other one at its name."""
        self.browsers: Counter[str] = Counter()
        """Connected browsers by their address."""
        self._connected: set[Browser] = set()
        self._files = page_files() | chart_files()
        routes = [
            Route("/{name}", self._file), Route("/", self._file),
            WebSocketRoute("/live", self._live), WebSocketRoute("/live/{name}", self._live),
        ]  # fmt: skip
        self._app = Starlette(routes=routes)
        self.app: ASGIApp = Guard(self._app)

    def show(self, *boards: PageBoard) -> None:
        """Show these pages from now on; browsers of a page that is not among them connect again."""
        self.boards = {board.name.lower() if number else "": board for number, board in enumerate(boards)}
        for browser in self._connected:
            if browser.board not in boards:
                browser.leave()

    @property
    def _links(self) -> list[list[str]]:
        """Return path and name of each page."""
        return [[path, board.name] for path, board in self.boards.items()]

    async def _file(self, request: Request) -> Response:
        name = request.path_params.get("name", "")
        board = self.boards.get(name)
        file = self._files.get(name if board is None else board.home)
        return PlainTextResponse("Not Found", 404) if file is None else Response(file.content, media_type=file.kind)

    async def _live(self, socket: WebSocket) -> None:
        client = socket.client
        host = "" if client is None else client.host
        is_full = self.browsers.total() >= MOST_BROWSERS or self.browsers[host] >= MOST_BROWSERS_OF_AN_ADDRESS
        board = self.boards.get(socket.path_params.get("name", ""))
        if board is None or is_full:
            await socket.close(1013)
            return
        who = "a browser" if client is None else f"{client.host}:{client.port}"
        browser = Browser(socket, board, board.session(self.access, who), who, self._links)
        self.browsers[host] += 1
        self._connected.add(browser)
        try:
            await socket.accept()
            await browser.attend()
        finally:
            self._connected.discard(browser)
            self.browsers[host] -= 1
            self.browsers += Counter()  # without addresses that have no browser


class Browser:
    """A connection to one browser, as long as it lasts. `links`: path and name of each page."""

    def __init__(
        self, socket: WebSocket, board: PageBoard, session: PageSession, who: str, links: list[list[str]]
    ) -> None:
        self.socket, self.board, self.session, self.who, self.links = socket, board, session, who, links
        self._actions: set[asyncio.Task[None]] = set()
        self._failed = asyncio.Event()
        """Set when the page connects again: after an error of sending or of an action, and for a new page."""

    def leave(self) -> None:
        """Close the connection, because its page is no longer shown."""
        self._failed.set()

    async def attend(self) -> None:
        """Send changes and carry out actions until the browser disconnects, breaks a rule, or cannot be served."""
        hearing = asyncio.ensure_future(self._hear())
        tasks: list[asyncio.Task[Any]] = [
            hearing, asyncio.ensure_future(self._show()), asyncio.ensure_future(self._failed.wait())
        ]  # fmt: skip
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            is_here = not hearing.done() or hearing.result()
            tasks += self._actions
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
        if is_here:
            with contextlib.suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
                async with asyncio.timeout(LONGEST_END):
                    await self.socket.close(1011 if self._failed.is_set() else 1008)

    async def _hear(self) -> bool:
        """Carry out actions until the browser disconnects or breaks a rule; return whether it is still connected."""
        with self._while_there():
            try:
                while True:
                    message = json.loads(await self.socket.receive_text())
                    while len(self._actions) >= MOST_ACTIONS:
                        await asyncio.wait(self._actions, return_when=asyncio.FIRST_COMPLETED)
                    action = asyncio.ensure_future(self._answer(message))
                    self._actions.add(action)
                    action.add_done_callback(self._actions.discard)
                    if self.session.wrong_tokens >= MOST_WRONG:
                        break
                    await asyncio.sleep(MESSAGE_EVERY)
            except (ValueError, KeyError, RecursionError):
                return True
            except (WebSocketDisconnect, RuntimeError):  # RuntimeError: it is closed
                return False
        return True

    async def _answer(self, told: Any) -> None:
        wrong = self.session.wrong_tokens
        with self._while_there():
            try:
                answer = await self.session.answer(told)
            except ValueError as error:
                answer = {"trouble": str(error)}
            if self.session.wrong_tokens > wrong:
                await asyncio.sleep(AFTER_WRONG)
            if answer is not None:
                await self._send(answer)

    async def _show(self) -> None:
        with self._while_there():
            await self._send({**self.session.hello(), "pages": self.links})
            while True:
                for message in self.session.news():
                    await self._send(message)
                await asyncio.sleep(SHOWN_EVERY)

    @contextlib.contextmanager
    def _while_there(self) -> Iterator[None]:
        """End the connection after an error, and log it: the browser has gone, takes no messages, or a defect."""
        try:
            yield
        except (WebSocketDisconnect, TimeoutError) as error:
            self._failed.set()
            log.info("web: %s has gone: %s", self.who, error)
        except Exception:
            self._failed.set()
            log.exception("web: %s is not served any more", self.who)

    async def _send(self, message: dict[str, Any]) -> None:
        text = as_text(message)
        try:
            async with asyncio.timeout(LONGEST_SEND):
                await self.socket.send_text(text)
        except RuntimeError as error:  # the connection is closed
            raise WebSocketDisconnect(1006, str(error)) from None


class _Uvicorn(uvicorn.Server):
    """A server that leaves the signals to the program around it."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


def watched(work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
    """Return the task of a work of the server or of its pages whose error is reported."""
    task = asyncio.ensure_future(work)
    task.add_done_callback(_has_ended)
    return task


def _has_ended(task: asyncio.Task[None]) -> None:
    """Report the error that has ended a task, in the way of the loop."""
    if not task.cancelled() and (error := task.exception()) is not None:
        task.get_loop().call_exception_handler(
            {"message": "web: the page is not served any more", "exception": error, "task": task}
        )


class WebServer:
    """Listen at once, and show pages from `begin` to `end`. Raises OSError for an address that cannot be bound."""

    def __init__(self, host: str, port: int, access: Access) -> None:
        self.access = access
        self.page = PageApp(access)
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.create_server((host, port), family=family)
        self.url = f"http://{bracketed(host)}:{self._socket.getsockname()[1]}/"
        self._config = uvicorn.Config(
            self.page.app, lifespan="off", log_config=None, access_log=False, server_header=False,
            ws="websockets-sansio", ws_per_message_deflate=False,
            limit_concurrency=MOST_CONNECTIONS, http=ImpatientProtocol, timeout_graceful_shutdown=LONGEST_END,
        )  # fmt: skip
        self._server = _Uvicorn(self._config)
        self._serving: asyncio.Task[None] | None = None
        self._working: dict[PageBoard, asyncio.Task[None]] = {}
        """The work of each page."""

    def begin(self, *boards: PageBoard) -> None:
        """Show these pages from now on, in the running loop; the first is at the address itself."""
        self._config.ws_max_size = max(board.largest_message for board in boards)
        self._serving = watched(self._server.serve([self._socket]))
        self.show(*boards)

    def show(self, *boards: PageBoard) -> None:
        """Show these pages instead of those before; their messages are not larger."""
        for board in [board for board in self._working if board not in boards]:
            self._working.pop(board).cancel()
        for board in boards:
            if board not in self._working:
                self._working[board] = watched(board.go_on())
        self.page.show(*boards)

    async def end(self) -> None:
        """Disconnect all browsers; the address is free afterwards."""
        self._server.should_exit = True
        if self._serving is not None:
            for task in self._working.values():
                task.cancel()
            await asyncio.wait([self._serving], timeout=2 * LONGEST_END)
            self._serving.cancel()
            await asyncio.gather(self._serving, *self._working.values(), return_exceptions=True)
            self._serving = None
        self._socket.close()
