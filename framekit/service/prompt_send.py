"""A SEND block that is its frame and nothing else: the frame leaves first, and is counted afterwards.

Between a trigger and its first byte nothing is done that could be done later; so this knows the parts that a usual
start goes through, and does only what each of them has to say about this block.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.memory.memory import DeviceMemoryError
from framekit.run.block_words import BlockSettings
from framekit.run.model import Block
from framekit.transport.clock import Clock

if TYPE_CHECKING:
    from framekit.run.transfer import Ended
    from framekit.service.channel import ChannelService


class PromptSend:
    """The start of one block on one channel; `ended` is told once for each. Raises as its parts do.

    Raises ValueError for a frame that is more than its bytes, or has to wait for the line.
    """

    __slots__ = (
        "_clock", "_constants", "_driver", "_encode", "_ended", "_engine", "_output", "_readers", "_scope", "_sender",
        "_transfers", "_unchanged",
    )  # fmt: skip

    def __init__(
        self, block: Block, channel: ChannelService, settings: BlockSettings, clock: Clock, ended: Ended
    ) -> None:
        self._unchanged = settings.unchanged(block)
        self._clock = clock
        self._ended = ended
        self._driver, self._transfers = channel.driver, channel.transfers
        self._sender, fields = channel.transfers.prepared_frame(block)
        self._engine = self._sender.engine
        self._output = self._engine.output
        if not self._sender.is_plain or not self._output.is_immediate:
            raise ValueError("such a frame does not leave at once, or is more than its bytes")
        self._encode, self._scope = self._sender.encode, self._sender.scope
        self._constants = {**self._sender.constants, **fields.constants}
        self._readers = fields.readers

    def __call__(self) -> Callable[[], None] | None:
        """Sends the frame; what is to be done afterwards. None: something is in the way, or wrong, and nothing is sent.

        Written out, since all of it stands between a trigger and the first byte.
        """
        driver, engine, output = self._driver, self._engine, self._output
        if not (  # as `Engine.is_quiet`
            output.is_open
            and output.clear_to_send
            and output.outgoing is None
            and not output.pending
            and not engine.is_busy
            and not driver.pending
            and engine.machine.monitor is None
            and self._unchanged()
        ):
            return None
        fields = self._constants.copy()
        try:
            for name, read in self._readers:
                fields[name] = read()
            data = self._encode(fields, self._scope)
        except (DeviceMemoryError, *EVALUATION_ERRORS):
            return None
        return partial(self._count, data, driver.port.write_through(data))

    def _count(self, data: bytes, has_left: bool) -> None:
        now = self._clock.now()
        self._transfers.is_sending(self._ended)
        self._sender.handed_over(data, now, partial(self._transfers.has_sent, self._ended))
        self._driver.handed_over(data, has_left, now)
