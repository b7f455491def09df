"""The status of a station: its last exchange decides whether it answers, independent of the block."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.api.run import VirtualRun

RUN = """run: plant
memory: {areas: {D: {unit: word, size: 100}, F: {unit: dword, size: 10}}}
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1, dead: no, timeout: 100 ms}
set: {F0: 70000}
blocks:
"""
ONCE = '  0: {read: "40001", into: D0, once: yes}\n'
OFTEN = '  1: {read: "40002", into: D1, every: 1 s}\n'


class World:
    """A run on simulated time whose device has faults that can be switched on."""

    def __init__(self, folder: Path, blocks: str) -> None:
        (folder / "meter.device.yaml").write_text("device: meter\nprotocol: modbus-tcp\nstation: 1\n", "utf-8")
        path = folder / "plant.run.yaml"
        path.write_text(RUN + blocks, "utf-8")
        self.run = VirtualRun(path, offers_faults=True)

    def switch(self, kind: str, on: bool) -> None:
        """Switch the first fault of a kind of the device on or off."""
        faults = self.run.simulated[0][1].faults
        assert faults is not None
        faults.of(kind)[0].is_on = on

    def after(self, time: str) -> tuple[int, int, bool]:
        """Return the counts of successes and failures after a time, and whether the station answers."""
        self.run.run_for(time)
        (station,) = self.run.status().stations
        return station.done, station.failed, station.answers


def test_an_earlier_success_does_not_hide_the_failures_of_the_other_block(tmp_path: Path) -> None:
    world = World(tmp_path, ONCE + OFTEN)
    done, failed, answers = world.after("3500 ms")
    assert (done > 2, failed, answers) == (True, 0, True)
    world.switch("no_reply", on=True)
    now_done, now_failed, answers = world.after("3000 s")
    assert (now_done, now_failed > 2900, answers) == (done, True, False)
    world.switch("no_reply", on=False)
    assert world.after("2 s")[2]


def test_a_refusal_is_an_answer(tmp_path: Path) -> None:
    world = World(tmp_path, ONCE + OFTEN)
    world.switch("error_reply", on=True)
    done, failed, answers = world.after("5500 ms")
    assert (done, failed > 4, answers) == (0, True, True)
    world.switch("no_reply", on=True)
    assert not world.after("5 s")[2]


@pytest.mark.parametrize("silent", [False, True])
def test_a_request_that_is_not_sent_shows_no_answer_of_its_station(tmp_path: Path, silent: bool) -> None:
    """The block whose address is 70000 fails most often and last, without a request."""
    unsent = "  2: {call: mask_write, with: {and_mask: 1, or_mask: 1}, from: {address: F0}, every: 100 ms}\n"
    world = World(tmp_path, ONCE + OFTEN + unsent)
    world.switch("no_reply", on=silent)
    _, failed, answers = world.after("5950 ms")
    last = world.run.status().blocks[2]
    assert str(last.last_failure).startswith("expression") and (last.last_end, failed > 40) == (5_900_000_000, True)
    assert answers is not silent
