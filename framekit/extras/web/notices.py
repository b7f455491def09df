"""Notices: trouble of a run that stays at the top of the page until a user has seen it, also if it is over."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

MOST_NOTICES = 50
"""Notices that are kept; the oldest is dropped first."""


@dataclass(slots=True)
class Notice:
    """One trouble. Times in seconds since 1970."""

    number: int
    text: str
    began: float
    ended: float | None = None
    """When it was over; None while it lasts."""


class Notices:
    """The troubles of a run, compared at regular intervals. `round` counts the changes."""

    def __init__(self) -> None:
        self.round = 0
        self._last = 0
        self._present: dict[str, Notice] = {}
        self._all: OrderedDict[int, Notice] = OrderedDict()

    def look(self, troubles: Mapping[str, str], now: float) -> None:
        """Compare with the troubles at this moment: a key for each, and its sentence."""
        for key in [key for key in self._present if key not in troubles]:
            self._present.pop(key).ended = now
            self.round += 1
        for key, text in troubles.items():
            notice = self._present.get(key)
            if notice is None:
                self._last += 1
                notice = self._present[key] = self._all[self._last] = Notice(self._last, text, now)
                self.round += 1
                while len(self._all) > MOST_NOTICES:
                    over = (number for number, known in self._all.items() if known.ended is not None)
                    del self._all[next(over, next(iter(self._all)))]  # a trouble that lasts stays
            elif notice.text != text:
                notice.text = text
                self.round += 1

    def __iter__(self) -> Iterator[Notice]:
        return iter(self._all.values())
