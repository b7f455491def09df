"""What a transfer leaves behind is freed at once: no collection has to find it."""

from __future__ import annotations

import gc
import weakref

from framekit.link.exchange import Exchange, Outcome
from framekit.link.transfer import Answer, Job, Transfer, TransferResult


def test_a_transfer_that_has_ended_is_freed_without_a_collection() -> None:
    results: list[TransferResult] = []
    started: list[Exchange] = []
    gc.disable()
    try:
        exchanges = [Exchange(), Exchange()]
        jobs = [Job(exchange, (), lambda outcome: Answer()) for exchange in exchanges]
        transfer = Transfer(jobs, started.append, lambda data: TransferResult(True), results.append)
        transfer.go()
        for exchange in exchanges:
            assert exchange is started[-1]
            exchange.on_done(Outcome(True))
        gone = weakref.ref(transfer)
        del transfer, jobs
        assert gone() is None, "its exchanges, which are still there, do not hold it"
    finally:
        gc.enable()
    assert [result.ok for result in results] == [True]
