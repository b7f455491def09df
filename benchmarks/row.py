"""Results of benchmarks: rows with a figure, its reference, and its target."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, Protocol

from benchmarks.measure import Ratio, Timing


@dataclass(frozen=True, slots=True)
class Target:
    """The bound of a figure: `at most` or `at least`."""

    sense: Literal["at most", "at least"]
    bound: float

    def reached(self, figure: float) -> bool:
        return figure <= self.bound if self.sense == "at most" else figure >= self.bound


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the table. `low` and `high` are the quartiles of the rounds.

    `details` are medians and other parts of the figure, with their unit in the name (`by hand µs`).
    """

    what: str
    against: str
    figure: float
    low: float
    high: float
    target: Target | None = None
    unit: str = "×"
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def reached(self) -> bool:
        return self.target is None or self.target.reached(self.figure)

    def as_json(self) -> dict[str, Any]:
        return {**asdict(self), "reached": self.reached}


class RowModule(Protocol):
    """A module of `benchmarks.rows`: its name, the target of the issue in words, and the measuring function."""

    NAME: str
    TARGET: str
    run: Callable[[int], list[Row]]


def slower(what: str, against: str, ours: Timing, other: Timing, target: Target | None, scale: float = 1e6) -> Row:
    """Return a row with our time as a multiple of the other's: 1.2 means a fifth longer."""
    return _row(what, against, ours.ratio(other), target, _medians(against, ours, other, scale))


def faster(what: str, against: str, ours: Timing, other: Timing, target: Target | None, scale: float = 1e6) -> Row:
    """Return a row with the other's time as a multiple of ours: 8 means we need an eighth of its time."""
    return _row(what, against, other.ratio(ours), target, _medians(against, ours, other, scale))


def _row(what: str, against: str, ratio: Ratio, target: Target | None, details: Mapping[str, Any]) -> Row:
    return Row(what, against, ratio.value, ratio.low, ratio.high, target, details=details)


UNITS = {1e9: "ns", 1e6: "µs", 1e3: "ms", 1.0: "s"}


def _medians(against: str, ours: Timing, other: Timing, scale: float) -> dict[str, float]:
    unit = UNITS[scale]
    return {f"framekit {unit}": round(ours.median * scale, 3), f"{against} {unit}": round(other.median * scale, 3)}


def as_table(rows: Iterable[Row]) -> str:
    """Return the rows as a readable table."""
    lines = [f"{'':<50} {'against':<21}{'figure':>10}{'quartiles':>17}{'target':>9}"]
    return "\n".join(lines + [_line(row) for row in rows])


def _line(row: Row) -> str:
    target, mark = "", ""
    if row.target is not None:
        target = f"{'≤' if row.target.sense == 'at most' else '≥'} {row.target.bound:g}"
        mark = "" if row.reached else "  missed"
    quartiles = f"{_number(row.low)} – {_number(row.high)}"
    details = ", ".join(f"{name} {value}" for name, value in row.details.items())
    figure = f"{_number(row.figure)} {row.unit}"
    return f"{row.what:<50} {row.against:<21}{figure:>10}{quartiles:>17}{target:>9}  {details}{mark}"


def _number(figure: float) -> str:
    return f"{figure:.2f}" if abs(figure) < 100 else f"{figure:.0f}"
