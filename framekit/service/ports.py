"""Where the ports of a run come from: real ones by their URL, simulated lines with their devices for `sim:`."""

from __future__ import annotations

from pathlib import Path

from framekit.blocks.device import Device, load_device
from framekit.blocks.model import Channel
from framekit.definition.load.reader import Reader
from framekit.definition.problems import DefinitionError, Problem
from framekit.service.device import DeviceService
from framekit.transport.clock import Clock
from framekit.transport.open_port import open_port
from framekit.transport.port import Port
from framekit.transport.simulated import SimulatedLine

SIMULATED = "sim:"


def devices_of(channel: Channel, folder: Path) -> list[Device]:
    """The simulated devices a channel's port names; none for a real port. Raises DefinitionError."""
    if not channel.port.startswith(SIMULATED):
        return []
    reader = Reader()
    found: list[Device] = []
    for name in channel.port.removeprefix(SIMULATED).split(","):
        file = folder / name.strip()
        try:
            found.append(load_device(file if file.is_file() else name.strip(), folder))
        except DefinitionError as error:
            reader.problems += [_here(problem, channel) for problem in error.problems]
    if reader.problems:
        raise DefinitionError(reader.problems)
    return found


def _here(problem: Problem, channel: Channel) -> Problem:
    """A device that is not there is the fault of the run that names it."""
    missing = problem.at.line == 1 and "there is no" in problem.what
    return Problem(channel.at, problem.what, problem.todo) if missing else problem


def port_for(channel: Channel, devices: list[Device], clock: Clock) -> tuple[Port, list[DeviceService]]:
    """The port of a channel and the simulated devices on its line. Raises ValueError for a port of no known kind."""
    if not devices:
        return open_port(channel.port, channel.line, clock), []
    line = SimulatedLine(clock, channel.line)
    services = [DeviceService(device, line.port(device.name), clock, channel.line) for device in devices]
    return line.port(f"channel {channel.number}"), services
