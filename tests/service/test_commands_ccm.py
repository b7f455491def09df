"""Commands 6001 to 6113 carried out against a simulated CCM slave: memory on both sides, status word, every refusal."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_world import SECOND, CommandWorld

DEVICE = "station: 5\nmemory: {set: {'%R101': [11, 22, 33, 44], '%I9': [1, 0, 1, 1, 0, 0, 1, 0], '%Q17': [1, 1]}}\n"


@pytest.fixture
def world(tmp_path: Path) -> CommandWorld:
    return CommandWorld(tmp_path, "ccm", DEVICE, ", role: master, own: 1")


def test_read_registers(world: CommandWorld) -> None:
    assert world.do(6101, 5, 1, 101, 3, 200) == 1
    assert world.own("R", 200, 4) == [11, 22, 33, 0]
    assert not world.fault


def test_read_into_inputs_and_outputs(world: CommandWorld) -> None:
    assert world.do(6102, 5, 2, 9, 8, 17) == 1
    assert world.own("I", 17, 8) == [1, 0, 1, 1, 0, 0, 1, 0]
    assert world.do(6103, 5, 3, 17, 8, 1) == 1
    assert world.own("Q", 1, 8) == [1, 1, 0, 0, 0, 0, 0, 0]


def test_lengths_count_the_own_elements(world: CommandWorld) -> None:
    assert world.do(6102, 5, 1, 101, 32, 1) == 1, "two registers fill 32 inputs"
    assert world.own("I", 1, 16) == [int(bit) for bit in f"{11:016b}"[::-1]]
    assert world.do(6101, 5, 6, 0x18, 2, 300) == 1, "four bytes of the scratch pad fill two registers"
    assert world.own("R", 300, 3) == [0, 0, 0]
    assert world.do(6101, 5, 2, 9, 1, 310) == 1, "16 inputs fill a register"
    assert world.own("R", 310) == [0b01001101]


def test_read_status_words_of_the_target(world: CommandWorld) -> None:
    assert world.do(6101, 5, 9, 1, 12, 400) == 1
    assert world.own("R", 411) == [0x0103], "software version"


def test_write_registers_inputs_and_outputs(world: CommandWorld) -> None:
    world.put("R", 50, 1, 2, 3)
    assert world.do(6111, 5, 1, 200, 3, 50) == 1
    assert world.at("R", 200, 4) == [1, 2, 3, 0]
    world.put("I", 9, 1, 1, 0, 1, 0, 0, 0, 1)
    assert world.do(6112, 5, 3, 1, 8, 9) == 1
    assert world.at("Q", 1, 8) == [1, 1, 0, 1, 0, 0, 0, 1]
    world.put("Q", 1, 1, 0, 0, 0, 0, 0, 0, 1)
    assert world.do(6113, 5, 1, 300, 8, 1) == 1, "eight points and zeros make a register"
    assert world.at("R", 300, 2) == [0x81, 0]


@pytest.mark.parametrize(("type_", "area", "value"), [(13, "I", 1), (14, "Q", 1), (17, "I", 0), (18, "Q", 0)])
def test_single_bits(world: CommandWorld, type_: int, area: str, value: int) -> None:
    world.there.memory.write(area, "bit", 39, [1 - value] * 3)
    assert world.do(6110, 5, type_, 41) == 1
    assert world.at(area, 40, 3) == [1 - value, value, 1 - value]


def test_read_q_response(world: CommandWorld) -> None:
    world.there.engine.scope.set("quick_data", bytes([1, 2, 3, 4]))
    assert world.do(6109, 5, 0, 0, 0, 100) == 1
    assert world.own("R", 100, 2) == [0x0201, 0x0403]


def test_set_q_response_of_the_own_slave(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "ccm", "station: 5\n", ", role: slave, own: 7")
    assert world.do(6001, 0x0201, 0x0403) == 1
    assert world.service.channels[1].engine.scope["quick_data"] == bytes([1, 2, 3, 4])
    assert world.do(6101, 5, 1, 1, 1, 1) == 31, "a slave asks nobody"


def test_own_status_words(world: CommandWorld) -> None:
    assert world.do(6101, 5, 1, 101, 1, 200) == 1
    assert world.do(6101, 9, 1, 101, 1, 200) == 23, "nobody is 9"
    assert world.do(6003, 0, 0, 1, 12, 600) == 1
    assert world.own("R", 600, 2) == [23, 1] and world.own("R", 611) == [0x0103]
    assert world.do(6003, 0, 0, 2, 1, 700) == 1
    assert world.own("R", 700, 2) == [1, 0]
    assert world.do(6002) == 1
    assert world.do(6003, 0, 0, 1, 20, 600) == 1
    assert world.own("R", 600, 2) == [0, 0] and world.own("R", 611) == [0x0103], "the version survives"


def test_software_configuration(world: CommandWorld) -> None:
    scope = world.service.channels[1].engine.scope
    before = scope["data_ack"]
    keep = [0xFFFF]
    assert world.do(6004, 1000, *keep * 8, 16, *keep * 4) == 1
    assert (scope["turnaround"], scope["enq_count"], scope["data_ack"]) == (SECOND, 16, before)
    assert world.do(6004, *keep * 9, 51, *keep * 4) == 32
    assert world.do(6004, *keep * 12, 3, *keep) == 32, "there are no three wires"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ([6101, 5, 1, 101, 3], 30),
        ([6101, 5, 1, 101, 3, 200, 0], 30),
        ([6099], 32),
        ([6101, 0, 1, 101, 3, 200], 32),
        ([6101, 91, 1, 101, 3, 200], 32),
        ([6101, 5, 1, 101, 0, 200], 8),
        ([6101, 5, 1, 101, 3, 0], 32),
        ([6101, 5, 4, 101, 3, 200], 10),
        ([6111, 5, 9, 1, 3, 200], 10),
        ([6110, 5, 15, 1], 10),
        ([6110, 5, 13, 0], 4),
        ([6102, 5, 2, 9, 7, 17], 12),
        ([6102, 5, 2, 9, 8, 18], 12),
        ([6101, 5, 1, 101, 3, 2047], 7),
        ([6102, 5, 2, 9, 8, 513], 4),
        ([6101, 5, 1, 2049, 1, 1], 10),
        ([6001, 1, 2], 16),
        ([6003, 0, 0, 0, 1, 100], 11),
        ([6003, 0, 0, 20, 2, 100], 11),
        ([6101, 9, 1, 101, 1, 200], 23),
    ],
)
def test_refusals_and_failures(world: CommandWorld, words: list[int], code: int) -> None:
    world.put("R", 200, 77)
    assert world.do(*words) == code
    assert not world.fault and world.own("R", 200) == [77], "nothing is stored"
    (status,) = world.service.status()
    assert status.failed == 1 and status.last_failure is not None
    assert status.last_failure.device_code == code and status.last_failure.meaning


def test_what_the_target_breaks_off(tmp_path: Path) -> None:
    device = (
        "station: 5\nmemory: {areas: {R: {unit: word, size: 50}, I: {unit: bit, size: 8}, Q: {unit: bit, size: 8}}}\n"
    )
    world = CommandWorld(tmp_path, "ccm", device, ", role: master, own: 1")
    assert world.do(6101, 5, 1, 51, 1, 200) == 22, "it ends the conversation instead of an ACK"
    assert world.do(6101, 5, 1, 50, 1, 200) == 1


def test_q_responses_time_out(world: CommandWorld) -> None:
    assert world.do(6109, 9, 0, 0, 0, 100) == 15


def test_peers(tmp_path: Path) -> None:
    world = CommandWorld(
        tmp_path, "ccm", "station: 5\nrole: peer\nmemory: {set: {'%R1': [7]}}\n", ", role: peer, own: 1"
    )
    assert world.do(6101, 5, 1, 1, 1, 20) == 1 and world.own("R", 20) == [7]
    assert world.do(6109, 5, 0, 0, 0, 100) == 31, "quick reads are a master's"
    world.there.stop()
    assert world.do(6101, 5, 1, 1, 1, 20) == 25
