"""Numbers with a fraction: in the state of a simulated device, from there in the memory of a run, and as defaults."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest

import framekit
from framekit.api.check import check_file
from framekit.cli.main import main
from framekit.memory.memory import DeviceMemory
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
OVEN = """\
protocol: oven
station: {type: none}
line: {kind: stream, tcp: 4000}
extends: standard
params: {gain: {type: decimal, default: -0.25}}
state:
  temperature: {scope: device, type: f32, initial: 21.3, publish: yes}
  exact: {scope: device, type: f64, initial: 21.3}
  zones: {scope: device, table: 1..4, holds: f32, initial: 0.5}
groups: {request: {from: client}, reply: {from: server}}
frames:
  GET: {group: request, body: [{const: 01}]}
  PUT: {group: request, body: [{const: 02}, {field: v, type: f32}]}
  TOLD:
    group: reply
    body:
      - {const: 11}
      - {field: t, type: f32}
      - {field: s, type: i16, scale: 0.1, default: -0.5}
      - {field: x, type: decimal, decimals: 2, size: 6, default: 12.25}
      - {field: g, type: decimal, decimals: any, end: 0D, default: gain}
  DONE: {group: reply, body: [{const: 12}]}
services:
  get:
    - request: {GET: {}}
      reply: {TOLD: {t: temperature, s: exact}}
      gives: {t: reply.t, s: reply.s, x: reply.x, g: reply.g, twice: reply.s * 2, all: "[reply.s, reply.x]"}
  put:
    - takes: {v: {type: decimal, default: 0.5}}
      request: {PUT: {v: v}}
      serve: {set: {temperature: request.v, 'zones[2]': request.v}}
      reply: {DONE: {}}
"""
DEVICE = "device: oven\nprotocol: oven.yaml\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "oven.yaml").write_text(OVEN)
    (tmp_path / "oven.device.yaml").write_text(DEVICE)
    return tmp_path


def run_of(folder: Path, block: str) -> Path:
    path = folder / "oven.run.yaml"
    channel = '{port: "sim:oven.device.yaml", protocol: oven.yaml}'
    path.write_text(f"run: oven\nmemory: masterlogic\nchannels: {{1: {channel}}}\nblocks:\n  0: {block}\n")
    return path


def words_after(path: Path, first: int, count: int) -> tuple[list[int], str]:
    """Return words of the own memory after two seconds, and the last error of the block."""
    clock = VirtualClock()
    service = RunService(load_run(path), clock)
    service.start()
    clock.run_for(2 * SECOND)
    memory: DeviceMemory = service.memory
    (status,) = service.status()
    return memory.read("M", "word", first, count), str(status.last_failure or "")


def words_of(*numbers: float) -> list[int]:
    """Return 32-bit floating-point numbers as words, the low word first."""
    data = struct.pack(f"<{len(numbers)}f", *numbers)
    return list(struct.unpack(f"<{2 * len(numbers)}H", data))


@pytest.mark.parametrize(
    ("into", "numbers"),
    [
        ('{t: "%MD50"}', [21.3]),  # a double word
        ("{t: M100}", [21.3]),  # two words
        ("{s: M100, x: M102, g: M104}", [21.3, 12.25, -0.25]),
        ("{reply.s: M100}", [21.3]),
        ('{twice: "%MD50"}', [42.6]),  # `check` cannot know that it may have a fraction
        ("{all: M100}, size: {all: 2}", [21.3, 12.25]),
        ("{all: M100}, size: {all: 3}", [21.3, 12.25, 0]),
    ],
)
def test_a_fraction_from_a_service_is_stored_as_a_float_in_two_words(
    folder: Path, into: str, numbers: list[float]
) -> None:
    path = run_of(folder, f"{{call: get, into: {into}, every: 1 s}}")
    assert check_file(str(path)).problems == []
    assert words_after(path, 100, 2 * len(numbers)) == (words_of(*numbers), "")


def test_where_a_fraction_cannot_be_stored_nothing_is(folder: Path) -> None:
    """A word for a whole number: the error is reported when the value arrives, or by `check` if it is known before."""
    path = run_of(folder, "{call: get, into: {twice: M100, t: M101}, every: 1 s}")
    what = "'twice' may have a fraction, and M100 is a word"
    assert words_after(path, 100, 3) == (
        [0, 0, 0],
        f"cannot_store: {what} – name a double word, which holds it as a floating-point number",
    )
    path = run_of(folder, '{call: get, into: {t: M100.3, x: "%MB7"}, every: 1 s}')
    messages = [str(problem).partition(": ")[2] for problem in check_file(str(path)).problems]
    assert [message.partition(" – ")[0] for message in messages] == [
        "'t' may have a fraction, and M100.3 is a bit", "'x' may have a fraction, and %MB7 is a byte",
    ]  # fmt: skip


def test_call_on_the_command_line_and_in_python(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    port = f"sim:{folder / 'oven.device.yaml'}"
    assert main(["call", str(folder / "oven.yaml"), "get", "--port", port, "--json"]) == 0
    printed = capsys.readouterr().out
    assert '"s": 21.3' in printed
    assert '"x": 12.25' in printed
    with framekit.connect(str(folder / "oven.yaml"), port) as client:
        client.call("put", {"v": 2.75})
        assert client.call("get")["t"] == 2.75
        client.call("put")
        assert client.call("get")["t"] == 0.5


VECTORS = """\
vectors: oven
frames:
  - {frame: TOLD, values: {t: 21.5}, bytes: 11 41 AC 00 00 FF FB 30 31 32 2E 32 35 2D 30 2E 32 35 0D}
conversations:
  - name: device
    role: server
    state: {exact: -0.5, temperature: 0.75, zones: {1: 0.25}}
    script:
      - {receive: 01}
      - {send: 11 3F 40 00 00 FF FB 30 31 32 2E 32 35 2D 30 2E 32 35 0D}
      - {receive: 02 41 AC CC CD}
      - {send: 12}
    result: {state: {temperature: 21.6, exact: -0.5}}
  - name: client
    role: client
    do: {get: {}}
    script:
      - {send: 01}
      - {receive: 11 41 AC CC CD 00 D5 30 31 32 2E 32 35 31 2E 35 30 0D}
    result: {values: {t: 21.6, s: 21.3, x: 12.25, g: 1.50}}
"""


@pytest.mark.parametrize(
    ("old", "new", "wrong"),
    [
        ("", "", ""),
        ("temperature: 21.6", "temperature: 21.5", "temperature is 21.600000381469727 afterwards, expected 21.5"),
        ("{t: 21.6", "{t: 21.61", "expected {'t': '21.61'"),
        ("s: 21.3", "s: 21.4", "'s': '21.4'"),
    ],
)
def test_vectors_tell_fractions(
    folder: Path, old: str, new: str, wrong: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "oven.vectors.yaml").write_text(VECTORS.replace(old, new, 1))
    assert main(["test", str(folder / "oven.yaml")]) == (1 if wrong else 0)
    printed: Any = capsys.readouterr()
    assert wrong in printed.out + printed.err
