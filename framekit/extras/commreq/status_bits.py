"""The status bits of the slots of a job table; they change with the scans only."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from framekit.definition.times import NEVER
from framekit.run.model import StatusBits

WriteBits = Callable[[tuple[int, ...]], None]


class StatusImage:
    """The status bits of `slots`. `write` receives all bits whenever one of them changes; `scan` is in nanoseconds."""

    def __init__(self, layout: StatusBits, slots: range, scan: int, write: WriteBits) -> None:
        self.layout = layout
        self.slots = slots
        self.scan = scan
        self._write = write
        self.ready = False
        self.network = True
        self.resource = False
        self._done: set[int] = set()
        self._pulsing: set[int] = set()
        self._errors: set[int] = set()
        self._shown: tuple[int, ...] = (0,) * layout.size
        self._origin = 0
        self._due = NEVER

    # ---- events -------------------------------------------------------------------------------------------

    def start(self, now: int) -> None:
        """Count scans from `now` on; all bits are 0 until the first scan."""
        self._origin = now
        self.ready, self.network, self.resource = True, True, False
        self._forget(self.slots)
        self._touch(now)

    def stop(self) -> None:
        """Set all bits to 0 at once."""
        self.ready = self.network = self.resource = False
        self._forget(self.slots)
        self._due = NEVER
        self._show((0,) * self.layout.size)

    def completed(self, slot: int, now: int) -> None:
        """Show the end of a transfer, good or bad, as a pulse with the next scan."""
        self._done.add(slot)
        self._touch(now)

    def set_error(self, slot: int, on: bool, now: int) -> None:
        """Set whether a slot shows an error, from the next scan on."""
        (self._errors.add if on else self._errors.discard)(slot)
        self._touch(now)

    def set_network(self, on: bool, now: int) -> None:
        """Set whether the network can be used."""
        self.network = on
        self._touch(now)

    def short(self, now: int) -> None:
        """Show a lack of resources for one scan."""
        self.resource = True
        self._touch(now)

    def clear(self, slots: Iterable[int]) -> None:
        """Set the bits of these slots to 0 at once."""
        self._forget(slots)
        bits = list(self._shown)
        for slot in slots:
            for first, step in (self.layout.done, self.layout.error):
                bits[first + step * (slot - self.slots.start) - 1] = 0
        if self.layout.any_error:
            shown = (self.layout.error[0] + self.layout.error[1] * index - 1 for index in range(len(self.slots)))
            bits[self.layout.any_error - 1] = int(any(bits[place] for place in shown))
        self._show(tuple(bits))

    def _forget(self, slots: Iterable[int]) -> None:
        for slot in slots:
            for group in (self._done, self._pulsing, self._errors):
                group.discard(slot)

    # ---- scans --------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """Return the time at which `tick` must show a change."""
        return self._due

    def tick(self, now: int) -> None:
        """Show the changes since the last scan, if a new scan has begun."""
        if self._due > now:
            return
        self._due = NEVER
        self._pulsing, rising = set(), self._done - self._pulsing
        self._pulsing |= rising
        self._done -= rising
        self._show(self._bits())
        if self._pulsing or self._done or self.resource:
            self._touch(now)
        self.resource = False

    def _touch(self, now: int) -> None:
        """Schedule the next scan after `now` to show a change."""
        if self._due == NEVER:
            self._due = self._origin + ((now - self._origin) // self.scan + 1) * self.scan

    def _bits(self) -> tuple[int, ...]:
        bits = [0] * (self.layout.size + 1)
        bits[self.layout.any_error] = int(bool(self._errors))
        bits[self.layout.network] = int(self.network)
        bits[self.layout.resource] = int(self.resource)
        bits[self.layout.ready] = int(self.ready)
        for group, (first, step) in ((self._pulsing, self.layout.done), (self._errors, self.layout.error)):
            for slot in group:
                bits[first + step * (slot - self.slots.start)] = 1
        return tuple(bits[1:])

    def _show(self, bits: tuple[int, ...]) -> None:
        if bits != self._shown:
            self._shown = bits
            self._write(bits)
