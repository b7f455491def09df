"""Areas of the own memory with typed elements: values stored by blocks, and values shown by points."""

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
    told = "'half' may have a fraction, and W0 is a word"
    assert block.failed == 1 and block.last_failure is not None
    assert block.last_failure.cause == f"{told} – name a double word, which holds it as a floating-point number"
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


NUMBERS = """
protocol: numbers
frames:
  ASK: {from: client, body: [{const: ENQ}]}
  TOLD: {from: server, body: [{const: STX}, {field: u, type: u16}, {field: f, type: f32}, {field: l, type: u32}, {field: d, type: decimal, decimals: 1, end: 2A}, {value: v, read: u}, {value: x, read: f}, {const: ETX}]}
sequences:
  ask: {takes: [request], gives: {reply: told}, local: {told: frame}, steps: [{step: x, send: request, receive: [{frame: TOLD, set: {told: it}, then: end}], within: 2 s}]}
  tell: {steps: [{step: w, receive: [{frame: ASK, then: next}]}, {step: t, send: {TOLD: {u: 40000, f: 3.5, l: 16777217, d: 7.5}}}]}
roles: {client: {lanes: {main: {exchange: ask}}}, server: {lanes: {main: {listen: tell}}}}
services: {all: [{request: {ASK: {}}, reply: {TOLD: {}}, gives: {u: reply.u, f: reply.f, l: reply.l, d: reply.d, v: reply.v, x: reply.x}}]}
"""  # noqa: E501
AREAS = """{areas: {F: {unit: dword, type: float32, size: 10}, G: {unit: lword, type: float64, size: 4}, W: {size: 10},
 D: {unit: dword, size: 10}, S: {type: int16, size: 10}, I: {unit: dword, type: int32, size: 10},
 B: {type: bcd16, size: 4}}}"""
NOT_HELD = [
    ("u", "S0", "'u' cannot be stored in S0: 40000 does not fit into 16 bits with sign: -32768 to 32767"),
    ("v", "S0", "'v' cannot be stored in S0: 40000 does not fit into 16 bits with sign: -32768 to 32767"),
    ("u", "B0", "'u' cannot be stored in B0: 40000 does not fit into 4 decimal digits"),
    ("l", "F0", "'l' cannot be stored in F0: 16777217 has more digits than a float32 holds: it would be 16777216"),
    ("x", "I0", "'x' cannot be stored in I0: 3.5 is no whole number, as a int32 is"),
]


def numbers_run(folder: Path, result: str, place: str, how: str) -> VirtualRun:
    (folder / "numbers.yaml").write_text(NUMBERS, "utf-8")
    (folder / "numbers.device.yaml").write_text("device: numbers\nprotocol: numbers.yaml\n", "utf-8")
    block = f"{{call: all, channel: 1, into: {{{result}: {place}}}, every: 1 s}}"
    blocks = f"0: {block}"
    if how == "receive":
        blocks = (
            f"0: {{receive: TOLD, channel: 1, data: {{{result}: {place}}}}}\n  1: {{send: ASK, channel: 1, every: 1 s}}"
        )
    path = folder / "numbers.run.yaml"
    path.write_text(
        f"run: numbers\nmemory: {AREAS}\nchannels:\n  1: {{port: 'sim:numbers.device.yaml', protocol: numbers.yaml}}\n"
        f"blocks:\n  {blocks}\n", "utf-8",
    )  # fmt: skip
    return VirtualRun(path)


@pytest.mark.parametrize("how", ["receive", "call"])
@pytest.mark.parametrize(("result", "place", "told"), NOT_HELD)
def test_a_number_that_its_place_cannot_hold_is_not_stored(
    result: str, place: str, told: str, how: str, tmp_path: Path
) -> None:
    run = numbers_run(tmp_path, result, place, how)
    run.run_for("1500 ms")
    block = run.blocks[0]
    assert block.failed == 1 and block.last_failure is not None
    assert block.last_failure.cause == f"{told} – name a place that holds it"
    assert run.memory.read(place, 1) == [0]
    run.stop()


@pytest.mark.parametrize("how", ["receive", "call"])
@pytest.mark.parametrize(
    ("result", "place", "type_", "held"),
    [
        ("u", "I0", "int32", 40000), ("u", "F1", "float32", 40000.0), ("f", "F0", "float32", 3.5),
        ("d", "D1", "float32", 7.5), ("l", "G0", "float64", 16777217.0), ("l", "D0", "dword", 16777217),
        ("x", "G1", "float64", 3.5), ("x", "D3", "float32", 3.5),
    ],
)  # fmt: skip
def test_a_number_that_its_place_holds_is_stored_as_that(
    result: str, place: str, type_: str, held: float, how: str, tmp_path: Path
) -> None:
    run = numbers_run(tmp_path, result, place, how)
    run.run_for("1500 ms")
    assert run.blocks[0].failed == 0
    assert run.memory.read(place, 1, type=type_) == [held]
    run.stop()


@pytest.mark.parametrize("how", ["receive", "call"])
@pytest.mark.parametrize("result", ["f", "d"])
def test_a_field_with_a_fraction_is_refused_where_whole_numbers_stand(result: str, how: str, tmp_path: Path) -> None:
    with pytest.raises(DefinitionError) as caught:
        numbers_run(tmp_path, result, "I0", how)
    (problem,) = caught.value.problems
    assert problem.what == f"'{result}' may have a fraction, and I0 is of type int32"
    assert problem.todo == "name a place of type float32 or float64"


def test_elements_are_moved_between_places_of_the_same_type(tmp_path: Path) -> None:
    path = tmp_path / "moved.run.yaml"
    text = f"run: moved\nmemory: {AREAS}\nchannels:\n  1: {{port: 'sim:df1', protocol: df1, station: 1}}\nblocks:\n"
    blocks = "  0: {read: 'F8:1', into: I0, channel: 1}\n  1: {write: 'F8:1', from: F0, channel: 1}\n"
    path.write_text(f"{text}{blocks}  2: {{read: 'F8:1', into: I0, type: dword, channel: 1}}\n", "utf-8")
    with pytest.raises(DefinitionError) as caught:
        VirtualRun(path)
    (problem,) = caught.value.problems
    assert problem.what == "I0 holds int32, and F8:1 holds float32"


def test_a_result_that_the_reply_does_not_have_leaves_its_place(tmp_path: Path) -> None:
    definition = """
protocol: told
extends: standard
station: {type: number, range: 0..9, default: 1}
groups: {request: {from: client}, answer: {from: server}}
frames:
  GET: {group: request, body: [{const: ENQ}, {field: station, type: u8}]}
  GOT: {group: answer, body: [{const: STX}, {field: a, type: u8}, {length: n, type: u8, of: [b]}, {name: b, wrap: none, size: n, of: [{optional: [{field: more, type: u8}]}]}]}
services: {get: [{request: {GET: {station: station}}, reply: {GOT: {a: 7}}, gives: {a: reply.a, more: reply.more}}]}
"""  # noqa: E501
    (tmp_path / "told.yaml").write_text(definition, "utf-8")
    (tmp_path / "told.device.yaml").write_text("device: told\nprotocol: told.yaml\nstation: 1\n", "utf-8")
    block = "{call: get, into: {a: W0, more: W1}, channel: 1, every: 1 s}"
    (tmp_path / "told.run.yaml").write_text(
        f"run: told\nmemory: {AREAS}\n"
        "channels: {1: {port: 'sim:told.device.yaml', protocol: told.yaml, station: 1}}\n"
        f"blocks: {{0: {block}}}\n", "utf-8",
    )  # fmt: skip
    run = VirtualRun(tmp_path / "told.run.yaml")
    run.memory.write("W0", [1, 2])
    run.run_for("1500 ms")
    assert run.blocks[0].failed == 0 and run.memory.read("W0", 2) == [7, 2]
    run.stop()
