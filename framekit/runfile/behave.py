"""Reads how the memory of a simulated device behaves: `behave:`, by address, each of a kind of `run/behaviours.py`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

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
    Unary,
    walk,
)
from framekit.definition.keys import read_part
from framekit.definition.load.documents import without_effect
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Entry, Mapping, Scalar, unread
from framekit.definition.nodes import Node as YamlNode
from framekit.definition.problems import Position, did_you_mean, parted
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.run.behaviours import BEHAVIOURS, Behaviour
from framekit.run.model import Point
from framekit.run.points import unscaled
from framekit.runfile import replay as replay  # it brings a kind
from framekit.runfile.points import PointsLoader

_OF_THE_PLACE = ("type", "order", "scale", "offset")
"""Keys that say what stands at an address, as those of a point do."""
_OPERATORS = (Number, Name, Unary, Binary, Compare, Logic, Conditional)
_FUNCTIONS = ("min", "max", "abs", "bit")


class BehaveLoader:
    """Reads the behaviours of a device whose memory has these addresses. Problems are noted."""

    def __init__(self, reader: Reader, folder: Path, grammar: AddressGrammar) -> None:
        self.reader, self.folder, self.grammar = reader, folder, grammar
        self._points = PointsLoader(reader, folder, grammar, {}, ())
        self._at: dict[tuple[str, int], Point] = {}
        """The place that each bit of memory belongs to, as area and number of the bit."""
        self._named: dict[str, Point] = {}
        self._names: dict[str, Point] = {}

    def load(self, node: YamlNode | None) -> tuple[Behaviour, ...]:
        """The behaviours in the order in which they are worked out; what is broken is left out."""
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
        """Where it stands, and what it is there. Raises Broken."""
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
        """Notes start values of the memory that are never seen: all of their places behave from the start on."""
        at_once = {id(one.place) for one in found if one.first is not None or not (one.after or one.goes_on)}
        for entry in self.reader.entries(node):
            try:
                address = self.grammar.parse(entry.key.text)
            except AddressError:
                continue  # that has been told
            end = address.first_bit + address.unit_bits * max(1, len(self.reader.items(entry.value)))
            if all(id(self._at.get((address.area, bit))) in at_once for bit in range(address.first_bit, end)):
                what = f"'{entry.key.text}' has no effect: its value is that of behave: from the start on"
                self.reader.note(entry.key.at, what, "remove one of them")

    # ---- formulas -----------------------------------------------------------------------------------------

    def formula(self, node: YamlNode) -> Expression:
        """An expression over names and addresses, these bare or in quotes. Raises Broken after all was looked at."""
        expression, broken = self.reader.expression(node, quoted_names=True), False
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
        """Notes what a name or an address of an expression reads. Raises Broken."""
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
        there = self._at.get((address.area, address.first_bit))
        if there is None or not _is_at(there, address):
            there = self._points.own_point(Scalar(text, part.at), ())
            self._check_no_part_behaves(part, there)
        if there.form.bounds is None:
            raise self.reader.broken(part.at, f"{text} holds text", "name a number")
        self._names[text] = there

    def _check_no_part_behaves(self, part: Name, there: Point) -> None:
        """A piece of a longer number is not a number of its own. Raises Broken."""
        area, first = there.place.address.area, there.place.address.first_bit
        for bit in range(first, first + there.bits):
            other = self._at.get((area, bit))
            if other is None:
                continue
            begin = other.place.address.first_bit
            if begin < first or begin + other.bits > first + there.bits:
                what = f"{part.name} holds a piece of {other.address} ({other.form.type}), which behaves"
                raise self.reader.broken(part.at, what, f"use '{other.address}'")

    # ---- one behaviour ------------------------------------------------------------------------------------

    def _behaviour(self, keys: Mapping, point: Point) -> Behaviour:
        reader = self.reader
        words = [word for word in BEHAVIOURS if word in keys]
        if len(words) != 1:
            raise Broken("the schema has told that this is no behaviour")
        self._names = {}
        behaviour = read_part(BEHAVIOURS[words[0]], self, keys, place=point)
        behaviour = replace(behaviour, names=self._names)
        reader.problems.extend(without_effect(entry, f"in a {words[0]}") for _, entry in unread(keys))
        for key, why in behaviour.useless():
            reader.note(_at(keys, key), f"'{key}' has no effect: {why}", "remove it")
        assert point.form.bounds is not None
        low, high = point.form.bounds
        for key, number in behaviour.numbers:
            with reader.refusing(_at(keys, key)):
                if not low <= unscaled(point, number) <= high:
                    what = f"{number:g} does not fit into {point.address} ({point.form.type})"
                    raise ValueError(f"{what} – give another number, type or scale")
        return behaviour

    # ---- order --------------------------------------------------------------------------------------------

    def _in_order(self, found: Sequence[Behaviour]) -> Iterator[Behaviour]:
        """Each behind those that it needs; circles in which nothing goes on from what it was are noted."""
        plain = {id(one.place): one for one in found if one.formula is not None and not one.goes_on}
        yield from (one for one in found if id(one.place) not in plain)
        needs = {key: set(self._needed(one)) & plain.keys() for key, one in plain.items()}
        while ready := [key for key, others in needs.items() if not others & needs.keys()]:
            for key in ready:
                del needs[key]
                yield plain[key]
        for others in needs.values():
            others &= needs.keys()
        while needs:
            circle = [next(iter(needs))]
            while (following := next(iter(needs[circle[-1]]))) not in circle:
                circle.append(following)
            circle = circle[circle.index(following) :]
            for key in _leading_to(set(circle), needs):
                needs.pop(key)
            members = [plain[key] for key in circle]
            first = min(members, key=lambda one: (one.at.line, one.at.column))
            texts = [one.name or one.place.address for one in (*members, members[0])]
            what = f"a circle: {', which goes by '.join(texts).replace(', which', '', 1)}"
            assert first.formula is not None
            self.reader.note(first.formula.at, what, "give one of them lag:, or take it out of the expression")

    def _needed(self, behaviour: Behaviour) -> Iterator[int]:
        """The places that behave where its expression looks."""
        for point in behaviour.names.values():
            address = point.place.address
            for bit in range(address.first_bit, address.first_bit + point.bits):
                if (there := self._at.get((address.area, bit))) is not None:
                    yield id(there)


def _is_at(place: Point, address: Address) -> bool:
    """Whether an address names this place: it begins there, and counts in its unit or is as long."""
    own = place.place.address
    return own.first_bit == address.first_bit and (own.unit == address.unit or place.bits == address.unit_bits)


def _leading_to(circle: set[int], needs: dict[int, set[int]]) -> set[int]:
    """A circle, and all that need something of it."""
    size = 0
    while size < len(circle):
        size = len(circle)
        circle |= {key for key, others in needs.items() if others & circle}
    return circle


def _at(keys: Mapping, key: str) -> Position:
    node = keys.value(key)
    return keys.at if node is None else node.at
