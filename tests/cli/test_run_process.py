"""`framekit run` as a process of its own on real pseudo-terminals: signals, kill and restart, an unplugged adapter.

The device at the other end runs in the test. Tests wait for lines of the process, never for time.
"""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from spread import spread

from framekit.definition.times import LineFormat
from framekit.runfile.devices import load_devices
from framekit.service.device import DeviceService
from framekit.transport.clock import AsyncioClock
from framekit.transport.pty_port import PtyPair
from framekit.transport.serial_port import SerialPort

LONGEST = 180
"""Seconds after which a test is aborted."""

RUN = """run: wired
memory: masterlogic
{more}channels:
  1: {{port: {port}, protocol: modbus-rtu, speed: 115200, station: 1, params: {{reply_timeout: 300 ms, retries: 0}}}}
blocks:
  0: {{read: "40001", count: 3, into: M100, every: 20 ms}}
  1: {{write: "40010", values: [4711], when: block 0 done}}
"""
DEVICE = "device: bench\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: [100, 200, 300]}}\n"


class Wires:
    """Two connected pseudo-terminals with fixed names, which remain if the pair is unplugged and replaced."""

    def __init__(self, folder: Path) -> None:
        self.near, self.far = folder / "near", folder / "far"
        self.pair: PtyPair | None = None

    def put_in(self) -> None:
        self.pair = PtyPair()
        for name, path in ((self.near, self.pair.first), (self.far, self.pair.second)):
            name.unlink(missing_ok=True)
            name.symlink_to(path)

    def pull(self) -> None:
        for name in (self.near, self.far):
            name.unlink()
        if self.pair is not None:
            self.pair.close()
            self.pair = None


class Process:
    """A running `framekit run --json`."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.lines: list[dict[str, Any]] = []

    async def until(self, wanted: Callable[[dict[str, Any]], bool], times: int = 1) -> None:
        """Read lines until `times` lines have matched."""
        assert self.process.stdout is not None
        while times:
            text = await self.process.stdout.readline()
            assert text, f"it has ended, after {self.lines[-3:]}"
            self.lines.append(json.loads(text))
            times -= wanted(self.lines[-1])

    async def ended(self) -> int:
        """Read to the end; return the exit status."""
        assert self.process.stdout is not None
        while text := await self.process.stdout.readline():
            self.lines.append(json.loads(text))
        return await self.process.wait()

    def blocks(self) -> dict[int, dict[str, Any]]:
        """Return the final counters of the blocks; assert that they add up."""
        found = {line["block"]: line for line in self.lines if line["event"] == "block"}
        for block in found.values():
            assert block["started"] == block["done"] + block["failed"] + block["running"]
        return found


@asynccontextmanager
async def started(folder: Path, wires: Wires, more: str = "") -> AsyncIterator[Process]:
    path = folder / "wired.run.yaml"
    path.write_text(RUN.format(port=wires.near, more=more), encoding="utf-8")
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "framekit", "run", str(path), "--json", "--frames",
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        yield Process(process)
    finally:
        if process.returncode is None:
            process.kill()
        _, errors = await process.communicate()
        assert errors == b"", errors.decode()


def on_wires(folder: Path, test: Callable[[Wires, DeviceService], Coroutine[Any, Any, None]]) -> None:
    """Run a test with a device at the far end."""

    async def all_of_it() -> None:
        wires = Wires(folder)
        wires.put_in()
        (folder / "bench.device.yaml").write_text(DEVICE, encoding="utf-8")
        device = load_devices(folder / "bench.device.yaml", folder)[0]
        clock, line = AsyncioClock(asyncio.get_running_loop()), LineFormat(115200, parity="E")
        service = DeviceService(device, SerialPort(str(wires.far), line, clock), clock, line)
        service.start()
        try:
            async with asyncio.timeout(LONGEST):
                await test(wires, service)
        finally:
            service.stop()
            if wires.pair is not None:
                wires.pull()

    asyncio.run(all_of_it())


def reply(line: dict[str, Any]) -> bool:
    return line["event"] == "frame" and line["direction"] == "in"


def event(name: str) -> Callable[[dict[str, Any]], bool]:
    return lambda line: line["event"] == name


@pytest.mark.usefixtures("each_loop")
@pytest.mark.parametrize("number", spread([signal.SIGTERM, signal.SIGINT], 2))
def test_a_signal_ends_a_run_with_its_summary(tmp_path: Path, number: signal.Signals) -> None:
    async def test(wires: Wires, device: DeviceService) -> None:
        async with started(tmp_path, wires) as run:
            await run.until(reply, 20)
            run.process.send_signal(number)
            assert await run.ended() == 0
            blocks = run.blocks()
            replies = sum(reply(line) for line in run.lines)
            asked_twice = [line["reason"] for line in run.lines if line["event"] == "not_taken"]  # on a busy machine
            assert all(reason.startswith("late") for reason in asked_twice)
            late = len(asked_twice)
            assert blocks[0]["done"] + blocks[1]["done"] == replies - late and replies >= 20, run.lines[-12:]
            assert blocks[0]["failed"] == blocks[1]["failed"] == 0
            assert device.memory.read("holding", "word", 9) == [4711]
            (channel,) = [line for line in run.lines if line["event"] == "channel"]
            assert channel["line_measured"] > 0

    on_wires(tmp_path, test)


@pytest.mark.long
def test_a_run_that_is_killed_can_be_started_again(tmp_path: Path) -> None:
    async def test(wires: Wires, device: DeviceService) -> None:
        for _ in range(2):
            async with started(tmp_path, wires) as run:
                await run.until(reply, 5)
                run.process.kill()
                assert await run.process.wait() == -signal.SIGKILL
        async with started(tmp_path, wires) as run:
            await run.until(reply, 10)
            run.process.send_signal(signal.SIGTERM)
            assert await run.ended() == 0
            assert run.blocks()[0]["done"] >= 5
            assert run.blocks()[0]["failed"] <= 1, "what the killed one had asked may still be answered to the new one"

    on_wires(tmp_path, test)


@pytest.mark.long
def test_a_killed_run_goes_on_counting_from_what_it_had_kept(tmp_path: Path) -> None:
    """Exchanges of 600 ms are saved every 100 ms; counts that were not saved before the kill are lost."""
    kept = "state: {file: wired.state, every: 100 ms}\n"

    async def test(wires: Wires, device: DeviceService) -> None:
        async with started(tmp_path, wires, kept) as run:
            await run.until(reply, 60)
            run.process.kill()
            await run.ended()
            before = sum(reply(line) for line in run.lines)
        async with started(tmp_path, wires, kept) as run:
            await run.until(reply, 10)
            run.process.send_signal(signal.SIGTERM)
            assert await run.ended() == 0
            blocks = run.blocks()
            done, here = blocks[0]["done"] + blocks[1]["done"], sum(reply(line) for line in run.lines)
            assert here < done <= here + before + 1

    on_wires(tmp_path, test)


@pytest.mark.usefixtures("each_loop")
def test_a_run_goes_on_when_its_adapter_is_pulled_out_and_put_back(tmp_path: Path) -> None:
    async def test(wires: Wires, device: DeviceService) -> None:
        async with started(tmp_path, wires) as run:
            for _ in range(2):
                await run.until(reply, 10)
                wires.pull()
                await run.until(event("closed"))
                wires.put_in()
                await run.until(event("open"))
            await run.until(reply, 10)
            run.process.send_signal(signal.SIGTERM)
            assert await run.ended() == 0
            blocks = run.blocks()
            assert blocks[0]["failed"] + blocks[1]["failed"] <= 4, "what was under way, and what nobody heard"
            assert blocks[0]["done"] >= 8, "of 30 replies for two blocks; after a lost reply some only confirm others"
            assert blocks[0]["overruns"] > 0, "cycles that came due without a port count"

    on_wires(tmp_path, test)


@pytest.mark.long
def test_a_run_waits_for_a_port_that_is_not_there_yet(tmp_path: Path) -> None:
    async def test(wires: Wires, device: DeviceService) -> None:
        wires.pull()
        async with started(tmp_path, wires) as run:
            await run.until(event("closed"))
            wires.put_in()
            await run.until(event("open"))
            await run.until(reply, 3)
            run.process.send_signal(signal.SIGINT)
            assert await run.ended() == 0

    on_wires(tmp_path, test)
