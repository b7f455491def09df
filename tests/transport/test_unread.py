"""Ports report unread bytes that have arrived: TCP, UDP, terminals, and devices with threads."""

from __future__ import annotations

import asyncio
import os
import socket
import threading
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from framekit.transport import serial_port
from framekit.transport.clock import AsyncioClock
from framekit.transport.network import TcpPort, UdpPort
from framekit.transport.port import Port, PortEvents
from framekit.transport.pty_port import PtyPair
from framekit.transport.serial_port import LONGEST_READ, SerialPort
from framekit.transport.unread import UnreadInput


class Events(PortEvents):
    """Record the opening of the port, and the received bytes."""

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


@pytest.mark.parametrize("error", [OSError("not a socket"), ValueError("a negative file descriptor")])
def test_bytes_are_unread_if_the_question_fails(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """A read then reports the lost port."""

    class Poll:
        def register(self, descriptor: int, events: int) -> None:
            assert descriptor >= 0

        def poll(self, time_limit: int) -> list[tuple[int, int]]:
            raise error

    monkeypatch.setattr("select.poll", Poll)
    assert UnreadInput(0)


class ThreadDevice:
    """A device of pyserial without a descriptor: the test decides when `read` and `in_waiting` return."""

    def __init__(self) -> None:
        self.reads, self.read_ends, self.asks, self.answers = (threading.Semaphore(0) for _ in range(4))
        self.data = b""
        self.loop_thread = threading.current_thread()

    def read(self, size: int) -> bytes:
        self.reads.release()
        assert self.read_ends.acquire(timeout=60)
        data, self.data = self.data, b""
        return data

    @property
    def in_waiting(self) -> int:
        if threading.current_thread() is not self.loop_thread:
            self.asks.release()
            assert self.answers.acquire(timeout=60)
        return 0

    def close(self) -> None:
        self.data = b""


class HandClock(AsyncioClock):
    """A clock whose time the test sets; the calls of the loop keep real time."""

    time = 0

    def now(self) -> int:  # type: ignore[override]
        return self.time


async def _a_thread(device: ThreadDevice) -> None:
    clock = HandClock(asyncio.get_running_loop())
    port = SerialPort("rfc2217://far", None, clock)
    events = Events()
    port.open(events)
    await events.is_open.wait()
    assert device.reads.acquire(timeout=60)
    clock.time += LONGEST_READ
    assert not port.has_unread
    clock.time += 1
    assert port.has_unread, "the read has ended, and the thread was stalled since: it may have bytes"
    device.read_ends.release()
    assert device.reads.acquire(timeout=60)
    assert not port.has_unread, "the read returned without bytes, and another has begun"
    device.data = b"end"
    device.read_ends.release()
    assert device.asks.acquire(timeout=60)
    assert port.has_unread, "the thread has read bytes, and asks for more"
    device.answers.release()
    await events.has_all.wait()
    assert device.reads.acquire(timeout=60)
    assert not port.has_unread
    port.close()
    clock.time += 1 + LONGEST_READ
    assert not port.has_unread
    device.read_ends.release()


def test_bytes_that_a_thread_holds_are_unread(monkeypatch: pytest.MonkeyPatch) -> None:
    device = ThreadDevice()
    monkeypatch.setattr(serial_port, "open_device", lambda url, settings, wiring: device)
    asyncio.run(_a_thread(device))
