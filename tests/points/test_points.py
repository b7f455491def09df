"""Points of a run: values, quality, time, planned reads, and writing – on simulated lines and their virtual clock."""

from __future__ import annotations

import asyncio
import json
import random
from pathlib import Path
from socket import socket
from typing import Any

import pytest

from framekit.api.errors import RequestError
from framekit.api.rows import point_rows
from framekit.api.run import AsyncRun, VirtualRun, loaded
from framekit.definition.problems import DefinitionError
from framekit.extras.web.shown import value_cells
from framekit.run.points import PointValue

DEVICE = """device: meter
protocol: {protocol}
station: {station}
memory: {{set: {{{values}}}}}
"""
RUN = """run: plant
channels:
  1: {{port: "sim:meter.device.yaml", protocol: {protocol}, station: {station}}}
points:
{points}
"""


def device_in(folder: Path, values: str, *, protocol: str = "modbus-tcp", station: Any = 1) -> None:
    """Write a simulated device with these start values."""
    text = DEVICE.format(protocol=protocol, station=station, values=values)
    (folder / "meter.device.yaml").write_text(text, "utf-8")


def run_of(
    folder: Path, points: str, values: str, *, protocol: str = "modbus-tcp", station: Any = 1, more: str = ""
) -> VirtualRun:
    """Write a run with these points, one per line, and a simulated device with these start values."""
    device_in(folder, values, protocol=protocol, station=station)
    lines = "\n".join(f"  {line}" for line in points.strip().splitlines())
    text = RUN.format(protocol=protocol, station=station, points=lines) + more
    (folder / "plant.run.yaml").write_text(text, "utf-8")
    return VirtualRun(folder / "plant.run.yaml")


def values_after(run: VirtualRun, time: str = "1500 ms") -> dict[str, Any]:
    run.run_for(time)
    found = {value.name: value.value for value in run.points.now()}
    assert {value.quality for value in run.points.now()} == {"good"}
    run.stop()
    return found


# ---- values -----------------------------------------------------------------------------------------------------


def test_numbers_are_scaled_exactly_and_named(tmp_path: Path) -> None:
    points = """
a: {channel: 1, address: "40001", scale: 0.1}
b: {channel: 1, address: "40002", type: int16, scale: 0.5, offset: -10}
c: {channel: 1, address: "40003", scale: 10, offset: 5}
d: {channel: 1, address: "40004", enum: {0: off, 3: heating}}
e: {channel: 1, address: "40001", enum: {0: off}}
f: {channel: 1, address: "40005", type: float32, order: ABCD, decimals: 2}
g: {channel: 1, address: "40007", type: string, size: 5}
h: {channel: 1, address: "00002"}
i: {channel: 1, address: "40001", scale: 0.001, decimals: 1}
"""
    device = '"40001": [217, 65535, 7, 3, 0x4049, 0x0FDB, 0x4142, 0x4344, 0x4500], "00001": [0, 1]'
    assert values_after(run_of(tmp_path, points, device)) == {
        "a": 21.7, "b": -10.5, "c": 75, "d": "heating", "e": 217, "f": 3.14, "g": "ABCDE", "h": 1, "i": 0.2,
    }  # fmt: skip


def test_a_float_of_32_bits_is_shown_with_the_digits_that_it_needs(tmp_path: Path) -> None:
    points = """
a: {channel: 1, address: "40001", type: float32, order: ABCD}
b: {channel: 1, address: "40003", type: float32, order: ABCD}
c: {channel: 1, address: "40005", type: float64, order: ABCD}
"""
    device = '"40001": [0x4144, 0xCCCD, 0x7149, 0xF2CA, 0x4028, 0x9999, 0xA000, 0]'  # 12.3, 1e30, and 12.3 of 32 bits
    run = run_of(tmp_path, points, device)
    run.run_for("1500 ms")
    shown = [run.points[value.name].text_of(value.value) for value in run.points.now()]
    run.stop()
    assert shown == ["12.3", "1e+30", "12.300000190734863"]


def test_decimals_format_every_text_of_a_value(tmp_path: Path) -> None:
    points = """
f: {channel: 1, address: "40001", type: float32, order: ABCD, decimals: 2, unit: V}
g: {channel: 1, address: "40001", type: float32, order: ABCD, decimals: 0}
n: {channel: 1, address: "40003", decimals: 1}
"""
    more = "sinks: [{csv: rows.csv}, {csv: columns.csv, every: 1 s}, {jsonl: lines.jsonl}]\n"
    run = run_of(tmp_path, points, '"40001": [0x4110, 0, 7]', more=more)
    run.run_for("1500 ms")
    shown = [row[1] for row in point_rows(run.points)]
    assert shown == ["9.00", "9", "7.0"] and repr(run.points["f"]) == "<point f: 9.00 V>"
    assert [value_cells(value, run.points[value.name])[0] for value in run.points.now()] == shown
    run.stop()
    rows = (tmp_path / "rows.csv").read_text("utf-8").splitlines()[1:]
    assert [line.split(",")[1:4] for line in rows] == [["f", "9.00", "V"], ["g", "9", ""], ["n", "7.0", ""]]
    assert (tmp_path / "columns.csv").read_text("utf-8").splitlines()[-1].split(",")[1:] == shown
    numbers = [json.loads(line)["value"] for line in (tmp_path / "lines.jsonl").read_text("utf-8").splitlines()]
    assert numbers == [9.0, 9.0, 7]


def test_every_multiple_of_a_tenth_is_written_shortly(tmp_path: Path) -> None:
    device = f'"40001": [{", ".join(str(number) for number in range(100, 200))}]'
    points = "\n".join(f'p{at}: {{channel: 1, address: "{40001 + at}", scale: 0.1}}' for at in range(100))
    found = values_after(run_of(tmp_path, points, device))
    assert [repr(value) for value in found.values()] == [f"{(100 + at) // 10}.{(100 + at) % 10}" for at in range(100)]


def test_what_is_no_number_fails_and_the_last_value_stays(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001", type: float32, order: ABCD}', '"40001": [0x4120, 0]')
    run.run_for("500 ms")
    device = run.device("meter")
    device.write("40001", [0x7FC0, 0])
    run.run_for("1 s")
    now = run.points["a"].now
    assert (now.value, now.quality, now.reason) == (10.0, "failed", "not a number (NaN)")
    device.write("40001", [0x4120, 0])
    run.run_for("1 s")
    assert run.points["a"].quality == "good"
    run.stop()


# ---- planned reads ----------------------------------------------------------------------------------------------


def reads_of(run: VirtualRun) -> list[tuple[str, int]]:
    return [(block.targets[0], block.count) for block in run.run.blocks if block.instruction == "read"]


TANK = """protocol: tank
extends: standard
groups:
  request: {from: client, head: [{const: STX}], tail: [{const: ETX}]}
  reply: {from: server, head: [{const: ACK}], tail: [{const: ETX}]}
frames:
  ASK: {group: request, body: [{text: A}, {field: page, type: u8}]}
  STATE:
    group: reply
    body:
      - {field: page, type: u8}
      - {field: level, type: i32}
      - {field: total, type: u64}
      - {field: temperature, type: f64}
      - {field: mode, type: ascii, size: 3}
      - {field: extra, type: u8, when: page == 2}
station: {type: none}
state: {level: {scope: device, type: i32, initial: -7}}
services:
  state:
    - takes: {page: {type: number, range: 0..9}}
      request: {ASK: {page: page}}
      reply:
        STATE:
          page: page
          level: -70000 + page
          total: 0xFFFFFFFFFFFFFFFF
          temperature: 0.1
          mode: "'RUN'"
          extra: 5 if page == 2 else none()
      gives:
        level: reply.level
        total: reply.total
        temperature: reply.temperature
        mode: reply.mode
        extra: either(reply.extra, none())
"""


def tank_of(folder: Path, points: str) -> VirtualRun:
    """Write a run with these points, and a device that answers one service."""
    (folder / "tank.yaml").write_text(TANK, "utf-8")
    (folder / "tank.device.yaml").write_text("device: one\nprotocol: tank.yaml\n", "utf-8")
    lines = "\n".join(f"  {line}" for line in points.strip().splitlines())
    text = f'run: plant\nchannels:\n  1: {{port: "sim:tank.device.yaml", protocol: tank.yaml}}\npoints:\n{lines}\n'
    (folder / "plant.run.yaml").write_text(text, "utf-8")
    return VirtualRun(folder / "plant.run.yaml")


def test_results_of_one_call_come_in_one_request(tmp_path: Path) -> None:
    run = tank_of(tmp_path, """
level: {channel: 1, call: state, with: {page: 1}, type: int32, scale: 0.5}
mode: {channel: 1, call: state, with: {page: 1}}
total: {channel: 1, call: state, with: {page: 1}, type: uint64}
warm: {channel: 1, call: state, with: {page: 1}, result: temperature}
short: {channel: 1, call: state, with: {page: 1}, result: temperature, type: float32, decimals: 3}
other: {channel: 1, call: state, with: {page: 2}, result: level}
extra: {channel: 1, call: state, with: {page: 2}, type: uint8}
slow: {channel: 1, call: state, with: {page: 1}, result: level, every: 2 s}
""")  # fmt: skip
    blocks = [(block.instruction, block.name, dict(block.arguments)) for block in run.run.blocks]
    assert blocks == [
        ("call", "level, mode, total, …", {"page": "1"}),
        ("call", "other, extra", {"page": "2"}),
        ("call", "slow", {"page": "1"}),
    ]
    assert values_after(run) == {
        "level": -34999.5, "mode": "RUN", "total": 0xFFFF_FFFF_FFFF_FFFF, "warm": 0.1, "short": 0.1,
        "other": -69998, "extra": 5, "slow": -69999,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ("result: extra, type: uint8", "the reply has no 'extra'"),
        ("result: total", "'total' cannot be stored"),  # more than an int64
        ("result: level, type: uint32", "'level' cannot be stored"),
        ("result: mode, type: string, size: 2", "'mode' has 3 characters, and there is room for 2"),
    ],
)
def test_a_result_that_no_place_holds_fails(tmp_path: Path, keys: str, reason: str) -> None:
    run = tank_of(tmp_path, f"one: {{channel: 1, call: state, with: {{page: 1}}, {keys}}}")
    run.run_for("1500 ms")
    now = run.points["one"].now
    assert (now.value, now.quality) == (None, "failed") and reason in now.reason, now
    run.stop()


def test_neighbours_come_in_one_request(tmp_path: Path) -> None:
    points = """
a: {channel: 1, address: "40001"}
c: {channel: 1, address: "40004"}
b: {channel: 1, address: "40002", type: float32}
far: {channel: 1, address: "40010"}
slow: {channel: 1, address: "40005", every: 5 s}
bit: {channel: 1, address: "00001"}
next: {channel: 1, address: "00002"}
"""
    run = run_of(tmp_path, points, '"40001": [1, 2, 3, 4]')
    assert sorted(reads_of(run)) == [("00001", 2), ("40001", 4), ("40005", 1), ("40010", 1)]
    run.stop()


def test_a_gap_is_read_where_the_run_says_so(tmp_path: Path) -> None:
    points = 'a: {channel: 1, address: "40001"}\nb: {channel: 1, address: "40010"}'
    run = run_of(tmp_path, points, '"40001": [1]', more="merge: {gap: 8}\n")
    assert reads_of(run) == [("40001", 10)]
    run.stop()


def test_no_point_is_cut_by_the_end_of_a_request(tmp_path: Path) -> None:
    """A Modbus request has at most 125 registers.

    A double word must not be read half by one request and half by the next.
    """
    points = "\n".join(f'p{at}: {{channel: 1, address: "{40001 + 2 * at}", type: uint32}}' for at in range(100))
    run = run_of(tmp_path, points, '"40001": [1]')
    assert reads_of(run) == [("40001", 124), ("40125", 76)]
    run.stop()


PLACES = {
    "modbus-tcp": (1, lambda at: f"{40001 + at}", "40001", ("word", "int16", "uint32", "float32", "int64")),
    "mldp": (2, lambda at: f"%MW{100 + at}", "%MW100", ("word", "int16", "uint32", "float32")),
    "modbus-rtu": (3, lambda at: f"{40001 + at}", "40001", ("word", "int16", "uint32", "float32")),
    "df1": (1, lambda at: f"N7:{at}", "N7:0", ("word", "int16", "uint32", "float32")),
}


@pytest.mark.parametrize("protocol", PLACES)
@pytest.mark.parametrize("seed", range(3))
def test_planned_reads_bring_what_single_reads_bring(tmp_path: Path, protocol: str, seed: int) -> None:
    station, place, first, types = PLACES[protocol]
    rng = random.Random(seed)
    words = [rng.randrange(0x3F00, 0x4700) for _ in range(40)]
    chosen = [(at, rng.choice(types)) for at in rng.sample(range(36), 14)]
    points = "\n".join(
        f'p{n}: {{channel: 1, address: "{place(at)}", type: {type_}}}' for n, (at, type_) in enumerate(chosen)
    )
    run = run_of(tmp_path, points, f'"{first}": {words}', protocol=protocol, station=station)
    run.run_for("4 s")
    device = run.device("meter")
    wanted = {f"p{n}": device.read(place(at), type=type_)[0] for n, (at, type_) in enumerate(chosen)}
    assert {value.name: value.value for value in run.points.now()} == wanted
    assert len(reads_of(run)) < 14
    run.stop()


# ---- quality and time -------------------------------------------------------------------------------------------


def test_quality_follows_the_device(tmp_path: Path) -> None:
    faults = "faults: gone\nrules:\n  - {fault: no_reply, from: 3 s, until: 9500 ms}\n"
    (tmp_path / "gone.faults.yaml").write_text(faults, "utf-8")
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001"}', '"40001": 7')
    text = (tmp_path / "plant.run.yaml").read_text("utf-8").replace("station: 1}", "station: 1, faults: gone}")
    run.stop()
    (tmp_path / "plant.run.yaml").write_text(text, "utf-8")
    run = VirtualRun(tmp_path / "plant.run.yaml")
    assert run.points["a"].now == PointValue("a")
    changes: list[tuple[str, Any]] = []
    run.points.watch(lambda value: changes.append((value.quality, value.value)))
    run.run_for("20 s")
    assert changes == [("good", 7), ("failed", 7), ("good", 7)]
    run.stop()


def test_points_that_were_never_read_have_failed_where_the_port_is_refused(tmp_path: Path) -> None:
    async def main() -> PointValue:
        with socket() as refused:  # bound, and nothing listens
            refused.bind(("127.0.0.1", 0))
            lines = RUN.format(protocol="modbus-tcp", station=1, points='  a: {channel: 1, address: "40001"}')
            text = lines.replace("sim:meter.device.yaml", f"tcp://127.0.0.1:{refused.getsockname()[1]}")
            (tmp_path / "plant.run.yaml").write_text(text, "utf-8")
            async with AsyncRun(tmp_path / "plant.run.yaml") as run:
                return await run.points["a"].changed(timeout=60)

    value = asyncio.run(main())
    assert (value.value, value.quality) == (None, "failed")
    assert value.reason.endswith("the device is on") and value.text_time


def test_a_value_that_is_not_read_for_long_is_stale(tmp_path: Path) -> None:
    run = run_of(
        tmp_path, 'a: {channel: 1, address: "40001"}\nb: {channel: 1, address: "40001", stale: 20 s}', '"40001": 7'
    )
    run.run_for("1500 ms")
    run.enable_channel(1, False)
    run.run_for("3 s")
    a, b = run.points["a"], run.points["b"]
    assert (a.value, a.quality, a.reason, b.quality) == (7, "stale", "not read for 3 s", "good")
    run.enable_channel(1, True)
    run.run_for("2 s")
    assert a.quality == "good"
    run.stop()


def test_the_time_is_that_of_the_reply(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001"}', '"40001": 7', protocol="modbus-rtu")
    run.run_for("200 ms")
    request_and_reply, gap = 8 + 7, 3  # characters of 11 bits at 19200
    least = (request_and_reply + gap) * 11 / 19200
    time = run.points["a"].time
    assert time is not None
    seconds = time.timestamp() % 60
    assert least <= seconds < least + 0.02
    assert run.points["a"].now.text_time.startswith("2000-01-01T00:00:00.0")
    run.stop()


def test_small_changes_are_not_told(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001", scale: 0.1, deadband: 0.5}', '"40001": 100')
    changes: list[Any] = []
    run.points.watch(lambda value: changes.append(value.value))
    run.run_for("500 ms")
    for number in (103, 105, 106, 110, 112, 100):
        run.device("meter").write("40001", number)
        run.run_for("1 s")
    assert changes == [10.0, 10.6, 11.2, 10.0]
    assert run.points["a"].value == 10.0
    run.stop()


OWN = """run: own
memory: masterlogic
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
points:
  free: {address: M100, access: rw, range: 0..50}
  read: {address: M201, scale: 0.1}
blocks:
  0: {read: "40001", count: 4, into: M200, channel: 1, every: 1 s}
"""


def test_points_of_the_own_memory_follow_it_and_its_blocks(tmp_path: Path) -> None:
    device_in(tmp_path, '"40001": [1, 2, 3]')
    (tmp_path / "own.run.yaml").write_text(OWN, "utf-8")
    run = VirtualRun(tmp_path / "own.run.yaml")
    changes: list[tuple[str, Any, str]] = []
    run.points.watch(lambda value: changes.append((value.name, value.value, value.quality)))
    run.run_for("500 ms")
    assert (run.points["free"].now.value, run.points["read"].now.quality) == (0, "stale")
    run.run_for("1 s")
    run.memory["M100"] = 5
    run.run_for("1 ms")
    run.points["free"].write(6)
    run.run_for("1 ms")
    assert changes == [("free", 0, "good"), ("read", 0.2, "good"), ("free", 5, "good"), ("free", 6, "good")]
    assert run.memory["M100"] == 6
    run.stop()


# ---- writing ----------------------------------------------------------------------------------------------------


def test_values_are_written_one_after_the_other_and_read_anew(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001", scale: 0.1, access: rw, every: 1 h}', '"40001": 7')
    run.run_for("10 ms")
    ends: list[Any] = []
    for value in (35.5, 36, 37.24):
        run.points["a"].write(value, done=ends.append)
    run.run_for("1 s")
    assert (ends, run.device("meter").read("40001"), run.points["a"].value) == ([None, None, None], [372], 37.2)
    run.stop()


@pytest.mark.parametrize(
    ("value", "why"),
    [
        (101, "101 is not in 0..100, the range of a"),
        (float("nan"), "nan is no number"),
        ("much", "'much' is no number"),
        (None, "None is no number"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_sent(tmp_path: Path, value: Any, why: str) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001", access: rw, range: 0..100}', '"40001": 7')
    run.run_for("10 ms")
    with pytest.raises(RequestError, match=why.replace(".", r"\.")):
        run.points["a"].write(value)
    run.run_for("100 ms")
    assert run.device("meter").read("40001") == [7]
    run.stop()


def test_a_point_is_read_only_unless_it_says_otherwise(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001"}', '"40001": 7')
    with pytest.raises(RequestError, match="'a' can only be read – access: rw of the point allows it"):
        run.points["a"].write(1)
    with pytest.raises(KeyError, match="there is no point 'b'"):
        run.points["b"]
    run.stop()


def test_a_write_that_fails_says_so(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001", station: 9, access: rw}', '"40001": 7')
    run.run_for("10 ms")
    ends: list[Any] = []
    run.points["a"].write(1, done=ends.append)
    run.run_for("30 s")
    assert [str(end) for end in ends] == ["no_reply"]
    run.stop()


def test_a_word_is_written_in_the_scale_it_is_read_in(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001", scale: 10, enum: {20: half}, access: rw}', '"40001": 0')
    run.run_for("10 ms")
    run.points["a"].write("half")
    run.run_for("1 s")
    assert (run.device("meter").read("40001"), run.points["a"].value) == ([2], "half")
    run.stop()


def test_a_rounded_value_stays_within_its_range(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001", scale: 0.5, access: rw, range: 0..0.3}', '"40001": 0')
    run.run_for("10 ms")
    with pytest.raises(RequestError, match=r"0\.3 is not in 0\.\.0\.3"):
        run.points["a"].write(0.3)
    run.stop()


def test_writes_that_never_happen_are_told(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001", access: rw}', '"40001": 0')
    with pytest.raises(RequestError, match="the run is not at work"):
        run.points["a"].write(1)
    run.run_for("10 ms")
    run.enable_channel(1, False)
    ends: list[Any] = []
    run.points["a"].write(1, done=ends.append)
    run.reset()
    run.points["a"].write(2, done=ends.append)
    run.stop()
    assert [str(end) for end in ends] == ["closed: the run was reset", "closed: the run was stopped"]


def test_listeners_that_end_or_fail_leave_the_others_alone(tmp_path: Path) -> None:
    run = run_of(tmp_path, 'a: {channel: 1, address: "40001"}', '"40001": 7')
    changes: list[Any] = []
    ends: list[Any] = []

    def once(value: PointValue) -> None:
        ends.pop()()

    ends.append(run.points.watch(once))
    run.points.watch(lambda value: 1 // 0)
    run.points.watch(lambda value: changes.append(value.value))
    run.run_for("1500 ms")
    assert changes == [7]
    run.stop()


BITS = """run: bits
memory: masterlogic
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 9}
points:
  bit: {address: M02000}
  clock: {address: F00093}
blocks:
  0: {read: "00001", into: M02000, channel: 1, every: 1 s}
"""


def test_a_change_beside_a_point_is_none_and_clock_bits_tick(tmp_path: Path) -> None:
    device_in(tmp_path, '"40001": 1')
    (tmp_path / "bits.run.yaml").write_text(BITS, "utf-8")
    run = VirtualRun(tmp_path / "bits.run.yaml")
    changes: list[tuple[str, Any, str]] = []
    run.points.watch(lambda value: changes.append((value.name, value.value, value.quality)))
    run.run_for("2600 ms")
    run.memory["M02005"] = 1
    run.run_for("1 ms")
    assert [change for change in changes if change[0] == "bit"] == [("bit", None, "failed")]
    assert len([change for change in changes if change[0] == "clock"]) >= 4
    run.stop()


# ---- files ------------------------------------------------------------------------------------------------------

TABLE = """name,address,type,scale,unit,enum
temperature,40001,,0.1,°C,
state,40002,,,,0=off;2=heating
"""
GROUPS = """run: two
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp}
points:
  - {file: meter.csv, channel: 1, station: 1, prefix: one, every: 2 s}
  - {file: more, channel: 1, station: 1}
"""


def test_tables_and_files_for_several_devices(tmp_path: Path) -> None:
    device_in(tmp_path, '"40001": [217, 2]')
    (tmp_path / "meter.csv").write_text(TABLE, "utf-8")
    (tmp_path / "more.points.yaml").write_text('points: more\nvalues:\n  state: {address: "40002"}\n', "utf-8")
    (tmp_path / "two.run.yaml").write_text(GROUPS, "utf-8")
    run = VirtualRun(tmp_path / "two.run.yaml")
    assert values_after(run) == {"one.temperature": 21.7, "one.state": "heating", "state": 2}
    assert {point.unit for point in run.run.points} == {"°C", ""}


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        ("", "1:1: the first row does not name the columns name and address"),
        ("name,address\na,40001\na,40002\n", "3:1: there are two points 'a'"),
        ("name,address,gain\na,40001,2\n", "2:3: unknown key 'gain' in point 'a' – write scale"),
        ("name,address,scale\na,40001,much\n", "2:3: 'much' is not a number (0.1 or -40), in point 'a'"),
        ("name,address\na,\n", "2:1: missing key 'address' in point 'a'"),
        ("name,address\na,40001,7\n", "2:1: unknown key 'column 3' in point 'a'"),
    ],
)
def test_what_is_wrong_with_a_table_is_told_by_row_and_column(tmp_path: Path, table: str, problem: str) -> None:
    (tmp_path / "meter.csv").write_text(table, "utf-8")
    (tmp_path / "two.run.yaml").write_text(GROUPS.replace("  - {file: more, channel: 1, station: 1}\n", ""), "utf-8")
    with pytest.raises(DefinitionError) as error:
        loaded(tmp_path / "two.run.yaml")
    assert any(f"meter.csv:{problem}" in str(reported) for reported in error.value.problems), error.value


@pytest.mark.parametrize(
    ("points", "problem"),
    [
        ("points: []\n", "'points' is empty – write at least one entry"),
        ("points: {}\n", "'points' is empty – write at least one entry"),
        (
            "points:\n  - {file: own, every: 2 s}\nmemory: masterlogic\n",
            "'every' has no effect: without a channel nothing is read – remove it",
        ),
    ],
)
def test_points_without_effect(tmp_path: Path, points: str, problem: str) -> None:
    (tmp_path / "own.points.yaml").write_text("points: own\nvalues: {a: {address: M5}}\n", "utf-8")
    head = GROUPS.partition("points:")[0]
    (tmp_path / "two.run.yaml").write_text(head + points, "utf-8")
    with pytest.raises(DefinitionError) as error:
        loaded(tmp_path / "two.run.yaml")
    assert [str(reported).partition(": ")[2] for reported in error.value.problems] == [problem]
