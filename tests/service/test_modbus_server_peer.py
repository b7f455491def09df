"""Our server with other masters: pymodbus, minimalmodbus and, if it is installed, mbpoll; TCP and terminals."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import minimalmodbus
import pytest
from pymodbus import FramerType
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient

from framekit.definition.times import LineFormat
from framekit.runfile.devices import DeviceSettings, load_devices
from framekit.service.device import Serving
from framekit.transport.clock import AsyncioClock
from framekit.transport.pty_port import PtyPair
from framekit.transport.serial_port import SerialPort

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
    """Serve the device for every connection; yield the port number."""
    serving = Serving(
        load_devices(device_file(folder, "modbus-tcp"), folder), AsyncioClock(asyncio.get_running_loop()), None
    )
    try:
        yield (await serving.listen("tcp://127.0.0.1:0")).number
    finally:
        serving.stop()


@asynccontextmanager
async def pty_device(folder: Path, protocol: str) -> AsyncIterator[tuple[str, Serving]]:
    """Serve the device, with Snet's limits and stations 1 and 2, at a terminal; yield the path of the other end."""
    given = DeviceSettings(stations=("1", "2"), params={"limit_write_words": "120"})
    devices = load_devices(device_file(folder, protocol), folder, given)
    clock, line = AsyncioClock(asyncio.get_running_loop()), LineFormat(19200, parity="E")
    with PtyPair() as pair:
        serving = Serving(devices, clock, line)
        serving.serve(SerialPort(pair.first, line, clock))
        try:
            yield pair.second, serving
        finally:
            serving.stop()


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
    assert not (await client.write_coils(100, [True, False] * 984, device_id=1)).isError()
    assert (await client.read_coils(100, count=1968, device_id=1)).bits[:1968] == [True, False] * 984
    client.close()


def test_pymodbus_over_tcp(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with tcp_device(tmp_path) as number, asyncio.timeout(180):
            await exercise(AsyncModbusTcpClient("127.0.0.1", port=number))

    asyncio.run(scenario())


@pytest.mark.parametrize(("protocol", "framer"), [("modbus-rtu", FramerType.RTU), ("modbus-ascii", FramerType.ASCII)])
def test_pymodbus_over_a_pty(tmp_path: Path, protocol: str, framer: FramerType) -> None:
    async def scenario() -> None:
        async with pty_device(tmp_path, protocol) as (path, serving), asyncio.timeout(180):
            await exercise(AsyncModbusSerialClient(path, framer=framer, baudrate=19200))
            client = AsyncModbusSerialClient(path, framer=framer, baudrate=19200)
            await client.connect()
            await client.write_register(20, 0x1234, device_id=0, no_response_expected=True)
            while any(store.memory.read("holding", "word", 20) != [0x1234] for store in serving.stores):
                await asyncio.sleep(0)  # all stations execute a broadcast, and none answers
            assert (await client.read_holding_registers(20, count=1, device_id=2)).registers == [0x1234]
            client.close()

    asyncio.run(scenario())


def all_functions(instrument: minimalmodbus.Instrument) -> None:
    """Test every function of the Snet server, at its limits and beyond them."""
    assert instrument.read_registers(0, 3) == [100, 200, 300]
    assert instrument.read_registers(0, 1, functioncode=4) == [7]
    assert instrument.read_bits(0, 3, functioncode=1) == [1, 0, 1]
    assert instrument.read_bits(0, 2000, functioncode=1)[:3] == [1, 0, 1]
    assert instrument.read_bits(0, 9, functioncode=2) == [0] * 9
    instrument.write_bit(7, 1, functioncode=5)
    instrument.write_bits(100, [1, 0] * 60)  # the largest write that minimalmodbus allows
    assert instrument.read_bits(7, 1, functioncode=1) == [1]
    assert instrument.read_bits(100, 120, functioncode=1) == [1, 0] * 60
    instrument.write_register(9, 0xBEEF, functioncode=6)
    instrument.write_registers(200, list(range(120)))
    assert instrument.read_registers(200, 125) == [*range(120), 0, 0, 0, 0, 0]
    assert instrument.read_register(9) == 0xBEEF
    instrument.write_float(300, 2.5)
    assert instrument.read_float(300) == 2.5
    assert instrument.serial is not None
    instrument.serial.timeout = 1  # a refusal is shorter than the reply that it waits for
    with pytest.raises(minimalmodbus.IllegalRequestError):
        instrument.read_registers(65535, 2)
    with pytest.raises(minimalmodbus.IllegalRequestError):
        instrument.write_registers(0, [0] * 121)
    assert instrument.read_registers(0, 3) == [100, 200, 300], "what is refused changes nothing"


@pytest.mark.parametrize(("protocol", "mode"), [("modbus-rtu", "rtu"), ("modbus-ascii", "ascii")])
def test_minimalmodbus_over_a_pty(tmp_path: Path, protocol: str, mode: str) -> None:
    def exercised(path: str) -> None:
        instrument = minimalmodbus.Instrument(path, 1, mode=mode, close_port_after_each_call=False)
        assert instrument.serial is not None
        instrument.serial.baudrate, instrument.serial.timeout = 19200, 5
        all_functions(instrument)
        other = minimalmodbus.Instrument(path, 2, mode=mode)
        assert other.read_registers(9, 1) == [0], "another station has a memory of its own"
        instrument.serial.close()

    async def scenario() -> None:
        async with pty_device(tmp_path, protocol) as (path, serving), asyncio.timeout(180):
            await asyncio.to_thread(exercised, path)
            refused = [dict(store.counters.refused) for store in serving.stores]
            assert refused == [{2: 1, 3: 1}, {}] and not serving.line_errors

    asyncio.run(scenario())


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")
@pytest.mark.parametrize("kind", ["tcp", "rtu"])
def test_mbpoll(tmp_path: Path, kind: str) -> None:
    async def mbpoll(line: list[str], place: str, options: list[str], *values: str) -> tuple[int | None, str]:
        process = await asyncio.create_subprocess_exec(
            "mbpoll", *line, "-1", "-a", "1", *options, place, *values,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
        )  # fmt: skip
        output, _ = await process.communicate()
        return process.returncode, output.decode()

    async def exercised(line: list[str], place: str) -> None:
        for table, count, values in (
            ("4", "3", "100 200 300"),
            ("3", "1", "7"),
            ("0", "3", "1 0 1"),
            ("1", "2", "0 0"),
        ):
            status, output = await mbpoll(line, place, ["-t", table, "-r", "1", "-c", count])
            found = [row.split()[-1] for row in output.splitlines() if row.startswith("[")]
            assert (status, found) == (0, values.split()), output
        status, output = await mbpoll(line, place, ["-t", "4", "-r", "10"], "17", "18")
        assert status == 0 and "Written 2 references" in output, output
        status, output = await mbpoll(line, place, ["-t", "0", "-r", "30"], "1", "1", "0")
        assert status == 0 and "Written 3 references" in output, output
        status, output = await mbpoll(line, place, ["-t", "4", "-r", "65536", "-c", "2"])
        assert "Illegal data address" in output, output

    async def scenario() -> None:
        async with asyncio.timeout(180):
            if kind == "tcp":
                async with tcp_device(tmp_path) as number:
                    await exercised(["-m", "tcp", "-p", str(number)], "127.0.0.1")
            else:
                async with pty_device(tmp_path, "modbus-rtu") as (path, _):
                    await exercised(["-m", "rtu", "-b", "19200", "-P", "none"], path)

    asyncio.run(scenario())
