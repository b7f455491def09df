"""Sides of one protocol share the data derived from its definition: a second side repeats no compilation or search."""

from __future__ import annotations

from typing import Any

import pytest

from framekit.codec import evaluate
from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.link import inside
from framekit.link.engine import Engine
from framekit.link.services import rows
from framekit.link.services.client import ServiceClient
from framekit.link.services.server import MemoryServer
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of


def test_a_second_side_compiles_no_expression_and_looks_for_no_frames_inside(monkeypatch: pytest.MonkeyPatch) -> None:
    protocol = load_protocol("df1")
    codec = compile_protocol(protocol)

    def make() -> None:
        memory = DeviceMemory(memory_of(protocol)[0])
        engine = Engine(protocol, codec, "full", server=MemoryServer(protocol, codec, memory))
        ServiceClient(protocol, codec, engine)

    work: list[str] = []

    def watched(module: Any, name: str) -> None:
        real = getattr(module, name)

        def called(*given: Any, **more: Any) -> Any:
            work.append(name)
            return real(*given, **more)

        monkeypatch.setattr(module, name, called)

    watched(evaluate, "emit")
    watched(inside, "_is_findable")
    watched(rows, "names_in")
    make()
    work.clear()
    make()
    assert work == []
