"""What a port is: bytes out, events in. One interface for real, simulated and network lines.

A port never raises what happens on its line; it tells its owner, who gives `PortEvents` when opening it. What the
bytes mean, and who wants them, is not known here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Protocol

from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault


class PortEvents(Protocol):
    """What a port tells its owner, with the time of each event (ns): when it happened, not when it is told.

    Nothing is told from inside of a call of the port's own methods.
    """

    def opened(self, now: int) -> None:
        """Bytes can be sent and received."""

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        """Bytes came, without a pause between them; `now` is when the last of them was complete."""

    def other_sender(self, now: int) -> None:
        """What comes from now on comes from another sender than before: the two never make one frame."""

    def line_break(self, now: int) -> None:
        """The other side holds the line in break state, for longer than a character lasts."""

    def sent(self, now: int) -> None:
        """The last bit of everything handed over (bytes and breaks) has left; told once, however many pieces it was."""

    def closed(self, now: int, reason: str) -> None:
        """The port is gone, or could not be opened; it may be opened again."""

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        """The control lines as they are now, by name (cts, dsr, dcd, ri)."""


class Port(ABC):
    """A place to send bytes to and receive them from.

    `settings` is None where there is no baud rate. While a port is not open, all methods but `open` do nothing.
    """

    name: str
    settings: LineFormat | None
    opens_again = True
    """Whether it can be opened again after it was closed."""

    @abstractmethod
    def open(self, events: PortEvents) -> None:
        """Opens the port; `events.opened` or `events.closed` follows. What came before belongs to nobody."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Sends bytes behind everything handed over before; `sent` follows, also when there are none."""

    def write_through(self, data: bytes) -> bool:
        """As `write`, for ports that can say at once that everything has left: True, and then `sent` is not told."""
        self.write(data)
        return False

    @abstractmethod
    def close(self) -> None:
        """Closes the port; no event follows. Closing twice does nothing."""

    @abstractmethod
    def send_break(self, duration: int) -> None:
        """Holds the line in break state for `duration` ns, behind everything handed over before; `sent` follows.

        Where there is no break state nothing is sent meanwhile; a network connection does not even wait.
        """

    def set_rts(self, on: bool) -> None:  # noqa: B027 - a port without the line has nothing to do
        """Switches request-to-send at once, where there is one."""

    def flush_input(self) -> None:  # noqa: B027 - a port that keeps nothing back has nothing to do
        """Drops what has come and has not been told yet."""

    def describes(self) -> str:
        """What the port is, for people: its name and, where it has a baud rate, speed and format."""
        return self.name if self.settings is None else f"{self.name} at {self.settings}"
