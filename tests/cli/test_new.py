"""`framekit new protocol`: the created files are valid and run, and no existing file is overwritten."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest

from framekit.cli.main import main


def test_what_is_laid_out_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "protocol", "acme-meter"]) == 0
    written = capsys.readouterr().out.splitlines()
    assert "framekit-acme-meter/pyproject.toml" in written and all((tmp_path / file).is_file() for file in written)
    assert not any("$" in (tmp_path / file).read_text("utf-8") for file in written)
    folder = tmp_path / "framekit-acme-meter" / "framekit_acme_meter"
    for verb in ("check", "test"):
        assert main([verb, str(folder / "acme-meter.yaml")]) == 0
    assert "warning" not in capsys.readouterr().err
    monkeypatch.setenv("FRAMEKIT_PATH", str(folder))
    device = folder / "acme-meter.device.yaml"
    assert main(["read", "acme-meter", "--port", f"sim:{device}", "D0", "-n", "4"]) == 0
    assert capsys.readouterr().out == "D0  100 200 300 400\n"


@pytest.mark.long
def test_its_own_test_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "protocol", "acme-meter"]) == 0
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path / "framekit-acme-meter")]
    done = subprocess.run(tests, cwd=tmp_path, env=dict(os.environ), capture_output=True, text=True)
    assert done.returncode == 0 and "2 passed" in done.stdout, done.stdout


@pytest.mark.parametrize("name", ["Acme", "-a", "a--b", "../a", "a b", "a/b", "", "a" * 41, "1a"])
def test_names_that_cannot_be_one(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) if name.startswith("-") else nullcontext():
        assert main(["new", "protocol", name, "-o", "there"]) != 0
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "mine.txt").write_text("mine", "utf-8")
    assert main(["new", "protocol", "acme", "-o", str(tmp_path / "there")]) == 2
    assert "is there already" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "there").iterdir()] == ["mine.txt"]
    assert main(["new", "protocol", "acme", "-o", str(tmp_path / "there" / "mine.txt" / "x")]) == 1
