"""Read points: named, scaled values of a run, from the run file, from `NAME.points.yaml` or from a table `NAME.csv`.

A table has one point per row; its columns are the keys of a point. The schema of points also checks the table.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Collection, Iterator, Sequence, Set
from collections.abc import Mapping as MappingOf
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from framekit.definition.expression import Expression
from framekit.definition.load.documents import Documents
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.services import UNIT_BITS
from framekit.definition.nodes import Entry, Mapping, Node, Scalar
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean, is_nearly
from framekit.definition.schema import validate
from framekit.definition.sources import INSIDE, leaves_folder
from framekit.definition.times import NEVER
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.link.packing import Typed, typed_at
from framekit.link.services.rows import wants_address
from framekit.memory.views import ORDERS, VIEWS, NumberView, TextView, view_of
from framekit.run.model import POINTS_AREA, Block, Channel, OwnPlace, Point, Scaling
from framekit.run.own_memory import AnyAddresses, stored_by
from framekit.run.points import PointCall, PointRead, planned
from framekit.run.transfer import Shape, is_path, shapes_of
from framekit.run.triggers import Every
from framekit.runfile.channels import Attempts, needs_station, read_channel_number, read_station
from framekit.runfile.transfers import CallLoader, OwnPlaces, packing_of
from framekit.runfile.vendor_tables import numbered_rows

EVERY = 1_000_000_000
"""Default read period of a point on a channel (ns)."""

NOT_READ = "without a channel nothing is read"
NO_BYTES = "a result has no order of bytes"
NOT_WRITTEN = "the result of a call cannot be written"
PERIODS_TO_STALE = 3
MOST_DECIMALS = 15

SUFFIX = ".points.yaml"
TYPES = (*UNIT_BITS, *VIEWS)
_LISTS = {"enum": ";"}
"""Columns of a table that hold several items, and the separator of the items."""


class WrittenPoints(NamedTuple):
    """The points of a file as written, and the problems of the file."""

    entries: tuple[Entry, ...]
    problems: Sequence[Problem]
    refused: Set[Position] = frozenset()
    """The places that the schema has reported."""


def load_points(path: Path) -> tuple[Entry, ...]:
    """Return the points of a file as written. Raise DefinitionError with all problems that need no run."""
    found, reader = read_points(path), Reader()
    PointsLoader(reader, path.parent, AnyAddresses(), {}, ()).look_at_values(found)
    problems = [*found.problems, *reader.problems]
    if any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return found.entries


def read_points(path: Path) -> WrittenPoints:
    """Return the points of a file and its problems. Raise DefinitionError for a file that cannot be read at all."""
    if path.suffix == ".csv":
        return _table(path)
    reader = Reader()
    documents = Documents(reader)
    entries: tuple[Entry, ...] = ()
    with suppress(Broken):
        root = documents.root(path, "points")
        reader.text(root.get("points"))  # the name is only for people
        entries = reader.entries(root.get("values"))
    return WrittenPoints(entries, documents.first_words(reader.problems), documents.refused)


# ---- tables -----------------------------------------------------------------------------------------------------


def _table(path: Path) -> WrittenPoints:
    """Return the rows of a table as points. Raise DefinitionError for a table without its columns."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(numbered_rows(csv.reader(file)))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        what = f"the table cannot be read: {error}"
        raise DefinitionError([Problem(Position(str(path), 1, 1), what, "give a table in UTF-8 with commas")]) from None
    columns = [name.strip() for name in rows[0][1]] if rows else []
    doubled = next((name for name in columns if name and columns.count(name) > 1), None)
    start = Position(str(path), 1, 1)
    if "name" not in columns or "address" not in columns:
        what = "the first row does not name the columns name and address"
        raise DefinitionError([Problem(start, what, "write name,address,type,scale,unit, or framekit import")])
    if doubled is not None:
        raise DefinitionError([Problem(start, f"there are two columns '{doubled}'", "take one of them out")])
    entries = []
    for line, row in rows[1:]:
        if any(cell.strip() for cell in row):
            entries.append(_row(columns, row, str(path), line))
    values = Mapping((Entry(Scalar("values", start), Mapping(tuple(entries), start)),), start)
    head = Mapping((Entry(Scalar("points", start), Scalar(path.stem, start)), *values.entries), start)
    problems = [*_doubles(entries), *validate(head, "points")]
    return WrittenPoints(tuple(entries), problems, {at for problem in problems for at in problem.places})


def _row(columns: Sequence[str], row: Sequence[str], file: str, line: int) -> Entry:
    """Return one row as a point; positions of cells give the line of the file and the number of the cell."""
    at = Position(file, line, 1)
    name, keys = Scalar("", at), []
    for number, (column, cell) in enumerate(zip(columns, row, strict=False), 1):
        text, place = cell.strip(), Position(file, line, number)
        if column == "name":
            name = Scalar(text, place)
        elif text and column in _LISTS:
            keys.append(Entry(Scalar(column, place), _words(text, _LISTS[column], place)))
        elif text:
            keys.append(Entry(Scalar(column, place), Scalar(text, place)))
    if len(row) > len(columns):
        keys.append(Entry(Scalar(f"column {len(columns) + 1}", at), Scalar(row[len(columns)], at)))
    return Entry(name, Mapping(tuple(keys), at))


def _words(text: str, between: str, at: Position) -> Mapping:
    """Return `0=off;1=on` as a mapping from number to word."""
    pairs = [part.partition("=") for part in text.split(between) if part.strip()]
    return Mapping(tuple(Entry(Scalar(key.strip(), at), Scalar(word.strip(), at)) for key, _, word in pairs), at)


def _doubles(entries: Sequence[Entry]) -> Iterator[Problem]:
    seen: set[str] = set()
    for entry in entries:
        if entry.key.text in seen:
            yield Problem(entry.key.at, f"there are two points '{entry.key.text}'", "name one of them otherwise")
        seen.add(entry.key.text)


# ---- points of a run --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Group:
    """The keys and the name prefix that apply to all points of one file; keys of a point take precedence."""

    keys: Mapping | None = None
    prefix: str = ""
    refused: Set[Position] = frozenset()
    """The places of the file that its schema has reported."""


class PointsLoader:
    """Reads the points of a run, given the address grammar of the own memory and the channels of the run."""

    def __init__(
        self, reader: Reader, folder: Path, grammar: AddressGrammar, channels: MappingOf[int, Channel],
        blocks: Sequence[Block], unread: Collection[str] = (), broken: MappingOf[int, Channel] = MappingProxyType({}),
    ) -> None:  # fmt: skip
        """Prepare the loader; `unread`: numbers, as written, of channels whose problems have been reported already.

        `broken`: those of them whose protocol is known; their points are checked as far as possible.
        """
        self.unread, self.broken = unread, broken
        self.reader, self.folder, self.grammar, self.channels = reader, folder, grammar, channels
        self.attempts = Attempts()
        self.names: list[str] = []
        """The names of all points, also of those with errors."""
        self.is_complete = True
        """Whether no point has an error."""
        self._grammars: dict[int, AddressGrammar] = {}
        self._cycles = {
            block.id: trigger.period for block in blocks for trigger in block.triggers if isinstance(trigger, Every)
        }
        frames = {number: channel.protocol.frames for number, channel in channels.items()}
        self._stored = [
            (block.id, place.address, bits)
            for block in blocks
            for place, bits in stored_by(block, frames.get(block.channel, {}))
        ]

    def load(self, node: Node | None) -> tuple[tuple[Point, ...], list[Block], int]:
        """Return the points, the blocks that read them, and the memory they take in words. Problems are noted."""
        found: dict[str, Point | PointRead] = {}
        if node is not None and not self.reader.items(node):
            self.reader.note(node.at, "'points' is empty", "write at least one entry")
        own: dict[int, Mapping] = {}  # common keys of files without any point on a channel
        on_channel: set[int] = set()
        for entry, group in self._entries(node):
            if group.keys is not None:
                own[id(group.keys)] = group.keys
            name = f"{group.prefix}.{entry.key.text}" if group.prefix else entry.key.text
            self.names.append(name)
            before = len(self.reader.problems)
            with self.reader.going_on():
                one = self._point(name, entry, group)
                if name in found:
                    what = f"there are two points '{name}'"
                    raise self.reader.broken(entry.key.at, what, "name one of them otherwise, or give a prefix")
                found[name] = one
            if group.refused:
                new = self.reader.problems[before:]
                self.reader.problems[before:] = [problem for problem in new if problem.at not in group.refused]
            if group.keys is not None and (name not in found or isinstance(found[name], PointRead)):
                on_channel.add(id(group.keys))
        for number, keys in own.items():
            if number not in on_channel:
                self._useless(keys, [(key, NOT_READ) for key in ("every", "station") if key in keys])
        self.is_complete = len(found) == len(self.names)
        if any(not problem.warning for problem in self.reader.problems):
            return tuple(one if isinstance(one, Point) else one.point for one in found.values()), [], 0
        asked = [one for one in found.values() if isinstance(one, PointRead)]
        blocks, read, words = planned(asked, self.channels)
        points = {name: one for name, one in found.items() if isinstance(one, Point)} | read
        return tuple(points[name] for name in found), blocks, words

    def _entries(self, node: Node | None) -> Iterator[tuple[Entry, _Group]]:
        """Yield every point as written, with the common keys and the prefix of its file."""
        if isinstance(node, Mapping):
            yield from ((entry, _Group()) for entry in self.reader.entries(node))
            return
        for item in self.reader.items(node):
            keys = item if isinstance(item, Mapping) else None
            file = item if keys is None else keys.get("file")
            with self.reader.going_on():
                prefix = "" if keys is None or keys.get("prefix") is None else self.reader.text(keys.get("prefix"))
                if file is not None:
                    written = self._file(file)
                    self.reader.problems.extend(written.problems)
                    yield from ((entry, _Group(keys, prefix, written.refused)) for entry in written.entries)

    def _file(self, node: Node) -> WrittenPoints:
        """Return the points of a file in the folder of the run. Raise Broken."""
        name = self.reader.text(node)
        path = self.folder / name
        if not path.name.endswith((".csv", ".yaml")):
            path = self.folder / f"{name}{SUFFIX}"
        if leaves_folder(name, self.folder):
            raise self.reader.broken(node.at, f"'{name}' leaves the run's folder", INSIDE)
        if not os.path.isfile(path):
            known = (one.name for end in (SUFFIX, ".csv") for one in self.folder.glob(f"*{end}"))
            raise self.reader.broken(node.at, f"there is no file '{path.name}'", did_you_mean(name, known))
        try:
            return read_points(path)
        except DefinitionError as error:
            self.reader.problems.extend(error.problems)
            raise Broken(name) from None

    # ---- single points --------------------------------------------------------------------------------------

    def own_point(self, address: Scalar, keys: Sequence[Entry]) -> Point:
        """Return the value at an address of the own memory; `keys` give its type, order and scaling. Raise Broken."""
        at = Entry(Scalar("address", address.at), address)
        point = self._point(address.text, Entry(address, Mapping((at, *keys), address.at)), _Group())
        assert isinstance(point, Point)
        return point

    def _point(self, name: str, entry: Entry, group: _Group) -> Point | PointRead:
        """Return one point. Check all its keys before raising Broken for the invalid ones."""
        reader, keys = self.reader, self.reader.mapping(entry.value)
        self.attempts.spoilt = False
        channel = self.attempts.to(lambda: self._channel(keys, group))
        is_known = channel is not None or not self.attempts.spoilt
        place = self.attempts.to(lambda: self._placed(keys, channel, entry)) if is_known else None
        if place is None:
            self._look_at_rest(keys, group)
            raise Broken(name)
        text, address, form, call = place
        every = self._time(keys, group, "every") or EVERY
        stale = self._time(keys, group, "stale")
        numeric = form.type != "string"
        sources = () if channel is not None else self._sources(address, form.bits)
        point = Point(
            name=name,
            form=form,
            place=OwnPlace(address=address, text=text),
            address=text,
            channel=None if channel is None else channel.number,
            station=None if channel is None else self._station(keys, group, channel, entry),
            blocks=sources,
            scaling=self._scaling(keys, numeric),
            order=self.attempts.maybe(reader.text, keys.get("order")),
            unit=self.attempts.maybe(reader.text, keys.get("unit")) or "",
            decimals=self._number_of(keys, "decimals", numeric, reader.number),
            names=self._names(keys),
            deadband=float(self._number_of(keys, "deadband", numeric, self._exact) or 0),
            stale=stale or min(NEVER, PERIODS_TO_STALE * (every if channel is not None else self._period(sources))),
            is_writable=call is None and self._writable(keys, channel, address),
            limits=self._limits(keys),
            about=self.attempts.maybe(reader.text, keys.get("about")) or "",
            at=entry.key.at,
        )
        self._out_of_range(keys, point.deadband, point.decimals, point.names)
        self._effects(keys, channel, point, every)
        if self.attempts.spoilt:
            raise Broken(name)
        return point if channel is None else PointRead(point, address, every, call)

    def _placed(
        self, keys: Mapping, channel: Channel | None, entry: Entry
    ) -> tuple[str, Address, Typed, PointCall | None]:
        """Return the address of a point as written and parsed, the form of its value, and its call. Raise Broken."""
        if "call" not in keys:
            return *self._addressed(keys, channel, entry), None
        call, form = self._call(keys, channel, entry)
        text = f"{call.service} {call.result}"
        return text, Address(POINTS_AREA, form.carrier, 0, text, {}), form, call

    def look_at_values(self, written: WrittenPoints) -> None:
        """Note problems of points that can be found without a run."""
        for entry in written.entries:
            if isinstance(entry.value, Mapping):
                self._look_at_rest(entry.value, _Group())
        self.reader.problems[:] = [problem for problem in self.reader.problems if problem.at not in written.refused]

    def _look_at_rest(self, keys: Mapping, group: _Group) -> None:
        """Note problems of the keys of a point that need neither its channel nor its address."""
        node = keys.get("type")
        numeric = not isinstance(node, Scalar) or node.text != "string"
        for read in (
            lambda: self._time(keys, group, "every"),
            lambda: self._time(keys, group, "stale"),
            lambda: self._scaling(keys, numeric),
            lambda: self._limits(keys),
        ):
            with self.reader.going_on():
                read()
        decimals = self.attempts.to(lambda: self._number_of(keys, "decimals", numeric, self.reader.number))
        deadband = self.attempts.to(lambda: self._number_of(keys, "deadband", numeric, self._exact))
        self._out_of_range(keys, float(deadband or 0), decimals, self.attempts.to(lambda: self._names(keys)) or {})

    def _typed(self, keys: Mapping) -> tuple[str | None, str | None, int | None]:
        """Return `type`, `order` and `size` of a point. Raise Broken."""
        reader = self.reader
        type_ = self.attempts.maybe(reader.text, keys.get("type"))
        order = self.attempts.maybe(reader.text, keys.get("order"))
        size = self.attempts.maybe(reader.number, keys.get("size"))
        if type_ == "string" and (size is None or size < 1):
            what = "nothing says how many characters the string has" if size is None else f"a string of {size} is none"
            raise reader.broken(self._at(keys, "type" if size is None else "size"), what, "give size: with 1 or more")
        if size is not None and type_ != "string":
            raise reader.broken(
                self._at(keys, "size"), "only a string has a size", "leave it out, or give type: string"
            )
        if type_ is not None and type_ not in TYPES:
            raise Broken("the schema has reported the type")
        if order is not None and order not in ORDERS:
            raise Broken("the schema has reported the order")
        return type_, order, size

    def _addressed(self, keys: Mapping, channel: Channel | None, entry: Entry) -> tuple[str, Address, Typed]:
        """Return the address of a point as written and parsed, and the form of its value. Raise Broken."""
        reader, address_node = self.reader, keys.get("address")
        if address_node is None and any(is_nearly("address", one.key.text) for one in keys.entries):
            raise Broken("the schema has reported a misspelt key")
        if address_node is None:
            what = f"missing key 'address' in point '{entry.key.text}'"
            raise reader.broken(keys.at, what, "add it, or call: with the service that brings the value")
        if channel is not None and "read" not in channel.protocol.services:
            what = f"'{channel.protocol.name}' has no service read"
            todo = "write call: SERVICE, or store its frames by a RECEIVE block and name that place"
            raise reader.broken(address_node.at, what, todo)
        text = reader.text(address_node)
        type_, order, size = self._typed(keys)
        if order is not None and type_ not in VIEWS:
            what = f"{type_ or 'what the address says'} has no order of bytes"
            raise reader.broken(self._at(keys, "order"), what, "give a type such as float32, or leave order out")
        grammar = self.grammar if channel is None else self._grammar(channel)
        with reader.refusing(address_node.at):
            try:
                address = grammar.parse(text)
            except AddressError as error:
                hint = "; or add channel: where a device has it" if channel is None and self.channels else ""
                raise ValueError(f"{error}{hint}") from None
            form = typed_at(grammar, text, type_, order, size or 1)
            grammar.check(address, -(-form.bits // address.unit_bits))
        return text, address, form

    def _call(self, keys: Mapping, channel: Channel | None, entry: Entry) -> tuple[PointCall, Typed]:
        """Return the call that reads a point, and the form of its value. Raise Broken."""
        reader, at = self.reader, self._at(keys, "call")
        if channel is None:
            raise reader.broken(at, "a service is called on a channel", "add channel: NUMBER")
        for key, why in (("address", "the point is a result of a call"), ("order", NO_BYTES), ("access", NOT_WRITTEN)):
            if key in keys:
                reader.note(self._at(keys, key), f"'{key}' has no effect: {why}", "remove it")
                self.attempts.spoilt = True
        calls = CallLoader(reader, self.attempts, OwnPlaces(reader, self.grammar), self.folder)
        service, rows = calls.service(keys, channel)
        if any(wants_address(row) for row in rows):
            raise reader.broken(at, f"'{service}' is about addresses of the device", "call it by a block")
        node = keys.get("result")
        result = reader.expression(node) if node is not None else reader.expression_text(entry.key.text, entry.key.at)
        where = entry.key.at if node is None else node.at
        if not is_path(result.root):
            raise reader.broken(where, f"'{result}' names no result", "write names with dots, such as time.hour")
        shape = calls.shape(service, [shapes_of(channel.protocol, row) for row in rows], result, where)
        call = PointCall(
            service=service, arguments=calls.constants(keys, channel.protocol, service, rows),
            packing=packing_of(rows), result=result, scale=shape.scale,
        )  # fmt: skip
        return call, self._form_of_result(keys, shape, result, where)

    def _form_of_result(self, keys: Mapping, shape: Shape, result: Expression, at: Position) -> Typed:
        """Return the form of a result in memory: by `type`, else by its shape. Raise Broken."""
        type_, _, size = self._typed(keys)
        if shape.kind in ("record", "list", "bytes"):
            named = f" such as {result}.{next(iter(shape.parts))}" if shape.parts else ""
            raise self.reader.broken(at, f"'{result}' is no single number or text", f"name one of its values{named}")
        if shape.kind == "text" and type_ not in (None, "string"):
            raise self.reader.broken(self._at(keys, "type"), f"'{result}' is a text", "write type: string")
        if shape.kind == "number" and type_ == "string":
            raise self.reader.broken(self._at(keys, "type"), f"'{result}' is a number", "leave the type out")
        if type_ is None and shape.kind == "any":
            raise self.reader.broken(at, f"the type of '{result}' is not known", "add type:, such as int32 or float64")
        if type_ == "string" or shape.kind == "text":
            size = size or shape.size
            if size is None:
                raise self.reader.broken(
                    at, f"the size of the text '{result}' is not known", "add type: string, size: N"
                )
            view = view_of("string")
            assert isinstance(view, TextView)
            return Typed("string", view, view.unit("byte"), view.units(size, "byte"), size, "byte")
        name = type_ or ("float64" if shape.is_real else "int64")
        if name not in VIEWS:
            return Typed(name, None, name, 1, 1, name)
        number = view_of(name)
        assert isinstance(number, NumberView)
        return Typed(name, number, number.unit, 1, 1, "word")

    def _at(self, keys: Mapping, key: str) -> Position:
        node = keys.value(key)
        return keys.at if node is None else node.at

    def _common(self, keys: Mapping, group: _Group, key: str) -> Node | None:
        """Return a key of the point, or else the common key of its file."""
        node = keys.get(key)
        return node if node is not None or group.keys is None else group.keys.get(key)

    def _channel(self, keys: Mapping, group: _Group) -> Channel | None:
        node = self._common(keys, group, "channel")
        if node is None:
            return None
        number = read_channel_number(self.reader, node, self.unread)
        if number not in self.channels:
            if number in self.broken:
                self.attempts.spoilt = True
                return self.broken[number]
            if self.reader.text(node) in self.unread:
                raise Broken("the problems of the channel have been reported")
            hint = did_you_mean(str(number), {*self.unread, *map(str, self.channels)})
            raise self.reader.broken(node.at, f"there is no channel {number}", hint)
        channel = self.channels[number]
        if channel.listens or not channel.asks:
            raise self.reader.broken(node.at, f"channel {number} only answers, nothing is read on it", "name another")
        return channel

    def _grammar(self, channel: Channel) -> AddressGrammar:
        found = self._grammars.get(channel.number)
        if found is None:
            protocol = channel.protocol
            found = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
            self._grammars[channel.number] = found
        return found

    def _station(self, keys: Mapping, group: _Group, channel: Channel, entry: Entry) -> Any:
        node = self._common(keys, group, "station")
        if node is not None:
            return self.attempts.to(lambda: read_station(self.reader, node, channel.protocol))
        is_broken = self.broken.get(channel.number) is channel
        if channel.station is None and not is_broken and needs_station(channel.protocol):
            what = f"point '{entry.key.text}' does not say which station it is read from"
            self.reader.note(entry.key.at, what, "add station: to it, to its file or to the channel")
            self.attempts.spoilt = True
        return channel.station

    def _sources(self, place: Address, bits: int) -> tuple[int, ...]:
        """Return the ids of the blocks that store into the place of an own point."""
        area, first, end = place.area, place.first_bit, place.first_bit + bits
        return tuple(
            block
            for block, address, size in self._stored
            if address.area == area and address.first_bit < end and first < address.first_bit + size
        )

    def _period(self, sources: tuple[int, ...]) -> int:
        """Return the longest cycle of the blocks that store an own point.

        NEVER without blocks, or if a block has no cycle.
        """
        periods = [self._cycles.get(block) for block in sources]
        known = [period for period in periods if period is not None]
        return max(known) if known and len(known) == len(periods) else NEVER

    # ---- values of points -----------------------------------------------------------------------------------

    def _exact(self, node: Node | None) -> Decimal:
        """Return a decimal number. Raise Broken for other text, which the schema has reported."""
        try:
            found = Decimal(self.reader.text(node).strip())
        except InvalidOperation:
            raise Broken("the schema has told that it is no number") from None
        if not found.is_finite():
            raise Broken("the schema has told that it is no number")
        return found

    def _time(self, keys: Mapping, group: _Group, key: str) -> int | None:
        node = self._common(keys, group, key)
        time = self.attempts.maybe(self.reader.time, node)
        if node is not None and time is not None and (time <= 0 or (key == "every" and time >= NEVER)):
            self.reader.note(node.at, f"'{self.reader.text(node)}' is no {key}", "give a time such as 1 s")
            self.attempts.spoilt = True
        return time

    def _scaling(self, keys: Mapping, numeric: bool) -> Scaling | None:
        factor = self._number_of(keys, "scale", numeric, self._exact)
        offset = self._number_of(keys, "offset", numeric, self._exact)
        if factor == 0:
            self.reader.note(self._at(keys, "scale"), "a scale of 0 makes every value the same", "give another")
            self.attempts.spoilt = True
        if factor is None and offset is None:
            return None
        return Scaling(Decimal(1) if factor is None else factor, Decimal(0) if offset is None else offset)

    def _number_of(self, keys: Mapping, key: str, numeric: bool, read: Any) -> Any:
        """Read a key that only numbers may have; raise Broken if a string has it."""
        node = keys.get(key)
        if node is not None and not numeric:
            raise self.reader.broken(node.at, f"a string has no {key}", "leave it out")
        return self.attempts.maybe(read, node)

    def _names(self, keys: Mapping) -> dict[int, str]:
        found: dict[int, str] = {}
        for entry in self.reader.entries(keys.get("enum")):
            with self.attempts.going_on():
                found[self.reader.number(entry.key)] = self.reader.text(entry.value)
        return found

    def _writable(self, keys: Mapping, channel: Channel | None, address: Address) -> bool:
        node = keys.get("access")
        if node is None or self.reader.text(node) != "rw":
            return False
        areas = self.grammar.areas if channel is None else channel.protocol.areas
        area = areas.get(address.area)
        if area is not None and area.access == "read":
            self.reader.note(node.at, f"area '{area.name}' can only be read", "leave access out")
            self.attempts.spoilt = True
        elif channel is not None and "write" not in channel.protocol.services:
            self.reader.note(node.at, f"'{channel.protocol.name}' has no service write", "leave access out")
            self.attempts.spoilt = True
        return True

    def _limits(self, keys: Mapping) -> tuple[float, float] | None:
        node = keys.get("range")
        if node is None:
            return None
        low, _, high = self.reader.text(node).partition("..")
        try:
            limits = float(low), float(high)
        except ValueError:
            what = f"'{self.reader.text(node)}' is no range"
            raise self.reader.broken(node.at, what, "write it like 0..100") from None
        if limits[0] > limits[1]:
            self.reader.note(node.at, f"the range {self.reader.text(node)} is empty", "give the smaller number first")
            self.attempts.spoilt = True
        return limits

    def _out_of_range(self, keys: Mapping, deadband: float, decimals: int | None, names: MappingOf[int, str]) -> None:
        """Note values out of range."""
        most, none = f"0 to {MOST_DECIMALS} are", "name each its own"
        wrong = [
            (deadband < 0, "deadband", "a dead band is not below 0", "give 0 or more"),
            (not 0 <= (decimals or 0) <= MOST_DECIMALS, "decimals", "so many decimals are not possible", most),
            (len(set(names.values())) < len(names), "enum", "two numbers have one word", none),
        ]
        for is_wrong, key, what, todo in wrong:
            if is_wrong:
                self.reader.note(self._at(keys, key), what, todo)
                self.attempts.spoilt = True

    def _effects(self, keys: Mapping, channel: Channel | None, point: Point, every: int) -> None:
        """Note keys without effect, and a value that would be stale before it is read again."""
        reader = self.reader
        useless = []
        if channel is None:
            useless = [(key, NOT_READ) for key in ("every", "station") if key in keys]
        if "call" not in keys:
            useless += [(key, "the point is not the result of a call") for key in ("result", "with") if key in keys]
        if point.limits is not None and not point.is_writable:
            useless.append(("range", "the point is not written; access: rw allows it"))
        if point.names and point.form.type == "string":
            useless.append(("enum", "a string has no numbers"))
        if channel is not None and point.stale < every:
            reader.note(self._at(keys, "stale"), "a value is stale before it is read again", "give more than every:")
            self.attempts.spoilt = True
        if point.names and (point.deadband or point.decimals is not None):
            useless += [(key, "words are shown") for key in ("deadband", "decimals") if key in keys]
        self._useless(keys, useless)

    def _useless(self, keys: Mapping, found: Sequence[tuple[str, str]]) -> None:
        """Note keys without effect, each with the reason."""
        for key, why in found:
            entry = next(one for one in keys.entries if one.key.text == key)
            self.reader.note(entry.key.at, f"'{key}' has no effect: {why}", "remove it")
            self.attempts.spoilt = True
