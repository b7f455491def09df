"""New files of the editor: each template is a file without errors, for every shipped protocol."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("starlette")

from extras.web.edit_world import TOKEN, asked, session_of, written
from extras.web.test_edit_sessions import told

from framekit.api.check import check_file
from framekit.extras.web.edit_files import EditedFolder, EditRefusedError

KINDS = ("device", "run", "points")
SHIPPED = asked("known", Path("x.yaml"), "")["known"]


def made(folder: Path, kind: str, name: str, of: str = "") -> Path:
    """Write a new file."""
    found = asked("new", folder / "x", "", kind=kind, name=name, of=of)
    path = folder / str(found["name"])
    path.write_text(found["text"], "utf-8")
    return path


def errors(path: Path) -> list[str]:
    return [str(one) for one in check_file(str(path)).problems if not one.warning]


def test_a_new_protocol_has_no_errors(tmp_path: Path) -> None:
    path = made(tmp_path, "protocol", "lamp")
    assert path.name == "lamp.yaml" and errors(path) == []
    device = made(tmp_path, "device", "hall", "lamp")
    assert errors(device) == [] and "protocol: lamp" in device.read_text("utf-8")


@pytest.mark.parametrize("protocol", ["modbus-tcp", "modbus-rtu", "snp", "scpi"])
def test_new_files_of_a_protocol_have_no_errors(tmp_path: Path, protocol: str) -> None:
    sound(tmp_path, protocol)


@pytest.mark.long
@pytest.mark.parametrize("protocol", [name for name in SHIPPED if name != "df1"])
def test_new_files_of_every_protocol_have_no_errors(tmp_path: Path, protocol: str) -> None:
    sound(tmp_path, protocol)


def sound(folder: Path, protocol: str) -> None:
    """Compare the problems of new files of each kind with none."""
    for kind in KINDS:
        found = asked("new", folder / "x", "", kind=kind, name=f"a-{kind}", of=protocol)
        if kind == "points" and "why" in found:
            assert found["why"].startswith(f"'{protocol}' has no addresses of values")
            continue
        path = folder / str(found["name"])
        path.write_text(found["text"], "utf-8")
        assert errors(path) == [], found["text"]
    run = made(folder, "run", "b-run", "a-device.device.yaml")
    assert errors(run) == [] and "sim:a-device.device.yaml" in run.read_text("utf-8")


def test_a_run_of_a_new_device_can_be_tried(tmp_path: Path) -> None:
    made(tmp_path, "device", "meter", "modbus-tcp")
    run = made(tmp_path, "run", "plant", "meter.device.yaml")
    found = asked("trial", run, service="", address="", values="", station="")
    assert "exchanges done" in found["result"] and len(found["frames"]) > 4


@pytest.mark.parametrize(
    ("kind", "name", "of", "why"),
    [
        ("device", "A b", "modbus-tcp", "'A b' cannot name a device"),
        ("device", "a", "modbus-tpc", "there is no definition 'modbus-tpc' – did you mean 'modbus-tcp'"),
        ("device", "a", "", "choose a protocol"),
        ("points", "a", "scpi", "'scpi' has no addresses of values"),
        ("run", "a", "gone.device.yaml", "there is no file 'gone.device.yaml'"),
        ("faults", "a", "", "there is no kind 'faults'"),
    ],
)  # fmt: skip
def test_what_cannot_be_made_is_refused_in_words(tmp_path: Path, kind: str, name: str, of: str, why: str) -> None:
    assert asked("new", tmp_path / "x", "", kind=kind, name=name, of=of)["why"].startswith(why)


def test_only_the_token_makes_a_file(tmp_path: Path) -> None:
    new = {"new": "device", "name": "meter", "of": "modbus-tcp", "id": 1}
    (refused,) = told(session_of(tmp_path, "a-wrong-token"), new)
    assert refused == {"done": 1, "why": "only with the token"} and list(tmp_path.iterdir()) == []
    made_one, opened = told(session_of(tmp_path), new, {"open": "meter.device.yaml"})
    assert made_one == {"done": 1, "made": "meter.device.yaml", "files": ["meter.device.yaml"]}
    assert opened["text"] == (tmp_path / "meter.device.yaml").read_text("utf-8")
    (again,) = told(session_of(tmp_path), new)
    assert again["why"] == "meter.device.yaml exists already – open it, or choose another name"


def test_a_new_file_stays_in_the_folder(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    folder = EditedFolder(tmp_path / "in")
    for name in ("../a.yaml", "/tmp/a.yaml", ".a.yaml", "a.txt", "sub/a.yaml", "a\0.yaml"):
        with pytest.raises(EditRefusedError, match="cannot be made here"):
            folder.make(name, "protocol: a\n")
    (tmp_path / "in" / "there.yaml").symlink_to(tmp_path / "out.yaml")
    with pytest.raises(EditRefusedError, match="exists already"):
        folder.make("there.yaml", "protocol: a\n")
    assert not (tmp_path / "out.yaml").exists()
    only = EditedFolder(written(tmp_path))
    with pytest.raises(EditRefusedError, match="cannot be made here"):
        only.make("b.yaml", "protocol: b\n")
    assert TOKEN and sorted(path.name for path in tmp_path.iterdir()) == ["in", "lamp.yaml"]
