"""Keys that no loader reads, in stand-alone files."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.definition.nodes import Mapping
from framekit.definition.problems import DefinitionError
from framekit.memory.profile import load_profile
from framekit.runfile.fault_plans import load_fault_plan


def test_a_key_of_a_memory_profile_that_no_loader_reads_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "own.memory.yaml"
    file.write_text("memory: own\nareas: {M: {unit: word, size: 10}}\nscan: 20 ms\n", encoding="utf-8")
    assert load_profile(file).scan == 20_000_000
    read = Mapping.get
    monkeypatch.setattr(Mapping, "get", lambda node, key: None if key == "scan" else read(node, key))
    with pytest.raises(DefinitionError, match="3:1: 'scan' has no effect here"):
        load_profile(file)


def test_a_key_of_a_fault_plan_that_no_loader_reads_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "own.faults.yaml"
    file.write_text("faults: own\nabout: it\nrules:\n  - {fault: no_reply, every: 3}\n", encoding="utf-8")
    assert len(load_fault_plan(file).rules) == 1
    read = Mapping.get
    monkeypatch.setattr(Mapping, "get", lambda node, key: None if key == "rules" else read(node, key))
    with pytest.raises(DefinitionError, match="3:1: 'rules' has no effect here"):
        load_fault_plan(file)
