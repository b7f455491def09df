"""A process that was suspended reports it, once."""

from __future__ import annotations

from collections.abc import Callable

from framekit.run.trouble import TroubleReport, Troubles
from framekit.service.standstill import EVERY, Standstill
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000


class Suspended(VirtualClock):
    """A clock of a suspendable process: periodic checks are delayed by the suspension."""

    def __init__(self) -> None:
        super().__init__()
        self.looks: list[Callable[[], None]] = []
        self.time = 0

    def now(self) -> int:
        return self.time

    def look_at(self, when: int, callback: Callable[[], None]) -> None:
        self.looks.append(callback)


def test_a_suspended_process_is_reported_once() -> None:
    clock = Suspended()
    troubles, reports = Troubles(clock.now), list[TroubleReport]()
    troubles.listen(reports.append)
    watch = Standstill(clock, troubles, "r")
    watch.start()
    for late in (0, SECOND, 40 * SECOND, 0, 0):
        clock.time += EVERY + late
        (look,) = clock.looks
        clock.looks.clear()
        look()
    assert [(report.event, report.text) for report in reports] == [
        ("note", "run r: the process stood still for 40 s – it was suspended, or the machine asleep or overloaded")
    ]
    watch.stop()
    clock.time += 100 * SECOND
    clock.looks.pop()()
    assert len(reports) == 1 and not clock.looks
