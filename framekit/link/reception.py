"""From bytes to the runs that wait: which frames are looked for now, and which run gets what the receiver finds.

Lanes are asked in the order written, in a lane the older exchange first; the first row that fits takes a frame
(guide: roles). Queue items, a break and a lost connection go the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from framekit.definition.times import NEVER
from framekit.link.arrivals import BadFrame, FrameArrived, Noise, ToldBytes
from framekit.link.events import LinkCounters, Reopen
from framekit.link.lanes import Lanes
from framekit.link.receiver import Receiver
from framekit.link.sequences.runtime import Machine
from framekit.link.sequences.state import NOT_TAKEN, CallFrame, Run, State, frame_arriving, frame_gone
from framekit.link.values import FrameValue

OnFrame = Callable[[FrameValue], None]

LATE = "late: the reply to a request that is over"

MOST_HELD = 262_144
"""So many bytes are kept for runs that will wait later but do not wait yet."""

MOST_KNOWN = 1024
"""For so many combinations of steps that wait the expected frames are kept ready."""


class Dispatcher:
    """Offers what happens to the runs of all lanes."""

    def __init__(self, machine: Machine, lanes: Lanes) -> None:
        self.machine = machine
        self.lanes = lanes

    def _receiving(self) -> Iterator[Run]:
        return (run for run in self.lanes.order if run.state is State.RECEIVING)

    # ---- frames -------------------------------------------------------------------------------------------

    def offer(self, value: FrameValue) -> bool:
        """Offers a good frame to the rows of the runs that wait. Tells whether one took it."""
        name, machine = value.frame, self.machine
        for run in self.lanes.order:
            if run.state is not State.RECEIVING or name not in run.expected:
                continue
            top = run.top
            context = top.d
            if context.checks_echo:
                asked, sent = context.asked, context.last_sent
                sources = () if sent is None else (sent,)
                if not machine.table.fits_echo(value, sources if asked is None else (asked, *sources), top.names):
                    continue
            rows, due, number = run.rows.get(name), run.asked, run.wait_number
            if rows is not None and machine.go(run, rows, top, value) is not NOT_TAKEN:
                if due is not None and run.wait_number == number and run.state is State.RECEIVING:
                    run.asked = due  # the run waits on as before: the reply is still due
                return True
            for frame in run.calls() if run.has_always else ():
                always = frame.step.always
                rows = None if always is None else always.of(frame.d.expected)[0].get(name)
                if rows is not None and self._taken(run, rows, frame, value):
                    return True
        return False

    def _taken(self, run: Run, rows: Any, frame: CallFrame, it: Any) -> bool:
        """Lets rows do what they say. While the run waits on as before, the reply it has asked for is still due."""
        asked, number = run.asked, run.wait_number
        if self.machine.go(run, rows, frame, it) is NOT_TAKEN:
            return False
        if asked is not None and run.wait_number == number and run.state is State.RECEIVING:
            run.asked = asked
        return True

    def offer_other(self, value: FrameValue) -> bool:
        """A good frame that no row takes goes to the first that says what to do with such frames."""
        return any(self._handle(run, "on_other", it=value) for run in self._receiving())

    def bad(self, bad: BadFrame) -> bool:
        """A bad frame goes to the lane whose rows name it, else to the first with a handler. False: to none."""
        receiving = list(self._receiving())
        for run in receiving:
            if bad.frame in run.expected:
                run.cause = f"{bad.frame}: {bad.cause}"
                self._handle(run, "on_bad", cause=bad.cause, frame=bad.frame)
                return True
        for run in receiving:
            run.cause = f"{bad.frame}: {bad.cause}"
            if self._handle(run, "on_bad", cause=bad.cause, frame=bad.frame):
                return True
        return False

    def noise(self) -> None:
        """Noise goes to the first lane that says what to do with it."""
        any(self._handle(run, "on_noise") for run in self._receiving())

    # ---- queues -------------------------------------------------------------------------------------------

    def queue_rows(self) -> bool:
        """Rows that wait for an item or for room. Tells whether one was taken; one that was not is asked again."""
        queues = self.machine.queues
        queues.is_due = False
        for run in self.lanes.order:
            if run.state is not State.RECEIVING:
                continue
            frame = run.top
            for queue, room, row in frame.step.queue_rows:
                if queue is not None:
                    items = queues.items[queue]
                    if items:
                        queues.is_due = True
                        if self._taken(run, row, frame, items[0]):
                            return True
                elif room is not None and not queues.full(room):
                    queues.is_due = True
                    if self._taken(run, row, frame, None):
                        return True
        return False

    # ---- the line -----------------------------------------------------------------------------------------

    def byte(self) -> None:
        """Something came: pauses that any byte ends."""
        for run in self.lanes.order:
            if run.state is State.PAUSING and "on_byte" in run.top.step.handlers:
                self._handle(run, "on_byte")

    def line_break(self) -> None:
        for run in self.lanes.order:
            if run.state is not State.DONE:
                self._handle(run, "on_break")

    def closed(self, reason: str) -> None:
        """A run that does not say what to do without a connection fails."""
        for run in self.lanes.order:
            if run.state is not State.DONE:
                run.cause = reason
                if not self._handle(run, "on_closed"):
                    self.machine.fail_run(run, "closed")

    def _handle(self, run: Run, event: str, **names: Any) -> bool:
        """Lets a run handle an event; what follows is done. Tells whether it has a handler that applies.

        A break and a lost connection are also for the callers, innermost first.
        """
        for frame in run.calls():
            handler = frame.step.handlers.get(event)
            if handler is not None:
                for name, value in names.items():
                    setattr(frame, name, value)
                return self.machine.go(run, handler, frame) is not NOT_TAKEN or run.state is State.DONE
            if event not in ("on_break", "on_closed"):
                break
        return False


class Reception:
    """`expected` are the names of frames expected and of others; None while the runs that will wait do not wait yet.

    `awaited`: frames that come by themselves, and that `on_frame` wants whenever they do. `on_bad` gets bad frames no
    step waited for. `cutting`: frames are being broken off because a time limit has run out; they are shown, and
    nothing more.
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
        self.awaited: frozenset[str] = frozenset()
        self.on_bad: Callable[[BadFrame], None] | None = None
        self.cutting = False
        self._told = ToldBytes()
        replies = self.machine.late.expected.frames  # first, for the bytes of one may be those of a request too
        self._all = tuple(sorted(receiver.table.on_line, key=lambda name: name not in replies))
        self.expected: tuple[tuple[str, ...], tuple[str, ...]] | None = (self._all, ())
        infos = receiver.table.infos.values()
        self._announcing = frozenset(info.name for info in infos if info.announces)
        self._known: dict[tuple[Any, ...], tuple[tuple[str, ...], tuple[str, ...]] | None] = {}
        self._waiting: list[Any] = []
        self._own_gap = True
        self.machine.has_bytes = lambda: not receiver.is_empty
        self.machine.stream_place = lambda: receiver.stream.offset
        self.machine.drop_stale = self.drop_stale
        self.machine.count_bad = self._count_bad

    def await_frames(self, names: Iterable[str]) -> None:
        """From now on these frames are wanted whenever they come, whatever else is under way."""
        self.awaited = frozenset(names)
        self.machine.awaits_frames = bool(self.awaited)
        self._known.clear()
        self._waiting, self.machine.changed = [], True

    def next_arrival(self) -> bool:
        """Handles the next thing in the bytes at hand, where there are some. False: nothing comes of them yet."""
        if self.machine.changed:
            self._work_out_expected()
        if self.expected is None:
            if len(self.receiver.stream.buffer) > MOST_HELD:
                self.drop_stale()
            return False
        receiver = self.receiver
        event = receiver.next(*self.expected)
        if event is None:
            waiting = receiver.waiting
            is_wanted = not waiting
            for run in self.lanes.order:
                if run.state is State.RECEIVING and (waiting or run.candidate is not None):
                    is_wanted |= self._note_progress(run, waiting)
            receiver.pauses.own_gap = self._own_gap or not is_wanted  # no step limits the pauses of other frames
            return False
        if isinstance(event, FrameArrived):
            self._frame(event)
        elif isinstance(event, BadFrame):
            self._bad(event)
        else:
            self.show_noise([event])
            if not event.skipped:
                self.dispatcher.noise()
        if receiver.broken:
            self.machine.output.commands.append(Reopen("the stream is out of step"))
        return True

    def _work_out_expected(self) -> None:
        """Which frames are looked for now, worked out once for the steps that wait."""
        self.machine.changed = False
        own_gap = is_limited = False
        waiting: list[Any] = [not self.lanes.order]
        for run in self.lanes.order:
            if run.state is State.RECEIVING:
                top = run.top
                waiting += (top.step, run.expected if run.has_always else top.d.expected)
                own_gap = own_gap or run.gap is not None
                is_limited = is_limited or run.complete is not None or run.longest < NEVER
            elif run.state is State.HELD:
                waiting.append(State.HELD)
        pauses, self._own_gap = self.receiver.pauses, not own_gap
        pauses.own_gap, pauses.is_idle = self._own_gap, not is_limited
        if waiting == self._waiting:
            return
        self._waiting, steps = waiting, tuple(waiting)
        if steps not in self._known:
            if len(self._known) >= MOST_KNOWN:
                self._known.clear()
            self._known[steps] = self._expected_now()
        self.expected = self._known[steps]

    def _expected_now(self) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
        """The frames of the rows that wait, and the others; None while the runs that will wait do not yet."""
        names: dict[str, None] = {}
        looks = others = held = False
        for run in self.lanes.order:
            if run.state is State.HELD:
                held = looks = others = True
            elif run.state is State.RECEIVING:
                looks = looks or bool(run.expected) or run.wants_others or "on_noise" in run.top.step.handlers
                names.update(dict.fromkeys(run.expected))
                others = others or run.wants_others
        if not self.lanes.order or (held and not names):
            return self._all, ()
        if not looks:
            return None
        expected = tuple(names)
        return expected, tuple(name for name in self._all if name not in names and (others or name in self.awaited))

    def _note_progress(self, run: Run, waiting: tuple[str, ...]) -> bool:
        """The clock of a run for which a frame is arriving, or turned out not to be; whether one is."""
        receiver = self.receiver
        is_arriving = any(name in run.expected for name in waiting)
        if is_arriving:
            limited = receiver.pauses.defines_gap and receiver.pauses.own_gap
            frame_arriving(run, receiver.waiting_since, receiver.stream.last, limited)
        else:
            frame_gone(run, self.machine.scope.now)
        return is_arriving

    # ---- arrivals -----------------------------------------------------------------------------------------

    def _frame(self, event: FrameArrived) -> None:
        machine, value = self.machine, event.value
        self.counters.received += 1
        machine.last_frame = machine.scope.now
        if machine.monitor is not None:
            machine.show_received(value, event.raw, event.times[0])
        late = machine.late
        if late.lost and late.was_kept(value.frame, self.receiver.is_followed_by(late.expected.frames)):
            self.unsolicited(value, True)
            return
        reading: FrameArrived | None = event
        while reading is not None:
            value = reading.value
            if value.frame in self._announcing:
                self.machine.accept(value)
            if self.dispatcher.offer(value):
                return
            reading = self.receiver.other_reading()
        is_awaited = event.value.frame in self.awaited
        was_due = late.came(event.value.frame, is_awaited)
        is_late = was_due and not late.by_itself
        is_taken = not is_late and bool(self.lanes.order) and self.dispatcher.offer_other(event.value)
        if is_awaited and not is_late:
            self._hand_over(event.value)
        elif not is_taken:
            self.unsolicited(event.value, is_late)
        if was_due and not late.until:
            self.lanes.release()

    def unsolicited(self, value: FrameValue, is_late: bool = False) -> None:
        """A good frame that was not taken. A late reply is no frame that came by itself."""
        self.counters.not_taken += 1
        self.counters.late += is_late
        if is_late or self.lanes.order:
            self.machine.show("not_taken", "in", value.raw or b"", value.frame, reason=LATE if is_late else "")
        if not is_late:
            self._hand_over(value)

    def _hand_over(self, value: FrameValue) -> None:
        """Gives a frame that came by itself to who wants such frames."""
        if self.on_frame is not None:
            on_frame = self.on_frame
            self.machine.callbacks.append(lambda: on_frame(value))

    def _count_bad(self) -> None:
        self.counters.bad += 1

    def _bad(self, bad: BadFrame) -> None:
        self._told.bad(bad)
        self._count_bad()
        if self.machine.is_watched:  # to find out what is wrong takes work
            self.machine.show(
                "bad", "in", bad.raw, bad.frame,
                reason=bad.cause, started_at=bad.started_at, segment=bad.segment, place=bad.place,
            )  # fmt: skip
        on_bad = self.on_bad
        if not self.cutting and not self.dispatcher.bad(bad) and on_bad is not None:
            self.machine.callbacks.append(lambda: on_bad(bad))

    def flush(self) -> None:
        """Drops what has come and is no frame yet; but frames that are wanted whenever they come are taken first."""
        names = tuple(name for name in self._all if name in self.awaited)
        cutting, self.cutting = self.cutting, True  # a step is under way: bad frames are shown, and nothing more
        while names and (event := self.receiver.next((), names)) is not None:
            if isinstance(event, FrameArrived):
                self._note_good(event)
                self._hand_over(event.value)
            elif isinstance(event, BadFrame):
                self._bad(event)
            else:
                self.show_noise([event])
        self.cutting = cutting
        self.show_noise(self.receiver.flush())

    def _note_good(self, event: FrameArrived) -> None:
        """Counts and shows a frame; `_frame` has these lines itself, for every reply passes there."""
        machine = self.machine
        self.counters.received += 1
        machine.last_frame = machine.scope.now
        if machine.monitor is not None:
            machine.show_received(event.value, event.raw, event.times[0])

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
        receiver = self.receiver
        if receiver.stream.is_marked or not (self.machine.is_idle or receiver.is_idle):
            self.show_noise(receiver.flush())
