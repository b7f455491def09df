"""`framekit completion SHELL`: a script that completes framekit's command line in that shell."""

from __future__ import annotations

import argparse

from framekit.cli.main import Failure


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "shell", choices=("bash", "zsh", "tcsh"), help="which shell; put the output where it reads such scripts"
    )


def run(arguments: argparse.Namespace) -> int:
    from framekit.cli.main import build_parser

    try:
        import shtab
    except ImportError:
        raise Failure("completion needs the package shtab – install framekit[completion]") from None
    print(shtab.complete(build_parser(), shell=arguments.shell))
    return 0
