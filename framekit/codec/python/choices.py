"""Choose between candidate frames by bytes that distinguish them, before any of them is read.

A frame is excluded only if a byte at a fixed offset contradicts its constants, and if no fault before that offset could
cause a refusal instead.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

from framekit.codec.python.source import quoted
from framekit.definition.model.frames import StaticSizes, parts_of
from framekit.definition.model.segments import Bits, Const, Field, FieldType, Inner, Segment
from framekit.definition.wire_types import DIGITS

Allowed = Mapping[int, frozenset[int]]
"""The possible values of a byte of a frame, by its offset."""
_FEW = 128
"""A byte with more allowed values than this does not distinguish a frame; a single fixed bit leaves 128."""


@dataclass(frozen=True, slots=True)
class Leaf:
    """Candidates that no byte distinguishes."""

    frames: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Switch:
    """Candidates that the byte at offset `at` distinguishes."""

    frames: tuple[str, ...]
    at: int
    cases: tuple[tuple[int, Leaf | Switch], ...]
    others: Leaf | Switch


_TREES: WeakKeyDictionary[StaticSizes, dict[tuple[str, ...], Leaf | Switch]] = WeakKeyDictionary()
"""Cached trees, by protocol and candidates, because large trees are slow to compute."""


def in_order(static: StaticSizes, frames: tuple[str, ...]) -> tuple[str, ...]:
    """Return candidates in the order of trial: frames with `refuse` come last."""
    return tuple(sorted(frames, key=lambda name: static.frames[name].refuse is not None))


def tree_of(static: StaticSizes, frames: tuple[str, ...]) -> Leaf | Switch:
    """Return the decision tree of candidates in this order."""
    known = _TREES.setdefault(static, {})
    if frames not in known:
        allowed = {name: dict(fixed_bytes(static.segments(static.frames[name]))) for name in frames}
        known[frames] = _tree(frames, allowed, frozenset(), True)
    return known[frames]


def _tree(frames: tuple[str, ...], allowed: Mapping[str, Allowed], used: frozenset[int], again: bool) -> Leaf | Switch:
    """Return the decision tree of candidates.

    `again`: one more byte may be used that only separates restricted frames from unrestricted ones.
    """
    places = {place for name in frames for place in allowed[name]} - used
    if not again:
        places = {place for place in places if _left(frames, allowed, place) < len(frames)}
    others_at = {place: tuple(name for name in frames if place not in allowed[name]) for place in places}
    best = min(places, key=lambda place: (_left(frames, allowed, place), not others_at[place], place), default=None)
    if best is None:
        return Leaf(frames)
    left, others = _left(frames, allowed, best), others_at[best]
    if left >= len(frames) and not others:
        return Leaf(frames)
    used, again = used | {best}, again and left < len(frames)
    cases = tuple(
        (value, _tree(group, allowed, used, again)) for value, group in sorted(_groups(frames, allowed, best).items())
    )
    return Switch(frames, best, cases, _tree(others, allowed, used, again) if others else Leaf(()))


def _left(frames: tuple[str, ...], allowed: Mapping[str, Allowed], place: int) -> float:
    """Return the average number of remaining candidates if the byte at `place` has one of the required values."""
    groups = _groups(frames, allowed, place)
    return sum(len(group) for group in groups.values()) / len(groups) if groups else len(frames)


def _groups(frames: tuple[str, ...], allowed: Mapping[str, Allowed], place: int) -> dict[int, tuple[str, ...]]:
    values = {value for name in frames for value in allowed[name].get(place, ())}
    return {
        value: tuple(name for name in frames if place not in allowed[name] or value in allowed[name][place])
        for value in values
    }


_DIGITS = {10: frozenset(b"0123456789"), 16: DIGITS}


def fixed_bytes(segments: tuple[Segment, ...], digits: bool = False) -> Iterator[tuple[int, frozenset[int]]]:
    """Yield offset and possible values of the restricted bytes of a frame, up to the first segment that may be refused.

    `digits`: include bytes that may be any digit.
    """
    place = 0
    static = StaticSizes({})
    for segment in _flat(segments):
        if segment.refuse is not None or segment.when is not None:
            return
        if isinstance(segment, Const):
            yield from ((place + offset, frozenset({byte})) for offset, byte in enumerate(segment.data))
        elif isinstance(segment, Field) and segment.long is None:
            numbers, type_ = segment.wire_values, segment.type
            if digits and numbers is None and type_.kind == "digits" and type_.base in _DIGITS:
                yield from ((place + offset, _DIGITS[type_.base]) for offset in range(type_.fixed_size or 0))
            yield from _numbers_at(place, type_, numbers)
        elif isinstance(segment, Bits):
            found = enumerate(segment.wire_bytes)
            yield from ((place + offset, values) for offset, values in found if len(values) <= _FEW)
        size = None if any(parts_of(segment, Inner)) else static.present(segment).fixed
        if size is None:
            return
        place += size


def _flat(segments: tuple[Segment, ...]) -> Iterator[Segment]:
    for segment in segments:
        if segment.is_record and segment.when is None and segment.refuse is None:
            yield from _flat(segment.members)
        else:
            yield segment


def _numbers_at(
    place: int, type_: FieldType, numbers: Sequence[int | str | bytes] | None
) -> Iterator[tuple[int, frozenset[int]]]:
    if numbers is None or type_.fixed_size is None or len(numbers) > 1 << 16:
        return
    forms = [type_.plain_bytes(number) for number in numbers]
    if any(form is None for form in forms):
        return
    for offset in range(type_.fixed_size):
        values = frozenset(form[offset] for form in forms if form is not None)
        if len(values) <= _FEW:
            yield place + offset, values


def choice_text(tree: Leaf | Switch) -> str:
    """Return the source of a `Choice` for the tree."""
    everything = _frames_text(tree.frames)
    if isinstance(tree, Leaf):
        return f"Choice({everything})"
    cases = ", ".join(f"{value:#04x}: {_branch_text(branch)}" for value, branch in tree.cases)
    return f"Choice({everything}, {tree.at}, {{{cases}}}, {_branch_text(tree.others)})"


def _branch_text(tree: Leaf | Switch) -> str:
    return _frames_text(tree.frames) if isinstance(tree, Leaf) else choice_text(tree)


def _frames_text(frames: tuple[str, ...]) -> str:
    return "(" + ", ".join(f"FRAMES[{quoted(name)}]" for name in frames) + ("," if len(frames) == 1 else "") + ")"
