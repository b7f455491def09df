"""Decode captures for the verb `decode`. An extra writes tables (`--to`, `--values`)."""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
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
)
from framekit.definition.problems import plural
from framekit.table_of_extras import OPTIONS, load

if TYPE_CHECKING:
    from framekit import Seen
    from framekit.codec.contents import Contents
    from framekit.definition.model.protocol import Protocol

DAY = 86_400
SECOND = 1_000_000_000


def decode_capture(protocol: Protocol, arguments: argparse.Namespace) -> int:
    """Print every frame; return 1 if the capture has bad frames or noise. Raises VerbError."""
    from framekit.api.monitor import decoder, result_of
    from framekit.codec.contents import Requests, contents_of

    if arguments.to is not None and arguments.values is not None:
        raise WordsError("--to and --values write different tables – leave one of them out")
    if arguments.to is not None:
        return int(load(OPTIONS["decode --to"])(protocol, arguments))
    for option in ("jobs", "engine"):
        if getattr(arguments, option) is not None:
            raise WordsError(f"--{option} has no effect without --to – add --to OUT.parquet, or remove it")
    if arguments.values is not None:
        return int(load(OPTIONS["decode --values"])(protocol, arguments))
    wanted, contents, requests = filter_of(arguments), contents_of(protocol), Requests()
    counts: Counter[str] = Counter()
    if matching(arguments.capture):
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
                requests.attach(contents, seen, channel)
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
        print(f"{arguments.capture}: {CUT}", file=sys.stderr)
    if not arguments.json:
        print(counted(counts))
    return 1 if counts["bad"] or counts["noise"] else 0


def decoding(counts: Mapping[str, int]) -> AbstractContextManager[object]:
    """Show the progress, unless decoded frames fill the terminal."""
    return nullcontext() if sys.stdout.isatty() else ProgressLine("decode", lambda: counted(counts))


def matching(pattern: Path) -> list[Path]:
    """Return the files that match a pattern, in order; none if the pattern is the name of a file."""
    return [] if pattern.exists() else [Path(one) for one in sorted(glob(str(pattern)))]


CUT = "the last record is not whole – its writer was stopped"
"""Message about a capture that ends within a record."""


def counted(counts: Mapping[str, int]) -> str:
    """Return the numbers of frames, bad frames and noise in words."""
    return f"{plural(counts.get('frame', 0), 'frame')}, {counts.get('bad', 0)} bad, {counts.get('noise', 0)} noise"


def _text(contents: Contents, channel: int, seen: Seen, as_ascii: bool) -> str:
    """Return the line of a frame and, below it, its fields."""
    text = seen_text(seen, time_text(seen.at), f"ch {channel}", as_ascii)
    fields = contents.to_plain(seen.frame, seen.fields, seen.request)
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
