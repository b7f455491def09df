"""The name that `on_bad` gives to a frame with a wrong check code that may be one of several frames."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.cli.main import main

LINE = """
protocol: line
line: {format: 8E1}
receiver: {gap: 50 ms}
groups:
  any:
    head: [{const: C8}, {length: n, type: u8, of: [type, body], plus: 1}, {field: type, type: u8}]
    tail: [{check: crc8-dvb-s2, over: type..here}]
frames:
  mode:  {group: any, where: {type: 0x21}, body: [{field: mode, type: ascii, end: 00}]}
  other: {group: any, body: [{data: d, size: n - 2}]}
state: {name: {scope: device, type: text}, why: {scope: device, type: text}}
sequences:
  hear:
    steps:
      - {step: idle, receive: [{frame: [FRAMES], then: again}], on_bad: {set: {name: frame, why: cause}, then: again}}
roles: {ear: {lanes: {main: {listen: hear}}}}
"""
VECTORS = """
vectors: line
conversations:
  - name: a wrong check code
    script: [{receive: DATA}, {wait: 1 s}]
    result: {state: {name: NAME, why: check}}
"""


@pytest.mark.parametrize(
    ("frames", "data", "name"),
    [
        ("mode, other", "C8 05 7F 01 02 03 77", "other"),
        ("other, mode", "C8 05 7F 01 02 03 77", "other"),
        ("mode, other", "C8 08 7F 01 02 03 04 05 06 77", "other"),
        ("mode, other", "C8 05 21 41 42 00 77", "mode"),
    ],
)
def test_a_frame_whose_constants_differ_gives_no_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], frames: str, data: str, name: str
) -> None:
    (tmp_path / "line.yaml").write_text(LINE.replace("FRAMES", frames), encoding="utf-8")
    vectors = VECTORS.replace("DATA", data).replace("NAME", name)
    (tmp_path / "line.vectors.yaml").write_text(vectors, encoding="utf-8")
    assert main(["test", str(tmp_path / "line.yaml")]) == 0, capsys.readouterr().out
