"""The parser of the command line: verbs, their options, and messages for wrong words."""

from __future__ import annotations

import argparse
import importlib
import os
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from framekit import __version__
from framekit.cli.common import WordsError, print_error_data
from framekit.definition import PATH_VARIABLE, ROOT_VARIABLE

VERBS = {
    "demo": "show for half a minute a simulated device, its values and its frames",
    "check": "check definitions and run files",
    "encode": "make the bytes of a frame",
    "decode": "tell which frame some bytes are, and its fields",
    "frames": "list protocols, frames and fields",
    "generate": "write stand-alone code from a definition",
    "test": "run the vectors beside a definition",
    "edit": "edit definitions and run files on a page that shows what they mean",
    "read": "read values of a device",
    "write": "write values into a device",
    "call": "run another service of a device",
    "commreq": "explain or carry out command blocks",
    "run": "carry out a run file",
    "fleet": "list the runs that tell a broker how they are, and roll run files out",
    "serve": "answer requests on a port, with memory",
    "monitor": "listen to a line between others",
    "record": "record the bytes of a line of which nothing is known, or find its speed and format",
    "guess": "say what can be said of an unknown line",
    "diff": "tell which fields differ between two recordings",
    "replay": "send the bytes of a capture again",
    "loopback": "test a port that is wired back to itself",
    "points": "make points of a register list",
    "history": "show the values that a run has kept",
    "new": "lay out a protocol of your own",
    "import": "make a definition of another program's protocol file",
    "schema": "print the schemas of files, and the settings of an editor",
    "completion": "print a shell's completion script",
}

TOGETHER = {
    "device_verbs": ("read", "write", "call"),
    "file_verbs": ("new", "import", "schema"),
    "definition_verbs": ("check", "test", "encode", "frames", "generate"),
    "points_verbs": ("points", "history"),
    "guess_verb": ("guess", "diff"),
    "line_verbs": ("monitor", "replay", "loopback"),
}
"""Modules with several verbs; `run` is in `run_verb`. A module defines `add_VERB_arguments` and `run_VERB`."""

_MESSAGES = (
    (r"^argument (\S+): invalid int value: ('.*')$", r"\1: \2 is not a whole number – write digits, such as 10"),
    (r"^argument (\S+): invalid float value: ('.*')$", r"\1: \2 is not a number – write digits, such as 2.5"),
    (r"^argument (\S+): expected one argument$", r"\1 has no value – write one behind it"),
    (r"^the following arguments are required: VERB$", r"missing: VERB – framekit --help lists the verbs"),
    (r"^the following arguments are required: (.*)$", r"missing: \1 – add what is meant"),
)
"""Messages of argparse, and the same in the words of framekit."""
_NO_VERB = r"argument VERB: invalid choice: '(?P<word>[^']*)'"
_CHOICE = r"invalid choice: '(?P<word>[^']*)' \(choose from (?P<choices>.*)\)"


class HelpText(argparse.HelpFormatter):
    """The formatter of argparse without its import of `shutil`, which every added argument would cause."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=_columns() - 2)


def _columns() -> int:
    """Return the width of the terminal; of other outputs 80."""
    given = os.environ.get("COLUMNS", "")
    if given.isdecimal() and int(given):
        return int(given)
    try:
        return os.get_terminal_size(sys.__stdout__.fileno()).columns or 80 if sys.__stdout__ is not None else 80
    except (ValueError, OSError):
        return 80


class Parser(argparse.ArgumentParser):
    """A parser of the command line or of a verb, with messages in the words of framekit."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, formatter_class=HelpText)
        self.verbs: dict[str, Parser] = {}
        """The parsers of the verbs, by name."""
        self.tells_json = False
        """Print errors as JSON objects too."""
        self.words: Sequence[str] = ()
        """The words of the command line."""

    def error(self, message: str) -> NoReturn:
        """Print an error message and end with status 2."""
        is_missing = message.startswith("the following arguments are required")
        for pattern, own_words in _MESSAGES:
            message = re.sub(pattern, own_words, message)
        if is_missing and (unknown := self._unknown(self.words)):  # perhaps the missing one, misspelt
            message = "; ".join([*unknown, message])
        match = re.search(_CHOICE, message)
        if (verb := re.match(_NO_VERB, message)) is not None:
            near = _near(verb["word"], list(VERBS))
            message = f"there is no verb '{verb['word']}' – {near or 'framekit --help lists the verbs'}"
        elif match is not None:
            near = _near(match["word"], re.findall(r"[^\s',]+", match["choices"]))
            message += f" – {near}" if near else ""
        if self.tells_json:
            print_error_data({"error": WordsError.kind, "message": message})
        super().error(message)

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print help or an error message. Unlike argparse, raise OSError if standard output cannot be written."""
        try:
            print(message, end="", file=file)
        except OSError:
            if file is not sys.stderr:
                raise

    def refuse(self, unknown: Sequence[str]) -> NoReturn:
        """End with a message about words that the parser does not know."""
        messages = self._unknown(unknown)
        self.error("; ".join(messages) or f"nothing takes {', '.join(repr(word) for word in unknown)}")

    def _unknown(self, words: Sequence[str]) -> list[str]:
        """Return a sentence for each word with the form of an option that this parser does not have."""
        known = [option for action in self._actions for option in action.option_strings]
        messages = []
        for word in words:
            option = word.partition("=")[0]
            if option == "--":
                break
            if not re.match(_OPTION, option) or any(one.startswith(option) or one == option[:2] for one in known):
                continue
            near = _MEANT.get(option) or _near(option, known)
            messages.append(f"there is no option '{option}'" + (f" – {near}" if near else ""))
        return messages


_OPTION = r"-[^\s\d.]\S*$"
_MEANT = {
    **dict.fromkeys(("--baud", "--baudrate", "-b"), "write --speed"),
    **dict.fromkeys(("--parity", "--stopbits", "--databits", "--bytesize"), "write --format, such as 8E1"),
    **dict.fromkeys(("--slave", "--unit", "--unit-id", "--address"), "write --station"),
}
"""Options of other programs, and the hint at the option of framekit."""


def _near(word: str, known: Sequence[str]) -> str:
    from framekit.definition.problems import did_you_mean

    hint = did_you_mean(word, known)
    return hint if hint.startswith("did you mean") else ""


def build_parser(only: str | None = None) -> Parser:
    """Return the parser of every verb; of verb `only` alone; or, for '', of all verbs without their options.

    The shorter parsers are made in less time.
    """
    parser = Parser(prog="framekit", description="Protocols of serial field devices in YAML, and run.")
    parser.add_argument("--version", action="version", version=f"framekit {__version__}")
    parser.add_argument(
        "--path", metavar="FOLDER", action="append", help=f"look for definitions there too, as in {PATH_VARIABLE}"
    )
    parser.add_argument(
        "--root", metavar="FOLDER", help=f"files inside this folder may name each other by ../, as with {ROOT_VARIABLE}"
    )
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True, prog="framekit")
    for verb, about in VERBS.items() if not only else [(only, VERBS[only])]:
        one = parser.verbs[verb] = verbs.add_parser(verb, help=about, description=about[0].upper() + about[1:] + ".")
        if only is None or only == verb:
            function_of(verb, f"add_{verb}_arguments")(one)
    return parser


def parse(parser: Parser, words: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """Return the parsed words, and the words without a meaning. Options may stand between positional arguments."""
    parsed, unknown = parser.parse_known_args(words)
    if unknown and not any(word.startswith("-") for word in unknown):
        return parser.verbs[parsed.verb].parse_known_intermixed_args(words[1:], argparse.Namespace(verb=parsed.verb))
    return parsed, unknown


def function_of(verb: str, name: str) -> Callable[[Any], Any]:
    """Import the module of a verb and return its function."""
    module = next((module for module, verbs in TOGETHER.items() if verb in verbs), f"{verb}_verb")
    found: Callable[[Any], Any] = getattr(importlib.import_module(f"framekit.cli.{module}"), name)
    return found
