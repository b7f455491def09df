"""The exchange of a READ block with one place: what stays the same of it is worked out once.

Data go from the reply to the own memory without becoming values in between. It sends nothing itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from framekit.blocks.block_status import Failure, failure_of
from framekit.blocks.model import Block
from framekit.blocks.own_memory import piece_writer
from framekit.link.client import Client, TransferResult
from framekit.link.direct_lane import DirectLane
from framekit.link.direct_read import DirectRead
from framekit.link.events import Command
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, unit_bits

if TYPE_CHECKING:
    from framekit.blocks.transfer import Ended


class RepeatedRead:
    """The reads of one block from one station; one at a time. Raises UnknownAreaError."""

    def __init__(self, block: Block, station: Any, client: Client, lane: DirectLane, memory: DeviceMemory) -> None:
        self.block = block
        self.station = station
        self._client = client
        self._lane = lane
        self._store: Callable[[bytes], None] = piece_writer(
            memory, block.places[0], block.count * unit_bits(block.units[0])
        )
        self._ask: DirectRead | None = None
        self._ended: Ended | None = None

    @property
    def is_under_way(self) -> bool:
        """Whether somebody has still to be told of an end."""
        return self._ended is not None

    def again(self, now: int, ended: Ended) -> bytes | None:
        """What has to leave at once, if nothing but such exchanges has happened on the channel; `left_at_once` of its
        lane tells that it has. None: nothing has been done, it has to `begin`."""
        ask = self._ask
        data = None if ask is None else self._lane.again(ask, now)
        if data is not None:
            self._ended = ended
        return data

    def begin(self, now: int, ended: Ended) -> list[Command]:
        """Begins the exchange; `ended` is called exactly once. Raises what cannot be asked."""
        block, client = self.block, self._client
        self._ended = ended
        self._ask = ask = client.repeated(
            block.targets[0], station=self.station, unit=block.unit, count=block.count, on_done=self._done
        )
        if ask is not None:
            ask.on_data = self._take
            commands = client.engine.ask(ask, now)
            if commands is not None:
                return commands
        return client.read(
            block.targets[0], station=self.station, unit=block.unit, count=block.count, now=now, on_done=self._done
        )

    def _done(self, result: TransferResult) -> None:
        if result.ok:
            self._take(result.data)
        else:
            self._tell(failure_of(result))

    def _take(self, data: bytes) -> None:
        try:
            self._store(data)
        except (DeviceMemoryError, ValueError) as error:
            self._tell(Failure(outcome="cannot_store", cause=str(error)))
        else:
            self._tell(None)

    def _tell(self, failure: Failure | None) -> None:
        ended, self._ended = self._ended, None
        if ended is not None:
            ended(failure)
