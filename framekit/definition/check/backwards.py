"""Service rows read backwards: whether a server can tell from a request what it asks for. Reference, section 11.

A leaf of a request can be read backwards when it is a constant, one name, or one name with constants and columns of the
area added, subtracted or multiplied. For the rest a row has `back`.
"""

from __future__ import annotations

from collections.abc import Iterator

from framekit.definition.check.addresses import parts_in
from framekit.definition.check.known_names import OFFERED
from framekit.definition.expression.syntax import Binary, Expression, Name, Node, names_in
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, RecordOf, Value
from framekit.definition.problems import Problem

NOT_COMPARED = frozenset({"station", "own"})
COLUMNS = frozenset({"area"})
"""Names that are known before anything is read: the area's columns are constants."""


def check_backwards(protocol: Protocol, row: ServiceRow) -> Iterator[Problem]:
    """What keeps a server from understanding the requests of this row."""
    if row.service not in ("read", "write") or row.serve is not None:
        return  # their work says itself where it takes its places from
    if row.client_only or row.request is None or not serves(protocol):
        return
    read = set(row.back)
    unreadable: list[Expression] = []
    for leaf in _leaves([row.request, *([row.buffer] if row.buffer is not None else [])]):
        name = single_name(leaf)
        if name is not None:
            read.add(name)
        elif names_in(leaf.root) - NOT_COMPARED:
            unreadable.append(leaf)
    if unreadable and not row.back:
        leaf = unreadable[0]
        what = f"'{leaf}' of a request cannot be read backwards by a server"
        yield Problem(leaf.at, what, "add back: {…} with what it means, or client_only: yes")
        return
    if not read <= _known_names(protocol, row):
        return  # what is misspelt is told elsewhere
    for missing in _missing(row, read):
        what = f"a server cannot tell the {missing} that this {row.service} asks for"
        yield Problem(row.at, what, f"put it into the request, or add back: {{{missing}: …}}, or client_only: yes")


def _known_names(protocol: Protocol, row: ServiceRow) -> set[str]:
    """Names that the leaves of a request may have."""
    known = {*OFFERED, *NOT_COMPARED, "memory", *row.back, *(argument.name for argument in row.takes)}
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
