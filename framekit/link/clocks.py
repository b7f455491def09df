"""Time limits of a waiting run (language reference, section 7): `within`, `complete`, `gap`, and pauses.

A clock begins when the last bit of what the run sent has left. While a frame is arriving that fits so far, `within`
stands still; if it turns out to be none, the time it took is given back.
"""

from __future__ import annotations

from framekit.definition.times import NEVER
from framekit.link.runs import Run, State


def after(start: int, time: int) -> int:
    """`start` and `time` later; never stays never."""
    return start + time if time < NEVER else NEVER


def begin_clock(run: Run, now: int) -> None:
    """The run begins to wait, or its clock is set anew."""
    run.clock_waits = run.unsent > 0
    run.started = now
    if run.state is State.PAUSING:
        run.deadline = NEVER if run.clock_waits else after(now, run.pause)
        return
    step, names = run.stack[-1].step, run.stack[-1].names
    run.complete = None if step.complete is None else int(step.complete(names))
    run.gap = None if step.gap is None else int(step.gap(names))
    run.longest = NEVER if step.within is None else int(step.within(names))
    run.within = NEVER if run.clock_waits else after(now, run.longest)
    if run.candidate is None:
        run.deadline = run.within


def frame_arriving(run: Run, since: int, last: int, receiver_limits: bool) -> None:
    """Bytes of a frame that fits so far: the first came at `since`, the last at `last`.

    Where neither step nor receiver limits a pause, nor the step the whole, no pause may be longer than `within`.
    """
    if run.candidate is None:
        run.candidate = max(since, run.started)
    gap = run.gap
    if gap is None and run.complete is None and not receiver_limits:
        gap = run.longest
    deadline = NEVER if gap is None else after(last, gap)
    if run.complete is not None:
        deadline = min(deadline, after(run.candidate, run.complete))
    run.deadline = deadline


def frame_gone(run: Run, now: int) -> None:
    """It was no frame for this run after all."""
    if run.candidate is not None:
        if run.within < NEVER:
            run.within += now - run.candidate
        run.candidate = None
        run.deadline = run.within
