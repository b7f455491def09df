"""Standard output and standard error on a full disk: a message and an exit status, never a traceback."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from cli.small_run import DEVICE, RUN
from spread import spread

from framekit.cli.common import why_output_failed

FULL = Path("/dev/full")
REQUEST = ("decode", "modbus-rtu", "01 03 00 00 00 0A C5 CD")
NO_ROOM = "standard output: No space left on device"

pytestmark = pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")


@pytest.fixture(params=["buffered", pytest.param("unbuffered", marks=pytest.mark.long)])
def environment(request: pytest.FixtureRequest) -> dict[str, str]:
    """Return the environment of a program with buffered or unbuffered standard output."""
    others = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return others if request.param == "buffered" else others | {"PYTHONUNBUFFERED": "1"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a run file, a device, and a broken definition."""
    (tmp_path / "far.device.yaml").write_text(DEVICE, "utf-8")
    (tmp_path / "full.run.yaml").write_text(RUN, "utf-8")
    (tmp_path / "broken.yaml").write_text("protocol: [\n", "utf-8")
    return tmp_path


def carried_out(
    folder: Path, environment: dict[str, str], words: Sequence[str], *, output: Path = FULL, errors: Path | None = None
) -> tuple[int, str]:
    """Run a command with its streams in files; return the exit status and the text of standard error."""
    errors = folder / "errors" if errors is None else errors
    with output.open("w") as one, errors.open("w") as other:
        command = [sys.executable, "-m", "framekit.cli.main", *words]
        status = subprocess.run(command, cwd=folder, env=environment, stdout=one, stderr=other, check=False).returncode
    return status, "" if errors == FULL else errors.read_text("utf-8")


OUTPUTS: list[Sequence[str]] = [
    ("--version",),
    ("--help",),
    ("decode", "--help"),
    REQUEST,
    (*REQUEST, "--json"),
    ("check", "modbus-rtu"),
    ("check", "modbus-rtu", "--json"),
    ("frames",),
    ("generate", "python", "modbus-rtu"),
    ("run", "full.run.yaml", "--for", "1s", "--json"),
    ("run", "full.run.yaml", "--for", "1s"),
    ("run", "full.run.yaml", "--for", "1s", "--virtual", "--json"),
]
"""Commands that write to standard output."""


@pytest.mark.parametrize("words", spread([(words,) for words in OUTPUTS], 3), ids=" ".join)
def test_output_that_has_no_room_gives_a_message_and_status_1(
    folder: Path, environment: dict[str, str], words: Sequence[str]
) -> None:
    status, errors = carried_out(folder, environment, words)
    (message,) = [line for line in errors.splitlines() if line.startswith("framekit")]
    assert NO_ROOM in message
    assert message.endswith(" – make room there, or send the output to another place")
    assert "Traceback" not in errors and "Exception ignored" not in errors
    assert status == 1


@pytest.mark.parametrize(
    ("words", "expected", "part"),
    [
        (("run", "--bad", "--json"), 2, "there is no option '--bad'"),
        (("run", "missing.run.yaml", "--json"), 2, "missing.run.yaml"),
        (("decode", "broken.yaml", "00", "--json"), 1, "broken.yaml:2:"),
        (("check", "broken.yaml", "--json"), 1, NO_ROOM),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_an_error_keeps_its_message_and_its_status(
    folder: Path, environment: dict[str, str], words: Sequence[str], expected: int, part: str
) -> None:
    status, errors = carried_out(folder, environment, words)
    assert part in errors
    assert "Traceback" not in errors and "Exception ignored" not in errors
    assert status == expected


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("run", "--bad", "--json"), 2),
        (("decode", "broken.yaml", "00"), 1),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_errors_that_have_no_room_leave_the_output_and_a_status(
    folder: Path, environment: dict[str, str], words: Sequence[str], expected: int
) -> None:
    output = folder / "output"
    status, _ = carried_out(folder, environment, words, output=output, errors=FULL)
    assert status == expected
    assert ("{" in output.read_text("utf-8")) == ("--json" in words)


def test_only_an_error_of_a_disk_is_one_of_standard_output() -> None:
    assert why_output_failed(OSError(errno.ENOSPC, "No space left on device")).startswith("standard output: ")
    assert why_output_failed(ConnectionResetError(errno.ECONNRESET, "it is reset")) == "it is reset"
