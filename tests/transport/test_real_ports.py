"""Real ports on asyncio: pseudo-terminals, TCP, pyserial's loop, and what happens when the other side goes away."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

import pytest

from framekit.definition.times import LineFormat
from framekit.transport.clock import AsyncioClock
from framekit.transport.open_port import host_and_port, open_port
from framekit.transport.pty_pair import PtyPair
from framekit.transport.tcp_port import AcceptedPort, TcpListener


class Waiting:
    """Events of a port, to be awaited."""

    def __init__(self) -> None:
        self.queue: asyncio.Queue[tuple[str, Any]] = asyncio.Queue()

    def opened(self, now: int) -> None:
        self.queue.put_nowait(("opened", None))

    def received(self, data: bytes, now: int, faults: object = ()) -> None:
        self.queue.put_nowait(("received", data))

    def line_break(self, now: int) -> None:
        self.queue.put_nowait(("break", None))

    def sent(self, now: int) -> None:
        self.queue.put_nowait(("sent", None))

    def closed(self, now: int, reason: str) -> None:
        self.queue.put_nowait(("closed", reason))

    def control(self, lines: object, now: int) -> None:
        self.queue.put_nowait(("control", lines))

    async def until(self, kind: str) -> Any:
        while True:
            found, value = await self.queue.get()
            if found == kind:
                return value

    async def bytes(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            data += await self.until("received")
        return data


def run(coroutine: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(coroutine, 20))


def test_a_pty_pair_carries_every_byte_both_ways() -> None:
    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        with PtyPair() as pair:
            left = open_port(pair.first, LineFormat(19200, parity="E"), clock)
            right = open_port(pair.second, LineFormat(19200, parity="E"), clock)
            here, there = Waiting(), Waiting()
            left.open(here)
            right.open(there)
            await here.until("opened")
            await there.until("opened")
            message = bytes(range(256))
            left.write(message)
            assert await there.bytes(256) == message
            right.write(message[::-1])
            assert await here.bytes(256) == message[::-1]
            left.close()
            right.close()

    run(check())


def test_a_pulled_pty_is_reported_and_nothing_raises() -> None:
    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        pair = PtyPair()
        port, events = open_port(pair.first, LineFormat(9600), clock), Waiting()
        port.open(events)
        await events.until("opened")
        pair.close()
        assert isinstance(await events.until("closed"), str)
        port.write(b"into the void")

    run(check())


def test_a_missing_port_is_reported_as_closed() -> None:
    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        events = Waiting()
        open_port("/dev/no-such-port", LineFormat(9600), clock).open(events)
        assert "no-such-port" in await events.until("closed")

    run(check())


def test_pyserial_urls_work_through_a_thread() -> None:
    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        port, events = open_port("loop://", LineFormat(115200), clock), Waiting()
        port.open(events)
        await events.until("opened")
        port.write(b"around")
        assert await events.bytes(6) == b"around"
        port.close()

    run(check())


def test_tcp_both_ways_and_the_end_of_a_connection() -> None:
    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        accepted: asyncio.Queue[AcceptedPort] = asyncio.Queue()
        listener = TcpListener("127.0.0.1", 0, clock, accepted.put_nowait)
        number = await listener.start()
        client, events = open_port(f"tcp://127.0.0.1:{number}", None, clock), Waiting()
        client.open(events)
        await events.until("opened")
        server, served = await accepted.get(), Waiting()
        server.open(served)
        client.write(b"ask")
        assert await served.bytes(3) == b"ask"
        server.write(b"answer")
        assert await events.bytes(6) == b"answer"
        server.close()
        assert "closed" in await events.until("closed")
        listener.stop()

    run(check())


@pytest.mark.parametrize(("text", "expected"), [("localhost:502", ("localhost", 502)), ("[::1]:5", ("::1", 5))])
def test_hosts_and_ports(text: str, expected: tuple[str, int]) -> None:
    assert host_and_port(text) == expected


@pytest.mark.parametrize("text", ["localhost", "x:99999", "x:y"])
def test_wrong_hosts_and_ports(text: str) -> None:
    with pytest.raises(ValueError, match="HOST:PORT"):
        host_and_port(text)


def test_an_unknown_scheme_is_named_with_those_that_exist() -> None:
    async def check() -> None:
        with pytest.raises(ValueError, match="'usb://1' is no port – known are a device such as"):
            open_port("usb://1", None, AsyncioClock(asyncio.get_running_loop()))

    run(check())
