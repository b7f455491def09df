"""Devices with many connections, or several stations on one line; misbehaving clients."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from framekit.definition.problems import DefinitionError
from framekit.definition.times import LineFormat
from framekit.link.events import Seen
from framekit.link.sequences import runtime
from framekit.run.model import DEFAULT_LIMITS, ConnectionLimits
from framekit.runfile.devices import DeviceSettings, load_devices
from framekit.service.device import MOST_CONNECTIONS, Serving
from framekit.transport.clock import AsyncioClock, VirtualClock
from framekit.transport.simulated_line import SimulatedLine

LONGEST = 180
MOST_FLOOD = 50_000_000
HERE = Path(__file__).parent


def run(scenario: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(scenario, LONGEST))


# ---- TCP --------------------------------------------------------------------------------------------------


@asynccontextmanager
async def served(
    name: str = "modbus-tcp", limits: ConnectionLimits = DEFAULT_LIMITS, **settings: Any
) -> AsyncIterator[tuple[Serving, int]]:
    """Serve devices on a port of this computer; yield its number."""
    settings.setdefault("initial", {"40001": "100,200,300"})
    devices = load_devices(name, HERE, DeviceSettings(**settings))
    serving = Serving(devices, AsyncioClock(asyncio.get_running_loop()), None, limits=limits)
    try:
        yield serving, (await serving.listen("tcp://127.0.0.1:0")).number
    finally:
        serving.stop()


def request(transaction: int, unit: int, pdu: str) -> bytes:
    data = bytes.fromhex(pdu)
    return struct.pack(">HHHB", transaction, 0, len(data) + 1, unit) + data


async def reply_of(reader: asyncio.StreamReader) -> tuple[int, int, bytes]:
    """Return transaction, unit and PDU of the next reply."""
    transaction, zero, length, unit = struct.unpack(">HHHB", await reader.readexactly(7))
    assert zero == 0
    return transaction, unit, await reader.readexactly(length - 1)


async def pdu_of_reply(number: int, unit: int, pdu: str) -> bytes:
    """Return the reply's PDU, over a separate connection."""
    reader, writer = await asyncio.open_connection("127.0.0.1", number)
    writer.write(request(7, unit, pdu))
    transaction, unit_of_reply, reply = await reply_of(reader)
    writer.close()
    assert (transaction, unit_of_reply) == (7, unit)
    return reply


READ_3 = "03 0000 0003"
THREE = bytes.fromhex("03 06 0064 00C8 012C")


def test_a_hundred_clients_one_after_the_other_and_fifty_at_once() -> None:
    async def scenario() -> None:
        async with served() as (serving, number):
            for value in range(100):
                await pdu_of_reply(number, 1, f"06 000A {value:04X}")
                assert await pdu_of_reply(number, 1, "03 000A 0001") == struct.pack(">BBH", 3, 2, value)
            replies = await asyncio.gather(*(pdu_of_reply(number, 1, READ_3) for _ in range(50)))
            assert replies == [THREE] * 50
            assert serving.connections == 250
            assert (serving.stores[0].counters.done, serving.stores[0].counters.errors) == (250, 0)

    run(scenario())


def test_connections_that_are_over_are_forgotten() -> None:
    async def scenario() -> None:
        async with served() as (serving, number):
            for _ in range(3):
                await pdu_of_reply(number, 1, READ_3)
            while serving.connected:
                await asyncio.sleep(0)

    run(scenario())


def test_too_many_connections_are_closed_at_once() -> None:
    async def scenario() -> None:
        async with served(limits=ConnectionLimits(per_address=2 * MOST_CONNECTIONS)) as (serving, number):
            open_ones = [await asyncio.open_connection("127.0.0.1", number) for _ in range(MOST_CONNECTIONS)]
            while len(serving.connected) < MOST_CONNECTIONS:
                await asyncio.sleep(0)
            reader, _ = await asyncio.open_connection("127.0.0.1", number)
            assert await reader.read() == b""
            first_reader, first_writer = open_ones[0]
            first_writer.write(request(1, 1, READ_3))
            assert (await reply_of(first_reader))[2] == THREE
            for _, writer in open_ones:
                writer.close()

    run(scenario())


def test_one_address_has_only_so_many_connections() -> None:
    async def scenario() -> None:
        async with served(limits=ConnectionLimits(per_address=2)) as (serving, number):
            idle = [await asyncio.open_connection("127.0.0.1", number) for _ in range(2)]
            while len(serving.connected) < 2:
                await asyncio.sleep(0)
            reader, _ = await asyncio.open_connection("127.0.0.1", number)
            assert await reader.read() == b""
            assert serving.line_errors == {"connections refused": 1}
            elsewhere = socket.socket()
            elsewhere.bind(("127.0.0.2", 0))
            elsewhere.setblocking(False)
            await asyncio.get_running_loop().sock_connect(elsewhere, ("127.0.0.1", number))
            other_reader, other_writer = await asyncio.open_connection(sock=elsewhere)
            other_writer.write(request(1, 1, READ_3))
            assert (await reply_of(other_reader))[2] == THREE, "another address is let in"
            idle[0][1].close()
            while len(serving.connected) > 2:
                await asyncio.sleep(0)
            assert await pdu_of_reply(number, 1, READ_3) == THREE, "so is this one, when one of its own has ended"
            idle[1][1].close()
            other_writer.close()

    run(scenario())


def test_a_connection_over_which_nothing_good_goes_is_closed() -> None:
    """On simulated time: a client requests every minute, another sends an invalid byte, a third is silent."""
    clock = VirtualClock()
    devices = load_devices("modbus-rtu", HERE, DeviceSettings(initial={"40001": "100,200,300"}))
    serving = Serving(devices, clock, None)
    asks, babbles, _ = masters = [accepted(serving, clock, name) for name in ("asks", "babbles", "silent")]
    for _ in range(9):
        clock.run_for(MINUTE)
        asks.port.write(ASK)
        babbles.port.write(b"\xff")
    clock.run_for(MINUTE - 1)
    assert len(serving.connected) == 3
    clock.run_for(1)
    assert [port.name for port in serving.connected] == ["asks"]
    assert serving.line_errors["idle connections closed"] == 2
    assert [len(master.heard) for master in masters] == [9 * 11, 0, 0]
    clock.run_for(10 * MINUTE)
    assert not serving.connected


def test_frames_are_read_to_be_shown_only_where_a_monitor_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []

    class Noted(Seen):
        def __init__(self, *values: Any, **more: Any) -> None:
            super().__init__(*values, **more)
            shown.append(self.kind)

    monkeypatch.setattr(runtime, "Seen", Noted)
    for monitor, kinds in ((None, ["open", "bad"]), (lambda *told: None, ["open", "frame", "frame", "bad"])):
        shown.clear()
        clock = VirtualClock()
        devices = load_devices("modbus-rtu", HERE, DeviceSettings(initial={"40001": "100,200,300"}))
        serving = Serving(devices, clock, None, monitor)
        master = accepted(serving, clock, "asks")
        clock.run_for(MINUTE)
        for data in (ASK, b"\xff"):
            master.port.write(data)
            clock.run_for(MINUTE)
        assert shown == kinds
        assert sum(serving.line_errors.values()) == 1
        assert (serving.stores[0].counters.done, len(master.heard)) == (1, 11)


@pytest.mark.parametrize("limits", [{"idle": 0}, {"per_address": 0}])
def test_limits_that_let_nobody_in_are_refused(limits: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=r"above 0|1 connection at least"):
        ConnectionLimits(**limits)


# ---- UDP --------------------------------------------------------------------------------------------------


class Asker(asyncio.DatagramProtocol):
    """A sender of datagrams that records the replies."""

    transport: asyncio.DatagramTransport

    def __init__(self) -> None:
        self.got: asyncio.Queue[bytes] = asyncio.Queue()

    def datagram_received(self, data: bytes, addr: object) -> None:
        self.got.put_nowait(data)

    @classmethod
    async def to(cls, number: int) -> Asker:
        loop = asyncio.get_running_loop()
        made = cls()
        made.transport, _ = await loop.create_datagram_endpoint(lambda: made, remote_addr=("127.0.0.1", number))
        return made


@asynccontextmanager
async def served_by_datagrams(limits: ConnectionLimits = DEFAULT_LIMITS) -> AsyncIterator[tuple[Serving, int]]:
    devices = load_devices("modbus-rtu", HERE, DeviceSettings(initial={"40001": "100,200,300"}))
    serving = Serving(devices, AsyncioClock(asyncio.get_running_loop()), None, limits=limits)
    try:
        yield serving, (await serving.listen("udp-listen://127.0.0.1:0")).number
    finally:
        serving.stop()


ASK = bytes.fromhex("01 03 0000 0003 05CB")


def test_datagrams_of_two_senders_never_make_one_frame_and_each_gets_its_own_replies() -> None:
    async def scenario() -> None:
        async with served_by_datagrams() as (serving, number):
            one, other = await Asker.to(number), await Asker.to(number)
            one.transport.sendto(ASK[:5])
            other.transport.sendto(ASK[5:])
            other.transport.sendto(ASK)
            one.transport.sendto(ASK[5:])
            for asker in (one, other):
                assert (await asker.got.get())[:9] == bytes.fromhex("01 03 06 0064 00C8 012C")
            assert serving.connections == 2
            assert (serving.stores[0].counters.done, one.got.qsize(), other.got.qsize()) == (2, 0, 0)

    run(scenario())


def test_a_new_sender_takes_the_place_of_the_one_silent_longest() -> None:
    async def scenario() -> None:
        async with served_by_datagrams(ConnectionLimits(per_address=2)) as (serving, number):
            for _ in range(5):
                asker = await Asker.to(number)
                asker.transport.sendto(ASK)
                assert len(await asker.got.get()) == 11
            assert (len(serving.connected), serving.connections) == (2, 5)
            assert not serving.line_errors

    run(scenario())


def test_a_client_leaves_in_the_middle_of_a_request() -> None:
    async def scenario() -> None:
        async with served() as (_, number):
            for size in range(1, 12):
                _, writer = await asyncio.open_connection("127.0.0.1", number)
                writer.write(request(1, 1, "06 0000 FFFF")[:size])
                writer.close()
                await writer.wait_closed()
            assert await pdu_of_reply(number, 1, READ_3) == THREE

    run(scenario())


def test_garbage_ends_its_connection_and_no_other() -> None:
    async def scenario() -> None:
        async with served() as (serving, number):
            other_reader, other = await asyncio.open_connection("127.0.0.1", number)
            reader, writer = await asyncio.open_connection("127.0.0.1", number)
            writer.write(b"GET / HTTP/1.1\r\n\r\n")
            assert await reader.read() == b"", "a stream that is out of step is closed"
            other.write(request(1, 1, READ_3))
            assert (await reply_of(other_reader))[2] == THREE
            assert sum(serving.line_errors.values()) >= 1
            other.close()

    run(scenario())


def test_a_slow_client_and_requests_in_one_piece() -> None:
    async def scenario() -> None:
        async with served() as (_, number):
            reader, writer = await asyncio.open_connection("127.0.0.1", number)
            for byte in request(1, 1, READ_3):
                writer.write(bytes([byte]))
                await writer.drain()
                await pdu_of_reply(number, 1, READ_3)  # another client is served meanwhile
            assert (await reply_of(reader))[0] == 1
            writer.write(b"".join(request(transaction, 1, READ_3) for transaction in range(16)))
            assert [(await reply_of(reader))[0] for _ in range(16)] == list(range(16))
            writer.close()

    run(scenario())


def test_a_client_that_never_reads_its_replies() -> None:
    async def scenario() -> None:
        async with served() as (serving, number):
            client = socket.socket()
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            client.setblocking(False)
            await asyncio.get_running_loop().sock_connect(client, ("127.0.0.1", number))
            _, writer = await asyncio.open_connection(sock=client)
            writer.transport.pause_reading()
            flood = request(1, 1, "03 0000 007D") * 2_000
            sent = 0
            while sent < MOST_FLOOD and writer.transport.get_write_buffer_size() < 4 * len(flood):
                writer.write(flood)
                sent += len(flood)
                await asyncio.sleep(0)
            assert sent < MOST_FLOOD, "the flood comes to a stop"
            assert await pdu_of_reply(number, 1, READ_3) == THREE
            waiting = [
                len(connection.engine.receiver.stream.buffer)
                for each in serving.connected.values()
                for connection in each
            ]
            assert max(waiting) < 500_000, "requests are not taken faster than replies"
            writer.transport.abort()

    run(scenario())


def test_units_behind_one_address() -> None:
    async def scenario() -> None:
        async with served(stations=("1", "2")) as (_, number):
            assert await pdu_of_reply(number, 2, "10 0000 0002 04 AAAA BBBB") == bytes.fromhex("10 0000 0002")
            assert await pdu_of_reply(number, 2, READ_3) == bytes.fromhex("03 06 AAAA BBBB 012C")
            assert await pdu_of_reply(number, 1, READ_3) == THREE
            reader, writer = await asyncio.open_connection("127.0.0.1", number)
            writer.write(request(1, 9, READ_3) + request(2, 1, READ_3))
            assert (await reply_of(reader))[:2] == (2, 1), "nobody is unit 9"
            writer.close()

    run(scenario())


def test_device_variables_belong_to_the_device_not_to_the_connection() -> None:
    """A monitor registered by one connection is executed by another."""

    async def exchange(number: int, request: bytes, size: int) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", number)
        writer.write(request)
        reply = await reader.readexactly(size)
        writer.close()
        return reply

    async def scenario() -> None:
        async with served("mldp", initial={"M100": "0x1234"}) as (_, number):
            assert await exchange(number, b"\x0501Y05\x04", 11) == b"\x1501Y050090\x03"
            assert await exchange(number, b"\x0501X05RSS0106%MW100\x04", 7) == b"\x0601X05\x03"
            assert await exchange(number, b"\x0501Y05\x04", 15) == b"\x0601Y0501021234\x03"

    run(scenario())


# ---- one line ---------------------------------------------------------------------------------------------


MINUTE = 60_000_000_000


def accepted(serving: Serving, clock: VirtualClock, name: str) -> Master:
    """Return the other end of a simulated connection that the serving object has accepted."""
    line = SimulatedLine(clock, None)
    port: Any = line.port(name)
    port.host, port.ends_itself, port.opens_again = "elsewhere", True, False
    serving.accept(port)
    return Master(line)


class Master:
    """Sender and recorder of bytes on a simulated line."""

    def __init__(self, line: SimulatedLine) -> None:
        self.port = line.port("master")
        self.heard = b""
        self.port.open(self)

    def opened(self, now: int) -> None: ...

    def received(self, data: bytes, now: int, faults: object = ()) -> None:
        self.heard += data

    def line_break(self, now: int) -> None: ...

    def sent(self, now: int) -> None: ...

    def closed(self, now: int, reason: str) -> None: ...

    def control(self, lines: object, now: int) -> None: ...


def test_stations_on_one_line_answer_each_for_itself() -> None:
    clock, settings = VirtualClock(), LineFormat(9600)
    line = SimulatedLine(clock, settings)
    seen: list[tuple[int, Seen]] = []
    devices = load_devices("mldp", HERE, DeviceSettings(stations=("1", "2", "5"), initial={"M0": "7"}))
    serving = Serving(devices, clock, settings, lambda port, number, one: seen.append((number, one)))
    port = line.port("devices")
    serving.serve(port)
    master = Master(line)
    clock.run_for(0)
    for station, value in (("01", "0001"), ("02", "0002"), ("05", "0005"), ("03", "0003")):
        master.port.write(f"\x05{station}WSS0106%MW100{value}\x04".encode())
        clock.run_for(100_000_000)
    assert master.heard == b"\x0601WSS\x03\x0602WSS\x03\x0605WSS\x03"
    assert [store.memory.read("M", "word", 100) for store in serving.stores] == [[1], [2], [5]]
    assert [store.memory.read("M", "word", 0) for store in serving.stores] == [[7], [7], [7]]
    assert [store.counters.done for store in serving.stores] == [1, 1, 1]
    master.port.write(b"\x0501RSS0106%MW100\x0500")
    clock.run_for(1_000_000_000)
    assert sum(serving.line_errors.values()) >= 1, "damage is counted once, though three hear it"
    port.pull()
    clock.run_for(1_000_000_000)
    master.heard = b""
    master.port.write(b"\x0502RSS0106%MW100\x04")
    clock.run_for(100_000_000)
    assert master.heard == b"\x0602RSS01020002\x03", "a line that was lost is opened again, with all stations"
    assert {number for number, one in seen if one.kind == "open"} == {0, 1, 2}
    serving.stop()
    clock.run_for(1_000_000_000)
    assert not serving.connected


def test_several_stations_of_a_device_file(tmp_path: Path) -> None:
    path = tmp_path / "rack.device.yaml"
    path.write_text("device: rack\nprotocol: modbus-rtu\nstation: [3, 4]\nmemory: {set: {40001: 1}}\n", "utf-8")
    devices = load_devices(path, tmp_path, DeviceSettings(initial={"40002": "2"}, params={"retries": "1"}))
    assert [(device.name, device.own) for device in devices] == [("rack 3", 3), ("rack 4", 4)]
    memory = devices[1].create_memory()
    assert memory.read("holding", "word", 0, 2) == [1, 2] and devices[0].params == {"retries": "1"}
    assert [device.own for device in load_devices(path, tmp_path, DeviceSettings(stations=("9",)))] == [9]


def test_settings_of_a_device_that_are_wrong_come_at_once() -> None:
    settings = DeviceSettings(stations=("1", "999"), params={"speed": "1"}, role="master")
    with pytest.raises(DefinitionError) as caught:
        load_devices("mldp", HERE, settings)
    assert [str(problem).partition(" – ")[0] for problem in caught.value.problems] == [
        "--param speed=1: 'mldp' has no parameter 'speed'",
        "--role master: there is no role 'master'",
        "--station 1,999: station 999 is not in 0..31",
    ]
