"""The content that all browsers of one run, or of served devices, share: read on request and at limited rates."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Sequence

from framekit.api.rows import FRAME_HEAD, FrameEntry, fields_text, frame_row, meaning_of
from framekit.codec.contents import contents_of
from framekit.codec.shown import explain
from framekit.extras.web.access import Access
from framekit.extras.web.cards import Card
from framekit.extras.web.history import PointHistory
from framekit.extras.web.messages import LARGEST_MESSAGE
from framekit.extras.web.notices import Notices
from framekit.extras.web.session import WebSession
from framekit.extras.web.shown import ChangingRows, ChangingValues, Shown
from framekit.link.values import EVALUATION_ERRORS

log = logging.getLogger(__name__)

VALUES_EVERY = 0.2
TABLES_EVERY = 1.0
"""Minimum interval in seconds between two reads of the points, and of the tables."""
HISTORY_EVERY = 1.0
"""Interval in seconds between two moments of the history."""
LONGEST_CELL = 300
"""Maximum length of decoded fields, in characters."""
NAME_CELL = FRAME_HEAD.index("frame")


class WebBoard:
    """The content shared by all browsers of one run, read on request and at limited rates."""

    largest_message = LARGEST_MESSAGE

    def __init__(self, shown: Shown, now: Callable[[], float] = time.monotonic) -> None:
        self.shown = shown
        self.points = [(name, points[one]) for name, points in shown.groups for one in points]
        self.values = ChangingValues([points for _, points in shown.groups])
        self.tables = {table.name: ChangingRows() for table in shown.tables}
        self.history = PointHistory(len(self.points))
        self.cards: Sequence[Card] = ()
        self.cards_round = 0
        self.notices = Notices()
        self.began = time.time()
        self._now = now
        self._values_at = self._tables_at = float("-inf")

    def look(self) -> None:
        """Read the points and the tables, each if its last read is old enough."""
        now = self._now()
        if now - self._values_at >= 0.9 * VALUES_EVERY:
            self._values_at = now
            self.values.look()
        if now - self._tables_at >= 0.95 * TABLES_EVERY:
            self._tables_at = now
            self._look_at_tables()

    def _look_at_tables(self) -> None:
        found = self.shown.look(self.values.values)
        for name, rows in found.rows.items():
            self.tables[name].put(rows)
        if found.cards != self.cards:
            self.cards = found.cards
            self.cards_round += 1
        self.notices.look(found.troubles, time.time())

    @property
    def home(self) -> str:
        """Return the file of the page."""
        return self.shown.home

    def session(self, access: Access, who: str) -> WebSession:
        """Return a new session for a browser."""
        return WebSession(self, access, who)

    async def go_on(self) -> None:
        """Record the values at regular intervals."""
        while True:
            try:
                self.remember(time.time())
            except Exception:
                log.exception("web: the values are not remembered")
            await asyncio.sleep(HISTORY_EVERY)

    def remember(self, at: float) -> None:
        """Add a moment to the history, at this time (seconds since 1970)."""
        self.look()
        self.history.take(at, self.values.values)

    def age(self, point: int) -> float | None:
        """Return the seconds since the value of a point was read; None before that."""
        value = self.values.values[point] if point < len(self.values.values) else None
        return max(0.0, round(time.time() - value.time / 1e9, 1)) if value is not None and value.time else None

    def frame_cells(self, entry: FrameEntry) -> list[str]:
        """Return the row of a frame: as in `frame_row`, with the name of the innermost frame, and the fields."""
        cells = list(frame_row(entry, self.shown.view.seconds(entry.seen.at)))
        if entry.seen.kind == "frame":
            cells[NAME_CELL] = meaning_of(entry.seen)
        return [*cells, self.fields_text(entry)]

    def fields_text(self, entry: FrameEntry) -> str:
        """Return the decoded fields of a frame in one line."""
        protocol = self.shown.log.protocol(entry.channel)
        try:
            fields = contents_of(protocol).to_plain(entry.seen.frame, entry.seen.fields)
        except EVALUATION_ERRORS as error:  # a frame may contain anything
            return explain(error)
        text = fields_text(fields, named=False)
        return text if len(text) <= LONGEST_CELL else f"{text[:LONGEST_CELL]} …"
