"""A run is edited while a reply is late: the channel that takes the place of another one still waits for it."""

from __future__ import annotations

from pathlib import Path

import pytest
from service.late_world import SECOND, OverlappingPort

from framekit.run.model import Channel
from framekit.runfile.devices import Device
from framekit.runfile.run_file import load_run
from framekit.service import channel as channels
from framekit.service.device import DeviceService, stores_of
from framekit.service.run import RunService
from framekit.transport.clock import Clock, VirtualClock
from framekit.transport.port import Port
from framekit.transport.simulated_line import SimulatedLine

RUN = """\
run: r
memory: masterlogic
dead: no
channels:
  1: {port: "sim:d.device.yaml", protocol: modbus-rtu, station: 3, params: {reply_timeout: TIMEOUT, retries: 0}}
blocks:
  0: {read: "READ", into: INTO, every: 20 s, phase: PHASE}
"""


def test_a_late_reply_is_not_taken_by_the_channel_of_an_edited_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The advice to set a longer reply_timeout is followed while replies are late."""
    clock = VirtualClock()
    ports: list[Port] = []
    devices: list[DeviceService] = []

    def port_for(channel: Channel, found: list[Device], _: Clock) -> tuple[Port, list[DeviceService]]:
        if not ports:
            line = SimulatedLine(clock, channel.line)
            (store,) = stores_of(found, clock, None)
            late = OverlappingPort(line.port("d"), clock, lambda now: 3 * SECOND)
            devices.append(DeviceService(store.device, late, clock, channel.line, store=store))
            devices[0].start()
            ports.append(line.port("channel 1"))
        return ports[0], []

    monkeypatch.setattr(channels, "port_for", port_for)
    (tmp_path / "d.device.yaml").write_text(
        "device: d\nprotocol: modbus-rtu\nstation: 3\nmemory: {set: {40001: [1001, 1002]}}\n"
    )

    def write(timeout: str, read: str, into: str, phase: str) -> Path:
        text = RUN.replace("TIMEOUT", timeout).replace("READ", read).replace("INTO", into).replace("PHASE", phase)
        (tmp_path / "r.run.yaml").write_text(text)
        return tmp_path / "r.run.yaml"

    service = RunService(load_run(write("1 s", "40001", "D1", "0 s")), clock)
    service.start()
    clock.run_until(int(1.5 * SECOND))
    assert service.states[0].failed == 1
    applied: list[object] = []
    service.editor.request(load_run(write("4 s", "40002", "D2", "1 s")), applied.append)
    clock.run_until(int(2.9 * SECOND))
    assert len(applied) == 1 and service.states[0].started == 1, "it began before the late reply came"
    clock.run_until(15 * SECOND)
    assert service.memory.read("D", "word", 1, 2) == [0, 1002]
    assert service.channels[1].engine.counters.late == 1
