"""The bits a memory sets by itself: clocks, always on and off, the first scan, every scan.

Sans-I/O: the caller passes the time and asks for the time of the next change. A clock of period T rises at T, 2T, 3T …
after the start, is on for the first half of each period and off for the second; it is off before T. Every state is
computed from the time since the start, so that no error accumulates, and a long gap costs no more than a short one. A
memory has no real scan: a scan is `profile.scan` nanoseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from framekit.definition.times import NEVER
from framekit.memory.memory import Area, DeviceMemory, DeviceMemoryError
from framekit.memory.profile import CALENDAR_PARTS, FixedBit, MemoryProfile

SECOND = 1_000_000_000

Locate = Callable[[str], tuple[str, int]]
"""Function that returns area and bit number (from 0 over the whole area) of an address in the form of the profile."""


@dataclass(slots=True)
class _Clock:
    """A clock that rises at `first`, then every `period` (ns after the start)."""

    mask: int
    period: int
    first: int
    waited_for: bool = True
    rises: int = 0
    """Number of rising edges so far."""
    is_on: bool = False
    """State, valid until `edge`."""
    edge: int = 0

    def move(self, time: int) -> None:
        """Set the state at `time`, which must not be before `edge`."""
        if time < self.first:
            self.edge = self.first
            return
        periods, into = divmod(time - self.first, self.period)
        half = (self.period + 1) // 2
        self.rises, self.is_on = periods + 1, 2 * into < self.period
        self.edge = time - into + (half if into < half else self.period)


@dataclass(slots=True)
class _Word:
    """The bits of one word that are set here, as masks."""

    area: Area
    number: int
    owned: int = 0
    on: int = 0
    first_scan: int = 0
    after_first_scan: int = 0
    clocks: list[_Clock] = field(default_factory=list)

    def next_edge(self, time: int, scan: int) -> int:
        """Return the time of the next change of a bit of the word; NEVER if no bit changes any more."""
        due = scan if time < scan and (self.first_scan or self.after_first_scan) else NEVER
        return min([due, *[clock.edge for clock in self.clocks]])


class SystemBits:
    """Keeps the clock and fixed bits of `profile` in `memory`, read-only areas included.

    `locate` finds the bit of an address; its errors pass through, and a bit outside of the whole words of its area
    raises MemoryRangeError. `wake`: the bits (area, bit number) that are waited for; None stands for all bits. Clocks
    and every-scan bits not among them are ignored in `next_change`, but are correct after every `update`, so call it
    before reading them. `date` returns the date and time of day at a time.
    """

    def __init__(
        self,
        memory: DeviceMemory,
        profile: MemoryProfile,
        locate: Locate,
        wake: Collection[tuple[str, int]] | None = None,
        date: Callable[[int], datetime] = lambda now: datetime(2000, 1, 1) + timedelta(microseconds=now // 1000),
    ) -> None:
        self._memory = memory
        self._locate = locate
        self._scan = profile.scan
        self._origin: int | None = None
        self.look_at = 0
        """Time (ns) before which `update` has no effect."""
        self.due = NEVER
        """Time (ns) of the next change of a bit that is waited for."""
        self._time = 0
        self._next_edge = 0
        self._words: dict[tuple[str, int], _Word] = {}
        self._date = date
        self._next_second = 0
        self._calendar = [(*self._word_of(word.address), word.parts) for word in profile.calendar]
        for clock in profile.clocks:
            self._add_clock(clock.address, clock.period, clock.period)
        for bit in profile.fixed:
            self._add_fixed(bit)
        words = self._words.values()
        self._has_scan_bits = any(word.first_scan or word.after_first_scan for word in words)
        self.wait_for(wake)
        for word in words:
            word.area.watch(word.number, 1, self._look_again, word.owned)

    @property
    def areas(self) -> set[str]:
        """Return the names of the areas that contain these bits."""
        return {word.area.name for word in self._words.values()} | {area.name for area, _, _ in self._calendar}

    def wait_for(self, wake: Collection[tuple[str, int]] | None) -> None:
        """Wait for these bits only from now on; None: all bits. Call `update` before."""
        self._wake = None if wake is None else {(self._memory.area(name).name, bit) for name, bit in wake}
        for word in self._words.values():
            for clock in word.clocks:
                place = (word.area.name, 16 * word.number + clock.mask.bit_length() - 1)
                clock.waited_for = self._wake is None or place in self._wake
        self._waited_for = [clock for word in self._words.values() for clock in word.clocks if clock.waited_for]
        self._calendar_counts = self._counts_calendar()
        self._note_due()

    def _add_clock(self, address: str, period: int, first: int) -> None:
        word, mask = self._place(address)
        word.clocks.append(_Clock(mask, period, first))

    def _add_fixed(self, bit: FixedBit) -> None:
        if bit.kind == "every_scan":
            self._add_clock(bit.address, 2 * self._scan, self._scan)
            return
        word, mask = self._place(bit.address)
        if bit.kind == "on":
            word.on |= mask
        elif bit.kind == "first_scan":
            word.first_scan |= mask
        elif bit.kind == "after_first_scan":
            word.after_first_scan |= mask

    def _word_of(self, address: str) -> tuple[Area, int]:
        name, bit = self._locate(address)
        area = self._memory.area(name)
        area.read("word", bit // 16)
        return area, bit // 16

    def _place(self, address: str) -> tuple[_Word, int]:
        area, _ = self._word_of(address)
        bit = self._locate(address)[1]
        word = self._words.setdefault((area.name, bit // 16), _Word(area, bit // 16))
        mask = 1 << bit % 16
        word.owned |= mask
        return word, mask

    def start(self, now: int) -> None:
        """Set time zero: clocks are off, the first scan begins. A repeated call starts again."""
        self._origin, self._time = now, 0
        for word in self._words.values():
            for clock in word.clocks:
                clock.rises, clock.is_on, clock.edge = 0, False, clock.first
            self._show(word, 0)
        self._next_second = 0
        self._show_calendar(now)
        self._note_next_edge()

    def next_change(self, now: int) -> int:
        """Return the time of the next change, `now` if it has already passed; NEVER if no bit changes any more. Raises
        DeviceMemoryError before `start`.
        """
        if self._origin is None:
            raise DeviceMemoryError("the system bits have not been started")
        return max(now, self.due)

    def _note_due(self) -> None:
        if self._origin is None:
            return
        due = self._scan if self._has_scan_bits and self._time < self._scan else NEVER
        for clock in self._waited_for:
            due = min(due, clock.edge)
        change = self._origin + due if due < NEVER else NEVER
        self.due = min(change, self._next_second) if self._calendar_counts else change

    def update(self, now: int) -> None:
        """Bring all bits up to date for `now`; a time before the previous one has no effect.

        A clock that is waited for and has risen since the last update shows one rising edge, even if its on phase has
        passed or a new one has begun: the word is then written up to three times.
        """
        if now < self.look_at:
            return
        if self._origin is None:
            raise DeviceMemoryError("the system bits have not been started")
        time = now - self._origin
        if now >= self._next_second:
            self._show_calendar(now)
            self._note_times()
        if time < self._next_edge or time <= self._time:
            return
        self._time = time
        for word in self._words.values():
            self._show(word, time)
        self._note_next_edge()

    def _counts_calendar(self) -> bool:
        """Return whether a block waits for a bit of the calendar."""
        places = {(area.name, number) for area, number, _ in self._calendar}
        return bool(places) and (self._wake is None or any((name, bit // 16) in places for name, bit in self._wake))

    def _show_calendar(self, now: int) -> None:
        """Write the words of the calendar, once a second."""
        if not self._calendar:
            self._next_second = NEVER
            return
        date = self._date(now)
        self._next_second = now - now % 1000 + SECOND - 1000 * date.microsecond
        for area, number, parts in self._calendar:
            values = [CALENDAR_PARTS[part](date) for part in parts]
            if len(values) == 1:
                word = values[0] & 0xFFFF
            else:
                word = sum((value // 10 << 4 | value % 10) << 8 * at for at, value in enumerate(values))
            if area.read("word", number) != [word]:
                area.write("word", number, [word], force=True)

    def _look_again(self, *_: object) -> None:
        """Mark overwritten bits: the next update restores them."""
        self._next_edge = self.look_at = 0

    def _note_next_edge(self) -> None:
        """Note the time of the next edge; until then an update has no effect."""
        words = self._words.values()
        self._next_edge = min((word.next_edge(self._time, self._scan) for word in words), default=NEVER)
        self._note_times()

    def _note_times(self) -> None:
        assert self._origin is not None
        self.look_at = min(self._origin + self._next_edge, self._next_second)
        self._note_due()

    def _show(self, word: _Word, time: int) -> None:
        risen = 0
        on = word.on | (word.first_scan if time < self._scan else word.after_first_scan)
        for clock in word.clocks:
            if time >= clock.edge:
                rises = clock.rises
                clock.move(time)
                if rises != clock.rises and clock.waited_for:
                    risen |= clock.mask
            if clock.is_on:
                on |= clock.mask
        before = word.area.read("word", word.number)[0]
        final = before & ~word.owned | on
        if final == before and not risen:
            return
        current = before
        for value in (before & ~risen, final | risen, final):
            if value != current:
                word.area.write("word", word.number, [value], force=True)
                current = value
