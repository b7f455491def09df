"""A serial device with a file descriptor, watched by the loop: reads and writes that never wait (POSIX).

Damaged characters and breaks are told where the driver marks them. With PARMRK a character with a parity or framing
fault is read as FF 00 and the character, a break as FF 00 00, and a good FF as FF FF (termios(3), "Input modes"). A
pseudo-terminal knows neither marks nor bit times.
"""

from __future__ import annotations

import contextlib
import os
import struct
import sys
import termios
from dataclasses import dataclass
from typing import Any

from framekit.definition.times import PLAIN, LineFormat, LineSettings
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import AsyncioClock
from framekit.transport.serial_device import (
    READ_SIZE,
    SERIAL_ERRORS,
    SerialConnection,
    SerialEvents,
    open_device,
    reason_of,
    set_attribute,
)

MARK = 0xFF
READ_COUNTERS = 0x545D
"""TIOCGICOUNT of Linux (tty_ioctl(2)): counts of interrupts and of damage; 20 native integers."""


class Marks:
    """Takes the marks out of a stream that may be cut anywhere."""

    def __init__(self) -> None:
        self._rest = b""

    def take_out(self, data: bytes) -> tuple[bytes, list[int]]:
        """The characters, and which of them (indices) are marked; an unfinished mark is kept for the next time."""
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

    def clear(self) -> None:
        """The input has been dropped."""
        self._rest = b""


@dataclass(frozen=True, slots=True)
class DamageCounts:
    """How many characters a driver has found damaged, and how many breaks."""

    framing: int = 0
    parity: int = 0
    breaks: int = 0

    def since(self, earlier: DamageCounts) -> DamageCounts:
        """What has been added."""
        return DamageCounts(self.framing - earlier.framing, self.parity - earlier.parity, self.breaks - earlier.breaks)


def damage_counts(descriptor: int) -> DamageCounts | None:
    """The counts of a port's driver; None where there are none."""
    if sys.platform != "linux":
        return None
    import fcntl

    try:
        counts = struct.unpack("20i", fcntl.ioctl(descriptor, READ_COUNTERS, bytes(80)))
    except OSError:
        return None
    return DamageCounts(framing=counts[6], parity=counts[8], breaks=counts[9])


def mark_damage(descriptor: int) -> bool:
    """Switches the marks on, where the terminal can; whether it marks now. Raises nothing."""
    import termios

    try:
        attributes = termios.tcgetattr(descriptor)
        attributes[0] &= ~(termios.IGNPAR | termios.IGNBRK | termios.BRKINT | termios.ISTRIP)
        attributes[0] |= termios.INPCK | termios.PARMRK
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        return bool(termios.tcgetattr(descriptor)[0] & termios.PARMRK)
    except (OSError, termios.error):
        return False


def read_at_least_one(descriptor: int) -> None:
    """Makes "nothing there" and "the other end is gone" different answers to a non-blocking read. Raises nothing."""
    import termios

    try:
        attributes = termios.tcgetattr(descriptor)
        attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    except (OSError, termios.error):
        return


class DescriptorConnection(SerialConnection):
    """An open device of this machine. Raises one of `SERIAL_ERRORS` when it cannot be opened."""

    def __init__(
        self,
        name: str,
        settings: LineFormat | None,
        clock: AsyncioClock,
        events: SerialEvents,
        wiring: LineSettings = PLAIN,
    ) -> None:
        self.clock = clock
        self.events = events
        self._device = device = _open(name, settings, wiring)
        self._descriptor: int = device.fileno()
        self.has_bit_times = not is_pseudo(self._descriptor)
        self._fault = LineFault.FRAMING if settings is None or settings.parity == "N" else LineFault.PARITY
        read_at_least_one(self._descriptor)
        self._marks = Marks() if self.has_bit_times and mark_damage(self._descriptor) else None
        self._counts = damage_counts(self._descriptor)
        self._unsent = bytearray()
        self._stopped = False
        os.set_blocking(self._descriptor, False)
        clock.loop.add_reader(self._descriptor, self._readable)
        clock.call_soon(events.opened)

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

    def _readable(self) -> None:
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
        elif self._marks is None:
            self.events.received(data, now, ())
        else:
            self._tell(*self._marks.take_out(data), now)

    def _tell(self, data: bytes, marked: list[int], now: int) -> None:
        """Tells of characters and breaks in their order."""
        added = self._added() if marked else None
        breaks = [index for index in marked if data[index] == 0]
        if added is not None:
            # A break is read as a marked 00, and so is a damaged 00; the driver's counts tell how many were breaks.
            breaks = breaks[: max(0, added.breaks)]
        fault = self._fault
        if added is not None and (added.parity > 0) != (added.framing > 0):
            fault = LineFault.PARITY if added.parity > 0 else LineFault.FRAMING
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
        """The damage counted since the last time; None where nobody counts."""
        before, self._counts = self._counts, damage_counts(self._descriptor)
        return None if before is None or self._counts is None else self._counts.since(before)

    def flush_input(self) -> None:
        with contextlib.suppress(OSError, termios.error):
            termios.tcflush(self._descriptor, termios.TCIFLUSH)
        if self._marks is not None:
            self._marks.clear()

    def drop_output(self) -> None:
        with contextlib.suppress(OSError, termios.error):
            termios.tcflush(self._descriptor, termios.TCOFLUSH)
        self._unsent.clear()

    # ---- writing ------------------------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        self._unsent += data
        self._write_more()

    def _write_more(self) -> None:
        """Hands over what the driver takes now; the rest follows when it can."""
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
        return None  # a pseudo-terminal has no such line

    def set_line(self, name: str, on: bool) -> None:
        set_attribute(self._device, name, on)


def _open(name: str, settings: LineFormat | None, wiring: LineSettings) -> Any:
    """A pseudo-terminal need not know the speed and format of a real line; any will do then."""
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
    """Whether it is a pseudo-terminal."""
    try:
        return is_pseudo_name(os.ttyname(descriptor))
    except OSError:
        return False


def is_pseudo_name(name: str) -> bool:
    """Whether a path, or what it links to, is a pseudo-terminal."""
    return os.path.realpath(name).startswith(("/dev/pts/", "/dev/ttyp", "/dev/ttys0"))
