"""A port on which a fault plan is carried out: whatever kind of port is behind it.

What its owner sends goes out late, damaged, in pieces or not at all; the port echoes, and goes away. What should happen
to which frame is decided elsewhere.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from framekit.link.events import CharacterFault
from framekit.service.fault_injector import FaultInjector, RuleAtWork
from framekit.transport.clock import Handle
from framekit.transport.port import Port, PortEvents
from framekit.transport.simulated_line import SimulatedPort, Transmission, in_order

GONE = "disconnected by the fault plan"


@dataclass(slots=True)
class _Item:
    """Bytes, a break of so many ns or a silence, after a pause. `owners`: its owner waits for `sent`."""

    pause: int
    data: bytes = b""
    duration: int = 0
    silence: int = 0
    owners: bool = True


class FaultyPort(Port):
    """Stands between an owner and a port; it is a port itself. One injector belongs to one port."""

    def __init__(self, inner: Port, injector: FaultInjector) -> None:
        self.inner = inner
        self.injector = injector
        self.clock = injector.clock
        self.name = inner.name
        self.settings = inner.settings
        self.opens_again = inner.opens_again
        self._character = 0 if inner.settings is None else inner.settings.character_time
        self._events: PortEvents | None = None
        self._queue: deque[_Item] = deque()
        self._busy = self._owed = False
        self._held = b""
        self._away_until = 0
        self._timers: list[Handle] = []
        self._opening = 0
        self._on_wire = isinstance(inner, SimulatedPort)
        if isinstance(inner, SimulatedPort):
            inner.fault = self._damage if inner.fault is None else in_order(inner.fault, self._damage)

    # ---- life ---------------------------------------------------------------------------------------------

    def open(self, events: PortEvents) -> None:
        if self._events is not None:
            self.close()
        self.injector.begin()
        self._events = events
        if self.clock.now() < self._away_until:
            self._later(self.clock.now(), self._refuse)
        else:
            self._set_windows()
            self.inner.open(self)

    def close(self) -> None:
        self._forget()
        self.inner.close()

    def _forget(self) -> None:
        self._opening += 1
        self._events = None
        self._queue.clear()
        self._busy = self._owed = False
        self._held = b""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    def _later(self, when: int, action: Callable[[], None]) -> None:
        """Does something then, unless the port has been closed meanwhile."""
        opening = self._opening
        self._timers = self._timers[-8:]
        self._timers.append(self.clock.call_at(when, lambda: action() if opening == self._opening else None))

    def _refuse(self) -> None:
        events = self._events
        self._forget()
        if events is not None:
            events.closed(self.clock.now(), GONE)

    def _cut(self, until: int) -> None:
        """The connection goes away, until then."""
        self._away_until = until
        self.inner.close()
        self._refuse()

    def _set_windows(self) -> None:
        """Disconnections that have a window and no frames to wait for begin by themselves; so do stray bytes."""
        injector, now = self.injector, self.clock.now()
        for rule in injector.of("disconnect"):
            model = rule.model
            begin, end = injector.at(model.begin), injector.at(model.end)
            if model.is_window and end > now:
                self._later(max(begin, now), partial(self._cut_in_window, end))
        for rule in injector.of("stray"):
            self._plan_stray(rule)

    def _cut_in_window(self, end: int) -> None:
        self.injector.note("disconnect")
        self._cut(end)

    # ---- out ----------------------------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        if self._events is None:
            return
        whole = self._held + data
        self._held = b""
        treated = self.injector.treat(data, self._character)
        if treated.cut is not None:
            self._later(self.clock.now(), partial(self._cut, self.clock.now() + treated.cut))
            return
        before = whole[: len(whole) - len(data)]
        if treated.held:
            self._held = before + b"".join(piece for _, piece in treated.pieces)
            treated.pieces = []
        elif before and treated.pieces:
            treated.pieces[0] = (treated.pieces[0][0], before + treated.pieces[0][1])
        for pause, piece in treated.pieces:
            self._queue.append(_Item(pause, piece))
        if not treated.pieces:
            self._queue.append(_Item(0, silence=len(data) * self._character))
        self._go_on()

    def send_break(self, duration: int) -> None:
        if self._events is not None:
            self._queue.append(_Item(0, duration=duration))
            self._go_on()

    def _go_on(self) -> None:
        """The next thing in the queue, once the one before it has left."""
        if self._busy or self._events is None:
            return
        if not self._queue:
            if self._owed:
                self._owed = False
                self._events.sent(self.clock.now())
            return
        item = self._queue.popleft()
        self._busy = True
        self._owed = self._owed or item.owners
        wait = item.pause + item.silence
        if wait or not (item.data or item.duration):
            self._later(self.clock.now() + wait, partial(self._put, item))
        else:
            self._put(item)

    def _put(self, item: _Item) -> None:
        if item.data:
            self.inner.write(item.data if self._on_wire else self.injector.damaged(item.data))
        elif item.duration:
            self.inner.send_break(item.duration)
        else:
            self._busy = False
            self._go_on()

    def _plan_stray(self, rule: RuleAtWork) -> None:
        """Stray bytes come at random times, on the average `time` apart."""
        begin = max(self.clock.now(), self.injector.at(rule.model.begin))
        when = begin + max(1, round(rule.random.expovariate(1) * (rule.model.time or 1)))
        if when < self.injector.at(rule.model.end):
            self._later(when, partial(self._stray, rule))

    def _stray(self, rule: RuleAtWork) -> None:
        if rule.hits():
            self.injector.note("stray")
            self._queue.append(_Item(0, self.injector.noise(rule), owners=False))
            self._go_on()
        self._plan_stray(rule)

    def _damage(self, transmission: Transmission) -> None:
        """On a simulated line: noise in the bits on the wire, and whether the sender hears itself."""
        self.injector.damage(transmission)
        if not self.injector.answers and self.injector.happens("echo") is not None:
            transmission.echo = True

    def set_rts(self, on: bool) -> None:
        self.inner.set_rts(on)

    def flush_input(self) -> None:
        self.inner.flush_input()

    # ---- in -----------------------------------------------------------------------------------------------

    def opened(self, now: int) -> None:
        if self._events is not None:
            self._events.opened(now)

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        """A device with an echo sends back what it hears: whoever asks hears itself."""
        if self._events is None:
            return
        if self.injector.answers and self.injector.happens("echo") is not None:
            self._queue.append(_Item(0, data, owners=False))
            self._go_on()
        self._events.received(data, now, faults)

    def other_sender(self, now: int) -> None:
        if self._events is not None:
            self._events.other_sender(now)

    def line_break(self, now: int) -> None:
        if self._events is not None:
            self._events.line_break(now)

    def sent(self, now: int) -> None:
        self._busy = False
        self._go_on()

    def closed(self, now: int, reason: str) -> None:
        events = self._events
        self._forget()
        if events is not None:
            events.closed(now, reason)

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        if self._events is not None:
            self._events.control(lines, now)
