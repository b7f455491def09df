from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from framekit.definition.problems import NOWHERE
from framekit.definition.times import NEVER
from framekit.memory.clock_bits import SystemBits
from framekit.memory.memory import Area, DeviceMemory, DeviceMemoryError, MemoryRangeError, UnknownAreaError
from framekit.memory.profile import ClockBit, FixedBit, FixedKind, MemoryProfile

MS = 1_000_000
S = 1_000 * MS


def locate(text: str) -> tuple[str, int]:
    found = re.fullmatch(r"([A-Z])(\d+)\.(\d+)", text)
    assert found
    return found[1], int(found[2]) * 16 + int(found[3])


def system(
    clocks: dict[str, int], fixed: dict[str, FixedKind] | None = None, wake: list[str] | None = None
) -> tuple[DeviceMemory, SystemBits]:
    profile = MemoryProfile(
        name="test",
        about="",
        source="",
        areas={},
        tables={},
        addresses=(),
        clocks=tuple(ClockBit(address, period, NOWHERE) for address, period in clocks.items()),
        fixed=tuple(FixedBit(address, kind, NOWHERE) for address, kind in (fixed or {}).items()),
        scan=10 * MS,
        named={},
        flags={},
        at=NOWHERE,
    )
    memory = DeviceMemory([Area("F", size=4, access="read")])
    return memory, SystemBits(memory, profile, locate, None if wake is None else [locate(text) for text in wake])


def bit(memory: DeviceMemory, address: str) -> bool:
    area, number = locate(address)
    return memory.area(area).read_bit(number)


def run(bits: SystemBits, start: int, end: int) -> list[int]:
    """Update the bits at each requested time; return these times."""
    times = []
    now = start
    while (now := bits.next_change(now)) <= end:
        bits.update(now)
        times.append(now - start)
    return times


def test_a_clock_rises_at_every_multiple_of_its_period() -> None:
    memory, bits = system({"F0.3": S})
    start = 123_456_789
    bits.start(start)
    edges: list[tuple[int, bool]] = []
    now = start
    memory.watch("F", 0, 1, lambda *_: edges.append((now - start, bit(memory, "F0.3"))))
    while (now := bits.next_change(now)) <= start + 3 * S:
        bits.update(now)
    assert edges == [(S, True), (3 * S // 2, False), (2 * S, True), (5 * S // 2, False), (3 * S, True)]


def test_a_day_brings_each_clock_its_exact_number_of_edges() -> None:
    memory, bits = system({"F0.3": S, "F0.7": 60 * S})
    bits.start(0)
    rises = {"F0.3": 0, "F0.7": 0}
    last = dict.fromkeys(rises, False)

    def count(*_: object) -> None:
        for address in rises:
            on = bit(memory, address)
            rises[address] += on and not last[address]
            last[address] = on

    memory.watch("F", 0, 1, count)
    hours = 2
    assert len(run(bits, 0, hours * 3600 * S)) == hours * 7200 - 1  # both clocks change together
    assert rises == {"F0.3": hours * 3600, "F0.7": hours * 60}


@given(
    st.integers(2, 1000), st.lists(st.integers(0, 5000), min_size=1, max_size=20).map(sorted), st.integers(0, 10**12)
)
def test_the_state_depends_on_the_time_alone(period: int, times: list[int], start: int) -> None:
    memory, bits = system({"F1.15": period})
    bits.start(start)
    last = 0
    for time in times:
        rises: list[bool] = []
        watch = memory.watch("F", 1, 1, lambda *_, rises=rises: rises.append(bit(memory, "F1.15")))
        bits.update(start + time)
        watch.cancel()
        assert bit(memory, "F1.15") == (time >= period and 2 * (time % period) < period)
        assert rises.count(True) == (time // period > last // period)  # one edge for any number of missed edges
        last = time
        due = bits.next_change(start + time) - start
        on = bit(memory, "F1.15")
        assert due > time
        assert (due >= period and 2 * (due % period) < period) != on
        assert (due - 1 >= period and 2 * ((due - 1) % period) < period) == on


def test_a_long_gap_shows_one_edge() -> None:
    memory, bits = system({"F0.0": 20 * MS, "F0.1": S})
    bits.start(0)
    seen: list[int] = []
    memory.watch("F", 0, 1, lambda area, word, _: seen.append(area.read("word", word)[0]))
    bits.update(3_600 * S + 700 * MS)  # both have risen several times; now they are on and off
    assert seen == [0b11, 0b01]
    seen.clear()
    bits.update(7_200 * S)  # both are on again; the off phase of the first was missed
    assert seen == [0b00, 0b11]
    seen.clear()
    bits.update(7_200 * S)
    bits.update(5 * S)
    assert seen == []


def test_being_late_is_told_at_once() -> None:
    _, bits = system({"F0.1": S})
    bits.start(10)
    assert bits.next_change(10) == S + 10
    assert bits.next_change(5 * S) == 5 * S
    bits.update(5 * S)
    assert bits.next_change(5 * S) == 5 * S + 10


def test_fixed_bits_and_the_first_scan() -> None:
    fixed: dict[str, FixedKind] = {
        "F0.9": "on",
        "F0.10": "off",
        "F0.11": "first_scan",
        "F0.12": "after_first_scan",
    }
    memory, bits = system({}, fixed)
    memory.write("F", "word", 0, [0xFFFF], force=True)
    bits.start(S)
    assert memory.read("F", "word", 0) == [0xFFFF & ~0x1400]  # bits without a system meaning stay unchanged
    assert bits.next_change(S) == S + 10 * MS
    bits.update(S + 10 * MS - 1)
    assert bit(memory, "F0.11") and not bit(memory, "F0.12")
    bits.update(S + 10 * MS)
    assert memory.read("F", "word", 0) == [0xFFFF & ~0x0C00]
    assert bits.next_change(2 * S) == NEVER
    bits.start(9 * S)
    assert bit(memory, "F0.11") and bits.next_change(9 * S) == 9 * S + 10 * MS


def test_a_bit_changes_with_every_scan() -> None:
    memory, bits = system({}, {"F0.13": "every_scan"})
    bits.start(0)
    states = []
    for time in range(0, 60, 5):
        bits.update(time * MS)
        states.append(bit(memory, "F0.13"))
    assert states == [False, False, True, True] * 3
    assert run(bits, 55 * MS, 100 * MS) == [5 * MS, 15 * MS, 25 * MS, 35 * MS, 45 * MS]


def test_only_clocks_somebody_waits_for_wake_the_driver() -> None:
    memory, bits = system({"F0.0": 20 * MS, "F0.3": S}, {"F0.13": "every_scan"}, wake=["F0.3"])
    bits.start(0)
    changes: list[int] = []
    memory.watch("F", 0, 1, lambda area, word, _: changes.append(area.read("word", word)[0]))
    assert run(bits, 0, 2 * S) == [S, 3 * S // 2, 2 * S]
    assert changes == [0b1001, 0b0001, 0b1001]
    bits.update(2 * S + 19 * MS)
    assert memory.read("F", "word", 0) == [0b10_0000_0000_1000]  # right at the update, without extra edges
    assert len(changes) == 4


def test_wrong_places_are_refused() -> None:
    with pytest.raises(MemoryRangeError):
        system({"F4.0": S})
    with pytest.raises(UnknownAreaError):
        system({"G0.0": S})
    _, bits = system({"F0.0": S})
    with pytest.raises(DeviceMemoryError, match="not been started"):
        bits.next_change(0)
    with pytest.raises(DeviceMemoryError, match="not been started"):
        bits.update(0)


def test_waiting_for_other_bits() -> None:
    memory, bits = system({"F0.0": S, "F0.1": 3 * S}, wake=["F0.0"])
    bits.start(0)
    assert run(bits, 0, 2 * S) == [S, S + S // 2, 2 * S]
    bits.update(4 * S + S // 4)
    before = memory.read("F", "word", 0)
    bits.wait_for([locate("F0.1")])
    bits.update(4 * S + S // 4 + 1)
    assert memory.read("F", "word", 0) == before, "what rose before nobody waited for"
    assert bits.next_change(4 * S + S // 2) == 4 * S + S // 2
    assert run(bits, 4 * S + S // 2, 7 * S)[-1] == S + S // 2
    bits.wait_for([])
    assert bits.next_change(7 * S) == NEVER
