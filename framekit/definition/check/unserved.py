"""Service rows that a server never comes to, because a row above takes every request that they could get.

A server looks for the row of a request by its frame, by the constants and names that stand in it, by the area that it
names, and by `when`; units, limits and counts choose nothing there. Where one row certainly fits whenever a later one
does, and would answer something else, the later one is told. Language reference, sections 11 and 12.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from framekit.definition.check.backwards import COLUMNS, NOT_COMPARED, serves, single_name
from framekit.definition.expression.syntax import Binary, Expression, Name, Node, names_in
from framekit.definition.fingerprint import fingerprint
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, RecordOf, Value
from framekit.definition.model.walk import expressions_of, names_always_there
from framekit.definition.problems import Problem

TODO = "tell them apart by a constant in the request or by when:, or add client_only: yes"


def check_unserved(protocol: Protocol) -> Iterator[Problem]:
    """Rows whose requests a server reads by a row above them."""
    if not serves(protocol):
        return
    above: dict[str, list[ServiceRow]] = {}
    for row in (row for rows in protocol.services.values() for row in rows):
        if row.request is None or row.client_only or row.request.frame not in protocol.frames:
            continue
        earlier = above.setdefault(row.request.frame, [])
        for one in earlier:
            alike = _Alike(protocol)
            if _takes_all(alike, one, row):  # the first that does answers
                if not alike.same or _told(one) != _told(row):
                    what = f"a server never comes to this row of {row.service}: it reads every '{row.request.frame}' "
                    where = "" if one.at.file == row.at.file else f" of {Path(one.at.file).name}"
                    what += f"that fits here by the row of {one.service} in line {one.at.line}{where}"
                    yield Problem(row.at, what, TODO)
                break
        earlier.append(row)


def _takes_all(alike: _Alike, earlier: ServiceRow, later: ServiceRow) -> bool:
    """Whether the earlier row fits every request that the later one fits."""
    assert earlier.request is not None and later.request is not None
    if earlier.buffer is None and later.buffer is not None:
        return False
    sent = alike.covers(earlier.request, later.request)
    sent = sent and (earlier.buffer is None or alike.covers(earlier.buffer, later.buffer))
    if not sent or len(set(alike.names)) < len(alike.names) or {"text", "start"} <= set(alike.names):
        return False
    by_columns = any(names_in(leaf.root) & COLUMNS for leaf in expressions_of([earlier.request, earlier.buffer]))
    if by_columns and set(earlier.areas) != set(later.areas):
        return False
    whens = _when(earlier), _when(later)
    if whens[0] is not None and (fingerprint(whens[0]) != fingerprint(whens[1]) or not alike.same):
        return False
    return _back_fits(earlier, later) and _areas_fit(earlier, later)


def _when(row: ServiceRow) -> Expression | None:
    return row.back.get("when", row.when)


def _back_fits(earlier: ServiceRow, later: ServiceRow) -> bool:
    """Whether `back` of the earlier row can be worked out whenever that of the later one can."""
    read = [(later.back.get(name), value) for name, value in earlier.back.items() if name != "when"]
    read += [(later.back_each.get(name), value) for name, value in earlier.back_each.items()]
    return all(
        not names_in(value.root) or isinstance(value.root, Name) or fingerprint(value) == fingerprint(other)
        for other, value in read
    )


def _areas_fit(earlier: ServiceRow, later: ServiceRow) -> bool:
    """Whether the earlier row is for every area that a request of the later one can name."""
    source = _area_source(earlier)
    if source == "code" and _area_source(later) != "code":
        return False
    if source not in ("text", "code") or not earlier.areas:
        return True
    return _area_source(later) == source and bool(later.areas) and set(later.areas) <= set(earlier.areas)


def _area_source(row: ServiceRow) -> str:
    """What a server takes the area from: `text`, `code`, `area` of back, or '' for the row itself."""
    back = {*row.back, *row.back_each}
    if "text" in back:
        return "text"
    leaves = {leaf.root.name for leaf in expressions_of([row.request, row.buffer]) if isinstance(leaf.root, Name)}
    named = leaves - {argument.name for argument in row.takes}
    if "text" in named:
        return "text"
    if "area" in back:
        return "area"
    return "code" if "code" in named else ""


def _told(row: ServiceRow) -> str:
    """What a server takes from a row whose request has been read."""
    places = () if _area_source(row) else (row.areas, row.units)
    transfer = row.service if row.service in ("read", "write") else ""
    back = {name: value for name, value in row.back.items() if name != "when"}
    return fingerprint((transfer, places, back, row.back_each, row.reply, row.refuse, row.serve, row.packing))


@dataclass
class _Alike:
    """Compares what two rows send; `names` are those the first one reads, `same`: neither reads another one there."""

    protocol: Protocol
    names: list[str] = field(default_factory=list)
    same: bool = True

    def covers(self, one: Value, other: Value | None) -> bool:
        """Whether everything that the other value can be fits the first one."""
        if isinstance(one, Expression):
            return self._leaf(one, other if isinstance(other, Expression) else None)
        if isinstance(one, FrameOf):
            there = isinstance(other, FrameOf) and other.frame == one.frame
            frame = self.protocol.frames.get(one.frame)
            known = set() if frame is None else names_always_there(frame.segments)
            return there and self._fields(one.fields, getattr(other, "fields", {}), known)
        if isinstance(one, LayoutOf):
            there = isinstance(other, LayoutOf) and other.layout == one.layout
            return there and self._fields(one.fields, getattr(other, "fields", {}), ())
        if isinstance(one, ListOf):
            if not isinstance(other, ListOf) or len(other.items) != len(one.items):
                return False
            return all(self.covers(item, counter) for item, counter in zip(one.items, other.items, strict=True))
        if isinstance(one, (RecordOf, EachOf)):
            return type(other) is type(one) and self._fields(one.fields, other.fields, ())
        return False

    def _fields(self, one: Mapping[str, Value], other: Mapping[str, Value], known: Collection[str]) -> bool:
        return all(
            (name in other or name in known or _passed_over(value)) and self.covers(value, other.get(name))
            for name, value in one.items()
        )

    def _leaf(self, one: Expression, other: Expression | None) -> bool:
        equal = fingerprint(one) == fingerprint(other)
        if not names_in(one.root):
            return equal
        if _passed_over(one):
            return True
        name = single_name(one)
        assert name is not None
        self.names.append(name)
        if not equal and other is not None and names_in(other.root):
            self.same = False
        return equal or _always_solved(one.root)


def _passed_over(value: Value) -> bool:
    """Whether a server neither reads nor compares a leaf."""
    if not isinstance(value, Expression) or not names_in(value.root):
        return False
    name = single_name(value)
    return name is None or name in NOT_COMPARED


def _always_solved(node: Node) -> bool:
    """Whether every result has a value of the name: it does for sums, a product may leave a rest."""
    while isinstance(node, Binary):
        if node.operator == "*":
            return False
        node = node.left if names_in(node.left) - COLUMNS else node.right
    return True
