"""A trial in the editor: a request to the simulated device of a protocol, and a run on simulated lines."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from extras.web.edit_world import answer_of, session_of, written

DEVICE = "device: meter\nprotocol: modbus-rtu\nstation: 3\nmemory: {set: {'40001': [7, 8]}}\n"
RUN = """run: plant
memory: masterlogic
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-rtu, station: 3}
blocks:
  0: {read: "40001", count: 2, into: MW0, every: 1 s}
  1: {read: "40001", station: 9, into: MW0, after: 1 s}
sinks: [{csv: values.csv}]
state: plant.state
points: {level: {channel: 1, address: "40001"}}
"""


def trial_of(path: Path, **given: str) -> dict[str, Any]:
    return answer_of("trial", path, **{"service": "read", "address": "", "values": "", "station": "", **given})


@pytest.fixture
def device(tmp_path: Path) -> Path:
    return written(tmp_path, DEVICE, "meter.device.yaml")


def test_a_read_shows_both_frames_and_the_values(device: Path) -> None:
    offer = answer_of("offer", device)
    assert (offer["address"], offer["station"]) == ("00001", "3")
    assert "read" in [name for name, _ in offer["services"]]
    found = trial_of(device, address="40001")
    assert found["result"] == "Done · values 7"
    request, reply = found["frames"]
    assert (request[1:4], reply[1:3]) == (["out", "read_holding", "03030000000185e8"], ["in", "read_holding_reply"])
    assert "read_holding_reply" in [row[3] for row in reply[4]]
    assert float(reply[0]) > float(request[0]) >= 0


def test_a_write_changes_the_memory_of_this_trial_only(device: Path) -> None:
    assert trial_of(device, service="write", address="40001", values="5 0x10")["result"] == "Done"
    assert trial_of(device, address="40001")["result"] == "Done · values 7"


def test_silence_is_a_result(device: Path) -> None:
    found = trial_of(device, address="40001", station="5")
    assert "no_reply" in found["result"]
    assert [frame[1] for frame in found["frames"]] == ["out"] * len(found["frames"])


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"address": "nowhere"}, "is not an address"),
        ({"service": "none"}, "no service 'none'"),
        ({"service": "write", "address": "40001", "values": "x"}, "'x' is not a whole number"),
        ({"service": "identify", "values": "x"}, "is not NAME=VALUE"),
        ({"address": "40001", "station": "x"}, "station"),
    ],
)
def test_an_impossible_request_says_why(device: Path, given: dict[str, str], why: str) -> None:
    assert why in trial_of(device, **given)["why"]


def test_a_protocol_is_tried_as_its_text_says(tmp_path: Path) -> None:
    path = written(tmp_path, "protocol: mine\nextends: modbus-tcp\n", "mine.yaml")
    assert trial_of(path, address="40001", station="1")["result"] == "Done · values 0"
    given = {"service": "read", "address": "40001", "values": "", "station": ""}
    found = answer_of("trial", path, "protocol: mine\nextends: modbus-tcp\nfrmaes: {}\n", **given)
    assert "unknown key 'frmaes'" in found["why"]


def test_a_run_is_tried_without_its_sinks_and_its_state(device: Path, tmp_path: Path) -> None:
    run = written(tmp_path, RUN, "plant.run.yaml")
    assert answer_of("offer", run) == {"services": [], "run": "5 s"}
    found = trial_of(run)
    assert "exchanges done, failed: " in found["result"]
    assert {frame[1] for frame in found["frames"]} == {"in", "out"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["meter.device.yaml", "plant.run.yaml"]


def test_a_run_with_a_real_port_is_not_tried(device: Path, tmp_path: Path) -> None:
    real = RUN.replace("sim:meter.device.yaml", "tcp://127.0.0.1:9").replace("modbus-rtu", "modbus-tcp")
    assert "real port" in trial_of(written(tmp_path, real, "plant.run.yaml"))["why"]


def test_a_file_without_services_says_so(tmp_path: Path) -> None:
    path = written(tmp_path)
    assert "no services" in answer_of("offer", path)["why"]
    points = written(tmp_path, "points: a\nvalues: {x: {address: M1}}\n", "a.points.yaml")
    assert "name a protocol or a device file" in answer_of("offer", points)["why"]


def test_a_browser_tries(device: Path) -> None:
    messages: list[dict[str, Any]] = [
        {"open": device.name}, {"offer": True}, {"try": "read", "address": "40002", "values": "", "station": "3"}
    ]  # fmt: skip

    async def every() -> list[dict[str, Any]]:
        session = session_of(device)
        try:
            return [await session.answer(message) or {} for message in messages]
        finally:
            await session.board.workers.close()

    _, offer, found = asyncio.run(every())
    assert offer["offer"] is True and offer["station"] == "3"
    assert (found["try"], found["result"]) == ("read", "Done · values 8")
