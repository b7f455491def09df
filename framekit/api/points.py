"""The points of a run: named values with quality and time, to read, await and write by name.

This module also converts register lists to points files, and reads the stored values of runs.
"""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import yaml

from framekit.api.errors import ExchangeError, NoReplyError, RequestError
from framekit.codec.shown import shown
from framekit.definition.problems import did_you_mean, no_such
from framekit.run.behaviours import number_of
from framekit.run.block_state import Failure
from framekit.run.model import RunModel
from framekit.run.points import PointValue, value_text
from framekit.run.points import Quality as Quality
from framekit.run.points import iso_time as iso_time
from framekit.runfile.run_file import load_run
from framekit.runfile.vendor_tables import Imported as Imported
from framekit.runfile.vendor_tables import label_of
from framekit.runfile.vendor_tables import read_vendor_table as read_vendor_table
from framekit.service.points import PointService, Written
from framekit.sinks.base import fits
from framekit.sinks.sqlite import Course as Course
from framekit.sinks.sqlite import HistoryError, HistoryRow, SqliteHistory, read_course, read_history

Do = Callable[[Callable[[], Any]], Any]
"""Call a function in the thread of the run and return its result."""

OnPoint = Callable[[PointValue], None]
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class RunPoint:
    """One point of a run. Its properties return the current state at each access."""

    def __init__(self, name: str, service: PointService, do: Do) -> None:
        self.name = name
        self._service, self._do = service, do
        self._point = service.point(name)

    def __repr__(self) -> str:
        now = self.now
        shown = (
            f"{self.text_of(now.value)} {self.unit}".rstrip()
            if now.quality == "good"
            else f"{now.quality}, {now.reason}"
        )
        return f"<point {self.name}: {shown}>"

    @property
    def now(self) -> PointValue:
        """Return value, quality, reason and time of the same moment."""
        found: PointValue = self._do(lambda: self._service.table[self.name])
        return found

    @property
    def value(self) -> Any:
        """Return the last good value, scaled; None before the first."""
        return self.now.value

    @property
    def quality(self) -> Quality:
        """Return `good`, `stale` (not read for too long) or `failed`."""
        return self.now.quality

    @property
    def reason(self) -> str:
        """Return why the point is not good."""
        return self.now.reason

    @property
    def time(self) -> datetime | None:
        """Return the time of its reply, or of its failure or aging (UTC); None before the first."""
        if not self.now.time:
            return None
        return _EPOCH + timedelta(microseconds=self.now.time // 1000)

    @property
    def unit(self) -> str:
        """Return the unit of measurement."""
        return self._point.unit

    def text_of(self, value: Any) -> str:
        """Return a value of the point as text, with the digits of `decimals`; `-` for None."""
        return value_text(self._point, value)

    @property
    def about(self) -> str:
        """Return the description of the point."""
        return self._point.about

    @property
    def place(self) -> str:
        """Return the address, with channel and station if a device has the point."""
        point = self._point
        station = "" if point.station is None else f" station {shown(point.station)}"
        return point.address if point.channel is None else f"ch {point.channel}{station} {point.address}"

    @property
    def group(self) -> str:
        """Return the source of the point: its channel and station, or the memory."""
        point = self._point
        if point.channel is None:
            return "memory"
        return f"channel {point.channel}" + ("" if point.station is None else f", station {shown(point.station)}")

    @property
    def is_writable(self) -> bool:
        """Return whether its `access:` allows writing."""
        return self._point.is_writable

    @property
    def names(self) -> Mapping[int, str]:
        """Return its value names by number."""
        return self._point.names

    @property
    def range(self) -> tuple[float, float] | None:
        """Return the minimum and maximum that may be written, if the run defines them."""
        return self._point.limits

    def value_of(self, text: str) -> int | float | str:
        """Return the value for a text: a word, a number, or the text itself if the point is a string.

        Raise RequestError.
        """
        if self._point.form.type == "string" or text in self._point.names.values():
            return text
        try:
            return number_of(text)
        except ValueError:
            raise RequestError(f"{text!r} is no value of {self.name}") from None

    async def changed(self, *, timeout: float | None = None) -> PointValue:
        """Wait for the next change of value or quality and return it; call it in the event loop of the run.

        Raise NoReplyError after `timeout` seconds.
        """
        change: asyncio.Future[PointValue] = asyncio.get_running_loop().create_future()

        def listen(value: PointValue) -> None:
            if value.name == self.name and not change.done():
                change.set_result(value)

        listeners = self._service.table.listeners
        listeners.append(listen)
        try:
            async with asyncio.timeout(timeout):
                return await change
        except TimeoutError:
            raise NoReplyError(f"'{self.name}' has not changed within {timeout:g} s", "timeout") from None
        finally:
            listeners.remove(listen)

    def write(self, value: Any, *, who: str = "a program", done: Written = lambda failure: None) -> None:
        """Request to write a scaled value. `done` is called with the result in the thread of the run.

        Raise RequestError without writing if the point is not writable or the value does not fit.
        """
        self._do(lambda: self._write(value, who, done))

    def _write(self, value: Any, who: str, done: Written) -> None:
        try:
            self._service.write(self.name, value, who, done)
        except ValueError as error:
            raise RequestError(str(error)) from None

    async def put(self, value: Any, *, who: str = "a program") -> None:
        """Write a value and wait for the reply; call it in the event loop of the run.

        Raise RequestError or ExchangeError.
        """
        ended: asyncio.Future[Failure | None] = asyncio.get_running_loop().create_future()
        self._write(value, who, lambda failure: None if ended.done() else ended.set_result(failure))
        failure = await ended
        if failure is not None:
            raise ExchangeError(f"'{self.name}' was not written: {failure}", failure.outcome, failure.cause)


class RunPoints(Mapping[str, RunPoint]):
    """The points of a run by name; `watch` reports every change."""

    def __init__(self, service: PointService, do: Do) -> None:
        self._service, self._do = service, do
        self._names = dict.fromkeys(value.name for value in service.table)

    def __getitem__(self, name: str) -> RunPoint:
        """Return a point. Raise KeyError if the run does not have it."""
        if name not in self._names:
            raise KeyError(no_such("there is no point", name, self._names))
        return RunPoint(name, self._service, self._do)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def now(self) -> list[PointValue]:
        """Return the values of all points at the same moment."""
        found: list[PointValue] = self._do(lambda: list(self._service.table))
        return found

    def watch(self, callback: OnPoint) -> Callable[[], None]:
        """Call back in the thread of the run on each change of value or quality; the returned function ends it."""
        listeners = self._service.table.listeners
        self._do(lambda: listeners.append(callback))

        def end() -> None:
            if callback in listeners:
                listeners.remove(callback)

        return lambda: self._do(end)


# ---- points as files ------------------------------------------------------------------------------------------


def points_text(imported: Imported, name: str, source: str) -> str:
    """Return the text of a points file for an imported register list."""
    lines = [f"points: {label_of(name) or 'points'}", f"source: {_scalar(source)}", "values:"]
    for point, keys in imported.points.items():
        inside = ", ".join(f"{key}: {_scalar(value)}" for key, value in keys.items())
        lines.append(f"  {point}: {{{inside}}}")
    return "\n".join(lines) + "\n"


def _scalar(text: str) -> str:
    """Return a text as YAML flow style writes it, quoted if necessary."""
    written: str = yaml.safe_dump([text], default_flow_style=True, allow_unicode=True, width=10**9)
    return written.strip()[1:-1]


def history_of(
    path: Path, points: Sequence[str] = ("*",), since: int | None = None, until: int | None = None
) -> Iterator[HistoryRow]:
    """Yield the stored values of a run, given its run file or its history file; times in ns since 1970 (UTC).

    Raise RequestError for a run without a history, DefinitionError for an invalid run file.
    """
    if path.suffix in (".yaml", ".yml"):
        run = load_run(path)
        names = [point.name for point in run.points]
        for pattern in points:
            if not any(fits(pattern, name) for name in names):
                hint = did_you_mean(pattern, names) or f"known: {', '.join(names[:10])}"
                raise RequestError(f"no point of {path} is called '{pattern}' – {hint}")
        stored = history_file(run)
        if stored is None:
            raise RequestError(f"{path} has no sqlite sink – add it, or name a file of one")
        path = stored
    try:
        yield from read_history(path, points, since, until)
    except (HistoryError, sqlite3.Error) as error:
        raise RequestError(f"{path}: {error}" if isinstance(error, sqlite3.Error) else str(error)) from None


def history_file(run: RunModel) -> Path | None:
    """Return the file of the first sqlite sink of a run; None if the run has none."""
    return next((Path(sink.sqlite) for sink in run.sinks if isinstance(sink, SqliteHistory)), None)


def course_of(path: Path, point: RunPoint, since: int, until: int, steps: int) -> Course:
    """Return the stored numbers of a point between two times (ns since 1970); see `Course`. Raise RequestError.

    It reads the file and may take seconds: call it in a thread of its own.
    """
    words = {word: float(number) for number, word in point.names.items()}
    try:
        return read_course(path, point.name, words, since, until, steps)
    except (HistoryError, sqlite3.Error) as error:
        raise RequestError(str(error)) from None
