"""Clocks: order, cancelling, moving virtual time, lagging participants, and real timers that never fire early."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from transport.real_world import run

from framekit.transport.clock import LONGEST, MOST, PIECE, AsyncioClock, Turns, VirtualClock


def test_calls_come_in_order_of_time_then_of_asking() -> None:
    clock, seen = VirtualClock(), []
    clock.call_at(20, lambda: seen.append(("b", clock.now())))
    clock.call_at(10, lambda: seen.append(("a", clock.now())))
    clock.call_at(20, lambda: seen.append(("c", clock.now())))
    clock.run_until(30)
    assert seen == [("a", 10), ("b", 20), ("c", 20)]
    assert clock.now() == 30


@given(st.lists(st.tuples(st.integers(0, 20), st.booleans()), max_size=40))
def test_any_calls_come_sorted_but_for_the_cancelled(calls: list[tuple[int, bool]]) -> None:
    clock, seen = VirtualClock(), []
    handles = [
        clock.call_at(when, lambda number=number: seen.append((clock.now(), number)))
        for number, (when, _) in enumerate(calls)
    ]
    for handle, (_, cancelled) in zip(handles, calls, strict=True):
        if cancelled:
            handle.cancel()
    clock.run_until(100)
    assert seen == sorted((when, number) for number, (when, cancelled) in enumerate(calls) if not cancelled)
    assert clock.next_call is None


def test_a_call_may_ask_for_calls_at_the_same_time() -> None:
    clock, seen = VirtualClock(), []

    def first() -> None:
        clock.call_soon(lambda: seen.append(clock.now()))

    clock.call_at(5, first)
    clock.run_until(5)
    assert seen == [5]


def test_a_past_time_means_now() -> None:
    clock, seen = VirtualClock(100), []
    clock.call_at(10, lambda: seen.append(clock.now()))
    clock.run_for(0)
    assert seen == [100]


def test_cancelled_calls_do_not_come_and_do_not_pile_up() -> None:
    clock, seen = VirtualClock(), []
    kept = clock.call_at(500_000, lambda: seen.append(clock.now()))
    for _ in range(10_000):
        handle = clock.call_at(1_000_000, lambda: seen.append(1))
        handle.cancel()
        handle.cancel()
    assert len(clock._calls) < 200
    assert clock.next_call == 500_000
    clock.run_until(2_000_000)
    assert seen == [500_000]
    kept.cancel()
    assert clock.next_call is None


def test_advance_goes_from_time_to_time() -> None:
    clock, seen = VirtualClock(), []
    for when in (3, 3, 8):
        clock.call_at(when, lambda: seen.append(clock.now()))
    assert (clock.advance(), seen) == (True, [3, 3])
    assert (clock.advance(), seen) == (True, [3, 3, 8])
    assert not clock.advance()
    assert clock.now() == 8


def test_an_error_in_a_call_comes_out_and_the_clock_goes_on() -> None:
    clock, seen = VirtualClock(), []
    clock.call_at(1, lambda: [][0])
    clock.call_at(2, lambda: seen.append(clock.now()))
    with pytest.raises(IndexError):
        clock.run_until(5)
    clock.run_until(5)
    assert seen == [2]


class Ticking:
    """A participant with an event every 10 ns, reported late and together."""

    def __init__(self, seen: list[tuple[str, int, int]], clock: VirtualClock) -> None:
        self.seen, self.clock, self.told = seen, clock, 0

    def behind(self, until: int) -> int | None:
        return until // 10 * 10 if until // 10 * 10 > self.told else None

    def catch_up(self, until: int) -> None:
        self.told = until
        self.seen.append(("lagging", until, self.clock.now()))


def test_who_lags_behind_catches_up_before_calls_and_where_time_stops() -> None:
    clock = VirtualClock()
    seen: list[tuple[str, int, int]] = []
    ticking = Ticking(seen, clock)
    clock.lag(ticking)
    for when in (5, 47, 60):
        clock.call_at(when, lambda: seen.append(("call", clock.now(), clock.now())))
    clock.run_until(95)
    assert [(kind, now) for kind, _, now in seen] == [
        ("call", 5), ("lagging", 40), ("call", 47), ("lagging", 60), ("call", 60), ("lagging", 90),
    ]  # fmt: skip
    clock.end_lag(ticking)
    clock.run_until(200)
    assert len(seen) == 6


def test_a_call_that_only_observes_moves_no_time_and_lets_no_source_report() -> None:
    clock = VirtualClock()
    seen: list[tuple[str, int, int]] = []
    clock.lag(Ticking(seen, clock))
    clock.call_at(5, lambda: seen.append(("call", clock.now(), clock.now())))
    clock.call_at(47, lambda: seen.append(("call", clock.now(), clock.now())))
    for when in (25, 90, 31):
        clock.look_at(when, lambda when=when: seen.append(("look", when, clock.now())))
    clock.run_until(60)
    assert seen == [
        ("call", 5, 5), ("look", 25, 5), ("look", 31, 5), ("lagging", 40, 40), ("call", 47, 47), ("lagging", 60, 60),
    ]  # fmt: skip
    clock.run_until(100)
    assert seen[6:] == [("look", 90, 60), ("lagging", 100, 100)]


@pytest.mark.usefixtures("each_loop")
def test_in_real_time_a_call_that_only_observes_is_made_too() -> None:
    async def check() -> bool:
        clock, made = AsyncioClock(asyncio.get_running_loop()), asyncio.Event()
        clock.look_at(clock.now() + 1_000_000, made.set)
        await asyncio.wait_for(made.wait(), 60)
        return made.is_set()

    assert run(check())


@pytest.mark.usefixtures("each_loop")
def test_real_time_calls_in_order_and_never_early() -> None:
    async def check() -> list[tuple[str, bool]]:
        clock = AsyncioClock(asyncio.get_running_loop())
        seen: list[tuple[str, bool]] = []
        done = asyncio.Event()
        begin = clock.now()
        clock.call_at(
            begin + 30_000_000, lambda: (seen.append(("late", clock.now() >= begin + 30_000_000)), done.set())
        )
        clock.call_at(begin + 1_000_000, lambda: seen.append(("early", clock.now() >= begin + 1_000_000)))
        clock.call_at(begin + 2_000_000, lambda: seen.append(("cancelled", True))).cancel()
        clock.call_at(begin - 1_000_000, lambda: seen.append(("past", True)))
        clock.call_soon(lambda: seen.append(("soon", True)))
        async with asyncio.timeout(180):
            await done.wait()
        return seen

    seen = run(check())
    order = [kind for kind, _ in seen]
    assert all(in_time for _, in_time in seen)
    assert [kind for kind in order if kind != "soon"] == ["past", "early", "late"]
    assert order.index("past") < order.index("soon") < order.index("late")


@pytest.mark.usefixtures("each_loop")
def test_real_time_keeps_the_order_however_late_it_is() -> None:
    """Times so close that many calls are due in one turn of the loop, some already overdue when scheduled."""

    async def check() -> list[int]:
        clock = AsyncioClock(asyncio.get_running_loop())
        seen: list[int] = []
        begin, done = clock.now(), asyncio.Event()
        for number in range(2000):
            clock.call_at(begin + number // 2 * 3_000, lambda number=number: seen.append(number))
        clock.call_at(begin + 20_000_000, done.set)
        async with asyncio.timeout(180):
            await done.wait()
        return seen

    assert run(check()) == list(range(2000))


class TickingLoop:
    """A loop that rounds delays to whole milliseconds, as uvloop does, and records them."""

    def __init__(self) -> None:
        self.delays: list[int] = []

    def call_later(self, delay: float, callback: Callable[[], None]) -> SimpleNamespace:
        self.delays.append(round(1000 * delay))
        return SimpleNamespace(cancel=lambda: None)


@pytest.mark.parametrize(("delay", "milliseconds"), [(1, 1), (400_000, 1), (1_300_000, 2), (2_000_000, 2)])
def test_a_delay_is_rounded_up_if_the_loop_rounds_it(
    delay: int, milliseconds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A delay that is rounded to 0 would let the loop turn until the call is due."""
    monkeypatch.setattr("framekit.transport.clock.time", SimpleNamespace(monotonic_ns=lambda: 700_000))
    loop = TickingLoop()
    AsyncioClock(cast(asyncio.AbstractEventLoop, loop)).call_at(700_000 + delay, lambda: None)
    assert loop.delays == [milliseconds]


@pytest.mark.usefixtures("each_loop")
def test_in_real_time_too_cancelled_calls_do_not_come_or_pile_up() -> None:
    async def check() -> list[str]:
        clock = AsyncioClock(asyncio.get_running_loop())
        seen: list[str] = []
        done = asyncio.Event()
        now = clock.now()
        for _ in range(1000):
            clock.call_at(now + 3_600_000_000_000, lambda: seen.append("cancelled")).cancel()
        assert len(clock._calls) < 200
        both = [clock.call_at(now, lambda: both[1].cancel()), clock.call_at(now, lambda: seen.append("too late"))]
        clock.call_at(now + 1, lambda: [][0])
        clock.call_at(now + 2, done.set)
        clock.loop.set_exception_handler(lambda loop, context: seen.append(type(context["exception"]).__name__))
        async with asyncio.timeout(180):
            await done.wait()
        return seen

    assert run(check()) == ["IndexError"]


# ---- turns --------------------------------------------------------------------------------------------------


async def taken(sizes: list[int], each: int = 0) -> list[list[int]]:
    """Return the pieces handled in each turn of the loop if each takes `each` ns."""
    loop = asyncio.get_running_loop()
    time, found = [0], [[]]
    turns = Turns(loop, lambda: time[0])

    def deal(number: int) -> None:
        found[-1].append(number)
        time[0] += each

    for number, size in enumerate(sizes):
        turns.take(size, lambda number=number: deal(number))
    while turns.waiting:
        found.append([])
        await asyncio.sleep(0)
    return [turn for turn in found if turn]


@given(st.lists(st.integers(1, 3 * MOST), max_size=60), st.sampled_from([0, LONGEST // 3, 2 * LONGEST]))
def test_turns_are_shared_in_order_and_none_has_too_much(sizes: list[int], each: int) -> None:
    turns = run(taken(sizes, each))
    assert [number for turn in turns for number in turn] == list(range(len(sizes)))
    for turn in turns:
        assert len(turn) == 1 or sum(sizes[number] + PIECE for number in turn) <= MOST
        assert len(turn) == 1 or (len(turn) - 1) * each < LONGEST
    for turn, later in pairwise(turns):
        available = sum(sizes[number] + PIECE for number in turn) + sizes[later[0]] + PIECE
        assert available > MOST or len(turn) * each >= LONGEST, "no turn ends early"


def test_the_first_piece_of_a_turn_has_all_its_room() -> None:
    async def check() -> None:
        time = [0]
        turns = Turns(asyncio.get_running_loop(), lambda: time[0])
        assert turns.take(MOST // 3, lambda: None) and turns.room == MOST - PIECE - (MOST // 3 + PIECE)
        time[0] += LONGEST
        assert turns.room == MOST - PIECE, "the turn before is over"
        assert turns.take(turns.room, lambda: None)

    run(check())


@pytest.mark.usefixtures("each_loop")
def test_calls_that_are_due_leave_others_their_turn() -> None:
    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        time, seen = [0], []
        clock.turns.now = lambda: time[0]

        def work(number: int) -> None:
            seen.append(number)
            time[0] += LONGEST // 2

        for number in range(9):
            clock.call_soon(lambda number=number: work(number))
        counts = []
        while len(seen) < 9:
            await asyncio.sleep(0)
            counts.append(len(seen))
        assert seen == list(range(9))
        assert max(after - before for before, after in pairwise([0, *counts])) <= 3

    run(check())
