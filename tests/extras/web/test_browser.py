"""The page of a run in a real browser: values, charts, frames, trouble, and actions with the token.

With FRAMEKIT_SCREENSHOTS set, the pictures of docs/images are made anew.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from extras.web.chromium import Looking, browser, needs_chart, needs_chromium, program
from extras.web.page_world import METER, written
from extras.web.page_world import RUN as WORLD

action_chains = pytest.importorskip("selenium.webdriver.common.action_chains")
keys = pytest.importorskip("selenium.webdriver.common.keys")

ROOT = Path(__file__).parents[3]
IMAGES = ROOT / "docs" / "images"


MAKES_PICTURES = bool(os.environ.get("FRAMEKIT_SCREENSHOTS"))


def picture(page: Looking, name: str) -> None:
    if MAKES_PICTURES:
        IMAGES.mkdir(exist_ok=True)
        page.driver.save_screenshot(str(IMAGES / name))


def value(page: Looking, name: str) -> str:
    return next((row[2] for row in page.rows("points") if row[1] == name), "")


def done_of(page: Looking, block: str) -> str:
    return next((row[6] for row in page.rows("blocks") if row[2] == block), "")


def quick(folder: Path) -> Path:
    """Write a run whose values change ten times a second."""
    device = METER.replace("over: 1000 s", "over: 100 s, every: 100 ms")
    return written(folder, WORLD.replace("every: 1s", "every: 100 ms"), device)


@pytest.mark.long
@needs_chromium
def test_values_move_and_frames_are_filtered_and_paused(tmp_path: Path) -> None:
    with browser() as page, program(tmp_path, "run", str(quick(tmp_path))) as (url, _):
        page.open(url)
        first = page.until(lambda: value(page, "level"))
        page.until(lambda: value(page, "level") not in ("", first, "-"))
        assert page.run("return document.body.classList.contains('may')") is False
        page.until(lambda: any("=" in row[7] for row in page.rows("frames")))
        assert {row[6] for row in page.rows("frames")} <= {"read_holding", "read_holding_reply"}
        page.type("#frame-filter", "frame:no_such_frame")
        page.until(lambda: page.rows("frames") == [])
        page.until(lambda: page.text("#frames .grid .empty") == "No frame fits the filter")
        page.type("#frame-filter", "ch:1 frame:holding_reply")
        page.until(lambda: page.rows("frames"))
        assert {row[6] for row in page.rows("frames")} == {"read_holding_reply"}
        page.click("#pause")
        page.until(lambda: page.text("#pause") == "Go on")
        moved = value(page, "level")
        page.until(lambda: value(page, "level") != moved)
        kept = page.rows("frames")
        moved = value(page, "level")
        page.until(lambda: value(page, "level") != moved)
        assert page.rows("frames") == kept
        page.click("#pause")
        page.until(lambda: page.rows("frames") != kept)
        assert page.errors() == []
        hosts = page.run("return performance.getEntriesByType('resource').map(one => new URL(one.name).host)")
        assert set(hosts) == {page.run("return location.host")}


@needs_chromium
@needs_chart
@pytest.mark.long
def test_points_are_filtered_grouped_and_drawn(tmp_path: Path) -> None:
    with browser() as page, program(tmp_path, "run", str(quick(tmp_path))) as (url, _):
        page.open(url)
        page.until(lambda: value(page, "level") not in ("", "–", "-"))
        assert [row[4] for row in page.rows("points")] == ["good"] * 3
        page.until(lambda: page.rows("points")[0][5].endswith(" s"))
        page.type("#point-filter", "lev")
        page.until(lambda: [row[1] for row in page.rows("points")] == ["level"])
        page.type("#point-filter", "")
        page.run(
            "const one = document.querySelector('#group'); one.value = '!'; one.dispatchEvent(new Event('change'))"
        )
        page.until(lambda: page.rows("points") == [])
        page.until(lambda: page.text("#points .empty") == "All are good")
        page.run("const one = document.querySelector('#group'); one.value = ''; one.dispatchEvent(new Event('change'))")
        page.until(lambda: len(page.rows("points")) == 3)
        legend = "[...document.querySelectorAll('.u-legend .u-label')].map(one => one.textContent)"
        page.until(lambda: "level" in page.run(f"return {legend}"))
        page.until(lambda: page.run("return document.querySelectorAll('.u-over').length") >= 1)
        page.run("document.querySelector('#points .grid').focus()")
        page.driver.switch_to.active_element.send_keys(keys.Keys.END, keys.Keys.ARROW_UP, keys.Keys.ENTER)
        page.until(lambda: "state" in page.run(f"return {legend}"))
        page.until(lambda: "uPlot 1.6.31" in page.text("#foot"))


DOUBTFUL = """  flue: {channel: 1, address: "40011", type: float32}
  heat: {channel: 1, address: "40013", type: float32, unit: kW}
"""
NUMBERS = '"40002": [2, 5], "40011": [0, 0x7FC0], "40013": [0x42F6, 0xE979]'
"""Not a number, and 123.456 with the high word first."""


@needs_chromium
@pytest.mark.long
def test_bad_and_doubtful_points_are_seen_at_the_top(tmp_path: Path) -> None:
    run = WORLD.replace("blocks:\n", f"{DOUBTFUL}blocks:\n")
    path = written(tmp_path, run, METER.replace('"40002": [2, 5]', NUMBERS))
    says = ("channel 1: not a number", "order of words: heat")
    with browser() as page, program(tmp_path, "run", str(path), trouble=says, status=0) as (url, _):
        page.open(url)
        page.until(
            lambda: "heat reads -1.8833671e+25 kW, with order: ABCD it would be 123.456 kW" in page.text("#notices")
        )
        page.until(lambda: "not a number (NaN)" in page.text("#notices"))
        page.until(lambda: page.text("#wrong") == "1 not good")
        page.click("#wrong")
        page.until(lambda: [row[1] for row in page.rows("points")] == ["flue"])
        assert value(page, "flue") == "–"
        page.click("#wrong")
        page.until(lambda: len(page.rows("points")) == 5)
        assert page.run("return document.querySelector('#frame').hidden")


WIDE = """run: wide
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
  2: {port: "tcp://127.0.0.1:9", protocol: modbus-tcp, station: 1}
points:
  level: {channel: 1, address: "40001", unit: mm, decimals: 2, every: 100 ms}
  state: {channel: 1, address: "40002", enum: {0: off, 2: heating}, access: rw, every: 100 ms}
  outside: {channel: 2, address: "40001", unit: mm, every: 100 ms}
"""


@needs_chromium
@needs_chart
@pytest.mark.long
def test_long_reasons_leave_all_columns_in_view_and_states_are_drawn_in_words(tmp_path: Path) -> None:
    with (
        browser() as page,
        program(tmp_path, "run", str(written(tmp_path, WIDE)), trouble="framekit run: channel 2 was never open") as (
            url,
            _,
        ),
    ):
        page.driver.set_window_size(1280, 1000)
        page.open(url)
        page.until(
            lambda: any("no connection to 127.0.0.1:9: Connection refused" in row[4] for row in page.rows("points"))
        )
        page.until(lambda: page.text("#notices .count") == "1 now")
        table = "const one = document.querySelector('#points .grid'); return [one.scrollWidth, one.clientWidth]"
        assert len(set(page.run(table))) == 1
        page.click_row("points", "state")
        legend = "return [...document.querySelectorAll('.u-value')].map(one => one.textContent.trim())"
        page.until(lambda: "heating" in page.run(legend))
        page.until(lambda: [text for text in page.run(legend) if re.fullmatch(r"\d+\.\d\d mm", text)])
        assert page.errors() == []


@needs_chromium
@needs_chart
@pytest.mark.long
def test_the_chart_is_zoomed_and_goes_on(tmp_path: Path) -> None:
    with browser() as page, program(tmp_path, "run", str(quick(tmp_path))) as (url, _):
        page.open(url)
        page.until(lambda: page.run("return document.querySelectorAll('.u-over').length") >= 1)
        over = page.driver.find_element("css selector", ".u-over")
        page.until(lambda: page.text(".u-legend .u-value") not in ("", "--"))
        drag = action_chains.ActionChains(page.driver).move_to_element_with_offset(over, -60, 0).click_and_hold()
        drag.move_by_offset(80, 0).release().perform()
        page.until(lambda: page.run("return document.querySelector('#trend').classList.contains('zoomed')"))
        action_chains.ActionChains(page.driver).move_to_element(over).double_click().perform()
        page.until(lambda: not page.run("return document.querySelector('#trend').classList.contains('zoomed')"))
        page.click("[data-span='60']")
        page.until(lambda: page.run("return document.querySelector('[data-span=\"60\"]').className") == "on")
        assert page.errors() == []


@needs_chromium
@needs_chart
@pytest.mark.long
def test_older_values_come_from_the_history_of_the_run(tmp_path: Path) -> None:
    sink = "sinks:\n  - {sqlite: plant.sqlite, every: 200 ms}\n"
    path = written(tmp_path, WORLD.replace("every: 1s", "every: 100 ms") + sink)
    with browser() as page, program(tmp_path, "run", str(path)) as (url, _):
        page.open(url)
        page.until(lambda: value(page, "level") not in ("", "–", "-"))
        page.until(lambda: page.run("return document.querySelectorAll('.u-over').length") >= 1)
        page.click("[data-span='3600']")
        page.until(lambda: page.text(".u-legend .u-value") not in ("", "--", "–", "– mm"))
        assert page.text("#told") == ""
        assert page.errors() == []


@needs_chromium
@pytest.mark.long
def test_fire_and_write_need_the_token(tmp_path: Path) -> None:
    with browser() as page, program(tmp_path, "run", str(written(tmp_path))) as (url, token):
        page.open(url)
        page.until(lambda: value(page, "limit") == "5")
        page.press("points", "limit")
        page.until(lambda: page.run("return document.querySelector('#lock').open"))
        assert page.text("#ask") == ""
        page.run(WRITE_ANYWAY)
        page.until(lambda: page.run("return document.body.dataset.refused") == "only with the token")
        page.type("#token", "not the token at all")
        page.click("#key button")
        page.until(lambda: page.text("#told") == "This is not the token")
        page.open(f"{url}#token={token}")
        page.until(lambda: page.text("#may") == "May fire and write")
        assert page.run("return location.href") == url
        page.click("#tabs button:nth-child(3)")
        page.until(lambda: done_of(page, "1") == "0")
        page.press("blocks", "by hand")
        page.until(lambda: "Block 1" in page.text("#ask h2"))
        page.click("#ask .main")
        page.until(lambda: page.text("#told") == "Done: fire 1")
        page.until(lambda: done_of(page, "1") == "1")
        page.press("points", "limit")
        page.until(lambda: "Now: 5" in page.text("#ask"))
        page.type("#value", "7")
        page.click("#ask .main")
        page.until(lambda: "Write 7 in place of 5?" in " ".join(page.text("#ask").split()))
        assert value(page, "limit") == "5"
        page.click("#ask .main")
        page.until(lambda: value(page, "limit") == "7")
        page.press("points", "limit")
        page.until(lambda: "Now: 7" in page.text("#ask"))
        page.type("#value", "11")
        page.click("#ask .main")
        page.click("#ask .main")
        page.until(lambda: "11 is not in 0..10" in page.text("#ask .why"))
        page.click("#ask [type=button]")
        assert value(page, "limit") == "7"
        assert page.errors() == []


WRITE_ANYWAY = """const socket = new WebSocket(`ws://${location.host}/live`);
    socket.onopen = () => socket.send(JSON.stringify({ write: 2, value: "7", id: 1 }));
    socket.onmessage = event => {
      const what = JSON.parse(event.data);
      if ("done" in what) document.body.dataset.refused = what.why;
    };"""


def shows_the_bytes_of_a_frame(page: Looking) -> bool:
    """Choose a request, and return whether its bytes are shown: its row may leave the table at any time."""
    page.click_row("frames", "read_holding")
    page.until(lambda: "bytes" in page.text("#frame h3"))
    size = page.run("return document.querySelectorAll('#frame .bytes span').length")
    return str(size) in [row[5] for row in page.rows("frames") if "picked" in row[0]]


@needs_chromium
@pytest.mark.long
def test_a_lost_channel_turns_red_and_a_chosen_frame_shows_its_bytes(tmp_path: Path) -> None:
    device = [sys.executable, "-m", "framekit", "serve", str(written(tmp_path).with_name("meter.device.yaml"))]
    with subprocess.Popen(
        [*device, "--port", "tcp://127.0.0.1:0", "--quiet"], stdout=subprocess.PIPE, text=True
    ) as there:
        assert there.stdout is not None
        port = there.stdout.readline().rsplit(" ", 1)[1].strip()
        run = RUN.replace("PORT", port)
        (tmp_path / "lost.run.yaml").write_text(run, "utf-8")
        try:
            with browser() as page, program(tmp_path, "run", "lost.run.yaml") as (url, _):
                page.open(url)
                page.until(lambda: [row[6] for row in page.rows("channels")] == ["open"])
                page.until(lambda: shows_the_bytes_of_a_frame(page))
                first = value(page, "level")
                page.until(lambda: value(page, "level") != first)
                there.send_signal(signal.SIGINT)
                page.until(lambda: "lost" in page.rows("channels")[0][0])
                page.until(lambda: "Channel 1" in page.text("#notices"))
                page.until(lambda: page.run("return document.querySelector('#cards .bad b') !== null"))
                colours = page.run(
                    "return ['[data-table=channels] tr.lost td', '#cards .bad b', '#notices .pill.bad']"
                    ".map(one => getComputedStyle(document.querySelector(one)).color)"
                )
                assert set(colours) == {"rgb(185, 44, 44)"}
                page.until(lambda: not page.rows("points")[0][5].startswith("good"))
                page.click("#notices button")
                page.until(lambda: page.run("return document.querySelector('#notices').hidden"))
        finally:
            there.kill()


@needs_chromium
@pytest.mark.long
def test_a_phone_shows_the_page_without_scrolling_sideways(tmp_path: Path) -> None:
    with browser() as page, program(tmp_path, "run", str(written(tmp_path))) as (url, _):
        page.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride", {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
        )
        page.open(url)
        page.until(lambda: value(page, "level") not in ("", "–"))
        assert page.run("return document.documentElement.scrollWidth") <= 390


@needs_chromium
@pytest.mark.long
def test_the_pictures_of_a_run(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    with browser() as page, program(tmp_path / "examples", "run", "oven.run.yaml") as (url, _):
        page.driver.set_window_size(1280, 1240)
        page.open(url)
        page.until(lambda: int(page.text("#frames .count").split()[0]) > (150 if MAKES_PICTURES else 20))
        page.click("#pause")
        page.click_row("frames", "read_holding_reply")
        page.until(lambda: "bytes" in page.text("#frame h3"))
        picture(page, "web-run.png")
        page.click("#theme")
        page.until(lambda: page.run("return document.documentElement.dataset.theme") == "dark")
        assert page.run("return getComputedStyle(document.body).backgroundColor") == "rgb(14, 19, 25)"
        picture(page, "web-run-dark.png")


RUN = """run: plant
memory: masterlogic
channels:
  1: {port: "PORT", protocol: modbus-tcp, station: 1}
points:
  level: {channel: 1, address: "40001", unit: mm, every: 200 ms}
  state: {channel: 1, address: "40002", enum: {0: off, 2: heating}, access: rw, every: 1s}
blocks:
  0: {read: "40001", channel: 1, count: 2, into: MW0, every: 1s}
"""

HOSTILE = "<img src=x onerror=document.title='caught'>"


@needs_chromium
@needs_chart
@pytest.mark.long
def test_names_and_values_are_text_whatever_they_are(tmp_path: Path) -> None:
    path = written(tmp_path, HOSTILE_RUN.replace("HOSTILE", HOSTILE))
    with browser() as page, program(tmp_path, "run", str(path)) as (url, token):
        page.open(f"{url}#token={token}")
        page.until(lambda: any(row[3] == HOSTILE for row in page.rows("points")))
        page.until(lambda: any(HOSTILE in row[3] for row in page.rows("blocks")))
        page.until(lambda: any(row[2] == HOSTILE for row in page.rows("points")))
        page.until(lambda: HOSTILE in page.text(".u-legend"))
        page.press("points", "text")
        page.until(lambda: f"Now: {HOSTILE}" in page.text("#ask"))
        page.click("#ask .main")
        page.until(lambda: f"Write {HOSTILE}" in page.text("#ask"))
        page.click("#ask [type=button]")
        page.click("#tabs button:nth-child(3)")
        page.press("blocks", HOSTILE)
        page.until(lambda: HOSTILE in page.text("#ask h2"))
        page.click("#ask footer [type=button]")
        page.until(lambda: page.rows("frames"))
        page.click_row("frames", "read_holding")
        page.until(lambda: "bytes" in page.text("#frame h3"))
        assert page.run("return document.querySelectorAll('img, script:not([src])').length") == 0
        assert (page.driver.title, page.text("#title")) == ("run plant", "plant")
        page.run(INLINE_SCRIPT)
        assert page.driver.title != "caught"
        assert any("Content Security Policy" in line for line in page.errors())


INLINE_SCRIPT = """const script = document.createElement("script");
    script.textContent = "document.title = 'caught'";
    document.body.append(script)"""

HOSTILE_RUN = """run: plant
memory: masterlogic
set: {MW100: [1, 2]}
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
points:
  level: {channel: 1, address: "40001", unit: "HOSTILE", about: "HOSTILE", every: 1s}
  text: {channel: 1, address: "40002", enum: {2: "HOSTILE"}, access: rw, every: 1s}
blocks:
  0: {read: "40001", channel: 1, name: "HOSTILE", into: MW0, every: 1s}
"""
