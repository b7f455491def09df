"""What a job table wants of whoever owns it: connections, transfers, words and bits in memory, and who is told.

Nothing is done here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from framekit.blocks.block_status import Failure
from framekit.blocks.jobs.diagnosis import JobStatus
from framekit.blocks.jobs.order import Command
from framekit.blocks.jobs.slot import Attempt

if TYPE_CHECKING:
    from framekit.blocks.model import Place

Store = Callable[[], Failure | None]
"""Puts what was read where it belongs; why not, if it cannot be."""

Watcher = Callable[[JobStatus, Failure | None], None]
"""Told how a slot is doing when a transfer has ended, is `late`, or could not begin; and with what was wrong."""


class JobOwner(Protocol):
    """Who does what a table wants."""

    def connect(self, attempt: Attempt) -> None:
        """Looks for a way to the host of an order; the table is told by `connected` or `not_connected`."""

    def begin(self, attempt: Attempt) -> None:
        """Begins a transfer; its end is told by `ended`."""

    def write_words(self, place: Place, words: tuple[int, ...]) -> bool:
        """Writes words from a place on; whether they could be."""

    def write_bits(self, bits: tuple[int, ...]) -> None:
        """Writes the status bits."""

    def answered(self, command: Command, word: int | None) -> None:
        """A command has its answer; None: it never gets one."""
