"""Decides what a fault plan does to each frame of one side, and keeps count of it.

The same plan gives the same faults for the same frames. Ports and servers carry it out.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from random import Random

from framekit.link.frame_faults import FrameFaults
from framekit.link.values import FrameValue
from framekit.run.model import LINE_KINDS, FaultPlan, FaultRule, Side
from framekit.transport.clock import Clock
from framekit.transport.simulated_line import Transmission, hits

AWAY = 1_000_000_000
"""How long a disconnection lasts that does not say (ns)."""
NOT_OF_FRAMES = (*LINE_KINDS, "echo", "error_reply")
"""Kinds that are not done to the bytes of a frame that is sent."""
LONGEST_NOISE = 4
"""Bytes that come when a rule does not say how many."""


@dataclass(slots=True)
class Treated:
    """What becomes of the bytes of one `write`: pieces with the pause (ns) before each; none: nobody hears them.

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
            self._began = self.clock.now()

    @property
    def time(self) -> int:
        return 0 if self._began is None else self.clock.now() - self._began

    def at(self, time: int) -> int:
        """When a time of the plan is on the clock."""
        return (self._began or 0) + time

    def of(self, kind: str) -> list[RuleAtWork]:
        return [rule for rule in self.rules if rule.model.kind == kind]

    def note(self, kind: str) -> None:
        """Something has been done."""
        self.injected[kind] += 1

    def happens(self, kind: str, frame: str | None = None) -> FaultRule | None:
        """The first rule of a kind that hits now."""
        for rule in self.of(kind):
            if rule.fits(self.time, frame) and rule.hits():
                self.note(kind)
                return rule.model
        return None

    def refusal(self, request: FrameValue, check_only: bool) -> FaultRule | None:
        """The rule that refuses a request; one that is checked before it is served gets the same answer twice."""
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
        """The bytes that a rule adds."""
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
        """Whether it concerns a frame at a time of the plan."""
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
