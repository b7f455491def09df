"""Lanes of a role: exchanges that wait for their turn, those that run, and what listens when none does.

With them what opens and closes sessions, and the replies for which other requests wait.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from framekit.definition.model.procedure import Lane
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER
from framekit.link.events import Exchange, Outcome, Reopen
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope
from framekit.link.sequences.runtime import Runs
from framekit.link.sequences.state import LaneState, Run, State

HOLD = 100_000_000
"""A listener that goes round in circles is started again after this (ns)."""

STALE = 1_000_000_000
"""Incomplete bytes that are this old (ns) when an exchange begins do not belong to it."""


class Lanes(Runs):
    """Runs by their lanes. `order`: in which arriving frames are offered to them. `lane_of`: the lane that runs
    exchanges of a sequence; None: the first that runs any. `on_shut`: the callback for the end of the session, until it
    is called.
    """

    awaited: frozenset[str]
    receiver: Receiver
    is_idle: bool
    _keeps_times: bool

    def __init__(
        self, protocol: Protocol, scope: Scope, program: Any, lanes: tuple[Lane, ...], is_stream: bool
    ) -> None:
        super().__init__(protocol, scope, program, is_stream)
        self.lanes = [LaneState(lane) for lane in lanes]
        self.was_closed = False
        self.live = 0
        """How many runs are under way; those that are over may stand in the order until others take their place."""
        self.is_holding = False
        self.on_shut: Callable[[], None] | None = None
        self.lane_of: dict[str | None, LaneState] = {}
        for lane in self.lanes:
            for name in (None, *lane.exchange) if lane.exchange else ():
                self.lane_of.setdefault(name, lane)

    def drop_stale(self) -> None:
        """Drop bytes that came before an exchange while no run listened: they cannot be its reply."""
        raise NotImplementedError

    # ---- starting -----------------------------------------------------------------------------------------

    def fill(self, lane: LaneState) -> None:
        """Starts exchanges whose turn it is, and a listener where the lane is free."""
        lane.is_queued = False
        if not self.is_open:
            return
        waiting, running, session = lane.waiting, lane.running, self.session
        while waiting:
            if session.busy:
                break
            if running and (len(running) >= lane.at_once(self.scope) or session.plan(waiting[0])):
                break
            listener = lane.listener
            if listener is not None and not listener.gives_way:
                break
            self.begin_exchange(lane, waiting.popleft())
        if lane.listen is not None and lane.listener is None and not running:
            self._begin_listener(lane)

    def begin_exchange(self, lane: LaneState, x: Exchange) -> None:
        """Begin an exchange in a lane that has room, with what its session needs before it."""
        if self.late.until or not self.is_idle:
            self._clear_line()
        run = lane.spare
        if run is None or lane.running:
            run = self._another_run(lane, x)
        else:  # it has kept its place in the order
            lane.spare = run.owed = run.agenda = None
            run.exchange, run.given_up = x, False
            run.cause, run.doing, run.unusable = "", "exchange", None
            lane.running.append(run)
        run.first_open = self.late.count
        self.live += 1
        if self.session.session is not None and (before := self.session.plan(x)):
            self._begin_behind(before, run, x)
        else:
            x.begin(self.scope, True, self.copies)
            self.begin(run, self.sequences[x.run or lane.exchange[0]], x)

    def _clear_line(self) -> None:
        """Before an exchange, forget replies that are due no longer, and bytes that no run listened for."""
        late, now = self.late, self.scope.now
        if late.until and late.until <= now:
            self.release()
        if not late.until and self.has_bytes():
            listens = bool(self.awaited) or self.listens
            if not listens or now - self.output.last_received >= STALE:
                self.drop_stale()

    def _another_run(self, lane: LaneState, exchange: Exchange) -> Run:
        self._give_way(lane)
        run = Run(self, lane, "exchange", exchange)
        lane.running.append(run)
        self._reorder()
        return run

    def _begin_behind(self, before: list[tuple[str, str]], run: Run, exchange: Exchange) -> None:
        """Begin the sequences that have to run before an exchange."""
        station = exchange.station
        exchange.begin(self.scope, True, self.copies)
        run.agenda = [(kind, one, Exchange(station=station).begin(self.scope)) for kind, one in before]
        run.agenda.append(("exchange", exchange.run or run.lane.exchange[0], exchange))
        self.session.busy = True
        self._next_of_agenda(run)

    def stir_all(self) -> None:
        """Something may begin in every lane."""
        for lane in self.lanes:
            if lane.waiting or lane.listen is not None:
                self.stir(lane)

    @staticmethod
    def _give_way(lane: LaneState) -> None:
        if lane.listener is not None:
            lane.listener.state, lane.listener.expected, lane.listener.deadline = State.DONE, {}, NEVER
            lane.listener.machine.live -= 1
            lane.listener = None

    def begin_sequences(self, kind: str, names: Iterable[str], station: Any) -> Run | None:
        """Runs sequences of the session in the first lane for exchanges: keeping alive, or closing."""
        lane = self.lane_of.get(None)
        if lane is None or not self.is_free:
            return None
        self._give_way(lane)
        run = Run(self, lane, kind)
        lane.running.append(run)
        self.live += 1
        self._reorder()
        run.agenda = [(kind, name, Exchange(station=station).begin(self.scope)) for name in names]
        if kind == "close":
            run.agenda.append(("ended", "", Exchange(station=station).begin(self.scope)))
        self._next_of_agenda(run)
        return run

    def _begin_listener(self, lane: LaneState) -> None:
        if lane.held_until > self.scope.now or lane.listen is None:
            return
        run = Run(self, lane, "listen")
        lane.listener = run
        self.live += 1
        self._reorder()
        self.begin(run, self.sequences[lane.listen], Exchange().begin(self.scope, False))

    def _next_of_agenda(self, run: Run) -> bool:
        """The next sequence of a run that has several: of its session first, then its own. False: there is none."""
        session = self.session
        while run.agenda:
            kind, name, context = run.agenda.pop(0)
            run.doing = kind
            if kind == "begin":
                session.begin(context.station)
            elif kind == "opened":
                session.opened()
            elif kind == "ended":
                session.end()
            else:
                session.busy = kind in ("open", "close")
                self.stir_all()
                self.begin(run, self.sequences[name], context)
                return True
        return False

    # ---- late replies -------------------------------------------------------------------------------------

    def release(self) -> None:
        """Go on with requests that were held back: no reply is due any more, or its time is over."""
        late = self.late
        late.time_over()
        items, late.items = late.items, []
        for send in items:
            send()
        for run in self.order:
            if run.state is State.HELD:
                if late.until > self.scope.now:
                    run.deadline = late.until
                else:
                    self.go_on(run)
            elif run.state is State.SILENT and run.doubt is not None and run.doubt.is_draining:
                run.deadline = max(late.until, self.scope.now)

    def hold_over(self, run: Run) -> None:
        """A time for which a run was to be held back is over."""
        late, now = self.late, self.scope.now
        more = late.time(self.scope, late.within)
        if self.has_bytes():  # one may be arriving
            late.until = max(late.until, self.output.last_received + more)
        if late.until <= now:
            if not (self.listens or self.awaited):
                self.drop_stale()
            self.release()
        elif not late.is_without_end(run.started):
            run.deadline = late.until
        else:
            run.cause = "replies that nothing waits for come without end"
            self.fail_run(run, "late_replies")

    # ---- ending -------------------------------------------------------------------------------------------

    def over(self, run: Run) -> None:
        """Update the session after the end of a run, begin the next sequence of the run, and report to the caller."""
        outcome, lane, session = run.outcome, run.lane, self.session
        if run.agenda and (outcome is None or outcome.ok or run.doing == "close"):
            run.state = State.GOING
            if self._next_of_agenda(run):
                return
            run.state = State.DONE
        if outcome is not None and run.doing != "close":
            self._failed(run, outcome)
        self.live -= 1
        if lane.listener is run:
            lane.listener = None
        elif run in lane.running:
            lane.running.remove(run)
        if lane.running or lane.listen is not None or run.unsent or run.kind != "exchange":
            self._reorder()
        else:
            lane.spare = run
        if session.busy:
            session.busy = False
            self.stir_all()
        elif lane.waiting or lane.listen is not None:
            self.stir(lane)
        exchange, run.exchange = run.exchange, None  # nothing leads from one to the other when both are over
        if exchange is not None:
            if outcome is None:
                exchange.succeeded(run.results)
            else:
                exchange.ended(outcome)

    def _failed(self, run: Run, outcome: Outcome) -> None:
        session, lost = self.session, True
        if run.doing == "open":
            session.end()
        else:
            lost = session.failed(outcome.outcome)
        if lost and session.reconnects and self.is_open:
            self.commands.append(Reopen(f"the session is lost: {outcome.outcome}"))
        if run.lane.listener is run and outcome.outcome == "circle":
            run.lane.held_until = self.scope.now + HOLD
            self.is_holding = self._keeps_times = True

    def cancel_now(self, exchange: Exchange) -> None:
        """Ends an exchange at once, wherever it stands."""
        for lane in self.lanes:
            if exchange in lane.waiting:
                lane.waiting.remove(exchange)
                self.tell(exchange, Outcome(False, "cancelled"))
                return
        for run in self.order:
            if run.exchange is exchange:
                run.agenda = None
                self.fail_run(run, "cancelled")

    def give_up_now(self, exchange: Exchange) -> None:
        """End an exchange that has not begun; an exchange under way repeats no request any more, and ends by itself."""
        if any(exchange in lane.waiting for lane in self.lanes):
            self.cancel_now(exchange)
        for run in self.order:
            if run.exchange is exchange:
                run.given_up = True
                if run.state in (State.HELD, State.SILENT):
                    self.cancel_now(exchange)

    def fail_waiting(self, outcome: str, cause: str) -> None:
        """Exchanges that have not begun fail."""
        for lane in self.lanes:
            while lane.waiting:
                self.tell(lane.waiting.popleft(), Outcome(False, outcome, cause))

    def _reorder(self) -> None:
        """Set the order of the runs, after runs have begun or ended."""
        order: list[Run] = []
        for lane in self.lanes:
            lane.spare = None
            order += lane.running
            if lane.listener is not None:
                order.append(lane.listener)
        self.order = tuple(order)

    @property
    def is_free(self) -> bool:
        """Whether the lane for exchanges could begin something of the session's own now."""
        lane = self.lane_of.get(None)
        if lane is None or lane.running or lane.waiting or not self.is_open:
            return False
        return lane.listener is None or lane.listener.gives_way

    @property
    def listens(self) -> bool:
        """Whether anything waits for frames."""
        return State.RECEIVING in [run.state for run in self.order]

    @property
    def held_until(self) -> int:
        """When a lane that is held back may begin its listener again."""
        now = self.scope.now
        times = [one.held_until for one in self.lanes if one.listener is None and not one.running]
        return min((time for time in times if time > now), default=NEVER)

    # ---- the end of all -----------------------------------------------------------------------------------

    def shut(self) -> bool:
        """Close the session when asked to, once the lane is free. Return whether something was done."""
        if self.on_shut is None:
            return False
        session = self.session
        if session.session is None or not (session.is_open or session.busy):
            if self.output.outgoing is not None or self.output.pending or self.late.items:
                return False
            self.ready.append(self.on_shut)
            self.on_shut = None
            return True
        if session.busy or not self.is_free:
            return False
        if not session.session.close:
            session.end()
            return True
        return self.begin_sequences("close", session.session.close, session.station) is not None
