"""The systemd unit and the container file of the examples: the files they name exist, and their commands work."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
import venv
from pathlib import Path

import pytest
from docs.pages import ROOT

from framekit.cli.parser import build_parser

UNIT = ROOT / "examples" / "service" / "framekit@.service"
CONTAINER = ROOT / "examples" / "Containerfile"
INSTALLED = "/opt/framekit/bin/framekit"


def command_of(key: str) -> list[str]:
    """Return the words of a command of the unit, for the run `plant`, with the tested framekit as its program."""
    (line,) = [line.partition("=")[2] for line in UNIT.read_text("utf-8").splitlines() if line.startswith(f"{key}=")]
    words = shlex.split(line.replace("%i", "plant"))
    assert words[0] == INSTALLED
    return [sys.executable, "-m", "framekit", *words[1:]]


@pytest.mark.long
def test_what_the_unit_starts_goes_on_until_it_is_stopped(tmp_path: Path) -> None:
    for file in ("third-party-plc.run.yaml", "third-party-plc.device.yaml"):
        shutil.copy(ROOT / "examples" / file, tmp_path / file.replace("third-party-plc.run", "plant.run"))
    settings = os.environ | {"FRAMEKIT_CACHE": ""}
    assert subprocess.run(command_of("ExecStartPre"), cwd=tmp_path, env=settings, capture_output=True).returncode == 0
    with subprocess.Popen(
        command_of("ExecStart"), cwd=tmp_path, env=settings, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "WR.REQ" in line:  # it is running
                break
        process.send_signal(signal.SIGHUP)  # ExecReload
        process.send_signal(signal.SIGTERM)
        output, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")
    assert "line load" in output


def test_systemd_takes_the_unit(tmp_path: Path) -> None:
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed")
    unit = tmp_path / "framekit@plant.service"
    unit.write_text(UNIT.read_text("utf-8").replace(INSTALLED, sys.executable), "utf-8")
    ran = subprocess.run([analyze, "verify", "--man=no", str(unit)], capture_output=True, text=True)
    assert (ran.returncode, [line for line in ran.stderr.splitlines() if unit.name in line]) == (0, [])


# ---- the container ----------------------------------------------------------------------------------------------


def instructions(word: str) -> list[str]:
    """Return the arguments of all instructions of this name in the container file, in order."""
    lines = CONTAINER.read_text("utf-8").splitlines()
    return [line.removeprefix(f"{word} ") for line in lines if line.startswith(f"{word} ")]


def test_the_container_copies_what_the_package_needs_and_starts_a_run() -> None:
    for copied in instructions("COPY"):
        *sources, _ = copied.split()
        assert all((ROOT / source).exists() for source in sources)
    built = {source for copied in instructions("COPY") for source in copied.split()[:-1]}
    assert {"pyproject.toml", "README.md", "framekit", "frames", "schemas", "examples/demo"} <= built
    (entry,), (words,) = (instructions(word) for word in ("ENTRYPOINT", "CMD"))
    assert entry == '["framekit"]'
    parsed = build_parser().parse_args([word.strip('" ') for word in words.strip("[]").split(",")])
    assert (parsed.verb, parsed.run) == ("run", Path("plant.run.yaml"))
    assert instructions("USER") == ["framekit"]


@pytest.mark.long
def test_the_commands_of_the_container_install_framekit(tmp_path: Path) -> None:
    for copied in instructions("COPY"):
        *sources, target = copied.split()
        for source in sources:
            place = tmp_path / target.lstrip("/")
            if (ROOT / source).is_dir():
                shutil.copytree(ROOT / source, place, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                place.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / source, place)
    programs = tmp_path / "venv" / "bin"
    venv.create(programs.parent)
    (programs / "pip").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m pip --python "{programs}/python" "$@"\n')
    (programs / "pip").chmod(0o755)  # installing pip itself would take as long as framekit
    for run in instructions("RUN"):
        words = shlex.split(run.replace("/src", str(tmp_path / "src")))
        if words[0] == "useradd":  # would make a user of this machine
            continue
        here = programs / words[0]
        subprocess.run([str(here) if here.exists() else words[0], *words[1:]], check=True, cwd=tmp_path)
    assert not (tmp_path / "src").exists()
    shown = subprocess.run([programs / "framekit", "check", "modbus-rtu"], capture_output=True, text=True, check=True)
    assert "modbus-rtu" in shown.stdout
