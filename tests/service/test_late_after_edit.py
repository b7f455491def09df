"""A channel closes while a reply is late: the next channel on its line waits for the reply, for any channel number."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from service.late_world import SECOND, OverlappingPort

from framekit.run.model import Channel
from framekit.runfile.devices import Device
from framekit.runfile.run_file import load_run
from framekit.service import channel as channels
from framekit.service.device import DeviceService, devices_of, port_for, stores_of
from framekit.service.run import RunService
from framekit.transport.clock import Clock, VirtualClock
from framekit.transport.port import Port
from framekit.transport.simulated_line import SimulatedLine

RUN = """\
run: r
memory: masterlogic
dead: no
channels:
  8: {port: "sim:other.device.yaml", protocol: modbus-rtu, station: 3}
CHANNELSblocks:
BLOCKS  9: {channel: 8, read: "40001", into: D9, every: 20 s}
"""
CHANNEL = """  NUMBER: {port: "sim:d.device.yaml", protocol: PROTOCOL, station: 3ENABLED, params: {PARAMS}}
"""
READ = """  0: {channel: NUMBER, read: "40002", into: D2, every: 20 s, phase: 1 s}
"""


class World:
    """A run whose channel reads 40001 at 0 s from a device that answers after 3 s; the time limit is 1 s.

    The device may be asked on several channels, one after the other.
    """

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, until: int = 3 * SECOND // 2) -> None:
        self.folder, self.clock = folder, VirtualClock()
        self.ports: list[Port] = []
        self.devices: list[DeviceService] = []
        monkeypatch.setattr(channels, "port_for", self.port_for)
        monkeypatch.setattr(channels, "devices_of", self.devices_of)
        for name in ("d", "other"):
            text = f"device: {name}\nprotocol: modbus-rtu\nstation: 3\nmemory: {{set: {{40001: [1001, 1002]}}}}\n"
            (folder / f"{name}.device.yaml").write_text(text)
        (folder / "mine.yaml").write_text("protocol: mine\nextends: modbus-rtu\n")
        first = READ.replace('"40002", into: D2', '"40001", into: D1').replace("phase: 1 s", "phase: 0 s")
        self.service = self.run_of(self.channel(1, "reply_timeout: 1 s, retries: 0"), first.replace("NUMBER", "1"))
        self.service.start()
        self.clock.run_until(until)
        assert self.service.states[0].failed == (until > SECOND)

    def devices_of(self, channel: Channel, folder: Path) -> list[Device]:
        """Return the devices of a line once: a later channel on it may have any protocol."""
        return [] if self.ports and "other" not in channel.port else devices_of(channel, folder)

    def port_for(self, channel: Channel, found: list[Device], clock: Clock) -> tuple[Port, list[DeviceService]]:
        """Return the port of the line with the device, the same for each channel; other lines as they are."""
        if "other" in channel.port:
            return port_for(channel, found, clock)
        if not self.ports:
            line = SimulatedLine(clock, channel.line)
            (store,) = stores_of(found, clock, None)
            late = OverlappingPort(line.port("d"), self.clock, lambda now: 3 * SECOND)
            self.devices.append(DeviceService(store.device, late, clock, channel.line, store=store))
            self.devices[0].start()
            self.ports.append(line.port("channel"))
        return self.ports[0], []

    def channel(
        self, number: int, params: str = "reply_timeout: 4 s", protocol: str = "modbus-rtu", enabled: str = ""
    ) -> str:
        text = CHANNEL.replace("NUMBER", str(number)).replace("PARAMS", params)
        return text.replace("PROTOCOL", protocol).replace("ENABLED", enabled)

    def write(self, channels: str, blocks: str) -> Path:
        path = self.folder / "r.run.yaml"
        path.write_text(RUN.replace("CHANNELS", channels).replace("BLOCKS", blocks))
        return path

    def run_of(self, channels: str, blocks: str, after: RunService | None = None) -> RunService:
        return RunService(load_run(self.write(channels, blocks)), self.clock, after=after)

    def edit(self, channels: str, blocks: str) -> None:
        applied: list[object] = []
        self.service.editor.request(load_run(self.write(channels, blocks)), applied.append)
        self.clock.run_for(SECOND // 10)
        assert len(applied) == 1

    def reads(self, number: int, *, channels: str = "") -> None:
        """Edit the run: this channel reads 40002."""
        self.edit(channels or self.channel(number), READ.replace("NUMBER", str(number)))

    def second(self, until: int) -> list[int]:
        """Let time pass; return the values of 40002 that were stored, without repeats."""
        found: list[int] = []
        while self.clock.now() < until:
            self.clock.run_for(SECOND // 4)
            first, second = self.service.memory.read("D", "word", 1, 2)
            assert first == 0
            if second and found[-1:] != [second]:
                found.append(second)
        return found


def same(world: World) -> None:
    world.reads(1)


def renumbered(world: World) -> None:
    world.reads(2)


def removed_and_added(world: World) -> None:
    world.edit("", "")
    world.reads(2)


def elsewhere_and_back(world: World) -> None:
    other = world.channel(1).replace("d.device.yaml", "other.device.yaml")
    world.edit(other, "")
    world.reads(1)


def another_by_hand(world: World) -> None:
    """Let a second channel of the same line take over, first switched off in the file, then switched on by hand."""
    first = world.channel(1, "reply_timeout: 1 s, retries: 0")
    world.reads(2, channels=first + world.channel(2, enabled=", enabled: no"))
    world.service.enable_channel(1, False)
    world.service.enable_channel(2)


def next_run(world: World) -> None:
    before = world.service
    before.stop()
    world.service = world.run_of(world.channel(4), READ.replace("NUMBER", "4"), before)
    world.service.start()


@pytest.mark.parametrize("change", [same, renumbered, removed_and_added, elsewhere_and_back, another_by_hand, next_run])
def test_a_late_reply_is_not_taken_by_the_next_channel_on_the_line(
    change: Callable[[World], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The advice to set a longer reply_timeout is followed while replies are late."""
    world = World(tmp_path, monkeypatch)
    change(world)
    assert world.second(15 * SECOND) == [1002]
    assert sum(channel.engine.counters.late for channel in world.service.channels.values()) == 1


def test_a_request_under_way_as_the_run_stops_is_late_in_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World(tmp_path, monkeypatch, until=SECOND // 2)
    assert world.service.states[0].running
    next_run(world)
    assert world.second(15 * SECOND) == [1002]


def test_a_reply_that_came_is_awaited_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(tmp_path, monkeypatch)
    same(world)
    world.clock.run_until(15 * SECOND)
    world.edit(world.channel(5), "")
    late = world.service.channels[5].engine.late
    assert late.open == [] and not late.is_over(world.clock.now()), "the lateness of the station is still known"


@pytest.mark.parametrize("protocol", ["mine.yaml", "ge-rtu"])
@pytest.mark.parametrize("number", [1, 2])
def test_a_channel_of_another_protocol_stores_no_reply_to_an_earlier_request(
    number: int, protocol: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their frames may be the same bytes under other names."""
    world = World(tmp_path, monkeypatch)
    world.reads(number, channels=world.channel(number, protocol=protocol))
    assert [request.is_foreign for request in world.service.channels[number].engine.late.open] == [True]
    assert world.second(90 * SECOND) == [1002]
