"""Report points whose words are probably read in the wrong order: an uncommon number that is common in the other order.

The point keeps its value and its quality: framekit does not guess. The report has both numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

from framekit.memory.memory import DeviceMemory
from framekit.memory.views import NumberView
from framekit.memory.word_order import has_words, likely_with_reversed_words, order_of, reversed_view
from framekit.run.model import Point
from framekit.run.own_memory import piece_reader
from framekit.run.points import PointTable, PointValue, scaled, value_text
from framekit.run.trouble import SECOND, Troubles
from framekit.transport.clock import Clock, Handle

GATHER = SECOND
"""Time from the first doubt to the report, which has further points in doubt (ns)."""
ENDS_AFTER = 20
"""Number of successive common values after which a doubt ends: a wrong order gives some by chance."""
MOST_NAMED = 3
NAME = "order of words"
REMEDY = "if that is the right value, write the order into the point"


class _Doubtful(NamedTuple):
    """A point that may be read in the wrong order."""

    point: Point
    view: NumberView
    read: Callable[[], bytes]


class OrderDoubts:
    """The points of a run whose order of words is in doubt. One trouble names all of them."""

    def __init__(
        self, points: Iterable[Point], table: PointTable, memory: DeviceMemory, troubles: Troubles, clock: Clock
    ) -> None:
        self._clock = clock
        self._watched: dict[str, _Doubtful] = {}
        for point in points:
            view = point.form.view
            if not isinstance(view, NumberView) or not has_words(view, point.form.place):
                continue
            if view.kind == "float" or point.order is None:
                self._watched[point.name] = _Doubtful(point, view, piece_reader(memory, point.place, point.bits))
        self._doubts: dict[str, str] = {}
        """Sentences by the names of the points in doubt."""
        self._common: dict[str, int] = {}
        """Number of common values since the last uncommon value, by the name of a point in doubt."""
        self._timer: Handle | None = None
        if self._watched:
            self._source = troubles.source(NAME, unit="", well="all values are common again", is_whole=True)
            table.listeners.append(self._look)

    def _look(self, value: PointValue) -> None:
        """Compare a new value of a point with its other order."""
        watched = self._watched.get(value.name)
        if watched is None or value.quality != "good":
            return
        point, view, read = watched
        number = view.read(read())[0]
        other = likely_with_reversed_words(view, number)
        if other is None:
            if point.name in self._doubts:
                self._is_common(point.name)
            return
        self._common[point.name] = 0
        is_new = point.name not in self._doubts
        order = order_of(reversed_view(view))
        as_read, other_text = (f"{_text(point, scaled(point, one))} {point.unit}".strip() for one in (number, other))
        self._doubts[point.name] = f"{point.name} reads {as_read}, with order: {order} it would be {other_text}"
        if self._source.reason:
            self._source.reason = self._reason()
        elif is_new and self._timer is None:
            self._timer = self._clock.call_at(self._clock.now() + GATHER, self._begin)

    def _is_common(self, name: str) -> None:
        self._common[name] += 1
        if self._common[name] < ENDS_AFTER:
            return
        del self._doubts[name], self._common[name]
        if self._doubts and self._source.reason:
            self._source.reason = self._reason()
        elif not self._doubts:
            self._source.ends()

    def _begin(self) -> None:
        self._timer = None
        if self._doubts and not self._source.reason:
            self._source.begins(self._reason())

    def _reason(self) -> str:
        named = list(self._doubts.values())
        more = [f"and {len(named) - MOST_NAMED} more"] if len(named) > MOST_NAMED else []
        return f"{'; '.join([*named[:MOST_NAMED], *more])} – {REMEDY}"

    def end(self) -> None:
        """Report a doubt that waits for its report; no report follows."""
        if self._timer is not None:
            self._timer.cancel()
            self._begin()


def _text(point: Point, value: object) -> str:
    """Return a value as text; a float of 32 bits with the digits that it needs."""
    return value_text(replace(point, decimals=None), value)
