"""Late, lost and glued replies on a line: no value belongs to another request, and every exchange ends.

`FRAMEKIT_EXCHANGES` sets the number of exchanges of the long tests per protocol.
"""

from __future__ import annotations

import os
from itertools import product
from random import Random
from typing import Any

import pytest
from service.late_world import LINES, MS, SECOND, LateWorld, protocol_of
from spread import spread

from framekit.link.slow import WELL_TIME
from framekit.run.model import FaultRule

ALIKE = ("modbus-rtu", "modbus-ascii", "mldp", "ge-rtu", "registers")
"""Protocols whose replies contain no request number. The last is a user's definition, on `standard`."""
SIX = (*ALIKE, "modbus-tcp")
NUMBERED = ("melsec-mc-4e", "fins-tcp", "srtp")
"""Further protocols whose replies contain a request number."""
MANY = int(os.environ.get("FRAMEKIT_EXCHANGES", "1000"))

LATE = FaultRule(kind="delay", time=1200 * MS, rate=1 / 200)
GLUE = FaultRule(kind="glue", rate=1 / 100)
SHORT = {"retries": 0, "reply_timeout": 100 * MS}

PLANS: dict[str, tuple[tuple[FaultRule, ...], dict[str, Any]]] = {
    "one of 200 late by 1.2 s": ((LATE,), {}),
    "one of 100 glued to the next": ((GLUE,), {}),
    "no repeats, one of 100 late by 120 ms": ((FaultRule(kind="delay", time=120 * MS, rate=1 / 100),), SHORT),
    "no repeats, one of 100 glued to the next": ((GLUE,), SHORT),
}
USUAL = {"srtp": 5000, "snp": 10_000, "snp-x": 2500, "ccm": 800, "ccm-peer": 800, "df1": 3000, "df1-master": 3000}
"""Time limits of the first replies in the procedures (ms)."""
EXCHANGES = {"snp": 800, "snp-x": 1300}
"""Number of exchanges in which a value was wrong while only break and attach kept late replies away."""


def world_of(name: str, plan: str, **more: Any) -> LateWorld:
    rules, params = PLANS[plan]
    known = protocol_of(LINES[name].protocol).params
    return LateWorld(name, *rules, **{key: value for key, value in params.items() if key in known}, **more)


def check(world: LateWorld, count: int) -> None:
    """Check that no value is wrong, that each exchange has ended, and that each failure is reported."""
    world.exchanges(count)
    assert world.wrong == []
    assert world.outcomes.total() == count
    assert set(world.outcomes) <= {"ok", "no_reply"}
    assert world.outcomes["ok"] >= 0.97 * count
    assert sum(world.injected.values()) >= count / 400


@pytest.mark.parametrize(("name", "plan"), spread(product((*SIX, *NUMBERED), PLANS), 3))
def test_no_value_is_that_of_another_request(name: str, plan: str) -> None:
    world = world_of(name, plan)
    check(world, 400)
    if name in ALIKE:
        assert world.late > 0, "some came late, and were counted"


@pytest.mark.parametrize("name", spread(ALIKE, 2))
def test_late_lost_and_damaged_ones_together(name: str) -> None:
    """Delays of up to nearly two reply times, on both sides of the line, with a monitor."""
    rules = (
        FaultRule(kind="jitter", time=1900 * MS, rate=1 / 50),
        FaultRule(kind="no_reply", rate=1 / 100),
        FaultRule(kind="no_reply", rate=1 / 100, of="requests"),
        FaultRule(kind="wrong_check", rate=1 / 100),
        FaultRule(kind="truncate", rate=1 / 100),
        FaultRule(kind="wrong_station", rate=1 / 100),
    )
    world = LateWorld(name, *rules, watched=True)
    world.exchanges(250)
    assert world.wrong == [] and world.outcomes.total() == 250 and world.late > 0
    late_frames = [event for event in world.seen if event.kind == "not_taken" and event.reason.startswith("late")]
    assert len(late_frames) == world.late


@pytest.mark.parametrize("name", USUAL)
def test_procedures_of_their_own_store_nothing_wrong_either(name: str) -> None:
    check_procedure(name, 150)


def check_procedure(name: str, count: int) -> None:
    """Check a procedure.

    SNP and SNP-X wait and attach again, DF1 and SRTP have numbers, CCM waits before the next conversation.
    """
    time = USUAL[name] * MS
    rules = (
        FaultRule(kind="jitter", time=time * 19 // 10, rate=1 / 30),
        FaultRule(kind="no_reply", rate=1 / 60),
        FaultRule(kind="no_reply", rate=1 / 100, of="requests"),
        FaultRule(kind="glue", rate=1 / 60),
    )
    world = LateWorld(name, *rules)
    world.exchanges(count)
    assert world.wrong == []
    assert world.outcomes.total() == count
    assert world.outcomes["ok"] >= 0.6 * count, world.outcomes


KEPT = list(product(("modbus-rtu", "modbus-ascii", "mldp"), (0, 1, 2), (0.05, 0.15), (False, True), (False, True)))


@pytest.mark.parametrize(("name", "retries", "rate", "in_pieces", "loses"), spread(KEPT, 3))
def test_replies_that_are_kept_until_the_next_one(
    name: str, retries: int, rate: float, in_pieces: bool, loses: bool
) -> None:
    """After a failure, the client pauses for longer than it waits for late replies.

    Replies arrive whole or in bytes.
    """
    rules = [FaultRule(kind="glue", rate=rate)]
    rules += [FaultRule(kind="no_reply", rate=0.1)] if loses else []
    rules += [FaultRule(kind="split", size=1)] if in_pieces else []
    glued = 0
    for seed in (1, 2, 3):
        world = LateWorld(name, *rules, seed=seed, retries=retries, reply_timeout=400 * MS)
        for _ in range(40):
            if world.exchange() != "ok":
                world.clock.run_for(10 * SECOND)
        assert world.wrong == []
        assert world.outcomes["ok"] >= 24, world.outcomes
        glued += world.injected["glue"]
    assert glued > 0


PAUSES = (0, 5, 30, 700)
"""Pause after each exchange (s); the last is longer than replies are remembered as late."""
HELD = list(product(ALIKE, (0.05, 0.3, 1.0), (False, True), (0, 2), PAUSES))


def check_held(name: str, rate: float, together: bool, retries: int, pause: int, count: int) -> int:
    """Read values from a gateway that keeps replies; return how often it kept some."""
    world = LateWorld(name, keeps=rate, together=together, retries=retries, reply_timeout=SECOND)
    for _ in range(count):
        world.exchange()
        world.clock.run_for(pause * SECOND)
    assert world.wrong == []
    assert set(world.outcomes) <= {"ok", "no_reply"}
    return world.gateway.number


@pytest.mark.parametrize(("name", "rate", "together", "retries", "pause"), HELD[::7])
def test_a_gateway_that_is_one_reply_behind_yields_no_wrong_value(
    name: str, rate: float, together: bool, retries: int, pause: int
) -> None:
    """A proof does not end the doubt: the replies of another content in it answered earlier requests."""
    assert check_held(name, rate, together, retries, pause, 160) > 0


@pytest.mark.parametrize(
    ("name", "together", "pause"), [("modbus-rtu", True, 0), ("mldp", False, 30), ("modbus-tcp", True, 30)]
)
def test_no_longer_time_out_is_advised_for_replies_that_are_kept(name: str, together: bool, pause: int) -> None:
    more = {"retries": 0} if name in ALIKE else {}
    world = LateWorld(name, keeps=0.3, together=together, reply_timeout=SECOND, **more)
    reports: list[str] = []
    world.service.engine.late.slow.on_change = lambda station, is_slow: reports.append(str(station))
    for _ in range(60):
        world.exchange()
        world.clock.run_for(pause * SECOND)
    assert reports == [
        "station 3 answers only when it is asked again: a longer reply_timeout does not help, a gateway or an adapter "
        "keeps replies"
    ]
    assert world.wrong == []


def test_the_advice_names_a_parameter_that_can_be_set() -> None:
    """The time limit of SNP-X is a sum: its first term is the setting."""
    world = LateWorld("snp-x", lateness=lambda now: 5 * SECOND if now > 10 * SECOND else 0)
    reports: list[str] = []
    world.service.engine.late.slow.on_change = lambda station, is_slow: reports.append(str(station))
    assert world.exchange() == "ok"
    world.clock.run_until(11 * SECOND)
    world.exchanges(3)
    assert reports == ["the other side answers after 5.1 s: set response_timeout to 6 s or more"]


@pytest.mark.long
@pytest.mark.parametrize("name", ALIKE)
def test_a_gateway_that_is_one_reply_behind_yields_no_wrong_value_in_many(name: str) -> None:
    rows = [row for row in HELD if row[0] == name]
    assert sum(check_held(*row, max(60, MANY // len(rows))) for row in rows) > len(rows)


@pytest.mark.parametrize("together", [False, True])
@pytest.mark.parametrize(("name", "rate"), [(name, rate) for name in USUAL for rate in (0.05, 0.15)][::3])
def test_replies_of_procedures_that_a_gateway_keeps_until_the_next_request(
    name: str, rate: float, together: bool
) -> None:
    world = LateWorld(name, keeps=rate, together=together)
    for number in range(60):
        world.exchange()
        world.clock.run_for(number % 3 * 10 * SECOND)
    assert world.wrong == [] and world.gateway.number > 0


def test_a_reply_may_be_later_than_two_reply_times_where_the_line_is_told_so() -> None:
    late = FaultRule(kind="delay", time=3 * 100 * MS, rate=1 / 50)
    world = LateWorld("modbus-rtu", late, retries=0, reply_timeout=100 * MS, late_reply=400 * MS)
    world.exchanges(500)
    assert world.wrong == [] and world.late == world.outcomes["no_reply"] > 5


TIMES = (1.2, 1.5, 2, 2.5, 3.5, 6.5, 20)
"""How late replies are, in time limits."""
WELL = 100 * SECOND
"""Time at which a device that was slow becomes quick (ns)."""
ILL = 10 * SECOND
"""Time at which a device that was quick becomes slow (ns)."""


def slow_world(name: str, times: float, which: str, retries: int, overlapping: bool) -> LateWorld:
    """Return a world in which all replies are late, or one in ten, or those of the first 100 s, or those after 10 s.

    Either each reply is delayed independently, or the device handles one request after the other.
    """
    late = int(times * USUAL.get(name, 1000)) * MS
    known = protocol_of(LINES[name].protocol).params
    given = {"retries": retries, "reply_timeout": 1000 * MS}
    params = {} if name in USUAL else {key: value for key, value in given.items() if key in known}
    random = Random(f"{name} {times}")
    if overlapping:
        lateness = {
            "all": lambda now: late,
            "one in ten": lambda now: late if random.random() < 0.1 else 0,
            "at first": lambda now: late if now < WELL else 0,
            "later": lambda now: late if now >= ILL else 0,
        }
        return LateWorld(name, lateness=lateness[which], **params)
    more: dict[str, Any] = {"all": {}, "one in ten": {"rate": 0.1}, "at first": {"end": WELL}, "later": {"begin": ILL}}[
        which
    ]
    return LateWorld(name, FaultRule(kind="delay", time=late, **more), **params)


SLOW = list(product(ALIKE, TIMES, ("all", "one in ten", "at first", "later"), (0, 2), (False, True)))


def check_slow(name: str, times: float, which: str, retries: int, overlapping: bool, count: int) -> LateWorld:
    world = slow_world(name, times, which, retries, overlapping)
    if which == "later":
        world.exchanges(60)
        world.clock.run_until(ILL)
    world.exchanges(count)
    assert world.wrong == []
    assert set(world.outcomes) <= {"ok", "no_reply"}
    return world


@pytest.mark.parametrize(("name", "times", "which", "retries", "overlapping"), SLOW[::37])
def test_no_reply_of_a_slow_device_is_stored_for_another_request(
    name: str, times: float, which: str, retries: int, overlapping: bool
) -> None:
    check_all_late(check_slow(name, times, which, retries, overlapping, 40), name, times, which, retries)


def check_all_late(world: LateWorld, name: str, times: float, which: str, retries: int, *more: bool) -> None:
    """Assert that a reply to a repeated request counts as a reply to that request."""
    if which == "all":
        assert set(world.outcomes) == {"ok" if times < 1 + retries else "no_reply"}, (name, times, retries)


@pytest.mark.parametrize("times", [12, 20])
@pytest.mark.parametrize("name", ["modbus-rtu", "mldp"])
def test_replies_that_overtake_each_other_by_many_time_outs_stay_open_until_they_can_come_no_more(
    name: str, times: int
) -> None:
    """Requests are repeated, one reply in ten is late: a short silence does not show that the open replies are lost."""
    random = Random(3)
    world = LateWorld(
        name, lateness=lambda now: times * SECOND if random.random() < 0.1 else 0, retries=2, reply_timeout=SECOND
    )
    world.exchanges(250)
    assert world.wrong == [] and world.late > 0
    assert set(world.outcomes) <= {"ok", "no_reply"}


@pytest.mark.parametrize(("name", "times", "retries"), list(product(ALIKE, TIMES, (0, 2)))[::5])
def test_values_are_right_again_soon_after_the_device_is_well(name: str, times: float, retries: int) -> None:
    """Check that values are right within 30 s after the device has become quick."""
    world = slow_world(name, times, "at first", retries, True)
    while world.clock.now() < WELL:
        world.exchange()
    while world.exchange() != "ok":
        assert world.clock.now() < WELL + 30 * SECOND
    world.exchanges(30)
    assert world.wrong == [] and world.clock.now() < WELL + 60 * SECOND


@pytest.mark.parametrize(
    ("times", "shown", "retries", "overlapping"),
    spread(
        [
            (1.5, "1.5 s: set reply_timeout to 2 s", 2, True),
            (1.5, "1.5 s: set reply_timeout to 2 s", 0, False),
            (3.5, "3.5 s: set reply_timeout to 4 s", 0, True),
            (3.5, "3.5 s: set reply_timeout to 4 s", 2, False),
        ],
        3,
    ),
)
def test_the_time_after_which_a_station_answers_is_reported(
    times: float, shown: str, retries: int, overlapping: bool
) -> None:
    world = slow_world("modbus-rtu", times, "at first", retries, overlapping)
    reports: list[str] = []
    world.service.engine.late.slow.on_change = lambda station, is_slow: reports.append(
        f"{station}" if is_slow else "well"
    )
    while world.clock.now() < WELL:
        world.exchange()
    assert reports == [f"station 3 answers after {shown} or more"]
    end = world.clock.now() + 2 * WELL_TIME
    while world.clock.now() < end:
        world.exchange()
    world.exchanges(40)
    assert reports[1:] == ["well"] and world.wrong == []
    assert world.service.engine.counters.repeated >= 10 * retries


@pytest.mark.long
@pytest.mark.parametrize("name", ALIKE)
def test_no_reply_of_a_slow_device_is_stored_for_another_request_in_many(name: str) -> None:
    """One row in three of the matrix, different rows for each protocol; all rows if `FRAMEKIT_EXCHANGES` is set."""
    rows = [row for row in SLOW if row[0] == name]
    if "FRAMEKIT_EXCHANGES" not in os.environ:
        rows = rows[ALIKE.index(name) % 3 :: 3]
    for row in rows:
        check_all_late(check_slow(*row, max(30, MANY // len(rows))), *row)


@pytest.mark.long
@pytest.mark.parametrize("name", (*SIX, *NUMBERED))
def test_no_value_is_that_of_another_request_in_many(name: str) -> None:
    """Two fifths of the exchanges have late replies, one fifth glued, two fifths a short time-out without retries."""
    for plan, fifths in zip(PLANS, (2, 1, 2), strict=False):
        check(world_of(name, plan), MANY * fifths // 5)


@pytest.mark.long
@pytest.mark.parametrize("name", USUAL)
def test_procedures_of_their_own_store_nothing_wrong_in_many(name: str) -> None:
    check_procedure(name, max(EXCHANGES.get(name, 0), MANY * 2 // 5))


@pytest.mark.parametrize(("name", "retries", "sent"), [("modbus-rtu", 0, 1), ("mldp", 0, 1), ("mldp", 2, 2)])
def test_a_write_is_sent_once_where_retries_are_0(name: str, retries: int, sent: int) -> None:
    """Also while replies to earlier writes may still arrive: the write waits until none is expected."""
    lost = FaultRule(kind="no_reply", begin=2 * SECOND, end=6 * SECOND)
    world = LateWorld(name, lost, watched=True, retries=retries, reply_timeout=SECOND)
    world.clock.run_until(3 * SECOND)
    assert not world.write(5).ok
    world.clock.run_until(7 * SECOND)
    world.seen.clear()
    assert world.write(7).ok
    requests = [event for event in world.seen if event.kind == "frame" and event.direction == "out"]
    assert len(requests) == sent
    assert world.clock.now() > 20 * SECOND if retries == 0 else world.clock.now() < 12 * SECOND


SLOW_PROCEDURES = {"snp": (2, 55), "snp-x": (2.5, 50), "ccm": (0.8, 16), "ccm-peer": (0.8, 16)}
"""The time limit of a reply, and the greatest delay (s).

20 time limits, but less than 60 s, the age at which open requests are dropped: SNP waits 10 s for the first reply of a
session, and 20 times that is not guaranteed.
"""


def check_slow_procedure(name: str, part: float, count: int) -> None:
    limit, greatest = SLOW_PROCEDURES[name]
    late = int((limit + part * (greatest - limit)) * SECOND)
    random = Random(f"{name} {part}")
    world = LateWorld(name, lateness=lambda now: late if random.random() < 0.1 else 0)
    world.exchanges(count)
    assert world.wrong == [] and world.late > 0
    assert world.outcomes["ok"] >= 0.4 * count, world.outcomes


PARTS = (0.1, 0.3, 1)


@pytest.mark.parametrize(("name", "part"), list(product(SLOW_PROCEDURES, PARTS))[::2])
def test_slow_devices_of_procedures_of_their_own_store_nothing_wrong(name: str, part: float) -> None:
    check_slow_procedure(name, part, 60)


@pytest.mark.long
@pytest.mark.parametrize(("name", "part"), list(product(SLOW_PROCEDURES, PARTS)))
def test_slow_devices_of_procedures_of_their_own_store_nothing_wrong_in_many(name: str, part: float) -> None:
    check_slow_procedure(name, part, max(60, MANY // len(PARTS)))
