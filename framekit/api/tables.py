"""Points as files: register lists turned into them, and the values that runs have kept of them."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path

import yaml

from framekit.api.errors import RequestError
from framekit.definition.problems import did_you_mean
from framekit.run.points import iso_time as iso_time
from framekit.runfile.run_file import load_run
from framekit.runfile.vendor_tables import Imported as Imported
from framekit.runfile.vendor_tables import label_of
from framekit.runfile.vendor_tables import read_vendor_table as read_vendor_table
from framekit.sinks.base import fits
from framekit.sinks.sqlite import HistoryError, HistoryRow, SqliteHistory, read_history


def points_text(imported: Imported, name: str, source: str) -> str:
    """A points file with what was read of a register list."""
    lines = [f"points: {label_of(name) or 'points'}", f"source: {_scalar(source)}", "values:"]
    for point, keys in imported.points.items():
        inside = ", ".join(f"{key}: {_scalar(value)}" for key, value in keys.items())
        lines.append(f"  {point}: {{{inside}}}")
    return "\n".join(lines) + "\n"


def _scalar(text: str) -> str:
    """A text as YAML writes it in braces, in quotes where it has to be."""
    written: str = yaml.safe_dump([text], default_flow_style=True, allow_unicode=True, width=10**9)
    return written.strip()[1:-1]


def history_of(
    path: Path, points: Sequence[str] = ("*",), since: int | None = None, until: int | None = None
) -> Iterator[HistoryRow]:
    """The kept values of a run, by its file or by that of its history; times in ns since 1970 (UTC).

    Raises RequestError for a run without a history, DefinitionError for a run file that is wrong.
    """
    if path.suffix in (".yaml", ".yml"):
        run = load_run(path)
        names = [point.name for point in run.points]
        for pattern in points:
            if not any(fits(pattern, name) for name in names):
                hint = did_you_mean(pattern, names) or f"known: {', '.join(names[:10])}"
                raise RequestError(f"no point of {path} is called '{pattern}' – {hint}")
        found = [Path(sink.sqlite) for sink in run.sinks if isinstance(sink, SqliteHistory)]
        if not found:
            raise RequestError(f"{path} has no sqlite sink – add it, or name a file of one")
        path = found[0]
    try:
        yield from read_history(path, points, since, until)
    except (HistoryError, sqlite3.Error) as error:
        raise RequestError(f"{path}: {error}" if isinstance(error, sqlite3.Error) else str(error)) from None
