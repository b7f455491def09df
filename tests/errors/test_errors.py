"""Invalid definitions and run files with their exact error messages.

Every file in the folders next to this module begins with comments `# expect: FILE:LINE:COLUMN: what – todo`, one for
every problem, in order. FILE is the file itself; other files are given by name. A file without such comments is valid.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.api import check
from framekit.cli.main import main
from framekit.definition.problems import Problem
from framekit.definition.sources import searched_folders

HERE = Path(__file__).parent
FILES = sorted([*HERE.glob("definitions/*.yaml"), *HERE.glob("runs/*.yaml")])
MARK = "# expect: "


def expected(path: Path) -> list[str]:
    """Return the problems that the head of a file announces."""
    lines = path.read_bytes().decode("utf-8", errors="replace").splitlines()
    return [line.removeprefix(MARK) for line in lines if line.startswith(MARK)]


def as_written(path: Path, problems: list[Problem]) -> list[str]:
    """Return the problems with file names as in the corpus."""
    names = {f"{path.resolve()}:": "FILE:", f"{path}:": "FILE:", f"{path.parent.resolve()}/": ""} | {
        f"{folder}/": "" for folder in searched_folders()
    }
    found = []
    for problem in problems:
        text = str(problem)
        for name, short in names.items():
            text = text.replace(name, short)
        found.append(text)
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_messages_and_exit_status(
    path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    checked = check.check_file(str(path))
    assert as_written(path, checked.problems) == expected(path)
    monkeypatch.setattr(check, "check_file", lambda name: checked)  # the command line shows this result
    wrong = [line for line in expected(path) if ": warning: " not in line]
    assert main(["check", str(path)]) == (1 if wrong else 0)
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err + captured.out
    assert len(captured.err.splitlines()) == len(expected(path))


@pytest.mark.parametrize("stem", ["definitions/yaml-tab", "definitions/names-unknown", "runs/many-at-once"])
def test_the_command_line_from_end_to_end(stem: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = HERE / f"{stem}.yaml"
    assert main(["check", str(path)]) == 1
    assert len(capsys.readouterr().err.splitlines()) == len(expected(path))


def test_there_are_enough_of_them() -> None:
    wrong = [path for path in FILES if expected(path)]
    assert len([path for path in wrong if path.parent.name == "definitions"]) >= 45
    assert len([path for path in wrong if path.parent.name == "runs"]) >= 20
    assert len([path for path in wrong if len(expected(path)) >= 3]) >= 30, "problems of a file come all at once"


def test_every_file_that_is_right_says_so() -> None:
    good = [path for path in FILES if path.stem.startswith("good-")]
    assert good
    assert all(not expected(path) for path in good)
