"""`framekit test PROTOCOL`: runs the vectors beside a definition, frames and conversations."""

from __future__ import annotations

import argparse
from pathlib import Path

from framekit.cli.common import add_json, add_protocol, near, print_json
from framekit.cli.main import Failure


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_protocol(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from framekit.definition.load.library import definition_path
    from framekit.service.vectors import run_vectors, vectors_path

    results = run_vectors(arguments.protocol, Path.cwd())
    if not results:
        path = definition_path(arguments.protocol, Path.cwd())
        raise Failure(f"there are no vectors beside '{near(str(path))}' – write {near(str(vectors_path(path)))}")
    failed = [result for result in results if result.problems]
    if arguments.json:
        print_json([{"kind": one.kind, "name": one.name, "problems": one.problems} for one in results])
        return int(bool(failed))
    for result in results:
        print(f"{'FAILED' if result.problems else 'ok':<8}{result.kind}: {result.name}")
        for problem in result.problems:
            print(f"        {problem}")
    print(f"{len(results) - len(failed)} passed, {len(failed)} failed")
    return int(bool(failed))
