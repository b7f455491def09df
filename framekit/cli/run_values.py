"""Values of a run as they change: one line a change, or a table that a terminal shows in place."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

from framekit.cli.common import json_line, painted, table
from framekit.cli.terminal import harmless
from framekit.definition.problems import plural, printable

if TYPE_CHECKING:
    from framekit import BlockStatus, PointValue
    from framekit.api.run import Block, RunCalls, RunModel
    from framekit.cli.live_output import QueuedStream

WIDEST_NAME = 24
"""Longest name that widens the column of names."""
MOST_NAMED = 3
"""Points that a line with a common failure names."""
REFRESH = 250_000_000
"""Period (ns) of the table."""
TABLE_HEAD = ("point", "value", "unit", "quality", "changed")
QUALITY = TABLE_HEAD.index("quality")
SHORTEST_QUALITY = 12
"""Column of quality and reason, and the fewest characters that it has."""


@dataclass(frozen=True, slots=True)
class Change:
    """A change of a point, or the end of a block with other data than before."""

    at: int
    """The time of the run's clock (ns)."""
    name: str
    """The name of the point, or the description of the block."""
    text: str
    """Value and unit; the stored words of a block."""
    trouble: str
    """`failed: REASON` or `stale: REASON`; empty for a good value."""
    data: dict[str, Any]
    """The same for JSON output."""


class ValueChanges:
    """Collects the changes of a run: of its points, or, in a run without points, of the data of its blocks.

    `described` returns the text of a block; `begins` is called before the first change after each `take`.
    """

    def __init__(self, run: RunCalls, described: Callable[[Block], str], begins: Callable[[], None]) -> None:
        self._run, self._begins = run, begins
        self._changes: list[Change] = []
        self._changed_at: dict[str, int] = {}
        """Times of the last change of each point."""
        self._known: dict[int, str] = {}
        """Text and failure of the last end of each block."""
        self._described = described
        if len(run.points):
            run.points.watch(self._point)
        else:
            run.watch_blocks(self._block)
        self.know(run.run)

    def know(self, run: RunModel) -> None:
        """Use the blocks of an edited run."""
        self._blocks = {block.id: block for block in run.blocks}
        names: Iterable[str] = self._run.points or map(self._described, run.blocks)
        self._width = min(WIDEST_NAME, max(map(len, names), default=0))

    def take(self) -> list[Change]:
        """Return all changes, and forget them."""
        changes, self._changes = self._changes, []
        return changes

    def _add(self, change: Change) -> None:
        if not self._changes:
            self._begins()
        self._changes.append(change)

    def _point(self, value: PointValue) -> None:
        point, now = self._run.points[value.name], self._run.now
        self._changed_at[value.name] = now
        is_good = value.quality == "good"
        text = f"{point.text_of(value.value)} {point.unit}".rstrip() if is_good else ""
        data = {"event": "value", "point": value.name, "value": value.value if is_good else None, "unit": point.unit,
                "quality": value.quality, "reason": value.reason}  # fmt: skip
        self._add(Change(now, value.name, text, "" if is_good else f"{value.quality}: {value.reason}", data))

    def _block(self, status: BlockStatus, ok: bool) -> None:
        block = self._blocks.get(status.id)
        if block is None:
            return
        stored = dict(self._run.stored(status.id)) if ok else {}
        trouble = "" if ok else f"failed: {status.last_failure}"
        text = (", ".join(f"{place} {words}" for place, words in stored.items()) or "done") if ok else ""
        if self._known.get(status.id) == text + trouble:
            return
        self._known[status.id] = text + trouble
        data = {"event": "value", "set": block.set, "block": block.number, "name": block.name, "stored": stored,
                "quality": "good" if ok else "failed", "reason": "" if ok else str(status.last_failure)}  # fmt: skip
        self._add(Change(self._run.now, self._described(block), text, trouble, data))

    # ---- as text ------------------------------------------------------------------------------------------

    def lines(self, changes: Iterable[Change]) -> Iterator[tuple[int, str]]:
        """Yield time and line of each change; points that fail together for the same reason share a line."""
        for (at, trouble), some in groupby(changes, lambda change: (change.at, change.trouble)):
            if not trouble:
                for change in some:
                    yield at, self._line(at, change.name, printable(change.text))
            else:
                first, *others = [change.name for change in some]
                names = ", ".join([first, *others[: MOST_NAMED - 1]])
                if len(others) >= MOST_NAMED:
                    names += f" … ({plural(1 + len(others), 'point')})"
                yield at, self._line(at, names, painted(printable(trouble), "red", sys.stdout))

    def _line(self, at: int, name: str, text: str) -> str:
        return f"{(at - self._run.began) / 1e9:10.3f}  {printable(name):<{self._width}}  {text}"

    def json_lines(self, changes: Iterable[Change]) -> Iterator[tuple[int, str]]:
        """Yield time and JSON object of each change."""
        for change in changes:
            event, *others = change.data.items()
            time = ("time", (change.at - self._run.began) / 1e9)
            yield change.at, json_line(dict([event, time, *others]), default=str)

    def rows(self, number: int) -> list[tuple[str, ...]]:
        """Return rows of at most `number` points: name, value, unit, quality and age of the last change."""
        now = self._run.now
        rows: list[tuple[str, ...]] = []
        for name, _ in zip(self._run.points, range(number), strict=False):
            point = self._run.points[name]
            value, changed = point.now, self._changed_at.get(name)
            quality = value.quality if value.quality == "good" else f"{value.quality}: {value.reason}"
            age = "" if changed is None else f"{(now - changed) / 1e9:.0f} s ago"
            rows.append((name, point.text_of(value.value), point.unit, quality, age))
        return rows


class ValueTable:
    """A table of the points of a run, drawn at the end of the output of a terminal, again and again."""

    def __init__(self, run: RunCalls, changes: ValueChanges, stream: QueuedStream) -> None:
        self._run, self._changes, self._stream = run, changes, stream
        run.each(REFRESH, self._draw)

    def _draw(self) -> None:
        """Draw the present values, as many as the terminal has room for."""
        width, height = shutil.get_terminal_size()
        most = max(1, height - 5)
        rows = _fitting(self._changes.rows(most), width)
        head, *lines = table(rows, TABLE_HEAD).split("\n")
        lines = [
            harmless(line) if row[3] == "good" else painted(harmless(line), "red", self._stream.stream)
            for row, line in zip(rows, lines, strict=True)
        ]
        if len(self._run.points) > most:
            lines.append(f"… and {plural(len(self._run.points) - most, 'more point')}: --screen shows all")
        title = f"run {printable(self._run.run.name)}, {(self._run.now - self._run.began) / 1e9:.0f} s – Ctrl-C ends it"
        self._stream.draw([title, "", head, *lines])


def _fitting(rows: list[tuple[str, ...]], width: int) -> list[tuple[str, ...]]:
    """Return the rows of the table with reasons that are short enough for the other columns to be in view."""
    widths = [max(map(len, column)) for column in zip(TABLE_HEAD, *rows, strict=True)]
    room = max(SHORTEST_QUALITY, width - sum(widths) + widths[QUALITY] - 2 * (len(widths) - 1))
    found = []
    for *before, quality, changed in rows:
        found.append((*before, quality if len(quality) <= room else f"{quality[: room - 1]}…", changed))
    return found


def draws(stream: Any) -> bool:
    """Return whether a stream is a terminal that moves its cursor as framekit asks."""
    if not stream.isatty() or os.environ.get("TERM", "dumb" if sys.platform != "win32" else "") == "dumb":
        return False
    return sys.platform != "win32" or "WT_SESSION" in os.environ or "TERM" in os.environ
