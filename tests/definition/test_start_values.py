"""Start values of state variables as lists, records and maps: conversion by type, and every error for wrong values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from framekit.codec.support import find_last
from framekit.definition.load.protocol import load_protocol
from framekit.definition.problems import DefinitionError
from framekit.link.scope import Scope
from framekit.runfile.device_state import with_state

DEFINITION = """protocol: kept
layouts:
  fault:
    - {field: slot, type: u8, range: 0..15}
    - {field: group, type: u8, values: {3: lost, 18: battery}}
    - {field: text, type: ascii, size: 4, pad: 00}
    - {field: mark, type: bytes, size: 2}
    - {field: late, type: u16, unit: ms}
    - {bits: {on: 0, mode: 1-2}, of: u8}
    - {field: day, type: bcd, size: 1}
    - {count: n, type: u8, of: parts}
    - {repeat: parts, times: n, of: [{field: size, type: u16}]}
  fact: [{field: major, type: u8}, {field: weight, type: f32}]
state:
  faults:  {scope: device, list: fault, max: 2, initial: FAULTS}
  facts:   {scope: device, record: fact, initial: FACTS}
  words:   {scope: device, table: 1..4, holds: text, initial: WORDS}
  numbers: {scope: device, table: 0..9, holds: u8}
  each:    {scope: device, table: 0..1, holds: fact}
  level:   {scope: session, type: u8, initial: 1}
  mode:    {scope: device, type: u8, values: {1: slow, 2: fast}}
  name:    {scope: device, type: text}
  code:    {scope: device, type: bytes, size: 2}
  wait:    {scope: device, type: time}
  on_line: {scope: line, type: u8}
"""
FAULTS = "[{slot: 1, group: battery, text: AB, mark: 01 FF, late: 20 ms, on: 1, day: 31, parts: [{size: 7}]}, {}]"


def scope_of(
    folder: Path, state: dict[str, Any] | None = None, faults: str = "[]", facts: str = "{}", words: str = "{}"
) -> Scope:
    """Return the scope of a device; the file has these start values, and `state` replaces some of them."""
    text = DEFINITION.replace("FAULTS", faults).replace("FACTS", facts).replace("WORDS", words)
    file = folder / "kept.yaml"
    file.write_text(text, encoding="utf-8")
    return Scope(with_state(load_protocol(file), state or {}))


def problems_of(folder: Path, state: dict[str, Any] | None = None, **texts: str) -> list[str]:
    """Return the problems of start values, without their places."""
    with pytest.raises(DefinitionError) as caught:
        scope_of(folder, state, **texts)
    return [f"{problem.what} – {problem.todo}" for problem in caught.value.problems]


def test_lists_records_and_tables(tmp_path: Path) -> None:
    scope = scope_of(
        tmp_path, faults=FAULTS, facts="{major: 16, weight: 0.5}", words="{2: SECRET, 0x03: ''}"
    )  # fmt: skip
    first, second = scope["faults"]
    assert first == {
        "slot": 1, "group": 18, "text": "AB", "mark": b"\x01\xff", "late": 20_000_000, "on": 1, "mode": 0, "day": 31,
        "parts": [{"size": 7}],
    }  # fmt: skip
    assert second["slot"] == 0 and second["mark"] == b"\0\0" and second["parts"] == []
    assert scope["facts"] == {"major": 16, "weight": 0.5}
    assert dict(scope["words"]) == {2: "SECRET", 3: ""} and 1 not in scope["words"]


def test_start_values_of_a_program_and_of_a_command_line(tmp_path: Path) -> None:
    state = {
        "faults": "[{slot: 2, mark: 0A 0B}]", "words": {4: "TOP"}, "numbers": {1: 2}, "each": {1: {"major": 3}},
        "level": 2, "mode": "fast", "name": "[MAIN]", "code": b"\x0a\x0b", "wait": "50 ms",
    }  # fmt: skip
    scope = scope_of(tmp_path, state, faults=FAULTS, words="{2: SECRET}")
    assert [fault["slot"] for fault in scope["faults"]] == [2] and dict(scope["words"]) == {4: "TOP"}
    assert dict(scope["numbers"]) == {1: 2} and scope["level"] == 2 and scope["mode"] == 2
    assert (scope["name"], scope["code"], scope["wait"]) == ("[MAIN]", b"\x0a\x0b", 50_000_000)
    assert scope["each"][1] == {"major": 3, "weight": 0.0}
    scope.set("level", 4)
    scope.reset_session()
    assert scope["level"] == 2, "a session begins with the start value"


def test_every_key_of_a_table_with_one_start_value_is_found(tmp_path: Path) -> None:
    scope = scope_of(tmp_path, words="\"'AB'\"")
    assert find_last(scope["words"], "AB") == 4 and next(iter(scope["words"].items())) == (1, "AB")


@pytest.mark.parametrize(
    ("texts", "problems"),
    [
        (
            {"faults": "[{slott: 1, slot: 16, group: batery, text: ABCDE, mark: 01, late: 5}, 7]"},
            [
                "there is no field 'slott' – did you mean 'slot'?",
                "16 does not fit: 'slot' holds 0 to 15 – correct it",
                "'batery' is not a whole number – did you mean 'battery'?",
                "'ABCDE' does not fit into 'text' – give 4 ASCII characters",
                "'mark' has 2 bytes – write them as hex pairs",
                "'5' is not a time – write a number and a unit (ms, s, min, h, d), such as 50 ms or 3 s",
                "this is no record – write {NAME: value} with some of slot, group, text, mark, late, on, mode, day, "
                "parts",
            ],
        ),
        ({"faults": "[{n: 1, mode: 4, day: 100}]"}, [
            "'n' is computed – leave it out", "4 does not fit: 'mode' holds 0 to 3 – correct it",
            "100 does not fit: 'day' holds 0 to 99 – correct it",
        ]),
        ({"faults": "[{}, {}, {}]"}, ["3 items do not fit: 'faults' holds 2 – leave some out"]),
        ({"faults": "{slot: 1}"}, ["'faults' is a list – write [{NAME: value, …}, …]"]),
        ({"facts": "[1]"}, ["this is no record – write {NAME: value} with some of major, weight"]),
        ({"words": "{5: A, x: B, 2: {a: 1}}"}, [
            "5 is no key of 'words' – give 1 to 4", "'x' is not a whole number – write it like 10 or 0x0A",
            "this must be a single value – write a single value",
        ]),
    ],
)  # fmt: skip
def test_wrong_start_values_of_a_file(tmp_path: Path, texts: dict[str, str], problems: list[str]) -> None:
    assert problems_of(tmp_path, **texts) == problems


@pytest.mark.parametrize(
    ("state", "problems"),
    [
        ({"levle": 1}, ["'kept' has no state variable 'levle' – did you mean 'level'?"]),
        ({"on_line": 1, "level": 256}, [
            "256 does not fit: 'level' holds 0 to 255 – correct it",
            "'kept' has no state variable 'on_line' – known: faults, facts, words, numbers, each, level, mode, name, "
            "code, wait",
        ]),
        ({"numbers": {10: 1}}, ["10 is no key of 'numbers' – give 0 to 9"]),
        ({"numbers": [1]}, ["'numbers' is a table – write {KEY: value}, keys 0 to 9"]),
        ({"code": b"\1", "wait": 5}, [
            "'code' has 2 bytes – write them as hex pairs",
            "'5' is not a time – write a number and a unit (ms, s, min, h, d), such as 50 ms or 3 s",
        ]),
    ],
)  # fmt: skip
def test_wrong_start_values_of_a_program(tmp_path: Path, state: dict[str, Any], problems: list[str]) -> None:
    assert problems_of(tmp_path, state) == problems


def test_text_that_is_no_yaml_is_reported(tmp_path: Path) -> None:
    assert len(problems_of(tmp_path, {"words": "{2: "})) == 1
