"""Decoding captures for the verb `decode`: to the terminal, to a table of rows, or to a table of values."""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Mapping
from contextlib import AbstractContextManager, closing, nullcontext
from datetime import UTC, datetime
from functools import lru_cache
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    seen_data,
    seen_text,
    why_not,
)
from framekit.definition.problems import plural

if TYPE_CHECKING:
    from framekit import Seen
    from framekit.codec.contents import Contents
    from framekit.definition.model.protocol import Protocol

DAY = 86_400
SECOND = 1_000_000_000


def decode_capture(protocol: Protocol, arguments: argparse.Namespace) -> int:
    """Print every frame; return 1 if the capture has bad frames or noise. Raises VerbError."""
    from framekit.api.monitor import decoder, result_of
    from framekit.codec.contents import contents_of

    if arguments.to is not None and arguments.values is not None:
        raise WordsError("--to and --values write different tables – leave one of them out")
    if arguments.to is not None:
        return _archive(protocol, arguments)
    for option in ("jobs", "engine"):
        if getattr(arguments, option) is not None:
            raise WordsError(f"--{option} has no effect without --to – add --to OUT.parquet, or remove it")
    if arguments.values is not None:
        return _values(protocol, arguments)
    wanted, contents = filter_of(arguments), contents_of(protocol)
    counts: Counter[str] = Counter()
    if _matching(arguments.capture):
        raise WordsError(f"{arguments.capture}: a pattern needs --to OUT.parquet – add it, or name one file")
    path, line = existing(arguments.capture), line_of(protocol, arguments)
    given = assignments(arguments.param)
    try:
        with in_words():
            found = decoder(path, protocol, line=line, params=given, client=arguments.client)
        with decoding(counts):
            for channel, seen in found.seen():
                if seen.kind != "noise" or not seen.reason:  # the rest of a bad frame is a part of it
                    counts[seen.kind] += 1
                if not wanted.takes(channel, seen):
                    continue
                if arguments.json:
                    more = {"time_ns": seen.at, "channel": channel, "result": result_of(protocol, seen)}
                    print_json(seen_data(seen, seen.at / 1e9, contents, **more))
                else:
                    print(_text(contents, channel, seen, arguments.ascii))
    except ValueError as error:
        raise VerbError(str(error)) from None
    if found.is_cut:
        print(f"{arguments.capture}: {_CUT}", file=sys.stderr)
    if not arguments.json:
        print(_counted(counts))
    return 1 if counts["bad"] or counts["noise"] else 0


def decoding(counts: Mapping[str, int]) -> AbstractContextManager[object]:
    """Show the progress, unless decoded frames fill the terminal."""
    return nullcontext() if sys.stdout.isatty() else ProgressLine("decode", lambda: _counted(counts))


def _matching(pattern: Path) -> list[Path]:
    """Return the files that match a pattern, in order; none if the pattern is the name of a file."""
    return [] if pattern.exists() else [Path(one) for one in sorted(glob(str(pattern)))]


_CUT = "the last record is not whole – its writer was stopped"


def _counted(counts: Mapping[str, int]) -> str:
    return (
        f"{plural(counts.get('frame', 0), 'frame')}, {counts.get('bad', 0)} bad, {counts.get('noise', 0)} times noise"
    )


def _archive(protocol: Protocol, arguments: argparse.Namespace) -> int:
    """Decode captures to a table, with a line for each of them.

    Return 1 if a capture has bad frames or noise, or could not be read. Raises VerbError.
    """
    from framekit.api.archive import archive

    if arguments.ascii:
        raise WordsError("--ascii has no effect with --to – remove it")
    if arguments.jobs is not None and (arguments.jobs < 1 or arguments.engine is not None):
        raise WordsError("--jobs is a number of processes on this machine, 1 or more – remove it or --engine")
    if not arguments.to.suffix == ".parquet":
        raise WordsError(f"--to {arguments.to}: write a name that ends in .parquet")
    captures = _matching(arguments.capture) or [existing(arguments.capture)]
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
            for problem in filter(None, (one.problem, _CUT if one.is_cut else "")):
                print(problem if one.capture in problem else f"{one.capture}: {problem}", file=sys.stderr)
            if arguments.json:
                print_json({"capture": one.capture, "rows": one.rows, **one.counts})
            elif not is_one:
                print(f"{Path(one.capture).name}: {_counted(one.counts)}", flush=True)
    if not arguments.json:
        print(f"{arguments.to}: {plural(rows, 'row')} of {plural(len(captures), 'capture')}; {_counted(total)}")
    return 1 if is_wrong else 0


def _values(protocol: Protocol, arguments: argparse.Namespace) -> int:
    """Write the values in a capture to a table. Raises VerbError."""
    from framekit.api.archive import captured_values, write_values
    from framekit.api.monitor import decoder

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
        print(f"{arguments.capture}: {_CUT}", file=sys.stderr)
    print(f"{arguments.values}: {plural(count, 'value')} of {plural(points, 'place')}")
    if not count:
        print("no request with a reply of one frame tells a value – look at the frames themselves", file=sys.stderr)
    return 0 if count else 1


def _text(contents: Contents, channel: int, seen: Seen, as_ascii: bool) -> str:
    """Return the line of a frame and, below it, its fields."""
    text = seen_text(seen, time_text(seen.at), f"ch {channel}", as_ascii)
    fields = contents.to_plain(seen.frame, seen.fields)
    shown = "  ".join(f"{name}={_plain(value)}" for name, value in fields.items())
    return f"{text}\n{'':10}{shown}" if shown else text


_AS_JSON = json.JSONEncoder(ensure_ascii=False).encode


def _plain(value: Any) -> str:
    return _AS_JSON(value) if isinstance(value, (dict, list)) else str(value)


def time_text(at: int) -> str:
    """Return the time of day, with the date if the capture has a real one."""
    seconds, rest = divmod(at, SECOND)
    return f"{_second_text(seconds)}.{rest // 1000:06d}"


@lru_cache(1)
def _second_text(seconds: int) -> str:
    moment = datetime.fromtimestamp(seconds, UTC)
    return f"{moment:%H:%M:%S}" if seconds < DAY else f"{moment:%Y-%m-%d %H:%M:%S}"
