"""The reception of an engine: the frames to look for in the arriving bytes, and the bytes that become no good frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from framekit.definition.times import NEVER
from framekit.link.arrivals import BadFrame, FrameArrived, Noise, ReportedBytes
from framekit.link.candidates import ExpectedFrames
from framekit.link.sequences.runtime import Machine
from framekit.link.sequences.state import Plan, Run, State, frame_arriving, frame_gone
from framekit.link.values import FrameValue

RECEIVING, HELD, SILENT = State.RECEIVING, State.HELD, State.SILENT

OnFrame = Callable[[FrameValue], None]

MOST_KNOWN = 1024
"""For so many combinations of waiting steps the expected frames are kept."""


class Reception:
    """The use of a machine's receiver. `on_frame` gets good frames that no step waited for."""

    def __init__(self, machine: Machine, on_frame: OnFrame | None) -> None:
        self.machine = machine
        self.receiver = receiver = machine.receiver
        self.on_frame = on_frame
        self.awaited: frozenset[str] = frozenset()
        """Frames that are wanted at any time."""
        self.has_candidates = False
        """Whether a frame has begun to arrive for a waiting run since the receiver was without bytes."""
        self.cutting = False
        """Whether frames are broken off, because a time limit has run out or by a break; they are only shown."""
        self._reported = ReportedBytes()
        expected = machine.late.expected
        replies = expected.frames | expected.numbered  # first: the bytes of a reply may fit a request too
        self._all = tuple(sorted(machine.table.on_line, key=lambda name: name not in replies))
        self.looked: ExpectedFrames | None = receiver.expect(self._all)
        """The frames that the receiver looks for; None: none."""
        self.plan: Plan | None = None
        """The plan of the only run, if `looked` belongs to this plan."""
        self._known: dict[Any, ExpectedFrames | None] = {}
        self._limited: list[tuple[Run, State, int]] | None = None
        self.own_gap = True
        """Whether the receiver limits the pauses inside frames, as no waiting step does."""
        receiver.on_scan = self._limit_pauses
        machine.flush = self.flush

    # ---- the frames to look for ---------------------------------------------------------------------------

    def await_frames(self, names: Iterable[str]) -> None:
        """Want these frames at any time from now on, in addition to the frames of waiting steps."""
        self.awaited = frozenset(names)
        self._known.clear()
        self.plan = None

    def look_for(self) -> None:
        """Select the frames to look for: worked out once for each combination of waiting steps."""
        order, self.plan = self.machine.order, None
        key: Any = () if self.machine.live else None
        for run in order:
            if run.state is RECEIVING:
                key = run.plan if key == () else (key, run.plan)
            elif run.state is HELD or run.state is SILENT:
                key = (key, HELD)
        if len(order) == 1 and type(key) is Plan:
            self.plan = key
        found = self._known.get(key, key)
        if found is key:
            if len(self._known) >= MOST_KNOWN:
                self._known.clear()
            found = self._known[key] = self._looked_now()
        self.looked = found

    def _looked_now(self) -> ExpectedFrames | None:
        """Return the frames of the waiting rows, and the others; None while runs that will wait do not wait yet."""
        names: dict[str, None] = {}
        looks = others = held = False
        for run in self.machine.order:
            if run.state is HELD or run.state is SILENT:
                held = looks = others = True
            elif run.state is RECEIVING and run.plan is not None:
                looks = looks or run.plan.looks
                names.update(run.plan.frames)
                others = others or run.plan.others
        if not self.machine.live or (held and not names):
            return self.receiver.expect(self._all)
        if not looks:
            return None
        rest = tuple(name for name in self._all if name not in names and (others or name in self.awaited))
        return self.receiver.expect(tuple(names), rest)

    def _limit_pauses(self) -> None:
        """Set, once for each wait, whether the waiting steps limit pauses themselves."""
        waits = [(run, run.state, run.wait_number) for run in self.machine.order]
        if waits == self._limited:
            return
        self._limited = waits
        own_gap = is_limited = False
        for run in self.machine.order:
            if run.state is RECEIVING:
                own_gap = own_gap or run.gap is not None
                is_limited = is_limited or run.complete is not None or run.longest < NEVER
        pauses, self.own_gap = self.receiver.pauses, not own_gap
        pauses.own_gap, pauses.is_unlimited = self.own_gap, not is_limited

    # ---- arriving frames ----------------------------------------------------------------------------------

    def note_progress(self) -> None:
        """Set the clocks of the waiting runs while no frame is complete: a frame is arriving for them, or none is."""
        receiver, waiting = self.receiver, self.receiver.waiting
        is_wanted = not waiting
        for run in self.machine.order:
            if run.state is RECEIVING and (waiting or run.candidate is not None):
                is_wanted |= self._note_progress(run, waiting)
        receiver.pauses.own_gap = self.own_gap or not is_wanted  # no step limits the pauses of other frames

    def _note_progress(self, run: Run, waiting: tuple[str, ...]) -> bool:
        """Set the clock of a run by whether a frame is arriving for it, and return that."""
        receiver = self.receiver
        is_arriving = any(name in run.expected for name in waiting)
        if is_arriving:
            self.has_candidates = True
            limited = receiver.pauses.defines_gap and receiver.pauses.own_gap
            frame_arriving(run, receiver.waiting_since, receiver.stream.last, limited)
        else:
            frame_gone(run, self.machine.scope.now)
        return is_arriving

    def drop_candidates(self) -> None:
        """Give waiting runs the time back that a frame took which turned out to be for another run, or no frame."""
        self.has_candidates = False
        for run in self.machine.order:
            if run.candidate is not None and run.state is RECEIVING:
                frame_gone(run, self.machine.scope.now)

    def hand_over(self, value: FrameValue) -> None:
        """Give a frame that came by itself to `on_frame`."""
        if self.on_frame is not None:
            self.machine.ready.append(partial(self.on_frame, value))

    # ---- bytes that become no good frame ------------------------------------------------------------------

    def note_bad(self, bad: BadFrame) -> None:
        """Count and show a bad frame."""
        machine = self.machine
        self._reported.bad(bad)
        machine.counters.bad += 1
        machine.late.noisy = machine.scope.now
        if machine.is_watched:  # finding the cause takes work
            machine.show(
                "bad", "in", bad.raw, bad.frame,
                reason=bad.cause, started_at=bad.started_at, segment=bad.segment, place=bad.place,
            )  # fmt: skip

    def show_noise(self, found: Iterable[Noise]) -> None:
        """Count and show noise, each byte once."""
        machine = self.machine
        for noise in found:
            count = self._reported.new_bytes(noise)
            if not count:
                continue
            machine.counters.noise_bytes += count
            machine.late.noisy = machine.scope.now
            reason = "what a bad frame left" if noise.skipped else ""
            machine.show("noise", "in", noise.data[-count:], started_at=noise.started_at, reason=reason)

    def flush(self) -> None:
        """Drop bytes that are no frame yet; frames that are wanted at any time are taken first."""
        machine = self.machine
        names = tuple(name for name in self._all if name in self.awaited)
        while names and (event := self.receiver.next((), names)) is not None:
            if isinstance(event, FrameArrived):
                machine.counters.received += 1
                machine.last_frame = machine.scope.now
                if machine.monitor is not None:
                    machine.show_received(event.value, event.raw, event.times[0])
                self.hand_over(event.value)
            elif isinstance(event, BadFrame):
                self.note_bad(event)
            else:
                self.show_noise([event])
        self.drop()

    def drop(self) -> None:
        """Drop the beginning of a frame as noise; no frame is arriving for a run any more."""
        had_unread = self.receiver.has_unread
        self.show_noise(self.receiver.flush())
        if had_unread:
            self.note_progress()

    def drop_stale(self) -> None:
        """Drop bytes that came while no run listened: they cannot be the reply to a later request."""
        if self.receiver.stream.is_marked or self.receiver.has_unread:
            self.drop()
