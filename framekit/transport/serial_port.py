"""Real serial ports, through pyserial: `/dev/ttyUSB0`, `COM3`, `socket://…`, `rfc2217://…`, `loop://`.

Where the port has a file descriptor it is watched by the loop; otherwise a thread reads it. Nothing that happens on the
line raises: the owner is told that the port is closed, and why.
"""

from __future__ import annotations

import contextlib
import os
import threading
from typing import Any

from framekit.definition.times import LineFormat
from framekit.transport.clock import AsyncioClock, Handle
from framekit.transport.port import Port, PortEvents

READ_SIZE = 4096
POLL = 0.05
"""How long the reading thread waits at a time for a port without a file descriptor (s)."""


class SerialPort(Port):
    """A serial port at `url` with the speed and format of `line`."""

    def __init__(self, url: str, line: LineFormat | None, clock: AsyncioClock) -> None:
        self.name = url
        self.line = line
        self.clock = clock
        self.events: PortEvents | None = None
        self._serial: Any = None
        self._descriptor: int | None = None
        self._unsent = bytearray()
        self._free = 0
        self._sent_call: Handle | None = None

    # ---- opening and closing ------------------------------------------------------------------------------

    def open(self, events: PortEvents) -> None:
        self.events = events
        try:
            self._serial = self._opened_serial()
        except (OSError, ValueError) as error:
            reason = str(error)
            self.clock.call_soon(lambda: self._lost(reason))
            return
        self._descriptor = self._descriptor_of(self._serial)
        if self._descriptor is not None:
            os.set_blocking(self._descriptor, False)
            self.clock.loop.add_reader(self._descriptor, self._readable)
        else:
            threading.Thread(target=self._read_forever, args=(self._serial,), daemon=True, name=self.name).start()
        self.clock.call_soon(lambda: events.opened(self.clock.now()))

    def _opened_serial(self) -> Any:
        import serial

        line = self.line or LineFormat(9600)
        opened = serial.serial_for_url(
            self.name,
            baudrate=line.speed,
            bytesize=line.data_bits,
            parity=line.parity,
            stopbits=line.stop_bits,
            timeout=POLL,
            write_timeout=None,
            exclusive=None,
        )
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            opened.reset_input_buffer()
        return opened

    @staticmethod
    def _descriptor_of(opened: Any) -> int | None:
        """The file descriptor to watch; None for ports that have none, or one that is no plain file."""
        if type(opened).__module__ != "serial.serialposix":
            return None
        return int(opened.fileno())

    def close(self) -> None:
        self.events = None
        self._release()

    def _release(self) -> None:
        if self._descriptor is not None:
            self.clock.loop.remove_reader(self._descriptor)
            self.clock.loop.remove_writer(self._descriptor)
            self._descriptor = None
        if self._sent_call is not None:
            self._sent_call.cancel()
        opened, self._serial = self._serial, None
        self._unsent.clear()
        if opened is not None:
            with contextlib.suppress(OSError):
                opened.close()

    def _lost(self, reason: str) -> None:
        events, self.events = self.events, None
        self._release()
        if events is not None:
            events.closed(self.clock.now(), reason)

    # ---- reading ------------------------------------------------------------------------------------------

    def _readable(self) -> None:
        assert self._descriptor is not None
        try:
            data = os.read(self._descriptor, READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(str(error))
            return
        if not data:
            self._lost("the other end is gone")
        elif self.events is not None:
            self.events.received(data, self.clock.now())

    def _read_forever(self, opened: Any) -> None:
        """Runs in its own thread, for ports that the loop can't watch."""
        loop = self.clock.loop
        while self._serial is opened:
            try:
                data = opened.read(max(1, opened.in_waiting or 0))
            except (OSError, ValueError, TypeError, AttributeError) as error:
                reason = str(error) or type(error).__name__
                with contextlib.suppress(RuntimeError):
                    loop.call_soon_threadsafe(self._thread_lost, opened, reason)
                return
            if data:
                with contextlib.suppress(RuntimeError):
                    loop.call_soon_threadsafe(self._handed_over, opened, bytes(data))

    def _thread_lost(self, opened: Any, reason: str) -> None:
        if self._serial is opened:
            self._lost(reason)

    def _handed_over(self, opened: Any, data: bytes) -> None:
        if self._serial is opened and self.events is not None:
            self.events.received(data, self.clock.now())

    # ---- writing ------------------------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        if self._serial is None or not data:
            return
        self._unsent += data
        self._flush()
        now = self.clock.now()
        duration = 0 if self.line is None else len(data) * self.line.character_time
        self._free = max(now, self._free) + duration
        if self._sent_call is not None:
            self._sent_call.cancel()
        self._sent_call = self.clock.call_at(self._free, self._sent)

    def _flush(self) -> None:
        """Hands over what the driver takes now; the rest follows when it can."""
        try:
            if self._descriptor is None:
                self._serial.write(bytes(self._unsent))
                self._unsent.clear()
                return
            del self._unsent[: os.write(self._descriptor, self._unsent)]
        except BlockingIOError:
            pass
        except OSError as error:
            reason = str(error)
            self.clock.call_soon(lambda: self._lost(reason))
            return
        if self._unsent and self._descriptor is not None:
            self.clock.loop.add_writer(self._descriptor, self._flush_more)

    def _flush_more(self) -> None:
        if self._descriptor is not None:
            self.clock.loop.remove_writer(self._descriptor)
            self._flush()

    def _sent(self) -> None:
        """The last bit has left once the time for it is over and the driver's queue is empty."""
        self._sent_call = None
        if self._serial is None or self.events is None:
            return
        with contextlib.suppress(OSError, AttributeError, NotImplementedError):
            if self._unsent or self._serial.out_waiting:
                self._sent_call = self.clock.call_at(self.clock.now() + 1_000_000, self._sent)
                return
        self.events.sent(self.clock.now())

    def send_break(self, duration: int) -> None:
        if self._serial is None:
            return
        with contextlib.suppress(OSError, NotImplementedError):
            self._serial.break_condition = True
        self._free = max(self.clock.now(), self._free) + duration
        self.clock.call_at(self._free, self._end_break)

    def _end_break(self) -> None:
        if self._serial is not None and self.events is not None:
            with contextlib.suppress(OSError, NotImplementedError):
                self._serial.break_condition = False
            self.events.sent(self.clock.now())

    def set_rts(self, on: bool) -> None:
        if self._serial is not None:
            with contextlib.suppress(OSError, NotImplementedError):
                self._serial.rts = on
