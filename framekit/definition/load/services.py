"""Read services, addresses, errors, refusals of a server, and command blocks. Guide: areas, services, serving."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from itertools import pairwise

from framekit.definition.expression import Expression
from framekit.definition.keys import read_keys, read_part
from framekit.definition.load.procedure import ValueLoader
from framekit.definition.load.reader import Reader
from framekit.definition.model.services import (
    BASES,
    UNIT_BITS,
    AddressForm,
    BlockWork,
    CommandRules,
    Errors,
    FormPart,
    Literally,
    Maybe,
    PlaceOf,
    ServiceRow,
    word,
)
from framekit.definition.nodes import Entry, Mapping, Node, Scalar
from framekit.definition.problems import Position, did_you_mean
from framekit.definition.tree import words_in

UNIT_WORDS = (*UNIT_BITS, "own")


class ServiceLoader:
    """Reads the sections `services`, `errors`, `server` and `commands`, by the tables of their classes."""

    def __init__(self, values: ValueLoader) -> None:
        self.values = values
        self.space = values.space
        self.reader: Reader = values.reader
        self.spoilt = False
        self.partly: list[tuple[ServiceRow, frozenset[str]]] = []
        """Rows with errors without their broken keys, each with the words that may be names of its own."""

    def rows(self, entry: Entry) -> tuple[ServiceRow, ...]:
        """Return the rows of one service. Broken rows are noted and left out; their good keys go to `partly`."""
        found, service = [], entry.key.text
        for number, item in enumerate(self._items(entry), start=1):
            with self.reader.going_on():
                keys = self.reader.mapping(item)
                known = {"at": keys.at, "service": service, "name": f"{service} {number}"}
                self.spoilt = False
                row = ServiceRow(**read_keys(ServiceRow, self, keys, self._spoil, **known))
                if not self.spoilt:
                    found.append(row)
                else:
                    given = (words_in(one.value) for one in keys.entries if one.key.text not in ("request", "when"))
                    self.partly.append((row, frozenset().union(*given)))
        return tuple(found)

    def _spoil(self) -> None:
        self.spoilt = True

    def _items(self, entry: Entry) -> Iterator[Node]:
        """Yield the items of a list of rows; `{rows: application}` stands for the application's rows of the service."""
        for item in self.reader.items(entry.value):
            if not isinstance(item, Mapping) or "rows" not in item:
                yield item
                continue
            inherited = self.space.of_application("services", entry.key.text)
            if len(self.reader.entries(item)) > 1 or inherited is None or inherited.entry is entry:
                what = f"there are no rows of '{entry.key.text}' to take from an application"
                self.reader.note(item.at, what, "leave rows out")
                continue
            yield from self.reader.items(inherited.entry.value)

    def place(self, node: Node) -> PlaceOf:
        """Read a place: areas, units and the name of an item are bare words; everything else is a value."""
        found, areas = {}, self.space.section("areas")
        for entry in self.reader.entries(node):
            key, value = entry.key.text, entry.value
            words = UNIT_WORDS if key == "unit" else areas if key == "area" else ()
            is_word = isinstance(value, Scalar) and (key == "as" or value.text in words)
            found[key] = word(self.reader.scalar(value)) if is_word else self.values.value(value)
        return found

    def block(self, node: Node) -> BlockWork:
        """Return the exchange that a request causes on the other side. Raises Broken."""
        reader, keys = self.reader, self.reader.mapping(node)
        for one, other in pairwise([key for key in ("read", "write", "call") if key in keys]):
            at = keys.get(other)
            reader.note(node.at if at is None else at.at, f"a block has {one} and {other}", "leave one of them out")
        for kind, own in (("read", "into"), ("write", "from")):
            moved = keys.get(kind)
            data = isinstance(moved, Mapping) and "data" in moved
            if moved is not None and not data and not {own, "then"} & {*keys.keys()}:
                reader.note(node.at, f"a block has {kind}, but no {own}", f"add {own}: with a place of the own memory")
            if own in keys and not {kind, "call", "inspect"} & {*keys.keys()}:
                reader.note(node.at, f"a block has {own}, but no {kind}", f"add {kind}: with a place of the other side")
        return read_part(BlockWork, self, keys)

    def rules(self, node: Node) -> CommandRules:
        """Return the section `commands` of an application. Raises Broken."""
        reader, keys, frames = self.reader, self.reader.mapping(node), self.values.frames.outlines
        frame = keys.get("frame")
        if frame is not None and (name := reader.text(frame)) not in frames:
            raise reader.broken(frame.at, f"there is no frame '{name}'", did_you_mean(name, frames))
        missing = [name for name in ("frame", "request", "status", "failed") if name not in keys]
        if missing:
            raise reader.broken(keys.at, f"commands: has no {', '.join(missing)}", "add it")
        return read_part(CommandRules, self, keys)

    def errors(self, node: Node) -> Errors:
        """Read the section `errors`. Raises Broken."""
        for frame in self.reader.items(self.reader.mapping(node).get("frame")):
            if not self.values.frames.members(self.reader.text(frame)):
                raise self.reader.unknown(frame.at, "frame", self.reader.text(frame), list(self.values.frames.outlines))
        return read_part(Errors, self, node)


_WIDTH = re.compile(r"(?:(?P<least>\w+)-)?(?P<most>\w+)")


def load_address_forms(
    reader: Reader, node: Node | None, areas: Collection[str], tables: Collection[str]
) -> tuple[AddressForm, ...]:
    """Return the forms of an `addresses` section; broken forms are noted and left out."""
    found = []
    for item in reader.items(node):
        with reader.going_on():
            found.append(_form(reader, reader.mapping(item), areas, tables))
    return tuple(found)


def _form(reader: Reader, keys: Mapping, areas: Collection[str], tables: Collection[str]) -> AddressForm:
    form = reader.scalar(keys.get("form"))
    area, unit = keys.get("area"), reader.maybe(reader.text, keys.get("unit"))
    parts = _Parts(reader, form).whole()
    if unit is not None and unit in tables and unit not in UNIT_BITS:
        unit, table = None, unit
    else:
        table = None
    named = ("form", "area", "unit", "type", "counts", "wire", "case", "range", "doc")
    return AddressForm(
        text=form.text,
        parts=parts,
        area=None if area is None else _area(reader, reader.scalar(area), areas),
        unit=unit,
        units_table=table,
        results=reader.by_name((entry for entry in keys.read_all() if entry.key.text not in named), reader.expression),
        wire=reader.flag(keys.get("wire")),
        at=keys.at,
        type=reader.maybe(reader.text, keys.get("type")),
        any_case=keys.get("case") is not None,
        counts=reader.maybe(reader.text, keys.get("counts")),
        ranges=reader.by_name(reader.entries(keys.get("range")), reader.range),
    )


def _area(reader: Reader, scalar: Scalar, areas: Collection[str]) -> Expression | str:
    return scalar.text if scalar.text in areas else reader.expression(scalar)


MOST_OPTIONAL = 4
"""Largest number of optional parts of a form: each doubles the ways to read an address."""


class _Parts:
    """Cuts the text of a form into literal text, parts in braces and optional text in brackets."""

    def __init__(self, reader: Reader, form: Scalar) -> None:
        self.reader = reader
        self.text = form.text
        self.at = form.at
        self.place = 0

    def whole(self) -> tuple[Literally | FormPart | Maybe, ...]:
        parts = self._until("")
        optional = sum(isinstance(part, Maybe) for part in parts)
        if optional > MOST_OPTIONAL:
            todo = "write several forms"
            raise self._error(f"it has {optional} optional parts, {MOST_OPTIONAL} are possible", todo)
        return parts

    def _until(self, end: str) -> tuple[Literally | FormPart | Maybe, ...]:
        parts: list[Literally | FormPart | Maybe] = []
        literal = ""
        while self.place < len(self.text):
            sign = self.text[self.place]
            if sign == end:
                break
            if self.text.startswith(("[[", "]]", "{{", "}}"), self.place):
                literal, self.place = literal + sign, self.place + 2
                continue
            if sign in "{[":
                parts, literal = [*parts, Literally(literal)] if literal else parts, ""
                parts.append(self._part() if sign == "{" else self._maybe(end))
                continue
            literal, self.place = literal + sign, self.place + 1
        if end and self.place >= len(self.text):
            raise self._error(f"'{end}' is missing")
        return tuple([*parts, Literally(literal)] if literal else parts)

    def _maybe(self, end: str) -> Maybe:
        if end:
            raise self._error("an optional part cannot hold another one")
        self.place += 1
        parts = self._until("]")
        self.place += 1
        return Maybe(tuple(part for part in parts if not isinstance(part, Maybe)))

    def _part(self) -> FormPart:
        close = self.text.find("}", self.place)
        if close < 0:
            raise self._error("'}' is missing")
        words = self.text[self.place + 1 : close].split(":")
        self.place = close + 1
        name = words[0].strip()
        if len(words) == 1:
            if name in ("area", "unit"):
                return FormPart("area" if name == "area" else "unit", name)
            return FormPart("column", name.partition(".")[2]) if name.startswith("area.") else FormPart("word", name)
        base = words[1].strip()
        if not re.fullmatch(r"[A-Za-z_]\w*", base):
            raise self._error(f"'{base}' is not a kind of number", "write dec, hex, oct, or a column of the areas")
        least, most = self._width(words[2] if len(words) > 2 else "")
        return FormPart("number", name, BASES.get(base, base), least, most)

    def _width(self, text: str) -> tuple[int | str | None, int | str | None]:
        if not text:
            return None, None
        match = _WIDTH.fullmatch(text.strip())
        if match is None:
            raise self._error(f"'{text}' is not a number of places", "write 4, 1-3, or a column of the areas")
        most = _places(match["most"])
        return (most if match["least"] is None else _places(match["least"])), most

    def _error(self, what: str, todo: str = "") -> Exception:
        at = Position(self.at.file, self.at.line, self.at.column)
        return self.reader.broken(at, f'in the form "{self.text}": {what}', todo)


def _places(text: str) -> int | str:
    return int(text) if text.isdigit() else text
