"""Runs of the API: on the virtual clock, in real time from threads, and for asyncio."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from api_world import device_file

import framekit
from framekit.transport.pty_port import PtyPair

RUN = """
run: plant
memory: masterlogic
channels:
  1: {{port: "{port}", protocol: modbus-rtu, params: {{reply_timeout: {timeout}, retries: 0}}}}
blocks:
  0: {{read: "40001", count: 3, station: 7, into: M0100, when: M00000}}
  1: {{write: "40011", station: 7, from: M0200, on_change: M0200}}
  2: {{read: "40001", station: 9, into: M0300, when: M00001}}
  3: {{read: "40001", station: 7, into: M0400, every: 1 s}}
"""


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    device_file(tmp_path)
    path = tmp_path / "plant.run.yaml"
    path.write_text(RUN.format(port="sim:bench.device.yaml", timeout="100 ms"), encoding="utf-8")
    return path


# ---- virtual time -----------------------------------------------------------------------------------------------


def test_ten_minutes_on_the_virtual_clock(plant: Path) -> None:
    with framekit.VirtualRun(plant) as run:
        run.run_for("10 min")
        status = run.block(3)
        assert (status.started, status.done, status.failed, status.running) == (600, 599, 0, True)
        assert [status.started for status in run.blocks] == [0, 0, 0, 600]
        assert run.now == 600_000_000_000
        assert run.memory["M0400"] == 100
        run.device("bench")["40001"] = 77
        run.run_for(1.5)
        assert run.memory["M0400"] == 77


def test_a_watch_tells_what_has_changed(plant: Path) -> None:
    run = framekit.VirtualRun(plant)
    assert run.memory.read("M0100", 3) == [0, 0, 0], "also before the start"
    heard: list[list[object]] = []
    bit: list[list[object]] = []
    watch = run.memory.watch("M0100", heard.append, 3)
    run.memory.watch("M00021", bit.append)
    run.memory.watch("M0100", lambda values: heard.append(["real", *values]), type="float32")
    with run:
        run.fire(0)
        run.run_for("50 ms")
        assert heard == [[100, 200, 300], ["real", pytest.approx(1.8367e-38, rel=1e-4)]]
        run.memory["M0101"] = 7
        run.memory["M0101"] = 200
        run.run_for("1 ms")
        assert len(heard) == 2, "changed back before it was told"
        run.memory["M0102"] = 1
        run.memory["M0102"] = 2
        run.memory["M00020"] = 1
        run.run_for("1 ms")
        assert heard[2:] == [[100, 200, 2]] and bit == [], "the last of several; other bits of the word say nothing"
        run.memory["M00021"] = 1
        watch.cancel()
        watch.cancel()
        run.memory["M0102"] = 3
        run.run_for("1 ms")
        assert len(heard) == 3 and bit == [[1]]
    with pytest.raises(framekit.RequestError, match="'Q1' is not an address"):
        run.memory.watch("Q1", heard.append)


def test_a_watch_that_was_cancelled_before_it_told_says_nothing(plant: Path) -> None:
    with framekit.VirtualRun(plant) as run:
        heard: list[list[object]] = []
        watch = run.memory.watch("M0100", heard.append)
        run.memory["M0100"] = 1
        watch.cancel()
        run.run_for("1 ms")
        assert heard == []


def test_memory_starts_blocks(plant: Path) -> None:
    run = framekit.VirtualRun(plant)
    run.memory["M0200"] = 5
    with run:
        run.run_for("100 ms")
        run.memory["M0200"] = 6
        run.memory["M00000"] = 1
        run.run_for("500 ms")
        assert run.device("bench")["40011"] == 6
        assert run.memory.read("M0100", 3) == [100, 200, 300]
    assert not run.running and run.block(0).done == 1


def test_blocks_by_hand(plant: Path) -> None:
    with framekit.VirtualRun(plant) as run:
        assert run.carry_out(0).done == 1
        assert run.memory.read("M0100", 3) == [100, 200, 300]
        status = run.carry_out(2)
        assert (status.failed, status.reason) == (1, framekit.ErrorCode.NO_REPLY)
        assert status.last_failure is not None and status.last_failure.outcome == "no_reply"
        with pytest.raises(TimeoutError, match="block 2 has not ended within 10 ms"):
            run.carry_out(2, within="10 ms")
        run.run_for("1 s")
        run.disable(0)
        assert not run.block(0).enabled
        run.fire(0)
        run.run_for("1 s")
        assert run.block(0).started == 1
        with pytest.raises(framekit.RequestError, match="block 0 is switched off"):
            run.carry_out(0)
        run.enable(0)
        assert run.carry_out(0).done == 2


def test_callbacks_and_what_they_raise(plant: Path) -> None:
    ends: list[tuple[int, bool]] = []
    frames: list[tuple[int, str, str]] = []
    with framekit.VirtualRun(
        plant,
        on_end=lambda status, ok: ends.append((status.block, ok)),
        on_seen=lambda channel, seen: frames.append((channel, seen.direction, seen.frame)),
    ) as run:
        run.fire(0)
        run.fire(2)
        run.run_for("500 ms")
    assert ends == [(0, True), (2, False)]
    assert [frame for frame in frames if frame[2]] == [
        (1, "out", "request_adu"), (1, "in", "reply_adu"), (1, "out", "request_adu"),
    ]  # fmt: skip

    def refuse(status: framekit.BlockStatus, ok: bool) -> None:
        raise AssertionError(f"block {status.block}")

    with framekit.VirtualRun(plant, on_end=refuse) as run, pytest.raises(AssertionError, match="block 3"):
        run.run_for("2 s")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda run: run.fire(9), "there is no block 9 – known: 0, 1, 2, 3"),
        (lambda run: run.block(64), "there is no block 64"),
        (lambda run: run.enable(-1), "there is no block -1"),
        (lambda run: run.device("pump"), "no simulated device 'pump' – known: bench"),
        (lambda run: run.memory["XYZ"], "is not an address"),
        (lambda run: run.run_for("soon"), "is not a time"),
        (lambda run: run.run_for(-1), "not less than 0"),
    ],
)
def test_what_cannot_be_asked(stopped: framekit.VirtualRun, call: object, message: str) -> None:
    with pytest.raises(framekit.RequestError, match=message):
        call(stopped)  # type: ignore[operator]


def test_a_block_that_receives_is_not_fired(tmp_path: Path) -> None:
    device_file(tmp_path)
    path = tmp_path / "plant.run.yaml"
    text = RUN.format(port="sim:bench.device.yaml", timeout="100 ms") + "  4: {receive: reply_adu}\n"
    path.write_text(text, encoding="utf-8")
    with framekit.VirtualRun(path) as run:
        for call in (run.fire, run.carry_out):
            with pytest.raises(framekit.RequestError, match="block 4 receives: nothing but its frame makes it due"):
                call(4)
        assert run.carry_out(0).done == 1, "its channel is free"


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> framekit.VirtualRun:
    folder = tmp_path_factory.mktemp("stopped")
    device_file(folder)
    (folder / "plant.run.yaml").write_text(RUN.format(port="sim:bench.device.yaml", timeout="100 ms"), encoding="utf-8")
    return framekit.VirtualRun(folder / "plant.run.yaml")


def test_wrong_files_and_ports(tmp_path: Path, plant: Path) -> None:
    with pytest.raises(framekit.DefinitionError, match=r"none\.run\.yaml"):
        framekit.VirtualRun(tmp_path / "none.run.yaml")
    plant.write_text(RUN.format(port="/dev/ttyS0", timeout="1 s"), encoding="utf-8")
    with pytest.raises(framekit.RequestError, match="is a real port and needs real time"):
        framekit.VirtualRun(plant)
    plant.write_text(RUN.format(port="what://x", timeout="1 s"), encoding="utf-8")
    with pytest.raises(ValueError, match="is no port"):
        framekit.Run(plant)


def test_a_state_is_kept_and_let_go_of(plant: Path) -> None:
    plant.write_text(plant.read_text("utf-8") + "state: plant.state\n", encoding="utf-8")
    with framekit.VirtualRun(plant) as run:
        run.carry_out(0)
        with pytest.raises(framekit.DefinitionError, match="is in use"):
            framekit.VirtualRun(plant)
        assert run.problems == []
    again = framekit.VirtualRun(plant)
    assert again.block(0).done == 1
    again.stop()
    with pytest.raises(framekit.RequestError, match="a run is started once"):
        again.start()
    framekit.VirtualRun(plant).stop()


# ---- real time --------------------------------------------------------------------------------------------------


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[tuple[Path, framekit.Server]]:
    """Yield the path of a run on a pseudo-terminal, and the device at its other end."""
    with PtyPair() as pair, framekit.serve(device_file(tmp_path), pair.first) as device:
        path = tmp_path / "plant.run.yaml"
        path.write_text(RUN.format(port=pair.second, timeout="2 s"), encoding="utf-8")
        yield path, device


def test_a_run_in_its_thread(terminal: tuple[Path, framekit.Server]) -> None:
    path, device = terminal
    ends: list[tuple[int, bool]] = []
    run = framekit.Run(path, on_end=lambda status, ok: ends.append((status.block, ok)))
    with pytest.raises(framekit.RequestError, match="has not been started"):
        run.carry_out(0)
    with run:
        run.disable(3)
        assert run.carry_out(0, timeout=180).done == 1
        assert run.memory.read("M0100", 3) == [100, 200, 300]
        with ThreadPoolExecutor(4) as pool:
            waiting = pool.submit(run.next_end, 1, timeout=180)
            for value in iter(range(1, 1_000_000)):
                run.memory["M0200"] = value % 0x10000
                if waiting.done():
                    break
        assert waiting.result().done == 1
        assert run.carry_out(2, timeout=180).failed == 1
        with pytest.raises(TimeoutError, match="block 3 has not ended within 0 s"):
            run.next_end(3, timeout=0)
    assert device.memory["40011"] != 0
    assert not run.running
    assert run.block(0).done == 1 and run.memory["M0100"] == 100, "what it had is still there"
    assert (0, True) in ends and (2, False) in ends
    run.stop()
    with pytest.raises(framekit.RequestError, match="started once"):
        run.start()
    with pytest.raises(framekit.RequestError, match="stopped"):
        run.next_end()


def test_what_is_called_at_intervals_is_called_on_the_loop_of_the_run(terminal: tuple[Path, framekit.Server]) -> None:
    called = threading.Event()
    threads: list[int | None] = []

    def call() -> None:
        threads.append(threading.get_ident())
        called.set()

    with framekit.Run(terminal[0]) as run:
        run.each(1_000_000, call)
        assert called.wait(180)
    assert threading.get_ident() not in threads


def test_callbacks_may_call_the_run(terminal: tuple[Path, framekit.Server]) -> None:
    """A callback may read, write and fire; it must not wait."""
    refused: list[RuntimeError] = []

    def on_end(status: framekit.BlockStatus, ok: bool) -> None:
        if status.block == 0 and status.done == 1:
            run.memory["M0101"] = run.memory["M0100"] + 1
            try:
                run.next_end()
            except RuntimeError as error:
                refused.append(error)
            run.fire(2)

    run = framekit.Run(terminal[0], on_end=on_end)
    with run:
        run.fire(0)
        assert run.next_end(2, timeout=180).failed == 1
        assert run.memory["M0101"] == 101
    assert [type(error) for error in refused] == [RuntimeError]


def test_asyncio(terminal: tuple[Path, framekit.Server]) -> None:
    async def scenario() -> None:
        async with framekit.AsyncRun(terminal[0]) as run:
            assert (await run.carry_out(0, timeout=180)).done == 1
            assert run.memory["M0102"] == 300
            ended = asyncio.create_task(run.next_end(1, timeout=180))
            await asyncio.sleep(0)
            run.memory["M0200"] = 9
            assert (await ended).done == 1
            assert terminal[1].memory["40011"] == 9
        assert not run.running

    asyncio.run(asyncio.wait_for(scenario(), 180))


def test_a_program_ends_without_stopping(plant: Path) -> None:
    script = f"""
import framekit
run = framekit.Run({str(plant)!r})
run.start()
print(run.carry_out(0, timeout=180).done)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=180, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "1\n", "")


def test_a_watch_of_a_run_in_a_thread(plant: Path) -> None:
    heard: list[list[object]] = []
    with framekit.Run(plant) as run:
        watch = run.memory.watch("M0100", heard.append, 3)
        assert run.carry_out(0, timeout=180).done == 1
        assert run.memory.read("M0100", 3) == [100, 200, 300], "a call into the thread, behind what was told there"
        assert heard == [[100, 200, 300]]
    run.memory["M0100"] = 5
    watch.cancel()
    assert heard == [[100, 200, 300]], "nothing is told when the run is over"
