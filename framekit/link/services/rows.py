"""A service row prepared for both sides: its names, the units that it can carry, the packing of its data.

Clients and servers read the same rows; this module does the work of neither. Guide: services.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.expression import Expression, names_in, ordered_by_need
from framekit.definition.model.frames import everything, parts_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import Argument
from framekit.definition.model.segments import Data, Segment
from framekit.definition.model.services import AS_NUMBERS, COUNTING, AreaModel, Refusal, ServiceRow, mentions_of
from framekit.definition.model.values import EachOf, FrameOf
from framekit.definition.problems import did_you_mean, listed
from framekit.link.addresses import Address, AddressGrammar, code_of
from framekit.link.frame_table import ProtocolCodec, made_once, table_of
from framekit.link.packing import Packers, cut_memory, in_unit, numbers_of, values_of
from framekit.link.value_source import ValueCompiler
from framekit.link.values import (
    EVALUATION_ERRORS,
    Evaluate,
    Names,
    bare_name,
    compile_expression,
    compile_optional,
)
from framekit.link.variables import ParameterError, given_value
from framekit.memory.memory import unit_bits

NATIVE = frozenset({"start", "count", "first"})
"""Names that count elements: a row that sends them, and no text, speaks of the area's own units only."""

FROM_START = frozenset({"start", "first"})
"""Names that cannot express a place between two elements of its unit."""

Rule = tuple[Evaluate, Evaluate, bool]
"""Condition, code, and whether the condition reads the bytes that come with the request."""


class ServiceRows:
    """Everything that the services of one protocol share; `rows` ask, `served` are answered, in the order of the file.

    `refuse`: refusals of a server that hold for requests of every row.
    """

    def __init__(self, protocol: Protocol, codec: ProtocolCodec) -> None:
        self.protocol = protocol
        self.codec = codec
        self.table = table_of(protocol, codec)
        self.values = ValueCompiler(self.table)
        self.grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
        rows = {service: tuple(RowFacts(row, self) for row in rows) for service, rows in protocol.services.items()}
        asking = {name: tuple(facts for facts in one if not facts.row.server_only) for name, one in rows.items()}
        self.rows = {name: one for name, one in asking.items() if one}
        everything = (facts for one in rows.values() for facts in one)
        self.refuse = rules(protocol.server_refusals)
        self.served = tuple(one for one in everything if one.row.request is not None and not one.row.client_only)

    @cached_property
    def error_frames(self) -> tuple[str, ...]:
        errors = self.protocol.errors
        frames = () if errors is None else errors.frames
        return tuple(frame for name in frames for frame in self.protocol.frames_of(name))


def rows_of(protocol: Protocol, codec: ProtocolCodec) -> ServiceRows:
    """Return the rows of a protocol, made once for a codec: clients and servers, however many there are, share them."""
    return made_once(protocol, codec, ServiceRows, lambda: ServiceRows(protocol, codec))


class RowFacts:
    """One row. `mentions`: names in its request and in the bytes with it; `single`: it carries one element.

    `lists`: conditions of the variables in each list of a request, if every list is for some of them. `packers`: the
    form of elements in its data, by unit. `defaults`: of its arguments; those that depend on others are last.
    """

    __slots__ = (
        "defaults", "has_each", "limit_bytes", "limit_count", "lists", "mentions", "named_numbers", "packers", "refuse",
        "row", "run", "shared", "single", "wants_address", "when",
    )  # fmt: skip

    def __init__(self, row: ServiceRow, shared: ServiceRows) -> None:
        self.row = row
        self.shared = shared
        self.mentions = mentions_of(row)
        lists = [each.when for each in parts_of([row.request, row.buffer], EachOf)]
        self.has_each = bool(lists)
        self.lists = [] if None in lists else [compile_expression(when) for when in lists if when is not None]
        self.when = compile_optional(row.when)
        defaults = {one.name: one.default for one in row.takes if one.default is not None}
        self.defaults = [(name, compile_expression(defaults[name])) for name in ordered_by_need(defaults)]
        self.refuse = rules(row.refuse)
        self.run = compile_optional(row.run)
        self.limit_count = compile_optional(row.limit.count)
        self.limit_bytes = compile_optional(row.limit.bytes)
        self.wants_address = wants_address(row)
        self.single = not self.mentions & COUNTING
        self.named_numbers = self._named_numbers()
        self.packers = Packers(row.packing)

    def _named_numbers(self) -> dict[str, Mapping[str, int]]:
        """Return the arguments that become fields with named numbers, with these numbers by name."""
        found: dict[str, Mapping[str, int]] = {}
        for frame in parts_of(self.row.request, FrameOf):
            numbers = self.shared.table.infos[frame.frame].numbers
            for field, value in frame.fields.items():
                name = bare_name(value) if isinstance(value, Expression) else None
                if name is not None and field in numbers:
                    found[name] = numbers[field]
        return found

    def fits(self, area: AreaModel, unit: str) -> bool:
        """Return whether the row can carry elements of `unit` of `area`, its condition aside."""
        row = self.row
        if row.areas and area.name not in row.areas:
            return False
        if row.units:
            return unit in row.units
        if "text" in self.mentions:
            return self.shared.grammar.can_print(area.name, unit)
        if self.mentions & NATIVE and "unit" not in self.mentions:
            return unit == area.unit or unit in area.codes
        return True

    def names(self, address: Address, count: int) -> dict[str, Any]:
        """Return the names that this row has for `count` elements at an address, without data and parts of transfers.

        Raise AddressError if the row sends the address as text and no form prints it.
        """
        grammar = self.shared.grammar
        packer = self.packers[address.unit]
        names: dict[str, Any] = {
            **address.parts,
            "area": grammar.views[address.area],
            "unit": address.unit,
            "start": address.start,
            "count": count,
            "bytes": packer.size(address.start, count),
            "element_bytes": max(1, packer.bits // 8),
        }
        if "text" in self.mentions:
            names["text"] = grammar.print(address)
        code = code_of(grammar.areas[address.area], address.unit)
        if code is not None:
            names["code"] = code
        return names


def rules(refusals: Sequence[Refusal]) -> list[Rule]:
    """Return the refusals of a definition, compiled."""
    return [
        (compile_expression(rule.when), compile_expression(rule.code), "buffer" in names_in(rule.when.root))
        for rule in refusals
    ]


def wants_address(row: ServiceRow) -> bool:
    """Return whether the requests of a row name places of the other side."""
    return bool((mentions_of(row) & {"text", "start"}) - {argument.name for argument in row.takes})


def padded_names(segments: tuple[Segment, ...]) -> frozenset[str]:
    """Return the data among these segments that are filled up with padding."""
    return frozenset(one.name for one in everything(segments) if isinstance(one, Data) and one.pad is not None)


class ServiceError(ValueError):
    """A transfer that this protocol has no request for; the message says why."""


@dataclass(frozen=True, slots=True)
class Piece:
    """`count` elements at an address, `done` elements after the start of the whole; `data` to write."""

    address: Address
    count: int
    data: bytes | None = None
    done: int = 0

    @property
    def bits(self) -> int:
        return self.count * self.address.unit_bits

    def cut(self, start: int, count: int, moved: Address) -> Piece:
        """Return `count` elements of this piece from its element `start` on, at the address `moved`."""
        width = self.address.unit_bits
        data = None if self.data is None else cut_memory(self.data, start * width, count * width)
        return Piece(moved, count, data, self.done + start)


@dataclass(frozen=True, slots=True)
class RowPlan:
    """A row and the exchanges that do the whole: each has one piece, or several where the row carries a list.

    `skip` is the number of bits that were added in front of the first piece to align it, `bits` those that were wanted.
    """

    facts: RowFacts
    exchanges: tuple[tuple[Piece, ...], ...]
    first: int
    total: int
    skip: int
    bits: int


class Planner:
    """Chooses rows and cuts transfers. `names`: further names that rows may read."""

    def __init__(self, shared: ServiceRows) -> None:
        self.shared = shared
        self.grammar = shared.grammar

    def plan(self, service: str, piece: Piece, names: Names, *, listed: bool = False) -> RowPlan:
        """Return the exchanges for one range of elements. Raise ServiceError when no row carries it.

        A range whose unit no row takes is carried in a unit of the area; a write only if it begins and ends with that.
        """
        of_all_units = self.grammar.parts_of_all_units(piece.address)
        for carried, skip in self._carried(piece):
            for facts in self.shared.rows.get(service, ()):
                if carried is not piece and facts.mentions & (piece.address.parts.keys() - of_all_units):
                    continue  # it names the place by parts of the address that mean another place in another unit
                if carried.address.shift and facts.mentions & FROM_START:
                    continue
                found = self._by_row(facts, carried, names, listed)
                if found is not None:
                    exchanges, more = found
                    return RowPlan(facts, exchanges, carried.address.start, carried.count, skip + more, piece.bits)
        area = self.shared.protocol.areas[piece.address.area]
        if piece.data is not None and area.access == "read":
            raise ServiceError(f"{piece.address} is in area {area.name}, which can only be read")
        where = "" if piece.count == 1 else f"{piece.count} × {piece.address.unit} from "
        hint = "name another address, or look whether role and parameters are those of the device"
        raise ServiceError(f"no request can {service} {where}{piece.address} – {hint}")

    def serves(self, address: Address, names: Names) -> bool:
        """Return whether a request can read or write one element at a place."""
        data = bytes(-(-address.unit_bits // 8))
        for service, piece in (("read", Piece(address, 1)), ("write", Piece(address, 1, data))):
            with suppress(ServiceError):
                self.plan(service, piece, names)
                return True
        return False

    def _carried(self, piece: Piece) -> Iterator[tuple[Piece, int]]:
        """Yield the range in its own unit, then in the area's, with the bits that stand before it in these."""
        yield piece, 0
        area = self.shared.protocol.areas[piece.address.area]
        first, end = piece.address.first_bit, piece.address.first_bit + piece.bits
        for unit in dict.fromkeys((area.unit, *area.codes)):
            width = unit_bits(unit)
            own_unit = unit == piece.address.unit and not piece.address.shift
            if own_unit or (piece.data is not None and (first % width or end % width)):
                continue
            start = first // width
            count = -(-end // width) - start
            place = self._at(piece.address, unit, start)
            data = None if piece.data is None else in_unit(piece.data, area.order, piece.address.unit, unit)
            yield Piece(place, count, data, 0), first - start * width

    def _at(self, address: Address, unit: str, start: int) -> Address:
        moved = Address(address.area, unit, start, "", address.parts)
        return self.grammar.advance(moved, 0)

    def _by_row(
        self, facts: RowFacts, piece: Piece, names: Names, listed: bool
    ) -> tuple[tuple[tuple[Piece, ...], ...], int] | None:
        area = self.shared.protocol.areas[piece.address.area]
        if not facts.fits(area, piece.address.unit) or (listed and not facts.row.most_variables):
            return None
        aligned = self._aligned(facts, piece)
        if aligned is None:
            return None
        try:
            offered = Names(self._offered(facts, piece, piece.address.start, piece.count), names)
            if facts.when is not None and not facts.when(offered):
                return None
        except EVALUATION_ERRORS:
            return None
        wider, skip = aligned
        pieces = tuple(self._cut(facts, wider, offered))
        if not all(self.has_list(facts, one, names) for one in pieces):
            return None
        return self._exchanges(facts, pieces, offered), skip * piece.address.unit_bits

    def has_list(self, facts: RowFacts, piece: Piece, names: Names) -> bool:
        """Return whether a list of the row's requests accepts these elements; True if its lists have no conditions."""
        if not facts.lists:
            return True
        offered = Names(self._offered(facts, piece, piece.address.start, piece.count), names)
        try:
            return any(holds(offered) for holds in facts.lists)
        except EVALUATION_ERRORS:
            return False

    def _aligned(self, facts: RowFacts, piece: Piece) -> tuple[Piece, int] | None:
        """Return the range widened to whole units of `align`, and the number of elements added in front.

        None for an unaligned write.
        """
        step = self._step(facts, piece)
        start, end = piece.address.start, piece.address.start + piece.count
        low, high = start - start % step, -(-end // step) * step
        if (low, high) == (start, end):
            return piece, 0
        if piece.data is not None:
            return None
        return Piece(self._at(piece.address, piece.address.unit, low), high - low), start - low

    def _step(self, facts: RowFacts, piece: Piece) -> int:
        return max(1, facts.row.align_bits // piece.address.unit_bits)

    def _cut(self, facts: RowFacts, piece: Piece, offered: Names) -> Iterator[Piece]:
        step, start = self._step(facts, piece), 0
        while start < piece.count:
            place = piece.address if start == 0 else self.grammar.advance(piece.address, start)
            most = self._most(facts, place, offered)
            count = min(piece.count - start, most if most < step else most - most % step)
            if count < 1:
                raise ServiceError(f"not even one {place.unit} of {place} fits into a request of this protocol")
            yield piece.cut(start, count, place)
            start += count

    def _most(self, facts: RowFacts, address: Address, offered: Names) -> int:
        """Return the most elements of one piece."""
        most = (
            1
            if facts.single
            else 1 << 32
            if facts.limit_count is None
            else self._limit(facts, facts.limit_count, offered)
        )
        if facts.limit_bytes is None:
            return most
        data_bytes = self._limit(facts, facts.limit_bytes, offered)
        return min(most, facts.packers[address.unit].most(address.start, data_bytes))

    def _limit(self, facts: RowFacts, limit: Evaluate, offered: Names) -> int:
        try:
            return int(limit(offered))
        except EVALUATION_ERRORS as error:
            raise ServiceError(f"the limit of row '{facts.row.name}' cannot be worked out: {explain(error)}") from None

    def _exchanges(self, facts: RowFacts, pieces: tuple[Piece, ...], offered: Names) -> tuple[tuple[Piece, ...], ...]:
        if not facts.row.most_variables:
            return tuple((piece,) for piece in pieces)
        return self.grouped(facts, pieces, offered)

    # ---- lists of variables -------------------------------------------------------------------------------

    def plan_list(self, service: str, pieces: Sequence[Piece], names: Names) -> list[RowPlan]:
        """Return the exchanges for single variables, in their order: as lists if a row carries lists, else one each."""
        plans: list[RowPlan] = []
        waiting: list[RowPlan] = []
        for piece in pieces:
            try:
                plan = self.plan(service, piece, names, listed=True)
            except ServiceError:
                plan = self.plan(service, piece, names)
            if waiting and not (plan.facts.row.most_variables and self._alike(waiting[-1], plan)):
                plans.extend(self._joined(waiting, names))
                waiting = []
            (waiting if plan.facts.row.most_variables else plans).append(plan)
        return plans + self._joined(waiting, names)

    def _alike(self, one: RowPlan, other: RowPlan) -> bool:
        same = one.facts.row.same
        return one.facts is other.facts and (same is None or getattr(_place(one), same) == getattr(_place(other), same))

    def _joined(self, plans: list[RowPlan], names: Names) -> list[RowPlan]:
        """Return the plans of a row joined into few exchanges; an aligned plan stays separate."""
        if not plans or any(sum(p.bits for e in plan.exchanges for p in e) != plan.bits for plan in plans):
            return plans
        facts = plans[0].facts
        pieces = [piece for plan in plans for exchange in plan.exchanges for piece in exchange]
        offered = Names(facts.names(pieces[0].address, pieces[0].count), names)
        exchanges = self.grouped(facts, pieces, offered)
        total = sum(piece.count for piece in pieces)
        return [RowPlan(facts, exchanges, pieces[0].address.start, total, 0, sum(piece.bits for piece in pieces))]

    def grouped(self, facts: RowFacts, pieces: Sequence[Piece], offered: Names) -> tuple[tuple[Piece, ...], ...]:
        """Return the pieces in groups that one request can carry."""
        most_bytes = None if facts.limit_bytes is None else self._limit(facts, facts.limit_bytes, offered)
        exchanges: list[list[Piece]] = []
        used = 0
        for piece in pieces:
            size = facts.packers[piece.address.unit].size(piece.address.start, piece.count)
            full = not exchanges or len(exchanges[-1]) == facts.row.most_variables
            if full or (most_bytes is not None and used + size > most_bytes):
                exchanges.append([])
                used = 0
            exchanges[-1].append(piece)
            used += size
        return tuple(tuple(exchange) for exchange in exchanges)

    # ---- names --------------------------------------------------------------------------------------------

    def offered(self, plan: RowPlan, piece: Piece) -> dict[str, Any]:
        """Return the names that a row offers for one piece of a plan. Raise AddressError."""
        return self._offered(plan.facts, piece, plan.first, plan.total)

    def _offered(self, facts: RowFacts, piece: Piece, first: int, total: int) -> dict[str, Any]:
        address = piece.address
        found = facts.names(address, piece.count)
        found.update(first=first, done=piece.done, total=total)
        if piece.data is not None:
            found["data"] = facts.packers[address.unit].to_data(piece.data, address.start, piece.count)
            if address.unit == "bit":
                found["bits"] = values_of(piece.data, "bit", piece.count)
            if facts.mentions & AS_NUMBERS and facts.row.service == "write":
                found["values"] = numbers_of(piece.data, address.unit, address.type, piece.count)
                found["value"] = found["values"][0]
        return found


def _place(plan: RowPlan) -> Address:
    """Return the address of the first piece of a plan."""
    return plan.exchanges[0][0].address


# ---- arguments of a call ----------------------------------------------------------------------------------

TYPES = ("time", "number", "decimal", "flag", "choice", "text", "bytes", "list")
"""The types of arguments that are checked; values of any other type are taken as they are."""


def arguments_of(facts: RowFacts, given: Mapping[str, Any], names: Names) -> dict[str, Any]:
    """Return the values of all arguments of a row, by name. Raise ServiceError for unknown, missing and unfit ones."""
    row = facts.row
    values: dict[str, Any] = {}
    problems: list[str] = []
    for argument in row.takes:
        if argument.name in given:
            try:
                values[argument.name] = _value(row.service, argument, given[argument.name])
            except ServiceError as error:
                problems.append(str(error))
    if not problems:
        known = Names(values, names)
        for name, default in facts.defaults:
            if name not in given:
                try:
                    known[name] = default(known)
                except EVALUATION_ERRORS as error:
                    problems.append(f"the default of '{name}' cannot be worked out: {explain(error)}")
        values = dict(known)
    if problems or len(values) < len(row.takes) or not given.keys() <= values.keys():
        raise ServiceError("; ".join([*problems, *_misnamed(row, given)]))
    for name, numbers in facts.named_numbers.items():
        if isinstance(values.get(name), str):
            values[name] = numbers.get(values[name], values[name])
    return values


def _misnamed(row: ServiceRow, given: Mapping[str, Any]) -> Iterator[str]:
    """Yield messages about missing and unknown arguments."""
    known = [argument.name for argument in row.takes]
    missing = [f"'{one.name}'" for one in row.takes if one.default is None and one.name not in given]
    if missing:
        yield f"'{row.service}' needs the argument{'s' * (len(missing) > 1)} {listed(missing)}"
    unknown = [name for name in given if name not in known]
    if len(unknown) == 1:
        hint = did_you_mean(unknown[0], known)
        yield f"'{row.service}' takes no argument '{unknown[0]}'" + (f" – {hint}" if hint else "")
    elif unknown:
        hint = f" – known: {', '.join(known)}" if known else ""
        yield f"'{row.service}' takes no arguments {listed(repr(name) for name in unknown)}{hint}"


def _value(service: str, argument: Argument, given: Any) -> Any:
    try:
        return checked(argument, given)
    except ParameterError as error:
        raise ServiceError(f"'{service}': {str(error).replace('parameter', 'argument', 1)}") from None


def checked(argument: Argument, value: Any) -> Any:
    """Return the value as the argument takes it. Raise ParameterError."""
    return given_value(argument, value) if argument.type in TYPES else value
