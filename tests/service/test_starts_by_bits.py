"""SEND blocks triggered by bits of the memory: their order, the content of their frames, and their counters."""

from __future__ import annotations

import gc
import shutil
from pathlib import Path
from weakref import ref

import pytest

from framekit.definition.times import NEVER
from framekit.run.model import RunModel
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock
from framekit.transport.port import Port, PortEvents

EXAMPLES = Path(__file__).parents[2] / "examples"
MS = 1_000_000
RUN = """
run: scales
memory: masterlogic
channels:
  1: {port: "sim:scale.device.yaml", protocol: scale}
blocks:
  0: {send: ASK, data: {station: M1}, when: M00500}
  1: {send: ASK, data: {station: M2}, when: F00091, priority: 5}
  2: {receive: WEIGHT, data: {net: "%MD50"}}
  3: {send: TARE, data: {station: M1}, when: block 2 done, repeat: 9}
  4: {receive: DONE}
"""


class Written(Port):
    """A port that records writes. `at_once`: it reports them as transmitted at once."""

    def __init__(self, inner: Port, clock: VirtualClock, at_once: bool) -> None:
        self.inner, self.clock, self.at_once = inner, clock, at_once
        self.name, self.settings = inner.name, inner.settings
        self.frames: list[tuple[int, bytes]] = []
        self.events: PortEvents | None = None

    def open(self, events: PortEvents) -> None:
        self.events = _SaysNothing(events) if self.at_once else events
        self.inner.open(self.events)

    def write(self, data: bytes) -> None:
        self.frames.append((self.clock.now(), data))
        self.inner.write(data)

    def write_through(self, data: bytes) -> bool:
        self.write(data)
        return self.at_once

    def lose(self) -> None:
        """Lose the line."""
        self.inner.close()
        assert self.events is not None
        self.events.closed(self.clock.now(), "pulled out")

    def close(self) -> None:
        self.inner.close()

    def send_break(self, duration: int) -> None:
        self.inner.send_break(duration)


class _SaysNothing:
    """The events of a port, except `sent`."""

    def __init__(self, events: PortEvents) -> None:
        self.opened, self.received, self.closed = events.opened, events.received, events.closed
        self.line_break, self.control = events.line_break, events.control

    def sent(self, now: int) -> None:
        """Ignore the event; the write has already reported it."""


class Bench:
    """A run with scales, and the frames written on its first channel."""

    def __init__(self, folder: Path, *, at_once: bool = False, run: str = RUN) -> None:
        for name in ("scale.yaml", "scale.device.yaml"):
            shutil.copy(EXAMPLES / name, folder / name)
        self.path = folder / "r.run.yaml"
        self.clock = VirtualClock()
        self.at_once = at_once
        self.service = RunService(self.loaded(run), self.clock)
        self.tap()
        self.memory = self.service.memory
        self.memory.write("M", "word", 1, [1, 2])
        self.service.start()
        self.clock.run_for(MS)

    def loaded(self, run: str) -> RunModel:
        self.path.write_text(run, encoding="utf-8")
        return load_run(self.path)

    def tap(self) -> None:
        driver = self.service.channels[1].driver
        driver.port = self.port = Written(driver.port, self.clock, self.at_once)

    def trigger(self) -> None:
        self.memory.write("M", "word", 50, [0])
        self.memory.write("M", "word", 50, [1])

    def counts(self, number: int) -> tuple[int, int, int]:
        counters = self.service.states[number]
        assert counters.started == counters.done + counters.failed + counters.running
        return counters.started, counters.done, counters.failed


WAYS = pytest.mark.parametrize("at_once", [True, False], ids=["at once", "later"])


# ---- whose turn it is -------------------------------------------------------------------------------------------


def test_a_block_does_not_go_before_one_that_is_due_by_a_bit_of_the_memory(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.clock.call_at(100 * MS, bench.trigger)
    bench.clock.run_for(200 * MS)
    assert [frame[1:4] for _, frame in bench.port.frames][:2] == [b"W02", b"W01"], "F00091 rises then: priority 5"
    assert bench.port.frames[0][0] == 100 * MS


def test_a_frame_with_a_pulse_in_it_shows_it_as_it_is_then(tmp_path: Path) -> None:
    run = RUN.replace("F00091", "M00900").replace("data: {station: M1}, when: M", "data: {station: L637}, when: M")
    bench = Bench(tmp_path, run=run)
    seen: list[int] = []

    def changed(*_: object) -> None:
        seen.append(bench.memory.read("L", "word", 637)[0])
        if seen[-1] == 1:
            bench.clock.call_at(bench.clock.now() + 10 * MS, bench.trigger)

    bench.memory.watch("L", 637, 1, changed)
    bench.memory.write("M", "word", 2, [1])
    bench.service.fire(1)
    bench.clock.run_for(500 * MS)
    assert seen == [1, 0], "the weight has come, and a scan later the pulse of block 2 is over"
    assert bench.port.frames[-1][1][1:4] == b"W00"


# ---- an edited run ----------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("small_heap")
@WAYS
def test_a_channel_that_has_been_replaced_is_forgotten_and_its_blocks_start_on_the_new_one(
    tmp_path: Path, at_once: bool
) -> None:
    run = RUN.replace("F00091", "M00900")
    bench = Bench(tmp_path, at_once=at_once, run=run)
    service = bench.service
    bench.trigger()
    bench.clock.run_for(500 * MS)
    old, before = ref(service.channels[1]), bench.counts(0)
    assert before[1] == 1
    service.on_channel = lambda number, channel: bench.tap()
    service.edit(bench.loaded(run.replace("protocol: scale}", "protocol: scale, speed: 4800}")))
    bench.clock.run_for(500 * MS)
    bench.trigger()
    bench.clock.run_for(0)
    assert [frame[1:4] for _, frame in bench.port.frames if frame[1:2] == b"W"][-1] == b"W01"
    bench.clock.run_for(500 * MS)
    assert bench.counts(0) == (2, 2, 0)
    gc.collect()
    assert old() is None


# ---- counters ---------------------------------------------------------------------------------------------------


@WAYS
def test_a_port_that_is_lost_while_a_frame_leaves(tmp_path: Path, at_once: bool) -> None:
    bench = Bench(tmp_path, at_once=at_once, run=RUN.replace("F00091", "M00900"))
    for number in range(1, 4):
        bench.trigger()
        bench.clock.run_for(MS)
        assert len(bench.port.frames) == number
        bench.port.lose()
        bench.clock.run_for(0)
        assert bench.counts(0) == ((number, number, 0) if at_once else (number, 0, number))
        bench.trigger()
        bench.clock.run_for(0)
        assert bench.counts(0)[0] == number, "it waits for the port"
        bench.memory.write("M", "word", 50, [0])
        bench.service.enable(0, False)
        bench.service.enable(0)
        bench.clock.run_for(5000 * MS)


# ---- pulses that end at the very moment ---------------------------------------------------------------------------


@pytest.mark.parametrize("looked_at", [False, True], ids=["nothing looks at it", "a block waits for it"])
def test_the_end_of_a_pulse_goes_first(tmp_path: Path, looked_at: bool) -> None:
    """Words that no trigger watches are computed when they are read, so they are right at any time."""
    run = RUN.replace("F00091", "M00900")
    bench = Bench(tmp_path, at_once=True, run=run.replace("M00900", "L006550") if looked_at else run)
    bench.trigger()
    bench.clock.run_for(MS)
    last_end = bench.service.states[0].last_end
    assert last_end is not None
    end = last_end + bench.service.run.memory.scan
    assert bench.service.block_memory.words.deadline == (end if looked_at else NEVER)
    assert bench.memory.read("L", "word", 625) == [1], "it has ended well"
    bench.clock.run_until(end - 1)
    seen: list[list[int]] = []
    write = bench.port.write
    bench.port.write = lambda data: (seen.append(bench.memory.read("L", "word", 625)), write(data))[1]  # type: ignore[method-assign]
    bench.clock._now = end  # the time is reached, but no timer has been called yet
    bench.trigger()
    bench.clock.run_until(end)
    assert seen == [[0]]
    assert bench.counts(0) == (2, 2, 0)
    assert bench.memory.read("L", "word", 625) == [1], "the second end"
    bench.clock.run_for(20 * MS)
    assert bench.memory.read("L", "word", 625) == [0], "pulses end all the same"
