"""A run, or served devices, in browsers: the content that they share, and the session of each browser.

The content is read on request and at limited rates. A session has a filter, updates, and the permitted actions; it
stores only the numbers of the rounds that the browser has seen, so a slow browser misses intermediate updates.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

from framekit import __version__
from framekit.api.errors import FramekitError, RequestError
from framekit.api.monitor import FrameFilter, parse_filter
from framekit.api.points import RunPoint
from framekit.api.rows import FRAME_HEAD, POINT_HEAD, FrameEntry, field_row, fields_text, frame_row, meaning_of
from framekit.codec.contents import contents_of
from framekit.codec.shown import explain
from framekit.definition.problems import printable
from framekit.extras.web.access import Access, Visitor
from framekit.extras.web.assets import CHART
from framekit.extras.web.cards import Card
from framekit.extras.web.history import PointHistory
from framekit.extras.web.messages import LARGEST_MESSAGE, Actions, Message, Told, answered, plain_text, whole_number
from framekit.extras.web.notices import Notices
from framekit.extras.web.shown import ChangingRows, ChangingValues, Shown, value_cells
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
PIECE = 500
"""Maximum number of values or rows in one message."""
MOST_FRAMES = 40
KEPT_FRAMES = 200
"""Maximum number of frames in one message, and of earlier frames shown after a change of the filter."""
LOOKED_AT = 1_000
LOOKED_THROUGH = 3_000
"""Maximum number of frames compared with a filter at once: of new frames, and of earlier frames after a change."""
MOST_HISTORIES = 64
MOST_COURSES = 6
"""Maximum number of points in one request for their last minutes or ages, and for stored values."""
MOST_SECONDS = 2**33
LONGEST_COURSE = 400 * 86_400
"""Latest time of stored values in seconds since 1970, and the longest span in one request."""


class WebBoard:
    """The content shared by all browsers of one run, read on request and at limited rates."""

    home = "board.html"
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
    def name(self) -> str:
        """Return the name of the page among the others of the same program."""
        return self.shown.name

    def session(self, access: Access, who: str) -> WebSession:
        """Return a new session for a browser."""
        return WebSession(self, access, who)

    async def go_on(self) -> None:
        """Record the values at regular intervals, until the page ends.

        The first interval is over when devices have the values of their behaviours, in place of zeros.
        """
        try:
            while True:
                await asyncio.sleep(HISTORY_EVERY)
                try:
                    self.remember(time.time())
                except Exception:
                    log.exception("web: the values are not remembered")
        finally:
            self.shown.end()

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
        """Return the decoded fields of a frame in one line, each number with its name."""
        protocol = self.shown.log.protocol(entry.channel)
        try:
            fields = contents_of(protocol).with_names(entry.seen.frame, entry.seen.fields, entry.seen.request)
        except EVALUATION_ERRORS as error:  # a frame may contain anything
            return explain(error)
        text = fields_text(fields, named=False)
        return text if len(text) <= LONGEST_CELL else f"{text[:LONGEST_CELL]} …"


class WebSession:
    """The session of a browser at address `who`. `news` returns its updates; `answer` executes its requests."""

    def __init__(self, board: WebBoard, access: Access, who: str) -> None:
        self.board = board
        self.visitor = Visitor(access, who)
        self._values_seen = self._cards_seen = self._notices_seen = 0
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
            "course": self._course,
            "ages": self._ages,
            "do": self._do,
            "write": self._write,
        }
        if board.shown.devices is not None:
            self._actions = {**self._actions, **board.shown.devices.actions(self._tried, who)}

    @property
    def wrong_tokens(self) -> int:
        """Return the number of wrong tokens it has sent."""
        return self.visitor.wrong_tokens

    # ---- updates to the browser ------------------------------------------------------------------------------

    def hello(self) -> Message:
        """Return the constant content: the titles of the tables and the descriptions of the points."""
        shown = self.board.shown
        return {
            "hello": shown.title,
            "version": __version__,
            "controls": shown.control is not None,
            "stored": shown.stored is not None,
            "began": self.board.began,
            "chart": CHART,
            "devices": None if shown.devices is None else shown.devices.described(),
            "tables": [[table.name, table.head] for table in shown.tables],
            "pointHead": POINT_HEAD,
            "points": [_about(group, point) for group, point in self.board.points],
        }

    def news(self) -> Iterator[Message]:
        """Yield the changes since the last call, in messages of bounded size."""
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
        yield from self._heads()
        frames = self._frames()
        if frames is not None:
            yield frames

    def _heads(self) -> Iterator[Message]:
        """Yield the cards and the notices, each if they have changed."""
        board = self.board
        if self._cards_seen != board.cards_round:
            self._cards_seen = board.cards_round
            yield {"cards": board.cards}
        if self._notices_seen != board.notices.round:
            self._notices_seen = board.notices.round
            yield {"notices": [[one.number, one.text, one.began, one.ended] for one in board.notices]}

    def _frames(self) -> Message | None:
        """Return the frames that pass the filter: the newest, or after a change of the filter the latest of the log."""
        shown = self.board.shown
        if self._paused and not self._anew:
            return None
        entries, missed = self._kept() if self._anew else self._newer()
        anew, self._anew = self._anew, False
        if not entries and not missed and not anew:
            return None
        counts = shown.log.counts
        rows = [self.board.frame_cells(one) for one in entries]
        counted = [counts["frame"], counts["bad"], counts["noise"]]
        return {"frames": rows, "anew": anew, "missed": missed, "counts": counted}

    def _newer(self) -> tuple[list[FrameEntry], int]:
        """Return the new frames since the last call, and how many were left out."""
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

    # ---- requests of the browser -----------------------------------------------------------------------------

    async def answer(self, told: Any) -> Message | None:
        """Execute a message and return the answer. Raise ValueError if it is no message of the page."""
        return await answered(self._actions, told)

    def _filtered(self, text: Any, told: Told) -> None:
        self._filter = parse_filter(plain_text(text), told.get("bad") is True)
        self._anew = True

    def _pause(self, on: Any, told: Told) -> None:
        self._paused = on is True

    def _frame(self, number: Any, told: Told) -> Message:
        """Return the bytes of a frame, and its fields with their offsets."""
        entry = self.board.shown.log.entry(whole_number(number))
        if entry is None:
            return {"fields": number, "gone": True}
        seen = entry.seen
        rows = [[*field_row(row), row.offset, len(row.data)] for row in self.board.shown.log.fields(entry)]
        fault = {"fault": [seen.reason, seen.place]} if seen.kind == "bad" else {}
        what = meaning_of(seen) if seen.kind == "frame" else seen.frame or seen.kind
        return {
            "fields": number, "what": what, "frame": seen.frame, "bytes": seen.raw.hex(), "rows": rows, **fault,
        }  # fmt: skip

    def _history(self, points: Any, told: Told) -> Message:
        """Return the latest moments of some points."""
        most = whole_number(told.get("last"))
        known = self._known(points, MOST_HISTORIES)
        return {"history": {str(one): self.board.history.last(one, most) for one in known}, "last": most}

    def _ages(self, points: Any, told: Told) -> Message:
        """Return the ages of the values of some points in seconds; None before the first value."""
        return {"ages": {str(one): self.board.age(one) for one in self._known(points, MOST_HISTORIES)}}

    async def _course(self, points: Any, told: Told) -> Message:
        """Return stored values of some points between two times, in seconds since 1970."""
        since, until = whole_number(told.get("since")), whole_number(told.get("until"))
        chosen = self._known(points, MOST_COURSES)
        stored = self.board.shown.stored
        answer: Message = {"course": chosen, "since": since, "until": until}
        if stored is None or not chosen or not 0 < until - since <= LONGEST_COURSE or until > MOST_SECONDS:
            raise ValueError("this is no message")
        named = [self.board.points[one][1] for one in chosen]
        try:
            times, numbers = await stored.courses(named, since * 10**9, until * 10**9)
        except FramekitError as error:
            return {**answer, "why": printable(str(error))}
        return {**answer, "times": times, "numbers": numbers}

    def _known(self, points: Any, most: int) -> list[int]:
        """Return the numbers of existing points in a message, `most` at most. Raise ValueError."""
        if not isinstance(points, list):
            raise ValueError("this is no message")
        return [one for one in map(whole_number, points[:most]) if one < len(self.board.points)]

    def _do(self, line: Any, told: Told) -> Message:
        """Fire a block, or enable or disable a block, a set or a channel."""
        control = self.board.shown.control

        def carry_out() -> None:
            words = plain_text(line)
            if control is None or words.split()[:1] not in (["fire"], ["enable"], ["disable"]):
                raise RequestError(f"{words!r} is nothing that the page does")
            control(words)
            log.info("web: %r, by %s", words, self.visitor.who)

        return self._tried(told, carry_out)

    def _tried(self, told: Told, action: Callable[[], None]) -> Message:
        """Execute an action if the visitor may; return whether it was done, or why not."""
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
        """Write a point and return the answer when the write has ended."""
        number = whole_number(point)
        if number >= len(self.board.points):
            raise ValueError("this is no message")
        _, target = self.board.points[number]
        found: list[Any] = []
        answer = self._tried(told, lambda: found.append(target.value_of(plain_text(told.get("value")))))
        if not found:
            return answer
        try:
            await target.put(found[0], who=f"the page, from {self.visitor.who}")
        except FramekitError as error:
            why = printable(str(error))
            log.warning(
                "point %s: %r was refused to the page, from %s: %s", target.name, found[0], self.visitor.who, why
            )
            return {**answer, "why": str(error)}
        return answer


def _pieces(head: Message, key: str, rows: Mapping[Any, Any]) -> Iterator[Message]:
    """Yield messages with at most `PIECE` rows each; the first has the head."""
    items = iter(rows.items())
    piece = dict(islice(items, PIECE))
    yield {**head, key: piece}
    named = {"table": head["table"]} if "table" in head else {}
    while piece := dict(islice(items, PIECE)):
        yield {**named, key: piece}


def _about(group: str, point: RunPoint) -> list[Any]:
    """Return name, unit, place, description, whether it is writable, range, words, group, and numbers of the words."""
    name = f"{group}: {point.name}" if group else point.name
    place = point.place if point.place != point.name else ""
    limits = "" if point.range is None else f"{point.range[0]:g}..{point.range[1]:g}"
    words = list(point.names.values())
    return [
        name, point.unit, place, point.about, point.is_writable, limits, words, group or point.group, list(point.names),
    ]  # fmt: skip
