"""Reads run files. Every problem of a run, of its protocols and of its memory comes at once.

Addresses of the own memory are resolved here; those of the other side are tried with the channel's protocol.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from framekit.blocks.device import start_value, without
from framekit.blocks.given import read_params, read_station
from framekit.blocks.load_block import BlockLoader
from framekit.blocks.model import Block, Channel, Place, Run
from framekit.definition.load.documents import Documents
from framekit.definition.load.library import load_protocol
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import Entry, Mapping, Node, Scalar
from framekit.definition.problems import DefinitionError, Problem, did_you_mean
from framekit.definition.times import LineFormat, parse_format
from framekit.link.addresses import AddressGrammar
from framekit.memory.load import load_profile, load_profile_node
from framekit.memory.profile import MemoryProfile

MOST_BLOCKS, MOST_SETS = 64, 8


def load_run(path: Path) -> Run:
    """The run in a file. Raises DefinitionError with everything that is wrong."""
    reader = Reader()
    documents = Documents(reader)
    run = None
    with suppress(Broken):
        run = RunLoader(reader, path, documents.root(path, "run")).load()
    problems = documents.first_words(reader.problems)
    if run is None or any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return run


class RunLoader:
    """Reads one run. Problems go to the reader."""

    def __init__(self, reader: Reader, path: Path, root: Mapping) -> None:
        self.reader = reader
        self.path = path
        self.root = root
        self.protocols: dict[str, Protocol | None] = {}

    def load(self) -> Run:
        profile = self._profile()
        grammar = AddressGrammar(profile.addresses, profile.areas, profile.tables)
        channels: dict[int, Channel] = {}
        for entry in self.reader.entries(self.root.get("channels")):
            with self.reader.going_on():
                channel = self._channel(entry)
                channels[channel.number] = channel
        known = {entry.key.text for entry in self.reader.entries(self.root.get("channels"))}
        blocks = BlockLoader(self.reader, grammar, channels, known)
        return Run(
            name=self._text("run"),
            about=self._text("about"),
            memory=profile,
            initial=self._initial(grammar),
            channels=channels,
            blocks=self._blocks(blocks),
            folder=str(self.path.parent),
            warnings=tuple(self._warnings()),
            at=self.root.at,
        )

    def _text(self, key: str) -> str:
        node = self.root.get(key)
        return node.text if isinstance(node, Scalar) else ""

    def _warnings(self) -> list[Problem]:
        found = [problem for problem in self.reader.problems if problem.warning]
        for protocol in self.protocols.values():
            found.extend(protocol.warnings if protocol is not None else ())
        return found

    # ---- memory -------------------------------------------------------------------------------------------

    def _profile(self) -> MemoryProfile:
        node = self.root.get("memory")
        if node is None:
            raise self.reader.broken(
                self.root.at, "the run has no memory", "add memory: with a profile's name or areas"
            )
        try:
            if isinstance(node, Mapping):
                return load_profile_node(without(node, "set"), self.path.parent)
            return load_profile(self.reader.text(node), self.path.parent, node.at)
        except DefinitionError as error:
            self.reader.problems.extend(error.problems)
            raise Broken("memory") from None

    def _initial(self, grammar: AddressGrammar) -> tuple[tuple[Place, tuple[int, ...]], ...]:
        memory = self.root.get("memory")
        entries = self.reader.entries(memory.get("set")) if isinstance(memory, Mapping) else ()
        entries += self.reader.entries(self.root.get("set"))
        return tuple(value for entry in entries if (value := start_value(self.reader, grammar, entry)) is not None)

    # ---- channels -----------------------------------------------------------------------------------------

    def _channel(self, entry: Entry) -> Channel:
        reader, keys = self.reader, self.reader.mapping(entry.value)
        protocol = self._protocol(keys)
        role = reader.maybe(reader.text, keys.get("role"))
        if protocol.roles:
            role = role or next((name for name in ("client", "master", "full") if name in protocol.roles), None)
            if role not in protocol.roles:
                at = keys.get("role") or entry.key
                raise reader.broken(
                    at.at, f"'{protocol.name}' has no role '{role}'", did_you_mean(role or "", protocol.roles)
                )
        pause = keys.get("pause")
        return Channel(
            number=reader.number(entry.key),
            port=reader.text(keys.get("port")),
            protocol=protocol,
            role=role,
            line=self._line(keys, protocol),
            own=self._station(keys.get("own"), protocol),
            station=self._station(keys.get("station"), protocol),
            params=read_params(reader, reader.entries(keys.get("params")), protocol),
            pause=0 if pause is None else reader.time(pause),
            at=entry.key.at,
        )

    def _protocol(self, keys: Mapping) -> Protocol:
        node = keys.get("protocol")
        if node is None:
            raise Broken("the schema asks for a protocol")
        name = self.reader.text(node)
        if name not in self.protocols:
            self.protocols[name] = None
            try:
                self.protocols[name] = load_protocol(self._beside(name), self.path.parent)
            except DefinitionError as error:
                for problem in error.problems:
                    there = problem.at.file != name
                    self.reader.problems.append(problem if there else Problem(node.at, problem.what, problem.todo))
        protocol = self.protocols[name]
        if protocol is None:
            raise Broken(name)
        return protocol

    def _beside(self, name: str) -> str | Path:
        file = self.path.parent / name
        return file if file.suffix == ".yaml" and file.is_file() else name

    def _line(self, keys: Mapping, protocol: Protocol) -> LineFormat | None:
        """The speed and format of the channel; the protocol's own where the run says nothing. None for a stream."""
        reader, line = self.reader, protocol.line
        if line.kind == "stream":
            return None
        speed_node, format_node = keys.get("speed"), keys.get("format")
        speed = line.speed if speed_node is None else reader.number(speed_node)
        if speed_node is not None and line.speeds and speed not in line.speeds:
            hint = "choose one of " + ", ".join(map(str, line.speeds))
            reader.warn(speed_node.at, f"'{protocol.name}' does not list a speed of {speed}", hint)
        text = line.format if format_node is None else reader.text(format_node)
        try:
            return parse_format(text, speed)
        except ValueError as error:
            what, _, todo = str(error).partition(" – ")
            raise reader.broken((format_node or speed_node or keys).at, what, todo) from None

    def _station(self, node: Node | None, protocol: Protocol) -> Any:
        """A station in the form the protocol wants; None when nothing is given."""
        return None if node is None else read_station(self.reader, node, protocol)

    # ---- blocks -------------------------------------------------------------------------------------------

    def _blocks(self, loader: BlockLoader) -> tuple[Block, ...]:
        entries = self.reader.entries(self.root.get("blocks"))
        found = []
        for entry in entries:
            with self.reader.going_on():
                number = self.reader.number(entry.key)
                if not 0 <= number < MOST_BLOCKS:
                    raise self.reader.broken(
                        entry.key.at, f"there is no block {number}", f"blocks are numbered 0 to {MOST_BLOCKS - 1}"
                    )
                found.append(loader.block(number, 1, entry))
        loader.check_ends(
            {block.number for block in found} | {int(e.key.text) for e in entries if e.key.text.isdigit()}
        )
        return tuple(found)
