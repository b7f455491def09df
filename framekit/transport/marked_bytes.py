"""Bytes of a terminal that marks damaged characters: what the marks mean, and how they are switched on (POSIX).

With PARMRK a character with a parity or framing fault is read as FF 00 and the character, a break as FF 00 00, and a
good FF as FF FF (termios(3), "Input modes"). Knows file descriptors, but no ports.
"""

from __future__ import annotations

import struct
import sys
from dataclasses import dataclass

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
