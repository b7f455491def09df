"""The verb for command blocks: words, or a command with named fields, are explained, or carried out on a port.

Exit status: 0 done, 1 refused, 2 it is no command block, 3 no good answer came.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import load, print_json
from framekit.cli.commreq_words import commands_in, record_of
from framekit.cli.main import WrongWords
from framekit.cli.one_shot import add_line, carry_out
from framekit.definition.model.walk import parts_of
from framekit.link.codes import code_text

if TYPE_CHECKING:
    from framekit.api.client import Client
    from framekit.blocks.command_meaning import Meaning
    from framekit.blocks.commands import CommandBlocks
    from framekit.definition.model.protocol import Protocol

NO_COMMAND = 2
"""Exit status when the words are no command block."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_line(parser, port_required=False)
    parser.add_argument(
        "words",
        nargs="+",
        metavar="WORD",
        help="decimal, 0x… or @FILE; or the name of a command, and FIELD=VALUE …; + and the next command",
    )
    parser.add_argument("--commands", metavar="NAME", help="the application of commands; default: the protocol's")
    parser.add_argument(
        "--set", action="append", default=[], metavar="ADDRESS=VALUE,…", help="own memory; may be repeated"
    )
    parser.add_argument(
        "--for",
        dest="duration",
        metavar="TIME",
        help="end jobs after this time; default: when they are over",
    )
    parser.add_argument("--explain", action="store_true", help="only say what the words mean, as without --port")


def run(arguments: argparse.Namespace) -> int:
    from framekit.blocks.bound_commands import commands_for
    from framekit.definition.problems import Position

    protocol = load(arguments.protocol)
    at = Position(arguments.protocol, 0, 0)
    application = commands_for(protocol, arguments.commands, Path.cwd(), at)
    blocks = _blocks(application, protocol, arguments)
    try:
        records = [record_of(blocks.words, given) for given in commands_in(arguments.words)]
    except ValueError as error:
        print(f"framekit {arguments.verb}: {error}", file=sys.stderr)
        return NO_COMMAND
    if arguments.port is None or arguments.explain:
        return max(explain(blocks, protocol, data, arguments) for data in records)
    return _carry_out(application, protocol, records, arguments)


def _carry_out(application: Protocol, protocol: Protocol, records: list[bytes], arguments: argparse.Namespace) -> int:
    """Carries the commands out until one fails; the exit status."""
    from framekit.cli.commreq_jobs import carry_out_jobs
    from framekit.cli.commreq_run import CommandRun
    from framekit.definition.model.commands import JobWork

    if any(parts_of(dict(application.services), JobWork)):
        return carry_out_jobs(application, protocol, records, arguments)
    if arguments.duration is not None:
        raise WrongWords("--for is for commands that repeat by themselves – leave it out")

    status = 0

    def act(client: Client) -> None:
        nonlocal status
        commands = CommandRun(client, client.command_blocks(application), arguments)
        for data in records:
            status = commands.carry_out(data)
            if status:
                return

    return carry_out(arguments, act, to_station=False) or status


def _blocks(application: Protocol, protocol: Protocol, arguments: argparse.Namespace) -> CommandBlocks:
    """Command blocks on a port that has done nothing yet, over an empty memory."""
    from framekit.blocks.commands import CommandBlocks
    from framekit.blocks.memory_settings import memory_of
    from framekit.codec.codec import compile_protocol
    from framekit.link.frame_vectors import default_line
    from framekit.link.scope import Scope
    from framekit.memory.memory import DeviceMemory

    role = arguments.role or protocol.asking_role
    channel = Scope(protocol, role=role, line=default_line(protocol))
    areas, _ = memory_of(application)
    return CommandBlocks(application, compile_protocol(application), DeviceMemory(areas), channel=channel)


# ---- explaining -------------------------------------------------------------------------------------------


def explain(blocks: CommandBlocks, protocol: Protocol, data: bytes, arguments: argparse.Namespace) -> int:
    """Says what a command block means; the exit status."""
    from framekit.blocks.command_meaning import meaning_of
    from framekit.blocks.command_words import CommandFaultError

    try:
        meaning = meaning_of(blocks.words.read(data), blocks, protocol)
    except CommandFaultError as error:
        print(f"framekit {arguments.verb}: this is no command block: {error}", file=sys.stderr)
        return NO_COMMAND
    if arguments.json:
        print_json(_as_json(meaning))
    else:
        print("\n".join(_lines(meaning)))
    return 0


def _as_json(meaning: Meaning) -> dict[str, Any]:
    return {
        "words": meaning.words, "command": meaning.request, "head": meaning.head, "fields": meaning.fields,
        "does": meaning.does, "status": meaning.status, "refused": meaning.refused, "because": meaning.because,
    }  # fmt: skip


def command_line(meaning: Meaning) -> str:
    """The command with its fields."""
    shown = [
        f"{name} {value}" + (f" ({meaning.names[name]})" if name in meaning.names else "")
        for name, value in meaning.fields.items()
    ]
    return f"command  {meaning.request}: " + ", ".join(shown)


def _lines(meaning: Meaning) -> list[str]:
    lines = ["words    " + " ".join(f"{word:04X}" for word in meaning.words), command_line(meaning)]
    lines += [f"{'' if number else 'does':<9}{line}" for number, line in enumerate(meaning.does)]
    lines.append(f"status   {meaning.status}")
    if meaning.refused:
        lines.append(
            f"refused  {code_text(meaning.refused)} {meaning.because}, by a port that has done nothing yet".rstrip()
        )
    return lines
