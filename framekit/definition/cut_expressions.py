"""Finds expressions that YAML has cut at a comma: `{set: max(a, b)}` is two keys, and the second has no value.

Only braces and brackets cut, and only what is not quoted. Which keys a mapping may have is not known here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from framekit.definition.problems import Position, Problem
from framekit.definition.tree import Entry, Mapping, Node, Scalar, Sequence
from framekit.definition.yaml_syntax import QUOTE_EXPRESSION

CUT = "the expression was cut at a comma"

_QUOTED = re.compile(r"'[^']*'")
_NAME = re.compile(r"[A-Za-z_]\w*")
_NO_SPACE = re.compile(r"[a-z_]+:[^:\s'\"()]+")
_PROSE = re.compile(r"doc|about|source|second_source|\d+|0[xX][0-9A-Fa-f]+")
_EXPRESSION = re.compile(r"[()\[\]{}'\"+*/%&|^~<>=]|\s(?:if|else|and|or|not|in|-)\s")


@dataclass(slots=True)
class Cuts:
    """What was found: the tree without the cut-off pieces, and the mappings and lists that had some."""

    tree: Node
    problems: list[Problem] = field(default_factory=list)
    places: set[Position] = field(default_factory=set)


def without_cuts(node: Node) -> Cuts:
    """The tree without the pieces of cut expressions; one problem for each mapping or list that has some."""
    cuts = Cuts(node)
    cuts.tree = _mended(node, cuts)
    return cuts


def is_cut(problem: Problem) -> bool:
    """Whether a problem is one of those that are noted here."""
    return problem.what.endswith(" was cut at a comma")


def looks_cut(text: str) -> bool:
    """Whether a key is a piece of an expression rather than a word."""
    return _EXPRESSION.search(text) is not None


def _mended(node: Node, cuts: Cuts) -> Node:
    if isinstance(node, Mapping):
        return _mapping(node, cuts)
    return _sequence(node, cuts) if isinstance(node, Sequence) else node


def _mapping(node: Mapping, cuts: Cuts) -> Mapping:
    kept: list[Entry] = []
    depth = 0
    for entry in node.entries:
        absent = isinstance(entry.value, Scalar) and entry.value.absent
        if node.flow and (absent or depth):
            _note(node, entry.key, kept[-1] if kept else None, depth, cuts)
        elif absent:
            cuts.problems.append(_no_value(entry.key))
        else:
            value = _mended(entry.value, cuts)
            kept.append(entry if value is entry.value else Entry(entry.key, value))
        depth = max(0, depth + _opened(entry.key) + _opened(entry.value)) if node.flow else 0
    if len(kept) == len(node.entries) and all(new is old for new, old in zip(kept, node.entries, strict=True)):
        return node
    return Mapping(tuple(kept), node.at, node.flow)


def _sequence(node: Sequence, cuts: Cuts) -> Sequence:
    kept: list[Node] = []
    depth = 0
    for item in node.items:
        if node.flow and depth and isinstance(item, Scalar):
            _note(node, item, None, depth, cuts)
        else:
            kept.append(_mended(item, cuts))
        depth = max(0, depth + _opened(item)) if node.flow else 0
    if len(kept) == len(node.items) and all(new is old for new, old in zip(kept, node.items, strict=True)):
        return node
    return Sequence(tuple(kept), node.at, node.flow)


def _opened(node: Node) -> int:
    """How many parentheses stay open behind an unquoted text; those inside its own quotes do not count."""
    if not isinstance(node, Scalar) or node.quoted:
        return 0
    text = _QUOTED.sub("", node.text)
    return text.count("(") - text.count(")")


def _note(node: Mapping | Sequence, piece: Scalar, before: Entry | None, depth: int, cuts: Cuts) -> None:
    """Notes the first cut of a mapping or list."""
    if node.at in cuts.places:
        return
    cuts.places.add(node.at)
    if isinstance(node, Mapping) and (before is None or _NO_SPACE.fullmatch(piece.text)):
        cuts.problems.append(_no_value(piece))
    elif before is not None and _PROSE.fullmatch(before.key.text):
        cuts.problems.append(Problem(piece.at, "the text was cut at a comma", "quote the whole text"))
    elif before is not None and piece.text.isdigit() and _is_number(before.value):
        cuts.problems.append(Problem(piece.at, "the number was cut at a comma", "write it without"))
    elif depth == 0 and _NAME.fullmatch(piece.text):
        cuts.problems.append(Problem(piece.at, CUT, f"{QUOTE_EXPRESSION}, or give '{piece.text}' a value"))
    else:
        cuts.problems.append(Problem(piece.at, CUT, QUOTE_EXPRESSION))


def _is_number(node: Node) -> bool:
    return isinstance(node, Scalar) and node.text.isdigit()


def _no_value(key: Scalar) -> Problem:
    name, colon, value = key.text.partition(":")
    todo = f"write {name}: {value.strip()} with a space" if colon and value else f"write {key.text}: value"
    return Problem(key.at, f"the key '{key.text}' has no value", todo)
