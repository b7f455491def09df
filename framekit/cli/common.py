"""Shared parts of the verbs: errors, options, protocols, assignments, hex input, seen frames, colours."""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Coroutine, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO, TypeVar

from framekit.cli.terminal import discard_unwritten, unguarded
from framekit.definition.problems import error_text, printable, separately, together

if TYPE_CHECKING:
    import asyncio
    from types import FrameType

    from framekit import Seen
    from framekit.api.monitor import FrameFilter
    from framekit.api.run import TroubleReport
    from framekit.api.settings import Names
    from framekit.codec.cache import CachedCodec
    from framekit.codec.contents import Contents
    from framekit.definition.model.protocol import Protocol
    from framekit.definition.problems import Problem
    from framekit.definition.times import LineFormat

V = TypeVar("V")


class VerbError(Exception):
    """Raised if a command failed; the message gives the reason."""

    status = 1
    """Exit status."""
    kind = "failed"
    """Kind of the error in the output of `--json`."""


class WordsError(VerbError):
    """Raised for a wrong command line: an option, a name or a value. The command had no effect."""

    status = 2
    kind = "command_line"


class PortError(VerbError):
    """Raised if the port cannot be opened."""

    status = 3
    kind = "port"


LEVELS = ("debug", "info", "warning", "error")


def _new_capture(text: str) -> Path:
    """Return the file of a new capture. Raises ArgumentTypeError if it exists: it may contain another capture."""
    from framekit.api.monitor import written_over

    path = Path(text)
    if (old_file := written_over(path)) is not None:
        raise argparse.ArgumentTypeError(f"{old_file} is there already – name another file, or delete it first")
    return path


OPTIONS: dict[str, dict[str, Any]] = {
    "protocol": {"metavar": "PROTOCOL", "help": "name of a shipped protocol, or a YAML file"},
    "-n, --count": {"type": int, "metavar": "COUNT"},
    "--json": {"action": "store_true", "help": "print JSON instead of text"},
    "--speed": {"type": int, "metavar": "BITS", "help": "line speed in bits a second; default: the protocol's"},
    "--format": {"metavar": "8E1", "help": "data bits, parity (N, E, O, M, S) and stop bits; default: the protocol's"},
    "--param": {
        "action": "append", "default": [], "metavar": "NAME=VALUE",
        "help": "parameter of the protocol; may be repeated",
    },
    "--filter": {"default": "", "metavar": "TEXT", "help": "only what has this in its name, reason or bytes"},
    "--frame-name": {"default": "", "metavar": "NAME", "help": "only frames whose name has this in it"},
    "--bad": {"action": "store_true", "help": "only bad frames and noise"},
    "--ascii": {"action": "store_true", "help": "show bytes as ASCII instead of hex"},
    "--capture": {
        "metavar": "FILE", "type": _new_capture,
        "help": "write everything on the lines to FILE: JSON lines (.jsonl), else pcap, a file for each channel",
    },
    "--screen": {"action": "store_true", "help": "show it live in the terminal; needs the extra 'screen'"},
    "--log": {"choices": LEVELS, "metavar": "LEVEL", "help": f"log to standard error: {', '.join(LEVELS)}"},
    "--for": {"dest": "duration", "metavar": "TIME", "help": "stop after this time, such as 10s"},
}  # fmt: skip
"""Arguments of several verbs."""

NAMES_HELP = "value of a parameter or a variable that the bytes depend on; may be repeated"
"""Help of `--param` for verbs that have bytes and no line."""


def add(parser: argparse._ActionsContainer, *names: str, **otherwise: Any) -> None:
    """Add arguments of `OPTIONS`; `otherwise` replaces settings of the table."""
    for name in names:
        parser.add_argument(*name.split(", "), **(OPTIONS[name] | otherwise))


def told(problem: Problem) -> str:
    """Return a problem as it is printed: with the path relative to the current folder."""

    return str(problem._replace(at=problem.at._replace(file=near(problem.at.file))))


def reasons_of(error: ValueError) -> list[str]:
    """Return the reasons why an edit was refused, as they are printed, without warnings."""
    from framekit.definition.problems import DefinitionError

    if isinstance(error, DefinitionError):
        return [told(problem) for problem in error.problems if not problem.warning]
    return [str(error)]


def status_of(problems: Iterable[Problem]) -> int:
    """Return the exit status: 1 for faults in files; 2 if only names on the command line are wrong."""
    wrong = [problem for problem in problems if not problem.warning]
    if not wrong:
        return 0
    return 1 if any(problem.at.line for problem in wrong) else WordsError.status


def told_once(problems: Iterable[Problem]) -> list[str]:
    """Return problems as they are printed; equal ones of a file become one line with all places."""
    return [told(problem) for problem in together(problems)]


def near(file: str) -> str:
    """Return a path below the current folder relative to it, other paths as they are."""
    path = Path(file)
    return str(path.relative_to(Path.cwd())) if path.is_absolute() and path.is_relative_to(Path.cwd()) else file


def why_not(error: OSError, file: Path | None = None) -> str:
    """Return the reason of a system error with its file: `file`, if the error does not name a file."""
    text, about = error_text(error), error.filename if error.filename is not None else file
    return f"{near(str(about))}: {text}" if about is not None else text


def tell_error(arguments: argparse.Namespace, kind: str, message: str, **more: object) -> None:
    """Print an error message on standard error; with `--json` also as an object on standard output.

    Raise no error if a stream cannot be written.
    """
    if getattr(arguments, "json", False):
        print_error_data({"error": kind, "message": message, **more})
    with contextlib.suppress(OSError):
        print(f"{painted(f'framekit {arguments.verb}', 'red', sys.stderr)}: {message}", file=sys.stderr)


def print_error_data(data: dict[str, object]) -> None:
    """Print an error as a JSON object; leave it out if standard output cannot be written."""
    try:
        print_json(data)
        sys.stdout.flush()
    except OSError:
        discard_unwritten()


def print_failure(error: OSError) -> None:
    """Print a system error that no verb has caught."""
    with contextlib.suppress(OSError):
        print(f"{painted('framekit', 'red', sys.stderr)}: {why_output_failed(error)}", file=sys.stderr)


def why_output_failed(error: OSError) -> str:
    """Return the reason of a system error; if a disk has no room, and no file is named, it is standard output's."""
    is_output = error.filename is None and error.errno in OUTPUT_ERRORS
    return f"{OUTPUT}: {why_not(error)} – {OUTPUT_HELP}" if is_output else why_not(error)


OUTPUT_ERRORS = frozenset((errno.ENOSPC, errno.EFBIG, errno.EIO, getattr(errno, "EDQUOT", errno.ENOSPC)))
"""Numbers of system errors that a write to a file raises, and a connection does not."""
OUTPUT = "standard output"
OUTPUT_HELP = "make room there, or send the output to another place"
"""The name of the stream, and what to do if it cannot be written."""


def print_trouble(report: TroubleReport) -> None:
    """Print a trouble of a file or a server on standard error at once, as a whole line; any thread."""
    from framekit.definition.problems import printable

    sys.stderr.write(f"{printable(report.text)}\n")
    sys.stderr.flush()


def tell_problems(arguments: argparse.Namespace, problems: Sequence[Problem]) -> int:
    """Print problems of files as `tell_error` does; return the exit status."""
    wrong = [problem for problem in problems if not problem.warning]
    if getattr(arguments, "json", False):
        shown = [problem_data(problem) for problem in separately(problems)]
        print_error_data({"error": "definition", "message": told((wrong or problems)[0]), "problems": shown})
    with contextlib.suppress(OSError):
        for problem in problems:
            print(told(problem) if problem.at.line else f"framekit {arguments.verb}: {told(problem)}", file=sys.stderr)
    return status_of(problems)


def problem_data(problem: Problem) -> dict[str, object]:
    """Return a problem as a JSON object."""
    return {
        "file": near(problem.at.file),
        "line": problem.at.line,
        "column": problem.at.column,
        "what": problem.what,
        "todo": problem.todo,
        "warning": problem.warning,
    }


def load(name: str) -> Protocol:
    """Return the protocol of a command line. Raises DefinitionError; warnings go to standard error."""
    from framekit.definition.load.protocol import load_protocol

    protocol = load_protocol(name, Path.cwd())
    _warn(protocol)
    return protocol


def load_codec(name: str) -> CachedCodec:
    """Return the functions of a protocol alone, which takes less time; the definition is read on demand."""
    from framekit.codec.cache import cached_codec

    codec = cached_codec(name, Path.cwd())
    if codec.warned:
        _warn(codec.protocol)
    return codec


def _warn(protocol: Protocol) -> None:
    for warning in protocol.warnings:
        print(told(warning), file=sys.stderr)


def assignment(text: str) -> tuple[str, Any]:
    """Split `NAME=VALUE`; objects, lists and quoted strings are JSON values, all others plain text."""
    import json

    def once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        return each_once(pairs, f"in the value of '{name}', ")

    name, equals, value = text.partition("=")
    if not equals or not name:
        raise WordsError(f"'{text}' is not NAME=VALUE")
    if value[:1] in ("{", "[", '"'):
        try:
            return name, json.loads(value, object_pairs_hook=once_each)
        except json.JSONDecodeError as error:
            raise WordsError(f"the value of '{name}' is not JSON: {error.msg} at character {error.pos + 1}") from None
        except RecursionError:
            raise WordsError(f"the value of '{name}' is nested too deeply") from None
    return name, value


def each_once(pairs: Iterable[tuple[str, V]], where: str = "") -> dict[str, V]:
    """Return values by their names. Raises WordsError for a repeated name; `where` begins its message."""
    found: dict[str, V] = {}
    for name, value in pairs:
        if name in found:
            raise WordsError(f"{where}'{name}' is given twice – give it once")
        found[name] = value
    return found


def assignments(texts: Iterable[str]) -> dict[str, Any]:
    """Split several `NAME=VALUE`. Raises WordsError."""
    return each_once(assignment(text) for text in texts)


def scope_of(protocol: Protocol, settings: Iterable[str]) -> Names:
    """Return names for a codec: parameters and state with these settings. Raises WordsError for unfit settings."""
    from framekit.api.settings import names_of

    with in_words():
        return names_of(protocol, assignments(settings))


def time_of(option: str, text: str) -> int:
    """Return the time (ns) of an option. Raises WordsError."""
    from framekit.definition.times import parse_time

    try:
        return parse_time(text)
    except ValueError as error:
        raise WordsError(f"{option}: {error}") from None


def duration_of(text: str | None) -> int | None:
    """Return the time of `--for` (ns), or None. Raises WordsError."""
    return None if text is None else time_of("--for", text)


def existing(file: Path) -> Path:
    """Return a file to be read. Raises WordsError if it does not exist."""
    if os.path.isdir(file):
        raise WordsError(f"{file}: this is a folder, not a file – name a file in it")
    if not os.path.exists(file):
        raise WordsError(f"{file}: there is no such file – check its name and folder")
    return file


HEX_DIGITS = frozenset("0123456789abcdefABCDEF")

SHOWN_DIGITS = 8
"""Digits that are shown on each side of a wrong digit of a long word."""


def hex_bytes(text: str) -> bytes:
    """Return bytes from hex digits with any spacing; `-` reads standard input. Raises WordsError."""
    if text == "-":
        text = sys.stdin.read()
    words = text.replace("0x", " ").replace(",", " ").replace(":", " ").split()
    try:
        return bytes.fromhex("".join(words))
    except ValueError:
        raise WordsError(f"{_not_bytes(words)} – write pairs of hex digits, such as 01 0F") from None


def _not_bytes(words: list[str]) -> str:
    """Return which of these words keeps them from being pairs of hex digits."""
    for word in words:
        place = next((at for at, character in enumerate(word) if character not in HEX_DIGITS), None)
        if place is not None:
            begin, end = max(place - SHOWN_DIGITS, 0), place + SHOWN_DIGITS
            part = "…" * (begin > 0) + printable(word[begin:end]) + "…" * (end < len(word))
            return f"'{part}' is not bytes"
    word = next(word for word in words if len(word) % 2)
    part = word if len(word) <= 2 * SHOWN_DIGITS else f"…{word[-SHOWN_DIGITS:]}"
    return f"'{part}' has a digit without its pair"


def line_of(protocol: Protocol, arguments: argparse.Namespace) -> LineFormat | None:
    """Return speed and format of the command line, else of the protocol; None on connections. Raises WordsError."""
    from framekit.definition.times import parse_format

    line = protocol.line
    if line.kind == "stream" and arguments.speed is None and arguments.format is None:
        return None
    try:
        speed = line.speed if arguments.speed is None else arguments.speed
        return parse_format(arguments.format or line.format, speed)
    except ValueError as error:
        raise WordsError(str(error)) from None


def filter_of(arguments: argparse.Namespace) -> FrameFilter:
    """Return the filter of the command line."""
    from framekit.api.monitor import FrameFilter

    return FrameFilter(frame=arguments.frame_name, bad_only=arguments.bad, text=arguments.filter)


def period_of(text: str | None) -> int:
    """Return the time of --status-every (ns), or 0. Raises WordsError."""
    period = 0 if text is None else time_of("--status-every", text)
    if text is not None and not period:
        raise WordsError("--status-every: write a time above 0")
    return period


LOG_OF_A_VERB = "log of a verb"
"""Name of the handler of the log."""


def begin_log(level: str | None) -> None:
    """Send the log of framekit to standard error, except reports of troubles, which are printed; None: no log.

    The log of an earlier verb of this process ends.
    """
    if level is None and "logging" not in sys.modules:
        return
    import logging

    logger = logging.getLogger("framekit")
    for earlier in [one for one in logger.handlers if one.name == LOG_OF_A_VERB]:
        logger.removeHandler(earlier)
    if level is not None:
        handler = logging.StreamHandler(sys.stderr)
        handler.name = LOG_OF_A_VERB
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(name)s: %(message)s"))
        handler.addFilter(lambda record: not getattr(record, "is_report", False))
        logger.addHandler(handler)
        logger.setLevel(level.upper())


def on_signal(name: str, act: Callable[[], object]) -> None:
    """Make the loop call `act` at a signal (`SIGHUP`); signals that the system does not have never come."""
    import signal

    number = getattr(signal, name, None)
    if number is None:
        return
    import asyncio

    loop = asyncio.get_running_loop()

    def came(number: int, frame: FrameType | None) -> None:
        if loop.is_closed():
            signal.default_int_handler(number, frame)
        loop.call_soon_threadsafe(act)

    try:
        loop.add_signal_handler(number, act)
    except NotImplementedError:  # the loops of Windows
        signal.signal(number, came)


STOP_SIGNALS = ("SIGINT", "SIGTERM", "SIGBREAK")
"""The signals that ask a program to stop; the last of them is Ctrl-Break on Windows."""


def on_stop(stop: Callable[[], object]) -> None:
    """Make the loop call `stop` at each of STOP_SIGNALS."""
    for name in STOP_SIGNALS:
        on_signal(name, stop)


@contextlib.contextmanager
def until_stopped() -> Iterator[None]:
    """End work without a loop at each of STOP_SIGNALS, at any point, without an error.

    Also if the program was started with SIGINT ignored, as shells start jobs in the background.
    """
    import signal

    numbers = [number for name in STOP_SIGNALS if (number := getattr(signal, name, None)) is not None]
    before = {number: signal.signal(number, signal.default_int_handler) for number in numbers}
    try:
        yield
    except KeyboardInterrupt:  # perhaps between making a coroutine and awaiting it
        warnings.filterwarnings("ignore", "coroutine .* was never awaited", RuntimeWarning)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def without_collecting() -> Iterator[None]:
    """Exclude existing objects from garbage collection, which stops everything: for 0.2 s in a large run."""
    import gc

    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


async def until(duration: int | None, *events: asyncio.Event) -> None:
    """Wait for an event, or until the time (ns) is over."""
    import asyncio

    waiting = [asyncio.ensure_future(event.wait()) for event in events]
    try:
        limit = None if duration is None else duration / 1e9
        await asyncio.wait(waiting, timeout=limit, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for one in waiting:
            one.cancel()


@contextlib.contextmanager
def in_words() -> Iterator[None]:
    """Turn requests that the API refuses into WordsError, and lost ports into PortError."""
    from framekit.api.errors import LineClosedError, RequestError

    try:
        yield
    except RequestError as error:
        raise WordsError(str(error)) from None
    except LineClosedError as error:
        raise PortError(str(error)) from None


def run_in_loop(coroutine: Coroutine[Any, Any, V]) -> V:
    """Return the result of a coroutine, which runs in a new event loop (`FRAMEKIT_LOOP`). Raise WordsError."""
    import asyncio

    from framekit.api.event_loop import new_event_loop

    try:
        with in_words():
            loop = new_event_loop()
    except WordsError:
        coroutine.close()
        raise
    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        return runner.run(coroutine)


def table(rows: Sequence[Sequence[str]], head: Sequence[str]) -> str:
    """Return rows in columns, left-aligned, under a head; invisible characters as escapes."""
    from framekit.definition.problems import printable

    lines = [[printable(cell) for cell in row] for row in (head, *rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )


def tables(*found: tuple[Sequence[Sequence[str]], Sequence[str]]) -> str:
    """Return tables with a blank line before each; tables without rows are left out."""
    return "".join(f"\n{table(rows, head)}\n" for rows, head in found if rows)


def plain(value: Any) -> Any:
    """Return bytes as hex pairs, other values as they are."""
    from framekit.api.rows import spaced

    return spaced(value) if isinstance(value, bytes) else value


def print_json(value: Any) -> None:
    """Print a value as one line of JSON."""
    print(json_line(value))


def json_line(value: Any, default: Callable[[Any], Any] | None = None) -> str:
    """Return a value as one line of JSON, invisible characters as escapes; `default` converts other objects."""
    import json

    text = json.dumps(value, ensure_ascii=False, default=default)
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() else json.dumps(sign)[1:-1] for sign in text)


ARROWS = {"in": "←", "out": "→", "": " "}
"""The sign of each direction of a frame."""


@cache
def _rows() -> Any:
    """Return the module that formats rows, imported on first use."""
    from framekit.api import rows

    return rows


def seen_text(
    seen: Seen, time: float | str, where: str, as_ascii: bool = False, stream: TextIO | None = None
) -> str:  # fmt: skip
    """Return a line of a stream: time (seconds, or a text), place, direction, frame, size and bytes.

    `stream` decides about colours; default: standard output.
    """
    raw, kind, place = seen.raw, seen.kind, ARROWS[seen.direction]
    if seen.client:
        place = f"{seen.client} {place}"
    if where:
        place = f"{where} {place}"
    what = f"{seen.frame if kind == 'frame' else _rows().what_was_seen(seen):<22}"
    if not what.isprintable():
        from framekit.definition.problems import printable

        what = printable(what)
    if kind in COLOUR_OF_KIND:
        what = painted(what, COLOUR_OF_KIND[kind], sys.stdout if stream is None else stream)
    if type(time) is float:
        time = f"{time:10.3f}"
    if raw:
        return f"{time}  {place} {what}{len(raw):4d} {_rows().shown_bytes(raw, as_ascii)}"
    return f"{time}  {place} {what}".rstrip()


def seen_data(seen: Seen, seconds: float, contents: Contents, **more: Any) -> dict[str, Any]:
    """Return the same as a JSON object with the frame's fields and names of numbers; empty parts are left out.

    `more` follows the time.
    """
    from framekit.api.rows import spaced

    line = {
        "event": seen.kind,
        "time": seconds,
        **more,
        **({"client": seen.client} if seen.client else {}),
        "direction": seen.direction,
        "frame": seen.frame,
        "size": len(seen.raw) or "",
        "bytes": spaced(seen.raw),
        "fields": contents.to_plain(seen.frame, seen.fields, seen.request),
        "names": contents.names(seen.frame, seen.fields, seen.request),
        "reason": seen.reason,
        "repeated": seen.repeated or "",
    }
    if seen.kind == "bad":
        line |= {"segment": seen.segment, "offset": seen.place}
    return {key: value for key, value in line.items() if value not in ("", {})}


# ---- output for terminals only: colours, and a line with the progress of long work ----------------------------


Colour = Literal["red", "green", "yellow"]
_CODES: dict[Colour, str] = {"red": "31", "green": "32", "yellow": "33"}

COLOUR_OF_KIND: dict[str, Colour] = {"bad": "red", "trouble": "red", "noise": "yellow"}
"""The colours of the kinds of seen frames; other kinds have none."""

SHOWN_AFTER = 2.0
"""Shorter work has no progress line (s)."""
SHOWN_EVERY = 0.25
WIDEST = 78


def has_colours(stream: TextIO) -> bool:
    """Return whether a stream is a terminal with colours that the user wants (NO_COLOR, https://no-color.org)."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or not stream.isatty():
        return False
    return sys.platform != "win32" or "WT_SESSION" in os.environ or "TERM" in os.environ


def painted(text: str, colour: Colour | None, stream: TextIO) -> str:
    """Return a text with its colour, if the stream has colours."""
    return text if colour is None or not has_colours(stream) else f"\x1b[{_CODES[colour]}m{text}\x1b[0m"


class ProgressLine:
    """A line on a terminal that shows the progress of work, from `after` seconds on, as a context manager.

    `says` returns the end of the line; another thread calls it, and it may be replaced at any time.
    """

    def __init__(
        self, what: str, says: Callable[[], str] = lambda: "", *, stream: TextIO | None = None,
        after: float = SHOWN_AFTER,
    ) -> None:  # fmt: skip
        self.says = says
        self._what = what
        self._stream = unguarded(sys.stderr if stream is None else stream)
        self._after = after
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> ProgressLine:
        if self._stream.isatty() and os.environ.get("TERM") != "dumb":
            self._thread = threading.Thread(target=self._show, daemon=True, name="tells how far it is")
            self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()

    def _show(self) -> None:
        from framekit.definition.problems import printable

        began, wait, width = time.monotonic(), self._after, 0
        while not self._over.wait(wait):
            wait = SHOWN_EVERY
            progress = self.says()
            text = printable(f"{self._what}: {time.monotonic() - began:.0f} s{f', {progress}' if progress else ''}")[
                :WIDEST
            ]
            self._stream.write("\r" + text.ljust(width))
            self._stream.flush()
            width = len(text)
        if width:
            self._stream.write("\r" + " " * width + "\r")
            self._stream.flush()
