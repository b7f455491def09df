"""A simulated device on a real TCP port or terminal, for independent programs that block while they wait."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from framekit.definition.times import LineFormat
from framekit.runfile.devices import load_devices
from framekit.service.device import Serving
from framekit.transport.clock import AsyncioClock
from framekit.transport.pty_port import PtyPair
from framekit.transport.serial_port import SerialPort

WAIT = 60
"""Seconds that a peer may take in total."""


@asynccontextmanager
async def tcp_device(folder: Path, text: str) -> AsyncIterator[tuple[int, Serving]]:
    """Serve a device file with this text over TCP; yield its port number and the serving object."""
    path = folder / "peer.device.yaml"
    path.write_text(text, encoding="utf-8")
    serving = Serving(load_devices(path, folder), AsyncioClock(asyncio.get_running_loop()), None)
    try:
        yield (await serving.listen("tcp://127.0.0.1:0")).number, serving
    finally:
        serving.stop()


@asynccontextmanager
async def pty_device(folder: Path, text: str, line: LineFormat) -> AsyncIterator[tuple[str, Serving]]:
    """Serve a device file with this text at a terminal; yield the path of the other end and the serving object."""
    path = folder / "peer.device.yaml"
    path.write_text(text, encoding="utf-8")
    clock = AsyncioClock(asyncio.get_running_loop())
    with PtyPair() as pair:
        serving = Serving(load_devices(path, folder), clock, line)
        serving.serve(SerialPort(pair.first, line, clock))
        try:
            yield pair.second, serving
        finally:
            serving.stop()


async def at_work(peer: Callable[..., None], *arguments: Any) -> None:
    """Run a blocking function in its own thread. Raises its exceptions, and TimeoutError after `WAIT` seconds."""
    async with asyncio.timeout(WAIT):
        await asyncio.to_thread(peer, *arguments)
