"""`framekit VERB …`: finds the verb, runs it, and turns what goes wrong into a message and an exit status.

0 all right · 1 the thing asked about is wrong or failed · 2 the command line itself is wrong · 3 no answer, no port.
Never a traceback.
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from framekit import __version__
from framekit.cli.common import VerbError, WordsError, print_json, tell_error, tell_problems
from framekit.definition import PATH_VARIABLE

VERBS = {
    "check": "check definitions and run files",
    "encode": "make the bytes of a frame",
    "decode": "tell which frame some bytes are, and its fields",
    "frames": "list protocols, frames and fields",
    "generate": "write stand-alone code from a definition",
    "test": "run the vectors beside a definition",
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
    "definition_verbs": ("check", "test", "encode", "decode", "frames", "generate"),
    "points_verbs": ("points", "history"),
    "guess_verb": ("guess", "diff"),
    "line_verbs": ("monitor", "replay", "loopback"),
}
"""Verbs that stand in one module; `run` stands in `run_verb`. A module has `add_VERB_arguments` and `run_VERB`."""

READS_ITSELF = ("check", "test", "completion", "record", "loopback", "points", "history", "new", "import", "schema")
"""Verbs that look at definitions as they are written, or at none: they take nothing from the cache."""

_TOLD = [
    (re.compile(one), told)
    for one, told in (
        (r"^argument (\S+): invalid int value: ('.*')$", r"\1: \2 is not a whole number – write digits, such as 10"),
        (r"^argument (\S+): invalid float value: ('.*')$", r"\1: \2 is not a number – write digits, such as 2.5"),
        (r"^argument (\S+): expected one argument$", r"\1 has no value – write one behind it"),
        (r"^the following arguments are required: VERB$", r"missing: VERB – framekit --help lists the verbs"),
        (r"^the following arguments are required: (.*)$", r"missing: \1 – add what is meant"),
    )
]
"""What the standard library says of words, and how it is said here."""
_NO_VERB = re.compile(r"argument VERB: invalid choice: '(?P<word>[^']*)'")
_CHOICE = re.compile(r"invalid choice: '(?P<word>[^']*)' \(choose from (?P<choices>.*)\)")


class Parser(argparse.ArgumentParser):
    """As its base; `verbs` are those that it has, by name. `tells_json`: what is wrong is printed as an object too.

    `words`: those of the command line.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.verbs: dict[str, Parser] = {}
        self.tells_json = False
        self.words: Sequence[str] = ()

    def error(self, message: str) -> NoReturn:
        """Tells what is wrong and ends with status 2."""
        is_missing = message.startswith("the following arguments are required")
        for pattern, told in _TOLD:
            message = pattern.sub(told, message)
        if is_missing and (unknown := self._unknown(self.words)):  # perhaps the missing one, misspelt
            message = "; ".join([*unknown, message])
        match = _CHOICE.search(message)
        if (verb := _NO_VERB.match(message)) is not None:
            near = _near(verb["word"], list(VERBS))
            message = f"there is no verb '{verb['word']}' – {near or 'framekit --help lists the verbs'}"
        elif match is not None:
            near = _near(match["word"], re.findall(r"[^\s',]+", match["choices"]))
            message += f" – {near}" if near else ""
        if self.tells_json:
            print_json({"error": WordsError.kind, "message": message})
        super().error(message)

    def refuse(self, unknown: Sequence[str]) -> NoReturn:
        """Tells that these words have no place here."""
        told = self._unknown(unknown)
        self.error("; ".join(told) or f"nothing takes {', '.join(repr(word) for word in unknown)}")

    def _unknown(self, words: Sequence[str]) -> list[str]:
        """A sentence for each of the words that looks like an option and is none here."""
        known = [option for action in self._actions for option in action.option_strings]
        told = []
        for word in words:
            option = word.partition("=")[0]
            if option == "--":
                break
            if not _OPTION.match(option) or any(one.startswith(option) or one == option[:2] for one in known):
                continue
            near = _MEANT.get(option) or _near(option, known)
            told.append(f"there is no option '{option}'" + (f" – {near}" if near else ""))
        return told


_OPTION = re.compile(r"-[^\s\d.]\S*$")
_MEANT = {
    **dict.fromkeys(("--baud", "--baudrate", "-b"), "write --speed"),
    **dict.fromkeys(("--parity", "--stopbits", "--databits", "--bytesize"), "write --format, such as 8E1"),
    **dict.fromkeys(("--slave", "--unit", "--unit-id", "--address"), "write --station"),
}
"""What other programs call options of framekit."""


def _near(word: str, known: Sequence[str]) -> str:
    from framekit.definition.problems import did_you_mean

    hint = did_you_mean(word, known)
    return hint if hint.startswith("did you mean") else ""


def build_parser(only: str | None = None) -> Parser:
    """The parser with every verb; or, quicker, with this one alone; or, with '', with all of them by name only."""
    parser = Parser(prog="framekit", description="Protocols of serial field devices in YAML, and run.")
    parser.add_argument("--version", action="version", version=f"framekit {__version__}")
    parser.add_argument(
        "--path", metavar="FOLDER", action="append", help=f"look for definitions there too, as in {PATH_VARIABLE}"
    )
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True, prog="framekit")
    for verb, about in VERBS.items() if not only else [(only, VERBS[only])]:
        one = parser.verbs[verb] = verbs.add_parser(verb, help=about, description=about[0].upper() + about[1:] + ".")
        if only is None or only == verb:
            _function(verb, f"add_{verb}_arguments")(one)
    return parser


def _parsed(parser: Parser, words: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """What the words say, and those that have no place. Options may stand between the names of a verb, too."""
    parsed, unknown = parser.parse_known_args(words)
    if unknown and not any(word.startswith("-") for word in unknown):
        return parser.verbs[parsed.verb].parse_known_intermixed_args(words[1:], argparse.Namespace(verb=parsed.verb))
    return parsed, unknown


def fit_output() -> None:
    """Whatever is printed can be written: in UTF-8 into pipes of Windows, elsewhere as the user has chosen."""
    for stream in (sys.stdout, sys.stderr):
        if not isinstance(stream, io.TextIOWrapper) or stream.encoding.lower().replace("-", "") == "utf8":
            continue
        if sys.platform == "win32" and not stream.isatty() and "PYTHONIOENCODING" not in os.environ:
            stream.reconfigure(encoding="utf-8", errors="backslashreplace")
        else:
            stream.reconfigure(errors="backslashreplace")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the console script; returns the exit status."""
    fit_output()
    folders, words = _folders(list(sys.argv[1:] if arguments is None else arguments))
    before = os.environ.get(PATH_VARIABLE)
    if folders:
        os.environ[PATH_VARIABLE] = os.pathsep.join([*folders, *([before] if before else [])])
    try:
        return _main(words)
    finally:
        if folders and before is None:
            del os.environ[PATH_VARIABLE]
        elif before is not None:
            os.environ[PATH_VARIABLE] = before


def _folders(words: list[str]) -> tuple[list[str], list[str]]:
    """The folders of `--path` before the verb, and the other words."""
    folders: list[str] = []
    while words:
        option, equals, folder = words[0].partition("=")
        if option != "--path" or not (equals or len(words) > 1):
            break
        folders.append(folder if equals else words.pop(1))
        del words[0]
    return folders, words


def _main(words: list[str]) -> int:
    """Carries out the words behind the options that come before a verb."""
    parser = build_parser(words[0] if words and words[0] in VERBS else "")
    for one in (parser, *parser.verbs.values()):
        one.tells_json, one.words = "--json" in words, words
    parsed, unknown = _parsed(parser, words)
    if unknown:
        parser.verbs[parsed.verb].refuse(unknown)
    try:
        return _run(parsed)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except VerbError as failure:
        tell_error(parsed, failure.kind, str(failure))
        return failure.status
    except ValueError as error:
        from framekit.definition.problems import DefinitionError

        if not isinstance(error, DefinitionError):
            raise
        return tell_problems(parsed, error.problems)


def _function(verb: str, name: str) -> Callable[[Any], Any]:
    """A function of a verb's module, which is imported now."""
    if verb == "completion":
        return add_completion_arguments if name.startswith("add") else run_completion
    module = next((module for module, verbs in TOGETHER.items() if verb in verbs), f"{verb}_verb")
    found: Callable[[Any], Any] = getattr(importlib.import_module(f"framekit.cli.{module}"), name)
    return found


def _run(parsed: argparse.Namespace) -> int:
    """Carries a verb out; definitions come from the user's cache folder where that holds them."""
    run = _function(parsed.verb, f"run_{parsed.verb}")
    if parsed.verb in READS_ITSELF:
        return int(run(parsed))
    from framekit.codec.cache import definition_cache
    from framekit.definition.sources import cached_by

    with cached_by(definition_cache()):
        return int(run(parsed))


SHELLS = ("bash", "zsh", "tcsh", "fish", "powershell")


def add_completion_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=SHELLS, help="which shell; put the output where it reads such scripts")


def run_completion(arguments: argparse.Namespace) -> int:
    try:
        import shtab
    except ImportError:
        from framekit.definition.problems import library_missing

        raise VerbError(library_missing("completion", "shtab")) from None
    parser = build_parser()
    for action in (action for one in (parser, *parser.verbs.values()) for action in one._actions):
        if isinstance(action.choices, range):
            action.choices = None  # no list for people
        if action.type is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]  # where shtab looks
    print(shtab.complete(parser, shell=arguments.shell))
    return 0


if __name__ == "__main__":
    sys.exit(main())
