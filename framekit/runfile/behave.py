"""Read `behave:`, the behaviour of memory addresses of a simulated device; `run/behaviours.py` has the kinds.

This module adds the kind `replay`. It reads values that a sink stored: a `csv` table in both forms, `jsonl`, or the
database of `sqlite`. The output of `framekit history --csv` has this form too. Values that were not good are left
out.
"""

from __future__ import annotations

import csv
import json
import sqlite3
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from operator import itemgetter
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from framekit.definition.expression import (
    Binary,
    Call,
    Compare,
    Conditional,
    Expression,
    Logic,
    Name,
    Node,
    Number,
    Real,
    Unary,
    walk,
)
from framekit.definition.keys import Form, KeyReading, key, keys, read_part, ref, words
from framekit.definition.load.documents import without_effect
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Entry, Mapping, Scalar, unread
from framekit.definition.nodes import Node as YamlNode
from framekit.definition.problems import Position, did_you_mean, parted
from framekit.definition.sources import INSIDE, leaves_folder
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.run.behaviours import BEHAVIOURS, Behaviour, BehaviourMoment
from framekit.run.model import Point
from framekit.run.points import unscaled
from framekit.runfile.points import PointsLoader
from framekit.sinks.sqlite import HistoryError, read_history

_OF_THE_PLACE = ("type", "order", "scale", "offset", "unit")
"""Keys that describe the value at an address, with the same meaning as in a point."""
_OPERATORS = (Number, Real, Name, Unary, Binary, Compare, Logic, Conditional)
_FUNCTIONS = ("min", "max", "abs", "bit")


class BehaveLoader:
    """Reads the behaviours of a device, given the address grammar of its memory. Problems are noted."""

    def __init__(self, reader: Reader, folder: Path, grammar: AddressGrammar) -> None:
        self.reader, self.folder, self.grammar = reader, folder, grammar
        self._points = PointsLoader(reader, folder, grammar, {}, ())
        self._at: dict[tuple[str, int], Point] = {}
        """The place that owns each bit of memory, by area and number of the bit."""
        self._named: dict[str, Point] = {}
        self._names: dict[str, Point] = {}

    def load(self, node: YamlNode | None) -> tuple[Behaviour, ...]:
        """Return the behaviours in the order of their evaluation; invalid entries are left out."""
        places = []
        for entry in self.reader.entries(node):
            with self.reader.going_on():
                places.append((entry, self._place(entry)))
        found = []
        for entry, point in places:
            with self.reader.going_on():
                found.append(self._behaviour(self.reader.mapping(entry.value), point))
        return tuple(self._in_order(found))

    # ---- places -------------------------------------------------------------------------------------------

    def _place(self, entry: Entry) -> Point:
        """Return the place of a behaviour and the form of its value; register its bits and its name. Raise Broken."""
        reader, keys = self.reader, self.reader.mapping(entry.value)
        point = self._points.own_point(entry.key, [one for one in keys.entries if one.key.text in _OF_THE_PLACE])
        if point.form.bounds is None:
            raise reader.broken(entry.key.at, f"{entry.key.text} holds text, which does not move", "name a number")
        area, first = point.place.address.area, point.place.address.first_bit
        for bit in range(first, first + point.bits):
            other = self._at.setdefault((area, bit), point)
            if other is not point:
                what = f"{entry.key.text} lies where {other.address} behaves"
                raise reader.broken(entry.key.at, what, "let one of them behave")
        name = keys.get("name")
        if name is not None:
            text = reader.text(name)
            if text in self._named:
                raise reader.broken(name.at, f"'{text}' is the name of another one", "name it otherwise")
            if self._is_address(text):
                raise reader.broken(name.at, f"'{text}' is an address", "name it otherwise")
            self._named[text] = point
        return point

    def _is_address(self, text: str) -> bool:
        try:
            self.grammar.parse(text, check=False)
        except AddressError:
            return False
        return True

    def check_start_values(self, node: YamlNode | None, found: Sequence[Behaviour]) -> None:
        """Note start values without effect: those whose place has the value of a behaviour from the start."""
        at_once = {id(one.place) for one in found if one.first is not None or not (one.after or one.goes_on)}
        for entry in self.reader.entries(node):
            try:
                address = self.grammar.parse(entry.key.text)
            except AddressError:
                continue  # already reported
            end = address.first_bit + address.unit_bits * max(1, len(self.reader.items(entry.value)))
            if all(id(self._at.get((address.area, bit))) in at_once for bit in range(address.first_bit, end)):
                what = f"'{entry.key.text}' has no effect: its value is that of behave: from the start on"
                self.reader.note(entry.key.at, what, "remove one of them")

    # ---- formulas -----------------------------------------------------------------------------------------

    def formula(self, node: YamlNode) -> Expression:
        """Return an expression over names and addresses, bare or quoted. Check all parts before raising Broken."""
        expression, broken = self.reader.expression(node, of_places=True), False
        for part in walk(expression.root):
            with self.reader.going_on():
                if not self._has_a_place(part):
                    what = f'in the expression "{expression}": only numbers have a place here'
                    raise self.reader.broken(part.at, what, "use names, addresses, operators, min, max, abs and bit")
                if isinstance(part, Name):
                    self._read(part)
                continue
            broken = True
        if broken:
            raise Broken(expression.text)
        return expression

    @staticmethod
    def _has_a_place(part: Node) -> bool:
        if isinstance(part, Call):
            return part.function in _FUNCTIONS
        return isinstance(part, _OPERATORS) and not (isinstance(part, Number) and part.is_time)

    def _read(self, part: Name) -> None:
        """Register the place that a name or an address of an expression reads. Raise Broken."""
        text = part.name
        if text in self._named:
            self._names[text] = self._named[text]
            return
        try:
            address = self.grammar.parse(text)
        except AddressError as error:
            what, todo = parted(error)
            known = did_you_mean(text, self._named)
            raise self.reader.broken(part.at, what, known if known.startswith("did you mean") else todo) from None
        owner = self._at.get((address.area, address.first_bit))
        if owner is None or not _is_at(owner, address):
            owner = self._points.own_point(Scalar(text, part.at), ())
            self._check_no_part_behaves(part, owner)
        if owner.form.bounds is None:
            raise self.reader.broken(part.at, f"{text} holds text", "name a number")
        self._names[text] = owner

    def _check_no_part_behaves(self, part: Name, there: Point) -> None:
        """Raise Broken if a place covers only a part of a longer number that behaves."""
        area, first = there.place.address.area, there.place.address.first_bit
        for bit in range(first, first + there.bits):
            other = self._at.get((area, bit))
            if other is None:
                continue
            begin = other.place.address.first_bit
            if begin < first or begin + other.bits > first + there.bits:
                what = f"{part.name} holds a piece of {other.address} ({other.form.type}), which behaves"
                raise self.reader.broken(part.at, what, f"use '{other.address}'")

    # ---- single behaviours ----------------------------------------------------------------------------------

    def _behaviour(self, keys: Mapping, point: Point) -> Behaviour:
        reader = self.reader
        words = [word for word in BEHAVIOURS if word in keys]
        if len(words) != 1:
            raise Broken("the schema has told that this is no behaviour")
        self._names = {}
        behaviour = read_part(BEHAVIOURS[words[0]], self, keys, place=point)
        behaviour = replace(behaviour, names=self._names)
        reader.problems.extend(without_effect(entry, f"in a {words[0]}") for _, entry in unread(keys))
        for name, why in behaviour.useless():
            reader.note(_at(keys, name), f"'{name}' has no effect: {why}", "remove it")
        assert point.form.bounds is not None
        low, high = point.form.bounds
        for name, number in behaviour.numbers:
            with reader.refusing(_at(keys, name)):
                if not low <= unscaled(point, number) <= high:
                    what = f"{number:g} does not fit into {point.address} ({point.form.type})"
                    raise ValueError(f"{what} – give another number, type or scale")
        return behaviour

    # ---- order --------------------------------------------------------------------------------------------

    def _in_order(self, found: Sequence[Behaviour]) -> Iterator[Behaviour]:
        """Yield each behaviour after those it depends on.

        Note circular dependencies without a value of the previous step.
        """
        plain = {id(one.place): one for one in found if one.formula is not None and not one.goes_on}
        yield from (one for one in found if id(one.place) not in plain)
        needs = {own: set(self._needed(one)) & plain.keys() for own, one in plain.items()}
        while ready := [own for own, others in needs.items() if not others & needs.keys()]:
            for own in ready:
                del needs[own]
                yield plain[own]
        for others in needs.values():
            others &= needs.keys()
        while needs:
            circle = [next(iter(needs))]
            while (following := next(iter(needs[circle[-1]]))) not in circle:
                circle.append(following)
            circle = circle[circle.index(following) :]
            for own in _leading_to(set(circle), needs):
                needs.pop(own)
            members = [plain[own] for own in circle]
            first = min(members, key=lambda one: (one.at.line, one.at.column))
            texts = [one.name or one.place.address for one in (*members, members[0])]
            what = f"a circle: {', which goes by '.join(texts).replace(', which', '', 1)}"
            assert first.formula is not None
            self.reader.note(first.formula.at, what, "give one of them lag:, or take it out of the expression")

    def _needed(self, behaviour: Behaviour) -> Iterator[int]:
        """Yield the keys of the places with a behaviour that an expression reads."""
        for point in behaviour.names.values():
            address = point.place.address
            for bit in range(address.first_bit, address.first_bit + point.bits):
                if (owner := self._at.get((address.area, bit))) is not None:
                    yield id(owner)


def _is_at(place: Point, address: Address) -> bool:
    """Return whether an address names this place: same first bit, and the same unit or the same length."""
    own = place.place.address
    return own.first_bit == address.first_bit and (own.unit == address.unit or place.bits == address.unit_bits)


def _leading_to(circle: set[int], needs: dict[int, set[int]]) -> set[int]:
    """Extend a circle by all behaviours that depend on it, directly or indirectly, and return it."""
    size = 0
    while size < len(circle):
        size = len(circle)
        circle |= {key for key, others in needs.items() if others & circle}
    return circle


def _at(keys: Mapping, key: str) -> Position:
    node = keys.value(key)
    return keys.at if node is None else node.at


# ---- replay: values stored by a sink appear again in a simulated device, with their original timing ------------

MOST_BYTES = 64_000_000
MOST_VALUES = 1_000_000
"""Limits of a replayed file: its size, and the number of values of the point."""
MOST_NAMES = 1000
"""Number of point names that are kept for error messages."""


class RecordedError(ValueError):
    """Raised for a file without usable values; the message contains the remedy."""


class _Value(NamedTuple):
    time: int
    value: Any


class _Wanted:
    """Selects the values of one point: the named point, else the first one in the file.

    Keeps names for error messages.
    """

    def __init__(self, point: str | None) -> None:
        self.point = point
        self.names: dict[str, None] = {}

    def __call__(self, name: str, value: Any) -> bool:
        """Return whether a value belongs to the wanted point and is good."""
        if name == self.point or len(self.names) < MOST_NAMES:
            self.names[name] = None
        return name == (next(iter(self.names)) if self.point is None else self.point) and value not in ("", None)


def recorded(path: Path, point: str | None) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return the values of a point, oldest first: times in ns since the first value, and numbers.

    `point` may be None if the file has only one point. Raise RecordedError.
    """
    wanted, found = _Wanted(point), list[_Value]()
    try:
        if path.stat().st_size > MOST_BYTES:
            raise RecordedError(f"{path.name} is larger than {MOST_BYTES // 1_000_000} MB – cut it into pieces")
        for one in _values(path, wanted):
            if len(found) == MOST_VALUES:
                raise RecordedError(f"{path.name} has more than {MOST_VALUES} values – cut it into pieces")
            found.append(one)
    except (OSError, UnicodeDecodeError, csv.Error, sqlite3.Error, HistoryError) as error:
        what = getattr(error, "strerror", None) or error
        raise RecordedError(f"{path.name} cannot be read: {what} – name a file of values") from None
    names = list(wanted.names)
    if point is None and len(names) > 1:
        raise RecordedError(f"{path.name} has several points: {', '.join(names[:12])} – say which by point:")
    if not found and point is not None and point not in names:
        raise RecordedError(f"{path.name} has no point '{point}' – {did_you_mean(point, names) or 'name another'}")
    if not found:
        raise RecordedError(f"{path.name} has no good values – name another file or point")
    numbers = sorted(((one.time, _number(one, path)) for one in found), key=itemgetter(0))
    first = numbers[0][0]
    return tuple(time - first for time, _ in numbers), tuple(value for _, value in numbers)


def _number(row: _Value, path: Path) -> float:
    if isinstance(row.value, (int, float)):
        return row.value
    text = str(row.value)
    try:
        return int(text) if text.lstrip("-").isdecimal() else float(text)
    except ValueError:
        raise RecordedError(f"{path.name} has '{row.value}', which is no number – replay another point") from None


def _values(path: Path, wanted: _Wanted) -> Iterator[_Value]:
    """Yield the good values of one point; the first bytes of the file decide its format."""
    with path.open("rb") as file:
        begin = file.read(16)
    if begin.startswith(b"SQLite format 3"):
        yield from (_Value(row.time, row.value) for row in read_history(path) if wanted(row.point, row.value))
    else:
        yield from _objects(path, wanted) if begin.lstrip().startswith(b"{") else _table(path, wanted)


def _objects(path: Path, wanted: _Wanted) -> Iterator[_Value]:
    """Yield the good values of one point in a `jsonl` file. Raise RecordedError for any other line."""
    with path.open(encoding="utf-8", newline="\n") as lines:
        for number, line in enumerate(lines, 1):
            try:
                one = json.loads(line)
                time, value = _time(one["time"]), one["value"]
                is_wanted = wanted(str(one["point"]), value)
            except (ValueError, KeyError, TypeError, RecursionError):
                what = f"{path.name}, line {number}, is no value of a point"
                raise RecordedError(f"{what} – name a file of jsonl") from None
            if is_wanted:
                yield _Value(time, value)


def _table(path: Path, wanted: _Wanted) -> Iterator[_Value]:
    """Yield the good values of one point in a table. Raise RecordedError for any other form."""
    with path.open(encoding="utf-8-sig", newline="") as lines:
        rows = csv.reader(lines)
        head = next(rows, [])
        if len(head) < 2 or head[0] != "time":
            what = f"{path.name} has no column time first"
            raise RecordedError(f"{what} – name a file of a sink, or framekit history --csv")
        columns = [] if head[1:3] == ["point", "value"] else [title.rpartition(" (")[0] or title for title in head[1:]]
        for row in rows:
            try:
                time = _time(row[0])
                cells = zip(columns, row[1:], strict=False) if columns else [(row[1], row[2])]
            except (ValueError, IndexError):
                what = f"{path.name}, line {rows.line_num}, has no time and value"
                raise RecordedError(f"{what} – name a file of a sink, or framekit history --csv") from None
            yield from (_Value(time, cell) for name, cell in cells if wanted(name, cell))


_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def _time(text: str) -> int:
    """Return nanoseconds since 1970 (UTC). Raise ValueError or TypeError."""
    moment = datetime.fromisoformat(text)
    since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - _EPOCH
    return since // timedelta(microseconds=1) * 1000


Samples = tuple[tuple[int, ...], tuple[float, ...]]
"""Times since the first value (ns), and the values."""


def _samples(reading: KeyReading) -> Samples:
    """Return the samples that `replay:` and `point:` name. Raise Broken."""
    reader, node, named = reading.reader, reading.keys.get("replay"), reading.keys.get("point")
    name = reader.text(node)
    point = None if named is None else reader.text(named)
    assert node is not None
    if leaves_folder(name, reading.loader.folder):
        raise reader.broken(node.at, f"'{name}' leaves the folder of this file", INSIDE)
    with reader.refusing(node.at):
        found = recorded(reading.loader.folder / name, point)
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayedValues(Behaviour):
    """Replay the values of a point as a sink has stored them, with the original times."""

    word: ClassVar[str] = "replay"
    samples: Samples = keys(
        {
            "replay": {**ref("text"), "description": "A file of values of a sink: csv, jsonl or sqlite."},
            "point": {**ref("text"), "description": "The point in it; it may be left out where there is one."},
        },
        _samples,
    )
    then: str = key(
        "then", Form(words("an end of a replay", "again", "stay"), lambda r, node: r.reader.text(node)),
        "What comes then: the last value stays (the default), or all again, one every after it.", default="stay",
    )  # fmt: skip

    def value(self, now: BehaviourMoment) -> float | None:
        times, values = self.samples
        time = now.time % (times[-1] + self.every) if self.then == "again" else now.time
        return values[bisect_right(times, time) - 1]

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        _, values = self.samples
        yield from (("replay", min(values)), ("replay", max(values)))


BEHAVIOURS["replay"] = ReplayedValues
