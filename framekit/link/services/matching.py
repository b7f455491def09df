"""Request matching: a service row as a function of the request, from its fields to the place and data it asks for.

Each row becomes one Python function, written when its frame is first served: it compares fields, names are local
variables, and everything known before is resolved. A row without a place of its own, or with work on state, goes on
with a `MatchedRow`. Values without a name to solve for are skipped; `station` and `own` are not compared.
Guide: services, read backwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.expression import Expression, emit, is_constant, tells_setting
from framekit.definition.fingerprint import fingerprint
from framekit.definition.kinds.base import Segments
from framekit.definition.model.frames import attributes_in, field_names, flat, names_read, parts_of
from framekit.definition.model.services import AS_NUMBERS, is_passed_over, only_start, told_by
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, ReadAs, RecordOf, Value
from framekit.link.addresses import Address, AddressError, code_of
from framekit.link.events import Served
from framekit.link.packing import PackingError, memory_of, memory_of_numbers, numbers_of, values_of
from framekit.link.services.areas import AreaUnit, Codes, DeviceAreas
from framekit.link.services.row_names import KNOWN, WriterLevel, Written, said
from framekit.link.services.rows import RowFacts, padded_names
from framekit.link.value_source import FunctionSource
from framekit.link.values import (
    EACH,
    EVALUATION_ERRORS,
    FrameValue,
    Names,
    attribute,
    bare_name,
    compile_expression,
    compile_optional,
    inverse_of,
    present,
    quotient,
    read_layout,
)
from framekit.link.variables import same_number
from framekit.memory.memory import DeviceMemoryError, MemoryRangeError, UnknownAreaError

PLACE_NAMES = ("area", "unit", "start", "count", "bytes", "element_bytes", "total")
WRONG_PLACE = (DeviceMemoryError, AddressError, PackingError)


class MismatchError(Exception):
    """The request differs from the row."""


class ElsewhereError(Exception):
    """The request names an area (`known`: of the protocol) that this row is not for."""

    def __init__(self, known: bool) -> None:
        super().__init__()
        self.known = known


class DamagedBufferError(Exception):
    """Bytes of a request do not have their layout; `refuse`: the code for it, if any."""

    def __init__(self, cause: ValueError) -> None:
        super().__init__(str(cause))
        self.refuse: int | None = getattr(cause, "refuse", None)


class DataError(MemoryRangeError):
    """Data of a request do not fit their elements: a wrong size, or a point that is neither on nor off."""


class RefusedMatchError(Exception):
    """The request is refused with `code`."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass(slots=True)
class MatchTarget:
    """Elements that a request names, and its data for them, as memory has them, with their own names.

    `type`: the usual type of the place.
    """

    unit: AreaUnit
    start: int
    count: int
    memory: bytes | None
    names: Names
    type: str | None


@dataclass(slots=True)
class MatchedRow:
    """A row that fits a request. `problem`: a fault of its places, which is reported after the row's conditions."""

    names: Names
    targets: list[MatchTarget] = field(default_factory=list)
    problem: DeviceMemoryError | None = None


Match = Callable[[FrameValue, bytes, Any, Names], "MatchedRow | None"]
"""Reads a request by a row; None: the row does not fit. Raise ElsewhereError and DamagedBufferError."""
Serve = Callable[[FrameValue, bytes, Any, Names], "Served | None"]
"""Serves a request; None: the row does not fit."""
GoOn = Callable[[FrameValue, MatchedRow], Served]


class Matching:
    """The functions of one row. `go_on` serves a reading, where the row's function does not do everything."""

    def __init__(self, facts: RowFacts, areas: DeviceAreas, codes: Codes, go_on: GoOn) -> None:
        row = facts.row
        assert row.request is not None
        self.facts, self.areas, self.codes, self.go_on = facts, areas, codes, go_on
        self.frame = row.request.frame
        self.when = row.back.get("when", row.when)
        self._holds = compile_optional(self.when)
        replies = [(reply.frame, reply.buffer) for reply in row.reply]
        self.is_whole = row.serve is None and not any(
            True for _ in parts_of([row.request, row.buffer, replies], EachOf)
        )
        """Whether one function does everything: one place at most, and no work but the transfer."""
        told = {*row.back, *row.back_each} & {"unit", "start", "memory"}
        self.takes_shift = row.service in ("read", "write") and row.serve is None and not told
        """Whether an element may begin between two of its unit, as an address with `counts` says."""
        self._read: dict[bool, Match] = {}

    def read(
        self, request: FrameValue, buffer: bytes, station: Any, names: Names, with_buffer: bool
    ) -> MatchedRow | None:
        """Return the meaning of a request; None: the row does not fit. Without the buffer: its bytes have not come yet.

        Raise MismatchError too if the row does not fit, ElsewhereError and DamagedBufferError.
        """
        function = self._read.get(with_buffer)
        if function is None:
            function = self._read[with_buffer] = RowWriter(self, with_buffer, False).function()
        return function(request, buffer, station, names)

    def serving(self) -> Serve:
        """Return the function that serves a request; it raises as `read`, RefusedMatchError and errors of memory."""
        serve: Serve = RowWriter(self, True, True).function()
        return serve

    def holds(self, reading: MatchedRow) -> bool:
        """Return whether the row's condition holds; a condition that fails because of a wrong place counts as true."""
        if self._holds is None:
            return True
        try:
            return bool(self._holds(reading.names))
        except EVALUATION_ERRORS:
            return reading.problem is not None

    # ---- methods for the written functions ----------------------------------------------------------------

    def address_named(self, text: str) -> Address:
        """Return the place that an address says."""
        try:
            address = self.facts.shared.grammar.parse(text, check=False)
        except AddressError as error:
            raise UnknownAreaError(str(error)) from None
        if address.shift and not self.takes_shift:
            raise MemoryRangeError(f"{address} does not begin at a whole {address.unit}")
        if self.facts.row.areas and address.area not in self.facts.row.areas:
            raise ElsewhereError(True)
        return address

    def area_named(self, area: Any) -> Any:
        """Return the area that `back` says."""
        if area not in self.areas.areas:
            raise UnknownAreaError(f"there is no area '{area}'")
        return self.facts.shared.grammar.views[area]

    def elsewhere(self, code: Any) -> None:
        """Raise ElsewhereError: no area of the row has the code."""
        raise ElsewhereError(bool(self.codes.get(code)))


class RowWriter:
    """Writes one function of a row: `whole` up to the reply, else up to a `MatchedRow`."""

    def __init__(self, matching: Matching, with_buffer: bool, whole: bool) -> None:
        self.matching, self.facts, self.row = matching, matching.facts, matching.facts.row
        self.shared, self.grammar = matching.facts.shared, matching.facts.shared.grammar
        self.areas = matching.areas
        self.with_buffer, self.whole = with_buffer, whole
        self.inline = whole and matching.is_whole
        self.level = WriterLevel()
        self.items_found: dict[str, tuple[str, WriterLevel, Expression | None]] = {}
        """By `when` of the lists: the variable with what their items hold, and the names it has in every round."""
        self.back = {**self.row.back, **self.row.back_each}
        self.arguments = {argument.name for argument in self.row.takes}
        row = self.row
        self.judged = attributes_in([row.back, row.back_each, row.when, row.refuse])
        """Fields that the row reads itself: they do not change the device's own value of a parameter."""
        params = self.shared.protocol.params.items()
        self.own = {name for name, one in params if one.is_compared or one.secret} - self.arguments
        replies = [(reply.frame, reply.buffer) for reply in row.reply]
        mentioning: list[Any] = [row.back, row.back_each, matching.when]
        mentioning += [(rule.when, rule.code) for rule in row.refuse]
        mentioning += [(reply.when, reply.frame, reply.buffer) for reply in row.reply]
        self.mentioned = names_read(mentioning)
        protocol = self.shared.protocol
        made = [protocol.frames[one.frame].segments for one in parts_of(replies, FrameOf)]
        made += [protocol.layouts[one.layout].segments for one in parts_of(replies, LayoutOf)]
        for segments in made:
            self.mentioned |= names_read(segments) - field_names(segments)
        given = {
            **_RUNTIME,
            "address_named": matching.address_named,
            "area_named": matching.area_named,
            "elsewhere": matching.elsewhere,
            "holds": matching.holds,
            "go_on": matching.go_on,
            "unit_there": self.areas.unit,
            "own_unit": self.areas.own_unit,
            "own_bytes": self.areas.own_bytes,
            "packers": self.facts.packers,
            "views": self.grammar.views,
            "fill_echo": self.shared.table.fill_echo,
        }
        self.writer = FunctionSource(self.shared.table, given)
        self.out, self.values = self.writer.body, self.writer.values
        self._variables = 0

    # ---- variables and constants --------------------------------------------------------------------------

    def variable(self) -> str:
        self._variables += 1
        return f"v{self._variables}"

    def let(self, level: WriterLevel, name: str, text: str) -> str:
        """Write the assignment of a name and return its variable."""
        variable = self.variable()
        self.out.add(f"{variable} = {text}")
        level.put(name, variable)
        return variable

    def worked_out(self, text: str) -> str:
        """Return a variable with the value of an expression; the row does not fit if evaluating it fails."""
        variable = self.variable()
        with self.out.block("try:"):
            self.out.add(f"{variable} = {text}")
        with self.out.block("except EVALUATION_ERRORS:"):
            self.out.add("return None")
        return variable

    def unfit_if(self, condition: str) -> None:
        with self.out.block(f"if {condition}:"):
            self.out.add("return None")

    # ---- the function -------------------------------------------------------------------------------------

    def function(self) -> Any:
        """Return the function itself."""
        row, out = self.row, self.out
        assert row.request is not None
        self._match(row.request, "request", self.level)
        if row.buffer is not None and self.with_buffer:
            self._match(row.buffer, "buffer", self.level, padded=isinstance(row.buffer, LayoutOf))
        elif self.with_buffer:
            self.unfit_if("buffer")
        if not self.inline:
            out.add(f"reading = Reading(Names(None, {KNOWN}))")
        with out.block("try:"):
            place = self._targets()
            out.add("pass")
        with out.block("except WRONG_PLACE as error:"):
            history = self.writer.object(tuple(self.level.history))
            known = KNOWN if self.inline else "reading.names"
            out.add(f"reading = wrong_place(error, {known}, {history}, locals(), {self.level.parts or None!r})")
            if self.inline:
                self.unfit_if("not holds(reading)")
                out.add("return go_on(request, reading)")
        if self.inline:
            self._serve(place)
        else:
            self.unfit_if("not holds(reading)")
            out.add("return go_on(request, reading)" if self.whole else "return reading")
        return self.writer.load("request", "buffer", "station", "names")

    # ---- comparing ----------------------------------------------------------------------------------------

    def _match(
        self,
        value: Value,
        actual: str,
        level: WriterLevel,
        numbers: Mapping[str, int] | None = None,
        padded: bool = False,
    ) -> None:
        """Write the comparison of a value with the request."""
        match value:
            case Expression():
                self._compare(value, actual, level, numbers or {}, padded)
            case FrameOf(frame=frame, fields=fields):
                if actual != "request":
                    self.unfit_if(f"type({actual}) is not FrameValue or {actual}.frame != {frame!r}")
                inside = self.variable()
                self.out.add(f"{inside} = {actual}.fields")
                padding = padded_names(self.shared.protocol.frames[frame].segments)
                in_cases = names_in_cases(self.shared.protocol.frames[frame].segments)
                self._fields(fields, actual, inside, level, self.shared.table.infos[frame].numbers, padding, in_cases)
            case RecordOf(fields=fields):
                self._fields(fields, actual, None, level, {}, frozenset())
            case LayoutOf(layout=layout, fields=fields):
                record, decode = self.variable(), f"{self.values.layout(layout)}[1]"
                self.out.add(f"{record} = layout_read({decode}, {actual}, {KNOWN}, {padded})")
                padding = padded_names(self.shared.protocol.layouts[layout].segments)
                self._fields(fields, record, None, level, {}, padding)
            case ListOf(items=items):
                self.unfit_if(f"not isinstance({actual}, list) or len({actual}) != {len(items)}")
                for index, item in enumerate(items):
                    part = self.variable()
                    self.out.add(f"{part} = {actual}[{index}]")
                    self._match(item, part, level)
            case EachOf():
                self._each(value, actual)

    def _fields(
        self, fields: Mapping[str, Value], actual: str, inside: str | None, level: WriterLevel,
        numbers: Mapping[str, Mapping[str, int]], padding: frozenset[str], in_cases: frozenset[str] = frozenset(),
    ) -> None:  # fmt: skip
        """Write the comparison of the fields. `in_cases`: names of fields that only some cases of a choice hold; an
        argument of the row is None if its field is in another case.
        """
        for name, value in fields.items():
            if isinstance(value, ReadAs) or (isinstance(value, Expression) and is_passed_over(value)):
                continue
            if name in self.judged and isinstance(value, Expression) and tells_setting(value, self.own):
                continue
            part = self.variable()
            if inside is None:
                self.out.add(f"{part} = part_of({actual}, {name!r})")
            else:
                with self.out.block("try:"):
                    self.out.add(f"{part} = {inside}[{name!r}]")
                is_argument = isinstance(value, Expression) and bare_name(value) in self.arguments
                read = "attribute" if name in in_cases and is_argument else "part_of"
                with self.out.block("except KeyError:"):
                    self.out.add(f"{part} = {read}({actual}, {name!r})")
            self._match(value, part, level, numbers.get(name), name in padding)

    def _compare(
        self, expression: Expression, actual: str, level: WriterLevel, numbers: Mapping[str, int], padded: bool
    ) -> None:
        if is_passed_over(expression):
            return
        if is_constant(expression):
            constant = compile_expression(expression)(Names())
            if isinstance(constant, str):
                constant = numbers.get(constant, constant)
            text = self.writer.object(constant)
            if isinstance(constant, Decimal):
                self.unfit_if(f"not same_number({actual}, {text})")
            elif padded and isinstance(constant, bytes):  # the rest is padding
                self.unfit_if(f"not isinstance({actual}, bytes) or not {actual}.startswith({text})")
            else:
                self.unfit_if(f"{actual} != {text}")
            return
        name = bare_name(expression)
        if name is None:
            inverse = inverse_of(expression)
            assert inverse is not None
            self.unfit_if(f"not isinstance({actual}, int)")
            level.pending.append((inverse, actual))
        elif name in level.values:
            self.unfit_if(f"{level.values[name]} != {actual}")
        else:
            level.put(name, actual)
        if name == "data":
            level.padded = padded

    def _each(self, each: EachOf, actual: str) -> None:
        """Write the comparison of the items of a list.

        The values of the items are in a list of tuples, shared by all lists with the same variables.
        """
        self.unfit_if(f"not isinstance({actual}, list)")
        part, found = self.variable(), self.variable()
        header = f"for {part} in {actual}:"
        variables = "" if each.when is None else fingerprint(each.when)
        before = self.items_found.get(variables)
        level = before[1] if before is not None else WriterLevel()
        if before is not None:  # several lists speak of the same variables
            self.unfit_if(f"len({actual}) != len({before[0]})")
            header = f"for {part}, ({level.held}) in zip({actual}, {before[0]}):"
        self.out.add(f"{found} = []")
        with self.out.block(header):
            if self.row.back_each:
                item = self.variable()
                self.out.add(f"{item} = item_of({level.item}, {part})")
                level.item = item
            self._fields(each.fields, part, None, level, {}, frozenset())
            self.out.add(f"{found}.append(({level.held}))")
        self.items_found[variables] = found, level, each.when

    # ---- places -------------------------------------------------------------------------------------------

    def _targets(self) -> str | None:
        """Write the selection of places; return the variable with the `AreaUnit` of the only place, else None."""
        level, out = self.level, self.out
        if not self.items_found:
            place = self._target(level)
            if not self.inline:
                out.add(f"reading.names.update({level.items})")
                if place is not None:
                    self._note_target(level, place, "reading.names")
                    out.add("name_targets(reading)")
            return place
        for listed, each, when in self.items_found.values():
            with out.block(f"for {each.held or '_'} in {listed}:"):
                for name, value in (told_by(when) or {}).items():
                    each.values.setdefault(name, repr(value))
                place = self._target(each)
                if when is not None:
                    self.unfit_if(f"not {self.worked_out(self.values.value(when, each.names))}")
                if place is not None:
                    self._note_target(each, place, f"Names({each.items}, reading.names)")
        self._solve(level)
        out.add(f"set_missing(reading.names, {level.items})")
        out.add("name_targets(reading)")
        return None

    def _note_target(self, level: WriterLevel, place: str, names: str) -> None:
        start, count = level.values["start"], level.values["count"]
        type_ = self._type(level, place)
        self.out.add(f"reading.targets.append(Target({place}, {start}, {count}, {level.memory}, {names}, {type_}))")

    def _target(self, level: WriterLevel) -> str | None:
        """Write the place that the names of a level mean; return the variable with its `AreaUnit`, or None."""
        back = self.back
        area, unit, fixed = self._area(level)
        if area is None and not back.keys() & {"area", "memory"}:
            self._solve(level)
            return None
        if "memory" in back:
            memory = self.worked_out(self._word("memory", level))
            self.let(level, "own_bytes", f"own_bytes(str({memory}))")
        for name in back:
            if name not in ("area", "memory", "text", "when"):
                level.put(name, self.worked_out(self._word(name, level)))
        self._solve(level)
        unit = level.values.get("unit", unit)
        if area is None or "memory" in back:
            memory = self.worked_out(self._word("memory", level))
            place = self.variable()
            self.out.add(f"{place} = own_unit(str({memory}), {unit})")
        elif fixed is not None and "unit" not in level.values:
            place = self.writer.object(fixed)
        else:
            place = self.variable()
            self.out.add(f"{place} = unit_there({area}, {unit}{level.shift})")
        self._complete(level, place)
        return place

    def _word(self, name: str, level: WriterLevel) -> str:
        """Return a value of `back`; a bare word that is a unit or an area stands for itself."""
        value = self.back[name]
        word = bare_name(value)
        if word is not None and (name == "unit" or (name in ("area", "memory") and word in self.areas.areas)):
            return repr(word)
        return emit(value.root, Written(level, name in self.row.back_each))

    def _area(self, level: WriterLevel) -> tuple[str | None, str | None, AreaUnit | None]:
        """Return the area and unit that the request names: by text, `back`, code, or because the row is for one area.

        The third item is the area in its unit, if it is certain before a request comes.
        """
        row, back = self.row, self.back
        if "text" in back or ("text" in level.values and "text" not in self.arguments):
            if "text" in back:
                level.put("text", self.worked_out(self._word("text", level)))
            return self._by_text(level)
        if "area" in back:
            named = self.worked_out(self._word("area", level))
            return self.let(level, "area", f"area_named({named})"), None, None
        if "code" in level.values and "code" not in self.arguments:
            return self._by_code(level)
        if len(row.areas) == 1:
            unit = row.units[0] if len(row.units) == 1 else None
            area = self.let(level, "area", self.writer.object(self.grammar.views[row.areas[0]]))
            return area, repr(unit), self.areas.unit(row.areas[0], unit)
        return None, None, None

    def _by_text(self, level: WriterLevel) -> tuple[str, str, None]:
        address = self.variable()
        self.out.add(f"{address} = address_named(str({level.values['text']}))")
        level.parts = self.variable()
        self.out.add(f"{level.parts} = {address}.parts")
        level.type = f"{address}.type"
        level.shift = f", {address}.shift" if self.matching.takes_shift else ""
        if "start" in level.values:
            self.unfit_if(f"{level.values['start']} != {address}.start")
        else:
            self.let(level, "start", f"{address}.start")
        if "text" in self.back:
            self.let(level, "unit", f"{address}.unit")
        return self.let(level, "area", f"views[{address}.area]"), f"{address}.unit", None

    def _by_code(self, level: WriterLevel) -> tuple[str, str, None]:
        found: dict[Any, tuple[Any, str]] = {}
        for code, pairs in self.matching.codes.items():
            for area, unit in pairs:
                if not self.row.areas or area in self.row.areas:
                    found[code] = (self.grammar.views[area], self._unit_of_row(area, unit, code))
                    break
        named, code = self.variable(), level.values["code"]
        self.out.add(f"{named} = {self.writer.object(found)}.get({code})")
        with self.out.block(f"if {named} is None:"):
            self.out.add(f"elsewhere({code})")
        return self.let(level, "area", f"{named}[0]"), f"{named}[1]", None

    def _unit_of_row(self, area: str, unit: str, code: Any) -> str:
        """Return the unit that the code means in this row: one of the row's own, where the code can stand for it."""
        units = self.row.units
        if not units or unit in units:
            return unit
        return next((own for own in units if code_of(self.grammar.areas[area], own) == code), unit)

    def _solve(self, level: WriterLevel) -> None:
        """Write the names whose values follow from the area; names of `back` go before them."""
        for inverse, actual in level.pending:
            if inverse.name in self.back:
                continue
            value = self.worked_out(inverse.source(actual, lambda other: self.values.value(other, level.names)))
            if inverse.name in level.values:
                self.unfit_if(f"{level.values[inverse.name]} != {value}")
            else:
                level.put(inverse.name, value)

    def _complete(self, level: WriterLevel, place: str) -> None:
        """Write start, count, sizes and data of a place."""
        values = level.values
        otherwise = str(only_start(self.shared.protocol.addresses, self.row.areas) or 0)
        start = self.let(level, "start", f"int({values['start']})" if "start" in values else otherwise)
        packer, unit = self._packer(level, place)
        numbers = self._numbers_sent(level)
        if "count" not in values:
            self.let(level, "count", self._count(level, packer, numbers))
        count = self.let(level, "count", f"int({values['count']})")
        with self.out.block(f"if {start} < 0 or {count} < 0:"):
            self.out.add(f"cannot_be({place}, {start}, {count})")
        if not self.inline or "bytes" in self.mentioned or level.padded:
            self.let(level, "bytes", f"{packer}.size({start}, {count})")
        if not self.inline or "element_bytes" in self.mentioned:
            self.let(level, "element_bytes", f"max(1, {packer}.bits // 8)")
        if "total" not in values:
            level.put("total", count)
        if self._put_memory(level, place, packer, numbers) and (not self.inline or "bits" in self.mentioned):
            self._put_bits(level, place, unit)

    def _packer(self, level: WriterLevel, place: str) -> tuple[str, str | None]:
        """Write the unit of a place; return the source of its packer, and the unit if it is fixed."""
        fixed = self.writer.given(place)
        if isinstance(fixed, AreaUnit):
            packer = self.writer.object(self.facts.packers[fixed.unit])
            self.let(level, "unit", repr(fixed.unit))
            return packer, fixed.unit
        packer = self.variable()
        self.out.add(f"{packer} = packers[{self.let(level, 'unit', f'{place}.unit')}]")
        return packer, None

    def _count(self, level: WriterLevel, packer: str, numbers: str | None) -> str:
        """Return the source of the count of a request without a count: it follows from the data, else it is 1."""
        values, data = level.values, level.values.get("data")
        if data is None and "bits" in self.back:
            return f"len({values['bits']})"
        if numbers is not None:
            return f"len({numbers})"
        size = values.get("bytes") or (None if data is None else f"len({data})")
        return "1" if size is None else f"{packer}.count_in({values['start']}, int({size}))"

    def _put_memory(self, level: WriterLevel, place: str, packer: str, numbers: str | None) -> bool:
        """Write the memory of a place from the data, bits or numbers of a request; return whether it has any."""
        values, start, count = level.values, level.values["start"], level.values["count"]
        data = values.get("data")
        if data is not None:
            data = self.let(level, "data", f"{data}[:{values['bytes']}]") if level.padded else data
            text = f"{packer}.to_memory({data}, {start}, {count})"
        elif "bits" in self.back:
            text = f"memory_of({values['bits']}, 'bit')"
        elif numbers is not None:
            text = f"numbers_there({numbers}, {count}, {place}.unit, {self._type(level, place)})"
        else:
            return False
        level.memory = self.variable()
        self.out.add(f"{level.memory} = {text}")
        if data is None and "bits" in self.back:
            self.let(level, "data", f"{packer}.to_data({level.memory}, {start}, {count})")
        return True

    def _put_bits(self, level: WriterLevel, place: str, unit: str | None) -> None:
        """Write the bits in the memory of a place of bits; `unit`: None if only the request shows the unit."""
        values = f"values_of({level.memory}, 'bit', {level.values['count']})"
        if unit == "bit":
            self.let(level, "bits", values)
        elif unit is None:
            otherwise = level.values.get("bits", "None")
            self.let(level, "bits", f"{values} if {place}.bits == 1 else {otherwise}")

    @staticmethod
    def _type(level: WriterLevel, place: str) -> str:
        """Return the source of the type of the elements: by the address in the request, else by the place."""
        return level.type or f"{place}.type"

    def _numbers_sent(self, level: WriterLevel) -> str | None:
        """Return the numbers of a write, if the request has numbers instead of data."""
        if "data" in level.values or self.row.service != "write":
            return None
        if "values" in level.values:
            return level.values["values"]
        return f"[{level.values['value']}]" if "value" in level.values else None

    # ---- work and reply -----------------------------------------------------------------------------------

    def _serve(self, place: str | None) -> None:
        """Write condition, refusals, the transfer and the reply."""
        level, out, row = self.level, self.out, self.row
        if self.matching.when is not None:
            holds = self.worked_out(self.values.value(self.matching.when, level.names))
            self.unfit_if(f"not {holds}")
        for rule in row.refuse:
            with out.block(f"if {self.values.value(rule.when, level.names)}:"):
                out.add(f"raise RefusedError(int({self.values.value(rule.code, level.names)}))")
        if place is not None:
            self._check(place)
        if row.service == "read":
            data = "b''" if place is None else self._read(place)
            level.values["data"] = data
            if place is not None and self.mentioned & AS_NUMBERS:
                count, type_ = level.values["count"], self._type(level, place)
                numbers = self.let(level, "values", f"numbers_of({level.memory}, {place}.unit, {type_}, {count})")
                if "value" in self.mentioned:
                    self.let(level, "value", f"the_only({numbers})")
            if "bytes" in self.mentioned:
                self.let(level, "bytes", f"len({data})")
        elif row.service == "write" and place is not None:
            values = level.values
            if level.memory == "None":
                out.add("no_data()")
            out.add(f"{place}.write({values['start']}, {values['count']}, {level.memory})")
        for reply in row.reply:
            if reply.when is None:
                self._reply(reply.frame, reply.buffer)
                return
            with out.block(f"if {self.values.value(reply.when, level.names)}:"):
                self._reply(reply.frame, reply.buffer)
        out.add("return Served(None)")

    def _check(self, place: str) -> None:
        start, count = self.level.values["start"], self.level.values["count"]
        fixed = self.writer.given(place)
        check = f"{place}.check({start}, {count}, {self.row.service == 'write'})"
        if isinstance(fixed, AreaUnit) and fixed.most and self.row.service != "write":
            with self.out.block(f"if {count} < 1 or {start} + {count} > {fixed.most}:"):
                self.out.add(check)
        else:
            self.out.add(check)

    def _read(self, place: str) -> str:
        """Write the read; return the variable with the data in the form of the frame."""
        level = self.level
        start, count = level.values["start"], level.values["count"]
        fixed, memory, data = self.writer.given(place), self.variable(), self.variable()
        level.memory = memory
        if not isinstance(fixed, AreaUnit):
            names = f"{place}.build and {level.known}"
            self.out.add(f"{memory} = {place}.read({start}, {count}, {names})")
            self.out.add(f"{data} = packers[{place}.unit].to_data({memory}, {start}, {count})")
            return data
        if fixed.most and fixed.is_plain and fixed.bits % 8 == 0 and fixed.offset % 8 == 0:
            read, size, first = self.writer.object(fixed.present().read_bytes), fixed.bits // 8, fixed.offset // 8
            self.out.add(f"{memory} = {read}({f'{first} + ' if first else ''}{start} * {size}, {count} * {size})")
        else:
            names = "None" if fixed.build is None else level.known
            self.out.add(f"{memory} = {place}.read({start}, {count}, {names})")
        packer = self.facts.packers[fixed.unit]
        if packer.bits == 8 or (packer.bits > 8 and packer.order == "little"):
            return memory
        if packer.order == "big" and packer.bits in (16, 32, 64):
            self.out.add(f"{data} = support.swap({memory}, {packer.bits // 8})")
        else:
            self.out.add(f"{data} = {self.writer.object(packer)}.to_data({memory}, {start}, {count})")
        return data

    def _reply(self, frame: FrameOf | None, buffer: Value | None) -> None:
        reply, names = "None", self.level.names
        if frame is not None:
            reply = self.variable()
            self.out.add(f"{reply} = {self.values.value(frame, names)}")
            if self.values.repeats(frame):
                self.out.add(f"fill_echo({reply}, request)")
        self.out.add(f"return Served({reply}{'' if buffer is None else f', {self.values.value(buffer, names)}'})")


# ---- functions for the written functions ------------------------------------------------------------------


def part_of(actual: Any, name: str) -> Any:
    """Return a field of a request."""
    try:
        return present(actual, name)
    except (KeyError, AttributeError):
        raise MismatchError(name) from None


def names_in_cases(segments: Segments) -> frozenset[str]:
    """Return the names of values that a record holds only in some cases of a choice."""
    cases = (block for segment in flat(segments) if segment.has_cases for block in segment.blocks)
    return frozenset(name for block in cases for segment in flat(block) for name in segment.value_names)


def item_of(before: dict[str, Any] | None, part: Any) -> dict[str, Any]:
    """Return the fields of an item, of all lists that have one for each."""
    return {**(before or {}), **(part if isinstance(part, dict) else {})}


def layout_read(decode: Callable[..., dict[str, Any]], data: Any, names: Names, padded: bool) -> dict[str, Any]:
    """Decode bytes as the layout; more bytes are an error unless they are `padded`."""
    try:
        return read_layout(decode, data, names) if padded else decode(data, names)
    except EVALUATION_ERRORS as error:
        raise DamagedBufferError(error if isinstance(error, ValueError) else ValueError(explain(error))) from None


def numbers_there(numbers: Any, count: int, unit: str, type_: str | None) -> bytes:
    """Return the numbers of a request in memory's form. Raise PackingError."""
    if not isinstance(numbers, list) or len(numbers) != count:
        raise PackingError(f"{count} values are wanted, not {len(numbers) if isinstance(numbers, list) else numbers!r}")
    return memory_of_numbers(numbers, unit, type_)


def the_only(numbers: list[Any]) -> Any:
    """Return the number of one element. Raise PackingError for more of them."""
    if len(numbers) != 1:
        raise PackingError(f"value is one element, and {len(numbers)} are asked for")
    return numbers[0]


def cannot_be(there: AreaUnit, start: int, count: int) -> None:
    """Raise MemoryRangeError for a place before the first, or a negative number of elements."""
    raise MemoryRangeError(f"{count} × {there.unit} from {start} on cannot be")


def no_data() -> None:
    """Raise MemoryRangeError for a write without data."""
    raise MemoryRangeError("the request brings no data to write")


def wrong_place(
    error: Exception,
    names: Names,
    history: tuple[tuple[str, str], ...],
    variables: Mapping[str, Any],
    parts: str | None,
) -> MatchedRow:
    """Return a request with a wrong place: the names that are known before, and the fault."""
    known = dict(variables.get(parts) or {}) if parts is not None else {}
    known.update((name, variables[variable]) for name, variable in history if variable in variables)
    if isinstance(error, DeviceMemoryError):
        problem = error
    else:
        problem = DataError(str(error)) if isinstance(error, PackingError) else MemoryRangeError(str(error))
    return MatchedRow(Names(known, names), [], problem)


def set_missing(names: Names, values: Mapping[str, Any]) -> None:
    """Set names that have no value to these values."""
    for name, value in values.items():
        names.setdefault(name, value)


def name_targets(reading: MatchedRow) -> None:
    """Give the request the names of its first place, and list all places."""
    names, targets = reading.names, reading.targets
    if targets:
        first = targets[0].names
        for name in PLACE_NAMES:
            if name in first:
                names.setdefault(name, first[name])
        names.setdefault("spans", [target.unit.span(target.start, target.count) for target in targets])
        names[EACH] = [target.names for target in targets]


_RUNTIME: dict[str, Any] = {
    "DamagedBufferError": DamagedBufferError,
    "EVALUATION_ERRORS": EVALUATION_ERRORS,
    "Reading": MatchedRow,
    "RefusedError": RefusedMatchError,
    "Served": Served,
    "Target": MatchTarget,
    "WRONG_PLACE": WRONG_PLACE,
    "attribute": attribute,
    "cannot_be": cannot_be,
    "item_of": item_of,
    "layout_read": layout_read,
    "memory_of": memory_of,
    "name_targets": name_targets,
    "no_data": no_data,
    "numbers_of": numbers_of,
    "numbers_there": numbers_there,
    "part_of": part_of,
    "quotient": quotient,
    "said": said,
    "same_number": same_number,
    "set_missing": set_missing,
    "the_only": the_only,
    "values_of": values_of,
    "wrong_place": wrong_place,
}
