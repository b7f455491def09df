"""The verbs that write files to begin with: `framekit new`, those of a protocol of one's own; `framekit import`, a
definition of another program's protocol file; `framekit schema`, the schemas with which editors complete keys and mark
what is wrong.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from framekit.cli.common import VerbError, WordsError, in_words, near, print_json, why_not


def add_new_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", choices=("protocol",), help="protocol: a package with a definition, cases and a test")
    parser.add_argument("name", metavar="NAME", help="name of the protocol, such as acme-meter")
    parser.add_argument("-o", "--output", metavar="FOLDER", type=Path, help="where to write it; default: framekit-NAME")


def run_new(arguments: argparse.Namespace) -> int:
    from framekit.api.new_files import new_protocol

    folder = arguments.output or Path(f"framekit-{arguments.name}")
    with in_words():
        try:
            written = new_protocol(arguments.name, folder)
        except OSError as error:
            raise VerbError(why_not(error)) from None
    for path in written:
        print(near(str(path)))
    return 0


def add_import_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", type=Path, help="a protocol file of EPICS StreamDevice")
    parser.add_argument("-o", "--output", metavar="NAME.yaml", type=Path, help="where; default: beside FILE")
    parser.add_argument("--strict", action="store_true", help="exit status 1 if something is left out")


def run_import(arguments: argparse.Namespace) -> int:
    from framekit.api.streamdevice import from_streamdevice

    place = arguments.output or arguments.file.with_suffix(".yaml")
    name = place.name.partition(".")[0]
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", name):
        raise WordsError(f"'{name}' is no name of a protocol – give one of letters, digits, _ and - with -o NAME.yaml")
    if place.exists() and arguments.output is None:
        raise WordsError(f"{near(str(place))} is there already – name another file with -o")
    try:
        text = arguments.file.read_text("utf-8", errors="replace")
    except OSError as error:
        raise WordsError(why_not(error)) from None
    made = from_streamdevice(text, str(arguments.file), name)
    try:
        place.write_text(made.text, "utf-8")
    except OSError as error:
        raise VerbError(why_not(error)) from None
    for problem in made.left_out:
        print(problem, file=sys.stderr)
    print(f"{near(str(place))} is written – framekit check {near(str(place))}")
    return 1 if arguments.strict and made.left_out else 0


def add_schema_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("kind", metavar="KIND", nargs="?", help="protocol, run, device …; default: one for all files")
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="where to write it; default: standard output")
    parser.add_argument(
        "--vscode", metavar="FILE", type=Path, nargs="?", const=Path(".vscode/framekit.schema.json"),
        help="write the schema of all files there, and print the settings of Visual Studio Code; "
        "default: .vscode/framekit.schema.json",
    )  # fmt: skip


def run_schema(arguments: argparse.Namespace) -> int:
    import json

    from framekit.api.new_files import schema, settings_of_vscode

    with in_words():
        whole = schema(arguments.kind)
    place = arguments.vscode or arguments.output
    if place is None:
        print_json(whole)
        return 0
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(json.dumps(whole, ensure_ascii=False, indent=1) + "\n", "utf-8")
    except OSError as error:
        raise VerbError(why_not(error)) from None
    if arguments.vscode is None:
        print(near(str(place)))
    else:
        print_json(settings_of_vscode(place))
    return 0
