"""What a capture says of the values in devices: a table like that of a sink, which a simulated device can replay."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from framekit.api.errors import RequestError
from framekit.codec.codec import compile_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import DefinitionError
from framekit.link.events import Seen
from framekit.link.frame_table import table_of
from framekit.link.scope import Scope
from framekit.link.services.overheard import KnownValue, Overheard
from framekit.link.values import CODEC_ERRORS, Names
from framekit.run.points import iso_time
from framekit.runfile.devices import load_devices

HEAD = ("time", "point", "value", "unit", "quality", "reason")
"""The columns, as those of the sink csv."""


class CapturedValue(NamedTuple):
    """A value that was read or written: when it came (ns since 1970), and its point, `STATION/ADDRESS` or `ADDRESS`."""

    time: int
    point: str
    value: Any


def captured_values(
    found: Iterable[tuple[int, Seen]], protocol: Protocol, name: str, params: Mapping[str, Any]
) -> Iterator[CapturedValue]:
    """The values in what was seen on channels, each the first time and whenever it is another one. `name`: the
    protocol's name or file.

    Raises RequestError for a protocol in which nothing asks for places, and CaptureError (a ValueError).
    """
    codec = compile_protocol(protocol)
    table, scope = table_of(protocol, codec), Scope(protocol, params=params)
    try:
        memory = load_devices(name, Path.cwd())[0].create_memory()
    except DefinitionError as error:
        raise RequestError(f"the values of '{name}' have no place: {error.problems[0]}") from None

    def line_of(channel: int) -> Overheard:
        if channel not in lines:
            lines[channel] = Overheard(protocol, codec, memory, Names({}, scope))
        return lines[channel]

    lines: dict[int, Overheard] = {}
    known: dict[tuple[int, str], Any] = {}
    if line_of(1).hears_nothing:
        raise RequestError(f"no frame of '{protocol.name}' asks for places of memory")
    for channel, seen in found:
        if seen.kind != "frame":
            continue
        try:
            frame = table.received(seen.frame, seen.fields, seen.raw, None)
        except CODEC_ERRORS:
            continue
        for one in line_of(channel).hear(frame):
            point = point_of(one)
            if (channel, point) not in known or known[channel, point] != one.value:
                known[channel, point] = one.value
                yield CapturedValue(seen.at, point, one.value)


def point_of(one: KnownValue) -> str:
    """The name of an element as a point."""
    return one.address if one.station is None else f"{one.station}/{one.address}"


def write_values(values: Iterator[CapturedValue], target: Path) -> tuple[int, int]:
    """Writes a table of comma-separated values; how many there were, and of how many points. Raises OSError."""
    points: set[str] = set()
    count = 0
    with target.open("w", encoding="utf-8", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(HEAD)
        for one in values:
            rows.writerow((iso_time(one.time), one.point, one.value, "", "good", ""))
            points.add(one.point)
            count += 1
    return count, len(points)
