"""One browser: what it has been shown, what it wants to see, and what it may do.

Nothing is kept for it but the rounds that it knows, so that a slow browser loses what came in between.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from typing import Any

from framekit import __version__
from framekit.api.errors import FramekitError, RequestError
from framekit.api.monitor import FrameFilter, parse_filter
from framekit.api.points import RunPoint
from framekit.api.rows import POINT_HEAD, FrameEntry, field_row, frame_row
from framekit.codec.plain import PlainValues
from framekit.codec.shown import explain
from framekit.definition.problems import printable
from framekit.web.access import Access, Visitor
from framekit.web.messages import Actions, Message, Told, answered, plain_text, whole_number
from framekit.web.shown import ChangingRows, ChangingValues, PointHistory, Shown, value_cells

log = logging.getLogger(__name__)

VALUES_EVERY = 0.2
TABLES_EVERY = 1.0
"""Seconds between two looks at the points, and at the tables."""
PIECE = 500
"""So many values or rows are in one message."""
MOST_FRAMES = 40
KEPT_FRAMES = 200
"""Frames in one message; frames that are looked for when the filter is another."""
LOOKED_AT = 1_000
LOOKED_THROUGH = 3_000
"""So many frames are compared with a filter at once, of those that came since, and of those before a new filter."""
LONGEST_CELL = 300
"""Characters of decoded fields."""
MOST_HISTORIES = 64
HISTORY_EVERY = 1.0
"""Seconds between two moments of the history."""


class WebBoard:
    """What all browsers are shown of one run; looked at when one of them wants it, and not too often."""

    home = "page.html"

    def __init__(self, shown: Shown, now: Callable[[], float] = time.monotonic) -> None:
        self.shown = shown
        self.points = [(name, points[one]) for name, points in shown.groups for one in points]
        self.values = ChangingValues([points for _, points in shown.groups])
        self.tables = {table.name: ChangingRows() for table in shown.tables}
        self.history = PointHistory(len(self.points))
        self._now = now
        self._values_at = self._tables_at = float("-inf")
        self._plain: dict[int, PlainValues] = {}

    def look(self) -> None:
        """Looks at what may be older than it should."""
        now = self._now()
        if now - self._values_at >= 0.9 * VALUES_EVERY:
            self._values_at = now
            self.values.look()
        if now - self._tables_at >= 0.95 * TABLES_EVERY:
            self._tables_at = now
            for name, rows in self.shown.rows().items():
                self.tables[name].put(rows)

    def session(self, access: Access, who: str) -> WebSession:
        """That of one browser."""
        return WebSession(self, access, who)

    async def go_on(self) -> None:
        """Remembers the values, moment after moment."""
        while True:
            try:
                self.remember(time.time())
            except Exception:
                log.exception("web: the values are not remembered")
            await asyncio.sleep(HISTORY_EVERY)

    def remember(self, at: float) -> None:
        """One more moment of the history, at this time (seconds since 1970)."""
        self.look()
        self.history.take(at, self.values.values)

    def fields_text(self, entry: FrameEntry) -> str:
        """The decoded fields of a frame in one line."""
        protocol = self.shown.log.protocol(entry.channel)
        plain = self._plain.get(entry.channel)
        if plain is None or plain.protocol is not protocol:
            plain = self._plain[entry.channel] = PlainValues(protocol)
        try:
            fields = plain.to_plain(entry.seen.frame, entry.seen.fields)
        except Exception as error:  # a frame may be anything
            return f"({explain(error)})"
        text = ", ".join(f"{name}={_flat(value)}" for name, value in fields.items())
        return text if len(text) <= LONGEST_CELL else text[:LONGEST_CELL] + " …"


def _flat(value: Any) -> str:
    if isinstance(value, dict):
        return "(" + ", ".join(f"{name}={_flat(item)}" for name, item in value.items()) + ")"
    return str(value)


class WebSession:
    """One browser at `who`. `news` is what it has not seen; `answer` does what it asks for."""

    def __init__(self, board: WebBoard, access: Access, who: str) -> None:
        self.board = board
        self.visitor = Visitor(access, who)
        self._values_seen = 0
        self._rows_seen = dict.fromkeys(board.tables, 0)
        self._filter = FrameFilter()
        self._paused = False
        self._frame_seen = 0
        self._anew = True
        self._actions: Actions = {
            "token": lambda given, told: self.visitor.give(given),
            "filter": self._filtered,
            "pause": self._pause,
            "frame": self._frame,
            "history": self._history,
            "do": self._do,
            "write": self._write,
        }

    @property
    def wrong_tokens(self) -> int:
        """So many it has given."""
        return self.visitor.wrong_tokens

    # ---- what it is shown ---------------------------------------------------------------------------------

    def hello(self) -> Message:
        """What stays as it is: the tables' heads, and what the points are."""
        shown = self.board.shown
        return {
            "hello": shown.title,
            "version": __version__,
            "controls": shown.control is not None,
            "tables": [[table.name, table.head] for table in shown.tables],
            "pointHead": POINT_HEAD,
            "points": [_about(group, point) for group, point in self.board.points],
        }

    def news(self) -> Iterator[Message]:
        """What has changed since the last time, in messages of bounded size."""
        board = self.board
        board.look()
        for name, table in board.tables.items():
            seen = self._rows_seen[name]
            self._rows_seen[name] = table.round
            keys = {"keys": table.keys} if table.keys_round > seen else {}
            rows = table.since(seen)
            if rows or keys:
                yield from _pieces({"table": name, **keys}, "rows", rows)
        values = {at: value_cells(value, point) for at, value, point in board.values.since(self._values_seen)}
        self._values_seen = board.values.round
        if values:
            yield from _pieces({}, "values", values)
        frames = self._frames()
        if frames is not None:
            yield frames

    def _frames(self) -> Message | None:
        """Frames that the filter wants: the newest of those that came, or the last of those that are kept."""
        shown = self.board.shown
        if self._paused and not self._anew:
            return None
        entries, missed = self._kept() if self._anew else self._newer()
        anew, self._anew = self._anew, False
        if not entries and not missed and not anew:
            return None
        counts = shown.log.counts
        rows = [[*frame_row(one, shown.view.seconds(one.seen.at)), self.board.fields_text(one)] for one in entries]
        counted = [counts["frame"], counts["bad"], counts["noise"]]
        return {"frames": rows, "anew": anew, "missed": missed, "counts": counted}

    def _newer(self) -> tuple[list[FrameEntry], int]:
        """What came since the last time, and how many of these are left out."""
        shown = self.board.shown
        newer = shown.log.since(self._frame_seen, LOOKED_AT)
        missed = shown.log.last_number - self._frame_seen - len(newer)
        self._frame_seen = shown.log.last_number
        chosen = [one for one in newer if self._filter.takes(one.channel, one.seen)]
        return chosen[-MOST_FRAMES:], missed + max(0, len(chosen) - MOST_FRAMES)

    def _kept(self) -> tuple[list[FrameEntry], int]:
        if not self._paused:
            self._frame_seen = self.board.shown.log.last_number
        latest = self.board.shown.log.latest(self._filter, self._frame_seen, LOOKED_THROUGH)
        return list(islice(latest, KEPT_FRAMES))[::-1], 0

    # ---- what it asks for ---------------------------------------------------------------------------------

    async def answer(self, told: Any) -> Message | None:
        """Does what a message says; what is to be told. Raises ValueError for what is no message of the page."""
        return await answered(self._actions, told)

    def _filtered(self, text: Any, told: Told) -> None:
        self._filter = parse_filter(plain_text(text), told.get("bad") is True)
        self._anew = True

    def _pause(self, on: Any, told: Told) -> None:
        self._paused = on is True

    def _frame(self, number: Any, told: Told) -> Message:
        """A frame's bytes, and its fields with their places."""
        entry = self.board.shown.log.entry(whole_number(number))
        if entry is None:
            return {"fields": number, "gone": True}
        seen = entry.seen
        rows = [[*field_row(row), row.offset, len(row.data)] for row in self.board.shown.log.fields(entry)]
        fault = {"fault": [seen.reason, seen.place]} if seen.kind == "bad" else {}
        return {"fields": number, "what": seen.frame or seen.kind, "bytes": seen.raw.hex(), "rows": rows, **fault}

    def _history(self, points: Any, told: Told) -> Message:
        """The last moments of some points."""
        if not isinstance(points, list):
            raise ValueError("this is no message")
        most = whole_number(told.get("last"))
        known = [one for one in map(whole_number, points[:MOST_HISTORIES]) if one < len(self.board.points)]
        return {"history": {str(one): self.board.history.last(one, most) for one in known}}

    def _do(self, line: Any, told: Told) -> Message:
        """A block is to be fired, or a block, set or channel to be switched."""
        control = self.board.shown.control

        def carry_out() -> None:
            words = plain_text(line)
            if control is None or words.split()[:1] not in (["fire"], ["enable"], ["disable"]):
                raise RequestError(f"{words!r} is nothing that the page does")
            control(words)
            log.info("web: %r, by %s", words, self.visitor.who)

        return self._tried(told, carry_out)

    def _tried(self, told: Told, action: Callable[[], None]) -> Message:
        """Whether it was done, and why not."""
        answer: Message = {"done": whole_number(told.get("id"))}
        why = self.visitor.refused()
        if why:
            return {**answer, "why": why}
        try:
            action()
        except FramekitError as error:
            log.warning("web: refused to %s: %s", self.visitor.who, printable(str(error)))
            return {**answer, "why": str(error)}
        return answer

    async def _write(self, point: Any, told: Told) -> Message:
        """A point is to be written; it is told when that has ended."""
        number = whole_number(point)
        if number >= len(self.board.points):
            raise ValueError("this is no message")
        _, there = self.board.points[number]
        found: list[Any] = []
        answer = self._tried(told, lambda: found.append(there.value_of(plain_text(told.get("value")))))
        if not found:
            return answer
        try:
            await there.put(found[0], who=f"the page, from {self.visitor.who}")
        except FramekitError as error:
            why = printable(str(error))
            log.warning(
                "point %s: %r was refused to the page, from %s: %s", there.name, found[0], self.visitor.who, why
            )
            return {**answer, "why": str(error)}
        return answer


def _pieces(head: Message, key: str, rows: Mapping[Any, Any]) -> Iterator[Message]:
    """Messages with so many rows each; the first has the head."""
    items = iter(rows.items())
    piece = dict(islice(items, PIECE))
    yield {**head, key: piece}
    named = {"table": head["table"]} if "table" in head else {}
    while piece := dict(islice(items, PIECE)):
        yield {**named, key: piece}


def _about(group: str, point: RunPoint) -> list[Any]:
    """Name, unit, place, what it is, whether it may be written, and what may be written."""
    name = f"{group}: {point.name}" if group else point.name
    place = point.place if point.place != point.name else ""
    limits = "" if point.range is None else f"{point.range[0]:g}..{point.range[1]:g}"
    return [name, point.unit, place, point.about, point.is_writable, limits, list(point.names.values())]
