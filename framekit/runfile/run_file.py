"""Read run files. All problems of a run, of its protocols and of its memory are reported at once.

After all sections, blocks are checked against each other: places that several blocks store into, and blocks that wait
for each other to end.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Sequence
from collections.abc import Mapping as MappingOf
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

from framekit.definition.load.documents import Documents
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Mapping, Node, Scalar, without
from framekit.definition.problems import NOWHERE, DefinitionError, Problem, did_you_mean
from framekit.definition.sources import edited_texts
from framekit.definition.times import MOST_STATIONS
from framekit.link.addresses import AddressGrammar
from framekit.memory.profile import BlockWords, MemoryProfile, load_profile, load_profile_node
from framekit.run.block_words import check_items, status_sections, words_of
from framekit.run.model import (
    BLOCKS_IN_SET,
    Block,
    Channel,
    JobsSection,
    KeptState,
    OwnPlace,
    RunModel,
)
from framekit.run.own_memory import AnyAddresses, OwnAddresses, addresses_of, stored_by
from framekit.runfile.blocks import BlockLoader
from framekit.runfile.channels import ChannelLoader
from framekit.runfile.devices import check_profile, start_values
from framekit.runfile.points import PointsLoader
from framekit.runfile.ports import doubled_ports
from framekit.runfile.sinks import SinksLoader
from framekit.table_of_extras import SECTIONS, load


def load_run(path: Path, text: str | None = None) -> RunModel:
    """Return the run in a file; `text` replaces its content. Raise DefinitionError with all problems."""
    reading = read_run(path, text)
    if reading.run is None:
        raise DefinitionError(reading.problems)
    return reading.run


class RunReading(NamedTuple):
    """The result of reading a file: the run, or None if it has errors; the channels whose protocols are known, also
    those with errors; and all problems.
    """

    run: RunModel | None
    channels: tuple[Channel, ...]
    problems: list[Problem]


def read_run(path: Path, text: str | None = None) -> RunReading:
    """Read as much as possible of the run in a file; `text` replaces its content."""
    reader = Reader()
    documents = Documents(reader)
    run, loader = None, None
    with edited_texts({} if text is None else {path: text}), suppress(Broken):
        loader = RunLoader(reader, path, documents.root(path, "run"))
        run = loader.load()
    problems = documents.first_words(reader.problems, path)
    if any(not problem.warning for problem in problems):
        run = None
    return RunReading(run, () if loader is None else loader.read_channels, problems)


class RunLoader:
    """Reads one run. Problems go to the reader."""

    def __init__(self, reader: Reader, path: Path, root: Mapping) -> None:
        self.reader = reader
        self.path = path
        self.root = root
        self.channels = ChannelLoader(reader, path.parent, root)
        self.read_channels: tuple[Channel, ...] = ()

    def load(self) -> RunModel:
        """Return the run. Read everything else before raising Broken for an invalid memory."""
        profile = self._profile()
        if profile is not None:
            self.reader.problems.extend([*check_items(profile.flags.values()), *check_profile(profile)])
        grammar = AnyAddresses() if profile is None else addresses_of(profile)
        channels = self._channels(grammar)
        known = {entry.key.text for entry in self.reader.entries(self.root.get("channels"))}
        jobs = self._jobs(grammar)
        if self.root.get("channels") is None and (jobs is None or (jobs != "wrong" and jobs.opening is None)):
            self.reader.note(self.root.at, "missing key 'channels' in a run file", "add it")
        own_bits: list[str] = []
        if profile is not None:
            own_bits = [*(clock.address for clock in profile.clocks), *(bit.address for bit in profile.fixed)]
        broken = self.channels.broken
        blocks = BlockLoader(self.reader, grammar, channels, known, self.root, jobs, self.path.parent, own_bits, broken)
        memory = self.root.get("memory")
        first = memory.get("set") if isinstance(memory, Mapping) else None
        initial = tuple(
            one for node in (first, self.root.get("set")) for one in start_values(self.reader, grammar, node)
        )
        found, sets = self._blocks(blocks), self._sets()
        points = PointsLoader(self.reader, self.path.parent, grammar, channels, found, known, self.channels.broken)
        named, reads, points_words = points.load(self.root.get("points"))
        state = self.reader.tried(lambda node: read_state(self.reader, node, profile), self.root.get("state"))
        status = self.reader.tried(self.reader.flag, self.root.get("status")) is not False
        written = named if points.is_complete else None
        sinks = SinksLoader(self.reader, self.path, written, points.names, "" if state is None else state.file)
        sink_kinds = sinks.load(self.root.get("sinks"))
        fleet = self.reader.tried(
            lambda node: load(SECTIONS["fleet"])(self.reader, node, self.path.parent), self.root.get("fleet")
        )
        self.reader.problems.extend(doubled_ports(self.read_channels, sink_kinds))
        if profile is None:
            raise Broken("memory")
        self._look_at(found, channels, profile, status)
        return RunModel(
            name=self._text("run"),
            about=self._text("about"),
            memory=profile,
            initial=initial,
            channels=channels,
            blocks=(*found, *reads),
            sets=sets,
            points=named,
            sinks=sink_kinds,
            files=tuple(sinks.taken),
            fleet=fleet,
            points_words=points_words,
            folder=str(self.path.parent),
            state=state,
            status=status,
            jobs=None if jobs == "wrong" else jobs,
            warnings=tuple(self._warnings()),
            at=self.root.at,
        )

    def _channels(self, grammar: OwnAddresses) -> dict[int, Channel]:
        """Return the channels by number, without those that have an error."""
        channels: dict[int, Channel] = {}
        for entry in self.reader.entries(self.root.get("channels")):
            with self.reader.going_on():
                channel = self.channels.channel(entry, grammar)
                if channel.number in channels:
                    self.reader.note(entry.key.at, f"there are two channels {channel.number}", "renumber one of them")
                channels[channel.number] = channel
        broken = (one for number, one in self.channels.broken.items() if number not in channels)
        self.read_channels = tuple(sorted((*channels.values(), *broken), key=lambda channel: channel.at))
        return channels

    def _look_at(
        self, blocks: Sequence[Block], channels: MappingOf[int, Channel], profile: MemoryProfile, status: bool
    ) -> None:
        """Warn about conflicts between blocks, if no errors have been found so far."""
        if any(not problem.warning for problem in self.reader.problems):
            return
        self.reader.problems.extend(never_started(blocks))
        on = {number for number, enabled in self._sets().items() if enabled}
        at_work = [block for block in blocks if block.enabled and block.set in on]
        self.reader.problems.extend(overlaps(at_work, channels, tuple(profile.flags.values()) if status else ()))
        self.reader.problems.extend(too_many_stations(blocks, channels))

    def _text(self, key: str) -> str:
        node = self.root.get(key)
        return node.text if isinstance(node, Scalar) else ""

    def _warnings(self) -> list[Problem]:
        found = [problem for problem in self.reader.problems if problem.warning]
        for protocol in self.channels.protocols.values():
            found.extend(protocol.warnings if protocol is not None else ())
        return found

    # ---- memory -------------------------------------------------------------------------------------------

    def _profile(self) -> MemoryProfile | None:
        """Return the own memory, or None if it is invalid, which is noted."""
        node = self.root.get("memory")
        if node is None and "points" in self.root and "blocks" not in self.root and "sets" not in self.root:
            return WITHOUT_MEMORY
        if node is None:
            misspelt = difflib.get_close_matches("memory", [entry.key.text for entry in self.root.entries])
            if not misspelt:
                self.reader.note(self.root.at, "the run has no memory", "add memory: with a profile's name or areas")
            return None
        try:
            if isinstance(node, Mapping):
                if (sizes := node.get("sizes")) is not None:
                    self.reader.note(sizes.at, "sizes are for devices, a run has a memory of its own", "say them there")
                return load_profile_node(without(without(node, "set"), "sizes"), self.path.parent)
            return load_profile(self.reader.text(node), self.path.parent, node.at)
        except DefinitionError as error:
            self.reader.problems.extend(error.problems)
            return None

    def _jobs(self, grammar: AddressGrammar) -> JobsSection | Literal["wrong"] | None:
        """Return the jobs section; "wrong" if it is invalid, so that blocks report no consequential errors."""
        node = self.root.get("jobs")
        with self.reader.going_on():
            if node is None:
                return None
            read: Callable[..., JobsSection] = load(SECTIONS["jobs"])
            return read(self.reader, node, self.path.parent, grammar, self.channels)
        return "wrong"

    # ---- blocks -------------------------------------------------------------------------------------------

    def _blocks(self, loader: BlockLoader) -> tuple[Block, ...]:
        """Return the blocks of all sets; the key `blocks` of the run is set 1."""
        found = self._set(loader, 1, self.root.get("blocks"))
        for entry in self.reader.entries(self.root.get("sets")):
            with self.reader.going_on():
                number = self.reader.number(entry.key)
                if number == 1 and self.root.get("blocks") is not None:
                    what = "the blocks of the run are set 1 already"
                    raise self.reader.broken(entry.key.at, what, "number this set otherwise, or move them into it")
                found += self._set(loader, number, self.reader.mapping(entry.value).get("blocks"))
        return tuple(found)

    def _set(self, loader: BlockLoader, set_number: int, node: Node | None) -> list[Block]:
        """Return the blocks of one parameter set."""
        found = []
        numbers: set[int] = set()
        for entry in self.reader.entries(node):
            with self.reader.going_on():
                number = self.reader.number(entry.key)
                if not 0 <= number < BLOCKS_IN_SET:
                    raise self.reader.broken(
                        entry.key.at, f"there is no block {number}", f"blocks are numbered 0 to {BLOCKS_IN_SET - 1}"
                    )
                if number in numbers:
                    raise self.reader.broken(entry.key.at, f"there are two blocks {number}", "renumber one of them")
                numbers.add(number)
                found.append(loader.block(number, set_number, entry))
        loader.triggers.check_ends(numbers)
        return found

    def _sets(self) -> dict[int, bool]:
        """Return the parameter sets by number, each with whether it is enabled at the start."""
        found = {1: True} if self.root.get("blocks") is not None or self.root.get("sets") is None else {}
        for entry in self.reader.entries(self.root.get("sets")):
            keys = entry.value if isinstance(entry.value, Mapping) else None
            if entry.key.text.isdigit():
                on = keys is None or self.reader.flag(keys.get("enabled"), default=True)
                found.setdefault(int(entry.key.text), on)
        return found


WITHOUT_MEMORY = MemoryProfile(
    name="none", about="A run of points alone has no memory of its own.", source="", areas={}, tables={}, addresses=(),
    clocks=(), fixed=(), scan=10_000_000, named={}, flags={}, at=NOWHERE,
)  # fmt: skip
EVERY, SHORTEST = 1_000_000_000, 100_000_000


# ---- state file of a run -----------------------------------------------------------------------------------


def read_state(reader: Reader, node: Node, profile: MemoryProfile | None) -> KeptState:
    """Return where and how often the run saves its state. Raise Broken if the file or a time is invalid; note the rest.

    Without a memory profile no areas are saved.
    """
    keys = node if isinstance(node, Mapping) else None
    file = reader.text(node if keys is None else keys.get("file"))
    areas = () if profile is None else _areas(reader, None if keys is None else keys.get("keep"), profile)
    every = None if keys is None else reader.maybe(lambda time: _time(reader, time), keys.get("every"))
    return KeptState(file=file, areas=areas, every=every or EVERY, at=node.at)


def _areas(reader: Reader, node: Node | None, profile: MemoryProfile) -> tuple[str, ...]:
    """Return the names of the saved areas."""
    if node is None:
        return retained(profile)
    areas = []
    for item in reader.items(node):
        with reader.going_on():
            areas.append(_area(reader, item, profile))
    return tuple(areas)


def retained(profile: MemoryProfile) -> tuple[str, ...]:
    """Return the areas that a profile marks as retained; if it marks no area, all areas with write access."""
    named = tuple(area.name for area in profile.areas.values() if area.retained)
    return named or tuple(area.name for area in profile.areas.values() if area.access == "rw")


def _area(reader: Reader, node: Node, profile: MemoryProfile) -> str:
    name = reader.text(node)
    for area in profile.areas.values():
        if name == area.name or name in area.aliases:
            return area.name
    todo = did_you_mean(name, profile.areas) or f"known: {', '.join(sorted(profile.areas))}"
    raise reader.broken(node.at, f"the memory has no area '{name}'", todo)


def _time(reader: Reader, node: Node) -> int:
    every = reader.time(node)
    if every < SHORTEST:
        raise reader.broken(node.at, "a file is not written more often than every 100 ms", "write it like 1 s")
    return every


# ---- places that several blocks store into -------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Stored:
    """A span of `bits` bits from a place on, into which a block stores."""

    block: Block
    place: OwnPlace
    first: int
    bits: int

    @property
    def end(self) -> int:
        return self.first + self.bits

    def __str__(self) -> str:
        count = -(-self.bits // self.place.address.unit_bits)
        return self.place.text if count == 1 else f"{self.place.text} ({count} × {self.place.address.unit})"


def overlaps(
    blocks: Sequence[Block], channels: MappingOf[int, Channel], sections: Sequence[BlockWords] = ()
) -> Iterator[Problem]:
    """Yield a warning for each pair of blocks that store into one place, and for blocks that overwrite status words.

    `sections`: the status words of blocks in the memory, if the run shows them.
    """
    stored: dict[str, list[_Stored]] = {}
    for block in blocks:
        frames = channels[block.channel].protocol.frames if block.frame is not None else {}
        for place, bits in stored_by(block, frames):
            one = _Stored(block, place, place.address.first_bit, bits)
            stored.setdefault(place.address.area, []).append(one)
    shown = _shown(blocks, sections)
    for area, found in stored.items():
        found.sort(key=lambda one: (one.first, one.block.id))
        yield from _pairs(found)
        yield from _over_words(found, shown.get(area, []))


def _pairs(found: list[_Stored]) -> Iterator[Problem]:
    """Yield a warning for each overlapping pair of blocks, once; `found` is sorted by address."""
    reported: set[frozenset[int]] = set()
    for at, one in enumerate(found):
        for other in found[at + 1 :]:
            if other.first >= one.end:
                break
            pair = frozenset((one.block.id, other.block.id))
            if len(pair) == 2 and pair not in reported and _spoils(one, other):
                reported.add(pair)
                first, second = sorted((one, other), key=lambda stored: stored.block.id)
                places = " and ".join(dict.fromkeys((str(first), str(second))))
                what = f"blocks {first.block.label} and {second.block.label} store in one place: {places}"
                yield Problem(second.block.at, what, "move one of them", warning=True)


def _spoils(one: _Stored, other: _Stored) -> bool:
    """Return whether two blocks disturb each other: different spans, or the same span and both run in cycles."""
    if (one.first, one.bits) != (other.first, other.bits):
        return True
    return all(any(trigger.is_cycle for trigger in stored.block.triggers) for stored in (one, other))


def _over_words(found: list[_Stored], shown: list[tuple[int, int, Block]]) -> Iterator[Problem]:
    for one in found:
        for first, end, block in shown:
            if one.first < end and first < one.end:
                what = f"block {one.block.label} stores in {one.place.text}, where the state of block {block.label} "
                yield Problem(one.block.at, what + "is shown", "name another place", warning=True)
                break


def _shown(blocks: Sequence[Block], sections: Sequence[BlockWords]) -> dict[str, list[tuple[int, int, Block]]]:
    """Return the spans of the status words of blocks: area → first bit, end, block."""
    found: dict[str, list[tuple[int, int, Block]]] = {}
    for block in blocks:
        for section, word in words_of(status_sections(sections), (block.set, block.number)):
            found.setdefault(section.area, []).append((16 * word, 16 * (word + section.words), block))
    return found


# ---- blocks that wait for each other to end ------------------------------------------------------------------


def never_started(blocks: Sequence[Block]) -> Iterator[Problem]:
    """Yield a warning for each block that only starts after blocks that wait for it or for each other.

    A block without triggers can be started by hand, so its followers can start too. A receiving block acts by itself.
    """
    waiting = {
        block.id: block
        for block in blocks
        if block.triggers and all(trigger.follows is not None for trigger in block.triggers)
    }
    while reached := [one for one in waiting.values() if any(before not in waiting for before in _before(one))]:
        for block in reached:
            del waiting[block.id]
    for block in waiting.values():
        numbers = [trigger.follows[0] for trigger in block.triggers if trigger.follows is not None]
        others = " or ".join(f"block {number}" for number in dict.fromkeys(numbers))
        what = f"block {block.label} only starts behind {others}, which nothing starts"
        if {block.number} == set(numbers):
            what = f"block {block.label} only starts behind itself"
        yield Problem(block.at, what, "add once:, every: or another trigger", warning=True)


def too_many_stations(blocks: Sequence[Block], channels: MappingOf[int, Channel]) -> Iterator[Problem]:
    """Yield a problem for each channel whose blocks name more stations than its kind of line supports.

    Devices on simulated lines are counted where they are loaded. An RS-232 line may lead to a converter to RS-485: a
    warning, unless that line has no room for them either.
    """
    for channel in channels.values():
        kind = channel.wiring.type
        if kind is None or channel.port.startswith("sim:"):
            continue
        count = len({block.station for block in blocks if block.channel == channel.number} - {None})
        room = f"{MOST_STATIONS[kind]}"
        with_converter = MOST_STATIONS["rs485" if kind == "rs232" else kind]
        if count > MOST_STATIONS[kind]:
            is_possible = count <= with_converter
            if kind == "rs232" and not is_possible:
                room += f", and with a converter {with_converter}"
            what = f"blocks name {count} stations on one {kind} line, which has room for {room}"
            todo = "use type: rs485, or more channels" if count <= MOST_STATIONS["rs485"] else "use more channels"
            yield Problem(channel.port_at, what, todo, warning=is_possible)


def _before(block: Block) -> Iterator[int]:
    """Yield the ids of the blocks after which a block starts."""
    for trigger in block.triggers:
        if trigger.follows is not None:
            yield block.id - block.number + trigger.follows[0]


# ---- read-only runs --------------------------------------------------------------------------------------------


WRITES = {
    "write": "writes into the other side",
    "send": "sends a frame, which may write",
    "call": "calls a service, which may write",
    "command": "carries out commands, which may write",
    "job": "begins a job, which may write",
}
"""The effect of each instruction that a read-only run must not contain."""


def only_reading(run: RunModel) -> RunModel:
    """Return the same run in read-only form: clients of its channels cannot write, and its points are not writable.

    Raise DefinitionError if a block or a point could write.
    """
    problems = list(_writing(run))
    if problems:
        raise DefinitionError(problems)
    channels = {number: replace(channel, read_only=True) for number, channel in run.channels.items()}
    points = tuple(replace(point, is_writable=False) for point in run.points)
    return replace(run, channels=channels, points=points, only_reads=True)


def _writing(run: RunModel) -> Iterator[Problem]:
    todo = "leave it out, or run the file without --read-only"
    of_points = {point.writer for point in run.points}
    for block in run.blocks:
        if block.instruction in WRITES and block.id not in of_points:
            yield Problem(block.at, f"block {block.number} {WRITES[block.instruction]}, and this run only reads", todo)
    for point in run.points:
        if point.writer is not None:
            what = f"point '{point.name}' can be written into a device, and this run only reads"
            yield Problem(point.at, what, "leave access: rw out, or run the file without --read-only")
