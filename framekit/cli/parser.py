"""The parser of the command line: verbs, their options, and messages for wrong words."""

from __future__ import annotations

import argparse
import importlib
import os
import re
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NoReturn

from framekit import __version__
from framekit.cli.common import WordsError, print_error_data
from framekit.cli.verb_table import VERBS, examples_of, examples_text, overview
from framekit.definition import PATH_VARIABLE, ROOT_VARIABLE

_MESSAGES = (
    (r"^argument (\S+): invalid int value: ('.*')$", r"\1: \2 is not a whole number – write digits, such as 10"),
    (r"^argument (\S+): invalid float value: ('.*')$", r"\1: \2 is not a number – write digits, such as 2.5"),
    (r"^argument (\S+): expected one argument$", r"\1 has no value – write it after \1"),
    (r"^the following arguments are required: VERB$", r"missing: VERB – framekit --help lists the verbs"),
    (r"^the following arguments are required: (.*)$", r"missing: \1"),
)
"""Messages of argparse, and the same in the words of framekit."""
_NO_VERB = r"argument VERB: invalid choice: '(?P<word>[^']*)'"
_CHOICE = r"invalid choice: '(?P<word>[^']*)' \(choose from (?P<choices>.*)\)"


class HelpText(argparse.HelpFormatter):
    """The formatter of argparse without its import of `shutil`, which every added argument would cause."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=_columns() - 2)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Wrap a paragraph; lines of examples stay as they are."""
        return text if "\n" in text else super()._fill_text(text, width, indent)


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
        self.verb = ""
        """The verb that the parser is for; empty for the parser of the whole command line."""

    def format_help(self) -> str:
        """Return the help text; that of the whole command line lists the verbs by groups."""
        if self.verb:
            self.epilog = examples_text(self.verb)
            return super().format_help()
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        formatter.start_section(self._optionals.title)
        formatter.add_arguments(self._optionals._group_actions)
        formatter.end_section()
        return f"{formatter.format_help()}\n{overview()}"

    def error(self, message: str) -> NoReturn:
        """Print an error message and end with status 2."""
        from framekit.cli.other_words import VERBS_MEANT

        is_missing = message.startswith("the following arguments are required")
        for pattern, own_words in _MESSAGES:
            message = re.sub(pattern, own_words, message)
        if is_missing and self.verb:
            message += f" – for example: {examples_of(self.verb)[0]}"
        if is_missing and (unknown := self._unknown(self.words)):  # perhaps the missing one, misspelt
            message = "; ".join([*unknown, message])
        match = re.search(_CHOICE, message)
        if (verb := re.match(_NO_VERB, message)) is not None:
            near = VERBS_MEANT.get(verb["word"]) or _near(verb["word"], list(VERBS))
            message = f"there is no verb '{verb['word']}' – {near or 'framekit --help lists the verbs'}"
        elif match is not None:
            near = _near(match["word"], re.findall(r"[^\s',]+", match["choices"]))
            message += f" – {near}" if near else ""
        if self.tells_json:
            print_error_data({"error": WordsError.kind, "message": message})
        if is_missing or message.startswith("there is no "):  # the remedy alone, without the usage
            self.exit(2, f"{self.prog}: error: {message}\n")
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
        from framekit.cli.other_words import option_meant

        known = [option for action in self._actions for option in action.option_strings]
        messages = []
        for word in words:
            option = word.partition("=")[0]
            if option == "--":
                break
            if option not in DIGITS and not re.match(_OPTION, option):
                continue
            if any(one.startswith(option) or one == option[:2] for one in known):
                continue
            near = option_meant(self.verb, option, known) or (_near(option, known) if len(option) > 2 else "")
            messages.append(f"there is no option '{option}'" + (f" – {near}" if near else ""))
        return messages


DIGITS = ("-0", "-1")
"""Options of mbpoll that look like numbers; `read` has no negative numbers."""
_OPTION = r"-[^\s\d.]\S*$"


def _near(word: str, known: Sequence[str]) -> str:
    from framekit.definition.problems import did_you_mean

    hint = did_you_mean(word, known)
    return hint if hint.startswith("did you mean") else ""


def build_parser(only: str | None = None) -> Parser:
    """Return the parser of every verb; of verb `only` alone; or, for '', of all verbs without their options.

    The shorter parsers are made in less time.
    """
    parser = Parser(prog="framekit", description="Protocols of serial field devices, described in YAML and run.")
    parser.add_argument("--version", action="version", version=f"framekit {__version__}")
    parser.add_argument(
        "--path", metavar="FOLDER", action="append", help=f"look for definitions there too, as in {PATH_VARIABLE}"
    )
    parser.add_argument(
        "--root", metavar="FOLDER", help=f"files inside this folder may name each other by ../, as with {ROOT_VARIABLE}"
    )
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True, prog="framekit")
    for verb in VERBS if not only else [only]:
        about = VERBS[verb].about
        one = parser.verbs[verb] = verbs.add_parser(verb, help=about, description=about[0].upper() + about[1:] + ".")
        one.verb = verb
        if only is None or only == verb:
            function_of(verb, f"add_{verb}_arguments")(one)
    return parser


def parse(parser: Parser, words: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """Return the parsed words, and the words without a meaning. Options may stand between positional arguments."""
    if words and words[0] == "read":
        digits = [word for before, word in pairwise(words) if word in DIGITS and not before.startswith("-")]
        if digits:
            parser.verbs[words[0]].refuse(digits)
    parsed, unknown = parser.parse_known_args(words)
    if unknown and not any(word.startswith("-") for word in unknown):
        return parser.verbs[parsed.verb].parse_known_intermixed_args(words[1:], argparse.Namespace(verb=parsed.verb))
    return parsed, unknown


def function_of(verb: str, name: str) -> Callable[[Any], Any]:
    """Import the module of a verb and return its function."""
    found: Callable[[Any], Any] = getattr(importlib.import_module(VERBS[verb].module), name)
    return found
