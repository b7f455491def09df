"""Names that frames and segments mention: fields that `where` fixes, what a length counts, what a check covers."""

from __future__ import annotations

from dataclasses import dataclass

from framekit.definition.expression.syntax import Expression
from framekit.definition.kinds.base import Segment, Segments, fixed_size
from framekit.definition.load.reader import Reader
from framekit.definition.model.walk import change_all, flat, leaves
from framekit.definition.problems import Position, did_you_mean
from framekit.definition.tree import Mapping, Node, Scalar

Parts = tuple[Segments, Segments, Segments]


# ---- fields that `where` fixes ------------------------------------------------------------------------------


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
    used: set[str] = set()
    head, body, tail = (change_all(part, lambda one: one.fixed(reader, wheres, used)) for part in parts)
    known = [name for part in parts for one in part for name, _ in one.numbers_with_names() if name == one.name]
    for name, where in wheres.items():
        if name not in used:
            what = f"frame '{frame.text}' has no field '{name}' to fix"
            reader.note(where.key.at, what, did_you_mean(name, known))
    return head, body, tail


# ---- segments that name others ------------------------------------------------------------------------------


def resolve_references(reader: Reader, parts: Parts, aliases: dict[str, tuple[str, ...]]) -> Parts:
    """The segments with named includes, `body` and bit names written out; names that are not there are noted."""
    head, body, tail = parts
    names = {segment.name: segment for segment in flat(head + body + tail) if segment.name}
    meant = dict(aliases)
    if "body" not in names:
        meant.setdefault("body", tuple(segment.name for segment in body if segment.name))
    for segment in names.values():
        meant |= {name: (segment.name or "",) for name in segment.value_names if name != segment.name}
    resolver = _Resolver(reader, names, meant)
    head, body, tail = (change_all(part, lambda one: one.resolved(resolver)) for part in parts)
    return head, body, tail


class _Resolver:
    """What names mean in one frame or record. `meant`: names that stand for others."""

    def __init__(self, reader: Reader, names: dict[str, Segment], meant: dict[str, tuple[str, ...]]) -> None:
        self.reader = reader
        self.names = names
        self.meant = meant

    def inside(self, segments: Segments) -> Segments:
        """The segments of a record inside, where names stand for the same."""
        return resolve_references(self.reader, ((), segments, ()), dict(self.meant))[1]

    def written_out(self, names: tuple[str, ...], at: Position) -> tuple[str, ...]:
        """The segments on the wire that names stand for."""
        result: list[str] = []
        for name in names:
            meant = [name] if name in self.names else self.meant.get(name)
            if meant is None:
                known = [known for known in [*self.names, *self.meant] if not known.startswith("_")]
                self.reader.note(at, f"there is no segment '{name}' in this frame", did_you_mean(name, known))
                continue
            on_wire = [one for one in meant if one not in self.names or any(leaves((self.names[one],)))]
            if not on_wire:
                self.reader.note(at, f"'{name}' takes no bytes", "name segments that stand on the wire")
            result.extend(on_wire)
        return tuple(result)

    def at_offset(self, offset: int, at: Position, which: int) -> str:
        """The segment that begins (`which` 0) or ends (-1) so many bytes from the start."""
        place = 0
        for name, segment in self.names.items():
            size = fixed_size(segment)
            if which == 0 and place == offset:
                return name
            if size is None:
                break
            place += size
            if which == -1 and place == offset + 1:
                return name
        what = f"no segment {'begins' if which == 0 else 'ends'} at offset {offset}"
        self.reader.note(at, what, "name the segment instead")
        return ""
