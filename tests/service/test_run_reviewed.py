"""Disturbed runs: failing watchers, channels switched on twice, edits of blocks that a user has switched."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
DEVICE = "device: d\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: [1, 2, 3, 4]}}\n"
CHANNEL = 'channels: {1: {port: "sim:d.device.yaml", protocol: modbus-rtu, station: 1MORE}}\n'


def load(folder: Path, text: str, more: str = "") -> object:
    (folder / "d.device.yaml").write_text(DEVICE, encoding="utf-8")
    path = folder / "r.run.yaml"
    path.write_text(f"run: r\nmemory: masterlogic\n{CHANNEL.replace('MORE', more)}{text}", encoding="utf-8")
    return load_run(path)


def add_up(service: RunService) -> None:
    for state in service.states.values():
        counters = state
        assert counters.started == counters.done + counters.failed + counters.running


TWO = """blocks:
  0: {read: 40001, into: M0, every: 1 s, phase: 0 s}
  1: {read: 40002, into: M1, every: 1 s, phase: 0 s}
"""


def test_watchers_that_fail_disturb_no_exchange(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def raising(*what: object) -> None:
        raise RuntimeError("the watcher is broken")

    clock = VirtualClock()
    service = RunService(load(tmp_path, TWO), clock, raising, raising)  # type: ignore[arg-type]
    with caplog.at_level(logging.CRITICAL):
        service.start()
        clock.run_for(3 * SECOND + SECOND // 2)
    assert [state.done for state in service.states.values()] == [4, 4]


def test_a_channel_that_is_switched_on_twice_goes_on(tmp_path: Path) -> None:
    """Also while its request is being transmitted."""
    clock = VirtualClock()
    service = RunService(load(tmp_path, TWO), clock)  # type: ignore[arg-type]
    service.start()
    for _ in range(200):
        clock.run_for(7_000_000)
        service.enable_channel(1)
    clock.run_for(10 * SECOND)
    add_up(service)
    assert all(state.done >= 11 and not state.failed for state in service.states.values())


def test_a_channel_that_is_switched_while_its_port_is_looked_for_again(tmp_path: Path) -> None:
    clock = VirtualClock()
    service = RunService(load(tmp_path, TWO), clock)  # type: ignore[arg-type]
    service.start()
    clock.run_for(SECOND // 2)
    for _ in range(50):
        service.channels[1].driver.closed(clock.now(), "pulled")
        service.enable_channel(1, False)
        service.enable_channel(1)
        clock.run_for(SECOND)
        add_up(service)
    assert all(state.done >= 45 for state in service.states.values())


def test_an_edit_leaves_sets_alone_that_were_switched_by_hand(tmp_path: Path) -> None:
    clock = VirtualClock()
    service = RunService(load(tmp_path, TWO), clock)  # type: ignore[arg-type]
    service.start()
    service.enable_set(1, False)
    service.edit(load(tmp_path, TWO.replace("M1", "M2")))  # type: ignore[arg-type]
    clock.run_for(3 * SECOND)
    assert [state.started for state in service.states.values()] == [0, 0]


def test_an_edit_may_begin_to_join_reads(tmp_path: Path) -> None:
    clock = VirtualClock()
    sent: list[bytes] = []
    service = RunService(
        load(tmp_path, TWO),  # type: ignore[arg-type]
        clock,
        lambda channel, seen: sent.append(seen.raw) if seen.direction == "out" and seen.kind == "frame" else None,
    )
    service.start()
    clock.run_for(SECOND // 2)
    assert len(sent) == 2
    service.edit(load(tmp_path, TWO, ", merge: yes"))  # type: ignore[arg-type]
    sent.clear()
    clock.run_for(SECOND)
    assert len(sent) == 1
    assert all(state.done == 2 for state in service.states.values())


def test_a_read_whose_memory_names_no_station_is_not_joined(tmp_path: Path) -> None:
    """M9 holds 300, which is not a station: only that block fails, and its place keeps the old value."""
    clock = VirtualClock()
    text = TWO.replace("into: M1", "into: M1, station: M9")
    service = RunService(load(tmp_path, text, ", merge: yes"), clock)  # type: ignore[arg-type]
    service.memory.write("M", "word", 9, [300])
    service.start()
    clock.run_for(SECOND // 2)
    good, bad = service.states.values()
    assert (good.done, bad.failed) == (1, 1)
    assert service.memory.read("M", "word", 0, 2) == [1, 0]
