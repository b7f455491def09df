"""Every fault of a plan with every client protocol: no wrong value is stored, the next exchange succeeds.

The fault is reported. With parity or a CRC on the line, no damage may pass. The undetected damage of 8-bit checks is
measured with the codecs.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import pytest
from service.fault_world import LINKS, MS, SECOND, FaultWorld, Link
from spread import spread

from framekit.definition.load.protocol import load_protocol
from framekit.run.model import FaultPlan, FaultRule
from framekit.runfile.fault_plans import mismatches

SINGLE: dict[str, dict[str, Any]] = {
    "delay": {"time": 100 * MS},
    "jitter": {"time": 200 * MS},
    "no_reply": {},
    "wrong_check": {},
    "wrong_station": {},
    "error_reply": {},
    "truncate": {},
    "extra": {},
    "glue": {},
    "split": {},
    "disconnect": {},
}
"""Faults of a single frame."""

HARMLESS = ("delay", "jitter", "split")
LASTING: dict[str, dict[str, Any]] = {"noise": {"rate": 1 / 2000}, "stray": {"time": 200 * MS}, "echo": {"every": 5}}
NEVER_SENT = {("wrong_station", "ccm-peer")}
"""Faults without such frames: a reply to an enquiry between peers contains no station."""

UNCHECKED = {("noise", "srtp-client")}
"""Long frames without a check code; their integrity depends on the underlying connection, which is checked."""


def fits(kind: str, link: Link) -> bool:
    plan = FaultPlan(rules=(FaultRule(kind=kind),)).of_line()  # type: ignore[arg-type]
    return not list(mismatches(plan, load_protocol(link.protocol), line=True)) and (kind, str(link)) not in NEVER_SENT


PLACES = (1, 2, 5)
"""Number of the affected frame of the device.

Each kind of fault uses all of them, on different links, and so does each link.
"""

HITS = [(kind, link, PLACES[(at + number) % 3]) for at, kind in enumerate(SINGLE) for number, link in enumerate(LINKS)]


@pytest.mark.parametrize(("kind", "link", "place"), spread(HITS, 5), ids=str)
def test_one_frame_is_hit_and_the_next_exchange_succeeds(kind: str, link: Link, place: int) -> None:
    if not fits(kind, link):
        pytest.skip(f"{link} has nothing that {kind} could be done to")
    world = FaultWorld(link, rule_for(kind, place))
    hit = ""
    while not world.injected[kind]:
        hit = world.exchange()
        assert world.number <= 20, "no frame could be hit"
    if kind == "glue" and hit != "ok":
        world.exchange()  # the held frame arrives only now
    if hit != "ok":
        world.clock.run_for(30 * SECOND)  # the other side may still wait for a frame that never arrives
    assert hit == "ok" or kind not in HARMLESS
    assert [world.exchange(), world.exchange()] == ["ok", "ok"], hit
    assert world.wrong == []
    if kind not in HARMLESS:
        assert_shown(kind, world, hit)
    assert world.injected == {kind: 1}


def rule_for(kind: str, place: int) -> FaultRule:
    """Return a rule for a single fault of the device's frame `place` after the first second, in which links come up."""
    return FaultRule(kind=kind, every=place, times=1, begin=SECOND, **SINGLE[kind])  # type: ignore[arg-type]


def assert_shown(kind: str, world: FaultWorld, outcome: str) -> None:
    """Assert that the fault is visible: in a counter of bad frames, noise, repeats or reopenings, or in the outcome."""
    counters, seen = world.engine.counters, world.seen
    if kind == "wrong_check":
        assert counters.bad == 1
    elif kind == "error_reply":
        assert outcome != "ok"
    elif kind == "disconnect":
        assert world.device.driver.reopenings + world.driver.reopenings >= 1 or outcome != "ok" or seen["repeated"]
    elif kind == "extra":
        assert counters.noise_bytes + counters.bad + counters.not_taken + world.device.engine.counters.bad > 0
    elif kind != "glue":  # a frame that arrives together with the next frame may have no effect
        lost = counters.bad + counters.noise_bytes + counters.not_taken + seen["repeated"]
        lost += sum(world.engine.scope.get(name) or 0 for name in ("enqs_sent", "naks_sent"))  # a link that asks again
        assert lost > 0 or outcome != "ok"


@pytest.mark.parametrize(("kind", "link"), spread(product(LASTING, LINKS), 5, 2), ids=str)
def test_what_lasts_stores_nothing_wrong_and_is_over_when_it_is_over(kind: str, link: Link) -> None:
    if (kind, str(link)) in UNCHECKED:
        pytest.skip(f"{link} cannot see {kind}")
    rules = [FaultRule(kind=kind, of=of, **LASTING[kind]) for of in ("replies", "requests")]  # type: ignore[arg-type]
    world = FaultWorld(link, *rules[: 1 if kind == "echo" else 2])
    for _ in range(40):
        world.exchange()
    assert world.wrong == []
    assert world.injected[kind] >= 3
    assert world.outcomes.count("ok") >= 15 or kind == "echo", "some procedures cannot do with an echo at all"
    world.no_more()
    world.clock.run_for(30 * SECOND)
    assert [world.exchange(), world.exchange()] == ["ok", "ok"]
    assert world.wrong == []


@pytest.mark.parametrize("link", spread(LINKS, 4), ids=str)
def test_the_same_seed_gives_the_same_faults(link: Link) -> None:
    rules = [
        FaultRule(kind="noise", rate=1 / 500),
        FaultRule(kind="truncate", rate=0.1),
        FaultRule(kind="jitter", time=MS),
    ]

    def story(seed: int) -> tuple[list[str], dict[str, int], int]:
        world = FaultWorld(link, *rules, seed=seed)
        for _ in range(12):
            world.exchange()
        return world.outcomes, dict(world.injected), world.clock.now()

    assert story(4) == story(4)
    assert story(4) != story(5)
