"""Simulated devices: an engine in its serving role, with a memory of its own, on a port."""

from __future__ import annotations

from framekit.blocks.device import Device
from framekit.codec.codec import compile_protocol
from framekit.definition.times import LineFormat
from framekit.link.engine import Engine
from framekit.link.observe import Monitor
from framekit.link.serving import MemoryServer
from framekit.memory.clock_bits import SystemBits
from framekit.service.driver import Driver
from framekit.service.memory_access import AddressedMemory, RefreshedServer
from framekit.transport.clock import Clock
from framekit.transport.port import Port


class DeviceService:
    """A device at work. Its memory can be read and written from outside at any time."""

    def __init__(
        self, device: Device, port: Port, clock: Clock, line: LineFormat | None, monitor: Monitor | None = None
    ) -> None:
        self.device = device
        self.memory = device.create_memory()
        self.clock = clock
        self.system = self._system_bits()
        codec = compile_protocol(device.protocol)
        self.server = MemoryServer(device.protocol, codec, self.memory, mapping=device.mapping)
        self.engine = Engine(
            device.protocol,
            codec,
            device.role,
            params=device.params,
            line=line,
            own=device.own,
            server=RefreshedServer(self.server, self.refresh),
            memory=AddressedMemory(self.memory, device.grammar, self.refresh),
            now=clock.now(),
            monitor=monitor,
        )
        self.driver = Driver(self.engine, port, clock)

    def _system_bits(self) -> SystemBits | None:
        """The bits that the device's memory sets by itself; nobody waits for them."""
        profile = self.device.profile
        if profile is None or not (profile.clocks or profile.fixed):
            return None

        def locate(text: str) -> tuple[str, int]:
            address = self.device.grammar.parse(text)
            return address.area, address.first_bit

        return SystemBits(self.memory, profile, locate, ())

    def refresh(self) -> None:
        """Brings these bits up to date."""
        if self.system is not None:
            self.system.update(self.clock.now())

    def start(self) -> None:
        if self.system is not None:
            self.system.start(self.clock.now())
        self.driver.start()

    def stop(self) -> None:
        self.driver.stop()
