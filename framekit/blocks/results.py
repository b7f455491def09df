"""CALL blocks and the own memory: arguments read from places, results stored in them.

A result is named by what the service gives: `time.hour`, `faults.faults.code`. What kind of value that is follows from
the service's rows, as far as they say it; what they leave open is judged when it comes. Either everything is stored, or
nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from framekit.blocks.model import ArgumentPlace, Block, ResultPlace
from framekit.blocks.own_memory import Piece, read_piece
from framekit.definition.expression.syntax import Attribute, Conditional, Expression, Index, List, Name, Node, Number
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import (
    Bits,
    Count,
    Data,
    Field,
    FieldType,
    Length,
    Record,
    Repeat,
    Segment,
)
from framekit.definition.model.services import Packing, ServiceRow
from framekit.definition.model.values import LayoutOf, ReadAs, RecordOf, Value
from framekit.definition.model.walk import flat
from framekit.definition.problems import did_you_mean
from framekit.link.evaluate import EVALUATION_ERRORS, Names, compile_expression
from framekit.link.packing import Packer, join_memory, memory_of, values_of
from framekit.link.services.client import TransferResult
from framekit.memory.memory import DeviceMemory, unit_bits
from framekit.memory.views import as_signed, from_float

MILLISECOND = 1_000_000
LONGEST = 65536
"""Most elements of a list, or bytes, that one result or argument can have."""

# ---- what kind of value a result is -----------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """What is known about a result. `size`: bytes of data or text that always has so many; `scale`: nanoseconds a
    number counts; `item`: of a list; `parts`: of a record."""

    kind: Literal["any", "number", "bytes", "text", "list", "record"] = "any"
    size: int | None = None
    scale: int = 1
    item: Shape | None = None
    parts: Mapping[str, Shape] | None = None

    @property
    def is_long(self) -> bool:
        """Whether there may be any number of elements or bytes."""
        return self.kind == "list" or (self.kind in ("bytes", "text") and self.size is None)


ANY = Shape()
_WORDS = {"number": "a number", "bytes": "bytes", "text": "a text"}


class NoResultError(ValueError):
    """A service does not give what is named; `hint` is what could be meant."""

    def __init__(self, what: str, hint: str) -> None:
        super().__init__(what)
        self.hint = hint


def shapes_of(protocol: Protocol, row: ServiceRow) -> dict[str, Shape]:
    """What one row of a service gives, with the reply's frame and the bytes beside it."""
    frames = [reply.frame.frame for reply in row.reply if reply.frame is not None]
    parts = [_parts(protocol.frames[name].segments) for name in frames if name in protocol.frames]
    known = {"buffer": Shape(kind="bytes")}
    if parts:
        known["reply"] = Shape(kind="record", parts=_either(parts))
    return known | {name: _given(protocol, value, known) for name, value in row.gives.items()}


def shape_at(expression: Expression, known: Mapping[str, Shape]) -> Shape:
    """The kind of the result that an expression names. Raises NoResultError."""
    return _followed(expression.root, known)


def is_path(node: Node) -> bool:
    """Whether an expression only names something: `time.hour`, `faults[0].code`."""
    if isinstance(node, Index):
        return isinstance(node.index, Number) and is_path(node.value)
    return isinstance(node, Name) or (isinstance(node, Attribute) and is_path(node.value))


def _followed(node: Node, known: Mapping[str, Shape]) -> Shape:
    match node:
        case Name(name=name):
            if name not in known:
                given = [one for one in known if one not in ("reply", "buffer")] or list(known)
                raise NoResultError(f"no result '{name}'", did_you_mean(name, given))
            return known[name]
        case Attribute(value=value, name=name):
            return _part(_followed(value, known), name)
        case Index(value=value):
            shape = _followed(value, known)
            return shape.item or ANY if shape.kind == "list" else Shape(kind="number") if shape.kind == "bytes" else ANY
        case Conditional(then=first, otherwise=second):
            one, other = _followed(first, known), _followed(second, known)
            return one if one.kind == other.kind else ANY
        case List():
            return Shape(kind="list", item=_followed(node.items[0], known) if node.items else ANY)
    return ANY


def _part(shape: Shape, name: str) -> Shape:
    if shape.kind == "list":
        return Shape(kind="list", item=_part(shape.item or ANY, name))
    if shape.kind == "record" and shape.parts is not None:
        if name not in shape.parts:
            raise NoResultError(f"no '{name}' in it", did_you_mean(name, shape.parts))
        return shape.parts[name]
    if shape.kind in ("number", "bytes", "text"):
        raise NoResultError(f"no '{name}' in it: it is {_WORDS[shape.kind]}", f"leave .{name} out")
    return ANY


def _given(protocol: Protocol, value: Value, known: Mapping[str, Shape]) -> Shape:
    match value:
        case ReadAs(layout=layout) if layout in protocol.layouts:
            return Shape(kind="record", parts=_parts(protocol.layouts[layout].segments))
        case LayoutOf():
            return Shape(kind="bytes")
        case RecordOf(fields=fields):
            return Shape(kind="record", parts={name: _given(protocol, one, known) for name, one in fields.items()})
        case Expression():
            try:
                return _followed(value.root, known)
            except NoResultError:
                return ANY
    return ANY


def _either(records: Sequence[Mapping[str, Shape]]) -> dict[str, Shape]:
    """The parts that a value has which is one of these records."""
    found: dict[str, Shape] = {}
    for record in records:
        for name, shape in record.items():
            found[name] = shape if found.get(name, shape) == shape else ANY
    return found


def _parts(segments: Iterable[Segment]) -> dict[str, Shape]:
    found: dict[str, Shape] = {}
    for segment in flat(segments):
        if isinstance(segment, Bits):
            found |= {part.name: Shape(kind="number") for part in segment.parts}
        elif segment.name is not None:
            shape = _of_segment(segment)
            found[segment.name] = shape if found.get(segment.name, shape) == shape else ANY
    return found


def _of_segment(segment: Segment) -> Shape:
    match segment:
        case Field():
            return replace(_of_type(segment.type), scale=segment.unit or 1)
        case Data():
            return Shape(kind="bytes", size=segment.size if isinstance(segment.size, int) else None)
        case Length() | Count():
            return Shape(kind="number")
        case Record():
            return Shape(kind="record", parts=_parts(segment.of))
        case Repeat():
            of = segment.of
            item = _of_type(of) if isinstance(of, FieldType) else Shape(kind="record", parts=_parts(of))
            return Shape(kind="list", item=item)
    return ANY


def _of_type(type_: FieldType) -> Shape:
    if type_.kind in ("ascii", "bytes"):
        return Shape(
            kind="text" if type_.kind == "ascii" else "bytes", size=type_.size if isinstance(type_.size, int) else None
        )
    return Shape(kind="number")


# ---- results into memory ----------------------------------------------------------------------------------


def result_pieces(block: Block, result: TransferResult) -> Iterator[Piece]:
    """What a call gave, at the places that the block names. Raises ValueError for what cannot be stored there."""
    names = Names({"reply": result.reply, "buffer": result.buffer, **result.gives})
    for place in block.results:
        try:
            value = compile_expression(place.result)(names)
        except EVALUATION_ERRORS:
            raise ValueError(f"the call gave no '{place.result}'") from None
        bits, data = _stored(place, value, block.packing or Packing())
        yield place.place, bits, data


def _stored(place: ResultPlace, value: Any, packing: Packing) -> tuple[int, bytes]:
    """Bits and content, in memory's form; what is shorter than its room is filled with zeros."""
    address, name = place.place.address, str(place.result)
    if isinstance(value, (int, float)):
        return _numbers(place, [value])
    if isinstance(value, (bytes, str)):
        text = isinstance(value, str)
        data = value.encode("latin-1", "replace") if isinstance(value, str) else value
        bits, data = (8 * len(data), data) if text else _bytes(place, data, packing)
        room = None if place.size is None else 8 * place.size
        what = f"{len(value)} {'characters' if text else 'bytes'}"
    elif isinstance(value, list) and all(isinstance(item, bytes) for item in value):
        bits, data = _bytes(place, b"".join(value), packing)
        room, what = _elements(place), f"{bits // address.unit_bits} elements"
    elif isinstance(value, list) and all(isinstance(item, (int, float)) for item in value):
        bits, data = _numbers(place, value)
        room, what = _elements(place), f"{len(value)} elements"
    else:
        raise ValueError(f"'{name}' is neither a number nor data, but {_shown(value)}")
    if room is None:
        raise ValueError(f"nothing says how much room '{name}' has, and it has {what} – give the block size:")
    if bits > room:
        raise ValueError(f"'{name}' has {what}, and there is room for {place.size}")
    return room, join_memory([(data, bits), (bytes((room - bits + 7) // 8), room - bits)])


def _elements(place: ResultPlace) -> int | None:
    return None if place.size is None else place.size * place.place.address.unit_bits


def _numbers(place: ResultPlace, values: Sequence[float]) -> tuple[int, bytes]:
    address = place.place.address
    scaled: list[Any] = [value // place.scale if place.scale > 1 else value for value in values]
    if any(isinstance(value, float) for value in scaled):
        if address.unit_bits not in (32, 64):
            raise ValueError(f"'{place.result}' is a floating-point number, and {place.place.text} is a {address.unit}")
        scaled = list(from_float(scaled, address.unit))
    try:
        return len(scaled) * address.unit_bits, memory_of(scaled, address.unit)
    except ValueError as error:
        raise ValueError(f"'{place.result}' does not fit into {place.place.text}: {error}") from None


def _bytes(place: ResultPlace, data: bytes, packing: Packing) -> tuple[int, bytes]:
    """Data as elements of the place, as the service's row packs them."""
    packer = Packer(packing, place.place.address.unit)
    count = packer.count_in(0, len(data))
    return count * packer.bits, packer.to_memory(data, 0, count)


def _shown(value: Any) -> str:
    return "a list of such" if isinstance(value, list) else "nothing" if value is None else "a record of several"


# ---- arguments from memory --------------------------------------------------------------------------------


def arguments_of_call(block: Block, memory: DeviceMemory) -> dict[str, Any]:
    """The arguments of a call as they are now. Raises DeviceMemoryError."""
    return {**block.arguments, **{name: _argument(place, memory) for name, place in block.argument_places.items()}}


def _argument(given: ArgumentPlace, memory: DeviceMemory) -> Any:
    address = given.place.address
    if given.type in ("text", "choice", "bytes"):
        data = read_piece(memory, given.place, 8 * given.size)
        return data if given.type == "bytes" else data.rstrip(b"\0").decode("latin-1")
    numbers: Sequence[Any] = values_of(
        read_piece(memory, given.place, given.size * address.unit_bits), address.unit, given.size
    )
    if given.signed and address.unit_bits > 1:
        numbers = as_signed(numbers, address.unit)
    if given.type == "list":
        return list(numbers)
    return numbers[0] * MILLISECOND if given.type == "time" else numbers[0]


def argument_bits(type_: str, size: int, unit: str) -> int:
    """How many bits of the memory an argument takes."""
    return 8 * size if type_ in ("text", "choice", "bytes") else size * unit_bits(unit)
