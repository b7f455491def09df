"""The pages of one program: the run, and its simulated devices, with links between them."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
pytest.importorskip("httpx2")

from extras.web.page_world import METER, RUN, TOKEN, Browser, written
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from framekit.api.monitor import FrameLog, LiveView
from framekit.api.run import AsyncRun, RunCalls, VirtualRun, view_of
from framekit.extras.web.access import Access
from framekit.extras.web.board import WebBoard, WebSession
from framekit.extras.web.server import PageApp
from framekit.extras.web.shown import Shown, shown_devices, shown_run
from framekit.extras.web.web_page import WebPage
from framekit.run.trouble import SampleCount

HOME = "http://127.0.0.1:8040"
HOLDING = 2
TWO = RUN.replace("points:", '  2: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}\npoints:')


class Pages:
    """The boards of a simulated run."""

    def __init__(self, folder: Path, run: str = RUN, device: str = METER) -> None:
        log = FrameLog()
        self.run = VirtualRun(written(folder, run, device), monitor=log.add, offers_faults=True)
        self.view = view_of(self.run, log)
        now = lambda: self.run.now / 1e9  # noqa: E731
        self.of_run = WebBoard(shown_run(self.run, self.view), now)
        self.of_devices = WebBoard(shown_devices(self.run, self.view), now)
        self.run.run_for("2 s")

    def session(self) -> WebSession:
        """Return the session of a browser on the devices' page, with the token."""
        session = self.of_devices.session(Access(TOKEN), "test:1")
        session.visitor.give(TOKEN)
        return session


def answer(session: WebSession, **told: Any) -> dict[str, Any]:
    found = asyncio.run(session.answer(told))
    assert found is not None
    return found


def test_each_page_has_its_address_and_links_to_the_others(tmp_path: Path) -> None:
    pages = Pages(tmp_path)
    app = PageApp(Access(TOKEN))
    app.show(pages.of_run, pages.of_devices)
    client = TestClient(app.app, base_url=HOME)
    assert client.get("/").text == client.get("/devices").text
    assert [client.get(path).status_code for path in ("/guess", "/live/devices", "/devices/x")] == [404] * 3
    for path, title in (("", "run plant"), ("/devices", "devices of plant")):
        with client.websocket_connect(f"{HOME.replace('http', 'ws')}/live{path}") as socket:
            hello = socket.receive_json()
        assert (hello["hello"], hello["pages"]) == (title, [["", "Run"], ["devices", "Devices"]])
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(f"{HOME.replace('http', 'ws')}/live/guess"):
        raise AssertionError


def test_a_page_that_is_replaced_connects_again(tmp_path: Path) -> None:
    pages = Pages(tmp_path)
    app = PageApp(Access(TOKEN))
    app.show(pages.of_run, pages.of_devices)
    client = TestClient(app.app, base_url=HOME)
    with client.websocket_connect(f"{HOME.replace('http', 'ws')}/live/devices") as socket:
        socket.receive_json()
        app.show(pages.of_run, WebBoard(shown_devices(pages.run, pages.view)))
        with pytest.raises(WebSocketDisconnect) as ended:
            while True:
                socket.receive_json()
    assert ended.value.code == 1011


def test_a_simulated_device_of_a_run_is_shown_and_set(tmp_path: Path) -> None:
    pages = Pages(tmp_path)
    session = pages.session()
    browser = Browser(session.hello())
    browser.take(session.news())
    assert list(browser.tables["devices"]["1"][1][:4]) == ["1", "meter", "modbus-tcp", "1"]
    assert browser.values["40002"][:2] == ["2", "good"]
    (device,) = session.hello()["devices"]
    assert (device["name"], device["used"]) == ("meter", HOLDING)
    assert device["behaviours"] == {"40001": "ramp 0..1000, over 1000 s"}
    assert answer(session, set=0, number=HOLDING, element=2, value="7", id=1) == {"done": 1}
    pages.run.run_for("2 s")
    assert pages.run.points["limit"].value == 7
    assert [card.title for card in pages.of_devices.cards] == ["Device", "Requests", "Errors"]
    pages.of_devices.shown.end()


def test_the_history_begins_an_interval_after_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    board = Pages(tmp_path).of_devices
    taken: list[int] = []

    async def pause(seconds: float) -> None:
        taken.append(board.history.taken)
        if len(taken) == 2:
            raise asyncio.CancelledError

    monkeypatch.setattr(asyncio, "sleep", pause)
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(board.go_on())
    assert taken == [0, 1]


def test_a_fault_of_a_simulated_device_reaches_the_run(tmp_path: Path) -> None:
    pages = Pages(tmp_path)
    session = pages.session()
    number = session.hello()["devices"][0]["faults"].index("No reply")
    assert pages.run.points["level"].quality == "good"
    assert answer(session, fault=0, number=number, on=True, id=1) == {"done": 1}
    pages.run.run_for("5 s")
    pages.of_run.look()
    card = next(card for card in pages.of_run.cards if card.title == "Stations")
    assert (card.value, card.text, card.state) == ("1 of 1 silent", "channel 1, station 1", "warn")
    pages.run.run_for("25 s")
    assert pages.run.points["level"].quality != "good"
    pages.of_run.look()
    (notice, *_) = pages.of_run.notices
    assert "does not answer" in notice.text or "no reply" in notice.text
    assert answer(session, fault=0, number=number, on=False, id=2) == {"done": 2}
    pages.run.run_for("60 s")
    assert pages.run.points["level"].quality == "good"
    pages.of_run.look()
    assert all(notice.ended is not None for notice in pages.of_run.notices)
    assert next(card for card in pages.of_run.cards if card.title == "Stations").value == "Answers"


def test_devices_with_the_same_name_are_distinguished(tmp_path: Path) -> None:
    session = Pages(tmp_path, TWO).session()
    hello = session.hello()
    assert [device["name"] for device in hello["devices"]] == ["meter, channel 1", "meter, channel 2"]
    assert hello["points"][0][0] == "meter, channel 1: 40001"


def test_a_run_without_a_page_has_only_the_faults_of_its_files(tmp_path: Path) -> None:
    run = VirtualRun(written(tmp_path))
    assert [store.faults for _, store in run.simulated] == [None]


def test_a_late_station_is_a_notice_with_the_advised_time(tmp_path: Path) -> None:
    run, device = (text.replace("modbus-tcp", "modbus-rtu") for text in (RUN, METER))
    limit = "station: 1, params: {reply_timeout: 300 ms}}\npoints"
    pages = Pages(tmp_path, run.replace("station: 1}\npoints", limit), device)
    session = pages.session()
    number = session.hello()["devices"][0]["faults"].index("Delay, 500 ms")
    answer(session, fault=0, number=number, on=True, id=1)
    pages.run.run_for("20 s")
    pages.of_run.look()
    texts = [notice.text for notice in pages.of_run.notices if notice.ended is None]
    assert any("reply_timeout" in text for text in texts), texts


def test_trouble_of_a_sink_is_a_notice_until_it_is_over(tmp_path: Path) -> None:
    pages = Pages(tmp_path)
    source = pages.run.trouble_source("sink csv: plant.csv", lambda: "3 samples wait", lambda: SampleCount(3), "sample")
    source.begins("No space left on device")
    pages.run.run_for("2 s")
    pages.of_run.look()
    (notice,) = pages.of_run.notices
    assert notice.text.startswith("sink csv: plant.csv") and "No space left on device" in notice.text
    assert notice.ended is None
    source.ends()
    pages.run.run_for("2 s")
    pages.of_run.look()
    (notice,) = pages.of_run.notices
    assert notice.ended is not None


def test_an_error_while_changed_devices_are_shown_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The devices of the run differ at each look, and their page cannot be made again."""
    made: list[None] = []

    def shown_once(run: RunCalls, view: LiveView) -> Shown:
        made.append(None)
        if len(made) > 1:
            raise ValueError("a defect")
        return shown_devices(run, view)

    async def reported() -> list[str]:
        found: list[str] = []
        ended = asyncio.Event()

        def note(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
            found.append(f"{context['message']}: {context['exception']}")
            ended.set()

        asyncio.get_running_loop().set_exception_handler(note)
        page = WebPage(argparse.Namespace(web="0", web_token=None, json=False))
        run = AsyncRun(written(tmp_path), offers_faults=True)
        async with page.of_run(run):
            monkeypatch.setattr(AsyncRun, "simulated", property(lambda run: [object()]))
            await asyncio.wait_for(ended.wait(), 60)
        return found

    monkeypatch.setattr("framekit.extras.web.web_page.LOOK_EVERY", 0)
    monkeypatch.setattr("framekit.extras.web.shown.shown_devices", shown_once)
    assert asyncio.run(reported()) == ["web: the page is not served any more: a defect"]
