"""`value(address, type)` in expressions of a definition: multi-byte numbers in the memory of a device."""

from __future__ import annotations

from pathlib import Path

import pytest

import framekit
from framekit.api.check import check_file

METER = """
protocol: meter
extends: standard
station: {type: none}
groups: {request: {from: client, head: [{const: 02}]}}
frames:
  GET:  {group: request, body: [{const: 01}]}
  GOT:
    from: server
    body: [{const: 03}, {field: hours, type: u32}, {field: level, type: f32}, {field: low, type: i16}]
areas: {B: {unit: byte, size: 64}, D: {unit: word, size: 64}}
addresses: [{form: "{area}{start:dec}", area: area}]
services:
  get:
    - request: {GET: {}}
      reply: {GOT: {hours: "value('B4', 'uint32')", level: "value('D10', 'float32')", low: "value('D1', 'int16')"}}
      gives: {hours: reply.hours, level: reply.level, low: reply.low}
"""
DEVICE = """
device: meter
protocol: meter.yaml
behave:
  B4: {hold: 100000, type: uint32}
  D10: {hold: 21.5, type: float32}
  D1: {hold: -3, type: int16}
"""


def test_numbers_of_a_behaving_device_are_replied(tmp_path: Path) -> None:
    (tmp_path / "meter.yaml").write_text(METER, encoding="utf-8")
    device = tmp_path / "meter.device.yaml"
    device.write_text(DEVICE, encoding="utf-8")
    with framekit.connect(str(tmp_path / "meter.yaml"), f"sim:{device}") as client:
        answer = client.call("get")
        assert [answer[name] for name in ("hours", "level", "low")] == [100_000, 21.5, -3]


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (
            "value('D10', 'float31')",
            "'float31' is not a type of numbers in memory – did you mean 'float32' or 'float64'?",
        ),
        ("value('D10', 'string')", "'string' is not a type of numbers in memory"),
        ("value('D10', text(1))", "a type of numbers in memory stands here – write it in quotes: int8, int16"),
        ("value(10, 'uint8')", "text"),
        ("memory(10, 4)[0]", "text"),
        ("value('D10')", "value"),
    ],
)
def test_a_wrong_call_is_a_problem(tmp_path: Path, call: str, what: str) -> None:
    path = tmp_path / "meter.yaml"
    path.write_text(METER.replace("value('D10', 'float32')", call), encoding="utf-8")
    (problem,) = check_file(str(path)).problems
    assert what in str(problem)
