"""Values of a device that requests and replies of others contain: all that listening alone can show.

A request is read by the rows that would serve it, its reply by the rows that would request it; both may be inside other
frames. A value is known only from a reply or a write.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple

from framekit.definition.expression import names_in
from framekit.definition.model.frames import parts_of
from framekit.definition.model.procedure import Serve
from framekit.definition.model.protocol import Protocol
from framekit.link.addresses import Address, AddressError
from framekit.link.events import Served
from framekit.link.frame_table import ProtocolCodec
from framekit.link.packing import in_unit, numbers_of
from framekit.link.services.areas import DeviceAreas, codes_of
from framekit.link.services.matching import (
    DamagedBufferError,
    ElsewhereError,
    MatchedRow,
    Matching,
    MatchTarget,
    MismatchError,
)
from framekit.link.services.replies import ErrorReader, ReplyReader
from framekit.link.services.rows import Piece, RowFacts, rows_of
from framekit.link.values import EACH, EVALUATION_ERRORS, Evaluate, FrameValue, Names, compile_expression
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, unit_bits


class KnownValue(NamedTuple):
    """The value of one element: its station (None if no frame names it), its address as text, and the number."""

    station: Any
    address: str
    value: Any


class _OpenRequest(NamedTuple):
    """A request whose reply has not come yet."""

    facts: RowFacts
    station: Any
    reading: MatchedRow
    pieces: tuple[Piece, ...]


class Overheard:
    """Reads the frames of one line, in order. `memory`: a memory with the areas of the protocol; it is not written.

    `names`: further names that expressions read.
    """

    def __init__(self, protocol: Protocol, codec: ProtocolCodec, memory: DeviceMemory, names: Names) -> None:
        self.shared = shared = rows_of(protocol, codec)
        self._names = names
        self._errors = ErrorReader(shared)
        areas, codes = DeviceAreas(protocol, codec, memory, None), codes_of(protocol)
        self._rows: dict[str, list[Matching]] = {}
        for facts in shared.served:
            if facts.row.service in ("read", "write"):
                matching = Matching(facts, areas, codes, lambda request, reading: Served(None))
                self._rows.setdefault(matching.frame, []).append(matching)
        self._replies: dict[RowFacts, ReplyReader] = {}
        self._stations = tuple(_stations_of(protocol))
        self._asked: _OpenRequest | None = None

    @property
    def hears_nothing(self) -> bool:
        """Return whether no frame of the protocol asks for places of memory."""
        return not self._rows

    def hear(self, frame: FrameValue) -> list[KnownValue]:
        """Return the values that are known by a frame."""
        for value in frames_inside(frame):
            asked = self._request(frame, value)
            if asked is not None:
                self._asked = asked
                return []
        asked, station = self._asked, self._station(frame)
        if asked is None or (None not in (station, asked.station) and station != asked.station):
            return []
        reader = self._reader(asked.facts)
        for value in frames_inside(frame):
            if value.frame in reader.expected:
                self._asked = None
                with suppress(*EVALUATION_ERRORS):
                    return list(self._told(asked, reader, value))
        return []

    def _station(self, frame: FrameValue) -> Any:
        """Return the station that a frame names, None if it names none."""
        return next((found for one in self._stations if (found := one(frame)) is not None), None)

    def _reader(self, facts: RowFacts) -> ReplyReader:
        found = self._replies.get(facts)
        if found is None:
            found = self._replies[facts] = ReplyReader(facts)
        return found

    def _request(self, outer: FrameValue, value: FrameValue) -> _OpenRequest | None:
        """Return the request in a frame, if it is a request of a row."""
        station = self._station(outer)
        for matching in self._rows.get(value.frame, ()):
            try:
                reading = matching.read(value, b"", station, Names({"station": station}, self._names), True)
            except (MismatchError, ElsewhereError, DamagedBufferError, DeviceMemoryError, *EVALUATION_ERRORS):
                continue
            if reading is None or reading.problem is not None:
                continue
            pieces = tuple(
                Piece(
                    Address(
                        target.unit.name or "",
                        target.unit.unit,
                        target.start,
                        type=target.type,
                        shift=target.unit.shift,
                    ),
                    target.count,
                )
                for target in reading.targets
            )
            return _OpenRequest(matching.facts, station, reading, pieces)
        return None

    def _told(self, asked: _OpenRequest, reader: ReplyReader, reply: FrameValue) -> Iterator[KnownValue]:
        """Yield the values of a reply: values that were read, or that it confirms as written. Raise ValueError."""
        if self._errors.refusal(reply, Names({"request": None, "reply": reply}, self._names)) is not None:
            return
        if asked.facts.row.service == "write":
            data = [target.memory for target in asked.reading.targets]
        else:
            names = Names({EACH: [target.names for target in asked.reading.targets]}, asked.reading.names)
            data = [*reader.reader(reply.frame, asked.pieces, names)(reply, b"", None)]
        for target, memory in zip(asked.reading.targets, data, strict=True):
            if memory is not None:
                yield from self._elements(asked.station, target, memory)

    def _elements(self, station: Any, target: MatchTarget, memory: bytes) -> Iterator[KnownValue]:
        """Yield each element of a place, if its address can be written."""
        unit, start, count = target.unit.unit, target.start, target.count
        name, parts = target.unit.name, {}
        if name is None:  # the row names the memory and, in addition, the area
            name, parts = str(target.names.get("area")), dict(target.names)
        area = self.shared.protocol.areas.get(name)
        if area is None:
            return
        own, width = unit_bits(area.unit), unit_bits(unit)
        if name != target.unit.name and own > width and not (start * width % own or count * width % own):
            memory = in_unit(memory, area.order, unit, area.unit)
            unit, start, count = area.unit, start * width // own, count * width // own
        first = Address(
            name, unit, start, parts=parts, type=area.type if unit == area.unit else None, shift=target.unit.shift
        )
        for at, number in enumerate(numbers_of(memory, unit, first.type, count)):
            with suppress(AddressError):
                yield KnownValue(station, self.shared.grammar.print(self.shared.grammar.advance(first, at)), number)


def frames_inside(frame: FrameValue) -> Iterator[FrameValue]:
    """Yield a frame, and those in it."""
    yield frame
    for part in frame.fields.values():
        if type(part) is FrameValue:
            yield from frames_inside(part)


class _StationOf:
    """The station that a frame is for, as the step says that serves it."""

    def __init__(self, evaluate: Evaluate, names: frozenset[str]) -> None:
        self._evaluate, self._names = evaluate, names

    def __call__(self, frame: FrameValue) -> Any:
        try:
            return self._evaluate(Names(dict.fromkeys(self._names, frame)))
        except EVALUATION_ERRORS:
            return None


def _stations_of(protocol: Protocol) -> Iterator[_StationOf]:
    for serve in parts_of(dict(protocol.sequences), Serve):
        if serve.station is not None:
            yield _StationOf(compile_expression(serve.station), frozenset(names_in(serve.station.root)))
