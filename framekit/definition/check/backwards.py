"""Service rows read backwards: whether a server can tell from a request what it asks for. Reference, section 11.

A leaf of a request can be read backwards when it is a constant, one name, or one name with constants and columns of the
area added, subtracted or multiplied. For the rest a row has `back`, and `back: {each: …}` for the items of a list.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from framekit.definition.check.addresses import parts_in
from framekit.definition.check.known_names import OFFERED
from framekit.definition.expression.syntax import Attribute, Binary, Call, Expression, Name, Node, children, names_in
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Repeat
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, RecordOf, Value
from framekit.definition.model.walk import field_names, parts_of
from framekit.definition.problems import Problem

NOT_COMPARED = frozenset({"station", "own"})
COLUMNS = frozenset({"area"})
"""Names that are known before anything is read: the area's columns are constants."""


def check_backwards(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """What keeps a server from understanding the requests of this row."""
    yield from _items(row)
    if row.service not in ("read", "write") or row.serve is not None:
        return  # their work says itself where it takes its places from
    if row.client_only or row.request is None or not serves(protocol):
        return
    read = {*row.back, *row.back_each}
    unreadable: list[Expression] = []
    for leaf in _leaves([row.request, *([row.buffer] if row.buffer is not None else [])]):
        name = single_name(leaf)
        if name is not None:
            read.add(name)
        elif names_in(leaf.root) - NOT_COMPARED:
            unreadable.append(leaf)
    if unreadable and not row.back and not row.back_each:
        leaf = unreadable[0]
        what = f"'{leaf}' of a request cannot be read backwards by a server"
        back = "back: {each: {…}}" if _lists(row) else "back: {…}"
        yield Problem(leaf.at, what, f"add {back} with what it means, or client_only: yes")
        return
    if not read <= _known_names(protocol, row):
        return  # what is misspelt is told elsewhere
    for missing in _missing(row, read):
        what = f"a server cannot tell the {missing} that this {row.service} asks for"
        yield Problem(row.at, what, f"put it into the request, or add back: {{{missing}: …}}, or client_only: yes")


def _items(row: ServiceRow) -> Iterator[Problem]:
    """What is said of items is said of each: not of the list as a whole, and not where there is no list."""
    lists = _lists(row)
    if row.back_each and not lists:
        first = next(iter(row.back_each.values()))
        what = "the request of this row has no list {each: …}, so there are no items to read"
        yield Problem(first.at, what, "write the keys of each: in back: itself")
    for name, expression in row.back.items():
        node = None if name == "when" else next(_reads_of(expression.root, lists), None)
        if node is not None:
            what = f"'{name}' is the same for all items of '{node.name}' here"
            yield Problem(node.at, what, f"write back: {{each: {{{name}: …}}}}, where the fields of the item are names")


def _reads_of(node: Node, lists: Mapping[str, EachOf]) -> Iterator[Attribute]:
    """Where an expression looks into one of these lists of the request, and does not only count its items."""
    if isinstance(node, Attribute) and node.name in lists and "request" in names_in(node):
        yield node
    elif not (isinstance(node, Call) and node.function == "len"):
        for child in children(node):
            yield from _reads_of(child, lists)


def _lists(row: ServiceRow) -> dict[str, EachOf]:
    """The lists of the request that have an item for each variable, by name."""
    sent = [row.request, row.buffer]
    holders: list[FrameOf | LayoutOf | RecordOf] = [*parts_of(sent, FrameOf), *parts_of(sent, LayoutOf)]
    holders += parts_of(sent, RecordOf)
    return {name: value for made in holders for name, value in made.fields.items() if isinstance(value, EachOf)}


def item_names(protocol: Protocol, row: ServiceRow) -> set[str]:
    """The fields that items of the request's lists have."""
    sent, lists, found = [row.request, row.buffer], _lists(row), set[str]()
    frames = [protocol.frames.get(made.frame) for made in parts_of(sent, FrameOf)]
    layouts = [protocol.layouts.get(made.layout) for made in parts_of(sent, LayoutOf)]
    for repeat in parts_of([holder.segments for holder in (*frames, *layouts) if holder is not None], Repeat):
        if repeat.name in lists and isinstance(repeat.of, tuple):
            found |= field_names(repeat.of)
    return found


def _known_names(protocol: Protocol, row: ServiceRow) -> set[str]:
    """Names that the leaves of a request may have."""
    known = {*OFFERED, *NOT_COMPARED, "memory", *row.back, *row.back_each, *(argument.name for argument in row.takes)}
    known |= protocol.params.keys() | protocol.state.keys() | protocol.tables.keys()
    for form in protocol.addresses:
        known |= form.results.keys() | {part.name for part in parts_in(form)}
    return known


def _missing(row: ServiceRow, read: set[str]) -> Iterator[str]:
    """What of area and start no part of the request says."""
    if "text" in read:
        return
    if not read & {"area", "memory", "code"} and len(row.areas) != 1:
        yield "area"
    if "start" not in read:
        yield "start"


def serves(protocol: Protocol) -> bool:
    """Whether a device may be made of this definition; of an application, whoever carries it decides."""
    if protocol.kind == "application":
        return True
    return any(step.serve is not None for sequence in protocol.sequences.values() for step in sequence.steps)


def _leaves(values: list[Value]) -> Iterator[Expression]:
    for value in values:
        match value:
            case Expression():
                yield value
            case FrameOf(fields=fields) | LayoutOf(fields=fields) | RecordOf(fields=fields) | EachOf(fields=fields):
                yield from _leaves(list(fields.values()))
            case ListOf(items=items):
                yield from _leaves(list(items))


def single_name(expression: Expression) -> str | None:
    """The one name whose value follows from the result; None when there is none or it does not follow."""
    node: Node = expression.root
    while not isinstance(node, Name):
        if not isinstance(node, Binary) or node.operator not in ("+", "-", "*"):
            return None
        left, right = names_in(node.left) - COLUMNS, names_in(node.right) - COLUMNS
        if bool(left) == bool(right):
            return None
        node = node.left if left else node.right
    return None if node.name in COLUMNS else node.name
