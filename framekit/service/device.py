"""Simulated devices: an engine in its serving role, with a memory of its own, on a port; and the lines of `sim:` ports.

What a device keeps lies in a store, so that it can serve several connections at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from framekit.codec.codec import Codec, compile_protocol
from framekit.definition.problems import DefinitionError, Problem
from framekit.definition.times import MOST_STATIONS, LineFormat
from framekit.link.engine import Engine
from framekit.link.events import LinkCounters, Monitor, Seen
from framekit.link.exchange import RequestHandler
from framekit.link.frame_faults import FrameFaults
from framekit.link.scope import DeviceState, Scope
from framekit.link.services.server import MemoryServer, ServiceCounters
from framekit.memory.clock_bits import SystemBits
from framekit.run.model import Channel, FaultPlan
from framekit.run.own_memory import AddressedMemory
from framekit.runfile.devices import Device, load_devices
from framekit.service.driver import Driver, LineLoad
from framekit.service.faults import FaultInjector, FaultyPort
from framekit.transport.clock import Clock, date_at
from framekit.transport.port import Port
from framekit.transport.schemes import open_port
from framekit.transport.simulated_line import SimulatedLine, Transmission
from framekit.transport.wiring import wired


class DeviceStore:
    """What a device keeps over all connections: memory, variables, clock, counters, the plan of its faults.

    `of_line` are the faults of its line, beside its own; what is done of them is counted in `faults.injected`.

    With `access` it has that memory and none of its own, with `server` others answer for it; frames, bytes and services
    of all connections are counted in `link`, `load` and `counters`, where they are given.
    """

    def __init__(
        self, device: Device, clock: Clock, of_line: FaultPlan | None = None, *, access: AddressedMemory | None = None,
        server: RequestHandler | None = None, link: LinkCounters | None = None, load: LineLoad | None = None,
        counters: ServiceCounters | None = None,
    ) -> None:  # fmt: skip
        self.device = device
        self.clock = clock
        self.link, self.load = link, load
        self.memory = device.create_memory() if access is None else access.memory
        self.state = DeviceState()
        self.counters = ServiceCounters() if counters is None else counters
        self.system = self._system_bits() if access is None else None
        codec = compile_protocol(device.protocol)
        plan = of_line if device.faults is None else device.faults.joined(of_line)
        self.faults = None if plan is None else self._injector(plan, codec)
        if server is None:
            refuses = None if self.faults is None else self.faults.refusal
            server = MemoryServer(
                device.protocol, codec, self.memory, mapping=device.mapping,
                refresh=None if self.system is None else self.refresh, refuses=refuses,
                counters=self.counters,
            )  # fmt: skip
        self.server = server
        self.access = AddressedMemory(self.memory, device.grammar, self.refresh) if access is None else access
        self._begun = False

    def _injector(self, plan: FaultPlan, codec: Codec) -> FaultInjector:
        device = self.device
        scope = Scope(device.protocol, role=device.role, own=device.own, params=device.params)
        frames = FrameFaults(device.protocol, codec, scope, answers=True)
        return FaultInjector(plan, self.clock, frames, name=device.name)

    def _system_bits(self) -> SystemBits | None:
        """The bits that the device's memory sets by itself; nothing waits for them."""
        profile = self.device.profile
        if profile is None or not (profile.clocks or profile.fixed or profile.calendar):
            return None

        def locate(text: str) -> tuple[str, int]:
            address = self.device.grammar.parse(text)
            return address.area, address.first_bit

        return SystemBits(self.memory, profile, locate, (), date_at(self.clock))

    def begin(self) -> None:
        """The clock bits begin to run, once."""
        if self.system is not None and not self._begun:
            self.system.start(self.clock.now())
        self._begun = True

    def refresh(self) -> None:
        """Brings these bits up to date; they do not move before `begin`."""
        if self.system is not None and self._begun:
            self.system.update(self.clock.now())


def stores_of(
    devices: Sequence[Device | DeviceStore], clock: Clock, of_line: FaultPlan | None = None
) -> list[DeviceStore]:
    """A store for every device that has none yet; a device over two protocols has one memory."""
    stores: list[DeviceStore] = []
    known: dict[str, AddressedMemory] = {}
    for one in devices:
        if isinstance(one, Device):
            one = DeviceStore(one, clock, of_line, access=known[one.name] if one.shares else None)
        known[one.device.name] = one.access
        stores.append(one)
    return stores


class DeviceService:
    """A device at work on one port. Its memory can be read and written from outside at any time.

    `store`: what it shares with the same device on other ports. `on_state` is told when the port opens or closes.
    `on_fault` is shown all but frames, for instance what
    could not be worked out; `watch_troubles` does the same in words. Where a protocol has no services, each frame that
    goes out counts as one.
    """

    def __init__(
        self,
        device: Device,
        port: Port,
        clock: Clock,
        line: LineFormat | None,
        monitor: Monitor | None = None,
        *,
        on_fault: Monitor | None = None,
        store: DeviceStore | None = None,
        on_state: Callable[[str], None] | None = None,
    ) -> None:
        self.device = device
        self.store = store = DeviceStore(device, clock) if store is None else store
        self.faults = store.faults
        self.memory = store.memory
        line_port = port if self.faults is None else FaultyPort(port, self.faults)
        self.engine = Engine(
            device.protocol,
            compile_protocol(device.protocol),
            device.role,
            params=device.params,
            line=line,
            own=device.own,
            server=store.server,
            memory=store.access,
            now=clock.now(),
            monitor=monitor,
            on_fault=on_fault,
            on_send=None if device.protocol.services else store.counters.count,
            device=store.state,
            counters=store.link,
            is_stream=line_port.is_stream,
        )
        self.driver = Driver(self.engine, line_port, clock, on_state)
        if store.load is not None:
            self.driver.load = store.load

    def watch_troubles(self, told: Callable[[str], None]) -> None:
        """From now on `told` hears why the device cannot do what it should; a request that has no reply is one case."""
        name = self.device.name

        def tell(seen: Seen) -> None:
            if seen.kind == "trouble":
                told(f"simulated device '{name}': {seen.reason}")

        self.engine.machine.on_fault = tell

    def start(self) -> None:
        self.store.begin()
        self.driver.start()

    def stop(self) -> None:
        self.driver.stop()


SIMULATED = "sim:"


def devices_of(channel: Channel, folder: Path) -> list[Device]:
    """The simulated devices a channel's port names; none for a real port. Raises DefinitionError."""
    if not channel.port.startswith(SIMULATED):
        return []
    problems: list[Problem] = []
    found: list[Device] = []
    for name in (part.strip() for part in channel.port.removeprefix(SIMULATED).split(",")):
        file = folder / name
        try:
            devices = load_devices(file if file.is_file() else name, folder)
        except DefinitionError as error:
            problems += [_here(problem, name, channel) for problem in error.problems]
            continue
        spoken = any(set(device.protocol.sources) & set(channel.protocol.sources) for device in devices)
        for device in devices:
            if not device.shares and not spoken:
                what = f"the device '{device.name}' speaks {device.protocol.name}, this channel {channel.protocol.name}"
                problems.append(Problem(channel.port_at, what, "name a device of that protocol"))
            problems += _same_station(device, found, channel)
            found.append(device)
    problems += _too_many(found, channel)
    if problems:
        raise DefinitionError(problems)
    return found


def _here(problem: Problem, name: str, channel: Channel) -> Problem:
    """A device that is not there is the fault of the run that names it."""
    missing = problem.at.file == name
    return Problem(channel.port_at, problem.what, problem.todo) if missing else problem


def _same_station(device: Device, others: list[Device], channel: Channel) -> list[Problem]:
    """Devices of one station on the line of a channel."""
    found = []
    for other in others:
        if not device.shares and not other.shares and device.own is not None and other.own == device.own:
            what = f"the devices '{other.name}' and '{device.name}' have the same station {device.own}"
            found.append(Problem(channel.port_at, what, "give one of them another station"))
    return found


def _too_many(devices: list[Device], channel: Channel) -> list[Problem]:
    """More devices than this kind of line can have."""
    kind = channel.wiring.type
    count = sum(not device.shares for device in devices)
    if kind is None or count <= MOST_STATIONS[kind]:
        return []
    what = f"{count} devices on one {kind} line, which has room for {MOST_STATIONS[kind]}"
    return [Problem(channel.port_at, what, "use type: rs485, or more channels")]


def port_for(channel: Channel, devices: list[Device], clock: Clock) -> tuple[Port, list[DeviceService]]:
    """The port of a channel and the simulated devices on its line. Raises ValueError for a port of no known kind."""
    if not devices:
        return open_port(channel.port, channel.line, clock, channel.wiring), []
    line = SimulatedLine(clock, channel.line, full_duplex=not channel.wiring.half_duplex)
    faults = None if channel.faults is None else channel.faults.of_line()
    services = [
        DeviceService(store.device, line.port(store.device.name, in_time=True), clock, channel.line, store=store)
        for store in stores_of(devices, clock, faults)
    ]
    port = line.port(f"channel {channel.number}")
    if channel.wiring.echo:
        port.fault = _echo
    asking = port if faults is None else FaultyPort(port, _asking(channel, faults, clock))
    return wired(asking, channel.wiring, clock), services


def _echo(transmission: Transmission) -> None:
    """The adapter of the channel hears what it sends."""
    transmission.echo = True


def _asking(channel: Channel, faults: FaultPlan, clock: Clock) -> FaultInjector:
    """The faults of what the channel itself sends."""
    protocol = channel.protocol
    scope = Scope(protocol, role=channel.role, own=channel.own, line=channel.line, params=channel.params)
    frames = FrameFaults(protocol, compile_protocol(protocol), scope, answers=False)
    return FaultInjector(faults, clock, frames, answers=False, name=f"channel {channel.number}")
