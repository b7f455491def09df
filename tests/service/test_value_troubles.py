"""Values that do not come are reported when it happens: the cause, the points, and the end, each once."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from framekit.cli.main import main
from framekit.link.slow import SlowStation, SlowStations
from framekit.run.block_state import Failure
from framekit.run.model import RunModel
from framekit.run.trouble import TroubleReport
from framekit.runfile.run_file import load_run
from framekit.service import value_troubles
from framekit.service.run import RunService
from framekit.service.run_status import run_status
from framekit.service.value_troubles import FIRST_PAUSE, MOST_NAMED, cause_of, failure_text
from framekit.sinks.prometheus import _of_troubles
from framekit.transport.clock import VirtualClock
from framekit.transport.port import PortEvents

SECOND = 1_000_000_000

RUN = """run: r
channels:
  1: {port: "sim:d1.device.yaml", protocol: PROTOCOL, station: 1, faults: {seed: 3, rules: [RULES]}}
points:
POINTS
"""
THREE = """  a: {channel: 1, address: "40001"}
  b: {channel: 1, address: "40050"}
  c: {channel: 1, address: "40099"}
"""


BLOCKS = """run: r
memory: masterlogic
channels:
  1: {port: "sim:d1.device.yaml", protocol: modbus-rtu, station: 1, faults: {seed: 3, rules: [RULES]}}
blocks:
  0: {read: "40001", into: D00000, channel: 1ASKED}
"""


def write_blocks(folder: Path, rules: str = "", asked: str = ", every: 1 s", more: str = "") -> Path:
    """Write a run of block 0 and `more` blocks."""
    write(folder)
    path = folder / "r.run.yaml"
    path.write_text(BLOCKS.replace("RULES", rules).replace("ASKED", asked) + more)
    return path


SECOND_STATION = '  2: {read: "40001", into: D00001, channel: 1, station: 2, every: 1 s}\n'


def write(
    folder: Path, rules: str = "", points: str = THREE, memory: str = "40001: [7]", protocol: str = "modbus-rtu"
) -> Path:
    device = f"device: d1\nprotocol: {protocol}\nstation: 1\nmemory: {{set: {{{memory}}}}}\n"
    (folder / "d1.device.yaml").write_text(device)
    path = folder / "r.run.yaml"
    path.write_text(RUN.replace("PROTOCOL", protocol).replace("RULES", rules).replace("POINTS", points))
    return path


class World:
    """A run on virtual time, and the reports of its troubles with their times (s)."""

    def __init__(self, path: Path) -> None:
        self.clock = VirtualClock()
        self.service = RunService(load_run(path), self.clock)
        self.reports: list[tuple[float, str, str]] = []
        self.service.troubles.listen(self._hear)
        self.service.start()

    def _hear(self, report: TroubleReport) -> None:
        self.reports.append((self.clock.now() / SECOND, report.event, report.text))

    def run(self, seconds: float) -> list[str]:
        """Let time pass; return the new reports."""
        known = len(self.reports)
        self.clock.run_for(int(seconds * SECOND))
        return [text for _, _, text in self.reports[known:]]

    @property
    def shown(self) -> list[str]:
        return [f"{trouble.name}: {trouble.reason}" for trouble in run_status(self.service).troubles]


REFUSED_THIRD = {"good1": "40001", "good2": "40005", "gone": "40100"}
ALL = " – 3 points without a good value (a, b, c)"


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ("no_reply", "no reply"),
        ("error_reply", "refused 0x0002: illegal data address"),
        ("wrong_check", "no reply: 3 replies arrived, all with a wrong check code (expected "),
        ("wrong_station", "no reply: 3 replies arrived and could not be used, the last one – reply_adu: station is "),
    ],
)
def test_one_line_when_it_begins_and_one_when_it_ends(fault: str, cause: str, tmp_path: Path) -> None:
    world = World(write(tmp_path, f"{{fault: {fault}, from: 4 s, until: 90 s}}"))
    assert world.run(3.9) == [] and world.shown == []
    reports = world.run(86)
    begun = reports[0]
    wanted = cause.replace("no reply: 3", "damaged reply: 3") if fault == "wrong_check" else cause
    assert begun.startswith(f"channel 1: {wanted}") and begun.endswith(ALL)
    assert len(reports) <= 2, "it is not repeated while it lasts"
    assert world.shown and world.shown[0].startswith(f"channel 1: {wanted.split(':')[0]}")
    assert world.shown[0].endswith(ALL)
    reports = world.run(60)
    assert len(reports) == 1 and reports[0].startswith("channel 1: good values again after ")
    assert world.reports[-1][0] < 100, "soon after the device is well"
    assert world.shown == [] and world.service.problems == []


def test_a_lost_port_is_reported_until_values_come_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The port opens, and the device does not answer at first: that is the same trouble with another cause."""
    world = World(write(tmp_path, "{fault: no_reply, from: 30 s, until: 60 s}"))
    world.run(3)
    driver = world.service.channels[1].driver

    def refused(events: PortEvents) -> None:
        world.clock.call_soon(lambda: events.closed(world.clock.now(), "no such device"))

    with monkeypatch.context() as patch:
        patch.setattr(driver.port, "open", refused)
        driver.port.close()
        driver.closed(world.clock.now(), "unplugged")
        assert [text for *_, text in world.reports] == [f"channel 1: port not open: unplugged{ALL}"]
        assert world.run(29) == [f"channel 1: port not open: no such device{ALL}"]
        driver.longest_retry = 10 * SECOND
    assert all(line.startswith("channel 1: no reply – ") for line in world.run(25))
    assert world.run(30)[-1].startswith("channel 1: good values again after ")
    assert world.shown == []


def test_hundreds_of_points_that_fail_at_once_are_counted(tmp_path: Path) -> None:
    """The device refuses each point separately.

    The first report follows within seconds, the second lists all points.
    """
    points = "".join(f'  p{n:03}: {{channel: 1, address: "{40001 + 40 * n}", every: 20 s}}\n' for n in range(200))
    world = World(write(tmp_path, "{fault: error_reply, from: 100 ms, until: 200 s}", points))
    reports = world.run(80)
    assert 1 <= len(reports) <= 4
    assert all(
        "points without a good value (" in report and report.count("p") < 10 + 2 * MOST_NAMED for report in reports
    )
    assert world.shown[0].endswith(" – 200 points without a good value (p000, p001, p002 …)")
    assert len(world.shown) == 1 and len(world.run(60)) == 0


def test_another_cause_is_reported_but_not_often(tmp_path: Path) -> None:
    rules = ", ".join(
        f"{{fault: {'no_reply' if at % 40 < 20 else 'wrong_check'}, from: {at} s, until: {at + 20} s}}"
        for at in range(4, 200, 20)
    )
    world = World(write(tmp_path, rules))
    world.run(200)
    times = [at for at, event, _ in world.reports if event == "changes"]
    begun = [at for at, event, _ in world.reports if event == "begins"]
    assert len(begun) <= 2 and 1 <= len(times) <= 6
    assert times[0] - begun[0] > FIRST_PAUSE / SECOND - 0.1


def test_troubles_that_last_and_come_again_are_reported_more_and_more_seldom(tmp_path: Path) -> None:
    """For an hour the device is silent for 20 s of each minute, later for 100 s, and in the end for 15 min."""
    rules = [f"{{fault: no_reply, from: {at} s, until: {at + 20} s}}" for at in range(10, 3600, 60)]
    rules += ["{fault: no_reply, from: 3700 s, until: 3800 s}", "{fault: no_reply, from: 3900 s, until: 4800 s}"]
    reports = World(write(tmp_path, ", ".join(rules))).run(5000)
    begun = [text for text in reports if "again after" not in text]
    ends = [text.partition("; it comes and goes: for 60 min ")[2] for text in begun]
    assert [end for end in ends if end] == [f"reported only when it lasts {time}" for time in ("10 s", "60 s")]
    assert [text for text in reports if "again after" in text][-1].endswith("good values again after 15 min")
    assert len(reports) < 40, "it was 124"


def test_silence_and_refusals_in_turn_are_two_troubles_that_come_and_go(tmp_path: Path) -> None:
    rules = ", ".join(
        f"{{fault: {'no_reply' if at % 8 else 'error_reply'}, from: {at} s, until: {at + 4} s}}"
        for at in range(4, 200, 4)
    )
    world = World(write(tmp_path, rules))
    world.run(200)
    assert 4 <= len(world.reports) <= 2 * 4 * 7


def test_a_point_that_is_refused_for_ever_hides_no_other_trouble(tmp_path: Path) -> None:
    rules = "{fault: no_reply, from: 30 s, until: 60 s}, {fault: no_reply, from: 120 s, until: 150 s}"
    points = "".join(f'  {name}: {{channel: 1, address: "{at}"}}\n' for name, at in REFUSED_THIRD.items())
    path = write(tmp_path, rules, points)
    device = path.parent / "d1.device.yaml"
    device.write_text(device.read_text().replace("memory: {", 'memory: {sizes: {"40001": 10}, '))
    world = World(path)
    refused = "channel 1: refused 0x0002: illegal data address – 1 point without a good value (gone)"
    silent = "channel 1: no reply – 3 points without a good value (gone, good1, good2)"
    again = "channel 1: good values again of 2 points (good1, good2) after 30 s"
    assert world.run(100) == [refused, silent, again]
    assert world.shown == [refused]
    assert world.run(100) == [silent, again.replace("30", "29")]
    assert world.run(1000) == []


def test_a_device_that_refuses_everything_after_an_outage_answers_again(tmp_path: Path) -> None:
    rules = "{fault: no_reply, from: 4 s, until: 30 s}, {fault: error_reply, from: 30 s, until: 60 s}"
    world = World(write(tmp_path, rules))
    refused = f"channel 1: refused 0x0002: illegal data address{ALL}"
    reports = world.run(50)
    assert reports[0] == f"channel 1: no reply{ALL}" and reports[2:] == [refused]
    assert reports[1].startswith("channel 1: answers again after ")
    assert world.shown == [refused]
    (again,) = world.run(60)
    assert again.startswith("channel 1: good values again after 29 s")


def test_a_cause_names_its_own_points(tmp_path: Path) -> None:
    """`s` is refused; the device is busy with it, so the other point is not read for a while."""
    points = '  a: {channel: 1, address: "40001"}\n  s: {channel: 1, address: "40050"}\n'
    world = World(write(tmp_path, "", points))
    world.run(2)
    block = {state.block.name: state.block for state in world.service.states.values()}
    world.service.values.failed(block["s"], 1, Failure(outcome="refused", device_code=2))
    world.service.values.not_good(world.service.run.points[0], 1, 1, "stale", "not read for 3 s")
    world.service.values.failed(block["a"], 1, Failure(outcome="late_replies"))
    assert world.shown == []
    world.service.stop()
    assert [text for *_, text in world.reports] == [
        "channel 1: refused 0x0002 – 1 point without a good value (s)",
        "channel 1: late replies – 1 point without a good value (a)",
    ]


def test_points_that_recover_are_reported_while_others_fail(tmp_path: Path) -> None:
    """A device may ignore the requests for one address."""
    points = "".join(f'  {name}: {{channel: 1, address: "4{at}01"}}\n' for at, name in enumerate("abcd", 10))
    world = World(write(tmp_path, "", points))
    world.run(2)
    block = {state.block.name: state.block for state in world.service.states.values()}
    for name in "abcd":
        world.service.enable(block[name].id, False)
    world.run(3)
    world.service.values.forget(lambda channel, item: True)
    for name in "abcd":
        world.service.values.failed(block[name], 1, Failure(outcome="no_reply"))
    assert world.run(5) == ["channel 1: no reply – 4 points without a good value (a, b, c …)"]
    for name in "acd":
        world.service.values.good(block[name])
    assert world.run(60) == ["channel 1: no reply – 1 point without a good value (b)"]


def test_a_trouble_that_comes_and_goes_is_reported_three_times_an_hour(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third report says that short troubles are not reported for some time; then they are reported again."""
    monkeypatch.setattr(value_troubles, "SELDOM", 300 * SECOND)
    times = [*range(4, 150, 4), *range(150, 250, 20), 330]
    rules = ", ".join(f"{{fault: error_reply, from: {at} s, until: {at + 2} s}}" for at in times)
    world = World(write(tmp_path, rules))
    world.run(340)
    begun = [text for _, event, text in world.reports if event == "begins"]
    assert len(begun) == 4 and len(world.reports) == 8
    assert ["comes and goes" in text for text in begun] == [False, False, True, False]
    assert begun[2].endswith("; it comes and goes: for 5 min reported only when it lasts 10 s")


def test_old_values_after_a_lost_port_are_no_news(tmp_path: Path) -> None:
    world = World(write(tmp_path, "{fault: disconnect, from: 5 s, until: 60 s}", protocol="modbus-tcp"))
    begins, ends = world.run(90)
    assert begins.startswith("channel 1: port not open: ") and begins.endswith(ALL)
    assert ends.startswith("channel 1: good values again after ")


def test_waits_and_old_values_in_turn_are_no_news(tmp_path: Path) -> None:
    """A gateway keeps each fifth reply until the next request, and the values change."""
    addresses = {"a": "%R1", "b": "%R41", "c": "%R81", "d": "%R121"}
    points = "".join(f'  {name}: {{channel: 1, address: "{place}"}}\n' for name, place in addresses.items())
    path = write(tmp_path, "{fault: glue, rate: 20 %, from: 30 s, until: 150 s}", points, protocol="ge-rtu", memory="")
    path.write_text(path.read_text().replace("seed: 3", "seed: 5"))
    behave = "".join(f'  "{place}": {{counter: 1, start: {at}000}}\n' for at, place in enumerate(addresses.values(), 3))
    (tmp_path / "d1.device.yaml").write_text(f"device: d1\nprotocol: ge-rtu\nstation: 1\nbehave:\n{behave}")
    reports = World(path).run(149)
    assert sum("not read for" in report for report in reports) == 1, reports
    assert sum("waits up to" in report for report in reports) == 1, reports


def test_late_replies_with_numbers_are_one_more_cause(tmp_path: Path) -> None:
    """They come in some exchanges of the outage only."""
    late = "{fault: delay, time: 6500 ms, from: 60 s, until: 180 s}"
    world = World(write(tmp_path, late, THREE + '  d: {channel: 1, address: "40150"}\n', protocol="modbus-tcp"))
    reports = [report for report in world.run(200) if "no reply" in report]
    assert 1 <= len(reports) <= 2, reports


def test_one_reply_and_several_that_cannot_be_used_are_one_kind_of_cause() -> None:
    several = cause_of("no reply: 3 replies arrived and could not be used, the last one – reply: station is 2, not 1")
    single = cause_of("no reply: a reply arrived and could not be used – reply: station is 24, not 1")
    assert several.kind == single.kind
    check = cause_of("damaged reply: 3 replies arrived, all with a wrong check code (expected 43 43, found 43 34)")
    single = cause_of("damaged reply: a reply arrived, with a wrong check code (expected 1A, found 22)")
    assert check.kind == single.kind


def test_a_damaged_character_is_described(tmp_path: Path) -> None:
    """Damage that the port has found has no message of its own."""
    world = World(write(tmp_path, "{fault: noise, rate: 0.01, from: 4 s}"))
    reports = world.run(60)
    assert any("found a damaged character" in report for report in reports), reports
    assert not any(":  –" in report for report in reports)


def test_points_that_alone_are_no_value(tmp_path: Path) -> None:
    points = '  a: {channel: 1, address: "40001"}\n  f: {channel: 1, address: "40002", type: float32, order: ABCD}\n'
    world = World(write(tmp_path, "", points, memory="40001: [7, 32704, 0]"))
    (begun,) = world.run(30)
    assert begun.startswith("channel 1: ") and begun.endswith(" – 1 point without a good value (f)")
    device = world.service.devices[0]
    place = device.device.grammar.parse("40002")
    device.memory.write(place.area, place.unit, place.start, [0x4120, 0], force=True)
    (ended,) = world.run(3)
    assert ended.startswith("channel 1: good values again after 3")


def test_a_value_that_is_not_read_for_long_is_reported(tmp_path: Path) -> None:
    """No exchange fails: the first takes as long as its time limit."""
    path = write(tmp_path, "{fault: delay, time: 40 s, from: 4 s}")
    path.write_text(path.read_text().replace("station: 1,", "station: 1, params: {reply_timeout: 60 s},"))
    world = World(path)
    (text,) = world.run(30)
    assert text == f"channel 1: not read for 3 s{ALL}"
    assert 6 < world.reports[0][0] < 12


def test_a_wait_for_late_replies_is_reported(tmp_path: Path) -> None:
    world = World(write(tmp_path, "{fault: delay, time: 8 s, from: 4 s, until: 40 s}"))
    reports, shown = [], []
    for _ in range(100):
        reports += world.run(1)
        shown += world.shown
    assert any(line.startswith(f"channel 1: no reply{ALL}; waits up to ") for line in shown), shown
    assert not any("for late replies" in report for report in reports), "it is a consequence"
    world.run(60)
    assert world.shown == []


def test_each_station_of_a_line_has_its_own_trouble(tmp_path: Path) -> None:
    points = "".join(f'  p{station}: {{channel: 1, address: "40001", station: {station}}}\n' for station in (1, 2))
    world = World(write(tmp_path, "", points))
    reports = world.run(60)
    assert reports == ["channel 1, station 2: no reply – 1 point without a good value (p2)"]
    world.service.enable(next(state.id for state in world.service.states.values() if state.block.name == "p2"), False)
    assert world.shown == [], "no value is expected of a block that is switched off"


def test_the_parts_of_a_line_change_with_its_stations(tmp_path: Path) -> None:
    """Block 0 fails in one part at a time: an edit adds a second station, and another edit removes it."""
    path = write_blocks(tmp_path, "{fault: no_reply, from: 4 s, until: 120 s}")
    alone = path.read_text()
    world = World(path)
    world.run(20)
    assert world.shown == ["channel 1: no reply – 1 block without success (0 READ 40001)"]
    path.write_text(alone + SECOND_STATION)
    world.service.edit(load_run(path))
    world.run(20)
    assert {line.partition(":")[0] for line in world.shown} == {"channel 1, station 2", "channel 1, station 1"}
    path.write_text(alone)
    world.service.edit(load_run(path))
    world.run(150)
    assert world.shown == [] and world.reports[-1][2].startswith("channel 1: good values again after ")


def test_the_trouble_of_a_station_that_memory_gives_ends_with_another_station(tmp_path: Path) -> None:
    world = World(write_blocks(tmp_path, "", ", station: D00010, every: 1 s"))
    place = world.service.grammar.parse("D00010")
    for station, shown in ((9, ["channel 1, station 9: no reply – 1 block without success (0 READ 40001)"]), (1, [])):
        world.service.memory.write(place.area, place.unit, place.start, [station], force=True)
        world.run(20)
        assert world.shown == shown
    world.run(60)
    assert world.service.values.is_quiet


@pytest.mark.parametrize("asked", ["", ", every: 1 s, enabled: no"], ids=["by a program", "switched off"])
def test_an_open_port_ends_its_trouble_if_no_block_starts_by_itself(asked: str, tmp_path: Path) -> None:
    world = World(write_blocks(tmp_path, "", asked))
    world.run(3)
    driver = world.service.channels[1].driver
    driver.port.close()
    driver.closed(world.clock.now(), "unplugged")
    assert len(world.shown) == 1
    assert world.run(20) == ["channel 1: the port is open again after 0.5 s"]
    assert world.shown == []


def test_the_status_shows_the_present_cause_after_a_lost_port(tmp_path: Path) -> None:
    """The device is silent before and after: the port is no cause any more when it is open."""
    world = World(write_blocks(tmp_path, "{fault: no_reply, from: 4 s}"))
    world.run(20)
    driver = world.service.channels[1].driver
    driver.port.close()
    driver.closed(world.clock.now(), "unplugged")
    assert "port not open" in world.shown[0]
    world.run(10)
    assert world.shown == ["channel 1: no reply – 1 block without success (0 READ 40001)"]
    assert world.run(30) == world.shown, "the new cause is reported, but not soon after the last report"


def test_a_wait_of_a_request_that_no_block_has_made_is_not_reported(tmp_path: Path) -> None:
    """No good value of a block would end it."""
    world = World(write_blocks(tmp_path, "", more='  1: {read: "40002", into: D00001, channel: 1, station: D00010}\n'))
    world.run(0.5)
    world.service.waits(1, 9, world.clock.now() + 60 * SECOND)
    assert world.run(30) == [] and world.shown == []


def test_a_refusal_of_a_device_has_no_remedy_for_files(tmp_path: Path) -> None:
    """A text of a protocol may read like a failure of a file: its remedy would mislead."""
    world = World(write_blocks(tmp_path))
    failure = Failure(outcome="refused", device_code=0xF009, meaning="data or file too large")
    world.service.values.failed(next(iter(world.service.states.values())).block, 1, failure)
    assert world.run(0.9) == []
    world.service.stop()
    assert world.reports[-1][2] == f"channel 1: {failure_text(failure)} – 1 block without success (0 READ 40001)"


def test_the_blocks_of_a_run_are_looked_through_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither an exchange nor a report searches all blocks and points."""
    made: list[RunModel] = []

    class Counted(value_troubles._BlockIndex):
        def __init__(self, run: RunModel) -> None:
            made.append(run)
            super().__init__(run)

    monkeypatch.setattr(value_troubles, "_BlockIndex", Counted)
    world = World(write_blocks(tmp_path, "{fault: error_reply}", more=SECOND_STATION))
    assert len(world.run(30)) == 2 and len(world.shown) == 2
    assert made == [world.service.run]


def test_status_json_and_metrics_agree(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write(tmp_path, "{fault: no_reply, from: 1500 ms}"))
    assert main(["run", path, "--virtual", "--for", "20s", "--json", "--status"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    (begun,) = [row for row in rows if row["event"] == "run_trouble"]
    assert 1.5 < begun["time"] < 12
    (status,) = [row for row in rows if row["event"] == "status"]
    assert begun["what"] == "begins" and begun["text"] == f"channel 1: no reply{ALL}"
    assert [(trouble["name"], trouble["reason"]) for trouble in status["troubles"]] == [("channel 1", f"no reply{ALL}")]
    world = World(Path(path))
    world.run(20)
    (failing, _) = _of_troubles(run_status(world.service))
    assert [(sample.labels, sample.value) for sample in failing.samples] == [({"run": "r", "name": "channel 1"}, 1.0)]


def test_with_a_log_each_line_stands_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write(tmp_path, "{fault: no_reply, from: 1500 ms, until: 12 s}"))
    assert main(["run", path, "--virtual", "--for", "40s", "--quiet", "--log", "warning"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == f"channel 1: no reply{ALL}" and lines[1].startswith("channel 1: good values again after ")
    assert len(lines) == 2


def test_a_run_that_ends_soon_reports_before(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write(tmp_path, "{fault: error_reply}"))
    assert main(["run", path, "--virtual", "--for", "300ms", "--quiet"]) == 0
    assert capsys.readouterr().err.splitlines() == [f"channel 1: refused 0x0002: illegal data address{ALL}"]


def test_the_end_of_a_slow_time_is_no_end_of_other_troubles(tmp_path: Path) -> None:
    world = World(write(tmp_path))
    station = SlowStation(1, 3 * SECOND, "reply_timeout")
    world.service.slow(1, station, True)
    world.service.slow(1, station, False)
    assert [text for *_, text in world.reports] == [
        "channel 1: station 1 answers after 3 s: set reply_timeout to 4 s or more",
        "channel 1: station 1 answers in time again after 0.0 s",
    ]


def test_a_second_advice_is_never_less_than_the_first() -> None:
    slow = SlowStations()
    advice: list[int] = []
    slow.on_change = lambda station, is_slow: advice.append(station.time if is_slow else 0)
    for at, time in enumerate((4, 1, 2, 6, 3, 7, 6, 8, 3)):
        slow.answered_late(1, time * SECOND, "reply_timeout", at * SECOND)
    assert advice == [4 * SECOND, 6 * SECOND]


@pytest.mark.parametrize("every", [20, 400])
def test_a_station_that_is_slow_now_and_then_is_reported_once(every: int) -> None:
    """Once slow, and at most once well again within the hour, however often it is slow."""
    slow = SlowStations()
    reports: list[bool] = []
    slow.on_change = lambda station, is_slow: reports.append(is_slow)
    for at in range(6000):
        if at % every:
            slow.answered_in_time(1, at * SECOND // 2)
        else:
            slow.answered_late(1, 3 * SECOND // 2, "reply_timeout", at * SECOND // 2)
            assert slow and len(slow.present) == 1
    assert reports == ([True] if every == 20 else [True, False])


def test_own_repeats_that_wait_in_the_device_are_not_its_time(tmp_path: Path) -> None:
    """The device takes 2.5 s for each request; a repeated request waits in it for the one before."""
    path = write(tmp_path, "{fault: delay, time: 2500 ms, from: 15 s, until: 135 s}")
    reports = World(path).run(200)
    assert [text for text in reports if "answers after" in text] == [
        "channel 1: station 1 answers after 2.5 s: set reply_timeout to 3 s or more"
    ]


FIVE = "".join(f'  {name}: {{channel: 1, address: "4{at}001"}}\n' for at, name in enumerate("abcde"))


@pytest.mark.parametrize("fault", ["no_reply", "wrong_check"])
def test_the_first_line_counts_the_points_that_wait_for_the_same_station(fault: str, tmp_path: Path) -> None:
    world = World(write(tmp_path, f"{{fault: {fault}, from: 15 s, until: 90 s}}", FIVE))
    reports = world.run(89)
    assert " – 5 points without a good value (a, b, c …)" in reports[0]
    assert len(reports) <= 2
    (again,) = world.run(60)
    assert again.startswith("channel 1: good values again after ")


def test_the_first_line_has_the_cause_that_the_device_has_shown(tmp_path: Path) -> None:
    """The exchange takes long, so that values are too old before it fails."""
    path = write(tmp_path, "{fault: wrong_check, from: 4 s}")
    path.write_text(path.read_text().replace("station: 1,", "station: 1, params: {reply_timeout: 5 s},"))
    reports = World(path).run(60)
    assert "wrong check code (expected " in reports[0]
    assert not any("not read" in report or "for late replies" in report.split(" – ")[0] for report in reports)


def test_a_quick_station_on_the_line_makes_no_slow_station_slower(tmp_path: Path) -> None:
    """The device takes 2.5 s for each request; a reply of the other device does not show that it has an empty queue."""
    path = write(
        tmp_path, "", "".join(f'  s{at}: {{channel: 1, station: 3, address: "4{at}001"}}\n' for at in range(3))
    )
    device = (tmp_path / "d1.device.yaml").read_text().replace("station: 1", "station: 3").replace("d1", "d3")
    faults = "faults: {seed: 2, rules: [{fault: delay, time: 2500 ms, from: 15 s, until: 135 s}]}\n"
    (tmp_path / "d3.device.yaml").write_text(device + faults)
    run = path.read_text().replace('"sim:d1.device.yaml"', '"sim:d1.device.yaml,d3.device.yaml"')
    path.write_text(run.replace("points:\n", 'points:\n  a: {channel: 1, address: "40001"}\n'))
    reports = World(path).run(200)
    assert [text for text in reports if "answers after" in text] == [
        "channel 1: station 3 answers after 2.5 s: set reply_timeout to 3 s or more"
    ]


def write_line(folder: Path, faults: dict[int, str], points: dict[str, str], settings: str = "") -> Path:
    """Write a run whose channel 1 has a device of each station, with faults."""
    for station, rules in faults.items():
        device = f"device: d{station}\nprotocol: modbus-rtu\nstation: {station}\nmemory: {{set: {{40001: [7]}}}}\n"
        (folder / f"d{station}.device.yaml").write_text(f"{device}faults: {{seed: 3, rules: [{rules}]}}\n")
    port = "sim:" + ",".join(f"d{station}.device.yaml" for station in faults)
    path = folder / "r.run.yaml"
    listed = "".join(f"  {name}: {{channel: 1, {point}}}\n" for name, point in points.items())
    path.write_text(f'run: r\nchannels:\n  1: {{port: "{port}", protocol: modbus-rtu{settings}}}\npoints:\n{listed}')
    return path


@pytest.mark.parametrize("retries", [0, 1, 2])
@pytest.mark.parametrize("late", ["1500 ms", "3 s"])
def test_two_slow_stations_are_two_troubles_for_ten_minutes(late: str, retries: int, tmp_path: Path) -> None:
    """Their values are too old again and again, and their requests wait: consequences, and no reports of their own."""
    rule = f"{{fault: delay, time: {late}, until: 600 s}}"
    points = {"a": 'address: "40001", station: 1, every: 1 s', "b": 'address: "40001", station: 2, every: 1 s'}
    settings = f", params: {{reply_timeout: 1 s, retries: {retries}}}"
    world = World(write_line(tmp_path, {1: rule, 2: rule}, points, settings))
    shown = {"1500 ms": "1.5 s: set reply_timeout to 2 s", "3 s": "3 s: set reply_timeout to 4 s"}[late]
    slow = [f"channel 1: station {station} answers after {shown} or more" for station in (2, 1)]
    begun = world.run(590)
    assert sorted(line for line in begun if "no reply" not in line) == sorted(slow)
    gets_values = {"1500 ms": 1, "3 s": 2}[late] <= retries
    assert len(begun) == (2 if gets_values else 4), "a station without any value is another trouble"
    lines = [line.removeprefix("channel 1: ") for line in world.shown if line.startswith("channel 1: ")]
    assert len(lines) == 1 and sorted(lines[0].split("; ")) == sorted(line.removeprefix("channel 1: ") for line in slow)
    ended = world.run(200)
    assert len(ended) == len(begun) and all(re.search(r" again after \d+ min", line) for line in ended)
    assert world.shown == []


def test_more_reads_than_the_line_carries_are_reported_once(tmp_path: Path) -> None:
    places = range(101, 4101, 100)
    points = {f"p{place}": f'address: "4{place:04}", station: 1, every: 1 s' for place in places}
    path = write_line(tmp_path, {1: ""}, points, ", speed: 2400")
    world = World(path)
    text = "channel 1: 40 reads take 4 s together and are due every 1 s: set every: to 5 s or more"
    assert world.run(300) == [text] and world.shown == [text]
    for number in list(world.service.states)[:32]:
        world.service.enable(number, False)
    (ended,) = world.run(300)
    assert ended.startswith("channel 1: the line keeps up again after ") and world.shown == []


def test_reads_with_different_periods_are_too_many_by_a_factor(tmp_path: Path) -> None:
    points = {
        f"p{at}": f'address: "4{at * 100 + 101:04}", station: {1 + at % 2}, every: {1 + at % 3} s' for at in range(80)
    }
    world = World(write_line(tmp_path, {1: "", 2: ""}, points, ", speed: 2400"))
    text = "channel 1: 80 reads take 5.0 s of each second: set every: to 5.5 times as much or more"
    assert world.run(300) == [text]


def keeps_old(world: World, name: str, seconds: int) -> list[str]:
    """Report each half second that the value of a point is too old, as the table of points does; return the reports."""
    point = next(point for point in world.service.run.points if point.name == name)
    reports: list[str] = []
    for _ in range(2 * seconds):
        world.service.values.not_good(point, 1, 2, "stale", "not read for 3 s")
        reports += world.run(0.5)
    return reports


SLOW_FIRST = {1: "{fault: delay, time: 1500 ms}", 2: ""}
BOTH = {name: f'address: "40001", station: {station}, every: 20 s' for name, station in (("a", 1), ("b", 2))}


def test_the_trouble_of_a_slow_station_ends_with_an_edit_of_its_channel(tmp_path: Path) -> None:
    """The user follows the advice: the station is measured again with the new time limit."""
    path = write_line(tmp_path, SLOW_FIRST, BOTH, ", params: {reply_timeout: 1 s, retries: 1}")
    world = World(path)
    slow = "channel 1: station 1 answers after 1.5 s: set reply_timeout to 2 s or more"
    assert world.run(60) == [slow] and world.shown == [slow]
    path.write_text(path.read_text().replace("reply_timeout: 1 s", "reply_timeout: 2 s"))
    world.service.edit(load_run(path))
    world.run(60)
    assert world.shown == []
    assert keeps_old(world, "b", 10)[0] == "channel 1, station 2: not read for 3 s – 1 point without a good value (b)"


def test_a_slow_station_that_answers_no_longer_explains_no_old_value(tmp_path: Path) -> None:
    world = World(write_line(tmp_path, SLOW_FIRST, BOTH, ", params: {reply_timeout: 1 s, retries: 1}"))
    world.run(60)
    assert keeps_old(world, "b", 10) == [], "a consequence"
    world.service.enable(next(state.id for state in world.service.states.values() if state.block.name == "a"), False)
    assert any("not read for 3 s" in text for text in keeps_old(world, "b", 100))


def test_a_slow_station_does_not_explain_a_long_exchange_with_another(tmp_path: Path) -> None:
    """Station 2 falls silent, and is asked for half a minute: no exchange fails in this time."""
    points = {name: f'address: "40001", station: {station}, every: 2 s' for name, station in (("a", 1), ("b", 2))}
    rules = {1: SLOW_FIRST[1], 2: "{fault: no_reply, from: 60 s}"}
    world = World(write_line(tmp_path, rules, points, ", params: {reply_timeout: 1 s, retries: 30}"))
    world.run(60)
    reports = world.run(20)
    assert any(text.startswith("channel 1, station 2: not read for ") for text in reports), reports


def test_a_reported_trouble_that_the_line_explains_later_has_an_end(tmp_path: Path) -> None:
    world = World(write_line(tmp_path, {1: "", 2: ""}, BOTH, ", params: {reply_timeout: 1 s}"))
    world.run(2)
    (begun,) = keeps_old(world, "b", 4)
    assert begun.startswith("channel 1, station 2: not read for 3 s")
    slow = world.service.channels[1].engine.late.slow
    slow.answered_late(1, 4 * SECOND, "reply_timeout", world.clock.now())
    first, second = [text for *_, text in world.reports[-2:]]
    assert first == "channel 1: station 1 answers after 4 s: set reply_timeout to 5 s or more"
    assert second.startswith("channel 1, station 2: explained by the reported trouble of the line after ")


def test_a_reported_trouble_of_a_block_that_is_switched_off_has_an_end(tmp_path: Path) -> None:
    world = World(write_blocks(tmp_path, "{fault: no_reply}"))
    assert len(world.run(20)) == 1
    world.service.enable(0, False)
    assert world.run(1)[-1:] == [] and world.reports[-1][2].startswith(
        "channel 1: no value is expected any more after "
    )


def test_an_overload_that_is_over_explains_no_old_value(tmp_path: Path) -> None:
    places = range(101, 4101, 100)
    points = {f"p{place}": f'address: "4{place:04}", station: 1, every: 1 s' for place in places}
    world = World(write_line(tmp_path, {1: ""}, points, ", speed: 2400"))
    assert len(world.run(100)) == 1
    for number in list(world.service.states)[:39]:
        world.service.enable(number, False)
    reports = keeps_old(world, "p4001", 120)
    assert any("the line keeps up again" in text for text in reports)
    assert any("not read for 3 s" in text for text in reports)


def test_a_line_that_loses_replies_to_changing_values_keeps_no_replies(tmp_path: Path) -> None:
    """A value may change within a proof: that alone is no sign of a gateway that keeps replies."""
    points = {f"p{at}": f'address: "4{at * 100 + 1:04}", every: 300 ms, station: 1' for at in range(3)}
    path = write_line(tmp_path, {1: "{fault: no_reply, rate: 5 %}"}, points)
    behave = "".join(f'  "4{at * 100 + 1:04}": {{counter: 1}}\n' for at in range(3))
    device = tmp_path / "d1.device.yaml"
    device.write_text(f"{device.read_text()}behave:\n{behave}")
    reports = World(path).run(300)
    assert not any("answers only when it is asked again" in report for report in reports), reports
    assert len(reports) < 12
