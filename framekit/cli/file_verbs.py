"""Verbs that create files: `framekit new`, a package for a new protocol; `framekit import`, a definition from another
program's protocol file; `framekit schema`, the schemas with which editors complete keys and mark errors.
"""

from __future__ import annotations

import argparse
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
    parser.add_argument("file", metavar="FILE", type=Path, help="such a file, as x.proto; the ending says what it is")
    parser.add_argument("-o", "--output", metavar="NAME.yaml", type=Path, help="where; default: beside FILE")
    parser.add_argument("--strict", action="store_true", help="exit status 1 if something is left out")


def run_import(arguments: argparse.Namespace) -> int:
    from framekit.api.draft import DraftError, protocol_name
    from framekit.api.imports import definition_beside, import_definition
    from framekit.api.replaced_file import replace_whole

    file, place = arguments.file, arguments.output or definition_beside(arguments.file)
    try:
        with in_words():
            made = import_definition(file, protocol_name(place))
        if place.exists() and place.samefile(file):
            raise WordsError(f"{near(str(place))} is the file that is read – name another one with -o")
        if place.exists() and arguments.output is None:
            raise WordsError(f"{near(str(place))} is there already – name another file with -o")
    except DraftError as error:
        raise WordsError(f"{error}; name it with -o") from None
    except OSError as error:
        raise WordsError(why_not(error)) from None
    try:
        replace_whole(place.resolve(), made.text.encode(), place if place.exists() else None)
    except OSError as error:
        raise VerbError(why_not(error, place)) from None
    for problem in made.left_out:
        print(problem, file=sys.stderr)
    print(f"{near(str(place))} is written – framekit check {near(str(place))}")
    return 1 if arguments.strict and any(not problem.warning for problem in made.left_out) else 0


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
        raise VerbError(why_not(error, place)) from None
    if arguments.vscode is None:
        print(near(str(place)))
    else:
        print_json(settings_of_vscode(place))
    return 0
