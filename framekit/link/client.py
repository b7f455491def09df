"""The client of a protocol: READ and WRITE by address, and every other service, as exchanges of an engine.

It makes requests and judges replies by the rows of the definition; the link procedure is the engine's. Nothing is
retried here. Language reference, sections 11 and 13.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from framekit.codec.shown import explain
from framekit.link.addresses import Address
from framekit.link.client_exchanges import ClientExchanges, given_in
from framekit.link.evaluate import EVALUATION_ERRORS, Evaluate, Names
from framekit.link.events import Command
from framekit.link.exchange import Asked, Outcome
from framekit.link.packing import memory_of
from framekit.link.ready import ReadyRead
from framekit.link.requests import Piece, Plan, ServiceError
from framekit.link.service_arguments import arguments_of
from framekit.link.services.rows import RowFacts
from framekit.link.transfer import Done, TransferResult
from framekit.memory.memory import unit_bits

__all__ = ["Client", "ServiceError", "TransferResult"]


class Client(ClientExchanges):
    """READ, WRITE and other services over one engine.

    Every method returns the engine's commands and calls `on_done` exactly once, perhaps before it returns. What cannot
    be asked at all is raised before anything is sent: AddressError, ServiceError, PackingError (all ValueError).
    `params` are names for this transfer alone, its rows and its sequences; they go before the protocol's parameters.
    """

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
            exchanges = tuple(self._prepared(plan, pieces, names, given_in(names)) for pieces in plan.exchanges)
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
            hint = f"known: {known}" if known else "this protocol has none beside read and write"
            raise ServiceError(f"there is no service '{service}' to call – {hint}")
        names = self._names(station, params)
        each = count if len(addresses) == 1 else 1
        pieces = [Piece(*self._place(address, unit, each)) for address in addresses]
        facts, offered = self._row_for(rows, arguments, pieces, names)
        plan = Plan(
            facts, (tuple(pieces),), 0, sum(piece.count for piece in pieces), 0, sum(piece.bits for piece in pieces)
        )
        job = self._job(self._prepared(plan, tuple(pieces), offered, given_in(names)))
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
                problem = ServiceError(
                    f"the condition of row '{facts.row.name}' cannot be worked out: {explain(error)}"
                )
        kind = f"{len(pieces)} addresses" if pieces else "no address"
        raise problem or ServiceError(f"no row of '{rows[0].row.service}' fits these arguments and {kind}")


def _may_hold(when: Evaluate | None, names: Names) -> bool:
    """Whether a row's condition may hold: False only where that is sure without the arguments of the call."""
    try:
        return when is None or bool(when(names))
    except EVALUATION_ERRORS:
        return True
