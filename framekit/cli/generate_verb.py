"""`framekit generate WHAT PROTOCOL`: write code or a document from a definition.

The core writes Python; extras bring the other generators (`framekit/table_of_extras.py`), which share the functions
here that are not of the verb.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from framekit.cli.common import NAMES_HELP, VerbError, WordsError, add, load_codec, near, why_not
from framekit.definition.problems import Problem
from framekit.table_of_extras import GENERATORS, load

LONGEST_FRAME = 65_536


def add_generate_arguments(parser: argparse.ArgumentParser) -> None:
    abouts = {"python": "a module of plain functions, usable without framekit"}
    abouts |= {name: generator.about for name, generator in GENERATORS.items()}
    parser.add_argument(
        "what", choices=tuple(abouts), help="; ".join(f"{name}: {about}" for name, about in abouts.items())
    )
    add(parser, "protocol")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="where to write it; default: standard output; of c and kaitai a directory; of document NAME.html or"
        " NAME.md",
    )
    parser.add_argument(
        "--strict", action="store_true", help="c, wireshark, kaitai: exit status 1 if something is left out"
    )
    add(parser, "--param", help=NAMES_HELP)
    parser.add_argument(
        "--max-bytes", type=_bytes_of_a_frame, metavar="N", default=None,
        help="c: bytes of a frame whose definition has no limit (default 1024)",
    )  # fmt: skip


def _bytes_of_a_frame(text: str) -> int:
    """Return a number of bytes from its text. Raises ArgumentTypeError."""
    if not text.isdecimal() or not 1 <= int(text) <= LONGEST_FRAME:
        raise argparse.ArgumentTypeError(f"'{text}' is no size – write a number from 1 to {LONGEST_FRAME}")
    return int(text)


def run_generate(arguments: argparse.Namespace) -> int:
    if arguments.output is not None and arguments.output.suffix in (".yaml", ".yml"):
        raise WordsError(f"-o: {arguments.output} ends like a definition, and none is written over – name another file")
    if arguments.what == "python":
        return _write_python(arguments)
    return int(load(GENERATORS[arguments.what].target)(arguments))


def _write_python(arguments: argparse.Namespace) -> int:
    from framekit.codec.python.generate import generate_source

    protocol = load_codec(arguments.protocol).protocol
    refuse_params(arguments)
    return write_text(arguments, generate_source(protocol))


def refuse_params(arguments: argparse.Namespace) -> None:
    """Raise WordsError if parameters are given to a generator that does not use them."""
    if arguments.param:
        raise WordsError("--param is for wireshark: other code is given parameters when it runs")


def write_text(arguments: argparse.Namespace, text: str) -> int:
    """Write a text to the output file, or print it; return the exit status. Raises VerbError."""
    if arguments.output is None:
        print(text, end="")
        return 0
    try:
        arguments.output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise VerbError(f"cannot write {why_not(error, arguments.output)}") from None
    return 0


def place(problem: Problem) -> str:
    """Return the place of a problem, relative to the current folder."""
    return f"{near(problem.at.file)}:{problem.at.line}:{problem.at.column}"
