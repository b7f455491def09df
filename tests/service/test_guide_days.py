"""The module guide's four examples for simulated hours: all counts and all words of memories are computed.

Long tests take three hours of the first two examples, and some minutes of the others, which poll more often. A program
would set and clear the bits that start blocks; the test does it if an example needs that.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.memory.memory import DeviceMemory
from framekit.runfile.run_file import load_run
from framekit.service.device import DeviceService
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

EXAMPLES = Path(__file__).parents[2] / "examples"
SECOND = 1_000_000_000
DAY = 24 * 3600
TIMES = [1800, pytest.param(3 * 3600, marks=pytest.mark.long)]
SETTLE = SECOND // 2
"""Time after the last start of the day for running exchanges to end."""


class Day:
    """A running example. Its counters are checked after every advance of time."""

    def __init__(self, name: str) -> None:
        self.clock = VirtualClock()
        self.service = RunService(load_run(EXAMPLES / f"{name}.run.yaml"), self.clock)
        self.service.start()

    def run_for(self, time: int) -> None:
        self.clock.run_for(time)
        for state in self.service.states.values():
            counters = state
            assert counters.started == counters.done + counters.failed + counters.running
            assert counters.running in (0, 1)

    def counts(self) -> dict[int, tuple[int, int, int, int]]:
        """Return started, done, failed, overruns of each block."""
        return {
            number: (state.started, state.done, state.failed, state.overruns)
            for number, state in self.service.states.items()
        }

    def device(self, name: str) -> DeviceService:
        return next(device for device in self.service.devices if device.device.name == name)

    def own(self) -> dict[str, int]:
        """Return the own memory without its system bits and the words of blocks."""
        return words(self.service.memory, "F", "L", "N")

    def check_status_words(self) -> None:
        """Assert that area L contains only the counts of all blocks: no pulse is active, no block has failed."""
        memory = self.service.memory
        expected: dict[str, int] = {}
        for number, (_, done, failed, _) in self.counts().items():
            base = 625 + 6 * number
            expected |= places("L", base + 2, [done & 0xFFFF, done >> 16, failed & 0xFFFF, failed >> 16])
        shown = [area.name for area in memory if area.name != "L"]
        assert words(memory, *shown) == expected


def words(memory: DeviceMemory, *without: str) -> dict[str, int]:
    """Return every word that is not 0, by area and number; areas of bits in words of 16."""
    found = {}
    for area in memory:
        if area.name not in without:
            data = area.read_bytes(0, area.size_bytes)
            for offset in range(0, len(data), 2):
                word = int.from_bytes(data[offset : offset + 2], "little")
                if word:
                    found[f"{area.name}{offset // 2}"] = word
    return found


def places(area: str, first: int, values: list[int]) -> dict[str, int]:
    return {f"{area}{first + index}": value for index, value in enumerate(values) if value}


def test_example_1_mldp_flags_set_once() -> None:
    day = Day("mldp-flags")
    day.run_for(DAY * SECOND)
    assert day.counts() == {0: (1, 1, 0, 0), 1: (1, 1, 0, 0)}
    sent = {"M200": 201, "M210": 202, "M220": 203}
    own = {"M0": 1, "P10": 1, **sent, **places("P", 100, [1100, 1110, 1120, 1130])}
    assert day.own() == own
    day.check_status_words()
    held = {"M100": 1100, "M110": 1110, "M120": 1120, "M130": 1130}
    assert words(day.device("mldp-station-2").memory, "F") == held, "a READ changes nothing there"
    assert words(day.device("mldp-station-5").memory, "F") == {"P101": 201, "P102": 202, "P103": 203}


@pytest.mark.parametrize("seconds", TIMES)
def test_example_1_mldp_flags_every_minute(seconds: int) -> None:
    """The program sets both bits at the start of each minute and clears them half a minute later."""
    day = Day("mldp-flags")
    memory, source = day.service.memory, day.device("mldp-station-2").memory
    for minute in range(seconds // 60):
        day.run_for(30 * SECOND)
        memory.write("M", "word", 0, [0])
        memory.write("P", "word", 10, [0])
        source.write("M", "word", 100, [minute])
        memory.write("M", "word", 200, [minute + 1])
        day.run_for(30 * SECOND)
        memory.write("M", "word", 0, [1])
        memory.write("P", "word", 10, [1])
    day.run_for(SETTLE)
    starts = 1 + seconds // 60
    assert day.counts() == {0: (starts, starts, 0, 0), 1: (starts, starts, 0, 0)}
    last = seconds // 60 - 1
    assert memory.read("P", "word", 100, 4) == [last, 1110, 1120, 1130]
    assert words(day.device("mldp-station-5").memory, "F") == {"P101": last + 1, "P102": 202, "P103": 203}


def test_example_2_mldp_two_channels_set_once() -> None:
    day = Day("mldp-two-channels")
    day.run_for(DAY * SECOND)
    assert day.counts() == {0: (1, 1, 0, 0), 1: (1, 1, 0, 0)}
    ten = list(range(1, 11))
    own = {"T1": 1, "M10": 4, **places("M", 125, ten), "P100": 2500, "P130": 2600}
    assert day.own() == own
    day.check_status_words()
    assert words(day.device("mldp-station-7").memory, "F") == {"M250": 2500, "M260": 2600}
    written = {"M100": 1100, "M110": 1110, "M120": 1120, "M130": 1130, **places("P", 200, ten)}
    assert words(day.device("mldp-station-2").memory, "F") == written, "the WRITE puts ten words from P200 on there"


@pytest.mark.parametrize("seconds", TIMES)
def test_example_2_mldp_two_channels_every_minute(seconds: int) -> None:
    """Both bits rise each minute, at different times; the channels do not wait for each other."""
    day = Day("mldp-two-channels")
    memory = day.service.memory
    for minute in range(seconds // 60):
        day.run_for(20 * SECOND)
        memory.write("M", "word", 10, [0])
        day.run_for(20 * SECOND)
        memory.write("T", "word", 1, [0])
        memory.write("M", "word", 125, [minute] * 10)
        memory.write("M", "word", 10, [4])
        day.run_for(20 * SECOND)
        memory.write("T", "word", 1, [1])
    day.run_for(SETTLE)
    starts = 1 + seconds // 60
    assert day.counts() == {0: (starts, starts, 0, 0), 1: (starts, starts, 0, 0)}
    assert day.device("mldp-station-2").memory.read("P", "word", 200, 11) == [seconds // 60 - 1] * 10 + [0]


@pytest.mark.long
def test_example_3_modbus_remote_io_for_four_minutes() -> None:
    check_remote_io(240)


def check_remote_io(seconds: int) -> None:
    """Assert that block 1 runs every 200 ms, first after 200 ms, and every other block once."""
    day = Day("modbus-remote-io")
    day.run_for(seconds * SECOND)
    polls = seconds * SECOND // 200_000_000
    once = (1, 1, 0, 0)
    others = dict.fromkeys((2, 3, 4, 5, 6), once)
    assert day.counts() == {1: (polls, polls - 1, 0, 0), **others}, "the last one has just begun"
    day.run_for(SETTLE // 5)
    assert day.counts() == {1: (polls, polls, 0, 0), **others}
    read = {"M10": 0x00F4, "M11": 0xA55A, "M20": 0x1234, "M30": 0x0F0F, "M31": 0x8001}
    assert day.own() == {"P4": 0x1E, "P16": 16, "P17": 17, **read}
    day.check_status_words()
    held = [words(day.device(f"remote-io-{number}").memory) for number in range(1, 7)]
    assert held == [
        {"input0": 0x00F4, "input1": 0xA55A},
        {"input0": 0x1234},
        {"coil0": 0xA55A},
        {"input0": 0x0F0F, "input1": 0x8001},
        {"holding0": 16, "holding1": 17},
        {"holding0": 0x0F0F},
    ]


@pytest.mark.long
def test_example_4_third_party_plc_for_ten_minutes() -> None:
    check_third_party(600)


def check_third_party(seconds: int) -> None:
    """Assert a request at each rise of the 1 s clock, the first after 1 s, each answered and confirmed."""
    day = Day("third-party-plc")
    day.run_for(seconds * SECOND)
    last = seconds - 1
    assert day.counts() == {0: (seconds, last, 0, 0), 1: (last, last, 0, 0), 2: (last, last, 0, 0)}, (
        "one has just begun"
    )
    day.run_for(SETTLE)
    assert day.counts() == dict.fromkeys(range(3), (seconds, seconds, 0, 0))
    ours, theirs = [0x1111, 0x2222, 0x3333, 0x4444], list(range(1, 13))
    assert day.own() == {**places("M", 0, ours), **places("M", 100, theirs)}
    day.check_status_words()
    device = day.device("third-party-plc")
    assert words(device.memory) == {**places("M", 0, theirs), **places("M", 100, ours)}
    assert (device.engine.scope["good"], device.engine.scope["late"]) == (seconds, 0)
