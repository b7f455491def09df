"""The work of one request in a server, counted in calls of Python functions, and the garbage it leaves."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest
from service.poll_world import ByHand

from framekit.runfile.devices import load_devices
from framekit.service.device import Serving
from framekit.transport.clock import VirtualClock
from framekit.transport.port import Port, PortEvents

READ = bytes.fromhex("0001 0000 0006 01 03 0000 000A")


class AtOnce(Port):
    """A port that records writes and transmits them at once."""

    name = "at once"
    settings = None

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.sent: list[bytes] = []
        self.events: PortEvents | None = None

    def open(self, events: PortEvents) -> None:
        self.events = events
        self.clock.call_soon(lambda: events.opened(self.clock.now()))

    def write(self, data: bytes) -> None:
        raise AssertionError(data)

    def write_through(self, data: bytes) -> bool:
        self.sent.append(data)
        return True

    def close(self) -> None:
        self.events = None

    def send_break(self, duration: int) -> None:
        raise AssertionError(duration)


@pytest.fixture
def served() -> AtOnce:
    """Return a simulated Modbus device that has already answered."""
    clock = VirtualClock()
    port = AtOnce(clock)
    Serving(load_devices("modbus-tcp", Path()), clock, None).serve(port)
    clock.run_for(1_000_000_000)
    for _ in range(3):
        asks(port)
    return port


def asks(port: AtOnce) -> None:
    assert port.events is not None
    port.events.received(READ, port.clock.now())
    assert len(port.sent.pop()) == 29 and not port.sent


def test_a_served_read_takes_90_calls_at_most(served: AtOnce) -> None:
    called: dict[CodeType, int] = {}

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            called[frame.f_code] = called.get(frame.f_code, 0) + 1

    sys.setprofile(note)
    try:
        asks(served)
    finally:
        sys.setprofile(None)
    assert 20 < sum(called.values()) <= 90, sorted((count, code.co_qualname) for code, count in called.items())


@contextmanager
def only_new_garbage() -> Iterator[None]:
    """Hide the objects of earlier tests, some of which are freed with their threads, from the collector."""
    gc.collect()
    gc.disable()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        gc.enable()


@pytest.mark.long
def test_a_served_read_leaves_nothing_to_the_collector(served: AtOnce) -> None:
    with only_new_garbage():
        for _ in range(20):
            asks(served)
        assert gc.collect() == 0


@pytest.mark.long
def test_a_poll_leaves_nothing_to_the_collector() -> None:
    world = ByHand("modbus-tcp")
    _, results = world.poll("40001", 4, station=1)
    for _ in range(5):
        world.answer()
    with only_new_garbage():
        for _ in range(20):
            world.answer()
        assert gc.collect() == 0 and len(results.values) == 25
