"""`framekit decode --capture`: write decoded frames to a table (`--to`), or the values in them (`--values`)."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from contextlib import closing, nullcontext
from pathlib import Path

from framekit.api.monitor import decoder
from framekit.cli.capture_decoding import CUT, counted, matching
from framekit.cli.common import (
    ProgressLine,
    VerbError,
    WordsError,
    assignments,
    existing,
    filter_of,
    in_words,
    line_of,
    print_json,
    why_not,
)
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import plural
from framekit.extras.archive.archive import archive, captured_values, write_values


def write_archive(protocol: Protocol, arguments: argparse.Namespace) -> int:
    """Decode captures to a table, with a line for each of them.

    Return 1 if a capture has bad frames or noise, or could not be read. Raises VerbError.
    """
    if arguments.ascii:
        raise WordsError("--ascii has no effect with --to – remove it")
    if arguments.jobs is not None and (arguments.jobs < 1 or arguments.engine is not None):
        raise WordsError("--jobs is a number of processes on this machine, 1 or more – remove it or --engine")
    if not arguments.to.suffix == ".parquet":
        raise WordsError(f"--to {arguments.to}: write a name that ends in .parquet")
    captures = matching(arguments.capture) or [existing(arguments.capture)]
    total: Counter[str] = Counter()
    rows, is_wrong, is_one, ended = 0, False, len(captures) == 1, 0
    shows = arguments.json or not is_one  # a line for each capture, which the progress would overwrite
    hidden = shows and sys.stdout.isatty()
    line = ProgressLine("decode", lambda: f"{ended} of {plural(len(captures), 'capture')}")
    with nullcontext() if hidden else line, in_words(), closing(
        archive(
            captures, arguments.protocol, arguments.to, params=assignments(arguments.param),
            line=line_of(protocol, arguments), client=arguments.client, wanted=filter_of(arguments),
            jobs=arguments.jobs, engine=arguments.engine or "",
        )
    ) as found:  # fmt: skip
        for one in found:
            ended += 1
            total.update(one.counts)
            rows += one.rows
            is_wrong |= bool(one.problem or one.counts.get("bad") or one.counts.get("noise"))
            for problem in filter(None, (one.problem, CUT if one.is_cut else "")):
                print(problem if one.capture in problem else f"{one.capture}: {problem}", file=sys.stderr)
            if arguments.json:
                print_json({"capture": one.capture, "rows": one.rows, **one.counts})
            elif not is_one:
                print(f"{Path(one.capture).name}: {counted(one.counts)}", flush=True)
    if not arguments.json:
        print(f"{arguments.to}: {plural(rows, 'row')} of {plural(len(captures), 'capture')}; {counted(total)}")
    return 1 if is_wrong else 0


def write_values_of(protocol: Protocol, arguments: argparse.Namespace) -> int:
    """Write the values in a capture to a table. Raises VerbError."""
    useless = {"--ascii": arguments.ascii, "--filter": arguments.filter, "--frame-name": arguments.frame_name}
    for option, given in (useless | {"--bad": arguments.bad, "--json": arguments.json}).items():
        if given:
            raise WordsError(f"{option} has no effect with --values – remove it")
    if arguments.values.suffix != ".csv":
        raise WordsError(f"--values {arguments.values}: write a name that ends in .csv")
    path, given = existing(arguments.capture), assignments(arguments.param)
    try:
        with in_words():
            found = decoder(path, protocol, line=line_of(protocol, arguments), params=given, client=arguments.client)
            values = captured_values(found.seen(), protocol, arguments.protocol, given)
            with ProgressLine("decode"):
                count, points = write_values(values, arguments.values)
    except OSError as error:
        raise VerbError(why_not(error)) from None
    except ValueError as error:
        raise VerbError(str(error)) from None
    if found.is_cut:
        print(f"{arguments.capture}: {CUT}", file=sys.stderr)
    print(f"{arguments.values}: {plural(count, 'value')} of {plural(points, 'place')}")
    if not count:
        print("no request with a reply of one frame tells a value – look at the frames themselves", file=sys.stderr)
    return 0 if count else 1
