"""A file that cannot be opened: the reason names the part of the path that is the obstacle."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from points.test_sinks import run_file

from framekit import DefinitionError, VirtualRun
from framekit.cli.main import main
from framekit.run.file_places import obstacle, why_not_opened
from framekit.service.state import StateError, StateFile


def _link(path: Path, target: str) -> None:
    path.symlink_to(target)


PLACES: dict[str, tuple[Callable[[Path], object], str, str]] = {
    "no folder": (lambda at: None, "no/a", "the folder {at}/no does not exist – make the folder"),
    "a file for a folder": (lambda at: (at / "file").touch(), "file/a", "{at}/file is no folder – check the path"),
    "a file above": (lambda at: (at / "file").touch(), "file/b/a", "{at}/file is no folder – check the path"),
    "a link to no folder": (
        lambda at: _link(at / "link", "gone"), "link/a",
        "{at}/link is a link to gone, which does not exist – make the folder",
    ),
    "a link into no folder": (
        lambda at: _link(at / "link", "gone/a"), "link",
        "{at}/link is a link to {at}/gone/a: the folder {at}/gone does not exist – make the folder",
    ),
    "a link to itself": (lambda at: _link(at / "link", "link"), "link", "{at}/link is a link that leads to itself – "),
    "a folder that links to itself": (
        lambda at: _link(at / "link", "link"), "link/a", "{at}/link is a link that leads to itself – mend the link",
    ),
    "a long name": (lambda at: None, "n" * 300, "the name is too long – shorten it"),
}  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("sink", ["csv: {}", "jsonl: {}", "sqlite: {}", 'mqtt: "127.0.0.1:1", store: {}'])
def test_a_sink_names_the_obstacle(tmp_path: Path, place: str, sink: str) -> None:
    make, name, reason = PLACES[place]
    make(tmp_path)
    run = VirtualRun(run_file(tmp_path, f"{{{sink.format(name)}}}"))
    with pytest.raises(DefinitionError) as error:
        run.start()
    run.stop()
    assert reason.format(at=tmp_path) in str(error.value)


@pytest.mark.parametrize("place", PLACES)
def test_the_state_file_names_the_obstacle(tmp_path: Path, place: str) -> None:
    make, name, reason = PLACES[place]
    make(tmp_path)
    with pytest.raises(StateError) as error:
        StateFile(tmp_path / name, "plant", ())
    assert reason.format(at=tmp_path) in str(error.value)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
def test_a_folder_of_the_system_is_not_called_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = VirtualRun(run_file(tmp_path, "{csv: /proc/a.csv}", "{sqlite: /proc/a.db}"))
    with pytest.raises(DefinitionError) as error:
        run.start()
    run.stop()
    assert [str(problem).partition(" written: ")[2] for problem in error.value.problems] == [
        "the folder /proc takes no new files – check the path, or name another file"
    ] * 2
    with pytest.raises(StateError, match="the folder /proc takes no new files"):
        StateFile(Path("/proc/a"), "plant", ())
    assert main(["run", str(run_file(tmp_path, "{csv: a.csv}")), "--for", "1s", "--capture", "/proc/a.pcap"]) == 1
    assert capsys.readouterr().err == "framekit run: /proc/a.pcap: the folder /proc takes no new files\n"


def test_a_folder_that_may_not_be_entered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test may run as an administrator, who has every permission."""
    (tmp_path / "closed").mkdir()
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path / "closed")
    assert obstacle(tmp_path / "closed" / "a") == f"no permission to enter the folder {tmp_path}/closed"


@pytest.mark.parametrize(
    ("number", "is_new", "reason"),
    [
        (errno.EACCES, True, "no permission to make a file in the folder {at}"),
        (errno.EACCES, False, "no permission to write {at}/a"),
        (errno.EROFS, True, "the folder {at} is in a read-only file system"),
        (errno.ENOSPC, True, "No space left on device"),
    ],
)
def test_the_error_of_the_system_gives_the_reason(tmp_path: Path, number: int, is_new: bool, reason: str) -> None:
    if not is_new:
        (tmp_path / "a").touch()
    assert why_not_opened(tmp_path / "a", OSError(number, os.strerror(number))) == reason.format(at=tmp_path)
