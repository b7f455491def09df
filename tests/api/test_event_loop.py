"""The event loop of runs, servers and synchronous clients: asyncio's or, with the extra `fast`, uvloop's."""

from __future__ import annotations

import asyncio
import queue
import socket
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

import pytest
from api_world import device_file

import framekit
from framekit.api.event_loop import LOOP_VARIABLE, new_event_loop
from framekit.cli.common import run_in_loop
from framekit.cli.main import main

RUN = """
run: r
memory: masterlogic
channels: {{1: {{port: '{port}', protocol: {protocol}, station: {station}}}}}
blocks: {{0: {{read: '40001', into: M0, channel: 1, every: 1 ms}}}}
"""
ASKS = bytes.fromhex("000100000006010300000001")
CLIENTS = 50
"""Number of clients one after another; the bytes of a client can arrive before or after the server opens its port."""


class UvLoop(asyncio.SelectorEventLoop):
    """A stand-in for uvloop's event loop."""

    made = 0


@pytest.fixture
def uvloop(monkeypatch: pytest.MonkeyPatch) -> type[UvLoop]:
    """Install a module `uvloop` that counts its loops, and leave the choice of the loop to framekit."""

    def make() -> UvLoop:
        UvLoop.made += 1
        return UvLoop()

    module = ModuleType("uvloop")
    module.__spec__ = ModuleSpec("uvloop", None)
    module.new_event_loop = make  # type: ignore[attr-defined]
    monkeypatch.setattr(UvLoop, "made", 0)
    monkeypatch.setitem(sys.modules, "uvloop", module)
    monkeypatch.delenv(LOOP_VARIABLE)
    return UvLoop


@pytest.fixture
def no_uvloop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the import system find no module `uvloop`."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.delenv(LOOP_VARIABLE)


def kind_of_loop() -> type[asyncio.AbstractEventLoop]:
    loop = new_event_loop()
    loop.close()
    return type(loop)


# ---- the choice ---------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_uvloop")
def test_without_uvloop_the_loop_is_of_asyncio(monkeypatch: pytest.MonkeyPatch) -> None:
    assert kind_of_loop().__module__.startswith("asyncio.")
    monkeypatch.setenv(LOOP_VARIABLE, "uvloop")
    with pytest.raises(framekit.RequestError, match="uvloop is not installed"):
        new_event_loop()


def test_with_uvloop_the_loop_is_of_uvloop_but_never_on_windows(
    uvloop: type[UvLoop], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert kind_of_loop() is uvloop
    monkeypatch.setenv(LOOP_VARIABLE, "")
    assert kind_of_loop() is uvloop
    monkeypatch.setattr("framekit.api.event_loop.sys.platform", "win32")
    assert kind_of_loop().__module__.startswith("asyncio.")


def test_the_variable_turns_uvloop_off(uvloop: type[UvLoop], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LOOP_VARIABLE, "asyncio")
    assert kind_of_loop().__module__.startswith("asyncio.")
    assert uvloop.made == 0


@pytest.mark.parametrize("verb", ["run", "serve", "read"])
def test_a_wrong_choice_is_an_error_of_the_command_line(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(LOOP_VARIABLE, "twisted")
    device = device_file(tmp_path)
    (tmp_path / "r.run.yaml").write_text(RUN.format(port=f"sim:{device.name}", protocol="modbus-rtu", station=7))
    words = {
        "run": ["run", str(tmp_path / "r.run.yaml"), "--for", "1ms", "--quiet"],
        "serve": ["serve", str(device), "--port", "tcp://127.0.0.1:0", "--for", "1ms", "--quiet"],
        "read": ["read", "modbus-rtu", "--port", f"sim:{device}", "--station", "7", "40001"],
    }
    assert main(words[verb]) == 2
    message = "FRAMEKIT_LOOP=twisted: this is no event loop – known are asyncio and uvloop"
    assert capsys.readouterr().err.strip().endswith(message)


# ---- who uses it --------------------------------------------------------------------------------------------


def test_a_coroutine_runs_in_the_loop(uvloop: type[UvLoop]) -> None:
    async def kind() -> type[asyncio.AbstractEventLoop]:
        return type(asyncio.get_running_loop())

    assert run_in_loop(kind()) is uvloop


def test_the_synchronous_client_uses_the_loop(tmp_path: Path, uvloop: type[UvLoop]) -> None:
    with framekit.connect("modbus-rtu", f"sim:{device_file(tmp_path)}", station=7) as client:
        assert list(client.read("40001")) == [100]
    assert uvloop.made == 1


def test_runs_and_servers_use_the_loop(
    tmp_path: Path, uvloop: type[UvLoop], capsys: pytest.CaptureFixture[str]
) -> None:
    device = device_file(tmp_path)
    file = tmp_path / "r.run.yaml"
    file.write_text(RUN.format(port=f"sim:{device.name}", protocol="modbus-rtu", station=7))
    assert main(["run", str(file), "--for", "1ms", "--quiet"]) == 0, capsys.readouterr()
    assert uvloop.made == 1
    assert main(["serve", str(device), "--port", "tcp://127.0.0.1:0", "--for", "1ms", "--quiet"]) == 0
    assert uvloop.made == 2


# ---- exchanges in both loops --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("protocol", "port"),
    [
        ("modbus-tcp", "tcp://127.0.0.1:0"),
        ("modbus-rtu", "tcp://127.0.0.1:0"),
        ("modbus-rtu", "udp-listen://127.0.0.1:0"),
        ("modbus-rtu", "pty:"),
    ],
)
def test_a_client_reads_and_writes_a_served_device(protocol: str, port: str, each_loop: str) -> None:
    assert kind_of_loop().__module__.startswith(each_loop)
    with framekit.serve(protocol, port, station=1, initial={"40001": [1, 2, 3]}) as device:
        reached = device.port.replace("udp-listen:", "udp:")
        with framekit.connect(protocol, reached, station=1, params={"reply_timeout": "60 s"}) as client:
            client.write("40002", 20)
            assert list(client.read("40001", count=3)) == [1, 20, 3]


def test_every_client_of_a_server_is_answered(each_loop: str) -> None:
    assert kind_of_loop().__module__.startswith(each_loop)
    with framekit.serve("modbus-tcp", "tcp://127.0.0.1:0", initial={"40001": 7}) as server:
        host, _, number = server.port.partition("://")[2].rpartition(":")
        for _ in range(CLIENTS):
            with socket.create_connection((host, int(number)), timeout=60) as client:
                client.sendall(ASKS)
                assert client.recv(1024)[-2:] == b"\0\7"


def test_a_run_reads_a_served_device(tmp_path: Path, each_loop: str) -> None:
    assert kind_of_loop().__module__.startswith(each_loop)
    with framekit.serve("modbus-tcp", "tcp://127.0.0.1:0", initial={"40001": 7}) as server:
        file = tmp_path / "r.run.yaml"
        file.write_text(RUN.format(port=server.port, protocol="modbus-tcp", station=1))
        frames = queue.SimpleQueue[str]()
        with framekit.Run(file, on_seen=lambda channel, seen: frames.put(seen.direction)) as run:
            for _ in range(20):
                while frames.get(timeout=60) != "in":
                    pass
            assert run.memory.read("M0", 1) == [7]
