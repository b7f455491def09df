"""`tls:` ports over real sockets, with generated certificates: accepted clients, refused clients, and messages."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import queue
import socket
import ssl
from pathlib import Path

import pytest

pytest.importorskip("cryptography")

from transport.certificates import DAY, NOW, Authority
from transport.real_world import Waiting, opened, run

import framekit
from framekit.cli.main import main
from framekit.service.written import client_of as who_wrote
from framekit.transport.clock import AsyncioClock
from framekit.transport.network import TcpAcceptedPort
from framekit.transport.port import AcceptedPort
from framekit.transport.schemes import is_known, make_listener, open_port
from framekit.transport.tls_port import MOST_HANDSHAKES, MOST_OF_ONE_ADDRESS, TlsListener, TlsPort

pytestmark = pytest.mark.usefixtures("each_loop")


class Certificates:
    """Certificates for the tests, issued once: `plant` signs the valid, `stranger` the invalid certificates."""

    def __init__(self, folder: Path) -> None:
        plant, stranger = Authority(folder), Authority(folder, "stranger")
        self.ca, self.stranger_ca = plant.ca, stranger.ca
        here = ("127.0.0.1", "localhost")
        self.server, self.key = plant.issue("server", hosts=here)
        self.elsewhere = plant.issue("elsewhere", hosts=("plc-7.example",))
        self.by_address = plant.issue("plc-9.example", hosts=("127.0.0.1",))
        self.old = plant.issue("old", hosts=here, until=NOW - DAY)
        self.client, self.client_key = plant.issue("client")
        self.foreign, self.foreign_key = stranger.issue("foreign", hosts=here)
        self.locked = plant.issue("locked", hosts=here, password=b"open sesame")

    def listening(self, *more: str, cert: tuple[Path, Path] | None = None) -> str:
        server, key = (self.server, self.key) if cert is None else cert
        return "&".join((f"?cert={server}&key={key}", *more))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return Certificates(tmp_path_factory.mktemp("certificates"))


async def listener_with(query: str) -> tuple[TlsListener, asyncio.Queue[AcceptedPort]]:
    accepted: asyncio.Queue[AcceptedPort] = asyncio.Queue()
    clock = AsyncioClock(asyncio.get_running_loop())
    listener = make_listener(f"tls://127.0.0.1:0{query}", clock, accepted.put_nowait)
    assert isinstance(listener, TlsListener)
    await listener.start()
    return listener, accepted


def client_of(listener: TlsListener, query: str) -> TlsPort:
    port = open_port(listener.reached + query, None, AsyncioClock(asyncio.get_running_loop()))
    assert isinstance(port, TlsPort)
    return port


async def refusal(listener: TlsListener, query: str) -> str:
    """Return the reason for which a client is not connected or was disconnected."""
    events = Waiting()
    client_of(listener, query).open(events)
    while (event := await events.queue.get())[0] == "opened":
        pass
    assert event[0] == "closed"
    return str(event[1])


# ---- connections ------------------------------------------------------------------------------------------------


def test_bytes_go_both_ways_with_a_client_that_has_a_certificate(files: Certificates) -> None:
    async def check() -> None:
        listener, accepted = await listener_with(files.listening(f"clients={files.ca}"))
        port = client_of(listener, f"?ca={files.ca}&cert={files.client}&key={files.client_key}")
        here = await opened(port)
        port.write(b"early")  # may arrive before the port of the other side is opened
        other = await accepted.get()
        assert other.host == "127.0.0.1"
        assert other.name == f"tls://{other.sender}"
        there = Waiting()
        other.open(there)
        assert (await there.until("received"))[0] == b"early"
        much = bytes(range(256)) * 2000
        other.write(much)
        came = b""
        while len(came) < len(much):
            came += (await here.until("received"))[0]
        assert came == much
        await there.until("sent")
        other.close()
        assert await here.until("closed") == "the other side has closed the connection"
        listener.stop()

    run(check())


def test_a_name_is_checked_and_can_be_another_one_than_the_host(files: Certificates) -> None:
    async def check() -> None:
        listener, accepted = await listener_with(files.listening(cert=files.elsewhere))
        assert "IP address mismatch, certificate is not valid for '127.0.0.1'" in await refusal(
            listener, f"?ca={files.ca}"
        )
        port = client_of(listener, f"?ca={files.ca}&name=plc-7.example")
        await opened(port)
        (await accepted.get()).close()
        port.close()
        listener.stop()

    run(check())


def test_the_common_name_of_a_certificate_proves_no_host(files: Certificates) -> None:
    """Only the alternative names count, also if they contain an address but no name."""

    async def check() -> None:
        listener, _ = await listener_with(files.listening(cert=files.by_address))
        assert "certificate is not valid for 'plc-9.example'" in await refusal(
            listener, f"?ca={files.ca}&name=plc-9.example"
        )
        listener.stop()

    run(check())


def test_who_is_not_let_in(files: Certificates, caplog: pytest.LogCaptureFixture) -> None:
    async def check() -> None:
        caplog.set_level(logging.WARNING, "framekit")
        good = f"?ca={files.ca}"
        listener, accepted = await listener_with(files.listening(f"clients={files.ca}"))
        assert "give cert= and key=" in await refusal(listener, good)
        stranger = f"{good}&cert={files.foreign}&key={files.foreign_key}"
        assert await refusal(listener, stranger)
        signed_by_another = await refusal(listener, f"?ca={files.stranger_ca}")
        assert "the certificate of the other side is not good: self-signed certificate" in signed_by_another
        assert "the certificate of the other side is not good" in await refusal(listener, "")  # system authorities
        with socket.create_connection(("127.0.0.1", listener.number)) as plain:
            plain.sendall(bytes.fromhex("000100000006010300000001"))
            assert await asyncio.get_running_loop().run_in_executor(None, plain.recv, 1024) != b"\0"
        listener.stop()
        old, _ = await listener_with(files.listening(cert=files.old))
        assert "certificate has expired" in await refusal(old, good)
        old.stop()
        assert accepted.empty()

    run(check())
    messages = [record.getMessage() for record in caplog.records]
    assert any("no handshake with 127.0.0.1:" in line and "has no certificate" in line for line in messages)
    assert any("does not speak TLS" in line for line in messages)
    assert len(messages) >= 3


def test_versions_that_are_too_old_are_refused(files: Certificates, caplog: pytest.LogCaptureFixture) -> None:
    async def check() -> None:
        listener, _ = await listener_with(files.listening())
        context = ssl.create_default_context(cafile=str(files.ca))
        with pytest.warns(DeprecationWarning):
            context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
        context.set_ciphers("ALL:@SECLEVEL=0")
        with pytest.raises((ssl.SSLError, ConnectionResetError)):
            await asyncio.open_connection("127.0.0.1", listener.number, ssl=context)
        listener.stop()
        assert "unsupported protocol" in caplog.text

    run(check())


# ---- names and files --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("query", "listens", "what"),
    [
        ("", True, "a tls: port that listens needs a certificate and its key"),
        ("?cret=a", True, "a tls: port has no 'cret' – did you mean 'cert'?"),
        ("?cert=a&ca=b", True, "'ca' is nothing for a tls: port that listens – known are cert, key, clients"),
        ("?clients=a", False, "'clients' is nothing for a tls: port that connects"),
        ("?key=a", False, "a tls: port has a key and no certificate"),
        ("?ca=", False, "'ca' of a tls: port names nothing"),
        ("?ca=a&ca=b", False, "'ca' of a tls: port names two things"),
    ],
)
def test_a_wrong_name_is_told(query: str, listens: bool, what: str) -> None:
    async def check() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        with pytest.raises(ValueError, match="tls: port") as raised:
            if listens:
                make_listener(f"tls://127.0.0.1:0{query}", clock, lambda port: None)
            else:
                open_port(f"tls://127.0.0.1:1{query}", None, clock)
        assert str(raised.value).startswith(what)

    assert is_known("tls://127.0.0.1:1")
    run(check())


def test_files_that_cannot_be_used_are_told_without_their_content(files: Certificates, tmp_path: Path) -> None:
    nonsense = tmp_path / "nonsense.pem"
    nonsense.write_text("a secret\n", "utf-8")

    async def why_not(query: str) -> str:
        with pytest.raises(OSError, match=r"\w") as raised:
            await listener_with(query)
        return str(raised.value)

    async def check() -> None:
        assert await why_not(f"?cert={tmp_path}/none.pem&key={files.key}") == (
            f"{tmp_path}/none.pem: it is not there, or may not be read"
        )
        for query in (
            files.listening(cert=(nonsense, nonsense)),
            files.listening(cert=(files.server, files.client_key)),
        ):
            assert "hold no certificate in PEM with the key that fits it" in await why_not(query)
        assert await why_not(files.listening(cert=files.locked)) == (
            "the key has a password, and a port cannot ask for it – keep the key in a file without one"
        )
        assert await why_not(files.listening(f"clients={nonsense}")) == f"{nonsense} holds no certificates in PEM"
        listener, _ = await listener_with(files.listening())
        reason = await refusal(listener, f"?ca={nonsense}")
        assert reason == f"no connection to 127.0.0.1:{listener.number}: {nonsense} holds no certificates in PEM"
        listener.stop()

    run(check())


# ---- in use -----------------------------------------------------------------------------------------------------


def test_a_device_is_served_and_read_over_tls(files: Certificates, capsys: pytest.CaptureFixture[str]) -> None:
    place = f"tls://127.0.0.1:0{files.listening(f'clients={files.ca}')}"
    with framekit.serve("modbus-tcp", place, initial={"40001": [7, 8]}) as server:
        assert server.port.startswith("tls://127.0.0.1:")
        assert "?" not in server.port
        client = f"{server.port}?ca={files.ca}&cert={files.client}&key={files.client_key}"
        assert main(["read", "modbus-tcp", "--port", client, "--station", "1", "40001", "-n", "2"]) == 0
        assert capsys.readouterr().out == "40001  7 8\n"
        assert main(["read", "modbus-tcp", "--port", f"{server.port}?ca={files.ca}", "--station", "1", "40001"]) == 3
        assert (
            main(["read", "modbus-tcp", "--port", f"{server.port}?ca={files.stranger_ca}", "--station", "1", "40001"])
            == 3
        )
        assert "the certificate of the other side is not good" in capsys.readouterr().err


def test_strangers_are_closed_before_a_handshake(files: Certificates, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "framekit")
    with framekit.serve("modbus-tcp", f"tls://127.0.0.1:0{files.listening()}", allow="10.0.0.0/8") as server:
        assert main(["read", "modbus-tcp", "--port", f"{server.port}?ca={files.ca}", "--station", "1", "40001"]) == 3
        assert server._server.line_errors["clients not allowed"] >= 1
    assert "127.0.0.1 is not allowed as a client" in caplog.text
    assert "no handshake" not in caplog.text


def test_connections_that_say_nothing_shut_out_none(files: Certificates, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "framekit")
    place = f"tls://127.0.0.1:0{files.listening()}"
    with contextlib.ExitStack() as silent, framekit.serve("modbus-tcp", place, initial={"40001": 7}) as server:
        number = int(server.port.rpartition(":")[2])
        for _ in range(70):
            silent.enter_context(socket.create_connection(("127.0.0.1", number)))
        with framekit.connect("modbus-tcp", f"{server.port}?ca={files.ca}", station=1) as client:
            assert client.read("40001") == [7]
        assert server._server.line_errors["connections refused"] >= 70 - MOST_OF_ONE_ADDRESS
    assert [message for message in caplog.messages if "connections refused" in message] == [
        "127.0.0.1 has too many connections: connections refused; they are counted from now on"
    ]


def test_room_is_made_where_most_is_taken(files: Certificates) -> None:
    async def check() -> None:
        listener, _ = await listener_with(files.listening())
        refused: list[str] = []
        listener.refused = refused.append
        for number in range(MOST_HANDSHAKES):
            task = asyncio.get_running_loop().create_task(asyncio.Event().wait())
            listener._handshakes[task] = "10.0.0.1" if number % 8 == 0 else f"10.0.1.{number}"  # type: ignore[index]
        listener._make_room("10.0.0.2")
        assert refused == ["10.0.0.1"]
        assert len(listener._handshakes) == MOST_HANDSHAKES - 1
        listener.stop()

    run(check())


def test_a_new_certificate_needs_no_restart(
    files: Certificates, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "framekit")
    cert, key = tmp_path / "mine.pem", tmp_path / "mine.key"

    def put(path: Path, content: bytes) -> None:
        new = path.with_suffix(".new")
        new.write_bytes(content)
        new.replace(path)

    async def check() -> None:
        put(cert, files.old[0].read_bytes())
        put(key, files.old[1].read_bytes())
        listener, _ = await listener_with(files.listening(cert=(cert, key)))
        good = f"?ca={files.ca}"
        assert "certificate has expired" in await refusal(listener, good)
        put(cert, files.server.read_bytes())
        assert "certificate has expired" in await refusal(listener, good)  # the key does not match yet
        put(key, files.key.read_bytes())
        port = client_of(listener, good)
        await opened(port)
        port.close()
        listener.stop()

    run(check())
    messages = [
        message.partition(" ")[2]
        for message in caplog.messages
        if "certificate" in message and "no handshake" not in message
    ]
    assert messages == [
        f"goes on with the certificate that it has: {cert} and {key}: they hold no certificate in PEM"
        " with the key that fits it",
        "its certificate was read anew",
    ]


def test_the_log_of_writes_names_who_the_certificate_names(
    files: Certificates, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "framekit.written")
    place = f"tls://127.0.0.1:0{files.listening(f'clients={files.ca}')}"
    with framekit.serve(["modbus-tcp"], place, station=[1, 2]) as server:
        client = f"{server.port}?ca={files.ca}&cert={files.client}&key={files.client_key}"
        assert main(["write", "modbus-tcp", "--port", client, "--station", "2", "40001", "5"]) == 0
    (message,) = [record.getMessage() for record in caplog.records if record.name == "framekit.written"]
    assert message.startswith("modbus-tcp 2: 40001: 0 → 5, written by 127.0.0.1:")
    assert message.endswith(" ('client')")


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("a) written by 10.9.9.9:1 (boss", "('a) written by 10.9.9.9:1 (boss')"),
        ("a') written by 10.9.9.9:1 ('boss", """("a') written by 10.9.9.9:1 ('boss")"""),
        ("""a"') written""", """('a"\\') written')"""),
        ("x" * 65, f"('{'x' * 64}'…)"),
    ],
)
def test_the_name_in_a_certificate_cannot_be_taken_for_words_of_the_log(name: str, shown: str) -> None:
    async def check() -> None:
        port = TcpAcceptedPort("127.0.0.1:5", AsyncioClock(asyncio.get_running_loop()))
        port.identity = name
        assert who_wrote(port) == f"127.0.0.1:5 {shown}"

    run(check())


def test_a_run_names_the_files_beside_it(files: Certificates, tmp_path: Path) -> None:
    for file in (files.ca, files.server, files.key):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    run_file = tmp_path / "secure.run.yaml"
    with framekit.serve("modbus-tcp", f"tls://127.0.0.1:0{files.listening()}", initial={"40001": 4711}) as server:
        run_file.write_text(
            "run: secure\nmemory: masterlogic\nchannels:\n"
            f"  1: {{port: '{server.port}?ca=plant-ca.pem', protocol: modbus-tcp, station: 1}}\n"
            "  2: {port: 'tls://127.0.0.1:0?cert=server.pem&key=server.key', protocol: modbus-tcp, role: server}\n"
            'blocks:\n  0: {read: "40001", into: M7, channel: 1, every: 10 ms}\n',
            "utf-8",
        )
        came = queue.SimpleQueue[int]()
        run_at_work = framekit.Run(run_file)
        run_at_work.memory.watch("M7", lambda values: came.put(values[0]))
        with run_at_work:
            assert came.get(timeout=60) == 4711
            shown = run_at_work.status().channels
            assert [connection.port for connection in shown] == [server.port, "tls://127.0.0.1:0"]  # without the files
    run_file.write_text(run_file.read_text("utf-8").replace("?ca=", "?cu="), "utf-8")
    with pytest.raises(framekit.DefinitionError, match="a tls: port has no 'cu'"):
        framekit.Run(run_file)
