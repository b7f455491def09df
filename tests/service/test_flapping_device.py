"""A device that closes connections after accepting them, or sends no frames: few connections, and one row per point."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import pytest

from framekit.run.points import PointValue
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock
from framekit.transport.port import PortEvents

SECOND = 1_000_000_000

RUN = """run: r
channels:
  1: {port: "sim:d1.device.yaml", protocol: modbus-tcp, station: 1, reconnect: 8 s}
points:
  a: {channel: 1, address: "40001"}
  b: {channel: 1, address: "40050"}
sinks:
  - {jsonl: rows.jsonl}
"""
CLOSED = "the other side has closed the connection"
JUNK = bytes(range(7, 200))


class Flapping:
    """A run whose device accepts each connection, sends `junk` and closes it after a time (s)."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, junk: bytes = b"", closes: float = 0.01) -> None:
        (folder / "d1.device.yaml").write_text(
            "device: d1\nprotocol: modbus-tcp\nstation: 1\nmemory: {set: {40001: [7]}}\n"
        )
        (folder / "r.run.yaml").write_text(RUN)
        self.clock = VirtualClock()
        self.service = RunService(load_run(folder / "r.run.yaml"), self.clock)
        self.rows: list[PointValue] = []
        self.service.points.table.listeners.append(self.rows.append)
        self.opened: list[float] = []
        self.is_well = False
        self.driver = driver = self.service.channels[1].driver
        opens, junk_at = driver.port.open, min(closes / 2, 0.005)

        def is_here(number: int) -> bool:
            return len(self.opened) == number and driver.is_open

        def accept(events: PortEvents) -> None:
            self.opened.append(self.clock.now() / SECOND)
            if self.is_well:
                opens(events)
                return
            number, now = len(self.opened), self.clock.now()
            self.clock.call_soon(lambda: events.opened(self.clock.now()))
            if junk:
                at = now + int(junk_at * SECOND)
                self.clock.call_at(at, lambda: is_here(number) and events.received(junk, self.clock.now()))
            else:
                at = now + int(closes * SECOND)
                self.clock.call_at(at, lambda: is_here(number) and events.closed(self.clock.now(), CLOSED))

        monkeypatch.setattr(driver.port, "open", accept)
        self.service.start()

    def run(self, seconds: float) -> None:
        self.clock.run_for(int(seconds * SECOND))

    @property
    def pauses(self) -> list[float]:
        return [round(later - earlier, 1) for earlier, later in pairwise(self.opened)]


@pytest.mark.parametrize("junk", [b"", JUNK])
def test_the_pauses_grow_until_a_good_frame_has_come(
    junk: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = Flapping(tmp_path, monkeypatch, junk)
    world.run(60)
    assert world.pauses[:7] == [0.5, 1.0, 2.0, 4.0, 8.0, 8.0, 8.0]
    world.is_well = True
    world.run(20)
    world.is_well = False
    known = len(world.opened)
    world.driver.port.close()
    world.driver.closed(world.clock.now(), CLOSED)
    world.run(10)
    assert world.pauses[known:][:3] == [1.0, 2.0, 4.0], "after half a second, and then with growing pauses"
    assert world.opened[known] < 80.6


@pytest.mark.parametrize("closes", [2.0, 9.0])
def test_a_connection_that_lasted_the_longest_pause_ends_the_back_off(
    closes: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection counts although no reply arrived, since a protocol may have no replies."""
    world = Flapping(tmp_path, monkeypatch, closes=closes)
    world.run(60)
    assert world.pauses[:4] == ([2.5, 3.0, 4.0, 6.0] if closes < 8 else [9.5] * 4)


@pytest.mark.parametrize("junk", [b"", JUNK])
def test_a_point_that_stays_failed_is_one_row(junk: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The wording of the reason may change; only another value or quality adds a row."""
    world = Flapping(tmp_path, monkeypatch, junk)
    world.run(60)
    assert [(row.name, row.quality) for row in world.rows] == [("a", "failed"), ("b", "failed")]
    world.is_well = True
    world.run(20)
    world.service.stop()
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert [(row["point"], row["quality"]) for row in rows] == [
        ("a", "failed"), ("b", "failed"), ("a", "good"), ("b", "good"),
    ]  # fmt: skip
    assert not any(row.get("reason", "").startswith("closed:") for row in rows)


def test_the_state_of_a_failed_point_has_the_latest_cause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = Flapping(tmp_path, monkeypatch)
    world.run(5)
    assert world.service.points.table["a"].reason == CLOSED

    def refuse(events: PortEvents) -> None:
        world.clock.call_soon(lambda: events.closed(world.clock.now(), "no such device"))

    monkeypatch.setattr(world.driver.port, "open", refuse)
    world.run(20)
    assert world.service.points.table["a"].reason == "no such device"
    assert len(world.rows) == 2


def test_junk_is_reported_as_no_frames_and_not_as_a_port_that_is_not_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reports: list[str] = []
    world = Flapping(tmp_path, monkeypatch, JUNK)
    world.service.troubles.listen(lambda report: reports.append(report.text))
    world.run(20)
    assert reports[0].startswith("channel 1: received bytes are no frames of 'modbus-tcp' – 2 points")
    world.driver.port.close()
    monkeypatch.setattr(
        world.driver.port,
        "open",
        lambda events: world.clock.call_soon(lambda: events.closed(world.clock.now(), "no such device")),
    )
    world.run(60)
    assert reports[-1].startswith("channel 1: port not open: no such device")
