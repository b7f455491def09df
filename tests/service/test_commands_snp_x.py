"""Commands 7101 and 7102 executed with simulated SNP-X slaves: both memories, status words, every refusal."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from command_world import SECOND, CommandWorld, text_words
from transfer_world import TransferWorld

DEVICE = """station: 41 42 43 44 45 46 00 00
memory: {set: {R1: [0x0155, 22, 33, 44], I1: [1, 0, 1, 1, 0, 0, 1, 0, 1, 1]}}
"""
ID, NULL, ALL = text_words("ABCDEF"), [0, 0, 0, 0], [0xFFFF] * 4
R, AI, IN = 8, 10, 70


@pytest.fixture
def world(tmp_path: Path) -> CommandWorld:
    return CommandWorld(tmp_path, "snp-x", DEVICE)


def test_read(world: CommandWorld) -> None:
    assert world.do(7101, *ID, 0, R, 1, 4, R, 100) == 1
    assert world.own("R", 100, 5) == [0x0155, 22, 33, 44, 0]
    assert world.do(7101, *NULL, 0, R, 2, 1, R, 110) == 1, "any slave"
    assert world.own("R", 110) == [22]


def test_units_may_differ(world: CommandWorld) -> None:
    assert world.do(7101, *ID, 0, R, 1, 10, IN, 1) == 1
    assert world.own("I", 1, 12) == [1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 0, 0]
    world.put("I", 1, *[1] * 10)
    world.there.memory.write("R", "word", 200, [0xFFFF, 0xFFFF])
    assert world.do(7102, *ID, 0, R, 201, 10, IN, 1) == 1
    assert world.at("R", 201, 2) == [0x03FF, 0xFFFF], "filled with zeros to the register's end"


def test_small_and_large_writes(world: CommandWorld) -> None:
    world.put("R", 100, *range(1, 501))
    assert world.do(7102, *ID, 0, R, 301, 1, R, 100) == 1
    assert world.at("R", 301, 2) == [1, 0]
    assert world.do(7102, *ID, 0, R, 1001, 400, R, 100) == 1
    assert world.at("R", 1001, 401) == [*range(1, 401), 0]


def test_the_manuals_block_with_all_its_words(world: CommandWorld) -> None:
    """V-Q13: I1-I10 to R201 of any slave, status word to R32."""
    world.put("I", 1, 1, 0, 1)
    assert world.do(7102, *NULL, 0, R, 201, 10, IN, 1, R, 32, 0, 0, 0, 0) == 1
    assert world.at("R", 201) == [5]
    assert world.own("R", 32)[0] >> 12 == 2, "stopped"


def test_times_hold_for_one_exchange(world: CommandWorld) -> None:
    scope = world.service.channels[1].engine.scope
    before = scope["response_timeout"]
    assert world.do(7101, *ID, 0, R, 1, 1, R, 100, 0, 0, 700) == 1
    assert scope["response_timeout"] == before
    world.there.stop()
    world.fire([7101, *ID, 0, R, 1, 1, R, 100, 0, 0, 100])
    world.clock.run_for(2_000_000_000)
    assert not world.service.states[0].running, "a short time-out ends it early"


def test_broadcast_session(world: CommandWorld) -> None:
    world.put("R", 100, 7)
    assert world.do(7102, *ALL, 1, R, 5, 1, R, 100) == 1
    assert world.at("R", 5) == [7]
    assert world.do(7101, *ID, 1, R, 5, 1, R, 110) == 1, "directed, in the same session"
    assert world.own("R", 110) == [7]
    assert world.do(7101, *ID, 0, R, 1, 1, R, 111) == 1, "a single session of its own"
    assert world.own("R", 111) == [0x0155]


def test_diagnostic_status_words(world: CommandWorld) -> None:
    assert world.do(7101, *ID, 0, R, 1, 1, R, 100) == 1
    assert world.do(7101, *ID, 0, R, 0, 1, R, 100) == 0x0B0C
    assert world.do(7001, 1, 20, R, 800) == 1
    assert world.own("R", 800, 4) == [0x0B0C, 1, 1, 0]
    assert world.own("R", 814, 6) == [7101, *ID, 0]
    assert world.do(7000) == 1
    assert world.do(7001, 1, 1, R, 800) == 1 and world.own("R", 800) == [0]


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ([7101, *ID, 0, R, 1, 4, R], 0x0C0C),
        ([7202, R, 1, 1, R, 1], 0x020C),
        ([7101, *ID, 0, 99, 1, 4, R, 100], 0x0A0C),
        ([7101, *ID, 0, R, 0, 4, R, 100], 0x0B0C),
        ([7101, *ID, 0, R, 1, 4, 99, 100], 0x060C),
        ([7101, *ID, 0, R, 1, 0, R, 100], 0x070C),
        ([7101, *ID, 0, R, 1, 4, R, 0], 0x070C),
        ([7101, *ID, 0, R, 1, 4, R, 2046], 0x080C),
        ([7101, *ID, 2, R, 1, 4, R, 100], 0x1D0C),
        ([7101, *ALL, 1, R, 1, 4, R, 100], 0x1E0C),
        ([7102, *ALL, 0, R, 1, 4, R, 100], 0x1F0C),
        ([7102, *NULL, 1, R, 1, 4, R, 100], 0x1F0C),
        ([7101, *ID, 0, R, 1, 501, R, 100], 0x1C0C),
        ([7101, *ID, 0, R, 32640, 2, R, 100], 0x0B0C),
        ([7101, *text_words("OTHER"), 0, R, 1, 1, R, 100], 0x460C),
        ([7001, 0, 1, R, 100], 0x0D0C),
    ],
)
def test_refusals(world: CommandWorld, words: list[int], code: int) -> None:
    assert world.do(*words) == code
    (status,) = world.service.status()
    assert status.last_failure is not None and status.last_failure.meaning and not world.fault


def test_what_the_slave_refuses(tmp_path: Path) -> None:
    world = CommandWorld(
        tmp_path, "snp-x", "station: 41 42 43 44 45 46 00 00\nmemory: {areas: {R: {unit: word, size: 50}}}\n"
    )
    assert world.do(7101, *ID, 0, R, 51, 1, R, 100) == 0x040F
    assert world.do(7101, *ID, 0, AI, 1, 1, R, 100) == 0x030F


def test_nobody_may_wait(world: CommandWorld) -> None:
    assert world.do(7101, *ID, 0, R, 1, 1, R, 100, wait=1, longest=60000) == 0x010C


def test_the_address_of_the_x_status_bits_of_the_own_slave(tmp_path: Path) -> None:
    device = "station: 47 00 00 00 00 00 00 00\n"  # another slave of the line
    settings = ", role: slave, own: 41 42 43 44 45 46 00 00, params: {status_bits: cmm}"
    world = CommandWorld(tmp_path, "snp-x", device, settings)
    scope = world.service.channels[1].engine.scope
    assert world.do(7003, 76, 9) == 1
    assert (scope["bits_type"], scope["bits_address"]) == (76, 9)
    assert world.do(7003, R, 9) == 0x060C
    assert world.do(7003, 76, 0) == 0x070C
    assert world.do(7003, 0, 0) == 1, "none"
    assert scope["bits_type"] == 0


def test_a_master_has_no_x_status_bits(world: CommandWorld) -> None:
    assert world.do(7003, 76, 9) == 0x020C


def test_ids_that_no_slave_can_have(world: CommandWorld) -> None:
    assert world.do(7101, 0x4241, 0x0143, 0, 0, 0, R, 1, 1, R, 100) == 0x1E0C, "no letter"
    assert world.do(7102, *text_words("ABCDEFGH"), 0, R, 1, 1, R, 100) == 0x1E0C, "eight letters"


def test_change_snp_id_of_the_own_slave(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "snp-x", "station: OTHER\n", ", role: slave, own: OLDID")
    assert world.do(7002, *text_words("NEWID1")) == 1
    assert world.service.channels[1].engine.scope["own_id"] == b"NEWID1\0\0"
    assert world.do(7002, 0x4241, 0x0143, 0, 0) == 0x360C
    assert world.do(7101, *ID, 0, R, 1, 1, R, 100) == 0x020C, "a slave asks nobody"


class Slave:
    """A master and a slave of SNP-X on a virtual line; `device` is the state of the slave."""

    def __init__(self) -> None:
        self.world = TransferWorld("snp-x", "master", "slave", server_own=b"ABCDEF\0\0", station=b"ABCDEF\0\0")
        self.device = self.world.server.scope

    def read(self, address: str, count: int = 1) -> int | None:
        client, station = self.world.client, self.world.station
        return self.world.do(lambda **keys: client.read(address, count=count, station=station, **keys)).code

    def hears(self, *messages: str) -> list[int]:
        """Give the slave messages after a break; return its status word, good, errors, aborts and breaks."""
        driver, engine = self.world.drivers[0], self.world.server
        driver.do(lambda now: engine.line_break(now))
        for data in map(bytes.fromhex, messages):
            driver.do(partial(engine.receive, data))
            self.world.clock.run_for(SECOND)
        return [self.device[name] for name in ("last_status", "good_count", "error_count", "abort_count", "breaks")]


ATTACH = "1B 58 41 42 43 44 45 46 00 00 00 00 00 00 00 00 00 00 17 00 00 00 00 B2"
READ = "1B 58 41 42 43 44 45 46 00 00 01 08 00 00 04 00 00 00 17 00 00 00 00 1A"
WRITE = "1B 58 00 00 00 00 00 00 00 00 02 08 63 00 0A 00 00 00 17 54 1C 00 00 13"


def test_a_slave_counts_what_its_diagnostic_status_words_show() -> None:
    slave = Slave()
    assert slave.read("%R1", 4) is None
    beyond = "1B 58 41 42 43 44 45 46 00 00 01 08 FF FF 04 00 00 00 17 00 00 00 00 1A"
    assert slave.hears(ATTACH, READ, beyond) == [0x040F, 2, 1, 0, 2]


@pytest.mark.parametrize(
    ("messages", "status", "aborts"),
    [
        ([ATTACH[:-2] + "00"], 0x520F, 0),
        ([READ], 0x550F, 0),
        ([ATTACH, READ[:-2] + "00"], 0x620F, 1),
        ([ATTACH, WRITE, "1B 54" + " 00" * 20 + " 17 00 00 00 00 00"], 0x720F, 1),
        ([ATTACH, WRITE, READ], 0x220F, 1),
    ],
)
def test_status_words_of_a_slave_that_travel_in_no_message(messages: list[str], status: int, aborts: int) -> None:
    assert Slave().hears(*messages) == [status, 0, 0, aborts, 1]


def test_a_read_of_all_slaves_is_an_error_that_travels_in_no_message() -> None:
    attach = "1B 58 FF FF FF FF FF FF FF FF 00 00 00 00 00 00 00 00 17 00 00 00 00 79"
    read = "1B 58 FF FF FF FF FF FF FF FF 01 08 00 00 04 00 00 00 17 00 00 00 00 D1"
    assert Slave().hears(attach, read) == [0x150F, 0, 1, 0, 1]


def test_a_missing_buffer_and_a_break_in_its_place() -> None:
    slave = Slave()
    slave.hears(ATTACH, WRITE)
    assert slave.hears() == [0x410F, 0, 0, 1, 2]
    slave.hears(ATTACH, WRITE)
    slave.world.clock.run_for(30 * SECOND)
    assert (slave.device["last_status"], slave.device["abort_count"]) == (0x730F, 2)


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("1B 58 41 42 43 44 45 46 00 00 01 4C 01 00 40 1F 00 00 17 00 00 00 00 C1", 0x080F),
        ("1B 58 41 42 43 44 45 46 00 00 01 4C 00 00 41 1F 00 00 17 00 00 00 00 CB", 0x050F),
        ("1B 58 41 42 43 44 45 46 00 00 01 16 00 00 E9 03 00 00 17 00 00 00 00 23", 0x050F),
        ("1B 58 41 42 43 44 45 46 00 00 01 08 00 00 F5 01 00 00 17 00 00 00 00 F8", 0x050F),
    ],
)
def test_reads_that_are_too_long(message: str, code: int) -> None:
    """8,000 points from the second of a byte on fill 1,001 bytes: the length is right, the response too long."""
    assert Slave().hears(ATTACH, message) == [code, 0, 1, 0, 1]


@pytest.mark.parametrize(
    ("fault", "frame", "words", "code"),
    [
        ("wrong_check", "attach_response", [7101, *ID, 0, R, 1, 4, R, 100], 0x420C),
        ("no_reply", "attach_response", [7101, *ID, 0, R, 1, 4, R, 100], 0x460C),
        ("wrong_check", "response", [7101, *ID, 0, R, 1, 4, R, 100], 0x620C),
        ("no_reply", "response", [7101, *ID, 0, R, 1, 4, R, 100], 0x660C),
        ("wrong_check", "intermediate", [7102, *ID, 0, R, 1, 4, R, 100], 0x720C),
        ("no_reply", "intermediate", [7102, *ID, 0, R, 1, 4, R, 100], 0x760C),
    ],
)
def test_the_status_word_says_which_message_is_at_fault(
    tmp_path: Path, fault: str, frame: str, words: list[int], code: int
) -> None:
    world = CommandWorld(tmp_path, "snp-x", f"{DEVICE}faults: {{rules: [{{fault: {fault}, frame: {frame}}}]}}\n")
    assert world.do(*words) == code


def test_a_port_of_both_kinds_hears_x_messages_only() -> None:
    """A Completion ACK of SNP in place of the X-Response is another message type."""
    world = TransferWorld("snp-x", "master", "slave", server_own=b"ABCDEF\0\0", station=b"ABCDEF\0\0")
    client, station, results = world.client, world.station, []
    world.drivers[0].stop()
    world.drivers[1].do(lambda now: client.read("%R1", station=station, now=now, on_done=results.append).commands)
    world.clock.run_for(SECOND // 2)
    attached = bytes.fromhex("1B 58 41 42 43 44 45 46 00 00 80" + " 00" * 7 + " 17 00 00 00 00 A2")
    for _ in range(2):
        world.drivers[1].do(lambda now: world.engine.receive(attached, now))
        world.clock.run_for(SECOND // 2)
    assert [result.outcome for result in results] == ["response_type"]
