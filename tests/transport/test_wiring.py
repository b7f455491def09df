"""Direction and echo around a port, on the simulated line and the virtual clock."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from transport.line_world import Listener

from framekit.definition.times import Direction, parse_format
from framekit.link.events import LineFault
from framekit.transport.clock import VirtualClock
from framekit.transport.port import Port
from framekit.transport.simulated_line import SimulatedLine, Transmission
from framekit.transport.wiring import DirectionPort, EchoFreePort

MS = 1_000_000
SECOND = 1000 * MS


class Bench:
    """A wrapped port, and a plain port at the other end of the line."""

    def __init__(self, around: Callable[[Port, VirtualClock], Port], **line: object) -> None:
        self.clock = VirtualClock()
        self.line = SimulatedLine(self.clock, parse_format("8E1", 9600), **line)  # type: ignore[arg-type]
        self.inner, self.far = self.line.port("inner"), self.line.port("far")
        self.port = around(self.inner, self.clock)
        self.here, self.there = Listener(self.inner), Listener(self.far)
        self.port.open(self.here)
        self.far.open(self.there)
        self.clock.run_for(0)

    def rts_times(self, duration: int) -> list[tuple[int, bool]]:
        """Return the times at which RTS changed."""
        found: list[tuple[int, bool]] = []
        end = self.clock.now() + duration
        while self.clock.now() < end:
            if not found or found[-1][1] != self.inner.rts:
                found.append((self.clock.now(), self.inner.rts))
            self.clock.run_for(MS // 10)
        return found


# ---- direction ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("high", [True, False])
def test_rts_is_there_from_before_the_first_to_behind_the_last_bit(high: bool) -> None:
    direction = Direction(high=high, before=2 * MS, after=3 * MS)
    bench = Bench(lambda port, clock: DirectionPort(port, direction, clock))
    assert bench.inner.rts is not high, "the line is free when the port opens"
    bench.port.write(b"12345678")
    length = 8 * bench.line.character_time
    changes = bench.rts_times(40 * MS)
    assert [level == high for _, level in changes] == [True, False]
    assert 0 <= changes[1][0] - (2 * MS + length + 3 * MS) <= MS // 5
    assert (bench.there.bytes, bench.there.data[-1][0]) == (b"12345678", 2 * MS + length)
    assert bench.here.sent_at == [2 * MS + length + 3 * MS], "its owner may send again when the line is free"


def test_what_is_written_meanwhile_goes_out_before_the_line_is_given_back() -> None:
    bench = Bench(lambda port, clock: DirectionPort(port, Direction(before=MS), clock))
    bench.port.write(b"ab")
    bench.port.write(b"cd")
    bench.clock.run_for(2 * MS)
    bench.port.write(b"ef")
    bench.clock.run_for(50 * MS)
    assert bench.there.bytes == b"abcdef"
    assert len(bench.here.sent_at) == 1
    assert not bench.inner.rts


def test_a_closed_port_sends_nothing_more() -> None:
    bench = Bench(lambda port, clock: DirectionPort(port, Direction(before=5 * MS), clock))
    bench.port.write(b"ab")
    bench.port.close()
    bench.clock.run_for(50 * MS)
    assert bench.there.bytes == b"" and bench.here.sent_at == []


# ---- echo ---------------------------------------------------------------------------------------------------


def echoing(**line: object) -> tuple[Bench, EchoFreePort]:
    bench = Bench(EchoFreePort, full_duplex=False, **line)
    assert isinstance(bench.port, EchoFreePort)
    return bench, bench.port


def test_the_echo_is_taken_away_and_nothing_else() -> None:
    bench, port = echoing(echo=True)
    port.write(b"ask")
    bench.clock.run_for(20 * MS)
    bench.far.write(b"ask")
    bench.clock.run_for(20 * MS)
    assert bench.here.bytes == b"ask", "an answer that is the same as the request is an answer"
    assert (port.removed, port.damaged, port.missing) == (3, 0, 0)


def test_a_damaged_echo_is_still_an_echo() -> None:
    def damage(transmission: Transmission) -> None:
        if transmission.sender == "inner":
            transmission.flip(1, 1)
            transmission.flip(2, 3)

    bench, port = echoing(echo=True, fault=damage)
    port.write(b"ask")
    bench.clock.run_for(20 * MS)
    bench.far.write(b"answer")
    bench.clock.run_for(20 * MS)
    assert bench.here.bytes == b"answer" and bench.here.faults == []
    assert (port.removed, port.damaged) == (3, 2)


def test_faults_of_the_answer_stay_at_their_places() -> None:
    def damage(transmission: Transmission) -> None:
        if transmission.sender == "far":
            transmission.flip(1, 1)

    bench, port = echoing(echo=True, fault=damage)
    port.write(b"as")
    bench.far.write(b"")
    bench.clock.run_for(20 * MS)
    bench.far.write(b"xyz")
    bench.clock.run_for(20 * MS)
    assert bench.here.faults == [(1, LineFault.PARITY)]


def test_a_port_without_echo_loses_no_answer() -> None:
    bench, port = echoing()
    port.write(b"ask")
    bench.clock.run_for(10 * MS)
    bench.far.write(b"no")
    bench.clock.run_for(20 * MS)
    assert bench.here.bytes == b"no" and port.missing == 1
    port.write(b"ask")
    bench.clock.run_for(SECOND)
    bench.far.write(b"ask")
    bench.clock.run_for(20 * MS)
    assert bench.here.bytes == b"noask", "long after the last bit it is no echo any more"
    assert port.missing == 2
