"""Loader of segments, groups and frames: from the nodes of a head, body, tail or layout to the model.

Includes are replaced by their segments, `where` is written into the fields, and names of segments are resolved. The
kinds of segments and their readers are in `definition/kinds`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any

from framekit.definition.expression import Expression, Number, names_in
from framekit.definition.keys import Meanings
from framekit.definition.kinds.base import KINDS, Segment, Segments, fixed_size
from framekit.definition.load.namespace import Namespace, Owned
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.load.resolve import with_item_words
from framekit.definition.model.frames import (
    Announced,
    Frame,
    Group,
    Mark,
    PartlyRead,
    Side,
    change_all,
    field_names,
    flat,
    leaves,
    with_holders,
)
from framekit.definition.model.segments import Require, Skip
from framekit.definition.problems import Position, did_you_mean, plural
from framekit.definition.tree import Entry, Mapping, Node, Scalar, Sequence, words_in

MOST_SEGMENTS = 4000
"""Largest number of segments of one frame, including its includes."""
MOST_LEVELS = 32
"""Largest depth of a layout that contains itself."""


class SegmentLoader:
    """Reads lists of segments.

    `space` gives the meaning of the names of types, tables and checks; `frames` finds the frames that `inner` and
    `inside` name. `level`: depth of a layout that contains itself. `side`: sender of the frame. `aliases`: named
    includes, each with the names of its segments. `spoilt`: whether broken segments were left out. `begun`: the layout
    read by itself. `known`: the names that expressions may read in addition to values. `lost`: the words of the
    segments that were left out, which may be names; None if they may have any name. `holders`: the places of segments
    inside which others were left out.
    """

    def __init__(self, space: Meanings, frames: FrameLoader, level: int = 1) -> None:
        self.space = space
        self.frames = frames
        self.level = level
        self.reader = space.reader
        self.side: str | None = None
        self.aliases: dict[str, tuple[str, ...]] = {}
        self.under_way: list[tuple[str, Sequence]] = []
        self.read = 0
        self.begun: Sequence | None = None
        self.unnamed = 0
        self.spoilt = False
        self.lost: frozenset[str] | None = frozenset()
        self.holders: set[Position] = set()
        self.known = _names_everywhere(space)

    def load(self, node: Node | None) -> Segments:
        """Return the segments of a list; broken ones are noted and left out."""
        found: list[Segment] = []
        is_spoilt = self.spoilt
        for item in self.reader.items(node):
            self.spoilt = False
            try:
                self._number(item)
                found.extend(self._segment(self.reader.mapping(item)))
                if self.spoilt:
                    self.holders.add(item.at)
            except Broken:
                self.spoilt = True
                self._leave_out(item)
            is_spoilt = is_spoilt or self.spoilt
        self.spoilt = is_spoilt
        return in_order(tuple(found))[0]

    def _leave_out(self, item: Node) -> None:
        """Add the words of a broken segment to the lost names."""
        if isinstance(item, Mapping) and "include" in item:
            self.lost = None
        elif self.lost is not None:
            self.lost |= words_in(item)

    def _number(self, item: Node) -> None:
        """Count a segment; raise Broken at the limit, which nested includes may reach."""
        self.read += 1
        if self.read == MOST_SEGMENTS and not self.space.too_much:
            self.space.too_much = True
            what = f"the frame has more than {MOST_SEGMENTS} segments with all it includes"
            self.reader.note(item.at, what, "take repeat: for what comes several times")
        if self.read >= MOST_SEGMENTS:
            if self.begun is not None:
                self.space.too_large.add(self.begun.at)
            raise Broken("too many segments")

    def _segment(self, keys: Mapping) -> Segments:
        kinds = [entry.key.text for entry in keys.entries if entry.key.text in KINDS]
        if len(kinds) != 1:
            raise Broken("the schema has told what is wrong with the kind")
        return KINDS[kinds[0]].load(self, keys)

    def common(self, keys: Mapping, kind: str) -> dict[str, Any]:
        """Return the attributes that all kinds have; a segment without a name gets an internal name."""
        reader = self.reader
        name = keys.get("name")
        if name is None:
            self.unnamed += 1
        return {
            "at": keys.at,
            "name": f"_{kind}_{self.unnamed}" if name is None else reader.text(name),
            "when": reader.maybe(reader.expression, keys.get("when")),
            "refuse": reader.maybe(reader.number, keys.get("refuse")),
            "doc": reader.maybe(reader.text, keys.get("doc")) or "",
        }

    def layout(self, node: Node) -> Segments:
        """Return the segments of the layout that `node` names, read in its own namespace. Raises Broken."""
        nodes, space = self.space.layout(node)
        names = [name for name, _ in self.under_way]
        place = next((place for place, (_, other) in enumerate(self.under_way) if other is nodes), None)
        if place is not None:
            raise self._circle(node, names[place:])
        if nodes.at in self.space.too_large:
            raise Broken("too many segments")
        if not self.read:
            self.begun = nodes
        if space is not self.space:
            self.known |= _names_everywhere(space)
        outer, self.space = self.space, space
        self.under_way.append((self.reader.text(node), nodes))
        try:
            return self.load(nodes)
        finally:
            self.space = outer
            self.under_way.pop()

    def find_frames(self, space: Any, node: Node) -> tuple[str, ...]:
        """Return the frames that a name refers to. Raises Broken."""
        return self.frames.find(space, node)

    def nested(self, node: Node, depth: Node) -> str:
        """Return the frame for a layout that contains itself, one level deeper. Raises Broken."""
        nodes, space = self.space.layout(node)
        most = self.reader.number(depth)
        if not 2 <= most <= MOST_LEVELS:
            raise self.reader.broken(depth.at, f"depth is from 2 to {MOST_LEVELS}, not {most}", "correct it")
        if all(other is not nodes for _, other in self.under_way) and not _stands_in(nodes, space, nodes, []):
            what = f"'{self.reader.text(node)}' does not stand in itself, so depth has no effect"
            raise self.reader.broken(depth.at, what, "leave it out")
        return self.frames.nested(self.space, node, self.level + 1, most)

    def _circle(self, node: Node, names: list[str]) -> Broken:
        """Return the error for layouts that include each other; each circle is noted once."""
        if frozenset(names) in self.space.circles:
            return Broken(names[0])
        self.space.circles.add(frozenset(names))
        chain = " → ".join([*names, names[0]])
        what = f"layouts include each other in a circle: {chain}" if len(names) > 1 else f"'{names[0]}' includes itself"
        todo = "break the circle, or include it with as: and depth: in a repeat, a choose or an optional"
        return self.reader.broken(node.at, what, todo)


def _stands_in(wanted: Sequence, space: Meanings, nodes: Node, seen: list[Node]) -> bool:
    """Return whether nodes include a layout, directly or through other layouts."""
    if isinstance(nodes, Sequence):
        return any(_stands_in(wanted, space, item, seen) for item in nodes.items)
    if not isinstance(nodes, Mapping):
        return False
    for entry in nodes.entries:
        if entry.key.text == "include" and isinstance(entry.value, Scalar):
            found, inner = space.layout(entry.value)
            if found is wanted:
                return True
            if all(found is not one for one in seen):
                seen.append(found)
                if _stands_in(wanted, inner, found, seen):
                    return True
        elif _stands_in(wanted, space, entry.value, seen):
            return True
    return False


def in_order(*lists: Segments) -> list[Segments]:
    """Return adjacent lists with every value without bytes moved after the segments it depends on."""
    if not any(segment.follows for segments in lists for segment in segments):
        return list(lists)
    late = {name for segments in lists for segment in segments for name in _names_of(segment)}
    waiting: list[Segment] = []
    found: list[Segments] = []

    def place(segment: Segment, here: list[Segment]) -> None:
        here.append(segment)
        late.difference_update(_names_of(segment))
        for value in waiting:
            if not late & _read_by(value):
                waiting.remove(value)
                return place(value, here)

    for segments in lists:
        here: list[Segment] = []
        for segment in segments:
            if segment.follows is not None and late & _read_by(segment) - {segment.name}:
                waiting.append(segment)
            else:
                place(segment, here)
        if segments is lists[-1]:
            here += waiting
        found.append(tuple(here))
    return found


def _names_of(segment: Segment) -> set[str]:
    return {name for name in (segment.name, *field_names((segment,))) if name is not None}


def _read_by(value: Segment) -> set[str]:
    return {name for one in (value.follows, value.when) if one is not None for name in names_in(one.root)}


def _names_everywhere(space: Meanings) -> set[str]:
    """Return the names of a file that its expressions may read anywhere."""
    return {name for section in ("params", "state", "tables", "queues") for name in space.section(section)}


# ---- names that frames and segments mention -----------------------------------------------------------------


Parts = tuple[Segments, Segments, Segments]


# ---- fields that `where` fixes ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Where:
    """Values fixed for a field: constants as written, or a `build` expression."""

    key: Scalar
    constants: tuple[Scalar, ...] = ()
    build: Expression | None = None


def load_where(reader: Reader, node: Node) -> dict[str, Where]:
    """Read `{field: constant | [constants] | {build: EXPR}}`. Raises Broken."""
    result = {}
    for entry in reader.entries(node):
        if isinstance(entry.value, Mapping):
            where = Where(entry.key, build=reader.expression(entry.value.get("build")))
        else:
            where = Where(entry.key, tuple(reader.scalar(item) for item in reader.items(entry.value)))
        result[entry.key.text] = where
    return result


def apply_where(reader: Reader, parts: Parts, wheres: dict[str, Where], frame: Scalar) -> Parts:
    """Return the segments with the constants written into their fields; unknown fields are noted."""
    used: set[str] = set()
    head, body, tail = (change_all(part, lambda one: one.fixed(reader, wheres, used)) for part in parts)
    known = [name for part in parts for one in part for name, _ in one.numbers_with_names() if name == one.name]
    for name, where in wheres.items():
        if name not in used:
            what = f"frame '{frame.text}' has no field '{name}' to fix"
            reader.note(where.key.at, what, did_you_mean(name, known))
    return head, body, tail


# ---- segments that name others ------------------------------------------------------------------------------


class MissingSegments:
    """Names of missing segments. A name in a group is noted once for all of its frames."""

    def __init__(self, reader: Reader) -> None:
        self.reader = reader
        self.told: set[tuple[Position, str]] = set()
        self.found: dict[tuple[Position, str], dict[str, set[str]]] = {}

    def add(self, at: Position, name: str, whose: str, known: Iterable[str]) -> None:
        """Add a missing name. `whose`: the part that lacks it, such as `frame 'A'`; `known`: its names."""
        self.found.setdefault((at, name), {})[whose] = {one for one in known if not one.startswith("_")}

    def take_over(self, other: MissingSegments, apart: Collection[str]) -> None:
        """Add the names of another list, apart from some."""
        for (at, name), known in other.found.items():
            if name not in apart:
                self.found.setdefault((at, name), {}).update(known)

    def tell(self) -> None:
        """Note the names added since the last call, each place once."""
        for (at, name), known in self.found.items():
            if (at, name) not in self.told:
                first, *others = known
                more = f" and {plural(len(others), 'other')}" if others else ""
                what = f"{first}{more} {'have' if others else 'has'} no segment '{name}'"
                self.reader.note(at, what, did_you_mean(name, set.intersection(*known.values())))
        self.told.update(self.found)
        self.found.clear()


BODY = "body"
"""Name for the whole body of a frame."""


def resolve_references(
    parts: Parts, aliases: dict[str, tuple[str, ...]], whose: str, missing: MissingSegments
) -> Parts:
    """Return the segments with their paths, and with named includes, `body` and bit names expanded; missing names are
    noted.

    `whose`: the owner of the segments, such as `frame 'A'`.
    """
    head, body, tail = map(with_holders, _resolved(parts, aliases, whose, missing))
    return head, body, tail


def _resolved(parts: Parts, aliases: dict[str, tuple[str, ...]], whose: str, missing: MissingSegments) -> Parts:
    """Return the segments of a frame or record, inner records included, with their names expanded."""
    head, body, tail = parts
    names = {segment.name: segment for segment in flat(head + body + tail) if segment.name}
    meant = dict(aliases)
    if BODY not in names:
        meant.setdefault(BODY, tuple(segment.name for segment in body if segment.name))
    for segment in names.values():
        meant |= {name: (segment.name or "",) for name in segment.value_names if name != segment.name}
    resolver = _Resolver(names, meant, whose, missing)
    head, body, tail = (change_all(part, lambda one: one.resolved(resolver)) for part in parts)
    return head, body, tail


class _Resolver:
    """Meanings of names in a frame or record. `meant`: names that stand for others."""

    def __init__(
        self, names: dict[str, Segment], meant: dict[str, tuple[str, ...]], whose: str, missing: MissingSegments
    ) -> None:
        self.reader = missing.reader
        self.names = names
        self.meant = meant
        self.whose = whose
        self.missing = missing

    def inside(self, segments: Segments) -> Segments:
        """Return the segments of an inner record, in which names have the same meaning."""
        return _resolved(((), segments, ()), dict(self.meant), self.whose, self.missing)[1]

    def written_out(self, names: tuple[str, ...], at: Position, *, may_be_empty: bool = True) -> tuple[str, ...]:
        """Return the segments on the wire that names stand for; an empty tuple for a body without any if
        `may_be_empty`.
        """
        result: list[str] = []
        for name in names:
            meant = [name] if name in self.names else self.meant.get(name)
            if meant is None:
                self.missing.add(at, name, self.whose, [*self.names, *self.meant])
                continue
            on_wire = [one for one in meant if one not in self.names or any(leaves((self.names[one],)))]
            if not on_wire and not (name == BODY and may_be_empty):
                self.reader.note(at, f"'{name}' takes no bytes", "name segments that stand on the wire")
            result.extend(on_wire)
        return tuple(result)

    def at_offset(self, offset: int, at: Position, which: int) -> str:
        """Return the segment that begins (`which` 0) or ends (-1) at a constant offset from the start."""
        place = 0
        for name, segment in self.names.items():
            size = fixed_size(segment)
            if which == 0 and place == offset and segment.takes_bytes:
                return name
            if size is None:
                break
            place += size
            if which == -1 and place == offset + 1:
                return name
        what = f"no segment {'begins' if which == 0 else 'ends'} at offset {offset}"
        self.reader.note(at, what, "name the segment instead")
        return ""


# ---- groups and frames --------------------------------------------------------------------------------------


SIDES: dict[str, Side] = {"client": "client", "server": "server", "both": "both", "none": "none"}
MARKS: dict[str, Mark] = {"first": "first", "last": "last", "none": "none"}
INHERITED = (
    "from", "head", "tail", "echo", "announces", "delimited", "surplus", "size", "fill", "max", "inside", "mark", "doc",
)  # fmt: skip
FRAME_KEYS = frozenset({*INHERITED, "group", "where", "body", "refuse"})
GROUP_KEYS = frozenset({*INHERITED, "where", "extends"})


@dataclass(frozen=True, slots=True)
class Outline:
    """Properties of a frame known before it is read: its place, its groups (nearest first), and whether it is
    refused.
    """

    name: str
    space: Namespace
    owned: Owned
    groups: tuple[str, ...]
    refused: bool
    inner: bool
    lacks_group: bool
    """Whether one of its groups is missing, which has been noted."""


class FrameLoader:
    """Reads the frames of a namespace, and the inner frames of used files."""

    def __init__(self, space: Namespace) -> None:
        self.space = space
        self.reader: Reader = space.reader
        self.outlines: dict[str, Outline] = {}
        self.groups: dict[str, tuple[Namespace, Owned]] = {}
        self.frames: dict[str, Frame] = {}
        self.partly: list[PartlyRead] = []
        self.missing = MissingSegments(self.reader)
        self.levels: dict[tuple[Position, int, int], str] = {}  # frames of layouts that contain themselves
        self._outline(space, inner_only=False)

    # ---- names first --------------------------------------------------------------------------------------

    def _outline(self, space: Namespace, *, inner_only: bool) -> None:
        for name, owned in space.section("groups").items():
            self.groups.setdefault(name, (space, owned))
        for name, owned in space.section("frames").items():
            if name in self.outlines:
                self.reader.note(owned.entry.key.at, f"there are two frames '{name}'", "give one another name")
                continue
            with self.reader.going_on():
                keys, before = self.reader.mapping(owned.entry.value), len(self.reader.problems)
                groups = tuple(self._chain(space, keys.get("group")))
                carried = bool(groups) and space.section("groups")[groups[0]].inner
                self.outlines[name] = Outline(
                    name,
                    space,
                    owned,
                    groups,
                    keys.get("refuse") is not None,
                    owned.inner or inner_only or carried,
                    len(self.reader.problems) > before,
                )

    def _chain(self, space: Namespace, node: Node | None, own: str = "") -> Iterator[str]:
        """Yield the group that a node names, and the groups that it extends; note a circle of groups of a frame.

        `own`: the group that extends the first of them.
        """
        groups, seen = space.section("groups"), {own}
        while node is not None:
            name = self.reader.text(node)
            if name not in groups:
                self.reader.note(node.at, f"there is no group '{name}'", did_you_mean(name, groups))
                return
            if name in seen and own:
                return
            if name in seen:
                self.reader.note(node.at, f"the group '{name}' extends itself", "break the circle")
                return
            seen.add(name)
            yield name
            value = groups[name].entry.value
            node = value.get("extends") if isinstance(value, Mapping) else None

    def members(self, name: str) -> tuple[str, ...]:
        """Return the frames of a group, refused frames last; a frame stands for itself."""
        if name in self.outlines:
            return (name,)
        frames = [outline for outline in self.outlines.values() if name in outline.groups]
        return tuple(outline.name for outline in sorted(frames, key=lambda outline: outline.refused))

    def knows(self, name: str) -> bool:
        return name in self.outlines or name in self.groups

    def find(self, space: Namespace, node: Node) -> tuple[str, ...]:
        """Return the frames that `GROUP`, `FRAME` or `FILE.GROUP` names. Raises Broken for an unknown name."""
        name = self.reader.text(node)
        if self.knows(name):
            return self.members(name)
        found = space.elsewhere(name)
        if found is not None:
            rest, other = found
            if other is not self.space and other is not space and not self.knows(rest):
                self._outline(other, inner_only=True)
            if self.knows(rest):
                return self.members(rest)
        known = [*self.outlines, *self.groups]
        if found is not None:
            known = [f"{name.partition('.')[0]}.{other}" for other in known]
        raise self.reader.broken(node.at, f"there is no frame or group '{name}'", did_you_mean(name, known))

    # ---- then the frames ----------------------------------------------------------------------------------

    def load_all(self) -> dict[str, Frame]:
        """Return all frames; reading a frame may add frames of a used file, which are read too."""
        tried: set[str] = set()
        while missing := [outline for name, outline in self.outlines.items() if name not in tried]:
            for outline in missing:
                tried.add(outline.name)
                with self.reader.going_on():
                    self.frames[outline.name] = self._frame(outline)
        self.missing.tell()
        return self.frames

    def nested(self, space: Meanings, node: Node, level: int, most: int) -> str:
        """Return the frame for a layout that contains itself, at a depth; beyond the greatest depth a frame that never
        matches.

        Raises Broken.
        """
        layout, at = self.reader.text(node), space.layout(node)[0].at
        key = at, min(level, most + 1), most
        if key in self.levels:
            return self.levels[key]
        name = f"{layout} {level}"
        while name in self.frames:
            name += "'"
        self.levels[key] = name
        body: Segments
        if level > most:
            text = f"{layout} stands in itself {most} times at most"
            never = Expression(text, Number(node.at, 0))
            body = (Require(at=node.at, name="_depth", condition=never), Skip(at=node.at, name="_deeper", size=1))
        else:
            loader = SegmentLoader(space, self, level)
            body = resolve_references(
                ((), loader.layout(node), ()), loader.aliases, f"layout '{layout}'", self.missing
            )[1]
            if loader.spoilt:
                raise Broken(layout)
            body = with_item_words(body, loader.known)
        self.frames[name] = Frame(
            name=name,
            at=node.at,
            groups=(),
            side="none",
            head=(),
            body=body,
            tail=(),
            inner=True,
            echo={},
            announces=(),
        )
        return name

    def load_groups(self) -> dict[str, Group]:
        result = {}
        for name, (space, owned) in self.groups.items():
            value = owned.entry.value
            keys: dict[str, Node] = {}
            with self.reader.going_on():
                extended = self._chain(space, value.get("extends"), name) if isinstance(value, Mapping) else ()
                keys = self._inherited(space, (name, *extended))
            result[name] = Group(
                name=name,
                frames=self.members(name),
                side=self._side(keys.get("from")),
                inner=owned.inner or space is not self.space,
                at=owned.entry.key.at,
            )
        return result

    def _side(self, node: Node | None) -> Side:
        return "both" if node is None else SIDES.get(self.reader.text(node), "both")

    def _inherited(self, space: Namespace, groups: tuple[str, ...]) -> dict[str, Node]:
        """Return the keys of the first group, combined with the keys of the groups it extends."""
        found: dict[str, Node] = {}
        for name in reversed(groups):
            value = space.section("groups")[name].entry.value
            found |= _inherited_keys(value) if isinstance(value, Mapping) else {}
        return found

    def _where(self, outline: Outline, keys: Mapping) -> dict[str, Where]:
        groups = outline.space.section("groups")
        nodes = [groups[name].entry.value for name in reversed(outline.groups)]
        result: dict[str, Where] = {}
        for node in [*nodes, keys]:
            if isinstance(node, Mapping) and (where := node.get("where")) is not None:
                result.update(load_where(self.reader, where))
        return result

    def _frame(self, outline: Outline) -> Frame:
        reader, space = self.reader, outline.space
        own = reader.mapping(outline.owned.entry.value)
        keys = self._inherited(space, outline.groups)
        keys |= _inherited_keys(own)
        loader = SegmentLoader(space, self)
        loader.side = self._side(keys.get("from"))
        parts = loader.load(keys.get("head")), loader.load(own.get("body")), loader.load(keys.get("tail"))
        attributes: dict[str, Any] | None = None
        wheres: dict[str, Where] | None = None
        with reader.going_on():
            attributes = self._attributes(space, keys, own)
        with reader.going_on():
            wheres = self._where(outline, own)
        is_sure = self._keys_known(outline, own) and not outline.lacks_group
        if loader.spoilt or not is_sure or attributes is None or wheres is None:
            self.partly.append(self._partly_read(outline, loader, parts, wheres or {}, is_sure=is_sure))
            raise Broken(outline.name)
        parts = apply_where(reader, parts, wheres, outline.owned.entry.key)
        whose = f"frame '{outline.name}'"
        parts = resolve_references(parts, loader.aliases, whose, self.missing)
        known = loader.known | field_names(part for segments in parts for part in segments)
        head, body, tail = in_order(*(with_item_words(part, known) for part in parts))
        return Frame(
            name=outline.name,
            at=outline.owned.entry.key.at,
            groups=outline.groups,
            head=head,
            body=body,
            tail=tail,
            inner=outline.inner,
            **attributes,
        )

    def _attributes(self, space: Namespace, keys: dict[str, Node], own: Mapping) -> dict[str, Any]:
        """Return what the keys of a frame give apart from its segments. Raises Broken."""
        reader, fill, mark = self.reader, keys.get("fill"), keys.get("mark")
        return {
            "side": self._side(keys.get("from")),
            "echo": self._echo(keys.get("echo")),
            "announces": tuple(self._announced(reader.entries(keys.get("announces")))),
            "delimited": reader.flag(keys.get("delimited")),
            "surplus": reader.maybe(reader.number, keys.get("surplus")),
            "size": reader.maybe(reader.bytes_at_most, keys.get("size")),
            "fill": 0 if fill is None else reader.byte(fill),
            "most": reader.maybe(reader.bytes_at_most, keys.get("max")),
            "inside": tuple(chain(*reader.each(reader.items(keys.get("inside")), lambda node: self.find(space, node)))),
            "refuse": reader.maybe(reader.number, own.get("refuse")),
            "mark": None if mark is None else MARKS.get(reader.text(mark)),
            "doc": reader.maybe(reader.text, keys.get("doc")) or "",
        }

    def _partly_read(
        self, outline: Outline, loader: SegmentLoader, parts: Parts, wheres: dict[str, Where], *, is_sure: bool
    ) -> PartlyRead:
        """Return the good segments of a frame with errors. Note references to missing segments, apart from names that
        its broken segments may have. `is_sure`: no other segments are missing.
        """
        lost, missing = loader.lost if is_sure else None, MissingSegments(Reader())
        if lost is not None:
            own = {name: where for name, where in wheres.items() if name not in lost}
            parts = apply_where(self.reader, parts, own, outline.owned.entry.key)
        segments = tuple(chain(*resolve_references(parts, loader.aliases, f"frame '{outline.name}'", missing)))
        if lost is not None:
            self.missing.take_over(missing, lost)
        segments = with_item_words(segments, loader.known | field_names(segments))
        return PartlyRead(name=outline.name, segments=segments, lost=lost, holders=frozenset(loader.holders))

    def _keys_known(self, outline: Outline, own: Mapping) -> bool:
        """Return whether all keys of a frame and its groups are known; otherwise a missing key may be misspelt."""
        groups = outline.space.section("groups")
        values = [groups[name].entry.value for name in outline.groups]
        return all(entry.key.text in FRAME_KEYS for entry in own.entries) and all(
            entry.key.text in GROUP_KEYS for value in values if isinstance(value, Mapping) for entry in value.entries
        )

    def _announced(self, entries: Iterable[Entry]) -> Iterator[Announced]:
        """Yield announcements `variable: EXPR` or `table[EXPR]: EXPR`; broken entries are noted and left out."""
        for entry in entries:
            with self.reader.going_on():
                name, key, field = self.reader.target(entry.key)
                if field is not None:
                    what = f"'{entry.key.text}' is a field, and a frame announces variables and entries of tables"
                    raise self.reader.broken(entry.key.at, what, "set it in the row that takes the frame")
                yield Announced(name, self.reader.expression(entry.value), key)

    def _echo(self, node: Node | None) -> dict[str, Expression]:
        if isinstance(node, Mapping):
            return self.reader.by_name(node.read_all(), self.reader.expression)
        return {self.reader.text(item): self.reader.expression(item) for item in self.reader.items(node)}


def _inherited_keys(keys: Mapping) -> dict[str, Node]:
    return {name: node for name in INHERITED if (node := keys.get(name)) is not None}
