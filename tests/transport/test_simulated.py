"""The simulated line: bit-exact times, several ports, collisions, breaks, errors with and without parity."""

from __future__ import annotations

import pytest

from framekit.definition.times import LineFormat, parse_format
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import VirtualClock
from framekit.transport.simulated import ByteErrors, SimulatedLine, SimulatedPort


class Listener:
    """Notes everything a port tells it."""

    def __init__(self) -> None:
        self.data: list[tuple[int, bytes]] = []
        self.faults: list[CharacterFault] = []
        self.events: list[tuple[str, int]] = []

    def opened(self, now: int) -> None:
        self.events.append(("opened", now))

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self.data.append((now, data))
        self.faults += faults

    def line_break(self, now: int) -> None:
        self.events.append(("break", now))

    def sent(self, now: int) -> None:
        self.events.append(("sent", now))

    def closed(self, now: int, reason: str) -> None:
        self.events.append((f"closed: {reason}", now))

    def control(self, lines: object, now: int) -> None:
        raise AssertionError("a simulated line has no control lines")


def wired(line: SimulatedLine, count: int) -> list[tuple[SimulatedPort, Listener]]:
    found = []
    for number in range(count):
        port, listener = line.port(f"port {number}"), Listener()
        port.open(listener)
        found.append((port, listener))
    line.clock.run_for(0)  # type: ignore[attr-defined]
    return found


@pytest.mark.parametrize(("text", "speed", "bits"), [("8N1", 9600, 10), ("8E1", 19200, 11), ("7E2", 300, 11)])
def test_bytes_take_their_bit_times(text: str, speed: int, bits: int) -> None:
    clock = VirtualClock()
    (sender, mine), (_, other) = wired(SimulatedLine(clock, parse_format(text, speed)), 2)
    sender.write(b"abc")
    sender.write(b"d")
    clock.run_for(1_000_000_000)
    character = round(1e9 * bits / speed)
    assert other.data == [(3 * character, b"abc"), (4 * character, b"d")]
    assert [event for event in mine.events if event[0] == "sent"] == [("sent", 3 * character), ("sent", 4 * character)]


def test_everybody_on_a_shared_pair_hears_but_the_sender() -> None:
    clock = VirtualClock()
    first, second, third = wired(SimulatedLine(clock, LineFormat(9600)), 3)
    second[0].write(b"x")
    clock.run_for(10_000_000)
    assert (first[1].data[0][1], second[1].data, third[1].data[0][1]) == (b"x", [], b"x")


def test_an_echo_lets_the_sender_hear_itself() -> None:
    clock = VirtualClock()
    ((port, listener),) = wired(SimulatedLine(clock, LineFormat(9600), echo=True), 1)
    port.write(b"x")
    clock.run_for(10_000_000)
    assert listener.data[0][1] == b"x"


def test_two_talkers_on_a_half_duplex_pair_damage_each_other() -> None:
    clock = VirtualClock()
    line = SimulatedLine(clock, LineFormat(9600), full_duplex=False)
    first, second, third = wired(line, 3)
    first[0].write(b"aaaa")
    clock.call_at(2 * line.character_time + 1, lambda: second[0].write(b"bb"))
    clock.run_for(100_000_000)
    heard = dict((data[-1:], data) for _, data in third[1].data)
    assert b"aaaa" not in heard.values() and b"bb" not in heard.values()
    assert {fault.fault for fault in third[1].faults} == {LineFault.FRAMING}


def test_a_stream_has_latency_and_no_bit_times() -> None:
    clock = VirtualClock()
    (sender, _), (_, other) = wired(SimulatedLine(clock, None, latency=700), 2)
    sender.write(b"hello")
    clock.run_for(1000)
    assert other.data == [(700, b"hello")]


def test_a_break_reaches_the_others_and_ends() -> None:
    clock = VirtualClock()
    line = SimulatedLine(clock, LineFormat(9600))
    (sender, mine), (_, other) = wired(line, 2)
    sender.send_break(5_000_000)
    sender.write(b"x")
    clock.run_for(100_000_000)
    assert ("break", line.character_time) in other.events
    assert other.data[0][0] == 5_000_000 + line.character_time, "bytes follow the break"
    assert mine.events.count(("sent", 5_000_000)) == 1


@pytest.mark.parametrize(("text", "flagged"), [("8E1", True), ("8N1", False)])
def test_bit_errors_are_flagged_where_there_is_parity(text: str, flagged: bool) -> None:
    clock = VirtualClock()
    settings = parse_format(text, 9600)
    errors = ByteErrors(0.1, seed=1, line=settings)
    (sender, _), (_, other) = wired(SimulatedLine(clock, settings, disturb=errors), 2)
    sender.write(bytes(1000))
    clock.run_for(10_000_000_000)
    data = b"".join(part for _, part in other.data)
    damaged = {index for index, byte in enumerate(data) if byte}
    assert len(damaged) == errors.damaged > 50
    assert {fault.index for fault in other.faults} == (damaged if flagged else set())


def test_a_pulled_port_says_so_and_hears_nothing_any_more() -> None:
    clock = VirtualClock()
    (sender, _), (port, listener) = wired(SimulatedLine(clock, LineFormat(9600)), 2)
    port.pull("gone")
    sender.write(b"x")
    clock.run_for(100_000_000)
    assert listener.events[-1][0] == "closed: gone" and listener.data == []
