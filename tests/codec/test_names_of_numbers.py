"""Names of numbers: of fields and bits, in frames and inner frames; accepted by encode, shown by decode."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.cli.main import main

TEXT = """\
protocol: named
frames:
  inside: {from: none, body: [{field: kind, type: u8, values: {1: one, 2: two}}]}
  around:
    body:
      - {const: 01}
      - {bits: {mode: 0-1, on: 7}, of: u8, values: {mode: {0: off, 1: slow, 2: fast}}}
      - {inner: p, of: inside}
  other: {body: [{const: 02}, {inner: p, of: inside}, {field: kind, type: u8, values: {1: single}}]}
"""


@pytest.fixture
def file(tmp_path: Path) -> str:
    (tmp_path / "named.yaml").write_text(TEXT, encoding="utf-8")
    return str(tmp_path / "named.yaml")


def test_names_are_given_and_shown(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["encode", file, "around", "mode=fast", "on=1", 'p={"inside": {"kind": "two"}}']) == 0
    assert capsys.readouterr().out == "01 82 02\n"
    assert main(["decode", file, "01 82 02"]) == 0
    rows = [line.split(maxsplit=3) for line in capsys.readouterr().out.splitlines()]
    assert [row[-1] for row in rows if row[0] in ("mode", "on", "p.inside.kind")] == ["2 (fast)", "1", "2 (two)"]
    assert main(["decode", file, "--json", "01 83 02"]) == 0
    assert '"mode": 3' in capsys.readouterr().out


def test_names_that_differ_are_not_shown(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["decode", file, "02 01 01"]) == 0
    assert "(one)" not in capsys.readouterr().out


def test_a_name_that_bits_do_not_have(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["encode", file, "around", "mode=fats", "on=1", 'p={"inside": {"kind": "two"}}']) != 0
    assert "give 0 (off), 1 (slow) or 2 (fast)" in capsys.readouterr().err
