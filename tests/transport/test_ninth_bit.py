"""Characters of nine bits on real ports: mark and space parity, switched after all earlier characters are transmitted.

No hardware is needed: a fake device records its input, a fake terminal its settings.
"""

from __future__ import annotations

import asyncio
import termios
from typing import Any, ClassVar

import pytest
from transport.real_world import open_pty, opened, run

from framekit.definition.times import LineFormat, parse_format
from framekit.link.events import CharacterFault, LineFault
from framekit.transport import serial_port
from framekit.transport.clock import AsyncioClock, VirtualClock
from framekit.transport.port import PortEvents
from framekit.transport.serial_port import (
    NO_STICKY_PARITY,
    STICKY_PARITY,
    DamageCounts,
    SerialConnection,
    SerialPort,
    has_sticky_parity,
    set_sticky_parity,
)

NINE = parse_format("9N1", 9600)


def real_clock() -> AsyncioClock:
    return AsyncioClock(asyncio.get_running_loop())


class Device(SerialConnection):
    """A device that records writes and switches of the ninth bit; its queue is always empty."""

    def __init__(self, clock: VirtualClock, has_bit_times: bool = True) -> None:
        self.clock = clock
        self.has_bit_times = has_bit_times
        self.noted: list[tuple[int, object]] = []

    def write(self, data: bytes) -> None:
        self.noted.append((self.clock.now(), data))

    @property
    def waiting(self) -> int:
        return 0

    def set_line(self, name: str, on: bool) -> None: ...

    def change_line(self, line: LineFormat) -> None: ...

    def set_ninth_bit(self, on: bool) -> None:
        self.noted.append((self.clock.now(), on))

    def drop_output(self) -> None: ...

    def stop(self) -> None: ...


class Sent(PortEvents):
    def __init__(self) -> None:
        self.times: list[int] = []

    def sent(self, now: int) -> None:
        self.times.append(now)


def port_on(device: Device, settings: LineFormat, monkeypatch: pytest.MonkeyPatch) -> tuple[SerialPort, Sent]:
    """Return a serial port just opened on a fake device, at time 0."""
    events = Sent()
    monkeypatch.setattr(SerialPort, "_connect", lambda self, use: device)
    port = SerialPort("made up", settings, device.clock)  # type: ignore[arg-type]
    port.open(events)
    assert port._use is not None
    port._use.opened()
    return port, events


C = NINE.character_time


@pytest.mark.parametrize(
    ("data", "marked", "expected"),
    [
        (b"\x0b\x01\x0c", 0, [(0, True), (0, b"\x0b"), (C, False), (C, b"\x01\x0c")]),
        (b"\x00\x05\x05", 2, [(0, b"\x00\x05"), (2 * C, True), (2 * C, b"\x05"), (3 * C, False)]),
        (b"\x00", 0, [(0, True), (0, b"\x00"), (C, False)]),
    ],
)
def test_the_bit_is_switched_when_all_before_has_left(
    monkeypatch: pytest.MonkeyPatch, data: bytes, marked: int, expected: list[tuple[int, object]]
) -> None:
    device = Device(VirtualClock())
    port, events = port_on(device, NINE, monkeypatch)
    port.write_marked(data, marked)
    device.clock.run_for(100 * C)
    assert device.noted == expected
    assert events.times == [len(data) * C], "told once, when the last bit has left and the port listens again"


def test_what_follows_a_marked_frame_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device(VirtualClock())
    port, events = port_on(device, NINE, monkeypatch)
    port.write_marked(b"\x0b\x0b", 0)
    port.write(b"\x00")
    device.clock.run_for(100 * C)
    assert [what for _, what in device.noted] == [True, b"\x0b", False, b"\x0b", b"\x00"]
    assert events.times == [3 * C]


@pytest.mark.parametrize(("settings", "has_bit_times"), [("8N1", True), ("9N1", False)])
def test_without_a_ninth_bit_nothing_is_switched(
    monkeypatch: pytest.MonkeyPatch, settings: str, has_bit_times: bool
) -> None:
    device = Device(VirtualClock(), has_bit_times)
    port, _ = port_on(device, parse_format(settings, 9600), monkeypatch)
    port.write_marked(b"\x0b\x0b", 0)
    device.clock.run_for(100 * C)
    assert [what for _, what in device.noted] == [b"\x0b\x0b"]
    assert not port.hears_marks


class Terminal:
    """The settings of a terminal, as termios has them; `keeps`: the control flags that its driver supports."""

    def __init__(self, keeps: int = -1) -> None:
        self.attributes: list[Any] = [0, 0, termios.CS8, 0, 0, 0, [0] * 32]
        self.when: list[int] = []
        self.keeps = keeps

    def get(self, descriptor: int) -> list[Any]:
        return [*self.attributes]

    def set(self, descriptor: int, when: int, attributes: list[Any]) -> None:
        self.attributes = [*attributes]
        self.attributes[2] &= self.keeps
        self.when.append(when)


def test_mark_and_space_parity_of_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(termios, "tcgetattr", terminal.get)
    monkeypatch.setattr(termios, "tcsetattr", terminal.set)
    assert not has_sticky_parity(5)
    set_sticky_parity(5, True)
    assert terminal.attributes[2] == termios.CS8 | termios.PARENB | STICKY_PARITY | termios.PARODD
    set_sticky_parity(5, False)
    assert terminal.attributes[2] == termios.CS8 | termios.PARENB | STICKY_PARITY
    assert terminal.when == [termios.TCSADRAIN] * 2, "what is still to leave is waited for"
    assert has_sticky_parity(5)


def test_a_terminal_that_cannot_be_switched(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(descriptor: int, when: int, attributes: list[Any]) -> None:
        raise termios.error(22, "Invalid argument")

    monkeypatch.setattr(termios, "tcgetattr", Terminal().get)
    monkeypatch.setattr(termios, "tcsetattr", refuse)
    with pytest.raises(OSError, match="no mark and space parity"):
        set_sticky_parity(5, True)


def test_a_driver_without_mark_and_space_parity_is_told_when_the_port_opens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_port, "is_pseudo", lambda descriptor: False)
    monkeypatch.setattr(serial_port, "has_sticky_parity", lambda descriptor: False)

    async def check() -> None:
        path, master = open_pty()
        with master:
            events = Closing()
            SerialPort(path, NINE, real_clock()).open(events)
            assert NO_STICKY_PARITY in await asyncio.wait_for(events.reason, 60)

    run(check())


class Closing(PortEvents):
    def __init__(self) -> None:
        self.reason: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    def closed(self, now: int, reason: str) -> None:
        self.reason.set_result(reason)


@pytest.mark.parametrize(
    ("added", "stream", "expected"),
    [
        (None, b"\xff\x00\x0b\x0b", {0: LineFault.MARK}),
        (DamageCounts(parity=1), b"\xff\x00\x0b\x0b", {0: LineFault.MARK}),
        (DamageCounts(framing=1), b"\xff\x00\x0b\x0b", {0: LineFault.FRAMING}),
        (None, b"\x05\xff\x00\x00", {1: LineFault.MARK}),
        (DamageCounts(parity=1), b"\x05\xff\x00\x00", {1: LineFault.MARK}),
    ],
)
def test_a_marked_byte_comes_as_one_with_a_parity_fault(
    monkeypatch: pytest.MonkeyPatch, added: DamageCounts | None, stream: bytes, expected: dict[int, LineFault]
) -> None:
    """Also a marked 00, which looks like a break if the driver has no error counters."""
    counted = [DamageCounts(), added]
    monkeypatch.setattr(serial_port, "is_pseudo", lambda descriptor: False)
    monkeypatch.setattr(serial_port, "mark_damage", lambda descriptor: True)
    monkeypatch.setattr(serial_port, "has_sticky_parity", lambda descriptor: True)
    monkeypatch.setattr(serial_port, "damage_counts", lambda descriptor: counted.pop(0) if added else None)

    async def check() -> None:
        path, master = open_pty()
        with master:
            port = SerialPort(path, NINE, real_clock())
            events = await opened(port)
            assert port.hears_marks
            master.write(stream)
            kind, (data, faults) = await events.queue.get()
            assert kind == "received" and len(data) == 2
            assert all(isinstance(fault, CharacterFault) for fault in faults)
            assert {fault.index: fault.fault for fault in faults} == expected
            port.close()

    run(check())


def test_a_pseudo_terminal_has_no_ninth_bit() -> None:
    async def check() -> None:
        path, master = open_pty()
        with master:
            port = SerialPort(path, NINE, real_clock())
            events = await opened(port)
            port.write_marked(b"\x0b\x0b", 0)
            await events.until("sent")
            assert master.read(10) == b"\x0b\x0b"
            assert not port.hears_marks
            port.close()

    run(check())


class Loop:
    """A stand-in for pyserial's port of a URL: records the parity of each write."""

    noted: ClassVar[list[tuple[str, bytes]]] = []
    parity = "S"
    in_waiting = 0
    flushed = 0

    def read(self, size: int) -> bytes:
        return b""

    def write(self, data: bytes) -> None:
        self.noted.append((self.parity, data))

    def flush(self) -> None:
        self.flushed += 1

    def close(self) -> None: ...


def test_where_there_is_no_descriptor_a_thread_switches(monkeypatch: pytest.MonkeyPatch) -> None:
    device = Loop()
    device.noted.clear()
    monkeypatch.setattr(serial_port, "open_device", lambda *arguments: device)

    async def check() -> None:
        port = SerialPort("loop://", NINE, real_clock())
        events = await opened(port)
        port.write_marked(b"\x0b\x0c\x0d", 0)
        await events.until("sent")
        port.close()

    run(check())
    assert device.noted == [("M", b"\x0b"), ("S", b"\x0c\x0d")]
    assert device.flushed == 2, "all before has left when the parity is switched"


def test_nine_bits_open_as_eight_with_space_parity() -> None:
    device = serial_port.open_device("loop://", NINE)
    assert (device.bytesize, device.parity, device.stopbits) == (8, "S", 1)
    serial_port.change_device(device, parse_format("9N2", 4800))
    assert (device.baudrate, device.bytesize, device.parity, device.stopbits) == (4800, 8, "S", 2)
    device.close()
