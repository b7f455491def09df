"""A SEND block that is its frame and nothing else: the frame leaves first, and is counted afterwards.

Between a trigger and its first byte nothing is done that could be done later; so this knows the parts that a usual
start goes through, and does only what each of them has to say about this block.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from framekit.blocks.block_settings import BlockSettings, SettingError
from framekit.blocks.model import Block
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.memory.errors import DeviceMemoryError
from framekit.transport.clock import Clock

if TYPE_CHECKING:
    from framekit.blocks.transfer import Ended
    from framekit.service.channel import ChannelService


class PromptSend:
    """The start of one block on its channel as it is now; `ended` is told once for each start."""

    def __init__(
        self, block: Block, channels: Mapping[int, ChannelService], settings: BlockSettings, clock: Clock, ended: Ended
    ) -> None:
        channel = channels[block.channel]
        self._channels, self._channel = channels, channel
        self._block = block
        self._settings = settings
        self._clock = clock
        self._ended = ended
        self._driver, self._transfers = channel.driver, channel.transfers
        self._sender, self._fields = channel.transfers.prepared_frame(block)

    def __call__(self) -> bool:
        """Starts it; False: something is in the way, or wrong, and nothing has been done."""
        driver, block = self._driver, self._block
        try:
            if driver.pending or self._channels.get(block.channel) is not self._channel:
                return False
            if self._settings.effective(block) is not block:
                return False
            data = self._sender.at_once(self._fields)
        except (SettingError, DeviceMemoryError, *EVALUATION_ERRORS):
            return False
        if data is None:
            return False
        has_left = driver.write_through(data)
        now = self._clock.now()
        self._transfers.is_sending(self._ended)
        self._sender.handed_over(data, now, partial(self._transfers.has_sent, self._ended))
        if has_left:
            driver.sent(now)
        else:
            driver.look_at_time()
        return True
