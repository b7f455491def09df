"""The link engine of one side of a line: events in, commands out (language reference, sections 6 to 8).

Sans-I/O: it has no clock, port or task. What follows from an event, and in which order, is in `engine_core`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from framekit.link.direct import DirectRequest
from framekit.link.direct_lane import DirectAsk
from framekit.link.engine_core import EngineCore
from framekit.link.events import CharacterFault, Command
from framekit.link.exchange import Exchange, Outcome
from framekit.link.frame_info import FrameInfo
from framekit.link.output import Item
from framekit.link.runs import State
from framekit.link.values import FrameValue


class Engine(EngineCore):
    """One side of a line. `role` None: frames alone are sent and received.

    `server` does what requests ask for; `ask` runs services for `ask` steps; `memory` is for `store` and `memory()`.
    `device`: what engines that play the same device share. `on_frame` gets good frames that nobody waited for.
    `monitor` is shown everything; without one that costs nothing. `on_fault` is shown everything but frames, `on_send`
    is told of each frame that a sequence sends; neither has frames read.
    Raises ParameterError for parameters that do not fit and KeyError for an unknown role. Nothing else here raises:
    what cannot be done is reported by outcomes and to the monitor.
    """

    # ---- events -------------------------------------------------------------------------------------------

    def opened(self, now: int) -> list[Command]:
        """The port, or the connection, is there."""
        self.direct.unfold()
        self.scope.now = now
        self.receiver.reset()
        self.machine.late.forget()
        self.lanes.is_open = self.output.is_open = True
        self.lanes.was_closed = False
        self.machine.stirred = True
        self.machine.show("open")
        self.output.poll()
        return self._finish()

    def closed(self, now: int, reason: str = "") -> list[Command]:
        """The connection is gone; what was to be sent is dropped, and whoever does not handle it fails."""
        self.scope.now = now
        self.direct.unfold()
        self.lanes.is_open = self.output.is_open = False
        self.lanes.was_closed = True
        self.machine.show("closed", reason=reason)
        self.output.clear()
        for run in self.lanes.order:
            run.unsent = 0
        self.reception.show_noise(self.receiver.reset())
        self.machine.session.end()
        self.dispatcher.closed(reason or "the connection is closed")
        self.lanes.fail_waiting("closed", reason)
        self.machine.late.forget()
        return self._finish()

    def receive(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> list[Command]:
        """Bytes came, the last of them at `now`; `faults` names damaged characters among them."""
        if self.deadline < now:
            self._tick(now)
        self.scope.now = self.output.last_received = now
        found = None if faults else self.direct.receive(data, now)
        if found is not None:
            return self._told(found)
        self.direct.unfold()
        self.receiver.append(data, now, faults)
        if data:
            self.dispatcher.byte()
        return self._finish()

    def other_sender(self, now: int) -> list[Command]:
        """What comes from now on comes from another sender. What had come before of a frame belongs to nothing."""
        self.scope.now = now
        self.direct.unfold()
        self.reception.show_noise(self.receiver.flush())
        return self._finish()

    def line_break(self, now: int) -> list[Command]:
        """The line was in break state. What had come before of a frame belongs to nothing."""
        self.scope.now = self.output.last_received = now
        self.direct.unfold()
        self.reception.show_noise(self.receiver.flush())
        self.machine.show("break", "in")
        self.dispatcher.line_break()
        return self._finish()

    def sent(self, now: int) -> list[Command]:
        """The last bit of the oldest command to send, or of a break, has left (not of those sent inside others)."""
        self.scope.now = now
        item = self.output.left()
        if item is not None and self.direct.left(item):
            return self._given()
        if item is not None:
            self.receiver.answered()
            if item.run is not None:
                self.machine.left(item.run)
            if item.on_sent is not None:
                self.machine.callbacks.append(item.on_sent)
        return self._finish()

    def control(self, lines: Mapping[str, bool], now: int) -> list[Command]:
        """The control lines as they are now (cts, dsr, dcd, ri). Without clear-to-send nothing is sent."""
        self.scope.now = now
        self.direct.disturb()
        self.output.clear_to_send = lines.get("cts", True)
        self.output.poll()
        return self._finish()

    def tick(self, now: int) -> list[Command]:
        """Time has passed; to be called when `deadline` is reached."""
        self._tick(now)
        return self._finish()

    # ---- what is asked of it ------------------------------------------------------------------------------

    def start(self, exchange: Exchange, now: int) -> list[Command]:
        """Queues an exchange; it begins when its lane has room. Its outcome comes by `on_done`."""
        self.scope.now = max(self.scope.now, now)
        self.direct.unfold()
        run = self.machine.asking
        if exchange.inside is not None:
            run = exchange.inside.run
        lane = self.lanes.lane_for(exchange.run)
        if run is not None and run.state is State.ASKING:
            self.machine.guarded(run, self.machine.start_inside, exchange)
        elif lane is None:
            self.machine.tell(exchange, Outcome(False, "no_sequence", f"role '{self.role}' runs no such exchange"))
        elif self.lanes.was_closed:
            self.machine.tell(exchange, Outcome(False, "closed", "the connection is closed"))
        else:
            lane.waiting.append(exchange)
        self.machine.changed = self.machine.stirred = True
        return self._finish()

    def direct_request(self, exchange: Exchange) -> DirectRequest | None:
        """What `ask` needs for exchanges like this one, to be used again and again; None where there is no such way."""
        return self.direct.request(exchange)

    def ask(self, ask: DirectAsk, now: int) -> list[Command] | None:
        """As `start`, by a shorter way that is open while nothing else goes on. None: it is not; nothing is done."""
        self.scope.now = max(self.scope.now, now)
        return self._given() if self.direct.begin(ask) else None

    def unfold(self) -> None:
        """An exchange that was begun by `ask` goes on as if it had been started by `start`."""
        self.direct.unfold()

    def cancel(self, exchange: Exchange, now: int) -> list[Command]:
        """Ends an exchange, begun or not; what has been handed over for sending still goes out.

        If its reply is due, other requests wait for that.
        """
        self.scope.now = max(self.scope.now, now)
        self.direct.unfold()
        self.lanes.cancel(exchange)
        return self._finish()

    def give_up(self, exchange: Exchange, now: int) -> list[Command]:
        """An exchange is given up by its caller. What has been asked is waited for, but not asked again."""
        self.scope.now = max(self.scope.now, now)
        self.direct.unfold()
        self.lanes.give_up(exchange)
        return self._finish()

    def send_frame(
        self,
        frame: FrameValue | str,
        now: int,
        fields: Mapping[str, Any] | None = None,
        on_sent: Callable[[], None] | None = None,
    ) -> list[Command]:
        """Sends a frame by itself. Raises ValueError for values that it cannot carry, KeyError for an unknown frame."""
        self.scope.now = max(self.scope.now, now)
        self.direct.unfold()
        machine = self.machine
        if isinstance(frame, str):
            frame = machine.table.made(frame, dict(fields or {}), self.scope)
        data = machine.table.encode(frame, self.scope)
        machine.announce(frame)
        if machine.monitor is not None:
            machine.show("frame", "out", data, frame.frame, frame.complete())
        self.counters.sent += 1
        self._put(Item(None, data, info=machine.table.infos[frame.frame], on_sent=on_sent))
        return self._finish()

    def put_frame(self, info: FrameInfo, data: bytes, now: int, on_sent: Callable[[], None]) -> list[Command]:
        """Sends the bytes of a frame that announces nothing: nobody here has anything to do because of it."""
        self.scope.now = max(self.scope.now, now)
        self.direct.unfold()
        self.counters.sent += 1
        self._put(Item(None, data, 0, info, on_sent))
        return self._finish() if self.machine.changed or self.machine.stirred else self._given()

    def _put(self, item: Item) -> None:
        """Sends it, or keeps it as long as replies are due."""
        late = self.machine.late
        if late.until > self.scope.now:
            late.items.append(item)
        else:
            self.output.put(item)

    @property
    def is_quiet(self) -> bool:
        """Whether a frame that is sent by itself may go out at once, and nobody is shown it."""
        output = self.output
        return (
            output.outgoing is None
            and not output.pending
            and output.is_open
            and output.clear_to_send
            and output.is_immediate
            and not self.is_busy
            and self.machine.monitor is None
            and not self.machine.late.until
        )

    def has_put(self, info: FrameInfo, data: bytes, now: int, on_sent: Callable[[], None]) -> None:
        """As `put_frame` while it is quiet, for bytes that have been given to the port already."""
        self.scope.now = max(self.scope.now, now)
        self.direct.unfold()
        self.counters.sent += 1
        self.output.outgoing = Item(None, data, 0, info, on_sent)

    def close_session(self, now: int, on_done: Callable[[], None] = lambda: None) -> list[Command]:
        """Closes an open session as soon as no exchange runs or waits; `on_done` is called once, when all is sent."""
        self.scope.now = max(self.scope.now, now)
        self.direct.unfold()
        self.farewell.ask(on_done)
        return self._finish()

    @property
    def last_frame(self) -> int:
        """When the last good frame came or went (ns); at first when the engine was made."""
        return self.machine.last_frame

    def status(self) -> dict[str, Any]:
        """Published variables."""
        return self.scope.published()
