"""A serial device that the loop cannot watch (a pyserial URL, a device of Windows): one thread reads, one writes.

Opening, writing and closing may take seconds there, so threads do all of it. What happens is told in calls of the loop.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import Any

from framekit.definition.line_settings import PLAIN, LineSettings
from framekit.definition.times import LineFormat
from framekit.transport.clock import AsyncioClock
from framekit.transport.serial_connection import (
    POLL,
    READ_SIZE,
    SERIAL_ERRORS,
    SerialConnection,
    SerialEvents,
    open_device,
    reason_of,
    set_attribute,
)

Order = Callable[[Any], None]


class ThreadConnection(SerialConnection):
    """A device that is being opened, or is open. `previous` is closed before this one is opened."""

    def __init__(
        self,
        url: str,
        settings: LineFormat | None,
        clock: AsyncioClock,
        events: SerialEvents,
        previous: ThreadConnection | None = None,
        wiring: LineSettings = PLAIN,
    ) -> None:
        self.url = url
        self.settings = settings
        self.wiring = wiring
        self.clock = clock
        self.events = events
        self.finished = threading.Event()
        self._stopping = threading.Event()
        self._heard = threading.Event()
        self._orders: SimpleQueue[Order | None] = SimpleQueue()
        self._unwritten = 0
        self._closed = False
        self._previous = previous.finished if previous is not None else None
        threading.Thread(target=self._run, daemon=True, name=f"reads {url}").start()

    # ---- in the threads -----------------------------------------------------------------------------------

    def _run(self) -> None:
        if self._previous is not None:
            self._previous.wait()
        try:
            device = open_device(self.url, self.settings, self.wiring)
        except SERIAL_ERRORS as error:
            self._tell_lost(error)
        else:
            threading.Thread(target=self._write_forever, args=(device,), daemon=True, name=f"writes {self.url}").start()
            self._tell(self.events.opened)
            self._read_forever(device)
            with contextlib.suppress(*SERIAL_ERRORS):
                device.close()
        finally:
            self._orders.put(None)
            self.finished.set()

    def _read_forever(self, device: Any) -> None:
        try:
            while not self._stopping.is_set():
                data = device.read(1)
                while data and (more := device.in_waiting) and len(data) < READ_SIZE:
                    data += device.read(min(more, READ_SIZE))
                if data:
                    self._heard.clear()
                    self._tell(partial(self._received, bytes(data), self.clock.now()))
                    while not self._heard.wait(POLL) and not self._stopping.is_set():
                        pass
        except SERIAL_ERRORS as error:
            self._tell_lost(error)

    def _write_forever(self, device: Any) -> None:
        try:
            while (order := self._orders.get()) is not None:
                order(device)
        except SERIAL_ERRORS as error:
            self._tell_lost(error)
            self._stopping.set()

    def _tell_lost(self, error: Exception) -> None:
        reason = reason_of(error)
        self._tell(lambda: self.events.lost(reason))

    def _tell(self, call: Callable[[], None]) -> None:
        """A call of the loop, unless nobody is to be told any more or the loop is closed."""
        with contextlib.suppress(RuntimeError):
            self.clock.loop.call_soon_threadsafe(lambda: None if self._closed else call())

    # ---- in the loop --------------------------------------------------------------------------------------

    def _received(self, data: bytes, now: int) -> None:
        """What has been read; the next is read when this has been dealt with."""
        self._heard.set()
        self.events.received(data, now, ())

    def stop(self) -> None:
        self._closed = True
        self._stopping.set()
        self._orders.put(None)

    def write(self, data: bytes) -> None:
        self._unwritten += len(data)

        def order(device: Any) -> None:
            device.write(data)
            self._tell(lambda: self._written(len(data)))

        self._orders.put(order)

    def _written(self, count: int) -> None:
        self._unwritten -= count

    @property
    def waiting(self) -> int:
        return self._unwritten

    def set_line(self, name: str, on: bool) -> None:
        self._orders.put(lambda device: set_attribute(device, name, on))

    def drop_output(self) -> None:
        """Nothing: a thread of its own closes the device, and nobody waits for it."""

    def flush_input(self) -> None:
        def order(device: Any) -> None:
            with contextlib.suppress(*SERIAL_ERRORS):
                device.reset_input_buffer()

        self._orders.put(order)
