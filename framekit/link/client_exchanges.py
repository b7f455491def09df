"""Exchanges of a client: requests made of service rows, started on an engine, and their replies judged.

It knows which exchange belongs to which row and place, but not what users ask for. Language reference, sections 11
and 13.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

from framekit.codec.shown import explain
from framekit.definition.model import protocol as model
from framekit.link.construct_values import EACH
from framekit.link.evaluate import EVALUATION_ERRORS, Names, compile_expression
from framekit.link.events import Command
from framekit.link.exchange import Exchange, Outcome
from framekit.link.frame_table import Codec
from framekit.link.ready import CompiledRow, Prepared, ReadyReads
from framekit.link.replies import ErrorReader, UnfitReplyError
from framekit.link.requests import Piece, Plan, Planner, ServiceError
from framekit.link.services.rows import ServiceRows
from framekit.link.transfer import Answer, Done, Job, Transfer, TransferResult, elements


class Starts(Protocol):
    """What a client needs of an engine: its names, and exchanges started on it."""

    @property
    def scope(self) -> Any: ...

    def start(self, exchange: Exchange, now: int) -> list[Command]: ...


class ClientExchanges:
    """What a client needs to do exchanges over one engine."""

    def __init__(self, protocol: model.Protocol, codec: Codec, engine: Starts) -> None:
        self.engine = engine
        self.shared = ServiceRows(protocol, codec)
        self.grammar = self.shared.grammar
        self.planner = Planner(self.shared)
        self.grammar.serves = lambda address: self.planner.serves(address, self._names(None, None))
        self.errors = ErrorReader(self.shared)
        default = protocol.station.default
        self._default_station = None if default is None else compile_expression(default)(Names())
        self._ready = ReadyReads(engine.scope)
        self._rows = {facts: CompiledRow(facts) for rows in self.shared.rows.values() for facts in rows}

    def _names(self, station: Any, params: Mapping[str, Any] | None) -> Names:
        """What a request is made of. Raises ParameterError for a parameter that does not fit."""
        scope = self.engine.scope
        names = Names(scope.worked_out(params), scope, scope.formulas_for(params)) if params else Names(None, scope)
        names["station"] = self._default_station if station is None else station
        return names

    def _transfer(
        self, plans: Sequence[Plan], wanted: Sequence[tuple[str, int]], names: Names, now: int, on_done: Done
    ) -> list[Command]:
        """Does the exchanges of all plans; `wanted` are the units and counts to be read."""
        given = given_in(names)
        exchanges = [self._prepared(plan, pieces, names, given) for plan in plans for pieces in plan.exchanges]
        return self._begin_read(plans, wanted, exchanges, now, on_done)

    def _begin_read(
        self, plans: Sequence[Plan], wanted: Sequence[tuple[str, int]], exchanges: Sequence[Prepared], now: int,
        on_done: Done,
    ) -> list[Command]:  # fmt: skip
        def finish(data: list[bytes]) -> TransferResult:
            return TransferResult(True, *elements(plans, wanted, data)) if wanted else TransferResult(True)

        return self._begin([self._job(prepared) for prepared in exchanges], finish, now, on_done)

    def _begin(
        self, jobs: Sequence[Job], finish: Callable[[list[bytes]], TransferResult], now: int, on_done: Done
    ) -> list[Command]:
        commands: list[Command] = []

        def start(exchange: Exchange) -> None:
            commands.extend(self.engine.start(exchange, max(now, self.engine.scope.now)))

        Transfer(jobs, start, finish, on_done).go()
        return commands

    def _prepared(self, plan: Plan, pieces: tuple[Piece, ...], names: Names, params: Mapping[str, Any]) -> Prepared:
        """An exchange of a plan, worked out. Raises ServiceError."""
        row = self._rows[plan.facts]
        offered = self._offered(plan, pieces, names)
        try:
            request = None if row.request is None else row.request(offered)
            buffer = b"" if row.buffer is None else row.buffer(offered)
            run = None if plan.facts.run is None else plan.facts.run(offered)
        except EVALUATION_ERRORS as error:
            raise ServiceError(f"the request of row '{plan.facts.row.name}' cannot be made: {explain(error)}") from None
        arguments = self._arguments(run, offered) if pieces and request is None else {}
        return Prepared(row, pieces, offered, run, names["station"], request, buffer, arguments, params)

    def _job(self, prepared: Prepared) -> Job:
        return Job(prepared.exchange(), prepared.pieces, partial(self._judge, prepared))

    def _arguments(self, run: Any, offered: Names) -> dict[str, Any]:
        """What a procedure that carries a transfer takes of the names of its row."""
        sequence = self.shared.protocol.sequences.get(str(run))
        return {} if sequence is None else {name: offered[name] for name in sequence.takes if name in offered}

    def _offered(self, plan: Plan, pieces: tuple[Piece, ...], names: Names) -> Names:
        if not pieces:
            return names
        variables = [self.planner.offered(plan, piece) for piece in pieces]
        offered = Names({} if len(pieces) > 1 else variables[0], names)
        offered[EACH] = variables
        return offered

    def _judge(self, asked: Prepared, outcome: Outcome) -> Answer:
        """What an exchange brought; anything but a fitting reply is a failure."""
        row, pieces, reply = asked.row, asked.pieces, outcome.reply
        names = Names({"request": asked.request}, asked.names)
        try:
            refusal = None if reply is None else self.errors.refusal(reply, names)
            if refusal is not None:
                word = outcome.outcome or refusal.outcome
                code, meaning = refusal.code, refusal.meaning
                return Answer(TransferResult(False, outcome=word, cause=outcome.cause, code=code, meaning=meaning))
            if not outcome.ok:
                return Answer(TransferResult(False, outcome=outcome.outcome, cause=outcome.cause))
            gives = self._gives(asked, outcome)
            if not pieces:
                blocks = row.reply.blocks(outcome, asked.names)
                return Answer(gives={"data": blocks} if blocks and not row.gives else gives)
            if row.request is None:
                return Answer(gives=gives)  # a procedure that wrote
            data = row.reply.data(outcome, pieces, asked.names)
            if row.facts.row.service == "read" and len(data) != len(pieces):
                raise UnfitReplyError("the reply brings no data")
            return Answer(data=data, gives=gives)
        except EVALUATION_ERRORS as error:
            return Answer(TransferResult(False, outcome="unfit_reply", cause=explain(error)))

    def _gives(self, asked: Prepared, outcome: Outcome) -> dict[str, Any]:
        if not asked.row.gives:
            return {}
        known = Names(outcome.results, asked.names)
        known.update(request=asked.request, reply=outcome.reply, buffer=outcome.buffer)
        return {name: compute(known) for name, compute in asked.row.gives}


def given_in(names: Names) -> dict[str, Any]:
    """The parameters that were given for one transfer alone, worked out."""
    return {name: value for name, value in names.items() if name != "station"}
