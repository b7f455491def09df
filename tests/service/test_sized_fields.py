"""Fields of SEND blocks whose size the block says: data side by side, sized by a parameter of the protocol."""

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


def sent(path: Path) -> list[bytes]:
    frames: list[bytes] = []

    def watch(channel: int, seen: Seen) -> None:
        if seen.kind == "frame" and seen.direction == "out":
            frames.append(seen.raw)

    clock = VirtualClock()
    service = RunService(load_run(path), clock, watch)
    service.start()
    clock.run_for(1_000_000_000)
    return frames


def test_the_block_says_where_the_first_of_two_ends(tmp_path: Path) -> None:
    blocks = """  0: {send: PAIR, data: {one: M0, two: M10}, size: {one: 6, two: 2}, once: yes}
  1: {send: PAIR, data: {one: M0, two: M10}, size: {one: 1, two: 4}, when: block 0 done}
"""
    assert sent(written(tmp_path, blocks)) == [b"\x05123456AB\x04", b"\x051ABCD\x04"]


@pytest.mark.parametrize(
    ("size", "problem"),
    [
        ("{one: 21, two: 2}", "21 is not in 1..20"),
        ("{two: 2}", "nothing says how many bytes 'one' of 'PAIR' has"),
        ("{one: 2}", "nothing says how many bytes 'two' of 'PAIR' has"),
    ],
)
def test_a_size_that_cannot_be_is_told(tmp_path: Path, size: str, problem: str) -> None:
    path = written(tmp_path, f"  0: {{send: PAIR, data: {{one: M0, two: M10}}, size: {size}, once: yes}}\n")
    with pytest.raises(DefinitionError) as told:
        load_run(path)
    assert [problem in str(one) for one in told.value.problems] == [True]
