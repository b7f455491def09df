"""Polls on the virtual clock: a client on a hand-played port, or on a simulated line with a device."""

from __future__ import annotations

from collections import deque
from typing import Any

from link.service_loop import codec_of
from service.fault_world import Link, loaded

from framekit.definition.times import parse_format
from framekit.link.engine import Engine
from framekit.link.events import Seen, Send
from framekit.link.services.client import TransferResult
from framekit.link.services.server import MemoryServer
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import Device, memory_of
from framekit.service.client import ClientService, Polling
from framekit.service.device import DeviceService
from framekit.transport.clock import VirtualClock
from framekit.transport.port import Port, PortEvents
from framekit.transport.simulated_line import SimulatedLine

MS = 1_000_000
SECOND = 1000 * MS


class HandPort(Port):
    """A port on which the test plays the device. `at_once`: a write is transmitted before the call returns."""

    name = "hand"
    settings = None

    def __init__(self, clock: VirtualClock, at_once: bool) -> None:
        self.clock = clock
        self.at_once = at_once
        self.written: list[bytes] = []
        self.times: list[int] = []
        self.events: PortEvents | None = None

    def open(self, events: PortEvents) -> None:
        self.events = events
        self.clock.call_soon(lambda: events.opened(self.clock.now()))

    def write(self, data: bytes) -> None:
        self._note(data)
        self.clock.call_soon(self._left)

    def write_through(self, data: bytes) -> bool:
        if self.at_once:
            self._note(data)
        else:
            self.write(data)
        return self.at_once

    def _note(self, data: bytes) -> None:
        self.written.append(data)
        self.times.append(self.clock.now())

    def _left(self) -> None:
        if self.events is not None:
            self.events.sent(self.clock.now())

    def close(self) -> None:
        self.events = None

    def send_break(self, duration: int) -> None:
        raise AssertionError(f"nothing here sends a break of {duration} ns")


class PollResults:
    """The results of one poll."""

    def __init__(self) -> None:
        self.values: list[tuple[int, ...]] = []
        self.failures: list[TransferResult] = []

    def result(self, result: TransferResult) -> None:
        if result.ok:
            self.numbers(tuple(result.values))
        else:
            self.failures.append(result)

    def numbers(self, values: tuple[int, ...]) -> None:
        self.values.append(values)

    @property
    def outcomes(self) -> list[str]:
        return [failure.outcome for failure in self.failures]


class Asking:
    """A client with the results of its calls."""

    service: ClientService
    clock: VirtualClock

    def poll(
        self, address: str, count: int = 1, *, station: Any, every: int = 0, unit: str | None = None,
        results: PollResults | None = None,
    ) -> tuple[Polling, PollResults]:  # fmt: skip
        """Start a poll."""
        results = PollResults() if results is None else results
        polling = Polling(
            self.service, address, station=station, unit=unit, count=count, every=every, on_result=results.result
        )
        polling.start()
        return polling, results

    def read(self, address: str, count: int = 1, *, station: Any) -> list[TransferResult]:
        """Start a read; its result will be appended to the returned list."""
        ended: list[TransferResult] = []
        self.service.request(
            lambda client, now, done: client.read(address, station=station, count=count, now=now, on_done=done),
            ended.append,
        )
        return ended

    def write(self, address: str, values: list[int], *, station: Any) -> list[TransferResult]:
        ended: list[TransferResult] = []
        self.service.request(
            lambda client, now, done: client.write(address, values, station=station, now=now, on_done=done),
            ended.append,
        )
        return ended


class ByHand(Asking):
    """A client on a hand-played port, and a device that computes replies on request."""

    def __init__(self, protocol: str, *, at_once: bool = True, watched: bool = False, **params: Any) -> None:
        self.clock = VirtualClock()
        self.port = HandPort(self.clock, at_once)
        definition, codec = codec_of(protocol)
        self.seen: list[Seen] = []
        self.service = ClientService(
            definition, self.port, self.clock, role="client", own=1, params=params,
            monitor=self.seen.append if watched else None,
        )  # fmt: skip
        self.memory = DeviceMemory(memory_of(definition)[0])
        self._device = Engine(definition, codec, "server", own=1, server=MemoryServer(definition, codec, self.memory))
        self._device.opened(0)
        self.service.start()
        self.clock.run_for(SECOND)

    @property
    def asked(self) -> bytes:
        """Return the last request."""
        return self.port.written[-1]

    def reply(self) -> bytes:
        """Return the device's reply to the last request."""
        self.clock.run_for(0)
        waiting, reply_bytes = deque(self._device.receive(self.asked, self.clock.now())), b""
        while waiting:
            command = waiting.popleft()
            if isinstance(command, Send):
                reply_bytes += command.data
                waiting.extend(self._device.sent(self.clock.now()))
        return reply_bytes

    def come(self, *pieces: bytes) -> None:
        """Deliver bytes in pieces."""
        for piece in pieces:
            self.clock.run_for(1000)
            assert self.port.events is not None
            self.port.events.received(piece, self.clock.now())
        self.clock.run_for(0)

    def answer(self) -> None:
        self.come(self.reply())

    def put(self, *words: int) -> None:
        """Set the device's registers from the first on."""
        self.memory.write("holding", "word", 0, words)


class OnLine(Asking):
    """A client and a device on a simulated line."""

    def __init__(self, link: Link, *, watched: bool = False) -> None:
        self.link = link
        self.clock = VirtualClock()
        settings = None if link.format is None else parse_format(link.format, link.speed)
        line = SimulatedLine(self.clock, settings, latency=MS)
        protocol = loaded(link.protocol)
        areas, grammar = memory_of(protocol)
        params = {"node": link.station} if "node" in protocol.params else {}
        device = Device(
            name="device", protocol=protocol, role=link.answering, own=link.station, params=params, areas=areas,
            grammar=grammar, profile=None, mapping={}, initial=(),
        )  # fmt: skip
        self.device_port, self.port = line.port("device"), line.port("client")
        self.device = DeviceService(device, self.device_port, self.clock, settings)
        self.seen: list[Seen] = []
        self.service = ClientService(
            protocol, self.port, self.clock, role=link.asking, own=link.own.get("node", 1), line=settings,
            params={**link.params, **link.own}, monitor=self.seen.append if watched else None,
        )  # fmt: skip
        self.device.start()
        self.service.start()
        self.clock.run_for(SECOND)

    def put(self, values: list[int]) -> None:
        """Set the device's values at the address that the link reads."""
        place = self.device.device.grammar.parse(self.link.address)
        self.device.memory.write(place.area, place.unit, place.start, values, force=True)

    def until(self, happened: Any) -> None:
        """Advance time until a condition is true, an hour at most."""
        end = self.clock.now() + 3600 * SECOND
        while not happened() and self.clock.now() < end and self.clock.advance():
            pass
        assert happened()
