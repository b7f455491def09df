"""Groups and frames: inheritance, `where` written into the fields, and names that segments mention resolved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from framekit.definition.expression.syntax import Expression
from framekit.definition.load.namespace import Namespace, Owned
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.load.references import Where, apply_where, load_where, resolve_references
from framekit.definition.load.segments import SegmentLoader, in_order
from framekit.definition.model.frames import Frame, Group, Side
from framekit.definition.nodes import Mapping, Node
from framekit.definition.problems import did_you_mean

SIDES: dict[str, Side] = {"client": "client", "server": "server", "both": "both", "none": "none"}
INHERITED = ("from", "head", "tail", "echo", "announces", "delimited", "surplus", "size", "fill", "max", "doc")
FRAME_KEYS = frozenset({*INHERITED, "group", "where", "body", "refuse"})
GROUP_KEYS = frozenset({*INHERITED, "where", "extends"})


@dataclass(frozen=True, slots=True)
class Outline:
    """What is known of a frame before it is read: its place, its groups (nearest first), and whether it is refused."""

    name: str
    space: Namespace
    owned: Owned
    groups: tuple[str, ...]
    refused: bool
    inner: bool


class FrameLoader:
    """Reads the frames of a namespace, and those of used files that an `inner` asks for."""

    def __init__(self, space: Namespace) -> None:
        self.space = space
        self.reader: Reader = space.reader
        self.outlines: dict[str, Outline] = {}
        self.groups: dict[str, tuple[Namespace, Owned]] = {}
        self.frames: dict[str, Frame] = {}
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
                keys = self.reader.mapping(owned.entry.value)
                groups = tuple(self._chain(space, keys))
                carried = bool(groups) and space.section("groups")[groups[0]].inner
                self.outlines[name] = Outline(
                    name,
                    space,
                    owned,
                    groups,
                    keys.get("refuse") is not None,
                    owned.inner or inner_only or carried,
                )

    def _chain(self, space: Namespace, keys: Mapping) -> Iterator[str]:
        """The group of a frame and the groups that one extends."""
        node, groups, seen = keys.get("group"), space.section("groups"), set()
        while node is not None:
            name = self.reader.text(node)
            if name not in groups:
                self.reader.note(node.at, f"there is no group '{name}'", did_you_mean(name, groups))
                return
            if name in seen:
                raise self.reader.broken(node.at, f"the group '{name}' extends itself", "break the circle")
            seen.add(name)
            yield name
            value = groups[name].entry.value
            node = value.get("extends") if isinstance(value, Mapping) else None

    def members(self, name: str) -> tuple[str, ...]:
        """The frames of a group, those that exist to be refused last; a frame stands for itself."""
        if name in self.outlines:
            return (name,)
        frames = [outline for outline in self.outlines.values() if name in outline.groups]
        return tuple(outline.name for outline in sorted(frames, key=lambda outline: outline.refused))

    def knows(self, name: str) -> bool:
        return name in self.outlines or name in self.groups

    def find(self, space: Namespace, node: Node) -> tuple[str, ...]:
        """The frames that `GROUP`, `FRAME` or `FILE.GROUP` means. Raises Broken when there is no such name."""
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
        """All frames; reading one may bring in those of a used file, which are read too."""
        tried: set[str] = set()
        while missing := [outline for name, outline in self.outlines.items() if name not in tried]:
            for outline in missing:
                tried.add(outline.name)
                with self.reader.going_on():
                    self.frames[outline.name] = self._frame(outline)
        return self.frames

    def load_groups(self) -> dict[str, Group]:
        result = {}
        for name, (space, owned) in self.groups.items():
            keys = self._inherited(space, name)
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

    def _inherited(self, space: Namespace, group: str) -> dict[str, Node]:
        """The keys of a group over those of the groups it extends."""
        found: dict[str, Node] = {}
        node = Mapping((), space.source.at)
        for name in reversed([group, *self._parents(space, group)]):
            value = space.section("groups")[name].entry.value
            keys = value if isinstance(value, Mapping) else node
            found |= _inherited_keys(keys)
        return found

    def _parents(self, space: Namespace, group: str) -> list[str]:
        value = space.section("groups")[group].entry.value
        if not isinstance(value, Mapping):
            return []
        parent = value.get("extends")
        names: list[str] = []
        groups = space.section("groups")
        while parent is not None and (name := self.reader.text(parent)) in groups and name not in [group, *names]:
            names.append(name)
            value = groups[name].entry.value
            parent = value.get("extends") if isinstance(value, Mapping) else None
        return names

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
        keys = self._inherited(space, outline.groups[0]) if outline.groups else {}
        keys |= _inherited_keys(own)
        if not self._keys_known(outline, own):
            raise Broken(outline.name)
        loader = SegmentLoader(space, self.find)
        loader.side = self._side(keys.get("from"))
        head, body, tail = loader.load(keys.get("head")), loader.load(own.get("body")), loader.load(keys.get("tail"))
        if loader.spoilt:
            raise Broken(outline.name)
        parts = apply_where(reader, (head, body, tail), self._where(outline, own), outline.owned.entry.key)
        head, body, tail = in_order(*resolve_references(reader, parts, loader.aliases))
        fill = keys.get("fill")
        return Frame(
            name=outline.name,
            at=outline.owned.entry.key.at,
            groups=outline.groups,
            side=self._side(keys.get("from")),
            head=head,
            body=body,
            tail=tail,
            inner=outline.inner,
            echo=self._echo(keys.get("echo")),
            announces={
                entry.key.text: reader.expression(entry.value) for entry in reader.entries(keys.get("announces"))
            },
            delimited=reader.flag(keys.get("delimited")),
            surplus=reader.maybe(reader.number, keys.get("surplus")),
            size=reader.maybe(reader.bytes_at_most, keys.get("size")),
            fill=0 if fill is None else reader.byte(fill),
            most=reader.maybe(reader.bytes_at_most, keys.get("max")),
            refuse=reader.maybe(reader.number, own.get("refuse")),
            fixed_by_where=frozenset(self._where(outline, own)),
            doc=reader.maybe(reader.text, keys.get("doc")) or "",
        )

    def _keys_known(self, outline: Outline, own: Mapping) -> bool:
        """Whether all keys of a frame and its groups are known; else what is missing may stand under another one."""
        groups = outline.space.section("groups")
        values = [groups[name].entry.value for name in outline.groups]
        return all(entry.key.text in FRAME_KEYS for entry in own.entries) and all(
            entry.key.text in GROUP_KEYS for value in values if isinstance(value, Mapping) for entry in value.entries
        )

    def _echo(self, node: Node | None) -> dict[str, Expression]:
        if isinstance(node, Mapping):
            return {entry.key.text: self.reader.expression(entry.value) for entry in node.read_all()}
        return {self.reader.text(item): self.reader.expression(item) for item in self.reader.items(node)}


def _inherited_keys(keys: Mapping) -> dict[str, Node]:
    return {name: node for name in INHERITED if (node := keys.get(name)) is not None}
