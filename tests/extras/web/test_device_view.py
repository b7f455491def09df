"""Served devices on the page without a browser: areas, values set by hand, and faults switched on and off."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")

from extras.web.page_world import TOKEN

from framekit.api.client import aconnect
from framekit.api.errors import NoReplyError
from framekit.api.monitor import FrameLog
from framekit.api.server import AsyncServer, aserve, view_of_devices
from framekit.extras.web.access import Access
from framekit.extras.web.board import WebBoard, WebSession
from framekit.extras.web.device_view import address_text
from framekit.extras.web.shown import shown_server
from framekit.runfile.devices import load_devices
from framekit.service.device import DeviceStore
from framekit.transport.clock import VirtualClock

DEVICE = """device: meter
protocol: modbus-tcp
station: 1
memory: {set: {"40002": [2, 5]}}
behave:
  "40001": {name: level, ramp: 0..1000, over: 1000 s}
faults: {seed: 1, rules: [{fault: no_reply, every: 1000000}]}
"""
HOLDING = 2


def served(folder: Path, test: Callable[[AsyncServer, WebSession], Awaitable[None]]) -> None:
    """Run a test with a served device and the session of a browser that has no token."""
    path = folder / "meter.device.yaml"
    path.write_text(DEVICE, "utf-8")

    async def run() -> None:
        server = aserve(path, "tcp://127.0.0.1:0")
        server.offer_faults()
        view = view_of_devices(server, FrameLog(), lambda: "open")
        async with server:
            board = WebBoard(shown_server(server, view))
            board.look()
            await test(server, WebSession(board, Access(TOKEN), "test:1"))

    asyncio.run(run())


async def answer(session: WebSession, **told: Any) -> dict[str, Any]:
    found = await session.answer(told)
    assert found is not None
    return found


def test_a_device_is_described_with_its_areas_faults_and_behaviours(tmp_path: Path) -> None:
    async def test(server: AsyncServer, session: WebSession) -> None:
        hello = session.hello()
        (device,) = hello["devices"]
        assert (device["name"], device["station"], device["used"]) == ("meter", "1", HOLDING)
        assert device["areas"][HOLDING] == ["holding", 65536, "word", 16, "rw"]
        assert device["behaviours"] == {"level": "ramp 0..1000, over 1000 s"}
        assert device["faults"][:3] == ["No reply, every 1000000. frame", "No reply", "Delay, 500 ms"]
        assert "Wrong check code" not in device["faults"]
        assert (session.board.home, session.board.name) == ("board.html", "Devices")
        assert [card.title for card in session.board.cards] == ["Device", "Requests", "Errors"]

    served(tmp_path, test)


def test_an_area_is_read_with_its_addresses(tmp_path: Path) -> None:
    async def test(server: AsyncServer, session: WebSession) -> None:
        found = await answer(session, area=0, number=HOLDING, first=0, count=20, step=10)
        assert found["elements"][1:3] == [2, 5] and len(found["elements"]) == 20
        assert found["addresses"] == ["40001", "40011"]
        last = await answer(session, area=0, number=HOLDING, first=65530, count=500, step=10)
        assert len(last["elements"]) == 6
        place = await answer(session, find=0, address="40003")
        assert (place["number"], place["element"]) == (HOLDING, 2)
        assert "why" in await answer(session, find=0, address="nowhere")
        for told in (
            {"area": 1, "number": 0, "first": 0, "count": 1, "step": 1},
            {"area": 0, "number": 99, "first": 0, "count": 1, "step": 1},
            {"area": 0, "number": 0, "first": 10**9, "count": 1, "step": 1},
            {"area": 0, "number": 0, "first": 0, "count": 1, "step": 0},
            {"area": 0, "number": 0, "first": 0, "count": 1},
            {"fault": 0, "number": 99, "on": True, "id": 1},
            {"fault": 0, "number": 0, "on": "yes", "id": 1},
            {"set": 0, "number": 0, "element": 10**9, "value": "1", "id": 1},
            {"find": 7, "address": "40001"},
        ):
            with pytest.raises(ValueError, match="this is no message"):
                await session.answer(told)

    served(tmp_path, test)


def test_a_value_is_set_with_the_token(tmp_path: Path) -> None:
    async def test(server: AsyncServer, session: WebSession) -> None:
        refused = await answer(session, set=0, number=HOLDING, element=2, value="7", id=1)
        assert refused == {"done": 1, "why": "only with the token"}
        assert server.memory["40003"] == 5
        await answer(session, token=TOKEN)
        for text, stored in (("7", 7), ("0x1F", 31), ("-1", 65535)):
            assert await answer(session, set=0, number=HOLDING, element=2, value=text, id=2) == {"done": 2}
            assert server.memory["40003"] == stored
        for text in ("65536", "-32769", "seven", ""):
            assert "why" in await answer(session, set=0, number=HOLDING, element=2, value=text, id=3)
        assert "why" in await answer(session, set=0, number=0, element=0, value="2", id=4)
        assert server.memory["40003"] == 65535

    served(tmp_path, test)


def test_a_fault_is_switched_on_and_off_with_the_token(tmp_path: Path) -> None:
    async def test(server: AsyncServer, session: WebSession) -> None:
        async with aconnect("modbus-tcp", server.port, station=1, params={"reply_timeout": "500 ms"}) as client:
            assert await client.read("40002") == [2]
            refused = await answer(session, fault=0, number=1, on=True, id=1)
            assert refused == {"done": 1, "why": "only with the token"}
            await answer(session, token=TOKEN)
            assert await answer(session, fault=0, number=1, on=True, id=2) == {"done": 2}
            with pytest.raises(NoReplyError):
                await client.read("40002")
            faults = (await answer(session, faults=True))["faults"][0]
            assert faults[0] == [True, 0] and faults[1][0] is True and faults[1][1] >= 1
            assert await answer(session, fault=0, number=1, on=False, id=3) == {"done": 3}
            assert await client.read("40002") == [2]

    served(tmp_path, test)


def test_an_address_is_shown_only_if_it_means_the_element() -> None:
    path = Path(__file__).parents[3] / "examples" / "df1" / "plc-3.device.yaml"
    (device,) = load_devices(path, path.parent)
    store = DeviceStore(device, VirtualClock())
    texts = {area.name: address_text(store, store.memory.area(area.name), 4) for area in device.areas}
    for name, text in texts.items():
        if text:
            assert (device.grammar.parse(text).area, device.grammar.parse(text).start) == (name, 4)
    assert texts["file10"] and not texts["PLC2"]
