"""Exchanges made ready: what a service row comes to for certain places, and reads kept for those who ask again.

A read that depends on nothing but its own arguments and settings is worked out once. Nothing is sent from here.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from framekit.definition.model.values import FrameOf, LayoutOf
from framekit.definition.model.walk import expressions_of, parts_of
from framekit.link.construct_values import Compute, compile_value
from framekit.link.evaluate import Names
from framekit.link.exchange import Exchange
from framekit.link.replies import ReplyReader
from framekit.link.requests import Piece, Plan
from framekit.link.scope import Scope
from framekit.link.services.rows import RowFacts
from framekit.link.values import FrameValue

MOST_KEPT = 1024
"""So many reads are kept; then all are forgotten, since nobody repeats so many."""


class CompiledRow:
    """A row as the client uses it."""

    def __init__(self, facts: RowFacts) -> None:
        row, shared = facts.row, facts.shared

        def compiled(value: Any) -> Compute:
            return compile_value(value, shared.protocol, shared.codec, shared.table)

        self.facts = facts
        self.request = None if row.request is None else compiled(row.request)
        self.buffer = None if row.buffer is None else compiled(row.buffer)
        self.gives = [(name, compiled(value)) for name, value in row.gives.items()]
        self.reply = ReplyReader(facts)


@dataclass(frozen=True, slots=True)
class Prepared:
    """One exchange of a row, as often as it is asked for: what it sends, and what its replies are judged by."""

    row: CompiledRow
    pieces: tuple[Piece, ...]
    names: Names
    run: str | None
    station: Any
    request: FrameValue | None
    buffer: bytes
    arguments: Mapping[str, Any] = field(default_factory=dict)
    params: Mapping[str, Any] = field(default_factory=dict)

    def exchange(self) -> Exchange:
        """A new one to start."""
        return Exchange(
            run=self.run,
            station=self.station,
            request=self.request,
            buffer=self.buffer,
            expected=self.row.reply.expected,
            outside_session=self.row.facts.row.outside_session,
            arguments=self.arguments,
            params=self.params,
        )


@dataclass(frozen=True, slots=True)
class ReadyRead:
    """A whole read: its plan, its exchanges, and the unit and count of what is wanted."""

    plan: Plan
    exchanges: tuple[Prepared, ...]
    unit: str
    count: int


class ReadyReads:
    """Reads by what was asked for. They hold as long as no parameter changes; rows that read more are never kept."""

    def __init__(self, scope: Names) -> None:
        self._scope = scope if isinstance(scope, Scope) else None
        self._settings = -1
        self._kept: dict[Hashable, ReadyRead] = {}
        self._lasting: dict[RowFacts, bool] = {}

    def find(self, key: Hashable) -> ReadyRead | None:
        """What was kept for this."""
        scope = self._scope
        if scope is None:
            return None
        if scope.settings != self._settings:
            self._settings = scope.settings
            self._kept.clear()
        return self._kept.get(key)

    def keep(self, key: Hashable, read: ReadyRead) -> None:
        """Keeps a read for the next who asks, if it will be the same then."""
        if self._scope is None or not all(_is_plain(one.request) for one in read.exchanges):
            return
        facts = read.plan.facts
        if not all(self._lasts(row, self._scope) for row in facts.shared.rows[facts.row.service]):
            return
        if len(self._kept) >= MOST_KEPT:
            self._kept.clear()
        self._kept[key] = read

    def _lasts(self, facts: RowFacts, scope: Scope) -> bool:
        """Whether what a row makes of a place depends on nothing that changes by itself."""
        known = self._lasting.get(facts)
        if known is None:
            row, protocol = facts.row, facts.shared.protocol
            sent = [row.request, row.buffer]
            made: Sequence[Any] = [
                *(protocol.frames[part.frame].segments for part in parts_of(sent, FrameOf)),
                *(protocol.layouts[part.layout].segments for part in parts_of(sent, LayoutOf)),
            ]
            used = expressions_of([row.when, row.limit, row.run, sent, made])
            known = self._lasting[facts] = not any(scope.changes(part) for part in used)
        return known


def _is_plain(request: FrameValue | None) -> bool:
    """Whether a request may be sent again and again: nothing inside it takes note of being sent."""
    return request is None or not any(isinstance(value, (FrameValue, dict, list)) for value in request.fields.values())
