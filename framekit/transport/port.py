"""What a port is: bytes out, events in. One interface for real, simulated and network lines.

A port never raises what happens on its line; it tells its owner, who gives `PortEvents` when opening it. Then three
ports around other ports: one that passes on, one shared by several stations, one that shows what goes through it.
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
    """What a port tells its owner, with the time of each event (ns): when it happened, not when it is told.

    Nothing is told from inside of a call of the port's own methods. A subclass that leaves an event out ignores it.
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

    `settings`, speed and format when it opens, is None where there is no baud rate. While a port is not open, all
    methods but `open` do nothing.
    """

    name: str
    settings: LineFormat | None
    opens_again = True
    """Whether it can be opened again after it was closed."""
    is_stream = False
    """Whether what is written is only a row of bytes, without times or pieces that the other side sees."""
    sender = ""
    """Who sent what was told last, HOST:PORT, where several can be on the other side."""
    hears_marks = False
    """Whether it tells, while it is open, which characters have their ninth bit set."""
    has_bit_times = True
    """Whether bytes take their time on a line that has a speed, once it is open; they do not on a pseudo-terminal."""
    sees_damage = False
    """Whether it tells, while it is open, which characters came damaged, and of breaks."""
    in_time = False
    """Whether its time is that of the clock's calls, however late they come: so a busy process delays no device."""

    @abstractmethod
    def open(self, events: PortEvents) -> None:
        """Opens the port; `events.opened` or `events.closed` follows. What came before is dropped."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Sends bytes behind everything handed over before; `sent` follows, also when there are none."""

    def write_through(self, data: bytes) -> bool:
        """As `write`, for ports that can say at once that everything has left: True, and then `sent` is not told."""
        self.write(data)
        return False

    def write_marked(self, data: bytes, marked: int) -> None:
        """As `write`, the byte at index `marked` with its ninth bit set and the others without, where there is one."""
        self.write(data)

    @abstractmethod
    def close(self) -> None:
        """Closes the port; no event follows. Closing twice does nothing."""

    @abstractmethod
    def send_break(self, duration: int) -> None:
        """Holds the line in break state for `duration` ns, behind everything handed over before; `sent` follows.

        Where there is no break state nothing is sent meanwhile; a network connection does not even wait.
        """

    def change_line(self, line: LineFormat) -> None:  # noqa: B027 - a port without a baud rate has nothing to do
        """Other speed and format at once, where there are such, until it is opened anew; all it sent has left."""

    def set_rts(self, on: bool) -> None:  # noqa: B027 - a port without the line has nothing to do
        """Switches request-to-send at once, where there is one."""

    def release(self) -> None:  # noqa: B027 - most hold nothing while they are closed
        """It will not be opened any more: gives back what it holds even while it is closed."""

    def describes(self) -> str:
        """What the port is, for people: its name and, where it has a baud rate, speed and format."""
        return self.name if self.settings is None else f"{self.name} at {self.settings}"


class AcceptedPort(Port):
    """The port of one connection that came to a listener; it can't be opened again. What comes before waits for that.

    `host`: the address of the other side; `identity`: the name in its certificate, where it had to show one.
    `ends_itself`: whether the other side tells when it has finished.
    """

    opens_again = False
    host = ""
    identity = ""
    ends_itself = True


Accepted = Callable[[AcceptedPort], None]
"""Gets the port, not yet opened, of each connection that comes."""


class PortListener(Protocol):
    """Listens somewhere and makes a port of everything that connects. It can listen again after it was stopped.

    `name`: where it listens; `reached`: how others name it. Both are exact once it listens.
    """

    name: str
    reached: str

    def listen(self) -> None:
        """Begin to listen; connections are accepted as soon as the loop goes on. Raises OSError."""

    async def start(self) -> None:
        """As `listen`; connections are accepted when it returns. Raises OSError."""

    def stop(self) -> None:
        """Accept no more; ports that have been accepted stay open where each has a connection of its own."""


class PassingPort(Port, PortEvents):
    """Passes on what its owner does, and what the port behind it tells."""

    def __init__(self, inner: Port) -> None:
        self.inner = inner
        self.name = inner.name
        self.settings = inner.settings
        self.opens_again = inner.opens_again
        self.in_time = inner.in_time
        self.events: PortEvents | None = None

    def forget(self) -> None:
        """The use of the port is over."""
        self.events = None

    # ---- what its owner does ------------------------------------------------------------------------------

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
    def has_bit_times(self) -> bool:  # type: ignore[override]
        return self.inner.has_bit_times

    def release(self) -> None:
        self.inner.release()

    # ---- what the port behind it tells --------------------------------------------------------------------

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
    """Opened by the first user that opens, closed by the first that closes; the others are told."""

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
        """The port is closed for all its users; the others are told, and may open it again."""
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
        """Everything has left: each user that has sent something since the last time is told."""
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

    def write_marked(self, data: bytes, marked: int) -> None:
        if self in self.shared.users:
            self.shared.sending.add(self)
            self.shared.port.write_marked(data, marked)

    @property
    def hears_marks(self) -> bool:  # type: ignore[override]
        return self.shared.port.hears_marks

    @property
    def sees_damage(self) -> bool:  # type: ignore[override]
        return self.shared.port.sees_damage

    @property
    def has_bit_times(self) -> bool:  # type: ignore[override]
        return self.shared.port.has_bit_times

    def close(self) -> None:
        self.shared.close(self)

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
    """Something on a line. `at` (ns): when the last byte was complete, or when it was handed over for sending.

    `faults`: the damaged and marked characters of `data`; `lines`: control lines by name; `reason`: why it was closed.
    """

    kind: LineEventKind
    at: int
    direction: Way = ""
    data: bytes = b""
    faults: tuple[CharacterFault, ...] = ()
    lines: Mapping[str, bool] = field(default_factory=dict)
    reason: str = ""


Tap = Callable[[LineEvent], None]


class TappedPort(PassingPort):
    """The port `inner`, with `tap` told of everything before the user of the port."""

    def __init__(self, inner: Port, clock: Clock, tap: Tap) -> None:
        super().__init__(inner)
        self.clock = clock
        self.tap = tap
        self.is_open = False

    # ---- what its owner does ------------------------------------------------------------------------------

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

    # ---- what the port behind it tells --------------------------------------------------------------------

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
