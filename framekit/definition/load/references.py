"""Names that segments mention: what a length counts, what a count counts, what a check covers."""

from __future__ import annotations

from dataclasses import dataclass, replace

from framekit.definition.expression.syntax import Expression
from framekit.definition.load.reader import Reader, parse_number
from framekit.definition.model.frames import fixed_size
from framekit.definition.model.segments import Bits, BitsPart, Check, Count, Data, Field, Length, Repeat, Segment
from framekit.definition.model.walk import bounds_of, change_all, flat, leaves
from framekit.definition.nodes import Mapping, Node, Scalar
from framekit.definition.problems import Position, did_you_mean

Parts = tuple[tuple[Segment, ...], tuple[Segment, ...], tuple[Segment, ...]]


@dataclass(frozen=True, slots=True)
class Where:
    """What one field is fixed to: constants as written, or a `build` expression."""

    key: Scalar
    constants: tuple[Scalar, ...] = ()
    build: Expression | None = None


def load_where(reader: Reader, node: Node) -> dict[str, Where]:
    """`{field: constant | [constants] | {build: EXPR}}`. Raises Broken."""
    result = {}
    for entry in reader.entries(node):
        if isinstance(entry.value, Mapping):
            where = Where(entry.key, build=reader.expression(entry.value.get("build")))
        else:
            where = Where(entry.key, tuple(reader.scalar(item) for item in reader.items(entry.value)))
        result[entry.key.text] = where
    return result


def apply_where(reader: Reader, parts: Parts, wheres: dict[str, Where], frame: Scalar) -> Parts:
    """The segments with the constants written into their fields; unknown fields are noted."""
    left = dict(wheres)

    def change(segment: Segment) -> Segment:
        if isinstance(segment, Field) and segment.name in wheres:
            left.pop(segment.name, None)
            return _fixed_field(reader, segment, wheres[segment.name])
        if isinstance(segment, Bits):
            fixed = []
            for part in segment.parts:
                if part.name in wheres:
                    left.pop(part.name, None)
                    part = _fixed_bits(reader, part, wheres[part.name])
                fixed.append(part)
            return replace(segment, parts=tuple(fixed))
        return segment

    head, body, tail = (change_all(part, change) for part in parts)
    for where in left.values():
        known = [segment.name for part in parts for segment in part if isinstance(segment, Field)]
        reader.note(
            where.key.at,
            f"frame '{frame.text}' has no field '{where.key.text}' to fix",
            did_you_mean(where.key.text, known),
        )
    return head, body, tail


def _fixed_field(reader: Reader, field: Field, where: Where) -> Field:
    if where.build is not None:
        return replace(field, build=where.build)
    constants = tuple(_constant(reader, field, scalar) for scalar in where.constants)
    for scalar, constant in zip(where.constants, constants, strict=True):
        _fits(reader, field, scalar, constant)
    return replace(field, constants=constants)


def _fixed_bits(reader: Reader, part: BitsPart, where: Where) -> BitsPart:
    if where.build is not None:
        return replace(part, build=where.build)
    constants = tuple(_number(reader, part, scalar) for scalar in where.constants)
    most = (1 << part.high - part.low + 1) - 1
    for scalar, number in zip(where.constants, constants, strict=True):
        if not 0 <= number <= most:
            reader.note(scalar.at, f"{number} does not fit: '{part.name}' holds 0 to {most}", "give it more bits")
    return replace(part, constants=constants)


def _constant(reader: Reader, field: Field, scalar: Scalar) -> int | str | bytes:
    if field.type.kind == "ascii":
        return scalar.text
    return reader.bytes(scalar) if field.type.kind == "bytes" else _number(reader, field, scalar)


def _number(reader: Reader, field: Field | BitsPart, scalar: Scalar) -> int:
    """A number, or a name of one. Raises Broken."""
    for number, name in (field.values or {}).items():
        if name == scalar.text:
            return number
    try:
        return parse_number(scalar.text)
    except ValueError as error:
        what, _, todo = str(error).partition(" – ")
        if field.values:
            what = f"'{scalar.text}' is neither a number nor a name in the values of '{field.name}'"
            todo = did_you_mean(scalar.text, field.values.values())
        raise reader.broken(scalar.at, what, todo) from None


def _fits(reader: Reader, field: Field, scalar: Scalar, constant: int | str | bytes) -> None:
    """A constant has the size of its field, and respects what the field says about its values."""
    if isinstance(constant, int):
        _number_fits(reader, field, scalar, constant)
        return
    size = field.type.fixed_size
    padded = field.type.pad is not None
    if size is not None and (len(constant) > size or (len(constant) < size and not padded)):
        what = f"'{scalar.text}' has {len(constant)} bytes, '{field.name}' has {size}"
        reader.note(scalar.at, what, "shorten it" if padded else "correct it, or add pad: to the field")


def _number_fits(reader: Reader, field: Field, scalar: Scalar, number: int) -> None:
    bounds = bounds_of(field.type) if field.long is None else None
    if bounds is not None and not bounds[0] <= number + field.plus <= bounds[1]:
        what = f"{number} does not fit: '{field.name}' holds {bounds[0] - field.plus} to {bounds[1] - field.plus}"
        reader.note(scalar.at, what, "use a wider type, or correct it")
    elif field.limits is not None and field.unit is None and not field.limits[0] <= number <= field.limits[1]:
        low, high = field.limits
        reader.note(scalar.at, f"{number} is not in {low}..{high}, the range of '{field.name}'", "correct one of them")
    elif field.only and field.values is not None and number not in field.values:
        reader.note(scalar.at, f"{number} has no name in the values of '{field.name}'", "add it there, or correct it")


def resolve_references(reader: Reader, parts: Parts, aliases: dict[str, tuple[str, ...]]) -> Parts:
    """The segments with named includes, `body` and bit names written out; names that are not there are noted."""
    head, body, tail = parts
    names = {segment.name: segment for segment in flat(head + body + tail) if segment.name}
    meant = dict(aliases)
    if "body" not in names:
        meant.setdefault("body", tuple(segment.name for segment in body if segment.name))
    for segment in names.values():
        if isinstance(segment, Bits):
            meant |= {part.name: (segment.name or "",) for part in segment.parts}
    resolver = _Resolver(reader, names, meant)
    return (
        change_all(head, resolver.change),
        change_all(body, resolver.change),
        change_all(tail, resolver.change),
    )


class _Resolver:
    def __init__(self, reader: Reader, names: dict[str, Segment], meant: dict[str, tuple[str, ...]]) -> None:
        self.reader = reader
        self.names = names
        self.meant = meant
        self.order = [name for name in names if name]

    def change(self, segment: Segment) -> Segment:
        if isinstance(segment, Length):
            return replace(segment, of=self._written_out(segment.of, segment.at))
        if isinstance(segment, Count):
            self._repeat(segment)
        if isinstance(segment, Check):
            return self._check(segment)
        return segment.with_record(
            lambda inside: resolve_references(self.reader, ((), inside, ()), dict(self.meant))[1]
        )

    def _written_out(self, names: tuple[str, ...], at: Position) -> tuple[str, ...]:
        result: list[str] = []
        for name in names:
            meant = [name] if name in self.names else self.meant.get(name)
            if meant is None:
                self._unknown(name, at)
                continue
            on_wire = [one for one in meant if one not in self.names or any(leaves((self.names[one],)))]
            if not on_wire:
                self.reader.note(at, f"'{name}' takes no bytes", "name segments that stand on the wire")
            result.extend(on_wire)
        return tuple(result)

    def _unknown(self, name: str, at: Position) -> None:
        known = [known for known in [*self.order, *self.meant] if not known.startswith("_")]
        self.reader.note(at, f"there is no segment '{name}' in this frame", did_you_mean(name, known))

    def _repeat(self, count: Count) -> None:
        if not isinstance(self.names.get(count.of), Repeat):
            known = [name for name, segment in self.names.items() if name and isinstance(segment, Repeat)]
            todo = did_you_mean(count.of, known) or "name a segment repeat: in of"
            if isinstance(self.names.get(count.of), (Data, Field)):
                todo = f"write length: {count.name} for the number of bytes"
            self.reader.note(count.at, f"there is no repeat '{count.of}' to count", todo)

    def _check(self, check: Check) -> Segment:
        if check.over is not None:
            return replace(check, over=self._written_out(check.over, check.at))
        if check.span is None:
            return check
        first, last = check.span
        return replace(
            check, span=(self._edge(first, check, 0), "here" if last == "here" else self._edge(last, check, -1))
        )

    def _edge(self, name: str, check: Check, which: int) -> str:
        """The segment at one end of a range: by name, or by its offset in bytes from the start."""
        if name.isdigit():
            return self._at_offset(int(name), check, which)
        written = self._written_out((name,), check.at)
        return written[which] if written else ""

    def _at_offset(self, offset: int, check: Check, which: int) -> str:
        place = 0
        for name in self.order:
            size = fixed_size(self.names[name])
            if which == 0 and place == offset:
                return name
            if size is None:
                break
            place += size
            if which == -1 and place == offset + 1:
                return name
        self.reader.note(
            check.at, f"no segment {'begins' if which == 0 else 'ends'} at offset {offset}", "name the segment instead"
        )
        return ""
