"""The server of the page: its files and headers, access control, start and stop; over real sockets."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import pytest

pytest.importorskip("starlette")
pytest.importorskip("httpx2")

import uvicorn
from extras.web.page_world import TOKEN, Browser, Page, async_run, written
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from framekit.api.monitor import FrameLog
from framekit.api.run import view_of
from framekit.api.server import aserve, view_of_devices
from framekit.cli.main import main
from framekit.extras.web import patience
from framekit.extras.web import server as server_module
from framekit.extras.web.access import Access, is_known_host
from framekit.extras.web.assets import PAGE, chart_files
from framekit.extras.web.board import WebBoard, WebSession
from framekit.extras.web.server import PageApp, WebServer
from framekit.extras.web.shown import shown_run, shown_server

MARKUP = re.compile(r"innerHTML|outerHTML|insertAdjacent|document\.write|eval\(|new Function|\sstyle=|\son\w+=")
"""Ways in which a text could become markup or code."""
HOME, LIVE = "http://127.0.0.1:8040", "ws://127.0.0.1:8040/live"


@pytest.fixture
def page(tmp_path: Path) -> Page:
    found = Page(written(tmp_path))
    found.run.run_for("2 s")
    return found


@pytest.fixture
def app(page: Page) -> PageApp:
    found = PageApp(Access(TOKEN))
    found.show(page.board)
    return found


def test_the_page_comes_with_its_rules(app: PageApp) -> None:
    client = TestClient(app.app, base_url=HOME)
    for path in ("/", "/board.js", "/parts.js", "/page.css", *(f"/{name}" for name in chart_files())):
        reply = client.get(path)
        assert reply.status_code == 200
        rules = reply.headers["content-security-policy"]
        assert "default-src 'none'" in rules
        assert "unsafe" not in rules
        assert reply.headers["x-content-type-options"] == "nosniff"
    assert client.get("/../server.py").status_code == 404
    assert client.get("/nothing").headers["x-frame-options"] == "DENY"
    assert client.post("/").status_code == 405


def test_nothing_of_the_page_comes_from_elsewhere_or_is_markup() -> None:
    for file in PAGE.iterdir():
        text = file.read_text("utf-8").replace('xmlns="http://www.w3.org/2000/svg"', "")
        assert "//" not in re.sub(r"^\s*//.*|(?<=;)\s+//.*|\$\{[^}]*\}://", "", text, flags=re.MULTILINE), file.name
        assert not MARKUP.search(text), file.name


@pytest.mark.parametrize(
    ("host", "known"),
    [("127.0.0.1:8040", True), ("localhost", True), ("[::1]:8040", True), ("192.168.0.9", True), ("10.0.0.1:1", True),
     ("evil.example", False), ("127.0.0.1.evil.example:8040", False), ("", False), ("localhost.evil.example", False),
     (f"{socket.gethostname()}:8040", True)],
)  # fmt: skip
def test_which_hosts_are_this_machine(host: str, known: bool) -> None:
    assert is_known_host(host) == known


def test_another_name_or_page_is_not_let_in(app: PageApp) -> None:
    client = TestClient(app.app, base_url=HOME)
    assert client.get("/", headers={"host": "evil.example"}).status_code == 403
    assert client.get("/", headers={"origin": "http://evil.example"}).status_code == 403
    for headers in (
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9"},
        {"host": "evil.example", "origin": "http://evil.example"},
    ):
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE, headers=headers):
            pass
    assert not app.browsers


def test_a_browser_is_served(app: PageApp) -> None:
    client = TestClient(app.app, base_url=HOME)
    with client.websocket_connect(LIVE, headers={"origin": HOME}) as socket:
        browser = Browser(socket.receive_json())
        while not browser.frames:
            browser.take([socket.receive_json()])
        assert browser.values["level"][0] == "2"
        socket.send_json({"token": TOKEN})
        assert socket.receive_json() == {"may": True}
        socket.send_json({"do": "disable 1", "id": 5})
        assert socket.receive_json() == {"done": 5}
        assert app.browsers.total() == 1
    assert not app.browsers


@pytest.mark.parametrize("told", ["no json", "[" * 100_000, "[]"])
def test_nonsense_ends_the_connection_or_is_refused(app: PageApp, told: str) -> None:
    client = TestClient(app.app, base_url=HOME)
    with client.websocket_connect(LIVE) as socket:
        browser = Browser(socket.receive_json())
        while not browser.frames:
            browser.take([socket.receive_json()])
        socket.send_text(told)
        try:
            assert socket.receive_json() == {"trouble": "this is no message"}
        except WebSocketDisconnect as end:
            assert end.code == 1008
    assert not app.browsers


def test_wrong_tokens_end_the_connection(app: PageApp, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "AFTER_WRONG", 0)
    client = TestClient(app.app, base_url=HOME)
    with client.websocket_connect(LIVE) as socket, pytest.raises(WebSocketDisconnect):
        for number in range(server_module.MOST_WRONG + 1):
            socket.send_json({"token": f"wrong {number}"})
        while True:
            socket.receive_json()


class RecordingSocket:
    """The socket of a browser that records the texts sent to it."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    async def send_text(self, text: str) -> None:
        self.texts.append(text)


def browser_at(page: Page, socket: Any) -> server_module.Browser:
    """Return the connection of a browser."""
    return server_module.Browser(socket, page.board, page.session(), "test:1", [])


def test_texts_of_devices_have_their_marks_as_escapes(page: Page) -> None:
    texts = {"a\u202ebc\u2066": ["\u200f", "\x1b[2J", "\ud800", {"b": "line\nend\ttab"}, "😀 é \\u202e", None, 1.5]}
    socket = RecordingSocket()
    browser = browser_at(page, socket)
    asyncio.run(browser._send(texts))
    assert json.loads(socket.texts[0]) == {
        r"a\u202ebc\u2066": [r"\u200f", r"\x1b[2J", r"\ud800", {"b": "line\nend\ttab"}, "😀 é \\u202e", None, 1.5]
    }


class Stuck:
    """The socket of a browser that never accepts a message."""

    def __init__(self) -> None:
        self.tried = 0

    async def send_text(self, text: str) -> None:
        self.tried += 1
        await asyncio.Event().wait()


def test_a_browser_that_takes_nothing_is_given_up_and_holds_nobody_up(
    page: Page, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def drive() -> Browser:
        stuck = Stuck()
        showing = asyncio.ensure_future(browser_at(page, stuck)._show())
        await asyncio.sleep(0)
        session = page.session()
        other = Browser(session.hello())
        for _ in range(3):
            page.run.run_for("1 s")
            other.take(session.news())
        assert not showing.done()
        assert stuck.tried == 1  # one message waits; no further message is built
        showing.cancel()
        monkeypatch.setattr(server_module, "LONGEST_SEND", 0)
        await browser_at(page, stuck)._show()
        return other

    caplog.set_level("INFO", "framekit.extras.web")
    assert asyncio.run(drive()).values["level"][0] == "5"
    assert [record.exc_info for record in caplog.records] == [None]


def test_no_more_browsers_than_there_is_room_for(app: PageApp) -> None:
    app.browsers.update(f"10.0.0.{number}" for number in range(server_module.MOST_BROWSERS))
    client = TestClient(app.app, base_url=HOME)
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE):
        pass


def test_one_address_leaves_room_for_others(app: PageApp) -> None:
    app.browsers.update({"testclient": server_module.MOST_BROWSERS_OF_AN_ADDRESS})
    client = TestClient(app.app, base_url=HOME)
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE):
        pass
    app.browsers.subtract({"testclient": 1})
    with client.websocket_connect(LIVE) as live:
        assert "points" in live.receive_json()
    assert app.browsers["testclient"] == server_module.MOST_BROWSERS_OF_AN_ADDRESS - 1


async def _answer(port: int) -> bytes:
    """Return the first line of the answer to a complete request."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
    line = await reader.readline()
    writer.close()
    return line


def test_silent_connections_of_an_address_end_and_keep_nobody_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    most = patience.MOST_OF_AN_ADDRESS

    async def drive() -> None:
        log = FrameLog()
        run = async_run(written(tmp_path), log)
        server = WebServer("127.0.0.1", 0, Access(TOKEN))
        server.begin(WebBoard(shown_run(run, view_of(run, log))))
        port = int(server.url.rstrip("/").rpartition(":")[2])
        assert b"200" in await _answer(port)
        with monkeypatch.context() as patched:
            patched.setattr(patience, "LONGEST_SILENCE", 0.0)
            silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2 * most)]
            silent[0][1].write(b"GET / HTTP/1.1\r\nHo")
            for reader, _ in silent:
                with contextlib.suppress(ConnectionError):
                    assert await reader.read() == b""
        assert b"200" in await _answer(port)
        for _, writer in silent:
            writer.close()
        await server.end()
        run.stop()

    asyncio.run(drive())
    assert not patience.ImpatientProtocol.open_connections


def test_an_address_has_so_many_connections_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patience, "LONGEST_SILENCE", 1_000.0)

    async def drive() -> list[bool]:
        loop = asyncio.get_running_loop()
        state = uvicorn.server.ServerState()
        config = uvicorn.Config(PageApp(Access(TOKEN)).app, log_config=None)
        config.load()
        transports = [Transport("10.0.0.1") for _ in range(patience.MOST_OF_AN_ADDRESS + 1)] + [Transport("10.0.0.2")]
        protocols = [patience.ImpatientProtocol(config, state, {}, loop) for _ in transports]
        for protocol, transport in zip(protocols, transports, strict=True):
            protocol.connection_made(cast(Any, transport))
        for protocol in protocols:
            protocol.connection_lost(None)
        return [transport.aborted for transport in transports]

    assert asyncio.run(drive()) == [False] * patience.MOST_OF_AN_ADDRESS + [True, False]
    assert not patience.ImpatientProtocol.open_connections


class Transport:
    """A transport that knows only the address of its peer."""

    def __init__(self, host: str) -> None:
        self.host, self.aborted = host, False

    def get_extra_info(self, name: str) -> object:
        return {"peername": (self.host, 1)}.get(name)

    def abort(self) -> None:
        self.aborted = True

    def close(self) -> None:
        """Do nothing; the connection is already lost."""


def test_a_point_is_written_over_the_line_and_refused_out_of_range(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "framekit")

    async def drive() -> list[dict[str, object]]:
        log = FrameLog()
        run = async_run(written(tmp_path), log)
        server = WebServer("127.0.0.1", 0, Access(TOKEN))
        server.begin(WebBoard(shown_run(run, view_of(run, log))))
        async with run:
            session = server.page.boards[""].session(server.access, "test:1")
            while run.points["limit"].quality != "good":
                await run.next_end()
            messages: list[dict[str, object]] = [{"token": TOKEN}]
            messages += [{"write": 2, "value": value, "id": 1} for value in ("7", "11", "warm")]
            messages += [{"write": 1, "value": "off", "id": 2}, {"write": 0, "value": "1", "id": 3}]
            found = [await session.answer(message) or {} for message in messages]
            assert run.device("meter")["40003"] == 7
            assert run.device("meter")["40002"] == 0
        await server.end()
        return found

    may, *answers = asyncio.run(drive())
    assert may == {"may": True}
    assert [answer.get("why") for answer in answers] == [
        None, "11 is not in 0..10, the range of limit", "'warm' is no value of limit", None,
        "'level' can only be read – access: rw of the point allows it",
    ]  # fmt: skip
    assert "point limit: 5 → 7, written by the page, from test:1" in caplog.text
    assert "point limit: 11 was refused to the page, from test:1: 11 is not in 0..10" in caplog.text


def test_values_of_a_device_are_shown_and_set(tmp_path: Path) -> None:
    async def drive() -> None:
        device = written(tmp_path).with_name("meter.device.yaml")
        devices = aserve(device, "tcp://127.0.0.1:0")
        view = view_of_devices(devices, FrameLog(), lambda: "open")
        async with devices:
            session = WebSession(WebBoard(shown_server(devices, view)), Access(TOKEN), "test:1")
            browser = Browser(session.hello())
            browser.take(session.news())
            assert list(browser.values) == browser.points == ["40001", "40002", "40003"]
            assert browser.values["40003"][:2] == ["5", "good"]
            assert browser.tables["devices"]["1"][1][:2] == ("meter", "modbus-tcp")
            assert await session.answer({"write": 2, "value": "6", "id": 1}) == {
                "done": 1,
                "why": "only with the token",
            }
            await session.answer({"token": TOKEN})
            assert await session.answer({"write": 2, "value": "6", "id": 2}) == {"done": 2}
            assert devices.memory["40003"] == 6
            devices.memory["40002"] = 9
            await asyncio.sleep(0)
            assert await session.answer({"do": "fire 1", "id": 3}) == {
                "done": 3, "why": "'fire 1' is nothing that the page does",
            }  # fmt: skip
            too_large = await session.answer({"write": 2, "value": "65536", "id": 4})
            assert too_large is not None
            assert "65536" in too_large["why"]
            assert [value.value for value in devices.points[0].now()][1:] == [9, 6]

    asyncio.run(drive())


def test_the_address_is_free_when_it_has_ended(tmp_path: Path) -> None:
    async def drive() -> None:
        for _ in range(2):
            log = FrameLog()
            run = async_run(written(tmp_path), log)
            server = WebServer("127.0.0.1", port, Access(TOKEN))
            server.begin(WebBoard(shown_run(run, view_of(run, log))))
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            assert b"200" in await reader.readline()
            await server.end()
            run.stop()
            writer.close()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    asyncio.run(drive())


# ---- the command line --------------------------------------------------------------------------------------------


def test_an_address_in_use_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        place = f"127.0.0.1:{listener.getsockname()[1]}"
        assert main(["run", str(written(tmp_path)), "--web", place, "--for", "1s"]) == 1
    assert capsys.readouterr().err == (
        f"framekit run: --web {place}: the address is in use – stop the program that uses it, or give "
        "another port, such as 0 for a free one\n"
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--web", "here"], "--web: 'here' is no place to listen on – write a port such as 8040"),
        (["--web-token", "env:X"], "--web-token has no effect without --web"),
        (["--web", "0", "--web-token", "swordfish"], "a token does not stand on the command line"),
        (["--web", "0", "--web-token", "env:NOTHING_THERE"], "NOTHING_THERE"),
        (["--web", "0", "--web-token", "env:SHORT"], "the token has 5 characters – give 12 or more"),
        (["--web", "0", "--virtual"], "--web is for runs in real time"),
        (["--web", "0", "--screen"], "leave --screen out"),
    ],
)
def test_what_the_command_line_says_wrongly(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: list[str], told: str
) -> None:
    monkeypatch.setenv("SHORT", "12345")
    assert main(["run", str(written(tmp_path)), "--for", "1s", *words]) == 2
    assert told in capsys.readouterr().err


def test_a_run_behind_the_option_is_no_place(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["run", "--web", "plant.run.yaml"])
    assert end.value.code == 2
    assert (
        "argument --web: 'plant.run.yaml' is no place to listen on – write files before --web"
        in capsys.readouterr().err
    )


def test_a_missing_library_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "framekit.extras.web.server")
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert main(["run", str(written(tmp_path)), "--web", "0", "--for", "1s"]) == 1
    assert "install framekit with the extra 'web'" in capsys.readouterr().err


def test_a_run_with_its_page_ends_by_a_signal(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "framekit", "run", str(written(tmp_path)), "--web", "0", "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        event = json.loads(run.stdout.readline())
        assert event["event"] == "web"
        assert len(event["token"]) >= 32
        address = re.match(r"http://127\.0\.0\.1:(\d+)/$", event["url"])
        assert address is not None
        with socket.create_connection(("127.0.0.1", int(address[1]))):
            run.send_signal(signal.SIGINT)
            _, trouble = run.communicate(timeout=30)
    assert (run.returncode, trouble) == (0, "")


# ---- what fails does not look as if it were alive -------------------------------------------------------------------


@pytest.mark.parametrize("method", ["news", "answer"])
def test_a_failure_ends_the_connection_and_is_logged(
    app: PageApp, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, method: str
) -> None:
    def fails(*_: Any) -> Any:
        raise RuntimeError("a defect")

    monkeypatch.setattr(WebSession, method, fails)
    client = TestClient(app.app, base_url=HOME)
    with client.websocket_connect(LIVE) as socket:
        socket.send_json({"pause": True})
        with pytest.raises(WebSocketDisconnect) as end:
            while True:
                socket.receive_json()
    assert end.value.code == 1011
    assert not app.browsers
    assert "is not served any more" in caplog.text and "a defect" in caplog.text
    monkeypatch.undo()
    with client.websocket_connect(LIVE) as socket:
        assert "points" in socket.receive_json(), "the page connects again"


def test_a_browser_that_takes_nothing_is_disconnected(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    class Silent(Stuck):
        async def receive_text(self) -> str:
            await asyncio.Event().wait()
            return ""

        async def close(self, code: int) -> None:
            self.code = code

    monkeypatch.setattr(server_module, "LONGEST_SEND", 0)
    silent = Silent()
    asyncio.run(browser_at(page, silent).attend())
    assert silent.code == 1011


def test_a_task_of_the_server_that_fails_is_reported_at_once(page: Page) -> None:
    async def fails() -> None:
        raise ValueError("a defect")

    async def drive() -> dict[str, Any]:
        reported: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: reported.set_result(context))
        page.board.go_on = fails  # type: ignore[method-assign]
        server = WebServer("127.0.0.1", 0, Access(TOKEN))
        server.begin(page.board)
        context = await reported
        await server.end()
        return context

    context = asyncio.run(drive())
    assert context["message"] == "web: the page is not served any more"
    assert str(context["exception"]) == "a defect"
