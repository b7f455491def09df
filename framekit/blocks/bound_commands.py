"""An application of commands found and bound to the protocol of a channel: what it calls and sets must be there.

It loads definitions; nothing is carried out here.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from framekit.definition.load import load_protocol
from framekit.definition.model.commands import CallOf
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.walk import parts_of
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean


def commands_for(protocol: Protocol, name: str | None, folder: Path, at: Position) -> Protocol:
    """The application of commands of a channel: `name`, else the one its protocol names.

    Raises DefinitionError when there is none, or when it does not fit the protocol.
    """
    wanted = name or protocol.commands_file
    if not wanted:
        what = f"'{protocol.name}' names no application of commands"
        raise DefinitionError([Problem(at, what, "add commands: NAME; on a command line --commands NAME")])
    application = load_protocol(_beside(wanted, folder), folder)
    problems = list(misfits(application, protocol, at))
    if problems:
        raise DefinitionError(problems)
    return application


def _beside(name: str, folder: Path) -> str | Path:
    file = folder / name
    return file if file.suffix == ".yaml" and file.is_file() else name


def misfits(application: Protocol, protocol: Protocol, at: Position) -> Iterator[Problem]:
    """Why an application of commands cannot work on a channel that speaks `protocol`."""
    if application.commands is None:
        yield Problem(at, f"'{application.name}' has no command blocks", "name an application with commands:")
        return
    for rows in application.services.values():
        for row in rows:
            yield from _missing(row, application, protocol, at)


def _missing(row: ServiceRow, application: Protocol, protocol: Protocol, at: Position) -> Iterator[Problem]:
    block = None if row.serve is None else row.serve.block
    if block is None:
        return
    whose = f"command '{row.service}' of '{application.name}'"
    for call in parts_of(block.calls, CallOf):
        rows = protocol.services.get(call.service)
        if not rows:
            hint = did_you_mean(call.service, protocol.services)
            yield Problem(at, f"{whose} calls '{call.service}', which '{protocol.name}' has not", hint)
            continue
        taken = {argument.name for one in rows for argument in one.takes}
        for name in call.arguments.keys() - taken:
            hint = did_you_mean(name, taken)
            yield Problem(at, f"{whose} gives '{call.service}' a '{name}', which that does not take", hint)
    for name in block.params.keys() - protocol.params.keys():
        hint = did_you_mean(name, protocol.params)
        yield Problem(at, f"{whose} gives '{protocol.name}' a parameter '{name}', which that has not", hint)
    for kind in ("read", "write"):
        if getattr(block, kind) is not None and kind not in protocol.services:
            yield Problem(at, f"{whose} has {kind}, which '{protocol.name}' has not", "take another application")
