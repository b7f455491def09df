"""Editors: the independent yaml-language-server accepts all shipped files with our schema, and completes keys.

Skipped only if the program is not installed (`npm install -g yaml-language-server`).
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from editors.language_server import LanguageServer

from framekit.api.new_files import schema

PROGRAM = shutil.which("yaml-language-server")
ROOT = Path(__file__).parents[2]
FILES = sorted([*ROOT.glob("frames/**/*.yaml"), *ROOT.glob("examples/**/*.yaml")])
FEW = [path for path in FILES if path.stem in ("cobs", "modbus-rtu", "modbus-rtu.vectors", "scale.device", "scale.run")]
pytestmark = pytest.mark.skipif(PROGRAM is None, reason="yaml-language-server is not installed")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LanguageServer]:
    path = tmp_path_factory.mktemp("schema") / "framekit.schema.json"
    path.write_text(json.dumps(schema()), "utf-8")
    assert PROGRAM is not None
    with LanguageServer(PROGRAM, path) as one:
        yield one


def complaints(server: LanguageServer, files: list[Path]) -> list[str]:
    return [
        f"{path.name}:{problem['range']['start']['line'] + 1}: {problem['message']}"
        for path in files
        for problem in server.problems(path.as_uri(), path.read_text("utf-8"))
    ]


def test_it_has_nothing_against_sound_files(server: LanguageServer) -> None:
    assert len(FEW) == 5
    assert complaints(server, FEW) == []


@pytest.mark.long
def test_it_has_nothing_against_any_shipped_file(server: LanguageServer) -> None:
    assert len(FILES) > 100
    assert complaints(server, FILES) == []


def test_it_tells_a_misspelt_key(server: LanguageServer) -> None:
    (one,) = server.problems("file:///wrong.yaml", "protocol: a\nframs: {}\n")
    assert "frams" in one["message"] and one["range"]["start"] == {"line": 1, "character": 0}


@pytest.mark.parametrize(
    ("name", "text", "offered"),
    [
        ("a.yaml", "protocol: a\nfr|\n", {"frames", "framekit"}),
        ("b.yaml", "protocol: a\nframes:\n  A:\n    body:\n      - fi|\n", {"field", "const", "check"}),
        ("c.yaml", "protocol: a\nframes:\n  A:\n    body:\n      - field: a\n        ty|\n", {"type", "size"}),
        ("d.run.yaml", "run: a\nchannels:\n  1:\n    port: a\n    protocol: |\n", {"modbus-rtu", "mldp"}),
        ("e.device.yaml", "device: a\nprotocol: |\n", {"modbus-rtu", "mldp"}),
        ("f.run.yaml", "run: a\nsinks:\n  - |\n", {"csv", "mqtt"}),
    ],
)
def test_it_completes_keys_and_names_of_protocols(
    server: LanguageServer, name: str, text: str, offered: set[str]
) -> None:
    assert offered <= set(server.completions(f"file:///{name}", text))
