"""Corrupt good frames on purpose: give them a wrong check code or a wrong station.

The definition determines where these are; every corrupted frame is decoded again, so that the rest of it stays right.
The caller decides when and how often a frame is corrupted.
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
    """Corrupt the frames of a side.

    `scope`: the names for frames that depend on parameters. `answers`: whether the frames are those of the server. A
    size that an earlier frame has announced is found by trying. Frames with other dependencies (on an earlier request,
    for example) may not be recognized and stay whole.
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
        """Return the names of the fields that carry a station."""
        return station_fields(self.protocol)

    @cached_property
    def frames(self) -> list[str]:
        """Return the frames on the line, with frames of the other side at the end."""
        inside = self.protocol.carried
        outer = [one for one in self.protocol.frames.values() if not one.inner and one.name not in inside]
        return [frame.name for frame in sorted(outer, key=lambda frame: frame.side == self.other)]

    def name_of(self, data: bytes) -> str | None:
        """Return the name of the frame of this side that the bytes form, or None if they are not exactly one frame."""
        found = self._known(data)
        return None if found is None else found[0]

    def _known(self, data: bytes) -> tuple[str, Names] | None:
        """Return the name of the frame that the bytes form, and the names it can be decoded with."""
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
        """Return the frame with a wrong check code; None if it has no check code or is not recognized."""
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
        """Return the frame from another station with the right check code.

        None if the frame has no station that can be changed, or is not recognized.
        """
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
    """Return the data with a random byte at an offset.

    Most hex digits are replaced by hex digits, so that only the value is wrong. The data may be unchanged.
    """
    old = data[place]
    digits = b"0123456789ABCDEF"
    new = random.choice(digits) if old in digits and random.random() < 0.75 else random.randrange(256)
    return data[:place] + bytes([new]) + data[place + 1 :] if new != old else data


def _numbers(fields: Mapping[str, Any]) -> list[tuple[Any, str]]:
    """Return every number in fields and in records inside, each as its container and name."""
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
    """Return the names of the fields that carry a station: those that the definition fills with a station.

    They are determined from constructors (`{frame: {field: station}}`), assignments and `echo`; the name of a field has
    no influence.
    """
    found = {name for name, value in _filled(protocol) if isinstance(value, Expression) and _is_station(value)}
    for frame in protocol.frames.values():
        for name, expression in frame.echo.items():
            if isinstance(expression.root, Name) and expression.root.name in found:
                found.add(name)
    return frozenset(found)


def _filled(protocol: Protocol) -> Iterator[tuple[str, Any]]:
    """Yield every field of a frame that the definition sets, with its value."""
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
