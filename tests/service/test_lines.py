"""Lines of runs and clients: RS-485 with an echo, time-outs, remote ports and UDP with real peers."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import serial
import serial.rfc2217
from transport.real_world import opened
from transport.real_world import run as run_real

import framekit
from framekit.definition.load.protocol import load_protocol
from framekit.definition.times import PLAIN, Direction, LineFormat, LineSettings
from framekit.link.events import Seen
from framekit.runfile.devices import load_devices
from framekit.runfile.run_file import load_run
from framekit.service.device import DeviceService
from framekit.service.run import RunService
from framekit.transport import clock as clock_module
from framekit.transport.clock import AsyncioClock, VirtualClock
from framekit.transport.network import TcpListener, UdpPort
from framekit.transport.port import AcceptedPort
from framekit.transport.pty_port import PtyPair
from framekit.transport.schemes import open_port
from framekit.transport.wiring import EchoFreePort

SECOND = 1_000_000_000

RS485 = """
run: two-wires
memory: masterlogic
channels:
  1: {{port: "sim:one.device.yaml,two.device.yaml", protocol: modbus-rtu, type: rs485{more}}}
blocks:
  0: {{station: 1, read: "40001", count: 4, into: M0, every: 100 ms}}
  1: {{station: 2, write: "40001", values: [5], every: 100 ms, phase: 50 ms}}
"""
DEVICE = "device: {name}\nprotocol: modbus-rtu\nstation: {station}\nmemory: {{set: {{40001: [7, 8, 9, 10]}}}}\n"


def rs485(folder: Path, more: str = "") -> RunService:
    for station, name in enumerate(("one", "two"), 1):
        (folder / f"{name}.device.yaml").write_text(DEVICE.format(name=name, station=station), "utf-8")
    (folder / "x.run.yaml").write_text(RS485.format(more=more), "utf-8")
    clock = VirtualClock()
    service = RunService(load_run(folder / "x.run.yaml"), clock)
    service.start()
    clock.run_for(20 * SECOND)
    return service


# ---- on the simulated line ----------------------------------------------------------------------------------


def test_half_duplex_with_an_echo_that_is_taken_away(tmp_path: Path) -> None:
    service = rs485(tmp_path, ", echo: yes, direction: {by: rts, before: 1 ms, after: 1 ms}")
    for state in service.states.values():
        assert (state.done, state.failed) == (200 if state.block.number else 199, 0) or (
            state.done >= 199 and state.failed == 0
        )
    port = service.channels[1].driver.port
    assert isinstance(port, EchoFreePort)
    assert port.removed >= 8 * 399 and port.damaged == port.missing == 0
    assert service.channels[1].engine.counters.noise_bytes == 0
    assert service.memory.read("M", "word", 0, 4) == [7, 8, 9, 10]


def test_a_half_duplex_line_is_half_duplex(tmp_path: Path) -> None:
    service = rs485(tmp_path)
    assert not service.devices[0].driver.port.line.full_duplex  # type: ignore[attr-defined]
    full = rs485(tmp_path, ", duplex: full")
    assert full.devices[0].driver.port.line.full_duplex  # type: ignore[attr-defined]
    assert all(state.failed == 0 for state in service.states.values())


def test_faults_of_a_line_in_a_run(tmp_path: Path) -> None:
    faults = "faults: {rules: [{fault: echo}, {fault: no_reply, every: 7}, {fault: wrong_check, every: 10}]}"
    service = rs485(tmp_path, f", echo: yes, params: {{reply_timeout: 20 ms}}, {faults}")
    injected = [device.faults.injected for device in service.devices if device.faults is not None]
    assert len(injected) == 2 and all(counts["wrong_check"] > 8 and counts["no_reply"] > 15 for counts in injected)
    counters = service.channels[1].engine.counters
    assert counters.bad == sum(counts["wrong_check"] for counts in injected)
    assert all(state.failed == 0 for state in service.states.values()), "repeats make up for all of it"


def test_times_of_a_channel(tmp_path: Path) -> None:
    service = rs485(tmp_path, ", reply_timeout: 30 ms, byte_timeout: 4 ms")
    scope = service.channels[1].engine.scope
    assert (scope["reply_timeout"], scope["byte_timeout"]) == (30_000_000, 4_000_000)
    usual = rs485(tmp_path, ", speed: 300").channels[1].engine.scope
    characters = 20 * usual.line.chars(1)
    assert abs(usual["byte_timeout"] - characters - 50_000_000) < 1000, "worked out from speed and format"


LONG = """
protocol: long
extends: standard
line: {speed: {default: 2400}, format: {default: 8E1}}
groups: {request: {from: client}}
frames:
  ask:  {group: request, body: [{const: ENQ}]}
  back: {from: server, body: [{const: STX}, {data: d, size: 60, pad: 00}, {const: ETX}]}
params: {block: {type: bytes, default: 00}}
services:
  get: [{request: {ask: {}}, reply: {back: {d: block}}, gives: {d: reply.d}}]
"""
LONG_RUN = """
run: long
memory: masterlogic
channels: {1: {port: "sim:long.device.yaml", protocol: long, params: {reply_timeout: 100 ms}}}
blocks: {0: {call: get, once: yes}}
"""


class HandMadeLoop:
    """A loop whose time the test sets; its timers fire with a delay that the test sets."""

    def __init__(self, late: int) -> None:
        self.now = 0
        self.late = late
        self.soon: list[Callable[[], None]] = []
        self.timers: list[tuple[int, asyncio.TimerHandle]] = []

    def call_soon(self, call: Callable[[], None]) -> None:
        self.soon.append(call)

    def call_later(self, delay: float, call: Callable[[], None]) -> asyncio.TimerHandle:
        when = self.now + round(delay * 1e9)
        handle = asyncio.TimerHandle(when, call, (), self)  # type: ignore[arg-type]
        self.timers.append((when, handle))
        return handle

    def get_debug(self) -> bool:
        return False

    def _timer_handle_cancelled(self, handle: asyncio.TimerHandle) -> None: ...

    def run_until(self, time: int) -> None:
        while self.soon or self.timers:
            while self.soon:
                self.soon.pop(0)()
            self.timers.sort(key=lambda timer: timer[0])
            when, handle = self.timers.pop(0)
            if when > time:
                return
            if not handle.cancelled():
                self.now = max(self.now, when) + self.late
                handle._run()


@pytest.mark.parametrize("late", [0, 3_000_000, 30_000_000])
def test_in_real_time_too_no_time_ends_while_the_frame_that_should_stop_it_arrives(
    late: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reply takes 284 ms on the line; a reply time of 100 ms ends with the first character."""
    (tmp_path / "long.yaml").write_text(LONG, "utf-8")
    (tmp_path / "long.device.yaml").write_text("device: d\nprotocol: long\n", "utf-8")
    (tmp_path / "x.run.yaml").write_text(LONG_RUN, "utf-8")
    loop = HandMadeLoop(late)
    monkeypatch.setattr(AsyncioClock, "now", lambda clock: loop.now)
    monkeypatch.setattr(clock_module, "time", SimpleNamespace(monotonic_ns=lambda: loop.now))
    seen: list[Seen] = []
    service = RunService(load_run(tmp_path / "x.run.yaml"), AsyncioClock(loop), lambda channel, one: seen.append(one))  # type: ignore[arg-type]
    service.start()
    loop.run_until(2 * SECOND)
    assert [event.frame for event in seen if event.kind == "frame"] == ["ask", "back"]
    assert service.states[0].done == 1


# ---- remote ports -------------------------------------------------------------------------------------------


class TerminalDevice(serial.Serial):  # type: ignore[misc]  # it has no types
    """A pseudo-terminal for programs that need modem lines."""

    cts = dsr = ri = cd = property(lambda self: True)

    def _update_rts_state(self) -> None:
        return

    def _update_dtr_state(self) -> None:
        return

    def _update_break_state(self) -> None:
        return


@contextmanager
def rfc2217_server(path: str) -> Iterator[tuple[int, list[Any]]]:
    """Run a server of pyserial's library for one connection, with the device at `path`; record its settings."""
    device = TerminalDevice(path, timeout=0.01)
    noted: list[Any] = []
    stop = threading.Event()
    listening = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with suppress(OSError):
            connection, _ = listening.accept()
            with connection:
                carry(connection)

    def carry(connection: socket.socket) -> None:
        connection.settimeout(0.01)
        lock = threading.Lock()

        class Sender:
            def write(self, data: bytes) -> None:
                with lock:
                    connection.sendall(data)

        manager = serial.rfc2217.PortManager(device, Sender())
        while not stop.is_set():
            with suppress(TimeoutError):
                data = connection.recv(1024)
                if not data:
                    return
                device.write(b"".join(manager.filter(data)))
            if waiting := device.read(max(1, device.in_waiting)):
                connection.sendall(b"".join(manager.escape(waiting)))
            noted[:] = [device.baudrate, device.parity]

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listening.getsockname()[1], noted
    finally:
        stop.set()
        listening.close()
        thread.join(10)
        device.close()


def test_a_client_through_an_rfc2217_server() -> None:
    with (
        PtyPair() as wires,
        framekit.serve("mldp", wires.first, station=1, initial={"D100": 0xFF41}),
        rfc2217_server(wires.second) as (number, noted),
    ):
        with framekit.connect("mldp", f"rfc2217://127.0.0.1:{number}", station=1, speed=19200) as client:
            assert client.read("D100").values == (0xFF41,)
            client.write("D101", [0xFFFF, 0x1111])
            assert client.read("D100", count=3).values == (0xFF41, 0xFFFF, 0x1111)
        assert noted == [19200, "N"], "the speed reaches the port at the far end"


def test_udp_on_both_sides() -> None:
    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        far_port = UdpPort("127.0.0.1", 0, clock, listens=True)
        hears = await opened(far_port)
        here = open_port(f"udp://127.0.0.1:{far_port.number}", None, clock)
        events = await opened(here)
        far_port.write(b"nobody has asked yet")
        await hears.until("sent")
        here.write(b"ask")
        assert await hears.bytes(3) == b"ask"
        far_port.write(b"answer")
        assert await events.bytes(6) == b"answer"
        other = open_port(f"udp://127.0.0.1:{far_port.number}", None, clock)
        others = await opened(other)
        other.write(b"me too")
        assert await hears.bytes(6) == b"me too"
        assert hears.seen.count("other sender") == 1
        far_port.write(b"only you")
        assert await others.bytes(8) == b"only you"
        assert events.seen.count("received") == 1, "the answer went to the one who asked last"
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        place = here._endpoint.transport.get_extra_info("sockname")  # type: ignore[attr-defined]
        stranger.sendto(b"from a stranger", place)
        stranger.close()
        here.write(b"ask")
        assert await hears.bytes(3) == b"ask"
        far_port.write(b"answer")
        assert await events.bytes(6) == b"answer", "what a stranger sends is not taken"
        taken = UdpPort("127.0.0.1", far_port.number, clock, listens=True)
        refused = type(hears)()
        taken.open(refused)
        assert "cannot listen" in await refused.until("closed")
        for port in (here, far_port, other):
            port.close()

    run_real(check())


def test_datagrams_of_two_senders_on_one_port_make_no_frame_together() -> None:
    ask = bytes.fromhex("01 03 0000 0003 05CB")

    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        [device] = load_devices("modbus-rtu", Path.cwd())
        far_port, states = UdpPort("127.0.0.1", 0, clock, listens=True), asyncio.Queue[str]()
        service = DeviceService(device, far_port, clock, None, on_state=states.put_nowait)
        service.start()
        assert await states.get() == "open"
        one, other = (open_port(f"udp://127.0.0.1:{far_port.number}", None, clock) for _ in range(2))
        await opened(one)
        answers = await opened(other)
        one.write(ask[:5])
        other.write(ask[5:])
        other.write(ask)
        assert len(await answers.bytes(11)) == 11
        assert service.store.counters.done == 1
        counters = service.engine.counters
        assert (counters.received, counters.bad) == (1, 1) and counters.noise_bytes > 0
        for port in (one, other, far_port):
            port.close()

    run_real(check())


def test_a_client_over_udp() -> None:
    probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    probe.bind(("127.0.0.1", 0))
    number = probe.getsockname()[1]
    probe.close()
    with (
        framekit.serve("modbus-rtu", f"udp-listen://127.0.0.1:{number}", station=3, initial={"40001": 77}),
        framekit.connect("modbus-rtu", f"udp://127.0.0.1:{number}", station=3) as client,
    ):
        assert client.read("40001").values == (77,)


# ---- ports that come and go ---------------------------------------------------------------------------------


def test_an_accepted_connection_is_not_opened_again() -> None:
    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        accepted: asyncio.Queue[AcceptedPort] = asyncio.Queue()
        listener = TcpListener("127.0.0.1", 0, clock, accepted.put_nowait)
        listener.listen()
        client = socket.create_connection(("127.0.0.1", listener.number))
        port = await accepted.get()
        over = asyncio.Event()
        states: list[str] = []

        def state(text: str) -> None:
            states.append(text)
            if text != "open":
                over.set()

        protocol = load_protocol("modbus-tcp")
        device = framekit_device(protocol)
        service = DeviceService(device, port, clock, None, on_state=state)
        service.start()
        client.close()
        await over.wait()
        assert clock.next_call is None, "nothing is to come any more"
        assert states[0] == "open" and len(states) == 2
        listener.stop()

    run_real(check())


def framekit_device(protocol: Any) -> Any:
    from framekit.runfile.devices import Device, memory_of

    areas, grammar = memory_of(protocol)
    return Device(
        name="device", protocol=protocol, role="server", own=1, params={}, areas=areas, grammar=grammar, profile=None,
        mapping={}, initial=(),
    )  # fmt: skip


def test_a_terminal_has_no_driver_that_switches_the_direction() -> None:
    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        with PtyPair() as wires:
            wiring = LineSettings(direction=Direction(by="driver"))
            port = open_port(wires.first, LineFormat(9600), clock, wiring=wiring)
            events = await closed_reason(port)
            assert events.endswith("its driver cannot switch the direction – use direction: rts")
            plain = open_port(wires.first, LineFormat(9600), clock, wiring=LineSettings(direction=Direction()))
            assert plain is not None and wiring != PLAIN
            again = await opened(plain)
            plain.write(b"x")
            await again.until("sent")
            plain.close()

    run_real(check())


async def closed_reason(port: Any) -> str:
    from transport.real_world import Waiting

    events = Waiting()
    port.open(events)
    return str(await events.until("closed"))
