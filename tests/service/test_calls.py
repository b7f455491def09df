"""CALL blocks: arguments from the own memory, results stored in it, with simulated devices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from framekit.memory.memory import DeviceMemory
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
PLC = """device: plc
protocol: snp
station: 33101A
memory: {set: {R1: [1, 2, 3, 4]}}
"""
SNET = """device: snet
protocol: mldp
station: 2
memory: {set: {M100: [0x1234, 0x5678, 0x9ABC], M200: 5}}
"""
MOMENT: dict[str, int] = {"second": 1, "minute": 2, "hour": 3, "day": 4, "month": 5, "year": 6}
FAULT: dict[str, Any] = {"rack": 0, "slot": 3, "unit": 0, "group": 6, "action": 2, "code": 99, **MOMENT}


class World:
    """A run with one device, on virtual time."""

    def __init__(self, folder: Path, device: str, blocks: str, sets: str = "", channel: str = "") -> None:
        (folder / "there.device.yaml").write_text(device)
        name, protocol, station = (line.split(": ")[1] for line in device.splitlines()[:3])
        text = f"run: calls\nmemory: masterlogic\n{sets}channels:\n"
        port = f'"sim:there.device.yaml", protocol: {protocol}, station: {station}{channel}'
        text += f"  1: {{port: {port}}}\nblocks:\n"
        text += "".join(f"  {line}\n" for line in blocks.strip().splitlines())
        path = folder / "calls.run.yaml"
        path.write_text(text)
        self.clock = VirtualClock()
        self.run = load_run(path)
        self.service = RunService(self.run, self.clock)
        self.device = next(device for device in self.service.devices if device.device.name == name)

    def go(self, seconds: float = 3) -> None:
        if not self.service.running:
            self.service.start()
        self.clock.run_for(round(seconds * SECOND))

    def own(self, area: str, first: int, count: int = 1) -> list[int]:
        memory: DeviceMemory = self.service.memory
        return memory.read(area, "word", first, count)

    def ends(self) -> dict[int, tuple[int, int, str]]:
        """Return done, failed and last error of each block."""
        return {block.id: (block.done, block.failed, str(block.last_failure or "")) for block in self.service.status()}


def test_status_and_clock_of_an_snp_device_reach_the_memory(tmp_path: Path) -> None:
    world = World(
        tmp_path, PLC, """
0: {call: short_status, into: {plc.state: M100, plc.level: M101, status.programs: M102}, every: 10 s, phase: 0 s}
1: {call: get_time, into: {time.hour: M110, time.minute: M111, time.second: "%MB224", time.weekday: M113}, every: 1 s}
2: {call: controller_id, into: {controller.id: M120, controller.major: M124}, once: yes}
""",
    )  # fmt: skip
    scope = world.device.engine.scope
    scope.set("plc_state", 2)
    scope.set("clock", MOMENT | {"year": 2026})
    world.go(2.5)
    assert world.own("M", 100, 2) == [2, scope["level"]]
    hour, minute, second = world.own("M", 110, 3)
    assert (hour, minute) == (3, 2)
    assert second in (2, 3), "the second byte of the word is not touched"
    text = b"".join(word.to_bytes(2, "little") for word in world.own("M", 120, 4))
    assert text.rstrip(b"\0").decode() == scope["cpu_id"], world.ends()
    assert world.own("M", 124) == [scope["cpu_major"]]
    assert all(failed == 0 and done for done, failed, _ in world.ends().values())


def test_a_fault_table_fills_its_room_and_old_faults_go(tmp_path: Path) -> None:
    world = World(
        tmp_path, PLC,
        '0: {call: plc_faults, into: {faults.present: M100, faults.faults.code: M101, "faults.faults[0].slot": M120},'
        " size: {faults.faults.code: 4}, every: 1 s}",
    )  # fmt: skip
    scope = world.device.engine.scope
    scope.set("plc_faults", [FAULT, {**FAULT, "code": 7}])
    world.service.memory.write("M", "word", 101, [0xFFFF] * 5)
    world.go(1.9)
    assert world.own("M", 100, 6) == [2, 99, 7, 0, 0, 0xFFFF]
    assert world.own("M", 120) == [3]
    scope.set("plc_faults", [FAULT])
    world.go(1)
    assert world.own("M", 100, 6) == [1, 99, 0, 0, 0, 0xFFFF]


def test_more_than_there_is_room_for_stores_nothing(tmp_path: Path) -> None:
    world = World(
        tmp_path, PLC,
        "0: {call: plc_faults, into: {faults.present: M100, faults.faults.code: M101},"
        " size: {faults.faults.code: 1}, every: 1 s}",
    )  # fmt: skip
    world.device.engine.scope.set("plc_faults", [FAULT, FAULT])
    world.go(1.9)
    assert world.own("M", 100, 2) == [0, 0]
    assert world.ends()[0] == (0, 1, "cannot_store: 'faults.faults.code' has 2 elements, and there is room for 1")


def test_a_result_that_is_not_there_stores_nothing(tmp_path: Path) -> None:
    world = World(
        tmp_path, PLC,
        '0: {call: plc_faults, into: {faults.present: M100, "faults.faults[1].code": M101}, every: 1 s}',
    )  # fmt: skip
    world.device.engine.scope.set("plc_faults", [FAULT])
    world.go(1.9)
    assert world.own("M", 100, 2) == [0, 0]
    assert world.ends()[0] == (0, 1, "cannot_store: the call gave no 'faults.faults[1].code'")


def test_arguments_come_from_the_memory_as_it_is_at_each_start(tmp_path: Path) -> None:
    world = World(
        tmp_path, PLC, """
0: {call: set_id, from: {id: M100}, size: {id: 6}, every: 1 s}
1: {call: set_time, with: {mode: time}, from: {hour: M110, minute: M111, second: "%MB224"}, every: 1 s}
2: {call: set_state, from: {state: M120}, every: 1 s}
""",
    )  # fmt: skip
    memory = world.service.memory
    world.go(1.5)
    world.device.engine.scope.set("level", 4)
    world.device.engine.scope.set("programmer", 1)
    memory.write_bytes("M", 200, b"AB12")
    memory.write("M", "word", 110, [13, 14, 15])
    memory.write("M", "word", 120, [2])
    world.go(1.5)
    scope = world.device.engine.scope
    assert scope["cpu_id"] == "AB12"
    assert (scope["clock"]["hour"], scope["clock"]["minute"]) == (13, 14)
    assert scope["plc_state"] == 2
    memory.write("M", "word", 120, [6])
    world.go(1)
    assert scope["plc_state"] == 6


def test_an_argument_that_does_not_fit_is_not_sent(tmp_path: Path) -> None:
    world = World(tmp_path, SNET, "0: {call: run_monitor, from: {register: M10}, into: {values: M11}, "
                  "size: {values: 1}, every: 1 s}")  # fmt: skip
    world.service.memory.write("M", "word", 10, [32])
    world.go(1.5)
    assert world.ends()[0] == (0, 1, "cannot_send: 'run_monitor': argument 'register': 32 is not in 0..31")


@pytest.mark.parametrize("channel", ["", ", params: {max_bytes: 4}"])
def test_monitors_are_registered_and_run_by_blocks(tmp_path: Path, channel: str) -> None:
    world = World(
        tmp_path, SNET, """
0: {call: register_monitor, with: {register: 5}, addresses: ["%MW100", "%MW200"], once: yes}
1: {call: run_monitor, with: {register: 5}, into: {values: P100}, size: {values: 2}, every: 1 s}
2: {call: register_monitor, with: {register: 6}, addresses: "%MW101", count: 2, once: yes}
3: {call: run_monitor, with: {register: 6}, into: {values: P110}, size: {values: 3}, every: 1 s}
4: {call: register_monitor, with: {register: 7}, addresses: ["%MX1602", "%MX1603"], once: yes}
5: {call: run_monitor, with: {register: 7}, into: {values: P00005}, size: {values: 2}, every: 1 s}
6: {call: register_monitor, with: {register: 8}, addresses: "%MD50", once: yes}
7: {call: run_monitor, with: {register: 8}, into: {values: "%PD60"}, size: {values: 1}, every: 1 s}
""",
        channel=channel,
    )  # fmt: skip
    world.service.memory.write("P", "word", 112, [0xFFFF])
    world.go(2.9)
    assert world.own("P", 100, 2) == [0x1234, 5]
    assert world.own("P", 110, 3) == [0x5678, 0x9ABC, 0]
    assert world.own("P", 0) == [0b01 << 5], "bits 2 and 3 of 1234"
    assert world.own("P", 120, 2) == [0x1234, 0x5678]
    assert all(failed == 0 and done for done, failed, _ in world.ends().values())
