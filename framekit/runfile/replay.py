"""The behaviour `replay`: what a sink has kept stands in a simulated device again, in the same time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from framekit.definition.keys import Form, KeyReading, key, keys, ref, words
from framekit.run.behaviours import BEHAVIOURS, Behaviour, BehaviourMoment
from framekit.runfile.fault_plans import leaves_folder
from framekit.sinks.recorded import recorded

Samples = tuple[tuple[int, ...], tuple[float, ...]]
"""Times from the first one on (ns), and the values."""


def _samples(reading: KeyReading) -> Samples:
    reader, node, named = reading.reader, reading.keys.get("replay"), reading.keys.get("point")
    name = reader.text(node)
    point = None if named is None else reader.text(named)
    assert node is not None
    if leaves_folder(name):
        raise reader.broken(node.at, f"'{name}' leaves the folder of this file", "name a file beside it")
    with reader.refusing(node.at):
        found = recorded(reading.loader.folder / name, point)
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayedValues(Behaviour):
    """Is what a point was, as a sink has kept it, in the same time."""

    word: ClassVar[str] = "replay"
    samples: Samples = keys(
        {
            "replay": {**ref("text"), "description": "A file of values of a sink: csv, jsonl or sqlite."},
            "point": {**ref("text"), "description": "The point in it; it may be left out where there is one."},
        },
        _samples,
    )
    then: str = key(
        "then", Form(words("an end of a replay", "again", "stay"), lambda r, node: r.reader.text(node)),
        "What comes then: the last value stays (the default), or all again, one every after it.", default="stay",
    )  # fmt: skip

    def value(self, now: BehaviourMoment) -> float | None:
        times, values = self.samples
        time = now.time % (times[-1] + self.every) if self.then == "again" else now.time
        return values[bisect_right(times, time) - 1]

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        _, values = self.samples
        yield from (("replay", min(values)), ("replay", max(values)))


BEHAVIOURS["replay"] = ReplayedValues
