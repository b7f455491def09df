"""The meaning of a text in the editor: problems at their lines, frames as boxes, bytes read and built."""

from __future__ import annotations

from pathlib import Path

import pytest
from extras.web.edit_world import LAMP, answer_of, written

RUN = """run: hall
channels:
  1: {port: "sim:x", protocol: lamp.yaml, role: client}
  2: {port: "sim:y", protocol: modbus-rtu, station: 1}
"""


@pytest.fixture
def lamp(tmp_path: Path) -> Path:
    return written(tmp_path)


def test_a_good_file_has_its_frames_as_boxes(lamp: Path) -> None:
    found = answer_of("look", lamp)
    assert (found["kind"], found["what"], found["problems"]) == ("protocol", "protocol lamp, 2 frames", [])
    (protocol,) = found["protocols"]
    name, about, boxes = protocol["frames"][0]
    assert (name, about) == ("SWITCH", "Sets the level of a lamp. 6 bytes, from the client.")
    assert [(box[0], box[2], box[3]) for box in boxes] == [
        ("const", "1", "constant"), ("station", "1", "value"), ("level", "2", "value"), ("check", "2", "check"),
    ]  # fmt: skip


def test_problems_stand_at_their_lines(lamp: Path) -> None:
    found = answer_of("look", lamp, LAMP.replace("type: u16", "type: u88"))
    assert found["problems"] == [
        [10, 30, "'u88' is not a type, in frame 'SWITCH'", "did you mean 'u8' or 'u48'?", False, ""]
    ]
    assert found["protocols"] is None


def test_a_problem_of_another_file_names_it(lamp: Path, tmp_path: Path) -> None:
    device = written(tmp_path, "device: hall\nprotocol: lamp.yaml\n", "hall.device.yaml")
    written(tmp_path, LAMP.replace("u16", "u88"))
    assert [(problem[0], problem[5]) for problem in answer_of("look", device)["problems"]] == [(0, "lamp.yaml")]


def test_text_that_is_no_yaml_has_one_problem(lamp: Path) -> None:
    found = answer_of("look", lamp, LAMP + "  [")
    assert (found["kind"], found["protocols"]) == ("", None)
    assert [problem[0] for problem in found["problems"]] == [18]


def test_a_run_shows_the_frames_of_its_protocols(lamp: Path, tmp_path: Path) -> None:
    run = written(tmp_path, RUN, "hall.run.yaml")
    assert [protocol["name"] for protocol in answer_of("look", run)["protocols"]] == ["lamp", "modbus-rtu"]
    (reading,) = answer_of("decode", run, protocol="lamp", data="02 05 01 00 0D 10")["readings"]
    assert reading["frame"] == "SWITCH"


def test_bytes_are_read(lamp: Path) -> None:
    found = answer_of("decode", lamp, protocol="lamp", data="02 05 01 00 0D 10")
    (reading,) = found["readings"]
    assert (found["bytes"], reading["frame"], reading["fault"]) == ("020501000d10", "SWITCH", None)
    assert [tuple(row) for row in reading["rows"]] == [
        ("const", "0", "02", "02", 0, 1), ("station", "1", "05", "5", 1, 1), ("level", "2", "01 00", "256", 2, 2),
        ("check", "4", "0D 10", "0D 10", 4, 2),
    ]  # fmt: skip


def test_a_fault_is_marked_where_it_is(lamp: Path) -> None:
    (reading,) = answer_of("decode", lamp, protocol="lamp", data="02 05 01 00 00 00")["readings"]
    assert (reading["frame"], reading["fault"]) == (
        "SWITCH", ["check: check, expected 0D 10, found 00 00", 4, "check"],
    )  # fmt: skip


def test_the_innermost_fault_is_marked(tmp_path: Path) -> None:
    device = written(tmp_path, "device: d\nprotocol: modbus-tcp\nstation: 1\n", "d.device.yaml")
    data = "00 01 00 00 00 09 01 0F 00 02 00 02 02 2D 00"  # the header fits, and no PDU is so long
    reading = answer_of("decode", device, protocol="modbus-tcp", data=data)["readings"][0]
    words, offset, segment = reading["fault"]
    assert words.startswith("pdu is none of its frames; nearest: pdu.write_coils_reply.frame: surplus")
    assert (offset, segment) == (12, "pdu.write_coils_reply.frame")


@pytest.mark.parametrize(
    ("data", "why"),
    [("0", "This is no hex"), ("xx", "This is no hex"), ("", "From 1 to"), ("00" * 5000, "From 1 to")],
)
def test_what_is_no_frame_says_why(lamp: Path, data: str, why: str) -> None:
    assert answer_of("decode", lamp, protocol="lamp", data=data)["why"].startswith(why)


def test_with_a_wrong_definition_no_bytes_are_read(lamp: Path) -> None:
    wrong = LAMP.replace("u16", "u88")
    assert answer_of("decode", lamp, wrong, protocol="lamp", data="02")["why"] == "Correct the definition first"
    assert answer_of("form", lamp, wrong, protocol="lamp", frame="SWITCH")["why"] == "Correct the definition first"


def test_a_file_without_frames_says_so(tmp_path: Path) -> None:
    path = written(tmp_path, "points: a\nvalues: {x: {address: M1}}\n", "a.points.yaml")
    assert answer_of("look", path)["protocols"] == []
    assert answer_of("decode", path, protocol="", data="02")["why"] == "This file has no frames"
    assert answer_of("form", written(tmp_path), protocol="x", frame="y")["why"] == "This file has no protocol 'x'"


def test_a_form_builds_a_frame(lamp: Path) -> None:
    form = answer_of("form", lamp, protocol="lamp", frame="SWITCH")
    assert [row[0] for row in form["rows"]] == [["station"], ["level"]]
    rows = [[["station"], "5"], [["level"], "256"]]
    assert answer_of("build", lamp, protocol="lamp", frame="SWITCH", rows=rows) == {"built": "02 05 01 00 0D 10"}
    rows[1][1] = "70000"
    refused = answer_of("build", lamp, protocol="lamp", frame="SWITCH", rows=rows)
    assert refused["field"] == "level" and "70000" in refused["why"]
    assert "station" in answer_of("build", lamp, protocol="lamp", frame="SWITCH", rows=rows[1:])["why"]


def test_a_form_holds_the_chosen_inner_frame(tmp_path: Path) -> None:
    device = written(tmp_path, "device: d\nprotocol: modbus-rtu\nstation: 1\n", "d.device.yaml")
    given = {"protocol": "modbus-rtu", "frame": "request_adu"}
    form = answer_of("form", device, **given, inside="read_holding")
    assert "read_holding" in form["inner"] and form["inside"] == "read_holding"
    assert [row[0] for row in form["rows"]] == [
        ["station"], ["pdu", "read_holding", "address"], ["pdu", "read_holding", "count"],
    ]  # fmt: skip
    values = ("17", "0", "2")
    rows = [[row[0], value] for row, value in zip(form["rows"], values, strict=True)]
    assert answer_of("build", device, **given, rows=rows) == {"built": "11 03 00 00 00 02 C6 9B"}


@pytest.mark.long
def test_every_form_of_shipped_protocols_builds_its_sample(tmp_path: Path) -> None:
    for name in ("modbus-tcp", "df1", "sbus"):
        device = written(tmp_path, f"device: d\nprotocol: {name}\n", "d.device.yaml")
        protocols = answer_of("look", device)["protocols"] or []
        built = 0
        for protocol in protocols:
            for frame, *_ in protocol["frames"]:
                given = {"protocol": protocol["name"], "frame": frame}
                built += "built" in answer_of("build", device, **given, rows=answer_of("form", device, **given)["rows"])
        assert not protocols or built > 0, name


def test_rows_that_do_not_fit_together_are_refused(lamp: Path) -> None:
    rows = [[["station"], "5"], [["station", "x"], "1"], [["level"], "[1"]]
    assert (
        answer_of("build", lamp, protocol="lamp", frame="SWITCH", rows=rows[:2])["why"]
        == "'station' has a value and parts"
    )
    assert "built" not in answer_of("build", lamp, protocol="lamp", frame="SWITCH", rows=[rows[2]])
    assert answer_of("build", lamp, protocol="lamp", frame="NONE", rows=[])["why"] == "There is no frame 'NONE'"
