"""Words of a memory that contain the date and the time, on virtual time."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import pytest

from framekit.definition.problems import DefinitionError
from framekit.definition.times import NEVER
from framekit.memory.clock_bits import SystemBits
from framekit.memory.memory import DeviceMemory
from framekit.memory.profile import load_profile
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
RUN = """
run: calendar
memory: {memory}
channels:
  1: {{port: "sim:snet.device.yaml", protocol: mldp, station: 2}}
blocks:
  0: {{read: "%MW0", into: P0, on_change: F0055}}
"""
DEVICE = "device: snet\nprotocol: mldp\nstation: 2\nmemory: masterlogic\n"


def words(memory: DeviceMemory, *numbers: int) -> list[int]:
    return [memory.read("F", "word", number)[0] for number in numbers]


def run_of(folder: Path, memory: str = "masterlogic") -> Path:
    (folder / "snet.device.yaml").write_text(DEVICE)
    path = folder / "calendar.run.yaml"
    path.write_text(RUN.format(memory=memory))
    return path


def masterlogic(begin: datetime) -> tuple[DeviceMemory, SystemBits]:
    profile = load_profile("masterlogic")
    memory = profile.create()

    def locate(text: str) -> tuple[str, int]:
        return "F", int(text[1:5]) * 16 + (int(text[5], 16) if len(text) > 5 else 0)

    return memory, SystemBits(memory, profile, locate, (), lambda now: begin + timedelta(microseconds=now // 1000))


def test_the_words_of_masterlogic() -> None:
    memory, system = masterlogic(datetime(2026, 11, 22, 16, 59, 58, 500_000))
    system.start(0)
    assert words(memory, 53, 54, 55, 56) == [0x1126, 0x1622, 0x5859, 0x2000], "22 November 2026 is a Sunday"
    assert words(memory, 136, 137) == [(datetime(2026, 11, 22) - datetime(1984, 1, 1)).days, 0]
    low, high = words(memory, 138, 139)
    assert high << 16 | low == ((16 * 60 + 59) * 60 + 58) * 1000, "milliseconds of the day"
    assert words(memory, 0) == [1], "RUN"
    system.update(SECOND // 2 - 1)
    assert words(memory, 55) == [0x5859]
    system.update(SECOND // 2)
    assert words(memory, 55) == [0x5959]
    system.update(9 * 3600 * SECOND)
    assert words(memory, 53, 54, 55, 137) == [0x1126, 0x0123, 0x5859, 1]


def test_words_that_are_not_waited_for_wake_nobody() -> None:
    _, system = masterlogic(datetime(2026, 11, 22))
    system.start(0)
    system.update(SECOND)
    assert system.next_change(SECOND) == NEVER
    system.wait_for([("F", 55 * 16)])
    assert system.next_change(SECOND) == 2 * SECOND


def test_run_and_devices_show_the_time_to_whoever_reads(tmp_path: Path) -> None:
    clock = VirtualClock()
    service = RunService(load_run(run_of(tmp_path)), clock)
    service.start()
    clock.run_for(62 * SECOND)
    service.refresh()
    assert words(service.memory, 53, 54, 55, 56) == [0x0100, 0x0001, 0x0201, 0x2006], "1 January 2000 was a Saturday"
    store = service.devices[0].store
    store.refresh()
    assert words(store.memory, 54, 55) == [0x0001, 0x0201]
    assert service.status()[0].done >= 60, "a trigger sees every second"


@pytest.mark.parametrize(
    ("parts", "problem"),
    [
        ("[minute, sekond]", "sekond"),
        ("[minute, days]", "'days' takes a whole word"),
        ("[minute, hour, day]", "a word has two bytes"),
    ],
)
def test_parts_that_cannot_be_are_told(tmp_path: Path, parts: str, problem: str) -> None:
    with pytest.raises(DefinitionError, match=problem):
        load_run(run_of(tmp_path, f"{{profile: masterlogic, calendar: {{F0060: {parts}}}}}"))
