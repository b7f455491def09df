"""The channel commands as words of memory: a ladder program writes them there and starts their execution."""

from __future__ import annotations

from pathlib import Path

from job_bench import Bench, write_device

from framekit.runfile.run_file import load_run

READ = [17, 0, 8, 9, 0, 0, 2003, 5, 10, 2, 1, 5, 8, 100, 8, 50, 4, 1, 4, 3, 0, 0, 2]
NAME = [0x4146, 0x0052] + [0] * 30
RUN = """
run: words
memory: ge-90-30
jobs: {{profile: ge-channels, status: I33, commands: ge-channels, hosts: {{FAR: 3.0.0.2}}}}
channels:
  1: {{port: "sim:far.device.yaml", protocol: srtp, host: 3.0.0.2, params: {{reply_timeout: 60 s, allow: writes}}}}
blocks:
{blocks}
set:
{words}
"""
FAR = 'device: far\nprotocol: srtp\nmemory: {set: {"%R50": [11, 12, 13, 14], "%I17": [1, 0, 1, 1, 0, 0, 0, 1]}}\n'


class Ladder(Bench):
    def register(self, number: int, count: int = 1) -> list[int]:
        return self.words("R", number - 1, count)


def ladder(folder: Path, *records: list[int], more: str = "") -> Ladder:
    """Write records to R301, R401 …, each with a block: the first starts at once, the others when M1, M2 … is set."""
    (folder / "far.device.yaml").write_text(FAR, encoding="utf-8")
    blocks, words = [], []
    for index, record in enumerate(records):
        when = "once: yes" if index == 0 else f"when: M{index}"
        blocks.append(f"  {index}: {{command: R{301 + 100 * index}, fault: T{index + 1}, {when}}}")
        words.append(f"  R{301 + 100 * index}: {[word & 0xFFFF for word in record]}")
    path = folder / "words.run.yaml"
    path.write_text(RUN.format(blocks="\n".join(blocks) + more, words="\n".join(words)), encoding="utf-8")
    return Ladder(path)


def test_a_read_and_its_details_and_its_abort(tmp_path: Path) -> None:
    at_work = ladder(tmp_path, READ, [4, 0, 8, 10, 0, 0, 2002, 5, 8, 110], [2, 0, 8, 11, 0, 0, 2001, 5])
    at_work.run(450)
    assert at_work.register(100, 4) == [11, 12, 13, 14] and at_work.register(10) == [1]
    slot = at_work.jobs.table.slots[5]
    assert slot.counters.good == 5 and slot.order is not None and (slot.order.period, slot.order.times) == (10**8, 10)
    at_work.memory.write("M", "bit", 0, [1])
    at_work.run(20)
    assert at_work.register(110, 2) == [1, 1] and at_work.register(11) == [1]
    at_work.memory.write("M", "bit", 1, [1])
    at_work.run(20)
    assert at_work.register(12) == [1] and slot.details == (0, 0)
    assert at_work.counts(0) == at_work.counts(1) == at_work.counts(2) == (1, 1, 0)


def test_by_name_and_bits_and_a_write(tmp_path: Path) -> None:
    by_name = [45, *READ[1:12], 70, 9, 70, 17, 8, 3, 32, *NAME]
    write = [17, 0, 8, 19, 0, 0, 2004, 6, 1, 2, 0, 0, 8, 200, 8, 60, 2, 1, 4, 3, 0, 0, 2]
    at_work = ladder(tmp_path, by_name, write)
    at_work.put("R", 199, 7, 8)
    at_work.memory.write("M", "bit", 0, [1])
    at_work.run(300)
    assert at_work.memory.read("I", "bit", 8, 8) == [1, 0, 1, 1, 0, 0, 0, 1] and at_work.register(10) == [1]
    (device,) = at_work.service.devices_on[1]
    assert device.memory.read("R", "word", 59, 2) == [7, 8] and at_work.register(20) == [1]


def test_the_words_are_copied(tmp_path: Path) -> None:
    at_work = ladder(tmp_path, READ)
    at_work.run(150)
    at_work.put("R", 300, *[0] * 23)
    at_work.run(2000)
    assert at_work.jobs.table.slots[5].counters.good == 10


def test_an_edit_leaves_them_alone(tmp_path: Path) -> None:
    at_work = ladder(tmp_path, READ)
    at_work.run(150)
    path = tmp_path / "words.run.yaml"
    path.write_text(
        path.read_text(encoding="utf-8").replace("set:", "  7: {abort: 5, when: M9}\nset:"), encoding="utf-8"
    )
    edits: list[object] = []
    at_work.service.edit(load_run(path), edits.append)
    at_work.run(100)
    assert [str(edit) for edit in edits] == ["block 7 new"] and at_work.counts(0) == (1, 1, 0)


def test_refusals_faults_and_reports(tmp_path: Path) -> None:
    report = [17, 0, 8, 12, 0, 0, 2010, 7, 10, 3, 7, 50, 8, 50, 8, 0, 0, 1, 4, 3, 0, 0, 1]
    wrong, fault = list(READ), list(READ)
    wrong[7], fault[0] = 17, 0
    at_work = ladder(tmp_path, wrong, fault, report)
    at_work.memory.write("M", "bit", 0, [1, 1])
    at_work.run(100)
    assert at_work.register(10) == [0x8890] and at_work.counts(0) == (1, 0, 1)
    assert at_work.memory.read("T", "bit", 0, 3) == [0, 1, 0], "FT"
    assert str(at_work.service.states[1].last_failure).startswith("cannot_send")
    assert at_work.register(13) == [0x008B]
    assert at_work.jobs.table.counters.refused == 2


def test_a_status_word_without_a_place_is_told_by_the_log_alone(tmp_path: Path) -> None:
    """A190H: the status word has no place to be written to, so only the log reports the fault."""
    system, beyond, wait = list(READ), list(READ), list(READ)
    system[2], beyond[3], wait[1] = 24, 0xFFFF, 1
    at_work = ladder(tmp_path, system, beyond, wait)
    at_work.memory.write("M", "bit", 0, [1, 1])
    at_work.run(100)
    assert at_work.memory.read("T", "bit", 0, 3) == [1, 1, 1], "FT"
    table = at_work.jobs.table
    assert [(event.name, event.word) for event in table.log] == [("fault", 0xA190), ("fault", 0xA190), ("fault", 0)]
    assert str(next(iter(table.log))).endswith("fault 0xA190 client: invalid memory type of the status word")
    assert (table.counters.faults, table.counters.taken) == (3, 0) and at_work.register(10) == [0]


def test_the_eighteenth_command_of_a_scan_is_lost(tmp_path: Path) -> None:
    more = "".join(f"\n  {n}: {{command: R401, when: M1}}" for n in range(2, 20))
    at_work = ladder(tmp_path, READ, [2, 0, 8, 11, 0, 0, 2001, 9], more=more)
    at_work.run(30)
    at_work.memory.write("M", "bit", 0, [1])
    at_work.run(5)
    counters = at_work.jobs.table.counters
    assert (counters.taken, counters.lost) == (18, 2)
    assert str(at_work.service.states[19].last_failure) == "queue_full: the command was not taken"


def test_another_protocol_on_the_channel(tmp_path: Path) -> None:
    """The commands name registers in the notation of the peer's protocol, which has no %R here."""
    write_device(tmp_path, "other")
    at_work = ladder(tmp_path, READ)
    text = (tmp_path / "words.run.yaml").read_text(encoding="utf-8")
    text = text.replace(
        'sim:far.device.yaml", protocol: srtp', 'sim:other.device.yaml", protocol: modbus-tcp, station: 1'
    )
    text = text.replace(", params: {reply_timeout: 60 s, allow: writes}", "")
    (tmp_path / "words.run.yaml").write_text(text, encoding="utf-8")
    at_work = Ladder(tmp_path / "words.run.yaml")
    at_work.run(100)
    assert at_work.register(10) == [0xF485]
