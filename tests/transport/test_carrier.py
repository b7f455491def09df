"""The carrier of a modem on a serial port: polled while the port is open, changes are reported."""

from __future__ import annotations

from typing import Any, cast

import pytest

from framekit.definition.times import PLAIN, LineFormat, LineSettings, Modem
from framekit.transport.clock import VirtualClock
from framekit.transport.serial_port import SerialConnection, SerialPort

SECOND = 1_000_000_000


class Wire(SerialConnection):
    """A device whose carrier the test switches."""

    carrier: bool | None = False
    looks = 0

    @property
    def has_carrier(self) -> bool | None:
        self.looks += 1
        return self.carrier

    def write(self, data: bytes) -> None: ...

    @property
    def waiting(self) -> int:
        return 0

    def set_line(self, name: str, on: bool) -> None: ...

    def change_line(self, line: LineFormat) -> None: ...

    def set_ninth_bit(self, on: bool) -> None: ...

    def drop_output(self) -> None: ...

    def stop(self) -> None: ...


class ControlRecorder:
    """Recorder of the control lines that a port reports."""

    def __init__(self) -> None:
        self.lines: list[dict[str, bool]] = []

    def opened(self, now: int) -> None: ...

    def control(self, lines: dict[str, bool], now: int) -> None:
        self.lines.append(lines)


class WiredPort(SerialPort):
    """A port on a fake device."""

    def _connect(self, use: Any) -> SerialConnection:
        self.wire = Wire()
        self.clock.call_soon(use.opened)
        return self.wire


def opened(wiring: LineSettings) -> tuple[VirtualClock, WiredPort, ControlRecorder]:
    clock, recorder = VirtualClock(), ControlRecorder()
    port = WiredPort("/dev/none", None, cast(Any, clock), wiring)
    port.open(cast(Any, recorder))
    clock.run_for(SECOND)
    return clock, port, recorder


def test_a_carrier_that_comes_and_goes_is_told() -> None:
    clock, port, recorder = opened(LineSettings(modem=Modem()))
    assert recorder.lines == [], "one that was never there is not lost"
    port.wire.carrier = True
    clock.run_for(SECOND)
    assert recorder.lines == [{"dcd": True}]
    port.wire.carrier = False
    clock.run_for(SECOND)
    assert recorder.lines == [{"dcd": True}, {"dcd": False}]
    port.close()
    port.wire.carrier = True
    clock.run_for(SECOND)
    assert len(recorder.lines) == 2


@pytest.mark.parametrize(("wiring", "looks"), [(PLAIN, 0), (LineSettings(modem=Modem()), 5)])
def test_only_ports_with_a_modem_are_looked_at(wiring: LineSettings, looks: int) -> None:
    _, port, _ = opened(wiring)
    assert port.wire.looks == looks


def test_a_device_without_such_a_line_is_not_looked_at_again() -> None:
    clock, port, recorder = opened(LineSettings(modem=Modem()))
    port.wire.carrier = None
    clock.run_for(10 * SECOND)
    looks = port.wire.looks
    clock.run_for(10 * SECOND)
    assert port.wire.looks == looks and recorder.lines == []
