"""Peers for the tests of the API: a device file, a pymodbus server in its own thread, a slow server."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from framekit.api.loop_thread import LoopThread

DEVICE = """
device: bench
protocol: {protocol}
station: 7
memory: {{set: {{{values}}}}}
"""
WORDS = "40001: [100, 200, 300], 00001: [1, 0, 1]"


def device_file(folder: Path, protocol: str = "modbus-rtu", values: str = WORDS) -> Path:
    path = folder / "bench.device.yaml"
    path.write_text(DEVICE.format(protocol=protocol, values=values), encoding="utf-8")
    return path


@contextmanager
def pymodbus_server() -> Iterator[str]:
    """Run a pymodbus server, device 1, whose register n holds 1000 + n; yield its port."""
    registers = SimData(0, values=[1000 + number for number in range(200)], datatype=DataType.REGISTERS)
    bits = SimData(0, values=[bool(number % 3) for number in range(64)], datatype=DataType.BITS)
    device = SimDevice(id=1, simdata=([bits], [bits], [registers], [registers]))
    thread = LoopThread("pymodbus")

    async def start() -> ModbusTcpServer:
        server = ModbusTcpServer(device, address=("127.0.0.1", 0))
        assert await server.listen()
        return server

    server = thread.wait(start())
    try:
        yield f"tcp://127.0.0.1:{server.transport.sockets[0].getsockname()[1]}"
    finally:
        thread.wait(server.shutdown())
        thread.stop()


class SlowServer:
    """Accept requests of 8 bytes; send each reply only when the test puts it into `replies`."""

    def __init__(self) -> None:
        self.requests: asyncio.Queue[bytes] = asyncio.Queue()
        self.replies: asyncio.Queue[bytes] = asyncio.Queue()
        self._server: asyncio.Server | None = None

    async def __aenter__(self) -> SlowServer:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = f"tcp://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                self.requests.put_nowait(await reader.readexactly(8))
                writer.write(await self.replies.get())
        except (asyncio.IncompleteReadError, ConnectionError):
            writer.close()
