"""CALL blocks: a service of the channel's protocol, and the arguments that it takes."""

from __future__ import annotations

from typing import Any

from framekit.blocks.attempts import Attempts
from framekit.blocks.model import Channel
from framekit.definition.load.reader import Reader
from framekit.definition.model.services import ServiceRow
from framekit.definition.nodes import Entry, Mapping
from framekit.definition.problems import Position, did_you_mean


class CallLoader:
    """Reads what such a block has of its own."""

    def __init__(self, reader: Reader, attempts: Attempts) -> None:
        self.reader = reader
        self.attempts = attempts

    def read(self, keys: Mapping, channel: Channel) -> dict[str, Any]:
        """A service and its arguments. Raises Broken."""
        reader = self.reader
        node = keys.get("call")
        name = reader.text(node)
        at = keys.at if node is None else node.at
        rows = channel.protocol.services.get(name)
        if rows is None:
            hint = did_you_mean(name, channel.protocol.services)
            raise reader.broken(at, f"'{channel.protocol.name}' has no service '{name}'", hint)
        entries = reader.entries(keys.get("with"))
        self._arguments(name, rows, entries, at)
        return {
            "service": name,
            "arguments": {
                entry.key.text: value
                for entry in entries
                if (value := self.attempts.maybe(self.reader.constant, entry.value)) is not None
            },
        }

    def _arguments(self, service: str, rows: tuple[ServiceRow, ...], entries: tuple[Entry, ...], at: Position) -> None:
        """Arguments there are, with all that have no default."""
        if service in ("read", "write") or any(row.most_variables for row in rows):
            return
        known = {argument.name for row in rows for argument in row.takes}
        given = {entry.key.text for entry in entries}
        for entry in entries:
            if entry.key.text not in known:
                hint = did_you_mean(entry.key.text, known) or "leave it out"
                self.reader.note(entry.key.at, f"'{service}' takes no '{entry.key.text}'", hint)
        if len(rows) == 1 and given <= known:
            for argument in rows[0].takes:
                if argument.default is None and argument.name not in given:
                    self.reader.note(at, f"'{service}' is called without '{argument.name}'", "add it to with:")
