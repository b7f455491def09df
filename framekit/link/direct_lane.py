"""The exchange that takes the short way, on an engine where nothing else is going on (see `direct`).

As soon as anything happens that is not its reply, whole and good – a time limit, part of a frame, another exchange, a
lost connection – it becomes the run of its sequence that it would have been from the start, and that goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
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
from framekit.link.same_reply import SameReply


class DirectAsk(Protocol):
    """One exchange asked for. `done` or `brought` is called once, unless `exchange` has been: that is told then."""

    @property
    def request(self) -> DirectRequest: ...

    def done(self, outcome: Outcome) -> None:
        """Its end."""
        ...

    def brought(self, same: SameReply, raw: bytes) -> None:
        """Its end: the reply that was learned, as these bytes."""
        ...

    def exchange(self) -> Exchange:
        """The same exchange for the long way, which it takes from now on."""
        ...


class DirectLane:
    """At most one exchange under way. `deadline`: when its time is over (ns).

    `_calm`: the last request, as long as nothing but it and its reply has happened since everything was looked at.
    """

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
        self._calm: DirectRequest | None = None
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
        request, machine = ask.request, self.machine
        data = self._begun(ask) if self._is_calm(request) or self._is_free(request) else None
        if data is None:
            return False
        if machine.monitor is not None:
            fields = request.sent_value(data).complete()
            machine.show("frame", "out", data, request.info.name, fields, repeated=False)
        self._item = item = Item(None, data, info=request.info)
        machine.output.put(item)
        return True

    def _begun(self, ask: DirectAsk) -> bytes | None:
        """What is to be sent; the exchange is under way from here on. None: nothing has been done."""
        request = ask.request
        try:
            data = request.begin()
            within = request.within() if request.fixed_within is None else request.fixed_within
        except EVALUATION_ERRORS:
            return None
        if data is not None:
            self._ask, self._calm, self._data, self._has_left = ask, request, data, False
            self._within, self._started, self.deadline = within, self.machine.scope.now, NEVER
        return data

    def again(self, ask: DirectAsk, now: int) -> bytes | None:
        """As `begin`, where nothing but such exchanges has happened: what the port is to be given at once.

        None: something else has happened since, or is to be done before; nothing is sent.
        """
        request, machine = ask.request, self.machine
        scope, output = machine.scope, machine.output
        if not self._is_calm(request) or not output.is_immediate or machine.monitor is not None:
            return None
        if now > scope.now:
            scope.now = now
        data = self._begun(ask)
        if data is not None:
            self._item.data, self._item.info = data, request.info
            output.outgoing = self._item
        return data

    def left_at_once(self, now: int) -> None:
        """What `again` gave has left the line already."""
        machine = self.machine
        output = machine.output
        output.outgoing, self._has_left = None, True
        machine.scope.now = output.last_sent = self._started = now
        self.deadline = after(now, self._within)

    def _is_calm(self, request: DirectRequest) -> bool:
        """Whether nothing has happened since the last exchange but its reply, and this one needs nothing before it."""
        machine = self.machine
        return (
            self._ask is None
            and self._has_left
            and (self._calm is request or (self._calm is not None and machine.session.session is None))
            and request.settings == machine.scope.settings
        )

    def disturb(self) -> None:
        """Something has happened: before the next exchange begins, everything is looked at."""
        self._calm = None

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
            and not machine.late.until
            and not machine.late.lost
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

    def receive(self, data: bytes, now: int) -> Callable[[], None] | None:
        """Takes bytes that are the reply; who asked is to be told so. None: they are not, or nothing is under way."""
        ask = self._ask
        if ask is None or type(data) is not bytes or not self.receiver.is_idle:
            return None
        same = self._same_in(ask.request, data)
        if same is not None:
            self._taken(data, now)
            return partial(ask.brought, same, data)
        found = ask.request.take(data, self._data, self._context)
        if found is None:
            return None
        value, outcome = found
        self._taken(data, now)
        self.machine.show_received(value, data, now)
        return partial(ask.done, outcome)

    def _same_in(self, request: DirectRequest, data: bytes) -> SameReply | None:
        """The reply that was learned, if these bytes are that; where somebody watches, it is read with care."""
        same, machine = request.same, self.machine
        if same is None or machine.monitor is not None or request.settings != machine.scope.settings:
            return None
        return same if same.fits(data, self._data) else None

    def take_same(self, ask: DirectAsk, data: bytes, now: int) -> SameReply | None:
        """Takes bytes that are the reply learned, if `ask` is what waits for them and nothing else has happened.

        None: nothing has been done; they are for `receive`.
        """
        request = ask.request
        if self._ask is not ask or self._calm is not request or self.deadline < now:
            return None
        same = self._same_in(request, data)
        if same is not None:
            machine = self.machine
            machine.scope.now = machine.output.last_received = now
            self._taken(data, now)
        return same

    def _taken(self, data: bytes, now: int) -> None:
        self._ask, self.deadline = None, NEVER
        self.receiver.pass_by(len(data), now)
        self.counters.received += 1

    def unfold(self) -> None:
        """What is under way becomes a run of its sequence, as it stands now."""
        if self._calm is not None:
            self.machine.late.within = self._within
        ask, self._ask, self._calm = self._ask, None, None
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
