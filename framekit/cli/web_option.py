"""The option `--web`: show a run, devices or another work in a browser; the page is an extra."""

from __future__ import annotations

import argparse
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from framekit.cli.common import WordsError
from framekit.table_of_extras import OPTIONS, load

if TYPE_CHECKING:
    from framekit import AsyncServer
    from framekit.api.run import OnSeen, RunCalls, Tape

USUAL = "127.0.0.1:8040"


def add_web(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--web", nargs="?", const=USUAL, metavar="ADDRESS:PORT", type=_no_file,
        help=f"show a page in the browser; default: {USUAL}, port 0 takes a free one; needs the extra 'web'",
    )  # fmt: skip
    parser.add_argument(
        "--web-token", metavar="env:NAME|file:NAME",
        help="variable or file with the token for firing and writing; default: a new token, printed at the start",
    )  # fmt: skip


def _no_file(text: str) -> str:
    """Return the value of `--web`; refuse a file that was meant as the run. Raises ArgumentTypeError."""
    if text.endswith((".yaml", ".yml")):
        raise argparse.ArgumentTypeError(f"'{text}' is no place to listen on – write files before --web")
    return text


class NoPage:
    """The absent page of a command line without `--web`; the page of the extra overrides every method."""

    switches_faults = False
    """Whether the page can switch faults of simulated devices on and off."""

    def monitor(self, tape: Tape | None) -> OnSeen | Tape | None:
        """Return the monitor of a run, given the tape for the terminal."""
        return tape

    @asynccontextmanager
    async def of_run(self, run: RunCalls) -> AsyncIterator[None]:
        """Show a run, not yet started, while the context lasts."""
        yield

    def watch(self, devices: AsyncServer) -> None:
        """Show the traffic of devices, not yet opened, in addition to their monitor."""

    @asynccontextmanager
    async def of_devices(self, devices: AsyncServer) -> AsyncIterator[None]:
        """Show open devices while the context lasts."""
        yield


def page_of(arguments: argparse.Namespace) -> NoPage:
    """Return the page that the command line asks for. Raises WordsError, VerbError."""
    if arguments.web is not None:
        make: Callable[[argparse.Namespace], NoPage] = load(OPTIONS["--web"])
        return make(arguments)
    if arguments.web_token is not None:
        raise WordsError("--web-token has no effect without --web")
    return NoPage()
