"""Characters on their way over a simulated line, and what is done to them there.

A transmission knows when each of its characters is complete and which are damaged; bits can be flipped, characters
lost, added, held up. It knows neither ports nor clocks, and not why somebody damages it.
"""

from __future__ import annotations

from collections.abc import Callable

from framekit.definition.times import LineFormat
from framekit.link.events import LineFault


class Transmission:
    """The bytes of one `write`, as the others hear them.

    `sender` is the name of the port that sends, `number` counts the transmissions of the line from 0, `start` is when
    the first start bit begins (ns), `step` what a character takes (0 on a stream). `told` characters have been told
    to the others, or never will be. An empty transmission is not heard at all. `echo`: its sender hears it as well;
    `connection` is the one it belongs to, on a stream.
    """

    __slots__ = (
        "_pauses", "connection", "data", "echo", "faults", "flips",
        "number", "sender", "settings", "start", "step", "told",
    )  # fmt: skip

    def __init__(
        self, sender: str, number: int, data: bytes, start: int, settings: LineFormat | None, step: int
    ) -> None:
        self.sender = sender
        self.number = number
        self.data = bytearray(data)
        self.start = start
        self.settings = settings
        self.step = step
        self.faults: dict[int, LineFault] = {}
        self.flips: dict[int, int] = {}
        self.echo = False
        self.connection = 0
        self.told = 0
        self._pauses: dict[int, int] = {}

    # ---- when ---------------------------------------------------------------------------------------------

    @property
    def end(self) -> int:
        """When the last stop bit ends."""
        return self.complete_at(len(self.data))

    def begins_at(self, index: int) -> int:
        """When the start bit of a character begins."""
        return self.complete_at(index + 1) - self.step

    def complete_at(self, count: int) -> int:
        """When the first `count` characters are complete."""
        time = self.start + count * self.step
        if self._pauses:
            time += sum(pause for index, pause in self._pauses.items() if index < count)
        return time

    def complete_by(self, time: int) -> int:
        """How many characters are complete at `time`."""
        elapsed, first = time - self.start, 0
        for index, pause in sorted(self._pauses.items()) if self._pauses else ():
            run = (index - first) * self.step
            if elapsed < run + pause:
                return first + self._characters(elapsed, index - first)
            elapsed -= run + pause
            first = index
        return first + self._characters(elapsed, len(self.data) - first)

    def _characters(self, elapsed: int, most: int) -> int:
        """How many characters of a run without a pause are complete so long after its begin."""
        if elapsed < 0:
            return 0
        count = elapsed // self.step if self.step else most
        return count if count < most else most

    def runs(self) -> list[int]:
        """The counts of characters at which a run without a pause ends; the last is the whole."""
        return [*sorted(index for index in self._pauses if index), len(self.data)]

    def overlapped_by(self, other: Transmission) -> list[int]:
        """Which characters are on the wire at the same time as characters of `other`."""
        return [
            index
            for index in range(self.told, len(self.data))
            if other.is_busy(self.begins_at(index), self.complete_at(index + 1))
        ]

    def within(self, start: int, end: int) -> list[int]:
        """Which characters, of those not told, are on the wire between these times."""
        places = range(max(self.told, self.complete_by(start)), len(self.data))
        return [index for index in places if self.begins_at(index) < end]

    def is_busy(self, start: int, end: int) -> bool:
        """Whether one of its characters is on the wire between these times."""
        next_one = self.complete_by(start)
        return next_one < len(self.data) and self.begins_at(next_one) < end

    # ---- what is done to it -------------------------------------------------------------------------------

    @property
    def wire_bits(self) -> int:
        """Bits of a character that can be flipped: data from bit 0, parity if there is one, the stop bit."""
        if self.settings is None:
            return 8
        return self.settings.data_bits + (self.settings.parity != "N") + 1

    def flip(self, index: int, mask: int) -> None:
        """Flips bits of a character as they go over the wire (`wire_bits`), and flags it as a receiver would.

        Even and odd parity notice an odd number of flipped bits, mark and space parity only their own bit; a flipped
        stop bit is a framing fault. Flipping again undoes it.
        """
        flips = self.flips[index] = self.flips.get(index, 0) ^ mask
        data_bits = 8 if self.settings is None else self.settings.data_bits
        self.data[index] ^= mask & ((1 << data_bits) - 1)
        fault = self._fault_of(flips, data_bits)
        if fault is not None:
            self.faults[index] = fault
        else:
            self.faults.pop(index, None)

    def _fault_of(self, flips: int, data_bits: int) -> LineFault | None:
        if self.settings is None:
            return None
        parity = self.settings.parity
        checked = data_bits + (parity != "N")
        if flips >> checked & 1:
            return LineFault.FRAMING
        if parity in "EO":
            return LineFault.PARITY if (flips & ((1 << checked) - 1)).bit_count() & 1 else None
        return LineFault.PARITY if parity != "N" and flips >> data_bits & 1 else None

    def drop(self) -> None:
        """Nobody hears it."""
        self.truncate(0)

    def truncate(self, count: int) -> None:
        """Only the first `count` characters are heard."""
        del self.data[count:]
        for places in (self.faults, self.flips, self._pauses):
            for index in [index for index in places if index >= count]:
                del places[index]

    def pause(self, index: int, duration: int) -> None:
        """Holds up the characters from `index` on; from 0: the whole."""
        if index == 0:
            self.start += duration
        elif duration > 0:
            self._pauses[index] = self._pauses.get(index, 0) + duration

    def lose(self, index: int) -> None:
        """A character is not heard; the others keep their times."""
        self._shift(index + 1, -1)
        del self.data[index]
        if index < len(self.data):
            self.pause(index, self.step)
        else:
            self._pauses.pop(index, None)

    def insert(self, index: int, data: bytes) -> None:
        """Adds characters before `index` (`len(data)`: behind the last); what follows comes later."""
        self._shift(index, len(data))
        self.data[index:index] = data

    def _shift(self, start: int, by: int) -> None:
        """What stands at `start` and behind moves by `by` characters; of what is moved over, only pauses remain."""
        gone = range(start + by, start)
        self.faults = {i + by * (i >= start): fault for i, fault in self.faults.items() if i not in gone}
        self.flips = {i + by * (i >= start): flips for i, flips in self.flips.items() if i not in gone}
        pauses, self._pauses = self._pauses, {}
        for index, duration in pauses.items():
            self.pause(index + by * (index >= start), duration)


Fault = Callable[[Transmission], None]
"""Changes a transmission when it goes on the line, before anybody has heard of it."""


def in_order(*faults: Fault) -> Fault:
    """One fault after the other."""

    def all_of_them(transmission: Transmission) -> None:
        for fault in faults:
            fault(transmission)

    return all_of_them
