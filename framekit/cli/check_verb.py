"""`framekit check FILE …`: every problem of definitions, devices, runs, vectors and memory profiles, all at once."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from framekit.cli.common import add_json, near, print_json, told

if TYPE_CHECKING:
    from framekit.definition.problems import Problem


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help="a YAML file, or the name of a shipped protocol")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    results = [(name, *check_file(name)) for name in arguments.files]
    failed = any(not problem.warning for _, _, problems in results for problem in problems)
    if arguments.json:
        print_json(
            [
                {"file": name, "what": what, "problems": [_as_json(one) for one in found]}
                for name, what, found in results
            ]
        )
        return int(failed)
    for name, what, problems in results:
        for problem in problems:
            print(told(problem), file=sys.stderr)
        if not any(not problem.warning for problem in problems):
            print(f"{name}: {what}")
    return int(failed)


def _as_json(problem: Problem) -> dict[str, object]:
    return {
        "file": near(problem.at.file),
        "line": problem.at.line,
        "column": problem.at.column,
        "what": problem.what,
        "todo": problem.todo,
        "warning": problem.warning,
    }


def check_file(name: str) -> tuple[str, list[Problem]]:
    """What a file is, in words, and what is wrong with it."""
    from framekit.definition.load.library import definition_path
    from framekit.definition.nodes import read_nodes
    from framekit.definition.problems import DefinitionError
    from framekit.definition.schema import kind_of

    try:
        path = definition_path(name)
        kind = kind_of(read_nodes(path))
        what, problems = CHECKS[kind](path)
        return what, sorted(problems)
    except DefinitionError as error:
        return "", list(error.problems)


def _protocol(path: Path) -> tuple[str, list[Problem]]:
    from framekit.codec.ambiguity import check_matrices
    from framekit.definition.load import load_protocol
    from framekit.link.address_check import check_addresses

    protocol = load_protocol(path)
    problems = [*protocol.warnings, *check_matrices(protocol)]
    problems += check_addresses(protocol.addresses, protocol.areas, protocol.tables)
    roles = f", roles {', '.join(protocol.roles)}" if protocol.roles else ""
    return f"{protocol.kind} {protocol.name}, {len(protocol.frames)} frames{roles}", problems


def _device(path: Path) -> tuple[str, list[Problem]]:
    from framekit.blocks.device import load_device

    device = load_device(path, path.parent)
    return f"device {device.name} speaking {device.protocol.name}", []


def _run(path: Path) -> tuple[str, list[Problem]]:
    from framekit.blocks.load import load_run
    from framekit.codec.ambiguity import check_matrices
    from framekit.definition.problems import DefinitionError
    from framekit.service.ports import devices_of

    loaded = load_run(path)
    problems: list[Problem] = []
    for channel in loaded.channels.values():
        try:
            devices_of(channel, path.parent)
        except DefinitionError as error:
            problems += error.problems
    for protocol in {id(channel.protocol): channel.protocol for channel in loaded.channels.values()}.values():
        problems += [problem for problem in check_matrices(protocol) if not problem.warning]
    if problems:
        raise DefinitionError(problems)
    return f"run {loaded.name}, {len(loaded.blocks)} blocks on {len(loaded.channels)} channels", list(loaded.warnings)


def _vectors(path: Path) -> tuple[str, list[Problem]]:
    from framekit.definition.check.vectors import check_vectors
    from framekit.definition.load import load_protocol
    from framekit.definition.load.library import definition_path
    from framekit.definition.load.vectors import load_vectors
    from framekit.definition.problems import DefinitionError, Problem

    vectors = load_vectors(path)
    try:
        protocol = load_protocol(definition_path(vectors.protocol, path.parent))
    except DefinitionError as error:
        if error.problems[0].at.file == vectors.protocol:
            what, todo = error.problems[0].what, error.problems[0].todo
        else:
            what, todo = f"the definition of '{vectors.protocol}' is not right", f"framekit check {vectors.protocol}"
        raise DefinitionError([Problem(vectors.protocol_at, what, todo)]) from None
    if problems := check_vectors(vectors, protocol):
        raise DefinitionError(problems)
    return (
        f"vectors of {vectors.protocol}, {len(vectors.frames)} frames, {len(vectors.conversations)} conversations",
        [],
    )


def _memory(path: Path) -> tuple[str, list[Problem]]:
    from framekit.link.address_check import check_addresses
    from framekit.memory.load import load_profile

    profile = load_profile(path)
    problems = check_addresses(profile.addresses, profile.areas, profile.tables)
    return f"memory {profile.name}, {len(profile.areas)} areas", problems


CHECKS = {"protocol": _protocol, "device": _device, "run": _run, "vectors": _vectors, "memory": _memory}
