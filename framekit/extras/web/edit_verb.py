"""`framekit edit [FILE|FOLDER]`: edit definitions and run files in the browser, next to their meaning."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path

from framekit.cli.common import WordsError, add, begin_log, duration_of, on_stop, until
from framekit.cli.live_output import live_output
from framekit.cli.web_option import USUAL, add_web


def add_edit_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "place", metavar="FILE|FOLDER", nargs="?", type=Path, default=Path(),
        help="a YAML file, or a folder with all YAML files in and below it; default: the current folder",
    )  # fmt: skip
    add(parser, "--for")
    add_web(parser)
    add(parser, "--log", "--json")
    parser.set_defaults(web=USUAL)


def run_edit(arguments: argparse.Namespace) -> int:
    place: Path = arguments.place
    if not place.exists():
        raise WordsError(f"there is no file or folder '{place}' – check its name, or make one: framekit new NAME")
    begin_log(arguments.log)
    duration = duration_of(arguments.duration)
    from framekit.extras.web.edit_board import EditBoard
    from framekit.extras.web.edit_files import EditedFolder, EditRefusedError

    try:
        folder = EditedFolder(place)
    except EditRefusedError as error:
        raise WordsError(str(error)) from None
    from framekit.extras.web.web_page import WebPage

    page = WebPage(arguments)
    board = EditBoard(folder)

    async def shown() -> None:
        ended = asyncio.Event()
        on_stop(ended.set)
        live.stops(ended.set)
        async with page.shows(board, to="edit and save"):
            await until(duration, ended)

    with live_output(arguments.json) as live:
        asyncio.run(shown())
    return 0
