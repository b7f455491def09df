"""Our client with a server that is late, short, of another station or noisy: no wrong value is accepted."""

from __future__ import annotations

from typing import Any

import pytest

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.definition.times import LineFormat
from framekit.link.engine import Engine
from framekit.link.events import Command
from framekit.link.services.client import ServiceClient
from framekit.service.driver import Driver
from framekit.transport.clock import VirtualClock
from framekit.transport.simulated_line import SimulatedLine

MILLISECOND = 1_000_000


def crc(text: str) -> bytes:
    data = bytes.fromhex(text)
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return data + value.to_bytes(2, "little")


GOOD = crc("01 03 02 1234")
WRONG: dict[str, bytes] = {
    "no reply": b"",
    "short": GOOD[:4],
    "of another station": crc("02 03 02 9999"),
    "of another function": crc("01 04 02 9999"),
    "of too many registers": crc("01 03 04 9999 9999"),
    "of no register": crc("01 03 00"),
    "with a wrong check": GOOD[:-1] + bytes([GOOD[-1] ^ 1]),
    "noise": b"\xff\x00\x55" * 5,
    "the request itself": crc("01 03 0000 0001"),
}
UNFIT = ("of too many registers", "of no register")
"""Valid replies to other requests: they fail at once, since repeating the request would return them again."""

DAMAGED = ("short", "with a wrong check")
"""Replies with a wrong check code only: they close the request, so the next reply needs no confirmation."""


class BadServer:
    """A server whose first reply is wrong, after `delay` ns; all other replies are right."""

    def __init__(self, line: SimulatedLine, clock: VirtualClock, first: bytes, delay: int) -> None:
        self.port, self.clock = line.port("server"), clock
        self.first, self.delay, self.requests = first, delay, 0
        self.heard = b""
        self.port.open(self)

    def received(self, data: bytes, now: int, faults: object = ()) -> None:
        self.heard += data
        if len(self.heard) < 8:
            return
        self.heard = b""
        self.requests += 1
        reply, delay = (self.first, self.delay) if self.requests == 1 else (GOOD, 5 * MILLISECOND)
        self.clock.call_at(now + delay, lambda: self.port.write(reply))

    def opened(self, now: int) -> None: ...

    def line_break(self, now: int) -> None: ...

    def sent(self, now: int) -> None: ...

    def closed(self, now: int, reason: str) -> None: ...

    def control(self, lines: object, now: int) -> None: ...


def read_twice(first: bytes, delay: int, retries: int) -> tuple[list[Any], BadServer]:
    """Read a register twice; return the results and the server."""
    clock, settings = VirtualClock(), LineFormat(19200, parity="E")
    line = SimulatedLine(clock, settings)
    server = BadServer(line, clock, first, delay)
    protocol = load_protocol("modbus-rtu")
    codec = compile_protocol(protocol)
    params = {"reply_timeout": "100 ms", "retries": str(retries)}
    engine = Engine(protocol, codec, "client", params=params, line=settings)
    driver, client = Driver(engine, line.port("client"), clock), ServiceClient(protocol, codec, engine)
    driver.start()
    clock.run_for(MILLISECOND)
    results: list[Any] = []

    def asking(now: int) -> list[Command]:
        return client.read("40001", station=1, now=now, on_done=results.append).commands

    for number in (1, 2):
        driver.do(asking)
        clock.run_for(1_000 * MILLISECOND)
        assert len(results) == number
    return results, server


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_reply_is_never_taken_and_the_next_read_is_right(what: str) -> None:
    (first, second), server = read_twice(WRONG[what], 5 * MILLISECOND, retries=0)
    assert not first.ok and not first.values
    assert second.ok and second.values == [0x1234]
    assert server.requests == (2 if what in UNFIT + DAMAGED else 3), (
        "after a request without its reply the next reply is confirmed"
    )


@pytest.mark.parametrize("what", [what for what in WRONG if what not in UNFIT])
def test_a_repeated_request_gets_the_right_reply(what: str) -> None:
    (first, second), server = read_twice(WRONG[what], 5 * MILLISECOND, retries=1)
    assert first.ok and first.values == [0x1234] and second.values == [0x1234]
    assert server.requests == (3 if what in DAMAGED else 4), "one confirms the reply after a request without one"


def test_noise_before_and_behind_a_reply_does_no_harm() -> None:
    (first, second), _ = read_twice(b"\xff\xff" + GOOD + b"\x00\x00", 5 * MILLISECOND, retries=0)
    assert first.ok and first.values == second.values == [0x1234]


def test_a_reply_that_comes_too_late_is_not_taken_for_the_next_one() -> None:
    (first, second), _ = read_twice(crc("01 03 02 9999"), 150 * MILLISECOND, retries=0)
    assert not first.ok and first.outcome == "no_reply"
    assert second.ok and second.values == [0x1234]
