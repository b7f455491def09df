"""Commands 7000 to 7300 executed with a simulated SNP slave: both memories, status words, every refusal."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_world import SECOND, CommandWorld, text_words

DEVICE = """station: SNPID1
memory: {set: {R1: [0x0155, 22, 33, 44], I1: [1, 0, 1, 1, 0, 0, 1, 0, 1, 1]}}
"""
LARGE = """station: SNPID1
params: {family: 90-70}
memory: {set: {P1: [71, 72], L1: [81, 82]}}
state: {program: {initial: "'MAIN'"}}
"""
ATTACH = [7200, *text_words("SNPID1"), 0, 0]
R, AI, IN, M = 8, 10, 70, 76


@pytest.fixture
def world(tmp_path: Path) -> CommandWorld:
    world = CommandWorld(tmp_path, "snp", DEVICE)
    assert world.do(*ATTACH) == 1
    return world


def test_attach_and_read(world: CommandWorld) -> None:
    assert world.do(7202, R, 1, 4, R, 100) == 1
    assert world.own("R", 100, 5) == [0x0155, 22, 33, 44, 0]


def test_enough_is_read_to_fill_the_own_elements(world: CommandWorld) -> None:
    world.put("I", 1, *[1] * 16)
    assert world.do(7202, R, 1, 10, IN, 1) == 1
    assert world.own("I", 1, 12) == [1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 1], "the bits behind the tenth stay"
    assert world.do(7202, IN, 1, 1, R, 100) == 1
    assert world.own("R", 100) == [0b1101001101]
    assert world.do(7202, 16, 1, 1, AI, 7) == 1, "two bytes make a word"
    assert world.own("AI", 7) == [0b1101001101]


def test_what_is_written_is_filled_with_zeros(world: CommandWorld) -> None:
    world.there.memory.write("R", "word", 200, [0xFFFF, 0xFFFF])
    assert world.do(7201, 2, *text_words("")) == 1
    world.put("I", 1, *[1] * 10)
    assert world.do(7203, R, 201, 10, IN, 1) == 1
    assert world.at("R", 201, 2) == [0x03FF, 0xFFFF]
    world.put("R", 100, 7, 8, 9)
    assert world.do(7203, R, 1, 3, R, 100) == 1
    assert world.at("R", 1, 4) == [7, 8, 9, 44]


def test_writes_need_the_level(world: CommandWorld) -> None:
    world.put("R", 100, 7)
    assert world.do(7203, R, 1, 1, R, 100) == 0x0202, "level 2 is needed"
    assert world.do(7201, 9, *text_words("")) == 0x0F0C
    world.there.engine.scope.set_entry("passwords", 3, "TOP")
    assert world.do(7201, -1, *text_words("TOP")) == 1, "the highest level that the password opens"
    assert world.there.engine.scope["level"] == 3
    assert world.do(7203, R, 1, 1, R, 100) == 1


def test_passwords(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "snp", DEVICE)
    world.there.engine.scope.set_entry("passwords", 2, "PASS1")
    assert world.do(*ATTACH) == 1
    assert world.do(7201, 2, *text_words("WRONG")) == 0xF505
    assert world.do(7201, 2, *text_words("PASS1")) == 1


def test_piggy_back_status(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "snp", DEVICE)
    assert world.do(7200, *text_words("SNPID1"), R, 171) == 1
    assert world.do(7202, R, 1, 1, R, 100) == 1
    low = world.own("R", 171)[0]
    assert low >> 8 == 1, "privilege level in the high byte"
    assert world.own("R", 172) == [39] and world.own("R", 173)[0] >> 12 == 2, "sweep time, stopped"


def test_task_and_program_block_memory(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "snp", LARGE, ", params: {family: 90-70}")
    assert world.do(*ATTACH) == 1
    assert world.do(7201, 2, *text_words("")) == 1
    assert world.do(7204, 1, 2, R, 100, *text_words("MAIN")) == 1
    assert world.own("R", 100, 2) == [71, 72]
    assert world.do(7206, 1, 2, R, 110, *text_words("MAIN"), *text_words("BLOCK1")) == 1
    assert world.own("R", 110, 2) == [81, 82]
    world.put("R", 120, 5, 6)
    assert world.do(7205, 3, 2, R, 120, *text_words("MAIN")) == 1
    assert world.at("P", 1, 4) == [71, 72, 5, 6]
    assert world.do(7207, 3, 2, R, 120, *text_words("MAIN"), *text_words("BLOCK1")) == 1
    assert world.at("L", 1, 4) == [81, 82, 5, 6]


def test_status_names_and_identity(world: CommandWorld) -> None:
    scope = world.there.engine.scope
    assert world.do(7208, R, 200) == 1
    assert world.own("R", 200) == [0] and world.own("R", 204) == [39], "no program; sweep time in the fifth word"
    assert world.own("R", 205)[0] >> 12 == 2
    scope.set("program", "LESSON1")
    assert world.do(7209, R, 220, 2) == 1
    assert world.own("R", 220, 5) == [1, *text_words("LESSON1")]
    assert world.do(7210, R, 240) == 1
    assert world.own("R", 240, 4) == text_words("SNPID1")
    assert world.own("R", 244) == [16 << 8 | 35] and world.own("R", 245) == [1]
    assert world.own("R", 246, 4) == text_words("LESSON1")


def test_time_and_date(world: CommandWorld) -> None:
    assert world.do(7201, 2, *text_words("")) == 1
    assert world.do(7213, 1, 0x1292, 0x1324, 0x5859, 2) == 1
    clock = world.there.engine.scope["clock"]
    assert (clock["month"], clock["day"], clock["hour"]) == (12, 24, 13)
    assert world.do(7213, 3, 0x0192, 0x0019, 0, 1) == 1, "only the date"
    clock = world.there.engine.scope["clock"]
    assert (clock["month"], clock["day"], clock["hour"]) == (1, 19, 13)
    assert world.do(7213, 2, 0, 0x0700, 0x3015, 1) == 1, "only the time"
    assert world.do(7211, R, 300) == 1
    year_month, day_hour, minute_second, _ = world.own("R", 300, 4)
    assert (year_month, day_hour, minute_second & 0xFF) == (0x0192, 0x0719, 0x15)
    assert world.do(7213, 4, 0, 0, 0, 0) == 1, "the own clock"
    theirs, mine = world.there.engine.scope["clock"], world.service.channels[1].engine.scope["clock"]
    assert [theirs[name] for name in ("month", "day", "hour")] == [mine[name] for name in ("month", "day", "hour")]


def test_fault_tables(world: CommandWorld) -> None:
    scope = world.there.engine.scope
    empty = {"second": 1, "minute": 2, "hour": 3, "day": 4, "month": 5, "year": 92}
    plc = {"rack": 0, "slot": 3, "unit": 0, "group": 18, "action": 2, "code": 0x1234, **empty}
    scope.set("plc_faults", [plc, {**plc, "slot": 4}])
    assert world.do(7212, 2, 2, 1, R, 600) == 1
    assert world.own("R", 603, 3) == [2, 2, 1], "faults since the clear, in the table, in this reply"
    assert world.own("R", 606 + 2)[0] == 4 << 8, "rack and slot of the second"
    assert world.own("R", 606 + 5) == [0x1234]
    assert world.own("R", 606 + 18, 3) == [0x0201, 0x0403, 0x9205]
    assert world.do(7212, 1, 1, 32, R, 700) == 1
    assert world.own("R", 703, 3) == [0, 0, 0]
    for words, code in [((3, 1, 1), 0x100C), ((2, 0, 1), 0x110C), ((2, 17, 1), 0x110C), ((2, 2, 16), 0x120C),
                        ((1, 33, 1), 0x110C), ((1, 1, 33), 0x120C), ((2, 1, 0), 0x120C)]:  # fmt: skip
        assert world.do(7212, *words, R, 600) == code


def test_toggle(world: CommandWorld) -> None:
    assert world.do(7201, 2, *text_words("")) == 1
    assert world.do(7214, M, 5) == 1
    assert world.at("M", 4, 3) == [0, 1, 0]
    assert world.do(7214, M + 80, 5) == 0x0302, "overrides need level 3"
    assert world.do(7214, R, 5) == 0x0A0C
    assert world.do(7214, M, 0) == 0x0B0C


def test_datagrams(world: CommandWorld) -> None:
    points = [2, R, 1, 3, 16, 1, 2]
    assert world.do(7215, 1, 0x81, 8, R, 160, 0, 0, 0, 0, *points) == 1
    (number,) = world.own("R", 160)
    assert number > 0
    assert world.do(7216, number, 0x81, R, 170) == 1
    assert world.own("R", 170, 4) == [0x0155, 22, 33, 0b1101001101]
    assert world.do(7218, number, *text_words("SNPID1"), R, 180, R, 190) == 1
    assert world.own("R", 180, 4) == world.own("R", 170, 4)
    assert world.own("R", 191) == [39], "piggy-back status of its own"
    assert world.do(7217, number, 0x81) == 0x030C, "that was without a session, and ended the old one"
    assert world.do(*ATTACH) == 1
    assert world.do(7217, number, 0x81) == 1
    assert world.do(7216, number, 0x81, R, 170) == 0xDD05
    assert world.do(7217, -1, 1) == 1
    place = (R, 160, 0, 0, 0, 0)
    for words, code in [((2, 1, 8, *place, *points), 0x160C), ((1, 2, 8, *place, *points), 0x170C),
                        ((1, 1, 8, *place, 0), 0x180C), ((1, 1, 0, *place, *points), 0x1A0C)]:  # fmt: skip
        assert world.do(7215, *words) == code


def test_long_attach_sets_the_times(world: CommandWorld) -> None:
    times = [10, 1500, 20000, 60, 0, 20, 0, 500]
    assert world.do(7300, *text_words("SNPID1"), 0, 0, *times) == 1
    scope = world.service.channels[1].engine.scope
    assert (scope["own_t2"], scope["own_data_size"], scope["data_size"]) == (1_500_000_000, 500, 500)
    assert world.do(7202, R, 1, 1, R, 100) == 1
    assert world.do(7300, *text_words("SNPID1"), 0, 0, *times[:-1], 501) == 0x0E0C


def test_names_of_programs_that_the_slave_does_not_have_are_empty(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "snp", "station: SNPID1\nstate: {program: {initial: \"'MAIN'\"}}\n")
    world.put("R", 100, *[7] * 12)
    assert world.do(*ATTACH) == 1
    assert world.do(7209, R, 100, 2) == 1
    assert world.own("R", 100, 10) == [1, *text_words("MAIN"), 0, 0, 0, 0, 7]


def test_diagnostic_status_words(world: CommandWorld) -> None:
    assert world.do(7202, R, 1, 1, R, 100) == 1
    failing = [7202, R, 0, 1, R, 100]
    assert world.do(*failing) == 0x0B0C
    assert world.do(7001, 1, 20, R, 800) == 1
    assert world.own("R", 800, 4) == [0x0B0C, 2, 1, 0]
    assert world.own("R", 813) == [0x0103] and world.own("R", 814, 6) == failing
    assert world.do(7000) == 1
    assert world.do(7001, 2, 1, AI, 3) == 1
    assert world.own("AI", 3) == [0]
    assert world.do(7001, 20, 2, R, 800) == 0x0D0C


def test_change_snp_id_of_the_own_slave(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "snp", "role: master\nstation: SNPID1\n", ", role: slave, own: OLDID")
    assert world.do(7002, *text_words("NEWID1")) == 1
    assert world.service.channels[1].engine.scope["cpu_id"] == "NEWID1"
    assert world.do(*ATTACH) == 0x020C, "a slave attaches to nobody"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ([7201, 1, 0], 0x0C0C),
        ([7219], 0x020C),
        ([6101, 5, 1, 1, 1, 1], 0x020C),
        ([7003, 70, 1], 0x020C),
        ([7002, 0, 0, 0, 0], 0x020C),
        ([7400, 30, 251, *[0x5441] * 121], 0x020E),
        ([7400, 30, 5, 0x5441, 0x0D5A], 0x030E),
        ([7400, 30, 0], 0x030E),
        ([7202, 99, 1, 1, R, 100], 0x0A0C),
        ([7202, R, 0, 1, R, 100], 0x0B0C),
        ([7202, R, 1, 1, 99, 100], 0x060C),
        ([7202, R, 1, 0, R, 100], 0x070C),
        ([7202, R, 1, 1, R, 0], 0x070C),
        ([7202, R, 1, 1025, R, 100], 0x090C),
        ([7202, R, 1, 2, R, 2048], 0x080C),
        ([7202, R, 32641, 1, R, 100], 0x0B0C),
        ([7209, R, 100, 9], 0x1B0C),
        ([7213, 5, 0x0192, 0x0019, 0, 1], 0x130C),
        ([7213, 1, 0x1392, 0x0019, 0, 1], 0x140C),
        ([7213, 1, 0x0A92, 0x0019, 0, 1], 0x140C),
        ([7200, *text_words("SNPID1"), 99, 1], 0x350C),
        ([7216, 1, 3, R, 1], 0x170C),
        ([7215, 1, 1, 21, R, 161, 0, 0, 0, 0, 2, R, 201, 10, 16, 1, 2], 0x1A0C),
        ([7215, 1, 1, 22, R, 161, 0, 0, 0, 0, 2, R, 201, 10, 99, 1, 2], 0x190C),
        ([7215, 1, 1, 22, R, 161, 0, 0, 0, 0, 1, R, 201, 0], 0x190C),
        ([7215, 1, 1, 22, R, 161, 0, 0, 0, 0, 1, R, 201, 257], 0x190C),
        ([7215, 1, 1, 22, R, 161, 0, 0, 0, 0, 1, 70, 5, 5], 0x190C),
        ([7215, 0, 1, 22, R, 161, 0, 0, 0, 0, 1, 70, 1, 1], 0x190C),
        ([7216, 1, 1, R, 1], 0xDD05),
    ],
)
def test_refusals(world: CommandWorld, words: list[int], code: int) -> None:
    assert world.do(*words) == code
    assert not world.fault
    (status,) = world.service.status()
    assert status.last_failure is not None and status.last_failure.device_code == code
    assert status.last_failure.meaning


def test_nobody_may_wait(world: CommandWorld) -> None:
    assert world.do(7202, R, 1, 1, R, 100, wait=1, longest=60000) == 0x010C


def test_sessions(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "snp", DEVICE)
    assert world.do(7202, R, 1, 1, R, 100) == 0x030C, "attach first"
    assert world.do(7200, *text_words("OTHER"), 0, 0) == 0x040C
    assert world.do(7202, R, 1, 1, R, 100) == 0x030C
    assert world.do(*ATTACH) == 1
    world.there.stop()
    status = world.do(7202, R, 1, 1, R, 100)
    assert status & 0xFF == 0x0C and status >> 8 in (0x2D, 0x04)
    assert world.do(7202, R, 1, 1, R, 100) == 0x030C, "the session is gone"
    assert world.do(7001, 4, 1, R, 800) == 1 and world.own("R", 800)[0] >= 1, "aborts"


def silent(which: str) -> str:
    """Return the device with a fault that suppresses its frames."""
    return f"{DEVICE}faults: {{seed: 1, rules: [{{fault: no_reply{which}}}]}}\n"


@pytest.mark.parametrize("which", [", from: 3 s", ", from: 3 s, frame: mailbox", ", frame: mailbox"])
def test_a_command_without_timers_ends_by_its_own(tmp_path: Path, which: str) -> None:
    """Silence after Attach, missing replies, and no answer to Parameter Select: the command ends after 30 s."""
    world = CommandWorld(tmp_path, "snp", silent(which), ", params: {timeouts: none}")
    attached = world.do(*ATTACH)
    assert attached == (1 if "from" in which else 0x320C)
    world.clock.run_for(3 * SECOND)
    before = world.clock.now()
    assert world.do(7202, R, 1, 1, R, 100) == (0x320C if "from" in which else 0x030C)
    if "from" in which:
        assert 30 <= (world.clock.now() - before) / SECOND <= 31
    assert not world.service.channels[1].engine.is_busy
    assert world.do(*ATTACH) in (0x320C, 0x040C), "the session is over, and the next one begins"
    (status,) = world.service.status()
    assert status.last_failure is not None and status.last_failure.meaning in ("COMMREQ timeout", "no answer to Attach")


def test_the_time_limit_of_a_command_is_a_parameter(tmp_path: Path) -> None:
    settings = ", params: {timeouts: none, commreq_timeout: 5 s}"
    world = CommandWorld(tmp_path, "snp", silent(", from: 3 s"), settings)
    assert world.do(*ATTACH) == 1
    world.clock.run_for(3 * SECOND)
    before = world.clock.now()
    assert world.do(7202, R, 1, 1, R, 100) == 0x320C
    assert 5 <= (world.clock.now() - before) / SECOND <= 5.5


def test_t2_stays_when_long_attach_switches_t3_off(tmp_path: Path) -> None:
    """The manual's example: T2 2000, T3 0; then the slave becomes silent."""
    world = CommandWorld(tmp_path, "snp", silent(", from: 3 s"))
    assert world.do(7300, *text_words("SNPID1"), R, 171, 5, 2000, 0, 100, 0, 10, 0, 256) == 1
    world.clock.run_for(3 * SECOND)
    before = world.clock.now()
    assert world.do(7202, R, 1, 2, R, 101) == 0x2D0C, "no acknowledge in time"
    assert 2 <= (world.clock.now() - before) / SECOND <= 3


def test_long_attach_sets_t5_and_the_transmission_delay(tmp_path: Path) -> None:
    world = CommandWorld(tmp_path, "snp", silent(", from: 3 s, frame: mailbox"))
    assert world.do(7300, *text_words("SNPID1"), 0, 0, 5, 2000, 10000, 50, 1000, 0, 3, 256) == 1
    world.clock.run_for(3 * SECOND)
    before = world.clock.now()
    assert world.do(7202, R, 1, 2, R, 101) == 0x2E0C, "no response in time"
    assert 4 <= (world.clock.now() - before) / SECOND <= 5, "T5, and the delay of 3 s"


PORT_SETUP = [0xFFF0, 1, 1, 5, 2, 1, 1, 0, 1, 1, 0, 1]
"""9600 bits a second, even parity, two stop bits, turnaround of 10 ms."""


@pytest.mark.parametrize(
    ("place", "value", "code"),
    [(1, 2, 0x0213), (2, 0, 0x0513), (3, 7, 0x0513), (4, 3, 0x0513), (5, 2, 0x0513), (7, 1, 0x0513), (8, 0, 0x0513)],
)
def test_wrong_port_setups(world: CommandWorld, place: int, value: int, code: int) -> None:
    words = list(PORT_SETUP)
    words[place] = value
    assert world.do(*words) == code
    assert world.do(7202, R, 1, 1, R, 100) == 1, "the session goes on"


def test_a_port_setup_of_another_length(world: CommandWorld) -> None:
    assert world.do(*PORT_SETUP[:8]) == 0x0313
