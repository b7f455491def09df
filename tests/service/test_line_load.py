"""The load of a line, computed from the bytes that a driver counts."""

from __future__ import annotations

from pathlib import Path

from framekit.definition.times import parse_format
from framekit.link.events import Seen
from framekit.runfile.run_file import load_run
from framekit.service.driver import LineLoad
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
EXAMPLES = Path(__file__).parents[2] / "examples"


def test_share_of_the_time() -> None:
    load = LineLoad(parse_format("8N1", 9600), 0)
    assert load.share(0) == 0
    load.bytes_out = 48
    load.bytes_in = 48
    assert load.bytes == 96
    assert round(load.share(SECOND) or 0, 6) == 0.1
    assert round(load.since_last(SECOND) or 0, 6) == 0.1
    assert load.since_last(2 * SECOND) == 0
    load.bytes_in += 480
    assert round(load.since_last(3 * SECOND) or 0, 6) == 0.5


def test_without_a_speed_there_is_no_load() -> None:
    load = LineLoad(None, 0)
    load.bytes_in = 1000
    assert load.share(SECOND) is None
    assert load.since_last(SECOND) is None


def test_a_run_counts_every_byte_of_its_lines() -> None:
    clock, sizes = VirtualClock(), {"in": 0, "out": 0}

    def watch(channel: int, seen: Seen) -> None:
        sizes[seen.direction] = sizes.get(seen.direction, 0) + len(seen.raw)

    service = RunService(load_run(EXAMPLES / "third-party-plc.run.yaml"), clock, watch)
    clock.run_for(5 * SECOND)  # loading before the start is not line time
    began = clock.now()
    service.start()
    clock.run_for(10 * SECOND)
    load = service.channels[1].driver.load
    assert (load.bytes_in, load.bytes_out) == (sizes["in"], sizes["out"])
    assert load.bytes_in > 200
    line = service.channels[1].channel.line
    assert line is not None
    assert clock.now() - began == 10 * SECOND
    assert load.share(clock.now()) == load.bytes * line.character_time / (10 * SECOND)
