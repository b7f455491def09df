"""The virtual clock: order, cancelling, and that it holds no cancelled calls for ever."""

from __future__ import annotations

from framekit.transport.clock import VirtualClock


def test_calls_come_in_order_of_time_then_of_asking() -> None:
    clock, seen = VirtualClock(), []
    clock.call_at(20, lambda: seen.append(("b", clock.now())))
    clock.call_at(10, lambda: seen.append(("a", clock.now())))
    clock.call_at(20, lambda: seen.append(("c", clock.now())))
    clock.run_until(30)
    assert seen == [("a", 10), ("b", 20), ("c", 20)]
    assert clock.now() == 30


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
    for _ in range(10_000):
        clock.call_at(1_000_000, lambda: seen.append(1)).cancel()
    assert len(clock._calls) < 200
    clock.run_until(2_000_000)
    assert seen == []


def test_idle_stops_at_the_limit() -> None:
    clock, seen = VirtualClock(), []

    def again() -> None:
        seen.append(clock.now())
        clock.call_at(clock.now() + 10, again)

    again()
    clock.run_until_idle(35)
    assert seen == [0, 10, 20, 30]
