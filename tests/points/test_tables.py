"""Register lists of vendors become points, and histories are printed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from framekit.api.points import points_text, read_vendor_table
from framekit.api.run import VirtualRun
from framekit.cli import history_verb
from framekit.cli.main import main
from framekit.definition.problems import DefinitionError
from framekit.runfile.points import load_points

SEMICOLONS = """Model X;Register list;;;;;
Parameter;Register;Data type;Factor;Units;R/W;Page
Inputs;;;;;;
Voltage L1-N;0;FLOAT;;V;R;12
Active power;0x10;INT32;0,001;kW;R;12
Heater mode;200-200;UINT16;1;-;RW;3
Limit;0C9h;INT 16 bit;1/10;°C;R/W;
Serial;100;STRING;;;;
Odd;300;PACKED;1;;R;
Twice;1;u16;x0.5;;R;
Twice;2;u16;0.5;;R;
Loud;3;u16;many;A;R;
???;4;u16;;A;R;
"""


def test_a_list_with_semicolons_and_commas_in_numbers(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text(SEMICOLONS, "cp1252")
    found = read_vendor_table(path, add=40001, order="ABCD")
    assert found.points == {
        "Voltage_L1-N": {"address": "40001", "type": "float32", "unit": "V", "order": "ABCD"},
        "Active_power": {"address": "40017", "type": "int32", "scale": "0.001", "unit": "kW", "order": "ABCD"},
        "Heater_mode": {"address": "40201", "type": "uint16", "access": "rw"},
        "Limit": {"address": "40202", "type": "int16", "scale": "0.1", "unit": "°C", "access": "rw"},
        "Twice": {"address": "40002", "type": "uint16", "scale": "0.5"},
    }
    assert [(problem.at.line, problem.what) for problem in found.problems] == [
        (8, "nothing says how many characters the text has"),
        (9, "'PACKED' is no type that is known here"),
        (11, "there is a point 'Twice' already"),
        (12, "'many' is no scale"),
        (13, "'???' has no letters or digits for a name"),
    ]
    assert found.unused == ("Page",)


def test_the_points_file_reads_back(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text('description,device register,unit\nFlow: inner,%MW5,m³/h\nLevel,%MW6,"a, b: #{c}"\n', "utf-8")
    found = read_vendor_table(path)
    text = points_text(found, "list", "from: somewhere")
    (tmp_path / "list.points.yaml").write_text(text, "utf-8")
    assert [entry.key.text for entry in load_points(tmp_path / "list.points.yaml")] == ["Flow_inner", "Level"]
    assert yaml.safe_load(text)["values"]["Level"] == {"address": "%MW6", "unit": "a, b: #{c}"}


@pytest.mark.parametrize("text", ["", "a;b\n1;2\n", "address,type\n1,u16\n"])
def test_what_is_no_list_is_told(tmp_path: Path, text: str) -> None:
    path = tmp_path / "list.csv"
    path.write_text(text)
    with pytest.raises(DefinitionError, match=r"no row names a column for addresses|no column has the names"):
        read_vendor_table(path)


def test_the_verb_says_what_it_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, output = tmp_path / "list.csv", tmp_path / "meter.points.yaml"
    path.write_text(SEMICOLONS, "utf-8")
    assert main(["import", str(path), "--address", "%MW{}", "-o", str(output)]) == 0
    printed = capsys.readouterr()
    assert printed.out == f"{output} is written – framekit check {output}\n"
    assert printed.err.count(" – left out\n") == 5 and "columns without effect on points: Page" in printed.err
    assert yaml.safe_load(output.read_text("utf-8"))["values"]["Limit"]["address"] == "%MW201"
    assert main(["import", str(path), "--address", "%MW"]) == 2
    assert main(["import", str(path), "-o", str(output), "--strict", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["written"] == str(output)
    (tmp_path / "x.ksy").write_text("meta: {id: x}\n", "utf-8")
    assert main(["import", str(tmp_path / "x.ksy"), "--add", "1"]) == 2
    assert main(["check", str(output)]) == 0


def test_a_cell_of_several_lines_moves_no_number(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text('name,address,type,about\nA,1,u16,"two\nlines"\nB,2,packed,\n', "utf-8")
    assert [problem.at.line for problem in read_vendor_table(path).problems] == [4]
    with pytest.raises(DefinitionError) as error:
        load_points(path)
    assert {problem.at.line for problem in error.value.problems} == {2, 4}


RUN = """run: plant
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
points:
  temperature: {channel: 1, address: "40001", scale: 0.1, unit: °C}
sinks:
  - {sqlite: history.db}
"""


def test_a_history_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "meter.device.yaml").write_text(
        'device: meter\nprotocol: modbus-tcp\nstation: 1\nmemory: {set: {"40001": 217}}\n', "utf-8"
    )
    path = tmp_path / "plant.run.yaml"
    path.write_text(RUN, "utf-8")
    assert main(["history", str(path)]) != 0
    assert "has the run been started?" in capsys.readouterr().err
    run = VirtualRun(path)
    run.run_for("2 s")
    run.stop()
    assert main(["history", str(path), "--csv", "--since", "2000-01-01", "--until", "2000-01-02T00:00+01:00"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["time,point,value,unit,quality,reason", "2000-01-01T00:00:00.000Z,temperature,21.7,°C,good,"]
    assert main(["history", str(tmp_path / "history.db"), "--since", "1h"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1
    assert main(["history", str(path), "--since", "soon"]) == 2
    capsys.readouterr()
    monkeypatch.setattr(history_verb, "PAGE", 1)
    assert main(["history", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("time                      point        value  unit")
    assert lines[1] == "2000-01-01T00:00:00.000Z  temperature  21.7   °C    good"
    path.write_text(RUN.partition("sinks:")[0], "utf-8")
    assert main(["history", str(path)]) != 0
    assert "has no sqlite sink" in capsys.readouterr().err
