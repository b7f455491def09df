"""Search path of definitions: FRAMEKIT_PATH, --path, installed packages, `../`; and the version of the language."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from framekit.cli.main import main
from framekit.definition import PATH_VARIABLE
from framekit.definition.load.protocol import load_protocol
from framekit.definition.problems import DefinitionError
from framekit.definition.sources import searched_folders

LAMP = "protocol: {name}\nframes: {{SWITCH: {{from: client, body: [{{const: {byte}}}]}}}}\n"


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")
    return path


def byte_of(name: str) -> str:
    return str(load_protocol(name).frames["SWITCH"].body[0])


def test_folders_of_the_path_are_searched_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder, byte in (("one", "01"), ("two", "02")):
        write(tmp_path / folder / "lamp.yaml", LAMP.format(name="lamp", byte=byte))
    write(tmp_path / "two" / "family" / "bell.yaml", LAMP.format(name="bell", byte="03"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DefinitionError, match="there is no definition 'lamp'"):
        load_protocol("lamp")
    monkeypatch.setenv(PATH_VARIABLE, os.pathsep.join([str(tmp_path / "one"), "", str(tmp_path / "two"), "/none"]))
    assert load_protocol("lamp").frames["SWITCH"].at.file == str(tmp_path / "one" / "lamp.yaml")
    assert load_protocol("bell").frames["SWITCH"].at.file.endswith("family/bell.yaml")
    monkeypatch.setenv(PATH_VARIABLE, str(tmp_path / "two"))
    assert load_protocol("lamp").frames["SWITCH"].at.file == str(tmp_path / "two" / "lamp.yaml")


def test_a_folder_of_an_unknown_user_holds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PATH_VARIABLE, "~nobody-of-that-name/x")
    with pytest.raises(DefinitionError, match="there is no definition 'lamp'"):
        load_protocol("lamp")


def test_a_new_folder_of_the_path_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PATH_VARIABLE, str(tmp_path))
    assert tmp_path in list(searched_folders())
    before = tmp_path.stat().st_mtime_ns
    (tmp_path / "family").mkdir()
    os.utime(tmp_path, ns=(before + 1, before + 1))
    assert tmp_path / "family" in list(searched_folders())


def test_the_option_counts_for_one_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "one" / "lamp.yaml", LAMP.format(name="lamp", byte="01"))
    write(tmp_path / "two" / "bell.yaml", LAMP.format(name="bell", byte="03"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(PATH_VARIABLE, str(tmp_path / "two"))
    assert main(["--path", "one", "encode", "lamp", "SWITCH"]) == 0 and capsys.readouterr().out == "01\n"
    assert main(["--path=two", "--path", "one", "encode", "lamp", "SWITCH"]) == 0 and capsys.readouterr().out == "01\n"
    assert main(["--path=one", "encode", "bell", "SWITCH"]) == 0 and capsys.readouterr().out == "03\n"
    assert os.environ[PATH_VARIABLE] == str(tmp_path / "two")
    assert main(["encode", "lamp", "SWITCH"]) == 2
    monkeypatch.delenv(PATH_VARIABLE)
    assert main(["--path", "one", "frames", "lamp"]) == 0 and PATH_VARIABLE not in os.environ


def test_files_of_a_root_name_each_other_upwards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = tmp_path / "root"
    write(root / "common" / "parts.yaml", "application: parts\nlayouts: {place: [{field: at, type: u16}]}\n")
    write(tmp_path / "outside.yaml", "application: outside\n")
    lamp = "protocol: lamp\nuses: [{}]\nframes: {{A: {{body: [{{include: parts.place}}]}}}}\n"
    path = write(root / "acme" / "lamp.yaml", lamp.format("../common/parts.yaml"))
    with pytest.raises(DefinitionError, match=r"leaves the definition's folder .* or --root"):
        load_protocol(path)
    monkeypatch.setenv(PATH_VARIABLE, str(root))
    assert load_protocol(path).frames["A"].body
    for wrong in ("../../outside.yaml", "../../root/../outside.yaml", "../common/../../outside.yaml"):
        write(path, lamp.format(wrong))
        with pytest.raises(DefinitionError, match="leaves the definition's folder"):
            load_protocol(path)
    write(root / "acme" / "parts.yaml", "application: parts\n")
    write(path, lamp.format("parts, ../common/parts.yaml"))
    with pytest.raises(DefinitionError, match="there are two files 'parts' in uses"):
        load_protocol(path)
    (root / "common" / "parts.yaml").unlink()
    (root / "common" / "parts.yaml").symlink_to(tmp_path / "outside.yaml")
    write(path, lamp.format("../common/parts.yaml"))
    with pytest.raises(DefinitionError, match="leaves the definition's folder"):
        load_protocol(path)


def installed(folder: Path, distribution: str, points: str) -> None:
    """Write the metadata of an installed package with entry points."""
    info = folder / f"{distribution}-1.0.dist-info"
    write(info / "METADATA", f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
    write(info / "entry_points.txt", f"[framekit.protocols]\n{points}\n")


@pytest.mark.long
def test_protocols_of_installed_packages_are_found_and_not_imported(tmp_path: Path) -> None:
    site = tmp_path / "site"
    installed(site, "acme", "lamp = acme_frames\nbell = acme_more:data.frames\ngone = not_there\n")
    installed(site, "broken", "one = foo bar!\ntwo =\nthree = ../x\nfour = .x\n")
    write(site / "acme_frames" / "__init__.py", "raise SystemExit('imported')\n")
    write(site / "acme_frames" / "lamp.yaml", LAMP.format(name="lamp", byte="01"))
    write(site / "acme_frames" / "modbus-rtu.yaml", LAMP.format(name="modbus-rtu", byte="EE"))
    write(site / "acme_more" / "data" / "frames" / "bell.yaml", LAMP.format(name="bell", byte="03"))
    environment = {**os.environ, "PYTHONPATH": str(site), "FRAMEKIT_CACHE": ""}

    def output_of(*words: str) -> str:
        command = [sys.executable, "-m", "framekit", *words]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert output_of("encode", "lamp", "SWITCH") == "01\n" and output_of("encode", "bell", "SWITCH") == "03\n"
    assert "request_adu" in output_of("frames", "modbus-rtu"), "a package does not stand in for a shipped definition"
    listed = output_of("frames")
    assert " lamp " in listed and " bell " in listed


def test_the_version_of_the_language_is_checked(tmp_path: Path) -> None:
    lamp = LAMP.format(name="lamp", byte="01")
    assert load_protocol(write(tmp_path / "a.yaml", f"framekit: 1\n{lamp}")).name == "lamp"
    assert load_protocol(write(tmp_path / "b.yaml", f"{lamp}framekit: 1\n")).name == "lamp"
    with pytest.raises(DefinitionError, match=r"c.yaml:1:11: this is version 2 of the language – install a newer"):
        load_protocol(write(tmp_path / "c.yaml", f"framekit: 2\n{lamp}"))
    with pytest.raises(DefinitionError, match=r"'1\.0' is no version of the language – write framekit: 1"):
        load_protocol(write(tmp_path / "d.yaml", f"framekit: 1.0\n{lamp}"))
    for strange in ("²", "9" * 6000, "-1", "''"):
        with pytest.raises(DefinitionError, match="no version of the language"):
            load_protocol(write(tmp_path / "strange.yaml", f"framekit: {strange}\n{lamp}"))
    with pytest.raises(DefinitionError, match="no version of the language"):
        load_protocol(write(tmp_path / "e.yaml", f"framekit: [1]\n{lamp}"))
    both = write(tmp_path / "f.yaml", f"framekit: 2\n{lamp}framez: 1\n")
    with pytest.raises(DefinitionError, match=r"(?s)version 2.*unknown key 'framez'"):
        load_protocol(both)


def test_a_newer_file_is_told_of_every_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text in ("run: a\n", "device: a\nprotocol: modbus-rtu\n", "memory: a\n", "faults: a\n"):
        assert main(["check", str(write(tmp_path / "x.yaml", f"framekit: 9\n{text}"))]) == 1
        assert "version 9 of the language" in capsys.readouterr().err


@pytest.mark.parametrize("mark", ["pyproject.toml", ".git", "framekit.yaml", "--root"])
def test_files_of_a_project_name_each_other_upwards(
    mark: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run in `runs/` may refer to devices, points, memory and faults of its project, but to no file outside of it."""
    project, device = tmp_path / "project", "device: lamp\nprotocol: modbus-tcp\nstation: 1\n"
    write(
        project / "devices" / "lamp.device.yaml",
        "device: lamp\nprotocol: modbus-tcp\nstation: 1\nmemory: {sizes: {}}\n",
    )
    write(project / "lists" / "lamp.points.yaml", 'points: lamp\nvalues: {level: {address: "40001"}}\n')
    write(tmp_path / "outside.device.yaml", device)
    run = (
        "run: lamp\nchannels:\n  1: {{port: 'sim:{}', protocol: modbus-tcp, station: 1}}\n"
        "points: [{{file: ../lists/lamp.points.yaml, channel: 1}}]\n"
    )
    path = write(project / "runs" / "lamp.run.yaml", run.format("../devices/lamp.device.yaml"))
    assert main(["check", str(path)]) == 1
    assert "'../devices/lamp.device.yaml' leaves the run's folder" in capsys.readouterr().err
    before: list[str] = []
    if mark == "--root":
        before = ["--root", str(project)]
    elif mark == ".git":
        (project / mark).mkdir()
    else:
        write(project / mark, "")
    assert main([*before, "check", str(path)]) == 0
    write(path, run.format("../../outside.device.yaml"))
    assert main([*before, "check", str(path)]) == 1
    assert "'../../outside.device.yaml' leaves the run's folder" in capsys.readouterr().err
