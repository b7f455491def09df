"""The content of the page without a browser: cards, notices, stored courses, ages, and the chart library."""

from __future__ import annotations

import asyncio
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")

from extras.web.page_world import METER, RUN, TOKEN, Page, written

from framekit.api.errors import RequestError
from framekit.api.points import course_of
from framekit.extras.web import assets
from framekit.extras.web.access import Access
from framekit.extras.web.board import WebSession
from framekit.extras.web.cards import Card, Rate
from framekit.extras.web.notices import MOST_NOTICES, Notices

SECOND = 1_000_000_000
BEGIN = 946_684_800
"""Begin of virtual time: 2000, in seconds since 1970."""


def cards(page: Page) -> dict[str, Card]:
    """Return the cards of a page by title."""
    page.board.look()
    return {card.title: card for card in page.board.cards}


def test_cards_say_how_the_run_is(tmp_path: Path) -> None:
    page = Page(written(tmp_path))
    for _ in range(4):
        page.run.run_for("1 s")
        found = cards(page)
    assert found["Line"] == Card("Line", "Open", "1 channel · modbus-tcp client", "good")
    assert found["Exchanges"].value == f"{found['Exchanges'].number:.1f} /s"
    assert (found["Errors"].value, found["Errors"].text) == ("0", "None so far")
    assert found["Stations"] == Card("Stations", "Answers", "1 station, in step", "good")
    assert found["Points"] == Card("Points", "3 of 3", "All good")
    assert "Load" not in found


def test_a_dead_station_is_named_on_its_card_and_as_a_notice(tmp_path: Path) -> None:
    run = RUN.replace("station: 1}\npoints", "station: 9}\npoints")
    page = Page(written(tmp_path, run))
    for _ in range(40):
        page.run.run_for("1 s")
        found = cards(page)
    assert found["Errors"].state == "bad" and "no reply" in found["Errors"].text
    assert found["Stations"].state == "bad" and "station 9" in found["Stations"].text
    assert found["Points"].value == "0 of 3"
    (notice,) = page.board.notices
    assert notice.text.startswith("channel 1") and "3 points without a good value" in notice.text
    session = page.session()
    notices = [message["notices"] for message in session.news() if "notices" in message]
    assert [notice[1] for notice in notices[0]] == [notice.text]
    assert not any("notices" in message for message in session.news())


def test_a_channel_that_is_switched_off_is_no_trouble(tmp_path: Path) -> None:
    page = Page(written(tmp_path))
    page.run.run_for("2 s")
    page.run.enable_channel(1, False)
    page.run.run_for("2 s")
    assert cards(page)["Line"] == Card("Line", "Closed", "1 channel · modbus-tcp client")
    assert list(page.board.notices) == []


def test_a_rate_is_of_the_last_seconds() -> None:
    rate = Rate()
    assert rate.read(0, 0) is None
    assert rate.read(SECOND, 10) is None
    assert rate.read(2 * SECOND, 20) == 10
    assert [rate.read(at * SECOND, 20) for at in range(3, 9)][-1] == 0
    assert rate.has_increased_within(8 * SECOND, 7 * SECOND) and not rate.has_increased_within(60 * SECOND, SECOND)


def test_notices_last_until_they_are_over_and_are_bounded() -> None:
    notices = Notices()
    notices.look({"a": "a is away"}, 1.0)
    notices.look({"a": "a is away, 3 samples wait"}, 2.0)
    assert [(notice.text, notice.began, notice.ended) for notice in notices] == [
        ("a is away, 3 samples wait", 1.0, None)
    ]
    notices.look({}, 3.0)
    notices.look({"a": "a is away"}, 4.0)
    assert [(notice.number, notice.ended) for notice in notices] == [(1, 3.0), (2, None)]
    before = notices.round
    notices.look({"a": "a is away"}, 5.0)
    assert notices.round == before
    for number in range(2 * MOST_NOTICES):
        notices.look({f"b{number}": "b"}, 6.0)
    assert len(list(notices)) == MOST_NOTICES


# ---- stored values -----------------------------------------------------------------------------------------------

STORED = "sinks:\n  - {sqlite: plant.sqlite, every: 1s}\n"


def stored(folder: Path, seconds: int = 20) -> Page:
    """Return the page of a run that has stored its values for some seconds."""
    page = Page(written(folder, RUN + STORED))
    page.run.run_for(f"{seconds} s")
    page.run.stop()
    return page


def test_a_stored_course_has_the_least_and_the_greatest_number_of_each_step(tmp_path: Path) -> None:
    page = stored(tmp_path)
    point, state = page.board.points[0][1], page.board.points[1][1]
    path = tmp_path / "plant.sqlite"
    found = course_of(path, point, BEGIN * SECOND, (BEGIN + 20) * SECOND, 4)
    assert found.step == 5 * SECOND
    pairs = list(zip(found.least, found.greatest, strict=True))
    assert all(low is not None and high is not None and low < high for low, high in pairs)
    assert [low for low, _ in pairs] == sorted(low for low, _ in pairs if low is not None)
    words = course_of(path, state, BEGIN * SECOND, (BEGIN + 20) * SECOND, 4)
    assert set(words.least) == {2.0}
    later = course_of(path, point, (BEGIN + 100) * SECOND, (BEGIN + 104) * SECOND, 2)
    assert later.least == later.greatest == [19.0, 19.0]
    with pytest.raises(RequestError, match="there is no"):
        course_of(tmp_path / "other.sqlite", point, 0, 1, 1)


def test_a_browser_asks_for_stored_values(tmp_path: Path) -> None:
    page = stored(tmp_path)
    session = page.session()
    assert session.hello()["stored"] is True
    found: Any = asyncio.run(session.answer({"course": [0, 1], "since": BEGIN, "until": BEGIN + 20}))
    assert len(found["numbers"]) == 2 and len(found["times"]) == len(found["numbers"][0]) > 20
    assert found["times"] == sorted(found["times"])
    for told in (
        {"course": [0], "since": 20, "until": 20},
        {"course": [], "since": 0, "until": 20},
        {"course": [0], "since": 0, "until": 10**12},
        {"course": [99], "since": 0, "until": 20},
        {"course": "0", "since": 0, "until": 20},
    ):
        with pytest.raises(ValueError, match="this is no message"):
            asyncio.run(session.answer(told))


def test_a_run_without_a_history_has_none(tmp_path: Path) -> None:
    session = Page(written(tmp_path)).session()
    assert session.hello()["stored"] is False
    with pytest.raises(ValueError, match="this is no message"):
        asyncio.run(session.answer({"course": [0], "since": 0, "until": 20}))


def test_ages_are_those_of_the_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = Page(written(tmp_path, RUN, METER))
    session = WebSession(page.board, Access(TOKEN), "test:1")
    page.board.look()
    assert asyncio.run(session.answer({"ages": [0, 99]})) == {"ages": {"0": None}}
    page.run.run_for("2 s")
    page.board._values_at = float("-inf")
    page.board.look()
    read = page.board.values.values[0].time / 1e9
    monkeypatch.setattr(time, "time", lambda: read + 4.25)
    assert asyncio.run(session.answer({"ages": [0]})) == {"ages": {"0": 4.2}}


# ---- the chart library -------------------------------------------------------------------------------------------


@pytest.mark.skipif(find_spec("youplot") is None, reason="youplot is not installed")
def test_the_chart_library_is_served_only_as_the_known_version(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    files = assets.chart_files()
    assert set(files) == {"uplot.js", "uplot.css"}
    assert b"v1.6.31" in files["uplot.js"].content[:200] and "1.6.31" in assets.CHART
    monkeypatch.setitem(assets.CHART_FILES, "uplot.css", (assets.CHART_FILES["uplot.css"][0], "0" * 64))
    assert assets.chart_files() == {}
    monkeypatch.setattr(assets, "CHART_WHEEL", "no-such-wheel")
    assert assets.chart_files() == {}
    assert "another version" in caplog.text and "install the extra 'web'" in caplog.text


def test_a_trouble_that_lasts_stays_among_many_that_are_over() -> None:
    notices = Notices()
    notices.look({"sink": "cannot write"}, 0)
    for number in range(2 * MOST_NOTICES):
        notices.look({"sink": "cannot write", "line": f"no reply {number}"}, number)
        notices.look({"sink": "cannot write"}, number)
    found = list(notices)
    assert len(found) == MOST_NOTICES and found[0].text == "cannot write" and found[0].ended is None
