"""Pauses in a stream: the silence that ends things (`quiet`) and the longest pause inside a frame (`gap`).

What bytes themselves take on the line is no pause, so it does not matter in which pieces a port hands them over.
"""

from __future__ import annotations

from framekit.definition.expression.syntax import Expression
from framekit.definition.model.protocol import Receiver
from framekit.link.evaluate import EVALUATION_ERRORS, Evaluate, Names, compile_expression
from framekit.link.line_times import LineTimes
from framekit.link.scope import Scope
from framekit.link.stream import Stream

QUIET_CHARACTERS = 3
"""Silence that ends noise, and frames without another end, where a definition does not say `quiet`."""


GAP_CHARACTERS, GAP_TIME, GAP_ON_STREAM = 20, 50_000_000, 10_000_000_000
"""The longest pause inside a frame while no step limits its time and the definition has no `gap`.

Characters and time (ns) on a line. On a stream nothing is lost, and a slow network may part a frame anywhere.
"""


class Pauses:
    """Times (ns) are worked out anew when a variable or parameter has changed.

    `own_gap` false: `gap` is what the waiting step allows instead of the definition's (None: any pause). `is_idle`: no
    waiting step limits the time of a frame, so where the definition has no `gap` either, the usual one holds.
    `character`: what one takes on the line.
    """

    __slots__ = (
        "_gap_of", "_line", "_names", "_quiet_of", "_scope", "_stream", "_worked_out", "character", "gap", "is_idle",
        "own_gap",
    )  # fmt: skip

    def __init__(self, rules: Receiver, names: Names, stream: Stream) -> None:
        self._names = names
        self._stream = stream
        self._scope = scope_of(names)
        self._quiet_of = _maybe(rules.quiet)
        self._gap_of = _maybe(rules.gap)
        line = names.get("line")
        self._line = line if isinstance(line, LineTimes) else LineTimes(None)
        self.character = self._line.character
        self._worked_out: tuple[int, int, int | None] | None = None
        self.own_gap = True
        self.is_idle = False
        self.gap: int | None = None

    def limits(self) -> tuple[int, int | None]:
        """`quiet`, and the gap in force or None."""
        version = -1 if self._scope is None else self._scope.version
        found = self._worked_out
        if found is None or found[0] != version:
            quiet = self._time(self._quiet_of)
            if quiet is None:
                quiet = self._line.chars(QUIET_CHARACTERS)
            found = self._worked_out = (version, quiet, self._time(self._gap_of))
        if not self.own_gap:
            return found[1], self.gap
        return found[1], self._usual_gap() if self.is_idle and self._gap_of is None else found[2]

    def _usual_gap(self) -> int:
        """The longest pause in a frame that begins while nothing is waited for."""
        return self._line.chars(GAP_CHARACTERS) + GAP_TIME if self.character else GAP_ON_STREAM

    @property
    def defines_gap(self) -> bool:
        return self._gap_of is not None

    def _time(self, evaluate: Evaluate | None) -> int | None:
        """A time that cannot be worked out counts as not given."""
        try:
            return None if evaluate is None else int(evaluate(self._names))
        except EVALUATION_ERRORS:
            return None

    def note(self, last: int, count: int) -> None:
        """Marks a pause before the `count` bytes that came last; those before them came at `last`."""
        stream = self._stream
        pause = stream.last - last - self._line.chars(count)
        if pause <= 0:
            return
        quiet, gap = self.limits()
        place = stream.base + len(stream.buffer) - count
        if pause > quiet:
            stream.mark(stream.silences, place)
        if gap is not None and pause > gap:
            stream.mark(stream.pauses, place)

    def is_quiet(self, now: int) -> bool:
        """Whether nothing has come for `quiet`."""
        return now - self._stream.last >= self.limits()[0]

    def reach(self, now: int) -> tuple[int, bool]:
        """How far a frame that begins here can reach (buffer index), and whether a pause too long stands there."""
        stream = self._stream
        if stream.pauses:
            pause = stream.first_after(stream.pauses, stream.position)
            if pause is not None:
                return pause, True
        end = len(stream.buffer)
        if now == stream.last:
            return end, False
        gap = self.limits()[1]
        return end, gap is not None and now - stream.last >= gap

    def silence_behind(self, index: int, now: int) -> int | None:
        """The buffer index behind `index` where a silence stands, the present one included; None when there is none."""
        stream = self._stream
        found = stream.first_after(stream.silences, index)
        cut = stream.first_after(stream.pauses, index)
        if cut is not None and (found is None or cut < found):
            found = cut
        if found is None and self.is_quiet(now):
            return len(stream.buffer)
        return found


def scope_of(names: Names) -> Scope | None:
    """The protocol-level names that `names` end in."""
    found: Names | None = names
    while found is not None and not isinstance(found, Scope):
        found = found.parent
    return found


def _maybe(expression: Expression | None) -> Evaluate | None:
    return None if expression is None else compile_expression(expression)
