"""The clients of the API: real pseudo-terminals, TCP, a pymodbus server; types, threads, cancelling, closed ports."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from api_world import SlowServer, device_file, pymodbus_server
from service.test_ending import DEVICE, PROTOCOL
from service.test_ending import RUN as TALK
from spread import spread

import framekit
from framekit.transport.pty_port import PtyPair

QUICK = {"reply_timeout": "50 ms", "retries": 0}


SEEN: list[framekit.Seen] = []


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> str:
    return f"sim:{device_file(tmp_path_factory.mktemp('device'))}"


@pytest.fixture(scope="module")
def shared(simulated: str) -> Iterator[framekit.Client]:
    """Yield a client without a default station, shared by several tests."""
    with framekit.connect("modbus-rtu", simulated, params=QUICK, monitor=SEEN.append) as client:
        yield client


# ---- values -----------------------------------------------------------------------------------------------------


def test_reads_and_writes(simulated: str) -> None:
    with framekit.connect("modbus-rtu", simulated, station=7) as client:
        read = client.read("40001", 3)
        assert read == [100, 200, 300]
        assert (read.type, read.addresses, read.station, read.value) == ("word", ("40001",), 7, 100)
        assert read.data == bytes.fromhex("6400 C800 2C01")
        assert read.raw.hex() == "070306006400c8012c" + read.raw[-2:].hex()
        client.write("40002", [7, -1])
        assert client.read("40001", 3) == [100, 7, 0xFFFF]
        assert client.read("00001", 3) == [1, 0, 1]
        client.write("00002", 1)
        assert client.read("00001", 3) == [1, 1, 1]
        client.write_many({"40001": 1, "40010": 2})
        assert client.read_many(["40010", "40001"]) == [2, 1]


def test_frames_with_a_check_code_before_their_end_constant_are_read_by_what_is_in_them(tmp_path: Path) -> None:
    """Read a reply in several frames, each ended by `check, *, CR` or `check, CR`; the rest of each frame is data."""
    protocol = tmp_path / "host-link.yaml"
    protocol.write_bytes((Path(__file__).parents[1] / "data" / protocol.name).read_bytes())
    device = tmp_path / "d.device.yaml"
    device.write_text("device: d\nprotocol: host-link\nmemory: {set: {D100: [1, 2, 3, 4]}}\n")
    frames: list[framekit.Seen] = []
    with framekit.connect(protocol, f"sim:{device}", monitor=frames.append) as client:
        assert client.read("D99", 5) == [0, 1, 2, 3, 4]
        client.write("D30", [7, 8])
        assert client.read("D0", 120) == [0] * 30 + [7, 8] + [0] * 68 + [1, 2, 3, 4] + [0] * 16
    named = [seen.frame for seen in frames if seen.frame is not None and seen.direction == "in"]
    assert named == ["whole", "done", "first", "middle", "middle", "middle", "last"]


@pytest.mark.parametrize(
    ("type_", "order", "values", "words"),
    [
        ("float32", None, [1.5, -2.25], [0x0000, 0x3FC0, 0x0000, 0xC010]),
        ("float32", "ABCD", [1.5, -2.25], [0x3FC0, 0x0000, 0xC010, 0x0000]),
        ("float32", "BADC", [1.5], [0xC03F, 0x0000]),
        ("float32", "DCBA", [1.5], [0x0000, 0xC03F]),
        ("float64", "ABCD", [1.5], [0x3FF8, 0, 0, 0]),
        ("int16", None, [-2, 5], [0xFFFE, 5]),
        ("int32", None, [-2], [0xFFFE, 0xFFFF]),
        ("uint32", "ABCD", [0x12345678], [0x1234, 0x5678]),
        ("uint32", "DCBA", [0x12345678], [0x7856, 0x3412]),
        ("int64", "ABCD", [-2], [0xFFFF, 0xFFFF, 0xFFFF, 0xFFFE]),
        ("string", None, ["Hello"], [0x4865, 0x6C6C, 0x6F00]),
        ("string", "DCBA", ["Hello"], [0x6548, 0x6C6C, 0x006F]),
    ],
)
def test_types(
    shared: framekit.Client, type_: str, order: framekit.Order | None, values: list[float], words: list[int]
) -> None:
    shared.write("40021", values, type=type_, order=order, station=7)
    assert shared.read("40021", len(words), station=7) == words
    count = len("Hello") if type_ == "string" else len(values)
    assert shared.read("40021", count, type=type_, order=order, station=7) == values
    if type_ != "string":
        assert shared.read_many(["40021"], type=type_, order=order, station=7) == values[:1]


def test_a_text_is_filled_up(shared: framekit.Client) -> None:
    shared.write("40031", "AB", type="string", count=6, station=7)
    assert shared.read("40031", 3, station=7) == [0x4142, 0, 0]
    assert shared.read("40031", 6, type="string", station=7) == ["AB"]


def test_services(simulated: str) -> None:
    with framekit.connect("modbus-rtu", simulated, station=7) as client:
        client.call("mask_write", {"address": 0, "and_mask": 0xF0, "or_mask": 5})
        assert client.read("40001") == [100 & 0xF0 | 5]
        answer = client.call("exchange_words", {"address": 0, "count": 2, "write_address": 1, "values": b"\x01\x02"})
        assert answer["values"] == bytes.fromhex("0065 0102")
        assert answer.reply is not None and answer.reply.name == "read_write_reply"


# ---- failures ---------------------------------------------------------------------------------------------------


def test_a_refusal_has_its_code_and_meaning(shared: framekit.Client) -> None:
    arguments = {"address": 65535, "count": 2, "write_address": 1, "values": b"\x01\x02"}
    with pytest.raises(framekit.RefusedError) as refused:
        shared.call("exchange_words", arguments, station=7)
    assert (refused.value.code, refused.value.meaning) == (2, "illegal data address")
    assert refused.value.error_code is framekit.ErrorCode.REFUSED
    assert shared.read("40003", station=7) == [300]


def test_nobody_answers(shared: framekit.Client) -> None:
    with pytest.raises(TimeoutError) as failed:
        shared.read("40001", station=8)
    assert isinstance(failed.value, framekit.NoReplyError)
    assert failed.value.outcome == "no_reply"
    assert shared.read("40003", station=7) == [300]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda client: client.read("4x", station=7), "is not an address"),
        (lambda client: client.read(40001, station=7), "an address is a text: write '40001'"),
        (lambda client: client.read(["40001", "40003"], station=7), "several have read_many"),
        (lambda client: client.read_many([40001], station=7), "write '40001'"),
        (lambda client: client.read("40001", "3", station=7), "count is '3'"),
        (lambda client: client.write(40001, 1, station=7), "write '40001'"),
        (lambda client: client.read("40001"), "needs a station"),
        (lambda client: client.read("40001", station="seven"), "'seven' is not a whole number"),
        (lambda client: client.read("40001", 0, station=7), "the count is 0"),
        (lambda client: client.read("40001", station=7, type="flaot32"), "did you mean 'float32'"),
        (lambda client: client.read("40001", station=7, type="int16", order="ABDC"), "is no order of bytes"),
        (lambda client: client.read("40001", station=7, order="ABCD"), "give a type"),
        (lambda client: client.read("40001", station=7, params={"retrys": 1}), "did you mean 'retries'"),
        (lambda client: client.write("40001", 65536, station=7), "does not fit into a word"),
        (lambda client: client.write("40001", 1.5, station=7), "give a type such as float32"),
        (lambda client: client.write("40001", 1.5, station=7, type="int16"), "1.5 is no int16"),
        (lambda client: client.write("40001", 2**31, station=7, type="int32"), "does not fit"),
        (lambda client: client.write("40001", 2**32, station=7, type="uint32"), "does not fit into a uint32"),
        (lambda client: client.write("40001", "x", station=7), "has the type string"),
        (lambda client: client.write("40001", "abc", station=7, type="string", count=2), "there is room for 2"),
        (lambda client: client.write("30001", 1, station=7), "can only be read"),
        (lambda client: client.call("nope", station=7), "there is no service 'nope'"),
        (lambda client: client.call("mask_write", {"adress": 1}, station=7), "did you mean 'address'"),
        (lambda client: client.send("request", {}), "has no frame"),
        (lambda client: client.send("request_adu", {"station": 7}), "request_adu"),
        (lambda client: client.wait_for("reply_adu"), "frames_alone=True"),
    ],
)
def test_what_cannot_be_asked(shared: framekit.Client, call: Callable[[framekit.Client], object], message: str) -> None:
    SEEN.clear()
    with pytest.raises(ValueError, match=message) as failed:
        call(shared)
    assert isinstance(failed.value, framekit.RequestError)
    assert SEEN == [], "nothing was sent"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"params": {"retrys": 1}}, "did you mean 'retries'"),
        ({"params": {"retries": "many"}}, "retries"),
        ({"station": "x"}, "'x' is not a whole number"),
        ({"format": "9X1"}, "line format"),
        ({"speed": 0}, "line speed"),
        ({"role": "boss"}, "has no role 'boss'"),
    ],
)
def test_settings_that_do_not_fit(simulated: str, arguments: dict[str, object], message: str) -> None:
    with pytest.raises(framekit.RequestError, match=message):
        framekit.connect("modbus-rtu", simulated, **arguments)  # type: ignore[arg-type]


def test_ports_and_definitions_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConnectionError, match="there is no such device"):
        framekit.connect("modbus-rtu", str(tmp_path / "ttyNONE"))
    with pytest.raises(framekit.LineClosedError, match="Connection refused"):
        framekit.connect("modbus-tcp", "tcp://127.0.0.1:1")
    with pytest.raises(framekit.RequestError, match="is no port"):
        framekit.connect("modbus-tcp", "127.0.0.1:502")
    with pytest.raises(framekit.DefinitionError, match="no-such"):
        framekit.connect("modbus-tcp", "sim:no-such.device.yaml")
    with pytest.raises(framekit.DefinitionError, match="there is no definition 'modbus-rtx'"):
        framekit.connect("modbus-rtx", "loop://")
    with pytest.raises(framekit.RequestError, match="is carried by other protocols"):
        framekit.connect("modbus-pdu", "loop://")


# ---- real lines -------------------------------------------------------------------------------------------------


def test_our_device_over_a_pty(tmp_path: Path) -> None:
    with (
        PtyPair() as pair,
        framekit.serve(device_file(tmp_path), pair.first, speed=19200) as device,
        framekit.connect("modbus-rtu", pair.second, speed=19200, station=7) as client,
    ):
        assert client.read("40001", 3) == [100, 200, 300]
        client.write("40005", -1.0, type="float32")
        assert device.memory.read("40005", 2) == [0x0000, 0xBF80]


def test_a_pymodbus_server() -> None:
    with pymodbus_server() as port, framekit.connect("modbus-tcp", port, station=1) as client:
        assert client.read("40001", 150) == list(range(1000, 1150)), "more than one request carries"
        client.write("40010", [1, 2, 3])
        assert client.read("40009", 5) == [1008, 1, 2, 3, 1012]
        with pytest.raises(framekit.RefusedError, match="illegal data address"):
            client.read("49000")


def test_threads_share_a_client() -> None:
    with pymodbus_server() as port, framekit.connect("modbus-tcp", port, station=1) as client:

        def read(number: int) -> list[list[int]]:
            return [list(client.read(f"4{number + 1:04}", 3)) for _ in range(20)]

        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(read, range(0, 80, 10)))
    assert found == [[[1000 + first, 1001 + first, 1002 + first]] * 20 for first in range(0, 80, 10)]


def test_a_line_that_is_pulled(tmp_path: Path) -> None:
    closed = threading.Event()

    def watch(seen: framekit.Seen) -> None:
        if seen.kind == "closed":
            closed.set()

    pair = PtyPair()
    device = framekit.serve(device_file(tmp_path), pair.first)
    with device, framekit.connect("modbus-rtu", pair.second, station=7, monitor=watch) as client:
        assert client.read("40001") == [100]
        pair.close()
        assert closed.wait(10)
        with pytest.raises(ConnectionError, match="is not open"):
            client.read("40001")
        assert not client.is_open


def test_closing_ends_the_calls_of_other_threads() -> None:
    requested = threading.Event()

    async def mute(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(8)
        requested.set()
        await reader.read()
        writer.close()

    from framekit.api.loop_thread import LoopThread

    thread = LoopThread("mute")
    server = thread.wait(asyncio.start_server(mute, "127.0.0.1", 0))
    number = server.sockets[0].getsockname()[1]
    client = framekit.connect("modbus-rtu", f"tcp://127.0.0.1:{number}", station=7, params={"reply_timeout": "1 min"})
    with ThreadPoolExecutor(1) as pool:
        reading = pool.submit(client.read, "40001")
        assert requested.wait(10)
        client.close()
        with pytest.raises(framekit.LineClosedError, match="closed"):
            reading.result(10)
    client.close()
    with pytest.raises(ConnectionError, match="it was closed"):
        client.read("40001")
    thread.do(server.close)
    thread.stop()


@pytest.mark.parametrize("ending", spread(["", "client.close()"], 2))
def test_a_program_ends_with_or_without_closing(tmp_path: Path, ending: str) -> None:
    script = f"""
import framekit
client = framekit.connect("modbus-rtu", "sim:{device_file(tmp_path)}", station=7)
print(client.read("40001", 3))
{ending}
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=180, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "Reading([100, 200, 300], word at 40001)\n"


def test_importing_is_cheap() -> None:
    script = "import sys, framekit; print([name for name in sys.modules if name.startswith('framekit')])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['framekit']"
    assert set(framekit.__all__) <= set(dir(framekit))
    assert all(getattr(framekit, name) is not None for name in framekit.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = framekit.nothing


# ---- asyncio ----------------------------------------------------------------------------------------------------


def reply_of(word: int) -> bytes:
    frame = {"station": 7, "pdu": {"read_holding_reply": {"values": word.to_bytes(2, "big")}}}
    return framekit.load("modbus-rtu").encode("reply_adu", **frame)


def test_a_cancelled_read_leaves_the_line_in_order() -> None:
    """The late reply to the cancelled request would also fit the next request; it must not be returned for that."""

    async def scenario() -> None:
        async with SlowServer() as server, framekit.aconnect("modbus-rtu", server.port, station=7) as client:
            first = asyncio.create_task(client.read("40001"))
            await server.requests.get()
            first.cancel()
            with pytest.raises(asyncio.CancelledError):
                await first
            second = asyncio.create_task(client.read("40002"))
            server.replies.put_nowait(reply_of(111))
            assert (await server.requests.get())[2:4] == b"\x00\x01"
            server.replies.put_nowait(reply_of(222))
            assert await second == [222]

    asyncio.run(asyncio.wait_for(scenario(), 180))


def test_a_cancelled_read_that_waited_is_never_sent() -> None:
    async def scenario() -> None:
        async with SlowServer() as server, framekit.aconnect("modbus-rtu", server.port, station=7) as client:
            first = asyncio.create_task(client.read("40001"))
            await server.requests.get()
            second = asyncio.create_task(client.read("40002"))
            third = asyncio.create_task(client.read("40003"))
            await asyncio.sleep(0)
            second.cancel()
            server.replies.put_nowait(reply_of(1))
            assert await first == [1]
            assert (await server.requests.get())[2:4] == b"\x00\x02"
            server.replies.put_nowait(reply_of(3))
            assert await third == [3]
            assert second.cancelled() and server.requests.empty()

    asyncio.run(asyncio.wait_for(scenario(), 180))


def test_a_time_limit_of_asyncio() -> None:
    async def scenario() -> None:
        async with SlowServer() as server, framekit.aconnect(
            "modbus-rtu", server.port, station=7, params={"reply_timeout": "100 ms"}
        ) as client:  # fmt: skip
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.01):
                    await client.read("40001")
            after = asyncio.create_task(client.read("40002"))
            first = await server.requests.get()
            server.replies.put_nowait(b"")
            assert first[2:4] == b"\x00\x00"
            second = await server.requests.get()
            assert second[2:4] == b"\x00\x01", "what nobody waits for is not repeated"
            for _ in range(8):  # more than the client asks: a server under load may answer after the time-out
                server.replies.put_nowait(reply_of(5))
            assert await after == [5]
            again_asked = [server.requests.get_nowait() for _ in range(server.requests.qsize())]
            assert again_asked and set(again_asked) == {second}, "the first reply is in doubt: asked again, until equal"

    asyncio.run(asyncio.wait_for(scenario(), 180))


def test_tasks_side_by_side_and_opening_by_await(simulated: str) -> None:
    async def scenario() -> None:
        client = await framekit.aconnect("modbus-rtu", simulated, station=7)
        assert client.is_open
        found = await asyncio.gather(client.read("40001"), client.read("40002"), client.read("40003"))
        assert found == [[100], [200], [300]]
        await client.close()
        with pytest.raises(ConnectionError, match="it was closed"):
            await client.read("40001")

    asyncio.run(asyncio.wait_for(scenario(), 180))


def test_commands_side_by_side_are_carried_out_one_after_the_other(tmp_path: Path) -> None:
    device = "device: five\nprotocol: ccm\nstation: 5\nmemory: {set: {'%R101': [11, 22, 33]}}\n"
    (tmp_path / "five.device.yaml").write_text(device, encoding="utf-8")

    async def scenario() -> None:
        async with framekit.aconnect("ccm", f"sim:{tmp_path / 'five.device.yaml'}", own=1) as client:
            blocks = client.command_blocks()

            def command(request: str, number: int, **fields: int) -> bytes:
                return blocks.words.make(request, {"command": number, **fields}, {})

            expected = {"target": 5, "type": 1, "count": 3}
            read, back = dict(expected, address=101, here=200), dict(expected, address=201, here=300)
            write = dict(expected, address=201, here=200)
            ends = await asyncio.gather(
                client.command(blocks, command("ccm_read", 6101, **read)),
                client.command(blocks, command("ccm_write", 6111, **write)),
                client.command(blocks, command("ccm_read", 6101, **back)),
            )
            assert [end.status for end in ends] == [1, 1, 1]
            assert blocks.areas.memory.read("R", "word", 299, 3) == [11, 22, 33]
            waiting = [asyncio.create_task(client.command(blocks, command("ccm_read", 6101, **read))) for _ in range(2)]
            await asyncio.sleep(0)
            waiting[0].cancel()
            client.close_now()
            with pytest.raises(ConnectionError, match="it was closed"):
                await waiting[1]

    asyncio.run(asyncio.wait_for(scenario(), 180))


@pytest.mark.parametrize("ask", ["read", "write", "call"])
def test_parameters_of_a_call_reach_its_times(tmp_path: Path, ask: str) -> None:
    (tmp_path / "d.device.yaml").write_text("device: d\nprotocol: modbus-rtu\nstation: 7\n", encoding="utf-8")
    sent: list[str] = []

    def note(seen: framekit.Seen) -> None:
        if seen.kind == "frame" and seen.direction == "out":
            sent.append(seen.frame)

    with framekit.connect("modbus-rtu", f"sim:{tmp_path / 'd.device.yaml'}", station=9, monitor=note) as client:
        quick = {"reply_timeout": "20 ms", "retries": 1}
        with pytest.raises(framekit.NoReplyError):
            if ask == "read":
                client.read("40001", params=quick)
            elif ask == "write":
                client.write("40001", 1, params=quick)
            else:
                client.call("exception_status", params=quick)
        assert len(sent) == 2, "one repeat, not the usual two"
        assert client.call("exception_status", station=7, params={"reply_timeout": "2 s"}).results == {"status": 0}


# ---- sessions ---------------------------------------------------------------------------------------------------


def test_closing_closes_the_session(tmp_path: Path) -> None:
    (tmp_path / "talk.yaml").write_text(PROTOCOL, encoding="utf-8")
    (tmp_path / "there.device.yaml").write_text(DEVICE, encoding="utf-8")
    sent: list[str] = []

    def watch(seen: framekit.Seen) -> None:
        if seen.kind == "frame":
            sent.append(seen.frame)

    port = f"sim:{tmp_path / 'there.device.yaml'}"
    with framekit.connect(tmp_path / "talk.yaml", port, station=3, monitor=watch) as client:
        assert client.call("get", {"x": 1})["y"] == 9
    assert sent[:7] == ["hello", "welcome", "ask", "answer", "bye", "so_long", "bye"]
    assert sent[7:] in ([], ["so_long"]), "nothing waits for the last one, it may come before the port is closed"


def test_a_run_closes_its_sessions(tmp_path: Path) -> None:
    for name, text in (("talk.yaml", PROTOCOL), ("there.device.yaml", DEVICE), ("talk.run.yaml", TALK)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    sent: list[str] = []
    with framekit.VirtualRun(tmp_path / "talk.run.yaml", on_seen=lambda channel, seen: sent.append(seen.frame)) as run:
        run.run_for("150 ms")
        sent.clear()
    assert [frame for frame in sent if frame] == ["bye", "so_long", "bye"]
    sent.clear()
    with framekit.Run(tmp_path / "talk.run.yaml", on_seen=lambda channel, seen: sent.append(seen.frame)) as real:
        assert real.carry_out(0, timeout=180).done == 1
    ending = [frame for frame in sent if frame]
    assert ending[ending.index("bye") :][:3] == ["bye", "so_long", "bye"]


# ---- frames -----------------------------------------------------------------------------------------------------


def test_frames_sent_and_waited_for() -> None:
    with (
        PtyPair() as pair,
        framekit.connect("third-party-plc", pair.first) as left,
        framekit.connect("third-party-plc", pair.second) as right,
    ):
        left.send("WR.REQ", {"payload": bytes(range(44))})
        left.send("IMM.RESPONSE")
        answer = right.wait_for("IMM.RESPONSE", timeout=180)
        request = right.wait_for(timeout=180)
        assert (answer.name, answer.fields) == ("IMM.RESPONSE", {})
        assert (request.name, request["payload"]) == ("WR.REQ", bytes(range(44)))
        assert request.raw == right_bytes(request)
        with pytest.raises(TimeoutError, match=r"no RD\.DATA came"):
            right.wait_for("RD.DATA", timeout=0)
        left.close()
        with pytest.raises(framekit.RequestError, match="has no frame 'RD'"):
            right.wait_for("RD")


def right_bytes(frame: framekit.Frame) -> bytes:
    return framekit.load("third-party-plc").encode(frame.name, **frame.fields)
