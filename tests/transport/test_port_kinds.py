"""A kind of port defined outside of framekit: pipes within this process, `pipe:NAME`."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

import framekit
from framekit.definition.times import LineFormat, LineSettings
from framekit.transport import schemes
from framekit.transport.clock import AsyncioClock, VirtualClock
from framekit.transport.port import Accepted, AcceptedPort, Port, PortEvents, PortListener
from framekit.transport.schemes import SCHEMES, Scheme, open_port, scheme_of

LISTENING: dict[str, PipeListener] = {}


class PipeEnd(AcceptedPort):
    """An end of a pipe; written bytes arrive at the other end in the next call of the clock."""

    settings = None

    def __init__(self, name: str, clock: AsyncioClock) -> None:
        self.name = name
        self.clock = clock
        self.other: PipeEnd | None = None
        self.events: PortEvents | None = None

    def open(self, events: PortEvents) -> None:
        self.events = events
        self.tell("opened")

    def tell(self, event: str, *values: Any) -> None:
        def call() -> None:
            if self.events is not None:
                before = values[:1] if event == "received" else ()
                getattr(self.events, event)(*before, self.clock.now(), *values[len(before) :])

        self.clock.call_soon(call)

    def write(self, data: bytes) -> None:
        if self.other is not None:
            self.other.tell("received", data)
        self.tell("sent")

    def send_break(self, duration: int) -> None:
        self.tell("sent")

    def close(self) -> None:
        self.events = None
        if self.other is not None:
            self.other.other = None
            self.other.tell("closed", "the pipe is closed")
            self.other = None


class PipePort(PipeEnd):
    """The connecting end; without a listener it is closed at once."""

    opens_again = True

    def open(self, events: PortEvents) -> None:
        self.close()
        listener = LISTENING.get(self.name)
        if listener is None:
            self.events = events
            self.tell("closed", f"{self.name}: nobody listens")
            return
        self.other = PipeEnd(f"{self.name} accepted", self.clock)
        self.other.other = self
        listener.accepted(self.other)
        super().open(events)


class PipeListener(PortListener):
    def __init__(self, url: str, clock: AsyncioClock, accepted: Accepted) -> None:
        self.name = self.reached = url
        self.accepted = accepted

    def listen(self) -> None:
        LISTENING[self.name] = self

    async def start(self) -> None:
        self.listen()

    def stop(self) -> None:
        LISTENING.pop(self.name, None)


def open_pipe(url: str, settings: LineFormat | None, clock: AsyncioClock, wiring: LineSettings) -> Port:
    return PipePort(url, clock)


PIPES = Scheme(form="pipe:NAME", open=open_pipe, listen=PipeListener)


@pytest.fixture
def pipes(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Register the kind of port, as an extension program does."""
    monkeypatch.setitem(SCHEMES, "pipe", PIPES)
    yield
    assert not LISTENING, "whoever listened has stopped"


def test_a_client_and_a_server_talk_over_a_kind_of_port_from_outside(pipes: None) -> None:
    async def check() -> None:
        async with framekit.aserve("modbus-tcp", "pipe:rack", initial={"40011": [7, 8, 9]}) as server:
            assert server.port == "pipe:rack"
            async with framekit.aconnect("modbus-tcp", "pipe:rack", station=1) as client:
                assert await client.read("40011", 3) == [7, 8, 9]
                await client.write("40012", [80])
                assert await client.read("40011", 3) == [7, 80, 9]

    asyncio.run(check())


def test_channels_of_a_run_ask_and_answer_over_it(pipes: None, tmp_path: Path) -> None:
    (tmp_path / "pipes.run.yaml").write_text("""\
run: pipes
memory: {profile: masterlogic, set: {"%MW20": [5, 6]}}
channels:
  1: {port: "pipe:here", protocol: modbus-tcp, role: server, own: 1, map: {holding: "%MW0"}}
  2: {port: "pipe:here", protocol: modbus-tcp}
blocks:
  1: {channel: 2, station: 1, read: "40021", count: 2, into: "%MW100", every: 10 ms}
""")

    async def check() -> None:
        async with framekit.AsyncRun(tmp_path / "pipes.run.yaml") as run:
            assert (await run.next_end(1)).done
            assert run.memory.read("%MW100", 2) == [5, 6]

    asyncio.run(asyncio.wait_for(check(), 180))


def test_a_key_about_wires_has_no_sense_on_it(pipes: None, tmp_path: Path) -> None:
    file = tmp_path / "pipes.run.yaml"
    file.write_text("""\
run: pipes
channels:
  1: {port: "pipe:here", protocol: modbus-rtu, type: rs485}
""")
    with pytest.raises(framekit.DefinitionError, match="'type' is about wires, and 'pipe:here' has none"):
        framekit.Run(file)


def test_it_needs_real_time_and_is_named_among_the_known(pipes: None) -> None:
    with pytest.raises(ValueError, match="'pipe:x' is a real port and needs real time"):
        open_port("pipe:x", None, VirtualClock())
    with pytest.raises(ValueError, match=r"'usb:one' is no port – known are .*, pipe:NAME"):
        open_port("usb:one", None, VirtualClock())


def test_an_installed_package_brings_a_kind_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    points = {
        "pipe": EntryPoint("pipe", f"{__name__}:PIPES", schemes.ENTRY_POINTS),
        "odd": EntryPoint("odd", f"{__name__}:LISTENING", schemes.ENTRY_POINTS),
        "gone": EntryPoint("gone", "no_such_module_at_all:KIND", schemes.ENTRY_POINTS),
    }
    monkeypatch.setattr(EntryPoint, "load", lambda self: _loaded(self))
    urls = []

    def entry_points(*, group: str, name: str) -> list[EntryPoint]:
        urls.append((group, name))
        return [points[name]] if name in points else []

    monkeypatch.setattr("importlib.metadata.entry_points", entry_points)
    monkeypatch.setattr(schemes, "SCHEMES", dict(SCHEMES))
    schemes._installed.cache_clear()
    try:
        assert scheme_of("pipe:x") is PIPES and scheme_of("sim:x") is None and scheme_of("none:x") is None
        assert scheme_of("pipe:x") is PIPES and urls == [("framekit.ports", "pipe"), ("framekit.ports", "none")]

        async def check() -> None:
            clock = AsyncioClock(asyncio.get_running_loop())
            assert isinstance(open_port("pipe:x", None, clock), PipePort)
            with pytest.raises(ValueError, match=r"the ports 'odd:. of .*LISTENING can.t be used: it is no Scheme"):
                open_port("odd:x", None, clock)
            with pytest.raises(
                ValueError, match="the ports 'gone:' of no_such_module_at_all:KIND can't be used: ModuleNotFound"
            ):
                open_port("gone:x", None, clock)

        asyncio.run(check())
    finally:
        schemes._installed.cache_clear()


def _loaded(point: EntryPoint) -> Any:
    module, _, name = point.value.partition(":")
    return globals()[name] if module == __name__ else __import__(module)
