"""A line on which a client receives its own requests: they are not replies, and the error message gives the setting."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.times import parse_format
from framekit.link.own_echo import UNPROVED
from framekit.link.services.client import ServiceClient, Transfer, TransferResult
from framekit.runfile.devices import Device, memory_of
from framekit.runfile.run_file import load_run
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
EQUAL = ("modbus-rtu", "modbus-ascii", "ge-rtu")
"""The reply to a write of one register equals the request."""


WRITES_ONLY = """
protocol: writes-only
extends: standard
about: A device that only takes commands, and acknowledges each with its bytes.
groups:
  request: {from: client, head: [{const: STX}, {field: code, type: u8}], tail: [{check: crc16-modbus}]}
  reply: {from: server, head: [{const: STX}, {field: code, type: u8}], tail: [{check: crc16-modbus}], echo: [code]}
frames:
  switch: {group: request, where: {code: 2}, body: [{field: value, type: u8}]}
  switched: {group: reply, where: {code: 2}, body: [{field: value, type: u8}]}
services:
  switch:
    - {takes: {value: {type: number}}, request: {switch: {value: value}}, reply: {switched: {value: value}}}
"""


class EchoWorld:
    """A client on a line with an echo; with `device`, station 3 is present."""

    def __init__(self, name: str, *, echo: bool = True, device: bool = False, exact: bool = True) -> None:
        format_, self.place = LINES.get(name, ("8E1", "P52"))
        self.clock = VirtualClock()
        settings = parse_format(format_, 19200)
        line = SimulatedLine(self.clock, settings, echo=echo)
        protocol = load_protocol_text(WRITES_ONLY, name) if name == "writes-only" else load_protocol(name)
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
        if not exact:  # an adapter may report an echo late
            self.service.engine.examine_replies(has_exact_times=False)
        self.service.start()
        self.clock.run_for(SECOND)

    def result(self, method: str, **more: Any) -> TransferResult:
        return self.end_of(lambda client: partial(getattr(client, method), self.place, **more))

    def called(self, service: str, **arguments: Any) -> TransferResult:
        return self.end_of(lambda client: partial(client.call, service, arguments))

    def end_of(self, method: Callable[[ServiceClient], Callable[..., Transfer]]) -> TransferResult:
        found: list[TransferResult] = []
        self.service.request(lambda client, now, done: method(client)(station=3, now=now, on_done=done), found.append)
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


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("name", LINES)
def test_without_a_device_nothing_is_written(name: str, exact: bool) -> None:
    found = EchoWorld(name, exact=exact).result("write", values=[5])
    assert (found.ok, found.outcome, found.cause) == (False, "no_reply", CAUSE)


@pytest.mark.parametrize("exact", [True, False])
def test_the_rows_of_uss_take_no_echo_of_a_read_of_zero(exact: bool) -> None:
    assert not EchoWorld("uss", exact=exact).result("read").ok
    assert not EchoWorld("uss", exact=exact).result("write", values=[0]).ok


@pytest.mark.parametrize("name", EQUAL)
def test_a_reply_equal_to_its_request_is_proved_once_by_a_read(name: str) -> None:
    """Needed until another reply has shown that the line has no echo."""
    world = EchoWorld(name, echo=False, device=True, exact=False)
    received = world.service.engine.counters
    assert world.result("write", values=[5]).ok and received.received == 2
    assert world.result("write", values=[6]).ok and received.received == 3
    assert world.result("read").values == [6]


@pytest.mark.parametrize("name", EQUAL)
def test_after_a_read_has_shown_the_echo_a_write_waits_for_the_second_copy(name: str) -> None:
    world = EchoWorld(name, device=True, exact=False)
    assert world.result("read").values == [0]
    assert world.result("write", values=[5]).ok
    assert world.result("read").values == [5]
    world.device.stop()
    found = world.result("write", values=[6])
    assert (found.ok, found.outcome, found.cause) == (False, "no_reply", CAUSE)


@pytest.mark.parametrize("name", EQUAL)
def test_on_a_line_with_exact_times_the_echo_begins_before_the_request_has_left(name: str) -> None:
    world = EchoWorld(name, device=True)
    assert world.result("write", values=[5]).ok and world.result("read").values == [5]


@pytest.mark.parametrize(("echo", "device"), [(True, False), (False, True)])
def test_a_reply_that_no_read_can_prove_is_not_believed(echo: bool, device: bool) -> None:
    world = EchoWorld("writes-only", echo=echo, device=device, exact=False)
    found = world.called("switch", value=7)
    assert (found.ok, found.outcome, found.cause) == (False, "no_reply", UNPROVED)


@pytest.mark.parametrize(
    ("wiring", "suspects"),
    [("", True), ("echo: no, ", False), ("echo: yes, ", False), ("type: rs232, ", False), ("type: rs485, ", True)],
)
def test_the_wiring_says_that_a_port_has_no_echo(wiring: str, suspects: bool, tmp_path: Path) -> None:
    path = tmp_path / "r.run.yaml"
    path.write_text(
        "run: r\nmemory: masterlogic\nchannels:\n"
        f"  1: {{{wiring}port: /dev/ttyUSB0, protocol: modbus-rtu, station: 3}}\nblocks: {{}}\n"
    )
    (channel,) = load_run(path).channels.values()
    assert channel.wiring.may_hear_itself == suspects
