"""The editor in a real browser: errors at their lines, bytes read and built, completion, and saving with the token.

With FRAMEKIT_SCREENSHOTS set, the pictures of docs/images are made anew.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from extras.web.chromium import Looking, browser, needs_chromium, program
from extras.web.edit_world import LAMP, written

pytestmark = pytest.mark.long

keys = pytest.importorskip("selenium.webdriver.common.keys").Keys
IMAGES = Path(__file__).parents[3] / "docs" / "images"
AREA = "#editor textarea"
SEQUENCE = """sequences:
  set_level:
    takes: [station, level]
    steps:
      - step: ask
        send: {SWITCH: {station: station, level: level}}
        receive: [{frame: STATE, then: end}]
        within: 500 ms
        on_timeout: [{at_most: 2, then: again, else: {fail: no_reply}}]
"""


@contextmanager
def editor(folder: Path, *words: str, token: bool = True) -> Iterator[Looking]:
    """Open the editor of a folder, as long as the context lasts."""
    with browser() as page, program(folder, "edit", *words) as (url, secret):
        page.driver.set_window_size(1400, 1000)
        page.open(f"{url}#token={secret}" if token else url)
        page.until(lambda: page.text("#problems .pill"))
        yield page
        page.driver.get("about:blank")
        page.run("return 1")


def picture(page: Looking, name: str) -> None:
    if os.environ.get("FRAMEKIT_SCREENSHOTS"):
        page.driver.save_screenshot(str(IMAGES / name))


def text(page: Looking) -> str:
    return str(page.run("return document.querySelector(arguments[0]).value", AREA))


def to_end_of(page: Looking, part: str) -> None:
    """Put the cursor after the first occurrence of a part of the text."""
    script = """const [field, part] = arguments, area = document.querySelector(field);
        const at = area.value.indexOf(part) + part.length;
        area.focus(); area.setSelectionRange(at, at)"""
    page.run(script, AREA, part)


def type_in(page: Looking, *texts: str) -> None:
    page.driver.find_element("css selector", AREA).send_keys(*texts)


@needs_chromium
def test_an_error_is_marked_and_bytes_are_read(tmp_path: Path) -> None:
    (tmp_path / "hall").mkdir()
    written(tmp_path / "hall", LAMP + SEQUENCE)
    with editor(tmp_path, "hall") as page:
        page.until(lambda: page.text("#problems .pill") == "None")
        assert page.text("#frames h3 button") == "SWITCH"
        assert page.text("#frames .boxes").split() == [
            "const", "02", "1", "station", "u8", "1", "level", "u16", "big", "2", "check", "crc16-modbus", "2",
        ]  # fmt: skip
        page.type("#hex", "02 05 01 00 00 00")
        page.until(lambda: page.text("#try .fault") == "00")
        assert "check, expected 0D 10, found 00 00 at byte 4" in page.text("#try h3")
        page.type("#hex", "02 05 01 00 0D 10")
        page.until(lambda: "level" in page.text("#try .fields") and not page.text("#try .fault"))
        assert "256" in page.text("#try .fields")
        picture(page, "edit.png")
        page.click("[data-tab=sequences]")
        page.until(lambda: "fails: no_reply" in page.run("return document.querySelector('#sequences svg').textContent"))
        to_end_of(page, "type: u16")
        type_in(page, keys.BACKSPACE, keys.BACKSPACE, "88")
        page.until(lambda: page.text("#problems .pill") == "1 to correct")
        assert page.text("#problems li").startswith("Line 10")
        assert page.run("return document.querySelector('.gutter .bad').textContent") == "10"
        assert page.run("return document.querySelector('.line .wrong').textContent") == "u88"
        assert page.run("return document.querySelector('#meaning').classList.contains('old')")
        page.until(lambda: "Correct the definition first" in page.text("#try .why"))
        assert page.errors() == []


@needs_chromium
def test_a_small_file_needs_no_scroll_bar_of_the_page(tmp_path: Path) -> None:
    (tmp_path / "lamp.yaml").write_text("protocol: lamp\nframes: {A: {body: [{feild: a, type: u8}]}}\n", "utf-8")
    with editor(tmp_path) as page:
        page.until(lambda: "1 to correct" in page.text("#problems .pill"))
        assert page.run("return document.documentElement.scrollHeight <= innerHeight")
        assert page.errors() == []


@needs_chromium
def test_a_form_builds_a_frame(tmp_path: Path) -> None:
    written(tmp_path)
    with editor(tmp_path) as page:
        page.until(lambda: page.text("#frames h3 button"))
        page.click("#frames h3 button")
        page.until(lambda: page.text("#build button") == "Build")
        for number, value in ((1, "5"), (2, "256")):
            page.type(f"#build label:nth-child({number}) input", value)
        page.click("#build form > button")
        page.until(lambda: page.run("return document.querySelector('#hex').value") == "02 05 01 00 0D 10")
        page.until(lambda: "256" in page.text("#try .fields"))
        page.type("#build label:nth-child(2) input", "70000")
        page.click("#build form > button")
        page.until(lambda: "70000" in page.text("#build .why"))
        assert page.run("return document.querySelector('#build label:nth-child(2) input').className") == "wrong"
        assert page.errors() == []


@needs_chromium
def test_words_are_completed_and_the_file_is_saved(tmp_path: Path) -> None:
    path = written(tmp_path)
    with editor(tmp_path, "lamp.yaml") as page:
        page.until(lambda: page.text("#may") == "May edit and save")
        to_end_of(page, "from: server")
        type_in(page, keys.ENTER, "mar")
        page.until(lambda: page.text(".words li b") == "mark")
        type_in(page, keys.ENTER)
        page.until(lambda: "    mark: \n" in text(page))
        type_in(page, "fi")
        page.until(lambda: page.text(".words li b") == "first")
        type_in(page, keys.TAB)
        assert text(page) == LAMP.replace("from: server\n", "from: server\n    mark: first\n")
        assert page.run("return document.querySelector('#changed').hidden") is False
        type_in(page, keys.CONTROL, "s")
        page.until(lambda: path.read_text("utf-8") == text(page))
        page.until(lambda: page.run("return document.querySelector('#changed').hidden"))
        path.write_text(LAMP, "utf-8")
        page.until(lambda: text(page) == LAMP)
        type_in(page, "#")
        path.write_text(LAMP + "# other", "utf-8")
        page.until(lambda: "has changed on disk: copy" in page.text("#told"))
        type_in(page, keys.CONTROL, "s")
        page.until(lambda: "Not saved: lamp.yaml has changed on disk" in page.text("#told"))
        assert path.read_text("utf-8") == LAMP + "# other"
        assert page.errors() == []
        page.run("window.onbeforeunload = null; document.querySelector('#save').click()")


PLANT = """# the plant
run: plant
memory: masterlogic
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-rtu, station: 1}
blocks:
  # the levels
  0: {read: "40001", count: 2, into: MW0, every: 1 s}   # two words
  1: {write: "40010", station: 2, from: MW20, when: MW10.2}
points:
  level: {channel: 1, address: "40001", unit: mm}   # of the tank
"""


@needs_chromium
def test_a_table_writes_yaml_and_keeps_comments(tmp_path: Path) -> None:
    (tmp_path / "hall").mkdir()
    path = written(tmp_path / "hall", PLANT, "plant.run.yaml")
    written(tmp_path / "hall", "device: meter\nprotocol: modbus-rtu\nstation: 1\n", "meter.device.yaml")
    with editor(tmp_path, str(path)) as page:
        page.until(lambda: page.text("#may") == "May edit and save" and page.text("#table h2") == "Blocks")
        page.until(lambda: page.run("return document.querySelectorAll('#table tbody')[0].rows.length") == 3)
        picture(page, "edit-run.png")
        size = "[aria-label='Size of 0']"
        page.type(size, "4" + keys.TAB)
        page.until(lambda: text(page) == PLANT.replace("count: 2", "count: 4"))
        page.type("[aria-label='Kind and address of the new row']", "40020" + keys.ENTER)
        page.until(lambda: "  2: {read: 40020}\n" in text(page))
        page.until(lambda: page.run("return document.querySelector(\"[aria-label='Own address of 2']\")"))
        page.type("[aria-label='Own address of 2']", "%MW30" + keys.TAB)
        page.until(lambda: '  2: {read: 40020, into: "%MW30"}\n' in text(page))
        page.until(lambda: page.text("#problems li").startswith("Line"))
        page.click("[aria-label='remove 1']")
        page.until(lambda: "  1: {write" not in text(page))
        type_in(page, keys.CONTROL, "z")
        page.until(lambda: "  1: {write" in text(page))
        page.click("#save")
        page.until(lambda: path.read_text("utf-8") == text(page))
        assert all(comment in text(page) for comment in ("# the plant", "# the levels", "# two words", "# of the tank"))
        assert page.errors() == []


@needs_chromium
def test_a_telephone_shows_everything_below_each_other(tmp_path: Path) -> None:
    path = written(tmp_path, PLANT, "plant.run.yaml")
    written(tmp_path, "device: meter\nprotocol: modbus-rtu\nstation: 1\n", "meter.device.yaml")
    with editor(tmp_path, str(path)) as page:
        page.until(lambda: page.text("#table h2") == "Blocks" and page.text("#frames h3 button"))
        page.driver.set_window_size(500, 1000)
        page.until(lambda: page.run("return document.documentElement.scrollWidth <= innerWidth"))
        tops = page.run("return ['table', 'definition', 'problems', 'try', 'meaning'].map(id => "
                        "document.getElementById(id).getBoundingClientRect().top)")  # fmt: skip
        assert tops == sorted(tops)
        before = page.run("return getComputedStyle(document.body).backgroundColor")
        page.click("#theme")
        page.until(lambda: page.run("return getComputedStyle(document.body).backgroundColor") != before)
        assert page.errors() == []


@needs_chromium
def test_a_device_is_tried(tmp_path: Path) -> None:
    (tmp_path / "hall").mkdir()
    device = "device: meter\nprotocol: modbus-rtu\nstation: 3\nmemory: {set: {'40001': [7, 8]}}\n"
    written(tmp_path / "hall", device, "meter.device.yaml")
    with editor(tmp_path, "hall") as page:
        page.click("[data-tab=trial]")
        page.until(lambda: page.text("#trial button") == "Try it")
        page.type("[data-trial=address]", "40001")
        page.click("#trial button")
        page.until(lambda: page.text("#trial .result") == "Done · values 7")
        page.click("#trial details:nth-child(2) summary")
        page.until(lambda: "values" in page.text("#trial .fields"))
        picture(page, "edit-try.png")
        page.type("[data-trial=address]", "nowhere")
        page.click("#trial button")
        page.until(lambda: "is not an address" in page.text("#trial .why"))
        assert page.errors() == []


@needs_chromium
def test_without_the_token_the_text_is_read_only_and_nothing_is_saved(tmp_path: Path) -> None:
    path = written(tmp_path)
    with editor(tmp_path, token=False) as page:
        page.until(lambda: page.text("#frames h3 button") == "SWITCH")
        assert page.text("#may") == "Read only"
        type_in(page, "x")
        assert text(page) == LAMP
        page.run("document.querySelector(arguments[0]).readOnly = false", AREA)
        to_end_of(page, "protocol: lamp")
        type_in(page, "s")
        page.until(lambda: "only with the token" in page.text("#told"))
        page.run("const save = document.querySelector('#save'); save.disabled = false; save.click()")
        page.until(lambda: "Not saved: only with the token" in page.text("#told"))
        assert path.read_text("utf-8") == LAMP


def make(page: Looking, kind: str, name: str, of: str = "") -> None:
    """Make a new file with the dialog."""
    page.click("#new")
    script = """const one = document.querySelector('#new-kind');
        one.value = arguments[0]; one.dispatchEvent(new Event('input'))"""
    page.run(script, kind)
    page.type("#new-name", name)
    if of:
        page.type("#new-of", of)
    page.click("#ask .main")


@needs_chromium
@pytest.mark.long
def test_new_files_are_made_from_templates_and_tried(tmp_path: Path) -> None:
    with browser() as page, program(tmp_path, "edit") as (url, secret):
        page.driver.set_window_size(1400, 1000)
        page.open(f"{url}#token={secret}")
        page.until(lambda: page.text("#may") == "May edit and save")
        assert page.text("#what") == "No YAML file here yet: press New"
        make(page, "protocol", "lamp")
        page.until(lambda: "protocol: lamp" in text(page) and page.text("#problems .pill") == "None")
        page.click("#new")
        page.type("#new-name", "lamp")
        page.until(lambda: page.text("#ask label + p, #ask p") == "Makes the file lamp.yaml")
        page.click("#ask .main")
        page.until(lambda: "lamp.yaml exists already" in page.text("#ask .why"))
        page.click("#ask footer button")
        make(page, "device", "hall", "lamp")
        page.until(lambda: "device: hall" in text(page) and page.text("#problems .pill") == "None")
        make(page, "run", "plant", "hall.device.yaml")
        page.until(lambda: "run: plant" in text(page) and page.text("#problems .pill") == "None")
        page.click("[data-tab=trial]")
        press = "const one = document.querySelector('#trial button'); one?.click(); return Boolean(one)"
        page.until(lambda: page.run(press))  # in one step: the panel is drawn again after each check
        page.until(lambda: "exchanges done" in page.text("#trial"))
        assert sorted(path.name for path in tmp_path.iterdir()) == ["hall.device.yaml", "lamp.yaml", "plant.run.yaml"]
        assert page.errors() == []
