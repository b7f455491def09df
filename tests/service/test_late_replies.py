"""Late, lost and glued replies on a line: no value is ever that of another request, and every exchange ends.

`FRAMEKIT_EXCHANGES` sets how many exchanges the long tests do with each protocol.
"""

from __future__ import annotations

import os
from itertools import product
from typing import Any

import pytest
from service.late_world import LINES, MS, LateWorld, protocol_of
from spread import spread

from framekit.run.model import FaultRule

ALIKE = ("modbus-rtu", "modbus-ascii", "mldp", "ge-rtu", "registers")
"""Replies that name no request. The last one is a definition of a user, on `standard`."""
SIX = (*ALIKE, "modbus-tcp")
MANY = int(os.environ.get("FRAMEKIT_EXCHANGES", "4000"))

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
"""How long the procedures wait for what they ask first (ms)."""
EXCHANGES = {"snp": 800, "snp-x": 1300}
"""The others: 250. As many as it took until one was wrong while only break and attach kept late replies away."""


def world_of(name: str, plan: str, **more: Any) -> LateWorld:
    rules, params = PLANS[plan]
    known = protocol_of(LINES[name].protocol).params
    return LateWorld(name, *rules, **{key: value for key, value in params.items() if key in known}, **more)


def check(world: LateWorld, count: int) -> None:
    """Nothing is wrong, each exchange has ended, and what did not end well is told."""
    world.exchanges(count)
    assert world.wrong == []
    assert world.outcomes.total() == count
    assert set(world.outcomes) <= {"ok", "no_reply"}
    assert world.outcomes["ok"] >= 0.97 * count
    assert sum(world.injected.values()) >= count / 400


@pytest.mark.parametrize(("name", "plan"), spread(product(SIX, PLANS), 3))
def test_no_value_is_that_of_another_request(name: str, plan: str) -> None:
    world = world_of(name, plan)
    check(world, 700)
    if name in ALIKE:
        assert world.late > 0, "some came late, and were counted"


@pytest.mark.parametrize("name", spread(ALIKE, 2))
def test_late_lost_and_damaged_ones_together(name: str) -> None:
    """Up to nearly two reply times late, on both sides of the line; a monitor looks on."""
    rules = (
        FaultRule(kind="jitter", time=1900 * MS, rate=1 / 50),
        FaultRule(kind="no_reply", rate=1 / 100),
        FaultRule(kind="no_reply", rate=1 / 100, of="requests"),
        FaultRule(kind="wrong_check", rate=1 / 100),
        FaultRule(kind="truncate", rate=1 / 100),
        FaultRule(kind="wrong_station", rate=1 / 100),
    )
    world = LateWorld(name, *rules, watched=True)
    world.exchanges(400)
    assert world.wrong == [] and world.outcomes.total() == 400 and world.late > 0
    told = [one for one in world.seen if one.kind == "not_taken" and one.reason.startswith("late")]
    assert len(told) == world.late


@pytest.mark.parametrize("name", USUAL)
def test_procedures_of_their_own_store_nothing_wrong_either(name: str) -> None:
    check_procedure(name, EXCHANGES.get(name, 250))


def check_procedure(name: str, count: int) -> None:
    """SNP and SNP-X wait and attach anew, DF1 and SRTP have numbers, CCM waits before another conversation."""
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


def test_a_reply_may_be_later_than_two_reply_times_where_the_line_is_told_so() -> None:
    late = FaultRule(kind="delay", time=3 * 100 * MS, rate=1 / 50)
    world = LateWorld("modbus-rtu", late, retries=0, reply_timeout=100 * MS, late_reply=400 * MS)
    world.exchanges(500)
    assert world.wrong == [] and world.late == world.outcomes["no_reply"] > 5


@pytest.mark.long
@pytest.mark.parametrize("name", SIX)
def test_no_value_is_that_of_another_request_in_many(name: str) -> None:
    """Two of five exchanges with late replies, one with glued ones, two with a short time-out and no repeats."""
    for plan, fifths in zip(PLANS, (2, 1, 2), strict=False):
        check(world_of(name, plan), MANY * fifths // 5)


@pytest.mark.long
@pytest.mark.parametrize("name", USUAL)
def test_procedures_of_their_own_store_nothing_wrong_in_many(name: str) -> None:
    check_procedure(name, MANY * 2 // 5)
