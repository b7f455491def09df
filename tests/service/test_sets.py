"""Parameter sets: blocks of one number in several sets, ends counted within a set, sets and channels on and off."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from near_run import started

from framekit.api.run import run_status
from framekit.cli.run_output import status_data
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
RUN = """run: sets
memory: masterlogic
channels:
  1: {port: "sim:there.device.yaml", protocol: modbus-rtu, station: 1}
  2: {port: "sim:there.device.yaml", protocol: modbus-rtu, station: 1, enabled: no}
sets:
  1:
    blocks:
      0: {read: "40001", into: M100, channel: 1, every: 1 s}
      1: {read: "40002", into: M101, channel: 1, when: block 0 done}
  2:
    blocks:
      0: {read: "40003", into: M102, channel: 1, every: 500 ms}
      1: {read: "40003", into: M103, channel: 2, every: 500 ms}
  8:
    enabled: no
    blocks:
      63: {write: "40009", values: [5], channel: 1, every: 1 s}
"""
DEVICE = "device: there\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: [7, 8, 9]}}\n"
LAST = 7 * 64 + 63


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def service(tmp_path: Path, clock: VirtualClock) -> RunService:
    return started(tmp_path, RUN, DEVICE, clock)


def done(service: RunService) -> list[int]:
    return [state.done for state in service.states.values()]


def test_blocks_of_several_sets_run_side_by_side(service: RunService, clock: VirtualClock) -> None:
    clock.run_for(10 * SECOND + SECOND // 4)
    assert done(service) == [10, 10, 20, 0, 0], "block 1 of set 1 follows block 0 of its own set only"
    assert [(status.set, status.block) for status in service.status()] == [(1, 0), (1, 1), (2, 0), (2, 1), (8, 63)]
    assert service.memory.read("M", "word", 100, 3) == [7, 8, 9]
    assert service.memory.read("L", "dword", (625 + 6 * 64 + 2) // 2, 1) != [0], "words of set 2 stand behind set 1"


def test_a_set_is_switched_on_and_off(service: RunService, clock: VirtualClock) -> None:
    clock.run_for(10 * SECOND + SECOND // 4)
    service.enable_set(8)
    service.enable_set(2, False)
    clock.run_for(10 * SECOND + SECOND // 4)
    assert done(service) == [20, 20, 20, 0, 10], "its times count from when it was switched on"
    assert service.devices[0].memory.read("holding", "word", 8, 1) == [5]
    with pytest.raises(ValueError, match="there is no set"):
        service.enable_set(3)


def test_the_blocks_of_a_set_that_is_off_are_off(service: RunService, clock: VirtualClock) -> None:
    def shown() -> list[tuple[str, bool]]:
        data = status_data(run_status(service), 0)
        return [(block["state"], block["enabled"]) for block in data["blocks"]]

    clock.run_for(SECOND // 4)
    assert shown() == [("ready", True), ("ready", True), ("ready", True), ("ready", True), ("off", False)]
    service.enable_set(8)
    service.enable_set(2, False)
    assert shown() == [("ready", True), ("ready", True), ("off", False), ("off", False), ("ready", True)]
    service.enable(0, False)
    service.enable_set(1, False)
    service.enable_set(1)
    assert shown()[:2] == [("off", False), ("ready", True)], "a block that is off itself stays so"
    service.reset()
    assert shown() == [("ready", True), ("ready", True), ("off", False), ("off", False), ("ready", True)]


def test_a_channel_is_opened_and_closed(service: RunService, clock: VirtualClock) -> None:
    clock.run_for(SECOND // 4)
    service.enable_channel(2)
    clock.run_for(10 * SECOND)
    assert done(service)[3] == 20
    service.enable_channel(2, False)
    clock.run_for(10 * SECOND)
    assert done(service)[3] == 20 and done(service)[2] == 40
    service.enable_channel(2)
    clock.run_for(10 * SECOND)
    assert 40 <= done(service)[3] <= 41, "what was due meanwhile runs once"


def test_reset_begins_anew(service: RunService, clock: VirtualClock) -> None:
    clock.run_for(10 * SECOND + SECOND // 4)
    service.reset()
    assert done(service) == [0, 0, 0, 0, 0]
    clock.run_for(3 * SECOND + SECOND // 4)
    assert done(service) == [3, 3, 6, 0, 0]
    for state in service.states.values():
        assert state.started == state.done + state.failed + state.running


BUSY = """run: busy
memory: masterlogic
dead: no
channels:
  1: {port: "sim:there.device.yaml", protocol: modbus-rtu, station: 1, merge: {gap: 4}, params: QUICK, faults: {rules: [
      {fault: no_reply, rate: 20 %}, {fault: wrong_check, rate: 20 %}]}}
  2: {port: "sim:there.device.yaml", protocol: modbus-rtu, role: server, own: 2}
sets:
  1:
    blocks:
      0: {read: "40001", into: M100, channel: 1, every: 70 ms}
      1: {read: "40002", into: M101, channel: 1, every: 70 ms}
      2: {write: "40009", values: [5], channel: 1, when: block 0 failed}
      3: {read: "49999", into: M102, channel: 1, every: 110 ms}
  2:
    blocks:
      0: {read: "40003", into: M103, channel: 1, when: block 1 done}
      1: {read: "40003", into: M104, channel: 1, every: 90 ms}
""".replace("QUICK", "{reply_timeout: 30 ms, retries: 1}")


@pytest.mark.parametrize("seed", range(4))
def test_counters_add_up_whatever_is_switched(seed: int, tmp_path: Path, clock: VirtualClock) -> None:
    """started = done + failed + running, for each block; for a channel, the sums of its blocks."""
    service, chance = started(tmp_path, BUSY, DEVICE, clock), random.Random(seed)
    actions = [
        lambda: service.enable_set(2, chance.random() < 0.6),
        lambda: service.enable_channel(1, chance.random() < 0.8),
        lambda: service.enable(chance.choice([0, 1, 2, 3]), chance.random() < 0.7),
        lambda: service.fire(chance.choice([0, 3, 64])),
        service.reset,
    ]
    failed = 0
    for _ in range(300):
        clock.run_for(chance.randrange(60_000_000))
        chance.choices(actions, [5, 5, 5, 10, 1])[0]()
        blocks, [channel, _] = service.status(), run_status(service).channels
        for one in blocks:
            assert one.started - one.done - one.failed == one.running, one
            assert not (one.running and one.waiting)
        assert sum(block.running for block in blocks) <= len(blocks)
        assert channel.services == sum(block.done for block in blocks)
        assert channel.errors == sum(block.failed for block in blocks) == sum(channel.reasons.values())
        failed += channel.errors
    assert failed > 0
    for number in service.states:
        service.enable(number, False)
    clock.run_for(10 * SECOND)
    assert not any(status.running or status.waiting for status in service.status()), "what ran has ended"
