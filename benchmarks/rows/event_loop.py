"""The extra `fast`: processor time of runs, of a server and of a synchronous client in uvloop and in asyncio.

The runs are those of `points`. The server (`framekit.serve`) answers one client after each request; the figure is the
time of its thread. The synchronous client reads from a responder in another process; the figure is the time of both of
its threads.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import socket
import time
from collections.abc import Callable, Iterator

import framekit
from benchmarks.measure import interleave
from benchmarks.responder import responder
from benchmarks.row import Row, slower
from benchmarks.rows.points import SHAPES, measure, run_of_points
from framekit.api.event_loop import LOOP_VARIABLE, new_event_loop

NAME = "Event loop: uvloop against asyncio, CPU a reading, a served request, a synchronous read"
TARGET = "no target"
REQUESTS = 2000
"""Requests in a round."""
ASKS = bytes.fromhex("00010000000601030000000a")
REPLY_SIZE = 29


@contextlib.contextmanager
def loop_of(library: str) -> Iterator[None]:
    """Choose the event loop."""
    before = os.environ.get(LOOP_VARIABLE)
    os.environ[LOOP_VARIABLE] = library
    try:
        yield
    finally:
        del os.environ[LOOP_VARIABLE]
        if before is not None:
            os.environ[LOOP_VARIABLE] = before


def served() -> float:
    """Return the processor time of the server's thread for a request (seconds)."""
    with framekit.serve("modbus-tcp", "tcp://127.0.0.1:0") as server:
        host, _, number = server.port.partition("://")[2].rpartition(":")
        begin = server._thread.do(time.thread_time)
        with socket.create_connection((host, int(number))) as client:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for _ in range(REQUESTS):
                client.sendall(ASKS)
                assert len(client.recv(REPLY_SIZE, socket.MSG_WAITALL)) == REPLY_SIZE
        return (server._thread.do(time.thread_time) - begin) / REQUESTS


def read_by(port: int) -> float:
    """Return the processor time of a read of the synchronous client (seconds)."""
    with framekit.connect("modbus-tcp", f"tcp://127.0.0.1:{port}", station=1) as client:
        client.read("40001", count=10)
        begin = time.process_time()
        for _ in range(REQUESTS):
            client.read("40001", count=10)
        return (time.process_time() - begin) / REQUESTS


def run(rounds: int) -> list[Row]:
    if importlib.util.find_spec("uvloop") is None:
        return []
    rows = []
    with responder("counting") as port:
        works: dict[str, Callable[[], float]] = {
            f"run: {what}": (lambda shape=shape: measure(run_of_points, port, shape, new_event_loop))
            for what, shape in SHAPES.items()
        }
        works |= {"server: a request": served, "synchronous client: a read": lambda: read_by(port)}
        for what, work in works.items():
            found = interleave({library: in_loop(library, work) for library in ("uvloop", "asyncio")}, rounds)
            rows.append(slower(what, "asyncio", found["uvloop"], found["asyncio"], None))
    return rows


def in_loop(library: str, work: Callable[[], float]) -> Callable[[], float]:
    """Return a function that does the work in the event loop of a library."""

    def done() -> float:
        with loop_of(library):
            return work()

    return done
