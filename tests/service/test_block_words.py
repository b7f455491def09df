"""Words of blocks in whole runs: pulses start other blocks, refusals show their codes, settings redirect exchanges."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from framekit.api.run import run_status
from framekit.run.block_state import ErrorCode
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

EXAMPLES = Path(__file__).parents[2] / "examples"
SECOND = 1_000_000_000
ONE = "device: one\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: 11}}\n"
TWO = "device: two\nprotocol: modbus-rtu\nstation: 2\nmemory: {set: {40001: [22, 23, 24]}}\n"
RUN = """
run: words
memory: masterlogic
status: STATUS
dead: no
channels:
  1: {port: "sim:one.device.yaml,two.device.yaml", protocol: modbus-rtu, params: {reply_timeout: 50 ms, retries: 0}}
blocks:
  0: {read: "40001", station: 1, into: M100, every: 1 s}
  1: {read: "40001", station: 2, into: M101, when: L006250}
  2: {read: "40001", station: 9, into: M102, every: 2 s}
  3: {read: "40001", station: 1, into: M103, when: L006371}
"""


class Bench:
    def __init__(self, folder: Path, run: str) -> None:
        (folder / "one.device.yaml").write_text(ONE, encoding="utf-8")
        (folder / "two.device.yaml").write_text(TWO, encoding="utf-8")
        (folder / "r.run.yaml").write_text(run, encoding="utf-8")
        self.clock = VirtualClock()
        self.service = RunService(load_run(folder / "r.run.yaml"), self.clock)
        self.memory = self.service.memory
        self.service.start()

    def counts(self, number: int) -> tuple[int, int]:
        counters = self.service.states[number]
        return counters.done, counters.failed

    def shown(self, number: int) -> tuple[int, int, int, int]:
        """Return pulses, STATUS, SVCCNT, ERRCNT."""
        flags, status, *counts = self.memory.read("L", "word", 625 + 6 * number, 6)
        return flags, status, counts[0] | counts[1] << 16, counts[2] | counts[3] << 16


def test_pulses_start_blocks_once_a_completion(tmp_path: Path) -> None:
    bench = Bench(tmp_path, RUN.replace("STATUS", "yes"))
    bench.clock.run_for(60 * SECOND + SECOND // 2)
    assert bench.counts(0) == (60, 0) and bench.counts(1) == (60, 0), "NDR of block 0"
    assert bench.counts(2) == (0, 30) and bench.counts(3) == (30, 0), "ERR of block 2"
    assert bench.memory.read("M", "word", 100, 4) == [11, 22, 0, 11]
    assert bench.shown(0) == (0, 0, 60, 0)
    assert bench.shown(2) == (0, ErrorCode.NO_REPLY, 0, 30)
    assert bench.shown(3) == (0, 0, 30, 0)


REFUSING = """
run: refusing
memory: masterlogic
channels: {1: {port: "sim:small.device.yaml", protocol: mldp, station: 1}}
blocks: {0: {read: M100, into: M100, every: 1 s}}
"""
SMALL = """
device: small
protocol: mldp
station: 1
memory: {areas: {M: {unit: word, size: 10}}, addresses: [{form: "%{area}{unit}{start:dec}", unit: unit_names}],
  tables: {unit_names: {X: bit, B: byte, W: word}}}
"""


def test_a_refusal_shows_the_code_of_the_device(tmp_path: Path) -> None:
    (tmp_path / "small.device.yaml").write_text(SMALL, encoding="utf-8")
    bench = Bench(tmp_path, REFUSING)
    bench.clock.run_for(10 * SECOND + SECOND // 2)
    (status,) = bench.service.status()
    assert bench.shown(0) == (0, 0x7132, 0, 10), "an address beyond the area"
    assert (status.device_code, status.reason) == (0x7132, ErrorCode.REFUSED)
    assert str(bench.service.states[0].last_failure).startswith("refused 0x7132")


def test_a_pulse_lasts_one_scan(tmp_path: Path) -> None:
    bench = Bench(tmp_path, RUN.replace("STATUS", "yes"))
    seen: list[tuple[int, int]] = []
    bench.memory.watch("L", 625, 1, lambda *_: seen.append((bench.clock.now(), bench.shown(0)[0])))
    bench.clock.run_for(SECOND + SECOND // 2)
    (on, first), (off, second) = seen
    assert (first, second) == (1, 0) and off - on == bench.service.run.memory.scan == 10_000_000


def test_a_changed_station_word_redirects_the_next_exchange(tmp_path: Path) -> None:
    bench = Bench(tmp_path, RUN.replace("STATUS", "yes"))
    bench.clock.run_for(SECOND + SECOND // 2)
    assert bench.memory.read("M", "word", 100) == [11]
    bench.memory.write("N", "word", 0, [2])
    bench.memory.write("N", "word", 5, [3])
    bench.clock.run_for(SECOND)
    assert bench.memory.read("M", "word", 100, 3) == [22, 22, 24]
    bench.memory.write("N", "word", 5, [0])
    bench.clock.run_for(SECOND)
    assert bench.shown(0) == (0, ErrorCode.BAD_SETTING, 2, 1)
    failure = bench.service.status()[0].last_failure
    assert failure is not None and str(failure) == "bad_setting: the size in N word 5 is 0: that moves nothing"
    bench.memory.write("N", "word", 5, [1])
    bench.clock.run_for(SECOND)
    assert bench.shown(0) == (0, ErrorCode.BAD_SETTING, 3, 1), "STATUS stays"


def test_what_is_only_shown_is_put_back_at_the_next_exchange(tmp_path: Path) -> None:
    """The address of a variable that the block lacks, and the size of a single variable, are restored.

    The station has effect.
    """
    bench = Bench(tmp_path, RUN.replace("STATUS", "yes"))
    shown = bench.memory.read("N", "word", 0, 41)
    assert shown[:3] == [1, int.from_bytes(b"40", "little"), int.from_bytes(b"00", "little")]
    bench.memory.write("N", "word", 11, [1, 2, 3, 4, 5])
    bench.memory.write("N", "word", 40, [7])
    done = bench.service.states[0].done
    bench.clock.run_for(2 * SECOND)
    assert bench.service.states[0].done > done
    assert bench.memory.read("N", "word", 0, 41) == shown
    bench.memory.write("N", "word", 0, [2])
    bench.clock.run_for(2 * SECOND)
    assert bench.memory.read("N", "word", 0, 41) == [2, *shown[1:]]
    assert bench.memory.read("M", "word", 100) == [22]


def test_start_values_of_a_run_go_before_its_blocks(tmp_path: Path) -> None:
    bench = Bench(tmp_path, RUN.replace("STATUS", "yes") + "set: {N00000: 2}\n")
    bench.clock.run_for(SECOND + SECOND // 2)
    assert bench.memory.read("M", "word", 100) == [22]


def test_without_status_it_is_plain_memory(tmp_path: Path) -> None:
    bench = Bench(tmp_path, RUN.replace("STATUS", "no"))
    bench.memory.write("N", "word", 0, [2])
    bench.clock.run_for(4 * SECOND + SECOND // 2)
    assert bench.counts(0) == (4, 0) and bench.counts(1) == (0, 0), "no pulse, no start"
    assert bench.memory.read("M", "word", 100) == [11], "the station is the run's"
    assert not any(bench.memory.read("L", "word", 0, 11264))
    assert not any(bench.memory.read("N", "word", 1, 21503))


def test_switching_a_block_off_is_in_its_status(tmp_path: Path) -> None:
    bench = Bench(tmp_path, RUN.replace("STATUS", "yes"))
    bench.service.enable(0, False)
    bench.clock.run_for(5 * SECOND)
    status = bench.service.status()[0]
    assert (status.enabled, status.started, status.error, status.last_end) == (False, 0, 0, None)


OWN = """
run: own
memory:
  areas: {D: {unit: word, size: 100}, S: {unit: word, size: 100, access: read}}
  flags:
    mine: {area: S, first: 10, words: 4, sets: 1, blocks: 4, items: {
      running: {word: 0, bit: 0}, started_count: {word: 1}, reason: {word: 2}, done: {word: 3, bit: 7}}}
dead: no
channels:
  1: {port: "sim:one.device.yaml", protocol: modbus-rtu, params: {reply_timeout: 50 ms, retries: 0}}
blocks:
  0: {read: "40001", station: 1, into: D0, every: 1 s}
  1: {read: "40001", station: 9, into: D1, every: 1 s, phase: 1500 ms}
"""


def test_a_memory_of_ones_own_may_show_blocks(tmp_path: Path) -> None:
    bench = Bench(tmp_path, OWN)
    seen: list[list[int]] = []
    bench.memory.watch("S", 10, 4, lambda *_: seen.append(bench.memory.read("S", "word", 10, 4)))
    bench.clock.run_for(SECOND + SECOND // 4)
    assert seen == [[1, 1, 0, 0], [0, 1, 0, 128], [0, 1, 0, 0]], "counts and pulse in one write"
    bench.clock.run_for(SECOND // 2)
    assert bench.memory.read("S", "word", 14, 4) == [0, 1, ErrorCode.NO_REPLY, 0]


DAMAGED = """
run: damaged
memory: masterlogic
channels:
  1: {port: "sim:third-party-plc.device.yaml", protocol: third-party-plc, faults: {rules: [FAULT]}}
blocks:
  0: {send: WR.REQ, when: F00093, data: {payload: M0}}
  1: {receive: RD.DATA, data: {payload: M100}}
  2: {send: IMM.RESPONSE, when: block 1 failed}
  3: {send: IMM.RESPONSE, when: L006311}
"""
FAULT = "{fault: wrong_check, frame: RD.DATA, every: 2}"


def test_a_frame_that_comes_damaged_is_an_abnormal_completion_of_the_block_that_receives_it(tmp_path: Path) -> None:
    for name in ("third-party-plc.device.yaml", "third-party-plc.yaml"):
        if (EXAMPLES / name).exists():
            shutil.copy(EXAMPLES / name, tmp_path)
    bench = Bench(tmp_path, DAMAGED.replace("FAULT", FAULT))
    bench.clock.run_for(20 * SECOND + SECOND // 2)
    sent = bench.counts(0)[0]
    assert bench.counts(1) == (sent // 2, sent // 2) and sent >= 20
    assert bench.shown(1)[1:] == (ErrorCode.DAMAGED_FRAME, sent // 2, sent // 2)
    assert bench.counts(2) == (sent // 2, 0), "when: block 1 failed"
    assert bench.counts(3) == (sent // 2, 0), "ERR of block 1"
    [channel] = run_status(bench.service).channels
    assert (channel.errors, channel.reasons, channel.bad) == (sent // 2, {"damaged_frame": sent // 2}, sent // 2)
    failure = bench.service.status()[1].last_failure
    assert failure is not None and str(failure).startswith("damaged_frame: check at byte ")
    bench.service.enable(1, False)
    bench.clock.run_for(20 * SECOND)
    assert bench.counts(1) == (sent // 2, sent // 2), "a block that is off fails no more than it takes"
    states = bench.service.states.values()
    assert all(state.started == state.done + state.failed for state in states)


def address_words(text: str) -> list[int]:
    data = text.encode().ljust(8, b"\0")
    return [int.from_bytes(data[at : at + 2], "little") for at in range(0, 8, 2)]


def test_an_address_in_memory_redirects_the_next_exchange(tmp_path: Path) -> None:
    """Table 81 of the Snet guide: peer addresses and sizes change while the run is active."""
    block = '{read: "40001", station: 1, into: M100, every: 1 s}'
    larger = '{read: "40001", station: 2, into: M110, count: 2, every: 1 s}'
    run = RUN.replace("STATUS", "yes").replace(block, larger)
    bench = Bench(tmp_path, run)
    bench.clock.run_for(SECOND + SECOND // 2)
    assert bench.memory.read("M", "word", 110, 2) == [22, 23]
    bench.memory.write("N", "word", 1, address_words("40002"))
    bench.clock.run_for(SECOND)
    assert bench.memory.read("M", "word", 110, 2) == [23, 24]
    assert bench.memory.read("N", "word", 1, 4) == address_words("40002"), "it stays"
    bench.memory.write("N", "word", 5, [1])
    bench.memory.write("N", "word", 1, address_words("40003"))
    bench.clock.run_for(SECOND)
    assert bench.memory.read("M", "word", 110, 2) == [24, 24], "one element of the size in memory"
    assert bench.counts(0) == (3, 0)


@pytest.mark.parametrize("text", ["4000", "M100", "00001", "49999999", "40001\x01", "\xff"])
def test_an_impossible_address_in_memory_sends_nothing(tmp_path: Path, text: str) -> None:
    bench = Bench(tmp_path, RUN.replace("STATUS", "yes"))
    bench.clock.run_for(SECOND + SECOND // 2)
    data = text.encode("latin-1").ljust(8, b"\0")
    bench.memory.write("N", "word", 1, [int.from_bytes(data[at : at + 2], "little") for at in range(0, 8, 2)])
    bench.clock.run_for(SECOND)
    assert bench.counts(0) == (1, 1)
    assert bench.shown(0)[1] == ErrorCode.BAD_SETTING
    bench.memory.write("N", "word", 1, address_words("40001"))
    bench.clock.run_for(SECOND)
    assert bench.counts(0) == (2, 1)


def test_a_write_keeps_out_of_areas_that_can_only_be_read(tmp_path: Path) -> None:
    block = '{read: "40001", station: 1, into: M100, every: 1 s}'
    write = '{write: "40001", station: 1, from: M100, every: 1 s}'
    run = RUN.replace("STATUS", "yes").replace(block, write)
    bench = Bench(tmp_path, run)
    bench.memory.write("N", "word", 21, address_words("30001"))
    bench.clock.run_for(SECOND + SECOND // 2)
    assert bench.counts(0) == (0, 1)
    assert bench.shown(0)[1] == ErrorCode.BAD_SETTING
