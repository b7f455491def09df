"""What a block with a command does on its channel: the words in its memory are carried out.

What the words mean is the application's (see `commands`); who starts the block is not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from framekit.blocks.block_status import Failure
from framekit.blocks.commands import CommandBlocks, CommandEnd
from framekit.blocks.model import Block
from framekit.blocks.operations import ParamsOf
from framekit.blocks.own_memory import store_pieces
from framekit.codec.codec import compile_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER
from framekit.link.engine import Engine
from framekit.link.events import Command
from framekit.link.services.client import Client
from framekit.memory.memory import DeviceMemory

if TYPE_CHECKING:
    from framekit.blocks.transfer import Ended

Later = Callable[[int, Callable[[], None]], None]
"""Calls something back after so many nanoseconds."""


class CommandTransfers:
    """Starts the command blocks of one channel."""

    def __init__(
        self, engine: Engine, client: Client | None, memory: DeviceMemory, mapping: Mapping[str, tuple[str, int]],
        later: Later | None, params_of: ParamsOf | None,
    ) -> None:  # fmt: skip
        self._engine = engine
        self._client = client
        self._memory = memory
        self._mapping = mapping
        self._later = later
        self._params_of = params_of
        self._commands: dict[str, CommandBlocks] = {}

    def start(self, block: Block, station: Any, now: int, ended: Ended) -> list[Command]:
        """The words of a command block are copied now; what happens to them later changes nothing."""
        assert block.commands is not None
        commands, place = self.commands_of(block.commands), block.places[0]
        area = self._memory.area(place.address.area)
        first = place.address.first_bit // 8
        data = area.read_bytes(first, min(2 * commands.rules.most, area.size_bytes - first))
        over = False

        def late() -> None:
            if not over:
                self._show_fault(block, True)

        def done(end: CommandEnd) -> None:
            nonlocal over
            over = True
            if end.fault:
                self._show_fault(block, True)
                ended(Failure(outcome="cannot_send", cause=end.fault))
            else:
                ended(end.failure)

        self._show_fault(block, False)
        waits = commands.waits_for(data)
        if waits <= 0:
            late()
        elif waits < NEVER and self._later is not None:
            self._later(waits, late)
        return commands.start(data, station, now, done, lambda station: self._params(block, station))

    def _params(self, block: Block, station: Any) -> dict[str, Any]:
        """What the channel says for a station, and the block does not."""
        given = {} if self._params_of is None else self._params_of(station)
        return {name: value for name, value in given.items() if name not in block.params}

    def commands_of(self, application: Protocol) -> CommandBlocks:
        """The command blocks of an application on this channel."""
        found = self._commands.get(application.name)
        if found is None or found.words.application != application:
            found = self._commands[application.name] = CommandBlocks(
                application,
                compile_protocol(application),
                self._memory,
                channel=self._engine.scope,
                engine=self._engine,
                client=self._client,
                mapping={name: place for name, place in self._mapping.items() if name in application.areas},
            )
        return found

    def _show_fault(self, block: Block, fault: bool) -> None:
        if block.fault is not None:
            store_pieces(self._memory, [(block.fault, 1, bytes([fault]))])
