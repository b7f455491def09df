"""The output of `framekit schema`: self-contained schemas, for each kind of file and for all kinds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator
from spread import spread

from framekit.api.errors import RequestError
from framekit.api.new_files import kinds, schema
from framekit.cli.main import main

ROOT = Path(__file__).parents[2]


def read_as_yaml(path: Path) -> Any:
    """Return the content of a file as YAML 1.2: the YAML 1.1 words for yes and no are texts."""

    class Loader(yaml.SafeLoader):
        """A loader with the numbers of YAML 1.2."""

    Loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in found if tag.endswith((":int", ":float", ":null"))]
        for first, found in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    return json.loads(json.dumps(yaml.load(path.read_text("utf-8"), Loader)))


@pytest.mark.parametrize("kind", spread([None, *kinds()], 4))
def test_a_schema_stands_alone(kind: str | None) -> None:
    whole = schema(kind)
    Draft202012Validator.check_schema(whole)
    text = json.dumps(whole)
    assert ".schema.json#" not in text and whole["$id"] and whole["title"]


def test_shipped_files_are_of_one_kind() -> None:
    validator = Draft202012Validator(schema())
    for name in ("frames/modbus/modbus-rtu.yaml", "examples/scale.run.yaml", "examples/scale.device.yaml"):
        assert [error.message for error in validator.iter_errors(read_as_yaml(ROOT / name))] == []
    assert list(validator.iter_errors({"protocol": "a", "frams": {}}))
    assert list(validator.iter_errors({"run": "a", "frames": {}}))
    assert list(validator.iter_errors({"something": "else"})) == [], "files of others are left alone"


def test_an_unknown_kind_is_refused() -> None:
    with pytest.raises(RequestError, match="did you mean 'device'"):
        schema("devise")


def test_the_settings_name_the_written_schema(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["schema", "--vscode"]) == 0
    (place,) = json.loads(capsys.readouterr().out)["yaml.schemas"]
    assert json.loads((tmp_path / place).read_text("utf-8")) == schema()
