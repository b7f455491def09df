"""The server of the page: Starlette on uvicorn, in the loop of the run or the devices.

The page is a few files of its own, and one WebSocket for each browser. Messages of browsers are bounded in size and
number. A message that a browser does not take is dropped, so that it delays neither the run nor other browsers.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
from collections import Counter
from collections.abc import Iterator
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
    """The routes, and the connected browsers. `board` may be set later; until then browsers are refused."""

    def __init__(self, access: Access) -> None:
        self.access = access
        self.board: PageBoard | None = None
        self.browsers: Counter[str] = Counter()
        """Connected browsers by their address."""
        self._files = page_files() | chart_files()
        routes = [Route(path, self._file) for path in ("/", *(f"/{name}" for name in self._files))]
        self._app = Starlette(routes=[*routes, WebSocketRoute("/live", self._live)])
        self.app: ASGIApp = Guard(self._app)

    async def _file(self, request: Request) -> Response:
        home = "" if self.board is None else self.board.home
        content, kind = self._files[request.url.path[1:] or home]
        return Response(content, media_type=kind)

    async def _live(self, socket: WebSocket) -> None:
        client = socket.client
        host = "" if client is None else client.host
        is_full = self.browsers.total() >= MOST_BROWSERS or self.browsers[host] >= MOST_BROWSERS_OF_AN_ADDRESS
        if self.board is None or is_full:
            await socket.close(1013)
            return
        who = "a browser" if client is None else f"{client.host}:{client.port}"
        self.browsers[host] += 1
        try:
            await socket.accept()
            await Browser(socket, self.board.session(self.access, who), who).attend()
        finally:
            self.browsers[host] -= 1
            self.browsers += Counter()  # without addresses that have no browser


class Browser:
    """A connection to one browser, as long as it lasts."""

    def __init__(self, socket: WebSocket, session: PageSession, who: str) -> None:
        self.socket, self.session, self.who = socket, session, who
        self._actions: set[asyncio.Task[None]] = set()
        self._failed = asyncio.Event()
        """Set when sending or an action has failed: the connection is closed, and the page connects again."""

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
            await self._send(self.session.hello())
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


def _has_ended(task: asyncio.Task[None]) -> None:
    """Report the error that has ended a task of the server, in the way of the loop."""
    if not task.cancelled() and (error := task.exception()) is not None:
        task.get_loop().call_exception_handler(
            {"message": "web: the page is not served any more", "exception": error, "task": task}
        )


class WebServer:
    """Listen at once, and show the page from `begin` to `end`. Raises OSError for an address that cannot be bound."""

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
        self._tasks: list[asyncio.Task[None]] = []

    def begin(self, board: PageBoard) -> None:
        """Show this board from now on, in the running loop."""
        self.page.board = board
        self._config.ws_max_size = board.largest_message
        self._tasks = [
            asyncio.ensure_future(self._server.serve([self._socket])),
            asyncio.ensure_future(board.go_on()),
        ]
        for task in self._tasks:
            task.add_done_callback(_has_ended)

    async def end(self) -> None:
        """Disconnect all browsers; the address is free afterwards."""
        self._server.should_exit = True
        if self._tasks:
            serving, going_on = self._tasks
            going_on.cancel()
            await asyncio.wait([serving], timeout=2 * LONGEST_END)
            serving.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            self._tasks = []
        self._socket.close()
