"""Watches the file of a run that goes on, and hands its new content over once it stays as it is.

Content is looked at, not times, so that every way of saving is noticed and none twice. Files are read and runs are
loaded outside the event loop. What is done with a new run is not known here.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from framekit.definition.problems import DefinitionError
from framekit.run.model import RunModel
from framekit.runfile.run_file import load_run

INTERVAL = 1.0
"""Seconds between two looks; a content is taken when two looks in a row find it."""


class FileWatch:
    """Loads the run of `path` anew when its content has changed, or when `look_now` is called.

    `changed` gets the run; what it raises as DefinitionError or ValueError, and what is wrong with the file, goes to
    `refused`. One content is tried once; `known` is the one that the run began with.
    """

    def __init__(
        self,
        path: Path,
        known: bytes | None,
        changed: Callable[[RunModel], None],
        refused: Callable[[ValueError], None],
    ) -> None:
        self.path = path
        self.changed = changed
        self.refused = refused
        self._asked = asyncio.Event()
        self._seen = self._tried = known

    def look_now(self) -> None:
        """Loads the file as it is, changed or not."""
        self._asked.set()

    async def watch(self) -> None:
        """Goes on until it is cancelled."""
        while True:
            try:
                await asyncio.wait_for(self._asked.wait(), INTERVAL)
                self._asked.clear()
                asked = True
            except TimeoutError:
                asked = False
            content = await asyncio.to_thread(content_of, self.path)
            settled, self._seen = content == self._seen, content
            if asked or (settled and content is not None and content != self._tried):
                self._tried = content
                await self._load()

    async def _load(self) -> None:
        try:
            self.changed(await asyncio.to_thread(load_run, self.path))
        except ValueError as error:
            self.refused(error)


def content_of(path: Path) -> bytes | None:
    """None: it cannot be read now, which an editor that replaces files may cause for a moment."""
    try:
        return path.read_bytes()
    except OSError:
        return None


def reasons(error: ValueError) -> list[str]:
    """Why an edit was refused, one sentence each, with places in files where there are any."""
    if isinstance(error, DefinitionError):
        return [str(problem) for problem in error.problems if not problem.warning]
    return [str(error)]
