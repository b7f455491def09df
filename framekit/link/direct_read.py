"""A read of one exchange that takes the short way, and the quick look at a reply that is nothing but its data.

Where there is any doubt the reply is judged as every other is. Nothing is sent from here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from framekit.link.direct import DirectRequest
from framekit.link.exchange import Exchange, Outcome
from framekit.link.packing import Packer, PackingError, reader_of, wire_reader_of
from framekit.link.same_reply import SameReply
from framekit.link.transfer import Done, TransferResult
from framekit.link.values import FrameValue

if TYPE_CHECKING:
    from framekit.link.ready import ReadyRead

FromWire = Callable[[bytes, int], tuple[int, ...]]
"""Reads the numbers of a reply, from its bytes and the place where its data begin."""
Judge = Callable[["ReadyRead", Outcome], TransferResult]


class PlainReply:
    """Where the data of one piece stand in replies that bring nothing else; `fields` has it by the reply's frame.

    `data_size`: how many bytes of data such a reply has.
    """

    __slots__ = ("_packer", "_size", "_start", "_values", "data_size", "fields", "from_wire")

    def __init__(self, fields: dict[str, str], packer: Packer, start: int, size: int, unit: str, count: int) -> None:
        self.fields = fields
        self._packer = packer
        self._start, self._size = start, size
        self._values = reader_of(unit, count)
        self.data_size = packer.size(start, size)
        self.from_wire = wire_reader_of(packer, unit, count)

    def result(self, outcome: Outcome) -> TransferResult | None:
        """What the reply brings; None when that has to be judged with care."""
        reply = outcome.reply
        field = None if reply is None else self.fields.get(reply.frame)
        if reply is None or field is None:
            return None
        found = reply.fields.get(field)
        return self.of(found, reply, outcome.raw, outcome.buffer) if type(found) is bytes else None

    def memory(self, found: bytes) -> bytes | None:
        """Data in memory's form; None for what has to be judged with care."""
        try:
            return self._packer.to_memory(found, self._start, self._size)
        except PackingError:
            return None

    def of(self, found: bytes, reply: FrameValue, raw: bytes, buffer: bytes) -> TransferResult | None:
        """What data of this reply are; None for data that have to be judged with care."""
        data = self.memory(found)
        if data is None:
            return None
        values = list(self._values(data))
        return TransferResult(True, values, data, exchanges=1, reply=reply, raw=raw, buffer=buffer)


class DirectRead:
    """One read. `follow` is told the exchange that it becomes when it cannot take the short way to its end.

    `on_data`, where somebody has set it, gets the data of a reply that was learned, in memory's form, and nothing else
    is told then.
    """

    __slots__ = ("_judge", "_on_done", "_ready", "follow", "on_data", "request")

    def __init__(self, ready: ReadyRead, request: DirectRequest, judge: Judge, on_done: Done) -> None:
        self.request = request
        self.follow: Callable[[Exchange], None] | None = None
        self.on_data: Callable[[bytes], None] | None = None
        self._ready = ready
        self._judge = judge
        self._on_done = on_done

    @property
    def from_wire(self) -> FromWire | None:
        """What reads the numbers of a reply that was learned, where they stand there as they are."""
        plain = self._ready.plain
        return None if plain is None else plain.from_wire

    def done(self, outcome: Outcome) -> None:
        """The exchange has ended, well or not."""
        plain = self._ready.plain
        result = None if plain is None or not outcome.ok else plain.result(outcome)
        self._on_done(self._judge(self._ready, outcome) if result is None else result)

    def brought(self, same: SameReply, raw: bytes) -> None:
        """The exchange has ended with the reply that it had before, whatever its data."""
        found = raw[same.start : same.end]
        data = None if self.on_data is None or self._ready.plain is None else self._ready.plain.memory(found)
        if data is not None and self.on_data is not None:
            self.on_data(data)
            return
        reply, plain = same.value(found, raw, self.request.fields), self._ready.plain
        result = None if plain is None else plain.of(found, reply, raw, b"")
        if result is None:
            result = self._judge(self._ready, Outcome(True, reply=reply, results={"reply": reply}, raw=raw))
        self._on_done(result)

    def exchange(self) -> Exchange:
        """The exchange for the long way."""
        exchange = self._ready.exchanges[0].exchange()
        exchange.on_done = self.done
        if self.follow is not None:
            self.follow(exchange)
        return exchange
