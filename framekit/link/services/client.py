"""The client of a protocol: READ and WRITE by address, and every other service, as exchanges of an engine.

The rows of the definition make requests and read replies; the link procedure is the engine's. A transfer consists of
exchanges, one after the other: it succeeds or fails as a whole, and a failed part fails the rest. A read that depends
only on its arguments and settings is planned once. The client repeats no request. Guide: services, errors.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import islice
from typing import Any, Protocol

from framekit.codec.shown import explain
from framekit.definition.model import protocol as model
from framekit.definition.model.frames import expressions_of, parts_of
from framekit.definition.model.values import FrameOf, LayoutOf
from framekit.link.addresses import Address
from framekit.link.events import Command, Exchange, Outcome, ServiceDone
from framekit.link.frame_table import FrameTable, ProtocolCodec
from framekit.link.own_echo import CAUSES, UNPROVED, EchoState, OwnEcho, Prove
from framekit.link.packing import cut_memory, in_unit, join_memory, memory_of, reader_of
from framekit.link.scope import Scope
from framekit.link.services.replies import ErrorReader, ReadPieces, ReplyReader, ReplyRefusal
from framekit.link.services.rows import Piece, Planner, RowFacts, RowPlan, ServiceError, arguments_of, rows_of
from framekit.link.values import EACH, EVALUATION_ERRORS, Evaluate, FrameValue, Names, compile_expression, plain
from framekit.memory.memory import unit_bits

__all__ = ["Done", "ServiceClient", "ServiceError", "TransferResult"]

MOST_PROOFS = 4
"""Upper limit of the reads that prove a suspected reply."""

MOST_KEPT = 1024
"""The most reads that are kept; then all of them are dropped, since no program repeats so many."""


class Starts(Protocol):
    """The part of an engine that a client needs: its names, and the start of exchanges."""

    @property
    def scope(self) -> Scope: ...

    @property
    def need_names(self) -> Collection[str]:
        """Return the frames that are built on names of an exchange."""

    @property
    def own_echo(self) -> OwnEcho: ...

    prove: Prove
    """Set by the client."""

    def start(self, exchange: Exchange, now: int) -> list[Command]: ...


@dataclass(slots=True)
class TransferResult:
    """The end of a transfer. `outcome` is '' or a word such as no_reply, refused, unfit_reply; `cause` adds a reason.

    `values` are the elements that were read, `data` the same as memory has them, both empty unless `ok`. `code` is the
    device's own code of a refusal, `meaning` its name. `exchanges` counts started exchanges, `written` the elements
    known to be written, also if a later part failed. `gives` are a service's results, `reply` is the last reply,
    `raw` its bytes and `buffer` the bytes that came with it.
    """

    ok: bool
    values: list[int] = field(default_factory=list)
    data: bytes = b""
    outcome: str = ""
    cause: str = ""
    code: int | None = None
    meaning: str = ""
    exchanges: int = 0
    written: int = 0
    gives: dict[str, Any] = field(default_factory=dict)
    reply: FrameValue | None = None
    raw: bytes = b""
    buffer: bytes = b""


Done = Callable[[TransferResult], None]

ReadKey = tuple[str | Address, str | None, int, Any]
"""A read: address, unit, count and station."""


class ClientRow:
    """A row as the client uses it."""

    def __init__(self, facts: RowFacts, errors: ErrorReader) -> None:
        row = facts.row
        self.facts = facts
        self.errors = errors
        self.gives = tuple(row.gives)
        self.reply = ReplyReader(facts)
        self.reads = row.service == "read"
        self.has_request = row.request is not None

    @cached_property
    def _make(self) -> Callable[[Names], Made]:
        row = self.facts.row
        return self.facts.shared.values.all((row.request, b"" if row.buffer is None else row.buffer, row.run))

    @cached_property
    def give(self) -> Callable[[Names], tuple[Any, ...]]:
        """What gives a service's results, in the order of their names."""
        return self.facts.shared.values.all(tuple(self.facts.row.gives.values()))

    def made(self, offered: Names) -> Made:
        """Return the request, the bytes that go with it, and its sequence. Raises ServiceError."""
        try:
            request, buffer, run = self._make(offered)
        except EVALUATION_ERRORS as error:
            raise ServiceError(f"the request of row '{self.facts.row.name}' cannot be made: {explain(error)}") from None
        return request, buffer, run

    def prepared(self, pieces: tuple[Piece, ...], offered: Names, station: Any, params: Mapping[str, Any]) -> Prepared:
        """An exchange of a plan, worked out. Raises ServiceError."""
        made = request, _, run = self.made(offered)
        arguments: dict[str, Any] = {}
        sequence = self.facts.shared.protocol.sequences.get(str(run)) if pieces and request is None else None
        if sequence is not None:  # a procedure carries the transfer: it takes what it names
            arguments = {name: offered[name] for name in sequence.takes if name in offered}
        written = sum(piece.count for piece in pieces if piece.data is not None)
        expected, outside = self.reply.expected, self.facts.row.outside_session
        more = bool(self.gives) or not pieces
        return Prepared(self, pieces, offered, made, station, expected, outside, arguments, params, None, written, more)


Made = tuple[FrameValue | None, bytes, Any]
"""The request of an exchange, the bytes that go with it, and the name of its sequence."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """One exchange of a row, to be carried out any number of times: its request, and the readers of its replies.

    `written`: the number of elements that it writes.
    """

    row: ClientRow
    pieces: tuple[Piece, ...]
    names: Names
    made: Made
    station: Any
    expected: tuple[str, ...]
    outside_session: bool
    arguments: Mapping[str, Any] = field(default_factory=dict)
    params: Mapping[str, Any] = field(default_factory=dict)
    inside: Any = None
    written: int = 0
    has_results: bool = False
    """The exchange may bring more than the data of its pieces."""
    readers: dict[str | None, ReadPieces] = field(default_factory=dict)
    """What reads the data of the pieces, by the frame of the reply."""

    def reader(self, frame: str | None) -> ReadPieces:
        """Return what reads the data of the pieces from such replies, and keep it for later exchanges."""
        reply = self.row.reply
        data = reply.reader(frame, self.pieces, self.names) if self.pieces and self.row.has_request else _no_data

        def refused(reply: FrameValue | None, buffer: bytes, request: FrameValue | None) -> list[bytes]:
            refusal = self.refusal(reply, request)
            if refusal is not None:
                raise RefusedReplyError(refusal)
            return data(reply, buffer, request)

        found = self.readers[frame] = refused if frame in reply.error_frames else data
        return found

    def refusal(self, reply: FrameValue | None, request: FrameValue | None) -> ReplyRefusal | None:
        """Return the refusal in a reply, if any. Raises EVALUATION_ERRORS."""
        if reply is None or reply.frame not in self.row.reply.error_frames:
            return None
        return self.row.errors.refusal(reply, Names({"request": request, "reply": reply}, self.names))

    def results(
        self, results: Mapping[str, Any], reply: FrameValue | None, buffer: bytes, request: FrameValue | None
    ) -> dict[str, Any]:
        """Return a service's results, from a reply to `request`. Raises EVALUATION_ERRORS."""
        row = self.row
        if row.gives:
            known = Names(results, self.names)
            known.update(request=request, reply=reply, buffer=buffer)
            return dict(zip(row.gives, row.give(known), strict=True))
        blocks = [] if self.pieces else row.reply.blocks(reply, buffer, self.names)
        return {"data": blocks} if blocks else {}


def _no_data(reply: FrameValue | None, buffer: bytes, request: FrameValue | None) -> list[bytes]:
    return []


class RefusedReplyError(Exception):
    """A reply refuses the request."""

    def __init__(self, refusal: ReplyRefusal) -> None:
        super().__init__(refusal)
        self.refusal = refusal


Wanted = tuple[str, int, str]
"""A part of a read: unit, count, and the byte order of its area."""


class TransferPlan:
    """A whole transfer: its exchanges, and the elements that they read.

    `sent`: the requests, unless `is_new_each_time`, which makes them anew for every transfer.
    """

    __slots__ = (
        "exchanges",
        "given",
        "is_new_each_time",
        "is_single",
        "numbers",
        "plans",
        "sent",
        "wanted",
    )

    def __init__(self, plans: Sequence[RowPlan], exchanges: Sequence[Prepared], wanted: Sequence[Wanted]) -> None:
        self.plans, self.exchanges, self.wanted = plans, exchanges, wanted
        self.sent = [one.made for one in exchanges]
        self.given = [
            (one.station, one.expected, one.outside_session, one.inside, one.arguments, one.params) for one in exchanges
        ]
        self.is_new_each_time = False
        self.numbers: Callable[[bytes], Iterable[int]] | None = None
        """Return the numbers in the data of the only piece; None if the transfer has several pieces or views."""
        if len(wanted) == len(plans) == len(exchanges) == len(exchanges[0].pieces) == 1:
            unit, count, order = wanted[0]
            bits, own = plans[0].bits, exchanges[0].pieces[0].address.unit
            is_alike = (order == "little" or unit == own) and not plans[0].skip
            if is_alike and exchanges[0].pieces[0].bits == bits == count * unit_bits(unit):
                self.numbers = reader_of(unit, count)
        row = exchanges[0].row if len(exchanges) == 1 else None
        self.is_single = self.numbers is not None and row is not None and not row.gives and row.reads
        """One exchange brings one place and no results."""

    def made(self) -> list[Made]:
        """Make the requests for one transfer. Raises ServiceError."""
        return [one.row.made(one.names) for one in self.exchanges]

    def result(self, data: Sequence[bytes]) -> TransferResult:
        """Return the result for the data of all exchanges."""
        if self.numbers is not None:
            return TransferResult(True, list(self.numbers(data[0])), data[0])
        if not self.wanted:
            return TransferResult(True)
        parts, place = [], 0
        for plan in self.plans:
            pieces = [piece for exchange in plan.exchanges for piece in exchange]
            brought = data[place : place + len(pieces)]
            areas = plan.facts.shared.protocol.areas
            whole = join_memory(
                [
                    (in_unit(part, areas[piece.address.area].order, piece.address.unit, "byte"), piece.bits)
                    for part, piece in zip(brought, pieces, strict=True)
                ]
            )
            parts.append((cut_memory(whole, plan.skip, plan.bits), plan.bits))  # what was read to be aligned goes
            place += len(pieces)
        whole, first = join_memory(parts), 0
        values: list[int] = []
        found: list[tuple[bytes, int]] = []
        for unit, count, order in self.wanted:
            bits = count * unit_bits(unit)
            found.append((in_unit(cut_memory(whole, first, bits), order, "byte", unit), bits))
            values.extend(reader_of(unit, count)(found[-1][0]))
            first += bits
        return TransferResult(True, values, join_memory(found))


class ReadCall:
    """A read by its arguments. Its plan is kept until a parameter changes, if only parameters decide on it."""

    __slots__ = ("_key", "_plan", "_settings", "spare")

    def __init__(self, key: ReadKey) -> None:
        self._key = key
        self._plan: TransferPlan | None = None
        self._settings = -1
        self.spare: Transfer | None = None
        """A finished transfer that can be begun again."""

    def plan(self, client: ServiceClient) -> TransferPlan:
        """Return the plan. Raises AddressError, ServiceError, PackingError."""
        plan = self._plan
        if plan is None or client.engine.scope.settings != self._settings:
            plan = client.planned_read(self._key, None)
            self._plan = plan if client.lasting.keeps(plan) else None
            self._settings = client.engine.scope.settings
        return plan

    def start(self, client: ServiceClient, now: int, on_done: Done) -> Transfer:
        """Begin the read, as `ServiceClient.read`."""
        plan, spare = self.plan(client), self.spare
        if spare is not None:
            self.spare = None
            if spare.again(plan, now, on_done) is not None:
                return spare
        return Transfer(plan, client.engine, now, on_done, self)


class LastingPlans:
    """Judges which plans of reads can be carried out again: those that only parameters decide on."""

    def __init__(self, scope: Scope, need_names: Collection[str]) -> None:
        self._scope = scope
        self._need_names = need_names
        self._chosen: dict[RowFacts, bool] = {}
        self._lasting: dict[RowFacts, bool] = {}

    def keeps(self, read: TransferPlan) -> bool:
        """Return whether a plan consists of the same exchanges as long as no parameter changes, and prepare it so."""
        facts = read.exchanges[0].row.facts
        rows = facts.shared.rows[facts.row.service]
        if not all(self._is_chosen_the_same(row) for row in rows):
            return False
        # a frame inside a request takes note of being sent, so it cannot be sent twice
        lasts = self._lasts(facts) and not any(_has_parts(one.made[0]) for one in read.exchanges)
        read.is_new_each_time = not lasts
        if lasts:
            self._build(read, facts.shared.table)
        return True

    def _build(self, read: TransferPlan, table: FrameTable) -> None:
        """Encode the requests whose bytes do not depend on an exchange."""
        for request, _, _ in read.sent:
            if request is None or request.frame in self._need_names:
                continue
            info = table.infos[request.frame]
            if info.on_line or len(request.fields) == info.count:
                try:
                    request.built = info.encode(plain(request.fields), self._scope)
                except EVALUATION_ERRORS:
                    continue

    def _is_chosen_the_same(self, facts: RowFacts) -> bool:
        """Return whether parameters alone decide on a row and its cuts."""
        if facts not in self._chosen:
            row = facts.row
            self._chosen[facts] = not any(
                self._scope.changes(it) for it in expressions_of([row.when, row.limit, row.run])
            )
        return self._chosen[facts]

    def _lasts(self, facts: RowFacts) -> bool:
        """Return whether a row's request depends on parameters alone."""
        if facts not in self._lasting:
            protocol, sent = facts.shared.protocol, [facts.row.request, facts.row.buffer]
            made: Sequence[Any] = [
                *(protocol.frames[part.frame].segments for part in parts_of(sent, FrameOf)),
                *(protocol.layouts[part.layout].segments for part in parts_of(sent, LayoutOf)),
            ]
            self._lasting[facts] = not any(self._scope.changes(part) for part in expressions_of([sent, made]))
        return self._lasting[facts]


def _has_parts(value: Any) -> bool:
    """Whether frames stand in a request."""
    if isinstance(value, FrameValue):
        value = value.fields
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return any(isinstance(one, FrameValue) or _has_parts(one) for one in parts)


class Transfer(Exchange):
    """One transfer under way: it is each of its exchanges, one after the other."""

    _data: list[bytes]
    _gives: dict[str, Any]

    __slots__ = (
        "__weakref__", "_data", "_done", "_engine", "_gives", "_goes_on", "_going", "_made", "_next", "_plan",
        "_read", "_written", "commands", "given_up",
    )  # fmt: skip

    def __init__(
        self, plan: TransferPlan, engine: Starts, now: int, on_done: Done, read: ReadCall | None = None
    ) -> None:  # fmt: skip
        self._plan, self._engine, self._done = plan, engine, on_done
        self._read = read
        """The read that may begin it again."""
        self._made = plan.made() if plan.is_new_each_time else plan.sent
        self._next = self._written = 0
        self.given_up = self.gives_way = False
        """Begin no further exchange."""
        self.commands: list[Command] = []
        """The commands of the engine because it began."""
        if self._made:
            self._go(now)
        else:
            self._end(plan.result(()), None, b"", b"")

    def _go(self, now: int) -> None:
        """Start exchanges as long as each ends at once."""
        self._going = self._goes_on = True
        while self._goes_on:
            if self.given_up:
                self._end(TransferResult(False, outcome="cancelled"), None, b"", b"")
                break
            place = self._next
            self.request, self.buffer, self.run = self._made[place]
            given = self._plan.given[place]
            self.station, self.expected, self.outside_session, self.inside, self.arguments, self.params = given
            self._next = place + 1
            self._goes_on = False
            commands = self._engine.start(self, now)
            self.commands = self.commands + commands if self.commands else commands
        self._going = False

    def again(self, plan: TransferPlan, now: int, on_done: Done) -> list[Command] | None:
        """Begin the transfer once more after `brought`, when it is not in use; None if another object is needed."""
        if self._plan is not plan or plan.is_new_each_time:
            return None
        self.request, self.buffer, self.run = self._made[0]
        self._done, self._next, self.given_up = on_done, 1, False
        self.commands = commands = self._engine.start(self, now)
        return commands

    def reports_to(self, on_done: Done) -> bool:
        """Return whether it is under way for the caller that gave this callback."""
        return self._done == on_done

    def succeeded(self, results: dict[str, Any]) -> None:
        """Read the reply, and go on with the next exchange or end."""
        reply, buffer = results.get("reply"), results.get("buffer", b"")
        if type(reply) is not FrameValue:
            reply = None
        if type(buffer) is not bytes:
            buffer = b""
        plan, place = self._plan, self._next - 1
        one, request = plan.exchanges[place], self._made[place][0]
        frame = None if reply is None else reply.frame
        try:
            data = (one.readers.get(frame) or one.reader(frame))(reply, buffer, request)
            gives = one.results(results, reply, buffer, request) if one.has_results else {}
        except EVALUATION_ERRORS as error:
            self._end(TransferResult(False, outcome="unfit_reply", cause=explain(error)), reply, self.raw, buffer)
            return
        except RefusedReplyError as error:
            self._end(_refused(error.refusal, error.refusal.outcome, ""), reply, self.raw, buffer)
            return
        if plan.is_single:
            done, self._done = self._done, _ended  # no reference to itself remains, so it is freed at once
            self.brought(data[0], reply, buffer, done)
            return
        self._data = self._data + data if place else data
        self._gives = {**self._gives, **gives} if place else gives
        self._written += one.written
        if self._next == len(self._made):
            result = plan.result(self._data)
            result.gives = self._gives
            self._end(result, reply, self.raw, buffer)
        else:
            self._goes_on = True
            if not self._going:
                self._go(self._engine.scope.now)

    def may_repeat(self) -> bool:
        """Return whether the present exchange only reads, or `retries` is not 0.

        Protocols without this parameter repeat writes, too: their procedures send a block until it is acknowledged.
        """
        if self._plan.exchanges[self._next - 1].row.reads:
            return True
        retries = self.params["retries"] if "retries" in self.params else self._engine.scope.get("retries")
        return bool(retries != 0)

    def suspected(self, results: dict[str, Any]) -> None:
        """Have it proved that the reply is no echo of the request, then read it."""
        self._engine.prove(self._plan.exchanges[self._next - 1], partial(self._proved, results))

    def _proved(self, results: dict[str, Any], cause: str) -> None:
        """Believe the suspected reply, or end without a reply; `cause` is why it is not believed."""
        if cause:
            self._end(TransferResult(False, outcome="no_reply", cause=cause), None, b"", b"")
        else:
            self.succeeded(results)

    def brought(self, data: bytes, reply: FrameValue | None, buffer: bytes, done: Done) -> None:
        """Report the data of one place that a single exchange has read; they have the size that was requested."""
        numbers, taken = self._plan.numbers, self.taken
        assert numbers is not None  # the plan `is_single`
        if self._read is not None:
            self._read.spare = self
        raw = b"" if taken is None else taken.raw or b""
        done(TransferResult(True, list(numbers(data)), data, "", "", None, "", 1, 0, {}, reply, raw, buffer))

    def ended(self, outcome: Outcome) -> None:
        """End with a failure; if the reply is a refusal, with its code."""
        place = self._next - 1
        one, request = self._plan.exchanges[place], self._made[place][0]
        result = TransferResult(False, outcome=outcome.failure_name, cause=outcome.cause)
        try:
            refusal = one.refusal(outcome.reply, request)
            if refusal is not None:
                result = _refused(refusal, outcome.outcome or refusal.outcome, outcome.cause)
        except EVALUATION_ERRORS as error:
            result = TransferResult(False, outcome="unfit_reply", cause=explain(error))
        self._end(result, outcome.reply, outcome.raw, outcome.buffer)

    def _end(self, result: TransferResult, reply: FrameValue | None, raw: bytes, buffer: bytes) -> None:
        result.exchanges, result.written = self._next, self._written
        result.reply, result.raw, result.buffer = reply, raw, buffer
        done, self._done = self._done, _ended  # no reference to itself remains, so it is freed at once
        done(result)


class Proof(Transfer):
    """A read that proves whether the line has an echo: its own reply need not be proved."""

    __slots__ = ()

    def suspected(self, results: dict[str, Any]) -> None:
        """Read the reply."""
        self.succeeded(results)


def _refused(refusal: ReplyRefusal, outcome: str, cause: str) -> TransferResult:
    return TransferResult(False, outcome=outcome, cause=cause, code=refusal.code, meaning=refusal.meaning)


def _ended(result: TransferResult) -> None:
    """Ignore the result of a transfer that has ended before."""


class ServiceClient:
    """READ, WRITE and other services over one engine.

    Every method gives the transfer that it begins, with the engine's commands, and calls `on_done` exactly once,
    perhaps before it returns. What cannot be asked at all is raised before anything is sent: AddressError,
    ServiceError, PackingError (all ValueError).
    `params` are names for this transfer alone, its rows and its sequences; they go before the protocol's parameters.
    """

    def __init__(self, protocol: model.Protocol, codec: ProtocolCodec, engine: Starts) -> None:
        self.engine = engine
        engine.prove = self.prove
        self.shared = rows_of(protocol, codec)
        self.planner = Planner(self.shared)
        self.grammar = self.shared.grammar.naming(lambda address: self.planner.serves(address, self._names(None, None)))
        errors = ErrorReader(self.shared)
        default = protocol.station.default
        self._default_station = None if default is None else compile_expression(default)(Names())
        self.lasting = LastingPlans(engine.scope, engine.need_names)
        self._reads: dict[ReadKey, ReadCall] = {}
        self._rows = {facts: ClientRow(facts, errors) for rows in self.shared.rows.values() for facts in rows}

    # ---- read and write -----------------------------------------------------------------------------------

    def read(
        self, address: str | Address, *, station: Any = None, unit: str | None = None, count: int = 1,
        params: Mapping[str, Any] | None = None, now: int, on_done: Done,
    ) -> Transfer:  # fmt: skip
        """Reads `count` elements of `unit` (default: the address's own)."""
        key = address, unit, count, station
        if params:
            return Transfer(self.planned_read(key, params), self.engine, now, on_done)
        return self.reading(key).start(self, now, on_done)

    def reading(self, key: ReadKey) -> ReadCall:
        """Return a read without parameters of its own, which is planned when it begins."""
        found = self._reads.get(key)
        if found is None:
            if len(self._reads) >= MOST_KEPT:
                self._reads.clear()
            found = self._reads[key] = ReadCall(key)
        return found

    def planned_read(self, key: ReadKey, params: Mapping[str, Any] | None) -> TransferPlan:
        """Plan a read. Raises AddressError, ServiceError, PackingError."""
        address, unit, count, station = key
        names = self._names(station, params)
        place, elements = self._place(address, unit, count)
        plan = self.planner.plan("read", Piece(place, elements), names)
        return self._planned([plan], [(unit or place.unit, count, self._order(place))], names)

    def write(
        self, address: str | Address, values: Sequence[int], *, station: Any = None, unit: str | None = None,
        params: Mapping[str, Any] | None = None, now: int, on_done: Done,
    ) -> Transfer:  # fmt: skip
        """Writes the values to as many elements."""
        names = self._names(station, params)
        place, elements = self._place(address, unit, len(values))
        piece = Piece(place, elements, self._data(place, unit, values))
        plan = self._planned([self.planner.plan("write", piece, names)], [], names)
        return Transfer(plan, self.engine, now, on_done)

    def read_variables(
        self, addresses: Sequence[str | Address], *, station: Any = None, unit: str | None = None,
        params: Mapping[str, Any] | None = None, now: int, on_done: Done,
    ) -> Transfer:  # fmt: skip
        """Read one element each; in lists if the protocol has them. Values in the order of addresses."""
        names = self._names(station, params)
        pieces = [Piece(*self._place(address, unit, 1)) for address in addresses]
        plans = self.planner.plan_list("read", pieces, names)
        wanted = [(unit or piece.address.unit, 1, self._order(piece.address)) for piece in pieces]
        return Transfer(self._planned(plans, wanted, names), self.engine, now, on_done)

    def write_variables(
        self, addresses: Sequence[str | Address], values: Sequence[int], *, station: Any = None,
        unit: str | None = None, params: Mapping[str, Any] | None = None, now: int, on_done: Done,
    ) -> Transfer:  # fmt: skip
        """Writes one value each."""
        if len(addresses) != len(values):
            raise ServiceError(f"there are {len(addresses)} addresses for {len(values)} values")
        names = self._names(station, params)
        pieces = []
        for address, value in zip(addresses, values, strict=True):
            place, elements = self._place(address, unit, 1)
            pieces.append(Piece(place, elements, self._data(place, unit, [value])))
        plans = self.planner.plan_list("write", pieces, names)
        return Transfer(self._planned(plans, [], names), self.engine, now, on_done)

    # ---- replies that may be an own echo ------------------------------------------------------------------

    def prove(self, suspected: Prepared, done: Callable[[str], None]) -> None:
        """Read other places until a reply comes that is not equal to its request: it proves that the line has no echo.

        Report by `done` why the reply to the suspected exchange is not believed; '' if it is.
        """
        self._prove_by(islice(self._proofs(suspected), MOST_PROOFS), done)

    def _prove_by(self, reads: Iterator[TransferPlan], done: Callable[[str], None]) -> None:
        """Carry out the next of these reads, and the others while the state of the echo is unknown."""
        plan = next(reads, None)
        if plan is None:
            done(UNPROVED)
            return

        def ended(result: TransferResult) -> None:
            state = self.engine.own_echo.state
            if state is EchoState.UNKNOWN and result.ok:
                self._prove_by(reads, done)
            else:
                done(CAUSES[state])

        Proof(plan, self.engine, self.engine.scope.now, ended)

    def _proofs(self, suspected: Prepared) -> Iterator[TransferPlan]:
        """Plan reads of the place that was written, of its neighbours, and of the beginning of each area."""
        pieces = suspected.pieces
        places = [piece.address for piece in pieces if piece.data is not None]
        places += [Address(at.area, at.unit, at.start + 1, parts=at.parts) for at in (one.address for one in pieces)]
        places += [Address(name, area.unit, 0) for name, area in self.grammar.areas.items()]
        for place in places:
            try:
                plan = self.planned_read((place, None, 1, suspected.station), suspected.params)
            except ValueError:  # this place cannot be read
                continue
            exchanges = [replace(one, inside=suspected.inside) for one in plan.exchanges]
            yield TransferPlan(plan.plans, exchanges, plan.wanted)

    # ---- names and places ---------------------------------------------------------------------------------

    def _names(self, station: Any, params: Mapping[str, Any] | None) -> Names:
        """Return the names of a request. Raises ParameterError for a parameter that does not fit."""
        scope = self.engine.scope
        names = Names(scope.worked_out(params), scope, scope.formulas_for(params)) if params else Names(None, scope)
        names["station"] = self._default_station if station is None else station
        return names

    def _order(self, place: Address) -> str:
        return self.grammar.areas[place.area].order

    def _data(self, place: Address, unit: str | None, values: Sequence[int]) -> bytes:
        """Values of a unit as elements of the place's own. Raises PackingError."""
        given = unit or place.unit
        return in_unit(memory_of(values, given), self._order(place), given, place.unit)

    def _planned(self, plans: Sequence[RowPlan], wanted: Sequence[Wanted], names: Names) -> TransferPlan:
        """Return the exchanges of all plans; `wanted` are the parts of the read. Raises ServiceError."""
        given = given_in(names)
        exchanges = [self._prepared(plan, pieces, names, given) for plan in plans for pieces in plan.exchanges]
        return TransferPlan(plans, exchanges, wanted)

    def _prepared(self, plan: RowPlan, pieces: tuple[Piece, ...], names: Names, params: Mapping[str, Any]) -> Prepared:
        offered = names
        if pieces:
            variables = [self.planner.offered(plan, piece) for piece in pieces]
            same = plan.facts.row.same
            shared = {} if same is None else {same: variables[0][same]}
            offered = Names(shared if len(pieces) > 1 else variables[0], names)
            offered[EACH] = variables
        return self._rows[plan.facts].prepared(pieces, offered, names["station"], params)

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
    ) -> Transfer:  # fmt: skip
        """Runs any service but read and write. One address stands for `count` elements, several for one each."""
        return self._call(service, arguments or {}, station, addresses, unit, count, params, on_done, None, now)

    def ask(self, service: str, arguments: dict[str, Any], station: Any, done: ServiceDone) -> None:
        """For the engine's `ask` steps: a service whose exchanges run inside the step. A refusal is a failure."""

        def ended(result: TransferResult) -> None:
            cause = result.cause or result.meaning
            done(Outcome(result.ok, result.outcome, cause, results=result.gives, raw=result.raw))

        self._call(service, arguments, station, (), None, 1, done.params, ended, done, self.engine.scope.now)

    def _call(
        self, service: str, arguments: Mapping[str, Any], station: Any, addresses: Sequence[str | Address],
        unit: str | None, count: int, params: Mapping[str, Any] | None, on_done: Done, inside: Any, now: int,
    ) -> Transfer:  # fmt: skip
        rows = self.shared.rows.get(service)
        if not rows or service in ("read", "write"):
            known = ", ".join(name for name in self.shared.rows if name not in ("read", "write"))
            hint = f"known: {known}" if known else "this protocol has none beside read and write"
            raise ServiceError(f"there is no service '{service}' to call – {hint}")
        names = self._names(station, params)
        each = count if len(addresses) == 1 else 1
        pieces = [Piece(*self._place(address, unit, each)) for address in addresses]
        facts, offered = self._row_for(rows, arguments, pieces, names)
        plan = RowPlan(
            facts, (tuple(pieces),), 0, sum(piece.count for piece in pieces), 0, sum(piece.bits for piece in pieces)
        )
        prepared = self._prepared(plan, tuple(pieces), offered, given_in(names))
        arguments = {argument.name: offered[argument.name] for argument in facts.row.takes}
        prepared = replace(prepared, arguments=arguments, inside=inside)
        return Transfer(TransferPlan([plan], [prepared], []), self.engine, now, on_done)

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
            if not all(self.planner.has_list(facts, piece, names) for piece in pieces):
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


def given_in(names: Names) -> dict[str, Any]:
    """The parameters that were given for one transfer alone, worked out."""
    return {name: value for name, value in names.items() if name != "station"}


def _may_hold(when: Evaluate | None, names: Names) -> bool:
    """Return whether a row's condition may hold: False only if no arguments of the call can change that."""
    try:
        return when is None or bool(when(names))
    except EVALUATION_ERRORS:
        return True
