"""A line on which a client hears its own requests: they are no replies, and the client says what to set."""

from __future__ import annotations

from typing import Any

import pytest

from framekit.definition.load.protocol import load_protocol
from framekit.definition.times import parse_format
from framekit.link.services.client import TransferResult
from framekit.runfile.devices import Device, memory_of
from framekit.service.client import ClientService
from framekit.service.device import DeviceService
from framekit.transport.clock import VirtualClock
from framekit.transport.simulated_line import SimulatedLine
from framekit.transport.wiring import EchoFreePort

SECOND = 1_000_000_000
CAUSE = "you hear your own request: set `echo: yes`"
LINES = {
    "modbus-rtu": ("8E1", "40001"),
    "modbus-ascii": ("7E1", "40001"),
    "ge-rtu": ("8E1", "40001"),
    "mldp": ("8N1", "D100"),
}


class EchoWorld:
    """A client on a line with an echo; `device`: its station 3 is there."""

    def __init__(self, name: str, *, echo: bool = True, device: bool = False) -> None:
        format_, self.place = LINES[name]
        self.clock = VirtualClock()
        settings = parse_format(format_, 19200)
        line = SimulatedLine(self.clock, settings, echo=echo)
        protocol = load_protocol(name)
        if device:
            areas, grammar = memory_of(protocol)
            model = Device(
                name="device", protocol=protocol, role="server", own=3, params={}, areas=areas, grammar=grammar,
                profile=None, mapping={}, initial=(),
            )  # fmt: skip
            port = EchoFreePort(line.port("device"), self.clock) if echo else line.port("device")
            self.device = DeviceService(model, port, self.clock, settings)
            self.device.start()
        self.service = ClientService(protocol, line.port("client"), self.clock, role="client", line=settings)
        self.service.start()
        self.clock.run_for(SECOND)

    def result(self, what: str, **more: Any) -> TransferResult:
        found: list[TransferResult] = []
        self.service.request(
            lambda client, now, done: getattr(client, what)(self.place, station=3, now=now, on_done=done, **more),
            found.append,
        )
        self.clock.run_for(60 * SECOND)
        assert len(found) == 1
        return found[0]


@pytest.mark.parametrize("name", LINES)
def test_without_a_device_a_read_names_the_cause(name: str) -> None:
    found = EchoWorld(name).result("read")
    assert (found.ok, found.outcome, found.cause) == (False, "no_reply", CAUSE)


@pytest.mark.parametrize("name", LINES)
def test_the_reply_after_the_echo_is_taken(name: str) -> None:
    world = EchoWorld(name, device=True)
    assert world.result("read").values == [0]


@pytest.mark.parametrize("name", LINES)
def test_a_reply_that_equals_its_request_is_a_reply_where_no_echo_is(name: str) -> None:
    world = EchoWorld(name, echo=False, device=True)
    found = world.result("write", values=[5])
    assert found.ok and world.service.engine.counters.not_taken == 0
    assert not EchoWorld(name, echo=False).result("write", values=[5]).ok
