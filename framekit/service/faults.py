"""Fault injection by a plan into the transmissions of a device or a channel: selection of rules, and the port that
applies them.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from random import Random

from framekit.link.events import CharacterFault
from framekit.link.frame_faults import FrameFaults
from framekit.link.values import FrameValue
from framekit.run.model import LINE_KINDS, FaultPlan, FaultRule, Side
from framekit.transport.clock import Clock, Handle
from framekit.transport.port import PassingPort, Port, PortEvents
from framekit.transport.simulated_line import SimulatedPort, Transmission, hits, in_order

AWAY = 1_000_000_000
"""Default duration of a disconnection (ns)."""
NOT_OF_FRAMES = (*LINE_KINDS, "echo", "error_reply")
"""Kinds of faults that do not change the bytes of a sent frame."""
LONGEST_NOISE = 4
"""Largest number of bytes that a rule without a number adds."""


@dataclass(slots=True)
class Treated:
    """Result of treating the bytes of a `write`."""

    pieces: list[tuple[int, bytes]] = field(default_factory=list)
    """Pieces with the pause (ns) before each; empty: the bytes are lost."""
    held: bool = False
    """Whether the pieces are sent together with the next bytes."""
    cut: int | None = None
    """Duration of a disconnection (ns) in place of the bytes; None: no disconnection."""


class FaultInjector:
    """The plan applied to one side. `injected` counts the faults by kind.

    `answers`: whether this side sends the replies. `name` gives several devices with one plan different random numbers.
    Times count from `begin`, which the port calls when it is opened first.
    """

    def __init__(
        self,
        plan: FaultPlan,
        clock: Clock,
        frames: FrameFaults,
        *,
        answers: bool = True,
        name: str = "",
    ) -> None:
        self.clock = clock
        self.frames = frames
        self.answers = answers
        self.injected: Counter[str] = Counter()
        side: Side = "replies" if answers else "requests"
        own = plan.rules_of(side)
        self.rules = [
            RuleAtWork(rule, Random(f"{plan.seed}/{name}/{side}/{number}")) for number, rule in enumerate(own)
        ]
        self._began: int | None = None
        self._checked: FrameValue | None = None
        self._refusal: FaultRule | None = None

    def begin(self) -> None:
        """Set time 0 of the plan at the first opening of the port."""
        if self._began is None:
            self._began = self.clock.moment()

    @property
    def time(self) -> int:
        return 0 if self._began is None else self.clock.moment() - self._began

    def at(self, time: int) -> int:
        """Return a time of the plan as a time of the clock (ns)."""
        return (self._began or 0) + time

    def of(self, kind: str) -> list[RuleAtWork]:
        return [rule for rule in self.rules if rule.model.kind == kind]

    def note(self, kind: str) -> None:
        """Count a fault."""
        self.injected[kind] += 1

    def happens(self, kind: str, frame: str | None = None) -> FaultRule | None:
        """Return the first rule of a kind that applies now, and count it."""
        for rule in self.of(kind):
            if rule.fits(self.time, frame) and rule.hits():
                self.note(kind)
                return rule.model
        return None

    def refusal(self, request: FrameValue, check_only: bool) -> FaultRule | None:
        """Return the rule that refuses a request; a request that is checked before it is served gets the same answer
        twice.
        """
        if request is not self._checked:
            self._checked, self._refusal = request, self.happens("error_reply", request.frame)
        if not check_only:
            self._checked = None
        return self._refusal

    # ---- frames -------------------------------------------------------------------------------------------

    def treat(self, data: bytes, character_time: int) -> Treated:
        """Apply the rules to a frame that is sent now."""
        name = self.frames.name_of(data) if any(rule.model.frame for rule in self.rules) else None
        treated, pieces = Treated(), _Pieces()
        for rule in self.rules:
            model = rule.model
            if model.kind in NOT_OF_FRAMES or model.is_window or not rule.fits(self.time, name):
                continue
            changed = self._changed(rule, data)
            if changed is None or not rule.hits():
                continue
            self.note(model.kind)
            data = changed
            match model.kind:
                case "no_reply":
                    return treated
                case "disconnect":
                    treated.cut = model.time or AWAY
                    return treated
                case "glue":
                    treated.held = True
                case _:
                    pieces.apply(rule, character_time)
        treated.pieces = pieces.of(data)
        return treated

    def _changed(self, rule: RuleAtWork, data: bytes) -> bytes | None:
        """Return the bytes as a rule changes them; None if the rule is not applicable to them."""
        model, random = rule.model, rule.random
        match model.kind:
            case "wrong_check":
                return self.frames.wrong_check(data, random)
            case "wrong_station":
                return self.frames.wrong_station(data, random)
            case "truncate":
                lost = model.size or (random.randrange(1, len(data)) if len(data) > 1 else 1)
                return data[: max(0, len(data) - lost)]
            case "extra":
                return self.noise(rule) + data if model.before else data + self.noise(rule)
            case "split":
                return data if len(data) > 1 else None
        return data

    @staticmethod
    def noise(rule: RuleAtWork) -> bytes:
        """Return the bytes that a rule adds."""
        model, random = rule.model, rule.random
        return model.data or random.randbytes(model.size or random.randint(1, LONGEST_NOISE))

    # ---- the line -----------------------------------------------------------------------------------------

    def damage(self, transmission: Transmission) -> None:
        """Apply noise to bits of characters on a simulated line, so that parity may detect it."""
        for rule in self.of("noise"):
            if rule.fits(self.time, None):
                bits = transmission.wire_bits
                for place in rule.wrong_bits(len(transmission.data) * bits):
                    transmission.flip(place // bits, 1 << place % bits)
                    self.note("noise")

    def damaged(self, data: bytes) -> bytes:
        """Apply noise to data bits only."""
        wrong = bytearray(data)
        for rule in self.of("noise"):
            if rule.fits(self.time, None):
                for place in rule.wrong_bits(8 * len(wrong)):
                    wrong[place // 8] ^= 1 << place % 8
                    self.note("noise")
        return bytes(wrong)


class RuleAtWork:
    """A rule with its random numbers and its counters."""

    def __init__(self, model: FaultRule, random: Random) -> None:
        self.model = model
        self.random = random
        self.is_on = model.is_on
        self.seen = 0
        self.done = 0

    def fits(self, time: int, frame: str | None) -> bool:
        """Return whether the rule is switched on and applies to a frame at a time of the plan."""
        model = self.model
        return self.is_on and model.begin <= time < model.end and (model.frame is None or model.frame == frame)

    def hits(self) -> bool:
        """Return whether the rule hits this occurrence."""
        model = self.model
        self.seen += 1
        if model.times is not None and self.done >= model.times:
            return False
        if model.every is not None:
            hit = self.seen % model.every == 0
        else:
            hit = model.rate is None or self.random.random() < model.rate
        self.done += hit
        return hit

    def wrong_bits(self, count: int) -> list[int]:
        """Return the indices, out of `count`, of the wrong bits."""
        rate = self.model.rate or 0.0
        return list(hits(self.random, rate, count)) if rate > 0 else []


GONE = "disconnected by the fault plan"


@dataclass(slots=True)
class _Pieces:
    """The pause before a frame, and how it is split. Times in nanoseconds."""

    pause: int = 0
    size: int = 0
    """Bytes of a piece; 0: the frame is one piece."""
    gap: int = 0

    def apply(self, rule: RuleAtWork, character_time: int) -> None:
        """Apply a rule of the kinds delay, jitter and split; other kinds change nothing."""
        model = rule.model
        match model.kind:
            case "delay":
                self.pause += model.time or 0
            case "jitter":
                self.pause += rule.random.randint(0, model.time or 0)
            case "split":
                self.size, self.gap = model.size or 1, model.time or 2 * character_time

    def of(self, data: bytes) -> list[tuple[int, bytes]]:
        """Return the pieces of a frame with the pause before each."""
        size = self.size
        pieces = [data[at : at + size] for at in range(0, len(data), size)] if size else [data]
        return [(self.gap if index else self.pause, piece) for index, piece in enumerate(pieces)]


@dataclass(slots=True)
class _Item:
    """An item of the send queue after a pause: bytes, a break, a silence or a disconnection (durations in ns)."""

    pause: int
    data: bytes = b""
    duration: int = 0
    silence: int = 0
    cut: int | None = None
    owners: bool = True
    """Whether the owner of the port waits for `sent`."""
    marked: int | None = None


class FaultyPort(PassingPort):
    """Port between an owner and another port that applies faults. Each port has its own injector."""

    def __init__(self, inner: Port, injector: FaultInjector) -> None:
        super().__init__(inner)
        self.injector = injector
        self.clock = injector.clock
        self._now = self.clock.moment if inner.in_time else self.clock.now
        self._character = 0 if inner.settings is None else inner.settings.character_time
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
        if self.events is not None:
            self.close()
        self.injector.begin()
        self.events = events
        if self._now() < self._away_until:
            self._later(self._now(), self._refuse)
        else:
            self._set_windows()
            self.inner.open(self)

    def forget(self) -> None:
        super().forget()
        self._opening += 1
        self._queue.clear()
        self._busy = self._owed = False
        self._held = b""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    def _later(self, when: int, action: Callable[[], None]) -> None:
        """Run an action at time `when` (ns), unless the port has been closed meanwhile."""
        opening = self._opening
        self._timers = self._timers[-8:]
        self._timers.append(self.clock.call_at(when, lambda: action() if opening == self._opening else None))

    def _refuse(self) -> None:
        events = self.events
        self.forget()
        if events is not None:
            events.closed(self._now(), GONE)

    def _cut(self, until: int) -> None:
        """Disconnect until a time (ns)."""
        self._away_until = until
        self.inner.close()
        self._refuse()

    def _set_windows(self) -> None:
        """Schedule the disconnections with a time window, and the stray bytes."""
        injector, now = self.injector, self._now()
        for rule in injector.of("disconnect"):
            model = rule.model
            begin, end = injector.at(model.begin), injector.at(model.end)
            if model.is_window and end > now:
                self._later(max(begin, now), partial(self._cut_in_window, rule, end))
        for rule in injector.of("stray"):
            self._plan_stray(rule)

    def _cut_in_window(self, rule: RuleAtWork, end: int) -> None:
        if rule.is_on:
            self.injector.note("disconnect")
            self._cut(end)

    # ---- out ----------------------------------------------------------------------------------------------

    def write(self, data: bytes, marked: int | None = None) -> None:
        if self.events is None:
            return
        before, self._held = self._held, b""
        treated = self.injector.treat(data, self._character)
        if treated.cut is not None and not before:
            self._later(self._now(), partial(self._cut, self._now() + treated.cut))
            return
        if treated.held:
            self._held = before + b"".join(piece for _, piece in treated.pieces)
            treated.pieces = []
        elif before and treated.pieces:
            treated.pieces[0] = (treated.pieces[0][0], before + treated.pieces[0][1])
        elif before:  # the bytes held back for this frame go out alone
            self._queue.append(_Item(0, before, owners=False))
        if treated.cut is not None:
            self._queue.append(_Item(0, cut=treated.cut, owners=False))
            self._go_on()
            return
        for pause, piece in treated.pieces:
            self._queue.append(_Item(pause, piece))
        if marked is not None and treated.pieces:
            self._mark(marked, len(data), len(treated.pieces), len(before))
        if not treated.pieces:
            self._queue.append(_Item(0, silence=len(data) * self._character))
        self._go_on()

    def write_marked(self, data: bytes, marked: int) -> None:
        self.write(data, marked)

    def _mark(self, marked: int, size: int, pieces: int, before: int) -> None:
        """Mark a byte of the data queued last: the first of `size` bytes follows `before` held bytes, the last ends the
        last item.
        """
        if marked == 0:
            self._queue[-pieces].marked = before
        elif marked == size - 1:
            self._queue[-1].marked = len(self._queue[-1].data) - 1

    def send_break(self, duration: int) -> None:
        if self.events is not None:
            self._queue.append(_Item(0, duration=duration))
            self._go_on()

    def _go_on(self) -> None:
        """Send the next item of the queue once the previous has left."""
        if self._busy or self.events is None:
            return
        if not self._queue:
            if self._owed:
                self._owed = False
                self.events.sent(self._now())
            return
        item = self._queue.popleft()
        self._busy = True
        self._owed = self._owed or item.owners
        wait = item.pause + item.silence
        if wait or not (item.data or item.duration):
            self._later(self._now() + wait, partial(self._put, item))
        else:
            self._put(item)

    def _put(self, item: _Item) -> None:
        if item.data:
            data = item.data if self._on_wire else self.injector.damaged(item.data)
            if item.marked is None:
                self.inner.write(data)
            else:
                self.inner.write_marked(data, item.marked)
        elif item.duration:
            self.inner.send_break(item.duration)
        elif item.cut is not None:
            self._cut(self._now() + item.cut)
        else:
            self._busy = False
            self._go_on()

    def _plan_stray(self, rule: RuleAtWork) -> None:
        """Schedule stray bytes at random times, on the average `time` apart."""
        begin = max(self._now(), self.injector.at(rule.model.begin))
        when = begin + max(1, round(rule.random.expovariate(1) * (rule.model.time or 1)))
        if when < self.injector.at(rule.model.end):
            self._later(when, partial(self._stray, rule))

    def _stray(self, rule: RuleAtWork) -> None:
        if rule.is_on and rule.hits():
            self.injector.note("stray")
            self._queue.append(_Item(0, self.injector.noise(rule), owners=False))
            self._go_on()
        self._plan_stray(rule)

    def _damage(self, transmission: Transmission) -> None:
        """Apply noise to the bits on a simulated line, and set whether the sender receives its own bytes."""
        self.injector.damage(transmission)
        if not self.injector.answers and self.injector.happens("echo") is not None:
            transmission.echo = True

    # ---- in -----------------------------------------------------------------------------------------------

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        """Pass on received bytes; a device with an echo also sends them back, so that the client receives its own
        bytes.
        """
        if self.events is None:
            return
        if self.injector.answers and self.injector.happens("echo") is not None:
            self._queue.append(_Item(0, data, owners=False))
            self._go_on()
        self.events.received(data, now, faults)

    def sent(self, now: int) -> None:
        self._busy = False
        self._go_on()
