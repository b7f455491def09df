"""Verbs that create files: `framekit new`, a package for a new protocol; `framekit import`, a definition or points from
a file of another program; `framekit schema`, the schemas with which editors complete keys and mark errors.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

from framekit.cli.common import VerbError, WordsError, add, existing, in_words, near, print_json, why_not

ORDERS = ("ABCD", "BADC", "CDAB", "DCBA")
"""Orders of the bytes of a number in two words."""


def add_new_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", choices=("protocol",), help="protocol: a package with a definition, cases and a test")
    parser.add_argument("name", metavar="NAME", help="name of the protocol, such as acme-meter")
    parser.add_argument("-o", "--output", metavar="FOLDER", type=Path, help="where to write it; default: framekit-NAME")
    add(parser, "--json")


def run_new(arguments: argparse.Namespace) -> int:
    from framekit.api.new_files import new_protocol

    folder = arguments.output or Path(f"framekit-{arguments.name}")
    with in_words():
        try:
            written = new_protocol(arguments.name, folder)
        except OSError as error:
            raise VerbError(why_not(error)) from None
    if arguments.json:
        print_json({"written": [near(str(path)) for path in written]})
    else:
        print("\n".join(near(str(path)) for path in written))
    return 0


def add_import_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", metavar="FILE", type=Path,
        help="a protocol file (.proto, .ksy), which becomes a definition, or a list of registers (.csv; its first row "
        "names the columns), which becomes points",
    )  # fmt: skip
    parser.add_argument("-o", "--output", metavar="NAME.yaml", type=Path, help="where; default: beside FILE")
    parser.add_argument("--strict", action="store_true", help="exit status 1 if something is left out")
    parser.add_argument(
        "--address", metavar="FORM", help="of a list: how a register is written, {} stands for its number: %%MW{}"
    )
    parser.add_argument("--add", metavar="N", type=int, help="of a list: added to each number, 40001 for those from 0")
    parser.add_argument("--order", choices=ORDERS, help="of a list: order of the bytes of longer numbers")
    add(parser, "--json")


def run_import(arguments: argparse.Namespace) -> int:
    from framekit.api.imports import ProtocolNameError, definition_beside
    from framekit.api.replaced_file import replace_whole

    file, place = arguments.file, arguments.output or definition_beside(arguments.file)
    try:
        with in_words():
            text, messages = _points(arguments, place) if is_list(file) else _definition(arguments, place)
        if place.exists() and place.samefile(file):
            raise WordsError(f"{near(str(place))} is the file that is read – name another one with -o")
        if place.exists() and arguments.output is None:
            raise WordsError(f"{near(str(place))} is there already – name another file with -o")
    except ProtocolNameError as error:
        raise WordsError(f"{error}; name it with -o") from None
    except OSError as error:
        raise WordsError(why_not(error)) from None
    try:
        replace_whole(place.resolve(), text.encode(), place if place.exists() else None)
    except OSError as error:
        raise VerbError(why_not(error, place)) from None
    for message in messages:
        print(message.text, file=sys.stderr)
    left_out = [message.text for message in messages if message.is_left_out]
    if arguments.json:
        notes = [message.text for message in messages if not message.is_left_out]
        print_json({"written": near(str(place)), "left_out": left_out, "notes": notes})
    else:
        print(f"{near(str(place))} is written – framekit check {near(str(place))}")
    return 1 if arguments.strict and left_out else 0


class ImportMessage(NamedTuple):
    """A message about a part of an imported file."""

    text: str
    is_left_out: bool
    """Whether the part is missing in the result."""


def is_list(file: Path) -> bool:
    """Return whether a file is a list of registers."""
    return file.suffix.lower() == ".csv"


def _definition(arguments: argparse.Namespace, place: Path) -> tuple[str, list[ImportMessage]]:
    """Return the text of a definition made of a file, and the messages about its parts."""
    from framekit.api.imports import import_definition, protocol_name

    for option in ("address", "add", "order"):
        if getattr(arguments, option) is not None:
            raise WordsError(f"--{option} is for lists of registers (.csv) – leave it out")
    made = import_definition(arguments.file, protocol_name(place))
    return made.text, [ImportMessage(str(problem), not problem.warning) for problem in made.left_out]


def _points(arguments: argparse.Namespace, place: Path) -> tuple[str, list[ImportMessage]]:
    """Return the text of the points of a list of registers, and the messages about its rows and columns."""
    from framekit.api.points import points_text, read_vendor_table

    form, file = "{}" if arguments.address is None else arguments.address, existing(arguments.file)
    if "{}" not in form:
        raise WordsError(f"--address: '{form}' has no {{}} for the number of the register")
    found = read_vendor_table(file, form, arguments.add or 0, arguments.order)
    messages = [ImportMessage(f"{problem} – left out", True) for problem in found.problems]
    if not found.points:
        raise VerbError("\n".join([f"{file} has no row that can be read", *(message.text for message in messages)]))
    if found.unused:
        messages.append(ImportMessage(f"columns without effect on points: {', '.join(found.unused)}", False))
    return points_text(found, place.name.partition(".")[0], f"framekit import {file.name}"), messages


def add_schema_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("kind", metavar="KIND", nargs="?", help="protocol, run, device …; default: one for all files")
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="where to write it; default: standard output")
    parser.add_argument(
        "--vscode", metavar="FILE", type=Path, nargs="?", const=Path(".vscode/framekit.schema.json"),
        help="write the schema of all files there, and print the settings of Visual Studio Code; "
        "default: .vscode/framekit.schema.json",
    )  # fmt: skip
    add(parser, "--json", help="with -o: print the name of the file as JSON; schemas are JSON anyway")


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
        if arguments.json:
            print_json({"written": near(str(place))})
        else:
            print(near(str(place)))
    else:
        print_json(settings_of_vscode(place))
    return 0
