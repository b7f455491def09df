"""Switches the transmitter of an RS-485 port by RTS around everything that is sent.

The line is given back as soon as the port says that the last bit has left. What the bytes mean is not known here.
"""

from __future__ import annotations

from collections import deque

from framekit.definition.line_settings import Direction
from framekit.transport.clock import Clock, Handle
from framekit.transport.passing_port import PassingPort
from framekit.transport.port import Port


class DirectionPort(PassingPort):
    """A port whose RTS is at the sending level from `before` the first bit until `after` the last one."""

    def __init__(self, inner: Port, direction: Direction, clock: Clock) -> None:
        super().__init__(inner)
        self.direction = direction
        self.clock = clock
        self._waiting: deque[bytes | int] = deque()
        self._sending = self._ready = False
        self._timer: Handle | None = None

    def _switch(self, sending: bool) -> None:
        self._sending = sending
        self._ready = False
        self.inner.set_rts(sending == self.direction.high)

    def _after(self, time: int) -> None:
        """`_go_on` so much later; only the last one asked for comes."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self.clock.call_at(self.clock.now() + time, self._go_on)

    def forget(self) -> None:
        super().forget()
        self._waiting.clear()
        self._sending = self._ready = False
        if self._timer is not None:
            self._timer.cancel()

    def opened(self, now: int) -> None:
        self._switch(False)
        super().opened(now)

    def write(self, data: bytes) -> None:
        self._put(data)

    def send_break(self, duration: int) -> None:
        self._put(duration)

    def set_rts(self, on: bool) -> None:
        """RTS belongs to the direction; a protocol that keys it by itself has nothing to say here."""

    def _put(self, what: bytes | int) -> None:
        if self.events is None:
            return
        self._waiting.append(what)
        if self._sending and self._ready:
            self._hand_over()
        elif not self._sending:
            self._switch(True)
            self._after(self.direction.before)

    def _go_on(self) -> None:
        """The level has been there long enough: sending begins, or the line is given back."""
        if self._waiting:
            self._ready = True
            self._hand_over()
        elif self._sending:
            self._switch(False)
            super().sent(self.clock.now())

    def _hand_over(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        while self._waiting:
            what = self._waiting.popleft()
            if isinstance(what, bytes):
                self.inner.write(what)
            else:
                self.inner.send_break(what)

    def sent(self, now: int) -> None:
        if self.direction.after:
            self._after(self.direction.after)
        else:
            self._go_on()
