"""512 idle blocks that watch bits while memory is written 1,000 times a second, compared with one block: CPU time.

Each block watches one bit. The writes go to unwatched words, like most writes of a program, and – a harder case – to
words in which blocks watch other bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measure import interleave
from benchmarks.row import Row, Target, slower
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

NAME = "512 idle blocks (8 sets × 64) watching bits, 1,000 memory writes a second"
TARGET = "≤ 1.2 × the same with 1 block"
WRITES = 2_000
EVERY = 1_000_000
WATCHED, ELSEWHERE = 1000, 20000
"""Words of area D: the first 512 from `WATCHED` on have a watched bit each."""
DEVICE = "{device: pump, protocol: modbus-rtu, station: 1}\n"


def service(blocks: int, folder: Path) -> tuple[RunService, VirtualClock]:
    """Return a run with this number of blocks, 64 per set, each waiting for a bit of its own word."""
    sets = []
    for number in range(0, blocks, 64):
        rows = [
            f'      {index}: {{read: "40001", into: D3000, when: D{WATCHED + number + index:05}.0}}'
            for index in range(min(64, blocks - number))
        ]
        sets.append(f"  {number // 64 + 1}:\n    blocks:\n" + "\n".join(rows))
    (folder / "pump.device.yaml").write_text(DEVICE, encoding="utf-8")
    file = folder / "idle.run.yaml"
    file.write_text(
        "run: idle\nmemory: masterlogic\nchannels:\n"
        '  1: {port: "sim:pump.device.yaml", protocol: modbus-rtu, station: 1}\nsets:\n' + "\n".join(sets) + "\n",
        encoding="utf-8",
    )
    clock = VirtualClock()
    run = RunService(load_run(file), clock)
    run.start()
    clock.run_for(1_000_000_000)
    return run, clock


def writes(run: RunService, clock: VirtualClock, word: int) -> Callable[[], float]:
    """Write every millisecond of simulated time to 512 words from `word` on in turn; return CPU seconds per write."""

    def measure() -> float:
        remaining = WRITES

        def write() -> None:
            nonlocal remaining
            remaining -= 1
            run.memory.write("D", "word", word + remaining % 512, [remaining << 1 & 0xFFFE])
            if remaining:
                clock.call_at(clock.now() + EVERY, write)

        begin = time.process_time()
        clock.call_at(clock.now() + EVERY, write)
        clock.run_for((WRITES + 1) * EVERY)
        used = time.process_time() - begin
        assert not remaining and not any(state.started for state in run.states.values())
        return used / WRITES

    return measure


def run(rounds: int) -> list[Row]:
    with TemporaryDirectory() as folder:
        many, one = service(512, Path(folder)), service(1, Path(folder))
    rows = []
    for what, word in (("words that nobody watches", ELSEWHERE), ("words with watched bits", WATCHED)):
        times = interleave({"512": writes(*many, word), "1": writes(*one, word)}, rounds)
        rows.append(slower(f"writes to {what}", "1 block", times["512"], times["1"], Target("at most", 1.2)))
    return rows
