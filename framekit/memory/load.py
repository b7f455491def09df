"""Reads memory profiles from `NAME.memory.yaml`, beside the file that names them or among the shipped ones.

Problems are collected and raised together. What an address means is not known here.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping as MappingOf
from pathlib import Path, PurePosixPath
from typing import Literal

from framekit.definition.load import scalars
from framekit.definition.load.addresses import load_address_forms
from framekit.definition.load.reader import Reader
from framekit.definition.load.tables import load_table
from framekit.definition.model.services import UNIT_BITS
from framekit.definition.nodes import Entry, Mapping, Node, read_nodes
from framekit.definition.problems import NOWHERE, DefinitionError, Position, Problem, did_you_mean
from framekit.definition.schema import validate
from framekit.definition.shipped import shipped_folder
from framekit.definition.times import NEVER, parse_time
from framekit.memory.numbers import unit_bits
from framekit.memory.profile import (
    BlockItem,
    BlockWords,
    ClockBit,
    FixedBit,
    FixedKind,
    MemoryProfile,
    ProfileArea,
)

SUFFIX = ".memory.yaml"
DEFAULT_SCAN = 10_000_000
SHORTEST_PERIOD = 1_000_000
"""A clock bit has a period of at least 1 ms; no port could show a faster one."""

_ACCESS: dict[str, Literal["rw", "read"]] = {"rw": "rw", "read": "read"}
_AREA_KEYS = ("unit", "size", "access", "aliases", "about")
_KINDS: dict[str, FixedKind] = {
    "on": "on",
    "off": "off",
    "first_scan": "first_scan",
    "after_first_scan": "after_first_scan",
    "every_scan": "every_scan",
}


def load_profile(name_or_path: str | Path, folder: Path | None = None, at: Position = NOWHERE) -> MemoryProfile:
    """The profile in a file (a Path), or of a name: `NAME.memory.yaml` in `folder`, else a shipped one.

    `at` is where the name was written. Raises DefinitionError with everything that is wrong.
    """
    path = name_or_path if isinstance(name_or_path, Path) else _find(name_or_path, folder, at)
    node = read_nodes(path)
    reader = Reader()
    reader.problems.extend(validate(node, "memory"))
    if not isinstance(node, Mapping) or any(not problem.warning for problem in reader.problems):
        raise DefinitionError(reader.problems)
    profile = _Loader(reader, node).profile()
    if any(not problem.warning for problem in reader.problems):
        raise DefinitionError(reader.problems)
    return profile


def _find(name: str, folder: Path | None, at: Position) -> Path:
    if not name or name.startswith(("/", "~")) or "\\" in name or ".." in PurePosixPath(name).parts:
        what = f"'{name}' leaves the folder of the file that names it"
        raise DefinitionError([Problem(at, what, "name a profile beside it or a shipped one")])
    places = [place for place in (folder, shipped_folder("frames")) if place is not None]
    for place in places:
        for candidate in (place / name, place / f"{name}{SUFFIX}"):
            if candidate.is_file() and candidate.resolve().is_relative_to(place.resolve()):
                return candidate
    known = {path.name.removesuffix(SUFFIX) for place in places for path in place.glob(f"*{SUFFIX}")}
    todo = did_you_mean(name, known) or f"write {name}{SUFFIX}"
    raise DefinitionError([Problem(at, f"there is no memory profile '{name}'", todo)])


class _Loader:
    """Turns the nodes of one file into a profile; problems go to `reader`."""

    def __init__(self, reader: Reader, root: Mapping) -> None:
        self.reader = reader
        self.root = root
        self.areas: dict[str, ProfileArea] = {}

    def profile(self) -> MemoryProfile:
        self._load_areas()
        tables = {entry.key.text: load_table(self.reader, entry) for entry in self._section("tables")}
        return MemoryProfile(
            name=self._text("memory"),
            about=self._text("about"),
            source=self._text("source"),
            areas=self.areas,
            tables=tables,
            addresses=load_address_forms(self.reader, self.root.get("addresses"), self.areas, tables),
            clocks=self._clocks(),
            fixed=self._fixed(),
            scan=self._scan(),
            flags=self._flags(),
            at=self.root.at,
        )

    def _text(self, key: str) -> str:
        node = self.root.get(key)
        return "" if node is None else self.reader.text(node)

    def _section(self, key: str) -> tuple[Entry, ...]:
        return self.reader.entries(self.root.get(key))

    # --- areas

    def _load_areas(self) -> None:
        taken: set[str] = set()
        for entry in self._section("areas"):
            with self.reader.going_on():
                area = self._area(entry)
                self.areas[area.name] = area
                for name in (area.name, *area.aliases):
                    if name in taken:
                        self.reader.note(entry.key.at, f"two areas are named '{name}'", "rename one of them")
                    taken.add(name)

    def _area(self, entry: Entry) -> ProfileArea:
        reader, node, name = self.reader, self.reader.mapping(entry.value), entry.key.text
        unit = "word" if (given := node.get("unit")) is None else reader.text(given)
        access = reader.maybe(lambda value: reader.one_of(value, _ACCESS, "an access"), node.get("access"))
        about = reader.maybe(reader.text, node.get("about"))
        return ProfileArea(
            name=name,
            unit=unit,
            element_bits=self._unit_bits(unit, entry.value if given is None else given),
            size=self._at_least(1, node.get("size")),
            access=access or "rw",
            codes={},
            memory=name,
            layout=None,
            columns=self._columns(node),
            at=entry.key.at,
            aliases=reader.texts(node.get("aliases")),
            about=about or "",
        )

    def _columns(self, node: Mapping) -> MappingOf[str, int | str | bytes]:
        columns: dict[str, int | str | bytes] = {}
        for entry in node.entries:
            key = entry.key.text
            if key in _AREA_KEYS:
                continue
            if difflib.get_close_matches(key, _AREA_KEYS, n=1, cutoff=0.75):
                self.reader.note(entry.key.at, f"an area has no key '{key}'", did_you_mean(key, _AREA_KEYS))
            columns[key] = scalars.parse_constant(self.reader.text(entry.value))
        return columns

    # --- bits the memory sets by itself

    def _clocks(self) -> tuple[ClockBit, ...]:
        clocks = []
        for entry in self._section("clocks"):
            with self.reader.going_on():
                period = self._time(entry.value)
                if not SHORTEST_PERIOD <= period < NEVER:
                    raise self.reader.broken(
                        entry.value.at, "a clock needs a period of 1 ms or more", "write it like 20 ms"
                    )
                clocks.append(ClockBit(entry.key.text, period, entry.key.at))
        return tuple(clocks)

    def _fixed(self) -> tuple[FixedBit, ...]:
        bits = []
        for entry in self._section("fixed"):
            with self.reader.going_on():
                kind = self.reader.one_of(entry.value, _KINDS, "a kind of fixed bit")
                bits.append(FixedBit(entry.key.text, kind, entry.key.at))
        return tuple(bits)

    def _scan(self) -> int:
        node = self.root.get("scan")
        if node is None:
            return DEFAULT_SCAN
        with self.reader.going_on():
            scan = self._time(node)
            if not SHORTEST_PERIOD <= scan < NEVER:
                raise self.reader.broken(node.at, "a scan takes 1 ms or more", "write it like 10 ms")
            return scan
        return DEFAULT_SCAN

    # --- words of blocks

    def _flags(self) -> dict[str, BlockWords]:
        flags = {}
        for entry in self._section("flags"):
            with self.reader.going_on():
                flags[entry.key.text] = self._block_words(entry)
        return flags

    def _block_words(self, entry: Entry) -> BlockWords:
        node = self.reader.mapping(entry.value)
        words = self._at_least(1, node.get("words"))
        found = BlockWords(
            name=entry.key.text,
            area=self._area_name(node.get("area")),
            first=self._at_least(0, node.get("first")),
            words=words,
            sets=self._at_least(1, node.get("sets")),
            blocks=self._at_least(1, node.get("blocks")),
            items={item.key.text: self._item(item, words) for item in self.reader.entries(node.get("items"))},
            at=entry.key.at,
        )
        area = self.areas[found.area]
        end = found.first + found.words * found.sets * found.blocks
        if end * 16 > area.size * area.element_bits:
            what = f"'{found.name}' reaches to word {end - 1}, beyond the end of area {area.name}"
            self.reader.note(entry.key.at, what, "fewer sets, blocks or words, or a larger area")
        return found

    def _item(self, entry: Entry, words: int) -> BlockItem:
        reader, node = self.reader, self.reader.mapping(entry.value)
        unit = "word" if (given := node.get("unit")) is None else reader.text(given)
        if unit not in ("word", "dword", "lword"):
            what, todo = f"'{unit}' is not made of words", "write word, dword or lword"
            raise reader.broken(entry.value.at, what, todo)
        least = UNIT_BITS[unit] // 16
        item = BlockItem(
            word=self._at_least(0, node.get("word")),
            bit=reader.maybe(lambda bit: self._at_least(0, bit), node.get("bit")),
            words=reader.maybe(lambda count: self._at_least(least, count), node.get("words")) or least,
            unit=unit,
        )
        if item.word + item.words > words or (item.bit or 0) > 15:
            raise reader.broken(entry.key.at, f"'{entry.key.text}' is beyond the {words} words of a block")
        return item

    # --- scalars

    def _area_name(self, node: Node | None) -> str:
        name = self.reader.text(node)
        if name not in self.areas:
            raise self.reader.unknown(self.reader.scalar(node).at, "area", name, list(self.areas))
        return name

    def _at_least(self, least: int, node: Node | None) -> int:
        number = self.reader.number(node)
        if number < least:
            what = f"{number} is too small: {least} is the least"
            raise self.reader.broken(self.reader.scalar(node).at, what)
        return number

    def _time(self, node: Node) -> int:
        try:
            return parse_time(self.reader.text(node))
        except ValueError as error:
            what, _, todo = str(error).partition(" – ")
            raise self.reader.broken(node.at, what, todo) from None

    def _unit_bits(self, unit: str, node: Node) -> int:
        try:
            return unit_bits(unit)
        except ValueError as error:
            what, _, todo = str(error).partition(" – ")
            raise self.reader.broken(node.at, what, todo) from None
