"""The client of a protocol: READ and WRITE by address, and every other service, as exchanges of an engine.

It makes requests and judges replies by the rows of the definition; the link procedure is the engine's. Nothing is
retried here. Language reference, sections 11 and 13.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

from framekit.definition.model import protocol as model
from framekit.link.addresses import Address
from framekit.link.construct_values import EACH
from framekit.link.evaluate import EVALUATION_ERRORS, Evaluate, Names, compile_expression
from framekit.link.events import Command
from framekit.link.exchange import Asked, Exchange, Outcome
from framekit.link.frame_table import Codec
from framekit.link.packing import memory_of
from framekit.link.ready import CompiledRow, Prepared, ReadyRead, ReadyReads
from framekit.link.replies import ErrorReader, UnfitReplyError
from framekit.link.requests import Piece, Plan, Planner, ServiceError
from framekit.link.service_arguments import arguments_of
from framekit.link.service_rows import RowFacts, ServiceRows
from framekit.link.transfer import Answer, Done, Job, Transfer, TransferResult, elements
from framekit.memory.numbers import unit_bits

__all__ = ["Client", "ServiceError", "TransferResult"]


class Starts(Protocol):
    """What a client needs of an engine: its names, and exchanges started on it."""

    @property
    def scope(self) -> Any: ...

    def start(self, exchange: Exchange, now: int) -> list[Command]: ...


class Client:
    """READ, WRITE and other services over one engine.

    Every method returns the engine's commands and calls `on_done` exactly once, perhaps before it returns. What cannot
    be asked at all is raised before anything is sent: AddressError, ServiceError, PackingError (all ValueError).
    `params` are names for this transfer alone, its rows and its sequences; they go before the protocol's parameters.
    """

    def __init__(self, protocol: model.Protocol, codec: Codec, engine: Starts) -> None:
        self.engine = engine
        self.shared = ServiceRows(protocol, codec)
        self.grammar = self.shared.grammar
        self.planner = Planner(self.shared)
        self.errors = ErrorReader(self.shared)
        default = protocol.station.default
        self._default_station = None if default is None else compile_expression(default)(Names())
        self._ready = ReadyReads(engine.scope)
        self._rows = {facts: CompiledRow(facts) for rows in self.shared.rows.values() for facts in rows}

    # ---- read and write -----------------------------------------------------------------------------------

    def read(
        self, address: str | Address, *, station: Any = None, unit: str | None = None, count: int = 1,
        params: Mapping[str, Any] | None = None, now: int, on_done: Done,
    ) -> list[Command]:  # fmt: skip
        """Reads `count` elements of `unit` (default: the address's own)."""
        key = None if params else (address, unit, count, station)
        ready = None if key is None else self._ready.find(key)
        if ready is None:
            names = self._names(station, params)
            place, elements = self._place(address, unit, count)
            plan = self.planner.plan("read", Piece(place, elements), names)
            exchanges = tuple(self._prepared(plan, pieces, names, _given(names)) for pieces in plan.exchanges)
            ready = ReadyRead(plan, exchanges, unit or place.unit, count)
            if key is not None:
                self._ready.keep(key, ready)
        return self._begin_read([ready.plan], [(ready.unit, ready.count)], ready.exchanges, now, on_done)

    def write(
        self, address: str | Address, values: Sequence[int], *, station: Any = None, unit: str | None = None,
        params: Mapping[str, Any] | None = None, now: int, on_done: Done,
    ) -> list[Command]:  # fmt: skip
        """Writes the values to as many elements."""
        names = self._names(station, params)
        place, elements = self._place(address, unit, len(values))
        piece = Piece(place, elements, memory_of(values, unit or place.unit))
        return self._transfer([self.planner.plan("write", piece, names)], [], names, now, on_done)

    def read_variables(
        self, addresses: Sequence[str | Address], *, station: Any = None, unit: str | None = None,
        params: Mapping[str, Any] | None = None, now: int, on_done: Done,
    ) -> list[Command]:  # fmt: skip
        """Reads one element each; in lists where the protocol has them, else one by one. Values in the order asked."""
        names = self._names(station, params)
        pieces = [Piece(*self._place(address, unit, 1)) for address in addresses]
        plans = self.planner.plan_list("read", pieces, names)
        return self._transfer(plans, [(unit or piece.address.unit, 1) for piece in pieces], names, now, on_done)

    def write_variables(
        self, addresses: Sequence[str | Address], values: Sequence[int], *, station: Any = None,
        unit: str | None = None, params: Mapping[str, Any] | None = None, now: int, on_done: Done,
    ) -> list[Command]:  # fmt: skip
        """Writes one value each."""
        if len(addresses) != len(values):
            raise ServiceError(f"there are {len(addresses)} addresses for {len(values)} values")
        names = self._names(station, params)
        pieces = []
        for address, value in zip(addresses, values, strict=True):
            place, elements = self._place(address, unit, 1)
            pieces.append(Piece(place, elements, memory_of([value], unit or place.unit)))
        plans = self.planner.plan_list("write", pieces, names)
        return self._transfer(plans, [], names, now, on_done)

    def _place(self, address: str | Address, unit: str | None, count: int) -> tuple[Address, int]:
        """Where `count` elements of `unit` begin, and how many elements of the place's own unit they are.

        A place that is at no multiple of a larger unit stays in its own: a double word may begin at any word.
        """
        if count < 1:
            raise ServiceError("there is nothing to transfer: the count is 0")
        place = self.grammar.parse(address) if isinstance(address, str) else address
        if unit is not None and unit != place.unit:
            width = unit_bits(unit)
            if width % place.unit_bits == 0 and place.first_bit % width:
                count *= width // place.unit_bits
            else:
                place = self.grammar.in_unit(place, unit)
        self.grammar.check(place, count)
        return place, count

    # ---- other services -----------------------------------------------------------------------------------

    def call(
        self, service: str, arguments: Mapping[str, Any] | None = None, *, station: Any = None,
        addresses: Sequence[str | Address] = (), unit: str | None = None, count: int = 1,
        params: Mapping[str, Any] | None = None, now: int, on_done: Done,
    ) -> list[Command]:  # fmt: skip
        """Runs any service but read and write. One address stands for `count` elements, several for one each."""
        return self._call(service, arguments or {}, station, addresses, unit, count, params, on_done, None, now)

    def ask(self, service: str, arguments: dict[str, Any], station: Any, done: Asked) -> None:
        """For the engine's `ask` steps: a service whose exchanges run inside the step. A refusal is a failure."""

        def ended(result: TransferResult) -> None:
            cause = result.cause or result.meaning
            done(Outcome(result.ok, result.outcome, cause, results=result.gives, raw=result.raw))

        self._call(service, arguments, station, (), None, 1, done.params, ended, done, self.engine.scope.now)

    def _call(
        self, service: str, arguments: Mapping[str, Any], station: Any, addresses: Sequence[str | Address],
        unit: str | None, count: int, params: Mapping[str, Any] | None, on_done: Done, inside: Any, now: int,
    ) -> list[Command]:  # fmt: skip
        rows = self.shared.rows.get(service)
        if not rows or service in ("read", "write"):
            known = ", ".join(name for name in self.shared.rows if name not in ("read", "write"))
            raise ServiceError(f"there is no service '{service}' to call – known: {known}")
        names = self._names(station, params)
        each = count if len(addresses) == 1 else 1
        pieces = [Piece(*self._place(address, unit, each)) for address in addresses]
        facts, offered = self._row_for(rows, arguments, pieces, names)
        plan = Plan(
            facts, (tuple(pieces),), 0, sum(piece.count for piece in pieces), 0, sum(piece.bits for piece in pieces)
        )
        job = self._job(self._prepared(plan, tuple(pieces), offered, _given(names)))
        exchange = job.exchange
        exchange.inside = inside
        exchange.arguments = {argument.name: offered[argument.name] for argument in facts.row.takes}
        return self._begin([job], lambda data: TransferResult(True), now, on_done)

    def _row_for(
        self, rows: Sequence[RowFacts], arguments: Mapping[str, Any], pieces: list[Piece], names: Names
    ) -> tuple[RowFacts, Names]:
        """The first row that takes these arguments and addresses and whose condition holds."""
        problem: ServiceError | None = None
        for facts in rows:
            if bool(pieces) != facts.wants_address or (len(pieces) > 1 and not facts.has_each):
                continue
            if facts.single and any(piece.count > 1 for piece in pieces):
                continue
            if len(pieces) > 1 and len(pieces) > facts.row.most_variables:
                problem = ServiceError(f"'{facts.row.service}' takes at most {facts.row.most_variables} addresses")
                continue
            if not _may_hold(facts.when, names):
                continue
            try:
                offered = Names(arguments_of(facts, arguments, names), names)
                if facts.when is None or facts.when(offered):
                    return facts, offered
            except ServiceError as error:
                problem = problem or error
            except EVALUATION_ERRORS as error:
                problem = ServiceError(f"the condition of row '{facts.row.name}' cannot be worked out: {error!r}")
        kind = f"{len(pieces)} addresses" if pieces else "no address"
        raise problem or ServiceError(f"no row of '{rows[0].row.service}' fits these arguments and {kind}")

    # ---- exchanges ----------------------------------------------------------------------------------------

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
        given = _given(names)
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
            raise ServiceError(f"the request of row '{plan.facts.row.name}' cannot be made: {error}") from None
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
                word = outcome.outcome or "refused"
                code, meaning = refusal
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
            return Answer(TransferResult(False, outcome="unfit_reply", cause=str(error)))

    def _gives(self, asked: Prepared, outcome: Outcome) -> dict[str, Any]:
        if not asked.row.gives:
            return {}
        known = Names(outcome.results, asked.names)
        known.update(request=asked.request, reply=outcome.reply, buffer=outcome.buffer)
        return {name: compute(known) for name, compute in asked.row.gives}


def _given(names: Names) -> dict[str, Any]:
    """The parameters that were given for one transfer alone, worked out."""
    return {name: value for name, value in names.items() if name != "station"}


def _may_hold(when: Evaluate | None, names: Names) -> bool:
    """Whether a row's condition may hold: False only where that is sure without the arguments of the call."""
    try:
        return when is None or bool(when(names))
    except EVALUATION_ERRORS:
        return True
