"""A service row read backwards: from a request that arrived to the places and data it asks for.

Whether a device has these places, and what is done with them, is decided elsewhere. Language reference, section 11
(read backwards).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.values import LayoutOf
from framekit.link.addresses import AddressError
from framekit.link.area_view import code_of
from framekit.link.construct_values import EACH
from framekit.link.device_areas import DeviceAreas, Span
from framekit.link.evaluate import EVALUATION_ERRORS, Evaluate, Names, compile_expression
from framekit.link.invert import NotReadableError, bare_name
from framekit.link.leaves import Binding, LeafCompiler, MismatchError
from framekit.link.packing import PackingError, memory_of, values_of
from framekit.link.service_rows import RowFacts
from framekit.link.values import FrameValue
from framekit.memory.memory import DeviceMemoryError, MemoryRangeError, UnknownAreaError

Codes = dict[Any, list[tuple[str, str]]]
"""What stands for areas on the wire: code → areas with the unit it counts in."""


@dataclass(slots=True)
class Target:
    """One place a request asks for, and the data it brings for it: as in the frame, and in memory's form."""

    span: Span
    names: Names
    data: bytes | None = None
    memory: bytes | None = None


@dataclass(slots=True)
class Reading:
    """A row that fits a request. `problem` is what is wrong with the places it names, to be told in its turn."""

    names: Names
    targets: list[Target] = field(default_factory=list)
    problem: DeviceMemoryError | None = None


class ElsewhereError(Exception):
    """The request names an area (`known`: of the protocol) that this row is not for."""

    def __init__(self, known: bool) -> None:
        super().__init__()
        self.known = known


class BackwardRow:
    """A row ready to be read backwards. `frame` is the request it is for."""

    def __init__(self, facts: RowFacts, areas: DeviceAreas, codes: Codes) -> None:
        row, shared = facts.row, facts.shared
        assert row.request is not None
        leaves = LeafCompiler(shared.protocol, shared.codec, shared.table)
        self.facts = facts
        self.frame = row.request.frame
        self.areas = areas
        self.codes = codes
        self.grammar = shared.grammar
        self._request = leaves.match(row.request)
        self._buffer = None if row.buffer is None else leaves.match(row.buffer, padded=isinstance(row.buffer, LayoutOf))
        back = {**row.back, **row.back_each}
        self._back = {name: _word_or_value(name, value, areas) for name, value in back.items()}
        self._of_items = row.back_each.keys()
        self._when: Evaluate | None = self._back.pop("when", facts.when)
        self._arguments = {argument.name for argument in row.takes}

    def read(self, request: FrameValue, buffer: bytes, names: Names, check_only: bool) -> Reading:
        """The request's meaning by this row. `check_only`: the bytes beside it are not here yet.

        Raises MismatchError when the row does not fit, ElsewhereError when it is not for the area that is asked for,
        DamagedBufferError when bytes in the request, or beside it, are not the layout they should be.
        """
        binding = Binding()
        self._request(request, binding, names)
        if self._buffer is not None and not check_only:
            self._buffer(buffer, binding, names)
        elif buffer and not check_only:
            raise MismatchError("buffer")
        reading = Reading(Names(parent=names))
        try:
            self._place(binding, request, reading)
        except (DeviceMemoryError, AddressError, PackingError) as error:
            reading.problem = error if isinstance(error, DeviceMemoryError) else MemoryRangeError(str(error))
            reading.names.update(binding.values)
        if self._when is not None and not self._holds(reading):
            raise MismatchError("when")
        return reading

    def _holds(self, reading: Reading) -> bool:
        """Whether the row's condition holds; what cannot be told because the place is wrong is no objection."""
        assert self._when is not None
        try:
            return bool(self._when(reading.names))
        except EVALUATION_ERRORS:
            return reading.problem is not None

    # ---- places -------------------------------------------------------------------------------------------

    def _place(self, binding: Binding, request: FrameValue, reading: Reading) -> None:
        if binding.variables is None:
            found = self._target(binding, reading.names, request)
            if found is not None:
                reading.targets.append(found)
        else:
            for variable in binding.variables:
                found = self._target(variable, Names(parent=reading.names), request)
                if found is not None:
                    reading.targets.append(found)
            self._bind(binding, reading.names)
        if reading.targets:
            first = reading.targets[0].names
            for name in ("area", "unit", "start", "count", "bytes", "element_bytes", "total"):
                if name in first:
                    reading.names.setdefault(name, first[name])
            reading.names.setdefault("spans", [target.span for target in reading.targets])
            reading.names[EACH] = [target.names for target in reading.targets]

    def _target(self, binding: Binding, names: Names, request: FrameValue) -> Target | None:
        """The place a binding speaks of; None if it speaks of none. All its names are in `names` then."""
        area, unit = self._area(binding, names)
        if area is not None:
            names["area"] = self.grammar.views[area]
        elif not self._back.keys() & {"area", "memory"}:
            self._bind(binding, names)
            return None
        for name, value in binding.values.items():
            names.setdefault(name, value)
        if "text" in self._back:
            names["unit"] = unit
        if "memory" in self._back:
            names["own_bytes"] = self.areas.own_bytes(str(self._read_back("memory", binding, names)))
        for name in self._back:
            if name not in ("area", "memory", "text"):
                names[name] = self._read_back(name, binding, names)
        self._bind(binding, names)
        if "unit" in names:
            unit = names["unit"]
        return self._completed(binding, names, area, unit)

    def _read_back(self, name: str, binding: Binding, names: Names) -> Any:
        """What `back` says; where it says it of each item, the item's fields are names."""
        seen = Names(binding.item, names) if name in self._of_items else names
        try:
            return self._back[name](seen)
        except EVALUATION_ERRORS as error:
            raise MismatchError(explain(error)) from None

    def _bind(self, binding: Binding, names: Names) -> None:
        """The names with values, then those whose values follow from what area it is; `back` goes before them."""
        for name, value in binding.values.items():
            names.setdefault(name, value)
        for inverse, actual in binding.pending:
            if inverse.name in self._back:
                continue
            try:
                value = inverse.solve(actual, names)
            except (NotReadableError, *EVALUATION_ERRORS):
                raise MismatchError(inverse.name) from None
            if names.setdefault(inverse.name, value) != value:
                raise MismatchError(inverse.name)

    def _area(self, binding: Binding, names: Names) -> tuple[str | None, str | None]:
        """Area and unit that the request names: by `back`, by text, by code, or because the row is for one area."""
        row, values = self.facts.row, binding.values
        if "text" in self._back:
            binding.values["text"] = self._read_back("text", binding, Names(values, names))
            return self._by_text(binding)
        if "text" in values and "text" not in self._arguments:
            return self._by_text(binding)
        if "area" in self._back:
            area = self._read_back("area", binding, names)
            if area not in self.areas.areas:
                raise UnknownAreaError(f"there is no area '{area}'")
            return str(area), None
        if "code" in values and "code" not in self._arguments:
            return self._by_code(values["code"])
        if len(row.areas) == 1:
            return row.areas[0], row.units[0] if len(row.units) == 1 else None
        return None, None

    def _by_text(self, binding: Binding) -> tuple[str, str]:
        text = binding.values["text"]
        try:
            address = self.grammar.parse(str(text), check=False)
        except AddressError as error:
            raise UnknownAreaError(str(error)) from None
        if self.facts.row.areas and address.area not in self.facts.row.areas:
            raise ElsewhereError(True)
        for name, value in address.parts.items():
            binding.values.setdefault(name, value)
        binding.bind("start", address.start)
        return address.area, address.unit

    def _by_code(self, code: Any) -> tuple[str, str]:
        found = self.codes.get(code, [])
        for area, unit in found:
            if not self.facts.row.areas or area in self.facts.row.areas:
                return area, self._unit_of_row(area, unit, code)
        raise ElsewhereError(bool(found))

    def _unit_of_row(self, area: str, unit: str, code: Any) -> str:
        """The unit that the code means in this row: one of the row's own, where the code can stand for it."""
        units = self.facts.row.units
        if not units or unit in units:
            return unit
        return next((own for own in units if code_of(self.grammar.areas[area], own) == code), unit)

    # ---- counts and data ----------------------------------------------------------------------------------

    def _completed(self, binding: Binding, names: Names, area: str | None, unit: str | None) -> Target:
        start = int(names["start"]) if "start" in names else 0
        if area is None or "memory" in self._back:
            span = self.areas.memory_span(str(self._read_back("memory", binding, names)), unit, start, 1)
        else:
            span = self.areas.span(area, unit, start, 1)
        packer = self.facts.packer(span.unit)
        names["start"], names["unit"] = start, span.unit
        data = binding.values.get("data")
        if "count" not in names:
            names["count"] = self._count(packer.count_in, names, data, start)
        count = int(names["count"])
        if start < 0 or count < 0:
            raise MemoryRangeError(f"{count} × {span.unit} from {start} on cannot be")
        span = Span(span.area, span.memory, span.unit, start, count)
        names["bytes"], names["element_bytes"] = packer.size(start, count), max(1, packer.bits // 8)
        names.setdefault("total", count)
        target = Target(span, names)
        if data is not None:
            target.data = data[: names["bytes"]] if binding.padded else data
            target.memory = packer.to_memory(target.data, start, count)
        elif "bits" in self._back:
            target.memory = memory_of(names["bits"], "bit")
            target.data = packer.to_data(target.memory, start, count)
        if target.memory is not None:
            names["data"] = target.data
            if span.unit == "bit":
                names["bits"] = values_of(target.memory, "bit", count)
        return target

    def _count(self, count_in: Callable[[int, int], int], names: Names, data: Any, start: int) -> int:
        """How many elements, when the request says it only in bytes; one if it does not say it at all."""
        size = names["bytes"] if "bytes" in names else None if data is None else len(data)
        return 1 if size is None else count_in(start, int(size))


def _word_or_value(name: str, value: Expression, areas: DeviceAreas) -> Evaluate:
    """A bare word that is a unit or an area stands for itself."""
    word = bare_name(value)
    if word is not None and (name == "unit" or (name in ("area", "memory") and word in areas.areas)):
        return lambda names: word
    return compile_expression(value)
