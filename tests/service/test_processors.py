"""The processors of examples/df1 served and queried: each family by its own commands, three of them on one line."""

from __future__ import annotations

from pathlib import Path

import pytest

import framekit
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

FOLDER = Path(__file__).parents[2] / "examples" / "df1"


def test_the_run_beside_them() -> None:
    clock = VirtualClock()
    service = RunService(load_run(FOLDER / "df1.run.yaml"), clock)
    service.start()
    clock.run_for(3_500_000_000)
    for state in service.states.values():
        assert (state.failed, state.overruns) == (0, 0), str(state.last_failure)
        assert state.done >= 1
    words = {100: [100, 200, 300, 65136], 110: [0, 0x42C8, 0, 0xC120], 130: [5, 6, 7], 140: [11, 22, 33], 150: [44]}
    for base, expected in words.items():
        assert service.memory.read("M", "word", base, len(expected)) == expected
    devices = {device.device.name: device.memory for device in service.devices}
    assert devices["slc"].read("file10", "word", 10, 4) == [1, 2, 3, 4]
    assert devices["slc"].read("file3", "bit", 16, 8) == [0, 0, 0, 0, 0, 1, 1, 0], "one bit set, its neighbour kept"
    assert devices["plc-5"].read("file10", "word", 0, 4) == [1, 2, 3, 4]
    assert devices["slc-slave 2"].read("file7", "word", 10, 4) == [1, 2, 3, 4]
    service.stop()


@pytest.mark.parametrize(
    ("name", "role", "station", "settings", "read", "expected"),
    [
        ("slc", "full", 1, {"check_kind": "bcc"}, "T4:0.PRE", [500]),
        ("micrologix", "full", 1, {"processor": "micrologix"}, "L10:0", [100000]),
        ("plc-2", "full", 9, {"processor": "plc2"}, "020", [0x1111, 0x2222]),
    ],
)
def test_one_command_serves_it(
    name: str, role: str, station: int, settings: dict[str, str], read: str, expected: list[int]
) -> None:
    file = FOLDER / f"{name}.device.yaml"
    check = {key: value for key, value in settings.items() if key == "check_kind"}
    with (
        framekit.serve(file, "pty:", params=check) as device,
        framekit.connect("df1", device.port, station=station, role=role, params=settings) as client,
    ):
        assert client.read(read, len(expected)) == expected
        client.write(read, [value + 1 for value in expected])
        assert device.memory.read(read, len(expected)) == [value + 1 for value in expected]


def test_the_same_file_as_a_half_duplex_slave() -> None:
    with (
        framekit.serve(FOLDER / "slc.device.yaml", "pty:", role="slave", station=[3, 16]) as devices,
        framekit.connect("df1", devices.port, station=16, role="master", params={"normal_nodes": [3, 16]}) as client,
    ):
        assert client.read("N10:0", 3) == [1, 2, 3]
        client.write("N10:0", 9)
        assert (devices.memory_of(3)["N10:0"], devices.memory_of(16)["N10:0"]) == (1, 9)
