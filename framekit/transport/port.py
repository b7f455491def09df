"""What a port is: bytes out, events in. One interface for real, simulated and network lines.

A port never raises what happens on its line; it tells its owner, who gives `PortEvents` when opening it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Protocol

from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault


class PortEvents(Protocol):
    """What a port tells its owner, with the time of each event (ns)."""

    def opened(self, now: int) -> None: ...

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        """Bytes came; `now` is when the last of them was complete."""

    def line_break(self, now: int) -> None: ...

    def sent(self, now: int) -> None:
        """The last bit of the oldest bytes (or break) handed over and not yet told of has left."""

    def closed(self, now: int, reason: str) -> None:
        """The port is gone, or could not be opened; it may be opened again."""

    def control(self, lines: Mapping[str, bool], now: int) -> None: ...


class Port(ABC):
    """A place to send bytes to and receive them from. `line` is None where there is no baud rate."""

    name: str
    line: LineFormat | None

    @abstractmethod
    def open(self, events: PortEvents) -> None:
        """Opens the port; `events.opened` or `events.closed` follows."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Sends bytes after everything handed over before; nothing is lost while the port is open."""

    @abstractmethod
    def close(self) -> None:
        """Closes the port; no event follows."""

    def send_break(self, duration: int) -> None:
        """Holds the line in break state for `duration` ns. Ports without one do nothing but say `sent`."""
        raise NotImplementedError

    def set_rts(self, on: bool) -> None:  # noqa: B027 - a port without the line has nothing to do
        """Switches request-to-send, where there is one."""
