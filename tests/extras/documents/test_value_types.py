"""Types of decoded values: they describe every frame of the vectors, and the TypeScript compiler accepts them."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

import framekit
from framekit.api.vectors import vectors_path
from framekit.cli.main import main
from framekit.codec.errors import FrameError
from framekit.codec.plain import PlainValues
from framekit.definition.load.protocol import definition_path, load_protocol, load_protocol_text
from framekit.definition.sources import shipped_definitions
from framekit.definition.vectors import read_vectors
from framekit.extras.documents.value_types import json_schema, typescript

NAMES = [path.stem for path in shipped_definitions() if "." not in path.stem]
QUICK = ("modbus-rtu", "mldp", "m-bus", "nmea0183", "osdp")
TSC = shutil.which("tsc")


def frames_of(name: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the decoded good frames of the vectors, as `decode --json` prints them."""
    path = vectors_path(definition_path(name))
    vectors = read_vectors(path)[0] if path.is_file() else None
    plain, codec, found = PlainValues(load_protocol(name)), framekit.load(name), []
    for case in () if vectors is None else vectors.frames:
        if case.frame is None or case.expect is not None or case.wire.exact is None or case.params or case.state:
            continue
        try:
            decoded = codec.decode(case.wire.exact, case.frame)
        except FrameError:
            continue  # a frame that needs a value announced by a request
        found.append((case.frame, json.loads(json.dumps(plain.to_plain(case.frame, decoded.fields)))))
    return found


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.long) for name in NAMES]
)
def test_frames_of_the_vectors_are_what_the_schema_says(name: str) -> None:
    schema = json_schema(load_protocol(name))
    Draft202012Validator.check_schema(schema)
    for frame, fields in frames_of(name):
        one = {"$ref": f"#/$defs/{frame}", "$defs": schema["$defs"]}
        errors = [error.message for error in Draft202012Validator(one).iter_errors(fields)]
        assert errors == [], (frame, fields)


def test_there_are_frames_to_look_at() -> None:
    assert all(len(frames_of(name)) >= 3 for name in QUICK)


HOSTILE = """
protocol: hostile
about: "*/ ` ${x} \\u0000"
frames:
  A-1: {body: [{field: constructor, type: u8, doc: "*/ } alert(1)"}, {bits: {low: 0-3, high: 4-7}, of: u8}]}
  A_1: {body: [{const: STX}, {field: Decoded, type: i64}, {field: t, type: decimal, decimals: 1, end: 0D}]}
  Decoded: {body: [{const: SOH}, {repeat: r, times: 2, of: [{field: v, type: f32}]}]}
"""


def typescript_of(names: list[str], folder: Path) -> list[Path]:
    """Write a module per protocol, with the decoded frames of its vectors as typed values."""
    found = []
    for name in names:
        text = typescript(load_protocol(name))
        shown = [json.dumps({"frame": frame, "fields": fields}) for frame, fields in frames_of(name)]
        inner = {frame.name for frame in load_protocol(name).frames.values() if frame.inner}
        on_line = [text for text in shown if json.loads(text)["frame"] not in inner]
        text += f"export const examples: Decoded[] = [{','.join(on_line)}];\n"
        found.append(folder / f"{name}.ts")
        found[-1].write_text(text, "utf-8")
    return found


def compiled(files: list[Path]) -> str:
    command = [TSC or "", "--noEmit", "--strict", "--target", "es2020", *map(str, files)]
    return subprocess.run(command, capture_output=True, text=True).stdout


@pytest.mark.long
@pytest.mark.skipif(TSC is None, reason="typescript is not installed")
def test_the_compiler_of_typescript_takes_all_frames(tmp_path: Path) -> None:
    (tmp_path / "hostile.ts").write_text(typescript(load_protocol_text(HOSTILE)), "utf-8")
    assert compiled([*typescript_of(NAMES, tmp_path), tmp_path / "hostile.ts"]) == ""
    wrong = tmp_path / "wrong.ts"
    wrong.write_text(f"import {{Decoded}} from './{NAMES[0]}';\nexport const x: Decoded = {{frame: 'no'}};\n", "utf-8")
    assert "error TS" in compiled([wrong])


def test_names_of_a_file_stay_text() -> None:
    protocol = load_protocol_text(HOSTILE)
    text = typescript(protocol)
    assert "alert" not in text and "${x}" not in text and text.count("export interface ") == 3
    assert len(set(text.split("export interface ")[1:])) == 3
    Draft202012Validator.check_schema(json_schema(protocol))


def test_the_command_prints_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["generate", "jsonschema", "modbus-rtu"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "modbus-rtu"
    assert main(["generate", "typescript", "modbus-rtu"]) == 0
    assert "export interface RequestAdu {" in capsys.readouterr().out
