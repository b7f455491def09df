"""The shipped protocols in `frames/`, which must all pass the common tests."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

from framekit.definition.problems import DefinitionError
from framekit.definition.sources import find_definition, shipped_definitions
from framekit.definition.vectors import Vectors, read_vectors

FRAMES = Path(__file__).parent.parent / "frames"
EXAMPLES = FRAMES.parent / "examples"


def example_runs() -> list[Path]:
    """Return the run files of `examples/` that are tracked by git, without the files that users of the README add."""
    listed = subprocess.run(["git", "ls-files", "-z", "*.run.yaml"], cwd=EXAMPLES, capture_output=True, text=True)
    names = [name for name in listed.stdout.split("\0") if name]
    return sorted(EXAMPLES / name for name in names) or sorted(EXAMPLES.glob("**/*.run.yaml"))


def file_of(name: str) -> Path:
    """Return the shipped file of this name, in any family's folder."""
    found = find_definition(name, FRAMES)
    assert found is not None, name
    return found


def names(first_key: str) -> list[str]:
    """Return the names of the shipped definitions with this first key."""
    found = []
    for path in shipped_definitions():
        lines = (line for line in path.read_text(encoding="utf-8").splitlines() if line and not line.startswith("#"))
        if next(lines).startswith(f"{first_key}:"):
            found.append(path.stem)
    return found


PROTOCOLS = names("protocol")
APPLICATIONS = names("application")


@cache
def vectors_of(name: str) -> Vectors:
    """Return the vectors of a shipped protocol, read once per process since searching the cases is slow."""
    return load_vectors(file_of(f"{name}.vectors.yaml"))


def load_vectors(path: Path) -> Vectors:
    """Return the cases of a file. Raises DefinitionError with all its problems."""
    vectors, problems = read_vectors(path)
    if vectors is None or any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return vectors
