"""CALL blocks: a service of the channel's protocol, and the arguments that it takes."""

from __future__ import annotations

from typing import Any

from framekit.blocks.attempts import Attempts
from framekit.blocks.given import raw_value
from framekit.blocks.model import Channel
from framekit.definition.load.reader import Reader
from framekit.definition.model.services import ServiceRow
from framekit.definition.nodes import Entry, Mapping
from framekit.definition.problems import Position, did_you_mean, listed
from framekit.link.parameters import ParameterError
from framekit.link.service_arguments import TYPES, checked


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
        arguments: dict[str, Any] = {}
        for entry in entries:
            with reader.going_on():
                arguments[entry.key.text] = self._value(rows, entry)
        return {"service": name, "arguments": arguments}

    def _value(self, rows: tuple[ServiceRow, ...], entry: Entry) -> Any:
        """A value as the argument of that name takes it, where all rows agree on that. Raises Broken."""
        taken = [argument for row in rows for argument in row.takes if argument.name == entry.key.text]
        if not taken or taken[0].type not in TYPES or any(one.type != taken[0].type for one in taken):
            return self.reader.constant(entry.value)
        value = raw_value(self.reader, entry.value)
        try:
            checked(taken[0], value)
        except ParameterError as error:
            if len(taken) == 1:
                what, _, todo = str(error).replace("parameter", "argument", 1).partition(" – ")
                raise self.reader.broken(entry.value.at, what, todo) from None
        return value

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
            missing = [f"'{one.name}'" for one in rows[0].takes if one.default is None and one.name not in given]
            if missing:
                todo = f"add {'it' if len(missing) == 1 else 'them'} to with:"
                self.reader.note(at, f"'{service}' is called without {listed(missing)}", todo)
