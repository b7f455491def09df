"""A simulated line: any number of ports on one pair of wires, exact to the bit time, on any clock.

Each character takes its bit times behind the one before it. On a stream (`settings` None) bytes only take `latency`,
and ports are connected as by TCP. What the bytes mean is not known here.

Coalescing, `cut_through=True` (the default): bytes are not told one by one. What is complete of a transmission is
told, at the time of its last character, before anything else on the clock happens and wherever a virtual clock stops;
when nothing happens meanwhile, that is once, at the end of the transmission. So no timer can run out that a character
should have stopped, and `received` always stands for characters without a pause between them. The one difference to
an event a character: what follows from the bytes themselves (an answer to a frame with noise behind it in the same
transmission) follows when they are told. `granularity` bounds how many characters that may be; with 1 there is no
difference. Of two who talk at once on a full-duplex line a third one hears pieces, not single characters.

`cut_through=False`: a transmission is told when it is complete (or every `granularity`
characters); time limits for the begin of a frame have to last until its end. The cheapest for many lines at once.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from random import Random

from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault
from framekit.transport.clock import Clock
from framekit.transport.simulated_port import SimulatedPort
from framekit.transport.transmission import Fault, Transmission

__all__ = ["SimulatedLine", "SimulatedPort"]


class SimulatedLine:
    """A line that its ports share: every other port hears what one sends.

    Without `full_duplex` two who talk at once damage each other: characters of the one that began first that overlap
    the other are garbled (`seed`), sometimes with a framing fault; the other one's are lost until the first has
    ended. `fault` may change every transmission; `echo` lets ports hear themselves, as many RS-485 adapters do;
    `latency` (ns) is added to everything that is heard.
    """

    def __init__(
        self,
        clock: Clock,
        settings: LineFormat | None,
        *,
        full_duplex: bool = True,
        cut_through: bool = True,
        granularity: int = 0,
        latency: int = 0,
        fault: Fault | None = None,
        echo: bool = False,
        seed: int = 0,
    ) -> None:
        self.clock = clock
        self.settings = settings
        self.full_duplex = full_duplex or settings is None
        self.granularity = granularity
        self.latency = latency
        self.fault = fault
        self.echo = echo
        self.character_time = 0 if settings is None else settings.character_time
        self.ports: tuple[SimulatedPort, ...] = ()
        self.transmissions = 0
        self.bytes_carried = 0
        self.connection = 0
        self._under_way: list[tuple[SimulatedPort, Transmission]] = []
        self._lag_on = clock if cut_through else None
        self._break: tuple[SimulatedPort | None, int, int] = (None, 0, 0)
        self._random = Random(seed)
        bits = 8 if settings is None else settings.data_bits
        self._lacking = bytes(range(256))[: 1 << bits] * (256 >> bits) if bits < 8 else None

    def port(self, name: str) -> SimulatedPort:
        """A new port on this line."""
        port = SimulatedPort(self, name)
        self.ports += (port,)
        return port

    # ---- sending ------------------------------------------------------------------------------------------

    def transmit(self, sender: SimulatedPort, data: bytes, start: int) -> int:
        """Puts characters on the line from `start` on; when the last of them will have left the sender (ns)."""
        if self._lacking is not None:
            data = data.translate(self._lacking)
        heard_from = max(start + self.latency, sender.heard_until)
        transmission = Transmission(
            sender.name, self.transmissions, data, heard_from, self.settings, self.character_time
        )
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
        return start + len(data) * self.character_time

    def _put(self, sender: SimulatedPort, transmission: Transmission) -> None:
        if self._lag_on is not None and not self._under_way:
            self._lag_on.lag(self)
        self._under_way.append((sender, transmission))
        for count in self._stops(transmission):
            self.clock.call_at(transmission.complete_at(count), partial(self._reached, sender, transmission, count))

    def _stops(self, transmission: Transmission) -> list[int]:
        """After how many characters it is told at the latest."""
        runs, step = transmission.runs(), self.granularity
        return runs if not step else sorted({*runs, *range(step, len(transmission.data), step)})

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
        """Damages characters that something else on the wire overlaps; half of them have no stop bit any more."""
        bits = transmission.wire_bits - 1
        for index in places:
            transmission.flip(index, self._random.randrange(1, 1 << bits) | self._random.randrange(2) << bits)

    # ---- hearing ------------------------------------------------------------------------------------------

    def behind(self, until: int) -> int | None:
        """See `Lagging`: when the first transmission with complete characters that nobody knows of can be told."""
        first: int | None = None
        for _, transmission in self._under_way:
            count = transmission.complete_by(until)
            if count > transmission.told:
                time = transmission.complete_at(count)
                first = time if first is None or time < first else first
        return first

    def catch_up(self, until: int) -> None:
        """See `Lagging`. Those who are further on tell of it when it is their turn."""
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
        if self._lag_on is not None and not self._under_way:
            self._lag_on.end_lag(self)

    def _tell(self, sender: SimulatedPort, transmission: Transmission, count: int) -> None:
        """Tells the others of the first `count` characters, as far as they do not know of them."""
        first = transmission.told
        if count <= first:
            return
        transmission.told = count
        data = bytes(transmission.data[first:count])
        faults: tuple[CharacterFault, ...] = ()
        if transmission.faults:
            flagged = sorted(index for index in transmission.faults if first <= index < count)
            faults = tuple(CharacterFault(index - first, transmission.faults[index]) for index in flagged)
        now, begin = transmission.complete_at(count), transmission.begins_at(first)
        for port in self.ports:
            if (port is not sender or transmission.echo) and port.connection == transmission.connection:
                port.hear(data, now, faults, begin)

    # ---- breaks, connections ------------------------------------------------------------------------------

    def break_from(self, sender: SimulatedPort, start: int, duration: int) -> None:
        """The line is held in break state from `start`, now; the others notice when that has lasted a character."""
        if self.settings is None:
            return
        begin = start + self.latency
        if not self.full_duplex:
            for other_sender, other in self._under_way:
                if other_sender is not sender:
                    self._garble(other, other.within(begin, begin + duration))
            self._break = sender, begin, begin + duration
        if duration > self.character_time:
            noticed = begin + self.character_time
            self.clock.call_at(noticed, lambda: self._tell_break(sender, noticed))

    def _tell_break(self, sender: SimulatedPort, now: int) -> None:
        for port in self.ports:
            if port is not sender or self.echo:
                port.hear_break(now)

    def cut_off(self, sender: SimulatedPort) -> None:
        """A port stops sending in the middle: of what is under way, only complete characters are heard.

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
        """A port is opened: at once on a line; on a stream, when there is another one to connect to."""
        if self.settings is not None:
            port.connect(self.connection)
            return
        there = [it for it in self.ports if it.wanted and (not it.joined or it.connection == self.connection)]
        if len(there) > 1:
            for it in there:
                if not it.joined:
                    it.connect(self.connection)

    def leave(self, port: SimulatedPort) -> None:
        """A port is closed. On a stream that ends the connection for all, behind what has been sent before."""
        if self.settings is not None or not port.joined or port.connection != self.connection:
            return
        self.connection += 1
        when = max(self.clock.now() + self.latency, port.heard_until)
        for other in self.ports:
            if other is not port and other.joined and other.connection == port.connection:
                other.lose_at(when)
