"""`framekit generate python|diagram PROTOCOL [-o FILE]`: a stand-alone codec module; diagrams of the sequences."""

from __future__ import annotations

import argparse
from pathlib import Path

from framekit.cli.common import add_protocol, load_codec, why_not
from framekit.cli.main import Failure


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "what",
        choices=("python", "diagram"),
        help="python: a module of plain functions, usable without framekit; diagram: the sequences in Mermaid",
    )
    add_protocol(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="where to write it; default: standard output")


def run(arguments: argparse.Namespace) -> int:
    protocol = load_codec(arguments.protocol).protocol
    if arguments.what == "python":
        from framekit.codec.python.generate import generate_source

        source = generate_source(protocol)
    else:
        from framekit.definition.diagrams import diagrams

        source = diagrams(protocol)
    if arguments.output is None:
        print(source, end="")
        return 0
    try:
        arguments.output.write_text(source, encoding="utf-8")
    except OSError as error:
        raise Failure(f"cannot write {why_not(error)}") from None
    return 0
