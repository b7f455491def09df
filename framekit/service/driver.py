"""Binds one engine to one port and a clock: events in, commands out, at the times the engine asks for.

No bytes from the wire raise an exception out of here. A lost port is reopened with back-off.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from framekit.definition.times import NEVER, LineFormat
from framekit.link.events import Break, ChangeLine, CharacterFault, Command, Send, SetRts
from framekit.transport.clock import Clock, Handle
from framekit.transport.port import Port, PortEvents

log = logging.getLogger(__name__)


class LineLoad:
    """Counts the bytes of a line. `line` None: the line has no speed, and its load is unknown."""

    __slots__ = ("_before", "_counted", "_sampled", "_sampled_at", "began", "bytes_in", "bytes_out", "character_time")

    def __init__(self, line: LineFormat | None, began: int) -> None:
        self.character_time = 0 if line is None else line.character_time
        self.began = self._sampled_at = began
        self.bytes_in = self.bytes_out = 0
        self._sampled = self._before = self._counted = 0

    def change(self, line: LineFormat) -> None:
        """Note another speed or format of the line from now on."""
        self._before, self._counted = self._busy, self.bytes
        self.character_time = line.character_time

    @property
    def _busy(self) -> int:
        """Return the time for which the line was busy (ns)."""
        return self._before + (self.bytes - self._counted) * self.character_time

    def begin(self, now: int) -> None:
        """Begin to measure time, if no byte has been on the line before."""
        if not self.bytes:
            self.began = self._sampled_at = now

    @property
    def bytes(self) -> int:
        """Return the number of bytes in both directions."""
        return self.bytes_in + self.bytes_out

    def share(self, now: int) -> float | None:
        """Return the share of the time since the beginning for which the line was busy (0 to 1); None without a
        speed.
        """
        return self._share(self._busy, now - self.began)

    def since_last(self, now: int) -> float | None:
        """Return the share of the time since the last call for which the line was busy; None without a speed."""
        busy = self._busy
        found = self._share(busy - self._sampled, now - self._sampled_at)
        self._sampled_at, self._sampled = now, busy
        return found

    def _share(self, busy: int, elapsed: int) -> float | None:
        if not self.character_time:
            return None
        return busy / elapsed if elapsed > 0 else 0.0


FIRST_RETRY, LONGEST_RETRY = 500_000_000, 30_000_000_000

STALL = 5_000_000
"""A call that comes later than this (ns) shows that the process was stalled, and that the loop has not read yet."""

MOST_UNREAD = 65_536
"""Limit of the bytes that are read before expired time limits take effect."""

IDLE_TURNS, MOST_TURNS = 2, 256
"""Expired time limits take effect after this number of successive turns of the loop in which the port reported no byte.

The first number counts if the port has no unread bytes or cannot know, the second if it has unread bytes.
"""


class Driven(Protocol):
    """The contract of a driver with an engine, or with a listener."""

    @property
    def deadline(self) -> int: ...

    @property
    def good_frames(self) -> int:
        """Return the number of good frames received so far. Without a protocol: of received bytes."""

    def opened(self, now: int) -> list[Command]: ...

    def hear_marks(self) -> None: ...

    def hear_late(self) -> None: ...

    def closed(self, now: int, reason: str = "") -> list[Command]: ...

    def receive(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> list[Command]: ...

    def other_sender(self, now: int) -> list[Command]: ...

    def line_break(self, now: int) -> list[Command]: ...

    def sent(self, now: int) -> list[Command]: ...

    def control(self, lines: Mapping[str, bool], now: int) -> list[Command]: ...

    def tick(self, now: int) -> list[Command]: ...


class Moment(Protocol):
    """The contract of an object that collects the effects of an event: it is `inside` until `end` is called."""

    inside: bool

    def end(self) -> None: ...


class Driver(PortEvents):
    """Runs an engine on a port. `on_state(text)` is called when the port opens, closes or fails.

    `pending` are the commands of the engine that are not carried out yet, `load` measures how busy the line is.
    `moment` encloses the effects of received bytes.
    """

    def __init__(
        self, engine: Driven, port: Port, clock: Clock, on_state: Callable[[str], None] | None = None,
        moment: Moment | None = None,
    ) -> None:  # fmt: skip
        self.engine = engine
        self.port = port
        self.clock = clock
        self.on_state = on_state or (lambda text: None)
        self.moment = moment
        self._now = clock.moment if port.in_time else clock.now
        self.is_open = False
        self.closed_by_engine = False
        """Whether the engine has closed the working port: received bytes are no frames, or the session is lost."""
        self.stopped = False
        self._started = False
        self.reopenings = 0
        self.load = LineLoad(port.settings, clock.now())
        self.pending: deque[Command] = deque()
        self._alarm = clock.alarm(self._ring)
        self._is_reading = False
        """Whether times that have run out wait until the port has read what arrived before."""
        self._read_from = self._read_to = self._idle_turns = 0
        self._send_timer: Handle | None = None
        self._reopen_timer: Handle | None = None
        self.longest_retry = LONGEST_RETRY
        """The longest pause before the port is opened again (ns)."""
        self._retry = FIRST_RETRY
        """The next pause (ns). It doubles until the other side has shown that it works, see `_has_worked`."""
        self._opened_at: int | None = None
        """The time of the last opening; None while the port is not open."""
        self._frames_before = 0
        """The number of good frames at that time."""

    # ---- life ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Open the port; try again until `stop` or `switch_off`, unless the port can be opened only once.

        A second call has no effect.
        """
        if self._started:
            return
        self._started = True
        self._retry = min(FIRST_RETRY, self.longest_retry)
        self.stopped = False
        self.load.begin(self.clock.now())
        self.port.open(self)

    def stop(self) -> None:
        """Close the port and drop the commands that are not carried out."""
        self.stopped, self._started = True, False
        self._is_reading = False
        self.pending.clear()
        self._alarm.cancel()
        for timer in (self._send_timer, self._reopen_timer):
            if timer is not None:
                timer.cancel()
        self._send_timer = self._reopen_timer = None
        self.port.close()

    def switch_off(self) -> None:
        """Close the port until `start`, and report that to the engine, so that exchanges under way end."""
        if not self.stopped:
            self.stop()
            self.is_open = False
            self.on_state("switched off")
            self.carry_out(self.engine.closed(self.clock.now(), "switched off"))

    def hurry(self) -> bool:
        """Open at once a port that waits to be opened again, unless it has to rest.

        Return whether the port is open or may be opened again.
        """
        if not self._started or self.stopped:
            return False
        rests = self.port.rests_until > self.clock.now()
        if self._reopen_timer is not None and not self.is_open and not rests:
            self._reopen_timer.cancel()
            self._reopen_timer = None
            self._reopen()
        return self.is_open or self.port.opens_again

    def do(self, action: Callable[[int], list[Command]]) -> None:
        """Call a function that acts on the engine (starts an exchange, for example), and carry out the commands."""
        self.carry_out(action(self.clock.now()))

    def later(self, delay: int, action: Callable[[int], list[Command]]) -> Callable[[], None]:
        """Call a function that acts on the engine after a delay, unless stopped before; the result cancels the call."""

        def act() -> None:
            if not self.stopped:
                self.do(action)

        return self.clock.call_at(self.clock.now() + delay, act).cancel

    # ---- events of the port -------------------------------------------------------------------------------

    def opened(self, now: int) -> None:
        if self.stopped:  # it took so long that it is not wanted any more
            self.port.close()
            return
        self.is_open = True
        self._opened_at, self._frames_before = now, self.engine.good_frames
        self.on_state("open")
        own = self.port.settings
        if own is not None and own.character_time != self.load.character_time:
            self.load.change(own)
        if self.port.hears_marks:
            self.engine.hear_marks()
        if not self.port.has_exact_times:
            self.engine.hear_late()
        self.carry_out(self.engine.opened(now))

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self.load.bytes_in += len(data)
        moment = self.moment
        if moment is not None:
            moment.inside = True
        try:
            commands = self.engine.receive(data, now, faults)
            if commands:
                self.pending.extend(commands)
            if self.pending:
                self._next_commands()
        finally:
            try:
                if moment is not None:
                    moment.end()
            finally:  # the timer must be set after errors, too
                self._alarm.set(NEVER if self.stopped else self.engine.deadline)

    def other_sender(self, now: int) -> None:
        self.carry_out(self.engine.other_sender(now))

    def line_break(self, now: int) -> None:
        self.carry_out(self.engine.line_break(now))

    def sent(self, now: int) -> None:
        self.carry_out(self.engine.sent(now))

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        self.carry_out(self.engine.control(dict(lines), now))

    def closed(self, now: int, reason: str) -> None:
        """Report to the engine that the port is gone, and open the port again after a while."""
        self.closed_by_engine = False
        self._closed(now, reason)

    def _closed(self, now: int, reason: str) -> None:
        self.is_open = False
        self.pending.clear()
        if self.stopped:
            return
        if self._has_worked(now):
            self._retry = min(FIRST_RETRY, self.longest_retry)
        self._opened_at = None
        next_time = max(now + self._retry, self.port.rests_until)
        again = f", trying again in {(next_time - now) / 1e9:.1f} s" if self.port.opens_again else ""
        log.info("%s: closed (%s)%s", self.port.name, reason, again)
        self.on_state(reason)
        self.carry_out(self.engine.closed(now, reason))
        if self.port.opens_again:
            self._reopen_timer = self.clock.call_at(next_time, self._reopen)
            self._retry = min(2 * self._retry, self.longest_retry)

    def _has_worked(self, now: int) -> bool:
        """Return whether the port, open until now, has received a good frame, or was open for the longest pause.

        A device that accepts connections and closes them, or that sends no frame of the protocol, does not end the
        back-off.
        """
        if self._opened_at is None:
            return False
        return self.engine.good_frames != self._frames_before or now - self._opened_at >= self.longest_retry

    def _reopen(self) -> None:
        self._reopen_timer = None
        if not self.stopped and not self.is_open:
            self.reopenings += 1
            self.port.open(self)

    # ---- commands -----------------------------------------------------------------------------------------

    def carry_out(self, commands: list[Command]) -> None:
        """Carry out commands of the engine, in order, and set the alarm to its deadline."""
        try:
            if commands:
                self.pending.extend(commands)
                self._next_commands()
        finally:
            self.look_at_time()

    def _next_commands(self) -> None:
        """Carry out pending commands in order; a command with a future time holds back the following commands."""
        pending, port = self.pending, self.port
        while pending:
            command = pending.popleft()
            if isinstance(command, Send):
                if command.not_before and self._is_early(command):
                    return
                data = command.data
                self.load.bytes_out += len(data)
                if command.marked is not None:
                    port.write_marked(data, command.marked)
                elif port.write_through(data):  # everything has left: the port will not call `sent`
                    pending.extend(self.engine.sent(self.clock.now()))
            elif isinstance(command, Break):
                if self._is_early(command):
                    return
                port.send_break(command.duration)
            elif isinstance(command, ChangeLine):
                port.change_line(command.line)
                if port.settings is not None:
                    self.load.change(command.line)
            elif isinstance(command, SetRts):
                port.set_rts(command.on)
            else:
                port.close()
                self.closed_by_engine = True
                self._closed(self.clock.now(), command.reason)

    def _is_early(self, command: Send | Break) -> bool:
        """Return whether a command has to wait for its time; if so, it is pending again, and a timer is set."""
        if command.not_before <= self._now():
            return False
        self.pending.appendleft(command)
        if self._send_timer is not None:
            self._send_timer.cancel()
        self._send_timer = self.clock.call_at(command.not_before, self._go_on)
        return True

    def _go_on(self) -> None:
        """Carry out the command whose time has come; then set the alarm anew."""
        self._send_timer = None
        self._next_commands()
        self.look_at_time()

    # ---- time ---------------------------------------------------------------------------------------------

    def look_at_time(self) -> None:
        """Set the alarm to the deadline of the engine."""
        self._alarm.set(NEVER if self.stopped else self.engine.deadline)

    def _ring(self) -> None:
        """Let times run out, unless bytes are unread: they arrived before, however late the process is.

        After a stall the loop reads first, for ports that do not know whether bytes are unread. If the port raises an
        exception, times run out before it is passed on.
        """
        if self._is_reading:
            return
        now = self._now()
        try:
            self._is_reading = self.port.has_unread or now - self.engine.deadline > STALL
        finally:
            if self._is_reading:
                self._read_from = self._read_to = self.load.bytes_in
                self._idle_turns = 0
                self.clock.call_soon(self._read_on)
            else:
                self.carry_out(self.engine.tick(now))

    def _read_on(self) -> None:
        """Let times run out when the port has read everything; the loop reads in its turns."""
        if not self._is_reading:
            return
        now, count = self._now(), self.load.bytes_in
        self._idle_turns = self._idle_turns + 1 if count == self._read_to else 0
        self._read_to = count
        self._is_reading = False  # also if the port raises an exception
        try:
            most = MOST_TURNS if self.port.has_unread else IDLE_TURNS
            self._is_reading = self._idle_turns < most and count - self._read_from < MOST_UNREAD
        finally:
            if self._is_reading:
                self.clock.call_soon(self._read_on)
            else:
                self.carry_out(self.engine.tick(now))
