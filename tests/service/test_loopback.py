"""The loop-back test: a good loop, and the report for each kind of bad loop."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from line_faults import lose

from framekit.api.monitor import Loopback, LoopbackResult, pattern_of
from framekit.definition.times import LineFormat
from framekit.transport.clock import VirtualClock
from framekit.transport.port import Port
from framekit.transport.simulated_line import Fault, SimulatedLine, Transmission

LINE = LineFormat(9600, 8, "E")


def trial(
    fault: Fault | None = None, lines: tuple[LineFormat, ...] = (LINE,), echo: bool = True
) -> list[LoopbackResult]:
    clock = VirtualClock()
    found: list[LoopbackResult] = []

    def make(line: LineFormat) -> Port:
        return SimulatedLine(clock, line, fault=fault, echo=echo).port("loop")

    Loopback(make, clock, lines, found.extend).start()
    clock.run_for(3600 * 1_000_000_000)
    assert len(found) == len(lines)
    return found


def test_a_good_loop_at_several_speeds_and_formats() -> None:
    lines = (LineFormat(300), LineFormat(9600, 7, "E"), LineFormat(115200, 8, "O", 2))
    for result in trial(lines=lines):
        assert result.passed
        assert result.remarks == []
        assert result.sent == result.received == len(pattern_of(result.line))
        assert result.measured_time == result.expected_time


def test_every_character_is_sent() -> None:
    assert set(pattern_of(LINE)) == set(range(256))
    assert set(pattern_of(LineFormat(9600, 7))) == set(range(128))


def lose_two(transmission: Transmission) -> None:
    lose(transmission, 200)
    lose(transmission, 9)


def change(transmission: Transmission) -> None:
    transmission.flip(5, 0b11)


def break_parity(transmission: Transmission) -> None:
    transmission.flip(5, 0b1)


def slow(transmission: Transmission) -> None:
    for index in range(1, 250):
        transmission.pause(index, 4_000_000)


CASES: list[tuple[Callable[[Transmission], None], list[str]]] = [
    (lose_two, ["2 of 272 bytes are missing", "from byte 9 on it is something else"]),
    (change, ["1 of 272 bytes changed, the first at 5: 05 came back as 06"]),
    (break_parity, ["1 of 272 bytes changed, the first at 5: 05 came back as 04", "1 × parity"]),
]


@pytest.mark.parametrize(("fault", "problems"), CASES, ids=["lost", "changed", "parity"])
def test_bad_loops(fault: Callable[[Transmission], None], problems: list[str]) -> None:
    (result,) = trial(fault)
    assert result.problems == problems
    assert not result.passed


def test_a_line_slower_than_set() -> None:
    """The loop takes 1.3 s instead of 0.3 s: the wait ends before all bytes are back."""
    (result,) = trial(slow)
    assert not result.passed
    assert "missing" in result.problems[0]


def test_nothing_comes_back() -> None:
    (result,) = trial(echo=False)
    assert result.problems == ["nothing came back – are transmitted and received data wired together?"]
