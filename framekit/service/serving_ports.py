"""Where devices are served: a listener where the port's kind has one, else the port itself."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
from dataclasses import dataclass

from framekit.definition.times import LineFormat, parse_format
from framekit.runfile.devices import Device
from framekit.service.serving import Serving
from framekit.transport.clock import AsyncioClock
from framekit.transport.schemes import open_port, scheme_of


@dataclass(frozen=True, slots=True)
class ServedAt:
    """Where it is served: `port`, as others have to name it, and `about`, for people, with the line's settings."""

    port: str
    about: str


def check_line(devices: list[Device]) -> None:
    """Whether devices can share a line. Raises ValueError with a sentence."""
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


def line_of(device: Device, speed: int | None, format: str | None) -> LineFormat | None:
    """The line's settings, the protocol's own where nothing is given. Raises ValueError with a sentence."""
    line = device.protocol.line
    if line.kind == "stream":
        if speed is not None or format is not None:
            raise ValueError(f"{device.protocol.name} runs on connections, which have neither speed nor format")
        return None
    return parse_format(format or line.format, line.speed if speed is None else speed)


async def begin_serving(
    url: str, serving: Serving, clock: AsyncioClock, first_state: asyncio.Future[str], stack: ExitStack
) -> ServedAt:
    """Opens the port, or begins to listen. `first_state` is what the serving tells first of its port.

    What has to be closed at the end goes on the stack. Raises ValueError for what is no port, OSError.
    """
    url = serving.stores[0].device.protocol.line.port_of(url)
    kind = scheme_of(url)
    if kind is not None and kind.listen is not None:
        listener = await serving.listen(url)
        return ServedAt(listener.reached, listener.reached)
    port = open_port(url, serving.line, clock, serves=True)
    stack.callback(port.release)
    serving.serve(port)
    reached = await first_state
    if reached != "open":
        raise OSError(reached if url in reached else f"{url}: {reached}")
    return ServedAt(port.name, port.describes())
