"""Memory profiles: areas, addresses, clock bits and words of blocks of a memory, and their reader.

A profile is in `NAME.memory.yaml`, in the folder of the file that names it or among the shipped profiles, or written in
place. Problems are collected and raised together.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from collections.abc import Mapping as MappingOf
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Literal, get_args

from framekit.definition.check.addresses import check_forms
from framekit.definition.load.documents import Documents, merged
from framekit.definition.load.namespace import load_table
from framekit.definition.load.reader import MOST_ELEMENTS, Broken, Reader
from framekit.definition.load.services import load_address_forms
from framekit.definition.model.services import NUMBER_BITS, UNIT_BITS, AddressForm, AreaModel, FormPart
from framekit.definition.model.values import Table
from framekit.definition.nodes import Entry, Mapping, Node, Scalar
from framekit.definition.problems import NOWHERE, DefinitionError, Position, Problem, did_you_mean
from framekit.definition.sources import find_profile
from framekit.definition.times import NEVER
from framekit.memory.memory import Area, DeviceMemory, LateArea, unit_bits

CALENDAR_PARTS: dict[str, Callable[[datetime], int]] = {
    "second": lambda date: date.second,
    "minute": lambda date: date.minute,
    "hour": lambda date: date.hour,
    "day": lambda date: date.day,
    "month": lambda date: date.month,
    "year": lambda date: date.year % 100,
    "century": lambda date: date.year // 100,
    "weekday": lambda date: date.isoweekday() % 7,
    "days": lambda date: (date - datetime(1984, 1, 1)).days,
    "ms_low": lambda date: _milliseconds(date) & 0xFFFF,
    "ms_high": lambda date: _milliseconds(date) >> 16,
}
"""Values that a word of the calendar can show; a week begins with Sunday, 0, and days are counted from 1984 on. The two
words of the milliseconds of the day change once a second, like the others.
"""

WHOLE_WORDS = ("days", "ms_low", "ms_high")
"""Values that do not fit into a byte."""


def _milliseconds(date: datetime) -> int:
    """Return the milliseconds since midnight at the begin of this second."""
    return ((date.hour * 60 + date.minute) * 60 + date.second) * 1000


FixedKind = Literal["on", "off", "first_scan", "after_first_scan", "every_scan"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileArea(AreaModel):
    """An area of a profile: an area of a protocol, with additional names."""

    aliases: tuple[str, ...] = ()
    retained: bool = False
    """Whether its content outlasts a restart, if a run stores its state."""
    about: str = ""


@dataclass(frozen=True, slots=True)
class ClockBit:
    """A bit that is on for half of `period` nanoseconds and off for the other half; `address` as written."""

    address: str
    period: int
    at: Position


@dataclass(frozen=True, slots=True)
class FixedBit:
    """A bit that is always on or off, on or off during the first scan only, or changes with every scan."""

    address: str
    kind: FixedKind
    at: Position


@dataclass(frozen=True, slots=True)
class CalendarWord:
    """A word that shows the date or the time: one part as a number, or two, low byte first, as two decimal digits."""

    address: str
    parts: tuple[str, ...]
    at: Position


@dataclass(frozen=True, slots=True)
class NamedPlace:
    """A place with a name; `address` as written."""

    address: str
    at: Position


@dataclass(frozen=True, slots=True)
class BlockItem:
    """`words` words, or one `bit`, from word `word` of a block's words on; `unit`: unit in which they are read."""

    word: int
    bit: int | None = None
    words: int = 1
    unit: str = "word"

    @property
    def bits(self) -> range:
        """Return the indices of its bits within the words of a block."""
        first = 16 * self.word + (self.bit or 0)
        return range(first, first + (16 * self.words if self.bit is None else 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockWords:
    """Words of the blocks of a run in `area`, one block after the other, for `sets` sets of `blocks` blocks."""

    name: str
    area: str
    first: int
    """First word of block 0 of set 1."""
    words: int
    """Number of words of each block."""
    sets: int
    blocks: int
    items: MappingOf[str, BlockItem]
    """Contents of the words, by name."""
    at: Position

    @property
    def end(self) -> int:
        """Return the first word after the words of all blocks."""
        return self.first + self.words * self.sets * self.blocks

    def base(self, set_number: int, block: int) -> int:
        """Return the first word of a block; sets count from 1, blocks from 0. Raises ValueError for any other."""
        if not 1 <= set_number <= self.sets or not 0 <= block < self.blocks:
            raise ValueError(
                f"there is no block {block} of set {set_number} – "
                f"sets are 1 to {self.sets}, blocks 0 to {self.blocks - 1}"
            )
        return self.first + self.words * (self.blocks * (set_number - 1) + block)


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryProfile:
    """A memory profile."""

    name: str
    about: str
    source: str
    areas: MappingOf[str, ProfileArea]
    tables: MappingOf[str, Table]
    addresses: tuple[AddressForm, ...]
    clocks: tuple[ClockBit, ...]
    fixed: tuple[FixedBit, ...]
    scan: int
    """Duration of a scan (ns)."""
    calendar: tuple[CalendarWord, ...] = ()
    named: MappingOf[str, NamedPlace]
    """Flags of the file that are addresses."""
    flags: MappingOf[str, BlockWords]
    """Flags of the file that are words of blocks."""
    at: Position

    def create(self) -> DeviceMemory:
        """Return a memory with these areas, all 0; an area with words of blocks may get an owner."""
        late = {section.area for section in self.flags.values()}
        return DeviceMemory(
            (LateArea if area.name in late else Area)(
                area.name, size=area.size, unit=area.unit, access=area.access, aliases=area.aliases
            )
            for area in self.areas.values()
        )


# ---- reading ---------------------------------------------------------------------------------------------------

SUFFIX = ".memory.yaml"
DEFAULT_SCAN = 10_000_000
SHORTEST_PERIOD = 1_000_000
"""Shortest period of a clock bit (ns); no port could show a faster one."""

PLAIN = AddressForm(
    text="{area}{start:dec}",
    parts=(FormPart("area", "area"), FormPart("number", "start")),
    area=None,
    unit=None,
    units_table=None,
    results={},
    wire=True,
    at=NOWHERE,
)
"""Default form of addresses: `M100`, counted in the area's own unit."""

_ACCESS: dict[str, Literal["rw", "read"]] = {"rw": "rw", "read": "read"}
_AREA_KEYS = ("unit", "type", "size", "access", "aliases", "retained", "about")
_KINDS: dict[str, FixedKind] = {kind: kind for kind in get_args(FixedKind)}


def load_profile(name_or_path: str | Path, folder: Path | None = None, at: Position = NOWHERE) -> MemoryProfile:
    """Return the profile in a file (a Path), or of a name: `NAME.memory.yaml` in `folder`, else a shipped profile.

    `at`: place of the name. Raises DefinitionError with all problems.
    """
    path = name_or_path if isinstance(name_or_path, Path) else _find(name_or_path, folder, at)
    reader = Reader()
    documents = Documents(reader)
    with suppress(Broken):
        return _profile(documents.root(path, "memory"), documents, path)
    raise DefinitionError(reader.problems)


def load_profile_node(node: Mapping, folder: Path | None = None) -> MemoryProfile:
    """Load a profile written in place, `{areas: …}`, on top of the profile named by its key `profile`, if present.

    Sections are joined by name, in areas single keys are replaced. Keys that no profile has are ignored: the reader of
    the surrounding file checks them. Raises DefinitionError.
    """
    base = node.get("profile")
    reader = Reader()
    documents = Documents(reader)
    with suppress(Broken):
        if base is None:
            return _profile(node, documents)
        name = base.text if isinstance(base, Scalar) else ""
        return _profile(merged(documents.root(_find(name, folder, base.at), "memory"), node), documents)
    raise DefinitionError(reader.problems)


def _profile(root: Mapping, documents: Documents, file: Path | None = None) -> MemoryProfile:
    """Return the profile in nodes.

    Raises Broken if a required part is missing, DefinitionError with all its problems.
    """
    reader = documents.reader
    profile = ProfileLoader(reader, root).profile()
    named = (
        entry.key.text for key in ("areas", "tables") for entry in reader.tried(reader.entries, root.get(key)) or ()
    )
    broken = {*named} - profile.areas.keys() - profile.tables.keys()
    reader.problems.extend(check_forms(profile.addresses, profile.areas, profile.tables, broken))
    for form in profile.addresses:
        if form.counts is not None:
            what = "places of a memory profile begin at whole elements, so counts: is not for it"
            reader.problems.append(Problem(form.at, what, "leave it out; forms of a protocol may have it"))
    problems = documents.first_words(reader.problems, file)
    if any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return profile


def _find(name: str, folder: Path | None, at: Position) -> Path:
    return find_profile(name, folder, at, kind="memory profile", suffix=SUFFIX)


def read_scan(reader: Reader, node: Node) -> int:
    """Return the duration of a scan (ns). Raises Broken."""
    time = reader.time(node)
    if not SHORTEST_PERIOD <= time < NEVER:
        raise reader.broken(node.at, "a scan takes 1 ms or more", "write it like 10 ms")
    return time


class ProfileLoader:
    """Converts the nodes of one file to a profile; problems go to `reader`."""

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
            addresses=load_address_forms(self.reader, self.root.get("addresses"), self.areas, tables) or (PLAIN,),
            clocks=self._clocks(),
            fixed=self._fixed(),
            scan=self.reader.tried(partial(read_scan, self.reader), self.root.get("scan")) or DEFAULT_SCAN,
            calendar=self._calendar(),
            named=self._named(),
            flags=self._flags(),
            at=self.root.at,
        )

    def _text(self, key: str) -> str:
        return self.reader.maybe(self.reader.text, self.root.get(key)) or ""

    def _section(self, key: str) -> tuple[Entry, ...]:
        return self.reader.tried(self.reader.entries, self.root.get(key)) or ()

    # --- areas

    def _load_areas(self) -> None:
        taken: set[str] = set()
        if self.root.get("areas") is None:
            self.reader.note(self.root.at, "the memory has no areas", "add areas: {NAME: {unit: word, size: N}}")
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
        columns = self._columns(node)
        access = reader.maybe(lambda value: reader.one_of(value, _ACCESS, "an access"), node.get("access"))
        about = reader.maybe(reader.text, node.get("about"))
        element_bits = self._unit_bits(unit, entry.value if given is None else given)
        return ProfileArea(
            name=name,
            unit=unit,
            type=self._type(node.get("type"), unit, element_bits),
            element_bits=element_bits,
            size=self._at_least(1, self._needed(entry, "size")),
            access=access or "rw",
            codes={},
            memory=name,
            layout=None,
            columns=columns,
            at=entry.key.at,
            aliases=reader.texts(node.get("aliases")),
            retained=reader.flag(node.get("retained")),
            about=about or "",
        )

    def _type(self, node: Node | None, unit: str, element_bits: int) -> str | None:
        """Return the type of numbers in elements; None for unsigned numbers. Raises Broken."""
        if node is None:
            return None
        text = self.reader.text(node)
        if text not in NUMBER_BITS:
            raise self.reader.broken(node.at, f"'{text}' is no type of number", did_you_mean(text, NUMBER_BITS))
        if NUMBER_BITS[text] != element_bits:
            todo = f"give a unit of {NUMBER_BITS[text]} bits, or another type"
            raise self.reader.broken(node.at, f"a {text} is no {unit}, which an element is", todo)
        return text

    def _columns(self, node: Mapping) -> MappingOf[str, int | str | bytes]:
        columns: dict[str, int | str | bytes] = {}
        for entry in node.read_all():
            key = entry.key.text
            if key in _AREA_KEYS:
                continue
            if key == "order":
                what = "the areas of a memory profile have no order: their words begin with the low byte"
                self.reader.note(entry.key.at, what, "leave it out; areas of a protocol may have one")
            if difflib.get_close_matches(key, _AREA_KEYS, n=1, cutoff=0.75):
                self.reader.note(entry.key.at, f"an area has no key '{key}'", did_you_mean(key, _AREA_KEYS))
            columns[key] = self.reader.cell(entry.value)
        return columns

    # --- bits the memory sets by itself

    def _clocks(self) -> tuple[ClockBit, ...]:
        clocks = []
        for entry in self._section("clocks"):
            with self.reader.going_on():
                period = self.reader.time(entry.value)
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

    def _calendar(self) -> tuple[CalendarWord, ...]:
        words = []
        for entry in self._section("calendar"):
            with self.reader.going_on():
                parts = self.reader.texts(entry.value)
                for part in parts:
                    if part not in CALENDAR_PARTS:
                        raise self.reader.unknown(entry.value.at, "part of a date", part, list(CALENDAR_PARTS))
                whole = next((part for part in parts if part in WHOLE_WORDS), "")
                if len(parts) == 2 and whole:
                    raise self.reader.broken(entry.value.at, f"'{whole}' takes a whole word", f"write {whole} alone")
                if len(parts) not in (1, 2):
                    raise self.reader.broken(entry.value.at, "a word has two bytes", "give one part, or two")
                words.append(CalendarWord(entry.key.text, parts, entry.key.at))
        return tuple(words)

    # --- named places and words of blocks

    def _named(self) -> dict[str, NamedPlace]:
        return {
            entry.key.text: NamedPlace(entry.value.text, entry.value.at)
            for entry in self._section("flags")
            if isinstance(entry.value, Scalar)
        }

    def _flags(self) -> dict[str, BlockWords]:
        flags = {}
        for entry in self._section("flags"):
            if isinstance(entry.value, Scalar):
                continue
            with self.reader.going_on():
                flags[entry.key.text] = self._block_words(entry)
        self._apart(list(flags.values()))
        return flags

    def _apart(self, sections: list[BlockWords]) -> None:
        """Note a problem for sections that share words, and for items of a section that share bits."""
        for place, one in enumerate(sections):
            for other in sections[:place]:
                if one.area == other.area and one.first < other.end and other.first < one.end:
                    what = f"words {one.first} to {one.end - 1} of '{one.name}' are also in '{other.name}', which has "
                    self.reader.note(one.at, f"{what}{other.first} to {other.end - 1}", "move one of them")
            taken: dict[int, str] = {}
            for name, item in one.items.items():
                shared = next((taken[bit] for bit in item.bits if bit in taken), None)
                if shared is not None:
                    self.reader.note(one.at, f"'{name}' and '{shared}' of '{one.name}' share bits", "move one of them")
                taken |= dict.fromkeys(item.bits, name)

    def _block_words(self, entry: Entry) -> BlockWords:
        words = self._at_least(1, self._needed(entry, "words"))
        found = BlockWords(
            name=entry.key.text,
            area=self._area_name(self._needed(entry, "area")),
            first=self._at_least(0, self._needed(entry, "first")),
            words=words,
            sets=self._at_least(1, self._needed(entry, "sets")),
            blocks=self._at_least(1, self._needed(entry, "blocks")),
            items={
                item.key.text: self._item(item, words) for item in self.reader.entries(self._needed(entry, "items"))
            },
            at=entry.key.at,
        )
        area = self.areas[found.area]
        if found.end * 16 > area.size * area.element_bits:
            what = f"'{found.name}' reaches to word {found.end - 1}, beyond the end of area {area.name}"
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
            word=self._at_least(0, self._needed(entry, "word")),
            bit=reader.maybe(lambda bit: self._at_least(0, bit), node.get("bit")),
            words=reader.maybe(lambda count: self._at_least(least, count), node.get("words")) or least,
            unit=unit,
        )
        if item.bit is not None and item.bit > 15:
            raise reader.broken(entry.key.at, f"a word has no bit {item.bit}", "bits are 0 to 15")
        if item.word + item.words > words:
            raise reader.broken(entry.key.at, f"'{entry.key.text}' is beyond the {words} words of a block")
        return item

    # --- scalars

    def _needed(self, entry: Entry, key: str) -> Node:
        node = self.reader.mapping(entry.value).get(key)
        if node is None:
            raise self.reader.broken(entry.value.at, f"'{entry.key.text}' has no {key}", f"add {key}:")
        return node

    def _area_name(self, node: Node) -> str:
        name = self.reader.text(node)
        if name not in self.areas:
            raise self.reader.unknown(node.at, "area", name, list(self.areas))
        return name

    def _at_least(self, least: int, node: Node) -> int:
        number = self.reader.number(node)
        if number < least:
            what = f"{number} is too small: {least} is the least"
            raise self.reader.broken(node.at, what)
        if number > MOST_ELEMENTS:
            raise self.reader.broken(node.at, f"{number} is too great: {MOST_ELEMENTS} is the greatest")
        return number

    def _unit_bits(self, unit: str, node: Node) -> int:
        with self.reader.refusing(node.at):
            return unit_bits(unit)
