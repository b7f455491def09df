"""Lanes of a role: exchanges that wait for their turn, those that run, and the listener of a free lane.

With the sequences that open and close sessions, the offering of frames and events to the runs, and the replies for
which other requests wait.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from framekit.definition.model.procedure import Lane
from framekit.definition.times import NEVER
from framekit.link.arrivals import BadFrame
from framekit.link.events import Exchange, Outcome, Reopen
from framekit.link.own_echo import EchoState, Suspicion
from framekit.link.reception import Reception
from framekit.link.sequences.runtime import Machine
from framekit.link.sequences.state import PARKED_EVENTS, Bad, Item, LaneState, Level, Run, State
from framekit.link.values import FrameValue

HOLD = 100_000_000
"""A listener that goes round in circles is started again after this (ns)."""

STALE = 1_000_000_000
"""Incomplete bytes that are this old (ns) when an exchange begins do not belong to it."""

RECEIVING, HELD, SILENT, DONE = State.RECEIVING, State.HELD, State.SILENT, State.DONE


class Lanes:
    """The runs of a machine by their lanes."""

    def __init__(self, machine: Machine, reception: Reception, lanes: tuple[Lane, ...]) -> None:
        self.machine = machine
        self.reception = reception
        self.all = [LaneState(lane) for lane in lanes]
        """In the order in which arriving frames are offered to their runs."""
        self.is_holding = False
        """Whether a listener has been held back."""
        self.keeps_times = machine.session.keep_alive is not None or machine.output.limits_holds
        """Effects depend on other times than those of runs: keep-alive, lanes or frames held back, end of session."""
        self.on_shut: Callable[[], None] | None = None
        """Called once at the end of the session."""
        self.lane_of: dict[str | None, LaneState] = {}
        """The lane that runs the exchanges of a sequence; None: the first lane that runs any."""
        for lane in self.all:
            for name in (None, *lane.exchange) if lane.exchange else ():
                self.lane_of.setdefault(name, lane)

    # ---- starting -----------------------------------------------------------------------------------------

    def fill(self, lane: LaneState) -> None:
        """Start exchanges whose turn it is, and a listener if the lane is free."""
        lane.is_queued = False
        machine = self.machine
        if not machine.output.is_open:
            return
        waiting, running, session = lane.waiting, lane.running, machine.session
        while waiting:
            if session.busy:
                break
            if running and (len(running) >= lane.at_once(machine.scope) or session.plan(waiting[0])):
                break
            listener = lane.listener
            if listener is not None and not listener.gives_way:
                break
            self.begin_exchange(lane, waiting.popleft())
        if lane.listen is not None and lane.listener is None and not running:
            self._begin_listener(lane)

    def begin_exchange(self, lane: LaneState, x: Exchange) -> None:
        """Begin an exchange in a lane that has room, with what its session needs before it."""
        machine = self.machine
        if machine.late.open or machine.late.holds.until or machine.receiver.has_unread:
            self._clear_line()
            machine.late.prepare(x)
        run = lane.spare
        if run is None or lane.running:
            run = self._another_run(lane, x)
        else:  # it has kept its place in the order
            lane.spare = run.owed = run.unusable = None
            run.exchange = x
            run.given_up = False
            run.cause = ""
            lane.running.append(run)
        run.first_open = machine.late.count
        machine.live += 1
        if machine.session.session is not None and (before := machine.session.plan(x)):
            self._begin_behind(before, run, x)
        else:
            x.begin(machine.scope, True, machine.copies)
            machine.begin(run, machine.sequences[x.run or lane.exchange[0]], x)

    def _clear_line(self) -> None:
        """Forget replies that are no longer due, and bytes that no run listened for, before an exchange."""
        machine, reception = self.machine, self.reception
        late, now = machine.late, machine.scope.now
        if late.until and late.until <= late.heard_until:
            self.release()
        if not late.until and not machine.receiver.is_empty:
            listens = bool(reception.awaited) or self.listens
            if not listens or now - machine.output.last_received >= STALE:
                reception.drop_stale()

    def _another_run(self, lane: LaneState, exchange: Exchange) -> Run:
        self._give_way(lane)
        run = Run(self.machine, lane, "exchange", exchange)
        lane.running.append(run)
        self._reorder()
        return run

    def _begin_behind(self, before: list[tuple[str, str]], run: Run, exchange: Exchange) -> None:
        """Begin the sequences that have to run before an exchange."""
        machine, station = self.machine, exchange.station
        exchange.begin(machine.scope, True, machine.copies)
        run.agenda = [(kind, one, Exchange(station=station).begin(machine.scope)) for kind, one in before]
        run.agenda.append(("exchange", exchange.run or run.lane.exchange[0], exchange))
        machine.session.busy = True
        self._next_of_agenda(run)

    def stir_all(self) -> None:
        """Look in every lane for exchanges and listeners that can begin."""
        for lane in self.all:
            if lane.waiting or lane.listen is not None:
                self.machine.stir(lane)

    def _give_way(self, lane: LaneState) -> None:
        """End the listener of a lane for an exchange."""
        if lane.listener is not None:
            lane.listener.state, lane.listener.expected, lane.listener.deadline = DONE, {}, NEVER
            self.machine.live -= 1
            lane.listener = None

    def begin_sequences(self, kind: str, names: Iterable[str], station: Any) -> Run | None:
        """Run sequences of the session in the first lane for exchanges: keeping alive, or closing."""
        lane, machine = self.lane_of.get(None), self.machine
        if lane is None or not self.is_free:
            return None
        self._give_way(lane)
        run = Run(machine, lane, kind)
        lane.running.append(run)
        machine.live += 1
        self._reorder()
        run.agenda = [(kind, name, Exchange(station=station).begin(machine.scope)) for name in names]
        if kind == "close":
            run.agenda.append(("ended", "", Exchange(station=station).begin(machine.scope)))
        self._next_of_agenda(run)
        return run

    def _begin_listener(self, lane: LaneState) -> None:
        machine = self.machine
        if lane.held_until > machine.scope.now or lane.listen is None:
            return
        run = Run(machine, lane, "listen")
        lane.listener = run
        machine.live += 1
        self._reorder()
        machine.begin(run, machine.sequences[lane.listen], Exchange().begin(machine.scope, False))

    def _next_of_agenda(self, run: Run) -> bool:
        """Begin the next sequence of a run with several: those of its session first. Return False after the last."""
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
                self.stir_all()
                self.machine.begin(run, self.machine.sequences[name], context)
                return True
        return False

    # ---- to the runs that wait ----------------------------------------------------------------------------

    def offer(self, value: FrameValue) -> bool:
        """Offer a good frame to the rows of the runs that wait; return whether a row took it.

        Lanes are asked in the order written, in a lane the older exchange first; the first row that fits takes it.
        """
        name, machine = value.frame, self.machine
        for run in machine.order:
            if name in run.expected:
                level = run.top
                x = level.x
                if x.checks_echo and not machine.table.repeats(value, x.asked, x.last_sent, x.names):
                    continue
                if machine.go(run, level, value) if machine.echo is None else self._go_examined(run, level, value):
                    return True
                caller = level.caller
                while caller is not None:
                    if name in caller.wait.names(caller.x.expected) and machine.go(run, caller, value):
                        return True
                    caller = caller.caller
        return False

    def _go_examined(self, run: Run, level: Level, value: FrameValue) -> bool:
        """Do as `go`, but for the echo of the request of a run; note a reply that may be an echo."""
        machine, x = self.machine, level.x
        echo = machine.own_echo
        if not x.checks_echo:
            return machine.go(run, level, value)
        if echo.takes(run, x, value) or not machine.go(run, level, value):
            return False
        machine.suspected = x if echo.suspects() else None
        if machine.suspected is not None and run.state is DONE and run.exchange is x:
            run.exchange = Suspicion(x)
        if echo.state is EchoState.ABSENT:
            machine.echo = None
        return True

    def offer_queues(self) -> None:
        """Let a row go on that waits for an item of a queue or for room in it; others may follow."""
        machine = self.machine
        queues = machine.queues
        for run in machine.order:
            if run.state is not RECEIVING:
                continue
            for place, (queue, room) in enumerate(run.top.wait.queues):
                if queue is not None:
                    items = queues.items[queue]
                    if items and machine.go(run, run.top, Item(place, items[0])):
                        machine.queues_changed()
                        return
                elif room is not None and not queues.full(room) and machine.go(run, run.top, Item(place, None)):
                    machine.queues_changed()
                    return

    def handle(self, run: Run, event: str, value: Any) -> bool:
        """Let a run handle an event, with the effects; return whether it has a handler that applies.

        A break, a lost connection and a frame that was not sent are also for the callers, innermost first.
        """
        for level in run.calls():
            if event in level.wait.events:
                return self.machine.go(run, level, value) or run.state is DONE
            if event not in PARKED_EVENTS:
                break
        return False

    def offer_bad(self, bad: BadFrame) -> bool:
        """Offer a bad frame to the run whose rows name it, else to the first run with a handler.

        Return whether a run took it.
        """
        receiving = [run for run in self.machine.order if run.state is RECEIVING]
        for run in receiving:
            if bad.frame in run.expected:
                is_reply = run.asked is not None and self.machine.late.is_damaged_reply(bad, run, run.asked)
                run.unusable_replies().add_bad(bad, is_reply=is_reply)
                run.cause = str(run.unusable)
                self.handle(run, "on_bad", Bad(bad.cause, bad.frame))
                return True
        for run in receiving:
            run.cause = f"{bad.frame}: {bad.cause}"
            if self.handle(run, "on_bad", Bad(bad.cause, bad.frame)):
                return True
        return False

    # ---- late replies -------------------------------------------------------------------------------------

    def release(self) -> None:
        """Go on with requests that were held back: no reply is due any more, or its time is over."""
        machine = self.machine
        late, now = machine.late, machine.scope.now
        late.time_over()
        items, late.items = late.items, []
        for send in items:
            send()
        for run in machine.order:
            if run.state is HELD:
                if (until := late.held_until(run.top.x.station)) > now:
                    run.deadline = until
                else:
                    machine.go_on(run)
            elif run.state is SILENT and run.doubt is not None and run.doubt.is_draining:
                run.deadline = max(late.held_until(run.top.x.station), now)
        late.on_end()

    def hold_over(self, run: Run) -> None:
        """Handle the end of the time for which a run is held back."""
        machine, reception = self.machine, self.reception
        late, now, station = machine.late, machine.scope.now, run.top.x.station
        more = late.time(machine.scope, late.within)
        if not machine.receiver.is_empty:  # a late reply may be arriving
            late.holds.extend(station, machine.output.last_received + more)
        until = late.held_until(station)
        if until <= now:
            if not (self.listens or reception.awaited):
                reception.drop_stale()
            self.release()
        elif not late.is_without_end(run.started):
            run.deadline = until
            late.on_wait(station, until)
        else:
            run.cause = "replies that nothing waits for come without end"
            machine.fail_run(run, "late_replies")

    # ---- ending -------------------------------------------------------------------------------------------

    def over(self, run: Run) -> None:
        """Update the session after the end of a run, begin the next sequence of the run, and report to the caller."""
        machine = self.machine
        lane = run.lane
        outcome = run.outcome
        session = machine.session
        if run.agenda and (outcome is None or outcome.ok or run.doing == "close"):
            run.state = State.GOING
            if self._next_of_agenda(run):
                return
            run.state = DONE
        if outcome is not None and run.doing != "close":
            self._failed(run, outcome)
        machine.live -= 1
        if lane.listener is run:
            lane.listener = None
        else:
            lane.running.remove(run)
        if lane.running or lane.listen is not None or run.unsent or run.agenda is not None or run.kind != "exchange":
            self._reorder()
        else:
            lane.spare = run
        if session.busy:
            session.busy = False
            self.stir_all()
        elif lane.waiting or lane.listen is not None:
            machine.stir(lane)
        exchange = run.exchange
        run.exchange = None  # break the reference cycle
        if exchange is not None:
            if outcome is None:
                exchange.succeeded(run.results)
            else:
                exchange.ended(outcome)

    def _failed(self, run: Run, outcome: Outcome) -> None:
        """Update the session after a failure."""
        machine = self.machine
        session, lost = machine.session, True
        if run.doing == "open":
            session.end()
        else:
            lost = session.failed(outcome.outcome)
        if lost and session.reconnects and machine.output.is_open:
            machine.output.commands.append(Reopen(f"the session is lost: {outcome.outcome}"))
        if run.lane.listener is run and outcome.outcome == "circle":
            run.lane.held_until = machine.scope.now + HOLD
            self.is_holding = self.keeps_times = True

    def cancel(self, exchange: Exchange) -> None:
        """End an exchange at once, begun or not."""
        machine = self.machine
        for lane in self.all:
            if exchange in lane.waiting:
                lane.waiting.remove(exchange)
                machine.tell(exchange, Outcome(False, "cancelled"))
                return
        for run in machine.order:
            if run.exchange is exchange:
                run.agenda = None
                machine.fail_run(run, "cancelled")

    def give_up(self, exchange: Exchange) -> None:
        """End an exchange that has not begun; an exchange under way repeats no request any more, and ends by itself."""
        if any(exchange in lane.waiting for lane in self.all):
            self.cancel(exchange)
        for run in self.machine.order:
            if run.exchange is exchange:
                run.given_up = True
                if run.state in (HELD, SILENT):
                    self.cancel(exchange)

    def fail_waiting(self, outcome: str, cause: str) -> None:
        """Report failure of the exchanges that have not begun."""
        for lane in self.all:
            while lane.waiting:
                self.machine.tell(lane.waiting.popleft(), Outcome(False, outcome, cause))

    def _reorder(self) -> None:
        """Set the order of the runs, after runs have begun or ended."""
        order: list[Run] = []
        for lane in self.all:
            lane.spare = None
            order += lane.running
            if lane.listener is not None:
                order.append(lane.listener)
        self.machine.order = tuple(order)

    @property
    def is_free(self) -> bool:
        """Return whether the lane for exchanges could begin a sequence of the session now."""
        lane = self.lane_of.get(None)
        if lane is None or lane.running or lane.waiting or not self.machine.output.is_open:
            return False
        return lane.listener is None or lane.listener.gives_way

    @property
    def listens(self) -> bool:
        """Return whether a run waits for frames."""
        return RECEIVING in [run.state for run in self.machine.order]

    @property
    def held_until(self) -> int:
        """Return when a lane that is held back may begin its listener again (ns)."""
        now = self.machine.scope.now
        times = [one.held_until for one in self.all if one.listener is None and not one.running]
        return min((time for time in times if time > now), default=NEVER)

    # ---- the end of all -----------------------------------------------------------------------------------

    def shut(self) -> bool:
        """Close the session on request, once the lane is free. Return whether that has changed the state."""
        if self.on_shut is None:
            return False
        machine = self.machine
        session, output = machine.session, machine.output
        if session.session is None or not (session.is_open or session.busy):
            if output.outgoing is not None or output.pending or machine.late.items:
                return False
            machine.ready.append(self.on_shut)
            self.on_shut = None
            return True
        if session.busy or not self.is_free:
            return False
        if not session.session.close:
            session.end()
            return True
        return self.begin_sequences("close", session.session.close, session.station) is not None
