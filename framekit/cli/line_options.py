"""Options of verbs that use one line without a run file: protocol parameters, speed, format, filters."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from framekit.cli.common import assignment
from framekit.cli.main import WrongWords

if TYPE_CHECKING:
    from framekit.definition.model.protocol import Protocol
    from framekit.definition.times import LineFormat
    from framekit.service.frame_log import FrameFilter


def add_line(parser: argparse.ArgumentParser) -> None:
    """--speed and --format."""
    parser.add_argument("--speed", type=int, help="line speed in bits a second; default: the protocol's")
    parser.add_argument("--format", help="data bits, parity and stop bits, such as 8E1; default: the protocol's")


def add_params(parser: argparse.ArgumentParser) -> None:
    """--param NAME=VALUE."""
    parser.add_argument(
        "--param", action="append", default=[], metavar="NAME=VALUE", help="parameter of the protocol; may be repeated"
    )


def add_filter(parser: argparse.ArgumentParser) -> None:
    """--filter, --frame and --bad."""
    parser.add_argument("--filter", default="", metavar="TEXT", help="only what has this in its name, reason or bytes")
    parser.add_argument("--frame-name", default="", metavar="NAME", help="only frames whose name has this in it")
    parser.add_argument("--bad", action="store_true", help="only bad frames and noise")


def line_of(protocol: Protocol, arguments: argparse.Namespace) -> LineFormat | None:
    """Speed and format of the command line, else the protocol's; None on connections. Raises WrongWords."""
    from framekit.definition.times import parse_format

    line = protocol.line
    if line.kind == "stream" and arguments.speed is None and arguments.format is None:
        return None
    try:
        speed = line.speed if arguments.speed is None else arguments.speed
        return parse_format(arguments.format or line.format, speed)
    except ValueError as error:
        raise WrongWords(str(error)) from None


def params_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """The parameters of the command line."""
    return dict(assignment(text) for text in arguments.param)


def filter_of(arguments: argparse.Namespace) -> FrameFilter:
    """What the command line wants to see."""
    from framekit.service.frame_log import FrameFilter

    return FrameFilter(frame=arguments.frame_name, bad_only=arguments.bad, text=arguments.filter)
