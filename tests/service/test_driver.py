"""A driver on ports that report at once that all bytes are transmitted."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping

import pytest
from link.service_loop import codec_of

from framekit.definition.times import NEVER
from framekit.link.events import CharacterFault, Command, Send
from framekit.link.services.client import TransferResult
from framekit.service.client import ClientService
from framekit.service.driver import Driver
from framekit.transport.clock import AsyncioClock, VirtualClock
from framekit.transport.port import Port, PortEvents

SECOND = 1_000_000_000


class QuickPort(Port):
    """A port that transmits every write at once and receives no data."""

    name = "quick"
    settings = None

    def __init__(self, clock: VirtualClock | AsyncioClock) -> None:
        self.clock = clock
        self.taken: list[bytes] = []
        self.events: PortEvents | None = None

    def open(self, events: PortEvents) -> None:
        self.events = events
        self.clock.call_soon(lambda: events.opened(self.clock.now()))

    def write(self, data: bytes) -> None:
        raise AssertionError(f"written without asking whether it has left: {data!r}")

    def write_through(self, data: bytes) -> bool:
        self.taken.append(data)
        return True

    def close(self) -> None:
        self.events = None

    def send_break(self, duration: int) -> None:
        raise AssertionError(f"nothing here sends a break of {duration} ns")


def test_a_request_that_waits_for_silence_has_its_time_limit_all_the_same() -> None:
    clock = VirtualClock()
    port = QuickPort(clock)
    service = ClientService(codec_of("modbus-rtu")[0], port, clock, role="client")
    service.start()
    clock.run_for(SECOND)
    assert port.events is not None
    port.events.received(b"\x55", clock.now())
    results: list[TransferResult] = []
    service.request(
        lambda client, now, done: client.read("40001", station=1, count=1, now=now, on_done=done), results.append
    )
    assert not port.taken, "the silence behind the character has to pass first"
    clock.run_for(600 * SECOND)
    assert [result.outcome for result in results] == ["no_reply"]
    assert len(port.taken) > 1 and len(set(port.taken)) == 1


def test_a_clock_keeps_nothing_of_a_driver_that_has_been_stopped() -> None:
    async def at_work() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        port = QuickPort(clock)
        service = ClientService(codec_of("modbus-rtu")[0], port, clock, role="client")
        service.start()
        while not service.is_open:
            await asyncio.sleep(0)
        results: list[TransferResult] = []
        service.request(
            lambda client, now, done: client.read("40001", station=1, count=1, now=now, on_done=done), results.append
        )
        assert clock.next_call is not None, "the time limit of the reply"
        service.stop()
        assert clock.next_call is None and [result.outcome for result in results] == ["closed"]

    asyncio.run(at_work())


class FaultyEngine:
    """An engine that sets a deadline and then raises for received bytes."""

    good_frames = 0

    def __init__(self) -> None:
        self.deadline = NEVER
        self.rung: list[int] = []

    def opened(self, now: int) -> list[Command]:
        return []

    def hear_late(self) -> None:
        pass

    def receive(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> list[Command]:
        self.deadline = now + SECOND
        raise ArithmeticError(data)

    def tick(self, now: int) -> list[Command]:
        self.rung.append(now)
        self.deadline = NEVER
        return []

    def closed(self, now: int, reason: str = "") -> list[Command]:
        return []

    def line_break(self, now: int) -> list[Command]:
        return []

    def sent(self, now: int) -> list[Command]:
        return []

    def control(self, lines: Mapping[str, bool], now: int) -> list[Command]:
        return []


class FaultyMoment:
    inside = False

    def end(self) -> None:
        raise LookupError("at the end of the event")


@pytest.mark.parametrize("moment", [None, FaultyMoment()])
def test_times_come_although_an_event_went_wrong(moment: FaultyMoment | None) -> None:
    clock, engine = VirtualClock(), FaultyEngine()
    driver = Driver(engine, QuickPort(clock), clock, moment=moment)
    driver.start()
    clock.run_for(SECOND)
    with pytest.raises(ArithmeticError if moment is None else LookupError):
        driver.received(b"\x01", clock.now())
    clock.run_for(2 * SECOND)
    assert engine.rung == [2 * SECOND]


class FailingPort(QuickPort):
    """A port whose query for unread bytes fails at the query numbers `fails`; it returns `is_unread` otherwise."""

    fails: tuple[int, ...] = ()
    is_unread = True
    asked = 0

    @property
    def has_unread(self) -> bool:
        self.asked += 1
        if self.asked in self.fails:
            raise OSError("no such socket")
        return self.is_unread


@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_port_that_fails_while_times_run_out_stops_no_time_limit(number: int) -> None:
    clock = VirtualClock()
    port = FailingPort(clock)
    service = ClientService(codec_of("modbus-rtu")[0], port, clock, role="client", params={"retries": 0})
    service.start()
    clock.run_for(SECOND)
    results: list[TransferResult] = []

    def read() -> None:
        service.request(
            lambda client, now, done: client.read("40001", station=1, count=1, now=now, on_done=done), results.append
        )

    port.asked, port.fails = 0, (number,)
    read()
    with pytest.raises(OSError, match="no such socket"):
        clock.run_for(60 * SECOND)
    port.is_unread = False
    clock.run_for(60 * SECOND)
    assert [result.outcome for result in results] == ["no_reply"]
    read()
    clock.run_for(600 * SECOND)
    assert [result.outcome for result in results] == ["no_reply"] * 2


class SendingEngine(FaultyEngine):
    """An engine that sends a byte each second."""

    def tick(self, now: int) -> list[Command]:
        self.rung.append(now)
        self.deadline = now + SECOND
        return [Send(b"x", 0, False)]


class FullPort(QuickPort):
    """A port whose writes fail."""

    def write_through(self, data: bytes) -> bool:
        raise OSError("no room")


def test_a_write_that_fails_stops_no_time_limit() -> None:
    clock, engine = VirtualClock(), SendingEngine()
    engine.deadline = SECOND
    driver = Driver(engine, FullPort(clock), clock)  # type: ignore[arg-type]
    driver.start()
    for _ in range(3):
        with pytest.raises(OSError, match="no room"):
            clock.run_for(10 * SECOND)
    assert engine.rung == [SECOND, 2 * SECOND, 3 * SECOND]
