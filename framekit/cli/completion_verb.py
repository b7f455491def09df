"""The verb `completion`: a script that completes the words of framekit in a shell."""

from __future__ import annotations

import argparse
from pathlib import Path

from framekit.cli.common import VerbError
from framekit.cli.parser import build_parser

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
            action.choices = None  # no list in the help
        if action.type is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]  # where shtab looks
    print(shtab.complete(parser, shell=arguments.shell))
    return 0
