"""The manual's ladder programs as runs, and the fifteen lessons that the specification draws from them (4.5)."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from types import CodeType

import pytest
from job_bench import MS, SECOND, Bench

from framekit.api.check import check_file
from framekit.codec import codec
from framekit.definition.model.protocol import Protocol
from framekit.definition.sources import cached_by
from framekit.runfile.run_file import load_run

SAMPLES = Path(__file__).parents[2] / "examples" / "ge-channels"
DELAY = "faults: {{rules: [{{fault: delay, time: {time}, frame: reply_pdu{more}}}]}}\n"


_codes: dict[frozenset[str], CodeType] = {}


@pytest.fixture(autouse=True)
def compiled_once(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Compile the frames of all PLCs once, since they are equal, instead of once per device and test; use no cache."""
    compiled = codec.code_of

    def code_of(protocol: Protocol) -> CodeType:
        key = frozenset(protocol.frames)
        if key not in _codes:
            _codes[key] = compiled(protocol)
        return _codes[key]

    monkeypatch.setattr(codec, "code_of", code_of)
    with cached_by(None):
        yield


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copytree(SAMPLES, tmp_path / "samples")
    return tmp_path / "samples"


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


@pytest.fixture
def with_one_channel(folder: Path) -> Path:
    """Reduce CHAN4 in the folder to its first channel, which is faster."""
    path = folder / "chan4.run.yaml"
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not line.startswith(("  2:", "  3:", "  4:"))), encoding="utf-8")
    return folder


def slow(folder: Path, number: int, time: str, more: str = "") -> None:
    """Make the PLC of this number answer late."""
    with (folder / f"plc-{number}.device.yaml").open("a", encoding="utf-8") as file:
        file.write(DELAY.format(time=time, more=more))


class Sample(Bench):
    """A bench with the bit names of the ladder program: I33 to I112 are status bits 1 to 80."""

    def bit(self, name: str) -> int:
        return self.memory.read(name[0], "bit", int(name[1:]) - 1, 1)[0]

    def bits(self, area: str = "I", first: int = 32) -> tuple[int, ...]:
        found = self.memory.read(area, "bit", first, 80)
        return tuple(number for number, bit in enumerate(found, 1) if bit)

    def register(self, number: int, count: int = 1) -> list[int]:
        return self.words("R", number - 1, count)

    def edges(self, name: str) -> list[tuple[int, int]]:
        """Return a list that collects (ms, value) of every future change of a bit."""
        seen: list[tuple[int, int]] = []
        place = int(name[1:]) - 1

        def look(*_: object) -> None:
            value = self.bit(name)
            if value != (seen[-1][1] if seen else 0):
                seen.append((self.clock.now() // MS, value))

        self.memory.watch(name[0], place // 16, 1, look)
        return seen


# ---- LANRDWT ----------------------------------------------------------------------------------------------


def test_a_read_and_a_write_take_turns(folder: Path) -> None:
    slow(folder, 2, "50 ms")
    at_work = Sample(folder / "lanrdwt.run.yaml")
    (device,) = at_work.service.devices_on[1]
    at_work.run(1900)
    assert at_work.counts(1) == (0, 0, 0), "nothing in the first two seconds (lesson 6)"
    at_work.run(1100)
    reads, writes = at_work.counts(1), at_work.counts(2)
    assert reads[1] == reads[0] - 1 + (reads[0] == reads[1]) and reads[1] - writes[1] in (0, 1)
    assert reads[1] >= 9 and reads[2] == writes[2] == 0
    assert at_work.register(201, 10) == [4711, *range(231, 240)], "ten registers; the first is what was written"
    assert device.memory.read("R", "word", 299, 1) == [4711]


def test_the_connection_is_made_once(folder: Path) -> None:
    """Lesson 13: consecutive single transfers share a connection (spec 3.2)."""
    connects: list[object] = []
    at_work = Sample(folder / "lanrdwt.run.yaml")
    engine = at_work.service.channels[1].engine
    engine.machine.monitor = lambda seen: connects.append(seen) if seen.raw == bytes(56) else None
    at_work.run(3000)
    assert at_work.counts(1)[1] > 100 and len(connects) == 1


def test_an_error_repeats_its_own_step(folder: Path) -> None:
    """Lesson 7: after a success comes the next step, after an error the same step again."""
    fault = "faults: {rules: [{fault: error_reply, code: 0x05F9, from: 2500 ms, times: 3}]}\n"
    with (folder / "plc-2.device.yaml").open("a", encoding="utf-8") as file:
        file.write(fault)
    at_work = Sample(folder / "lanrdwt.run.yaml")
    at_work.run(3000)
    reads, writes = at_work.counts(1), at_work.counts(2)
    assert reads[2] + writes[2] == 3 and 0 <= reads[1] - writes[1] <= 1, "no step is left out, none is done twice"
    assert {event.word for event in at_work.jobs.table.log} == {0xF905}


QUEUE_FULL = "faults: {rules: [{fault: error_reply, code: 0x0700, from: 2500 ms, times: 2}]}\n"


def test_a_full_queue_is_asked_again_after_a_pause(folder: Path) -> None:
    """The connection repeats the request after 10 ms or later; the job does not notice (spec 1.8.1)."""
    with (folder / "plc-2.device.yaml").open("a", encoding="utf-8") as file:
        file.write(QUEUE_FULL)
    at_work = Sample(folder / "lanrdwt.run.yaml")
    sent: list[int] = []
    engine = at_work.service.channels[1].engine
    engine.machine.monitor = lambda seen: sent.append(seen.at // MS) if seen.direction == "out" else None
    at_work.run(3000)
    assert engine.status()["repeated"] == 2 and not at_work.jobs.table.log.total
    refused = [at for at in sent if at >= 2500][:3]
    assert refused[1] - refused[0] >= 10 and refused[2] - refused[1] >= 10


def test_a_full_queue_that_the_connection_does_not_repeat_is_retried_by_the_program(folder: Path) -> None:
    """As 0007H: the program repeats the same command at its next scan 10 ms later (lesson 7)."""
    with (folder / "plc-2.device.yaml").open("a", encoding="utf-8") as file:
        file.write(QUEUE_FULL)
    change(folder / "lanrdwt.run.yaml", "reply_timeout:", "busy_retries: 0, reply_timeout:")
    at_work = Sample(folder / "lanrdwt.run.yaml")
    at_work.run(3000)
    reads, writes = at_work.counts(1), at_work.counts(2)
    assert reads[2] + writes[2] == 2 and 0 <= reads[1] - writes[1] <= 1
    assert {event.word for event in at_work.jobs.table.log} == {0x0007}


# ---- CHAN4 ------------------------------------------------------------------------------------------------


def test_four_reads_every_second(folder: Path) -> None:
    at_work = Sample(folder / "chan4.run.yaml")
    at_work.run(1990)
    assert not any(slot.active for slot in at_work.jobs.table.slots.values())
    at_work.run(4000)
    assert at_work.register(1, 4) == [1, 1, 1, 1]
    assert [at_work.register(301 + 10 * n, 2) for n in range(4)] == [[200, 201], [300, 301], [400, 401], [500, 501]]
    assert [slot.counters.good for slot in list(at_work.jobs.table.slots.values())[:5]] == [4, 4, 4, 4, 0]
    assert (at_work.bit("I45"), at_work.bit("I48"), at_work.bit("I50")) == (1, 1, 0)


def test_an_error_after_the_first_transfer_begins_the_job_again(folder: Path) -> None:
    slow(folder, 2, "1300 ms", ", from: 5 s, until: 6 s")
    at_work = Sample(folder / "chan4.run.yaml")
    errors = at_work.edges("I50")
    at_work.run(9500)
    assert [value for _, value in errors[:2]] == [1, 0] and at_work.counts(1) == (2, 2, 0)
    assert [at_work.counts(number) for number in (2, 3, 4)] == [(1, 1, 0)] * 3, "the others go on undisturbed"
    assert at_work.jobs.table.slots[1].counters.over_period == 1 and not at_work.bit("I50")


def test_a_job_that_cannot_begin_stays_as_it_is(folder: Path) -> None:
    """Lesson 8: wrong addresses and missing nodes need the attention of a person."""
    change(folder / "chan4.run.yaml", "host: 3.0.0.5, params", "host: 3.0.0.5, enabled: no, params")
    at_work = Sample(folder / "chan4.run.yaml")
    at_work.run(20_000)
    assert at_work.register(1, 4) == [1, 1, 1, 0x9690] and at_work.counts(4) == (1, 0, 1)
    assert not at_work.bit("I56") and at_work.jobs.table.slots[4].details == (0x9690, 0)


def test_a_lost_connection_and_a_restart_by_hand(folder: Path) -> None:
    at_work = Sample(folder / "chan4.run.yaml")
    at_work.run(4500)
    at_work.service.enable_channel(2, False)
    at_work.run(1000)
    assert at_work.register(2) == [0x9690] and at_work.counts(2) == (2, 1, 1), "one restart, in vain; then it rests"
    at_work.service.enable_channel(2, True)
    at_work.run(5000)
    assert not at_work.jobs.table.slots[2].active
    at_work.service.fire(2)
    at_work.run(2500)
    assert at_work.register(2) == [1] and at_work.jobs.table.slots[2].counters.good == 6


# ---- lessons ----------------------------------------------------------------------------------------------


def test_lesson_1_trigger_guard_payload_destination_and_status_are_separate(with_one_channel: Path) -> None:
    block = load_run(with_one_channel / "chan4.run.yaml").blocks[1]
    assert block.job is not None and block.job.order is not None and block.job.status is not None
    order = block.job.order
    assert block.triggers and block.unless is not None
    assert (order.remote, order.count, order.place.text, order.host) == ("%R200", 10, "R301", "3.0.0.2")
    assert block.job.status.text == "R1"


def test_lesson_2_any_trigger_and_a_guard(with_one_channel: Path) -> None:
    change(with_one_channel / "chan4.run.yaml", "unless: not I48}", "unless: M1}")
    at_work = Sample(with_one_channel / "chan4.run.yaml")
    at_work.memory.write("M", "bit", 0, [1])
    at_work.run(5000)
    assert at_work.counts(1) == (0, 0, 0), "the guard holds it back"
    at_work.memory.write("M", "bit", 0, [0])
    at_work.memory.write("I", "bit", 49, [1])
    at_work.run(500)
    assert at_work.counts(1) == (1, 1, 0), "the error bit is another trigger"


def test_lesson_3_the_status_word_is_0_until_there_is_an_answer(with_one_channel: Path) -> None:
    slow(with_one_channel, 2, "300 ms")
    at_work = Sample(with_one_channel / "chan4.run.yaml")
    at_work.put("R", 0, 0x9690)
    at_work.run(2100)
    assert at_work.counts(1) == (1, 0, 0) and at_work.register(1) == [0]
    at_work.run(300)
    assert at_work.register(1) == [1]


def test_lesson_4_edges_start_commands_and_pending_ones_are_not_started_again(with_one_channel: Path) -> None:
    slow(with_one_channel, 2, "900 ms")
    at_work = Sample(with_one_channel / "chan4.run.yaml")
    at_work.run(2100)
    for value in (1, 0, 1, 1):
        at_work.memory.write("I", "bit", 49, [value])
    at_work.run(100)
    assert at_work.counts(1) == (1, 0, 0) and at_work.service.states[1].overruns == 2
    at_work.run(10_000)
    assert at_work.counts(1) == (1, 1, 0), "a level starts nothing again"


def test_lesson_5_jobs_are_established_again_when_the_interface_is_back(folder: Path) -> None:
    at_work = Sample(folder / "chan4.run.yaml")
    at_work.run(3500)
    at_work.memory.write("I", "bit", 47, [0])
    at_work.service.fire(1)
    at_work.run(100)
    assert at_work.counts(1) == (1, 1, 0), "nothing while it is not healthy"
    at_work.memory.write("I", "bit", 47, [1])
    at_work.run(100)
    assert [at_work.counts(number) for number in range(1, 5)] == [(2, 2, 0)] * 4


def test_lesson_6_the_first_command_comes_two_seconds_after_the_start(with_one_channel: Path) -> None:
    at_work = Sample(with_one_channel / "chan4.run.yaml")
    pulses = at_work.edges("I49")
    at_work.run(2500)
    assert pulses[0][0] == 2010 and at_work.jobs.table.counters.taken == 2


def test_lesson_7_a_retry_with_a_pause_and_a_limit(folder: Path) -> None:
    """A clock bit of the memory gives the pause, `repeat` the limit; the sample program has neither."""
    path = folder / "chan4.run.yaml"
    change(path, "host: 3.0.0.5, params", "host: 3.0.0.5, enabled: no, params")
    again = """  14: {job: 4, read: "%R200", count: 10, into: R331, host: 3.0.0.5, every: 1 s, status: R4, when: S5,
    unless: not I48 or R4 == 0 or R4 == 1, repeat: 5}
"""
    path.write_text(path.read_text(encoding="utf-8") + again, encoding="utf-8")
    at_work = Sample(path)
    at_work.run(4600)
    assert at_work.counts(4) == (1, 0, 1) and at_work.counts(14) == (2, 0, 2), "with each full second"
    at_work.run(60_000)
    assert at_work.counts(4) == (1, 0, 1) and at_work.counts(14) == (5, 0, 5)


def test_lesson_8_the_first_failure_and_a_later_one_can_be_told_apart(folder: Path) -> None:
    change(folder / "chan4.run.yaml", "host: 3.0.0.5, params", "host: 3.0.0.5, enabled: no, params")
    at_work = Sample(folder / "chan4.run.yaml")
    at_work.run(4500)
    at_work.service.enable_channel(1, False)
    at_work.run(5)
    first, later = at_work.jobs.table.status()[3], at_work.jobs.table.status()[0]
    assert first.counters.good == 0 and first.word == 0x9690 and not first.error
    assert later.counters.good == 3 and later.error


def test_lesson_9_a_command_that_is_not_taken_has_an_outcome_of_its_own(with_one_channel: Path) -> None:
    path = with_one_channel / "chan4.run.yaml"
    change(path, "status: I33}", "status: I33, surplus: lost}")
    lines = "".join(f"  {n}: {{inspect: 1, into: R{500 + 2 * n}, when: R20 == 1}}\n" for n in range(5, 30))
    path.write_text(
        path.read_text(encoding="utf-8") + lines + "  40: {abort: 1, when: block 29 failed}\n", encoding="utf-8"
    )
    at_work = Sample(path)
    at_work.run(2005)
    assert str(at_work.service.states[29].last_failure) == "queue_full: the command was not taken"
    at_work.run(100)
    assert str(at_work.service.states[40].last_failure) == "queue_full: the command was not taken", (
        "in the same scan: lost, too"
    )


def test_lesson_10_commands_that_are_too_many_for_a_scan_come_with_the_next_one(with_one_channel: Path) -> None:
    path = with_one_channel / "chan4.run.yaml"
    lines = "".join(f"  {n}: {{inspect: 1, into: R{500 + 2 * n}, when: R20 == 1}}\n" for n in range(5, 30))
    path.write_text(path.read_text(encoding="utf-8") + lines, encoding="utf-8")
    at_work = Sample(path)
    at_work.run(2050)
    assert (
        all(at_work.counts(number) == (1, 1, 0) for number in (0, 1, *range(5, 30)))
        and at_work.jobs.table.counters.lost == 0
    )


def test_lesson_11_a_time_out_longer_than_its_period_is_warned_of(folder: Path) -> None:
    (problem,) = check_file(str(folder / "chan4.run.yaml")).problems
    assert problem.warning and problem.what == "the period is over before the time-out"
    assert len(problem.places) == 4


def test_lesson_12_pulses_are_no_counters(with_one_channel: Path) -> None:
    path = with_one_channel / "chan4.run.yaml"
    change(path, "every: 1 s, late: 5 s, status: R1", "every: 10 ms, late: 5 s, status: R1")
    at_work = Sample(path)
    pulses = at_work.edges("I49")
    at_work.run(2995)
    status = at_work.jobs.table.status()[0]
    assert status.counters.good == 100 and sum(value for _, value in pulses) == 50
    assert status.last_good is not None and status.last_good // SECOND == 2


def test_lesson_14_details_are_kept_with_their_time(with_one_channel: Path) -> None:
    slow(with_one_channel, 2, "1300 ms", ", from: 5 s, until: 6 s")
    at_work = Sample(with_one_channel / "chan4.run.yaml")
    at_work.run(9500)
    status = at_work.jobs.table.status()[0]
    assert status.word == 1 and status.last_error is not None and status.last_error // SECOND == 6
    (event,) = at_work.jobs.table.log
    assert (event.name, event.slot, event.word, event.text) == (
        "error", 1, 0x0290, "client: period is over, still waiting",
    )  # fmt: skip


def test_lesson_15_stop_aborts_everything_and_a_start_is_clean(with_one_channel: Path) -> None:
    slow(with_one_channel, 2, "1300 ms")
    change(with_one_channel / "chan4.run.yaml", "[I48 and R20 == 1, I50]", "[I48 and R20 == 1]")
    at_work = Sample(with_one_channel / "chan4.run.yaml")
    at_work.run(3100)
    assert at_work.bit("I41") and at_work.bit("I50")
    at_work.service.reset()
    assert at_work.bits() == () and not any(slot.active for slot in at_work.jobs.table.slots.values())
    assert at_work.jobs.table.slots[1].details == (0, 0)
    at_work.run(100)
    assert at_work.bits() == (13, 16), "R20 is 1 still: the jobs begin with the interface"
    at_work.service.stop()
    assert at_work.bits() == ()
