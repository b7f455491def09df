"""Ports know whether bytes have arrived that the loop has not read: TCP, UDP, and terminals."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from framekit.transport.clock import AsyncioClock
from framekit.transport.network import TcpPort, UdpPort
from framekit.transport.port import Port, PortEvents
from framekit.transport.pty_port import PtyPair
from framekit.transport.serial_port import SerialPort


class Events(PortEvents):
    """Notes when the port is open, and the received bytes."""

    def __init__(self) -> None:
        self.is_open, self.has_all = asyncio.Event(), asyncio.Event()
        self.data = b""

    def opened(self, now: int) -> None:
        self.is_open.set()

    def received(self, data: bytes, now: int, faults: object = ()) -> None:
        self.data += data
        if self.data.endswith(b"end"):
            self.has_all.set()


async def open_port(port: Port) -> Events:
    events = Events()
    port.open(events)
    await events.is_open.wait()
    assert not port.has_unread
    return events


async def read_all(port: Port, events: Events) -> None:
    """Let the loop read; a turn of the loop takes a part of many bytes, so some stay unread meanwhile."""
    assert port.has_unread, "they arrived, and the loop has not read them"
    await events.has_all.wait()
    assert not port.has_unread
    port.close()
    assert not port.has_unread


async def _tcp() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = TcpPort("127.0.0.1", listening.getsockname()[1], AsyncioClock(asyncio.get_running_loop()))
        events = await open_port(port)
        peer, _ = listening.accept()
        peer.sendall(bytes(5000) + b"end")
        await read_all(port, events)
        peer.close()


async def _udp() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        port = UdpPort("127.0.0.1", peer.getsockname()[1], AsyncioClock(asyncio.get_running_loop()))
        events = await open_port(port)
        port.write(b"hello")
        _, address = peer.recvfrom(100)
        peer.sendto(bytes(2000) + b"end", address)
        await read_all(port, events)


async def _a_terminal() -> None:
    with PtyPair() as pair:
        port = SerialPort(pair.first, None, AsyncioClock(asyncio.get_running_loop()))
        events = await open_port(port)
        other = os.open(pair.second, os.O_RDWR | os.O_NOCTTY)
        os.write(other, b"end")
        for _ in range(1_000_000):  # a thread carries the bytes
            if port.has_unread:
                break
        await read_all(port, events)
        os.close(other)


@pytest.mark.parametrize("use", [_tcp, _udp, _a_terminal])
def test_bytes_are_unread_until_the_loop_has_read_all_of_them(use: Callable[[], Coroutine[Any, Any, None]]) -> None:
    asyncio.run(use())
