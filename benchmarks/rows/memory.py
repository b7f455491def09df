"""64 channels with 512 blocks for hours of simulated time: memory must not grow after the first hour.

`make bench` simulates 4 hours; `python -m benchmarks.rows.memory --hours 24` simulates any number.
"""

from __future__ import annotations

import argparse
import gc
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.row import Row, Target, as_table
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

NAME = "Memory: 64 channels, 512 blocks, hours of simulated time"
TARGET = "no growth after the first hour"
HOUR = 3_600_000_000_000
CHANNELS, SETS = 64, 8
BEGUN = 1_000
"""Start of counters: Python caches numbers up to 256, so counters that pass it would look like growth."""
DEVICE = "{device: pump, protocol: modbus-rtu, station: 1}\n"


def service(folder: Path, clock: VirtualClock) -> RunService:
    """Return a run whose channels have a device each and a block of every set, which reads every few minutes."""
    (folder / "pump.device.yaml").write_text(DEVICE, encoding="utf-8")
    channels = "\n".join(
        f'  {number}: {{port: "sim:pump.device.yaml", protocol: modbus-rtu, speed: 115200, station: 1}}'
        for number in range(1, CHANNELS + 1)
    )
    sets = []
    for number in range(SETS):
        blocks = "\n".join(
            f'      {index}: {{read: "40001", count: 10, channel: {index + 1}, every: {120 + 30 * number} s, '
            f"into: D{10 * (CHANNELS * number + index):05}}}"
            for index in range(CHANNELS)
        )
        sets.append(f"  {number + 1}:\n    blocks:\n{blocks}")
    file = folder / "day.run.yaml"
    file.write_text(
        f"run: day\nmemory: masterlogic\nchannels:\n{channels}\nsets:\n" + "\n".join(sets) + "\n", encoding="utf-8"
    )
    return RunService(load_run(file), clock)


def simulate(hours: int) -> Row:
    """Return the allocated blocks of the interpreter at the end, compared with those after the first hour."""
    clock = VirtualClock()
    with TemporaryDirectory() as folder:
        run = service(Path(folder), clock)
    run.start()
    for state in run.states.values():
        state.started = state.done = BEGUN
    held, resident = [], []
    for _ in range(hours):
        clock.run_for(HOUR)
        gc.collect()
        held.append(sys.getallocatedblocks())
        resident.append(_resident())
    done = sum(state.done - BEGUN for state in run.states.values())
    assert not any(state.failed for state in run.states.values())
    run.stop()
    details = {
        "exchanges": done,
        "allocated blocks": f"{held[0]} → {held[-1]}",
        "resident MB": f"{resident[0]:.1f} → {resident[-1]:.1f}",
    }
    growth = held[-1] / held[0]
    return Row(f"after {hours} h", "after 1 h", growth, growth, growth, Target("at most", 1.001), details=details)


def _resident() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 1e6


def run(rounds: int) -> list[Row]:
    """Measure once; `rounds` is ignored, since simulated time is always the same."""
    return [simulate(4)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=NAME)
    parser.add_argument("--hours", type=int, default=24)
    print(as_table([simulate(parser.parse_args().hours)]))
