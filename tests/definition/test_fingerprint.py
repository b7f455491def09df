"""Fingerprints: equal content has the same fingerprint at any place, and every difference changes it."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest
from shipped import EXAMPLES, example_runs

from framekit.definition.fingerprint import fingerprint
from framekit.definition.problems import Position
from framekit.runfile.run_file import load_run

RUNS = [path for path in example_runs() if path.parent == EXAMPLES]


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.stem)
def test_where_a_thing_stands_does_not_count(path: Path) -> None:
    first, second = load_run(path), load_run(path)
    assert {number: fingerprint(channel) for number, channel in first.channels.items()} == {
        number: fingerprint(channel) for number, channel in second.channels.items()
    }
    elsewhere = Position("elsewhere.yaml", 99, 9)
    for block in first.blocks:
        assert fingerprint(replace(block, at=elsewhere)) == fingerprint(block)
    assert len({fingerprint(block) for block in first.blocks}) == len(first.blocks)


def test_every_field_of_a_block_counts() -> None:
    (block, *_) = load_run(EXAMPLES / "mldp-flags.run.yaml").blocks
    same = fingerprint(block)
    for field in fields(block):
        if field.name != "at":
            assert fingerprint(replace(block, **{field.name: ("other", 1)})) != same, field.name


def test_texts_are_not_run_together() -> None:
    assert fingerprint(("a", "b")) != fingerprint(("ab",)) != fingerprint(("a", ("b",)))
    assert fingerprint({"a": 1}) != fingerprint({"a": "1"})
    assert fingerprint(1) != fingerprint(True)
    with pytest.raises(TypeError, match="a object has no fingerprint"):
        fingerprint(object())
