"""Latency from a set bit to the first byte at the port with 64 armed blocks: 99th percentile, against bare asyncio.

Bare asyncio is a `call_soon` callback that writes the bytes. Both write into the same kind of port, which records the
time and sends no bytes, since a system call would only hide the difference.
"""

from __future__ import annotations

import asyncio
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measure import interleave, quartiles
from benchmarks.row import Row, Target
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import AsyncioClock
from framekit.transport.port import Port, PortEvents

NAME = "Trigger bit set → first byte handed to the port, 64 blocks armed"
TARGET = "p99 ≤ 100 µs"
SAMPLES = 1000
ROUNDS = 25
"""Least number of rounds: the 99th percentile of 1000 samples is the tenth slowest, which any disturbance changes."""

BLOCKS = 64


class NotingPort(Port):
    """Record the time of a write, and report it as transmitted at once."""

    name, settings = "noting", None

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.written_at = 0
        self.written = asyncio.Event()
        self.events: PortEvents | None = None

    def open(self, events: PortEvents) -> None:
        self.events = events
        self.loop.call_soon(lambda: events.opened(time.monotonic_ns()))

    def write(self, data: bytes) -> None:
        self.written_at = time.perf_counter_ns()
        self.written.set()
        if self.events is not None:
            events = self.events
            self.loop.call_soon(lambda: events.sent(time.monotonic_ns()))

    def write_through(self, data: bytes) -> bool:
        """Report all bytes as transmitted, like a port whose operating system accepts them at once."""
        self.written_at = time.perf_counter_ns()
        self.written.set()
        return True

    def close(self) -> None:
        self.events = None

    def send_break(self, duration: int) -> None:
        """Do nothing; no line exists."""


async def p99(port: NotingPort, prepare: Callable[[int], None], trigger: Callable[[int], None]) -> float:
    """Return the seconds from the call of `trigger` to the write; `prepare` is called before it."""
    found = []
    for sample in range(SAMPLES):
        port.written.clear()
        prepare(sample)
        await asyncio.sleep(0)
        begin = time.perf_counter_ns()
        trigger(sample)
        await port.written.wait()
        found.append((port.written_at - begin) / 1e9)
        await asyncio.sleep(0.002)  # the block is done, and its channel free again
    return statistics.quantiles(found, n=100)[98]


def armed(loop: asyncio.AbstractEventLoop) -> tuple[RunService, NotingPort]:
    """Return a run with 64 blocks, each waiting for a bit of its own, on a port that records."""
    blocks = "\n".join(
        f"  {number}: {{send: WR.REQ, channel: 1, when: D{number:05}.0, data: {{payload: M0}}}}"
        for number in range(BLOCKS)
    )
    with TemporaryDirectory() as folder:
        file = Path(folder) / "armed.run.yaml"
        file.write_text(
            "run: armed\nmemory: masterlogic\nchannels:\n"
            "  1: {port: /dev/null, protocol: third-party-plc}\nblocks:\n" + blocks + "\n",
            encoding="utf-8",
        )
        service = RunService(load_run(file), AsyncioClock(loop))
    port = NotingPort(loop)
    service.channels[1].driver.port = port
    return service, port


def run(rounds: int) -> list[Row]:
    loop = asyncio.new_event_loop()
    return loop.run_until_complete(_measure(loop, rounds))


async def _measure(loop: asyncio.AbstractEventLoop, rounds: int) -> list[Row]:
    service, port = armed(loop)
    service.start()
    await asyncio.sleep(0.05)
    data = bytes.fromhex("00 01 00 00 00 06 01 03 00 00 00 0A")
    bare = NotingPort(loop)

    def clear_bit(sample: int) -> None:
        service.memory.write("D", "word", sample % BLOCKS, [0])

    def set_bit(sample: int) -> None:
        service.memory.write("D", "word", sample % BLOCKS, [1])

    def nothing(sample: int) -> None:
        """Do nothing; bare asyncio has no bit."""

    def call_soon(sample: int) -> None:
        loop.call_soon(bare.write, data)

    def of(port: NotingPort, *functions: Callable[[int], None]) -> Callable[[], float]:
        return lambda: asyncio.run_coroutine_threadsafe(p99(port, *functions), loop).result()

    rounds = max(rounds, ROUNDS)
    functions = {"framekit": of(port, clear_bit, set_bit), "bare asyncio": of(bare, nothing, call_soon)}
    times = await asyncio.to_thread(interleave, functions, rounds)
    started = sum(state.started for state in service.states.values())
    assert started == rounds * SAMPLES, started
    service.stop()
    found = [1e6 * seconds for seconds in times["framekit"].rounds]
    bare = {"bare asyncio µs": round(1e6 * times["bare asyncio"].median, 3)}
    at_most = Target("at most", 100)
    return [Row("p99", "the clock", statistics.median(found), *quartiles(found), at_most, "µs", details=bare)]
