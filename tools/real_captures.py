"""Record other programs at work: their communication over real terminals and sockets.

`PYTHONPATH=tests python tools/real_captures.py [NAME…]` writes tests/data/guess/NAME.pcap, without a name all of them,
and the README in the same folder. It needs framekit with its extra `test`, the programs of `NEEDS`, and `mbpoll`. The
transmitted values are drawn with fixed seeds; the times are real.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import tempfile
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from random import Random
from typing import Any

import serial
from peer_world import at_work, pty_device, tcp_device

from framekit.definition.times import LineFormat
from framekit.extras.guess.record import Recorder
from framekit.transport.pty_port import PtyPair

NEEDS = "digi-xbee enocean pyrtcm pysbf2 python-pylontech yamspy zigpy-znp"
FOLDER = Path(__file__).parent.parent / "tests" / "data" / "guess"
LINE = LineFormat(19200)


@dataclass(frozen=True)
class Recording:
    """The source of one file: `program` and its peer, and the packages whose versions matter."""

    program: str
    other: str
    packages: tuple[str, ...]
    work: Callable[[Path], Awaitable[None]]


RECORDINGS: dict[str, Recording] = {}


def recording(name: str, program: str, other: str = "", packages: Iterable[str] = ()) -> Callable[..., Any]:
    """Return a row of the table."""

    def add(work: Callable[[Path], Awaitable[None]]) -> Callable[[Path], Awaitable[None]]:
        RECORDINGS[name] = Recording(program, other, tuple(packages) or (program,), work)
        return work

    return add


# ---- lines ------------------------------------------------------------------------------------------------------


@asynccontextmanager
async def recorded(path: Path, urls: list[str]) -> AsyncIterator[None]:
    """Record within the context; with two ports, forward the bytes of each port to the other."""
    ready: set[int] = set()
    opened = asyncio.Event()

    def state(number: int, text: str) -> None:
        ready.add(number)
        if len(ready) == len(urls):
            opened.set()

    through = len(urls) == 2
    recorder = Recorder.at(urls, path, lambda heard: None, line=LINE, on_state=state, through=through)
    recorder.start()
    await opened.wait()
    try:
        yield
        await asyncio.sleep(0.2)  # for bytes in transit
    finally:
        recorder.stop()
    assert not recorder.problems, recorder.problems


@asynccontextmanager
async def before_terminal(path: Path, server: str) -> AsyncIterator[str]:
    """Yield a terminal for the client of a server at another terminal."""
    with PtyPair() as pair:
        async with recorded(path, [pair.first, server]):
            yield pair.second


@asynccontextmanager
async def before_connection(path: Path, server: int) -> AsyncIterator[int]:
    """Yield a TCP port for the client of a server at another TCP port; one connection."""
    ends: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()

    async def accepted(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await ends.put((reader, writer))

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(4096):
            writer.write(data)

    listening = await asyncio.start_server(accepted, "127.0.0.1", 0)
    number = listening.sockets[0].getsockname()[1]
    async with recorded(path, [f"tcp://127.0.0.1:{number}", f"tcp://127.0.0.1:{server}"]):
        near = await ends.get()

        async def pass_on() -> None:
            far = await ends.get()
            await asyncio.gather(carry(far[0], near[1]), carry(near[0], far[1]))

        passing = asyncio.create_task(pass_on())
        yield number
        await asyncio.sleep(0.2)
        passing.cancel()
    listening.close()


async def sent(path: Path, frames: Iterable[bytes], pause: float = 0.01) -> None:
    """Record frames of a program, written to a terminal with a pause after each frame."""
    with PtyPair() as pair:

        def write() -> None:
            with serial.Serial(pair.second, 19200) as port:
                for frame in frames:
                    port.write(bytes(frame))
                    threading.Event().wait(pause)

        async with recorded(path, [pair.first]):
            await at_work(write)


@asynccontextmanager
async def device_terminal(text: str, line: LineFormat = LINE) -> AsyncIterator[str]:
    """Serve a device of framekit at a terminal."""
    with tempfile.TemporaryDirectory() as folder:
        async with pty_device(Path(folder), text, line) as (path, _):
            yield path


@asynccontextmanager
async def device_port(text: str) -> AsyncIterator[int]:
    """Serve a device of framekit at a TCP port."""
    with tempfile.TemporaryDirectory() as folder:
        async with tcp_device(Path(folder), text) as (number, _):
            yield number


# ---- Modbus -----------------------------------------------------------------------------------------------------


def modbus_memory(stations: Iterable[int]) -> list[Any]:
    from pymodbus.simulator import DataType, SimData, SimDevice

    rng = Random(1)
    bits = [rng.random() < 0.4 for _ in range(64)]
    words = [rng.randrange(1 << 16) for _ in range(200)]
    coils = [SimData(0, values=bits, datatype=DataType.BITS)]
    registers = [SimData(0, values=words, datatype=DataType.REGISTERS)]
    return [SimDevice(id=station, simdata=(coils, coils, registers, registers)) for station in stations]


@asynccontextmanager
async def modbus_server(framer: str) -> AsyncIterator[str]:
    """Serve stations 1, 2 and 9 by pymodbus at a terminal."""
    from pymodbus import FramerType
    from pymodbus.server import ModbusSerialServer

    with PtyPair() as pair:
        server = ModbusSerialServer(modbus_memory([1, 2, 9]), framer=FramerType[framer], port=pair.first)
        await server.listen()
        try:
            yield pair.second
        finally:
            await server.shutdown()


async def modbus_work(client: Any, count: int, seed: int) -> None:
    """Read and write by a client of pymodbus."""
    rng = Random(seed)
    assert await client.connect()
    for _ in range(count):
        station, first = rng.choice([1, 1, 2, 9]), rng.randrange(150)
        kind = rng.choice(["holding", "holding", "input", "coils", "write", "several"])
        match kind:
            case "holding":
                await client.read_holding_registers(first, count=rng.randrange(1, 9), device_id=station)
            case "input":
                await client.read_input_registers(first, count=rng.randrange(1, 5), device_id=station)
            case "coils":
                await client.read_coils(rng.randrange(20), count=rng.randrange(1, 40), device_id=station)
            case "write":
                await client.write_register(first, rng.randrange(1 << 16), device_id=station)
            case _:
                values = [rng.randrange(1 << 16) for _ in range(rng.randrange(1, 6))]
                await client.write_registers(first, values, device_id=station)
    client.close()


@recording("pymodbus-rtu", "pymodbus", "its own server")
async def pymodbus_rtu(path: Path) -> None:
    from pymodbus.client import AsyncModbusSerialClient

    async with modbus_server("RTU") as server, before_terminal(path, server) as port:
        await modbus_work(AsyncModbusSerialClient(port), 100, 1)


@recording("pymodbus-ascii", "pymodbus", "its own server")
async def pymodbus_ascii(path: Path) -> None:
    from pymodbus import FramerType
    from pymodbus.client import AsyncModbusSerialClient

    async with modbus_server("ASCII") as server, before_terminal(path, server) as port:
        await modbus_work(AsyncModbusSerialClient(port, framer=FramerType.ASCII), 100, 2)


@recording("pymodbus-tcp", "pymodbus", "its own server")
async def pymodbus_tcp(path: Path) -> None:
    from pymodbus.client import AsyncModbusTcpClient
    from pymodbus.server import ModbusTcpServer

    server = ModbusTcpServer(modbus_memory([1, 2, 9]), address=("127.0.0.1", 0))
    await server.listen()
    try:
        async with before_connection(path, server.transport.sockets[0].getsockname()[1]) as number:
            await modbus_work(AsyncModbusTcpClient("127.0.0.1", port=number), 100, 3)
    finally:
        await server.shutdown()


METER = """
device: peer
protocol: {protocol}
station: 3
memory: {{set: {{40001: [230, 50, 1000, 7]}}}}
behave: {{40001: {{sine: 2200..2400, period: 3 s, every: 50 ms}}, 40002: {{counter: 1, every: 200 ms}}}}
"""


async def mbpoll(seconds: float, *words: str) -> None:
    """Run mbpoll for this duration."""
    process = await asyncio.create_subprocess_exec(
        "mbpoll", *words, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL
    )
    await asyncio.sleep(seconds)
    with contextlib.suppress(ProcessLookupError):
        process.terminate()
    await process.wait()


MBPOLL_RTU = ("-m", "rtu", "-b", "19200", "-P", "none", "-r", "1", "-c", "4")


@recording("mbpoll-rtu", "mbpoll", "a simulated meter of framekit, asked each 100 ms")
async def mbpoll_rtu(path: Path) -> None:
    text = METER.format(protocol="modbus-rtu")
    async with device_terminal(text) as server, before_terminal(path, server) as port:
        await mbpoll(6, *MBPOLL_RTU, "-a", "3", "-l", "100", port)


@recording("mbpoll-silent", "mbpoll", "a simulated meter of framekit; of stations 3 and 4 only 3 is there, -o 0.15")
async def mbpoll_silent(path: Path) -> None:
    text = METER.format(protocol="modbus-rtu")
    async with device_terminal(text) as server, before_terminal(path, server) as port:
        await mbpoll(9, *MBPOLL_RTU, "-a", "3,4", "-l", "100", "-o", "0.15", port)


@recording("pymodbus-silent", "pymodbus", "a simulated meter of framekit; station 4 is missing; timeout=0.2, retries=2")
async def pymodbus_silent(path: Path) -> None:
    from pymodbus.client import AsyncModbusSerialClient
    from pymodbus.exceptions import ModbusException

    rng = Random(22)
    async with device_terminal(METER.format(protocol="modbus-rtu")) as server, before_terminal(path, server) as port:
        client = AsyncModbusSerialClient(port, timeout=0.2, retries=2)
        assert await client.connect()
        for _ in range(12):
            for _ in range(rng.randrange(1, 4)):
                await client.read_holding_registers(rng.randrange(4), count=rng.randrange(1, 5), device_id=3)
            with contextlib.suppress(ModbusException):
                await client.read_holding_registers(3, count=2, device_id=4)
        client.close()


@recording("mbpoll-tcp", "mbpoll", "a simulated meter of framekit, asked each 100 ms")
async def mbpoll_tcp(path: Path) -> None:
    text = METER.format(protocol="modbus-tcp")
    async with device_port(text) as server, before_connection(path, server) as number:
        await mbpoll(6, "-m", "tcp", "-p", str(number), "-a", "3", "-r", "1", "-c", "4", "-l", "100", "127.0.0.1")


async def minimalmodbus_work(path: Path, mode: str) -> None:
    import minimalmodbus

    def work(port: str) -> None:
        rng = Random(4)
        instruments = [minimalmodbus.Instrument(port, station, mode=mode.lower()) for station in (1, 2)]
        for _ in range(80):
            one = rng.choice(instruments)
            kind = rng.randrange(4)
            if kind == 0:
                one.write_register(rng.randrange(100), rng.randrange(1 << 16))
            elif kind == 1:
                one.read_float(rng.randrange(100))
            elif kind == 2:
                one.read_bits(rng.randrange(20), rng.randrange(1, 20))
            else:
                one.read_registers(rng.randrange(100), rng.randrange(1, 6))

    async with modbus_server(mode) as server, before_terminal(path, server) as port:
        await at_work(work, port)


@recording("minimalmodbus-rtu", "minimalmodbus", "a server of pymodbus", ("minimalmodbus", "pymodbus"))
async def minimalmodbus_rtu(path: Path) -> None:
    await minimalmodbus_work(path, "RTU")


@recording("minimalmodbus-ascii", "minimalmodbus", "a server of pymodbus", ("minimalmodbus", "pymodbus"))
async def minimalmodbus_ascii(path: Path) -> None:
    await minimalmodbus_work(path, "ASCII")


# ---- controllers and drives -------------------------------------------------------------------------------------


@recording("df1", "df1py3", "a simulated controller of framekit")
async def df1(path: Path) -> None:
    from df1.commands import Command0FAA
    from df1.file_type import FileType
    from df1.models.df1_tcp_client import Df1TCPClient

    text = 'device: peer\nprotocol: df1\nrole: full\nstation: 1\nmemory: {sizes: {"N10:0": 64}}\n'

    def work(number: int) -> None:
        rng, client = Random(5), Df1TCPClient("127.0.0.1", number)
        client.connect()
        for _ in range(40):
            values = [rng.choice([0x1010, rng.randrange(1 << 16)]) for _ in range(rng.randrange(1, 9))]
            command = client.create_command(
                Command0FAA, table=10, file_type=FileType.INTEGER, start=16, data_to_write=values
            )
            client.send_command(command)
            client.read_integer(file_table=10, start=16, total_int=len(values))
        client.close()

    async with device_port(text) as server, before_connection(path, server) as number:
        await at_work(work, number)


async def melsec(path: Path, protocol: str, kind: str, code: str) -> None:
    import pymcprotocol

    def work(number: int) -> None:
        rng, client = Random(6), getattr(pymcprotocol, kind)("Q")
        client.setaccessopt(commtype=code)
        client.connect("127.0.0.1", number)
        for _ in range(35):
            values = [rng.randrange(-32768, 32768) for _ in range(rng.randrange(1, 9))]
            place = f"D{rng.randrange(1000)}"
            client.batchwrite_wordunits(place, values)
            client.batchread_wordunits(place, len(values))
            client.batchread_bitunits(f"M{rng.randrange(100)}", rng.randrange(1, 20))
        client.close()

    async with (
        device_port(f"device: peer\nprotocol: {protocol}\n") as server,
        before_connection(path, server) as number,
    ):
        await at_work(work, number)


for _name, _protocol, _kind, _code in (
    ("melsec-3e", "melsec-mc-3e", "Type3E", "binary"),
    ("melsec-3e-ascii", "melsec-mc-3e-ascii", "Type3E", "ascii"),
    ("melsec-4e", "melsec-mc-4e", "Type4E", "binary"),
):

    @recording(_name, "pymcprotocol", "a simulated controller of framekit")
    async def _melsec(path: Path, protocol: str = _protocol, kind: str = _kind, code: str = _code) -> None:
        await melsec(path, protocol, kind, code)


@recording("fins-tcp", "fins", "a simulated controller of framekit")
async def fins(path: Path) -> None:
    from fins import tcp

    def work(number: int) -> None:
        rng, client = Random(7), tcp.TCPFinsConnection()
        client.connect("127.0.0.1", port=number)
        for _ in range(45):
            values = [rng.randrange(1 << 16) for _ in range(rng.randrange(2, 9))]
            place = rng.randrange(1000)
            client.write(values, "d", place, "ui")
            client.read("d", place, "ui", len(values))

    async with device_port("device: peer\nprotocol: fins-tcp\n") as server, before_connection(path, server) as number:
        await at_work(work, number)


@recording("melsec-1c", "omniplc", "a simulated controller of framekit")
async def melsec_1c(path: Path) -> None:
    import omniplc

    text = "device: peer\nprotocol: melsec-mc-1c\nstation: 3\nparams: {line_ends: yes}\n"

    def work(port: str) -> None:
        rng, kinds, client = Random(8), omniplc.DataType, omniplc.MelsecMcSerialClient("1C", 3)
        client.configure_serial(port, 9600, 8, 1, "N")
        client.connect()
        for _ in range(35):
            place = rng.randrange(1000)
            client.write(f"D{place}", rng.choice([kinds.USHORT, kinds.ULONG]), rng.randrange(1 << 16))
            client.read(f"D{place}", rng.choice([kinds.USHORT, kinds.ULONG]))
            client.read(f"M{rng.randrange(1000)}", kinds.BOOL)
        client.disconnect()

    async with device_terminal(text) as server, before_terminal(path, server) as port:
        await at_work(work, port)


@recording("mewtocol", "omniplc", "a simulated controller of framekit")
async def mewtocol(path: Path) -> None:
    import omniplc

    def work(number: int) -> None:
        rng, kinds = Random(9), omniplc.DataType
        client: Any = omniplc.PanasonicMewtocolTcpClient("127.0.0.1", number, 1)
        client.connect()
        for _ in range(35):
            place = rng.randrange(1000)
            client.write(f"D{place}", rng.choice([kinds.USHORT, kinds.ULONG]), rng.randrange(1 << 16))
            client.read(f"D{place}", rng.choice([kinds.USHORT, kinds.ULONG]))
            client.read(f"R{rng.randrange(10)}{rng.randrange(16):X}", kinds.BOOL)
        client.disconnect()

    text = "device: peer\nprotocol: mewtocol\nstation: 1\n"
    async with device_port(text) as server, before_connection(path, server) as number:
        await at_work(work, number)


@recording("dynamixel-2", "dynamixel-sdk", "a simulated drive of framekit")
async def dynamixel(path: Path) -> None:
    import dynamixel_sdk

    def work(place: str) -> None:
        rng, port, packets = Random(10), dynamixel_sdk.PortHandler(place), dynamixel_sdk.PacketHandler(2.0)
        dynamixel_sdk.port_handler.LATENCY_TIMER = 5000
        port.openPort()
        port.setBaudRate(57600)
        for _ in range(30):
            packets.write4ByteTxRx(port, 1, 116, rng.randrange(1 << 20))
            packets.read4ByteTxRx(port, 1, rng.choice([116, 132]))
            packets.read2ByteTxRx(port, 1, rng.choice([84, 126, 144]))
        port.closePort()

    text = "device: peer\nprotocol: dynamixel\nstation: 1\n"
    line = LineFormat(57600)
    async with device_terminal(text, line) as server, before_terminal(path, server) as port:
        await at_work(work, port)


@recording("shdlc", "sensirion-shdlc-driver", "a simulated sensor of framekit")
async def shdlc(path: Path) -> None:
    import sensirion_shdlc_driver as driver

    def work(place: str) -> None:
        rng = Random(11)
        with driver.ShdlcSerialPort(port=place, baudrate=115200) as port:
            device = driver.ShdlcDevice(driver.ShdlcConnection(port), slave_address=0x11)
            requests = [
                device.get_product_name, device.get_serial_number, device.get_version, device.get_system_up_time,
                device.get_error_state, device.get_reply_delay,
            ]  # fmt: skip
            for _ in range(75):
                if rng.random() < 0.3:
                    device.set_reply_delay(rng.choice([0x1113, 0x117E, rng.randrange(1 << 16)]))
                rng.choice(requests)()

    text = """
device: peer
protocol: shdlc
station: 0x11
params: {serial_number: 00112233AABBCCDD, answer_delay: 0 ms}
"""
    line = LineFormat(115200)
    async with device_terminal(text, line) as server, before_terminal(path, server) as port:
        await at_work(work, port)


@recording("osdp", "osdp", "a simulated reader of framekit")
async def osdp(path: Path) -> None:
    import osdp as package

    def work(place: str) -> None:
        panel = package.ControlPanel(bytes(16))
        bus = panel.start_connection(package.SerialPortOsdpConnection(place, 115200))
        panel.add_device(bus, 0x25, True, False)
        threading.Event().wait(1.5)
        for _ in range(6):
            panel.id_report(bus, 0x25)
            panel.input_status(bus, 0x25)
            panel.device_capabilities(bus, 0x25)
            threading.Event().wait(0.5)
        panel.shutdown()

    text = """
device: peer
protocol: osdp
station: 0x25
params: {identity: 464B000101000007, serial: 0x01020304, answer_delay: 0 ms}
"""
    line = LineFormat(115200)
    async with device_terminal(text, line) as server, before_terminal(path, server) as port:
        await at_work(work, port)


# ---- meters -----------------------------------------------------------------------------------------------------


@recording("m-bus", "pyMeterBus", "meters 5 to 8, whose frames it makes too")
async def m_bus(path: Path) -> None:
    import meterbus

    rng, stop = Random(12), threading.Event()

    def reply(station: int) -> bytes:
        frame = meterbus.TelegramLong()
        frame.header.cField.parts, frame.header.aField.parts = [8], [station]
        frame.body.bodyHeaderLength = 13
        head = [0x72, station, 0x43, 0x65, 0x87, 0x43, 4, 2, 7, rng.randrange(256), 0, 0, 0]
        records = [0x0C, 0x13, *rng.randbytes(3), 0, 0x02, 0x5B, rng.randrange(99), 0, 0x04, 0x06, *rng.randbytes(3), 0]
        frame.body.load([*head, *records[: rng.choice([6, 10, 16])]])
        return bytes(frame)

    def meters(place: str) -> None:
        with serial.Serial(place, 19200, timeout=0.1) as port:
            while not stop.is_set():
                request = port.read(5)
                if len(request) < 5:
                    continue
                threading.Event().wait(0.02)
                port.write(reply(request[2]) if request[1] & 0x0F == 0x0B else b"\xe5")

    def master(place: str) -> None:
        with serial.Serial(place, 19200, timeout=2) as port:
            for _ in range(75):
                station = rng.randrange(5, 9)
                if rng.random() < 0.1:
                    meterbus.send_ping_frame(port, station)
                else:
                    meterbus.send_request_frame(port, station)
                meterbus.recv_frame(port, 1)
        stop.set()

    with PtyPair() as pair:
        working = asyncio.create_task(at_work(meters, pair.second))
        async with before_terminal(path, pair.first) as port:
            await at_work(master, port)
        await working


@recording("iec62056-21", "iec62056-21", "a simulated meter of framekit")
async def iec62056_21(path: Path) -> None:
    from iec62056_21 import client

    rows = b"".join(b"1.8.%d(%09.1f*kWh)\r\n" % (row, 123.4 * row) for row in range(1, 5))
    text = f"""
device: peer
protocol: iec62056-21
station: "12345678"
params: {{reaction: 20 ms, model: '\\2FK-1', readings: {rows.hex(" ").upper()}}}
"""

    def work(number: int) -> None:
        reader = client.Iec6205621Client.with_tcp_transport(("127.0.0.1", number), device_address="12345678")
        reader.connect()
        for _ in range(6):
            reader.standard_readout()
        reader.disconnect()

    async with device_port(text) as server, before_connection(path, server) as number:
        await at_work(work, number)


@recording("pylontech", "python-pylontech", "(no battery answers it)")
async def pylontech(path: Path) -> None:
    from pylontech import Pylontech

    def work(place: str) -> None:
        rng, battery = Random(13), Pylontech(place, 19200)
        for _ in range(100):
            module = rng.randrange(2, 10)
            command, info = rng.choice(
                [(0x42, b"%02X" % module), (0x93, b"%02X" % module), (0x47, b""), (0x92, b"0A0B")]
            )
            battery.send_cmd(module, command, info)
            threading.Event().wait(0.02)
        battery.s.close()

    with PtyPair() as pair:
        async with recorded(path, [pair.first]):
            await at_work(work, pair.second)


# ---- frames that packages make ----------------------------------------------------------------------------------


@recording("nmea", "pynmea2")
async def nmea(path: Path) -> None:
    import pynmea2

    rng, out = Random(14), list[bytes]()
    for second in range(50):
        place = (f"1929.{rng.randrange(1000):03}", "S", f"02410.{rng.randrange(1000):03}", "E")
        time, height, course = f"1844{second:02}", f"{rng.randrange(300)}.0", str(rng.randrange(360))
        words = (time, *place, "1", "04", "2.6", height, "M", "-33.9", "M", "", "0000")
        out.append(f"{pynmea2.GGA('GP', 'GGA', words)}\r\n".encode())
        wind = (str(rng.randrange(360)), "R", f"{rng.randrange(300) / 10}", "N", "A")
        out.append(f"{pynmea2.MWV('WI', 'MWV', wind)}\r\n".encode())
        rest = (time, "A", *place, "0.1", course, "191194", "020.3", "E")
        out.append(f"{pynmea2.RMC('GP', 'RMC', rest)}\r\n".encode())
    await sent(path, out)


@recording("ubx", "pyubx2")
async def ubx(path: Path) -> None:
    import pyubx2

    rng, out = Random(15), list[bytes]()
    for at in range(60):
        status = pyubx2.UBXMessage("NAV", "NAV-STATUS", pyubx2.GET, iTOW=at * 1000, gpsFix=rng.randrange(4))
        where = {"lon": rng.random(), "lat": rng.random(), "height": rng.randrange(5000)}
        out += [
            status.serialize(),
            pyubx2.UBXMessage("NAV", "NAV-POSLLH", pyubx2.GET, iTOW=at * 1000, **where).serialize(),
            pyubx2.UBXMessage("ACK", "ACK-ACK", pyubx2.GET, clsID=6, msgID=rng.randrange(60)).serialize(),
        ]
    await sent(path, out)


@recording("sbf", "pysbf2")
async def sbf(path: Path) -> None:
    import pysbf2

    rng, out = Random(16), list[bytes]()
    for at in range(60):
        times = {"TOW": 1000 * at, "WNc": 2300}
        out.append(pysbf2.SBFMessage("PVTGeodetic", **times, Latitude=rng.random(), Height=rng.random()).serialize())
        out.append(pysbf2.SBFMessage("ReceiverTime", **times, UTCSec=at % 60, UTCMin=rng.randrange(60)).serialize())
    await sent(path, out)


@recording("rtcm3", "pyrtcm")
async def rtcm3(path: Path) -> None:
    import pyrtcm

    rng, out = Random(17), list[bytes]()
    for _ in range(50):
        out.append(pyrtcm.RTCMMessage(payload=(1005 << 4).to_bytes(2, "big") + rng.randbytes(17)).serialize())
        out.append(
            pyrtcm.RTCMMessage(payload=(1230 << 4).to_bytes(2, "big") + b"\x11\x0f" + rng.randbytes(8)).serialize()
        )
    await sent(path, out)


@recording("esp3", "enocean")
async def esp3(path: Path) -> None:
    from enocean.protocol.packet import Packet

    rng, out = Random(18), list[bytes]()
    for _ in range(100):
        sender = [0x01, 0x9A, 0x3C, rng.randrange(4)]
        data = rng.choice([
            [0xF6, rng.randrange(256), *sender, 0x30], [0xA5, *rng.randbytes(4), *sender, 0],
            [0xD2, *rng.randbytes(rng.randrange(3, 9)), *sender, 0],
        ])  # fmt: skip
        out.append(bytes(Packet(1, data=data, optional=[3, 255, 255, 255, 255, rng.randrange(40, 90), 0]).build()))
    await sent(path, out)


@recording("xbee", "digi-xbee")
async def xbee(path: Path) -> None:
    from digi.xbee.models.address import XBee16BitAddress, XBee64BitAddress
    from digi.xbee.packets.common import ATCommPacket, TransmitPacket

    rng, out = Random(19), list[bytes]()
    for at in range(100):
        number = at % 255 + 1
        if rng.random() < 0.3:
            one: Any = ATCommPacket(number, rng.choice(["DB", "NI", "MY"]))
        else:
            address = XBee64BitAddress(bytes.fromhex("0013A20040A1B2") + bytes([rng.randrange(4)]))
            data = bytearray(rng.randbytes(rng.randrange(2, 20)))
            one = TransmitPacket(number, address, XBee16BitAddress.UNKNOWN_ADDRESS, 0, 0, rf_data=data)
        out.append(bytes(one.output()))
    await sent(path, out)


@recording("msp", "yamspy")
async def msp(path: Path) -> None:
    from yamspy import MSPy

    def work(place: str) -> None:
        rng, board = Random(20), MSPy(device=place, baudrate=19200)
        board.conn.open()
        for _ in range(100):
            kind = rng.randrange(3)
            if kind == 0:
                board.send_RAW_msg(rng.choice([101, 102, 108, 109]))
            elif kind == 1:
                board.send_RAW_msg(200, list(rng.randbytes(16)))
            else:
                board.send_RAW_msg(214, list(rng.randbytes(8)))
            threading.Event().wait(0.01)
        board.conn.close()

    with PtyPair() as pair:
        async with recorded(path, [pair.first]):
            await at_work(work, pair.second)


@recording("znp", "zigpy-znp")
async def znp(path: Path) -> None:
    import zigpy_znp.types as kinds
    from zigpy_znp.frames import GeneralFrame, TransportFrame

    rng, out = Random(21), list[bytes]()
    for _ in range(100):
        header, data = rng.choice([(0x0121, 0), (0x0227, 2), (0x0124, 12), (0x0021, 1), (0x8144, rng.randrange(9, 20))])
        frame = GeneralFrame(kinds.CommandHeader(header), kinds.Bytes(rng.randbytes(data)))
        out.append(TransportFrame(frame).serialize())
    await sent(path, out)


# ---- all of them ------------------------------------------------------------------------------------------------


def version_of(package: str) -> str:
    return "1.0 (Debian)" if package == "mbpoll" else version(package)


def readme() -> str:
    """Return the README of the recordings."""
    lines = [
        "# Programs not written here, at work",
        "",
        "Each file was recorded by `framekit record` between the programs, or at a terminal that a program writes to.",
        "`benchmarks/guess_real.py` knows the truth of each. The commands are run with `PYTHONPATH=tests`.",
        "",
        "| file | program that talks | with | command |",
        "|---|---|---|---|",
    ]
    for name, one in sorted(RECORDINGS.items()):
        programs = ", ".join(f"{package} {version_of(package)}" for package in one.packages)
        other = one.other or "(it only sends)"
        lines.append(f"| {name}.pcap | {programs} | {other} | `python tools/real_captures.py {name}` |")
    return "\n".join(lines) + "\n"


async def main(names: list[str]) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in names or RECORDINGS:
        path = FOLDER / f"{name}.pcap"
        path.unlink(missing_ok=True)
        async with asyncio.timeout(60):
            await RECORDINGS[name].work(path)
        print(f"{name}: {path.stat().st_size} bytes")
    (FOLDER / "README.md").write_text(readme(), encoding="utf-8")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1:]))
