"""Lanes of a role: exchanges that wait for their turn, those that run, and what listens when none does.

With them the shutdown, which waits for them and closes their session.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from framekit.definition.model.procedure import Lane
from framekit.definition.times import NEVER
from framekit.link.events import Exchange, Outcome, Reopen
from framekit.link.late import MOST_HOLDS
from framekit.link.output import Output
from framekit.link.sequences.runtime import Machine
from framekit.link.sequences.state import LaneState, Run, State

HOLD = 100_000_000
"""A listener that goes round in circles is started again after this (ns)."""

STALE = 1_000_000_000
"""What has lain there incomplete for so long (ns) when an exchange begins has nothing to do with it."""


class Lanes:
    """All lanes of a role, and the order in which arriving frames are offered to what runs in them.

    `lane_of`: the lane that runs exchanges of a sequence; None: the first that runs any.
    """

    def __init__(self, lanes: tuple[Lane, ...], machine: Machine) -> None:
        self.machine = machine
        self.lanes = [LaneState(lane) for lane in lanes]
        self.order: tuple[Run, ...] = ()
        self.was_closed = False
        self.is_holding = False
        self.lane_of: dict[str | None, LaneState] = {}
        for lane in self.lanes:
            for name in (None, *lane.exchange) if lane.exchange else ():
                self.lane_of.setdefault(name, lane)

    # ---- starting -----------------------------------------------------------------------------------------

    def begin_what_can(self) -> bool:
        """Starts exchanges whose turn it is, and listeners where a lane is free. Tells whether it did anything."""
        self.machine.stirred = False
        if not self.machine.is_open:
            return False
        begun = False
        for lane in self.lanes:
            while lane.waiting and self._has_room(lane):
                self._begin_exchange(lane, lane.waiting.popleft())
                begun = True
            if lane.listen is not None and not lane.running and lane.listener is None:
                begun = self._begin_listener(lane) or begun
        return begun

    def _has_room(self, lane: LaneState) -> bool:
        session = self.machine.session
        running = len(lane.running)
        if session.busy or (running and running >= lane.at_once(self.machine.scope)):
            return False
        if running and session.plan(lane.waiting[0]):
            return False
        return lane.listener is None or lane.listener.gives_way

    def _begin_exchange(self, lane: LaneState, exchange: Exchange) -> None:
        machine = self.machine
        late = machine.late
        if late.until and late.until <= machine.scope.now:
            self.release()
        if not late.until and (
            not (machine.awaits_frames or (self.order and self.listens))
            or (machine.scope.now - machine.output.last_received >= STALE and machine.has_bytes())
        ):
            machine.drop_stale()
        if lane.listener is not None:
            self._give_way(lane)
        run = Run(machine, lane, "exchange", exchange)
        lane.running.append(run)
        self._reorder()
        name, station = exchange.run or lane.exchange[0], exchange.station
        session = machine.session
        before = session.plan(exchange) if session.session is not None else ()
        exchange.begin(machine.scope)
        if not before:
            session.busy = False
            machine.start(run, machine.sequences[name], exchange)
            return
        for kind, sequence in before:
            run.agenda.append((kind, sequence, Exchange(station=station).begin(machine.scope)))
        run.agenda.append(("exchange", name, exchange))
        session.busy = True
        self._next_of_agenda(run)

    @staticmethod
    def _give_way(lane: LaneState) -> None:
        if lane.listener is not None:
            lane.listener.state = State.DONE
            lane.listener = None

    def begin_sequences(self, kind: str, names: Iterable[str], station: Any) -> Run | None:
        """Runs sequences of the session in the first lane for exchanges: keeping alive, or closing."""
        lane = self.lane_of.get(None)
        if lane is None or not self.is_free:
            return None
        self._give_way(lane)
        run = Run(self.machine, lane, kind)
        lane.running.append(run)
        self._reorder()
        for name in names:
            run.agenda.append((kind, name, Exchange(station=station).begin(self.machine.scope)))
        if kind == "close":
            run.agenda.append(("ended", "", Exchange(station=station).begin(self.machine.scope)))
        self._next_of_agenda(run)
        return run

    def _begin_listener(self, lane: LaneState) -> bool:
        machine = self.machine
        if lane.held_until > machine.scope.now or lane.listen is None:
            return False
        run = Run(machine, lane, "listen")
        lane.listener = run
        self._reorder()
        machine.start(run, machine.sequences[lane.listen], Exchange().begin(machine.scope, False))
        return True

    def _next_of_agenda(self, run: Run) -> bool:
        """The next sequence of a run that has several: of its session first, then its own. False: there is none."""
        session = self.machine.session
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
                self.machine.stirred = True
                self.machine.start(run, self.machine.sequences[name], context)
                return True
        return False

    # ---- late replies -------------------------------------------------------------------------------------

    def release(self) -> None:
        """Nothing is due any more, or its time is over: what was held back goes on."""
        machine, late = self.machine, self.machine.late
        late.clear()
        items, late.items = late.items, []
        for send in items:
            send()
        for run in self.order:
            if run.state is State.HELD:
                if late.until > machine.scope.now:
                    run.deadline = late.until
                else:
                    machine.go_on(run)

    def hold_over(self, run: Run) -> None:
        """A time for which a run was to be held back is over."""
        machine, late = self.machine, self.machine.late
        now, more = machine.scope.now, late.time(machine.scope, late.within)
        if machine.has_bytes():  # one may be arriving
            late.until = max(late.until, machine.output.last_received + more)
        if late.until <= now:
            if not (self.listens or machine.awaits_frames):
                machine.drop_stale()
            self.release()
        elif now - run.started < MOST_HOLDS * (late.within + more):
            run.deadline = late.until
        else:
            run.cause = "replies that nothing waits for come without end"
            machine.fail_run(run, "late_replies")

    # ---- ending -------------------------------------------------------------------------------------------

    def settle_ended(self) -> None:
        """What follows from runs that have ended: the session, the next sequence of the run, the caller."""
        machine = self.machine
        while machine.ended:
            run = machine.ended.popleft()
            outcome = run.outcome
            assert outcome is not None
            if run.agenda and (outcome.ok or run.doing == "close") and self._next_of_agenda(run):
                continue
            if not outcome.ok and run.doing != "close":
                self._failed(run, outcome)
            machine.session.busy = False
            lane = run.lane
            if lane.listener is run:
                lane.listener = None
            elif run in lane.running:
                lane.running.remove(run)
            self._reorder()
            exchange, run.exchange = run.exchange, None  # nothing leads from one to the other when both are over
            if exchange is not None:
                machine.callbacks.append(partial(exchange.ended, outcome))

    def _failed(self, run: Run, outcome: Outcome) -> None:
        session = self.machine.session
        lost = True
        if run.doing == "open":
            session.end()
        else:
            lost = session.failed(outcome.outcome)
        if lost and session.reconnects and self.machine.is_open:
            self.machine.output.commands.append(Reopen(f"the session is lost: {outcome.outcome}"))
        if run.lane.listener is run and outcome.outcome == "circle":
            run.lane.held_until = self.machine.scope.now + HOLD
            self.is_holding = True

    def cancel(self, exchange: Exchange) -> None:
        """Ends an exchange at once, wherever it stands."""
        for lane in self.lanes:
            if exchange in lane.waiting:
                lane.waiting.remove(exchange)
                self.machine.tell(exchange, Outcome(False, "cancelled"))
                return
        for run in self.order:
            if run.exchange is exchange:
                run.agenda.clear()
                self.machine.fail_run(run, "cancelled")

    def give_up(self, exchange: Exchange) -> None:
        """Ends an exchange that has not begun; one under way repeats nothing any more, and ends by itself."""
        if any(exchange in lane.waiting for lane in self.lanes):
            self.cancel(exchange)
        for run in self.order:
            if run.exchange is exchange:
                run.given_up = True
                if run.state is State.HELD:
                    self.cancel(exchange)

    def fail_waiting(self, outcome: str, cause: str) -> None:
        """Exchanges that have not begun fail."""
        for lane in self.lanes:
            while lane.waiting:
                self.machine.tell(lane.waiting.popleft(), Outcome(False, outcome, cause))

    def _reorder(self) -> None:
        """Other runs than before: what is looked for may be something else, and a lane may have room."""
        machine = self.machine
        order: list[Run] = []
        machine.changed = True
        for lane in self.lanes:
            order += lane.running
            if lane.listener is not None:
                order.append(lane.listener)
            if lane.waiting or lane.listen is not None:
                machine.stirred = True
        self.order = tuple(order)

    @property
    def is_free(self) -> bool:
        """Whether the lane for exchanges could begin something of the session's own now."""
        lane = self.lane_of.get(None)
        if lane is None or lane.running or lane.waiting or not self.machine.is_open:
            return False
        return lane.listener is None or lane.listener.gives_way

    @property
    def listens(self) -> bool:
        """Whether anything waits for frames."""
        return State.RECEIVING in [run.state for run in self.order]

    @property
    def held_until(self) -> int:
        """When a lane that is held back may begin its listener again."""
        now = self.machine.scope.now
        times = [one.held_until for one in self.lanes if one.listener is None and not one.running]
        return min((time for time in times if time > now), default=NEVER)


class Shutdown:
    """Closes the session when asked to, once the lane is free. `on_done`: who asked, until it is told."""

    def __init__(self, machine: Machine, lanes: Lanes, output: Output) -> None:
        self.machine = machine
        self.lanes = lanes
        self.output = output
        self.on_done: Callable[[], None] | None = None

    def ask(self, on_done: Callable[[], None]) -> None:
        """Asks for the end; `on_done` is called once, when no session is open and the last byte has left."""
        self.on_done = on_done

    def go_on(self) -> bool:
        """Does the next thing there is to do now. False when there is nothing, or something has to end first."""
        if self.on_done is None:
            return False
        session = self.machine.session
        if session.session is None or not (session.is_open or session.busy):
            if self.output.outgoing is not None or self.output.pending or self.machine.late.items:
                return False
            self.machine.callbacks.append(self.on_done)
            self.on_done = None
            return True
        if session.busy or not self.lanes.is_free:
            return False
        if not session.session.close:
            session.end()
            return True
        return self.lanes.begin_sequences("close", session.session.close, session.station) is not None
