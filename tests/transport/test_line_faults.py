"""Faults: detection by parity, rates and seeds, and each single fault of a transmission."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from line_faults import Faults, insert, lose
from transport.line_world import SECOND, World

from framekit.definition.times import parse_format
from framekit.link.events import LineFault
from framekit.transport.simulated_line import Transmission, in_order


def transmission(data: bytes = b"\x00\x01\x02\x03\x04", text: str = "8E1", step: int = 10) -> Transmission:
    return Transmission("port", 0, data, 100, parse_format(text, 9600), step)


# ---- single things ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "mask", "fault"),
    [
        ("8E1", 0b0_0000_0001, LineFault.PARITY),
        ("8E1", 0b0_0000_0011, None),
        ("8E1", 0b1_0000_0000, LineFault.PARITY),
        ("8E1", 0b1_0000_0001, None),
        ("8O1", 0b0_0000_0111, LineFault.PARITY),
        ("8N1", 0b0_0000_0001, None),
        ("8N1", 0b1_0000_0000, LineFault.FRAMING),
        ("8E1", 0b10_0000_0000, LineFault.FRAMING),
        ("7E1", 0b0_0100_0000, LineFault.PARITY),
        ("7E1", 0b0_1000_0001, None),
        ("8M1", 0b0_0000_0001, None),
        ("8S1", 0b1_0000_0000, LineFault.PARITY),
    ],
)
def test_what_a_receiver_notices(text: str, mask: int, fault: LineFault | None) -> None:
    damaged = transmission(b"\x55\x55", text)
    damaged.flip(1, mask)
    data_bits = int(text[0])
    assert damaged.data == bytes([0x55, 0x55 ^ mask & (1 << data_bits) - 1])
    assert damaged.faults == ({} if fault is None else {1: fault})
    damaged.flip(1, mask)
    assert (damaged.data, damaged.faults) == (b"\x55\x55", {})


def test_pauses_hold_up_what_follows() -> None:
    held = transmission()
    held.pause(2, 7)
    held.pause(0, 1000)
    assert [held.complete_at(count) for count in range(1, 6)] == [1110, 1120, 1137, 1147, 1157]
    assert held.runs() == [2, 5] and held.end == 1157


def test_a_lost_character_leaves_its_time() -> None:
    holed = transmission()
    holed.flip(3, 1)
    lose(holed, 1)
    assert holed.data == b"\x00\x02\x02\x04" and holed.faults == {2: LineFault.PARITY}
    assert [holed.complete_at(count) for count in range(1, 5)] == [110, 130, 140, 150]
    lose(holed, 0)
    lose(holed, 2)
    assert [holed.complete_at(count) for count in range(1, 3)] == [130, 140]
    assert (holed.runs(), holed.end) == ([2], 140)


def test_inserted_characters_move_those_behind() -> None:
    longer = transmission()
    longer.flip(0, 1)
    longer.flip(2, 1)
    longer.pause(2, 5)
    insert(longer, 1, b"ab")
    assert longer.data == b"\x01ab\x01\x03\x03\x04" and set(longer.faults) == {0, 4}
    assert longer.runs() == [4, 7]


def test_truncated() -> None:
    short = transmission()
    short.flip(1, 1)
    short.flip(4, 1)
    short.pause(3, 5)
    short.truncate(3)
    assert (short.data, set(short.faults), short.end) == (b"\x00\x00\x02", {1}, 130)
    short.truncate(0)
    assert (short.data, short.faults) == (b"", {})


@given(
    st.binary(min_size=1, max_size=12),
    st.lists(st.tuples(st.integers(0, 12), st.integers(1, 40)), max_size=4),
    st.integers(0, 400),
)
def test_complete_by_and_complete_at_agree(data: bytes, pauses: list[tuple[int, int]], time: int) -> None:
    held = transmission(data)
    for index, duration in pauses:
        if index < len(data):
            held.pause(index, duration)
    complete = [count for count in range(1, len(data) + 1) if held.complete_at(count) <= time]
    assert held.complete_by(time) == len(complete)
    assert held.runs()[-1] == len(data)
    busy = any(held.begins_at(i) < time + 1 and held.complete_at(i + 1) > time for i in range(len(data)))
    assert held.is_busy(time, time + 1) == busy


# ---- by rate ------------------------------------------------------------------------------------------------


def heard(faults: Faults, text: str = "8N1", count: int = 200) -> World:
    """Send transmissions of 20 zeros, one per second, with these faults."""
    world = World(2, text, fault=faults)
    for _ in range(count):
        world.ports[0].write(bytes(20))
        world.clock.run_for(SECOND)
    return world


@pytest.mark.parametrize(("text", "parity"), [("8E1", True), ("8N1", False)])
def test_bit_errors(text: str, parity: bool) -> None:
    faults = Faults(bit_errors=0.005, seed=1)
    listener = heard(faults, text).listeners[1]
    kinds = Counter(fault for _, fault in listener.faults)
    expected = 4000 * (10 if parity else 9) * 0.005
    assert faults.injected["bit_errors"] == pytest.approx(expected, rel=0.3)
    assert kinds[LineFault.FRAMING] > 5, "stop bits are hit too"
    damaged = {index for index, value in enumerate(listener.bytes) if value}
    flagged = {index for index, fault in listener.faults if fault is LineFault.PARITY}
    if parity:
        single = {index for index in damaged if listener.bytes[index].bit_count() == 1}
        assert len(flagged & single) > 0.9 * len(single)
    else:
        assert len(damaged) > 50 and flagged == set()


def test_byte_errors_change_every_byte_they_hit() -> None:
    faults = Faults(byte_errors=1.0, seed=2)
    listener = heard(faults, "7E1", count=10).listeners[1]
    assert 0 not in listener.bytes and max(listener.bytes) < 128
    assert 40 < len(listener.faults) < 190, "parity and stop bit are left to chance"


def test_whole_transmissions() -> None:
    dropped = Faults(drop=0.25, seed=1)
    assert len(heard(dropped).listeners[1].data) == 200 - dropped.injected["drop"] == pytest.approx(150, abs=25)
    cut = Faults(truncate=1.0, seed=1)
    assert max(len(data) for _, data in heard(cut).listeners[1].data) < 20
    noisy = Faults(extra=1.0, longest_extra=3, seed=1)
    sizes = Counter(now // SECOND for now, _ in heard(noisy).listeners[1].characters())
    assert set(sizes.values()) == {21, 22, 23}


def test_delays_and_an_echo() -> None:
    world = heard(Faults(delay=1000, echo=True, seed=5), count=50)
    late = [now % SECOND - 20 * world.character for now, _ in world.listeners[1].characters()[19::20]]
    assert min(late) >= 0 and max(late) <= 1000 and len(set(late)) > 25
    assert world.listeners[0].characters() == world.listeners[1].characters()


def test_a_seed_repeats_and_kinds_of_faults_do_not_disturb_each_other() -> None:
    def damage(**rates: float) -> bytes:
        return heard(Faults(byte_errors=0.1, **rates), count=20).listeners[1].bytes  # type: ignore[arg-type]

    assert damage(seed=1) == damage(seed=1) != damage(seed=2)
    assert damage(seed=1, delay=100_000) == damage(seed=1)


def test_faults_can_be_put_in_order() -> None:
    world = World(2, fault=in_order(lambda it: insert(it, 0, b">"), lambda it: insert(it, len(it.data), b"<")))
    world.ports[0].write(b"a")
    world.clock.run_for(SECOND)
    assert world.listeners[1].bytes == b">a<"
    assert world.listeners[0].sent_at == [world.character], "the sender knows nothing of it"
