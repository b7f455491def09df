"""What to do about values that cannot be sent: names that were meant, and the numbers that a field may have.

It goes by the model of the frame and what was given; that something is wrong, and what, has been found by the encoder.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from framekit.codec.errors import EncodeError
from framekit.definition.model.frames import by_value_name
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Field, Inner, Repeat, Segment
from framekit.definition.problems import did_you_mean

MOST = 8
"""Numbers of a field that are listed."""

MOST_NAMES = 16
"""Names of fields that are listed."""

Level = tuple[Mapping[str, Segment], Mapping[str, Any]]
"""The values that a frame or record can have, and those that were given."""


def with_hint(
    error: EncodeError, protocol: Protocol, frame: str, given: Mapping[str, Any], more: Iterable[str] = ()
) -> str:
    """The error in words, with what to do about it where that is known; `more` are names that fit elsewhere."""
    names = [path.rpartition(".")[2] for path in (error.field, *error.more)]
    levels = list(_levels(protocol, protocol.frames[frame].segments, given))
    found = {name: hint for name in names if (hint := _hint(name, levels, more))}
    hints = [f"{name}: {hint}" for name, hint in found.items()] if error.more else list(found.values())
    return f"{error} – {'; '.join(hints)}" if hints else str(error)


def _hint(name: str, levels: Iterable[Level], more: Iterable[str]) -> str:
    for known, given in levels:
        if name in given and name not in known:
            return _known(name, list(known), more)
        segment = known.get(name)
        if isinstance(segment, Field) and segment.values and not _has_meaning(segment.values, given.get(name)):
            return numbers_of(segment.values)
        if isinstance(segment, Inner) and isinstance(value := given.get(name), Mapping):
            return next(
                (did_you_mean(str(frame), segment.frames) for frame in value if frame not in segment.frames), ""
            )
    return ""


def _known(name: str, known: list[str], more: Iterable[str]) -> str:
    """The name that was meant, where one is near, and all there are."""
    near = did_you_mean(name, [*known, *more])
    names = ", ".join(known[:MOST_NAMES]) + (", …" if len(known) > MOST_NAMES else "")
    return f"{near} The fields are {names}" if near.startswith("did you mean") else f"the fields are {names}"


def _has_meaning(values: Mapping[int, str], given: Any) -> bool:
    """Whether a value is one of the numbers or names."""
    return str(given) in {*values.values(), *map(str, values)}


def numbers_of(values: Mapping[int, str]) -> str:
    """`give 1 (on), 2 (off) or 3 (both)`."""
    shown = [f"{number} ({text})" for number, text in list(values.items())[:MOST]]
    if len(values) > MOST:
        return f"give one of {', '.join(shown)}, …"
    return "give " + " or ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


def _levels(protocol: Protocol, segments: tuple[Segment, ...], given: Any) -> Iterator[Level]:
    """The frame itself, then the records, items and inner frames that were given in it."""
    if not isinstance(given, Mapping):
        return
    known = by_value_name(segments)
    yield known, given
    for name, value in given.items():
        match known.get(name):
            case Segment(is_record=True, members=of):
                yield from _levels(protocol, of, value)
            case Repeat(of=of) if isinstance(of, tuple):
                for item in value if isinstance(value, list) else [value]:
                    yield from _levels(protocol, of, item)
            case Inner() if isinstance(value, Mapping):
                for frame, fields in value.items():
                    if frame in protocol.frames:
                        yield from _levels(protocol, protocol.frames[frame].segments, fields)
