"""Values of rows: parts of addresses in other units, fields of unused cases, fractions, names of a variable."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest

import framekit
from framekit.cli.main import main
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError

BLOCKS = """protocol: blocks
extends: standard
order: big
line: {format: 8E1}
station: {type: number, range: 1..99, default: 1}
groups:
  request: {from: client, head: [{const: STX}, {field: station, type: u8}], tail: [{check: sum8}]}
  reply: {from: server, echo: [station], head: [{const: SOH}, {field: station, type: u8}], tail: [{check: sum8}]}
frames:
  READ:   {group: request, body: [{field: block, type: u8}, {field: place, type: u16}, {field: count, type: u8}]}
  VALUES: {group: reply, body: [{length: size, type: u8, of: [values]}, {data: values, size: size}]}
areas: {DB: {unit: byte, size: 100, order: big}}
tables: {letters: {B: byte, W: word, D: dword}}
addresses:
  - {form: "DB{block:dec}.{unit}{start:dec}", area: DB, unit: letters, counts: byte}
services:
  read:
    - areas: [DB]
      units: [byte]
      request: {READ: {station: station, block: block, place: start, count: count}}
      back: {area: "'DB'"}
      limit: {count: 100}
      reply: {VALUES: {values: data}}
"""
DEVICE = 'device: c\nprotocol: blocks.yaml\nmemory: {set: {"DB1.B2": [1, 2, 3, 4]}}\n'
FRACTION = """protocol: frac
extends: standard
station: {type: none}
state: {level: {scope: device, type: i32, initial: 7, publish: yes}}
groups: {request: {from: client, head: [{const: STX}]}}
frames:
  SET:  {group: request, body: [{field: level, type: i16, scale: 0.1}]}
  DONE: {from: server, body: [{const: ACK}]}
services:
  set:
    - takes: {level: {type: decimal}}
      request: {SET: {level: level}}
      serve: {set: {level: request.level}}
      reply: {DONE: {}}
"""
CASES = """protocol: cases
extends: standard
station: {type: none}
layouts: {who: [{field: k, type: u8}, {choose: k, cases: {0: [{field: a, type: u8}], 1: [{field: b, type: u16}]}}]}
groups: {request: {from: client, head: [{const: STX}, {include: who}]}}
frames:
  ASK:   {group: request, body: [{const: ENQ}]}
  OTHER: {group: request, refuse: 5, body: [{const: EOT}]}
  TOLD:  {from: server, body: [{const: ACK}, {include: who}]}
  NO:    {from: server, body: [{const: NAK}, {field: code, type: u8}, {include: who}]}
errors: {frame: NO, code: code, answer: {NO: {code: code, k: request.k, a: request.a, b: request.b}}}
services:
  ask:
    - takes: {k: {type: number}, a: {type: number}, b: {type: number}}
      request: {ASK: {k: k, a: a, b: b}}
      refuse: [{when: request.b == 9, code: 6}]
      reply: {TOLD: {k: request.k, a: request.a, b: request.b}}
"""


def failures(folder: Path, definition: str, conversations: Iterable[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the output of `framekit test` if conversations fail, else ''."""
    lines = "".join(f"  - {{name: case {number}, role: server, {case}}}\n" for number, case in enumerate(conversations))
    name = definition.partition("\n")[0].removeprefix("protocol: ")
    (folder / f"{name}.yaml").write_text(definition)
    (folder / f"{name}.vectors.yaml").write_text(f"vectors: {name}\nconversations:\n{lines}")
    status = main(["test", str(folder / f"{name}.yaml")])
    return "".join(capsys.readouterr()) if status else ""


def test_a_word_is_read_as_bytes_by_a_row_that_names_a_part_of_the_address(tmp_path: Path) -> None:
    (tmp_path / "blocks.yaml").write_text(BLOCKS)
    (tmp_path / "c.device.yaml").write_text(DEVICE)
    protocol = tmp_path / "blocks.yaml"
    with framekit.connect(str(protocol), f"sim:{tmp_path / 'c.device.yaml'}", station=1) as client:
        assert list(client.read("DB1.W2", 2)) == [0x0102, 0x0304]
        assert list(client.read("DB1.D2")) == [0x01020304]


def test_a_fraction_is_not_stored_in_a_whole_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole, fraction = "script: [{receive: 02 00 14}, {send: 06}]", "script: [{receive: 02 00 09}, {send: 06}]"
    assert not failures(tmp_path, FRACTION, [f"{whole}, result: {{state: {{level: 2}}}}"], capsys)
    (tmp_path / "other").mkdir()
    assert "0.9 is not a whole number" in failures(tmp_path / "other", FRACTION, [fraction], capsys)


def test_a_field_of_a_case_that_was_not_taken_may_be_copied(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scripts = [
        "script: [{receive: 02 01 00 07 05}, {send: 06 01 00 07}]",
        "script: [{receive: 02 00 07 05}, {send: 06 00 07}]",
        "script: [{receive: 02 01 00 09 05}, {send: 15 06 01 00 09}]",
        "script: [{receive: 02 01 00 07 04}, {send: 15 05 01 00 07}]",
    ]
    assert failures(tmp_path, CASES, scripts, capsys) == ""


LIST = BLOCKS.replace(
    "body: [{field: block, type: u8}, {field: place, type: u16}, {field: count, type: u8}]",
    "body: [{field: kind, type: u8}, {repeat: list, of: [{field: place, type: u16}], times: rest}]",
).replace(
    "request: {READ: {station: station, block: block, place: start, count: count}}",
    "variables: {max: 4, same: unit}\n      request: {READ: {kind: KIND, list: {each: {place: start}}}}",
)


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("lengths[unit]", ""),
        ("lengths[area]", "'area' may differ from variable to variable – use it in each, or add same: area"),
        ("start", "'start' may differ from variable to variable – use it in each"),
    ],
)
def test_names_of_one_variable_stand_in_each(kind: str, told: str) -> None:
    text = LIST.replace("KIND", f'"{kind}"').replace("tables: {", "tables: {lengths: {byte: 1, DB: 2}, ")
    found = [problem for problem in problems_of(text) if "variable to variable" in problem]
    assert len(found) == bool(told) and told in "".join(found), found


def problems_of(text: str) -> list[str]:
    """Return the errors of a definition, or the warnings if it has no errors."""
    try:
        return [str(problem) for problem in load_protocol_text(text).warnings]
    except DefinitionError as error:
        return [str(problem) for problem in error.problems]


def test_a_word_that_means_two_things_is_a_problem(tmp_path: Path) -> None:
    text = FRACTION.replace("{field: level, type: i16, scale: 0.1}", "{field: level, type: u8, values: {1: text}}")
    found = problems_of(text.replace("{SET: {level: level}}", "{SET: {level: text}}"))
    assert any(
        "'text' is a name of the address here, and 'level' has a value 'text'" in message for message in found
    ), found
    assert not any("name of the address" in problem for problem in problems_of(text))


def test_a_value_is_no_frame_and_layout_at_once() -> None:
    text = FRACTION.replace("SET:  {", "INNER: {from: server, body: [{field: level, type: u8}]}\n  SET:  {")
    text = text.replace("type: i16, scale: 0.1}]", "type: i16}, {data: more, size: 1}]")
    text = text.replace("{level: level}}", "{level: level, more: {INNER: {level: 1}}}}", 1)
    named = text.replace("groups:", "layouts: {INNER: [{field: level, type: u8}]}\ngroups:")
    message = "'INNER' is a frame and a layout, and a value by that name is the frame – give one of them another name"
    assert [message in problem for problem in problems_of(named) if "INNER" in problem] == [True]
    assert not any("is a frame and a layout" in problem for problem in problems_of(text))
