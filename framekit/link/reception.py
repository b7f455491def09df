"""From bytes to those who wait: which frames are looked for now, and what is done with what the receiver finds.

It knows who waits in which lane, but not what steps are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from framekit.codec.shown import explain
from framekit.definition.times import NEVER
from framekit.link.arrivals import Arrival, BadFrame, FrameArrived, Noise, ToldBytes
from framekit.link.clocks import frame_arriving, frame_gone
from framekit.link.counters import LinkCounters
from framekit.link.dispatch import Dispatcher
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.events import Reopen
from framekit.link.receiver import Receiver
from framekit.link.runs import State
from framekit.link.values import FrameValue

OnFrame = Callable[[FrameValue], None]

LATE = "late: the reply to a request that is over"

MOST_HELD = 262_144
"""So many bytes are kept for those who will wait later but do not wait yet."""


class Reception:
    """`interest` are the names of frames expected and of others; None while those who will wait do not wait yet.

    `on_bad` gets bad frames no step waited for. `cutting`: frames are being broken off because a time limit has run
    out; they are shown, and nothing more.
    """

    def __init__(
        self, receiver: Receiver, dispatcher: Dispatcher, counters: LinkCounters, on_frame: OnFrame | None
    ) -> None:
        self.receiver = receiver
        self.dispatcher = dispatcher
        self.machine = dispatcher.machine
        self.lanes = dispatcher.lanes
        self.counters = counters
        self.on_frame = on_frame
        self.on_bad: Callable[[BadFrame], None] | None = None
        self.cutting = False
        self._told = ToldBytes()
        replies = self.machine.late.replies  # first, for the bytes of one may be those of a request too
        self._all = tuple(sorted(receiver.table.on_line, key=lambda name: name not in replies))
        self.interest: tuple[tuple[str, ...], tuple[str, ...]] | None = (self._all, ())
        self._others: dict[tuple[str, ...], tuple[str, ...]] = {}
        self.machine.has_bytes = lambda: not receiver.is_empty
        self.machine.stream_place = lambda: receiver.stream.offset
        self.machine.drop_stale = self.drop_stale

    def next_arrival(self) -> bool:
        """Handles the next thing in the bytes at hand. False: there is none, or nobody looks."""
        if self.machine.changed:
            self._work_out_interest()
        if self.interest is None:
            if len(self.receiver.stream.buffer) > MOST_HELD:
                self.drop_stale()
            return False
        event = self.receiver.next(*self.interest)
        if event is None:
            self._note_progress()
            return False
        self._arrived(event)
        return True

    def _work_out_interest(self) -> None:
        """Which frames are looked for now; None while those who will wait do not yet."""
        self.machine.changed = False
        names: dict[str, None] = {}
        others = looks = own_gap = is_limited = held = False
        for run in self.lanes.order:
            if run.state is State.HELD:
                held = looks = others = True
            elif run.state is State.RECEIVING:
                looks = looks or bool(run.interest) or run.wants_others or run.has_handler("on_noise")
                names.update(dict.fromkeys(run.interest))
                others = others or run.wants_others
                own_gap = own_gap or run.gap is not None
                is_limited = is_limited or run.complete is not None or run.longest < NEVER
        if not self.lanes.order or (held and not names):
            self.interest = (self._all, ())
        elif not looks:
            self.interest = None
        else:
            self.interest = self._pair(tuple(names), others)
        self.receiver.pauses.own_gap = not own_gap
        self.receiver.pauses.is_idle = not is_limited

    def _pair(self, expected: tuple[str, ...], others: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The same pair of tuples for the same names, so that the receiver knows them again at once."""
        known = self.interest
        if known is not None and known[0] == expected:
            expected = known[0]
        if not others:
            return expected, ()
        rest = self._others.get(expected)
        if rest is None:
            rest = self._others[expected] = tuple(name for name in self._all if name not in expected)
        return expected, rest

    def _note_progress(self) -> None:
        """Clocks of those for whom a frame is arriving, or turned out not to be."""
        waiting, receiver = self.receiver.waiting, self.receiver
        for run in self.lanes.order:
            if run.state is State.RECEIVING and (waiting or run.candidate is not None):
                if any(name in run.interest for name in waiting):
                    limited = receiver.pauses.defines_gap and receiver.pauses.own_gap
                    frame_arriving(run, receiver.waiting_since, receiver.stream.last, limited)
                else:
                    frame_gone(run, self.machine.scope.now)

    # ---- arrivals -----------------------------------------------------------------------------------------

    def _arrived(self, event: Arrival) -> None:
        if isinstance(event, FrameArrived):
            self._frame(event)
        elif isinstance(event, BadFrame):
            self._bad(event)
        else:
            self.show_noise([event])
            if not event.skipped:
                self.dispatcher.noise()
        if self.receiver.broken:
            self.machine.output.commands.append(Reopen("the stream is out of step"))

    def _frame(self, event: FrameArrived) -> None:
        reading: FrameArrived | None = event
        self.counters.received += 1
        self.machine.show_received(event.value, event.raw, event.started_at)
        late = self.machine.late
        if late.lost and late.was_kept(event.value.frame, self.receiver.is_followed_by(late.replies)):
            self.unsolicited(event.value, True)
            return
        while reading is not None:
            self._announce(reading.value)
            if self.dispatcher.offer(reading.value, reading.raw):
                return
            reading = self.receiver.other_reading()
        is_late = late.came(event.value.frame)
        if is_late or not self.lanes.order or not self.dispatcher.offer_other(event.value):
            self.unsolicited(event.value, is_late)
        if is_late and not late.until:
            self.lanes.release()

    def _announce(self, value: FrameValue) -> None:
        try:
            self.machine.announce(value)
        except EVALUATION_ERRORS as error:
            self.machine.show("trouble", frame=value.frame, reason=explain(error))

    def unsolicited(self, value: FrameValue, is_late: bool = False) -> None:
        """A good frame that was not taken. A late reply is no frame that came by itself."""
        self.counters.not_taken += 1
        self.counters.late += is_late
        if is_late or self.lanes.order:
            self.machine.show("not_taken", "in", value.raw or b"", value.frame, reason=LATE if is_late else "")
        if self.on_frame is not None and not is_late:
            on_frame = self.on_frame
            self.machine.callbacks.append(lambda: on_frame(value))

    def _bad(self, bad: BadFrame) -> None:
        self._told.bad(bad)
        self.counters.bad += 1
        self.machine.show(
            "bad", "in", bad.raw, bad.frame,
            reason=bad.cause, started_at=bad.started_at, segment=bad.segment, place=bad.place,
        )  # fmt: skip
        on_bad = self.on_bad
        if not self.cutting and not self.dispatcher.bad(bad) and on_bad is not None:
            self.machine.callbacks.append(lambda: on_bad(bad))

    def show_noise(self, found: Iterable[Noise]) -> None:
        for noise in found:
            count = self._told.new_bytes(noise)
            if not count:
                continue
            self.counters.noise_bytes += count
            reason = "what a bad frame left" if noise.skipped else ""
            self.machine.show("noise", "in", noise.data[-count:], started_at=noise.started_at, reason=reason)

    def drop_stale(self) -> None:
        """An exchange begins and nothing listened: what came before cannot be its reply."""
        self.show_noise(self.receiver.flush())
