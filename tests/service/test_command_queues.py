"""Command blocks that a channel does not take: before its first moment, and when too many wait."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from command_world import SECOND, text_words

from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

RUN = """run: queued
memory: ge-90-30
channels:
  1: {{port: "sim:there.device.yaml", protocol: snp, {settings}}}
blocks:
  0: {{command: R1, fault: M1{first}}}
  1: {{command: R21, fault: M2}}
  2: {{command: R41, fault: M3}}
  3: {{read: R1, into: R900, station: SNPID1}}
"""


class World:
    def __init__(self, folder: Path, settings: str, first: str = "") -> None:
        (folder / "there.device.yaml").write_text("device: there\nprotocol: snp\nstation: SNPID1\n", encoding="utf-8")
        (folder / "q.run.yaml").write_text(RUN.format(settings=settings, first=first), encoding="utf-8")
        self.clock = VirtualClock()
        self.service = RunService(load_run(folder / "q.run.yaml"), self.clock)
        for number in range(3):
            words = [7, 0, 8, 499 + number, 0, 0, 7200, *text_words("SNPID1"), 0, 0]
            self.service.memory.write("R", "word", 20 * number, words)
        self.service.start()

    def run(self, seconds: float) -> None:
        self.clock.run_for(int(seconds * SECOND))

    def faults(self) -> list[int]:
        return self.service.memory.read("M", "bit", 0, 3)

    def status_words(self) -> list[int]:
        return self.service.memory.read("R", "word", 499, 3)

    def last(self, number: int) -> Any:
        return self.service.states[number].last_failure


def test_a_command_before_the_channel_takes_commands_is_a_fault(tmp_path: Path) -> None:
    world = World(tmp_path, "command_start: 2 s")
    world.run(1)
    world.service.fire(0)
    world.service.fire(3)
    world.run(0.9)
    assert world.faults() == [1, 0, 0] and world.status_words() == [0, 0, 0]
    assert (world.last(0).outcome, world.last(0).cause) == ("queue_full", "the channel takes no commands yet")
    assert world.service.states[3].done == 1, "other blocks do not wait"
    world.run(0.2)
    world.service.fire(0)
    world.run(2)
    assert world.faults() == [0, 0, 0] and world.status_words() == [1, 0, 0]


def test_one_command_more_than_may_wait_is_a_fault(tmp_path: Path) -> None:
    world = World(tmp_path, "command_queue: 1")
    world.run(1)
    for number in (0, 1, 2):
        world.service.fire(number)
        world.run(0.001)
    assert world.faults() == [0, 0, 1], "one at work, one waits"
    assert world.last(2).cause == "the queue of the channel is full"
    world.run(5)
    assert world.status_words() == [1, 1, 0]
    world.service.fire(2)
    world.run(5)
    assert world.faults() == [0, 0, 0] and world.status_words() == [1, 1, 1]


def test_without_the_keys_all_commands_wait(tmp_path: Path) -> None:
    world = World(tmp_path, "role: master")
    for number in (0, 1, 2):
        world.service.fire(number)
    world.run(5)
    assert world.faults() == [0, 0, 0] and world.status_words() == [1, 1, 1]


def test_a_command_that_starts_by_a_level_is_taken_later(tmp_path: Path) -> None:
    world = World(tmp_path, "command_start: 2 s", ", while: M9")
    world.service.memory.write("M", "bit", 8, [1])
    world.run(1.5)
    assert world.faults() == [1, 0, 0]
    world.run(2)
    assert world.status_words() == [1, 0, 0] and world.service.states[0].done >= 1
