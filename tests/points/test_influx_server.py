"""Values in a real InfluxDB (Debian's `influxdb`), which is killed and restarted meanwhile."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from points.mosquitto import free_port

import framekit

PROGRAM = shutil.which("influxd")
pytestmark = [pytest.mark.long, pytest.mark.skipif(PROGRAM is None, reason="influxdb is not installed")]
CONFIG = """
reporting-disabled = true
bind-address = "127.0.0.1:{rpc}"
[meta]
  dir = "{folder}/meta"
[data]
  dir = "{folder}/data"
  wal-dir = "{folder}/wal"
[http]
  bind-address = "127.0.0.1:{port}"
  log-enabled = false
[monitor]
  store-enabled = false
"""


class Influx:
    """A server on a free port."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self._file = folder / "influx.conf"
        self._file.write_text(CONFIG.format(folder=folder, port=self.port, rpc=free_port()))
        self.start()

    def start(self) -> None:
        assert PROGRAM is not None
        words = [PROGRAM, "-config", str(self._file)]
        self._process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for _ in range(1000):
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
                return
            except OSError:
                time.sleep(0.02)
        raise AssertionError("influxd does not start")

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def ask(self, query: str, **more: str) -> list[list[Any]]:
        """Return the rows of a query."""
        data = urllib.parse.urlencode({"q": query, **more}).encode()
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/query", data, 10) as answer:
            found = json.load(answer)["results"][0].get("series", [])
        return [row for series in found for row in series["values"]]


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Influx]:
    found = Influx(tmp_path)
    yield found
    found.kill()


def until(found: Any, wanted: Any) -> None:
    """Wait until `found()` returns the wanted value."""
    end = time.monotonic() + 60
    while (now := found()) != wanted:
        assert time.monotonic() < end, now
        time.sleep(0.05)


def test_values_are_there_also_those_that_came_while_it_was_away(server: Influx, tmp_path: Path) -> None:
    server.ask("CREATE DATABASE plant")
    (tmp_path / "none.device.yaml").write_text("device: none\nprotocol: modbus-tcp\nstation: 1\n", "utf-8")
    path = tmp_path / "plant.run.yaml"
    path.write_text(
        "run: plant\nmemory: masterlogic\n"
        'channels: {1: {port: "sim:none.device.yaml", protocol: modbus-tcp, station: 1}}\n'
        "points:\n  level: {address: '%MW10', scale: 0.1, unit: m}\n  flow.rate: {address: '%MW11'}\n"
        f'sinks: [{{influx: "http://127.0.0.1:{server.port}", database: plant}}]\n',
        "utf-8",
    )
    numbers = list(range(1, 41))

    def values(point: str = "level") -> list[Any]:
        query = f'SELECT "value" FROM "plant" WHERE "point" = \'{point}\' AND "quality" = \'good\''
        return [row[1] for row in server.ask(query, db="plant")]

    with framekit.Run(path) as run:
        for number in numbers[:20]:
            run.memory["%MW10"] = number
            time.sleep(0.005)
        run.memory["%MW11"] = 7
        until(lambda: values()[-20:], [number / 10 for number in numbers[:20]])
        server.kill()
        for number in numbers[20:]:
            run.memory["%MW10"] = number
            time.sleep(0.005)
        until(lambda: bool(run.status().sinks[0].problem), True)
        server.start()
        until(lambda: run.status().sinks[0].waiting, 0)
        assert values()[-40:] == [number / 10 for number in numbers]
        assert values("flow.rate")[-1:] == [7]
        units = server.ask('SHOW TAG VALUES FROM "plant" WITH KEY = "unit"', db="plant")
        assert units == [["unit", "m"]]
        assert run.status().sinks[0].dropped == 0
