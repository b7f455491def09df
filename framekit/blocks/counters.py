"""What happened to a block, in numbers. They add up: started = done + failed + running."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Counters:
    """Counters of one block. `overruns`: times it came due while it was still waiting or running."""

    started: int = 0
    done: int = 0
    failed: int = 0
    overruns: int = 0

    @property
    def running(self) -> int:
        return self.started - self.done - self.failed
