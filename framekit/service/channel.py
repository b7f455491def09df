"""One channel of a run: its engine on its port, its client, and the blocks that use them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from framekit.blocks.model import Block, Channel
from framekit.blocks.transfer import BlockTransfers, Ended
from framekit.codec.codec import compile_protocol
from framekit.link.client import Client
from framekit.link.engine import Engine
from framekit.link.events import Command
from framekit.link.exchange import Asked
from framekit.link.observe import Monitor
from framekit.link.values import FrameValue
from framekit.memory.errors import DeviceMemoryError
from framekit.memory.memory import DeviceMemory
from framekit.service.driver import Driver
from framekit.transport.clock import Clock
from framekit.transport.port import Port

Arrived = Callable[[int, bool, str], None]
"""Told that the frame of a RECEIVE block came: the block's number, whether it was stored, and why not."""


class ChannelService:
    """Runs blocks on one channel. `arrived` is told of frames of RECEIVE blocks, `opened` whether the port is open."""

    def __init__(
        self,
        channel: Channel,
        port: Port,
        clock: Clock,
        memory: DeviceMemory,
        receiving: list[Block],
        arrived: Arrived,
        opened: Callable[[bool], None],
        monitor: Monitor | None = None,
    ) -> None:
        self.channel = channel
        self.arrived = arrived
        self.opened = opened
        self.receiving: dict[str, list[Block]] = {}
        for block in receiving:
            self.receiving.setdefault(block.frame or "", []).append(block)
        protocol = channel.protocol
        codec = compile_protocol(protocol)
        self.engine = Engine(
            protocol,
            codec,
            channel.role,
            params=channel.params,
            line=channel.line,
            own=channel.own,
            now=clock.now(),
            ask=self._ask,
            on_frame=self._frame,
            monitor=monitor,
        )
        self.client = client = Client(protocol, codec, self.engine) if protocol.services else None
        self.transfers = BlockTransfers(self.engine, client, memory, dict(protocol.frames))
        self.state = "closed"
        self.driver = Driver(self.engine, port, clock, self._on_state)

    def _on_state(self, state: str) -> None:
        self.state = state
        if state != "open":
            self.transfers.closed("closed")
        self.opened(state == "open")

    def start(self) -> None:
        self.driver.start()

    def stop(self) -> None:
        self.driver.stop()

    def start_block(self, block: Block, ended: Ended) -> None:
        """Begins the exchange of a block; `ended` is called exactly once."""

        def begin(now: int) -> list[Command]:
            return self.transfers.start(block, now, ended)

        self.driver.do(begin)

    def _ask(self, service: str, arguments: dict[str, Any], station: Any, done: Asked) -> None:
        if self.client is not None:
            self.client.ask(service, arguments, station, done)

    def _frame(self, frame: FrameValue) -> None:
        """A frame nobody waited for: the RECEIVE blocks that name it take it."""
        for block in self.receiving.get(frame.frame, ()):
            try:
                self.transfers.store_frame(block, frame)
            except (DeviceMemoryError, ValueError) as error:
                self.arrived(block.number, False, str(error))
            else:
                self.arrived(block.number, True, "")
