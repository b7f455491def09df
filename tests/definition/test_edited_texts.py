"""Texts that replace the content of a file: the loaders and the check of every kind of file read them."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.api.check import check_file
from framekit.definition.load.protocol import load_protocol
from framekit.definition.problems import DefinitionError
from framekit.definition.sources import edited_texts

LAMP = """protocol: lamp
frames:
  SWITCH:
    from: client
    body:
      - {const: STX}
      - {field: level, type: u8}
"""
BASED = """protocol: dimmer
extends: lamp
frames:
  DIM:
    body:
      - {const: ETX}
      - {field: level, type: u16}
"""


def test_a_protocol_is_checked_as_the_text_says(tmp_path: Path) -> None:
    path = tmp_path / "lamp.yaml"
    path.write_text(LAMP, "utf-8")
    with edited_texts({path: LAMP.replace("type: u8", "type: u88")}):
        problem = check_file(str(path)).problems[0]
    assert (problem.at, problem.what) == ((str(path), 7, 30), "'u88' is not a type, in frame 'SWITCH'")
    assert check_file(str(path)).problems == []


def test_a_loaded_definition_follows_the_text(tmp_path: Path) -> None:
    path = tmp_path / "lamp.yaml"
    path.write_text(LAMP, "utf-8")
    assert list(load_protocol(path).frames) == ["SWITCH"]
    with edited_texts({path: LAMP.replace("SWITCH", "SET")}):
        assert list(load_protocol(path).frames) == ["SET"]
        with edited_texts({path: LAMP.replace("SWITCH", "PUT")}):
            assert list(load_protocol(path).frames) == ["PUT"]
        assert list(load_protocol(path).frames) == ["SET"]
    assert list(load_protocol(path).frames) == ["SWITCH"]


def test_neighbours_are_found_and_may_be_edited_too(tmp_path: Path) -> None:
    base, path = tmp_path / "lamp.yaml", tmp_path / "dimmer.yaml"
    base.write_text(LAMP, "utf-8")
    path.write_text("", "utf-8")
    with edited_texts({path: BASED}):
        assert list(load_protocol(path).frames) == ["SWITCH", "DIM"]
    with edited_texts({path: BASED, base: LAMP.replace("SWITCH", "SET")}):
        assert list(load_protocol(path).frames) == ["SET", "DIM"]
    with edited_texts({base: "protocol: ["}), pytest.raises(DefinitionError):
        load_protocol(base)


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("a.run.yaml", "run: a\nchanels: {}\n", "unknown key 'chanels' in a run file"),
        ("a.device.yaml", "device: a\nprotocl: modbus-rtu\n", "unknown key 'protocl' in a device file"),
        ("a.points.yaml", "points: a\nvalues: {x: {adress: '40001'}}\n", "unknown key 'adress' in point 'x'"),
    ],
)  # fmt: skip
def test_other_kinds_of_files_are_checked_as_the_text_says(tmp_path: Path, name: str, text: str, what: str) -> None:
    path = tmp_path / name
    path.write_text("", "utf-8")
    with edited_texts({path: text}):
        assert what in [problem.what for problem in check_file(str(path)).problems]
