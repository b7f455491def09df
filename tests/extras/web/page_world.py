"""A run with a simulated meter, and its page without a browser: by sessions, and over sockets."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from framekit.api.monitor import FrameLog
from framekit.api.run import AsyncRun, VirtualRun, view_of
from framekit.extras.web.access import Access
from framekit.extras.web.board import WebBoard, WebSession
from framekit.extras.web.shown import shown_run

TOKEN = "a-token-of-tests"

METER = """device: meter
protocol: modbus-tcp
station: 1
memory: {set: {"40002": [2, 5]}}
behave:
  "40001": {ramp: 0..1000, over: 1000 s}
"""

RUN = """run: plant
memory: masterlogic
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
points:
  level: {channel: 1, address: "40001", unit: mm, every: 1s}
  state: {channel: 1, address: "40002", enum: {0: off, 2: heating}, access: rw, every: 1s}
  limit: {channel: 1, address: "40003", access: rw, range: 0..10, every: 1s}
blocks:
  0: {read: "40001", channel: 1, count: 2, into: MW0, every: 1s}
  1: {read: "40001", channel: 1, name: by hand, into: MW10}
"""


def written(folder: Path, run: str = RUN, device: str = METER) -> Path:
    """Write the run to a folder."""
    (folder / "meter.device.yaml").write_text(device, "utf-8")
    path = folder / "plant.run.yaml"
    path.write_text(run, "utf-8")
    return path


class Page:
    """The page of a simulated run; the board has the time of the run."""

    def __init__(self, run: Path) -> None:
        log = FrameLog()
        self.run = VirtualRun(run, monitor=log.add)
        self.board = WebBoard(shown_run(self.run, view_of(self.run, log)), lambda: self.run.now / 1e9)
        self.run.start()

    def session(self) -> WebSession:
        return WebSession(self.board, Access(TOKEN), "test:1")


class Browser:
    """The state of a browser: points, tables, values and frames, updated by messages."""

    def __init__(self, hello: dict[str, Any]) -> None:
        self.points: list[str] = [point[0] for point in hello["points"]]
        self.tables: dict[str, dict[str, Any]] = {name: {} for name, _ in hello["tables"]}
        self.values: dict[str, list[Any]] = {}
        self.frames: list[list[str]] = []

    def take(self, messages: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
        taken = list(messages)
        for message in taken:
            if "table" in message:
                table = self.tables[message["table"]]
                if "keys" in message:
                    table = self.tables[message["table"]] = {key: table.get(key) for key in message["keys"]}
                table.update(message["rows"])
            elif "values" in message:
                self.values |= {self.points[int(at)]: cells for at, cells in message["values"].items()}
            elif "frames" in message:
                self.frames = ([] if message["anew"] else self.frames) + message["frames"]
        return taken


def async_run(path: Path, log: FrameLog) -> AsyncRun:
    return AsyncRun(path, monitor=log.add)
