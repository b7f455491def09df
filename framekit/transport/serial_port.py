"""Real serial ports, through pyserial: `/dev/ttyUSB0`, `COM3`, `socket://…`, `rfc2217://…`, `loop://`.

A port keeps the order of bytes and breaks and determines when the last bit has left. No event on the line raises an
error: the port reports to its owner that it is closed, and why.

The loop watches a device with a file descriptor (POSIX): reads and writes never wait. Damaged characters and breaks are
reported if the driver marks them: with PARMRK a character with a parity or framing fault is read as FF 00 and the
character, a break as FF 00 00, and a good FF as FF FF (termios(3), "Input modes"). A pseudo-terminal has no marks, no
bit times, no parity and no break.

Characters of nine bits are sent as eight bits with a parity bit: mark parity for the marked byte, space parity for all
others, switched when all earlier bytes have left. While receiving, the port uses space parity, so that a marked byte
arrives with a parity fault. Without a file descriptor (a pyserial URL, a device of Windows), opening, writing and
closing may take seconds: two threads do all of it.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import struct
import sys
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue
from typing import Any

from framekit.definition.problems import error_text
from framekit.definition.times import NEVER, PLAIN, Direction, LineFormat, LineSettings
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import AsyncioClock
from framekit.transport.port import Port, PortEvents
from framekit.transport.unread import UnreadInput

if sys.platform != "win32":
    import fcntl
    import termios

READ_SIZE = 1024
POLL = 0.05
"""Longest wait of a thread for a device without a file descriptor (s)."""
MARK_PARITY, SPACE = "M", "S"
"""Names in pyserial of the parities whose bit is always 1 and always 0."""
STICKY_PARITY = 0x40000000
"""CMSPAR of Linux (termios(3)): the parity bit is always the same, 1 with PARODD and 0 without."""
NO_STICKY_PARITY = "its driver has no mark and space parity, so no ninth bit – use an adapter that has it"
SERIAL_ERRORS: tuple[type[Exception], ...] = (OSError, ValueError, TypeError, AttributeError, KeyError)
"""Errors of pyserial if a device is missing, is lost, is closed while a thread reads it, or a URL is wrong."""
SWITCH_ERRORS: tuple[type[Exception], ...] = (*SERIAL_ERRORS, NotImplementedError)
"""Errors of pyserial if a driver cannot switch the direction."""

CHANGE_ERRORS: tuple[type[Exception], ...] = (
    *SWITCH_ERRORS,
    OverflowError,
    struct.error,
    *(() if sys.platform == "win32" else (termios.error,)),
)
"""Errors of pyserial if a device does not support a speed or format."""

MOST_TOLD = 8
"""Largest number of existing devices named in the message about a missing device."""

_REASONS = {
    errno.ENOENT: "there is no such device",
    errno.EACCES: "no permission to open it – its group, often dialout, has to be one of yours",
    errno.EBUSY: "another program has it open",
    errno.EAGAIN: "another program has it open",
    errno.EIO: "the device is gone",
    errno.ENXIO: "the device is gone",
    errno.ENODEV: "the device is gone",
    errno.ENOTTY: "this is no serial line – name one, such as /dev/ttyUSB0, or tcp://HOST:PORT",
    errno.EISDIR: "this is a folder – name a device in it",
}


class SerialConnection(ABC):
    """A device from opening to closing."""

    has_bit_times = True
    """Whether bytes take their time on a line; False on a pseudo-terminal."""
    hears_marks = False
    """Whether the device reports which characters have their ninth bit set."""
    sees_damage = False
    """Whether the device reports damaged characters."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Write bytes to the device without waiting."""

    @property
    @abstractmethod
    def waiting(self) -> int:
        """Return the number of bytes not sent yet, if the device reports it."""

    @property
    def has_unread(self) -> bool:
        """Return whether bytes have arrived that are not reported yet; False if unknown."""
        return False

    @property
    def has_carrier(self) -> bool | None:
        """Return whether the modem reports a carrier (DCD); None if unknown."""
        return None

    @abstractmethod
    def set_line(self, name: str, on: bool) -> None:
        """Set a pyserial attribute (`rts`, `break_condition`), if the device has it."""

    @abstractmethod
    def change_line(self, line: LineFormat) -> None:
        """Change speed and format of the device; report it as lost if it does not support them."""

    @abstractmethod
    def set_ninth_bit(self, on: bool) -> None:
        """Set the ninth bit of the characters written from now on, if the device has it; all earlier characters must
        have left.
        """

    @abstractmethod
    def drop_output(self) -> None:
        """Drop the data not yet sent, if closing the device would wait for it."""

    @abstractmethod
    def stop(self) -> None:
        """Close the device soon; no event follows."""


def open_device(url: str, settings: LineFormat | None, wiring: LineSettings = PLAIN) -> Any:
    """Return the pyserial object of a device or URL. Raises one of `SERIAL_ERRORS`."""
    import serial

    line = settings or LineFormat(9600)
    options: dict[str, Any] = {"timeout": POLL, "exclusive": True if has_descriptor(url) else None}
    opened = serial.serial_for_url(
        url,
        baudrate=line.speed,
        bytesize=min(line.data_bits, 8),
        parity=SPACE if line.has_marks else line.parity,
        stopbits=line.stop_bits,
        rtscts=wiring.handshake == "rtscts",
        xonxoff=wiring.handshake == "xonxoff",
        do_not_open=True,
        **options,
    )
    if wiring.listen_only:
        opened.rts = opened.dtr = False
    opened.open()
    if wiring.direction is not None and wiring.direction.by == "driver":
        _let_driver_switch(opened, wiring.direction)
    with contextlib.suppress(*SERIAL_ERRORS):
        opened.reset_input_buffer()
    return opened


def _let_driver_switch(device: Any, direction: Direction) -> None:
    """Let the driver switch the direction of the line (TIOCSRS485). Raises OSError if it cannot."""
    from serial.rs485 import RS485Settings

    try:
        device.rs485_mode = RS485Settings(
            rts_level_for_tx=direction.high,
            rts_level_for_rx=not direction.high,
            delay_before_tx=direction.before / 1e9 or None,
            delay_before_rx=direction.after / 1e9 or None,
        )
    except SWITCH_ERRORS as error:
        device.close()
        raise OSError("its driver cannot switch the direction – use direction: rts") from error


def change_device(device: Any, line: LineFormat) -> None:
    """Change speed and format of an open device. Raises OSError if it does not support them."""
    try:
        device.baudrate, device.bytesize = line.speed, min(line.data_bits, 8)
        device.parity, device.stopbits = SPACE if line.has_marks else line.parity, line.stop_bits
    except CHANGE_ERRORS as error:
        raise OSError(f"the device cannot be set to {line}: {error}") from error


def is_device(url: str) -> bool:
    """Return whether it is a device of this machine and no URL."""
    return "://" not in url


def has_descriptor(url: str) -> bool:
    """Return whether a port has a file descriptor that the loop can watch: a device does, but not on Windows."""
    return is_device(url) and sys.platform != "win32"


def reason_of(error: Exception) -> str:
    """Return the reason why a device could not be opened or was lost, as a text for users."""
    number = getattr(error, "errno", None)
    if number is None and error.__context__ is not None:  # pyserial wraps the system's error about settings in a text
        number = next(iter(error.__context__.args), None)
    if number in _REASONS:
        return _REASONS[number]
    text = str(error)
    if "FileNotFoundError(" in text:  # pyserial's words on Windows: it names the class, and keeps no number
        return _REASONS[errno.ENOENT]
    if "PermissionError(" in text:
        return _REASONS[errno.EBUSY]
    return error_text(error)


def _what_there_is(name: str) -> str:
    """Return advice for a name that is no device: a network port for that host, or the devices of this machine."""
    if re.fullmatch(r"localhost|[\w-]+(\.[\w-]+)+", name):
        return f"write tcp://{name}:PORT for a connection to that host"
    from serial.tools.list_ports import comports

    devices = sorted(port.device for port in comports())
    more = f" and {len(devices) - MOST_TOLD} more" if len(devices) > MOST_TOLD else ""
    return f"there are {', '.join(devices[:MOST_TOLD])}{more}" if devices else "no serial device is there now"


def set_attribute(device: Any, name: str, on: bool) -> None:
    """Set a control line of a device; ignore a control line that it does not have."""
    with contextlib.suppress(*SERIAL_ERRORS, NotImplementedError):
        setattr(device, name, on)


Order = Callable[[Any], None]

LONGEST_READ = 60_000_000
"""A read of a thread that lasts longer than this (ns) has ended, and the thread is stalled: a read ends after `POLL`.
"""


class ThreadConnection(SerialConnection):
    """A device being opened or open, handled by two threads. `previous` is closed before this one is opened."""

    def __init__(
        self,
        url: str,
        settings: LineFormat | None,
        clock: AsyncioClock,
        events: _SerialUse,
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
        self._device: Any = None
        self._has_read = False
        """Whether the thread has read bytes that are not reported yet."""
        self._reads_since = NEVER
        """Start of the latest read of the thread."""
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
            self._device = device
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
                self._reads_since = self.clock.now()
                data = device.read(1)
                if data:
                    self._has_read = True
                    while (more := device.in_waiting) and len(data) < READ_SIZE:
                        data += device.read(min(more, READ_SIZE))
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
        """Run a call in the loop, unless the connection or the loop is closed."""
        with contextlib.suppress(RuntimeError):
            self.clock.loop.call_soon_threadsafe(lambda: None if self._closed else call())

    # ---- in the loop --------------------------------------------------------------------------------------

    def _received(self, data: bytes, now: int) -> None:
        """Queue received data for its turn; reading continues after the turn."""
        self.clock.turns.take(len(data), lambda: self._take(data, now))

    def _take(self, data: bytes, now: int) -> None:
        self._has_read = False
        self._heard.set()
        if not self._closed:
            self.events.received(data, now, ())

    @property
    def has_unread(self) -> bool:
        """Return whether the thread or the device has unread bytes, or the thread is stalled and may have some.

        Unknown for bytes that the thread reads at this moment.
        """
        if self._closed:
            return False
        if self._has_read or self.clock.now() - self._reads_since > LONGEST_READ:
            return True
        with contextlib.suppress(*SERIAL_ERRORS, AttributeError):
            return bool(self._device.in_waiting)
        return False

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

    def change_line(self, line: LineFormat) -> None:
        self._orders.put(lambda device: change_device(device, line))

    def set_ninth_bit(self, on: bool) -> None:
        self._orders.put(partial(self._switch, MARK_PARITY if on else SPACE))

    @staticmethod
    def _switch(parity: str, device: Any) -> None:
        """Switch the parity in the writing thread, which may wait until all earlier data has left."""
        device.flush()
        device.parity = parity

    def drop_output(self) -> None:
        """Keep the output: a separate thread closes the device, and no caller waits for it."""


SHORTEST_LOOK = 500_000
"""Shortest time between two checks of a driver's queue that is not empty (ns)."""

CARRIER_EVERY = 250_000_000
"""Interval between two checks of the carrier of a modem (ns)."""

LONGEST_HOLD = 30_000_000_000
"""Longest time (ns) for which the other side may hold back data to be sent (CTS off, XOFF) before the port counts as
lost.
"""


class SerialPort(Port):
    """A serial port at `url` with the speed and format of `settings` (9600 8N1 if None)."""

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
            if self.name.endswith((".yaml", ".yml")):
                reason = f"this is the name of a file – for a simulated device write sim:{self.name}"
            elif reason == _REASONS[errno.ENOENT]:
                reason += f" – {_what_there_is(self.name)}"
            self.clock.call_soon(lambda: use.lost(reason))

    def _connect(self, use: _SerialUse) -> SerialConnection:
        if has_descriptor(self.name):
            return DescriptorConnection(self.name, self.settings, self.clock, use, self.wiring)
        previous = self._last_threads
        self._last_threads = ThreadConnection(self.name, self.settings, self.clock, use, previous, self.wiring)
        return self._last_threads

    def forget(self) -> None:
        """End the use of the port."""
        self._use = None

    def close(self) -> None:
        if self._use is not None:
            self._use.end()

    def write(self, data: bytes) -> None:
        if self._use is not None:
            self._use.put(data)

    def write_marked(self, data: bytes, marked: int) -> None:
        if self._use is not None:
            self._use.put_marked(data, marked)

    @property
    def has_unread(self) -> bool:
        use = self._use
        return use is not None and use.connection is not None and use.connection.has_unread

    @property
    def hears_marks(self) -> bool:  # type: ignore[override]
        use = self._use
        return use is not None and use.connection is not None and use.connection.hears_marks

    @property
    def sees_damage(self) -> bool:  # type: ignore[override]
        use = self._use
        return use is not None and use.connection is not None and use.connection.sees_damage

    @property
    def has_bit_times(self) -> bool:  # type: ignore[override]
        use = self._use
        return use is None or use.connection is None or use.connection.has_bit_times

    def send_break(self, duration: int) -> None:
        if self._use is not None:
            self._use.put(duration)

    def change_line(self, line: LineFormat) -> None:
        if self._use is not None:
            self._use.change_line(line)

    def set_rts(self, on: bool) -> None:
        if self._use is not None:
            self._use.set_line("rts", on)

    def set_dtr(self, on: bool) -> None:
        if self._use is not None:
            self._use.set_line("dtr", on)


@dataclass(frozen=True, slots=True)
class NinthBit:
    """Marker in the send queue: ninth bit of the characters after it."""

    on: bool


class _SerialUse:
    """The use of a serial port from opening to closing: its events in, its bytes and breaks (ns) out, in order."""

    def __init__(self, port: SerialPort, events: PortEvents) -> None:
        self.port = port
        self.clock = port.clock
        self.events = events
        self.connection: SerialConnection | None = None
        self.is_open = False
        self._over = False
        self._character_time = (port.settings or LineFormat(9600)).character_time
        self._queue: deque[bytes | int | NinthBit] = deque()
        self._has_marks = port.settings is not None and port.settings.has_marks
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
        """Report a change of the carrier. A carrier that was never present (not wired in the cable) is not lost."""
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
        """Close the device; no event follows."""
        self._over = True
        self.is_open = False
        self.port.forget()
        if self.connection is not None:
            self.connection.stop()

    # ---- bytes and breaks out -----------------------------------------------------------------------------

    def put(self, what: bytes | int) -> None:
        """Queue bytes, or a break of so many ns, after everything queued before."""
        if self.is_open:
            self._queue.append(what)
            self._go_on()

    def put_marked(self, data: bytes, marked: int) -> None:
        """Queue bytes as `put` does, with the ninth bit set for one byte if the device has a ninth bit."""
        if self.is_open and self._has_marks and self.connection is not None and self.connection.has_bit_times:
            rest = (data[marked : marked + 1], NinthBit(False), data[marked + 1 :])
            self._queue += [piece for piece in (data[:marked], NinthBit(True), *rest) if piece]
            self._go_on()
        else:
            self.put(data)

    def set_line(self, name: str, on: bool) -> None:
        if self.is_open and self.connection is not None:
            self.connection.set_line(name, on)

    def change_line(self, line: LineFormat) -> None:
        if self.is_open and self.connection is not None:
            self._character_time = line.character_time
            self._has_marks = line.has_marks
            self.connection.change_line(line)

    def _go_on(self) -> None:
        """Write the queued data that may go out now; a break or a change of the ninth bit waits until all earlier data
        has left.
        """
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
        """Check whether the last bit has left: its time is over and the driver's queue is empty.

        Then take the next step.
        """
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
        elif self._queue and isinstance(bit := self._queue[0], NinthBit):
            self._queue.popleft()
            connection.set_ninth_bit(bit.on)
            self._go_on()
        elif self._queue:
            self._begin_break(now)
        else:
            self.events.sent(now)

    def _is_held(self, waiting: int, now: int) -> bool:
        """Return whether the same bytes have been waiting for too long: an exchange must not wait for ever."""
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


MARK = 0xFF
READ_COUNTERS = 0x545D
"""TIOCGICOUNT of Linux (tty_ioctl(2)): counts of interrupts and of damage; 20 native integers."""


class DamageMarks:
    """Removes the marks from a stream that may be split anywhere."""

    def __init__(self) -> None:
        self._rest = b""

    def take_out(self, data: bytes) -> tuple[bytes, list[int]]:
        """Return the characters, and the indices of the marked ones; an unfinished mark is kept for the next call."""
        if not self._rest and MARK not in data:
            return data, []
        data, self._rest = self._rest + data, b""
        found, marked, place = bytearray(), [], 0
        while place < len(data):
            if data[place] != MARK:
                found.append(data[place])
                place += 1
                continue
            size = 3 if data[place + 1 : place + 2] == b"\x00" else 2
            if len(data) < place + size:
                self._rest = data[place:]
                break
            if size == 3:
                marked.append(len(found))
            found.append(data[place + size - 1])
            place += size
        return bytes(found), marked


@dataclass(frozen=True, slots=True)
class DamageCounts:
    """Counts of damaged characters and of breaks, as reported by a driver."""

    framing: int = 0
    parity: int = 0
    breaks: int = 0

    def since(self, earlier: DamageCounts) -> DamageCounts:
        """Return the difference to earlier counts."""
        return DamageCounts(self.framing - earlier.framing, self.parity - earlier.parity, self.breaks - earlier.breaks)


def damage_counts(descriptor: int) -> DamageCounts | None:
    """Return the counts of a port's driver; None if it has none."""
    if sys.platform != "linux":
        return None
    try:
        counts = struct.unpack("20i", fcntl.ioctl(descriptor, READ_COUNTERS, bytes(80)))
    except OSError:
        return None
    return DamageCounts(framing=counts[6], parity=counts[8], breaks=counts[9])


def mark_damage(descriptor: int) -> bool:
    """Enable marks for damaged characters and return whether the terminal now marks them. Raises no error."""
    try:
        attributes = termios.tcgetattr(descriptor)
        attributes[0] &= ~(termios.IGNPAR | termios.IGNBRK | termios.BRKINT | termios.ISTRIP)
        attributes[0] |= termios.INPCK | termios.PARMRK
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        return bool(termios.tcgetattr(descriptor)[0] & termios.PARMRK)
    except (OSError, termios.error):
        return False


def has_sticky_parity(descriptor: int) -> bool:
    """Return whether the driver kept mark or space parity; many drivers without it reset the setting.

    Raises no error.
    """
    try:
        return bool(termios.tcgetattr(descriptor)[2] & STICKY_PARITY)
    except (OSError, termios.error):
        return False


def set_sticky_parity(descriptor: int, on: bool) -> None:
    """Set mark parity or space parity for all data written from now on, after waiting until earlier data has left.

    Raises OSError.
    """
    try:
        attributes = termios.tcgetattr(descriptor)
        attributes[2] |= termios.PARENB | STICKY_PARITY
        attributes[2] = attributes[2] | termios.PARODD if on else attributes[2] & ~termios.PARODD
        termios.tcsetattr(descriptor, termios.TCSADRAIN, attributes)
    except termios.error as error:
        raise OSError(NO_STICKY_PARITY) from error


def read_at_least_one(descriptor: int) -> None:
    """Let a non-blocking read distinguish "no data" from "the other end is gone". Raises no error."""
    try:
        attributes = termios.tcgetattr(descriptor)
        attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    except (OSError, termios.error):
        return


class DescriptorConnection(SerialConnection):
    """An open device of this machine. Raises one of `SERIAL_ERRORS` if it cannot be opened."""

    def __init__(
        self,
        name: str,
        settings: LineFormat | None,
        clock: AsyncioClock,
        events: _SerialUse,
        wiring: LineSettings = PLAIN,
    ) -> None:
        self.clock = clock
        self.events = events
        self._device = device = _open(name, settings, wiring)
        self._descriptor: int = device.fileno()
        self.has_bit_times = not is_pseudo(self._descriptor)
        self._marks: DamageMarks | None = None
        if (
            settings is not None
            and settings.has_marks
            and self.has_bit_times
            and not has_sticky_parity(self._descriptor)
        ):
            device.close()
            raise OSError(NO_STICKY_PARITY)
        self._line_is_set(settings)
        self._counts = damage_counts(self._descriptor)
        self._unsent = bytearray()
        self._stopped = False
        self._waits = False
        """Whether bytes that were read wait for their turn."""
        self._reads_again = False
        """Whether the loop reported the device meanwhile; uvloop reports the end of a device only once."""
        self._unread = UnreadInput(self._descriptor)
        os.set_blocking(self._descriptor, False)
        clock.loop.add_reader(self._descriptor, self._readable)
        clock.call_soon(events.opened)

    def _line_is_set(self, line: LineFormat | None) -> None:
        """Set the options that pyserial does not have again after a change of speed and format, which resets them."""
        has_marks = line is not None and line.has_marks
        self._fault = LineFault.FRAMING if line is None or line.parity == "N" else LineFault.PARITY
        self._parity_fault = LineFault.MARK if has_marks else LineFault.PARITY
        if has_marks:
            self._fault = LineFault.MARK
        read_at_least_one(self._descriptor)
        if not self.has_bit_times or not mark_damage(self._descriptor):
            self._marks = None
        elif self._marks is None:
            self._marks = DamageMarks()
        self.sees_damage = self._marks is not None
        self.hears_marks = has_marks and self.sees_damage

    def change_line(self, line: LineFormat) -> None:
        try:
            change_device(self._device, line)
        except OSError as error:
            if self.has_bit_times:  # a pseudo-terminal need not know the format of a real line
                reason = reason_of(error)
                self.clock.call_soon(lambda: None if self._stopped else self._lost(reason))
                return
        self._line_is_set(line)

    def set_ninth_bit(self, on: bool) -> None:
        try:
            set_sticky_parity(self._descriptor, on)
        except OSError as error:
            reason = reason_of(error)
            self.clock.call_soon(lambda: None if self._stopped else self._lost(reason))

    def stop(self) -> None:
        if self._stopped:
            return
        self._stopped = True
        self.clock.loop.remove_reader(self._descriptor)
        self.clock.loop.remove_writer(self._descriptor)
        with contextlib.suppress(*SERIAL_ERRORS):
            self._device.close()

    def _lost(self, reason: str) -> None:
        self.stop()
        self.events.lost(reason)

    # ---- reading ------------------------------------------------------------------------------------------

    @property
    def has_unread(self) -> bool:
        return not self._stopped and (self._waits or bool(self._unread))

    def _readable(self) -> None:
        if self._waits:
            self._reads_again = True
            return
        try:
            data = os.read(self._descriptor, READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(reason_of(error))
            return
        now = self.clock.now()
        if not data:
            self._lost("the device is gone")
        else:
            self._waits = True
            self.clock.turns.take(len(data), lambda: self._take(data, now))

    def _take(self, data: bytes, now: int) -> None:
        self._waits = False
        if self._stopped:
            return
        if self._marks is None:
            self.events.received(data, now, ())
        else:
            self._tell(*self._marks.take_out(data), now)
        if self._reads_again and not self._stopped:
            self._reads_again = False
            self._readable()

    def _tell(self, data: bytes, marked: list[int], now: int) -> None:
        """Report characters and breaks in order."""
        added = self._added() if marked else None
        breaks = [index for index in marked if data[index] == 0]
        if added is not None:
            # A break is read as a marked 00, and so is a damaged 00; the driver's counts give the number of breaks.
            breaks = breaks[: max(0, added.breaks)]
        elif self.hears_marks:  # a marked 00 is common, a break is not
            breaks = []
        fault = self._fault
        if added is not None and (added.parity > 0) != (added.framing > 0):
            fault = self._parity_fault if added.parity > 0 else LineFault.FRAMING
        start = 0
        for end in [*breaks, len(data)]:
            if self._stopped:
                return
            if end > start:
                faults = tuple(CharacterFault(index - start, fault) for index in marked if start <= index < end)
                self.events.received(data[start:end], now, faults)
            if end < len(data) and not self._stopped:
                self.events.line_break(now)
            start = end + 1

    def _added(self) -> DamageCounts | None:
        """Return the damage counted since the previous call; None if the driver does not count it."""
        before, self._counts = self._counts, damage_counts(self._descriptor)
        return None if before is None or self._counts is None else self._counts.since(before)

    def drop_output(self) -> None:
        with contextlib.suppress(OSError, termios.error):
            termios.tcflush(self._descriptor, termios.TCOFLUSH)
        self._unsent.clear()

    # ---- writing ------------------------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        self._unsent += data
        self._write_more()

    def _write_more(self) -> None:
        """Write the data that the driver accepts now; the rest follows when the device is ready."""
        loop = self.clock.loop
        try:
            del self._unsent[: os.write(self._descriptor, self._unsent)]
        except BlockingIOError:
            pass
        except OSError as error:
            self._unsent.clear()
            loop.remove_writer(self._descriptor)
            reason = reason_of(error)
            self.clock.call_soon(lambda: None if self._stopped else self._lost(reason))
            return
        if self._unsent:
            loop.add_writer(self._descriptor, self._write_more)
        else:
            loop.remove_writer(self._descriptor)

    @property
    def waiting(self) -> int:
        with contextlib.suppress(*SERIAL_ERRORS):
            return len(self._unsent) + int(self._device.out_waiting)
        return len(self._unsent)

    @property
    def has_carrier(self) -> bool | None:
        with contextlib.suppress(*SERIAL_ERRORS, AttributeError):
            return bool(self._device.cd)
        return None  # a pseudo-terminal has no carrier

    def set_line(self, name: str, on: bool) -> None:
        set_attribute(self._device, name, on)


def _open(name: str, settings: LineFormat | None, wiring: LineSettings) -> Any:
    """Open a device; a pseudo-terminal that rejects the speed and format is opened without them. Raises OSError."""
    try:
        try:
            return open_device(name, settings, wiring)
        except (ValueError, termios.error):
            if not is_pseudo_name(name):
                raise
            return open_device(name, None, wiring)
    except (ValueError, termios.error) as error:
        raise OSError(f"the device cannot be set to {settings}: {error}") from error


def is_pseudo(descriptor: int) -> bool:
    """Return whether it is a pseudo-terminal."""
    try:
        return is_pseudo_name(os.ttyname(descriptor))
    except OSError:
        return False


def is_pseudo_name(name: str) -> bool:
    """Return whether a path, or the target of its link, is a pseudo-terminal."""
    return os.path.realpath(name).startswith(("/dev/pts/", "/dev/ttyp", "/dev/ttys0"))
