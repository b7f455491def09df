"""The exchange that takes the short way, on an engine where nothing else is going on (see `direct`).

As soon as anything happens that is not its reply, whole and good – a time limit, part of a frame, another exchange, a
lost connection – it becomes the run of its sequence that it would have been from the start, and that goes on.
"""

from __future__ import annotations

from typing import Protocol

from framekit.definition.times import NEVER
from framekit.link.clocks import after, begin_clock
from framekit.link.counters import LinkCounters
from framekit.link.direct import DirectRequest, NotPlainError
from framekit.link.direct_plan import DirectPlan, plan_of
from framekit.link.evaluate import EVALUATION_ERRORS, Names
from framekit.link.exchange import Exchange, Outcome
from framekit.link.lanes import Lanes
from framekit.link.machine import Machine, arguments_of
from framekit.link.output import Item
from framekit.link.receiver import Receiver
from framekit.link.runs import Activation, Dealing, Run


class DirectAsk(Protocol):
    """One exchange asked for. `done` is called once with its end, unless `exchange` has been: that is told then."""

    @property
    def request(self) -> DirectRequest: ...

    def done(self, outcome: Outcome) -> None: ...

    def exchange(self) -> Exchange:
        """The same exchange for the long way, which it takes from now on."""
        ...


class DirectLane:
    """At most one exchange under way. `deadline`: when its time is over (ns)."""

    def __init__(
        self, machine: Machine, lanes: Lanes, receiver: Receiver, counters: LinkCounters, context: Names
    ) -> None:
        self.machine = machine
        self.lanes = lanes
        self.receiver = receiver
        self.counters = counters
        self.deadline = NEVER
        self._context = context
        self._ask: DirectAsk | None = None
        self._item = Item(None)
        self._data = b""
        self._started = 0
        self._within = NEVER
        self._has_left = False
        self._plans: dict[str, DirectPlan | None] = {}

    @property
    def is_under_way(self) -> bool:
        """Whether an exchange is."""
        return self._ask is not None

    # ---- before -------------------------------------------------------------------------------------------

    def request(self, exchange: Exchange) -> DirectRequest | None:
        """The short way of an exchange like this one; None if there is none."""
        lane = self.lanes.lane_for(exchange.run)
        if lane is None or lane.at_once(self.machine) < 1:
            return None
        name = exchange.run or lane.exchange[0]
        if name not in self._plans:
            machine = self.machine
            scope = machine.scope
            self._plans[name] = plan_of(machine.sequences[name], scope.protocol, machine.table, scope)
        plan = self._plans[name]
        try:
            return None if plan is None else DirectRequest(plan, self.machine.table, self.machine.scope, exchange)
        except (NotPlainError, *EVALUATION_ERRORS):
            return None

    # ---- asking -------------------------------------------------------------------------------------------

    def begin(self, ask: DirectAsk) -> bool:
        """Begins an exchange, if nothing else is going on. False: nothing has been sent."""
        if not self._is_free(ask.request):
            return False
        request, machine = ask.request, self.machine
        try:
            data = request.begin()
            within = request.within()
        except EVALUATION_ERRORS:
            return False
        if data is None:
            return False
        self._ask, self._data, self._has_left = ask, data, False
        self._within = within
        self._started = machine.scope.now
        self.deadline = NEVER
        if machine.monitor is not None:
            fields = request.sent_value(data).complete()
            machine.show("frame", "out", data, request.info.name, fields, repeated=False)
        self._item = item = Item(None, data, info=request.info)
        machine.output.put(item)
        return True

    def _is_free(self, request: DirectRequest) -> bool:
        """Whether the exchange could begin at once, and alone."""
        lanes, machine = self.lanes, self.machine
        output = machine.output
        return (
            self._ask is None
            and lanes.is_open
            and not lanes.order
            and not lanes.is_waited_for
            and output.outgoing is None
            and output.clear_to_send
            and not output.pending
            and machine.asking is None
            and not machine.delivered
            and machine.session.is_ready(request.station, request.outside_session)
            and self.receiver.is_idle
        )

    def left(self, item: Item) -> bool:
        """Something has left the line: if it was the request that waits for its reply, its time begins."""
        if item is not self._item or self._ask is None:
            return False
        self._has_left = True
        self._started = now = self.machine.scope.now
        self.deadline = after(now, self._within)
        return True

    # ---- what comes ---------------------------------------------------------------------------------------

    def receive(self, data: bytes, now: int) -> tuple[DirectAsk, Outcome] | None:
        """Takes bytes that are the reply. None: they are not, or nothing is under way; nothing has been done."""
        ask = self._ask
        if ask is None or type(data) is not bytes or not self.receiver.is_idle:
            return None
        found = ask.request.take(data, self._context)
        if found is None:
            return None
        value, outcome = found
        self._ask, self.deadline = None, NEVER
        self.receiver.pass_by(len(data), now)
        self.counters.received += 1
        self.machine.show_received(value, data, now)
        return ask, outcome

    def unfold(self) -> None:
        """What is under way becomes a run of its sequence, as it stands now."""
        ask, self._ask = self._ask, None
        if ask is None:
            return
        self.deadline = NEVER
        request, machine = ask.request, self.machine
        plan, exchange = request.plan, ask.exchange()
        run = self.lanes.take_over(exchange)
        dealing = Dealing(machine.scope, exchange, True)
        activation = Activation(plan.sequence, dealing, arguments_of(plan.sequence, dealing), False)
        activation.index, activation.step = plan.index, plan.step
        activation.phase = len(plan.step.phases)
        value = request.sent_value(self._data)
        activation.sent, dealing.last_sent = (self._data, value), value
        run.stack.append(activation)
        if not self._has_left:
            run.unsent, self._item.run = 1, run
        machine.guarded(run, self._wait)

    def _wait(self, run: Run) -> None:
        self.machine.receive(run)
        begin_clock(run, self._started)
