"""The files of the page: its own folder, and the chart library uPlot out of the installed wheel `youplot`.

Code of others is read as a file and never imported. It is served only if its content is the known version.
"""

from __future__ import annotations

import hashlib
import logging
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import NamedTuple

log = logging.getLogger(__name__)

PAGE = Path(__file__).with_name("page")
KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}


class PageFile(NamedTuple):
    """A file that the server sends."""

    content: bytes
    kind: str
    """Its media type."""


CHART = "uPlot 1.6.31, MIT licence"
"""Name, version and licence of the chart library."""
CHART_WHEEL = "youplot"
CHART_FILES = {
    "uplot.js": (
        "youplot/vendor/uplot.iife.min.js",
        "2d27e8ad3d228164525ce213f9dc716f39b4e3aee0cc773fb3491c96cf4921a2",
    ),
    "uplot.css": (
        "youplot/vendor/uplot.min.css",
        "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    ),
}
"""Files of the chart library: name on the page, path in the wheel, SHA-256 of the content."""


def page_files() -> dict[str, PageFile]:
    """Return the files of the page by name."""
    return {
        file.name: PageFile(file.read_bytes(), KINDS[file.suffix]) for file in PAGE.iterdir() if file.suffix in KINDS
    }


def chart_files() -> dict[str, PageFile]:
    """Return the files of the chart library by name; empty without the wheel, and for another version of a file."""
    try:
        wheel = distribution(CHART_WHEEL)
        paths = {name: Path(str(wheel.locate_file(path))) for name, (path, _) in CHART_FILES.items()}
        files = {name: PageFile(path.read_bytes(), KINDS[path.suffix]) for name, path in paths.items()}
    except (PackageNotFoundError, OSError):
        log.warning("web: no charts – install the extra 'web' again: pip install '.[web]'")
        return {}
    if any(hashlib.sha256(files[name].content).hexdigest() != known for name, (_, known) in CHART_FILES.items()):
        log.warning("web: no charts – the wheel %s has another version of uPlot than %s", CHART_WHEEL, CHART)
        return {}
    return files
