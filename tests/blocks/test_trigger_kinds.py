"""A kind of trigger defined outside of framekit: `bursts: TIME` starts three times in a row, in every period."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import framekit
from framekit.definition import schema
from framekit.definition.nodes import Mapping, Node
from framekit.run.triggers import TRIGGERS, ArmedTriggers, Cycle, KnownPeriods, Trigger, TriggerReader, add_trigger
from framekit.runfile.run_file import load_run
from framekit.service.feasibility import Periods

EXAMPLES = Path(__file__).parents[2] / "examples"
MS = 1_000_000
RUN = """\
run: bursts
memory: masterlogic
channels:
  1: {port: "sim:third-party-plc.device.yaml", protocol: third-party-plc}
blocks:
  0: {receive: RD.DATA, channel: 1, data: {payload: M0100}}
  1: {send: WR.REQ, channel: 1, bursts: 1 s, data: {payload: M0200}}
  2: {send: IMM.RESPONSE, channel: 1, when: block 1 done}
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bursts(Trigger):
    """Three starts, 100 ms apart, in every period."""

    period: int

    @classmethod
    def load(cls, read: TriggerReader, node: Node, keys: Mapping) -> Bursts:
        period = read.some_time(node)
        if period < 300 * MS:
            raise read.reader.broken(node.at, "a burst takes 300 ms", "give a longer time")
        return cls(period=period)

    @property
    def is_cycle(self) -> bool:
        return True

    def arm(self, armed: ArmedTriggers, now: int) -> None:
        for number in range(3):
            first = now + number * 100 * MS
            armed.at(first, Cycle(first, self.period))

    def periods(self, known: KnownPeriods) -> Iterable[int]:
        return (self.period // 3,)


@pytest.fixture
def bursts() -> Iterator[None]:
    add_trigger("bursts", Bursts.load, {"$ref": "common.schema.json#/$defs/time"})
    yield
    del TRIGGERS["bursts"]
    for made in (schema._schemas, schema._validator, schema._known_keys):
        made.cache_clear()


def test_a_block_is_due_by_a_trigger_from_outside(bursts: None, tmp_path: Path) -> None:
    shutil.copy(EXAMPLES / "third-party-plc.device.yaml", tmp_path)
    file = tmp_path / "bursts.run.yaml"
    file.write_text(RUN)
    with framekit.VirtualRun(file) as run:
        run.run_for("2950 ms")
        one, two = run.block(1), run.block(2)
        assert (one.started, one.done) == (9, 9), "three in each second"
        assert two.started == 9, "others follow it"
    found = load_run(file)
    assert Periods(found).of(found.blocks[1]) == Periods(found).of(found.blocks[2]) == 1_000_000_000 // 3


def test_its_value_is_checked_like_any_other(bursts: None, tmp_path: Path) -> None:
    file = tmp_path / "bursts.run.yaml"
    file.write_text(RUN.replace("bursts: 1 s", "bursts: soon"))
    with pytest.raises(framekit.DefinitionError, match=r"bursts.run.yaml:7:41: .*'soon'"):
        load_run(file)
    file.write_text(RUN.replace("bursts: 1 s", "bursts: 20 ms"))
    with pytest.raises(framekit.DefinitionError, match="7:41: a burst takes 300 ms – give a longer time"):
        load_run(file)


def test_without_it_nobody_knows_the_key(tmp_path: Path) -> None:
    file = tmp_path / "bursts.run.yaml"
    file.write_text(RUN)
    with pytest.raises(framekit.DefinitionError, match="unknown key 'bursts' in block 1"):
        load_run(file)
