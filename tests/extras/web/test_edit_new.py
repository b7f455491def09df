"""New files of the editor: each template is a file without errors, for every shipped protocol."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
import yaml

pytest.importorskip("starlette")

from extras.web.edit_world import LAMP, TOKEN, answer_of, session_of, written
from extras.web.test_edit_sessions import answers_to

from framekit.api.check import check_file
from framekit.extras.web.edit_files import EditedFolder, EditRefusedError

KINDS = ("device", "run", "points")
SHIPPED = answer_of("known", Path("x.yaml"), "")["known"]


def made(folder: Path, kind: str, name: str, of: str = "") -> Path:
    """Write a new file."""
    found = answer_of("new", folder / "x", "", kind=kind, name=name, of=of)
    path = folder / str(found["name"])
    path.write_text(found["text"], "utf-8")
    return path


def errors(path: Path) -> list[str]:
    return [str(problem) for problem in check_file(str(path)).problems if not problem.warning]


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
    """Assert that new files of each kind have no problems."""
    for kind in KINDS:
        found = answer_of("new", folder / "x", "", kind=kind, name=f"a-{kind}", of=protocol)
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
    found = answer_of("trial", run, service="", address="", values="", station="")
    assert "exchanges done" in found["result"] and len(found["frames"]) > 4


@pytest.mark.parametrize(
    ("kind", "name", "of", "why"),
    [
        ("device", "A b", "modbus-tcp", "'A b' cannot name a device"),
        ("device", "a", "modbus-tpc", "there is no definition 'modbus-tpc' – did you mean 'modbus-tcp'"),
        ("device", "a", "", "choose a protocol"),
        ("points", "a", "scpi", "'scpi' has no addresses of values"),
        ("run", "a", "gone.device.yaml", "'gone.device.yaml' is no YAML file of this folder"),
        ("run", "a", "../secret.yaml", "'../secret.yaml' is no YAML file of this folder"),
        ("run", "a", "../secret", "'../secret.yaml' is no YAML file of this folder"),
        ("points", "a", "/etc/passwd", "'/etc/passwd.yaml' is no YAML file of this folder"),
        ("run", "a", "..", "there is no definition '..'"),
        ("run", "a", "modbus-tcp\0", "there is no definition 'modbus-tcp"),
        ("run", "a", "a\\b.device.yaml", "'a\\b.device.yaml' is no YAML file of this folder"),
        ("run", "a", "\ud800.yaml", "'\ud800.yaml' is no YAML file of this folder"),
        ("run", "a", 300 * "x", "a name of 300 characters is too long"),
        ("run", "a", 296 * "x" + ".yaml", "a name of 301 characters is too long"),
        ("faults", "a", "", "there is no kind 'faults'"),
    ],
)  # fmt: skip
def test_what_cannot_be_made_is_refused_in_words(tmp_path: Path, kind: str, name: str, of: str, why: str) -> None:
    assert answer_of("new", tmp_path / "x", "", kind=kind, name=name, of=of)["why"].startswith(why)


def test_a_file_outside_the_folder_gives_neither_values_nor_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their names are a path upwards, an absolute path, a link, and the name of a file in the current folder."""
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(tmp_path)
    secret = written(tmp_path, "password: hunter2\n", "secret")
    device = written(tmp_path, "device: sec\nprotocol: modbus-tcp\nstation: 77\n", "sec.device.yaml")
    (work / "linked.device.yaml").symlink_to(device)
    names = ("../sec.device.yaml", str(device), "linked.device.yaml", "sec.device.yaml", "sec.device", "../secret")
    for of in (*names, str(secret), "secret"):
        found = answer_of("new", work / "x", "", kind="run", name="a", of=of)
        assert "text" not in found and "password" not in found["why"], of


@pytest.mark.parametrize("name", ['a "b".device.yaml', "a: b #c.device.yaml", "a\nb.device.yaml", "$name.device.yaml"])
def test_a_file_name_is_a_text_in_the_new_file(tmp_path: Path, name: str) -> None:
    written(tmp_path, 'device: hall\nprotocol: "b \\"c.yaml"\nstation: 3\n', name)
    written(tmp_path, "protocol: lamp\nextends: modbus-tcp\n", 'b "c.yaml')
    run = made(tmp_path, "run", "plant", name)
    channel = yaml.safe_load(run.read_text("utf-8"))["channels"][1]
    assert channel == {"port": f"sim:{name}", "protocol": 'b "c.yaml', "station": 3}
    assert errors(run) == []
    copied = made(tmp_path, "device", "copy", 'b "c.yaml')
    assert yaml.safe_load(copied.read_text("utf-8"))["protocol"] == 'b "c.yaml' and errors(copied) == []


def test_a_file_of_a_folder_inside_is_named_with_its_path(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    written(tmp_path / "sub", "device: hall\nprotocol: modbus-tcp\n", "hall.device.yaml")
    run = made(tmp_path, "run", "plant", "sub/hall.device.yaml")
    assert errors(run) == [] and '"sim:sub/hall.device.yaml"' in run.read_text("utf-8")


def test_a_run_without_addresses_has_a_memory_of_no_product(tmp_path: Path) -> None:
    run = made(tmp_path, "run", "plant", "scpi")
    memory = yaml.safe_load(run.read_text("utf-8"))["memory"]
    assert list(memory) == ["areas"] and errors(run) == []


def test_a_single_file_is_edited_without_a_look_at_its_neighbours(tmp_path: Path) -> None:
    written(tmp_path, "password: hunter2\n", "secret.yaml")
    (answer,) = answers_to(session_of(written(tmp_path)), {"new": "run", "name": "a", "of": "secret.yaml", "id": 1})
    assert answer["done"] == 1 and "cannot be made here" in answer["why"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of the size of files")
def test_a_failed_write_leaves_no_file(tmp_path: Path) -> None:
    import resource

    folder = EditedFolder(tmp_path)
    handler, limits = signal.signal(signal.SIGXFSZ, signal.SIG_IGN), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limits[1]))
    try:
        with pytest.raises(EditRefusedError, match=r"^lamp.yaml cannot be made: File too large$"):
            folder.make("lamp.yaml", LAMP)
        left = list(tmp_path.iterdir())
        folder.make("short.yaml", "a: 1\n")
        digest = folder.read("short.yaml").digest
        with pytest.raises(EditRefusedError, match=r"^short.yaml cannot be written: File too large$"):
            folder.save("short.yaml", LAMP, digest)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert left == [] and [path.name for path in tmp_path.iterdir()] == ["short.yaml"]
    folder.make("lamp.yaml", LAMP)
    with pytest.raises(EditRefusedError, match="cannot be written in UTF-8"):
        folder.make("other.yaml", "a: \ud800\n")
    assert folder.read("lamp.yaml").text == LAMP and folder.names() == ["lamp.yaml", "short.yaml"]


def test_only_the_token_makes_a_file(tmp_path: Path) -> None:
    new = {"new": "device", "name": "meter", "of": "modbus-tcp", "id": 1}
    (refused,) = answers_to(session_of(tmp_path, "a-wrong-token"), new)
    assert refused == {"done": 1, "why": "only with the token"} and list(tmp_path.iterdir()) == []
    made_one, opened = answers_to(session_of(tmp_path), new, {"open": "meter.device.yaml"})
    assert made_one == {"done": 1, "made": "meter.device.yaml", "files": ["meter.device.yaml"]}
    assert opened["text"] == (tmp_path / "meter.device.yaml").read_text("utf-8")
    (again,) = answers_to(session_of(tmp_path), new)
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
