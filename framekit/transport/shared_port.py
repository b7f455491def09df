"""One port for several users, each of whom sees a port of its own: several stations on one line.

Everybody hears what comes; nobody hears what the others send. What the bytes mean is not known here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from framekit.link.events import CharacterFault
from framekit.transport.clock import Clock
from framekit.transport.port import Port, PortEvents


class SharedPort:
    """Opened by the first user that opens, closed by the first that closes; the others are told."""

    def __init__(self, port: Port, clock: Clock) -> None:
        self.port = port
        self.clock = clock
        self.is_open = False
        self.is_opening = False
        self.users: dict[UserPort, PortEvents] = {}
        self.sending: set[UserPort] = set()

    def user(self) -> UserPort:
        """A port for one more user, not yet opened."""
        return UserPort(self)

    # ---- what users do ------------------------------------------------------------------------------------

    def open(self, user: UserPort, events: PortEvents) -> None:
        self.users[user] = events
        if self.is_open:
            self.clock.call_soon(lambda: self._tell_open(user, events))
        elif not self.is_opening:
            self.is_opening = True
            self.port.open(self)

    def _tell_open(self, user: UserPort, events: PortEvents) -> None:
        if self.is_open and self.users.get(user) is events:
            events.opened(self.clock.now())

    def close(self, user: UserPort) -> None:
        """The port is closed for everybody; the others are told, and may open it again."""
        if self.users.pop(user, None) is None:
            return
        self.sending.discard(user)
        others, self.users = self.users, {}
        self.sending.clear()
        self.is_open = self.is_opening = False
        self.port.close()
        self.clock.call_soon(lambda: self._tell_closed(others.values()))

    def _tell_closed(self, others: Iterable[PortEvents]) -> None:
        for events in others:
            events.closed(self.clock.now(), "another station has closed it")

    # ---- events of the port -------------------------------------------------------------------------------

    def opened(self, now: int) -> None:
        self.is_open, self.is_opening = True, False
        for events in list(self.users.values()):
            events.opened(now)

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        for events in list(self.users.values()):
            events.received(data, now, faults)

    def other_sender(self, now: int) -> None:
        for events in list(self.users.values()):
            events.other_sender(now)

    def line_break(self, now: int) -> None:
        for events in list(self.users.values()):
            events.line_break(now)

    def sent(self, now: int) -> None:
        """Everything has left: whoever has sent something since the last time is told."""
        sending, self.sending = self.sending, set()
        for user, events in list(self.users.items()):
            if user in sending:
                events.sent(now)

    def closed(self, now: int, reason: str) -> None:
        users, self.users = self.users, {}
        self.sending.clear()
        self.is_open = self.is_opening = False
        for events in users.values():
            events.closed(now, reason)

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        for events in list(self.users.values()):
            events.control(lines, now)


class UserPort(Port):
    """The port as one of its users sees it."""

    def __init__(self, shared: SharedPort) -> None:
        self.shared = shared
        self.name = shared.port.name
        self.settings = shared.port.settings
        self.opens_again = shared.port.opens_again

    def open(self, events: PortEvents) -> None:
        self.shared.open(self, events)

    def write(self, data: bytes) -> None:
        if self in self.shared.users:
            self.shared.sending.add(self)
            self.shared.port.write(data)

    def close(self) -> None:
        self.shared.close(self)

    def send_break(self, duration: int) -> None:
        if self in self.shared.users:
            self.shared.sending.add(self)
            self.shared.port.send_break(duration)

    def set_rts(self, on: bool) -> None:
        self.shared.port.set_rts(on)

    def flush_input(self) -> None:
        self.shared.port.flush_input()
