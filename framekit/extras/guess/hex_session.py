"""The page of an unknown line: the rows of a recording, a few at a time, possible types of its bytes, and names for
them.

A browser requests the rows it shows; the server stores only the version of the names that it has
received.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from framekit import __version__
from framekit.definition.problems import printable
from framekit.extras.guess.draft import NamedGuess
from framekit.extras.guess.hex_table import NOISE, HexLine, HexSpan, HexTable, guessed_spans, shown_as
from framekit.extras.guess.naming import TYPES, FieldNaming, NamingError, types_of
from framekit.extras.guess.recordings import Statement
from framekit.extras.web.access import Access, Visitor
from framekit.extras.web.messages import LARGEST_MESSAGE, Actions, Message, Told, answered, plain_text, whole_number

log = logging.getLogger(__name__)

WIDTHS = (8, 16, 24, 32)
"""Widths of a line (bytes) that a browser may choose."""
MOST_LINES = 200
MOST_FIELDS = 500
MOST_DRAWN = 600
"""Largest number of lines and fields in one message, and of numbers of a course."""
LARGEST_RANGE = 64
"""Largest number of bytes examined together."""
POINTED = (1, 2, 4)
"""Sizes (bytes) of the fields examined from a single byte on."""
SHOWN = ("u", "i", "f", "t")
_NOTHING: Mapping[str, str] = {}


class HexBoard:
    """Content common to all browsers of a recording.

    `names`: None if a definition describes the bytes; then `behaviours` gives the behaviour of its fields over all
    frames, by FRAME.FIELD.
    """

    name = "Guess"
    home = "bytes.html"
    largest_message = LARGEST_MESSAGE

    def __init__(
        self, title: str, table: HexTable, statements: Sequence[Statement], names: NamedGuess | None = None,
        behaviours: Mapping[str, str] = _NOTHING,
    ) -> None:  # fmt: skip
        self.title = title
        self.behaviours = behaviours
        self.table = table
        self.statements = statements
        self.names = names
        self.round = 1
        self._lock = asyncio.Lock()

    def session(self, access: Access, who: str) -> HexSession:
        """Return a session for a browser."""
        return HexSession(self, access, who)

    async def go_on(self) -> None:
        """Return at once: a recording does not change."""

    async def give(self, naming: FieldNaming) -> None:
        """Give a name to bytes. Raises NamingError."""
        async with self._lock:
            await asyncio.to_thread(self._names().give, naming)
            self._renamed()

    async def forget(self, kind: str, offset: int) -> None:
        """Remove the name of bytes. Raises NamingError."""
        async with self._lock:
            await asyncio.to_thread(self._names().forget, kind, offset)
            self._renamed()

    def _names(self) -> NamedGuess:
        if self.names is None:
            raise NamingError("the definition says what the bytes are – without --with they can be named")
        return self.names

    def _renamed(self) -> None:
        self.table.use(guessed_spans(self._names().guess))
        self.round += 1


class HexSession:
    """The session of a browser."""

    def __init__(self, board: HexBoard, access: Access, who: str) -> None:
        self.board = board
        self.visitor = Visitor(access, who)
        self._round = 0
        self._actions: Actions = {
            "token": lambda given, told: self.visitor.give(given),
            "lines": self._lines,
            "fields": self._fields,
            "point": self._point,
            "course": self._course,
            "draft": self._draft,
            "name": self._name,
            "forget": self._forget,
        }

    @property
    def wrong_tokens(self) -> int:
        """Return the number of wrong tokens it has sent."""
        return self.visitor.wrong_tokens

    def hello(self) -> Message:
        """Return the constant content."""
        board = self.board
        path = None if board.names is None else board.names.path
        return {
            "hello": board.title,
            "version": __version__,
            "names": board.names is not None,
            "file": "" if path is None else path.name,
            "widths": WIDTHS,
            "types": {name: list(one.sizes) for name, one in TYPES.items()},
            "rows": len(board.table.rows),
            "others": len(board.table.others),
            "timed": board.table.longest_time,
            "longest": max((len(row.data) for row in board.table.rows), default=0),
            "kinds": [[kind.name, kind.side, len(kind.rows)] for kind in board.table.kinds],
            "statements": [[one.is_sure, one.text, str(one.evidence), one.against] for one in board.statements],
        }

    def news(self) -> Iterator[Message]:
        """Yield an update if the names have changed."""
        if self._round != self.board.round:
            self._round = self.board.round
            draft = None if self.board.names is None else self.board.names.draft
            yield {
                "round": self._round,
                "problems": [] if draft is None else list(draft.problems),
                "warnings": [] if draft is None else list(draft.warnings),
            }

    async def answer(self, told: Any) -> Message | None:
        """Execute a message and return the answer. Raises ValueError if it is no message of the page."""
        return await answered(self._actions, told)

    # ---- rows ---------------------------------------------------------------------------------------------

    async def _lines(self, first: Any, told: Told) -> Message:
        kind, width = told.get("kind"), whole_number(told.get("width"))
        if kind is not None and (type(kind) is not int or not NOISE <= kind < len(self.board.table.kinds)):
            raise ValueError("this is no message")
        if width not in WIDTHS:
            raise ValueError("this is no message")
        begin, most = whole_number(first), min(MOST_LINES, whole_number(told.get("most")))
        return await asyncio.to_thread(self._lines_from, kind, width, begin, most)

    def _lines_from(self, kind: int | None, width: int, first: int, most: int) -> Message:
        table, number = self.board.table, self.board.round
        found = [self._line(line, width) for line in table.lines(kind, width, first, most)]
        return {
            "lines": first, "kind": kind, "width": width, "of": table.count(kind, width), "round": number,
            "list": found,
        }  # fmt: skip

    def _line(self, line: HexLine, width: int) -> list[Any]:
        """Return number of the row, first byte, time, pause before it, direction, kind, size, bytes, fields, fault."""
        table = self.board.table
        row = table.rows[line.row]
        end = line.offset + width
        spans = [
            [max(span.offset, line.offset), min(span.offset + span.size, end), span.shade, span.name, span.offset]
            for span in table.spans(line.row)
            if span.offset < end and span.offset + span.size > line.offset
        ]
        time = pause = ""
        if row.time is not None and not line.offset:
            time = f"{table.seconds(row):.3f}"
            before = table.rows[line.row - 1].time if line.row else None
            pause = "" if before is None else f"{(row.time - before) / 1e6:.0f}"
        data = row.data[line.offset : end].hex()
        return [
            line.row,
            line.offset,
            time,
            pause,
            self._way(line.row),
            row.kind,
            len(row.data),
            data,
            spans,
            row.fault,
        ]

    def _way(self, number: int) -> str:
        row = self.board.table.rows[number]
        if row.direction or row.kind == NOISE:
            return row.direction
        return {"client": "out", "server": "in"}.get(self.board.table.kinds[row.kind].side, "")

    def _fields(self, kind: Any, told: Told) -> Message:
        """Return the fields of a kind, from its first frame."""
        number = whole_number(kind)
        table = self.board.table
        if number >= len(table.kinds) or not table.kinds[number].rows:
            raise ValueError("this is no message")
        row = table.kinds[number].rows[0]
        name, known = table.kinds[number].frame, self.board.behaviours
        spans = table.spans(row)[:MOST_FIELDS]
        rows = [[*span[:4], known.get(f"{name}.{span.name}", span.about)] for span in spans]
        return {"fields": number, "row": row, "list": rows}

    # ---- values -------------------------------------------------------------------------------------------

    def _range(self, row: Any, told: Told) -> tuple[int, int, int]:
        """Return the range of bytes of a row that a message names. Raises ValueError."""
        number, first, size = whole_number(row), whole_number(told.get("first")), whole_number(told.get("size"))
        table = self.board.table
        if number >= len(table.rows) or not 1 <= size <= LARGEST_RANGE or first + size > len(table.rows[number].data):
            raise ValueError("this is no message")
        return number, first, size

    async def _point(self, row: Any, told: Told) -> Message:
        """Return the known fields of these bytes, and their value as each type; for a single byte also together with
        the bytes after it.
        """
        number, first, size = self._range(row, told)
        table, data = self.board.table, self.board.table.rows[number].data
        sizes = [one for one in POINTED if first + one <= len(data)] if size == 1 else [size]
        types = []
        for one in sizes:
            values = await asyncio.to_thread(table.values, number, first, one)
            here = data[first : first + one]
            types += [
                [one, value.type, value.order, shown_as(value.type, value.order, here), *value[2:]]
                for value in values.types
                if size > 1 or value.type[0] in SHOWN
            ]
        values = await asyncio.to_thread(table.values, number, first, size)
        covered = [one for one in table.spans(number) if one.offset < first + size and first < one.offset + one.size]
        span = covered[0] if len(covered) == 1 else None
        kind = table.rows[number].kind
        return {
            "point": number, "first": first, "size": size, "kind": kind, "bytes": data[first : first + size].hex(),
            "field": None if span is None else [*span, *self._guessed(kind, span)],
            "covers": [one.name for one in covered],
            "fault": table.rows[number].fault, "frames": values.frames, "different": values.different, "types": types,
        }  # fmt: skip

    def _guessed(self, kind: int, span: HexSpan) -> tuple[str, str, bool]:
        """Return the evidence of a field, its given type with the order, and whether its size varies."""
        names = self.board.names
        fields = () if names is None or kind == NOISE else names.guess.kinds[kind].fields
        field = next((one for one in fields if one.name == span.name), None)
        if field is None:
            return "", "", False
        evidence = str(field.evidence) if field.evidence.of else ""
        return evidence, f"{field.wire} {field.order}" if field.wire else "", not field.size

    def _course(self, row: Any, told: Told) -> Message:
        """Return the numbers at these bytes in the frames of the kind, in order."""
        number, first, size = self._range(row, told)
        type_, order = plain_text(told.get("type")), plain_text(told.get("order"))
        data = self.board.table.rows[number].data[first : first + size]
        if (type_, order) not in types_of([data]):
            raise ValueError("this is no message")
        found = self.board.table.course(number, first, size, type_, order, MOST_DRAWN)
        return {
            "course": number, "first": first, "size": size, "type": type_, "order": order,
            "times": [time for time, _ in found], "numbers": [value for _, value in found],
        }  # fmt: skip

    # ---- names --------------------------------------------------------------------------------------------

    def _draft(self, wanted: Any, told: Told) -> Message:
        """Return the present definition."""
        names = self.board.names
        return {"draft": "" if names is None else names.draft.text, "file": "" if names is None else names.draft.name}

    async def _name(self, name: Any, told: Told) -> Message:
        """Give a name and a type to bytes. `size` 0: data of varying size."""
        kind, type_, order = (plain_text(told.get(key)) for key in ("kind", "type", "order"))
        first, size = (whole_number(told.get(key)) for key in ("first", "size"))
        naming = FieldNaming(kind, first, size, plain_text(name), type_, order)
        where = f"byte {naming.offset} of {naming.kind}, {naming.size} in all"
        return await self._tried(told, lambda: self.board.give(naming), f"{naming.name!r} for {where}")

    async def _forget(self, kind: Any, told: Told) -> Message:
        """Remove the name of a field."""
        name, first = plain_text(kind), whole_number(told.get("first"))
        return await self._tried(told, lambda: self.board.forget(name, first), f"no name for byte {first} of {name}")

    async def _tried(self, told: Told, action: Any, what: str) -> Message:
        """Execute an action if the visitor may; return whether it was done, or why not."""
        answer: Message = {"done": whole_number(told.get("id"))}
        why = self.visitor.refused()
        if why:
            return {**answer, "why": why}
        try:
            await action()
        except NamingError as error:
            log.warning("web: refused to %s: %s", self.visitor.who, printable(str(error)))
            return {**answer, "why": str(error)}
        log.info("web: %s, by %s", printable(what), self.visitor.who)
        return answer
