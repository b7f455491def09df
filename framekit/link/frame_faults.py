"""Frames made wrong on purpose: a wrong check code, a wrong station, in the bytes of a frame that is right.

The definition says where they stand; every frame made here is read back, so that nothing else in it is wrong. When and
how often that happens is not known here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from random import Random
from typing import Any

from framekit.codec.codec import Codec
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.expression import Attribute, Expression, Name
from framekit.definition.model.frames import parts_of
from framekit.definition.model.procedure import Action, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.values import FrameOf
from framekit.link.scope import Scope
from framekit.link.values import EVALUATION_ERRORS, Names

WRONG = (FrameError, EncodeError, *EVALUATION_ERRORS)
TRIES = 64


class FrameFaults:
    """Makes frames of one side wrong. `scope`: its names, for frames that depend on parameters; `answers`: whose side.

    A size that an earlier frame has announced is found by trying. Frames that depend on more (on a request before them,
    say) may not be known again: they stay whole.
    """

    def __init__(self, protocol: Protocol, codec: Codec, scope: Scope, answers: bool) -> None:
        self.codec = codec
        self.names = Names({"request": None, "buffer": b""}, scope)
        self.announced = [
            name for name, variable in protocol.state.items() if variable.announced and variable.keys is None
        ]
        self.protocol = protocol
        self.own = scope["own"]
        self.other = "client" if answers else "server"

    @cached_property
    def stations(self) -> frozenset[str]:
        """Names of the fields that carry a station."""
        return station_fields(self.protocol)

    @cached_property
    def frames(self) -> list[str]:
        """The frames that stand on the line by themselves, those that only the other side sends last."""
        inside = self.protocol.carried
        outer = [one for one in self.protocol.frames.values() if not one.inner and one.name not in inside]
        return [frame.name for frame in sorted(outer, key=lambda frame: frame.side == self.other)]

    def name_of(self, data: bytes) -> str | None:
        """Which frame of this side these bytes are; None when they are no single one."""
        found = self._known(data)
        return None if found is None else found[0]

    def _known(self, data: bytes) -> tuple[str, Names] | None:
        """The frame that these bytes are, and the names it can be read with."""
        for names in self._possible_names(len(data)):
            for name in self.frames:
                if self._read(name, data, names) is not None:
                    return name, names
        return None

    def _possible_names(self, size: int) -> Iterator[Names]:
        yield self.names
        for name in self.announced:
            for announced in range(size + 1):
                yield Names({name: announced}, self.names)

    def wrong_check(self, data: bytes, random: Random) -> bytes | None:
        """The same frame with a check code that is wrong; None when it has none, or is no frame."""
        known = self._known(data)
        if known is None:
            return None
        name, names = known
        for _, begin, end, _ in reversed(self.codec.trace(name, data, names)[1]):
            for _ in range(TRIES if 0 < end - begin <= 8 else 0):
                wrong = _changed(data, random.randrange(begin, end), random)
                if self._fails_at(name, wrong, names, begin):
                    return wrong
        return None

    def _fails_at(self, name: str, data: bytes, names: Names, place: int) -> bool:
        try:
            self.codec.decode(name, data, names)
        except FrameError as error:
            return error.cause == "check" and error.offset == place
        except EVALUATION_ERRORS:
            return False
        return False

    def wrong_station(self, data: bytes, random: Random) -> bytes | None:
        """The same frame from another station, its check code right; None when it names none, or is no frame."""
        known = self._known(data)
        fields = None if known is None else self._read(known[0], data, known[1])
        if known is None or fields is None:
            return None
        name, names = known
        places = [(record, field) for record, field in _numbers(fields) if field in self.stations]
        places.sort(key=lambda place: place[0][place[1]] != self.own)
        for record, field in places:
            right = record[field]
            for _ in range(TRIES):
                record[field] = right ^ random.randrange(1, 32)
                try:
                    wrong = self.codec.encode(name, fields, names)
                except WRONG:
                    continue
                if wrong != data and self._read(name, wrong, names) is not None:
                    return wrong
            record[field] = right
        return None

    def _read(self, name: str, data: bytes, names: Names) -> dict[str, Any] | None:
        try:
            return self.codec.decode(name, data, names)
        except WRONG:
            return None


def _changed(data: bytes, place: int, random: Random) -> bytes:
    """One byte made another of its sort: a hex digit stays one, so that nothing but its value is wrong."""
    old = data[place]
    digits = b"0123456789ABCDEF"
    new = random.choice(digits) if old in digits and random.random() < 0.75 else random.randrange(256)
    return data[:place] + bytes([new]) + data[place + 1 :] if new != old else data


def _numbers(fields: Mapping[str, Any]) -> list[tuple[Any, str]]:
    """Every number in fields and in records inside, with what holds it."""
    found: list[tuple[Any, str]] = []
    for name, value in fields.items():
        if isinstance(value, Mapping):
            found += _numbers(value)
        elif isinstance(value, int):
            found.append((fields, name))
    return found


# ---- stations ---------------------------------------------------------------------------------------------

STATIONS = ("station", "own")


def station_fields(protocol: Protocol) -> frozenset[str]:
    """Names of the fields that carry a station: those that the definition fills with one.

    Worked out from constructors (`{frame: {field: station}}`), assignments and `echo`; no field's name means anything.
    """
    found = {name for name, value in _filled(protocol) if isinstance(value, Expression) and _is_station(value)}
    for frame in protocol.frames.values():
        for name, expression in frame.echo.items():
            if isinstance(expression.root, Name) and expression.root.name in found:
                found.add(name)
    return frozenset(found)


def _filled(protocol: Protocol) -> Iterator[tuple[str, Any]]:
    """Every field of a frame with what it is filled with."""
    procedure = (dict(protocol.sequences), dict(protocol.services), protocol.errors)
    for frame in parts_of(procedure, FrameOf):
        yield from frame.fields.items()
    actions = [action.set for action in parts_of(procedure, Action)]
    for assignments in (*actions, *(step.set for step in parts_of(procedure, Step))):
        for target, value in assignments:
            if target.field is not None:
                yield target.field, value


def _is_station(expression: Expression) -> bool:
    root = expression.root
    if isinstance(root, Attribute):
        return root.name == "station"
    return isinstance(root, Name) and root.name in STATIONS
