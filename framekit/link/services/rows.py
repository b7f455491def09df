"""A service row prepared for both sides: what it mentions, which units it can carry, how its data are packed.

Clients and servers read the same rows; neither's work is done here. Language reference, section 11.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.definition.expression.syntax import Expression, names_in
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Data, Segment
from framekit.definition.model.services import Area, ServiceRow
from framekit.definition.model.values import EachOf, FrameOf
from framekit.definition.model.walk import everything, expressions_of, parts_of
from framekit.link.addresses import Address, AddressGrammar, code_of
from framekit.link.evaluate import Evaluate, bare_name, compile_expression
from framekit.link.frame_table import ProtocolCodec, made_once, table_of
from framekit.link.packing import Packer

NATIVE = frozenset({"start", "count", "first"})
"""Names that count elements: a row that sends them, and no text, speaks of the area's own units only."""

COUNTING = frozenset({"count", "bytes", "data", "bits", "total"})
"""Names that say how many elements are meant: a row that sends none of them means one."""


class ServiceRows:
    """Everything the services of one protocol share; `rows` ask, `served` are answered, in the order of the file."""

    def __init__(self, protocol: Protocol, codec: ProtocolCodec) -> None:
        self.protocol = protocol
        self.codec = codec
        self.table = table_of(protocol, codec)
        self.grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
        rows = {service: tuple(RowFacts(row, self) for row in rows) for service, rows in protocol.services.items()}
        asking = {name: tuple(facts for facts in one if not facts.row.server_only) for name, one in rows.items()}
        self.rows = {name: one for name, one in asking.items() if one}
        everything = (facts for one in rows.values() for facts in one)
        self.served = tuple(one for one in everything if one.row.request is not None and not one.row.client_only)

    @property
    def error_frames(self) -> tuple[str, ...]:
        errors = self.protocol.errors
        frames = () if errors is None else errors.frames
        return tuple(frame for name in frames for frame in self.protocol.frames_of(name))


def rows_of(protocol: Protocol, codec: ProtocolCodec) -> ServiceRows:
    """The rows of a protocol, made once for a codec: clients and servers, however many there are, share them."""
    return made_once(protocol, codec, ServiceRows, lambda: ServiceRows(protocol, codec))


class RowFacts:
    """One row. `mentions` are the names its request and the bytes beside it read; `single`: it carries one element."""

    __slots__ = (
        "_packers", "has_each", "limit_bytes", "limit_count", "mentions", "named_numbers", "row", "run", "shared",
        "single", "wants_address", "when",
    )  # fmt: skip

    def __init__(self, row: ServiceRow, shared: ServiceRows) -> None:
        self.row = row
        self.shared = shared
        self.mentions = mentions_of(row)
        self.has_each = any(True for _ in parts_of([row.request, row.buffer], EachOf))
        self.when = _maybe(row.when)
        self.run = _maybe(row.run)
        self.limit_count = _maybe(row.limit.count)
        self.limit_bytes = _maybe(row.limit.bytes)
        self.wants_address = wants_address(row)
        self.single = not self.mentions & COUNTING
        self.named_numbers = self._named_numbers()
        self._packers: dict[str, Packer] = {}

    def _named_numbers(self) -> dict[str, Mapping[str, int]]:
        """Arguments that go as they are into fields whose numbers have names: argument → those numbers by name."""
        found: dict[str, Mapping[str, int]] = {}
        for frame in parts_of(self.row.request, FrameOf):
            numbers = self.shared.table.infos[frame.frame].numbers
            for field, value in frame.fields.items():
                name = bare_name(value) if isinstance(value, Expression) else None
                if name is not None and field in numbers:
                    found[name] = numbers[field]
        return found

    def packer(self, unit: str) -> Packer:
        """How elements of `unit` stand in this row's data."""
        packer = self._packers.get(unit)
        if packer is None:
            packer = self._packers[unit] = Packer(self.row.packing, unit)
        return packer

    def fits(self, area: Area, unit: str) -> bool:
        """Whether the row can carry elements of `unit` of `area`, its condition aside."""
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

    def place_is_in(self, address: Address) -> bool:
        """Whether the request names the place by parts of the address, so that it cannot be counted in other units."""
        return bool(self.mentions & address.parts.keys())

    def names(self, address: Address, count: int) -> dict[str, Any]:
        """The names this row has of `count` elements at an address, those about data and parts of transfers aside.

        Raises AddressError if the row sends the address as text and no form shows it.
        """
        grammar = self.shared.grammar
        packer = self.packer(address.unit)
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


def mentions_of(row: ServiceRow) -> frozenset[str]:
    """The names that a row's request and the bytes beside it read."""
    return frozenset(name for part in expressions_of([row.request, row.buffer]) for name in names_in(part.root))


def wants_address(row: ServiceRow) -> bool:
    """Whether the requests of a row name places of the other side."""
    return bool((mentions_of(row) & {"text", "start"}) - {argument.name for argument in row.takes})


def _maybe(expression: Expression | None) -> Evaluate | None:
    return None if expression is None else compile_expression(expression)


def padded_names(segments: tuple[Segment, ...]) -> frozenset[str]:
    """The data among these segments that are filled up with padding."""
    return frozenset(one.name for one in everything(segments) if isinstance(one, Data) and one.pad is not None)
