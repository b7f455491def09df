"""What a transfer leaves behind is freed at once: no collection has to find it."""

from __future__ import annotations

import gc
import weakref
from types import SimpleNamespace
from typing import Any

from framekit.link.exchange import Exchange, Outcome
from framekit.link.services.client import Transfer, TransferResult


def made(on_done: Any) -> Exchange:
    return Exchange(on_done=on_done)


def test_a_transfer_that_has_ended_is_freed_without_a_collection() -> None:
    results: list[TransferResult] = []
    started: list[Exchange] = []
    gc.disable()
    try:
        one = SimpleNamespace(exchange=made, answer=lambda outcome: ([], {}), written=0)
        plan: Any = SimpleNamespace(exchanges=[one, one], result=lambda data: TransferResult(True))
        transfer = Transfer(plan, started.append, results.append)
        transfer.go()
        for number in (1, 2):
            assert len(started) == number
            started[-1].on_done(Outcome(True))
        gone = weakref.ref(transfer)
        del transfer
        assert gone() is None, "its exchanges, which are still there, do not hold it"
    finally:
        gc.enable()
    assert [result.ok for result in results] == [True]
