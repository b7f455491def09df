"""Allowed clients of listening ports: accepted and refused connections, with their messages and counters."""

from __future__ import annotations

import logging
import queue
import socket
from pathlib import Path

import pytest

import framekit
from framekit.cli.main import main
from framekit.run.model import ConnectionLimits, in_both, network_of

pytestmark = pytest.mark.usefixtures("each_loop")

ASKS = bytes.fromhex("000100000006010300000001")


def answer_at(port: str) -> bytes:
    """Return the reply to a Modbus request, or no bytes if the connection is closed."""
    host, _, number = port.partition("://")[2].rpartition(":")
    with socket.create_connection((host, int(number)), timeout=60) as client:
        try:
            client.sendall(ASKS)
            return client.recv(1024)
        except ConnectionError:
            return b""


def test_only_clients_of_the_networks_are_answered(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "framekit")
    with framekit.serve("modbus-tcp", "tcp://127.0.0.1:0", allow=["10.0.0.0/8", "127.0.0.0/8"]) as server:
        assert answer_at(server.port)[7] == 3
    with framekit.serve("modbus-tcp", "tcp://127.0.0.1:0", allow=["10.0.0.0/8", "192.168.1.7"]) as server:
        assert [answer_at(server.port) for _ in range(3)] == [b""] * 3
        assert server._server.line_errors == {"clients not allowed": 3}
        assert server._server.connections == 0
    messages = [record.getMessage() for record in caplog.records]
    assert messages == ["127.0.0.1 is not allowed as a client: closed; it is counted from now on"]  # reported once only


def test_senders_of_datagrams_are_refused_too(tmp_path: Path) -> None:
    device = "device: d\nprotocol: modbus-rtu\nstation: 1\nclients: 10.0.0.0/8\n"
    (tmp_path / "d.device.yaml").write_text(device, "utf-8")
    with framekit.serve(tmp_path / "d.device.yaml", "udp-listen://127.0.0.1:0") as server:
        host, _, number = server.port.partition("://")[2].rpartition(":")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            for _ in range(5):
                client.sendto(bytes.fromhex("0103000000018401"[:12] + "840A"), (host, int(number)))
            while server._thread.do(lambda: server._server.line_errors.get("clients not allowed", 0)) < 5:
                pass
    assert server._server.done == 0


def test_what_files_say_holds_where_the_command_line_says_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, station, clients in (("a", 1, "[127.0.0.0/8, 10.0.0.0/8]"), ("b", 2, "127.0.0.1")):
        text = f"device: {name}\nprotocol: modbus-rtu\nstation: {station}\nclients: {clients}\n"
        (tmp_path / f"{name}.device.yaml").write_text(text, "utf-8")
    (tmp_path / "c.device.yaml").write_text("device: c\nprotocol: modbus-rtu\nstation: 3\nclients: [10.0.0.1/24]\n")
    (tmp_path / "e.device.yaml").write_text("device: e\nprotocol: modbus-rtu\nstation: 4\nclients: 10.0.0.1\n", "utf-8")
    with framekit.serve(["a.device.yaml", "b.device.yaml"], "tcp://127.0.0.1:0") as server:
        assert server._server._limits.allowed == (network_of("127.0.0.1"),)
    with framekit.serve("b.device.yaml", "tcp://127.0.0.1:0", allow="10.0.0.0/8") as server:
        assert server._server._limits.allowed == (network_of("10.0.0.0/8"),)
    assert main(["check", "c.device.yaml"]) == 1
    assert capsys.readouterr().err == (
        "c.device.yaml:4:11: '10.0.0.1/24' names one address and a whole network"
        " – write 10.0.0.0/24, or the address alone\n"
    )
    assert main(["serve", "b.device.yaml", "e.device.yaml", "--port", "tcp://127.0.0.1:0", "--for", "1ms"]) == 2
    assert "no client may use all devices of this line" in capsys.readouterr().err
    assert main(["serve", "e.device.yaml", "--port", "pty:", "--allow", "10.0.0.1"]) == 2
    assert "'pty:' has no clients with addresses" in capsys.readouterr().err
    assert main(["serve", "e.device.yaml", "--port", "tcp://127.0.0.1:0", "--allow", "meter.example"]) == 2
    assert "'meter.example' is no address of clients" in capsys.readouterr().err


@pytest.mark.parametrize("clients", ["[127.0.0.1]", "{allow: 127.0.0.0/8, connections: 2}", "10.0.0.0/8"])
def test_a_channel_of_a_run_has_allowed_clients(clients: str, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        number = free.getsockname()[1]
    file = tmp_path / "answers.run.yaml"
    file.write_text(
        "run: answers\nmemory: masterlogic\nchannels:\n"
        f"  1: {{port: 'tcp-listen://127.0.0.1:{number}', protocol: modbus-tcp, role: server, own: 1,"
        f" map: {{holding: M0}}, clients: {clients}}}\n",
        "utf-8",
    )
    states = queue.SimpleQueue[str]()
    run = framekit.Run(file, on_seen=lambda channel, seen: states.put(seen.kind))
    with run:
        while states.get(timeout=60) != "open":
            pass
        assert bool(answer_at(f"tcp://127.0.0.1:{number}")) == (clients != "10.0.0.0/8")
        reasons = run.status().channels[0].reasons
    assert reasons == ({"clients not allowed": 1} if clients == "10.0.0.0/8" else {})


def test_addresses_and_networks() -> None:
    limits = ConnectionLimits(allowed=(network_of("192.168.1.0/24"), network_of("fe80::/10")))
    assert [limits.lets_in(host) for host in ("192.168.1.9", "::ffff:192.168.1.9", "fe80::1%eth0")] == [True] * 3
    assert [limits.lets_in(host) for host in ("192.168.2.9", "::1", "", "meter")] == [False] * 4
    assert ConnectionLimits().lets_in("")
    wide, narrow, other = map(network_of, ("10.0.0.0/8", "10.1.0.0/16", "fd00::/8"))
    assert in_both((wide, other), (narrow, other)) == (narrow, other)
    assert in_both((), (narrow,)) == in_both((narrow,), ()) == (narrow,)
