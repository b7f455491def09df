"""Jobs: repetitions, periods, late transfers, errors, commands; data are written before words, words before bits."""

from __future__ import annotations

from pathlib import Path

import pytest
from job_world import MS, SECOND, JobWorld, place, profile_with

from framekit.extras.commreq.job_table import JobState
from framekit.run.block_state import Failure

READY = (13, 16)


NO_WORD = "0xA2: {text: status word could not be written, class: "


def refused(code: int) -> Failure:
    return Failure(outcome="refused", device_code=code)


def slot_of(world: JobWorld, number: int = 1):  # type: ignore[no-untyped-def]
    return world.table.slots[number]


# ---- repetitions and periods ------------------------------------------------------------------------------


def test_the_first_transfer_starts_at_once_whatever_the_period() -> None:
    world = JobWorld(takes=MS)
    world.now = 3 * MS
    world.job(1, period=5965 * 3600 * SECOND)
    assert world.starts == [(3 * MS, 1)]


def test_transfers_start_with_periods_counted_from_the_first() -> None:
    world = JobWorld(takes=3 * MS)
    world.job(1, period=10 * MS)
    world.run(45 * MS)
    assert [at // MS for at, _ in world.starts] == [0, 10, 20, 30, 40]


def test_period_0_is_back_to_back_and_knows_no_period_errors() -> None:
    world = JobWorld(takes=7 * MS)
    world.job(1)
    world.run(30 * MS)
    assert [at // MS for at, _ in world.starts] == [0, 7, 14, 21, 28]
    assert slot_of(world).counters.over_period == 0 and not slot_of(world).error


def test_transfers_that_take_no_time_stop_nobody() -> None:
    world = JobWorld(takes=0)
    world.job(1)
    world.run(5 * MS)
    assert [at // MS for at, _ in world.starts] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("times", [1, 2, 10])
def test_so_many_transfers_and_the_job_is_over(times: int) -> None:
    world = JobWorld(takes=MS)
    world.job(1, period=20 * MS, times=times)
    world.run(SECOND)
    assert len(world.starts) == times and slot_of(world).counters.good == times
    assert slot_of(world).details == (0x0001, 0), "the last code stays, and it is not active"


def test_times_0_goes_on_until_it_is_aborted() -> None:
    world = JobWorld(takes=MS)
    world.job(1, period=20 * MS)
    world.run(SECOND - 1)
    assert len(world.starts) == 50
    world.command("abort", 1)
    world.run(2 * SECOND)
    assert len(world.starts) == 50


def test_a_clock_that_is_late_does_not_move_the_periods() -> None:
    world = JobWorld(takes=MS)
    world.job(1, period=10 * MS)
    world.run(5 * MS)
    world.now = 13 * MS
    world.table.tick(world.now)
    world.run(35 * MS)
    assert [at // MS for at, _ in world.starts] == [0, 13, 20, 30]
    assert slot_of(world).counters.over_period == 0


# ---- late transfers ---------------------------------------------------------------------------------------


def test_a_period_that_is_over_is_told_and_the_transfer_stays_pending() -> None:
    world = JobWorld()
    world.job(1, period=100 * MS)
    world.run(100 * MS)
    assert slot_of(world).details == (0x0290, 1) and slot_of(world).state is JobState.TRANSFERRING
    assert len(world.starts) == 1, "never more than one transfer of a job"
    world.run(120 * MS)
    assert world.bits() == (9, 13, 16, 18)
    world.now = 130 * MS
    world.end(1)
    assert slot_of(world).details == (0x0001, 1)
    world.run(199 * MS)
    assert world.bits() == READY, "a later success takes the error away"
    world.run(200 * MS)
    assert [at // MS for at, _ in world.starts] == [0, 200], "with the next period"
    assert slot_of(world).counters.good == 1


def test_after_a_late_transfer_the_next_one_may_start_at_once(tmp_path: Path) -> None:
    world = JobWorld(profile_with(tmp_path, "next: next_period", "next: at_once"))
    world.job(1, period=100 * MS)
    world.run(130 * MS)
    world.end(1)
    world.run(131 * MS)
    world.end(1)
    world.run(200 * MS)
    assert [at // MS for at, _ in world.starts] == [0, 130, 200], "and those behind it with their periods"


def test_a_late_transfer_is_told_once_or_with_every_period(tmp_path: Path) -> None:
    once, again = JobWorld(), JobWorld(profile_with(tmp_path, "again: no", "again: yes"))
    for world, count in ((once, 1), (again, 4)):
        world.job(1, period=100 * MS)
        world.run(450 * MS)
        assert slot_of(world).counters.over_period == count


def test_a_time_out_is_told_and_the_transfer_stays_pending() -> None:
    world = JobWorld()
    world.job(1, late=500 * MS, times=2)
    world.run(499 * MS)
    assert not slot_of(world).error
    world.run(500 * MS)
    assert slot_of(world).details == (0x0190, 1) and slot_of(world).counters.late == 1
    world.end(1)
    assert slot_of(world).details == (0x0001, 1), "a late transfer counts (A7)"
    world.run(501 * MS)
    world.end(1)
    assert slot_of(world).details == (0x0001, 0)


def test_no_time_out_no_telling() -> None:
    world = JobWorld()
    world.job(1)
    world.run(3600 * SECOND)
    assert slot_of(world).details == (0, 1) and not slot_of(world).error


def test_of_a_short_period_and_a_long_time_out_the_period_comes_first() -> None:
    world = JobWorld()
    world.job(1, period=SECOND, late=5 * SECOND)
    world.run(SECOND)
    assert slot_of(world).word == 0x0290
    world.run(5 * SECOND)
    assert slot_of(world).word == 0x0190, "the latest event counts (A6)"
    assert [event.word for event in world.table.log if event.name == "error"] == [0x0290]


def test_even_a_single_transfer_can_exceed_its_period() -> None:
    world = JobWorld()
    world.job(1, period=100 * MS, times=1)
    world.run(100 * MS)
    assert slot_of(world).word == 0x0290
    world.end(1)
    assert slot_of(world).details == (0x0001, 0) and not slot_of(world).error


def test_time_outs_include_the_connection() -> None:
    world = JobWorld()
    world.connects = False
    world.job(1, late=500 * MS)
    world.run(500 * MS)
    assert world.words("D1") == [0x0190] and slot_of(world).state is JobState.CONNECTING
    world.table.connected(world.connecting[0], world.now)
    world.end(1)
    assert world.words("D1") == [0x0190], "the word is written once (A10)"
    assert slot_of(world).details == (0x0001, 1)


# ---- order of what is written -----------------------------------------------------------------------------


def test_data_then_word_then_bits() -> None:
    world = JobWorld(takes=3 * MS)
    world.job(1, period=SECOND)
    world.run(40 * MS)
    assert world.notes == [
        ("data", 3 * MS, 1),
        ("words", 3 * MS, "D1", 0x0001),
        ("bits", 10 * MS, (13, 16, 17)),
        ("bits", 20 * MS, READY),
    ]


def test_the_word_comes_before_the_error_bit() -> None:
    world = JobWorld(takes=3 * MS)
    world.next_failure = refused(0x05F9)
    world.job(16, period=SECOND)
    world.run(40 * MS)
    assert world.notes == [
        ("words", 3 * MS, "D16", 0xF905),
        ("bits", 10 * MS, (9, 13, 16, 47, 48)),
        ("bits", 20 * MS, (9, 13, 16, 48)),
    ]


def test_the_word_is_written_once_whatever_comes_later() -> None:
    world = JobWorld(takes=MS)
    world.job(1, period=10 * MS)
    world.run(25 * MS)
    world.next_failure = refused(0x05F9)
    world.run(95 * MS)
    assert world.words("D1") == [0x0001] and slot_of(world).counters.refused == 1
    assert slot_of(world).counters.good == 9


def test_an_answer_after_the_end_stores_nothing() -> None:
    world = JobWorld()
    world.job(1)
    (_, attempt), *_ = world.running
    world.command("abort", 1)
    world.finish(attempt)
    assert not [note for note in world.notes if note[0] == "data"]


def test_pulses_of_successive_scans() -> None:
    world = JobWorld(takes=MS)
    world.job(1, period=10 * MS)
    world.run(100 * MS)
    shown = [(note[1] // MS, 17 in note[2]) for note in world.notes if note[0] == "bits"]
    assert shown == [(10, True), (20, False), (30, True), (40, False), (50, True), (60, False), (70, True), (80, False),
                     (90, True), (100, False)], "two transfers may share a pulse; each bit has its scan"  # fmt: skip


def test_any_error_is_on_while_one_slot_shows_one() -> None:
    world = JobWorld(takes=MS)
    world.next_failure = refused(0x05F9)
    world.job(1, period=SECOND)
    world.run(5 * MS)
    world.next_failure = refused(0x05F9)
    world.job(2, period=SECOND)
    world.run(50 * MS)
    assert world.bits() == (9, 13, 16, 18, 20)
    world.command("abort", 1)
    assert world.bits() == (9, 13, 16, 20), "at once"
    world.command("abort", 2)
    assert world.bits() == READY


# ---- errors -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("failure", "word", "bits", "goes_on"),
    [
        (refused(0x05F9), 0xF905, (9, 13, 16, 17, 18), True),
        (refused(0x0100), 0x000B, (9, 13, 16, 17, 18), True),
        (refused(0x0203), 0x0302, (9, 13, 16, 17, 18), True),
        (refused(2), 0x0205, (9, 13, 16, 17, 18), True),
        (refused(0x1104), 0x0411, (9, 13, 16, 17, 18), False),
        (Failure(outcome="cannot_store"), 0xF485, (9, 13, 16, 17, 18), True),
        (Failure(outcome="closed"), 0x9690, (9, 13, 16, 18), False),
        (Failure(outcome="no_reply"), 0x9790, (9, 13, 16, 18), False),
        (Failure(outcome="unfit_reply"), 0x9D90, (9, 13, 16, 18), False),
        (Failure(outcome="no_connect_response"), 0x9890, (9, 13, 16, 18), False),
        (Failure(outcome="no_session_response"), 0x9A90, (9, 13, 16, 18), False),
        (Failure(outcome="session_denied"), 0x9B90, (9, 13, 16, 18), False),
        (Failure(outcome="out_of_order"), 0x9C90, (9, 13, 16, 18), False),
        (Failure(outcome="error_pdu", device_code=0x1132), 0x3211, (9, 13, 16, 17, 18), False),
        (Failure(outcome="not_allowed"), 0x008B, (9, 13, 16, 18), False),
        (Failure(outcome="queue_full"), 0x9590, (9, 13, 14, 16, 18), True),
    ],
)
def test_what_becomes_of_a_job_whose_transfer_fails(
    failure: Failure, word: int, bits: tuple[int, ...], goes_on: bool
) -> None:
    world = JobWorld(takes=MS)
    world.next_failure = failure
    world.job(1, period=100 * MS)
    world.run(10 * MS)
    assert world.bits() == bits and slot_of(world).details == (word, int(goes_on)) and world.words("D1") == [word]
    world.run(250 * MS)
    assert len(world.starts) == (3 if goes_on else 1)
    assert slot_of(world).error is not goes_on, "a success takes the error away, else it stays"


@pytest.mark.parametrize("major", [0x02, 0x04, 0x05, 0x06, 0x07, 0x11])
def test_every_code_of_a_server_comes_to_the_status_word_with_its_name(major: int) -> None:
    """The 43 codes of a service request, the 32 of an error PDU, privilege levels, and codes without a minor code."""
    world = JobWorld(takes=MS)
    profile = world.table.profile
    minors = profile.codes[major].minors or {0: None, 4: None}
    for minor in minors:
        outcome = "error_pdu" if major == 0x11 else "refused"
        world.next_failure = Failure(outcome=outcome, device_code=major << 8 | minor)
        world.job(1, times=1)
        world.run(world.now + 10 * MS)
        word = world.words("D1")[-1]
        assert word == minor << 8 | major
        assert profile.text_of(word).startswith("server: ") and "unknown" not in profile.text_of(word)
        assert profile.text_of(word).endswith(profile.codes[major].minors[minor].text if minors[minor] else "")
    assert len(minors) == {0x05: 43, 0x11: 32}.get(major, 2)


def test_a_status_word_that_cannot_be_written_ends_the_job() -> None:
    world = JobWorld(takes=MS)
    world.job(1, period=100 * MS)
    world.refuse_words = True
    world.run(250 * MS)
    assert slot_of(world).details == (0xA290, 0) and len(world.starts) == 1
    assert world.answers == [(1, 0xA290)] and world.bits() == (9, 13, 16, 18)


def test_after_a_full_queue_there_is_a_pause() -> None:
    world = JobWorld(takes=MS)
    world.next_failure = refused(0x0700)
    world.job(1)
    world.run(30 * MS)
    assert [at // MS for at, _ in world.starts][:3] == [0, 11, 12]


def test_a_connection_that_is_lost_ends_waiting_and_busy_jobs() -> None:
    world = JobWorld()
    world.job(1, period=SECOND)
    world.job(2, period=SECOND)
    world.end(1)
    for number in (1, 2):
        world.table.lost(number, world.now)
    world.run(5 * SECOND)
    assert [slot_of(world, number).details for number in (1, 2)] == [(0x9690, 0), (0x9690, 0)]
    assert len(world.starts) == 2 and world.words("D1") == [1] and world.words("D2") == [0x9690]


@pytest.mark.parametrize(
    ("reason", "word"),
    [("unknown_host", 0xB190), ("no_resolver", 0xB390), ("no_channel", 0x9090), ("not_connected", 0x9690)],
)
def test_no_way_to_the_host(reason: str, word: int) -> None:
    world = JobWorld()
    world.connects = False
    world.job(1, period=100 * MS)
    world.table.not_connected(world.connecting[0], reason, world.now)
    world.run(SECOND)
    assert world.words("D1") == [word] and slot_of(world).details == (word, 0) and not world.starts
    assert world.bits() == READY, "no error bit: nothing had begun"
    assert [(event.name, event.word) for event in world.table.log] == [("ended", word)]


def test_a_connection_that_takes_too_long() -> None:
    world = JobWorld()
    world.connects = False
    world.job(1)
    world.run(90 * SECOND - 1)
    assert world.words("D1") == []
    world.run(90 * SECOND)
    assert world.words("D1") == [0x9790] and slot_of(world).state is JobState.IDLE


# ---- commands ---------------------------------------------------------------------------------------------


def test_abort_is_no_error_for_idle_slots_and_zeroes_everything_before_its_answer() -> None:
    world = JobWorld(takes=MS)
    world.next_failure = refused(0x05F9)
    world.job(3, period=SECOND)
    world.run(10 * MS)
    world.notes.clear()
    world.command("abort", 3, status="D100")
    assert world.notes == [("bits", 10 * MS, READY), ("words", 10 * MS, "D100", 1)]
    assert slot_of(world, 3).details == (0, 0)
    world.command("abort", 5, status="D100")
    world.command("abort", None, status="D100")
    assert world.words("D100") == [1, 1, 1]


def test_abort_all() -> None:
    world = JobWorld()
    for number in range(1, 17):
        world.job(number)
    world.command("abort", None)
    assert all(not slot.active for slot in world.table.slots.values())
    assert world.words("D7") == [0x9790], "the establishing commands were not answered yet"


def test_a_new_job_in_a_busy_slot_replaces_the_old_one() -> None:
    world = JobWorld()
    first = world.job(1, status="D50", period=100 * MS)
    (_, attempt) = world.running.pop()
    second = world.job(1, status="D51")
    assert world.words("D50") == [0x9790] and world.answers == [(first, 0x9790)]
    world.finish(attempt)
    assert world.words("D51") == [], "the old transfer is nobody's"
    world.end(1)
    assert world.answers[-1] == (second, 1) and slot_of(world).counters.good == 1


def test_detail_words_come_before_the_answer_and_change_nothing() -> None:
    world = JobWorld(takes=MS)
    world.next_failure = refused(0x05F9)
    world.job(5, period=SECOND)
    world.run(30 * MS)
    before = world.bits()
    world.notes.clear()
    world.command("inspect", 5, into=place("D100"), status="D10")
    assert world.notes == [("words", 30 * MS, "D100", 0xF905, 1), ("words", 30 * MS, "D10", 1)]
    world.run(60 * MS)
    assert before == (9, 13, 16, 26) and len(world.notes) == 2 and slot_of(world, 5).error


def test_an_idle_slot_tells_its_last_code() -> None:
    world = JobWorld(takes=MS)
    world.job(5, times=1)
    world.run(30 * MS)
    world.command("inspect", 5, into=place("D100"))
    assert ("words", 30 * MS, "D100", 1, 0) in world.notes


@pytest.mark.parametrize("number", [0, 17])
def test_there_are_16_slots(number: int) -> None:
    world = JobWorld()
    world.job(number, status="D200")
    world.command("abort", number, status="D200")
    world.command("inspect", number, status="D200", into=place("D100"))
    assert world.words("D200") == [0x8890] * 3 and not world.starts
    world.command("inspect", None, status="D201", into=place("D100"))
    assert world.words("D201") == [0x8890], "only abort knows all slots"


def test_reports_are_refused_and_leave_the_job_that_is_there() -> None:
    world = JobWorld(takes=MS)
    world.job(1, period=100 * MS)
    world.run(50 * MS)
    world.job(1, status="D60", kind="report", period=100 * MS)
    assert world.words("D60") == [0x008B] and slot_of(world).active


def test_the_eighteenth_command_of_a_scan_is_lost() -> None:
    world = JobWorld(takes=MS)
    ids = [world.command("abort", 1 + index % 16, status=f"D{300 + index}") for index in range(18)]
    assert world.answers == [(number, 1) for number in ids[:17]] + [(ids[17], None)]
    assert world.words("D317") == [], "it is never answered"
    (event,) = world.table.log
    assert str(event) == "0.000 s lost slot 2 event 0x08 0x0024" and world.table.counters.lost == 1
    world.run(10 * MS)
    assert world.bits() == (13, 14, 16)
    world.run(20 * MS)
    assert world.bits() == READY, "the bit resets itself"
    world.command("abort", 1, status="D400")
    assert world.words("D400") == [1]


# ---- start and stop ---------------------------------------------------------------------------------------


def test_stop_aborts_all_jobs_and_start_begins_anew() -> None:
    world = JobWorld(takes=MS)
    world.next_failure = refused(0x05F9)
    world.job(1, period=10 * MS)
    world.run(5 * MS)
    world.job(2, period=10 * MS)
    world.run(10 * MS)
    assert world.bits() == (9, 13, 16, 17, 18, 19)
    world.table.stop()
    assert world.bits() == () and slot_of(world).details == (0xF905, 0)
    world.run(SECOND)
    assert len(world.starts) == 3
    world.job(1)
    assert world.answers[-1][1] is None, "no command is taken"
    world.table.start(world.now)
    world.run(world.now + 10 * MS)
    assert slot_of(world).details == (0, 0) and world.bits() == READY


def test_a_stopped_table_leaves_no_command_waiting() -> None:
    world = JobWorld()
    first = world.job(1)
    world.table.stop()
    assert world.answers == [(first, None)]


def test_the_network_bit() -> None:
    world = JobWorld()
    world.run(10 * MS)
    world.table.set_network(False, world.now)
    world.run(20 * MS)
    assert world.bits() == (16,)
    world.table.set_network(True, world.now)
    world.run(30 * MS)
    assert world.bits() == READY


# ---- diagnosis --------------------------------------------------------------------------------------------


def test_the_log_keeps_16_events() -> None:
    world = JobWorld()
    for _ in range(20):
        world.job(0, status=None)
        world.run(world.now + 10 * MS)
    assert len(world.table.log) == 16 and world.table.log.total == 20


def test_status_of_jobs() -> None:
    world = JobWorld(takes=MS)
    world.job(2, period=100 * MS, times=3, host="3.0.0.2", count=8)
    world.run(150 * MS)
    status = world.table.status()[1]
    assert (status.slot, status.kind, status.state, status.word, status.text) == (2, "read", "waiting", 1, "success")
    assert (status.counters.completed, status.left, status.remote, status.own, status.count, status.host) == (
        2, 1, "R1", "M0", 8, "3.0.0.2",
    )  # fmt: skip
    assert status.last_good == 101 * MS and status.last_error is None and not status.pending
    assert world.table.status()[0].kind == ""


def test_a_job_without_a_connection_never_starts_whatever_the_class_of_its_words(tmp_path: Path) -> None:
    world = JobWorld(profile_with(tmp_path, NO_WORD + "fatal}", NO_WORD + "transient}"))
    world.connects, world.refuse_words = False, True
    world.job(1, late=100 * MS, period=SECOND)
    world.run(5 * SECOND)
    assert world.starts == [] and world.table.slots[1].state is JobState.IDLE
