"""The page of served devices in a real browser: values and memory are set, faults are switched.

With FRAMEKIT_SCREENSHOTS set, the picture of docs/images is made anew.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from extras.web.chromium import Looking, browser, needs_chromium, program
from extras.web.test_browser import MAKES_PICTURES, ROOT, picture, quick, value

pytestmark = [needs_chromium, pytest.mark.long]

OVEN = str(ROOT / "examples" / "oven.device.yaml")
CELLS = "return [...document.querySelectorAll('#areas tbody tr.row')][0].innerText.split(/\\s+/)"


def element(page: Looking, number: int) -> str:
    """Return the shown value of an element in the first row of the area."""
    return str(page.run(CELLS)[number + 1])


def test_values_of_a_device_are_shown_and_set(tmp_path: Path) -> None:
    with browser() as page, program(tmp_path, "serve", OVEN, "--port", "tcp://127.0.0.1:0") as (url, token):
        page.open(url)
        page.until(lambda: value(page, "setpoint") == "180.0")
        assert {row[2] for row in page.rows("devices")} == {"modbus-tcp"}
        behaviours = {row[1]: row[6] for row in page.rows("points")}
        assert {row[1]: row[3] for row in page.rows("points")}["supply"] == "V"
        page.until(lambda: page.text("#cards b") == "Station 1")
        assert behaviours["supply"] == "random walk 220..240, start 230, step 0.5"
        page.press("points", "setpoint")
        page.until(lambda: page.run("return document.querySelector('#lock').open"))
        page.open(f"{url}#token={token}")
        page.until(lambda: page.text("#may") == "May set values and switch faults")
        page.press("points", "setpoint")
        page.until(lambda: "Now: 180.0" in page.text("#ask"))
        page.type("#value", "30")
        page.click("#ask .main")
        page.click("#ask .main")
        page.until(lambda: value(page, "setpoint") == "30.0")
        first = value(page, "temperature")
        page.until(lambda: value(page, "temperature") != first)
        assert page.errors() == []


def test_elements_of_an_area_are_set_and_found(tmp_path: Path) -> None:
    with browser() as page, program(tmp_path, "serve", OVEN, "--port", "tcp://127.0.0.1:0") as (url, token):
        page.open(f"{url}#token={token}")
        page.until(lambda: page.text("#may") == "May set values and switch faults")
        page.until(lambda: page.run(CELLS)[0] == "40001")
        page.until(lambda: element(page, 1) == "1800")
        page.run("document.querySelectorAll('#areas tbody tr.row')[0].querySelectorAll('button')[1].click()")
        page.until(lambda: "Now: 1800" in page.text("#ask"))
        page.type("#value", "-5")
        page.click("#ask .main")
        page.until(lambda: "Set -5 in place of 1800?" in page.text("#ask"))
        page.click("#ask .main")
        page.until(lambda: element(page, 1) == "65531")
        page.run(
            "const one = document.querySelector('#form'); one.value = 'hex'; one.dispatchEvent(new Event('change'))"
        )
        page.until(lambda: element(page, 1) == "FFFB")
        narrow = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
        page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", narrow)
        page.until(lambda: page.run("return document.querySelectorAll('#areas thead th').length") == 6)
        assert page.run("return document.documentElement.scrollWidth") <= 390
        page.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        page.type("#address", "10002")
        page.run("document.querySelector('#go').requestSubmit()")
        page.until(lambda: page.text("#area-tabs .on") == "input" and page.text("#areas .found") != "")
        assert page.errors() == []


def test_a_fault_is_switched_on_and_off(tmp_path: Path) -> None:
    run = "run: asks\nchannels:\n  1: {port: PORT, protocol: modbus-tcp, station: 1, reply_timeout: 300 ms}\npoints:\n"
    run += '  level: {channel: 1, address: "40002", every: 200 ms}\n'
    device = "tcp://127.0.0.1:{}"
    with browser() as page, program(tmp_path, "serve", OVEN, "--port", device.format(0)) as (url, token):
        page.open(f"{url}#token={token}")
        port = page.until(lambda: page.text("#cards p").removeprefix("modbus-tcp · "))
        (tmp_path / "asks.run.yaml").write_text(run.replace("PORT", port), "utf-8")
        with program(tmp_path, "run", "asks.run.yaml"):
            page.until(lambda: any(row[6] == "read_holding" for row in page.rows("frames")))
            page.until(lambda: "/s" in page.text("#cards section:nth-child(2) b"))
            if MAKES_PICTURES:
                page.until(lambda: float(value(page, "temperature")) > 60)
            page.run("[...document.querySelectorAll('.switch')].find(one => one.innerText == 'No reply').click()")
            page.until(lambda: "time" in page.text(".switch.on .count"))
            page.until(lambda: "No reply is switched on" in page.text("#told"))
            if MAKES_PICTURES:
                page.driver.set_window_size(1280, 1240)
                page.until(lambda: len(page.rows("frames")) > 8)
                picture(page, "web-device.png")
            page.run("document.querySelector('.switch.on').click()")
            page.until(lambda: "No reply is switched off" in page.text("#told"))
            page.until(lambda: page.text(".switch.on") == "")
        assert page.errors() == []


def test_the_devices_of_a_run_are_a_page_of_their_own(tmp_path: Path) -> None:
    with browser() as page, program(tmp_path, "run", str(quick(tmp_path))) as (url, token):
        page.open(f"{url}#token={token}")
        page.until(lambda: value(page, "level") not in ("", "–", "-"))
        assert page.text("#pages").split() == ["Run", "Devices"]
        page.run("[...document.querySelectorAll('#pages a')].find(one => one.textContent == 'Devices').click()")
        page.until(lambda: page.text("#may") == "May set values and switch faults")
        assert page.text("[aria-current]") == "Devices"
        assert page.text("#parts").split() == ["Values", "Trend", "Memory", "Faults", "Frames", "Details"]
        page.until(lambda: page.run(CELLS)[0] == "40001")
        page.run("[...document.querySelectorAll('.switch')].find(one => one.innerText == 'No reply').click()")
        page.until(lambda: "No reply is switched on" in page.text("#told"))
        page.run("document.querySelector('#pages a').click()")
        page.until(lambda: page.text("#may") == "May fire and write")
        page.until(lambda: "no reply – 3 points without a good value" in page.text("#notices li"))
        assert page.errors() == []
