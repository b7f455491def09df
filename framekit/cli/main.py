"""`framekit VERB …`: finds the verb, runs it, and turns what goes wrong into a message and an exit status.

0 all right · 1 the thing asked about is wrong or failed · 2 the command line itself is wrong · 3 no answer, no port.
Never a traceback.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from types import ModuleType

from framekit import __version__
from framekit.cli.words import Parser

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
    "serve": "answer requests on a port, with memory",
    "monitor": "listen to a line between others",
    "replay": "send the bytes of a capture again",
    "loopback": "test a port that is wired back to itself",
    "completion": "print a shell's completion script",
}

READS_ITSELF = ("check", "test", "completion", "loopback")
"""Verbs that look at definitions as they are written, or at none: they take nothing from the cache."""


class Failure(Exception):  # noqa: N818 - a message for the user, not a fault of the program
    """What a verb was asked for can't be done; the message says why."""

    status = 1
    """The exit status."""


class WrongWords(Failure):
    """The command line is wrong: an option, a name or a value in it. Nothing was done."""

    status = 2


class NoPort(Failure):
    """The port cannot be opened."""

    status = 3


def build_parser(only: str | None = None) -> Parser:
    """The parser with every verb; or, quicker, with this one alone; or, with '', with all of them by name only."""
    parser = Parser(prog="framekit", description="Protocols of serial field devices in YAML, and run.")
    parser.add_argument("--version", action="version", version=f"framekit {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True, prog="framekit")
    for verb, about in VERBS.items() if not only else [(only, VERBS[only])]:
        one = parser.verbs[verb] = verbs.add_parser(verb, help=about, description=about[0].upper() + about[1:] + ".")
        if only is None or only == verb:
            importlib.import_module(f"framekit.cli.{verb}_verb").add_arguments(one)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the console script; returns the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = build_parser(words[0] if words and words[0] in VERBS else "")
    parsed, unknown = parser.parse_known_args(words)
    if unknown:
        parser.verbs[parsed.verb].refuse(unknown)
    module = importlib.import_module(f"framekit.cli.{parsed.verb}_verb")
    try:
        return _run(module, parsed)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Failure as failure:
        print(f"framekit {parsed.verb}: {failure}", file=sys.stderr)
        return failure.status
    except ValueError as error:
        from framekit.definition.problems import DefinitionError

        if not isinstance(error, DefinitionError):
            raise
        from framekit.cli.common import status_of, told

        print("\n".join(told(problem) for problem in error.problems), file=sys.stderr)
        return status_of(error.problems)


def _run(module: ModuleType, parsed: argparse.Namespace) -> int:
    """Carries a verb out; definitions come from the user's cache folder where that holds them."""
    if parsed.verb in READS_ITSELF:
        return int(module.run(parsed))
    from framekit.codec.stored import kept_library
    from framekit.definition.keeping import kept_by

    with kept_by(kept_library()):
        return int(module.run(parsed))


if __name__ == "__main__":
    sys.exit(main())
