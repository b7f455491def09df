"""A quick look at a frame before anything else of it is read: the check code at its end, and bytes at fixed places.

It serves to pass over candidates that cannot be good. What it does not know how to look at, it leaves to the codec.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

from framekit.codec.checks import function_of, residue_of
from framekit.codec.python.choices import fixed_bytes
from framekit.definition.expression import Expression, names_in
from framekit.definition.model.frames import Frame, StaticSizes, parts_of
from framekit.definition.model.segments import Check, Const, Field, Inner, Segment
from framekit.link.evaluate import EVALUATION_ERRORS, Names, compile_expression

Intact = Callable[[bytes | bytearray], bool]
"""Whether these bytes may be good: false if they are surely no good frame, and none that is refused."""


def intact_of(frame: Frame) -> Intact | None:
    """For a frame that ends in a check code over everything before it; None for every other."""
    check = _check_of(frame)
    restricted = _restricted(frame)
    if check is None or not restricted:
        return check

    def intact(raw: bytes | bytearray) -> bool:
        for place, allowed in restricted:
            if place < len(raw) and raw[place] not in allowed:
                return False
        return check(raw)

    return intact


def any_intact(frames: Sequence[tuple[Frame, Intact | None]]) -> Intact:
    """Whether bytes may be a good one of several frames, told apart by one byte first; always where nothing tells."""
    looks = {look: dict(_restricted(frame)) for frame, look in frames}
    if None in looks:
        return lambda raw: True
    known = Counter(place for allowed in looks.values() for place in allowed)
    if len(looks) == 1 or not known:
        return _any_of(tuple(look for look in looks if look is not None))
    place = known.most_common(1)[0][0]
    left = [
        tuple(look for look, allowed in looks.items() if look and (place not in allowed or byte in allowed[place]))
        for byte in range(256)
    ]

    def intact(raw: bytes | bytearray) -> bool:
        if place >= len(raw):
            return True
        return any(look(raw) for look in left[raw[place]])

    return intact


def _any_of(looks: tuple[Intact, ...]) -> Intact:
    return looks[0] if len(looks) == 1 else lambda raw: any(look(raw) for look in looks)


def _restricted(frame: Frame) -> list[tuple[int, frozenset[int]]]:
    """Bytes that only some values are right for; what measures a frame looks at the constants it begins with."""
    begin = 0
    for segment in frame.segments:
        if not isinstance(segment, Const) or segment.when is not None:
            break
        begin += len(segment.data)
    moves = frame.delimited or frame.size is not None
    segments = frame.head + frame.body if moves else frame.segments
    return [(place, allowed) for place, allowed in fixed_bytes(segments) if place >= begin]


def _check_of(frame: Frame) -> Intact | None:
    """A look at the check code; None where it is no number or digits at the very end, or is not always to be right."""
    last = frame.segments[-1] if frame.segments else None
    if not isinstance(last, Check) or last.form not in ("raw", "hex", "HEX") or last.verify != "error":
        return None
    if frame.size is not None and not frame.tail:  # what fills it up stands behind
        return None
    if (
        last.method.kind == "fold"
        or last.over is not None
        or last.span is not None
        or any(one.is_there_inside for one in parts_of(frame.segments, Segment))
    ):
        return None
    intact = _code_of(last) if last.form == "raw" else _digits_of(last)
    return intact if last.when is None or intact is None else _where_there(last.when, frame.segments, intact)


def _code_of(check: Check) -> Intact:
    code, size, order = function_of(check.method), check.size, check.order
    residue = residue_of(check.method, size, order)
    if residue is not None:
        return lambda raw: code(raw) == residue
    room = (1 << 8 * size) - 1

    def intact(raw: bytes | bytearray) -> bool:
        return raw[-size:] == (code(raw[:-size]) & room).to_bytes(size, order)

    return intact


def _digits_of(check: Check) -> Intact | None:
    code, size = function_of(check.method), check.size
    if size != 2:
        return None

    def intact(raw: bytes | bytearray) -> bool:
        return raw[-2:].upper() == b"%02X" % (code(raw[:-2]) & 0xFF)

    return intact


def _where_there(condition: Expression, segments: tuple[Segment, ...], intact: Intact) -> Intact | None:
    """For a check code that is there under a condition on one character at a fixed place."""
    names = names_in(condition.root)
    name = next(iter(names)) if len(names) == 1 else None
    place = None if name is None else _character_at(name, segments)
    if name is None or place is None:
        return None
    holds = compile_expression(condition)
    known: dict[int, bool] = {}

    def is_there(byte: int) -> bool:
        try:
            return bool(holds(Names({name: chr(byte)})))
        except EVALUATION_ERRORS:
            return False

    def look(raw: bytes | bytearray) -> bool:
        if place >= len(raw):
            return True
        there = known.get(raw[place])
        if there is None:
            there = known[raw[place]] = is_there(raw[place])
        return not there or intact(raw)

    return look


def _character_at(name: str, segments: tuple[Segment, ...]) -> int | None:
    """The place of a field of one character, if it is always the same."""
    place, shapes = 0, StaticSizes({})
    for segment in segments:
        if segment.when is not None or any(parts_of(segment, Inner)):
            return None
        if isinstance(segment, Field) and segment.name == name:
            plain = segment.type.kind == "ascii" and segment.type.fixed_size == 1 and segment.type.pad is None
            return place if plain and segment.values is None and segment.long is None else None
        size = shapes.present(segment).fixed
        if size is None:
            return None
        place += size
    return None
