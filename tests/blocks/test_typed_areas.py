"""Areas of the own memory whose elements have a type: what blocks store there, and what points show."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.api.run import VirtualRun
from framekit.cli.main import main
from framekit.definition.problems import DefinitionError

PROTOCOL = """
protocol: meter
frames:
  TOLD: {from: server, body: [{const: STX}, {field: v, type: decimal, decimals: 2, end: 2A}, {field: n, type: u8}, {value: half, read: v}, {const: ETX}]}
  SET: {from: client, body: [{const: ACK}, {field: v, type: decimal, decimals: 2, end: 2A}, {field: n, type: u8}]}
sequences:
  hear: {steps: [{step: x, receive: [{frame: TOLD, then: end}], within: 2 s}]}
  tell: {local: {given: frame}, steps: [{step: w, wait: 1 s}, {step: t, send: {TOLD: {v: 2.5, n: 7}}}]}
roles: {client: {lanes: {main: {exchange: hear}}}, server: {lanes: {main: {listen: tell}}}}
services: {a: [{run: "'hear'", client_only: yes}]}
"""  # noqa: E501
RUN = """
run: typed
memory: {areas: {F: {unit: dword, type: float32, size: 10}, W: {size: 10}, S: {type: int16, size: 10}}}
channels:
  1: {port: "sim:meter.device.yaml", protocol: meter.yaml}
blocks:
  0: {receive: TOLD, channel: 1, data: {DATA}}
points:
  a: {address: F0}
  b: {address: F1}
  c: {address: S0}
"""


def run_of(folder: Path, data: str) -> VirtualRun:
    (folder / "meter.yaml").write_text(PROTOCOL, "utf-8")
    (folder / "meter.device.yaml").write_text("device: meter\nprotocol: meter.yaml\n", "utf-8")
    path = folder / "typed.run.yaml"
    path.write_text(RUN.replace("{DATA}", data), "utf-8")
    return VirtualRun(path)


def test_numbers_are_stored_as_the_area_holds_them(tmp_path: Path) -> None:
    run = run_of(tmp_path, "{v: F0, half: F1, n: F2}")
    run.memory.write("S0", [-2])
    run.run_for("1500 ms")
    assert run.memory.read("F0", 3, type="float32") == [2.5, 2.5, 7.0]
    assert (run.points["a"].value, run.points["b"].value, run.points["c"].value) == (2.5, 2.5, -2)
    run.stop()


def test_a_fraction_is_not_cut_off_for_a_place_of_whole_numbers(tmp_path: Path) -> None:
    run = run_of(tmp_path, "{half: W0, n: W1}")
    run.memory.write("W0", [5])
    run.run_for("1500 ms")
    (block,) = run.blocks
    assert block.failed == 1 and block.last_failure is not None
    assert block.last_failure.cause == "'half' is 2.50, and W0 holds whole numbers – give it a type such as float32"
    assert run.memory.read("W0", 2) == [5, 0]
    run.stop()


@pytest.mark.parametrize(
    ("area", "told"),
    [
        ("{type: float, size: 3}", "'float' is no type of number"),
        (
            "{type: float32, size: 3}",
            "a float32 is no word, which an element is – give a unit of 32 bits, or another type",
        ),
    ],
)
def test_types_that_an_area_cannot_have_are_told(area: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.run.yaml"
    path.write_text(f"run: wrong\nmemory: {{areas: {{F: {area}}}}}\nchannels: {{}}\npoints: {{}}\n", "utf-8")
    with pytest.raises(DefinitionError) as caught:
        VirtualRun(path)
    assert any(told in str(problem) for problem in caught.value.problems), caught.value
    assert main(["check", str(path)]) == 1
