"""Two recordings of one line, such as pump off and pump on: the fields whose values differ.

The fields are guessed from both recordings together, or are those of a definition. Replies are compared with replies to
the same request.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from framekit.api.monitor import field_rows
from framekit.codec.codec import compile_protocol
from framekit.codec.plain import PlainValues
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.frames import everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Count, Length
from framekit.definition.problems import plural
from framekit.extras.guess.checks import holds
from framekit.extras.guess.fields import ONE_UP
from framekit.extras.guess.framing import cut_line
from framekit.extras.guess.guess import guess, own_name
from framekit.extras.guess.model import FrameKind, Guess, HeardBytes
from framekit.extras.guess.pieces import joined, streams_of
from framekit.extras.guess.recordings import LEAST_FRAMES, seen_by
from framekit.extras.guess.stuffing import plain_frame
from framekit.extras.guess.texts import shown_text


class Difference(NamedTuple):
    """A field whose values differ between two recordings."""

    frame: str
    offset: int
    field: str
    first: str
    second: str


class SeenFrame(NamedTuple):
    """A frame of one recording: its kind, the request before it ('' for a frame that is no reply), and its values."""

    kind: str
    asked: str
    size: int
    values: dict[tuple[int, str], Any]


def differences(one: Sequence[HeardBytes], two: Sequence[HeardBytes]) -> list[Difference]:
    """Return the fields of frames, guessed from both recordings, that have other values in the second.

    Counters and checks always differ and are left out, as are bytes that a reply repeats: they are compared in the
    request.
    """
    if others := _other_protocols(one, two):
        return others
    found = guess([*one, *_behind(one, two)])
    framing = found.framing
    if framing is None:
        return []
    kind_of = {id(frame): kind for kind in found.kinds for frame in kind.frames}
    frames = [frame for frame in found.frames if id(frame) in kind_of]
    texts = {id(frame): plain_frame(framing, frame.data) for frame in frames}
    requests: dict[str, list[bytes]] = defaultdict(list)
    for frame in frames:
        if (kind := kind_of[id(frame)]).side == "client":
            requests[kind.name].append(texts[id(frame)])
    fixed = {kind.name: _asked_places(kind, requests[kind.name]) for kind in found.kinds if requests[kind.name]}
    halves: tuple[list[SeenFrame], list[SeenFrame]] = [], []
    first, at, asked = sum(len(frame.data) for frame in cut_line(framing, streams_of(joined(one))).frames), 0, ""
    for frame in found.frames:
        half = halves[at >= first]
        at += len(frame.data)
        if (known := kind_of.get(id(frame))) is None:
            continue
        text = texts[id(frame)]
        if known.side == "client":
            places = fixed[known.name]
            asked = " ".join(f"{byte:02X}" if place in places else ".." for place, byte in enumerate(text[:MOST_SHOWN]))
            asked = asked.rstrip(" .")
        key = asked if known.side == "server" else ""
        half.append(SeenFrame(known.name, key, len(text), dict(_guessed_values(known, text))))
    return compared(*halves)


MOST_ASKED = 12
"""Largest number of values of a byte that identifies a request."""
MOST_SHOWN = 24


def _behind(one: Sequence[HeardBytes], two: Sequence[HeardBytes]) -> list[HeardBytes]:
    """Return the second recording, with times as if it followed the first."""
    last = max((chunk.time for chunk in one if chunk.time is not None), default=0)
    first = min((chunk.time for chunk in two if chunk.time is not None), default=0)
    later = last - first + LONG_AFTER
    return [chunk if chunk.time is None else chunk._replace(time=chunk.time + later) for chunk in two]


LONG_AFTER = 10_000_000_000


def _other_protocols(one: Sequence[HeardBytes], two: Sequence[HeardBytes]) -> list[Difference]:
    """Report another protocol if the check of each recording fails in the frames of the other."""
    both = guess(one), guess(two)
    for found, other in (both, both[::-1]):
        checks = [kind.check for kind in found.kinds if kind.check is not None and kind.check.is_sure]
        texts = [frame.data for frame in other.frames]
        if not checks or len(texts) < LEAST_KNOWN or not _is_sure(other):
            return []
        if sum(any(holds(check, text) for check in checks) for text in texts) > FEW * len(texts):
            return []
    return [Difference("all frames", 0, "another protocol", *(_check_name(found) for found in both))]


LEAST_KNOWN = 5
FEW = 0.1


def _is_sure(found: Guess) -> bool:
    return found.check is not None and found.check.is_sure


def _check_name(found: Guess) -> str:
    assert found.check is not None
    return found.check.name or own_name(found.check)


def _asked_places(kind: FrameKind, texts: Sequence[bytes]) -> frozenset[int]:
    """Return the offsets of the bytes that identify a request: without counters, codes, and bytes that always
    differ.
    """
    end = min(map(len, texts)) + min((field.offset for field in kind.fields if field.offset < 0), default=0)
    counted = {
        place
        for field in kind.fields
        if field.kind == "counter" or field.about.startswith(ONE_UP)
        for place in range(field.offset, field.offset + field.size)
    }
    return frozenset(
        place for place in range(end) if place not in counted and len({text[place] for text in texts}) <= MOST_ASKED
    )


def _guessed_values(kind: FrameKind, text: bytes) -> Iterator[tuple[tuple[int, str], Any]]:
    """Yield the values of a frame, by offset and name; data of varying size byte by byte."""
    end = len(text) + min((field.offset for field in kind.fields if field.offset < 0), default=0)
    for field in kind.fields:
        if field.kind in ("counter", "check", "length", "count") or field.offset < 0:
            continue
        if field.kind == "copy" and (kind.side == "server" or field.about.startswith(ONE_UP)):
            continue
        if field.kind == "text" and field.size:
            yield (field.offset, field.name), shown_text(text[field.offset : field.offset + field.size])
            continue
        for place in range(field.offset, field.offset + field.size if field.size else end):
            yield (place, field.name), text[place : place + 1]


# ---- two recordings ---------------------------------------------------------------------------------------------


def compared(one: Sequence[SeenFrame], two: Sequence[SeenFrame]) -> list[Difference]:
    """Return the differences of frames of each kind, of replies to equal requests, and frames that only one recording
    has.
    """
    groups: dict[tuple[str, str], tuple[list[SeenFrame], list[SeenFrame]]] = defaultdict(lambda: ([], []))
    kinds: dict[str, tuple[list[SeenFrame], list[SeenFrame]]] = defaultdict(lambda: ([], []))
    for number, part in enumerate((one, two)):
        for frame in part:
            groups[frame.kind, frame.asked][number].append(frame)
            kinds[frame.kind][number].append(frame)
    often = Counter(kind for kind, _ in groups)
    rows = [_of_one(kind, *halves) for kind, halves in kinds.items() if not all(halves)]
    for (kind, asked), halves in groups.items():
        name = f"{kind} (asked {asked})" if asked and often[kind] > 1 else kind
        if all(halves):
            rows += _of_values(name, *halves)
        elif all(kinds[kind]):
            rows.append(_of_one(name, *halves))
    return rows


def _of_one(name: str, one: Sequence[SeenFrame], two: Sequence[SeenFrame]) -> Difference:
    counts = (plural(len(part), "frame") if part else "none" for part in (one, two))
    return Difference(name, 0, "all of it", *counts)


def _of_values(name: str, one: Sequence[SeenFrame], two: Sequence[SeenFrame]) -> Iterator[Difference]:
    """Yield the fields that differ, in frames of the most frequent size."""
    sizes = Counter(frame.size for frame in (*one, *two))
    both = {frame.size for frame in one} & {frame.size for frame in two}
    size = max(both or sizes, key=lambda size: (sizes[size], size))
    for place, field in dict.fromkeys(key for frame in (*one, *two) for key in frame.values):
        values = [
            [frame.values[place, field] for frame in part if frame.size == size and (place, field) in frame.values]
            or [frame.values[place, field] for frame in part if (place, field) in frame.values]
            for part in (one, two)
        ]
        if all(values) and _differ(*values):
            shown = (_some(list(dict.fromkeys(part))) for part in values)
            yield Difference(name, place, field, *shown)


def _differ(one: Sequence[Any], two: Sequence[Any]) -> bool:
    """Return whether two sets of values differ: no common value and separate ranges, or nearly all values of one set
    greater.

    Numbers with a constant step always differ.
    """
    first, second = (list(map(_number, part)) for part in (one, two))
    if _is_counter(first) or _is_counter(second):
        return False
    if None in first or None in second:
        return not {*map(str, one)} & {*map(str, two)}
    low, high = sorted((sorted(part) for part in (first, second)), key=lambda part: (part[0], part[-1]))
    if not {*first} & {*second}:
        return bool(low[-1] < high[0]) or all(3 * len({*part}) <= len(part) for part in (first, second))
    if min(len(low), len(high)) < ENOUGH or any(_only_rises(part) for part in (first, second)):
        return False
    return bool(low[len(low) * 9 // 10] < high[len(high) // 10] or high[len(high) * 9 // 10] < low[len(low) // 10])


ENOUGH = 5
"""Number of values whose range is significant."""


def _number(value: Any) -> Any:
    """Return a value as a number for comparison; None if it has none."""
    if isinstance(value, bytes):
        return int.from_bytes(value, "big")
    return value if isinstance(value, (int, float)) else None


def _only_rises(values: Sequence[Any]) -> bool:
    """Return whether numbers never decrease, as a sum or a time that continues from one recording to the next."""
    return len({*values}) > 1 and all(one <= two for one, two in pairwise(values))


def _some(values: Sequence[Any]) -> str:
    """Return the different values as text; many values as a range."""
    if len(values) <= 3 or any(_number(one) is None for one in values):
        shown = sorted(map(_shown, values))
        return ", ".join(shown[:3]) + (f" … {len(shown)} values" if len(shown) > 3 else "")
    ordered = sorted(values, key=_number)
    return f"{_shown(ordered[0])} to {_shown(ordered[-1])}, {len(values)} values"


def _shown(value: Any) -> str:
    return value.hex(" ").upper() if isinstance(value, bytes) else str(value)


# ---- of a definition --------------------------------------------------------------------------------------------


def definition_differences(name: str | Path, one: Sequence[HeardBytes], two: Sequence[HeardBytes]) -> list[Difference]:
    """Return the fields of a definition that have other values in the second recording. Raises DefinitionError.

    Lengths, counts, and values with a constant step from frame to frame are left out.
    """
    protocol = load_protocol(name)
    halves = [_read(protocol, part) for part in (one, two)]
    values: dict[tuple[str, str], list[Any]] = defaultdict(list)
    for frame in (*halves[0], *halves[1]):
        if protocol.frames[frame.kind].side == "client":
            for (_, path), value in frame.values.items():
                values[frame.kind, path].append(value)
    often = Counter(frame.kind for half in halves for frame in half)
    telling = {
        key
        for key, own in values.items()
        if (len({*map(str, own)}) > 1 or len(own) < often[key[0]])
        and len({*map(str, own)}) <= MOST_ASKED
        and not _is_counter(own)
    }
    return compared(*(_with_asked(protocol, half, telling) for half in halves))


def _with_asked(protocol: Protocol, frames: Sequence[SeenFrame], telling: set[tuple[str, str]]) -> list[SeenFrame]:
    """Return the replies with the request before them."""
    found, asked = [], ""
    for frame in frames:
        if protocol.frames[frame.kind].side == "client":
            known = [(path, value) for (_, path), value in frame.values.items() if (frame.kind, path) in telling]
            asked = " ".join(f"{path.rpartition('.')[2]}={_shown(value)}" for path, value in known)
        elif protocol.frames[frame.kind].side == "server":
            frame = frame._replace(asked=asked)
        found.append(frame)
    return found


def _read(protocol: Protocol, chunks: Sequence[HeardBytes]) -> list[SeenFrame]:
    """Return the frames in order, with the values of their own fields."""
    codec, plain, counting = compile_protocol(protocol), PlainValues(protocol), _counting(protocol)
    known: dict[tuple[str, str], int] = {}
    found = []
    for seen in seen_by(protocol, chunks):
        if seen.kind != "frame":
            continue
        places: dict[str, int] | None = None
        values = {}
        for path, value in _paths(plain.to_plain(seen.frame, seen.fields), seen.fields):
            if path.rpartition(".")[2] in counting:
                continue
            if (seen.frame, path) not in known:
                if places is None:
                    places = {row.path: row.offset for row in field_rows(codec, protocol, seen)}
                known[seen.frame, path] = _offset(path, places)
            values[known[seen.frame, path], path] = (
                value if isinstance(value, bytes) else plain.named(seen.frame, path, value)
            )
        found.append(SeenFrame(seen.frame, "", len(seen.raw), values))
    return found


def _paths(shown: Any, fields: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every single value in the form of users' input, with its path; items, and bytes, by their numbers."""
    if isinstance(fields, Mapping) and isinstance(shown, Mapping):
        for key, value in fields.items():
            yield from _paths(shown.get(key), value, f"{path}.{key}" if path else str(key))
    elif isinstance(fields, (bytes, bytearray)):
        yield from ((f"{path}[{number}]", bytes([byte])) for number, byte in enumerate(fields))
    elif isinstance(fields, list) and isinstance(shown, list):
        for number, (one, item) in enumerate(zip(shown, fields, strict=True)):
            yield from _paths(one, item, f"{path}[{number}]")
    else:
        yield path, shown


def _counting(protocol: Protocol) -> frozenset[str]:
    """Return the names of lengths and counts."""
    segments = (one for frame in protocol.frames.values() for one in everything(frame.segments))
    return frozenset(name for one in segments if isinstance(one, (Length, Count)) for name in one.value_names)


def _offset(path: str, places: Mapping[str, int]) -> int:
    """Return the offset of a field; a byte counts from the first byte of its field."""
    if path in places:
        return places[path]
    name, _, number = path.rpartition("[")
    return places.get(name, 0) + int(number.removesuffix("]") or 0) if name else 0


def _is_counter(values: Sequence[Any]) -> bool:
    """Return whether the values are numbers with a constant step."""
    if len(values) <= LEAST_FRAMES or not all(type(value) is int for value in values):
        return False
    steps = {after - before for before, after in pairwise(values)}
    return len(steps) == 1 and steps != {0}
