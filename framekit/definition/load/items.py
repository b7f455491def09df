"""`index`, `last` and `previous` in the items of lists: they get names that nothing else has.

A field, variable, parameter, table or queue of that name goes before the word. So both compilers and the checker see
only names that mean one thing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from framekit.definition.expression import Expression, Name, Node, names_in
from framekit.definition.model.frames import change_all, field_names, names_read_in
from framekit.definition.model.segments import ITEM_WORDS, LAST, ItemEnd, Repeat, Segment, Segments


def with_item_words(segments: Segments, known: Collection[str], in_item: bool = False) -> Segments:
    """The segments with the words of items resolved; `known`: what else is known here. `in_item`: they are an item."""
    names = {*known, *field_names(segments)}
    meant = {word: name for word, name in ITEM_WORDS.items() if word not in names} if in_item else {}

    def change(segment: Segment) -> Segment:
        if meant:
            segment = _renamed(segment, meant)
        return segment.with_record(lambda of: _inside(segment, of, names, in_item))

    return change_all(segments, change)


def _inside(holder: Segment, of: Segments, names: Collection[str], in_item: bool) -> Segments:
    """The segments of a record or of an item; where only an item's end shows if it is the last, it says so."""
    found = with_item_words(of, names, in_item or holder.is_list)
    if isinstance(holder, Repeat) and holder.times == "rest" and LAST in names_read_in(found):
        found = (*found, ItemEnd(at=holder.at))
    return found


def _renamed(segment: Segment, meant: Mapping[str, str]) -> Segment:
    """A segment with names in its own expressions replaced; what it holds is left as it is."""

    def name(node: Any) -> Any:
        if isinstance(node, Name) and node.name in meant:
            return replace(node, name=meant[node.name])
        return _with_parts(node, name) if isinstance(node, (Node, tuple)) else node

    def expression(part: Any) -> Any:
        if isinstance(part, Expression):
            return replace(part, root=name(part.root)) if names_in(part.root) & meant.keys() else part
        return part if isinstance(part, Segment) else _with_parts(part, expression)

    changed: Segment = _with_parts(segment, expression)
    return changed


def _with_parts(whole: Any, change: Callable[[Any], Any]) -> Any:
    """A dataclass, tuple or mapping with its parts changed; itself if none is."""
    if isinstance(whole, tuple):
        items = tuple(change(item) for item in whole)
        return items if any(new is not old for new, old in zip(items, whole, strict=True)) else whole
    if isinstance(whole, dict):
        return {key: change(value) for key, value in whole.items()}
    if not is_dataclass(whole) or isinstance(whole, type):
        return whole
    changes = {one.name: change(getattr(whole, one.name)) for one in fields(whole)}
    changes = {key: value for key, value in changes.items() if value is not getattr(whole, key)}
    return replace(whole, **changes) if changes else whole
