"""Who gets what happens: frames, bad frames, noise, queue items, a break, a lost connection.

Lanes are asked in the order written, in a lane the older exchange first; the first row that fits takes a frame.
Language reference, section 8.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from framekit.codec.shown import explain
from framekit.link.arrivals import BadFrame
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.lanes import Lanes
from framekit.link.machine import Machine
from framekit.link.program import CompiledRow, rows_naming
from framekit.link.runs import Activation, Run, State
from framekit.link.values import FrameValue


class Dispatcher:
    """Offers what happens to the runs of all lanes."""

    def __init__(self, machine: Machine, lanes: Lanes) -> None:
        self.machine = machine
        self.lanes = lanes

    def _receiving(self) -> Iterator[Run]:
        return (run for run in self.lanes.order if run.state is State.RECEIVING)

    # ---- frames -------------------------------------------------------------------------------------------

    def offer(self, value: FrameValue, raw: bytes) -> bool:
        """Offers a good frame to the rows of those who wait. Tells whether one took it."""
        for run in self._receiving():
            found = self._row_for(run, value)
            if found is not None:
                activation, row = found
                dealing = activation.dealing
                dealing.raw = raw
                if not dealing.checks_echo:
                    dealing.last_taken = value
                run.cause = ""
                self._do(run, activation, row)
                return True
        return False

    def _row_for(self, run: Run, value: FrameValue) -> tuple[Activation, CompiledRow] | None:
        """The first row that takes the frame: of the step, then `always` rows, its own and its callers'."""
        if value.frame not in run.interest:
            return None
        top = run.stack[-1]
        if not self._repeats_request(top, value):
            return None
        row = self._fitting(top, top.step.matching(value.frame, top.dealing.expected), value)
        if row is not None:
            return top, row
        for activation in reversed(run.stack):
            always = activation.sequence.always
            if always:
                row = self._fitting(activation, rows_naming(always, value.frame, activation.dealing.expected), value)
                if row is not None:
                    return activation, row
        return None

    def _repeats_request(self, activation: Activation, value: FrameValue) -> bool:
        dealing = activation.dealing
        if not dealing.checks_echo:
            return True
        return self.machine.table.fits_echo(value, dealing.echo_sources(), activation.names)

    def _fitting(self, activation: Activation, rows: tuple[CompiledRow, ...], it: Any) -> CompiledRow | None:
        names = activation.names
        before = names["it"]
        names["it"] = it
        for row in rows:
            if row.when is None or self._holds(activation, row):
                return row
        names["it"] = before
        return None

    def _holds(self, activation: Activation, row: CompiledRow) -> bool:
        """A condition that cannot be worked out for this frame does not hold; that is shown."""
        assert row.when is not None
        try:
            return bool(row.when(activation.names))
        except EVALUATION_ERRORS as error:
            step = activation.step.name
            self.machine.show("trouble", reason=f"step {step}, condition of a row: {explain(error)}")
            return False

    def offer_other(self, value: FrameValue) -> bool:
        """A good frame that no row takes goes to the first who says what to do with such frames."""
        return any(self._handle(run, "on_other", it=value) for run in self._receiving())

    def bad(self, bad: BadFrame) -> bool:
        """A bad frame goes to the lane whose rows name it, else to the first with a handler. False: to none."""
        receiving = list(self._receiving())
        for run in receiving:
            if bad.frame in run.interest:
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
        """Rows that wait for an item or for room. Tells whether one was taken."""
        queues = self.machine.queues
        for run in self._receiving():
            activation = run.stack[-1]
            for row in activation.step.queue_rows:
                if row.queue is not None and not queues.empty(row.queue):
                    if self._fitting(activation, (row,), queues.first(row.queue)) is not None:
                        queues.take(row.queue)
                        self._do(run, activation, row)
                        return True
                elif row.room is not None and not queues.full(row.room) and self._fits_room(activation, row):
                    self._do(run, activation, row)
                    return True
        return False

    def _fits_room(self, activation: Activation, row: CompiledRow) -> bool:
        return row.when is None or self._holds(activation, row)

    # ---- the line -----------------------------------------------------------------------------------------

    def byte(self) -> None:
        """Something came: pauses that any byte ends."""
        for run in self.lanes.order:
            if run.state is State.PAUSING and run.has_handler("on_byte"):
                self._handle(run, "on_byte")

    def line_break(self) -> None:
        for run in self.lanes.order:
            if run.state is not State.DONE:
                self._handle(run, "on_break")

    def closed(self, reason: str) -> None:
        """Whoever does not say what to do without a connection fails."""
        for run in self.lanes.order:
            if run.state is not State.DONE:
                run.cause = reason
                if not self._handle(run, "on_closed"):
                    self.machine.fail_run(run, "closed")

    # ---- doing --------------------------------------------------------------------------------------------

    def _do(self, run: Run, activation: Activation, row: CompiledRow) -> None:
        machine = self.machine
        asked, run.asked = run.asked, None
        if asked is not None and machine.late.until:
            machine.late.extend(asked.names, run.started, run.longest)
        number = run.wait_number
        machine.guarded(run, machine.take, activation, row, "next")
        if run.wait_number == number and run.state is State.RECEIVING:
            run.asked = asked

    def _handle(self, run: Run, event: str, **names: Any) -> bool:
        """Lets a run handle an event; whatever follows is done. Tells whether it has a handler that applies."""
        machine = self.machine
        return bool(machine.guarded(run, machine.handle, event, "", names)) or run.state is State.DONE
