"""Every key of rich files with wrong values: errors are reported as problems, never as a traceback.

The long test gives most keys one of the twelve kinds of values; `FRAMEKIT_EVERY=1` gives each key all of them.
"""

from __future__ import annotations

import copy
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from errors.mutations import at, dumped, places

from framekit.api.check import check_file

RICH = Path(__file__).parent / "rich"
FILES = ["oven.yaml", "oven.device.yaml", "plant.run.yaml"]
WRONG: list[Any] = [[], {}, None, "", "-1", "nothing", "99999999", ["x"], {"x": "y"}, "1.5", [[]], "0"]
EVERY = 401
"""Step of the samples in the short test; prime, so every kind of value occurs."""
LONG = int(os.environ.get("FRAMEKIT_EVERY", "37"))
"""Step of the samples in the long test."""


def trees(name: str) -> Any:
    return yaml.load((RICH / name).read_text(encoding="utf-8"), Loader=yaml.BaseLoader)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("every", [EVERY, pytest.param(LONG, marks=pytest.mark.long)])
def test_a_wrong_value_is_a_problem(name: str, every: int, tmp_path: Path) -> None:
    shutil.copytree(RICH, tmp_path, dirs_exist_ok=True)
    tree, file = trees(name), tmp_path / name
    cases = [(path, wrong) for path in places(tree) for wrong in WRONG]
    reported = 0
    for path, wrong in cases[::every]:
        changed = copy.deepcopy(tree)
        at(changed, path[:-1])[path[-1]] = wrong
        file.write_text(dumped(changed), encoding="utf-8")
        try:
            problems = check_file(str(file)).problems
        except Exception as error:
            raise AssertionError(f"{name}: {path} = {wrong!r}") from error
        reported += any(not problem.warning for problem in problems)
    assert reported > len(cases[::every]) // 2


@pytest.mark.parametrize("name", FILES)
def test_the_rich_files_are_right(name: str) -> None:
    assert not [str(problem) for problem in check_file(str(RICH / name)).problems if not problem.warning]
