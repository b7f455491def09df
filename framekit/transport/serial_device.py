"""Open serial devices: what a port needs of one, opening through pyserial with reasons for people, and two threads.

A device that the loop can watch by its file descriptor is a `DescriptorConnection` (`serial_descriptor`). Where it
cannot (a pyserial URL, a device of Windows), opening, writing and closing may take seconds: two threads do all of it.
"""

from __future__ import annotations

import contextlib
import errno
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import Any, Protocol

from framekit.definition.times import PLAIN, Direction, LineFormat, LineSettings
from framekit.link.events import CharacterFault
from framekit.transport.clock import AsyncioClock

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
