"""Reads run files. Every problem of a run, of its protocols and of its memory comes at once.

Addresses of the own memory are resolved here; those of the other side are tried with the channel's protocol.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping as Mapping_
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

from framekit.blocks.block_settings import check_items
from framekit.blocks.jobs.section import JobsSection
from framekit.blocks.kept_state import read_state
from framekit.blocks.load_block import BlockLoader
from framekit.blocks.load_channel import ChannelLoader
from framekit.blocks.load_jobs_section import read_jobs
from framekit.blocks.memory_settings import read_mapping, start_value
from framekit.blocks.model import BLOCKS_IN_SET, Block, Channel, Place, Run
from framekit.blocks.never_started import never_started
from framekit.blocks.own_memory import AnyAddresses, addresses_of
from framekit.blocks.own_overlaps import overlaps
from framekit.blocks.profile_places import check_profile
from framekit.definition.load.documents import Documents
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Mapping, Node, Scalar, without
from framekit.definition.problems import DefinitionError, Problem
from framekit.link.addresses import AddressGrammar
from framekit.memory.profile import MemoryProfile, load_profile, load_profile_node


def load_run(path: Path) -> Run:
    """The run in a file. Raises DefinitionError with everything that is wrong."""
    reading = read_run(path)
    if reading.run is None:
        raise DefinitionError(reading.problems)
    return reading.run


class RunReading(NamedTuple):
    """What a file says: the run, if nothing is wrong; the channels that are all right; and every problem."""

    run: Run | None
    channels: tuple[Channel, ...]
    problems: list[Problem]


def read_run(path: Path) -> RunReading:
    """As much of the run in a file as can be read."""
    reader = Reader()
    documents = Documents(reader)
    run, loader = None, None
    with suppress(Broken):
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

    def load(self) -> Run:
        """The run. Raises Broken when its memory is none; everything else is read before that."""
        channels: dict[int, Channel] = {}
        for entry in self.reader.entries(self.root.get("channels")):
            with self.reader.going_on():
                channel = self.channels.channel(entry)
                if channel.number in channels:
                    self.reader.note(entry.key.at, f"there are two channels {channel.number}", "renumber one of them")
                channels[channel.number] = channel
        self.read_channels = tuple(channels.values())
        profile = self._profile()
        if profile is not None:
            self.reader.problems.extend([*check_items(profile.flags.values()), *check_profile(profile)])
        grammar = AnyAddresses() if profile is None else addresses_of(profile)
        channels = self._mapped(channels, grammar)
        known = {entry.key.text for entry in self.reader.entries(self.root.get("channels"))}
        jobs = self._jobs(grammar)
        if self.root.get("channels") is None and (jobs is None or (jobs != "wrong" and jobs.opening is None)):
            self.reader.note(self.root.at, "missing key 'channels' in a run file", "add it")
        blocks = BlockLoader(self.reader, grammar, channels, known, self.root, jobs, self.path.parent)
        initial, found, sets = self._initial(grammar), self._blocks(blocks), self._sets()
        state = self.reader.maybe(lambda node: read_state(self.reader, node, profile), self.root.get("state"))
        status = self.reader.flag(self.root.get("status"), default=True)
        if profile is None:
            raise Broken("memory")
        self._look_at(found, channels, profile, status)
        return Run(
            name=self._text("run"),
            about=self._text("about"),
            memory=profile,
            initial=initial,
            channels=channels,
            blocks=found,
            sets=sets,
            folder=str(self.path.parent),
            state=state,
            status=status,
            jobs=None if jobs == "wrong" else jobs,
            warnings=tuple(self._warnings()),
            at=self.root.at,
        )

    def _look_at(
        self, blocks: Sequence[Block], channels: Mapping_[int, Channel], profile: MemoryProfile, status: bool
    ) -> None:
        """What is strange about blocks beside each other, where everything else is all right."""
        if any(not problem.warning for problem in self.reader.problems):
            return
        self.reader.problems.extend(never_started(blocks))
        on = {number for number, enabled in self._sets().items() if enabled}
        at_work = [block for block in blocks if block.enabled and block.set in on]
        self.reader.problems.extend(overlaps(at_work, channels, tuple(profile.flags.values()) if status else ()))

    def _mapped(self, channels: dict[int, Channel], grammar: AddressGrammar) -> dict[int, Channel]:
        """The channels with the places that areas of their protocols have in the own memory."""
        found = dict(channels)
        for entry in self.reader.entries(self.root.get("channels")):
            node = entry.value.get("map") if isinstance(entry.value, Mapping) else None
            for number, channel in channels.items():
                if node is not None and str(number) == entry.key.text:
                    mapping = read_mapping(self.reader, node, channel.protocol, grammar)
                    found[number] = replace(channel, mapping=mapping)
        return found

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
        """The own memory; None when it is none, which is noted."""
        node = self.root.get("memory")
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
        """The jobs section; when it is wrong, what blocks say of jobs means nothing."""
        node = self.root.get("jobs")
        with self.reader.going_on():
            return None if node is None else read_jobs(self.reader, node, self.path.parent, grammar, self.channels)
        return "wrong"

    def _initial(self, grammar: AddressGrammar) -> tuple[tuple[Place, tuple[int, ...]], ...]:
        memory = self.root.get("memory")
        entries = self.reader.entries(memory.get("set")) if isinstance(memory, Mapping) else ()
        entries += self.reader.entries(self.root.get("set"))
        return tuple(value for entry in entries if (value := start_value(self.reader, grammar, entry)) is not None)

    # ---- blocks -------------------------------------------------------------------------------------------

    def _blocks(self, loader: BlockLoader) -> tuple[Block, ...]:
        """The blocks of all sets; `blocks` of the run itself are those of set 1."""
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
        """The blocks of one parameter set."""
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
        """Which parameter sets there are, and whether they are enabled from the start."""
        found = {1: True} if self.root.get("blocks") is not None or self.root.get("sets") is None else {}
        for entry in self.reader.entries(self.root.get("sets")):
            keys = entry.value if isinstance(entry.value, Mapping) else None
            if entry.key.text.isdigit():
                on = keys is None or self.reader.flag(keys.get("enabled"), default=True)
                found.setdefault(int(entry.key.text), on)
        return found
