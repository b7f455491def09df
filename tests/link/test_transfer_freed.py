"""The objects of a finished transfer are freed at once, without garbage collection."""

from __future__ import annotations

import gc
import weakref
from types import SimpleNamespace
from typing import Any

from framekit.link.events import Command, Exchange
from framekit.link.services.client import Transfer, TransferResult


class Engine:
    """An engine that starts exchanges and stores them."""

    scope = SimpleNamespace(now=0)

    def __init__(self) -> None:
        self.started: list[Exchange] = []

    def start(self, exchange: Exchange, now: int) -> list[Command]:
        self.started.append(exchange)
        return []


def test_a_transfer_that_has_ended_is_freed_without_a_collection() -> None:
    results: list[TransferResult] = []
    engine = Engine()
    gc.disable()
    try:
        one = SimpleNamespace(
            readers={None: lambda reply, buffer, request: []}, has_results=False, written=0
        )  # fmt: skip
        plan: Any = SimpleNamespace(
            exchanges=[one, one], sent=[(None, b"", None)] * 2, is_new_each_time=False, is_single=False,
            given=[(None, (), False, None, {}, {})] * 2,
            result=lambda data: TransferResult(True),
        )  # fmt: skip
        transfer = Transfer(plan, engine, 0, results.append)
        for number in (1, 2):
            assert engine.started == [transfer] * number
            transfer.taken = None
            transfer.succeeded({})
        gone = weakref.ref(transfer)
        engine.started.clear()
        del transfer
        assert gone() is None
    finally:
        gc.enable()
    assert [result.ok for result in results] == [True]
