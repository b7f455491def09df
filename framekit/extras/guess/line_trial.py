"""Search for the speed and format of a line by listening with each of several, and the certainty of the result.

With a wrong speed or format, about half of the characters have framing or parity errors. So each undamaged character is
evidence, and a damaged character is counter-evidence; repetitions after the same character add none. Some regularities
do not occur in real data: that the lowest bit of all characters is 0, or the eighth bit 1. They come from the start bit
and the idle state of a line that is slower, or has a shorter format. If eight bits always have the same parity, the
eighth is a parity bit. Each value with a regularity halves the probability of chance. All evidence is counted in
bits: 10 bits are a probability of chance of 1 in 1,024.

A wrong speed may still give undamaged characters, especially if the right speed is not among those tried. So the best
are tested at twice their speed: there each bit must occur twice. Only a result that passes this test is called sure.

The number of stop bits, one or two, cannot be determined by listening.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import log2
from typing import Literal

from framekit.api.errors import LineClosedError, RequestError
from framekit.definition.problems import plural
from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import AsyncioClock, Clock
from framekit.transport.port import Port, PortEvents
from framekit.transport.schemes import open_port, scheme_of

SPEEDS = "9600,19200,115200,38400,57600,4800,2400,1200"
FORMATS = "8N1,8E1,8O1,7E1,7O1,7N1"
EACH = 2_000_000_000
"""Duration of the trial of each speed and format (ns)."""
AGAIN = 4
"""Number of best results that are tried again, `LONGER` times as long, if the first round gave no certain result."""
LONGER = 4
TESTED = 3
"""Number of speeds tested at twice the speed."""

DAMAGED_IF_RIGHT, DAMAGED_IF_WRONG = 0.01, 0.4
CLEAN_BITS = log2((1 - DAMAGED_IF_RIGHT) / (1 - DAMAGED_IF_WRONG))
DAMAGED_BITS = log2(DAMAGED_IF_RIGHT / DAMAGED_IF_WRONG)
MOST_CONTEXTS = 200
"""Largest number of different pairs of adjacent characters that count as evidence."""
TEXT = frozenset(range(0x20, 0x7F)) | frozenset(b"\r\n\t\x02\x03\x04\x05\x06\x15\x17")
MOST_TEXT_BITS = 6.0

SURE, LIKELY = 16.0, 5.0
"""Evidence (bits), as the lead over the next result, from which a result is sure, or likely."""
PAIR_BITS = 10.0
"""Evidence from the test at twice the speed (bits)."""
PAIRS_WANTED = 20
"""Least number of characters that show whether each bit occurs twice."""
ENOUGH, HOPELESS = 400, 80
"""Numbers of characters after which a trial ends early: enough characters, or fewer of which more than a third are
damaged.
"""

Certainty = Literal["sure", "likely", "unsure", "nothing fits", "silent"]


@dataclass(slots=True)
class HeardAt:
    """Characters received with one speed and format."""

    line: LineFormat
    sees_damage: bool = True
    """See `Port`."""
    characters: int = 0
    damaged: int = 0
    text: int = 0
    contexts: set[tuple[int, int, bool]] = field(default_factory=set)
    values: set[int] = field(default_factory=set)
    pairs: int = 0
    no_pairs: int = 0
    paired: set[int] = field(default_factory=set)
    sample: bytes = b""
    problem: str = ""
    """Reason why it could not be tried; '' if it was."""
    _before: int = -1
    _is_behind_clean: bool = True

    def add(self, data: bytes, faults: Iterable[CharacterFault] = ()) -> None:
        """Add received characters."""
        damaged = {fault.index for fault in faults if fault.fault is not LineFault.MARK}
        for index, value in enumerate(data):
            self._character(value, index in damaged)
        if len(self.sample) < 16:
            self.sample = (self.sample + data)[:16]

    def add_break(self) -> None:
        """Add a break: continuous zeros."""
        self._character(0, True)

    def _character(self, value: int, is_damaged: bool) -> None:
        if is_damaged and self.characters == self.damaged < 3:
            return  # listening may begin within a character
        self.characters += 1
        self.damaged += is_damaged
        self.text += value in TEXT and not is_damaged
        if len(self.contexts) < MOST_CONTEXTS:
            self.contexts.add((self._before, value, is_damaged))
        if not is_damaged:
            self.values.add(value)
        self._look_for_pairs(value, is_damaged)
        self._before, self._is_behind_clean = value, not is_damaged

    def _look_for_pairs(self, value: int, is_damaged: bool) -> None:
        """Count whether each bit of the line occurs twice; only a character after an undamaged one begins at a bit
        boundary.
        """
        if self._is_behind_clean and (value or not is_damaged):
            stop = 0 if is_damaged else 1
            halves = (value >> 1 ^ value >> 2) & 0b10101  # bits 1 and 2, 3 and 4, 5 and 6
            if not value & 1 and not halves and value >> 7 == stop:
                self.pairs += 1
                self.paired.add(value)
            else:
                self.no_pairs += 1

    @property
    def is_doubled(self) -> bool | None:
        """Return whether the line has half the speed, or a quarter; None if too few characters were received."""
        count = self.pairs + self.no_pairs
        return None if count < PAIRS_WANTED else self.pairs >= 0.9 * count and len(self.paired) >= 3

    @property
    def pair_bits(self) -> float:
        """Return the evidence for half the speed (bits)."""
        if self.is_doubled is None:
            return 0.0
        if self.is_doubled:
            return PAIR_BITS
        share = self.pairs / (self.pairs + self.no_pairs)
        return 0.0 if share >= 0.4 else -3 * PAIR_BITS  # where characters do not follow at whole bits some fail

    @property
    def damaged_share(self) -> float:
        """Return the share of damaged characters, 0 to 1."""
        return self.damaged / self.characters if self.characters else 0.0

    @property
    def bits(self) -> float:
        """Return the evidence for this speed and format (bits); below 0 it is counter-evidence."""
        share, found = self.damaged_share, self._text_bits - self._parity_bits - self.same_bits
        if self.sees_damage:
            found += len(self.contexts) * ((1 - share) * CLEAN_BITS + share * DAMAGED_BITS)
        return found

    @property
    def _text_bits(self) -> float:
        """Return the evidence from text (bits): characters received with a wrong speed are seldom text."""
        if self.text < 0.95 * self.characters or len(self.values) < 8:
            return 0.0
        return min(len(self.values) / 2, MOST_TEXT_BITS)

    @property
    def _parity_bits(self) -> float:
        """Return the evidence that the eighth bit is a parity bit, in a format without parity (bits)."""
        if self.line.data_bits != 8:
            return 0.0
        odd = sum(value.bit_count() & 1 for value in self.values)
        even = len(self.values) - odd
        return max(0.0, max(odd, even) - 5.0 * min(odd, even))

    @property
    def same_bits(self) -> float:
        """Return the counter-evidence (bits) from regularities: all values even, or all values with the eighth bit
        set.
        """
        count = len(self.values)
        odd, high = sum(value & 1 for value in self.values), sum(value >> 7 for value in self.values)
        found = max(0.0, count - 6.0 * odd)
        return found + (max(0.0, count - 6.0 * (count - high)) if self.line.data_bits == 8 else 0.0)


@dataclass(frozen=True, slots=True)
class TrialResult:
    """Result of listening. `ranking`: best first; `text`: a sentence; `bits`: the evidence for each."""

    certainty: Certainty
    ranking: list[HeardAt]
    text: str
    bits: list[float] = field(default_factory=list)

    @property
    def line(self) -> LineFormat | None:
        """Return the speed and format to use; None if unknown."""
        return self.ranking[0].line if self.certainty in ("sure", "likely", "unsure") else None


def judge(heard: Iterable[HeardAt], doubles: Iterable[HeardAt] = ()) -> TrialResult:
    """Return the most likely speed and format, and the certainty.

    `doubles`: characters received at twice the speed of some.
    """
    tried = list(heard)
    tests = {one.line.speed: one for one in [*tried, *doubles] if is_for_pairs(one)}

    def bits(one: HeardAt) -> float:
        test = tests.get(2 * one.line.speed)
        return one.bits + (0.0 if test is None else test.pair_bits)

    ranking = sorted(tried, key=lambda one: (bits(one), one.characters), reverse=True)
    if not any(one.characters for one in ranking):
        return TrialResult("silent", ranking, "nothing was heard – is the line in use, and wired to this port?")
    best = ranking[0]
    others = [one for one in ranking[1:] if replace(one.line, stop_bits=best.line.stop_bits) != best.line]
    margin = bits(best) - (max(bits(others[0]), 0.0) if others else 0.0)
    if best.sees_damage and bits(best) <= 0:
        why = "none of these speeds and formats fits – try others with --speeds and --formats"
        return TrialResult("nothing fits", ranking, why, [bits(one) for one in ranking])
    least = min(bits(best), margin)
    certainty, reason = (
        _judge_with_damage(best, tests.get(2 * best.line.speed), least)
        if best.sees_damage
        else _judge_by_text(best, others, least)
    )
    text = f"{certainty}: {best.line} ({plural(best.characters, 'character')} heard{reason})"
    if certainty == "unsure" and others and margin < LIKELY and bits(others[0]) > 0:
        text += f"; {others[0].line} fits as well"
    if certainty != "sure":
        text += " – listen longer with --each, or when more is going on"
    return TrialResult(certainty, ranking, text, [bits(one) for one in ranking])


def _judge_with_damage(best: HeardAt, test: HeardAt | None, bits: float) -> tuple[Certainty, str]:
    """Return the certainty and the reason if the port reports damaged characters. `test`: the trial at twice the speed;
    `bits`: the least evidence for the best trial.
    """
    reason, double = f", {shown_share(best)} damaged", 2 * best.line.speed
    passes = None if test is None else test.is_doubled
    if passes and bits >= SURE and best.same_bits < LIKELY:
        return "sure", f"{reason}; at {double} each bit comes twice"
    if passes is False:
        return "unsure", f"{reason}; at {double} not each bit comes twice"
    return "likely" if bits >= LIKELY else "unsure", reason


def _judge_by_text(best: HeardAt, others: Iterable[HeardAt], bits: float) -> tuple[Certainty, str]:
    """Return the certainty and the reason if only the characters themselves are evidence, of `bits` at least."""
    reason = "; this port does not tell damaged characters, so only that they are text speaks for it"
    is_likely = bits >= LIKELY and len(_other_speeds_heard(best, others)) >= SPEEDS_WANTED
    return "likely" if is_likely else "unsure", reason


def _other_speeds_heard(best: HeardAt, others: Iterable[HeardAt]) -> set[int]:
    """Return the other speeds with enough characters to exclude text."""
    return {one.line.speed for one in others if one.characters >= PAIRS_WANTED} - {best.line.speed}


SPEEDS_WANTED = 3
"""Number of other speeds required if only text distinguishes the speeds."""


def is_for_pairs(one: HeardAt) -> bool:
    """Return whether bits that occur twice can be detected in these characters."""
    return one.sees_damage and (one.line.data_bits, one.line.parity) == (8, "N")


def shown_share(one: HeardAt) -> str:
    """Return the share of damaged characters as text."""
    return f"{100 * one.damaged_share:.1f} %" if one.sees_damage else "unknown"


class LineTrial(PortEvents):
    """Listens to a port with each of `lines` for `each` ns; `on_end(verdict, why)` is called once, `why` for a lost
    port.

    `on_result` gets the result of each line. The port is opened once, and its speed and format are changed.
    """

    def __init__(
        self,
        port: Port,
        clock: Clock,
        lines: Sequence[LineFormat],
        on_end: Callable[[TrialResult, str], None],
        *,
        each: int = EACH,
        on_result: Callable[[HeardAt], None] = lambda heard: None,
    ) -> None:
        self.heard = [HeardAt(line) for line in lines]
        self.doubles: list[HeardAt] = []
        self._port = port
        self._clock = clock
        self._on_end = on_end
        self._on_result = on_result
        self._each = each
        self._waiting: list[HeardAt] = list(self.heard)
        self._now_at: HeardAt | None = None
        self._listens = False
        self._round = 0
        self._over = False
        self._alarm = clock.alarm(self._ring)

    def start(self) -> None:
        """Open the port and begin."""
        self._port.open(self)

    def stop(self) -> None:
        """End with the results so far."""
        self._end("")

    def _next(self) -> None:
        while not self._waiting and self._round < 2:
            self._round += 1
            if self._round == 1:
                self._waiting = self._best_again()
            else:
                self.doubles = self._at_twice_the_speed()
                self._waiting = list(self.doubles)
        if not self._waiting:
            self._end("")
            return
        self._now_at = heard = self._waiting.pop(0)
        self._listens = False
        self._port.change_line(heard.line)
        heard.sees_damage = self._port.sees_damage
        self._alarm.set(self._clock.now() + SETTLING + 2 * heard.line.character_time)

    def _ranked(self) -> list[HeardAt]:
        return [one for one in judge(self.heard, self.doubles).ranking if one.characters and one.bits > -SURE]

    def _best_again(self) -> list[HeardAt]:
        """Return the best results that are still undecided."""
        found = [one for one in self._ranked() if one.sees_damage][:AGAIN]
        if len(found) > 1 and found[0].bits - found[1].bits >= SURE and found[0].bits >= SURE:
            return []
        return found

    def _at_twice_the_speed(self) -> list[HeardAt]:
        speeds = dict.fromkeys(2 * one.line.speed for one in self._ranked() if one.sees_damage)
        known = {one.line.speed for one in self.heard if is_for_pairs(one) and one.is_doubled is not None}
        return [HeardAt(LineFormat(speed)) for speed in list(speeds)[:TESTED] if speed not in known]

    def _ring(self) -> None:
        """Begin to count after the settling time of a change, or end the time of this speed and format."""
        if self._listens or self._now_at is None:
            self._done()
        else:
            self._listens = True
            self._alarm.set(self._clock.now() + self._each * (1 if self._round == 0 else LONGER))

    def _done(self) -> None:
        self._alarm.cancel()
        self._listens = False
        heard, self._now_at = self._now_at, None
        if heard is not None:
            self._on_result(heard)
        self._clock.call_soon(self._go_on)

    def _go_on(self) -> None:
        if not self._over and self._now_at is None:
            self._next()

    def _end(self, why: str) -> None:
        if not self._over:
            self._over = True
            self._alarm.cancel()
            self._port.close()
            self._on_end(judge(self.heard, self.doubles), why)

    def _look(self) -> None:
        """End the trial of this speed and format if enough characters were received."""
        heard = self._now_at
        if heard is not None and (
            heard.characters >= ENOUGH * (LONGER if self._round == 1 else 1)
            or (heard.characters >= HOPELESS and heard.damaged_share > 1 / 3 and self._round < 2)
        ):
            self._done()

    # ---- events of the port -------------------------------------------------------------------------------

    def opened(self, now: int) -> None:
        self._next()

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        if self._listens and self._now_at is not None:
            self._now_at.add(data, faults)
            self._look()

    def line_break(self, now: int) -> None:
        if self._listens and self._now_at is not None:
            self._now_at.add_break()
            self._look()

    def closed(self, now: int, reason: str) -> None:
        """Handle the loss of the port: a device that does not support a speed or format is lost, and opened again for
        the next.
        """
        heard, self._now_at = self._now_at, None
        self._alarm.cancel()
        if heard is None or self._listens:
            self._end(reason)
            return
        heard.problem = reason
        self._on_result(heard)
        self._port.open(self)


SETTLING = 30_000_000
"""Settling time (ns): characters within it after a change of speed were received before the change."""


async def try_lines(
    url: str, lines: Sequence[LineFormat], *, each: int, on_result: Callable[[HeardAt], None],
    begun: Callable[[LineTrial], None],
) -> TrialResult:  # fmt: skip
    """Listen to a port with each of `lines`; `begun` gets the trial, which can be stopped.

    Raises RequestError for an invalid port or a port without a speed, LineClosedError for a port that cannot be opened
    or is lost.
    """
    clock = AsyncioClock(asyncio.get_running_loop())
    ended: asyncio.Future[tuple[TrialResult, str]] = clock.loop.create_future()
    kind = scheme_of(url)
    if kind is not None and not kind.wires:
        raise RequestError(f"'{url}' has no speed to be found – record it as it is")
    try:
        port = open_port(url, lines[0], clock, listen_only=True)
    except ValueError as error:
        raise RequestError(str(error)) from None
    trial = LineTrial(
        port, clock, lines, lambda verdict, why: ended.set_result((verdict, why)), each=each, on_result=on_result
    )  # fmt: skip
    begun(trial)
    trial.start()
    verdict, why = await ended
    if why:
        raise LineClosedError(why, "closed")
    return verdict
