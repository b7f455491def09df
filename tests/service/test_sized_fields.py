"""Fields of SEND blocks whose size is given by the block: adjacent data, sized by a parameter of the protocol."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.definition.problems import DefinitionError
from framekit.link.events import Seen
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

PROTOCOL = """protocol: pairs
line: {format: 8E1}
params: {first: {type: number, default: 4, range: 1..20}}
groups:
  tx: {from: client, head: [{const: ENQ}], tail: [{const: EOT}]}
frames:
  PAIR: {group: tx, body: [{data: one, size: first}, {data: two, size: rest}]}
"""
RUN = """run: pairs
memory: masterlogic
channels:
  1: {port: "sim:nobody.device.yaml", protocol: pairs.yaml}
blocks:
"""
SET = "set: {M0: [0x3231, 0x3433, 0x3635], M10: [0x4241, 0x4443]}\n"


def written(folder: Path, blocks: str) -> Path:
    (folder / "pairs.yaml").write_text(PROTOCOL)
    (folder / "nobody.device.yaml").write_text("device: nobody\nprotocol: pairs.yaml\n")
    path = folder / "pairs.run.yaml"
    path.write_text(RUN + blocks + SET)
    return path


class Bench:
    """A started run, with its transmitted frames."""

    def __init__(self, path: Path) -> None:
        self.frames: list[bytes] = []
        self.clock = VirtualClock()
        self.service = RunService(load_run(path), self.clock, self._watch)
        self.service.start()

    def _watch(self, channel: int, seen: Seen) -> None:
        if seen.kind == "frame" and seen.direction == "out":
            self.frames.append(seen.raw)

    def sent_in(self, milliseconds: int) -> list[bytes]:
        """Return the frames that are sent within the next milliseconds."""
        self.frames.clear()
        self.clock.run_for(milliseconds * 1_000_000)
        return self.frames.copy()


def sent(path: Path) -> list[bytes]:
    return Bench(path).sent_in(1000)


def test_the_block_says_where_the_first_of_two_ends(tmp_path: Path) -> None:
    blocks = """  0: {send: PAIR, data: {one: M0, two: M10}, size: {one: 6, two: 2}, once: yes}
  1: {send: PAIR, data: {one: M0, two: M10}, size: {one: 1, two: 4}, when: block 0 done}
"""
    assert sent(written(tmp_path, blocks)) == [b"\x05123456AB\x04", b"\x051ABCD\x04"]


def test_a_size_that_the_block_leaves_out_is_that_of_the_parameter(tmp_path: Path) -> None:
    block = "  0: {send: PAIR, data: {one: M0, two: M10}, size: {two: 2}, once: yes}\n"
    assert sent(written(tmp_path, block)) == [b"\x051234AB\x04"]


FIRST_SIZE, SECOND_SIZE = 25, 30
"""The words of block 0 in the area N that hold the sizes of its first two variables."""


def test_settings_changed_in_memory_count_at_later_starts(tmp_path: Path) -> None:
    """Each start reads the settings; fields read by an earlier start are not used again."""
    block = "  0: {send: PAIR, data: {one: M0, two: M10}, size: {one: 6, two: 2}, every: 100 ms}\n"
    bench = Bench(written(tmp_path, block))
    memory = bench.service.memory
    assert bench.sent_in(250) == [b"\x05123456AB\x04"] * 2
    memory.write("N", "word", FIRST_SIZE, [1])
    memory.write("N", "word", SECOND_SIZE, [4])
    assert bench.sent_in(200) == [b"\x051ABCD\x04"] * 2, "changed before the third start"
    memory.write("N", "word", FIRST_SIZE, [3])
    memory.write("M", "word", 0, [0x3938])
    assert bench.sent_in(100) == [b"\x05893ABCD\x04"], "changed again, and other content"
    memory.write("N", "word", FIRST_SIZE, [0])
    assert bench.sent_in(100) == [], "no size"
    failure = bench.service.status()[0].last_failure
    assert failure is not None and failure.outcome == "bad_setting"
    memory.write("N", "word", FIRST_SIZE, [6])
    memory.write("N", "word", SECOND_SIZE, [2])
    assert bench.sent_in(200) == [b"\x05893456AB\x04"] * 2, "as the run file has it"


@pytest.mark.parametrize(
    ("size", "problem"),
    [
        ("{one: 21, two: 2}", "21 is not in 1..20"),
        ("{one: 2}", "nothing says how many bytes 'two' of 'PAIR' has"),
    ],
)
def test_a_size_that_cannot_be_is_told(tmp_path: Path, size: str, problem: str) -> None:
    path = written(tmp_path, f"  0: {{send: PAIR, data: {{one: M0, two: M10}}, size: {size}, once: yes}}\n")
    with pytest.raises(DefinitionError) as error:
        load_run(path)
    assert [problem in str(reported) for reported in error.value.problems] == [True]
