"""`framekit check FILE …`: every problem of definitions, devices, runs, vectors, profiles, fault plans, jobs, at once.

For a run it also says how much of their time its channels need. `framekit test PROTOCOL` runs the vectors beside a
definition, frames and conversations.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import VerbError, add, near, print_json, status_of, told_once

if TYPE_CHECKING:
    from framekit.api.check import Checked
    from framekit.definition.problems import Problem


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help="a YAML file, or the name of a shipped protocol")
    parser.add_argument("--load", action="store_true", help="show what each block of a run takes of its channel's time")
    add(parser, "--json")


def run_check(arguments: argparse.Namespace) -> int:
    from framekit.api.check import check_file

    results = [(name, check_file(name)) for name in arguments.files]
    status = status_of(problem for _, checked in results for problem in checked.problems)
    if arguments.json:
        print_json([{"file": name, **_file_as_json(checked)} for name, checked in results])
        return status
    for name, checked in results:
        for line in told_once(checked.problems):
            print(line, file=sys.stderr)
        if not any(not problem.warning for problem in checked.problems):
            print(f"{name}: {checked.what}")
            _show_loads(checked, arguments.load)
    return status


def _show_loads(checked: Checked, in_full: bool) -> None:
    """A line for each channel with cycles; in full, every channel with a table of its blocks."""
    from framekit.cli.run_output import load_line, load_table

    for load in checked.loads:
        if in_full:
            print(f"\n{load_line(load)}\n{load_table(load)}")
        elif load.round:
            print(f"  {load_line(load)}")


def _file_as_json(checked: Checked) -> dict[str, Any]:
    found = {"what": checked.what, "problems": [_as_json(one) for one in checked.problems]}
    if checked.loads:
        from framekit.cli.run_output import load_data

        found["channels"] = [load_data(load) for load in checked.loads]
    return found


def _as_json(problem: Problem) -> dict[str, object]:
    return {
        "file": near(problem.at.file),
        "line": problem.at.line,
        "column": problem.at.column,
        "what": problem.what,
        "todo": problem.todo,
        "warning": problem.warning,
    }


def add_test_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "protocol", "--json")


def run_test(arguments: argparse.Namespace) -> int:
    from framekit.api.vectors import run_vectors, vectors_path
    from framekit.definition.load.protocol import definition_path

    results = run_vectors(arguments.protocol, Path.cwd())
    if not results:
        path = definition_path(arguments.protocol, Path.cwd())
        raise VerbError(f"there are no vectors beside '{near(str(path))}' – write {near(str(vectors_path(path)))}")
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
