"""Simulated durations of exchanges, compared with sums by hand and with the durations of the same run."""

from __future__ import annotations

from pathlib import Path

import pytest
from service.late_world import REGISTERS
from shipped import EXAMPLES, example_runs

from framekit.link.events import Seen
from framekit.runfile.run_file import load_run
from framekit.service.feasibility import Cost, loads_of, simulated_costs
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

MS = 1_000_000
SECOND = 1_000_000_000
EXCHANGES = ("read", "write", "send", "receive", "call")
"""Instructions that exchange frames by themselves; jobs only do so after they are established."""


def costs(folder: Path, channel: str, *blocks: str) -> dict[int, Cost]:
    path = folder / "r.run.yaml"
    lines = "".join(f"  {number}: {{{block}}}\n" for number, block in enumerate(blocks))
    path.write_text(f"run: r\nmemory: masterlogic\nchannels:\n  1: {{{channel}}}\nblocks:\n{lines}", encoding="utf-8")
    return {number: cost for (_, number), cost in simulated_costs(load_run(path)).items()}


RTU = "port: /dev/null, protocol: modbus-rtu, speed: 9600, station: 1"
CHARACTER = 11 / 9600 * SECOND  # 8E1


def test_a_read_takes_both_frames_and_the_silence_before_each(tmp_path: Path) -> None:
    found = costs(tmp_path, RTU, 'read: "40001", count: 10, into: M100, once: yes')[0]
    assert (found.bytes, found.frames, found.doubt) == (8 + 5 + 20, 2, "")
    assert found.duration == pytest.approx((33 + 2 * 3.5) * CHARACTER, rel=1e-4)


def test_a_split_read_counts_every_exchange(tmp_path: Path) -> None:
    found = costs(tmp_path, RTU, 'read: "40001", count: 300, into: M100, once: yes')[0]
    assert (found.bytes, found.frames) == (3 * (8 + 5) + 600, 6), "125 + 125 + 50 registers"


def test_pause_and_answer_time_are_counted(tmp_path: Path) -> None:
    block = 'write: "40001", values: [1], once: yes'
    plain = costs(tmp_path, RTU, block)[0]
    longer = costs(tmp_path, RTU + ", pause: 15 ms, answer: 20 ms", block)[0]
    assert longer.duration - plain.duration == 35 * MS
    assert longer.bytes == plain.bytes == 16


def test_measuring_logs_no_writes(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A run with `--log info` simulates its exchanges first: these write to no real device."""
    with caplog.at_level("INFO", "framekit"):
        found = costs(tmp_path, RTU, 'write: "40005", values: [0], once: yes')[0]
    assert found.frames == 2 and caplog.messages == []


def test_a_broadcast_has_no_answer(tmp_path: Path) -> None:
    found = costs(tmp_path, RTU, 'write: "40001", values: [1], station: 0, once: yes')[0]
    assert (found.bytes, found.frames, found.doubt) == (8, 1, "")
    assert found.duration > 100 * MS, "the definition waits 100 ms behind it"


def test_a_station_from_memory_is_one_that_may_be(tmp_path: Path) -> None:
    found = costs(tmp_path, RTU, 'read: "40001", station: M200, into: M100, once: yes')[0]
    assert (found.bytes, found.doubt) == (8 + 7, "")


def test_a_connection_has_only_the_answer_time(tmp_path: Path) -> None:
    channel = "port: tcp://h:502, protocol: modbus-tcp, station: 1, answer: 30 ms"
    found = costs(tmp_path, channel, 'read: "40001", into: M100, once: yes')[0]
    assert found.duration == 30 * MS


def test_a_reply_that_is_due_does_not_count_for_the_next_block(tmp_path: Path) -> None:
    """A frame that is the request of a service holds the line until its reply arrives; no reply is expected here."""
    (tmp_path / "registers.yaml").write_text(REGISTERS, encoding="utf-8")
    channel = "port: /dev/null, protocol: registers, speed: 19200, station: 1"
    send = "send: read, values: {station: 1, address: 1, count: 1}, every: 300 ms"
    found = costs(tmp_path, channel, send, "read: R1, into: M100, every: 1 s")
    assert found[0].duration == pytest.approx(8 * 10 / 19200 * SECOND, rel=1e-4)
    assert found[1].duration == pytest.approx((8 + 8) * 10 / 19200 * SECOND, rel=0.2)


def test_user_frames_count_their_bytes() -> None:
    found = {
        number: cost for (_, number), cost in simulated_costs(load_run(EXAMPLES / "third-party-plc.run.yaml")).items()
    }
    assert [found[number].bytes for number in range(3)] == [1 + 4 + 44 + 3, 1 + 4 + 24 + 3, 6]
    assert found[0].duration == pytest.approx(52 * 10 / 9600 * SECOND, rel=1e-4)


def test_mldp_frames() -> None:
    found = {number: cost for (_, number), cost in simulated_costs(load_run(EXAMPLES / "mldp-flags.run.yaml")).items()}
    request = 1 + 2 + 1 + 2 + 2 + 4 * (2 + 6) + 1 + 2
    reply = 1 + 2 + 1 + 2 + 2 + 4 * (2 + 4) + 1 + 2
    assert found[0].bytes == request + reply


def test_a_protocol_with_acknowledgements_counts_them_all(tmp_path: Path) -> None:
    """CCM master, GFK-0582: enquiry 3, answer 3, header 17, ACK, block of 8 bytes with STX, ETX, LRC, ACK, EOT, EOT."""
    channel = "port: /dev/null, protocol: ccm, own: 1, station: 5"
    found = costs(tmp_path, channel, "read: R1, count: 4, into: M100, once: yes")[0]
    assert (found.bytes, found.frames, found.doubt) == (3 + 3 + 17 + 1 + 11 + 1 + 1 + 1, 8, "")


def test_an_answer_that_comes_too_late_is_told(tmp_path: Path) -> None:
    channel = "port: /dev/null, protocol: modbus-rtu, station: 1, answer: 5 s, params: {retries: 0}"
    found = costs(tmp_path, channel, 'read: "40001", into: M100, once: yes')[0]
    assert found.doubt == "only its request is counted: no_reply"
    assert found.bytes == 8


@pytest.mark.parametrize("path", example_runs(), ids=lambda path: path.stem)
def test_every_block_of_the_examples_can_be_simulated(path: Path) -> None:
    run = load_run(path)
    found = simulated_costs(run)
    blocks = {(block.set, block.number): block for block in run.blocks}
    assert set(found) == {key for key, block in blocks.items() if block.instruction in EXCHANGES}
    for key, cost in found.items():
        has_speed = run.channels[blocks[key].channel].line is not None
        assert cost.doubt == ""
        assert cost.bytes > 0 and cost.frames > 0 and (cost.duration > 0) == has_speed


FULL = """run: full
memory: masterlogic
channels:
  1: {port: "sim:there.device.yaml", protocol: modbus-rtu, speed: 9600, station: 1}
blocks:
  0: {read: "40001", count: 20, into: M100, every: 50 ms}
  1: {read: "40001", into: M200, every: 200 ms}
  2: {write: "40001", values: [1], when: block 1 done}
  3: {read: "40001", count: 300, into: M300, when: F00094}
"""


def test_the_run_does_what_was_foreseen(tmp_path: Path) -> None:
    """Starts, missed cycles and transmitted bytes of an overloaded run, over 100 s."""
    (tmp_path / "there.device.yaml").write_text("device: there\nprotocol: modbus-rtu\nstation: 1\n", encoding="utf-8")
    path = tmp_path / "full.run.yaml"
    path.write_text(FULL, encoding="utf-8")
    run = load_run(path)
    (load,) = loads_of(run)
    assert load.busy > 1
    seen = 0

    def count(channel: int, event: Seen) -> None:
        nonlocal seen
        seen += len(event.raw)

    clock = VirtualClock()
    service = RunService(run, clock, count)
    service.start()
    clock.run_for(100 * SECOND)
    line = 0.0
    for one in load.blocks:
        counters = service.states[one.block.number]
        assert 100 * SECOND / counters.started == pytest.approx(one.reached, rel=0.025)
        assert counters.overruns / (counters.started + counters.overruns) == pytest.approx(one.missed, abs=0.01)
        line += one.cost.bytes * CHARACTER / one.reached
    assert seen * CHARACTER / (100 * SECOND) == pytest.approx(line, rel=0.02)
