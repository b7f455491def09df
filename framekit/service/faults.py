"""Faults as a plan says, done to what a device or a channel sends: which and when, and the port that does them."""

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
"""How long a disconnection lasts that does not say (ns)."""
NOT_OF_FRAMES = (*LINE_KINDS, "echo", "error_reply")
"""Kinds that are not done to the bytes of a frame that is sent."""
LONGEST_NOISE = 4
"""Bytes that come when a rule does not say how many."""


@dataclass(slots=True)
class Treated:
    """What becomes of the bytes of one `write`: pieces with the pause (ns) before each; none: they are not heard.

    `held`: they come before what is sent next. `cut`: the connection goes away instead, for so long (ns).
    """

    pieces: list[tuple[int, bytes]] = field(default_factory=list)
    held: bool = False
    cut: int | None = None


class FaultInjector:
    """The plan at work for one side. `injected` counts what has been done, by kind.

    `answers`: the side is the one that answers, its frames are the replies. `name` makes the chance of several devices
    with one plan different. Times count from `begin`, which the port calls when it is opened first.
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
        """The port is opened; the first time is time 0 of the plan."""
        if self._began is None:
            self._began = self.clock.moment()

    @property
    def time(self) -> int:
        return 0 if self._began is None else self.clock.moment() - self._began

    def at(self, time: int) -> int:
        """When a time of the plan is on the clock."""
        return (self._began or 0) + time

    def of(self, kind: str) -> list[RuleAtWork]:
        return [rule for rule in self.rules if rule.model.kind == kind]

    def note(self, kind: str) -> None:
        """Something has been done."""
        self.injected[kind] += 1

    def happens(self, kind: str, frame: str | None = None) -> FaultRule | None:
        """Return the first rule of a kind that hits now."""
        for rule in self.of(kind):
            if rule.fits(self.time, frame) and rule.hits():
                self.note(kind)
                return rule.model
        return None

    def refusal(self, request: FrameValue, check_only: bool) -> FaultRule | None:
        """Return the rule that refuses a request; one that is checked before it is served gets the same answer
        twice.
        """
        if request is not self._checked:
            self._checked, self._refusal = request, self.happens("error_reply", request.frame)
        if not check_only:
            self._checked = None
        return self._refusal

    # ---- frames -------------------------------------------------------------------------------------------

    def treat(self, data: bytes, character_time: int) -> Treated:
        """What becomes of a frame that is sent now."""
        name = self.frames.name_of(data) if any(rule.model.frame for rule in self.rules) else None
        treated, pause, size = Treated(), 0, 0
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
                case "delay":
                    pause += model.time or 0
                case "jitter":
                    pause += rule.random.randint(0, model.time or 0)
                case "split":
                    size, gap = model.size or 1, model.time or 2 * character_time
        pieces = [data] if not size else [data[at : at + size] for at in range(0, len(data), size)]
        treated.pieces = [(gap if index else pause, piece) for index, piece in enumerate(pieces)]
        return treated

    def _changed(self, rule: RuleAtWork, data: bytes) -> bytes | None:
        """The bytes as a rule leaves them; None where it cannot do anything to them."""
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
        """Noise on a simulated line: bits of characters as they are on the wire, so that parity may see it."""
        for rule in self.of("noise"):
            if rule.fits(self.time, None):
                bits = transmission.wire_bits
                for place in rule.wrong_bits(len(transmission.data) * bits):
                    transmission.flip(place // bits, 1 << place % bits)
                    self.note("noise")

    def damaged(self, data: bytes) -> bytes:
        """Noise where there are only bytes: wrong data bits."""
        wrong = bytearray(data)
        for rule in self.of("noise"):
            if rule.fits(self.time, None):
                for place in rule.wrong_bits(8 * len(wrong)):
                    wrong[place // 8] ^= 1 << place % 8
                    self.note("noise")
        return bytes(wrong)


class RuleAtWork:
    """A rule with its chance and its counters."""

    def __init__(self, model: FaultRule, random: Random) -> None:
        self.model = model
        self.random = random
        self.seen = 0
        self.done = 0

    def fits(self, time: int, frame: str | None) -> bool:
        """Return whether it concerns a frame at a time of the plan."""
        model = self.model
        return model.begin <= time < model.end and (model.frame is None or model.frame == frame)

    def hits(self) -> bool:
        """Whether it happens to this one."""
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
        """Which of so many bits are wrong."""
        rate = self.model.rate or 0.0
        return list(hits(self.random, rate, count)) if rate > 0 else []


GONE = "disconnected by the fault plan"


@dataclass(slots=True)
class _Item:
    """Bytes, a break of so many ns, a silence or a disconnection for so long, after a pause.

    `owners`: its owner waits for `sent`.
    """

    pause: int
    data: bytes = b""
    duration: int = 0
    silence: int = 0
    cut: int | None = None
    owners: bool = True
    marked: int | None = None


class FaultyPort(PassingPort):
    """Stands between an owner and a port; it is a port itself. One injector belongs to one port."""

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
        """Does something then, unless the port has been closed meanwhile."""
        opening = self._opening
        self._timers = self._timers[-8:]
        self._timers.append(self.clock.call_at(when, lambda: action() if opening == self._opening else None))

    def _refuse(self) -> None:
        events = self.events
        self.forget()
        if events is not None:
            events.closed(self._now(), GONE)

    def _cut(self, until: int) -> None:
        """The connection goes away, until then."""
        self._away_until = until
        self.inner.close()
        self._refuse()

    def _set_windows(self) -> None:
        """Disconnections that have a window and no frames to wait for begin by themselves; so do stray bytes."""
        injector, now = self.injector, self._now()
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
        elif before:  # what was held back for this frame goes out alone
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
        """Of what has just been queued for `size` bytes, the first byte stays the first, behind those held back
        `before`, and the last one the last.
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
        """The next thing in the queue, once the one before it has left."""
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
        """Stray bytes come at random times, on the average `time` apart."""
        begin = max(self._now(), self.injector.at(rule.model.begin))
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

    # ---- in -----------------------------------------------------------------------------------------------

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        """A device with an echo sends back what it hears: the client hears itself."""
        if self.events is None:
            return
        if self.injector.answers and self.injector.happens("echo") is not None:
            self._queue.append(_Item(0, data, owners=False))
            self._go_on()
        self.events.received(data, now, faults)

    def sent(self, now: int) -> None:
        self._busy = False
        self._go_on()
