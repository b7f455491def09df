"""Command blocks in runs: faults, waiting, copying of the words, the place of the status word, loading, edits."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_world import SECOND, CommandWorld

from framekit.definition.problems import DefinitionError
from framekit.runfile.run_file import load_run

DEVICE = "station: 5\nmemory: {set: {'%R101': [11, 22, 33, 44]}}\n"
READ = [6101, 5, 1, 101, 3, 200]


@pytest.fixture
def world(tmp_path: Path) -> CommandWorld:
    return CommandWorld(tmp_path, "ccm", DEVICE, ", role: master, own: 1")


@pytest.mark.parametrize("length", [0, 129, 65535])
def test_wrong_lengths_are_a_fault_and_write_no_status_word(world: CommandWorld, length: int) -> None:
    assert world.do(*READ, length=length) == 0
    assert world.fault and world.own("R", 200) == [0]
    (status,) = world.service.status()
    assert status.failed == 1 and str(status.last_failure).startswith("cannot_send: 'words' is")
    assert world.do(*READ) == 1 and not world.fault, "the next one clears it"


def test_a_status_word_without_a_place_is_a_fault(world: CommandWorld) -> None:
    world.put("R", 1, 6, 0, 8, 2048, 0, 0, *READ)
    world.service.fire(0)
    world.clock.run_for(5 * SECOND)
    assert world.fault and world.own("R", 200) == [0], "nothing was carried out"


def test_status_words_may_stand_in_points(world: CommandWorld) -> None:
    world.put("R", 1, 6, 0, 72, 35, 0, 0, *READ)
    world.service.fire(0)
    world.clock.run_for(5 * SECOND)
    assert world.own("Q", 36, 16) == [1] + [0] * 15 and world.own("R", 200) == [11]


@pytest.mark.parametrize(("target", "ended"), [(9, True), (8, False)])
def test_parameters_of_a_station_are_those_of_commands_to_it(tmp_path: Path, target: int, ended: bool) -> None:
    stations = "stations: {9: {params: {enq_count: 1, enq_ack: 100 ms}}}"
    world = CommandWorld(tmp_path, "ccm", DEVICE, f", role: master, own: 1, {stations}")
    world.put("R", 1, 6, 0, 8, 499, 0, 0, 6101, target, *READ[2:])
    world.service.fire(0)
    world.clock.run_for(2 * SECOND)
    assert (world.own("R", 500) != [0]) is ended


def test_words_are_copied_when_the_block_starts(world: CommandWorld) -> None:
    world.fire(READ)
    world.clock.run_for(SECOND // 100)
    world.put("R", 1, *[0] * 12)
    world.clock.run_for(5 * SECOND)
    assert world.own("R", 500) == [1] and world.own("R", 200, 3) == [11, 22, 33]


def test_the_status_word_comes_once_and_after_the_data(world: CommandWorld) -> None:
    seen: list[tuple[int, int]] = []
    world.fire(READ)
    for _ in range(3000):
        world.clock.run_for(SECOND // 1000)
        now = (world.own("R", 200)[0], world.own("R", 500)[0])
        if not seen or seen[-1] != now:
            seen.append(now)
    assert seen in ([(0, 0), (11, 1)], [(0, 0), (11, 0), (11, 1)])


def test_one_who_waits_is_told_when_it_takes_too_long(world: CommandWorld) -> None:
    assert world.do(*READ, wait=1, longest=60000) == 1
    assert not world.fault, "6 s are enough"
    assert world.do(*READ, wait=1, longest=1) == 1, "the command goes on, and ends"
    assert world.fault
    assert world.do(*READ, wait=1, longest=0) == 1 and world.fault, "no time at all is a fault"
    assert world.do(*READ, wait=0, longest=0) == 1 and not world.fault, "nobody waits"


def run_with(
    folder: Path, block: str, channel: str = "protocol: ccm, role: master, own: 1", more: str = ""
) -> list[str]:
    text = (
        f"run: r\nmemory: ge-90-30\n{more}channels:\n  1: {{port: /dev/ttyS0, {channel}}}\nblocks:\n  0: {{{block}}}\n"
    )
    path = folder / "x.run.yaml"
    path.write_text(text, encoding="utf-8")
    try:
        run = load_run(path)
    except DefinitionError as error:
        return [str(problem).partition("x.run.yaml:")[2] for problem in error.problems]
    assert run.blocks[0].commands is not None
    return [run.blocks[0].commands.name]


@pytest.mark.parametrize(
    ("block", "channel", "more", "found"),
    [
        ("command: R1, once: yes", "protocol: ccm, role: master, own: 1", "", "commreq-ccm"),
        ("command: R1, once: yes", "protocol: snp", "", "commreq-snp"),
        ("command: R1, once: yes, commands: commreq-snp", "protocol: snp", "commands: commreq-ccm\n", "commreq-snp"),
        ("command: R1, once: yes", "protocol: snp, commands: commreq-snp", "commands: commreq-ccm\n", "commreq-snp"),
        ("command: R1, once: yes", "protocol: snp", "commands: commreq-snp\n", "commreq-snp"),
        ("command: R1, once: yes", "protocol: modbus-rtu", "", "'modbus-rtu' names no application of commands"),
        ("command: R1, once: yes", "protocol: modbus-rtu, commands: commreq-ccm", "", "calls 'read_quick', which"),
        ("command: R1, once: yes", "protocol: snp, commands: nothing", "", "there is no definition 'nothing'"),
        ("command: R1, once: yes, count: 3", "protocol: snp", "", "'count' has no effect beside command:"),
        ("command: M1, once: yes", "protocol: snp", "", "commreq-snp"),
        ("command: M2, once: yes", "protocol: snp", "", "is not at the start of a word"),
        ("command: R1, once: yes, fault: M1025", "protocol: snp", "", "M1025 is not in area M"),
        ("read: '%R1', into: R1, once: yes, fault: M1", "protocol: snp", "", "fault"),
    ],
)
def test_where_the_application_is_named(tmp_path: Path, block: str, channel: str, more: str, found: str) -> None:
    assert any(found in told for told in run_with(tmp_path, block, channel, more))


def test_a_run_that_has_stopped_shows_no_fault_any_more(world: CommandWorld) -> None:
    world.fire([6101, 9, *READ[2:]], wait=1, longest=1)
    world.clock.run_for(1000)
    world.service.stop()
    world.put("M", 1, 0)
    world.clock.run_for(100 * SECOND)
    assert not world.fault
