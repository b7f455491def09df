"""Commands 6001 to 6113 executed with a simulated CCM slave: memory on both sides, status word, every refusal."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_world import SECOND, CommandWorld

from framekit.transport.simulated_line import SimulatedPort

LENGTH, PORT, VALUES = 0x0002, 0x0003, 0x0004
"""Status words of the three errors whose numbers are not in the manual."""


def error(code: int) -> int:
    """Return the status word of an error of the manual's table: its code is the high byte."""
    return code << 8 | 2


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
    assert world.do(6101, 5, 1, 1, 1, 1) == PORT, "a slave asks nobody"


def test_own_status_words(world: CommandWorld) -> None:
    assert world.do(6101, 5, 1, 101, 1, 200) == 1
    assert world.do(6101, 9, 1, 101, 1, 200) == error(23), "nobody is 9"
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
    assert world.do(6004, *keep * 9, 51, *keep * 4) == VALUES
    assert world.do(6004, *keep * 12, 3, *keep) == VALUES, "there are no three wires"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ([6101, 5, 1, 101, 3], LENGTH),
        ([6101, 5, 1, 101, 3, 200, 0], LENGTH),
        ([6099], VALUES),
        ([6101, 0, 1, 101, 3, 200], VALUES),
        ([6101, 91, 1, 101, 3, 200], VALUES),
        ([6101, 5, 1, 101, 0, 200], error(8)),
        ([6101, 5, 1, 101, 3, 0], VALUES),
        ([6101, 5, 128, 101, 3, 200], error(10)),
        ([6101, 5, 1, 101, 32768, 200], error(5)),
        ([6102, 5, 2, 9, 7, 17], error(12)),
        ([6102, 5, 2, 9, 8, 18], error(12)),
        ([6101, 5, 1, 101, 3, 2047], error(7)),
        ([6111, 5, 1, 101, 3, 2047], error(7)),
        ([6102, 5, 2, 9, 8, 513], error(4)),
        ([6001, 1, 2], error(16)),
        ([6003, 0, 0, 0, 1, 100], error(11)),
        ([6003, 0, 0, 20, 2, 100], error(11)),
        ([6101, 9, 1, 101, 1, 200], error(23)),
    ],
)
def test_refusals_and_failures(world: CommandWorld, words: list[int], code: int) -> None:
    world.put("R", 200, 77)
    assert world.do(*words) == code
    assert not world.fault and world.own("R", 200) == [77], "nothing is stored"
    (status,) = world.service.status()
    assert status.failed == 1 and status.last_failure is not None
    assert status.last_failure.device_code == code and status.last_failure.meaning


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ([6101, 5, 4, 101, 3, 200], 10),
        ([6101, 5, 7, 1, 2, 200], 10),
        ([6111, 5, 9, 1, 3, 200], 9),
        ([6111, 5, 6, 1, 2, 200], 3),
        ([6110, 5, 15, 1], 10),
        ([6110, 5, 13, 0], 4),
        ([6101, 5, 1, 0, 1, 1], 7),
        ([6102, 5, 2, 10, 8, 17], 12),
        ([6101, 5, 6, 250, 6, 1], 12),
        ([6101, 5, 9, 20, 2, 1], 11),
    ],
)
def test_the_target_judges_types_and_addresses(world: CommandWorld, words: list[int], code: int) -> None:
    world.put("R", 200, 77)
    assert world.do(*words) == error(22), "it ends the conversation instead of an ACK"
    assert world.own("R", 200) == [77] and not world.fault
    assert world.there.engine.scope["last_error"] == code


@pytest.mark.parametrize(
    ("words", "header"),
    [
        ([6102, 5, 2, 2, 8, 17], "0502000200010117"),
        ([6112, 5, 2, 4, 8, 1], "0582000400010117"),
        ([6101, 5, 7, 65535, 3, 1], "0507FFFF00060117"),
        ([6103, 5, 120, 0, 512, 1], "0578000000400117"),
        ([6110, 5, 21, 4097], "0595100100000117"),
        ([6101, 5, 1, 101, 3, 200], "0501006500060117"),
        ([6113, 5, 1, 300, 8, 1], "0581012C00020117"),
    ],
)
def test_headers_have_the_type_and_the_address_of_the_block(tmp_path: Path, words: list[int], header: str) -> None:
    """Byte-oriented addresses of a Series One, Three or Five, and memory types of other targets."""
    seen: list[bytes] = []
    world = CommandWorld(tmp_path, "ccm", DEVICE, ", role: master, own: 1", lambda _, event: seen.append(event.raw))
    world.put("Q", 1, *[0] * 8)
    world.do(*words)
    sent = [data[1:15].decode("ascii") for data in seen if data[:1] == b"\1"]
    assert sent[:1] == [header[:-2]]


def test_large_targets(tmp_path: Path) -> None:
    device = "station: 25\nmemory: {sizes: {Q1: 1024, R1: 16384}, set: {Q713: 1, R5000: [7, 8]}}\n"
    world = CommandWorld(tmp_path, "ccm", device, ", role: master, own: 1")
    assert world.at("Q", 713) == [1]
    assert world.do(6110, 25, 18, 713) == 1 and world.at("Q", 713) == [0]
    assert world.do(6101, 25, 1, 5000, 2, 1) == 1 and world.own("R", 1, 2) == [7, 8]
    assert world.do(6101, 25, 1, 16384, 2, 1) == error(22)


def test_status_words_have_the_last_error_status_and_command(world: CommandWorld) -> None:
    assert world.do(6101, 5, 1, 101, 0, 200) == error(8), "refused here"
    assert world.do(6003, 0, 0, 1, 20, 600) == 1
    assert world.own("R", 600) == [8]
    assert world.own("R", 612, 8) == [error(8), 6101, 5, 1, 101, 0, 200, 0]


def test_wait_words_that_are_wrong_are_reported_where_the_block_says(world: CommandWorld) -> None:
    assert world.do(6101, 5, 1, 101, 3, 200, wait=2) == VALUES
    assert world.own("R", 200) == [0] and not world.fault
    assert world.do(6101, 5, 1, 101, 3, 200, wait=1, longest=50000) == 1


def test_what_the_target_breaks_off(tmp_path: Path) -> None:
    device = (
        "station: 5\nmemory: {areas: {R: {unit: word, size: 50}, I: {unit: bit, size: 8}, Q: {unit: bit, size: 8}}}\n"
    )
    world = CommandWorld(tmp_path, "ccm", device, ", role: master, own: 1")
    assert world.do(6101, 5, 1, 51, 1, 200) == error(22), "it ends the conversation instead of an ACK"
    assert world.do(6101, 5, 1, 50, 1, 200) == 1


def test_q_responses_time_out(world: CommandWorld) -> None:
    assert world.do(6109, 9, 0, 0, 0, 100) == error(15)


def test_peers(tmp_path: Path) -> None:
    world = CommandWorld(
        tmp_path, "ccm", "station: 5\nrole: peer\nmemory: {set: {'%R1': [7]}}\n", ", role: peer, own: 1"
    )
    assert world.do(6101, 5, 1, 1, 1, 20) == 1 and world.own("R", 20) == [7]
    assert world.do(6109, 5, 0, 0, 0, 100) == PORT, "quick reads are a master's"
    world.there.stop()
    assert world.do(6101, 5, 1, 1, 1, 20) == error(25)


def test_a_peer_that_refuses_every_enquiry_has_a_code_of_its_own(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "ccm", "station: 5\nrole: peer\nparams: {busy: yes}\n", ", role: peer, own: 1")
    assert world.do(6101, 5, 1, 1, 1, 20) == error(24)


def test_a_command_without_timers_ends_by_its_own(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "ccm", DEVICE, ", role: master, own: 1, params: {timeouts: none}")
    assert world.do(6101, 5, 1, 101, 1, 200) == 1
    world.there.stop()
    before = world.clock.now()
    assert world.do(6101, 5, 1, 101, 1, 200) == error(2)
    assert 30 <= (world.clock.now() - before) / SECOND <= 31


def test_cts_that_stays_off(world: CommandWorld) -> None:
    port = world.service.channels[1].driver.port
    assert isinstance(port, SimulatedPort)
    port.signal({"cts": False})
    assert world.do(6101, 5, 1, 101, 1, 200) == error(26)
    assert world.do(6003, 0, 0, 1, 1, 600) == 1 and world.own("R", 600) == [26]
    port.signal({"cts": True})
    assert world.do(6101, 5, 1, 101, 1, 200) == 1 and world.own("R", 200) == [11]


def test_a_slave_whose_cts_stays_off(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "ccm", DEVICE + "params: {cts_time: 500 ms}\n", ", role: master, own: 1")
    port = world.there.driver.port
    assert isinstance(port, SimulatedPort)
    port.signal({"cts": False})
    assert world.do(6101, 5, 1, 101, 1, 200) == error(23), "the slave does not answer"
    assert world.there.engine.scope["last_error"] == 26
    port.signal({"cts": True})
    assert world.do(6101, 5, 1, 101, 1, 200) == 1
