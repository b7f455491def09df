"""The documentation site: it has every page and no broken link, and a browser shows and searches it."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from docs.pages import PAGES, ROOT
from extras.web.chromium import browser, needs_chromium

import framekit

pytest.importorskip("mkdocs", reason="mkdocs-material is not installed")
pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("docs")
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "site.py"), "--no-diagrams", "-o", str(place)],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return place / "site"


class Silent(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *words: object) -> None:
        """Discard the log message."""


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Silent, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_every_page_is_in_it(site: Path) -> None:
    for page in PAGES:
        name = str(page.relative_to(ROOT).with_suffix(".html")).replace("README.html", "index.html")
        assert (site / name).is_file(), name
    assert len(list(site.glob("gallery/*.html"))) > 45


def test_nothing_comes_from_elsewhere(site: Path) -> None:
    for name in ("index.html", "docs/points.html", "gallery/modbus-rtu.html"):
        text = (site / name).read_text("utf-8")
        loaded = re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="?(https?:[^">\s]+)', text)
        assert loaded == [], name


def test_a_link_that_leads_nowhere_is_refused(tmp_path: Path) -> None:
    pages, settings = tmp_path / "pages", tmp_path / "mkdocs.yml"
    pages.mkdir()
    settings.write_text(f"INHERIT: {ROOT / 'mkdocs.yml'}\ndocs_dir: pages\nsite_dir: site\n", "utf-8")
    (pages / "index.md").write_text("# Start\n\n[x](points.md) [y](points.md#values)\n", "utf-8")
    (pages / "points.md").write_text("# Points\n\n## Values\n", "utf-8")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(settings)]
    assert subprocess.run(command, capture_output=True).returncode == 0
    (pages / "index.md").write_text("# Start\n\n[x](nowhere.md) [y](points.md#nowhere)\n", "utf-8")
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode != 0 and "nowhere.md" in done.stderr and "#nowhere" in done.stderr


@needs_chromium
def test_a_browser_shows_it_and_finds_pages(address: str) -> None:
    with browser() as page:
        page.driver.get(f"{address}/gallery/modbus-rtu.html")
        assert "modbus-rtu" in page.driver.title
        pictures = page.run("return [...document.images].map(one => one.complete && one.naturalWidth)")
        assert len(pictures) > 20 and all(pictures[:3])
        page.driver.get(f"{address}/index.html")
        page.run("document.querySelector('[data-md-toggle=search]').checked = true")
        page.until(lambda: page.type(".md-search__input", "fault plan") or True)
        found = "return [...document.querySelectorAll('.md-search-result__item a')].map(one => one.innerText)"
        assert any("Fault plans" in text for text in page.until(lambda: page.run(found)))
        assert page.errors() == []


def test_the_api_has_every_public_name(site: Path) -> None:
    text = (site / "api.html").read_text("utf-8")
    shown = set(re.findall(r'<h2 id="framekit\.[a-z_.]*\.(\w+)"', text))
    assert shown == set(framekit.__all__)
    assert "open_within" in text[text.index('id="framekit.api.client.connect"') :][:20_000], "arguments of connect"
