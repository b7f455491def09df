"""Mixed transfers between a client and our server on the bit-exact line, with a ledger of the expected memory content.

Every transfer must end: with the right data, or reported as failed. After a failed write, the content of its addresses
is unknown until the next successful write; all other addresses are compared on both sides.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from random import Random
from typing import Any

from line_faults import Faults

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.definition.times import parse_format
from framekit.link.engine import Engine
from framekit.link.services.client import ServiceClient, TransferResult
from framekit.link.services.server import MemoryServer
from framekit.memory.memory import DeviceMemory
from framekit.run.own_memory import AddressedMemory
from framekit.runfile.devices import memory_of
from framekit.service.driver import Driver
from framekit.transport.clock import VirtualClock
from framekit.transport.simulated_line import SimulatedLine

PATIENCE = 3600 * 1_000_000_000


class TransferWorld:
    """A client and a server of one protocol on one line."""

    def __init__(
        self,
        protocol: str,
        client_role: str,
        server_role: str,
        *,
        speed: int = 19200,
        line_format: str = "8O1",
        faults: Faults | None = None,
        params: dict[str, Any] | None = None,
        client_own: Any = None,
        server_own: Any = None,
        station: Any = None,
    ) -> None:
        self.protocol = load_protocol(protocol)
        self.codec = compile_protocol(self.protocol)
        self.clock = VirtualClock()
        self.settings = parse_format(line_format, speed)
        self.line = SimulatedLine(self.clock, self.settings, fault=faults)
        areas, self.grammar = memory_of(self.protocol)
        self.memory = DeviceMemory(areas)
        server = MemoryServer(self.protocol, self.codec, self.memory)
        self.server = self._engine(server_role, server_own, params, server)
        self.engine = self._engine(client_role, client_own, params, None)
        self.client = ServiceClient(self.protocol, self.codec, self.engine)
        self.engine.machine.ask_service = self.client.ask
        self.drivers = [
            Driver(self.server, self.line.port("server"), self.clock),
            Driver(self.engine, self.line.port("client"), self.clock),
        ]
        self.station = station
        self.outcomes: Counter[str] = Counter()
        self.wrong: list[str] = []
        for driver in self.drivers:
            driver.start()
        self.clock.run_for(0)

    def _engine(self, role: str, own: Any, params: dict[str, Any] | None, server: MemoryServer | None) -> Engine:
        return Engine(
            self.protocol, self.codec, role, params=params, line=self.settings, own=own, server=server,
            memory=AddressedMemory(self.memory, self.grammar), now=self.clock.now(),
        )  # fmt: skip

    def do(self, start: Callable[..., Any]) -> TransferResult:
        """Run a transfer to its end."""
        results: list[TransferResult] = []
        self.drivers[1].do(lambda now: start(now=now, on_done=results.append).commands)
        end = self.clock.now() + PATIENCE
        while not results and self.clock.now() < end:
            self.clock.run_for(10_000_000)
        assert results, "a transfer has not ended within an hour"
        self.outcomes[results[0].outcome or "ok"] += 1
        return results[0]

    # ---- transfers ----------------------------------------------------------------------------------------

    def mixed(self, transfers: int, places: dict[str, int], longest: int, seed: int = 1) -> None:
        """Make this number of reads and writes of up to `longest` elements.

        `places`: first address → number of elements.
        """
        random = Random(seed)
        known: dict[str, list[int | None]] = {address: [0] * size for address, size in places.items()}
        for _ in range(transfers):
            address = random.choice(list(places))
            count = 1 if random.random() < 0.2 else random.randint(1, min(longest, places[address]))
            place = self.protocol_address(address)
            if place.unit_bits == 1 and random.random() < 0.9:
                count = -(-count // 8) * 8  # whole bytes, mostly: the rest goes point by point
            if random.random() < 0.5:
                self._write(address, place, [random.getrandbits(place.unit_bits) for _ in range(count)], known[address])
            else:
                self._read(address, place, count, known[address])

    def protocol_address(self, text: str) -> Any:
        """Return the first of the places, in the client's notation."""
        return self.client.grammar.parse(text)

    def _write(self, text: str, place: Any, values: list[int], known: list[int | None]) -> None:
        result = self.do(lambda **keys: self.client.write(place, values, station=self.station, **keys))
        known[: len(values)] = values if result.ok else [None] * len(values)
        if result.ok:
            address = self.grammar.parse(text)
            if self.memory.read(address.area, address.unit, address.start, len(values)) != values:
                self.wrong.append(f"write of {len(values)} to {text} is not in the device")

    def _read(self, text: str, place: Any, count: int, known: list[int | None]) -> None:
        result = self.do(lambda **keys: self.client.read(place, count=count, station=self.station, **keys))
        address = self.grammar.parse(text)
        if result.ok and result.values != self.memory.read(address.area, address.unit, address.start, count):
            self.wrong.append(f"read of {count} from {text} is not what the device has")
        expected = known[:count]
        if result.ok and any(one not in (None, other) for one, other in zip(expected, result.values, strict=True)):
            self.wrong.append(f"read of {count} from {text} is not what was written")
