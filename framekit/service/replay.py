"""Sends the bytes of a capture again: at their times, at so many times their speed, or one after the other.

It knows ports and clocks, and not what the bytes mean.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Literal

from framekit.link.events import CharacterFault
from framekit.transport.clock import Clock
from framekit.transport.port import LineEvent, Port


class Replay:
    """Sends what `events` say went in `direction`; `on_end(reason)` is told once, '' when everything has been sent.

    `speed_up`: how many times faster than it was; None: each piece as soon as the one before it has left.
    """

    def __init__(
        self,
        events: Iterable[LineEvent],
        port: Port,
        clock: Clock,
        on_end: Callable[[str], None],
        *,
        direction: Literal["in", "out"] = "out",
        speed_up: float | None = 1.0,
    ) -> None:
        self.port = port
        self.clock = clock
        self.pieces_sent = self.bytes_sent = self.bytes_received = 0
        self.began = self.ended_at = 0
        self._events = [event for event in events if event.kind == "data" and event.direction == direction]
        self._on_end = on_end
        self._speed_up = speed_up
        self._character = 0 if port.settings is None else port.settings.character_time
        self._over = False

    @property
    def pieces(self) -> int:
        """How many there are."""
        return len(self._events)

    def start(self) -> None:
        """Opens the port and begins."""
        self.port.open(self)

    def stop(self) -> None:
        """Ends it where it is."""
        self._end("stopped")

    def _begun_at(self, event: LineEvent) -> int:
        """When its first bit was on the line: received bytes have the time of their last."""
        return event.at - (len(event.data) * self._character if event.direction == "in" else 0)

    def _next(self) -> None:
        """Asks for the next piece at its time, or ends."""
        if self._over:
            return
        if self.pieces_sent >= len(self._events):
            self._end("")
        elif self._speed_up is None:
            self._send()
        else:
            passed = self._begun_at(self._events[self.pieces_sent]) - self._begun_at(self._events[0])
            self.clock.call_at(self.began + round(passed / self._speed_up), self._send)

    def _send(self) -> None:
        if self._over:
            return
        data = self._events[self.pieces_sent].data
        self.pieces_sent += 1
        self.bytes_sent += len(data)
        self.port.write(data)

    def _end(self, reason: str) -> None:
        if not self._over:
            self._over = True
            self.ended_at = self.clock.now()
            self.port.close()
            self._on_end(reason)

    # ---- events of the port -------------------------------------------------------------------------------

    def opened(self, now: int) -> None:
        self.began = now
        self._next()

    def sent(self, now: int) -> None:
        self._next()

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self.bytes_received += len(data)

    def other_sender(self, now: int) -> None:
        """Who sends changes nothing."""

    def line_break(self, now: int) -> None:
        """Breaks of the other side change nothing."""

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        """Control lines change nothing."""

    def closed(self, now: int, reason: str) -> None:
        self._end(reason)
