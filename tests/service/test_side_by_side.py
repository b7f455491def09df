"""Every shipped link procedure in one run, each on a channel of its own, on one virtual clock."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

RUN = Path(__file__).parents[2] / "examples" / "side-by-side" / "side-by-side.run.yaml"
SECONDS = 6


@pytest.mark.long
def test_all_link_procedures_side_by_side() -> None:
    clock = VirtualClock()
    service = RunService(load_run(RUN), clock)
    service.start()
    clock.run_for(SECONDS * 1_000_000_000)
    for state in service.states.values():
        counters = state
        assert counters.failed == 0, f"block {state.block.number}: {state.last_failure}"
        assert counters.overruns == 0
        rounds = SECONDS * (5 if state.block.channel < 5 else 1)
        assert counters.done in (rounds - 1, rounds)
        assert counters.started == counters.done + counters.failed + counters.running
    for channel, base in enumerate(range(100, 140, 10)):
        assert service.memory.read("M", "word", base, 4) == [channel + 2, 20, 30, 40]
    for slave, base in enumerate(range(140, 170, 10)):
        assert service.memory.read("M", "word", base, 4) == [slave + 1, 20, 30, 40]
    for channel, base in ((6, 170), (7, 180)):
        assert service.memory.read("M", "word", base, 4) == [channel + 1, 20, 30, 40]
    written = {device.device.name: device for device in service.devices}
    for name, area, start in [
        ("mldp", "D", 200),
        ("modbus", "holding", 10),
        ("ccm", "R", 10),
        ("snp", "R", 10),
        ("snp-x", "R", 10),
        ("df1", "file7", 10),
    ]:
        assert written[name].memory.read(area, "word", start, 4) == [1, 2, 3, 4], name
    assert written["slave2"].memory.read("file7", "word", 10, 4) == [1, 2, 3, 4]
    service.stop()
