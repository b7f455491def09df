"""Replies: the data in them, or the error that a device reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from framekit.codec.python.source import INDENT, Source
from framekit.codec.shown import explain
from framekit.definition.expression import Expression
from framekit.definition.model.frames import parts_of
from framekit.definition.model.services import AS_NUMBERS, ReplyRow
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, RecordOf, Value
from framekit.link.packing import PackingError, memory_of_numbers
from framekit.link.services.rows import Piece, RowFacts, ServiceRows, padded_names
from framekit.link.value_source import LOOKED_UP, FunctionSource
from framekit.link.values import (
    EACH,
    EVALUATION_ERRORS,
    Evaluate,
    FrameValue,
    Names,
    bare_name,
    compile_expression,
    present,
    read_layout,
)

Found = list[tuple[Any, bool]]
"""Data found in a reply, each with whether padding may follow them."""


Find = Callable[[FrameValue | None, bytes, Names], Found]
"""Finds data in a reply and the bytes that came with it. Raise UnfitReplyError and EVALUATION_ERRORS."""


ReadPieces = Callable[[FrameValue | None, bytes, FrameValue | None], list[bytes]]
"""Reads the data of pieces from a reply and the bytes that came with it; the last argument is the request."""


class UnfitReplyError(ValueError):
    """A reply does not fit its request; the message names the place."""


class ReplyRefusal(NamedTuple):
    """`outcome`: the outcome of the exchange, unless the exchange has its own."""

    code: int
    meaning: str
    outcome: str


class ErrorReader:
    """Reads refusals in replies."""

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

    def refusal(self, reply: FrameValue, names: Names) -> ReplyRefusal | None:
        """Return the refusal if the reply is an error frame. Raise EVALUATION_ERRORS."""
        if reply.frame not in self.frames:
            return None
        fields = Names(reply.complete(), names)
        if self.when is not None and not self.when(fields):
            return None
        code = 0 if self.code is None else int(self.code(fields))
        known = Names({"code": code}, fields)
        unanswered = self.unanswered is not None and bool(self.unanswered(known))
        return ReplyRefusal(code, self.meaning(code, known), "no_reply" if unanswered else "refused")

    def meaning(self, code: int, names: Names) -> str:
        """Return the name of a code, '' if the protocol has none for it, with its detail. Raise EVALUATION_ERRORS."""
        found = (table[code] for when, table in self.names if code in table and (when is None or when(names)))
        meaning, detail = str(next(found, "")), "" if self.detail is None else str(self.detail(names))
        return f"{meaning} ({detail})" if meaning and detail else meaning or detail


class ReplyReader:
    """Takes the data out of replies to one service row. Each form of the reply is one function, written when needed."""

    def __init__(self, facts: RowFacts) -> None:
        self.facts = facts
        self.shared = facts.shared
        frames = [row.frame.frame for row in facts.row.reply if row.frame is not None]
        self.error_frames = frozenset(self.shared.error_frames)
        self.expected = tuple(dict.fromkeys((*frames, *self.shared.error_frames)))
        self._finds: dict[str | None, tuple[Find, ...]] = {}

    def reader(self, frame: str | None, pieces: Sequence[Piece], names: Names) -> ReadPieces:
        """Return what reads the data of each piece from such replies, as memory has them; [] if a reply has none.

        It raises UnfitReplyError.
        """
        finds, places = self._fitting(frame), [self._place(piece) for piece in pieces]
        reads, only = self.facts.row.service == "read", places[0] if len(places) == 1 else None

        def read(reply: FrameValue | None, buffer: bytes, request: FrameValue | None) -> list[bytes]:
            problem: UnfitReplyError | None = None
            for find in finds:
                try:
                    found = find(reply, buffer, names)
                    if only is not None and len(found) == 1:
                        return [only(*found[0])]
                    if found and len(found) != len(places):
                        raise UnfitReplyError(f"the reply holds {len(found)} blocks of data, not {len(places)}")
                    if reads and not found:
                        raise UnfitReplyError("the reply brings no data")
                    return [place(data, padded) for place, (data, padded) in zip(places, found, strict=False)]
                except EVALUATION_ERRORS as error:
                    problem = problem or _unfit(error)
            if reads and reply is None and problem is None:
                raise UnfitReplyError("the reply brings no data")
            return self._nothing_found(reply, problem)

        return read

    def _place(self, piece: Piece) -> Callable[[Any, bool], bytes]:
        """Return what turns the data of a piece into memory's form. It raises UnfitReplyError and PackingError."""
        packer = self.facts.packers[piece.address.unit]
        to_memory, size = packer.reader(piece.address.start, piece.count), packer.size(piece.address.start, piece.count)

        def place(data: Any, padded: bool) -> bytes:
            if type(data) is bytes:
                return to_memory(data[:size] if padded else data)
            if type(data) is list:
                return _of_numbers(data, piece)
            raise UnfitReplyError(f"the reply has {data!r} where data should stand")

        return place

    def blocks(self, reply: FrameValue | None, buffer: bytes, names: Names) -> list[bytes]:
        """Return the data as the reply has them, for a service without places. Raise UnfitReplyError."""
        problem: UnfitReplyError | None = None
        for find in self._fitting(None if reply is None else reply.frame):
            try:
                return [data for data, _ in find(reply, buffer, names) if isinstance(data, bytes)]
            except EVALUATION_ERRORS as error:
                problem = problem or _unfit(error)
        return self._nothing_found(reply, problem)

    def _nothing_found(self, reply: FrameValue | None, problem: UnfitReplyError | None) -> list[bytes]:
        if problem is not None:
            raise problem
        if reply is None:
            return []
        raise UnfitReplyError(f"'{reply.frame}' is no reply to '{self.facts.row.name}'")

    def _fitting(self, name: str | None) -> tuple[Find, ...]:
        """Return the functions of rows for this frame, and of rows without a frame: their sequence chooses replies."""
        finds = self._finds.get(name)
        if finds is None:
            rows = [row for row in self.facts.row.reply if row.frame is None or row.frame.frame == name]
            finds = self._finds[name] = tuple(
                FindWriter(self.shared, row, self.facts.row.service in ("read", "write")).function() for row in rows
            )
        return finds


class FindWriter:
    """Writes the function that finds the data in a form of reply. `is_transfer`: `value` and `values` are data too."""

    def __init__(self, shared: ServiceRows, row: ReplyRow, is_transfer: bool) -> None:
        self.shared, self.row, self.is_transfer = shared, row, is_transfer
        given = {"present": present, "listed": listed, "read_layout": read_layout}
        self.writer = FunctionSource(shared.table, given)
        self.out = self.writer.body
        self.of_some = any(each.when is not None for each in parts_of([row.frame, row.buffer], EachOf))
        """Lists are for some of the variables each: their data are sorted by the order of the variables."""
        self.place = "len(found)"
        self._variables = 0

    def function(self) -> Find:
        """Return the function itself."""
        self.out.add("found = {}" if self.of_some else "found = []")
        if self.row.frame is not None:
            inside = Source(self.out.depth + 1)
            self._collect(self.row.frame, "reply", False, inside)
            if inside.lines:
                self.out.add("if reply is not None:")
                self.out.lines.extend(inside.lines)
        if self.row.buffer is not None:
            self._collect(self.row.buffer, "buffer", False, self.out)
        self.out.add("return [found[place] for place in sorted(found)]" if self.of_some else "return found")
        find: Find = self.writer.load("reply", "buffer", "names")
        return find

    def _collect(self, value: Value, actual: str, padded: bool, out: Source) -> None:
        match value:
            case Expression():
                name = bare_name(value)
                if name == "data" or (self.is_transfer and name in AS_NUMBERS):
                    pair = f"({f'[{actual}]' if name == 'value' else actual}, {padded and name == 'data'})"
                    out.add(f"found[{self.place}] = {pair}" if self.of_some else f"found.append({pair})")
            case FrameOf(frame=frame, fields=fields):
                padding = padded_names(self.shared.protocol.frames[frame].segments)
                self._fields(fields, actual, padding, actual == "reply", out)
            case RecordOf(fields=fields):
                self._fields(fields, actual, frozenset(), False, out)
            case LayoutOf(layout=layout, fields=fields):
                inside, record = Source(out.depth), self._variable()
                padding = padded_names(self.shared.protocol.layouts[layout].segments)
                self._fields(fields, record, padding, False, inside)
                if inside.lines:
                    decode = f"{self.writer.values.layout(layout)}[1]"
                    out.add(f"{record} = read_layout({decode}, {actual}, names)")
                    out.lines.extend(inside.lines)
            case ListOf(items=items):
                parts = [self._variable() for _ in items]
                inside = Source(out.depth)
                for item, part in zip(items, parts, strict=True):
                    self._collect(item, part, False, inside)
                if inside.lines:
                    out.add(f"{''.join(f'{part}, ' for part in parts)}= listed({actual}, {len(items)})")
                    out.lines.extend(inside.lines)
            case EachOf(fields=fields, when=when):
                part, inside = self._variable(), Source(out.depth + 1)
                if when is None:
                    header = f"for {part} in listed({actual}, None):"
                else:
                    places, self.place = self._variable(), self._variable()
                    holds = self.writer.values.value(when, LOOKED_UP)
                    known = f"[(place, Names(one, names)) for place, one in enumerate(names[{EACH!r}])]"
                    out.add(f"{places} = [place for place, names in {known} if {holds}]")
                    header = f"for {self.place}, {part} in zip({places}, listed({actual}, len({places}))):"
                self._fields(fields, part, frozenset(), False, inside)
                self.place = "len(found)"
                out.add(header)
                out.lines.extend(inside.lines or [INDENT * (out.depth + 1) + "pass"])

    def _fields(
        self, fields: Mapping[str, Value], actual: str, padded: frozenset[str], is_frame: bool, out: Source
    ) -> None:
        for name, value in fields.items():
            part, inside = self._variable(), Source(out.depth)
            self._collect(value, part, name in padded, inside)
            if not inside.lines:
                continue
            text = f"present({actual}, {name!r})"
            if is_frame:
                text = f"{actual}.fields[{name!r}] if {name!r} in {actual}.fields else {text}"
            out.add(f"{part} = {text}")
            out.lines.extend(inside.lines)

    def _variable(self) -> str:
        self._variables += 1
        return f"v{self._variables}"


def _of_numbers(numbers: list[Any], piece: Piece) -> bytes:
    """Return the numbers of a reply in memory's form. Raise UnfitReplyError and PackingError."""
    if len(numbers) != piece.count:
        raise UnfitReplyError(f"the reply has {len(numbers)} values, not {piece.count}")
    return memory_of_numbers(numbers, piece.address.unit, piece.address.type)


def listed(actual: Any, count: int | None) -> list[Any]:
    """Return the list if it has that many items; lists with an item a piece are counted after reading."""
    if isinstance(actual, list) and (count is None or len(actual) == count):
        return actual
    if count is None:
        raise UnfitReplyError("the reply has no list of blocks")
    raise UnfitReplyError(f"the reply has {len(actual) if isinstance(actual, list) else 'no'} blocks, not {count}")


def _unfit(error: Exception) -> UnfitReplyError:
    if isinstance(error, UnfitReplyError):
        return error
    if isinstance(error, PackingError):
        return UnfitReplyError(f"the reply does not fit the request: {error}")
    return UnfitReplyError(f"the reply cannot be read: {explain(error)}")
