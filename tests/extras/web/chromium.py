"""Debian's Chromium for tests, driven by selenium; and a program that serves the page."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import pytest

webdriver = pytest.importorskip("selenium.webdriver")
wait = pytest.importorskip("selenium.webdriver.support.wait")

T = TypeVar("T")
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None or DRIVER is None, reason="chromium and chromium-driver are not installed"
)
needs_chart = pytest.mark.skipif(find_spec("youplot") is None, reason="youplot is not installed")
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--window-size=1200,1500",
)  # fmt: skip
LONGEST = 30


class Looking:
    """A page in a browser."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def open(self, url: str) -> None:
        self.driver.get("about:blank")  # the browser would not reload for a change after # only
        self.driver.get(url)
        self.until(lambda: self.text("#state") == "Live")

    def until(self, found: Callable[[], T]) -> T:
        """Return the result of `found` as soon as it is true. Raise TimeoutException."""
        return wait.WebDriverWait(self.driver, LONGEST, 0.05, ignored_exceptions=[Exception]).until(lambda _: found())

    def run(self, script: str, *given: Any) -> Any:
        return self.driver.execute_script(script, *given)

    def text(self, selector: str) -> str:
        return str(self.run("return document.querySelector(arguments[0])?.innerText ?? ''", selector))

    def rows(self, section: str) -> list[list[str]]:
        """Return the displayed rows of a table, each with its class first."""
        script = """return [...document.querySelectorAll(arguments[0])].filter(row => !row.hidden)
            .map(row => [row.className, ...[...row.cells].map(cell => cell.textContent)])"""
        return list(self.run(script, self.rows_of(section)))

    @staticmethod
    def rows_of(section: str) -> str:
        """Return the selector for the rows of a table."""
        place = f"#{section} .grid" if section in ("points", "frames", "areas") else f"[data-table={section}]"
        return f"{place} tr.row"

    def click(self, selector: str) -> None:
        self.driver.find_element("css selector", selector).click()

    def click_row(self, section: str, text: str) -> None:
        """Click the first row that contains a text."""
        script = """const row = [...document.querySelectorAll(arguments[0])]
            .find(row => !row.hidden && row.textContent.includes(arguments[1]));
            row?.cells[0].click(); return Boolean(row)"""
        self.until(lambda: self.run(script, self.rows_of(section), text))

    def press(self, section: str, text: str) -> None:
        """Click the button of the first row that contains a text."""
        script = """const row = [...document.querySelectorAll(arguments[0])]
            .find(row => !row.hidden && row.textContent.includes(arguments[1]));
            const button = row?.querySelector('button'); button?.click(); return Boolean(button)"""
        self.until(lambda: self.run(script, self.rows_of(section), text))

    def type(self, selector: str, text: str) -> None:
        field = self.driver.find_element("css selector", selector)
        field.clear()
        field.send_keys(text)

    def errors(self) -> list[str]:
        """Return the errors in the log of the browser, without those of lost connections."""
        messages = [str(line["message"]) for line in self.driver.get_log("browser") if line["level"] == "SEVERE"]
        return [line for line in messages if "favicon" not in line and "WebSocket connection" not in line]


@contextmanager
def browser() -> Iterator[Looking]:
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with tempfile.TemporaryDirectory() as folder:
        for option in (*OPTIONS, f"--user-data-dir={folder}/profile"):
            options.add_argument(option)
        service = webdriver.ChromeService(DRIVER, log_output=os.devnull)
        driver = webdriver.Chrome(options=options, service=service)
        try:
            yield Looking(driver)
        finally:
            driver.quit()


@contextmanager
def program(
    folder: Path, *words: str, trouble: str | tuple[str, ...] = "", status: int | None = None, **environment: str
) -> Iterator[tuple[str, str]]:  # fmt: skip
    """Run `framekit …` with a page and yield its address and token.

    `trouble`: the begin of its messages. `status`: its exit status; default: 3 with trouble, else 0.
    """
    expected = (3 if trouble else 0) if status is None else status
    command = [sys.executable, "-m", "framekit", *words, "--web", "0", "--json"]
    with subprocess.Popen(
        command, cwd=folder, env=os.environ | environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            event = json.loads(process.stdout.readline())
            threading.Thread(target=process.stdout.read, daemon=True).start()  # a full pipe would stop the program
            yield event["url"], event.get("token", "")
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(timeout=60)
        assert process.stderr is not None
        messages = [line for line in process.stderr.read().splitlines() if not trouble or not line.startswith(trouble)]
    assert (process.returncode, messages) == (expected, [])
