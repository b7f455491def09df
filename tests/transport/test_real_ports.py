"""Real ports on asyncio: special behaviour of pseudo-terminals, pyserial URLs and TCP; opening by URL."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable

import pytest
from transport.real_world import LONGEST, Waiting, open_pty, opened, run

from framekit.definition.times import LineFormat, LineSettings
from framekit.link.events import CharacterFault
from framekit.transport import serial_port
from framekit.transport.clock import MOST, AsyncioClock, VirtualClock
from framekit.transport.network import TcpListener, TcpPort, host_and_port
from framekit.transport.port import AcceptedPort, Port
from framekit.transport.pty_port import PtyPair
from framekit.transport.schemes import open_port
from framekit.transport.serial_port import SerialPort, open_device

pytestmark = pytest.mark.usefixtures("each_loop")


def real_clock() -> AsyncioClock:
    return AsyncioClock(asyncio.get_running_loop())


# ---- pseudo-terminals ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [LineFormat(12345), LineFormat(7, 7, "O", 2), LineFormat(4_000_000, 5, "M", 1.5), LineFormat(50, 8, "S"), None],
)
def test_a_pty_takes_any_speed_and_format(settings: LineFormat | None) -> None:
    async def check() -> None:
        path, master = open_pty()
        with master:
            port = open_port(path, settings, real_clock())
            events = await opened(port)
            port.write(b"\x00\xff\x11\x13\x03")
            await events.until("sent")
            assert master.read(100) == b"\x00\xff\x11\x13\x03"
            master.write(b"\xff\xff\x00\r\n\x04")
            assert await events.bytes(6) == b"\xff\xff\x00\r\n\x04"
            port.close()

    run(check())


def test_on_a_pty_bytes_are_sent_at_once() -> None:
    """A pseudo-terminal has no bit times: at 50 bits per second this would take minutes."""

    async def check() -> None:
        path, master = open_pty()
        with master:
            port = open_port(path, LineFormat(50), real_clock())
            events = await opened(port)
            port.write(bytes(1000))
            await events.until("sent")
            assert len(master.read(1000)) == 1000
            port.close()

    run(check())


def test_a_pty_that_is_pulled() -> None:
    async def check() -> None:
        path, master = open_pty()
        port = open_port(path, LineFormat(9600), real_clock())
        events = await opened(port)
        master.close()
        assert await events.until("closed") == f"{path}: the device is gone"

    run(check())


def test_a_pty_that_is_pulled_while_its_bytes_wait_for_their_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """uvloop reports the end of a device once."""

    async def check() -> None:
        clock = real_clock()
        waiting: list[Callable[[], None]] = []
        monkeypatch.setattr(clock.turns, "take", lambda size, callback: waiting.append(callback))
        path, master = open_pty()
        port = open_port(path, LineFormat(9600), clock)
        events = await opened(port)
        master.write(b"last")
        while not waiting:
            await asyncio.sleep(0)
        master.close()
        for _ in range(10):  # turns of the loop, which reports the end in one of them
            await asyncio.sleep(0)
        waiting.pop()()
        assert await events.bytes(4) == b"last"
        assert await events.until("closed") == f"{path}: the device is gone"

    run(check())


def test_a_port_whose_other_side_takes_nothing_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """As with CTS off: waiting bytes must not block a channel for ever."""
    monkeypatch.setattr(serial_port, "LONGEST_HOLD", 20_000_000)

    async def check() -> None:
        path, master = open_pty()
        port = open_port(path, LineFormat(921600), real_clock())
        events = await opened(port)
        port.write(bytes(20_000))
        assert "nothing has been taken for 0.02 s" in await events.until("closed")
        assert "sent" not in events.seen
        master.close()

    run(check())


def test_closing_a_port_in_the_middle_of_its_own_event() -> None:
    class Closing(Waiting):
        def received(self, data: bytes, now: int, faults: object = ()) -> None:
            port.close()
            self._note("received", now, (data, ()))

    async def check() -> None:
        nonlocal port
        with PtyPair() as pair:
            port = open_port(pair.first, None, real_clock())
            other = open_port(pair.second, None, real_clock())
            events = Closing()
            port.open(events)
            await events.until("opened")
            await opened(other)
            other.write(b"x")
            assert await events.bytes(1) == b"x"
            port.write(b"nothing")
            other.close()
            assert events.seen == ["opened", "received"]

    port: Port
    run(check())


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("/dev/no-such-port", "/dev/no-such-port: there is no such device"),
        ("x.device.yaml", "x.device.yaml: this is the name of a file – for a simulated device write sim:x.device.yaml"),
        (os.devnull, f"{os.devnull}: this is no serial line – name one, such as /dev/ttyUSB0, or tcp://HOST:PORT"),
        ("/tmp", "/tmp: this is a folder – name a device in it"),
        ("loop://?nonsense", "loop://?nonsense: "),
    ],
)
def test_what_cannot_be_opened_is_reported_as_closed(name: str, reason: str) -> None:
    async def check() -> None:
        events = Waiting()
        open_port(name, LineFormat(9600), real_clock()).open(events)
        assert events.seen == [], "not from inside of the call"
        assert (await events.until("closed")).startswith(reason)

    run(check())


def test_a_port_that_another_one_has_open() -> None:
    async def check() -> None:
        path, master = open_pty()
        with master:
            first, second, events = open_port(path, None, real_clock()), open_port(path, None, real_clock()), Waiting()
            await opened(first)
            second.open(events)
            assert await events.until("closed") == f"{path}: another program has it open"
            first.close()
            await opened(second)
            second.close()

    run(check())


def test_closing_before_it_is_open() -> None:
    async def check() -> None:
        path, master = open_pty()
        with master:
            for url in (path, "loop://", "tcp://127.0.0.1:1"):
                port, events = open_port(url, None, real_clock()), Waiting()
                port.open(events)
                port.write(b"too early")
                port.close()
                later = asyncio.Event()
                real_clock().call_at(real_clock().now() + 5_000_000, later.set)
                await later.wait()
                assert events.seen == []

    run(check())


# ---- pyserial's URLs ----------------------------------------------------------------------------------------


def test_a_loop_hears_itself() -> None:
    async def check() -> None:
        port = open_port("loop://", LineFormat(115200), real_clock())
        events = await opened(port)
        port.set_rts(False)
        port.write(b"around")
        assert await events.sent_and_heard(6) == b"around"
        port.close()

    run(check())


def test_bytes_through_a_url_take_their_bit_times() -> None:
    async def check() -> None:
        clock = real_clock()
        settings = LineFormat(9600)
        port = open_port("loop://", settings, clock)
        events = await opened(port)
        begin = clock.now()
        port.write(bytes(10))
        await events.until("sent")
        assert events.times[-1] - begin >= 10 * settings.character_time
        port.close()

    run(check())


# ---- TCP ----------------------------------------------------------------------------------------------------


def test_bytes_that_come_before_an_accepted_port_is_opened_wait_for_it() -> None:
    async def check() -> None:
        clock = real_clock()
        accepted: asyncio.Queue[AcceptedPort] = asyncio.Queue()
        listener = TcpListener("127.0.0.1", 0, clock, accepted.put_nowait)
        await listener.start()
        _, writer = await asyncio.open_connection("127.0.0.1", listener.number)
        writer.write(b"early")
        await writer.drain()
        port = await accepted.get()
        writer.close()
        await writer.wait_closed()
        events = await opened(port)
        assert await events.bytes(5) == b"early"
        assert await events.until("closed") == "the other side has closed the connection"
        port.open(events)
        assert await events.until("closed") == "the connection is over"
        listener.stop()

    run(check())


def test_a_listener_can_be_asked_for_its_port_at_once_and_stops() -> None:
    async def check() -> None:
        clock = real_clock()
        listener = TcpListener("localhost", 0, clock, lambda port: None)
        listener.listen()
        assert listener.number > 0
        listener.stop()
        events = Waiting()
        TcpPort("127.0.0.1", listener.number, clock).open(events)
        reason = await events.until("closed")
        assert reason.startswith(f"no connection to 127.0.0.1:{listener.number}: Connection refused – nothing listens")
        with pytest.raises(OSError, match=r"\w"):
            TcpListener("256.0.0.1", 0, clock, lambda port: None).listen()

    run(check())


@pytest.mark.parametrize("host", ["no-such-host.invalid", "x" * 70 + ".invalid"])
def test_a_host_that_is_none(host: str) -> None:
    async def check() -> None:
        events = Waiting()
        TcpPort(host, 502, real_clock()).open(events)
        assert (await events.until("closed")).startswith(f"no connection to {host}:502: ")

    run(check())


async def flooded(size: int) -> tuple[list[bytes], list[str]]:
    """Return the pieces in which a connection delivers `size` bytes, and the order of data of both connections.

    Another connection sends after the first piece.
    """
    clock = real_clock()
    accepted: asyncio.Queue[AcceptedPort] = asyncio.Queue()
    listener = TcpListener("127.0.0.1", 0, clock, accepted.put_nowait)
    listener.listen()
    _, flood = await asyncio.open_connection("127.0.0.1", listener.number)
    flooding = await accepted.get()
    _, other = await asyncio.open_connection("127.0.0.1", listener.number)
    pieces: list[bytes] = []
    order: list[str] = []

    class Recorder(Waiting):
        def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
            order.append("flood")
            if not pieces:
                other.write(b"other")
            pieces.append(data)

        def closed(self, now: int, reason: str) -> None:
            order.append("closed")
            super().closed(now, reason)

    class Other(Waiting):
        def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
            order.append("other")

    (await accepted.get()).open(Other())
    flood.write(bytes(number % 251 for number in range(size)))
    await flood.drain()
    flood.close()
    await flood.wait_closed()
    events = Recorder()
    flooding.open(events)
    await events.until("closed")
    other.close()
    listener.stop()
    return pieces, order


def test_a_flood_is_taken_in_turns_and_nothing_of_it_is_lost() -> None:
    pieces, order = run(flooded(200_000))
    assert b"".join(pieces) == bytes(number % 251 for number in range(200_000))
    assert max(map(len, pieces)) <= MOST
    assert order.index("other") < 10, "the other one had a turn in between"
    assert order[-1] == "closed"


def test_connections_share_a_turn_of_the_loop() -> None:
    async def check() -> None:
        clock = real_clock()
        accepted: asyncio.Queue[AcceptedPort] = asyncio.Queue()
        listener = TcpListener("127.0.0.1", 0, clock, accepted.put_nowait)
        listener.listen()
        writers = [(await asyncio.open_connection("127.0.0.1", listener.number))[1] for _ in range(8)]
        ports = [await accepted.get() for _ in writers]
        turns: list[int] = []
        left = [40_000 * len(writers)]
        done = asyncio.Event()

        class Told(Waiting):
            def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
                turns.append(clock.turns.used)
                left[0] -= len(data)
                if not left[0]:
                    done.set()

        for writer in writers:
            writer.write(bytes(40_000))
            await writer.drain()
        for port in ports:
            port.open(Told())
        await asyncio.wait_for(done.wait(), LONGEST)
        for writer in writers:
            writer.close()
        listener.stop()
        assert max(turns) <= MOST

    run(check())


def test_sent_waits_until_the_system_has_taken_everything() -> None:
    async def check() -> None:
        clock = real_clock()
        accepted: asyncio.Queue[AcceptedPort] = asyncio.Queue()
        listener = TcpListener("127.0.0.1", 0, clock, accepted.put_nowait)
        listener.listen()
        client = TcpPort("127.0.0.1", listener.number, clock)
        events = await opened(client)
        server = await accepted.get()
        size = 20_000_000
        client.write(bytes(size))
        later = asyncio.Event()
        clock.call_at(clock.now() + 5_000_000, later.set)
        await later.wait()
        assert "sent" not in events.seen, "nobody reads yet"
        there = await opened(server)
        assert len(await there.bytes(size)) == size
        await events.until("sent")
        client.close()
        server.close()
        listener.stop()

    run(check())


# ---- opening by URL -----------------------------------------------------------------------------------------


def test_kinds_of_ports_by_url() -> None:
    async def check() -> None:
        clock = real_clock()
        line = LineFormat(9600)
        assert isinstance(open_port("/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0", line, clock), SerialPort)
        assert isinstance(open_port("COM3", line, clock), SerialPort)
        assert isinstance(open_port("rfc2217://host:7000", line, clock), SerialPort)
        port = open_port("TCP://[::1]:502", line, clock)
        assert isinstance(port, TcpPort)
        assert (port.name, port.describes(), port.settings) == ("tcp://[::1]:502", "tcp://[::1]:502", None)
        assert open_port("COM3", LineFormat(9600, 7, "E"), clock).describes() == "COM3 at 9600 7E1"

    run(check())


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("usbx://1", "'usbx://1' is no port – known are a device such as"),
        ("tpc://1.2.3.4:502", "'tpc://1.2.3.4:502' is no port – did you mean 'tcp'"),
        ("pty:", r"sim:FILE; a server can open pty:\[PATH\] too"),
        (
            "pty:/tmp/plc",
            "'pty:/tmp/plc' is no port here – name the terminal itself: /tmp/plc; a server makes it with --port",
        ),
        ("sim:x.yaml", "'sim:x.yaml' is no port"),
        ("", "'' is no port"),
        ("plc.example:502", "write tcp://plc.example:502 for a connection to that host"),
        ("tcp:host:1", "'tcp:host:1' is no port"),
        ("tcp://host", "'host' is not HOST:PORT"),
    ],
)
def test_what_is_no_port_is_answered_with_what_is(url: str, message: str) -> None:
    async def check() -> None:
        with pytest.raises(ValueError, match=message):
            open_port(url, None, real_clock())

    run(check())


def test_a_real_port_needs_real_time() -> None:
    with pytest.raises(ValueError, match="needs real time – use sim:"):
        open_port("/dev/ttyUSB0", LineFormat(9600), VirtualClock())


@pytest.mark.parametrize(
    ("text", "expected"),
    [("localhost:502", ("localhost", 502)), ("[::1]:5", ("::1", 5)), (":7", ("127.0.0.1", 7)), ("a:1/", ("a", 1))],
)
def test_hosts_and_ports(text: str, expected: tuple[str, int]) -> None:
    assert host_and_port(f"tcp://{text}") == expected


@pytest.mark.parametrize("text", ["localhost", "x:99999", "x:" + "9" * 5000, "x:²", "x:y", ""])
def test_wrong_hosts_and_ports(text: str) -> None:
    with pytest.raises(ValueError, match="65535 at most" if "99999" in text else "HOST:PORT"):
        host_and_port(f"tcp://{text}")


def test_a_port_that_only_listens_leaves_the_control_lines_off() -> None:
    for listen_only in (True, False):
        device = open_device("loop://", None, LineSettings(listen_only=listen_only))
        assert (device.rts, device.dtr) == (not listen_only, not listen_only)
        device.close()
