"""`framekit new`: the files that a protocol of one's own begins with."""

from __future__ import annotations

import argparse
from pathlib import Path

from framekit.cli.common import VerbError, in_words, near, why_not


def add_new_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", choices=("protocol",), help="protocol: a package with a definition, cases and a test")
    parser.add_argument("name", metavar="NAME", help="name of the protocol, such as acme-meter")
    parser.add_argument("-o", "--output", metavar="FOLDER", type=Path, help="where to write it; default: framekit-NAME")


def run_new(arguments: argparse.Namespace) -> int:
    from framekit.api.new import new_protocol

    folder = arguments.output or Path(f"framekit-{arguments.name}")
    with in_words():
        try:
            written = new_protocol(arguments.name, folder)
        except OSError as error:
            raise VerbError(why_not(error)) from None
    for path in written:
        print(near(str(path)))
    return 0
