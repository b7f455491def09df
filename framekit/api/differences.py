"""Two recordings of one line, such as pump off and pump on: the fields that have no value in common.

The fields are guessed from both recordings together, or are those of a definition.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from framekit.api.guess import LEAST_FRAMES, seen_by
from framekit.api.monitor import field_rows
from framekit.codec.codec import compile_protocol
from framekit.codec.plain import PlainValues
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.frames import everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Count, Length
from framekit.guess.framing import cut_line
from framekit.guess.guess import guess
from framekit.guess.model import GuessedField, HeardBytes
from framekit.guess.pieces import joined, streams_of
from framekit.guess.stuffing import plain_frame
from framekit.guess.texts import shown_text


class Difference(NamedTuple):
    """A field whose values differ between two recordings."""

    frame: str
    offset: int
    field: str
    first: str
    second: str


def differences(one: Sequence[HeardBytes], two: Sequence[HeardBytes]) -> list[Difference]:
    """The bytes of frames, guessed from both together, that have other values in the second recording.

    Counters and checks differ always, and are left out.
    """
    found = guess([*one, *two])
    framing = found.framing
    if framing is None:
        return []
    own = [{frame.data for frame in cut_line(framing, streams_of(joined(part))).frames} for part in (one, two)]
    rows: list[Difference] = []
    for kind in found.kinds:
        halves = [
            [plain_frame(framing, frame.data) for frame in kind.frames if frame.data in part] for part in own
        ]  # fmt: skip
        for field in kind.fields:
            if field.kind not in ("counter", "check", "length", "count"):
                rows += _of_guessed(kind.name, field, halves)
    return rows


def _of_guessed(kind: str, field: GuessedField, halves: list[list[bytes]]) -> Iterator[Difference]:
    """Where no value is in both halves; in data of varying size byte by byte, of frames of one size."""
    if field.size:
        parts = [(field.offset, field.size, halves)]
    else:
        sizes = Counter(len(text) for half in halves for text in half)
        size = max(sizes, key=lambda one: (sizes[one], one), default=0)
        same = [[text for text in half if len(text) == size] for half in halves]
        parts = [(place, 1, same) for place in range(field.offset, size)]
    shown = shown_text if field.kind == "text" else _hex
    for place, width, texts in parts:
        values = [{text[place : place + width] for text in half} for half in texts]
        if all(values) and not values[0] & values[1]:
            yield Difference(kind, place, field.name, *(_some(map(shown, sorted(one))) for one in values))


def _hex(data: bytes) -> str:
    return data.hex(" ").upper()


def _some(values: Iterable[str]) -> str:
    shown = list(values)
    return ", ".join(shown[:3]) + (f" … {len(shown)} values" if len(shown) > 3 else "")


# ---- of a definition --------------------------------------------------------------------------------------------


class FieldValues(NamedTuple):
    """The values that a field had in one recording, in their order, and where it first stood."""

    offset: int
    values: list[Any]


def definition_differences(name: str | Path, one: Sequence[HeardBytes], two: Sequence[HeardBytes]) -> list[Difference]:
    """The fields of a definition that have other values in the second recording. Raises DefinitionError.

    Lengths and counts, and what goes up by the same from frame to frame, are left out.
    """
    protocol = load_protocol(name)
    before, after = (_values_of_fields(protocol, part) for part in (one, two))
    rows = []
    for (frame, path), first in before.items():
        second = after.get((frame, path))
        if second is None or _is_counter(first.values) or _is_counter(second.values):
            continue
        sets = [dict.fromkeys(part.values) for part in (first, second)]
        if not sets[0].keys() & sets[1].keys():
            rows.append(Difference(frame, first.offset, path, *(_some(map(str, values)) for values in sets)))
    return rows


def _values_of_fields(protocol: Protocol, chunks: Sequence[HeardBytes]) -> dict[tuple[str, str], FieldValues]:
    """The values of each field, by its frame and path."""
    codec, plain, counting = compile_protocol(protocol), PlainValues(protocol), _counting(protocol)
    found: dict[tuple[str, str], FieldValues] = {}
    for seen in seen_by(protocol, chunks):
        if seen.kind != "frame":
            continue
        places: dict[str, int] | None = None
        for path, value in _paths(plain.to_plain(seen.frame, seen.fields), seen.fields):
            known = found.get((seen.frame, path))
            if known is None:
                if path.rpartition(".")[2] in counting:
                    continue
                if places is None:
                    places = {row.path: row.offset for row in field_rows(codec, protocol, seen)}
                known = found[seen.frame, path] = FieldValues(_offset(path, places), [])
            known.values.append(plain.named(seen.frame, path, value))
    return found


def _paths(shown: Any, fields: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every single value as people write it, with its path; items, and bytes, by their numbers."""
    if isinstance(fields, Mapping) and isinstance(shown, Mapping):
        for key, value in fields.items():
            yield from _paths(shown.get(key), value, f"{path}.{key}" if path else str(key))
    elif isinstance(fields, (bytes, bytearray)):
        yield from ((f"{path}[{number}]", f"{byte:02X}") for number, byte in enumerate(fields))
    elif isinstance(fields, list) and isinstance(shown, list):
        for number, (one, item) in enumerate(zip(shown, fields, strict=True)):
            yield from _paths(one, item, f"{path}[{number}]")
    else:
        yield path, shown


def _counting(protocol: Protocol) -> frozenset[str]:
    """The names of lengths and counts."""
    segments = (one for frame in protocol.frames.values() for one in everything(frame.segments))
    return frozenset(name for one in segments if isinstance(one, (Length, Count)) for name in one.value_names)


def _offset(path: str, places: Mapping[str, int]) -> int:
    """Where a field stands; a byte counts from the first one of its field."""
    if path in places:
        return places[path]
    name, _, number = path.rpartition("[")
    return places.get(name, 0) + int(number.removesuffix("]") or 0) if name else 0


def _is_counter(values: Sequence[Any]) -> bool:
    """Whether they are numbers that go up by the same each time."""
    if len(values) <= LEAST_FRAMES or not all(type(value) is int for value in values):
        return False
    steps = {after - before for before, after in pairwise(values)}
    return len(steps) == 1 and steps != {0}
