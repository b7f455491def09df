"""Real serial ports, through pyserial: `/dev/ttyUSB0`, `COM3`, `socket://…`, `rfc2217://…`, `loop://`.

A port keeps the order of bytes and breaks and knows when the last bit has left. Nothing that happens on the line
raises: the owner is told that the port is closed, and why.
"""

from __future__ import annotations

import os
from collections import deque

from framekit.definition.times import PLAIN, LineFormat, LineSettings
from framekit.link.events import CharacterFault
from framekit.transport.clock import AsyncioClock
from framekit.transport.port import Port, PortEvents
from framekit.transport.serial_device import SERIAL_ERRORS, SerialConnection, ThreadConnection, is_device, reason_of

SHORTEST_LOOK = 500_000
"""Between two looks at a driver's queue that is not empty yet, at least (ns)."""

CARRIER_EVERY = 250_000_000
"""How often the carrier of a modem is looked at (ns)."""

LONGEST_HOLD = 30_000_000_000
"""How long the other side may hold back what is to be sent (CTS off, XOFF) before the port counts as lost (ns)."""


class SerialPort(Port):
    """A serial port at `url` with the speed and format of `settings` (9600 8N1 where there are none)."""

    def __init__(
        self, url: str, settings: LineFormat | None, clock: AsyncioClock, wiring: LineSettings = PLAIN
    ) -> None:
        self.name = url
        self.wiring = wiring
        self.settings = settings
        self.clock = clock
        self._use: _SerialUse | None = None
        self._last_threads: ThreadConnection | None = None

    def open(self, events: PortEvents) -> None:
        self.close()
        self._use = use = _SerialUse(self, events)
        try:
            use.connection = self._connect(use)
        except SERIAL_ERRORS as error:
            reason = reason_of(error)
            self.clock.call_soon(lambda: use.lost(reason))

    def _connect(self, use: _SerialUse) -> SerialConnection:
        if is_device(self.name) and os.name == "posix":
            from framekit.transport.serial_descriptor import DescriptorConnection

            return DescriptorConnection(self.name, self.settings, self.clock, use, self.wiring)
        previous = self._last_threads
        self._last_threads = ThreadConnection(self.name, self.settings, self.clock, use, previous, self.wiring)
        return self._last_threads

    def forget(self) -> None:
        """The use of the port is over."""
        self._use = None

    def close(self) -> None:
        if self._use is not None:
            self._use.end()

    def write(self, data: bytes) -> None:
        if self._use is not None:
            self._use.put(data)

    def send_break(self, duration: int) -> None:
        if self._use is not None:
            self._use.put(duration)

    def set_rts(self, on: bool) -> None:
        if self._use is not None:
            self._use.set_line("rts", on)

    def flush_input(self) -> None:
        if self._use is not None and self._use.is_open and self._use.connection is not None:
            self._use.connection.flush_input()


class _SerialUse:
    """A port from being opened to being closed: its events in, its bytes and breaks (ns) out, in order."""

    def __init__(self, port: SerialPort, events: PortEvents) -> None:
        self.port = port
        self.clock = port.clock
        self.events = events
        self.connection: SerialConnection | None = None
        self.is_open = False
        self._over = False
        self._character_time = (port.settings or LineFormat(9600)).character_time
        self._queue: deque[bytes | int] = deque()
        self._free = 0
        self._in_break = False
        self._looking = False
        self._held = (0, 0)

    # ---- events of the device -----------------------------------------------------------------------------

    def opened(self) -> None:
        if not self._over:
            self.is_open = True
            self.events.opened(self.clock.now())
            if self.port.wiring.modem is not None:
                self._look_at_carrier(None)

    def _look_at_carrier(self, before: bool | None) -> None:
        """Tells when the carrier comes or goes; one that was never there (no wire in the cable) is not lost."""
        if self._over or self.connection is None:
            return
        carrier = self.connection.has_carrier
        if carrier is None:
            return
        now = self.clock.now()
        if before is not None and carrier != before:
            self.events.control({"dcd": carrier}, now)
        self.clock.call_at(now + CARRIER_EVERY, lambda: self._look_at_carrier(carrier))

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...]) -> None:
        if not self._over:
            self.events.received(data, now, faults)

    def line_break(self, now: int) -> None:
        if not self._over:
            self.events.line_break(now)

    def lost(self, reason: str) -> None:
        if not self._over:
            self.end()
            self.events.closed(self.clock.now(), f"{self.port.name}: {reason}")

    def end(self) -> None:
        """Closes the device; nothing is told any more."""
        self._over = True
        self.is_open = False
        self.port.forget()
        if self.connection is not None:
            self.connection.stop()

    # ---- bytes and breaks out -----------------------------------------------------------------------------

    def put(self, what: bytes | int) -> None:
        """Bytes, or a break of so many ns, go out behind everything before."""
        if self.is_open:
            self._queue.append(what)
            self._go_on()

    def set_line(self, name: str, on: bool) -> None:
        if self.is_open and self.connection is not None:
            self.connection.set_line(name, on)

    def _go_on(self) -> None:
        """Hands over what may go out now; a break waits until everything before it has left."""
        connection = self.connection
        if connection is None or self._in_break:
            return
        while self._queue and isinstance(data := self._queue[0], bytes):
            self._queue.popleft()
            connection.write(data)
            if connection.has_bit_times:
                self._free = max(self._free, self.clock.now()) + len(data) * self._character_time
        if not self._looking:
            self._looking = True
            self.clock.call_at(self._free, self._look)

    def _look(self) -> None:
        """The last bit has left once the time for it is over and the driver's queue is empty."""
        self._looking = False
        connection = self.connection
        if self._over or connection is None:
            return
        now, waiting = self.clock.now(), connection.waiting
        if self._is_held(waiting, now):
            connection.drop_output()
            self.lost(f"nothing has been taken for {LONGEST_HOLD / 1e9:g} s – is the other side ready?")
        elif self._free > now or waiting:
            self._looking = True
            rest = max(SHORTEST_LOOK, waiting * self._character_time) if waiting else 0
            self.clock.call_at(max(self._free, now + rest), self._look)
        elif self._queue:
            self._begin_break(now)
        else:
            self.events.sent(now)

    def _is_held(self, waiting: int, now: int) -> bool:
        """Whether the same bytes have been waiting for too long: an exchange must not wait for ever."""
        if not waiting or waiting != self._held[0]:
            self._held = waiting, now
        return bool(waiting) and now - self._held[1] > LONGEST_HOLD

    def _begin_break(self, now: int) -> None:
        duration = self._queue.popleft()
        assert isinstance(duration, int)
        self._in_break = True
        self.set_line("break_condition", True)
        self._free = now + duration
        self.clock.call_at(self._free, self._end_break)

    def _end_break(self) -> None:
        self._in_break = False
        self.set_line("break_condition", False)
        if not self._over:
            self._go_on()
