"""Shipped files with random changes: errors are reported as problems, never as a traceback.

The files are small, so hundreds of changes take seconds; FRAMEKIT_MUTATIONS=N makes N changes per file, of all files.
"""

from __future__ import annotations

import os
import random
from pathlib import Path
from typing import Any

import pytest
import yaml
from errors.mutations import dumped, mutated
from shipped import file_of
from spread import spread

from framekit.api.check import check_file
from framekit.definition.sources import shipped_definitions

ROOT = Path(__file__).parents[2]
WANTED = int(os.environ.get("FRAMEKIT_MUTATIONS", "0"))
SMALL = [
    file_of("third-party-plc.yaml"),
    file_of("standard.yaml"),
    file_of("third-party-plc.vectors.yaml"),
    file_of("masterlogic.memory.yaml"),
    ROOT / "examples" / "third-party-plc.run.yaml",
    ROOT / "examples" / "third-party-plc.device.yaml",
    ROOT / "tests" / "errors" / "definitions" / "good-link.yaml",
    ROOT / "tests" / "errors" / "definitions" / "good-device.yaml",
]
ALL = [*shipped_definitions(), *sorted(ROOT.glob("examples/*.yaml")), *SMALL[-2:]]
EACH = WANTED or 26


def beside(source: Path, folder: Path) -> None:
    """Link the other files of the source's folder, which the source may refer to."""
    for other in source.parent.glob("*.yaml"):
        if other != source:
            (folder / other.name).symlink_to(other)


@pytest.mark.parametrize("source", spread(ALL if WANTED else SMALL, 2), ids=lambda path: path.name)
def test_only_problems_come_out(source: Path, tmp_path: Path) -> None:
    beside(source, tmp_path)
    tree: Any = yaml.load(source.read_text(encoding="utf-8"), Loader=yaml.BaseLoader)
    wrong = 0
    for number in range(EACH):
        choose = random.Random(f"{source.name} {number}")
        path = tmp_path / source.name
        path.write_text(dumped(mutated(tree, choose)), encoding="utf-8")
        problems = check_file(str(path)).problems
        assert all(problem.what and problem.at.line > 0 for problem in problems)
        wrong += any(not problem.warning for problem in problems)
    assert wrong > EACH // 3, "most changes break something"
