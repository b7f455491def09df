"""The page of an unknown line in a real browser: coloured bytes, a byte under the pointer, a click that names.

With FRAMEKIT_SCREENSHOTS set, the picture of docs/images is made again.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from extras.guess.hex_world import hex_text, polled
from extras.web.chromium import Looking, browser, needs_chromium, program
from extras.web.test_browser import picture

from framekit.cli.main import main

pytest.importorskip("starlette")
action_chains = pytest.importorskip("selenium.webdriver.common.action_chains")

pytestmark = [needs_chromium, pytest.mark.long]


def cells(page: Looking, row: int) -> list[Any]:
    """Return the cells of a row's bytes in hex."""
    script = """return [...document.querySelectorAll('#lines .cells')].filter(one => !one.hidden)[arguments[0]]
        .querySelectorAll('.hex i:not(.none)')"""
    return list(page.run(script, row))


def shades(page: Looking, row: int) -> list[str]:
    return [str(cell.get_attribute("class")).split()[0] for cell in cells(page, row)]


def drag(page: Looking, row: int, first: int, last: int) -> None:
    found = cells(page, row)
    chain = action_chains.ActionChains(page.driver)
    chain.click_and_hold(found[first]).move_to_element(found[last]).release().perform()


def point(page: Looking, row: int, at: int) -> None:
    action_chains.ActionChains(page.driver).move_to_element(cells(page, row)[at]).perform()


def name(page: Looking, words: str, type_: str, order: str = "big") -> None:
    page.until(lambda: not page.run("return document.querySelector('#naming').hidden"))
    page.type("#name", words)
    page.run(
        "const [type, order] = arguments; const pick = (id, value) => { const one = document.getElementById(id);"
        "one.value = value; one.dispatchEvent(new Event('change')); }; pick('type', type); pick('order', order)",
        type_, order,
    )  # fmt: skip
    page.click("#give")


def test_a_click_names_a_field_and_the_definition_passes(tmp_path: Path) -> None:
    (tmp_path / "meter.txt").write_text(hex_text(polled()), "utf-8")
    written = tmp_path / "meter.yaml"
    with browser() as page, program(tmp_path, "guess", "meter.txt", "--write", "meter.yaml") as (url, token):
        page.open(url)
        page.until(lambda: len(cells(page, 1)) == 9)
        seen = shades(page, 1)
        assert (seen[1], seen[3], seen[7:]) == ("copy", "value", ["check", "check"])
        assert "a frame begins with A5" in page.text("#said")
        point(page, 1, 3)
        page.until(lambda: "40 different values" in page.text("#tip"))
        assert "f32 CDAB" in page.text("#tip") and "u16 big" in page.text("#tip")
        drag(page, 1, 2, 5)
        page.until(lambda: "f32 big" in page.text("#types"))
        assert page.run("return document.querySelector('#naming').hidden")  # the token is still missing
        page.open(f"{url}#token={token}")
        page.until(lambda: page.text("#may") == "May name fields")
        page.until(lambda: len(cells(page, 1)) == 9)
        drag(page, 1, 2, 5)
        name(page, "level", "f32")
        page.until(lambda: page.text("#told") == "Done")
        page.until(lambda: shades(page, 1)[2:6] == ["named"] * 4)
        assert "{field: level, type: f32}" in written.read_text("utf-8")
        drag(page, 1, 2, 5)
        page.until(lambda: "level" in page.text("#what"))
        page.run("document.querySelector('#types tr.row').click()")
        page.until(lambda: not page.run("return document.querySelector('#course').hidden"))
        if os.environ.get("FRAMEKIT_SCREENSHOTS"):
            page.driver.set_window_size(1280, 900)
            point(page, 9, 2)
            page.until(lambda: "u8" in page.text("#tip"))
            picture(page, "web-guess.png")
        before = written.read_text("utf-8")
        cells(page, 1)[6].click()
        name(page, "level", "u8")
        page.until(lambda: "already" in page.text("#told"))
        name(page, "not a name", "u8")
        page.until(lambda: "is no name" in page.text("#told"))
        assert written.read_text("utf-8") == before
        name(page, "status", "bits")
        page.until(lambda: shades(page, 1)[6] == "named")
        page.click("#definition summary")
        page.until(lambda: "status_7" in page.text("#definition pre"))
        assert page.errors() == []
    assert main(["check", str(written)]) == 0 and main(["test", str(written)]) == 0


def test_a_definition_is_shown_with_noise_and_names_are_text(tmp_path: Path) -> None:
    many = polled(40) * 60
    (tmp_path / "meter.txt").write_text(hex_text(many), "utf-8")
    (tmp_path / "meter.yaml").write_text(HOSTILE, "utf-8")
    with browser() as page, program(tmp_path, "guess", "meter.txt", "--with", "meter.yaml") as (url, _):
        page.open(url)
        page.until(lambda: len(cells(page, 1)) == 9)
        assert shades(page, 1)[:2] == ["constant", "named"]
        cells(page, 1)[6].click()
        page.until(lambda: "status" in page.text("#what"))
        assert "<b>" in page.text("#what") or "<b>" in page.text("#layout")
        page.run("document.querySelector('#kinds').value = '-1';"
                 "document.querySelector('#kinds').dispatchEvent(new Event('change'))")  # fmt: skip
        page.until(lambda: shades(page, 0) == ["noise"] * 3)
        page.run("document.querySelector('#kinds').value = '';"
                 "document.querySelector('#kinds').dispatchEvent(new Event('change'))")  # fmt: skip
        page.until(lambda: len(cells(page, 1)) == 9)
        page.run("document.querySelector('#lines').scrollTop = 1e9")
        page.until(lambda: page.run(LAST) == str(len(many)))
        assert page.run("return document.querySelectorAll('#lines .cells').length") < 100
        assert page.errors() == []


def test_a_telephone_shows_whole_rows_of_bytes(tmp_path: Path) -> None:
    (tmp_path / "meter.txt").write_text(hex_text(polled()), "utf-8")
    with browser() as page, program(tmp_path, "guess", "meter.txt") as (url, _):
        page.open(url)
        page.until(lambda: page.text("#heads").split()[:2] == ["no.", "s"])
        narrow = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
        page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", narrow)
        page.until(lambda: page.text("#heads").split()[:2] == ["no.", "frame"])
        assert page.run("const one = document.querySelector('#lines'); return one.scrollWidth <= one.clientWidth")
        assert page.errors() == []


LAST = """return [...document.querySelectorAll('#lines .cells')].filter(one => !one.hidden)
    .map(one => one.firstChild.textContent).filter(Boolean).at(-1)"""

HOSTILE = """protocol: meter
frames:
  asked:
    body:
      - {const: A5}
      - {field: station, type: u8}
      - {field: first, type: u8}
      - {const: 10}
      - {check: crc16-modbus, order: little}
  told:
    body:
      - {const: A5}
      - {field: station, type: u8}
      - {field: level, type: f32}
      - {field: status, type: u8, values: {0: "<b>off</b>", 1: "on", 128: "<b>bad</b>"}}
      - {check: crc16-modbus, order: little}
"""
