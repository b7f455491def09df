"""Channels of a run in an answering role serve the run's own memory: several protocols access the same words."""

from __future__ import annotations

import asyncio
import os
import select
import socket
from pathlib import Path

from framekit.api.run import run_status
from framekit.link.events import Seen
from framekit.run.model import ConnectionLimits
from framekit.runfile.run_file import load_run
from framekit.service.device import ListeningPort
from framekit.service.run import RunService
from framekit.transport.clock import AsyncioClock, VirtualClock
from framekit.transport.pty_port import PtyPair

LONGEST = 180
RUN = """
run: serving
memory: masterlogic
channels:
  1: {{port: {first}, protocol: mldp, role: server, own: 1}}
  2: {{port: {second}, protocol: modbus-rtu, role: server, own: 3, map: {{holding: M100, coil: M200}}}}
set: {{M100: [0x1234, 0x5678]}}
blocks: {{}}
"""
MLDP_READ = b"\x0501RSB06%MW10002\x04"


def crc(data: bytes) -> bytes:
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return data + value.to_bytes(2, "little")


def reply_to(path: str, request: bytes, size: int) -> bytes:
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(descriptor, request)
        reply = b""
        while len(reply) < size and select.select([descriptor], [], [], LONGEST)[0]:
            reply += os.read(descriptor, 256)
        return reply
    finally:
        os.close(descriptor)


def test_two_channels_serve_one_memory(tmp_path: Path) -> None:
    async def scenario() -> None:
        with PtyPair() as one, PtyPair() as other:
            path = tmp_path / "serving.run.yaml"
            path.write_text(RUN.format(first=one.first, second=other.first), "utf-8")
            opened = asyncio.Event()
            states: set[int] = set()

            def seen(channel: int, event: object) -> None:
                states.add(channel)
                if states == {1, 2}:
                    opened.set()

            service = RunService(load_run(path), AsyncioClock(asyncio.get_running_loop()), seen)
            service.start()
            try:
                await opened.wait()
                reply = await asyncio.to_thread(reply_to, other.second, crc(bytes.fromhex("03 03 0000 0002")), 9)
                assert reply == crc(bytes.fromhex("03 03 04 1234 5678"))
                written = await asyncio.to_thread(reply_to, other.second, crc(bytes.fromhex("03 06 0001 BEEF")), 8)
                assert written == crc(bytes.fromhex("03 06 0001 BEEF"))
                await asyncio.to_thread(reply_to, other.second, crc(bytes.fromhex("03 05 000A FF00")), 8)
                reply = await asyncio.to_thread(reply_to, one.second, MLDP_READ, 19)
                assert reply == b"\x0601RSB01041234BEEF\x03"
                reply = await asyncio.to_thread(reply_to, one.second, b"\x0501RSS0106%MW200\x04", 15)
                assert reply == b"\x0601RSS01020400\x03", "coil 11 is bit A of M200"
                assert service.memory.read("M", "word", 101) == [0xBEEF]
                await asyncio.to_thread(reply_to, other.second, crc(bytes.fromhex("03 03 FFFF 0002")), 5)
                status = {channel.number: channel for channel in run_status(service).channels}
                assert (status[1].services, status[1].errors) == (2, 0)
                assert (status[2].services, status[2].errors) == (3, 1)
                assert list(status[2].reasons.values()) == [1] and "refused 0x0002" in next(iter(status[2].reasons))
                service.reset()
                assert [(channel.services, channel.errors) for channel in run_status(service).channels] == [
                    (0, 0),
                    (0, 0),
                ]
            finally:
                service.stop()

    asyncio.run(asyncio.wait_for(scenario(), LONGEST))


ECHO = """
protocol: echo
line: {kind: serial, speed: {default: 9600}, format: {default: 8N1}}
frames:
  ASK: {body: [{const: 05}, {field: n, type: u8}]}
  SAY: {body: [{const: 06}, {field: n, type: u8}]}
sequences:
  answer:
    steps:
      - {step: idle, receive: [{frame: ASK, then: say}]}
      - {step: say, send: {SAY: {n: it.n}}, then: end}
roles:
  server: {lanes: {main: {listen: answer}}}
"""
ECHO_RUN = """
run: echo
memory: masterlogic
channels: {1: {port: "sim:echo.device.yaml", protocol: echo, role: server}}
blocks: {}
"""


def test_frames_that_sequences_answer_with_are_counted(tmp_path: Path) -> None:
    (tmp_path / "echo.yaml").write_text(ECHO, "utf-8")
    (tmp_path / "echo.device.yaml").write_text("device: echo\nprotocol: echo\n", "utf-8")
    (tmp_path / "echo.run.yaml").write_text(ECHO_RUN, "utf-8")
    clock = VirtualClock()
    service = RunService(load_run(tmp_path / "echo.run.yaml"), clock)
    service.start()
    for number in range(3):
        clock.run_for(100_000_000)
        service.channels[1].driver.received(bytes([5, number]), clock.now())
    [status] = run_status(service).channels
    assert (status.services, status.errors, status.frames_in) == (3, 0, 3)


LISTENING = """
run: listening
memory: masterlogic
channels:
  1: {port: "tcp-listen://127.0.0.1:0", protocol: modbus-tcp, role: server, own: 1, map: {holding: M100}}
  2: {port: "tcp://127.0.0.1:0", protocol: mldp, role: server, own: 1}
set: {M100: [0x1234, 0x5678]}
blocks: {}
"""
MODBUS_READ = bytes.fromhex("0001 0000 0006 01 03 0000 0002")
MODBUS_REPLY = bytes.fromhex("0001 0000 0007 01 03 04")


async def exchanged(link: tuple[asyncio.StreamReader, asyncio.StreamWriter], request: bytes, size: int) -> bytes:
    link[1].write(request)
    return await link[0].readexactly(size)


def test_a_channel_answers_several_clients_over_tcp(tmp_path: Path) -> None:
    async def scenario() -> None:
        path = tmp_path / "listening.run.yaml"
        path.write_text(LISTENING, "utf-8")
        opened: dict[int, asyncio.Event] = {1: asyncio.Event(), 2: asyncio.Event()}

        clients: list[str] = []

        def seen(channel: int, event: Seen) -> None:
            opened[channel].set()
            if channel == 1 and event.frame:
                clients.append(event.client)

        service = RunService(load_run(path), AsyncioClock(asyncio.get_running_loop()), seen)
        service.start()
        links = []
        try:
            for event in opened.values():
                await event.wait()
            ports = [int(service.channels[number].driver.port.name.rpartition(":")[2]) for number in (1, 2)]
            for port in (ports[0], ports[0], ports[1]):
                links.append(await asyncio.open_connection("127.0.0.1", port))
            one, other, snet = links
            assert await exchanged(one, MODBUS_READ, 13) == MODBUS_REPLY + bytes.fromhex("1234 5678")
            write = bytes.fromhex("0002 0000 0006 01 06 0001 BEEF")
            assert await exchanged(other, write, 12) == write
            assert await exchanged(one, MODBUS_READ, 13) == MODBUS_REPLY + bytes.fromhex("1234 BEEF")
            assert await exchanged(snet, MLDP_READ, 19) == b"\x0601RSB01041234BEEF\x03"
            assert service.memory.read("M", "word", 101) == [0xBEEF]
            status = {channel.number: channel for channel in run_status(service).channels}
            assert (status[1].state, status[1].frames_in, status[1].bytes_in) == ("open", 3, 36)
            assert status[2].frames_in == 1
            names = [f"127.0.0.1:{link[1].get_extra_info('sockname')[1]}" for link in (one, other)]
            assert clients == [names[0]] * 2 + [names[1]] * 2 + [names[0]] * 2
            assert [(channel.services, channel.errors) for channel in status.values()] == [(3, 0), (1, 0)]
        finally:
            for _, writer in links:
                writer.close()
            service.stop()

    asyncio.run(asyncio.wait_for(scenario(), LONGEST))


class Sender(asyncio.DatagramProtocol):
    """A sender of datagrams that records the replies."""

    def __init__(self) -> None:
        self.got: asyncio.Queue[bytes] = asyncio.Queue()

    def datagram_received(self, data: bytes, addr: object) -> None:
        self.got.put_nowait(data)


def test_a_channel_answers_every_sender_of_datagrams_by_itself(tmp_path: Path) -> None:
    async def scenario() -> None:
        path = tmp_path / "listening.run.yaml"
        path.write_text(LISTENING.replace("tcp-listen:", "udp-listen:"), "utf-8")
        loop, opened = asyncio.get_running_loop(), asyncio.Event()
        service = RunService(
            load_run(path), AsyncioClock(loop), lambda channel, seen: opened.set() if channel == 1 else None
        )
        service.start()
        transports = []
        try:
            await opened.wait()
            number = int(service.channels[1].driver.port.name.rpartition(":")[2])
            senders = [Sender(), Sender()]
            for sender in senders:
                made, _ = await loop.create_datagram_endpoint(
                    lambda sender=sender: sender, remote_addr=("127.0.0.1", number)
                )
                transports.append(made)
            one, other = transports
            one.sendto(MODBUS_READ[:8])
            other.sendto(MODBUS_READ)
            one.sendto(MODBUS_READ[8:])
            for sender in senders:
                assert await sender.got.get() == MODBUS_REPLY + bytes.fromhex("1234 5678")
            [status, _] = run_status(service).channels
            assert (status.services, status.errors, status.bad, status.noise_bytes) == (2, 0, 0, 0)
        finally:
            for transport in transports:
                transport.close()
            service.stop()

    asyncio.run(asyncio.wait_for(scenario(), LONGEST))


def test_a_channel_says_how_many_connections_an_address_may_have_and_how_long_they_may_be_idle(tmp_path: Path) -> None:
    async def scenario() -> None:
        path = tmp_path / "listening.run.yaml"
        limited = "map: {holding: M100}, clients: {connections: 1, idle_timeout: 90 s}"
        path.write_text(LISTENING.replace("map: {holding: M100}", limited), "utf-8")
        opened = asyncio.Event()
        service = RunService(
            load_run(path),
            AsyncioClock(asyncio.get_running_loop()),
            lambda channel, seen: opened.set() if channel == 1 else None,
        )
        service.start()
        links = []
        try:
            await opened.wait()
            port = service.channels[1].driver.port
            assert isinstance(port, ListeningPort) and port.serving is not None
            assert port.serving.limits == ConnectionLimits(idle=90_000_000_000, per_address=1)
            number = int(port.name.rpartition(":")[2])
            for _ in range(2):
                links.append(await asyncio.open_connection("127.0.0.1", number))
            one, other = links
            assert await exchanged(one, MODBUS_READ, 13) == MODBUS_REPLY + bytes.fromhex("1234 5678")
            assert await other[0].read() == b"", "one more is closed"
            assert service.channels[1].counters.failed == {"connections refused": 1}
        finally:
            for _, writer in links:
                writer.close()
            service.stop()

    asyncio.run(asyncio.wait_for(scenario(), LONGEST))


def test_a_port_that_is_taken_is_told_and_tried_again(tmp_path: Path) -> None:
    async def scenario() -> None:
        taken = socket.create_server(("127.0.0.1", 0))
        number = taken.getsockname()[1]
        path = tmp_path / "listening.run.yaml"
        path.write_text(LISTENING.replace("tcp-listen://127.0.0.1:0", f"tcp-listen://127.0.0.1:{number}"), "utf-8")
        states: list[str] = []
        opened = asyncio.Event()

        def seen(channel: int, event: Seen) -> None:
            if channel == 1:
                states.append(event.reason)
                taken.close()
                if service.channels[1].state == "open":
                    opened.set()

        service = RunService(load_run(path), AsyncioClock(asyncio.get_running_loop()), seen)
        service.start()
        try:
            await opened.wait()
            assert "Address already in use" in states[0]
        finally:
            service.stop()

    asyncio.run(asyncio.wait_for(scenario(), LONGEST))
