"""What a serial port needs of an open device, and opening one through pyserial, with reasons for people.

The two ways of watching a device, by its file descriptor or by threads, are in modules of their own.
"""

from __future__ import annotations

import contextlib
import errno
import os
from abc import ABC, abstractmethod
from typing import Any, Protocol

from framekit.definition.line_settings import PLAIN, Direction, LineSettings
from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault

READ_SIZE = 1024
POLL = 0.05
"""How long a thread waits at a time for a device without a file descriptor (s)."""
SERIAL_ERRORS: tuple[type[Exception], ...] = (OSError, ValueError, TypeError, AttributeError, KeyError)
"""What pyserial raises when a device is not there, goes away, is closed while a thread reads it, or a URL is wrong."""
SWITCH_ERRORS: tuple[type[Exception], ...] = (*SERIAL_ERRORS, NotImplementedError)
"""What pyserial raises where a driver cannot switch the direction."""

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


class SerialEvents(Protocol):
    """What an open device tells; always in calls of the loop."""

    def opened(self) -> None: ...

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...]) -> None: ...

    def line_break(self, now: int) -> None: ...

    def lost(self, reason: str) -> None: ...


class SerialConnection(ABC):
    """A device from opening to closing. `has_bit_times`: bytes take their time on a line (they do not on a pty)."""

    has_bit_times = True

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Hands bytes over to the device without waiting."""

    @property
    @abstractmethod
    def waiting(self) -> int:
        """How many bytes have not left yet, as far as that can be asked."""

    @property
    def has_carrier(self) -> bool | None:
        """Whether a modem says that there is a carrier (DCD); None where that is not known."""
        return None

    @abstractmethod
    def set_line(self, name: str, on: bool) -> None:
        """Sets a pyserial attribute (`rts`, `break_condition`), where the device has it."""

    @abstractmethod
    def flush_input(self) -> None:
        """Drops what has come and has not been read."""

    @abstractmethod
    def drop_output(self) -> None:
        """Drops what has not left, where closing the device would wait for it."""

    @abstractmethod
    def stop(self) -> None:
        """Closes the device, soon; nothing is told any more."""


def open_device(url: str, settings: LineFormat | None, wiring: LineSettings = PLAIN) -> Any:
    """The pyserial object of a device or URL. Raises one of `SERIAL_ERRORS`."""
    import serial

    line = settings or LineFormat(9600)
    options: dict[str, Any] = {"timeout": POLL, "exclusive": True if is_device(url) and os.name == "posix" else None}
    opened = serial.serial_for_url(
        url,
        baudrate=line.speed,
        bytesize=line.data_bits,
        parity=line.parity,
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
    """Hands the direction of the line over to the driver (TIOCSRS485). Raises OSError where it cannot do that."""
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


def is_device(url: str) -> bool:
    """Whether it is a device of this machine and no URL."""
    return "://" not in url


def reason_of(error: Exception) -> str:
    """Why a device could not be opened or was lost, for people."""
    number = getattr(error, "errno", None)
    if number is None and error.__context__ is not None:  # pyserial hides what the system said of settings in words
        number = next(iter(error.__context__.args), None)
    if number in _REASONS:
        return _REASONS[number]
    return str(error) or type(error).__name__


def set_attribute(device: Any, name: str, on: bool) -> None:
    """Sets a line of a device; one that it does not have is passed over."""
    with contextlib.suppress(*SERIAL_ERRORS, NotImplementedError):
        setattr(device, name, on)
