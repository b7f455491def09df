"""A simulated line: any number of ports on one pair of wires, exact to the bit time, on any clock.

Each character takes its bit times after the previous character, at the speed and in the format of the sending port. A
port with other settings samples the signal with its own bit times (`misheard`). On a stream (`settings` None) bytes
only take `latency`, and ports are connected as by TCP.

Bytes are not reported singly. The complete characters of a transmission are reported, with the time of the last of
them, before any other event of the clock and wherever a virtual clock stops; without other events that is once, at the
end of the transmission. So no timer can expire that a character should have stopped, and each `received` covers
characters without a pause between them. There is one difference to an event for each character: a reaction to the bytes
(such as the answer to a frame with noise after it in the same transmission) follows when they are reported. If two
stations send at once on a full-duplex line, a third station receives pieces, not single characters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache, partial
from random import Random

from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import Clock
from framekit.transport.port import Port, PortEvents


class Transmission:
    """The bytes of one `write`, as received by the other ports.

    `sender`: name of the sending port; `number`: index of the transmission on the line, from 0; `start`: begin of the
    first start bit (ns); `step`: duration of a character (ns; 0 on a stream). The first `told` characters have been
    reported to the others, or never will be. An empty transmission is not received at all. `echo`: whether the sender
    receives it as well; `connection`: its connection, on a stream; `marks`: the indices of characters whose ninth bit
    is set.
    """

    __slots__ = (
        "_pauses", "connection", "data", "echo", "faults", "flips", "marks",
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
        self.marks: set[int] = set()
        self.echo = False
        self.connection = 0
        self.told = 0
        self._pauses: dict[int, int] = {}

    # ---- when ---------------------------------------------------------------------------------------------

    @property
    def end(self) -> int:
        """Return the end of the last stop bit (ns)."""
        return self.complete_at(len(self.data))

    def begins_at(self, index: int) -> int:
        """Return the begin of the start bit of a character (ns)."""
        return self.complete_at(index + 1) - self.step

    def complete_at(self, count: int) -> int:
        """Return when the first `count` characters are complete (ns)."""
        time = self.start + count * self.step
        if self._pauses:
            time += sum(pause for index, pause in self._pauses.items() if index < count)
        return time

    def complete_by(self, time: int) -> int:
        """Return the number of characters complete at `time`."""
        elapsed, first = time - self.start, 0
        for index, pause in sorted(self._pauses.items()) if self._pauses else ():
            run = (index - first) * self.step
            if elapsed < run + pause:
                return first + self._characters(elapsed, index - first)
            elapsed -= run + pause
            first = index
        return first + self._characters(elapsed, len(self.data) - first)

    def _characters(self, elapsed: int, most: int) -> int:
        """Return the number of characters of a run without a pause that are complete `elapsed` ns after its begin."""
        if elapsed < 0:
            return 0
        count = elapsed // self.step if self.step else most
        return count if count < most else most

    def runs(self) -> list[int]:
        """Return the numbers of characters at which a run without a pause ends; the last is the total."""
        return [*sorted(index for index in self._pauses if index), len(self.data)]

    def overlapped_by(self, other: Transmission) -> list[int]:
        """Return the indices of characters that overlap characters of `other` on the wire."""
        return [
            index
            for index in range(self.told, len(self.data))
            if other.is_busy(self.begins_at(index), self.complete_at(index + 1))
        ]

    def within(self, start: int, end: int) -> list[int]:
        """Return the indices of characters, among those not reported yet, that are on the wire between these times."""
        places = range(max(self.told, self.complete_by(start)), len(self.data))
        return [index for index in places if self.begins_at(index) < end]

    def is_busy(self, start: int, end: int) -> bool:
        """Return whether one of its characters is on the wire between these times."""
        next_one = self.complete_by(start)
        return next_one < len(self.data) and self.begins_at(next_one) < end

    def heard_as(self, first: int, count: int, line: LineFormat | None) -> tuple[bytes, tuple[CharacterFault, ...]]:
        """Return characters `first` to `count` as a port with these settings receives them, with their faults.

        A port of another speed or format gets one character for each: it samples at the middle of each of its own bits,
        and the line is idle after the stop bit. Speeds that differ by more than `TOLERANCE` allows give a bad stop bit.
        """
        data = bytes(self.data[first:count])
        flagged = self.faults and {index - first: self.faults[index] for index in self.faults if first <= index < count}
        sent = self.settings
        if line is not sent and line is not None and sent is not None and line != sent:
            ninth = [(first + index in self.marks) << 8 for index in range(len(data))]
            heard = [misheard(value | bit, sent, line) for value, bit in zip(data, ninth, strict=True)]
            data = bytes(value & 0xFF for value, _ in heard)
            found = {index: fault for index, (_, fault) in enumerate(heard) if fault is not None}
            flagged = {**found, **flagged}
            marks = [index for index, (value, _) in enumerate(heard) if value > 0xFF]
        else:
            marks = sorted(index - first for index in self.marks if first <= index < count) if self.marks else []
        if not flagged and not marks:
            return data, ()
        damaged = [CharacterFault(index, flagged[index]) for index in sorted(flagged)]
        return data, (*damaged, *(CharacterFault(index, LineFault.MARK) for index in marks))

    # ---- changes by faults --------------------------------------------------------------------------------

    @property
    def wire_bits(self) -> int:
        """Return the number of bits of a character that can be flipped: data from bit 0, parity if any, the stop
        bit.
        """
        if self.settings is None:
            return 8
        return self.settings.data_bits + (self.settings.parity != "N") + 1

    def flip(self, index: int, mask: int) -> None:
        """Flip bits of a character on the wire (`wire_bits`), and flag it as a receiver would.

        Even and odd parity detect an odd number of flipped bits, mark and space parity only their own bit; a flipped
        stop bit is a framing fault. Flipping again undoes it.
        """
        flips = self.flips[index] = self.flips.get(index, 0) ^ mask
        data_bits = 8 if self.settings is None else self.settings.data_bits
        self.data[index] ^= mask & ((1 << data_bits) - 1) & 0xFF
        if data_bits == 9 and mask >> 8 & 1:
            self.marks ^= {index}
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

    def truncate(self, count: int) -> None:
        """Drop all characters after the first `count`."""
        del self.data[count:]
        self.marks = {index for index in self.marks if index < count}
        for places in (self.faults, self.flips, self._pauses):
            for index in [index for index in places if index >= count]:
                del places[index]

    def pause(self, index: int, duration: int) -> None:
        """Delay the characters from `index` on; from 0: all characters."""
        if index == 0:
            self.start += duration
        elif duration > 0:
            self._pauses[index] = self._pauses.get(index, 0) + duration


TOLERANCE = 20
"""Reciprocal of the largest relative difference of speeds that still agree: beyond it half a bit is lost within a
character.
"""


@lru_cache(4096)
def misheard(value: int, sent: LineFormat, line: LineFormat) -> tuple[int, LineFault | None]:
    """Return a character as a receiver of another speed or format reads it, with the fault it detects.

    `value` and the result have a ninth bit if the format has one.
    """
    bits = [0, *(value >> place & 1 for place in range(sent.data_bits))]
    if sent.parity != "N":
        bits.append(_parity_of(value, sent.parity))

    def at(place: int) -> int:
        """Return the bit at this place, sampled in its middle; the line is idle after the last bit."""
        index = (2 * place + 1) * sent.speed // (2 * line.speed)
        return bits[index] if index < len(bits) else 1

    found = sum(at(place + 1) << place for place in range(line.data_bits))
    after = 1 + line.data_bits
    has_parity = line.parity != "N"
    if abs(sent.speed - line.speed) * TOLERANCE > sent.speed or not at(after + has_parity):
        return found, LineFault.FRAMING
    if has_parity and at(after) != _parity_of(found, line.parity):
        return found, LineFault.PARITY
    return found, None


def _parity_of(value: int, parity: str) -> int:
    """Return the parity bit of a character."""
    odd = value.bit_count() & 1
    return {"E": odd, "O": 1 - odd, "M": 1, "S": 0}[parity]


Fault = Callable[[Transmission], None]
"""Function that changes a transmission when it begins on the line, before any port receives it."""


def in_order(*faults: Fault) -> Fault:
    """Return a fault that applies the given faults in order."""

    def all_of_them(transmission: Transmission) -> None:
        for fault in faults:
            fault(transmission)

    return all_of_them


def hits(random: Random, rate: float, count: int) -> Iterator[int]:
    """Yield the indices, out of `count`, that are hit with probability `rate` each; the cost grows with the hits
    only.
    """
    if rate >= 1:
        yield from range(count)
        return
    scale, index = math.log1p(-rate), -1
    while True:
        index += 1 + int(math.log(1.0 - random.random()) / scale)
        if index >= count:
            return
        yield index


FAR_END_CLOSED = "the other side has closed the connection"


class SimulatedPort(Port):
    """A port made by `SimulatedLine.port`.

    `format`: present speed and format. While `present` is False (an unplugged adapter) the port cannot be opened.
    `rts`: level set by its owner. `wanted`: the port is open or waits for a connection; `joined`: it takes part in
    `connection`. `fault`: applied to transmissions of this port, before the fault of the line.
    """

    has_exact_times = True

    def __init__(self, line: SimulatedLine, name: str, in_time: bool) -> None:
        self.line = line
        self.name = name
        self.settings = self.format = line.settings
        self.present = True
        self.rts = False
        self.fault: Fault | None = None
        self.is_open = False
        self.joined = False
        self.connection = line.connection
        self.heard_until = 0
        self._events: PortEvents | None = None
        self._clock = line.clock
        self.in_time = in_time
        self._now = line.clock.moment if in_time else line.clock.now
        self._opening = 0
        self._deaf_until = 0
        self._free = 0
        self._sent_due = False

    @property
    def hears_marks(self) -> bool:  # type: ignore[override]
        return self.format is not None and self.format.has_marks

    @property
    def sees_damage(self) -> bool:  # type: ignore[override]
        return self.format is not None

    @property
    def wanted(self) -> bool:
        return self._events is not None

    def _later(self, when: int, action: Callable[[], None]) -> None:
        """Run an action at time `when` (ns), unless the port has been closed meanwhile."""
        opening = self._opening

        def call() -> None:
            if opening == self._opening:
                action()

        self._clock.call_at(when, call)

    # ---- life ---------------------------------------------------------------------------------------------

    def open(self, events: PortEvents) -> None:
        self.close()
        self.format = self.settings
        self._events = events
        if self.present:
            self.line.join(self)
        else:
            self._later(self._clock.now(), lambda: self.pull(f"{self.name} is not there"))

    def connect(self, connection: int) -> None:
        """Connect the port to the line, or to a connection on a stream: it opens now."""
        self.joined = True
        self.connection = connection
        self._later(self._clock.now(), self._opened)

    def _opened(self) -> None:
        self.is_open = True
        self._deaf_until = now = self._clock.now()
        if self._events is not None:
            self._events.opened(now)

    def close(self) -> None:
        if self.wanted:
            self._forget()

    def _forget(self) -> None:
        """End the use of the port: data that has not begun to leave is dropped."""
        self._events = None
        self.is_open = False
        self._opening += 1
        self._free = 0
        self._sent_due = False
        self.line.cut_off(self)
        self.line.leave(self)
        self.joined = False

    def pull(self, reason: str = "pulled out") -> None:
        """Remove the port, as if its adapter were unplugged; its owner gets `closed` at once."""
        events = self._events
        if events is not None:
            self._forget()
            events.closed(self._clock.now(), reason)

    def lose_at(self, when: int) -> None:
        """Close the port at time `when` (ns), because the other side of a connection has closed."""
        self._later(when, lambda: self.pull(FAR_END_CLOSED))

    # ---- out ----------------------------------------------------------------------------------------------

    def write(self, data: bytes, marked: int | None = None) -> None:
        if not self.is_open:
            return
        start = max(self._free, self._now())
        self._free = self.line.transmit(self, data, start, marked) if data else start
        self._tell_when_sent()

    def write_marked(self, data: bytes, marked: int) -> None:
        self.write(data, marked)

    def send_break(self, duration: int) -> None:
        if not self.is_open:
            return
        start = max(self._free, self._now())
        self._free = start + duration
        self._later(start, lambda: self.line.break_from(self, start, duration))
        self._tell_when_sent()

    def _tell_when_sent(self) -> None:
        if not self._sent_due:
            self._sent_due = True
            self._later(self._free, self._left)

    def _left(self) -> None:
        """Report `sent` if the last bit has left and no further data was handed over."""
        self._sent_due = False
        if self._free > self._now():
            self._tell_when_sent()
        elif self._events is not None:
            self._events.sent(self._free)

    def change_line(self, line: LineFormat) -> None:
        if self.is_open and self.settings is not None:
            self.format = line

    def set_rts(self, on: bool) -> None:
        self.rts = on

    # ---- in -----------------------------------------------------------------------------------------------

    def hear(self, transmission: Transmission, first: int, count: int) -> None:
        """Receive the characters from `first` on, of the first `count`, without a pause between them."""
        if self._events is None or not self.is_open:
            return
        data, faults = transmission.heard_as(first, count, self.format)
        now, begin = transmission.complete_at(count), transmission.begins_at(first)
        if begin < self._deaf_until:
            step = transmission.step
            missed = -((begin - self._deaf_until) // step) if step else len(data)
            data = data[missed:]
            faults = tuple(CharacterFault(at.index - missed, at.fault) for at in faults if at.index >= missed)
        if data:
            self._events.received(data, now, faults)

    def hear_break(self, now: int) -> None:
        """Report a break that has lasted longer than a character."""
        if self._events is not None and self.is_open:
            self._events.line_break(now)

    def signal(self, lines: Mapping[str, bool]) -> None:
        """Set control lines (cts, dsr, dcd, ri) as the connected equipment does."""
        if self._events is not None and self.is_open:
            self._events.control(lines, self._clock.now())


_LACKING = {bits: bytes(range(256))[: 1 << bits] * (256 >> bits) for bits in (5, 6, 7)}
"""Translation of bytes to characters of fewer than 8 bits."""


class SimulatedLine:
    """A line shared by its ports: each port receives the transmissions of the others.

    Without `full_duplex` simultaneous transmissions damage each other: characters of the first that overlap the second
    are garbled (`seed`), sometimes with a framing fault; the second is lost until the first has ended. `fault` may
    change every transmission; `echo` lets ports receive their own transmissions, as many RS-485 adapters do; `latency`
    (ns) delays everything received.
    """

    def __init__(
        self,
        clock: Clock,
        settings: LineFormat | None,
        *,
        full_duplex: bool = True,
        latency: int = 0,
        fault: Fault | None = None,
        echo: bool = False,
        seed: int = 0,
    ) -> None:
        self.clock = clock
        self.settings = settings
        self.full_duplex = full_duplex or settings is None
        self.latency = latency
        self.fault = fault
        self.echo = echo
        self.character_time = 0 if settings is None else settings.character_time
        self.ports: tuple[SimulatedPort, ...] = ()
        self.transmissions = 0
        self.bytes_carried = 0
        self.connection = 0
        self._under_way: list[tuple[SimulatedPort, Transmission]] = []
        self._break: tuple[SimulatedPort | None, int, int] = (None, 0, 0)
        self._random = Random(seed)

    def port(self, name: str, *, in_time: bool = False) -> SimulatedPort:
        """Return a new port on this line; `in_time` for a simulated device, see `Port`."""
        port = SimulatedPort(self, name, in_time)
        self.ports += (port,)
        return port

    # ---- sending ------------------------------------------------------------------------------------------

    def transmit(self, sender: SimulatedPort, data: bytes, start: int, marked: int | None = None) -> int:
        """Transmit characters from `start` on; return when the last of them will have left the sender (ns).

        `marked`: index of the character whose ninth bit is set, if characters have nine bits.
        """
        line = sender.format
        step = self.character_time if line is self.settings or line is None else line.character_time
        if line is not None and line.data_bits < 8:
            data = data.translate(_LACKING[line.data_bits])
        heard_from = max(start + self.latency, sender.heard_until)
        transmission = Transmission(sender.name, self.transmissions, data, heard_from, line, step)
        if marked is not None and line is not None and line.has_marks:
            transmission.marks.add(marked)
        transmission.echo = self.echo
        transmission.connection = sender.connection
        self.transmissions += 1
        self.bytes_carried += len(data)
        for fault in (sender.fault, self.fault):
            if fault is not None:
                fault(transmission)
        if transmission.data:
            sender.heard_until = transmission.end
            if not self.full_duplex:
                self._collide(sender, transmission)
            self._put(sender, transmission)
        return start + len(data) * step

    def _put(self, sender: SimulatedPort, transmission: Transmission) -> None:
        if not self._under_way:
            self.clock.lag(self)
        self._under_way.append((sender, transmission))
        for count in transmission.runs():
            self.clock.call_at(transmission.complete_at(count), partial(self._reached, sender, transmission, count))

    def _collide(self, sender: SimulatedPort, new: Transmission) -> None:
        breaking, begin, end = self._break
        if breaking is not sender and end > new.start:
            self._garble(new, new.within(begin, end))
        for other_sender, other in self._under_way:
            if other_sender is not sender and other.end > new.start and new.end > other.start:
                first, second = (other, new) if other.start <= new.start else (new, other)
                lost = second.overlapped_by(first)
                self._garble(first, first.overlapped_by(second))
                while lost and lost[0] == second.told:
                    second.told = lost.pop(0) + 1
                self._garble(second, lost)

    def _garble(self, transmission: Transmission, places: Iterable[int]) -> None:
        """Damage characters that overlap other characters on the wire; half of them lose their stop bit."""
        bits = transmission.wire_bits - 1
        for index in places:
            transmission.flip(index, self._random.randrange(1, 1 << bits) | self._random.randrange(2) << bits)

    # ---- hearing ------------------------------------------------------------------------------------------

    def behind(self, until: int) -> int | None:
        """Return the time of the first transmission with unreported complete characters up to `until`, or None.

        See `Lagging`.
        """
        first: int | None = None
        for _, transmission in self._under_way:
            count = transmission.complete_by(until)
            if count > transmission.told:
                time = transmission.complete_at(count)
                first = time if first is None or time < first else first
        return first

    def catch_up(self, until: int) -> None:
        """Report the transmissions whose complete characters end at `until`; later transmissions follow in order.

        See `Lagging`.
        """
        for sender, transmission in list(self._under_way):
            count = transmission.complete_by(until)
            if count > transmission.told and transmission.complete_at(count) == until:
                self._tell(sender, transmission, count)

    def _reached(self, sender: SimulatedPort, transmission: Transmission, count: int) -> None:
        self._tell(sender, transmission, min(count, len(transmission.data)))
        if count >= len(transmission.data):
            self._over(sender, transmission)

    def _over(self, sender: SimulatedPort, transmission: Transmission) -> None:
        if (sender, transmission) in self._under_way:
            self._under_way.remove((sender, transmission))
        if not self._under_way:
            self.clock.end_lag(self)

    def _tell(self, sender: SimulatedPort, transmission: Transmission, count: int) -> None:
        """Report the first `count` characters to the other ports, without those already reported."""
        first = transmission.told
        if count <= first:
            return
        transmission.told = count
        for port in self.ports:
            if (port is not sender or transmission.echo) and port.connection == transmission.connection:
                port.hear(transmission, first, count)

    # ---- breaks, connections ------------------------------------------------------------------------------

    def break_from(self, sender: SimulatedPort, start: int, duration: int) -> None:
        """Hold the line in break state from `start`; the others detect it after the duration of a character."""
        if self.settings is None:
            return
        begin = start + self.latency
        if not self.full_duplex:
            for other_sender, other in self._under_way:
                if other_sender is not sender:
                    self._garble(other, other.within(begin, begin + duration))
            self._break = sender, begin, begin + duration
        times = {port.format.character_time for port in self.ports if port.format is not None}
        for noticed in sorted(time for time in times if time < duration):
            self.clock.call_at(begin + noticed, partial(self._tell_break, sender, begin, noticed))

    def _tell_break(self, sender: SimulatedPort, begin: int, character: int) -> None:
        """Report a break to the ports whose characters have this duration."""
        for port in self.ports:
            is_theirs = port.format is not None and port.format.character_time == character
            if is_theirs and (port is not sender or self.echo):
                port.hear_break(begin + character)

    def cut_off(self, sender: SimulatedPort) -> None:
        """Cut off the transmissions of a port: only characters already complete are received.

        A stream delivers everything that has been handed over.
        """
        if self.settings is None:
            return
        sent_by = self.clock.now() + self.latency
        for other, transmission in list(self._under_way):
            if other is sender and transmission.end > sent_by:
                transmission.truncate(transmission.complete_by(sent_by))
                end = transmission.end if transmission.data else sent_by
                self.clock.call_at(end, partial(self._reached, sender, transmission, len(transmission.data)))
        sender.heard_until = min(sender.heard_until, sent_by)

    def join(self, port: SimulatedPort) -> None:
        """Connect a port: at once on a line; on a stream, once another port waits for a connection."""
        if self.settings is not None:
            port.connect(self.connection)
            return
        ready = [it for it in self.ports if it.wanted and (not it.joined or it.connection == self.connection)]
        if len(ready) > 1:
            for it in ready:
                if not it.joined:
                    it.connect(self.connection)

    def leave(self, port: SimulatedPort) -> None:
        """Disconnect a port; on a stream that ends the connection for all ports, after the data sent before."""
        if self.settings is not None or not port.joined or port.connection != self.connection:
            return
        self.connection += 1
        when = max(self.clock.now() + self.latency, port.heard_until)
        for other in self.ports:
            if other is not port and other.joined and other.connection == port.connection:
                other.lose_at(when)
