"""Random faults on a simulated line, for tests: bits, characters, whole transmissions."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from random import Random

from framekit.transport.simulated_line import Transmission, hits


def lose(transmission: Transmission, index: int) -> None:
    """Lose a character; the others keep their times."""
    _shift(transmission, index + 1, -1)
    del transmission.data[index]
    if index < len(transmission.data):
        transmission.pause(index, transmission.step)
    else:
        transmission._pauses.pop(index, None)


def insert(transmission: Transmission, index: int, data: bytes) -> None:
    """Insert characters before `index` (`len(data)`: after the last character) and shift the faults after it."""
    _shift(transmission, index, len(data))
    transmission.data[index:index] = data


def _shift(transmission: Transmission, start: int, by: int) -> None:
    """Shift the faults and pauses from `start` on by `by` characters.

    If characters are removed, their faults are dropped and their pauses are kept.
    """
    gone = range(start + by, start)
    transmission.faults = {i + by * (i >= start): fault for i, fault in transmission.faults.items() if i not in gone}
    transmission.flips = {i + by * (i >= start): flips for i, flips in transmission.flips.items() if i not in gone}
    pauses, transmission._pauses = transmission._pauses, {}
    for index, duration in pauses.items():
        transmission.pause(index + by * (index >= start), duration)


@dataclass(slots=True)
class Faults:
    """A fault for `SimulatedLine.fault`; rates are probabilities from 0 to 1.

    `bit_errors` applies to each bit on the wire (data, parity, stop), `byte_errors` to each character, which is
    replaced by another character. `drop`, `truncate` and `extra` apply to each transmission: it is lost, its end is cut
    off, or up to `longest_extra` characters of noise follow it. `delay` is the longest delay of a transmission in ns.
    `echo` lets the sender receive its own transmission. `injected` counts the faults by field name.
    """

    bit_errors: float = 0.0
    byte_errors: float = 0.0
    drop: float = 0.0
    truncate: float = 0.0
    extra: float = 0.0
    longest_extra: int = 4
    delay: int = 0
    echo: bool = False
    seed: int = 0
    injected: Counter[str] = field(default_factory=Counter)
    _random: dict[str, Random] = field(default_factory=dict, repr=False)

    def __call__(self, transmission: Transmission) -> None:
        transmission.echo = transmission.echo or self.echo
        if self._happens("drop", self.drop):
            transmission.truncate(0)
            return
        if self._happens("truncate", self.truncate):
            transmission.truncate(self._of("truncate").randrange(len(transmission.data) or 1))
        if self.bit_errors > 0:
            self._damage_bits(transmission)
        if self.byte_errors > 0:
            self._damage_bytes(transmission)
        if self._happens("extra", self.extra):
            noise = self._of("extra").randbytes(self._of("extra").randint(1, max(1, self.longest_extra)))
            insert(transmission, len(transmission.data), noise)
        if self.delay > 0:
            self.injected["delay"] += 1
            transmission.pause(0, self._of("delay").randint(0, self.delay))

    def _of(self, kind: str) -> Random:
        """Return the random generator of a kind of fault."""
        if kind not in self._random:
            self._random[kind] = Random(f"{self.seed}/{kind}")
        return self._random[kind]

    def _happens(self, kind: str, rate: float) -> bool:
        happens = rate > 0 and self._of(kind).random() < rate
        self.injected[kind] += happens
        return happens

    def _damage_bits(self, transmission: Transmission) -> None:
        bits = transmission.wire_bits
        for place in hits(self._of("bit_errors"), self.bit_errors, len(transmission.data) * bits):
            transmission.flip(place // bits, 1 << place % bits)
            self.injected["bit_errors"] += 1

    def _damage_bytes(self, transmission: Transmission) -> None:
        random = self._of("byte_errors")
        data_bits = 8 if transmission.settings is None else transmission.settings.data_bits
        others = (1 << (transmission.wire_bits - data_bits)) - 1
        for index in hits(random, self.byte_errors, len(transmission.data)):
            mask = random.randrange(1, 1 << data_bits)
            transmission.flip(index, mask | (random.randint(0, others) << data_bits))
            self.injected["byte_errors"] += 1
