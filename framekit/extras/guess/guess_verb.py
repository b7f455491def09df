"""`framekit guess FILE…` and `framekit diff A B`: statements about an unknown line, and the differences of two
recordings.
"""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    ProgressLine,
    VerbError,
    WordsError,
    add,
    begin_log,
    duration_of,
    existing,
    print_json,
    table,
    until,
)
from framekit.cli.web_option import NoPage, add_web, page_of
from framekit.definition.problems import plural
from framekit.extras.web.web_page import WebPage

if TYPE_CHECKING:
    from framekit.extras.guess.hex_session import HexBoard
    from framekit.extras.guess.recordings import Guess, GuessedTimes, HeardBytes, TimeSpread

MOST_POINTS = 20
"""Largest number of shown values of a known protocol."""
FILES_HELP = "captures (pcap, JSON lines), pcap files of TCP or UDP, or hex text: a line for each frame"


def add_guess_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", metavar="FILE", nargs="+", type=Path, help=FILES_HELP)
    parser.add_argument("--write", metavar="NAME.yaml", type=Path, help="write a definition of what was found")
    parser.add_argument(
        "--with",
        dest="definition",
        metavar="NAME.yaml",
        help="go on from a definition: what of the files is still noise",
    )
    add(parser, "--for")
    add_web(parser)
    add(parser, "--log", "--json")


def run_guess(arguments: argparse.Namespace) -> int:
    if arguments.write is not None and arguments.definition is not None:
        raise WordsError("--write makes a definition, --with goes on from one – leave one of them out")
    if arguments.write is not None and arguments.write.exists():
        raise WordsError(f"--write: {arguments.write} is there already – name another file")
    if arguments.write is not None and not arguments.write.parent.is_dir():
        raise WordsError(f"--write: there is no folder '{arguments.write.parent}' – make it first")
    if arguments.duration is not None and arguments.web is None:
        raise WordsError("--for ends the page – it has no effect without --web")
    begin_log(arguments.log)
    duration_of(arguments.duration)
    page = page_of(arguments)
    chunks = heard_in(arguments.files)
    if arguments.definition is not None:
        return _of_definition(arguments, chunks, page)
    return _of_guess(arguments, chunks, page)


def _of_definition(arguments: argparse.Namespace, chunks: list[HeardBytes], page: NoPage) -> int:
    """Print or show the bytes decoded by a definition; return the exit status."""
    from framekit.extras.guess.recordings import reading_of

    with ProgressLine("guess"):
        reading = reading_of(arguments.definition, chunks)

    def print_results() -> None:
        print_json(reading.data) if arguments.json else print(reading.text)

    if not isinstance(page, WebPage):
        print_results()
        return 0 if reading.data["frames"] else 1
    from framekit.extras.guess.hex_session import HexBoard
    from framekit.extras.guess.hex_table import definition_table

    title = f"{_named(arguments.files)} with {arguments.definition}"
    board = HexBoard(title, definition_table(arguments.definition, chunks), [], behaviours=reading.data["fields"])
    _show(arguments, page, board, print_results, "")
    return 0


def _of_guess(arguments: argparse.Namespace, chunks: list[HeardBytes], page: NoPage) -> int:
    """Print or show the statements about the bytes; return the exit status."""
    from framekit.extras.guess.known_lines import known_protocols
    from framekit.extras.guess.recordings import Evidence, Statement, guess, heard_points

    with ProgressLine("guess"):
        found, known = guess(chunks), known_protocols(chunks)
        points = heard_points(known[0].name, chunks) if known else []
    source = _named(arguments.files)

    def print_results() -> None:
        if arguments.json:
            values = {point.name: point.values for point in points}
            rows = [{"protocol": one.name, "frames": one.frames} for one in known]
            print_json(data_of(found) | {"known": rows, "values": values})
        else:
            for number, one in enumerate(known):
                print(f"this is {one.name}: {plural(one.frames, 'frame')}, {one.covered} of {one.of} bytes")
                for point in points[:MOST_POINTS] if number == 0 else ():
                    print(f"  {point.name}: {point.told}")
                if number == 0 and len(points) > MOST_POINTS:
                    print(f"  and {len(points) - MOST_POINTS} more: --with {one.name} shows all")
            print(text_of(found))
        if arguments.write is not None:
            write(found, arguments.write, source)

    if not isinstance(page, WebPage):
        print_results()
        return 0
    from framekit.api.imports import ProtocolNameError, protocol_name
    from framekit.extras.guess.draft import DraftError, NamedGuess
    from framekit.extras.guess.hex_session import HexBoard
    from framekit.extras.guess.hex_table import guessed_table

    known_statements = [
        Statement(f"this is {one.name} – --with {one.name} shows its fields", Evidence(one.covered, one.of), False)
        for one in known
    ]
    try:
        name = "found" if arguments.write is None else protocol_name(arguments.write)
        names = NamedGuess(found, name, source, arguments.write) if found.kinds else None
    except (DraftError, ProtocolNameError) as error:
        raise VerbError(str(error)) from None
    board = HexBoard(source, guessed_table(found), [*known_statements, *found.statements], names)
    _show(arguments, page, board, print_results, "name fields" if names is not None else "")
    return 0


def _named(files: list[Path]) -> str:
    return ", ".join(path.name for path in files)


def _show(
    arguments: argparse.Namespace, page: WebPage, board: HexBoard, print_results: Callable[[], None], to: str
) -> None:  # fmt: skip
    """Show the page until the time is over, or SIGINT or SIGTERM arrives.

    In text output the address of the page comes last, in JSON first.
    """
    from framekit.cli.live_output import live_output

    duration = duration_of(arguments.duration)

    async def shown() -> None:
        ended = asyncio.Event()
        live.on_stop(ended.set)
        if not arguments.json:
            print_results()
        async with page.shows(board, to=to):
            if arguments.json:
                print_results()
            await until(duration, ended)

    with live_output(arguments.json, goes_on="the page") as live:
        asyncio.run(shown())


def heard_in(files: list[Path]) -> list[HeardBytes]:
    """Return the bytes of all files. Raises VerbError if they hold none."""
    from framekit.extras.guess.recordings import HeardError, heard

    try:
        chunks = [chunk for file in files for chunk in heard(existing(file))]
    except HeardError as error:
        raise VerbError(str(error)) from None
    if not chunks:
        raise VerbError("no bytes were found in there")
    return chunks


def write(found: Guess, path: Path, source: str) -> None:
    """Write the definition with its vectors, and print its problems. Raises VerbError."""
    from framekit.api.imports import ProtocolNameError
    from framekit.extras.guess.draft import DraftError, write_definition

    try:
        draft = write_definition(found, path, source)
    except (DraftError, ProtocolNameError, OSError) as error:
        raise VerbError(str(error)) from None
    for problem in draft.problems:
        print(f"not right yet: {problem}")
    if draft.problems:
        print(f"{path} is written all the same, and its vectors beside it, to go on from there")
    if not draft.problems:
        print(f"{path} is written, and its vectors beside it – framekit test {path}")


def text_of(found: Guess) -> str:
    """Return the results in words."""
    whole = sum(len(chunk.data) for chunk in found.chunks)
    noise = f", {found.noise} bytes of {whole} in none" if found.noise else ""
    lines = [f"{plural(len(found.frames), 'frame')} in {plural(len(found.chunks), 'piece')}{noise}", ""]
    for one in found.statements:
        lines.append(f"{'sure ' if one.is_sure else 'maybe'}  {one.text}  ({one.evidence})")
    for kind in found.kinds:
        rows = [
            (str(field.offset), str(field.size) if field.size else "…", field.name, field.kind, field.about)
            for field in kind.fields
        ]
        side = f", {kind.side}" if kind.side else ""
        lines += ["", f"{kind.name}: {plural(len(kind.frames), 'frame')}{side}"]
        lines.append(table(rows, ("offset", "bytes", "field", "is", "what is known")))
    return "\n".join(lines)


def data_of(found: Guess) -> dict[str, Any]:
    """Return the results for JSON output."""
    return {
        "frames": len(found.frames),
        "noise": found.noise,
        "statements": [
            {
                "text": one.text, "sure": one.is_sure, "holds": one.evidence.holds, "of": one.evidence.of,
                **({"against": one.against} if one.against else {}),
            }
            for one in found.statements
        ],
        "kinds": [
            {
                "name": kind.name, "side": kind.side, "frames": len(kind.frames),
                "fields": [
                    {"name": one.name, "offset": one.offset, "size": one.size, "is": one.kind, "about": one.about}
                    for one in kind.fields
                ],
            }
            for kind in found.kinds
        ],
        "times": times_data(found.times),
    }  # fmt: skip


def times_data(times: GuessedTimes) -> dict[str, Any]:
    """Return the times (ns) for programs."""

    def spread(one: TimeSpread | None) -> dict[str, int] | None:
        return None if one is None else {"least": one.least, "middle": one.middle, "greatest": one.greatest}

    silence = times.unanswered
    return {
        "answers": [
            {"asked": one.asked, "told": dict(one.told), "of": one.of, "delay": spread(one.delay)}
            for one in times.answers
        ],
        "unanswered": None if silence is None else {
            "requests": silence.count, "of": silence.of, "wait": spread(silence.wait), "repeats": silence.repeats,
        },
        "periods": [
            {
                "kind": one.kind, "bytes": one.data.hex(" ").upper(), "every": spread(one.every), "near": one.near,
                "of": one.of,
            }
            for one in times.periods
        ],
    }  # fmt: skip


# ---- diff -------------------------------------------------------------------------------------------------------


def add_diff_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", metavar="FILE", nargs=2, type=Path, help=f"two recordings: {FILES_HELP}")
    parser.add_argument(
        "--with", dest="definition", metavar="NAME.yaml", help="which fields of this definition differ, by their names"
    )
    add(parser, "--json")


def run_diff(arguments: argparse.Namespace) -> int:
    from framekit.extras.guess.differences import definition_differences, differences

    one, two = (heard_in([file]) for file in arguments.files)
    known = arguments.definition
    with ProgressLine("diff"):
        rows = differences(one, two) if known is None else definition_differences(known, one, two)
    if arguments.json:
        for row in rows:
            print_json(row._asdict())
    elif rows:
        print(table([tuple(map(str, row)) for row in rows], ("frame", "offset", "field", "first", "second")))
    else:
        print("no field differs")
    return 0
