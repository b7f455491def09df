"""The queue of transmissions, with the silence that the line wants before each and RTS around it.

The next command is given when the last command has left. Sequences are not known here; the run of a transmission is
only kept for them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from framekit.definition.model.sections import Line
from framekit.definition.times import NEVER, LineFormat
from framekit.link.events import Break, ChangeLine, Command, Send, SetRts
from framekit.link.scope import Scope
from framekit.link.stream import marked_in
from framekit.link.values import compile_optional


class Output:
    """The queue to the line. `last_sent` and `last_received` are when the last character left or came (ns).

    `is_immediate`: frames go out without a pause or RTS before them. `is_stream`: the port
    has no times of its own, so frames that are due at once go out in one piece: `joined` leaves with `outgoing`.
    `held_until`: when frames that clear-to-send holds back are dropped (ns).
    `on_change` is called for a change of the line that is done, with whether the line had other settings before.
    """

    def __init__(self, line: Line, scope: Scope, commands: list[Command], is_stream: bool = False) -> None:
        self.scope = scope
        self.commands = commands
        self.pending: deque[Send | Break | ChangeLine] = deque()
        self.outgoing: Send | Break | None = None
        self.joined: list[Send] = []
        self.is_stream = is_stream
        self.on_change: Callable[[ChangeLine, bool], None] = lambda change, is_other: None
        self.last_sent = self.last_received = scope.now - (1 << 62)
        self.clear_to_send = True
        self.held_until = NEVER
        self.is_open = False
        self._rts = False
        self._turnaround = compile_optional(line.turnaround)
        self._key_delay = compile_optional(line.key_delay)
        self._clear_time = compile_optional(line.clear_time)
        self.limits_holds = line.clear_time is not None
        """Whether frames that clear-to-send holds back have a time limit."""
        self._has_marks = line.has_marks
        self.is_immediate = self._turnaround is None and self._key_delay is None

    def put(self, item: Send | Break) -> bool:
        """Queue an item. Return False if it goes into the frame that is leaving, and counts as sent with that frame."""
        outgoing = self.outgoing
        if self._has_marks and type(item) is Send and item.info is not None:
            item.marked = marked_in(item.info, len(item.data))
        if outgoing is None and self.is_immediate and self.is_open and not self.pending and self.clear_to_send:
            self.outgoing = item
            self.commands.append(item)
            return True
        if outgoing is not None and self._fits_inside(outgoing, item):
            self.commands.append(item)
            if type(item) is Send and item.on_sent is not None:
                self.joined.append(item)
            return False
        if outgoing is not None and type(item) is Send and self._joins(item):
            return True
        self.pending.append(item)
        self.poll()
        return True

    def _joins(self, item: Send) -> bool:
        """Append bytes to the last frame that is sent in this turn, if the port sends both in one piece."""
        last = self.commands[-1] if self.is_stream and self.commands else None
        if self.pending or not self.is_immediate or type(last) is not Send or last.inside:
            return False
        self.commands[-1] = Send(last.data + item.data)
        self.joined.append(item)
        return True

    def _fits_inside(self, outgoing: Send | Break, item: Send | Break) -> bool:
        """Return whether an item may go into the frame that is leaving, and mark it so."""
        if type(outgoing) is not Send or type(item) is not Send:
            return False
        around, frame = outgoing.info, item.info
        if around is None or frame is None or around.insert is None or frame.name not in around.carries:
            return False
        item.inside = bool(around.insert(self.scope))
        return item.inside

    def change_line(self, line: LineFormat) -> ChangeLine | None:
        """Change speed and format when everything queued has left. Return the pending change; None if it is done."""
        change = ChangeLine(line)
        self.pending.append(change)
        self.poll()
        return change if self.pending else None

    def own_line(self) -> None:
        """Return to the line's own speed and format when everything queued has left."""
        times = self.scope.line
        if self.is_open and times.own is not None and (self.pending or times.line != times.own):
            self.change_line(times.own)

    def _change(self, change: ChangeLine) -> None:
        is_other = change.line != self.scope.line.line
        if is_other:
            self.scope.change_line(change.line)
            self.commands.append(change)
        self.on_change(change, is_other)

    def poll(self) -> None:
        """Give the next command, if the line is free."""
        if self.outgoing is not None or not self.is_open:
            return
        pending = self.pending
        while pending:
            item = pending[0]
            if isinstance(item, ChangeLine):
                pending.popleft()
                self._change(item)
            elif self.clear_to_send:
                pending.popleft()
                self._give(item)
                return
            else:
                self._hold()
                return

    def _hold(self) -> None:
        """Switch RTS on, which clear-to-send answers, and start the time limit of the hold."""
        if self._key_delay is not None:
            self._switch_on()
        if self._clear_time is not None and self.held_until == NEVER:
            self.held_until = min(NEVER, self.scope.now + int(self._clear_time(self.scope)))

    def _switch_on(self) -> None:
        if not self._rts:
            self._rts = True
            self.commands.append(SetRts(True))

    def _switch_off(self) -> None:
        """Switch RTS off unless a frame is leaving."""
        if self._rts and self.outgoing is None:
            self._rts = False
            self.commands.append(SetRts(False))

    def _give(self, item: Send | Break) -> None:
        self.outgoing = item
        if not self.is_immediate:
            item.not_before = self._not_before()
        self.commands.append(item)

    def _not_before(self) -> int:
        """Return when sending may begin after the silence and the key delay, 0 for now; switch RTS on."""
        scope = self.scope
        not_before = 0
        if self._turnaround is not None:
            not_before = max(self.last_sent, self.last_received) + int(self._turnaround(scope))
        if self._key_delay is not None:
            self._switch_on()
            not_before = max(not_before, scope.now + int(self._key_delay(scope)))
        return not_before if not_before > scope.now else 0

    def left(self) -> Send | Break | None:
        """Note that the last bit of `outgoing` and `joined` has left; return `outgoing`, None after `clear`."""
        item, self.outgoing = self.outgoing, None
        self.last_sent = self.scope.now
        if self.pending:
            self.poll()
        if self._rts:
            self._switch_off()
        return item

    def clear(self) -> None:
        """Drop everything queued: the connection is gone."""
        self.pending.clear()
        self.joined.clear()
        self.outgoing = None
        self.held_until = NEVER
        self._rts = False

    def drop_held(self) -> list[Send | Break]:
        """Drop and return the frames and breaks that clear-to-send holds back."""
        self.held_until = NEVER
        held = [item for item in self.pending if not isinstance(item, ChangeLine)]
        self.pending = deque(item for item in self.pending if isinstance(item, ChangeLine))
        self.poll()
        self._switch_off()
        return held

    @property
    def quiet_since(self) -> int:
        return max(self.last_sent, self.last_received)
