"""Late, lost and kept replies of a meter of IEC 62056-21: no readout is that of an earlier exchange."""

from __future__ import annotations

import os
from itertools import product
from random import Random

import pytest
from service.late_world import SECOND, LateWorld

from framekit.link.services.client import Done, ServiceClient, Transfer, TransferResult
from framekit.run.model import FaultRule

MANY = int(os.environ.get("FRAMEKIT_EXCHANGES", "100"))
NAME = "iec62056-21"
LIMIT = 1500_000_000
"""Time limit of the replies (ns)."""


def read_out(world: LateWorld, count: int) -> None:
    """Read the meter; each readout has another number than all others."""
    ended: list[TransferResult] = []

    def begin(client: ServiceClient, now: int, done: Done) -> Transfer:
        return client.call("readout", station="", now=now, on_done=done)

    for number in range(count):
        ended.clear()
        restore = world.device.engine.scope.override({"readings": f"0.0({number})\r\n".encode()})
        world.service.request(begin, ended.append)
        while not ended and world.clock.advance():
            pass
        world.outcomes[ended[0].outcome or "ok"] += 1
        if ended[0].ok and [line["value"] for line in ended[0].gives["lines"]["lines"]] != [str(number)]:
            world.wrong.append(f"{ended[0].gives} for {number}")
        restore()


def check(world: LateWorld, count: int, least: float) -> None:
    read_out(world, count)
    assert world.wrong == []
    assert set(world.outcomes) <= {"ok", "no_reply", "late_replies"}
    assert world.outcomes["ok"] >= least * count, world.outcomes


TIMES = (1.2, 2, 3.5, 6.5, 20)


def late_world(times: float, in_order: bool) -> LateWorld:
    late = int(times * LIMIT)
    if in_order:
        return LateWorld(NAME, FaultRule(kind="delay", time=late, rate=0.1))
    random = Random(f"{times}")
    return LateWorld(NAME, lateness=lambda now: late if random.random() < 0.1 else 0)


def least(times: float, in_order: bool) -> float:
    """Return the least part of exchanges that succeed: a meter that delays everything by 30 s is mostly busy."""
    return 0.05 if in_order and times == 20 else 0.3


@pytest.mark.parametrize(("times", "in_order"), list(product(TIMES, (False, True)))[::3])
def test_no_late_readout_is_that_of_another_exchange(times: float, in_order: bool) -> None:
    check(late_world(times, in_order), 30, least(times, in_order))


@pytest.mark.parametrize("together", [False, True])
def test_no_kept_readout_is_that_of_another_exchange(together: bool) -> None:
    world = LateWorld(NAME, keeps=0.3, together=together)
    check(world, 25, 0.5)
    assert world.gateway.number > 5


@pytest.mark.long
@pytest.mark.parametrize(("times", "in_order"), product(TIMES, (False, True)))
def test_no_late_readout_is_that_of_another_exchange_in_many(times: float, in_order: bool) -> None:
    check(late_world(times, in_order), MANY // 10, least(times, in_order))


@pytest.mark.long
@pytest.mark.parametrize(("keeps", "together"), product((0.05, 0.3, 1.0), (False, True)))
def test_no_kept_readout_is_that_of_another_exchange_in_many(keeps: float, together: bool) -> None:
    check(LateWorld(NAME, keeps=keeps, together=together), MANY // 10, 0 if keeps == 1 else 0.5)


def test_a_readout_in_time_is_that_of_its_exchange() -> None:
    world = LateWorld(NAME)
    check(world, 5, 1)
    assert world.clock.now() < 60 * SECOND
