"""What a reply brings: the data where a service row says they stand, judged against what was asked.

A reply that does not fit the request, in bytes or in the number of blocks, gives nothing. Language reference, sections
11 and 13.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from framekit.codec.shown import explain
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.services import ReplyRow
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, RecordOf, Value
from framekit.link.construct_values import read_layout
from framekit.link.evaluate import EVALUATION_ERRORS, Evaluate, Names, compile_expression
from framekit.link.exchange import Outcome
from framekit.link.invert import bare_name
from framekit.link.packing import PackingError
from framekit.link.requests import Piece
from framekit.link.services.rows import RowFacts, ServiceRows, padded_names
from framekit.link.values import FrameValue, attribute

Found = list[tuple[Any, bool]]
"""Data found in a reply, each with whether padding may stand behind them."""
Collect = Callable[[Any, Names, Found], None]


class UnfitReplyError(ValueError):
    """A reply that does not fit what was asked; the message says where."""


class Refusal(NamedTuple):
    """`outcome`: what an exchange is that ended so and has no other word for it."""

    code: int
    meaning: str
    outcome: str


class ErrorReader:
    """Tells when a device says no, and how."""

    def __init__(self, shared: ServiceRows) -> None:
        errors = shared.protocol.errors
        self.frames = shared.error_frames
        self.when: Evaluate | None = None
        self.code: Evaluate | None = None
        self.detail: Evaluate | None = None
        self.unanswered: Evaluate | None = None
        tables = shared.protocol.tables
        self.names = [
            (None if names.when is None else compile_expression(names.when), tables[names.table].entries)
            for names in (() if errors is None else errors.names)
            if names.table in tables
        ]
        if errors is not None and self.frames:
            self.when = None if errors.when is None else compile_expression(errors.when)
            self.code = None if errors.code is None else compile_expression(errors.code)
            self.detail = None if errors.detail is None else compile_expression(errors.detail)
            self.unanswered = None if errors.unanswered is None else compile_expression(errors.unanswered)

    def refusal(self, reply: FrameValue, names: Names) -> Refusal | None:
        """What the reply says when it is an error frame. Raises EVALUATION_ERRORS."""
        if reply.frame not in self.frames:
            return None
        fields = Names(reply.complete(), names)
        if self.when is not None and not self.when(fields):
            return None
        code = 0 if self.code is None else int(self.code(fields))
        known = Names({"code": code}, fields)
        unanswered = self.unanswered is not None and bool(self.unanswered(known))
        return Refusal(code, self.meaning(code, known), "no_reply" if unanswered else "refused")

    def meaning(self, code: int, names: Names) -> str:
        """The name of a code, '' if the protocol has none for it, with its detail. Raises EVALUATION_ERRORS."""
        found = (table[code] for when, table in self.names if code in table and (when is None or when(names)))
        meaning, detail = str(next(found, "")), "" if self.detail is None else str(self.detail(names))
        return f"{meaning} ({detail})" if meaning and detail else meaning or detail


class ReplyReader:
    """Takes the data out of replies to one service row."""

    def __init__(self, facts: RowFacts) -> None:
        self.facts = facts
        self.shared = facts.shared
        self.rows = [(row, *self._compiled(row)) for row in facts.row.reply]
        frames = [row.frame.frame for row in facts.row.reply if row.frame is not None]
        self.expected = tuple(dict.fromkeys((*frames, *self.shared.error_frames)))

    def data_fields(self) -> dict[str, str]:
        """By their frames, the replies in which one field is the data of the only piece, and nothing else matters."""
        found: dict[str, str] = {}
        several: set[str] = set()
        for row, _, _ in self.rows:
            frame = row.frame
            name = None if frame is None else frame.frame
            if frame is None or name is None or row.buffer is not None:
                continue
            if name in found:
                several.add(name)
            padded = padded_names(self.shared.protocol.frames[name].segments)
            fields = [field for field, value in frame.fields.items() if self._collect(value, False) is not _nothing]
            plain = [field for field in fields if field not in padded and _is_data(frame.fields[field])]
            if len(fields) == len(plain) == 1:
                found[name] = plain[0]
            else:
                several.add(name)
        return {name: field for name, field in found.items() if name not in several | set(self.shared.error_frames)}

    def data(self, outcome: Outcome, pieces: Sequence[Piece], names: Names) -> list[bytes]:
        """The data of each piece in memory's form; [] if the reply row brings none. Raises UnfitReplyError."""
        return self._first(outcome, names, lambda found: self._unpacked(found, pieces))

    def blocks(self, outcome: Outcome, names: Names) -> list[bytes]:
        """The data as they stand in the reply, of a service that was not asked for places. Raises UnfitReplyError."""
        return self._first(outcome, names, lambda found: [data for data, _ in found if isinstance(data, bytes)])

    def _first(self, outcome: Outcome, names: Names, judge: Callable[[Found], list[bytes]]) -> list[bytes]:
        """What `judge` makes of the data in the first row of this reply's frame that fits."""
        problem: UnfitReplyError | None = None
        for row, frame, buffer in self._fitting(outcome.reply):
            try:
                return judge(self._found(row, frame, buffer, outcome, names))
            except UnfitReplyError as error:
                problem = problem or error
        if problem is not None:
            raise problem
        if outcome.reply is None:
            return []
        raise UnfitReplyError(f"'{outcome.reply.frame}' is no reply to '{self.facts.row.name}'")

    def _fitting(self, reply: FrameValue | None) -> list[tuple[ReplyRow, Collect, Collect]]:
        name = None if reply is None else reply.frame
        return [item for item in self.rows if (None if item[0].frame is None else item[0].frame.frame) == name]

    def _found(self, row: ReplyRow, frame: Collect, buffer: Collect, outcome: Outcome, names: Names) -> Found:
        found: Found = []
        try:
            if outcome.reply is not None:
                frame(outcome.reply, names, found)
            if row.buffer is not None:
                buffer(outcome.buffer, names, found)
        except UnfitReplyError:
            raise
        except EVALUATION_ERRORS as error:
            raise UnfitReplyError(f"the reply cannot be read: {explain(error)}") from None
        return found

    def _unpacked(self, found: Found, pieces: Sequence[Piece]) -> list[bytes]:
        if found and len(found) != len(pieces):
            raise UnfitReplyError(f"the reply holds {len(found)} blocks of data, not {len(pieces)}")
        return [self._of_piece(data, padded, piece) for (data, padded), piece in zip(found, pieces, strict=False)]

    def _of_piece(self, data: Any, padded: bool, piece: Piece) -> bytes:
        if not isinstance(data, bytes):
            raise UnfitReplyError(f"the reply has {data!r} where data should stand")
        packer, start = self.facts.packer(piece.address.unit), piece.address.start
        size = packer.size(start, piece.count)
        if padded and len(data) > size:
            data = data[:size]
        try:
            return packer.to_memory(data, start, piece.count)
        except PackingError as error:
            raise UnfitReplyError(f"the reply does not fit the request: {error}") from None

    # ---- compiled once ------------------------------------------------------------------------------------

    def _compiled(self, row: ReplyRow) -> tuple[Collect, Collect]:
        return (
            _nothing if row.frame is None else self._collect(row.frame, False),
            _nothing if row.buffer is None else self._collect(row.buffer, False),
        )

    def _collect(self, value: Value, padded: bool) -> Collect:
        match value:
            case Expression():
                return _data_there(padded) if _is_data(value) else _nothing
            case FrameOf(frame=frame, fields=fields):
                return self._fields(fields, padded_names(self.shared.protocol.frames[frame].segments))
            case RecordOf(fields=fields):
                return self._fields(fields, frozenset())
            case LayoutOf(layout=layout, fields=fields):
                segments = self.shared.protocol.layouts[layout].segments
                return self._layout(layout, self._fields(fields, padded_names(segments)))
            case ListOf(items=items):
                return _each_of([self._collect(item, False) for item in items])
            case EachOf(fields=fields):
                return _every(self._fields(fields, frozenset()))
        return _nothing

    def _fields(self, fields: Mapping[str, Value], padded: frozenset[str]) -> Collect:
        compiled = [(name, self._collect(value, name in padded)) for name, value in fields.items()]
        wanted = [(name, collect) for name, collect in compiled if collect is not _nothing]
        if not wanted:
            return _nothing

        def collect_fields(actual: Any, names: Names, found: Found) -> None:
            for name, collect in wanted:
                collect(attribute(actual, name), names, found)

        return collect_fields

    def _layout(self, layout: str, collect: Collect) -> Collect:
        decode = self.shared.codec.layouts[layout][1]
        if collect is _nothing:
            return _nothing
        return lambda actual, names, found: collect(read_layout(decode, actual, names), names, found)


def _is_data(value: Value) -> bool:
    return isinstance(value, Expression) and bare_name(value) == "data"


def _nothing(actual: Any, names: Names, found: Found) -> None:
    """Nothing is to be taken here."""


def _data_there(padded: bool) -> Collect:
    return lambda actual, names, found: found.append((actual, padded))


def _each_of(items: list[Collect]) -> Collect:
    """A list with exactly these items."""
    if all(item is _nothing for item in items):
        return _nothing

    def collect(actual: Any, names: Names, found: Found) -> None:
        if not isinstance(actual, list) or len(actual) != len(items):
            raise UnfitReplyError(f"the reply has {_length(actual)} blocks, not {len(items)}")
        for item, part in zip(items, actual, strict=True):
            item(part, names, found)

    return collect


def _every(item: Collect) -> Collect:
    """A list with one record a piece; whether there are as many is judged when all are found."""

    def collect(actual: Any, names: Names, found: Found) -> None:
        if not isinstance(actual, list):
            raise UnfitReplyError("the reply has no list of blocks")
        for part in actual:
            item(part, names, found)

    return collect


def _length(actual: Any) -> str:
    return str(len(actual)) if isinstance(actual, list) else "no"
