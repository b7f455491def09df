"""Devices that answer: an engine in its serving role with a memory of its own, on a port; and lines of `sim:` ports.
`Serving` serves devices on a line, or on every connection that a listener accepts.

The data of a device are kept in a store, so that it can serve several connections at once. Over UDP each sender has a
device service of its own, as each connection has over TCP. Output is left to the callers' monitors.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from framekit.codec.codec import Codec, compile_protocol
from framekit.definition.problems import DefinitionError, Problem, error_text
from framekit.definition.times import MOST_STATIONS, NEVER, LineFormat
from framekit.link.engine import Engine
from framekit.link.events import LinkCounters, MemoryAccess, Monitor, RequestHandler, Seen
from framekit.link.frame_faults import FrameFaults
from framekit.link.scope import DeviceState, Scope
from framekit.link.services.server import MemoryServer, ServiceCounters
from framekit.memory.clock_bits import SystemBits
from framekit.run.behaviours import Behaving
from framekit.run.model import DEFAULT_LIMITS, Channel, ConnectionLimits, FaultPlan
from framekit.run.own_memory import AddressedMemory
from framekit.runfile.devices import Device, load_devices
from framekit.service.driver import Driver, LineLoad
from framekit.service.faults import FaultInjector, FaultyPort
from framekit.service.written import NamedMemory, NamedServer, WriteLog, begun_log, client_of
from framekit.transport.clock import Clock, date_at
from framekit.transport.network import NetworkListener
from framekit.transport.port import AcceptedPort, Port, PortEvents, PortListener, SharedPort
from framekit.transport.schemes import make_listener, open_port, scheme_of, without_files
from framekit.transport.simulated_line import SimulatedLine, Transmission
from framekit.transport.wiring import wired

log = logging.getLogger(__name__)


class DeviceStore:
    """The data of a device for all connections: memory, variables, clock, counters, the plan of its faults.

    `of_line` are the faults of its line, in addition to its own; injected faults are counted in `faults.injected`.

    With `access` it uses that memory and none of its own, with `server` another server answers; frames, bytes and
    services of all connections are counted in `link`, `load` and `counters`, if they are given. `writes`: the log of
    writes with their clients, if that log is on. `is_trial`: the device only measures exchanges, and logs no writes.
    """

    def __init__(
        self, device: Device, clock: Clock, of_line: FaultPlan | None = None, *, access: AddressedMemory | None = None,
        server: RequestHandler | None = None, link: LinkCounters | None = None, load: LineLoad | None = None,
        counters: ServiceCounters | None = None, writes: WriteLog | None = None, is_trial: bool = False,
    ) -> None:  # fmt: skip
        self.writes = writes
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
            self.writes = writes = None if is_trial else begun_log(device.name, device.protocol)
            refuses = None if self.faults is None else self.faults.refusal
            server = MemoryServer(
                device.protocol, codec, self.memory, mapping=device.mapping,
                refresh=None if self.system is None else self.refresh, refuses=refuses,
                counters=self.counters, read_only=device.read_only, written=None if writes is None else writes.note,
                kept=None if writes is None else writes.note_kept,
            )  # fmt: skip
        self.server = server
        if device.read_only and (set_anyway := device.protocol.set_by_sequences(device.role)):
            names = ", ".join(set_anyway)
            log.warning("%s only reads, but its sequences change variables by themselves: %s", device.name, names)
        if access is None:
            access = AddressedMemory(self.memory, device.grammar, self.refresh, read_only=device.read_only)
        self.access = access
        self._begun = False
        self.troubles: list[Callable[[str], None]] = []
        """The callbacks for failed expressions of behaviours."""
        self.behaving: Behaving | None = None
        if device.behaviours:
            self.behaving = Behaving(device.behaviours, self.memory, device.name, self._cannot)
            self._alarm = clock.alarm(self._behave)

    def _cannot(self, what: str) -> None:
        for callback in self.troubles:
            callback(what)

    def _behave(self) -> None:
        """Run the behaviours that are due."""
        assert self.behaving is not None
        self.behaving.tick(self.clock.now())
        self._alarm.set(self.behaving.deadline)

    def _injector(self, plan: FaultPlan, codec: Codec) -> FaultInjector:
        device = self.device
        scope = Scope(device.protocol, role=device.role, own=device.own, params=device.params)
        frames = FrameFaults(device.protocol, codec, scope, answers=True)
        return FaultInjector(plan, self.clock, frames, name=device.name)

    def _system_bits(self) -> SystemBits | None:
        """Return the bits that the device's memory sets by itself; they are computed when they are read."""
        profile = self.device.profile
        if profile is None or not (profile.clocks or profile.fixed or profile.calendar):
            return None

        def locate(text: str) -> tuple[str, int]:
            address = self.device.grammar.parse(text)
            return address.area, address.first_bit

        return SystemBits(self.memory, profile, locate, (), date_at(self.clock))

    def begin(self) -> None:
        """Begin the clock bits and behaviours, once; after an end only the behaviours continue."""
        if not self._begun and self.system is not None:
            self.system.start(self.clock.now())
        if self.behaving is not None:
            if not self._begun:
                self.behaving.begin(self.clock.now())
            self._alarm.set(self.behaving.deadline)
        self._begun = True

    def end(self) -> None:
        """Stop behaviours: the memory changes only by requests."""
        if self.behaving is not None:
            self._alarm.cancel()

    def refresh(self) -> None:
        """Bring the bits that the memory sets by itself up to date; they do not move before `begin`."""
        if self.system is not None and self._begun:
            self.system.update(self.clock.now())


def stores_of(
    devices: Sequence[Device | DeviceStore], clock: Clock, of_line: FaultPlan | None = None
) -> list[DeviceStore]:
    """Return a store for every device without one; a device over two protocols has one memory."""
    stores: list[DeviceStore] = []
    known: dict[str, AddressedMemory] = {}
    for one in devices:
        if isinstance(one, Device):
            one = DeviceStore(one, clock, of_line, access=known[one.name] if one.shares else None)
        known[one.device.name] = one.access
        stores.append(one)
    return stores


class DeviceService:
    """A device on a port. Its memory can be read and written from outside at any time.

    `store`: the data shared with the same device on other ports. `on_state` is called when the port opens or closes.
    `who`: returns the present client, for the log of writes. `on_fault` gets all records but frames, for instance
    failed expressions; `watch_troubles` gives the same in words. If a protocol has no services, each
    frame that is sent counts as a service.
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
        who: Callable[[], str] | None = None,
    ) -> None:
        self.device = device
        self.store = store = DeviceStore(device, clock) if store is None else store
        self.faults = store.faults
        self.memory = store.memory
        line_port = port if self.faults is None else FaultyPort(port, self.faults)
        server: RequestHandler = store.server
        access: MemoryAccess = store.access
        if store.writes is not None:
            asking = partial(client_of, port) if who is None else who
            server = NamedServer(server, store.writes, asking)
            access = NamedMemory(access, store.writes, asking)
        self.engine = Engine(
            device.protocol,
            compile_protocol(device.protocol),
            device.role,
            params=device.params,
            line=line,
            own=device.own,
            server=server,
            memory=access,
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
        """Call `told` with the reason of every failure of the device, for example of a request without a reply."""
        name = self.device.name

        def tell(seen: Seen) -> None:
            if seen.kind == "trouble":
                told(f"simulated device '{name}': {seen.reason}")

        self.engine.machine.on_fault = tell
        self.store.troubles.append(lambda what: told(f"simulated device '{name}': {what}"))

    def start(self) -> None:
        self.store.begin()
        self.driver.start()

    def stop(self) -> None:
        """Leave the port; the store may serve on other ports."""
        self.driver.stop()

    def end(self) -> None:
        """End the device, which is on this port only."""
        self.stop()
        self.store.end()


SIMULATED = "sim:"


def devices_of(channel: Channel, folder: Path) -> list[Device]:
    """Return the simulated devices that a channel's port names; an empty tuple for a real port.

    Raises DefinitionError.
    """
    if not channel.port.startswith(SIMULATED):
        return []
    problems: list[Problem] = []
    found: list[Device] = []
    for name in (part.strip() for part in channel.port.removeprefix(SIMULATED).split(",")):
        file = folder / name
        try:
            devices = load_devices(file if os.path.isfile(file) else name, folder)
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
    """Return a problem at the place in the run that names a device if its file is missing; other problems unchanged."""
    missing = problem.at.file == name and not problem.at.line
    return Problem(channel.port_at, problem.what, problem.todo) if missing else problem


def _same_station(device: Device, others: list[Device], channel: Channel) -> list[Problem]:
    """Return a problem for devices with the same station on the line of a channel."""
    found = []
    for other in others:
        if not device.shares and not other.shares and device.own is not None and other.own == device.own:
            what = f"the devices '{other.name}' and '{device.name}' have the same station {device.own}"
            found.append(Problem(channel.port_at, what, "give one of them another station"))
    return found


def _too_many(devices: list[Device], channel: Channel) -> list[Problem]:
    """Return a problem for more devices than this kind of line supports."""
    kind = channel.wiring.type
    count = sum(not device.shares for device in devices)
    if kind is None or count <= MOST_STATIONS[kind]:
        return []
    what = f"{count} devices on one {kind} line, which has room for {MOST_STATIONS[kind]}"
    return [Problem(channel.port_at, what, "use type: rs485, or more channels")]


def port_for(channel: Channel, devices: list[Device], clock: Clock) -> tuple[Port, list[DeviceService]]:
    """Return the port of a channel and the simulated devices on its line.

    Raises ValueError for a port of no known kind.
    """
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
    """Make the adapter of the channel receive its own transmissions."""
    transmission.echo = True


def _asking(channel: Channel, faults: FaultPlan, clock: Clock) -> FaultInjector:
    """Return the faults of the frames that the channel itself sends."""
    protocol = channel.protocol
    scope = Scope(protocol, role=channel.role, own=channel.own, line=channel.line, params=channel.params)
    frames = FrameFaults(protocol, compile_protocol(protocol), scope, answers=False)
    return FaultInjector(faults, clock, frames, answers=False, name=f"channel {channel.number}")


# ---- devices at work ----------------------------------------------------------------------------------------


ServingMonitor = Callable[[str, int, Seen], None]
"""Gets each record: the name of the port, the number of the device that made it, and the record."""

MOST_CONNECTIONS = 256
"""Largest number of connections at once; a further connection is closed at once."""

MOST_STRANGERS = 256
"""Largest number of refused addresses that are logged, each once."""


class Serving:
    """Serves devices that hear the same line. `wrap` may put another port around every port, to inject faults.

    `line_errors` counts bad frames by their cause, bytes of noise, and connections closed here; `turned_away` counts
    refused connections, if it is given.
    """

    def __init__(
        self,
        devices: Sequence[Device | DeviceStore],
        clock: Clock,
        line: LineFormat | None,
        monitor: ServingMonitor | None = None,
        *,
        wrap: Callable[[Port], Port] | None = None,
        limits: ConnectionLimits = DEFAULT_LIMITS,
        turned_away: Counter[str] | None = None,
    ) -> None:
        self.clock = clock
        self.line = line
        self.monitor = monitor
        self.wrap = wrap or (lambda port: port)
        self.stores = stores_of(devices, clock)
        self.connected: dict[Port, list[DeviceService]] = {}
        self._last_published: list[dict[str, Any]] = []
        """Published variables of each device at the end of the last connection."""
        self.line_errors: Counter[str] = Counter()
        self.turned_away = self.line_errors if turned_away is None else turned_away
        self.connections = 0
        self.limits = limits
        self.listener: PortListener | None = None
        self._own_port: Port | None = None
        self._hosts: dict[Port, str] = {}
        self._told: set[tuple[str, str]] = set()
        self._idle_alarm = clock.alarm(self._close_idle)
        for number, store in enumerate(self.stores):
            store.troubles.append(partial(self._trouble, number))

    # ---- ports --------------------------------------------------------------------------------------------

    def serve(self, port: Port) -> None:
        """Serve on a port until `stop`; the port is opened, and opened again when it is lost."""
        self._begin_stores()
        self._begin(port, lambda state: None)

    async def begin(self, url: str) -> tuple[str, str]:
        """Listen at `url`, or open that port. Raises ValueError for an unknown port, OSError.

        Return the address of the port as clients have to name it, and a description with the line's settings.
        """
        self._begin_stores()
        url = self.stores[0].device.protocol.line.port_of(url)
        kind = scheme_of(url)
        if kind is not None and kind.listen is not None:
            listener = await self.listen(url)
            return listener.reached, listener.reached
        self._own_port = port = open_port(url, self.line, self.clock, serves=True)
        first_state: asyncio.Future[str] = asyncio.get_running_loop().create_future()

        def state(text: str) -> None:
            if not first_state.done():
                first_state.set_result(text)

        self._begin(port, state)
        reached = await first_state
        if reached != "open":
            raise OSError(reached if url in reached else f"{url}: {reached}")
        return port.name, port.describes()

    def _begin_stores(self) -> None:
        """Begin the memories of the devices, which run without connections too."""
        for store in self.stores:
            store.begin()

    def _trouble(self, number: int, what: str) -> None:
        """Report the failed behaviour of a device to the monitor, without a connection."""
        seen = Seen("", "trouble", self.clock.now(), reason=what)
        self._count_fault(number, seen)
        if self.monitor is not None:
            self.monitor("", number, seen)

    async def listen(self, url: str) -> PortListener:
        """Serve every connection to `url`, over UDP every sender separately. Raises ValueError, OSError."""
        self.listener = listener = make_listener(url, self.clock, self.accept)
        if isinstance(listener, NetworkListener):
            listener.admits, listener.refused = self.admits, self.refused
        await listener.start()
        return listener

    def accept(self, port: AcceptedPort) -> None:
        """Serve a connection, or close it if its client is not allowed or there are too many connections."""
        if not self.admits(port.host):
            port.close()
            return
        if not self._has_room(port):
            self.refused(port.host)
            port.close()
            return
        self.connections += 1
        self._hosts[port] = port.host

        def state(text: str) -> None:
            if text != "open":
                self.clock.call_soon(lambda: self._end(port))

        self._begin(port, state)
        self._set_idle_alarm()

    def admits(self, host: str) -> bool:
        """Return whether a client with that address is allowed; a refused client is counted, and logged once."""
        if self.limits.lets_in(host):
            return True
        self.turned_away["clients not allowed"] += 1
        self._log_once(host, "%s is not allowed as a client: closed; it is counted from now on")
        return False

    def refused(self, host: str) -> None:
        """Count a connection refused because of too many others, and log it once an address."""
        self.turned_away["connections refused"] += 1
        self._log_once(host, "%s has too many connections: connections refused; they are counted from now on")

    def _log_once(self, host: str, what: str) -> None:
        if (host, what) not in self._told and len(self._told) < MOST_STRANGERS:
            self._told.add((host, what))
            log.warning(what, host)

    def _has_room(self, port: AcceptedPort) -> bool:
        """Return whether a further connection may be served.

        A sender of datagrams never ends by itself: a new sender takes the place of an old one.
        """
        in_the_way = [one for one, host in self._hosts.items() if host == port.host]
        if len(in_the_way) < self.limits.per_address:
            if len(self._hosts) < MOST_CONNECTIONS:
                return True
            in_the_way = list(self._hosts)
        if not port.ends_itself:
            self._end(min(in_the_way, key=self._last_frame))
        return not port.ends_itself

    def _last_frame(self, port: Port) -> int:
        """Return the time of the last good frame on a connection; at first the time of its opening."""
        return max(service.engine.machine.last_frame for service in self.connected[port])

    def _set_idle_alarm(self) -> None:
        oldest = min(map(self._last_frame, self._hosts), default=NEVER)
        self._idle_alarm.set(NEVER if oldest == NEVER else oldest + self.limits.idle)

    def _close_idle(self) -> None:
        """Close the connections that had no good frame for too long."""
        since = self.clock.now() - self.limits.idle
        for port in sorted((port for port in self._hosts if self._last_frame(port) <= since), key=self._last_frame):
            self.line_errors["idle connections closed"] += 1
            self._end(port)
        self._set_idle_alarm()

    def _begin(self, port: Port, on_state: Callable[[str], None]) -> None:
        wrapped = self.wrap(port)
        shared = None if len(self.stores) == 1 else SharedPort(wrapped, self.clock)
        services = []
        for number, store in enumerate(self.stores):
            services.append(
                DeviceService(
                    store.device,
                    wrapped if shared is None else shared.user(),
                    self.clock,
                    self.line,
                    self._shown_to(port, number),
                    on_fault=partial(self._count_fault, number),
                    store=store,
                    on_state=on_state if number == 0 else None,
                    who=partial(client_of, port),
                )
            )
        self.connected[port] = services
        for service in services:
            service.start()

    def _shown_to(self, port: Port, number: int) -> Callable[[Seen], None] | None:
        monitor, name = self.monitor, port.name
        if monitor is None:
            return None

        def shown(seen: Seen) -> None:
            seen.client = port.sender
            monitor(name, number, seen)

        return shown

    def _count_fault(self, number: int, seen: Seen) -> None:
        """Count faults of the line once, although all devices hear them; bytes that a bad frame left belong to it."""
        if seen.kind == "trouble":
            self.line_errors["could not be worked out"] += 1
        elif number == 0 and seen.kind == "bad":
            self.line_errors[f"bad frame: {seen.reason}"] += 1
        elif number == 0 and seen.kind == "noise" and not seen.reason:
            self.line_errors["bytes of noise"] += len(seen.raw)

    def _end(self, port: Port) -> None:
        """End a connection, which cannot be opened again; its client may open a new one."""
        self._hosts.pop(port, None)
        services = self.connected.pop(port, [])
        if services and not self.connected:
            self._last_published = [service.engine.status() for service in services]
        for service in services:
            service.stop()

    def stop(self) -> None:
        """Stop accepting, and close all ports."""
        if self.listener is not None:
            self.listener.stop()
        self._idle_alarm.cancel()
        for store in self.stores:
            store.end()
        for port in list(self.connected):
            self._end(port)
        if self._own_port is not None:
            self._own_port.release()

    # ---- status -------------------------------------------------------------------------------------------

    def published(self, number: int) -> dict[str, Any]:
        """Return the published variables of a device, those of scope line or session from its latest connection."""
        services = next(reversed(self.connected.values()), None)
        if services is not None:
            return services[number].engine.status()
        return self._last_published[number] if self._last_published else {}


def check_line(devices: list[Device]) -> None:
    """Raise ValueError with a sentence if the devices cannot share a line."""
    alone = [device for device in devices if not device.shares]
    for number, device in enumerate(alone):
        others = alone[:number]
        if any(device.own is not None and device.own == other.own for other in others):
            raise ValueError(f"two devices have the station {device.own} – give one of them another")
        if others and not set(device.protocol.sources) & set(others[0].protocol.sources):
            protocols = f"{others[0].protocol.name} and {device.protocol.name}"
            raise ValueError(f"{protocols} can't share a line – serve them on two ports")
    if len(alone) > 1 and any(device.own is None for device in alone):
        raise ValueError("several devices on one line need stations – add station to their files")


class ListeningPort(Port):
    """Listens at the address of `channel`. Raises ValueError for an unknown address, and if the clock is not real."""

    def __init__(self, channel: Channel, clock: Clock) -> None:
        self.listener = make_listener(channel.port, clock, self._accept)
        self.channel = channel
        self.clock = clock
        self.name = without_files(channel.port)
        self.settings = None
        self.serving: Serving | None = None

    def answer(
        self, access: AddressedMemory, server: RequestHandler | None, monitor: Monitor | None, counters: LinkCounters,
        load: LineLoad, services: ServiceCounters, writes: WriteLog | None, turned_away: Counter[str],
    ) -> None:  # fmt: skip
        """Serve connections from this memory by this server from now on, with these counters and logs."""
        channel = self.channel
        device = Device(
            name=f"channel {channel.number}", protocol=channel.protocol, role=channel.role, own=channel.own,
            params=channel.params, areas=(), grammar=access.grammar, profile=None, mapping=channel.mapping, initial=(),
        )  # fmt: skip
        store = DeviceStore(
            device, self.clock, access=access, server=server, link=counters, load=load, counters=services,
            writes=writes,
        )  # fmt: skip
        watch = None if monitor is None else lambda port, number, seen: monitor(seen)
        self.serving = serving = Serving(
            [store], self.clock, channel.line, watch, limits=channel.limits, turned_away=turned_away
        )
        if isinstance(self.listener, NetworkListener):
            self.listener.admits, self.listener.refused = serving.admits, serving.refused

    def _accept(self, port: AcceptedPort) -> None:
        assert self.serving is not None
        self.serving.accept(port)

    def open(self, events: PortEvents) -> None:
        now = self.clock.now()
        try:
            self.listener.listen()
        except OSError as error:
            reason = f"{self.listener.name}: {error_text(error)}"
            self.clock.call_soon(lambda: events.closed(now, reason))
            return
        self.name = self.listener.name
        self.clock.call_soon(lambda: events.opened(now))

    def write(self, data: bytes) -> None:
        """Ignore the bytes: the port itself has no sender."""

    def close(self) -> None:
        self.listener.stop()
        if self.serving is not None:
            self.serving.stop()

    def send_break(self, duration: int) -> None:
        """Ignore the break: the port itself has no sender."""
