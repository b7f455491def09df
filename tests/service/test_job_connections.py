"""Channels that are opened on demand of a job, for hosts without a channel in the run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest
from job_bench import Bench, bench, write_device

from framekit.api.run import run_status
from framekit.definition.problems import DefinitionError
from framekit.extras.commreq.jobs import FIRST_OPENED
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock
from framekit.transport.port import Port

SECOND = 1_000_000_000

HEAD = """
run: opened
memory: masterlogic
dead: no
jobs:
  profile: ge-channels
  status: P0
  hosts: {{FAR: 3.0.0.2}}
  open: {{port: "sim:{{host}}.device.yaml", protocol: modbus-tcp, station: 1}}
  {more}
blocks:
"""


def run(folder: Path, blocks: str, more: str = "", **others: object) -> Bench:
    for last in (2, 3, 4):
        write_device(folder, f"3.0.0.{last}", f"{last}1, {last}2")
    return bench(folder, HEAD.format(more=more) + blocks, **others)


def job(number: int, host: str, **more: object) -> str:
    given = {"every": "100 ms", **more}
    keys = "".join(f", {name}: {value}" for name, value in given.items())
    return (
        f'  {number}: {{job: {number}, read: "40001", into: D{100 + number}, host: {host}, status: D{number}{keys}}}\n'
    )


def test_a_host_without_a_channel_gets_one(tmp_path: Path) -> None:
    at_work = run(tmp_path, job(1, "3.0.0.2", once="yes") + job(2, "FAR", once="yes") + job(3, "3.0.0.3", once="yes"))
    at_work.run(250)
    assert at_work.words("D", 1, 3) == [1, 1, 1] and at_work.words("D", 101, 3) == [21, 21, 31]
    assert list(at_work.service.channels) == [FIRST_OPENED, FIRST_OPENED + 1], "one connection a host"
    shown = run_status(at_work.service).channels
    assert [(connection.port, connection.state) for connection in shown] == [
        ("sim:3.0.0.2.device.yaml", "open"), ("sim:3.0.0.3.device.yaml", "open"),
    ]  # fmt: skip
    at_work.service.stop()
    assert not at_work.service.channels


def test_a_name_that_the_system_knows(tmp_path: Path) -> None:
    at_work = run(tmp_path, job(1, "plc.example", once="yes"), names={"plc.example": ["3.0.0.4", "3.0.0.2"]})
    at_work.run(50)
    assert at_work.word("D", 1) == 1 and at_work.word("D", 101) == 41


def test_a_host_that_is_nowhere(tmp_path: Path) -> None:
    at_work = run(tmp_path, job(1, "3.0.0.9", once="yes"))
    at_work.run(50)
    assert at_work.word("D", 1) == 0x9090 and not at_work.service.channels


def test_connections_are_kept_and_closed_when_another_host_needs_the_place(tmp_path: Path) -> None:
    blocks = job(1, "3.0.0.2", times=1, once="yes") + job(2, "3.0.0.3", after="100 ms") + job(3, "3.0.0.4", when="D900")
    at_work = run(tmp_path, blocks, "connections: 1")
    at_work.run(50)
    assert at_work.word("D", 1) == 1 and at_work.service.channels[FIRST_OPENED].channel.host == "3.0.0.2"
    at_work.run(100)
    assert at_work.word("D", 2) == 1 and at_work.service.channels[FIRST_OPENED].channel.host == "3.0.0.3"
    at_work.put("D", 900, 1)
    at_work.run(100)
    assert at_work.word("D", 3) == 0x9090, "the only connection is in use"
    assert at_work.jobs.table.slots[2].active


def test_a_retask_to_the_same_host_keeps_the_connection(tmp_path: Path) -> None:
    blocks = job(1, "3.0.0.2", once="yes") + job(1, "3.0.0.2", after="200 ms").replace("  1:", "  2:")
    at_work = run(tmp_path, blocks, "connections: 1")
    at_work.run(100)
    channel = at_work.service.channels[FIRST_OPENED]
    at_work.run(300)
    assert at_work.service.channels == {FIRST_OPENED: channel} and at_work.jobs.table.slots[1].counters.good == 5


def test_a_connection_that_is_lost_is_forgotten(tmp_path: Path) -> None:
    at_work = run(tmp_path, job(1, "3.0.0.2", once="yes") + job(1, "3.0.0.2", when="D900").replace("  1:", "  2:"))
    at_work.run(150)
    at_work.service.channels[FIRST_OPENED].driver.closed(at_work.clock.now(), "the cable is out")
    at_work.run(10)
    assert at_work.jobs.table.slots[1].details == (0x9690, 0) and not at_work.service.channels
    at_work.put("D", 900, 1)
    at_work.run(150)
    assert at_work.jobs.table.slots[1].details == (1, 1) and list(at_work.service.channels) == [FIRST_OPENED]


def test_an_edit_leaves_them_alone(tmp_path: Path) -> None:
    blocks = job(1, "3.0.0.2", once="yes")
    at_work = run(tmp_path, blocks)
    at_work.run(150)
    path = tmp_path / "edited.run.yaml"
    path.write_text(HEAD.format(more="") + blocks + job(2, "3.0.0.2", once="yes"), encoding="utf-8")
    done: list[object] = []
    at_work.service.edit(load_run(path), done.append)
    at_work.run(150)
    assert [str(edit) for edit in done] == ["block 2 new"] and list(at_work.service.channels) == [FIRST_OPENED]
    assert at_work.jobs.table.slots[1].counters.good == 4 and at_work.word("D", 2) == 1


@pytest.mark.parametrize(
    ("more", "blocks", "why"),
    [
        ("connections: 0", "", "0 connections are none"),
        ("", job(1, "3.0.0.2").replace('"40001"', '"X1"'), "X1"),
        ("", job(1, "3.0.0.2").replace("host: 3.0.0.2, ", ""), "does not say which host"),
    ],
)
def test_what_is_wrong_is_told(tmp_path: Path, more: str, blocks: str, why: str) -> None:
    with pytest.raises(DefinitionError, match=why):
        run(tmp_path, blocks or job(1, "3.0.0.2"), more)


def test_connections_without_open(tmp_path: Path) -> None:
    path = tmp_path / "wrong.run.yaml"
    text = "run: wrong\nmemory: masterlogic\njobs: {profile: ge-channels, connections: 3}\n"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DefinitionError) as problems:
        load_run(path)
    assert [problem.what for problem in problems.value.problems] == [
        "missing key 'channels' in a run file", "connections: counts channels that are opened when wanted",
    ]  # fmt: skip


def test_a_host_of_the_opened_channel_is_the_jobs(tmp_path: Path) -> None:
    text = HEAD.format(more="").replace("station: 1}", "station: 1, host: 3.0.0.2}")
    with pytest.raises(DefinitionError, match="the host is the one that a job names"):
        bench(tmp_path, text + job(1, "3.0.0.2"))


class ClosingPort:
    """A port of another channel on the line whose modem is hanging up."""

    name = "closing"

    def when_closed(self, done: Callable[[], None]) -> None:
        self.done = done


@pytest.mark.parametrize("is_freed", [True, False])
def test_a_job_waits_for_its_line_up_to_its_time_limit(is_freed: bool, tmp_path: Path) -> None:
    """A modem is hanging up on the channel's line; without waiting, the job would be refused as not connected."""
    write_device(tmp_path, "far", "21, 22")
    channel = 'channels: {1: {port: "sim:far.device.yaml", protocol: modbus-tcp, station: 1, host: 3.0.0.2}}'
    text = HEAD.format(more="").replace("jobs:", f"{channel}\njobs:") + job(1, "3.0.0.2", once="yes", every="10 s")
    path = tmp_path / "r.run.yaml"
    path.write_text(text, encoding="utf-8")
    clock = VirtualClock()
    service = RunService(load_run(path), clock)
    port = ClosingPort()
    service.lines.closing.add(service.channels[1].line, cast(Port, port))
    service.start()
    clock.run_for(2 * SECOND)
    assert service.jobs is not None
    slot = service.jobs.table.slots[1]

    def words(first: int) -> list[int]:
        return list(service.memory.read("D", "word", first, 1))

    assert slot.active and words(1) == [0], "no answer yet"
    if is_freed:
        port.done()
        clock.run_for(SECOND)
        assert words(1) == [1] and words(101) == [21]
    else:
        clock.run_for(120 * SECOND)
        assert slot.counters.good == 0 and words(1) != [0], "its time limit"
