"""Service requests over a connection: our client with our server, on virtual time and over real TCP."""

from __future__ import annotations

import asyncio
import socket
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from link.link_world import Side, compiled
from near_run import started
from shipped import file_of
from spread import TRANSFERS
from transfer_world import TransferWorld

import framekit
from framekit.api.run import run_status
from framekit.cli.main import main
from framekit.cli.run_output import status_text
from framekit.link.services.client import ServiceClient, TransferResult
from framekit.transport.clock import VirtualClock

PROTOCOL = "srtp"


@cache
def loaded() -> Any:
    return framekit.load(PROTOCOL)


@pytest.fixture(scope="module")
def server(each_loop: str) -> Any:
    with framekit.serve(PROTOCOL, "tcp://127.0.0.1:0") as running:
        yield running


@pytest.fixture
def device(server: Any) -> Any:
    server.memory["R1"] = [1, 2, 3, 4, 5]
    return server


def connect(device: Any, **params: str) -> Any:
    return framekit.connect(loaded(), device.port, params=params)


def raw_header(port: str, data: bytes) -> bytes:
    """Return the server's reply to bytes that our client would never send."""
    host, number = port.removeprefix("tcp://").split(":")
    with socket.create_connection((host, int(number)), timeout=180) as connection:
        connection.sendall(data)
        return connection.recv(4096)


# ---- real TCP --------------------------------------------------------------------------------------------------


def test_inline_and_following_data(device: Any) -> None:
    with connect(device, allow="writes") as client:
        assert client.read("%R1", 3) == [1, 2, 3]
        assert client.read("%R1", 5) == [1, 2, 3, 4, 5]
        client.write("%R11", [10, 20, 30, 40])
        client.write("%R21", list(range(1, 6)))
        assert client.read("%R11", 15) == [10, 20, 30, 40, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5]
        values = [(7919 * place) & 0xFFFF for place in range(1500)]
        client.write("%R101", values)
        assert client.read("%R101", 1500) == values
    assert device.memory.read("R11", 4) == [10, 20, 30, 40]


def test_every_memory_type(device: Any) -> None:
    with connect(device, allow="writes") as client:
        for area in ("I", "Q", "T", "M", "SA", "SB", "SC", "G"):
            client.write(f"%{area}3", [1, 0, 1, 1, 0, 0, 0, 1])
            assert client.read(f"%{area}1", 12) == [0, 0, 1, 0, 1, 1, 0, 0, 0, 1, 0, 0]
            client.write(f"%{area}1", [0x55, 0xAA], type="byte")
            assert client.read(f"%{area}1", 2, type="byte") == [0x55, 0xAA]
        for area in ("R", "AI", "AQ"):
            client.write(f"%{area}40", [0x1234, 0xFEDC])
            assert client.read(f"%{area}39", 4) == [0, 0x1234, 0xFEDC, 0]
        assert client.read("%S1", 4) == [0, 0, 0, 0]


def test_a_client_only_reads_unless_it_is_allowed_more(device: Any) -> None:
    with connect(device) as client:
        with pytest.raises(framekit.ExchangeError) as caught:
            client.write("%R1", 9)
        assert caught.value.outcome == "not_allowed"
        assert "the parameter allow has to be writes" in str(caught.value)
        with pytest.raises(framekit.ExchangeError, match="the parameter allow has to be everything"):
            client.call("set_state", {"state": 2})
        assert client.read("%R1") == [1], "the connection is as good as before"
        assert client.call("short_status")["plc"]["state"] == 2
    assert device.memory.read("R1", 1) == [1]


def test_a_run_says_why_a_write_was_kept_back(tmp_path: Path) -> None:
    clock = VirtualClock()
    run = (
        "run: r\nmemory: masterlogic\nchannels: {1: {port: 'sim:there.device.yaml', protocol: srtp}}\n"
        "blocks: {0: {write: '%R301', from: M200, once: yes}}\n"
    )
    service = started(tmp_path, run, "device: there\nprotocol: srtp\n", clock)
    clock.run_for(1_000_000_000)
    assert "not_allowed: the parameter allow has to be writes" in status_text(run_status(service), 0)


def test_refusals_by_name(device: Any) -> None:
    with connect(device, allow="everything") as client:
        with pytest.raises(framekit.RefusedError, match="given connection ID not found") as caught:
            client.call("update_datagram", {"id": 7})
        assert caught.value.code == 0x05DD
        with pytest.raises(framekit.RefusedError, match="only allowed for the programmer"):
            client.call("set_state", {"state": 0})
        client.call("logon")
        client.call("set_state", {"state": 0})
        assert client.call("short_status")["plc"]["state"] == 0


def test_session_slots_and_time(device: Any) -> None:
    with connect(device, open_session="yes", slot="2", stamp_time="yes") as client:
        assert client.read("%R1") == [1]
        assert client.call("get_time")["time"]["month"] in range(1, 13)


def test_many_requests_at_once_on_one_connection(device: Any) -> None:
    async def ask() -> list[Any]:
        async with framekit.aconnect(loaded(), device.port, params={"outstanding": "8"}) as client:
            return await asyncio.gather(*(client.read(f"%R{1 + number % 5}") for number in range(200)))

    assert asyncio.run(ask()) == [[1 + number % 5] for number in range(200)]


def test_the_command_line(device: Any, capsys: pytest.CaptureFixture[str]) -> None:
    line = (PROTOCOL, "--port", device.port)
    assert main(["read", *line, "%R1", "-n", "5"]) == 0
    assert capsys.readouterr().out == "%R1  1 2 3 4 5\n"
    assert main(["write", *line, "%R1", "7"]) != 0
    assert "do not allow such a request" in capsys.readouterr().err
    assert main(["write", *line, "%R1", "7", "--param", "allow=writes"]) == 0
    assert device.memory.read("R1", 1) == [7]


def test_strangers_do_no_harm(device: Any) -> None:
    assert raw_header(device.port, b"\x09" * 56)[0] == 5, "an error PDU, then the connection is closed"
    assert raw_header(device.port, b"\x00" * 56) == b"\x01" + bytes(55)
    with connect(device) as client:
        assert client.read("%R1") == [1]


# ---- virtual time ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", TRANSFERS)
def test_transfers_up_to_2_kb(count: int) -> None:
    world = TransferWorld(PROTOCOL, "client", "server", params={"allow": "writes"})
    world.mixed(count, {"R1": 1024, "R1501": 40, "I1": 256, "Q17": 64, "M35": 77}, longest=1024)
    assert world.wrong == []
    assert world.outcomes == {"ok": count}


def test_task_and_block_memory_of_the_large_family() -> None:
    params = {"allow": "writes", "family": "90-70", "task": "STAT_1", "block": "SUB1"}
    world = TransferWorld(PROTOCOL, "client", "server", params=params)

    def done(method: Any, *arguments: Any, **options: Any) -> TransferResult:
        return world.do(lambda **keys: method(*arguments, station=None, **options, **keys))

    for address in ("P39", "L9"):
        assert done(world.client.write, address, [0x4A9B, 0x3463, 0x1ACB, 0x91D4, 0x8BC3]).ok
        assert done(world.client.read, address, count=5).values == [0x4A9B, 0x3463, 0x1ACB, 0x91D4, 0x8BC3]
        assert done(world.client.read, address, count=2).values == [0x4A9B, 0x3463]


def read_word(asking: Side, client: ServiceClient, results: dict[int, Any], number: int) -> None:
    def store(done: TransferResult) -> None:
        results[number] = done.values

    asking.do(client.read(f"R{number}", now=asking.now, on_done=store).commands)


def answer_to(request: bytes, value: int) -> bytes:
    """Return the reply to a request for one word, with the numbers of the request."""
    header = b"\x03\0" + request[2:4] + bytes(26) + request[30:31]
    mailbox = b"\xd4" + request[36:40] + request[32:36] + b"\1\1\0\0" + value.to_bytes(2, "little")
    return (header + mailbox).ljust(56, b"\0")


@pytest.mark.long
def test_replies_in_any_order_find_their_requests() -> None:
    text = file_of(f"{PROTOCOL}.yaml").read_text(encoding="utf-8")
    protocol, codec = compiled(text)
    asking = Side(text, "client", params={"outstanding": 4})
    client = ServiceClient(protocol, codec, asking.engine)
    results: dict[int, Any] = {}
    for number in range(1, 7):
        read_word(asking, client, results, number)
    asking.run(0)
    assert asking.taken() == [bytes(56)]
    asking.gets(b"\x01" + bytes(55), whole=True)
    asking.run(0)
    requests = asking.taken()
    assert [(data[2], data[30], data[44]) for data in requests] == [(1, 1, 0), (2, 2, 1), (3, 3, 2), (4, 4, 3)]
    asking.gets(answer_to(requests[2], 30) + answer_to(requests[0], 10), whole=True)
    asking.run(0)
    assert results == {3: [30], 1: [10]}
    requests[4:] = asking.taken()
    assert [(data[2], data[44]) for data in requests[4:]] == [(5, 4), (6, 5)], "two more as two have ended"
    for place in (5, 3, 4, 1):
        asking.gets(answer_to(requests[place], 10 * place + 10), whole=True)
    asking.run(0)
    assert results == {number: [10 * number] for number in range(1, 7)}


def test_a_restart_of_the_server_only_costs_what_is_under_way() -> None:
    world = TransferWorld(PROTOCOL, "client", "server")

    def read() -> TransferResult:
        return world.do(lambda **keys: world.client.read("R1", **keys))

    assert read().ok
    for driver in world.drivers:
        driver.closed(world.clock.now(), "gone")
    assert read().outcome == "closed"
    world.clock.run_for(2_000_000_000)
    assert read().ok, "connected and opened again"
