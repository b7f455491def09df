"""Simulated devices: an engine in its serving role, with a memory of its own, on a port."""

from __future__ import annotations

from framekit.blocks.device import Device
from framekit.codec.codec import compile_protocol
from framekit.definition.times import LineFormat
from framekit.link.engine import Engine
from framekit.link.observe import Monitor
from framekit.link.serving import MemoryServer
from framekit.service.driver import Driver
from framekit.service.memory_access import AddressedMemory
from framekit.transport.clock import Clock
from framekit.transport.port import Port


class DeviceService:
    """A device at work. Its memory can be read and written from outside at any time."""

    def __init__(
        self, device: Device, port: Port, clock: Clock, line: LineFormat | None, monitor: Monitor | None = None
    ) -> None:
        self.device = device
        self.memory = device.create_memory()
        codec = compile_protocol(device.protocol)
        self.server = MemoryServer(device.protocol, codec, self.memory)
        self.engine = Engine(
            device.protocol,
            codec,
            device.role,
            params=device.params,
            line=line,
            own=device.own,
            server=self.server,
            memory=AddressedMemory(self.memory, device.grammar),
            now=clock.now(),
            monitor=monitor,
        )
        self.driver = Driver(self.engine, port, clock)

    def start(self) -> None:
        self.driver.start()

    def stop(self) -> None:
        self.driver.stop()
