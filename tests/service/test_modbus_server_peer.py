"""Our simulated device under foreign masters: pymodbus's client over TCP and a pseudo-terminal, mbpoll where it is."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from pymodbus import FramerType
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient

from framekit.blocks.device import load_device
from framekit.definition.times import LineFormat
from framekit.service.device import DeviceService
from framekit.transport.clock import AsyncioClock
from framekit.transport.pty_pair import PtyPair
from framekit.transport.serial_port import SerialPort
from framekit.transport.tcp_port import AcceptedPort, TcpListener

DEVICE = """
device: bench
protocol: {protocol}
station: 1
memory: {{set: {{40001: [100, 200, 300], 30001: 7, 00001: [1, 0, 1]}}}}
"""


def device_file(folder: Path, protocol: str) -> Path:
    path = folder / "bench.device.yaml"
    path.write_text(DEVICE.format(protocol=protocol), encoding="utf-8")
    return path


@asynccontextmanager
async def tcp_device(folder: Path) -> AsyncIterator[int]:
    """A device for every connection; the port number it is reached at."""
    device = load_device(device_file(folder, "modbus-tcp"), folder)
    clock = AsyncioClock(asyncio.get_running_loop())
    services: list[DeviceService] = []

    def accepted(port: AcceptedPort) -> None:
        services.append(DeviceService(device, port, clock, None))
        services[-1].start()

    listener = TcpListener("127.0.0.1", 0, clock, accepted)
    try:
        yield await listener.start()
    finally:
        for service in services:
            service.stop()
        listener.stop()


async def exercise(client: AsyncModbusTcpClient | AsyncModbusSerialClient) -> None:
    assert await client.connect()
    assert (await client.read_holding_registers(0, count=3, device_id=1)).registers == [100, 200, 300]
    assert (await client.read_input_registers(0, count=1, device_id=1)).registers == [7]
    assert (await client.read_coils(0, count=3, device_id=1)).bits[:3] == [True, False, True]
    assert not (await client.write_registers(1, [7, 8], device_id=1)).isError()
    assert not (await client.write_register(0, 9, device_id=1)).isError()
    assert not (await client.write_coils(8, [True, True], device_id=1)).isError()
    assert (await client.read_holding_registers(0, count=3, device_id=1)).registers == [9, 7, 8]
    assert (await client.read_coils(8, count=2, device_id=1)).bits[:2] == [True, True]
    refused = await client.read_holding_registers(65535, count=2, device_id=1)
    assert refused.isError() and refused.exception_code == 2
    masked = await client.mask_write_register(address=0, and_mask=0xF0, or_mask=0x05, device_id=1)
    assert not masked.isError()
    client.close()


def test_pymodbus_over_tcp(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with tcp_device(tmp_path) as number, asyncio.timeout(20):
            await exercise(AsyncModbusTcpClient("127.0.0.1", port=number))

    asyncio.run(scenario())


@pytest.mark.parametrize(("protocol", "framer"), [("modbus-rtu", FramerType.RTU), ("modbus-ascii", FramerType.ASCII)])
def test_pymodbus_over_a_pty(tmp_path: Path, protocol: str, framer: FramerType) -> None:
    async def scenario() -> None:
        device = load_device(device_file(tmp_path, protocol), tmp_path)
        clock, line = AsyncioClock(asyncio.get_running_loop()), LineFormat(19200, parity="E")
        with PtyPair() as pair:
            service = DeviceService(device, SerialPort(pair.first, line, clock), clock, line)
            service.start()
            async with asyncio.timeout(20):
                await exercise(AsyncModbusSerialClient(pair.second, framer=framer, baudrate=19200))
            service.stop()

    asyncio.run(scenario())


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")
def test_mbpoll_over_tcp(tmp_path: Path) -> None:
    async def mbpoll(number: int, *words: str) -> str:
        process = await asyncio.create_subprocess_exec(
            "mbpoll", "-m", "tcp", "-p", str(number), "-1", "-a", "1", *words,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
        )  # fmt: skip
        output, _ = await process.communicate()
        assert process.returncode == 0, output.decode()
        return output.decode()

    async def scenario() -> None:
        async with tcp_device(tmp_path) as number, asyncio.timeout(20):
            read = await mbpoll(number, "-t", "4", "-r", "1", "-c", "3", "127.0.0.1")
            assert [line.split()[-1] for line in read.splitlines() if line.startswith("[")] == ["100", "200", "300"]
            assert "Written 2 references" in await mbpoll(number, "-t", "4", "-r", "10", "127.0.0.1", "17", "18")

    asyncio.run(scenario())
