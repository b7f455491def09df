"""Runs controlled by lines: blocks started, disabled and enabled by hand, and refused lines with their messages."""

from __future__ import annotations

from pathlib import Path

import pytest
from near_run import started

from framekit.api.run import COMMANDS, carry_out
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
RUN = """run: by-hand
memory: masterlogic
channels:
  1: {port: "sim:there.device.yaml", protocol: modbus-rtu, station: 1}
blocks:
  0: {read: "40001", into: M100, every: 100 ms}
  3: {read: "40002", into: M101}
  4: {receive: reply_adu}
"""
DEVICE = "device: there\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: [7, 8]}}\n"


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def service(tmp_path: Path, clock: VirtualClock) -> RunService:
    return started(tmp_path, RUN, DEVICE, clock)


def test_a_block_is_fired(service: RunService, clock: VirtualClock) -> None:
    clock.run_for(SECOND)
    assert service.states[3].started == 0
    carry_out(service, "fire 3\n")
    carry_out(service, "  FIRE block 1.3  # in set 1")
    clock.run_for(SECOND)
    counters = service.states[3]
    assert (counters.started, counters.done, counters.overruns) == (1, 1, 1), "fired twice at once: runs once"
    assert service.memory.read("M", "word", 101, 1) == [8]


def test_a_block_is_disabled_and_enabled(service: RunService, clock: VirtualClock) -> None:
    clock.run_for(SECOND)
    before = service.states[0].started
    carry_out(service, "disable 0")
    clock.run_for(SECOND)
    assert service.states[0].started == before and not service.status()[0].enabled
    carry_out(service, "enable 0")
    clock.run_for(SECOND)
    assert service.states[0].started == before + 10


@pytest.mark.parametrize("line", ["", "   \n", "# nothing"])
def test_nothing_to_do(service: RunService, line: str) -> None:
    carry_out(service, line)
    assert all(state.started == 0 for state in service.states.values())


@pytest.mark.parametrize(
    ("line", "told"),
    [
        (
            "fire",
            f"'fire' is no command – write {COMMANDS}",
        ),
        ("fire 9", "there is no block 9 – known: 0, 3, 4"),
        ("fire 4", "block 4 receives: nothing but its frame makes it due"),
        ("fire 2.3", "there is no block 2.3 – known: 0, 3, 4"),
        ("fire 0.3", "there is no block 0.3 – known: 0, 3, 4"),
        ("disable 1.67", "there is no block 1.67 – known: 0, 3, 4"),
        (
            "fire ٣",
            f"'fire ٣' is no command – write {COMMANDS}",
        ),
        ("disable set 3", "there is no set 3 – known: 1"),
        ("enable channel 7", "there is no channel 7 – known: 1"),
        (
            "sing 3",
            f"'sing 3' is no command – write {COMMANDS}",
        ),
    ],
)
def test_what_cannot_be_done_is_told(service: RunService, line: str, told: str) -> None:
    with pytest.raises(ValueError) as error:
        carry_out(service, line)
    assert str(error.value) == told


def test_sets_channels_and_reset(service: RunService, clock: VirtualClock) -> None:
    clock.run_for(SECOND)
    carry_out(service, "disable set 1")
    before = service.states[0].started
    clock.run_for(SECOND)
    assert service.states[0].started == before > 0
    carry_out(service, "reset")
    assert service.states[0].started == 0
    carry_out(service, "enable set 1")
    carry_out(service, "disable channel 1")
    clock.run_for(SECOND)
    assert service.states[0].done == 0
    carry_out(service, "enable channel 1")
    clock.run_for(SECOND)
    assert service.states[0].done >= 9
