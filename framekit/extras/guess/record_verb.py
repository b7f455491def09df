"""`framekit record`: the bytes of an unknown line, recorded and shown; search for its speed and format."""

from __future__ import annotations

import argparse
import asyncio
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    PortError,
    VerbError,
    WordsError,
    add,
    begin_log,
    duration_of,
    in_words,
    on_stop,
    print_json,
    print_trouble,
    table,
    time_of,
    until,
    why_not,
)
from framekit.cli.live_output import LiveOutput, live_output
from framekit.definition.problems import plural
from framekit.transport.schemes import help_on_ports

if TYPE_CHECKING:
    from framekit.definition.times import LineFormat
    from framekit.extras.guess.line_trial import HeardAt, LineTrial, TrialResult
    from framekit.extras.guess.record import Recorder


def add_record_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "ports", nargs="+", metavar="PORT",
        help=f"{help_on_ports()}; a second one that hears the other direction of the line",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", metavar="FILE", type=Path, help="the recording: JSON lines (.jsonl), else pcap"
    )
    add(parser, "--speed", help="line speed in bits a second; default: 9600")
    add(parser, "--format", help="data bits, parity (N, E, O, M, S) and stop bits; default: 8N1")
    parser.add_argument(
        "--try", dest="tries", action="store_true",
        help="find speed and format first; with -o, go on with what was found",
    )  # fmt: skip
    parser.add_argument("--speeds", metavar="N,N…", help="what --try tries; default: 1200 to 115200")
    parser.add_argument("--formats", metavar="F,F…", help="what --try tries; default: 8N1,8E1,8O1,7E1,7O1,7N1")
    parser.add_argument("--each", metavar="TIME", help="how long --try listens to each; default: 2s")
    parser.add_argument(
        "--through", action="store_true", help="stand between two ports: what comes at one leaves at the other"
    )
    parser.add_argument("--pause", metavar="TIME", help="a pause that is shown; default: 5 characters, 5 ms at least")
    parser.add_argument("--quiet", action="store_true", help="show no bytes")
    add(parser, "--for", "--log", "--json")


def run_record(arguments: argparse.Namespace) -> int:
    _check(arguments)
    duration = duration_of(arguments.duration)
    goes_on = "" if arguments.output is None or arguments.tries else "the recording"
    with live_output(arguments.json, has_quiet=True, goes_on=goes_on) as live:
        begin_log(arguments.log)
        try:
            return asyncio.run(_run(arguments, duration, live))
        except OSError as error:
            raise VerbError(why_not(error)) from None


def _check(arguments: argparse.Namespace) -> None:
    """Raise WordsError for options that exclude each other."""
    if arguments.output is None and arguments.quiet and not arguments.tries:
        raise WordsError("--quiet shows nothing, and nothing is recorded – name a file with -o")
    for option in ("speeds", "formats", "each"):
        if getattr(arguments, option) is not None and not arguments.tries:
            raise WordsError(f"--{option} is what --try tries – add --try")
    for option in ("speed", "format"):
        if getattr(arguments, option) is not None and arguments.tries:
            raise WordsError(f"--{option} is what --try finds – leave one of the two out")
    if arguments.output is not None and arguments.output.is_file():
        raise WordsError(f"{arguments.output} is there already – name another file, or delete it first")
    if arguments.pause is not None and not time_of("--pause", arguments.pause):
        raise WordsError("--pause: write a time above 0")


async def _run(arguments: argparse.Namespace, duration: int | None, live: LiveOutput) -> int:
    stopped = asyncio.Event()
    line = _line(arguments.format or "8N1", 9600 if arguments.speed is None else arguments.speed)
    if arguments.tries:
        verdict = await _try(arguments, stopped)
        if verdict.line is None or stopped.is_set() or arguments.output is None:
            return 0 if verdict.certainty in ("sure", "likely") else 1
        line = verdict.line
    return await _record(arguments, line, duration, stopped, live)


def _line(form: str, speed: int) -> LineFormat:
    from framekit.definition.times import parse_format

    try:
        return parse_format(form, speed)
    except ValueError as error:
        raise WordsError(str(error)) from None


# ---- recording ------------------------------------------------------------------------------------------------


class _PortStates:
    """Show the states of the ports of a recording; stop it if a port cannot be opened at first."""

    recorder: Recorder

    def __init__(self, urls: Sequence[str], stopped: asyncio.Event) -> None:
        self._urls, self._stopped = urls, stopped
        self.failed: list[str] = []
        """The reasons why ports could not be opened."""
        self._opened: set[int] = set()
        self._last: dict[int, str] = {}

    def change(self, number: int, text: str) -> None:
        """Show the new state of a port: `open`, or the reason why it is not."""
        if text == "open":
            if number not in self._opened and not self.recorder.wires[number].port.sees_damage:
                _say(f"{self._urls[number]}: damaged characters and breaks cannot be seen here, only bytes and times")
            self._opened.add(number)
        elif number not in self._opened:
            self.failed.append(text)
            self._stopped.set()
        elif text != self._last[number]:  # otherwise unchanged since the last try
            _say(f"{text} – trying again")
        self._last[number] = text


async def _record(
    arguments: argparse.Namespace, line: LineFormat, duration: int | None, stopped: asyncio.Event, live: LiveOutput
) -> int:
    """Record until the time is over, or SIGINT or SIGTERM arrives; return the exit status.

    Raises WordsError, PortError, OSError.
    """
    from framekit.extras.guess.record import LEGEND, ByteRows, ByteView, Recorder, clock_of_loop, usual_pause
    from framekit.transport.schemes import scheme_of

    began = time.monotonic_ns()
    live.on_stop(stopped.set)
    live.stops(stopped.set)
    kind = scheme_of(arguments.ports[0])
    pause = usual_pause(line if kind is not None and kind.wires else None)
    if arguments.pause is not None:
        pause = time_of("--pause", arguments.pause)
    rows = None if arguments.json else ByteRows(began, pause)
    view = ByteView(clock_of_loop(), began, rows, print)
    states = _PortStates(arguments.ports, stopped)
    with in_words():
        states.recorder = recorder = Recorder.at(
            arguments.ports, arguments.output, lambda heard: None if arguments.quiet else view.show(heard),
            line=line, on_state=states.change, through=arguments.through,
        )  # fmt: skip
    if not arguments.quiet and not arguments.json:
        at = f" at {line}" if recorder.wires[0].port.settings is not None else ""
        what = "showing" if arguments.output is None else "recording"
        _say(f"{what} {' and '.join(arguments.ports)}{at} – Ctrl-C ends it; {LEGEND}")
    recorder.watch_troubles(print_trouble)
    recorder.start()
    try:
        with live.may_drop():
            await until(duration, stopped)
    finally:
        recorder.stop()
        view.close()
    if states.failed:
        _drop_empty(arguments.output, recorder)
        raise PortError(states.failed[0])
    live.check()
    _summary(arguments, recorder)
    for problem in recorder.problems:
        _say(problem)
    return live.report_losses(1 if recorder.problems else 0)


def _drop_empty(path: Path | None, recorder: Recorder) -> None:
    """Delete an empty recording, such as of a port that could not be opened."""
    if path is not None and path.is_file() and not any(wire.counts.bytes for wire in recorder.wires):
        path.unlink(missing_ok=True)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _summary(arguments: argparse.Namespace, recorder: Recorder) -> None:
    for url, wire, load in zip(arguments.ports, recorder.wires, recorder.loads, strict=True):
        counts, share = wire.counts, load.share(time.monotonic_ns())
        sees = wire.port.sees_damage or counts.framing or counts.parity or counts.breaks
        if arguments.json:
            data: dict[str, Any] = {"event": "line", "port": url, "bytes": counts.bytes}
            if sees:
                data |= {"framing": counts.framing, "parity": counts.parity, "breaks": counts.breaks}
            if counts.overruns:
                data["overruns"] = counts.overruns
            print_json(data | {"line_measured": None if share is None else round(share, 6)})
            continue
        parts = [plural(counts.bytes, "byte")]
        if sees:
            parts += [plural(counts.framing, "framing error"), plural(counts.parity, "parity error")]
            parts.append(plural(counts.breaks, "break"))
        if counts.overruns:
            parts.append(f"characters lost {counts.overruns} times")
        parts += [] if share is None else [f"line load {100 * share:.1f} %"]
        print(f"{url}: {', '.join(parts)}")
    if not arguments.json and arguments.output is not None:
        print(f"recorded in {arguments.output}")


# ---- finding speed and format ---------------------------------------------------------------------------------


async def _try(arguments: argparse.Namespace, stopped: asyncio.Event) -> TrialResult:
    """Listen with each speed and format, and return the verdict. Raises WordsError, PortError."""
    from framekit.extras.guess.line_trial import EACH, FORMATS, LONGER, SPEEDS, TESTED, try_lines

    if len(arguments.ports) > 1:
        raise WordsError("--try listens to one port – try them one after the other")
    speeds, formats = arguments.speeds or SPEEDS, arguments.formats or FORMATS
    lines = list(
        dict.fromkeys(_line(form, _speed(speed)) for speed in speeds.split(",") for form in formats.split(","))
    )
    each = EACH if arguments.each is None else time_of("--each", arguments.each)
    if not each:
        raise WordsError("--each: write a time above 0")
    count = 0

    def told(heard: HeardAt) -> None:
        nonlocal count
        count += 1
        if not arguments.json and not arguments.quiet:
            _say(f"{count:4}  {heard.line!s:<12} {_what(heard)}")

    def begun(trial: LineTrial) -> None:
        def stop() -> None:
            stopped.set()
            trial.stop()

        on_stop(stop)

    if not arguments.json and not arguments.quiet:
        seconds = each * (len(lines) + LONGER * (len(lines[:4]) + TESTED)) / 1e9
        _say(
            f"listening to {arguments.ports[0]} with {plural(len(lines), 'setting')} of speed and format, "
            f"{max(seconds, 1):.0f} s at most; nothing is sent"
        )
    with in_words():
        verdict = await try_lines(arguments.ports[0], lines, each=each, on_result=told, begun=begun)
    _show_verdict(verdict, arguments.json)
    return verdict


def _speed(text: str) -> int:
    if not text.strip().isdecimal() or len(text) > 10:
        raise WordsError(f"'{text.strip()}' is not a speed – write bits a second, such as 9600")
    return int(text)


def _what(heard: HeardAt) -> str:
    from framekit.extras.guess.line_trial import shown_share

    if heard.problem:
        return heard.problem
    return f"{plural(heard.characters, 'character')}, {shown_share(heard)} damaged" if heard.characters else "silence"


def _show_verdict(verdict: TrialResult, as_json: bool) -> None:
    from framekit.api.rows import ascii_of, spaced
    from framekit.extras.guess.line_trial import shown_share

    heard = [(one, bits) for one, bits in zip(verdict.ranking, verdict.bits, strict=False) if one.characters]
    if as_json:
        print_json(
            {
                "event": "found",
                "certainty": verdict.certainty,
                "line": None if verdict.line is None else str(verdict.line),
                "text": verdict.text,
                "ranking": [
                    {
                        "line": str(one.line), "bits": round(bits, 1), "characters": one.characters,
                        "damaged": one.damaged if one.sees_damage else None, "bytes": spaced(one.sample),
                    }
                    for one, bits in heard
                ],
            }
        )  # fmt: skip
        return
    rows = [
        (str(one.line), str(one.characters), shown_share(one), f"{bits:.0f}", spaced(one.sample), ascii_of(one.sample))
        for place, (one, bits) in enumerate(heard[:5])
        if place < 2 or bits > 0
    ]  # fmt: skip
    if rows:
        print(table(rows, ("speed and format", "characters", "damaged", "evidence", "it begins", "")))
    print(verdict.text)
