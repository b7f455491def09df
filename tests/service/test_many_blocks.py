"""64 blocks on eight channels in one run: all starts and values are computed, and the predicted load is compared."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

from framekit.link.events import Seen
from framekit.runfile.run_file import load_run
from framekit.service.feasibility import load_problems, loads_of
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
SECONDS = 6
BLOCKS = 8
"""Number of blocks of a channel."""


@dataclass(frozen=True)
class Line:
    """A channel: its settings, its device, and the address of element number `{}` of its device."""

    protocol: str
    settings: str
    device: str
    address: str
    where: tuple[str, int]


LINES = [
    Line("mldp", "speed: 38400, station: 2", "station: 2", "D{}", ("D", 0)),
    Line("modbus-rtu", "speed: 38400, station: 3", "station: 3", "4{:04}", ("holding", -1)),
    Line("modbus-ascii", "speed: 38400, station: 4", "station: 4", "4{:04}", ("holding", -1)),
    Line("modbus-tcp", "station: 5", "station: 5", "4{:04}", ("holding", -1)),
    Line("ccm", "speed: 19200, role: master, own: 1, station: 6", "station: 6", "R{}", ("R", -1)),
    Line("df1", "speed: 38400, role: full, station: 7", "station: 7, role: full", "N7:{}", ("file7", 0)),
    Line("ge-rtu", "speed: 38400, station: 8", "station: 8", "4{:04}", ("R", -1)),
    Line("mldp", "speed: 57600, station: 9", "station: 9", "M{:04}", ("M", 0)),
]


def write_run(folder: Path) -> Path:
    """Write a run whose even blocks read three words and whose odd blocks write two; cycles are 400 ms to 750 ms."""
    channels, blocks = [], []
    for number, line in enumerate(LINES, 1):
        name = f"d{number}.device.yaml"
        held = ", ".join(f'"{line.address.format(100 + 4 * n)}": [{number}, {n}, {number * n}]' for n in range(BLOCKS))
        device = "\n".join(line.device.split(", "))
        text = f"device: d{number}\nprotocol: {line.protocol}\n{device}\nmemory: {{set: {{{held}}}}}\n"
        (folder / name).write_text(text, encoding="utf-8")
        channels.append(f'  {number}: {{port: "sim:{name}", protocol: {line.protocol}, {line.settings}}}')
        for n in range(BLOCKS):
            block, period = BLOCKS * (number - 1) + n, 400 + 50 * n
            own = 1000 + 4 * block
            what = f'read: "{line.address.format(100 + 4 * n)}", count: 3, into: D{own:05}'
            if n % 2:
                what = f'write: "{line.address.format(200 + 4 * n)}", count: 2, from: M{block:04}'
            blocks.append(f"  {block}: {{{what}, channel: {number}, every: {period} ms}}")
    start = ", ".join(str(7 * number) for number in range(8 * BLOCKS + 1))
    path = folder / "many.run.yaml"
    path.write_text(
        "\n".join(["run: many", "memory: masterlogic", f"set: {{M0000: [{start}]}}", "channels:", *channels, "blocks:"])
        + "\n" + "\n".join(blocks) + "\n",
        encoding="utf-8",
    )  # fmt: skip
    return path


@pytest.mark.long
def test_sixty_four_blocks_on_eight_protocols(tmp_path: Path) -> None:
    run = load_run(write_run(tmp_path))
    assert len(run.blocks) == 64 and len(run.channels) == 8
    loads = {load.channel.number: load for load in loads_of(run)}
    assert load_problems(tuple(loads.values())) == []
    carried: Counter[int] = Counter()

    def count(channel: int, seen: Seen) -> None:
        assert seen.kind not in ("bad", "noise", "trouble", "not_taken"), seen
        carried[channel] += len(seen.raw)

    clock = VirtualClock()
    service = RunService(run, clock, count)
    service.start()
    clock.run_for(SECONDS * SECOND)
    for number, state in service.states.items():
        counters, n = state, number % BLOCKS
        due = SECONDS * 1000 // (400 + 50 * n)
        assert (counters.failed, counters.overruns) == (0, 0), str(state.last_failure)
        assert counters.started in (due - 1, due), "what comes due at the very end may still wait"
        assert counters.started == counters.done + counters.failed + counters.running
    for number, line in enumerate(LINES, 1):
        device = service.devices[number - 1].memory
        area, offset = line.where
        for n in range(BLOCKS):
            block = BLOCKS * (number - 1) + n
            if n % 2:
                written = device.read(area, "word", 200 + 4 * n + offset, 2)
                assert written == [7 * block, 7 * (block + 1)], (line.protocol, n)
            else:
                assert service.memory.read("D", "word", 1000 + 4 * block, 3) == [number, n, number * n], line.protocol
    for number, load in loads.items():
        ended = sum(block.cost.bytes * service.states[block.block.number].done for block in load.blocks)
        longest = max(block.cost.bytes for block in load.blocks)
        doubled = ended // 100  # escaped bytes of some frames, depending on their content
        assert ended - doubled <= carried[number] <= ended + doubled + longest, "the line carries what was foreseen"
