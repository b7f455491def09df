"""A run with jobs on the virtual clock, with a simulated device for each host and a record of bits and words."""

from __future__ import annotations

from pathlib import Path

from framekit.extras.commreq.jobs import Found
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

MS = 1_000_000
SECOND = 1_000_000_000
FAR = """device: far
protocol: modbus-tcp
station: 1
memory: {{areas: {{holding: {{unit: word, size: 200}}}}, set: {{holding0: [{values}]}}}}
{more}
"""


def write_device(folder: Path, name: str, values: str = "11, 12, 13, 14", more: str = "") -> None:
    """Write a device that answers at once."""
    (folder / f"{name}.device.yaml").write_text(FAR.format(values=values, more=more), encoding="utf-8")


class Bench:
    """A run service on a virtual clock with a scripted resolver.

    `names` maps each host name to its addresses, or to None if the resolver is busy and cannot take the query.
    """

    def __init__(self, run: Path, names: dict[str, list[str] | None] | None = None) -> None:
        self.clock = VirtualClock()
        self.names = names or {}
        self.asked: list[str] = []
        self.service = RunService(load_run(run), self.clock, resolve=self._resolve)
        self.memory = self.service.memory
        self.jobs = self.service.jobs
        assert self.jobs is not None
        self.service.start()

    def _resolve(self, name: str, found: Found) -> None:
        self.asked.append(name)
        addresses = self.names.get(name, [])
        self.clock.call_at(self.clock.now() + 5 * MS, lambda: found(addresses))

    def run(self, milliseconds: int) -> None:
        self.clock.run_for(milliseconds * MS)

    def words(self, area: str, first: int, count: int = 1) -> list[int]:
        return self.memory.read(area, "word", first, count)

    def word(self, area: str, first: int) -> int:
        return self.words(area, first)[0]

    def put(self, area: str, first: int, *values: int) -> None:
        self.memory.write(area, "word", first, list(values))

    def bits(self, area: str = "P", first: int = 0) -> tuple[int, ...]:
        """Return the numbers of the status bits that are set."""
        words = self.words(area, first, 5)
        return tuple(16 * index + bit + 1 for index, word in enumerate(words) for bit in range(16) if word >> bit & 1)

    def counts(self, number: int) -> tuple[int, int, int]:
        """Return the counters of a block: started, done, failed."""
        counters = self.service.states[number]
        return counters.started, counters.done, counters.failed


def bench(folder: Path, text: str, **more: object) -> Bench:
    """Return a bench for a run with this text."""
    path = folder / "r.run.yaml"
    path.write_text(text, encoding="utf-8")
    return Bench(path, **more)  # type: ignore[arg-type]
