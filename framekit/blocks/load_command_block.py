"""Reads blocks that carry out a command block of the own memory: where its words are, and what reads them.

The application of commands is named on the block, its channel or the run, else by the channel's protocol.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from framekit.blocks.bound_commands import commands_for
from framekit.blocks.model import Channel, Place
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import Mapping, Node
from framekit.definition.problems import DefinitionError, Problem


class CommandBlockLoader:
    """Reads them; `place` reads a place of the own memory in a unit, `written` one that is to be written."""

    def __init__(
        self, reader: Reader, folder: Path, root: Mapping,
        place: Callable[[Node, str | None], Place], written: Callable[[Node, str | None], Place],
    ) -> None:  # fmt: skip
        self.reader = reader
        self.folder = folder
        self._root = root
        self._place = place
        self._written = written
        self._found: dict[tuple[str, str], Protocol | None] = {}

    def read(self, keys: Mapping, channel: Channel) -> dict[str, Any]:
        """What a block with `command:` has of its own. Raises Broken."""
        node, fault = keys.get("command"), keys.get("fault")
        assert node is not None
        place = self._place(node, "word")
        return {
            "places": (place,),
            "targets": (place.text,),
            "commands": self._application(keys, channel, node),
            "fault": None if fault is None else self._written(fault, "bit"),
        }

    def _application(self, keys: Mapping, channel: Channel, block: Node) -> Protocol:
        of_channel = self._of_channel(channel)
        named = next((node for node in (keys.get("commands"), of_channel, self._root.get("commands")) if node), None)
        name = "" if named is None else self.reader.text(named)
        known = (name, channel.protocol.name)
        if known not in self._found:
            self._found[known] = None
            at = block.at if named is None else named.at
            try:
                self._found[known] = commands_for(channel.protocol, name or None, self.folder, at)
            except DefinitionError as error:
                for problem in error.problems:
                    there = problem.at.file != name
                    self.reader.problems.append(problem if there else Problem(at, problem.what, problem.todo))
        found = self._found[known]
        if found is None:
            raise Broken(name)
        return found

    def _of_channel(self, channel: Channel) -> Node | None:
        for entry in self.reader.entries(self._root.get("channels")):
            if entry.key.at == channel.at and isinstance(entry.value, Mapping):
                return entry.value.get("commands")
        return None
