"""Devices with behaviours that change their memory: each kind of behaviour on the virtual clock."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import framekit
from framekit.cli.main import main
from framekit.codec.support import times
from framekit.link.packing import typed_at
from framekit.runfile.behave import RecordedError, recorded
from framekit.runfile.devices import DeviceSettings, load_devices
from framekit.service.device import DeviceStore
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
HEAD = "device: oven\nprotocol: modbus-tcp\nstation: 1\n"


class World:
    """A running device on its own clock, without a line."""

    def __init__(self, folder: Path, text: str) -> None:
        file = folder / "oven.device.yaml"
        file.write_text(HEAD + text, "utf-8")
        self.clock = VirtualClock()
        self.store = DeviceStore(load_devices(file, folder)[0], self.clock)
        self.troubles: list[str] = []
        self.store.troubles.append(self.troubles.append)
        self.store.begin()

    def values(self, address: str, seconds: int, every: float = 1, type_: str | None = None) -> list[Any]:
        """Return the current value and the values after each step, for so many seconds."""
        found = [self.read(address, type_)]
        for _ in range(round(seconds / every)):
            self.clock.run_for(round(every * SECOND))
            found.append(self.read(address, type_))
        return found

    def read(self, address: str, type_: str | None = None) -> Any:
        form = typed_at(self.store.device.grammar, address, type_, None, 1)
        place = self.store.device.grammar.parse(address)
        area = self.store.memory.area(place.area)
        numbers = area.read_from(place.first_bit, form.carrier, form.units)
        return form.values(area.read_bits(place.first_bit, form.bits), numbers)[0]

    def write(self, address: str, value: int) -> None:
        place = self.store.device.grammar.parse(address)
        self.store.memory.area(place.area).write_from(place.first_bit, place.unit, [value])


Make = Callable[[str], World]


@pytest.fixture
def made(tmp_path: Path) -> Make:
    return lambda text: World(tmp_path, text)


@pytest.mark.parametrize(
    ("keys", "values"),
    [
        ("ramp: 0..100, over: 4 s", [0, 25, 50, 75, 0, 25]),
        ("ramp: 100..0, over: 4 s, then: stay", [100, 75, 50, 25, 0, 0]),
        ("ramp: 0..100, over: 2 s, then: back", [0, 50, 100, 50, 0, 50]),
        ("ramp: 0..10, over: 4 s, scale: 0.1, offset: -1", [10, 35, 60, 85, 10, 35]),
        ("ramp: 0..100, over: 4 s, every: 2 s", [0, 0, 50, 50, 0, 0]),
        ("ramp: 5..9, over: 4 s, after: 2 s", [0, 0, 5, 6, 7, 8]),
        ("sine: 0..200, period: 4 s", [100, 200, 100, 0, 100, 200]),
        ("square: 3..7, period: 4 s", [3, 3, 7, 7, 3, 3]),
        ("square: 3..7, period: 4 s, pulse: 1 s", [3, 3, 3, 7, 3, 3]),
        ("hold: 21.5, scale: 0.1", [215] * 6),
        ("hold: 7, after: 3 s", [0, 0, 0, 7, 7, 7]),
        ("counter: 3, start: 10", [10, 13, 16, 19, 22, 25]),
        ("counter: 3, start: 65530", [65530, 65533, 0, 3, 6, 9]),
        ("counter: 0 - 2, start: 3, type: uint16", [3, 1, 65535, 65533, 65531, 65529]),
        ("counter: 30000, type: int16", [0, 30000, 65536 - 5536, 24464, 65536 - 11072, 18928]),
        ("counter: 1, every: 2 s, after: 1 s", [0, 0, 0, 1, 1, 2]),
        ("follow: 70000", [65535] * 6),
        ("follow: 0 - 1", [0] * 6),
        ("follow: 9, after: 2 s, start: 4", [4, 4, 9, 9, 9, 9]),
        ("follow: 1000, lag: 2 s", [round(1000 * (1 - math.exp(-time / 2))) for time in range(6)]),
        ("follow: 12000, type: bcd16", [0x9999] * 6),
        ("follow: 7 / 2, scale: 0.1", [35] * 6),
        ("follow: 0.1 + 0.2 * 2, scale: 0.1", [5] * 6),
        ("follow: 7 / 2 // 1", [3] * 6),
        ("counter: 1 / 4, scale: 0.01", [0, 25, 50, 75, 100, 125]),
    ],
)
def test_what_a_behaviour_does(made: Make, keys: str, values: list[int]) -> None:
    assert made(f'behave: {{"40001": {{{keys}}}}}').values("40001", 5) == values


def test_chance_is_repeated_by_its_seed_and_stays_within_its_limits(made: Make) -> None:
    text = """
behave:
  "40001": {random walk: 10..20, step: 4, start: 15}
  "40002": {random walk: 10..20, step: 4, start: 15}
  "40003": {noise: 1..6, seed: 3}
"""
    walk, other, noise = (made(text).values(address, 100) for address in ("40001", "40002", "40003"))
    assert [walk, other, noise] == [made(text).values(address, 100) for address in ("40001", "40002", "40003")]
    assert walk[0] == 15
    assert walk != other
    assert (min(walk), max(walk)) == (10, 20)
    assert max(abs(one - two) for one, two in itertools.pairwise(walk)) <= 4
    assert set(noise) == {1, 2, 3, 4, 5, 6}
    assert noise != made(text.replace("seed: 3", "seed: 4")).values("40003", 100)


def test_expressions_read_names_and_addresses_in_their_own_scale(made: Make) -> None:
    world = made("""
behave:
  "40001": {follow: power > 500 or '40020' == 3}
  "40002": {follow: voltage * current, name: power}
  "40003": {hold: 230.5, scale: 0.1, name: voltage}
  "40004": {hold: 2.5, type: float32, name: current}
  "10001": {follow: "bit('40020', 1)"}
""")
    assert (world.read("40002"), world.read("40001"), world.read("10001")) == (576, 1, 0)
    world.write("40003", 1000)
    world.write("40020", 2)
    world.clock.run_for(SECOND)
    assert (world.read("40002"), world.read("40001"), world.read("10001")) == (250, 0, 1)
    world.write("40020", 3)
    world.clock.run_for(SECOND)
    assert world.read("40001") == 1


def test_an_address_reads_the_behaviour_that_stands_there_whatever_its_width(made: Make) -> None:
    world = made("""
behave:
  "40001": {follow: "'40010' * 10"}
  "40002": {follow: "'40012'", type: int32}
  "40010": {hold: 1.4, type: float32, name: gain}
  "40012": {hold: -70000, type: int32}
""")
    assert (world.read("40001"), world.read("40002", "int32")) == (14, -70000)


def test_an_address_within_a_behaviour_is_an_error(tmp_path: Path) -> None:
    behave = """behave: {"40010": {hold: 1.4, type: float32}, "40001": {follow: "'40011' + 1"}}"""
    with pytest.raises(framekit.DefinitionError) as error:
        World(tmp_path, behave)
    (problem,) = error.value.problems
    assert problem.what == "40011 holds a piece of 40010 (float32), which behaves"
    assert problem.todo == "use '40010'"
    assert (problem.at.line, problem.at.column) == (4, behave.index("'40011'") + 1)


@pytest.mark.parametrize(
    ("keys", "values"),
    [
        ("start: 65535, counter: step", [65535, 0, 0, 1, 2, 3, 4]),
        ("start: 0, counter: 0 - step", [0, 65535, 65534, 65534, 65533, 65532, 65532]),
        ("start: 131070, counter: step + step, scale: 2", [65535, 0, 0, 1, 2, 3, 4]),
        ("start: 7, counter: 400000 + step", [7, 6792, 13576, 20361, 27146, 33931, 40716]),
    ],
)
def test_a_counter_keeps_its_fraction_over_the_end_of_its_type(made: Make, keys: str, values: list[int]) -> None:
    step = '"40003": {hold: 0.75, type: float32, name: step}'
    assert made(f'behave: {{"40001": {{{keys}}}, {step}}}').values("40001", 6) == values


def test_what_others_write_is_what_a_counter_goes_on_from_and_fractions_are_kept(made: Make) -> None:
    world = made('behave: {"40001": {counter: "\'40002\'", scale: 2}, "40002": {hold: 1}}')
    assert world.values("40001", 4) == [0, 0, 1, 2, 2]  # 0.5 and 1.5 are rounded to even
    world.write("40001", 100)
    assert world.values("40001", 3) == [100, 100, 101, 102]


def test_what_goes_on_reads_what_the_others_were_before(made: Make) -> None:
    """A counter reads the previous values of others, so a cycle through it does not depend on the order in the file."""
    lines = ['"40001": {counter: 1, name: a, start: 1}', '"40002": {counter: a, name: b}', '"40003": {follow: a + b}']
    found = []
    for order in (lines, lines[::-1]):
        world = made(f"behave:\n  {order[0]}\n  {order[1]}\n  {order[2]}\n")
        found.append([world.values("40003", 0), *([world.values("40003", 1)[1]] for _ in range(4))])
    assert found[0] == found[1] == [[1], [3], [6], [10], [15]]


def test_what_cannot_be_worked_out_changes_nothing_and_is_told_once(made: Make) -> None:
    world = made("""
behave:
  "40001": {follow: 100 // '40005'}
  "40002": {follow: level + 1, type: float32}
  "40006": {follow: 100 / '40005'}
  "40004": {hold: 4}
  "40010": {hold: 1, type: float32, name: level}
""")
    world.clock.run_for(3 * SECOND)
    assert sorted(world.troubles) == [
        "the behaviour of 40001: integer division or modulo by zero", "the behaviour of 40006: division by zero"
    ]  # fmt: skip
    world.troubles.clear()
    world.write("40005", 5)
    world.clock.run_for(SECOND)
    assert (world.read("40001"), world.read("40006")) == (20, 20)
    world.write("40005", 0)
    world.write("40011", 0x7F80)  # the level is infinite
    world.clock.run_for(2 * SECOND)
    assert (world.read("40001"), world.read("40002", "float32")) == (20, 2.0)
    assert sorted(world.troubles) == [
        "the behaviour of 40001: integer division or modulo by zero",
        "the behaviour of 40002: the number is infinite",
        "the behaviour of 40006: division by zero",
    ]


def test_a_late_clock_skips_what_was_missed_and_counters_lose_nothing(made: Make) -> None:
    world = made('behave: {"40001": {counter: 1, every: 1 ms}, "40002": {ramp: 0..1000, over: 1 s, every: 10 ms}}')
    behaving = world.store.behaving
    assert behaving is not None
    behaving.tick(345_678_901)
    assert (world.read("40001"), world.read("40002")) == (345, 340)
    assert behaving.deadline == 346_000_000


def test_an_end_is_the_end(made: Make) -> None:
    world = made('behave: {"40001": {counter: 1}}')
    world.clock.run_for(2 * SECOND)
    world.store.end()
    assert world.clock.next_call is None
    world.clock.run_for(2 * SECOND)
    world.store.begin()
    world.clock.run_for(SECOND)
    assert world.read("40001") == 5


def test_each_station_behaves_and_a_second_protocol_shares_the_memory(tmp_path: Path) -> None:
    file = tmp_path / "two.device.yaml"
    file.write_text(
        'device: two\nprotocol: modbus-rtu\nstation: [1, 2]\nbehave: {"40001": {noise: 0..60000}}\n', "utf-8"
    )
    (tmp_path / "both.device.yaml").write_text(
        "device: both\nprotocol: modbus-rtu\nalso: modbus-ascii\nstation: 3\nbehave: {'40001': {hold: 100}}\n", "utf-8"
    )
    clock = VirtualClock()
    stores = [DeviceStore(device, clock) for device in load_devices(file, tmp_path)]
    for store in stores:
        store.begin()
    first, second = (store.memory.area("holding").read("word", 0) for store in stores)
    assert first != second
    assert [len(device.behaviours) for device in load_devices(tmp_path / "both.device.yaml", tmp_path)] == [1, 0]


def test_a_served_device_behaves_before_anyone_has_connected(tmp_path: Path) -> None:
    """Behaviours run once for all connections; they share the memory with the clients' writes."""
    file = tmp_path / "oven.device.yaml"
    file.write_text(
        HEAD + 'behave: {"40001": {counter: 1, every: 1 ms}, "40003": {follow: "1 // \'40004\'"}}\n', "utf-8"
    )

    async def main() -> tuple[int, list[str], int]:
        seen: list[str] = []
        async with framekit.aserve(
            file, "tcp-listen://127.0.0.1:0", monitor=lambda one: seen.append(one.reason)
        ) as server:
            while not (before := server.memory.read("40001")[0]):
                await asyncio.sleep(0)
            url = server.port.replace("tcp-listen", "tcp")
            found = []
            for _ in range(2):
                async with framekit.aconnect("modbus-tcp", url, station=1) as client:
                    found += await client.read("40001")
            assert before <= found[0] <= found[1]
            return before, seen, server.line_errors["could not be worked out"]

    before, seen, counted = asyncio.run(main())
    assert before > 0
    assert "the behaviour of 40003: integer division or modulo by zero" in seen
    assert counted == 1


def test_numbers_with_fractions_are_multiplied_and_texts_are_not() -> None:
    assert times(0.5, 3) == 1.5
    with pytest.raises(TypeError):
        times("a", 3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "keys", ["noise: 0.3", "sine: a..b, period: 1 s", "ramp: 1.., over: 1 s", "square: 1..2..3, period: 1 s"]
)
def test_a_range_that_is_none_is_an_error_with_its_place(tmp_path: Path, keys: str) -> None:
    with pytest.raises(framekit.DefinitionError) as error:
        World(tmp_path, f'behave: {{"40001": {{{keys}}}}}')
    (problem,) = error.value.problems
    text = keys.partition(",")[0].partition(": ")[2]
    assert (problem.at.line > 0, problem.what) == (True, f"'{text}' is not a range (0..100)")


def test_start_values_that_nobody_sees_are_errors(tmp_path: Path) -> None:
    memory = 'memory: {set: {"40001": 1, "40002": [1, 2], "40003": 3, "40004": 4, "40005": 5}}'
    behave = """
behave:
  "40001": {hold: 1}
  "40002": {counter: 1}
  "40003": {noise: 0..1}
  "40004": {follow: 3, after: 1 s}
  "40005": {follow: 3, lag: 1 s}
"""
    with pytest.raises(framekit.DefinitionError) as error:
        World(tmp_path, memory + behave)
    assert [(problem.at.column, problem.what) for problem in error.value.problems] == [
        (memory.index('"40001"') + 1, "'40001' has no effect: its value is that of behave: from the start on"),
        (memory.index('"40003"') + 1, "'40003' has no effect: its value is that of behave: from the start on"),
    ]
    given = DeviceSettings(initial={"40001": "5"})
    with pytest.raises(framekit.DefinitionError, match="--set 40001=5: '40001' has no effect"):
        load_devices(tmp_path / "oven.device.yaml", tmp_path, given)


# ---- replay ---------------------------------------------------------------------------------------------------

METER = """
run: meter
channels:
  1: {port: "sim:oven.device.yaml", protocol: modbus-tcp, station: 1}
points:
  level: {channel: 1, address: "40001", scale: 0.1, unit: m}
  other: {channel: 1, address: "40002"}
sinks: [{csv: rows.csv}, {csv: columns.csv, every: 1 s}, {jsonl: lines.jsonl}, {sqlite: kept.db}]
"""


def test_what_sinks_have_kept_is_replayed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "oven.device.yaml").write_text(
        HEAD + 'behave: {"40001": {ramp: 10..50, over: 4 s, then: back}, "40002": {counter: 1}}\n', "utf-8"
    )
    (tmp_path / "meter.run.yaml").write_text(METER, "utf-8")
    with framekit.VirtualRun(tmp_path / "meter.run.yaml") as run:
        run.run_for("6.5 s")
    assert main(["history", str(tmp_path / "kept.db"), "--point", "level", "--csv"]) == 0
    (tmp_path / "printed.csv").write_text(capsys.readouterr().out, "utf-8")
    for file in ("rows.csv", "columns.csv", "lines.jsonl", "kept.db", "printed.csv"):
        point = "" if file == "printed.csv" else ", point: level"
        world = World(tmp_path, f'behave: {{"40007": {{replay: {file}{point}, scale: 0.01}}}}')
        found = world.values("40007", 8)
        assert found[:6] == [100, 200, 300, 400, 500, 400], file
        assert found[-1] == (400 if file == "columns.csv" else 300)  # its lines hold the values of a second before


def test_a_replay_begins_again_where_it_shall(tmp_path: Path) -> None:
    lines = ["time,level", "2026-01-01T00:00:02Z,7", "2026-01-01T00:00:00Z,5", "2026-01-01T00:00:01Z,", ""]
    (tmp_path / "a.csv").write_text("\n".join(lines), "utf-8")
    text = 'behave: {"40001": {replay: a.csv, then: again}, "40002": {replay: a.csv, after: 2 s}}'
    assert World(tmp_path, text).values("40001", 6) == [5, 5, 7, 5, 5, 7, 5]
    assert World(tmp_path, text).values("40002", 6) == [0, 0, 5, 5, 7, 7, 7]


def test_lines_of_jsonl_end_at_a_line_feed_only(tmp_path: Path) -> None:
    lines = [
        f'{{"time": "2026-01-01T00:00:0{second}Z", "point": "a\u2028b\u0085", "value": {second}}}' for second in (3, 4)
    ]
    (tmp_path / "a.jsonl").write_text("\r\n".join(lines) + "\n", "utf-8", newline="")
    assert recorded(tmp_path / "a.jsonl", None) == ((0, SECOND), (3, 4))


def test_only_good_values_of_the_point_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("framekit.runfile.behave.MOST_VALUES", 2)
    file = tmp_path / "a.csv"
    rows = [f"2026-01-01T00:00:0{second}Z,{second},,{second // 3 or ''}\n" for second in range(5)]
    file.write_text("".join(["time,up,gone,few\n", *rows]), "utf-8")
    assert recorded(file, "few") == ((0, SECOND), (1, 1))
    with pytest.raises(RecordedError, match=r"a.csv has more than 2 values – cut it into pieces"):
        recorded(file, "up")
    file.write_text("time,point,value\n" + "2026-01-01T00:00:00Z,up,1\n" * 2 + "2026-01-01T00:00:00Z,up,\n", "utf-8")
    assert recorded(file, None) == ((0, 0), (1, 1))


@pytest.mark.parametrize(
    ("keys", "what"),
    [
        ("replay: none.csv", "none.csv cannot be read: No such file or directory – name a file of values"),
        ("replay: ../a.csv", "'../a.csv' leaves the folder of this file – name a file beside it"),
        ("replay: a.csv", "a.csv has several points: up, state, gone – say which by point:"),
        ("replay: a.csv, point: upp", "a.csv has no point 'upp' – did you mean 'up'?"),
        ("replay: a.csv, point: state", "a.csv has 'off', which is no number – replay another point"),
        ("replay: a.csv, point: gone", "a.csv has no good values – name another file or point"),
        ("replay: a.csv, point: up, type: int8", "300 does not fit into 40001 (int8) – give another number"),
        ("replay: b.csv", "b.csv, line 2, has no time and value – name a file of a sink, or framekit history --csv"),
        ("replay: c.csv", "c.csv has no column time first – name a file of a sink, or framekit history --csv"),
        ("replay: d.jsonl", "d.jsonl, line 1, is no value of a point – name a file of jsonl"),
        ("replay: e.db", "e.db cannot be read: "),
        ("replay: f.csv", "f.csv cannot be read: "),
    ],
)  # fmt: skip
def test_files_that_cannot_be_replayed(tmp_path: Path, keys: str, what: str) -> None:
    rows = "time,up (m),state,gone\n2026-01-01T00:00:00Z,1.5,off,\n2026-01-01T00:00:01Z,300,on,\n"
    files = {"a.csv": rows, "b.csv": "time,up\nnoon,3\n", "c.csv": "up,down\n", "d.jsonl": '{"time": 3}\n'}
    for name, text in files.items():
        (tmp_path / name).write_text(text, "utf-8")
    (tmp_path / "e.db").write_bytes(b"SQLite format 3\0 and nothing")
    (tmp_path / "f.csv").write_bytes(b"time,\xff\n")
    with pytest.raises(framekit.DefinitionError) as error:
        World(tmp_path, f'behave: {{"40001": {{{keys}}}}}')
    (problem,) = error.value.problems
    assert what in str(problem)
    assert (problem.at.line, problem.at.column) == (4, 28)
