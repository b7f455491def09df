"""`framekit history`: the values that runs have kept."""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import chain, islice
from pathlib import Path

from framekit.cli.common import WordsError, add, in_words, print_json, time_of
from framekit.definition.problems import printable

FURTHEST = (1 << 63) - 1
"""Greatest distance of a time from 1970 (ns)."""

PAGE = 1_000
"""Number of values of a history in memory at once."""


def add_history_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN.yaml", type=Path, help="the run, or the file of its sqlite sink")
    parser.add_argument(
        "--point", metavar="NAME", action="append", help="this point, * stands for any text; several times for more"
    )
    parser.add_argument("--since", metavar="TIME", help="from then on: 1h for an hour ago, or 2026-03-01T12:00")
    parser.add_argument("--until", metavar="TIME", help="up to then")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--csv", action="store_true", help="as comma-separated values")
    add(form, "--json", help="print JSON instead of text: an object for each value")


def run_history(arguments: argparse.Namespace) -> int:
    from framekit.api.points import history_of, iso_time

    now = time.time_ns()
    since, until = (
        None if text is None else _moment(option, text, now)
        for option, text in (("--since", arguments.since), ("--until", arguments.until))
    )
    head = ("time", "point", "value", "unit", "quality", "reason")
    with in_words():
        found = history_of(arguments.run, arguments.point or ["*"], since, until)
        if arguments.json:
            for row in found:
                values = (iso_time(row.time), row.point, row.value, row.unit, row.quality, row.reason)
                print_json(dict(zip(head, values, strict=True)))
            return 0
        rows = ((iso_time(row.time), row.point, _shown(row.value), row.unit, row.quality, row.reason) for row in found)
        first = list(islice(rows, PAGE))  # faults of the history are reported before any output
        if arguments.csv:
            csv.writer(sys.stdout, lineterminator="\n").writerows(chain([head], first, rows))
        else:
            _print_pages(head, first, rows)
    return 0


def _print_pages(head: Sequence[str], page: Sequence[Sequence[str]], rows: Iterator[Sequence[str]]) -> None:
    """Print a table of any length: columns get wider if a later page needs it, and never narrower."""
    widths = [len(title) for title in head]
    lines = [head, *page]
    while lines:
        lines = [tuple(map(printable, line)) for line in lines]
        widths = [max(width, *map(len, column)) for width, column in zip(widths, zip(*lines, strict=True), strict=True)]
        for line in lines:
            print("  ".join(map(str.ljust, line, widths)).rstrip())
        lines = list(islice(rows, PAGE))


def _shown(value: object) -> str:
    return "" if value is None else str(value)


def _moment(option: str, text: str, now: int) -> int:
    """Return a time in ns since 1970: a time of day (UTC unless a zone is given), or a duration before now.

    Raises WordsError.
    """
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return now - time_of(option, text)
    try:
        seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    except (OverflowError, ValueError):
        raise WordsError(f"{option}: '{text}' is no time that a history has") from None
    return max(-FURTHEST, min(FURTHEST, round(seconds * 1_000_000) * 1_000))
