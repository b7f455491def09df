"""The page in a real browser: values move, a filter filters, pause pauses, a lost channel turns red, and the token.

With FRAMEKIT_SCREENSHOTS set, the pictures of docs/images are made anew.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from extras.web.chromium import Looking, browser, needs_chromium, program
from extras.web.page_world import METER, written
from extras.web.page_world import RUN as WORLD

ROOT = Path(__file__).parents[3]
IMAGES = ROOT / "docs" / "images"


def picture(page: Looking, name: str) -> None:
    if os.environ.get("FRAMEKIT_SCREENSHOTS"):
        IMAGES.mkdir(exist_ok=True)
        page.driver.save_screenshot(str(IMAGES / name))


def value(page: Looking, name: str) -> str:
    return next((row[2] for row in page.rows("points") if row[1] == name), "")


def done_of(page: Looking, block: str) -> str:
    return next((row[6] for row in page.rows("blocks") if row[2] == block), "")


@needs_chromium
def test_values_move_and_frames_are_filtered_and_paused(tmp_path: Path) -> None:
    quick = METER.replace("over: 1000 s", "over: 100 s, every: 100 ms")
    path = written(tmp_path, WORLD.replace("every: 1s", "every: 100 ms"), quick)
    with browser() as page, program(tmp_path, "run", str(path)) as (url, _):
        page.open(url)
        first = page.until(lambda: value(page, "level"))
        page.until(lambda: value(page, "level") not in ("", first, "-"))
        assert page.run("return document.body.classList.contains('may')") is False
        page.until(lambda: any("=" in row[9] for row in page.rows("frames")))
        page.type("#frame-filter", "frame:no_such_frame")
        page.until(lambda: page.rows("frames") == [])
        page.type("#frame-filter", "ch:1")
        page.until(lambda: page.rows("frames"))
        page.click("#pause")
        page.until(lambda: page.text("#pause") == "go on")
        moved = value(page, "level")
        page.until(lambda: value(page, "level") != moved)
        kept = page.rows("frames")
        moved = value(page, "level")
        page.until(lambda: value(page, "level") != moved)
        assert page.rows("frames") == kept
        page.click("#pause")
        page.until(lambda: page.rows("frames") != kept)
        assert page.errors() == []


@needs_chromium
@pytest.mark.long
def test_fire_and_write_need_the_token(tmp_path: Path) -> None:
    with browser() as page, program(tmp_path, "run", str(written(tmp_path))) as (url, token):
        page.open(url)
        page.click_row("blocks", "0")
        assert page.run("return [...document.querySelectorAll('#block button')].every(one => one.disabled)")
        page.run("document.querySelectorAll('#block button').forEach(one => { one.disabled = false; })")
        page.click("#block [data-do=fire]")
        page.until(lambda: "only with the token" in page.text("#told"))
        page.type("#token", "not the token at all")
        page.click("#key button")
        page.until(lambda: page.text("#told") == "this is not the token")
        page.open(f"{url}#token={token}")
        page.until(lambda: page.text("#may") == "may fire and write")
        assert page.run("return location.href") == url
        page.until(lambda: done_of(page, "1") == "0")
        page.click_row("blocks", "by hand")
        page.click("#block [data-do=fire]")
        page.until(lambda: page.text("#told") == "done")
        page.until(lambda: done_of(page, "1") == "1")
        page.click_row("points", "limit")
        page.type("#value", "7")
        page.click("#write button")
        page.until(lambda: value(page, "limit") == "7")
        page.type("#value", "11")
        page.click("#write button")
        page.until(lambda: "11 is not in 0..10" in page.text("#told"))
        assert value(page, "limit") == "7"
        assert page.errors() == []


def shows_the_bytes_of_a_frame(page: Looking) -> bool:
    """Choose a request, and return whether its bytes are shown: its row may leave the table at any time."""
    page.click_row("frames", "request")
    page.until(lambda: "bytes" in page.text("#frame h3"))
    shown = page.run("return [...document.querySelectorAll('#bytes .hex')].map(one => one.innerText).join(' ')")
    return shown in [row[8] for row in page.rows("frames") if "picked" in row[0]]


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
                page.click_row("points", "level")
                page.until(lambda: shows_the_bytes_of_a_frame(page))
                first = value(page, "level")
                page.until(lambda: value(page, "level") != first)
                there.send_signal(signal.SIGINT)
                page.until(lambda: "lost" in page.rows("channels")[0][0])
                red = page.run("return getComputedStyle(document.querySelector('#channels tr.lost')).backgroundColor")
                assert red == "rgb(198, 40, 40)"
                page.until(lambda: not page.rows("points")[0][4].startswith("good"))
        finally:
            there.kill()


@needs_chromium
@pytest.mark.long
def test_values_of_a_device_are_shown_and_set(tmp_path: Path) -> None:
    oven = str(ROOT / "examples" / "oven.device.yaml")
    with browser() as page, program(tmp_path, "serve", oven, "--port", "tcp://127.0.0.1:0") as (url, token):
        page.open(url)
        page.until(lambda: value(page, "setpoint") == "180.0")
        assert {row[2] for row in page.rows("devices")} == {"modbus-tcp"}
        page.click_row("points", "setpoint")
        assert page.run("return document.querySelector('#write').hidden")
        page.open(f"{url}#token={token}")
        page.click_row("points", "setpoint")
        page.until(lambda: not page.run("return document.querySelector('#write').hidden"))
        page.type("#value", "30")
        page.click("#write button")
        page.until(lambda: value(page, "setpoint") == "30.0")
        first = value(page, "temperature")
        page.until(lambda: value(page, "temperature") != first)
        page.click_row("points", "temperature")
        picture(page, "web-device.png")
        assert page.errors() == []


@pytest.mark.skipif(not os.environ.get("FRAMEKIT_SCREENSHOTS"), reason="FRAMEKIT_SCREENSHOTS is not set")
@needs_chromium
@pytest.mark.long
def test_the_picture_of_a_run(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    with browser() as page, program(tmp_path / "examples", "run", "oven.run.yaml") as (url, _):
        page.open(url)
        page.click_row("points", "temperature")
        page.until(lambda: int(page.text("#frames .count").split()[0]) > 80)
        page.click_row("frames", "reply")
        page.until(lambda: "bytes" in page.text("#frame h3"))
        picture(page, "web-run.png")


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
@pytest.mark.long
def test_names_and_values_are_text_whatever_they_are(tmp_path: Path) -> None:
    path = written(tmp_path, HOSTILE_RUN.replace("HOSTILE", HOSTILE))
    with browser() as page, program(tmp_path, "run", str(path)) as (url, token):
        page.open(f"{url}#token={token}")
        page.until(lambda: any(row[3] == HOSTILE for row in page.rows("points")))
        page.until(lambda: any(HOSTILE in row[3] for row in page.rows("blocks")))
        page.until(lambda: any(row[2] == HOSTILE for row in page.rows("points")))
        page.click_row("points", "level")
        page.until(lambda: HOSTILE in page.text("#point h3"))
        page.click_row("points", "text")
        page.type("#value", HOSTILE + HOSTILE)
        page.click("#write button")
        page.until(lambda: HOSTILE + HOSTILE in page.text("#told"))
        page.click_row("blocks", HOSTILE)
        page.until(lambda: page.rows("frames"))
        page.click_row("frames", "request")
        page.until(lambda: "bytes" in page.text("#frame h3"))
        assert page.run("return document.querySelectorAll('img, script:not([src])').length") == 0
        assert page.driver.title == page.text("#title") == "run plant"
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
