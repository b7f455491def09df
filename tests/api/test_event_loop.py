"""The event loop of runs, servers and synchronous clients, with and without uvloop (extra `fast`)."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from types import ModuleType

import pytest
from api_world import device_file

import framekit
from framekit.api.event_loop import new_event_loop, run_in_loop
from framekit.cli.main import main

RUN = """
run: r
memory: masterlogic
channels: {1: {port: 'sim:bench.device.yaml', protocol: modbus-rtu, station: 7}}
blocks: {0: {read: '40001', into: M0, channel: 1, every: 1 s}}
"""


class UvLoop(asyncio.SelectorEventLoop):
    """Stands in for the loop of uvloop."""

    made = 0


@pytest.fixture
def uvloop(monkeypatch: pytest.MonkeyPatch) -> type[UvLoop]:
    """Install a module `uvloop` that counts its loops."""

    def make() -> UvLoop:
        UvLoop.made += 1
        return UvLoop()

    module = ModuleType("uvloop")
    module.new_event_loop = make  # type: ignore[attr-defined]
    monkeypatch.setattr(UvLoop, "made", 0)
    monkeypatch.setitem(sys.modules, "uvloop", module)
    return UvLoop


def kind_of_loop() -> type[asyncio.AbstractEventLoop]:
    loop = new_event_loop()
    loop.close()
    return type(loop)


def test_without_uvloop_the_loop_is_of_asyncio(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "uvloop", None)
    assert kind_of_loop().__module__.startswith("asyncio.")


def test_with_uvloop_the_loop_is_of_uvloop_but_never_on_windows(
    uvloop: type[UvLoop], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert kind_of_loop() is uvloop
    monkeypatch.setattr("framekit.api.event_loop.sys.platform", "win32")
    assert kind_of_loop().__module__.startswith("asyncio.")


def test_a_coroutine_runs_in_the_loop(uvloop: type[UvLoop]) -> None:
    async def kind() -> type[asyncio.AbstractEventLoop]:
        return type(asyncio.get_running_loop())

    assert run_in_loop(kind()) is uvloop


def test_the_synchronous_client_uses_the_loop(tmp_path: Path, uvloop: type[UvLoop]) -> None:
    with framekit.connect("modbus-rtu", f"sim:{device_file(tmp_path)}", station=7) as client:
        assert list(client.read("40001")) == [100]
    assert uvloop.made == 1


def test_runs_and_servers_use_the_loop(
    tmp_path: Path, uvloop: type[UvLoop], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    device = device_file(tmp_path)
    (tmp_path / "r.run.yaml").write_text(RUN)
    monkeypatch.chdir(tmp_path)
    assert main(["run", "r.run.yaml", "--for", "1ms", "--quiet"]) == 0, capsys.readouterr()
    assert uvloop.made == 1
    assert main(["serve", str(device), "--port", "tcp://127.0.0.1:0", "--for", "1ms", "--quiet"]) == 0
    assert uvloop.made == 2


def test_exchanges_over_tcp_and_a_pseudo_terminal_in_uvloop() -> None:
    uv = pytest.importorskip("uvloop")
    assert kind_of_loop() is uv.Loop
    for protocol, port in (("modbus-tcp", "tcp://127.0.0.1:0"), ("modbus-rtu", "pty:")):
        with (
            framekit.serve(protocol, port, station=1, initial={"40001": [1, 2, 3]}) as device,
            framekit.connect(protocol, device.port, station=1) as client,
        ):
            client.write("40002", 20)
            assert list(client.read("40001", count=3)) == [1, 20, 3]
