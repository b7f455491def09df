"""Commands 7101 and 7102 executed with simulated SNP-X slaves: both memories, status words, every refusal."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_world import CommandWorld, text_words

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
