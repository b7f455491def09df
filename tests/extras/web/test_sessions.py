"""Sessions of browsers on simulated time: the messages about a run, and the permitted actions."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

pytest.importorskip("starlette")

from extras.web.page_world import TOKEN, Browser, Page, written

from framekit.extras.web import board
from framekit.extras.web.history import PointHistory
from framekit.extras.web.shown import ChangingRows, ShownRow


@pytest.fixture
def page(tmp_path: Path) -> Page:
    return Page(written(tmp_path))


def answered(session: board.WebSession, **told: object) -> dict[str, object]:
    found = asyncio.run(session.answer(told))
    assert found is not None
    return found


def test_a_browser_gets_everything_and_then_what_has_changed(page: Page) -> None:
    page.run.run_for("2 s")
    session = page.session()
    browser = Browser(session.hello())
    browser.take(session.news())
    assert browser.points == ["level", "state", "limit"]
    assert browser.values["level"][:2] == ["2", "good"]
    assert browser.values["state"][:2] == ["heating", "good"]
    assert list(browser.tables["blocks"]) == ["0", "1"]
    assert browser.tables["channels"]["1"][0] == ""
    assert browser.frames
    assert list(session.news()) == []
    page.run.run_for("1 s")
    messages = browser.take(session.news())
    values = next(message["values"] for message in messages if "values" in message)
    assert {browser.points[at] for at in values} == {"level"}
    assert browser.values["level"][0] == "3"
    page.run.enable_channel(1, False)
    page.run.run_for("1 s")
    browser.take(session.news())
    assert browser.tables["channels"]["1"][0] == "off"


def test_a_slow_browser_loses_what_came_in_between_and_has_the_same_picture(page: Page) -> None:
    slow, quick = page.session(), page.session()
    seen = [Browser(session.hello()) for session in (slow, quick)]
    for _ in range(30):
        page.run.run_for("1 s")
        seen[1].take(quick.news())
    messages = seen[0].take(slow.news())
    assert seen[0].values == seen[1].values
    assert seen[0].tables == seen[1].tables
    assert len(messages) <= 8
    page.run.run_for("100 s")
    later = [message for message in slow.news() if "frames" in message]
    assert len(later[0]["frames"]) == board.MOST_FRAMES
    assert later[0]["missed"] > 0


def test_messages_are_of_bounded_size(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(board, "PIECE", 1)
    page.run.run_for("2 s")
    session = page.session()
    browser = Browser(session.hello())
    messages = browser.take(session.news())
    assert all(len(message.get("values", message.get("rows", ()))) <= 1 for message in messages)
    assert set(browser.values) == set(browser.points)
    assert list(browser.tables["blocks"]) == ["0", "1"]


def test_filter_and_pause_of_frames(page: Page) -> None:
    page.run.run_for("3 s")
    session = page.session()
    browser = Browser(session.hello())
    browser.take(session.news())
    everything = len(browser.frames)
    assert asyncio.run(session.answer({"filter": "ch:1 frame:reply"})) is None
    browser.take(session.news())
    assert 0 < len(browser.frames) < everything
    assert all("reply" in frame[6] or "response" in frame[6] for frame in browser.frames)
    asyncio.run(session.answer({"filter": "nowhere"}))
    browser.take(session.news())
    assert browser.frames == []
    asyncio.run(session.answer({"filter": "", "bad": False}))
    asyncio.run(session.answer({"pause": True}))
    browser.take(session.news())
    kept = list(browser.frames)
    page.run.run_for("2 s")
    browser.take(session.news())
    assert browser.frames == kept
    asyncio.run(session.answer({"pause": False}))
    browser.take(session.news())
    numbers = [int(frame[0]) for frame in browser.frames]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) > len(kept)


def test_a_frame_has_its_fields_in_place(page: Page) -> None:
    page.run.run_for("1 s")
    session = page.session()
    browser = Browser(session.hello())
    browser.take(session.news())
    frame = next(frame for frame in browser.frames if "=" in frame[8])
    found = answered(session, frame=int(frame[0]))
    whole = bytes.fromhex(str(found["bytes"]))
    assert whole.hex(" ").upper().startswith(frame[7].removesuffix(" …"))
    assert all(row[2] == whole[row[4] : row[4] + row[5]].hex(" ").upper() for row in found["rows"])
    assert answered(session, frame=10**9)["gone"]


def test_history_is_what_was_remembered(page: Page) -> None:
    for second in range(3):
        page.run.run_for("1 s")
        page.board.remember(float(second))
    session = page.session()
    found = answered(session, history=[0, 99], last=2)
    assert found == {"history": {"0": ([1.0, 2.0], [2.0, 3.0])}, "last": 2}


def test_nothing_is_done_without_the_token(page: Page) -> None:
    session = page.session()
    assert answered(session, do="fire 1", id=1) == {"done": 1, "why": "only with the token"}
    assert answered(session, write=1, value="off", id=2) == {"done": 2, "why": "only with the token"}
    assert answered(session, token="wrong") == {"may": False}
    assert answered(session, token=None) == {"may": False}
    assert session.wrong_tokens == 2
    assert answered(session, do="fire 1", id=3)["why"] == "only with the token"
    page.run.run_for("1 s")
    assert page.run.block(1).started == 0


def test_blocks_are_fired_and_switched_with_the_token(page: Page) -> None:
    session = page.session()
    assert answered(session, token=TOKEN) == {"may": True}
    assert answered(session, do="fire 1", id=1) == {"done": 1}
    page.run.run_for("500 ms")
    assert page.run.block(1).done == 1
    assert answered(session, do="disable 0", id=2) == {"done": 2}
    assert not page.run.block(0).enabled
    assert "there is no block 7" in str(answered(session, do="fire 7", id=3)["why"])
    for line in ("reset", "stop", "", "enable\nset 1 reset"):
        assert "why" in answered(session, do=line, id=4)


def test_a_browser_writes_no_lines_of_its_own_into_the_log(page: Page, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "framekit.extras.web")
    session = page.session()
    answered(session, token=TOKEN)
    forged = "\nINFO told\r\x1b[2K\u2028"
    for line in (f"fire{forged}", f"fire 'x{forged}'", f"enable set{forged}", f"disable {forged} \ud800", f"x{forged}"):
        assert "why" in answered(session, do=line, id=1)
    assert "why" in answered(session, write=1, value=f"5{forged}", id=2)
    logged = [record.getMessage() for record in caplog.records]
    assert len(logged) == 6 and all(line.isprintable() for line in logged)


@pytest.mark.parametrize(
    "told", [[], {}, "x", None, {"other": 1}, {"frame": "1"}, {"frame": True}, {"frame": -1}, {"history": 5},
             {"frame": 1.0}, {"history": [0.0], "last": 1}, {"history": [0], "last": 1.0}, {"frame": 10**400},
             {"write": 0.0, "value": "1", "id": 1}, {"do": "fire 0"}, {"do": "fire 0", "id": float("nan")},
             {"do": "fire 0", "id": {}},
             {"history": [0]}, {"history": ["0"], "last": 1}, {"filter": 1}, {"filter": "x" * 1000}, {"write": 99}],
)  # fmt: skip
def test_what_is_no_message_is_refused(page: Page, told: object) -> None:
    with pytest.raises(ValueError, match="this is no message"):
        asyncio.run(page.session().answer(told))


def test_what_is_told_is_json(page: Page) -> None:
    page.run.run_for("2 s")
    session = page.session()
    for message in (session.hello(), *session.news()):
        json.dumps(message, allow_nan=False)


def test_rows_that_go_and_come() -> None:
    rows = ChangingRows()
    one, two = ShownRow("", ("1",)), ShownRow("", ("2",))
    rows.put({"a": one, "b": two})
    assert rows.since(0) == {"a": one, "b": two}
    rows.put({"a": one, "b": one})
    assert (rows.since(1), rows.keys_round) == ({"b": one}, 1)
    rows.put({"b": one})
    assert (rows.since(2), rows.keys_round, rows.keys) == ({}, 3, ["b"])
    rows.put({"a": one, "b": one})
    assert rows.since(3) == {"a": one}


def test_the_history_is_bounded() -> None:
    assert PointHistory(1).size == 600
    assert PointHistory(20_000).size == 100
    history = PointHistory(0)
    for second in range(700):
        history.take(second, [])
    assert history.taken == 700
