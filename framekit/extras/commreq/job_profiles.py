"""Reads job profiles from `NAME.jobs.yaml`, in the folder of the file that names them or among the shipped profiles."""

from __future__ import annotations

from collections.abc import Mapping as MappingOf
from functools import partial
from pathlib import Path

from framekit.definition.expression import names_in
from framekit.definition.load.documents import load_file
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Entry, Mapping, Node, Scalar
from framekit.definition.problems import NOWHERE, Position
from framekit.definition.sources import find_profile
from framekit.definition.times import NEVER
from framekit.memory.profile import DEFAULT_SCAN, read_scan
from framekit.run.model import (
    OTHERWISE,
    WORDS,
    AfterLate,
    CodeClass,
    EventCode,
    JobOutcome,
    JobProfile,
    Major,
    Minor,
    StatusBits,
    TimeUnit,
)

SUFFIX = ".jobs.yaml"


def load_job_profile(name_or_path: str | Path, folder: Path | None = None, at: Position = NOWHERE) -> JobProfile:
    """Return the profile in a file (a Path), or of a name: `NAME.jobs.yaml` in `folder`, else a shipped profile.

    `at`: place of the name. Raises DefinitionError with all problems.
    """
    path = name_or_path
    if not isinstance(path, Path):
        path = find_profile(path, folder, at, kind="job profile", suffix=SUFFIX)
    return load_file(path, "jobs", lambda reader, root: JobProfileLoader(reader, root).profile())


DEFAULT_CONNECT = 10_000_000_000
MOST = 0xFFFF
DEFAULT_LOG = 16
NO_LIMIT = 1 << 30

_CLASSES = {one.value: one for one in CodeClass}
_AFTER = {one.value: one for one in AfterLate}


class JobProfileLoader:
    """Converts the nodes of one file to a profile; problems go to `reader`."""

    def __init__(self, reader: Reader, root: Mapping) -> None:
        self.reader = reader
        self.root = root

    def profile(self) -> JobProfile:
        """Return the profile. Raises Broken if a required part is missing; the rest is read before."""
        reader, root = self.reader, self.root
        first, last = self._slots()
        late, pause = self._mapping("late"), self._mapping("pause")
        after = reader.tried(lambda node: reader.one_of(node, _AFTER, "a moment"), late.get("next"))
        return JobProfile(
            name=self._text("jobs"),
            about=self._text("about"),
            source=self._text("source"),
            first=first,
            last=last,
            commands=self._number("commands", NO_LIMIT, least=1),
            scan=reader.tried(partial(read_scan, reader), root.get("scan")) or DEFAULT_SCAN,
            log=self._number("log", DEFAULT_LOG, least=1),
            connect=reader.tried(self._time, root.get("connect")) or DEFAULT_CONNECT,
            pause=reader.tried(self._time, pause.get("time")) or 0,
            pause_after=frozenset(reader.tried(self._numbers, pause.get("after")) or ()),
            units=self._units(),
            late_unit=reader.tried(self._some_time, late.get("unit")) or 1,
            late_most=reader.tried(partial(self._at_least, 1), late.get("most")) or MOST,
            lengths=self._lengths(),
            after_late=after or AfterLate.NEXT_PERIOD,
            late_again=reader.flag(late.get("again")),
            bits=self._bits(last - first + 1),
            words={name: self._word(node) for name in WORDS if (node := self._mapping("words").get(name)) is not None},
            outcomes=self._outcomes(),
            codes=self._codes(),
            events=self._events(),
            at=root.at,
        )

    # ---- parts --------------------------------------------------------------------------------------------

    def _slots(self) -> tuple[int, int]:
        return self.reader.tried(self.reader.range, self.root.get("slots")) or (1, 1)

    def _units(self) -> dict[int, TimeUnit]:
        units = {}
        for entry in self._entries("units"):
            with self.reader.going_on():
                keys = self.reader.mapping(entry.value)
                most = self.reader.tried(partial(self._at_least, 1), keys.get("most"))
                units[self.reader.number(entry.key)] = TimeUnit(
                    self._some_time(self._needed(entry, "time")), most or MOST
                )
        return units

    def _lengths(self) -> dict[str, int]:
        lengths = {}
        for entry in self._entries("lengths"):
            with self.reader.going_on():
                lengths[entry.key.text] = self._at_least(1, entry.value)
        return lengths

    def _bits(self, slots: int) -> StatusBits:
        keys = self._mapping("bits")
        size = 0
        with self.reader.going_on():
            size = self._at_least(1, keys.get("size"))
        taken: dict[int, str] = {}

        def free(bit: int, name: str, node: Node | None) -> None:
            """Reserve a bit; raise Broken if it is out of range or in use."""
            if node is None:
                return
            if not 1 <= bit <= size:
                raise self.reader.broken(node.at, f"there is no bit {bit} for {name}", f"bits are 1 to {size}")
            if bit in taken:
                raise self.reader.broken(node.at, f"bit {bit} is that of {taken[bit]} already", "give it another one")
            taken[bit] = name

        def single(name: str) -> int:
            node = keys.get(name)
            with self.reader.going_on():
                if node is not None:
                    free(bit := self.reader.number(node), name, node)
                    return bit
            return 0

        def many(name: str) -> tuple[int, int]:
            node = keys.get(name)
            with self.reader.going_on():
                section = self.reader.mapping(node)
                first = self.reader.number(section.get("first"))
                step = self.reader.maybe(self.reader.number, section.get("step")) or 1
                for index in range(slots):
                    free(first + step * index, f"{name} {index + 1}", node)
                return first, step
            return 0, 1

        return StatusBits(
            size=size,
            any_error=single("any_error"),
            network=single("network"),
            resource=single("resource"),
            ready=single("ready"),
            done=many("done"),
            error=many("error"),
        )

    def _outcomes(self) -> dict[str, JobOutcome]:
        outcomes = {}
        for entry in self._entries("outcomes"):
            with self.reader.going_on():
                word = self.reader.expression(self._needed(entry, "word"))
                for name in sorted(names_in(word.root) - {"code"}):
                    self.reader.note(entry.value.at, f"an outcome does not know '{name}'", "use code, or a number")
                completed = self.reader.flag(self.reader.mapping(entry.value).get("completed"))
                outcomes[entry.key.text] = JobOutcome(word=word, completed=completed)
        if OTHERWISE not in outcomes and self.root.get("outcomes") is not None:
            raise Broken("the schema asks for an outcome for all others")
        return outcomes

    def _codes(self) -> dict[int, Major]:
        lists = {entry.key.text: self._minors(entry.value) for entry in self._entries("minors")}
        codes = {}
        for entry in self._entries("codes"):
            with self.reader.going_on():
                keys = self.reader.mapping(entry.value)
                minors: MappingOf[int, Minor] = {}
                node = keys.get("minors")
                if node is not None and (name := self.reader.text(node)) in lists:
                    minors = lists[name]
                elif node is not None:
                    self.reader.unknown(node.at, "minor", self.reader.text(node), list(lists))
                code = self.reader.number(entry.key)
                if not 0 < code <= 0xFF:
                    self.reader.note(entry.key.at, f"{code} is no low byte of an answer", "give 1 to 255")
                text = self.reader.text(self._needed(entry, "text"))
                codes[code] = Major(text, self._class(keys.get("class")), minors)
        return codes

    def _minors(self, node: Node) -> dict[int, Minor]:
        minors = {}
        for entry in self.reader.entries(node):
            with self.reader.going_on():
                number = self.reader.number(entry.key)
                if not 0 < number <= 0xFF:
                    self.reader.note(entry.key.at, f"{number} is no high byte that says more", "give 1 to 255")
                if isinstance(entry.value, Scalar):
                    minors[number] = Minor(entry.value.text)
                    continue
                kind = self.reader.mapping(entry.value).get("class")
                text = self.reader.text(self._needed(entry, "text"))
                minors[number] = Minor(text, None if kind is None else self._class(kind))
        return minors

    def _events(self) -> dict[str, EventCode]:
        events = {}
        for entry in self._entries("events"):
            with self.reader.going_on():
                number = self.reader.number(self._needed(entry, "number"))
                entries = self._numbers(self.reader.mapping(entry.value).get("entries"))
                events[entry.key.text] = EventCode(number=number, entries=entries)
        return events

    # ---- scalars ------------------------------------------------------------------------------------------

    def _entries(self, key: str) -> tuple[Entry, ...]:
        return self.reader.tried(self.reader.entries, self.root.get(key)) or ()

    def _mapping(self, key: str) -> Mapping:
        node = self.root.get(key)
        return node if isinstance(node, Mapping) else Mapping((), self.root.at)

    def _needed(self, entry: Entry, key: str) -> Node:
        node = self.reader.mapping(entry.value).get(key)
        if node is None:
            raise Broken("the schema has told what is missing")
        return node

    def _text(self, key: str) -> str:
        return self.reader.maybe(self.reader.text, self.root.get(key)) or ""

    def _numbers(self, node: Node | None) -> tuple[int, ...]:
        return tuple(self.reader.number(item) for item in self.reader.items(node))

    def _number(self, key: str, default: int, least: int) -> int:
        number = self.reader.tried(partial(self._at_least, least), self.root.get(key))
        return default if number is None else number

    def _at_least(self, least: int, node: Node | None) -> int:
        number = self.reader.number(node)
        if number < least and node is not None:
            raise self.reader.broken(node.at, f"{number} is too small: {least} is the least")
        return number

    def _word(self, node: Node) -> int:
        with self.reader.going_on():
            number = self.reader.number(node)
            if not 0 < number <= 0xFFFF:
                raise self.reader.broken(node.at, f"{number} is no word that answers a command", "give 1 to 0xFFFF")
            return number
        return 1

    def _class(self, node: Node | None) -> CodeClass:
        return self.reader.one_of(node, _CLASSES, "a class")

    def _time(self, node: Node) -> int:
        time = self.reader.time(node)
        if time >= NEVER:
            raise self.reader.broken(node.at, "never is no time to wait for", "give a time such as 10 s")
        return time

    def _some_time(self, node: Node) -> int:
        time = self._time(node)
        if time <= 0:
            raise self.reader.broken(node.at, "a unit of no time counts nothing", "give a time such as 10 ms")
        return time
