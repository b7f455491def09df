"""Simulated devices of the API: on TCP and pseudo-terminals, with our client and pymodbus, and their memory."""

from __future__ import annotations

import asyncio
import os
import socket
from pathlib import Path

import pytest
from api_world import device_file
from pymodbus.client import ModbusTcpClient

import framekit

LEVEL = """
protocol: level
station: {type: none}
line: {kind: stream, tcp: 4000}
state: {level: {scope: device, type: u8, publish: yes}}
extends: standard
groups: {request: {from: client, head: [{const: 02}]}}
frames:
  SET:  {group: request, body: [{field: level, type: u8}]}
  DONE: {from: server, body: [{const: 06}]}
services:
  set:
    - takes: {level: {type: number}}
      request: {SET: {level: level}}
      serve: {set: {level: request.level}}
      reply: {DONE: {}}
"""


def test_a_protocol_on_tcp_under_two_clients() -> None:
    with framekit.serve("modbus-tcp", "tcp://127.0.0.1:0", station=1, initial={"40001": [1, 2, 3]}) as device:
        number = int(device.port.rpartition(":")[2])
        with framekit.connect("modbus-tcp", device.port, station=1) as ours:
            theirs = ModbusTcpClient("127.0.0.1", port=number)
            assert theirs.connect()
            assert theirs.read_holding_registers(0, count=3, device_id=1).registers == [1, 2, 3]
            ours.write("40002", 20)
            assert theirs.read_holding_registers(1, count=1, device_id=1).registers == [20]
            device.memory["40003"] = 30
            assert ours.read("40001", 3) == [1, 20, 30]
            with pytest.raises(framekit.RefusedError):
                ours.call("exchange_words", {"address": 65535, "count": 9, "write_address": 0, "values": b"12"})
            theirs.close()
            assert (device.done, device.refused) == (4, {2: 1})
    assert device.memory["40003"] == 30, "the memory outlives the line"
    device.close()
    with pytest.raises(ConnectionError):
        framekit.connect("modbus-tcp", device.port)


ROLES = """
protocol: roles
line: {{kind: stream, tcp: {tcp}}}
groups: {{request: {{from: client}}}}
frames:
  ask:  {{group: request, body: [{{const: ENQ}}, {{field: number, type: u8}}]}}
  back: {{from: server, body: [{{const: ACK}}, {{field: number, type: u8}}]}}
sequences:
  exchange:
    takes: [request]
    gives: {{reply: a}}
    local: {{a: frame}}
    steps: [{{step: s, send: request, receive: [{{frame: expected, set: {{a: it}}, then: end}}], within: 2 s}}]
  listen:
    local: {{question: frame}}
    steps:
      - {{step: idle, receive: [{{frame: ask, set: {{question: it}}, then: next}}]}}
      - {{step: answer, send: {{back: {{number: question.number + 1}}}}, then: end}}
roles:
  {serving}: {{lanes: {{main: {{listen: listen}}}}}}
  {asking}: {{lanes: {{main: {{exchange: exchange}}}}}}
services:
  ping:
    - takes: {{n: {{type: number}}}}
      request: {{ask: {{number: n}}}}
      reply: {{back: {{}}}}
      gives: {{n: reply.number}}
"""


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.mark.parametrize(("asking", "serving"), [("computer", "plc"), ("client", "plc"), ("slave", "master")])
def test_roles_of_any_name_on_the_port_of_the_protocol(tmp_path: Path, asking: str, serving: str) -> None:
    number = free_port()
    path = tmp_path / "roles.yaml"
    path.write_text(ROLES.format(tcp=number, asking=asking, serving=serving), encoding="utf-8")
    with framekit.serve(str(path), "tcp://127.0.0.1") as device:
        assert device.port == f"tcp://127.0.0.1:{number}"
        with framekit.connect(str(path), "tcp://127.0.0.1") as client:
            assert client.call("ping", {"n": 4})["n"] == 5


def test_a_protocol_that_no_role_answers_is_not_served(tmp_path: Path) -> None:
    text = ROLES.format(tcp=502, asking="computer", serving="plc")
    path = tmp_path / "roles.yaml"
    path.write_text(text.replace("  plc: {lanes: {main: {listen: listen}}}\n", ""), encoding="utf-8")
    with pytest.raises(framekit.DefinitionError, match="no role of 'roles' listens, so nothing would answer"):
        framekit.serve(str(path), "tcp://127.0.0.1:0")


def test_stations_on_one_pseudo_terminal() -> None:
    with framekit.serve("modbus-rtu", "pty:", station=[1, 2]) as devices:
        with framekit.connect("modbus-rtu", devices.port) as client:
            client.write("40001", 5, station=1)
            client.write("40001", 6, station=2)
        assert (devices.memory_of(1)["40001"], devices.memory_of("2")["40001"]) == (5, 6)
        with pytest.raises(framekit.RequestError, match="no device here has the station 3 – known: 1, 2"):
            devices.memory_of(3)


def test_a_pseudo_terminal_has_the_same_path_after_each_start(tmp_path: Path) -> None:
    path = tmp_path / "plc"
    for value in (5, 6):
        with framekit.serve("modbus-rtu", f"pty:{path}", station=1, initial={"40001": value}) as device:
            assert device.port == str(path) and path.is_symlink()
            with framekit.connect("modbus-rtu", device.port, station=1) as client:
                assert client.read("40001") == [value]
        assert not path.is_symlink()
    path.symlink_to("/dev/pts/9999")  # of a killed program
    with framekit.serve("modbus-rtu", f"pty:{path}", station=1):
        assert os.readlink(path) != "/dev/pts/9999"
    path.write_text("a file of the user", encoding="utf-8")
    with pytest.raises(framekit.RequestError, match="exists and is no link to a terminal"):
        framekit.serve("modbus-rtu", f"pty:{path}", station=1)
    assert path.read_text(encoding="utf-8") == "a file of the user"
    with pytest.raises(framekit.LineClosedError, match="No such file or directory"):
        framekit.serve("modbus-rtu", f"pty:{tmp_path}/none/plc", station=1)


def test_memory_with_types() -> None:
    with framekit.serve("modbus-rtu", "pty:", memory="masterlogic", map={"holding": "M0"}, station=3) as device:
        memory = device.memory
        memory.write("M0100", [1.5, -2.5], type="float32", order="ABCD")
        assert memory.read("M0100", 4) == [0x3FC0, 0, 0xC020, 0]
        assert memory.read("M0100", 2, type="float32", order="ABCD") == [1.5, -2.5]
        memory.write("M0111", -5, type="int32")
        assert memory.read("M0111", type="int32") == [-5]
        assert memory.read("M0111", 1, type="dword") == [0xFFFFFFFB], "a double word at an odd word"
        memory["M00203"] = 1
        assert memory.read("M00200", 5) == [0, 0, 0, 1, 0]
        memory["M0012"] = [7, 8]
        memory.write("M0020", "Hello", type="string", count=8)
        assert memory.read("M0020", 8, type="string") == ["Hello"]
        with framekit.connect("modbus-rtu", device.port, station=3) as client:
            assert client.read("40013", 2) == [7, 8]


@pytest.mark.parametrize(
    ("access", "message"),
    [
        (lambda memory: memory.read("50000"), "is not an address"),
        (lambda memory: memory.read("465536", 2), "not in area|beyond|is not an address"),
        (lambda memory: memory.read("40001", 0), "the count is 0"),
        (lambda memory: memory.read("holding:65535", 2), "holding"),
        (lambda memory: memory.write("40001", 65536), "does not fit into a word"),
        (lambda memory: memory.write("40001", "x"), "has the type string"),
        (lambda memory: memory.write("40001", 1, type="real"), "is not a type"),
    ],
)
def test_memory_refuses(memory: framekit.Memory, access: object, message: str) -> None:
    with pytest.raises(framekit.RequestError, match=message):
        access(memory)  # type: ignore[operator]


@pytest.fixture(scope="module")
def memory() -> framekit.Memory:
    """Return the memory of a device that is no longer served."""
    with framekit.serve("modbus-rtu", "pty:") as device:
        return device.memory


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"port": "tcp://127.0.0.1"}, framekit.RequestError, "is not HOST:PORT"),
        ({"port": "what://x"}, framekit.RequestError, "is no port"),
        ({"port": "/dev/no-such-port"}, framekit.LineClosedError, "there is no such device"),
        ({"port": "tcp://192.0.2.1:0"}, framekit.LineClosedError, "192.0.2.1"),
        ({"port": "pty:", "station": 900}, framekit.DefinitionError, "900"),
        ({"port": "pty:", "params": {"retrys": 1}}, framekit.DefinitionError, "retrys"),
        ({"port": "pty:", "format": "9X1"}, framekit.RequestError, "line format"),
        ({"port": "pty:", "initial": {"40001": 70000}}, framekit.RequestError, "does not fit"),
    ],
)
def test_what_cannot_be_served(arguments: dict[str, object], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        framekit.serve("modbus-rtu", **arguments)  # type: ignore[arg-type]


def test_faults(tmp_path: Path) -> None:
    plan = tmp_path / "bad.faults.yaml"
    plan.write_text("faults: bad\nrules: [{fault: no_reply, every: 2}]\n", encoding="utf-8")
    seen: list[str] = []
    modbus = framekit.load("modbus-tcp")
    with (
        framekit.serve("modbus-tcp", "tcp://127.0.0.1:0", station=1, faults=str(plan)) as device,
        framekit.connect(modbus, device.port, station=1, params={"reply_timeout": "200 ms"}) as client,
    ):
        for _ in range(4):
            try:
                client.read("40001")
                seen.append("done")
            except TimeoutError:
                seen.append("no reply")
    assert seen.count("done") == 2 and seen.count("no reply") == 2


def test_asyncio(tmp_path: Path) -> None:
    async def scenario() -> None:
        seen: list[str] = []
        server = framekit.aserve(device_file(tmp_path), "pty:", monitor=lambda one: seen.append(one.frame))
        with pytest.raises(framekit.RequestError, match="before it is opened"):
            _ = server.memory
        async with server as device, framekit.aconnect("modbus-rtu", device.port, station=7) as client:
            device.memory["40003"] = -1
            assert await client.read("40001", 3) == [100, 200, 0xFFFF]
        assert [frame for frame in seen if frame] == ["request_adu", "reply_adu"]

    asyncio.run(asyncio.wait_for(scenario(), 180))


def test_a_session_without_breaks_on_a_pseudo_terminal() -> None:
    """A pseudo-terminal has no break and no parity, so the session begins with the bare message that opens it."""
    params = {"use_break": "no"}
    with (
        framekit.serve("snp", "pty:", station="33101A", params=params) as device,
        framekit.connect("snp", device.port, station="33101A", params={**params, "privilege": "2"}) as client,
    ):
        client.write("R1", list(range(600)))
        assert client.read("R1", 600) == list(range(600))
        client.write("Q19", [1, 0, 1])
        assert device.memory["Q19"] == 1
        assert client.call("controller_id")["controller"]["id"] == "33101A"


REPLY = """
protocol: named
extends: standard
line: {format: 8E1}
groups: {request: {from: client}}
frames:
  ask:   {group: request, body: [{const: ENQ}, {field: n, type: u8}]}
  reply: {from: server, body: [{const: ACK}, {field: m, type: u8}]}
services:
  ping: [{takes: {n: {type: number}}, request: {ask: {n: n}}, reply: {reply: {m: request.n + 1}}, gives: {m: reply.m}}]
"""


def test_a_frame_may_be_called_reply(tmp_path: Path) -> None:
    (tmp_path / "named.yaml").write_text(REPLY, encoding="utf-8")
    device = tmp_path / "named.device.yaml"
    device.write_text("device: named\nprotocol: named\n", encoding="utf-8")
    with framekit.connect(str(tmp_path / "named.yaml"), f"sim:{device}") as client:
        assert client.call("ping", {"n": 4})["m"] == 5


def test_the_published_state_stays_after_the_last_connection(tmp_path: Path) -> None:
    path = tmp_path / "level.yaml"
    path.write_text(LEVEL, encoding="utf-8")

    async def published_after(level: int) -> object:
        async with framekit.aserve(str(path), "tcp://127.0.0.1:0") as server:
            async with framekit.aconnect(str(path), server.port) as client:
                await client.call("set", {"level": level})
            while server._opened().connected:
                await asyncio.sleep(0)
            return [status.status for status in server.status()]

    assert asyncio.run(asyncio.wait_for(published_after(9), 180)) == [{"level": 9}]
