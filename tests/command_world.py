"""A run with one command block at R1 of its own memory, started by hand, with simulated devices on virtual time."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import patch

from framekit.run.model import RunModel
from framekit.runfile.devices import Device
from framekit.runfile.run_file import load_run
from framekit.service.channel import RunMonitor
from framekit.service.device import DeviceService, devices_of
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
STATUS, FAULT = 500, 1
"""The status word is %R500 unless a test says otherwise; the fault bit is %M1."""

RUN = """run: commands
memory: ge-90-30
channels:
  1: {{port: "sim:there.device.yaml", protocol: {protocol}{settings}}}
blocks:
  0: {{command: R1, fault: M1}}
"""


_LOADED: dict[tuple[str, str, str], tuple[RunModel, tuple[Device, ...]]] = {}


def loaded(folder: Path, protocol: str, device: str, settings: str) -> tuple[RunModel, tuple[Device, ...]]:
    """Return the run and its devices; equal definitions are loaded once."""
    key = (protocol, device, settings)
    if key not in _LOADED:
        (folder / "there.device.yaml").write_text(f"device: there\nprotocol: {protocol}\n{device}", encoding="utf-8")
        (folder / "r.run.yaml").write_text(RUN.format(protocol=protocol, settings=settings), encoding="utf-8")
        run = load_run(folder / "r.run.yaml")
        _LOADED[key] = run, tuple(devices_of(run.channels[1], folder))
    return _LOADED[key]


class CommandWorld:
    """The own memory, the device's memory, and execution of commands one after the other."""

    def __init__(
        self, folder: Path, protocol: str, device: str, settings: str = "", monitor: RunMonitor | None = None
    ) -> None:
        run, devices = loaded(folder, protocol, device, settings)
        self.clock = VirtualClock()
        with patch("framekit.service.channel.devices_of", lambda channel, folder: devices):
            self.service = RunService(run, self.clock, monitor)
        self.service.start()
        self.clock.run_for(SECOND)

    @property
    def there(self) -> DeviceService:
        return self.service.devices[0]

    def own(self, area: str, number: int, count: int = 1) -> list[int]:
        """Return elements of the own memory, counted from 1."""
        return self.service.memory.read(area, self.service.memory.area(area).unit, number - 1, count)

    def put(self, area: str, number: int, *values: int) -> None:
        self.service.memory.write(area, self.service.memory.area(area).unit, number - 1, values)

    def at(self, area: str, number: int, count: int = 1) -> list[int]:
        """Return elements of the device's memory, counted from 1."""
        return self.there.memory.read(area, self.there.memory.area(area).unit, number - 1, count)

    def fire(self, words: list[int], *, wait: int = 0, longest: int = 0, length: int | None = None) -> None:
        """Write a command block with these command words to R1 and start it."""
        self.put("R", STATUS, 0)
        head = [len(words) if length is None else length, wait, 8, STATUS - 1, 0, longest]
        self.put("R", 1, *head, *(word & 0xFFFF for word in words))
        self.service.fire(0)

    def do(self, *words: int, wait: int = 0, longest: int = 0, length: int | None = None) -> int:
        """Execute a command to its end; return the status word, 0 if none was written."""
        self.fire(list(words), wait=wait, longest=longest, length=length)
        for _ in range(120):
            self.clock.run_for(SECOND // 2)
            if not self.service.states[0].running:
                break
        return self.own("R", STATUS)[0]

    @property
    def fault(self) -> bool:
        return bool(self.own("M", FAULT)[0])


def text_words(text: str, size: int = 8) -> list[int]:
    """Return a text as words, the first character in the low byte."""
    data = text.encode("ascii").ljust(size, b"\0")
    return [int.from_bytes(data[at : at + 2], "little") for at in range(0, size, 2)]
