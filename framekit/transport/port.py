"""Ports: the common interface of real, simulated and network lines. Bytes go out, events come in.

A port never raises errors of its line; it reports them to its owner, who passes `PortEvents` to `open`. The module also
has three ports around other ports: one passes everything on, one is shared by several stations, one shows the traffic.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import Clock


class PortEvents:
    """Events that a port reports to its owner, each with the time (ns) at which it happened, not at which it is
    reported.

    No event is reported during a call of a method of the port. A subclass ignores the events that it does not override.
    """

    def opened(self, now: int) -> None:
        """Handle the opening of the port: bytes can be sent and received from now on."""

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        """Handle received bytes without a pause between them; `now`: when the last of them was complete."""

    def other_sender(self, now: int) -> None:
        """Handle a change of sender: bytes before and after it never form one frame."""

    def line_break(self, now: int) -> None:
        """Handle a break: the other side holds the line in break state for longer than a character."""

    def sent(self, now: int) -> None:
        """Handle the end of transmission: the last bit of all data and breaks handed over has left.

        Reported once for several pieces.
        """

    def closed(self, now: int, reason: str) -> None:
        """Handle the loss of the port, or the failure to open it; it may be opened again."""

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        """Handle a change of control lines; `lines`: their present state by name (cts, dsr, dcd, ri)."""


class Port(ABC):
    """Interface for sending and receiving bytes.

    While a port is not open, all methods except `open` have no effect.
    """

    name: str
    has_exact_times = False
    """Whether the port reports when each bit came and left; simulated ports do."""
    settings: LineFormat | None
    """Speed and format at opening; None if the port has no baud rate."""
    opens_again = True
    """Whether the port can be opened again after closing."""
    is_stream = False
    """Whether the port carries a plain stream of bytes, without times or pieces that the other side can see."""
    sender = ""
    """Sender of the latest reported bytes, as HOST:PORT, if several senders are possible."""
    hears_marks = False
    """Whether the port, while open, reports which characters have their ninth bit set."""
    has_bit_times = True
    """Whether bytes take their time on the line, once it is open; False on a pseudo-terminal."""
    sees_damage = False
    """Whether the port, while open, reports damaged characters and breaks."""
    in_time = False
    """Whether the port uses the time of the clock's calls, however late they run, so that a busy process delays no
    simulated device.
    """

    @property
    def rests_until(self) -> int:
        """Return the time (ns) before which the port should not be opened again after a failure; 0: at once.

        A modem makes no call meanwhile.
        """
        return 0

    @property
    def has_unread(self) -> bool:
        """Return whether bytes have arrived that are not reported yet; False if the port cannot know."""
        return False

    @abstractmethod
    def open(self, events: PortEvents) -> None:
        """Open the port; `events.opened` or `events.closed` follows. Bytes received before are dropped."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send bytes after everything handed over before; `sent` follows, also for empty data."""

    def write_through(self, data: bytes) -> bool:
        """Send bytes as `write` does; return True if everything has left already, in which case `sent` does not
        follow.
        """
        self.write(data)
        return False

    def write_marked(self, data: bytes, marked: int) -> None:
        """Send bytes as `write` does, with the ninth bit set for the byte at index `marked` only, if the format has a
        ninth bit.
        """
        self.write(data)

    @abstractmethod
    def close(self) -> None:
        """Close the port; no event follows. Closing twice has no effect."""

    def when_closed(self, done: Callable[[], None]) -> None:
        """Call `done` once, when a closed port has finished its work: at once, or after a modem has hung up."""
        done()

    @abstractmethod
    def send_break(self, duration: int) -> None:
        """Hold the line in break state for `duration` ns, after everything handed over before; `sent` follows.

        If the port has no break state, it sends no data meanwhile; a network connection does not even wait.
        """

    def change_line(self, line: LineFormat) -> None:  # noqa: B027 - a port without a baud rate has nothing to do
        """Change speed and format at once, if the port has them, until it is opened again; all sent data must have
        left.
        """

    def set_rts(self, on: bool) -> None:  # noqa: B027 - a port without the line has nothing to do
        """Set request-to-send at once, if the port has it."""

    def set_dtr(self, on: bool) -> None:  # noqa: B027 - a port without the line has nothing to do
        """Set data-terminal-ready at once, if the port has it; it is on after opening."""

    def release(self) -> None:  # noqa: B027 - most hold nothing while they are closed
        """Release the resources that the port holds even while closed; it must not be opened again."""

    def describes(self) -> str:
        """Return a description for users: the name and, if the port has a baud rate, speed and format."""
        return self.name if self.settings is None else f"{self.name} at {self.settings}"


class AcceptedPort(Port):
    """Port of one connection accepted by a listener; it cannot be opened again.

    Bytes received earlier wait for its opening.
    """

    opens_again = False
    host = ""
    """Address of the other side."""
    identity = ""
    """Name in the certificate of the other side, if a certificate was required."""
    ends_itself = True
    """Whether the other side reports the end of the connection."""


Accepted = Callable[[AcceptedPort], None]
"""Callback for the port, not yet opened, of each new connection."""


class PortListener(Protocol):
    """Listener that creates a port for each connection. It can listen again after `stop`."""

    name: str
    """Address at which it listens; exact once it listens."""
    reached: str
    """Name under which others connect; exact once it listens."""

    def listen(self) -> None:
        """Begin to listen; connections are accepted once the loop continues. Raises OSError."""

    async def start(self) -> None:
        """Listen as `listen` does; connections are accepted when it returns. Raises OSError."""

    def stop(self) -> None:
        """Stop accepting; accepted ports stay open if each has its own connection."""


class PassingPort(Port, PortEvents):
    """Port that forwards all calls of its owner to `inner`, and all events of `inner` to its owner."""

    def __init__(self, inner: Port) -> None:
        self.inner = inner
        self.name = inner.name
        self.settings = inner.settings
        self.opens_again = inner.opens_again
        self.in_time = inner.in_time
        self.has_exact_times = inner.has_exact_times
        self.events: PortEvents | None = None

    def forget(self) -> None:
        """End the use of the port."""
        self.events = None

    # ---- calls of the owner -------------------------------------------------------------------------------

    def open(self, events: PortEvents) -> None:
        if self.events is not None:
            self.close()
        self.events = events
        self.inner.open(self)

    def write(self, data: bytes) -> None:
        self.inner.write(data)

    def close(self) -> None:
        self.forget()
        self.inner.close()

    def send_break(self, duration: int) -> None:
        self.inner.send_break(duration)

    def change_line(self, line: LineFormat) -> None:
        self.inner.change_line(line)

    def set_rts(self, on: bool) -> None:
        self.inner.set_rts(on)

    def set_dtr(self, on: bool) -> None:
        self.inner.set_dtr(on)

    def when_closed(self, done: Callable[[], None]) -> None:
        self.inner.when_closed(done)

    @property
    def rests_until(self) -> int:
        return self.inner.rests_until

    def write_marked(self, data: bytes, marked: int) -> None:
        self.inner.write_marked(data, marked)

    @property
    def sender(self) -> str:  # type: ignore[override]
        return self.inner.sender

    @property
    def hears_marks(self) -> bool:  # type: ignore[override]
        return self.inner.hears_marks

    @property
    def sees_damage(self) -> bool:  # type: ignore[override]
        return self.inner.sees_damage

    @property
    def has_unread(self) -> bool:
        return self.inner.has_unread

    @property
    def has_bit_times(self) -> bool:  # type: ignore[override]
        return self.inner.has_bit_times

    def release(self) -> None:
        self.inner.release()

    # ---- events of the inner port -------------------------------------------------------------------------

    def opened(self, now: int) -> None:
        if self.events is not None:
            self.events.opened(now)

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        if self.events is not None:
            self.events.received(data, now, faults)

    def other_sender(self, now: int) -> None:
        if self.events is not None:
            self.events.other_sender(now)

    def line_break(self, now: int) -> None:
        if self.events is not None:
            self.events.line_break(now)

    def sent(self, now: int) -> None:
        if self.events is not None:
            self.events.sent(now)

    def closed(self, now: int, reason: str) -> None:
        events = self.events
        self.forget()
        if events is not None:
            events.closed(now, reason)

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        if self.events is not None:
            self.events.control(lines, now)


class SharedPort(PortEvents):
    """Port for several users: opened by the first user that opens, closed by the first that closes, with an event to
    the others.
    """

    def __init__(self, port: Port, clock: Clock) -> None:
        self.port = port
        self.clock = clock
        self.is_open = False
        self.is_opening = False
        self.users: dict[UserPort, PortEvents] = {}
        self.sending: set[UserPort] = set()

    def user(self) -> UserPort:
        """Return a port for one more user, not yet opened."""
        return UserPort(self)

    # ---- calls of the users -------------------------------------------------------------------------------

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
        """Close the port for all users; the others get an event, and may open it again."""
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
        """Report `sent` to each user that has sent since the previous event."""
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
    """The port as seen by one of its users."""

    def __init__(self, shared: SharedPort) -> None:
        self.shared = shared
        self.name = shared.port.name
        self.settings = shared.port.settings
        self.opens_again = shared.port.opens_again
        self.has_exact_times = shared.port.has_exact_times

    def open(self, events: PortEvents) -> None:
        self.shared.open(self, events)

    def write(self, data: bytes) -> None:
        if self in self.shared.users:
            self.shared.sending.add(self)
            self.shared.port.write(data)

    def write_marked(self, data: bytes, marked: int) -> None:
        if self in self.shared.users:
            self.shared.sending.add(self)
            self.shared.port.write_marked(data, marked)

    @property
    def rests_until(self) -> int:
        return self.shared.port.rests_until

    @property
    def hears_marks(self) -> bool:  # type: ignore[override]
        return self.shared.port.hears_marks

    @property
    def has_unread(self) -> bool:
        return self.shared.port.has_unread

    @property
    def sees_damage(self) -> bool:  # type: ignore[override]
        return self.shared.port.sees_damage

    @property
    def has_bit_times(self) -> bool:  # type: ignore[override]
        return self.shared.port.has_bit_times

    def close(self) -> None:
        self.shared.close(self)

    def when_closed(self, done: Callable[[], None]) -> None:
        self.shared.port.when_closed(done)

    def send_break(self, duration: int) -> None:
        if self in self.shared.users:
            self.shared.sending.add(self)
            self.shared.port.send_break(duration)

    def change_line(self, line: LineFormat) -> None:
        self.shared.port.change_line(line)

    def set_rts(self, on: bool) -> None:
        self.shared.port.set_rts(on)


LineEventKind = Literal["data", "break", "control", "open", "closed"]
Way = Literal["in", "out", ""]


@dataclass(frozen=True, slots=True)
class LineEvent:
    """An event of a line."""

    kind: LineEventKind
    at: int
    """Time at which the last byte was complete, or was handed over for sending (ns)."""
    direction: Way = ""
    data: bytes = b""
    faults: tuple[CharacterFault, ...] = ()
    """Damaged and marked characters of `data`."""
    lines: Mapping[str, bool] = field(default_factory=dict)
    """Control lines by name."""
    reason: str = ""
    """Reason for closing."""


Tap = Callable[[LineEvent], None]


class TappedPort(PassingPort):
    """Port that shows all traffic of `inner` to `tap`, before the user of the port gets it."""

    def __init__(self, inner: Port, clock: Clock, tap: Tap) -> None:
        super().__init__(inner)
        self.clock = clock
        self.tap = tap
        self.is_open = False

    # ---- calls of the owner -------------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        self._show(data)
        self.inner.write(data)

    def write_through(self, data: bytes) -> bool:
        self._show(data)
        return self.inner.write_through(data)

    def write_marked(self, data: bytes, marked: int) -> None:
        self._show(data, (CharacterFault(marked, LineFault.MARK),))
        self.inner.write_marked(data, marked)

    def _show(self, data: bytes, marks: tuple[CharacterFault, ...] = ()) -> None:
        if self.is_open and data:
            self.tap(LineEvent("data", self.clock.now(), "out", data, marks))

    def close(self) -> None:
        if self.is_open:
            self.is_open = False
            self.tap(LineEvent("closed", self.clock.now()))
        super().close()

    def send_break(self, duration: int) -> None:
        if self.is_open:
            self.tap(LineEvent("break", self.clock.now(), "out"))
        self.inner.send_break(duration)

    def set_rts(self, on: bool) -> None:
        if self.is_open:
            self.tap(LineEvent("control", self.clock.now(), "out", lines={"rts": on}))
        self.inner.set_rts(on)

    def describes(self) -> str:
        return self.inner.describes()

    # ---- events of the inner port -------------------------------------------------------------------------

    def opened(self, now: int) -> None:
        self.is_open = True
        self.tap(LineEvent("open", now))
        super().opened(now)

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self.tap(LineEvent("data", now, "in", data, tuple(faults)))
        super().received(data, now, faults)

    def line_break(self, now: int) -> None:
        self.tap(LineEvent("break", now, "in"))
        super().line_break(now)

    def closed(self, now: int, reason: str) -> None:
        self.is_open = False
        self.tap(LineEvent("closed", now, reason=reason))
        super().closed(now, reason)

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        self.tap(LineEvent("control", now, "in", lines=dict(lines)))
        super().control(lines, now)
