"""Jobs in run files: blocks establish, abort and inspect them; hosts are resolved by address and by name."""

from __future__ import annotations

from pathlib import Path

import pytest
from job_bench import MS, SECOND, Bench, bench, write_device

from framekit.api.run import run_status
from framekit.definition.problems import DefinitionError
from framekit.runfile.run_file import load_run

HEAD = """
run: jobs
memory: masterlogic
dead: no
jobs: {profile: ge-channels, status: P0, hosts: {FAR: 3.0.0.2, NOWHERE: 3.0.0.8}}
channels:
  1: {port: "sim:far.device.yaml", protocol: modbus-tcp, station: 1, host: 3.0.0.2}
  2: {port: "sim:near.device.yaml", protocol: modbus-tcp, station: 1, host: near, enabled: no}
blocks:
"""


def run(folder: Path, blocks: str, head: str = HEAD, **more: object) -> Bench:
    write_device(folder, "far")
    write_device(folder, "near", "21, 22")
    return bench(folder, head + blocks, **more)


def test_a_read_job_repeats_by_itself(tmp_path: Path) -> None:
    block = '  0: {job: 5, read: "40001", count: 4, into: D100, host: 3.0.0.2, every: 100 ms, times: 10, status: D10}'
    at_work = run(tmp_path, block)
    at_work.service.fire(0)
    at_work.run(950)
    assert at_work.words("D", 100, 4) == [11, 12, 13, 14] and at_work.word("D", 10) == 1
    assert at_work.counts(0) == (1, 1, 0), "the block ends with its answer"
    status = at_work.jobs.table.status()[4]
    assert (status.counters.good, status.state, status.kind, status.host) == (10, "idle", "read", "3.0.0.2")
    at_work.run(2000)
    assert at_work.jobs.table.slots[5].counters.good == 10 and at_work.bits() == (13, 16)


def test_a_channel_counts_the_transfers_of_its_jobs(tmp_path: Path) -> None:
    block = """  0: {job: 5, read: "40001", count: 4, into: D100, channel: 1, every: 100 ms, status: D10, once: yes}
  1: {job: 6, read: "41001", into: D200, channel: 1, every: 200 ms, status: D11, once: yes}
  2: {read: "40001", into: D300, channel: 1, every: 500 ms}
"""
    at_work = run(tmp_path, block)
    at_work.run(2050)
    [first, second] = run_status(at_work.service).channels
    counters = {slot: at_work.jobs.table.slots[slot].counters for slot in (5, 6)}
    assert counters[5].good == 21 and first.errors == counters[6].refused > 0
    assert first.services == counters[5].good + at_work.service.states[2].done
    assert first.reasons == {"refused": first.errors}
    assert (second.services, second.errors) == (0, 0)


def test_a_write_job_writes_what_stands_there_then(tmp_path: Path) -> None:
    at_work = run(
        tmp_path, '  0: {job: 6, write: "40101", count: 2, from: D50, host: FAR, every: 1 s, status: D10, once: yes}'
    )
    (device,) = at_work.service.devices_on[1]
    at_work.run(500)
    at_work.put("D", 50, 7, 8)
    assert device.memory.read("holding", "word", 100, 2) == [0, 0]
    at_work.run(1000)
    assert device.memory.read("holding", "word", 100, 2) == [7, 8]


def test_commands_are_carried_out_side_by_side(tmp_path: Path) -> None:
    blocks = "\n".join(
        f'  {n}: {{job: {n}, read: "40001", into: D{100 + n}, channel: 1, every: 100 ms, status: D{n}, once: yes}}'
        for n in range(1, 17)
    )
    at_work = run(tmp_path, blocks)
    at_work.run(50)
    assert at_work.words("D", 1, 16) == [1] * 16 and at_work.words("D", 101, 16) == [11] * 16
    at_work.run(1000)
    assert all(slot.counters.good == 11 for slot in at_work.jobs.table.slots.values())


def test_a_trigger_during_a_pending_command_is_an_overrun(tmp_path: Path) -> None:
    head = HEAD.replace("station: 1, host: 3.0.0.2", "station: 9, host: 3.0.0.2, params: {reply_timeout: 60 s}")
    at_work = run(
        tmp_path, '  0: {job: 5, read: "40001", into: D1, host: FAR, late: 5 s, status: D10, when: D900}', head
    )
    for value in (1, 0, 1, 0, 1):
        at_work.put("D", 900, value)
        at_work.run(900)
    assert at_work.counts(0) == (1, 0, 0) and at_work.word("D", 10) == 0, "nobody answers, and nothing is told yet"
    assert at_work.service.states[0].overruns == 2
    at_work.run(1000)
    assert at_work.word("D", 10) == 0x0190
    assert str(at_work.service.states[0].last_failure) == "refused 0x0190: client: time-out is over, still waiting"


@pytest.mark.parametrize(("station", "word"), [(9, 0x9790), (8, 0)])
def test_parameters_of_a_station_are_those_of_its_jobs(tmp_path: Path, station: int, word: int) -> None:
    more = "params: {reply_timeout: 60 s}, stations: {9: {timeout: 200 ms}}"
    head = HEAD.replace("station: 1, host: 3.0.0.2", f"station: 1, host: 3.0.0.2, {more}")
    block = f'  0: {{job: 1, read: "40001", into: D1, station: {station}, host: FAR, status: D9, once: yes}}'
    at_work = run(tmp_path, block, head)
    at_work.run(1000)
    assert at_work.word("D", 9) == word, "station 8 has the channel's own time"


def test_abort_and_inspect_blocks(tmp_path: Path) -> None:
    blocks = """
  0: {job: 5, read: "40001", into: D1, host: FAR, every: 100 ms, once: yes}
  1: {inspect: 5, into: D20, status: D22, after: 250 ms}
  2: {abort: 5, status: D23, after: 500 ms}
  3: {inspect: 5, into: D30, status: D32, after: 600 ms}
  4: {abort: all, status: D33, after: 700 ms}
"""
    at_work = run(tmp_path, blocks)
    at_work.run(1000)
    assert at_work.words("D", 20, 4) == [1, 1, 1, 1] and at_work.words("D", 30, 4) == [0, 0, 1, 1]
    assert at_work.jobs.table.slots[5].counters.good == 5


def test_a_block_that_inspects_has_a_cycle_of_its_own(tmp_path: Path) -> None:
    at_work = run(tmp_path, "  0: {inspect: 5, into: D20, status: D22, every: 1 s}")
    at_work.run(3500)
    assert at_work.counts(0) == (3, 3, 0) and not at_work.service.run.warnings


def test_blocks_start_each_other_by_jobs_ends(tmp_path: Path) -> None:
    blocks = """
  0: {job: 1, read: "40001", into: D1, host: FAR, times: 1, once: yes}
  1: {job: 1, write: "40101", from: D1, host: FAR, times: 1, when: block 0 done}
  2: {job: 1, read: "49999", into: D2, host: FAR, times: 1, when: block 1 done}
  3: {abort: 1, when: block 2 failed}
"""
    at_work = run(tmp_path, blocks)
    at_work.run(100)
    assert [at_work.counts(number) for number in range(4)] == [(1, 1, 0), (1, 1, 0), (1, 0, 1), (1, 1, 0)]


def test_reports_are_refused(tmp_path: Path) -> None:
    at_work = run(
        tmp_path,
        "  0: {job: 7, report: D50, count: 8, host: FAR, every: 7 s, times: 10, late: 500 ms, status: D10, once: yes}",
    )
    at_work.run(100)
    assert at_work.word("D", 10) == 0x008B and at_work.counts(0) == (1, 0, 1)
    assert str(at_work.service.states[0].last_failure) == "refused 0x008B: client: illegal service request"


@pytest.mark.parametrize(
    ("host", "names", "word"),
    [
        ("FAR", {}, 1),
        ("3.0.0.2", {}, 1),
        ("plc.example", {"plc.example": ["3.0.0.7", "3.0.0.2"]}, 1),
        ("plc.example", {"plc.example": ["3.0.0.7"]}, 0x9090),
        ("plc.example", {}, 0xB190),
        ("plc.example", {"plc.example": None}, 0xB390),
        ("NOWHERE", {}, 0x9090),
        ("3.0.0.9", {}, 0x9090),
        ("near", {}, 0x9690),
    ],
)
def test_hosts(tmp_path: Path, host: str, names: dict[str, list[str] | None], word: int) -> None:
    block = f'  0: {{job: 1, read: "40001", into: D1, host: {host}, every: 100 ms, status: D10, once: yes}}'
    at_work = run(tmp_path, block, names=names)
    at_work.run(300)
    assert at_work.word("D", 10) == word
    assert at_work.asked == ([host] if host == "plc.example" else []), "own names first"
    assert at_work.bits()[-1] in (16, 17), "no error bit: nothing had begun"


def test_a_job_that_is_aborted_while_its_host_is_looked_up(tmp_path: Path) -> None:
    blocks = """
  0: {job: 1, read: "40001", into: D1, host: slow.example, status: D10, once: yes}
  1: {abort: 1, status: D11, after: 2 ms}
"""
    at_work = run(tmp_path, blocks, names={"slow.example": ["3.0.0.2"]})
    at_work.run(100)
    assert (at_work.word("D", 10), at_work.word("D", 11), at_work.word("D", 1)) == (0x9790, 1, 0)


def test_an_answer_for_a_job_that_is_no_more_leads_the_next_one_nowhere(tmp_path: Path) -> None:
    head = HEAD.replace("host: near, enabled: no", "host: near")
    blocks = """
  0: {job: 1, read: "40001", into: D1, host: slow.example, status: D10, once: yes}
  1: {job: 1, read: "40001", into: D1, channel: 2, every: 100 ms, status: D11, after: 2 ms}
"""
    at_work = run(tmp_path, blocks, head, names={"slow.example": ["3.0.0.2"]})
    at_work.run(1000)
    assert (at_work.word("D", 10), at_work.word("D", 11)) == (0x9790, 1)
    assert at_work.word("D", 1) == 21, "what the second job reads on its own channel"


def test_an_error_of_the_device_goes_on_and_comes_back(tmp_path: Path) -> None:
    at_work = run(tmp_path, '  0: {job: 3, read: "49999", into: D1, host: FAR, every: 100 ms, status: D10, once: yes}')
    at_work.run(550)
    assert at_work.word("D", 10) == 0x0205 and {9, 22} <= set(at_work.bits())
    assert at_work.jobs.table.slots[3].counters.refused == 6


def test_a_place_that_cannot_be_written_goes_on(tmp_path: Path) -> None:
    at_work = run(tmp_path, '  0: {job: 3, read: "40001", into: K50, host: FAR, every: 100 ms, status: D10, once: yes}')
    at_work.service.memory.area("K").access = "read"
    at_work.run(250)
    assert at_work.word("D", 10) == 0xF485 and at_work.jobs.table.slots[3].counters.refused == 3


def test_a_status_word_that_cannot_be_written_ends_the_job(tmp_path: Path) -> None:
    at_work = run(tmp_path, '  0: {job: 3, read: "40001", into: D1, host: FAR, every: 100 ms, status: K50, once: yes}')
    at_work.service.memory.area("K").access = "read"
    at_work.run(250)
    assert at_work.jobs.table.slots[3].details == (0xA290, 0) and {9, 22} <= set(at_work.bits())


def test_a_connection_that_is_lost_ends_its_jobs_and_another_channel_stays(tmp_path: Path) -> None:
    head = HEAD.replace("enabled: no", "enabled: yes")
    blocks = """
  0: {job: 1, read: "40001", into: D1, host: FAR, every: 100 ms, status: D10, once: yes}
  1: {job: 2, read: "40001", into: D2, host: near, every: 100 ms, status: D11, once: yes}
"""
    at_work = run(tmp_path, blocks, head)
    at_work.run(350)
    at_work.service.enable_channel(1, False)
    at_work.run(500)
    assert at_work.jobs.table.slots[1].details == (0x9690, 0) and {9, 18} <= set(at_work.bits())
    assert at_work.jobs.table.slots[2].details == (1, 1) and at_work.word("D", 10) == 1
    at_work.service.enable_channel(1, True)
    at_work.run(500)
    assert at_work.jobs.table.slots[1].counters.good == 4, "it does not begin again by itself"
    at_work.service.fire(0)
    at_work.run(500)
    assert at_work.jobs.table.slots[1].details == (1, 1) and not {9, 18} & set(at_work.bits())


def test_stop_and_reset(tmp_path: Path) -> None:
    at_work = run(tmp_path, '  0: {job: 1, read: "40001", into: D1, host: FAR, every: 100 ms, status: D10, once: yes}')
    at_work.run(150)
    at_work.service.reset()
    assert at_work.bits() == ()
    at_work.run(150)
    assert 16 in at_work.bits() and at_work.jobs.table.slots[1].counters.good == 2, "once: again after a reset"
    at_work.service.stop()
    assert at_work.bits() == () and not at_work.jobs.table.running


def test_an_edit_keeps_jobs_and_their_section(tmp_path: Path) -> None:
    text = HEAD + '  0: {job: 1, read: "40001", into: D1, host: FAR, every: 100 ms, status: D10, once: yes}\n'
    at_work = run(tmp_path, text[len(HEAD) :])
    at_work.run(150)
    (tmp_path / "e.run.yaml").write_text(text + "  1: {abort: 1, status: D11, when: D900}\n", encoding="utf-8")
    done: list[object] = []
    at_work.service.edit(load_run(tmp_path / "e.run.yaml"), done.append)
    at_work.run(100)
    assert str(done[0]) == "block 1 new" and at_work.jobs.table.slots[1].active
    at_work.put("D", 900, 1)
    at_work.run(100)
    assert at_work.word("D", 11) == 1 and not at_work.jobs.table.slots[1].active
    (tmp_path / "e.run.yaml").write_text(text.replace("status: P0", "status: P8"), encoding="utf-8")
    with pytest.raises(DefinitionError, match="what the run says of its jobs cannot change"):
        at_work.service.edit(load_run(tmp_path / "e.run.yaml"))


def test_an_edit_without_a_job_block_ends_its_job(tmp_path: Path) -> None:
    one = '  0: {job: 1, read: "40001", into: D1, host: FAR, every: 100 ms, status: D10, when: D900}\n'
    two = '  1: {job: 2, read: "40001", into: D2, host: FAR, every: 100 ms, status: D11, when: D901}\n'
    at_work = run(tmp_path, one + two)
    at_work.put("D", 900, 1, 1)
    at_work.run(150)
    first, second = at_work.jobs.table.slots[1], at_work.jobs.table.slots[2]
    assert first.active and second.active
    path = tmp_path / "e.run.yaml"
    path.write_text(HEAD + one, encoding="utf-8")
    at_work.service.edit(load_run(path))
    at_work.run(100)
    assert first.details == (1, 1) and second.details == (0, 0), "as an abort leaves it"
    path.write_text(HEAD + one.replace("100 ms", "50 ms"), encoding="utf-8")
    at_work.service.edit(load_run(path))
    at_work.run(100)
    assert first.details == (1, 1) and first.counters.established == 2 and first.period == 50 * MS, "begun anew"


def test_words_of_blocks_show_commands(tmp_path: Path) -> None:
    at_work = run(tmp_path, '  2: {job: 1, read: "49999", into: D1, host: FAR, every: 100 ms, once: yes}')
    at_work.run(50)
    assert at_work.words("L", 625 + 12, 6) == [0, 0x0205, 0, 0, 1, 0]
    (status,) = at_work.service.status()
    assert (status.instruction, status.channel, status.device_code) == ("job", 0, 0x0205)


def test_times_of_the_section(tmp_path: Path) -> None:
    head = HEAD.replace("status: P0,", "status: P0, scan: 50 ms, next: at_once, connect: 1 s,")
    at_work = run(tmp_path, '  0: {job: 1, read: "40001", into: D1, host: FAR, every: 100 ms, once: yes}', head)
    seen: list[int] = []
    at_work.memory.watch("P", 1, 1, lambda *_: seen.append(at_work.clock.now() // MS))
    at_work.run(400)
    assert seen == [50, 100, 150, 200, 250, 300, 350, 400]
    assert at_work.jobs.table.profile.connect == SECOND


MANY = "\n".join(f"  {n}: {{inspect: {1 + n % 16}, into: D{100 + 2 * n}, status: D{n}, once: yes}}" for n in range(40))


def test_commands_that_are_too_many_for_a_scan_wait_for_the_next_one(tmp_path: Path) -> None:
    at_work = run(tmp_path, MANY)
    seen: list[tuple[int, int]] = []
    for number in range(40):
        at_work.memory.watch("D", number, 1, lambda *_, n=number: seen.append((at_work.clock.now() // MS, n)))
    at_work.run(5)
    assert sum(at_work.words("D", 0, 40)) == 17
    at_work.run(15)
    assert sum(at_work.words("D", 0, 40)) == 40, "all within three scans"
    assert at_work.jobs.table.counters.lost == 0


def test_commands_that_are_too_many_for_a_scan_may_be_lost(tmp_path: Path) -> None:
    at_work = run(tmp_path, MANY, HEAD.replace("status: P0,", "status: P0, surplus: lost,"))
    at_work.run(10)
    assert sum(at_work.words("D", 0, 40)) == 17 and at_work.jobs.table.counters.lost == 23
    assert {event.code.number for event in at_work.jobs.table.log if event.code} == {8}
    assert str(at_work.service.states[39].last_failure) == "queue_full: the command was not taken"
    assert at_work.bits() == (13, 14, 16)
    at_work.run(10)
    assert at_work.bits() == (13, 16)


def test_stop_ends_commands_that_wait(tmp_path: Path) -> None:
    at_work = run(tmp_path, MANY)
    at_work.service.stop()
    assert str(at_work.service.states[39].last_failure) == "cancelled: the command was not taken"
