"""Where the ports of a run come from: real ones by their URL, simulated lines with their devices for `sim:`."""

from __future__ import annotations

from pathlib import Path

from framekit.codec.codec import compile_protocol
from framekit.definition.problems import DefinitionError, Problem
from framekit.definition.times import MOST_STATIONS
from framekit.link.frame_faults import FrameFaults
from framekit.link.scope import Scope
from framekit.run.model import Channel, FaultPlan
from framekit.runfile.devices import Device, load_devices
from framekit.service.device import DeviceService, stores_of
from framekit.service.faults import FaultInjector, FaultyPort
from framekit.transport.clock import Clock
from framekit.transport.port import Port
from framekit.transport.schemes import open_port
from framekit.transport.simulated_line import SimulatedLine, Transmission
from framekit.transport.wiring import wired

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
        DeviceService(store.device, line.port(store.device.name), clock, channel.line, store=store)
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
