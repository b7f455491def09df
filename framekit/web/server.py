"""The server of the page: Starlette on uvicorn, in the loop of what it shows.

The page is a few files of its own, and one WebSocket for each browser. Whatever a browser sends is bounded in size and
number, and what a browser does not take is not kept: it holds up neither the run nor other browsers.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from framekit.transport.network import bracketed
from framekit.transport.network import listening_at as listening_at
from framekit.web.access import HEADERS, Access, is_known_host, is_own_origin
from framekit.web.messages import PageBoard, PageSession

log = logging.getLogger(__name__)
logging.getLogger("uvicorn").addHandler(logging.NullHandler())

PAGE = Path(__file__).with_name("page")
KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
MOST_BROWSERS = 16
MOST_CONNECTIONS = 64
LARGEST_MESSAGE = 16_384
MOST_ACTIONS = 8
"""Browsers and connections at once, bytes of a message, and what one browser may have under way."""
MESSAGE_EVERY = 0.02
"""Seconds that the next message of a browser waits."""
SHOWN_EVERY = 0.2
AFTER_WRONG = 1.0
MOST_WRONG = 3
LONGEST_SEND = 30.0
LONGEST_END = 2
"""Seconds between two looks at what is new, and after a wrong token, so many of which end the connection; and those
that a message has to leave, and everything to end."""


class Guard:
    """Lets no other web page in, and puts the headers on every answer."""

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
    """The routes, and the browsers that are there. `board` may come later; until then nothing is shown."""

    def __init__(self, access: Access) -> None:
        self.access = access
        self.board: PageBoard | None = None
        self.browsers = 0
        self._files = {
            file.name: (file.read_bytes(), KINDS[file.suffix]) for file in PAGE.iterdir() if file.suffix in KINDS
        }
        routes = [Route(path, self._file) for path in ("/", *(f"/{name}" for name in self._files))]
        self._app = Starlette(routes=[*routes, WebSocketRoute("/live", self._live)])
        self.app: ASGIApp = Guard(self._app)

    async def _file(self, request: Request) -> Response:
        home = "" if self.board is None else self.board.home
        content, kind = self._files[request.url.path[1:] or home]
        return Response(content, media_type=kind)

    async def _live(self, socket: WebSocket) -> None:
        if self.board is None or self.browsers >= MOST_BROWSERS:
            await socket.close(1013)
            return
        client = socket.client
        who = "a browser" if client is None else f"{client.host}:{client.port}"
        self.browsers += 1
        try:
            await socket.accept()
            await Browser(socket, self.board.session(self.access, who), who).attend()
        finally:
            self.browsers -= 1


class Browser:
    """A connection to one browser, as long as it lasts."""

    def __init__(self, socket: WebSocket, session: PageSession, who: str) -> None:
        self.socket, self.session, self.who = socket, session, who
        self._actions: set[asyncio.Task[None]] = set()

    async def attend(self) -> None:
        """Shows what changes and does what is asked for, until the browser goes."""
        showing = asyncio.ensure_future(self._show())
        try:
            while True:
                told = json.loads(await self.socket.receive_text())
                while len(self._actions) >= MOST_ACTIONS:
                    await asyncio.wait(self._actions, return_when=asyncio.FIRST_COMPLETED)
                action = asyncio.ensure_future(self._answer(told))
                self._actions.add(action)
                action.add_done_callback(self._actions.discard)
                if self.session.wrong_tokens >= MOST_WRONG:
                    break
                await asyncio.sleep(MESSAGE_EVERY)
        except WebSocketDisconnect:
            return
        except (ValueError, KeyError, RecursionError):
            pass
        finally:
            tasks = [showing, *self._actions]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            await self.socket.close(1008)

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
        """What ends because the browser has gone, or takes nothing, is no trouble."""
        try:
            yield
        except (WebSocketDisconnect, RuntimeError, TimeoutError) as error:
            log.info("web: %s has gone: %s", self.who, error)
        except Exception:
            log.exception("web: %s is not served any more", self.who)

    async def _send(self, message: dict[str, Any]) -> None:
        async with asyncio.timeout(LONGEST_SEND):
            await self.socket.send_text(json.dumps(message, allow_nan=False, separators=(",", ":")))


class _Uvicorn(uvicorn.Server):
    """Signals are those of the program that it is a part of."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


class WebServer:
    """Listens at once; shows the page from `begin` to `end`. Raises OSError for an address that cannot be had."""

    def __init__(self, host: str, port: int, access: Access) -> None:
        self.access = access
        self.page = PageApp(access)
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.create_server((host, port), family=family)
        self.url = f"http://{bracketed(host)}:{self._socket.getsockname()[1]}/"
        config = uvicorn.Config(
            self.page.app, lifespan="off", log_config=None, access_log=False, server_header=False,
            ws="websockets-sansio", ws_max_size=LARGEST_MESSAGE, ws_per_message_deflate=False,
            limit_concurrency=MOST_CONNECTIONS, timeout_graceful_shutdown=LONGEST_END,
        )  # fmt: skip
        self._server = _Uvicorn(config)
        self._tasks: list[asyncio.Task[None]] = []

    def begin(self, board: PageBoard) -> None:
        """Shows this from now on, in the running loop."""
        self.page.board = board
        self._tasks = [
            asyncio.ensure_future(self._server.serve([self._socket])),
            asyncio.ensure_future(board.go_on()),
        ]

    async def end(self) -> None:
        """All browsers are told to go; the address is free afterwards."""
        self._server.should_exit = True
        if self._tasks:
            serving, going_on = self._tasks
            going_on.cancel()
            await asyncio.wait([serving], timeout=2 * LONGEST_END)
            serving.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            self._tasks = []
        self._socket.close()
